//! Ways on foot, found without a search.
//!
//! The sidewalks along the streets of a row of blocks form two *bands*, one above and one below the blocks, that run across
//! the whole map, since crossings join them over every street on their way. It is the same with columns of blocks. All other
//! cells that one can walk on are between the buildings of a block, in the two inner sidewalks that cross in its middle. So a
//! way leaves the buildings by one of the four ends of the inner sidewalks, and changes from band to band where these cross:
//! there are few candidates, and the shortest of them is a shortest way.

use super::map::Zone;
use super::route::{Way, steps};
use super::{Cell, Layout};

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
    for corner in best.iter().flat_map(|(_, corners)| corners) {
        way.straight(*corner);
    }
    way.straight(goal);
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
