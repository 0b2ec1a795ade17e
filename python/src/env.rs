//! Safe Path Following: environments in which Python says how fast cars drive.

use crate::city::{Loaded, one_of};
use crate::input_error;
use logicity::city::Cell;
use logicity::config::{AgentName, Speed, Split};
use logicity::diag::{Diagnostic, Sources};
use logicity::files::read_or_builtin;
use logicity::render::{Icons, Overview, Sprite};
use logicity::sim::World;
use logicity::task::path::{
    Autoreset, Begin, Egos, Env, Episode, EpisodeAgent, EpisodeSet, EpisodeSource, Info, OracleRun, PathTask,
    VectorEnv, View, describe, explain,
};
use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadwriteArray1, PyReadwriteArrayDyn,
};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyTuple};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyTask>()?;
    module.add_class::<PyEnvironments>()?;
    module.add_class::<PyCars>()
}

/// Safe Path Following in one world: what environments share.
#[pyclass(name = "Task", module = "logicity._logicity", frozen)]
pub struct PyTask {
    pub task: Arc<PathTask>,
    sources: Mutex<Sources>,
    /// Names of the clauses that can be broken.
    labels: Vec<Py<PyString>>,
    recorded: [OnceLock<Arc<[Episode]>>; 3],
    overview: OnceLock<Overview>,
}

pub fn split_named(name: &str) -> PyResult<Split> {
    one_of("split", name, &Split::ALL, Split::name)
}

pub fn view_named(name: &str) -> PyResult<View> {
    one_of("observation", name, &[View::Atoms, View::Points], |view| match view {
        View::Atoms => "atoms",
        View::Points => "points",
    })
}

fn autoreset_named(name: &str) -> PyResult<Autoreset> {
    let all = [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled];
    one_of("autoreset mode", name, &all, |mode| match mode {
        Autoreset::NextStep => "NextStep",
        Autoreset::SameStep => "SameStep",
        Autoreset::Disabled => "Disabled",
    })
}

/// An exception of gymnasium.
fn gymnasium_error(py: Python<'_>, name: &str, message: String) -> PyErr {
    let class = py.import("gymnasium.error").and_then(|module| module.getattr(name));
    match class.and_then(|class| class.call1((message,))) {
        Ok(error) => PyErr::from_value(error),
        Err(error) => error,
    }
}

pub fn speed(py: Python<'_>, action: i64, of: impl Fn() -> String) -> PyResult<Speed> {
    let known = usize::try_from(action).ok().and_then(|action| Speed::ALL.get(action));
    known.copied().ok_or_else(|| {
        let message = format!(
            "{action}{} is no action: they are 0 Slow, 1 Normal, 2 Fast, 3 Stop",
            of()
        );
        gymnasium_error(py, "InvalidAction", message)
    })
}

/// What a trainer may say of an episode.
#[derive(FromPyObject)]
enum PyBegin {
    /// `True`: the next one of the source; `False`: none, the environment goes on.
    Next(bool),
    /// One of the recorded ones, by its number.
    Recorded(usize),
    Given(PyEpisode),
}

