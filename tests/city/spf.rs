//! Safe Path Following: observations, the oracle's actions, violations and rewards.

use crate::cases::cases;
use crate::shipped_world::{SPF_MODES, task, task_of};
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::field_of_view;
use logicity::city::{Action, ActionTable, AgentKind, KindTable, Split};
use logicity::datalog::{ClauseId, Literal, Rules, Term};
use logicity::diag::{Diagnostic, Sources};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Chance, Decider, Entity, Facts, Observer, Progress, Settings, Simulation, ground};
use logicity::task::spf::{
    self, Autoreset, Baseline, BatchEvaluator, Begin, ControlMode, Env, EpisodeSet, EpisodeSource, MapIdentity,
    ObservationKind, Policy, RANDOM_RUNS, Rate, Rollout, Score, SpfTask, VectorEnv, describe, rollout, summarize,
};
use logicity::yaml::codes;
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Facts about the entities that one agent observes, from the definitions.
struct Plain {
    entities: Vec<usize>,
    facts: BTreeSet<(String, Vec<usize>)>,
}

/// Draws as a simulation does. Only predicates with a chance draw; for those it takes the observer's value.
struct Trusted<'a>(&'a BTreeSet<(usize, Vec<usize>)>);

impl Chance for Trusted<'_> {
    fn tick(&self) -> u64 {
        0
    }

    fn word(&self) -> u64 {
        0
    }

    fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
        self.0.contains(&(predicate, vec![first, second]))
    }
}

/// All base facts of a city.
fn facts_of(city: &Simulation, chance: &impl Chance) -> Facts {
    let entities: Vec<Entity<'_>> = (city.agents().iter())
        .map(|agent| Entity {
            kind: agent.kind,
            concepts: &agent.concepts,
            priority: agent.priority,
            at: agent.cell,
            heading: agent.heading,
            progress: Progress::default(),
        })
        .collect();
    let world = city.world();
    let view = world.scenario.view;
    ground(&world.vocabulary, world.map(), view, &entities, chance, |_| false)
}

/// Names of actions.
type Actions = BTreeSet<&'static str>;

