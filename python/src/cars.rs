//! Every car of a city, driven.

use crate::episode::{PyEpisode, read_episode};
use crate::task::{PyTask, speed, split_named, view_named};
use crate::{Signals, slice_of};
use logicity::config::Speed;
use logicity::task::path::{Egos, Env, EpisodeSource, Info, View, describe};
use numpy::{PyArray3, PyReadwriteArrayDyn};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyCars>()
}

/// A city in which Python drives every car.
#[pyclass(name = "Cars", module = "logicity._logicity")]
struct PyCars {
    task: Py<PyTask>,
    env: Env,
    view: View,
    source: EpisodeSource,
    actions: Vec<Speed>,
    signals: Arc<Signals>,
}

#[pymethods]
impl PyCars {
    #[new]
    fn new(py: Python<'_>, task: Py<PyTask>, split: &str, observation: &str) -> PyResult<Self> {
        let (split, view) = (split_named(split)?, view_named(observation)?);
        let shared = Arc::clone(&task.get().task);
        let signals = Signals::new();
        let stop = signals.stop();
        let env = signals
            .detach(py, || Env::new_until(shared, split, Egos::Cars, stop))?
            .map_err(|fault| task.get().error(py, fault))?;
        Ok(PyCars {
            task,
            env,
            view,
            source: EpisodeSource::new(0, None),
            actions: Vec::new(),
            signals,
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
    fn reset(&mut self, py: Python<'_>, episode: Option<Bound<'_, PyDict>>) -> PyResult<()> {
        let given = episode.map(|episode| read_episode(&episode, &self.env));
        let episode = given.transpose().map_err(|fault| self.task.get().error(py, fault))?;
        let (env, source) = (&mut self.env, &mut self.source);
        let begun = self.signals.detach(py, || match &episode {
            Some(episode) => env.reset_to(episode),
            None => source.begin(env),
        })?;
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
        (self.signals.detach(py, || env.step(actions))?).map_err(|fault| self.task.get().error(py, fault))
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
        self.check(car)?;
        let wanted = self.view.shape(&self.task.get().task).iter().product();
        self.view.write(&self.env, car, slice_of(&mut out, wanted)?);
        Ok(())
    }

    /// How the episode began.
    fn episode(&self) -> PyEpisode {
        PyEpisode::of(self.env.episode())
    }

    /// Why the rules want what they want of a car.
    fn explain(&self, py: Python<'_>, car: usize) -> PyResult<String> {
        self.check(car)?;
        self.task.get().explain(py, &self.env, car, &self.signals)
    }

    /// The state of a car in a few lines.
    fn text(&self, car: usize) -> PyResult<String> {
        self.check(car)?;
        Ok(describe(&self.env, car))
    }

    /// The city: red, green and blue.
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        self.task.get().picture(py, &self.env, &[])
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