/// An episode as Python writes it.
#[derive(FromPyObject, IntoPyObject)]
struct PyEpisode {
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
    #[pyo3(item)]
    start: (i32, i32),
    #[pyo3(item)]
    goal: (i32, i32),
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
    fn of(episode: &Episode) -> PyEpisode {
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
    fn read(self, env: &Env) -> PyResult<Episode> {
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

#[pymethods]
impl PyTask {
    #[new]
    fn new(py: Python<'_>, config: PathBuf, rules: Option<PathBuf>, overrides: Option<&str>) -> PyResult<Self> {
        let Loaded {
            sources,
            scenario,
            program,
            ..
        } = Loaded::new(py, &config, rules.as_deref(), None, overrides)?;
        let made = py.detach(|| PathTask::new(Arc::new(World::new(scenario, program)?), &sources));
        let task = made.map_err(|faults| input_error(py, &faults, &sources))?;
        let demands = 0..task.oracle().demands().len();
        Ok(PyTask {
            labels: demands
                .map(|demand| PyString::new(py, task.label(demand)).unbind())
                .collect(),
            sources: Mutex::new(sources),
            recorded: Default::default(),
            overview: OnceLock::new(),
            task: Arc::new(task),
        })
    }

    /// The shape of an observation of that kind.
    fn shape(&self, observation: &str) -> PyResult<Vec<usize>> {
        Ok(view_named(observation)?.shape(&self.task))
    }

    /// How many recorded episodes a split has.
    fn recorded(&self, py: Python<'_>, split: &str) -> PyResult<usize> {
        Ok(self.recorded_episodes(py, split_named(split)?)?.len())
    }
}

impl PyTask {
    pub fn error(&self, py: Python<'_>, fault: Diagnostic) -> PyErr {
        // A copy, since what is held while Python works may be waited for by a thread that Python waits for.
        let sources = self.sources.lock().unwrap_or_else(PoisonError::into_inner).clone();
        input_error(py, &[fault], &sources)
    }

    /// The recorded episodes of a split, as they are on disk or built in.
    pub fn episode_set(&self, py: Python<'_>, split: Split) -> PyResult<EpisodeSet> {
        let set = {
            let mut sources = self.sources.lock().unwrap_or_else(PoisonError::into_inner);
            EpisodeSet::load(&self.task, split, &mut sources, &read_or_builtin)
        };
        set.map_err(|fault| self.error(py, fault))
    }

    fn recorded_episodes(&self, py: Python<'_>, split: Split) -> PyResult<&Arc<[Episode]>> {
        let place = &self.recorded[split as usize];
        if let Some(episodes) = place.get() {
            return Ok(episodes);
        }
        let episodes: Arc<[Episode]> = self.episode_set(py, split)?.episodes.into();
        if episodes.is_empty() {
            return Err(PyValueError::new_err(format!(
                "no episodes are recorded for the split `{}`",
                split.name()
            )));
        }
        Ok(place.get_or_init(|| episodes))
    }

    /// The names of the clauses that were broken.
    fn labels<'py>(&self, py: Python<'py>, broken: &[usize]) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, broken.iter().map(|&demand| self.labels[demand].bind(py)))
    }

    fn info<'py>(&self, py: Python<'py>, info: &Info) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        dict.set_item(intern!(py, "oracle_action"), info.oracle_action)?;
        dict.set_item(intern!(py, "violations"), self.labels(py, &info.broken)?)?;
        dict.set_item(intern!(py, "progress"), info.progress)?;
        dict.set_item(intern!(py, "success"), info.success)?;
        dict.set_item(intern!(py, "steps"), info.steps)?;
        dict.set_item(intern!(py, "seed"), info.seed)?;
        Ok(dict)
    }

    /// The true atoms that a rider observes, as rules write them.
    fn atoms<'py>(&self, py: Python<'py>, env: &Env, rider: usize) -> PyResult<Bound<'py, PyTuple>> {
        let (vocabulary, agents) = (&self.task.world().vocabulary, env.city().agents());
        let atoms = env.riders()[rider].observer().atoms().map(|(predicate, of)| {
            let names: Vec<String> = of.iter().map(|&agent| agents[agent].name().to_string()).collect();
            format!("{}({})", vocabulary.predicates[predicate].name, names.join(", "))
        });
        PyTuple::new(py, atoms.collect::<Vec<String>>())
    }

    fn explain(&self, py: Python<'_>, env: &Env, rider: usize) -> PyResult<String> {
        let told = {
            let sources = self.sources.lock().unwrap_or_else(PoisonError::into_inner);
            explain(env, rider, &sources)
        };
        told.map_err(|fault| self.error(py, fault))
    }

    /// Red, green and blue, row by row.
    fn picture<'py>(&self, py: Python<'py>, env: &Env) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let map = self.task.world().map();
        if self.overview.get().is_none() {
            let overview = Overview::new(map, Arc::new(Icons::default()));
            let _ = (self.overview).set(overview.map_err(|error| PyValueError::new_err(error.to_string()))?);
        }
        let overview = self.overview.get().expect("it has just been set");
        let city = env.city();
        let names: Vec<String> = city.agents().iter().map(|agent| agent.name().to_string()).collect();
        let decided = city
            .report()
            .agents
            .iter()
            .map(|done| (city.now() > 0).then_some(done.action));
        let named = city.agents().iter().zip(&names).zip(decided);
        let sprites: Vec<_> = named
            .map(|((agent, name), action)| Sprite::of(agent, name, action))
            .collect();
        let picture = overview.draw(city.now(), &sprites);
        let shape = [picture.height() as usize, picture.width() as usize, 3];
        picture.into_pixels().into_pyarray(py).reshape(shape)
    }
}

