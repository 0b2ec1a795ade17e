//! Quantities: base predicates with values, in rules, runs, scenes, traces and observations.

use crate::agreement::{self, Counts, multiply, observers_derive_as_sessions_do, record, replay, simulation};
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Agent, AgentKind};
use logicity::config::Scenario;
use logicity::datalog::Value;
use logicity::diag::Sources;
use logicity::predicate::Quantity;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Decider, Executor, Observer, Oracle, TraceTick, World};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The declarations of all quantities.
const DECLARED: &str = ".include \"vocabulary.dl\"
.decl Speed, Priority, Waited, Remaining, Intersection(x: agent, n: number)
.decl Heading, Exit(x: agent, h: symbol)
.decl Distance(x: agent, y: agent, d: float)
.decl Tick(t: number)
.input Speed, Priority, Waited, Remaining, Intersection, Heading, Exit, Distance, Tick
";

/// Expert mode with all quantities, these rules, and the changes of `edit`.
fn with_quantities(rules: &str, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    let definitions = Quantity::ALL.map(|quantity| {
        let name = quantity.name();
        format!("    {}{}: {{quantity: {name}}}\n", name[..1].to_uppercase(), &name[1..])
    });
    let config = format!("base: expert\npredicates:\n  define:\n{}", definitions.concat());
    configured(&config, &format!("{DECLARED}{rules}"), edit)
}

/// Random rules: clauses of actions with conditions on the quantities of one agent or two.
fn random_rules(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 29] = [
        "Waited(X, n), n > 2",
        "Waited(X, n), n >= 1, n < 6",
        "Speed(X, 2)",
        "Not(Speed(X, 0))",
        "Speed(Y, n), n != 1",
        "Heading(X, \"Up\")",
        "Sees(X, Y), Not(Heading(Y, \"Left\"))",
        "Heading(X, h), Heading(Y, h)",
        "Heading(Y, _)",
        "Heading(X, \"Up\"), Tick(n), n % 4 < 2",
        "Speed(X, n), Waited(Y, n)",
        "Priority(Y, n), Speed(X, m), m <= n",
        "Waited(Y, n), Waited(X, m), n != m",
        "Priority(X, n), Priority(Y, m), n < m",
        "Distance(X, Y, d), d < 8.5",
        "Distance(Y, X, d), d >= 4.0, d <= 15.0",
        "Tick(n), n % 7 < 3",
        "Tick(n), Waited(X, m), n - m > 20",
        "Remaining(X, n), n < 20",
        "Waited(X, n), Waited(Y, m), n > m",
        "Waited(Y, n), Speed(Y, m), n + m * 2 > 3",
        "n = 1, Speed(Y, n)",
        "Intersection(X, n), Intersection(Y, n)",
        "Sees(X, Y), Intersection(Y, n), n % 3 = 1",
        "IsClose(X, Y)",
        "Sees(X, Y), Not(IsAtInter(Y))",
        "Exit(X, \"Up\")",
        "Exit(X, h), Heading(Y, h)",
        "Heading(X, h), Not(Exit(X, h))",
    ];
    let mut clauses = String::new();
    for head in ["Stop", "Slow", "Fast"] {
        for _ in 0..random.random_range(1..4) {
            let mut body = vec![["IsCar(X)", "IsAtInter(X)"][random.random_range(0..2)].to_owned()];
            for fact in 0..random.random_range(1..4) {
                // Each with its own variables.
                let own = |letter: char| format!("{letter}{fact}");
                let chosen = FACTS[random.random_range(0..FACTS.len())];
                let renamed = "Ynmdh".chars().fold(chosen.to_owned(), |text, letter| {
                    let mut words = text.split_inclusive(|c: char| !c.is_alphanumeric());
                    let rename = |word: &str| match word.strip_prefix(letter) {
                        Some(rest) if !rest.starts_with(char::is_alphanumeric) => own(letter) + rest,
                        _ => word.to_owned(),
                    };
                    words.by_ref().map(rename).collect()
                });
                body.push(renamed);
            }
            clauses += &format!("{head}(X) :- {}.\n", body.join(", "));
        }
    }
    clauses
}

