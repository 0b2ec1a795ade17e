//! Agents, and where they start and want to go.

use crate::cancel::Cancel;
use crate::city::{AgentConfig, AgentKind, AgentName, AgentSet};
use crate::city::{Cell, Heading, Places, Route, Router};
use crate::diag::{Code, Diagnostic};
use crate::rng::{Purpose, RngExt, Seed};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Purpose {
    /// First start and goal; index: agent.
    pub const PLACEMENT: Purpose = Purpose::new(2);
}

/// An agent on its way.
#[derive(Clone, Debug)]
pub struct Agent {
    /// What it is.
    pub kind: AgentKind,
    /// Its number within the kind, from 1.
    pub number: u32,
    /// The concepts it carries, which agents that are alike share.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
    /// Where it is.
    pub cell: Cell,
    /// The direction of its last move; none before its first move on a route.
    pub heading: Option<Heading>,
    /// Whether it rests at its goal.
    pub rest: Rest,
    /// The direction of the next step; of the last one at the goal.
    ahead: Heading,
    /// Steps to the end of the piece of the route that it is on; 0 at the goal only.
    left: u32,
    /// The piece of the route after that.
    next: u32,
    /// How many steps of the route it has gone.
    position: u32,
    /// The way it takes. It changes only through [`Agent::set_out`].
    route: Route,
}

/// The stages of an agent's stay at its goal: under way, arrived, rested. In the tick after that it sets out for a new goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rest {
    /// Under way; also in the first tick at the goal, before it stops there.
    #[default]
    UnderWay,
    /// Has stopped at the goal for one tick.
    Arrived,
    /// Has stopped for two ticks; sets out in this one.
    Rested,
}

impl Agent {
    /// An agent at the start of a route.
    pub fn new(config: &AgentConfig, route: Route) -> Self {
        Agent::with(config.name, &config.concepts, config.priority, route)
    }

    fn with(name: AgentName, concepts: &Arc<[String]>, priority: i32, route: Route) -> Self {
        let mut agent = Agent {
            kind: name.kind,
            number: name.number,
            concepts: Arc::clone(concepts),
            priority,
            cell: route.start(),
            heading: None,
            rest: Rest::UnderWay,
            ahead: Heading::Left,
            left: 0,
            next: 0,
            position: 0,
            route,
        };
        agent.next_piece();
        agent
    }

    /// Its name, for example `Car_1`.
    pub fn name(&self) -> AgentName {
        AgentName {
            kind: self.kind,
            number: self.number,
        }
    }

    /// Starts a new route: the agent is put at its start, without a heading.
    pub fn set_out(&mut self, route: Route) {
        self.cell = route.start();
        self.heading = None;
        self.route = route;
        (self.left, self.next, self.position) = (0, 0, 0);
        self.rest = Rest::UnderWay;
        self.next_piece();
    }

    /// Goes on to the next piece of the route, if there is one.
    fn next_piece(&mut self) {
        if let Some(piece) = self.route.piece(self.next) {
            self.ahead = piece.heading();
            self.left = piece.steps();
            self.next += 1;
        }
    }

    /// The route.
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// The direction of its next step; of the last one at the goal.
    pub fn ahead(&self) -> Heading {
        self.ahead
    }

    /// How far it has come: its position among the cells of the route, from 0.
    pub fn position(&self) -> usize {
        self.position as usize
    }

    /// Where the route starts.
    pub fn start(&self) -> Cell {
        self.route.start()
    }

    /// Where the route ends.
    pub fn goal(&self) -> Cell {
        self.route.goal()
    }

    /// Whether it is at its goal.
    pub fn at_goal(&self) -> bool {
        self.left == 0
    }

    /// Steps straight ahead on the route, up to the next corner, node of the road graph, or the goal.
    pub(super) fn straight_ahead(&self) -> usize {
        self.left as usize
    }

