//! Temporal operators: sessions against the specification, and the specification against the words of the reference.

use crate::cases::cases;
use logicity_datalog::diag::Limit;
use logicity_datalog::{Limits, Program, Session, Strategy, Value, naive};
use proptest::collection::vec;
use proptest::prelude::*;
// The engine has strategies, too.
use proptest::strategy::Strategy as Generator;
use std::collections::BTreeSet;

/// A window of a temporal operator; `None` for all ticks so far.
type Window = Option<(u32, u32)>;

fn window() -> impl Generator<Value = Window> {
    let bounded = (0..4_u32, 0..6_u32).prop_map(|(first, more)| Some((first, first + more)));
    prop_oneof![5 => bounded, 1 => Just(None)]
}

fn written(operator: &str, window: Window) -> String {
    match window {
        Some((first, last)) => format!("{operator}[{first},{last}]"),
        None => operator.to_owned(),
    }
}

/// Returns whether `p` held so in the last tick of a trace, by the words of the reference.
fn once(trace: &[bool], (first, last): (usize, usize)) -> bool {
    let now = trace.len() - 1;
    (first..=last.min(now)).any(|ago| ago <= now && trace[now - ago])
}

fn historically(trace: &[bool], (first, last): (usize, usize)) -> bool {
    let now = trace.len() - 1;
    (first..=last).all(|ago| ago <= now && trace[now - ago])
}

fn since(held: &[bool], trace: &[bool], (first, last): (usize, usize)) -> bool {
    let now = trace.len() - 1;
    (first..=last.min(now)).any(|ago| trace[now - ago] && (0..ago).all(|later| held[now - later]))
}

fn ends(window: Window) -> (usize, usize) {
    window.map_or((0, usize::MAX), |(first, last)| (first as usize, last as usize))
}

proptest! {
    #![proptest_config(cases(400))]

    /// Propositional traces, operator by operator.
    #[test]
    fn operators_mean_what_the_reference_says(
        window in window(),
        bounded in (0..4_u32, 0..6_u32),
        ticks in 1..5_u32,
        trace in vec((any::<bool>(), prop::bool::weighted(0.7)), 1..30),
    ) {
        let bounded = (bounded.0, bounded.0 + bounded.1);
        let program = Program::parse(&format!(
            ".decl p, q, a, b, c, d, e, f() .input p, q
             a() :- {once} p().
             b() :- {historically} p().
             c() :- q() {since} p().
             d() :- previous p().
             e() :- for[{ticks}] p().
             f() :- q(), not {once} p().",
            once = written("once", window),
            historically = written("historically", Some(bounded)),
            since = written("since", window),
        ))
        .map_err(|error| TestCaseError::fail(error.to_string()))?;
        let mut session = program.session();
        for tick in 0..trace.len() {
            let (p, q) = trace[tick];
            for (name, holds) in [("p", p), ("q", q)] {
                let change = if holds { Session::insert } else { Session::retract };
                change(&mut session, name, ()).unwrap();
            }
            match tick {
                0 => session.commit().unwrap(),
                _ => session.advance().unwrap(),
            };
            let (p, q): (Vec<bool>, Vec<bool>) = trace[..=tick].iter().copied().unzip();
            let bounded = (bounded.0 as usize, bounded.1 as usize);
            let expected = [
                ("a", once(&p, ends(window))),
                ("b", historically(&p, bounded)),
                ("c", since(&q, &p, ends(window))),
                ("d", tick > 0 && p[tick - 1]),
                ("e", historically(&p, (0, ticks as usize - 1))),
                ("f", q[tick] && !once(&p, ends(window))),
            ];
            for (name, holds) in expected {
                prop_assert_eq!(session.contains(name, ()), holds, "{} in tick {} of {:?}", name, tick, trace);
            }
        }
    }
}

/// A rule with a temporal operator over rows.
fn rule() -> impl Generator<Value = String> {
    let head = prop_oneof![Just("a(x)"), Just("b(x)")];
    let bounded = (0..4_u32, 0..6_u32).prop_map(|(first, more)| Some((first, first + more)));
    let literal = prop_oneof![
        (
            window(),
            prop_oneof![
                Just("e(x, y), n(y)"),
                Just("n(x)"),
                Just("e(x, _)"),
                Just("e(y, x)"),
                Just("e(x, x)")
            ]
        )
            .prop_map(|(window, atoms)| format!("{} {atoms}", written("once", window))),
        (
            bounded.clone(),
            prop_oneof![Just("e(x, y)"), Just("n(x)"), Just("e(x, 2)"), Just("c(x, y)")]
        )
            .prop_map(|(window, atom)| format!("{} {atom}", written("historically", window))),
        (
            window(),
            prop_oneof![
                Just(("n(y)", "e(x, y)")),
                Just(("n(x)", "e(x, y)")),
                Just(("e(y, x)", "e(x, y)")),
                Just(("n(1)", "n(x)")),
                Just(("c(x, y)", "c(y, x)")),
            ]
        )
            .prop_map(|(window, (held, atom))| format!("{held} {} {atom}", written("since", window))),
        Just("previous a(x)".to_owned()),
        Just("previous c(x, y)".to_owned()),
        (1..5_u32).prop_map(|ticks| format!("for[{ticks}] n(x)")),
    ];
    let more = prop_oneof![
        3 => Just(""),
        1 => Just(", n(x)"),
        1 => Just(", not n(x)"),
        1 => Just(", not previous b(x)"),
        1 => Just(", not once[1,3] c(x, x)"),
        1 => Just(", 1 < count : { once[0,2] e(x, z) }"),
    ];
    (head, literal, more).prop_map(|(head, literal, more)| format!("{head} :- {literal}{more}."))
}