/// The dense executor evaluates conditions on quantities, in cities of every shape, as the relational one does.
#[test]
fn executors_agree_on_random_rules_with_quantities() {
    let mut counts = Counts::default();
    for (case, &(times, threads)) in [(1, 1), (1, 1), (1, 1), (5, 1), (5, 1), (20, 1), (20, 2)]
        .iter()
        .enumerate()
    {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let (world, _) = with_quantities(&rules, |scenario| {
            if times > 1 {
                multiply(scenario, times);
            }
        });
        let mut cities = [(Executor::Relational, 1), (Executor::Dense, threads)]
            .map(|(executor, threads)| simulation(&world, executor, threads));
        counts.go_the_same_way(&mut cities, if times < 20 { 80 } else { 12 });
    }
    counts.check();
}

/// Quantities are what a spectator of the run counts.
#[test]
fn quantities_count_what_the_reports_of_the_ticks_show() {
    let (world, _) = with_quantities("Stop(X) :- CollidingClose(X, Y), Waited(X, n), n < 9.", |_| ());
    let mut city = simulation(&world, Executor::Auto, 1);
    let position = |quantity: Quantity| {
        let mut known = world.vocabulary.predicates.iter();
        known.position(|known| known.quantity() == Some(quantity)).unwrap()
    };
    let agents = city.agents().len();
    let (mut waited, mut speed) = (vec![0; agents], vec![0; agents]);
    let (mut longest, mut at_intersections, mut exits_seen) = (0, 0, 0);
    for tick in 0..400 {
        let before: Vec<_> = city.agents().to_vec();
        let moved: Vec<_> = city.tick(&[]).unwrap().agents.iter().map(|done| done.moved).collect();
        let facts = city.facts(|_| true).unwrap();
        let values = |quantity| {
            let (rows, values) = (&facts.rows[position(quantity)], &facts.values[position(quantity)]);
            assert_eq!(rows.len(), values.len());
            rows.iter()
                .zip(values)
                .map(|(row, value)| (row.map(|agent| agent as usize), *value))
        };
        let numbers = |quantity| values(quantity).map(|(_, value)| value.as_number()).collect::<Vec<_>>();
        assert_eq!(
            values(Quantity::Tick).collect::<Vec<_>>(),
            [([0, 0], Value::number(tick))]
        );
        assert_eq!(numbers(Quantity::Waited), waited);
        assert_eq!(numbers(Quantity::Speed), speed);
        let remaining = before
            .iter()
            .map(|agent| agent.route().cells().count() - 1 - agent.position());
        assert_eq!(
            numbers(Quantity::Remaining),
            remaining.map(|cells| cells as i32).collect::<Vec<_>>()
        );
        assert_eq!(
            numbers(Quantity::Priority),
            before.iter().map(|agent| agent.priority).collect::<Vec<_>>()
        );
        let intersections: Vec<([usize; 2], Value)> = before
            .iter()
            .enumerate()
            .filter_map(|(at, agent)| {
                let number = world.map().at_intersection(agent.kind, agent.cell);
                let number = number.or_else(|| world.map().in_intersection(agent.cell));
                Some(([at, 0], Value::number(number? as i32)))
            })
            .collect();
        assert_eq!(values(Quantity::Intersection).collect::<Vec<_>>(), intersections);
        at_intersections += intersections.len();
        for ([agent, _], value) in values(Quantity::Heading) {
            assert_eq!(before[agent].heading.unwrap() as u32, value.0);
        }
        let exits: BTreeMap<usize, u32> = values(Quantity::Exit)
            .map(|([agent, _], value)| (agent, value.0))
            .collect();
        for (at, agent) in before.iter().enumerate() {
            // The route leaves a lane, or the intersection in which the agent is, and comes to another lane.
            let mut lanes = (agent.route().cells().skip(agent.position())).map(|cell| world.map().lane_at(cell));
            let lane = world.map().lane_at(agent.cell);
            let is_inside = lane.is_none() && world.map().in_intersection(agent.cell).is_some();
            let on_street = agent.kind == AgentKind::Car && (is_inside || lane.is_some());
            let expected = (on_street && (is_inside || lanes.any(|lane| lane.is_none())))
                .then(|| lanes.flatten().next())
                .flatten();
            if on_street {
                assert_eq!(
                    exits.get(&at).copied(),
                    expected.map(|heading| heading as u32),
                    "{at} in {tick}: {:?}, {:?}",
                    agent.cell,
                    logicity::city::corners(agent.route().cells().skip(agent.position()))
                );
                exits_seen += usize::from(expected.is_some());
            } else if agent.kind == AgentKind::Pedestrian {
                assert!(!exits.contains_key(&at));
            }
        }
        for ([x, y], value) in values(Quantity::Distance) {
            let (dx, dy) = (
                before[x].cell.row - before[y].cell.row,
                before[x].cell.col - before[y].cell.col,
            );
            let distance = f64::from(dx * dx + dy * dy).sqrt();
            assert!((f64::from(value.as_float()) - distance).abs() < 1e-4);
        }
        assert_eq!(values(Quantity::Distance).count(), agents * (agents - 1));
        for (agent, moved) in moved.iter().enumerate() {
            speed[agent] = (moved.to.row - moved.from.row).abs() + (moved.to.col - moved.from.col).abs();
            waited[agent] = if speed[agent] == 0 { waited[agent] + 1 } else { 0 };
            longest = longest.max(waited[agent]);
        }
    }
    assert!(longest > 5 && at_intersections > 100, "{longest} {at_intersections}");
    assert!(exits_seen > 500, "{exits_seen}");
}

