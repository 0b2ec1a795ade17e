//! `{same: intersection}`: both are at or in the same intersection.

use crate::city::CityMap;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Reach, Relation, Sight, Subject, Syntax};
use crate::yaml::read::choice;
use serde::Serialize;
use std::sync::Arc;

/// Both are at or in the same intersection, as `at-intersection` and `in-intersection` define it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SameIntersection;

impl PredicateKind for SameIntersection {
    const SYNTAX: Syntax = Syntax::Keys(&["same"], |nodes, faults| {
        choice(nodes[0], &[("intersection", SameIntersection)], faults).map(SameIntersection::into)
    });

    fn phrase(&self) -> Phrase {
        Phrase::new("is at or inside the same intersection as")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![SameIntersection.into()]
    }
}

impl PairKind for SameIntersection {
    type Relation = Junctions;

    const READS: [bool; 2] = [true, true];

    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let intersection = |agent: &Subject| {
            let at = sight.map.at_intersection(agent.kind, agent.at);
            at.or_else(|| sight.map.in_intersection(agent.at))
        };
        intersection(x).is_some_and(|number| intersection(y) == Some(number))
    }

    fn relation(&self, map: &Arc<CityMap>) -> Junctions {
        Junctions {
            reach: map.intersection_extent().min(Reach::FARTHEST),
            map: Arc::clone(map),
        }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

/// The intersections of a map, each at most `reach` cells from side to side.
#[derive(Clone, Debug)]
pub(crate) struct Junctions {
    map: Arc<CityMap>,
    reach: i32,
}

impl Relation for Junctions {
    #[inline]
    fn reach_back(&self) -> Reach {
        Reach::Within([self.reach; 4])
    }

    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let [one, other] = [x, y].map(|agent| self.map.intersection(agent.kind, agent.at));
        one.is_some() && one == other
    }
}
