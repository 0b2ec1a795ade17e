//! Records: every program derives what the naive evaluator derives, at once and by increments.

use crate::cases::cases;
use crate::choice::Random;
use crate::component::{has_fault, load};
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::explain::{ExplanationPrinter, Node, Origin};
use logicity_datalog::{Limits, PredicateId, Program, Session, Value, facts, format, naive, parse, print};
use std::collections::BTreeSet;

fn program(text: &str) -> Program {
    let (sources, loaded) = load(text);
    let shown = render(&loaded.diagnostics, &sources, false);
    Program::new(loaded.rules.unwrap_or_else(|| panic!("{text}\n{shown}"))).expect("small")
}

/// Returns the code and the message of each diagnostic.
fn messages(text: &str) -> Vec<(&'static str, String)> {
    let (_, loaded) = load(text);
    let faults = loaded.diagnostics.into_iter();
    faults.map(|fault| (fault.code.name(), fault.message)).collect()
}

fn predicate(session: &Session, name: &str) -> PredicateId {
    let predicates = &session.program().rules().predicates;
    let at = predicates.iter().position(|predicate| predicate.name == name);
    PredicateId(u32::try_from(at.expect("declared")).expect("few"))
}

/// Returns the rows of all declared predicates, as text.
fn rows(session: &Session) -> Vec<(String, String)> {
    let predicates = session.program().rules().predicates.iter();
    let shown = (0..).map(PredicateId).zip(predicates);
    shown
        .filter(|(_, predicate)| !predicate.hidden)
        .map(|(id, predicate)| (predicate.name.clone(), facts::print(session, id)))
        .collect()
}

/// Checks a session against the naive evaluator, given the rows inserted by their predicates.
fn compare(session: &Session, given: &[(PredicateId, Vec<Value>)], text: &str) {
    let rules = session.program().rules();
    let edb = |id: PredicateId| rules.predicates[id.index()].edb.unwrap_or(id);
    let given: Vec<(PredicateId, Vec<Value>)> = given.iter().map(|(id, row)| (edb(*id), row.clone())).collect();
    // A copy numbers records as the session does.
    let symbols = session.symbols().clone();
    let database = naive::evaluate(rules, &symbols, given);
    for (id, predicate) in (0..).map(PredicateId).zip(&rules.predicates) {
        if predicate.hidden {
            continue;
        }
        let found: BTreeSet<Vec<Value>> = session.encoded_rows(id).map(<[Value]>::to_vec).collect();
        assert_eq!(found, database[id.index()], "{}\n{text}", predicate.name);
    }
}

