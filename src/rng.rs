//! Seeded, named random streams.
//!
//! A stream is a function of (seed, purpose, index, tick) and has no state between calls. So a draw depends neither on
//! other draws nor on the thread that makes it. The generator is ChaCha with 8 rounds, keyed by these four numbers;
//! `rand_chacha` keeps its output stable across versions.

use rand::SeedableRng;
pub use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// The purpose of a stream. Streams of different purposes are independent.
///
/// Each module declares its own purposes as constants; a test checks that their numbers are distinct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Purpose(u64);

impl Purpose {
    /// Random input of tests.
    pub const TEST: Purpose = Purpose::new(6);

    /// Creates the purpose with this number, which must be unique.
    pub const fn new(number: u64) -> Purpose {
        Purpose(number)
    }
}

/// The seed of a run. All streams derive from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed(pub u64);

impl Seed {
    /// Returns the stream for a purpose, an index and a tick.
    pub fn stream(self, purpose: Purpose, index: u64, tick: u64) -> impl Rng + use<> {
        let mut key = [0; 32];
        for (chunk, word) in key.chunks_exact_mut(8).zip([self.0, purpose.0, index, tick]) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        ChaCha8Rng::from_seed(key)
    }
}

/// Draws elements of a list, with replacement. The list must not be empty if `count` is positive.
pub fn draw<T: Copy>(elements: &[T], count: usize, random: &mut impl Rng) -> Vec<T> {
    (0..count)
        .map(|_| elements[random.random_range(0..elements.len())])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOAL: Purpose = Purpose::new(3);
    const MOVE: Purpose = Purpose::new(4);

    #[test]
    fn streams_are_functions_of_their_four_numbers() {
        let draw = |seed, purpose, index, tick| -> u64 { Seed(seed).stream(purpose, index, tick).random() };
        let base = draw(7, GOAL, 3, 11);
        assert_eq!(base, draw(7, GOAL, 3, 11));
        for other in [
            draw(8, GOAL, 3, 11),
            draw(7, MOVE, 3, 11),
            draw(7, GOAL, 4, 11),
            draw(7, GOAL, 3, 12),
        ] {
            assert_ne!(base, other);
        }
    }
}
