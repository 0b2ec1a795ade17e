//! Safe Path Following: what is observed, wanted, judged and rewarded.

mod recorded_cases;
mod shipped_world;

use flate2::read::GzDecoder;
use logicity::city::{Agent, Cell, Heading, field_of_view};
use logicity::config::{AgentConfig, AgentKind, Speed, Split};
use logicity::diag::{Code, Diagnostic, Sources};
use logicity::files::read_or_builtin;
use logicity::lang::{Literal, Rules, Term};
use logicity::rng::Seed;
use logicity::sim::{Chance, Entity, Observer, Settings, Simulation, World, ground};
use logicity::task::path::{
    Baseline, Egos, Env, EpisodeSet, Exam, PathTask, Policy, RANDOM_RUNS, Rollout, describe, rollout,
};
use proptest::prelude::*;
use serde_json::Value as Json;
use shipped_world::{PATH_MODES, task, task_of};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::sync::Arc;

/// From every recorded state of the published environment: observation, wanted action, reward and violation are the recorded ones.
#[test]
fn recorded_steps() {
    for mode in ["easy", "hard"] {
        let Some(folder) = recorded_cases::folder() else {
            return;
        };
        let file = File::open(folder.join(format!("gym_{mode}.jsonl.gz"))).unwrap();
        let lines = BufReader::new(GzDecoder::new(file));
        let task = task(mode, None);
        let world = task.world();
        let mut city = Simulation::new(Arc::clone(world), Split::Test, Seed(0), Settings::default()).unwrap();
        let mut observer = Observer::new(Arc::clone(task.oracle()), 0);
        let mut out = vec![0.0; task.observation_width()];
        let mut steps = 0;
        for line in lines.lines() {
            let step: Json = serde_json::from_str(&line.unwrap()).unwrap();
            let Some(recorded) = step["agents"].as_array() else {
                if step["meta"] == true {
                    assert_eq!(step["obs_dim"], task.observation_width());
                }
                continue;
            };
            let mut agents: Vec<Agent> = recorded
                .iter()
                .zip(city.agents())
                .map(|(agent, like)| placed(agent, like, world))
                .collect();
            city.restart(Seed(0), &mut agents);
            observer.begin(&city);
            let ones: BTreeSet<usize> = step["obs_ones"].as_array().unwrap().iter().map(index).collect();
            let entities: Vec<usize> = step["ents"]
                .as_array()
                .unwrap()
                .iter()
                .map(|id| index(id) - 3)
                .collect();
            let drawn = Recorded {
                task: &task,
                entities: &entities,
                ones: &ones,
            };
            observer.look_with(&city, &drawn);

            assert_eq!(observer.entities().collect::<Vec<_>>(), entities, "{mode} step {steps}");
            observer.write(&mut out);
            let written: BTreeSet<usize> = (0..out.len()).filter(|&at| out[at] == 1.0).collect();
            assert_eq!(written, ones, "{mode} step {steps}");
            let derived = observer.derived(&city).unwrap();
            let wanted = world.vocabulary.decide(derived);
            assert_eq!(wanted, Speed::ALL[index(&step["expert"])], "{mode} step {steps}");
            let action = Speed::ALL[index(&step["action"])];
            let broken = observer.broken(&city, action).unwrap().to_vec();
            assert_eq!(
                !broken.is_empty(),
                step["fail"].as_bool().unwrap(),
                "{mode} step {steps}"
            );
            let reward = task.reward(action, &broken, index(&step["path_length4"]) / 4);
            let expected = step["reward"].as_f64().unwrap();
            assert!(
                (reward - expected).abs() < 1e-6,
                "{mode} step {steps}: {reward}, recorded {expected}"
            );
            steps += 1;
        }
        assert!(steps > 200, "{mode}: {steps} steps");
    }
}

fn index(json: &Json) -> usize {
    usize::try_from(json.as_u64().unwrap()).unwrap()
}

