//! The relational executor: commits, joins, recursion and maintenance.
//!
//! `exec` makes a commit, `join` runs a plan, `recursion` runs a recursive stratum to its fixpoint, and `maintain` brings a stratum up to
//! date from a change. `adapt` has clauses planned again when the sizes of relations have changed; `seen` marks rows that were derived
//! before; `noted` holds the changes of the next commit, `table` a relation and its indexes; `workers` are the threads; `limits` bounds what
//! a commit may take; `delta` and `stats` say what it changed and did.

mod adapt;
pub mod delta;
pub(crate) mod exec;
mod join;
pub mod limits;
mod maintain;
mod pending;
mod recursion;
mod seen_bitmap;
pub mod stats;
mod table;
pub(crate) mod workers;
