//! Sessions: facts, their changes and what follows from them.

use std::fmt;

use crate::cancel::Cancel;
use crate::check::{ClauseId, Literal, RelId, Relation};
use crate::eval::delta::Delta;
use crate::eval::exec::{self, CommitOptions, Store};
use crate::eval::limits::{EvalError, Limits};
use crate::eval::output::Abort;
use crate::eval::stats::{EvalEvent, EvalStats, Strategy};
use crate::eval::workers::{Threads, Workers};
use crate::program::Program;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use crate::syntax::functor::AggregateOp;
use crate::value::Value;

/// Facts and everything that the rules derive from them.
///
/// [`insert`](Session::insert) and [`retract`](Session::retract) record pending changes, which no query sees.
/// [`commit`](Session::commit) applies all of them at once and updates the derived relations. Every query answers as of
/// the last commit.
pub struct Session {
    pub(super) program: Program,
    symbols: Symbols,
    pub(super) store: Box<dyn Store>,
    limits: Limits,
    strategy: Strategy,
    workers: Workers,
    work: EvalStats,
}

impl Program {
    /// Returns the relation if the caller may set its rows.
    fn base(&self, rel: RelId) -> Result<&Relation, RowError> {
        let relation = self.rules().relations.get(rel.index());
        let relation = relation.ok_or(RowError::UnknownRelation)?;
        if relation.derived && relation.edb.is_none() {
            return Err(RowError::Derived {
                relation: relation.name.clone(),
            });
        }
        Ok(relation)
    }

    /// Creates a session without inserted facts.
    ///
    /// Every relation is empty until the first commit, even one with facts in the source.
    pub fn session(&self) -> Session {
        Session {
            store: exec::store(&self.0),
            symbols: self.rules().symbols.clone(),
            program: self.clone(),
            limits: Limits::default(),
            strategy: Strategy::Auto,
            workers: Workers::default(),
            work: EvalStats::default(),
        }
    }
}

impl Session {
    /// Returns the program that the session runs.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Returns the symbol table: the symbols of the program and those interned in this session.
    pub fn symbols(&self) -> &Symbols {
        &self.symbols
    }

    /// Returns the word for a symbol, for use in rows of this session.
    pub fn intern(&mut self, text: &str) -> Value {
        Value(self.symbols.intern(text).0)
    }

