//! Exact probabilities of rows, for clauses with probabilities and for uncertain facts.
//!
//! The semantics is that of Sato's distribution semantics, as in ProbLog: each draw and each uncertain fact is an
//! independent random variable, and a row has the probability of the worlds in which it follows.
//!
//! ```text
//! 0.8 :: Slow(x) :- Near(x, y), Not(Bus(x)).
//! becomes
//! instance(x, y) :- Near(x, y).                       a session derives which instances there may be
//! Slow(x) :- instance(x, y).
//! Slow("a") = Near("a", "b") and draw("a", "b") and not Bus("a")    its formula, from each instance
//! ```
//!
//! Facts about symbols, if they are few or the instances are derived in advance, count as uncertain too, with the formulas
//! "true" and "false". So the session need not derive anew what there may be in another scene of the same entities.
//!
//! Formulas are decision diagrams. Where they grow too large, or where an aggregate counts uncertain rows, the result is
//! an estimate from sampled worlds, with an interval.

mod circuits;
mod facts;
mod formulas;
mod grounding;
mod proofs;

pub use circuits::{CircuitCompiler, CircuitOptions, FactProof, ProbabilityCircuit, RandomVariable};
pub use grounding::Inexact;

use crate::cancel::Cancel;
use crate::chance;
use crate::check::{Clause, ClauseId, Literal, PredicateId, Term};
use crate::convert::{AsPredicate, IntoRow, RowError, check_words, words_of};
use crate::diagram::{Diagrams, NODE_BYTES, TooLarge};
use crate::eval::limits::{EvalError, Limits};
use crate::marginals::facts::{AskedRows, FactRow, FactTables, asked_rows};
use crate::marginals::formulas::{Given, Source};
use crate::marginals::grounding::{Grounding, LIFTED_MAX, liftable};
use crate::program::Program;
use crate::session::Session;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use crate::value::{Value, symbol_hash};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// How marginals are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MarginalOptions {
    /// The maximum number of nodes of decision diagrams. Beyond it, probabilities are estimated.
    pub nodes_max: usize,
    /// The number of worlds for estimates, at least 1.
    pub samples: u32,
    /// The seed of these worlds.
    pub seed: u64,
    /// The limits of evaluation.
    pub limits: Limits,
}

impl Default for MarginalOptions {
    /// A million nodes, 10,000 samples, seed 0, and the default limits.
    fn default() -> Self {
        MarginalOptions {
            nodes_max: 1 << 20,
            samples: 10_000,
            seed: 0,
            limits: Limits::default(),
        }
    }
}

/// The probability of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probability {
    /// The probability, or its estimate.
    pub value: f64,
    /// For an estimate, the ends of its 95 % interval by Wilson's score (1927).
    pub interval: Option<(f64, f64)>,
}

/// The maximum number of instances of clauses, and of rows of an input, to derive in advance.
const PREGROUND_MAX: usize = 1 << 14;

/// The rows of a predicate, sorted, with their probabilities.
type Marginal = Vec<(Box<[Value]>, Probability)>;

/// Facts, some of them uncertain, and the probabilities of what follows from them.
///
/// ```
/// # use logicity_datalog::cancel::Cancel;
/// # use logicity_datalog::{MarginalOptions, Marginals, Program};
/// let program = Program::parse(
///     ".decl road(x: symbol, y: symbol) .input road
///      .decl path(x: symbol, y: symbol)
///      0.9 :: path(x, y) :- road(x, y).
///      path(x, z) :- path(x, y), path(y, z).",
/// )?;
/// let mut marginals = Marginals::new(&program, ["path"], MarginalOptions::default())?;
/// marginals.insert("road", ("a", "b"), 0.5)?;
/// marginals.insert("road", ("b", "c"), 1.0)?;
/// marginals.compute(&Cancel::never())?;
/// let path = marginals.probability("path", ("a", "c")).unwrap();
/// assert!((path.value - 0.5 * 0.9 * 0.9).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Marginals {
    program: Program,
    queries: Vec<PredicateId>,
    options: MarginalOptions,
    facts: FactTables,
    /// The input predicates that had an uncertain fact. The grounding treats them as uncertain, or lifts them.
    uncertain: BTreeSet<PredicateId>,
    /// The number of rows that [`preground`](Marginals::preground) has made known.
    pregrounded: usize,
    grounding: Option<Grounding>,
    diagrams: Diagrams,
    /// What the variables of the diagrams stand for.
    sources: Vec<Source>,
    symbols: Symbols,
    results: Vec<(PredicateId, Marginal)>,
    /// See [`Marginals::set_order`].
    order: Vec<PredicateId>,
    /// See [`Marginals::set_rows`].
    asked: Option<AskedRows>,
    /// The weights of clauses, which only [`CircuitCompiler`] has.
    weights: BTreeMap<ClauseId, usize>,
    /// For each row of a predicate of the order, the probability that each is the first one.
    firsts: BTreeMap<Box<[Value]>, Vec<Probability>>,
    inexact: Option<Inexact>,
}

