//! Metrics of policies on recorded episodes, and the description of a task.

use crate::episode::PyEpisode;
use crate::task::{PyTask, read_action, split_named, table_of};
use crate::{Signals, slice_of, to_python};
use logicity::city::{Action, Split};
use logicity::task::spf::{
    Baseline, BatchEvaluator, Env, EpisodeSet, ObservationKind, Planner, RANDOM_RUNS, Rollout, SearchBounds, SpfTask,
    Summary, steps_by_action, summarize,
};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadwriteArray1, PyReadwriteArrayDyn};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyRandomBaseline>()?;
    module.add_class::<PyBatchEvaluator>()?;
    module.add_function(wrap_pyfunction!(layout, module)?)?;
    module.add_function(wrap_pyfunction!(describe, module)?)
}

/// The random policy on the recorded episodes of a split.
#[pyclass(name = "RandomBaseline", module = "logicity._logicity")]
struct PyRandomBaseline {
    task: Py<PyTask>,
    set: EpisodeSet,
    env: Env,
    baseline: Baseline,
    signals: Arc<Signals>,
}

#[pymethods]
impl PyRandomBaseline {
    #[new]
    fn new(py: Python<'_>, task: Py<PyTask>, split: &str) -> PyResult<Self> {
        let split = split_named(split)?;
        let shared = &task.get().task;
        let signals = Signals::new();
        let cancel = signals.cancel();
        let env = signals.detach(py, || {
            Env::new_with(Arc::clone(shared), split, shared.control(), &cancel)
        })?;
        Ok(PyRandomBaseline {
            env: env.map_err(|fault| task.get().error(py, fault))?,
            set: task.get().episode_set(py, split)?,
            baseline: Baseline::default(),
            task,
            signals,
        })
    }

    /// Returns the number of episodes.
    fn __len__(&self) -> usize {
        self.set.episodes.len()
    }

    /// Returns the SHA-256 of the set of episodes.
    fn hash(&self) -> String {
        self.set.hash()
    }

    /// Runs the random policy on the next episode.
    fn add(&mut self, py: Python<'_>) -> PyResult<()> {
        let next = self.set.episodes.get(self.baseline.returns().len());
        let episode = next.ok_or_else(|| PyIndexError::new_err("the baseline has run all episodes"))?;
        let (env, baseline) = (&mut self.env, &mut self.baseline);
        (self.signals.detach(py, || baseline.add(env, episode))?).map_err(|fault| self.task.get().error(py, fault))
    }

    /// Returns the results so far: `summary` and `episodes`.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let task = self.task.get();
        let runs = usize::from(RANDOM_RUNS);
        report(
            py,
            task,
            &self.baseline.summary(&task.task),
            (self.baseline.rollouts(), runs),
        )
    }
}

/// A batch of recorded episodes that a policy in Python runs once.
#[pyclass(name = "BatchEvaluator", module = "logicity._logicity")]
struct PyBatchEvaluator {
    task: Py<PyTask>,
    evaluator: BatchEvaluator,
    view: ObservationKind,
    actions: Vec<Action>,
    /// The planners of the episodes, made on demand.
    planners: Vec<Planner>,
    signals: Arc<Signals>,
}

#[pymethods]
impl PyBatchEvaluator {
    #[new]
    fn new(py: Python<'_>, baseline: &PyRandomBaseline, observation: &str, shielded: bool) -> PyResult<Self> {
        let (task, set) = (baseline.task.clone_ref(py), &baseline.set);
        let view = task.get().view(py, observation)?;
        let signals = Signals::new();
        let cancel = signals.cancel();
        let evaluator = signals.detach(py, || {
            let mut evaluator = BatchEvaluator::new_with(&task.get().task, set, &cancel)?;
            if !shielded {
                evaluator.remove_shields()?;
            }
            Ok(evaluator)
        })?;
        Ok(PyBatchEvaluator {
            evaluator: evaluator.map_err(|fault| task.get().error(py, fault))?,
            actions: Vec::with_capacity(set.episodes.len()),
            planners: Vec::new(),
            task,
            view,
            signals,
        })
    }

    /// Returns the number of episodes.
    fn __len__(&self) -> usize {
        self.evaluator.envs().len()
    }

    /// Returns the start of an episode.
    fn episode(&self, at: usize) -> PyResult<PyEpisode> {
        let env = self.evaluator.envs().get(at);
        let env = env.ok_or_else(|| PyIndexError::new_err(format!("there is no episode {at}")))?;
        Ok(PyEpisode::of(env.episode()))
    }

    /// Returns the number of egos of each episode.
    fn egos(&self) -> usize {
        self.evaluator.egos()
    }

