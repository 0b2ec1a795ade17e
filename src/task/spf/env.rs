//! The environment: one city with externally controlled cars.

use crate::cancel::Cancel;
use crate::city::Agent;
use crate::city::{Action, AgentKind, Split};
use crate::config::{Shaping, ShieldMode};
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::{Actions, Observer, SensorModel, Sensors, Settings, Shield, ShieldState, Simulation, Verdict};
use crate::task::spf::reward::{ShapedStep, shaping};
use crate::task::spf::{Episode, SpfTask};
use crate::yaml::codes;
use smallvec::SmallVec;
use std::sync::Arc;

impl Purpose {
    /// An ego of an episode: its priority and concepts; index: the number of the ego.
    pub const EGO: Purpose = Purpose::new(7);

    /// The agents that take part in an episode of a curriculum.
    pub const CURRICULUM: Purpose = Purpose::new(50);
}

/// The cars under external control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlMode {
    /// The first car.
    First,
    /// The first `egos` cars of the task's configuration, or every car if it has no such key. Each is its own
    /// [`ControlledCar`].
    Egos,
}

/// A city in which the caller controls one car or several. Task, split and seed determine an episode.
pub struct Env {
    task: Arc<SpfTask>,
    city: Simulation,
    control: ControlMode,
    settings: Settings,
    /// Whether to compute the allowed actions in every state.
    judges: bool,
    controlled_cars: Vec<ControlledCar>,
    /// The sensors of the cars, with their model if they need one.
    sensors: Option<SensorsWithModel>,
    shield: Option<Arc<Shield>>,
    /// The maximum number of steps of the episode.
    horizon: u32,
    /// The reward terms of training, if the configuration has any and the agents are those of the training split.
    shaping: Option<Shaping>,
    steps: u32,
    controls: Vec<(usize, Action)>,
    /// The actions of all controlled cars in each step of the episode.
    taken: Vec<Action>,
    episode: Episode,
}

/// Sensors, and their model if they need one.
type SensorsWithModel = (Arc<Sensors>, Option<Arc<SensorModel>>);

/// A car under external control.
pub struct ControlledCar {
    observer: Observer,
    /// Cells of its route, start and goal included.
    cells: usize,
    /// The covered share of its route before the last step, for reward terms.
    covered: f64,
    derived: Actions,
    allowed: Option<Actions>,
    /// The state of the shield; `None` without one.
    shielded: Option<Box<ShieldedCar>>,
    last: Transition,
    running: bool,
}

/// What a shield does for a car.
struct ShieldedCar {
    state: ShieldState,
    /// What it says of the present state; `None` before it is asked.
    verdict: Option<Verdict>,
    /// The action that it replaced in the last step.
    replaced: Option<Action>,
    /// The clauses of its rules that this action violated.
    reasons: Vec<usize>,
}

/// The result of an action.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transition {
    /// Reward of the task, which evaluations sum up.
    pub reward: f64,
    /// What the reward terms of training add to it; 0 in the splits `val` and `test`.
    pub shaping: f64,
    /// Whether the episode has ended because the car is at its goal or violated a rule.
    pub terminated: bool,
    /// Whether the episode has reached its horizon.
    pub truncated: bool,
    /// Whether the car is at its goal without a violation.
    pub success: bool,
    /// The violated clauses, by their positions in [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub broken: Vec<usize>,
}

impl Transition {
    /// Returns the reward for a learner: that of the task, and the reward terms of training.
    pub fn shaped_reward(&self) -> f64 {
        self.reward + self.shaping
    }
}

impl ControlledCar {
    /// Returns its observer.
    pub fn observer(&self) -> &Observer {
        &self.observer
    }

    /// Returns the position of the car in the list of agents.
    pub fn agent(&self) -> usize {
        self.observer.ego()
    }

    /// Returns the number of cells of its route when the episode began, start and goal included.
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// Returns the actions that the rules derive for it now, before the default. If there are any, the next step is
    /// *constrained*.
    pub fn derived(&self) -> Actions {
        self.derived
    }

    /// Returns the actions that violate no clause now; `None` without [`Env::judge_actions`].
    pub fn allowed(&self) -> Option<Actions> {
        self.allowed
    }

