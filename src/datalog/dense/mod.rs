//! The dense executor: programs over one small universe of entities, evaluated on bit words.
//!
//! Reach for [`Dense`] where the same rules are asked again and again about some dozens of entities, all facts new each time, and
//! every predicate relates at most two of them. A one-column predicate is a [`Set`]: a word with one bit for each entity. A
//! two-column predicate is a list of sets, one for each entity. What is true of the head's first variable is decided for 64 entities at
//! once; "there is" is a search that ends at the first witness; a negation is a mask.
//!
//! ```text
//! Rules --choose--> Choice (which strata) --compile--> Dense (immutable, shareable)
//!                                                        |
//!      facts: BitState::set_input, BinaryFacts --------------> BitState::run --> BitState::set, BitState::row
//! ```
//!
//! `analyse` decides which strata can be evaluated so and tells why others cannot; `body` says what a clause asks of each variable;
//! `compile` writes that as a `program`, a short list of operations on numbered sets, in which what several clauses ask is asked once;
//! `run` executes the list. Facts about pairs are asked of a [`BinaryFacts`], which may hold them ([`BitFacts`], in `facts`) or compute them when
//! asked. Answers are those of [`super::naive`] if every symbol in the facts is an entity.

mod analyse;
mod body;
mod compile;
mod facts;
mod program;
mod run;
mod sets;

pub use analyse::{Choice, Unsupported, choose};
pub use facts::BitFacts;
pub use program::{Argument, Dense, Input, List, TrackFirings};
pub use run::{BinaryFacts, BitState};
pub use sets::{Set, and, first, has, is_empty, members, without};
