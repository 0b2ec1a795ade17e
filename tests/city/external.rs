//! External predicates: functions of the caller, in runs, traces, scenes, tasks and observations.

use crate::agreement::{
    Counts, answer, executors, go_the_same_way, multiply, observers_derive_as_sessions_do, record, replay, simulation,
};
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Split};
use logicity::config::Scenario;
use logicity::diag::Sources;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{
    CityState, Decider, Executor, ExternalFacts, ExternalPredicates, Oracle, Settings, Simulation, TraceTick, World,
};
use logicity::task::spf::{Autoreset, ControlMode, Env, EpisodeSource, ObservationKind, SpfTask, VectorEnv};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

const CONFIG: &str = "base: expert
predicates:
  define:
    IsGreen: {external: agent}
    IsRival: {external: pair}
";

const DECLARED: &str = ".include \"vocabulary.dl\"
.decl IsGreen(x: agent)
.decl IsRival(x: agent, y: agent)
.input IsGreen, IsRival
";

/// Draws facts from the state: cells and headings of agents, and the tick.
#[derive(Debug)]
struct Drawn {
    names: Vec<&'static str>,
    /// The ticks of all calls.
    calls: Mutex<Vec<u64>>,
    /// The first tick in which it fails.
    fails_from: AtomicU64,
}

