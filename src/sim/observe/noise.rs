//! Random bits with a given probability, 64 at a time.

use crate::rng::Words;

/// A probability as a binary fraction with 64 digits.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Threshold {
    digits: u64,
    /// Whether the probability is 1.
    always: bool,
}

impl Threshold {
    /// Returns the threshold of a probability from 0 to 1.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a fraction of 2^64
    pub fn new(probability: f64) -> Threshold {
        Threshold {
            digits: (probability * 2f64.powi(64)) as u64,
            always: probability >= 1.0,
        }
    }

    /// Returns whether no draw is below it.
    pub fn is_never(self) -> bool {
        self.digits == 0 && !self.always
    }
}

/// Draws a number from 0 to 1 for each lane in `lanes`, and returns for each threshold the lanes whose number is below
/// it. Other lanes are unspecified.
///
/// Random words give the digits of the numbers, one digit of all lanes at a time, until all lanes are decided: after
/// eight words or so.
pub(super) fn below<const N: usize>(thresholds: [Threshold; N], lanes: u64, random: &mut Words) -> [u64; N] {
    let mut below = thresholds.map(|threshold| if threshold.always { u64::MAX } else { 0 });
    let mut open = thresholds.map(|threshold| match threshold.always || threshold.digits == 0 {
        true => 0,
        false => lanes,
    });
    for digit in (0..64).rev() {
        if open.iter().all(|open| *open == 0) {
            break;
        }
        let word = random.next_word();
        for ((below, open), threshold) in below.iter_mut().zip(&mut open).zip(thresholds) {
            if threshold.digits >> digit & 1 == 0 {
                *open &= !word;
            } else {
                *below |= *open & !word;
                *open &= word;
            }
            // No number is below a threshold whose other digits are 0.
            if threshold.digits & ((1 << digit) - 1) == 0 {
                *open = 0;
            }
        }
    }
    below
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Seed};

    #[test]
    fn bits_are_set_with_their_probability_and_share_their_number() {
        let mut random = Seed(3).words(Purpose::TEST, 0, 0);
        let (draws, lanes) = (2000, u64::MAX >> 3);
        let probabilities = [0.05, 0.9, 0.5, 0.333, 0.0, 1.0];
        let mut counts = [0u32; 6];
        for _ in 0..draws {
            let masks = below(probabilities.map(Threshold::new), lanes, &mut random);
            for (count, mask) in counts.iter_mut().zip(masks) {
                *count += (mask & lanes).count_ones();
            }
            // A number below a threshold is below every greater one.
            assert_eq!(masks[0] & !masks[3] & lanes, 0);
            assert_eq!(masks[2] & !masks[1] & lanes, 0);
        }
        for (count, probability) in counts.into_iter().zip(probabilities) {
            let (total, count) = (f64::from(draws) * 61.0, f64::from(count));
            let deviation = (total * probability * (1.0 - probability)).sqrt();
            assert!(
                (count - total * probability).abs() <= 4.0 * deviation,
                "{probability}: {count}"
            );
        }
    }

    #[test]
    fn certain_thresholds_take_no_random_word() {
        let mut one = Seed(3).words(Purpose::TEST, 0, 0);
        let mut two = Seed(3).words(Purpose::TEST, 0, 0);
        assert_eq!(below([0.0, 1.0].map(Threshold::new), u64::MAX, &mut one), [0, u64::MAX]);
        assert_eq!(one.next_word(), two.next_word());
    }
}
