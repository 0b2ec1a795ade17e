//! The road graph of a map of blocks, routes of cars on it, and the [`Router`].
//!
//! Cars drive on a graph of lanes. Each side of each street between two intersections is a lane with a start node and
//! an end node. At an intersection, each lane that ends there is connected to each lane that starts there: straight on,
//! by a turn or by a U-turn. A car drives from its start to the end node of the lane on its own side, and reaches its
//! goal from the start node of the goal's lane. So a goal just ahead in the same lane requires a detour, as in the
//! published program.
//!
//! The graph is regular, so the program does not store it. It searches for routes in a part of the map around start and
//! goal: a best route leaves their bounding box by at most one block. All parts of [`PART`] x [`PART`] blocks are
//! equal, so the route found between two lanes of one part is cached for all.
// Decision: docs/decisions/city.md#d058

use crate::city::drive::{Driving, RouteCosts};
use crate::city::map::Strip;
use crate::city::route::{NoRoute, TURN_COST, Way, steps};
use crate::city::walk::{search, walk};
use crate::city::{Agent, AgentKind, Routing, Side, Turn};
use crate::city::{Cell, CityMap, Heading, Layout, Route};
use pathfinding::directed::astar::astar;
use pathfinding::directed::bfs::bfs_bidirectional;
use pathfinding::directed::dijkstra::dijkstra;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Rows and columns of blocks of the part in which routes are cached. A smaller map is one part.
const PART: i32 = 8;

/// A side of a street between two intersections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lane {
    /// The cell where cars enter it, on the outline of the intersection behind.
    pub start: Cell,
    /// The cell where cars leave it, on the outline of the intersection ahead.
    pub end: Cell,
    /// The direction of travel.
    pub heading: Heading,
}

impl Lane {
    /// Returns its length in cells: the steps from start to end.
    pub fn length(&self) -> u32 {
        steps(self.start, self.end)
    }
}

/// A lane by its position on the grid of streets and blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct LanePlace {
    heading: Heading,
    /// The street whose side it is.
    street: i32,
    /// The block along which it runs: the column of a horizontal lane, the row of a vertical one.
    block: i32,
}

impl LanePlace {
    const fn is_horizontal(self) -> bool {
        matches!(self.heading, Heading::Left | Heading::Right)
    }

    /// The streets that meet at its end, [horizontal, vertical].
    fn end(self) -> [i32; 2] {
        match self.heading {
            Heading::Left => [self.street, self.block],
            Heading::Right => [self.street, self.block + 1],
            Heading::Up => [self.block, self.street],
            Heading::Down => [self.block + 1, self.street],
        }
    }

    /// The lane that starts with a heading at an intersection, if it is on the map.
    fn starting([across, down]: [i32; 2], heading: Heading) -> LanePlace {
        let (street, block) = match heading {
            Heading::Left => (across, down - 1),
            Heading::Right => (across, down),
            Heading::Up => (down, across - 1),
            Heading::Down => (down, across),
        };
        LanePlace { heading, street, block }
    }

    /// The lane that ends with a heading at an intersection, if it is on the map.
    fn ending([across, down]: [i32; 2], heading: Heading) -> LanePlace {
        let (street, block) = match heading {
            Heading::Left => (across, down),
            Heading::Right => (across, down - 1),
            Heading::Up => (down, across),
            Heading::Down => (down, across - 1),
        };
        LanePlace { heading, street, block }
    }

    /// The streets that meet at its start, [horizontal, vertical].
    fn start(self) -> [i32; 2] {
        let [across, down] = self.end();
        let (rows, cols) = self.heading.delta();
        [across - rows, down - cols]
    }

    /// The range of the streets at its ends, in rows and columns.
    fn extent(self) -> [Range<i32>; 2] {
        let ends = [self.start(), self.end()];
        [0, 1].map(|axis| ends[0][axis].min(ends[1][axis])..ends[0][axis].max(ends[1][axis]))
    }