impl Plain {
    fn new(city: &Simulation, ego: usize, most: usize, drawn: &BTreeSet<(usize, Vec<usize>)>) -> Plain {
        let world = city.world();
        let agents = city.agents();
        let field = field_of_view(agents[ego].cell, agents[ego].heading, world.scenario.view, world.map());
        let others = (0..agents.len()).filter(|&other| other != ego && field.contains(agents[other].cell));
        let entities: Vec<usize> = std::iter::once(ego).chain(others).take(most).collect();
        let (vocabulary, facts) = (&world.vocabulary, facts_of(city, &Trusted(drawn)));
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

    /// Whether a body holds for the ego, by trying all entities for all variables. Of the actions, only `given` of the
    /// ego hold.
    fn holds(&self, rules: &Rules, clause: usize, given: &Actions) -> bool {
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
        given: &Actions,
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

    fn is_true(&self, rules: &Rules, literal: &Literal, values: &[usize], given: &Actions) -> bool {
        let atom = literal.atom().expect("rules of the city");
        let name = &rules.predicates[atom.predicate.index()].name;
        let term = |term: &Term| match term {
            Term::Variable(variable) => values[variable.index()],
            other => panic!("{other:?}"),
        };
        let row: Vec<usize> = atom.terms.iter().map(term).collect();
        let holds = match Action::STANDARD.iter().any(|action| action.name() == name) {
            true => row[0] == self.entities[0] && given.contains(name.as_str()),
            false => self.facts.contains(&(name.clone(), row)),
        };
        holds != matches!(literal, Literal::Negative(_))
    }

    /// The actions derived for the ego before the default. Evaluates the strata in order, each to its fixpoint, so that
    /// negation reads complete predicates.
    fn derived(&self, rules: &Rules) -> Actions {
        let mut derived = Actions::new();
        for stratum in &rules.strata {
            loop {
                let fires = |clause: &&ClauseId| self.holds(rules, clause.index(), &derived);
                let head = |clause: &ClauseId| rules.clauses[clause.index()].head.predicate.index();
                let names = stratum
                    .clauses
                    .iter()
                    .filter(fires)
                    .map(|clause| &rules.predicates[head(clause)].name);
                let actions = |name| {
                    Action::STANDARD
                        .iter()
                        .map(|action| action.name())
                        .find(|action| action == name)
                };
                let new: Actions = names
                    .filter_map(actions)
                    .filter(|name| !derived.contains(name))
                    .collect();
                if new.is_empty() {
                    break;
                }
                derived.extend(new);
            }
        }
        if derived.len() == 1 {
            derived.remove("Normal");
        }
        derived
    }

    /// The clauses that an action violates.
    fn violations(&self, task: &SpfTask, action: Action) -> Vec<usize> {
        let (rules, given) = (task.world().program.rules(), Actions::from([action.name()]));
        let constraints = task.oracle().constraints().iter().enumerate();
        constraints
            .filter(|(_, constraint)| {
                constraint.action != action && self.holds(rules, constraint.clause.index(), &given)
            })
            .map(|(position, _)| position)
            .collect()
    }
}

/// The rules of a task.
fn rules_of(task: &SpfTask) -> String {
    let rules = &task.world().scenario.rules.value;
    let rules = rules.file_name().unwrap().to_str().unwrap();
    format!(".include \"rules/{rules}\"\n")
}

/// Appends a clause to the rules that changes no action but that the dense executor cannot evaluate.
fn relational(rules: &str) -> String {
    format!("{rules}Stop(X) :- IsCar(X), IsPedestrian(X), IsCar(Y), X != Y.\n")
}

/// Appends a clause to the rules that changes no action but whose body reads an action, so that the monitor needs two
/// evaluations: one for wanted actions and one for violated clauses.
fn apart(rules: &str) -> String {
    format!("{rules}.decl Halts(x: agent)\nHalts(X) :- Stop(X).\n")
}

/// Observations, wanted actions and violated clauses equal those of the definitions for every ego, with either executor
/// and with one evaluation or two. Decisions on the written observations are the same.
#[test]
fn observers_agree_with_the_definitions() {
    for &mode in SPF_MODES {
        let plain_task = task(mode, None);
        let other = task(mode, Some(&relational(&rules_of(&plain_task))));
        let twice = task(mode, Some(&apart(&rules_of(&plain_task))));
        let world = plain_task.world();
        let rules = world.program.rules();
        let n = plain_task.oracle().entities();
        let mut seen = [0; 4];
        let mut observation = vec![0.0; plain_task.oracle().width()];
        let mut deciders = [&plain_task, &other, &twice].map(|task| Decider::new(Arc::clone(task.oracle())).unwrap());
        for seed in 0..3 {
            let mut city = Simulation::new(Arc::clone(world), Split::Test, Seed(seed), Settings::default()).unwrap();
            let egos = 0..city.agents().len();
            let observers = |task: &SpfTask| -> Vec<Observer> {
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
                    dense.look(&city).unwrap();
                    slow.look(&city).unwrap();
                    twice.look(&city).unwrap();
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
                    dense.write(&mut observation);
                    let action = world.vocabulary.decide(Some(AgentKind::Car.into()), derived);
                    for decider in &mut deciders {
                        assert_eq!(decider.action(&observation, &Cancel::never()).unwrap(), action);
                    }
                    assert_eq!(
                        derived.iter().map(Action::name).collect::<Actions>(),
                        plain.derived(rules),
                        "{mode} {seed} {ego}"
                    );
                    for action in Action::STANDARD {
                        let broken = dense.violations(&city, action).unwrap().to_vec();
                        let expected = plain.violations(&plain_task, action);
                        assert_eq!(broken, expected, "{mode} seed {seed} ego {ego} {action:?}");
                        // Clauses of the included file come first.
                        assert_eq!(broken, slow.violations(&city, action).unwrap());
                        assert_eq!(broken, twice.violations(&city, action).unwrap());
                        seen[action.index()] += broken.len();
                    }
                }
                city.tick(&[]).unwrap();
            }
        }
        assert!(seen.iter().any(|broken| *broken > 0), "{mode} breaks nothing");
    }
}

/// Random clauses with actions in their bodies. The actions of the head's agent, negated or not, come earlier in a
/// random order; or all are positive and recursive.
fn random_clauses(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 10] = [
        "IsTiro(X)",
        "Not(IsBus(X))",
        "Not(IsAtInter(X))",
        "IsReckless(X)",
        "IsAtInter(Y)",
        "Not(IsInInter(Y)), Sees(X, Y)",
        "HigherPri(Y, X)",
        "IsClose(X, Y)",
        "NextTo(X, Y), IsPedestrian(Y)",
        "CollidingClose(X, Y)",
    ];
    let mut order = ["Stop", "Slow", "Fast"];
    for last in (1..order.len()).rev() {
        order.swap(last, random.random_range(0..=last));
    }
    let circular = random.random_range(0..6) == 0;
    let mut clauses = Vec::new();
    for (rank, head) in order.into_iter().chain(["Normal"]).enumerate() {
        let asked = match circular {
            true if head != "Normal" => &order[..],
            _ => &order[..rank],
        };
        for _ in 0..random.random_range(0..4) {
            let mut body =
                vec![["IsCar(X)", "IsPedestrian(X)"][usize::from(random.random_range(0..4) == 0)].to_owned()];
            for fact in 0..random.random_range(0..3) {
                let fact_of = FACTS[random.random_range(0..FACTS.len())];
                // Each with its own variable.
                body.push(fact_of.replace('Y', &format!("Y{fact}")));
            }
            for action in asked {
                match random.random_range(0..if circular { 2 } else { 4 }) {
                    0 => body.push(format!("{action}(X)")),
                    2 => body.push(format!("Not({action}(X))")),
                    _ => {}
                }
            }
            clauses.push(format!("{head}(X) :- {}.\n", body.join(", ")));
        }
    }
    for last in (1..clauses.len()).rev() {
        clauses.swap(last, random.random_range(0..=last));
    }
    format!(".include \"rules/vocabulary.dl\"\n{}", clauses.concat())
}

