//! Circuits of probabilities: against marginals, differences and the enumeration of worlds.

use crate::cases::cases;
use crate::chance::{SYMBOLS, Written, clauses, facts, marginals, text};
use crate::written_program::program;
use logicity_datalog::cancel::Cancel;
use logicity_datalog::{
    CircuitCompiler, CircuitOptions, ClauseId, Inexact, MarginalOptions, PredicateId, ProbabilityCircuit, Program,
    RandomVariable, Value, naive,
};
use proptest::collection::vec;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// The predicates of decisions, and the rows of which circuits have the probability.
const ORDER: [&str; 3] = ["d", "a", "b"];

/// A compiler of the decisions and of `c`.
fn compiler(program: &Program, options: &CircuitOptions) -> CircuitCompiler {
    let order = ORDER.map(|name| program.predicate(name).unwrap());
    CircuitCompiler::new(program, &order, &[program.predicate("c").unwrap()], options)
}

/// A compiler with the facts, and the circuit of the decisions of both symbols and of all rows of `c`.
fn compiled(
    program: &Program,
    facts: &[(&str, Vec<&str>)],
    probabilities: &[f64],
    (options, weights): (&CircuitOptions, &[f64]),
) -> (CircuitCompiler, Result<ProbabilityCircuit, Inexact>) {
    let mut compiler = compiler(program, options);
    let circuit = compiled_by(&mut compiler, program, (facts, probabilities), weights);
    (compiler, circuit)
}

/// The circuit that a compiler makes of the decisions of both symbols and of all rows of `c`.
fn compiled_by(
    compiler: &mut CircuitCompiler,
    program: &Program,
    (facts, probabilities): (&[(&str, Vec<&str>)], &[f64]),
    weights: &[f64],
) -> Result<ProbabilityCircuit, Inexact> {
    let c = program.predicate("c").unwrap();
    compiler.begin();
    for ((name, row), probability) in facts.iter().zip(probabilities) {
        let mut row: Vec<Value> = row.iter().map(|text| compiler.intern(text)).collect();
        if *name == "w" {
            row.push(Value::float(0.25));
        }
        compiler.insert(program.predicate(name).unwrap(), &row, *probability);
    }
    let egos = SYMBOLS.map(|text| compiler.intern(text));
    let pairs: Vec<(PredicateId, Box<[Value]>)> = egos
        .iter()
        .flat_map(|x| egos.map(|y| (c, Box::from([*x, y]))))
        .collect();
    let done = compiler.tick(&egos, &pairs, weights, &Cancel::never()).unwrap();
    done.map(|()| compiler.circuit())
}

/// The present probabilities of variables, given those of facts by row.
fn probabilities(
    circuit: &ProbabilityCircuit,
    of_facts: &BTreeMap<(PredicateId, Box<[Value]>), f64>,
    weights: &[f64],
) -> Vec<f64> {
    let of = |variable: &RandomVariable| match variable {
        RandomVariable::Fact { tick, predicate, row } => {
            assert_eq!(*tick, 0);
            of_facts[&(*predicate, row.clone())]
        }
        RandomVariable::Draw(bits) => f64::from_bits(*bits),
        RandomVariable::Weight(number) => weights[*number],
    };
    circuit.variables.iter().map(of).collect()
}

/// The probabilities of facts by row, with the words of a compiler.
fn by_row(
    program: &Program,
    compiler: &mut CircuitCompiler,
    facts: &[(&str, Vec<&str>)],
    probabilities: &[f64],
) -> BTreeMap<(PredicateId, Box<[Value]>), f64> {
    let mut rows = BTreeMap::new();
    for ((name, row), probability) in facts.iter().zip(probabilities) {
        let mut row: Vec<Value> = row.iter().map(|text| compiler.intern(text)).collect();
        if *name == "w" {
            row.push(Value::float(0.25));
        }
        rows.insert((program.predicate(name).unwrap(), row.into()), *probability);
    }
    rows
}

