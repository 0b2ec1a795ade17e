//! Routes of pedestrians: a direct construction, and the search of the published program.
//!
//! The sidewalks along the streets of a row of blocks form two *bands*, one above and one below the blocks. Crossings
//! connect them over every street, so a band spans the whole map. Columns of blocks have bands too. All other walkable
//! cells are between the buildings of a block, in two inner sidewalks that cross in its center. So a route leaves a
//! block by one of the four ends of its inner sidewalks and changes between bands where they cross. There are few
//! candidates, and the shortest of them is a shortest path.

use crate::city::map::Strip;
use crate::city::route::{NoRoute, Way, steps};
use crate::city::{Cell, CityMap, Heading, Layout};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use std::collections::HashMap;

impl Purpose {
    /// The choice among shortest paths; index: the start, tick: the goal.
    pub const WALK: Purpose = Purpose::new(16);
}

/// The corners of a path, without its end.
#[derive(Clone, Copy)]
struct Corners {
    steps: u32,
    corners: [Cell; 2],
}

/// Continues the route to a goal on foot. Its current cell and the goal must be walkable.
pub(super) fn walk(layout: &Layout, goal: Cell, way: &mut Way<'_>) {
    let start = way.at();
    let (from, to) = (Spot::new(layout, start), Spot::new(layout, goal));
    if let (Some(block), Some(other)) = (from.block, to.block)
        && block == other
    {
        // Go along the inner sidewalk to the crossing with the other one.
        return way.bend(goal, !from.row_is_inner);
    }
    let mut best: Option<(u32, [Cell; 6])> = None;
    let (exits, entries) = (from.exits(layout), to.exits(layout));
    for out in &exits[..from.ways()] {
        for back in &entries[..to.ways()] {
            let between = between(layout, out, back);
            let steps = out.steps + between.steps + back.steps;
            if best.is_none_or(|(least, _)| steps < least) {
                let [first, second] = between.corners;
                best = Some((steps, [out.corner, out.cell, first, second, back.cell, back.corner]));
            }
        }
    }
    let mut line = Line::new(start);
    for corner in best.iter().flat_map(|(_, corners)| corners) {
        line.push(*corner);
    }
    line.push(goal);
    line.stroll(layout, way);
}

/// A shortest path with few straight legs.
struct Line {
    /// The start, the corners, the end.
    points: [Cell; Line::MOST],
    count: usize,
}

impl Line {
    const MOST: usize = 8;

    fn new(start: Cell) -> Line {
        Line {
            points: [start; Line::MOST],
            count: 1,
        }
    }

    /// Continues to a cell in the same row or column.
    fn push(&mut self, to: Cell) {
        let last = self.points[self.count - 1];
        let Some(heading) = Heading::between(last, to) else {
            return;
        };
        if self.count > 1 && Heading::between(self.points[self.count - 2], last) == Some(heading) {
            self.points[self.count - 1] = to;
        } else {
            self.points[self.count] = to;
            self.count += 1;
        }
    }

    /// Walks along the path with random sidesteps.
    ///
    /// A corner replaces steps in the old direction by steps in the new one. The pedestrian makes some of the new steps
    /// early, on the leg before the corner, and some of the old ones late, on the leg behind it. Their number is
    /// limited by the width of the sidewalk. The length stays the same.
    ///
    /// Straight paths would cross streets on the line where an intersection begins: *At* it, but never *In* it. With
    /// sidesteps, pedestrians are at and in intersections as often as those of the published program. The sidesteps are
    /// drawn for each pair of start and goal.
    fn stroll(&self, layout: &Layout, way: &mut Way<'_>) {
        let points = &self.points[..self.count];
        let number = |cell: Cell| u64::from(cell.row.cast_unsigned()) << 32 | u64::from(cell.col.cast_unsigned());
        let mut stream = Seed(0).stream(Purpose::WALK, number(points[0]), number(points[self.count - 1]));
        // Steps of the next leg made early, and the rest of the last leg with its direction.
        let (mut early, mut left) = (0, None);
        for (place, leg) in points.windows(2).enumerate() {
            let (from, to) = (leg[0], leg[1]);
            let heading = heading_of(from, to);
            let mut ahead = steps(from, to) - early;
            let mut aside = Aside::default();
            aside.add(left.take());
            early = 0;
            if let Some(&next) = points.get(place + 2) {
                let turn = heading_of(to, next);
                let late = room(layout, to, next, heading.opposite()).min(ahead);
                early = room(layout, from, to, turn).min(steps(to, next));
                ahead -= late;
                left = Some((heading, late));
                aside.add(Some((turn, early)));
            }
            aside.go(heading, ahead, &mut stream, way);
        }
    }
}

