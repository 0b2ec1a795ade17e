//! Routes of cars on a road network.
//!
//! A car drives along its lane to the connection that it takes, and may change into the lane beside it. A route is a
//! sequence of stages; a stage is a lane and the cell where the car enters it.

use crate::city::network::Direction;
use crate::city::road_map::{RoadMap, Spot};
use crate::city::route::{NoRoute, Route, TURN_COST, Way, steps};
use crate::city::{Agent, Cell, Routing, Side, Turn};
use pathfinding::directed::astar::astar;
use pathfinding::directed::dijkstra::dijkstra_all;
use smallvec::SmallVec;
use std::sync::OnceLock;

/// The cost of a change of lanes in addition to its length, in cells.
const CHANGE_COST: u32 = 10;
/// The steps along a lane between two changes.
const CHANGE_AFTER: u32 = 2;

/// The number of landmarks.
const LANDMARKS: usize = 16;

/// Plans routes of cars on a network.
#[derive(Clone, Copy, Debug)]
pub(super) struct Driving<'m> {
    roads: &'m RoadMap,
    costs: &'m RouteCosts,
}

/// The costs of routes on a network, and lower bounds on them.
#[derive(Debug)]
pub(super) struct RouteCosts {
    routing: Routing,
    /// The cost of each connection, from the end of its first lane to the start of its second.
    connections: Box<[u32]>,
    landmarks: OnceLock<Option<Landmarks>>,
}

/// The distances of all lanes from and to some of them, which bound other distances by the triangle inequality: the
/// search ALT (Goldberg and Harrelson, 2005). `u32::MAX` means that there is no way.
#[derive(Debug)]
struct Landmarks {
    from: Box<[[u32; LANDMARKS]]>,
    to: Box<[[u32; LANDMARKS]]>,
}

impl RouteCosts {
    pub fn new(roads: &RoadMap, routing: Routing) -> RouteCosts {
        let network = roads.network();
        let connections = (network.connections.iter().zip(0..)).map(|(connection, number)| match routing {
            Routing::Hops => 1,
            Routing::Weighted => {
                let link = u32::try_from(roads.link(number).len()).expect("a map has few cells");
                let is_straight = connection.direction == Direction::Straight;
                link + 1 + if is_straight { 0 } else { TURN_COST }
            }
        });
        RouteCosts {
            routing,
            connections: connections.collect(),
            landmarks: OnceLock::new(),
        }
    }
}

impl Landmarks {
    /// Chooses lanes that are far from each other. Costs are those from the end of a lane to that of another; a change
    /// of lanes counts from where it costs least. `None` if a change brings a car nearer to the end of a lane than it
    /// costs.
    fn new(driving: &Driving<'_>) -> Option<Landmarks> {
        let network = driving.roads.network();
        let count = network.lanes.len();
        let mut ahead: Vec<Vec<(u32, u32)>> = vec![Vec::new(); count];
        let mut behind = ahead.clone();
        for lane in (0..).take(count) {
            let mut join = |other: u32, cost: u32| {
                ahead[lane as usize].push((other, cost));
                behind[other as usize].push((lane, cost));
            };
            for &connection in driving.roads.leaving(lane) {
                let other = network.connections[connection as usize].to;
                join(
                    other,
                    driving.costs.connections[connection as usize] + driving.last(other),
                );
            }
            for other in driving.roads.beside(lane) {
                let spots = (0..=driving.last(lane)).flat_map(|at| {
                    let changes = driving.changes(Spot { lane, at });
                    changes.map(move |found| (at, found))
                });
                let mut least: Option<u32> = None;
                for (at, (from, to)) in spots.filter(|(_, (_, to))| to.lane == other) {
                    let after = driving.change_cost(from, at, lane, to) + driving.last(other) - to.at;
                    let cost = after.checked_sub(driving.last(lane) - at)?;
                    least = Some(least.map_or(cost, |least| least.min(cost)));
                }
                if let Some(cost) = least {
                    join(other, cost);
                }
            }
        }
        let distances = |of: &[Vec<(u32, u32)>], start: u32| {
            let found = dijkstra_all(&start, |lane| of[*lane as usize].iter().copied());
            let mut distances = vec![u32::MAX; count];
            distances[start as usize] = 0;
            found
                .iter()
                .for_each(|(lane, (_, cost))| distances[*lane as usize] = *cost);
            distances
        };
        let mut landmarks = Landmarks {
            from: vec![[u32::MAX; LANDMARKS]; count].into(),
            to: vec![[u32::MAX; LANDMARKS]; count].into(),
        };
        let is_driven = |lane: &u32| !driving.roads.path(*lane).is_empty();
        let mut next = (0..).take(count).find(is_driven);
        let mut nearest = vec![u32::MAX; count];
        for at in 0..LANDMARKS {
            let Some(landmark) = next else { break };
            let from = distances(&ahead, landmark);
            let to = distances(&behind, landmark);
            for lane in 0..count {
                landmarks.from[lane][at] = from[lane];
                landmarks.to[lane][at] = to[lane];
                nearest[lane] = nearest[lane].min(from[lane]).min(to[lane]);
            }
            // The farthest lane that some way joins with the landmarks.
            let lanes = (0..)
                .zip(&nearest)
                .filter(|(_, distance)| (1..u32::MAX).contains(*distance));
            next = lanes
                .max_by_key(|(lane, distance)| (**distance, std::cmp::Reverse(*lane)))
                .map(|(lane, _)| lane);
        }
        Some(landmarks)
    }

