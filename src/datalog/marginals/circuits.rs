//! Probabilities as functions of those of the facts, with gradients: for learning through rules.

use crate::cancel::Cancel;
use crate::check::{ClauseId, Past, PastOperator, PredicateId};
use crate::diagram::{DiagramCircuit, Formula, TooLarge};
use crate::eval::limits::EvalError;
use crate::marginals::facts::{FactRow, find_row};
use crate::marginals::formulas::{Algebra, Given, Source};
use crate::marginals::grounding::{Formulas, Inexact};
use crate::marginals::proofs::{Proof, TopProofs, literal};
use crate::marginals::{MarginalOptions, Marginals};
use crate::program::Program;
use crate::value::Value;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// How [`CircuitCompiler`] computes formulas.
#[derive(Clone, Debug, Default)]
pub struct CircuitOptions {
    /// The number of proofs to keep for each row. The probability is then a lower bound for rules without negation,
    /// else an approximation. `None` for exact probabilities.
    pub proofs: Option<usize>,
    /// The clauses with a weight, which is the probability that an instance of the clause counts, and its number.
    pub weights: BTreeMap<ClauseId, usize>,
    /// The limits; samples are not used.
    pub marginals: MarginalOptions,
}

/// The source of a variable of a [`ProbabilityCircuit`].
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum RandomVariable {
    /// A fact, in a tick that counts from 0.
    Fact {
        /// The tick.
        tick: usize,
        /// The predicate.
        predicate: PredicateId,
        /// The row.
        row: Box<[Value]>,
    },
    /// A draw of a clause; the bits of its probability, an `f64`.
    Draw(u64),
    /// That an instance of a clause counts: the number of the weight.
    Weight(usize),
}

/// A proof: variables that hold or fail, from which a row follows.
#[derive(Clone, Debug, PartialEq)]
pub struct FactProof {
    /// The probability that all of them do so.
    pub probability: f64,
    /// The variables, and whether they hold.
    pub literals: Vec<(RandomVariable, bool)>,
}

/// The formulas of rows over facts, some of them uncertain, in one tick or several.
pub struct CircuitCompiler {
    marginals: Marginals,
    /// The predicates of which the first one that a row is in is the decision.
    order: Vec<PredicateId>,
    proofs: Option<TopProofs>,
    /// Of proofs: the formulas of variables in the diagrams.
    variables: Vec<Formula>,
    sources: Vec<RandomVariable>,
    /// What temporal operators read in the present tick.
    given: HashMap<(PredicateId, FactRow), Formula>,
    /// By tick: the formulas of the rows that temporal operators read later.
    history: Vec<HashMap<(PredicateId, FactRow), Formula>>,
    formulas: Option<Formulas>,
    roots: Vec<Formula>,
}

/// Probabilities as a function of those of its variables.
#[derive(Clone, Debug)]
pub struct ProbabilityCircuit {
    circuit: DiagramCircuit,
    /// The variables that occur.
    pub variables: Vec<RandomVariable>,
}

impl CircuitCompiler {
    /// Prepares a program for the decisions by these predicates, in order of precedence, and for `others`.
    ///
    /// # Panics
    /// If the program lacks a predicate.
    pub fn new(program: &Program, order: &[PredicateId], others: &[PredicateId], options: &CircuitOptions) -> Self {
        let rules = program.rules();
        let read = rules.pasts.iter().flat_map(Past::operands);
        let mut queries: Vec<PredicateId> = order.iter().chain(others).copied().chain(read).collect();
        queries.sort_unstable();
        queries.dedup();
        let mut marginals = Marginals::new(program, queries, options.marginals).expect("predicates of the program");
        marginals.weights.clone_from(&options.weights);
        let steps = options.marginals.nodes_max as u64 * 64;
        CircuitCompiler {
            marginals,
            order: order.to_vec(),
            proofs: options.proofs.map(|k| TopProofs::new(k.max(1), steps)),
            variables: Vec::new(),
            sources: Vec::new(),
            given: HashMap::new(),
            history: Vec::new(),
            formulas: None,
            roots: Vec::new(),
        }
    }

