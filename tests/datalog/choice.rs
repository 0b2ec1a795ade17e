//! Keys and limits of predicates: every program derives what the naive evaluator derives, at once and by increments.

use crate::cases::cases;
use crate::component::{has_fault, load};
use logicity_datalog::cancel::Cancel;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::explain::ExplanationPrinter;
use logicity_datalog::{
    BaseType, Inexact, MarginalOptions, Marginals, PredicateId, Program, Session, Strategy, Value, diff, facts, format,
    naive, parse, print, rewrite,
};
use std::collections::BTreeSet;

pub(crate) fn program(text: &str) -> Program {
    let (sources, loaded) = load(text);
    let shown = render(&loaded.diagnostics, &sources, false);
    Program::new(loaded.rules.unwrap_or_else(|| panic!("{text}\n{shown}"))).expect("small")
}

pub(crate) fn predicate(session: &Session, name: &str) -> PredicateId {
    session.program().predicate(name).expect("declared")
}

pub(crate) fn shown(session: &Session, name: &str) -> String {
    facts::print(session, predicate(session, name))
}

/// Checks a session against the naive evaluator.
pub(crate) fn compare(session: &Session, text: &str) {
    let rules = session.program().rules();
    let ids = || (0..).map(PredicateId).zip(&rules.predicates);
    let given = ids().filter_map(|(id, predicate)| Some((id, predicate.edb.or(predicate.input.then_some(id))?)));
    let given: Vec<(PredicateId, Vec<Value>)> = given
        .flat_map(|(_, stored)| {
            let rows = session.encoded_rows(stored).map(move |row| (stored, row.to_vec()));
            rows.collect::<Vec<_>>()
        })
        .collect();
    let database = naive::evaluate(rules, session.symbols(), given);
    for (id, predicate) in ids().filter(|(_, predicate)| !predicate.hidden) {
        let found: BTreeSet<Vec<Value>> = session.encoded_rows(id).map(<[Value]>::to_vec).collect();
        assert_eq!(found, database[id.index()], "{}\n{text}", predicate.name);
    }
}

/// Programs with what some of their predicates hold.
const PROGRAMS: &[(&str, &[(&str, &str)])] = &[
    // The least row of each key; keys of several columns, several keys, symbols by their text.
    (
        ".decl m(s: symbol, n: number)\nm(\"b\", 3). m(\"b\", -2). m(\"a\", 7). m(\"a\", 5). m(\"c\", 5).\n\
         .decl one(s: symbol, n: number) choice-domain s\none(s, n) :- m(s, n).\n\
         .decl both(s: symbol, n: number) choice-domain s, n\nboth(s, n) :- m(s, n).\n\
         .decl pair(s: symbol, n: number, k: number) choice-domain (s, n)\npair(s, n, k) :- m(s, n), m(_, k).\n\
         .decl any(s: symbol) choice-domain s\nany(s) :- m(s, _).\n",
        &[
            ("one", "a\t5\nb\t-2\nc\t5\n"),
            ("both", "a\t5\nb\t-2\n"),
            ("pair", "a\t5\t-2\na\t7\t-2\nb\t-2\t-2\nb\t3\t-2\nc\t5\t-2\n"),
            ("any", "a\nb\nc\n"),
        ],
    ),
    // Facts alone.
    (
        ".decl f(x: number, y: number) choice-domain x\nf(1, 2). f(1, 1). f(2, 2).\n.decl g(x: number)\ng(y) :- f(_, y).\n",
        &[("f", "1\t1\n2\t2\n"), ("g", "1\n2\n")],
    ),
    // In a recursion: a total order, and a spanning tree.
    (
        ".decl d(x: symbol)\nd(\"c\"). d(\"a\"). d(\"b\").\n.decl l(p: symbol, x: symbol) choice-domain p, x\nl(\"nil\", \"head\").\n\
         l(x, y) :- d(y), l(_, x).\n.decl e(x: number, y: number)\ne(1, 2). e(1, 3). e(2, 3). e(3, 2). e(2, 4). e(3, 4). e(4, 1).\n\
         .decl tree(x: number, y: number) choice-domain y\ntree(0, 1). tree(x, y) :- tree(_, x), e(x, y).\n",
        &[
            ("l", "a\tb\nb\tc\nhead\ta\nnil\thead\n"),
            ("tree", "0\t1\n1\t2\n1\t3\n2\t4\n"),
        ],
    ),
    // A limit ends a recursion; one that is reached before ends it before it begins.
    (
        ".decl n(x: number)\nn(0). n(x + 1) :- n(x).\n.limitsize n(n=4)\n.decl m(x: number)\nm(0). m(1). m(x + 2) :- m(x).\n.limitsize m(n=2)\n\
         .decl e(x: number, y: number)\ne(x, x + 1) :- n(x). e(3, 0).\n.decl p(x: number, y: number)\np(x, y) :- e(x, y). p(x, z) :- p(x, y), e(y, z).\n\
         .limitsize p(n=6)\n.decl q(x: number)\nq(x) :- n(x).\n.limitsize q(n=1)\n",
        &[
            ("n", "0\n1\n2\n3\n"),
            ("m", "0\n1\n"),
            ("p", "0\t1\n0\t2\n1\t2\n1\t3\n2\t0\n2\t3\n2\t4\n3\t0\n3\t1\n3\t4\n"),
            ("q", "0\n1\n2\n3\n"),
        ],
    ),
    // In a component, and read by a negation and an aggregate.
    (
        ".comp C { .decl v(x: number, y: number) choice-domain (x)\nv(x, y) :- n(x), n(y), x != y. }\n.init c = C\n.decl n(x: number)\nn(1). n(2). n(3).\n\
         .decl o(x: number, y: number)\no(x, y) :- n(x), n(y), !c.v(x, y). o(0, k) :- k = count : { c.v(_, _) }.\n",
        &[
            ("c.v", "1\t2\n2\t1\n3\t1\n"),
            ("o", "0\t3\n1\t1\n1\t3\n2\t2\n2\t3\n3\t2\n3\t3\n"),
        ],
    ),
];