    /// Returns what the shield says of the present state, after [`Env::ask_shield`].
    pub fn verdict(&self) -> Option<&Verdict> {
        self.shielded.as_ref()?.verdict.as_ref()
    }

    /// Returns the action that the shield replaced in the last step, and the clauses of the shield's rules that this
    /// action violated, as positions in their [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub fn replaced(&self) -> Option<(Action, &[usize])> {
        let shielded = self.shielded.as_ref()?;
        Some((shielded.replaced?, &shielded.reasons))
    }

    /// Returns the result of its last action.
    pub fn last(&self) -> &Transition {
        &self.last
    }

    /// Returns whether its episode is running.
    pub fn is_running(&self) -> bool {
        self.running
    }
}

impl Env {
    /// Returns an environment over the agents of a split. Call [`Env::reset`] next.
    ///
    /// # Errors
    /// `unknown-split`, `no-start-cell`, `no-route`, `limit-exceeded`: see [`Simulation::new`]; `invalid-value` if the
    /// split has no car, or fewer than the task has egos.
    pub fn new(task: Arc<SpfTask>, split: Split, control: ControlMode) -> Result<Env, Diagnostic> {
        Env::new_with(task, split, control, &Cancel::never())
    }

    /// Cancellable variant of [`Env::new`]. The environment keeps `cancel`, so its later work is cancellable, too.
    /// After cancellation it needs a reset.
    ///
    /// # Errors
    /// As [`Env::new`]; `cancelled` on cancellation.
    pub fn new_with(
        task: Arc<SpfTask>,
        split: Split,
        control: ControlMode,
        cancel: &Cancel,
    ) -> Result<Env, Diagnostic> {
        Env::configured(task, split, control, Settings::default(), cancel)
    }

    /// Variant of `new` with settings for the simulation.
    ///
    /// # Errors
    /// As [`Env::new_with`].
    pub(super) fn configured(
        task: Arc<SpfTask>,
        split: Split,
        control: ControlMode,
        settings: Settings,
        cancel: &Cancel,
    ) -> Result<Env, Diagnostic> {
        let mut env = Env::without_sensors_and_shield(task, split, control, settings, cancel)?;
        if let Some(sensors) = env.task.sensors() {
            let model = env.task.sensor_model(cancel)?.cloned();
            env.sensors = Some((Arc::clone(sensors), model));
            env.controlled_cars = (env.controlled_cars.into_iter())
                .map(|car| ControlledCar {
                    observer: sensed(car.observer, env.sensors.as_ref()),
                    ..car
                })
                .collect();
        }
        env.set_shield(env.task.shield().cloned())?;
        Ok(env)
    }

    /// Variant of `configured` without sensors and shield.
    pub(super) fn without_sensors_and_shield(
        task: Arc<SpfTask>,
        split: Split,
        control: ControlMode,
        settings: Settings,
        cancel: &Cancel,
    ) -> Result<Env, Diagnostic> {
        let city = Simulation::new_with(Arc::clone(task.world()), split, Seed(0), settings, cancel)?;
        let agents = city.agents().iter().enumerate();
        let cars = agents
            .filter(|(_, agent)| agent.kind_id == AgentKind::Car.into())
            .map(|(position, _)| position);
        let driven = cars.take(match control {
            ControlMode::First => 1,
            ControlMode::Egos => task.config().egos.map_or(usize::MAX, |egos| egos.value as usize),
        });
        let controlled_car = |ego| ControlledCar {
            observer: Observer::new(Arc::clone(task.oracle()), ego),
            cells: 0,
            covered: 0.0,
            derived: Actions::default(),
            allowed: None,
            shielded: None,
            last: Transition::default(),
            running: false,
        };
        let controlled_cars: Vec<ControlledCar> = driven.map(controlled_car).collect();
        if let Some(egos) = (task.config().egos)
            .filter(|egos| control == ControlMode::Egos && controlled_cars.len() < egos.value as usize)
        {
            let (split, count) = (split.name(), controlled_cars.len());
            let plural = if count == 1 { "" } else { "s" };
            let message = format!("the split `{split}` has {count} car{plural}, not {}", egos.value);
            let fault = Diagnostic::new(codes::INVALID_VALUE, message).at(egos.span, "for these egos");
            return Err(fault.help("lower `egos`, or add cars to the split"));
        }
        if controlled_cars.is_empty() {
            let message = format!("the split `{}` has no car to control", split.name());
            return Err(Diagnostic::new(codes::INVALID_VALUE, message).at(task.config().span, "for this task"));
        }
        let shaping = task.config().reward.shaping;
        Ok(Env {
            horizon: task.config().horizon,
            shaping: (split == Split::Train && !shaping.is_none()).then_some(shaping),
            steps: 0,
            controls: Vec::with_capacity(controlled_cars.len()),
            taken: Vec::new(),
            episode: Episode::of(0, city.agents()),
            control,
            settings,
            judges: false,
            controlled_cars,
            sensors: None,
            shield: None,
            city,
            task,
        })
    }

