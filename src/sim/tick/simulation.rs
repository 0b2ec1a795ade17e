//! The tick: all agents decide on the same state, then all move.

use crate::cancel::Cancel;
use crate::city::{Action, AgentSet, Split};
use crate::city::{Agent, Cell, CityMap, Heading, MoveReason, Moved, Places, Surroundings, advance, place_agents_into};
use crate::config::Scenario;
use crate::config::codes;
use crate::datalog::Session;
use crate::datalog::internal::symbol_hash;
use crate::datalog::{ClauseId, Value};
use crate::diag::{self, Diagnostic};
use crate::predicate::{Entity, Progress, Subject};
use crate::rng::Seed;
use crate::sim::codes as sim_codes;
use crate::sim::tick::agent_state::Position;
use crate::sim::tick::chance::{Chance, Drawing, Draws};
use crate::sim::tick::dense_executor::{Decisions, DenseExecutor, Undecided, WHOLE_MAX};
use crate::sim::tick::executor::{Choice, Executor, given_up, of_rules};
use crate::sim::tick::external::{CityState, ExternalFacts};
use crate::sim::tick::ground::{Facts, MAX_ENTITIES, ground_with};
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::handed::HandedState;
use crate::sim::tick::hidden::Now;
use crate::sim::tick::memory::Memory;
use crate::sim::tick::pool::{start_threads, threads_of};
use crate::sim::tick::vocabulary::{Actions, Vocabulary};
use crate::sim::tick::world::World;
use crate::threads::Pool;
use crate::yaml;
use ndarray::Array3;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// The facts of rules that the dense executor evaluates itself.
static NOT_HANDED: ExternalFacts = ExternalFacts::NONE;

/// Settings of a [`Simulation`]. They do not affect its results.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// The executor that evaluates the rules.
    pub executor: Executor,
    /// Whether to count the firings of clauses.
    pub count_firings: bool,
    /// The number of threads for a city of more than [`WHOLE_MAX`] agents, at least 1. A smaller city uses one.
    pub threads: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            executor: Executor::Auto,
            count_firings: false,
            threads: 1,
        }
    }
}

/// A running city. The same world, split and seed give the same ticks.
pub struct Simulation {
    world: Arc<World>,
    split: Split,
    places: Arc<Places>,
    seed: Seed,
    /// Ticks since the start of the run.
    tick: u64,
    agents: Vec<Agent>,
    /// The hashes of their names; empty unless the rules draw.
    names: Vec<u64>,
    /// The changing part of each agent in a large city, packed because the dense executor reads it in the order of
    /// location.
    positions: Vec<Position>,
    /// The dense executor; `None` if `state` decides.
    dense: Option<DenseExecutor>,
    /// The rules that the dense executor hands over.
    handed: Option<Box<HandedState>>,
    /// The executor that the settings demand.
    demanded: Executor,
    /// Why the dense executor was not chosen, hands over a part of the rules, or gave up.
    fallback: Option<Diagnostic>,
    decisions: Decisions,
    /// What the rules read of earlier ticks in the last tick; before the first one, nothing.
    memory: Memory,
    /// What they read in the next tick, made on demand.
    next_memory: OnceLock<Memory>,
    /// The facts of the external predicates in the last tick.
    external: ExternalFacts,
    /// Those in the present state, on which the next tick is decided, computed on demand.
    next_external: OnceLock<ExternalFacts>,
    /// The action that the caller imposes on each agent. All `None` between ticks.
    given: Vec<Option<Action>>,
    /// The session with the facts on which tick `stated` was decided. Created on first use.
    state: Option<Box<GroundState>>,
    stated: Option<u64>,
    report: TickReport,
    /// The clauses whose firings can be counted: [`World::clauses`].
    clauses: Arc<[ClauseId]>,
    threads: Option<Pool>,
    cancel: Cancel,
}

/// The result of a tick.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct TickReport {
    /// Number of the tick, from 0.
    pub tick: u64,
    /// The results of the agents, in list order.
    pub agents: Vec<AgentTick>,
}

/// The tick of one agent: its state before, its decision, its move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct AgentTick {
    /// The heading before the move. The cell before the move is in `moved`.
    pub heading: Option<Heading>,
    /// The number of cells moved in the tick before.
    pub speed: u8,
    /// The number of ticks without a move before this one.
    pub waited: u32,
    /// The number of steps to the goal before the move.
    pub remaining: u32,
    /// The direction in which the route left the next intersection before the move, if a predicate says so.
    pub exit: Option<Heading>,
    /// The derived actions, without the default.
    pub derived: Actions,
    /// The action in effect: decided by the rules, imposed by the caller, or that which parked the agent.
    pub action: Action,
    /// The move.
    pub moved: Moved,
}

/// A part of the work of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Computes facts and evaluates rules.
    Decide,
    /// Moves agents and sends them to new goals.
    Move,
    /// Updates the agents' positions in the executor.
    Note,
}

