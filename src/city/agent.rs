//! Agents and their placement.
// Decision: docs/decisions/city.md#d059

use crate::cancel::Cancel;
use crate::city::codes;
use crate::city::route::Piece;
use crate::city::{Action, AgentConfig, AgentKind, AgentName, AgentSet, KindId, KindName, Rectangle, Region};
use crate::city::{Cell, CityMap, Heading, NoRoute, Places, Route, Router, TripEnds};
use crate::diag::Diagnostic;
use crate::located::Located;
use crate::rng::{Purpose, RngExt, Seed};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Purpose {
    /// An agent's first start and goal; index: agent.
    pub const PLACEMENT: Purpose = Purpose::new(2);
}

/// An agent on its route.
#[derive(Clone, Debug)]
pub struct Agent {
    /// Whether it drives or walks.
    pub kind: AgentKind,
    /// Its kind, which the configuration may define.
    pub kind_id: KindId,
    /// Its number within the kind, from 1.
    pub number: u32,
    /// Its concepts, shared by equal agents. The first one of a kind that the configuration defines is its name.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
    /// Its position.
    pub cell: Cell,
    /// The direction of its last move; `None` before the first move on a route.
    pub heading: Option<Heading>,
    /// The stage of its rest at the goal.
    pub rest: Rest,
    /// The number of cells that it moved in the last tick; 0 before the first.
    pub speed: u8,
    /// The number of ticks since its last move, or since the start of the run.
    pub waited: u32,
    /// The number of ticks for which it stands parked from the next tick on.
    pub parked: u32,
    /// The action that parked it, in effect while it stands.
    pub parked_by: Action,
    /// The direction of the next step; at the goal, of the last one.
    ahead: Heading,
    /// The direction that it faces on the current piece of the route.
    facing: Heading,
    /// Steps to the end of the current piece of the route; 0 only at the goal.
    left: u32,
    /// The index of the next piece.
    next: u32,
    /// Steps of the route taken so far.
    position: u32,
    /// Its route. Only [`Agent::set_out`] changes it.
    route: Route,
}

/// The stages of an agent's rest at its goal. In the tick after the last stage it sets out for a new goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rest {
    /// Under way, or in its first tick at the goal.
    #[default]
    UnderWay,
    /// Has rested for one tick.
    Arrived,
    /// Has rested for two ticks; sets out in the next.
    Rested,
}

impl Agent {
    /// Creates an agent at the start of a route.
    pub fn new(config: &AgentConfig, route: Route) -> Self {
        Agent::with(config.name, &config.concepts, config.priority, route)
    }

    fn with(name: AgentName, concepts: &Arc<[String]>, priority: i32, route: Route) -> Self {
        let mut agent = Agent {
            kind: name.kind,
            kind_id: name.kind_id(),
            number: name.number,
            concepts: Arc::clone(concepts),
            priority,
            cell: route.start(),
            heading: None,
            rest: Rest::UnderWay,
            speed: 0,
            waited: 0,
            parked: 0,
            parked_by: Action::Stop,
            ahead: Heading::Left,
            facing: Heading::Left,
            left: 0,
            next: 0,
            position: 0,
            route,
        };
        agent.next_piece();
        agent
    }

    /// Returns its name, for example `Car_1`.
    pub fn name(&self) -> AgentName {
        let own = || Some((self.kind_id, KindName::new(self.concepts.first()?)?));
        AgentName {
            kind: self.kind,
            own: (!self.kind_id.is_standard()).then(own).flatten(),
            number: self.number,
        }
    }

    /// Returns whether an earlier action parked the agent, so that it has no choice in the next tick.
    pub fn is_parked(&self) -> bool {
        self.parked > 0
    }

    /// Moves the agent to the start of a new route and clears its heading.
    pub fn set_out(&mut self, route: Route) {
        self.cell = route.start();
        self.heading = None;
        self.route = route;
        (self.left, self.next, self.position) = (0, 0, 0);
        self.rest = Rest::UnderWay;
        self.parked = 0;
        self.next_piece();
    }

    /// Replaces the rest of the route by a route from the agent's cell. The heading stays.
    pub(super) fn change_route(&mut self, route: Route) {
        debug_assert_eq!(route.start(), self.cell);
        self.route = route;
        (self.left, self.next, self.position) = (0, 0, 0);
        self.next_piece();
    }