/// Arrays with a number for each environment: oracle action, progress, success, steps, seed.
type Columns<'py> = (
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray1<'py, u64>,
);

/// What came of a step: rewards, and whether episodes ended or were cut short.
type Outcomes<'py> = (
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, bool>,
);

/// What is told of an environment at the end of an episode: its position, the last observation, the names of the broken clauses.
type Last<'py> = (usize, Bound<'py, PyArray1<f32>>, Bound<'py, PyTuple>);

fn slice_of<'a, T: numpy::Element>(array: &'a mut PyReadwriteArray1<'_, T>, count: usize) -> PyResult<&'a mut [T]> {
    let slice = array
        .as_slice_mut()
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    match slice.len() == count {
        true => Ok(slice),
        false => Err(PyValueError::new_err(format!(
            "an array of {}, not {count}",
            slice.len()
        ))),
    }
}

/// Writes what is told of environments; the columns have a number for each environment.
fn tell<'a>(columns: &mut Columns<'_>, count: usize, infos: impl Iterator<Item = (usize, &'a Info)>) -> PyResult<()> {
    let (oracle, progress, success, steps, seeds) = columns;
    let (oracle, progress) = (slice_of(oracle, count)?, slice_of(progress, count)?);
    let (success, steps, seeds) = (
        slice_of(success, count)?,
        slice_of(steps, count)?,
        slice_of(seeds, count)?,
    );
    for (at, info) in infos {
        oracle[at] = info.oracle_action as i64;
        progress[at] = info.progress;
        success[at] = info.success;
        steps[at] = i64::from(info.steps);
        seeds[at] = info.seed;
    }
    Ok(())
}

/// Environments that take a step together.
#[pyclass(name = "Environments", module = "logicity._logicity")]
struct PyEnvironments {
    task: Py<PyTask>,
    split: Split,
    vector: VectorEnv,
    recorded: Option<Arc<[Episode]>>,
    actions: Vec<Speed>,
}

