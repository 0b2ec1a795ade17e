//! Policies measured on recorded episodes.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::diag::Diagnostic;
use crate::rng::{Purpose, RngExt, Seed};
use crate::task::spf::metrics::{mean_return, summarise_runs};
use crate::task::spf::{ControlMode, Env, Episode, EpisodeSet, Policy, Rollout, SpfTask, Summary, rollout};
use std::sync::Arc;

/// So often the random policy drives every episode.
pub const RANDOM_RUNS: u8 = 10;

/// How the random policy does, episode by episode: what a score is measured from.
#[derive(Clone, Debug, Default)]
pub struct Baseline {
    rollouts: Vec<Rollout>,
    returns: Vec<f64>,
}

impl Baseline {
    /// Lets the random policy drive one more episode, [`RANDOM_RUNS`] times. What it does is a function of the episode's seed.
    ///
    /// # Errors
    /// As [`Env::reset_to`] and [`rollout`]; then nothing is added.
    pub fn add(&mut self, env: &mut Env, episode: &Episode) -> Result<(), Diagnostic> {
        let runs = (0..RANDOM_RUNS).map(|run| {
            env.reset_to(episode)?;
            let mut stream = Seed(episode.seed).stream(Purpose::POLICY, run.into(), u64::MAX);
            rollout(env, Policy::Random(Seed(stream.random())))
        });
        // All or none: the runs of an episode stand together.
        let runs: Vec<Rollout> = runs.collect::<Result<_, Diagnostic>>()?;
        self.returns.push(mean_return(&runs));
        self.rollouts.extend(runs);
        Ok(())
    }

    /// All its runs, those of an episode together.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// The mean return of each episode.
    pub fn returns(&self) -> &[f64] {
        &self.returns
    }

    /// How well the random policy itself did. Its score is 0, with no interval: it is compared with itself.
    pub fn summary(&self, task: &SpfTask) -> Summary {
        summarise_runs(task, &self.rollouts, RANDOM_RUNS.into(), Some(&self.returns))
    }
}

/// Recorded episodes that a policy from outside drives side by side, each once.
pub struct BatchEvaluator {
    envs: Vec<Env>,
    rollouts: Vec<Rollout>,
}

impl BatchEvaluator {
    /// All episodes of a set, at their beginnings.
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

    /// The episodes, in the order of the set.
    pub fn envs(&self) -> &[Env] {
        &self.envs
    }

    /// How each has gone so far.
    pub fn rollouts(&self) -> &[Rollout] {
        &self.rollouts
    }

    /// Which of them go on.
    pub fn running(&self) -> impl Iterator<Item = bool> {
        self.envs.iter().map(|env| env.controlled_cars()[0].is_running())
    }

    /// Takes a step in every episode that goes on; the actions for the others count for nothing.
    ///
    /// # Errors
    /// `limit-exceeded` for rules that derive too much.
    ///
    /// # Panics
    /// If there are not as many actions as episodes.
    pub fn step(&mut self, actions: &[Action]) -> Result<(), Diagnostic> {
        assert!(actions.len() == self.envs.len(), "one action for each episode");
        for ((env, done), &action) in self.envs.iter_mut().zip(&mut self.rollouts).zip(actions) {
            if env.controlled_cars()[0].is_running() {
                if env.city().cancel().requested() {
                    return Err(Diagnostic::cancelled());
                }
                let asked = env.controlled_cars()[0].derived();
                env.step(&[action])?;
                done.add(env, asked.iter());
            }
        }
        Ok(())
    }
}
