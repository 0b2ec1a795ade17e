//! How an episode begins, as Python says and is told it.

use crate::city::one_of;
use logicity::city::Cell;
use logicity::config::{AgentName, Speed};
use logicity::task::path::{Env, Episode, EpisodeAgent, OracleRun};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::BTreeMap;

/// What a trainer may say of an episode.
#[derive(FromPyObject)]
pub enum PyBegin {
    /// `True`: the next one of the source; `False`: none, the environment goes on.
    Next(bool),
    /// One of the recorded ones, by its number.
    Recorded(usize),
    Given(PyEpisode),
}

/// An episode as Python writes it.
#[derive(FromPyObject, IntoPyObject)]
pub struct PyEpisode {
    #[pyo3(item)]
    seed: u64,
    #[pyo3(item)]
    agents: Vec<PyEpisodeAgent>,
    #[pyo3(item, default)]
    oracle: Option<PyOracle>,
}

#[derive(FromPyObject, IntoPyObject)]
struct PyEpisodeAgent {
    #[pyo3(item)]
    id: String,
    #[pyo3(item)]
    concepts: Vec<String>,
    #[pyo3(item)]
    priority: i32,
    #[pyo3(item, from_py_with = cell)]
    start: (i32, i32),
    #[pyo3(item, from_py_with = cell)]
    goal: (i32, i32),
}

/// Row and column, in a tuple or, as JSON has it, in a list.
fn cell(given: &Bound<'_, PyAny>) -> PyResult<(i32, i32)> {
    let [row, col]: [i32; 2] = given.extract()?;
    Ok((row, col))
}

#[derive(FromPyObject, IntoPyObject)]
struct PyOracle {
    #[pyo3(item)]
    steps: u32,
    #[pyo3(item("return"))]
    total: f64,
    #[pyo3(item)]
    constrained: BTreeMap<String, u32>,
}

impl PyEpisode {
    pub fn of(episode: &Episode) -> PyEpisode {
        let agent = |agent: &EpisodeAgent| PyEpisodeAgent {
            id: agent.name.to_string(),
            concepts: agent.concepts.to_vec(),
            priority: agent.priority,
            start: (agent.start.row, agent.start.col),
            goal: (agent.goal.row, agent.goal.col),
        };
        let constrained = |counts: [u32; 4]| {
            let named = Speed::ALL.map(|action| (action.name().to_owned(), counts[action as usize]));
            named.into_iter().filter(|(_, count)| *count > 0).collect()
        };
        PyEpisode {
            seed: episode.seed,
            agents: episode.agents.iter().map(agent).collect(),
            oracle: episode.oracle.as_ref().map(|oracle| PyOracle {
                steps: oracle.steps,
                total: oracle.total,
                constrained: constrained(oracle.constrained),
            }),
        }
    }

    /// The episode for an environment: agents are named as there.
    pub fn read(self, env: &Env) -> PyResult<Episode> {
        let known = env.city().agents();
        let agent = |agent: PyEpisodeAgent| {
            let names: Vec<AgentName> = known.iter().map(|agent| agent.name()).collect();
            let name = names.into_iter().find(|name| name.to_string() == agent.id);
            let cell = |(row, col)| Cell::new(row, col);
            Ok(EpisodeAgent {
                name: name.ok_or_else(|| PyValueError::new_err(format!("the split has no agent `{}`", agent.id)))?,
                concepts: agent.concepts.into(),
                priority: agent.priority,
                start: cell(agent.start),
                goal: cell(agent.goal),
            })
        };
        let oracle = |oracle: PyOracle| {
            let mut constrained = [0; 4];
            for (name, count) in &oracle.constrained {
                constrained[one_of("action", name, &Speed::ALL, Speed::name)? as usize] = *count;
            }
            Ok::<_, PyErr>(OracleRun {
                steps: oracle.steps,
                total: oracle.total,
                constrained,
            })
        };
        Ok(Episode {
            seed: self.seed,
            agents: self.agents.into_iter().map(agent).collect::<PyResult<_>>()?,
            oracle: self.oracle.map(oracle).transpose()?,
        })
    }
}
