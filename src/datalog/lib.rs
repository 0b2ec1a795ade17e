//! An incremental Datalog engine: facts come and go, and what follows from them is maintained.
//!
//! Rules are written in a dialect of Soufflé, with stratified negation, aggregates, expressions and typed columns.
//!
//! ```
//! use logicity_datalog::Program;
//!
//! let program = Program::parse(
//!     ".decl edge(x: number, y: number)
//!      .input edge
//!      .decl path(x: number, y: number)
//!      path(x, y) :- edge(x, y).
//!      path(x, z) :- path(x, y), edge(y, z).",
//! )?;
//! let mut session = program.session();
//! session.insert("edge", (1, 2))?;
//! session.insert("edge", (2, 3))?;
//! session.commit()?;
//! let paths: Vec<(i64, i64)> = session.rows("path")?.collect();
//! assert_eq!(paths, [(1, 2), (1, 3), (2, 3)]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What to use
//!
//! - [`Program`]: loads, checks and plans rules once; many sessions share it.
//! - [`Session`]: holds facts, commits changes and answers queries. Rows are tuples of Rust values, or slices of
//!   [`Value`]s, which take no conversion.
//! - [`diag`]: the errors and warnings of rules, with their places.
//! - [`facts`]: reads and writes predicates as text and as JSON.
//! - [`export`]: writes rules for other engines, as plain Soufflé and as SQL.
//! - [`explain`]: proves why a fact holds, and shows why another one does not.
//! - [`diff`]: compares two rule sets, and proves them equivalent or finds a difference.
//! - [`Workspace`]: edits a program and runs ad hoc queries.
//! - [`dense`]: evaluates rules on bit sets, for a few dozen entities and entirely new facts each time.
//! - [`rewrite`]: unfolds inline predicates and restricts others to the rows that the outputs need.
//! - [`naive`]: the specification; a short, slow evaluator.
//!
//! # The life of a program
//!
//! ```text
//! text --load--> Rules --plan--> Program (immutable, shared)
//!                                   |
//!                                Session: insert, retract --commit--> Delta (rows added, rows removed)
//! ```
//!
//! 1. [`Program::parse`] parses and checks rules, and plans every clause. [`Program::load`] also reads what they include
//!    and returns warnings. [`Program::new`] plans rules that [`load`] checked.
//! 2. [`Program::session`] creates an empty [`Session`]. Its first commit also derives what follows from facts in the
//!    text.
//! 3. [`Session::insert`] and [`Session::retract`] record changes of base predicates. No query sees them yet.
//! 4. [`Session::commit`] applies the changes and updates the derived predicates, or fails and changes nothing.
//!    The [`Delta`] it returns lists the added and removed rows of every predicate, base and derived.
//!
//! ```
//! use logicity_datalog::{Program, StratumStats};
//!
//! let program = Program::parse(
//!     ".decl road, closed(x: number, y: number)
//!      .input road, closed
//!      .decl open(x: number, y: number)
//!      open(x, y) :- road(x, y), !closed(x, y).",
//! )?;
//! let mut session = program.session();
//! session.insert_all("road", [(1, 2), (1, 3)])?;
//! session.commit()?;
//! assert!(session.contains("open", (1, 2)));
//!
//! session.insert("closed", (1, 2))?;
//! let delta = session.commit()?;
//! let open = delta.of(program.predicate("open").unwrap()).unwrap();
//! assert_eq!(session.decode::<(i64, i64)>("open", &open.removed)?.collect::<Vec<_>>(), [(1, 2)]);
//!
//! // A commit without a net change evaluates nothing.
//! session.retract("closed", (1, 2))?;
//! session.insert("closed", (1, 2))?;
//! assert!(session.commit()?.is_empty());
//! assert!(session.work().strata.iter().all(|stratum| *stratum == StratumStats::Skipped));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Ticks
//!
//! Temporal operators such as `once[0,5] p(x)` ask what held in earlier ticks. [`Session::advance`] begins the next tick
//! with the pending changes and commits them. [`Session::commit`] stays in the present tick; later ticks read the state
//! after its last commit. A session remembers what a window of its rules can still see and forgets the rest.
//!
//! # What is incremental
//!
//! A commit visits the strata in order and skips every stratum whose inputs did not change. It updates any other
//! stratum in one of two ways, whichever promises to scan fewer rows ([`Strategy`] overrides the choice):
//!
//! - *Maintain*: delete and rederive (DRed). The work depends on the change and on the rows that join with it.
//! - *Recompute*: semi-naive evaluation from scratch.
//!
//! If the result of a stratum stays the same, the change stops there. A commit also copies every predicate that changes,
//! in time proportional to its size.
//!
//! [`Session::work`] reports the strata and rules that the last commit evaluated, with the numbers of rows. After every
//! commit a session holds exactly the facts that [`naive`] derives from the same input.
//!
//! Rules are fixed: to change them, load a new program and insert the facts into a new session.
//!
//! # Limits
//!
//! - A predicate has at most 32 columns; a clause has at most 128 variables and 128 literals ([`Program::new`]).
//! - A stratum with a clause of more than 24 literals is recomputed, never maintained.
//! - Numbers have 32 bits, or 64 ([`Workspace::set_word_size`]). Whole numbers wrap around.
//! - A commit stays within [`Limits`]: by default 10⁸ derived rows, 10¹¹ scanned rows and 4 GiB. Beyond that it fails
//!   with an [`EvalError`], and the session stays as it was. The limits count work, so the outcome does not depend on
//!   time.
//! - Lattices and user-defined aggregates of Soufflé are not supported. The checker reports them with the code
//!   `unsupported`.
//!
//! The engine performs no I/O, reads no clock and is deterministic: threads ([`Session::set_threads`]) change neither
//! rows nor their order. It knows nothing of cities, egos or actions.
//!
//! The feature `optimizer` simplifies clauses by equality saturation before planning; without it, [`Options::optimize`]
//! has no effect.

