//! Datalog: from text to facts.
//!
//! What to reach for: [`Program`] to prepare rules once and share them; [`Session`] to hold facts, change them and ask what follows; [`facts`]
//! to read and print relations as text; [`explain`] for proofs; [`diff`] to compare programs; [`naive`] for the semantics in two pages.
//!
//! ```text
//! text --load--> Rules --plan--> Program (immutable, shared)
//!                                   |
//!                                Session: insert, retract --commit--> Delta (rows that came, rows that went)
//! ```
//!
//! A commit takes the net change of the inserted facts through the strata whose inputs changed, in order. The engine maintains a stratum
//! (delete and rederive) or recomputes it, whichever is cheaper ([`Strategy`]); a stratum whose result stays the same stops the change
//! there. [`Session::work`] says what was done. [`naive`] is the specification: after every commit a session holds exactly the facts that
//! `naive` derives from the same input.
//!
//! This room does not know what a city, an agent or an ego is. It does no I/O, reads no clock and is deterministic.

mod analysis;
mod check;
mod codes;
pub mod dense;
mod eval;
pub mod explain;
pub mod facts;
pub mod naive;
mod plan;
mod plan_printer;
mod program;
mod row;
mod session;
mod syntax;
mod value;
mod workspace;

pub use analysis::{constraints, diff};
pub use check::{
    Atom, Clause, ClauseId, Column, Comparing, Constraint, DeclaredConstraint, Directive, Edb, Literal, RelId,
    Relation, RowFormat, RowPlace, Rules, Stratum, Term, Type, TypeId, VarId,
};
pub use codes::CODES;
pub use eval::delta::{Delta, RelationChange, Rows};
pub use eval::limits::{EvalError, Limits};
pub use eval::stats::{EvalEvent, EvalStats, RuleStats, Strategy, StratumStats, WorkCounts};
pub use eval::workers::Threads;
#[cfg(feature = "optimizer")]
pub use plan::optimize;
pub use program::{Options, Program};
pub use session::{RowError, Session};
pub use syntax::ast::{self, BaseType, Comparison, MarkKind};
pub use syntax::functor::{AggregateOp, Functor};
pub use syntax::{DIRECTIVES, Parsed, format, is_name, parse, print, quoted};
pub use value::{Patterns, Value, parse as parse_value, print_float};
pub use workspace::{FactPattern, FactRow, Loaded, Workspace, is_complete, load, load_with};
