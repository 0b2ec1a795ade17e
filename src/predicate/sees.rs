//! `Sees`, which every scenario has: the second is in the field of view of the first. It is the only reflexive
//! predicate.

use crate::city::{AgentKind, CityMap, Heading, field_of_view, view_reach};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Reach, Relation, Sight, Subject, Syntax};
use serde::Serialize;
use std::sync::Arc;

/// The second is in the field of view of the first. Every agent sees itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Sees;

impl PredicateKind for Sees {
    const SYNTAX: Syntax = Syntax::Always;

    fn phrase(&self) -> Phrase {
        Phrase::new("sees").meaning("Every agent sees itself.")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![Sees.into()]
    }
}

impl PairKind for Sees {
    type Relation = Sees;

    const READS: [bool; 2] = [true, false];

    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        field_of_view(x.at, x.heading, sight.half_width, sight.map).contains(y.at)
    }

    fn relation(&self, _: &Arc<CityMap>) -> Sees {
        Sees
    }

    fn horizon(&self, half_width: u32) -> f64 {
        f64::from(half_width)
    }
}

impl Relation for Sees {
    const REFLEXIVE: bool = true;

    const FILLS_REACH: bool = true;

    #[inline]
    fn reach(&self, views: &Views, _: AgentKind, heading: Option<Heading>) -> Reach {
        Reach::Within(views.of(heading))
    }

    #[inline]
    fn test(&self, _: &Subject, _: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        true
    }
}

/// The numbers of cells that agents see up, down, left and right: without a heading, and for each heading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Views([[i32; 4]; 5]);

impl Views {
    /// Computes the views for a field of view of this half-width in cells.
    pub fn new(half_width: u32) -> Views {
        let reach = |heading| view_reach(heading, half_width).map(|cells| cells.min(Reach::FARTHEST));
        let [left, right, up, down] = Heading::ALL.map(|heading| reach(Some(heading)));
        Views([reach(None), left, right, up, down])
    }

    /// Returns the view of an agent with this heading.
    #[inline]
    pub fn of(&self, heading: Option<Heading>) -> [i32; 4] {
        self.0[heading.map_or(0, |heading| heading as usize + 1)]
    }

    /// Returns the maximum number of cells in any direction.
    pub fn farthest(&self) -> i32 {
        self.0.as_flattened().iter().copied().max().unwrap_or(0)
    }
}