    /// Moves along the route, at most [`Agent::straight_ahead`] steps.
    pub(super) fn step(&mut self, cells: usize) {
        let cells = u32::try_from(cells).unwrap_or(u32::MAX).min(self.left);
        if cells == 0 {
            return;
        }
        self.cell = self.cell.ahead(self.ahead, cells.cast_signed());
        self.heading = Some(self.ahead);
        self.position += cells;
        self.left -= cells;
        if self.left == 0 {
            self.next_piece();
        }
    }
}

/// Places a set of agents on the map: different start cells, a goal and a route for each. (In runs of the published program two
/// agents may start in one cell; that needs given routes, see [`Agent::new`].)
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
        check_room(set, places, kind)?;
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
        let route =
            (places.draw_route(router, name.kind, start, &mut stream)).map_err(|_| nowhere(set, name, start))?;
        match agents.get_mut(index) {
            Some(agent) => {
                agent.kind = name.kind;
                agent.number = name.number;
                agent.priority = group.priority;
                // Counting who shares them is dear, and mostly they are what they were.
                if !Arc::ptr_eq(&agent.concepts, &group.concepts) {
                    agent.concepts = Arc::clone(&group.concepts);
                }
                agent.set_out(route);
            }
            None => agents.push(Agent::with(name, &group.concepts, group.priority, route)),
        }
        count += 1;
    }
    agents.truncate(count);
    Ok(())
}

/// Where the agents of a set start.
fn within(set: &AgentSet) -> String {
    set.region.map_or_else(
        || "on the whole map".to_string(),
        |region| format!("in the first {} rows and columns", region.value),
    )
}

/// `no-start-cell` if there are fewer places than agents of a kind.
fn check_room(set: &AgentSet, places: &Places, kind: AgentKind) -> Result<(), Diagnostic> {
    let (wanted, there_are) = (set.count(kind), places.count(kind));
    if wanted <= there_are {
        return Ok(());
    }
    let (plural, beside) = match kind {
        AgentKind::Car => (
            "cars",
            "cars start at the kerb across from a gas station, garage or store",
        ),
        AgentKind::Pedestrian => ("pedestrians", "pedestrians start beside a house or office"),
    };
    let message = format!(
        "too few start cells for {plural}: {wanted} wanted, {there_are} {}",
        within(set)
    );
    let span = set.region.map_or(set.span, |region| region.span);
    let larger = set.region.map_or("map", |_| "region or map");
    let fewer = match set.repeat {
        0 | 1 => format!("fewer {plural}"),
        _ => "a smaller `repeat`".to_owned(),
    };
    Err(Diagnostic::new(Code::NO_START_CELL, message)
        .at(span, "too small for these agents")
        .note(beside)
        .help(format!("take a larger {larger}, or {fewer}")))
}

/// `no-route`: an agent that can go nowhere from its start.
fn nowhere(set: &AgentSet, name: AgentName, Cell { row, col }: Cell) -> Diagnostic {
    let goal = match name.kind {
        AgentKind::Car => "a car needs another kerb cell to go to",
        AgentKind::Pedestrian => "a pedestrian goes to a house or office in another block",
    };
    let (span, near, larger) = match (set.trip, set.region) {
        (Some(trip), _) => (
            trip.span,
            format!(" by a trip of {} rows and columns", trip.value),
            "trip, region or map",
        ),
        (None, Some(region)) => (region.span, String::new(), "region or map"),
        (None, None) => (set.span, String::new(), "region or map"),
    };
    let message = format!("{name} has nowhere to go from [{row}, {col}]{near} {}", within(set));
    Diagnostic::new(Code::NO_ROUTE, message)
        .at(span, "no goal that can be reached")
        .help(format!("{goal}: take a larger {larger}"))
}

/// A list of the numbers below a count, from which numbers are taken; the last one moves to where one was taken. What was not
/// moved is not stored.
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

    /// Takes the number at a place in the list, which is less than the count.
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
