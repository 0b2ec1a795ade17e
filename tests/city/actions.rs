//! Actions that a configuration defines: what they do to routes, and the messages about faulty ones.

use crate::agreement::{Counts, executors, record, replay, simulation};
use crate::config::{load_memory, refused};
use crate::shipped_world::configured;
use logicity::cancel::Cancel;
use logicity::city::{Action, AgentKind, Heading, MoveReason, Split};
use logicity::diag::Sources;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Executor, Simulation, World};
use logicity::task::spf::{ControlMode, Env, Episode, Policy, SpfTask, make_episodes, rollout};
use std::sync::Arc;

/// A city whose cars can turn, reroute and park.
const CONFIG: &str = "base: expert
task: ~
actions:
  define:
    TurnLeft: {cells: {Car: 2}, turn: left}
    TurnRight: {cells: {Car: 1}, turn: right}
    GoOn: {cells: {Car: 3}, turn: straight}
    Reroute: {cells: {Car: 1}, reroute: true}
    Park: {cells: {Car: 0, Pedestrian: 0}, park: 4}
  priority: [Stop, Park, TurnLeft, TurnRight, GoOn, Reroute, Slow, Fast, Normal]
";

const DECLARED: &str = ".include \"vocabulary.dl\"
.decl TurnLeft, TurnRight, GoOn, Reroute, Park(x: agent)
.output TurnLeft, TurnRight, GoOn, Reroute, Park
";

fn city(rules: &str) -> (Arc<World>, Sources) {
    configured(CONFIG, &format!("{DECLARED}{rules}"), |_| ())
}

/// Runs a city whose rules always derive one action for cars. Returns, for each car, its headings without repetitions
/// while it has one goal.
fn drives(action: &str) -> (Simulation, Vec<Vec<Heading>>) {
    let (world, _) = city(&format!("{action}(X) :- IsCar(X)."));
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut driven: Vec<Vec<Heading>> = vec![Vec::new(); city.agents().len()];
    for _ in 0..150 {
        city.tick(&[]).unwrap();
        for (agent, headings) in city.agents().iter().zip(&mut driven) {
            if agent.kind == AgentKind::Car
                && let Some(heading) = agent.heading
                && headings.last() != Some(&heading)
            {
                headings.push(heading);
            }
        }
    }
    (city, driven)
}

/// A car that always turns right drives around a block; one that goes straight on leaves the straight line only at the
/// edge of the map, where its route stays as it is.
#[test]
fn cars_turn_where_the_rules_say() {
    let (_, right) = drives("TurnRight");
    let (_, left) = drives("TurnLeft");
    let count = |driven: &[Vec<Heading>], is: fn(Heading) -> Heading| {
        let pairs = driven.iter().flat_map(|headings| headings.windows(2));
        let pairs: Vec<bool> = pairs.map(|pair| is(pair[0]) == pair[1]).collect();
        (pairs.iter().filter(|is| **is).count(), pairs.len())
    };
    let (turns, all) = count(&right, Heading::clockwise);
    assert!(all > 20 && turns * 10 > all * 8, "{turns} of {all} are right turns");
    let (turns, all) = count(&left, |heading| heading.clockwise().opposite());
    assert!(all > 20 && turns * 2 > all, "{turns} of {all} are left turns");
}

/// Every route that an action changes begins at the agent's cell, ends at its goal, and goes step by step.
#[test]
fn changed_routes_lead_to_the_same_goal() {
    for action in ["TurnLeft", "TurnRight", "GoOn", "Reroute"] {
        let (world, _) = city(&format!("{action}(X) :- IsCar(X), Not(Stop(X))."));
        let mut city = simulation(&world, Executor::Auto, 1);
        let mut changed = 0;
        for _ in 0..120 {
            let before = city.agents().to_vec();
            let report = city.tick(&[]).unwrap().clone();
            for ((done, agent), before) in report.agents.iter().zip(city.agents()).zip(&before) {
                if !done.moved.rerouted {
                    continue;
                }
                changed += 1;
                assert_eq!(agent.start(), done.moved.from);
                if !done.moved.replanned {
                    assert_eq!(agent.goal(), before.goal());
                }
                let cells: Vec<_> = agent.route().cells().collect();
                assert_eq!(cells.last(), Some(&agent.goal()));
                for pair in cells.windows(2) {
                    assert!(Heading::between(pair[0], pair[1]).is_some(), "{action}: {pair:?}");
                    assert_eq!(pair[0].row.abs_diff(pair[1].row) + pair[0].col.abs_diff(pair[1].col), 1);
                }
                assert!(cells.iter().all(|&cell| world.map().contains(cell)));
                // It reaches its goal by driving on.
                assert_eq!(agent.remaining() as usize + agent.position(), agent.route().steps());
            }
        }
        assert!(changed > 10, "{action} changed {changed} routes");
    }
}

