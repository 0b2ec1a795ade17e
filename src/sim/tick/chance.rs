//! Draws: whether what holds with a probability holds.

use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// Predicates that hold with a probability; index: the pair of agents, see `sim::ground`.
    pub const PREDICATE: Purpose = Purpose::new(5);
}

/// Decides whether a predicate that holds only with a probability holds now, for the pair (first, second) of entities.
pub trait Chance {
    /// `predicate` is its position in the vocabulary; `probability` is in 0..=1.
    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool;

    /// The same, where what is certain is not drawn.
    #[inline]
    fn decides(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        probability >= 1.0 || probability > 0.0 && self.happens(predicate, first, second, probability)
    }
}

/// Draws from seeded streams: the same for the same seed, time, predicate and pair of entities.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draws {
    pub seed: Seed,
    pub time: u64,
}

impl Chance for Draws {
    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        // 16 bits of predicate and 24 bits for each entity: a scene has fewer of either.
        let index = (predicate as u64) << 48 | (first as u64) << 24 | second as u64;
        let mut stream = self.seed.stream(Purpose::PREDICATE, index, self.time);
        stream.random::<f64>() < probability
    }
}
