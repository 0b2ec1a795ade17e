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
//! A commit looks at the net change of the inserted facts and evaluates, in order, the strata whose inputs changed; a stratum
//! whose result stays the same stops the change there. [`Session::work`] tells what was done. [`naive`] is the specification:
//! after every commit a session holds exactly what `naive` derives from the same facts.
//!
//! Inside: `plan` orders the literals of each clause and chooses indexes, once; `join` runs a plan; `exec` keeps relations and
//! runs strata to their fixpoint; `row` has the sorted lists all this works on.
//!
//! This module refuses to know what a city, an agent or an ego is. It does no I/O and is deterministic.

mod exec;
pub mod facts;
mod join;
pub mod naive;
mod plan;
mod row;

use crate::diag::Diagnostic;
use crate::lang::{BaseType, ClauseId, RelId, Rules, Value};
use crate::symbol::Symbols;
use exec::Store;
use plan::Plans;
use std::fmt;
use std::sync::Arc;

/// Rules with a plan for every clause. Cheap to clone; many sessions can run one program.
#[derive(Clone, Debug)]
pub struct Program(Arc<Compiled>);

#[derive(Debug)]
struct Compiled {
    rules: Rules,
    plans: Plans,
}

impl Program {
    /// Plans the evaluation of checked rules. Fails only if a predicate has more than 32 columns or a clause more than 128
    /// variables or literals.
    pub fn new(rules: Rules) -> Result<Program, Diagnostic> {
        let plans = Plans::new(&rules)?;
        Ok(Program(Arc::new(Compiled { rules, plans })))
    }

    /// The rules.
    pub fn rules(&self) -> &Rules {
        &self.0.rules
    }

    /// The predicate of that name.
    pub fn relation(&self, name: &str) -> Option<RelId> {
        self.0.rules.relation(name)
    }

    /// A session without inserted facts and without a commit: every relation is empty, also those with facts in the text.
    pub fn session(&self) -> Session {
        Session {
            store: exec::store(&self.0),
            symbols: self.0.rules.symbols.clone(),
            program: self.clone(),
            limit: Session::DERIVED_ROWS_MAX,
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
    limit: usize,
    work: WorkLog,
}

impl Session {
    /// The limit on derived rows that a session begins with.
    pub const DERIVED_ROWS_MAX: usize = 100_000_000;

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

    /// Sets how many rows all derived relations together may have; a commit that would pass it fails. It also bounds the memory
    /// of an evaluation.
    pub fn set_limit(&mut self, derived_rows: usize) {
        self.limit = derived_rows;
    }

    /// Notes that the row holds from the next commit on. Noting both for one row, the last one counts.
    pub fn insert(&mut self, rel: RelId, row: &[Value]) -> Result<(), RowError> {
        let rel = self.check(rel, row)?;
        self.store.change(rel, row, true);
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
        let Some(relation) = self.program.rules().relations.get(rel.index()) else {
            return Err(RowError::UnknownRelation);
        };
        if relation.derived && relation.given.is_none() {
            return Err(RowError::Derived {
                relation: relation.name.clone(),
            });
        }
        if relation.arity() != row.len() {
            return Err(RowError::Arity {
                relation: relation.name.clone(),
                expected: relation.arity(),
                found: row.len(),
            });
        }
        let known = self.symbols.len();
        let mut columns = relation.columns.iter().zip(row);
        if columns.any(|(column, value)| column.base == BaseType::Symbol && value.0 as usize >= known) {
            return Err(RowError::UnknownSymbol {
                relation: relation.name.clone(),
            });
        }
        Ok(relation.given.unwrap_or(rel))
    }

    /// Makes what was noted true and derives what follows. Says exactly what became true and what stopped being true, in every
    /// relation. If it fails, the session is as before the call, with the same changes noted; see
    /// [`rollback`](Session::rollback).
    pub fn commit(&mut self) -> Result<Delta, EvalError> {
        let (delta, work) = self.store.commit(&self.program.0, &self.symbols, self.limit)?;
        self.work = work;
        Ok(delta)
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

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let relations = self.program.rules().relations.iter().zip(0..);
        f.debug_map()
            .entries(relations.map(|(relation, rel)| (&relation.name, self.len(RelId(rel)))))
            .finish()
    }
}

/// Rows of one relation, sorted by their words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rows {
    arity: usize,
    len: usize,
    words: Vec<Value>,
}

impl Rows {
    fn with_capacity(arity: usize, rows: usize) -> Self {
        Rows {
            arity,
            len: 0,
            words: Vec::with_capacity(arity * rows),
        }
    }

    fn push(&mut self, row: &[Value]) {
        self.words.extend_from_slice(row);
        self.len += 1;
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
        (0..self.len).map(|position| &self.words[position * self.arity..(position + 1) * self.arity])
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StratumWork {
    /// Nothing: none of its inputs changed.
    Skipped,
    /// Evaluated it from scratch.
    Evaluated {
        /// Semi-naive rounds; 1 if the stratum is not recursive.
        rounds: usize,
        /// Rows that clauses derived, repetitions included.
        considered: u64,
    },
}

/// What a commit did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkLog {
    /// By position in [`Rules::strata`]; empty before the first commit.
    pub strata: Vec<StratumWork>,
}

impl WorkLog {
    /// Positions in [`Rules::strata`] of the strata that were evaluated.
    pub fn evaluated(&self) -> impl Iterator<Item = usize> {
        let strata = self.strata.iter().enumerate();
        strata
            .filter(|(_, work)| **work != StratumWork::Skipped)
            .map(|(position, _)| position)
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

/// Why a commit failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EvalError {
    /// The derived relations together have more rows than allowed; see [`Session::set_limit`].
    TooManyRows {
        /// The limit.
        limit: usize,
        /// A clause of the stratum where it was passed.
        clause: ClauseId,
    },
}

impl fmt::Display for EvalError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EvalError::TooManyRows { limit, .. } => write!(f, "the rules derive more than {limit} rows"),
        }
    }
}

impl std::error::Error for EvalError {}
