//! From checked rules to facts.
//!
//! Reach for [`Program`] to prepare rules once and share them; for [`Session`] to hold facts, change them and ask what follows
//! from them; for [`facts`] to read and print relations as text; and for [`naive`] to see in two pages what the answers mean.
//!
//! ```text
//! Rules --plan--> Program (immutable, shareable)
//!                    |
//!                 Session: insert, retract --commit--> Delta (what became true, what stopped being true)
//! ```
//!
//! A commit looks at the net change of the inserted facts and goes, in order, through the strata whose inputs changed. Each is
//! maintained, which looks only at what the change touches, or recomputed, whatever looks cheaper ([`Strategy`]); a stratum whose
//! result stays the same stops the change there. [`Session::work`] tells what was done. [`naive`] is the specification: after
//! every commit a session holds exactly what `naive` derives from the same facts.
//!
//! Inside: `plan` says what a plan is, `planner` orders the literals of each clause and chooses indexes; `estimate` judges plans by
//! the sizes of relations, and `adapt` has clauses planned again when those have changed; `show` prints them. `join` runs a plan;
//! `seen` knows what was derived before; `exec` makes a commit, `recursion` runs a recursive stratum to its fixpoint; `maintain` brings a
//! stratum up to date from a change; `noted` holds the changes of the next commit, `table` a relation and its indexes; `workers` are the
//! threads; `limits` says how much is too much; `row` has the sorted lists all this works on.
//!
//! Beside these stand [`dense`], which evaluates rules over few entities on words of bits; [`optimize`], which simplifies clauses
//! before they are planned; [`diff`], which compares programs; and [`provenance`], which explains facts.
//!
//! This module refuses to know what a city, an agent or an ego is. It does no I/O and is deterministic.

mod adapt;
pub mod dense;
pub mod diff;
mod estimate;
mod exec;
pub mod facts;
mod join;
mod limits;
mod maintain;
pub mod naive;
mod noted;
pub mod optimize;
mod plan;
mod planner;
pub mod promise;
pub mod provenance;
mod recursion;
mod row;
mod seen;
mod show;
mod table;
mod workers;

use crate::diag::{Diagnostic, SourceId, Sources};
use crate::files::ReadError;
use crate::lang::{self, BaseType, Clause, ClauseId, Inputs, RelId, Relation, Rules, Value};
use crate::symbol::Symbols;
use exec::{Orders, Store};
use plan::{Plans, StratumPlan};
use row::{Row, RowList};
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use workers::Workers;

pub use limits::{EvalError, Limits};
pub use workers::Threads;

/// Rules with a plan for every clause. Cheap to clone; many sessions can run one program.
#[derive(Clone, Debug)]
pub struct Program(Arc<Compiled>);

/// How to prepare a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Simplify clauses before they are planned.
    pub optimize: bool,
    /// Rely on [`Rules::promises`]. Where facts break a promise, answers may then be wrong; [`promise::broken`] tells.
    pub promises: bool,
}

impl Default for Options {
    /// Optimised, relying on no promise.
    fn default() -> Self {
        Options {
            optimize: true,
            promises: false,
        }
    }
}

#[derive(Debug)]
struct Compiled {
    rules: Rules,
    /// What the optimiser added after the predicates and clauses of the rules; nobody sees it but the plans.
    shared: (Vec<Relation>, Vec<Clause>),
    /// Made from the text alone.
    plans: Arc<Plans>,
}

impl Compiled {
    /// A predicate of the rules or of the plans only.
    fn relation(&self, relation: RelId) -> &Relation {
        let own = self.rules.relations.len();
        match relation.index().checked_sub(own) {
            Some(further) => &self.shared.0[further],
            None => &self.rules.relations[relation.index()],
        }
    }

    /// Whether the stratum is one that the optimiser added.
    fn is_shared(&self, stratum: &StratumPlan) -> bool {
        let own = self.rules.relations.len();
        stratum.members.first().is_some_and(|member| member.index() >= own)
    }
}

impl Program {
    /// Loads the rules of `entry`, a text of `sources`, with [`lang::load`] and plans them. Beside the program stand all errors
    /// and warnings; there is none if one of them is an error.
    pub fn load(
        sources: &mut Sources,
        entry: SourceId,
        read: &dyn Fn(&Path) -> Result<String, ReadError>,
    ) -> (Option<Program>, Vec<Diagnostic>) {
        Program::load_with(sources, entry, read, Inputs::Given)
    }

