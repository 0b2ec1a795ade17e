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
//! Facts about symbols, if they are few, count as uncertain too, with the formulas "true" and "false". So the session
//! need not derive anew what there may be in another scene of the same entities.
//!
//! Formulas are decision diagrams. Where they grow too large, or where an aggregate counts uncertain rows, the result is
//! an estimate from sampled worlds, with an interval.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, HashMap};

use crate::cancel::Cancel;
use crate::chance;
use crate::check::{
    Atom, Clause, ClauseId, Column, Draw, Literal, Predicate, PredicateId, Rules, Stratum, Term, TypeId, VarId,
    restratified,
};
use crate::convert::{AsPredicate, IntoRow, RowError, check_words, encode};
use crate::diagram::{Diagrams, Formula, NODE_BYTES, TooLarge};
use crate::eval::limits::{EvalError, Limits};
use crate::program::Program;
use crate::session::Session;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use crate::value::{Value, symbol_hash};
use smallvec::SmallVec;

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

/// Why probabilities are estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inexact {
    /// The decision diagrams would have more nodes than [`MarginalOptions::nodes_max`].
    TooLarge,
    /// An aggregate ranges over uncertain rows of this predicate, or of a hidden one.
    Aggregate(PredicateId),
}

/// The rows of a predicate, sorted, with their probabilities.
type Marginal = Vec<(Box<[Value]>, Probability)>;

