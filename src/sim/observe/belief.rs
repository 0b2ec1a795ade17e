//! How probable facts are: before a reading, after one, and after all readings of an episode.
//!
//! Each fact is an independent Markov chain with two states; [`SensorModel`] has its probabilities. A sensor is a
//! binary channel with a true and a false positive rate. A missing reading carries no information. The forward
//! algorithm (Rabiner: A tutorial on hidden Markov models, 1989, section III A) computes the probability given all
//! readings.

use crate::config::Sensor;

/// The position of the ego in a fact. A fact about one agent has one of the first two roles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// The ego is the only or the first agent.
    First,
    /// The fact is about one other agent, or the ego is the second agent.
    Second,
    /// The ego is not in the fact.
    Absent,
}

impl Role {
    pub const COUNT: usize = 3;

    /// Returns the role for a fact about an entity, or about a pair whose first one is `row`. The ego is entity 0.
    pub fn of(row: Option<usize>, entity: usize) -> Role {
        match (row, entity) {
            (None, 0) | (Some(0), _) => Role::First,
            (None, _) | (Some(_), 0) => Role::Second,
            (Some(_), _) => Role::Absent,
        }
    }
}

/// The Markov chain of a fact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    /// The probability that it holds in a tick.
    pub base: f32,
    /// The probability that it holds in the first tick that observes its agents.
    pub initial: f32,
    /// The probability that it still holds a tick later.
    pub stays: f32,
    /// The probability that it holds a tick after it did not.
    pub appears: f32,
}

impl Chain {
    /// Returns the probability a tick later, given that of now.
    #[inline]
    pub fn next(self, holds: f32) -> f32 {
        self.appears + holds * (self.stays - self.appears)
    }

    /// Returns the probability some ticks later.
    pub fn later(self, holds: f32, ticks: u32) -> f32 {
        (0..ticks).fold(holds, |holds, _| self.next(holds))
    }
}

/// The counts of a fact over many ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub ticks: u64,
    pub holds: u64,
    /// The ticks whose predecessor did not observe the fact.
    pub first: u64,
    /// Those of them in which it holds.
    pub holds_first: u64,
    /// The ticks whose predecessor observed the fact, too, by whether it held.
    pub after: [u64; 2],
    /// Those of them in which it holds.
    pub holds_after: [u64; 2],
}

impl Counts {
    /// Returns the chain with the mean of its probabilities under a uniform prior (the rule of succession). A fact that
    /// `never_changes` keeps its value.
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)] // a share
    pub fn chain(self, never_changes: bool) -> Chain {
        let share = |some: u64, all: u64| ((some + 1) as f64 / (all + 2) as f64) as f32;
        let base = share(self.holds, self.ticks);
        let initial = share(self.holds_first, self.first);
        match never_changes {
            true => Chain {
                base,
                initial,
                stays: 1.0,
                appears: 0.0,
            },
            false => Chain {
                base,
                initial,
                stays: share(self.holds_after[1], self.after[1]),
                appears: share(self.holds_after[0], self.after[0]),
            },
        }
    }
}

/// A reading of a fact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reading {
    Missing,
    Negative,
    Positive,
}

impl Reading {
    pub const ALL: [Reading; 3] = [Reading::Missing, Reading::Negative, Reading::Positive];

    /// Returns the reading with these bits: whether there is one, and whether it is positive.
    #[inline]
    pub fn of(read: u64, positive: u64) -> Reading {
        match read + (read & positive) {
            0 => Reading::Missing,
            1 => Reading::Negative,
            _ => Reading::Positive,
        }
    }
}

/// The probabilities of each reading, by whether the fact holds.
pub(super) type Likelihoods = [[f32; 2]; 3];

/// Returns the probabilities of readings of a sensor.
#[allow(clippy::cast_possible_truncation)] // single precision
pub(super) fn likelihoods(sensor: &Sensor) -> Likelihoods {
    let [no, yes] = [sensor.false_positive_rate as f32, sensor.true_positive_rate as f32];
    Reading::ALL.map(|reading| match reading {
        Reading::Missing => [1.0, 1.0],
        Reading::Negative => [1.0 - no, 1.0 - yes],
        Reading::Positive => [no, yes],
    })
}