    /// Writes the observations, one row per episode and ego.
    fn observe(&self, mut out: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        let width: usize = self.view.shape(&self.task.get().task).iter().product();
        let width = width * self.evaluator.egos();
        let rows = slice_of(&mut out, width * self.evaluator.envs().len())?;
        for (env, row) in self.evaluator.envs().iter().zip(rows.chunks_exact_mut(width)) {
            self.view.write_all(env, row);
        }
        Ok(())
    }

    /// Writes the mask of running episodes, one value per episode and ego.
    fn running(&self, mut out: PyReadwriteArray1<'_, bool>) -> PyResult<()> {
        let out = slice_of(&mut out, self.rows())?;
        out.iter_mut()
            .zip(self.evaluator.running())
            .for_each(|(out, running)| *out = running);
        Ok(())
    }

    /// Returns the oracle's actions, one per episode and ego.
    fn oracle_actions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let egos = self.evaluator.egos();
        let actions = (self.evaluator.envs().iter())
            .flat_map(|env| (0..egos).map(move |ego| env.oracle_action(ego).index() as i64));
        actions.collect::<Vec<i64>>().into_pyarray(py)
    }

    /// Searches for the action of the ego in each running episode, `horizon` steps ahead and with at most `expansions`
    /// states. Returns the actions, one per episode, and the number of states that the searches expanded.
    fn planned_actions<'py>(
        &mut self,
        py: Python<'py>,
        horizon: u32,
        expansions: usize,
    ) -> PyResult<(Bound<'py, PyArray1<i64>>, usize)> {
        if self.evaluator.egos() != 1 {
            return Err(PyValueError::new_err(
                "the planner drives one ego: set `task.egos` to 1",
            ));
        }
        let bounds = SearchBounds {
            horizon: horizon.max(1),
            expansions: expansions.max(1),
        };
        let count = self.evaluator.envs().len();
        if self.planners.first().map(Planner::bounds) != Some(bounds) {
            self.planners = (0..count).map(|_| Planner::new(bounds)).collect();
        }
        let (evaluator, planners) = (&self.evaluator, &mut self.planners);
        let planned = self.signals.detach(py, || {
            let plan = |(env, planner): (&Env, &mut Planner)| match env.is_running() {
                true => planner
                    .plan(env)
                    .map(|planned| (planned.action.index() as i64, planned.expanded)),
                false => Ok((0, 0)),
            };
            evaluator
                .envs()
                .iter()
                .zip(planners)
                .map(plan)
                .collect::<Result<Vec<(i64, usize)>, _>>()
        })?;
        let planned = planned.map_err(|fault| self.task.get().error(py, fault))?;
        let expanded = planned.iter().map(|(_, expanded)| expanded).sum();
        let actions: Vec<i64> = planned.into_iter().map(|(action, _)| action).collect();
        Ok((actions.into_pyarray(py), expanded))
    }

    /// Returns the actions that the cars have taken in an episode, which shields may have replaced, one byte per step
    /// and ego.
    fn taken(&self, at: usize) -> PyResult<Vec<u8>> {
        let env = self.evaluator.envs().get(at);
        let env = env.ok_or_else(|| PyIndexError::new_err(format!("there is no episode {at}")))?;
        let byte = |action: &Action| u8::try_from(action.index()).expect("less than 16");
        Ok(env.taken().flatten().map(byte).collect())
    }

    /// Steps every running episode. `actions` has one per episode and ego.
    fn step(&mut self, py: Python<'_>, actions: PyReadonlyArray1<'_, i64>) -> PyResult<()> {
        let given = actions.as_array();
        check(given.len(), self.rows())?;
        let egos = self.evaluator.egos();
        self.actions.clear();
        for (at, &action) in given.iter().enumerate() {
            self.actions.push(read_action(py, &self.task.get().task, action, || {
                format!(" (of episode {})", at / egos)
            })?);
        }
        let (evaluator, actions) = (&mut self.evaluator, &self.actions);
        (self.signals.detach(py, || evaluator.step(actions))?).map_err(|fault| self.task.get().error(py, fault))
    }

    /// Returns the results: `summary`, with the score relative to a baseline on the same episodes, and `episodes`.
    fn report<'py>(&self, py: Python<'py>, baseline: &PyRandomBaseline) -> PyResult<Bound<'py, PyAny>> {
        let (task, rollouts) = (self.task.get(), self.evaluator.rollouts());
        check(baseline.baseline.returns().len(), self.evaluator.envs().len())?;
        let summary = summarize(&task.task, rollouts, Some(baseline.baseline.returns()));
        report(py, task, &summary, (rollouts, 1))
    }
}

impl PyBatchEvaluator {
    /// Returns the number of egos of all episodes.
    fn rows(&self) -> usize {
        self.evaluator.envs().len() * self.evaluator.egos()
    }
}

