//! Episodes one after another, and many environments that take a step together.

use crate::city::{Action, Split};
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::{Stop, run_polled, start_threads};
use crate::task::spf::{ControlMode, Env, Episode, SpfTask};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// So many environments at least are one thread's work.
const SHARE: usize = 8;

/// The episodes of one environment: each is a function of the seed and of how many there were before it.
#[derive(Clone, Debug)]
pub struct EpisodeSource {
    seed: u64,
    begun: u64,
    recorded: Option<Arc<[Episode]>>,
}

impl EpisodeSource {
    /// Episodes that are drawn, or taken at random from recorded ones.
    ///
    /// # Panics
    /// If there are recorded episodes, but none of them.
    pub fn new(seed: u64, recorded: Option<Arc<[Episode]>>) -> EpisodeSource {
        assert!(recorded.as_ref().is_none_or(|set| !set.is_empty()), "no episodes");
        EpisodeSource {
            seed,
            begun: 0,
            recorded,
        }
    }

    /// The seed of the next episode, less than 2^53: any reader of JSON keeps it.
    pub fn next_seed(&mut self) -> u64 {
        let mut stream = Seed(self.seed).stream(Purpose::EPISODE, self.begun, 0);
        self.begun += 1;
        stream.random::<u64>() >> 11
    }

    /// The seed of all of them, and how many have begun.
    pub fn place(&self) -> [u64; 2] {
        [self.seed, self.begun]
    }

    /// Goes to where so many have begun.
    pub fn skip_to(&mut self, begun: u64) {
        self.begun = begun;
    }

    /// Begins the next episode.
    ///
    /// # Errors
    /// As [`Env::reset`] and [`Env::reset_to`].
    pub fn begin(&mut self, env: &mut Env) -> Result<(), Diagnostic> {
        let seed = self.next_seed();
        match &self.recorded {
            None => env.reset(seed),
            Some(set) => env.reset_to(&set[(seed % set.len() as u64) as usize]),
        }
    }
}

/// What a controlled_car is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationKind {
    /// The groundings of the predicates over a few entities, see [`Env::observe`].
    Groundings,
    /// The exact state, see [`Env::observe_state`].
    State,
}

impl ObservationKind {
    /// Both kinds.
    pub const ALL: [ObservationKind; 2] = [ObservationKind::Groundings, ObservationKind::State];

    /// Its name in Python.
    pub const fn name(self) -> &'static str {
        match self {
            ObservationKind::Groundings => "groundings",
            ObservationKind::State => "state",
        }
    }

    /// The shape of an observation.
    pub fn shape(self, task: &SpfTask) -> Vec<usize> {
        match self {
            ObservationKind::Groundings => vec![task.observation_width()],
            ObservationKind::State => task.state_shape().to_vec(),
        }
    }

    /// Writes what a controlled_car is shown.
    ///
    /// # Panics
    /// If there is not room for as many numbers as the shape says.
    pub fn write(self, env: &Env, controlled_car: usize, out: &mut [f32]) {
        match self {
            ObservationKind::Groundings => env.observe(controlled_car, out),
            ObservationKind::State => env.observe_state(controlled_car, out),
        }
    }
}

/// What is told of a controlled_car beside what it observes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Info {
    /// What the rules want now, by its number.
    pub oracle_action: usize,
    /// The clauses that the last action broke, by their positions in [`Oracle::demands`](crate::sim::Oracle::demands).
    pub broken: Vec<usize>,
    /// How much of its route it has gone, 0 to 1.
    pub progress: f64,
    /// Whether it is at its goal without a rule broken.
    pub success: bool,
    /// How many steps the episode has had.
    pub steps: u32,
    /// The seed of the episode.
    pub seed: u64,
}

impl Info {
    /// Takes note of a controlled_car as it is now.
    pub fn note(&mut self, env: &Env, controlled_car: usize) {
        let last = env.controlled_cars()[controlled_car].last();
        self.oracle_action = env.oracle_action(controlled_car) as usize;
        self.broken.clone_from(&last.broken);
        self.progress = env.progress(controlled_car);
        self.success = last.success;
        self.steps = env.steps();
        self.seed = env.episode().seed;
    }
}

/// When an environment whose episode has ended begins the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Autoreset {
    /// In the next step, which takes no action of it and is worth 0.
    NextStep,
    /// In the same step: the observation is the first of the next episode; the last one of the old episode is in [`SubEnv::ended`].
    SameStep,
    /// When it is told to.
    Disabled,
}

/// How the next episode of an environment begins.
#[derive(Clone, Debug)]
pub enum Begin {
    /// With the next episode of its source.
    Next,
    /// With this one; the source does not go on.
    Given(Arc<Episode>),
}

/// One environment of many.
pub struct SubEnv {
    env: Env,
    source: EpisodeSource,
    stage: Stage,
    outcome: Outcome,
    info: Info,
    ended: Ended,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// No episode has begun, or one was lost to a fault.
    Idle,
    Running,
    Over,
}

