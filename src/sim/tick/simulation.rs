//! The tick: all agents decide on the same state, then all move.

use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::city::{Agent, Cell, Heading, MoveReason, Moved, Places, Surroundings, advance, place_agents_into};
use crate::datalog::Session;
use crate::datalog::{ClauseId, Value};
use crate::diag::{Code, Diagnostic};
use crate::predicate::Entity;
use crate::rng::Seed;
use crate::sim::tick::chance::Draws;
use crate::sim::tick::dense_executor::{Decisions, DenseExecutor, WHOLE_MAX};
use crate::sim::tick::executor::{Choice, Executor};
use crate::sim::tick::ground::{Facts, MAX_ENTITIES, ground_with};
use crate::sim::tick::ground_state::GroundState;
use crate::sim::tick::vocabulary::Actions;
use crate::sim::tick::window::Position;
use crate::sim::tick::world::World;
use ndarray::Array3;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, mpsc};
use std::time::Duration;

/// How a [`Simulation`] works. Ticks are the same whatever is chosen.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// What evaluates the rules.
    pub executor: Executor,
    /// Whether the firings of clauses are counted.
    pub count_firings: bool,
    /// Threads for a city of more than [`WHOLE_MAX`] agents, at least 1; a smaller one has one.
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

/// A city in motion. The same world, split and seed give the same ticks.
pub struct Simulation {
    world: Arc<World>,
    split: Split,
    places: Arc<Places>,
    seed: Seed,
    /// How many ticks have passed.
    tick: u64,
    agents: Vec<Agent>,
    /// What moves change of each agent. Close together, since many agents are looked up in the order of where they are.
    positions: Vec<Position>,
    /// Decides densely; `None` if `state` decides.
    dense: Option<DenseExecutor>,
    /// Why `state` decides, if that was not asked for.
    fallback: Option<String>,
    decisions: Decisions,
    /// For each agent the action it is given in the tick, if it is given one. Empty between ticks.
    given: Vec<Option<Action>>,
    /// The session with the facts on which a tick was decided, and the number of that tick. Made when it is needed first.
    state: Option<GroundState>,
    stated: Option<u64>,
    report: TickReport,
    /// The clauses whose firings can be counted: all with a body, hidden ones left out.
    clauses: Vec<ClauseId>,
    threads: Option<ThreadPool>,
    cancel: Cancel,
}

/// What happened in a tick.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct TickReport {
    /// Number of the tick, from 0.
    pub tick: u64,
    /// What each agent decided and did, in list order.
    pub agents: Vec<AgentTick>,
}

/// The tick of one agent: the state it was judged on, what the rules decided, what it did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct AgentTick {
    /// Its heading before it moved; where it was is in `moved`.
    pub heading: Option<Heading>,
    /// The actions derived before the default.
    pub derived: Actions,
    /// The action decided on: the rules' own, or the one given from outside.
    pub action: Action,
    /// What it did.
    pub moved: Moved,
}

/// A part of the work of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Facts are computed and rules evaluated.
    Decide,
    /// Agents move and set out for new goals.
    Move,
    /// The executor takes note of where they are.
    Note,
}

impl Phase {
    /// All of them, in order.
    pub const ALL: [Phase; 3] = [Phase::Decide, Phase::Move, Phase::Note];
}

/// The state on which the last tick was decided, as facts of a session.
#[derive(Clone, Copy)]
pub struct Snapshot<'a> {
    pub(crate) world: &'a World,
    pub(crate) state: &'a GroundState,
}

impl<'a> Snapshot<'a> {
    /// The facts and what the rules derive from them.
    pub fn session(&self) -> &'a Session {
        self.state.session()
    }

    /// What does not change.
    pub fn world(&self) -> &'a World {
        self.world
    }

    /// The value that stands for an agent, by its position in the list.
    pub fn value(&self, agent: usize) -> Value {
        self.state.value(agent)
    }

    /// The position in the list of the agent that a value stands for.
    pub fn agent(&self, value: Value) -> Option<usize> {
        self.state.entity(value)
    }
}