/// The heading of a leg of a [`Line`].
fn heading_of(from: Cell, to: Cell) -> Heading {
    Heading::between(from, to).expect("two points of a line that follow each other differ in one coordinate")
}

/// The maximum number of sidesteps on one side of a corner.
const ASIDE_MAX: u32 = 8;

/// The sidesteps of a leg, in order.
#[derive(Default)]
struct Aside {
    steps: [Option<Heading>; 2 * ASIDE_MAX as usize],
    count: usize,
}

impl Aside {
    fn add(&mut self, more: Option<(Heading, u32)>) {
        if let Some((heading, steps)) = more {
            self.steps[self.count..][..steps as usize].fill(Some(heading));
            self.count += steps as usize;
        }
    }

    /// Goes `ahead` steps ahead and makes the sidesteps at random places between.
    fn go(&self, heading: Heading, ahead: u32, stream: &mut impl Rng, way: &mut Way<'_>) {
        let mut places = [0; 2 * ASIDE_MAX as usize];
        let places = &mut places[..self.count];
        places
            .iter_mut()
            .for_each(|place| *place = stream.random_range(0..=ahead));
        places.sort_unstable();
        let mut done = 0;
        for (&place, aside) in places.iter().zip(self.steps.iter().flatten()) {
            way.straight(way.at().ahead(heading, (place - done).cast_signed()));
            way.straight(way.at().ahead(*aside, 1));
            done = place;
        }
        way.straight(way.at().ahead(heading, (ahead - done).cast_signed()));
    }
}

/// The number of sidesteps possible anywhere on a straight leg along a sidewalk; 0 elsewhere.
fn room(layout: &Layout, from: Cell, to: Cell, aside: Heading) -> u32 {
    let at = if from.row == to.row { from.row } else { from.col };
    let (strip, street) = layout.strip(at);
    if strip.in_street() || strip.in_block() {
        return 0;
    }
    // The cells between the street and the buildings.
    let (low, high) = if strip.after_mid_line() {
        (layout.street_span(street).end, layout.built_span(street).start - 1)
    } else {
        (layout.built_span(street - 1).end, layout.street_span(street).start - 1)
    };
    let (row, col) = aside.delta();
    let room = if row + col > 0 { high - at } else { at - low };
    room.cast_unsigned().min(ASIDE_MAX)
}

/// A walkable cell.
struct Spot {
    cell: Cell,
    /// Whether its row belongs to the inner sidewalk of its block.
    row_is_inner: bool,
    /// The block that contains it between its buildings; `None` in a band.
    block: Option<[i32; 2]>,
}

impl Spot {
    fn new(layout: &Layout, cell: Cell) -> Self {
        let (row, col) = (layout.strip(cell.row), layout.strip(cell.col));
        let inside = row.0.in_block() && col.0.in_block();
        Spot {
            cell,
            row_is_inner: row.0 == Strip::Inner,
            block: inside.then_some([row.1, col.1]),
        }
    }

    /// The number of ways to the bands.
    fn ways(&self) -> usize {
        if self.block.is_some() { 4 } else { 1 }
    }