impl Inexact {
    /// Returns the reason as a sentence without a full stop.
    pub fn show(self, rules: &Rules) -> String {
        match self {
            Inexact::TooLarge => "the formulas of the probabilities are too large".to_owned(),
            Inexact::Aggregate(predicate) => {
                let title = rules.predicates[predicate.index()].title();
                format!("an aggregate ranges over uncertain rows ({title})")
            }
        }
    }
}

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
    /// The input predicates that had an uncertain fact, for which the grounding was made.
    uncertain: BTreeSet<PredicateId>,
    grounding: Option<Grounding>,
    diagrams: Diagrams,
    symbols: Symbols,
    results: Vec<(PredicateId, Marginal)>,
    /// See [`Marginals::set_order`].
    order: Vec<PredicateId>,
    /// See [`Marginals::set_rows`].
    asked: Option<AskedRows>,
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
            grounding: None,
            diagrams: Diagrams::new(options.nodes_max.min(nodes_max)),
            symbols: program.rules().symbols.clone(),
            results: Vec::new(),
            order: Vec::new(),
            asked: None,
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
        if !(0.0..=1.0).contains(&probability) {
            let predicate = self.program.rules().predicates[to.index()].name.clone();
            let found = probability.to_string();
            return Err(RowError::Probability { predicate, found });
        }
        if probability < 1.0 && self.uncertain.insert(to) {
            self.grounding = None;
        }
        self.note(to, &words, true);
        self.facts.insert(to, words, probability);
        Ok(())
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
        let words: FactRow = match row.words() {
            Some(words) => words.into(),
            None => {
                let mut words = Vec::new();
                encode(predicate, row, &|text| Some(self.symbols.intern(text)), &mut words)?;
                words.into()
            }
        };
        check_words(predicate, &words, self.symbols.len())?;
        Ok((to, words))
    }

    /// Computes the probabilities for the present facts. A pure function of the facts and the options.
    ///
    /// # Errors
    /// If the evaluation exceeds a limit, or the caller cancels it. The facts stay as they are.
    pub fn compute(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        (self.inexact, self.results, self.firsts) = (None, Vec::new(), BTreeMap::new());
        self.facts.sort();
        // Earlier scenes may have left many rows.
        let kept = 4 * self.facts.len() + LIFTED_MAX;
        self.grounding = self.grounding.take().filter(|known| known.lifted_rows <= kept);
        let grounding = match &mut self.grounding {
            Some(grounding) => grounding,
            None => {
                let lifted = match self.facts.len() <= LIFTED_MAX {
                    true => liftable(self.program.rules()),
                    false => BTreeSet::new(),
                };
                let sets = (&self.uncertain, lifted);
                let mut grounding = Grounding::new(&self.program, sets, &self.queries, &self.symbols);
                grounding.session.set_limits(self.options.limits);
                for (to, words, _) in self.facts.iter() {
                    grounding.note(to, words, true);
                }
                self.grounding.insert(grounding)
            }
        };
        let exact = match grounding.inexact {
            Some(inexact) => Err(inexact),
            None => {
                if grounding.session.symbols().len() < self.symbols.len() {
                    grounding.session.set_symbols(self.symbols.clone());
                }
                grounding.commit(cancel)?;
                grounding.find_needed(&self.queries, self.asked.as_ref());
                let formulas = grounding.formulas(&self.facts, &mut self.diagrams, cancel)?;
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
                self.firsts = firsts;
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
                        BaseType::Symbol => draw.symbol(symbol_hash(*value, &self.symbols)),
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
        let mut words = Vec::new();
        let words = match row.words() {
            Some(words) => words,
            None => {
                encode(declared, &row, &|text| self.symbols.get(text), &mut words).ok()?;
                &words
            }
        };
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

/// The rows of [`Marginals::set_rows`].
type AskedRows = BTreeSet<Box<[Value]>>;

/// The words of a fact.
type FactRow = SmallVec<[Value; 4]>;

/// The facts of the input predicates, with their probabilities.
struct FactTables {
    /// By predicate: the rows, and whether they are sorted, each once. The last of equal rows counts.
    tables: Vec<(Vec<(FactRow, f64)>, bool)>,
}

impl FactTables {
    fn new(predicates: usize) -> FactTables {
        FactTables {
            tables: vec![(Vec::new(), true); predicates],
        }
    }

    fn insert(&mut self, to: PredicateId, row: FactRow, probability: f64) {
        let (rows, sorted) = &mut self.tables[to.index()];
        *sorted &= rows.last().is_none_or(|(last, _)| *last < row);
        rows.push((row, probability));
    }

    fn remove(&mut self, to: PredicateId, row: &[Value]) {
        self.sort();
        let (rows, _) = &mut self.tables[to.index()];
        if let Ok(at) = rows.binary_search_by(|(known, _)| (**known).cmp(row)) {
            rows.remove(at);
        }
    }

    fn clear(&mut self) {
        for (rows, sorted) in &mut self.tables {
            rows.clear();
            *sorted = true;
        }
    }

    fn sort(&mut self) {
        for (rows, sorted) in self.tables.iter_mut().filter(|(_, sorted)| !sorted) {
            // The order of equal rows stays.
            rows.sort_by(|(one, _), (other, _)| one.cmp(other));
            rows.reverse();
            rows.dedup_by(|(one, _), (other, _)| one == other);
            rows.reverse();
            *sorted = true;
        }
    }

    fn len(&self) -> usize {
        self.tables.iter().map(|(rows, _)| rows.len()).sum()
    }

    fn of(&self, predicate: PredicateId) -> &[(FactRow, f64)] {
        &self.tables[predicate.index()].0
    }

    fn iter(&self) -> impl Iterator<Item = (PredicateId, &[Value], f64)> {
        let tables = (0..).map(PredicateId).zip(&self.tables);
        tables.flat_map(|(id, (rows, _))| rows.iter().map(move |(row, probability)| (id, &**row, *probability)))
    }
}

/// Returns the rows of a predicate that are asked for, with their positions.
fn asked_rows<'s>(
    session: &'s Session,
    predicate: PredicateId,
    asked: Option<&AskedRows>,
) -> Vec<(usize, &'s [Value])> {
    match asked {
        None => session.encoded_rows(predicate).enumerate().collect(),
        Some(asked) => {
            let found = asked
                .iter()
                .filter_map(|row| find_row(session, predicate, row))
                .map(|at| at as usize);
            found.map(|at| (at, session.row(predicate, at))).collect()
        }
    }
}

/// The maximum number of facts that count as uncertain although they are certain.
const LIFTED_MAX: usize = 512;

/// A session that derives what there may be, and the clauses of what is uncertain.
struct Grounding {
    session: Session,
    /// By predicate: whether it is an input of which the session keeps all rows that there ever were.
    is_lifted: Vec<bool>,
    /// The number of these rows.
    lifted_rows: usize,
    /// Whether facts of the session have changed since its commit.
    changed: bool,
    /// The predicates whose rows may be uncertain and that the queries depend on.
    uncertain: Vec<bool>,
    /// The input predicates among them.
    inputs: Vec<PredicateId>,
    strata: Vec<GroundStratum>,
    inexact: Option<Inexact>,
    /// What the queries depend on. Made on demand; every commit and other queried rows clear it.
    needed: Option<Needed>,
}

/// The rows on which the queried rows depend.
struct Needed {
    /// Formulas of all rows before the first clause is evaluated.
    formulas: Formulas,
    /// The rows of the uncertain input predicates, with their positions.
    inputs: Vec<(PredicateId, Vec<(u32, FactRow)>)>,
}

/// The formulas of the rows of the uncertain predicates.
#[derive(Clone)]
struct Formulas {
    /// By predicate: the place of its first row; `None` for predicates that are certain.
    starts: Vec<Option<usize>>,
    all: Vec<Formula>,
}

impl Formulas {
    /// The formula of the row at this position; of a certain predicate, that it holds.
    #[inline]
    fn at(&self, predicate: PredicateId, row: usize) -> Formula {
        self.starts[predicate.index()].map_or(Formula::TRUE, |start| self.all[start + row])
    }

    #[inline]
    fn set(&mut self, predicate: PredicateId, row: usize, formula: Formula) {
        if let Some(start) = self.starts[predicate.index()] {
            self.all[start + row] = formula;
        }
    }
}

/// The clauses of the uncertain predicates of a stratum.
struct GroundStratum {
    clauses: Vec<GroundClause>,
}

/// A clause of an uncertain predicate. Its terms are columns of the rows of its instances.
struct GroundClause {
    head: Atom,
    /// The predicate of its instances; `None` for a certain fact.
    instances: Option<PredicateId>,
    /// Uncertain atoms of lower strata, and whether they are negated.
    lower: Vec<(Atom, bool)>,
    /// Uncertain atoms of its stratum.
    recursive: Vec<Atom>,
    draw: Option<Draw>,
    /// The instances that the session derives.
    found: Instances,
}

/// The positions of the rows of each instance of a clause: of the head, of the atoms of lower strata, and of those of
/// its stratum.
#[derive(Default)]
struct Instances {
    positions: Vec<u32>,
    /// The rows that match negated atoms with `_`.
    groups: Vec<Vec<u32>>,
    /// The numbers of the instances on which the queried rows depend, sorted.
    needed: Vec<u32>,
}

/// The position of a row that there cannot be.
const NOWHERE: u32 = u32::MAX;

impl Grounding {
    fn new(
        program: &Program,
        (inputs, lifted): (&BTreeSet<PredicateId>, BTreeSet<PredicateId>),
        queries: &[PredicateId],
        symbols: &Symbols,
    ) -> Grounding {
        let rules = program.rules();
        let mut is_lifted = vec![false; rules.predicates.len()];
        lifted.iter().for_each(|predicate| is_lifted[predicate.index()] = true);
        let inputs: BTreeSet<PredicateId> = inputs.union(&lifted).copied().collect();
        let uncertain = relevant(rules, uncertain(rules, &inputs), queries);
        let is_uncertain = |atom: &Atom| uncertain[atom.predicate.index()];
        let mut inexact = None;
        let mut made = rules.clone();
        made.clauses = Vec::with_capacity(rules.clauses.len());
        (made.pasts, made.chance) = (Vec::new(), None);
        let mut ground: Vec<Option<GroundClause>> = Vec::with_capacity(rules.clauses.len());
        for clause in &rules.clauses {
            if !is_uncertain(&clause.head) {
                made.clauses.push(clause.clone());
                ground.push(None);
                continue;
            }
            let aggregated = clause.body.iter().find_map(|literal| match literal {
                Literal::Aggregate { atom, .. } if is_uncertain(atom) => Some(atom.predicate),
                _ => None,
            });
            if let Some(predicate) = aggregated {
                inexact.get_or_insert(Inexact::Aggregate(predicate));
                ground.push(None);
                continue;
            }
            ground.push(Some(split(rules, clause, &is_uncertain, &mut made)));
        }
        let in_stratum = |stratum: &Stratum, atom: &Atom| stratum.predicates.contains(&atom.predicate);
        let strata = rules.strata.iter().filter_map(|stratum| {
            let is_empty = !stratum.predicates.iter().any(|predicate| uncertain[predicate.index()]);
            let clauses = stratum.clauses.iter().filter_map(|clause: &ClauseId| {
                let mut clause = ground[clause.index()].take()?;
                let (recursive, lower) = clause
                    .lower
                    .into_iter()
                    .partition(|(atom, _)| in_stratum(stratum, atom));
                clause.lower = lower;
                let recursive: Vec<(Atom, bool)> = recursive;
                clause.recursive = recursive.into_iter().map(|(atom, _)| atom).collect();
                Some(clause)
            });
            let clauses = clauses.collect();
            (!is_empty).then_some(GroundStratum { clauses })
        });
        let strata = strata.collect();
        let inputs = inputs
            .iter()
            .copied()
            .filter(|input| uncertain[input.index()])
            .collect();
        let made = Program::new(restratified(made)).expect("the clauses have fewer literals than those of the program");
        Grounding {
            session: made.session_with(symbols.clone()),
            is_lifted,
            lifted_rows: 0,
            changed: true,
            uncertain,
            inputs,
            strata,
            inexact,
            needed: None,
        }
    }

    /// Notes a change of a fact.
    fn note(&mut self, to: PredicateId, words: &[Value], holds: bool) {
        if self.is_lifted[to.index()] {
            if !holds || self.session.contains(to, words) {
                return;
            }
            self.lifted_rows += 1;
        }
        self.changed = true;
        self.session.change_row(to, words, holds);
    }

    /// Derives what there may be, and finds the rows of all instances.
    fn commit(&mut self, cancel: &Cancel) -> Result<(), EvalError> {
        if !self.changed {
            return Ok(());
        }
        self.session.commit_with(cancel)?;
        self.changed = false;
        let clauses = self.strata.iter_mut().flat_map(|stratum| &mut stratum.clauses);
        clauses.for_each(|clause| clause.find(&self.session));
        self.needed = None;
        Ok(())
    }

    /// Finds the rows and instances on which the queried rows depend.
    fn find_needed(&mut self, queries: &[PredicateId], asked: Option<&AskedRows>) {
        if self.needed.is_some() {
            return;
        }
        let rows = |predicate: u32| match self.uncertain[predicate as usize] {
            true => vec![false; self.session.len(PredicateId(predicate))],
            false => Vec::new(),
        };
        let mut needed: Vec<Vec<bool>> = (0..self.uncertain.len() as u32).map(rows).collect();
        for query in queries.iter().filter(|query| self.uncertain[query.index()]) {
            for (at, _) in asked_rows(&self.session, *query, asked) {
                needed[query.index()][at] = true;
            }
        }
        // From the last stratum to the first, so that all readers come before.
        for stratum in self.strata.iter_mut().rev() {
            stratum
                .clauses
                .iter_mut()
                .for_each(|clause| clause.found.needed.clear());
            let mut more = true;
            while std::mem::take(&mut more) {
                for clause in &mut stratum.clauses {
                    more |= clause.find_needed(&mut needed);
                }
            }
        }
        let rows_of = |input: PredicateId| {
            let rows = (0..).zip(self.session.encoded_rows(input)).zip(&needed[input.index()]);
            let needed = rows.filter(|(_, needed)| **needed);
            (input, needed.map(|((at, row), _)| (at, row.into())).collect())
        };
        let inputs = self.inputs.iter().map(|input| rows_of(*input)).collect();
        let mut next = 0;
        let start = |(rows, uncertain): (&Vec<bool>, &bool)| {
            uncertain.then(|| {
                next += rows.len();
                next - rows.len()
            })
        };
        let starts = needed.iter().zip(&self.uncertain).map(start).collect();
        self.needed = Some(Needed {
            formulas: Formulas {
                starts,
                all: vec![Formula::FALSE; next],
            },
            inputs,
        });
    }

    /// Returns the probabilities of [`Marginals::first`] for all rows of these predicates.
    fn firsts(
        &self,
        (order, asked): (&[PredicateId], Option<&AskedRows>),
        known: &Formulas,
        diagrams: &mut Diagrams,
    ) -> Result<BTreeMap<Box<[Value]>, Vec<Probability>>, TooLarge> {
        let mut rows: BTreeMap<&[Value], Vec<Formula>> = BTreeMap::new();
        for (place, predicate) in order.iter().enumerate() {
            for (at, row) in asked_rows(&self.session, *predicate, asked) {
                let formulas = rows.entry(row).or_insert_with(|| vec![Formula::FALSE; order.len()]);
                formulas[place] = known.at(*predicate, at);
            }
        }
        let mut firsts = BTreeMap::new();
        for (row, formulas) in rows {
            let mut none = Formula::TRUE;
            let mut each = Vec::with_capacity(formulas.len() + 1);
            for formula in formulas {
                let first = diagrams.and(none, formula)?;
                each.push(first);
                none = diagrams.and(none, formula.not())?;
            }
            each.push(none);
            let probability = |formula| Probability {
                value: diagrams.probability(formula),
                interval: None,
            };
            firsts.insert(row.into(), each.into_iter().map(probability).collect());
        }
        Ok(firsts)
    }

    /// Returns the formulas of the needed rows.
    fn formulas(
        &self,
        facts: &FactTables,
        diagrams: &mut Diagrams,
        cancel: &Cancel,
    ) -> Result<Result<Formulas, TooLarge>, EvalError> {
        diagrams.clear();
        let needed = self.needed.as_ref().expect("it is known which rows are needed");
        let mut work = Work {
            session: &self.session,
            diagrams,
            formulas: needed.formulas.clone(),
            draws: HashMap::new(),
            cancel,
        };
        match work.run(self, &needed.inputs, facts) {
            Ok(()) => Ok(Ok(work.formulas)),
            Err(Stop::TooLarge) => Ok(Err(TooLarge)),
            Err(Stop::Cancelled) => Err(EvalError::Cancelled { clause: ClauseId(0) }),
        }
    }
}

/// Why formulas are not complete.
enum Stop {
    TooLarge,
    Cancelled,
}

impl From<TooLarge> for Stop {
    fn from(_: TooLarge) -> Stop {
        Stop::TooLarge
    }
}

/// The formulas so far.
struct Work<'w> {
    session: &'w Session,
    diagrams: &'w mut Diagrams,
    formulas: Formulas,
    /// The alternatives of each draw. Lookup only, never iterated.
    draws: HashMap<(u64, Box<[Value]>), Vec<Formula>>,
    cancel: &'w Cancel,
}

/// An instance of a recursive clause: the position of its head, what holds of it apart from the recursion, and the
/// positions of the recursive atoms.
struct Instance {
    head: (PredicateId, u32),
    fixed: Formula,
    recursive: Vec<(PredicateId, u32)>,
}

impl Work<'_> {
    fn run(
        &mut self,
        grounding: &Grounding,
        inputs: &[(PredicateId, Vec<(u32, FactRow)>)],
        facts: &FactTables,
    ) -> Result<(), Stop> {
        for (input, rows) in inputs {
            // Both are sorted. Facts of the source are no such facts; clauses add them below.
            let mut given = facts.of(*input).iter().peekable();
            for (at, row) in rows {
                while given.next_if(|(known, _)| known < row).is_some() {}
                if let Some((_, probability)) = given.next_if(|(known, _)| known == row) {
                    let formula = self.random(*probability)?;
                    self.formulas.set(*input, *at as usize, formula);
                }
            }
        }
        for stratum in &grounding.strata {
            let mut instances = Vec::new();
            for clause in &stratum.clauses {
                self.instances(clause, &mut instances)?;
            }
            self.fixpoint(&instances)?;
        }
        Ok(())
    }

    /// Returns a formula that holds with this probability, independently of all others.
    fn random(&mut self, probability: f64) -> Result<Formula, TooLarge> {
        match probability {
            ..=0.0 => Ok(Formula::FALSE),
            1.0.. => Ok(Formula::TRUE),
            _ => self.diagrams.variable(probability),
        }
    }

    /// Evaluates the instances of a clause, and collects those that are recursive.
    fn instances(&mut self, clause: &GroundClause, recursive: &mut Vec<Instance>) -> Result<(), Stop> {
        for (count, &number) in clause.found.needed.iter().enumerate() {
            if count % 1024 == 1023 && self.cancel.requested() {
                return Err(Stop::Cancelled);
            }
            let number = number as usize;
            let positions = &clause.found.positions[number * clause.width()..][..clause.width()];
            let (lower, own) = positions[1..].split_at(clause.lower.len());
            let mut fixed = Formula::TRUE;
            for ((atom, negated), &at) in clause.lower.iter().zip(lower) {
                let formula = match negated {
                    false => self.at((atom.predicate, at)),
                    true if at == NOWHERE => continue,
                    true if atom.terms.contains(&Term::Wildcard) => {
                        let mut all = Formula::FALSE;
                        for &at in &clause.found.groups[at as usize] {
                            all = self.diagrams.or(all, self.at((atom.predicate, at)))?;
                        }
                        all.not()
                    }
                    true => self.at((atom.predicate, at)).not(),
                };
                fixed = self.diagrams.and(fixed, formula)?;
                if fixed == Formula::FALSE {
                    break;
                }
            }
            if fixed == Formula::FALSE {
                continue;
            }
            if let (Some(draw), Some(instances)) = (&clause.draw, clause.instances) {
                let drawn = self.drawn(draw, self.session.row(instances, number))?;
                fixed = self.diagrams.and(fixed, drawn)?;
            }
            let head = (clause.head.predicate, positions[0]);
            if own.is_empty() {
                self.add(head, fixed)?;
            } else {
                let own = clause.recursive.iter().zip(own);
                recursive.push(Instance {
                    head,
                    fixed,
                    recursive: own.map(|(atom, at)| (atom.predicate, *at)).collect(),
                });
            }
        }
        Ok(())
    }

    /// Evaluates recursive instances until no formula changes. Formulas only grow, so this ends.
    fn fixpoint(&mut self, instances: &[Instance]) -> Result<(), Stop> {
        let mut changed: BTreeSet<(PredicateId, u32)> = BTreeSet::new();
        let mut first = true;
        while first || !changed.is_empty() {
            let mut next = BTreeSet::new();
            for instance in instances {
                if !first && !instance.recursive.iter().any(|atom| changed.contains(atom)) {
                    continue;
                }
                if self.cancel.requested() {
                    return Err(Stop::Cancelled);
                }
                let mut formula = instance.fixed;
                for atom in &instance.recursive {
                    formula = self.diagrams.and(formula, self.at(*atom))?;
                }
                if self.add(instance.head, formula)? {
                    next.insert(instance.head);
                }
            }
            (first, changed) = (false, next);
        }
        Ok(())
    }

    /// Adds a reason for a row. Returns whether its formula changes.
    fn add(&mut self, (predicate, at): (PredicateId, u32), reason: Formula) -> Result<bool, TooLarge> {
        let before = self.at((predicate, at));
        let after = self.diagrams.or(before, reason)?;
        self.formulas.set(predicate, at as usize, after);
        Ok(before != after)
    }

    #[inline]
    fn at(&self, (predicate, at): (PredicateId, u32)) -> Formula {
        self.formulas.at(predicate, at as usize)
    }

    /// Returns the formula that the alternative of a draw is chosen.
    fn drawn(&mut self, draw: &Draw, instance: &[Value]) -> Result<Formula, TooLarge> {
        let values = draw.values.iter().map(|term| value(term, instance).unwrap_or_default());
        let key = (draw.stream, values.collect::<Box<[Value]>>());
        if let Some(alternatives) = self.draws.get(&key) {
            return Ok(alternatives.get(draw.alternative).copied().unwrap_or(Formula::FALSE));
        }
        let probabilities = draw.probabilities.iter();
        let probabilities = probabilities.map(|term| value(term, instance).unwrap_or_default().as_float());
        let probabilities: Vec<f32> = probabilities.collect();
        let mut alternatives = Vec::new();
        if chance::alternative(0.0, probabilities.iter().copied()).is_some() {
            // The first alternatives are not chosen, and this one is, of what is left.
            let (mut before, mut left) = (Formula::TRUE, 1.0);
            for probability in probabilities.into_iter().map(exact) {
                let chosen = self.random(if left > 0.0 { probability / left } else { 0.0 })?;
                alternatives.push(self.diagrams.and(before, chosen)?);
                before = self.diagrams.and(before, chosen.not())?;
                left -= probability;
            }
        }
        let found = alternatives.get(draw.alternative).copied().unwrap_or(Formula::FALSE);
        self.draws.insert(key, alternatives);
        Ok(found)
    }
}