/// Wanted actions and violations of random clauses are the same with one evaluation, two, the relational executor, and
/// the definitions.
#[test]
fn slow_violations_of_random_clauses_agree_with_the_definitions() {
    const CASES: u64 = 48;
    let shipped = task("expert", None);
    let cities: Vec<Simulation> = (0..4)
        .map(|seed| {
            let world = Arc::clone(shipped.world());
            let mut city = Simulation::new(world, Split::Test, Seed(seed), Settings::default()).unwrap();
            for _ in 0..10 + 7 * seed {
                city.tick(&[]).unwrap();
            }
            city
        })
        .collect();
    let n = shipped.oracle().entities();
    let (mut several, mut chains, mut broke) = (0, 0, [0; 4]);
    for case in 0..CASES {
        let text = random_clauses(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        let once = task("expert", Some(&text));
        let others = [apart(&text), relational(&text)].map(|text| task("expert", Some(&text)));
        let rules = once.world().program.rules();
        let actions = |clause: &ClauseId| {
            let body = rules.clauses[clause.index()].body.iter();
            let name = |literal: &Literal| Some(rules.predicates[literal.atom()?.predicate.index()].name.clone());
            body.filter_map(name)
                .filter(|name| Action::STANDARD.iter().any(|action| action.name() == name))
                .count()
        };
        for city in &cities {
            for ego in 0..city.agents().len() {
                let observe = |task: &Arc<SpfTask>| {
                    let mut observer = Observer::new(Arc::clone(task.oracle()), ego);
                    observer.begin(city);
                    observer.look(city).unwrap();
                    observer
                };
                let [mut once_of, mut apart_of, mut relational_of] = [&once, &others[0], &others[1]].map(observe);
                let plain = Plain::new(city, ego, n, &once_of.atoms().collect());
                let derived = once_of.derived(city).unwrap();
                let named: Actions = derived.iter().map(Action::name).collect();
                assert_eq!(named, plain.derived(rules), "case {case} ego {ego}\n{text}");
                assert_eq!(
                    derived,
                    apart_of.derived(city).unwrap(),
                    "case {case} ego {ego}\n{text}"
                );
                assert_eq!(
                    derived,
                    relational_of.derived(city).unwrap(),
                    "case {case} ego {ego}\n{text}"
                );
                several += usize::from(named.len() > 1);
                for action in Action::STANDARD {
                    let broken = once_of.violations(city, action).unwrap();
                    assert_eq!(
                        broken,
                        plain.violations(&once, action),
                        "case {case} ego {ego} {action:?}\n{text}"
                    );
                    assert_eq!(
                        broken,
                        apart_of.violations(city, action).unwrap(),
                        "case {case} {ego} {action:?}\n{text}"
                    );
                    assert_eq!(
                        broken,
                        relational_of.violations(city, action).unwrap(),
                        "case {case} {ego} {action:?}\n{text}"
                    );
                    broke[action.index()] += broken.len();
                    let constraints = broken
                        .iter()
                        .map(|&constraint| once.oracle().constraints()[constraint].clause);
                    chains += constraints.filter(|clause| actions(clause) > 1).count();
                }
            }
        }
    }
    assert!(
        several > 100 && chains > 100 && broke.iter().all(|broke| *broke > 100),
        "{several} {chains} {broke:?}"
    );
}

/// Compares the exact observation, number by number, with the agents and the definitions of predicates.
#[test]
fn exact_observations_agree_with_the_definitions() {
    let mut met = [0; 4];
    for (mode, rows) in [("easy", 32), ("expert", 32), ("expert", 3)] {
        let task = task_of(&format!("base: configs/{mode}.yaml\ntask: {{state_agents: {rows}}}\n"));
        let task = Arc::new(task.unwrap_or_else(|faults| panic!("{faults:?}")));
        let scenario = &task.world().scenario;
        let priorities = (scenario.splits.iter()).flat_map(|(_, set)| set.entries().map(|group| group.priority));
        let of_ego = task
            .config()
            .ego
            .iter()
            .flat_map(|ego| ego.priority)
            .map(u32::cast_signed);
        let scale = priorities.chain(of_ego).max().unwrap();
        let [room, width] = task.state_shape();
        let unary = (task.world().vocabulary.predicates.iter()).filter(|predicate| predicate.arity == 1);
        assert_eq!([room, width], [rows, 8 + unary.count()]);
        let mut env = Env::new(Arc::clone(&task), Split::Test, ControlMode::Egos).unwrap();
        let mut random = Seed(5).stream(Purpose::POLICY, 0, 0);
        for seed in 0..3 {
            env.reset(seed).unwrap();
            let mut episode = env.episode().clone();
            for agent in &mut episode.agents {
                agent.priority = random.random_range(-2 * scale..=2 * scale);
            }
            env.reset_to(&episode).unwrap();
            let mut shown = vec![0.5; room * width];
            for _ in 0..25 {
                for controlled_car in 0..env.controlled_cars().len() {
                    env.observe_state(controlled_car, &mut shown);
                    let plain = plain_state(env.city(), env.controlled_cars()[controlled_car].agent(), scale);
                    let (rows, rest) = shown.split_at(plain.len().min(room) * width);
                    assert_eq!(
                        rows,
                        plain[..plain.len().min(room)].concat(),
                        "{mode} {seed} {controlled_car}"
                    );
                    assert!(rest.iter().all(|number| *number == 0.0));
                    met[0] += usize::from(plain.len() > room);
                    met[1] += usize::from(!rest.is_empty());
                    met[2] += plain.iter().filter(|row| row[7] == -1.0).count();
                    met[3] += plain.iter().filter(|row| row[3..7] == [0.0; 4]).count();
                }
                let actions: Vec<Action> = (env.controlled_cars().iter())
                    .map(|_| Action::STANDARD[random.random_range(0..4)])
                    .collect();
                env.step(&actions).unwrap();
            }
        }
    }
    assert!(met.iter().all(|count| *count > 10), "{met:?}");
}

/// The `state` rows of all agents in the ego's view, the ego first.
#[allow(clippy::cast_precision_loss)]
fn plain_state(city: &Simulation, ego: usize, scale: i32) -> Vec<Vec<f32>> {
    let (world, agents) = (city.world(), city.agents());
    let (view, vocabulary) = (world.scenario.view, &world.vocabulary);
    let facts = facts_of(city, &Trusted(&BTreeSet::new()));
    let field = field_of_view(agents[ego].cell, agents[ego].heading, view, world.map());
    let seen = (0..agents.len()).filter(|&other| other != ego && field.contains(agents[other].cell));
    let row_of = |agent: usize| {
        let [it, me] = [&agents[agent], &agents[ego]];
        let share = |cells: i32| cells as f32 / view as f32;
        let mut row = vec![1.0, share(it.cell.row - me.cell.row), share(it.cell.col - me.cell.col)];
        for name in ["Left", "Right", "Up", "Down"] {
            row.push(f32::from(u8::from(
                it.heading.is_some_and(|heading| heading.name() == name),
            )));
        }
        row.push((it.priority as f32 / scale as f32).clamp(-1.0, 1.0));
        for (predicate, rows) in vocabulary.predicates.iter().zip(&facts.rows) {
            if predicate.arity == 1 {
                let holds = rows.iter().any(|row| row[0] as usize == agent);
                row.push(f32::from(u8::from(holds)));
            }
        }
        row
    };
    std::iter::once(ego).chain(seen).map(row_of).collect()
}

/// The oracle solves the recorded episodes of all modes and splits as recorded, and violates no rule.
#[test]
fn slow_recorded_episodes() {
    for &mode in SPF_MODES {
        let task = task(mode, None);
        for split in Split::ALL {
            let mut sources = Sources::new();
            let set =
                EpisodeSet::load(&task, split, &mut sources, &BuiltinFiles).unwrap_or_else(|fault| panic!("{fault:?}"));
            assert_eq!(set.config, mode);
            assert_eq!(set.episodes.len(), if split == Split::Val { 40 } else { 100 });
            let mut env = Env::new(Arc::clone(&task), split, ControlMode::First).unwrap();
            let mut asked = [0; Action::MAX];
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
                    (done.steps, &done.constrained_by_name(task.world().vocabulary.actions())),
                    (oracle.steps, &oracle.constrained),
                    "{context}"
                );
                assert!((done.total - oracle.total).abs() < 1e-9, "{context}");
                assert_eq!(env.horizon(), 2 * oracle.steps);
                for (asked, steps) in asked.iter_mut().zip(done.constrained) {
                    *asked += usize::from(steps > 0);
                }
            }
            let of = |action: Action| {
                task.oracle()
                    .constraints()
                    .iter()
                    .any(|constraint| constraint.action == action)
            };
            for action in Action::STANDARD.into_iter().filter(|action| of(*action)) {
                assert!(
                    asked[action.index()] >= 6,
                    "{mode} {}: {action:?} occurs in {asked:?}",
                    split.name()
                );
            }
        }
    }
}

