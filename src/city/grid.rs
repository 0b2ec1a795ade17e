//! Cells and directions.

/// A cell of the map, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell {
    /// Row; grows downwards.
    pub row: i32,
    /// Column; grows to the right.
    pub col: i32,
}

impl Cell {
    /// A cell.
    pub const fn new(row: i32, col: i32) -> Self {
        Cell { row, col }
    }

    /// The cell `cells` further in the direction of `heading`.
    pub fn ahead(self, heading: Heading, cells: i32) -> Cell {
        let (dr, dc) = heading.delta();
        Cell::new(self.row + dr * cells, self.col + dc * cells)
    }

    /// Squared Euclidean distance in cells.
    pub fn distance_squared(self, other: Cell) -> i64 {
        let (dr, dc) = (i64::from(self.row - other.row), i64::from(self.col - other.col));
        dr * dr + dc * dc
    }
}

/// A direction on the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Heading {
    /// Towards column 0.
    Left,
    /// Towards the last column.
    Right,
    /// Towards row 0.
    Up,
    /// Towards the last row.
    Down,
}

impl Heading {
    /// All four.
    pub const ALL: [Heading; 4] = [Heading::Left, Heading::Right, Heading::Up, Heading::Down];

    /// The step of one cell, (rows, columns).
    pub const fn delta(self) -> (i32, i32) {
        match self {
            Heading::Left => (0, -1),
            Heading::Right => (0, 1),
            Heading::Up => (-1, 0),
            Heading::Down => (1, 0),
        }
    }

    /// Its name in scenes and traces.
    pub const fn name(self) -> &'static str {
        match self {
            Heading::Left => "Left",
            Heading::Right => "Right",
            Heading::Up => "Up",
            Heading::Down => "Down",
        }
    }

    /// The heading of that name.
    pub fn from_name(name: &str) -> Option<Heading> {
        Heading::ALL.into_iter().find(|heading| heading.name() == name)
    }

    /// The direction from one cell to another in the same row or column; `None` if they are equal or on no common line.
    pub fn between(from: Cell, to: Cell) -> Option<Heading> {
        match ((to.row - from.row).signum(), (to.col - from.col).signum()) {
            (0, -1) => Some(Heading::Left),
            (0, 1) => Some(Heading::Right),
            (-1, 0) => Some(Heading::Up),
            (1, 0) => Some(Heading::Down),
            _ => None,
        }
    }
}
