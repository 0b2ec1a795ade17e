//! How well a policy did over many episodes: the measures of the paper, with 95 % confidence intervals.

use super::{PathTask, Rollout};
use crate::config::Speed;
use serde::Serialize;

/// The 97.5th percentile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// A share of episodes with its Wilson score interval (Wilson 1927).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// The share, 0 to 1; 0 if there are no episodes.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Of how many episodes.
    pub episodes: usize,
}

impl Rate {
    /// So many of so many episodes.
    #[allow(clippy::cast_precision_loss)] // fewer than 2^53 episodes
    pub fn of(hits: usize, episodes: usize) -> Rate {
        if episodes == 0 {
            return Rate {
                value: 0.0,
                low: 0.0,
                high: 1.0,
                episodes,
            };
        }
        let n = episodes as f64;
        let p = hits as f64 / n;
        let middle = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        Rate {
            value: p,
            low: (middle - half).max(0.0),
            high: (middle + half).min(1.0),
            episodes,
        }
    }
}

/// A mean with its interval by the central limit theorem: the mean, less and plus 1.96 standard errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// The mean.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Score {
    /// The mean of some values; of none it is 0.
    #[allow(clippy::cast_precision_loss)] // fewer than 2^53 episodes
    pub fn of(values: impl Iterator<Item = f64> + Clone) -> Score {
        let n = values.clone().count().max(1) as f64;
        let mean = values.clone().sum::<f64>() / n;
        let squares: f64 = values.map(|value| (value - mean) * (value - mean)).sum();
        let half = if n > 1.0 {
            Z * (squares / (n - 1.0) / n).sqrt()
        } else {
            0.0
        };
        Score {
            value: mean,
            low: mean - half,
            high: mean + half,
        }
    }
}

/// A rate for an action that the rules can ask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ActionRate {
    /// Name of the action.
    pub action: &'static str,
    /// Of the episodes in which the rules asked the action, the share in which no clause that asks it was broken.
    #[serde(flatten)]
    pub rate: Rate,
}

/// How well a policy did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Trajectory success rate: the share of episodes that reach the goal in time without a rule broken.
    pub tsr: Rate,
    /// Decision success rate: the share of episodes in which the rules asked something at least once and were never broken, however it
    /// ended.
    pub dsr: Rate,
    /// The same by action.
    pub dsr_by_action: Vec<ActionRate>,
    /// Mean return.
    pub mean_return: Score,
    /// Mean return less that of the random policy on the same episodes; `None` if that is not known.
    pub score: Option<Score>,
    /// Mean number of steps.
    pub mean_steps: f64,
}

/// Sums up rollouts. `random` has for each the mean return of the random policy on the same episode.
///
/// # Panics
/// If there are more or fewer of them.
#[allow(clippy::cast_precision_loss)] // fewer than 2^53 episodes and steps
pub fn summarise(task: &PathTask, rollouts: &[Rollout], random: Option<&[f64]>) -> Summary {
    let count = |hits: &dyn Fn(&Rollout) -> bool| rollouts.iter().filter(|rollout| hits(rollout)).count();
    let demands = task.oracle().demands();
    let asked = |action: Speed| demands.iter().any(|demand| demand.action == action);
    let by_action = |action: Speed| {
        let constrained = |rollout: &Rollout| rollout.constrained[action as usize] > 0;
        let obeyed = |rollout: &Rollout| rollout.broken.iter().all(|&demand| demands[demand].action != action);
        ActionRate {
            action: action.name(),
            rate: Rate::of(
                count(&|rollout| constrained(rollout) && obeyed(rollout)),
                count(&constrained),
            ),
        }
    };
    let score = random.map(|random| {
        assert!(random.len() == rollouts.len(), "one random return for each rollout");
        Score::of(
            rollouts
                .iter()
                .zip(random)
                .map(|(rollout, random)| rollout.total - random),
        )
    });
    let steps: u64 = rollouts.iter().map(|rollout| u64::from(rollout.steps)).sum();
    Summary {
        tsr: Rate::of(count(&|rollout| rollout.success), rollouts.len()),
        dsr: Rate::of(
            count(&|rollout| rollout.broken.is_empty() && rollout.constrained.iter().any(|steps| *steps > 0)),
            rollouts.len(),
        ),
        dsr_by_action: Speed::ALL
            .into_iter()
            .filter(|action| asked(*action))
            .map(by_action)
            .collect(),
        mean_return: Score::of(rollouts.iter().map(|rollout| rollout.total)),
        score,
        mean_steps: steps as f64 / rollouts.len().max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_of_the_textbook() {
        // Newcombe 1998, table 1: 81 of 263, score interval without continuity correction.
        let rate = Rate::of(81, 263);
        assert!(
            (rate.low - 0.2553).abs() < 5e-5 && (rate.high - 0.3662).abs() < 5e-5,
            "{rate:?}"
        );
        let none = Rate::of(0, 20);
        assert!(none.low == 0.0 && (none.high - 0.1611).abs() < 5e-5, "{none:?}");
        let score = Score::of([1.0, 2.0, 3.0, 4.0].into_iter());
        assert!(
            (score.value - 2.5).abs() < 1e-12 && (score.high - 2.5 - Z * 0.645_497_224).abs() < 1e-8,
            "{score:?}"
        );
    }
}
