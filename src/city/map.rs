//! The static map.

use super::Cell;
use crate::config::{AgentKind, Building, Widths};
use ndarray::{Array2, Array3};
use std::ops::Range;

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

/// Names of the static layers of [`CityMap::semantic`], in order.
pub const STATIC_LAYERS: [&str; 8] = [
    "walking street",
    "traffic street",
    "crossing",
    "house",
    "office",
    "garage",
    "store",
    "gas station",
];

/// Where everything lies on a map of equal blocks. Both axes follow the same pattern: street 0, block 0, street 1, block 1, ...,
/// the last street. An axis is meant wherever only one number is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    blocks: [i32; 2],
    street: i32,
    sidewalk: i32,
    building: i32,
    inner_sidewalk: i32,
}

impl Layout {
    /// A layout whose size has been checked: all of its measures are small.
    pub(super) fn new(blocks: [u32; 2], widths: Widths) -> Self {
        let cells = |count: u32| i32::try_from(count).expect("a checked layout is at most 2^24 cells long");
        Layout {
            blocks: blocks.map(cells),
            street: cells(widths.street),
            sidewalk: cells(widths.sidewalk),
            building: cells(widths.building),
            inner_sidewalk: cells(widths.inner_sidewalk),
        }
    }

    /// Rows and columns of blocks.
    pub fn blocks(&self) -> [i32; 2] {
        self.blocks
    }

    /// Rows of cells.
    pub fn rows(&self) -> i32 {
        self.street_start(self.blocks[0]) + self.street
    }

    /// Columns of cells.
    pub fn cols(&self) -> i32 {
        self.street_start(self.blocks[1]) + self.street
    }

    /// Width of the sidewalk between street and building, in cells.
    pub fn sidewalk(&self) -> i32 {
        self.sidewalk
    }

    /// Cells from a lane to the mid line of its street: a quarter of the street.
    pub fn lane_offset(&self) -> i32 {
        ((self.street - 1) / 4).max(1)
    }

    /// Side of a block in cells, sidewalks included.
    pub fn block_side(&self) -> i32 {
        2 * self.sidewalk + 2 * self.building + self.inner_sidewalk
    }

    /// Cells from one street to the next.
    pub fn period(&self) -> i32 {
        self.street + self.block_side()
    }

    /// First cell of a street.
    pub fn street_start(&self, street: i32) -> i32 {
        street * self.period()
    }

    /// The cells across a street.
    pub fn street_span(&self, street: i32) -> Range<i32> {
        self.street_start(street)..self.street_start(street) + self.street
    }

    /// The mid line of a street.
    pub fn mid_line(&self, street: i32) -> i32 {
        self.street_start(street) + self.street / 2
    }

    /// First cell of a block.
    pub fn block_start(&self, block: i32) -> i32 {
        self.street_start(block) + self.street
    }

    /// The cells of a block without its outer sidewalks.
    pub fn built_span(&self, block: i32) -> Range<i32> {
        let start = self.block_start(block) + self.sidewalk;
        start..start + 2 * self.building + self.inner_sidewalk
    }

    /// The cells of the first (0) or second (1) building of a block.
    pub fn building_span(&self, block: i32, which: i32) -> Range<i32> {
        let start = self.built_span(block).start + which * (self.building + self.inner_sidewalk);
        start..start + self.building
    }

    /// The cells of an intersection with this street: the street and the sidewalks along it. At the edges of the world the span
    /// reaches beyond it.
    pub fn intersection_span(&self, street: i32) -> Range<i32> {
        let span = self.street_span(street);
        span.start - self.sidewalk..span.end + self.sidewalk
    }

    /// The number of the block, from 1, that a cell belongs to, sidewalks included; `None` on streets and off the map.
    pub fn block_at(&self, cell: Cell) -> Option<u32> {
        let along = |at: i32, blocks: i32| {
            let block = at.div_euclid(self.period());
            ((0..blocks).contains(&block) && at >= self.block_start(block)).then_some(block)
        };
        let (row, col) = (along(cell.row, self.blocks[0])?, along(cell.col, self.blocks[1])?);
        u32::try_from(row * self.blocks[1] + col + 1).ok()
    }
}

/// A generated map. All layers have the shape (rows, columns).
#[derive(Clone, Debug)]
pub struct CityMap {
    /// Name of the map.
    pub name: String,
    /// Where streets, blocks and intersections lie.
    pub layout: Layout,
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

    /// The ground of a cell; `None` off the map.
    pub fn ground_at(&self, cell: Cell) -> Option<Ground> {
        self.ground.get(index(cell)?).copied()
    }

