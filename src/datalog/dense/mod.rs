//! The dense executor: evaluates programs over a small universe of entities with bitwise operations.
//!
//! Use [`Dense`] to evaluate the same rules repeatedly over a few dozen entities, with new facts each time and
//! predicates of one or two columns. A one-column predicate is a [`Set`] with one bit per entity. A two-column
//! predicate is a list of sets, one per entity. One operation decides a property of the head's first variable for 64
//! entities. An existential is a search that stops at the first witness, and a negation is a mask.
//!
//! ```text
//! Rules --lift--> Lifted --divide--> Division --compile--> Dense (immutable, shareable)
//!                                                             |
//!           facts: BitState::set_input, BinaryFacts --------------> BitState::run --> BitState::set, BitState::row
//! ```
//!
//! - `analyze` decides which clauses the executor supports and why it does not support others.
//! - `body` splits a clause into conditions on its variables.
//! - `count` finds bounds on counts in a body.
//! - `division` makes clauses that it does not support facts, which the relational executor derives.
//! - `condition` replaces literals on values by conditions, which the caller evaluates.
//! - `compile` translates these to a `program`: a short list of operations on numbered sets. It shares conditions
//!   between clauses.
//! - `search` finds values of one or two variables; `tree` finds values of more, with tables of what failed before.
//! - `run` executes the list.
//!
//! Binary facts come from a [`BinaryFacts`], which can store them ([`BitFacts`], in `facts`) or compute them lazily.
//! The answers equal those of [`super::naive`] if every symbol in the facts is an entity.
// Decision: docs/decisions/executors.md#d039

mod analyze;
mod body;
mod compile;
mod condition;
mod count;
mod division;
mod facts;
mod program;
mod run;
mod search;
mod sets;
mod tree;
mod values;

pub use analyze::{Construct, Unsupported, costly, obstacles};
pub use condition::{Condition, ConditionValues, EntityDraw, Lifted, TickDraw, lift};
pub use division::{Division, Handed, divide};
pub use facts::BitFacts;
pub use program::{Argument, Dense, Input, List, TrackFirings};
pub use run::BitState;
pub use search::BinaryFacts;
pub use sets::{Set, and, first, has, holding, is_empty, members, without};
pub use tree::TooManySteps;
