//! User-defined functors: every program derives what the naive evaluator derives, at once and by increments.

use crate::component::{has_fault, load};
use logicity_datalog::cancel::Cancel;
use logicity_datalog::diag::{Diagnostic, Sources, render};
use logicity_datalog::explain::ExplanationPrinter;
use logicity_datalog::{
    EvalError, FunctorError, InputPolicy, PredicateId, Program, Session, Strategy, Value, Workspace, facts, format,
    naive, parse, print,
};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

fn program(text: &str) -> Program {
    let (sources, loaded) = load(text);
    let shown = render(&loaded.diagnostics, &sources, false);
    Program::new(loaded.rules.unwrap_or_else(|| panic!("{text}\n{shown}"))).expect("small")
}

const FUNCTORS: &str = ".type List = [head: number, tail: List]\n.type Shape = Circle {r: number} | Dot {}\n\
    .functor twice(x: number): number\n.functor join(symbol, symbol): symbol stateful\n.functor half(x: number): number\n\
    .functor push(n: number, l: List): List stateful\n.functor area(s: Shape): float\n.functor seven(): unsigned\n";

/// Returns the program with the functors of [`FUNCTORS`] before it, and their definitions.
fn defined(text: &str) -> Program {
    program(&format!("{FUNCTORS}{text}"))
        .define("twice", |(x,): (i32,)| Some(x.wrapping_mul(2)))
        .and_then(|program| program.define("join", |(a, b): (String, String)| Some(format!("{a}-{b}"))))
        .and_then(|program| program.define("half", |(x,): (i32,)| (x % 2 == 0).then_some(x / 2)))
        .and_then(|program| program.define("push", |(n, l): (i32, String)| Some(format!("[{n}, {l}]"))))
        .and_then(|program| {
            program.define("area", |(shape,): (String,)| {
                let radius = shape.strip_prefix("$Circle(")?.strip_suffix(')')?;
                radius.parse().ok().map(|radius: f32| radius * radius)
            })
        })
        .and_then(|program| program.define("seven", |(): ()| Some(7_u32)))
        .expect("declared")
}

fn predicate(session: &Session, name: &str) -> PredicateId {
    session.program().predicate(name).expect("declared")
}

/// Checks a session against the naive evaluator.
fn compare(session: &Session, text: &str) {
    let rules = session.program().rules();
    let symbols = session.symbols().clone();
    let ids = || (0..).map(PredicateId).zip(&rules.predicates);
    let given: Vec<(PredicateId, Vec<Value>)> = ids()
        .filter(|(_, predicate)| predicate.input)
        .flat_map(|(id, predicate)| {
            let rows = session
                .encoded_rows(id)
                .map(move |row| (predicate.edb.unwrap_or(id), row.to_vec()));
            rows.collect::<Vec<_>>()
        })
        .collect();
    let database = naive::evaluate(rules, &symbols, given);
    for (id, predicate) in ids().filter(|(_, predicate)| !predicate.hidden) {
        let found: BTreeSet<Vec<Value>> = session.encoded_rows(id).map(<[Value]>::to_vec).collect();
        assert_eq!(found, database[id.index()], "{}\n{text}", predicate.name);
    }
}

