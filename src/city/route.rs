//! Routes, stored as straight pieces.

use crate::city::AgentKind;
use crate::city::{Cell, CityMap, Heading};

/// The cost of a turn or U-turn in addition to its length, in cells.
pub(super) const TURN_COST: u32 = 30;

/// The reason why there is no route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum NoRoute {
    /// Agents of this kind cannot start there: a pedestrian outside of walking streets and crossings, or a car that is
    /// not beside a lane (on the mid line, in an intersection, off the street).
    Start,
    /// Agents of this kind cannot arrive there, for the same reasons.
    Goal,
    /// Start and goal are not connected.
    Unconnected,
    /// The search for a pedestrian's route with [`Routing::Hops`](crate::city::Routing::Hops) would visit more than
    /// 2^20 cells.
    TooFar,
}

/// A route from a start to a goal.
///
/// It is split into straight pieces. A move ends at the end of a piece: at a corner or at a node of the road graph. So an
/// agent needs only the heading and the length of its current piece. On a road network, whose lanes run in any
/// direction, a move may pass corners within a lane, and an agent faces the direction in which the lane runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    start: Cell,
    goal: Cell,
    pieces: Box<[Piece]>,
    /// Steps from the start to the goal.
    steps: u32,
    starts_at_node: bool,
    /// Whether a move may go on behind some piece.
    has_passed_corners: bool,
}

/// A straight piece: at least one step in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece(u32);

impl Piece {
    fn new(heading: Heading, steps: u32, ends_at_node: bool) -> Self {
        Piece(steps << 6 | (heading as u32) << 4 | u32::from(ends_at_node) << 2 | heading as u32)
    }

    /// A piece on which agents face another direction than that of their steps.
    fn facing_to(self, facing: Heading) -> Piece {
        Piece(self.0 & !(3 << 4) | (facing as u32) << 4)
    }

    /// A piece that moves pass.
    fn passed(self) -> Piece {
        Piece(self.0 | 1 << 3)
    }

    pub(super) fn heading(self) -> Heading {
        Heading::ALL[(self.0 & 3) as usize]
    }

    /// The direction that agents face on it.
    pub(super) fn facing(self) -> Heading {
        Heading::ALL[(self.0 >> 4 & 3) as usize]
    }

    /// The number of steps.
    pub(super) fn steps(self) -> u32 {
        self.0 >> 6
    }

    pub(super) fn ends_at_node(self) -> bool {
        self.0 & 4 != 0
    }

    /// Whether a move may go on to the next piece.
    pub(super) fn is_passed(self) -> bool {
        self.0 & 8 != 0
    }
}

/// The steps before and behind a step that determine the direction of a path there.
const AROUND_STEP: usize = 4;

/// Returns the direction in which a path of cells runs at each of its cells: the one that most steps around it have;
/// among equally many, that of the cell before.
pub(super) fn facings(cells: &[Cell]) -> Vec<Heading> {
    let steps: Vec<Heading> = (cells.windows(2))
        .filter_map(|pair| Heading::between(pair[0], pair[1]))
        .collect();
    let mut facing = steps.first().copied();
    let mut facings: Vec<Heading> = Vec::with_capacity(cells.len());
    // The number of steps around in each direction.
    let mut counts = [0; 4];
    for step in steps.iter().take(AROUND_STEP) {
        counts[*step as usize] += 1;
    }
    for (at, step) in steps.iter().enumerate() {
        if let Some(entering) = steps.get(at + AROUND_STEP) {
            counts[*entering as usize] += 1;
        }
        if let Some(leaving) = at.checked_sub(AROUND_STEP + 1) {
            counts[steps[leaving] as usize] -= 1;
        }
        let count = |heading: Heading| counts[heading as usize];
        let before = facing.unwrap_or(*step);
        let best = Heading::ALL
            .into_iter()
            .max_by_key(|&heading| (count(heading), heading == before, heading == *step));
        facing = best;
        facings.push(best.unwrap_or(*step));
    }
    // A path of one cell runs nowhere.
    facings.extend(facing.or((cells.len() == 1).then_some(Heading::Left)));
    facings
}

impl Route {
    /// Returns the first cell.
    pub fn start(&self) -> Cell {
        self.start
    }