impl Marginals {
    /// Creates marginals of these predicates, without facts.
    ///
    /// # Errors
    /// If the program has no such predicate.
    pub fn new<P: AsPredicate>(
        program: &Program,
        queries: impl IntoIterator<Item = P>,
        options: MarginalOptions,
    ) -> Result<Marginals, RowError> {
        let queries = queries
            .into_iter()
            .map(|predicate| predicate.resolve(program.rules()).map(|(id, _)| id));
        let nodes_max = usize::try_from(options.limits.bytes / 4 / NODE_BYTES).unwrap_or(usize::MAX);
        Ok(Marginals {
            queries: queries.collect::<Result<_, _>>()?,
            facts: FactTables::new(program.rules().predicates.len()),
            uncertain: BTreeSet::new(),
            pregrounded: 0,
            grounding: None,
            diagrams: Diagrams::new(options.nodes_max.min(nodes_max)),
            sources: Vec::new(),
            symbols: program.rules().symbols.clone(),
            results: Vec::new(),
            order: Vec::new(),
            asked: None,
            weights: BTreeMap::new(),
            firsts: BTreeMap::new(),
            inexact: None,
            program: program.clone(),
            options,
        })
    }

    /// Creates marginals of these predicates for the committed facts of a session, all of them certain, with its limits.
    ///
    /// ```
    /// # use logicity_datalog::cancel::Cancel;
    /// # use logicity_datalog::{MarginalOptions, Marginals, Program};
    /// let program = Program::parse(
    ///     ".decl coin(x: symbol) .input coin
    ///      .decl heads(x: symbol)
    ///      0.5 :: heads(x) :- coin(x).",
    /// )?;
    /// let mut session = program.session();
    /// session.insert("coin", ("penny",))?;
    /// session.commit()?;
    /// let mut marginals = Marginals::of_session(&session, ["heads"], MarginalOptions::default())?;
    /// marginals.compute(&Cancel::never())?;
    /// assert_eq!(marginals.probability("heads", ("penny",)).unwrap().value, 0.5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`new`](Marginals::new).
    pub fn of_session<P: AsPredicate>(
        session: &Session,
        queries: impl IntoIterator<Item = P>,
        options: MarginalOptions,
    ) -> Result<Marginals, RowError> {
        let options = MarginalOptions {
            limits: session.limits(),
            ..options
        };
        let program = session.program();
        let mut marginals = Marginals::new(program, queries, options)?;
        marginals.symbols = session.symbols().clone();
        let rules = program.rules();
        for (id, predicate) in (0..).map(PredicateId).zip(&rules.predicates) {
            let given = predicate.edb.or((!predicate.derived).then_some(id));
            let given = given.filter(|given| Some(*given) != rules.chance);
            for row in given.into_iter().flat_map(|given| session.encoded_rows(given)) {
                marginals.insert(id, row, 1.0)?;
            }
        }
        Ok(marginals)
    }

