//! What the tests of all kinds of rules check: that executors, replays, observers and scenes agree.

use logicity::city::{Action, Split};
use logicity::config::Scenario;
use logicity::diag::{Sources, render};
use logicity::files::ReadFile;
use logicity::rng::Seed;
use logicity::sim::{
    Executor, Facts, Inference, Observer, Oracle, Replay, Settings, Simulation, TraceHeader, TraceTick, TraceWriter,
    World,
};
use std::sync::Arc;

/// The agents of the test split, repeated `times` times, anywhere on the map.
pub fn multiply(scenario: &mut Scenario, times: u32) {
    let mut splits = scenario.splits.iter_mut();
    let (_, set) = splits.find(|(split, _)| *split == Split::Test).unwrap();
    (set.region, set.repeat) = (None, times);
}

pub fn simulation(world: &Arc<World>, executor: Executor, threads: usize) -> Simulation {
    let settings = Settings {
        executor,
        count_firings: true,
        threads,
    };
    Simulation::new(Arc::clone(world), Split::Test, Seed(3), settings).unwrap()
}

/// A city under both executors, the dense one also on two threads.
pub fn executors(world: &Arc<World>) -> [Simulation; 3] {
    let executors = [(Executor::Relational, 1), (Executor::Dense, 1), (Executor::Dense, 2)];
    executors.map(|(executor, threads)| simulation(world, executor, threads))
}

/// Runs the simulations and compares their reports.
pub fn go_the_same_way(simulations: &mut [Simulation], ticks: u64) {
    Counts::default().go_the_same_way(simulations, ticks);
}

/// How often agents did each action, and clauses derived an action, in a tick.
#[derive(Debug, Default)]
pub struct Counts {
    pub actions: [usize; Action::MAX],
    fired: usize,
}

impl Counts {
    /// Runs the simulations, compares their reports and counts what they do.
    pub fn go_the_same_way(&mut self, simulations: &mut [Simulation], ticks: u64) {
        let (first, others) = simulations.split_first_mut().unwrap();
        for _ in 0..ticks {
            let report = first.tick(&[]).unwrap().clone();
            for other in &mut *others {
                let seen = other.tick(&[]).unwrap();
                for (agent, (one, two)) in report.agents.iter().zip(&seen.agents).enumerate() {
                    assert_eq!(one, two, "agent {agent} in tick {}", report.tick);
                }
                assert_eq!(report.tick, other.report().tick);
                assert_eq!(first.firings(), other.firings(), "tick {}", report.tick);
                for agent in 0..report.agents.len() {
                    let fired = |simulation: &Simulation| simulation.fired(agent).collect::<Vec<_>>();
                    assert_eq!(fired(first), fired(other), "agent {agent} in tick {}", report.tick);
                }
            }
            for agent in &report.agents {
                self.actions[agent.action.index()] += 1;
            }
            self.fired += first.firings().iter().filter(|count| **count > 0).count();
        }
    }

    /// Checks that the rules did something.
    pub fn check(&self) {
        let enough = Action::STANDARD.iter().all(|action| self.actions[action.index()] > 100) && self.fired > 500;
        assert!(enough, "{self:?}");
    }
}

/// Runs a city for these ticks, and returns its trace and the facts of each tick. `before` sees it before each tick.
pub fn record(
    world: &Arc<World>,
    sources: &Sources,
    ticks: u32,
    mut before: impl FnMut(&Simulation),
) -> (String, Vec<Facts>) {
    let mut city = simulation(world, Executor::Auto, 1);
    let mut trace = TraceWriter::new(Vec::new(), &city, sources, &[]).unwrap();
    let mut facts = Vec::new();
    for _ in 0..ticks {
        before(&city);
        city.tick(&[]).unwrap();
        trace.tick(&city).unwrap();
        facts.push(city.facts(|_| true).unwrap());
    }
    (String::from_utf8(trace.into_inner()).unwrap(), facts)
}

/// Replays a trace, checks that it has the facts of each tick, and calls `each` with the replay and the tick. Returns the
/// replay after the last tick.
pub fn replay(world: &Arc<World>, trace: &str, facts: &[Facts], mut each: impl FnMut(&mut Replay, usize)) -> Replay {
    let mut lines = trace.lines();
    // The header names the rules of the configuration; only its list of agents matters here.
    let mut header: serde_json::Value = serde_json::from_str(lines.next().unwrap()).unwrap();
    header["version"] = 1.into();
    header["rules"] = "rules.dl".into();
    let header = TraceHeader::read(&header.to_string()).unwrap();
    let mut replay = Replay::new(Arc::clone(world), &header).unwrap();
    assert_eq!(lines.clone().count(), facts.len());
    for (tick, line) in lines.enumerate() {
        replay.set(&TraceTick::read(line).unwrap()).unwrap();
        assert_eq!(replay.facts(), &facts[tick], "tick {tick}");
        each(&mut replay, tick);
    }
    replay
}

/// Observes each agent of a city for these ticks: the actions that its monitor derives are those of a session with the
/// same facts. Returns their number.
pub fn observers_derive_as_sessions_do(oracle: &Arc<Oracle>, world: &Arc<World>, ticks: u32) -> usize {
    let mut city = simulation(world, Executor::Auto, 1);
    let egos = 0..city.agents().len();
    let mut observers: Vec<Observer> = egos.map(|ego| Observer::new(Arc::clone(oracle), ego)).collect();
    observers.iter_mut().for_each(|observer| observer.begin(&city));
    let mut derived = 0;
    for _ in 0..ticks {
        for observer in &mut observers {
            observer.look(&city).unwrap();
            let found = observer.derived(&city).unwrap();
            let (session, ego) = observer.session(&city).unwrap();
            let holds = |action: &Action| session.contains(world.vocabulary.action(*action).unwrap(), [ego]);
            let expected = Action::STANDARD.into_iter().filter(holds).collect();
            assert_eq!(found, world.vocabulary.before_default(None, expected));
            derived += found.len();
        }
        city.tick(&[]).unwrap();
    }
    derived
}

/// Returns the answer to a scene, or its faults as text. `read` reads the maps that it names.
pub fn answer(
    world: &World,
    executor: Executor,
    read: impl ReadFile + Send + Sync + 'static,
    scene: &str,
) -> Result<serde_json::Value, String> {
    let (scenario, program) = (world.scenario.clone(), world.program.clone());
    let mut inference = Inference::new(scenario, program, Seed(0), executor, read).unwrap();
    let mut sources = Sources::new();
    let source = sources.add("scene", scene.to_owned());
    match inference.answer(&sources, source) {
        Ok(answer) => Ok(answer.to_json(u64::MAX).unwrap()),
        Err(faults) => Err(render(&faults, &sources, false)),
    }
}
