//! Routes: ways over the map, held as straight pieces.

use super::{Cell, CityMap, Heading};
use crate::config::AgentKind;

/// A way from a start to a goal.
///
/// It is cut into straight pieces where a move must end: at corners and at nodes of the road graph. So who goes along one needs
/// to know the heading and the length of the piece it is on, and nothing else until that ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    start: Cell,
    goal: Cell,
    pieces: Box<[Piece]>,
    /// Steps from the start to the goal.
    steps: u32,
    starts_at_node: bool,
}

/// A straight piece: at least one step in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece(u32);

impl Piece {
    fn new(heading: Heading, steps: u32, ends_at_node: bool) -> Self {
        Piece(steps << 3 | u32::from(ends_at_node) << 2 | heading as u32)
    }

    pub(super) fn heading(self) -> Heading {
        Heading::ALL[(self.0 & 3) as usize]
    }

    /// Its length in cells.
    pub(super) fn steps(self) -> u32 {
        self.0 >> 3
    }

    fn ends_at_node(self) -> bool {
        self.0 & 4 != 0
    }
}

impl Route {
    /// The first cell.
    pub fn start(&self) -> Cell {
        self.start
    }

    /// The last cell.
    pub fn goal(&self) -> Cell {
        self.goal
    }

    /// Number of steps from the start to the goal, in cells.
    pub fn steps(&self) -> usize {
        self.steps as usize
    }

    /// The cells from the start to the goal, both included. Neighbours differ by one step.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + Clone + '_ {
        let mut at = self.start;
        let steps = (self.pieces.iter()).flat_map(|piece| (0..piece.steps()).map(move |_| piece.heading()));
        std::iter::once(self.start).chain(steps.map(move |heading| {
            at = at.ahead(heading, 1);
            at
        }))
    }

    /// The nodes of the road graph that it passes, in order; a car jumps over none of them. None for the routes of pedestrians.
    pub fn nodes(&self) -> impl Iterator<Item = Cell> + '_ {
        let mut at = self.start;
        let ends = self.pieces.iter().filter_map(move |piece| {
            at = at.ahead(piece.heading(), piece.steps().cast_signed());
            piece.ends_at_node().then_some(at)
        });
        self.starts_at_node.then_some(self.start).into_iter().chain(ends)
    }

    /// A piece by its place on the way, from 0.
    pub(super) fn piece(&self, index: u32) -> Option<Piece> {
        self.pieces.get(index as usize).copied()
    }

    /// Bytes it takes beside its own size.
    pub fn heap_bytes(&self) -> usize {
        std::mem::size_of_val(&*self.pieces)
    }
}

/// A route under construction.
pub(super) struct Way<'m> {
    map: &'m CityMap,
    kind: AgentKind,
    start: Cell,
    at: Cell,
    pieces: Vec<Piece>,
    steps: u32,
}

impl<'m> Way<'m> {
    /// A way of a single cell.
    pub(super) fn new(map: &'m CityMap, kind: AgentKind, start: Cell) -> Self {
        Way {
            map,
            kind,
            start,
            at: start,
            pieces: Vec::with_capacity(32),
            steps: 0,
        }
    }

    /// The last cell so far.
    pub(super) fn at(&self) -> Cell {
        self.at
    }

    fn is_node(&self, cell: Cell) -> bool {
        self.kind == AgentKind::Car && self.map.is_lane_node(cell)
    }

    /// Goes to a cell in the same row or column. There must be no node of the road graph strictly between.
    pub(super) fn straight(&mut self, to: Cell) {
        let Some(heading) = Heading::between(self.at, to) else {
            return;
        };
        let steps = steps(self.at, to);
        let is_node = self.is_node(to);
        match self.pieces.last_mut() {
            Some(last) if last.heading() == heading && !last.ends_at_node() => {
                *last = Piece::new(heading, last.steps() + steps, is_node);
            }
            _ => self.pieces.push(Piece::new(heading, steps, is_node)),
        }
        self.at = to;
        self.steps += steps;
    }

    /// Goes to a cell by at most one bend.
    pub(super) fn bend(&mut self, to: Cell, rows_first: bool) {
        let from = self.at;
        self.straight(if rows_first {
            Cell::new(to.row, from.col)
        } else {
            Cell::new(from.row, to.col)
        });
        self.straight(to);
    }

    pub(super) fn finish(self) -> Route {
        Route {
            starts_at_node: self.is_node(self.start),
            start: self.start,
            goal: self.at,
            steps: self.steps,
            pieces: self.pieces.into_boxed_slice(),
        }
    }
}

/// Steps between two cells if nothing is in the way.
pub(super) fn steps(from: Cell, to: Cell) -> u32 {
    from.row.abs_diff(to.row) + from.col.abs_diff(to.col)
}
