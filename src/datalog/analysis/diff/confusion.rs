//! What perception reports in place of concepts.

use crate::analysis::diff::sat::Lit;
use crate::check::PredicateId;

/// What perception reports in place of a concept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Image {
    /// A concept, by its position in [`Shortcuts::concepts`](super::shortcuts::Shortcuts::concepts), or its negation.
    Concept {
        /// The position.
        position: usize,
        /// Whether it is negated.
        negated: bool,
    },
    /// Always or never.
    Constant(bool),
}

/// What perception reports in place of concepts.
pub(super) struct Confusion {
    /// The concepts: their positions among base predicates, and their predicates.
    pub(super) bases: Vec<(usize, PredicateId)>,
    /// The possible images of each, and the literals that choose them.
    pub(super) choices: Vec<Vec<(Image, Lit)>>,
}