fn close(one: &[f64], other: &[f64]) -> Result<(), TestCaseError> {
    prop_assert_eq!(one.len(), other.len());
    for (at, (one, other)) in one.iter().zip(other).enumerate() {
        prop_assert!((one - other).abs() < 1e-9, "{at}: {one} and {other}");
    }
    Ok(())
}

/// What `compiled` gives, from marginals.
fn expected(program: &Program, facts: &[(&str, Vec<&str>)], probabilities: &[f64]) -> Vec<f64> {
    let mut known = marginals(program, facts, probabilities, MarginalOptions::default());
    known.set_order(ORDER).unwrap();
    known.compute(&Cancel::never()).unwrap();
    let mut expected = Vec::new();
    for ego in SYMBOLS {
        let word = known.intern(ego);
        expected.extend(known.first(&[word]).iter().map(|each| each.value));
        expected.extend(ORDER.map(|name| known.probability(name, (ego,)).map_or(0.0, |each| each.value)));
    }
    for x in SYMBOLS {
        expected.extend(SYMBOLS.map(|y| known.probability("c", (x, y)).map_or(0.0, |each| each.value)));
    }
    expected
}

fn uncertain() -> impl Strategy<Value = Vec<f64>> {
    vec(prop::sample::select(vec![1.0, 0.4, 0.75, 0.1]), 8)
}