/// Programs with what some of their predicates hold.
const PROGRAMS: &[(&str, &[(&str, &str)])] = &[
    // Fields bind from a column, a record from its fields; `nil` and constants are tests.
    (
        ".type Pair = [x: number, y: symbol]\n.decl p, back(r: Pair)\n.decl q, two(x: number, y: symbol)\n.decl nils(n: number)\n\
         p([1, \"a\"]). p([2, \"b, c\"]). p(nil).\nq(x, y) :- p([x, y]).\nback([x, y]) :- q(x, y).\n\
         two(x, y) :- p(r), r = [2, y], x = 2. two(0, \"\") :- p(r), r = nil.\nnils(n) :- n = count : { p(nil) }.\n",
        &[
            ("back", "[1, a]\n[2, \"b, c\"]\n"),
            ("q", "1\ta\n2\tb, c\n"),
            ("two", "0\t\n2\tb, c\n"),
            ("nils", "1\n"),
        ],
    ),
    // Lists: built by recursion within a bound, summed, reversed, nested patterns.
    (
        ".type List = [head: number, tail: List]\n.decl l(l: List, n: number)\n.decl total(l: List, n: number)\n.decl drop(l: List)\n\
         .decl rev(todo: List, done: List)\n.decl reversed(l: List, r: List)\n\
         l(nil, 0). l([n, t], n + 1) :- l(t, n), n < 4.\ntotal(nil, 0). total(l, n + m) :- l(l, _), l = [n, t], total(t, m).\n\
         drop(t) :- l([_, [_, t]], _).\nrev(l, nil) :- l(l, 4). rev(t, [h, d]) :- rev([h, t], d).\nreversed(l, r) :- l(l, 4), rev(nil, r).\n",
        &[
            (
                "total",
                "nil\t0\n[0, nil]\t0\n[1, [0, nil]]\t1\n[2, [1, [0, nil]]]\t3\n[3, [2, [1, [0, nil]]]]\t6\n",
            ),
            ("drop", "nil\n[0, nil]\n[1, [0, nil]]\n"),
            ("reversed", "[3, [2, [1, [0, nil]]]]\t[0, [1, [2, [3, nil]]]]\n"),
        ],
    ),
    // Trees: equality of whole trees, fields of several types, records in negated atoms and aggregates.
    (
        ".type Tree = [l: Tree, key: symbol, w: float, r: Tree]\n.decl t(t: Tree)\n.decl in(t: Tree, key: symbol)\n.decl leaf(key: symbol)\n\
         .decl same(a: Tree)\n.decl twin(key: symbol)\n.decl size(t: Tree, n: number)\n.decl light(t: Tree, w: float)\n\
         t([[nil, \"a\", 0.5, nil], \"b\", 1, [nil, \"c\", 2.25, nil]]). t([nil, \"d\", -1, nil]).\n\
         t(l) :- t([l, _, _, _]), l != nil. t(r) :- t([_, _, _, r]), r != nil.\nin(t, k) :- t(t), t = [_, k, _, _].\n\
         in(t, k) :- t(t), t = [l, _, _, _], in(l, k). in(t, k) :- t(t), t = [_, _, _, r], in(r, k).\n\
         leaf(k) :- t([nil, k, _, nil]).\nsame(a) :- t(a), t(b), a = b.\n\
         twin(k) :- in(_, k), !t([nil, k, -1, nil]).\nsize(t, n) :- t(t), n = count : { in(t, _) }.\n\
         light(t, w) :- t(t), w = min v : { t([_, _, v, _]) }.\n",
        &[
            ("leaf", "a\nc\nd\n"),
            ("twin", "a\nb\nc\n"),
            (
                "size",
                "[nil, a, 0.5, nil]\t1\n[nil, c, 2.25, nil]\t1\n[nil, d, -1, nil]\t1\n[[nil, a, 0.5, nil], b, 1, [nil, c, 2.25, nil]]\t3\n",
            ),
        ],
    ),
    // An interpreter of expressions: [operator, left, right], a number where both are nil.
    (
        ".type Expr = [op: symbol, n: number, a: Expr, b: Expr]\n.decl root, sub(e: Expr)\n.decl value(e: Expr, n: number)\n.decl result(n: number)\n\
         root([\"+\", 0, [\"n\", 2, nil, nil], [\"*\", 0, [\"n\", 3, nil, nil], [\"n\", 4, nil, nil]]]).\n\
         sub(e) :- root(e). sub(a), sub(b) :- sub([_, _, a, b]), a != nil, b != nil.\n\
         value(e, n) :- sub(e), e = [\"n\", n, nil, nil].\nvalue(e, x + y) :- sub(e), e = [\"+\", _, a, b], value(a, x), value(b, y).\n\
         value(e, x * y) :- sub(e), e = [\"*\", _, a, b], value(a, x), value(b, y).\nresult(n) :- root(e), value(e, n).\n",
        &[("result", "14\n")],
    ),
    // Records as contexts; subtypes and aliases of record types; a record type as an argument of a component.
    (
        ".type Context = [site: number, rest: Context]\n.type Short <: Context\n.type Same = Context\n.comp Keep<T> { .decl kept(x: T) }\n\
         .init k = Keep<Context>\n.decl call(from: number, to: number)\n.decl reach(m: number, c: Same)\n.decl short(c: Context)\n\
         call(1, 2). call(2, 3). call(3, 1).\nreach(1, nil). reach(m, [n, [o, nil]]) :- reach(n, [o, _]), call(n, m). reach(m, [n, nil]) :- reach(n, nil), call(n, m).\n\
         k.kept(c) :- reach(_, c).\nshort(c) :- k.kept(c), c = [_, nil].\n",
        &[
            ("short", "[1, nil]\n"),
            (
                "reach",
                "1\tnil\n1\t[3, [2, nil]]\n2\t[1, nil]\n2\t[1, [3, nil]]\n3\t[2, [1, nil]]\n",
            ),
        ],
    ),
    // Both sides unbound but for fields; records within expressions of an equation; alternatives; unions of literals.
    (
        ".type P = [a: number, b: Q]\n.type Q = [c: number]\n.decl n(x: number)\n.decl p(p: P)\n.decl q(x: number, y: number)\n\
         n(1). n(2).\np(r) :- n(x), r = [x, s], s = [x + 1].\np([x, nil]) :- n(x), x > 1.\n\
         q(x, y) :- [x, [y]] = r, p(r).\nq(x, 0) :- (p([x, nil]); p([x, [3]])).\nq(9, x) :- n(x), as([x, nil], P) = r, p(r), r = [x, nil].\n",
        &[
            ("p", "[1, [2]]\n[2, nil]\n[2, [3]]\n"),
            ("q", "1\t2\n2\t0\n2\t3\n9\t2\n"),
        ],
    ),
    // Branches: constructors, patterns, tests, nested, with and without fields; in components and beside each other.
    (
        ".type Shape = Circle {r: number} | Square {side: number} | Point {} | Both {a: Shape, b: Shape}\n.decl s(s: Shape)\n\
         .decl area(s: Shape, n: number)\n.decl point(n: number)\n.decl in(s: Shape)\n\
         s($Circle(3)). s($Point). s($Point()). s($Both($Square(2), $Both($Point, $Circle(1)))).\n\
         in(s) :- s(s). in(a), in(b) :- in($Both(a, b)).\narea(s, 3 * r * r) :- in(s), s = $Circle(r). area(s, x * x) :- in(s), s = $Square(x).\n\
         area(s, 0) :- in(s), s = $Point.\narea(s, n + m) :- in(s), s = $Both(a, b), area(a, n), area(b, m).\n\
         point(n) :- n = count : { s($Point()) }. point(7) :- s($Both(_, $Both($Point, _))), !s($Square(2)).\n",
        &[
            ("point", "1\n7\n"),
            (
                "area",
                "$Both($Point, $Circle(1))\t3\n$Both($Square(2), $Both($Point, $Circle(1)))\t7\n$Circle(1)\t3\n$Circle(3)\t27\n$Point\t0\n$Square(2)\t4\n",
            ),
        ],
    ),
    (
        ".comp C { .type E = Num {n: number} | Add {a: E, b: E}\n.decl e(e: E)\n.decl v(e: E, n: number)\ne($Add($Num(1), $Num(2))).\n\
         e(a), e(b) :- e($Add(a, b)).\nv(e, n) :- e(e), e = $Num(n). v(e, n + m) :- e(e), e = $Add(a, b), v(a, n), v(b, m). }\n\
         .init c = C\n.init d = C\n.decl out(n: number)\nout(n) :- c.v($c.Add(_, _), n). out(n) :- d.v($d.Num(n), _).\n",
        &[("out", "1\n2\n3\n")],
    ),
    // Records whose type nothing names, since they only stand for their fields.
    (
        ".decl a(x: number, y: number)\n.decl r(z: number)\n.decl s(x: number, y: number)\na(1, 2). a(2, 2). a(3, 2).\n\
         r(z) :- a(x, y), r = [x, y], s = r, s = [v, w], w = z, z = v.\n\
         s(v, w) :- a(x, y), [x, [y, _]] = [v, [w, x]]. s(v, 7) :- a(x, y), r = [_, y], r = [x, _], [v, 2] = r.\n",
        &[("r", "2\n"), ("s", "1\t2\n1\t7\n2\t2\n2\t7\n3\t2\n3\t7\n")],
    ),
    // Their fields imply their shape where they do not equal others.
    (
        ".type L = [h: number, t: L]\n.decl a(x: number, s: symbol, l: L)\n.decl same, cast(x: number)\n.decl k(n: number)\n\
         a(1, \"a\", nil). a(2, \"a\", [1, nil]). a(2, \"b\", nil).\n\
         same(x) :- a(x, s, l), a(2, t, _), ord([x, [s, l]]) = ord([2, [t, [1, nil]]]).\n\
         k(n) :- n = count : { a(x, s, _), r = [x, s], ord(r) = ord([2, \"b\"]) }.\n\
         cast(x) :- a(x, _, l), as([1, nil], L) = l.\n",
        &[("same", "2\n"), ("k", "1\n"), ("cast", "2\n")],
    ),
    // Records without fields, and of unsigned numbers.
    (
        ".type Unit = []\n.type U = [n: unsigned, u: Unit]\n.decl u(u: U)\n.decl v(n: unsigned)\nu([4000000000, []]). u([1, nil]).\nv(n) :- u([n, []]).\n",
        &[("v", "4000000000\n")],
    ),
];

