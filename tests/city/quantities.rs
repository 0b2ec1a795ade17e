//! Quantities: base predicates with values, in rules, runs, scenes, traces and observations.

use crate::shipped_world::world;
use logicity::city::Split;
use logicity::config::{PredicateConfig, Scenario};
use logicity::datalog::Value;
use logicity::located::Located;
use logicity::predicate::Quantity;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Executor, Settings, Simulation, World};
use std::sync::Arc;

/// The declarations of all quantities, which have the names of [`name`].
const DECLARED: &str = ".include \"vocabulary.dl\"
.decl Speed, Priority, Waited, Remaining(x: agent, n: number)
.decl Heading(x: agent, h: symbol)
.decl Distance(x: agent, y: agent, d: float)
.decl Tick(t: number)
.input Speed, Priority, Waited, Remaining, Heading, Distance, Tick
";

/// The name of the predicate of a quantity in these tests.
fn name(quantity: Quantity) -> String {
    let name = quantity.name();
    name[..1].to_uppercase() + &name[1..]
}

/// Defines all quantities.
fn define(scenario: &mut Scenario) {
    let span = scenario.predicates[0].name.span;
    scenario.predicates.extend(Quantity::ALL.map(|quantity| PredicateConfig {
        name: Located {
            value: name(quantity),
            span,
        },
        definition: quantity.into(),
    }));
}

/// Repeats the agents of the test split on the whole map.
fn multiply(scenario: &mut Scenario, times: u32) {
    let mut splits = scenario.splits.iter_mut();
    let (_, set) = splits.find(|(split, _)| *split == Split::Test).unwrap();
    (set.region, set.repeat) = (None, times);
}

/// Random rules: clauses of actions with conditions on the quantities of one agent or two.
fn random_rules(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 20] = [
        "Waited(X, n), n > 2",
        "Waited(X, n), n >= 1, n < 6",
        "Speed(X, 2)",
        "Not(Speed(X, 0))",
        "Speed(Y, n), n != 1",
        "Heading(X, \"Up\")",
        "Sees(X, Y), Not(Heading(Y, \"Left\"))",
        "Heading(X, h), Heading(Y, h)",
        "Heading(Y, _)",
        "Priority(X, n), Priority(Y, m), n < m",
        "Distance(X, Y, d), d < 8.5",
        "Distance(Y, X, d), d >= 4.0, d <= 15.0",
        "Tick(n), n % 7 < 3",
        "Tick(n), Waited(X, m), n - m > 20",
        "Remaining(X, n), n < 20",
        "Waited(X, n), Waited(Y, m), n > m",
        "Waited(Y, n), Speed(Y, m), n + m * 2 > 3",
        "n = 1, Speed(Y, n)",
        "IsClose(X, Y)",
        "Sees(X, Y), Not(IsAtInter(Y))",
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
    format!("{DECLARED}{clauses}")
}

fn simulation(world: &Arc<World>, executor: Executor, threads: usize) -> Simulation {
    let settings = Settings {
        executor,
        count_firings: true,
        threads,
    };
    Simulation::new(Arc::clone(world), Split::Test, Seed(3), settings).unwrap()
}

/// The dense executor evaluates conditions on quantities, in cities of every shape, as the relational one does.
#[test]
fn executors_agree_on_random_rules_with_quantities() {
    let (mut actions, mut fired) = ([0; 4], 0);
    for (case, &(times, threads)) in [(1, 1), (1, 1), (1, 1), (5, 1), (5, 1), (20, 1), (20, 2)].iter().enumerate() {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let world = world("expert", Some(&rules), |scenario| {
            define(scenario);
            if times > 1 {
                multiply(scenario, times);
            }
        });
        let mut dense = simulation(&world, Executor::Dense, threads);
        let mut relational = simulation(&world, Executor::Relational, 1);
        for tick in 0..if times < 20 { 80 } else { 12 } {
            let expected = relational.tick(&[]).unwrap().clone();
            let found = dense.tick(&[]).unwrap();
            for (agent, (one, other)) in expected.agents.iter().zip(&found.agents).enumerate() {
                assert_eq!(one, other, "agent {agent} in tick {tick} under\n{rules}");
                actions[one.action as usize] += 1;
            }
            assert_eq!(dense.firings(), relational.firings(), "tick {tick} under\n{rules}");
            fired += dense.firings().iter().filter(|count| **count > 0).count();
        }
    }
    assert!(actions.iter().all(|count| *count > 100) && fired > 500, "{actions:?} {fired}");
}

/// Quantities are what a spectator of the run counts.
#[test]
fn quantities_count_what_the_reports_of_the_ticks_show() {
    let rules = format!("{DECLARED}Stop(X) :- CollidingClose(X, Y), Waited(X, n), n < 9.");
    let world = world("expert", Some(&rules), define);
    let mut city = simulation(&world, Executor::Auto, 1);
    let position = |quantity: Quantity| {
        let mut known = world.vocabulary.predicates.iter();
        known.position(|known| known.quantity() == Some(quantity)).unwrap()
    };
    let agents = city.agents().len();
    let (mut waited, mut speed) = (vec![0; agents], vec![0; agents]);
    let mut longest = 0;
    for tick in 0..400 {
        let before: Vec<_> = city.agents().to_vec();
        let moved: Vec<_> = city.tick(&[]).unwrap().agents.iter().map(|done| done.moved).collect();
        let facts = city.facts(|_| true).unwrap();
        let values = |quantity| {
            let (rows, values) = (&facts.rows[position(quantity)], &facts.values[position(quantity)]);
            assert_eq!(rows.len(), values.len());
            rows.iter().zip(values).map(|(row, value)| (row.map(|agent| agent as usize), *value))
        };
        let numbers = |quantity| values(quantity).map(|(_, value)| value.as_number()).collect::<Vec<_>>();
        assert_eq!(values(Quantity::Tick).collect::<Vec<_>>(), [([0, 0], Value::number(tick))]);
        assert_eq!(numbers(Quantity::Waited), waited);
        assert_eq!(numbers(Quantity::Speed), speed);
        let remaining = before.iter().map(|agent| agent.route().cells().count() - 1 - agent.position());
        assert_eq!(numbers(Quantity::Remaining), remaining.map(|cells| cells as i32).collect::<Vec<_>>());
        assert_eq!(numbers(Quantity::Priority), before.iter().map(|agent| agent.priority).collect::<Vec<_>>());
        for ([agent, _], value) in values(Quantity::Heading) {
            assert_eq!(before[agent].heading.unwrap() as u32, value.0);
        }
        for ([x, y], value) in values(Quantity::Distance) {
            let (dx, dy) = (before[x].cell.row - before[y].cell.row, before[x].cell.col - before[y].cell.col);
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
    assert!(longest > 5, "{longest}");
}
