//! Where agents start and arrive, counted and drawn without listing them.
//!
//! Which cells of a block are places depends on its four buildings only, so there are sixteen patterns for each kind of agent. A
//! pattern is cut into bands of equal rows; with the number of places in every band of every row of blocks, the place of a
//! given number is found by its place among those.

use super::{Cell, CityMap, Layout, NoRoute, Route, Router};
use crate::config::{AgentKind, Building};
use crate::rng::{Rng, RngExt};
use std::ops::Range;
use std::sync::Arc;

/// How often a goal that cannot be reached is drawn again.
const GOAL_DRAWS: usize = 16;

/// The cells where agents start and arrive in a region of the map, numbered from 0 row by row.
///
/// Pedestrians: cells of the walking street that touch a house or an office, corners included. Cars: the kerb cells of a traffic
/// street straight across the sidewalk from a gas station, garage or store.
#[derive(Clone, Debug)]
pub struct Places {
    map: Arc<CityMap>,
    patterns: [Pattern; 2],
    /// The places in the region, for each kind.
    all: [Numbering; 2],
    /// How many rows and columns away a goal may be.
    trip: Option<i32>,
}

/// Rows and columns of cells.
#[derive(Clone, Debug)]
struct Window {
    rows: Range<i32>,
    cols: Range<i32>,
}

/// The places of a block by its buildings, in cells from its first row and column; kerbs are one before and one behind the block.
#[derive(Clone, Debug)]
struct Pattern {
    /// Rows of cells in which the places of a block lie in the same columns, from the top.
    bands: Vec<Range<i32>>,
    /// For each set of buildings, the columns in each band, from the left, and how many these are.
    cols: Vec<Vec<(Vec<Range<i32>>, u32)>>,
}

/// The places in a window, numbered row by row.
#[derive(Clone, Debug)]
struct Numbering {
    window: Window,
    bands: Vec<Band>,
    count: usize,
}

/// Rows of the map that hold equally many places in the same columns.
#[derive(Clone, Debug)]
struct Band {
    rows: Range<i32>,
    block_row: i32,
    /// Its place in [`Pattern::bands`].
    band: usize,
    /// Places in each of the rows.
    in_row: usize,
    /// Places in the rows above.
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

impl Pattern {
    fn new(layout: &Layout, kind: AgentKind) -> Self {
        let first = layout.block_start(0);
        let spans = [0, 1].map(|which| {
            let span = layout.building_span(0, which);
            span.start - first..span.end - first
        });
        let side = layout.block_side();
        // Between these lines all cells are alike.
        let mut lines = vec![-1, 0, side, side + 1];
        for span in &spans {
            lines.extend([span.start - 1, span.start, span.end, span.end + 1]);
        }
        lines.sort_unstable();
        lines.dedup();
        let parts: Vec<Range<i32>> = lines.windows(2).map(|pair| pair[0]..pair[1]).collect();
        // The place of the building across from a kerb, or of the one that the coordinate is in.
        let which = |at: i32| spans.iter().position(|span| span.contains(&at));
        let is_place = |set: usize, row: i32, col: i32| {
            let has = |row: usize, col: usize| set >> (2 * row + col) & 1 == 1;
            let end = |at: i32| (at == -1).then_some(0).or((at == side).then_some(1));
            match kind {
                AgentKind::Car => {
                    let across = |at: i32, along: i32| Some((end(at)?, which(along)?));
                    across(row, col).is_some_and(|(row, col)| has(row, col))
                        || across(col, row).is_some_and(|(col, row)| has(row, col))
                }
                AgentKind::Pedestrian => {
                    let touches = |which: usize, at: i32| (spans[which].start - 1..=spans[which].end).contains(&at);
                    let free = which(row).is_none() || which(col).is_none();
                    free && [(0, 0), (0, 1), (1, 0), (1, 1)]
                        .into_iter()
                        .any(|(r, c)| has(r, c) && touches(r, row) && touches(c, col))
                }
            }
        };
        let cols_of = |set: usize, row: i32| -> Vec<Range<i32>> {
            (parts.iter().filter(|cols| is_place(set, row, cols.start)))
                .cloned()
                .collect()
        };
        let bands: Vec<Range<i32>> = (parts.iter())
            .filter(|rows| (0..16).any(|set| !cols_of(set, rows.start).is_empty()))
            .cloned()
            .collect();
        let cols = (0..16).map(|set| {
            let counted = |cols: Vec<Range<i32>>| {
                let count = cols.iter().map(|cols| cols.len()).sum::<usize>();
                (
                    cols,
                    u32::try_from(count).expect("a block is less than 2^20 cells wide"),
                )
            };
            bands.iter().map(|rows| counted(cols_of(set, rows.start))).collect()
        });
        Pattern {
            cols: cols.collect(),
            bands,
        }
    }
}

/// Which of four buildings agents of a kind start at, as a set of bits.
fn starts(kind: AgentKind, buildings: [Building; 4]) -> usize {
    let is_start = |building| match kind {
        AgentKind::Car => matches!(building, Building::GasStation | Building::Garage | Building::Store),
        AgentKind::Pedestrian => matches!(building, Building::House | Building::Office),
    };
    (0..4).filter(|&at| is_start(buildings[at])).map(|at| 1 << at).sum()
}

/// The rows of blocks, or columns, whose places can be within these rows or columns of cells.
fn blocks_near(layout: &Layout, cells: &Range<i32>, blocks: i32) -> Range<i32> {
    let block = |at: i32| at.div_euclid(layout.period());
    (block(cells.start) - 1).max(0)..(block(cells.end) + 1).min(blocks)
}

/// What one call looks at: the places of one kind in a window.
#[derive(Clone, Copy)]
struct View<'p> {
    kind: AgentKind,
    map: &'p CityMap,
    pattern: &'p Pattern,
    numbering: &'p Numbering,
}

