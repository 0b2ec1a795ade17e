//! Sequences of episodes, and vectorized environments.

mod actor;

pub use actor::{Ending, Layer, PolicyNetwork, Trajectories};

use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::diag::Diagnostic;
use crate::rng::{Purpose, Seed};
use crate::sim::{Actions, Shield, Verdict, run_polled, start_threads, threads_of};
use crate::task::spf::codes;
use crate::task::spf::episode::episode_seed;
use crate::task::spf::{ControlMode, Env, Episode, SpfTask, reset_demanding};
use crate::threads::Pool;
use crate::yaml;
use rayon::prelude::*;
use smallvec::SmallVec;
use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The number of environments that a thread takes at once, and between two polls for cancellation.
const SHARE: usize = 8;

/// The episodes of one environment: each is a function of the seed and of the number of episodes before it.
#[derive(Clone, Debug)]
pub struct EpisodeSource {
    seed: u64,
    begun: u64,
    /// Whether the rules must constrain the drawn episodes.
    demanding: bool,
    recorded: Option<Arc<[Episode]>>,
}

impl EpisodeSource {
    /// Returns a source of random episodes, or of random choices among recorded ones.
    ///
    /// # Panics
    /// If `recorded` is an empty set.
    pub fn new(seed: u64, recorded: Option<Arc<[Episode]>>) -> EpisodeSource {
        assert!(recorded.as_ref().is_none_or(|set| !set.is_empty()), "no episodes");
        EpisodeSource {
            seed,
            begun: 0,
            demanding: false,
            recorded,
        }
    }

    /// Returns a source of random episodes that [`reset_demanding`] accepts.
    pub fn demanding(seed: u64) -> EpisodeSource {
        EpisodeSource {
            demanding: true,
            ..EpisodeSource::new(seed, None)
        }
    }

    /// Returns the seed of the next episode.
    pub fn next_seed(&mut self) -> u64 {
        let mut stream = Seed(self.seed).stream(Purpose::EPISODE, self.begun, 0);
        self.begun += 1;
        episode_seed(&mut stream)
    }

    /// Returns the seed of the source, and the number of episodes begun.
    pub fn place(&self) -> [u64; 2] {
        [self.seed, self.begun]
    }

    /// Moves to the position at which `begun` episodes have begun.
    pub fn skip_to(&mut self, begun: u64) {
        self.begun = begun;
    }

    /// Begins the next episode. The curriculum applies to drawn episodes with one controlled car.
    ///
    /// # Errors
    /// As [`Env::reset_with`], [`Env::reset_to`] and [`reset_demanding`].
    pub fn begin(&mut self, env: &mut Env) -> Result<(), Diagnostic> {
        let agents = match env.control() {
            ControlMode::First => env.task().agents_after(self.begun, env.city().split()),
            ControlMode::Egos => None,
        };
        let seed = self.next_seed();
        match &self.recorded {
            None if self.demanding => reset_demanding(env, seed, agents).map(|_| ()),
            None => env.reset_with(seed, agents),
            Some(set) => env.reset_to(&set[(seed % set.len() as u64) as usize]),
        }
    }
}

/// The kind of an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationKind {
    /// The groundings of the predicates over a few entities; see [`Env::observe`].
    Groundings,
    /// The exact state; see [`Env::observe_state`].
    State,
}

impl ObservationKind {
    /// Both kinds.
    pub const ALL: [ObservationKind; 2] = [ObservationKind::Groundings, ObservationKind::State];