impl Drawn {
    fn of(names: &[&'static str]) -> Arc<Drawn> {
        Arc::new(Drawn {
            names: names.to_vec(),
            calls: Mutex::default(),
            fails_from: AtomicU64::new(u64::MAX),
        })
    }

    fn all() -> Arc<Drawn> {
        // The order of the names differs from that of the configuration.
        Drawn::of(&["IsRival", "IsGreen"])
    }

    fn calls(&self) -> Vec<u64> {
        self.calls.lock().unwrap().clone()
    }
}

impl ExternalPredicates for Drawn {
    fn names(&self) -> Vec<String> {
        self.names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn compute(&self, state: &CityState<'_>, facts: &mut ExternalFacts) -> Result<(), String> {
        self.calls.lock().unwrap().push(state.tick);
        if state.tick >= self.fails_from.load(Ordering::Relaxed) {
            return Err("the light is broken".to_owned());
        }
        for (number, (predicate, _)) in state.vocabulary.externals().enumerate() {
            let one = |agent: &logicity::city::Agent| {
                let heading = agent.heading.map_or(7, |heading| heading as u64);
                (agent.cell.row * 31 + agent.cell.col * 17) as u64 + heading + state.tick / 5
            };
            let holds: Vec<bool> = match predicate.name.as_str() {
                "IsGreen" => state.agents.iter().map(|agent| one(agent).is_multiple_of(3)).collect(),
                _ => (state.agents.iter())
                    .flat_map(|x| {
                        state
                            .agents
                            .iter()
                            .map(move |y| (one(x) * 5 + one(y)).is_multiple_of(4))
                    })
                    .collect(),
            };
            facts.set(number, &holds);
        }
        Ok(())
    }
}

fn world_of(rules: &str, edit: impl FnOnce(&mut Scenario), external: Arc<Drawn>) -> (Arc<World>, Sources) {
    let (mut world, sources) = configured(CONFIG, &format!("{DECLARED}{rules}"), edit);
    Arc::get_mut(&mut world).unwrap().set_external(external).unwrap();
    (world, sources)
}

/// Random rules: clauses of actions that read external facts.
fn random_rules(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 10] = [
        "IsGreen(X)",
        "Not(IsGreen(X))",
        "IsRival(X, Y)",
        "IsRival(Y, X)",
        "Sees(X, Y), IsGreen(Y)",
        "Sees(X, Y), Not(IsRival(X, Y))",
        "IsRival(X, Y), IsClose(X, Y)",
        "IsRival(X, Y), IsRival(Y, X), IsGreen(Y)",
        "IsRival(X, X)",
        "IsAtInter(Y), IsRival(X, Y)",
    ];
    let mut clauses = String::new();
    for head in ["Stop", "Slow", "Fast"] {
        for _ in 0..random.random_range(1..4) {
            let mut body = vec![["IsCar(X)", "IsAtInter(X)"][random.random_range(0..2)].to_owned()];
            for fact in 0..random.random_range(1..3) {
                let chosen = FACTS[random.random_range(0..FACTS.len())];
                body.push(chosen.replace('Y', &format!("Y{fact}")));
            }
            clauses += &format!("{head}(X) :- {}.\n", body.join(", "));
        }
    }
    clauses
}

/// Both executors read the same facts, in cities of every shape, on any number of threads.
#[test]
fn executors_agree_on_random_rules_with_external_predicates() {
    let mut counts = Counts::default();
    for (case, &(times, threads)) in [(1, 1), (1, 1), (1, 1), (5, 1), (5, 1), (20, 1), (20, 2)]
        .iter()
        .enumerate()
    {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let (world, _) = world_of(
            &rules,
            |scenario| {
                if times > 1 {
                    multiply(scenario, times);
                }
            },
            Drawn::all(),
        );
        let mut cities = [(Executor::Relational, 1), (Executor::Auto, threads)]
            .map(|(executor, threads)| simulation(&world, executor, threads));
        counts.go_the_same_way(&mut cities, if times < 20 { 60 } else { 5 });
    }
    counts.check();
}

/// In tiles, the dense executor reads facts about pairs in view.
#[test]
fn tiles_agree_with_the_relational_executor() {
    const RULES: &str = "Stop(X) :- IsCar(X), Sees(X, Y), IsRival(X, Y), IsGreen(Y).
Slow(X) :- IsGreen(X), Not(Stop(X)).
Fast(X) :- Sees(X, Y), IsRival(Y, X), IsClose(X, Y), Not(Stop(X)).
";
    let (world, _) = world_of(RULES, |scenario| multiply(scenario, 20), Drawn::all());
    let mut cities = executors(&world);
    assert_eq!(cities[2].threads(), 2);
    go_the_same_way(&mut cities, 5);
}

#[test]
fn a_function_is_called_once_per_tick() {
    let external = Drawn::all();
    let (world, _) = world_of("Stop(X) :- IsGreen(X).", |_| (), Arc::clone(&external));
    let mut city = simulation(&world, Executor::Auto, 1);
    assert_eq!(external.calls(), [0; 0]);
    // Before the first tick, the present facts are those of that tick.
    let before = city.facts(|_| true).unwrap();
    for _ in 0..3 {
        city.tick(&[]).unwrap();
        city.facts(|_| true).unwrap();
        city.snapshot().unwrap();
    }
    assert_eq!(external.calls(), [0, 1, 2]);
    let green = (world.vocabulary.predicates.iter()).position(|known| known.name == "IsGreen");
    let mut again = simulation(&world, Executor::Relational, 1);
    again.tick(&[]).unwrap();
    assert_eq!(again.facts(|_| true).unwrap().rows, before.rows);
    assert!(!before.rows[green.unwrap()].is_empty());
}

#[test]
fn a_function_that_fails_leaves_the_city_unchanged() {
    let external = Drawn::all();
    for executor in [Executor::Dense, Executor::Relational] {
        let (world, _) = world_of("Stop(X) :- IsGreen(X).", |_| (), Arc::clone(&external));
        let mut cities = [executor, executor].map(|executor| simulation(&world, executor, 1));
        go_the_same_way(&mut cities, 5);
        let [mut city, _] = cities;
        let (agents, report) = (format!("{:?}", city.agents()), city.report().agents.clone());
        let facts = city.facts(|_| true).unwrap();
        external.fails_from.store(5, Ordering::Relaxed);
        let fault = city.tick(&[]).unwrap_err();
        assert_eq!(fault.code.name(), "external-predicate");
        assert_eq!(
            fault.message,
            "the external predicates failed in tick 5: the light is broken"
        );
        assert_eq!((city.now(), format!("{:?}", city.agents())), (5, agents));
        assert_eq!(city.report().agents, report);
        assert_eq!(city.facts(|_| true).unwrap(), facts);
        external.fails_from.store(u64::MAX, Ordering::Relaxed);
        let mut other = simulation(&world, executor, 1);
        (0..5).for_each(|_| _ = other.tick(&[]).unwrap());
        go_the_same_way(&mut [city, other], 5);
    }
}

#[test]
fn traces_replay_without_the_functions() {
    let rules = "Stop(X) :- IsGreen(X), IsCar(X).\nSlow(X) :- IsRival(X, Y), Not(Stop(X)), previous IsGreen(Y).\n";
    let (world, sources) = world_of(rules, |_| (), Drawn::all());
    let (trace, facts) = record(&world, &sources, 30, |_| ());
    let externals = |facts: &logicity::sim::Facts| facts.rows.iter().map(Vec::len).sum::<usize>();
    assert!(facts.iter().map(externals).sum::<usize>() > 1000);
    let (without, _) = configured(CONFIG, &format!("{DECLARED}{rules}"), |_| ());
    let mut again = simulation(&world, Executor::Relational, 1);
    replay(&without, &trace, &facts, |replay, _| {
        let report = again.tick(&[]).unwrap();
        for (agent, done) in report.agents.iter().enumerate() {
            assert_eq!(replay.derived(agent), done.derived);
        }
    });
    // A tick without the facts, as of another configuration.
    let line = trace.lines().nth(1).unwrap().replace("\"IsRival\"", "\"IsOther\"");
    let mut header: serde_json::Value = serde_json::from_str(trace.lines().next().unwrap()).unwrap();
    (header["version"], header["rules"]) = (1.into(), "rules.dl".into());
    let header = logicity::sim::TraceHeader::read(&header.to_string()).unwrap();
    let mut replay = logicity::sim::Replay::new(without, &header).unwrap();
    let fault = replay.set(&TraceTick::read(&line).unwrap()).unwrap_err();
    assert_eq!(fault.message, "tick 0 does not record the external predicate `IsRival`");
}

#[test]
fn cities_without_the_functions_are_refused() {
    let refused = |external: Option<Arc<Drawn>>| {
        let (mut world, _) = configured(CONFIG, &format!("{DECLARED}Stop(X) :- IsGreen(X)."), |_| ());
        if let Some(external) = external {
            Arc::get_mut(&mut world).unwrap().set_external(external)?;
        }
        Simulation::new(world, Split::Test, Seed(0), Settings::default()).map(|_| ())
    };
    let message = |external| refused(external).unwrap_err().message;
    assert_eq!(message(None), "no function computes `IsGreen`, `IsRival`");
    assert_eq!(message(Some(Drawn::of(&["IsGreen"]))), "no function computes `IsRival`");
    let unknown = refused(Some(Drawn::of(&["IsGren"]))).unwrap_err();
    assert_eq!(
        unknown.message,
        "`IsGren` is no external predicate of the configuration `mine`"
    );
    assert_eq!(unknown.help, ["did you mean `IsGreen`?"]);
    let twice = message(Some(Drawn::of(&["IsGreen", "IsGreen"])));
    assert_eq!(twice, "two functions are given for the predicate `IsGreen`");
    refused(Some(Drawn::all())).unwrap();
}

#[test]
fn scenes_state_external_predicates() {
    const RULES: &str = "Stop(X) :- IsGreen(X).\nFast(X) :- IsRival(X, Y), IsGreen(Y), Not(Stop(X)).";
    let (world, _) = configured(CONFIG, &format!("{DECLARED}{RULES}"), |_| ());
    let scene = |given: &str| {
        format!(
            r#"{{"map": "square-5x5", "agents": [{{"id": "Car_1", "type": "Car", "at": [102, 20]}},
            {{"id": "Car_2", "type": "Car", "at": [102, 23]}}]{given}}}"#
        )
    };
    for executor in [Executor::Dense, Executor::Relational] {
        let given = r#", "given": {"IsGreen": ["Car_2"], "IsRival": [["Car_1", "Car_2"]]}"#;
        let found = answer(&world, executor, BuiltinFiles, &scene(given)).unwrap();
        assert_eq!(found["egos"]["Car_1"]["action"], "Fast");
        assert_eq!(found["egos"]["Car_2"]["action"], "Stop");
        let fault = answer(&world, executor, BuiltinFiles, &scene("")).unwrap_err();
        assert!(
            fault.contains("the scene does not state the external predicate `IsGreen`"),
            "{fault}"
        );
        let fault = answer(&world, executor, BuiltinFiles, &scene(r#", "given": {"IsGreen": []}"#)).unwrap_err();
        assert!(
            fault.contains(r#""given": {"IsRival": [["Car_1", "Car_2"]]}"#),
            "{fault}"
        );
        let symbols = r#"{"entities": ["e0", "e1"], "ego": "e0", "facts": {
            "IsRival": [["e0", "e1"]], "IsGreen": ["e1"]}}"#;
        let found = answer(&world, executor, BuiltinFiles, symbols).unwrap();
        assert_eq!(found["egos"]["e0"]["action"], "Fast");
    }
}