/// An agent in a recorded state.
fn placed(recorded: &Json, like: &Agent, world: &World) -> Agent {
    let cell = |key: &str| {
        let pair: Vec<i32> = recorded[key]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| i32::try_from(n.as_i64().unwrap()).unwrap())
            .collect();
        Cell::new(pair[0], pair[1])
    };
    let config = AgentConfig {
        name: like.name(),
        concepts: recorded["concepts"]
            .as_array()
            .unwrap()
            .iter()
            .map(|name| name.as_str().unwrap().to_owned())
            .collect(),
        priority: i32::try_from(recorded["pri"].as_i64().unwrap()).unwrap(),
    };
    let route = world.router.plan(like.kind, cell("start"), cell("goal")).unwrap();
    let mut agent = Agent::new(&config, route);
    agent.cell = cell("pos");
    agent.heading = recorded["dir"]
        .as_str()
        .map(|name| Heading::ALL.into_iter().find(|heading| heading.name() == name).unwrap());
    agent
}

/// The draws of the published program, read off the recorded observation.
struct Recorded<'a> {
    task: &'a PathTask,
    entities: &'a [usize],
    ones: &'a BTreeSet<usize>,
}

impl Chance for Recorded<'_> {
    fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
        let n = self.task.oracle().entities();
        let columns = self.task.oracle().columns();
        let base: usize = columns
            .take_while(|(before, _)| *before != predicate)
            .map(|(_, width)| width)
            .sum();
        let place = |agent| self.entities.iter().position(|&entity| entity == agent).unwrap();
        self.ones.contains(&(base + n * place(first) + place(second)))
    }
}

/// Facts about what one agent observes, straight from the definitions.
struct Plain {
    entities: Vec<usize>,
    facts: BTreeSet<(String, Vec<usize>)>,
}

/// Draws as a simulation does: only predicates with a chance ask, and the observer's answer is trusted for those.
struct Trusted<'a>(&'a BTreeSet<(usize, Vec<usize>)>);

impl Chance for Trusted<'_> {
    fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
        self.0.contains(&(predicate, vec![first, second]))
    }
}

impl Plain {
    fn new(city: &Simulation, ego: usize, most: usize, drawn: &BTreeSet<(usize, Vec<usize>)>) -> Plain {
        let world = city.world();
        let agents = city.agents();
        let field = field_of_view(agents[ego].cell, agents[ego].heading, world.scenario.view, world.map());
        let others = (0..agents.len()).filter(|&other| other != ego && field.contains(agents[other].cell));
        let entities: Vec<usize> = std::iter::once(ego).chain(others).take(most).collect();
        let all: Vec<Entity<'_>> = agents
            .iter()
            .map(|agent| Entity {
                kind: agent.kind,
                concepts: &agent.concepts,
                priority: agent.priority,
                at: agent.cell,
                heading: agent.heading,
            })
            .collect();
        let vocabulary = &world.vocabulary;
        let facts = ground(
            vocabulary,
            world.map(),
            world.scenario.view,
            &all,
            &Trusted(drawn),
            |_| false,
        );
        let mut known = BTreeSet::new();
        for (predicate, rows) in vocabulary.predicates.iter().zip(&facts.rows) {
            for row in rows {
                let row: Vec<usize> = row[..predicate.arity].iter().map(|&agent| agent as usize).collect();
                if row.iter().all(|agent| entities.contains(agent)) {
                    known.insert((predicate.name.clone(), row));
                }
            }
        }
        Plain { entities, facts: known }
    }

    /// Whether a body holds for the ego, trying all entities for all variables. Actions hold as `given`.
    fn holds(&self, rules: &Rules, clause: usize, given: Speed) -> bool {
        let clause = &rules.clauses[clause];
        let mut values = vec![self.entities[0]; clause.variables.len()];
        let head = match clause.head.terms[0] {
            Term::Variable(variable) => variable.index(),
            ref other => panic!("{other:?}"),
        };
        self.some(rules, &clause.body, &mut values, 0, head, given)
    }

    fn some(
        &self,
        rules: &Rules,
        body: &[Literal],
        values: &mut Vec<usize>,
        next: usize,
        head: usize,
        given: Speed,
    ) -> bool {
        if next == values.len() {
            return body.iter().all(|literal| self.is_true(rules, literal, values, given));
        }
        if next == head {
            return self.some(rules, body, values, next + 1, head, given);
        }
        self.entities.iter().any(|&entity| {
            values[next] = entity;
            self.some(rules, body, values, next + 1, head, given)
        })
    }

