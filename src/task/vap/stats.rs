//! Estimates the labels and the facts of worlds, with standard errors.

use crate::cancel::Cancel;
use crate::task::vap::dataset::Monitor;
use crate::task::vap::{DatasetError, Worlds, count_actions, count_atoms, total};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::Range;

/// The counts of one world.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldCounts {
    /// The result of [`count_actions`].
    pub actions: [u64; 4],
    /// The result of [`count_atoms`].
    pub atoms: BTreeMap<String, u64>,
}

impl WorldCounts {
    /// Counts the labels and the facts of each of these worlds, without pictures or files.
    ///
    /// `progress` receives the numbers of worlds done and in total. It is called, and `cancel` is polled, on the
    /// calling thread only.
    ///
    /// # Errors
    /// As [`Worlds::frames`]; `cancelled`.
    pub fn of_worlds(
        worlds: &Worlds,
        numbers: Range<u32>,
        threads: NonZeroUsize,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &Cancel,
    ) -> Result<Vec<WorldCounts>, DatasetError> {
        let numbers: Vec<u32> = numbers.collect();
        Monitor::new(numbers.len() as u64, progress, cancel).run(threads, &numbers, |&number, step| {
            let frames = worlds.frames(number)?;
            let facts = frames.iter().map(|frame| &frame.facts);
            let counts = WorldCounts {
                actions: count_actions(&frames),
                atoms: count_atoms(&worlds.world().vocabulary, facts),
            };
            step(1)?;
            Ok(counts)
        })
    }
}

/// An estimate from a sample of worlds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The estimate.
    pub value: f64,
    /// Its standard error; `None` with a single world. Frames of one world are alike, so the worlds are the sample.
    pub error: Option<f64>,
}

impl Estimate {
    /// Estimates the mean of a number per world.
    fn mean(values: &[f64]) -> Estimate {
        Estimate::ratio(&values.iter().map(|&value| (value, 1.0)).collect::<Vec<_>>())
    }

    /// Estimates the ratio of two sums over the worlds, with the linearized (Taylor) standard error.
    #[allow(clippy::cast_precision_loss)]
    fn ratio(worlds: &[(f64, f64)]) -> Estimate {
        let (above, below) = worlds
            .iter()
            .fold((0.0, 0.0), |sum, world| (sum.0 + world.0, sum.1 + world.1));
        let value = if below == 0.0 { 0.0 } else { above / below };
        let count = worlds.len() as f64;
        let error = (worlds.len() > 1 && below > 0.0).then(|| {
            let squares: f64 = worlds.iter().map(|(part, all)| (part - value * all).powi(2)).sum();
            (squares * count / (count - 1.0)).sqrt() / below
        });
        Estimate { value, error }
    }

    /// Returns a multiple of the estimate.
    #[must_use]
    pub fn times(self, factor: f64) -> Estimate {
        Estimate {
            value: self.value * factor,
            error: self.error.map(|error| error * factor),
        }
    }
}

/// Estimates from a sample of worlds.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// The number of worlds.
    pub worlds: usize,
    /// The number of labels of cars.
    pub labels: u64,
    /// The share of each label, 0..=1, in the order of [`Action::STANDARD`](crate::city::Action::STANDARD).
    pub actions: [Estimate; 4],
    /// The number of true atoms of a world, by predicate; see [`count_atoms`].
    pub atoms: BTreeMap<String, Estimate>,
}

impl Statistics {
    /// Returns the estimates from these worlds.
    #[allow(clippy::cast_precision_loss)]
    pub fn of(worlds: &[WorldCounts]) -> Statistics {
        let share = |action: usize| {
            let parts = worlds.iter().map(|world| world.actions);
            Estimate::ratio(
                &parts
                    .map(|all| (all[action] as f64, total(all) as f64))
                    .collect::<Vec<_>>(),
            )
        };
        let names = worlds.first().into_iter().flat_map(|world| world.atoms.keys());
        let atoms = names.map(|name| {
            let counts: Vec<f64> = worlds.iter().map(|world| world.atoms[name] as f64).collect();
            (name.clone(), Estimate::mean(&counts))
        });
        Statistics {
            worlds: worlds.len(),
            labels: worlds.iter().map(|world| total(world.actions)).sum(),
            actions: [0, 1, 2, 3].map(share),
            atoms: atoms.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(actions: [u64; 4], close: u64) -> WorldCounts {
        let atoms = BTreeMap::from([("IsClose".to_owned(), close)]);
        WorldCounts { actions, atoms }
    }

    #[test]
    fn estimates_are_those_of_the_textbook() {
        let found = Statistics::of(&[world([1, 0, 0, 9], 4), world([3, 0, 0, 7], 8), world([2, 0, 0, 8], 6)]);
        assert_eq!((found.worlds, found.labels), (3, 30));
        // Worlds of equal size: the standard error of the mean of the shares 0.1, 0.3 and 0.2.
        let near = |found: Estimate, value: f64, error: f64| {
            assert!((found.value - value).abs() < 1e-12, "{found:?}");
            assert!((found.error.unwrap() - error).abs() < 1e-12, "{found:?}");
        };
        near(found.actions[0], 0.2, 0.1 / 3_f64.sqrt());
        near(found.actions[1], 0.0, 0.0);
        near(found.atoms["IsClose"], 6.0, 2.0 / 3_f64.sqrt());
        near(found.atoms["IsClose"].times(20.0), 120.0, 40.0 / 3_f64.sqrt());
        let one = Statistics::of(&[world([1, 1, 0, 2], 4)]);
        assert_eq!(
            one.actions[3],
            Estimate {
                value: 0.5,
                error: None
            }
        );
        assert_eq!(Statistics::of(&[]).labels, 0);
    }
}