    /// The ways to the bands; all four are equal if there is only one.
    fn exits(&self, layout: &Layout) -> [Exit; 4] {
        let cell = self.cell;
        let Some([block_row, block_col]) = self.block else {
            return [Exit::new(layout, cell, cell, cell); 4];
        };
        let (rows, cols) = (layout.built_span(block_row), layout.built_span(block_col));
        let row = nearest_inner(layout, block_row, cell.row);
        let col = nearest_inner(layout, block_col, cell.col);
        let (along, down) = (Cell::new(row, cell.col), Cell::new(cell.row, col));
        [
            (down, Cell::new(rows.start - 1, col)),
            (along, Cell::new(row, cols.start - 1)),
            (along, Cell::new(row, cols.end)),
            (down, Cell::new(rows.end, col)),
        ]
        .map(|(corner, end)| Exit::new(layout, cell, corner, end))
    }
}

/// A way to the bands.
#[derive(Clone, Copy)]
struct Exit {
    corner: Cell,
    /// Its end: the first cell in a band.
    cell: Cell,
    steps: u32,
    /// The bands that contain its end, of rows and of columns.
    bands: [Option<Band>; 2],
}

/// A sidewalk along a street.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Band {
    street: i32,
    /// Whether it lies after the street.
    after: bool,
}

impl Exit {
    fn new(layout: &Layout, from: Cell, corner: Cell, cell: Cell) -> Self {
        let band = |at: i32| {
            let (strip, street) = layout.strip(at);
            let after = strip.after_mid_line();
            (!strip.in_street() && !strip.in_block()).then_some(Band { street, after })
        };
        Exit {
            corner,
            cell,
            steps: steps(from, corner) + steps(corner, cell),
            bands: [band(cell.row), band(cell.col)],
        }
    }
}

/// Returns a shortest path between two cells of bands.
fn between(layout: &Layout, from: &Exit, to: &Exit) -> Corners {
    let ([from_row, from_col], [to_row, to_col]) = (from.bands, to.bands);
    let (from, to) = (from.cell, to.cell);
    let bend = |corner| Corners {
        steps: steps(from, to),
        corners: [corner; 2],
    };
    if from_row.is_some() && (to_col.is_some() || from_row == to_row) {
        return bend(Cell::new(from.row, to.col));
    }
    if from_col.is_some() && (to_row.is_some() || from_col == to_col) {
        return bend(Cell::new(to.row, from.col));
    }
    // For parallel bands the path needs a band that crosses them, or the inner sidewalk of a block between them.
    let same_blocks = |one: Option<Band>, other: Option<Band>| {
        one.zip(other).is_some_and(|(one, other)| {
            let (first, second) = if one.after { (one, other) } else { (other, one) };
            first.after && !second.after && first.street + 1 == second.street
        })
    };
    let corners = if from_row.is_some() {
        // A pedestrian who goes up keeps right in the higher columns.
        let keep_high = to.row < from.row;
        let col = passage(layout, [from.col, to.col], keep_high, same_blocks(from_row, to_row));
        [Cell::new(from.row, col), Cell::new(to.row, col)]
    } else {
        let keep_high = to.col > from.col;
        let row = passage(layout, [from.row, to.row], keep_high, same_blocks(from_col, to_col));
        [Cell::new(row, from.col), Cell::new(row, to.col)]
    };
    let [first, second] = corners;
    Corners {
        steps: steps(from, first) + steps(first, second) + steps(second, to),
        corners,
    }
}

/// Returns the coordinate at which to cross from one coordinate, which is in no band, to another. It prefers one
/// between them, else the one with the least detour. Inner sidewalks count if `through_blocks`. Of equal cells of a
/// band it returns the highest or the lowest, so that pedestrians in opposite directions keep apart.
fn passage(layout: &Layout, [from, to]: [i32; 2], keep_high: bool, through_blocks: bool) -> i32 {
    let (strip, number) = layout.strip(from);
    let gap = if strip.in_street() {
        layout.street_span(number)
    } else {
        layout.built_span(number)
    };
    let (before, after) = (gap.start - 1, gap.end);
    if to <= before {
        return if keep_high {
            before
        } else {
            to.max(before + 1 - layout.sidewalk())
        };
    }
    if to >= after {
        return if keep_high {
            to.min(after - 1 + layout.sidewalk())
        } else {
            after
        };
    }
    let (low, high) = (from.min(to), from.max(to));
    let detour = |at: i32| (low - at).max(at - high).max(0);
    let mut best = if detour(before) <= detour(after) { before } else { after };
    if through_blocks && !strip.in_street() && !layout.inner_span(number).is_empty() {
        let inner = nearest_inner(layout, number, from);
        if detour(inner) < detour(best) {
            best = inner;
        }
    }
    best
}