const DECLARED: &str = ".decl n, a, b(x: number) .decl e, c(x: number, y: number) .input n, e .output a, b
                        c(x, y) :- e(x, y), n(y).
                        c(x, y) :- e(y, x), previous c(x, y).\n";

/// The changes of a commit: a row of `n` or `e` that holds or not.
type Changes = Vec<(bool, i32, Option<i32>)>;

fn row(x: i32, y: Option<i32>) -> Vec<Value> {
    [Some(x), y].into_iter().flatten().map(Value::number).collect()
}

fn changes() -> impl Generator<Value = Changes> {
    vec((prop::bool::weighted(0.6), 0..3_i32, prop::option::of(0..3_i32)), 0..4)
}

proptest! {
    #![proptest_config(cases(400))]

    /// Random programs and ticks of several commits each. After every tick, each session holds what the specification
    /// derives from the whole history. That is about 12,000 commits.
    #[test]
    fn sessions_agree_with_the_whole_history(
        rules in vec(rule(), 1..5),
        script in vec(vec(changes(), 1..3), 1..14),
    ) {
        let program = Program::parse(&(DECLARED.to_owned() + &rules.join("\n")))
            .map_err(|error| TestCaseError::fail(format!("{error}\n{rules:?}")))?;
        let checked = program.rules();
        let [n, e] = ["n", "e"].map(|name| program.predicate(name).unwrap());
        let mut facts: BTreeSet<_> = BTreeSet::new();
        let mut ticks = Vec::new();
        for changes in script.iter() {
            for (holds, x, y) in changes.iter().flatten() {
                let fact = (if y.is_some() { e } else { n }, row(*x, *y));
                if *holds { facts.insert(fact) } else { facts.remove(&fact) };
            }
            ticks.push(facts.iter().cloned().collect::<Vec<_>>());
        }
        let models = naive::evaluate_ticks(checked, &checked.symbols, ticks);
        for strategy in [Strategy::Auto, Strategy::Maintain, Strategy::Recompute] {
            let mut session = program.session();
            session.set_strategy(strategy);
            for (tick, (commits, model)) in script.iter().zip(&models).enumerate() {
                for (commit, changes) in commits.iter().enumerate() {
                    for (holds, x, y) in changes {
                        let row = row(*x, *y);
                        let predicate = if y.is_some() { e } else { n };
                        let change = if *holds { Session::insert } else { Session::retract };
                        change(&mut session, predicate, &row[..]).unwrap();
                    }
                    if commit == 0 && tick > 0 {
                        session.advance().unwrap();
                    } else {
                        session.commit().unwrap();
                    }
                }
                prop_assert_eq!(session.tick(), tick as u64);
                let held = crate::random_program::agree::database(&session);
                for (position, (held, expected)) in held.iter().zip(model).enumerate() {
                    if !program.is_aggregated(logicity_datalog::PredicateId(position as u32)) {
                        let name = &checked.predicates[position].name;
                        prop_assert_eq!(held, expected, "{} in tick {} with {:?}\n{:?}", name, tick, strategy, rules);
                    }
                }
            }
        }
    }
}

/// What a session remembers counts towards its limit of memory, although no predicate has more rows.
#[test]
fn memories_of_sessions_have_a_limit() {
    let source = ".decl p, q(x: number) .input p
                  q(x) :- once[900000,1000000] p(x).";
    let program = Program::parse(source).unwrap();
    let mut session = program.session();
    let limits = Limits {
        bytes: 1 << 20,
        ..session.limits()
    };
    session.set_limits(limits);
    let mut advance = |tick: u32| {
        for x in 0..10_i32 {
            match tick % 2 {
                0 => session.insert("p", (x,)).unwrap(),
                _ => session.retract("p", (x,)).unwrap(),
            }
        }
        session.advance().map(|_| ())
    };
    let (tick, error) = (0..10_000)
        .find_map(|tick| Some((tick, advance(tick).err()?)))
        .expect("the memory grows");
    assert!(tick > 100, "{tick}");
    assert_eq!(error.limit(), Some(Limit::Memory(1 << 20)), "{error}");
}