    /// Sets an order of precedence among predicates of the same columns: [`first`](Marginals::first) returns which of
    /// them is the first one that a row is in. They must be among the queries.
    ///
    /// # Errors
    /// If the program has no such predicate.
    pub fn set_order<P: AsPredicate>(&mut self, order: impl IntoIterator<Item = P>) -> Result<(), RowError> {
        let order = order.into_iter();
        let order = order.map(|predicate| predicate.resolve(self.program.rules()).map(|(id, _)| id));
        self.order = order.collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Restricts the results to these rows of the queried predicates, which need less work; `None` stands for all rows.
    pub fn set_rows(&mut self, rows: Option<&[&[Value]]>) {
        let rows = rows.map(|rows| rows.iter().map(|row| (*row).into()).collect());
        if rows != self.asked {
            self.asked = rows;
            self.grounding.iter_mut().for_each(|grounding| grounding.needed = None);
        }
    }

    /// Returns the word for a symbol, for use in rows of facts.
    pub fn intern(&mut self, text: &str) -> Value {
        Value(self.symbols.intern(text).0)
    }

    /// Sets the limits of evaluation.
    pub fn set_limits(&mut self, limits: Limits) {
        self.options.limits = limits;
        if let Some(grounding) = &mut self.grounding {
            grounding.session.set_limits(limits);
        }
    }

    /// Adds a fact that holds with a probability from 0 to 1, or changes its probability.
    ///
    /// # Errors
    /// As [`Session::insert`], and if the probability is none.
    pub fn insert(&mut self, predicate: impl AsPredicate, row: impl IntoRow, probability: f64) -> Result<(), RowError> {
        let (to, words) = self.encoded(predicate, &row)?;
        self.add(to, words, probability)
    }

    /// Variant of [`insert`](Marginals::insert) for many rows of words, each with its probability. On an error, the rows
    /// before the invalid one stay added.
    ///
    /// # Errors
    /// As [`insert`](Marginals::insert).
    pub fn insert_all<R: AsRef<[Value]>>(
        &mut self,
        predicate: impl AsPredicate,
        rows: impl IntoIterator<Item = (R, f64)>,
    ) -> Result<(), RowError> {
        let program = self.program.clone();
        let (predicate, to) = program.base(predicate)?;
        for (row, probability) in rows {
            check_words(predicate, row.as_ref(), &self.symbols)?;
            self.add(to, FactRow::from_slice(row.as_ref()), probability)?;
        }
        Ok(())
    }

    fn add(&mut self, to: PredicateId, words: FactRow, probability: f64) -> Result<(), RowError> {
        if !(0.0..=1.0).contains(&probability) {
            let predicate = self.program.rules().predicates[to.index()].name.clone();
            let found = probability.to_string();
            return Err(RowError::Probability { predicate, found });
        }
        if probability < 1.0 && self.uncertain.insert(to) {
            // Where its facts count as uncertain anyway, the grounding stays the same.
            self.grounding = self.grounding.take().filter(|known| known.is_lifted[to.index()]);
        }
        self.note(to, &words, true);
        self.facts.insert(to, words, probability);
        Ok(())
    }

    /// Removes all facts, and derives all instances of clauses over these symbols, so that scenes about them need no
    /// evaluation. Skips inputs with more than [`PREGROUND_MAX`] rows. Does nothing more if the clauses may have more
    /// instances than that, or if clauses of a recursive stratum draw or have weights: each instance is then a variable.
    ///
    /// # Errors
    /// If the caller cancels it.
    fn preground(&mut self, inputs: &[PredicateId], symbols: &[Value], cancel: &Cancel) -> Result<(), EvalError> {
        self.clear();
        self.pregrounded = 0;
        let rules = self.program.rules();
        let combinations = |columns: usize| symbols.len().saturating_pow(columns as u32);
        let instances = rules.clauses.iter().map(|clause| combinations(columns(clause)));
        let draws = |clause: &ClauseId| {
            self.weights.contains_key(clause) || rules.draw(&rules.clauses[clause.index()]).is_some()
        };
        let mut recursive = rules.strata.iter().filter(|stratum| stratum.recursive);
        if instances.fold(0, usize::saturating_add) > PREGROUND_MAX
            || recursive.any(|stratum| stratum.clauses.iter().any(draws))
        {
            return Ok(());
        }
        let liftable = liftable(rules);
        let mut rows: Vec<(PredicateId, FactRow)> = Vec::new();
        for input in inputs {
            let predicate = &rules.predicates[input.index()];
            let to = predicate.edb.unwrap_or(*input);
            if !liftable.contains(&to) || combinations(predicate.arity()) > PREGROUND_MAX {
                continue;
            }
            for place in 0..combinations(predicate.arity()) {
                let column = |column: usize| symbols[place / combinations(column) % symbols.len()];
                rows.push((to, (0..predicate.arity()).rev().map(column).collect()));
            }
        }
        self.pregrounded = rows.len();
        for (to, row) in rows {
            self.note(to, &row, true);
            self.facts.insert(to, row, 1.0);
        }
        let prepared = self.prepare(cancel);
        self.clear();
        let Err(error) = prepared else { return Ok(()) };
        // The session would keep these rows, and scenes need only some of them.
        (self.grounding, self.pregrounded) = (None, 0);
        match error {
            EvalError::Cancelled { .. } => Err(error),
            _ => Ok(()),
        }
    }

    /// Removes a fact.
    ///
    /// # Errors
    /// As [`Session::insert`].
    pub fn retract(&mut self, predicate: impl AsPredicate, row: impl IntoRow) -> Result<(), RowError> {
        let (to, words) = self.encoded(predicate, &row)?;
        self.note(to, &words, false);
        self.facts.remove(to, &words);
        Ok(())
    }

    /// Removes all facts.
    pub fn clear(&mut self) {
        if let Some(grounding) = &mut self.grounding {
            for (to, words, _) in self.facts.iter() {
                grounding.note(to, words, false);
            }
        }
        self.facts.clear();
    }

    fn note(&mut self, to: PredicateId, words: &[Value], holds: bool) {
        if let Some(grounding) = &mut self.grounding {
            grounding.note(to, words, holds);
        }
    }

    fn encoded(&self, predicate: impl AsPredicate, row: &impl IntoRow) -> Result<(PredicateId, FactRow), RowError> {
        let (predicate, to) = self.program.base(predicate)?;
        let (types, mut encoded) = (&self.program.rules().types, Vec::new());
        let words = words_of(predicate, row, types, &self.symbols.encoder(), &mut encoded)?;
        check_words(predicate, words, &self.symbols)?;
        Ok((to, words.into()))
    }

    /// Computes the probabilities for the present facts. A pure function of the facts and the options.
    ///
    /// # Errors
    /// If the evaluation exceeds a limit, or the caller cancels it. The facts stay as they are.
    pub fn compute(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        (self.inexact, self.results, self.firsts) = (None, Vec::new(), BTreeMap::new());
        self.prepare(cancel)?;
        let grounding = self.grounding.as_ref().expect("it is prepared");
        let exact = match grounding.inexact {
            Some(inexact) => Err(inexact),
            None => {
                self.diagrams.clear();
                self.sources.clear();
                let given = Given {
                    formulas: &HashMap::new(),
                    weights: &[],
                };
                let formulas = grounding.formulas(given, &mut self.diagrams, &mut self.sources, cancel)?;
                let asked = self.asked.as_ref();
                let firsts = formulas.and_then(|formulas| {
                    let firsts = grounding.firsts((&self.order, asked), &formulas, &mut self.diagrams)?;
                    Ok((formulas, firsts))
                });
                firsts.map_err(|TooLarge| Inexact::TooLarge)
            }
        };
        match exact {
            Ok((formulas, firsts)) => {
                let exact = |value| Probability { value, interval: None };
                let firsts = firsts.into_iter();
                self.firsts = firsts
                    .map(|(row, each)| (row, each.into_iter().map(exact).collect()))
                    .collect();
                let of = |predicate: PredicateId| {
                    let rows = asked_rows(&grounding.session, predicate, self.asked.as_ref());
                    let row = |(at, row): (usize, &[Value])| {
                        let value = self.diagrams.probability(formulas.at(predicate, at));
                        let interval = None;
                        (value > 0.0).then(|| (row.into(), Probability { value, interval }))
                    };
                    (predicate, rows.into_iter().filter_map(row).collect())
                };
                self.results = self.queries.iter().map(|predicate| of(*predicate)).collect();
                if self.symbols.len() < grounding.session.symbols().len() {
                    self.symbols = grounding.session.symbols().clone();
                }
            }
            Err(inexact) => {
                self.inexact = Some(inexact);
                self.sample(cancel)?;
            }
        }
        Ok(())
    }

    /// Derives what there may be, given the present facts, and finds what the queries depend on.
    fn prepare(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        self.facts.sort();
        // Earlier scenes may have left many rows.
        let kept = self.pregrounded + 4 * self.facts.len() + LIFTED_MAX;
        self.grounding = self.grounding.take().filter(|known| known.lifted_rows <= kept);
        let grounding = match &mut self.grounding {
            Some(grounding) => grounding,
            None => {
                let lifted = match self.facts.len() <= LIFTED_MAX.max(self.pregrounded) {
                    true => liftable(self.program.rules()),
                    false => BTreeSet::new(),
                };
                let sets = (&self.uncertain, lifted);
                let mut grounding = Grounding::new(&self.program, sets, &self.queries, &self.weights, &self.symbols);
                grounding.session.set_limits(self.options.limits);
                for (to, words, _) in self.facts.iter() {
                    grounding.note(to, words, true);
                }
                self.grounding.insert(grounding)
            }
        };
        if grounding.inexact.is_none() {
            if grounding.session.symbols().len() < self.symbols.len() {
                grounding.session.set_symbols(self.symbols.clone());
            }
            grounding.update(&self.facts, cancel)?;
            grounding.find_needed(&self.queries, self.asked.as_ref());
        }
        Ok(())
    }

    /// Estimates the probabilities from sampled worlds.
    fn sample(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        let mut session = self.program.session_with(self.symbols.clone());
        session.set_limits(self.options.limits);
        let samples = self.options.samples.max(1);
        let mut counts: Vec<BTreeMap<Box<[Value]>, u32>> = vec![BTreeMap::new(); self.queries.len()];
        for (to, words, _) in self.facts.iter() {
            session.change_row(to, words, true);
        }
        let is_asked = |row: &[Value]| self.asked.as_ref().is_none_or(|asked| asked.contains(row));
        let mut firsts: BTreeMap<Box<[Value]>, Vec<u32>> = BTreeMap::new();
        let streams: Vec<u64> = (self.program.rules().predicates.iter())
            .map(|predicate| chance::stream(&predicate.name))
            .collect();
        for sample in 0..samples {
            let word = chance::word(self.options.seed, u64::from(sample));
            session.set_chance(word);
            for (to, words, probability) in self.facts.iter().filter(|(.., probability)| *probability < 1.0) {
                let draw = chance::Draw::new(word, streams[to.index()]);
                let columns = self.program.rules().predicates[to.index()].columns.iter();
                let draw = columns
                    .zip(words)
                    .fold(draw, |draw, (column, value)| match column.base {
                        BaseType::Symbol | BaseType::Record => draw.symbol(symbol_hash(*value, &self.symbols)),
                        _ => draw.value(value.0),
                    });
                session.change_row(to, words, draw.number() < probability);
            }
            session.commit_with(cancel)?;
            for (predicate, counts) in self.queries.iter().zip(&mut counts) {
                for row in session.encoded_rows(*predicate).filter(|row| is_asked(row)) {
                    match counts.get_mut(row) {
                        Some(count) => *count += 1,
                        None => _ = counts.insert(row.into(), 1),
                    }
                }
            }
            let mut taken: BTreeSet<&[Value]> = BTreeSet::new();
            for (place, predicate) in self.order.iter().enumerate() {
                let rows = session.encoded_rows(*predicate).filter(|row| is_asked(row));
                for row in rows.filter(|row| taken.insert(row)) {
                    let counts = firsts.entry(row.into()).or_insert_with(|| vec![0; self.order.len()]);
                    counts[place] += 1;
                }
            }
        }
        let of = |(predicate, counts): (&PredicateId, BTreeMap<Box<[Value]>, u32>)| {
            let row = |(row, count)| (row, Probability::estimated(count, samples));
            (*predicate, counts.into_iter().map(row).collect())
        };
        self.results = self.queries.iter().zip(counts).map(of).collect();
        let of = |(row, mut counts): (Box<[Value]>, Vec<u32>)| {
            counts.push(samples - counts.iter().sum::<u32>());
            let each = counts.into_iter().map(|count| Probability::estimated(count, samples));
            (row, each.collect())
        };
        self.firsts = firsts.into_iter().map(of).collect();
        self.symbols = session.symbols().clone();
        Ok(())
    }

    /// Returns why the last computed probabilities are estimates; `None` if they are exact.
    pub fn inexact(&self) -> Option<Inexact> {
        self.inexact
    }

    /// Returns the rows of a queried predicate with a positive probability, in the order of their words.
    pub fn rows(&self, predicate: impl AsPredicate) -> impl Iterator<Item = (&[Value], Probability)> {
        let id = predicate.resolve(self.program.rules()).ok().map(|(id, _)| id);
        let found = self.results.iter().find(|(predicate, _)| Some(*predicate) == id);
        found
            .into_iter()
            .flat_map(|(_, rows)| rows)
            .map(|(row, probability)| (&**row, *probability))
    }

    /// Returns the probability of a row of a queried predicate; `None` if it cannot follow.
    pub fn probability(&self, predicate: impl AsPredicate, row: impl IntoRow) -> Option<Probability> {
        let (id, declared) = predicate.resolve(self.program.rules()).ok()?;
        let (types, mut encoded) = (&self.program.rules().types, Vec::new());
        let words = words_of(declared, &row, types, &self.symbols.finder(), &mut encoded).ok()?;
        let (_, rows) = self.results.iter().find(|(predicate, _)| *predicate == id)?;
        let at = rows.binary_search_by(|(row, _)| (**row).cmp(words)).ok()?;
        Some(rows[at].1)
    }

    /// Returns for each predicate of the [order](Marginals::set_order) the probability that it is the first one that
    /// a row is in, and after these the probability that the row is in none.
    pub fn first(&self, row: &[Value]) -> Vec<Probability> {
        let none = || {
            let certain = |value| Probability { value, interval: None };
            let mut all = vec![certain(0.0); self.order.len()];
            all.push(certain(1.0));
            all
        };
        self.firsts.get(row).cloned().unwrap_or_else(none)
    }

    /// Returns the options.
    pub fn options(&self) -> &MarginalOptions {
        &self.options
    }

    /// Returns the symbol table of the rows.
    pub fn symbols(&self) -> &Symbols {
        &self.symbols
    }
}

/// Returns an upper bound of the number of columns of the instances of a clause: a `_` of a positive atom becomes one.
fn columns(clause: &Clause) -> usize {
    let positive = clause.body.iter().filter_map(|literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    });
    let unnamed = positive
        .flat_map(|atom| &atom.terms)
        .filter(|term| **term == Term::Wildcard);
    clause.variables.len() + unnamed.count()
}

impl Probability {
    /// Returns the probability that one of two exclusive events happens. The interval of estimates is conservative.
    pub fn or(self, other: Probability) -> Probability {
        let interval = self.interval.zip(other.interval);
        Probability {
            value: self.value + other.value,
            interval: interval.map(|(one, two)| (one.0 + two.0, (one.1 + two.1).min(1.0))),
        }
    }

    /// Returns the estimate from the count of sampled worlds.
    fn estimated(count: u32, samples: u32) -> Probability {
        /// The quantile of the normal distribution for 95 %.
        const Z: f64 = 1.959_963_984_540_054;
        let n = f64::from(samples);
        let value = f64::from(count) / n;
        let center = value + Z * Z / (2.0 * n);
        let radius = Z * (value * (1.0 - value) / n + Z * Z / (4.0 * n * n)).sqrt();
        let end = |end: f64| (end / (1.0 + Z * Z / n)).clamp(0.0, 1.0);
        Probability {
            value,
            interval: Some((end(center - radius), end(center + radius))),
        }
    }
}
