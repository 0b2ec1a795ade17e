//! Compares the engine with its specification, and tests fixed examples.

use crate::cases::cases;
use crate::choice::Random;
use crate::random_program::agree::{agrees, database};
use crate::random_program::{Batch, Genome, computing_genomes, genomes, recursive_genomes};
use crate::written_program::program;
use logicity_datalog as datalog;
use logicity_datalog::cancel::Cancel;
use logicity_datalog::codes;
use logicity_datalog::diag::{self, MAX_FAULTS, Sources};
use logicity_datalog::{BaseType, ClauseId, InputPolicy, PredicateId, Rules, Value};
use logicity_datalog::{
    EvalError, Limits, Program, RowError, RuleStats, Session, Strategy, StratumStats, Threads, WorkCounts, facts, naive,
};
use proptest::prelude::*;
use proptest::strategy::Strategy as _;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// The least program.
const COPY: &str = ".decl Base(x: number)
    .decl Copy(x: number)
    Copy(x) :- Base(x).";

fn check_script(genome: &Genome) -> Result<(), TestCaseError> {
    let rules = genome.rules();
    agrees(&rules, &genome.batches(&rules))
}

/// Like `check_script` in a program with rows of twelve words, so that base predicates have narrow rows until they
/// change.
fn check_narrow(genome: &Genome) -> Result<(), TestCaseError> {
    let mut rules = genome.rules();
    let script = genome.batches(&rules);
    if let Some(mut wide) = rules.predicates.iter().find(|predicate| predicate.arity() > 0).cloned() {
        wide.name = "Wide".to_owned();
        wide.derived = false;
        wide.columns = vec![wide.columns[0].clone(); 12];
        rules.predicates.push(wide);
    }
    agrees(&rules, &script)
}

/// Threads that share all work, however small.
fn eager(count: usize) -> Threads {
    Threads {
        split_from: 0,
        ..Threads::new(count.try_into().unwrap())
    }
}

/// Cancels at the first poll after `polls` others, and counts polls.
fn counted_cancel(polls: u32) -> (Cancel, Arc<AtomicU32>) {
    let count = Arc::new(AtomicU32::new(0));
    let counter = Arc::clone(&count);
    (Cancel::when(move || counter.fetch_add(1, Relaxed) >= polls), count)
}

/// Runs the script with several numbers of threads. The results equal those with one, also beyond a limit.
fn check_threads(rules: &Rules, script: &[Batch], limits: Limits) -> Result<(), TestCaseError> {
    let program = Program::new(rules.clone()).expect("a generated program is safe and small");
    for strategy in [Strategy::Auto, Strategy::Maintain, Strategy::Recompute] {
        let mut sessions = [1, 2, 5].map(|count| {
            let mut session = program.session();
            session.set_strategy(strategy);
            session.set_threads(eager(count)).unwrap();
            session.set_limits(limits);
            session
        });
        for batch in script {
            for (present, id, row) in batch {
                for session in &mut sessions {
                    match present {
                        true => session.insert(*id, row).unwrap(),
                        false => session.retract(*id, row).unwrap(),
                    }
                }
            }
            let [one, others @ ..] = &mut sessions;
            let expected = one.commit();
            for session in others {
                prop_assert_eq!(&session.commit(), &expected);
                prop_assert_eq!(session.work(), one.work());
                prop_assert_eq!(database(session), database(one));
                prop_assert_eq!(session.symbols().len(), one.symbols().len());
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 20_000, ..cases(256) })]

    #[test]
    fn threads_change_nothing(
        genome in prop_oneof![genomes(1..4), recursive_genomes(1..4)],
        rows in prop_oneof![Just(usize::MAX), 0..60_usize],
        steps in prop_oneof![Just(u64::MAX), 0..2_000_u64],
        bytes in prop_oneof![Just(u64::MAX), 0..8_000_u64],
    ) {
        let rules = genome.rules();
        check_threads(&rules, &genome.batches(&rules), Limits { rows, steps, bytes })?;
    }

    #[test]
    fn aggregates_over_bodies_agree_with_naive((text, changes) in aggregating_programs()) {
        let program = program(&text);
        let (rules, script) = (program.rules(), aggregating_script(&program, &changes));
        agrees(rules, &script)?;
        check_threads(rules, &script, Limits::default())?;
    }

    #[test]
    fn correlated_aggregates_agree_with_naive(
        (text, changes) in correlated_programs(),
        steps in prop_oneof![Just(u64::MAX), 0..2_000_u64],
        bytes in prop_oneof![Just(u64::MAX), 0..8_000_u64],
    ) {
        let program = program(&text);
        let (rules, script) = (program.rules(), aggregating_script(&program, &changes));
        agrees(rules, &script)?;
        check_threads(rules, &script, Limits { rows: usize::MAX, steps, bytes })?;
    }
}

/// Programs with aggregates over values that only a recursion provides, and changes of their predicates.
fn correlated_programs() -> impl proptest::strategy::Strategy<Value = (String, Vec<ChangeGenes>)> {
    use proptest::collection::vec;
    let clause =
        (any::<[u8; 8]>(), vec(any::<[u8; 3]>(), 1..3)).prop_map(|(genes, atoms)| correlated_clause(genes, &atoms));
    let changes = vec(
        vec((prop::bool::weighted(0.7), any::<u8>(), any::<[u8; 2]>()), 3..25),
        1..4,
    );
    (vec(clause, 1..4), changes).prop_map(|(clauses, changes)| {
        let recursion = ".decl L(x: number, y: number) L(x, y) :- R(x, z), S(z, y).
            .decl A, B(x: number, n: number)
            A(x, 0) :- K(x).
            B(x, n) :- A(x, n), S(x, _).\n";
        (String::from(AGGREGATED) + recursion + &clauses.join("\n"), changes)
    })
}

/// A recursive clause with an aggregate whose body uses `n`, which only the recursion binds.
fn correlated_clause(genes: [u8; 8], atoms: &[[u8; 3]]) -> String {
    let (mut inner, mut own) = (Vec::new(), Vec::new());
    for gene in atoms {
        let term = |gene: u8| ["x", "n", "y", "a", "a", "b", "b", "_", "1"][gene as usize % 9];
        let terms = [term(gene[1]), term(gene[2])];
        own.extend(terms.into_iter().filter(|term| ["a", "b"].contains(term)));
        inner.push(format!(
            "{}({}, {})",
            ["R", "S", "L"][gene[0] as usize % 3],
            terms[0],
            terms[1]
        ));
    }
    let pick = |gene: u8| own.get(gene as usize % own.len().max(1)).copied().unwrap_or("1");
    let one = pick(genes[1]);
    inner.push(match genes[0] % 6 {
        0 | 1 => format!("{one} < n"),
        2 => format!("!S({one}, n)"),
        3 => format!("m = {one} + n, S(m, _)"),
        4 => format!("m = count : {{ S(z, w), {one} + z < n + w }}, m > 0"),
        _ => "n > 1".to_owned(),
    });
    let (op, target) = match (genes[2] % 5, own.is_empty()) {
        (0, _) | (_, true) => ("count", ""),
        (kind, _) => (["sum", "min", "max", "mean"][kind as usize - 1], pick(genes[3])),
    };
    let aggregate = format!("{op} {target} : {{ {} }}", inner.join(", "));
    let [head, from] = [genes[4], genes[5]].map(|gene| ["A", "B"][gene as usize % 2]);
    match (op, genes[6] % 3) {
        ("mean", _) => format!("{head}(y, n) :- {from}(x, n), R(x, y), {aggregate} >= 1.0."),
        (_, 0) => format!("{head}(y, n) :- {from}(x, n), R(x, y), S(_, c), c = {aggregate}."),
        _ => format!("{head}(y, (n + c) band 7) :- {from}(x, n), R(x, y), c = {aggregate}."),
    }
}

/// A correlated aggregate is evaluated once for each binding of its parameters.
#[test]
fn a_correlated_aggregate_is_evaluated_once_for_each_binding() {
    let text = ".decl R(x: number, y: number) .decl V(v: number)
        R(x, y) :- x = range(0, 50), y = range(0, 50).
        V(v) :- v = range(0, 1000).
        .decl A(x: number, n: number)
        A(0, 500).
        A(y, n) :- A(x, n), R(x, y), c = count : { V(v), v > n }, c > 0.";
    let mut session = program(text).session();
    session.commit().unwrap();
    assert_eq!(session.len(session.program().predicate("A").unwrap()), 50);
    let scanned = session.work().rules().map(|rule| rule.rows_scanned);
    // 50 x 50 rows of R, one look at V for n = 500.
    assert!(
        (3_500..15_000).contains(&scanned.max().unwrap()),
        "{:?}",
        session.work()
    );
    // An unrelated change evaluates nothing; one of V evaluates the recursion again.
    let mut session =
        program(&text.replace("V(v) :-", ".input V .decl W(v: number) .input W W(1). V(1). // ")).session();
    session.commit().unwrap();
    let reached = |session: &Session| session.len(session.program().predicate("A").unwrap());
    assert_eq!(reached(&session), 1);
    insert(&mut session, "W", &[&[2]]);
    session.commit().unwrap();
    assert!(session.work().rules().next().is_none());
    insert(&mut session, "V", &[&[501]]);
    session.commit().unwrap();
    assert_eq!(reached(&session), 50);
    let v = session.program().predicate("V").unwrap();
    session.retract(v, numbers(&[501])).unwrap();
    session.commit().unwrap();
    assert_eq!(reached(&session), 1);
}

/// A count visits no row of the last scan, and stores no row of the join.
#[test]
fn an_aggregate_over_a_join_stores_groups_only() {
    let program = program(
        ".decl R(x: number, y: number)
        .decl S(y: number, z: number)
        .decl Total(n: number)
        .decl Most(x: number, n: number)
        Total(n) :- n = count : { R(x, y), S(y, z) }.
        Most(x, n) :- R(x, _), n = max z : { R(x, y), S(y, z) }.",
    );
    let rules = program.rules();
    let hidden: Vec<PredicateId> = (0..rules.predicates.len() as u32)
        .map(PredicateId)
        .filter(|id| program.is_aggregated(*id))
        .collect();
    assert_eq!(hidden.len(), 2);
    assert!(hidden.iter().all(|id| rules.predicates[id.index()].hidden));
    for threads in [1, 3] {
        let mut session = program.session();
        session.set_threads(eager(threads)).unwrap();
        let pairs = || (0..200).flat_map(|x| (0..20).map(move |y| numbers(&[x % 100, y + x / 100])));
        for name in ["R", "S"] {
            session.insert_all(program.predicate(name).unwrap(), pairs()).unwrap();
        }
        let delta = session.commit().unwrap();
        // 100 x 21 rows in R; those with y < 21 of 100 in S have 21 each.
        assert_eq!(shown(&session, "Total"), (100 * 21 * 21).to_string());
        assert_eq!(session.len(program.predicate("Most").unwrap()), 100);
        assert!(hidden.iter().all(|&id| session.is_empty(id) && delta.of(id).is_none()));
        assert!(session.bytes() < 100_000, "{}", session.bytes());
        let work: Vec<&RuleStats> = session.work().rules().collect();
        let counted = work
            .iter()
            .find(|rule| rule.derived == 100 * 21 * 21 && rule.rows_scanned < 5_000);
        assert!(counted.is_some(), "{work:?}");
    }
}