    /// Returns the word for a symbol.
    pub fn intern(&mut self, text: &str) -> Value {
        self.marginals.intern(text)
    }

    /// Derives all instances of clauses over these symbols in advance, unless there are too many. Begin a new circuit after
    /// it.
    ///
    /// # Errors
    /// If the caller cancels it.
    pub fn preground(&mut self, inputs: &[PredicateId], symbols: &[Value], cancel: &Cancel) -> Result<(), EvalError> {
        self.marginals.preground(inputs, symbols, cancel)
    }

    /// Begins a new circuit, before its first tick.
    pub fn begin(&mut self) {
        self.marginals.clear();
        self.marginals.diagrams.clear();
        if let Some(proofs) = &mut self.proofs {
            proofs.clear();
        }
        self.variables.clear();
        self.sources.clear();
        self.given.clear();
        self.history.clear();
        self.roots.clear();
    }

    /// Adds a fact of the present tick. A fact with a probability above 0 and below 1 is a variable.
    ///
    /// # Panics
    /// If the row does not fit the predicate, or the probability is not from 0 to 1.
    pub fn insert(&mut self, predicate: PredicateId, row: &[Value], probability: f64) {
        let inserted = self.marginals.insert(predicate, row, probability);
        inserted.expect("the row fits the predicate");
    }

    /// Evaluates the present tick, and begins the next one. The circuit gets these outputs: for each ego, the
    /// probability of each decision and of none; then that of each predicate of the order; then that of each row.
    /// `weights` are those of the clauses.
    ///
    /// # Errors
    /// If the evaluation exceeds a limit, or the caller cancels it; the inner one if the formulas are too large, or an
    /// aggregate ranges over uncertain rows.
    pub fn tick(
        &mut self,
        egos: &[Value],
        rows: &[(PredicateId, Box<[Value]>)],
        weights: &[f64],
        cancel: &Cancel,
    ) -> Result<Result<(), Inexact>, EvalError> {
        let asked: Vec<&[Value]> = egos.iter().map(std::slice::from_ref).collect();
        let alone = rows.is_empty() && self.marginals.program.rules().pasts.is_empty();
        self.marginals.set_rows(alone.then_some(&asked));
        if let Err(TooLarge) = self.look_back() {
            return Ok(Err(Inexact::TooLarge));
        }
        self.marginals.prepare(cancel)?;
        let Marginals {
            grounding, diagrams, ..
        } = &mut self.marginals;
        let grounding = grounding.as_ref().expect("it is prepared");
        if let Some(inexact) = grounding.inexact {
            return Ok(Err(inexact));
        }
        let given = Given {
            formulas: &self.given,
            weights,
        };
        let mut sources = Vec::new();
        let found = match &mut self.proofs {
            Some(proofs) => grounding.formulas(given, proofs, &mut sources, cancel)?,
            None => grounding.formulas(given, diagrams, &mut sources, cancel)?,
        };
        let Ok(formulas) = found else {
            return Ok(Err(Inexact::TooLarge));
        };
        let tick = self.history.len();
        let session = &grounding.session;
        self.sources.extend(sources.into_iter().map(|source| match source {
            Source::Fact(predicate, at) => RandomVariable::Fact {
                tick,
                predicate,
                row: session.row(predicate, at as usize).into(),
            },
            Source::Draw(probability) => RandomVariable::Draw(probability.to_bits()),
            Source::Weight(number) => RandomVariable::Weight(number),
        }));
        self.formulas = Some(formulas);
        let added = self.add_roots(egos, rows);
        self.remember();
        self.marginals.clear();
        Ok(added.map_err(|TooLarge| Inexact::TooLarge))
    }

