//! `{lane_beside: left}`: cars may change from the lane of the agent into one to its left. `{beside: left}`: the second
//! agent is on that lane.

use crate::city::{Area, Cell, CityMap, Side};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{PairKind, Phrase, PlaceKind, PredicateKind, Relation, Sight, Subject, Syntax};
use crate::yaml::read::choice;
use serde::Serialize;
use std::sync::Arc;

/// The agent is on a lane of a road network with another beside it, into which cars may change. On a map of blocks there
/// is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LaneBeside {
    /// Where the other lane is.
    pub lane_beside: Side,
}

impl PredicateKind for LaneBeside {
    const SYNTAX: Syntax = Syntax::Keys(&["lane_beside"], |nodes, faults| {
        let lane_beside = choice(nodes[0], &Side::ALL.map(|side| (side.name(), side)), faults)?;
        Some(LaneBeside { lane_beside }.into())
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(format!("has a lane to its {}", self.lane_beside.name()))
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        Side::ALL.map(|lane_beside| LaneBeside { lane_beside }.into()).into()
    }
}

impl PlaceKind for LaneBeside {
    fn holds(&self, map: &CityMap, at: Cell) -> bool {
        map.lane_beside(at, self.lane_beside).is_some()
    }

    fn area(&self, map: &CityMap) -> Arc<Area> {
        Arc::new(map.area_of(|cell| self.holds(map, cell)))
    }
}

/// The second is on the lane beside that of the first, into which cars may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Beside {
    /// Where its lane is.
    pub beside: Side,
}

impl PredicateKind for Beside {
    const SYNTAX: Syntax = Syntax::Keys(&["beside"], |nodes, faults| {
        let beside = choice(nodes[0], &Side::ALL.map(|side| (side.name(), side)), faults)?;
        Some(Beside { beside }.into())
    });

    fn phrase(&self) -> Phrase {
        // Read from the first agent: the lane of the second is to its left.
        Phrase::new(match self.beside {
            Side::Left => "is on the lane to the right of",
            Side::Right => "is on the lane to the left of",
        })
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        Side::ALL.map(|beside| Beside { beside }.into()).into()
    }
}

impl PairKind for Beside {
    type Relation = OnLaneBeside;

    const READS: [bool; 2] = [true, true];

    fn holds(&self, sight: Sight<'_>, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        let lane = sight.map.place_on_lane(y.at).map(|(lane, _)| lane);
        lane.is_some() && sight.map.lane_beside(x.at, self.beside) == lane
    }

    fn relation(&self, map: &Arc<CityMap>) -> OnLaneBeside {
        OnLaneBeside {
            map: Arc::clone(map),
            side: self.beside,
        }
    }

    fn horizon(&self, _: u32) -> f64 {
        0.0
    }
}

/// The fast form.
#[derive(Clone, Debug)]
pub(crate) struct OnLaneBeside {
    map: Arc<CityMap>,
    side: Side,
}

impl Relation for OnLaneBeside {
    #[inline]
    fn test(&self, x: &Subject, y: &Subject, _: impl FnOnce(f64) -> bool) -> bool {
        match (self.map.lane_beside(x.at, self.side), self.map.place_on_lane(y.at)) {
            (Some(lane), Some((other, _))) => lane == other,
            _ => false,
        }
    }
}