    /// As [`Program::load`], with a choice of what an `.input` is.
    pub fn load_with(
        sources: &mut Sources,
        entry: SourceId,
        read: &dyn Fn(&Path) -> Result<String, ReadError>,
        inputs: Inputs,
    ) -> (Option<Program>, Vec<Diagnostic>) {
        let mut loaded = lang::load_with(sources, entry, read, inputs);
        let program = loaded
            .rules
            .and_then(|rules| Program::new(rules).map_err(|fault| loaded.diagnostics.push(fault)).ok());
        (program, loaded.diagnostics)
    }

    /// Plans the evaluation of checked rules. Fails only if a predicate has more than 32 columns or a clause more than 128
    /// variables or literals.
    pub fn new(rules: Rules) -> Result<Program, Diagnostic> {
        Program::with(rules, Options::default())
    }

    /// As [`Program::new`], with a choice of what to rely on. The answers are the same.
    pub fn with(rules: Rules, options: Options) -> Result<Program, Diagnostic> {
        let (plans, shared) = if options.optimize {
            let mut better = optimize::optimize(&rules, options.promises);
            let plans = Plans::new(&better)?;
            let relations = better.relations.split_off(rules.relations.len());
            (plans, (relations, better.clauses.split_off(rules.clauses.len())))
        } else {
            (Plans::new(&rules)?, Default::default())
        };
        let plans = Arc::new(plans);
        Ok(Program(Arc::new(Compiled { rules, shared, plans })))
    }

    /// The rules.
    pub fn rules(&self) -> &Rules {
        &self.0.rules
    }

    /// The predicate of that name.
    pub fn relation(&self, name: &str) -> Option<RelId> {
        self.0.rules.relation(name)
    }

    /// The relation, if rows of it can be set.
    fn base(&self, rel: RelId) -> Result<&Relation, RowError> {
        let relation = self.rules().relations.get(rel.index());
        let relation = relation.ok_or(RowError::UnknownRelation)?;
        if relation.derived && relation.given.is_none() {
            return Err(RowError::Derived {
                relation: relation.name.clone(),
            });
        }
        Ok(relation)
    }

    /// How many parts of bodies are computed once for several clauses. They are in no answer; [`Work::shared`] tells what they took.
    pub fn shared_bodies(&self) -> usize {
        self.0.shared.1.len()
    }

    /// A session without inserted facts and without a commit: every relation is empty, also those with facts in the text.
    pub fn session(&self) -> Session {
        Session {
            store: exec::store(&self.0),
            symbols: self.0.rules.symbols.clone(),
            program: self.clone(),
            limits: Limits::default(),
            strategy: Strategy::Auto,
            workers: Workers::default(),
            work: WorkLog::default(),
        }
    }
}

/// Facts and what follows from them.
///
/// A fact passes through these stages: it is *noted* by [`insert`](Session::insert) or [`retract`](Session::retract) and
/// visible to nobody; [`commit`](Session::commit) makes it *true* (or not true any more) together with all that follows. All
/// questions are answered as of the last commit.
pub struct Session {
    program: Program,
    symbols: Symbols,
    store: Box<dyn Store>,
    limits: Limits,
    strategy: Strategy,
    workers: Workers,
    work: WorkLog,
}

/// What [`Session::commit_watched`] tells of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// A clause begins to be evaluated.
    Begin(ClauseId),
    /// It has been evaluated. There is always just one that has begun.
    End(ClauseId),
}

/// How a commit brings a stratum up to date whose inputs changed. The result is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Maintain or recompute, whatever looks cheaper. This is decided by numbers of rows: how many changed, and how many the last
    /// computation from scratch looked at. If maintaining looks at more rows than that, it is given up and the stratum is
    /// recomputed.
    #[default]
    Auto,
    /// Always maintain, whatever it costs. Some strata cannot be maintained (those with a clause of more than 24 literals); they
    /// are recomputed.
    Maintain,
    /// Always recompute.
    Recompute,
}

impl Session {
    /// The program.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// The texts of the symbols in rows: the program's and those interned here.
    pub fn symbols(&self) -> &Symbols {
        &self.symbols
    }

    /// The word for a symbol, for use in rows of this session.
    pub fn intern(&mut self, text: &str) -> Value {
        Value(self.symbols.intern(text).0)
    }

    /// Sets what a commit may take; one that would take more fails.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Sets how many threads evaluate: one unless set otherwise. Answers, their order, deltas and work logs are the same with any
    /// number. Fails if the system does not give so many.
    pub fn set_threads(&mut self, threads: Threads) -> std::io::Result<()> {
        self.workers = Workers::new(threads)?;
        Ok(())
    }

