//! The typed form of all configuration files. `docs/reference/configuration.md` documents them for users.
//!
//! The serialized form omits file names and places. [`Scenario::hash`] is its hash.

use crate::city::{Action, ActionTable, AgentSet, KindId, KindTable, MapConfig, OwnLook, Routing, Split, TripEnds};
use crate::diag::Span;
use crate::located::Located;
use crate::predicate::Definition;
use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};
use std::path::PathBuf;
use std::sync::Arc;

/// A base predicate of a scenario.
#[derive(Clone, Debug, Serialize)]
pub struct PredicateConfig {
    /// Its name in the rules.
    pub name: Located<String>,
    /// The computation of its rows.
    pub definition: Definition,
}

/// The selection of one action from those that the rules derive for an agent.
#[derive(Clone, Debug)]
pub struct ActionsConfig {
    /// The actions: the four standard ones, and those that the configuration defines.
    pub table: ActionTable,
    /// The order of precedence if several actions are derived. It contains each action once.
    pub priority: Vec<Action>,
    /// The action if none is derived.
    pub default: Action,
    /// The kinds with an order of precedence or a default of their own.
    pub of_kinds: Vec<KindActions>,
}

/// The selection of an action for agents of a kind.
#[derive(Clone, Debug)]
pub struct KindActions {
    /// The kind.
    pub kind: KindId,
    /// Its name.
    pub name: String,
    /// The order of precedence if several actions are derived. It contains each action once.
    pub priority: Vec<Action>,
    /// The action if none is derived.
    pub default: Action,
}

impl ActionsConfig {
    /// Returns the order of precedence of a kind, and its default.
    pub fn order(&self, kind: impl Into<KindId>) -> (&[Action], Action) {
        let kind = kind.into();
        let own = self.of_kinds.iter().find(|own| own.kind == kind);
        own.map_or((&self.priority, self.default), |own| (&own.priority, own.default))
    }
}

/// The standard actions, the safest first.
impl Default for ActionsConfig {
    fn default() -> Self {
        ActionsConfig {
            table: ActionTable::default(),
            priority: Action::SAFEST_FIRST.to_vec(),
            default: Action::Normal,
            of_kinds: Vec::new(),
        }
    }
}

/// Serializes names. The serialized form omits an empty list of own actions and of kinds with their own order, so
/// that hashes of configurations without them do not depend on it.
impl Serialize for ActionsConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let names: Vec<&str> = self.priority.iter().map(|&action| self.table.name(action)).collect();
        let mut config = serializer.serialize_struct("ActionsConfig", 4)?;
        config.serialize_field("priority", &names)?;
        config.serialize_field("default", self.table.name(self.default))?;
        if !self.table.own().is_empty() {
            config.serialize_field("define", self.table.own())?;
        }
        if !self.of_kinds.is_empty() {
            let named = |action: &Action| self.table.name(*action).to_owned();
            let orders = self.of_kinds.iter().map(|own| {
                let priority: Vec<String> = own.priority.iter().map(named).collect();
                (own.kind.index(), priority, named(&own.default))
            });
            config.serialize_field("of_kinds", &orders.collect::<Vec<_>>())?;
        }
        config.end()
    }
}

/// The unit that costs of violations are counted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ViolationsPer {
    /// The greatest cost of the violated clauses of each action, once per action (the published program).
    Action,
    /// The cost of each violated clause (the formula of the paper).
    Clause,
}

impl ViolationsPer {
    /// Both ways.
    pub const ALL: [ViolationsPer; 2] = [ViolationsPer::Action, ViolationsPer::Clause];

    /// Returns its name: `action` or `clause`.
    pub const fn name(self) -> &'static str {
        match self {
            ViolationsPer::Action => "action",
            ViolationsPer::Clause => "clause",
        }
    }
}

/// The rewards of a step of Safe Path Following; costs are negative.
#[derive(Clone, Debug, Serialize)]
pub struct RewardConfig {
    /// For each action, in the order of the [`ActionTable`]; divided by four times the number of cells of the route.
    pub actions: Vec<f64>,
    /// For a violation; not divided.
    pub violation: f64,
    /// The unit that costs of violations are counted by.
    pub violations_per: ViolationsPer,
    /// For violations of clauses with these labels, instead of `violation`.
    pub clauses: Vec<(Located<String>, f64)>,
    /// For reaching the horizon before the goal.
    pub overtime: f64,
    /// The terms that only training has.
    #[serde(skip_serializing_if = "Shaping::is_none")]
    pub shaping: Shaping,
}