#[test]
fn branches_have_names_of_their_own() {
    for text in [
        // A type of an instance may have the name of a branch outside of it.
        ".type Shape = Circle {r: number}\n.comp C { .type Circle = number\n.decl s(s: Shape)\ns($Circle(3)). }\n.init c = C\n",
        // And a branch the name of a parameter.
        ".comp C<T> { .type S = T {r: number}\n.decl s(s: S)\ns($T(3)). }\n.init c = C<number>\n",
        // The instances around one have branches, too.
        ".comp C { .type S = A {r: number}\n.comp D { .type A = number\n.decl s(s: S)\ns($A(3)). }\n.init d = D\n}\n.init c = C\n",
    ] {
        assert_eq!(messages(text), [], "{text}");
        let mut session = program(text).session();
        session.commit().expect("small");
        compare(&session, &[], text);
        assert!(rows(&session).iter().any(|(_, rows)| rows.contains("(3)")), "{text}");
    }
}

#[test]
fn programs_derive_what_the_naive_evaluator_derives() {
    for (text, wanted) in PROGRAMS {
        let mut session = program(text).session();
        session.commit().expect("small");
        for (name, rows) in *wanted {
            assert_eq!(
                facts::print(&session, predicate(&session, name)),
                *rows,
                "{name}\n{text}"
            );
        }
        compare(&session, &[], text);
        // The printed and the formatted program are the same one.
        let mut sources = Sources::new();
        let id = sources.add("a.dl", *text);
        let tree = parse(&sources, id).file;
        for printed in [print(&tree), format(&sources, id).expect("parses")] {
            let mut again = program(&printed).session();
            again.commit().expect("small");
            assert_eq!(rows(&again), rows(&session), "{printed}");
        }
    }
}

