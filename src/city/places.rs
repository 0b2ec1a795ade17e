//! The cells where agents start and arrive, counted and drawn without listing them.
//!
//! The places of a block depend on its four buildings only, so each kind of agent has sixteen patterns. A pattern
//! consists of bands of equal rows. The number of places in each band of each row of blocks determines the place with a
//! given number.

use crate::city::road_map::RoadMap;
use crate::city::{AgentKind, Building, Ground};
use crate::city::{Cell, CityMap, Layout, NoRoute, Rectangle, Region, Route, Router, TripEnds};
use crate::rng::{Rng, RngExt};
use std::ops::Range;
use std::sync::Arc;

/// The maximum number of goals drawn until one is reachable.
const GOAL_DRAWS: usize = 16;

/// The cells where agents start and arrive in a region of the map, numbered from 0 row by row.
///
/// On a map of blocks, pedestrians: cells of the walking street that touch a house or an office, corners included. Cars:
/// cells of a traffic street straight across the sidewalk from a gas station, garage or store, on the lines of
/// [`TripEnds`]. On a road network, pedestrians: the walkable cells that are not at or inside an intersection. Cars: the
/// cells in the middle of lanes, except for three at each end.
#[derive(Clone, Debug)]
pub struct Places {
    ends: TripEnds,
    /// The maximum distance of a goal in rows and columns.
    trip: Option<i32>,
    terrain: Terrain,
}

/// The places of a map.
#[derive(Clone, Debug)]
enum Terrain {
    Blocks(Box<BlockPlaces>),
    /// For each kind of agent the places on a road network, row by row.
    Roads([Box<[Cell]>; 2]),
}

/// The places of a map of blocks.
#[derive(Clone, Debug)]
struct BlockPlaces {
    layout: Layout,
    patterns: [Pattern; 2],
    /// For each kind and each block: the bit set of the buildings where agents start.
    starts: [Box<[u8]>; 2],
    /// The places in the region, by kind.
    all: [Numbering; 2],
}

/// The places of a block by its buildings, in cells from its first row and column. Cars stop outside of the block.
#[derive(Clone, Debug)]
struct Pattern {
    /// The rows and the columns that places of a block can have.
    reach: Range<i32>,
    /// Ranges of rows with places in the same columns, from the top.
    bands: Vec<Range<i32>>,
    /// For each set of buildings and each band: the columns from the left, and their number.
    cols: Vec<(Vec<Range<i32>>, usize)>,
}

/// The places in an extent, numbered row by row.
#[derive(Clone, Debug, Default)]
struct Numbering {
    extent: Rectangle,
    bands: Vec<Band>,
    count: usize,
}

/// A range of rows with equal places.
#[derive(Clone, Debug)]
struct Band {
    rows: Range<i32>,
    block_row: i32,
    /// Its position in [`Pattern::bands`].
    band: usize,
    /// Places per row.
    in_row: usize,
    /// Places in all rows above.
    before: usize,
}

impl Band {
    fn count(&self) -> usize {
        self.rows.len() * self.in_row
    }
}

fn overlap(a: &Range<i32>, b: &Range<i32>) -> Range<i32> {
    a.start.max(b.start)..a.end.min(b.end)
}

/// The positions of a block's buildings on an axis, and of the lines of cells where cars stop beside it, from its first
/// cell.
struct BlockAxis {
    buildings: [Range<i32>; 2],
    side: i32,
    /// The lines before and after the block.
    lines: [i32; 2],
    /// The lines in use among rows: above and below the block.
    above_below: [bool; 2],
    /// The lines in use among columns: to the left and to the right of the block.
    left_right: [bool; 2],
}