impl Phase {
    /// All phases, in order.
    pub const ALL: [Phase; 3] = [Phase::Decide, Phase::Move, Phase::Note];
}

/// The state on which the last tick was decided, as facts of a session.
#[derive(Clone, Copy)]
pub struct Snapshot<'a> {
    pub(crate) world: &'a World,
    pub(crate) state: &'a GroundState,
}

impl<'a> Snapshot<'a> {
    /// Returns the session that holds the facts and the rows that the rules derive from them.
    pub fn session(&self) -> &'a Session {
        self.state.session()
    }

    /// Returns the world of the simulation.
    pub fn world(&self) -> &'a World {
        self.world
    }

    /// Returns the value that represents an agent, given its position in the list.
    pub fn value(&self, agent: usize) -> Value {
        self.state.value(agent)
    }

    /// Returns the position in the list of the agent that a value represents.
    pub fn agent(&self, value: Value) -> Option<usize> {
        self.state.entity(value)
    }
}

impl Simulation {
    /// Creates a simulation and places the agents of a split.
    ///
    /// # Errors
    /// `unknown-split`, `no-start-cell`, `no-route`; `external-predicate` if a function that computes an external
    /// predicate is missing; `dense-unsupported` if `settings` demand the dense executor and it
    /// cannot evaluate the rules; `limit-exceeded` for more than [`MAX_ENTITIES`] agents with the relational executor,
    /// whose binary facts take memory quadratic in that number, or if temporal operators need more memory than
    /// [`World::limits`].
    pub fn new(world: Arc<World>, split: Split, seed: Seed, settings: Settings) -> Result<Simulation, Diagnostic> {
        Simulation::new_with(world, split, seed, settings, &Cancel::never())
    }

    /// Cancellable variant of [`new`](Simulation::new). The simulation keeps `cancel`, so its later work is
    /// cancellable, too.
    ///
    /// # Errors
    /// As [`Simulation::new`]; `cancelled` on cancellation.
    pub fn new_with(
        world: Arc<World>,
        split: Split,
        seed: Seed,
        settings: Settings,
        cancel: &Cancel,
    ) -> Result<Simulation, Diagnostic> {
        let set = agent_set(&world.scenario, split)?;
        let places = world.places(split, set);
        let mut agents = Vec::with_capacity(set.len());
        place_agents_into(&mut agents, set, &world.router, &places, seed, cancel)?;
        Simulation::with_agents(world, split, seed, settings, agents, cancel)
    }

    /// Creates a simulation that continues at tick `tick` with the agents that another simulation of the split had
    /// before that tick. The map must be the same; the rules may be others.
    ///
    /// Under the same rules, the later ticks are equal, too.
    ///
    /// # Errors
    /// As [`Simulation::new_with`].
    pub fn resume(
        world: Arc<World>,
        split: Split,
        seed: Seed,
        settings: Settings,
        (tick, agents): (u64, Vec<Agent>),
        cancel: &Cancel,
    ) -> Result<Simulation, Diagnostic> {
        world.without_time("simulations that begin in a later tick")?;
        let mut simulation = Simulation::with_agents(world, split, seed, settings, agents, cancel)?;
        simulation.tick = tick;
        simulation.report.tick = tick;
        Ok(simulation)
    }