const LISTS: &str = ".type List = [head: symbol, tail: List]\n.decl given(l: List, n: number)\n.input given\n.decl part(l: List)\n\
    .decl member(x: symbol, l: List)\n.decl pair(l: List)\n.decl long(n: number)\n\
    part(l) :- given(l, _). part(t) :- part([_, t]).\nmember(x, l) :- part(l), l = [x, _]. member(x, l) :- part(l), l = [_, t], member(x, t).\n\
    pair([x, [y, nil]]) :- member(x, _), member(y, _), !part([x, [y, nil]]), x < y.\nlong(n) :- n = count : { part([_, [_, _]]) }.\n";

#[test]
fn increments_equal_fresh_evaluation() {
    const ROWS: &[(&str, i32)] = &[
        ("nil", 0),
        ("[a, nil]", 1),
        ("[b, [a, nil]]", 2),
        ("[\"a b\", [\",\", [\"\", nil]]]", 3),
        ("[c, [b, [a, nil]]]", 4),
        ("[a, [a, [a, nil]]]", 5),
    ];
    let program = program(LISTS);
    let mut session = program.session();
    let mut held = BTreeSet::new();
    let mut state = 12_345_u32;
    for step in 0..60 {
        for _ in 0..3 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let at = (state >> 16) as usize % ROWS.len();
            let (text, n) = ROWS[at];
            if held.remove(&at) {
                session.retract("given", (text, n)).expect("a row");
            } else {
                held.insert(at);
                session.insert("given", (text, n)).expect("a row");
            }
        }
        session.commit().expect("small");
        let mut fresh = program.session();
        for &at in &held {
            fresh.insert("given", ROWS[at]).expect("a row");
        }
        fresh.commit().expect("small");
        assert_eq!(rows(&session), rows(&fresh), "step {step}");
        let id = predicate(&session, "given");
        let given: Vec<_> = session.encoded_rows(id).map(|row| (id, row.to_vec())).collect();
        compare(&session, &given, LISTS);
        for (at, row) in ROWS.iter().enumerate() {
            assert_eq!(session.contains("given", *row), held.contains(&at), "step {step}");
        }
    }
}

#[test]
fn rows_of_rust_are_texts() {
    let mut session = program(LISTS).session();
    session.insert("given", ("[x, [y, nil]]", 1)).expect("a row");
    for wrong in ["", "[x]", "[x, y]", "[x, nil", "[x, nil] y", "nil, nil", "[\"x, nil]"] {
        let error = session.insert("given", (wrong, 1)).expect_err("no list");
        assert!(error.to_string().contains("the text of a record"), "{error}");
    }
    session.commit().expect("small");
    let found: Vec<(String,)> = session.rows("part").expect("read").collect();
    assert_eq!(found.len(), 3);
    assert!(found.contains(&("[x, [y, nil]]".to_owned(),)));
}

#[test]
fn files_have_what_results_have() {
    let text = "nil\t0\n[a, nil]\t1\n [ \"q\"\"r, s\" , [ b c , nil ] ] \t2\n";
    let mut session = program(LISTS).session();
    let mut sources = Sources::new();
    let source = sources.add("given.facts", text);
    let id = predicate(&session, "given");
    assert_eq!(facts::load(&mut session, id, &sources, source).expect("rows"), 3);
    session.commit().expect("small");
    let printed = facts::print(&session, id);
    assert_eq!(printed, "nil\t0\n[a, nil]\t1\n[\"q\"\"r, s\", [b c, nil]]\t2\n");
    // With a comma between values, the brackets of a record keep its fields together.
    let format = logicity_datalog::RowFormat {
        delimiter: ",".to_owned(),
        ..logicity_datalog::RowFormat::default()
    };
    let mut out = Vec::new();
    facts::write_rows(&session, id, &format, &mut out).expect("memory");
    let written = String::from_utf8(out).expect("text");
    let source = sources.add("given.csv", written.clone());
    let mut again = program(LISTS).session();
    assert_eq!(
        facts::load_as(&mut again, id, &sources, source, &format).expect(&written),
        3
    );
    again.commit().expect("small");
    assert_eq!(rows(&again), rows(&session));
    let mut again = program(LISTS).session();
    let source = sources.add("again.facts", printed.clone());
    facts::load(&mut again, id, &sources, source).expect("rows");
    again.commit().expect("small");
    assert_eq!(rows(&again), rows(&session));

    for (text, place, message) in [
        ("[a, b]\t1\n", 4, "expected `[` or `nil`"),
        ("[a nil]\t1\n", 6, "expected `,` and a further field"),
        ("[a, nil\t1\n", 7, "expected `]`"),
        ("[a, nil]]\t1\n", 8, "expected the end of the value"),
        ("[\"a, nil]\t1\n", 2, "expected a text that ends with a double quote"),
    ] {
        let source = sources.add("wrong.facts", text);
        let faults = facts::load(&mut session, id, &sources, source).expect_err("no row");
        assert_eq!(faults[0].message, message, "{text}");
        let label = faults[0].primary.as_ref().expect("a place");
        assert_eq!(label.span.start, place, "{text}");
    }
}

