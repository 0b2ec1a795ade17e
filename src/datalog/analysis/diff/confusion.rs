//! Maps of concepts, as the circuits of `shortcuts` read them.

use crate::analysis::diff::sat::Lit;
use crate::check::PredicateId;

/// The value that perception reports for a concept.
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

/// The possible images of each concept, and the literals that choose them.
pub(super) struct Confusion {
    /// The concepts: their positions among base predicates, and their predicates.
    pub(super) bases: Vec<(usize, PredicateId)>,
    /// The possible images of each, and the literals that choose them.
    pub(super) choices: Vec<Vec<(Image, Lit)>>,
}