    /// The lane on the side of the street where the cell is.
    fn beside(layout: &Layout, cell: Cell) -> Option<LanePlace> {
        if !(0..layout.rows()).contains(&cell.row) || !(0..layout.cols()).contains(&cell.col) {
            return None;
        }
        let place = |street: (Strip, i32), block: (Strip, i32), before, after| {
            let side = match street.0 {
                Strip::StreetBefore => before,
                Strip::StreetAfter => after,
                _ => return None,
            };
            let block = match block.0 {
                Strip::LineBefore => block.1 - 1,
                strip if strip.in_block() || strip == Strip::LineAfter => block.1,
                _ => return None,
            };
            Some(LanePlace {
                heading: side,
                street: street.1,
                block,
            })
        };
        let (row, col) = (layout.strip(cell.row), layout.strip(cell.col));
        place(row, col, Heading::Left, Heading::Right).or_else(|| place(col, row, Heading::Down, Heading::Up))
    }

    fn moved(self, [rows, cols]: [i32; 2]) -> LanePlace {
        let (across, along) = if self.is_horizontal() {
            (rows, cols)
        } else {
            (cols, rows)
        };
        LanePlace {
            street: self.street + across,
            block: self.block + along,
            ..self
        }
    }

    /// The lane at this position.
    fn lane(self, layout: &Layout) -> Lane {
        let (middle, offset) = (layout.mid_line(self.street), layout.lane_offset());
        let (low, high) = layout.lane_ends(self.block);
        // Cars keep right: those that go left or down use the lane before the mid line.
        let (across, start, end) = match self.heading {
            Heading::Left => (middle - offset, high, low),
            Heading::Down => (middle - offset, low, high),
            Heading::Right => (middle + offset, low, high),
            Heading::Up => (middle + offset, high, low),
        };
        let cell = |along| {
            if self.is_horizontal() {
                Cell::new(across, along)
            } else {
                Cell::new(along, across)
            }
        };
        Lane {
            start: cell(start),
            end: cell(end),
            heading: self.heading,
        }
    }
}

/// A node of the road graph: the start or the end of a lane, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum RoadNode {
    /// The start of the car.
    Origin,
    Start(u32),
    End(u32),
    /// The goal of the car.
    Destination,
}

/// The road graph of a map or of a part of it: `blocks` rows and columns of blocks with the streets around them.
///
/// Lanes are numbered street by street, horizontal streets first, then block by block, the left-going or down-going
/// lane first. Searches visit lanes in this order, so it breaks ties between equal routes. For fewest hops it breaks
/// them as the published program does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Roads {
    layout: Layout,
    blocks: [i32; 2],
}

impl Roads {
    fn horizontal_lanes(&self) -> i32 {
        2 * (self.blocks[0] + 1) * self.blocks[1]
    }

    /// The number of lanes.
    fn lanes(&self) -> u32 {
        (self.horizontal_lanes() + 2 * (self.blocks[1] + 1) * self.blocks[0]).unsigned_abs()
    }

    /// The number of a lane; `None` if it is not on the map.
    fn number(&self, lane: LanePlace) -> Option<u32> {
        let [streets, blocks] = if lane.is_horizontal() {
            self.blocks
        } else {
            [self.blocks[1], self.blocks[0]]
        };
        if !(0..=streets).contains(&lane.street) || !(0..blocks).contains(&lane.block) {
            return None;
        }
        let first = if lane.is_horizontal() {
            0
        } else {
            self.horizontal_lanes()
        };
        let second = i32::from(matches!(lane.heading, Heading::Right | Heading::Up));
        Some((first + 2 * (lane.street * blocks + lane.block) + second).unsigned_abs())
    }