    /// Sets how commits bring strata up to date: [`Strategy::Auto`] unless set otherwise. There is no need to set it besides
    /// testing and measuring.
    pub fn set_strategy(&mut self, strategy: Strategy) {
        self.strategy = strategy;
    }

    /// Notes that the row holds from the next commit on. Noting both for one row, the last one counts.
    pub fn insert(&mut self, rel: RelId, row: &[Value]) -> Result<(), RowError> {
        let rel = self.check(rel, row)?;
        self.store.change(rel, row, true);
        Ok(())
    }

    /// Notes that all these rows hold from the next commit on: as [`insert`](Session::insert) does, but faster where they are many.
    /// If one of them cannot be inserted, none is noted.
    pub fn insert_all(
        &mut self,
        rel: RelId,
        rows: impl IntoIterator<Item = impl AsRef<[Value]>>,
    ) -> Result<(), RowError> {
        /// Words that are handed on at once.
        const PART: usize = 1 << 12;
        let (relation, known) = (self.program.base(rel)?, self.symbols.len());
        let (to, arity) = (relation.given.unwrap_or(rel), relation.arity());
        let symbolic = relation.columns.iter().any(|column| column.base == BaseType::Symbol);
        let before = self.store.noted(to);
        let mut words: Vec<Value> = Vec::with_capacity(PART);
        let rows = rows.into_iter();
        self.store.reserve(to, rows.size_hint().0);
        for row in rows {
            let row = row.as_ref();
            if (symbolic || row.len() != arity)
                && let Err(error) = check_row(relation, row, known)
            {
                self.store.forget(to, before);
                return Err(error);
            }
            if arity == 0 {
                self.store.change(to, row, true);
            }
            words.extend_from_slice(row);
            if words.len() >= PART {
                self.store.insert_all(to, &words, arity);
                words.clear();
            }
        }
        if !words.is_empty() {
            self.store.insert_all(to, &words, arity);
        }
        Ok(())
    }

    /// Notes that the row does not hold from the next commit on. A fact in the text of the rules holds nevertheless: this takes
    /// back an [`insert`](Session::insert), not a rule.
    pub fn retract(&mut self, rel: RelId, row: &[Value]) -> Result<(), RowError> {
        let rel = self.check(rel, row)?;
        self.store.change(rel, row, false);
        Ok(())
    }

    /// Forgets what was noted since the last commit.
    pub fn rollback(&mut self) {
        self.store.rollback();
    }

    /// Where the row goes.
    fn check(&self, rel: RelId, row: &[Value]) -> Result<RelId, RowError> {
        let relation = self.program.base(rel)?;
        check_row(relation, row, self.symbols.len())?;
        Ok(relation.given.unwrap_or(rel))
    }

    /// Makes what was noted true and derives what follows. Says exactly what became true and what stopped being true, in every
    /// relation. If it fails, the session is as before the call, with the same changes noted; see
    /// [`rollback`](Session::rollback).
    pub fn commit(&mut self) -> Result<Delta, EvalError> {
        self.commit_with(None, None)
    }

    /// The same, telling on the calling thread when the evaluation of a clause begins and ends. The engine reads no clock; whoever
    /// watches may.
    pub fn commit_watched(&mut self, watch: &dyn Fn(Moment)) -> Result<Delta, EvalError> {
        self.commit_with(Some(watch), None)
    }

    /// The same, given up when `stop` says so, which is asked on the calling thread: a few thousand times a second at most while
    /// rules are evaluated, less often while rows are sorted.
    ///
    /// # Errors
    /// [`EvalError::Interrupted`] if it was given up, with the session as after any commit that fails.
    pub fn commit_until(&mut self, stop: &dyn Fn() -> bool) -> Result<Delta, EvalError> {
        self.commit_with(None, Some(stop))
    }

    fn commit_with(
        &mut self,
        watch: Option<&dyn Fn(Moment)>,
        ask: Option<&dyn Fn() -> bool>,
    ) -> Result<Delta, EvalError> {
        let orders = Orders {
            strategy: self.strategy,
            limits: self.limits,
            workers: &self.workers,
            watch,
            ask,
        };
        let known = self.symbols.len();
        match self.store.commit(&self.program.0, &self.symbols, orders) {
            Ok((delta, work)) => {
                self.work = work;
                Ok(delta)
            }
            Err(error) => {
                self.symbols.truncate(known);
                Err(error)
            }
        }
    }