    /// Returns the name in Python.
    pub const fn name(self) -> &'static str {
        match self {
            ObservationKind::Groundings => "groundings",
            ObservationKind::State => "state",
        }
    }

    /// Returns this kind after a check that egos of the task have such observations.
    ///
    /// # Errors
    /// `invalid-value` for [`ObservationKind::State`] if the task has sensors: it is exact.
    pub fn checked_for(self, task: &SpfTask) -> Result<ObservationKind, Diagnostic> {
        match &task.config().sensors {
            Some(sensors) if self == ObservationKind::State => {
                let message = "the observation `state` is exact, but this task has sensors";
                let fault = Diagnostic::new(yaml::codes::INVALID_VALUE, message).at(sensors.span, "");
                Err(fault.help("observe `groundings`, or remove `sensors`"))
            }
            _ => Ok(self),
        }
    }

    /// Returns the shape of an observation.
    pub fn shape(self, task: &SpfTask) -> Vec<usize> {
        match self {
            ObservationKind::Groundings => vec![task.observation_width()],
            ObservationKind::State => task.state_shape().to_vec(),
        }
    }

    /// Writes the observation of a controlled car.
    ///
    /// # Panics
    /// If `out` is shorter than the shape requires.
    pub fn write(self, env: &Env, controlled_car: usize, out: &mut [f32]) {
        match self {
            ObservationKind::Groundings => env.observe(controlled_car, out),
            ObservationKind::State => env.observe_state(controlled_car, out),
        }
    }

    /// Writes the observations of all controlled cars, one after the other.
    ///
    /// # Panics
    /// If the length of `out` is not that of one observation per controlled car.
    pub fn write_all(self, env: &Env, out: &mut [f32]) {
        let egos = env.controlled_cars().len();
        let rows = out.chunks_exact_mut(out.len() / egos);
        (0..egos).zip(rows).for_each(|(ego, row)| self.write(env, ego, row));
    }
}

/// Information about a controlled car besides its observation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Info {
    /// The action that the rules want now, as a number.
    pub oracle_action: usize,
    /// The clauses that the last action violated, by their positions in
    /// [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub broken: Vec<usize>,
    /// The fraction of its route that it has covered, 0 to 1.
    pub progress: f64,
    /// Whether it is at its goal without a violation.
    pub success: bool,
    /// Number of steps of the episode so far.
    pub steps: u32,
    /// The seed of the episode.
    pub seed: u64,
    /// The actions that violate no clause now, if the environment computes them.
    pub allowed: Option<Actions>,
    /// What the shield says of the actions now, if there is one.
    pub verdict: Option<Verdict>,
    /// The action that the shield replaced in the last step.
    pub replaced: Option<Action>,
    /// The clauses of the shield's rules that this action violated, by their positions in
    /// [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub reasons: Vec<usize>,
}

impl Info {
    /// Updates the information about a controlled car.
    pub fn note(&mut self, env: &Env, controlled_car: usize) {
        let car = &env.controlled_cars()[controlled_car];
        let last = car.last();
        self.verdict = car.verdict().cloned();
        let (replaced, reasons) = car.replaced().unzip();
        self.replaced = replaced;
        self.reasons.clear();
        self.reasons.extend_from_slice(reasons.unwrap_or_default());
        self.oracle_action = env.oracle_action(controlled_car).index();
        self.broken.clone_from(&last.broken);
        self.progress = env.progress(controlled_car);
        self.success = last.success;
        self.steps = env.steps();
        self.seed = env.episode().seed;
        self.allowed = car.allowed();
    }
}

/// The time at which an environment begins the next episode after one has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Autoreset {
    /// In the next step, which ignores its action and has reward 0.
    NextStep,
    /// In the same step: the observation is the first of the next episode; [`SubEnv::ended`] has the last one of the
    /// old episode.
    SameStep,
    /// On an explicit reset.
    Disabled,
}

/// The start of the next episode of an environment.
#[derive(Clone, Debug)]
pub enum Begin {
    /// With the next episode of its source.
    Next,
    /// With this episode; the source does not advance.
    Given(Arc<Episode>),
}

/// One environment of a vector.
pub struct SubEnv {
    env: Env,
    source: EpisodeSource,
    stage: Stage,
    egos: SmallVec<[EgoResult; 1]>,
    ended: Ended,
}

/// What the last step gave an ego.
#[derive(Clone, Debug, Default)]
struct EgoResult {
    outcome: Outcome,
    info: Info,
    /// Whether its action counts in the next step, if that begins no episode.
    active: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// No episode has begun, or an error ended it.
    Idle,
    Running,
    Over,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Reward, with the reward terms of training.
    pub reward: f64,
    /// Whether the episode has ended.
    pub terminated: bool,
    /// Whether the episode has reached its horizon.
    pub truncated: bool,
}

/// The end of an episode whose successor began in the same step.
#[derive(Clone, Debug, Default)]
pub struct Ended {
    happened: bool,
    /// The last observations of the egos, concatenated.
    observations: Vec<f32>,
    infos: SmallVec<[Info; 1]>,
    /// The atoms of [`Observer::atoms`](crate::sim::Observer::atoms) for each ego, if the vector keeps them.
    atoms: Option<Vec<EgoAtoms>>,
}

/// The atoms of an ego: the position of the predicate, and of each entity.
type EgoAtoms = Vec<(usize, Vec<usize>)>;

