//! Seeded, named random streams.
//!
//! Nothing here advances from one call to the next: a stream is a function of (seed, purpose, index, tick), so a draw does not
//! depend on how many draws others made before, nor on which thread makes it. The generator is ChaCha with 8 rounds, keyed by
//! those four numbers, whose output `rand_chacha` keeps stable across versions.

use rand::SeedableRng;
pub use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// What a stream is for. Streams of different purposes are independent.
///
/// Each room declares its own as constants; a test checks that no two have the same number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Purpose(u64);

impl Purpose {
    /// The purpose with this number, which no other has.
    pub const fn new(number: u64) -> Purpose {
        Purpose(number)
    }
}

/// The seed of a run, from which every stream is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed(pub u64);

impl Seed {
    /// The stream for a purpose, an index and a tick.
    pub fn stream(self, purpose: Purpose, index: u64, tick: u64) -> impl Rng + use<> {
        let mut key = [0; 32];
        for (chunk, word) in key.chunks_exact_mut(8).zip([self.0, purpose.0, index, tick]) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        ChaCha8Rng::from_seed(key)
    }
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