    fn is_true(&self, rules: &Rules, literal: &Literal, values: &[usize], given: Speed) -> bool {
        let atom = literal.atom().expect("rules of the city");
        let name = &rules.relations[atom.relation.index()].name;
        let term = |term: &Term| match term {
            Term::Variable(variable) => values[variable.index()],
            other => panic!("{other:?}"),
        };
        let row: Vec<usize> = atom.terms.iter().map(term).collect();
        let holds = match Speed::ALL.iter().any(|speed| speed.name() == name) {
            true => row[0] == self.entities[0] && given.name() == name,
            false => self.facts.contains(&(name.clone(), row)),
        };
        holds != matches!(literal, Literal::Negative(_))
    }

    /// What is derived for the ego: strata in their order, so that each negation looks at what is finished.
    fn derived(&self, rules: &Rules) -> BTreeSet<&'static str> {
        let mut actions: BTreeSet<&'static str> = BTreeSet::new();
        for stratum in &rules.strata {
            let before = actions.clone();
            for clause in &stratum.clauses {
                let body = &rules.clauses[clause.index()].body;
                let head = &rules.relations[rules.clauses[clause.index()].head.relation.index()].name;
                let open = body.iter().all(|literal| {
                    let name = literal
                        .atom()
                        .map_or("", |atom| &rules.relations[atom.relation.index()].name);
                    !Speed::ALL.iter().any(|speed| speed.name() == name) || !before.contains(name)
                });
                // Without any action given every negated one holds, which `open` has looked after.
                let quiet: Vec<Literal> = body
                    .iter()
                    .filter(|literal| {
                        let name = literal
                            .atom()
                            .map_or("", |atom| &rules.relations[atom.relation.index()].name);
                        !Speed::ALL.iter().any(|speed| speed.name() == name)
                    })
                    .cloned()
                    .collect();
                let clause = &rules.clauses[clause.index()];
                let mut values = vec![self.entities[0]; clause.variables.len()];
                let Term::Variable(variable) = clause.head.terms[0] else {
                    panic!("a head without a variable")
                };
                if open && self.some(rules, &quiet, &mut values, 0, variable.index(), Speed::Stop) {
                    actions.extend(Speed::ALL.iter().map(|speed| speed.name()).filter(|name| name == head));
                }
            }
        }
        actions
    }
}

/// Rules that mean the same and that the dense executor cannot take.
fn relational(task: &PathTask) -> String {
    let rules = task
        .world()
        .scenario
        .rules
        .value
        .file_name()
        .unwrap()
        .to_str()
        .unwrap()
        .to_owned();
    format!(".include \"rules/{rules}\"\nStop(X) :- IsCar(X), IsPedestrian(X), IsCar(Y), X != Y.\n")
}

/// Rules that mean the same, but a body asks for an action in passing: what is wanted and what is broken are evaluated apart.
fn apart(task: &PathTask) -> String {
    let rules = &task.world().scenario.rules.value;
    let rules = rules.file_name().unwrap().to_str().unwrap();
    format!(".include \"rules/{rules}\"\n.decl Halts(x: agent)\nHalts(X) :- Stop(X).\n")
}