impl BlockAxis {
    fn new(layout: &Layout, ends: TripEnds) -> Self {
        let first = layout.block_start(0);
        let from_first = |span: Range<i32>| span.start - first..span.end - first;
        let side = layout.block_side();
        let (lines, above_below, left_right) = match ends {
            TripEnds::Curb => ([-1, side], [true, true], [true, true]),
            // Cars keep right: the lane above a block leads right, the lane to the right of it leads down.
            TripEnds::Lane => (
                [
                    layout.mid_line(0) + layout.lane_offset() - first,
                    layout.mid_line(1) - layout.lane_offset() - first,
                ],
                [true, false],
                [false, true],
            ),
        };
        BlockAxis {
            buildings: [0, 1].map(|which| from_first(layout.building_span(0, which))),
            side,
            lines,
            above_below,
            left_right,
        }
    }

    /// The coordinates from the first line to the last.
    fn reach(&self) -> Range<i32> {
        self.lines[0]..self.lines[1] + 1
    }

    /// The block and the lines beside it, split into ranges of equivalent coordinates.
    fn parts(&self) -> Vec<Range<i32>> {
        let [before, after] = self.lines;
        let mut lines = vec![before, before + 1, 0, self.side, after, after + 1];
        for span in &self.buildings {
            lines.extend([span.start - 1, span.start, span.end, span.end + 1]);
        }
        lines.sort_unstable();
        lines.dedup();
        lines.windows(2).map(|pair| pair[0]..pair[1]).collect()
    }

    /// The building that contains a coordinate.
    fn within(&self, at: i32) -> Option<usize> {
        self.buildings.iter().position(|span| span.contains(&at))
    }

    /// The building on the side of a line, if that line is in use.
    fn beside(&self, used: [bool; 2], at: i32) -> Option<usize> {
        (0..2).find(|&side| used[side] && self.lines[side] == at)
    }

    /// Whether a coordinate is in a building or adjacent to it.
    fn touches(&self, at: i32, which: usize) -> bool {
        (self.buildings[which].start - 1..=self.buildings[which].end).contains(&at)
    }

    /// Whether agents of a kind start at a cell, given the set of buildings where they start.
    fn is_place(&self, kind: AgentKind, set: u8, row: i32, col: i32) -> bool {
        let has = |row: usize, col: usize| set >> (2 * row + col) & 1 == 1;
        match kind {
            AgentKind::Car => {
                let across = |used, at, along| Some((self.beside(used, at)?, self.within(along)?));
                across(self.above_below, row, col).is_some_and(|(row, col)| has(row, col))
                    || across(self.left_right, col, row).is_some_and(|(col, row)| has(row, col))
            }
            AgentKind::Pedestrian => {
                let touches = |&(r, c): &(usize, usize)| has(r, c) && self.touches(row, r) && self.touches(col, c);
                let is_free = self.within(row).is_none() || self.within(col).is_none();
                is_free && [(0, 0), (0, 1), (1, 0), (1, 1)].iter().any(touches)
            }
        }
    }
}

impl Pattern {
    fn new(layout: &Layout, ends: TripEnds, kind: AgentKind) -> Self {
        let axis = BlockAxis::new(layout, ends);
        let parts = axis.parts();
        let cols_of = |set: u8, rows: &Range<i32>| -> Vec<Range<i32>> {
            let is_place = |cols: &&Range<i32>| axis.is_place(kind, set, rows.start, cols.start);
            parts.iter().filter(is_place).cloned().collect()
        };
        let has_places = |rows: &&Range<i32>| (0..16).any(|set| !cols_of(set, rows).is_empty());
        let bands: Vec<Range<i32>> = parts.iter().filter(has_places).cloned().collect();
        let counted = |cols: Vec<Range<i32>>| {
            let count = cols.iter().map(|cols| cols.len()).sum();
            (cols, count)
        };
        let pairs = (0..16).flat_map(|set| bands.iter().map(move |rows| (set, rows)));
        Pattern {
            reach: axis.reach(),
            cols: pairs.map(|(set, rows)| counted(cols_of(set, rows))).collect(),
            bands,
        }
    }
}

/// The bit set of the four buildings where agents of a kind start.
fn starts(kind: AgentKind, buildings: [Building; 4]) -> u8 {
    let is_start = |building| match kind {
        AgentKind::Car => matches!(building, Building::GasStation | Building::Garage | Building::Store),
        AgentKind::Pedestrian => matches!(building, Building::House | Building::Office),
    };
    (0..4).filter(|&at| is_start(buildings[at])).map(|at| 1 << at).sum()
}

