//! Evaluation of policies on recorded episodes.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::task::spf::metrics::{mean_return, summarize_runs};
use crate::task::spf::{ControlMode, Env, Episode, EpisodeSet, Policy, Rollout, SpfTask, Summary, rollout};
use std::sync::Arc;

/// Runs of the random policy per episode.
pub const RANDOM_RUNS: u8 = 10;

/// The results of the random policy on each episode, as the baseline of scores.
#[derive(Clone, Debug, Default)]
pub struct Baseline {
    rollouts: Vec<Rollout>,
    returns: Vec<f64>,
}

impl Baseline {
    /// Runs the random policy on one more episode, [`RANDOM_RUNS`] times. The episode's seed determines the runs.
    ///
    /// # Errors
    /// As [`Env::reset_to`] and [`rollout`]; on an error the baseline does not change.
    pub fn add(&mut self, env: &mut Env, episode: &Episode) -> Result<(), Diagnostic> {
        let runs = (0..RANDOM_RUNS).map(|run| {
            env.reset_to(episode)?;
            let mut stream = Seed(episode.seed).stream(Purpose::POLICY, run.into(), u64::MAX);
            rollout(env, Policy::Random(Seed(stream.random())))
        });
        // Adds all runs of an episode or none, because they must stay adjacent.
        let runs: Vec<Rollout> = runs.collect::<Result<_, Diagnostic>>()?;
        self.returns.push(mean_return(&runs));
        self.rollouts.extend(runs);
        Ok(())
    }

    /// Returns all runs; those of an episode are adjacent.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// Returns the mean return of each episode.
    pub fn returns(&self) -> &[f64] {
        &self.returns
    }

    /// Returns the summary of the random policy. Its score against itself is 0, without an interval.
    pub fn summary(&self, task: &SpfTask) -> Summary {
        summarize_runs(task, &self.rollouts, RANDOM_RUNS.into(), Some(&self.returns))
    }
}

/// Evaluates an external policy on recorded episodes in lockstep, each once.
pub struct BatchEvaluator {
    envs: Vec<Env>,
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
            let mut env = Env::new_with(Arc::clone(task), set.split, ControlMode::First, cancel)?;
            env.reset_to(episode)?;
            Ok(env)
        };
        Ok(BatchEvaluator {
            envs: set.episodes.iter().map(begin).collect::<Result<_, Diagnostic>>()?,
            rollouts: vec![Rollout::default(); set.episodes.len()],
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

    /// Returns the rollouts so far.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// Returns for each episode whether it is running.
    pub fn running(&self) -> impl Iterator<Item = bool> {
        self.envs.iter().map(|env| env.controlled_cars()[0].is_running())
    }

    /// Takes a step in every running episode; ignores the actions for the others.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    ///
    /// # Panics
    /// If the number of actions differs from that of episodes.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), Diagnostic> {
        assert!(actions.len() == self.envs.len(), "one action for each episode");
        for ((env, done), &action) in self.envs.iter_mut().zip(&mut self.rollouts).zip(actions) {
            if env.controlled_cars()[0].is_running() {
                if env.city().cancel().requested() {
                    return Err(Diagnostic::cancelled());
                }
                let asked = env.controlled_cars()[0].derived();
                env.step_shielded(&[action])?;
                let executed = env.taken().next_back().map_or(action, |taken| taken[0]);
                done.add(env, executed, asked.iter());
            }
        }
        Ok(())
    }
}
