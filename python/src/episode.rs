//! Conversion of the start of an episode from and to Python.
// Decision: docs/decisions/tasks.md#d006

use crate::task::table_of;
use logicity::city::Cell;
use logicity::city::{ActionTable, AgentName};
use logicity::diag::{Diagnostic, did_you_mean};
use logicity::task::spf::codes;
use logicity::task::spf::{Env, Episode, EpisodeAgent, OracleRun};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyInt, PyMapping};
use std::collections::BTreeMap;

/// The option `episode` of a reset.
#[derive(FromPyObject)]
pub enum PyEpisodeOption<'py> {
    /// `True` starts the next episode of the source. `False` does not reset.
    Next(bool),
    /// The number of a recorded episode.
    Recorded(Bound<'py, PyInt>),
    /// A description of an episode.
    Given(Bound<'py, PyDict>),
}

/// An episode that converts to a dict.
#[derive(IntoPyObject)]
pub struct PyEpisode {
    seed: u64,
    agents: Vec<PyEpisodeAgent>,
    oracle: Option<PyOracle>,
}

#[derive(IntoPyObject)]
struct PyEpisodeAgent {
    id: String,
    concepts: Vec<String>,
    priority: i32,
    start: (i32, i32),
    goal: (i32, i32),
}

#[derive(IntoPyObject)]
struct PyOracle {
    steps: u32,
    #[pyo3(item("return"))]
    total: f64,
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
        PyEpisode {
            seed: episode.seed,
            agents: episode.agents.iter().map(agent).collect(),
            oracle: episode.oracle.as_ref().map(|oracle| PyOracle {
                steps: oracle.steps,
                total: oracle.total,
                constrained: oracle.constrained.clone(),
            }),
        }
    }
}

/// Parses an episode. Its agents must be those of the environment.
pub fn read_episode(given: &Bound<'_, PyDict>, env: &Env) -> Result<Episode, Diagnostic> {
    let episode = EpisodeMapping::new("the episode".to_owned(), given, &["seed", "agents", "oracle"])?;
    let agents: Vec<Bound<'_, PyAny>> = episode.get("agents")?;
    let read = |(at, agent): (usize, &Bound<'_, PyAny>)| read_agent(&format!("agent {at} of the episode"), agent, env);
    let oracle: Option<Bound<'_, PyAny>> = episode.find("oracle")?.flatten();
    Ok(Episode {
        seed: episode.get("seed")?,
        agents: agents.iter().enumerate().map(read).collect::<Result<_, _>>()?,
        oracle: (oracle.as_ref())
            .map(|run| read_oracle(run, table_of(env.task())))
            .transpose()?,
    })
}

fn read_agent(what: &str, given: &Bound<'_, PyAny>, env: &Env) -> Result<EpisodeAgent, Diagnostic> {
    let agent = EpisodeMapping::new(what.to_owned(), given, &["id", "concepts", "priority", "start", "goal"])?;
    let id: String = agent.get("id")?;
    let set = env.task().world().scenario.agent_set(env.city().split());
    let known: Vec<AgentName> = set.expect("a city has it").members().map(|(name, _)| name).collect();
    let name = known.iter().find(|name| name.to_string() == id);
    let name = *name.ok_or_else(|| {
        let names: Vec<String> = known.iter().map(AgentName::to_string).collect();
        unknown(
            format!("the split has no agent `{id}`"),
            &id,
            names.iter().map(String::as_str),
        )
    })?;
    // Row and column: a tuple, or a list as in JSON.
    let cell = |key| agent.get(key).map(|[row, col]: [i32; 2]| Cell::new(row, col));
    let concepts: Vec<String> = agent.get("concepts")?;
    Ok(EpisodeAgent {
        name,
        concepts: concepts.into(),
        priority: agent.get("priority")?,
        start: cell("start")?,
        goal: cell("goal")?,
    })
}

fn read_oracle(given: &Bound<'_, PyAny>, table: &ActionTable) -> Result<OracleRun, Diagnostic> {
    let what = "the oracle's run";
    let run = EpisodeMapping::new(what.to_owned(), given, &["steps", "return", "constrained"])?;
    let counts = run.get("constrained")?;
    let counts = EpisodeMapping::new(
        format!("`constrained` of {what}"),
        &counts,
        &table.names().collect::<Vec<_>>(),
    )?;
    let mut constrained = BTreeMap::new();
    for action in table.names() {
        if let Some(steps) = counts.find(action)?.filter(|steps| *steps > 0) {
            constrained.insert(action.to_owned(), steps);
        }
    }
    Ok(OracleRun {
        steps: run.get("steps")?,
        total: run.get("return")?,
        constrained,
    })
}

/// A mapping that describes an episode or a part of an episode.
struct EpisodeMapping<'a, 'py> {
    what: String,
    given: &'a Bound<'py, PyMapping>,
}

impl<'a, 'py> EpisodeMapping<'a, 'py> {
    /// Checks that the value is a mapping without unknown keys.
    fn new(what: String, given: &'a Bound<'py, PyAny>, keys: &[&str]) -> Result<Self, Diagnostic> {
        let wrong = |error: PyErr| invalid(format!("{what} cannot be read: {error}"));
        let Ok(given) = given.cast::<PyMapping>() else {
            return Err(invalid(format!("{what} must be a mapping")));
        };
        for key in given.keys().map_err(wrong)? {
            let key = key.to_string();
            if !keys.contains(&key.as_str()) {
                let message = format!("{what} has an unknown key `{key}`");
                return Err(unknown(message, &key, keys.iter().copied()));
            }
        }
        Ok(EpisodeMapping { what, given })
    }

    /// Returns the value of an optional key.
    fn find<T: for<'s> FromPyObject<'s, 'py>>(&self, key: &str) -> Result<Option<T>, Diagnostic> {
        let read = match self.given.get_item(key) {
            Err(error) if error.is_instance_of::<PyKeyError>(self.given.py()) => return Ok(None),
            Err(error) => Err(error),
            Ok(value) => value.extract().map_err(Into::into),
        };
        read.map(Some)
            .map_err(|error: PyErr| invalid(format!("`{key}` of {} cannot be read: {error}", self.what)))
    }

    /// Returns the value of a required key.
    fn get<T: for<'s> FromPyObject<'s, 'py>>(&self, key: &str) -> Result<T, Diagnostic> {
        let found = self.find(key)?;
        found.ok_or_else(|| invalid(format!("{} has no `{key}`", self.what)))
    }
}

fn invalid(message: String) -> Diagnostic {
    Diagnostic::new(codes::INVALID_EPISODE, message)
}

/// Returns a diagnostic whose help is the closest known name, or otherwise all known names.
fn unknown<'a>(message: String, name: &str, known: impl Iterator<Item = &'a str> + Clone) -> Diagnostic {
    invalid(message).help(match did_you_mean(name, known.clone()) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("known: {}", known.collect::<Vec<_>>().join(", ")),
    })
}