    fn place(&self, number: u32) -> LanePlace {
        let number = number.cast_signed();
        let horizontal = self.horizontal_lanes();
        let (number, blocks, headings) = if number < horizontal {
            (number, self.blocks[1], [Heading::Left, Heading::Right])
        } else {
            (number - horizontal, self.blocks[0], [Heading::Down, Heading::Up])
        };
        LanePlace {
            heading: headings[(number % 2) as usize],
            street: number / 2 / blocks,
            block: number / 2 % blocks,
        }
    }

    fn lane(&self, number: u32) -> Lane {
        self.place(number).lane(&self.layout)
    }

    /// The lanes that start where a lane ends, in ascending order.
    fn next(&self, lane: u32) -> impl Iterator<Item = u32> {
        let crossing = self.place(lane).end();
        let headings = [Heading::Left, Heading::Right, Heading::Down, Heading::Up];
        let mut next = headings.map(|heading| self.number(LanePlace::starting(crossing, heading)));
        next.sort_unstable();
        next.into_iter().flatten()
    }

    /// The lanes that end where a lane starts, in ascending order.
    fn previous(&self, lane: u32) -> impl Iterator<Item = u32> {
        let crossing = self.place(lane).start();
        let headings = [Heading::Right, Heading::Left, Heading::Down, Heading::Up];
        let mut previous = headings.map(|heading| self.number(LanePlace::ending(crossing, heading)));
        previous.sort_unstable();
        previous.into_iter().flatten()
    }

    /// The lanes of a best route after the first, up to the last. This function defines the result; the search is slow.
    fn search(&self, routing: Routing, first: u32, last: u32) -> Option<Vec<u32>> {
        let nodes = match routing {
            Routing::Weighted => self.lightest(first, last),
            Routing::Hops => self.fewest_hops(first, last),
        };
        Some(entered(&nodes?))
    }

    /// The nodes of a route with the least sum of length and turn costs.
    fn lightest(&self, first: u32, last: u32) -> Option<Vec<RoadNode>> {
        let successors = |&node: &RoadNode| {
            (self.after(node, first, last).into_iter())
                .map(move |next| (next, self.weight(node, next)))
                .collect::<Vec<_>>()
        };
        dijkstra(&RoadNode::Origin, successors, |&node| node == RoadNode::Destination).map(|(nodes, _)| nodes)
    }

    /// The nodes of a route with the fewest nodes. The bidirectional search expands the smaller frontier first, which
    /// breaks ties as the published program does.
    fn fewest_hops(&self, first: u32, last: u32) -> Option<Vec<RoadNode>> {
        let after = |&node: &RoadNode| self.after(node, first, last);
        let before = |&node: &RoadNode| self.before(node, first, last);
        bfs_bidirectional(&RoadNode::Origin, &RoadNode::Destination, after, before)
    }

    /// The successors of a node on a route from one lane to another.
    fn after(&self, node: RoadNode, first: u32, last: u32) -> Vec<RoadNode> {
        match node {
            RoadNode::Origin => vec![RoadNode::End(first)],
            RoadNode::Start(lane) if lane == last => vec![RoadNode::End(lane), RoadNode::Destination],
            RoadNode::Start(lane) => vec![RoadNode::End(lane)],
            RoadNode::End(lane) => self.next(lane).map(RoadNode::Start).collect(),
            RoadNode::Destination => Vec::new(),
        }
    }

    /// The predecessors of a node: the converse of [`Roads::after`].
    fn before(&self, node: RoadNode, first: u32, last: u32) -> Vec<RoadNode> {
        match node {
            RoadNode::Origin => Vec::new(),
            RoadNode::Start(lane) => self.previous(lane).map(RoadNode::End).collect(),
            RoadNode::End(lane) if lane == first => vec![RoadNode::Start(lane), RoadNode::Origin],
            RoadNode::End(lane) => vec![RoadNode::Start(lane)],
            RoadNode::Destination => vec![RoadNode::Start(last)],
        }
    }