impl SubEnv {
    /// Returns the environment.
    pub fn env(&self) -> &Env {
        &self.env
    }

    /// Returns the environment for queries that need `&mut`.
    pub fn env_mut(&mut self) -> &mut Env {
        &mut self.env
    }

    /// Returns the source of its episodes.
    pub fn source(&self) -> &EpisodeSource {
        &self.source
    }

    /// Returns the result of the last step for an ego. That of an ego that did not act is the default.
    pub fn outcome(&self, ego: usize) -> Outcome {
        self.egos[ego].outcome
    }

    /// Returns the information about an ego besides its observation.
    pub fn info(&self, ego: usize) -> &Info {
        &self.egos[ego].info
    }

    /// Returns the information about all egos.
    pub fn infos(&self) -> impl Iterator<Item = &Info> {
        self.egos.iter().map(|ego| &ego.info)
    }

    /// Returns whether the action of an ego counts in the next step, unless that step begins an episode. The rules
    /// drive egos whose episode has ended, until it has ended for all.
    pub fn is_active(&self, ego: usize) -> bool {
        self.egos[ego].active
    }

    /// Returns the last observations of all egos, one after the other, and their information, in the episode that the
    /// last step ended, if the next episode began in that step.
    pub fn ended(&self) -> Option<(&[f32], &[Info])> {
        let Ended {
            observations, infos, ..
        } = &self.ended;
        self.ended.happened.then_some((observations, infos))
    }

    /// Returns the atoms of an ego that were true then; see [`VectorEnv::keep_last_atoms`].
    pub fn ended_atoms(&self, ego: usize) -> Option<&[(usize, Vec<usize>)]> {
        let atoms = self.ended.atoms.as_ref().filter(|_| self.ended.happened)?;
        atoms.get(ego).map(Vec::as_slice)
    }

    /// Returns whether it can take a step without a reset.
    pub fn is_ready(&self, autoreset: Autoreset) -> bool {
        match self.stage {
            Stage::Idle => false,
            Stage::Running => true,
            Stage::Over => autoreset == Autoreset::NextStep,
        }
    }

    fn cancel(&mut self) -> Result<(), Diagnostic> {
        self.stage = Stage::Idle;
        Err(Diagnostic::cancelled())
    }

    fn begin(&mut self, how: &Begin) -> Result<(), Diagnostic> {
        self.stage = Stage::Idle;
        self.ended.happened = false;
        match how {
            Begin::Next => self.source.begin(&mut self.env)?,
            Begin::Given(episode) => self.env.reset_to(episode)?,
        }
        self.env.ask_shield()?;
        self.stage = Stage::Running;
        for ego in &mut self.egos {
            (ego.outcome, ego.active) = (Outcome::default(), true);
        }
        self.note();
        Ok(())
    }

    /// Updates the information about all egos.
    fn note(&mut self) {
        for (number, ego) in self.egos.iter_mut().enumerate() {
            ego.info.note(&self.env, number);
        }
    }

    /// Repeats a step that was taken; the shield has no say in it.
    fn replay(&mut self, actions: &[Action]) -> Result<(), Diagnostic> {
        let stepped = self.env.step(actions);
        self.note_step(stepped, Autoreset::Disabled, ObservationKind::Groundings)
    }

    fn step(&mut self, actions: &[Action], autoreset: Autoreset, view: ObservationKind) -> Result<(), Diagnostic> {
        if self.stage == Stage::Over {
            return self.begin(&Begin::Next);
        }
        let stepped = self.env.step_shielded(actions);
        self.note_step(stepped, autoreset, view)
    }