/// Returns the probability of a fact after a reading, given that before it (Bayes). A reading that is impossible leaves
/// it as it was.
#[inline]
pub(super) fn update(likelihoods: &Likelihoods, holds: f32, reading: Reading) -> f32 {
    let [no, yes] = likelihoods[reading as usize];
    let (yes, no) = (holds * yes, (1.0 - holds) * no);
    // Divides in either case, so that the compiler needs no branch.
    let after = yes / (yes + no);
    if yes + no > 0.0 { after } else { holds }
}

/// The probabilities of a fact and of the noise of its sensor, if noise is correlated: `[holds][class]`.
///
/// The noise is a number from 0 to 1. It is below both rates, between them, or above both: three classes. The class
/// and the truth determine the reading.
pub(super) type Joint = [[f32; 3]; 2];

/// The shares of the three classes of noise.
#[allow(clippy::cast_possible_truncation)] // single precision
fn classes(sensor: &Sensor) -> [f32; 3] {
    let (yes, no) = (sensor.true_positive_rate, sensor.false_positive_rate);
    [yes.min(no), (yes - no).abs(), 1.0 - yes.max(no)].map(|share| share as f32)
}

/// Returns the joint probabilities of a fact that holds with a probability, and of new noise.
pub(super) fn fresh(sensor: &Sensor, holds: f32) -> Joint {
    [1.0 - holds, holds].map(|holds| classes(sensor).map(|share| holds * share))
}

/// Moves joint probabilities a tick on.
pub(super) fn predict(sensor: &Sensor, chain: Chain, joint: &Joint) -> Joint {
    let (kept, shares) = (sensor.correlation as f32, classes(sensor));
    let mut next = [[0.0; 3]; 2];
    for class in 0..3 {
        let [no, yes] = [joint[0][class], joint[1][class]];
        let moved = chain.appears * no + chain.stays * yes;
        next[1][class] = moved;
        next[0][class] = no + yes - moved;
    }
    next.map(|row| {
        let sum: f32 = row.iter().sum();
        [0, 1, 2].map(|class| kept * row[class] + (1.0 - kept) * sum * shares[class])
    })
}

/// Conditions joint probabilities on the truth of the fact.
pub(super) fn assume(sensor: &Sensor, joint: &mut Joint) {
    let sum: f32 = joint[1].iter().sum();
    *joint = match sum > 0.0 {
        true => [[0.0; 3], joint[1].map(|share| share / sum)],
        false => fresh(sensor, 1.0),
    };
}

/// Conditions joint probabilities on a reading. A reading that is impossible leaves them as they were.
pub(super) fn condition(sensor: &Sensor, joint: &mut Joint, reading: Reading) {
    if reading == Reading::Missing {
        return;
    }
    let middle = sensor.true_positive_rate >= sensor.false_positive_rate;
    let mut conditioned = *joint;
    for (holds, row) in conditioned.iter_mut().enumerate() {
        for (class, value) in row.iter_mut().enumerate() {
            let positive = class == 0 || class == 1 && (holds == 1) == middle;
            if positive != (reading == Reading::Positive) {
                *value = 0.0;
            }
        }
    }
    let sum: f32 = conditioned.iter().flatten().sum();
    if sum > 0.0 {
        *joint = conditioned.map(|row| row.map(|value| value / sum));
    }
}

/// Returns the probability that the fact of joint probabilities holds.
pub(super) fn marginal(joint: &Joint) -> f32 {
    joint[1].iter().sum()
}

/// The chains of the facts that an ego observes, counted in episodes of the oracle, and the probabilities after each
/// reading.
#[derive(Debug)]
pub struct SensorModel {
    /// By predicate of the vocabulary and role.
    pub(super) facts: Vec<[FactModel; Role::COUNT]>,
    /// By number of observed entities, the observed probabilities after negative readings of all facts, if observations
    /// are probabilities.
    pub(super) negative: Vec<Vec<f32>>,
}

/// The model of the facts of a predicate in which the ego has the same role.
#[derive(Clone, Copy, Debug)]
pub(super) struct FactModel {
    pub chain: Chain,
    /// The probability now after each [`Reading`] of this tick.
    pub after: [f32; 3],
    /// The probability that the fact holds now if it did not hold in the tick of the reading, and how much greater it
    /// is if it did.
    pub ahead: [f32; 2],
}

