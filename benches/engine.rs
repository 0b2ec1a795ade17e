//! Benchmarks of the engine on programs with known answers, and of the same programs hand-written with datafrog.
//!
//! `cargo bench --bench engine` prints times. Each case checks its number of rows first. Times include loading the base
//! facts into a new session.

#[path = "../tests/root.rs"]
mod root;
#[path = "../tests/datalog/written_program.rs"]
mod written_program;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use datafrog::{Iteration, Relation};
use logicity_datalog::{PredicateId, Value};
use logicity_datalog::{Program, Session, naive};
use std::hint::black_box;
use std::time::Duration;
use written_program::program;

const TRANSITIVE: &str = ".decl Edge(x: number, y: number)
    .decl Path(x: number, y: number)
    Path(x, y) :- Edge(x, y).
    Path(x, z) :- Path(x, y), Edge(y, z).";
const SAME_GENERATION: &str = ".decl Parent(child: number, parent: number)
    .decl Same(x: number, y: number)
    Same(x, y) :- Parent(x, p), Parent(y, p).
    Same(x, y) :- Parent(x, p), Same(p, q), Parent(y, q).";

/// A linear congruential generator with a fixed seed.
fn generator(seed: u64) -> impl FnMut() -> u32 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u32
    }
}

/// 6,000 edges over 2,000 nodes.
fn random_graph() -> Vec<(u32, u32)> {
    let mut random = generator(1);
    (0..6_000).map(|_| (random() % 2_000, random() % 2_000)).collect()
}

fn chain() -> Vec<(u32, u32)> {
    (0..2_000).map(|node| (node, node + 1)).collect()
}

/// Child and parent in a complete binary tree of 4,095 nodes.
fn tree() -> Vec<(u32, u32)> {
    (2..4_096).map(|node| (node, node / 2)).collect()
}

fn load(program: &Program, base: &str, rows: &[(u32, u32)]) -> Session {
    let mut session = program.session();
    let base = program.predicate(base).expect("the program has it");
    let rows = rows.iter().map(|&(a, b)| [Value(a), Value(b)]);
    session
        .insert_all(base, rows)
        .expect("it is a base predicate of two columns");
    session
}

fn derived_rows(program: &Program, base: &str, derived: &str, rows: &[(u32, u32)]) -> usize {
    let mut session = load(program, base, rows);
    session.commit().expect("within the limit");
    session.len(program.predicate(derived).expect("the program has it"))
}

fn transitive_datafrog(edges: &[(u32, u32)]) -> usize {
    let edges: Relation<(u32, u32)> = edges.iter().collect();
    let mut iteration = Iteration::new();
    // Path(x, y) as (y, x).
    let path = iteration.variable::<(u32, u32)>("path");
    path.extend(edges.iter().map(|&(x, y)| (y, x)));
    while iteration.changed() {
        path.from_join(&path, &edges, |_, &x, &z| (z, x));
    }
    path.complete().len()
}

fn same_generation_datafrog(parent: &[(u32, u32)]) -> usize {
    let children: Relation<(u32, u32)> = parent.iter().map(|&(x, p)| (p, x)).collect();
    let mut iteration = Iteration::new();
    let same = iteration.variable::<(u32, u32)>("same");
    let half = iteration.variable::<(u32, u32)>("half");
    same.insert(Relation::from_join(&children, &children, |_, &x, &y| (x, y)));
    while iteration.changed() {
        half.from_join(&same, &children, |_, &q, &x| (q, x));
        same.from_join(&half, &children, |_, &x, &y| (x, y));
    }
    same.complete().len()
}

/// A program with one derived predicate over one base predicate of pairs.
struct Case {
    name: &'static str,
    rules: &'static str,
    base: &'static str,
    derived: &'static str,
    rows: Vec<(u32, u32)>,
    datafrog: fn(&[(u32, u32)]) -> usize,
    expected: usize,
}