    /// Updates the results after a step.
    fn note_step(
        &mut self,
        stepped: Result<(), Diagnostic>,
        autoreset: Autoreset,
        view: ObservationKind,
    ) -> Result<(), Diagnostic> {
        self.ended.happened = false;
        let stepped = stepped.and_then(|()| self.env.ask_shield());
        if stepped.is_err() {
            self.stage = Stage::Idle;
            return stepped;
        }
        let mut over = true;
        for (ego, car) in self.egos.iter_mut().zip(self.env.controlled_cars()) {
            let last = car.last();
            ego.outcome = match ego.active {
                true => Outcome {
                    reward: last.shaped_reward(),
                    terminated: last.terminated,
                    truncated: last.truncated,
                },
                false => Outcome::default(),
            };
            ego.active = car.is_running();
            over &= !ego.active;
        }
        if over && autoreset == Autoreset::SameStep {
            view.write_all(&self.env, &mut self.ended.observations);
            for (number, info) in self.ended.infos.iter_mut().enumerate() {
                info.note(&self.env, number);
            }
            if let Some(atoms) = &mut self.ended.atoms {
                for (atoms, car) in atoms.iter_mut().zip(self.env.controlled_cars()) {
                    atoms.clear();
                    atoms.extend(car.observer().atoms());
                }
            }
            let outcomes: SmallVec<[Outcome; 4]> = self.egos.iter().map(|ego| ego.outcome).collect();
            self.begin(&Begin::Next)?;
            self.ended.happened = true;
            for (ego, outcome) in self.egos.iter_mut().zip(outcomes) {
                ego.outcome = outcome;
            }
        } else {
            self.note();
            self.stage = if over { Stage::Over } else { Stage::Running };
        }
        Ok(())
    }
}

/// Calls `act` with the position of each environment and the environment. The environments share working memory.
fn in_turn(sub_envs: &mut [SubEnv], mut act: impl FnMut(usize, &mut SubEnv)) {
    for at in 0..sub_envs.len() {
        // Many environments do not fit the cache. This loads the next one while this one takes its step. It loads the
        // addresses of its parts one step earlier.
        if let Some(next) = sub_envs.get(at + 1) {
            black_box(next.env.prefetch());
        }
        if let Some(after) = sub_envs.get(at + 2) {
            black_box((after.stage, after.env.steps(), after.env.prefetch_head()));
        }
        if let Some([before, sub_env]) = at.checked_sub(1).and_then(|first| sub_envs[first..].first_chunk_mut()) {
            sub_env.env.swap_memory(&mut before.env);
        }
        act(at, &mut sub_envs[at]);
    }
    // The first one begins the next turn.
    if let [first, .., last] = sub_envs {
        first.env.swap_memory(&mut last.env);
    }
}

/// A vectorized environment. Results equal those of the individual environments, on any number of threads.
pub struct VectorEnv {
    sub_envs: Vec<SubEnv>,
    /// The controlled cars of each environment.
    egos: usize,
    autoreset: Autoreset,
    view: ObservationKind,
    /// Numbers per observation.
    width: usize,
    threads: Option<Pool>,
    cancel: Cancel,
}

impl VectorEnv {
    /// Returns one environment per source, each with the agents of a split. The caller controls the cars that `control`
    /// names. Call [`VectorEnv::reset`] next.
    ///
    /// # Errors
    /// As [`Env::new`] and [`ObservationKind::checked_for`]; `limit-exceeded` if the threads cannot be started.
    pub fn new(
        task: &Arc<SpfTask>,
        (split, control): (Split, ControlMode),
        sources: impl IntoIterator<Item = EpisodeSource>,
        autoreset: Autoreset,
        view: ObservationKind,
        threads: usize,
    ) -> Result<VectorEnv, Diagnostic> {
        let agents = (split, control);
        VectorEnv::new_with(task, agents, sources, autoreset, view, threads, &Cancel::never())
    }

    /// Cancellable variant of [`VectorEnv::new`]. The environments keep `cancel`, so their later work is cancellable,
    /// too. After cancellation those that took no step need a reset.
    ///
    /// # Errors
    /// As [`VectorEnv::new`]; `cancelled` on cancellation.
    pub fn new_with(
        task: &Arc<SpfTask>,
        (split, control): (Split, ControlMode),
        sources: impl IntoIterator<Item = EpisodeSource>,
        autoreset: Autoreset,
        view: ObservationKind,
        threads: usize,
        cancel: &Cancel,
    ) -> Result<VectorEnv, Diagnostic> {
        let width = view.checked_for(task)?.shape(task).iter().product();
        let sub_env = |source| {
            if cancel.requested() {
                return Err(Diagnostic::cancelled());
            }
            let env = Env::new_with(Arc::clone(task), split, control, cancel)?;
            let egos = env.controlled_cars().len();
            let ended = match autoreset {
                Autoreset::SameStep => egos,
                Autoreset::NextStep | Autoreset::Disabled => 0,
            };
            Ok(SubEnv {
                env,
                source,
                stage: Stage::Idle,
                egos: smallvec::smallvec![EgoResult::default(); egos],
                ended: Ended {
                    observations: vec![0.0; ended * width],
                    infos: smallvec::smallvec![Info::default(); ended],
                    ..Ended::default()
                },
            })
        };
        let threads = start_threads(threads)?;
        let sub_envs: Vec<SubEnv> = sources.into_iter().map(sub_env).collect::<Result<_, _>>()?;
        Ok(VectorEnv {
            egos: sub_envs.first().map_or(1, |first| first.egos.len()),
            sub_envs,
            autoreset,
            view,
            width,
            threads,
            cancel: cancel.clone(),
        })
    }