    /// The weight of an edge in cells. The first and the last edge are common to all routes between two places.
    fn weight(&self, from: RoadNode, to: RoadNode) -> u32 {
        match (from, to) {
            (RoadNode::Start(lane), RoadNode::End(_)) => self.lane(lane).length(),
            (RoadNode::End(from), RoadNode::Start(to)) => {
                let (from, to) = (self.lane(from), self.lane(to));
                steps(from.end, to.start) + if from.heading == to.heading { 0 } else { TURN_COST }
            }
            _ => 0,
        }
    }

    /// Finds a route of equal cost as [`Roads::search`] by A*; it may break ties differently.
    fn guided(&self, routing: Routing, first: u32, last: u32) -> Option<Vec<u32>> {
        let target = self.lane(last);
        let [across, down] = self.place(last).start();
        // A lower bound on the cost from the end of a lane. Some route attains the minimum of turns, and some route the
        // minimum of length.
        let from_end = |lane: u32| {
            let [row, col] = self.place(lane).end();
            match routing {
                Routing::Hops => 2 * (row.abs_diff(across) + col.abs_diff(down)) + 1,
                Routing::Weighted => {
                    let from = self.lane(lane);
                    let turns = least_turns(from.heading, [across - row, down - col], target.heading);
                    steps(from.end, target.start) + TURN_COST * turns
                }
            }
        };
        let weight = |from, to| match routing {
            Routing::Hops => 1,
            Routing::Weighted => self.weight(from, to),
        };
        let successors = |&node: &RoadNode| {
            let after = self.after(node, first, last).into_iter();
            after.map(move |next| (next, weight(node, next))).collect::<Vec<_>>()
        };
        let to_go = |&node: &RoadNode| match node {
            RoadNode::Start(lane) if lane != last => weight(node, RoadNode::End(lane)) + from_end(lane),
            RoadNode::End(lane) => from_end(lane),
            _ => 0,
        };
        let (nodes, _) = astar(&RoadNode::Origin, successors, to_go, |&node| {
            node == RoadNode::Destination
        })?;
        Some(entered(&nodes))
    }
}

/// The lanes that a route enters.
fn entered(nodes: &[RoadNode]) -> Vec<u32> {
    let lane = |node: &RoadNode| match node {
        RoadNode::Start(lane) => Some(*lane),
        _ => None,
    };
    nodes.iter().filter_map(lane).collect()
}

/// The least number of turns on a route that begins with one heading, covers a difference of rows and columns, and ends
/// with another heading. The route takes the two directions in either order.
fn least_turns(first: Heading, [rows, cols]: [i32; 2], last: Heading) -> u32 {
    let vertical = if rows < 0 { Heading::Up } else { Heading::Down };
    let horizontal = if cols < 0 { Heading::Left } else { Heading::Right };
    let turns = |way: &[Heading]| way.windows(2).map(|pair| u32::from(pair[0] != pair[1])).sum();
    match (rows, cols) {
        (0, 0) => turns(&[first, last]),
        (_, 0) => turns(&[first, vertical, last]),
        (0, _) => turns(&[first, horizontal, last]),
        _ => turns(&[first, vertical, horizontal, last]).min(turns(&[first, horizontal, vertical, last])),
    }
}

/// The headings of the lanes that a route enters, two bits each, with their number in the high bits; 0 means none. It
/// holds up to 29 headings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Turns(u64);

impl Turns {
    /// The position of the number.
    const COUNT: u32 = 58;

    fn new(headings: &[Heading]) -> Option<Turns> {
        if 2 * headings.len() > Self::COUNT as usize {
            return None;
        }
        let bits = (headings.iter().rev()).fold(0, |bits, &heading| bits << 2 | heading as u64);
        Some(Turns((headings.len() as u64) << Self::COUNT | bits))
    }

    fn headings(self) -> impl Iterator<Item = Heading> {
        (0..self.0 >> Self::COUNT).map(move |index| Heading::ALL[(self.0 >> (2 * index) & 3) as usize])
    }
}

