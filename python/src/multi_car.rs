//! An environment that controls every car of a city.

use crate::episode::{PyEpisode, read_episode};
use crate::task::{
    PyTask, ShieldSettings, check_permitted, read_action, read_actions, shield_of, split_named, table_of,
};
use crate::{Signals, borrowed, borrowed_mut, slice_of};
use logicity::city::Action;
use logicity::task::spf::{ControlMode, Env, EpisodeSource, Info, ObservationKind, describe};
use numpy::{PyArray3, PyReadwriteArrayDyn};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyMultiCarEnv>()
}

/// A city in which Python controls every car.
#[pyclass(name = "MultiCarEnv", module = "logicity._logicity")]
struct PyMultiCarEnv {
    task: Py<PyTask>,
    env: Env,
    view: ObservationKind,
    source: EpisodeSource,
    actions: Vec<Action>,
    /// The task whose rules the shield has, if they are not those of `task`.
    shield_rules: Option<Py<PyTask>>,
    signals: Arc<Signals>,
}

#[pymethods]
impl PyMultiCarEnv {
    #[new]
    fn new(py: Python<'_>, task: Py<PyTask>, split: &str, observation: &str, judges: bool) -> PyResult<Self> {
        let (split, view) = (split_named(split)?, task.get().view(py, observation)?);
        let shared = Arc::clone(&task.get().task);
        let signals = Signals::new();
        let cancel = signals.cancel();
        let mut env = signals
            .detach(py, || Env::new_with(shared, split, ControlMode::Cars, &cancel))?
            .map_err(|fault| task.get().error(py, fault))?;
        if judges {
            env.judge_actions();
        }
        Ok(PyMultiCarEnv {
            task,
            env,
            view,
            source: EpisodeSource::new(0, None),
            actions: Vec::new(),
            shield_rules: None,
            signals,
        })
    }

