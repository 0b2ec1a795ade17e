//! Compares explanations with the specification: every proof replays and has the least height, and every literal that
//! an explanation calls false is false.

use crate::cases::cases;
use crate::component::load;
use crate::proofs::{check, database};
use crate::random_program::{Genome, NUMBERS, TEXTS, computing_genomes, genomes, recursive_genomes};
use crate::rule_files::RuleFiles;
use crate::written_program::program;
use logicity_datalog::cancel::Cancel;
use logicity_datalog::diag::codes;
use logicity_datalog::diag::{Diagnostic, Limit, Sources};
use logicity_datalog::explain::{
    AbsenceReason, ExplainError, Explainer, ExplanationPrinter, FailureKind, Node, Obstacle, Origin, Premise,
};
use logicity_datalog::{
    BaseType, ClauseId, Literal, PredicateId, Rules, Value, parse_value, print_float, shortest_float,
};
use logicity_datalog::{Limits, Program, Session, naive};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

/// The height of every fact: the round that derives it, if each round fires every clause once on the facts of earlier
/// rounds. Negated atoms read the complete model.
fn heights(rules: &Rules, session: &Session, model: &naive::Database) -> Vec<BTreeMap<Vec<Value>, u32>> {
    let count = rules.predicates.len();
    let clauses: Vec<_> = rules
        .clauses
        .iter()
        .map(|clause| {
            let mut clause = clause.clone();
            for literal in &mut clause.body {
                if let Literal::Negative(atom) | Literal::Aggregate { atom, .. } = literal {
                    atom.predicate = PredicateId(atom.predicate.0 + count as u32);
                }
            }
            clause
        })
        .collect();
    let mut known: naive::Database = vec![BTreeSet::new(); count];
    let mut heights = vec![BTreeMap::new(); count];
    for (id, rows) in model
        .iter()
        .enumerate()
        .filter(|(id, _)| !rules.predicates[*id].derived)
    {
        heights[id].extend(rows.iter().map(|row| (row.clone(), 0)));
        known[id].clone_from(rows);
    }
    for clause in clauses.iter().filter(|clause| clause.body.is_empty()) {
        for row in naive::consequences(session.program().rules(), clause, session.symbols(), &known) {
            heights[clause.head.predicate.index()].insert(row.clone(), 0);
            known[clause.head.predicate.index()].insert(row);
        }
    }
    for round in 1.. {
        let mut all = known.clone();
        all.extend(model.iter().cloned());
        for clause in &clauses {
            for row in naive::consequences(session.program().rules(), clause, session.symbols(), &all) {
                let id = clause.head.predicate.index();
                if known[id].insert(row.clone()) {
                    heights[id].insert(row, round);
                }
            }
        }
        if known[..] == all[..count] {
            break;
        }
    }
    assert_eq!(&known, model);
    heights
}

/// Every row over the domain, for narrow predicates.
fn domain(rules: &Rules, id: usize) -> Vec<Vec<Value>> {
    let mut rows: Vec<Vec<Value>> = vec![Vec::new()];
    for column in &rules.predicates[id].columns {
        let values: Vec<Value> = match column.base {
            logicity_datalog::BaseType::Symbol => (0..TEXTS.len() as u32).map(Value).collect(),
            logicity_datalog::BaseType::Unsigned => NUMBERS[..3].iter().map(|n| Value(n.unsigned_abs())).collect(),
            logicity_datalog::BaseType::Record => unreachable!("random programs have no records"),
            logicity_datalog::BaseType::Float => NUMBERS[..3].iter().map(|n| Value::float(*n as f32)).collect(),
            logicity_datalog::BaseType::Number => NUMBERS[..3].iter().copied().map(Value::number).collect(),
        };
        rows = rows
            .iter()
            .flat_map(|row| values.iter().map(move |value| [row.as_slice(), &[*value]].concat()))
            .take(50)
            .collect();
    }
    rows
}