/// A batch of changes: whether the row is inserted, its predicate and its values.
type ChangeGenes = Vec<(bool, u8, [u8; 2])>;

/// Programs whose aggregates range over joins, and changes of their predicates.
fn aggregating_programs() -> impl proptest::strategy::Strategy<Value = (String, Vec<ChangeGenes>)> {
    use proptest::collection::vec;
    let clause =
        (any::<[u8; 6]>(), vec(any::<[u8; 3]>(), 1..4)).prop_map(|(genes, atoms)| aggregating_clause(genes, &atoms));
    let changes = vec(
        vec((prop::bool::weighted(0.8), any::<u8>(), any::<[u8; 2]>()), 3..25),
        1..4,
    );
    (vec(clause, 1..4), changes).prop_map(|(clauses, changes)| {
        let mut text = String::from(AGGREGATED);
        for (number, (types, head, body)) in clauses.iter().enumerate() {
            text += &format!(".decl Out{number}({types})\nOut{number}({head}) :- {body}.\n");
        }
        (text, changes)
    })
}

/// The predicates of [`aggregating_programs`].
const AGGREGATED: &str = ".decl K(k: number)
    .decl R(x: number, y: number)
    .decl S(x: number, y: number)
    .decl F(x: number, v: float)
    .decl T(x: number, s: symbol)
    T(9, \"b\"). T(9, \"\"). T(8, \"a\"). T(8, \"ab\").\n";

/// The columns, head and body of a clause with an aggregate.
fn aggregating_clause(genes: [u8; 6], atoms: &[[u8; 3]]) -> (String, String, String) {
    let keyed = !genes[0].is_multiple_of(3);
    let number = |gene: u8| match gene % 9 {
        0 | 1 => {
            if keyed {
                "k"
            } else {
                "a"
            }
        }
        2 | 3 => "a",
        4 | 5 => "b",
        6 => "c",
        7 => "_",
        _ => "1",
    };
    let mut inner: Vec<String> = Vec::new();
    let mut bound: Vec<&str> = Vec::new();
    for gene in atoms {
        let (name, last) = match gene[0] % 8 {
            0..3 => ("R", number(gene[2])),
            3..6 => ("S", number(gene[2])),
            6 => ("F", "v"),
            _ => ("T", "s"),
        };
        inner.push(format!("{name}({}, {last})", number(gene[1])));
        bound.extend([number(gene[1]), last]);
    }
    bound.retain(|term| !["_", "1"].contains(term));
    let numbers: Vec<&str> = bound
        .iter()
        .copied()
        .filter(|name| !["v", "s"].contains(name))
        .collect();
    let pick = |gene: u8| {
        numbers
            .get(gene as usize % numbers.len().max(1))
            .copied()
            .unwrap_or("2")
    };
    inner.extend(match genes[1] % 8 {
        0 => Some(format!("{} < {}", pick(genes[2]), pick(genes[3]))),
        1 => Some(format!("!R({}, {})", pick(genes[2]), pick(genes[3]))),
        2 => Some(format!("m = {} + 1, S(m, _)", pick(genes[2]))),
        3 => Some(format!("m = count : {{ S({}, z), R(z, _) }}, m > 0", pick(genes[2]))),
        _ => None,
    });
    let own: Vec<&str> = bound.iter().copied().filter(|name| *name != "k").collect();
    let target = own.get(genes[4] as usize % own.len().max(1)).copied();
    let (op, target) = match (genes[5] % 6, target) {
        (0 | 1, _) | (_, None) => ("count", ""),
        (2 | 3, Some("s")) => ("min", "s"),
        (_, Some("s")) => ("max", "s"),
        (kind, Some(target)) => (["sum", "min", "max", "mean"][kind as usize - 2], target),
    };
    let result = match (op, target) {
        ("count", _) => "number",
        ("mean", _) | (_, "v") => "float",
        (_, "s") => "symbol",
        _ => "number",
    };
    let aggregate = format!("n = {op} {target} : {{ {} }}", inner.join(", "));
    match keyed {
        false => (format!("n: {result}"), "n".into(), aggregate),
        true if genes[0] % 3 == 2 && result == "number" => {
            ("k: number".into(), "k".into(), format!("K(k), {aggregate}, R(k, n)"))
        }
        true => (
            format!("k: number, n: {result}"),
            "k, n".into(),
            format!("K(k), {aggregate}"),
        ),
    }
}

fn aggregating_script(program: &Program, changes: &[ChangeGenes]) -> Vec<Batch> {
    let change = |&(present, predicate, values): &(bool, u8, [u8; 2])| {
        let name = ["K", "R", "R", "S", "S", "F", "T"][predicate as usize % 7];
        let id = program.predicate(name).unwrap();
        let columns = program.rules().predicates[id.index()].columns.iter();
        let value = |(column, gene): (&logicity_datalog::Column, u8)| match column.base {
            BaseType::Symbol => Value(u32::from(gene) % program.rules().symbols.len() as u32),
            BaseType::Float => Value::float([0.1, -2.5, 1e30, -1e30, 3.0][gene as usize % 5]),
            _ => Value::number(i32::from(gene % 5)),
        };
        (present, id, columns.zip(values).map(value).collect())
    };
    let batch = |changes: &ChangeGenes| changes.iter().map(change).collect();
    changes.iter().map(batch).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 20_000, ..cases(512) })]

    #[test]
    fn commits_agree_with_naive(genome in genomes(1..5)) {
        check_script(&genome)?;
    }

    #[test]
    fn narrow_relations_agree_with_naive(genome in genomes(1..5)) {
        check_narrow(&genome)?;
    }

    #[test]
    fn recursive_commits_agree_with_naive(genome in recursive_genomes(1..4)) {
        check_script(&genome)?;
    }

    #[test]
    fn commits_with_expressions_agree_with_naive(genome in computing_genomes(1..4)) {
        check_script(&genome)?;
    }
}

fn insert(session: &mut Session, name: &str, rows: &[&[i32]]) {
    let id = session.program().predicate(name).unwrap();
    rows.iter().for_each(|row| session.insert(id, numbers(row)).unwrap());
}

fn retract(session: &mut Session, name: &str, rows: &[&[i32]]) {
    let id = session.program().predicate(name).unwrap();
    rows.iter().for_each(|row| session.retract(id, numbers(row)).unwrap());
}

fn numbers(row: &[i32]) -> Vec<Value> {
    row.iter().copied().map(Value::number).collect()
}

/// The predicate as `facts` prints it, with spaces and commas for tabs and line ends.
fn shown(session: &Session, name: &str) -> String {
    let text = facts::print(session, session.program().predicate(name).unwrap());
    text.trim_end().replace('\t', " ").replace('\n', ", ")
}

#[test]
fn transitive_closure_and_its_complement() {
    let program = program(
        ".decl Edge(x: number, y: number)
        .decl Node(x: number)
        .decl Path(x: number, y: number)
        .decl Cut(x: number, y: number)
        .decl Sink(x: number)
        Node(x) :- Edge(x, _).
        Node(y) :- Edge(_, y).
        Path(x, y) :- Edge(x, y).
        Path(x, z) :- Path(x, y), Path(y, z).
        Cut(x, y) :- Node(x), Node(y), !Path(x, y).
        Sink(x) :- Node(x), !Path(x, _).",
    );
    let mut session = program.session();
    insert(&mut session, "Edge", &[&[1, 2], &[2, 3], &[3, 1], &[3, 4]]);
    session.commit().unwrap();
    assert_eq!(
        shown(&session, "Path"),
        "1 1, 1 2, 1 3, 1 4, 2 1, 2 2, 2 3, 2 4, 3 1, 3 2, 3 3, 3 4"
    );
    assert_eq!(shown(&session, "Cut"), "4 1, 4 2, 4 3, 4 4");
    assert_eq!(shown(&session, "Sink"), "4");

    retract(&mut session, "Edge", &[&[3, 1]]);
    let delta = session.commit().unwrap();
    assert_eq!(shown(&session, "Path"), "1 2, 1 3, 1 4, 2 3, 2 4, 3 4");
    let path = delta.of(program.predicate("Path").unwrap()).unwrap();
    assert_eq!((path.added.len(), path.removed.len()), (0, 6));
    assert!(delta.of(program.predicate("Sink").unwrap()).is_none());
}

/// While words are dense, a recursion keeps its rows as bits only. Then it derives words beyond the bits.
#[test]
fn a_closure_beyond_the_dense_words_keeps_its_rows() {
    let program = program(
        ".decl Edge(x: number, y: number)
        .decl Path(x: number, y: number)
        Path(x, y) :- Edge(x, y), x < 200, y < 200.
        Path(x, z) :- Path(x, y), Edge(y, z).",
    );
    let (edge, path) = (program.predicate("Edge").unwrap(), program.predicate("Path").unwrap());
    // A chain of cycles of 8 nodes with chords, then a long path to nodes with large numbers and back.
    let mut edges: Vec<(i32, i32)> = (199..260).map(|node| (node, node + 1)).collect();
    for node in 0..200 {
        edges.extend([
            (node, node / 8 * 8 + (node + 1) % 8),
            (node, node / 8 * 8 + (node + 3) % 8),
        ]);
        edges.extend((node % 8 == 7 && node < 199).then_some((node, node + 1)));
    }
    edges.extend((0..5).map(|far| (if far == 0 { 260 } else { far * 50_000_000 }, (far + 1) * 50_000_000)));
    edges.push((250_000_000, 100));
    let mut expected: BTreeSet<Vec<Value>> = BTreeSet::new();
    for from in 0..200 {
        let mut waiting = vec![from];
        while let Some(at) = waiting.pop() {
            let next = edges.iter().filter(|&&(start, _)| start == at).map(|&(_, end)| end);
            waiting.extend(next.filter(|&end| expected.insert(numbers(&[from, end]))));
        }
    }
    for threads in [1, 3] {
        let mut session = program.session();
        session.set_threads(eager(threads)).unwrap();
        session
            .insert_all(edge, edges.iter().map(|&(x, y)| numbers(&[x, y])))
            .unwrap();
        session.commit().unwrap();
        assert!(session.encoded_rows(path).eq(&expected));
        let work = session.work().strata.last().and_then(StratumStats::work).unwrap();
        let derived: Vec<u64> = work.rules.iter().map(|rule| rule.delta_rows).collect();
        assert_eq!(derived, [0, expected.len() as u64], "every row is new once");
    }
}