impl FactModel {
    pub fn new(sensor: &Sensor, chain: Chain) -> FactModel {
        let from = [0.0, 1.0].map(|holds| chain.later(holds, sensor.delay));
        let ahead = [from[0], from[1] - from[0]];
        let likelihoods = likelihoods(sensor);
        let after = Reading::ALL.map(|reading| match reading {
            Reading::Missing => chain.base,
            _ => ahead[0] + ahead[1] * update(&likelihoods, chain.base, reading),
        });
        FactModel { chain, after, ahead }
    }
}

impl SensorModel {
    /// Returns the chains of a predicate: that of facts whose only or first agent is the ego, that of facts about one
    /// other agent or with the ego second, and that of facts about two others.
    pub fn chains(&self, predicate: usize) -> [Chain; 3] {
        self.facts[predicate].map(|fact| fact.chain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    /// The probability that the fact holds after these readings: a sum over all histories of the fact and of its noise.
    fn enumerated(sensor: &Sensor, chain: Chain, readings: &[Reading]) -> f64 {
        let shares = classes(sensor).map(f64::from);
        let (ticks, mut sums) = (readings.len(), [0.0; 2]);
        for history in 0..6usize.pow(u32::try_from(ticks).unwrap()) {
            let mut code = history;
            let states: Vec<(usize, usize)> = (0..ticks)
                .map(|_| {
                    let state = code % 6;
                    code /= 6;
                    (state / 3, state % 3)
                })
                .collect();
            let mut probability = 1.0;
            for (at, &(holds, class)) in states.iter().enumerate() {
                let truth = match at.checked_sub(1).map(|before| states[before].0) {
                    None => f64::from(chain.initial),
                    Some(1) => f64::from(chain.stays),
                    Some(_) => f64::from(chain.appears),
                };
                probability *= if holds == 1 { truth } else { 1.0 - truth };
                let redrawn = (1.0 - if at == 0 { 0.0 } else { sensor.correlation }) * shares[class];
                let kept = at > 0 && states[at - 1].1 == class;
                probability *= redrawn + if kept { sensor.correlation } else { 0.0 };
                let above = [sensor.false_positive_rate, sensor.true_positive_rate][holds];
                let other = [sensor.true_positive_rate, sensor.false_positive_rate][holds];
                let positive = class == 0 || class == 1 && above > other;
                probability *= match readings[at] {
                    Reading::Missing => 1.0,
                    Reading::Positive => f64::from(u8::from(positive)),
                    Reading::Negative => f64::from(u8::from(!positive)),
                };
            }
            sums[states[ticks - 1].0] += probability;
        }
        sums[1] / (sums[0] + sums[1])
    }

    #[test]
    fn filters_equal_the_sum_over_all_histories() {
        let mut random = Seed(5).stream(Purpose::TEST, 0, 0);
        for case in 0..40 {
            let correlation = if case % 2 == 0 {
                0.0
            } else {
                random.random_range(0.1..0.9)
            };
            let sensor = Sensor {
                true_positive_rate: random.random_range(0.05..0.95),
                false_positive_rate: random.random_range(0.05..0.95),
                correlation,
                ..Sensor::default()
            };
            let mut share = || random.random_range(0.05f32..0.95);
            let chain = Chain {
                base: share(),
                initial: share(),
                stays: share(),
                appears: share(),
            };
            let readings: Vec<Reading> = (0..5).map(|_| Reading::ALL[random.random_range(0..3)]).collect();
            let (mut joint, mut simple) = (fresh(&sensor, chain.initial), chain.initial);
            for (at, reading) in readings.iter().enumerate() {
                if at > 0 {
                    joint = predict(&sensor, chain, &joint);
                    simple = chain.next(simple);
                }
                condition(&sensor, &mut joint, *reading);
                simple = update(&likelihoods(&sensor), simple, *reading);
                let expected = enumerated(&sensor, chain, &readings[..=at]);
                assert!(
                    (f64::from(marginal(&joint)) - expected).abs() < 1e-4,
                    "{case}: {joint:?}"
                );
                if correlation == 0.0 {
                    assert!((f64::from(simple) - expected).abs() < 1e-4, "{case}: {simple}");
                }
            }
        }
    }

    #[test]
    fn impossible_readings_change_nothing() {
        let sensor = Sensor::default();
        assert_eq!(update(&likelihoods(&sensor), 0.0, Reading::Positive), 0.0);
        let mut joint = fresh(&sensor, 0.0);
        condition(&sensor, &mut joint, Reading::Positive);
        assert_eq!(joint, fresh(&sensor, 0.0));
    }
}
