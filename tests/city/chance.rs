//! Clauses with probabilities in cities: executors, replays, observers and scenes draw the same, and as often as the
//! rules say.

use crate::agreement::{self, Counts, multiply, observers_derive_as_sessions_do, record, replay, simulation};
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::Action;
use logicity::config::Scenario;
use logicity::datalog::MarginalOptions;
use logicity::datalog::explain::ExplanationPrinter;
use logicity::diag::Sources;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Decider, Executor, Inference, Oracle, World};
use std::sync::Arc;

/// Expert mode with two quantities, these rules, and the changes of `edit`.
fn with_rules(rules: &str, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    let config =
        "base: expert\npredicates:\n  define:\n    Waited: {quantity: waited}\n    Heading: {quantity: heading}\n";
    let declared = ".include \"vocabulary.dl\"\n.decl Waited(x: agent, n: number)\n.decl Heading(x: agent, h: symbol)\n\
                    .input Waited, Heading\n.decl Bold(x: agent)\n.decl Trusts(x: agent, y: agent)\n.scope Sees\n";
    configured(config, &format!("{declared}{rules}"), edit)
}

/// Random rules: clauses of actions and of hidden moods, most with probabilities. Those about three agents are left to
/// the relational executor.
fn random_rules(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 12] = [
        "IsCar(Y)",
        "IsAtInter(Y)",
        "CollidingClose(X, Y)",
        "IsClose(X, _)",
        "Waited(X, n), n > 1",
        "Waited(Y, n), n < 3",
        "Heading(X, h), h != \"Up\"",
        "Bold(X)",
        "Not(Bold(X))",
        "Trusts(X, Y)",
        "Not(Trusts(X, Y)), IsCar(Y)",
        "previous Bold(X)",
    ];
    let body = |random: &mut dyn FnMut(usize) -> usize, facts: &[&str]| {
        let mut body = vec![["IsCar(X)", "IsAtInter(X)"][random(2)].to_owned()];
        body.extend((0..random(3)).map(|_| facts[random(facts.len())].to_owned()));
        body.sort();
        body.dedup();
        body.join(", ")
    };
    let mut number = |below: usize| random.random_range(0..below);
    let chance = ["0.1", "0.5", "0.9", "1/3"];
    let mut clauses = String::new();
    clauses += &format!(
        "{} :: Bold(X) :- {}.\n",
        chance[number(4)],
        body(&mut number, &FACTS[..7])
    );
    clauses += &format!(
        "{} :: Trusts(X, Y) :- IsCar(Y), {}.\n",
        chance[number(4)],
        body(&mut number, &FACTS[..7])
    );
    for _ in 0..3 {
        clauses += &match number(4) {
            0 => format!("0.3 :: Stop(X); 0.4 :: Fast(X) :- {}.\n", body(&mut number, &FACTS)),
            1 => format!(
                "to_float(n) / 8.0 :: Slow(X) :- Waited(X, n), n < 8, {}.\n",
                body(&mut number, &FACTS)
            ),
            2 => format!("Slow(X) :- {}.\n", body(&mut number, &FACTS)),
            _ => format!(
                "{} :: {}(X) :- {}.\n",
                chance[number(4)],
                ["Stop", "Slow", "Fast"][number(3)],
                body(&mut number, &FACTS)
            ),
        };
    }
    // Each action occurs.
    clauses + "0.2 :: Stop(X); 0.2 :: Slow(X); 0.2 :: Fast(X) :- IsCar(X).\n"
}

#[test]
fn executors_agree_on_random_rules_with_probabilities() {
    let mut counts = Counts::default();
    for (case, &(times, threads)) in [(1, 1), (1, 1), (1, 1), (1, 1), (5, 1), (5, 1), (20, 1), (20, 2)]
        .iter()
        .enumerate()
    {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let (world, _) = with_rules(&rules, |scenario| {
            if times > 1 {
                multiply(scenario, times);
            }
        });
        let mut cities = [(Executor::Relational, 1), (Executor::Dense, threads)]
            .map(|(executor, threads)| simulation(&world, executor, threads));
        counts.go_the_same_way(&mut cities, if times < 20 { 60 } else { 10 });
    }
    counts.check();
}

