//! `{yields: lane}`: a way from the lane of the first agent must yield to one from the lane of the second.

use crate::city::CityMap;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Relation, Sight, Subject, Syntax};
use crate::yaml::read::choice;
use serde::Serialize;
use std::sync::Arc;

/// At the end of the lane of the first, some connection must yield to one that leaves the lane of the second. On a map of
/// blocks none must.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Yields;

impl PredicateKind for Yields {
    const SYNTAX: Syntax = Syntax::Keys(&["yields"], |nodes, faults| {
        choice(nodes[0], &[("lane", Yields)], faults).map(Yields::into)
    });

    fn phrase(&self) -> Phrase {
        Phrase::new("is on a lane that must yield to the lane of")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![Yields.into()]
    }
}

impl PairKind for Yields {
    type Relation = Lanes;

    const READS: [bool; 2] = [true, true];

    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        sight.map.must_yield(x.at, y.at)
    }

    fn relation(&self, map: &Arc<CityMap>) -> Lanes {
        Lanes { map: Arc::clone(map) }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

/// The fast form.
#[derive(Clone, Debug)]
pub(crate) struct Lanes {
    map: Arc<CityMap>,
}

impl Relation for Lanes {
    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        self.map.must_yield(x.at, y.at)
    }
}