fn check_genome(genome: &Genome) {
    let rules = genome.rules();
    let program = Program::new(rules.clone()).unwrap();
    let mut session = program.session();
    for batch in 0..genome.script.len() {
        for (present, id, row) in genome.batch(&rules, batch) {
            if present {
                session.insert(id, &row).unwrap();
            } else {
                session.retract(id, &row).unwrap();
            }
        }
    }
    session.commit().unwrap();
    let model = database(&session);
    let heights = heights(&rules, &session, &model);
    let mut explainer = Explainer::new(&session);
    for (id, rows) in model.iter().enumerate() {
        for row in rows.iter().take(30) {
            let explanation = explainer
                .explain(PredicateId(id as u32), row)
                .unwrap()
                .expect("it holds");
            let Node::Fact(fact) = &explanation.nodes()[0] else {
                panic!()
            };
            assert_eq!((fact.predicate.index(), &fact.row), (id, row));
            for node in explanation.nodes() {
                if let Node::Fact(fact) = node {
                    assert_eq!(fact.height, heights[fact.predicate.index()][&fact.row]);
                }
            }
            check(&session, &model, &explanation);
            // A fresh explainer gives the same explanation.
            if Some(row) == rows.first() || Some(row) == rows.iter().take(30).next_back() {
                assert_eq!(
                    session.explain(PredicateId(id as u32), row).unwrap().as_ref(),
                    Some(&explanation)
                );
            }
        }
        let domain = domain(&rules, id);
        for row in &domain {
            let wanted: Vec<Option<Value>> = row.iter().copied().map(Some).collect();
            let explanation = explainer.explain_absence(PredicateId(id as u32), &wanted).unwrap();
            assert_eq!(explanation.is_none(), rows.contains(row));
            if Some(row) == domain.last() {
                let fresh = session.explain_absence(PredicateId(id as u32), &wanted).unwrap();
                assert_eq!(fresh, explanation);
            }
            if let Some(explanation) = explanation {
                check(&session, &model, &explanation);
                assert!(explainer.explain(PredicateId(id as u32), row).unwrap().is_none());
            }
        }
    }
}

/// A literal matters if the clause without it derives new rows from the complete model.
fn check_matters(genome: &Genome) {
    let rules = genome.rules();
    let mut session = Program::new(rules.clone()).unwrap().session();
    for (present, predicate, row) in genome.batch(&rules, 0).into_iter().filter(|(present, ..)| *present) {
        assert!(present);
        session.insert(predicate, &row).unwrap();
    }
    session.commit().unwrap();
    let model = database(&session);
    let mut explainer = Explainer::new(&session);
    for (clause, id) in rules.clauses.iter().zip(0..) {
        for literal in 0..clause.body.len() {
            let Some(matters) = explainer.matters(ClauseId(id), literal).unwrap() else {
                continue;
            };
            let mut less = clause.clone();
            less.body.remove(literal);
            let derived = naive::consequences(&rules, &less, session.symbols(), &model);
            assert_eq!(matters, !derived.is_subset(&model[clause.head.predicate.index()]));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 2_000, ..cases(96) })]

    #[test]
    fn random_programs_are_explained(genome in genomes(1..3)) {
        check_genome(&genome);
    }

    #[test]
    fn literals_that_matter_agree_with_the_definition(genome in genomes(1..2)) {
        check_matters(&genome);
    }

    #[test]
    fn expressions_and_floats_are_explained(genome in computing_genomes(1..3)) {
        check_genome(&genome);
        check_matters(&genome);
    }

    #[test]
    fn shown_floats_read_back(bits in any::<u32>()) {
        let float = Value::float(f32::from_bits(bits));
        let shown = shortest_float(float.as_float());
        prop_assert_eq!(parse_value(BaseType::Float, &shown), Some(float), "{}", shown);
        prop_assert!(shown.len() <= print_float(float.as_float()).len(), "{}", shown);
    }

    #[test]
    fn random_recursion_is_explained(genome in recursive_genomes(1..2)) {
        check_genome(&genome);
    }
}

