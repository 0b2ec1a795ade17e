//! The tick: all agents decide on the same state, then all move.

use super::ground::{Entity, Facts, ground};
use super::infer::{Draws, GroundState, before_default};
use super::scene::MAX_ENTITIES;
use super::world::World;
use crate::city::{Agent, Cell, Heading, Moved, Places, Surroundings, advance, place_agents};
use crate::config::{Speed, Split};
use crate::diag::{Code, Diagnostic};
use crate::engine::{EvalError, Session};
use crate::lang::{ClauseId, Value};
use crate::rng::Seed;
use ndarray::Array3;
use std::sync::Arc;

/// A city in motion. The same world, split and seed give the same ticks.
pub struct Simulation {
    world: Arc<World>,
    split: Split,
    places: Places,
    seed: Seed,
    tick: u64,
    agents: Vec<Agent>,
    state: GroundState,
    facts: Facts,
    /// The clauses whose firings are counted: all with a body, hidden ones left out.
    clauses: Vec<ClauseId>,
}

/// What happened in a tick.
#[derive(Clone, Debug)]
pub struct TickReport {
    /// Number of the tick, from 0.
    pub tick: u64,
    /// What each agent decided and did, in list order.
    pub agents: Vec<AgentTick>,
    /// How many rows each counted clause derived, in the order of [`Simulation::clauses`].
    pub firings: Vec<usize>,
}

/// The tick of one agent: the state it was judged on, what the rules decided, what it did.
#[derive(Clone, Debug)]
pub struct AgentTick {
    /// Where it was.
    pub at: Cell,
    /// Its heading.
    pub heading: Option<Heading>,
    /// Where it was bound for.
    pub goal: Cell,
    /// The actions derived before the default.
    pub derived: Vec<Speed>,
    /// The action decided on: the rules' own, or the one given from outside.
    pub action: Speed,
    /// The action clauses that fired for it: positions in [`Simulation::clauses`].
    pub clauses: Vec<usize>,
    /// What it did.
    pub moved: Moved,
}

impl Simulation {
    /// Places the agents of a split.
    ///
    /// # Errors
    /// `unknown-split`, `no-start-cell`, `no-route`; `limit-exceeded` for more than [`MAX_ENTITIES`] agents, since facts about pairs of
    /// them take memory in the square of their number.
    pub fn new(world: Arc<World>, split: Split, seed: Seed) -> Result<Simulation, Diagnostic> {
        let scenario = &world.scenario;
        let set = scenario.agent_set(split).ok_or_else(|| {
            let message = format!("the configuration `{}` has no split `{}`", scenario.name, split.name());
            let known: Vec<&str> = scenario.splits.iter().map(|(split, _)| split.name()).collect();
            Diagnostic::new(Code::UnknownSplit, message).help(format!("it has: {}", known.join(", ")))
        })?;
        if set.len() > MAX_ENTITIES {
            let message = format!("{} agents, the limit is {MAX_ENTITIES}", set.len());
            let fault = Diagnostic::new(Code::LimitExceeded, message);
            return Err(fault.at(set.span, "in this agent set"));
        }
        let places = Places::new(
            &world.router,
            set.region.map(|region| region.value),
            set.trip.map(|trip| trip.value),
        );
        let agents = place_agents(set, &world.router, &places, seed)?;
        let names: Vec<String> = agents.iter().map(|agent| agent.name().to_string()).collect();
        let state = GroundState::new(&world.program, &world.vocabulary, names.iter().map(String::as_str));
        let rules = world.program.rules();
        let counted = |clause: &ClauseId| {
            let clause = &rules.clauses[clause.index()];
            !clause.body.is_empty() && !rules.relations[clause.head.relation.index()].hidden
        };
        let clauses = (0..rules.clauses.len())
            .map(|index| ClauseId(u32::try_from(index).expect("fewer than 2^32 clauses")))
            .filter(counted)
            .collect();
        Ok(Simulation {
            split,
            places,
            seed,
            tick: 0,
            agents,
            state,
            facts: Facts::default(),
            clauses,
            world,
        })
    }

    /// What does not change.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The split the agents are of.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The seed of the run.
    pub fn seed(&self) -> Seed {
        self.seed
    }