#[test]
fn programs_derive_what_the_naive_evaluator_derives() {
    derive_alike(PROGRAMS);
}

/// Compares programs with the naive evaluator and with what some of their predicates hold, also printed and formatted.
pub fn derive_alike(programs: &[(&str, &[(&str, &str)])]) {
    for (text, wanted) in programs {
        let mut session = program(text).session();
        session.commit().unwrap_or_else(|error| panic!("{error}\n{text}"));
        for (name, rows) in *wanted {
            assert_eq!(shown(&session, name), *rows, "{name}\n{text}");
        }
        compare(&session, text);
        let mut sources = Sources::new();
        let id = sources.add("a.dl", *text);
        let tree = parse(&sources, id).file;
        for printed in [print(&tree), format(&sources, id).expect("parses")] {
            let mut again = program(&printed).session();
            again.commit().expect("small");
            for (name, rows) in *wanted {
                assert_eq!(shown(&again, name), *rows, "{name}\n{printed}");
            }
        }
    }
}

#[test]
fn the_formatter_keeps_the_keys_together() {
    let text = ".decl v( x :number,y: number )  choice - domain x,( x,y )\nv($+1,2*$):-v(x, - $),x!=$.\n\
                .type T = N { n : number }\n.decl t(t: T)\nt($N( 1-choice )) :- v(choice,$-1).\n";
    let mut sources = Sources::new();
    let id = sources.add("a.dl", text);
    assert_eq!(
        format(&sources, id).expect("parses"),
        ".decl v(x: number, y: number) choice-domain x, (x, y)\nv($ + 1, 2 * $) :- v(x, -$), x != $.\n\
         .type T = N { n: number }\n.decl t(t: T)\nt($N(1 - choice)) :- v(choice, $ - 1).\n"
    );
}

#[test]
fn many_clauses_are_numbered() {
    let text = (0..200).fold(".decl a(x: number)\na(1). a(2).\n".to_owned(), |text, at| {
        text + &format!(
            ".decl n{at}(x: number, n: number)\nn{at}(x, autoinc()) :- a(x), x > {}.\n",
            at % 2
        )
    });
    let mut session = program(&text).session();
    session.commit().expect("small");
    compare(&session, &text);
    let mut numbers: Vec<i32> = (0..200)
        .flat_map(|at| {
            let rows = session.encoded_rows(predicate(&session, &format!("n{at}")));
            rows.map(|row| row[1].as_number()).collect::<Vec<_>>()
        })
        .collect();
    numbers.sort_unstable();
    assert_eq!(numbers, (0..300).collect::<Vec<i32>>());
}