/// A trace records the quantities that the states of the agents do not determine, and its replay has all values.
#[test]
fn replays_of_traces_have_the_quantities_of_the_run() {
    let rules = random_rules(&mut Seed(1).stream(Purpose::TEST, 0, 0));
    let (world, sources) = with_quantities(&rules, |_| ());
    let (trace, facts) = record(&world, &sources, 30, |_| ());
    let mut replay = replay(&world, &trace, &facts, |_, _| ());
    let line = trace.lines().nth(1).unwrap();
    for (from, to) in [("[\"Car_1\",", "[\"Car_99\","), ("\"Waited\":[[", "\"Waited\":[[1,")] {
        assert!(line.contains(from));
        let fault = replay
            .set(&TraceTick::read(&line.replace(from, to)).unwrap())
            .unwrap_err();
        assert!(fault.message.contains("is not a row of"), "{}", fault.message);
    }
}

/// Wanted actions of observed agents are those of a session with the same facts.
#[test]
fn observers_decide_on_quantities_as_sessions_do() {
    let mut derived = 0;
    for case in 0..6 {
        let rules = random_rules(&mut Seed(case).stream(Purpose::TEST, 0, 0));
        // Reading an action makes the monitor evaluate the rules twice.
        let apart = if case % 2 == 0 {
            ""
        } else {
            ".decl Halts(x: agent)\nHalts(X) :- Stop(X).\n"
        };
        let (world, _) = with_quantities(&(rules + apart), |_| ());
        let oracle = Arc::new(Oracle::new(Arc::clone(&world), 6).unwrap());
        derived += observers_derive_as_sessions_do(&oracle, &world, 12);
    }
    assert!(derived > 300, "{derived}");
}

/// What the rules decide on observations, which are numbers, is what they decide on the facts. A task may observe the
/// ego alone.
#[test]
fn rules_decide_on_observed_quantities() {
    let mut decided = [0; 4];
    for case in 0..8 {
        let rules = random_rules(&mut Seed(100 + case).stream(Purpose::TEST, 0, 0));
        let (world, _) = with_quantities(&rules, |_| ());
        let entities = if case % 4 == 3 { 1 } else { 6 };
        let oracle = Arc::new(Oracle::new(Arc::clone(&world), entities).unwrap());
        let mut decider = Decider::new(Arc::clone(&oracle)).unwrap();
        let mut city = simulation(&world, Executor::Auto, 1);
        let egos = (0..city.agents().len()).filter(|ego| city.agents()[*ego].kind == AgentKind::Car);
        let mut observers: Vec<Observer> = egos.map(|ego| Observer::new(Arc::clone(&oracle), ego)).collect();
        observers.iter_mut().for_each(|observer| observer.begin(&city));
        let mut observation = vec![f32::NAN; oracle.width()];
        for _ in 0..40 {
            for observer in &mut observers {
                observer.look(&city).unwrap();
                let derived = observer.derived(&city).unwrap();
                let expected = world.vocabulary.decide(Some(AgentKind::Car.into()), derived);
                observer.write(&mut observation);
                assert_eq!(
                    decider.action(&observation, city.cancel()).unwrap(),
                    expected,
                    "{rules}"
                );
                let (session, ego) = observer.session(&city).unwrap();
                let holds = |action: &Action| session.contains(world.vocabulary.action(*action).unwrap(), [ego]);
                assert_eq!(
                    world
                        .vocabulary
                        .before_default(None, Action::STANDARD.into_iter().filter(holds).collect()),
                    derived
                );
                decided[expected.index()] += 1;
            }
            city.tick(&[]).unwrap();
        }
    }
    assert!(decided.iter().all(|&count| count > 50), "{decided:?}");
}

