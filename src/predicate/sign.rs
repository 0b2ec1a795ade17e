//! `{sign: yield}`: the agent is on a lane of a road network from which a connection with this right of way leads.

use crate::city::{Area, Cell, CityMap, Sign};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PlaceKind, PredicateKind, Syntax};
use crate::yaml::read::choice;
use serde::Serialize;
use std::sync::Arc;

/// The agent is on a lane with a sign at its end. On a map of blocks there are none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OnLaneWithSign {
    /// The sign.
    pub sign: Sign,
}

impl PredicateKind for OnLaneWithSign {
    const SYNTAX: Syntax = Syntax::Keys(&["sign"], |nodes, faults| {
        let sign = choice(nodes[0], &Sign::ALL.map(|sign| (sign.name(), sign)), faults)?;
        Some(OnLaneWithSign { sign }.into())
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(match self.sign {
            Sign::Priority => "is on a lane that has priority at its end",
            Sign::Yield => "is on a lane with a sign to yield at its end",
            Sign::Stop => "is on a lane with a stop sign at its end",
            Sign::AllWayStop => "is on a lane to an all-way stop",
            Sign::Right => "is on a lane to a junction without signs",
            Sign::Signal => "is on a lane with a signal at its end",
        })
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        // Those of the built-in road network.
        [Sign::Priority, Sign::Yield]
            .map(|sign| OnLaneWithSign { sign }.into())
            .into()
    }
}

impl PlaceKind for OnLaneWithSign {
    fn holds(&self, map: &CityMap, at: Cell) -> bool {
        map.signs_ahead(at).any(|sign| sign == self.sign)
    }

    fn area(&self, map: &CityMap) -> Arc<Area> {
        Arc::new(map.area_of(|cell| self.holds(map, cell)))
    }
}