/// The first recorded episodes of a split.
fn some_recorded(task: &SpfTask, split: Split, count: usize) -> EpisodeSet {
    let mut set = EpisodeSet::load(task, split, &mut Sources::new(), &BuiltinFiles).unwrap();
    set.episodes.truncate(count);
    set
}

/// Episodes evaluated in one batch equal episodes evaluated alone.
#[test]
fn a_batch_evaluation_equals_single_episodes() {
    let task = task("expert", None);
    let set = some_recorded(&task, Split::Val, 6);
    for policy in [
        Policy::Oracle,
        Policy::Always(Action::Normal),
        Policy::Always(Action::Stop),
    ] {
        let mut evaluator = BatchEvaluator::new(&task, &set).unwrap();
        while evaluator.running().any(|running| running) {
            let act = |env: &Env| match policy {
                Policy::Always(action) => action,
                _ => env.oracle_action(0),
            };
            let actions: Vec<Action> = evaluator.envs().iter().map(act).collect();
            evaluator.step(&actions).unwrap();
        }
        let mut env = Env::new(Arc::clone(&task), Split::Val, ControlMode::First).unwrap();
        let alone = set.episodes.iter().map(|episode| {
            env.reset_to(episode).unwrap();
            rollout(&mut env, policy).unwrap()
        });
        assert_eq!(evaluator.rollouts(), alone.collect::<Vec<Rollout>>(), "{policy:?}");
    }
}

#[test]
fn the_random_policy_scores_zero() {
    let task = task("easy", None);
    let set = some_recorded(&task, Split::Val, 3);
    let mut env = Env::new(Arc::clone(&task), Split::Val, ControlMode::First).unwrap();
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
    let summary = baseline.summary(&task);
    let score = summary.score.unwrap();
    assert_eq!([score.value, score.low, score.high], [0.0; 3]);
    assert_eq!((summary.tsr.episodes, summary.tsr.runs), (3, 30));
    // An episode counts once for the interval of the mean.
    assert_eq!(summary.mean_return, Score::of(baseline.returns().iter().copied()));
    let runs = |episode: usize| &baseline.rollouts()[10 * episode..10 * episode + 10];
    assert!(
        runs(0).iter().any(|run| run != &runs(0)[0]),
        "each run has its own draws"
    );
    assert_eq!(drive().rollouts(), baseline.rollouts());
}

