//! Kinds of agents that a configuration defines: where and how fast they move, what rules read of them, and the messages
//! about faulty ones.

use crate::agreement::{executors, go_the_same_way, record, replay, simulation};
use crate::config::{load_memory, refused};
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, ActionTable, AgentKind, KindTable, MoveReason, Split};
use logicity::diag::{Sources, render};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{CityTheory, Executor, Inference, Simulation, World, conflict_lints, conflicts, examine};
use logicity::task::spf::{ControlMode, Env, EpisodeSet, MapIdentity, SpfTask};
use std::sync::Arc;

/// A city with cyclists, who stop rather than go on, and runners, who are fast pedestrians.
const CONFIG: &str = "base: expert
task: ~
kinds:
  Cyclist: {of: Car, cells: {Slow: 1, Normal: 1, Fast: 2}, picture: bicycle, default: Slow}
  Runner:
    of: Pedestrian
    cells: {Normal: 2, Fast: 3}
    priority: [Fast, Stop, Slow, Normal]
predicates:
  define:
    IsCyclist: {kind: Cyclist}
    IsRunner: {kind: Runner}
agents:
  test:
    Cyclist:
      - {priority: 20, count: 2}
      - {priority: 21, concepts: [reckless]}
    Runner:
      - {count: 3}
";

const DECLARED: &str = ".include \"vocabulary.dl\"
.decl IsCyclist, IsRunner(x: agent)
.input IsCyclist, IsRunner
";

fn city(rules: &str) -> (Arc<World>, Sources) {
    configured(CONFIG, &format!("{DECLARED}{rules}"), |_| ())
}

fn of_kind(city: &Simulation, name: &str) -> Vec<usize> {
    let agents = city.agents().iter().enumerate();
    let agents = agents.filter(|(_, agent)| agent.name().kind_name() == name);
    agents.map(|(position, _)| position).collect()
}

#[test]
fn agents_of_own_kinds_follow_the_others_and_carry_the_name() {
    let (world, _) = city("Stop(X) :- IsCyclist(X).");
    let city = simulation(&world, Executor::Auto, 1);
    let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
    let others = names.len() - 6;
    assert_eq!(
        names[others..],
        [
            "Cyclist_1",
            "Cyclist_2",
            "Cyclist_3",
            "Runner_1",
            "Runner_2",
            "Runner_3"
        ]
    );
    assert!(
        names[..others]
            .iter()
            .all(|name| name.starts_with("Car_") || name.starts_with("Pedestrian_"))
    );
    let reckless = &city.agents()[others + 2];
    assert_eq!(reckless.concepts[..], ["Cyclist".to_owned(), "reckless".to_owned()]);
    assert_eq!(reckless.kind, AgentKind::Car);
    // The others are placed as in a city without these kinds.
    let plain = "base: expert\ntask: ~\n";
    let (plain, _) = configured(plain, ".include \"vocabulary.dl\"\nStop(X) :- IsBus(X).", |_| ());
    let plain = simulation(&plain, Executor::Auto, 1);
    for (one, other) in city.agents().iter().zip(plain.agents()) {
        assert_eq!((one.cell, one.goal()), (other.cell, other.goal()));
    }
}

/// Cyclists move one cell under Normal and at most two; runners two under Normal, and three under Fast.
#[test]
fn kinds_have_their_own_speeds() {
    for (rules, cyclist, runner) in [
        ("Stop(X) :- IsBus(X), IsOld(X).", 1, 2),
        ("Fast(X) :- IsCar(X).\nFast(X) :- IsPedestrian(X).", 2, 3),
    ] {
        let (world, _) = city(rules);
        let mut city = simulation(&world, Executor::Auto, 1);
        let wanted = [("Cyclist", cyclist, 2), ("Runner", runner, 3)];
        let mut moved = [0; 2];
        for _ in 0..80 {
            let report = city.tick(&[]).unwrap().clone();
            for (kind, (name, cells, most)) in wanted.into_iter().enumerate() {
                for agent in of_kind(&city, name) {
                    let done = &report.agents[agent];
                    let distance = (done.moved.to.row - done.moved.from.row).abs()
                        + (done.moved.to.col - done.moved.from.col).abs();
                    assert!(distance <= most, "{name} moved {distance}");
                    if done.moved.reason == MoveReason::Decided {
                        assert_eq!(distance, cells, "{name} under {:?}", done.action);
                        moved[kind] += 1;
                    }
                }
            }
        }
        assert!(moved.iter().all(|moved| *moved > 60), "{moved:?}");
    }
}