fn fixpoints(c: &mut Criterion) {
    let closure = |name, rows, expected| Case {
        name,
        rules: TRANSITIVE,
        base: "Edge",
        derived: "Path",
        rows,
        datafrog: transitive_datafrog,
        expected,
    };
    let cases = [
        closure("transitive_closure/random_2k_6k", random_graph(), 3_498_323),
        closure("transitive_closure/chain_2k", chain(), 2_001_000),
        Case {
            name: "same_generation/tree_4k",
            rules: SAME_GENERATION,
            base: "Parent",
            derived: "Same",
            rows: tree(),
            datafrog: same_generation_datafrog,
            expected: 5_592_404,
        },
    ];
    for case in cases {
        let program = program(case.rules);
        let run = |rows: &[(u32, u32)]| derived_rows(&program, case.base, case.derived, rows);
        assert_eq!(run(&case.rows), case.expected, "{}", case.name);
        assert_eq!((case.datafrog)(&case.rows), case.expected, "{}, datafrog", case.name);
        let mut group = c.benchmark_group(case.name);
        group.sample_size(10);
        group.bench_function("engine", |b| b.iter(|| run(black_box(&case.rows))));
        group.bench_function("datafrog", |b| b.iter(|| (case.datafrog)(black_box(&case.rows))));
    }
}

/// A predicate and one of its rows.
type Fact = (PredicateId, Vec<Value>);

/// The rules of the expert city over 18 entities: the cost of a small tick.
fn ticks(c: &mut Criterion) {
    let program = program(".include \"expert.dl\"");
    let inputs: Vec<PredicateId> = (program.rules().predicates.iter().zip((0..).map(PredicateId)))
        .filter_map(|(predicate, id)| predicate.input.then_some(id))
        .collect();
    let arity = |id: &PredicateId| program.rules().predicates[id.index()].arity();
    let id = |name: &str| program.predicate(name).expect("the program has it");
    // Facts of an invented tick: one in four of the possible ones.
    let facts = |seed: u64| {
        let mut random = generator(seed);
        let mut facts = Vec::new();
        for (x, y) in (0..18).flat_map(|x| (0..18).map(move |y| (x, y))) {
            let wanted = if x == y { 1 } else { 2 };
            let present = inputs
                .iter()
                .filter(|id| arity(id) == wanted && random().is_multiple_of(4));
            facts.extend(present.map(|&id| (id, vec![Value(x), Value(y)][..wanted].to_vec())));
        }
        facts
    };
    let (even, odd) = (facts(1), facts(2));
    let switch = |session: &mut Session, from: &[Fact], to: &[Fact]| {
        from.iter()
            .for_each(|(id, row)| session.retract(*id, row).expect("a base predicate"));
        to.iter()
            .for_each(|(id, row)| session.insert(*id, row).expect("a base predicate"));
    };
    let fresh = || {
        let mut session = program.session();
        (0..18).for_each(|entity| _ = session.intern(&format!("e{entity}")));
        switch(&mut session, &[], &even);
        session
    };
    let mut session = fresh();
    let delta = session.commit().expect("within the limit");
    let expected = naive::evaluate(program.rules(), session.symbols(), even.iter().cloned());
    for action in ["Stop", "Slow", "Fast"] {
        let added = &delta.of(id(action)).expect("an agent takes it").added;
        assert!(added.iter().eq(&expected[id(action).index()]), "{action}");
    }

    let mut group = c.benchmark_group("expert_18_entities");
    let mut now = false;
    group.bench_function("tick_all_facts_replaced", |b| {
        b.iter(|| {
            let (from, to) = if now { (&odd, &even) } else { (&even, &odd) };
            switch(&mut session, from, to);
            now = !now;
            session.commit()
        });
    });
    let row = [Value(0)];
    group.bench_function("tick_one_fact_changed", |b| {
        b.iter(|| {
            if session.contains(id("IsInInter"), row) {
                session.retract(id("IsInInter"), row)
            } else {
                session.insert(id("IsInInter"), row)
            }
            .expect("a base predicate");
            session.commit()
        });
    });
    group.bench_function("first_commit", |b| {
        b.iter_batched(&fresh, |mut session| session.commit(), BatchSize::SmallInput);
    });
}