#[test]
fn files_have_branches() {
    let text = "$Circle(1)\n$Dot\n $Dot ( ) \n$Pair([1, [2, nil]], a b)\n";
    let mut session = program(
        ".type L = [n: number, l: L]\n.type K = Circle {r: number} | Dot {} | Pair {l: L, s: symbol}\n.decl k(k: K)\n.input k\n",
    )
    .session();
    let mut sources = Sources::new();
    let source = sources.add("k.facts", text);
    let id = predicate(&session, "k");
    assert_eq!(facts::load(&mut session, id, &sources, source).expect("rows"), 4);
    session.commit().expect("small");
    assert_eq!(
        facts::print(&session, id),
        "$Circle(1)\n$Dot\n$Pair([1, [2, nil]], a b)\n"
    );
    for (text, message) in [
        ("$Square(1)\n", "expected `$Circle` or `$Dot` or `$Pair`"),
        ("nil\n", "expected `$Circle` or `$Dot` or `$Pair`"),
        ("$Circle\n", "expected `(` and the fields"),
        ("$Circle(1\n", "expected `)`"),
    ] {
        let source = sources.add("wrong.facts", text);
        let faults = facts::load(&mut session, id, &sources, source).expect_err("no row");
        assert_eq!(faults[0].message, message, "{text}");
    }
}

#[test]
fn deep_records_need_no_deep_stack() {
    let mut text = "nil".to_owned();
    for _ in 0..50_000 {
        text.insert_str(0, "[x, ");
        text.push(']');
    }
    let mut session = program(
        ".type List = [head: symbol, tail: List]\n.decl given(l: List, n: number)\n.input given\n.decl out(l: List)\nout(t) :- given([_, t], _).\n",
    )
    .session();
    session.insert("given", (text.as_str(), 1)).expect("a row");
    session.insert("given", (&text[4..text.len() - 1], 2)).expect("a row");
    session.commit().expect("small");
    let printed = facts::print(&session, predicate(&session, "given"));
    assert_eq!(printed.len(), 2 * text.len() - 5 + "\t1\n\t2\n".len());
}

#[test]
fn recursion_without_end_is_stopped() {
    let text = ".type List = [head: number, tail: List]\n.decl l(l: List)\nl(nil). l([1, t]) :- l(t).\n";
    let limits = Limits {
        rows: 10_000,
        ..Limits::default()
    };
    let mut session = program(text).session();
    session.set_limits(limits);
    let error = session.commit().expect_err("no end");
    let fault = error.diagnostic(session.program().rules());
    assert!(
        fault.help[0].contains("where a column `n` counts the steps"),
        "{fault:?}"
    );
    // A value of 2^60 numbers is small in the session, and cut off in texts.
    let text = ".type T = [l: T, r: T]\n.decl t(t: T, n: number)\nt(nil, 0). t([t, t], n + 1) :- t(t, n), n < 60.\n";
    let mut session = program(text).session();
    session.commit().expect("small");
    let id = predicate(&session, "t");
    assert_eq!(session.len(id), 61);
    let error = facts::write_rows(
        &session,
        id,
        &logicity_datalog::RowFormat::default(),
        &mut std::io::sink(),
    );
    assert!(error.expect_err("long").to_string().contains("MiB of text"));
}

#[test]
fn explanations_show_records() {
    let mut session = program(
        ".type Pair = [x: number, y: symbol]\n.decl p(r: Pair)\n.decl q(y: symbol)\np([1, \"a\"]). q(y) :- p([1, y]).\n",
    )
    .session();
    session.commit().expect("small");
    let id = predicate(&session, "q");
    let row: Vec<Value> = session.encoded_rows(id).next().expect("a row").to_vec();
    let proof = session.explain(id, &row).expect("few steps").expect("holds");
    let (sources, rules) = (Sources::new(), session.program().rules());
    let printer = ExplanationPrinter::new(rules, session.symbols(), &sources);
    let Node::Fact(fact) = &proof.nodes()[0] else {
        panic!("no fact")
    };
    let Origin::Derived(derivation) = &fact.origin else {
        panic!("not derived")
    };
    let clause = &rules.clauses[derivation.clause.index()];
    let shown: Vec<String> = (clause.body.iter())
        .map(|literal| printer.literal(clause, literal, &derivation.binding))
        .collect();
    let wanted = ["p([1, \"a\"])", "[1, \"a\"] = [1, _]", "[1, \"a\"] = [_, a]"];
    for wanted in wanted {
        assert!(shown.iter().any(|literal| literal == wanted), "{shown:?}");
    }
}