#[test]
fn floats_are_shown_as_written() {
    let (sources, loaded) = load(".decl p, q(x: float)\np(0.45).\np(1e20).\nq(x * 2) :- p(x).\n");
    let program = Program::new(loaded.rules.unwrap()).unwrap();
    let mut session = program.session();
    session.commit().unwrap();
    let shown = |row: f32| {
        let why = Explainer::new(&session).explain(program.predicate("q").unwrap(), &[Value::float(row)]);
        ExplanationPrinter::new(program.rules(), session.symbols(), &sources).tree(&why.unwrap().unwrap())
    };
    assert!(shown(0.9).starts_with("q(0.9)"), "{}", shown(0.9));
    assert!(shown(2e20).contains("p(1e+20)"), "{}", shown(2e20));
}

fn numbers(row: &[i32]) -> Vec<Value> {
    row.iter().copied().map(Value::number).collect()
}

/// A session with these numbers in these predicates.
fn session(text: &str, facts: &[(&str, &[&[i32]])]) -> Session {
    let program = program(text);
    let mut session = program.session();
    for (name, rows) in facts {
        let id = program.predicate(name).unwrap();
        rows.iter().for_each(|row| session.insert(id, numbers(row)).unwrap());
    }
    session.commit().unwrap();
    session
}

const PATHS: &str = ".decl edge(x: number, y: number)
    .input edge
    .decl path(x: number, y: number)
    path(x, y) :- edge(x, y).
    path(x, z) :- path(x, y), path(y, z).";

#[test]
fn a_long_chain_has_a_proof_of_logarithmic_height() {
    let edges: Vec<Vec<i32>> = (0..64).map(|at| vec![at, at + 1]).collect();
    let edges: Vec<&[i32]> = edges.iter().map(Vec::as_slice).collect();
    let session = session(PATHS, &[("edge", &edges)]);
    let path = session.program().predicate("path").unwrap();
    let proof = session.explain(path, &numbers(&[0, 64])).unwrap().unwrap();
    let Node::Fact(fact) = &proof.nodes()[0] else { panic!() };
    assert_eq!(fact.height, 7);
    check(&session, &database(&session), &proof);
}

#[test]
fn expressions_and_aggregates_are_leaves_with_their_values() {
    let text = ".decl edge(x: number, y: number)
        .input edge
        .decl degree, next, far(x: number, n: number)
        .decl inverse(x: number)
        degree(x, n) :- edge(x, _), n = count : { edge(x, _) }.
        next(x, z) :- degree(x, n), z = n + 1.
        far(x, s) :- edge(x, _), s = sum y : { edge(x, y), y > x }.
        inverse(x) :- edge(x, y), 1 = 1 / y.
        .decl reach(x: number, n: number)
        reach(1, 0).
        reach(y, m) :- reach(x, n), edge(x, y), n < 3, c = count : { edge(x, w), w >= n }, m = n + c.";
    let session = session(text, &[("edge", &[&[1, 2], &[1, 3], &[1, 0], &[2, 0]])]);
    let rules = session.program().rules();
    let model = database(&session);
    let sources = Sources::new();
    let printer = ExplanationPrinter::new(rules, session.symbols(), &sources);
    let leaves = |name: &str, row: &[i32]| {
        let id = session.program().predicate(name).unwrap();
        let proof = session.explain(id, &numbers(row)).unwrap().unwrap();
        check(&session, &model, &proof);
        let Node::Fact(fact) = &proof.nodes()[0] else { panic!() };
        let Origin::Derived(derivation) = &fact.origin else {
            panic!()
        };
        let clause = &rules.clauses[derivation.clause.index()];
        let computed = |premise: &Premise| matches!(premise, Premise::Computed { .. });
        let at = derivation.premises.iter().position(computed).unwrap();
        printer.literal(clause, &clause.body[at], &derivation.binding)
    };
    assert_eq!(leaves("next", &[1, 4]), "4 = 3 + 1");
    assert_eq!(leaves("degree", &[1, 3]), "3 = count : { edge(1, _) }");
    assert_eq!(leaves("far", &[1, 5]), "5 = sum y : { edge(1, y), y > 1 }");
    for (name, row, value) in [
        ("next", [1, 9], Some(Value::number(4))),
        ("degree", [1, 9], Some(Value::number(3))),
    ] {
        let id = session.program().predicate(name).unwrap();
        let wanted: Vec<Option<Value>> = numbers(&row).into_iter().map(Some).collect();
        let absence = session.explain_absence(id, &wanted).unwrap().unwrap();
        check(&session, &model, &absence);
        let Node::Absence(explained) = &absence.nodes()[0] else {
            panic!()
        };
        let AbsenceReason::NoClause(misses) = &explained.reason else {
            panic!()
        };
        let Obstacle::Body { failures, .. } = &misses[0].obstacle else {
            panic!()
        };
        assert_eq!(failures[0].kind, FailureKind::Computed { value });
    }
    // The same for an aggregate that is evaluated in place.
    assert_eq!(leaves("reach", &[2, 3]), "3 = count : { edge(1, w), w >= 0 }");
    let reach = session.program().predicate("reach").unwrap();
    let absence = session.explain_absence(reach, &numbers(&[2, 2]).into_iter().map(Some).collect::<Vec<_>>());
    check(&session, &model, &absence.unwrap().unwrap());
    let inverse = session.program().predicate("inverse").unwrap();
    let absence = session.explain_absence(inverse, &[Some(Value::number(2))]);
    check(&session, &model, &absence.unwrap().unwrap());
}

