//! Vectorized environments with one controlled car each, or with several egos.

use crate::actor::PyPolicyNetwork;
use crate::city::one_of;
use crate::episode::{PyEpisode, PyEpisodeOption, read_episode};
use crate::task::{
    PyTask, ShieldSettings, action_mask, check_permitted, gymnasium_error, read_action, read_actions, shield_mask,
    shield_of, split_named, table_of, write_violations,
};
use crate::{Signals, borrowed, borrowed_mut, slice_of};
use logicity::city::{Action, Split};
use logicity::diag::did_you_mean;
use logicity::task::spf::{
    Autoreset, Begin, ControlMode, Episode, EpisodeSource, Info, PolicyNetwork, SubEnv, VectorEnv, describe,
};
use numpy::{
    PyArray1, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray1,
    PyReadwriteArray2, PyReadwriteArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::sync::Arc;

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyVectorEnv>()
}

/// The largest number of steps that a call collects. With distinct observations, they take some GiB.
const STEPS_MAX: usize = 1 << 22;

fn autoreset_named(name: &str) -> PyResult<Autoreset> {
    let all = [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled];
    one_of("autoreset mode", name, &all, |mode| match mode {
        Autoreset::NextStep => "NextStep",
        Autoreset::SameStep => "SameStep",
        Autoreset::Disabled => "Disabled",
    })
}

/// The episodes that environments start.
#[derive(Clone)]
enum Episodes {
    Drawn,
    Demanding,
    Recorded(Arc<[Episode]>),
}

impl Episodes {
    fn named(py: Python<'_>, name: &str, task: &PyTask, split: Split) -> PyResult<Episodes> {
        const NAMES: [&str; 3] = ["drawn", "drawn-demanding", "recorded"];
        match NAMES.iter().position(|known| *known == name) {
            Some(0) => Ok(Episodes::Drawn),
            Some(1) => Ok(Episodes::Demanding),
            Some(_) => Ok(Episodes::Recorded(Arc::clone(task.recorded_episodes(py, split)?))),
            None => {
                let help = match did_you_mean(name, NAMES) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("known: {}", NAMES.map(|name| format!("`{name}`")).join(", ")),
                };
                Err(PyValueError::new_err(format!("unknown `episodes` \"{name}\"; {help}")))
            }
        }
    }

    fn source(&self, seed: u64) -> EpisodeSource {
        match self {
            Episodes::Drawn => EpisodeSource::new(seed, None),
            Episodes::Demanding => EpisodeSource::demanding(seed),
            Episodes::Recorded(set) => EpisodeSource::new(seed, Some(Arc::clone(set))),
        }
    }
}

/// Arrays with one row per ego of every environment: oracle action, progress, success, steps, seed, violations.
type Columns<'py> = (
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray2<'py, bool>,
);

/// The outcomes of a step: rewards, terminations and truncations.
type Outcomes<'py> = (
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, bool>,
);

/// The start of an episode, and the actions taken in it, one byte each.
type BegunEpisode<'py> = (Bound<'py, PyDict>, Vec<u8>);

/// The end of an episode: the index of the environment, and the last observations of its egos, one after the other.
type EpisodeEnd<'py> = (usize, Bound<'py, PyArray1<f32>>);

/// Writes infos to columns with one row per ego of every environment.
fn write_infos<'a>(
    columns: &mut Columns<'_>,
    [count, clauses]: [usize; 2],
    infos: impl Iterator<Item = (usize, &'a Info)>,
) -> PyResult<()> {
    let (oracle, progress, success, steps, seeds, violations) = columns;
    let (oracle, progress) = (slice_of(oracle, count)?, slice_of(progress, count)?);
    let (success, steps, seeds) = (
        slice_of(success, count)?,
        slice_of(steps, count)?,
        slice_of(seeds, count)?,
    );
    let violations = slice_of(violations, count * clauses)?;
    for (at, info) in infos {
        oracle[at] = info.oracle_action as i64;
        progress[at] = info.progress;
        success[at] = info.success;
        steps[at] = i64::from(info.steps);
        seeds[at] = info.seed.cast_signed();
        write_violations(info, &mut violations[at * clauses..][..clauses]);
    }
    Ok(())
}

