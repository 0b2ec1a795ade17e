//! Roads and routes.
//!
//! A [`Router`] is built once for a map and shared. Pedestrians walk a shortest way over walking streets and crossings. Cars
//! drive on the road graph: each side of each street between two intersections is a lane with a start node and an end node, and
//! at every intersection each lane that ends there is connected to each lane that starts there, be it straight on, by a turn or
//! by a U-turn. A car gets from its start to the end node of the lane on its own side, and reaches its goal from the start node
//! of the goal's lane. So a goal a little ahead in the same lane takes a trip around, as in the published program.

use super::route::{Way, steps};
use super::{Cell, CityMap, Heading, Layout, Route};
use crate::config::{AgentKind, Routing};
use pathfinding::directed::astar::astar;
use pathfinding::directed::bfs::bfs_bidirectional;
use pathfinding::directed::dijkstra::dijkstra;
use std::sync::Arc;

/// What a turn or U-turn costs over its length, in cells.
const TURN_COST: u32 = 30;

/// Why there is no route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRoute {
    /// Agents of this kind cannot start there: a pedestrian outside of walking streets and crossings, a car that is not beside a
    /// lane (on the mid line, in an intersection, off the street).
    Start,
    /// They cannot arrive there, for the same reasons.
    Goal,
    /// Start and goal are not connected.
    Unconnected,
}

/// A side of a street between two intersections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lane {
    /// Where cars enter it: on the outline of the intersection behind.
    pub start: Cell,
    /// Where cars leave it: on the outline of the intersection ahead.
    pub end: Cell,
    /// The direction of travel.
    pub heading: Heading,
}

impl Lane {
    /// Its length in cells: steps from start to end.
    pub fn length(&self) -> u32 {
        steps(self.start, self.end)
    }
}

/// A node of the road graph: the start or the end of a lane, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Node {
    /// Where the car is.
    Origin,
    Start(u32),
    End(u32),
    /// Where the car wants to go.
    Destination,
}

/// Plans routes on one map.
#[derive(Clone, Debug)]
pub struct Router {
    map: Arc<CityMap>,
    routing: Routing,
    lanes: Vec<Lane>,
    /// For each lane, the lanes that start where it ends.
    next: Vec<Vec<u32>>,
    /// For each lane, the lanes that end where it starts.
    previous: Vec<Vec<u32>>,
}

impl Router {
    /// Builds the road graph of a map.
    pub fn new(map: Arc<CityMap>, routing: Routing) -> Self {
        let layout = map.layout;
        let lanes = lay_lanes(&layout);
        // The order of the lanes, horizontal ones first, is the order in which searches meet them. It decides among ways of equal
        // length, and with fewest hops it does so as the published program.
        let corners = (layout.blocks()[0] + 1) as usize * (layout.blocks()[1] + 1) as usize;
        let corner = |node: Cell| {
            let street = |at: i32| (at + layout.sidewalk()).div_euclid(layout.period());
            (street(node.row) * (layout.blocks()[1] + 1) + street(node.col)) as usize
        };
        let (mut starting, mut ending) = (vec![Vec::new(); corners], vec![Vec::new(); corners]);
        for (number, lane) in (0..).zip(&lanes) {
            starting[corner(lane.start)].push(number);
            ending[corner(lane.end)].push(number);
        }
        Router {
            next: lanes.iter().map(|lane| starting[corner(lane.end)].clone()).collect(),
            previous: lanes.iter().map(|lane| ending[corner(lane.start)].clone()).collect(),
            map,
            routing,
            lanes,
        }
    }

    /// The map.
    pub fn map(&self) -> &Arc<CityMap> {
        &self.map
    }

    /// How cars choose their route.
    pub fn routing(&self) -> Routing {
        self.routing
    }

    /// The lanes.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// The connections between lanes: a pair of lane numbers for each end node and start node that are connected.
    pub fn connectors(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        (self.next.iter().enumerate()).flat_map(|(from, next)| next.iter().map(move |&to| (from, to as usize)))
    }

    /// Plans a route. The same question always gets the same answer. If an agent is already at its goal, the route is that cell.
    ///
    /// A car starts and arrives anywhere beside a lane: on a street between two intersections, their outlines included, on
    /// either side of the mid line.
    ///
    /// # Errors
    /// If the agent can't be at the start or at the goal, or cannot get from one to the other.
    pub fn plan(&self, kind: AgentKind, start: Cell, goal: Cell) -> Result<Route, NoRoute> {
        match kind {
            AgentKind::Car => self.drive(start, goal),
            AgentKind::Pedestrian => self.walk(start, goal),
        }
    }

