//! The static map.
// Decision: docs/decisions/city.md#d057

#[cfg(feature = "cli")]
use crate::city::network::Point;
use crate::city::network::{Network, Sign};
use crate::city::road_map::RoadMap;
use crate::city::square::{BUILDING, CAR_AT, INSIDE, MID_LINE, NODE, PEDESTRIAN_AT, Square};
use crate::city::{AgentKind, Building, Widths};
use crate::city::{Area, Rectangle};
use crate::city::{Cell, Heading, Light, RightOfWay, Side};
use crate::city::{Ground, Junction};
use crate::diag::Diagnostic;
use crate::diag::codes;
use ndarray::Array3;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// The names of the static layers of [`CityMap::semantic`], in order.
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

/// The maximum number of values of a [`CityMap::semantic`]: 1 GiB in total.
pub const SEMANTIC_MAX: usize = 1 << 28;

/// The maximum number of classes of cells that [`CityMap::distinct_cells`] compares.
const DISTINCT_MAX: usize = 1 << 22;

/// The geometry of a map of equal blocks.
///
/// Both axes follow the same pattern: street 0, block 0, street 1, block 1, ..., the last street. Functions with a
/// single coordinate apply to either axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    blocks: [i32; 2],
    street: i32,
    sidewalk: i32,
    building: i32,
    inner_sidewalk: i32,
}

impl Layout {
    /// Creates a layout of checked, small measures.
    pub(super) fn new(blocks: [u32; 2], widths: Widths) -> Self {
        let cells = |count: u32| i32::try_from(count).expect("a checked layout is at most 2^20 cells long");
        Layout {
            blocks: blocks.map(cells),
            street: cells(widths.street),
            sidewalk: cells(widths.sidewalk),
            building: cells(widths.building),
            inner_sidewalk: cells(widths.inner_sidewalk),
        }
    }

    /// Returns the number of rows and columns of blocks.
    pub fn blocks(&self) -> [i32; 2] {
        self.blocks
    }

    /// Returns whether a street runs between blocks. Only such streets have crossings and lines where cars wait.
    pub fn has_inner_streets(&self) -> bool {
        self.blocks.iter().any(|&blocks| blocks > 1)
    }

    /// Returns the number of rows of cells.
    pub fn rows(&self) -> i32 {
        self.street_start(self.blocks[0]) + self.street
    }

    /// Returns the number of columns of cells.
    pub fn cols(&self) -> i32 {
        self.street_start(self.blocks[1]) + self.street
    }

    /// Returns the width of the sidewalk between street and building, in cells.
    pub fn sidewalk(&self) -> i32 {
        self.sidewalk
    }

    /// Returns the number of cells from a lane to the mid line of its street: a quarter of the street.
    pub fn lane_offset(&self) -> i32 {
        ((self.street - 1) / 4).max(1)
    }

    /// Returns the side of a block in cells, sidewalks included.
    pub fn block_side(&self) -> i32 {
        2 * self.sidewalk + 2 * self.building + self.inner_sidewalk
    }

    /// Returns the distance from one street to the next, in cells.
    pub fn period(&self) -> i32 {
        self.street + self.block_side()
    }

    /// Returns the first cell of a street.
    pub fn street_start(&self, street: i32) -> i32 {
        street * self.period()
    }

    /// Returns the cells across a street.
    pub fn street_span(&self, street: i32) -> Range<i32> {
        self.street_start(street)..self.street_start(street) + self.street
    }

    /// Returns the mid line of a street.
    pub fn mid_line(&self, street: i32) -> i32 {
        self.street_start(street) + self.street / 2
    }

    /// Returns the first cell of a block.
    pub fn block_start(&self, block: i32) -> i32 {
        self.street_start(block) + self.street
    }

    /// Returns the cells of a block without its outer sidewalks.
    pub fn built_span(&self, block: i32) -> Range<i32> {
        let start = self.block_start(block) + self.sidewalk;
        start..start + 2 * self.building + self.inner_sidewalk
    }

    /// Returns the cells of the first (0) or second (1) building of a block.
    pub fn building_span(&self, block: i32, which: i32) -> Range<i32> {
        let start = self.built_span(block).start + which * (self.building + self.inner_sidewalk);
        start..start + self.building
    }

    /// Returns the cells of the sidewalk between the buildings of a block.
    pub fn inner_span(&self, block: i32) -> Range<i32> {
        self.building_span(block, 0).end..self.building_span(block, 1).start
    }

