//! Safe Path Following (SPF): an ego car follows its route by choosing a speed at every step, without violating a rule.
//!
//! ```text
//! Scenario (task:) + World -> SpfTask (immutable, shared) -> Env: reset, step -> Env, Env, ... in a VectorEnv
//!                                                              ^
//!                                               Episode, drawn or recorded (EpisodeSet)
//! ```
//!
//! At every step the ego observes the true atoms about itself and a few entities in its view, and takes an
//! [action](crate::city::Action). If a clause derives another action for it, the ego violates the rule and the episode
//! ends with the penalty, undivided. Otherwise the reward of the step is that of its action, divided by four times the
//! cells of the route. The episode also ends at the goal. At the horizon it is truncated, with the overtime penalty.
//!
//! [`rollouts`] runs a built-in policy on an episode; a [`BatchEvaluator`] runs an external one on a whole set;
//! [`Baseline`] has the results of the random policy. [`summarize`] computes the paper's rates and score over many
//! episodes. A [`VectorEnv`] steps many environments together. [`pddl`] writes the task for planners, and a [`Planner`]
//! searches the city itself. [`explain`] explains what the rules want, and [`record`]
//! writes the trace of an episode.

pub mod codes;
mod env;
mod episode;
mod evaluate;
mod explain;
mod lookahead;
mod metrics;
pub mod pddl;
mod reward;
mod rollout;
mod search;
mod sensor_model;
mod trace;
mod vector;

pub use env::{ControlMode, ControlledCar, Env, Transition};
pub use episode::{Episode, EpisodeAgent, EpisodeSet, MapIdentity, OracleRun};
pub use evaluate::{Baseline, BatchEvaluator, RANDOM_RUNS};
pub use explain::{describe, explain, explain_shield};
pub use metrics::{ActionRate, JointRates, Rate, Score, Summary, summarize};
pub use rollout::{
    DRAWS_MAX, EPISODE_SHARDS, EpisodeShard, Policy, Rollout, make_episodes, reset_demanding, rollout, rollouts,
    steps_by_action,
};
pub use search::{Planned, Planner, SearchBounds};
pub use trace::{Origin, RecordError, record};
pub use vector::{Autoreset, Begin, EpisodeSource, Info, ObservationKind, Outcome, SubEnv, VectorEnv};
pub use vector::{Ending, Layer, PolicyNetwork, Trajectories};

use crate::city::{Action, AgentKind, AgentSet, Split};
use crate::config::{CurriculumStage, EntityOrder, Scenario, SpfConfig};
use crate::datalog::explain::ExplanationPrinter;
use crate::diag::{Diagnostic, Sources, did_you_mean, listed};
use crate::sim::{Observer, Oracle, SensorModel, Sensors, Shield, World};
use crate::yaml;
use std::sync::{Arc, OnceLock};

/// Safe Path Following in one world. Immutable and shared by all its environments.
pub struct SpfTask {
    oracle: Arc<Oracle>,
    config: SpfConfig,
    sensors: Option<Arc<Sensors>>,
    shield: Option<Arc<Shield>>,
    /// See [`SpfTask::sensor_model`].
    sensor_model: OnceLock<Arc<SensorModel>>,
    /// For each constraint of the oracle, its label and the reward for violating it.
    constraints: Vec<(String, f64)>,
    /// The actions that an ego, which is a car, can take.
    possible: Vec<Action>,
}

impl SpfTask {
    /// Returns the task of the world's configuration. `sources` are those of the rules and the configuration.
    ///
    /// # Errors
    /// `missing-key` if the configuration has no task, `invalid-value` if it names an unknown clause.
    pub fn new(world: Arc<World>, sources: &Sources) -> Result<SpfTask, Vec<Diagnostic>> {
        let scenario = &world.scenario;
        let Some(config) = scenario.task.clone() else {
            let message = format!("the configuration `{}` has no `task`", scenario.name);
            let fault = Diagnostic::new(yaml::codes::MISSING_KEY, message);
            return Err(vec![
                fault.help("add one, for example `task: configs/tasks/expert.yaml`"),
            ]);
        };
        let oracle = Oracle::new(Arc::clone(&world), config.entities as usize).map_err(|fault| vec![fault])?;
        let oracle = oracle.nearest_first(config.order == EntityOrder::Nearest);
        let printer = ExplanationPrinter::new(world.program.rules(), &world.program.rules().symbols, sources);
        let labels: Vec<String> = oracle
            .constraints()
            .iter()
            .map(|constraint| printer.label(constraint.clause))
            .collect();
        let unknown = config
            .reward
            .clauses
            .iter()
            .filter(|(label, _)| !labels.contains(&label.value));
        let mut faults: Vec<Diagnostic> = unknown
            .map(|(label, _)| {
                let message = format!("no clause that derives an action has the label `{}`", label.value);
                let fault =
                    Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(label.span, "the reward for violating it");
                match did_you_mean(&label.value, labels.iter().map(String::as_str)) {
                    Some(near) => fault.help(format!("did you mean `{near}`?")),
                    None => fault.help(format!("the labels are: {}", listed(&labels))),
                }
            })
            .collect();
        faults.extend(too_large_stages(scenario, &config));
        faults.extend(too_many_egos(scenario, &config));
        if !faults.is_empty() {
            return Err(faults);
        }
        let reward = |label: &str| {
            let own = config.reward.clauses.iter().find(|(given, _)| given.value == label);
            own.map_or(config.reward.violation, |(_, reward)| *reward)
        };
        let constraints = labels.iter().map(|label| (label.clone(), reward(label))).collect();
        let table = &scenario.actions.table;
        let sensors = config.sensors.clone().map(|sensors| Arc::new(oracle.sensors(sensors)));
        let oracle = Arc::new(oracle);
        let shield = (config.shield.as_ref())
            .map(|given| {
                let shield = Shield::new(Arc::clone(&oracle), given.value)?;
                shield.check(&oracle, &config)?;
                Ok(Arc::new(shield))
            })
            .transpose();
        let at = |fault: Diagnostic| match (&fault.primary, &config.shield) {
            (None, Some(shield)) => fault.at(shield.span, "for this shield"),
            _ => fault,
        };
        Ok(SpfTask {
            shield: shield.map_err(|fault| vec![at(fault)])?,
            sensors,
            sensor_model: OnceLock::new(),
            possible: table
                .all()
                .filter(|&action| table.can_take(AgentKind::Car, action))
                .collect(),
            oracle,
            constraints,
            config,
        })
    }