    fn with_agents(
        world: Arc<World>,
        split: Split,
        seed: Seed,
        settings: Settings,
        agents: Vec<Agent>,
        cancel: &Cancel,
    ) -> Result<Simulation, Diagnostic> {
        let scenario = &world.scenario;
        let set = agent_set(scenario, split)?;
        world.check_external()?;
        let places = world.places(split, set);
        let clauses = world.counted_clauses();
        let to_count: &[ClauseId] = if settings.count_firings { &clauses } else { &[] };
        // Below this size, one thread is faster than waking a pool.
        let threads = match agents.len() > WHOLE_MAX {
            true => settings.threads.max(1),
            false => 1,
        };
        let chosen = (settings.executor)
            .choose(|| {
                DenseExecutor::new(
                    &world,
                    &agents,
                    to_count,
                    (threads, settings.executor == Executor::Auto),
                )
            })
            .map_err(|fault| of_rules(fault, scenario.rules.span))?;
        let (dense, mut fallback) = match chosen {
            Choice::Dense(dense) => (Some(dense), None),
            Choice::Relational(reason) => (None, reason),
        };
        if dense.is_none() && agents.len() > MAX_ENTITIES {
            let message = format!(
                "{} agents, the limit of the relational executor is {MAX_ENTITIES}",
                agents.len()
            );
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(set.span, "in this agent set");
            return Err(match fallback {
                None => fault.help("use fewer agents, or another executor (`auto`)"),
                Some(reason) => {
                    let fault = fault.note(reason.message);
                    let fault = reason
                        .primary
                        .into_iter()
                        .fold(fault, |fault, label| fault.also(label.span, label.message));
                    fault.help("`logicity check` lists the rules that the dense executor cannot evaluate, and why")
                }
            });
        }
        let handed = dense
            .as_ref()
            .and_then(|dense| HandedState::new(&world, dense.plan(), &agents));
        if let Some(handed) = &handed {
            fallback = Some(handed.rules().reason.clone());
        }
        let pool = start_threads(threads)?;
        let watched = world.watched(agents.len());
        let memory = Memory::new(&world.program.rules().pasts, &watched, world.limits.bytes)
            .map_err(|fault| of_rules(fault, scenario.rules.span))?;
        let report = TickReport {
            tick: 0,
            agents: (agents.iter())
                .map(|agent| AgentTick::resting(agent, world.map_of_exits()))
                .collect(),
        };
        Ok(Simulation {
            split,
            places,
            seed,
            tick: 0,
            next_memory: OnceLock::new(),
            memory,
            external: ExternalFacts::default(),
            next_external: OnceLock::new(),
            decisions: Decisions::new(agents.len(), to_count.len(), watched),
            given: vec![None; agents.len()],
            positions: match &dense {
                Some(dense) if !dense.takes_positions() => Vec::new(),
                _ => agents.iter().map(Position::of).collect(),
            },
            names: match world.vocabulary.draws {
                true => {
                    let names = agents.iter().map(|agent| agent.name().to_string());
                    names.map(|name| symbol_hash(&name)).collect()
                }
                false => Vec::new(),
            },
            agents,
            dense,
            handed: handed.map(Box::new),
            demanded: settings.executor,
            fallback,
            state: None,
            stated: None,
            report,
            clauses,
            threads: pool,
            cancel: cancel.clone(),
            world,
        })
    }

    /// Starts a new run at tick 0 with the same number of agents and the same names.
    ///
    /// It equals a new simulation with `seed` and these agents. The previous agents are swapped into `agents`.
    ///
    /// # Panics
    /// If the number of agents or a name differs.
    pub fn restart(&mut self, seed: Seed, agents: &mut Vec<Agent>) {
        assert!(agents.len() == self.agents.len(), "more or fewer agents");
        std::mem::swap(&mut self.agents, agents);
        for (agent, before) in self.agents.iter().zip(agents) {
            assert!(agent.name() == before.name(), "agents named otherwise");
        }
        self.begin_run(seed);
    }

    /// Continues this run at tick `tick` with these agents, which have the names of the present ones. Later ticks equal
    /// those of a run that had these agents before that tick. The previous agents are swapped into `agents`.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules have temporal operators, since what they remember is unknown.
    ///
    /// # Panics
    /// As [`Simulation::restart`].
    pub fn place(&mut self, tick: u64, agents: &mut Vec<Agent>) -> Result<(), Diagnostic> {
        self.world.without_time("simulations that begin in a later tick")?;
        self.restart(self.seed, agents);
        (self.tick, self.report.tick) = (tick, tick);
        Ok(())
    }

    /// Returns whether the agents have the names of all agents of the split, in list order.
    pub fn has_all_agents(&self) -> bool {
        let set = self.world.scenario.agent_set(self.split);
        let names = set.into_iter().flat_map(AgentSet::members).map(|(name, _)| name);
        names.eq(self.agents.iter().map(Agent::name))
    }

    /// Starts a new run at tick 0 with the agents that a new simulation with `seed` has, after `change`. Reuses the
    /// memory of the agents, which are [all agents](Simulation::has_all_agents) of the split.
    ///
    /// # Panics
    /// If there are more or fewer agents.
    ///
    /// # Errors
    /// `no-start-cell`, `no-route`, `cancelled`; some agents are then those of the last run.
    pub fn restart_drawn(&mut self, seed: Seed, change: impl FnOnce(&mut [Agent])) -> Result<(), Diagnostic> {
        let set = agent_set(&self.world.scenario, self.split)?;
        assert!(self.agents.len() == set.len(), "more or fewer agents");
        let agents = &mut self.agents;
        let drawn = place_agents_into(agents, set, &self.world.router, &self.places, seed, &self.cancel);
        if drawn.is_ok() {
            change(agents);
        }
        self.begin_run(seed);
        drawn
    }

    /// Starts a run with the present agents.
    fn begin_run(&mut self, seed: Seed) {
        for (agent, position) in self.agents.iter().zip(&mut self.positions) {
            *position = Position::of(agent);
        }
        self.seed = seed;
        (self.tick, self.stated) = (0, None);
        if let Some(dense) = &mut self.dense {
            dense.restart(self.world.map(), &self.agents);
        }
        self.decisions.clear();
        self.memory.clear();
        self.next_memory.take();
        self.next_external.take();
        self.report.tick = 0;
        for (done, agent) in self.report.agents.iter_mut().zip(&self.agents) {
            *done = AgentTick::resting(agent, self.world.map_of_exits());
        }
    }