/// Observed numbers are the values of the quantities, divided by the scales of their columns.
#[test]
fn observations_have_the_values_of_quantities() {
    let (world, _) = with_quantities("Stop(X) :- CollidingClose(X, Y), Waited(X, n), n < 9.", |_| ());
    let oracle = Arc::new(Oracle::new(Arc::clone(&world), 4).unwrap());
    let columns = oracle.columns();
    assert_eq!(columns.iter().map(|column| column.width).sum::<usize>(), oracle.width());
    let scales: Vec<(&str, Option<f32>)> = columns
        .iter()
        .rev()
        .take(23)
        .map(|column| (column.name.as_str(), column.scale))
        .collect();
    let named = |name: &str| ["Down", "Up", "Right", "Left"].map(|heading| format!("{name}={heading}"));
    let (headings, exits) = (named("Heading"), named("Exit"));
    let map = world.map();
    #[allow(clippy::cast_precision_loss)]
    let expected = [
        ("Tick", Some(world.scenario.task.as_ref().unwrap().horizon as f32)),
        ("Distance", Some(32.0)),
        ("Clearance", Some(32.0)),
        ("Right_of_way=mutual", None),
        ("Right_of_way=first", None),
        ("Right_of_way=yields", None),
        ("Light=green", None),
        ("Light=yellow", None),
        ("Light=red", None),
        ("Limit", Some(100.0)),
        (&exits[0], None),
        (&exits[1], None),
        (&exits[2], None),
        (&exits[3], None),
        ("Intersection", Some(map.intersections() as f32)),
        ("Remaining", Some((map.rows() + map.cols()) as f32)),
        ("Waited", Some(world.scenario.task.as_ref().unwrap().horizon as f32)),
        ("Priority", Some(oracle.priority_scale())),
        (&headings[0], None),
        (&headings[1], None),
        (&headings[2], None),
        (&headings[3], None),
        ("Speed", Some(3.0)),
    ];
    assert_eq!(scales, expected);
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut observer = Observer::new(Arc::clone(&oracle), 0);
    observer.begin(&city);
    let mut observation = vec![f32::NAN; oracle.width()];
    let (mut most, mut waits) = (0, 0);
    for _ in 0..80 {
        observer.look(&city).unwrap();
        observer.write(&mut observation);
        let seen: Vec<&Agent> = observer.entities().map(|at| &city.agents()[at]).collect();
        most = most.max(seen.len());
        let mut rest = &observation[..];
        for column in &columns {
            let (numbers, after) = rest.split_at(column.width);
            rest = after;
            let (name, heading) = column.name.split_once('=').unwrap_or((&column.name, ""));
            for (place, number) in numbers.iter().enumerate() {
                let number = (number * column.scale.unwrap_or(1.0)).round() as i64;
                let agent = seen.get(place).filter(|_| column.arity == 1);
                let expected = match (name, agent) {
                    ("Speed", Some(agent)) => i64::from(agent.speed),
                    ("Waited", Some(agent)) => i64::from(agent.waited),
                    ("Remaining", Some(agent)) => i64::from(agent.remaining()),
                    ("Priority", Some(agent)) => i64::from(agent.priority),
                    ("Tick", Some(_)) => i64::try_from(city.now()).unwrap(),
                    ("Exit", Some(agent)) => i64::from(agent.exit(map).is_some_and(|exit| exit.name() == heading)),
                    ("Heading", Some(agent)) => i64::from(agent.heading.is_some_and(|now| now.name() == heading)),
                    ("Intersection", Some(agent)) => map.intersection(agent.kind, agent.cell).unwrap_or(0).into(),
                    ("Distance", _) => match [seen.get(place / 4), seen.get(place % 4)] {
                        [Some(x), Some(y)] => x.cell.distance(y.cell).round() as i64,
                        _ => 0,
                    },
                    (_, None) if column.arity == 1 => 0,
                    _ => continue,
                };
                assert_eq!(number, expected, "{name} at {place}");
                waits += i64::from(name == "Waited") * number;
            }
        }
        city.tick(&[]).unwrap();
    }
    assert!(most == 4 && waits > 10, "{most} {waits}");
}