/// The reward terms that a learner gets in training besides the rewards of the task. Without values there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Shaping {
    /// For the whole route; a step gets the share of it that the car covers.
    pub progress: f64,
    /// For reaching the goal without a violation.
    pub goal: f64,
    /// Potential-based shaping.
    pub potential: Potential,
}

impl Shaping {
    /// Returns whether every step has the reward of the task alone.
    pub fn is_none(&self) -> bool {
        self.progress == 0.0 && self.goal == 0.0 && self.potential.weight == 0.0
    }
}

/// Potential-based shaping: a step from s to s' gets `gamma` times the potential of s' minus that of s (Ng, Harada and
/// Russell 1999).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Potential {
    /// The potential of the whole route; 0 for no shaping.
    pub weight: f64,
    /// What the potential is proportional to.
    pub of: PotentialOf,
    /// The discount factor of the learner, 0 to 1.
    pub gamma: f64,
}

impl Default for Potential {
    fn default() -> Self {
        Potential {
            weight: 0.0,
            of: PotentialOf::Remaining,
            gamma: 0.99,
        }
    }
}

/// What a [`Potential`] is proportional to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum PotentialOf {
    /// Minus the remaining share of the route.
    Remaining,
    /// The covered share of the route.
    Progress,
}

impl PotentialOf {
    /// Both.
    pub const ALL: [PotentialOf; 2] = [PotentialOf::Remaining, PotentialOf::Progress];

    /// Returns its name: `remaining` or `progress`.
    pub const fn name(self) -> &'static str {
        match self {
            PotentialOf::Remaining => "remaining",
            PotentialOf::Progress => "progress",
        }
    }
}

/// The random properties of the ego, drawn when an episode begins.
#[derive(Clone, Debug, Serialize)]
pub struct EgoConfig {
    /// The maximum of its priority, which is uniform from 1; by split, in the order of [`Split::ALL`].
    pub priority: [u32; 3],
    /// Its possible sets of concepts and their weights. Weights are non-negative and not all zero; they need not sum to
    /// one.
    pub concepts: Vec<(f64, Arc<[String]>)>,
}

/// The order of the entities that the ego observes. It does not affect which entities the ego observes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum EntityOrder {
    /// The order of the list of agents.
    #[default]
    List,
    /// By distance from the ego; agents at the same distance in list order.
    Nearest,
}

impl EntityOrder {
    /// Both.
    pub const ALL: [EntityOrder; 2] = [EntityOrder::List, EntityOrder::Nearest];

    /// Returns its name: `list` or `nearest`.
    pub const fn name(self) -> &'static str {
        match self {
            EntityOrder::List => "list",
            EntityOrder::Nearest => "nearest",
        }
    }

    fn is_default(&self) -> bool {
        *self == EntityOrder::default()
    }
}

/// A stage of a curriculum: episodes with fewer agents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct CurriculumStage {
    /// The number of episodes of an environment at which the stage ends.
    pub until: u64,
    /// The number of agents, the ego included.
    pub agents: Located<u32>,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde passes a reference
fn is_one(number: &u32) -> bool {
    *number == 1
}

/// The sensors of an ego. They read the truth values of the observed facts; quantities and `Sees` are exact.
#[derive(Clone, Debug, Serialize)]
pub struct SensorsConfig {
    /// What the observation has for each fact.
    pub output: SensorOutput,
    /// Whether the ego knows the facts about itself alone without sensors.
    pub exact_ego: bool,
    /// The sensors of all predicates without an entry in `predicates`.
    pub common: Sensor,
    /// The sensors of single predicates.
    pub predicates: Vec<(Located<String>, Sensor)>,
    /// What others tell the ego.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share: Option<ShareConfig>,
    /// The place of the configuration.
    #[serde(skip)]
    pub span: Span,
}

impl SensorsConfig {
    /// Returns the sensor of a predicate.
    pub fn of(&self, predicate: &str) -> Sensor {
        let own = self.predicates.iter().find(|(name, _)| name.value == predicate);
        own.map_or(self.common, |(_, sensor)| *sensor)
    }
}

/// What an observation through sensors has for each fact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum SensorOutput {
    /// 1 if the sensor reads that the fact holds, else 0, also without a reading.
    #[default]
    Facts,
    /// The probability that the fact holds, given the reading of this tick.
    Probabilities,
    /// The probability that the fact holds, given all readings of the episode.
    Belief,
}

impl SensorOutput {
    /// All outputs.
    pub const ALL: [SensorOutput; 3] = [SensorOutput::Facts, SensorOutput::Probabilities, SensorOutput::Belief];