/// Programs with what some of their predicates hold.
const PROGRAMS: &[(&str, &[(&str, &str)])] = &[
    // In facts, heads, tests, comparisons, and within other expressions; a call without a value.
    (
        ".decl n(x: number)\n.decl a(x: number)\n.decl h(x: number, y: number)\n.decl s(s: symbol)\n.decl u(n: unsigned)\n\
         n(1). n(2). n(3). n(4). n(@twice(4)).\na(@twice(x)) :- n(x). a(x) :- n(x), @twice(x) + 1 > 6.\n\
         h(x, y) :- n(x), y = @half(x). h(0, x) :- n(x), !a(x), x = @half(@twice(x)).\n\
         s(@join(\"a\", @join(\"b\", \"c\"))). s(@join(to_string(x), \"x\")) :- n(x), x < 3.\nu(@seven()). u(@seven() + 1u) :- n(1).\n",
        &[
            ("a", "2\n3\n4\n6\n8\n16\n"),
            ("h", "0\t1\n2\t1\n4\t2\n8\t4\n"),
            ("s", "1-x\n2-x\na-b-c\n"),
            ("u", "7\n8\n"),
        ],
    ),
    // Recursion, to a fixpoint and within a bound.
    (
        ".decl n(x: number)\n.decl down(x: number, y: number)\n.decl root(x: number, y: number)\n\
         n(40). n(6). n(7).\nn(@twice(x)) :- n(x), x < 50.\ndown(x, x) :- n(x). down(x, @half(y)) :- down(x, y).\n\
         root(x, y) :- down(x, y), y % 2 = 1.\n",
        &[(
            "root",
            "6\t3\n7\t7\n12\t3\n14\t7\n24\t3\n28\t7\n40\t5\n48\t3\n56\t7\n80\t5\n96\t3\n",
        )],
    ),
    // In aggregates, also correlated ones, and where one row is enough.
    (
        ".decl n(x: number)\n.decl m(x: number, y: number)\n.decl c(x: number, c: number)\n.decl sum(s: number)\n.decl any(x: number)\n.decl flag()\n\
         n(1). n(2). n(3). n(4).\nm(x, y) :- n(x), n(y), x <= y.\nc(x, k) :- n(x), k = count : { m(x, y), @half(y) > 0 }.\n\
         sum(s) :- s = sum @twice(x) : { n(x) }. sum(s) :- s = sum y : { n(x), y = @half(x) }.\n\
         any(x) :- n(x), m(x, y), @half(y) = _z, n(_z). any(9) :- n(x), z = max @twice(y) : { m(x, y) }, z = @twice(4).\n\
         flag() :- n(x), @half(x) = 2.\n",
        &[
            ("c", "1\t2\n2\t2\n3\t1\n4\t1\n"),
            ("sum", "3\n20\n"),
            ("any", "1\n2\n3\n4\n9\n"),
            ("flag", "()\n"),
        ],
    ),
    // Records as arguments and values.
    (
        ".decl l(l: List)\n.decl head(x: number)\n.decl area(s: Shape, a: float)\nl(nil). l(@push(1, t)) :- l(t), t = nil.\n\
         head(1). head(2). l(@push(5, [6, nil])).\n.decl first(x: number)\nfirst(x) :- l([x, _]).\n\
         .decl shape(s: Shape)\nshape($Circle(3)). shape($Dot).\narea(s, a) :- shape(s), a = @area(s). area($Circle(x), @area($Circle(x))) :- head(x).\n",
        &[("area", "$Circle(1)\t1\n$Circle(2)\t4\n$Circle(3)\t9\n")],
    ),
    // In components, inline predicates and alternatives.
    (
        ".comp C { .decl v(x: number)\nv(@twice(1)). v(@twice(x)) :- v(x), x < 10. }\n.init c = C\n.decl o(x: number)\n\
         .decl big(x: number) inline\nbig(x) :- @twice(x) > 8.\no(x) :- c.v(x), (x = @twice(2); big(x)).\n",
        &[("o", "4\n8\n16\n")],
    ),
];

#[test]
fn programs_derive_what_the_naive_evaluator_derives() {
    for (text, wanted) in PROGRAMS {
        let mut session = defined(text).session();
        session.commit().unwrap_or_else(|error| panic!("{error}\n{text}"));
        for (name, rows) in *wanted {
            assert_eq!(
                facts::print(&session, predicate(&session, name)),
                *rows,
                "{name}\n{text}"
            );
        }
        compare(&session, text);
        let mut sources = Sources::new();
        let id = sources.add("a.dl", format!("{FUNCTORS}{text}"));
        let tree = parse(&sources, id).file;
        for printed in [print(&tree), format(&sources, id).expect("parses")] {
            assert!(
                printed.contains(".functor join(symbol, symbol): symbol stateful\n"),
                "{printed}"
            );
            let again = program(&printed);
            assert_eq!(
                again.rules().clauses.len(),
                session.program().rules().clauses.len(),
                "{printed}"
            );
        }
    }
}

#[test]
fn increments_equal_fresh_evaluation() {
    let text = ".decl e(x: number, y: number)\n.input e\n.decl p(x: number, y: number)\n.decl s(x: symbol)\n.decl c(n: number)\n\
        p(x, @twice(y)) :- e(x, y). p(x, @half(z)) :- p(x, y), e(y, z). p(@half(x), y) :- p(x, y).\n\
        s(@join(to_string(x), to_string(y))) :- p(x, y), !e(x, y).\nc(n) :- n = count : { p(x, y), @half(x) < y }.\n";
    let program = defined(text);
    let mut state = 7_u32;
    let mut random = |end: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) % end
    };
    for strategy in [Strategy::Auto, Strategy::Maintain, Strategy::Recompute] {
        let mut session = program.session();
        session.set_strategy(strategy);
        for step in 0..40 {
            for _ in 0..4 {
                let row = (random(8), random(8));
                match random(2) {
                    0 => session.insert("e", row),
                    _ => session.retract("e", row),
                }
                .expect("a row");
            }
            session.commit().expect("small");
            compare(&session, text);
            let mut fresh = program.session();
            let rows: Vec<(i64, i64)> = session.rows("e").expect("read").collect();
            fresh.insert_all("e", rows).expect("rows");
            fresh.commit().expect("small");
            for name in ["p", "s", "c"] {
                let print = |session: &Session| facts::print(session, predicate(session, name));
                assert_eq!(print(&session), print(&fresh), "step {step}");
            }
        }
    }
}