/// Checks the number of values.
fn check(given: usize, expected: usize) -> PyResult<()> {
    match given == expected {
        true => Ok(()),
        false => Err(PyValueError::new_err(format!(
            "expected {expected} values, one per episode and ego, not {given}"
        ))),
    }
}

/// Reports adjacent rollouts, one per episode, run and ego.
fn report<'py>(
    py: Python<'py>,
    task: &PyTask,
    summary: &Summary,
    (rollouts, runs): (&[Rollout], usize),
) -> PyResult<Bound<'py, PyAny>> {
    let egos = task.task.evaluated_egos();
    let record = |(at, rollout): (usize, &Rollout)| {
        let episode = at / (runs * egos);
        let table = table_of(&task.task);
        let [actions, constrained] = [rollout.actions, rollout.constrained]
            .map(|steps| steps_by_action(table, steps).collect::<BTreeMap<&str, u32>>());
        let labels = rollout.broken.iter().map(|&constraint| task.task.label(constraint));
        let mut record = json!({
            "episode": episode, "steps": rollout.steps, "total": rollout.total, "success": rollout.success,
            "truncated": rollout.truncated, "actions": actions, "constrained": constrained,
            "violations": labels.collect::<Vec<&str>>(),
        });
        if task.task.shares() && runs == 1 {
            record["observed_clauses"] = json!(rollout.observed_clauses);
        }
        if egos > 1 {
            record["ego"] = json!(at % egos);
        }
        record
    };
    let episodes: Vec<Value> = rollouts.iter().enumerate().map(record).collect();
    to_python(py, &json!({"summary": summary, "episodes": episodes}))
}

/// Describes the numbers of `groundings` observations: their columns, the number of entities, and whether the length of
/// the route follows. Reads no episodes.
#[pyfunction]
fn layout<'py>(py: Python<'py>, task: &PyTask) -> PyResult<Bound<'py, PyAny>> {
    to_python(py, &layout_of(&task.task))
}

fn layout_of(task: &SpfTask) -> Value {
    let (oracle, vocabulary) = (task.oracle(), &task.world().vocabulary);
    let columns = oracle.columns().into_iter().map(|column| {
        let mut described = json!({"predicate": column.name, "arity": column.arity, "width": column.width});
        if let Some(quantity) = vocabulary.predicates[column.predicate].quantity() {
            described["quantity"] = json!(quantity.name());
        }
        if let Some(scale) = column.scale {
            described["scale"] = json!(scale);
        }
        described
    });
    json!({
        "egos": task.config().egos.map(|egos| egos.value), "entities": oracle.entities(), "columns": columns.collect::<Vec<Value>>(), "width": task.observation_width(),
        "route_length": task.config().route_length,
        "sensors": task.sensors().map(|sensors| sensors.config().output.name()),
        "shield": task.shield().map(|shield| shield.config().mode.name()),
    })
}

/// Describes a task: the [layout] of observations, the number and the hash of the recorded episodes of each split, and
/// the hashes of its configuration and rules as in the headers of traces.
#[pyfunction]
fn describe<'py>(py: Python<'py>, task: &PyTask) -> PyResult<Bound<'py, PyAny>> {
    let (shared, world) = (&task.task, task.task.world());
    let (config, oracle) = (shared.config(), shared.oracle());
    let constraints = oracle.constraints().iter().enumerate().map(|(number, constraint)| {
        let reward = shared.reward(constraint.action, &[number], 1);
        json!({"clause": shared.label(number), "action": table_of(shared).name(constraint.action), "reward": reward})
    });
    let by_action: BTreeMap<&str, f64> = (table_of(shared).names())
        .zip(config.reward.actions.iter().copied())
        .collect();
    let mut splits = serde_json::Map::new();
    for split in Split::ALL {
        let Some(agents) = world.scenario.agent_set(split) else {
            continue;
        };
        let set = match config.episodes[split as usize] {
            Some(_) => Some(task.episode_set(py, split)?),
            None => None,
        };
        let entry = json!({
            "agents": agents.entries().map(|group| group.count).sum::<u32>(),
            "episodes": set.as_ref().map(|set| set.episodes.len()),
            "hash": set.as_ref().map(EpisodeSet::hash),
        });
        splits.insert(split.name().to_owned(), entry);
    }
    let mut description = json!({
        "state": shared.state_shape(), "view": world.scenario.view, "priority_scale": shared.priority_scale(),
        "horizon": config.horizon, "patience": config.patience, "overtime": config.reward.overtime,
        "shaping": config.reward.shaping, "order": config.order.name(),
        "config_hash": world.scenario.hash, "rules_hash": task.rules_hash,
        "actions": by_action, "constraints": constraints.collect::<Vec<Value>>(), "splits": splits,
    });
    if let (Value::Object(all), Value::Object(layout)) = (&mut description, layout_of(shared)) {
        all.extend(layout);
    }
    to_python(py, &description)
}
