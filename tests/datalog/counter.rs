//! Counters: every program derives what the naive evaluator derives, at once and by increments.

use crate::choice::{Random, compare, derive_alike, explain, predicate, program, shown};
use crate::component::{has_fault, load};
use logicity_datalog::explain::ExplanationPrinter;
use logicity_datalog::{PredicateId, Program, Value, facts};
use std::collections::BTreeSet;

/// Programs with what some of their predicates hold.
const PROGRAMS: &[(&str, &[(&str, &str)])] = &[
    // In heads, by value and not by the order of symbols; several in one clause; `$`.
    (
        ".decl a(s: symbol)\na(\"b\"). a(\"c\"). a(\"a\").\n.decl n(s: symbol, n: number)\nn(s, autoinc()) :- a(s).\n\
         .decl m(s: symbol, n: number, k: number)\nm(s, $, 10 * autoinc()) :- a(s), s != \"b\".\n",
        &[("n", "a\t0\nb\t1\nc\t2\n"), ("m", "a\t3\t40\nc\t5\t60\n")],
    ),
    // Facts, comparisons, and atoms in bodies; what depends on a number does not decide which solutions have one.
    (
        ".decl a(x: number)\na(2). a(0). a(5).\n.decl f(x: number)\nf(autoinc()). f(100 + autoinc()).\n.decl b(x: number, n: number)\nb(x, n) :- a(x), n = autoinc(), n > 2.\n\
         .decl c(x: number)\nc(x) :- a(x), a(autoinc()).\n",
        &[("f", "0\n101\n"), ("b", "2\t3\n5\t4\n"), ("c", "")],
    ),
    // Of all variables of the body, aggregates and negation included; the numbers are read by others.
    (
        ".decl e(x: number, y: number)\ne(1, 2). e(1, 3). e(2, 3).\n.decl n(i: number, x: number)\nn(autoinc(), x) :- e(x, y), !e(y, x), c = count : { e(x, _) }, c > 0.\n\
         .decl first(x: number)\nfirst(x) :- n(i, x), i = min j : { n(j, _) }.\n.decl k(i: number, x: number)\nk(autoinc(), i) :- n(i, _), i > 0.\n",
        &[("n", "0\t1\n1\t1\n2\t2\n"), ("first", "1\n"), ("k", "3\t1\n4\t2\n")],
    ),
    (
        ".decl a(x: number)\na(2). a(0). a(5).\n.decl c(x: number)\nc(x) :- a(x), a(autoinc()).\n",
        &[("c", "0\n2\n")],
    ),
    // In components; a clause whose predicate is declared first may be numbered last.
    (
        ".decl late(n: number)\nlate(autoinc()) :- c.v(_).\n.comp C { .decl v(x: number)\nv(autoinc()) :- n(_). }\n.init c = C\n.decl n(x: number)\nn(7). n(8).\n",
        &[("c.v", "0\n1\n"), ("late", "2\n3\n")],
    ),
];

#[test]
fn programs_derive_what_the_naive_evaluator_derives() {
    derive_alike(PROGRAMS);
}

#[test]
fn increments_equal_fresh_evaluation() {
    let text = ".decl e(x: symbol, y: number)\n.input e\n.decl n(i: number, x: symbol)\nn(autoinc(), x) :- e(x, y), y > 0.\n\
        .decl m(x: number, y: number)\nm(autoinc(), i) :- n(i, x), e(x, 2). m(i, autoinc()) :- n(i, _).\n.decl p(x: symbol, y: number)\np(x, i) :- n(i, x), i % 2 = 0. p(x, y) :- p(x, _), e(x, y).\n";
    let program = program(text);
    let mut random = Random(3);
    let mut session = program.session();
    for step in 0..60 {
        for _ in 0..2 {
            let row = (random.of(&["b", "a", "d", "c"]), random.below(3));
            match random.below(2) {
                0 => session.retract("e", row),
                _ => session.insert("e", row),
            }
            .expect("a row");
        }
        session.commit().expect("small");
        compare(&session, text);
        let mut fresh = program.session();
        for line in facts::print(&session, predicate(&session, "e")).lines().rev() {
            let (x, y) = line.split_once('\t').expect("two columns");
            fresh
                .insert("e", (x, y.parse::<i32>().expect("a number")))
                .expect("a row");
        }
        fresh.commit().expect("small");
        for id in (0..).map(PredicateId).take(program.rules().predicates.len()) {
            assert_eq!(facts::print(&session, id), facts::print(&fresh, id), "step {step}");
        }
        // No number is given twice.
        let rows = shown(&session, "n");
        let numbers: Vec<&str> = (rows.lines())
            .filter_map(|line| Some(line.split_once('\t')?.0))
            .collect();
        assert_eq!(numbers.iter().collect::<BTreeSet<_>>().len(), numbers.len(), "{rows}");
        explain(&session, text);
    }
}

#[test]
fn explanations_show_numbers() {
    let (text, _) = PROGRAMS[0];
    let (sources, loaded) = load(text);
    let program = Program::new(loaded.rules.expect("valid")).expect("small");
    let mut session = program.session();
    session.commit().expect("small");
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let b = session.symbols().get("b").expect("a symbol");
    let row = [Value(b.0), Value::number(1)];
    let proof = session
        .explain(predicate(&session, "n"), &row)
        .expect("small")
        .expect("holds");
    assert!(
        printer.tree(&proof).contains("1 = autoinc()"),
        "{}",
        printer.tree(&proof)
    );
    let pattern = [Some(Value(b.0)), Some(Value::number(7))];
    let absence = session
        .explain_absence(predicate(&session, "n"), &pattern)
        .expect("small")
        .expect("absent");
    assert!(!printer.tree(&absence).is_empty());
}

#[test]
fn faults_say_what_is_wrong() {
    let declared = ".decl a(x: number)\na(1).\n.decl s(s: symbol)\n";
    for (clause, code, message) in [
        ("a(autoinc()) :- a(x), x < 3.", "cyclic-negation", ""),
        (
            "a(n) :- n = count : { a(autoinc()) }.",
            "unsupported",
            "`autoinc()` in an aggregate",
        ),
        ("s(autoinc()) :- a(_).", "type-mismatch", ""),
        ("a(autoinc(1)).", "arity-mismatch", ""),
        ("s(x) :- n = autoinc(), n > 0.", "unbound-variable", ""),
    ] {
        has_fault(&format!("{declared}{clause}\n"), code, message);
    }
}