/// Plans routes on one map.
#[derive(Debug)]
pub struct Router {
    map: Arc<CityMap>,
    routing: Routing,
    /// The streets between blocks; `None` on a road network.
    streets: Option<Streets>,
    /// The costs on a road network; `None` on a map of blocks.
    costs: Option<RouteCosts>,
}

/// The streets of a map of blocks.
#[derive(Debug)]
struct Streets {
    routing: Routing,
    /// The roads of the whole map.
    roads: Roads,
    /// The roads of a part.
    part: Roads,
    /// For each pair of lanes of a part: the cached [`Turns`], or 0. The value is a function of the pair, so that
    /// threads may write it concurrently.
    known: Box<[AtomicU64]>,
}

impl Router {
    /// Creates a router for a map. It takes at most 0.7 MB for a map of blocks. For a road network it takes four bytes
    /// a connection and, from the first weighted route on, 128 bytes a lane.
    pub fn new(map: Arc<CityMap>, routing: Routing) -> Self {
        Router {
            streets: map.layout().map(|layout| Streets::new(*layout, routing)),
            costs: map.roads().map(|roads| RouteCosts::new(roads, routing)),
            routing,
            map,
        }
    }

    /// Returns the map.
    pub fn map(&self) -> &Arc<CityMap> {
        &self.map
    }

    /// Returns the algorithm by which agents choose routes.
    pub fn routing(&self) -> Routing {
        self.routing
    }

    /// Returns the lanes between blocks: street by street, horizontal streets first, then block by block, the
    /// left-going or down-going lane first. [`CityMap::network`] has those of a road network.
    pub fn lanes(&self) -> impl ExactSizeIterator<Item = Lane> {
        let count = self.streets.as_ref().map_or(0, |streets| streets.roads.lanes());
        (0..count).map(|number| self.streets.as_ref().expect("it has lanes").roads.lane(number))
    }

    /// Returns the connections between these lanes: the pairs of lane numbers whose end node and start node are
    /// connected.
    pub fn connectors(&self) -> impl Iterator<Item = (usize, usize)> {
        self.streets.iter().flat_map(|streets| {
            let roads = &streets.roads;
            (0..roads.lanes()).flat_map(|from| roads.next(from).map(move |to| (from as usize, to as usize)))
        })
    }

    /// Plans a route; equal arguments give equal routes. If the agent is at its goal, the route is that cell.
    ///
    /// A car can start and arrive anywhere beside a lane: on a street between two intersections, their outlines
    /// included, on either side of the mid line. A pedestrian takes a shortest path over walking streets and crossings.
    ///
    /// # Errors
    /// If the agent cannot be at the start or at the goal, or cannot get from one to the other.
    pub fn plan(&self, kind: AgentKind, start: Cell, goal: Cell) -> Result<Route, NoRoute> {
        let mut way = Way::new(&self.map, kind, start);
        match (kind, &self.streets) {
            (AgentKind::Car, Some(streets)) => streets.drive(&mut way, goal)?,
            (AgentKind::Car, None) => self.network().drive(&mut way, goal)?,
            (AgentKind::Pedestrian, streets) => {
                if !self.map.is_walkable(start) {
                    return Err(NoRoute::Start);
                }
                if !self.map.is_walkable(goal) {
                    return Err(NoRoute::Goal);
                }
                match (self.routing, streets) {
                    (Routing::Weighted, Some(streets)) => walk(&streets.roads.layout, goal, &mut way),
                    (Routing::Weighted, None) | (Routing::Hops, _) => search(&self.map, goal, &mut way)?,
                }
            }
        }
        Ok(way.finish())
    }

