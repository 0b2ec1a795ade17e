//! Subsumption: every program derives what the naive evaluator derives, at once and by increments.

use crate::choice::{Random, change_alike, clauses, derive_alike, predicate, program, shown};
use crate::component::{has_fault, load};
use logicity_datalog::explain::ExplanationPrinter;
use logicity_datalog::{Limits, Program, Value};

/// Programs with what some of their predicates hold.
const PROGRAMS: &[(&str, &[(&str, &str)])] = &[
    // Facts, constants, `_`, several subsumptions, a negation; neither row subsumes itself.
    (
        ".decl m(x: number)\nm(1). m(2). m(3).\n.decl r(x: number)\nr(1).\nm(x) <= m(y) :- !r(x), m(y).\n\
         .decl p(x: symbol, n: number)\np(\"a\", 1). p(\"a\", 3). p(\"b\", 2). p(\"b\", 0). p(\"c\", 9).\np(x, n) <= p(x, m) :- n < m.\np(_, 9) <= p(_, 3) :- true.\n\
         .decl o(x: symbol)\no(x) :- p(x, _).\n",
        &[("m", "1\n"), ("p", "a\t3\nb\t2\n"), ("o", "a\nb\n")],
    ),
    // Of rows that make each other superfluous, the greatest one holds.
    (
        ".decl p(x: symbol, n: number)\np(\"b\", 1). p(\"a\", 1). p(\"c\", 1). p(\"d\", 2).\np(_, n) <= p(_, m) :- n <= m, m < 2.\n",
        &[("p", "c\t1\nd\t2\n")],
    ),
    // Shortest paths on a graph with a cycle, where the recursion ends since longer paths do not hold.
    (
        ".decl e(x: number, y: number, w: number)\ne(0, 1, 4). e(0, 2, 1). e(2, 1, 2). e(1, 3, 1). e(2, 3, 5). e(3, 0, 1).\n\
         .decl d(x: number, w: number)\nd(0, 0). d(y, v + w) :- d(x, v), e(x, y, w).\nd(x, v) <= d(x, w) :- w < v.\n",
        &[("d", "0\t0\n1\t3\n2\t1\n3\t4\n")],
    ),
    // Intervals that contain others, in a component, with an aggregate over what holds.
    (
        ".comp C { .decl i(a: number, b: number)\ni(1, 5). i(2, 3). i(4, 9). i(a, d) :- i(a, b), i(c, d), c <= b, a < c.\ni(a, b) <= i(c, d) :- c <= a, b <= d. }\n\
         .init c = C\n.decl n(n: number)\nn(n) :- n = count : { c.i(_, _) }.\n",
        &[("c.i", "1\t9\n"), ("n", "1\n")],
    ),
    // A component that overrides a predicate has none of its subsumptions.
    (
        ".comp A { .decl p(x: number) overridable\np(1). p(2). p(x) <= p(y) :- x < y. }\n.comp B : A { .override p\np(1). p(2). }\n\
         .init a = A\n.init b = B\n.decl o(x: number)\no(x) :- a.p(x), b.p(x).\n",
        &[("a.p", "2\n"), ("b.p", "1\n2\n"), ("o", "2\n")],
    ),
    // Few rows remain of many, which changes the plans of the next round.
    (
        ".decl s(x: number)\ns(x) :- x = range(1, 1001).\n.decl k(z: number, x: number)\nk(5000, x) :- x = range(981, 1001).\n\
         .decl f(z: number)\nf(5000).\n.decl r(y: number, z: number, x: number)\nr(9000, 1, 1).\n\
         .decl d(x: number)\n.decl m(z: number, x: number)\nd(x) :- s(x). m(z, x) :- k(z, x). m(z, x) :- d(y), r(y, z, x).\n\
         d(z) :- d(x), m(z, x), f(z). d(x) <= d(y) :- x < y.\n",
        &[("d", "5000\n")],
    ),
    // The body reads a predicate of the same recursion.
    (
        ".decl a(x: number)\na(1). a(x + 1) :- b(x), x < 5.\n.decl b(x: number)\nb(x) :- a(x).\na(x) <= a(y) :- b(y), x + 1 < y.\n",
        &[("a", "4\n5\n"), ("b", "1\n2\n3\n4\n5\n")],
    ),
];

#[test]
fn programs_derive_what_the_naive_evaluator_derives() {
    derive_alike(PROGRAMS);
}

