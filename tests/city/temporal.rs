//! Temporal operators in cities: both executors against each other and against the whole history.

use crate::agreement::{Counts, answer, multiply, observers_derive_as_sessions_do, record, replay, simulation};
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, ActionTable, Split};
use logicity::config::Scenario;
use logicity::datalog::explain::ExplanationPrinter;
use logicity::datalog::{BaseType, Value, diff, naive};
use logicity::diag::{Sources, codes};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Decider, Executor, Finding, Oracle, Settings, Simulation, TraceTick, World, conflicts};
use std::sync::Arc;

const DECLARED: &str = ".include \"vocabulary.dl\"
.decl Follows(x: agent, y: agent)
Follows(X, Y) :- NextTo(X, Y), IsCar(Y), RightOf(Y, X).
.decl Halted(x: agent)
Halted(X) :- previous Stop(X).
";

fn world(rules: &str, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    configured("base: expert\n", &format!("{DECLARED}{rules}"), edit)
}

/// Random rules: clauses of actions with temporal operators about one agent or two.
fn random_rules(random: &mut impl RngExt) -> String {
    let window = |random: &mut dyn FnMut(u32) -> u32, longest: u32| {
        let first = random(4);
        format!("[{first},{}]", first + random(longest))
    };
    let mut clauses = String::new();
    for head in ["Stop", "Slow", "Fast"] {
        for _ in 0..random.random_range(1..4) {
            let mut body = vec![["IsCar(X)", "IsAtInter(X)", "Sees(X, Z)"][random.random_range(0..3)].to_owned()];
            for fact in 0..random.random_range(1..3) {
                let mut draw = |below: u32| random.random_range(0..below);
                // Some windows do not fit into a word.
                let longest = [6, 6, 12, 90][draw(4) as usize];
                let window = window(&mut draw, longest);
                let literal = match draw(14) {
                    0 => format!("once{window} IsAtInter(X)"),
                    1 => format!("once{window} IsInInter(Y)"),
                    2 => format!("once{window} Follows(X, Y)"),
                    3 => format!("once{window} NextTo(Y, X)"),
                    4 => format!("historically{window} IsCar(X), Not(once{window} Stop(X))"),
                    5 => format!("historically{window} NextTo(X, Y)"),
                    6 => format!("Sees(X, Y) since{window} Follows(X, Y)"),
                    7 => format!("Halted(X) since{window} IsAtInter(X)"),
                    8 => "previous Slow(X)".to_owned(),
                    9 => format!("for[{}] Halted(X)", 1 + draw(5)),
                    10 => "Not(once IsInInter(X))".to_owned(),
                    11 => "once IsBus(Y)".to_owned(),
                    12 => "Sees(X, Y) since IsPedestrian(Y), NextTo(X, Y)".to_owned(),
                    _ => format!("Not(once{window} IsClose(X, _))"),
                };
                body.push(literal.replace('Y', &format!("Y{fact}")));
            }
            clauses += &format!("{head}(X) :- {}.\n", body.join(", "));
        }
    }
    clauses
}

/// The dense executor remembers, in cities of every shape, what the relational one does.
#[test]
fn executors_agree_on_random_rules_about_earlier_ticks() {
    let mut counts = Counts::default();
    for (case, &(times, threads)) in [(1, 1), (1, 1), (1, 1), (1, 1), (5, 1), (5, 1), (20, 1), (20, 2)]
        .iter()
        .enumerate()
    {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let (world, _) = world(&rules, |scenario| {
            if times > 1 {
                multiply(scenario, times);
            }
        });
        let mut cities = [(Executor::Relational, 1), (Executor::Dense, threads)]
            .map(|(executor, threads)| simulation(&world, executor, threads));
        for run in 0..2 {
            counts.go_the_same_way(&mut cities, if times < 20 { 110 } else { 12 });
            // A new run remembers nothing.
            for city in &mut cities {
                city.restart_drawn(Seed(10 + run), |_| ()).unwrap();
            }
        }
    }
    counts.check();
}