#[pymethods]
impl PyEnvironments {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "each is an argument in Python")]
    fn new(
        py: Python<'_>,
        task: Py<PyTask>,
        split: &str,
        count: usize,
        autoreset: &str,
        observation: &str,
        recorded: bool,
        threads: usize,
    ) -> PyResult<Self> {
        let split = split_named(split)?;
        let (autoreset, view) = (autoreset_named(autoreset)?, view_named(observation)?);
        let episodes = recorded.then(|| task.get().recorded_episodes(py, split).map(Arc::clone));
        let recorded = episodes.transpose()?;
        let sources = std::iter::repeat_n(EpisodeSource::new(0, recorded.clone()), count);
        let shared = &task.get().task;
        let vector = py
            .detach(|| VectorEnv::new(shared, split, sources, autoreset, view, threads))
            .map_err(|fault| task.get().error(py, fault))?;
        Ok(PyEnvironments {
            task,
            split,
            vector,
            recorded,
            actions: Vec::with_capacity(count),
        })
    }

    /// Gives an environment the episodes of a seed, from the one with that number on.
    fn seed(&mut self, at: usize, seed: u64, begun: u64) -> PyResult<()> {
        self.member(at)?;
        let mut source = EpisodeSource::new(seed, self.recorded.clone());
        source.skip_to(begun);
        self.vector.set_source(at, source);
        Ok(())
    }

    /// The seed of the episodes of an environment, and how many have begun.
    fn source(&self, at: usize) -> PyResult<[u64; 2]> {
        Ok(self.member(at)?.source().place())
    }

    /// Begins episodes, see `PyBegin`; the observations of environments that go on stay.
    fn reset(
        &mut self,
        py: Python<'_>,
        begin: Vec<PyBegin>,
        mut observations: PyReadwriteArrayDyn<'_, f32>,
    ) -> PyResult<()> {
        let task = self.task.get();
        self.check(begin.len())?;
        let read = |(begin, member): (PyBegin, &logicity::task::path::Member)| match begin {
            PyBegin::Next(next) => Ok(next.then_some(Begin::Next)),
            PyBegin::Recorded(number) => {
                let recorded = task.recorded_episodes(py, self.split)?;
                let episode = recorded.get(number).ok_or_else(|| {
                    let (split, count) = (self.split.name(), recorded.len());
                    PyIndexError::new_err(format!("no episode {number}: the split `{split}` has {count}, from 0"))
                })?;
                Ok(Some(Begin::Given(Arc::new(episode.clone()))))
            }
            PyBegin::Given(episode) => Ok(Some(Begin::Given(Arc::new(episode.read(member.env())?)))),
        };
        let begin: Vec<Option<Begin>> = begin
            .into_iter()
            .zip(self.vector.members())
            .map(read)
            .collect::<PyResult<_>>()?;
        let rows = self.rows(&mut observations)?;
        let vector = &mut self.vector;
        py.detach(|| vector.reset(&begin, rows))
            .map_err(|fault| task.error(py, fault))
    }

    /// A step of the only environment: reward, whether the episode ended, whether it was cut short, what else is told.
    fn step_one<'py>(
        &mut self,
        py: Python<'py>,
        action: i64,
        mut observation: PyReadwriteArrayDyn<'py, f32>,
    ) -> PyResult<(f64, bool, bool, Bound<'py, PyDict>)> {
        self.check(1)?;
        self.check_ready(py)?;
        let actions = [speed(py, action, String::new)?];
        let task = self.task.get();
        let rows = self.rows(&mut observation)?;
        self.vector
            .step(&actions, rows)
            .map_err(|fault| task.error(py, fault))?;
        let member = &self.vector.members()[0];
        let outcome = member.outcome();
        Ok((
            outcome.reward,
            outcome.terminated,
            outcome.truncated,
            task.info(py, member.info())?,
        ))
    }

    /// A step of all environments. Returned are those in which clauses were broken, with their names.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        actions: PyReadonlyArray1<'py, i64>,
        mut observations: PyReadwriteArrayDyn<'py, f32>,
        outcomes: Outcomes<'py>,
        mut columns: Columns<'py>,
    ) -> PyResult<Vec<(usize, Bound<'py, PyTuple>)>> {
        let given = actions
            .as_slice()
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        self.check(given.len())?;
        self.check_ready(py)?;
        self.actions.clear();
        for (at, &action) in given.iter().enumerate() {
            self.actions
                .push(speed(py, action, || format!(" (of environment {at})"))?);
        }
        let task = self.task.get();
        let rows = self.rows(&mut observations)?;
        let (vector, actions) = (&mut self.vector, &self.actions);
        py.detach(|| vector.step(actions, rows))
            .map_err(|fault| task.error(py, fault))?;

        let count = self.actions.len();
        let (mut rewards, mut terminated, mut truncated) = outcomes;
        let (rewards, terminated) = (slice_of(&mut rewards, count)?, slice_of(&mut terminated, count)?);
        let truncated = slice_of(&mut truncated, count)?;
        let members = self.vector.members();
        for (at, member) in members.iter().enumerate() {
            let outcome = member.outcome();
            (rewards[at], terminated[at], truncated[at]) = (outcome.reward, outcome.terminated, outcome.truncated);
        }
        tell(
            &mut columns,
            count,
            members.iter().map(|member| member.info()).enumerate(),
        )?;
        let broken = members
            .iter()
            .enumerate()
            .filter(|(_, member)| !member.info().broken.is_empty());
        broken
            .map(|(at, member)| Ok((at, task.labels(py, &member.info().broken)?)))
            .collect()
    }

    /// Of each environment whose episode ended in the last step, the next one having begun: its position, the last observation, the names of
    /// the broken clauses. What else was told then is written to the columns.
    fn ended<'py>(&self, py: Python<'py>, mut columns: Columns<'py>) -> PyResult<Vec<Last<'py>>> {
        let members = self.vector.members();
        let ended = || {
            members
                .iter()
                .enumerate()
                .filter_map(|(at, member)| Some((at, member.ended()?)))
        };
        tell(&mut columns, members.len(), ended().map(|(at, (_, info))| (at, info)))?;
        let task = self.task.get();
        let last = |(at, (observation, info)): (usize, (&[f32], &Info))| {
            Ok((
                at,
                PyArray1::from_slice(py, observation),
                task.labels(py, &info.broken)?,
            ))
        };
        ended().map(last).collect()
    }

    /// What is told of an environment beside the observation.
    fn info<'py>(&self, py: Python<'py>, at: usize) -> PyResult<Bound<'py, PyDict>> {
        self.task.get().info(py, self.member(at)?.info())
    }

    /// The true atoms that an ego observes.
    fn atoms<'py>(&self, py: Python<'py>, at: usize) -> PyResult<Bound<'py, PyTuple>> {
        self.task.get().atoms(py, self.member(at)?.env(), 0)
    }

    /// How the episode of an environment began.
    fn episode(&self, at: usize) -> PyResult<PyEpisode> {
        Ok(PyEpisode::of(self.member(at)?.env().episode()))
    }

    /// Why the rules want what they want.
    fn explain(&self, py: Python<'_>, at: usize) -> PyResult<String> {
        self.task.get().explain(py, self.member(at)?.env(), 0)
    }

    /// The state of an environment in a few lines.
    fn text(&self, at: usize) -> PyResult<String> {
        Ok(describe(self.member(at)?.env(), 0))
    }

    /// The city of an environment: red, green and blue.
    fn picture<'py>(&self, py: Python<'py>, at: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        self.task.get().picture(py, self.member(at)?.env())
    }
}

