//! `{lane: left}`: the agent is on a lane for cars that go left, on a sidewalk, or on a crossing.

use crate::city::{Area, Cell, CityMap, Ground, Heading};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PlaceKind, PredicateKind, Syntax};
use crate::yaml::read::choice;
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// The agent is on a lane of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnLane {
    /// A lane for cars with this heading: a side of a street between two intersections, with the lines at its ends.
    Cars(Heading),
    /// A walking street.
    Sidewalk,
    /// A crossing of a traffic street. Its outer lines also belong to lanes for cars.
    Crossing,
}

impl OnLane {
    /// All lanes.
    pub const ALL: [OnLane; 6] = [
        OnLane::Cars(Heading::Left),
        OnLane::Cars(Heading::Right),
        OnLane::Cars(Heading::Up),
        OnLane::Cars(Heading::Down),
        OnLane::Sidewalk,
        OnLane::Crossing,
    ];

    /// Returns the name in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            OnLane::Cars(Heading::Left) => "left",
            OnLane::Cars(Heading::Right) => "right",
            OnLane::Cars(Heading::Up) => "up",
            OnLane::Cars(Heading::Down) => "down",
            OnLane::Sidewalk => "sidewalk",
            OnLane::Crossing => "crossing",
        }
    }
}

impl Serialize for OnLane {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl PredicateKind for OnLane {
    const SYNTAX: Syntax = Syntax::Keys(&["lane"], |nodes, faults| {
        choice(nodes[0], &OnLane::ALL.map(|lane| (lane.name(), lane)), faults).map(OnLane::into)
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(match self {
            OnLane::Cars(_) => format!("is on a lane where cars go {}", self.name()),
            OnLane::Sidewalk => "is on a sidewalk".to_owned(),
            OnLane::Crossing => "is on a crossing".to_owned(),
        })
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        OnLane::ALL.map(OnLane::into).into()
    }
}

impl PlaceKind for OnLane {
    fn holds(&self, map: &CityMap, at: Cell) -> bool {
        match self {
            OnLane::Cars(heading) => map.lane_at(at) == Some(*heading),
            OnLane::Sidewalk => map.ground_at(at) == Some(Ground::Walking),
            OnLane::Crossing => map.ground_at(at) == Some(Ground::Crossing),
        }
    }

    fn area(&self, map: &CityMap) -> Arc<Area> {
        Arc::new(map.area_of(|cell| self.holds(map, cell)))
    }
}