    /// Returns the last cell.
    pub fn goal(&self) -> Cell {
        self.goal
    }

    /// Returns the number of steps from the start to the goal, in cells.
    pub fn steps(&self) -> usize {
        self.steps as usize
    }

    /// Returns the cells from the start to the goal, both included. Consecutive cells differ by one step.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + Clone + '_ {
        let mut at = self.start;
        let steps = (self.pieces.iter()).flat_map(|piece| (0..piece.steps()).map(move |_| piece.heading()));
        std::iter::once(self.start).chain(steps.map(move |heading| {
            at = at.ahead(heading, 1);
            at
        }))
    }

    /// Returns the first and the last cell, and the cells between them where the route turns, each as row and column.
    pub fn corners(&self) -> Vec<[i32; 2]> {
        corners(self.cells())
    }

    /// Returns the nodes of the road graph on the route, in order; no move of a car jumps over one. The routes of
    /// pedestrians have none.
    pub fn nodes(&self) -> impl Iterator<Item = Cell> + '_ {
        let mut at = self.start;
        let ends = self.pieces.iter().filter_map(move |piece| {
            at = at.ahead(piece.heading(), piece.steps().cast_signed());
            piece.ends_at_node().then_some(at)
        });
        self.starts_at_node.then_some(self.start).into_iter().chain(ends)
    }

    /// Whether a move may go on behind some piece.
    #[inline]
    pub(super) fn has_passed_corners(&self) -> bool {
        self.has_passed_corners
    }

    /// The piece with this index.
    pub(super) fn piece(&self, index: u32) -> Option<Piece> {
        self.pieces.get(index as usize).copied()
    }

    /// Returns the bytes that it allocates on the heap.
    pub fn heap_bytes(&self) -> usize {
        std::mem::size_of_val(&*self.pieces)
    }
}

impl Route {
    /// Splits the pieces where the direction of the path changes, and lets moves pass the corners within a lane. A move
    /// never passes a node, and never comes back toward where it began, so that it is as long as the distance between
    /// its ends.
    fn smooth(&mut self) {
        let cells: Vec<Cell> = self.cells().collect();
        let facings = facings(&cells);
        let mut pieces: Vec<Piece> = Vec::with_capacity(self.pieces.len());
        let mut at = 0;
        for piece in &self.pieces {
            let end = at + piece.steps() as usize;
            while at < end {
                let same = facings[at..end]
                    .iter()
                    .take_while(|&&facing| facing == facings[at])
                    .count();
                let is_last = at + same == end;
                let steps = u32::try_from(same).expect("a piece has 26 bits of steps");
                let part = Piece::new(piece.heading(), steps, is_last && piece.ends_at_node());
                pieces.push(part.facing_to(facings[at]));
                at += same;
            }
        }
        for at in 1..pieces.len() {
            let (last, next) = (pieces[at - 1], pieces[at]);
            let mut before = pieces[..at].iter().rev();
            let mut steps = 0;
            let turns_back = loop {
                match before.next() {
                    Some(piece) if steps < MOVE_MAX => {
                        if piece.heading() == next.heading().opposite() {
                            break true;
                        }
                        steps += piece.steps();
                    }
                    _ => break false,
                }
            };
            if !last.ends_at_node() && !turns_back {
                pieces[at - 1] = last.passed();
            }
        }
        self.has_passed_corners = pieces.iter().any(|piece| piece.is_passed());
        self.pieces = pieces.into();
    }
}

/// The steps of a move within which a route must not turn back, if the move is to pass the corner.
const MOVE_MAX: u32 = 3;

/// Returns the first and last of these cells of a route, and the cells between them where it turns.
pub fn corners(cells: impl Iterator<Item = Cell>) -> Vec<[i32; 2]> {
    let mut corners: Vec<[i32; 2]> = Vec::new();
    for cell in cells {
        let now = [cell.row, cell.col];
        if let [.., a, b] = corners[..]
            && (a[0] == b[0] && b[0] == now[0] || a[1] == b[1] && b[1] == now[1])
        {
            corners.pop();
        }
        corners.push(now);
    }
    corners
}

