//! Learns rules from demonstrations.
//!
//! An example is a state, what an ego sees, with the action taken in it. For each action in the order of precedence, the
//! learner finds clauses that hold in every example of the action and in no example of an action of lower precedence.
//! The result is a set of clauses of least cost among those found.

pub mod ask;
mod bits;
mod constraints;
mod cover;
mod examples;
mod learner;
mod problem;
mod search;
mod vocabulary;

pub use constraints::{Constraints, Violation};
pub use examples::{Contradiction, ENTITIES_MAX, Examples, State, Tally};
pub use learner::{ActionRules, LearnedClause, Settings, learn};
pub use vocabulary::{ARITY_MAX, Atom, Body, Literal, Predicate, VARIABLE_NAMES, VARIABLES_MAX, Vocabulary};