impl PyEnvironments {
    fn member(&self, at: usize) -> PyResult<&logicity::task::path::Member> {
        let member = self.vector.members().get(at);
        member.ok_or_else(|| PyIndexError::new_err(format!("there is no environment {at}")))
    }

    fn check(&self, given: usize) -> PyResult<()> {
        let count = self.vector.members().len();
        match given == count {
            true => Ok(()),
            false => Err(PyValueError::new_err(format!("{given} given for {count} environments"))),
        }
    }

    fn check_ready(&self, py: Python<'_>) -> PyResult<()> {
        let mode = self.vector.autoreset();
        let members = self.vector.members();
        let Some(at) = members.iter().position(|member| !member.is_ready(mode)) else {
            return Ok(());
        };
        let which = match members.len() {
            1 => String::new(),
            _ => format!(" of environment {at}"),
        };
        let message = format!("the episode{which} has ended or not begun: `reset` begins one");
        Err(gymnasium_error(py, "ResetNeeded", message))
    }

    fn rows<'a>(&self, observations: &'a mut PyReadwriteArrayDyn<'_, f32>) -> PyResult<&'a mut [f32]> {
        let rows = observations
            .as_slice_mut()
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let wanted = self.vector.width() * self.vector.members().len();
        match rows.len() == wanted {
            true => Ok(rows),
            false => Err(PyValueError::new_err(format!(
                "room for {} numbers, not {wanted}",
                rows.len()
            ))),
        }
    }
}

/// A city in which Python drives every car.
#[pyclass(name = "Cars", module = "logicity._logicity")]
struct PyCars {
    task: Py<PyTask>,
    env: Env,
    view: View,
    source: EpisodeSource,
    actions: Vec<Speed>,
}

