//! Ways on foot: found without a search, and the published ones.
//!
//! The sidewalks along the streets of a row of blocks form two *bands*, one above and one below the blocks, that run across
//! the whole map, since crossings join them over every street on their way. It is the same with columns of blocks. All other
//! cells that one can walk on are between the buildings of a block, in the two inner sidewalks that cross in its middle. So a
//! way leaves the buildings by one of the four ends of the inner sidewalks, and changes from band to band where these cross:
//! there are few candidates, and the shortest of them is a shortest way.

use crate::city::map::Zone;
use crate::city::roads::NoRoute;
use crate::city::route::{Way, steps};
use crate::city::{Cell, CityMap, Heading, Layout};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use std::collections::HashMap;

impl Purpose {
    /// Which of the shortest ways pedestrians take; index: the start, tick: the goal.
    pub const WALK: Purpose = Purpose::new(16);
}

/// The corners of a way, in order; the end is not told.
#[derive(Clone, Copy)]
struct Corners {
    steps: u32,
    corners: [Cell; 2],
}

/// Goes from where the way is, on foot, to a goal. One must be able to walk on both.
pub(super) fn walk(layout: &Layout, goal: Cell, way: &mut Way<'_>) {
    let start = way.at();
    let (from, to) = (Spot::new(layout, start), Spot::new(layout, goal));
    if let (Some(block), Some(other)) = (from.block, to.block)
        && block == other
    {
        // Along the inner sidewalk to where the other crosses it.
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

/// A shortest way as few straight legs.
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

    /// Goes on to a cell in the same row or column.
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

    /// Walks along, but not in straight lines. At a corner, steps in the new direction are due and steps in the old one no longer: as many as
    /// the sidewalks beside it are wide are done early, on the leg before the corner, and late, on the leg behind it, a step here and a step
    /// there. The length stays the same.
    ///
    /// Going straight, all would cross streets on the very line where an intersection begins: at it, but never in it. Like this they are at
    /// and in intersections as often as those who go the published way. Where steps aside are taken is drawn for each start and goal.
    fn stroll(&self, layout: &Layout, way: &mut Way<'_>) {
        let points = &self.points[..self.count];
        let number = |cell: Cell| u64::from(cell.row.cast_unsigned()) << 32 | u64::from(cell.col.cast_unsigned());
        let mut stream = Seed(0).stream(Purpose::WALK, number(points[0]), number(points[self.count - 1]));
        // How much of the next leg is done early, and what of the last one is left, in its direction.
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

/// Of a leg of a [`Line`].
fn heading_of(from: Cell, to: Cell) -> Heading {
    Heading::between(from, to).expect("two points of a line that follow each other differ in one coordinate")
}

/// The most steps aside for one side of a corner.
const ASIDE_MAX: u32 = 8;

/// Steps aside that a leg has, in order.
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

    /// Goes so many steps ahead, with the steps aside anywhere between.
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

/// How many steps aside one can take anywhere on a straight leg. It is along a sidewalk, or there are none.
fn room(layout: &Layout, from: Cell, to: Cell, aside: Heading) -> u32 {
    let at = if from.row == to.row { from.row } else { from.col };
    let (zone, street) = layout.zone(at);
    if zone.in_street() || zone.in_block() {
        return 0;
    }
    // The cells between the street and the buildings.
    let (low, high) = if zone.after_mid_line() {
        (layout.street_span(street).end, layout.built_span(street).start - 1)
    } else {
        (layout.built_span(street - 1).end, layout.street_span(street).start - 1)
    };
    let (row, col) = aside.delta();
    let room = if row + col > 0 { high - at } else { at - low };
    room.cast_unsigned().min(ASIDE_MAX)
}

/// A cell that one can walk on.
struct Spot {
    cell: Cell,
    /// Whether its row is one of the inner sidewalk of its block.
    row_is_inner: bool,
    /// The block between whose buildings it is, if it is in no band.
    block: Option<[i32; 2]>,
}

impl Spot {
    fn new(layout: &Layout, cell: Cell) -> Self {
        let (row, col) = (layout.zone(cell.row), layout.zone(cell.col));
        let inside = row.0.in_block() && col.0.in_block();
        Spot {
            cell,
            row_is_inner: row.0 == Zone::Inner,
            block: inside.then_some([row.1, col.1]),
        }
    }

    /// How many ways there are to the bands.
    fn ways(&self) -> usize {
        if self.block.is_some() { 4 } else { 1 }
    }

    /// The ways to the bands; all are the same if there is only one.
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
    /// Its end: the first cell that is in a band.
    cell: Cell,
    steps: u32,
    /// The bands that this is in, of rows and of columns.
    bands: [Option<Band>; 2],
}

/// A sidewalk along a street.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Band {
    street: i32,
    /// On which side of the street it is.
    after: bool,
}

impl Exit {
    fn new(layout: &Layout, from: Cell, corner: Cell, cell: Cell) -> Self {
        let band = |at: i32| {
            let (zone, street) = layout.zone(at);
            let after = zone.after_mid_line();
            (!zone.in_street() && !zone.in_block()).then_some(Band { street, after })
        };
        Exit {
            corner,
            cell,
            steps: steps(from, corner) + steps(corner, cell),
            bands: [band(cell.row), band(cell.col)],
        }
    }
}

/// A shortest way between two cells of bands.
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
    // Two bands side by side: the way needs one that crosses them, or the inner sidewalk of a block that lies between.
    let same_blocks = |one: Option<Band>, other: Option<Band>| {
        one.zip(other).is_some_and(|(one, other)| {
            let (first, second) = if one.after { (one, other) } else { (other, one) };
            first.after && !second.after && first.street + 1 == second.street
        })
    };
    let corners = if from_row.is_some() {
        // Going up one keeps right in the higher columns.
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

/// Where to cross on the way from one coordinate to another, of which the first is in no band: at one between them if there is one,
/// else where the detour is least. Inner sidewalks count if `through_blocks`. Of a band's equal cells the highest or lowest is taken, so
/// that those who walk the other way are not in the way.
fn passage(layout: &Layout, [from, to]: [i32; 2], keep_high: bool, through_blocks: bool) -> i32 {
    let (zone, number) = layout.zone(from);
    let gap = if zone.in_street() {
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
    if through_blocks && !zone.in_street() && !layout.inner_span(number).is_empty() {
        let inner = nearest_inner(layout, number, from);
        if detour(inner) < detour(best) {
            best = inner;
        }
    }
    best
}

/// The coordinate in the inner sidewalk of a block that is nearest to another one.
fn nearest_inner(layout: &Layout, block: i32, at: i32) -> i32 {
    let inner = layout.inner_span(block);
    at.clamp(inner.start, inner.end - 1)
}

/// What the published program thinks a step onto a cell costs that one cannot walk on.
const WALL: u32 = 1000;

/// The most cells that a search looks at. They take some 70 MB.
const CELLS_MAX: usize = 1 << 20;

/// The way of the published program: the one of the shortest that A* finds, whose heuristic is the number of steps if nothing were in the way.
///
/// Among ways of equal length the order of the open list decides: it is a binary heap, and a cell's neighbours come to it upper, left, right,
/// lower. Cells that one cannot walk on take part in that order, though nothing goes through them.
pub(super) fn search(map: &CityMap, goal: Cell, way: &mut Way<'_>) -> Result<(), NoRoute> {
    const NEIGHBOURS: [Heading; 4] = [Heading::Up, Heading::Left, Heading::Right, Heading::Down];
    let start = way.at();
    // The steps to a cell, and the one before it.
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
        for heading in NEIGHBOURS {
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

/// The open list of A*: a binary heap of cells, the least estimate first. Of equal estimates the one comes first that the heaps of C++ and
/// Python would give, whose way of closing the gap at the top differs from that of Rust: down to a leaf first, and then the last one rises
/// from there.
#[derive(Default)]
struct OpenList {
    /// Estimates of whole ways, each with the cell that the way goes through.
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
