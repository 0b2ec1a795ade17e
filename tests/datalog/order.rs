//! The order of literals has no meaning: any order gives the same diagnostics and the same rows.

use crate::cases::cases;
use crate::rule_files::RuleFiles;
use logicity_datalog::diag::{Severity, Sources};
use logicity_datalog::{PredicateId, Program, Value, load, naive};
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::fmt::Write;

/// What a body needs: literals in the order in which they were drawn.
#[derive(Clone, Debug)]
struct Drawn {
    /// For each clause: the head, and the numbers from which its literals are made.
    clauses: Vec<(u8, Vec<[u8; 4]>)>,
}

fn drawn() -> impl Strategy<Value = Drawn> {
    let clause = (any::<u8>(), prop::collection::vec(any::<[u8; 4]>(), 1..7));
    prop::collection::vec(clause, 1..4).prop_map(|clauses| Drawn { clauses })
}

const FACTS: &str = ".decl b(v: number)\n.decl e(v: number, w: number)\n.decl r(v: number, w: number)\n.decl q(v: number)\n\
                     .output r, q\nb(0). b(1). b(3).\ne(0, 1). e(1, 2). e(2, 2). e(3, 0).\n";

const NAMES: [&str; 5] = ["x", "y", "z", "k", "s"];

fn name(number: u8) -> &'static str {
    NAMES[usize::from(number) % NAMES.len()]
}

/// Returns a literal: bounded, so that recursion ends.
fn literal([kind, a, b, c]: [u8; 4]) -> Vec<String> {
    let (x, y, n) = (name(a), name(b), c % 4);
    let one = match kind % 20 {
        0..=3 => format!("b({x})"),
        4..=5 => format!("e({x}, {y})"),
        6 => format!("r({x}, {y})"),
        7 => format!("q({x})"),
        8 => format!("!b({x})"),
        9 => format!("!e({x}, _)"),
        10 => format!("{x} = {n}"),
        11 => format!("{x} = {y}"),
        12 => format!("{x} = ({y} + {n}) % 5"),
        13 => format!("{x} < {y}"),
        14 => format!("{x} = range(0, {y} % 4)"),
        15 => format!("{x} = (sum n : {{ b(n), n < {y} }}) % 7"),
        16 => format!("{x} = (sum n : {{ n = range(0, {y} % 3) }}) % 7"),
        17 => format!("{x} = count : {{ e({y}, m), m > {n} }}"),
        18 => format!("{x} = max -n : {{ e({y}, n) }}"),
        _ => format!("{x} = (sum n : {{ e({y}, n), k2 = max m : {{ b(m), m <= {y} }}, n <= k2 }}) % 7"),
    };
    vec![one]
}

/// Returns the text; the literals of each body are in the order of `rank`.
fn text(drawn: &Drawn, rank: impl Fn(usize, usize) -> u64) -> String {
    let mut text = FACTS.to_owned();
    for (number, (head, body)) in drawn.clauses.iter().enumerate() {
        let mut literals: Vec<String> = body.iter().flat_map(|genes| literal(*genes)).collect();
        let mut places: Vec<usize> = (0..literals.len()).collect();
        places.sort_by_key(|&place| rank(number, place));
        literals = places.into_iter().map(|place| literals[place].clone()).collect();
        let head = match head % 3 {
            0 => format!("q({})", name(*head / 3)),
            _ => format!("r({}, {})", name(*head / 3), name(*head / 15)),
        };
        writeln!(text, "{head} :- {}.", literals.join(", ")).unwrap();
    }
    text
}