const TYPES: &str = ".type Pair = [x: number, y: symbol]\n.decl p(r: Pair)\n.decl n(x: number)\n.decl s(y: symbol)\n\
    .type Kind = Circle {r: number} | Dot {}\n.decl k(k: Kind)\n";

#[test]
fn faults_say_what_is_wrong() {
    for (clause, code, message) in [
        (
            "p([1]).",
            "arity-mismatch",
            "a record of type `Pair` has 2 fields, not 1",
        ),
        (
            "p([1, 2]).",
            "type-mismatch",
            "the field `y` has type `symbol`, not `number`",
        ),
        (
            "p([nil, \"a\"]).",
            "type-mismatch",
            "the field `x` has type `number`, not `record`",
        ),
        (
            "p(1).",
            "type-mismatch",
            "expected a value of type `Pair`, found a number",
        ),
        (
            "n(nil).",
            "type-mismatch",
            "expected a value of type `number`, found `nil`",
        ),
        (
            "n([1, \"a\"]).",
            "type-mismatch",
            "expected a value of type `number`, found `[1, \"a\"]` of type `record`",
        ),
        (
            "n(x) :- p([x, y]), n(y).",
            "type-mismatch",
            "`y` cannot be both `number` and `symbol`",
        ),
        (
            "n(x) :- p([x, _]), x = \"a\".",
            "type-mismatch",
            "a `number` cannot be compared with a `symbol`",
        ),
        ("n(x) :- p(r), r < [1, \"a\"], r = [x, _].", "type-mismatch", ""),
        ("n(x) :- [x, 1] = [y].", "type-mismatch", "a record of unknown type"),
        ("p([x, \"a\"]) :- n(_).", "unbound-variable", ""),
        ("p([1, _]).", "unbound-variable", ""),
        ("n(1) :- !p([1, _]).", "unbound-variable", ""),
        ("k($Circl(1)).", "unknown-type", "no type has a branch `Circl`"),
        ("k($Circle(1, 2)).", "arity-mismatch", "`$Circle` has 1 field, not 2"),
        ("k($Circle).", "arity-mismatch", "`$Circle` has 1 field, not 0"),
        (
            "k($Circle(\"a\")).",
            "type-mismatch",
            "the field `r` has type `number`, not `symbol`",
        ),
        (
            "k(nil).",
            "type-mismatch",
            "`nil` is no value of `Kind`, which has branches",
        ),
        (
            "n(1) :- k(s), s = nil.",
            "type-mismatch",
            "`nil` is no value of `Kind`, which has branches",
        ),
        (
            "k([1]).",
            "type-mismatch",
            "a record without a branch, but `Kind` has branches",
        ),
        (
            "p($Circle(1)).",
            "type-mismatch",
            "expected a value of type `Pair`, found `$Circle(1)` of type `Kind`",
        ),
        ("n(1) :- p($Circle(1)).", "type-mismatch", ""),
        (
            ".type A = Circle {}",
            "duplicate-declaration",
            "two branches are called `Circle`",
        ),
        (".type A = B {x: number} | C", "syntax", ""),
        ("n(strlen(r)) :- p(r).", "type-mismatch", ""),
        (
            ".type A = [x: number, x: number]",
            "duplicate-declaration",
            "two fields are called `x`",
        ),
        (
            ".type A = [x: Nothing]",
            "unknown-type",
            "no type `Nothing` is declared",
        ),
        (".type A = [x number]", "syntax", ""),
        ("p([1, \"a\").", "syntax", ""),
    ] {
        has_fault(&format!("{TYPES}{clause}\n"), code, message);
    }
}

#[test]
fn faulty_types_are_reported_once() {
    for text in [
        ".type A = B {x: nothing}\n.decl p(a: A)\np($B(1)). p(x) :- p(x), x = $B(_).\n",
        ".decl p(a: nothing, b: number)\n.decl q, w(x: number)\np([x, 1], x) :- q(x). w(x) :- !p([x, nil], x), q(x).\nq(1).\n",
        ".type A = [x: nothing]\n.decl p(a: A)\np([1]).\n",
        // The types that contain one, in any order.
        ".type A = [b: B, c: symbol]\n.type S <: B\n.type B = [x: nothing, y: A]\n.decl p(a: A, b: S)\n.decl q(s: S)\n.input q\np([[1, r], \"a\"], r) :- q(r).\n",
        // What such a record contains.
        ".decl p(a: nothing)\n.input p\n.decl q(n: number)\nq(1). q(n) :- p(r), r = [n, [m, s]], q(m), s = [n].\n",
    ] {
        let found = messages(text);
        let errors: Vec<_> = found.iter().filter(|(code, _)| *code != "ignored").collect();
        assert!(matches!(errors[..], [("unknown-type", _)]), "{text}: {found:?}");
    }
    let found = messages(&format!("{TYPES}p(r) :- p(r), s(r).\n"));
    assert!(!found.is_empty());
    let (_, loaded) = load(&format!("{TYPES}s(\"a\"). s(r) :- p(r).\n"));
    let helps = loaded.diagnostics.iter().flat_map(|fault| &fault.help);
    assert!(
        helps.into_iter().all(|help| !help.contains("to_")),
        "{:?}",
        loaded.diagnostics
    );
}