fn answer(rules: &str, executor: Executor, scene: &str) -> Result<serde_json::Value, String> {
    agreement::answer(&with_quantities(rules, |_| ()).0, executor, BuiltinFiles, scene)
}

#[test]
fn scenes_state_quantities() {
    const RULES: &str = "Stop(X) :- Waited(X, n), Waited(Y, m), n < m.
Slow(X) :- Heading(X, \"Up\"), Tick(t), t >= 5.
Fast(X) :- Distance(X, Y, d), d < 3.5, Remaining(Y, 7).
";
    let agents = r#"{"map": "square-5x5", "tick": 5, "agents": [
        {"id": "Car_1", "type": "Car", "at": [102, 20], "heading": "Up", "waited": 1},
        {"id": "Car_2", "type": "Car", "at": [102, 23], "speed": 2, "waited": 3, "remaining": 7,
         "exit": "Left"}]}"#;
    let symbols = r#"{"entities": ["e0", "e1"], "ego": "e0", "facts": {
        "Waited": [["e0", 1], ["e1", 3]], "Heading": [["e0", "Up"]], "Tick": [5], "Distance": [["e0", "e1", 3.5]]}}"#;
    for executor in [Executor::Dense, Executor::Relational] {
        let found = answer(RULES, executor, agents).unwrap();
        assert_eq!(
            found["egos"]["Car_1"]["derived"],
            serde_json::json!(["Slow", "Fast", "Stop"])
        );
        let known = &found["egos"]["Car_2"]["true"];
        assert_eq!(known["Speed"], serde_json::json!([["Car_2", 2], ["Car_1", 0]]));
        assert_eq!(known["Tick"], serde_json::json!([5]));
        assert_eq!(
            known["Distance"],
            serde_json::json!([["Car_2", "Car_1", 3.0], ["Car_1", "Car_2", 3.0]])
        );
        assert_eq!(known["Heading"], serde_json::json!([["Car_1", "Up"]]));
        assert_eq!(known["Exit"], serde_json::json!([["Car_2", "Left"]]));
        let found = answer(RULES, executor, symbols).unwrap();
        assert_eq!(found["egos"]["e0"]["derived"], serde_json::json!(["Slow", "Stop"]));
        assert_eq!(
            found["egos"]["e0"]["true"]["Distance"],
            serde_json::json!([["e0", "e1", 3.5]])
        );
    }
    let faulty = |facts: &str| {
        let scene = format!(r#"{{"entities": ["e0"], "ego": "e0", "facts": {facts}}}"#);
        answer(RULES, Executor::Auto, &scene).unwrap_err()
    };
    for (facts, message) in [
        (r#"{"Waited": [["e0", 1], ["e0", 2]]}"#, "a second value of `Waited`"),
        (
            r#"{"Waited": ["e0"]}"#,
            "a row of 1 term; the quantity takes 1 name and a value",
        ),
        (r#"{"Waited": [["e0", 1.5]]}"#, "not a scene"),
        (r#"{"Heading": [["e0", "North"]]}"#, "`North` is not a heading"),
    ] {
        let found = faulty(facts);
        assert!(found.contains(message), "{found}");
    }
}

#[test]
fn rules_that_read_quantities_are_refused_where_facts_have_no_values() {
    let (world, _) = with_quantities("Stop(X) :- Waited(X, n), n < 3.", |_| ());
    let fault = world.vocabulary.without_quantities("questions").unwrap_err();
    assert_eq!(
        fault.message,
        "questions contain no quantities, but the rules declare `Speed` as input"
    );
}