#[test]
fn a_parked_agent_stands_whatever_the_rules_decide() {
    let (world, _) = city("Park(X) :- IsPedestrian(X).");
    let park = world.scenario.actions.table.find("Park").unwrap();
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut parked = 0;
    for _ in 0..40 {
        for done in &city.tick(&[]).unwrap().agents {
            if done.moved.reason == MoveReason::Parked {
                assert_eq!(done.moved.from, done.moved.to);
                assert_eq!(done.action, park);
                parked += 1;
            }
        }
    }
    let pedestrians = city
        .agents()
        .iter()
        .filter(|agent| agent.kind == AgentKind::Pedestrian)
        .count();
    assert!(
        parked >= 30 * pedestrians,
        "{parked} ticks of {pedestrians} pedestrians"
    );
    // It drives on after four ticks.
    let (world, sources) = self::city("");
    let mut city = simulation(&world, Executor::Auto, 1);
    city.tick(&[(0, park)]).unwrap();
    for tick in 1..6 {
        let done = city.tick(&[]).unwrap().agents[0];
        assert_eq!(done.moved.reason == MoveReason::Parked, tick < 4, "tick {tick}");
        assert_eq!(done.action, if tick < 4 { park } else { Action::Normal });
        let account = city.decision(0).unwrap().account(None, &Cancel::never()).unwrap();
        let text = account.text(&sources);
        let says = text.contains("it is parked since tick 0; the rules say Normal");
        assert_eq!(says, tick < 4, "{text}");
    }
}

#[test]
fn a_caller_imposes_only_actions_that_the_agent_can_take() {
    let (world, _) = city("");
    let turn = world.scenario.actions.table.find("TurnLeft").unwrap();
    let mut city = simulation(&world, Executor::Auto, 1);
    let walker = city
        .agents()
        .iter()
        .position(|agent| agent.kind == AgentKind::Pedestrian)
        .unwrap();
    let fault = city.tick(&[(walker, turn)]).unwrap_err();
    assert_eq!(fault.message, "Pedestrian_1 cannot take the action `TurnLeft`");
    assert_eq!(city.now(), 0);
    assert_eq!(city.tick(&[(0, turn)]).unwrap().agents[0].action, turn);
}

/// If the rules derive an action for agents that cannot take it, it does not count.
#[test]
fn agents_ignore_derived_actions_that_they_cannot_take() {
    let (world, _) = city("TurnLeft(X) :- IsPedestrian(X).\nSlow(X) :- IsPedestrian(X).");
    let mut city = simulation(&world, Executor::Auto, 1);
    let report = city.tick(&[]).unwrap().clone();
    for (done, agent) in report.agents.iter().zip(city.agents()) {
        let walks = agent.kind == AgentKind::Pedestrian;
        assert_eq!(done.action, if walks { Action::Slow } else { Action::Normal });
    }
}

/// Both executors, on one thread and on two, decide the same on random rules with all nine actions.
#[test]
fn executors_agree_on_random_rules_with_own_actions() {
    const FACTS: [&str; 6] = [
        "IsAtInter(X)",
        "IsBus(X)",
        "IsClose(X, Y)",
        "CollidingClose(X, Y)",
        "IsTiro(X)",
        "IsOld(X)",
    ];
    let mut taken = Counts::default();
    for case in 0..3_u64 {
        let mut random = Seed(case).stream(Purpose::TEST, 0, 0);
        let mut rules = String::new();
        for head in ["Stop", "Slow", "TurnLeft", "TurnRight", "GoOn", "Reroute", "Park"] {
            for _ in 0..random.random_range(1..3) {
                let fact = FACTS[random.random_range(0..FACTS.len())];
                let kind = ["IsCar(X)", "Not(IsBus(X))"][random.random_range(0..2)];
                rules += &format!("{head}(X) :- Sees(X, X), {kind}, {fact}.\n");
            }
        }
        let times = [1, 1, 20][case as usize];
        let (world, _) = configured(CONFIG, &format!("{DECLARED}{rules}"), |scenario| {
            if times > 1 {
                crate::agreement::multiply(scenario, times);
            }
        });
        taken.go_the_same_way(&mut executors(&world), if times < 20 { 40 } else { 3 });
    }
    assert!(
        taken.actions.iter().filter(|count| **count > 0).count() >= 6,
        "{taken:?}"
    );
}

