//! `higher-priority`: the first has the smaller priority number.

use crate::city::CityMap;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Relation, Sight, Subject, Syntax};
use serde::Serialize;
use std::sync::Arc;

/// The first has the smaller priority number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct HigherPriority;

impl PredicateKind for HigherPriority {
    const SYNTAX: Syntax = Syntax::Word("higher-priority", || HigherPriority.into());

    fn phrase(&self) -> Phrase {
        Phrase::new("has priority over")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![HigherPriority.into()]
    }
}

impl PairKind for HigherPriority {
    type Relation = HigherPriority;

    const READS: [bool; 2] = [false, false];

    fn holds(&self, _: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        x.priority < y.priority
    }

    fn relation(&self, _: &Arc<CityMap>) -> HigherPriority {
        HigherPriority
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

impl Relation for HigherPriority {
    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        x.priority < y.priority
    }
}
