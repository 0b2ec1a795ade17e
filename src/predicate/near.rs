//! `{near: Store, within: 8}`: the agent is at most 8 rows and at most 8 columns away from a building of this kind.

use crate::city::{Area, Building, Cell, CityMap, Rectangle};
#[cfg(test)]
use crate::predicate::Definition;
use crate::predicate::{Phrase, PlaceKind, PredicateKind, Syntax};
use crate::yaml::read::{choice, integer};
use serde::Serialize;
use std::sync::Arc;

/// The maximum distance from a building, in cells.
pub const NEAR_MAX: u32 = 1000;

/// The agent is at most `within` rows and at most `within` columns away from the nearest cell of a building.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Near {
    /// The kind of the building.
    pub near: Building,
    /// The maximum distance in cells.
    pub within: u32,
}

impl PredicateKind for Near {
    const SYNTAX: Syntax = Syntax::Keys(&["near", "within"], |nodes, faults| {
        let near = choice(
            nodes[0],
            &Building::ALL.map(|building| (building.name(), building)),
            faults,
        );
        let within = integer(nodes[1], 0..=NEAR_MAX, faults);
        let (near, within) = (near?, within?);
        Some(Near { near, within }.into())
    });

    fn phrase(&self) -> Phrase {
        let building = match self.near {
            Building::House => "a house",
            Building::Office => "an office",
            Building::Garage => "a garage",
            Building::Store => "a store",
            Building::GasStation => "a gas station",
        };
        Phrase::new(format!("is at most {} cells away from {building}", self.within))
            .meaning("The distance from a building counts rows and columns of cells, and the larger number counts.")
    }

    #[cfg(test)]
    fn samples() -> Vec<Definition> {
        let near = |near, within| Near { near, within }.into();
        vec![
            near(Building::Garage, 8),
            near(Building::GasStation, 60),
            near(Building::Store, 1),
        ]
    }
}

impl PlaceKind for Near {
    fn holds(&self, map: &CityMap, at: Cell) -> bool {
        let Some(layout) = map.layout() else { return false };
        // The blocks that are near enough, whatever their buildings.
        let blocks = |at: i32, blocks: i32| {
            let [first, last] = [-1, 1].map(|sign| (at + sign * self.within.cast_signed()).div_euclid(layout.period()));
            (first - 1).max(0)..(last + 1).min(blocks)
        };
        let [rows, cols] = layout.blocks();
        blocks(at.row, rows).any(|block_row| {
            blocks(at.col, cols).any(|block_col| {
                let number = block_row * cols + block_col;
                let buildings = map.buildings()[number as usize].iter().zip(0..);
                buildings
                    .filter(|(building, _)| **building == self.near)
                    .any(|(_, place)| {
                        let cells = Rectangle {
                            rows: layout.building_span(block_row, place / 2),
                            cols: layout.building_span(block_col, place % 2),
                        };
                        cells.grown(self.within).contains(at)
                    })
            })
        })
    }

    fn area(&self, map: &CityMap) -> Arc<Area> {
        let around = map.buildings_of(self.near).map(|building| building.grown(self.within));
        let area = Area::of_rectangles([map.rows(), map.cols()], &around.collect::<Vec<_>>());
        Arc::new(area.expect("the buildings of a map have few rows and columns"))
    }
}