/// A batch of environments that one call steps.
#[pyclass(name = "VectorEnv", module = "logicity._logicity")]
struct PyVectorEnv {
    task: Py<PyTask>,
    split: Split,
    vector: VectorEnv,
    episodes: Episodes,
    actions: Vec<Action>,
    /// The task whose rules the shield has, if they are not those of `task`.
    shield_rules: Option<Py<PyTask>>,
    signals: Arc<Signals>,
}

/// What a shield does and says, a row per ego of every environment: masks, probabilities, replaced actions and violated
/// clauses.
type ShieldColumns<'py> = (
    PyReadwriteArray2<'py, i8>,
    PyReadwriteArray2<'py, f64>,
    PyReadwriteArray1<'py, i64>,
    PyReadwriteArray2<'py, bool>,
);

#[pymethods]
impl PyVectorEnv {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "each is an argument in Python")]
    fn new(
        py: Python<'_>,
        task: Py<PyTask>,
        split: &str,
        count: usize,
        autoreset: &str,
        observation: &str,
        episodes: &str,
        threads: usize,
        several: bool,
    ) -> PyResult<Self> {
        let split = split_named(split)?;
        let control = if several { ControlMode::Egos } else { ControlMode::First };
        let (autoreset, view) = (autoreset_named(autoreset)?, task.get().view(py, observation)?);
        let episodes = Episodes::named(py, episodes, task.get(), split)?;
        let sources = std::iter::repeat_n(episodes.source(0), count);
        let shared = &task.get().task;
        let signals = Signals::new();
        let cancel = signals.cancel();
        let vector = signals
            .detach(py, || {
                VectorEnv::new_with(shared, (split, control), sources, autoreset, view, threads, &cancel)
            })?
            .map_err(|fault| task.get().error(py, fault))?;
        Ok(PyVectorEnv {
            task,
            split,
            vector,
            episodes,
            actions: Vec::with_capacity(count),
            shield_rules: None,
            signals,
        })
    }

    /// Sets the shield of all environments, by the rules of a task with the same observations, or of this one.
    fn set_shield(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        rules: Option<Py<PyTask>>,
        settings: ShieldSettings,
    ) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let of = rules.as_ref().unwrap_or(&this.task).get();
        let shield = shield_of(py, of, &settings)?;
        let vector = &mut this.vector;
        let set = this.signals.detach(py, || vector.set_shield(Some(&shield)))?;
        set.map_err(|fault| of.error(py, fault))?;
        this.shield_rules = rules;
        Ok(())
    }

    /// Returns the names of the clauses that the shield's rules have; `None` without a shield.
    fn shield_clauses<'py>(slf: &Bound<'py, Self>, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        let this = borrowed(slf)?;
        let shielded = this
            .vector
            .sub_envs()
            .first()
            .is_some_and(|first| first.env().shield().is_some());
        shielded.then(|| this.shield_task().clauses(py)).transpose()
    }

    /// Explains what the shield of an ego says now.
    #[pyo3(signature = (at, ego = 0))]
    fn explain_shield(slf: &Bound<'_, Self>, py: Python<'_>, at: usize, ego: usize) -> PyResult<String> {
        let this = &mut *borrowed_mut(slf)?;
        this.begun(py, at)?;
        this.shield_text(py, at, ego)
    }

    /// Returns the number of egos of each environment.
    fn egos(slf: &Bound<'_, Self>) -> PyResult<usize> {
        Ok(borrowed(slf)?.vector.egos())
    }

    /// Returns the names of the egos.
    fn names(slf: &Bound<'_, Self>) -> PyResult<Vec<String>> {
        let this = borrowed(slf)?;
        let env = this.sub_env(0)?.env();
        let agents = env.city().agents();
        let names = env
            .controlled_cars()
            .iter()
            .map(|car| agents[car.agent()].name().to_string());
        Ok(names.collect())
    }

    /// Writes for each ego whether its action counts in the next step.
    fn active(slf: &Bound<'_, Self>, mut out: PyReadwriteArrayDyn<'_, bool>) -> PyResult<()> {
        let this = borrowed(slf)?;
        let out = slice_of(&mut out, this.rows_of_egos())?;
        for (at, ego, place) in this.egos_of_all() {
            out[place] = this.vector.sub_envs()[at].is_active(ego);
        }
        Ok(())
    }

    /// Writes what the shield does and says in all environments. With `ended`, writes that at the end of the episodes
    /// that ended in the last step, for autoreset in the same step.
    fn shield_infos(slf: &Bound<'_, Self>, columns: ShieldColumns<'_>, ended: bool) -> PyResult<()> {
        let this = borrowed(slf)?;
        let sub_envs = this.vector.sub_envs();
        let count = this.rows_of_egos();
        let table = table_of(&this.task.get().task);
        let (actions, clauses) = (table.all().len(), this.shield_task().constraints());
        let (mut masks, mut probabilities, mut replaced, mut violations) = columns;
        let masks = slice_of(&mut masks, count * actions)?;
        let probabilities = slice_of(&mut probabilities, count * actions)?;
        let replaced = slice_of(&mut replaced, count)?;
        let violations = slice_of(&mut violations, count * clauses)?;
        for (at, ego, row) in this.egos_of_all() {
            let Some(info) = info_of(&sub_envs[at], ego, ended) else {
                continue;
            };
            let mask = masks[row * actions..][..actions].iter_mut();
            mask.zip(shield_mask(table, info))
                .for_each(|(to, permits)| *to = permits);
            if let Some(verdict) = &info.verdict {
                let probabilities = probabilities[row * actions..][..actions].iter_mut();
                (probabilities.zip(table.all())).for_each(|(to, action)| *to = verdict.probability(action));
            }
            replaced[row] = info.replaced.map_or(-1, |action| action.index() as i64);
            info.reasons
                .iter()
                .for_each(|clause| violations[row * clauses + clause] = true);
        }
        Ok(())
    }

    /// Sets the seed of an environment's episodes, and skips the first `begun` episodes.
    fn seed(slf: &Bound<'_, Self>, at: usize, seed: u64, begun: u64) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        this.sub_env(at)?;
        let mut source = this.episodes.source(seed);
        source.skip_to(begun);
        this.vector.set_source(at, source);
        Ok(())
    }

    /// Returns the seed of an environment's episodes, and the number of episodes started from it.
    fn source(slf: &Bound<'_, Self>, at: usize) -> PyResult<[u64; 2]> {
        let this = borrowed(slf)?;
        Ok(this.sub_env(at)?.source().place())
    }

    /// Starts episodes, see `PyEpisodeOption`. Does not change the observations of other environments.
    fn reset(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        begin: Vec<PyEpisodeOption<'_>>,
        observations: &Bound<'_, PyArrayDyn<f32>>,
    ) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let mut observations = observations.try_readwrite()?;
        let task = this.task.get();
        this.check(begin.len(), this.vector.sub_envs().len())?;
        let read = |(begin, sub_env): (PyEpisodeOption<'_>, &SubEnv)| match begin {
            PyEpisodeOption::Next(next) => Ok(next.then_some(Begin::Next)),
            PyEpisodeOption::Recorded(number) => {
                let recorded = task.recorded_episodes(py, this.split)?;
                let place: Option<usize> = number.extract().ok();
                let episode = place.and_then(|place| recorded.get(place)).ok_or_else(|| {
                    let (split, count) = (this.split.name(), recorded.len());
                    let message = format!("no episode {number}: the split `{split}` has {count} episodes, from 0");
                    PyIndexError::new_err(message)
                })?;
                Ok(Some(Begin::Given(Arc::new(episode.clone()))))
            }
            PyEpisodeOption::Given(episode) => match read_episode(&episode, sub_env.env()) {
                Ok(episode) => Ok(Some(Begin::Given(Arc::new(episode)))),
                Err(fault) => Err(task.error(py, fault)),
            },
        };
        let begin: Vec<Option<Begin>> = begin
            .into_iter()
            .zip(this.vector.sub_envs())
            .map(read)
            .collect::<PyResult<_>>()?;
        let rows = this.rows(&mut observations)?;
        let vector = &mut this.vector;
        (this.signals.detach(py, || vector.reset(&begin, rows))?).map_err(|fault| task.error(py, fault))
    }

    /// Steps a batch of one environment. Returns the reward, the termination, the truncation and the info.
    fn step_one<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        action: i64,
        observation: &Bound<'py, PyArrayDyn<f32>>,
    ) -> PyResult<(f64, bool, bool, Bound<'py, PyDict>)> {
        let this = &mut *borrowed_mut(slf)?;
        let mut observation = observation.try_readwrite()?;
        this.check(1, 1)?;
        this.check_ready(py)?;
        let task = this.task.get();
        let actions = [read_action(py, &task.task, action, String::new)?];
        this.check_permitted(py, &actions)?;
        // The state of the decision is gone after the step.
        let verdict = this.vector.sub_envs()[0].info(0).verdict.as_ref();
        let permitted = verdict.map(|verdict| verdict.permitted);
        let reason = match permitted.is_some_and(|permitted| !permitted.contains(actions[0])) {
            true => this.shield_text(py, 0, 0)?,
            false => String::new(),
        };
        let task = this.task.get();
        let rows = this.rows(&mut observation)?;
        (this.signals.run_polled(|| this.vector.step(&actions, rows))?).map_err(|fault| task.error(py, fault))?;
        let sub_env = &this.vector.sub_envs()[0];
        let outcome = sub_env.outcome(0);
        let info = this.full_info(py, sub_env, 0)?;
        if let Some(executed) = sub_env.env().taken().next_back().filter(|_| permitted.is_some()) {
            let name = |action| table_of(&task.task).name(action);
            let reason = match sub_env.info(0).replaced {
                Some(replaced) => format!("{} replaces {}\n{reason}", name(executed[0]), name(replaced)),
                None => String::new(),
            };
            info.set_item("shield_reason", reason)?;
        }
        Ok((outcome.reward, outcome.terminated, outcome.truncated, info))
    }

    /// Steps all environments. Each ego has an action and a row of the outcomes and columns.
    fn step<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        actions: PyReadonlyArray1<'py, i64>,
        observations: &Bound<'py, PyArrayDyn<f32>>,
        outcomes: Outcomes<'py>,
        mut columns: Columns<'py>,
    ) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let mut observations = observations.try_readwrite()?;
        let given = actions
            .as_slice()
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        let count = this.rows_of_egos();
        this.check(given.len(), count)?;
        this.check_ready(py)?;
        this.actions.clear();
        for (row, &action) in given.iter().enumerate() {
            let action = read_action(py, &this.task.get().task, action, || format!(" ({})", this.of_row(row)))?;
            this.actions.push(action);
        }
        this.check_permitted(py, &this.actions)?;
        let task = this.task.get();
        let rows = this.rows(&mut observations)?;
        let (vector, actions) = (&mut this.vector, &this.actions);
        (this.signals.detach(py, || vector.step(actions, rows))?).map_err(|fault| task.error(py, fault))?;

        let (mut rewards, mut terminated, mut truncated) = outcomes;
        let (rewards, terminated) = (slice_of(&mut rewards, count)?, slice_of(&mut terminated, count)?);
        let truncated = slice_of(&mut truncated, count)?;
        let sub_envs = this.vector.sub_envs();
        for (at, ego, row) in this.egos_of_all() {
            let outcome = sub_envs[at].outcome(ego);
            (rewards[row], terminated[row], truncated[row]) = (outcome.reward, outcome.terminated, outcome.truncated);
        }
        let infos = sub_envs.iter().flat_map(SubEnv::infos).enumerate();
        write_infos(&mut columns, [count, task.constraints()], infos)
    }

    /// Runs every environment under the stochastic policies of networks, one for all egos or for each, see
    /// `logicity::task::spf::VectorEnv::collect`. `random` has shape (environments x egos, steps). Returns the arrays
    /// of each network.
    fn collect<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        networks: Vec<PyRef<'py, PyPolicyNetwork>>,
        random: PyReadonlyArray2<'py, f32>,
        observations: &Bound<'py, PyArrayDyn<f32>>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let this = &mut *borrowed_mut(slf)?;
        let mut observations = observations.try_readwrite()?;
        let rows = this.rows(&mut observations)?;
        let [count, steps] = [0, 1].map(|axis| random.shape()[axis]);
        this.check(count, this.rows_of_egos())?;
        this.check_ready(py)?;
        if ![1, this.vector.egos()].contains(&networks.len()) {
            let (given, egos) = (networks.len(), this.vector.egos());
            let message = format!("expected a network for all egos or for each of {egos}, not {given} networks");
            return Err(PyValueError::new_err(message));
        }
        if count.saturating_mul(steps) > STEPS_MAX {
            let message = format!("expected at most {STEPS_MAX} steps in all environments, not {count} x {steps}");
            return Err(PyValueError::new_err(message));
        }
        let expected = this.vector.width();
        if let Some(width) = (networks.iter().map(|network| network.network.width())).find(|width| *width != expected) {
            let message = format!("expected a network for observations of {expected} numbers, not {width}");
            return Err(PyValueError::new_err(message));
        }
        if this.vector.autoreset() != Autoreset::SameStep {
            return Err(PyValueError::new_err("expected the autoreset mode SameStep"));
        }
        // The array may have another memory layout.
        let random: Vec<f32> = random.as_array().iter().copied().collect();
        let (task, vector) = (this.task.get(), &mut this.vector);
        let of_all: Vec<&PolicyNetwork> = networks.iter().map(|network| &network.network).collect();
        let done = (this.signals).detach(py, || vector.collect(&of_all, &random, rows))?;
        let done = done.map_err(|fault| task.error(py, fault))?;
        let arrays = networks.iter().zip(done);
        arrays
            .map(|(network, done)| network.arrays(py, count / networks.len(), done))
            .collect()
    }

    /// Returns the episodes that ended in the last step, for autoreset in the same step.
    ///
    /// Writes the other keys of their infos to the columns.
    fn ended<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        mut columns: Columns<'py>,
    ) -> PyResult<Vec<EpisodeEnd<'py>>> {
        let this = borrowed(slf)?;
        let sub_envs = this.vector.sub_envs();
        let ended = || {
            sub_envs
                .iter()
                .enumerate()
                .filter_map(|(at, sub_env)| Some((at, sub_env.ended()?)))
        };
        let size = [this.rows_of_egos(), this.task.get().constraints()];
        let egos = this.vector.egos();
        let infos = ended().flat_map(|(at, (_, infos))| (at * egos..).zip(infos));
        write_infos(&mut columns, size, infos)?;
        let last = |(at, (rows, _)): (usize, (&[f32], &[Info]))| (at, PyArray1::from_slice(py, rows));
        Ok(ended().map(last).collect())
    }

    /// Writes the infos of the egos of some environments to the columns.
    fn infos<'py>(slf: &Bound<'py, Self>, mut columns: Columns<'py>, places: Vec<usize>) -> PyResult<()> {
        let this = borrowed(slf)?;
        let size = [this.rows_of_egos(), this.task.get().constraints()];
        let egos = this.vector.egos();
        for at in places {
            let infos = this.sub_env(at)?.infos();
            write_infos(&mut columns, size, (at * egos..).zip(infos))?;
        }
        Ok(())
    }

    /// Returns the info of an ego.
    #[pyo3(signature = (at, ego = 0))]
    fn info<'py>(slf: &Bound<'py, Self>, py: Python<'py>, at: usize, ego: usize) -> PyResult<Bound<'py, PyDict>> {
        let this = borrowed(slf)?;
        this.full_info(py, this.sub_env(at)?, this.checked_ego(ego)?)
    }

    /// Returns the true atoms that an ego observes.
    #[pyo3(signature = (at, ego = 0))]
    fn atoms<'py>(slf: &Bound<'py, Self>, py: Python<'py>, at: usize, ego: usize) -> PyResult<Bound<'py, PyTuple>> {
        let this = borrowed(slf)?;
        let env = this.sub_env(at)?.env();
        (this.task.get()).atoms(
            py,
            env,
            env.controlled_cars()[this.checked_ego(ego)?].observer().atoms(),
        )
    }

    /// Keeps the true atoms at the end of an episode after the next one has started.
    fn keep_last_atoms(slf: &Bound<'_, Self>) -> PyResult<()> {
        borrowed_mut(slf)?.vector.keep_last_atoms();
        Ok(())
    }

    /// Computes from the next reset on which actions violate no clause.
    fn judge_actions(slf: &Bound<'_, Self>) -> PyResult<()> {
        borrowed_mut(slf)?.vector.judge_actions();
        Ok(())
    }

    /// Writes for each ego which actions violate no clause. With `ended`, writes those at the end of the episodes that
    /// ended in the last step, for autoreset in the same step.
    fn action_masks(slf: &Bound<'_, Self>, mut out: PyReadwriteArray2<'_, i8>, ended: bool) -> PyResult<()> {
        let this = borrowed(slf)?;
        let sub_envs = this.vector.sub_envs();
        let table = table_of(&this.task.get().task);
        let count = table.all().len();
        let rows = slice_of(&mut out, count * this.rows_of_egos())?;
        for (at, ego, row) in this.egos_of_all() {
            if let Some(info) = info_of(&sub_envs[at], ego, ended) {
                rows[row * count..][..count].copy_from_slice(&action_mask(table, info));
            }
        }
        Ok(())
    }

    /// Returns the true atoms at the end of the episode that ended in the last step, if they were kept.
    #[pyo3(signature = (at, ego = 0))]
    fn ended_atoms<'py>(
        slf: &Bound<'py, Self>,
        py: Python<'py>,
        at: usize,
        ego: usize,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let this = borrowed(slf)?;
        let sub_env = this.sub_env(at)?;
        let atoms = sub_env.ended_atoms(ego).unwrap_or_default().iter().cloned();
        this.task.get().atoms(py, sub_env.env(), atoms)
    }

    /// Returns whether an environment has a running or finished episode.
    fn has_begun(slf: &Bound<'_, Self>, at: usize) -> PyResult<bool> {
        let this = borrowed(slf)?;
        Ok(this.sub_env(at)?.is_ready(Autoreset::NextStep))
    }

    /// Returns the actions taken in an environment's episode, one byte per step and ego.
    fn taken(slf: &Bound<'_, Self>, at: usize) -> PyResult<Vec<u8>> {
        let this = borrowed(slf)?;
        let taken = this.sub_env(at)?.env().taken().flatten();
        Ok(taken
            .map(|&action| u8::try_from(action.index()).expect("less than 16"))
            .collect())
    }

    /// Restores environments from the starts of their episodes and the actions taken.
    fn replay(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        episodes: Vec<Option<BegunEpisode<'_>>>,
        observations: &Bound<'_, PyArrayDyn<f32>>,
    ) -> PyResult<()> {
        let this = &mut *borrowed_mut(slf)?;
        let mut observations = observations.try_readwrite()?;
        this.check(episodes.len(), this.vector.sub_envs().len())?;
        let task = this.task.get();
        let read = |(episode, sub_env): (Option<BegunEpisode<'_>>, &SubEnv)| {
            let Some((start, taken)) = episode else { return Ok(None) };
            let start = read_episode(&start, sub_env.env()).map_err(|fault| task.error(py, fault))?;
            Ok(Some((Arc::new(start), read_actions(py, &task.task, &taken)?)))
        };
        let episodes: Vec<_> = (episodes.into_iter().zip(this.vector.sub_envs()).map(read)).collect::<PyResult<_>>()?;
        let rows = this.rows(&mut observations)?;
        let vector = &mut this.vector;
        (this.signals.detach(py, || vector.replay(&episodes, rows))?).map_err(|fault| task.error(py, fault))
    }

    /// Returns the start of an environment's episode.
    fn episode(slf: &Bound<'_, Self>, py: Python<'_>, at: usize) -> PyResult<PyEpisode> {
        let this = borrowed(slf)?;
        Ok(PyEpisode::of(this.begun(py, at)?.env().episode()))
    }

    /// Explains the oracle's action for an ego, or a fact.
    #[pyo3(signature = (at, fact, ego = 0))]
    fn explain(slf: &Bound<'_, Self>, py: Python<'_>, at: usize, fact: Option<&str>, ego: usize) -> PyResult<String> {
        let this = borrowed(slf)?;
        let ego = this.checked_ego(ego)?;
        (this.task.get()).explain(py, (this.begun(py, at)?.env(), ego), fact, &this.signals)
    }

    /// Returns the state of the egos of an environment as text.
    fn text(slf: &Bound<'_, Self>, py: Python<'_>, at: usize) -> PyResult<String> {
        let this = borrowed(slf)?;
        let env = this.begun(py, at)?.env();
        let texts: Vec<String> = (0..this.vector.egos()).map(|ego| describe(env, ego)).collect();
        Ok(texts.join("\n"))
    }

    /// Returns an RGB picture of an environment.
    fn picture<'py>(slf: &Bound<'py, Self>, py: Python<'py>, at: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let this = borrowed(slf)?;
        {
            let env = this.begun(py, at)?.env();
            // The picture marks a single ego.
            let marked = match env.controlled_cars() {
                [one] => std::slice::from_ref(one),
                _ => &[],
            };
            this.task.get().picture(py, env, marked)
        }
    }
}