    /// A given way as a route; repeated cells are left out. `None` if it is empty, leaves the map, or has neighbours that differ by
    /// more than a step.
    pub fn follow(&self, kind: AgentKind, cells: impl IntoIterator<Item = Cell>) -> Option<Route> {
        let mut cells = cells.into_iter();
        let start = cells.next().filter(|&cell| self.map.contains(cell))?;
        let mut way = Way::new(&self.map, kind, start);
        for cell in cells {
            if !self.map.contains(cell) || steps(way.at(), cell) > 1 {
                return None;
            }
            way.straight(cell);
        }
        Some(way.finish())
    }

    /// A shortest way on foot.
    fn walk(&self, start: Cell, goal: Cell) -> Result<Route, NoRoute> {
        if !self.map.is_walkable(start) {
            return Err(NoRoute::Start);
        }
        if !self.map.is_walkable(goal) {
            return Err(NoRoute::Goal);
        }
        let neighbours = |&cell: &Cell| {
            let around = Heading::ALL.map(|heading| cell.ahead(heading, 1));
            (around.into_iter().filter(|&cell| self.map.is_walkable(cell))).map(|cell| (cell, 1))
        };
        // Each step changes one coordinate by one, so the sum of differences never overestimates.
        let (cells, _) =
            astar(&start, neighbours, |&cell| steps(cell, goal), |&cell| cell == goal).ok_or(NoRoute::Unconnected)?;
        self.follow(AgentKind::Pedestrian, cells).ok_or(NoRoute::Unconnected)
    }

    /// A way by car.
    fn drive(&self, start: Cell, goal: Cell) -> Result<Route, NoRoute> {
        let first = self.lane_beside(start).ok_or(NoRoute::Start)?;
        let last = self.lane_beside(goal).ok_or(NoRoute::Goal)?;
        let mut way = Way::new(&self.map, AgentKind::Car, start);
        if start == goal {
            return Ok(way.finish());
        }
        let nodes = match self.routing {
            Routing::Weighted => self.lightest(first, last),
            Routing::Hops => self.fewest_hops(first, last),
        };
        let nodes = nodes.ok_or(NoRoute::Unconnected)?;
        for node in nodes {
            match node {
                Node::Origin => {}
                Node::End(lane) if way.at() == start => {
                    let end = self.lanes[lane as usize].end;
                    way.bend(end, rows_first_out(start, end));
                }
                Node::End(lane) => way.bend(self.lanes[lane as usize].end, true),
                Node::Start(lane) => {
                    // Straight on to the line of the new lane, then along it.
                    let lane = self.lanes[lane as usize];
                    way.bend(lane.start, matches!(lane.heading, Heading::Left | Heading::Right));
                }
                Node::Destination => way.bend(goal, !rows_first_out(goal, way.at())),
            }
        }
        Ok(way.finish())
    }

    /// The nodes of a route of least length and turns.
    fn lightest(&self, first: u32, last: u32) -> Option<Vec<Node>> {
        let successors = |&node: &Node| {
            (self.after(node, first, last).into_iter())
                .map(move |next| (next, self.weight(node, next)))
                .collect::<Vec<_>>()
        };
        dijkstra(&Node::Origin, successors, |&node| node == Node::Destination).map(|(nodes, _)| nodes)
    }

    /// The nodes of a route with the fewest of them. Searching from both ends, the smaller frontier first, is what makes the
    /// choice among equals that of the published program.
    fn fewest_hops(&self, first: u32, last: u32) -> Option<Vec<Node>> {
        let after = |&node: &Node| self.after(node, first, last);
        let before = |&node: &Node| self.before(node, first, last);
        bfs_bidirectional(&Node::Origin, &Node::Destination, after, before)
    }

    /// Where one can go from a node, on the way from one lane to another.
    fn after(&self, node: Node, first: u32, last: u32) -> Vec<Node> {
        match node {
            Node::Origin => vec![Node::End(first)],
            Node::Start(lane) if lane == last => vec![Node::End(lane), Node::Destination],
            Node::Start(lane) => vec![Node::End(lane)],
            Node::End(lane) => self.next[lane as usize].iter().map(|&lane| Node::Start(lane)).collect(),
            Node::Destination => Vec::new(),
        }
    }

    /// The converse of [`Router::after`].
    fn before(&self, node: Node, first: u32, last: u32) -> Vec<Node> {
        match node {
            Node::Origin => Vec::new(),
            Node::Start(lane) => self.previous[lane as usize]
                .iter()
                .map(|&lane| Node::End(lane))
                .collect(),
            Node::End(lane) if lane == first => vec![Node::Start(lane), Node::Origin],
            Node::End(lane) => vec![Node::Start(lane)],
            Node::Destination => vec![Node::Start(last)],
        }
    }