#[test]
fn observers_decide_on_external_predicates_as_sessions_do() {
    let mut derived = 0;
    for case in 0..6 {
        let rules = random_rules(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        // Reading an action makes the monitor evaluate the rules twice.
        let apart = [".decl Halts(x: agent)\nHalts(X) :- Stop(X).\n", ""][case as usize % 2];
        let (world, _) = world_of(&(rules + apart), |_| (), Drawn::all());
        let oracle = Arc::new(Oracle::new(Arc::clone(&world), 6).unwrap());
        // Observations contain the facts.
        Decider::new(Arc::clone(&oracle)).unwrap();
        derived += observers_derive_as_sessions_do(&oracle, &world, 12);
    }
    assert!(derived > 300, "{derived}");
}

/// Vectors on threads give the observations of single environments, which contain the facts.
#[test]
fn environments_observe_external_predicates() {
    const RULES: &str = "Stop(X) :- IsGreen(X), IsAtInter(X).\nSlow(X) :- IsRival(X, Y), Not(Stop(X)).\n";
    let (world, sources) = world_of(RULES, |_| (), Drawn::all());
    let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).unwrap());
    let columns = task.oracle().columns().into_iter().scan(0, |start, column| {
        let first = *start;
        *start += column.width;
        Some((column.predicate, first, column.width))
    });
    let names = &world.vocabulary.predicates;
    let columns: Vec<_> = columns
        .filter(|(predicate, ..)| names[*predicate].definition.is_external())
        .collect();
    assert_eq!(columns.iter().map(|(.., width)| *width).collect::<Vec<_>>(), [5, 25]);
    let (count, width) = (40, task.observation_width());
    for (view, width) in [
        (ObservationKind::Groundings, width),
        (
            ObservationKind::State,
            ObservationKind::State.shape(&task).iter().product(),
        ),
    ] {
        let mut vectors = [1, 2].map(|threads| {
            let sources = (0..count).map(|seed| EpisodeSource::new(seed, None));
            VectorEnv::new(
                &task,
                (Split::Train, ControlMode::First),
                sources,
                Autoreset::NextStep,
                view,
                threads,
            )
            .unwrap()
        });
        let mut rows = [0, 1].map(|_| vec![0.0; count as usize * width]);
        for (vector, rows) in vectors.iter_mut().zip(&mut rows) {
            vector
                .reset(&vec![Some(logicity::task::spf::Begin::Next); count as usize], rows)
                .unwrap();
        }
        let mut held = 0;
        for step in 0..30 {
            assert_eq!(rows[0], rows[1], "step {step}");
            if view == ObservationKind::Groundings {
                for &(_, start, width_of) in &columns {
                    let ones = rows[0].chunks_exact(width).map(|row| &row[start..start + width_of]);
                    held += ones.flatten().filter(|value| **value > 0.5).count();
                }
            }
            for (vector, rows) in vectors.iter_mut().zip(&mut rows) {
                vector
                    .step(&vec![Action::STANDARD[step % 4]; count as usize], rows)
                    .unwrap();
            }
        }
        assert!(view == ObservationKind::State || held > 500, "{held}");
    }
    // The oracle reads them, too.
    let mut env = Env::new(Arc::clone(&task), Split::Train, ControlMode::Egos).unwrap();
    env.reset(1).unwrap();
    let wanted: std::collections::BTreeSet<&str> = (0..env.controlled_cars().len())
        .map(|car| env.oracle_action(car).name())
        .collect();
    assert!(wanted.len() > 1, "{wanted:?}");
}