impl Numbering {
    fn new(map: &CityMap, kind: AgentKind, pattern: &Pattern, window: Window) -> Self {
        let layout = &map.layout;
        let near = blocks_near(layout, &window.cols, layout.blocks()[1]);
        let mut numbering = Numbering {
            bands: Vec::new(),
            count: 0,
            window,
        };
        for block_row in blocks_near(layout, &numbering.window.rows, layout.blocks()[0]) {
            let first = layout.block_start(block_row);
            for (band, rows) in pattern.bands.iter().enumerate() {
                let rows = overlap(&(first + rows.start..first + rows.end), &numbering.window.rows);
                if rows.is_empty() {
                    continue;
                }
                let view = View {
                    kind,
                    map,
                    pattern,
                    numbering: &numbering,
                };
                let in_row = near
                    .clone()
                    .map(|block_col| view.in_block(block_row, block_col, band))
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

impl View<'_> {
    /// The columns in each row of a band of a block, whether they are in the window or not, from the block's first; and how many.
    fn cols(&self, block_row: i32, block_col: i32, band: usize) -> &(Vec<Range<i32>>, u32) {
        let set = starts(self.kind, self.map.block_buildings(block_row, block_col));
        &self.pattern.cols[set][band]
    }

    /// The columns of those that are in the window.
    fn runs(&self, block_row: i32, block_col: i32, band: usize) -> impl Iterator<Item = Range<i32>> {
        let first = self.map.layout.block_start(block_col);
        (self.cols(block_row, block_col, band).0.iter())
            .map(move |cols| overlap(&(first + cols.start..first + cols.end), &self.numbering.window.cols))
    }

    /// How many places in each row of a band of a block are in the window.
    fn in_block(&self, block_row: i32, block_col: i32, band: usize) -> usize {
        let first = self.map.layout.block_start(block_col) - 1;
        let window = &self.numbering.window.cols;
        if window.start <= first && first + self.map.layout.block_side() + 2 <= window.end {
            return self.cols(block_row, block_col, band).1 as usize;
        }
        self.runs(block_row, block_col, band).map(|cols| cols.len()).sum()
    }

    fn blocks_across(&self) -> Range<i32> {
        blocks_near(
            &self.map.layout,
            &self.numbering.window.cols,
            self.map.layout.blocks()[1],
        )
    }

    /// The place of a number below the count.
    fn nth(&self, number: usize) -> Option<Cell> {
        let bands = &self.numbering.bands;
        let band = bands[..bands.partition_point(|band| band.before <= number)]
            .iter()
            .rfind(|band| band.in_row > 0)?;
        let inside = number - band.before;
        self.in_band(band, inside / band.in_row, inside % band.in_row, None)
    }

    /// The place of a number in a row of a band, where the places of one block do not count.
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

    /// The number of a cell; `None` if it is no place in the window.
    fn number(&self, cell: Cell) -> Option<usize> {
        let bands = &self.numbering.bands;
        let band = bands[..bands.partition_point(|band| band.rows.start <= cell.row)].last()?;
        if !band.rows.contains(&cell.row) {
            return None;
        }
        let mut number = band.before + (cell.row - band.rows.start) as usize * band.in_row;
        for block_col in self.blocks_across() {
            // Its places begin with the kerb before it.
            if cell.col > self.map.layout.block_start(block_col) + self.map.layout.block_side() {
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

    /// Draws goals for an agent at `start` among the places that count for it; `None` if there is none.
    fn goals(&self, start: Cell) -> Option<Goals<'_>> {
        let goals = match self.kind {
            AgentKind::Car => {
                let own = self.number(start);
                Goals {
                    view: *self,
                    count: self.numbering.count - usize::from(own.is_some()),
                    without: Without::Place(own),
                }
            }
            AgentKind::Pedestrian => {
                let layout = &self.map.layout;
                let Some([block_row, block_col]) = layout.block_place(start) else {
                    let without = Without::Place(None);
                    return (self.numbering.count > 0).then_some(Goals {
                        view: *self,
                        count: self.numbering.count,
                        without,
                    });
                };
                let bands = &self.numbering.bands;
                let first = bands.partition_point(|band| band.block_row < block_row);
                let home = first..bands.partition_point(|band| band.block_row <= block_row);
                let own: usize = (bands[home.clone()].iter())
                    .map(|band| band.rows.len() * self.in_block(block_row, block_col, band.band))
                    .sum();
                Goals {
                    view: *self,
                    count: self.numbering.count - own,
                    without: Without::Block {
                        bands: home,
                        block_col,
                        own,
                    },
                }
            }
        };
        (goals.count > 0).then_some(goals)
    }
}

/// The places that an agent may go to, numbered in the same order.
struct Goals<'p> {
    view: View<'p>,
    count: usize,
    without: Without,
}

/// What an agent does not go to.
enum Without {
    /// The place where it is, if it is one.
    Place(Option<usize>),
    /// Its own block.
    Block {
        /// The bands of the block's row.
        bands: Range<usize>,
        block_col: i32,
        /// Its places.
        own: usize,
    },
}

impl Goals<'_> {
    fn nth(&self, number: usize) -> Option<Cell> {
        match &self.without {
            Without::Place(own) => self
                .view
                .nth(number + usize::from(own.is_some_and(|own| own <= number))),
            Without::Block { bands, block_col, own } => {
                let mut left = number;
                for (place, band) in self.view.numbering.bands[bands.clone()].iter().enumerate() {
                    if place == 0 {
                        let Some(inside) = number.checked_sub(band.before) else {
                            return self.view.nth(number);
                        };
                        left = inside;
                    }
                    let in_row = band.in_row - self.view.in_block(band.block_row, *block_col, band.band);
                    if left < in_row * band.rows.len() {
                        return self.view.in_band(band, left / in_row, left % in_row, Some(*block_col));
                    }
                    left -= in_row * band.rows.len();
                }
                self.view.nth(number + own)
            }
        }
    }
}

impl Places {
    /// The places within the first `region` rows and columns; `None` for the whole map. A goal is drawn from those that are at
    /// most `trip` rows and columns away; `None` for all of them.
    pub fn new(router: &Router, region: Option<u32>, trip: Option<u32>) -> Self {
        let map = router.map();
        let cells = |cells: u32| i32::try_from(cells).unwrap_or(i32::MAX);
        let limit = region.map_or(i32::MAX, cells);
        let window = Window {
            rows: 0..map.rows().min(limit),
            cols: 0..map.cols().min(limit),
        };
        let patterns = AgentKind::ALL.map(|kind| Pattern::new(&map.layout, kind));
        let all = AgentKind::ALL.map(|kind| Numbering::new(map, kind, &patterns[kind as usize], window.clone()));
        Places {
            map: Arc::clone(map),
            patterns,
            all,
            trip: trip.map(cells),
        }
    }

    fn all(&self, kind: AgentKind) -> View<'_> {
        self.view(kind, &self.all[kind as usize])
    }

    fn view<'p>(&'p self, kind: AgentKind, numbering: &'p Numbering) -> View<'p> {
        View {
            kind,
            map: &self.map,
            pattern: &self.patterns[kind as usize],
            numbering,
        }
    }

    /// How many places there are for agents of a kind.
    pub fn count(&self, kind: AgentKind) -> usize {
        self.all[kind as usize].count
    }

    /// The place of that number for agents of a kind; `None` if there are not so many.
    pub fn nth(&self, kind: AgentKind, number: usize) -> Option<Cell> {
        (number < self.count(kind)).then(|| self.all(kind).nth(number))?
    }

    /// Whether agents of a kind start and arrive here.
    pub fn contains(&self, kind: AgentKind, cell: Cell) -> bool {
        self.all(kind).number(cell).is_some()
    }

    /// Draws a goal for an agent at `start` and plans the way: for a car any place but the start, for a pedestrian a place in
    /// another block (so it keeps more than 3 cells away from the buildings of its own). Draws again, a bounded number of times, if there is no way.
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
        let near = self.near(kind, start);
        let view = self.view(kind, near.as_ref().unwrap_or(&self.all[kind as usize]));
        let goals = view.goals(start).ok_or(NoRoute::Goal)?;
        let mut failure = NoRoute::Unconnected;
        for _ in 0..GOAL_DRAWS {
            let goal = goals.nth(stream.random_range(0..goals.count)).ok_or(NoRoute::Goal)?;
            match router.plan(kind, start, goal) {
                Ok(route) => return Ok(route),
                Err(NoRoute::Start) => return Err(NoRoute::Start),
                Err(other) => failure = other,
            }
        }
        Err(failure)
    }

    /// The places within a trip, if trips are limited.
    fn near(&self, kind: AgentKind, start: Cell) -> Option<Numbering> {
        let trip = self.trip?;
        let around = |at: i32| at.saturating_sub(trip)..at.saturating_add(trip).saturating_add(1);
        let all = &self.all[kind as usize].window;
        let window = Window {
            rows: overlap(&around(start.row), &all.rows),
            cols: overlap(&around(start.col), &all.cols),
        };
        Some(Numbering::new(&self.map, kind, &self.patterns[kind as usize], window))
    }

    /// The goals that [`Places::draw_route`] draws from, row by row.
    pub fn goals(&self, kind: AgentKind, start: Cell) -> Vec<Cell> {
        let near = self.near(kind, start);
        let view = self.view(kind, near.as_ref().unwrap_or(&self.all[kind as usize]));
        let goals = view.goals(start);
        goals.map_or_else(Vec::new, |goals| {
            (0..goals.count).filter_map(|number| goals.nth(number)).collect()
        })
    }
}