impl GroundClause {
    /// Returns the number of positions of an instance.
    fn width(&self) -> usize {
        1 + self.lower.len() + self.recursive.len()
    }

    /// Finds the instances of needed rows, and marks the rows that they read. Returns whether there are further ones.
    fn find_needed(&mut self, needed: &mut [Vec<bool>]) -> bool {
        let width = self.width();
        let found = &mut self.found;
        let before = found.needed.len();
        found.needed.clear();
        for (number, positions) in (0..).zip(found.positions.chunks_exact(width)) {
            let heads = &needed[self.head.predicate.index()];
            if !heads.get(positions[0] as usize).is_some_and(|needed| *needed) {
                continue;
            }
            found.needed.push(number);
            let lower = self.lower.iter().map(|(atom, negated)| (atom, *negated));
            let atoms = lower.chain(self.recursive.iter().map(|atom| (atom, false)));
            for ((atom, negated), &at) in atoms.zip(&positions[1..]) {
                let rows = &mut needed[atom.predicate.index()];
                let grouped = negated && atom.terms.contains(&Term::Wildcard);
                match (grouped, at) {
                    (true, group) => found.groups[group as usize]
                        .iter()
                        .for_each(|at| rows[*at as usize] = true),
                    (false, NOWHERE) => {}
                    (false, at) => rows[at as usize] = true,
                }
            }
        }
        found.needed.len() > before
    }