/// `IsCar` holds for all that drive, the predicate of a kind only for its agents.
#[test]
fn predicates_tell_kinds_apart() {
    let (world, _) =
        city("Slow(X) :- IsCyclist(X), IsCar(X), Not(IsPedestrian(X)).\nFast(X) :- IsRunner(X), IsPedestrian(X).");
    cyclists_are_slow_and_runners_fast(&world, Action::Normal);
}

/// Checks the actions of a tick. `others` is that of cars and pedestrians.
fn cyclists_are_slow_and_runners_fast(world: &Arc<World>, others: Action) {
    let mut city = simulation(world, Executor::Auto, 1);
    let report = city.tick(&[]).unwrap().clone();
    for (done, agent) in report.agents.iter().zip(city.agents()) {
        let expected = match agent.name().kind_name() {
            "Cyclist" => Action::Slow,
            "Runner" => Action::Fast,
            _ => others,
        };
        assert_eq!(done.action, expected, "{}", agent.name());
    }
}

#[test]
fn a_kind_has_its_own_precedence_and_default() {
    let rules = "Stop(X) :- Sees(X, X), Not(IsCyclist(X)).\nFast(X) :- Sees(X, X), Not(IsCyclist(X)).
        Normal(X) :- Sees(X, X), IsBus(X).";
    // Without `vocabulary.dl`, nothing is derived for cyclists.
    let declared = ".type agent <: symbol\n.decl IsCyclist, IsRunner, IsBus(x: agent)\n.decl Sees(x: agent, y: agent)
        .input IsCyclist, IsRunner, IsBus, Sees\n.decl Stop, Fast, Normal(x: agent)\n.output Stop, Fast, Normal\n";
    let (world, _) = configured(CONFIG, &format!("{declared}{rules}"), |_| ());
    cyclists_are_slow_and_runners_fast(&world, Action::Stop);
}

/// A warning about two actions names the kinds whose order of precedence decides otherwise.
#[test]
fn conflicts_name_kinds_with_another_winner() {
    let (world, sources) = city("Stop(X) :- IsBus(X).\nFast(X) :- IsBus(X).");
    let (rules, config) = (world.program.rules(), &world.scenario.actions);
    let theory = CityTheory::new(world.scenario.clone()).unwrap();
    let found = conflicts(&examine(rules, Some(&theory), &sources).in_city, &config.table).unwrap();
    let lints = conflict_lints(&found, rules, config);
    let text = render(&lints, &sources, false);
    assert!(
        text.contains("the rules can derive Stop and Fast for one agent, and Stop wins"),
        "{text}"
    );
    assert!(text.contains("by their own `priority`, Fast wins for Runner"), "{text}");
    assert!(!text.contains("Cyclist"), "{text}");
}

/// Both executors, on one thread and on two, decide the same on random rules; a replay has the same facts.
#[test]
fn executors_and_replays_agree_on_random_rules_with_own_kinds() {
    const FACTS: [&str; 7] = [
        "IsAtInter(X)",
        "IsCyclist(X)",
        "IsClose(X, Y), IsCyclist(Y)",
        "CollidingClose(X, Y), Not(IsRunner(Y))",
        "IsReckless(X)",
        "NextTo(X, Y), IsRunner(Y)",
        "HigherPri(X, Y), IsCyclist(Y), IsCar(X)",
    ];
    for case in 0..4_u64 {
        let mut random = Seed(case).stream(Purpose::TEST, 0, 0);
        let mut rules = String::new();
        for head in ["Stop", "Slow", "Fast"] {
            for _ in 0..random.random_range(1..3) {
                let fact = FACTS[random.random_range(0..FACTS.len())];
                rules += &format!("{head}(X) :- {fact}.\n");
            }
        }
        let times = [1, 1, 1, 20][case as usize];
        let (world, sources) = configured(CONFIG, &format!("{DECLARED}{rules}"), |scenario| {
            if times > 1 {
                crate::agreement::multiply(scenario, times);
            }
        });
        go_the_same_way(&mut executors(&world), if times < 20 { 40 } else { 3 });
        if times == 1 {
            let (trace, facts) = record(&world, &sources, 20, |_| ());
            assert!(
                trace.contains("\"id\":\"Cyclist_1\",\"type\":\"Car\",\"concepts\":[\"Cyclist\"]"),
                "{}",
                &trace[..2000]
            );
            replay(&world, &trace, &facts, |_, _| ());
        }
    }
}

