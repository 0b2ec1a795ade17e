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

    /// Returns words for a purpose, an index and a tick.
    #[inline]
    pub fn words(self, purpose: Purpose, index: u64, tick: u64) -> Words {
        let next = |words: Words, number: u64| Words(Words(words.0 ^ number).next_word());
        [purpose.0, index, tick].into_iter().fold(Words(mix(self.0)), next)
    }
}

/// Random words of a stream: SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
/// Faster to begin and to draw from than [`Seed::stream`], for a few words in every tick.
#[derive(Clone, Debug)]
pub struct Words(u64);

impl Words {
    /// Returns the next word.
    #[inline]
    pub fn next_word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }
}

#[inline]
fn mix(word: u64) -> u64 {
    let word = (word ^ word >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ word >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ word >> 31
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
        depends_on_all_numbers(|seed, purpose, index, tick| Seed(seed).stream(purpose, index, tick).random());
        depends_on_all_numbers(|seed, purpose, index, tick| Seed(seed).words(purpose, index, tick).next_word());
    }

    fn depends_on_all_numbers(draw: impl Fn(u64, Purpose, u64, u64) -> u64) {
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