#[test]
fn a_proof_may_be_deep() {
    let text = ".decl edge(x: number, y: number) .decl start(x: number) .decl reach(x: number)
        reach(x) :- start(x).
        reach(y) :- reach(x), edge(x, y).";
    let edges: Vec<Vec<i32>> = (0..5_000).map(|at| vec![at, at + 1]).collect();
    let edges: Vec<&[i32]> = edges.iter().map(Vec::as_slice).collect();
    let session = session(text, &[("edge", &edges), ("start", &[&[0]])]);
    let reach = session.program().predicate("reach").unwrap();
    let proof = session.explain(reach, &numbers(&[5_000])).unwrap().unwrap();
    // The start, 5,000 edges, and 5,001 rows of `reach`.
    assert_eq!(proof.nodes().len(), 10_002);
}

#[test]
fn a_search_beyond_its_limit_is_reported_and_leaves_no_partial_result() {
    let edges: Vec<Vec<i32>> = (0..40).map(|at| vec![at, at + 1]).collect();
    let edges: Vec<&[i32]> = edges.iter().map(Vec::as_slice).collect();
    let session = session(PATHS, &[("edge", &edges)]);
    let path = session.program().predicate("path").unwrap();
    let expected = session.explain(path, &numbers(&[0, 40])).unwrap();
    let mut explainer = Explainer::new(&session);
    for limit in [0, 1, 10, 100, 1_000, 5_000] {
        explainer.set_limit(limit);
        let error = explainer.explain(path, &numbers(&[0, 40])).unwrap_err();
        assert_eq!(error, ExplainError::TooMuchWork { limit });
        assert!(error.to_string().contains(&limit.to_string()));
    }
    explainer.set_limit(Explainer::LIMIT);
    assert_eq!(explainer.explain(path, &numbers(&[0, 40])).unwrap(), expected);
}

