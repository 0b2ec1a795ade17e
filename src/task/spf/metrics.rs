//! How well a policy did over many episodes: the measures of the paper, with 95 % confidence intervals.

use crate::city::Action;
use crate::task::spf::{Rollout, SpfTask};
use serde::Serialize;

/// The 97.5th percentile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// A share of runs with its Wilson score interval (Wilson 1927).
///
/// Several runs of one episode are alike and tell less than as many episodes would. So the interval is that of the *effective* number of
/// runs (Kish 1965): their number over the design effect, which is the variance of the share between episodes over that of as many
/// independent runs, but at least 1. Where that cannot be seen, since all runs hit or none or there is one episode, it is the number of
/// episodes. With one run of each episode it is their number in any case.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// The share, 0 to 1; 0 if there are no runs.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// How many episodes there are runs of.
    pub episodes: usize,
    /// Of how many runs, those of all episodes together.
    pub runs: usize,
}

impl Rate {
    /// For each episode so many hits of so many runs; one with no runs does not count.
    #[allow(clippy::cast_precision_loss)] // fewer than 2^53 runs
    pub fn of(counts: impl Iterator<Item = [usize; 2]> + Clone) -> Rate {
        let counts = counts.filter(|[_, runs]| *runs > 0);
        let [episodes, hits, runs] =
            (counts.clone()).fold([0; 3], |sum, [hits, runs]| [sum[0] + 1, sum[1] + hits, sum[2] + runs]);
        let (k, n) = (episodes as f64, runs as f64);
        let p = if runs == 0 { 0.0 } else { hits as f64 / n };
        let effective = if episodes < 2 || hits == 0 || hits == runs {
            k
        } else {
            let squares: f64 = counts.map(|[hits, runs]| (hits as f64 - p * runs as f64).powi(2)).sum();
            let between = k / (k - 1.0) * squares / (n * n);
            n / (between / (p * (1.0 - p) / (n - 1.0))).max(1.0)
        };
        let [low, high] = wilson(p, effective);
        Rate {
            value: p,
            low,
            high,
            episodes,
            runs,
        }
    }
}

/// The score interval of a share of so many.
fn wilson(p: f64, n: f64) -> [f64; 2] {
    if n == 0.0 {
        return [0.0, 1.0];
    }
    let middle = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
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
    /// Of the runs in which the rules asked the action, the share in which no clause that asks it was broken.
    #[serde(flatten)]
    pub rate: Rate,
}

/// How well a policy did. Where it has driven every episode several times, an episode counts for means and their intervals with the mean
/// of its runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Trajectory success rate: the share of runs that reach the goal in time without a rule broken.
    pub tsr: Rate,
    /// Decision success rate: the share of runs in which the rules asked something at least once and were never broken, however it
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

/// Sums up rollouts, one of each episode. `random` has for each the mean return of the random policy on the same episode.
///
/// # Panics
/// If there are more or fewer of them.
pub fn summarise(task: &SpfTask, rollouts: &[Rollout], random: Option<&[f64]>) -> Summary {
    summarise_runs(task, rollouts, 1, random)
}

/// Sums up so many rollouts of each episode, which stand together. `random` has a mean return for each episode.
#[allow(clippy::cast_precision_loss)] // fewer than 2^53 runs and steps
pub(super) fn summarise_runs(task: &SpfTask, rollouts: &[Rollout], runs: usize, random: Option<&[f64]>) -> Summary {
    assert!(rollouts.len().is_multiple_of(runs), "as many rollouts of each episode");
    let episodes = rollouts.chunks_exact(runs);
    // A run hits or not, or does not count.
    let rate = |hits: &dyn Fn(&Rollout) -> Option<bool>| {
        Rate::of(episodes.clone().map(|runs| {
            let counted = runs.iter().filter_map(hits);
            [counted.clone().filter(|hit| *hit).count(), counted.count()]
        }))
    };
    let constraints = task.oracle().constraints();
    let asked = |action: Action| constraints.iter().any(|constraint| constraint.action == action);
    let by_action = |action: Action| {
        let constrained = |rollout: &Rollout| rollout.constrained[action as usize] > 0;
        let obeyed = |rollout: &Rollout| {
            rollout
                .broken
                .iter()
                .all(|&constraint| constraints[constraint].action != action)
        };
        ActionRate {
            action: action.name(),
            rate: rate(&|rollout| constrained(rollout).then(|| obeyed(rollout))),
        }
    };
    let returns = episodes.clone().map(mean_return);
    let score = random.map(|random| {
        assert!(random.len() == episodes.len(), "one random return for each episode");
        Score::of(returns.clone().zip(random).map(|(mean, random)| mean - random))
    });
    let steps: u64 = rollouts.iter().map(|rollout| u64::from(rollout.steps)).sum();
    let constrained = |rollout: &Rollout| rollout.constrained.iter().any(|steps| *steps > 0);
    Summary {
        tsr: rate(&|rollout| Some(rollout.success)),
        dsr: rate(&|rollout| Some(rollout.broken.is_empty() && constrained(rollout))),
        dsr_by_action: Action::ALL
            .into_iter()
            .filter(|action| asked(*action))
            .map(by_action)
            .collect(),
        mean_return: Score::of(returns),
        score,
        mean_steps: steps as f64 / rollouts.len().max(1) as f64,
    }
}