    /// Returns the cells where the next moves must end, in order, each with whether it is a node of the road graph.
    pub(super) fn stops_ahead(&self) -> impl Iterator<Item = (Cell, bool)> + '_ {
        let first = (self.next.checked_sub(1))
            .and_then(|last| self.route.piece(last))
            .map(|piece| (piece, self.left));
        let rest = (self.next..)
            .map_while(|index| self.route.piece(index))
            .map(|piece| (piece, piece.steps()));
        let mut at = self.cell;
        let ends = first.into_iter().chain(rest).map(move |(piece, steps)| {
            at = at.ahead(piece.heading(), steps.cast_signed());
            (at, piece)
        });
        ends.filter(|(_, piece)| !piece.is_passed())
            .map(|(at, piece)| (at, piece.ends_at_node()))
    }

    /// Returns the direction in which its route leaves the intersection at or in which it is, or else its next one;
    /// `None` if the route ends before. The corners of the map count as intersections.
    pub fn exit(&self, map: &CityMap) -> Option<Heading> {
        self.stops_ahead()
            .filter(|(cell, is_node)| *is_node && *cell != self.cell)
            .find_map(|(cell, _)| map.lane_entered(cell))
    }

    /// Advances to the next piece of the route, if there is one.
    fn next_piece(&mut self) {
        if let Some(piece) = self.route.piece(self.next) {
            self.ahead = piece.heading();
            self.facing = piece.facing();
            self.left = piece.steps();
            self.next += 1;
        }
    }

    /// Returns the route.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// Returns the direction of its next step; at the goal, of the last one.
    pub fn ahead(&self) -> Heading {
        self.ahead
    }

    /// Returns its position among the cells of the route, from 0.
    pub fn position(&self) -> usize {
        self.position as usize
    }

    /// Returns the first cell of the route.
    pub fn start(&self) -> Cell {
        self.route.start()
    }

    /// Returns the last cell of the route.
    pub fn goal(&self) -> Cell {
        self.route.goal()
    }

    /// Returns whether it is at its goal.
    pub fn at_goal(&self) -> bool {
        self.left == 0
    }

    /// Steps to the next place where a move must end: a corner, a node of the road graph, or the goal. On a road network
    /// it counts only as far as it needs to for `most` steps.
    #[inline]
    pub(super) fn free_ahead(&self, most: usize) -> usize {
        match self.is_passing() {
            false => self.left as usize,
            true => self.passed_ahead(most),
        }
    }

    /// Whether a move may go on behind the current piece of the route.
    #[inline]
    fn is_passing(&self) -> bool {
        self.route.has_passed_corners() && self.current().is_some_and(Piece::is_passed)
    }

    #[inline(never)]
    fn passed_ahead(&self, most: usize) -> usize {
        let mut ahead = self.left as usize;
        let mut pieces = (self.next..).map_while(|index| self.route.piece(index));
        let mut is_passed = true;
        while let Some(piece) = pieces.next().filter(|_| is_passed && ahead < most) {
            ahead += piece.steps() as usize;
            is_passed = piece.is_passed();
        }
        ahead
    }

    /// The current piece of the route; `None` at a goal that is the start.
    fn current(&self) -> Option<Piece> {
        self.route.piece(self.next.checked_sub(1)?)
    }

    /// Returns the number of steps to the goal.
    pub fn remaining(&self) -> u32 {
        u32::try_from(self.route.steps()).expect("positions have 32 bits") - self.position
    }

    /// Records the number of cells that it moved in a tick.
    #[inline]
    pub(super) fn record(&mut self, cells: usize) {
        // A move has at most three cells.
        #[allow(clippy::cast_possible_truncation)]
        let speed = cells as u8;
        self.speed = speed;
        self.waited = if speed == 0 { self.waited.saturating_add(1) } else { 0 };
    }

    /// Moves along the route by at most [`Agent::free_ahead`] steps.
    pub(super) fn step(&mut self, cells: usize) {
        let mut cells = u32::try_from(cells).unwrap_or(u32::MAX);
        while cells > self.left && self.is_passing() {
            cells -= self.left;
            self.walk(self.left);
        }
        self.walk(cells.min(self.left));
    }

    /// Moves along the current piece of the route by at most its rest.
    #[inline]
    fn walk(&mut self, cells: u32) {
        if cells == 0 {
            return;
        }
        self.cell = self.cell.ahead(self.ahead, cells.cast_signed());
        self.heading = Some(self.facing);
        self.position += cells;
        self.left -= cells;
        if self.left == 0 {
            self.next_piece();
        }
    }
}