    /// Returns a lower bound on the cost from the end of a lane to that of another.
    #[inline]
    fn bound(&self, lane: u32, other: u32) -> u32 {
        let (lane, other) = (lane as usize, other as usize);
        let pairs = |high: &[u32; LANDMARKS], low: &[u32; LANDMARKS]| {
            let mut most = 0;
            for at in 0..LANDMARKS {
                if high[at] != u32::MAX {
                    most = most.max(high[at].saturating_sub(low[at]));
                }
            }
            most
        };
        pairs(&self.from[other], &self.from[lane]).max(pairs(&self.to[lane], &self.to[other]))
    }
}

/// A node of the search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Stage {
    /// On a lane, where the car entered it.
    On(Spot, Entered),
    /// At the goal.
    Arrived,
}

/// How a car came to its lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Entered {
    First,
    Changed,
    Connected(u32),
}

impl<'m> Driving<'m> {
    pub fn new(roads: &'m RoadMap, costs: &'m RouteCosts) -> Self {
        Driving { roads, costs }
    }

    /// Continues a way to a goal.
    pub fn drive(&self, way: &mut Way<'_>, goal: Cell) -> Result<(), NoRoute> {
        let start = self.roads.spot(way.at()).ok_or(NoRoute::Start)?;
        let end = self.roads.spot(goal).ok_or(NoRoute::Goal)?;
        if way.at() == goal {
            return Ok(());
        }
        let (stages, _) = self
            .search(Stage::On(start, Entered::First), end)
            .ok_or(NoRoute::Unconnected)?;
        self.append(way, start, &stages, end, goal);
        Ok(())
    }

    /// Continues a way to the goal of a car with a turn at its next junction; `None` if no connection goes there.
    pub fn turn(&self, way: &mut Way<'_>, agent: &Agent, turn: Turn) -> Option<()> {
        let wanted = match turn {
            Turn::Left => Direction::Left,
            Turn::Right => Direction::Right,
            Turn::Straight => Direction::Straight,
        };
        let start = self.ahead(way, agent)?;
        let network = self.roads.network();
        let leaving = self.roads.leaving(start.lane).iter();
        let ways = leaving.filter(|&&connection| network.connections[connection as usize].direction == wanted);
        let (connection, stages, _) = self.best(ways.copied(), agent.goal())?;
        self.append_by(way, start, connection, &stages, agent.goal());
        Some(())
    }