    /// Whether the row holds.
    pub fn contains(&self, rel: RelId, row: &[Value]) -> bool {
        self.arity(rel) == Some(row.len()) && self.store.contains(rel, row)
    }

    /// The rows that hold, in the order of their words (for symbols, the order in which they were interned).
    pub fn rows(&self, rel: RelId) -> impl Iterator<Item = &[Value]> {
        let arity = self.arity(rel).unwrap_or(0);
        (0..self.len(rel)).map(move |position| &self.store.row(rel, position)[..arity])
    }

    /// How many rows hold.
    pub fn len(&self, rel: RelId) -> usize {
        self.arity(rel).map_or(0, |_| self.store.len(rel))
    }

    /// Whether no row of the relation holds.
    pub fn is_empty(&self, rel: RelId) -> bool {
        self.len(rel) == 0
    }

    fn arity(&self, rel: RelId) -> Option<usize> {
        self.program
            .rules()
            .relations
            .get(rel.index())
            .map(|relation| relation.arity())
    }

    /// The distinct rows that one clause derives from what holds, sorted. Several clauses may derive one row. For a fact in the
    /// text, the fact.
    pub fn fired(&self, clause: ClauseId) -> Vec<Vec<Value>> {
        if clause.index() < self.program.rules().clauses.len() {
            self.store.fired(&self.program.0, &self.symbols, clause)
        } else {
            Vec::new()
        }
    }

    /// What the last successful commit did.
    pub fn work(&self) -> &WorkLog {
        &self.work
    }
}

/// Whether the row can be one of the relation, where so many symbols are known.
fn check_row(relation: &Relation, row: &[Value], known: usize) -> Result<(), RowError> {
    if relation.arity() != row.len() {
        return Err(RowError::Arity {
            relation: relation.name.clone(),
            expected: relation.arity(),
            found: row.len(),
        });
    }
    let mut columns = row.iter().zip(&relation.columns);
    if columns.any(|(value, column)| value.0 as usize >= known && column.base == BaseType::Symbol) {
        return Err(RowError::UnknownSymbol {
            relation: relation.name.clone(),
        });
    }
    Ok(())
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let relations = self.program.rules().relations.iter().zip(0..);
        f.debug_map()
            .entries(relations.map(|(relation, rel)| (&relation.name, self.len(RelId(rel)))))
            .finish()
    }
}

/// Rows of one relation, sorted by their words. Cheap to clone: they may be shared with the session they come from.
#[derive(Clone)]
pub struct Rows {
    arity: usize,
    len: usize,
    list: Arc<dyn RowList>,
}

impl Rows {
    /// Of rows that have at least so many words.
    fn of<const W: usize>(arity: usize, rows: Arc<Vec<Row<W>>>) -> Self {
        Rows {
            arity,
            len: rows.len(),
            list: rows,
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[Value]> {
        self.range(0..self.len)
    }

    /// The rows at these positions; those that are not there are left out.
    pub fn range(&self, positions: std::ops::Range<usize>) -> impl Iterator<Item = &[Value]> {
        let end = positions.end.min(self.len);
        (positions.start..end).map(|position| &self.list.row(position)[..self.arity])
    }
}

impl Default for Rows {
    fn default() -> Self {
        Rows::of::<2>(0, Arc::default())
    }
}

impl PartialEq for Rows {
    fn eq(&self, other: &Self) -> bool {
        self.len == other.len && self.iter().eq(other.iter())
    }
}

impl Eq for Rows {}

impl fmt::Debug for Rows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// How one relation changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The relation.
    pub relation: RelId,
    /// Rows that hold now and did not before.
    pub added: Rows,
    /// Rows that held before and do not now.
    pub removed: Rows,
}

/// What a commit changed, in base and derived relations.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Delta {
    changes: Vec<Change>,
}

impl Delta {
    fn push(&mut self, relation: RelId, added: Rows, removed: Rows) {
        self.changes.push(Change {
            relation,
            added,
            removed,
        });
    }

    /// The relations that changed, in the order of their ids.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// How a relation changed, if it did.
    pub fn of(&self, rel: RelId) -> Option<&Change> {
        let position = self.changes.binary_search_by_key(&rel, |change| change.relation).ok()?;
        Some(&self.changes[position])
    }

    /// Whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }
}

/// What a commit did with a stratum.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StratumWork {
    /// Nothing: none of its inputs changed.
    Skipped,
    /// Followed the change of its inputs.
    Maintained(Work),
    /// Computed it from scratch: at the first commit, if the change is large, or if the stratum cannot be maintained.
    Recomputed(Work),
}