    /// Returns the first cells of the street before a block, of the sidewalks, and of the buildings of the block, and
    /// that of the next street.
    pub fn strip_edges(&self, block: i32) -> [i32; 7] {
        let [first, second] = [0, 1].map(|which| self.building_span(block, which));
        [
            self.street_start(block),
            self.block_start(block),
            first.start,
            first.end,
            second.start,
            second.end,
            self.street_start(block + 1),
        ]
    }

    /// Returns the cells of an intersection on this street: the street and the sidewalks along it. At the edges of the
    /// world the span extends beyond it.
    pub fn intersection_span(&self, street: i32) -> Range<i32> {
        let span = self.street_span(street);
        span.start - self.sidewalk..span.end + self.sidewalk
    }

    /// Returns row and column of the block that contains a cell, sidewalks included; `None` on streets and off the map.
    pub fn block_place(&self, cell: Cell) -> Option<[i32; 2]> {
        let along = |at: i32, blocks: i32| {
            let block = at.div_euclid(self.period());
            ((0..blocks).contains(&block) && at >= self.block_start(block)).then_some(block)
        };
        Some([along(cell.row, self.blocks[0])?, along(cell.col, self.blocks[1])?])
    }

    /// Returns the number of the block that contains a cell, from 1, row by row; `None` as in [`Layout::block_place`].
    pub fn block_at(&self, cell: Cell) -> Option<u32> {
        let [row, col] = self.block_place(cell)?;
        u32::try_from(row * self.blocks[1] + col + 1).ok()
    }
}

/// The class of a coordinate on its axis, in bits: its [`Strip`] and the two flags below.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct CoordinateClass(u8);

/// The nearest street runs along an edge of the world.
const AT_EDGE: u8 = 1 << 4;
/// The coordinate across the street is that of a lane.
const ON_LANE: u8 = 1 << 5;
/// The bits that determine the content of a cell.
const STRIP_AND_EDGE: u8 = AT_EDGE | 0xf;

/// The strips of an axis. "Before" and "after" are relative to the mid line of the nearest street: coordinates before it
/// are smaller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Strip {
    /// A building in the block's first row or column.
    FirstBuilding,
    /// The sidewalk between buildings.
    Inner,
    SecondBuilding,
    /// The outermost cell of an intersection, where lanes begin and end.
    LineBefore,
    /// The sidewalk along a street, without the line.
    SidewalkBefore,
    StreetBefore,
    MidLine,
    StreetAfter,
    SidewalkAfter,
    LineAfter,
}

impl Strip {
    const ALL: [Strip; 10] = [
        Strip::FirstBuilding,
        Strip::Inner,
        Strip::SecondBuilding,
        Strip::LineBefore,
        Strip::SidewalkBefore,
        Strip::StreetBefore,
        Strip::MidLine,
        Strip::StreetAfter,
        Strip::SidewalkAfter,
        Strip::LineAfter,
    ];

    pub(super) const fn in_street(self) -> bool {
        matches!(self, Strip::StreetBefore | Strip::MidLine | Strip::StreetAfter)
    }

    const fn in_building(self) -> bool {
        matches!(self, Strip::FirstBuilding | Strip::SecondBuilding)
    }

    /// Whether the strip lies between the outer sidewalks of a block.
    pub(super) const fn in_block(self) -> bool {
        self.in_building() || matches!(self, Strip::Inner)
    }

    const fn on_line(self) -> bool {
        matches!(self, Strip::LineBefore | Strip::LineAfter)
    }

    const fn before_mid_line(self) -> bool {
        matches!(self, Strip::LineBefore | Strip::SidewalkBefore | Strip::StreetBefore)
    }

    pub(super) const fn after_mid_line(self) -> bool {
        matches!(self, Strip::LineAfter | Strip::SidewalkAfter | Strip::StreetAfter)
    }
}

impl Layout {
    /// Returns the strip of a coordinate and the nearest street; inside a block, the block, whose number is that of the
    /// street before it.
    pub(super) fn strip(&self, at: i32) -> (Strip, i32) {
        let number = at.div_euclid(self.period());
        let middle = self.mid_line(number);
        let (street, built) = (self.street_span(number), self.built_span(number));
        let strip = if at < middle {
            Strip::StreetBefore
        } else if at == middle {
            Strip::MidLine
        } else if at < street.end {
            Strip::StreetAfter
        } else if at < built.start - 1 {
            Strip::SidewalkAfter
        } else if at == built.start - 1 {
            Strip::LineAfter
        } else if at == built.end {
            Strip::LineBefore
        } else if at > built.end {
            Strip::SidewalkBefore
        } else if at < built.start + self.building {
            Strip::FirstBuilding
        } else if at < built.start + self.building + self.inner_sidewalk {
            Strip::Inner
        } else {
            Strip::SecondBuilding
        };
        (strip, number + i32::from(at >= built.end))
    }

