//! The engine against its specification, and fixed examples of what it must know.

mod random_program;
mod written_program;

use logicity::diag::{Code, Sources};
use logicity::engine::{EvalError, Program, RowError, RuleWork, Session, Strategy, StratumWork, Work, facts, naive};
use logicity::lang::{ClauseId, RelId, Value};
use proptest::prelude::*;
use random_program::agree::{agrees, database};
use random_program::{Genome, genomes, recursive_genomes};
use std::collections::BTreeSet;
use written_program::program;

/// The least program.
const COPY: &str = ".decl Base(x: number)
    .decl Copy(x: number)
    Copy(x) :- Base(x).";

fn check_script(genome: &Genome) -> Result<(), TestCaseError> {
    let rules = genome.rules();
    agrees(&rules, &genome.batches(&rules))
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
        let rel = program.relation(name).unwrap();
        for _ in 0..count {
            let row = [Value(random(50)), Value(random(50))];
            session.insert(rel, &row).unwrap();
            facts.insert((rel, row.to_vec()));
        }
    }
    session.commit().unwrap();
    assert!(session.len(program.relation("PointsTo").unwrap()) > 700);
    let expected = naive::evaluate(program.rules(), session.symbols(), facts);
    assert_eq!(database(&session), expected);
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
}

/// What the clauses did that ran: the clause's position, rows given, rows derived.
fn ran(session: &Session) -> Vec<(u32, u64, u64)> {
    let rules = session.work().rules();
    rules.map(|rule| (rule.clause.0, rule.given, rule.derived)).collect()
}

#[test]
fn only_clauses_that_read_what_changed_run_and_only_on_that() {
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
            .all(|work| matches!(work, StratumWork::Recomputed(_)))
    );

    // One more row: one clause runs, on one row, and finds one head that was not known. So one row of `Go` is in doubt, which
    // its clause is asked about: lost, and not derived again.
    insert(&mut session, "Ill", &[&[500]]);
    let delta = session.commit().unwrap();
    assert_eq!(shown(&session, "Stop"), "9, 19, 499, 500");
    assert_eq!(ran(&session), [(1, 1, 1), (2, 1, 1), (3, 4, 2)]);
    assert_eq!(delta.changes().len(), 3);
    let looked_at: u64 = session.work().rules().map(|rule| rule.looked_at).sum();
    assert!(looked_at < 30, "{looked_at}");

    // What is known already is not derived again.
    insert(&mut session, "Old", &[&[500]]);
    assert_eq!(session.commit().unwrap().changes().len(), 1);
    assert_eq!(ran(&session), [(0, 1, 0)]);
    assert!(matches!(
        session.work().strata[..],
        [StratumWork::Maintained(_), StratumWork::Skipped]
    ));

    // The row goes; the head in doubt has another reason, and the change ends there.
    retract(&mut session, "Old", &[&[500]]);
    assert_eq!(session.commit().unwrap().changes().len(), 1);
    assert_eq!(ran(&session), [(0, 2, 1), (1, 1, 1)]);
    let rule = |clause: u32| {
        let mut rules = session.work().rules();
        *rules.find(|rule| rule.clause == ClauseId(clause)).unwrap()
    };
    // The row itself, whose neighbour it is, and whether that neighbour is known.
    let expected = RuleWork {
        clause: ClauseId(0),
        given: 2,
        looked_at: 6,
        derived: 1,
    };
    assert_eq!(rule(0), expected);
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
    assert_eq!(session.len(program.relation("Path").unwrap()), 10 * 29 * 30 / 2);

    let maintained = |session: &Session| {
        let strata = session.work().strata.iter();
        strata
            .map(|work| match work {
                StratumWork::Skipped => '-',
                StratumWork::Maintained(_) => 'm',
                StratumWork::Recomputed(Work { given_up: 0, .. }) => 'r',
                StratumWork::Recomputed(_) => 'R',
            })
            .collect::<String>()
    };
    insert(&mut session, "Edge", &[&[1_000, 1_001]]);
    session.commit().unwrap();
    assert_eq!(maintained(&session), "mm");
    retract(&mut session, "Edge", &[&[29 + 30 * 7 - 1, 29 + 30 * 7]]);
    let delta = session.commit().unwrap();
    // `Path` loses 29 rows of 4,350. `Reached` looks at 25 to begin with.
    assert_eq!(maintained(&session), "mr");
    assert_eq!(delta.of(program.relation("Path").unwrap()).unwrap().removed.len(), 29);
    assert!(session.work().rules().map(|rule| rule.looked_at).sum::<u64>() < 1_000);

    // All chains become one: it looks cheap, turns out not to be, and is given up.
    (0..9).for_each(|chain| insert(&mut session, "Edge", &[&[chain * 30 + 29, chain * 30 + 30]]));
    session.commit().unwrap();
    assert_eq!(maintained(&session), "Rr");
    // Nearly all marks change: it does not look cheap.
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
            "5:1 an empty line where a row of `R` was expected",
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