/// Places a set of agents on the map: each gets its own start cell, a goal and a route. (In runs of the published
/// program two agents may start in one cell; to reproduce those, pass routes to [`Agent::new`].)
///
/// # Errors
/// `no-start-cell` if the region has fewer start cells than agents of a kind, `no-route` if no goal can be reached.
pub fn place_agents(set: &AgentSet, router: &Router, places: &Places, seed: Seed) -> Result<Vec<Agent>, Diagnostic> {
    let mut agents = Vec::with_capacity(set.len());
    place_agents_into(&mut agents, set, router, places, seed, &Cancel::never())?;
    Ok(agents)
}

/// Places a set of agents in the memory of other agents. Polls `cancel` for every agent. After an error or
/// cancellation, the list holds some of both.
///
/// # Errors
/// As [`place_agents`]; `cancelled` on cancellation.
pub fn place_agents_into(
    agents: &mut Vec<Agent>,
    set: &AgentSet,
    router: &Router,
    places: &Places,
    seed: Seed,
    cancel: &Cancel,
) -> Result<(), Diagnostic> {
    for kind in AgentKind::ALL {
        check_room(set, router.map(), places, kind)?;
    }
    let mut free = AgentKind::ALL.map(|kind| Free::new(places.count(kind)));
    let mut count = 0;
    for (index, (name, group)) in set.members().enumerate() {
        if cancel.requested() {
            return Err(Diagnostic::cancelled());
        }
        let mut stream = seed.stream(Purpose::PLACEMENT, index as u64, 0);
        let free = &mut free[name.kind as usize];
        let drawn = free.take(stream.random_range(0..free.count));
        let start = places.nth(name.kind, drawn).expect("a place that was free");
        let route = (places.draw_route(router, name.kind, start, &mut stream))
            .map_err(|reason| nowhere(set, router.map(), places, name, start, reason))?;
        match agents.get_mut(index) {
            Some(agent) => {
                (agent.kind, agent.kind_id) = (name.kind, name.kind_id());
                agent.number = name.number;
                agent.priority = group.priority;
                // The atomic reference count is expensive, and the concepts usually stay the same.
                if !Arc::ptr_eq(&agent.concepts, &group.concepts) {
                    agent.concepts = Arc::clone(&group.concepts);
                }
                agent.set_out(route);
                (agent.speed, agent.waited) = (0, 0);
            }
            None => agents.push(Agent::with(name, &group.concepts, group.priority, route)),
        }
        count += 1;
    }
    agents.truncate(count);
    Ok(())
}

/// Returns the start region of a set if it does not cover the map.
fn part_of_map<'s>(set: &'s AgentSet, map: &CityMap) -> Option<&'s Located<Region>> {
    set.region.as_ref().filter(|region| {
        let Rectangle { rows, cols } = region.value.extent(map);
        rows != (0..map.rows()) || cols != (0..map.cols())
    })
}

/// Describes the start region of a set, for messages.
fn within(set: &AgentSet, map: &CityMap) -> String {
    part_of_map(set, map).map_or_else(
        || "on the whole map".to_string(),
        |region| match &region.value {
            Region::Side(side) => format!("in the first {side} rows and columns"),
            Region::Zone(name) => format!("in the zone `{name}`"),
        },
    )
}