/// What came of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// What the action was worth.
    pub reward: f64,
    /// Whether the episode ended with it.
    pub terminated: bool,
    /// Whether it was cut short at the horizon.
    pub truncated: bool,
}

/// How an episode ended, if the next one began in the same step.
#[derive(Clone, Debug, Default)]
pub struct Ended {
    happened: bool,
    observation: Vec<f32>,
    info: Info,
    /// As [`Observer::atoms`](crate::sim::Observer::atoms) tells them, if they are to be kept.
    atoms: Option<Vec<(usize, Vec<usize>)>>,
}

impl SubEnv {
    /// The environment.
    pub fn env(&self) -> &Env {
        &self.env
    }

    /// The same, to ask for the facts of a moment.
    pub fn env_mut(&mut self) -> &mut Env {
        &mut self.env
    }

    /// Its episodes.
    pub fn source(&self) -> &EpisodeSource {
        &self.source
    }

    /// What came of the last step.
    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// What is told beside the observation.
    pub fn info(&self) -> &Info {
        &self.info
    }

    /// The last observation of the episode that the last step ended, and what was told then; only if the next one began in that step.
    pub fn ended(&self) -> Option<(&[f32], &Info)> {
        let Ended { observation, info, .. } = &self.ended;
        self.ended.happened.then_some((observation, info))
    }

    /// The atoms that were true then, see [`VectorEnv::keep_last_atoms`].
    pub fn ended_atoms(&self) -> Option<&[(usize, Vec<usize>)]> {
        self.ended.atoms.as_deref().filter(|_| self.ended.happened)
    }

    /// Whether it can take a step without being told to begin an episode.
    pub fn is_ready(&self, autoreset: Autoreset) -> bool {
        match self.stage {
            Stage::Idle => false,
            Stage::Running => true,
            Stage::Over => autoreset == Autoreset::NextStep,
        }
    }

    fn give_up(&mut self) -> Result<(), Diagnostic> {
        self.stage = Stage::Idle;
        Err(Diagnostic::cancelled())
    }

    fn begin(&mut self, how: &Begin) -> Result<(), Diagnostic> {
        self.stage = Stage::Idle;
        self.ended.happened = false;
        self.outcome = Outcome::default();
        match how {
            Begin::Next => self.source.begin(&mut self.env)?,
            Begin::Given(episode) => self.env.reset_to(episode)?,
        }
        self.stage = Stage::Running;
        self.info.note(&self.env, 0);
        Ok(())
    }

    fn step(&mut self, action: Action, autoreset: Autoreset, view: ObservationKind) -> Result<(), Diagnostic> {
        if self.stage == Stage::Over {
            return self.begin(&Begin::Next);
        }
        self.ended.happened = false;
        let stepped = self.env.step(&[action]);
        if stepped.is_err() {
            self.stage = Stage::Idle;
            return stepped;
        }
        let last = self.env.controlled_cars()[0].last();
        let outcome = Outcome {
            reward: last.reward,
            terminated: last.terminated,
            truncated: last.truncated,
        };
        let over = outcome.terminated || outcome.truncated;
        if over && autoreset == Autoreset::SameStep {
            view.write(&self.env, 0, &mut self.ended.observation);
            self.ended.info.note(&self.env, 0);
            if let Some(atoms) = &mut self.ended.atoms {
                atoms.clear();
                atoms.extend(self.env.controlled_cars()[0].observer().atoms());
            }
            self.begin(&Begin::Next)?;
            self.ended.happened = true;
        } else {
            self.info.note(&self.env, 0);
            self.stage = if over { Stage::Over } else { Stage::Running };
        }
        self.outcome = outcome;
        Ok(())
    }
}

/// Environments that take a step together. Each goes as it would alone, on any number of threads.
pub struct VectorEnv {
    members: Vec<SubEnv>,
    autoreset: Autoreset,
    view: ObservationKind,
    /// Numbers of an observation.
    width: usize,
    threads: Option<ThreadPool>,
    stop: Stop,
}

impl VectorEnv {
    /// So many environments, in each of which the first car is driven. [`VectorEnv::reset`] comes next.
    ///
    /// # Errors
    /// As [`Env::new`]; `limit-exceeded` if so many threads cannot be started.
    pub fn new(
        task: &Arc<SpfTask>,
        split: Split,
        sources: impl IntoIterator<Item = EpisodeSource>,
        autoreset: Autoreset,
        view: ObservationKind,
        threads: usize,
    ) -> Result<VectorEnv, Diagnostic> {
        VectorEnv::new_until(task, split, sources, autoreset, view, threads, Arc::new(|| false))
    }