    /// Returns the class of each coordinate of an axis with this number of blocks.
    fn parts(&self, blocks: i32) -> Box<[CoordinateClass]> {
        let size = self.street_start(blocks) + self.street;
        let part = |at| {
            let (strip, street) = self.strip(at);
            let at_edge = street == 0 || street == blocks;
            let on_lane = strip.in_street() && (at - self.mid_line(street)).abs() == self.lane_offset();
            CoordinateClass(strip as u8 | (u8::from(at_edge) * AT_EDGE) | (u8::from(on_lane) * ON_LANE))
        };
        (0..size).map(part).collect()
    }
}

/// Returns the content of a cell with these strips. The flags say whether the nearest streets run along an edge of
/// the world.
fn square_of((row, row_at_edge): (Strip, bool), (col, col_at_edge): (Strip, bool)) -> Square {
    // A walking street crosses every traffic street that does not run along an edge.
    let crosses = |street: Strip, at_edge: bool, other: Strip| {
        street.in_street() && !at_edge && !other.in_street() && !other.in_block()
    };
    let building = row.in_building() && col.in_building();
    let ground = if crosses(row, row_at_edge, col) || crosses(col, col_at_edge, row) {
        Ground::Crossing
    } else if row.in_street() || col.in_street() {
        Ground::Traffic
    } else if building {
        Ground::Other
    } else {
        Ground::Walking
    };
    let mid_line = |street: Strip, other: Strip| street == Strip::MidLine && other.in_block();
    let mut flags = 0;
    if mid_line(row, col) || mid_line(col, row) {
        flags |= MID_LINE;
    }
    if building {
        flags |= BUILDING;
    }
    // The corners of the world are not intersections.
    let at_corner = row_at_edge && col_at_edge;
    if !row.in_block() && !col.in_block() && !at_corner {
        // A street along an edge is a through road: its cars have no line to wait at. The cars on the stem have
        // one.
        let outline = row.on_line() && !col_at_edge || col.on_line() && !row_at_edge;
        // Cars keep right: those that go down or left use the cells before the mid line.
        let down = row == Strip::LineBefore && col.before_mid_line() && !col_at_edge;
        let up = row == Strip::LineAfter && col.after_mid_line() && !col_at_edge;
        let right = col == Strip::LineBefore && row.after_mid_line() && !row_at_edge;
        let left = col == Strip::LineAfter && row.before_mid_line() && !row_at_edge;
        flags |= if outline { PEDESTRIAN_AT } else { INSIDE };
        if down || up || left || right {
            flags |= CAR_AT;
        }
    }
    let mut square = Square::of_ground(ground);
    square.set(flags);
    square
}

/// Returns the table of squares; the entry of `row` and `col` is at `row << 5 | col`.
fn squares() -> Box<[Square; 1 << 10]> {
    let mut table = Box::new([Square::of_ground(Ground::Other); 1 << 10]);
    for row in Strip::ALL {
        for col in Strip::ALL {
            for (row_at_edge, col_at_edge) in [(false, false), (false, true), (true, false), (true, true)] {
                let index = |strip: Strip, at_edge: bool| usize::from(strip as u8 | (u8::from(at_edge) * AT_EDGE));
                table[index(row, row_at_edge) << 5 | index(col, col_at_edge)] =
                    square_of((row, row_at_edge), (col, col_at_edge));
            }
        }
    }
    table
}

/// A generated map.
#[derive(Clone, Debug)]
pub struct CityMap {
    /// The name of the map.
    pub name: String,
    terrain: Terrain,
    /// The names and the cells of the zones.
    zones: Vec<(String, Arc<Area>)>,
}

/// The cells of a map.
#[derive(Clone, Debug)]
enum Terrain {
    Blocks(Blocks),
    Roads(Arc<RoadMap>),
}

/// A map of equal blocks. It stores nothing per cell: the content of a cell follows from its row, its column, and the
/// buildings of its block.
#[derive(Clone, Debug)]
struct Blocks {
    /// The positions of streets, blocks and intersections.
    layout: Layout,
    rows: Box<[CoordinateClass]>,
    cols: Box<[CoordinateClass]>,
    squares: Box<[Square; 1 << 10]>,
    /// The four buildings of each block, row by row; the blocks are in row order too.
    buildings: Vec<[Building; 4]>,
}

impl Blocks {
    /// The classes of a cell's row and column; `None` off the map.
    fn parts(&self, cell: Cell) -> Option<(CoordinateClass, CoordinateClass)> {
        let row = self.rows.get(usize::try_from(cell.row).ok()?)?;
        let col = self.cols.get(usize::try_from(cell.col).ok()?)?;
        Some((*row, *col))
    }