    /// Returns the environments.
    pub fn sub_envs(&self) -> &[SubEnv] {
        &self.sub_envs
    }

    /// Returns the environments for queries that need `&mut`.
    pub fn sub_envs_mut(&mut self) -> &mut [SubEnv] {
        &mut self.sub_envs
    }

    /// Returns the number of egos, which are the controlled cars, of each environment.
    pub fn egos(&self) -> usize {
        self.egos
    }

    /// Returns the numbers per observation. Each ego of each environment has one.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns when the next episode begins.
    pub fn autoreset(&self) -> Autoreset {
        self.autoreset
    }

    /// Keeps from now on the atoms at the end of an episode whose successor begins in the same step.
    pub fn keep_last_atoms(&mut self) {
        for sub_env in &mut self.sub_envs {
            sub_env.ended.atoms = Some(vec![Vec::new(); self.egos]);
        }
    }

    /// Computes from the next reset on which actions violate no clause; see [`Info::allowed`].
    pub fn judge_actions(&mut self) {
        for sub_env in &mut self.sub_envs {
            sub_env.env.judge_actions();
        }
    }

    /// Replaces the shield of all environments. It judges the actions of [`VectorEnv::step`].
    ///
    /// # Errors
    /// As [`Env::replace_shield`]. Then the environments keep their shield.
    pub fn set_shield(&mut self, shield: Option<&Arc<Shield>>) -> Result<(), Diagnostic> {
        let before = self.sub_envs.first().and_then(|first| first.env.shield().cloned());
        let set = |sub_env: &mut SubEnv, shield: Option<&Arc<Shield>>| {
            sub_env.env.replace_shield(shield.cloned())?;
            if sub_env.stage != Stage::Idle {
                sub_env.note();
            }
            Ok(())
        };
        let done = self.sub_envs.iter_mut().try_for_each(|sub_env| set(sub_env, shield));
        if done.is_err() {
            (self.sub_envs.iter_mut()).try_for_each(|sub_env| set(sub_env, before.as_ref()))?;
        }
        done
    }

    /// Replaces the source of an environment's episodes.
    pub fn set_source(&mut self, sub_env: usize, source: EpisodeSource) {
        self.sub_envs[sub_env].source = source;
    }

    /// Begins episodes; `None` leaves an environment unchanged. Writes a row of `observations` for each ego of each
    /// begun episode.
    ///
    /// # Errors
    /// As [`Env::reset`] and [`Env::reset_to`], for the first environment that fails. It needs another reset; the
    /// others have begun.
    ///
    /// # Panics
    /// If the length of `begin` differs from the number of environments.
    pub fn reset(&mut self, begin: &[Option<Begin>], observations: &mut [f32]) -> Result<(), Diagnostic> {
        let view = self.view;
        self.each(begin, observations, |sub_env, how, row, cancelled| {
            let Some(how) = how else { return Ok(()) };
            if cancelled {
                return sub_env.cancel();
            }
            sub_env.begin(how)?;
            view.write_all(&sub_env.env, row);
            Ok(())
        })
    }

    /// Restores the states of environments from the starts of their episodes and the actions taken in them, as
    /// [`Env::episode`] and [`Env::taken`] return them. `None` leaves an environment unchanged. Writes a row of
    /// `observations` for each ego of each restored environment.
    ///
    /// # Errors
    /// As [`VectorEnv::reset`] and [`VectorEnv::step`]; `invalid-episode` if actions follow the end of an episode, or
    /// their number is not a multiple of that of the egos.
    ///
    /// # Panics
    /// If the length of `episodes` differs from the number of environments.
    pub fn replay(
        &mut self,
        episodes: &[Option<(Arc<Episode>, Vec<Action>)>],
        observations: &mut [f32],
    ) -> Result<(), Diagnostic> {
        let (view, egos) = (self.view, self.egos);
        self.each(episodes, observations, |sub_env, episode, row, cancelled| {
            let Some((start, taken)) = episode else { return Ok(()) };
            if cancelled {
                return sub_env.cancel();
            }
            sub_env.begin(&Begin::Given(Arc::clone(start)))?;
            let invalid = |message: String| Err(Diagnostic::new(codes::INVALID_EPISODE, message));
            if !taken.len().is_multiple_of(egos) {
                return invalid(format!("{} actions of {egos} egos", taken.len()));
            }
            for actions in taken.chunks_exact(egos) {
                if !sub_env.is_ready(Autoreset::Disabled) {
                    return invalid("actions follow the end of the episode".to_owned());
                }
                sub_env.replay(actions)?;
            }
            view.write_all(&sub_env.env, row);
            Ok(())
        })
    }

