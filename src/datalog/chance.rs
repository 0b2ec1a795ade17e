//! Draws of clauses with probabilities: `0.3 :: A(x); 0.7 :: B(x) :- C(x, y).`
//!
//! A draw is a function of the word of a tick, the stream of the clause and the values of its variables. So it depends
//! neither on the order of evaluation nor on the thread, and it is the same each time that a clause is evaluated in a
//! tick. The checker writes it as literals, which planners and executors treat like any others:
//!
//! ```text
//! chance(high, low), k = choose(high, low, stream high, stream low, alternatives, symbols, 0.3, 0.7, x, y), k = 0
//! ```
//!
//! `symbols` has a bit for each value that is a symbol: those count by their text, since their ids depend on the order
//! of interning.

/// The number of arguments before the probabilities.
pub(crate) const FIXED: usize = 6;

/// The position of the number of alternatives.
pub(crate) const ALTERNATIVES: usize = 4;

/// The position of the bits of the values that are symbols.
pub(crate) const SYMBOLS: usize = 5;

/// The maximum number of variables of a clause with probabilities, one for each bit of a word.
pub(crate) const VALUES_MAX: usize = 32;

/// The name of the hidden predicate with the word of the tick, which no source can write.
pub(crate) const PREDICATE: &str = "chance of the tick";

/// How far probabilities may add up to more than 1, since they have single precision.
pub(crate) const TOLERANCE: f64 = 1e-6;

/// Returns the word of a tick, from which all draws of the tick follow.
pub fn word(seed: u64, tick: u64) -> u64 {
    mix(mix(seed ^ 0x6c6f_6769_6369_7479).wrapping_add(tick))
}

/// Returns the stream of a clause from a text that no other clause of the program has.
pub(crate) fn stream(text: &str) -> u64 {
    hash(text)
}

/// Returns the two halves of a word.
pub(crate) fn halves(word: u64) -> [u32; 2] {
    [(word >> 32) as u32, word as u32]
}

/// Returns the word of these halves.
pub(crate) fn joined(high: u32, low: u32) -> u64 {
    u64::from(high) << 32 | u64::from(low)
}

/// The state of a draw before it has seen all values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draw(u64);

impl Draw {
    /// Begins the draw of a stream in a tick.
    #[inline]
    pub fn new(word: u64, stream: u64) -> Draw {
        Draw(mix(word ^ stream))
    }

    /// Adds the word of the value of a variable that is no symbol.
    pub fn value(self, word: u32) -> Draw {
        Draw(mix(self.0 ^ u64::from(word)))
    }

    /// Adds the value of a variable with a symbol, of which this is the [`hash`].
    #[inline]
    pub fn symbol(self, hash: u64) -> Draw {
        Draw(mix(self.0 ^ hash))
    }

    /// Returns the drawn number, at least 0 and below 1.
    #[inline]
    pub fn number(self) -> f64 {
        self.bits() as f64 / Draw::STEPS
    }

    /// Returns the drawn number in units of its smallest difference.
    #[inline]
    pub fn bits(self) -> u64 {
        mix(self.0) >> 11
    }

    /// Returns the least [`bits`](Draw::bits) of numbers that are at least `number`, which is at least 0.
    pub fn bits_from(number: f64) -> u64 {
        // The product is exact, and conversions of greater numbers give the greatest word.
        (number * Draw::STEPS).ceil() as u64
    }

    /// How many numbers can be drawn.
    const STEPS: f64 = (1_u64 << 53) as f64;
}

/// Returns the alternative that a number from 0 to 1 selects, or their count if it selects none. `None` if these are no
/// probabilities of alternatives.
pub(crate) fn alternative(number: f64, probabilities: impl Iterator<Item = f32>) -> Option<usize> {
    let (mut sum, mut chosen, mut count) = (0.0, None, 0);
    for probability in probabilities {
        if !(0.0..=1.0).contains(&probability) {
            return None;
        }
        sum += f64::from(probability);
        if chosen.is_none() && number < sum {
            chosen = Some(count);
        }
        count += 1;
    }
    (sum <= 1.0 + TOLERANCE).then(|| chosen.unwrap_or(count))
}

/// The mixing function of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014), after
/// its constant increment.
#[inline]
fn mix(word: u64) -> u64 {
    let word = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let word = (word ^ word >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ word >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ word >> 31
}

/// Returns the hash of a symbol, which draws use in place of its id.
pub fn hash(text: &str) -> u64 {
    let mut bytes = text.as_bytes().chunks_exact(8);
    let mut state = mix(text.len() as u64);
    for chunk in &mut bytes {
        state = mix(state ^ u64::from_le_bytes(chunk.try_into().expect("chunks of eight bytes")));
    }
    let rest = (bytes.remainder().iter().rev()).fold(0_u64, |word, &byte| word << 8 | u64::from(byte));
    mix(state ^ rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_have_the_frequencies_of_their_probabilities() {
        let probabilities = [0.25_f32, 0.0, 0.5];
        let mut counts = [0; 4];
        let draws = 40_000;
        for tick in 0..draws / 100 {
            let begun = Draw::new(word(7, tick), stream("A 1"));
            for value in 0..100 {
                counts[alternative(begun.value(value).number(), probabilities.into_iter()).unwrap()] += 1;
            }
        }
        // Five standard deviations of a fair coin tossed as often.
        let within = 2.5 * (draws as f64).sqrt();
        for (count, expected) in counts.into_iter().zip([0.25, 0.0, 0.5, 0.25]) {
            assert!(
                (f64::from(count) - expected * draws as f64).abs() <= within,
                "{counts:?}"
            );
        }
    }

    #[test]
    fn bits_compare_like_numbers() {
        let bounds = (0..200).map(|round| Draw::new(round, 1).number());
        let bounds = bounds.flat_map(|number| [number, number.next_down(), number.next_up(), f64::from(number as f32)]);
        for bound in bounds.chain([0.0, 1.0, f64::INFINITY]) {
            for round in 0..200 {
                let draw = Draw::new(round, 1);
                assert_eq!(draw.bits() >= Draw::bits_from(bound), draw.number() >= bound, "{bound}");
            }
        }
    }

    #[test]
    fn no_alternative_is_drawn_from_what_is_no_probability() {
        let drawn = |probabilities: &[f32]| alternative(0.5, probabilities.iter().copied());
        assert_eq!(drawn(&[]), Some(0));
        assert_eq!(drawn(&[0.5, 0.5]), Some(1));
        assert_eq!(drawn(&[0.2]), Some(1));
        for faulty in [&[-0.1_f32][..], &[1.1], &[f32::NAN], &[0.6, 0.6]] {
            assert_eq!(drawn(faulty), None);
        }
    }
}