/// The rows (or columns) of blocks with coordinates of their `reach` in this range of cells.
fn blocks_near(layout: &Layout, reach: &Range<i32>, cells: &Range<i32>, blocks: i32) -> Range<i32> {
    let (period, start) = (layout.period(), layout.block_start(0));
    let first = (cells.start - start - reach.end).div_euclid(period) + 1;
    let end = (cells.end - start - reach.start - 1).div_euclid(period) + 1;
    first.max(0)..end.min(blocks)
}

/// The places of one kind.
#[derive(Clone, Copy)]
struct OfKind<'p> {
    kind: AgentKind,
    layout: &'p Layout,
    starts: &'p [u8],
    pattern: &'p Pattern,
}

/// The places of one kind in an extent.
#[derive(Clone, Copy)]
struct Selection<'p> {
    of: OfKind<'p>,
    numbering: &'p Numbering,
}

impl Numbering {
    fn new(of: OfKind<'_>, extent: Rectangle) -> Self {
        let layout = of.layout;
        let near = blocks_near(layout, &of.pattern.reach, &extent.cols, layout.blocks()[1]);
        let mut numbering = Numbering {
            bands: Vec::new(),
            count: 0,
            extent,
        };
        for block_row in blocks_near(layout, &of.pattern.reach, &numbering.extent.rows, layout.blocks()[0]) {
            let first = layout.block_start(block_row);
            for (band, rows) in of.pattern.bands.iter().enumerate() {
                let rows = overlap(&(first + rows.start..first + rows.end), &numbering.extent.rows);
                if rows.is_empty() {
                    continue;
                }
                let selection = Selection {
                    of,
                    numbering: &numbering,
                };
                let in_row = near
                    .clone()
                    .map(|block_col| selection.in_block(block_row, block_col, band))
                    .sum();
                let band = Band {
                    rows,
                    block_row,
                    band,
                    in_row,
                    before: numbering.count,
                };
                numbering.count += band.count();
                numbering.bands.push(band);
            }
        }
        numbering
    }
}