/// The rule compliance rate leaves out the runs without a constrained step; the decision success rate counts them.
#[test]
#[allow(clippy::cast_precision_loss)]
fn compliance_counts_only_runs_with_a_constrained_step() {
    let task = task("easy", None);
    let run = |stops: u32, broken: &[usize]| Rollout {
        constrained: std::array::from_fn(|action| if action == Action::Stop.index() { stops } else { 0 }),
        broken: broken.to_vec(),
        success: broken.is_empty(),
        ..Rollout::default()
    };
    let rollouts = [run(2, &[]), run(1, &[0]), run(0, &[]), run(0, &[]), run(7, &[])];
    let summary = summarize(&task, &rollouts, None);
    let rate = |hits: usize, runs: usize| Rate::of((0..runs).map(|run| [usize::from(run < hits), 1]));
    assert_eq!(summary.tsr, rate(4, 5));
    assert_eq!(summary.dsr, rate(2, 5));
    assert_eq!(summary.compliance, rate(2, 3));
    let nothing = summarize(&task, &rollouts[2..4], None);
    assert_eq!(
        (nothing.tsr.value, nothing.dsr.value, nothing.compliance.runs),
        (1.0, 0.0, 0)
    );
}

/// The result of a step, for comparison.
fn observed(env: &Env) -> (Vec<f32>, f64, bool, bool) {
    let mut out = vec![0.0; env.task().observation_width()];
    env.observe(0, &mut out);
    let last = env.controlled_cars()[0].last();
    (out, last.reward, last.terminated, last.truncated)
}

#[test]
fn an_episode_can_be_repeated() {
    let task = task("expert", None);
    let mut env = Env::new(Arc::clone(&task), Split::Train, ControlMode::First).unwrap();
    let mut other = Env::new(task, Split::Train, ControlMode::First).unwrap();
    for seed in 0..40 {
        env.reset(seed).unwrap();
        other.reset(seed + 1).unwrap();
        let episode = env.episode().clone();
        other.reset_to(&episode).unwrap();
        assert_eq!((other.episode(), other.horizon()), (&episode, env.horizon()));
        for step in 0..60 {
            assert_eq!(observed(&env), observed(&other), "seed {seed} step {step}");
            if !env.controlled_cars()[0].is_running() {
                break;
            }
            let action = if step % 7 == 3 {
                Action::Slow
            } else {
                env.oracle_action(0)
            };
            env.step(&[action]).unwrap();
            other.step(&[action]).unwrap();
        }
    }
}

#[test]
fn the_horizon_truncates_an_episode() {
    let mut env = Env::new(task("easy", None), Split::Train, ControlMode::First).unwrap();
    env.reset(1).unwrap();
    let cells = env.controlled_cars()[0].cells();
    env.set_horizon(9);
    let done = rollout(&mut env, Policy::Always(Action::Stop)).unwrap();
    assert!(done.truncated && !done.success && done.broken.is_empty());
    assert_eq!(done.steps, 9);
    #[allow(clippy::cast_precision_loss)]
    let expected = 9.0 * -5.0 / (4.0 * cells as f64) - 3.0;
    assert!((done.total - expected).abs() < 1e-12, "{} {expected}", done.total);
}

#[test]
fn every_car_can_be_driven() {
    let task = task("expert", None);
    let mut env = Env::new(Arc::clone(&task), Split::Test, ControlMode::Egos).unwrap();
    env.reset(3).unwrap();
    assert_eq!(env.controlled_cars().len(), 10);
    let mut ended = 0;
    for _ in 0..200 {
        let running: Vec<bool> = env
            .controlled_cars()
            .iter()
            .map(|controlled_car| controlled_car.is_running())
            .collect();
        let actions: Vec<Action> = (0..10)
            .map(|controlled_car| {
                if controlled_car == 2 {
                    Action::Fast
                } else {
                    env.oracle_action(controlled_car)
                }
            })
            .collect();
        env.step(&actions).unwrap();
        for (position, was) in running.into_iter().enumerate() {
            let controlled_car = &env.controlled_cars()[position];
            assert!(was || !controlled_car.is_running());
            // The description of a car whose episode has ended is current, too.
            let mut alone = Observer::new(Arc::clone(task.oracle()), controlled_car.agent());
            alone.begin(env.city());
            alone.look(env.city()).unwrap();
            assert!(alone.atoms().eq(controlled_car.observer().atoms()));
            assert!(alone.entities().eq(controlled_car.observer().entities()));
            let derived = alone.derived(env.city()).unwrap();
            assert_eq!(derived, controlled_car.derived());
            let wanted = task.world().vocabulary.decide(Some(AgentKind::Car.into()), derived);
            assert_eq!(env.oracle_action(position), wanted);
            assert!(describe(&env, position).ends_with(&format!("the rules want {}\n", wanted.name())));
            let mut shown = vec![0.5; task.observation_width()];
            let mut expected = shown.clone();
            env.observe(position, &mut shown);
            alone.write(&mut expected);
            assert_eq!(shown, expected);
        }
        ended = env
            .controlled_cars()
            .iter()
            .filter(|controlled_car| !controlled_car.is_running())
            .count();
    }
    assert!(ended > 3, "{ended} have ended");
    assert!(!env.controlled_cars()[2].last().success, "racing breaks a rule");
}