/// The expert rules over 10,000 agents that each see few others: about 30,000 unary and 280,000 binary facts.
fn large_city(c: &mut Criterion) {
    let program = program(".include \"expert.dl\"");
    let inputs: Vec<PredicateId> = (program.rules().predicates.iter().zip((0..).map(PredicateId)))
        .filter_map(|(predicate, id)| predicate.input.then_some(id))
        .collect();
    let (unary, binary): (Vec<PredicateId>, Vec<PredicateId>) = inputs
        .iter()
        .partition(|id| program.rules().predicates[id.index()].arity() == 1);
    let mut session = program.session();
    let agents: Vec<Value> = (0..10_000).map(|agent| session.intern(&format!("a{agent}"))).collect();
    let mut random = generator(3);
    let mut facts: Vec<Fact> = Vec::new();
    for (position, &x) in agents.iter().enumerate() {
        facts.extend(
            unary
                .iter()
                .filter(|_| random().is_multiple_of(4))
                .map(|&id| (id, vec![x])),
        );
        for _ in 0..14 {
            // Agents see near agents, and near agents have near numbers.
            let y = agents[(position + random() as usize % 60) % agents.len()];
            let related = binary
                .iter()
                .filter(|&&id| id == binary[binary.len() - 1] || random().is_multiple_of(6));
            facts.extend(related.map(|&id| (id, vec![x, y])));
        }
    }
    let moving: Vec<Fact> = facts
        .iter()
        .filter(|(id, _)| binary.contains(id))
        .step_by(100)
        .cloned()
        .collect();
    facts
        .iter()
        .for_each(|(id, row)| session.insert(*id, row).expect("a base predicate"));
    session.commit().expect("within the limit");
    let actions =
        ["Stop", "Slow", "Fast"].map(|name| session.len(program.predicate(name).expect("the program has it")));
    assert_eq!(
        (facts.len(), moving.len(), actions),
        (307_867, 2_806, [5_407, 876, 2_010])
    );

    let mut group = c.benchmark_group("expert_10k_agents");
    group.sample_size(20);
    let mut present = true;
    group.bench_function("tick_1_percent_changed", |b| {
        b.iter(|| {
            present = !present;
            for (id, row) in &moving {
                if present {
                    session.insert(*id, row)
                } else {
                    session.retract(*id, row)
                }
                .expect("a base predicate");
            }
            session.commit()
        });
    });
    group.bench_function("first_commit", |b| {
        let fresh = || {
            let mut session = program.session();
            agents
                .iter()
                .zip(0..)
                .for_each(|(_, agent)| _ = session.intern(&format!("a{agent}")));
            facts
                .iter()
                .for_each(|(id, row)| session.insert(*id, row).expect("a base predicate"));
            session
        };
        b.iter_batched(fresh, |mut session| session.commit(), BatchSize::LargeInput);
    });
}

/// Loads large texts of two sizes into sessions. The second should take about twice the time of the first.
fn large_texts(c: &mut Criterion) {
    let declarations = ".decl P(x: symbol)\n.decl Q(x: symbol, y: symbol)\n.input Q\n.output P\n";
    let text = |count: usize, clause: &dyn Fn(usize) -> String| {
        (0..count).fold(declarations.to_owned(), |text, number| text + &clause(number))
    };
    let one_head = |number| format!("P(x) :- Q(x, y), y != \"{number}\".\n");
    let shared = |number| format!("P(x) :- Q(x, y), Q(y, z), Q(z, x), Q(x, \"{number}\").\n");
    let negations = |number| match number {
        0 => ".decl N0(x: symbol)\nN0(x) :- Q(x, x).\n".to_owned(),
        _ => format!(
            ".decl N{number}(x: symbol)\nN{number}(x) :- Q(x, _), !N{}(x).\n",
            number - 1
        ),
    };
    let facts = |number| format!("Q(\"{number}\", \"{}\").\n", number / 2);
    type Case = (&'static str, usize, fn(usize) -> String);
    let cases: [Case; 4] = [
        ("one_head", 2_500, one_head),
        ("shared_body", 2_500, shared),
        ("negations", 2_500, negations),
        ("facts", 50_000, facts),
    ];
    let mut group = c.benchmark_group("load");
    group.sample_size(10);
    for (name, count, clause) in cases {
        for count in [count, 2 * count] {
            let text = text(count, &clause);
            group.bench_function(format!("{name}/{count}"), |b| {
                b.iter(|| program(black_box(&text)).session());
            });
        }
    }
}

criterion_group! {
    name = benches;
    // Long enough for figures within some percent of each other; all of `cargo bench` takes minutes.
    config = Criterion::default().warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(3));
    targets = fixpoints, ticks, large_city, large_texts
}
criterion_main!(benches);
