//! The task that environments share: Safe Path Following in one world.

use crate::city::{Files, Loaded, city_error, one_of};
use crate::episode::read_episode;
use crate::output::{overwrite_if, unwritable};
use crate::predicate::Functions;
use crate::{LimitArguments, Signals, input_error, locked, to_python};
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, ActionTable, Split};
use logicity::config::{SEES, ShieldConfig, ShieldMode, ShieldQuery};
use logicity::diag::{Diagnostic, SourceId, Sources};
use logicity::files::Output;
use logicity::render::{Icons, Marked, Overview, Sprite};
use logicity::sim::{Chain, Shield, Verdict};
use logicity::task::spf::{
    ControlledCar, Env, Episode, EpisodeSet, Info, ObservationKind, Origin, RecordError, SpfTask, explain,
    explain_shield, record,
};
use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};
use serde_json::json;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyTask>()
}

/// The task that environments share: Safe Path Following in one world.
#[pyclass(name = "Task", module = "logicity._logicity", frozen)]
pub struct PyTask {
    pub task: Arc<SpfTask>,
    /// The arguments of `new`, with the source of the files that were read.
    arguments: Arguments,
    functions: Option<Arc<Functions>>,
    sources: Mutex<Sources>,
    /// The rule files among the sources.
    rule_files: Vec<SourceId>,
    /// The hash of the rule files.
    pub rules_hash: String,
    recorded: [OnceLock<Arc<[Episode]>>; 3],
    overview: OnceLock<Overview>,
}

/// The configuration, the rule file, the overrides, the limits, and the sources of files by path. The predicates of
/// Python are apart.
type Arguments = (PathBuf, Option<PathBuf>, Option<String>, LimitArguments, Option<Files>);

pub fn split_named(name: &str) -> PyResult<Split> {
    one_of("split", name, &Split::ALL, Split::name)
}

/// Returns an exception of `gymnasium.error` by its name.
pub fn gymnasium_error(py: Python<'_>, name: &str, message: String) -> PyErr {
    let class = py.import("gymnasium.error").and_then(|module| module.getattr(name));
    match class.and_then(|class| class.call1((message,))) {
        Ok(error) => PyErr::from_value(error),
        Err(error) => error,
    }
}

/// Returns for each action 1 if it violates no clause, else 0; all 0 if the environment does not compute it.
pub fn action_mask(table: &ActionTable, info: &Info) -> Vec<i8> {
    let allows = |action| i8::from(info.allowed.is_some_and(|allowed| allowed.contains(action)));
    table.all().map(allows).collect()
}

/// The mode, the query and the threshold of a shield.
pub type ShieldSettings = (String, Option<String>, Option<f64>);

/// Returns the shield with these settings by the rules of a task.
pub fn shield_of(py: Python<'_>, rules: &PyTask, (mode, query, threshold): &ShieldSettings) -> PyResult<Arc<Shield>> {
    let mode = one_of("mode", mode, &ShieldMode::ALL, ShieldMode::name)?;
    let query = match query {
        Some(query) => one_of("query", query, &ShieldQuery::ALL, ShieldQuery::name)?,
        None => mode.default_query(),
    };
    if !mode.supports(query) {
        let (mode, query) = (mode.name(), query.name());
        return Err(PyValueError::new_err(format!(
            "the mode `{mode}` does not support the query `{query}`: use `query=\"safe\"`"
        )));
    }
    let config = ShieldConfig {
        mode,
        query,
        threshold: threshold.unwrap_or(ShieldConfig::THRESHOLD),
    };
    let made = Shield::new(Arc::clone(rules.task.oracle()), config);
    made.map(Arc::new).map_err(|fault| rules.error(py, fault))
}

/// Returns for each action 1 if the shield permits it now, else 0; all 0 without an episode.
pub fn shield_mask(table: &ActionTable, info: &Info) -> impl Iterator<Item = i8> + use<> {
    let permitted = info.verdict.as_ref().map(|verdict| verdict.permitted);
    let permits = move |action| permitted.is_some_and(|permitted| permitted.contains(action));
    table.all().map(move |action| i8::from(permits(action)))
}

/// Checks that a shield in the mode `mask` permits an action. `of` says whose it is, for messages.
pub fn check_permitted(
    py: Python<'_>,
    (shield, verdict): (&Arc<Shield>, &Verdict),
    action: (Action, &str),
    of: impl Fn() -> String,
) -> PyResult<()> {
    if shield.config().mode != ShieldMode::Mask || verdict.permitted.contains(action.0) {
        return Ok(());
    }
    let fault = shield.forbidden(&format!("{}{}", action.1, of()), verdict.permitted);
    let message = format!("{}; {}", fault.message, fault.help.join("; "));
    Err(gymnasium_error(py, "InvalidAction", message))
}