    /// Whether cars may be on this cell.
    pub fn is_drivable(&self, cell: Cell) -> bool {
        matches!(self.ground_at(cell), Some(Ground::Traffic | Ground::Crossing))
    }

    /// Whether pedestrians may be on this cell.
    pub fn is_walkable(&self, cell: Cell) -> bool {
        matches!(self.ground_at(cell), Some(Ground::Walking | Ground::Crossing))
    }

    /// The cells where agents of a kind start and arrive, row by row; within the first `region` rows and columns, if given.
    ///
    /// Pedestrians: cells of the walking street that touch a house or an office, corners included. Cars: the kerb cells of a
    /// traffic street straight across the sidewalk from a gas station, garage or store.
    pub fn start_cells(&self, kind: AgentKind, region: Option<u32>) -> Vec<Cell> {
        let limit = region.map_or(i32::MAX, |region| i32::try_from(region).unwrap_or(i32::MAX));
        let [block_rows, block_cols] = self.layout.blocks();
        let mut cells = Vec::new();
        for (block_row, row) in (0..block_rows).flat_map(|block| [(block, 0), (block, 1)]) {
            for (block_col, col) in (0..block_cols).flat_map(|block| [(block, 0), (block, 1)]) {
                let rows = self.layout.building_span(block_row, row);
                let cols = self.layout.building_span(block_col, col);
                let building = self.building[(rows.start as usize, cols.start as usize)];
                match (kind, building) {
                    (AgentKind::Pedestrian, Some(Building::House | Building::Office)) => {
                        let around = |span: Range<i32>| span.start - 1..span.end + 1;
                        let ring =
                            around(rows).flat_map(|row| around(cols.clone()).map(move |col| Cell::new(row, col)));
                        cells.extend(ring.filter(|&cell| self.ground_at(cell) == Some(Ground::Walking)));
                    }
                    (AgentKind::Car, Some(Building::GasStation | Building::Garage | Building::Store)) => {
                        let kerb = |span: &Range<i32>, which: i32| match which {
                            0 => span.start - self.layout.sidewalk - 1,
                            _ => span.end + self.layout.sidewalk,
                        };
                        let (kerb_row, kerb_col) = (kerb(&rows, row), kerb(&cols, col));
                        cells.extend(cols.map(|col| Cell::new(kerb_row, col)));
                        cells.extend(rows.map(|row| Cell::new(row, kerb_col)));
                    }
                    _ => {}
                }
            }
        }
        cells.retain(|cell| cell.row < limit && cell.col < limit);
        cells.sort_unstable();
        cells.dedup();
        cells
    }

    /// The layered semantic map of the paper, W x H x (B + N), of shape (rows, columns, 8 + number of agents). Each value is 0
    /// or 1. Layers 0 to 7 are the static ones of [`STATIC_LAYERS`], of which a cell has at most one; layer 8 + i is 1 in the
    /// cell of agent i and 0 elsewhere (0 everywhere for an agent off the map).
    pub fn semantic(&self, agents: &[Cell]) -> Array3<f32> {
        let statics = STATIC_LAYERS.len();
        let (rows, cols) = self.ground.dim();
        let mut layers = Array3::zeros((rows, cols, statics + agents.len()));
        for ((row, col), &ground) in self.ground.indexed_iter() {
            let layer = match (ground, self.building[(row, col)]) {
                (Ground::Walking, _) => 0,
                (Ground::Traffic, _) => 1,
                (Ground::Crossing, _) => 2,
                (Ground::Other, Some(Building::House)) => 3,
                (Ground::Other, Some(Building::Office)) => 4,
                (Ground::Other, Some(Building::Garage)) => 5,
                (Ground::Other, Some(Building::Store)) => 6,
                (Ground::Other, Some(Building::GasStation)) => 7,
                (Ground::Other, None) => continue,
            };
            layers[(row, col, layer)] = 1.0;
        }
        for (agent, &cell) in agents.iter().enumerate() {
            if let Some((row, col)) = index(cell)
                && let Some(value) = layers.get_mut((row, col, statics + agent))
            {
                *value = 1.0;
            }
        }
        layers
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
    layer.get(index(cell)?).copied().filter(|&number| number != 0)
}

/// The place of a cell in a layer; `None` for negative coordinates.
pub(super) fn index(cell: Cell) -> Option<(usize, usize)> {
    Some((usize::try_from(cell.row).ok()?, usize::try_from(cell.col).ok()?))
}