    /// Sets the limits of a commit. A commit that would exceed one fails.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
    }

    /// Returns the limits of a commit.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Returns the bytes of the rows, indexes, pending changes and symbols.
    pub fn bytes(&self) -> u64 {
        self.store.bytes() + self.symbols.bytes()
    }

    /// Returns the bytes that the limit leaves for work on the committed rows.
    pub(crate) fn bytes_left(&self) -> u64 {
        self.limits.bytes.saturating_sub(self.bytes())
    }

    /// Sets the number of evaluation threads; the default is one.
    ///
    /// The number changes neither rows nor their order, deltas or statistics.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn set_threads(&mut self, threads: Threads) -> std::io::Result<()> {
        self.workers = Workers::new(threads)?;
        Ok(())
    }

    /// Sets how commits update strata; the default is [`Strategy::Auto`].
    ///
    /// Other strategies serve tests and measurements.
    pub fn set_strategy(&mut self, strategy: Strategy) {
        self.strategy = strategy;
    }

    /// Marks a row to hold from the next commit on. The last change of a row before the commit wins.
    ///
    /// # Errors
    /// If the row does not fit the relation, or rules alone define the relation.
    pub fn insert(&mut self, rel: RelId, row: &[Value]) -> Result<(), RowError> {
        let rel = self.check(rel, row)?;
        self.store.change(rel, row, true);
        Ok(())
    }

    /// Marks many rows to hold from the next commit on; faster than repeated [`insert`](Session::insert).
    ///
    /// # Errors
    /// If one of the rows is invalid. In that case the call changes nothing.
    pub fn insert_all(
        &mut self,
        rel: RelId,
        rows: impl IntoIterator<Item = impl AsRef<[Value]>>,
    ) -> Result<(), RowError> {
        /// Words per call of the store.
        const PART: usize = 1 << 12;
        let (relation, known) = (self.program.base(rel)?, self.symbols.len());
        let (to, arity) = (relation.edb.unwrap_or(rel), relation.arity());
        let symbolic = relation.columns.iter().any(|column| column.base == BaseType::Symbol);
        let before = self.store.pending(to);
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

    /// Marks a row not to hold from the next commit on.
    ///
    /// This undoes an [`insert`](Session::insert), not a rule: a fact of the source holds nevertheless.
    ///
    /// # Errors
    /// If the row does not fit the relation, or rules alone define the relation.
    pub fn retract(&mut self, rel: RelId, row: &[Value]) -> Result<(), RowError> {
        let rel = self.check(rel, row)?;
        self.store.change(rel, row, false);
        Ok(())
    }

    /// Discards the changes since the last commit.
    pub fn rollback(&mut self) {
        self.store.rollback();
    }

    /// Returns the relation that stores the row, once the row is valid.
    fn check(&self, rel: RelId, row: &[Value]) -> Result<RelId, RowError> {
        let relation = self.program.base(rel)?;
        check_row(relation, row, self.symbols.len())?;
        Ok(relation.edb.unwrap_or(rel))
    }

    /// Applies the pending changes, derives what follows and returns the difference.
    ///
    /// The [`Delta`] lists, for every relation, exactly the rows that became true and those that became false.
    ///
    /// # Errors
    /// If the evaluation exceeds a limit. In that case the session stays as before the call, with the same changes
    /// pending; see [`rollback`](Session::rollback).
    pub fn commit(&mut self) -> Result<Delta, EvalError> {
        self.run_commit(None, &Cancel::never())
    }

    /// Commits and calls `watch` on the calling thread whenever the evaluation of a clause begins or ends.
    ///
    /// The engine reads no clock; the callback may.
    ///
    /// # Errors
    /// As [`commit`](Session::commit).
    pub fn commit_watched(&mut self, watch: &dyn Fn(EvalEvent)) -> Result<Delta, EvalError> {
        self.run_commit(Some(watch), &Cancel::never())
    }

    /// Cancellable variant of [`commit`](Session::commit). On cancellation the session is as before the call, with the
    /// same changes pending.
    ///
    /// The calling thread polls `cancel`: up to a few thousand times a second while it evaluates rules, less often
    /// while it sorts rows.
    ///
    /// # Errors
    /// [`EvalError::Cancelled`] on cancellation.
    pub fn commit_with(&mut self, cancel: &Cancel) -> Result<Delta, EvalError> {
        self.run_commit(None, cancel)
    }

    fn run_commit(&mut self, watch: Option<&dyn Fn(EvalEvent)>, cancel: &Cancel) -> Result<Delta, EvalError> {
        let options = CommitOptions {
            strategy: self.strategy,
            limits: self.limits,
            workers: &self.workers,
            watch,
            cancel,
        };
        let known = self.symbols.len();
        match self.store.commit(&self.program.0, &self.symbols, options) {
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

    /// Returns whether the row holds.
    pub fn contains(&self, rel: RelId, row: &[Value]) -> bool {
        self.arity(rel) == Some(row.len()) && self.store.contains(rel, row)
    }

    /// Returns the aggregate over the rows of a relation that begin with `key`, if that relation [is
    /// aggregated](Program::is_aggregated).
    pub(crate) fn group(&self, rel: RelId, key: &[Value], op: AggregateOp) -> Option<Value> {
        self.store.group(rel, key, op)
    }

    /// Returns the value of a correlated aggregate for these parameters, and the number of rows scanned. It stops after
    /// about `budget` rows, or if it takes more than `bytes`.
    pub(crate) fn correlated(
        &self,
        aggregate: &Literal,
        parameters: &[Value],
        (budget, bytes): (u64, u64),
        cancel: &Cancel,
    ) -> (Result<Option<Value>, Abort>, u64) {
        (self.store).correlated(aggregate, parameters, &self.symbols, (budget, bytes, cancel))
    }

    /// Returns the rows that hold, in the order of their words. For symbols this is the order of interning. A relation
    /// that [is aggregated](Program::is_aggregated) has none.
    pub fn rows(&self, rel: RelId) -> impl Iterator<Item = &[Value]> {
        let arity = self.arity(rel).unwrap_or(0);
        (0..self.len(rel)).map(move |position| &self.store.row(rel, position)[..arity])
    }

    /// Returns the row at a position below [`Session::len`].
    pub(crate) fn row(&self, rel: RelId, position: usize) -> &[Value] {
        &self.store.row(rel, position)[..self.arity(rel).unwrap_or(0)]
    }

    /// Returns the number of rows that hold.
    pub fn len(&self, rel: RelId) -> usize {
        self.arity(rel).map_or(0, |_| self.store.len(rel))
    }

    /// Returns whether no row of the relation holds.
    pub fn is_empty(&self, rel: RelId) -> bool {
        self.len(rel) == 0
    }

    /// The number of columns of a relation whose rows are stored.
    fn arity(&self, rel: RelId) -> Option<usize> {
        let relation = self.program.rules().relations.get(rel.index())?;
        (!self.program.is_aggregated(rel)).then(|| relation.arity())
    }

    /// Returns the distinct rows that one clause derives from the current facts, sorted.
    ///
    /// For a fact of the source this is the fact itself. Several clauses may derive the same row. For a relation
    /// that [is aggregated](Program::is_aggregated) the result is empty.
    pub fn fired(&self, clause: ClauseId) -> Vec<Vec<Value>> {
        if clause.index() < self.program.rules().clauses.len() {
            let bytes = self.bytes_left() / 4;
            self.store.fired(&self.program.0, &self.symbols, clause, bytes)
        } else {
            Vec::new()
        }
    }

    /// Returns the statistics of the last successful commit.
    pub fn work(&self) -> &EvalStats {
        &self.work
    }
}

/// Checks that the row fits the relation. `known` is the number of interned symbols.
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

/// The reason why a session refuses a row.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RowError {
    /// The program has no relation with that id.
    UnknownRelation,
    /// The relation is derived: clauses with bodies define its rows, and it is no input.
    Derived {
        /// The relation's name.
        relation: String,
    },
    /// The row has the wrong number of values.
    Arity {
        /// The relation's name.
        relation: String,
        /// Its number of columns.
        expected: usize,
        /// The number of values in the row.
        found: usize,
    },
    /// A value in a symbol column is no symbol of the session; see [`Session::intern`].
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