/// The coordinate of the block's inner sidewalk that is nearest to another one.
fn nearest_inner(layout: &Layout, block: i32, at: i32) -> i32 {
    let inner = layout.inner_span(block);
    at.clamp(inner.start, inner.end - 1)
}

/// The cost of a step onto an unwalkable cell in the published program.
const WALL: u32 = 1000;

/// The maximum number of cells that a search visits; they take about 70 MB.
const CELLS_MAX: usize = 1 << 20;

/// Searches for the path of the published program: the shortest path that its A* search finds. The heuristic is the
/// number of steps without obstacles.
///
/// The order of the open list breaks ties between paths of equal length. It is a binary heap, and the neighbors of a
/// cell enter it in the order up, left, right, down. Unwalkable cells take part in that order, but no path continues
/// from them.
pub(super) fn search(map: &CityMap, goal: Cell, way: &mut Way<'_>) -> Result<(), NoRoute> {
    const NEIGHBORS: [Heading; 4] = [Heading::Up, Heading::Left, Heading::Right, Heading::Down];
    let start = way.at();
    // By cell: the cost of reaching it, and the cell before it.
    let mut reached = HashMap::from([(start, (0, start))]);
    let mut open = OpenList::default();
    open.push(0, start);
    loop {
        let cell = open.pop().ok_or(NoRoute::Unconnected)?;
        if cell == goal {
            break;
        }
        if !map.is_walkable(cell) {
            continue;
        }
        let (cost, _) = reached[&cell];
        for heading in NEIGHBORS {
            let next = cell.ahead(heading, 1);
            if !map.contains(next) {
                continue;
            }
            let cost = cost + if map.is_walkable(next) { 1 } else { WALL };
            if reached.get(&next).is_none_or(|&(known, _)| cost < known) {
                open.push(cost + steps(next, goal), next);
                reached.insert(next, (cost, cell));
            }
        }
        if reached.len() > CELLS_MAX {
            return Err(NoRoute::TooFar);
        }
    }
    let mut cells = vec![goal];
    while let Some(&last) = cells.last().filter(|&&cell| cell != start) {
        cells.push(reached[&last].1);
    }
    cells.iter().rev().for_each(|&cell| way.straight(cell));
    Ok(())
}

/// The open list of A*: a binary heap of cells, the least estimate first. It breaks ties as the heaps of C++ and Python
/// do. Unlike Rust's heap, these close the gap at the top down to a leaf, and then sift the last element up from there.
#[derive(Default)]
struct OpenList {
    /// Estimates of complete paths, each with its cell.
    heap: Vec<(u32, Cell)>,
}

impl OpenList {
    fn push(&mut self, estimate: u32, cell: Cell) {
        self.heap.push((estimate, cell));
        self.rise(self.heap.len() - 1);
    }

    fn pop(&mut self) -> Option<Cell> {
        if self.heap.is_empty() {
            return None;
        }
        let (_, first) = self.heap.swap_remove(0);
        let count = self.heap.len();
        let (mut at, last) = (0, self.heap.first().copied());
        while 2 * at + 1 < count {
            let (left, right) = (2 * at + 1, 2 * at + 2);
            let better = if right < count && self.heap[right].0 <= self.heap[left].0 {
                right
            } else {
                left
            };
            self.heap[at] = self.heap[better];
            at = better;
        }
        if let Some(last) = last {
            self.heap[at] = last;
            self.rise(at);
        }
        Some(first)
    }

    fn rise(&mut self, mut at: usize) {
        let entry = self.heap[at];
        while at > 0 && self.heap[(at - 1) / 2].0 > entry.0 {
            self.heap[at] = self.heap[(at - 1) / 2];
            at = (at - 1) / 2;
        }
        self.heap[at] = entry;
    }
}