    /// The road network with the algorithm; only for maps that are not of blocks.
    fn network(&self) -> Driving<'_> {
        let (roads, costs) = (self.map.roads().zip(self.costs.as_ref())).expect("a map is of blocks or of roads");
        Driving::new(roads, costs)
    }

    /// Returns given cells as a route, without consecutive repetitions. `None` if there are none, one is off the map,
    /// or consecutive cells differ by more than one step.
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

    /// Returns the route to the car's goal that takes a direction at its next intersection; `None` if no street leads
    /// there.
    pub(super) fn turn(&self, agent: &Agent, turn: Turn) -> Option<Route> {
        if agent.kind != AgentKind::Car {
            return None;
        }
        let mut way = Way::new(&self.map, agent.kind, agent.cell);
        match &self.streets {
            Some(streets) => streets.turn(&mut way, agent, turn)?,
            None => self.network().turn(&mut way, agent, turn)?,
        }
        Some(way.finish())
    }

    /// Returns the best route to the goal of a car on a road network that changes into the lane on a side of its own;
    /// `None` if there is none, or the car is too near to an end.
    pub(super) fn change_lane(&self, agent: &Agent, side: Side) -> Option<Route> {
        if agent.kind != AgentKind::Car || self.streets.is_some() {
            return None;
        }
        let mut way = Way::new(&self.map, agent.kind, agent.cell);
        self.network().change_lane(&mut way, agent, side)?;
        Some(way.finish())
    }

    /// Returns the best route to the car's goal that leaves its next intersection in another direction than its route;
    /// `None` if its route ends before, or there is no other street.
    pub(super) fn reroute(&self, agent: &Agent) -> Option<Route> {
        if agent.kind != AgentKind::Car {
            return None;
        }
        let way = || Way::new(&self.map, agent.kind, agent.cell);
        match &self.streets {
            Some(streets) => streets.reroute(way, agent),
            None => self.network().reroute(way, agent),
        }
    }
}

impl Streets {
    fn new(layout: Layout, routing: Routing) -> Streets {
        let roads = |blocks| Roads { layout, blocks };
        let part = roads(layout.blocks().map(|blocks| blocks.min(PART)));
        let lanes = part.lanes() as usize;
        Streets {
            routing,
            roads: roads(layout.blocks()),
            part,
            known: (0..lanes * lanes).map(|_| AtomicU64::new(0)).collect(),
        }
    }

    fn layout(&self) -> &Layout {
        &self.roads.layout
    }

    /// Plans the route of a car.
    fn drive(&self, way: &mut Way<'_>, goal: Cell) -> Result<(), NoRoute> {
        let layout = self.layout();
        let start = way.at();
        let first = self.lane_beside(start).ok_or(NoRoute::Start)?;
        let last = self.lane_beside(goal).ok_or(NoRoute::Goal)?;
        if start == goal {
            return Ok(());
        }
        let end = first.lane(layout).end;
        way.bend(end, rows_first_out(start, end));
        match self.turns(first, last).ok_or(NoRoute::Unconnected)? {
            Found::Known(turns) => self.enter(way, first, turns.headings()),
            Found::Long(headings) => self.enter(way, first, headings.into_iter()),
        }
        way.bend(goal, !rows_first_out(goal, way.at()));
        Ok(())
    }

    /// Continues a way from the end of a lane to the start of the last of the lanes that it enters after it.
    fn enter(&self, way: &mut Way<'_>, mut at: LanePlace, headings: impl Iterator<Item = Heading>) {
        let layout = self.layout();
        for (count, heading) in headings.enumerate() {
            if count > 0 {
                way.straight(at.lane(layout).end);
            }
            at = LanePlace::starting(at.end(), heading);
            // Go straight to the line of the new lane, then along it.
            way.bend(at.lane(layout).start, at.is_horizontal());
        }
    }

    /// Continues a way to the car's goal that takes a direction at its next intersection; `None` if no street leads
    /// there.
    fn turn(&self, way: &mut Way<'_>, agent: &Agent, turn: Turn) -> Option<()> {
        let lane = self.lane_ahead(agent)?;
        let heading = match turn {
            Turn::Straight => lane.heading,
            Turn::Right => lane.heading.clockwise(),
            Turn::Left => lane.heading.clockwise().opposite(),
        };
        self.turned(way, agent, lane, heading).map(|_| ())
    }