impl Simulation {
    /// Places the agents of a split.
    ///
    /// # Errors
    /// `unknown-split`, `no-start-cell`, `no-route`; `limit-exceeded` if the relational executor is to decide for more than
    /// [`MAX_ENTITIES`] agents, since its facts about pairs of them take memory in the square of their number, or the dense one is
    /// to evaluate rules that it cannot.
    pub fn new(world: Arc<World>, split: Split, seed: Seed, settings: Settings) -> Result<Simulation, Diagnostic> {
        Simulation::new_with(world, split, seed, settings, &Cancel::never())
    }

    /// Cancellable variant of [`new`](Simulation::new). The simulation keeps `cancel`, so its later work is
    /// cancellable, too. On cancellation the simulation is unchanged.
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
        let scenario = &world.scenario;
        let set = scenario.agent_set(split).ok_or_else(|| {
            let message = format!("the configuration `{}` has no split `{}`", scenario.name, split.name());
            let known: Vec<&str> = scenario.splits.iter().map(|(split, _)| split.name()).collect();
            Diagnostic::new(Code::UNKNOWN_SPLIT, message).help(format!("it has: {}", known.join(", ")))
        })?;
        let places = world.places(split, set);
        let mut agents = Vec::with_capacity(set.len());
        place_agents_into(&mut agents, set, &world.router, &places, seed, cancel)?;
        let clauses: Vec<ClauseId> = world.clauses().collect();
        let to_count: &[ClauseId] = if settings.count_firings { &clauses } else { &[] };
        // Fewer agents are decided about faster than threads are woken.
        let threads = match agents.len() > WHOLE_MAX {
            true => settings.threads.max(1),
            false => 1,
        };
        let chosen = (settings.executor)
            .choose(|| DenseExecutor::new(&world, &agents, to_count, threads))
            .map_err(|fault| fault.at(scenario.rules.span, "these rules"))?;
        let (dense, fallback) = match chosen {
            Choice::Dense(dense) => (Some(dense), None),
            Choice::Relational(reason) => (None, reason),
        };
        if dense.is_none() && agents.len() > MAX_ENTITIES {
            let message = format!(
                "{} agents, the limit of the relational executor is {MAX_ENTITIES}",
                agents.len()
            );
            let fault = Diagnostic::new(Code::LIMIT_EXCEEDED, message).at(set.span, "in this agent set");
            return Err(match fallback {
                None => fault.help("let the executor be chosen: `--executor auto`"),
                Some(reason) => fault
                    .note(reason)
                    .help("`logicity check` tells which rules the dense executor cannot take, and why"),
            });
        }
        let pool = start_threads(threads)?;
        let report = TickReport {
            tick: 0,
            agents: agents.iter().map(AgentTick::resting).collect(),
        };
        Ok(Simulation {
            split,
            places,
            seed,
            tick: 0,
            decisions: Decisions::new(agents.len(), to_count.len()),
            given: vec![None; agents.len()],
            positions: agents.iter().map(Position::of).collect(),
            agents,
            dense,
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

    /// Starts a new run with other agents, as many and named alike: tick 0 with this seed, as a new simulation with them would. Those
    /// of before take their places in the list.
    ///
    /// # Panics
    /// If they are more or fewer than before, or named otherwise.
    pub fn restart(&mut self, seed: Seed, agents: &mut Vec<Agent>) {
        assert!(agents.len() == self.agents.len(), "more or fewer agents");
        std::mem::swap(&mut self.agents, agents);
        for ((agent, before), position) in self.agents.iter().zip(agents).zip(&mut self.positions) {
            assert!(agent.name() == before.name(), "agents named otherwise");
            *position = Position::of(agent);
        }
        self.seed = seed;
        (self.tick, self.stated) = (0, None);
        if let Some(dense) = &mut self.dense {
            dense.restart(self.world.map(), &self.agents);
        }
        self.decisions.clear();
        self.report.tick = 0;
        for (done, agent) in self.report.agents.iter_mut().zip(&self.agents) {
            *done = AgentTick::resting(agent);
        }
    }

    /// Places the agents of the split as a new simulation with this seed would, in a list of other agents, whose memory is used again.
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

    /// Where agents start and arrive.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// The cancellation request that long work of this simulation polls.
    pub fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// What does not change.
    pub fn world(&self) -> &Arc<World> {
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
    ///
    /// # Errors
    /// As [`CityMap::semantic`].
    pub fn semantic_map(&self) -> Result<Array3<f32>, Diagnostic> {
        let cells: Vec<Cell> = self.agents.iter().map(|agent| agent.cell).collect();
        self.world.map().semantic(&cells)
    }

    /// How many ticks have passed.
    pub fn now(&self) -> u64 {
        self.tick
    }

    /// The last tick; before the first, agents that rest.
    pub fn report(&self) -> &TickReport {
        &self.report
    }

    /// What evaluates the rules: dense or relational.
    pub fn executor(&self) -> Executor {
        match self.dense {
            Some(_) => Executor::Dense,
            None => Executor::Relational,
        }
    }

    /// Why the relational executor evaluates the rules although it was not asked for: a sentence without a full stop.
    pub fn fallback(&self) -> Option<&str> {
        self.fallback.as_deref()
    }

    /// On how many threads it goes.
    pub fn threads(&self) -> usize {
        self.threads.as_ref().map_or(1, ThreadPool::current_num_threads)
    }

    /// The clauses whose firings can be counted, in the order of the text.
    pub fn clauses(&self) -> &[ClauseId] {
        &self.clauses
    }

    /// How many rows each clause derived in the last tick, in the order of [`Simulation::clauses`]; empty unless
    /// [`Settings::count_firings`] is set.
    pub fn firings(&self) -> &[usize] {
        &self.decisions.firings
    }

    /// The action clauses that fired for an agent in the last tick: positions in [`Simulation::clauses`]. None unless
    /// [`Settings::count_firings`] is set.
    pub fn fired(&self, agent: usize) -> impl Iterator<Item = usize> {
        self.decisions.fired(agent)
    }

    /// Lets every agent decide and move. `controls` replaces the decisions of the agents it names by their positions in the list; of
    /// several for one agent the last counts.
    ///
    /// # Errors
    /// `invalid-value` for a position that no agent has; `limit-exceeded` for rules that derive more than the relational executor
    /// allows, or too many agents in one place for the dense one. The city is then as before.
    pub fn tick(&mut self, controls: &[(usize, Action)]) -> Result<&TickReport, Diagnostic> {
        self.tick_watched(controls, |_| ())
    }

    /// The same; `ended` is told when a part of the work is done.
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
            return Err(Diagnostic::new(Code::INVALID_VALUE, message));
        }
        let draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        let map = self.world.map();
        match &mut self.dense {
            Some(dense) => {
                let decisions = &mut self.decisions;
                match &self.threads {
                    Some(pool) => pool.install(|| dense.decide(map, draws, decisions)),
                    None => dense.decide(map, draws, decisions),
                }?;
            }
            None => self.decide_by_facts(draws)?,
        }
        ended(Phase::Decide);
        self.advance(controls);
        ended(Phase::Move);
        if let Some(dense) = &mut self.dense {
            let (map, positions) = (self.world.map(), &self.positions);
            match &self.threads {
                Some(pool) => pool.install(|| dense.follow(map, positions)),
                None => dense.follow(map, positions),
            }
        }
        ended(Phase::Note);
        self.report.tick = self.tick;
        self.tick += 1;
        Ok(&self.report)
    }

    /// Everybody does what was decided.
    fn advance(&mut self, controls: &[(usize, Action)]) {
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
        let controlled = &*given;
        let vocabulary = &world.vocabulary;
        let surroundings = Surroundings {
            router: &world.router,
            places: &*places,
            seed: self.seed,
            tick: self.tick,
        };
        let step = |index: usize, agent: &mut Agent, position: &mut Position, done: &mut AgentTick| {
            let derived = decisions.derived(index);
            let action = controlled[index].unwrap_or_else(|| vocabulary.decide(derived));
            *done = AgentTick {
                heading: agent.heading,
                derived: vocabulary.before_default(derived),
                action,
                moved: advance(agent, index, action, &surroundings),
            };
            *position = Position::of(agent);
        };
        match &self.threads {
            Some(pool) => pool.install(|| {
                (agents.par_iter_mut().with_min_len(1024))
                    .zip(positions)
                    .zip(&mut report.agents)
                    .enumerate()
                    .for_each(|(index, ((agent, position), done))| step(index, agent, position, done));
            }),
            None => {
                let agents = agents.iter_mut().zip(positions).zip(&mut report.agents);
                for (index, ((agent, position), done)) in agents.enumerate() {
                    step(index, agent, position, done);
                }
            }
        }
        for &(position, _) in controls {
            given[position] = None;
        }
    }

    /// Decides by the relational executor.
    fn decide_by_facts(&mut self, draws: Draws) -> Result<(), Diagnostic> {
        let world = &*self.world;
        let entities: Vec<Entity<'_>> = self.agents.iter().map(entity).collect();
        let (vocabulary, view) = (&world.vocabulary, world.scenario.view);
        let unread = |index: usize| !vocabulary.is_read(index);
        let facts = ground_with(vocabulary, world.map(), view, &entities, &draws, unread, &self.cancel);
        let facts = facts.ok_or_else(Diagnostic::cancelled)?;
        let state = (self.state).get_or_insert_with(|| ground_state(&self.world, &self.agents));
        state
            .set_with(&facts, &self.cancel)
            .map_err(|error| error.diagnostic(self.world.program.rules()))?;
        self.stated = Some(draws.time);
        self.decisions.clear();
        for agent in 0..self.agents.len() {
            for action in state.derived(&self.world.vocabulary, agent).iter() {
                self.decisions.add(agent, action);
            }
        }
        if !self.decisions.firings.is_empty() {
            let rules = self.world.program.rules();
            for (index, &clause) in self.clauses.iter().enumerate() {
                let rows = state.session().fired(clause);
                let head = rules.clauses[clause.index()].head.relation;
                if (Action::ALL.into_iter()).any(|action| self.world.vocabulary.action(action) == Some(head)) {
                    for agent in rows.iter().filter_map(|row| state.entity(row[0])) {
                        self.decisions.add_fired(agent, index);
                    }
                }
                self.decisions.firings[index] = rows.len();
            }
        }
        Ok(())
    }

    /// The state on which the last tick was decided, as facts of a session; before the first tick, the present one.
    ///
    /// # Errors
    /// `limit-exceeded` for more than [`MAX_ENTITIES`] agents, or rules that derive too much.
    pub fn snapshot(&mut self) -> Result<Snapshot<'_>, Diagnostic> {
        let tick = self.report.tick;
        if self.stated != Some(tick) {
            if self.agents.len() > MAX_ENTITIES {
                let message = format!(
                    "facts about pairs of {} agents; the limit is {MAX_ENTITIES} agents",
                    self.agents.len()
                );
                return Err(Diagnostic::new(Code::LIMIT_EXCEEDED, message));
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

    /// The base facts on which the last tick was decided: of the predicates, by their positions in the vocabulary, for which
    /// `wanted` holds.
    pub fn facts(&self, wanted: impl Fn(usize) -> bool) -> Facts {
        self.facts_with(wanted, &Cancel::never()).expect("never cancelled")
    }

    /// Cancellable variant of [`facts`](Simulation::facts).
    ///
    /// # Errors
    /// `cancelled` on cancellation.
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
            cancel,
        );
        facts.ok_or_else(Diagnostic::cancelled)
    }

    /// Evaluates the rules on other facts, by the relational executor and its differences.
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much.
    pub fn evaluate(&mut self, facts: &Facts) -> Result<(), Diagnostic> {
        self.stated = None;
        let state = (self.state).get_or_insert_with(|| ground_state(&self.world, &self.agents));
        (state.set_with(facts, &self.cancel)).map_err(|error| error.diagnostic(self.world.program.rules()))
    }

    /// Computes all facts about the present state that the rules can ask for, as bits; how many there are. `None` unless the dense
    /// executor looks at the whole city at once.
    pub fn count_facts(&mut self) -> Option<u64> {
        let draws = Draws {
            seed: self.seed,
            time: self.tick,
        };
        self.dense.as_mut()?.count_facts(draws)
    }

    /// The agents as they were when the last tick was decided.
    fn decided_entities(&self) -> Vec<Entity<'_>> {
        let before = |(agent, done): (_, &AgentTick)| Entity {
            at: done.moved.from,
            heading: done.heading,
            ..entity(agent)
        };
        self.agents.iter().zip(&self.report.agents).map(before).collect()
    }
}