#[test]
fn numbers_follow_those_before() {
    let text = ".decl e, f(x: symbol)\n.input e, f\n.decl m, n(x: symbol, n: number)\nm(x, autoinc()) :- e(x).\n\
                n(x, autoinc()) :- f(x).\n.output m, n\n";
    let program = program(text);
    let mut session = program.session();
    session.insert("f", ("x",)).expect("a row");
    session.commit().expect("small");
    assert_eq!(shown(&session, "n"), "x\t0\n");
    session.insert("e", ("a",)).expect("a row");
    session.commit().expect("small");
    compare(&session, text);
    assert_eq!(shown(&session, "n"), "x\t1\n");
    // They are uncertain where those before are.
    let mut marginals = Marginals::new(&program, ["n"], MarginalOptions::default()).expect("queried");
    marginals.insert("e", ("a",), 0.5).expect("a row");
    marginals.insert("f", ("x",), 1.0).expect("a row");
    marginals.compute(&Cancel::never()).expect("small");
    let inexact = marginals.inexact();
    assert!(matches!(inexact, Some(Inexact::Rounds(_))), "{inexact:?}");
    for number in [0, 1] {
        let found = marginals.probability("n", ("x", number)).expect("derived");
        let (low, high) = found.interval.expect("estimated");
        assert!(low < 0.5 && 0.5 < high, "{found:?}");
    }
}

#[test]
fn plans_show_numbers() {
    let (sources, loaded) = load(".decl a, n(x: number)\na(1).\nn(autoinc()) :- a(_).\n");
    let plans = Program::new(loaded.rules.expect("valid"))
        .expect("small")
        .show_plans(&sources);
    assert!(plans.contains("= autoinc()"), "{plans}");
}

#[test]
fn functors_of_the_caller_are_checked() {
    let text = ".functor f(x: number): symbol\n.decl s, t(s: symbol)\n.input s\n";
    let (_, loaded) = load(&format!("{text}t(@f(s)) :- s(s).\n"));
    let messages: Vec<_> = loaded.diagnostics.iter().map(|fault| &fault.message).collect();
    assert_eq!(
        messages,
        ["`@f` takes or returns values of type `number`, not `symbol`"]
    );
    let stray = program(&format!("{text}t(@f(1)) :- s(_).\n")).define_batch("f", |batch, values| {
        values.extend((0..batch.len()).map(|_| Some(Value(u32::MAX))));
        Ok(())
    });
    let mut session = stray.expect("declared").session();
    session.insert("s", ("a",)).expect("a row");
    let error = session.commit().expect_err("fails").to_string();
    assert_eq!(error, "the functor `f` failed: a value is no symbol of this session");
}

#[test]
fn faults_of_a_limit_are_reported_once() {
    let declared = ".decl a, b(x: number)\na(1). b(1).\n";
    for (directive, wanted) in [
        (".limitsize a, b(n=2, k=3)", "`k` has no effect"),
        (".limitsize a, b(n=x)", "`n=x` is no number of rows"),
        (".limitsize a, b()", "`.limitsize a, b` has no limit"),
    ] {
        let (_, loaded) = load(&format!("{declared}{directive}\n"));
        let messages: Vec<_> = loaded.diagnostics.iter().map(|fault| &fault.message).collect();
        assert_eq!(messages, [wanted], "{directive}");
    }
}

/// A linear congruential generator.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end
    }

    pub(crate) fn of<'t>(&mut self, all: &[&'t str]) -> &'t str {
        all[usize::try_from(self.below(all.len() as u64)).expect("few")]
    }
}

/// Returns a program of three strata over an input predicate, each with a key or a limit.
fn random_program(random: &mut Random) -> String {
    let mut text =
        ".decl e(x: symbol, y: number)\n.input e\n.decl i(x: symbol, y: number) choice-domain y\n.input i\n".to_owned();
    for stratum in 0..3 {
        let key = random.of(&[
            "choice-domain x",
            "choice-domain y",
            "choice-domain x, y",
            "choice-domain (x, y), x",
            "",
        ]);
        text += &format!(".decl p{stratum}(x: symbol, y: number) {key}\n.decl q{stratum}(x: symbol, y: number)\n");
        if random.below(3) == 0 {
            text += &format!(".limitsize p{stratum}(n={})\n", 1 + random.below(8));
        }
        let before = match stratum {
            0 => vec!["e".to_owned(), "i".to_owned()],
            _ => vec![format!("p{}", stratum - 1), format!("q{}", stratum - 1), "e".to_owned()],
        };
        let before: Vec<&str> = before.iter().map(String::as_str).collect();
        text += &clauses(stratum, &before, random);
    }
    text
}

