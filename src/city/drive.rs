//! Routes of cars on a road network.
//!
//! A car drives along its lane to the connection that it takes, and may change into the lane beside it. A route is a
//! sequence of stages; a stage is a lane and the cell where the car enters it.

use crate::city::network::{Direction, RoadMap, Spot};
use crate::city::route::{NoRoute, Route, TURN_COST, Way, steps};
use crate::city::{Agent, Cell, Routing, Turn};
use pathfinding::directed::astar::astar;

/// The cost of a change of lanes in addition to its length, in cells.
const CHANGE_COST: u32 = 10;
/// The steps along a lane between two changes.
const CHANGE_AFTER: u32 = 2;

/// Plans routes of cars on a network.
#[derive(Clone, Copy, Debug)]
pub(super) struct Driving<'m> {
    roads: &'m RoadMap,
    routing: Routing,
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
    pub fn new(roads: &'m RoadMap, routing: Routing) -> Self {
        Driving { roads, routing }
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
            Some((connection, stages, cost + self.cost_of(connection)))
        });
        routes.min_by_key(|(.., cost)| *cost)
    }

    fn entered(&self, connection: u32) -> Stage {
        let lane = self.roads.network().connections[connection as usize].to;
        Stage::On(Spot { lane, at: 0 }, Entered::Connected(connection))
    }

    /// The cost of a connection, from the end of its first lane to the start of its second.
    fn cost_of(&self, connection: u32) -> u32 {
        let is_straight = self.roads.network().connections[connection as usize].direction == Direction::Straight;
        match self.routing {
            Routing::Hops => 1,
            Routing::Weighted => {
                let link = self.roads.link(connection).len();
                u32::try_from(link).expect("a map has few cells") + 1 + if is_straight { 0 } else { TURN_COST }
            }
        }
    }

    /// Finds the stages of a best route, with its cost.
    fn search(&self, first: Stage, end: Spot) -> Option<(Vec<Stage>, u32)> {
        let goal = self.roads.path(end.lane)[end.at as usize];
        let weigh = |steps: u32, other: u32| match self.routing {
            Routing::Hops => other.min(1),
            Routing::Weighted => steps + other,
        };
        let successors = |stage: &Stage| {
            let Stage::On(spot, _) = *stage else { return Vec::new() };
            let path = self.roads.path(spot.lane);
            let last = u32::try_from(path.len()).expect("a map has few cells") - 1;
            let mut next = Vec::new();
            if spot.lane == end.lane && spot.at <= end.at {
                next.push((Stage::Arrived, weigh(end.at - spot.at, 0)));
            }
            next.extend(self.roads.leaving(spot.lane).iter().map(|&connection| {
                let cost = match self.routing {
                    Routing::Hops => 1,
                    Routing::Weighted => last - spot.at + self.cost_of(connection),
                };
                (self.entered(connection), cost)
            }));
            next.extend(self.changes(spot).map(|(from, to)| {
                let aside = steps(path[from as usize], self.roads.path(to.lane)[to.at as usize]);
                (
                    Stage::On(to, Entered::Changed),
                    weigh(from - spot.at + aside, CHANGE_COST),
                )
            }));
            next
        };
        let to_go = |stage: &Stage| match (stage, self.routing) {
            (Stage::On(spot, _), Routing::Weighted) => steps(self.roads.path(spot.lane)[spot.at as usize], goal),
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