    /// The weight of an edge in cells. The first and the last edge are the same for all routes between two places.
    fn weight(&self, from: Node, to: Node) -> u32 {
        match (from, to) {
            (Node::Start(lane), Node::End(_)) => self.lanes[lane as usize].length(),
            (Node::End(from), Node::Start(to)) => {
                let (from, to) = (self.lanes[from as usize], self.lanes[to as usize]);
                steps(from.end, to.start) + if from.heading == to.heading { 0 } else { TURN_COST }
            }
            _ => 0,
        }
    }

    /// The lane on the side of the street where the cell is.
    fn lane_beside(&self, cell: Cell) -> Option<u32> {
        if !self.map.contains(cell) {
            return None;
        }
        let layout = &self.map.layout;
        let [block_rows, block_cols] = layout.blocks();
        // The place of the street's first lane in the list of lanes, see `lay_lanes`.
        let (first, block, side) = match (layout.place(cell.row), layout.place(cell.col)) {
            (Place::Street { number, side }, Place::Lane { block }) => (2 * number * block_cols, block, side),
            (Place::Lane { block }, Place::Street { number, side }) => {
                let horizontal = 2 * (block_rows + 1) * block_cols;
                (horizontal + 2 * number * block_rows, block, side)
            }
            _ => return None,
        };
        let number = match side {
            -1 => first + 2 * block,
            1 => first + 2 * block + 1,
            _ => return None,
        };
        u32::try_from(number).ok()
    }
}

/// Whether a car that leaves for a node goes along the column first: the shorter leg comes first, and equal ones start with it. A
/// car that arrives does the same backwards.
fn rows_first_out(place: Cell, node: Cell) -> bool {
    (node.row - place.row).abs() <= (node.col - place.col).abs()
}

/// All lanes: street by street, horizontal streets first, then block by block, the left-going or down-going lane first.
fn lay_lanes(layout: &Layout) -> Vec<Lane> {
    let [block_rows, block_cols] = layout.blocks();
    let mut lanes = Vec::new();
    for (streets, blocks, horizontal) in [(block_rows, block_cols, true), (block_cols, block_rows, false)] {
        for street in 0..=streets {
            let (middle, offset) = (layout.mid_line(street), layout.lane_offset());
            for block in 0..blocks {
                let (low, high) = layout.lane_ends(block);
                let cell = |across, along| {
                    if horizontal {
                        Cell::new(across, along)
                    } else {
                        Cell::new(along, across)
                    }
                };
                let (before, after) = (middle - offset, middle + offset);
                let down = Lane {
                    start: cell(before, if horizontal { high } else { low }),
                    end: cell(before, if horizontal { low } else { high }),
                    heading: if horizontal { Heading::Left } else { Heading::Down },
                };
                let up = Lane {
                    start: cell(after, if horizontal { low } else { high }),
                    end: cell(after, if horizontal { high } else { low }),
                    heading: if horizontal { Heading::Right } else { Heading::Up },
                };
                lanes.extend([down, up]);
            }
        }
    }
    lanes
}

/// What a coordinate is on its axis.
enum Place {
    /// In a street, before (-1), on (0) or after (1) its mid line.
    Street { number: i32, side: i32 },
    /// Along a block, where lanes run beside it.
    Lane { block: i32 },
    /// In the part of a block that intersections reach into.
    Corner,
}

impl Layout {
    /// First and last cell of the lanes along a block: the outlines of the two intersections.
    pub fn lane_ends(&self, block: i32) -> (i32, i32) {
        let built = self.built_span(block);
        (built.start - 1, built.end)
    }

    /// Whether a lane starts or ends here.
    pub fn is_lane_node(&self, cell: Cell) -> bool {
        self.is_node_across(cell.row, cell.col) || self.is_node_across(cell.col, cell.row)
    }

    /// Whether the first coordinate is on a lane and the second is where lanes begin and end.
    fn is_node_across(&self, across: i32, along: i32) -> bool {
        let on_lane = match self.place(across) {
            Place::Street { number, .. } => (across - self.mid_line(number)).abs() == self.lane_offset(),
            _ => false,
        };
        let at_end = match self.place(along) {
            Place::Lane { block } => {
                let (low, high) = self.lane_ends(block);
                along == low || along == high
            }
            _ => false,
        };
        on_lane && at_end
    }

    /// What a coordinate is on its axis; meaningful on the map only.
    fn place(&self, at: i32) -> Place {
        let number = at.div_euclid(self.period());
        if at < self.block_start(number) {
            let side = (at - self.mid_line(number)).signum();
            return Place::Street { number, side };
        }
        let (low, high) = self.lane_ends(number);
        if (low..=high).contains(&at) {
            Place::Lane { block: number }
        } else {
            Place::Corner
        }
    }
}