/// Clustered node numbers give the same closure as dense ones, also after a retraction.
#[test]
fn a_closure_of_distant_clusters_is_that_of_near_ones() {
    const SIZE: i32 = 40;
    let program = program(
        ".decl Edge(x: number, y: number)
        .decl Path(x: number, y: number)
        .decl Near(x: number, y: number)
        Path(x, y) :- Edge(x, y).
        Path(x, z) :- Path(x, y), Path(y, z).
        Near(x, y) :- Path(z, x), Path(z, y), Edge(x, y).
        Near(x, z) :- Near(x, y), Edge(y, z).",
    );
    let mut random = Random(1);
    let mut below = |end: i32| random.below(end as u64) as i32;
    let edges: Vec<(i32, i32)> = (0..20 * SIZE * 2)
        .map(|edge| {
            (
                edge / (SIZE * 2) * SIZE + below(SIZE),
                edge / (SIZE * 2) * SIZE + below(SIZE),
            )
        })
        .collect();
    let distant = |node: i32| node / SIZE * 1_000 + node % SIZE;
    for threads in [1, 3] {
        let sessions: Vec<Vec<BTreeSet<(i32, i32)>>> = [&(|node| node) as &dyn Fn(i32) -> i32, &distant]
            .into_iter()
            .map(|place| {
                let mut session = program.session();
                session.set_threads(eager(threads)).unwrap();
                let rows = |edges: &[(i32, i32)]| -> Vec<Vec<Value>> {
                    edges.iter().map(|&(x, y)| numbers(&[place(x), place(y)])).collect()
                };
                session.insert_all("Edge", rows(&edges)).unwrap();
                session.commit().unwrap();
                let mut found = Vec::new();
                for _ in 0..2 {
                    for name in ["Path", "Near"] {
                        let id = session.program().predicate(name).unwrap();
                        let back = |value: Value| {
                            let word = value.to_number(session.symbols()) as i32;
                            match place(SIZE) == SIZE {
                                true => word,
                                false => word / 1_000 * SIZE + word % 1_000,
                            }
                        };
                        found.push(
                            session
                                .encoded_rows(id)
                                .map(|row| (back(row[0]), back(row[1])))
                                .collect(),
                        );
                    }
                    for row in rows(&edges[..200]) {
                        session.retract("Edge", row).unwrap();
                    }
                    session.commit().unwrap();
                }
                found
            })
            .collect();
        assert!(sessions[0][0].len() > 15_000);
        assert!(sessions[0] == sessions[1], "{threads} threads");
    }
}

#[test]
fn points_to_in_rounds_of_many_new_rows() {
    let program = program(
        ".decl AddressOf(y: number, x: number)
        .decl Assign(y: number, x: number)
        .decl Load(y: number, x: number)
        .decl Store(y: number, x: number)
        .decl PointsTo(y: number, x: number)
        PointsTo(y, x) :- AddressOf(y, x).
        PointsTo(y, x) :- Assign(y, z), PointsTo(z, x).
        PointsTo(y, w) :- Load(y, x), PointsTo(x, z), PointsTo(z, w).
        PointsTo(z, w) :- Store(y, x), PointsTo(y, z), PointsTo(x, w).",
    );
    let mut session = program.session();
    let mut state = 1_u32;
    let mut random = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let mut facts = BTreeSet::new();
    for (name, count) in [("AddressOf", 50), ("Assign", 60), ("Load", 15), ("Store", 15)] {
        let id = program.predicate(name).unwrap();
        for _ in 0..count {
            let row = [Value(random(50)), Value(random(50))];
            session.insert(id, row).unwrap();
            facts.insert((id, row.to_vec()));
        }
    }
    session.commit().unwrap();
    assert!(session.len(program.predicate("PointsTo").unwrap()) > 700);
    let expected = naive::evaluate(program.rules(), session.symbols(), facts);
    assert_eq!(database(&session), expected);
}

#[test]
fn long_lists_of_derived_rows_are_those_of_a_search() {
    const NODES: u32 = 600;
    let program = program(
        ".decl Edge(x: number, y: number)
        .decl Skip(x: number, y: number)
        .decl Path(x: number, y: number)
        Path(x, y) :- Edge(x, y).
        Path(x, z) :- Edge(x, y), Path(y, z).
        Path(x, z) :- Skip(x, y), Path(y, w), Path(w, z).",
    );
    let mut state = 7_u32;
    let mut random = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let edges: Vec<[u32; 2]> = (0..1_200).map(|_| [random(NODES), random(NODES)]).collect();
    let skips: Vec<[u32; 2]> = (0..12).map(|_| [random(NODES), random(NODES)]).collect();
    // By node, the nodes that it reaches, as bits.
    let mut reached = vec![[0_u64; NODES as usize / 64 + 1]; NODES as usize];
    for [x, y] in &edges {
        reached[*x as usize][*y as usize / 64] |= 1 << (y % 64);
    }
    loop {
        let before = reached.clone();
        let mut add = |to: u32, from: u32| {
            let words = reached[to as usize].iter_mut().zip(before[from as usize]);
            words.for_each(|(word, more)| *word |= more);
        };
        edges.iter().for_each(|&[x, y]| add(x, y));
        for &[x, y] in &skips {
            let middle = |node: &u32| before[y as usize][*node as usize / 64] >> (node % 64) & 1 == 1;
            (0..NODES).filter(middle).for_each(|node| add(x, node));
        }
        if reached == before {
            break;
        }
    }
    let reaches = |x: u32, y: u32| reached[x as usize][y as usize / 64] >> (y % 64) & 1 == 1;
    let pairs = (0..NODES).flat_map(|x| (0..NODES).map(move |y| (x, y)));
    let expected: Vec<Vec<Value>> = pairs
        .filter(|&(x, y)| reaches(x, y))
        .map(|(x, y)| vec![Value(x), Value(y)])
        .collect();
    assert!(expected.len() > 100_000);
    let mut work = Vec::new();
    for threads in [1, 3] {
        let mut session = program.session();
        session.set_threads(eager(threads)).unwrap();
        for (name, pairs) in [("Edge", &edges), ("Skip", &skips)] {
            let rows = pairs.iter().map(|pair| pair.map(Value));
            session.insert_all(program.predicate(name).unwrap(), rows).unwrap();
        }
        session.commit().unwrap();
        let found = session.encoded_rows(program.predicate("Path").unwrap());
        assert!(found.eq(expected.iter().map(Vec::as_slice)));
        work.push(session.work().clone());
    }
    assert_eq!(work[0], work[1]);
}

#[test]
fn same_generation() {
    let program = program(
        ".decl Parent(child: number, parent: number)
        .decl Same(x: number, y: number)
        Same(x, y) :- Parent(x, p), Parent(y, p).
        Same(x, y) :- Parent(x, p), Same(p, q), Parent(y, q).",
    );
    let mut session = program.session();
    insert(&mut session, "Parent", &[&[2, 1], &[3, 1], &[4, 2], &[5, 3]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "Same"), "2 2, 2 3, 3 2, 3 3, 4 4, 4 5, 5 4, 5 5");
}

#[test]
fn predicates_without_columns() {
    let program = program(
        ".decl Fire(place: number)
        .decl Open()
        .decl Alarm()
        .decl Calm()
        Alarm() :- Fire(_).
        Calm() :- Open(), !Alarm().",
    );
    let mut session = program.session();
    insert(&mut session, "Open", &[&[]]);
    let delta = session.commit().unwrap();
    assert_eq!(
        (shown(&session, "Calm"), shown(&session, "Alarm")),
        ("()".into(), String::new())
    );
    assert_eq!(delta.changes().len(), 2);
    insert(&mut session, "Fire", &[&[7]]);
    session.commit().unwrap();
    assert_eq!(
        (shown(&session, "Calm"), shown(&session, "Alarm")),
        (String::new(), "()".into())
    );
    assert!(session.contains("Alarm", ()));
}