    /// Returns the circuit of all ticks since the last [`begin`](CircuitCompiler::begin).
    pub fn circuit(&self) -> ProbabilityCircuit {
        let circuit = self.marginals.diagrams.circuit(&self.roots);
        let variables = circuit.variables.iter();
        ProbabilityCircuit {
            variables: variables.map(|at| self.sources[*at as usize].clone()).collect(),
            circuit,
        }
    }

    /// Returns the most probable proofs that an ego decides by the predicate at a place of the order, or by none if the
    /// place is its length, in the last tick. Empty without [`CircuitOptions::proofs`].
    ///
    /// # Errors
    /// If the search takes too many steps.
    pub fn proofs(&mut self, ego: Value, place: usize) -> Result<Vec<FactProof>, Inexact> {
        let before: Vec<Formula> = self.order[..place.min(self.order.len())]
            .iter()
            .map(|predicate| self.formula(*predicate, &[ego]))
            .collect();
        let own = (self.order.get(place)).map_or(Formula::TRUE, |predicate| self.formula(*predicate, &[ego]));
        let Some(proofs) = &mut self.proofs else {
            return Ok(Vec::new());
        };
        let mut search = || {
            let mut all = own;
            for earlier in &before {
                all = proofs.and(all, earlier.not())?;
            }
            Ok(proofs.proofs(all)?.to_vec())
        };
        let found = search().map_err(|TooLarge| Inexact::TooLarge)?;
        let proof = |proof: Proof| FactProof {
            probability: proofs.probability(&proof),
            literals: (proof.iter())
                .map(|each| {
                    let (variable, holds) = literal(*each);
                    (self.sources[variable].clone(), holds)
                })
                .collect(),
        };
        Ok(found.into_iter().map(proof).collect())
    }

    /// Returns the formula of a row in the present tick.
    fn formula(&self, predicate: PredicateId, row: &[Value]) -> Formula {
        let grounding = self.marginals.grounding.as_ref().expect("it is prepared");
        match (&self.formulas, find_row(&grounding.session, predicate, row)) {
            (Some(formulas), Some(at)) => formulas.at(predicate, at as usize),
            _ => Formula::FALSE,
        }
    }

    fn add_roots(&mut self, egos: &[Value], rows: &[(PredicateId, Box<[Value]>)]) -> Result<(), TooLarge> {
        for ego in egos {
            let derived: Vec<Formula> = (self.order.iter())
                .map(|predicate| self.formula(*predicate, &[*ego]))
                .collect();
            let derived = self.in_diagrams(&derived)?;
            self.roots.extend(self.marginals.diagrams.firsts(&derived)?);
            self.roots.extend(derived);
        }
        let rows: Vec<Formula> = rows
            .iter()
            .map(|(predicate, row)| self.formula(*predicate, row))
            .collect();
        let rows = self.in_diagrams(&rows)?;
        self.roots.extend(rows);
        Ok(())
    }

    /// Returns the diagrams of formulas.
    fn in_diagrams(&mut self, formulas: &[Formula]) -> Result<Vec<Formula>, TooLarge> {
        let Some(proofs) = &mut self.proofs else {
            return Ok(formulas.to_vec());
        };
        let diagrams = &mut self.marginals.diagrams;
        while self.variables.len() < proofs.count() {
            let probability = proofs.of_variable(self.variables.len());
            self.variables.push(diagrams.variable(probability)?);
        }
        let mut found = Vec::with_capacity(formulas.len());
        for formula in formulas {
            let mut any = Formula::FALSE;
            for proof in proofs.proofs(*formula)? {
                let mut all = Formula::TRUE;
                for each in proof.iter().rev() {
                    let (variable, holds) = literal(*each);
                    let variable = self.variables[variable];
                    all = diagrams.and(if holds { variable } else { variable.not() }, all)?;
                }
                any = diagrams.or(any, all)?;
            }
            found.push(any);
        }
        Ok(found)
    }