    /// The same. Long work, this and all that follows, is given up when `stop` says so, with `cancelled`; the environments that have
    /// not gone on then need a reset.
    ///
    /// # Errors
    /// As [`VectorEnv::new`].
    pub fn new_until(
        task: &Arc<SpfTask>,
        split: Split,
        sources: impl IntoIterator<Item = EpisodeSource>,
        autoreset: Autoreset,
        view: ObservationKind,
        threads: usize,
        stop: Stop,
    ) -> Result<VectorEnv, Diagnostic> {
        let width = view.shape(task).iter().product();
        let member = |source| {
            if stop() {
                return Err(Diagnostic::cancelled());
            }
            Ok(SubEnv {
                env: Env::new_until(Arc::clone(task), split, ControlMode::First, Arc::clone(&stop))?,
                source,
                stage: Stage::Idle,
                outcome: Outcome::default(),
                info: Info::default(),
                ended: Ended {
                    observation: vec![0.0; width],
                    ..Ended::default()
                },
            })
        };
        let threads = start_threads(threads)?;
        Ok(VectorEnv {
            members: sources.into_iter().map(member).collect::<Result<_, _>>()?,
            autoreset,
            view,
            width,
            threads,
            stop,
        })
    }

    /// The environments.
    pub fn members(&self) -> &[SubEnv] {
        &self.members
    }

    /// The same, to ask for the facts of a moment.
    pub fn members_mut(&mut self) -> &mut [SubEnv] {
        &mut self.members
    }

    /// Numbers of an observation.
    pub fn width(&self) -> usize {
        self.width
    }

    /// When the next episode begins.
    pub fn autoreset(&self) -> Autoreset {
        self.autoreset
    }

    /// From here on it is kept what was true when an episode ended and the next one began in the same step.
    pub fn keep_last_atoms(&mut self) {
        for member in &mut self.members {
            member.ended.atoms = Some(Vec::new());
        }
    }

    /// Gives an environment other episodes from now on.
    pub fn set_source(&mut self, member: usize, source: EpisodeSource) {
        self.members[member].source = source;
    }

    /// Begins episodes, by environment; `None` leaves one as it is. `observations` has a row for each; those of the others stay.
    ///
    /// # Errors
    /// As [`Env::reset`] and [`Env::reset_to`], of the first that fails; it needs another reset, the others have gone on.
    ///
    /// # Panics
    /// If there are not as many as environments.
    pub fn reset(&mut self, begin: &[Option<Begin>], observations: &mut [f32]) -> Result<(), Diagnostic> {
        let view = self.view;
        self.each(begin, observations, |member, how, row, stopped| {
            let Some(how) = how else { return Ok(()) };
            if stopped {
                return member.give_up();
            }
            member.begin(how)?;
            view.write(&member.env, 0, row);
            Ok(())
        })
    }

    /// Takes a step in every environment. `observations` gets a row for each.
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much, or what keeps the next episode from beginning, of the first that fails; it needs a
    /// reset, the others have gone on.
    ///
    /// # Panics
    /// If there are not as many actions as environments, or one is not [ready](SubEnv::is_ready).
    pub fn step(&mut self, actions: &[Action], observations: &mut [f32]) -> Result<(), Diagnostic> {
        let (autoreset, view) = (self.autoreset, self.view);
        self.each(actions, observations, |member, &action, row, stopped| {
            assert!(member.is_ready(autoreset), "an episode must begin first");
            if stopped {
                return member.give_up();
            }
            member.step(action, autoreset, view)?;
            view.write(&member.env, 0, row);
            Ok(())
        })
    }

    fn each<T: Sync>(
        &mut self,
        given: &[T],
        observations: &mut [f32],
        act: impl Fn(&mut SubEnv, &T, &mut [f32], bool) -> Result<(), Diagnostic> + Sync,
    ) -> Result<(), Diagnostic> {
        let count = self.members.len();
        assert!(given.len() == count, "{} given for {count} environments", given.len());
        assert!(observations.len() == count * self.width, "a row for each environment");
        let width = self.width;
        // The first by position: which one is told must not depend on threads.
        let first = |a: Option<(usize, Diagnostic)>, b: Option<(usize, Diagnostic)>| match (a, b) {
            (Some(a), Some(b)) => Some(if a.0 <= b.0 { a } else { b }),
            (a, b) => a.or(b),
        };
        let (stop, stopped) = (&*self.stop, AtomicBool::new(false));
        let act = |(position, ((member, given), row)): (usize, ((&mut SubEnv, &T), &mut [f32]))| {
            if position % SHARE == 0 && stop() {
                stopped.store(true, Ordering::Relaxed);
            }
            let stopped = stopped.load(Ordering::Relaxed);
            act(member, given, row, stopped).err().map(|fault| (position, fault))
        };
        let fault = match &self.threads {
            Some(pool) => run_polled(pool, stop, || {
                (self.members.par_iter_mut().with_min_len(SHARE))
                    .zip(given)
                    .zip(observations.par_chunks_exact_mut(width))
                    .enumerate()
                    .map(act)
                    .reduce(|| None, first)
            }),
            None => (self
                .members
                .iter_mut()
                .zip(given)
                .zip(observations.chunks_exact_mut(width))
                .enumerate())
            .map(act)
            .fold(None, first),
        };
        fault.map_or(Ok(()), |(_, fault)| Err(fault))
    }
}