#[pymethods]
impl PyCars {
    #[new]
    fn new(py: Python<'_>, task: Py<PyTask>, split: &str, observation: &str) -> PyResult<Self> {
        let (split, view) = (split_named(split)?, view_named(observation)?);
        let shared = Arc::clone(&task.get().task);
        let env = py
            .detach(|| Env::new(shared, split, Egos::Cars))
            .map_err(|fault| task.get().error(py, fault))?;
        Ok(PyCars {
            task,
            env,
            view,
            source: EpisodeSource::new(0, None),
            actions: Vec::new(),
        })
    }

    /// The names of the cars.
    fn names(&self) -> Vec<String> {
        let agents = self.env.city().agents();
        self.env
            .riders()
            .iter()
            .map(|rider| agents[rider.agent()].name().to_string())
            .collect()
    }

    /// The episodes of a seed from now on.
    fn seed(&mut self, seed: u64) {
        self.source = EpisodeSource::new(seed, None);
    }

    /// Begins the next episode, or one that is given.
    fn reset(&mut self, py: Python<'_>, episode: Option<PyEpisode>) -> PyResult<()> {
        let episode = episode.map(|episode| episode.read(&self.env)).transpose()?;
        let (env, source) = (&mut self.env, &mut self.source);
        let begun = py.detach(|| match &episode {
            Some(episode) => env.reset_to(episode),
            None => source.begin(env),
        });
        begun.map_err(|fault| self.task.get().error(py, fault))
    }

    /// A step: an action for each car, which matters only for those whose episode goes on.
    fn step(&mut self, py: Python<'_>, actions: Vec<i64>) -> PyResult<()> {
        let count = self.env.riders().len();
        if actions.len() != count {
            return Err(PyValueError::new_err(format!(
                "{} actions for {count} cars",
                actions.len()
            )));
        }
        self.actions.clear();
        for (rider, action) in actions.into_iter().enumerate() {
            self.actions.push(speed(py, action, || format!(" (of car {rider})"))?);
        }
        let (env, actions) = (&mut self.env, &self.actions);
        py.detach(|| env.step(actions))
            .map_err(|fault| self.task.get().error(py, fault))
    }

    /// What came of the last action of a car: reward, whether its episode ended, whether it was cut short, what else is told.
    fn outcome<'py>(&self, py: Python<'py>, car: usize) -> PyResult<(f64, bool, bool, Bound<'py, PyDict>)> {
        self.check(car)?;
        let last = self.env.riders()[car].last();
        let mut info = Info::default();
        info.note(&self.env, car);
        Ok((
            last.reward,
            last.terminated,
            last.truncated,
            self.task.get().info(py, &info)?,
        ))
    }

    /// Writes what a car observes.
    fn observe(&self, car: usize, mut out: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        let out = out
            .as_slice_mut()
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let wanted: usize = self.view.shape(&self.task.get().task).iter().product();
        self.check(car)?;
        if out.len() != wanted {
            return Err(PyValueError::new_err(format!(
                "room for {} numbers, not {wanted}",
                out.len()
            )));
        }
        self.view.write(&self.env, car, out);
        Ok(())
    }

    /// How the episode began.
    fn episode(&self) -> PyEpisode {
        PyEpisode::of(self.env.episode())
    }

    /// Why the rules want what they want of a car.
    fn explain(&self, py: Python<'_>, car: usize) -> PyResult<String> {
        self.check(car)?;
        self.task.get().explain(py, &self.env, car)
    }

    /// The state of a car in a few lines.
    fn text(&self, car: usize) -> PyResult<String> {
        self.check(car)?;
        Ok(describe(&self.env, car))
    }

    /// The city: red, green and blue.
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        self.task.get().picture(py, &self.env)
    }
}

impl PyCars {
    fn check(&self, car: usize) -> PyResult<()> {
        match car < self.env.riders().len() {
            true => Ok(()),
            false => Err(PyIndexError::new_err(format!("there is no car {car}"))),
        }
    }
}