    /// Returns the city and its rules.
    pub fn world(&self) -> &Arc<World> {
        self.oracle.world()
    }

    /// Returns which cars evaluations and learners control: the egos that the configuration counts, or the first car.
    pub fn control(&self) -> ControlMode {
        match self.config.egos {
            Some(_) => ControlMode::Egos,
            None => ControlMode::First,
        }
    }

    /// Returns the number of cars that evaluations and learners control.
    pub fn evaluated_egos(&self) -> usize {
        self.config.egos.map_or(1, |egos| egos.value as usize)
    }

    /// Returns the actions that an ego can take, in the order of the action table.
    pub fn possible_actions(&self) -> &[Action] {
        &self.possible
    }

    /// Returns the oracle, which decides and finds violations.
    pub fn oracle(&self) -> &Arc<Oracle> {
        &self.oracle
    }

    /// Returns the configuration of the task.
    pub fn config(&self) -> &SpfConfig {
        &self.config
    }

    /// Returns the sensors of the ego, if configured.
    pub fn sensors(&self) -> Option<&Arc<Sensors>> {
        self.sensors.as_ref()
    }

    /// Returns whether others may tell the ego facts.
    pub fn shares(&self) -> bool {
        self.sensors
            .as_ref()
            .is_some_and(|sensors| sensors.config().share.is_some())
    }

    /// Returns the shield of the configuration, if any. It judges by the rules of the city.
    pub fn shield(&self) -> Option<&Arc<Shield>> {
        self.shield.as_ref()
    }

    /// Returns the label of a clause, by its position in [`Oracle::constraints`]: `S2`, or `file:line` if it has none.
    pub fn label(&self, constraint: usize) -> &str {
        &self.constraints[constraint].0
    }

    /// Returns the length of the groundings observation: the atoms, and the length of the route if configured.
    pub fn observation_width(&self) -> usize {
        self.oracle.width() + usize::from(self.config.route_length)
    }

    /// Returns the shape of the `state` observation: one row per agent, and the numbers in a row.
    pub fn state_shape(&self) -> [usize; 2] {
        [self.config.state_agents as usize, Observer::state_width(&self.oracle)]
    }

    /// Returns the divisor of priorities in the `state` observation: the greatest possible priority number.
    pub fn priority_scale(&self) -> f32 {
        self.oracle.priority_scale()
    }

    /// Returns the number of agents in the next drawn episode of an environment after `begun` others, by the
    /// curriculum; `None` for all.
    pub(super) fn agents_after(&self, begun: u64, split: Split) -> Option<usize> {
        let mut stages = self.config.curriculum.iter().filter(|_| split == Split::Train);
        let stage = stages.find(|stage| begun < stage.until);
        stage.map(|stage| stage.agents.value as usize)
    }

    /// Returns the side of the region of a split, in cells; without a region, the number of rows of the map.
    fn region(&self, split: Split) -> u32 {
        let set = self.world().scenario.agent_set(split);
        let region = set.and_then(|set| set.region.as_ref());
        let map = self.world().map();
        region.map_or(map.rows().unsigned_abs(), |region| region.value.side(map))
    }
}

/// Reports a number of egos that no split has.
fn too_many_egos(scenario: &Scenario, config: &SpfConfig) -> Option<Diagnostic> {
    let cars = |set: &AgentSet| set.count_of(AgentKind::Car.into());
    let most = scenario.splits.iter().map(|(_, set)| cars(set)).max().unwrap_or(0);
    let egos = config.egos.filter(|egos| egos.value as usize > most)?;
    let message = format!("no split has {} cars; the largest has {most}", egos.value);
    let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(egos.span, "for these egos");
    Some(fault.help("lower `egos`, or add cars to a split"))
}

/// Reports the stages of the curriculum that want more agents than the training split has.
fn too_large_stages(scenario: &Scenario, config: &SpfConfig) -> Vec<Diagnostic> {
    let count = scenario.agent_set(Split::Train).map_or(0, AgentSet::len);
    let too_large = (config.curriculum.iter()).filter(|stage| stage.agents.value as usize > count);
    let fault = |stage: &CurriculumStage| {
        let message = format!("the split `train` has {count} agents, not {}", stage.agents.value);
        let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(stage.agents.span, "for this stage");
        fault.help("after the last stage, episodes have all agents")
    };
    too_large.map(fault).collect()
}
