//! The engine against its specification, and fixed examples of what it must know.

mod random_program;
mod written_program;

use logicity::diag::{Code, Sources};
use logicity::engine::{EvalError, Program, RowError, Session, StratumWork, facts, naive};
use logicity::lang::{ClauseId, Literal, RelId, Rules, Value};
use proptest::prelude::*;
use random_program::{Genome, genomes, recursive_genomes};
use std::collections::BTreeSet;
use written_program::program;

/// The least program.
const COPY: &str = ".decl Base(x: number)
    .decl Copy(x: number)
    Copy(x) :- Base(x).";

/// Everything a session holds.
fn database(session: &Session) -> naive::Database {
    let relations = session.program().rules().relations.len();
    (0..relations as u32)
        .map(|rel| session.rows(RelId(rel)).map(<[Value]>::to_vec).collect())
        .collect()
}

/// Runs the genome's script; after every batch the session is what `naive` derives from scratch.
fn check_script(genome: &Genome) -> Result<(), TestCaseError> {
    let rules = genome.rules();
    let program = Program::new(rules.clone()).expect("a generated program is safe and small");
    let mut session = program.session();
    let mut facts: BTreeSet<(RelId, Vec<Value>)> = BTreeSet::new();
    let mut before: naive::Database = vec![BTreeSet::new(); rules.relations.len()];
    for batch in 0..genome.script.len() {
        for (present, rel, row) in genome.batch(&rules, batch) {
            if present {
                session.insert(rel, &row).unwrap();
                facts.insert((rel, row));
            } else {
                session.retract(rel, &row).unwrap();
                facts.remove(&(rel, row));
            }
        }
        let delta = session.commit().unwrap();
        let after = naive::evaluate(&rules, session.symbols(), facts.iter().cloned());
        prop_assert_eq!(&database(&session), &after);

        for (rel, (before, after)) in before.iter().zip(&after).enumerate() {
            let rows = session.rows(RelId(rel as u32));
            prop_assert!(rows.is_sorted());
            let change = delta.of(RelId(rel as u32));
            prop_assert_eq!(change.is_some(), before != after);
            if let Some(change) = change {
                prop_assert!(change.added.iter().eq(after.difference(before)));
                prop_assert!(change.removed.iter().eq(before.difference(after)));
            }
        }
        for (clause, position) in rules.clauses.iter().zip(0..) {
            let fired = session.fired(ClauseId(position));
            prop_assert!(fired.iter().eq(&naive::consequences(clause, session.symbols(), &after)));
        }
        for (stratum, work) in rules.strata.iter().zip(&session.work().strata) {
            let mut clauses = stratum.clauses.iter();
            let changed = clauses.any(|clause| input_changed(&rules, *clause, &stratum.relations, &before, &after));
            prop_assert_eq!(*work != StratumWork::Skipped, batch == 0 || changed);
        }
        before = after;
    }
    Ok(())
}

/// Whether the clause reads a relation outside of its stratum that is not what it was.
fn input_changed(
    rules: &Rules,
    clause: ClauseId,
    own: &[RelId],
    before: &naive::Database,
    after: &naive::Database,
) -> bool {
    rules.clauses[clause.index()]
        .body
        .iter()
        .filter_map(Literal::atom)
        .any(|atom| {
            let own = own.contains(&atom.relation) && rules.relations[atom.relation.index()].derived;
            !own && before[atom.relation.index()] != after[atom.relation.index()]
        })
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn commits_agree_with_naive(genome in genomes(1..5)) {
        check_script(&genome)?;
    }

    #[test]
    fn recursive_commits_agree_with_naive(genome in recursive_genomes(1..4)) {
        check_script(&genome)?;
    }
}

fn insert(session: &mut Session, name: &str, rows: &[&[i32]]) {
    let rel = session.program().relation(name).unwrap();
    rows.iter().for_each(|row| session.insert(rel, &numbers(row)).unwrap());
}

fn retract(session: &mut Session, name: &str, rows: &[&[i32]]) {
    let rel = session.program().relation(name).unwrap();
    rows.iter().for_each(|row| session.retract(rel, &numbers(row)).unwrap());
}

fn numbers(row: &[i32]) -> Vec<Value> {
    row.iter().copied().map(Value::number).collect()
}

/// The relation as `facts` prints it, with spaces and commas for tabs and line ends.
fn shown(session: &Session, name: &str) -> String {
    let text = facts::print(session, session.program().relation(name).unwrap());
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
    let path = delta.of(program.relation("Path").unwrap()).unwrap();
    assert_eq!((path.added.len(), path.removed.len()), (0, 6));
    assert!(delta.of(program.relation("Sink").unwrap()).is_none());
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
    assert!(session.contains(program.relation("Alarm").unwrap(), &[]));
}