    fn square(&self, cell: Cell) -> Option<Square> {
        let (row, col) = self.parts(cell)?;
        let index = |part: CoordinateClass| usize::from(part.0 & STRIP_AND_EDGE);
        Some(self.squares[index(row) << 5 | index(col)])
    }

    fn lane_at(&self, cell: Cell) -> Option<Heading> {
        self.square(cell)?;
        let [row, col] = [cell.row, cell.col].map(|at| self.layout.strip(at).0);
        let is_along = |strip: Strip| strip.in_block() || strip.on_line();
        // Cars keep right.
        match [row, col] {
            [Strip::StreetBefore, along] if is_along(along) => Some(Heading::Left),
            [Strip::StreetAfter, along] if is_along(along) => Some(Heading::Right),
            [along, Strip::StreetBefore] if is_along(along) => Some(Heading::Down),
            [along, Strip::StreetAfter] if is_along(along) => Some(Heading::Up),
            _ => None,
        }
    }

    fn is_lane_node(&self, cell: Cell) -> bool {
        let is_line = |part: CoordinateClass| {
            let strip = part.0 & 0xf;
            strip == Strip::LineBefore as u8 || strip == Strip::LineAfter as u8
        };
        let across = |across: CoordinateClass, along: CoordinateClass| across.0 & ON_LANE != 0 && is_line(along);
        (self.parts(cell)).is_some_and(|(row, col)| across(row, col) || across(col, row))
    }

    fn building_at(&self, cell: Cell) -> Option<Building> {
        if !self.square(cell)?.has(BUILDING) {
            return None;
        }
        let layout = &self.layout;
        let block = |at: i32| at.div_euclid(layout.period());
        let second = |at: i32| usize::from(at >= layout.building_span(block(at), 1).start);
        let number = block(cell.row) * layout.blocks()[1] + block(cell.col);
        Some(self.buildings[number as usize][2 * second(cell.row) + second(cell.col)])
    }

    /// The number of the nearest intersection, from 1, row by row, without the corners of the world.
    fn intersection_near(&self, cell: Cell) -> u32 {
        let [row, col] = [cell.row, cell.col].map(|at| self.layout.strip(at).1);
        let [block_rows, block_cols] = self.layout.blocks();
        let place = row * (block_cols + 1) + col;
        let corners = [0, block_cols, block_rows * (block_cols + 1)];
        let before = corners.into_iter().filter(|&corner| corner < place).count();
        place.unsigned_abs() + 1 - u32::try_from(before).expect("at most three corners")
    }
}

impl CityMap {
    /// Creates the map of a layout with four buildings for each block, row by row; the blocks are in row order too.
    pub(super) fn of_blocks(name: String, layout: Layout, buildings: Vec<[Building; 4]>) -> Self {
        let [block_rows, block_cols] = layout.blocks();
        let blocks = Blocks {
            layout,
            rows: layout.parts(block_rows),
            cols: layout.parts(block_cols),
            squares: squares(),
            buildings,
        };
        CityMap {
            name,
            terrain: Terrain::Blocks(blocks),
            zones: Vec::new(),
        }
    }

    /// Creates the map of a road network.
    pub(super) fn of_roads(name: String, roads: RoadMap) -> Self {
        CityMap {
            name,
            terrain: Terrain::Roads(Arc::new(roads)),
            zones: Vec::new(),
        }
    }

    /// Adds zones.
    pub(super) fn with_zones(self, zones: Vec<(String, Arc<Area>)>) -> CityMap {
        CityMap { zones, ..self }
    }

    /// Returns the positions of streets, blocks and intersections; `None` for a road network.
    pub fn layout(&self) -> Option<&Layout> {
        match &self.terrain {
            Terrain::Blocks(blocks) => Some(&blocks.layout),
            Terrain::Roads(_) => None,
        }
    }

    /// Returns the raster of a road network; `None` for a map of blocks.
    pub(crate) fn roads(&self) -> Option<&RoadMap> {
        match &self.terrain {
            Terrain::Blocks(_) => None,
            Terrain::Roads(roads) => Some(roads),
        }
    }

    /// Returns the road network; `None` for a map of blocks.
    pub fn network(&self) -> Option<&Network> {
        self.roads().map(RoadMap::network)
    }