#[test]
fn records_have_ordinal_numbers() {
    let text = ".type P = [a: number]\n.decl p(p: P)\np([1]). p([2]). p(nil).\n.decl same(p: P)\nsame(p) :- p(p), p(q), ord(p) = ord(q), p = [_].\n";
    let mut session = program(text).session();
    session.commit().expect("small");
    assert_eq!(facts::print(&session, predicate(&session, "same")), "[1]\n[2]\n");
}

/// The engine looks up records whose fields are bound, and compares equal records by word: a join reads about as many
/// rows as it finds.
#[test]
fn joins_by_fields_use_indexes() {
    let texts = [
        ".decl q(a: number, b: number)\nq(0, 0).\nq(c, d) :- q(a, b), p([a, b], [c, d]).\n",
        ".decl s(r: P, s: P)\ns([a, b], r) :- p([a, b], r), p([c, d], [a, b]), c < a, d < 9.\n",
        ".decl t(r: P)\nt([a, b]) :- p([a, b], [c, d]), p([c, d], [e, f]), e != f.\n",
        ".type N = [p: P, n: number]\n.decl n(n: N)\nn([r, 7]) :- p(r, _).\n\
         .decl m(a: number, b: number)\nm(0, 0).\nm(a + 1, (b + 1) % 7) :- m(a, b), n([[a, b], 7]).\n",
    ];
    let texts = texts.into_iter().chain([
        // A record of the head, or of a negated atom, is the first of its kind.
        ".decl c(x: number, y: number)\nc(a, a % 7) :- i(a).\n.decl h(r: P)\nh([x, y]) :- c(x, y), p([x, y], _).\n",
        ".decl c(x: number, y: number)\nc(a, a % 7) :- i(a).\n.decl d(r: P)\nd([1, 2]).\n\
         .decl h(x: number)\nh(x) :- !d([x, y]), c(x, y), p([x, y], _).\n",
    ]);
    for (text, last) in texts.flat_map(|text| [(text, 40), (text, 3_000)]) {
        let text = format!(
            ".type P = [a: number, b: number]\n.decl p(r: P, s: P)\n.decl i(a: number)\n\
             i(0).\ni(a + 1) :- i(a), a < {last}.\np([a, a % 7], [a + 1, (a + 1) % 7]) :- i(a).\n{text}"
        );
        let mut session = program(&text).session();
        session.set_limits(Limits {
            steps: 100_000,
            ..Limits::default()
        });
        session.commit().unwrap_or_else(|error| panic!("{error}\n{text}"));
        let predicates = &session.program().rules().predicates;
        let derived = predicates.iter().rposition(|predicate| !predicate.hidden).expect("one");
        let derived = PredicateId(u32::try_from(derived).expect("few"));
        assert!(session.encoded_rows(derived).count() > last / 4, "{text}");
        if last < 100 {
            compare(&session, &[], &text);
        }
    }
}

/// A symbol that only looks like a record has no fields, whatever the order of the join.
#[test]
fn symbols_that_look_like_records_have_no_fields() {
    for (size, body) in [
        (1, "c(x, y), b([x, y])"),
        (1_000, "b([x, y]), c(x, y)"),
        (3, "b(r), b0(r), r = [x, y]"),
    ] {
        let text = format!(
            ".type P = [a: number, b: number]\n.decl i(i: number)\ni(0).\ni(i + 1) :- i(i), i < {size}.\n\
             .decl b0, b(r: P)\nb0([i, i]) :- i(i).\nb(as(cat(as(r, symbol), \"x\"), P)) :- b0(r).\n\
             .decl c, h(x: number, y: number)\nc(1, 1).\nh(x, y) :- {body}.\n"
        );
        let mut session = program(&text).session();
        session.commit().expect("small");
        assert_eq!(facts::print(&session, predicate(&session, "h")), "", "{text}");
        assert_eq!(session.len(predicate(&session, "b")), size + 1);
    }
}

