//! The paper's measures of a policy over many episodes, with 95 % confidence intervals.

use crate::city::Action;
use crate::task::spf::{Rollout, SpfTask};
use serde::Serialize;

/// The 97.5th percentile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// A proportion of runs with its Wilson score interval (Wilson 1927).
///
/// Several runs of one episode are correlated. The interval therefore uses the *effective* number of runs (Kish 1965):
/// the number of runs over the design effect, at least 1. The design effect is the variance of the proportion between
/// episodes over the variance for independent runs. If it cannot be estimated, because all runs hit, no run hits, or
/// there is one episode, the effective number is that of the episodes. With one run per episode it equals the number of
/// episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// The proportion, 0 to 1; 0 without runs.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Number of episodes with runs.
    pub episodes: usize,
    /// Number of runs in all episodes.
    pub runs: usize,
}

impl Rate {
    /// Computes the rate from `[hits, runs]` of each episode; ignores episodes without runs.
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

/// Returns the Wilson score interval of a proportion of `n` trials.
fn wilson(p: f64, n: f64) -> [f64; 2] {
    if n == 0.0 {
        return [0.0, 1.0];
    }
    let middle = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    // Rounding errors must not move a bound across the proportion.
    [(middle - half).clamp(0.0, p), (middle + half).clamp(p, 1.0)]
}

/// A mean with its normal approximation interval: the mean plus or minus 1.96 standard errors.
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
    /// Computes the mean of some values; without values it is 0.
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

/// The decision success rate for an action.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActionRate {
    /// Name of the action.
    pub action: String,
    /// The proportion of runs without a violation of the action's clauses, among those in which the rules derived it.
    #[serde(flatten)]
    pub rate: Rate,
}

/// The measures of a policy. With several runs or egos per episode, means and their intervals use the mean over the
/// runs and egos of each episode, and a rate counts every ego of every run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Trajectory success rate: the proportion of runs that reach the goal in time without a violation.
    pub tsr: Rate,
    /// Rule compliance rate: of the runs that have a constrained step, the proportion without a violation.
    pub compliance: Rate,
    /// Decision success rate: the proportion of runs that have a constrained step and no violation. Unlike
    /// `compliance`, it counts runs without a constrained step as failures.
    pub dsr: Rate,
    /// Decision success rate by action.
    pub dsr_by_action: Vec<ActionRate>,
    /// The rates of all egos together; `None` for one ego.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<JointRates>,
    /// Mean return.
    pub mean_return: Score,
    /// Mean return minus that of the random policy on the same episodes; `None` if that is unknown.
    pub score: Option<Score>,
    /// Mean number of steps.
    pub mean_steps: f64,
}

/// The rates of all egos of a run together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct JointRates {
    /// The proportion of runs in which all egos reach their goals in time without a violation.
    pub tsr: Rate,
    /// The proportion of runs without a violation in which an ego has a constrained step.
    pub dsr: Rate,
}

/// Summarizes rollouts, one per episode and ego of the task. `random` has the random policy's mean return on each
/// episode.
///
/// # Panics
/// If `rollouts` has no whole number of episodes, or `random` has another number of them.
pub fn summarize(task: &SpfTask, rollouts: &[Rollout], random: Option<&[f64]>) -> Summary {
    summarize_runs(task, rollouts, [1, task.evaluated_egos()], random)
}

/// Summarizes adjacent rollouts of each episode, one per run and ego. `random` has a mean return for each episode.
#[allow(clippy::cast_precision_loss)] // fewer than 2^53 runs and steps
pub(super) fn summarize_runs(
    task: &SpfTask,
    rollouts: &[Rollout],
    [runs, egos]: [usize; 2],
    random: Option<&[f64]>,
) -> Summary {
    assert!(
        rollouts.len().is_multiple_of(runs * egos),
        "the same number of rollouts of each episode"
    );
    let episodes = rollouts.chunks_exact((runs * egos).max(1));
    // `None` if the run does not count.
    let rate = |hits: &dyn Fn(&Rollout) -> Option<bool>| {
        Rate::of(episodes.clone().map(|runs| {
            let counted = runs.iter().filter_map(hits);
            [counted.clone().filter(|hit| *hit).count(), counted.count()]
        }))
    };
    let constraints = task.oracle().constraints();
    let asked = |action: Action| constraints.iter().any(|constraint| constraint.action == action);
    let by_action = |action: Action| {
        let constrained = |rollout: &Rollout| rollout.constrained[action.index()] > 0;
        let obeyed = |rollout: &Rollout| {
            rollout
                .broken
                .iter()
                .all(|&constraint| constraints[constraint].action != action)
        };
        ActionRate {
            action: task.world().vocabulary.actions().name(action).to_owned(),
            rate: rate(&|rollout| constrained(rollout).then(|| obeyed(rollout))),
        }
    };
    let returns = episodes.clone().map(mean_return);
    let score = random.map(|random| {
        assert!(random.len() == episodes.len(), "one random return for each episode");
        Score::of(returns.clone().zip(random).map(|(mean, random)| mean - random))
    });
    let joint_rate = |hits: &dyn Fn(&[Rollout]) -> bool| {
        Rate::of((episodes.clone()).map(|all| [all.chunks_exact(egos).filter(|run| hits(run)).count(), runs]))
    };
    let steps: u64 = rollouts.iter().map(|rollout| u64::from(rollout.steps)).sum();
    let constrained = |rollout: &Rollout| rollout.constrained.iter().any(|steps| *steps > 0);
    Summary {
        tsr: rate(&|rollout| Some(rollout.success)),
        compliance: rate(&|rollout| constrained(rollout).then_some(rollout.broken.is_empty())),
        dsr: rate(&|rollout| Some(rollout.broken.is_empty() && constrained(rollout))),
        dsr_by_action: (0..Action::MAX)
            .map(Action::at)
            .filter(|action| asked(*action))
            .map(by_action)
            .collect(),
        joint: (egos > 1).then(|| JointRates {
            tsr: joint_rate(&|run| run.iter().all(|rollout| rollout.success)),
            dsr: joint_rate(&|run| run.iter().all(|rollout| rollout.broken.is_empty()) && run.iter().any(constrained)),
        }),
        mean_return: Score::of(returns),
        score,
        mean_steps: steps as f64 / rollouts.len().max(1) as f64,
    }
}

/// Returns the mean return of at least one rollout.
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
        for episodes in 1..300 {
            let [none, all] = [once(0, episodes), once(episodes, episodes)];
            assert_eq!([none.low, all.high], [0.0, 1.0], "{episodes}");
        }
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
        // Ten equal runs carry the information of one.
        let same = Rate::of((0..30).map(|episode| [if episode < 9 { 10 } else { 0 }, 10]));
        assert_eq!((same.value, same.episodes, same.runs), (0.3, 30, 300));
        is_wilson(same, 300.0 * 29.0 / 299.0);
        // Where all episodes are alike, every run counts.
        is_wilson(Rate::of((0..30).map(|_| [3, 10])), 300.0);
        // The correlation of runs cannot be estimated.
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

    /// Samples episodes, one in five of which half of the runs hit. About 95 of 100 intervals contain 0.1, and far
    /// fewer of those that treat runs as independent.
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
