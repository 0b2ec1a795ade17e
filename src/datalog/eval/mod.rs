//! The relational executor: commits, joins, recursion and maintenance.
//!
//! - `exec` makes a commit, and replans clauses when the sizes of predicates have changed. `join` runs a plan, and
//!   `output` receives the rows that it derives.
//! - `word_sets` and `correlated` keep what a plan would compute again: lists of rows as bits, values of aggregates.
//! - `recursion` evaluates a recursive stratum to its fixpoint, and `maintain` updates a stratum incrementally.
//! - `table` holds a predicate and its indexes, `pending` the changes of the next commit, and `seen_bitmap` marks
//!   derived rows, as bits or by `pages` of bits.
//! - `narrow` holds loaded predicates whose rows are narrower than the program's.
//! - `groups` aggregates what a plan derives.
//! - `workers` holds the threads, and `limits` bounds the resources of a commit.
//! - `delta` and `stats` report what a commit changed and did.

pub(crate) mod calls;
mod choice;
pub(crate) mod correlated;
pub mod delta;
mod dominance;
pub(crate) mod exec;
pub(crate) mod groups;
mod growth;
pub(crate) mod join;
pub mod limits;
mod maintain;
mod narrow;
pub(crate) mod output;
mod pages;
mod pending;
mod recursion;
mod seen_bitmap;
pub mod stats;
mod table;
mod word_sets;
pub(crate) mod workers;
