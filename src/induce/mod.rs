//! Learns rules from demonstrations.
//!
//! An example is a state, what an ego sees, with the action taken in it. For each action in the order of precedence,
//! the learner finds clauses that together cover the examples of the action and hold in no example of an action of
//! lower precedence. The result is a set of clauses of least cost among those found. If some examples may have a wrong
//! action, clauses may hold in a few negative examples and leave a few positive ones: see [`Noise`].

pub mod ask;
mod beam;
mod bits;
mod constraints;
mod cover;
mod examples;
mod hitting_set;
mod learner;
mod noise;
mod problem;
mod relational;
mod rules;
mod search;
mod support;
#[cfg(test)]
mod tests;
mod vocabulary;
mod weights;

pub use constraints::{Constraints, Violation};
pub use examples::{Contradiction, ENTITIES_MAX, Examples, State, Tally};
pub use learner::{learn, learn_with};
pub use noise::NOISE_MAX;
pub use relational::{Database, derived, learn_relational, undecided};
pub use rules::{ActionRules, LearnedClause, LearnedRules, Noise, Progress, Settings};
pub use support::{ClauseSupport, Conflict, Support, support};
pub use vocabulary::{
    ARITY_MAX, Atom, Body, LITERAL_COST, Link, Literal, Predicate, VARIABLE_NAMES, VARIABLES_MAX, Vocabulary, tuples,
};
