//! Random draws for predicates that hold with a probability.
// Decision: docs/decisions/city.md#d005

use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// Predicates that hold with a probability; index: predicate and pair of agents.
    pub const PREDICATE: Purpose = Purpose::new(5);
}

/// Decides whether a predicate with a probability holds now for an ordered pair of entities.
pub trait Chance {
    /// Returns the number of the tick that is now.
    fn tick(&self) -> u64;

    /// Returns whether the predicate holds. `predicate` is its position in the vocabulary; `probability` is in 0..=1.
    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool;

    /// Variant of [`happens`](Chance::happens) that skips the draw for the probabilities 0 and 1.
    #[inline]
    fn decides(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        probability >= 1.0 || probability > 0.0 && self.happens(predicate, first, second, probability)
    }
}

/// Draws from seeded streams. Equal seed, time, predicate and pair give equal draws.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draws {
    pub seed: Seed,
    pub time: u64,
}

impl Chance for Draws {
    fn tick(&self) -> u64 {
        self.time
    }

    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        // The index has 16 bits for the predicate and 24 bits per entity, more than any scene needs.
        let index = (predicate as u64) << 48 | (first as u64) << 24 | second as u64;
        let mut stream = self.seed.stream(Purpose::PREDICATE, index, self.time);
        stream.random::<f64>() < probability
    }
}