    /// Continues a way to the goal of a car with a change into the lane on a side of its own; `None` if there is none, or
    /// the car is not on its lane or too near to an end.
    pub fn change_lane(&self, way: &mut Way<'_>, agent: &Agent, side: Side) -> Option<()> {
        let start = self.roads.spot(agent.cell)?;
        if self.roads.path(start.lane)[start.at as usize] != agent.cell {
            return None;
        }
        let lane = self.roads.lane_beside(start.lane, side)?;
        let (_, to) = self.changes(start).find(|(_, to)| to.lane == lane)?;
        let end = self.roads.spot(agent.goal())?;
        let (stages, _) = self.search(Stage::On(to, Entered::Changed), end)?;
        self.along(way, start, start.at + CHANGE_AFTER);
        self.append(way, to, &stages[1..], end, agent.goal());
        Some(())
    }

    /// Returns the best route to a car's goal that takes another connection at its next junction than its route does.
    /// `way` begins a way at the car.
    pub fn reroute<'w>(&self, way: impl Fn() -> Way<'w>, agent: &Agent) -> Option<Route> {
        let mut way = way();
        let start = self.ahead(&mut way, agent)?;
        let network = self.roads.network();
        // The lane that its route enters next.
        let end = *self.roads.path(start.lane).last()?;
        let mut cells = agent
            .route()
            .cells()
            .skip(agent.position())
            .skip_while(|&cell| cell != end);
        let after: Vec<Cell> = cells.by_ref().skip(1).collect();
        let planned = |connection: u32| {
            let enters = network.connections[connection as usize].to;
            let link = self.roads.link(connection);
            let first = self.roads.path(enters).first();
            link.iter().chain(first).zip(&after).all(|(cell, other)| cell == other)
        };
        if after.is_empty() {
            return None;
        }
        let others = self.roads.leaving(start.lane).iter().copied();
        let (connection, stages, _) = self.best(others.filter(|&other| !planned(other)), agent.goal())?;
        self.append_by(&mut way, start, connection, &stages, agent.goal());
        Some(way.finish())
    }

    /// Continues a way to the lane whose end is the car's next junction: that of its cell, or the next of its route.
    fn ahead(&self, way: &mut Way<'_>, agent: &Agent) -> Option<Spot> {
        for cell in agent.route().cells().skip(agent.position()) {
            way.straight(cell);
            if let Some(spot) = self.roads.spot(cell) {
                return Some(spot);
            }
        }
        None
    }

    /// Finds the best route to a goal that begins with one of these connections.
    fn best(&self, connections: impl Iterator<Item = u32>, goal: Cell) -> Option<(u32, Vec<Stage>, u32)> {
        let end = self.roads.spot(goal)?;
        let routes = connections.filter_map(|connection| {
            let first = self.entered(connection);
            let (stages, cost) = self.search(first, end)?;
            Some((connection, stages, cost + self.costs.connections[connection as usize]))
        });
        routes.min_by_key(|(.., cost)| *cost)
    }

    fn entered(&self, connection: u32) -> Stage {
        let lane = self.roads.network().connections[connection as usize].to;
        Stage::On(Spot { lane, at: 0 }, Entered::Connected(connection))
    }

    /// The position of the last cell of a lane for cars.
    fn last(&self, lane: u32) -> u32 {
        let length = u32::try_from(self.roads.path(lane).len()).expect("a map has few cells");
        length.saturating_sub(1)
    }

    /// The cost of a change of lanes, from a position on a lane to one on the lane beside it.
    fn change_cost(&self, from: u32, at: u32, lane: u32, to: Spot) -> u32 {
        let cell = self.roads.path(lane)[from as usize];
        let aside = steps(cell, self.roads.path(to.lane)[to.at as usize]);
        match self.costs.routing {
            Routing::Hops => 1,
            Routing::Weighted => from - at + aside + CHANGE_COST,
        }
    }

    /// Finds the stages of a best route, with its cost.
    fn search(&self, first: Stage, end: Spot) -> Option<(Vec<Stage>, u32)> {
        let goal = self.roads.path(end.lane)[end.at as usize];
        let network = self.roads.network();
        let is_weighted = self.costs.routing == Routing::Weighted;
        let successors = |stage: &Stage| {
            let mut next: SmallVec<[(Stage, u32); 6]> = SmallVec::new();
            let Stage::On(spot, _) = *stage else { return next };
            if spot.lane == end.lane && spot.at <= end.at {
                next.push((Stage::Arrived, if is_weighted { end.at - spot.at } else { 0 }));
            }
            let along = if is_weighted { self.last(spot.lane) - spot.at } else { 0 };
            for &connection in self.roads.leaving(spot.lane) {
                let lane = network.connections[connection as usize].to;
                let entered = Stage::On(Spot { lane, at: 0 }, Entered::Connected(connection));
                next.push((entered, along + self.costs.connections[connection as usize]));
            }
            for (from, to) in self.changes(spot) {
                let cost = self.change_cost(from, spot.at, spot.lane, to);
                next.push((Stage::On(to, Entered::Changed), cost));
            }
            next
        };
        let landmarks = match is_weighted {
            true => self.costs.landmarks.get_or_init(|| Landmarks::new(self)).as_ref(),
            false => None,
        };
        let behind_goal = self.last(end.lane) - end.at;
        let to_go = |stage: &Stage| match *stage {
            Stage::On(spot, _) if is_weighted => {
                let least = steps(self.roads.path(spot.lane)[spot.at as usize], goal);
                let bound = landmarks.map_or(0, |landmarks| {
                    let ends = landmarks.bound(spot.lane, end.lane);
                    (self.last(spot.lane) - spot.at + ends).saturating_sub(behind_goal)
                });
                bound.max(least)
            }
            _ => 0,
        };
        astar(&first, successors, to_go, |stage| *stage == Stage::Arrived)
    }

    /// The changes into the lanes beside: the position where the car leaves its lane, and where it enters the other.
    fn changes(&self, spot: Spot) -> impl Iterator<Item = (u32, Spot)> {
        let path = self.roads.path(spot.lane);
        let from = spot.at + CHANGE_AFTER;
        let is_before_end = |at: usize, path: &[Cell]| at + 1 < path.len();
        let beside = self
            .roads
            .beside(spot.lane)
            .filter(move |_| is_before_end(from as usize, path));
        beside.filter_map(move |lane| {
            let cell = path[from as usize];
            let other = self.roads.path(lane);
            let (at, _) = other.iter().enumerate().min_by_key(|(_, other)| steps(cell, **other))?;
            let at = is_before_end(at, other).then_some(at)?;
            let at = u32::try_from(at).ok()?;
            Some((from, Spot { lane, at }))
        })
    }

    /// Continues a way by stages, from a position on a lane.
    fn append(&self, way: &mut Way<'_>, start: Spot, stages: &[Stage], end: Spot, goal: Cell) {
        let mut at = start;
        way.bend(self.roads.path(at.lane)[at.at as usize], false);
        for stage in stages {
            match *stage {
                Stage::On(_, Entered::First) => {}
                Stage::On(spot, Entered::Connected(connection)) => {
                    self.connect(way, at, connection);
                    at = spot;
                }
                Stage::On(spot, Entered::Changed) => {
                    self.along(way, at, at.at + CHANGE_AFTER);
                    way.bend(self.roads.path(spot.lane)[spot.at as usize], false);
                    at = spot;
                }
                Stage::Arrived => self.along(way, at, end.at),
            }
        }
        way.bend(goal, false);
    }

    /// Continues a way from a position on a lane to its end, and by a connection to the start of the next.
    fn connect(&self, way: &mut Way<'_>, from: Spot, connection: u32) {
        self.along(way, from, u32::MAX);
        let lane = self.roads.network().connections[connection as usize].to;
        let start = self.roads.path(lane).iter().take(1);
        self.roads
            .link(connection)
            .iter()
            .chain(start)
            .for_each(|&cell| way.straight(cell));
    }

    /// Continues a way by a connection and stages behind it.
    fn append_by(&self, way: &mut Way<'_>, start: Spot, connection: u32, stages: &[Stage], goal: Cell) {
        let end = self.roads.spot(goal).expect("a search has found it");
        way.bend(self.roads.path(start.lane)[start.at as usize], false);
        self.connect(way, start, connection);
        let lane = self.roads.network().connections[connection as usize].to;
        let first = Spot { lane, at: 0 };
        self.append(way, first, &stages[1..], end, goal);
    }

    /// Continues a way along a lane, from the cell behind a position to another position, or to the end.
    fn along(&self, way: &mut Way<'_>, from: Spot, to: u32) {
        let path = self.roads.path(from.lane);
        let end = path.len().min(to as usize + 1);
        path[(from.at as usize + 1).min(end)..end]
            .iter()
            .for_each(|&cell| way.straight(cell));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::network::{Connection, LaneUse, Network, Point, RoadJunction, RoadLane, Sign};
    use crate::rng::{Purpose, RngExt, Seed};
    use std::sync::Arc;

    /// Two streets of several lanes around a block; the lanes of the first begin and end at different places.
    fn network(starts: [f64; 3], ends: [f64; 3]) -> RoadMap {
        let lane = |name: &str, left: Option<u32>, points: &[(f64, f64)]| RoadLane {
            name: name.to_owned(),
            usage: LaneUse::Drive,
            to: Some(0),
            left,
            shape: points.iter().map(|&(x, y)| Point { x, y }).collect(),
            width: 1.0,
            limit: None,
        };
        let row = |at: usize| 40.5 - 2.0 * f64::from(u8::try_from(at).unwrap());
        let mut lanes: Vec<RoadLane> = (0..3)
            .map(|at| {
                let left = u32::try_from(at + 1).ok().filter(|left| *left < 3);
                lane(&format!("a{at}"), left, &[(starts[at], row(at)), (ends[at], row(at))])
            })
            .collect();
        lanes.push(lane("back", None, &[(95.5, 10.5), (2.5, 10.5)]));
        let connection = |from, to, direction| Connection {
            from,
            to,
            direction,
            sign: Sign::Priority,
            shape: Vec::new(),
            yields_to: Vec::new(),
            light: None,
        };
        let around = (0..3).map(|from| connection(from, 3, Direction::Left));
        let again = (0..2).map(|to| connection(3, to, Direction::Straight));
        RoadMap::new(Arc::new(Network {
            cell: 1.0,
            origin: [0.0; 2],
            size: [50, 100],
            junctions: vec![RoadJunction {
                name: "all".to_owned(),
                shape: Vec::new(),
            }],
            lanes,
            connections: around.chain(again).collect(),
            signals: Vec::new(),
        }))
    }

    /// With and without landmarks, routes have the same costs.
    #[test]
    fn landmarks_change_no_cost() {
        let mut random = Seed(3).stream(Purpose::TEST, 0, 0);
        let (mut bounded, mut compared) = (0, 0);
        for _ in 0..30 {
            let starts = [(); 3].map(|()| f64::from(random.random_range(2..60_u8)) + 0.5);
            let ends = [(); 3].map(|()| f64::from(random.random_range(70..96_u8)) + 0.5);
            let roads = network(starts, ends);
            let [costs, plain] = [(); 2].map(|()| RouteCosts::new(&roads, Routing::Weighted));
            let _ = plain.landmarks.set(None);
            let (fast, slow) = (Driving::new(&roads, &costs), Driving::new(&roads, &plain));
            for _ in 0..40 {
                let [first, end] = [(); 2].map(|()| {
                    let lane = random.random_range(0..4_u32);
                    let at = random.random_range(0..=fast.last(lane));
                    Spot { lane, at }
                });
                let cost = |driving: &Driving<'_>| {
                    let found = driving.search(Stage::On(first, Entered::First), end);
                    found.map(|(_, cost)| cost)
                };
                assert_eq!(cost(&fast), cost(&slow), "{starts:?} {ends:?} {first:?} {end:?}");
                compared += usize::from(cost(&fast).is_some());
            }
            bounded += usize::from(costs.landmarks.get().is_some_and(Option::is_some));
        }
        assert!(bounded > 0 && bounded < 30 && compared > 300, "{bounded} {compared}");
    }
}
