//! Reads a trace and restores the state of any tick as facts of a session.

use crate::city::{Action, ActionTable, AgentKind, KindId};
use crate::city::{Cell, Heading};
use crate::datalog::{BaseType, Limits, Session, Value};
use crate::diag::{Diagnostic, json_error};
use crate::predicate::{Entity, Progress, Unit};
use crate::rng::Seed;
use crate::sim::codes;
use crate::sim::tick::chance::{Chance, Draws};
use crate::sim::tick::ground::{Facts, PastRows, ground};
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::simulation::Snapshot;
use crate::sim::tick::vocabulary::{Actions, BasePredicate};
use crate::sim::tick::world::World;
use crate::sim::trace::archive::Archive;
use crate::sim::trace::writer::{Driven, TRACE_VERSION};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// The header of a trace. docs/reference/traces.md describes the format.
#[derive(Clone, Debug, Deserialize)]
pub struct TraceHeader {
    trace: String,
    version: u32,
    /// The name of the configuration.
    pub config: String,
    /// The name of the map.
    #[serde(default)]
    pub map: String,
    /// The hash of the configuration.
    pub config_hash: String,
    /// The name of the split.
    pub split: String,
    /// The seed of the run.
    pub seed: u64,
    /// The name of the rule file.
    pub rules: String,
    /// The hash of the rules and all included files.
    pub rules_hash: String,
    /// The agents in list order.
    pub agents: Vec<TraceAgent>,
    /// The configuration and the rule files. `None` in a trace of version 1.
    #[serde(skip)]
    pub archive: Option<Archive>,
}

/// An agent of a [`TraceHeader`].
#[derive(Clone, Debug, Deserialize)]
pub struct TraceAgent {
    /// The name.
    pub id: String,
    /// The name of the type.
    #[serde(rename = "type")]
    pub kind: String,
    /// The names of the concepts.
    pub concepts: Vec<String>,
    /// The priority.
    pub priority: i32,
}

impl TraceAgent {
    /// Returns the number that selects the instance of its icon, given its position: that in its name, as in pictures of
    /// the run itself.
    pub fn instance(&self, position: usize) -> u32 {
        let number = self.id.rsplit('_').next().and_then(|number| number.parse().ok());
        number.unwrap_or(u32::try_from(position).unwrap_or(0))
    }
}

/// One tick of a trace.
#[derive(Clone, Debug, Deserialize)]
pub struct TraceTick {
    /// The number of the tick.
    pub tick: u64,
    /// The state and decision of each agent, in the order of the header.
    pub agents: Vec<TraceState>,
    /// The rows of the predicates that the states of the agents do not determine: those that hold with a probability,
    /// external ones, quantities with their values, and what temporal operators read of earlier ticks, with the ticks that explain it.
    #[serde(default)]
    given: BTreeMap<String, Vec<Vec<GivenTerm>>>,
}

/// A term of a row in a [`TraceTick`].
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum GivenTerm {
    Name(String),
    Value(i64),
}

/// The state and decision of an agent in a [`TraceTick`].
#[derive(Clone, Debug, Deserialize)]
pub struct TraceState {
    /// Row and column before the move.
    pub at: [i32; 2],
    /// The direction of the last move.
    pub heading: Option<String>,
    /// Row and column of the goal.
    pub goal: [i32; 2],
    /// The names of the derived actions, without the default.
    pub derived: Vec<String>,
    /// The name of the action in effect.
    pub action: String,
    /// The clauses that fired: positions in [`World::clauses`].
    pub clauses: Vec<usize>,
    /// Row and column after the move.
    pub next: [i32; 2],
    /// If the action changed the route: the corners of the rest of the route, from the cell before the move to the
    /// goal.
    #[serde(default)]
    pub route: Option<Vec<[i32; 2]>>,
    /// The entry of an agent that the caller controlled.
    #[serde(default)]
    pub driven: Option<Driven>,
}

impl TraceState {
    /// Parses the heading.
    ///
    /// # Errors
    /// `invalid-trace`, without a source position.
    pub fn heading(&self) -> Result<Option<Heading>, Diagnostic> {
        let named = |name: &String| {
            Heading::from_name(name).ok_or_else(|| invalid(format!("`{name}` is not the name of a heading")))
        };
        self.heading.as_ref().map(named).transpose()
    }