/// Returns random clauses of the predicates `p` and `q` of a stratum over those before.
pub fn clauses(stratum: usize, before: &[&str], random: &mut Random) -> String {
    let mut text = String::new();
    for _ in 0..2 + random.below(4) {
        let (one, other) = (random.of(before), random.of(before));
        text += &match random.below(7) {
            0 | 1 => format!("p{stratum}(x, y) :- {one}(x, y).\n"),
            2 => format!("p{stratum}(x, y) :- p{stratum}(x, z), {one}(_, y), z != y.\n"),
            3 => format!("p{stratum}(x, y + 1) :- p{stratum}(x, y), {one}(x, _), y < 6.\n"),
            4 => format!(
                "q{stratum}(x, y) :- p{stratum}(x, y), {one}(_, y). q{stratum}(x, y) :- q{stratum}(z, y), {other}(x, _), p{stratum}(z, _).\n"
            ),
            5 => format!("p{stratum}(x, y) :- q{stratum}(x, y), {other}(x, _).\n"),
            _ => format!("q{stratum}(x, c) :- {one}(x, _), c = count : {{ {other}(x, _) }}.\n"),
        };
    }
    text
}

#[test]
fn random_programs_derive_what_the_naive_evaluator_derives() {
    change_alike(150, random_program, |program| program);
}

/// Compares sessions of random programs over `e` and `i`, with their functors `defined`, with the naive evaluator and with
/// fresh sessions.
pub fn change_alike(programs: u32, random_program: impl Fn(&mut Random) -> String, defined: fn(Program) -> Program) {
    for seed in 0..u64::from(cases(programs).cases) {
        let mut random = Random(seed);
        let text = random_program(&mut random);
        let program = defined(program(&text));
        let mut session = program.session();
        session.set_strategy([Strategy::Auto, Strategy::Maintain, Strategy::Recompute][seed as usize % 3]);
        for step in 0..4 {
            for _ in 0..5 {
                let row = (random.of(&["b", "a", "d", "c"]), random.below(4));
                let name = random.of(&["e", "i"]);
                match random.below(3) {
                    0 => session.retract(name, row),
                    _ => session.insert(name, row),
                }
                .expect("a row");
            }
            session.commit().expect("small");
            compare(&session, &text);
            // Symbols have other numbers in a fresh session.
            let mut fresh = program.session();
            for name in ["e", "i"] {
                let stored = predicate(&session, name);
                let stored = program.rules().predicates[stored.index()].edb.unwrap_or(stored);
                let lines = facts::print(&session, stored);
                for line in lines.lines().rev() {
                    let (x, y) = line.split_once('\t').expect("two columns");
                    fresh
                        .insert(name, (x, y.parse::<i32>().expect("a number")))
                        .expect("a row");
                }
            }
            fresh.commit().expect("small");
            for id in (0..).map(PredicateId).take(program.rules().predicates.len()) {
                let name = &program.rules().predicates[id.index()].name;
                assert_eq!(
                    facts::print(&session, id),
                    facts::print(&fresh, id),
                    "{name}, seed {seed}, step {step}\n{text}"
                );
            }
            explain(&session, &text);
        }
    }
}

/// Explains the rows that hold, and the absence of others.
pub(crate) fn explain(session: &Session, text: &str) {
    let (sources, _) = load(text);
    let rules = session.program().rules();
    let printer = ExplanationPrinter::new(rules, session.symbols(), &sources);
    for (id, predicate) in (0..)
        .map(PredicateId)
        .zip(&rules.predicates)
        .filter(|(_, predicate)| !predicate.hidden)
    {
        for row in session.encoded_rows(id).map(<[Value]>::to_vec).collect::<Vec<_>>() {
            let proof = session.explain(id, &row).expect("small");
            let proof = proof.unwrap_or_else(|| panic!("{} {row:?} has no proof\n{text}", predicate.name));
            assert!(!printer.tree(&proof).is_empty());
        }
        let bases: Vec<BaseType> = predicate.columns.iter().map(|column| column.base).collect();
        if bases != [BaseType::Symbol, BaseType::Number] {
            continue;
        }
        let symbol = session.symbols().get("a").map_or(Value(0), |symbol| Value(symbol.0));
        for n in 0..3 {
            let pattern = [Some(symbol), Some(Value::number(n))];
            if !session.contains(id, &[symbol, Value::number(n)][..]) {
                let absence = session.explain_absence(id, &pattern).expect("small");
                let absence = absence.unwrap_or_else(|| panic!("{} {pattern:?} is not absent\n{text}", predicate.name));
                assert!(!printer.tree(&absence).is_empty());
            }
        }
    }
}

