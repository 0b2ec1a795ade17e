//! `at-intersection`, `in-intersection`: the agent's position relative to an intersection.

use crate::city::{AgentKind, Cell, CityMap, Junction};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{LocalKind, Phrase, PredicateKind, Syntax};
use serde::Serialize;

/// A car is on an entrance line or a pedestrian on an outline of an intersection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct AtIntersection;

/// The agent is inside an intersection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct InIntersection;

impl PredicateKind for AtIntersection {
    const SYNTAX: Syntax = Syntax::Word("at-intersection", || AtIntersection.into());

    fn phrase(&self) -> Phrase {
        Phrase::new("is at the edge of an intersection").meaning(
            "A car is at the edge of an intersection when it is on the line where it would enter; a pedestrian, when it \
             is on any side of the intersection.",
        )
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![AtIntersection.into()]
    }
}

impl LocalKind for AtIntersection {
    fn holds(&self, map: &CityMap, kind: AgentKind, at: Cell) -> bool {
        map.at_intersection(kind, at).is_some()
    }

    fn holds_on(&self, junction: Junction, kind: AgentKind) -> bool {
        junction.is_at(kind)
    }
}

impl PredicateKind for InIntersection {
    const SYNTAX: Syntax = Syntax::Word("in-intersection", || InIntersection.into());

    fn phrase(&self) -> Phrase {
        Phrase::new("is inside an intersection")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![InIntersection.into()]
    }
}

impl LocalKind for InIntersection {
    fn holds(&self, map: &CityMap, _kind: AgentKind, at: Cell) -> bool {
        map.in_intersection(at).is_some()
    }

    fn holds_on(&self, junction: Junction, _kind: AgentKind) -> bool {
        junction.is_inside()
    }
}