    /// Places the agents of the split in `agents`, reusing its memory, as a new simulation with this seed does.
    ///
    /// # Errors
    /// `no-start-cell`, `no-route`.
    pub fn draw_agents(&self, seed: Seed, agents: &mut Vec<Agent>) -> Result<(), Diagnostic> {
        let set = self
            .world
            .scenario
            .agent_set(self.split)
            .expect("the simulation was made for it");
        place_agents_into(agents, set, &self.world.router, &self.places, seed, &self.cancel)
    }

    /// Returns the cells where agents start and arrive.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Returns the cancellation request that long work of this simulation polls.
    pub fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Returns the world: scenario, map, roads and rules.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Returns the split of the agents.
    pub fn split(&self) -> Split {
        self.split
    }

    /// Returns the seed of the run.
    pub fn seed(&self) -> Seed {
        self.seed
    }

    /// Returns the current agents in list order.
    pub fn agents(&self) -> &[Agent] {
        &self.agents
    }

    /// Returns the layered semantic map of the present state; [`CityMap::semantic`] documents shape and layers.
    ///
    /// [`CityMap::semantic`]: crate::city::CityMap::semantic
    ///
    /// # Errors
    /// As [`CityMap::semantic`].
    pub fn semantic_map(&self) -> Result<Array3<f32>, Diagnostic> {
        let cells: Vec<Cell> = self.agents.iter().map(|agent| agent.cell).collect();
        self.world.map().semantic(&cells)
    }

    /// Returns the number of ticks since the start of the run.
    pub fn now(&self) -> u64 {
        self.tick
    }

    /// Returns the result of the last tick; before the first tick, all agents rest.
    pub fn report(&self) -> &TickReport {
        &self.report
    }

    /// Returns the executor in use, which is never [`Executor::Auto`].
    pub fn executor(&self) -> Executor {
        match self.dense {
            Some(_) => Executor::Dense,
            None => Executor::Relational,
        }
    }

    /// Returns whether the dense executor hands a part of the rules over to the relational one.
    pub fn hands_over(&self) -> bool {
        self.handed.is_some()
    }

    /// Returns why [`Executor::Auto`] chose the relational executor, for all rules or for some, or fell back to it. The
    /// message is a sentence without a full stop; the place is in the rules.
    pub fn fallback(&self) -> Option<&Diagnostic> {
        self.fallback.as_ref()
    }

    /// Returns the number of threads in use.
    pub fn threads(&self) -> usize {
        self.threads.as_ref().map_or(1, Pool::count)
    }

    /// Returns the clauses whose firings can be counted, in the order of [`World::clauses`].
    pub fn clauses(&self) -> &[ClauseId] {
        &self.clauses
    }

    /// Returns the number of rows that each clause derived in the last tick, in the order of [`Simulation::clauses`].
    /// Empty unless [`Settings::count_firings`] is set.
    pub fn firings(&self) -> &[usize] {
        &self.decisions.firings
    }

    /// Returns the action clauses that fired for an agent in the last tick, as positions in [`Simulation::clauses`].
    /// Empty unless [`Settings::count_firings`] is set.
    pub fn fired(&self, agent: usize) -> impl Iterator<Item = usize> {
        self.decisions.fired(agent)
    }

    /// Exchanges the working memory of a small city. It has no state between ticks, so that cities that take turns can
    /// share it and keep it in the cache.
    pub fn swap_memory(&mut self, other: &mut Simulation) {
        if let (Some(dense), Some(others)) = (&mut self.dense, &mut other.dense) {
            dense.swap_memory(others);
        }
    }

    /// Loads the addresses of what [`Simulation::prefetch`] reads. Returns a meaningless sum of what it reads.
    pub fn prefetch_head(&self) -> u64 {
        let lengths = [
            self.agents.len(),
            self.report.agents.len(),
            self.given.len(),
            self.decisions.len(),
        ];
        (lengths.iter()).fold(self.tick ^ u64::from(self.dense.is_some()), |sum, length| {
            sum ^ *length as u64
        })
    }

    /// Loads what a tick of a small city uses into the cache, while other work proceeds. Returns a meaningless sum of
    /// what it reads.
    pub fn prefetch(&self) -> u64 {
        if !self.positions.is_empty() {
            return 0;
        }
        let agents = self.agents.iter().fold(0, |sum: usize, agent| {
            sum.wrapping_add(agent.position()).wrapping_add(agent.route().steps())
        });
        let ticks = self.report.agents.iter().step_by(2);
        let ticks = ticks.fold(0, |sum: u64, tick| sum.wrapping_add(tick.action.index() as u64));
        ticks.wrapping_add(agents as u64)
    }

