//! What a picture is told of an agent.

use crate::city::{Action, AgentKind};
use crate::city::{Agent, Cell};
use crate::render::class::{Class, Facing};

/// What a picture shows of an agent.
#[derive(Clone, Copy, Debug)]
pub struct Sprite<'a> {
    /// Its name. `Car_12` is labelled `C12`, `Pedestrian_3` is labelled `P3`; any other name labels itself, shortened.
    pub name: &'a str,
    /// What it is.
    pub kind: AgentKind,
    /// Its concepts, for example `ambulance`; all of them show.
    pub concepts: &'a [String],
    /// Where it is. An agent off the map is not drawn.
    pub at: Cell,
    /// Where it faces.
    pub facing: Facing,
    /// Which instance of its class it is shown as.
    pub instance: u32,
    /// What it decided; `None` if nothing yet. Only an [`Overview`](super::Overview) shows it.
    pub action: Option<Action>,
}

impl<'a> Sprite<'a> {
    /// An agent as it is, its name, and what it decided. It faces as it came; where its route turns, halfway to where it goes on, and it
    /// stays so while it stops there. Its number says which instance shows it.
    pub fn of(agent: &'a Agent, name: &'a str, action: Option<Action>) -> Sprite<'a> {
        Sprite {
            name,
            kind: agent.kind,
            concepts: &agent.concepts,
            at: agent.cell,
            facing: Facing::turning(agent.heading.unwrap_or(agent.ahead()), agent.ahead()),
            instance: agent.number,
            action,
        }
    }

    /// What it is shown as.
    pub fn class(&self) -> Class {
        Class::agent(self.kind, self.concepts)
    }
}
