//! The static map.

use super::Cell;
use crate::config::{AgentKind, Building};
use ndarray::Array2;

/// What the ground of a cell is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Ground {
    /// No street: a building or the gap between buildings.
    Other,
    /// Walking street.
    Walking,
    /// Traffic street.
    Traffic,
    /// Both: where a walking street crosses a traffic street.
    Crossing,
}

/// A generated map. All layers have the shape (rows, columns).
#[derive(Clone, Debug)]
pub struct CityMap {
    /// Name of the map.
    pub name: String,
    /// The ground.
    pub ground: Array2<Ground>,
    /// Mid lines of the traffic streets.
    pub mid_line: Array2<bool>,
    /// What building stands here.
    pub building: Array2<Option<Building>>,
    /// Number of the block, from 1, where a building stands; else 0.
    pub block: Array2<u32>,
    /// Number of the intersection, from 1, whose entrance line this is (cars are *At* it here); else 0.
    pub entrance: Array2<u32>,
    /// Number of the intersection whose outline this is (pedestrians are *At* it here); else 0.
    pub outline: Array2<u32>,
    /// Number of the intersection that this is inside of; else 0.
    pub inside: Array2<u32>,
}

impl CityMap {
    /// Rows of cells.
    pub fn rows(&self) -> i32 {
        i32::try_from(self.ground.nrows()).expect("a map has at most 2^31 rows")
    }

    /// Columns of cells.
    pub fn cols(&self) -> i32 {
        i32::try_from(self.ground.ncols()).expect("a map has at most 2^31 columns")
    }

    /// Whether the cell is on the map.
    pub fn contains(&self, cell: Cell) -> bool {
        (0..self.rows()).contains(&cell.row) && (0..self.cols()).contains(&cell.col)
    }

    /// The intersection an agent of this kind is *At* on this cell, if any.
    pub fn at_intersection(&self, kind: AgentKind, cell: Cell) -> Option<u32> {
        match kind {
            AgentKind::Car => number(&self.entrance, cell),
            AgentKind::Pedestrian => number(&self.outline, cell),
        }
    }

    /// The intersection that the cell is inside of, if any.
    pub fn in_intersection(&self, cell: Cell) -> Option<u32> {
        number(&self.inside, cell)
    }
}

/// The non-zero value of a layer at a cell on the map.
fn number(layer: &Array2<u32>, cell: Cell) -> Option<u32> {
    let index = (usize::try_from(cell.row).ok()?, usize::try_from(cell.col).ok()?);
    layer.get(index).copied().filter(|&number| number != 0)
}