/// The share of cars and ticks in which a drawn clause fires is its probability, and other seeds draw otherwise.
#[test]
fn clauses_fire_as_often_as_they_say() {
    let (world, _) = with_rules("0.3 :: Stop(X); 0.2 :: Fast(X) :- IsCar(X).\n", |_| ());
    let mut city = simulation(&world, Executor::Dense, 1);
    let (mut stops, mut fasts, mut cars) = (0, 0, 0);
    for _ in 0..400 {
        for agent in &city.tick(&[]).unwrap().agents.clone() {
            let [stop, fast] = [Action::Stop, Action::Fast].map(|action| agent.derived.iter().any(|one| one == action));
            assert!(!(stop && fast), "alternatives exclude each other");
            stops += usize::from(stop);
            fasts += usize::from(fast);
        }
        cars += city
            .agents()
            .iter()
            .filter(|agent| agent.name().to_string().starts_with("Car"))
            .count();
    }
    for (count, expected) in [(stops, 0.3), (fasts, 0.2)] {
        let share = count as f64 / cars as f64;
        // Five standard deviations of a fair coin.
        assert!((share - expected).abs() < 2.5 / (cars as f64).sqrt(), "{share}");
    }
}

/// A draw about three agents needs the relational executor, and the reason says what to write instead.
#[test]
fn draws_about_three_agents_are_relational() {
    let (world, _) = with_rules("0.5 :: Stop(X) :- IsClose(X, Y), IsClose(X, Z).\n", |_| ());
    let fault = simulation(&world, Executor::Auto, 1).fallback().unwrap().clone();
    assert!(
        fault.message.contains("draws for each combination"),
        "{}",
        fault.message
    );
    assert!(
        fault.help.iter().any(|help| help.contains("begin with `_`")),
        "{:?}",
        fault.help
    );
    let (world, _) = with_rules("0.5 :: Stop(X) :- IsClose(X, Y), IsClose(X, _Z).\n", |_| ());
    assert!(simulation(&world, Executor::Auto, 1).fallback().is_none());
}

#[test]
fn replays_draw_as_the_run_did() {
    let rules = random_rules(&mut Seed(1).stream(Purpose::TEST, 0, 0));
    let (world, sources) = with_rules(&rules, |_| ());
    let mut decided = Vec::new();
    let (trace, facts) = record(&world, &sources, 30, |city| {
        decided.push(
            city.report()
                .agents
                .iter()
                .map(|agent| agent.derived)
                .collect::<Vec<_>>(),
        );
    });
    let mut drawn = 0;
    replay(&world, &trace, &facts, |replay, tick| {
        // `before` saw the report of the tick before.
        if let Some(decided) = decided.get(tick + 1) {
            for (agent, derived) in decided.iter().enumerate() {
                assert_eq!(
                    replay.derived(agent),
                    world.vocabulary.before_default(None, *derived),
                    "tick {tick}"
                );
                drawn += derived.len();
            }
        }
    });
    assert!(drawn > 50, "{drawn}");
}

#[test]
fn observers_draw_as_sessions_do() {
    let mut derived = 0;
    for case in 0..6 {
        let rules = random_rules(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        // Reading an action makes the monitor evaluate the rules twice.
        let apart = if case % 2 == 0 {
            ""
        } else {
            ".decl Halts(x: agent)\nHalts(X) :- Stop(X).\n"
        };
        let (world, _) = with_rules(&(rules + apart), |_| ());
        let oracle = Arc::new(Oracle::new(Arc::clone(&world), 6).unwrap());
        assert!(Decider::new(Arc::clone(&oracle)).is_err());
        derived += observers_derive_as_sessions_do(&oracle, &world, 12);
    }
    assert!(derived > 300, "{derived}");
}

/// Both executors answer a scene with the same draws, which its tick determines.
#[test]
fn scenes_draw() {
    let (world, _) = with_rules("0.5 :: Stop(X) :- IsCar(X).\n", |_| ());
    let mut stopped = 0;
    for tick in 0..40 {
        let scene = format!(
            r#"{{"map": "square-5x5", "tick": {tick}, "agents": [
                {{"id": "Car_1", "type": "Car", "at": [102, 20], "heading": "Up"}},
                {{"id": "Car_2", "type": "Car", "at": [102, 23]}}]}}"#
        );
        let [dense, relational] = [Executor::Dense, Executor::Relational]
            .map(|executor| agreement::answer(&world, executor, BuiltinFiles, &scene).unwrap());
        assert_eq!(dense["egos"], relational["egos"]);
        for car in ["Car_1", "Car_2"] {
            stopped += usize::from(dense["egos"][car]["derived"] == serde_json::json!(["Stop"]));
        }
    }
    assert!((25..55).contains(&stopped), "{stopped}");
}