/// A trace records changed routes and names the actions; its replay has the same facts and explains them.
#[test]
fn traces_record_own_actions_and_changed_routes() {
    let (world, sources) = city("TurnRight(X) :- IsCar(X), IsAtInter(X).\nReroute(X) :- IsBus(X).");
    let (trace, facts) = record(&world, &sources, 60, |_| ());
    assert!(
        trace.contains("\"action\":\"TurnRight\"") && trace.contains("\"route\":[["),
        "{}",
        &trace[..400]
    );
    let table = world.vocabulary.actions();
    let turn = table.find("TurnRight").unwrap();
    let lines: Vec<&str> = trace.lines().skip(1).collect();
    let mut derived = 0;
    replay(&world, &trace, &facts, |replay, tick| {
        let written: serde_json::Value = serde_json::from_str(lines[tick]).unwrap();
        for agent in 0..replay.agents().len() {
            let names: Vec<&str> = replay.derived(agent).iter().map(|action| table.name(action)).collect();
            assert_eq!(serde_json::json!(names), written["agents"][agent]["derived"]);
            derived += usize::from(replay.derived(agent).contains(turn));
        }
    });
    assert!(derived > 0);
    let mut city = simulation(&world, Executor::Auto, 1);
    city.tick(&[]).unwrap();
    let account = city.decision(0).unwrap().account(Some(turn), &Cancel::never()).unwrap();
    assert!(
        account.text(&sources).contains("TurnRight"),
        "{}",
        account.text(&sources)
    );
}

/// The text of each faulty `actions`, and what the message says.
const FAULTS: [(&str, &str); 14] = [
    (
        "define: {Turn: {cells: {Car: 1}}}",
        "expected each of `Slow`, `Normal`, `Fast`, `Stop`, `Turn` exactly once",
    ),
    (
        "define: {Turn: {cells: {Car: 1}}}",
        "add `Turn`: the first action in the list wins",
    ),
    ("define: {Turn: {cells: {}}}", "no agent can take `Turn`"),
    ("define: {Turn: {turn: left}}", "the key `cells` is missing"),
    (
        "define: {Turn: {cells: {Car: 4}}}",
        "expected a whole number from 0 to 3, found `4`",
    ),
    ("define: {Turn: {cells: {Tram: 1}}}", "unknown key `Tram`"),
    (
        "define: {Turn: {cells: {Car: 1}, turn: back}}",
        "expected one of `left`, `right`, `straight`, found `back`",
    ),
    (
        "define: {Turn: {cells: {Pedestrian: 1}, turn: left}}",
        "pedestrians have no lanes",
    ),
    (
        "define: {Turn: {cells: {Car: 1}, turn: left, reroute: true}}",
        "`Turn` has more than one of",
    ),
    (
        "define: {Park: {cells: {Car: 1}, park: 3}}",
        "an agent that parks does not move",
    ),
    ("define: {Fast: {cells: {Car: 1}}}", "`Fast` is a standard action"),
    (
        "define: {IsBus: {cells: {Car: 1}}}",
        "`IsBus` is both an action and a base predicate",
    ),
    ("define: {2nd: {cells: {Car: 1}}}", "expected the name of an action"),
    (
        "define: {Turn: {cells: {Car: 1}}}\n  priority: [Turn, Stop, Slow, Fast, Normal]\n  default: Turn",
        "a Pedestrian cannot take it",
    ),
];

#[test]
fn faulty_actions_have_messages_with_places() {
    for (actions, expected) in FAULTS {
        let message = refused(&format!("base: expert\ntask: ~\nactions:\n  {actions}\n"));
        assert!(message.contains(expected), "{actions}\n{message}");
    }
}

