//! Clauses with probabilities: sessions against the specification, and exact probabilities against the enumeration of
//! all worlds and the frequencies of seeded runs.

use crate::cases::cases;
use crate::random_program::Batch;
use crate::random_program::agree::{agrees, database};
use crate::written_program::program;
use logicity_datalog::cancel::Cancel;
use logicity_datalog::diff::{Equivalence, Options, diff};
use logicity_datalog::{Inexact, MarginalOptions, Marginals, PredicateId, Program, Session, Value, naive};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::strategy::Strategy as Generator;
use std::collections::BTreeMap;

/// The declarations. The facts intern the symbols, so that they have the same words in all sessions.
const DECLARED: &str = ".decl domain(x: symbol)
    domain(\"u\").
    domain(\"v\").
    .decl n(x: symbol) .input n
    .decl e(x: symbol, y: symbol) .input e
    .decl w(x: symbol, p: float) .input w
    .decl a, b, d(x: symbol)
    .decl c(x: symbol, y: symbol)
    .decl k(x: symbol, m: number)\n";

/// The symbols of facts.
pub const SYMBOLS: [&str; 2] = ["u", "v"];

/// A clause: the probabilities and heads of its alternatives, and its body. A probability is a number or the variable
/// that the body binds.
#[derive(Clone, Debug)]
pub struct Written {
    pub heads: Vec<(Option<&'static str>, &'static str)>,
    body: Vec<&'static str>,
}

impl Written {
    pub fn text(&self) -> String {
        let heads = self.heads.iter().map(|(probability, head)| match probability {
            Some(probability) => format!("{probability} :: {head}"),
            None => (*head).to_owned(),
        });
        let heads: Vec<String> = heads.collect();
        format!("{} :- {}.\n", heads.join("; "), self.body.join(", "))
    }

    fn is_drawn(&self) -> bool {
        self.heads[0].0.is_some()
    }

    /// The variables that a draw is about.
    fn variables(&self) -> Vec<&'static str> {
        let text = self.text();
        ["x", "y", "p"]
            .into_iter()
            .filter(|name| text.split(|c: char| !c.is_alphanumeric()).any(|word| word == *name))
            .collect()
    }

    fn probability(text: &str) -> f64 {
        // The facts of `w` have this probability.
        text.parse().unwrap_or(0.25)
    }
}

/// Clauses in two strata. Every clause binds its variables; `w` gives `x` the probability `p`.
pub fn clauses() -> impl Generator<Value = Vec<Written>> {
    let heads = |unary: [&'static str; 2], probability: bool| {
        let one = prop::sample::select(unary.to_vec());
        let number = prop::sample::select(vec!["0.3", "0.5", "0.9", "1.0", "0.0"]);
        let low = prop::sample::select(vec!["0.2", "0.5", "0.1"]);
        prop_oneof![
            3 => one.clone().prop_map(|head| vec![(None, head)]),
            3 => (number, one.clone()).prop_map(|(number, head)| vec![(Some(number), head)]),
            1 => (low.clone(), one.clone(), low.clone(), one.clone())
                .prop_map(|(p, head, q, other)| vec![(Some(p), head), (Some(q), other)]),
            u32::from(probability) => one.prop_map(|head| vec![(Some("p"), head)]),
        ]
    };
    let clause = |unary: [&'static str; 2], literals: Vec<&'static str>| {
        let body = vec(prop::sample::select(literals), 0..3);
        (
            heads(unary, true),
            body,
            prop::sample::select(vec!["n(x)", "e(x, y)", "e(y, x)", "e(x, _)", "e(x, _y)"]),
        )
            .prop_map(|(heads, mut body, first)| {
                body.insert(0, first);
                // Every variable has a positive atom.
                let text = format!("{heads:?} {body:?}");
                if text.contains('y') && !body.iter().any(|literal| ["e(x, y)", "e(y, x)"].contains(literal)) {
                    body.push("n(y)");
                }
                if heads.iter().any(|(probability, _)| *probability == Some("p")) {
                    body.push("w(x, p)");
                }
                Written { heads, body }
            })
    };
    let low = clause(
        ["a(x)", "c(x, y)"],
        vec!["a(x)", "c(x, y)", "a(y)", "n(x)", "c(y, x)", "not n(x)", "x != y"],
    );
    let high = clause(
        ["b(x)", "d(x)"],
        vec![
            "not a(x)",
            "not c(x, y)",
            "not c(x, _)",
            "b(y)",
            "d(x)",
            "a(x)",
            "c(_, x)",
            "(a(x); c(y, x))",
        ],
    );
    (vec(low, 1..4), vec(high, 1..4)).prop_map(|(low, high)| low.into_iter().chain(high).collect())
}

pub fn text(clauses: &[Written]) -> String {
    clauses
        .iter()
        .fold(DECLARED.to_owned(), |text, clause| text + &clause.text())
}

/// Facts by their numbers: of `n`, `e` and `w`.
pub fn facts(bits: u16) -> Vec<(&'static str, Vec<&'static str>)> {
    let [u, v] = SYMBOLS;
    let all = [
        ("n", vec![u]),
        ("n", vec![v]),
        ("e", vec![u, v]),
        ("e", vec![v, u]),
        ("e", vec![u, u]),
        ("e", vec![v, v]),
        ("w", vec![u]),
        ("w", vec![v]),
    ];
    let chosen = all.into_iter().enumerate().filter(|(at, _)| bits >> at & 1 == 1);
    chosen.map(|(_, fact)| fact).collect()
}

/// Encodes facts in the symbols of a program.
fn encoded(program: &Program, facts: &[(&str, Vec<&str>)]) -> Vec<(PredicateId, Vec<Value>)> {
    let symbols = &program.rules().symbols;
    let row = |(name, row): &(&str, Vec<&str>)| {
        let mut row: Vec<Value> = row.iter().map(|text| Value(symbols.intern(text).0)).collect();
        if *name == "w" {
            row.push(Value::float(0.25));
        }
        (program.predicate(name).unwrap(), row)
    };
    facts.iter().map(row).collect()
}

/// An outcome of a random variable: its probability, and the fact that it adds.
type Outcome = (f64, Option<(String, Vec<String>)>);

/// The probabilities of all derived rows, by enumeration of the worlds: an input predicate for each clause says for
/// which values it is drawn, and which alternative.
fn enumerated(clauses: &[Written], facts: &[(&str, Vec<&str>)], uncertain: &[f64]) -> BTreeMap<String, f64> {
    let mut source = DECLARED.to_owned();
    // Each random variable: its outcomes, with their probabilities and the fact that each adds.
    let mut random: Vec<Vec<Outcome>> = Vec::new();
    for (number, clause) in clauses.iter().enumerate() {
        if !clause.is_drawn() {
            source += &clause.text();
            continue;
        }
        let variables: Vec<&str> = clause.variables().into_iter().filter(|name| *name != "p").collect();
        let columns: Vec<String> = variables.iter().map(|name| format!("{name}: symbol")).collect();
        for (at, (_, head)) in clause.heads.iter().enumerate() {
            source += &format!(
                ".decl pick{number}_{at}({columns}) .input pick{number}_{at}\n{head} :- {}, pick{number}_{at}({}).\n",
                clause.body.join(", "),
                variables.join(", "),
                columns = columns.join(", "),
            );
        }
        for world in 0..SYMBOLS.len().pow(variables.len() as u32) {
            let row = (0..variables.len()).map(|at| SYMBOLS[world / SYMBOLS.len().pow(at as u32) % SYMBOLS.len()]);
            let row: Vec<String> = row.map(str::to_owned).collect();
            let mut outcomes: Vec<Outcome> = (clause.heads.iter().enumerate())
                .map(|(at, (p, _))| {
                    (
                        Written::probability(p.unwrap()),
                        Some((format!("pick{number}_{at}"), row.clone())),
                    )
                })
                .collect();
            outcomes.push((1.0 - outcomes.iter().map(|(p, _)| p).sum::<f64>(), None));
            random.push(outcomes);
        }
    }
    for ((name, row), p) in facts.iter().zip(uncertain) {
        let row = row.iter().map(|text| (*text).to_owned()).collect();
        random.push(vec![(*p, Some(((*name).to_owned(), row))), (1.0 - p, None)]);
    }
    let program = Program::parse(&source).unwrap_or_else(|error| panic!("{error}"));
    let mut found = BTreeMap::new();
    let mut choice = vec![0; random.len()];
    loop {
        let chosen = || choice.iter().zip(&random).map(|(at, outcomes)| &outcomes[*at]);
        let weight: f64 = chosen().map(|(p, _)| p).product();
        if weight > 0.0 {
            let facts: Vec<(&str, Vec<&str>)> = chosen()
                .filter_map(|(_, fact)| fact.as_ref())
                .map(|(name, row)| (name.as_str(), row.iter().map(String::as_str).collect()))
                .collect();
            let rules = program.rules();
            let model = naive::evaluate(rules, &rules.symbols, encoded(&program, &facts));
            for (predicate, rows) in rules
                .predicates
                .iter()
                .zip(&model)
                .filter(|(predicate, _)| predicate.derived)
            {
                for row in rows {
                    let row: Vec<&str> = row
                        .iter()
                        .map(|value| {
                            rules
                                .symbols
                                .resolve(logicity_datalog::symbol::Symbol(value.0))
                                .unwrap()
                        })
                        .collect();
                    *found.entry(format!("{}{row:?}", predicate.name)).or_default() += weight;
                }
            }
        }
        // The next world, as a number with digits of several bases.
        let Some(at) = (0..choice.len()).find(|&at| choice[at] + 1 < random[at].len()) else {
            return found;
        };
        choice[at] += 1;
        choice[..at].fill(0);
    }
}

/// The number of worlds of [`enumerated`].
fn worlds(clauses: &[Written], facts: usize) -> usize {
    let of = |clause: &Written| {
        let rows = clause.variables().iter().filter(|name| **name != "p").count() as u32;
        (clause.heads.len() + 1).saturating_pow(SYMBOLS.len().pow(rows) as u32)
    };
    let drawn = clauses.iter().filter(|clause| clause.is_drawn());
    drawn.map(of).fold(1 << facts, usize::saturating_mul)
}

const DERIVED: [&str; 4] = ["a", "b", "c", "d"];

/// Marginals of the program with these facts.
pub fn marginals(
    program: &Program,
    facts: &[(&str, Vec<&str>)],
    probabilities: &[f64],
    options: MarginalOptions,
) -> Marginals {
    let mut marginals = Marginals::new(program, DERIVED, options).unwrap();
    insert(&mut marginals, facts, probabilities);
    marginals.compute(&Cancel::never()).unwrap();
    marginals
}

fn insert(marginals: &mut Marginals, facts: &[(&str, Vec<&str>)], probabilities: &[f64]) {
    for ((name, row), p) in facts.iter().zip(probabilities) {
        match row.as_slice() {
            [x] if *name == "w" => marginals.insert(*name, (*x, 0.25_f32), *p),
            [x] => marginals.insert(*name, (*x,), *p),
            [x, y] => marginals.insert(*name, (*x, *y), *p),
            _ => unreachable!("facts have one symbol or two"),
        }
        .unwrap();
    }
}

/// The probabilities, as those of [`enumerated`].
fn shown(marginals: &Marginals) -> BTreeMap<String, f64> {
    let mut shown = BTreeMap::new();
    for name in DERIVED {
        for (row, probability) in marginals.rows(name) {
            let symbols = marginals.symbols();
            let row: Vec<&str> = row
                .iter()
                .map(|value| symbols.resolve(logicity_datalog::symbol::Symbol(value.0)).unwrap())
                .collect();
            shown.insert(format!("{name}{row:?}"), probability.value);
        }
    }
    shown
}

fn close(one: &BTreeMap<String, f64>, other: &BTreeMap<String, f64>, within: f64) -> Result<(), TestCaseError> {
    for name in one.keys().chain(other.keys()) {
        let [first, second] = [one, other].map(|all| all.get(name).copied().unwrap_or(0.0));
        prop_assert!((first - second).abs() <= within, "{name}: {first} and {second}");
    }
    Ok(())
}

/// Aggregates over drawn rows, and draws over their results.
const AGGREGATES: &str = "k(x, m) :- n(x), m = count : { c(x, _) }.
    0.5 :: k(x, m) :- n(x), m = 10 + count : { c(_, x), a(x) }, m > 10.\n";

proptest! {
    #![proptest_config(cases(300))]

    /// Incremental sessions equal fresh naive evaluation under insertions and deletions.
    #[test]
    fn draws_agree_with_naive(clauses in clauses(), script in vec(vec((any::<bool>(), 0..8_u16), 0..6), 1..5)) {
        let program = program(&(text(&clauses) + AGGREGATES));
        let script: Vec<Batch> = (script.iter())
            .map(|batch| {
                let change = |(present, bit): &(bool, u16)| {
                    let (id, row) = encoded(&program, &facts(1 << bit)).remove(0);
                    (*present, id, row)
                };
                batch.iter().map(change).collect()
            })
            .collect();
        // The words of ticks are facts of the hidden predicate, too.
        let mut script = script;
        let chance = program.rules().chance;
        if let Some((chance, batch)) = chance.zip(script.first_mut()) {
            batch.insert(0, (true, chance, vec![Value(3), Value(4)]));
        }
        agrees(&without_own_word(program.rules()), &script)?;
    }

    /// Each tick has its own draws, which a second commit repeats.
    #[test]
    fn ticks_draw_anew(clauses in clauses(), ticks in vec(0..256_u16, 1..12)) {
        let program = program(&text(&clauses));
        let mut session = program.session();
        let mut held: Vec<(PredicateId, Vec<Value>)> = Vec::new();
        let of_ticks = ticks.iter().map(|bits| encoded(&program, &facts(*bits)));
        let expected = naive::evaluate_ticks(program.rules(), &program.rules().symbols, of_ticks);
        for (number, (bits, expected)) in ticks.iter().zip(&expected).enumerate() {
            let now = encoded(&program, &facts(*bits));
            held.iter().for_each(|(id, row)| session.retract(*id, row).unwrap());
            now.iter().for_each(|(id, row)| session.insert(*id, row).unwrap());
            held = now;
            if number == 0 { session.commit() } else { session.advance() }.unwrap();
            prop_assert_eq!(&database(&session), expected);
            prop_assert!(session.commit().unwrap().is_empty());
        }
    }

    #[test]
    fn probabilities_are_those_of_all_worlds(
        clauses in clauses(),
        bits in 0..256_u16,
        uncertain in vec(prop::sample::select(vec![1.0, 1.0, 0.4, 0.75]), 8),
    ) {
        let facts = facts(bits);
        let random = facts.iter().zip(&uncertain).filter(|(_, p)| **p < 1.0).count();
        prop_assume!(worlds(&clauses, random) <= 1 << 12);
        let program = program(&text(&clauses));
        let found = marginals(&program, &facts, &uncertain, MarginalOptions::default());
        prop_assert_eq!(found.inexact(), None);
        close(&shown(&found), &enumerated(&clauses, &facts, &uncertain), 1e-9)?;
    }

    /// Marginals whose facts change equal those made anew.
    #[test]
    fn facts_may_change(clauses in clauses(), scenes in vec((0..256_u16, vec(prop::sample::select(vec![1.0, 0.4]), 8)), 1..5)) {
        let program = program(&text(&clauses));
        let mut kept = Marginals::new(&program, DERIVED, MarginalOptions::default()).unwrap();
        for (bits, uncertain) in scenes {
            let facts = facts(bits);
            kept.clear();
            insert(&mut kept, &facts, &uncertain);
            kept.compute(&Cancel::never()).unwrap();
            let fresh = marginals(&program, &facts, &uncertain, MarginalOptions::default());
            close(&shown(&kept), &shown(&fresh), 1e-12)?;
            // Of few rows only, and again of all.
            let asked: Vec<Vec<&str>> = vec![vec![SYMBOLS[usize::from(bits) % SYMBOLS.len()]], vec!["u", "v"]];
            let words: Vec<Vec<Value>> =
                asked.iter().map(|row| row.iter().map(|name| kept.intern(name)).collect()).collect();
            let rows: Vec<&[Value]> = words.iter().map(Vec::as_slice).collect();
            kept.set_rows(Some(&rows));
            kept.compute(&Cancel::never()).unwrap();
            let mut expected = shown(&fresh);
            expected.retain(|name, _| asked.iter().any(|row| name[1..] == format!("{row:?}")));
            let found = shown(&kept);
            prop_assert!(found.keys().eq(expected.keys()), "{found:?} {expected:?}");
            close(&found, &expected, 1e-12)?;
            kept.set_rows(None);
        }
    }
}

/// The rules, with the word of the tick as an ordinary predicate, so that sessions draw no word of their own.
fn without_own_word(rules: &logicity_datalog::Rules) -> logicity_datalog::Rules {
    logicity_datalog::Rules {
        chance: None,
        ..rules.clone()
    }
}

proptest! {
    #![proptest_config(cases(24))]

    /// The frequencies of seeded runs are within their error of the exact probabilities, and estimates within their
    /// interval, at least nearly always.
    #[test]
    fn probabilities_are_frequencies(clauses in clauses(), bits in 0..256_u16) {
        const RUNS: u64 = 2_000;
        let facts = facts(bits);
        let program = program(&text(&clauses));
        let certain = vec![1.0; facts.len()];
        let exact = shown(&marginals(&program, &facts, &certain, MarginalOptions::default()));
        let mut session = program.session();
        encoded(&program, &facts).iter().for_each(|(id, row)| session.insert(*id, row).unwrap());
        let mut counts: BTreeMap<String, f64> = BTreeMap::new();
        for seed in 0..RUNS {
            session.set_seed(seed);
            session.commit().unwrap();
            count(&session, &mut counts);
        }
        counts.values_mut().for_each(|count| *count /= RUNS as f64);
        // Six standard deviations of a fair coin.
        close(&counts, &exact, 3.0 / (RUNS as f64).sqrt())?;
        let options = MarginalOptions { nodes_max: 0, samples: RUNS as u32, ..MarginalOptions::default() };
        let estimated = marginals(&program, &facts, &certain, options);
        if estimated.inexact().is_some() {
            prop_assert_eq!(estimated.inexact(), Some(Inexact::TooLarge));
            close(&shown(&estimated), &exact, 3.0 / (RUNS as f64).sqrt())?;
        }
    }
}

fn count(session: &Session, counts: &mut BTreeMap<String, f64>) {
    for name in DERIVED {
        let id = session.program().predicate(name).unwrap();
        for row in session.encoded_rows(id) {
            let row: Vec<&str> = row
                .iter()
                .map(|value| {
                    session
                        .symbols()
                        .resolve(logicity_datalog::symbol::Symbol(value.0))
                        .unwrap()
                })
                .collect();
            *counts.entry(format!("{name}{row:?}")).or_default() += 1.0;
        }
    }
}

/// The same draws whatever the order in which symbols are interned.
#[test]
fn draws_depend_on_the_text_of_symbols() {
    let source = ".decl n(x: symbol) .input n .decl a(x: symbol) 0.5 :: a(x) :- n(x).";
    let names: Vec<String> = (0..100).map(|number| format!("agent {number}")).collect();
    let drawn = |order: &mut dyn Iterator<Item = &String>| {
        let program = Program::parse(source).unwrap();
        let mut session = program.session();
        order.for_each(|name| session.insert("n", (name.as_str(),)).unwrap());
        session.commit().unwrap();
        let mut rows: Vec<String> = session
            .rows::<(&str,)>("a")
            .unwrap()
            .map(|(name,)| name.to_owned())
            .collect();
        rows.sort();
        rows
    };
    let forwards = drawn(&mut names.iter());
    assert_eq!(forwards, drawn(&mut names.iter().rev()));
    assert!((25..75).contains(&forwards.len()));
}

/// Facts of the source may have probabilities, too.
#[test]
fn facts_are_drawn() {
    let source = ".decl edge, path(x: symbol, y: symbol)
         0.6 :: edge(\"a\", \"b\").
         edge(\"b\", \"c\").
         0.1 :: edge(\"a\", \"c\").
         path(x, y) :- edge(x, y).
         path(x, z) :- path(x, y), edge(y, z).";
    let program = Program::parse(source).unwrap();
    let mut marginals = Marginals::new(&program, ["edge", "path"], MarginalOptions::default()).unwrap();
    marginals.compute(&Cancel::never()).unwrap();
    let p = |name, row: (&str, &str)| marginals.probability(name, row).unwrap().value;
    assert_eq!(
        [p("edge", ("a", "b")), p("edge", ("b", "c")), p("path", ("b", "c"))],
        [0.6, 1.0, 1.0]
    );
    assert!((p("path", ("a", "c")) - (1.0 - 0.4 * 0.9)).abs() < 1e-12);
    let mut session = program.session();
    let drawn = (0..2_000).filter(|seed| {
        session.set_seed(*seed);
        session.commit().unwrap();
        session.contains("edge", ("a", "b"))
    });
    assert!((1_100..1_300).contains(&drawn.count()));
}

/// A variable multiplies draws, `_` does not, and all heads of an alternative share the draw.
#[test]
fn draws_are_about_the_named_variables() {
    let source = ".decl n(x: symbol) .input n .decl e(x: symbol, y: symbol) .input e
         .decl a, b, c(x: symbol)
         0.5 :: a(x) :- e(x, y).
         0.5 :: b(x) :- e(x, _).
         0.5 :: c(x) :- e(x, _y).";
    let program = Program::parse(source).unwrap();
    let mut marginals = Marginals::new(&program, ["a", "b", "c"], MarginalOptions::default()).unwrap();
    for y in ["r", "s", "t"] {
        marginals.insert("e", ("q", y), 1.0).unwrap();
    }
    marginals.compute(&Cancel::never()).unwrap();
    let p = |name| marginals.probability(name, ("q",)).unwrap().value;
    assert_eq!([p("a"), p("b"), p("c")], [0.875, 0.5, 0.5]);
}

/// A long chain needs no deep recursion, and a formula that is too large becomes an estimate.
#[test]
fn large_formulas_are_estimated() {
    let program = Program::parse(
        ".decl e(x: number, y: number) .input e
         .decl r(x: number)
         r(0).
         r(y) :- r(x), e(x, y).",
    )
    .unwrap();
    let options = MarginalOptions {
        samples: 50,
        ..MarginalOptions::default()
    };
    let mut marginals = Marginals::new(&program, ["r"], options).unwrap();
    for x in 0..6_000 {
        marginals.insert("e", (x, x + 1), 0.999_9).unwrap();
    }
    marginals.compute(&Cancel::never()).unwrap();
    assert_eq!(marginals.inexact(), Some(Inexact::TooLarge));
    let last = marginals.probability("r", (1_000,)).unwrap();
    let (low, high) = last.interval.unwrap();
    assert!(low < last.value && last.value < high && low > 0.7, "{last:?}");
}

#[test]
fn aggregates_over_uncertain_rows_are_estimated() {
    let program = Program::parse(
        ".decl n(x: symbol) .input n
         .decl a(x: symbol)
         .decl k(m: number)
         0.5 :: a(x) :- n(x).
         k(m) :- m = count : { a(_) }.",
    )
    .unwrap();
    let mut marginals = Marginals::new(&program, ["k"], MarginalOptions::default()).unwrap();
    for x in ["r", "s"] {
        marginals.insert("n", (x,), 1.0).unwrap();
    }
    marginals.compute(&Cancel::never()).unwrap();
    assert!(matches!(marginals.inexact(), Some(Inexact::Aggregate(_))));
    for (count, expected) in [(0, 0.25), (1, 0.5), (2, 0.25)] {
        let found = marginals.probability("k", (count,)).unwrap();
        let (low, high) = found.interval.unwrap();
        assert!((low..=high).contains(&expected), "{count}: {found:?}");
    }
}

/// Comparisons regard draws as facts, the same for both sides if stream and probabilities are.
#[test]
fn draws_are_facts_in_comparisons() {
    const HEAD: &str = ".decl A(x: symbol)\n.input A\n.decl B(x: symbol)\n.decl C(x: symbol)\n.output B, C\n";
    let compared = |left: &str, right: &str| {
        let [left, right] =
            [left, right].map(|text| Program::parse(&format!("{HEAD}{text}\n")).unwrap().rules().clone());
        diff(&left, &right, &Options::default()).unwrap()
    };
    for (left, right) in [
        ("0.01 :: B(x) :- A(x).", "0.01 :: B(y) :- A(y)."),
        ("1.0 :: B(x) :- A(x).", "B(x) :- A(x)."),
    ] {
        let found = compared(left, right);
        assert!(
            matches!(found, Equivalence::Equivalent { .. }),
            "{left} | {right}: {found:?}"
        );
    }
    // What is never drawn, and two alternatives at once.
    for (left, right) in [
        ("0.0 :: B(x) :- A(x).", ""),
        (
            "0.3 :: B(x); 0.7 :: C(x) :- A(x).",
            "0.3 :: B(x); 0.7 :: C(x) :- A(x).\nB(y) :- A(y), B(x), C(x).",
        ),
    ] {
        let found = compared(left, right);
        assert!(
            !matches!(found, Equivalence::Different(_)),
            "{left} | {right}: {found:?}"
        );
    }
    for (left, right) in [
        ("0.01 :: B(x) :- A(x).", ""),
        ("0.99999 :: B(x) :- A(x).", "B(x) :- A(x)."),
        ("0.8 :: B(x) :- A(x).", "0.5 :: B(x) :- A(x)."),
        ("0.3 :: B(x); 0.7 :: C(x) :- A(x).", "0.3 :: B(x); 0.6 :: C(x) :- A(x)."),
        (
            "0.3 :: B(x); 0.7 :: C(x) :- A(x).",
            "0.3 :: B(x); 0.7 :: C(x) :- A(x).\nB(x) :- C(x).",
        ),
    ] {
        let Equivalence::Different(scene) = compared(left, right) else {
            panic!("{left} | {right}: no difference found");
        };
        assert_ne!(scene.derived[0], scene.derived[1]);
        assert_eq!(scene.entities.len(), 1, "{left} | {right}: {scene:?}");
    }
}
