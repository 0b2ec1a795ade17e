//! Episodes: how a city begins.

use crate::city::{Agent, Cell, Router};
use crate::config::{AgentConfig, AgentName};
use crate::diag::{Code, Diagnostic};
use std::sync::Arc;

/// How an episode begins, and what the oracle made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Of everything that is drawn during the episode.
    pub seed: u64,
    /// The agents in list order.
    pub agents: Vec<EpisodeAgent>,
    /// What the oracle made of it, if it is known.
    pub oracle: Option<OracleRun>,
}

/// An agent as an episode begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeAgent {
    /// Its name.
    pub name: AgentName,
    /// What it is.
    pub concepts: Arc<[String]>,
    /// Right of way; a smaller number goes first.
    pub priority: i32,
    /// Where it starts.
    pub start: Cell,
    /// Where it goes.
    pub goal: Cell,
}

/// An episode in which the ego does what the rules want.
#[derive(Clone, Debug, PartialEq)]
pub struct OracleRun {
    /// How many steps it took to the goal.
    pub steps: u32,
    /// The sum of its rewards.
    pub total: f64,
    /// In how many steps the rules asked an action, by action in the order of [`Speed::ALL`](crate::config::Speed::ALL).
    pub constrained: [u32; 4],
}

impl EpisodeAgent {
    pub(super) fn of(agent: &Agent) -> EpisodeAgent {
        EpisodeAgent {
            name: agent.name(),
            concepts: Arc::clone(&agent.concepts),
            priority: agent.priority,
            start: agent.start(),
            goal: agent.goal(),
        }
    }
}

impl Episode {
    pub(super) fn of(seed: u64, agents: &[Agent]) -> Episode {
        Episode {
            seed,
            agents: agents.iter().map(EpisodeAgent::of).collect(),
            oracle: None,
        }
    }

    /// The agents at their starts, which must be named as these are.
    pub(super) fn place(&self, router: &Router, like: &[Agent]) -> Result<Vec<Agent>, Diagnostic> {
        let fault = |message: String| Diagnostic::new(Code::InvalidEpisode, message);
        if self.agents.len() != like.len() {
            let message = format!(
                "the episode has {} agents, the split has {}",
                self.agents.len(),
                like.len()
            );
            return Err(fault(message));
        }
        let agents = self.agents.iter().zip(like).map(|(agent, like)| {
            if agent.name != like.name() {
                return Err(fault(format!(
                    "the episode has {} where {} is",
                    agent.name,
                    like.name()
                )));
            }
            let [start, goal] = [agent.start, agent.goal];
            let route = router.plan(agent.name.kind, start, goal).map_err(|_| {
                let (from, to) = (
                    format!("[{}, {}]", start.row, start.col),
                    format!("[{}, {}]", goal.row, goal.col),
                );
                fault(format!("{} cannot go from {from} to {to}", agent.name))
                    .help("cars start and arrive at kerb cells of traffic streets, pedestrians on sidewalks")
            })?;
            let config = AgentConfig {
                name: agent.name,
                concepts: Arc::clone(&agent.concepts),
                priority: agent.priority,
            };
            Ok(Agent::new(&config, route))
        });
        agents.collect()
    }
}