    /// Takes a step in every environment and writes a row of `observations` for each ego. `actions` has the actions of
    /// the egos of the first environment, then those of the next; those of egos that do not [act](SubEnv::is_active)
    /// have no effect.
    ///
    /// # Errors
    /// As [`Env::step_shielded`], or the errors of the next episode, for the first environment that fails. It needs a
    /// reset; the others have taken the step.
    ///
    /// # Panics
    /// If the number of actions differs from that of egos, or an environment is not [ready](SubEnv::is_ready).
    pub fn step(&mut self, actions: &[Action], observations: &mut [f32]) -> Result<(), Diagnostic> {
        let (autoreset, view) = (self.autoreset, self.view);
        let act = |sub_env: &mut SubEnv, actions: &[Action], row: &mut [f32], cancelled| {
            assert!(sub_env.is_ready(autoreset), "an episode must begin first");
            if cancelled {
                return sub_env.cancel();
            }
            sub_env.step(actions, autoreset, view)?;
            view.write_all(&sub_env.env, row);
            Ok(())
        };
        match self.egos {
            1 => self.each(actions, observations, |sub_env, action, row, cancelled| {
                act(sub_env, std::slice::from_ref(action), row, cancelled)
            }),
            egos => {
                let actions: Vec<&[Action]> = actions.chunks(egos).collect();
                self.each(&actions, observations, |sub_env, actions, row, cancelled| {
                    act(sub_env, actions, row, cancelled)
                })
            }
        }
    }

    fn each<T: Sync>(
        &mut self,
        given: &[T],
        observations: &mut [f32],
        act: impl Fn(&mut SubEnv, &T, &mut [f32], bool) -> Result<(), Diagnostic> + Sync,
    ) -> Result<(), Diagnostic> {
        let count = self.sub_envs.len();
        let width = self.egos * self.width;
        assert!(given.len() == count, "{} given for {count} environments", given.len());
        assert!(observations.len() == count * width, "a row for each ego");
        // The first error by position, so that the result does not depend on threads.
        let first = |a: Option<(usize, Diagnostic)>, b: Option<(usize, Diagnostic)>| match (a, b) {
            (Some(a), Some(b)) => Some(if a.0 <= b.0 { a } else { b }),
            (a, b) => a.or(b),
        };
        let (cancel, cancelled) = (&self.cancel, AtomicBool::new(false));
        let act = |begin: usize, sub_envs: &mut [SubEnv], given: &[T], rows: &mut [f32]| {
            let mut fault = None;
            let mut given = given.iter().zip(rows.chunks_exact_mut(width));
            in_turn(sub_envs, |at, sub_env| {
                let (given, row) = given.next().expect("as many as environments");
                if at % SHARE == 0 && cancel.requested() {
                    cancelled.store(true, Ordering::Relaxed);
                }
                if let Err(error) = act(sub_env, given, row, cancelled.load(Ordering::Relaxed)) {
                    fault.get_or_insert((begin + at, error));
                }
            });
            fault
        };
        let fault = match &threads_of(self.threads.as_ref())? {
            Some(pool) => run_polled(pool, &|| _ = cancel.requested(), || {
                (self.sub_envs.par_chunks_mut(SHARE))
                    .zip(given.par_chunks(SHARE))
                    .zip(observations.par_chunks_mut(SHARE * width))
                    .enumerate()
                    .map(|(share, ((sub_envs, given), rows))| act(share * SHARE, sub_envs, given, rows))
                    .reduce(|| None, first)
            }),
            None => act(0, &mut self.sub_envs, given, observations),
        };
        fault.map_or(Ok(()), |(_, fault)| Err(fault))
    }
}