    /// Finds the rows of all instances.
    fn find(&mut self, session: &Session) {
        let mut found = Instances::default();
        let position = |atom: &Atom, instance: &[Value]| find(session, atom, instance).unwrap_or(NOWHERE);
        let mut add = |instance: &[Value]| {
            found.positions.push(position(&self.head, instance));
            for (atom, negated) in &self.lower {
                found
                    .positions
                    .push(match *negated && atom.terms.contains(&Term::Wildcard) {
                        false => position(atom, instance),
                        true => {
                            found.groups.push(matching(session, atom, instance));
                            found.groups.len() as u32 - 1
                        }
                    });
            }
            let own = self.recursive.iter().map(|atom| position(atom, instance));
            found.positions.extend(own);
        };
        match self.instances {
            None => add(&[]),
            Some(instances) => session.encoded_rows(instances).for_each(add),
        }
        self.found = found;
    }
}

/// Returns the position of the row of an atom, all of whose terms have values.
fn find(session: &Session, atom: &Atom, instance: &[Value]) -> Option<u32> {
    let wanted = atom.terms.iter().map(|term| value(term, instance));
    let wanted: SmallVec<[Value; 4]> = wanted.collect::<Option<_>>()?;
    find_row(session, atom.predicate, &wanted)
}

fn find_row(session: &Session, predicate: PredicateId, wanted: &[Value]) -> Option<u32> {
    let (mut low, mut high) = (0, session.len(predicate));
    while low < high {
        let middle = low.midpoint(high);
        match session.row(predicate, middle).cmp(wanted) {
            Ordering::Less => low = middle + 1,
            Ordering::Equal => return u32::try_from(middle).ok(),
            Ordering::Greater => high = middle,
        }
    }
    None
}

