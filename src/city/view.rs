//! Fields of view.

use crate::city::{Cell, CityMap, Heading};

/// The rectangle of cells in a field of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldOfView {
    /// The upper left cell.
    pub first: Cell,
    /// The lower right cell, included.
    pub last: Cell,
}

impl FieldOfView {
    /// Returns the cells at most `up`, `down`, `left` and `right` cells away from `at`.
    pub fn around(at: Cell, [up, down, left, right]: [i32; 4]) -> FieldOfView {
        FieldOfView {
            first: Cell::new(at.row.saturating_sub(up), at.col.saturating_sub(left)),
            last: Cell::new(at.row.saturating_add(down), at.col.saturating_add(right)),
        }
    }

    /// Returns whether the cell is in view.
    pub fn contains(&self, cell: Cell) -> bool {
        (self.first.row..=self.last.row).contains(&cell.row) && (self.first.col..=self.last.col).contains(&cell.col)
    }
}

/// Returns the extent of a field of view [up, down, left, right] of an agent, in cells.
///
/// It extends `half_width` cells ahead and to both sides, and a little behind: 1 cell for an agent that goes left or
/// up, 2 cells for one that goes right or down. These are the published program's rectangles, half-open after a shift
/// by one. Without a heading it extends `half_width` cells to all sides.
pub fn view_reach(heading: Option<Heading>, half_width: u32) -> [i32; 4] {
    let ahead = i32::try_from(half_width).unwrap_or(i32::MAX);
    match heading {
        None => [ahead; 4],
        Some(Heading::Left) => [ahead, ahead, ahead, ahead.min(1)],
        Some(Heading::Right) => [ahead, ahead, ahead.min(2), ahead],
        Some(Heading::Up) => [ahead, ahead.min(1), ahead, ahead],
        Some(Heading::Down) => [ahead.min(2), ahead, ahead, ahead],
    }
}

/// Returns the field of view of an agent, clipped to the map.
///
/// It extends `half_width` cells ahead and to both sides, and 1 or 2 cells behind. Without a heading it extends
/// `half_width` cells to all sides.
pub fn field_of_view(at: Cell, heading: Option<Heading>, half_width: u32, map: &CityMap) -> FieldOfView {
    let FieldOfView { first, last } = FieldOfView::around(at, view_reach(heading, half_width));
    FieldOfView {
        first: Cell::new(first.row.max(0), first.col.max(0)),
        last: Cell::new(last.row.min(map.rows() - 1), last.col.min(map.cols() - 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::generate::tests::square;

    #[test]
    fn it_reaches_ahead_and_to_both_sides() {
        let map = square([5, 5]);
        let view = |at, heading| {
            let FieldOfView { first, last } = field_of_view(at, heading, 25, &map);
            [
                first.row - at.row,
                last.row - at.row,
                first.col - at.col,
                last.col - at.col,
            ]
        };
        let middle = Cell::new(100, 100);
        assert_eq!(view(middle, None), [-25, 25, -25, 25]);
        assert_eq!(view(middle, Some(Heading::Left)), [-25, 25, -25, 1]);
        assert_eq!(view(middle, Some(Heading::Right)), [-25, 25, -2, 25]);
        assert_eq!(view(middle, Some(Heading::Up)), [-25, 1, -25, 25]);
        assert_eq!(view(middle, Some(Heading::Down)), [-2, 25, -25, 25]);
        // The world ends at 0 and 240.
        assert_eq!(view(Cell::new(3, 238), None), [-3, 25, -25, 2]);
    }

    #[test]
    fn any_width_will_do() {
        let map = square([1, 1]);
        let at = Cell::new(30, 30);
        let alone = field_of_view(at, Some(Heading::Right), 0, &map);
        assert_eq!((alone.first, alone.last), (at, at));
        let whole = field_of_view(at, None, u32::MAX, &map);
        assert!(whole.contains(Cell::new(0, 0)) && whole.contains(Cell::new(56, 56)));
        assert!(!whole.contains(Cell::new(57, 0)));
    }
}