    /// Runs one tick: all agents decide, then all move.
    ///
    /// `controls` overrides the decisions of agents, given by their positions in the list. The last entry for an agent
    /// counts. External predicates are computed first, unless an observation of the state has done so. If the dense
    /// executor needs too many steps, [`Executor::Auto`] falls back to the relational one for this
    /// and all later ticks ([`Simulation::fallback`]).
    ///
    /// # Errors
    /// `invalid-value` for a position outside the list or an action that the agent cannot take; `limit-exceeded` if an
    /// evaluation by the relational executor or what the rules read of earlier ticks exceeds the
    /// [limits](World::limits), too many agents are in one place for the dense one, or it needs too many steps and the
    /// settings demand it; `external-predicate` if a function that computes one fails; `cancelled` on cancellation. On
    /// error the city is unchanged.
    pub fn tick(&mut self, controls: &[(usize, Action)]) -> Result<&TickReport, Diagnostic> {
        self.tick_watched(controls, |_| ())
    }

    /// Variant of [`tick`](Simulation::tick) that calls `ended` at the end of each phase.
    ///
    /// # Errors
    /// As [`Simulation::tick`].
    pub fn tick_watched(
        &mut self,
        controls: &[(usize, Action)],
        mut ended: impl FnMut(Phase),
    ) -> Result<&TickReport, Diagnostic> {
        let count = self.agents.len();
        if let Some((position, _)) = controls.iter().find(|(position, _)| *position >= count) {
            let message = format!("there is no agent {position} to control: there are {count}, counted from 0");
            return Err(Diagnostic::new(yaml::codes::INVALID_VALUE, message));
        }
        self.check_controls(controls)?;
        let draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        self.external()?;
        let threads = threads_of(self.threads.as_ref())?;
        // Until now the memory was that of the last tick, for explanations. After an error it is already that of this one.
        if let Some(next) = self.next_memory.take() {
            self.memory = next;
        } else if self.must_remember() {
            self.memory.advance(&self.decisions.watched);
        }
        self.memory.check(self.world.limits.bytes)?;
        self.evaluate_handed(draws)?;
        let map = self.world.map();
        if let Some(dense) = &mut self.dense {
            let decisions = &mut self.decisions;
            let now = Now {
                draws,
                agents: &self.agents,
                memory: &self.memory,
                drawing: Drawing {
                    word: word_of(&self.world, draws),
                    names: &self.names,
                },
                external: self.next_external.get().unwrap_or(&self.external),
                handed: self.handed.as_ref().map_or(&NOT_HANDED, |handed| handed.facts()),
            };
            let decided = match &threads {
                Some(pool) => pool.install(|| dense.decide(map, now, decisions)),
                None => dense.decide(map, now, decisions),
            };
            match decided {
                Ok(()) => self.count_handed(),
                Err(Undecided::Crowded(fault)) => return Err(fault),
                Err(Undecided::TooManySteps(error)) => {
                    let agents = self.agents.len();
                    if self.demanded == Executor::Dense || agents > MAX_ENTITIES {
                        return Err(given_up(error));
                    }
                    let message = format!("the dense executor gave up in tick {}: {error}", self.tick);
                    self.fallback = Some(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
                    (self.dense, self.handed) = (None, None);
                }
            }
        }
        if self.dense.is_none() {
            self.decide_by_facts(draws)?;
        }
        self.decisions.watched.sort();
        if let Some(next) = self.next_external.take() {
            self.external = next;
        }
        ended(Phase::Decide);
        self.advance(controls, threads.as_deref());
        ended(Phase::Move);
        if let Some(dense) = &mut self.dense {
            let (map, positions) = (self.world.map(), &self.positions);
            match &threads {
                Some(pool) => pool.install(|| dense.follow(map, positions)),
                None => dense.follow(map, positions),
            }
        }
        ended(Phase::Note);
        self.report.tick = self.tick;
        self.tick += 1;
        Ok(&self.report)
    }

    /// Checks that the controlled agents can take their actions.
    fn check_controls(&self, controls: &[(usize, Action)]) -> Result<(), Diagnostic> {
        let table = &self.world.scenario.actions.table;
        let cannot = |&&(position, action): &&(usize, Action)| !table.can_take(self.agents[position].kind_id, action);
        let Some(&(position, action)) = controls.iter().find(cannot) else {
            return Ok(());
        };
        let (name, action) = (self.agents[position].name(), table.name(action));
        let message = format!("{name} cannot take the action `{action}`");
        let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message);
        Err(fault.help(format!(
            "the `cells` of `{action}` in the configuration list the kinds that can"
        )))
    }

    /// Returns whether the memory lacks the last tick.
    fn must_remember(&self) -> bool {
        !self.memory.is_empty() && self.memory.ticks() < self.tick
    }

    /// Returns what the rules read of earlier ticks in the next tick.
    pub(crate) fn remembered(&self) -> &Memory {
        if !self.must_remember() {
            return &self.memory;
        }
        self.next_memory.get_or_init(|| {
            let mut next = self.memory.clone();
            next.advance(&self.decisions.watched);
            next
        })
    }

