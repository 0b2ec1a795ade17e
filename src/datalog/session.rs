//! Facts, their changes, and what follows from them.

use std::fmt;

use crate::cancel::Cancel;
use crate::datalog::check::{ClauseId, RelId, Relation};
use crate::datalog::eval::delta::Delta;
use crate::datalog::eval::exec::{self, CommitOptions, Store};
use crate::datalog::eval::limits::{EvalError, Limits};
use crate::datalog::eval::stats::{EvalEvent, EvalStats, Strategy};
use crate::datalog::eval::workers::{Threads, Workers};
use crate::datalog::program::Program;
use crate::datalog::syntax::ast::BaseType;
use crate::datalog::value::Value;
use crate::symbol::Symbols;

/// Facts and what follows from them.
///
/// A fact passes through these stages: it is *noted* by [`insert`](Session::insert) or [`retract`](Session::retract) and
/// visible to nobody; [`commit`](Session::commit) makes it *true* (or not true any more) together with all that follows. All
/// questions are answered as of the last commit.
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
    /// The relation, if rows of it can be set.
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

    /// A session without inserted facts and without a commit: every relation is empty, also those with facts in the text.
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
        Ok(relation.edb.unwrap_or(rel))
    }

    /// Makes what was noted true and derives what follows. Says exactly what became true and what stopped being true, in every
    /// relation. If it fails, the session is as before the call, with the same changes noted; see
    /// [`rollback`](Session::rollback).
    pub fn commit(&mut self) -> Result<Delta, EvalError> {
        self.run_commit(None, &Cancel::never())
    }

    /// Commits and calls `watch` on the calling thread when the evaluation of a clause begins and ends. The engine
    /// reads no clock; `watch` may.
    pub fn commit_watched(&mut self, watch: &dyn Fn(EvalEvent)) -> Result<Delta, EvalError> {
        self.run_commit(Some(watch), &Cancel::never())
    }

    /// Cancellable variant of [`commit`](Session::commit). On cancellation the session is as before the call, with the
    /// same changes noted.
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
    pub fn work(&self) -> &EvalStats {
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