    /// Returns its name: `facts`, `probabilities` or `belief`.
    pub const fn name(self) -> &'static str {
        match self {
            SensorOutput::Facts => "facts",
            SensorOutput::Probabilities => "probabilities",
            SensorOutput::Belief => "belief",
        }
    }
}

/// How the truth values of a predicate are read. The default reads them exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sensor {
    /// The probability that a fact that holds is read as holding.
    pub true_positive_rate: f64,
    /// The probability that a fact that does not hold is read as holding.
    pub false_positive_rate: f64,
    /// The maximum Euclidean distance in cells between the ego and each other agent of the fact; `None` for no bound.
    pub range: Option<u32>,
    /// Whether a building on the line from the ego to an agent hides it.
    pub occluded_by_buildings: bool,
    /// Whether a third agent on the line from the ego to an agent hides it.
    pub occluded_by_agents: bool,
    /// The age of a reading in ticks.
    pub delay: u32,
    /// The probability that there is no reading.
    pub dropout: f64,
    /// The probability that the noise of a fact is that of the tick before instead of a new draw. It is the correlation
    /// of the noise in successive ticks.
    pub correlation: f64,
}

impl Default for Sensor {
    fn default() -> Self {
        Sensor {
            true_positive_rate: 1.0,
            false_positive_rate: 0.0,
            range: None,
            occluded_by_buildings: false,
            occluded_by_agents: false,
            delay: 0,
            dropout: 0.0,
            correlation: 0.0,
        }
    }
}

/// Facts that others tell the ego: true ones of which its sensors have no reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ShareConfig {
    /// The maximum number of facts in a tick.
    pub facts: u32,
    /// Which facts come first.
    pub by: ShareOrder,
    /// Who tells them.
    pub from: Sender,
    /// The maximum number of other agents that these facts are about in a tick; `None` for no bound.
    pub entities: Option<u32>,
}

/// The order in which facts are told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum ShareOrder {
    /// By the distance from the ego to the farthest agent of the fact.
    #[default]
    Distance,
    /// First some facts with which the rules derive the same actions as with all facts that could be told; then the
    /// others by distance.
    Relevance,
    /// In random order.
    Random,
}

impl ShareOrder {
    /// All orders.
    pub const ALL: [ShareOrder; 3] = [ShareOrder::Distance, ShareOrder::Relevance, ShareOrder::Random];

    /// Returns its name: `distance`, `relevance` or `random`.
    pub const fn name(self) -> &'static str {
        match self {
            ShareOrder::Distance => "distance",
            ShareOrder::Relevance => "relevance",
            ShareOrder::Random => "random",
        }
    }
}

/// Who tells the ego facts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Sender {
    /// An assistant that knows all facts.
    Assistant,
    /// The other cars within a distance in cells, or all of them. Each knows the facts whose agents the sensor of the
    /// predicate reaches from its place: `range` and `occluded_by` apply, errors do not.
    Cars {
        /// The maximum Euclidean distance from the ego.
        radius: Option<u32>,
    },
}

/// A shield: rules judge every action of the learner before the ego takes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ShieldConfig {
    /// What happens to an action that the shield does not permit.
    pub mode: ShieldMode,
    /// Which actions the shield permits.
    pub query: ShieldQuery,
    /// In the mode `probabilistic`: the least probability of a permitted action.
    pub threshold: f64,
}

/// What a shield does with an action that it does not permit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ShieldMode {
    /// It is an error: the learner reads the mask of permitted actions.
    Mask,
    /// The ego takes the action that the rules choose.
    Override,
    /// The ego takes the most probable action. Facts have the probabilities of the ego's sensors.
    Probabilistic,
    /// The egos take the safe joint action that changes the fewest proposed ones. Clauses may read the actions of other
    /// egos. Only for the query [`ShieldQuery::Safe`].
    Joint,
}

impl ShieldMode {
    /// All modes.
    pub const ALL: [ShieldMode; 4] = [
        ShieldMode::Mask,
        ShieldMode::Override,
        ShieldMode::Probabilistic,
        ShieldMode::Joint,
    ];

    /// Returns its name in configurations.
    pub const fn name(self) -> &'static str {
        match self {
            ShieldMode::Mask => "mask",
            ShieldMode::Override => "override",
            ShieldMode::Probabilistic => "probabilistic",
            ShieldMode::Joint => "joint",
        }
    }

    /// Returns the default query: `safe` in the mode `joint`, else `appropriate`.
    pub fn default_query(self) -> ShieldQuery {
        match self {
            ShieldMode::Joint => ShieldQuery::Safe,
            _ => ShieldQuery::default(),
        }
    }

    /// Returns whether shields of this mode support a query.
    pub fn supports(self, query: ShieldQuery) -> bool {
        self != ShieldMode::Joint || query == ShieldQuery::Safe
    }
}

