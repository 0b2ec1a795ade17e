//! `{zone: school}`: the agent is in this zone of the map.

use crate::city::{Area, Cell, CityMap};
use crate::located::Located;
use crate::predicate::{Definition, Phrase, Place, PlaceKind, PredicateKind, Syntax};
use crate::yaml::read::name;
use serde::Serialize;
use std::sync::Arc;

/// The agent is in the zone with this name. A map without such a zone has no agent in it.
#[derive(Clone, Debug, Serialize)]
pub struct Zone(pub Located<String>);

impl PartialEq for Zone {
    fn eq(&self, other: &Zone) -> bool {
        self.0.value == other.0.value
    }
}

impl PredicateKind for Zone {
    const SYNTAX: Syntax = Syntax::Keys(&["zone"], |nodes, faults| {
        let value = name(nodes[0], "the name of a zone", faults)?.to_owned();
        let span = nodes[0].span;
        Some(Zone(Located { value, span }).into())
    });

    fn phrase(&self) -> Phrase {
        Phrase::new(format!("is in the zone {}", self.0.value))
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        let span = crate::diag::Span::new(crate::diag::Sources::new().add("zone", ""), 0..0);
        let zone = |name: &str| {
            Zone(Located {
                value: name.to_owned(),
                span,
            })
        };
        vec![zone("school").into(), zone("center").into()]
    }
}

impl PlaceKind for Zone {
    fn holds(&self, map: &CityMap, at: Cell) -> bool {
        map.in_zone(&self.0.value, at)
    }

    fn area(&self, map: &CityMap) -> Arc<Area> {
        map.zone(&self.0.value).cloned().unwrap_or_default()
    }
}

impl Definition {
    /// Returns the name of the zone that the predicate tests, if it tests one.
    pub fn zone(&self) -> Option<&Located<String>> {
        match self {
            Definition::Place(Place::Zone(zone)) => Some(&zone.0),
            _ => None,
        }
    }
}