    /// Returns the facts of the external predicates in the present state.
    ///
    /// # Errors
    /// `external-predicate` if a function fails; `limit-exceeded` if the facts need more memory than
    /// [`World::limits`].
    pub(crate) fn external(&self) -> Result<&ExternalFacts, Diagnostic> {
        if let Some(known) = self.next_external.get() {
            return Ok(known);
        }
        let Some(external) = self.world.external() else {
            return Ok(&self.external);
        };
        let state = CityState {
            scenario: &self.world.scenario,
            vocabulary: &self.world.vocabulary,
            map: self.world.map(),
            tick: self.tick,
            agents: &self.agents,
        };
        let mut facts = ExternalFacts::within(&state, self.world.limits.bytes)?;
        external.compute(&state, &mut facts).map_err(|reason| {
            let message = format!("the external predicates failed in tick {}: {reason}", self.tick);
            Diagnostic::new(sim_codes::EXTERNAL_PREDICATE, message)
        })?;
        Ok(self.next_external.get_or_init(|| facts))
    }

    /// Applies the decisions and `controls` and moves all agents.
    fn advance(&mut self, controls: &[(usize, Action)], threads: Option<&ThreadPool>) {
        let Simulation {
            world,
            places,
            decisions,
            agents,
            given,
            positions,
            report,
            ..
        } = self;
        for &(position, action) in controls {
            given[position] = Some(action);
        }
        let moving = Moving {
            decisions,
            controlled: given,
            vocabulary: &world.vocabulary,
            map_of_exits: world.map_of_exits(),
            surroundings: Surroundings {
                router: &world.router,
                places: &*places,
                actions: &world.scenario.actions.table,
                seed: self.seed,
                tick: self.tick,
            },
        };
        match threads {
            Some(pool) => pool.install(|| {
                (agents.par_iter_mut().with_min_len(1024))
                    .zip(positions)
                    .zip(&mut report.agents)
                    .enumerate()
                    .for_each(|(index, ((agent, position), done))| {
                        moving.step(index, agent, done);
                        *position = Position::of(agent);
                    });
            }),
            None if positions.is_empty() => {
                for (index, (agent, done)) in agents.iter_mut().zip(&mut report.agents).enumerate() {
                    moving.step(index, agent, done);
                }
            }
            None => {
                let agents = agents.iter_mut().zip(positions).zip(&mut report.agents);
                for (index, ((agent, position), done)) in agents.enumerate() {
                    moving.step(index, agent, done);
                    *position = Position::of(agent);
                }
            }
        }
        for &(position, _) in controls {
            given[position] = None;
        }
    }

    /// Returns whether a predicate with a probability holds at a tick of this run for two agents. The predicate is given
    /// by its position in the vocabulary, the agents by theirs in the list.
    pub(crate) fn happens(&self, tick: u64, predicate: usize, agents: [usize; 2], probability: f64) -> bool {
        let draws = Draws {
            seed: self.seed,
            time: tick,
        };
        draws.happens(predicate, agents[0], agents[1], probability)
    }