/// A scene of the agents of a city, with their kinds as types, has the decisions of the city.
#[test]
fn scenes_have_types_of_own_kinds() {
    let rules = "Stop(X) :- CollidingClose(X, Y), IsCyclist(Y).\nFast(X) :- NextTo(X, Y), IsRunner(Y).";
    let (world, sources) = city(rules);
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut sources = sources;
    let mut decided = 0;
    for _ in 0..30 {
        let agents: Vec<serde_json::Value> = (city.agents().iter())
            .map(|agent| {
                // As in traces, or by name.
                let own = usize::from(!agent.kind_id.is_standard() && agent.number > 1);
                serde_json::json!({
                    "id": agent.name().to_string(),
                    "type": if own == 1 { agent.name().kind_name().to_owned() } else { agent.kind.name().to_owned() },
                    "concepts": agent.concepts[own..],
                    "priority": agent.priority,
                    "at": [agent.cell.row, agent.cell.col],
                    "heading": agent.heading.map(logicity::city::Heading::name),
                })
            })
            .collect();
        let scene = serde_json::json!({ "map": "square-5x5", "agents": agents }).to_string();
        let source = sources.add("scene", scene);
        let (scenario, program) = (world.scenario.clone(), world.program.clone());
        let mut inference = Inference::new(scenario, program, Seed(0), Executor::Auto, BuiltinFiles).unwrap();
        let facts = inference.ground(&sources, source).unwrap();
        assert_eq!(
            facts.kinds,
            city.agents().iter().map(|agent| agent.kind_id).collect::<Vec<_>>()
        );
        let answer = inference.answer(&sources, source).unwrap();
        let actions: Vec<Action> = answer.actions().map(|(_, action)| action).collect();
        let report = city.tick(&[]).unwrap();
        // Chance decides whether pedestrians see a collision ahead, so compare those that drive.
        for ((done, action), kind) in report.agents.iter().zip(actions).zip(&facts.kinds) {
            if world.scenario.kinds.base(*kind) == AgentKind::Car {
                assert_eq!(done.action, action);
                decided += usize::from(!kind.is_standard());
            }
        }
    }
    assert_eq!(decided, 90);
}

/// Tasks have other kinds of agents around the ego; episodes name them.
#[test]
fn episodes_with_own_kinds_are_written_and_read() {
    let config = CONFIG.replace("task: ~\n", "");
    let rules = format!("{DECLARED}Stop(X) :- CollidingClose(X, Y).");
    let (world, sources) = configured(&config, &rules, |_| ());
    let kinds = world.scenario.kinds.clone();
    let task = Arc::new(SpfTask::new(world, &sources).unwrap_or_else(|faults| panic!("{faults:?}")));
    let mut env = Env::new(task, Split::Test, ControlMode::First).unwrap();
    env.reset(5).unwrap();
    let episode = env.episode().clone();
    let set = EpisodeSet {
        config: "mine".into(),
        split: Split::Test,
        map: MapIdentity::of(env.task().world().map()),
        seed: 5,
        episodes: vec![episode.clone()],
    };
    let mut text = Vec::new();
    set.write(&mut text).unwrap();
    let text = String::from_utf8(text).unwrap();
    assert!(text.contains("\"Cyclist_3\""), "{text}");
    let mut sources = Sources::new();
    let source = sources.add("mine.jsonl", text);
    let read = EpisodeSet::read(&sources, source, &kinds, &ActionTable::default()).unwrap();
    assert_eq!(read.episodes[0].agents, episode.agents);
    assert!(
        EpisodeSet::read(&sources, source, &KindTable::default(), &ActionTable::default())
            .unwrap_err()
            .message
            .contains("`Cyclist_1` is not an agent name")
    );
    env.reset_to(&read.episodes[0]).unwrap();
}

#[test]
fn pictures_and_questions_refuse_other_kinds() {
    let (world, _) = city("Stop(X) :- IsCyclist(X).");
    let fault = world.only_standard("questions").unwrap_err();
    assert_eq!(fault.message, "questions have cars and pedestrians only, not `Cyclist`");
}