/// The mean return of some rollouts, at least one.
#[allow(clippy::cast_precision_loss)] // fewer than 2^53
pub(super) fn mean_return(rollouts: &[Rollout]) -> f64 {
    rollouts.iter().map(|rollout| rollout.total).sum::<f64>() / rollouts.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    #[test]
    fn intervals_are_those_of_the_textbook() {
        // Newcombe 1998, table 1: 81 of 263, score interval without continuity correction.
        let rate = once(81, 263);
        assert!(
            (rate.low - 0.2553).abs() < 5e-5 && (rate.high - 0.3662).abs() < 5e-5,
            "{rate:?}"
        );
        let none = once(0, 20);
        assert!(none.low == 0.0 && (none.high - 0.1611).abs() < 5e-5, "{none:?}");
        let score = Score::of([1.0, 2.0, 3.0, 4.0].into_iter());
        assert!(
            (score.value - 2.5).abs() < 1e-12 && (score.high - 2.5 - Z * 0.645_497_224).abs() < 1e-8,
            "{score:?}"
        );
    }

    /// One run of each episode.
    fn once(hits: usize, episodes: usize) -> Rate {
        Rate::of((0..episodes).map(|episode| [usize::from(episode < hits), 1]))
    }

    #[test]
    #[allow(clippy::cast_precision_loss)]
    fn intervals_depend_on_how_far_runs_of_an_episode_agree() {
        let is_wilson = |rate: Rate, n: f64| {
            let [low, high] = wilson(rate.value, n);
            assert!(
                (rate.low - low).abs() < 1e-12 && (rate.high - high).abs() < 1e-12,
                "{rate:?} {n}"
            );
        };
        for hits in 0..=20 {
            is_wilson(once(hits, 20), 20.0);
        }
        // Ten runs that go the same way tell what one does.
        let same = Rate::of((0..30).map(|episode| [if episode < 9 { 10 } else { 0 }, 10]));
        assert_eq!((same.value, same.episodes, same.runs), (0.3, 30, 300));
        is_wilson(same, 300.0 * 29.0 / 299.0);
        // Where episodes are all alike, every run counts.
        is_wilson(Rate::of((0..30).map(|_| [3, 10])), 300.0);
        // Nothing is seen of how alike runs are.
        is_wilson(Rate::of((0..30).map(|_| [0, 10])), 30.0);
        is_wilson(Rate::of([[10, 10], [10, 10]].into_iter()), 2.0);
        is_wilson(Rate::of([[3, 10]].into_iter()), 1.0);
        // Episodes without runs do not count.
        let some = Rate::of([[3, 10], [0, 0], [5, 7]].into_iter());
        assert_eq!(some, Rate::of([[3, 10], [5, 7]].into_iter()));
        assert_eq!((some.episodes, some.runs), (2, 17));
        let none = Rate::of([[0, 0]].into_iter());
        assert_eq!((none.low, none.high, none.episodes, none.runs), (0.0, 1.0, 0, 0));
    }

    /// Drawn episodes, one in five of which is easy and hit by half of its runs, the others by none: 0.1 lies in about 95 of 100 intervals,
    /// and in far fewer of those that take all runs for independent ones.
    #[test]
    fn intervals_have_their_coverage() {
        let mut random = Seed(3).stream(Purpose::POLICY, 0, 0);
        let (trials, mut inside, mut naive) = (500, 0, 0);
        for _ in 0..trials {
            let episodes: Vec<[usize; 2]> = (0..100)
                .map(|_| {
                    let easy = random.random_range(0..5) == 0;
                    [(0..10).filter(|_| random.random::<bool>() && easy).count(), 10]
                })
                .collect();
            let rate = Rate::of(episodes.iter().copied());
            let [low, high] = wilson(rate.value, 1000.0);
            inside += usize::from(rate.low <= 0.1 && 0.1 <= rate.high);
            naive += usize::from(low <= 0.1 && 0.1 <= high);
        }
        assert!((460..=495).contains(&inside), "{inside} of {trials}");
        assert!(naive < 400, "{naive} of {trials}");
    }
}
