//! The description of an agent for pictures.

use crate::city::{Action, AgentKind};
use crate::city::{Agent, Cell};
use crate::render::class::{Class, Facing};
use crate::render::framing::Framing;

/// An agent as a picture shows it.
#[derive(Clone, Copy, Debug)]
pub struct Sprite<'a> {
    /// Name. The label is `C12` for `Car_12`, `P3` for `Pedestrian_3`, `Cyc3` for `Cyclist_3`, else the shortened name.
    pub name: &'a str,
    /// Agent type.
    pub kind: AgentKind,
    /// The name of its kind in the legend; `None` for the name of its class.
    pub kind_name: Option<&'a str>,
    /// Concepts, for example `ambulance`; all of them show.
    pub concepts: &'a [String],
    /// Cell. Pictures omit agents off the map.
    pub at: Cell,
    /// Facing.
    pub facing: Facing,
    /// Instance of the class.
    pub instance: u32,
    /// How a picture shows the agent; `None` shows it in its usual size, with a box that fits.
    pub framing: Option<Framing>,
    /// Action, `None` before the first decision. Only an [`Overview`](super::Overview) shows it.
    pub action: Option<Action>,
}

impl<'a> Sprite<'a> {
    /// Returns the sprite of an agent with its name and action. The agent faces along its last move; where its route
    /// turns, it faces halfway between both headings, also while it waits there. Its number selects the instance.
    pub fn of(agent: &'a Agent, name: &'a str, action: Option<Action>) -> Sprite<'a> {
        Sprite {
            name,
            kind: agent.kind,
            kind_name: None,
            concepts: &agent.concepts,
            at: agent.cell,
            facing: Facing::turning(agent.heading.unwrap_or(agent.ahead()), agent.ahead()),
            instance: agent.number,
            framing: None,
            action,
        }
    }

    /// Returns the class of its icon.
    pub fn class(&self) -> Class {
        Class::agent(self.kind, self.concepts)
    }
}