    /// Returns the best route to the car's goal that leaves its next intersection in another direction than its route;
    /// `None` if its route ends before, or there is no other street. `way` begins a way at the car.
    fn reroute<'m>(&self, way: impl Fn() -> Way<'m>, agent: &Agent) -> Option<Route> {
        let lane = self.lane_ahead(agent)?;
        let end = lane.lane(self.layout()).end;
        let mut nodes = std::iter::once((agent.cell, true))
            .chain(agent.stops_ahead())
            .filter(|(_, is_node)| *is_node)
            .map(|(cell, _)| cell);
        nodes.find(|&node| node == end)?;
        let planned = nodes.next()?;
        let is_other =
            |&heading: &Heading| LanePlace::starting(lane.end(), heading).lane(self.layout()).start != planned;
        let others = Heading::ALL.into_iter().filter(is_other);
        let routes = others.filter_map(|heading| {
            let mut way = way();
            let (lanes, turns) = self.turned(&mut way, agent, lane, heading)?;
            let route = way.finish();
            let cost = match self.routing {
                Routing::Hops => lanes,
                Routing::Weighted => route.steps() + TURN_COST as usize * turns,
            };
            Some((route, cost))
        });
        routes.min_by_key(|(_, cost)| *cost).map(|(route, _)| route)
    }

    /// The lane whose end is the car's next intersection: that beside it or, in an intersection, the next of its route.
    fn lane_ahead(&self, agent: &Agent) -> Option<LanePlace> {
        let next = || agent.stops_ahead().find(|(_, is_node)| *is_node);
        (self.lane_beside(agent.cell)).or_else(|| self.lane_beside(next()?.0))
    }

    /// Continues a way by the best one that leaves the end of a lane with a heading. Returns the numbers of its lanes
    /// and of its turns; `None` if no lane starts there.
    fn turned(&self, way: &mut Way<'_>, agent: &Agent, lane: LanePlace, heading: Heading) -> Option<(usize, usize)> {
        let next = LanePlace::starting(lane.end(), heading);
        self.roads.number(next)?;
        let goal = agent.goal();
        let last = self.lane_beside(goal)?;
        let mut headings = vec![heading];
        if next != last {
            match self.turns(next, last)? {
                Found::Known(turns) => headings.extend(turns.headings()),
                Found::Long(more) => headings.extend(more),
            }
        }
        if self.lane_beside(agent.cell).is_none() {
            // It crosses the intersection as planned.
            for (cell, is_node) in agent.stops_ahead() {
                way.straight(cell);
                if is_node {
                    break;
                }
            }
        }
        let end = lane.lane(self.layout()).end;
        way.bend(end, rows_first_out(way.at(), end));
        let all = std::iter::once(lane.heading).chain(headings.iter().copied());
        let turns = all.zip(&headings).filter(|(from, to)| from != *to).count();
        let lanes = headings.len();
        self.enter(way, lane, headings.into_iter());
        way.bend(goal, !rows_first_out(goal, way.at()));
        Some((lanes, turns))
    }

    /// The headings of the lanes that a best route between two lanes enters after the first.
    fn turns(&self, first: LanePlace, last: LanePlace) -> Option<Found> {
        let [one, other] = [first.extent(), last.extent()];
        let box_of = |axis: usize| one[axis].start.min(other[axis].start)..one[axis].end.max(other[axis].end);
        let around = [box_of(0), box_of(1)];
        let part = self.part.blocks;
        // The part must include a block on each side, or the whole map.
        let fits = |axis: usize| part[axis] == self.roads.blocks[axis] || around[axis].len() as i32 + 2 <= part[axis];
        if !(fits(0) && fits(1)) {
            let low = [0, 1].map(|axis| (around[axis].start - 1).max(0));
            let high = [0, 1].map(|axis| (around[axis].end + 1).min(self.roads.blocks[axis]));
            let blocks = [high[0] - low[0], high[1] - low[1]];
            let roads = Roads { blocks, ..self.roads };
            let [first, last] = [first, last].map(|lane| roads.number(lane.moved(low.map(|at| -at))));
            let lanes = roads.guided(self.routing, first?, last?)?;
            return Some(Found::Long(
                lanes.into_iter().map(|lane| roads.place(lane).heading).collect(),
            ));
        }
        let first_block = [0, 1].map(|axis| {
            let middle = (around[axis].start + around[axis].end - part[axis]).div_euclid(2);
            -middle.clamp(0, self.roads.blocks[axis] - part[axis])
        });
        let [first, last] = [first, last].map(|lane| self.part.number(lane.moved(first_block)));
        let (first, last) = (first?, last?);
        let known = &self.known[first as usize * self.part.lanes() as usize + last as usize];
        let turns = known.load(Ordering::Relaxed);
        if turns != 0 {
            return Some(Found::Known(Turns(turns)));
        }
        let lanes = self.part.search(self.routing, first, last)?;
        let headings: Vec<Heading> = lanes.into_iter().map(|lane| self.part.place(lane).heading).collect();
        let Some(turns) = Turns::new(&headings) else {
            return Some(Found::Long(headings));
        };
        known.store(turns.0, Ordering::Relaxed);
        Some(Found::Known(turns))
    }

    /// The lane on the side of the street where the cell is.
    fn lane_beside(&self, cell: Cell) -> Option<LanePlace> {
        LanePlace::beside(self.layout(), cell)
    }
}

