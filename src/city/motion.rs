//! Movement: turns an action into a move.

use crate::city::{Action, ActionTable, Effect};
use crate::city::{Agent, Cell, Places, Rest, Router};
use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// An agent's new goal; index: agent.
    pub const GOAL: Purpose = Purpose::new(3);

    /// The choice among several possible moves; index: agent.
    pub const MOVE: Purpose = Purpose::new(4);
}

/// Returns the maximum number of cells that an agent can move with these actions; all smaller positive numbers are
/// possible, too.
///
/// A move is straight, or follows a lane of a road network, and jumps over no node of the road graph, so that cars always
/// land on the lines where intersections begin and end. 0 at the goal.
pub fn possible_cells(agent: &Agent, actions: &ActionTable) -> usize {
    let most = actions.reach(agent.kind_id);
    agent.free_ahead(most).min(most)
}

/// The reason for an agent's move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum MoveReason {
    /// The move follows the decision.
    Decided,
    /// The route allows no other move.
    OnlyMove,
    /// The route allows several moves, but not the decided one, so the move is drawn at random.
    Drawn,
    /// The agent rests at its goal or cannot reach another.
    Resting,
    /// The agent is parked, by the decision of this tick or of an earlier one.
    Parked,
}

/// The move of an agent in a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moved {
    /// The cell before the move.
    pub from: Cell,
    /// The cell after the move.
    pub to: Cell,
    /// The reason.
    pub reason: MoveReason,
    /// Whether the agent set out for a new goal.
    pub replanned: bool,
    /// Whether the decision changed its route to the same goal.
    pub rerouted: bool,
}

impl Moved {
    /// Returns the number of cells of the move, which never turns back.
    pub fn cells(&self) -> u32 {
        self.from.row.abs_diff(self.to.row) + self.from.col.abs_diff(self.to.col)
    }
}

/// The surroundings in which agents move.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The router that plans new routes.
    pub router: &'a Router,
    /// The candidates for new goals.
    pub places: &'a Places,
    /// The actions.
    pub actions: &'a ActionTable,
    /// The seed of the run.
    pub seed: Seed,
    /// The number of the tick, from 0.
    pub tick: u64,
}

/// Moves an agent for one tick according to its decided action. `index` is its position in the list of agents and
/// selects its random streams.
///
/// An agent at its goal rests for two ticks, whatever the decision. In the third it draws a new goal, clears its
/// heading and follows the decision of that tick on the new route. If it can reach no other goal, it stays and tries
/// again in the next tick.
///
/// The effect of an action comes before its move. It applies only to an agent under way.
// Inlined so that the compiler writes the result, which is larger than a register, in place.
#[inline]
pub fn advance(agent: &mut Agent, index: usize, decided: Action, surroundings: &Surroundings<'_>) -> Moved {
    let from = agent.cell;
    let resting = Moved {
        from,
        to: from,
        reason: MoveReason::Resting,
        replanned: false,
        rerouted: false,
    };
    if agent.is_parked() {
        agent.parked -= 1;
        agent.record(0);
        return Moved {
            reason: MoveReason::Parked,
            ..resting
        };
    }
    let mut replanned = false;
    if agent.at_goal() {
        match agent.rest {
            Rest::UnderWay => agent.rest = Rest::Arrived,
            Rest::Arrived => agent.rest = Rest::Rested,
            Rest::Rested => replanned = replan(agent, index, surroundings),
        }
        if !replanned {
            agent.record(0);
            return resting;
        }
    }
    let mut rerouted = false;
    if !decided.is_standard() {
        rerouted = affect(agent, decided, surroundings);
        if agent.is_parked() {
            agent.parked -= 1;
            agent.record(0);
            return Moved {
                reason: MoveReason::Parked,
                replanned,
                ..resting
            };
        }
    }
    let actions = surroundings.actions;
    let (cells, reason) = choose(agent, decided, actions, |most| draw_cells(most, index, surroundings));
    agent.step(cells);
    agent.record(cells);
    Moved {
        from,
        to: agent.cell,
        reason,
        replanned,
        rerouted,
    }
}

/// Applies the effect of a decision. Returns whether it changed the route.
#[inline(never)]
fn affect(agent: &mut Agent, decided: Action, surroundings: &Surroundings<'_>) -> bool {
    if !surroundings.actions.can_take(agent.kind_id, decided) {
        return false;
    }
    let route = match surroundings.actions.effect(decided) {
        None => None,
        Some(Effect::Turn(turn)) => surroundings.router.turn(agent, turn),
        Some(Effect::ChangeLane(side)) => surroundings.router.change_lane(agent, side),
        Some(Effect::Reroute) => surroundings.router.reroute(agent),
        Some(Effect::Park(ticks)) => {
            (agent.parked, agent.parked_by) = (ticks, decided);
            None
        }
    };
    let changed = route.filter(|route| !route.cells().eq(agent.route().cells().skip(agent.position())));
    changed.map(|route| agent.change_route(route)).is_some()
}