    /// Returns the number of rows of cells.
    #[inline]
    pub fn rows(&self) -> i32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.rows(),
            Terrain::Roads(roads) => roads.rows(),
        }
    }

    /// Returns the number of columns of cells.
    #[inline]
    pub fn cols(&self) -> i32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.cols(),
            Terrain::Roads(roads) => roads.cols(),
        }
    }

    /// Returns whether the cell is on the map.
    pub fn contains(&self, cell: Cell) -> bool {
        (0..self.rows()).contains(&cell.row) && (0..self.cols()).contains(&cell.col)
    }

    #[inline]
    fn square(&self, cell: Cell) -> Option<Square> {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.square(cell),
            Terrain::Roads(roads) => roads.square(cell),
        }
    }

    /// Returns the ground of a cell; `None` off the map.
    pub fn ground_at(&self, cell: Cell) -> Option<Ground> {
        self.square(cell).map(Square::ground)
    }

    /// Returns whether cars may be on this cell.
    pub fn is_drivable(&self, cell: Cell) -> bool {
        matches!(self.ground_at(cell), Some(Ground::Traffic | Ground::Crossing))
    }

    /// Returns whether pedestrians may be on this cell.
    pub fn is_walkable(&self, cell: Cell) -> bool {
        matches!(self.ground_at(cell), Some(Ground::Walking | Ground::Crossing))
    }

    /// Returns whether the mid line of a traffic street runs through this cell.
    pub fn is_mid_line(&self, cell: Cell) -> bool {
        self.square(cell).is_some_and(|square| square.has(MID_LINE))
    }

    /// Returns the heading of cars on the lane that contains a cell: a side of a street between two intersections, with
    /// the lines where lanes begin and end. `None` on the mid line, inside an intersection and off the street.
    pub fn lane_at(&self, cell: Cell) -> Option<Heading> {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.lane_at(cell),
            Terrain::Roads(roads) => roads.lane_heading(cell),
        }
    }

    /// Returns the cells for which `holds` is true. On a map of blocks it must be equal for all cells with the same
    /// strips and edges.
    pub(crate) fn area_of(&self, holds: impl Fn(Cell) -> bool) -> Area {
        let Terrain::Blocks(blocks) = &self.terrain else {
            let counts = [self.rows(), self.cols()].map(i32::unsigned_abs);
            let axes = counts.map(|count| (0..count).collect());
            return Area::of_classes(axes, counts, |row, col| {
                holds(Cell::new(row.cast_signed(), col.cast_signed()))
            });
        };
        let axes = [&blocks.rows, &blocks.cols].map(|parts| {
            let mut firsts: Vec<(CoordinateClass, i32)> = Vec::new();
            let classes = parts.iter().zip(0..).map(|(part, at)| {
                let known = firsts.iter().position(|(known, _)| known == part);
                let class = known.unwrap_or_else(|| {
                    firsts.push((*part, at));
                    firsts.len() - 1
                });
                u32::try_from(class).expect("there are at most 2^8 classes")
            });
            let classes: Box<[u32]> = classes.collect();
            (classes, firsts)
        });
        let [(rows, first_rows), (cols, first_cols)] = axes;
        let counts =
            [&first_rows, &first_cols].map(|firsts| u32::try_from(firsts.len()).expect("there are few classes"));
        Area::of_classes([rows, cols], counts, |row, col| {
            holds(Cell::new(first_rows[row as usize].1, first_cols[col as usize].1))
        })
    }

    /// Returns whether a lane starts or ends here, so that the cell is a node of the road graph.
    pub fn is_lane_node(&self, cell: Cell) -> bool {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.is_lane_node(cell),
            Terrain::Roads(roads) => roads.square(cell).is_some_and(|square| square.has(NODE)),
        }
    }

    /// Returns the building on this cell, if any. [`Layout::block_at`] returns its block.
    pub fn building_at(&self, cell: Cell) -> Option<Building> {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.building_at(cell),
            Terrain::Roads(_) => None,
        }
    }

    /// Returns the four buildings of each block, row by row; the blocks are in row order too. A road network has none.
    pub fn buildings(&self) -> &[[Building; 4]] {
        match &self.terrain {
            Terrain::Blocks(blocks) => &blocks.buildings,
            Terrain::Roads(_) => &[],
        }
    }

    /// Returns the number, the kind and the cells of each building of the blocks that a rectangle touches, row by row of
    /// blocks. The buildings of a block have four consecutive numbers.
    pub(crate) fn sites<'m>(&'m self, near: &Rectangle) -> impl Iterator<Item = (u32, Building, Rectangle)> + use<'m> {
        let blocks = self.layout().map(|layout| {
            let [rows, cols] = layout.blocks();
            let touched = |span: &Range<i32>, blocks: i32| {
                let block = |at: i32| at.div_euclid(layout.period()).clamp(0, blocks);
                block(span.start)..(block(span.end - 1) + 1).min(blocks)
            };
            (layout, touched(&near.rows, rows), touched(&near.cols, cols))
        });
        blocks.into_iter().flat_map(move |(layout, rows, cols)| {
            let places = rows.flat_map(move |row| cols.clone().map(move |col| (row, col)));
            places.flat_map(move |(row, col)| {
                let block = row * layout.blocks()[1] + col;
                (0..).zip(&self.buildings()[block as usize]).map(move |(at, building)| {
                    let cells = Rectangle {
                        rows: layout.building_span(row, at / 2),
                        cols: layout.building_span(col, at % 2),
                    };
                    ((4 * block + at).cast_unsigned(), *building, cells)
                })
            })
        })
    }

    /// Returns all cells as a rectangle.
    pub(crate) fn whole(&self) -> Rectangle {
        Rectangle {
            rows: 0..self.rows(),
            cols: 0..self.cols(),
        }
    }

    /// Returns the cells of the buildings of a kind, row by row of blocks.
    pub(crate) fn buildings_of(&self, kind: Building) -> impl Iterator<Item = Rectangle> {
        let of_kind = self
            .sites(&self.whole())
            .filter(move |(_, building, _)| *building == kind);
        of_kind.map(|(.., cells)| cells)
    }

    /// Returns the names of the zones, in the order of the configuration.
    pub fn zones(&self) -> impl Iterator<Item = &str> {
        self.zones.iter().map(|(name, _)| name.as_str())
    }

    /// Returns the names and the cells of the zones, in the order of the configuration.
    #[cfg(feature = "render")]
    pub(crate) fn zone_areas(&self) -> impl Iterator<Item = (&str, &Area)> {
        self.zones.iter().map(|(name, area)| (name.as_str(), &**area))
    }

    /// Returns whether a cell is in the zone with this name. A map without such a zone has no cell in it.
    pub fn in_zone(&self, name: &str, cell: Cell) -> bool {
        self.zone(name).is_some_and(|zone| zone.contains(cell))
    }

    /// Returns the cells of the zone with this name.
    pub(crate) fn zone(&self, name: &str) -> Option<&Arc<Area>> {
        self.zones.iter().find(|(known, _)| known == name).map(|(_, area)| area)
    }

    /// Returns the layered semantic map of the paper, W x H x (B + N), of shape (rows, columns, 8 + number of agents).
    /// Each value is 0 or 1. Layers 0 to 7 are the static ones of [`STATIC_LAYERS`]; a cell has at most one of them.
    /// Layer 8 + i is 1 in the cell of agent i and 0 elsewhere (0 everywhere for an agent off the map).
    ///
    /// # Errors
    /// `limit-exceeded` for more than [`SEMANTIC_MAX`] values.
    pub fn semantic(&self, agents: &[Cell]) -> Result<Array3<f32>, Diagnostic> {
        let statics = STATIC_LAYERS.len();
        let [rows, cols] = [self.rows(), self.cols()].map(|count| count as usize);
        let shape = (rows, cols, statics + agents.len());
        let cells = rows.checked_mul(cols);
        let values = cells.and_then(|cells| cells.checked_mul(shape.2));
        if values.is_none_or(|values| values > SEMANTIC_MAX) {
            let (rows, cols, layers) = shape;
            let message = format!("a semantic map of {rows} x {cols} cells and {layers} layers takes too much memory");
            let limit = format!("the limit is {SEMANTIC_MAX} values; use a smaller map or fewer agents");
            return Err(Diagnostic::new(codes::LIMIT_EXCEEDED, message).help(limit));
        }
        let mut layers = Array3::zeros(shape);
        let cells = (0..self.rows()).flat_map(|row| (0..self.cols()).map(move |col| Cell::new(row, col)));
        for (cell, mut values) in cells.zip(layers.lanes_mut(ndarray::Axis(2))) {
            let layer = match (self.ground_at(cell), self.building_at(cell)) {
                (Some(Ground::Walking), _) => 0,
                (Some(Ground::Traffic), _) => 1,
                (Some(Ground::Crossing), _) => 2,
                (_, Some(Building::House)) => 3,
                (_, Some(Building::Office)) => 4,
                (_, Some(Building::Garage)) => 5,
                (_, Some(Building::Store)) => 6,
                (_, Some(Building::GasStation)) => 7,
                _ => continue,
            };
            values[layer] = 1.0;
        }
        for (agent, &cell) in agents.iter().enumerate() {
            if let (Ok(row), Ok(col)) = (usize::try_from(cell.row), usize::try_from(cell.col))
                && let Some(value) = layers.get_mut((row, col, statics + agent))
            {
                *value = 1.0;
            }
        }
        Ok(layers)
    }

    /// Returns the relation of a cell to intersections; none off the map. Takes constant time.
    pub fn junction(&self, cell: Cell) -> Junction {
        self.square(cell).map_or_else(Junction::default, Square::junction)
    }

    /// Returns cells on which agents of a kind may be: one for each combination of a relation to intersections and of
    /// membership in these areas, which are at most 64. `None` if that takes too long.
    pub(crate) fn distinct_cells(&self, kind: AgentKind, areas: &[Arc<Area>]) -> Option<Vec<Cell>> {
        // Cells of equal classes are alike.
        let firsts = |mut ids: Vec<u32>, axis: usize| {
            for area in areas {
                let mut known = BTreeMap::new();
                for (id, class) in ids.iter_mut().zip(area.classes()[axis]) {
                    let next = u32::try_from(known.len()).expect("fewer than 2^32 rows and columns");
                    *id = *known.entry((*id, *class)).or_insert(next);
                }
            }
            let mut firsts = BTreeMap::new();
            for (id, at) in ids.into_iter().zip(0..) {
                firsts.entry(id).or_insert(at);
            }
            firsts.into_values().collect::<Vec<i32>>()
        };
        let [rows, cols] = match &self.terrain {
            Terrain::Blocks(blocks) => {
                [&blocks.rows, &blocks.cols].map(|parts| parts.iter().map(|part| part.0.into()).collect())
            }
            Terrain::Roads(_) => [self.rows(), self.cols()].map(|count| (0..count.unsigned_abs()).collect()),
        };
        let (rows, cols) = (firsts(rows, 0), firsts(cols, 1));
        if rows.len().saturating_mul(cols.len()) > DISTINCT_MAX || areas.len() > 64 {
            return None;
        }
        let cells = rows
            .iter()
            .flat_map(|&row| cols.iter().map(move |&col| Cell::new(row, col)));
        let may_be = |cell: &Cell| match kind {
            AgentKind::Car => self.is_drivable(*cell),
            AgentKind::Pedestrian => self.is_walkable(*cell),
        };
        let mut found = BTreeMap::new();
        for cell in cells.filter(may_be) {
            let members = areas.iter().enumerate();
            let members = members.fold(0_u64, |set, (at, area)| set | u64::from(area.contains(cell)) << at);
            found.entry((self.junction(cell).index(), members)).or_insert(cell);
        }
        Some(found.into_values().collect())
    }

    /// Returns the intersection that an agent of this kind is *At* on this cell, if any.
    pub fn at_intersection(&self, kind: AgentKind, cell: Cell) -> Option<u32> {
        (self.junction(cell).is_at(kind)).then(|| self.intersection_near(cell))
    }

    /// Returns the intersection that contains the cell, if any.
    pub fn in_intersection(&self, cell: Cell) -> Option<u32> {
        (self.junction(cell).is_inside()).then(|| self.intersection_near(cell))
    }

    /// Returns the intersection at or in which an agent of this kind is on this cell, if any.
    #[inline]
    pub fn intersection(&self, kind: AgentKind, cell: Cell) -> Option<u32> {
        let junction = self.junction(cell);
        (junction.is_at(kind) || junction.is_inside()).then(|| self.intersection_near(cell))
    }

    /// Returns the number of intersections, 0 on a map of one block.
    pub fn intersections(&self) -> u32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => {
                let [rows, cols] = blocks.layout.blocks().map(|blocks| blocks.unsigned_abs() + 1);
                rows * cols - 4
            }
            Terrain::Roads(roads) => roads.intersections(),
        }
    }

    /// Returns the direction of the lane that starts at a node of the road graph; `None` where one ends.
    pub(super) fn lane_entered(&self, node: Cell) -> Option<Heading> {
        let heading = self.lane_at(node)?;
        let starts = match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.starts_lane(node, heading),
            Terrain::Roads(roads) => roads.spot(node).is_some_and(|spot| spot.at == 0),
        };
        starts.then_some(heading)
    }

    /// Returns the cells of a lane of the road network, by its position there; none for a lane that is not for cars.
    pub fn lane_cells(&self, lane: usize) -> &[Cell] {
        let lane = u32::try_from(lane).ok();
        lane.and_then(|lane| Some(self.roads()?.path(lane))).unwrap_or_default()
    }

    /// Returns the direction of travel at each of these cells.
    pub fn lane_headings(&self, lane: usize) -> &[Heading] {
        let lane = u32::try_from(lane).ok();
        lane.and_then(|lane| Some(self.roads()?.path_headings(lane)))
            .unwrap_or_default()
    }

    /// Returns the cells of a connection of the road network between its two lanes, by its position there.
    pub fn connection_cells(&self, connection: usize) -> &[Cell] {
        let connection = u32::try_from(connection).ok();
        connection
            .and_then(|connection| Some(self.roads()?.link(connection)))
            .unwrap_or_default()
    }

    /// Returns the number of the lane for cars that contains a cell, and the steps along it from its start.
    pub(crate) fn place_on_lane(&self, cell: Cell) -> Option<(u32, u32)> {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.place_on_lane(cell),
            Terrain::Roads(roads) => roads.spot(cell).map(|spot| (spot.lane, spot.at)),
        }
    }

    /// Returns the lane beside that of a cell of a road network into which cars may change.
    pub(crate) fn lane_beside(&self, cell: Cell, side: Side) -> Option<u32> {
        let roads = self.roads()?;
        roads.lane_beside(roads.spot(cell)?.lane, side)
    }

    /// Returns the most cells across a lane.
    pub(crate) fn lane_width(&self) -> i32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.street_span(0).end,
            Terrain::Roads(roads) => roads.lane_width(),
        }
    }

    /// Returns what regulates the right of way at the end of the lane of a cell, except for ways back.
    pub fn signs_ahead(&self, cell: Cell) -> impl Iterator<Item = Sign> {
        self.roads().into_iter().flat_map(move |roads| roads.signs_ahead(cell))
    }

    /// Returns the name of the lane of a cell on a road network.
    #[cfg(feature = "cli")]
    pub(crate) fn lane_name(&self, cell: Cell) -> Option<&str> {
        self.roads()?.lane_name(cell)
    }

    /// Returns the point in the middle of the lane of a cell on a road network that is nearest to a point.
    #[cfg(feature = "cli")]
    pub(crate) fn lane_point(&self, cell: Cell, near: Point) -> Option<Point> {
        self.roads()?.lane_point(cell, near)
    }

    /// Returns two cells of the lane of a cell on a road network, at most `around` steps behind and ahead of it.
    #[cfg(feature = "cli")]
    pub(crate) fn lane_direction(&self, cell: Cell, around: usize) -> Option<(Cell, Cell)> {
        self.roads()?.lane_direction(cell, around)
    }

    /// Returns the speed limit in km/h on the lane of an agent of that kind.
    pub fn limit(&self, kind: AgentKind, cell: Cell) -> Option<u16> {
        self.roads().filter(|_| kind == AgentKind::Car)?.limit(cell)
    }

    /// Returns the light of a signal in a tick for an agent of that kind whose route leaves its next intersection in a
    /// direction. Of several lights it is the one with which a car drives on.
    pub fn light(&self, kind: AgentKind, cell: Cell, exit: Option<Heading>, tick: u64) -> Option<Light> {
        (self.roads().filter(|_| kind == AgentKind::Car)?).light(cell, exit, tick)
    }

    /// Returns which of two cars must yield on a road network, by their cells and by the directions in which their routes
    /// leave their next intersections; `None` if their ways do not meet.
    pub fn right_of_way(&self, one: (Cell, Option<Heading>), other: (Cell, Option<Heading>)) -> Option<RightOfWay> {
        self.roads()?.right_of_way(one, other)
    }

    /// Returns the number of cells that a car drives on a road network until it has left the way of another in their next
    /// intersection, by their cells and by the directions in which their routes leave it; `None` if their ways do not
    /// meet, or no longer.
    pub fn clearance(&self, other: (Cell, Option<Heading>), car: (Cell, Option<Heading>)) -> Option<u32> {
        self.roads()?.clearance(other, car)
    }

    /// Returns whether a connection that leaves the lane of the first cell, and is no way back, must yield to one that
    /// leaves the lane of the second.
    pub fn must_yield(&self, cell: Cell, other: Cell) -> bool {
        self.roads().is_some_and(|roads| roads.must_yield(cell, other))
    }

    /// Returns whether pedestrians cross streets somewhere.
    #[cfg(feature = "render")]
    pub(crate) fn has_crossings(&self) -> bool {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.layout.has_inner_streets(),
            Terrain::Roads(roads) => {
                (roads.network().lanes.iter()).any(|lane| lane.usage == crate::city::LaneUse::Crossing)
            }
        }
    }

    /// Returns the most rows or columns between two cells at or inside one intersection.
    pub(crate) fn intersection_extent(&self) -> i32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => {
                let span = blocks.layout.intersection_span(0);
                span.end - span.start - 1
            }
            Terrain::Roads(roads) => roads.extent(),
        }
    }

    /// The number of the intersection of a cell at or inside one, from 1. On a map of blocks row by row, without the
    /// corners of the world; on a road network in the order of the junctions.
    fn intersection_near(&self, cell: Cell) -> u32 {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.intersection_near(cell),
            Terrain::Roads(roads) => roads.intersection_near(cell),
        }
    }
}