    /// Keeps the formulas that temporal operators read later.
    fn remember(&mut self) {
        let mut kept = HashMap::new();
        let program = self.marginals.program.clone();
        let grounding = self.marginals.grounding.as_ref().expect("it is prepared");
        for operand in program.rules().pasts.iter().flat_map(Past::operands) {
            for row in grounding.session.encoded_rows(operand) {
                let formula = self.formula(operand, row);
                if formula != Formula::FALSE {
                    kept.insert((operand, FactRow::from(row)), formula);
                }
            }
        }
        self.history.push(kept);
    }

    /// Computes what temporal operators read in the present tick, as facts with formulas.
    fn look_back(&mut self) -> Result<(), TooLarge> {
        self.given.clear();
        let program = self.marginals.program.clone();
        for past in &program.rules().pasts {
            let known = self.history.iter().flat_map(HashMap::keys);
            let rows: BTreeSet<FactRow> = known
                .filter(|(operand, _)| *operand == past.operand)
                .map(|(_, row)| row.clone())
                .collect();
            for row in rows {
                let formula = match &mut self.proofs {
                    Some(proofs) => remembered(past, &row, &self.history, proofs)?,
                    None => remembered(past, &row, &self.history, &mut self.marginals.diagrams)?,
                };
                if formula == Formula::FALSE {
                    continue;
                }
                // The formula counts, not the probability.
                let inserted = self.marginals.insert(past.predicate, &row[..], 0.5);
                inserted.expect("rows of the operand");
                self.given.insert((past.predicate, row), formula);
            }
        }
        Ok(())
    }
}

/// Returns the formula of a row that a temporal operator reads in the tick after those of the history. Before the first
/// tick, no row held.
fn remembered<A: Algebra>(
    past: &Past,
    row: &FactRow,
    history: &[HashMap<(PredicateId, FactRow), Formula>],
    algebra: &mut A,
) -> Result<Formula, TooLarge> {
    let ago = |predicate: PredicateId, row: &FactRow, ticks: usize| match history.len().checked_sub(ticks) {
        Some(tick) => history[tick]
            .get(&(predicate, row.clone()))
            .copied()
            .unwrap_or(Formula::FALSE),
        None => Formula::FALSE,
    };
    let first = past.first as usize;
    let last = past.last.map_or(history.len(), |last| last as usize);
    let mut result = Formula::FALSE;
    match &past.operator {
        PastOperator::Once => {
            for ticks in first..=last.min(history.len()) {
                result = algebra.or(result, ago(past.operand, row, ticks))?;
            }
        }
        PastOperator::Always => {
            result = if last > history.len() || first > last {
                Formula::FALSE
            } else {
                Formula::TRUE
            };
            for ticks in first..=last.min(history.len()) {
                result = algebra.and(result, ago(past.operand, row, ticks))?;
            }
        }
        PastOperator::Since(predicate, columns) => {
            let held_row: FactRow = columns.iter().map(|column| row[*column]).collect();
            let mut held = Formula::TRUE;
            for ticks in 1..=last.min(history.len()) {
                if ticks >= first {
                    let since = algebra.and(ago(past.operand, row, ticks), held)?;
                    result = algebra.or(result, since)?;
                }
                held = algebra.and(held, ago(*predicate, &held_row, ticks))?;
            }
        }
    }
    Ok(result)
}

impl ProbabilityCircuit {
    /// Returns the number of nodes, the constant included.
    pub fn node_count(&self) -> usize {
        self.circuit.node_count()
    }

    /// Returns the outputs, given the probabilities of the variables.
    pub fn outputs(&self, probabilities: &[f64]) -> Vec<f64> {
        let values = self.circuit.values(probabilities);
        self.circuit.outputs(&values).collect()
    }

    /// Returns the derivatives by the variables of the sum of all outputs, each times its weight.
    pub fn gradient(&self, probabilities: &[f64], weights: &[f64]) -> Vec<f64> {
        let values = self.circuit.values(probabilities);
        self.circuit.gradient(probabilities, &values, weights)
    }
}