/// Explanations say what was drawn, with which probability.
#[test]
fn explanations_show_draws() {
    let (world, sources) = with_rules("0.5 :: Stop(X) :- IsCar(X).\n", |_| ());
    let mut city = simulation(&world, Executor::Dense, 1);
    city.tick(&[]).unwrap();
    let stops: Vec<bool> = city
        .report()
        .agents
        .iter()
        .map(|agent| agent.derived.len() == 1)
        .collect();
    let snapshot = city.snapshot().unwrap();
    let session = snapshot.session();
    let stop = world.vocabulary.action(Action::Stop).unwrap();
    let printer = ExplanationPrinter::new(world.program.rules(), session.symbols(), &sources);
    let mut shown = [0; 2];
    for (agent, stops) in stops.into_iter().enumerate() {
        let row = [snapshot.value(agent)];
        if !session.contains(world.program.predicate("IsCar").unwrap(), row) {
            continue;
        }
        let explained = match stops {
            true => session.explain(stop, &row),
            false => session.explain_absence(stop, &row.map(Some)),
        };
        let text = printer.tree(&explained.unwrap().unwrap());
        let expected = if stops { "drawn: 0.5, yes" } else { "drawn: 0.5, no" };
        assert!(text.contains(expected), "{text}");
        assert!(
            !text.contains("chance of the tick") && !text.contains("choose"),
            "{text}"
        );
        shown[usize::from(stops)] += 1;
    }
    assert!(shown.iter().all(|count| *count > 0), "{shown:?}");
}

#[test]
fn what_draws_nothing_refuses_such_rules() {
    let (world, _) = with_rules("0.5 :: Stop(X) :- IsCar(X).\n", |_| ());
    let fault = world.without_draws("questions").unwrap_err();
    assert_eq!(
        fault.message,
        "questions draw nothing, but clauses of the rules have probabilities"
    );
}

/// In a list of scenes, earlier ticks must be certain only where temporal operators read them.
#[test]
fn marginals_of_a_list_of_scenes() {
    let scenes = r#"[{"entities": ["a"], "ego": "a", "facts": {"IsAtInter": ["a"]}},
        {"entities": ["a"], "ego": "a", "facts": {"IsBus": ["a"]}}]"#;
    let answer = |rules: &str| {
        let text = format!(".include \"vocabulary.dl\"\n{rules}");
        let (world, _) = configured("base: expert\n", &text, |_| ());
        let (scenario, program) = (world.scenario.clone(), world.program.clone());
        let mut inference = Inference::new(scenario, program, Seed(0), Executor::Auto, BuiltinFiles).unwrap();
        let mut sources = Sources::new();
        let source = sources.add("scene", scenes);
        let found = inference.marginals(&sources, source, MarginalOptions::default(), &Cancel::never());
        found
            .map(|answer| answer.to_json())
            .map_err(|faults| faults[0].message.clone())
    };
    let rules = "0.25 :: Slow(X) :- IsBus(X).\nStop(X) :- Slow(X), once[1,2] IsAtInter(X).";
    let found = answer(rules).unwrap();
    assert_eq!(found["egos"]["a"]["derived"]["Stop"], 0.25, "{found}");
    let rules = "0.25 :: Slow(X) :- IsAtInter(X).\nStop(X) :- once[1,2] Slow(X).";
    let fault = answer(rules).unwrap_err();
    assert!(
        fault.starts_with("temporal operators read `Slow` of the earlier ticks"),
        "{fault}"
    );
}