/// Observations, wanted actions and broken clauses are those of the definitions, by either executor and in one evaluation or two, for any
/// agent as the ego.
#[test]
fn observers_agree_with_the_definitions() {
    for &mode in PATH_MODES {
        let plain_task = task(mode, None);
        let other = task(mode, Some(&relational(&plain_task)));
        let twice = task(mode, Some(&apart(&plain_task)));
        let world = plain_task.world();
        let rules = world.program.rules();
        let n = plain_task.oracle().entities();
        let mut seen = [0; 4];
        for seed in 0..3 {
            let mut city = Simulation::new(Arc::clone(world), Split::Test, Seed(seed), Settings::default()).unwrap();
            let egos = 0..city.agents().len();
            let observers = |task: &PathTask| -> Vec<Observer> {
                egos.clone()
                    .map(|ego| Observer::new(Arc::clone(task.oracle()), ego))
                    .collect()
            };
            let others = observers(&other).into_iter().zip(observers(&twice));
            let mut pairs: Vec<(Observer, (Observer, Observer))> =
                observers(&plain_task).into_iter().zip(others).collect();
            for (dense, (slow, twice)) in &mut pairs {
                dense.begin(&city);
                slow.begin(&city);
                twice.begin(&city);
            }
            for _ in 0..12 {
                for (ego, (dense, (slow, twice))) in pairs.iter_mut().enumerate() {
                    dense.look(&city);
                    slow.look(&city);
                    twice.look(&city);
                    let atoms: BTreeSet<(usize, Vec<usize>)> = dense.atoms().collect();
                    assert_eq!(atoms, slow.atoms().collect());
                    let plain = Plain::new(&city, ego, n, &atoms);
                    assert_eq!(dense.entities().collect::<Vec<_>>(), plain.entities);
                    let name = |predicate: usize| world.vocabulary.predicates[predicate].name.clone();
                    let named: BTreeSet<_> = atoms
                        .into_iter()
                        .map(|(predicate, row)| (name(predicate), row))
                        .collect();
                    let expected: BTreeSet<_> =
                        plain.facts.iter().filter(|(name, _)| name != "Sees").cloned().collect();
                    assert_eq!(named, expected, "{mode} seed {seed} ego {ego}");

                    let derived = dense.derived(&city).unwrap();
                    assert_eq!(derived, slow.derived(&city).unwrap());
                    assert_eq!(derived, twice.derived(&city).unwrap());
                    let mut expected = plain.derived(rules);
                    if expected.len() == 1 {
                        expected.remove("Normal");
                    }
                    assert_eq!(
                        derived.iter().map(Speed::name).collect::<BTreeSet<_>>(),
                        expected,
                        "{mode} {seed} {ego}"
                    );
                    for action in Speed::ALL {
                        let broken = dense.broken(&city, action).unwrap().to_vec();
                        let demands = plain_task.oracle().demands().iter().enumerate();
                        let expected: Vec<usize> = demands
                            .filter(|(_, demand)| {
                                demand.action != action && plain.holds(rules, demand.clause.index(), action)
                            })
                            .map(|(position, _)| position)
                            .collect();
                        assert_eq!(broken, expected, "{mode} seed {seed} ego {ego} {action:?}");
                        // The clauses of the included file come first.
                        assert_eq!(broken, slow.broken(&city, action).unwrap());
                        assert_eq!(broken, twice.broken(&city, action).unwrap());
                        seen[action as usize] += broken.len();
                    }
                }
                city.tick(&[]).unwrap();
            }
        }
        assert!(seen.iter().any(|broken| *broken > 0), "{mode} breaks nothing");
    }
}

/// The recorded episodes of all modes and splits are solved by the oracle as recorded, and break no rule.
#[test]
fn recorded_episodes() {
    for &mode in PATH_MODES {
        let task = task(mode, None);
        for split in Split::ALL {
            let mut sources = Sources::new();
            let set = EpisodeSet::load(&task, split, &mut sources, &read_or_builtin)
                .unwrap_or_else(|fault| panic!("{fault:?}"));
            assert_eq!(set.config, mode);
            assert_eq!(set.episodes.len(), if split == Split::Val { 40 } else { 100 });
            let mut env = Env::new(Arc::clone(&task), split, Egos::First).unwrap();
            let mut asked = [0; 4];
            for (number, episode) in set.episodes.iter().enumerate() {
                env.reset_to(episode).unwrap();
                let done = rollout(&mut env, Policy::Oracle).unwrap();
                let oracle = episode.oracle.as_ref().unwrap();
                let context = format!("{mode} {} {number}", split.name());
                assert!(
                    done.success && done.broken.is_empty() && done.constrained.iter().any(|steps| *steps > 0),
                    "{context}"
                );
                assert_eq!(
                    (done.steps, done.constrained),
                    (oracle.steps, oracle.constrained),
                    "{context}"
                );
                assert!((done.total - oracle.total).abs() < 1e-9, "{context}");
                assert_eq!(env.horizon(), 2 * oracle.steps);
                for (asked, steps) in asked.iter_mut().zip(done.constrained) {
                    *asked += usize::from(steps > 0);
                }
            }
            let of = |action: Speed| task.oracle().demands().iter().any(|demand| demand.action == action);
            for action in Speed::ALL.into_iter().filter(|action| of(*action)) {
                assert!(
                    asked[action as usize] >= 6,
                    "{mode} {}: {action:?} is asked in {asked:?}",
                    split.name()
                );
            }
        }
    }
}

