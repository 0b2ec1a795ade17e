//! Random draws for predicates and clauses with a probability.
// Decision: docs/decisions/city.md#d005

use crate::rng::{Purpose, RngExt, Seed};

impl Purpose {
    /// Predicates that hold with a probability; index: predicate and pair of agents.
    pub const PREDICATE: Purpose = Purpose::new(5);
    /// Clauses with probabilities; the index is 0.
    pub const CLAUSES: Purpose = Purpose::new(20);
}

/// Decides whether a predicate with a probability holds now for an ordered pair of entities.
pub trait Chance {
    /// Returns the number of the tick that is now.
    fn tick(&self) -> u64;

    /// Returns the word of this tick, from which the draws of clauses with probabilities follow.
    fn word(&self) -> u64;

    /// Returns whether the predicate holds. `predicate` is its position in the vocabulary; `probability` is in 0..=1.
    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool;

    /// Variant of [`happens`](Chance::happens) that skips the draw for the probabilities 0 and 1.
    #[inline]
    fn decides(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        probability >= 1.0 || probability > 0.0 && self.happens(predicate, first, second, probability)
    }
}

/// What the draws of clauses read in a tick.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Drawing<'a> {
    /// The word of the tick; 0 unless the rules draw.
    pub word: u64,
    /// The hashes of the names of the agents, in list order; empty unless the rules draw.
    pub names: &'a [u64],
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

    fn word(&self) -> u64 {
        self.seed.stream(Purpose::CLAUSES, 0, self.time).random()
    }

    fn happens(&self, predicate: usize, first: usize, second: usize, probability: f64) -> bool {
        // The index has 16 bits for the predicate and 24 bits per entity, more than any scene needs.
        let index = (predicate as u64) << 48 | (first as u64) << 24 | second as u64;
        let mut stream = self.seed.stream(Purpose::PREDICATE, index, self.time);
        stream.random::<f64>() < probability
    }
}