    /// Returns the task.
    pub fn task(&self) -> &Arc<SpfTask> {
        &self.task
    }

    /// Returns which cars the caller controls.
    pub fn control(&self) -> ControlMode {
        self.control
    }

    /// Returns the city.
    pub fn city(&self) -> &Simulation {
        &self.city
    }

    /// Returns the city for queries that need `&mut`; only the environment may advance or restart it.
    pub fn city_mut(&mut self) -> &mut Simulation {
        &mut self.city
    }

    /// Returns the controlled cars, in the order of the list of agents.
    pub fn controlled_cars(&self) -> &[ControlledCar] {
        &self.controlled_cars
    }

    /// Returns whether the episode of any controlled car is running.
    pub fn is_running(&self) -> bool {
        self.controlled_cars.iter().any(ControlledCar::is_running)
    }

    /// Returns the number of steps so far.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Returns the maximum number of steps of the episode.
    pub fn horizon(&self) -> u32 {
        self.horizon
    }

    /// Returns the start of the episode.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Returns the actions of each step so far, one per controlled car. [`Env::episode`] and these actions determine
    /// the state.
    pub fn taken(&self) -> std::slice::ChunksExact<'_, Action> {
        self.taken.chunks_exact(self.controlled_cars.len())
    }

    /// Computes from the next state on which actions violate no clause; see [`ControlledCar::allowed`].
    pub fn judge_actions(&mut self) {
        self.judges = true;
    }

    /// Returns the shield, which [`Env::step_shielded`] asks.
    pub fn shield(&self) -> Option<&Arc<Shield>> {
        self.shield.as_ref()
    }

    /// Replaces the shield, also during an episode. Call [`Env::ask_shield`] next.
    ///
    /// # Errors
    /// `invalid-value` if the shield is probabilistic and the sensors output facts, or if it has another layout of
    /// observations.
    pub fn set_shield(&mut self, shield: Option<Arc<Shield>>) -> Result<(), Diagnostic> {
        if let Some(shield) = &shield {
            shield.check(self.task.oracle(), self.task.config())?;
        }
        for car in &mut self.controlled_cars {
            car.shielded = shield.as_ref().map(|shield| {
                Box::new(ShieldedCar {
                    state: ShieldState::new(shield),
                    verdict: None,
                    replaced: None,
                    reasons: Vec::new(),
                })
            });
        }
        self.shield = shield;
        Ok(())
    }

    /// Replaces the shield, also during an episode, and asks it.
    ///
    /// # Errors
    /// As [`Env::set_shield`] and [`Env::ask_shield`]. Then the environment keeps its shield.
    pub fn replace_shield(&mut self, shield: Option<Arc<Shield>>) -> Result<(), Diagnostic> {
        let before = self.shield.clone();
        let done = self.set_shield(shield).and_then(|()| self.ask_shield());
        if done.is_err() {
            self.set_shield(before)?;
            self.ask_shield()?;
        }
        done
    }

    /// Asks the shield, if there is one, what it permits each car in the present state; see
    /// [`ControlledCar::verdict`].
    ///
    /// # Errors
    /// `limit-exceeded` if the shield's rules derive too many rows, or its probabilities are too complex.
    pub fn ask_shield(&mut self) -> Result<(), Diagnostic> {
        let Some(shield) = &self.shield else { return Ok(()) };
        for car in &mut self.controlled_cars {
            if let Some(shielded) = &mut car.shielded
                && shielded.verdict.is_none()
                // Before the first episode, nothing is observed.
                && car.observer.entities().len() > 0
            {
                shielded.verdict = Some(shielded.state.judge(shield, &mut car.observer, &self.city)?);
            }
        }
        Ok(())
    }

    /// Variant of [`Env::step`] for proposed actions. The shield replaces each one that it does not permit. A joint
    /// shield replaces the fewest actions with which the joint action is safe.
    ///
    /// # Errors
    /// As [`Env::step`] and [`Env::ask_shield`]; `invalid-value` if the mode of the shield is `mask`, and it does not
    /// permit an action. Then no car moves.
    ///
    /// # Panics
    /// If the number of actions differs from that of controlled cars.
    pub fn step_shielded(&mut self, proposed: &[Action]) -> Result<(), Diagnostic> {
        self.ask_shield()?;
        let Some(shield) = &self.shield else {
            return self.step(proposed);
        };
        if shield.config().mode == ShieldMode::Joint {
            let shield = Arc::clone(shield);
            return self.step_jointly(&shield, proposed);
        }
        let mut executed: SmallVec<[Action; 4]> = SmallVec::from_slice(proposed);
        for (car, action) in self.controlled_cars.iter_mut().zip(&mut executed) {
            let can_choose = car.running && !self.city.agents()[car.agent()].is_parked();
            let Some(shielded) = car.shielded.as_deref_mut() else {
                continue;
            };
            shielded.replaced = None;
            let forbidding = (shielded.verdict.as_ref()).filter(|verdict| !verdict.permitted.contains(*action));
            let Some(verdict) = forbidding.filter(|_| can_choose) else {
                continue;
            };
            if shield.config().mode == ShieldMode::Mask {
                let name = self.task.world().vocabulary.actions().name(*action);
                return Err(shield.forbidden(name, verdict.permitted));
            }
            let broken = (shielded.state).violations(shield, &car.observer, &self.city, *action)?;
            shielded.reasons.clear();
            shielded.reasons.extend_from_slice(broken);
            shielded.replaced = Some(*action);
            *action = verdict.preferred;
        }
        self.step(&executed)
    }

    /// Takes the safe joint action that is nearest to the proposed one.
    fn step_jointly(&mut self, shield: &Shield, proposed: &[Action]) -> Result<(), Diagnostic> {
        let mut executed: SmallVec<[Action; 4]> = SmallVec::from_slice(proposed);
        let mut egos = Vec::with_capacity(proposed.len());
        let mut running: SmallVec<[usize; 4]> = SmallVec::new();
        for (number, car) in self.controlled_cars.iter_mut().enumerate() {
            let ControlledCar { observer, shielded, .. } = car;
            let Some(shielded) = shielded else { continue };
            shielded.replaced = None;
            shielded.reasons.clear();
            if car.running {
                egos.push((&mut shielded.state, &*observer, proposed[number]));
                running.push(number);
            }
        }
        let nearest = shield.nearest_safe(&mut egos, &self.city)?;
        for (number, action) in running.into_iter().zip(nearest) {
            let Some(shielded) = &mut self.controlled_cars[number].shielded else {
                continue;
            };
            if action != proposed[number] {
                shielded.replaced = Some(proposed[number]);
                shielded.reasons.extend_from_slice(shielded.state.reasons());
                executed[number] = action;
            }
        }
        self.step(&executed)
    }

    /// Begins a random episode: draws starts and goals for all agents, and priority and concepts for the egos if the
    /// configuration says so. The egos are the first car, or as many cars as `egos` of the configuration says.
    ///
    /// # Errors
    /// `no-start-cell`, `no-route`, `limit-exceeded`. The environment then needs another reset.
    pub fn reset(&mut self, seed: u64) -> Result<(), Diagnostic> {
        self.reset_with(seed, None)
    }

    /// Variant of [`Env::reset`] with `agents` agents: the first car, and others that the seed selects. They start as
    /// in the episode with all agents. `None` means all.
    ///
    /// # Errors
    /// As [`Env::reset`].
    pub fn reset_with(&mut self, seed: u64, agents: Option<usize>) -> Result<(), Diagnostic> {
        self.horizon = self.task.config().horizon;
        let (task, split) = (&self.task, self.city.split());
        let count = match self.control {
            ControlMode::First => 1,
            ControlMode::Egos => task.config().egos.map_or(1, |egos| egos.value as usize),
        };
        let egos = self.controlled_cars.iter().take(count).map(ControlledCar::agent);
        let draw_egos = |agents: &mut [Agent]| {
            for (number, ego) in (0..).zip(egos) {
                draw_ego(task, (split, seed, number), &mut agents[ego]);
            }
        };
        if agents.is_none() && self.city.has_all_agents() {
            self.city.restart_drawn(Seed(seed), draw_egos)?;
            self.note(seed);
            return self.start();
        }
        let mut drawn = Vec::new();
        self.city.draw_agents(Seed(seed), &mut drawn)?;
        draw_egos(&mut drawn);
        if let Some(agents) = agents {
            select(seed, agents, &mut drawn);
        }
        self.begin(seed, drawn)
    }

    /// Begins a given episode. Its horizon is [`Episode::horizon`]. In the mode [`ControlMode::Egos`] it is the
    /// configured horizon, because the oracle's steps are those of the first car.
    ///
    /// # Errors
    /// `invalid-episode` if its agents differ from those of the split, have concepts without a predicate for their
    /// type, or have no route; `limit-exceeded`.
    pub fn reset_to(&mut self, episode: &Episode) -> Result<(), Diagnostic> {
        let agents = episode.place(&self.task, self.city.split(), self.control)?;
        self.horizon = match self.control {
            ControlMode::First => episode.horizon(self.task.config()),
            ControlMode::Egos => self.task.config().horizon.max(1),
        };
        self.begin(episode.seed, agents)?;
        self.episode.oracle.clone_from(&episode.oracle);
        Ok(())
    }

    /// Continues the episode after `steps` steps with these agents, in states that they could have then. The previous
    /// agents are swapped into `agents`. [`Env::taken`] lacks the actions of the steps before.
    ///
    /// # Errors
    /// As [`Simulation::place`]; `limit-exceeded` if the rules derive too many rows.
    pub(super) fn place(&mut self, steps: u32, agents: &mut Vec<Agent>) -> Result<(), Diagnostic> {
        self.city.place(steps.into(), agents)?;
        self.steps = steps;
        self.taken.clear();
        for controlled_car in &mut self.controlled_cars {
            controlled_car.running = true;
            controlled_car.last = Transition::default();
        }
        self.look()
    }

    /// Sets the horizon of the running episode, at least 1 step.
    pub fn set_horizon(&mut self, steps: u32) {
        self.horizon = steps.max(1);
    }

    /// Begins an episode with these agents.
    fn begin(&mut self, seed: u64, mut agents: Vec<Agent>) -> Result<(), Diagnostic> {
        let names = self.city.agents().iter().map(Agent::name);
        if names.eq(agents.iter().map(Agent::name)) {
            self.city.restart(Seed(seed), &mut agents);
            self.note(seed);
        } else {
            self.replace_agents(seed, agents)?;
        }
        self.start()
    }

    /// Updates the record of the episode from the agents that the city has just started with.
    fn note(&mut self, seed: u64) {
        self.episode.seed = seed;
        self.episode.oracle = None;
        for (noted, agent) in self.episode.agents.iter_mut().zip(self.city.agents()) {
            noted.note(agent);
        }
    }

    /// Starts the controlled cars and observes.
    fn start(&mut self) -> Result<(), Diagnostic> {
        self.steps = 0;
        self.taken.clear();
        for controlled_car in &mut self.controlled_cars {
            controlled_car.cells = self.city.agents()[controlled_car.agent()].route().steps() + 1;
            controlled_car.running = true;
            controlled_car.last = Transition::default();
            if let Some(shielded) = &mut controlled_car.shielded {
                shielded.replaced = None;
            }
            controlled_car.observer.begin(&self.city);
        }
        self.look()
    }

    /// Makes a city of these agents, where others take part than in the last episode.
    fn replace_agents(&mut self, seed: u64, agents: Vec<Agent>) -> Result<(), Diagnostic> {
        let split = self.city.split();
        let (world, cancel) = (Arc::clone(self.task.world()), self.city.cancel().clone());
        self.city = Simulation::resume(world, split, Seed(seed), self.settings, (0, agents), &cancel)?;
        self.episode = Episode::of(seed, self.city.agents());
        for controlled_car in &mut self.controlled_cars {
            // Observers know the names of agents.
            let observer = Observer::new(Arc::clone(self.task.oracle()), controlled_car.agent());
            controlled_car.observer = sensed(observer, self.sensors.as_ref());
        }
        Ok(())
    }

    /// Updates all observations, also of cars whose episode has ended.
    fn look(&mut self) -> Result<(), Diagnostic> {
        for controlled_car in &mut self.controlled_cars {
            controlled_car.observer.look(&self.city)?;
            controlled_car.observer.sense(&self.city)?;
            if let Some(shielded) = &mut controlled_car.shielded {
                shielded.verdict = None;
            }
            controlled_car.derived = controlled_car.observer.derived(&self.city)?;
            if self.judges {
                let mut allowed = Actions::default();
                let is_parked = self.city.agents()[controlled_car.agent()].is_parked();
                for action in self.task.possible_actions() {
                    let action = *action;
                    if is_parked || controlled_car.observer.violations(&self.city, action)?.is_empty() {
                        allowed.insert(action);
                    }
                }
                controlled_car.allowed = Some(allowed);
            }
        }
        Ok(())
    }

    /// Counts the clauses that apply to a controlled car now, which are those that some action violates, by how far it
    /// observes them: fully, partly, and not at all; see [`Observer::observed_clauses`].
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn observed_clauses(&mut self, controlled_car: usize) -> Result<[u32; 3], Diagnostic> {
        let (observer, actions) = (
            &mut self.controlled_cars[controlled_car].observer,
            self.task.possible_actions(),
        );
        observer.observed_clauses(&self.city, actions)
    }

    /// Returns the action that the rules want of a controlled car.
    pub fn oracle_action(&self, controlled_car: usize) -> Action {
        self.task.world().vocabulary.decide(
            Some(AgentKind::Car.into()),
            self.controlled_cars[controlled_car].derived,
        )
    }

    /// Advances the city by a tick. `actions` has one action per controlled car. The rules drive cars whose episode has
    /// ended; these cars still observe. [`ControlledCar::last`] has the results.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    ///
    /// # Panics
    /// If the number of actions differs from that of controlled cars.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), Diagnostic> {
        assert!(
            actions.len() == self.controlled_cars.len(),
            "one action for each controlled car"
        );
        self.controls.clear();
        for (controlled_car, &action) in self.controlled_cars.iter_mut().zip(actions) {
            if controlled_car.running {
                // A parked car has no choice, so its action violates no clause.
                let agent = &self.city.agents()[controlled_car.agent()];
                let (action, broken) = match agent.is_parked() {
                    true => (agent.parked_by, &[][..]),
                    false => (action, controlled_car.observer.violations(&self.city, action)?),
                };
                controlled_car.last.broken.clear();
                controlled_car.last.broken.extend_from_slice(broken);
                controlled_car.last.reward = self.task.reward(action, broken, controlled_car.cells);
                controlled_car.covered = covered(&self.city.agents()[controlled_car.agent()]);
                self.controls.push((controlled_car.agent(), action));
            }
        }
        self.city.tick(&self.controls)?;
        self.steps += 1;
        self.taken.extend_from_slice(actions);
        for controlled_car in self
            .controlled_cars
            .iter_mut()
            .filter(|controlled_car| controlled_car.running)
        {
            let agent = &self.city.agents()[controlled_car.agent()];
            let arrived = agent.at_goal();
            let last = &mut controlled_car.last;
            last.success = arrived && last.broken.is_empty();
            last.terminated = arrived || !last.broken.is_empty();
            last.truncated = !last.terminated && self.steps >= self.horizon;
            if last.truncated {
                last.reward += self.task.config().reward.overtime;
            }
            if let Some(terms) = &self.shaping {
                let step = ShapedStep {
                    covered: [controlled_car.covered, covered(agent)],
                    terminated: last.terminated,
                    success: last.success,
                };
                last.shaping = shaping(terms, step);
            }
        }
        self.look()?;
        for controlled_car in &mut self.controlled_cars {
            controlled_car.running &= !(controlled_car.last.terminated || controlled_car.last.truncated);
        }
        Ok(())
    }

    /// Exchanges working memory. It has no state between steps, so that environments that take turns can share it and
    /// keep it in the cache.
    pub fn swap_memory(&mut self, other: &mut Env) {
        self.city.swap_memory(&mut other.city);
        for (car, others) in self.controlled_cars.iter_mut().zip(&mut other.controlled_cars) {
            car.observer.swap_memory(&mut others.observer);
        }
    }

    /// Loads the addresses of what [`Env::prefetch`] reads. Returns a meaningless sum of what it reads.
    pub fn prefetch_head(&self) -> u64 {
        self.city.prefetch_head() ^ u64::from(self.horizon) ^ self.episode.seed ^ self.controlled_cars.len() as u64
    }

    /// Loads what a step uses into the cache, while other work proceeds. Returns a meaningless sum of what it reads.
    pub fn prefetch(&self) -> u64 {
        let observers = self.controlled_cars.iter().map(|car| car.observer.prefetch());
        observers.fold(self.city.prefetch(), |sum, read| sum ^ read)
    }

    /// Writes the observation of the groundings: the true atoms as [`Observer::write`] does and, if configured, the
    /// cells of the route divided by twice the side of the region, at most 1.
    ///
    /// # Panics
    /// If `out` has fewer than [`SpfTask::observation_width`] numbers.
    pub fn observe(&self, controlled_car: usize, out: &mut [f32]) {
        let controlled_car = &self.controlled_cars[controlled_car];
        controlled_car.observer.write(out);
        if self.task.config().route_length {
            let region = self.task.region(self.city.split());
            #[allow(clippy::cast_precision_loss)] // a share
            let share = controlled_car.cells as f32 / (2.0 * region as f32);
            out[self.task.oracle().width()] = share.min(1.0);
        }
    }

    /// Writes the `state` observation, [`SpfTask::state_shape`] numbers row by row; see [`Observer::write_state`].
    pub fn observe_state(&self, controlled_car: usize, out: &mut [f32]) {
        (self.controlled_cars[controlled_car].observer).write_state(&self.city, out);
    }

    /// Returns the fraction of its route that a controlled car has covered, 0 to 1.
    pub fn progress(&self, controlled_car: usize) -> f64 {
        covered(&self.city.agents()[self.controlled_cars[controlled_car].agent()])
    }
}