impl Selection<'_> {
    /// The columns of each row of a band of a block, from the block's first, and their number. Ignores the extent.
    fn cols(&self, block_row: i32, block_col: i32, band: usize) -> &(Vec<Range<i32>>, usize) {
        let block = block_row * self.of.layout.blocks()[1] + block_col;
        let set = usize::from(self.of.starts[block as usize]);
        &self.of.pattern.cols[set * self.of.pattern.bands.len() + band]
    }

    /// The columns on the map of the places in the extent.
    fn runs(&self, block_row: i32, block_col: i32, band: usize) -> impl Iterator<Item = Range<i32>> {
        let first = self.of.layout.block_start(block_col);
        (self.cols(block_row, block_col, band).0.iter())
            .map(move |cols| overlap(&(first + cols.start..first + cols.end), &self.numbering.extent.cols))
    }

    /// The number of places in the extent, per row of a band of a block.
    fn in_block(&self, block_row: i32, block_col: i32, band: usize) -> usize {
        let (first, reach) = (self.of.layout.block_start(block_col), &self.of.pattern.reach);
        let extent = &self.numbering.extent.cols;
        if extent.start <= first + reach.start && first + reach.end <= extent.end {
            return self.cols(block_row, block_col, band).1;
        }
        self.runs(block_row, block_col, band).map(|cols| cols.len()).sum()
    }

    fn blocks_across(&self) -> Range<i32> {
        blocks_near(
            self.of.layout,
            &self.of.pattern.reach,
            &self.numbering.extent.cols,
            self.of.layout.blocks()[1],
        )
    }

    /// The place with a number below the count.
    fn nth(&self, number: usize) -> Option<Cell> {
        let bands = &self.numbering.bands;
        let band = bands[..bands.partition_point(|band| band.before <= number)]
            .iter()
            .rfind(|band| band.in_row > 0)?;
        let inside = number - band.before;
        self.in_band(band, inside / band.in_row, inside % band.in_row, None)
    }

    /// The place with a number in a row of a band, without the places of one block.
    fn in_band(&self, band: &Band, row: usize, mut number: usize, without: Option<i32>) -> Option<Cell> {
        for block_col in self.blocks_across().filter(|&block_col| Some(block_col) != without) {
            let count = self.in_block(band.block_row, block_col, band.band);
            if number < count {
                let col = (self.runs(band.block_row, block_col, band.band).flatten()).nth(number)?;
                return Some(Cell::new(band.rows.start + i32::try_from(row).ok()?, col));
            }
            number -= count;
        }
        None
    }

    /// The number of a cell; `None` if it is not a place in the extent.
    fn number(&self, cell: Cell) -> Option<usize> {
        let bands = &self.numbering.bands;
        let band = bands[..bands.partition_point(|band| band.rows.start <= cell.row)].last()?;
        if !band.rows.contains(&cell.row) {
            return None;
        }
        let mut number = band.before + (cell.row - band.rows.start) as usize * band.in_row;
        for block_col in self.blocks_across() {
            if cell.col >= self.of.layout.block_start(block_col) + self.of.pattern.reach.end {
                number += self.in_block(band.block_row, block_col, band.band);
                continue;
            }
            for cols in self.runs(band.block_row, block_col, band.band) {
                if cols.contains(&cell.col) {
                    return Some(number + (cell.col - cols.start) as usize);
                }
                number += cols.len();
            }
            return None;
        }
        None
    }

    /// The possible goals of an agent at `start`; `None` if there are none.
    fn goals(&self, start: Cell) -> Option<Goals<'_>> {
        let home = match self.of.kind {
            AgentKind::Car => None,
            AgentKind::Pedestrian => self.of.layout.block_place(start),
        };
        let (without, own) = match home {
            None => {
                let own = self.number(start);
                (Without::Place(own), usize::from(own.is_some()))
            }
            Some([block_row, block_col]) => {
                let bands = &self.numbering.bands;
                let first = bands.partition_point(|band| band.block_row < block_row);
                let bands = first..bands.partition_point(|band| band.block_row <= block_row);
                let in_band = |band: &Band| band.rows.len() * self.in_block(block_row, block_col, band.band);
                let own = self.numbering.bands[bands.clone()].iter().map(in_band).sum();
                (Without::Block { bands, block_col, own }, own)
            }
        };
        let count = self.numbering.count - own;
        (count > 0).then_some(Goals {
            selection: *self,
            count,
            without,
        })
    }
}

/// The possible goals of an agent, numbered in order of place.
struct Goals<'p> {
    selection: Selection<'p>,
    count: usize,
    without: Without,
}

/// The places excluded as goals.
enum Without {
    /// The agent's own place, if it is at one.
    Place(Option<usize>),
    /// The agent's own block.
    Block {
        /// The bands of its row of blocks.
        bands: Range<usize>,
        block_col: i32,
        /// The number of its places.
        own: usize,
    },
}

impl Goals<'_> {
    fn nth(&self, number: usize) -> Option<Cell> {
        match &self.without {
            Without::Place(own) => self
                .selection
                .nth(number + usize::from(own.is_some_and(|own| own <= number))),
            Without::Block { bands, block_col, own } => {
                let mut left = number;
                for (place, band) in self.selection.numbering.bands[bands.clone()].iter().enumerate() {
                    if place == 0 {
                        let Some(inside) = number.checked_sub(band.before) else {
                            return self.selection.nth(number);
                        };
                        left = inside;
                    }
                    let in_row = band.in_row - self.selection.in_block(band.block_row, *block_col, band.band);
                    if left < in_row * band.rows.len() {
                        return self
                            .selection
                            .in_band(band, left / in_row, left % in_row, Some(*block_col));
                    }
                    left -= in_row * band.rows.len();
                }
                self.selection.nth(number + own)
            }
        }
    }
}

