//! The agents of the pictures of a run: from a running city, or from a trace.

use crate::city::{Action, AgentKind, Cell, Heading};
use crate::diag::Diagnostic;
use crate::render::{Facing, Sprite};
use crate::sim::{Replay, Simulation, TraceHeader, TraceTick};

/// What never changes of an agent in pictures.
pub struct Drawn {
    pub name: String,
    kind: AgentKind,
    /// The name of its kind, if the configuration defines it.
    kind_name: Option<String>,
    /// The concepts that its icon shows.
    shown: Vec<String>,
    instance: u32,
}

impl Drawn {
    /// Returns the agents of a running city.
    pub fn of_city(city: &Simulation) -> Vec<Drawn> {
        let kinds = &city.world().scenario.kinds;
        let agents = city.agents().iter().map(|agent| Drawn {
            name: agent.name().to_string(),
            kind: agent.kind,
            kind_name: (!agent.kind_id.is_standard()).then(|| agent.name().kind_name().to_owned()),
            shown: kinds.shown(agent.kind, &agent.concepts).into_owned(),
            instance: agent.number,
        });
        agents.collect()
    }

    /// Returns the agents of a trace.
    pub fn of_trace(header: &TraceHeader, replay: &Replay) -> Vec<Drawn> {
        let kinds = &replay.world().scenario.kinds;
        let agents = (header.agents.iter().zip(replay.kinds()).enumerate()).map(|(position, (agent, &kind))| {
            let own = kinds.of(kind, &agent.concepts);
            Drawn {
                name: agent.id.clone(),
                kind,
                kind_name: (!own.is_standard()).then(|| kinds.name(own).to_owned()),
                shown: kinds.shown(kind, &agent.concepts).into_owned(),
                instance: agent.instance(position),
            }
        });
        agents.collect()
    }
}

/// What changes of a picture from tick to tick: as in the trace, the state before the tick, and the actions that it chooses.
#[derive(Clone)]
pub struct Frame {
    pub tick: u64,
    /// Place, facing and action of each agent.
    pub agents: Vec<(Cell, Facing, Option<Action>)>,
}

impl Frame {
    /// Returns the state before the next tick, without actions.
    pub fn before(city: &Simulation) -> Frame {
        let agents = city.agents().iter().map(|agent| {
            let sprite = Sprite::of(agent, "", None);
            (sprite.at, sprite.facing, None)
        });
        Frame {
            tick: city.now(),
            agents: agents.collect(),
        }
    }

    /// Adds the actions of the tick, which is over.
    pub fn decide(&mut self, city: &Simulation) {
        for ((.., action), done) in self.agents.iter_mut().zip(&city.report().agents) {
            *action = Some(done.action);
        }
    }

    /// Returns the states and actions of ticks. An agent that turns in its next move faces halfway, as far as the ticks
    /// show that move.
    pub fn of_trace(ticks: &[TraceTick], replay: &Replay) -> Result<Vec<Frame>, Diagnostic> {
        let table = replay.world().vocabulary.actions();
        let mut ahead: Vec<Option<Heading>> = vec![None; replay.kinds().len()];
        let frames = ticks.iter().rev().map(|tick| {
            let agents = tick.agents.iter().zip(&mut ahead).map(|(state, ahead)| {
                let heading = state.heading()?;
                let moved = direction(state.at, state.next);
                // A move around a corner begins straight on.
                *ahead = match state.at == state.next {
                    true => *ahead,
                    false => moved.or(heading),
                };
                let from = heading.or(*ahead).unwrap_or(Heading::Up);
                let facing = Facing::turning(from, ahead.unwrap_or(from));
                Ok((Cell::new(state.at[0], state.at[1]), facing, Some(state.action(table)?)))
            });
            Ok(Frame {
                tick: tick.tick,
                agents: agents.collect::<Result<_, Diagnostic>>()?,
            })
        });
        let mut frames: Vec<Frame> = frames.collect::<Result<_, Diagnostic>>()?;
        frames.reverse();
        Ok(frames)
    }

    /// Returns the agents as sprites.
    pub fn sprites<'a>(&self, drawn: &'a [Drawn]) -> Vec<Sprite<'a>> {
        let agents = drawn.iter().zip(&self.agents);
        agents
            .map(|(drawn, &(at, facing, action))| Sprite {
                name: &drawn.name,
                kind: drawn.kind,
                kind_name: drawn.kind_name.as_deref(),
                concepts: &drawn.shown,
                at,
                facing,
                instance: drawn.instance,
                framing: None,
                action,
            })
            .collect()
    }
}

/// Returns the direction of a move along a row or a column.
fn direction(from: [i32; 2], to: [i32; 2]) -> Option<Heading> {
    match [(to[0] - from[0]).signum(), (to[1] - from[1]).signum()] {
        [-1, 0] => Some(Heading::Up),
        [1, 0] => Some(Heading::Down),
        [0, -1] => Some(Heading::Left),
        [0, 1] => Some(Heading::Right),
        _ => None,
    }
}