#[test]
fn a_question_can_be_cancelled_and_repeated() {
    let edges: Vec<Vec<i32>> = (0..60).map(|at| vec![at, at + 1]).collect();
    let edges: Vec<&[i32]> = edges.iter().map(Vec::as_slice).collect();
    let session = session(PATHS, &[("edge", &edges)]);
    let path = session.program().predicate("path").unwrap();
    let polls = Arc::new(AtomicU32::new(0));
    let cancelled = Arc::new(AtomicBool::new(true));
    let cancel = {
        let (polls, cancelled) = (Arc::clone(&polls), Arc::clone(&cancelled));
        Cancel::when(move || {
            polls.fetch_add(1, Relaxed);
            cancelled.load(Relaxed)
        })
    };
    let mut explainer = Explainer::new_with(&session, &cancel);
    assert_eq!(
        explainer.explain(path, &numbers(&[0, 60])),
        Err(ExplainError::Cancelled)
    );
    assert_eq!(polls.load(Relaxed), 1);
    cancelled.store(false, Relaxed);
    let expected = session.explain(path, &numbers(&[0, 60]));
    assert_eq!(explainer.explain(path, &numbers(&[0, 60])), expected);
    assert!(expected.unwrap().is_some() && polls.load(Relaxed) > 1);
}

#[test]
fn invalid_questions_have_no_answer() {
    let session = session(PATHS, &[("edge", &[&[1, 2]])]);
    let path = session.program().predicate("path").unwrap();
    assert!(session.explain(PredicateId(9), &[]).unwrap().is_none());
    assert!(session.explain(path, &numbers(&[1])).unwrap().is_none());
    assert!(session.explain_absence(PredicateId(9), &[]).unwrap().is_none());
    assert!(session.explain_absence(path, &[None]).unwrap().is_none());
    assert!(session.explain_absence(path, &[None, None]).unwrap().is_none());
    assert!(Explainer::new(&session).matters(ClauseId(9), 0).unwrap().is_none());
    assert!(Explainer::new(&session).matters(ClauseId(0), 9).unwrap().is_some());
}

/// A program, its facts, a question, and the printed answer.
fn explained(text: &str, facts: &[(&str, &[&[i32]])], name: &str, row: &[i32]) -> String {
    let mut sources = Sources::new();
    let entry = sources.add("rules.dl", text);
    let rules = logicity_datalog::load(&mut sources, entry, &RuleFiles).rules.unwrap();
    let program = Program::new(rules).unwrap();
    let mut session = program.session();
    for (name, rows) in facts {
        let id = program.predicate(name).unwrap();
        rows.iter().for_each(|row| session.insert(id, numbers(row)).unwrap());
    }
    session.commit().unwrap();
    let id = program.predicate(name).unwrap();
    let wanted: Vec<Option<Value>> = numbers(row).into_iter().map(Some).collect();
    let explanation = match session.explain(id, &numbers(row)).unwrap() {
        Some(proof) => proof,
        None => session.explain_absence(id, &wanted).unwrap().unwrap(),
    };
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let json = printer.json(&explanation);
    assert_eq!(json["nodes"].as_array().unwrap().len(), explanation.nodes().len());
    assert!(!json.to_string().contains('+'), "the JSON names a hidden predicate");
    printer.tree(&explanation)
}

#[test]
fn explanations_name_the_variables_of_the_source() {
    let text = "
.decl a(x: number, g: number)
.decl oldest, youngest, second(x: number)
.input a
oldest(x) :- m = max x : a(x, _), m > 1.
youngest(x) :- m = min e : { a(x, y), e = y * 2 }, m > 1.
second(x) :- m = max g : a(x, g), m > 1.";
    let facts: &[(&str, &[&[i32]])] = &[("a", &[&[1, 3], &[2, 2]])];
    let of = |name: &str, row: i32| {
        let tree = explained(text, facts, name, &[row]);
        tree.split_once('\n').unwrap().1.trim_end().to_owned()
    };
    let wanted = "\
├─ 2 = max x : { a(x, _) }
├─ a(2, 2)
├─ 2 = 2
└─ 2 > 1";
    assert_eq!(of("oldest", 2), wanted);
    let wanted = "\
├─ 4 = min e : { a(x, y), e = y * 2 }
├─ a(2, 2)
├─ 4 = 2 * 2
├─ 4 = 4
└─ 4 > 1";
    assert_eq!(of("youngest", 2), wanted);
    let wanted = "\
├─ 3 = max g : { a(_, g) }
├─ a(1, 3)
├─ 3 = 3
└─ 3 > 1";
    assert_eq!(of("second", 1), wanted);
    let wanted = "\
└─ youngest(x) :- m = min e : { a(x, y), e = y * 2 }, m > 1.  [rules.dl:6]
   └─ nearest m = 4, e = 4: a(7, y) does not hold";
    assert_eq!(of("youngest", 7), wanted);
}