/// The headings of the lanes that a route enters.
enum Found {
    Known(Turns),
    Long(Vec<Heading>),
}

/// Whether a car that drives to a node goes along the column first: the shorter leg comes first, and in a tie the
/// column. An arriving car does the reverse.
fn rows_first_out(place: Cell, node: Cell) -> bool {
    (node.row - place.row).abs() <= (node.col - place.col).abs()
}

impl Layout {
    /// Returns a number of the lane on the side of the street where the cell is, and the steps along it.
    pub(super) fn place_on_lane(&self, cell: Cell) -> Option<(u32, u32)> {
        let place = LanePlace::beside(self, cell)?;
        let roads = Roads {
            layout: *self,
            blocks: self.blocks(),
        };
        let start = place.lane(self).start;
        let steps = match place.is_horizontal() {
            true => cell.col.abs_diff(start.col),
            false => cell.row.abs_diff(start.row),
        };
        Some((roads.number(place)?, steps))
    }

    /// Returns the first and last cell of the lanes along a block: the outlines of the two intersections.
    pub fn lane_ends(&self, block: i32) -> (i32, i32) {
        let built = self.built_span(block);
        (built.start - 1, built.end)
    }

    /// Returns all lanes, in the order in which searches visit them, each with the numbers of its street and of the block
    /// along which it runs.
    pub fn lanes(&self) -> impl Iterator<Item = (i32, i32, Lane)> {
        let roads = Roads {
            layout: *self,
            blocks: self.blocks(),
        };
        (0..roads.lanes()).map(move |number| {
            let place = roads.place(number);
            (place.street, place.block, place.lane(&roads.layout))
        })
    }

    /// Returns whether a lane with a heading starts at a node of the road graph: behind an intersection, not before one.
    pub(super) fn starts_lane(&self, node: Cell, heading: Heading) -> bool {
        let (along, behind) = match heading {
            Heading::Left => (node.col, Strip::LineBefore),
            Heading::Right => (node.col, Strip::LineAfter),
            Heading::Up => (node.row, Strip::LineBefore),
            Heading::Down => (node.row, Strip::LineAfter),
        };
        self.strip(along).0 == behind
    }
}