mod aggregate;
mod analysis;
pub mod cancel;
#[cfg(test)]
#[path = "../../tests/cases.rs"]
mod cases;
mod chance;
mod check;
pub mod codes;
mod component;
mod convert;
pub mod dense;
pub mod diag;
mod diagram;
mod eqrel;
mod eval;
pub mod explain;
pub mod export;
pub mod facts;
pub mod files;
mod history;
mod marginals;
pub mod naive;
mod plan;
mod plan_printer;
mod program;
mod record;
pub mod rewrite;
mod row;
mod session;
mod snapshot;
mod spans;
pub mod symbol;
mod syntax;
mod threads;
mod value;
mod workspace;

pub use analysis::{constraints, diff};
pub use check::{
    Atom, Clause, ClauseId, Column, Comparing, Constraint, DeclaredConstraint, Directive, Draw, Function, FunctorBatch,
    FunctorError, InputPolicy, Literal, Numbering, Past, PastOperator, Predicate, PredicateId, RecordShape,
    RowEncoding, RowFormat, RowPlace, Rules, Stratum, Term, Type, TypeId, UserFunctor, VarId, drawn_probabilities,
};
pub use convert::{AsPredicate, FromRow, FromValue, IntoRow, RowError, ToValue};
pub use eval::delta::{Delta, PredicateChange, Rows};
pub use eval::limits::{EvalError, Limits};
pub use eval::stats::{EvalEvent, EvalStats, RuleStats, Strategy, StratumStats, WorkCounts};
pub use eval::workers::Threads;
pub use marginals::{
    CircuitCompiler, CircuitOptions, FactProof, Inexact, MarginalOptions, Marginals, Probability, ProbabilityCircuit,
    RandomVariable,
};
#[cfg(feature = "optimizer")]
pub use plan::optimize;
pub use program::{Options, Program, ProgramError};
pub use session::Session;
pub use snapshot::SnapshotError;
pub use syntax::ast::{self, BaseType, Comparison, MarkKind};
pub use syntax::functor::{AggregateOp, Functor};
pub use syntax::{
    DIRECTIVES, FULL_STOP, Parsed, Preprocessing, TokenKind, format, is_name, parse, print, quoted, tokens,
};
pub use value::{Patterns, Value, parse as parse_value, parse_in, print_float, shortest_float};
pub use workspace::{Declaration, FactPattern, FactRow, Loaded, Workspace, is_complete, load, load_with};

/// What the crate `logicity` shares with the engine. No part of the interface: it may change in any version.
#[doc(hidden)]
pub mod internal {
    pub use crate::chance::{hash as symbol_hash, word as chance_word};
    pub use crate::check::shapes;
    pub use crate::convert::{record_of_text, record_word};
    pub use crate::eval::limits::size;
    pub use crate::spans::Spans;
    pub use crate::value::{NIL, record_fields, record_source, shortened, shown_number, whole_record};
    pub use crate::workspace::moved;

    pub mod threads {
        pub use crate::threads::{Pool, start};
    }
}

/// The examples of the README, which are tested like those of the documentation.
#[cfg(doctest)]
#[doc = include_str!("README.md")]
pub struct Readme;