/// The first car's horizon follows from the oracle's steps; other cars have that of the configuration.
#[test]
fn the_horizon_depends_on_the_controlled_car() {
    let task = task("expert", None);
    let episode = &some_recorded(&task, Split::Test, 1).episodes[0];
    let steps = episode.oracle.as_ref().unwrap().steps;
    for (egos, horizon) in [
        (ControlMode::First, 2 * steps),
        (ControlMode::Egos, task.config().horizon),
    ] {
        let mut env = Env::new(Arc::clone(&task), Split::Test, egos).unwrap();
        env.reset_to(episode).unwrap();
        assert_eq!(env.horizon(), horizon, "{egos:?}");
    }
    assert_ne!(2 * steps, task.config().horizon);
}

/// The fault of a configuration with this task.
fn fault_of(text: &str) -> Diagnostic {
    let faults = task_of(text).err().unwrap_or_default();
    faults
        .into_iter()
        .next()
        .unwrap_or_else(|| panic!("no fault in {text}"))
}

#[test]
fn faulty_tasks_are_reported() {
    let fault = |task: &str| fault_of(&format!("base: configs/expert.yaml\ntask: {task}\n"));
    assert_eq!(fault("~").code, codes::MISSING_KEY);
    assert_eq!(fault("{entities: 0}").code, codes::INVALID_VALUE);
    assert_eq!(fault("{reward: {violation: .nan}}").code, codes::INVALID_VALUE);
    assert_eq!(fault("{reward: {violations_per: rule}}").code, codes::INVALID_VALUE);
    assert_eq!(fault("{horison: 3}").code, codes::UNKNOWN_KEY);
    assert_eq!(fault("{ego: {concepts: [{weight: 0}]}}").code, codes::INVALID_VALUE);
    assert_eq!(
        fault("{ego: {concepts: [{weight: 1, concepts: [old]}]}}").code,
        codes::INVALID_VALUE
    );
    let unknown = fault("{reward: {clauses: {S17: -1}}}");
    assert_eq!(unknown.code, codes::INVALID_VALUE);
    assert!(
        unknown.primary.is_some() && unknown.help[0].contains("S1"),
        "{unknown:?}"
    );
}

#[test]
fn clauses_can_have_their_own_weights() {
    let text = "base: configs/expert.yaml\ntask: {reward: {violations_per: PER, clauses: {S1: -20, S7: -1}}}\n";
    for (per, expected) in [
        ("action", [-20.0, -5.0, -1.0, -25.0]),
        ("clause", [-26.0, -5.0, -1.0, -25.0]),
    ] {
        let task = task_of(&text.replace("PER", per)).unwrap();
        let constraint = |label: &str| (0..).find(|&constraint| task.label(constraint) == label).unwrap();
        let [s1, s2, s7, l1] = ["S1", "S2", "S7", "L1"].map(constraint);
        let rewards =
            [vec![s1, s2, s7], vec![s2], vec![s7], vec![s1, l1]].map(|broken| task.reward(Action::Normal, &broken, 10));
        assert_eq!(rewards, expected, "{per}");
        assert_eq!(task.reward(Action::Stop, &[], 10), -3.0 / 40.0);
    }
}

/// Concepts of an episode's agents are checked as those of an agent set.
#[test]
fn agents_of_episodes_have_known_concepts() {
    let mut env = Env::new(task("expert", None), Split::Test, ControlMode::First).unwrap();
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
        spf::codes::INVALID_EPISODE
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
        (car, &["bus", "tiro", "bus"], "has the concept `bus` twice", None),
    ];
    for (agent, concepts, message, help) in bad {
        let fault = begun(agent, concepts).unwrap_err();
        assert_eq!(fault.code, spf::codes::INVALID_EPISODE, "{concepts:?}");
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
    EpisodeSet::read(&sources, source, &KindTable::default(), &ActionTable::default())
}

