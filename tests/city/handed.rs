//! Rules that the dense executor supports in part: it hands the other clauses over to a session.

use crate::agreement::{Counts, multiply, simulation};
use crate::shipped_world::configured;
use logicity::city::{Action, Split};
use logicity::config::Scenario;
use logicity::diag::codes;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Executor, Settings, Simulation, World};
use std::sync::Arc;

const CONFIG: &str = "base: expert
predicates:
  define:
    Waited: {quantity: waited}
    Speed: {quantity: speed}
    Distance: {quantity: distance}
    Tick: {quantity: tick}
    Heading: {quantity: heading}
";

/// Predicates with clauses that need the relational executor, beside others that do not.
const DECLARED: &str = ".include \"vocabulary.dl\"
.decl Waited, Speed(x: agent, n: number)
.decl Distance(x: agent, y: agent, d: float)
.decl Tick(t: number)
.decl Heading(x: agent, h: symbol)
.input Waited, Speed, Distance, Tick, Heading
.decl Vertical, Driven(h: symbol)
.decl Opposite(h: symbol, g: symbol)
.decl Favorite(x: agent, h: symbol)
.decl Named(x: agent)
Named(x) :- x = \"Car_2\".
Named(X) :- IsBus(X), X != \"Car_1\".
Vertical(\"Up\"). Vertical(\"Down\").
Opposite(\"Up\", \"Down\"). Opposite(\"Down\", \"Up\"). Opposite(\"Left\", \"Right\"). Opposite(\"Right\", \"Left\").
Favorite(\"Car_1\", \"Up\"). Favorite(\"Car_3\", \"Left\").
Favorite(X, h) :- Heading(X, h), IsTiro(X).
.decl Chained, Near(x: agent, y: agent)
.decl Crowded, Even, Odd, Halted(x: agent)
.decl Between(x: agent, y: agent, z: agent)
.decl Gap(x: agent, n: number)
.decl Jam()
Chained(X, Y) :- NextTo(X, Y).
Chained(X, Z) :- Chained(X, Y), NextTo(Y, Z).
Near(X, Y) :- IsClose(X, Y).
Near(X, Y) :- Sees(X, Y), Gap(X, n), Waited(Y, m), m > n.
Near(X, X) :- IsInInter(X), Jam().
Crowded(X) :- IsAtInter(X), n = count : { Sees(X, _) }, m = count : { Near(X, _) }, n < 3 * m.
Crowded(X) :- IsInInter(X), IsBus(X).
Crowded(\"Car_2\").
Even(X) :- IsAtInter(X).
Even(X) :- Odd(Y), NextTo(X, Y).
Odd(X) :- Even(Y), NextTo(X, Y).
Halted(X) :- Waited(X, n), n > 1.
Between(X, Y, Z) :- Sees(X, Y), Sees(X, Z), NextTo(Y, Z).
Gap(X, n) :- IsCar(X), n = min d : { Waited(Y, d), Sees(X, Y) }.
.scope
Driven(h) :- Heading(Y, h), IsBus(Y).
Jam() :- n = count : { Waited(Y, m), m > 2 }, n > 2.
.scope Sees
";

/// Random clauses of actions, about a third of which the dense executor does not support.
fn random_rules(random: &mut impl RngExt) -> String {
    // Each fact has its own variables.
    const FACTS: [&str; 35] = [
        "Sees(X, Y#)",
        "IsClose(X, Y#), Not(IsAtInter(Y#))",
        "NextTo(Y#, X)",
        "Not(IsInInter(X))",
        "Waited(X, n#), n# > 2",
        "Speed(Y#, n#), n# != 1",
        "Chained(X, Y#)",
        "Chained(Y#, X), IsBus(Y#)",
        "Not(Chained(X, _))",
        "Near(X, Y#), Not(IsBus(Y#))",
        "Near(Y#, X)",
        "Near(X, X)",
        "n# = count : { Near(X, _) }, n# > 2",
        "Crowded(X)",
        "Sees(X, Y#), Not(Crowded(Y#))",
        "Even(X)",
        "Odd(Y#), Sees(X, Y#)",
        "Between(X, Y#, Z#), Waited(Z#, n#), n# < 3",
        "Gap(X, n#), n# < 2",
        "Jam()",
        "Not(Jam())",
        "Waited(X, a#), Waited(Y#, b#), Waited(Z#, c#), a# + b# > c#",
        "once[1,4] Crowded(X)",
        "Not(historically[1,3] Halted(X))",
        "Heading(X, h#), Vertical(h#)",
        "Heading(X, h#), Not(Vertical(h#))",
        "Heading(X, h#), Heading(Y#, g#), Opposite(h#, g#)",
        "Heading(X, h#), Favorite(X, h#)",
        "Favorite(Y#, _), Sees(X, Y#)",
        "Heading(X, h#), Driven(h#)",
        "Heading(Y#, h#), Driven(h#), h# != \"Up\"",
        "Driven(_), IsAtInter(X)",
        "Sees(X, Y#), Y# != \"Car_2\"",
        "X != \"Car_1\", IsInInter(X)",
        "Named(Y#), NextTo(X, Y#)",
    ];
    let mut clauses = String::new();
    for head in ["Stop", "Slow", "Fast"] {
        for _ in 0..random.random_range(1..4) {
            let mut body = vec![["IsCar(X)", "IsAtInter(X)", "Sees(X, W)"][random.random_range(0..3)].to_owned()];
            for fact in 0..random.random_range(1..3) {
                let chosen = FACTS[random.random_range(0..FACTS.len())];
                body.push(chosen.replace('#', &fact.to_string()));
            }
            let chance = if random.random_bool(0.2) { "0.7 :: " } else { "" };
            clauses += &format!("{chance}{head}(X) :- {}.\n", body.join(", "));
        }
    }
    clauses
}

fn world(rules: &str, edit: impl FnOnce(&mut Scenario)) -> Arc<World> {
    configured(CONFIG, &format!("{DECLARED}{rules}"), edit).0
}

fn uncounted(world: &Arc<World>, threads: usize) -> Simulation {
    let settings = Settings {
        threads,
        ..Settings::default()
    };
    Simulation::new(Arc::clone(world), Split::Test, Seed(3), settings).unwrap()
}

/// Clauses that a session evaluates decide as if it evaluated all, in cities of every shape, with and without counting.
#[test]
fn clauses_that_are_handed_over_decide_as_the_relational_executor_does() {
    let mut counts = Counts::default();
    let shapes = [
        (1, 24),
        (1, 24),
        (1, 24),
        (1, 24),
        (1, 24),
        (1, 24),
        (5, 12),
        (5, 12),
        (20, 3),
    ];
    let (mut handed, mut dense) = (0, 0);
    for (case, (times, ticks)) in shapes.into_iter().enumerate() {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let world = world(&rules, |scenario| multiply(scenario, times));
        let mut cities = [
            simulation(&world, Executor::Relational, 1),
            simulation(&world, Executor::Auto, 1),
            simulation(&world, Executor::Auto, 2),
        ];
        let mut without_counts = [uncounted(&world, 1), uncounted(&world, 2)];
        assert_eq!(cities[1].executor(), Executor::Dense, "{rules}");
        match cities[1].fallback() {
            Some(_) => handed += 1,
            None => dense += 1,
        }
        for _ in 0..ticks {
            counts.go_the_same_way(&mut cities, 1);
            for city in &mut without_counts {
                assert_eq!(city.tick(&[]).unwrap().agents, cities[0].report().agents, "{rules}");
            }
        }
        // A new run of the same cities begins without memory.
        for city in cities.iter_mut().chain(&mut without_counts) {
            city.restart_drawn(Seed(9), |_| ()).unwrap();
        }
        counts.go_the_same_way(&mut cities, 2);
        for city in &mut without_counts {
            city.tick(&[]).unwrap();
            assert_eq!(city.tick(&[]).unwrap().agents, cities[0].report().agents, "{rules}");
        }
    }
    assert!(handed > 5, "{handed} {dense}");
    counts.check();
}

/// The reason names a clause, and the snapshot for explanations has all rows.
#[test]
fn the_fallback_names_the_first_clause_that_is_handed_over() {
    let world = world("Stop(X) :- Near(X, Y), IsBus(Y).\nSlow(X) :- Gap(X, n), n > 3.", |_| ());
    // Without counts, a session evaluates only what decides.
    let mut city = uncounted(&world, 1);
    let reason = city.fallback().unwrap();
    assert_eq!(reason.code, logicity::sim::codes::DENSE_UNSUPPORTED);
    assert_eq!(
        reason.message,
        "the relational executor evaluates some clauses, the first because a clause of `Gap` aggregates with `min`"
    );
    city.tick(&[]).unwrap();
    let stop = world.vocabulary.action(Action::Stop).unwrap();
    let stopped = city
        .report()
        .agents
        .iter()
        .filter(|done| done.derived.contains(Action::Stop))
        .count();
    let snapshot = city.snapshot().unwrap();
    assert_eq!(snapshot.session().encoded_rows(stop).count(), stopped);
}

/// What the relational executor derives keeps to the limits of the world.
#[test]
fn clauses_that_are_handed_over_keep_to_the_limits() {
    let mut world = world("Stop(X) :- Between(X, Y, Z), Waited(Z, n), n < 3.", |_| ());
    Arc::get_mut(&mut world).unwrap().limits.rows = 3;
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut ticks = 0;
    let fault = loop {
        match city.tick(&[]) {
            Ok(_) => ticks += 1,
            Err(fault) => break fault,
        }
        assert!(ticks < 200, "no limit was hit");
    };
    assert_eq!(fault.code, codes::LIMIT_EXCEEDED);
    assert_eq!(city.now(), ticks);

    // The facts of all pairs exceed the limit before the session sees them.
    let mut world = self::world("Stop(X) :- Between(X, Y, Z), Waited(Z, n), n < 3.", |scenario| {
        multiply(scenario, 5);
        scenario.view = 1000;
    });
    Arc::get_mut(&mut world).unwrap().limits.bytes = 20_000;
    let fault = uncounted(&world, 1).tick(&[]).unwrap_err();
    assert_eq!(fault.code, codes::LIMIT_EXCEEDED);
    assert!(
        fault.message.contains("the facts about the agents"),
        "{}",
        fault.message
    );
}

/// Constants that name no agent cannot be rows of bits, but `_` sees them: the city goes on without the dense executor.
#[test]
fn rows_about_no_agent_end_the_dense_executor() {
    let rules = ".include \"vocabulary.dl\"
.scope
.decl Wanted(x: agent)
Wanted(\"Nobody\") :- IsInInter(X), IsCar(X).
Stop(X) :- IsAtInter(X), Wanted(_).
";
    let world = configured("base: expert", rules, |_| ()).0;
    let mut cities = [
        simulation(&world, Executor::Relational, 1),
        simulation(&world, Executor::Auto, 1),
    ];
    assert_eq!(cities[1].executor(), Executor::Dense);
    Counts::default().go_the_same_way(&mut cities, 200);
    let message = &cities[1].fallback().unwrap().message;
    assert!(message.contains("something that is no agent"), "{message}");
    assert_eq!(cities[1].executor(), Executor::Relational);
}
