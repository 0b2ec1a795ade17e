//! Evaluation of policies on recorded episodes.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::Actions;
use crate::task::spf::metrics::{mean_return, summarize_runs};
use crate::task::spf::rollout::reset_for_evaluation;
use crate::task::spf::{ControlledCar, Env, Episode, EpisodeSet, Policy, Rollout, SpfTask, Summary, rollouts};
use smallvec::SmallVec;
use std::sync::Arc;

/// Runs of the random policy per episode.
pub const RANDOM_RUNS: u8 = 10;

/// The results of the random policy on each episode, as the baseline of scores.
#[derive(Clone, Debug, Default)]
pub struct Baseline {
    /// One per episode, run and ego, in this order.
    rollouts: Vec<Rollout>,
    returns: Vec<f64>,
    /// The number of egos.
    egos: usize,
}

impl Baseline {
    /// Runs the random policy on one more episode, [`RANDOM_RUNS`] times. The episode's seed determines the runs.
    ///
    /// # Errors
    /// As [`Env::reset_to`] and [`rollouts`]; on an error the baseline does not change.
    pub fn add(&mut self, env: &mut Env, episode: &Episode) -> Result<(), Diagnostic> {
        reset_for_evaluation(env, episode)?;
        let horizon = env.horizon();
        let runs = (0..RANDOM_RUNS).map(|run| {
            env.reset_to(episode)?;
            env.set_horizon(horizon);
            let mut stream = Seed(episode.seed).stream(Purpose::POLICY, run.into(), u64::MAX);
            rollouts(env, Policy::Random(Seed(stream.random())))
        });
        // Adds all runs of an episode or none, because they must stay adjacent.
        let runs: Vec<Rollout> = runs.collect::<Result<Vec<_>, Diagnostic>>()?.concat();
        self.egos = env.controlled_cars().len();
        self.returns.push(mean_return(&runs));
        self.rollouts.extend(runs);
        Ok(())
    }

    /// Returns the results of all runs, one per ego; those of an episode are adjacent, as are those of a run.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// Returns the mean return of each episode, over its runs and the egos.
    pub fn returns(&self) -> &[f64] {
        &self.returns
    }

    /// Returns the summary of the random policy. Its score against itself is 0, without an interval.
    pub fn summary(&self, task: &SpfTask) -> Summary {
        let runs = [RANDOM_RUNS.into(), self.egos];
        summarize_runs(task, &self.rollouts, runs, Some(&self.returns))
    }
}

/// Evaluates an external policy on recorded episodes in lockstep, each once. It controls the cars that
/// [`SpfTask::control`] names.
pub struct BatchEvaluator {
    envs: Vec<Env>,
    /// The egos of each episode.
    egos: usize,
    /// One per episode and ego.
    rollouts: Vec<Rollout>,
}

impl BatchEvaluator {
    /// Returns an evaluator with all episodes of a set at their start.
    ///
    /// # Errors
    /// As [`Env::new`] and [`Env::reset_to`].
    pub fn new(task: &Arc<SpfTask>, set: &EpisodeSet) -> Result<BatchEvaluator, Diagnostic> {
        BatchEvaluator::new_with(task, set, &Cancel::never())
    }

    /// Cancellable variant of [`BatchEvaluator::new`]. The evaluator keeps `cancel`, so its steps are cancellable, too.
    /// After cancellation it is inconsistent: make another.
    ///
    /// # Errors
    /// As [`BatchEvaluator::new`]; `cancelled` on cancellation.
    pub fn new_with(task: &Arc<SpfTask>, set: &EpisodeSet, cancel: &Cancel) -> Result<BatchEvaluator, Diagnostic> {
        let begin = |episode| {
            if cancel.requested() {
                return Err(Diagnostic::cancelled());
            }
            let mut env = Env::new_with(Arc::clone(task), set.split, task.control(), cancel)?;
            reset_for_evaluation(&mut env, episode)?;
            Ok(env)
        };
        let egos = task.evaluated_egos();
        Ok(BatchEvaluator {
            envs: set.episodes.iter().map(begin).collect::<Result<_, Diagnostic>>()?,
            egos,
            rollouts: vec![Rollout::default(); set.episodes.len() * egos],
        })
    }

    /// Removes the shields of the configuration, for policies that need none.
    ///
    /// # Errors
    /// As [`Env::set_shield`].
    pub fn remove_shields(&mut self) -> Result<(), Diagnostic> {
        self.envs.iter_mut().try_for_each(|env| env.set_shield(None))
    }

    /// Returns the environments, in the order of the set.
    pub fn envs(&self) -> &[Env] {
        &self.envs
    }

    /// Returns the number of egos of each episode.
    pub fn egos(&self) -> usize {
        self.egos
    }

    /// Returns the results so far, one per episode and ego.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// Returns for each ego of each episode whether its episode is running.
    pub fn running(&self) -> impl Iterator<Item = bool> {
        let cars = self.envs.iter().flat_map(|env| env.controlled_cars());
        cars.map(ControlledCar::is_running)
    }

    /// Takes a step in every running episode; ignores the actions for other egos. `actions` has those of the egos of
    /// the first episode, then those of the next.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    ///
    /// # Panics
    /// If the number of actions differs from that of egos in all episodes.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), Diagnostic> {
        let egos = self.egos;
        assert!(actions.len() == self.envs.len() * egos, "one action for each ego");
        let episodes = self.envs.iter_mut().zip(self.rollouts.chunks_exact_mut(egos));
        let mut asked: SmallVec<[Option<Actions>; 4]> = SmallVec::new();
        for ((env, done), actions) in episodes.zip(actions.chunks_exact(egos)) {
            if !env.is_running() {
                continue;
            }
            if env.city().cancel().requested() {
                return Err(Diagnostic::cancelled());
            }
            if env.task().shares() {
                for (ego, done) in done.iter_mut().enumerate() {
                    if env.controlled_cars()[ego].is_running() {
                        let clauses = env.observed_clauses(ego)?;
                        (done.observed_clauses.iter_mut().zip(clauses)).for_each(|(sum, count)| *sum += count);
                    }
                }
            }
            asked.clear();
            asked.extend((env.controlled_cars().iter()).map(|car| car.is_running().then(|| car.derived())));
            env.step_shielded(actions)?;
            let executed = env.taken().next_back().unwrap_or(actions);
            for (ego, asked) in asked.iter().enumerate() {
                if let Some(asked) = asked {
                    done[ego].add(env, ego, executed[ego], asked.iter());
                }
            }
        }
        Ok(())
    }
}
