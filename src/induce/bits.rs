//! Sets of small numbers as bits.

use smallvec::SmallVec;

/// A set of numbers below a fixed bound.
pub type Bits = SmallVec<[u64; 4]>;

/// Returns the empty set of numbers below `bound`.
pub fn empty(bound: usize) -> Bits {
    SmallVec::from_elem(0, bound.div_ceil(64))
}

/// Returns the set of all numbers below `bound`.
pub fn full(bound: usize) -> Bits {
    let mut all = empty(bound);
    (0..bound).for_each(|number| insert(&mut all, number));
    all
}

/// Returns whether a number is in the set.
#[inline]
pub fn contains(set: &[u64], number: usize) -> bool {
    set[number / 64] >> (number % 64) & 1 == 1
}

/// Adds a number.
#[inline]
pub fn insert(set: &mut [u64], number: usize) {
    set[number / 64] |= 1 << (number % 64);
}

/// Removes a number.
#[inline]
pub fn remove(set: &mut [u64], number: usize) {
    set[number / 64] &= !(1 << (number % 64));
}

/// Adds the numbers of another set.
pub fn union(set: &mut [u64], other: &[u64]) {
    set.iter_mut().zip(other).for_each(|(set, other)| *set |= other);
}

/// Removes the numbers of another set.
pub fn subtract(set: &mut [u64], other: &[u64]) {
    set.iter_mut().zip(other).for_each(|(set, other)| *set &= !other);
}

/// Returns whether two sets have a common number.
#[inline]
pub fn intersects(one: &[u64], other: &[u64]) -> bool {
    one.iter().zip(other).any(|(one, other)| one & other != 0)
}

/// Returns how many numbers are in the set.
#[inline]
pub fn count(set: &[u64]) -> u32 {
    set.iter().map(|word| word.count_ones()).sum()
}

/// Returns how many numbers are in both sets.
#[inline]
pub fn intersection_len(one: &[u64], other: &[u64]) -> u32 {
    one.iter()
        .zip(other)
        .map(|(one, other)| (one & other).count_ones())
        .sum()
}

/// Returns the numbers of a set, in ascending order.
pub fn elements(set: &[u64]) -> impl Iterator<Item = usize> + '_ {
    set.iter().enumerate().flat_map(|(at, &word)| {
        let mut rest = word;
        std::iter::from_fn(move || {
            (rest != 0).then(|| {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                at * 64 + bit
            })
        })
    })
}
