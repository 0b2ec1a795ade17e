//! The state of an agent that predicates can see, and what a move changes of it.

use crate::city::{Agent, AgentKind, Cell, CityMap, Heading, Junction};
use crate::predicate::Subject;

/// The state of an agent that predicates can see.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AgentState {
    pub at: Cell,
    pub priority: i32,
    /// The position in the list of agents.
    pub agent: u32,
    /// The position in [`Grounder::classes`].
    pub class: u32,
    pub kind: AgentKind,
    pub heading: Option<Heading>,
    /// The junction at its cell.
    pub junction: Junction,
}

/// The part of an agent's state that a move changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Position {
    pub cell: Cell,
    pub heading: Option<Heading>,
}

impl Position {
    pub fn of(agent: &Agent) -> Position {
        Position {
            cell: agent.cell,
            heading: agent.heading,
        }
    }
}

impl AgentState {
    /// Creates the body of an agent, with class 0. `position` is its place in the list.
    pub fn new(map: &CityMap, position: usize, agent: &Agent) -> Self {
        AgentState {
            at: agent.cell,
            priority: agent.priority,
            agent: u32::try_from(position).expect("fewer than 2^32 agents"),
            class: 0,
            kind: agent.kind,
            heading: agent.heading,
            junction: map.junction(agent.cell),
        }
    }

    /// Returns the part that binary predicates read.
    #[inline]
    pub fn subject(&self) -> Subject {
        Subject {
            kind: self.kind,
            priority: self.priority,
            at: self.at,
            heading: self.heading,
        }
    }

    /// Applies a move.
    pub fn shift(&mut self, map: &CityMap, to: Position) {
        self.heading = to.heading;
        if self.at != to.cell {
            self.at = to.cell;
            self.junction = map.junction(to.cell);
        }
    }
}
