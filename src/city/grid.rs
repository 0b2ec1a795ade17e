//! Cells and directions.

use std::cmp::Ordering;

/// A cell of the map, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell {
    /// Row; grows downwards.
    pub row: i32,
    /// Column; grows to the right.
    pub col: i32,
}

impl Cell {
    /// Creates a cell.
    pub const fn new(row: i32, col: i32) -> Self {
        Cell { row, col }
    }

    /// Returns the cell `cells` further in the direction of `heading`; saturates at the ends of the coordinates.
    pub fn ahead(self, heading: Heading, cells: i32) -> Cell {
        let (dr, dc) = heading.delta();
        let add = |at: i32, step: i32| at.saturating_add(step.saturating_mul(cells));
        Cell::new(add(self.row, dr), add(self.col, dc))
    }

    /// Returns the offset from another cell: (rows, columns), each of at most 33 bits.
    pub fn offset_from(self, other: Cell) -> (i64, i64) {
        let difference = |a: i32, b: i32| i64::from(a) - i64::from(b);
        (difference(self.row, other.row), difference(self.col, other.col))
    }

    /// Returns the Euclidean distance in cells, the square root of an integer that is exact on any map.
    #[allow(clippy::cast_precision_loss)]
    pub fn distance(self, other: Cell) -> f64 {
        let (dr, dc) = self.offset_from(other);
        let (dr, dc) = (dr as f64, dc as f64);
        (dr * dr + dc * dc).sqrt()
    }
}

/// A direction on the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Heading {
    /// Toward column 0.
    Left,
    /// Toward the last column.
    Right,
    /// Toward row 0.
    Up,
    /// Toward the last row.
    Down,
}

impl Heading {
    /// All four headings.
    pub const ALL: [Heading; 4] = [Heading::Left, Heading::Right, Heading::Up, Heading::Down];

    /// Returns the opposite direction.
    pub const fn opposite(self) -> Heading {
        match self {
            Heading::Left => Heading::Right,
            Heading::Right => Heading::Left,
            Heading::Up => Heading::Down,
            Heading::Down => Heading::Up,
        }
    }

    /// Returns the direction to the right.
    pub const fn clockwise(self) -> Heading {
        match self {
            Heading::Left => Heading::Up,
            Heading::Up => Heading::Right,
            Heading::Right => Heading::Down,
            Heading::Down => Heading::Left,
        }
    }

    /// Returns the step of one cell: (rows, columns).
    pub const fn delta(self) -> (i32, i32) {
        match self {
            Heading::Left => (0, -1),
            Heading::Right => (0, 1),
            Heading::Up => (-1, 0),
            Heading::Down => (1, 0),
        }
    }

    /// Returns its name in scenes and traces.
    pub const fn name(self) -> &'static str {
        match self {
            Heading::Left => "Left",
            Heading::Right => "Right",
            Heading::Up => "Up",
            Heading::Down => "Down",
        }
    }

    /// Returns the heading with this name.
    pub fn from_name(name: &str) -> Option<Heading> {
        Heading::ALL.into_iter().find(|heading| heading.name() == name)
    }

    /// Returns the direction from one cell to another in the same row or column. `None` if they are equal or not in
    /// line.
    pub fn between(from: Cell, to: Cell) -> Option<Heading> {
        match (to.row.cmp(&from.row), to.col.cmp(&from.col)) {
            (Ordering::Equal, Ordering::Less) => Some(Heading::Left),
            (Ordering::Equal, Ordering::Greater) => Some(Heading::Right),
            (Ordering::Less, Ordering::Equal) => Some(Heading::Up),
            (Ordering::Greater, Ordering::Equal) => Some(Heading::Down),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_farthest_cells_have_distances_and_directions() {
        let (first, last) = (Cell::new(i32::MIN, 0), Cell::new(i32::MAX, 0));
        assert_eq!(last.distance(first), f64::from(u32::MAX));
        assert_eq!(Heading::between(first, last), Some(Heading::Down));
        assert_eq!(last.ahead(Heading::Down, i32::MAX), last);
        assert_eq!(first.ahead(Heading::Up, i32::MAX), first);
        assert_eq!(Cell::new(3, 0).distance(Cell::new(0, 4)), 5.0);
    }
}