/// The text of each faulty `kinds`, and what the message says.
const FAULTS: [(&str, &str); 19] = [
    ("kinds: {Cyclist: {}}", "the key `of` is missing in a kind of agents"),
    (
        "kinds: {Cyclist: {}}",
        "`of: Car` drives on streets, `of: Pedestrian` walks on sidewalks",
    ),
    (
        "kinds: {Cyclist: {of: Tram}}",
        "expected one of `Car`, `Pedestrian`, found `Tram`",
    ),
    (
        "kinds: {cyclist: {of: Car}}",
        "expected the name of a kind (a capital letter",
    ),
    (
        "kinds: {CAR: {of: Car}}",
        "`CAR` differs from the kind `Car` only by case",
    ),
    ("kinds: {Cyclist: {of: Car}, CYCLIST: {of: Car}}", "only by case"),
    (
        "kinds: {Cyclist: {of: Car, cells: {Fast: 4}}}",
        "expected a whole number from 0 to 3, found `4`",
    ),
    (
        "kinds: {Cyclist: {of: Car, cells: {Stop: 1}}}",
        "unknown key `Stop` in the cells per tick of a kind",
    ),
    (
        "kinds: {Cyclist: {of: Car, cells: {Slow: 0, Normal: 0, Fast: 0}}}",
        "agents of this kind would never move",
    ),
    (
        "kinds: {Cyclist: {of: Car, picture: bycicle}}",
        "did you mean `bicycle`?",
    ),
    (
        "kinds: {Cyclist: {of: Car, picture: old}}",
        "expected one of `ambulance`, `bus`, `police`, `tiro`, `reckless`, `bicycle`, found `old`",
    ),
    ("kinds: {cyclist: {of: Car}}", "write `Cyclist`"),
    (
        "kinds: {Cyclist: {of: Car, default: Turn}}",
        "expected one of `Slow`, `Normal`, `Fast`, `Stop`, found `Turn`",
    ),
    ("kinds: {Cyclist: {of: Car, priority: [Stop]}}", "exactly once"),
    ("kinds: {Car: {of: Car}}", "unknown key `of`"),
    (
        "kinds: {Cyclist: {of: Car}}\nagents: {test: {cars: [{priority: 1, concepts: [Cyclist]}]}}",
        "unknown concept `Cyclist`",
    ),
    (
        "agents: {test: {Cyclist: [{priority: 1}]}}",
        "define a kind of your own under `kinds`",
    ),
    (
        "kinds: {ambulance: {of: Car}, Ambulance: {of: Car}}",
        "expected the name of a kind",
    ),
    (
        "kinds: {Cyclist: {of: Car}}\npredicates: {define: {IsBike: {kind: Bike}}}",
        "expected one of `Car`, `Pedestrian`, `Cyclist`, found `Bike`",
    ),
];

#[test]
fn faulty_kinds_have_messages_with_places() {
    for (kinds, expected) in FAULTS {
        let message = refused(&format!("base: expert\ntask: ~\n{kinds}\n"));
        assert!(message.contains(expected), "{kinds}\n{message}");
    }
    let many: Vec<String> = (0..15).map(|number| format!("K{number}: {{of: Car}}")).collect();
    let message = refused(&format!("base: expert\nkinds: {{{}}}\n", many.join(", ")));
    assert!(message.contains("15 kinds are defined, the limit is 14"), "{message}");
}

/// A definition changes the hash; the standard kinds as they are do not.
#[test]
fn kinds_are_part_of_the_hash() {
    let hash = |text: &str| load_memory(&[("main.yaml", text)]).1.expect("it is right").hash;
    let plain = hash("base: expert\n");
    assert_eq!(
        hash("base: expert\nkinds: {Car: {cells: {Fast: 3}}, Pedestrian: ~}\n"),
        plain
    );
    for other in [
        "kinds: {Car: {cells: {Fast: 2}}}",
        "kinds: {Car: {default: Slow}}",
        "kinds: {Cyclist: {of: Car}}",
        "kinds: {Cyclist: {of: Pedestrian}}",
    ] {
        assert_ne!(hash(&format!("base: expert\n{other}\n")), plain, "{other}");
    }
}