/// Writes for each clause whether the last action violated it.
pub fn write_violations(info: &Info, out: &mut [bool]) {
    out.fill(false);
    for &constraint in &info.broken {
        out[constraint] = true;
    }
}

/// Reads actions that an environment returned as bytes.
pub fn read_actions(py: Python<'_>, task: &SpfTask, taken: &[u8]) -> PyResult<Vec<Action>> {
    let actions = taken
        .iter()
        .map(|&action| read_action(py, task, action.into(), String::new));
    actions.collect()
}

/// Reads an action of an ego. `of` says whose it is, for messages.
pub fn read_action(py: Python<'_>, task: &SpfTask, action: i64, of: impl Fn() -> String) -> PyResult<Action> {
    let table = table_of(task);
    let known = usize::try_from(action).ok().and_then(|action| table.all().nth(action));
    let message = match known {
        Some(action) if task.possible_actions().contains(&action) => return Ok(action),
        Some(action) => format!("{}{} is an action that a car cannot take", table.name(action), of()),
        None => {
            let names = table
                .names()
                .enumerate()
                .map(|(number, name)| format!("{number} {name}"));
            let names = names.collect::<Vec<_>>().join(", ");
            format!("{action}{} is not an action; known: {names}", of())
        }
    };
    Err(gymnasium_error(py, "InvalidAction", message))
}

/// Returns the actions of a task.
pub fn table_of(task: &SpfTask) -> &ActionTable {
    task.world().vocabulary.actions()
}

#[pymethods]
impl PyTask {
    #[new]
    #[pyo3(signature = (config, rules, overrides, limits, files=None, predicates=None))]
    fn new(
        py: Python<'_>,
        config: PathBuf,
        rules: Option<PathBuf>,
        overrides: Option<String>,
        limits: LimitArguments,
        files: Option<Files>,
        predicates: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let functions = predicates.as_ref().map(Functions::new).transpose()?;
        let signals = Signals::new();
        let (named, replaced, merged) = (config.clone(), rules.clone(), overrides.clone());
        let Loaded {
            sources,
            city,
            files,
            replaced,
        } = Loaded::new(py, &signals, named, replaced, limits, files, merged)?;
        let (rule_files, rules_hash) = (city.rule_files.clone(), city.rules_hash.clone());
        let external = functions.clone();
        let (made, sources) = signals.on_thread(py, move || {
            let world = city.world().and_then(|mut world| {
                if let Some(external) = external {
                    world.set_external(external).map_err(|fault| vec![fault])?;
                }
                Ok(Arc::new(world))
            });
            (world.and_then(|world| SpfTask::new(world, &sources)), sources)
        })?;
        let task = made.map_err(|faults| city_error(py, faults, &sources, replaced.as_deref()))?;
        Ok(PyTask {
            arguments: (config, rules, overrides, limits, Some(files)),
            functions,
            sources: Mutex::new(sources),
            rule_files,
            rules_hash,
            recorded: Default::default(),
            overview: OnceLock::new(),
            task: Arc::new(task),
        })
    }

    /// Pickles the arguments and the sources of the files, so that unpickling reads no file.
    #[allow(clippy::type_complexity, reason = "the arguments of `new`")]
    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> (
        Bound<'py, PyType>,
        (
            PathBuf,
            Option<PathBuf>,
            Option<String>,
            LimitArguments,
            Option<Files>,
            Option<Py<PyAny>>,
        ),
    ) {
        let task = slf.get();
        let (config, rules, overrides, limits, files) = task.arguments.clone();
        let predicates = task.functions.as_ref().map(|functions| functions.object(slf.py()));
        (slf.get_type(), (config, rules, overrides, limits, files, predicates))
    }

    /// Returns the task itself, because it is immutable.
    fn __deepcopy__<'py>(slf: &Bound<'py, Self>, _memo: &Bound<'py, PyAny>) -> Bound<'py, Self> {
        slf.clone()
    }