#[test]
fn explanations_name_the_row_that_holds_instead() {
    let text = ".decl e(x: number, y: number)\ne(1, 2). e(1, 3). e(2, 3).\n.decl p(x: number, y: number) choice-domain x\n/// P1: an edge\np(x, y) :- e(x, y).\n\
        .decl n(x: number)\nn(0). n(x + 1) :- n(x).\n.limitsize n(n=3)\n";
    let (sources, loaded) = load(text);
    let program = Program::new(loaded.rules.expect("valid")).expect("small");
    let mut session = program.session();
    session.commit().expect("small");
    let printer = ExplanationPrinter::new(program.rules(), session.symbols(), &sources);
    let absent = |name: &str, row: &[i32]| {
        let pattern: Vec<Option<Value>> = row.iter().map(|n| Some(Value::number(*n))).collect();
        let explanation = session
            .explain_absence(predicate(&session, name), &pattern)
            .expect("small")
            .expect("absent");
        printer.json(&explanation).to_string() + &printer.tree(&explanation)
    };
    let said = absent("p", &[1, 3]);
    assert!(said.contains("p(1, 2) holds instead"), "{said}");
    let said = absent("p", &[2, 2]);
    assert!(said.contains("fails"), "{said}");
    let said = absent("n", &[3]);
    assert!(said.contains("limit"), "{said}");
}

#[test]
fn demand_leaves_keys_and_limits_alone() {
    let text = ".decl e(x: number, y: number)\ne(1, 2). e(2, 1). e(1, 1). e(2, 3).\n.decl p(x: number, y: number) choice-domain x magic\np(x, y) :- e(x, y).\n\
        .decl q(x: number, y: number) magic\nq(x, y) :- p(x, y). q(x, z) :- q(x, y), p(y, z).\n.decl o(y: number)\n.output o\no(y) :- q(2, y).\n";
    let (_, loaded) = load(text);
    let rules = loaded.rules.expect("valid");
    let restricted = rewrite::demand(&rules).expect("restricted");
    let rows = |rules| {
        let mut session = Program::new(rules).expect("small").session();
        session.commit().expect("small");
        shown(&session, "o")
    };
    assert_eq!(rows(restricted), rows(rules));
}

#[test]
fn probabilities_are_estimated_and_comparisons_refused() {
    let text = ".decl e(x: symbol, y: symbol)\n.input e\n.decl p(x: symbol, y: symbol) choice-domain x\np(x, y) :- e(x, y).\n.output p\n";
    let program = program(text);
    let mut marginals = Marginals::new(&program, ["p"], MarginalOptions::default()).expect("queried");
    marginals.insert("e", ("a", "b"), 0.5).expect("a row");
    marginals.insert("e", ("a", "c"), 1.0).expect("a row");
    marginals.compute(&Cancel::never()).expect("small");
    assert!(
        matches!(marginals.inexact(), Some(Inexact::Rounds(_))),
        "{:?}",
        marginals.inexact()
    );
    for row in [("a", "b"), ("a", "c")] {
        let found = marginals.probability("p", row).expect("derived");
        let (low, high) = found.interval.expect("estimated");
        assert!(low < 0.5 && 0.5 < high, "{found:?}");
    }
    let rules = program.rules();
    let faults = diff::diff(rules, rules, &diff::Options::default()).expect_err("refused");
    assert_eq!(faults[0].code.name(), "unsupported");
}

#[test]
fn faults_say_what_is_wrong() {
    for (text, code, message) in [
        (
            ".decl p(x: number) choice-domain y",
            "unknown-column",
            "`p` has no column `y`",
        ),
        (
            ".decl p(x: number) choice-domain (x, y)",
            "unknown-column",
            "`p` has no column `y`",
        ),
        (
            ".decl p(x: number, y: number) inline choice-domain x\np(1, 2). p(1, 3).\n.decl o(x: number)\no(y) :- p(_, y).",
            "unsupported",
            "`p` is inline and has keys",
        ),
        (
            ".decl p(x: number, y: number) eqrel choice-domain x\np(1, 2). p(1, 3).",
            "unsupported",
            "`p` is an equivalence relation and has keys",
        ),
        (".decl p(x: number) choice-domain", "syntax", ""),
        (".decl p(x: number) choice-domain (x", "syntax", ""),
        (
            ".decl p(x: number)\n.limitsize p",
            "syntax",
            "`.limitsize p` has no limit",
        ),
        (
            ".decl p(x: number)\n.limitsize p(n=many)",
            "syntax",
            "`n=many` is no number of rows",
        ),
        (".decl p(x: number)\n.limitsize p(n=-1)", "syntax", ""),
        (".limitsize q(n=1)", "unknown-predicate", ""),
        (
            ".decl p(x: number)\n.limitsize p(n=1, m=2)",
            "ignored",
            "`m` has no effect",
        ),
    ] {
        has_fault(&format!("{text}\n"), code, message);
    }
}