#[test]
fn alternatives_and_other_heads_of_an_absence_share_a_line() {
    let text = "
.decl e(x: number)
.decl a(x: number, y: number)
.input e
a(x, 1) :- e(x).
a(x, 2) :- e(x), (x > 3; x > 4; x > 5).
a(x, 3) :- (e(x); e(y), x = y * 2; e(x), x > 1; e(x), x > 2), x < 9.
a(x, 4) :- e(x).
a(4, y) :- e(y), y = 3.
";
    assert_eq!(
        explained(text, &[("e", &[&[7]])], "a", &[3, 3]),
        "\
Not(a(3, 3)): no clause of a holds
├─ a(x, 3) :- (e(x); e(y), x = y * 2; e(x), x > 1; e(x), x > 2), x < 9.  [rules.dl:7]
│  ├─ e(3) does not hold
│  └─ nearest y = 7: 3 = 7 * 2 fails: it is 14
├─ a(4, y) :- e(y), y = 3.  [rules.dl:9]
│  └─ its head has another value in column 1
└─ the heads of 3 clauses have another value in column 2  [rules.dl:5, rules.dl:6, rules.dl:8]
"
    );
}

#[test]
fn trees_are_printed_as_expected() {
    let text = "
.decl edge(x: number, y: number)
.decl big(x: number)
.decl path(x: number, y: number)
.decl lone(x: number)
.input edge, big
/// E: an edge is a path
path(x, y) :- edge(x, y).
/// P: and so is one after another
path(x, z) :- path(x, y), edge(y, z), x < 9.
big(7).
lone(x) :- big(x), !path(x, _).
";
    let edges: &[(&str, &[&[i32]])] = &[("edge", &[&[1, 2], &[2, 3], &[9, 1]])];
    assert_eq!(
        explained(text, edges, "path", &[1, 3]),
        "\
path(1, 3)  by P: and so is one after another  [rules.dl:10]
├─ path(1, 2)  by E: an edge is a path  [rules.dl:8]
│  └─ edge(1, 2)
├─ edge(2, 3)
└─ 1 < 9
"
    );
    assert_eq!(
        explained(text, edges, "path", &[9, 2]),
        "\
Not(path(9, 2)): no clause of path holds
├─ E: an edge is a path  [rules.dl:8]
│  └─ edge(9, 2) does not hold
└─ P: and so is one after another  [rules.dl:10]
   └─ 9 < 9 fails
"
    );
    assert_eq!(
        explained(text, edges, "lone", &[7]),
        "\
lone(7)  by lone(x) :- big(x), !path(x, _).  [rules.dl:12]
├─ big(7)  [rules.dl:11]
└─ Not(path(7, _)): no clause of path holds
   ├─ E: an edge is a path  [rules.dl:8]
   │  └─ edge(7, y) does not hold
   └─ P: and so is one after another  [rules.dl:10]
      └─ nearest y = 9: path(7, 9) does not hold
         ├─ E: an edge is a path  [rules.dl:8]
         │  └─ edge(7, 9) does not hold
         └─ P: and so is one after another  [rules.dl:10]
            ├─ path(7, y) does not hold  (circular)
            └─ edge(y, 9) does not hold
"
    );
}