impl BlockPlaces {
    fn new(map: &Arc<CityMap>, layout: Layout, ends: TripEnds, extent: &Rectangle) -> Self {
        let starts = AgentKind::ALL.map(|kind| map.buildings().iter().map(|&block| starts(kind, block)).collect());
        let mut places = BlockPlaces {
            patterns: AgentKind::ALL.map(|kind| Pattern::new(&layout, ends, kind)),
            starts,
            all: [Numbering::default(), Numbering::default()],
            layout,
        };
        places.all = AgentKind::ALL.map(|kind| Numbering::new(places.of(kind), extent.clone()));
        places
    }

    fn of(&self, kind: AgentKind) -> OfKind<'_> {
        OfKind {
            kind,
            layout: &self.layout,
            starts: &self.starts[kind as usize],
            pattern: &self.patterns[kind as usize],
        }
    }

    /// The places in `near`, or in the whole region.
    fn selection<'p>(&'p self, kind: AgentKind, near: Option<&'p Numbering>) -> Selection<'p> {
        Selection {
            of: self.of(kind),
            numbering: near.unwrap_or(&self.all[kind as usize]),
        }
    }

    /// The places at most `trip` rows and columns away.
    fn near(&self, kind: AgentKind, start: Cell, trip: i32) -> Numbering {
        let around = |at: i32| at.saturating_sub(trip)..at.saturating_add(trip).saturating_add(1);
        let all = &self.all[kind as usize].extent;
        let extent = Rectangle {
            rows: overlap(&around(start.row), &all.rows),
            cols: overlap(&around(start.col), &all.cols),
        };
        Numbering::new(self.of(kind), extent)
    }
}

/// The cells of a lane at each of its ends where cars neither start nor arrive.
const LANE_ENDS: usize = 3;

/// Returns the places of a kind on a road network, row by row.
fn on_roads(map: &CityMap, roads: &RoadMap, kind: AgentKind, extent: &Rectangle) -> Box<[Cell]> {
    let mut cells: Vec<Cell> = match kind {
        AgentKind::Car => {
            // A car goes on from its goal.
            let middles = roads.circulating(extent).into_iter().flat_map(|lane| {
                let path = roads.path(lane);
                let end = path.len().saturating_sub(LANE_ENDS);
                &path[LANE_ENDS.min(end)..end]
            });
            // Where lanes meet, the nearest one counts.
            middles.copied().filter(|&cell| roads.spot(cell).is_some()).collect()
        }
        AgentKind::Pedestrian => roads.cells(|cell| {
            map.ground_at(cell) == Some(Ground::Walking) && map.intersection(AgentKind::Pedestrian, cell).is_none()
        }),
    };
    cells.retain(|&cell| extent.contains(cell));
    cells.sort_unstable();
    cells.dedup();
    cells.into()
}

impl Places {
    /// Returns the places within the first `region` rows and columns; `None` for the whole map. Goals are at most
    /// `trip` rows and columns away; `None` for no limit. Trips of cars start and end at `ends` on a map of blocks.
    pub fn new(router: &Router, ends: TripEnds, region: Option<u32>, trip: Option<u32>) -> Self {
        Places::of(router, ends, region.map(Region::Side).as_ref(), trip)
    }

    /// Returns the places in a region; `None` for the whole map.
    pub fn of(router: &Router, ends: TripEnds, region: Option<&Region>, trip: Option<u32>) -> Self {
        let map = router.map();
        let whole = || Rectangle {
            rows: 0..map.rows(),
            cols: 0..map.cols(),
        };
        let extent = region.map_or_else(whole, |region| region.extent(map));
        let terrain = match (map.layout(), map.roads()) {
            (Some(layout), _) => Terrain::Blocks(Box::new(BlockPlaces::new(map, *layout, ends, &extent))),
            (None, Some(roads)) => Terrain::Roads(AgentKind::ALL.map(|kind| on_roads(map, roads, kind, &extent))),
            (None, None) => Terrain::Roads(Default::default()),
        };
        Places {
            ends,
            trip: trip.map(|cells| i32::try_from(cells).unwrap_or(i32::MAX)),
            terrain,
        }
    }

