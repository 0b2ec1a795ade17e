//! `left-of`, `right-of`: the side on which the first lies, seen along the second's heading.

use crate::city::{Cell, CityMap, Heading};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Relation, Sight, Subject, Syntax, Views};
use serde::Serialize;
use std::sync::Arc;

/// The first lies left of the second, seen along the second's heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOf;

/// The first lies right of the second, seen along the second's heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct RightOf;

/// The meaning of both phrases.
const SIDES: &str = "Left and right of an agent are as that agent sees them, in the direction of its last move.";

impl PredicateKind for LeftOf {
    const SYNTAX: Syntax = Syntax::Word("left-of", || LeftOf.into());

    fn phrase(&self) -> Phrase {
        Phrase::new("is to the left of").meaning(SIDES)
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![LeftOf.into()]
    }
}

impl PredicateKind for RightOf {
    const SYNTAX: Syntax = Syntax::Word("right-of", || RightOf.into());

    fn phrase(&self) -> Phrase {
        Phrase::new("is to the right of").meaning(SIDES)
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        vec![RightOf.into()]
    }
}

impl PairKind for LeftOf {
    type Relation = Side;

    const READS: [bool; 2] = [false, true];

    fn holds(&self, _: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        y.heading.is_some_and(|heading| side_of(heading, x.at, y.at) > 0)
    }

    fn relation(&self, _: &Arc<CityMap>) -> Side {
        Side { sign: 1 }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

impl PairKind for RightOf {
    type Relation = Side;

    const READS: [bool; 2] = [false, true];

    fn holds(&self, _: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        y.heading.is_some_and(|heading| side_of(heading, x.at, y.at) < 0)
    }

    fn relation(&self, _: &Arc<CityMap>) -> Side {
        Side { sign: -1 }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

/// Returns the side of x, seen from y along a heading (dr, dc): positive left, negative right, zero straight. With (rr,
/// rc) = x - y it is dr * rc - dc * rr.
#[inline]
fn side_of(heading: Heading, x: Cell, y: Cell) -> i64 {
    let (dr, dc) = heading.delta();
    let (rr, rc) = x.offset_from(y);
    i64::from(dr) * rc - i64::from(dc) * rr
}

/// The side on which [`side_of`] has this sign.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side {
    sign: i64,
}

impl Relation for Side {
    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        y.heading
            .is_some_and(|heading| side_of(heading, x.at, y.at) * self.sign > 0)
    }

    /// Loops over second agents first, because the side depends on their heading. The side of an agent to itself is 0.
    #[inline]
    fn relate(
        &self,
        _: &Views,
        subjects: impl Iterator<Item = Subject> + Clone,
        _: impl Fn(usize, usize, f64) -> bool,
        rows: &mut [u64],
    ) {
        for (second, y) in subjects.clone().enumerate() {
            let Some(heading) = y.heading else { continue };
            for (x, row) in subjects.clone().zip(&mut *rows) {
                *row |= u64::from(side_of(heading, x.at, y.at) * self.sign > 0) << second;
            }
        }
    }
}