/// The first recorded episodes of a split.
fn some_recorded(task: &PathTask, split: Split, count: usize) -> EpisodeSet {
    let mut set = EpisodeSet::load(task, split, &mut Sources::new(), &read_or_builtin).unwrap();
    set.episodes.truncate(count);
    set
}

/// Side by side, episodes go as one after the other.
#[test]
fn an_exam_goes_as_its_episodes_would_alone() {
    let task = task("expert", None);
    let set = some_recorded(&task, Split::Val, 6);
    for policy in [
        Policy::Oracle,
        Policy::Always(Speed::Normal),
        Policy::Always(Speed::Stop),
    ] {
        let mut exam = Exam::new(&task, &set).unwrap();
        while exam.running().any(|running| running) {
            let act = |env: &Env| match policy {
                Policy::Always(action) => action,
                _ => env.oracle_action(0),
            };
            let actions: Vec<Speed> = exam.envs().iter().map(act).collect();
            exam.step(&actions).unwrap();
        }
        let mut env = Env::new(Arc::clone(&task), Split::Val, Egos::First).unwrap();
        let alone = set.episodes.iter().map(|episode| {
            env.reset_to(episode).unwrap();
            rollout(&mut env, policy).unwrap()
        });
        assert_eq!(exam.rollouts(), alone.collect::<Vec<Rollout>>(), "{policy:?}");
    }
}

#[test]
fn the_random_policy_is_the_zero_of_scores() {
    let task = task("easy", None);
    let set = some_recorded(&task, Split::Val, 3);
    let mut env = Env::new(Arc::clone(&task), Split::Val, Egos::First).unwrap();
    let mut drive = || {
        let mut baseline = Baseline::default();
        for episode in &set.episodes {
            baseline.add(&mut env, episode).unwrap();
        }
        baseline
    };
    let baseline = drive();
    assert_eq!(baseline.rollouts().len(), 3 * usize::from(RANDOM_RUNS));
    let [first, ..] = baseline.returns() else {
        panic!("three returns")
    };
    let of_first = baseline.rollouts()[..RANDOM_RUNS.into()]
        .iter()
        .map(|rollout| rollout.total);
    assert!((first - of_first.sum::<f64>() / f64::from(RANDOM_RUNS)).abs() < 1e-12);
    let score = baseline.summary(&task).score.unwrap();
    assert!(
        score.value.abs() < 1e-9 && score.low < 0.0 && score.high > 0.0,
        "{score:?}"
    );
    let runs = |episode: usize| &baseline.rollouts()[10 * episode..10 * episode + 10];
    assert!(
        runs(0).iter().any(|run| run != &runs(0)[0]),
        "each run has draws of its own"
    );
    assert_eq!(drive().rollouts(), baseline.rollouts());
}

/// What a step tells, for comparison.
fn told(env: &Env) -> (Vec<f32>, f64, bool, bool) {
    let mut out = vec![0.0; env.task().observation_width()];
    env.observe(0, &mut out);
    let last = env.riders()[0].last();
    (out, last.reward, last.terminated, last.truncated)
}

#[test]
fn an_episode_can_be_begun_again() {
    let task = task("expert", None);
    let mut env = Env::new(Arc::clone(&task), Split::Train, Egos::First).unwrap();
    let mut other = Env::new(task, Split::Train, Egos::First).unwrap();
    for seed in 0..40 {
        env.reset(seed).unwrap();
        other.reset(seed + 1).unwrap();
        let episode = env.episode().clone();
        other.reset_to(&episode).unwrap();
        assert_eq!((other.episode(), other.horizon()), (&episode, env.horizon()));
        for step in 0..60 {
            assert_eq!(told(&env), told(&other), "seed {seed} step {step}");
            if !env.riders()[0].is_running() {
                break;
            }
            let action = if step % 7 == 3 {
                Speed::Slow
            } else {
                env.oracle_action(0)
            };
            env.step(&[action]).unwrap();
            other.step(&[action]).unwrap();
        }
    }
}