    /// Parses the action, given the actions of the configuration.
    ///
    /// # Errors
    /// `invalid-trace`, without a source position.
    pub fn action(&self, actions: &ActionTable) -> Result<Action, Diagnostic> {
        action_named(&self.action, actions)
    }
}

impl Driven {
    /// Parses the action that the rules chose, given the actions of the configuration.
    ///
    /// # Errors
    /// `invalid-trace`, without a source position.
    pub fn wanted(&self, actions: &ActionTable) -> Result<Action, Diagnostic> {
        action_named(&self.wanted, actions)
    }
}

fn action_named(name: &str, actions: &ActionTable) -> Result<Action, Diagnostic> {
    (actions.find(name)).ok_or_else(|| invalid(format!("`{name}` is not the name of an action")))
}

fn invalid(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::INVALID_TRACE, message)
}

impl TraceHeader {
    /// Parses the first line of a trace, and compares its configuration and rules with their hashes.
    ///
    /// # Errors
    /// `invalid-trace` and `trace-mismatch`, without a source position.
    pub fn read(line: &str) -> Result<TraceHeader, Diagnostic> {
        let not_header =
            |error: serde_json::Error| invalid(format!("not the header of a trace: {}", json_error(&error)));
        let mut header: TraceHeader = serde_json::from_str(line).map_err(not_header)?;
        if header.trace != "logicity" || ![1, TRACE_VERSION].contains(&header.version) {
            let message = format!(
                "a trace of `{}`, version {}; this program reads `logicity`, versions 1 and {TRACE_VERSION}",
                header.trace, header.version
            );
            return Err(invalid(message));
        }
        if header.version > 1 {
            let archive: Archive = serde_json::from_str(line).map_err(not_header)?;
            archive.verify(&header.config, &header.config_hash, &header.rules_hash)?;
            header.archive = Some(archive);
        }
        Ok(header)
    }
}

impl TraceTick {
    /// Parses a line of a trace after the first.
    ///
    /// # Errors
    /// `invalid-trace`, without a source position.
    pub fn read(line: &str) -> Result<TraceTick, Diagnostic> {
        serde_json::from_str(line).map_err(|error| invalid(format!("not a tick: {}", json_error(&error))))
    }
}

/// Returns the limits of an evaluation of one tick by rules that come with its trace: in proportion to the number of
/// pairs of agents, far more than a city needs, and far less than the default of a session.
pub fn trace_limits(agents: usize) -> Limits {
    let usual = Limits::default();
    let pairs = agents.saturating_mul(agents);
    let rows = usual.rows.min(pairs.saturating_mul(100).saturating_add(100_000));
    Limits {
        rows,
        steps: usual.steps.min(100_000_000 + 1000 * rows as u64),
        ..usual
    }
}

/// The agents of a trace in a world. [`Replay::set`] loads the state of a tick into the session.
pub struct Replay {
    world: Arc<World>,
    seed: Seed,
    agents: Vec<TraceAgent>,
    kinds: Vec<AgentKind>,
    positions: HashMap<String, usize>,
    state: GroundState,
    facts: Facts,
}

impl Replay {
    /// Creates a replay of the agents of `header`, without a state.
    ///
    /// # Errors
    /// `invalid-trace` for an agent that is neither car nor pedestrian, or that is listed twice.
    pub fn new(world: Arc<World>, header: &TraceHeader) -> Result<Replay, Diagnostic> {
        let mut kinds = Vec::new();
        let mut positions = HashMap::new();
        for (position, agent) in header.agents.iter().enumerate() {
            let kind = (AgentKind::ALL.into_iter())
                .find(|kind| kind.name() == agent.kind)
                .ok_or_else(|| invalid(format!("`{}` of `{}` is not a type of agent", agent.kind, agent.id)))?;
            kinds.push(kind);
            if positions.insert(agent.id.clone(), position).is_some() {
                return Err(invalid(format!("the header lists the agent `{}` twice", agent.id)));
            }
        }
        let names = header.agents.iter().map(|agent| agent.id.as_str());
        Ok(Replay {
            state: GroundState::new(&world.program, &world.vocabulary, world.limits, names),
            seed: Seed(header.seed),
            agents: header.agents.clone(),
            kinds,
            positions,
            facts: Facts::default(),
            world,
        })
    }