    /// Returns the names of the clauses that actions can violate.
    pub fn clauses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let constraints = 0..self.constraints();
        PyTuple::new(py, constraints.map(|constraint| self.task.label(constraint)))
    }

    /// Returns the names of the actions, in the order of their numbers.
    fn actions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, table_of(&self.task).names().collect::<Vec<_>>())
    }

    /// Returns the shape of a kind of observation.
    fn shape(&self, py: Python<'_>, observation: &str) -> PyResult<Vec<usize>> {
        Ok(self.view(py, observation)?.shape(&self.task))
    }

    /// Describes the sensors of the ego as JSON does; `None` without sensors.
    fn sensors<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(sensors) = self.task.sensors() else {
            return Ok(None);
        };
        let signals = Signals::new();
        let cancel = signals.cancel();
        let model = signals.detach(py, || self.task.sensor_model(&cancel).map(|model| model.cloned()))?;
        let model = model.map_err(|fault| self.error(py, fault))?;
        let config = sensors.config();
        let observed = self.task.world().vocabulary.predicates.iter().enumerate();
        let sensed = observed.filter(|(_, known)| known.quantity().is_none() && known.name != SEES);
        let predicates = sensed.map(|(predicate, known)| {
            let sensor = config.of(&known.name);
            let occluders = [("buildings", sensor.occluded_by_buildings), ("agents", sensor.occluded_by_agents)];
            let occluders = occluders.iter().filter(|(_, hides)| *hides).map(|(name, _)| *name);
            let mut described = json!({
                "true_positive_rate": sensor.true_positive_rate, "false_positive_rate": sensor.false_positive_rate,
                "range": sensor.range, "occluded_by": occluders.collect::<Vec<&str>>(), "delay": sensor.delay,
                "dropout": sensor.dropout, "correlation": sensor.correlation,
            });
            if let Some(model) = &model {
                let chain = |chain: Chain| {
                    json!({"base": chain.base, "initial": chain.initial, "stays": chain.stays, "appears": chain.appears})
                };
                described["chains"] = json!(model.chains(predicate).map(chain));
            }
            (known.name.clone(), described)
        });
        let described = json!({
            "output": config.output.name(), "ego": if config.exact_ego { "exact" } else { "sensed" },
            "predicates": predicates.collect::<serde_json::Map<String, serde_json::Value>>(),
        });
        to_python(py, &described).map(Some)
    }

    /// Returns the largest number of steps of a drawn or recorded episode.
    fn max_steps(&self, py: Python<'_>, split: &str, recorded: bool) -> PyResult<u32> {
        let split = split_named(split)?;
        if !recorded {
            return Ok(self.task.config().horizon);
        }
        let episodes = self.recorded_episodes(py, split)?.iter();
        Ok(episodes
            .map(|episode| episode.horizon(self.task.config()))
            .max()
            .unwrap_or(0))
    }

    /// Replays the actions taken in an episode, and writes the trace to an output: a file, the function that writes it,
    /// and whether it replaces any file.
    fn write_trace(
        &self,
        py: Python<'_>,
        split: &str,
        episode: &Bound<'_, PyDict>,
        actions: &[u8],
        output: (PathBuf, String, bool),
    ) -> PyResult<()> {
        let (path, by, overwrite) = output;
        let output = Output::create(&path, &by, overwrite_if(overwrite)).map_err(|error| unwritable(&path, &error))?;
        let split = split_named(split)?;
        let actions = read_actions(py, &self.task, actions)?;
        let signals = Signals::new();
        let cancel = signals.cancel();
        let env = signals.detach(py, || {
            Env::new_with(Arc::clone(&self.task), split, self.task.control(), &cancel)
        })?;
        let episode = env.and_then(|env| read_episode(episode, &env));
        let episode = episode.map_err(|fault| self.error(py, fault))?;
        let sources = self.sources();
        let origin = Origin {
            sources: &sources,
            rule_files: &self.rule_files,
        };
        let written = signals.detach(py, || {
            let driven = (&episode, actions.as_slice());
            record(&self.task, split, driven, origin, output, &cancel)?.finish()?;
            Ok(())
        })?;
        written.map_err(|error| match error {
            RecordError::Fault(fault) => self.error(py, fault),
            RecordError::Write(error) => unwritable(&path, &error),
        })
    }

    /// Returns the number of recorded episodes of a split.
    fn recorded(&self, py: Python<'_>, split: &str) -> PyResult<usize> {
        Ok(self.recorded_episodes(py, split_named(split)?)?.len())
    }
}

impl PyTask {
    /// Returns the kind of observation with a name, if the task has it.
    pub fn view(&self, py: Python<'_>, name: &str) -> PyResult<ObservationKind> {
        let kind = one_of("observation", name, &ObservationKind::ALL, ObservationKind::name)?;
        kind.checked_for(&self.task).map_err(|fault| self.error(py, fault))
    }

    /// Returns the number of clauses that actions can violate.
    pub fn constraints(&self) -> usize {
        self.task.oracle().constraints().len()
    }

    pub fn error(&self, py: Python<'_>, fault: Diagnostic) -> PyErr {
        let raised = self
            .functions
            .as_ref()
            .and_then(|functions| functions.exception(&fault));
        raised.unwrap_or_else(|| input_error(py, &[fault], &self.sources()))
    }

    /// Returns the sources, and the rule files among them.
    pub fn rule_texts(&self) -> (Sources, &[SourceId]) {
        (self.sources(), &self.rule_files)
    }

    /// Returns a copy of the sources, because holding the lock while Python runs may deadlock.
    fn sources(&self) -> Sources {
        locked(&self.sources).clone()
    }