/// In every tick, the city derives what the specification derives from the facts of all ticks so far.
#[test]
fn cities_agree_with_the_whole_history() {
    let mut derived = 0;
    for case in 20..26 {
        let rules = random_rules(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        let (world, _) = world(&rules, |_| ());
        let mut city = simulation(&world, Executor::Dense, 1);
        let checked = world.program.rules();
        let names: Vec<Value> = (city.agents().iter())
            .map(|agent| Value(checked.symbols.intern(&agent.name().to_string()).0))
            .collect();
        let (mut ticks, mut found) = (Vec::new(), Vec::new());
        for _ in 0..14 {
            let report = city.tick(&[]).unwrap().clone();
            found.push(report.agents.iter().map(|agent| agent.derived).collect::<Vec<_>>());
            let facts = city.facts(|_| true).unwrap();
            let mut held = Vec::new();
            for (known, rows) in world.vocabulary.predicates.iter().zip(&facts.rows) {
                let Some(id) = known.id else { continue };
                let columns = &checked.predicates[id.index()].columns;
                assert!(columns.iter().all(|column| column.base == BaseType::Symbol));
                held.extend(rows.iter().map(|row| {
                    let row = row[..known.arity].iter().map(|agent| names[*agent as usize]);
                    (id, row.collect::<Vec<Value>>())
                }));
            }
            ticks.push(held);
        }
        let models = naive::evaluate_ticks(checked, &checked.symbols, ticks);
        for (tick, (model, found)) in models.iter().zip(&found).enumerate() {
            for (agent, found) in found.iter().enumerate() {
                let holds = |action: &Action| {
                    let predicate = world.vocabulary.action(*action);
                    predicate.is_some_and(|predicate| model[predicate.index()].contains(&vec![names[agent]]))
                };
                let expected = Action::STANDARD.into_iter().filter(holds).collect();
                let expected = world.vocabulary.before_default(None, expected);
                assert_eq!(*found, expected, "agent {agent} in tick {tick} under\n{rules}");
                derived += found.len();
            }
        }
    }
    assert!(derived > 300, "{derived}");
}

/// A trace records what the rules read of earlier ticks, and explanations name these ticks.
#[test]
fn traces_and_explanations_name_the_ticks() {
    let rules = "/// R1: a car that stopped waits two ticks more
Stop(X) :- IsCar(X), once[1,2] Stop(X), Not(historically[1,3] Stop(X)).
Stop(X) :- IsAtInter(X), IsInInter(Y).
Slow(X) :- Not(Stop(X)), historically[1,3] IsCar(X), IsCar(X) since[1,9] IsAtInter(X).
";
    let (world, sources) = world(rules, |_| ());
    let (trace, facts) = record(&world, &sources, 30, |_| ());
    let rules = world.program.rules();
    let mut found = String::new();
    let mut replay = replay(&world, &trace, &facts, |replay, tick| {
        for (past, rows) in rules.pasts.iter().zip(&facts[tick].past) {
            let tick = tick as u64;
            for (_, then) in rows {
                let ago = tick - then;
                let window = u64::from(past.first)..=past.last.map_or(tick, u64::from);
                assert!(window.contains(&ago), "{past:?} {tick} {then}");
            }
        }
        for agent in 0..replay.agents().len() {
            for action in [Action::Stop, Action::Slow] {
                let predicate = world.vocabulary.action(action).unwrap();
                let Some(proof) = replay.session().explain(predicate, &[replay.value(agent)]).unwrap() else {
                    continue;
                };
                let printer = ExplanationPrinter::new(rules, replay.session().symbols(), &sources);
                found += &printer.tree(&proof);
            }
        }
    });
    for words in [
        "once[1,2] Stop(\"Car_",
        ")  in tick 25",
        "historically[1,3] IsCar(\"Car_",
        ")  in the ticks 23 to 25",
        "so far IsCar(\"Car_9\") since[1,9] IsAtInter(\"Car_9\")",
        ")  since tick 22",
    ] {
        assert!(found.contains(words), "{words} in\n{found}");
    }
    let line = trace.lines().nth(4).unwrap();
    let missing = line.replace("once[1,2] Stop", "once[1,3] Stop");
    let fault = replay.set(&TraceTick::read(&missing).unwrap()).unwrap_err();
    assert!(
        fault.message.contains("does not record `once[1,2] Stop`"),
        "{}",
        fault.message
    );
}

/// Wanted actions of observed agents are those of a session with the same facts and the same memory.
#[test]
fn observers_remember_what_the_city_does() {
    let mut derived = 0;
    for case in 30..36 {
        let rules = random_rules(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        // Reading an action makes the monitor evaluate the rules twice.
        let apart = if case % 2 == 0 {
            ""
        } else {
            ".decl Halts(x: agent)\nHalts(X) :- Stop(X).\n"
        };
        let (world, _) = world(&(rules + apart), |_| ());
        let oracle = Arc::new(Oracle::new(Arc::clone(&world), 6).unwrap());
        let refused = Decider::new(Arc::clone(&oracle)).map(|_| ()).unwrap_err();
        assert_eq!(
            refused.message,
            "observations have no earlier ticks, but the rules have temporal operators"
        );
        derived += observers_derive_as_sessions_do(&oracle, &world, 14);
    }
    assert!(derived > 300, "{derived}");
}

/// The memory of a city has the limit of the world: from the beginning, and for what it remembers later.
#[test]
fn memories_of_cities_have_a_limit() {
    let city = |rules: &str, limit: u64| {
        let (world, _) = world(rules, |scenario| multiply(scenario, 40));
        let mut world = Arc::into_inner(world).unwrap();
        world.limits.bytes = limit;
        Simulation::new(Arc::new(world), Split::Test, Seed(3), Settings::default())
    };
    let fault = city("Stop(X) :- once[64,64] IsInInter(X).\n", 1024).err().unwrap();
    assert_eq!(
        (fault.code, fault.message.as_str()),
        (
            codes::LIMIT_EXCEEDED,
            "what the rules read of earlier ticks takes more than 1 KiB"
        )
    );
    let rules = "Stop(X) :- once[900000,1000000] NextTo(X, Y).\n";
    let mut city = city(rules, 1 << 20).unwrap();
    let fault = (0..2000).find_map(|_| city.tick(&[]).err()).expect("the memory grows");
    assert_eq!(
        fault.message,
        "what the rules read of earlier ticks takes more than 1 MiB"
    );
    let tick = city.now();
    assert!(tick > 1 && city.tick(&[]).is_err() && city.now() == tick, "{tick}");
}

/// A list of scenes is a list of ticks. Entities of the same name are the same one; what an agent saw stays known after
/// it is out of view.
#[test]
fn lists_of_scenes_are_ticks() {
    const RULES: &str = "Stop(X) :- once[0,1] IsBus(_).
Slow(X) :- IsCar(Y) since[0,5] IsTiro(Y), Not(previous Stop(X)).
Fast(X) :- for[3] IsCar(X).
";
    let (world, _) = world(RULES, |_| ());
    let answer = |executor: Executor, scenes: &str| {
        let answer = answer(&world, executor, BuiltinFiles, scenes)?;
        Ok::<_, String>(answer["egos"]["a"]["derived"].clone())
    };
    let bus = r#"{"entities": ["a", "b"], "ego": "a", "facts": {"IsCar": ["a", "b"], "IsBus": ["b"]}}"#;
    let tiro = r#"{"entities": ["c", "a"], "ego": "a", "facts": {"IsCar": ["c", "a"], "IsTiro": ["c"]}}"#;
    let car = r#"{"entities": ["a", "c"], "ego": "a", "facts": {"IsCar": ["a", "c"]}}"#;
    let alone = r#"{"entities": ["a"], "ego": "a", "facts": {"IsCar": ["a"]}}"#;
    for executor in [Executor::Dense, Executor::Relational] {
        for (ticks, derived) in [
            (vec![alone], serde_json::json!([])),
            (vec![bus], serde_json::json!(["Stop"])),
            (vec![bus, alone], serde_json::json!(["Stop"])),
            (vec![bus, alone, alone], serde_json::json!(["Fast"])),
            (vec![tiro, car], serde_json::json!(["Slow"])),
            (vec![tiro, alone, car], serde_json::json!(["Fast"])),
            (vec![bus, tiro], serde_json::json!(["Stop"])),
            (vec![tiro, car, car, car], serde_json::json!(["Slow", "Fast"])),
        ] {
            let text = format!("[{}]", ticks.join(", "));
            assert_eq!(answer(executor, &text), Ok(derived), "{text}");
        }
        let fault = answer(executor, "[]").unwrap_err();
        assert!(fault.contains("a list without scenes"), "{fault}");
        let fault = answer(executor, &format!("[{alone}, {{}}]")).unwrap_err();
        assert!(fault.contains("a scene without agents or entities"), "{fault}");
    }
}

/// What has one tick only refuses rules that look back.
#[test]
fn single_ticks_refuse_rules_that_look_back() {
    let (world, _) = world("Stop(X) :- previous Stop(X).", |_| ());
    let rules = world.program.rules();
    let fault = diff::diff(rules, rules, &diff::Options::default()).unwrap_err();
    assert_eq!(fault[0].message, "rules with temporal operators cannot be compared");
    let city = simulation(&world, Executor::Auto, 1);
    let state = (3, city.agents().to_vec());
    let settings = Settings::default();
    let resumed = Simulation::resume(
        Arc::clone(&world),
        Split::Test,
        Seed(3),
        settings,
        state,
        &Cancel::never(),
    );
    let fault = resumed.map(|_| ()).unwrap_err();
    assert!(
        fault
            .message
            .starts_with("simulations that begin in a later tick have no earlier ticks")
    );
    // Conflicts concern every possible past.
    let overlaps = conflicts(rules, &ActionTable::default()).unwrap();
    assert!(
        overlaps
            .iter()
            .all(|overlap| !matches!(overlap.finding, Finding::NotFound(_)))
    );
}