/// What a shield asks about an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum ShieldQuery {
    /// Whether it is the action that the rules choose.
    #[default]
    Appropriate,
    /// Whether it violates no clause.
    Safe,
}

impl ShieldQuery {
    /// Both.
    pub const ALL: [ShieldQuery; 2] = [ShieldQuery::Appropriate, ShieldQuery::Safe];

    /// Returns its name: `appropriate` or `safe`.
    pub const fn name(self) -> &'static str {
        match self {
            ShieldQuery::Appropriate => "appropriate",
            ShieldQuery::Safe => "safe",
        }
    }
}

impl ShieldConfig {
    /// The threshold unless another one is given.
    pub const THRESHOLD: f64 = 0.5;
}

/// The configuration of Safe Path Following (`configs/tasks/*.yaml`).
#[derive(Clone, Debug, Serialize)]
pub struct SpfConfig {
    /// The number of entities that the ego observes, itself included; 1 to 64.
    pub entities: u32,
    /// The rows of the `state` observation, one per agent, the ego included; 1 to 1024.
    pub state_agents: u32,
    /// The order of the observed entities.
    #[serde(skip_serializing_if = "EntityOrder::is_default")]
    pub order: EntityOrder,
    /// Whether the observation ends with the length of the route.
    pub route_length: bool,
    /// The maximum number of steps of a randomly drawn episode.
    pub horizon: u32,
    /// The maximum number of steps of a recorded episode, as a multiple of the oracle's steps.
    pub patience: u32,
    /// The rewards.
    pub reward: RewardConfig,
    /// The random properties of the ego; `None` to use the agent set.
    pub ego: Option<EgoConfig>,
    /// The number of egos, which are the first cars; `None` for one, or for every car in environments of several egos.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub egos: Option<Located<u32>>,
    /// The number of steps that the rules constrain in the oracle's run of a demanding episode, at least 1.
    #[serde(skip_serializing_if = "is_one")]
    pub constrained_steps: u32,
    /// The stages of the curriculum, by ascending `until`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub curriculum: Vec<CurriculumStage>,
    /// The sensors of the ego; `None` if it observes facts exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensors: Option<SensorsConfig>,
    /// The shield of the learner.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shield: Option<Located<ShieldConfig>>,
    /// The files of recorded episodes, in the order of [`Split::ALL`].
    #[serde(skip)]
    pub episodes: [Option<Located<PathBuf>>; 3],
    /// The place of its configuration.
    #[serde(skip)]
    pub span: Span,
}

/// A run configuration (`configs/*.yaml`) composed of all its files.
#[derive(Clone, Debug, Serialize)]
pub struct Scenario {
    /// The name of the file without its extension.
    #[serde(skip)]
    pub name: String,
    /// The map.
    pub map: MapConfig,
    /// The rule file.
    #[serde(skip)]
    pub rules: Located<PathBuf>,
    /// The agent sets, at least one.
    pub splits: Vec<(Split, AgentSet)>,
    /// The base predicates, in the order of the observation. The last one is `Sees`, which observations omit.
    pub predicates: Vec<PredicateConfig>,
    /// The kinds of agents.
    #[serde(skip_serializing_if = "KindTable::is_standard")]
    pub kinds: KindTable,
    /// The looks of concepts and kinds in pictures.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub looks: Vec<OwnLook>,
    /// The selection of one action from the derived ones.
    pub actions: ActionsConfig,
    /// The algorithm by which agents choose routes.
    pub routing: Routing,
    /// The cells where trips of cars start and end.
    #[serde(skip_serializing_if = "TripEnds::is_default")]
    pub trip_ends: TripEnds,
    /// The half-width of the field of view, in cells.
    pub view: u32,
    /// The length of a run in ticks; the command line can override it.
    pub ticks: u32,
    /// Safe Path Following, if configured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<SpfConfig>,
    /// The SHA-256 of the configuration with all its parts, in hexadecimal. Equal content has equal hashes, whatever
    /// the file names.
    #[serde(skip)]
    pub hash: String,
    /// The configuration with all its parts as JSON, without `rules` and files of episodes. With a value for `rules`,
    /// it is a configuration file of the same meaning that refers to no other file.
    #[serde(skip)]
    pub composed: serde_json::Value,
}

impl Scenario {
    /// Returns the agents of a split, if configured.
    pub fn agent_set(&self, split: Split) -> Option<&AgentSet> {
        self.splits
            .iter()
            .find(|(given, _)| *given == split)
            .map(|(_, set)| set)
    }
}