/// Fails with `no-start-cell` if there are fewer start cells than agents of a kind.
fn check_room(set: &AgentSet, map: &CityMap, places: &Places, kind: AgentKind) -> Result<(), Diagnostic> {
    let (wanted, available) = (set.count(kind), places.count(kind));
    if wanted <= available {
        return Ok(());
    }
    let on_roads = map.network().is_some();
    let (plural, rule) = match kind {
        AgentKind::Car if on_roads => ("cars", "cars start on lanes, at least three cells from their ends"),
        AgentKind::Pedestrian if on_roads => (
            "pedestrians",
            "pedestrians start on sidewalks, which a network has if its lanes are for pedestrians, too",
        ),
        AgentKind::Car => match places.trip_ends() {
            TripEnds::Curb => (
                "cars",
                "cars start at the curb across from a gas station, garage or store",
            ),
            TripEnds::Lane => (
                "cars",
                "cars start on lanes that lead right or down, across from a gas station, garage or store",
            ),
        },
        AgentKind::Pedestrian => ("pedestrians", "pedestrians start beside a house or office"),
    };
    let message = format!(
        "too few start cells for {plural}: {wanted} needed, {available} {}",
        within(set, map)
    );
    let region = part_of_map(set, map);
    let span = region.map_or(set.span, |region| region.span);
    let larger = match region {
        Some(_) => "use a larger region or map",
        None if on_roads => "use a map with more such lanes",
        None => "add such buildings to the map, use a larger map",
    };
    let fewer = match set.repeat {
        0 | 1 => format!("fewer {plural}"),
        _ => "a smaller `repeat`".to_owned(),
    };
    Err(Diagnostic::new(codes::NO_START_CELL, message)
        .at(span, "too small for these agents")
        .note(rule)
        .help(format!("{larger}, or {fewer}")))
}

/// Returns the `no-route` diagnostic of an agent that cannot reach any goal.
fn nowhere(
    set: &AgentSet,
    map: &CityMap,
    places: &Places,
    name: AgentName,
    Cell { row, col }: Cell,
    reason: NoRoute,
) -> Diagnostic {
    let (goal, other) = match (name.kind, places.trip_ends()) {
        (AgentKind::Car, _) if map.network().is_some() => (
            "a car needs a cell of a lane that connections lead to as its goal",
            "connections",
        ),
        (AgentKind::Pedestrian, _) if map.network().is_some() => (
            "a pedestrian needs a sidewalk that it can walk to as its goal",
            "sidewalks or crossings",
        ),
        (AgentKind::Car, TripEnds::Curb) => (
            "a car needs another curb cell as its goal",
            "another gas station, garage or store",
        ),
        (AgentKind::Car, TripEnds::Lane) => (
            "a car needs another lane cell beside a building as its goal",
            "another gas station, garage or store",
        ),
        (AgentKind::Pedestrian, _) => (
            "a pedestrian needs a house or office in another block as its goal",
            "a house or office in a second block",
        ),
    };
    let (span, near, remedy) = match (set.trip, part_of_map(set, map)) {
        (Some(trip), region) => (
            trip.span,
            format!(" by a trip of {} rows and columns", trip.value),
            region.map_or("use a larger trip or map", |_| "use a larger trip, region or map"),
        ),
        (None, Some(region)) => (region.span, String::new(), "use a larger region or map"),
        (None, None) => (set.span, String::new(), "use a larger map"),
    };
    let message = format!(
        "{name} has nowhere to go from [{row}, {col}]{near} {}",
        within(set, map)
    );
    // Without a trip and a region, only the map can lack goals.
    let is_whole_map = set.trip.is_none() && part_of_map(set, map).is_none();
    let help = match (is_whole_map, reason) {
        (true, NoRoute::Goal) => format!("{goal}, and the map has none: add {other} to the map"),
        _ => format!("{goal}: {remedy}"),
    };
    Diagnostic::new(codes::NO_ROUTE, message)
        .at(span, "no reachable goal")
        .help(help)
}

/// A set of the numbers below `count` from which numbers are drawn. The last number of the list replaces the one taken;
/// the map stores only moved numbers.
struct Free {
    count: usize,
    moved: BTreeMap<usize, usize>,
}

impl Free {
    fn new(count: usize) -> Self {
        Free {
            count,
            moved: BTreeMap::new(),
        }
    }

    /// Takes the number at an index of the list, which is less than `count`.
    fn take(&mut self, place: usize) -> usize {
        self.count -= 1;
        let last = self.moved.remove(&self.count).unwrap_or(self.count);
        if place == self.count {
            return last;
        }
        self.moved.insert(place, last).unwrap_or(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_taken_as_from_a_list() {
        let mut list: Vec<usize> = (0..40).collect();
        let mut free = Free::new(list.len());
        let mut stream = Seed(1).stream(Purpose::PLACEMENT, 0, 0);
        while !list.is_empty() {
            assert_eq!(free.count, list.len());
            let place = stream.random_range(0..list.len());
            assert_eq!(free.take(place), list.swap_remove(place));
        }
    }
}