    /// Loads the recorded episodes of a split from disk, or the built-in ones.
    pub fn episode_set(&self, py: Python<'_>, split: Split) -> PyResult<EpisodeSet> {
        let set = {
            let mut sources = locked(&self.sources);
            EpisodeSet::load(&self.task, split, &mut sources, &BuiltinFiles)
        };
        set.map_err(|fault| self.error(py, fault))
    }

    pub fn recorded_episodes(&self, py: Python<'_>, split: Split) -> PyResult<&Arc<[Episode]>> {
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

    pub fn info<'py>(&self, py: Python<'py>, info: &Info) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        dict.set_item(intern!(py, "oracle_action"), info.oracle_action)?;
        let mut violations = vec![false; self.constraints()];
        write_violations(info, &mut violations);
        dict.set_item(intern!(py, "violations"), violations.into_pyarray(py))?;
        dict.set_item(intern!(py, "progress"), info.progress)?;
        dict.set_item(intern!(py, "success"), info.success)?;
        dict.set_item(intern!(py, "steps"), info.steps)?;
        dict.set_item(intern!(py, "seed"), info.seed.cast_signed())?;
        if info.allowed.is_some() {
            dict.set_item(
                intern!(py, "action_mask"),
                action_mask(table_of(&self.task), info).into_pyarray(py),
            )?;
        }
        Ok(dict)
    }

    /// Adds what a shield did and says to an info.
    pub fn add_shield<'py>(&self, dict: &Bound<'py, PyDict>, info: &Info, shield: &Shield) -> PyResult<()> {
        let py = dict.py();
        let table = table_of(&self.task);
        let mask: Vec<i8> = shield_mask(table, info).collect();
        dict.set_item(intern!(py, "shield_mask"), mask.into_pyarray(py))?;
        let probability = |action| (info.verdict.as_ref()).map_or(0.0, |verdict| verdict.probability(action));
        let probabilities: Vec<f64> = table.all().map(probability).collect();
        dict.set_item(intern!(py, "shield_probabilities"), probabilities.into_pyarray(py))?;
        let replaced = info.replaced.map_or(-1, |action| action.index() as i64);
        dict.set_item(intern!(py, "replaced_action"), replaced)?;
        let mut reasons = vec![false; shield.oracle().constraints().len()];
        info.reasons.iter().for_each(|clause| reasons[*clause] = true);
        dict.set_item(intern!(py, "shield_violations"), reasons.into_pyarray(py))
    }

    /// Explains what the shield of an environment says now. The sources of its rules are those of this task.
    pub fn explain_shield(&self, py: Python<'_>, env: &mut Env, car: usize, signals: &Signals) -> PyResult<String> {
        let sources = self.sources();
        let explained = signals.detach(py, || explain_shield(env, car, &sources))?;
        explained.map_err(|(faults, sources)| input_error(py, &faults, &sources))
    }

    /// Formats atoms over the agents of an environment in the syntax of rules.
    pub fn atoms<'py>(
        &self,
        py: Python<'py>,
        env: &Env,
        atoms: impl Iterator<Item = (usize, Vec<usize>)>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let (vocabulary, agents) = (&self.task.world().vocabulary, env.city().agents());
        let atoms = atoms.map(|(predicate, of)| {
            let names: Vec<String> = of.iter().map(|&agent| agents[agent].name().to_string()).collect();
            format!("{}({})", vocabulary.predicates[predicate].name, names.join(", "))
        });
        PyTuple::new(py, atoms.collect::<Vec<String>>())
    }

    pub fn explain(
        &self,
        py: Python<'_>,
        (env, controlled_car): (&Env, usize),
        fact: Option<&str>,
        signals: &Signals,
    ) -> PyResult<String> {
        let sources = self.sources();
        let explained = signals.detach(py, || explain(env, controlled_car, fact, &sources))?;
        explained.map_err(|(faults, sources)| input_error(py, &faults, &sources))
    }

    /// Returns an RGB picture of the city that marks some controlled cars.
    pub fn picture<'py>(
        &self,
        py: Python<'py>,
        env: &Env,
        marked: &[ControlledCar],
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let map = self.task.world().map();
        if self.overview.get().is_none() {
            let icons = Icons::default().with_looks(&self.task.world().scenario.looks);
            let icons = icons.map_err(|fault| PyValueError::new_err(fault.reason))?;
            let overview = Overview::new(map, Arc::new(icons));
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
        let driven = marked.iter().map(|controlled_car| {
            let agent = &city.agents()[controlled_car.agent()];
            Marked {
                agent: controlled_car.agent(),
                way: agent.route().cells().skip(agent.position()).collect(),
            }
        });
        let picture = overview.draw_marked(city.now(), &sprites, &driven.collect::<Vec<_>>());
        let shape = [picture.height() as usize, picture.width() as usize, 3];
        picture.into_pixels().into_pyarray(py).reshape(shape)
    }
}