/// Returns the positions of the rows that match an atom.
fn matching(session: &Session, atom: &Atom, instance: &[Value]) -> Vec<u32> {
    let pattern: Vec<Option<Value>> = atom.terms.iter().map(|term| value(term, instance)).collect();
    let rows = (0..).zip(session.encoded_rows(atom.predicate));
    let matches = rows.filter(|(_, row)| {
        let mut columns = pattern.iter().zip(*row);
        columns.all(|(wanted, found)| wanted.is_none_or(|wanted| wanted == *found))
    });
    matches.map(|(at, _)| at).collect()
}

/// Returns the inputs whose facts may count as uncertain: those of symbols that no aggregate depends on.
fn liftable(rules: &Rules) -> BTreeSet<PredicateId> {
    let aggregates = rules.clauses.iter().flat_map(|clause| &clause.body);
    let mut open: Vec<PredicateId> = aggregates
        .filter_map(|literal| match literal {
            Literal::Aggregate { atom, .. } => Some(atom.predicate),
            _ => None,
        })
        .collect();
    let mut read: BTreeSet<PredicateId> = BTreeSet::new();
    while let Some(predicate) = open.pop() {
        if read.insert(predicate) {
            let clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == predicate);
            let atoms = clauses.flat_map(|clause| clause.body.iter().filter_map(Literal::atom));
            open.extend(atoms.map(|atom| atom.predicate));
        }
    }
    let ids = (0..).map(PredicateId).zip(&rules.predicates);
    let liftable = ids.filter(|(id, predicate)| {
        let symbols = predicate.columns.iter().all(|column| column.base == BaseType::Symbol);
        !predicate.derived && symbols && !read.contains(id)
    });
    liftable.map(|(id, _)| id).collect()
}