#[test]
fn calls_come_in_batches() {
    let text = ".functor f(x: number): number\n.functor g(x: number, y: number): number\n.decl n(x: number)\n.input n\n\
        .decl a(x: number, y: number)\na(x, y) :- n(x), n(k), k < 2, y = @g(@f(x), k).\n";
    let (batches, calls) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let counted = (Arc::clone(&batches), Arc::clone(&calls));
    let program = program(text)
        .define_batch("f", move |batch, values| {
            counted.0.fetch_add(1, Ordering::Relaxed);
            counted.1.fetch_add(batch.len(), Ordering::Relaxed);
            values.extend((0..batch.len()).map(|call| Some(Value::number(batch.row(call)[0].as_number() + 1))));
            Ok(())
        })
        .and_then(|program| program.define("g", |(x, y): (i32, i32)| Some(10 * x + y)))
        .expect("declared");
    let mut session = program.session();
    session.insert_all("n", (0..10_000).map(|n| (n,))).expect("rows");
    session.commit().expect("small");
    assert_eq!(session.len(predicate(&session, "a")), 20_000);
    assert!(session.contains("a", (9_999, 100_001)) && session.contains("a", (0, 10)));
    let (batches, calls) = (batches.load(Ordering::Relaxed), calls.load(Ordering::Relaxed));
    assert!(
        (10_000..=20_000).contains(&calls) && batches <= calls / 4096 + 1,
        "{batches} batches, {calls} calls"
    );
}

#[test]
fn queries_and_explanations_apply_functors() {
    let text = format!(
        "{FUNCTORS}.decl e(x: number, y: number)\ne(1, 2). e(2, 4). e(5, 4).\n.decl p(x: number)\np(y) :- e(x, y), y = @twice(x).\n"
    );
    let mut sources = Sources::new();
    let mut workspace = Workspace::new(InputPolicy::Fixed);
    let entry = sources.add("a.dl", text.as_str());
    workspace.add(&mut sources, entry, &|_: &std::path::Path| unreachable!());
    let checked = Program::new(workspace.check().rules.expect("valid")).expect("small");
    let program = checked.define("twice", |(x,): (i32,)| Some(2 * x)).expect("declared");
    let mut session = program.session();
    session.commit().expect("small");
    let question = sources.add("<query>", "e(x, y), y != @twice(x)");
    let query = workspace
        .ask(&sources, question, session.symbols().clone())
        .rules
        .expect("valid");
    let mut answer = session
        .query(&Program::new(query).expect("small"), &Cancel::never())
        .expect("small");
    answer.commit().expect("small");
    assert_eq!(facts::print(&answer, predicate(&answer, Workspace::ANSWER)), "5\t4\n");

    let id = predicate(&session, "p");
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let proof = session.explain(id, &[Value::number(4)]).expect("small").expect("holds");
    assert!(
        printer.tree(&proof).contains("4 = @twice(2)"),
        "{}",
        printer.tree(&proof)
    );
    let missing = session
        .explain_absence(id, &[Some(Value::number(5))])
        .expect("small")
        .expect("fails");
    assert!(printer.tree(&missing).contains("@twice"), "{}", printer.tree(&missing));
    assert!(
        program.show_plans(&sources).contains("@twice("),
        "{}",
        program.show_plans(&sources)
    );
}