#[test]
fn the_horizon_cuts_an_episode_short() {
    let mut env = Env::new(task("easy", None), Split::Train, Egos::First).unwrap();
    env.reset(1).unwrap();
    let cells = env.riders()[0].cells();
    env.set_horizon(9);
    let done = rollout(&mut env, Policy::Always(Speed::Stop)).unwrap();
    assert!(done.truncated && !done.success && done.broken.is_empty());
    assert_eq!(done.steps, 9);
    #[allow(clippy::cast_precision_loss)]
    let expected = 9.0 * -5.0 / (4.0 * cells as f64) - 3.0;
    assert!((done.total - expected).abs() < 1e-12, "{} {expected}", done.total);
}

#[test]
fn every_car_can_be_driven() {
    let task = task("expert", None);
    let mut env = Env::new(Arc::clone(&task), Split::Test, Egos::Cars).unwrap();
    env.reset(3).unwrap();
    assert_eq!(env.riders().len(), 10);
    let mut ended = 0;
    for _ in 0..200 {
        let running: Vec<bool> = env.riders().iter().map(|rider| rider.is_running()).collect();
        let actions: Vec<Speed> = (0..10)
            .map(|rider| {
                if rider == 2 {
                    Speed::Fast
                } else {
                    env.oracle_action(rider)
                }
            })
            .collect();
        env.step(&actions).unwrap();
        for (position, was) in running.into_iter().enumerate() {
            let rider = &env.riders()[position];
            assert!(was || !rider.is_running());
            // Also of a car whose episode has ended the present is told.
            let mut alone = Observer::new(Arc::clone(task.oracle()), rider.agent());
            alone.begin(env.city());
            alone.look(env.city());
            assert!(alone.atoms().eq(rider.observer().atoms()));
            assert!(alone.entities().eq(rider.observer().entities()));
            let derived = alone.derived(env.city()).unwrap();
            assert_eq!(derived, rider.derived());
            let wanted = task.world().vocabulary.decide(derived);
            assert_eq!(env.oracle_action(position), wanted);
            assert!(describe(&env, position).ends_with(&format!("the rules want {}\n", wanted.name())));
            let mut shown = vec![0.5; task.observation_width()];
            let mut expected = shown.clone();
            env.observe(position, &mut shown);
            alone.write(&mut expected);
            assert_eq!(shown, expected);
        }
        ended = env.riders().iter().filter(|rider| !rider.is_running()).count();
    }
    assert!(ended > 3, "{ended} have ended");
    assert!(!env.riders()[2].last().success, "racing breaks a rule");
}

/// The oracle's steps are those of the first car; the others have the horizon of the configuration.
#[test]
fn the_horizon_of_an_episode_is_that_of_who_is_driven() {
    let task = task("expert", None);
    let episode = &some_recorded(&task, Split::Test, 1).episodes[0];
    let steps = episode.oracle.as_ref().unwrap().steps;
    for (egos, horizon) in [(Egos::First, 2 * steps), (Egos::Cars, task.config().horizon)] {
        let mut env = Env::new(Arc::clone(&task), Split::Test, egos).unwrap();
        env.reset_to(episode).unwrap();
        assert_eq!(env.horizon(), horizon, "{egos:?}");
    }
    assert_ne!(2 * steps, task.config().horizon);
}

/// The fault of a configuration made of `text`.
fn fault_of(text: &str) -> Diagnostic {
    let faults = task_of(text).err().unwrap_or_default();
    faults
        .into_iter()
        .next()
        .unwrap_or_else(|| panic!("no fault in {text}"))
}