proptest! {
    #![proptest_config(cases(200))]

    #[test]
    fn circuits_are_marginals(clauses in clauses(), bits in 0..256_u16, uncertain in uncertain()) {
        let facts = facts(bits);
        let program = program(&text(&clauses));
        let expected = expected(&program, &facts, &uncertain);
        let exact = CircuitOptions::default();
        let (mut compiler, circuit) = compiled(&program, &facts, &uncertain, (&exact, &[]));
        let circuit = circuit.unwrap();
        let given = by_row(&program, &mut compiler, &facts, &uncertain);
        let at = probabilities(&circuit, &given, &[]);
        close(&circuit.outputs(&at), &expected)?;
        // Outputs are linear in each variable, so a difference is the derivative.
        let weights: Vec<f64> = (0..expected.len()).map(|at| 0.5 + at as f64).collect();
        let sum = |at: &[f64]| circuit.outputs(at).iter().zip(&weights).map(|(p, weight)| p * weight).sum::<f64>();
        let gradient = circuit.gradient(&at, &weights);
        for (place, derivative) in gradient.iter().enumerate() {
            let [mut low, mut high] = [at.clone(), at.clone()];
            (low[place], high[place]) = (0.0, 1.0);
            prop_assert!((sum(&high) - sum(&low) - derivative).abs() < 1e-9);
        }
        // All proofs give the same, and the decision has the probability of its proofs.
        let every = CircuitOptions { proofs: Some(100_000), ..CircuitOptions::default() };
        let (mut compiler, circuit) = compiled(&program, &facts, &uncertain, (&every, &[]));
        let circuit = circuit.unwrap();
        let at = probabilities(&circuit, &given, &[]);
        close(&circuit.outputs(&at), &expected)?;
        let ego = compiler.intern(SYMBOLS[0]);
        for (place, expected) in expected[..=ORDER.len()].iter().enumerate() {
            let proofs = compiler.proofs(ego, place).unwrap();
            let most = proofs.iter().map(|proof| proof.probability).fold(0.0, f64::max);
            let sum: f64 = proofs.iter().map(|proof| proof.probability).sum();
            prop_assert!(most <= expected + 1e-9 && *expected <= sum + 1e-9);
            prop_assert!(proofs.windows(2).all(|pair| pair[0].probability >= pair[1].probability));
        }
    }

    /// Instances that are derived in advance change no probability, in one scene after another.
    #[test]
    fn grounding_in_advance_changes_nothing(clauses in clauses(), scenes in vec((0..256_u16, uncertain()), 3)) {
        let program = program(&text(&clauses));
        let mut compiler = compiler(&program, &CircuitOptions::default());
        let symbols = SYMBOLS.map(|text| compiler.intern(text));
        let inputs = ["n", "e", "w"].map(|name| program.predicate(name).unwrap());
        compiler.preground(&inputs, &symbols, &Cancel::never()).unwrap();
        for (bits, uncertain) in scenes {
            let facts = facts(bits);
            let circuit = compiled_by(&mut compiler, &program, (&facts, &uncertain), &[]).unwrap();
            let given = by_row(&program, &mut compiler, &facts, &uncertain);
            let outputs = circuit.outputs(&probabilities(&circuit, &given, &[]));
            close(&outputs, &expected(&program, &facts, &uncertain))?;
        }
    }

    /// A weight is a probability before the clause.
    #[test]
    fn weights_are_probabilities_of_clauses(clauses in clauses(), bits in 0..256_u16, uncertain in uncertain()) {
        // `_` takes no part in a draw, but instances differ in it. Each alternative of a body has a weight of its own.
        let is_plain = |clause: &Written| !clause.text().contains(['_', ';']) || clause.heads.len() > 1;
        let clauses: Vec<Written> = clauses.into_iter().filter(is_plain).collect();
        let weighted = |clause: &Written| clause.heads.len() == 1 && clause.heads[0].0.is_none();
        let drawn: Vec<Written> = (clauses.iter().cloned())
            .map(|mut clause| {
                if weighted(&clause) {
                    clause.heads[0].0 = Some("0.3");
                }
                clause
            })
            .collect();
        let facts = facts(bits);
        let expected = expected(&program(&text(&drawn)), &facts, &uncertain);
        let program = program(&text(&clauses));
        let weights: BTreeMap<ClauseId, usize> = (program.rules().clauses.iter().enumerate())
            .filter(|(_, clause)| !clause.body.is_empty() && program.rules().draw(clause).is_none())
            .filter(|(_, clause)| !program.rules().predicates[clause.head.predicate.index()].hidden)
            .map(|(at, _)| (ClauseId(at as u32), 0))
            .collect();
        let options = CircuitOptions { weights, ..CircuitOptions::default() };
        let (mut compiler, circuit) = compiled(&program, &facts, &uncertain, (&options, &[0.3]));
        let circuit = circuit.unwrap();
        let given = by_row(&program, &mut compiler, &facts, &uncertain);
        close(&circuit.outputs(&probabilities(&circuit, &given, &[0.3])), &expected)?;
    }

    /// Ticks with uncertain facts, against all their worlds.
    #[test]
    fn circuits_remember(
        body in prop::sample::select(vec![
            "once[1,2] n(x)", "previous n(x), not n(x)", "historically[0,1] n(x)", "n(x) since[0,2] m(x)",
            "n(x) since m(x), not previous m(x)", "for[2] n(x), once m(x)", "once[1,1] q(x)", "not once[1,3] q(x), n(x)",
        ]),
        uncertain in vec(vec(prop::sample::select(vec![0.0, 1.0, 0.3, 0.8]), 2), 1..4),
        proofs in prop::sample::select(vec![None, Some(1000)]),
    ) {
        let program = program(&format!(
            ".decl n, m(x: symbol) .input n .input m
             .decl q, r(x: symbol)
             q(x) :- n(x), not m(x).
             r(x) :- m(x), {body}.
             r(x) :- n(x), {body}."
        ));
        let [n, m, r] = ["n", "m", "r"].map(|name| program.predicate(name).unwrap());
        let options = CircuitOptions { proofs, ..CircuitOptions::default() };
        let mut compiler = CircuitCompiler::new(&program, &[r], &[], &options);
        compiler.begin();
        let u = compiler.intern("u");
        for tick in &uncertain {
            for (predicate, probability) in [n, m].into_iter().zip(tick) {
                if *probability > 0.0 {
                    compiler.insert(predicate, &[u], *probability);
                }
            }
            compiler.tick(&[u], &[], &[], &Cancel::never()).unwrap().unwrap();
        }
        let circuit = compiler.circuit();
        let at: Vec<f64> = (circuit.variables.iter())
            .map(|variable| match variable {
                RandomVariable::Fact { tick, predicate, .. } => uncertain[*tick][usize::from(*predicate == m)],
                other => panic!("{other:?}"),
            })
            .collect();
        let found = circuit.outputs(&at);
        let symbols = &program.rules().symbols;
        let word = Value(symbols.intern("u").0);
        let all: Vec<f64> = uncertain.iter().flatten().copied().collect();
        let mut expected = vec![0.0; uncertain.len()];
        for world in 0..1_usize << all.len() {
            let holds = |at: usize| world >> at & 1 == 1;
            let weight = |at: usize| if holds(at) { all[at] } else { 1.0 - all[at] };
            let weight: f64 = (0..all.len()).map(weight).product();
            let ticks = (0..uncertain.len()).map(|tick| {
                let rows = [n, m].into_iter().enumerate().filter(|(at, _)| holds(2 * tick + at));
                rows.map(|(_, predicate)| (predicate, vec![word])).collect::<Vec<_>>()
            });
            for (tick, database) in naive::evaluate_ticks(program.rules(), symbols, ticks).iter().enumerate() {
                if database[r.index()].contains(&vec![word]) {
                    expected[tick] += weight;
                }
            }
        }
        let first: Vec<f64> = found.chunks(3).map(|each| each[0]).collect();
        close(&first, &expected)?;
    }
}