#[test]
fn faulty_episodes_are_reported() {
    let header = r#"{"episodes":"logicity","version":1,"config":"x","split":"test","map":{"name":"m","hash":"0"},"seed":0,"agents":[{"id":"Car_1","concepts":[],"priority":1}]}"#;
    let good = format!("{header}\n{{\"seed\":1,\"trips\":[[46,20,56,64]]}}\n");
    assert_eq!(set_of(&good).unwrap().episodes.len(), 1);
    let bad = [
        String::new(),
        "{}".to_owned(),
        header.to_owned(),
        header.replace("Car_1", "Car_01"),
        header.replace("test", "tset"),
        header.replace(r#""map":{"name":"m","hash":"0"},"#, ""),
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
        assert_eq!(fault.code, spf::codes::INVALID_EPISODE, "{text}");
        assert!(fault.primary.is_some(), "{text}");
    }
}

/// An unknown key is an error with a line.
#[test]
fn unknown_keys_of_episodes_are_reported() {
    let lines = [
        r#"{"episodes":"logicity","version":1,"config":"x","split":"test","map":{"name":"m","hash":"0"},"seed":0,"agents":[{"id":"Car_1","concepts":[],"priority":1}]}"#,
        r#"{"seed":1,"trips":[[46,20,56,64]],"changes":{"Car_1":{"concepts":["bus"],"priority":2}},"oracle":{"steps":1,"return":0,"constrained":{}}}"#,
    ];
    let fault_of = |line: usize, from: &str, to: &str| {
        let mut lines = lines.map(str::to_owned);
        assert!(lines[line].contains(from), "{from}");
        lines[line] = lines[line].replace(from, to);
        let mut sources = Sources::new();
        let source = sources.add("mine.jsonl", lines.join("\n"));
        EpisodeSet::read(&sources, source, &KindTable::default(), &ActionTable::default()).map_err(|fault| {
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
        assert_eq!((fault.code, at), (spf::codes::INVALID_EPISODE, line + 1), "{fault:?}");
        assert!(fault.message.contains(&format!("unknown field `x{key}`")), "{fault:?}");
        assert!(!fault.message.contains("line 1"), "{fault:?}");
    }
}

proptest! {
    #![proptest_config(cases(256))]

    /// Any text parses or gives an error, and written episodes parse to the same values.
    #[test]
    fn written_episodes_parse_to_the_same_values(text in ".{0,200}", seed in 0u64..1000) {
        let _ = set_of(&text);
        let mut env = Env::new(task("easy", None), Split::Val, ControlMode::First).unwrap();
        env.reset(seed).unwrap();
        let map = MapIdentity::of(env.task().world().map());
        let episodes = vec![env.episode().clone()];
        let set = EpisodeSet { config: "easy".into(), split: Split::Val, map, seed, episodes };
        let mut written = Vec::new();
        set.write(&mut written).unwrap();
        let text = String::from_utf8(written).unwrap();
        prop_assert_eq!(&set_of(&text).unwrap(), &set);
        prop_assert_eq!(set_of(&text).unwrap().hash(), set.hash());
    }
}

/// The steps of an episode.
struct ShapedEpisode {
    /// By step: the covered shares before and after, the end (terminated, truncated, success), reward and shaping.
    steps: Vec<([f64; 2], [bool; 3], f64, f64)>,
}

/// Runs an episode in which each action is the oracle's with probability 0.9, and random otherwise.
fn shaped_episode(env: &mut Env, seed: u64) -> ShapedEpisode {
    env.reset(seed).unwrap();
    let mut random = Seed(seed).stream(Purpose::POLICY, 0, 0);
    let mut steps = Vec::new();
    while env.controlled_cars()[0].is_running() {
        let wanted = env.oracle_action(0);
        let action = match random.random_range(0..10) {
            0 if seed.is_multiple_of(2) => Action::STANDARD[random.random_range(0..4)],
            _ => wanted,
        };
        let before = env.progress(0);
        env.step(&[action]).unwrap();
        let last = env.controlled_cars()[0].last();
        assert_eq!(last.shaped_reward(), last.reward + last.shaping);
        let end = [last.terminated, last.truncated, last.success];
        steps.push(([before, env.progress(0)], end, last.reward, last.shaping));
    }
    ShapedEpisode { steps }
}

const SHAPED: &str = "base: configs/easy.yaml\ntask:\n  horizon: 60\n  reward: ";

#[test]
fn reward_terms_agree_with_their_definitions() {
    let shaped = |reward: &str| {
        let task = Arc::new(task_of(&format!("{SHAPED}{reward}\n")).unwrap());
        Env::new(task, Split::Train, ControlMode::First).unwrap()
    };
    let mut plain = shaped("{}");
    let (mut goals, mut violations, mut truncations) = (0, 0, 0);
    for (reward, progress, goal, weight, gamma, remaining) in [
        ("{progress: 5}", 5.0, 0.0, 0.0, 0.0, true),
        ("{goal: 2.5}", 0.0, 2.5, 0.0, 0.0, true),
        ("{potential: {weight: 3}}", 0.0, 0.0, 3.0, 0.99, true),
        (
            "{potential: {weight: 4, of: progress, gamma: 0.5}}",
            0.0,
            0.0,
            4.0,
            0.5,
            false,
        ),
        (
            "{progress: -1, goal: 7, potential: {weight: 2, gamma: 1}}",
            -1.0,
            7.0,
            2.0,
            1.0,
            true,
        ),
    ] {
        let mut env = shaped(reward);
        for seed in 0..30 {
            let run = shaped_episode(&mut env, seed).steps;
            let without = shaped_episode(&mut plain, seed).steps;
            assert_eq!(run.len(), without.len());
            // The potential of the published definition, and 0 in a terminal state.
            let phi = |covered: f64, terminal: bool| match (terminal, remaining) {
                (true, _) => 0.0,
                (_, true) => -weight * (1.0 - covered),
                (_, false) => weight * covered,
            };
            let (mut sum, mut discount) = (0.0, 1.0);
            for (&([before, after], [terminated, truncated, success], task_reward, shaping), bare) in
                run.iter().zip(&without)
            {
                assert_eq!((task_reward, 0.0), (bare.2, bare.3), "the reward of the task stays");
                let by_goal = if success { goal } else { 0.0 };
                let by_potential = gamma * phi(after, terminated) - phi(before, false);
                let expected = progress * (after - before) + by_goal + by_potential;
                assert!(
                    (shaping - expected).abs() < 1e-12,
                    "{reward} seed {seed}: {shaping} {expected}"
                );
                sum += discount * by_potential;
                discount *= gamma;
                goals += usize::from(success);
                violations += usize::from(terminated && !success);
                truncations += usize::from(truncated);
            }
            // The discounted sum of the potential's terms depends on the first state alone, except at the horizon.
            if run.last().unwrap().1[0] {
                assert!((sum + phi(0.0, false)).abs() < 1e-9, "{reward} seed {seed}: {sum}");
            }
        }
    }
    assert!(
        goals > 20 && violations > 20 && truncations > 20,
        "{goals} {violations} {truncations}"
    );
}

#[test]
fn evaluations_have_no_reward_terms() {
    let mode = |reward: &str| {
        let text = format!("base: configs/expert.yaml\ntask: {{reward: {reward}}}\n");
        Arc::new(task_of(&text).unwrap())
    };
    let (shaped, plain) = (mode("{progress: 5, goal: 3, potential: {weight: 2}}"), mode("{}"));
    // The splits of validation and test have none, whatever steps through them.
    for split in [Split::Val, Split::Test] {
        let mut env = Env::new(Arc::clone(&shaped), split, ControlMode::First).unwrap();
        let steps = shaped_episode(&mut env, 3).steps;
        assert!(steps.iter().all(|step| step.3 == 0.0));
    }
    // A rollout sums the rewards of the task, also over episodes of training.
    for split in [Split::Train, Split::Test] {
        let set = some_recorded(&plain, split, 3);
        for episode in &set.episodes {
            let total = |task: &Arc<SpfTask>| {
                let mut env = Env::new(Arc::clone(task), split, ControlMode::First).unwrap();
                env.reset_to(episode).unwrap();
                rollout(&mut env, Policy::Oracle).unwrap().total
            };
            assert_eq!(total(&shaped), total(&plain));
            let oracle = episode.oracle.as_ref().unwrap().total;
            assert!((total(&shaped) - oracle).abs() < 1e-9, "{} {oracle}", total(&shaped));
        }
    }
}

#[test]
fn a_vector_and_every_car_get_the_reward_terms() {
    let task = Arc::new(task_of(&format!("{SHAPED}{{progress: 5, potential: {{weight: 2}}}}\n")).unwrap());
    let sources = (0..3).map(|seed| EpisodeSource::new(seed, None));
    let view = ObservationKind::Groundings;
    let mut vector = VectorEnv::new(
        &task,
        (Split::Train, ControlMode::First),
        sources,
        Autoreset::NextStep,
        view,
        2,
    )
    .unwrap();
    let mut rows = vec![0.0; 3 * vector.width()];
    vector.reset(&[const { Some(Begin::Next) }; 3], &mut rows).unwrap();
    for _ in 0..100 {
        vector.step(&[Action::Normal; 3], &mut rows).unwrap();
        for sub_env in vector.sub_envs() {
            let last = sub_env.env().controlled_cars()[0].last();
            let stepped = sub_env.env().steps() > 0;
            assert_eq!(
                sub_env.outcome(0).reward,
                if stepped { last.shaped_reward() } else { 0.0 }
            );
        }
    }
    let mut env = Env::new(task, Split::Train, ControlMode::Egos).unwrap();
    env.reset(2).unwrap();
    let cars = env.controlled_cars().len();
    let before: Vec<f64> = (0..cars).map(|car| env.progress(car)).collect();
    env.step(&vec![Action::Normal; cars]).unwrap();
    for (car, before) in before.into_iter().enumerate() {
        let (last, after) = (env.controlled_cars()[car].last(), env.progress(car));
        let next = if last.terminated { 0.0 } else { -2.0 * (1.0 - after) };
        let expected = 5.0 * (after - before) + 0.99 * next + 2.0 * (1.0 - before);
        assert!((last.shaping - expected).abs() < 1e-12, "{} {expected}", last.shaping);
    }
}

#[test]
fn faulty_reward_terms_are_reported() {
    let fault = |reward: &str| fault_of(&format!("{SHAPED}{reward}\n"));
    for (reward, message) in [
        ("{progress: high}", "a reward from -1e6 to 1e6"),
        ("{goal: 1e7}", "a reward from -1e6 to 1e6"),
        ("{potential: 5}", "the potential (a mapping)"),
        ("{potential: {weight: -1}}", "a weight from 0 to 1e6"),
        ("{potential: {gamma: 1.5}}", "a discount factor from 0 to 1"),
    ] {
        let fault = fault(reward);
        assert_eq!(fault.code, codes::INVALID_VALUE, "{reward}");
        assert!(fault.message.contains(message), "{reward}: {}", fault.message);
    }
    let near = |reward: &str| {
        let fault = fault(reward);
        fault.help.join(" ") + &fault.message
    };
    assert!(near("{potential: {of: remaning}}").contains("did you mean `remaining`?"));
    assert!(near("{progres: 5}").contains("`progress`"), "{}", near("{progres: 5}"));
    assert!(near("{potential: {gama: 0.9}}").contains("`gamma`"));
}