/// Returns the number that a float of single precision was probably written as: 0.3, not 0.30000001192.
fn exact(probability: f32) -> f64 {
    probability
        .to_string()
        .parse()
        .unwrap_or_else(|_| f64::from(probability))
}

/// Returns the value of a term whose variables are columns of a row.
fn value(term: &Term, row: &[Value]) -> Option<Value> {
    match *term {
        Term::Constant(constant) => Some(constant),
        Term::Variable(column) => Some(row[column.index()]),
        Term::Wildcard => None,
    }
}

/// Returns for each predicate whether a row may be uncertain.
fn uncertain(rules: &Rules, inputs: &BTreeSet<PredicateId>) -> Vec<bool> {
    let mut uncertain: Vec<bool> = (0..rules.predicates.len() as u32)
        .map(|id| inputs.contains(&PredicateId(id)))
        .collect();
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for clause in &rules.clauses {
            let head = clause.head.predicate.index();
            let reads = |literal: &Literal| {
                literal
                    .atom()
                    .is_some_and(|atom| uncertain[atom.predicate.index()] || Some(atom.predicate) == rules.chance)
            };
            if !uncertain[head] && clause.body.iter().any(reads) {
                uncertain[head] = true;
                changed = true;
            }
        }
    }
    uncertain
}