    /// Sets the shield of all cars, by the rules of a task with the same observations, or of this one.
    fn set_shield(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        rules: Option<Py<PyTask>>,
        settings: ShieldSettings,
    ) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let of = rules.as_ref().unwrap_or(&this.task).get();
        let shield = shield_of(py, of, &settings)?;
        let env = &mut this.env;
        let set = this.signals.detach(py, || env.replace_shield(Some(shield)))?;
        set.map_err(|fault| of.error(py, fault))?;
        this.shield_rules = rules;
        Ok(())
    }

    /// Returns the names of the clauses that the shield's rules have; `None` without a shield.
    fn shield_clauses<'py>(slf: &Bound<'py, Self>, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        let this = borrowed(slf)?;
        this.env.shield().map(|_| this.shield_task().clauses(py)).transpose()
    }

    /// Explains what the shield of a car says now.
    fn explain_shield(slf: &Bound<'_, Self>, py: Python<'_>, car: usize) -> PyResult<String> {
        let this = &mut *borrowed_mut(slf)?;
        this.check(car)?;
        let rules = this.shield_rules.as_ref().unwrap_or(&this.task).get();
        rules.explain_shield(py, &mut this.env, car, &this.signals)
    }

    /// Returns the names of the cars.
    fn names(slf: &Bound<'_, Self>) -> PyResult<Vec<String>> {
        let this = borrowed(slf)?;
        let agents = this.env.city().agents();
        let controlled_cars = this.env.controlled_cars().iter();
        Ok(controlled_cars
            .map(|controlled_car| agents[controlled_car.agent()].name().to_string())
            .collect())
    }

    /// Sets the seed of the episodes, and skips the first `begun` episodes.
    fn seed(slf: &Bound<'_, Self>, seed: u64, begun: u64) -> PyResult<()> {
        let mut source = EpisodeSource::new(seed, None);
        source.skip_to(begun);
        borrowed_mut(slf)?.source = source;
        Ok(())
    }

    /// Returns the seed of the episodes, and the number of episodes started from it.
    fn source(slf: &Bound<'_, Self>) -> PyResult<[u64; 2]> {
        Ok(borrowed(slf)?.source.place())
    }

    /// Returns the actions taken in the episode, one byte per car and step.
    fn taken(slf: &Bound<'_, Self>) -> PyResult<Vec<u8>> {
        let this = borrowed(slf)?;
        Ok(this
            .env
            .taken()
            .flatten()
            .map(|&action| u8::try_from(action.index()).expect("less than 16"))
            .collect())
    }

    /// Starts `episode`, and takes actions as `taken` returns them.
    fn replay(slf: &Bound<'_, Self>, py: Python<'_>, episode: Bound<'_, PyDict>, taken: &[u8]) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let task = this.task.get();
        let start = read_episode(&episode, &this.env).map_err(|fault| task.error(py, fault))?;
        let actions = read_actions(py, &this.task.get().task, taken)?;
        let env = &mut this.env;
        let count = env.controlled_cars().len();
        let replayed = this.signals.detach(py, || {
            env.reset_to(&start)?;
            actions.chunks_exact(count).try_for_each(|actions| env.step(actions))?;
            env.ask_shield()
        })?;
        replayed.map_err(|fault| task.error(py, fault))
    }

    /// Starts the next episode, or `episode`.
    fn reset(slf: &Bound<'_, Self>, py: Python<'_>, episode: Option<Bound<'_, PyDict>>) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let given = episode.map(|episode| read_episode(&episode, &this.env));
        let episode = given.transpose().map_err(|fault| this.task.get().error(py, fault))?;
        let (env, source) = (&mut this.env, &mut this.source);
        let begun = this.signals.detach(py, || {
            match &episode {
                Some(episode) => env.reset_to(episode),
                None => source.begin(env),
            }?;
            env.ask_shield()
        })?;
        begun.map_err(|fault| this.task.get().error(py, fault))
    }

    /// Steps with one action per car. Actions of cars whose episode has ended have no effect.
    fn step(slf: &Bound<'_, Self>, py: Python<'_>, actions: Vec<i64>) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let count = this.env.controlled_cars().len();
        if actions.len() != count {
            return Err(PyValueError::new_err(format!(
                "expected {count} actions, one per car, not {}",
                actions.len()
            )));
        }
        this.actions.clear();
        for (controlled_car, action) in actions.into_iter().enumerate() {
            this.actions.push(read_action(py, &this.task.get().task, action, || {
                format!(" (of car {controlled_car})")
            })?);
        }
        let table = table_of(&this.task.get().task);
        for (car, &action) in this.env.controlled_cars().iter().zip(&this.actions) {
            let of = || format!(" of {}", this.env.city().agents()[car.agent()].name());
            let says = (this.env.shield(), car.verdict().filter(|_| car.is_running()));
            check_permitted(py, says, (action, table.name(action)), of)?;
        }
        let (env, actions) = (&mut this.env, &this.actions);
        let step = || env.step_shielded(actions).and_then(|()| env.ask_shield());
        (this.signals.detach(py, step)?).map_err(|fault| this.task.get().error(py, fault))
    }

    /// Returns the outcome of a car's last action: reward, termination, truncation and info.
    fn outcome<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        car: usize,
    ) -> PyResult<(f64, bool, bool, Bound<'py, PyDict>)> {
        let this = borrowed(slf)?;
        this.check(car)?;
        let last = this.env.controlled_cars()[car].last();
        let mut info = Info::default();
        info.note(&this.env, car);
        let dict = this.task.get().info(py, &info)?;
        if let Some(shield) = this.env.shield() {
            this.task.get().add_shield(&dict, &info, shield)?;
        }
        Ok((last.shaped_reward(), last.terminated, last.truncated, dict))
    }

    /// Writes the observation of a car.
    fn observe(slf: &Bound<'_, Self>, car: usize, mut out: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        let this = borrowed(slf)?;
        this.check(car)?;
        let wanted = this.view.shape(&this.task.get().task).iter().product();
        this.view.write(&this.env, car, slice_of(&mut out, wanted)?);
        Ok(())
    }

    /// Returns the start of the episode.
    fn episode(slf: &Bound<'_, Self>) -> PyResult<PyEpisode> {
        Ok(PyEpisode::of(borrowed(slf)?.env.episode()))
    }

    /// Explains the action that the rules derive for a car, or a fact.
    fn explain(slf: &Bound<'_, Self>, py: Python<'_>, car: usize, fact: Option<&str>) -> PyResult<String> {
        let this = borrowed(slf)?;
        this.check(car)?;
        (this.task.get()).explain(py, (&this.env, car), fact, &this.signals)
    }

    /// Returns the state of a car as text.
    fn text(slf: &Bound<'_, Self>, car: usize) -> PyResult<String> {
        let this = borrowed(slf)?;
        this.check(car)?;
        Ok(describe(&this.env, car))
    }

    /// Returns an RGB picture of the city.
    fn picture<'py>(slf: &Bound<'py, Self>, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let this = borrowed(slf)?;
        this.task.get().picture(py, &this.env, &[])
    }
}

impl PyMultiCarEnv {
    /// Returns the task with the rules of the shield.
    fn shield_task(&self) -> &PyTask {
        self.shield_rules.as_ref().unwrap_or(&self.task).get()
    }

    fn check(&self, car: usize) -> PyResult<()> {
        match car < self.env.controlled_cars().len() {
            true => Ok(()),
            false => Err(PyIndexError::new_err(format!("there is no car {car}"))),
        }
    }
}