impl StratumWork {
    /// With what was done before it, for parts of bodies that are computed once.
    fn after(self, shared: Vec<StratumWork>) -> StratumWork {
        let Some(last) = shared.iter().rfind(|work| **work != StratumWork::Skipped) else {
            return self;
        };
        let maintained = matches!(last, StratumWork::Maintained(_));
        let works = shared.iter().filter_map(StratumWork::work);
        let shared = works.map(|work| work.looked_at() + work.given_up).sum();
        match self {
            StratumWork::Maintained(work) => StratumWork::Maintained(Work { shared, ..work }),
            StratumWork::Recomputed(work) => StratumWork::Recomputed(Work { shared, ..work }),
            // Its inputs changed, and what it reads of them did not.
            StratumWork::Skipped => {
                let work = Work {
                    rounds: 1,
                    shared,
                    ..Work::default()
                };
                match maintained {
                    true => StratumWork::Maintained(work),
                    false => StratumWork::Recomputed(work),
                }
            }
        }
    }

    /// What was done, unless the stratum was skipped.
    pub fn work(&self) -> Option<&Work> {
        match self {
            StratumWork::Skipped => None,
            StratumWork::Maintained(work) | StratumWork::Recomputed(work) => Some(work),
        }
    }
}

/// What it took to bring a stratum up to date.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Rounds to a fixpoint; 1 if the stratum is not recursive.
    pub rounds: usize,
    /// What its clauses did, those that ran, in order.
    pub rules: Vec<RuleWork>,
    /// If maintaining the stratum was given up: after so many rows were looked at, as many as recomputing it would take; else 0.
    /// They are not in `rules`.
    pub given_up: u64,
    /// Rows looked at for parts of bodies that clauses share and that were computed once, before this stratum; they serve later ones
    /// too. They are not in `rules`.
    pub shared: u64,
}

impl Work {
    /// Rows that scans and tests of its clauses looked at, and those for what they share.
    pub fn looked_at(&self) -> u64 {
        self.shared + self.rules.iter().map(|rule| rule.looked_at).sum::<u64>()
    }

    /// Rows that its clauses derived, repetitions included.
    pub fn derived(&self) -> u64 {
        self.rules.iter().map(|rule| rule.derived).sum()
    }
}

/// What one clause did in a commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuleWork {
    /// The clause.
    pub clause: ClauseId,
    /// Changed rows, and rows of its head in doubt, from which it was evaluated. 0 if it ran once over all rows.
    pub given: u64,
    /// Rows that its scans and tests looked at.
    pub looked_at: u64,
    /// Rows it derived, repetitions included: of those that may go, that stay nevertheless, and that come.
    pub derived: u64,
}

/// What a commit did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkLog {
    /// By position in [`Rules::strata`]; empty before the first commit.
    pub strata: Vec<StratumWork>,
}

impl WorkLog {
    /// Positions in [`Rules::strata`] of the strata that were maintained or recomputed.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let strata = self.strata.iter().enumerate();
        strata
            .filter(|(_, work)| **work != StratumWork::Skipped)
            .map(|(position, _)| position)
    }

    /// What each clause did that ran, in the order of the strata.
    pub fn rules(&self) -> impl Iterator<Item = &RuleWork> {
        self.strata
            .iter()
            .filter_map(StratumWork::work)
            .flat_map(|work| &work.rules)
    }
}

/// Why a row cannot be inserted or retracted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowError {
    /// The program has no relation with that id.
    UnknownRelation,
    /// The relation is head of a clause with a body and not input, so its rows follow from others.
    Derived {
        /// Its name.
        relation: String,
    },
    /// The row is too short or too long.
    Arity {
        /// The relation's name.
        relation: String,
        /// Its number of columns.
        expected: usize,
        /// The number of values in the row.
        found: usize,
    },
    /// A value in a column of symbols is not a symbol of the session; see [`Session::intern`].
    UnknownSymbol {
        /// The relation's name.
        relation: String,
    },
}

impl fmt::Display for RowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RowError::UnknownRelation => write!(f, "the program has no such relation"),
            RowError::Derived { relation } => write!(f, "`{relation}` is derived by rules; its rows cannot be set"),
            RowError::Arity {
                relation,
                expected,
                found,
            } => write!(f, "a row of `{relation}` has {expected} values, not {found}"),
            RowError::UnknownSymbol { relation } => {
                write!(
                    f,
                    "a row of `{relation}` has a symbol that the session has not interned"
                )
            }
        }
    }
}

impl std::error::Error for RowError {}