/// Returns the info of an ego now, or at the end of the episode that ended in the last step.
fn info_of(sub_env: &SubEnv, ego: usize, ended: bool) -> Option<&Info> {
    match ended {
        false => Some(sub_env.info(ego)),
        true => sub_env.ended().map(|(_, infos)| &infos[ego]),
    }
}

impl PyVectorEnv {
    fn sub_env(&self, at: usize) -> PyResult<&SubEnv> {
        let sub_env = self.vector.sub_envs().get(at);
        sub_env.ok_or_else(|| PyIndexError::new_err(format!("there is no environment {at}")))
    }

    /// Returns the task with the rules of the shield.
    fn shield_task(&self) -> &PyTask {
        self.shield_rules.as_ref().unwrap_or(&self.task).get()
    }

    /// Returns the number of egos of all environments.
    fn rows_of_egos(&self) -> usize {
        self.vector.sub_envs().len() * self.vector.egos()
    }

    /// Returns the environment, the number and the row of every ego.
    fn egos_of_all(&self) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
        let egos = self.vector.egos();
        (0..self.rows_of_egos()).map(move |row| (row / egos, row % egos, row))
    }

    /// Names the environment or the ego of a row, for messages.
    fn of_row(&self, row: usize) -> String {
        let (egos, count) = (self.vector.egos(), self.vector.sub_envs().len());
        let (at, ego) = (row / egos, row % egos);
        let env = self.vector.sub_envs()[at].env();
        let name = || env.city().agents()[env.controlled_cars()[ego].agent()].name();
        match (egos, count) {
            (1, _) => format!("of environment {at}"),
            (_, 1) => format!("of {}", name()),
            _ => format!("of {} in environment {at}", name()),
        }
    }

    fn checked_ego(&self, ego: usize) -> PyResult<usize> {
        match ego < self.vector.egos() {
            true => Ok(ego),
            false => Err(PyIndexError::new_err(format!("there is no ego {ego}"))),
        }
    }

    /// Explains what the shield of an ego says now.
    fn shield_text(&mut self, py: Python<'_>, at: usize, ego: usize) -> PyResult<String> {
        let ego = self.checked_ego(ego)?;
        let rules = self.shield_rules.as_ref().unwrap_or(&self.task).get();
        rules.explain_shield(py, self.vector.sub_envs_mut()[at].env_mut(), ego, &self.signals)
    }

    /// Returns the info of an ego, with what its shield does and says.
    fn full_info<'py>(&self, py: Python<'py>, sub_env: &SubEnv, ego: usize) -> PyResult<Bound<'py, PyDict>> {
        let task = self.task.get();
        let dict = task.info(py, sub_env.info(ego))?;
        if let Some(shield) = sub_env.env().shield() {
            task.add_shield(&dict, sub_env.info(ego), shield)?;
        }
        Ok(dict)
    }

    /// Checks that shields in the mode `mask` permit the actions.
    fn check_permitted(&self, py: Python<'_>, actions: &[Action]) -> PyResult<()> {
        let (sub_envs, table) = (self.vector.sub_envs(), table_of(&self.task.get().task));
        for ((at, ego, row), &action) in self.egos_of_all().zip(actions) {
            let sub_env = &sub_envs[at];
            // The action after the end of an episode only begins the next one.
            let verdict = sub_env.info(ego).verdict.as_ref().filter(|_| sub_env.is_active(ego));
            let Some(says) = sub_env.env().shield().zip(verdict) else {
                continue;
            };
            let of = || match self.rows_of_egos() {
                1 => String::new(),
                _ => format!(" {}", self.of_row(row)),
            };
            check_permitted(py, says, (action, table.name(action)), of)?;
        }
        Ok(())
    }

    /// Returns an environment. Fails if its episode has not started.
    fn begun(&self, py: Python<'_>, at: usize) -> PyResult<&SubEnv> {
        let sub_env = self.sub_env(at)?;
        match sub_env.is_ready(Autoreset::NextStep) {
            true => Ok(sub_env),
            false => Err(self.reset_needed(py, at, "has not started")),
        }
    }

    fn reset_needed(&self, py: Python<'_>, at: usize, why: &str) -> PyErr {
        let which = match self.vector.sub_envs().len() {
            1 => String::new(),
            _ => format!(" of environment {at}"),
        };
        let message = format!("the episode{which} {why}: call `reset`");
        gymnasium_error(py, "ResetNeeded", message)
    }

    /// Checks the number of values: one per environment, or one per ego of each.
    fn check(&self, given: usize, expected: usize) -> PyResult<()> {
        let each = match expected == self.vector.sub_envs().len() {
            true => "environment",
            false => "ego of each environment",
        };
        match given == expected {
            true => Ok(()),
            false => Err(PyValueError::new_err(format!(
                "expected {expected} values, one per {each}, not {given}"
            ))),
        }
    }

    fn check_ready(&self, py: Python<'_>) -> PyResult<()> {
        let mode = self.vector.autoreset();
        let mut sub_envs = self.vector.sub_envs().iter();
        match sub_envs.position(|sub_env| !sub_env.is_ready(mode)) {
            None => Ok(()),
            Some(at) => Err(self.reset_needed(py, at, "has ended or not started")),
        }
    }

    fn rows<'a>(&self, observations: &'a mut PyReadwriteArrayDyn<'_, f32>) -> PyResult<&'a mut [f32]> {
        slice_of(observations, self.vector.width() * self.rows_of_egos())
    }
}