/// Threads, if they are more than one.
///
/// # Errors
/// `limit-exceeded` if so many cannot be started.
pub(crate) fn start_threads(threads: usize) -> Result<Option<ThreadPool>, Diagnostic> {
    let pool = (threads > 1).then(|| ThreadPoolBuilder::new().num_threads(threads).build());
    pool.transpose().map_err(|error| {
        let message = format!("{threads} threads cannot be started: {error}");
        Diagnostic::new(Code::LIMIT_EXCEEDED, message).help("take fewer")
    })
}

/// The interval between polls of the thread that waits for a pool.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs work in a pool while the calling thread waits and calls `poll`. Some callbacks work on the calling thread only;
/// for example, Python checks for signals on its main thread.
pub(crate) fn run_polled<R: Send>(pool: &ThreadPool, poll: &(dyn Fn() + Sync), work: impl FnOnce() -> R + Send) -> R {
    let (done, result) = mpsc::channel();
    let received = pool.in_place_scope(|scope| {
        scope.spawn(move |_| done.send(work()).expect("the caller waits for it"));
        loop {
            match result.recv_timeout(POLL_INTERVAL) {
                Err(mpsc::RecvTimeoutError::Timeout) => poll(),
                received => break received,
            }
        }
    });
    received.expect("the scope resumes a panic of the work")
}