    /// Returns what draws of clauses read in the present tick.
    pub(crate) fn drawing(&self) -> Drawing<'_> {
        let draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        Drawing {
            word: word_of(&self.world, draws),
            names: &self.names,
        }
    }

    /// Returns the facts on which the tick is decided. `is_read` selects predicates by their positions in the
    /// vocabulary, `reads_past` those about earlier ticks.
    fn ground(
        &self,
        draws: Draws,
        is_read: impl Fn(usize) -> bool,
        reads_past: impl Fn(usize) -> bool,
    ) -> Result<Facts, Diagnostic> {
        let world = &*self.world;
        let entities = self.agents.iter().map(|agent| Entity {
            progress: Progress::of(agent, world.map_of_exits()),
            ..entity(agent)
        });
        let entities: Vec<Entity<'_>> = entities.collect();
        let (vocabulary, view) = (&world.vocabulary, world.scenario.view);
        let unread = |index: usize| !is_read(index);
        let bounds = (world.limits.bytes, &self.cancel);
        let mut facts = ground_with(vocabulary, world.map(), view, &entities, &draws, unread, bounds)?;
        facts.past = self.memory.rows_of(reads_past);
        let external = self.next_external.get().unwrap_or(&self.external);
        facts.add_external(vocabulary, external, is_read);
        Ok(facts)
    }

    /// Derives what the dense executor hands over, or gives that executor up.
    fn evaluate_handed(&mut self, draws: Draws) -> Result<(), Diagnostic> {
        let Some(handed) = &self.handed else {
            return Ok(());
        };
        let reads_past = |past: usize| handed.rules().reads_past[past];
        let mut facts = self.ground(draws, |index| handed.lacks(index), reads_past)?;
        let bounds = (self.world.limits.bytes, &self.cancel);
        let subjects: Vec<Subject> = self.agents.iter().map(|agent| entity(agent).subject()).collect();
        handed.add_pairs(&subjects, draws, &mut facts, bounds)?;
        if let Some(handed) = &mut self.handed
            && !handed.evaluate(&facts, &self.cancel)?
        {
            let message = format!(
                "the dense executor gave up in tick {}: a clause that it hands over derives a row about something that \
                 is no agent",
                self.tick
            );
            self.fallback = Some(Diagnostic::new(sim_codes::DENSE_UNSUPPORTED, message));
            (self.dense, self.handed) = (None, None);
        }
        Ok(())
    }

    /// Counts the firings of the clauses that the dense executor hands over.
    fn count_handed(&mut self) {
        let Some(handed) = self.handed.as_ref().filter(|_| !self.decisions.firings.is_empty()) else {
            return;
        };
        for (index, (clause, action)) in self.world.clause_actions().enumerate() {
            if let Some(rows) = handed.fired(clause) {
                self.decisions
                    .count(index, action.is_some(), &rows, |value| handed.agent(value));
            }
        }
    }

    /// Decides with the relational executor.
    fn decide_by_facts(&mut self, draws: Draws) -> Result<(), Diagnostic> {
        let vocabulary = &self.world.vocabulary;
        let facts = self.ground(draws, |index| vocabulary.is_read(index), |_| true)?;
        let state = (self.state).get_or_insert_with(|| ground_state(&self.world, &self.agents));
        state
            .set_with(&facts, &self.cancel)
            .map_err(|error| error.diagnostic(self.world.program.rules()))?;
        self.stated = Some(draws.time);
        self.decisions.clear();
        state.watch(&mut self.decisions.watched);
        for agent in 0..self.agents.len() {
            for action in state.derived(&self.world.vocabulary, agent).iter() {
                self.decisions.add(agent, action);
            }
        }
        if !self.decisions.firings.is_empty() {
            for (index, (clause, action)) in self.world.clause_actions().enumerate() {
                let rows = state.session().fired(clause);
                self.decisions
                    .count(index, action.is_some(), &rows, |value| state.entity(value));
            }
        }
        Ok(())
    }

    /// Returns the state on which the last tick was decided, as facts of a session. Before the first tick, it is the
    /// present state.
    ///
    /// # Errors
    /// `limit-exceeded` for more than [`MAX_ENTITIES`] agents, or if the rules derive too many rows; `cancelled` on
    /// cancellation.
    pub fn snapshot(&mut self) -> Result<Snapshot<'_>, Diagnostic> {
        let tick = self.report.tick;
        if self.stated != Some(tick) {
            if self.agents.len() > MAX_ENTITIES {
                let message = format!(
                    "{} agents have too many binary facts; the limit is {MAX_ENTITIES} agents",
                    self.agents.len()
                );
                return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
            }
            let facts = self.facts_with(|index| self.world.vocabulary.is_read(index), &self.cancel)?;
            let state = (self.state).get_or_insert_with(|| ground_state(&self.world, &self.agents));
            state
                .set_with(&facts, &self.cancel)
                .map_err(|error| error.diagnostic(self.world.program.rules()))?;
            self.stated = (self.tick > 0).then_some(tick);
        }
        Ok(Snapshot {
            world: &self.world,
            state: self.state.as_ref().expect("it has just been made"),
        })
    }

    /// Returns the base facts on which the last tick was decided. `wanted` selects predicates by their positions in the
    /// vocabulary.
    ///
    /// # Errors
    /// `limit-exceeded` if they take more memory than the limits of the world allow; before the first tick also
    /// `external-predicate` if a function that computes one fails.
    pub fn facts(&self, wanted: impl Fn(usize) -> bool) -> Result<Facts, Diagnostic> {
        self.facts_with(wanted, &Cancel::never())
    }

    /// Cancellable variant of [`facts`](Simulation::facts).
    ///
    /// # Errors
    /// As [`facts`](Simulation::facts); `cancelled` on cancellation.
    pub fn facts_with(&self, wanted: impl Fn(usize) -> bool, cancel: &Cancel) -> Result<Facts, Diagnostic> {
        let world = &self.world;
        let draws = Draws {
            seed: self.seed,
            time: self.report.tick,
        };
        let view = world.scenario.view;
        let unwanted = |index| !wanted(index);
        let decided_entities = self.decided_entities();
        let facts = ground_with(
            &world.vocabulary,
            world.map(),
            view,
            &decided_entities,
            &draws,
            unwanted,
            (world.limits.bytes, cancel),
        );
        if self.memory.ticks() > self.report.tick {
            let message = "the last tick cannot be evaluated again, since the next one has failed";
            return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message));
        }
        let mut facts = facts?;
        facts.past = self.memory.rows();
        let external = match self.report.tick < self.tick {
            true => &self.external,
            false => self.external()?,
        };
        facts.add_external(&world.vocabulary, external, wanted);
        Ok(facts)
    }

    /// Evaluates the rules on other facts with the relational executor, incrementally.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows; `cancelled` on cancellation.
    pub fn evaluate(&mut self, facts: &Facts) -> Result<(), Diagnostic> {
        self.stated = None;
        let state = (self.state).get_or_insert_with(|| ground_state(&self.world, &self.agents));
        (state.set_with(facts, &self.cancel)).map_err(|error| error.diagnostic(self.world.program.rules()))
    }

    /// Computes, as bits, all facts about the present state that the rules may read, and returns their number. `None`
    /// unless the dense executor evaluates the whole city in one window, or if a function that computes an external
    /// predicate fails.
    pub fn count_facts(&mut self) -> Option<u64> {
        let draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        self.external().ok()?;
        let now = Now {
            draws,
            agents: &self.agents,
            memory: &self.memory,
            drawing: Drawing {
                word: word_of(&self.world, draws),
                names: &self.names,
            },
            external: self.next_external.get().unwrap_or(&self.external),
            handed: self.handed.as_ref().map_or(&NOT_HANDED, |handed| handed.facts()),
        };
        self.dense.as_mut()?.count_facts(self.world.map(), now)
    }

    /// Returns the agents as they were when the last tick was decided.
    fn decided_entities(&self) -> Vec<Entity<'_>> {
        self.agents.iter().zip(&self.report.agents).map(decided).collect()
    }
}