/// A route under construction.
pub(super) struct Way<'m> {
    map: &'m CityMap,
    kind: AgentKind,
    start: Cell,
    at: Cell,
    pieces: Pieces,
    steps: u32,
}

/// The pieces so far. Most routes have few pieces, which stay on the stack, so that each route allocates once and
/// exactly.
struct Pieces {
    few: [Piece; Pieces::FEW],
    count: usize,
    /// All pieces, if there are more than [`Pieces::FEW`].
    many: Vec<Piece>,
}

impl Pieces {
    const FEW: usize = 32;

    fn as_slice(&self) -> &[Piece] {
        match self.count {
            0..=Self::FEW => &self.few[..self.count],
            _ => &self.many,
        }
    }

    fn last_mut(&mut self) -> Option<&mut Piece> {
        match self.count {
            0..=Self::FEW => self.few[..self.count].last_mut(),
            _ => self.many.last_mut(),
        }
    }

    fn push(&mut self, piece: Piece) {
        match self.count {
            0..Self::FEW => self.few[self.count] = piece,
            _ => {
                if self.count == Self::FEW {
                    self.many = self.few.to_vec();
                }
                self.many.push(piece);
            }
        }
        self.count += 1;
    }
}

impl<'m> Way<'m> {
    /// Creates a route of a single cell.
    pub(super) fn new(map: &'m CityMap, kind: AgentKind, start: Cell) -> Self {
        Way {
            map,
            kind,
            start,
            at: start,
            pieces: Pieces {
                few: [Piece(0); Pieces::FEW],
                count: 0,
                many: Vec::new(),
            },
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

    /// Continues to a cell in the same row or column. There must be no node of the road graph strictly between.
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

    /// Continues to a cell with at most one bend.
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
        let mut route = Route {
            starts_at_node: self.is_node(self.start),
            start: self.start,
            goal: self.at,
            steps: self.steps,
            pieces: self.pieces.as_slice().into(),
            has_passed_corners: false,
        };
        if self.map.network().is_some() {
            route.smooth();
        }
        route
    }
}

/// The number of steps between two cells without obstacles.
pub(super) fn steps(from: Cell, to: Cell) -> u32 {
    from.row.abs_diff(to.row) + from.col.abs_diff(to.col)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::generate::tests::square;

    /// The direction of most steps in the window around each cell, as the definition says.
    #[test]
    fn paths_run_where_most_steps_around_go() {
        let mut random = crate::rng::Seed(5).stream(crate::rng::Purpose::TEST, 0, 0);
        for length in 1..200_usize {
            let mut cells = vec![Cell::new(0, 0)];
            let mut heading = Heading::Right;
            for _ in 1..length {
                if crate::rng::RngExt::random_range(&mut random, 0..3) == 0 {
                    heading = Heading::ALL[crate::rng::RngExt::random_range(&mut random, 0..4)];
                }
                cells.push(cells[cells.len() - 1].ahead(heading, 1));
            }
            let found = facings(&cells);
            assert_eq!(found.len(), cells.len());
            for at in 0..length - 1 {
                let [first, last] = [at.saturating_sub(AROUND_STEP), (at + AROUND_STEP).min(length - 2)];
                let count = |heading: Heading| {
                    let steps = (first..=last).filter_map(|step| Heading::between(cells[step], cells[step + 1]));
                    steps.filter(|step| *step == heading).count()
                };
                let most = Heading::ALL.map(count).into_iter().max().unwrap();
                assert_eq!(count(found[at]), most);
                if at > 0 && count(found[at - 1]) == most {
                    assert_eq!(found[at], found[at - 1]);
                }
            }
        }
    }

    #[test]
    fn ways_of_few_and_of_many_pieces_are_kept() {
        let map = square([2, 2]);
        for corners in [0, 1, 31, 32, 33, 34, 70] {
            let cells: Vec<Cell> = (0..=corners).map(|at| Cell::new(at / 2, (at + 1) / 2)).collect();
            let mut way = Way::new(&map, AgentKind::Pedestrian, cells[0]);
            cells.iter().for_each(|&cell| way.straight(cell));
            let route = way.finish();
            assert_eq!(route.cells().collect::<Vec<_>>(), cells);
            assert_eq!(route.pieces.len(), corners as usize);
        }
    }
}
