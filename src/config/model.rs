//! The typed form of every configuration file. `configs/README.md` documents the same for users.
//!
//! The serialised form holds the content without file names and places. It is what [`Scenario::hash`] is taken of.

use crate::city::{Action, AgentSet, MapConfig, Routing, Split};
use crate::diag::{Located, Span};
use crate::predicate::Definition;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;

/// A base predicate of a scenario.
#[derive(Clone, Debug, Serialize)]
pub struct PredicateConfig {
    /// Its name in the rules.
    pub name: Located<String>,
    /// How it is computed.
    pub definition: Definition,
}

/// How derived action predicates become one action.
#[derive(Clone, Debug, Serialize)]
pub struct ActionsConfig {
    /// If several actions are derived, the first of this list is taken. Each of the four exactly once.
    pub priority: Vec<Action>,
    /// The action if none is derived.
    pub default: Action,
}

/// How violations of rules are added up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum ViolationsPer {
    /// Once for each action of which a clause is violated (the published program): the greatest cost of its violated clauses.
    Action,
    /// Once for each violated clause (the formula of the paper).
    Clause,
}

impl ViolationsPer {
    /// Both.
    pub const ALL: [ViolationsPer; 2] = [ViolationsPer::Action, ViolationsPer::Clause];

    /// Its name: `action` or `clause`.
    pub const fn name(self) -> &'static str {
        match self {
            ViolationsPer::Action => "action",
            ViolationsPer::Clause => "clause",
        }
    }
}

/// What a step of Safe Path Following is worth. The numbers are rewards: what costs is negative.
#[derive(Clone, Debug, Serialize)]
pub struct RewardConfig {
    /// For each action, in the order of [`Action::ALL`]; divided by four times the cells of the route.
    pub actions: [f64; 4],
    /// For a violation, not divided.
    pub violation: f64,
    /// How violations are added up.
    pub violations_per: ViolationsPer,
    /// For violations of clauses with these labels instead of `violation`.
    pub clauses: Vec<(Located<String>, f64)>,
    /// For reaching the horizon without having arrived.
    pub overtime: f64,
}

/// What the ego is drawn to be when an episode begins.
#[derive(Clone, Debug, Serialize)]
pub struct EgoConfig {
    /// Its priority is uniform from 1 to this number; by split, in the order of [`Split::ALL`].
    pub priority: [u32; 3],
    /// What concepts it carries, and with what weight; weights are not negative, not all zero, and need not sum to one.
    pub concepts: Vec<(f64, Arc<[String]>)>,
}

/// Safe Path Following in this scenario (`configs/tasks/*.yaml`).
#[derive(Clone, Debug, Serialize)]
pub struct SpfConfig {
    /// How many entities the ego observes, itself included; 1 to 64.
    pub entities: u32,
    /// Rows of the `state` observation, one for each agent, the ego included; 1 to 1024.
    pub state_agents: u32,
    /// Whether the observation ends with the length of the route.
    pub route_length: bool,
    /// An episode that is drawn has at most so many steps.
    pub horizon: u32,
    /// A recorded episode has at most so many times the oracle's steps.
    pub patience: u32,
    /// What steps are worth.
    pub reward: RewardConfig,
    /// What the ego is drawn to be; `None` if it is as the agent set says.
    pub ego: Option<EgoConfig>,
    /// The file of recorded episodes of a split.
    #[serde(skip)]
    pub episodes: [Option<Located<PathBuf>>; 3],
    /// Where the task is configured.
    #[serde(skip)]
    pub span: Span,
}

/// A run configuration (`configs/*.yaml`) with every file it is composed of.
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
    /// The base predicates, in the order of the observation; last comes `Sees`, which no observation holds.
    pub predicates: Vec<PredicateConfig>,
    /// How derived actions become one.
    pub actions: ActionsConfig,
    /// How agents choose a route.
    pub routing: Routing,
    /// Half-width of the field of view in cells.
    pub view: u32,
    /// Length of a run in ticks unless the command line says otherwise.
    pub ticks: u32,
    /// Safe Path Following, if the configuration has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<SpfConfig>,
    /// SHA-256 of the configuration with all its parts, in hexadecimal: equal for equal content, whatever the file names.
    #[serde(skip)]
    pub hash: String,
}

impl Scenario {
    /// The agents of a split, if the configuration has it.
    pub fn agent_set(&self, split: Split) -> Option<&AgentSet> {
        self.splits
            .iter()
            .find(|(given, _)| *given == split)
            .map(|(_, set)| set)
    }
}