#[test]
fn faulty_tasks_are_told() {
    let fault = |task: &str| fault_of(&format!("base: configs/expert.yaml\ntask: {task}\n"));
    assert_eq!(fault("~").code, Code::MissingKey);
    assert_eq!(fault("{entities: 0}").code, Code::InvalidValue);
    assert_eq!(fault("{reward: {violation: .nan}}").code, Code::InvalidValue);
    assert_eq!(fault("{reward: {violations_per: rule}}").code, Code::InvalidValue);
    assert_eq!(fault("{horison: 3}").code, Code::UnknownKey);
    assert_eq!(fault("{ego: {concepts: [{weight: 0}]}}").code, Code::InvalidValue);
    assert_eq!(
        fault("{ego: {concepts: [{weight: 1, concepts: [old]}]}}").code,
        Code::InvalidValue
    );
    let unknown = fault("{reward: {clauses: {S17: -1}}}");
    assert_eq!(unknown.code, Code::InvalidValue);
    assert!(
        unknown.primary.is_some() && unknown.help[0].contains("S1"),
        "{unknown:?}"
    );
}

#[test]
fn clauses_can_have_weights_of_their_own() {
    let text = "base: configs/expert.yaml\ntask: {reward: {violations_per: PER, clauses: {S1: -20, S7: -1}}}\n";
    for (per, expected) in [
        ("action", [-20.0, -5.0, -1.0, -25.0]),
        ("clause", [-26.0, -5.0, -1.0, -25.0]),
    ] {
        let task = task_of(&text.replace("PER", per)).unwrap();
        let demand = |label: &str| (0..).find(|&demand| task.label(demand) == label).unwrap();
        let [s1, s2, s7, l1] = ["S1", "S2", "S7", "L1"].map(demand);
        let rewards =
            [vec![s1, s2, s7], vec![s2], vec![s7], vec![s1, l1]].map(|broken| task.reward(Speed::Normal, &broken, 10));
        assert_eq!(rewards, expected, "{per}");
        assert_eq!(task.reward(Speed::Stop, &[], 10), -3.0 / 40.0);
    }
}

/// What an agent of an episode carries is checked like an entry of an agent set.
#[test]
fn agents_of_episodes_are_what_predicates_can_tell() {
    let mut env = Env::new(task("expert", None), Split::Test, Egos::First).unwrap();
    env.reset(1).unwrap();
    let episode = env.episode().clone();
    let mut begun = |agent: usize, concepts: &[&str]| {
        let mut changed = episode.clone();
        changed.agents[agent].concepts = concepts.iter().map(|&name| name.to_owned()).collect();
        env.reset_to(&changed)
    };
    let kind = |agent: usize| episode.agents[agent].name.kind;
    let car = (0..).find(|&agent| kind(agent) == AgentKind::Car).unwrap();
    let walker = (0..).find(|&agent| kind(agent) == AgentKind::Pedestrian).unwrap();
    assert_eq!(
        begun(car, &["ambulance", "old"]).unwrap_err().code,
        Code::InvalidEpisode
    );
    for (agent, good) in [
        (car, &["ambulance"][..]),
        (car, &["bus", "tiro"]),
        (walker, &["old"]),
        (walker, &[]),
    ] {
        begun(agent, good).unwrap();
    }
    let bad = [
        (car, &["ambulnce"][..], "`ambulnce`", Some("did you mean `ambulance`?")),
        (car, &["zeppelin"], "`zeppelin`", Some("concepts of a car: ")),
        (walker, &["ambulance"], "concept of a car", None),
        (car, &["old"], "concept of a pedestrian", None),
        (car, &["bus", "tiro", "bus"], "`bus` is given twice", None),
    ];
    for (agent, concepts, message, help) in bad {
        let fault = begun(agent, concepts).unwrap_err();
        assert_eq!(fault.code, Code::InvalidEpisode, "{concepts:?}");
        assert!(fault.message.contains(message), "{fault:?}");
        assert!(
            fault.message.contains(&episode.agents[agent].name.to_string()),
            "{fault:?}"
        );
        assert!(help.is_none_or(|help| fault.help[0].starts_with(help)), "{fault:?}");
    }
}

fn set_of(text: &str) -> Result<EpisodeSet, Diagnostic> {
    let mut sources = Sources::new();
    let source = sources.add("mine.jsonl", text);
    EpisodeSet::read(&sources, source)
}

