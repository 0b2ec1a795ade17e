//! Sums of weights over sets of states.

use crate::induce::bits;

/// A weight for each state of a list, as planes of bits: plane `k` has the states whose weight has bit `k`.
pub struct Weights {
    planes: Vec<Vec<u64>>,
}

impl Weights {
    /// Creates the weights.
    pub fn new(weights: &[u32]) -> Weights {
        let planes = weights.iter().max().map_or(0, |most| u32::BITS - most.leading_zeros());
        let plane = |bit: u32| {
            let mut plane = bits::empty(weights.len()).into_vec();
            for (state, _) in weights.iter().enumerate().filter(|(_, weight)| *weight >> bit & 1 == 1) {
                bits::insert(&mut plane, state);
            }
            plane
        };
        Weights {
            planes: (0..planes).map(plane).collect(),
        }
    }

    /// Returns the sum of the weights of a set of states.
    pub fn sum(&self, states: &[u64]) -> i64 {
        let plane = |(bit, plane): (usize, &Vec<u64>)| i64::from(bits::intersection_len(plane, states)) << bit;
        self.planes.iter().enumerate().map(plane).sum()
    }

    /// Returns the sum of the weights of the states that are in both sets.
    pub fn sum_common(&self, one: &[u64], other: &[u64]) -> i64 {
        let plane = |(bit, plane): (usize, &Vec<u64>)| {
            let count = |((plane, one), other): ((&u64, &u64), &u64)| (plane & one & other).count_ones();
            i64::from(plane.iter().zip(one).zip(other).map(count).sum::<u32>()) << bit
        };
        self.planes.iter().enumerate().map(plane).sum()
    }
}
