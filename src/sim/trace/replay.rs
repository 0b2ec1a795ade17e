//! A trace read again: the state of every tick, as facts of a session.

use crate::city::{Action, AgentKind};
use crate::city::{Cell, Heading};
use crate::datalog::Session;
use crate::datalog::Value;
use crate::diag::{Code, Diagnostic};
use crate::predicate::Entity;
use crate::sim::tick::chance::Chance;
use crate::sim::tick::ground::{Facts, ground};
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::simulation::Snapshot;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::world::World;
use crate::sim::trace::writer::{Driven, TRACE_VERSION};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// The header of a trace. README describes the format.
#[derive(Clone, Debug, Deserialize)]
pub struct TraceHeader {
    trace: String,
    version: u32,
    /// Name of the configuration.
    pub config: String,
    /// The file it was read from, as the user named it.
    pub config_file: Option<String>,
    /// Stands for the content of the configuration.
    pub config_hash: String,
    /// Name of the split.
    pub split: String,
    /// Seed of the run.
    pub seed: u64,
    /// The file of the rules.
    pub rules: String,
    /// Stands for the rules and all they include.
    pub rules_hash: String,
    /// The agents in list order.
    pub agents: Vec<TraceAgent>,
}

/// An agent of a [`TraceHeader`].
#[derive(Clone, Debug, Deserialize)]
pub struct TraceAgent {
    /// Its name.
    pub id: String,
    /// Name of its type.
    #[serde(rename = "type")]
    pub kind: String,
    /// Names of its concepts.
    pub concepts: Vec<String>,
    /// Its priority.
    pub priority: i32,
}

/// A tick of a trace.
#[derive(Clone, Debug, Deserialize)]
pub struct TraceTick {
    /// Its number.
    pub tick: u64,
    /// The state and decision of each agent, in the order of the header.
    pub agents: Vec<TraceState>,
    /// The rows of the predicates that were drawn.
    #[serde(default)]
    given: BTreeMap<String, Vec<Vec<String>>>,
}

/// The state and decision of an agent in a [`TraceTick`].
#[derive(Clone, Debug, Deserialize)]
pub struct TraceState {
    /// Row and column.
    pub at: [i32; 2],
    /// Direction of the last move.
    pub heading: Option<String>,
    /// Where it was going.
    pub goal: [i32; 2],
    /// Names of the actions that were derived before the default.
    pub derived: Vec<String>,
    /// Name of the action.
    pub action: String,
    /// The clauses that fired: positions in [`World::clauses`].
    pub clauses: Vec<usize>,
    /// Where it was afterwards.
    pub next: [i32; 2],
    /// If it was driven from outside, what is told of that.
    #[serde(default)]
    pub driven: Option<Driven>,
}

impl TraceState {
    /// The heading.
    ///
    /// # Errors
    /// `invalid-trace`, without a place.
    pub fn heading(&self) -> Result<Option<Heading>, Diagnostic> {
        let named = |name: &String| {
            Heading::from_name(name).ok_or_else(|| invalid(format!("`{name}` is not the name of a heading")))
        };
        self.heading.as_ref().map(named).transpose()
    }

    /// The action.
    ///
    /// # Errors
    /// `invalid-trace`, without a place.
    pub fn action(&self) -> Result<Action, Diagnostic> {
        action_named(&self.action)
    }
}

impl Driven {
    /// The action that the rules wanted.
    ///
    /// # Errors
    /// `invalid-trace`, without a place.
    pub fn wanted(&self) -> Result<Action, Diagnostic> {
        action_named(&self.wanted)
    }
}

fn action_named(name: &str) -> Result<Action, Diagnostic> {
    let known = Action::ALL.into_iter().find(|action| action.name() == name);
    known.ok_or_else(|| invalid(format!("`{name}` is not the name of an action")))
}

fn invalid(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(Code::INVALID_TRACE, message)
}

impl TraceHeader {
    /// Reads the first line of a trace.
    ///
    /// # Errors
    /// `invalid-trace`, without a place.
    pub fn read(line: &str) -> Result<TraceHeader, Diagnostic> {
        let header: TraceHeader =
            serde_json::from_str(line).map_err(|error| invalid(format!("not the header of a trace: {error}")))?;
        if header.trace != "logicity" || header.version != TRACE_VERSION {
            let message = format!(
                "a trace of `{}`, version {}; this program reads `logicity`, version {TRACE_VERSION}",
                header.trace, header.version
            );
            return Err(invalid(message));
        }
        Ok(header)
    }
}

impl TraceTick {
    /// Reads a line of a trace after the first.
    ///
    /// # Errors
    /// `invalid-trace`, without a place.
    pub fn read(line: &str) -> Result<TraceTick, Diagnostic> {
        serde_json::from_str(line).map_err(|error| invalid(format!("not a tick: {error}")))
    }
}