#[test]
fn faulty_episodes_are_told() {
    let header = r#"{"episodes":"logicity","version":1,"config":"x","split":"test","seed":0,"agents":[{"id":"Car_1","concepts":[],"priority":1}]}"#;
    let good = format!("{header}\n{{\"seed\":1,\"trips\":[[46,20,56,64]]}}\n");
    assert_eq!(set_of(&good).unwrap().episodes.len(), 1);
    let bad = [
        String::new(),
        "{}".to_owned(),
        header.to_owned(),
        header.replace("Car_1", "Car_01"),
        header.replace("test", "tset"),
        header.replace("\"version\":1", "\"version\":2"),
        good.replace("[46,20,56,64]", ""),
        good.replace("[46,20,56,64]", "[46,20,56]"),
        good.replace("\"seed\":1,", ""),
        good.replace(
            "\"seed\":1,",
            "\"seed\":1,\"changes\":{\"Car_2\":{\"concepts\":[],\"priority\":1}},",
        ),
        good.replace(
            "\"seed\":1,",
            "\"seed\":1,\"oracle\":{\"steps\":1,\"return\":0,\"constrained\":{\"Halt\":1}},",
        ),
    ];
    for text in bad {
        let fault = set_of(&text).expect_err(&text);
        assert_eq!(fault.code, Code::InvalidEpisode, "{text}");
        assert!(fault.primary.is_some(), "{text}");
    }
}

/// A key that is misspelt is told with its line; it is not passed over.
#[test]
fn unknown_keys_of_episodes_are_told() {
    let lines = [
        r#"{"episodes":"logicity","version":1,"config":"x","split":"test","seed":0,"agents":[{"id":"Car_1","concepts":[],"priority":1}]}"#,
        r#"{"seed":1,"trips":[[46,20,56,64]],"changes":{"Car_1":{"concepts":["bus"],"priority":2}},"oracle":{"steps":1,"return":0,"constrained":{}}}"#,
    ];
    let fault_of = |line: usize, from: &str, to: &str| {
        let mut lines = lines.map(str::to_owned);
        assert!(lines[line].contains(from), "{from}");
        lines[line] = lines[line].replace(from, to);
        let mut sources = Sources::new();
        let source = sources.add("mine.jsonl", lines.join("\n"));
        EpisodeSet::read(&sources, source).map_err(|fault| {
            let place = sources.position(fault.primary.as_ref().expect("a place").span);
            (place.line, fault)
        })
    };
    fault_of(0, "{", "{").unwrap();
    let (_, newer) = fault_of(0, "\"version\":1", "\"version\":2,\"weather\":0").unwrap_err();
    assert!(newer.message.contains("version 2; this program reads"), "{newer:?}");
    for (line, key) in [
        (0, "seed"),
        (0, "priority"),
        (1, "changes"),
        (1, "oracle"),
        (1, "priority"),
        (1, "constrained"),
    ] {
        let quoted = format!("\"{key}\"");
        let (at, fault) = fault_of(line, &quoted, &format!("\"x{key}\"")).unwrap_err();
        assert_eq!((fault.code, at), (Code::InvalidEpisode, line + 1), "{fault:?}");
        assert!(fault.message.contains(&format!("unknown field `x{key}`")), "{fault:?}");
        assert!(!fault.message.contains("line 1"), "{fault:?}");
    }
}

proptest! {
    /// Any text at all is read or refused, and what is written is read the same.
    #[test]
    fn episodes_are_read_as_they_are_written(text in ".{0,200}", seed in 0u64..1000) {
        let _ = set_of(&text);
        let mut env = Env::new(task("easy", None), Split::Val, Egos::First).unwrap();
        env.reset(seed).unwrap();
        let set = EpisodeSet { config: "easy".into(), split: Split::Val, seed, episodes: vec![env.episode().clone()] };
        let mut written = Vec::new();
        set.write(&mut written).unwrap();
        let text = String::from_utf8(written).unwrap();
        prop_assert_eq!(&set_of(&text).unwrap(), &set);
        prop_assert_eq!(set_of(&text).unwrap().hash(), set.hash());
    }
}
