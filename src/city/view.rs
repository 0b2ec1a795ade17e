//! What an agent sees.

use super::{Cell, CityMap, Heading};

/// The rectangle of cells in a field of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    /// Its upper left cell.
    pub first: Cell,
    /// Its lower right cell, which belongs to it.
    pub last: Cell,
}

impl View {
    /// Whether the cell is in view.
    pub fn contains(&self, cell: Cell) -> bool {
        (self.first.row..=self.last.row).contains(&cell.row) && (self.first.col..=self.last.col).contains(&cell.col)
    }
}

/// The field of view of an agent. It reaches `half_width` cells to both sides of the way and ahead, and hardly behind: 1 cell
/// for an agent that goes left or up, 2 cells for one that goes right or down (the published program's rectangles, half open
/// after a shift by one). Without a heading it reaches `half_width` cells to all sides. It ends where the world ends.
pub fn field_of_view(at: Cell, heading: Option<Heading>, half_width: u32, map: &CityMap) -> View {
    let ahead = i32::try_from(half_width).unwrap_or(i32::MAX);
    let (mut up, mut down, mut left, mut right) = (ahead, ahead, ahead, ahead);
    match heading {
        None => {}
        Some(Heading::Left) => right = ahead.min(1),
        Some(Heading::Right) => left = ahead.min(2),
        Some(Heading::Up) => down = ahead.min(1),
        Some(Heading::Down) => up = ahead.min(2),
    }
    View {
        first: Cell::new(at.row.saturating_sub(up).max(0), at.col.saturating_sub(left).max(0)),
        last: Cell::new(
            at.row.saturating_add(down).min(map.rows() - 1),
            at.col.saturating_add(right).min(map.cols() - 1),
        ),
    }
}