/// Environments have the actions of the configuration: the oracle takes them, another action violates the clause that
/// demands one, masks say so, and their rewards count.
#[test]
fn environments_have_own_actions() {
    let config = format!(
        "{}task: {{reward: {{actions: {{TurnRight: -7}}}}}}\n",
        CONFIG.replace("task: ~\n", "")
    );
    // The second rule set is for the relational executor: it counts.
    for more in [
        "",
        "Slow(X) :- IsBus(X), 2 < count : { Sees(X, Y) }, Not(TurnRight(X)).\n",
    ] {
        let rules = format!("{DECLARED}/// R1: turn\nTurnRight(X) :- IsCar(X), IsAtInter(X).\n{more}");
        let (world, sources) = configured(&config, &rules, |_| ());
        let table = &world.scenario.actions.table;
        let turn = table.find("TurnRight").unwrap();
        let park = table.find("Park").unwrap();
        let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).unwrap_or_else(|faults| panic!("{faults:?}")));
        assert_eq!(task.possible_actions().len(), 9);
        let mut env = Env::new(Arc::clone(&task), Split::Test, ControlMode::First).unwrap();
        env.judge_actions();
        let (mut turned, mut broken) = (0, 0);
        for seed in 0..12 {
            env.reset(seed).unwrap();
            while env.controlled_cars()[0].is_running() {
                let oracle = env.oracle_action(0);
                let car = &env.controlled_cars()[0];
                let allowed = car.allowed().unwrap();
                assert!(allowed.contains(oracle));
                let cells = car.cells();
                if oracle == turn {
                    assert!(!allowed.contains(park) && !allowed.contains(Action::Normal));
                    // Once, disobey.
                    let given = if seed % 3 == 0 { park } else { turn };
                    env.step(&[given]).unwrap();
                    let last = env.controlled_cars()[0].last();
                    match given == turn {
                        true => {
                            let reward = -7.0 / (4.0 * cells as f64);
                            assert!(
                                (last.reward - reward).abs() < 1e-12 || last.terminated,
                                "{}",
                                last.reward
                            );
                            turned += 1;
                        }
                        false => {
                            assert_eq!((last.broken.as_slice(), last.terminated), (&[0][..], true));
                            broken += 1;
                        }
                    }
                } else {
                    env.step(&[oracle]).unwrap();
                }
            }
        }
        assert!(turned > 3 && broken > 0, "{turned} {broken}");
        // A random policy takes all actions.
        let mut taken = [0; Action::MAX];
        for seed in 0..20 {
            env.reset(seed).unwrap();
            let done = rollout(&mut env, Policy::Random(Seed(seed))).unwrap();
            for (sum, steps) in taken.iter_mut().zip(done.actions) {
                *sum += steps;
            }
        }
        assert!(
            taken[..9].iter().all(|steps| *steps > 0) && taken[9..].iter().all(|steps| *steps == 0),
            "{taken:?}"
        );
        let set = make_episodes(&task, Split::Test, 3, 1, |_| ()).unwrap();
        let named = |episode: &Episode| episode.oracle.as_ref().unwrap().constrained.contains_key("TurnRight");
        assert!(set.episodes.iter().all(named));
    }
}

/// The default clause of the vocabulary does not know the actions of a configuration. Beside one of these, the default
/// is no demand: neither in reports nor in environments. A clause that does not only negate actions demands it.
#[test]
fn the_default_counts_only_if_no_action_is_derived() {
    let config = CONFIG.replace("task: ~\n", "");
    let rules = format!("{DECLARED}/// R1: turn\nTurnRight(X) :- IsCar(X), IsAtInter(X).\n");
    let (world, sources) = configured(&config, &rules, |_| ());
    let turn = world.scenario.actions.table.find("TurnRight").unwrap();
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut turned = 0;
    for _ in 0..60 {
        for done in &city.tick(&[]).unwrap().agents {
            assert!(!done.derived.contains(Action::Normal), "{:?}", done.derived);
            turned += usize::from(done.derived.contains(turn));
        }
    }
    assert!(turned > 10, "{turned}");
    let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).unwrap_or_else(|faults| panic!("{faults:?}")));
    let mut env = Env::new(task, Split::Test, ControlMode::First).unwrap();
    let mut steps = [0; Action::MAX];
    for seed in 0..8 {
        env.reset(seed).unwrap();
        let done = rollout(&mut env, Policy::Oracle).unwrap();
        for (sum, count) in steps.iter_mut().zip(done.constrained) {
            *sum += count;
        }
    }
    assert!(steps[turn.index()] > 0, "{steps:?}");
    assert_eq!(steps[Action::Normal.index()], 0, "{steps:?}");

    let demanded = format!("{DECLARED}Stop(X) :- IsCar(X).\nNormal(X) :- IsCar(X), IsBus(X).\n");
    let (world, _) = configured(CONFIG, &demanded, |_| ());
    let mut city = simulation(&world, Executor::Auto, 1);
    let both = |derived: &logicity::sim::Actions| derived.contains(Action::Stop) && derived.contains(Action::Normal);
    assert!(city.tick(&[]).unwrap().agents.iter().any(|done| both(&done.derived)));
}

/// A definition changes the hash, and none leaves it.
#[test]
fn definitions_of_actions_are_part_of_the_hash() {
    let hash = |text: &str| load_memory(&[("main.yaml", text)]).1.expect("it is right").hash;
    let plain = hash("base: expert\ntask: ~\n");
    assert_eq!(hash("base: expert\ntask: ~\nactions: {define: {}}\n"), plain);
    assert_ne!(hash(CONFIG), plain);
    assert_ne!(hash(&CONFIG.replace("park: 4", "park: 5")), hash(CONFIG));
}