#[test]
fn views_are_reported_and_hidden_predicates_are_not() {
    let text = "
.decl sees(x: number, y: number)
.decl near(x: number, y: number)
.decl car(x: number)
.decl free(x: number)
.decl go(x: number)
.input sees, near, car
.scope sees
/// F: no agent in view is near
free(X) :- car(X), !near(X, _).
/// G: an agent in view is free
go(X) :- car(X), free(Y).
";
    let facts: &[(&str, &[&[i32]])] = &[
        ("car", &[&[1], &[2], &[3]]),
        ("near", &[&[1, 2], &[2, 3]]),
        ("sees", &[&[1, 1], &[1, 2], &[2, 2], &[3, 1], &[3, 3]]),
    ];
    // 2 is near to 3, but does not see it.
    assert_eq!(
        explained(text, facts, "go", &[1]),
        "\
go(1)  by G: an agent in view is free  [rules.dl:12]
├─ car(1)
├─ free(2)  by F: no agent in view is near  [rules.dl:10]
│  ├─ car(2)
│  └─ Not(near(2, _) in view)
│     └─ not in view: sees(2, 3)
└─ in view: sees(1, 2)
"
    );
    assert_eq!(
        explained(text, facts, "free", &[1]),
        "\
Not(free(1)): no clause of free holds
└─ F: no agent in view is near  [rules.dl:10]
   └─ Not(near(1, _) in view) fails
      └─ near(1, _) in view
         ├─ near(1, 2)
         └─ in view: sees(1, 2)
"
    );
    assert_eq!(
        explained(text, &[facts[0], facts[1]], "go", &[1]),
        "\
Not(go(1)): no clause of go holds
└─ G: an agent in view is free  [rules.dl:12]
   └─ nearest Y = 2: not in view: sees(1, 2)
"
    );
}

#[test]
fn a_range_is_printed_as_in_the_text() {
    let text = "
.decl upto(n: number)
.decl a(x: number)
.input upto
a(x) :- upto(n), x = range(0, n).
";
    let facts: &[(&str, &[&[i32]])] = &[("upto", &[&[3]])];
    assert_eq!(
        explained(text, facts, "a", &[2]),
        "\
a(2)  by a(x) :- upto(n), x = range(0, n).  [rules.dl:5]
├─ upto(3)
└─ 2 = range(0, 3, 1)
"
    );
    assert_eq!(
        explained(text, facts, "a", &[3]),
        "\
Not(a(3)): no clause of a holds
└─ a(x) :- upto(n), x = range(0, n).  [rules.dl:5]
   └─ nearest n = 3: 3 = range(0, 3, _) does not hold
"
    );
}

/// The search for an explanation evaluates correlated aggregates again. They count against the memory limit.
#[test]
fn aggregates_in_explanations_stay_within_the_memory_limit() {
    let program = program(
        ".decl V(v: number)
        V(v) :- v = range(0, 100).
        .decl A(n: number)
        A(0).
        A(n + c) :- A(n), n < 1, c = count : { V(v), V(w), v > n, w > v }.",
    );
    let a = program.predicate("A").unwrap();
    let row = [Value::number(99 * 98 / 2)];
    let mut session = program.session();
    session.commit().unwrap();
    let proof = session.explain(a, &row).unwrap().expect("it holds");
    let limits = |bytes| Limits {
        bytes,
        ..Limits::default()
    };
    session.set_limits(limits(session.bytes() + (1 << 20)));
    assert_eq!(session.explain(a, &row), Ok(Some(proof)));
    session.set_limits(limits(1000));
    let error = session.explain(a, &row).unwrap_err();
    assert_eq!(error, ExplainError::TooMuchMemory { limit: 1000 });
    let fault = Diagnostic::from(error);
    assert_eq!(
        fault.message,
        "the search for an explanation takes more than 1000 bytes"
    );
    assert_eq!(
        (fault.code, fault.limit),
        (codes::LIMIT_EXCEEDED, Some(Limit::Memory(1000)))
    );
    // A fact that no aggregate derives needs little.
    session.set_limits(limits(session.bytes() + (1 << 14)));
    assert!(session.explain(a, &[Value::number(0)]).unwrap().is_some());
}