/// Keeps the predicates on which the queries depend.
fn relevant(rules: &Rules, mut uncertain: Vec<bool>, queries: &[PredicateId]) -> Vec<bool> {
    let mut needed = vec![false; uncertain.len()];
    let mut open: Vec<PredicateId> = queries.to_vec();
    while let Some(predicate) = open.pop() {
        if !std::mem::replace(&mut needed[predicate.index()], true) {
            let clauses = rules.clauses.iter().filter(|clause| clause.head.predicate == predicate);
            let atoms = clauses.flat_map(|clause| clause.body.iter().filter_map(Literal::atom));
            open.extend(atoms.map(|atom| atom.predicate));
        }
    }
    uncertain
        .iter_mut()
        .zip(needed)
        .for_each(|(uncertain, needed)| *uncertain &= needed);
    uncertain
}

/// Splits a clause of an uncertain predicate: adds the clause of its instances and that of its head to the rules that
/// derive what there may be, and returns the rest.
fn split(rules: &Rules, clause: &Clause, is_uncertain: &impl Fn(&Atom) -> bool, made: &mut Rules) -> GroundClause {
    if clause.body.is_empty() {
        made.clauses.push(clause.clone());
        return GroundClause {
            head: clause.head.clone(),
            instances: None,
            lower: Vec::new(),
            recursive: Vec::new(),
            draw: None,
            found: Instances::default(),
        };
    }
    let mut draw = rules.draw(clause);
    let drawn = draw.as_ref().map_or([usize::MAX; 3], |draw| draw.literals);
    let mut atoms: Vec<(Atom, bool)> = Vec::new();
    let mut body = Vec::new();
    for (at, literal) in clause.body.iter().enumerate() {
        match literal {
            _ if drawn.contains(&at) => continue,
            Literal::Negative(atom) if is_uncertain(atom) => {
                atoms.push((atom.clone(), true));
                continue;
            }
            Literal::Positive(atom) | Literal::Guard(atom) if is_uncertain(atom) => {
                atoms.push((atom.clone(), false));
            }
            _ => {}
        }
        body.push(literal.clone());
    }
    // A `_` of a positive atom needs a value, to know the row.
    let mut variables = clause.variables.clone();
    let mut bases = rules.bases(clause);
    let mut next = 0;
    for literal in &mut body {
        let (Literal::Positive(atom) | Literal::Guard(atom)) = literal else {
            continue;
        };
        if !is_uncertain(atom) {
            continue;
        }
        let columns = &rules.predicates[atom.predicate.index()].columns;
        for (term, column) in atom.terms.iter_mut().zip(columns) {
            if *term == Term::Wildcard {
                *term = Term::Variable(VarId(variables.len() as u32));
                variables.push("_".to_owned());
                bases.push(column.base);
            }
        }
        let positive = atoms[next..].iter().position(|(_, negated)| !negated);
        if let Some(position) = positive {
            atoms[next + position].0 = atom.clone();
            next += position + 1;
        }
    }
    let mut head = clause.head.clone();
    // The columns of the instances: the variables of what remains to be evaluated.
    let mut columns: Vec<VarId> = Vec::new();
    let terms = (head.terms.iter_mut())
        .chain(atoms.iter_mut().flat_map(|(atom, _)| &mut atom.terms))
        .chain(
            draw.iter_mut()
                .flat_map(|draw| draw.probabilities.iter_mut().chain(&mut draw.values)),
        );
    for term in terms {
        if let Term::Variable(variable) = term {
            let column = columns.iter().position(|known| known == variable).unwrap_or_else(|| {
                columns.push(*variable);
                columns.len() - 1
            });
            *variable = VarId(column as u32);
        }
    }
    let instances = PredicateId(made.predicates.len() as u32);
    let column = |variable: &VarId| Column {
        name: variables[variable.index()].clone(),
        ty: TypeId(0),
        base: bases[variable.index()],
    };
    made.predicates.push(Predicate::made(
        format!("+instances {}", made.clauses.len()),
        columns.iter().map(column).collect(),
        "instances of a clause".to_owned(),
        clause.span,
    ));
    let atom = Atom {
        predicate: instances,
        terms: columns.iter().map(|variable| Term::Variable(*variable)).collect(),
        span: clause.span,
    };
    made.clauses.push(Clause {
        head: atom.clone(),
        body,
        variable_spans: vec![clause.span; variables.len()],
        variables: variables.clone(),
        doc: String::new(),
        span: clause.span,
    });
    made.clauses.push(Clause {
        body: vec![Literal::Positive(Atom {
            terms: (0..columns.len() as u32)
                .map(|column| Term::Variable(VarId(column)))
                .collect(),
            ..atom
        })],
        head: head.clone(),
        variable_spans: vec![clause.span; columns.len()],
        variables: columns
            .iter()
            .map(|variable| variables[variable.index()].clone())
            .collect(),
        doc: String::new(),
        span: clause.span,
    });
    GroundClause {
        head,
        instances: Some(instances),
        lower: atoms,
        recursive: Vec::new(),
        draw,
        found: Instances::default(),
    }
}