/// The codes and messages of errors, and the rows of each predicate.
type Verdict = (Vec<(&'static str, String)>, Option<Vec<Vec<String>>>);

/// Returns the set of messages, and the rows of all predicates, if there is no error.
fn verdict(text: &str) -> Verdict {
    let mut sources = Sources::new();
    let entry = sources.add("a.dl", text);
    let loaded = load(&mut sources, entry, &RuleFiles);
    // Warnings of clauses that derive nothing new stem from searches with limits.
    let errors = loaded
        .diagnostics
        .iter()
        .filter(|fault| fault.severity() == Severity::Error);
    let mut messages: Vec<(&str, String)> = errors.map(|fault| (fault.code.name(), fault.message.clone())).collect();
    messages.sort();
    // One cycle may be reported at several of its atoms.
    messages.dedup();
    let rows = loaded.rules.map(|rules| {
        let program = Program::new(rules).expect("the rules are small");
        let mut session = program.session();
        session.commit().expect("the recursion is bounded");
        let shown: Vec<_> = ["r", "q"]
            .into_iter()
            .map(|name| program.rules().predicate(name).unwrap())
            .collect();
        let naive = naive::evaluate(program.rules(), &program.rules().symbols, []);
        let rows = |predicate: PredicateId| {
            let rows: BTreeSet<Vec<Value>> = session.encoded_rows(predicate).map(<[Value]>::to_vec).collect();
            assert_eq!(rows, naive[predicate.index()], "{text}");
            rows.iter().map(|row| format!("{row:?}")).collect()
        };
        shown.into_iter().map(rows).collect()
    });
    (messages, rows)
}

proptest! {
    #![proptest_config(cases(512))]

    #[test]
    fn any_order_of_literals_gives_the_same_verdict_and_rows(drawn in drawn(), seed in any::<u64>()) {
        let written = text(&drawn, |_, place| place as u64);
        let shuffled = text(&drawn, |clause, place| {
            let mixed = seed ^ (clause as u64 * 64 + place as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            mixed.wrapping_mul(0xBF58_476D_1CE4_E5B9).rotate_left(31)
        });
        prop_assert_eq!(verdict(&written), verdict(&shuffled), "{}\n{}", written, shuffled);
    }
}

#[test]
fn what_binds_may_stand_last() {
    let clauses = [
        (
            "a(k, s) :- s = sum n : { b(n), n < k }, k = range(0, 3).",
            "0 0, 1 0, 2 1",
        ),
        (
            "a(k, s) :- s = sum n : { n = range(0, k) }, k = range(0, 3).",
            "0 0, 1 0, 2 1",
        ),
        (
            "a(k, s) :- s = sum n : { n = range(0, m), m = k }, k = t + 1, t = count : b(_).",
            "4 6",
        ),
        (
            "a(k, s) :- s = count : { c(n), n < k }, k = sum n : { b(n), n < t }, t = range(0, 4).",
            "0 0, 1 1, 3 3",
        ),
        // The aggregate needs s, which its own value must equal.
        ("a(k, s) :- s = sum n : { b(n), n < s }, s = k, c(k).", "0 0"),
        (
            "a(k, s) :- s = (sum n : { b(n), n < s }) % 7, c(k), s = count : { b(n), n < k }.",
            "0 0",
        ),
        // The recursion binds k, and so does c: the aggregate must not need itself.
        (
            "a(k, s) :- a(k, _), s = sum n : { n = range(0, k) }, c(k).\na(1, 7).",
            "1 0, 1 7",
        ),
        (
            "a(k, s) :- c(k), s = sum n : { n = range(0, k) }, a(k, _).\na(1, 7).",
            "1 0, 1 7",
        ),
    ];
    for (clause, wanted) in clauses {
        let text = format!(
            ".decl a(k: number, s: number)\n.decl b(v: number)\n.decl c(v: number)\n.output a\nb(0). b(1). b(2).\n\
             c(0). c(1). c(2).\n{clause}\n"
        );
        let mut sources = Sources::new();
        let entry = sources.add("a.dl", text.as_str());
        let loaded = load(&mut sources, entry, &RuleFiles);
        assert!(loaded.diagnostics.is_empty(), "{clause}: {:?}", loaded.diagnostics);
        let program = Program::new(loaded.rules.expect("there is no error")).expect("the rules are small");
        let mut session = program.session();
        session.commit().expect("the recursion is bounded");
        let predicate = program.rules().predicate("a").unwrap();
        let mut rows: Vec<String> = (session.encoded_rows(predicate))
            .map(|row| {
                row.iter()
                    .map(|value| value.as_number().to_string())
                    .collect::<Vec<_>>()
                    .join(" ")
            })
            .collect();
        rows.sort();
        assert_eq!(rows.join(", "), wanted, "{clause}");
    }
}