/// The agents of a trace under a world. [`Replay::set`] makes the state of a tick that of the session.
pub struct Replay {
    world: Arc<World>,
    agents: Vec<TraceAgent>,
    kinds: Vec<AgentKind>,
    positions: HashMap<String, usize>,
    state: GroundState,
    facts: Facts,
}

impl Replay {
    /// The agents of `header`, nowhere yet.
    ///
    /// # Errors
    /// `invalid-trace` for an agent that is neither car nor pedestrian, or that is there twice.
    pub fn new(world: Arc<World>, header: &TraceHeader) -> Result<Replay, Diagnostic> {
        let mut kinds = Vec::new();
        let mut positions = HashMap::new();
        for (position, agent) in header.agents.iter().enumerate() {
            let kind = [AgentKind::Car, AgentKind::Pedestrian]
                .into_iter()
                .find(|kind| kind.name() == agent.kind)
                .ok_or_else(|| invalid(format!("`{}` of `{}` is not a type of agent", agent.kind, agent.id)))?;
            kinds.push(kind);
            if positions.insert(agent.id.clone(), position).is_some() {
                return Err(invalid(format!("the agent `{}` is there twice", agent.id)));
            }
        }
        let names = header.agents.iter().map(|agent| agent.id.as_str());
        Ok(Replay {
            state: GroundState::new(&world.program, &world.vocabulary, names),
            agents: header.agents.clone(),
            kinds,
            positions,
            facts: Facts::default(),
            world,
        })
    }

    /// Makes the state on which a tick was decided the state of the session.
    ///
    /// # Errors
    /// `invalid-trace` for a tick that does not fit the header or the map, `limit-exceeded` for rules that derive too much.
    pub fn set(&mut self, tick: &TraceTick) -> Result<(), Diagnostic> {
        if tick.agents.len() != self.agents.len() {
            let (found, expected) = (tick.agents.len(), self.agents.len());
            return Err(invalid(format!(
                "tick {} has {found} agents, not {expected}",
                tick.tick
            )));
        }
        let map = self.world.map();
        let mut entities = Vec::with_capacity(self.agents.len());
        for ((agent, state), &kind) in self.agents.iter().zip(&tick.agents).zip(&self.kinds) {
            let [row, col] = state.at;
            let at = Cell { row, col };
            if !map.contains(at) {
                return Err(invalid(format!("`{}` at [{row}, {col}] is not on the map", agent.id)));
            }
            let heading = state.heading()?;
            entities.push(Entity {
                kind,
                concepts: &agent.concepts,
                priority: agent.priority,
                at,
                heading,
            });
        }
        let vocabulary = &self.world.vocabulary;
        let given = |index: usize| tick.given.get(&vocabulary.predicates[index].name);
        let view = self.world.scenario.view;
        let mut facts = ground(vocabulary, map, view, &entities, &Never, |index| given(index).is_some());
        for (index, predicate) in vocabulary.predicates.iter().enumerate() {
            let Some(rows) = given(index) else { continue };
            for row in rows {
                let places: Option<Vec<u32>> = (row.iter())
                    .map(|name| self.positions.get(name).and_then(|&place| u32::try_from(place).ok()))
                    .collect();
                match places.as_deref() {
                    Some(&[x, y]) if predicate.arity == 2 => facts.rows[index].push([x, y]),
                    Some(&[x]) if predicate.arity == 1 => facts.rows[index].push([x, 0]),
                    _ => return Err(invalid(format!("`{}` does not hold of {row:?}", predicate.name))),
                }
            }
            facts.rows[index].sort_unstable();
            facts.rows[index].dedup();
        }
        (self.state.set(&facts)).map_err(Diagnostic::from)?;
        self.facts = facts;
        Ok(())
    }

    /// The base facts of that state, by the predicates of the vocabulary.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// The state as a whole.
    pub fn snapshot(&self) -> Snapshot<'_> {
        Snapshot {
            world: &self.world,
            state: &self.state,
        }
    }

    /// What the agents are, in the order of the header.
    pub fn kinds(&self) -> &[AgentKind] {
        &self.kinds
    }

    /// What the rules derive from that state.
    pub fn session(&self) -> &Session {
        self.state.session()
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The position of the agent of that name in the header.
    pub fn position(&self, agent: &str) -> Option<usize> {
        self.positions.get(agent).copied()
    }

    /// The value that stands for an agent in the session.
    pub fn value(&self, position: usize) -> Value {
        self.state.value(position)
    }

    /// The actions that hold for an agent, the default where it stands alone left out.
    pub fn derived(&self, position: usize) -> Actions {
        let vocabulary = &self.world.vocabulary;
        vocabulary.before_default(self.state.derived(vocabulary, position))
    }
}

/// Nothing is drawn: the trace has what was.
struct Never;

impl Chance for Never {
    fn happens(&self, _: usize, _: usize, _: usize, _: f64) -> bool {
        false
    }
}