#[test]
fn unchanged_strata_are_not_evaluated_again() {
    let program = program(
        ".decl In(x: number, size: number)
        .decl Out(x: number)
        .decl Big(x: number)
        .decl Any()
        .decl Far(x: number)
        .decl Side(x: number)
        Big(x) :- In(x, 9).
        Any() :- Big(_).
        Far(x) :- Any(), Out(x).
        Side(x) :- Out(x).",
    );
    let mut session = program.session();
    insert(&mut session, "In", &[&[1, 9]]);
    insert(&mut session, "Out", &[&[5]]);
    session.commit().unwrap();
    // The predicates of the evaluated strata, in the order of the text.
    let evaluated = |session: &Session| {
        let rules = session.program().rules();
        let mut predicates: Vec<PredicateId> = session
            .work()
            .evaluated()
            .flat_map(|stratum| rules.strata[stratum].predicates.clone())
            .collect();
        predicates.sort_unstable();
        predicates
            .iter()
            .map(|predicate| rules.predicates[predicate.index()].name.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(evaluated(&session), ["Big", "Any", "Far", "Side"]);

    // No change, or no net change.
    assert!(session.commit().unwrap().is_empty());
    assert!(evaluated(&session).is_empty());
    insert(&mut session, "In", &[&[1, 9], &[2, 9]]);
    retract(&mut session, "In", &[&[2, 9], &[3, 9]]);
    assert!(session.commit().unwrap().is_empty());
    assert!(evaluated(&session).is_empty());

    // `Big` is evaluated and stays the same, so the change ends there.
    insert(&mut session, "In", &[&[2, 3]]);
    session.commit().unwrap();
    assert_eq!(evaluated(&session), ["Big"]);
    // `Big` changes, `Any` does not.
    insert(&mut session, "In", &[&[2, 9]]);
    session.commit().unwrap();
    assert_eq!(evaluated(&session), ["Big", "Any"]);
    insert(&mut session, "Out", &[&[6]]);
    session.commit().unwrap();
    assert_eq!(evaluated(&session), ["Far", "Side"]);
}

/// The work of the clauses that ran: position, delta rows, derived rows.
fn ran(session: &Session) -> Vec<(u32, u64, u64)> {
    let rules = session.work().rules();
    rules
        .map(|rule| (rule.clause.0, rule.delta_rows, rule.derived))
        .collect()
}

#[test]
fn only_clauses_that_read_the_change_run_and_only_on_the_change() {
    let program = program(
        ".decl Near(x: number, y: number)
        .decl Old(x: number)
        .decl Ill(x: number)
        .decl Stop(x: number)
        .decl Go(x: number)
        Stop(x) :- Near(x, y), Old(y).
        Stop(x) :- Near(x, y), Ill(y).
        Stop(x) :- Ill(x).
        Go(x) :- Near(x, _), !Stop(x).",
    );
    let mut session = program.session();
    session.set_strategy(Strategy::Maintain);
    let near: Vec<[i32; 2]> = (0..1_000).map(|x| [x, (x + 1) % 1_000]).collect();
    near.iter().for_each(|row| insert(&mut session, "Near", &[row]));
    insert(&mut session, "Old", &[&[10], &[20]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "Stop"), "9, 19");
    assert!(
        session
            .work()
            .strata
            .iter()
            .all(|work| matches!(work, StratumStats::Recomputed(_)))
    );

    // One more row: one clause runs on one row and derives one new head. So one row of `Go` is in doubt. Its clause
    // does not derive it again, so it is lost.
    insert(&mut session, "Ill", &[&[500]]);
    let delta = session.commit().unwrap();
    assert_eq!(shown(&session, "Stop"), "9, 19, 499, 500");
    assert_eq!(ran(&session), [(1, 1, 1), (2, 1, 1), (3, 4, 2)]);
    assert_eq!(delta.changes().len(), 3);
    let rows_scanned: u64 = session.work().rules().map(|rule| rule.rows_scanned).sum();
    assert!(rows_scanned < 30, "{rows_scanned}");

    // A known row is not derived again.
    insert(&mut session, "Old", &[&[500]]);
    assert_eq!(session.commit().unwrap().changes().len(), 1);
    assert_eq!(ran(&session), [(0, 1, 0)]);
    assert!(matches!(
        session.work().strata[..],
        [StratumStats::Maintained(_), StratumStats::Skipped]
    ));

    // The row goes. The head in doubt has another derivation, and the change ends there.
    retract(&mut session, "Old", &[&[500]]);
    assert_eq!(session.commit().unwrap().changes().len(), 1);
    assert_eq!(ran(&session), [(0, 2, 1), (1, 1, 1)]);
    let rule = |clause: u32| {
        let mut rules = session.work().rules();
        *rules.find(|rule| rule.clause == ClauseId(clause)).unwrap()
    };
    // The row itself, its neighbor, and whether that neighbor is known.
    let stats: RuleStats = rule(0);
    assert_eq!((stats.delta_rows, stats.rows_scanned, stats.derived), (2, 6, 1));
}

/// A session after its first commit, with these rows in predicates of numbers.
fn committed(text: &str, facts: &[(&str, Vec<Vec<i32>>)]) -> Session {
    let mut session = program(text).session();
    for (name, rows) in facts {
        rows.iter().for_each(|row| insert(&mut session, name, &[row]));
    }
    session.commit().unwrap();
    session
}

/// The number of rows that the last commit scanned.
fn rows_scanned(session: &Session) -> u64 {
    session.work().rules().map(|rule| rule.rows_scanned).sum()
}

/// All orders of a list.
fn orders<T: Copy>(list: &[T]) -> Vec<Vec<T>> {
    let Some((first, rest)) = list.split_first() else {
        return vec![Vec::new()];
    };
    let insert = |order: Vec<T>| (0..=order.len()).map(move |at| [&order[..at], &[*first], &order[at..]].concat());
    orders(rest).into_iter().flat_map(insert).collect()
}

#[test]
fn joins_follow_the_sizes_of_relations_and_not_the_text() {
    let numbers = |count: i32, row: &dyn Fn(i32) -> Vec<i32>| (0..count).map(row).collect::<Vec<_>>();
    type Facts<'a> = Vec<(&'a str, Vec<Vec<i32>>)>;
    // Declarations, head, body, facts, rows of the result, and the most rows that the commit may scan.
    let cases: Vec<(&str, &[&str], Facts, usize, u64)> = vec![
        (
            "R(x: number, z: number)",
            &["Big(x, y)", "Small(y, z)"],
            vec![
                ("Big", numbers(20_000, &|n| vec![n, n % 5_000])),
                ("Small", numbers(10, &|n| vec![n * 7, n])),
            ],
            40,
            100,
        ),
        (
            "R(a: number, e: number)",
            &["Many(a, b)", "Few(b, c)", "Also(c, d)", "Last(d, e)"],
            vec![
                ("Many", numbers(20_000, &|n| vec![n, n % 2_000])),
                ("Few", numbers(10, &|n| vec![n, n * 3])),
                ("Also", numbers(20_000, &|n| vec![n % 2_000, n / 10])),
                ("Last", numbers(10, &|n| vec![n * 3 / 10 * 200 + n, n])),
            ],
            // Ten paths from `Few` to `Last`, and ten rows of `Many` for each.
            100,
            600,
        ),
        (
            "R(x: number, y: number, z: number)",
            &["Fact(x, y, z)", "A(x)", "B(y)", "C(z)"],
            vec![
                ("Fact", numbers(20_000, &|n| vec![n % 100, n % 1_000, n / 20])),
                ("A", numbers(100, &|n| vec![n])),
                ("B", numbers(5, &|n| vec![n * 10])),
                ("C", numbers(900, &|n| vec![n])),
            ],
            90,
            400,
        ),
        (
            "R(x: number)",
            &["Big(x, y)", "Tag(y, 7)", "Big(y, _)"],
            vec![
                ("Big", numbers(20_000, &|n| vec![n, n % 5_000])),
                ("Tag", numbers(3_000, &|n| vec![n, n / 100])),
            ],
            400,
            // One scan of all tags, without an index, then only the wanted rows.
            3_000 + 1_000,
        ),
    ];
    for (head, body, facts, rows, most) in cases {
        let names = ["x", "y", "z", "u"];
        let mut declared = format!(".decl {head}\n");
        for (name, rows) in &facts {
            let columns = names[..rows[0].len()].iter().map(|name| format!("{name}: number"));
            declared += &format!(".decl {name}({})\n", columns.collect::<Vec<_>>().join(", "));
        }
        let head = head.replace(": number", "");
        for order in orders(body) {
            let session = committed(&format!("{declared}{head} :- {}.", order.join(", ")), &facts);
            let found = session.len(session.program().predicate("R").unwrap());
            assert_eq!(found, rows, "{order:?}");
            assert!(
                rows_scanned(&session) <= most,
                "{order:?} scans {}",
                rows_scanned(&session)
            );
        }
    }
}

/// Rounds of a recursion also read the atom with the fewest matching rows next, whatever the order in the clause. Each
/// class has up to 100 superclasses, and few of them are parts of a definition.
#[test]
fn rounds_follow_the_sizes_of_relations() {
    let sub: Vec<Vec<i32>> = (0..3_000).filter(|n| n % 100 != 99).map(|n| vec![n, n + 1]).collect();
    let both = (0..30).map(|n| vec![n * 100 + 40, n * 100 + 60, 9_000 + n]).collect();
    let of = (0..30).map(|n| vec![n * 100 + 20]).collect();
    let facts = [("Sub", sub), ("Both", both), ("Of", of)];
    for order in orders(&["Is(x, c)", "Both(c, d, e)", "Is(x, d)"]) {
        let text = format!(
            ".decl Sub(x: number, y: number)\n.decl Both(x: number, y: number, z: number)\n.decl Of(x: number)\n\
             .decl Is(x: number, y: number)\nIs(x, y) :- Sub(x, y).\nIs(x, z) :- Is(x, y), Sub(y, z).\n\
             Is(x, e) :- {}.\nIs(x, x) :- Of(x).\n",
            order.join(", ")
        );
        let session = committed(&text, &facts);
        let found = session.len(session.program().predicate("Is").unwrap());
        // The classes below the first part of a definition: 40 of each 100.
        assert_eq!(found, 30 * (99 * 100 / 2) + 30 + 30 * 40, "{order:?}");
        let scanned = rows_scanned(&session);
        assert!(
            scanned <= 8 * found as u64,
            "{order:?} scans {scanned} for {found} rows"
        );
    }
}

#[test]
fn maintenance_follows_the_sizes_of_relations() {
    let program = program(
        ".decl Seed(x: number)
        .decl Big(x: number, y: number)
        .decl Small(x: number, y: number)
        .decl R(x: number, y: number)
        R(y, z) :- Seed(x), Big(x, y), Small(x, z), Small(z, y).",
    );
    let mut session = program.session();
    session.set_strategy(Strategy::Maintain);
    (0..10_000).for_each(|n| insert(&mut session, "Big", &[&[n % 10, n]]));
    (0..10).for_each(|n| insert(&mut session, "Small", &[&[n, 20 + n], &[20 + n, n]]));
    session.commit().unwrap();
    // The new row finds one row of `Small`, which finds another. Only then the key of `Big` is bound.
    insert(&mut session, "Seed", &[&[3]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "R"), "3 23");
    assert!(rows_scanned(&session) < 20, "{}", rows_scanned(&session));
    retract(&mut session, "Seed", &[&[3]]);
    session.commit().unwrap();
    assert!(rows_scanned(&session) < 30, "{}", rows_scanned(&session));
}

/// A hub linked with all nodes in both directions, and some nodes that are all linked with each other.
fn star_and_clique(spokes: i32, clique: i32) -> Vec<Vec<i32>> {
    let star = (1..=spokes).flat_map(|node| [vec![0, node], vec![node, 0]]);
    let pairs = (1..=clique).flat_map(|a| (1..=clique).map(move |b| vec![a, b]));
    star.chain(pairs.filter(|pair| pair[0] != pair[1])).collect()
}

#[test]
fn cyclic_joins_scan_no_more_rows_than_the_worst_case_bound() {
    let edges = star_and_clique(3_000, 20);
    let most = (edges.len() as f64).powf(1.5) as u64;
    let declared = ".decl E(x: number, y: number)\n.decl R(x: number, y: number, z: number, u: number)\n";
    // Ordered triangles and cliques of four among the 21 linked nodes. Triangles with a fourth edge would be far beyond
    // the bound.
    for (body, rows) in [
        ("E(x, y), E(y, z), E(x, z), u = 0", 21 * 20 * 19),
        ("E(y, x), E(z, y), E(x, z), u = 1", 21 * 20 * 19),
        (
            "E(x, y), E(x, z), E(x, u), E(y, z), E(y, u), E(z, u)",
            21 * 20 * 19 * 18,
        ),
    ] {
        let text = format!("{declared}R(x, y, z, u) :- {body}.");
        let session = committed(&text, &[("E", edges.clone())]);
        assert_eq!(session.len(session.program().predicate("R").unwrap()), rows);
        let rows_scanned = rows_scanned(&session);
        // A binary join would pair each of 3,000 edges to the hub with 3,000 edges from it.
        assert!(
            rows_scanned < most + 4 * rows as u64,
            "{body} scans {rows_scanned}, more than {most}"
        );
        assert!(rows_scanned < 3_000 * 3_000 / 10, "{body} scans {rows_scanned}");

        // Maintenance scans the common neighbors of the changed rows, not all neighbors of the hub.
        let mut session = session;
        session.set_strategy(Strategy::Maintain);
        insert(&mut session, "E", &[&[1, 2_000], &[2_000, 1], &[2, 2_000], &[2_000, 2]]);
        let delta = session.commit().unwrap();
        assert_eq!(delta.changes().len(), 2);
        assert!(
            self::rows_scanned(&session) < 2_000,
            "{body} scans {}",
            self::rows_scanned(&session)
        );
    }
}

#[test]
fn one_witness_is_enough_if_no_later_literal_needs_it() {
    let hundred = |row: &dyn Fn(i32) -> Vec<i32>| (0..100).map(row).collect::<Vec<_>>();
    let facts = [
        ("A", vec![vec![1], vec![2]]),
        (
            "B",
            hundred(&|n| vec![1, n])
                .into_iter()
                .chain(hundred(&|n| vec![2, n]))
                .collect(),
        ),
        ("C", hundred(&|n| vec![n])),
        ("D", (0..5).flat_map(|n| [vec![1, n], vec![2, n]]).collect()),
        ("F", hundred(&|n| vec![n, n])),
    ];
    let declared = ".decl A(x: number) .decl C(x: number) .decl H(x: number, w: number)
        .decl B(x: number, y: number) .decl D(x: number, w: number) .decl F(x: number, y: number)\n";
    // In the middle of a body: for each of two rows of `A` one witness, then five rows of `D`.
    let session = committed(&format!("{declared}H(x, w) :- A(x), B(x, y), C(y), D(x, w)."), &facts);
    assert_eq!(
        (session.work().rules().next().unwrap().derived, rows_scanned(&session)),
        (10, 2 + 2 * 2 + 10)
    );
    // At the end, two atoms deep. If the last test fails, the search tries no other witness of the witness.
    let session = committed(
        &format!("{declared}H(x, w) :- A(x), D(x, w), B(x, y), F(y, z), C(z)."),
        &facts,
    );
    assert_eq!(
        (session.work().rules().next().unwrap().derived, rows_scanned(&session)),
        (10, 2 + 10 + 10 * 3)
    );
    let session = committed(
        &format!("{declared}H(x, 1) :- A(x), B(x, y), F(y, _), D(_, x), x > 1."),
        &facts,
    );
    assert_eq!(session.work().rules().next().unwrap().derived, 1);
    assert!(rows_scanned(&session) <= 2 + 4, "{}", rows_scanned(&session));
}

/// Bodies of two to four atoms over three binary predicates and four variables, mostly cyclic. The predicates are skewed
/// and large enough for planning by size.
#[test]
fn slow_cyclic_bodies_agree_with_naive() {
    let mut state = 11_u32;
    let mut random = move |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let variables = ["a", "b", "c", "d"];
    let (mut joins, mut cases) = (0, 0);
    for _ in 0..40 {
        let atoms: Vec<[&str; 3]> = (0..2 + random(3))
            .map(|_| ["R", "S", "T"].map(|_| variables[random(4) as usize]))
            .collect();
        let body: Vec<String> = atoms
            .iter()
            .zip(["R", "S", "T", "R"])
            .map(|(atom, name)| format!("{name}({}, {})", atom[0], atom[1]))
            .collect();
        let used: Vec<&str> = variables
            .into_iter()
            .filter(|name| atoms.iter().any(|atom| atom[..2].contains(name)))
            .collect();
        let head: Vec<&str> = (0..2).map(|at| used[(at + random(2) as usize) % used.len()]).collect();
        let text = format!(
            ".decl R(x: number, y: number) .decl S(x: number, y: number) .decl T(x: number, y: number)
            .decl H(x: number, y: number)
            H({}) :- {}.",
            head.join(", "),
            body.join(", ")
        );
        let program = program(&text);
        let mut sessions = [Strategy::Recompute, Strategy::Maintain].map(|strategy| {
            let mut session = program.session();
            session.set_strategy(strategy);
            session
        });
        let mut facts = BTreeSet::new();
        for (name, count) in [("R", 400), ("S", 300), ("T", 30)] {
            let id = program.predicate(name).unwrap();
            // Larger values are less likely.
            let mut node = || {
                let most = 1 + random(40);
                random(most)
            };
            facts.extend((0..count).map(|_| (id, vec![Value(node()), Value(node())])));
        }
        for step in 0..3 {
            let chosen: Vec<_> = facts.iter().filter(|_| step > 0 && random(20) == 0).cloned().collect();
            for session in &mut sessions {
                match step {
                    0 => facts.iter().for_each(|(id, row)| session.insert(*id, row).unwrap()),
                    _ => chosen.iter().for_each(|(id, row)| session.retract(*id, row).unwrap()),
                }
                session.commit().unwrap();
            }
            chosen.iter().for_each(|fact| _ = facts.remove(fact));
            let expected = naive::evaluate(program.rules(), sessions[0].symbols(), facts.iter().cloned());
            for session in &sessions {
                assert_eq!(database(session), expected, "{text}");
            }
        }
        cases += 1;
        let mut sources = Sources::new();
        sources.add("program.dl", text);
        joins += usize::from(sessions[0].show_plans(&sources).contains("join   "));
    }
    assert!(joins > cases / 10, "only {joins} of {cases} plans have a leapfrog join");
}

#[test]
fn a_large_change_is_recomputed_and_a_small_one_maintained() {
    let program = program(
        ".decl Edge(x: number, y: number)
        .decl Mark(x: number)
        .decl Path(x: number, y: number)
        .decl Reached(x: number)
        Path(x, y) :- Edge(x, y).
        Path(x, z) :- Path(x, y), Edge(y, z).
        Reached(y) :- Mark(x), Path(x, y).",
    );
    let mut session = program.session();
    // Ten chains of thirty nodes.
    let chains = (0..300).filter(|x| x % 30 != 29).map(|x| [x, x + 1]);
    chains.for_each(|row| insert(&mut session, "Edge", &[&row]));
    insert(&mut session, "Mark", &[&[5]]);
    session.commit().unwrap();
    assert_eq!(session.len(program.predicate("Path").unwrap()), 10 * 29 * 30 / 2);

    let maintained = |session: &Session| {
        let strata = session.work().strata.iter();
        strata
            .map(|work| match work {
                StratumStats::Skipped => '-',
                StratumStats::Maintained(_) => 'm',
                StratumStats::Recomputed(WorkCounts { given_up: 0, .. }) => 'r',
                StratumStats::Recomputed(_) => 'R',
            })
            .collect::<String>()
    };
    insert(&mut session, "Edge", &[&[1_000, 1_001]]);
    session.commit().unwrap();
    assert_eq!(maintained(&session), "mm");
    retract(&mut session, "Edge", &[&[29 + 30 * 7 - 1, 29 + 30 * 7]]);
    let delta = session.commit().unwrap();
    // `Path` loses 29 of 4,350 rows. `Reached` begins with 25 rows.
    assert_eq!(maintained(&session), "mr");
    assert_eq!(delta.of(program.predicate("Path").unwrap()).unwrap().removed.len(), 29);
    assert!(session.work().rules().map(|rule| rule.rows_scanned).sum::<u64>() < 1_000);

    // All chains become one: maintenance seems cheap, exceeds its budget, and is abandoned.
    (0..9).for_each(|chain| insert(&mut session, "Edge", &[&[chain * 30 + 29, chain * 30 + 30]]));
    session.commit().unwrap();
    assert_eq!(maintained(&session), "Rr");
    // The last node is cut off, then the chain is cut in the middle: half of all paths may be lost.
    let path = program.predicate("Path").unwrap();
    insert(&mut session, "Edge", &[&[238, 239]]);
    session.commit().unwrap();
    retract(&mut session, "Edge", &[&[298, 299]]);
    session.commit().unwrap();
    assert_eq!(maintained(&session), "mr");
    assert_eq!(session.len(path), 299 * 298 / 2 + 1);
    retract(&mut session, "Edge", &[&[149, 150]]);
    let delta = session.commit().unwrap();
    assert_eq!(maintained(&session), "Rr");
    assert_eq!(session.len(path), (150 * 149 + 149 * 148) / 2 + 1);
    assert_eq!(delta.of(path).unwrap().removed.len(), 150 * 149);
    insert(&mut session, "Edge", &[&[298, 299], &[149, 150]]);
    session.commit().unwrap();
    assert_eq!(session.len(path), 300 * 299 / 2 + 1);
    // Nearly all marks change: maintenance does not seem cheap.
    (6..290).for_each(|x| insert(&mut session, "Mark", &[&[x]]));
    session.commit().unwrap();
    assert_eq!(maintained(&session), "-r");
}

#[test]
fn facts_in_the_text_hold_and_cannot_be_retracted() {
    let program = program(
        ".decl Base(x: number)
        .decl Copy(x: number)
        Base(1).
        Base(2).
        Copy(x) :- Base(x).
        Copy(9).",
    );
    let mut session = program.session();
    let base = program.predicate("Base").unwrap();
    assert_eq!(session.len(base), 0);
    insert(&mut session, "Base", &[&[2], &[3]]);
    retract(&mut session, "Base", &[&[1]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "Copy"), "1, 2, 3, 9");
    retract(&mut session, "Base", &[&[1], &[2], &[3]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "Copy"), "1, 2, 9");
    assert_eq!(session.fired(ClauseId(0)), [numbers(&[1])]);
    assert_eq!(session.fired(ClauseId(2)), [numbers(&[1]), numbers(&[2])]);
    assert_eq!(session.fired(ClauseId(3)), [numbers(&[9])]);
    assert!(session.fired(ClauseId(99)).is_empty());
}

/// The default limits except for rows.
fn rows(rows: usize) -> Limits {
    Limits {
        rows,
        ..Limits::default()
    }
}

#[test]
fn a_failed_commit_changes_nothing() {
    let program = program(
        ".decl Node(x: number)
        .decl Pair(x: number, y: number)
        .decl Odd(x: number)
        Pair(x, y) :- Node(x), Node(y).
        Odd(x) :- Node(x), !Pair(x, x).",
    );
    let mut session = program.session();
    session.set_limits(rows(9));
    insert(&mut session, "Node", &[&[1], &[2]]);
    session.commit().unwrap();
    insert(&mut session, "Node", &[&[3], &[4]]);
    let before = database(&session);
    let limit = EvalError::TooManyRows {
        limit: 9,
        clause: ClauseId(0),
    };
    assert_eq!(session.commit(), Err(limit.clone()));
    assert_eq!(database(&session), before);
    assert_eq!(session.commit(), Err(limit), "the changes stay pending");
    retract(&mut session, "Node", &[&[4]]);
    session.commit().unwrap();
    assert_eq!(session.len(program.predicate("Pair").unwrap()), 9);
    insert(&mut session, "Node", &[&[4]]);
    session.rollback();
    assert!(session.commit().unwrap().is_empty());

    // Rows of an empty predicate.
    let mut session = program.session();
    session.set_limits(rows(9));
    insert(&mut session, "Node", &[&[4], &[2], &[1], &[4], &[3]]);
    assert!(session.commit().is_err());
    assert_eq!(database(&session), database(&program.session()));
    assert!(session.commit().is_err(), "the changes stay pending");
    retract(&mut session, "Node", &[&[2]]);
    session.commit().unwrap();
    assert_eq!(shown(&session, "Node"), "1, 3, 4");
    assert_eq!(session.len(program.predicate("Pair").unwrap()), 9);
}

#[test]
fn inserting_rows_together_equals_inserting_them_one_by_one() {
    let program = program(
        ".decl Base(x: number, y: number)
        .decl Flag()
        .decl Named(x: symbol)
        .input Base, Flag, Named
        .decl Copy(x: number, y: number)
        Copy(y, x) :- Base(x, y), Flag().
        Base(7, 7).",
    );
    let [base, flag, named] = ["Base", "Flag", "Named"].map(|name| program.predicate(name).unwrap());
    let rows = |from: i32, to: i32| (from..to).map(|n| numbers(&[n * 37 % 1_000, n % 91]));
    let (mut together, mut alone) = (program.session(), program.session());
    for (present, from, to) in [(true, 0, 3_000), (false, 500, 600), (true, 550, 4_000), (false, 0, 300)] {
        match present {
            true => together.insert_all(base, rows(from, to)).unwrap(),
            false => rows(from, to).for_each(|row| together.retract(base, &row).unwrap()),
        }
        for row in rows(from, to) {
            match present {
                true => alone.insert(base, &row).unwrap(),
                false => alone.retract(base, &row).unwrap(),
            }
        }
        if from != 500 {
            together.insert_all(flag, [()]).unwrap();
            alone.insert(flag, ()).unwrap();
            assert_eq!(together.commit(), alone.commit());
            assert_eq!(database(&together), database(&alone));
        }
    }
    // If one row is invalid, none is inserted.
    let word = together.intern("word");
    let arity = together.insert_all(base, rows(5_000, 9_000).chain([numbers(&[1])]));
    assert!(matches!(arity, Err(RowError::Arity { found: 1, .. })));
    let unknown = together.insert_all(named, [[word], [Value(word.0 + 1)]]);
    assert!(matches!(unknown, Err(RowError::UnknownSymbol { .. })));
    assert!(matches!(
        together.insert_all(program.predicate("Copy").unwrap(), rows(0, 1)),
        Err(RowError::Derived { .. })
    ));
    assert_eq!(
        together.insert_all(PredicateId(99), rows(0, 1)),
        Err(unknown_predicate("#99"))
    );
    assert!(together.commit().unwrap().is_empty());
}

#[test]
fn recursion_past_the_limit_fails() {
    let program = program(
        ".decl Seed(a: number, b: number, c: number, d: number)
        .decl Letter(x: number)
        .decl Word(a: number, b: number, c: number, d: number)
        Word(a, b, c, d) :- Seed(a, b, c, d).
        Word(a, b, c, e) :- Word(a, b, c, _), Letter(e).
        Word(b, c, d, a) :- Word(a, b, c, d).",
    );
    let mut session = program.session();
    session.set_limits(rows(1_000));
    insert(&mut session, "Seed", &[&[0, 0, 0, 0]]);
    (0..10).for_each(|letter| insert(&mut session, "Letter", &[&[letter]]));
    assert!(matches!(
        session.commit(),
        Err(EvalError::TooManyRows { limit: 1_000, .. })
    ));
    session.set_limits(rows(10_000));
    session.commit().unwrap();
    assert_eq!(session.len(program.predicate("Word").unwrap()), 10_000);
}

#[test]
fn endless_derivations_reach_a_limit() {
    let program = program(
        ".decl Seed(x: number)
        .input Seed
        .decl Number(x: number)
        .decl Text(x: symbol)
        Number(x) :- Seed(x).
        Number(x + 1) :- Number(x).
        Text(cat(to_string(x), \"!\")) :- Seed(x).
        Text(cat(x, x)) :- Text(x), strlen(x) < 100.",
    );
    let mut session = program.session();
    session.set_limits(rows(1_000));
    insert(&mut session, "Seed", &[&[1]]);
    assert!(matches!(
        session.commit(),
        Err(EvalError::TooManyRows { limit: 1_000, .. })
    ));
    assert!(session.is_empty(program.predicate("Number").unwrap()));
    retract(&mut session, "Seed", &[&[1]]);
    assert!(session.commit().unwrap().is_empty());
}

/// The error of a commit beyond a limit, with one thread and with three. The session stays empty.
fn stopped(text: &str, limits: Limits) -> EvalError {
    let program = program(text);
    let [one, three] = [1, 3].map(|threads| {
        let mut session = program.session();
        session.set_threads(eager(threads)).unwrap();
        session.set_limits(limits);
        let error = session.commit().map(|_| ()).unwrap_err();
        assert!(database(&session).iter().all(BTreeSet::is_empty));
        assert_eq!(session.commit().map(|_| ()).as_ref(), Err(&error));
        error
    });
    assert_eq!(one, three);
    one
}

/// Recursion that computes new values without end needs a bound, and no higher limit.
#[test]
fn an_endless_recursion_is_told_what_to_bound() {
    let decl = ".decl N, M(x: number)\n.decl S(x: symbol)\n.decl L(n: number, s: symbol)\n.decl P(x: number, y: number)\n\
                .decl U(x: unsigned)\n.decl B(x: number)\n.decl F(x: float)\n";
    let endless = [
        ("N(0). N(x + 1) :- N(x).", "x < 100"),
        ("N(0). N(y) :- y = 1 + x, N(x).", "x < 100"),
        ("N(0). N(x - 1) :- N(x), x < 10.", "x > -100"),
        ("N(0). N(x + -1) :- N(x).", "x > -100"),
        ("N(0). N(x + 1) :- N(x), x > 0 - 10.", "x < 100"),
        ("U(4000000000u). U(x - 1) :- U(x).", "x > 0"),
        ("F(0). F(x + 0.5) :- F(x).", "x < 100"),
        ("N(1). N(x * 3) :- N(x).", "x < 100"),
        ("N(1). N(2). N(x + y) :- N(x), N(y).", "x < 100"),
        ("N(0). N(x + 1) :- M(x). M(x) :- N(x).", "x < 100"),
        ("N(0). M(x) :- N(x). N(y) :- M(x), z = x + 1, y = z.", "x < 100"),
        ("P(0, 0). P(y, x + 1) :- P(x, y).", "x < 100"),
        ("S(\"\"). S(cat(x, \"a\")) :- S(x).", "strlen(x) < 100"),
        ("S(\"\"). S(\"a\" + x) :- S(x).", "strlen(x) < 100"),
        ("L(0, \"\"). L(n + 1, cat(s, to_string(n))) :- L(n, s).", "n < 100"),
        (
            "S(\"1\"). N(to_number(s)) :- S(s). S(to_string(x + 1)) :- N(x).",
            "x < 100",
        ),
        ("B(0). N(0). N(x + 1) :- N(x), B(y), y < 10.", "x < 100"),
    ];
    for (clauses, bound) in endless {
        let text = format!("{decl}{clauses}");
        let fault = stopped(&text, rows(1_000)).diagnostic(program(&text).rules());
        assert_eq!(fault.limit, None, "{clauses}");
        assert_eq!(
            fault.help,
            [format!("bound them, for example with `{bound}`")],
            "{clauses}"
        );
    }
    let ends = [
        "N(0). N(x + 1) :- N(x), x < 100000.",
        "N(0). N(x + 1) :- N(x), 100000 >= x.",
        "N(0). N(y) :- N(x), y = x + 1, y < 100000.",
        "N(0). N(x - 1) :- N(x), x > 0 - 100000.",
        "N(0). N(x + 1) :- N(x), x != 100000.",
        "N(0). N(x + 1) :- M(x). M(x) :- N(x), x < 100000.",
        "S(\"\"). S(cat(x, \"a\")) :- S(x), strlen(x) < 2000.",
        "N(100000). N(x) :- N(y), x = range(0, y).",
        "P(x, y) :- x = range(0, 100), y = range(0, 100).",
    ];
    for clauses in ends {
        let text = format!("{decl}{clauses}");
        let fault = stopped(&text, rows(1_000)).diagnostic(program(&text).rules());
        assert!(fault.limit.is_some(), "{clauses}");
    }
}

/// This number of facts.
fn facts_of(name: &str, count: usize) -> String {
    (0..count).map(|n| format!("{name}({n}).\n")).collect()
}

#[test]
fn a_product_that_derives_nothing_reaches_a_limit() {
    let text = facts_of("A", 100)
        + ".decl A(x: number)
        .decl B(x: number)
        B(x) :- A(x), x > 50.
        B(x) :- A(x), A(y), A(z), A(w), x + y + z + w < 0.";
    let steps = 1_000_000;
    let limits = Limits {
        steps,
        ..Limits::default()
    };
    let error = stopped(&text, limits);
    assert_eq!(
        error,
        EvalError::TooManySteps {
            limit: steps,
            clause: ClauseId(101)
        }
    );
    let fault = error.diagnostic(program(&text).rules());
    assert_eq!((fault.code, fault.secondary.len()), (diag::codes::LIMIT_EXCEEDED, 1));
    // An aggregate scans rows, too.
    let counted = facts_of("A", 2_000)
        + ".decl A(x: number)
        .decl Group(x: number, g: number)
        .decl Size(x: number, n: number)
        Group(x, 0) :- A(x).
        Size(x, n) :- Group(x, g), n = count : { Group(_, g) }.";
    assert!(matches!(stopped(&counted, limits), EvalError::TooManySteps { .. }));
    // So does one that is evaluated in place, and its rows take memory.
    let in_place = facts_of("A", 2_000)
        + ".decl A(x: number)
        .decl N(n: number)
        N(0).
        N(n + 1) :- N(n), n < 2000, c = count : { A(x), x >= n, x != 7 }, c >= 0.";
    assert!(matches!(stopped(&in_place, limits), EvalError::TooManySteps { .. }));
}

#[test]
fn rows_of_an_aggregate_in_place_are_counted_in_bytes() {
    let limits = Limits {
        bytes: 1 << 20,
        ..Limits::default()
    };
    // A wildcard of an inline predicate repeats rows, so the aggregate keeps the distinct ones.
    let text = facts_of("A", 300)
        + ".decl A(x: number)
        .decl P(x: number, y: number) inline
        P(x, y) :- A(x), A(y), A(z), z < 2.
        .decl N(n: number)
        N(0).
        N(n + 1) :- N(n), n < 2, c = count : { P(x, y), x >= n }, c >= 0.";
    let rules = datalog::rewrite::unfold(program(&text).rules()).expect("P is inline").0;
    let mut session = Program::new(rules).unwrap().session();
    session.set_limits(limits);
    assert!(matches!(session.commit(), Err(EvalError::TooMuchMemory { .. })));
    session.set_limits(Limits::default());
    session.commit().unwrap();
    assert_eq!(session.len(session.program().predicate("N").unwrap()), 3);
}

#[test]
fn loaded_relations_take_the_memory_of_their_own_columns() {
    let loaded = |more: &str| {
        let program = program(&format!(".decl Edge(x: number, y: number)\n.input Edge\n{more}"));
        let edge = program.predicate("Edge").unwrap();
        let mut session = program.session();
        session
            .insert_all(edge, (0..10_000).map(|n| numbers(&[n / 7, n])))
            .unwrap();
        session.commit().unwrap();
        (session, edge)
    };
    let columns: Vec<String> = (0..20).map(|column| format!("c{column}: number")).collect();
    let (alone, _) = loaded("");
    let (mut session, edge) = loaded(&format!(".decl Wide({})\n.input Wide", columns.join(", ")));
    assert_eq!(session.bytes(), alone.bytes());
    // A change pads the rows.
    session.retract(edge, numbers(&[0, 6])).unwrap();
    assert_eq!(session.commit().unwrap().of(edge).unwrap().removed.len(), 1);
    assert_eq!(session.len(edge), 9_999);
    assert!(session.bytes() >= 9_999 * 20 * 4);
}

#[test]
fn wide_rows_indexes_and_texts_are_counted_in_bytes() {
    let limits = Limits {
        bytes: 1 << 20,
        ..Limits::default()
    };
    let columns = |end: &str| (0..30).map(|n| format!("c{n}{end}")).collect::<Vec<_>>().join(", ");
    let wide = facts_of("A", 200)
        + &format!(
            ".decl A(x: number)\n.decl W(x: number, y: number, {})\nW(x, y, {}) :- A(x), A(y).\n",
            columns(": number"),
            vec!["0"; 30].join(", ")
        );
    assert!(matches!(stopped(&wide, limits), EvalError::TooMuchMemory { .. }));

    let doubled = ".decl Text(x: symbol)\nText(\"0123456789\").\nText(cat(x, x)) :- Text(x).";
    assert!(matches!(stopped(doubled, limits), EvalError::TooMuchMemory { .. }));
    let spread = ".decl Text(x: symbol)\nText(\"0123456789\").\nText(cat(x, x, x, x, x, x, x, x)) :- Text(x), strlen(x) < 1000000000.";
    assert!(matches!(stopped(spread, limits), EvalError::TooMuchMemory { .. }));

    // The rows fit, but an index in another order does not.
    let index = facts_of("A", 280)
        + ".decl A(x: number)
        .decl P(x: number, y: number)
        .decl Q(x: number)
        P(x, y) :- A(x), A(y).
        Q(x) :- A(y), y < 3, P(x, y), x < 3.";
    assert!(matches!(stopped(&index, limits), EvalError::TooMuchMemory { .. }));
}

#[test]
fn rows_that_do_not_fit_are_errors() {
    let program = program(COPY);
    let (base, copy) = (program.predicate("Base").unwrap(), program.predicate("Copy").unwrap());
    let mut session = program.session();
    let arity = |found| RowError::Arity {
        predicate: "Base".into(),
        expected: 1,
        found,
    };
    assert_eq!(session.insert(base, ()), Err(arity(0)));
    assert_eq!(session.retract(base, numbers(&[1, 2])), Err(arity(2)));
    assert_eq!(
        session.insert(copy, numbers(&[1])),
        Err(RowError::Derived {
            predicate: "Copy".into()
        })
    );
    assert_eq!(session.insert(PredicateId(7), ()), Err(unknown_predicate("#7")));
    assert!(!session.contains(PredicateId(7), ()) && !session.contains(base, ()));
    assert_eq!(session.encoded_rows(PredicateId(7)).count(), 0);
    assert_eq!((session.len(PredicateId(7)), session.len("Nothing")), (0, 0));
}

fn unknown_predicate(predicate: &str) -> RowError {
    RowError::UnknownPredicate {
        predicate: predicate.to_owned(),
        near: None,
    }
}

const PEOPLE: &str = "\
    .decl person(name: symbol, born: number, id: unsigned, height: float) .input person
    .decl here() .input here
    .decl tall(name: symbol) tall(name) :- person(name, _, _, height), height > 1.8.";

#[test]
fn rows_are_rust_values() {
    let program = Program::parse(PEOPLE).unwrap();
    let mut session = program.session();
    session.insert("person", ("Ada", 1815_i64, 7_u64, 1.9)).unwrap();
    session
        .insert(&"person".to_owned(), (String::from("Alan"), 1912, 8, 1.75_f32))
        .unwrap();
    let mixed = (session.intern("Kurt"), Value::number(-1906), 9_u8, &1.5);
    session.insert(program.predicate("person").unwrap(), mixed).unwrap();
    session.insert("here", ()).unwrap();
    session.commit().unwrap();

    let people: Vec<(&str, i64, u32, f64)> = session.rows("person").unwrap().collect();
    let expected = [
        ("Ada", 1815, 7, f64::from(1.9_f32)),
        ("Alan", 1912, 8, 1.75),
        ("Kurt", -1906, 9, 1.5),
    ];
    assert_eq!(people, expected);
    let ids: Vec<i64> = session
        .rows::<(Value, i32, i64, f32)>("person")
        .unwrap()
        .map(|row| row.2)
        .collect();
    assert_eq!(ids, [7, 8, 9]);
    assert_eq!(
        session.rows::<[&str; 1]>("tall").unwrap().collect::<Vec<_>>(),
        [["Ada"]]
    );
    let texts: Vec<Vec<String>> = session.rows("tall").unwrap().collect();
    assert_eq!(texts, [["Ada"]]);
    assert_eq!(session.rows::<Vec<i64>>("here").unwrap().len(), 1);
    assert!(session.contains("here", ()) && session.contains("tall", ["Ada"]) && session.contains("tall", ["Ada"]));
    assert!(
        !session.contains("tall", ["Grace"]) && !session.contains("tall", [1]) && !session.contains("tal", ["Ada"])
    );

    session.retract("person", ("Ada", 1815, 7, 1.9)).unwrap();
    session.insert_all("person", [("Emmy", 1882, 10, 1.85)]).unwrap();
    let delta = session.commit().unwrap();
    let change = delta.of(program.predicate("tall").unwrap()).unwrap();
    assert_eq!(
        session
            .decode::<(&str,)>("tall", &change.added)
            .unwrap()
            .collect::<Vec<_>>(),
        [("Emmy",)]
    );
    assert_eq!(
        session
            .decode::<(&str,)>("tall", &change.removed)
            .unwrap()
            .collect::<Vec<_>>(),
        [("Ada",)]
    );
}

#[test]
fn errors_of_rows_name_relation_column_and_what_was_expected() {
    let program = Program::parse(PEOPLE).unwrap();
    let mut session = program.session();
    let mut message = |row: (&str, i64, i64, f64)| session.insert("person", row).unwrap_err().to_string();
    assert_eq!(
        message(("Ada", 3_000_000_000, 7, 1.9)),
        "the column `born` of `person` expects a number in the range of the program, not 3000000000"
    );
    assert_eq!(
        message(("Ada", 1815, -7, 1.9)),
        "the column `id` of `person` expects an unsigned number in the range of the program, not -7"
    );
    let swapped = session.insert("person", (1815, "Ada", 7, 1.9)).unwrap_err();
    assert_eq!(
        swapped.to_string(),
        "the column `name` of `person` expects a symbol, not 1815"
    );
    let number = session.insert("person", ("Ada", 1.5, 7, 1.9)).unwrap_err();
    assert_eq!(
        number.to_string(),
        "the column `born` of `person` expects a number in the range of the program, not the float 1.5"
    );
    let float = session.insert("person", ("Ada", 1815, 7, "high")).unwrap_err();
    assert_eq!(
        float.to_string(),
        "the column `height` of `person` expects a float, not the symbol \"high\""
    );
    let arity = session.insert("person", ("Ada", 1815)).unwrap_err();
    assert_eq!(arity.to_string(), "a row of `person` has 4 values, not 2");
    let unknown = session.retract("persons", ("Ada", 1815, 7, 1.9)).unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "the program declares no predicate `persons`; did you mean `person`?"
    );
    let derived = session.insert("tall", ["Ada"]).unwrap_err();
    assert_eq!(
        derived.to_string(),
        "`tall` is derived by rules; its rows cannot be set"
    );
    let symbol = session.insert("person", (Value(99), 1815, 7, 1.9)).unwrap_err();
    assert!(matches!(symbol, RowError::UnknownSymbol { .. }));
    // If one row is invalid, none is inserted.
    let rows = [["Ada", "x"], ["Alan", "y"]];
    assert!(matches!(
        session.insert_all("person", rows),
        Err(RowError::Arity { found: 2, .. })
    ));

    let read = session.rows::<(&str, u32, u32, f32)>("person").err().unwrap();
    assert_eq!(
        read.to_string(),
        "the column `born` of `person` has type number; expected type unsigned"
    );
    let read = session.rows::<[&str; 2]>("person").err().unwrap();
    assert_eq!(read.to_string(), "a row of `person` has 4 values, not 2");
    assert!(session.commit().unwrap().is_empty());
}

#[test]
fn faulty_programs_are_errors_that_show_the_place() {
    let error = Program::parse(".decl a(x: number)\na(x) :- b(x).").unwrap_err();
    assert_eq!(error.diagnostics().len(), 1);
    assert_eq!(
        error
            .sources()
            .locate(error.diagnostics()[0].primary.as_ref().unwrap().span),
        "program.dl:2:9"
    );
    let shown = error.to_string();
    assert!(
        shown.starts_with("error[unknown-predicate]") && shown.contains("2 | a(x) :- b(x)."),
        "{shown}"
    );
    let boxed: Box<dyn std::error::Error> = error.into();
    assert_eq!(format!("{boxed:?}"), format!("\n{shown}"));
    let include = Program::parse(".include \"other.dl\"").unwrap_err();
    assert!(
        include.to_string().contains("`Program::parse` includes no files"),
        "{include}"
    );
}

#[test]
fn rows_may_have_any_number_of_columns_up_to_the_limit() {
    for arity in 1..=32 {
        let list = |name: &str| {
            (0..arity)
                .map(|column| format!("{name}{column}"))
                .collect::<Vec<_>>()
                .join(", ")
        };
        let declared = (0..arity)
            .map(|column| format!("x{column}: number"))
            .collect::<Vec<_>>()
            .join(", ");
        let turned = (0..arity)
            .map(|column| format!("x{}", (column + 1) % arity))
            .collect::<Vec<_>>()
            .join(", ");
        let program = program(&format!(
            ".decl Base({declared})
            .decl Turned({declared})
            Turned({0}) :- Base({0}).
            Turned({turned}) :- Turned({0}).",
            list("x")
        ));
        let mut session = program.session();
        let row: Vec<i32> = (0..arity).collect();
        insert(&mut session, "Base", &[&row]);
        session.commit().unwrap();
        let turned = program.predicate("Turned").unwrap();
        assert_eq!(session.len(turned), arity as usize);
        let last: Vec<i32> = (0..arity).map(|column| (column + arity - 1) % arity).collect();
        assert!(session.contains(turned, numbers(&last)));
    }
}

#[test]
fn programs_too_large_to_plan_are_errors() {
    let mut rules = program(COPY).rules().clone();
    let literal = rules.clauses[0].body[0].clone();
    rules.clauses[0].body = vec![literal; 1_000];
    assert_eq!(
        Program::new(rules.clone()).unwrap_err().code,
        diag::codes::LIMIT_EXCEEDED
    );
    rules.clauses[0].body.truncate(100);
    assert!(Program::new(rules.clone()).is_ok());
    let column = rules.predicates[0].columns[0].clone();
    rules.predicates[1].columns = vec![column; 33];
    assert_eq!(
        Program::new(rules.clone()).unwrap_err().code,
        diag::codes::LIMIT_EXCEEDED
    );
}

#[test]
fn an_unsafe_clause_is_an_error() {
    let mut rules = program(COPY).rules().clone();
    rules.clauses[0].body.clear();
    assert_eq!(Program::new(rules).unwrap_err().code, codes::UNBOUND_VARIABLE);
}

#[test]
fn programs_and_sessions_move_between_threads() {
    fn shareable<T: Send + Sync>(_: &T) {}
    let program = program(COPY);
    shareable(&program);
    shareable(&program.session());
}

fn mixed() -> Session {
    let program = program(
        ".decl R(name: symbol, n: number)
        .decl Flag()
        .decl Copy(name: symbol, n: number)
        .decl Copied()
        Copy(x, n) :- R(x, n).
        Copied() :- Flag().",
    );
    program.session()
}

/// Loads a text into a predicate. Returns the faults as `line:column message`, those without a place as messages.
fn load(session: &mut Session, predicate: &str, text: &str) -> Result<usize, Vec<String>> {
    let mut sources = Sources::new();
    let source = sources.add("R.facts", text);
    let id = session.program().predicate(predicate).unwrap();
    facts::load(session, id, &sources, source).map_err(|faults| {
        let place = |fault: &logicity_datalog::diag::Diagnostic| {
            let Some(label) = &fault.primary else {
                return fault.message.clone();
            };
            let position = sources.position(label.span);
            assert_eq!(fault.code, codes::INVALID_FACT);
            format!("{}:{} {}", position.line, position.column, fault.message)
        };
        faults.iter().map(place).collect()
    })
}

#[test]
fn facts_are_read_and_printed_as_text() {
    let mut session = mixed();
    assert_eq!(
        load(&mut session, "R", "zoé\t10\r\nb\t9\nb\t-1\n\t2147483647\nb\t9"),
        Ok(5)
    );
    assert_eq!(load(&mut session, "R", ""), Ok(0));
    assert_eq!(load(&mut session, "Flag", "()\n"), Ok(1));
    session.commit().unwrap();
    let printed = |name: &str| facts::print(&session, session.program().predicate(name).unwrap());
    assert_eq!(printed("Copy"), "\t2147483647\nb\t-1\nb\t9\nzoé\t10\n");
    assert_eq!(printed("Copied"), "()\n");
}

#[test]
fn faulty_facts_are_located_and_nothing_is_inserted() {
    let mut session = mixed();
    let faults = load(&mut session, "R", "a\t1\né\tx\nb\nc\t1\t2\n\nd\t2147483648\n").unwrap_err();
    assert_eq!(
        faults,
        [
            "2:3 column `n` of `R` holds numbers",
            "3:1 a row of `R` has 2 values, not 1",
            "4:1 a row of `R` has 2 values, not 3",
            "5:1 an empty line where a row of `R` was expected",
            "6:3 column `n` of `R` holds numbers",
        ]
    );
    assert_eq!(
        load(&mut session, "Flag", "()\nyes\n").unwrap_err(),
        ["2:1 `Flag` has no columns; its only row is `()`"]
    );
    assert!(session.commit().unwrap().is_empty());
    let many = load(&mut session, "R", &"x\n".repeat(100_000)).unwrap_err();
    assert_eq!(many.len(), 1002);
    assert_eq!(many[1001], "more than 1001 errors; the others are not shown");
    let different: String = (0..1000).map(|count| "x\t".repeat(count) + "\n").collect();
    let many = load(&mut session, "R", &different).unwrap_err();
    assert_eq!(many.len(), MAX_FAULTS + 1);
    assert_eq!(many[MAX_FAULTS], "more than 100 errors; the others are not shown");
}

/// The values of `range`, by counting.
fn counted(from: i64, to: i64, step: i64) -> BTreeSet<i64> {
    let before = |x: i64| if step > 0 { x < to } else { x > to };
    let all = std::iter::successors(Some(from), |x| Some(x + step)).take_while(|&x| before(x));
    match step {
        0 => (from != to).then_some(from).into_iter().collect(),
        _ => all.collect(),
    }
}

/// Start, end and step of ranges with some hundred values, anywhere among all numbers.
fn ranges(least: i64, greatest: i64) -> impl proptest::strategy::Strategy<Value = (i64, i64, i64)> {
    let near = prop_oneof![-3_i64..=3, least.max(-greatest)..=greatest];
    let edge = prop_oneof![Just(least), Just(greatest), least..=greatest, -20_i64..=20];
    (edge, near, 0_i64..200, -2_i64..=2).prop_map(move |(from, step, count, beside)| {
        let within = |x: i64| x.clamp(least, greatest);
        (within(from), within(within(from) + step * count + beside), step)
    })
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn a_range_equals_counting(
        signed in ranges(i64::from(i32::MIN), i64::from(i32::MAX)),
        unsigned in ranges(0, i64::from(u32::MAX))
    ) {
        let program = program(
            ".decl S(f: number, t: number, s: number)
            .decl U(f: unsigned, t: unsigned, s: unsigned)
            .input S, U
            .decl A, B(x: number)
            .decl C, D(x: unsigned)
            A(x) :- S(f, t, s), x = range(f, t, s).
            B(x) :- S(f, t, s), s != 0, f < t, t - f <= 300, t - f >= 0, x = range(f, t).
            B(x) :- S(f, t, s), s != 0, f > t, f - t <= 300, f - t >= 0, x = range(f, t).
            C(x) :- U(f, t, s), x = range(f, t, s).
            D(x) :- U(f, t, s), s != 0, (t <= f; t - f <= 300), x = range(f, t).",
        );
        let mut session = program.session();
        let find = |name: &str| program.predicate(name).unwrap();
        let narrow = |x: i64| Value(u32::try_from(x & i64::from(u32::MAX)).unwrap());
        let row = |(from, to, step): (i64, i64, i64)| [narrow(from), narrow(to), narrow(step)];
        // As an unsigned number, a negative step is large.
        let unsigned = (unsigned.0, unsigned.1, unsigned.2.rem_euclid(1 << 32));
        session.insert(find("S"), row(signed)).unwrap();
        session.insert(find("U"), row(unsigned)).unwrap();
        session.commit().unwrap();
        let numbers = |name| {
            let rows = session.encoded_rows(find(name));
            rows.map(|row| i64::from(row[0].as_number())).collect::<BTreeSet<i64>>()
        };
        let words = |name| session.encoded_rows(find(name)).map(|row| i64::from(row[0].0)).collect::<BTreeSet<i64>>();
        let (from, to, step) = signed;
        prop_assert_eq!(numbers("A"), counted(from, to, step));
        if step != 0 && (from - to).abs() <= 300 {
            prop_assert_eq!(numbers("B"), counted(from, to, if from <= to { 1 } else { -1 }));
        }
        let (from, to, step) = unsigned;
        prop_assert_eq!(words("C"), counted(from, to, step));
        if step != 0 && (to <= from || to - from <= 300) {
            prop_assert_eq!(words("D"), counted(from, to, 1));
        }
    }

    /// Rules extend an input, in every strategy.
    #[test]
    fn an_extended_input_agrees_with_naive(
        script in proptest::collection::vec((any::<bool>(), 0_i32..5, 0_i32..5), 1..12)
    ) {
        let mut sources = Sources::new();
        let entry = sources.add(
            "edges.dl",
            ".decl Edge(x: number, y: number)
            .input Edge
            Edge(x, z) :- Edge(x, y), Edge(y, z).
            Edge(9, 1).
            .decl Loose(x: number)
            .input Loose
            Loose(x) :- Edge(x, _), !Edge(x, x)."
                .to_owned(),
        );
        let read = |_: &std::path::Path| unreachable!("nothing is included");
        let loaded = datalog::load_with(&mut sources, entry, &read, InputPolicy::Extensible);
        prop_assert!(loaded.diagnostics.iter().all(|fault| fault.code == codes::EXTENDED_INPUT));
        let rules = loaded.rules.unwrap();
        let program = Program::new(rules.clone()).unwrap();
        let edge = program.predicate("Edge").unwrap();
        for strategy in [Strategy::Auto, Strategy::Maintain, Strategy::Recompute] {
            let mut session = program.session();
            session.set_strategy(strategy);
            let mut facts = BTreeSet::new();
            for &(present, x, y) in &script {
                let row = vec![Value::number(x), Value::number(y)];
                if present {
                    session.insert(edge, &row).unwrap();
                    facts.insert((edge, row));
                } else {
                    session.retract(edge, &row).unwrap();
                    facts.remove(&(edge, row));
                }
                session.commit().unwrap();
                let expected = naive::evaluate(&rules, session.symbols(), facts.iter().cloned());
                for name in ["Edge", "Loose"] {
                    let id = program.predicate(name).unwrap();
                    let rows: BTreeSet<Vec<Value>> = session.encoded_rows(id).map(<[Value]>::to_vec).collect();
                    prop_assert_eq!(&rows, &expected[id.index()], "{} by {:?}", name, strategy);
                }
            }
        }
    }
}

#[test]
fn the_error_names_the_clause_that_derives_without_end() {
    let text = ".decl N(x: number) .decl Seed(x: number) .input Seed
        N(0).
        N(x) :- Seed(x).
        N(x + 1) :- N(x).";
    let mut session = program(text).session();
    insert(&mut session, "Seed", &[&[7]]);
    for rows in [10, 1_000] {
        session.set_limits(Limits {
            rows,
            ..Limits::default()
        });
        let error = session.commit().unwrap_err();
        let rules = session.program().rules();
        assert!(matches!(error, EvalError::TooManyRows { limit, .. } if limit == rows));
        let head = &rules.clauses[error.clause().unwrap().index()].head;
        assert!(matches!(head.terms[..], [datalog::Term::Variable(_)]));
        assert_eq!(error.clause(), Some(ClauseId(2)));
    }
}

#[test]
fn a_commit_can_be_cancelled() {
    // Endless work in rounds, in one plan, and in the rows that an aggregate scans.
    let counting = ".decl N(x: number) .decl Seed(x: number) .input Seed N(x) :- Seed(x). N(x + 1) :- N(x).";
    let product =
        ".decl A(x: number) .decl Seed(x: number) .input Seed A(x) :- Seed(x), x < 0. A(x) :- x = range(0, 1000).
        .decl B(x: number) B(x) :- Seed(_), A(x), A(y), A(z), A(w), x + y + z + w < 0.";
    let counted = ".decl A(x: number) .decl G(x: number, g: number) .decl Seed(x: number) .input Seed
        A(x) :- x = range(0, 20000). G(x, 0) :- A(x).
        .decl B(x: number) B(x) :- Seed(_), G(x, g), n = count : { G(_, g) }, n < 0.";
    for (text, from) in [(counting, "N"), (product, "B"), (counted, "B")] {
        for count in [1, 3] {
            let mut session = program(text).session();
            session.set_threads(eager(count)).unwrap();
            session.commit().unwrap();
            let before = session.encoded_rows(session.program().predicate(from).unwrap()).count();
            insert(&mut session, "Seed", &[&[7]]);
            let (cancel, polls) = counted_cancel(2);
            let error = session.commit_with(&cancel).unwrap_err();
            let clause = &session.program().rules().clauses[error.clause().unwrap().index()];
            assert!(matches!(error, EvalError::Cancelled { .. }), "{error}");
            assert_eq!(
                session.program().rules().predicates[clause.head.predicate.index()].name,
                from
            );
            assert_eq!(polls.load(Relaxed), 3, "not polled again after cancellation");
            // The session is unchanged, and the pending change can be undone.
            let predicate = session.program().predicate(from).unwrap();
            assert_eq!(session.encoded_rows(predicate).count(), before);
            session.rollback();
            assert!(session.commit_with(&Cancel::when(|| true)).unwrap().is_empty());
        }
    }
}

#[test]
fn a_commit_that_is_not_cancelled_equals_commit() {
    let text =
        ".decl A(x: number) .decl B(x: number, y: number) A(x) :- x = range(0, 300). B(x, y) :- A(x), A(y), x < y.";
    let (mut cancellable, mut plain) = (program(text).session(), program(text).session());
    let (cancel, polls) = counted_cancel(u32::MAX);
    let delta = cancellable.commit_with(&cancel);
    assert_eq!(delta, plain.commit());
    assert_eq!(cancellable.work(), plain.work());
    assert!(polls.load(Relaxed) > 0);
}