#[test]
fn what_did_not_change_is_not_redone() {
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
    // The relations of the strata that were evaluated, in the order of the text.
    let evaluated = |session: &Session| {
        let rules = session.program().rules();
        let mut relations: Vec<RelId> = session
            .work()
            .evaluated()
            .flat_map(|stratum| rules.strata[stratum].relations.clone())
            .collect();
        relations.sort_unstable();
        relations
            .iter()
            .map(|relation| rules.relations[relation.index()].name.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(evaluated(&session), ["Big", "Any", "Far", "Side"]);

    // Nothing noted, or nothing in effect.
    assert!(session.commit().unwrap().is_empty());
    assert!(evaluated(&session).is_empty());
    insert(&mut session, "In", &[&[1, 9], &[2, 9]]);
    retract(&mut session, "In", &[&[2, 9], &[3, 9]]);
    assert!(session.commit().unwrap().is_empty());
    assert!(evaluated(&session).is_empty());

    // `Big` is evaluated and stays the same: the change ends there.
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
    let side = StratumWork::Evaluated {
        rounds: 1,
        considered: 2,
    };
    assert!(session.work().strata.contains(&side) && session.work().strata.contains(&StratumWork::Skipped));
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
    let base = program.relation("Base").unwrap();
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
    session.set_limit(9);
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
    assert_eq!(session.commit(), Err(limit), "what was noted is kept");
    retract(&mut session, "Node", &[&[4]]);
    session.commit().unwrap();
    assert_eq!(session.len(program.relation("Pair").unwrap()), 9);
    insert(&mut session, "Node", &[&[4]]);
    session.rollback();
    assert!(session.commit().unwrap().is_empty());
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
    session.set_limit(1_000);
    insert(&mut session, "Seed", &[&[0, 0, 0, 0]]);
    (0..10).for_each(|letter| insert(&mut session, "Letter", &[&[letter]]));
    assert!(matches!(
        session.commit(),
        Err(EvalError::TooManyRows { limit: 1_000, .. })
    ));
    session.set_limit(10_000);
    session.commit().unwrap();
    assert_eq!(session.len(program.relation("Word").unwrap()), 10_000);
}

#[test]
fn values_without_end_are_stopped() {
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
    session.set_limit(1_000);
    insert(&mut session, "Seed", &[&[1]]);
    assert!(matches!(
        session.commit(),
        Err(EvalError::TooManyRows { limit: 1_000, .. })
    ));
    assert!(session.is_empty(program.relation("Number").unwrap()));
    retract(&mut session, "Seed", &[&[1]]);
    assert!(session.commit().unwrap().is_empty());
}

#[test]
fn rows_that_do_not_fit_are_refused() {
    let program = program(COPY);
    let (base, copy) = (program.relation("Base").unwrap(), program.relation("Copy").unwrap());
    let mut session = program.session();
    let arity = |found| RowError::Arity {
        relation: "Base".into(),
        expected: 1,
        found,
    };
    assert_eq!(session.insert(base, &[]), Err(arity(0)));
    assert_eq!(session.retract(base, &numbers(&[1, 2])), Err(arity(2)));
    assert_eq!(
        session.insert(copy, &numbers(&[1])),
        Err(RowError::Derived {
            relation: "Copy".into()
        })
    );
    assert_eq!(session.insert(RelId(7), &[]), Err(RowError::UnknownRelation));
    assert!(!session.contains(RelId(7), &[]) && !session.contains(base, &[]));
    assert_eq!(session.rows(RelId(7)).count(), 0);
}

#[test]
fn rows_may_have_any_number_of_columns_up_to_the_widest() {
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
        let turned = program.relation("Turned").unwrap();
        assert_eq!(session.len(turned), arity as usize);
        let last: Vec<i32> = (0..arity).map(|column| (column + arity - 1) % arity).collect();
        assert!(session.contains(turned, &numbers(&last)));
    }
}

#[test]
fn what_is_too_large_to_plan_is_refused() {
    let mut rules = program(COPY).rules().clone();
    let literal = rules.clauses[0].body[0].clone();
    rules.clauses[0].body = vec![literal; 1_000];
    assert_eq!(Program::new(rules.clone()).unwrap_err().code, Code::LimitExceeded);
    rules.clauses[0].body.truncate(100);
    assert!(Program::new(rules.clone()).is_ok());
    let column = rules.relations[0].columns[0].clone();
    rules.relations[1].columns = vec![column; 33];
    assert_eq!(Program::new(rules.clone()).unwrap_err().code, Code::LimitExceeded);
}

#[test]
fn an_unsafe_clause_is_refused() {
    let mut rules = program(COPY).rules().clone();
    rules.clauses[0].body.clear();
    assert_eq!(Program::new(rules).unwrap_err().code, Code::UnboundVariable);
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

/// Loads a text into a relation; the faults as `line:column message`.
fn load(session: &mut Session, relation: &str, text: &str) -> Result<usize, Vec<String>> {
    let mut sources = Sources::new();
    let source = sources.add("R.facts", text);
    let rel = session.program().relation(relation).unwrap();
    facts::load(session, rel, &sources, source).map_err(|faults| {
        let place = |fault: &logicity::diag::Diagnostic| {
            let position = sources.position(fault.primary.as_ref().unwrap().span);
            assert_eq!(fault.code, Code::InvalidFact);
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
    let printed = |name: &str| facts::print(&session, session.program().relation(name).unwrap());
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
            "5:1 a row of `R` has 2 values, not 1",
            "6:3 column `n` of `R` holds numbers",
        ]
    );
    assert_eq!(
        load(&mut session, "Flag", "()\nyes\n").unwrap_err(),
        ["2:1 `Flag` has no columns; its only row is `()`"]
    );
    assert!(session.commit().unwrap().is_empty());
    assert_eq!(
        load(&mut session, "R", &"x\n".repeat(100_000)).unwrap_err().len(),
        facts::FAULTS_MAX
    );
}