/// Returns the word from which the draws of clauses follow; 0 if the rules draw nothing.
fn word_of(world: &World, draws: Draws) -> u64 {
    match world.vocabulary.draws {
        true => draws.word(),
        false => 0,
    }
}

/// Returns an agent as it was before a tick.
fn decided<'a>((agent, done): (&'a Agent, &AgentTick)) -> Entity<'a> {
    Entity {
        at: done.moved.from,
        heading: done.heading,
        progress: Progress {
            speed: done.speed.into(),
            waited: done.waited,
            remaining: done.remaining,
            exit: done.exit,
        },
        ..entity(agent)
    }
}

/// The data that agents need to move in a tick.
struct Moving<'a> {
    decisions: &'a Decisions,
    controlled: &'a [Option<Action>],
    vocabulary: &'a Vocabulary,
    map_of_exits: Option<&'a CityMap>,
    surroundings: Surroundings<'a>,
}

impl Moving<'_> {
    /// Moves an agent and records its tick.
    // A call would take longer than most moves.
    #[inline(always)]
    fn step(&self, index: usize, agent: &mut Agent, done: &mut AgentTick) {
        let derived = self.decisions.derived(index);
        let action = match agent.parked {
            0 => self.controlled[index].unwrap_or_else(|| self.vocabulary.decide(Some(agent.kind_id), derived)),
            _ => agent.parked_by,
        };
        *done = AgentTick {
            heading: agent.heading,
            speed: agent.speed,
            waited: agent.waited,
            remaining: agent.remaining(),
            exit: self.map_of_exits.and_then(|map| agent.exit(map)),
            derived: self.vocabulary.before_default(Some(agent.kind_id), derived),
            action,
            moved: advance(agent, index, action, &self.surroundings),
        };
    }
}

impl AgentTick {
    /// The report of an agent before the first tick.
    fn resting(agent: &Agent, map_of_exits: Option<&CityMap>) -> AgentTick {
        AgentTick {
            heading: agent.heading,
            speed: agent.speed,
            waited: agent.waited,
            remaining: agent.remaining(),
            exit: map_of_exits.and_then(|map| agent.exit(map)),
            derived: Actions::default(),
            action: Action::Stop,
            moved: Moved {
                from: agent.cell,
                to: agent.cell,
                reason: MoveReason::Resting,
                replanned: false,
                rerouted: false,
            },
        }
    }
}

/// Returns the agents of a split.
///
/// # Errors
/// `unknown-split`.
fn agent_set(scenario: &Scenario, split: Split) -> Result<&AgentSet, Diagnostic> {
    scenario.agent_set(split).ok_or_else(|| {
        let message = format!("the configuration `{}` has no split `{}`", scenario.name, split.name());
        let known: Vec<&str> = scenario.splits.iter().map(|(split, _)| split.name()).collect();
        Diagnostic::new(codes::UNKNOWN_SPLIT, message)
            .help(format!("it has: {}; name one of these as the split", known.join(", ")))
    })
}

fn ground_state(world: &World, agents: &[Agent]) -> Box<GroundState> {
    let names: Vec<String> = agents.iter().map(|agent| agent.name().to_string()).collect();
    let names = names.iter().map(String::as_str);
    Box::new(GroundState::new(&world.program, &world.vocabulary, world.limits, names))
}

/// What predicates see of an agent, without `exit`.
pub(crate) fn entity(agent: &Agent) -> Entity<'_> {
    Entity {
        kind: agent.kind,
        concepts: &agent.concepts,
        priority: agent.priority,
        at: agent.cell,
        heading: agent.heading,
        progress: Progress::of(agent, None),
    }
}