    /// Returns where trips of cars start and end on a map of blocks.
    pub fn trip_ends(&self) -> TripEnds {
        self.ends
    }

    /// Returns the number of places for agents of a kind.
    pub fn count(&self, kind: AgentKind) -> usize {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.all[kind as usize].count,
            Terrain::Roads(places) => places[kind as usize].len(),
        }
    }

    /// Returns the place with this number for agents of a kind, or `None` if the number is too large.
    pub fn nth(&self, kind: AgentKind, number: usize) -> Option<Cell> {
        match &self.terrain {
            Terrain::Blocks(blocks) => (number < self.count(kind)).then(|| blocks.selection(kind, None).nth(number))?,
            Terrain::Roads(places) => places[kind as usize].get(number).copied(),
        }
    }

    /// Returns whether agents of a kind start and arrive here.
    pub fn contains(&self, kind: AgentKind, cell: Cell) -> bool {
        match &self.terrain {
            Terrain::Blocks(blocks) => blocks.selection(kind, None).number(cell).is_some(),
            Terrain::Roads(places) => places[kind as usize].binary_search(&cell).is_ok(),
        }
    }

    /// Draws a goal for an agent at `start` and plans a route to it. The goal of a car is any place but the start. The
    /// goal of a pedestrian is in another block, so it is more than 3 cells away from the buildings of its own block;
    /// on a road network it is any place but the start. If a goal cannot be reached, it draws again, up to 16 times in
    /// all.
    ///
    /// # Errors
    /// If there is no such place, or none of those drawn can be reached.
    pub fn draw_route(
        &self,
        router: &Router,
        kind: AgentKind,
        start: Cell,
        stream: &mut impl Rng,
    ) -> Result<Route, NoRoute> {
        self.with_goals(kind, start, |count, nth| {
            if count == 0 {
                return Err(NoRoute::Goal);
            }
            let mut failure = NoRoute::Unconnected;
            for _ in 0..GOAL_DRAWS {
                let goal = nth(stream.random_range(0..count)).ok_or(NoRoute::Goal)?;
                match router.plan(kind, start, goal) {
                    Ok(route) => return Ok(route),
                    Err(fault @ (NoRoute::Start | NoRoute::TooFar)) => return Err(fault),
                    Err(other) => failure = other,
                }
            }
            Err(failure)
        })
    }

    /// Calls a function with the number of possible goals of an agent at `start`, and with the goal of each number.
    fn with_goals<T>(
        &self,
        kind: AgentKind,
        start: Cell,
        work: impl FnOnce(usize, &dyn Fn(usize) -> Option<Cell>) -> T,
    ) -> T {
        match &self.terrain {
            Terrain::Blocks(blocks) => {
                let near = self.trip.map(|trip| blocks.near(kind, start, trip));
                match blocks.selection(kind, near.as_ref()).goals(start) {
                    Some(goals) => work(goals.count, &|number| goals.nth(number)),
                    None => work(0, &|_| None),
                }
            }
            Terrain::Roads(places) => {
                let all = &places[kind as usize];
                let near: Option<Vec<Cell>> = self.trip.map(|trip| {
                    let low = all.partition_point(|cell| cell.row < start.row.saturating_sub(trip));
                    let high = all.partition_point(|cell| cell.row <= start.row.saturating_add(trip));
                    let is_near = |cell: &&Cell| (cell.col - start.col).abs() <= trip;
                    all[low..high].iter().filter(is_near).copied().collect()
                });
                let all = near.as_deref().unwrap_or(all);
                let own = all.binary_search(&start).ok();
                let nth = |number: usize| {
                    all.get(number + usize::from(own.is_some_and(|own| own <= number)))
                        .copied()
                };
                work(all.len() - usize::from(own.is_some()), &nth)
            }
        }
    }

    /// Returns the goals from which [`Places::draw_route`] draws, row by row.
    pub fn goals(&self, kind: AgentKind, start: Cell) -> Vec<Cell> {
        self.with_goals(kind, start, |count, nth| (0..count).filter_map(nth).collect())
    }
}