    /// The agents in list order, as they are now.
    pub fn agents(&self) -> &[Agent] {
        &self.agents
    }

    /// The layered semantic map of the present state; [`CityMap::semantic`] documents shape and layers.
    ///
    /// [`CityMap::semantic`]: crate::city::CityMap::semantic
    pub fn semantic_map(&self) -> Array3<f32> {
        let cells: Vec<Cell> = self.agents.iter().map(|agent| agent.cell).collect();
        self.world.map().semantic(&cells)
    }

    /// How many ticks have passed.
    pub fn now(&self) -> u64 {
        self.tick
    }

    /// The base facts on which the last tick was decided.
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// What the rules derived from those facts.
    pub fn session(&self) -> &Session {
        self.state.session()
    }

    /// The value that stands for an agent, by its position in the list, in the session.
    pub fn value(&self, agent: usize) -> Value {
        self.state.value(agent)
    }

    /// The position in the list of the agent that a value of the session stands for.
    pub fn agent(&self, value: Value) -> Option<usize> {
        self.state.entity(value)
    }

    /// The clauses whose firings are counted, in the order of the text.
    pub fn clauses(&self) -> &[ClauseId] {
        &self.clauses
    }

    /// Lets every agent decide and move. `controls` replaces the decision of the agents it names (by position in the list).
    ///
    /// # Errors
    /// Rules that derive more than the engine's limit. The city is then as before.
    pub fn tick(&mut self, controls: &[(usize, Speed)]) -> Result<TickReport, EvalError> {
        let world = &*self.world;
        let entities: Vec<Entity<'_>> = self.agents.iter().map(entity).collect();
        let mut draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        let vocabulary = &world.vocabulary;
        let unread = |index: usize| index != vocabulary.sees && vocabulary.predicates[index].relation.is_none();
        let facts = ground(
            vocabulary,
            world.map(),
            world.scenario.view,
            &entities,
            &mut draws,
            unread,
        );
        self.state.set(&facts)?;
        self.facts = facts;

        let (firings, mut clauses) = self.count_firings();

        let surroundings = Surroundings {
            router: &world.router,
            places: &self.places,
            seed: self.seed,
            tick: self.tick,
        };
        let mut agents = Vec::with_capacity(self.agents.len());
        for (index, agent) in self.agents.iter_mut().enumerate() {
            let derived = self.state.derived(vocabulary, index);
            let control = controls.iter().rev().find(|(controlled, _)| *controlled == index);
            let action = control.map_or_else(|| vocabulary.decide(&derived), |(_, action)| *action);
            agents.push(AgentTick {
                at: agent.cell,
                heading: agent.heading,
                goal: agent.goal(),
                derived: before_default(vocabulary, derived),
                action,
                clauses: std::mem::take(&mut clauses[index]),
                moved: advance(agent, index, action, &surroundings),
            });
        }
        let report = TickReport {
            tick: self.tick,
            agents,
            firings,
        };
        self.tick += 1;
        Ok(report)
    }

    /// How many rows each clause derives, and for each agent the clauses of actions that fired for it.
    fn count_firings(&self) -> (Vec<usize>, Vec<Vec<usize>>) {
        let rules = self.world.program.rules();
        let mut fired_for = vec![Vec::new(); self.agents.len()];
        let mut firings = Vec::with_capacity(self.clauses.len());
        for (index, &clause) in self.clauses.iter().enumerate() {
            let rows = self.state.session().fired(clause);
            let head = rules.clauses[clause.index()].head.relation;
            if Speed::ALL
                .into_iter()
                .any(|speed| self.world.vocabulary.action(speed) == Some(head))
            {
                for agent in rows.iter().filter_map(|row| self.state.entity(row[0])) {
                    fired_for[agent].push(index);
                }
            }
            firings.push(rows.len());
        }
        (firings, fired_for)
    }
}

fn entity(agent: &Agent) -> Entity<'_> {
    Entity {
        kind: agent.kind,
        concepts: &agent.concepts,
        priority: agent.priority,
        at: agent.cell,
        heading: agent.heading,
    }
}