/// Returns the observer with sensors, if there are any.
fn sensed(observer: Observer, sensors: Option<&SensorsWithModel>) -> Observer {
    match sensors {
        Some((sensors, model)) => observer.with_sensors(Arc::clone(sensors), model.clone()),
        None => observer,
    }
}

/// Draws the priority and the concepts of an ego by its number, if the configuration says so.
fn draw_ego(task: &SpfTask, (split, seed, number): (Split, u64, u64), agent: &mut Agent) {
    let Some(ego) = &task.config().ego else { return };
    let mut stream = Seed(seed).stream(Purpose::EGO, number, 0);
    let most = ego.priority[split as usize];
    agent.priority = stream.random_range(1..=most).cast_signed();
    let sum: f64 = ego.concepts.iter().map(|(weight, _)| weight).sum();
    let mut left = stream.random::<f64>() * sum;
    // Rounding may leave a remainder after the last entry; it must not select one of weight 0.
    let mut possible = ego.concepts.iter().filter(|(weight, _)| *weight > 0.0);
    let drawn = possible.clone().find(|(weight, _)| {
        left -= weight;
        left < 0.0
    });
    let (_, concepts) = drawn.or(possible.next_back()).expect("a weight is not 0");
    agent.concepts = Arc::clone(concepts);
}

/// Keeps the first agent, which is the ego, and others up to `count`, each as probable as any (selection sampling,
/// Knuth 1997, algorithm 3.4.2 S).
fn select(seed: u64, count: usize, agents: &mut Vec<Agent>) {
    let mut stream = Seed(seed).stream(Purpose::CURRICULUM, 0, 0);
    let (mut left, mut wanted) = (agents.len(), count.max(1));
    agents.retain(|_| {
        let is_ego = wanted == count.max(1);
        let takes = is_ego || stream.random_range(0..left) < wanted;
        left -= 1;
        wanted -= usize::from(takes);
        takes
    });
}

/// Returns the fraction of its route that an agent has covered, 0 to 1.
#[allow(clippy::cast_precision_loss)] // a share
fn covered(agent: &Agent) -> f64 {
    agent.position() as f64 / (agent.route().steps().max(1)) as f64
}