#[test]
fn missing_and_failing_definitions_are_errors() {
    let text = ".functor f(x: number): number\n.functor unused(x: number): number\n.decl n(x: number)\n.input n\n.decl a(x: number)\na(@f(x)) :- n(x).\n";
    let mut session = program(text).session();
    let error = session.commit().expect_err("undefined");
    assert!(
        matches!(&error, EvalError::UndefinedFunctor { functor, .. } if functor == "f"),
        "{error}"
    );
    let fault = error.diagnostic(session.program().rules());
    assert_eq!(fault.code.name(), "failed-functor");
    assert!(
        fault
            .help
            .iter()
            .any(|help| help.contains("program.define(\"f\", ...)")),
        "{fault:?}"
    );

    let failing = program(text).define_batch("f", |batch, values| {
        for call in 0..batch.len() {
            match batch.row(call)[0].as_number() {
                13 => return Err("13 is unlucky".to_owned()),
                n => values.push(Some(Value::number(n))),
            }
        }
        Ok(())
    });
    let mut session = failing.expect("declared").session();
    session.insert("n", (1,)).expect("a row");
    session.commit().expect("small");
    session.insert("n", (13,)).expect("a row");
    let error = session.commit().expect_err("fails");
    assert_eq!(error.to_string(), "the functor `f` failed: 13 is unlucky");
    // The session is as before.
    assert!(session.contains("a", (1,)) && !session.contains("n", (13,)));
    session.rollback();
    session.commit().expect("small");

    let short = program(text).define_batch("f", |_, _| Ok(())).expect("declared");
    let mut session = short.session();
    session.insert("n", (1,)).expect("a row");
    assert_eq!(
        session.commit().expect_err("fails").to_string(),
        "the functor `f` failed: 0 values for 1 call"
    );
    let wrong = program(text)
        .define("f", |(x,): (i64,)| Some(x << 40))
        .expect("declared");
    let mut session = wrong.session();
    session.insert("n", (1,)).expect("a row");
    let said = session.commit().expect_err("fails").to_string();
    assert_eq!(
        said,
        "the functor `f` failed: 1099511627776 is no value of type `number`"
    );

    let error = program(text).define("g", |(x,): (i32,)| Some(x)).expect_err("unknown");
    assert!(matches!(error, FunctorError::Unknown { .. }), "{error}");
    let error = program(text)
        .define("f", |(x,): (String,)| Some(x))
        .expect_err("another type");
    assert!(matches!(error, FunctorError::Arguments { .. }), "{error}");
    let error = program(text)
        .define("f", |(x, _): (i32, i32)| Some(x))
        .expect_err("another arity");
    assert!(matches!(error, FunctorError::Arguments { .. }), "{error}");
}

#[test]
fn recursion_without_end_is_stopped() {
    let text = ".functor more(x: number): number\n.decl n(x: number)\nn(0). n(@more(x)) :- n(x).\n";
    let program = program(text)
        .define("more", |(x,): (i32,)| Some(x.wrapping_add(1)))
        .expect("declared");
    let mut session = program.session();
    session.set_limits(logicity_datalog::Limits {
        rows: 1_000,
        ..logicity_datalog::Limits::default()
    });
    let error = session.commit().expect_err("no end");
    let fault = error.diagnostic(program.rules());
    assert_eq!(fault.code.name(), "limit-exceeded");
    let longer = ".functor more(s: symbol): symbol\n.decl n(s: symbol)\nn(\"a\"). n(@more(s)) :- n(s).\n";
    let program = crate::functors::program(longer)
        .define("more", |(s,): (String,)| Some(s.repeat(2)))
        .expect("declared");
    let mut session = program.session();
    session.set_limits(logicity_datalog::Limits {
        bytes: 1 << 24,
        ..logicity_datalog::Limits::default()
    });
    assert!(matches!(session.commit(), Err(EvalError::TooMuchMemory { .. })));
}

#[test]
fn faults_say_what_is_wrong() {
    let declared = ".functor f(x: number, s: symbol): symbol\n.type P = [a: number, b: symbol]\n.functor p(p: P): number\n\
        .decl s(s: symbol)\n.decl n(n: number)\n.decl q(p: P)\n";
    for (clause, code, message) in [
        ("s(@g(1)).", "unknown-functor", "no functor `g` is declared"),
        ("s(@f(1)).", "arity-mismatch", "`@f` takes 2 arguments, not 1"),
        ("n(@f(1, \"a\")).", "type-mismatch", ""),
        ("s(@f(\"a\", 1)).", "type-mismatch", ""),
        (
            "s(@f(1, 1)).",
            "type-mismatch",
            "expected a value of type `symbol`, found `1`",
        ),
        ("s(@f(x, \"a\")).", "unbound-variable", ""),
        ("n(@p([\"a\", \"b\"])).", "type-mismatch", ""),
        ("n(@p(1)).", "type-mismatch", ""),
        ("s(x) :- @f(1, \"a\") = y, s(x).", "", ""),
        (
            ".functor f(x: number): number",
            "duplicate-declaration",
            "the functor `f` is declared twice",
        ),
        (".functor f(number, symbol): symbol", "", ""),
        (
            ".functor g(x: nothing): number",
            "unknown-type",
            "no type `nothing` is declared",
        ),
        (".functor g(x: number)", "syntax", ""),
        (".functor g", "syntax", ""),
        ("s(@f 1).", "syntax", ""),
        ("s(@f).", "syntax", ""),
    ] {
        let text = format!("{declared}{clause}\n");
        if code.is_empty() {
            let errors: Vec<_> = (load(&text).1.diagnostics.into_iter())
                .filter(Diagnostic::is_error)
                .collect();
            assert!(errors.is_empty(), "{clause}: {errors:?}");
        } else {
            has_fault(&text, code, message);
        }
    }
}