    /// Sets the limits of later evaluations; without this call, they are those of the world.
    pub fn set_limits(&mut self, limits: Limits) {
        self.state.set_limits(limits);
    }

    /// Loads the state on which a tick was decided into the session.
    ///
    /// # Errors
    /// `invalid-trace` for a tick that does not fit the header or the map; `limit-exceeded` if the rules derive too
    /// many rows.
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
                progress: Progress::default(),
            });
        }
        let vocabulary = &self.world.vocabulary;
        let given = |index: usize| tick.given.get(&vocabulary.predicates[index].name);
        let view = self.world.scenario.view;
        let recorded = Recorded(Draws {
            seed: self.seed,
            time: tick.tick,
        });
        let mut facts = ground(vocabulary, map, view, &entities, &recorded, |index| {
            given(index).is_some()
        });
        for (index, predicate) in vocabulary.predicates.iter().enumerate() {
            let Some(rows) = given(index) else { continue };
            let read = rows.iter().map(|row| {
                let faulty = || invalid(format!("{row:?} is not a row of `{}`", predicate.name));
                self.given(row, predicate).ok_or_else(faulty)
            });
            let mut read = read.collect::<Result<Vec<([u32; 2], Option<Value>)>, _>>()?;
            read.sort_unstable();
            read.dedup_by_key(|(row, _)| *row);
            facts.values[index] = read.iter().filter_map(|(_, value)| *value).collect();
            facts.rows[index] = read.into_iter().map(|(row, _)| row).collect();
        }
        let mut externals = vocabulary.externals();
        if let Some((lacking, _)) = externals.find(|(known, _)| !tick.given.contains_key(&known.name)) {
            let message = format!(
                "tick {} does not record the external predicate `{}`",
                tick.tick, lacking.name
            );
            return Err(invalid(message).help("use the configuration of the run"));
        }
        let rules = self.world.program.rules();
        for past in &rules.pasts {
            let hidden = &rules.predicates[past.predicate.index()];
            let Some(rows) = tick.given.get(&hidden.name) else {
                let message = format!(
                    "tick {} does not record `{}`, which the rules read",
                    tick.tick, hidden.name
                );
                return Err(invalid(message).help("use the rules of the run"));
            };
            let read = rows.iter().map(|row| {
                let faulty = || invalid(format!("{row:?} is not a row of `{}`", hidden.name));
                self.given_past(row, hidden.arity()).ok_or_else(faulty)
            });
            let mut read = read.collect::<Result<PastRows, _>>()?;
            read.sort_unstable();
            read.dedup_by_key(|(row, _)| *row);
            facts.past.push(read);
        }
        let set = self.state.set(&facts);
        set.map_err(|error| error.diagnostic(self.world.program.rules()))?;
        self.facts = facts;
        Ok(())
    }

    /// Checks that the rules derive from the loaded state what a tick of the same rules records.
    ///
    /// # Errors
    /// `trace-mismatch`, without a source position.
    pub fn verify(&self, tick: &TraceTick) -> Result<(), Diagnostic> {
        let table = self.world.vocabulary.actions();
        for (position, (agent, state)) in self.agents.iter().zip(&tick.agents).enumerate() {
            let derived = self.derived(position);
            let recorded: Option<Actions> = state.derived.iter().map(|name| table.find(name)).collect();
            // Traces of earlier versions may list the default beside an action of the configuration.
            let kind = Some(self.kind_id(position));
            if recorded.is_some_and(|recorded| self.world.vocabulary.before_default(kind, recorded) == derived) {
                continue;
            }
            let found: Vec<&str> = derived.iter().map(|action| table.name(action)).collect();
            let message = format!(
                "the state of tick {} gives {} [{}], but the trace has [{}]",
                tick.tick,
                agent.id,
                found.join(", "),
                state.derived.join(", ")
            );
            let fault = Diagnostic::new(codes::TRACE_MISMATCH, message);
            return Err(fault.help("the trace was changed after the run; record the run again"));
        }
        Ok(())
    }

    /// Reads a row of a hidden predicate about earlier ticks, with the tick that explains it; `None` if it is none.
    fn given_past(&self, row: &[GivenTerm], arity: usize) -> Option<([u32; 2], u64)> {
        let (tick, agents) = row.split_last()?;
        let GivenTerm::Value(tick) = tick else { return None };
        let mut places = [0; 2];
        for (place, agent) in places.iter_mut().zip(agents) {
            let GivenTerm::Name(name) = agent else { return None };
            *place = u32::try_from(*self.positions.get(name)?).ok()?;
        }
        (agents.len() == arity).then_some((places, u64::try_from(*tick).ok()?))
    }

    /// Reads a row of a predicate; `None` if it is none.
    fn given(&self, row: &[GivenTerm], predicate: &BasePredicate) -> Option<([u32; 2], Option<Value>)> {
        let mut places = [0; 2];
        let (agents, value) = row.split_at_checked(predicate.arity)?;
        for (place, agent) in places.iter_mut().zip(agents) {
            let GivenTerm::Name(name) = agent else { return None };
            *place = u32::try_from(*self.positions.get(name)?).ok()?;
        }
        match (value, predicate.value) {
            ([], None) => Some((places, None)),
            ([GivenTerm::Value(number)], Some(BaseType::Number)) => {
                Some((places, Some(Value::number(i32::try_from(*number).ok()?))))
            }
            ([GivenTerm::Name(name)], Some(BaseType::Symbol)) => {
                let Unit::Word(words) = predicate.definition.unit()? else {
                    return None;
                };
                Some((places, Some(Value(words.find(name)?))))
            }
            _ => None,
        }
    }

    /// Returns the base facts of the state, by the predicates of the vocabulary.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// Returns the state as facts of the session.
    pub fn snapshot(&self) -> Snapshot<'_> {
        Snapshot {
            world: &self.world,
            state: &self.state,
        }
    }

    /// Returns the agents, in the order of the header.
    pub fn agents(&self) -> &[TraceAgent] {
        &self.agents
    }

    /// Returns the kind of the agent at a position, which the configuration may define.
    pub fn kind_id(&self, position: usize) -> KindId {
        let kinds = &self.world.scenario.kinds;
        kinds.of(self.kinds[position], &self.agents[position].concepts)
    }

    /// Returns whether the agents drive or walk, in the order of the header.
    pub fn kinds(&self) -> &[AgentKind] {
        &self.kinds
    }

    /// Returns the session with the state.
    pub fn session(&self) -> &Session {
        self.state.session()
    }

    /// Returns the world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Returns the position in the header of the agent with this name.
    pub fn position(&self, agent: &str) -> Option<usize> {
        self.positions.get(agent).copied()
    }

    /// Returns the value that represents an agent in the session.
    pub fn value(&self, position: usize) -> Value {
        self.state.value(position)
    }

    /// Returns, for each agent, the clauses that derive an action for it: positions in [`World::clauses`].
    pub fn fired(&self) -> Vec<Vec<usize>> {
        let mut fired = vec![Vec::new(); self.agents.len()];
        let deriving = self.world.clause_actions().enumerate();
        for (position, (clause, _)) in deriving.filter(|(_, (_, action))| action.is_some()) {
            for row in self.state.session().fired(clause) {
                if let Some(agent) = row.first().and_then(|value| self.state.entity(*value))
                    && fired[agent].last() != Some(&position)
                {
                    fired[agent].push(position);
                }
            }
        }
        fired
    }

    /// Returns the derived actions of an agent, without the default.
    pub fn derived(&self, position: usize) -> Actions {
        let vocabulary = &self.world.vocabulary;
        let kind = Some(self.kind_id(position));
        vocabulary.before_default(kind, self.state.derived(vocabulary, position))
    }
}

/// The draws of a tick whose trace records the rows of predicates with a probability.
struct Recorded(Draws);

impl Chance for Recorded {
    fn tick(&self) -> u64 {
        self.0.time
    }

    fn word(&self) -> u64 {
        self.0.word()
    }

    fn happens(&self, _: usize, _: usize, _: usize, _: f64) -> bool {
        false
    }
}