/// Returns a program of strata. A stratum makes records of the values of earlier ones, and takes apart those of any, so
/// that it ends.
fn random_program(random: &mut Random) -> String {
    let mut text = ".type L = [h: number, t: L]\n.decl g(l: L)\n.decl n(x: number)\n.input g, n\n".to_owned();
    let patterns = [
        "r",
        "[x, r]",
        "[x, [y, r]]",
        "[1, r]",
        "[_, [x, r]]",
        "[x, [x, r]]",
        "[x, nil]",
    ];
    for stratum in 0..3 {
        text += &format!(".decl p{stratum}(l: L)\n.decl q{stratum}(x: number, l: L)\n");
        let before = |random: &mut Random| match stratum {
            0 => "g".to_owned(),
            _ => format!("p{}", random.below(stratum)),
        };
        let pairs = |random: &mut Random| match stratum {
            0 => "n(x), g(r)".to_owned(),
            _ => format!("q{}(x, r)", random.below(stratum)),
        };
        for _ in 0..2 + random.below(4) {
            let (source, more) = (before(random), pairs(random));
            let pattern = random.of(&patterns);
            let other = before(random);
            text += &match random.below(12) {
                0 => format!(
                    "p{stratum}(r) :- p{stratum}({}).\n",
                    random.of(&["[x, r]", "[_, [_, r]]", "[2, r]"])
                ),
                1 => format!("p{stratum}([x, r]) :- {more}.\n"),
                2 => format!("q{stratum}(x, r) :- {source}(l), l = [x, r].\n"),
                3 => format!("q{stratum}(x, r) :- {more}, !{source}([x, r]).\n"),
                4 => format!("p{stratum}(r) :- {source}(l), {more}, l = [x, [_, r]].\n"),
                5 => format!("p{stratum}(r) :- {source}({pattern}), {more}, r != [x, nil].\n"),
                6 => format!("q{stratum}(c, r) :- {source}(r), c = count : {{ {source}([_, r]) }}.\n"),
                // The same record twice, and records of fields that other atoms bind.
                8 => format!("q{stratum}(x, r) :- {source}([x, r]), {other}([x, [x, r]]), n(x).\n"),
                9 => format!("p{stratum}([x, r]) :- {more}, {source}([x, r]), {other}({pattern}), !{other}([x, r]).\n"),
                10 => format!("q{stratum}(x, s) :- {more}, p{stratum}([x, [x, r]]), {source}(s), s = [_, r].\n"),
                7 => format!("q{stratum}(x + 1, s) :- {more}, s = [x, t], r = [_, t].\n"),
                _ => format!("p{stratum}(s) :- {more}, ({source}([x, s]); s = [x, r]; s = nil, x = 1).\n"),
            };
        }
    }
    text
}

/// Returns a text about lists with branches instead of records and `nil`.
fn with_branches(text: &str) -> String {
    let ty = ".type L = Cons {h: number, t: L} | Nil {} | Other {h: number, t: L}";
    text.replace('[', "$Cons(")
        .replace(']', ")")
        .replace("nil", "$Nil")
        .replace(".type L = $Cons(h: number, t: L)", ty)
}

#[test]
fn random_programs_derive_what_the_naive_evaluator_derives() {
    const LISTS: &[&str] = &[
        "nil",
        "[1, nil]",
        "[2, [1, nil]]",
        "[1, [1, nil]]",
        "[2, nil]",
        "[1, [2, [1, nil]]]",
    ];
    for seed in 0..u64::from(cases(240).cases) {
        let mut random = Random(seed);
        let has_branches = seed % 2 == 1;
        let spelled = |text: &str| match has_branches {
            true => with_branches(text),
            false => text.to_owned(),
        };
        let text = spelled(&random_program(&mut random));
        let lists: Vec<String> = LISTS.iter().map(|list| spelled(list)).collect();
        let program = program(&text);
        let mut session = program.session();
        let mut held: BTreeSet<(bool, usize)> = BTreeSet::new();
        for _ in 0..5 {
            for _ in 0..4 {
                let at = usize::try_from(random.below(LISTS.len() as u64)).expect("few");
                let change = (random.below(2) == 0, at);
                let gone = held.remove(&change) || !held.insert(change);
                let (is_list, at) = change;
                let result = match (is_list, gone) {
                    (true, true) => session.retract("g", (&lists[at],)),
                    (true, false) => session.insert("g", (&lists[at],)),
                    (false, true) => session.retract("n", (at % 3,)),
                    (false, false) => session.insert("n", (at % 3,)),
                };
                result.expect("a row");
                if !is_list {
                    // Several positions stand for one number.
                    held.retain(|(is_list, other)| *is_list || other % 3 != at % 3 || !gone);
                }
            }
            session.commit().expect("small");
            let mut fresh = program.session();
            let mut given = Vec::new();
            for name in ["g", "n"] {
                let id = predicate(&session, name);
                let rows: Vec<Vec<Value>> = session.encoded_rows(id).map(<[Value]>::to_vec).collect();
                for line in facts::print(&session, id).lines() {
                    match name {
                        "g" => fresh.insert("g", (line,)),
                        _ => fresh.insert("n", (line.parse::<i32>().expect("a number"),)),
                    }
                    .expect("a row");
                }
                given.extend(rows.into_iter().map(|row| (id, row)));
            }
            fresh.commit().expect("small");
            assert_eq!(rows(&session), rows(&fresh), "seed {seed}\n{text}");
            compare(&session, &given, &text);
        }
    }
}