/// Sets out for a new goal; returns whether there is a reachable one. Not inlined, to keep the common moves short.
#[inline(never)]
fn replan(agent: &mut Agent, index: usize, surroundings: &Surroundings<'_>) -> bool {
    let mut stream = (surroundings.seed).stream(Purpose::GOAL, index as u64, surroundings.tick);
    let route = (surroundings.places).draw_route(surroundings.router, agent.kind, agent.cell, &mut stream);
    route.map(|route| agent.set_out(route)).is_ok()
}

/// Draws a number of cells from 1 to `most`.
#[inline(never)]
fn draw_cells(most: usize, index: usize, surroundings: &Surroundings<'_>) -> usize {
    let mut stream = (surroundings.seed).stream(Purpose::MOVE, index as u64, surroundings.tick);
    stream.random_range(1..=most)
}

/// Returns the number of cells to move: the decided number if the route allows it, else the only possible one, else the
/// result of `draw`, which chooses from 1 to its argument.
fn choose(
    agent: &Agent,
    decided: Action,
    actions: &ActionTable,
    draw: impl FnOnce(usize) -> usize,
) -> (usize, MoveReason) {
    if decided == Action::Stop {
        return (0, MoveReason::Decided);
    }
    let most = possible_cells(agent, actions);
    match actions.speed_cells(agent.kind_id, decided) {
        Some(cells) if cells <= most => (cells, MoveReason::Decided),
        _ if most <= 1 => (most, MoveReason::OnlyMove),
        _ => (draw(most), MoveReason::Drawn),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::generate::tests::square;
    use crate::city::{AgentConfig, AgentKind, AgentName, Routing, TripEnds};
    use std::sync::Arc;

    /// A car that leaves the curb, stops at the node at the end of its lane, and turns right behind it.
    fn car() -> Agent {
        let router = Router::new(Arc::new(square([2, 2])), Routing::Weighted);
        let goal = Cell::new(64, 46);
        let route = router
            .plan(AgentKind::Car, Cell::new(56, 36), goal)
            .expect("a way around the block");
        let config = AgentConfig {
            name: AgentName::standard(AgentKind::Car, 1),
            concepts: Arc::default(),
            priority: 1,
        };
        Agent::new(&config, route)
    }

    #[test]
    fn a_move_ends_before_a_turn_and_on_a_node() {
        let mut car = car();
        // Three cells from the curb to the lane, five along it to its end at column 41, then on into the intersection.
        let mut seen = Vec::new();
        while car.cell.col < 45 {
            seen.push((
                car.cell.row,
                car.cell.col,
                possible_cells(&car, &ActionTable::default()),
            ));
            car.step(1);
        }
        let expected = [
            (56, 36, 3),
            (55, 36, 2),
            (54, 36, 1),
            (53, 36, 3),
            (53, 37, 3),
            (53, 38, 3),
            (53, 39, 2),
            (53, 40, 1),
            (53, 41, 3),
            (53, 42, 3),
            (53, 43, 3),
            (53, 44, 3),
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn the_decision_counts_if_the_route_allows_it() {
        let mut car = car();
        let chosen = |car: &Agent, decided| choose(car, decided, &ActionTable::default(), |most| most - 1);
        assert_eq!(chosen(&car, Action::Fast), (3, MoveReason::Decided));
        assert_eq!(chosen(&car, Action::Stop), (0, MoveReason::Decided));
        car.step(1);
        assert_eq!(chosen(&car, Action::Normal), (2, MoveReason::Decided));
        assert_eq!(chosen(&car, Action::Fast), (1, MoveReason::Drawn));
        car.step(1);
        assert_eq!(chosen(&car, Action::Slow), (1, MoveReason::Decided));
        assert_eq!(chosen(&car, Action::Fast), (1, MoveReason::OnlyMove));
    }

    #[test]
    fn an_agent_without_another_goal_stays() {
        let router = Router::new(Arc::new(square([1, 1])), Routing::Weighted);
        let places = Places::new(&router, TripEnds::Curb, Some(0), None);
        let mut car = car();
        while !car.at_goal() {
            car.step(1);
        }
        for tick in 0..5 {
            let surroundings = Surroundings {
                router: &router,
                places: &places,
                actions: &ActionTable::default(),
                seed: Seed(1),
                tick,
            };
            let moved = advance(&mut car, 0, Action::Fast, &surroundings);
            assert_eq!(
                (moved.reason, moved.to, moved.replanned),
                (MoveReason::Resting, car.goal(), false)
            );
        }
        assert_eq!(car.rest, Rest::Rested);
    }
}