#[test]
fn few_proofs_are_a_lower_bound() {
    let program = program(
        ".decl n(x: symbol, y: symbol) .input n
         .decl c(x: symbol, y: symbol) .decl d, a, b(x: symbol)
         d(x) :- n(x, _).",
    );
    let all: Vec<(&str, Vec<&str>)> = vec![("n", vec!["u", "u"]), ("n", vec!["u", "v"])];
    let at = |proofs| {
        let options = CircuitOptions {
            proofs,
            ..CircuitOptions::default()
        };
        let (_, circuit) = compiled(&program, &all, &[0.5, 0.8], (&options, &[]));
        let circuit = circuit.unwrap();
        let of = |variable: &RandomVariable| match variable {
            RandomVariable::Fact { row, .. } if row[0] == row[1] => 0.5,
            _ => 0.8,
        };
        let given: Vec<f64> = circuit.variables.iter().map(of).collect();
        circuit.outputs(&given)[0]
    };
    assert!((at(Some(1)) - 0.8).abs() < 1e-12);
    assert!((at(Some(2)) - 0.9).abs() < 1e-12);
    assert!((at(None) - 0.9).abs() < 1e-12);
}

#[test]
fn large_circuits_and_uncertain_aggregates_are_refused() {
    let rules = |body: &str| {
        program(&format!(
            ".decl n(x: symbol) .input n .decl e(x: symbol, y: symbol) .input e .decl w(x: symbol, p: float) .input w
             .decl c(x: symbol, y: symbol) .decl d, a, b(x: symbol)
             d(x) :- {body}."
        ))
    };
    let facts = facts(0b0011_1111);
    let small = CircuitOptions {
        marginals: MarginalOptions {
            nodes_max: 3,
            ..MarginalOptions::default()
        },
        ..CircuitOptions::default()
    };
    let (_, circuit) = compiled(&rules("e(x, y), n(x), n(y)"), &facts, &[0.5; 6], (&small, &[]));
    assert_eq!(circuit.unwrap_err(), Inexact::TooLarge);
    let counted = rules("n(x), count : { e(x, _) } > 1");
    let (_, circuit) = compiled(&counted, &facts, &[0.5; 6], (&CircuitOptions::default(), &[]));
    assert!(matches!(circuit.unwrap_err(), Inexact::Aggregate(_)));
}
