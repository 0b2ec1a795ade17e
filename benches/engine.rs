//! The engine on programs with known answers, beside the same programs written by hand on datafrog.
//!
//! `cargo bench --bench engine` prints times; each case checks its number of rows before it is timed. Times include loading the
//! base facts into a fresh session.

#[path = "../tests/plain_rules/mod.rs"]
mod plain_rules;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use datafrog::{Iteration, Relation};
use logicity::engine::{Program, Session, naive};
use logicity::lang::Value;
use plain_rules::program;
use std::hint::black_box;

const TRANSITIVE: &str = "Path(x, y) :- Edge(x, y)
    Path(x, z) :- Path(x, y), Edge(y, z)";
const SAME_GENERATION: &str = "Same(x, y) :- Parent(x, p), Parent(y, p)
    Same(x, y) :- Parent(x, p), Same(p, q), Parent(y, q)";

/// A fixed congruential generator.
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
    let base = program.relation(base).expect("the program has it");
    for &(a, b) in rows {
        session
            .insert(base, &[Value(a), Value(b)])
            .expect("it is a base relation of two columns");
    }
    session
}

fn derived_rows(program: &Program, base: &str, derived: &str, rows: &[(u32, u32)]) -> usize {
    let mut session = load(program, base, rows);
    session.commit().expect("within the limit");
    session.len(program.relation(derived).expect("the program has it"))
}

fn transitive_by_hand(edges: &[(u32, u32)]) -> usize {
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

fn same_generation_by_hand(parent: &[(u32, u32)]) -> usize {
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

fn fixpoints(c: &mut Criterion) {
    type ByHand = fn(&[(u32, u32)]) -> usize;
    let cases: [(&str, &str, [&str; 2], Vec<(u32, u32)>, ByHand, usize); 3] = [
        (
            "transitive_closure/random_2k_6k",
            TRANSITIVE,
            ["Edge", "Path"],
            random_graph(),
            transitive_by_hand,
            3_498_323,
        ),
        (
            "transitive_closure/chain_2k",
            TRANSITIVE,
            ["Edge", "Path"],
            chain(),
            transitive_by_hand,
            2_001_000,
        ),
        (
            "same_generation/tree_4k",
            SAME_GENERATION,
            ["Parent", "Same"],
            tree(),
            same_generation_by_hand,
            5_592_404,
        ),
    ];
    for (name, rules, [base, derived], rows, by_hand, expected) in cases {
        let program = program(&[rules]);
        assert_eq!(derived_rows(&program, base, derived, &rows), expected, "{name}");
        assert_eq!(by_hand(&rows), expected, "{name} by hand");
        let mut group = c.benchmark_group(name);
        group.sample_size(10);
        group.bench_function("engine", |b| {
            b.iter(|| derived_rows(&program, base, derived, black_box(&rows)))
        });
        group.bench_function("datafrog", |b| b.iter(|| by_hand(black_box(&rows))));
    }
}

/// A city's crossing rules over 18 entities: what a small tick costs.
fn ticks(c: &mut Criterion) {
    let program = program(&[
        "Stop(x) :- At(x), Sees(x, y), In(y), !Amb(x), !Old(x)
         Stop(x) :- At(x), Sees(x, y), At(y), Higher(y, x), !Amb(x), !Old(x)
         Stop(x) :- In(x), Sees(x, y), In(y), Amb(y), !Amb(x), !Old(x)
         Stop(x) :- Car(x), Sees(x, y), Left(y, x), Close(y, x), Police(y), !Amb(x), !Police(x), !In(x), !At(x)
         Stop(x) :- Bus(x), Sees(x, y), Right(y, x), Next(y, x), Ped(y), !In(x), !At(x)
         Stop(x) :- Amb(x), Sees(x, y), Right(y, x), Old(y)
         Stop(x) :- Sees(x, y), Colliding(x, y), !Amb(x), !Old(x)",
        "Slow(x) :- Tiro(x), Sees(x, y), Ped(y), Close(x, y), !Stop(x)
         Slow(x) :- Tiro(x), In(x), Sees(x, y), At(y), !Stop(x)
         Slow(x) :- Police(x), Sees(x, y), Sees(x, z), Young(y), Young(z), Next(y, z), !Stop(x)",
        "Fast(x) :- Reckless(x), Sees(x, y), At(y), !Stop(x), !Slow(x)
         Fast(x) :- Bus(x), !Stop(x), !Slow(x)
         Fast(x) :- Police(x), Sees(x, y), Reckless(y), !Stop(x), !Slow(x)",
    ]);
    let unary = [
        "Car", "Ped", "Amb", "Old", "At", "In", "Police", "Bus", "Tiro", "Young", "Reckless",
    ];
    let binary = ["Sees", "Higher", "Left", "Right", "Close", "Next", "Colliding"];
    let rel = |name: &str| program.relation(name).expect("the program has it");
    // Facts of an imagined tick: one in four of the unary ones, one in four of the binary ones.
    let facts = |seed: u64| {
        let mut random = generator(seed);
        let mut facts = Vec::new();
        for x in 0..18 {
            facts.extend(
                unary
                    .iter()
                    .filter(|_| random() % 4 == 0)
                    .map(|name| (rel(name), vec![Value(x)])),
            );
            for y in (0..18).filter(|&y| y != x) {
                let present = binary.iter().filter(|_| random() % 4 == 0);
                facts.extend(present.map(|name| (rel(name), vec![Value(x), Value(y)])));
            }
        }
        facts
    };
    let (even, odd) = (facts(1), facts(2));
    let switch = |session: &mut Session, from: &[_], to: &[_]| {
        let (from, to): (&[(_, Vec<Value>)], &[(_, Vec<Value>)]) = (from, to);
        from.iter()
            .for_each(|(rel, row)| session.retract(*rel, row).expect("a base relation"));
        to.iter()
            .for_each(|(rel, row)| session.insert(*rel, row).expect("a base relation"));
    };
    let mut session = program.session();
    switch(&mut session, &[], &even);
    let delta = session.commit().expect("within the limit");
    let expected = naive::evaluate(program.rules(), session.symbols(), even.iter().cloned());
    for action in ["Stop", "Slow", "Fast"] {
        let added = &delta.of(rel(action)).expect("some agent does it").added;
        assert!(added.iter().eq(&expected[rel(action).index()]), "{action}");
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
            if session.contains(rel("In"), &row) {
                session.retract(rel("In"), &row)
            } else {
                session.insert(rel("In"), &row)
            }
            .expect("a base relation");
            session.commit()
        });
    });
    group.bench_function("first_commit", |b| {
        let fresh = || {
            let mut session = program.session();
            switch(&mut session, &[], &even);
            session
        };
        b.iter_batched(fresh, |mut session| session.commit(), BatchSize::SmallInput);
    });
}

criterion_group!(benches, fixpoints, ticks);
criterion_main!(benches);