/// Independent cities that go at the same pace. Each goes as it would alone.
pub struct Batch {
    cities: Vec<Simulation>,
    threads: Option<ThreadPool>,
}

impl Batch {
    /// Cities, and on how many threads they go; they had better have one thread each themselves.
    ///
    /// # Errors
    /// `limit-exceeded` if so many threads cannot be started.
    pub fn new(cities: Vec<Simulation>, threads: usize) -> Result<Batch, Diagnostic> {
        Ok(Batch {
            cities,
            threads: start_threads(threads)?,
        })
    }

    /// The cities.
    pub fn cities(&self) -> &[Simulation] {
        &self.cities
    }

    /// The cities, for example to place one afresh.
    pub fn cities_mut(&mut self) -> &mut [Simulation] {
        &mut self.cities
    }

    /// A tick of every city. `controls` tells for each, by its position, whose decisions are given, see [`Simulation::tick`].
    ///
    /// # Errors
    /// As [`Simulation::tick`], of the first city that has one. The others have gone on.
    pub fn tick<'c>(&mut self, controls: impl Fn(usize) -> &'c [(usize, Action)] + Sync) -> Result<(), Diagnostic> {
        let fault = |(position, city): (usize, &mut Simulation)| Some((position, city.tick(controls(position)).err()?));
        let faults = match &self.threads {
            Some(pool) => pool.install(|| {
                let faults = self.cities.par_iter_mut().enumerate().filter_map(fault);
                faults.min_by_key(|(position, _)| *position)
            }),
            None => (self.cities.iter_mut().enumerate().filter_map(fault)).min_by_key(|(position, _)| *position),
        };
        faults.map_or(Ok(()), |(_, fault)| Err(fault))
    }
}

impl AgentTick {
    /// Of an agent before the first tick.
    fn resting(agent: &Agent) -> AgentTick {
        AgentTick {
            heading: agent.heading,
            derived: Actions::default(),
            action: Action::Stop,
            moved: Moved {
                from: agent.cell,
                to: agent.cell,
                reason: MoveReason::Resting,
                replanned: false,
            },
        }
    }
}

fn ground_state(world: &World, agents: &[Agent]) -> GroundState {
    let names: Vec<String> = agents.iter().map(|agent| agent.name().to_string()).collect();
    GroundState::new(&world.program, &world.vocabulary, names.iter().map(String::as_str))
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