/// Returns a program of three strata over an input predicate, with subsumptions.
fn random_program(random: &mut Random) -> String {
    let mut text = ".decl e(x: symbol, y: number)\n.input e\n.decl i(x: symbol, y: number)\n.input i\ni(x, y) <= i(x, z) :- z < y.\n".to_owned();
    for stratum in 0..3 {
        text += &format!(".decl p{stratum}(x: symbol, y: number)\n.decl q{stratum}(x: symbol, y: number)\n");
        let before = match stratum {
            0 => vec!["e".to_owned(), "i".to_owned()],
            _ => vec![format!("p{}", stratum - 1), format!("q{}", stratum - 1), "e".to_owned()],
        };
        let before: Vec<&str> = before.iter().map(String::as_str).collect();
        for _ in 0..1 + random.below(2) {
            let order = random.of(&[
                "y < z",
                "z < y",
                "y <= z",
                "z < y, e(x, _)",
                "y != z, !e(x, y)",
                "w < x, y = z",
            ]);
            let of = random.of(&["p", "q"]);
            let other = random.of(&["x", "x", "w"]);
            let same = if other == "w" && !order.contains("w <") {
                ", w >= x"
            } else {
                ""
            };
            let order = if other == "x" {
                order.replace("w < x", "y != z")
            } else {
                order.to_owned()
            };
            text += &format!("{of}{stratum}(x, y) <= {of}{stratum}({other}, z) :- {order}{same}.\n");
        }
        text += &clauses(stratum, &before, random);
    }
    text
}

#[test]
fn random_programs_derive_what_the_naive_evaluator_derives() {
    change_alike(150, random_program, |program| program);
}

#[test]
fn explanations_name_the_row_that_holds_instead() {
    let (text, _) = PROGRAMS[2];
    let (sources, loaded) = load(text);
    let program = Program::new(loaded.rules.expect("valid")).expect("small");
    let mut session = program.session();
    session.commit().expect("small");
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let pattern = [1, 4].map(|n| Some(Value::number(n)));
    let explanation = session
        .explain_absence(predicate(&session, "d"), &pattern)
        .expect("small")
        .expect("absent");
    let said = printer.tree(&explanation);
    assert!(said.contains("d(1, 3) holds instead"), "{said}");
    // The premise of this row holds no more.
    let text = ".decl a(x: number)\na(1). a(x + 1) :- a(x), x < 3.\na(x) <= a(y) :- x = 2, y = 3.\n";
    let (sources, loaded) = load(text);
    let program = Program::new(loaded.rules.expect("valid")).expect("small");
    let mut session = program.session();
    session.commit().expect("small");
    assert_eq!(shown(&session, "a"), "1\n3\n");
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let proof = session
        .explain(predicate(&session, "a"), &[Value::number(3)])
        .expect("small")
        .expect("holds");
    assert_eq!(
        printer.tree(&proof),
        "a(3)  derived from rows that a subsumption has removed\n"
    );
}

#[test]
fn faults_say_what_is_wrong() {
    let declared = ".decl p(x: number, y: number)\n.decl q(x: number)\np(1, 2). q(1).\n";
    for (clause, code, message) in [
        ("q(x) <= p(x, _).", "syntax", "`<=` between heads is no implication"),
        (
            "q(x) <= p(x, _) :- q(x).",
            "syntax",
            "`<=` between heads is no implication",
        ),
        ("q(x) <= q(y).", "syntax", ""),
        ("q(x), q(2) <= q(y) :- x < y.", "syntax", "`<=` after several heads"),
        ("q(x) <= q(y, 1) :- x < y.", "arity-mismatch", ""),
        ("q(x) <= q(y) :- x < z.", "unbound-variable", ""),
        ("q(x) <= q(y) :- x < \"a\".", "type-mismatch", ""),
        ("q(x) <= q(y) :- x < y, r(x).", "unknown-predicate", ""),
        (
            "r(x) <= r(y) :- x < y.",
            "unknown-predicate",
            "no predicate `r` is declared",
        ),
        (
            "q(x) <= q(y) :- !s(x), x < y.\n.decl s(x: number)\ns(x) :- q(x).",
            "cyclic-negation",
            "",
        ),
        (
            ".decl k(x: number, y: number) choice-domain x\nk(1, 2).\nk(x, y) <= k(x, z) :- y < z.",
            "unsupported",
            "both keys and a subsumption",
        ),
        (
            ".decl k(x: number) inline\nk(x) :- x = 1; x = 2.\nk(x) <= k(y) :- x < y.",
            "unsupported",
            "`k` is `inline` and has a subsumption",
        ),
        (
            ".decl k(x: number, y: number) eqrel\nk(1, 2).\nk(_, x) <= k(_, y) :- x < y.",
            "unsupported",
            "`k` is `eqrel` and has a subsumption",
        ),
    ] {
        has_fault(&format!("{declared}{clause}\n"), code, message);
    }
}

#[test]
fn a_recursion_that_replaces_its_rows_without_end_is_stopped() {
    let text = ".decl a(n: number)\na(0). a(n + 1) :- a(n).\na(x) <= a(y) :- x < y.\n";
    let mut session = program(text).session();
    session.set_limits(Limits {
        rows: 1000,
        ..Limits::default()
    });
    let error = session.commit().expect_err("endless").to_string();
    assert!(error.contains("more than 1000 rows"), "{error}");
}
