//! Sets of entities as bit words.

/// A set of entities: entity `i` is bit `i % 64` of word `i / 64`. Holds up to `64 * W` entities.
pub type Set<const W: usize> = [u64; W];

/// Returns the set with one member.
pub(super) fn only<const W: usize>(entity: usize) -> Set<W> {
    let mut set = [0; W];
    set[entity / 64] = 1 << (entity % 64);
    set
}

/// Returns whether the entity is in the set.
pub fn has<const W: usize>(set: &Set<W>, entity: usize) -> bool {
    set[entity / 64] >> (entity % 64) & 1 != 0
}

/// Returns the set of the first `count` entities.
pub fn first<const W: usize>(count: usize) -> Set<W> {
    std::array::from_fn(|word| match count.saturating_sub(word * 64) {
        0 => 0,
        1..64 => (1 << (count % 64)) - 1,
        _ => u64::MAX,
    })
}

/// Returns the intersection.
#[inline(always)]
pub fn and<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] &= right[at];
        at += 1;
    }
    left
}

/// Returns the members of `left` that are not in `right`.
#[inline(always)]
pub fn without<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] &= !right[at];
        at += 1;
    }
    left
}

#[inline(always)]
pub(super) fn or<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] |= right[at];
        at += 1;
    }
    left
}

/// Returns whether the set is empty.
#[inline(always)]
pub fn is_empty<const W: usize>(set: &Set<W>) -> bool {
    let mut all = 0;
    let mut at = 0;
    while at < W {
        all |= set[at];
        at += 1;
    }
    all == 0
}

/// Returns the set of the entities for which a value is true. There is one value per entity, at most 64.
#[inline]
pub fn holding(values: impl DoubleEndedIterator<Item = bool>) -> u64 {
    // Shifting the set takes fewer instructions than shifting each value.
    values.rev().fold(0, |set, holds| set << 1 | u64::from(holds))
}

/// Returns the entities of a set in ascending order.
pub fn members<const W: usize>(set: &Set<W>) -> impl Iterator<Item = usize> + use<W> {
    let mut rest = *set;
    let mut word = 0;
    std::iter::from_fn(move || {
        while word < W {
            if rest[word] != 0 {
                let bit = rest[word].trailing_zeros() as usize;
                rest[word] &= rest[word] - 1;
                return Some(word * 64 + bit);
            }
            word += 1;
        }
        None
    })
}
