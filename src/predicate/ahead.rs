//! `{ahead: 12}`: the second agent is ahead of the first on its lane, at most this many cells.

use crate::city::CityMap;
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PredicateKind, Reach, Relation, Sight, Subject, Syntax};
use crate::yaml::read::integer;
use serde::Serialize;
use std::sync::Arc;

/// The maximum number of cells.
const AHEAD_MAX: u32 = 1000;

/// The second is on the lane of the first, farther along it, and at most this many cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Ahead {
    /// The cells along the lane, at least 1.
    pub ahead: u32,
}

impl PredicateKind for Ahead {
    const SYNTAX: Syntax = Syntax::Keys(&["ahead"], |nodes, faults| {
        let ahead = integer(nodes[0], 1..=AHEAD_MAX, faults)?;
        Some(Ahead { ahead }.into())
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(format!(
            "is on the same lane as, and at most {} cells behind,",
            self.ahead
        ))
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        [1, 8, 40].map(|ahead| Ahead { ahead }.into()).into()
    }
}

impl PairKind for Ahead {
    type Relation = OnLane;

    const READS: [bool; 2] = [true, true];

    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let (Some((lane, behind)), Some((other, ahead))) =
            (sight.map.place_on_lane(x.at), sight.map.place_on_lane(y.at))
        else {
            return false;
        };
        lane == other && behind < ahead && ahead - behind <= self.ahead
    }

    fn relation(&self, map: &Arc<CityMap>) -> OnLane {
        OnLane {
            // Cells beside the line of a lane count as the nearest cell on it.
            reach: (self.ahead.cast_signed() + 2 * map.lane_width()).min(Reach::FARTHEST),
            ahead: self.ahead,
            map: Arc::clone(map),
        }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

/// The fast form.
#[derive(Clone, Debug)]
pub(crate) struct OnLane {
    map: Arc<CityMap>,
    ahead: u32,
    reach: i32,
}

impl Relation for OnLane {
    #[inline]
    fn reach_back(&self) -> Reach {
        Reach::Within([self.reach; 4])
    }

    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let [one, other] = [x, y].map(|agent| self.map.place_on_lane(agent.at));
        match (one, other) {
            (Some((lane, behind)), Some((other, ahead))) => {
                lane == other && (1..=self.ahead).contains(&ahead.wrapping_sub(behind))
            }
            _ => false,
        }
    }
}
