//! Seeded, named random streams.
//!
//! Nothing here advances from one call to the next: a stream is a function of (seed, purpose, index, tick), so a draw does not
//! depend on how many draws others made before, nor on which thread makes it. The generator is ChaCha with 8 rounds, keyed by
//! those four numbers, whose output `rand_chacha` keeps stable across versions.

use rand::SeedableRng;
pub use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// What a stream is for. Streams of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Building types of a generated map; index: block.
    Buildings = 1,
    /// First start and goal; index: agent.
    Placement = 2,
    /// New goals; index: agent.
    Goal = 3,
    /// A choice among several possible moves; index: agent.
    Move = 4,
    /// Predicates that hold with a probability; index: the pair of agents, see `sim::ground`.
    Predicate = 5,
    /// A scene in which two rule sets are compared; index: its number.
    Scene = 6,
    /// What the ego of a task is.
    Ego = 7,
    /// Seeds of one episode after another; index: how many there were before.
    Episode = 8,
    /// A policy that acts at random; index: the step.
    Policy = 9,
    /// What an icon looks like; index: its class, tick: the instance.
    Icon = 10,
    /// The texture of the ground.
    Texture = 11,
    /// Language questions: the worlds they are from, which decisions are asked about, and the order of entities.
    Question = 12,
    /// The seeds of the worlds of a data set; index: number of the world, tick: the split.
    World = 13,
    /// The agents of a world whose agents are drawn.
    Cast = 14,
    /// Which instance of its class a picture shows; index: agent.
    Look = 15,
    /// Which of the shortest ways pedestrians take; index: the start, tick: the goal.
    Walk = 16,
}

/// The seed of a run, from which every stream is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed(pub u64);

impl Seed {
    /// The stream for a purpose, an index and a tick.
    pub fn stream(self, purpose: Purpose, index: u64, tick: u64) -> impl Rng + use<> {
        let mut key = [0; 32];
        for (chunk, word) in key.chunks_exact_mut(8).zip([self.0, purpose as u64, index, tick]) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        ChaCha8Rng::from_seed(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_functions_of_their_four_numbers() {
        let draw = |seed, purpose, index, tick| -> u64 { Seed(seed).stream(purpose, index, tick).random() };
        let base = draw(7, Purpose::Goal, 3, 11);
        assert_eq!(base, draw(7, Purpose::Goal, 3, 11));
        for other in [
            draw(8, Purpose::Goal, 3, 11),
            draw(7, Purpose::Move, 3, 11),
            draw(7, Purpose::Goal, 4, 11),
            draw(7, Purpose::Goal, 3, 12),
        ] {
            assert_ne!(base, other);
        }
    }
}
