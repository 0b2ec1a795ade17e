//! A bitmap of derived rows: one bit for each possible row.
//!
//! Rules often derive the same row many times. Where words are dense, as interned symbols and small numbers are,
//! testing a bit costs much less than sorting repetitions away. The bits of new rows also form a sorted list.
// Decision: docs/decisions/evaluation.md#d018

use crate::row::Row;
use crate::value::Value;

/// A set of rows whose words are below fixed bounds.
#[derive(Debug)]
pub(crate) struct SeenBitmap<const W: usize> {
    /// Indexed by column: the exclusive upper bound of the words.
    bounds: [u32; W],
    /// Indexed by column: the distance between the bits of consecutive words.
    strides: [u64; W],
    /// The bits of all rows ever added.
    known: Vec<u64>,
    /// The bits of rows added since the last [`SeenBitmap::drain`]; empty while new rows are kept elsewhere.
    fresh: Vec<u64>,
}

/// The result of adding a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Added {
    /// The set already had the row.
    Known,
    /// The row is new.
    New,
    /// A word exceeds its bound.
    Beyond,
}

impl<const W: usize> SeenBitmap<W> {
    /// The size in bytes that a set may have regardless of the number of rows.
    const BYTES_FREE: u64 = 1 << 13;

    /// From this bound on, the words of the last column fill whole words of bits, so that [`SeenBitmap::add_set`] can
    /// add many rows at once.
    const ALIGNED_MIN: u32 = 512;

    /// Makes a set of these rows. Its bounds leave room above the words of `rows` and `largest`. Returns `None` if it
    /// would take more memory than `count` rows.
    pub(crate) fn over(rows: &[Row<W>], mut largest: [u32; W], count: u64) -> Option<Self> {
        raise(&mut largest, rows);
        let mut bounds = [1; W];
        let mut strides = [0; W];
        let mut bits = 1_u64;
        for column in (0..W).rev() {
            strides[column] = bits;
            // A column of zeros is probably padding.
            if largest[column] > 0 {
                bounds[column] = largest[column].checked_add(largest[column] / 4 + 1)?;
            }
            if bits == 1 && bounds[column] >= Self::ALIGNED_MIN {
                bounds[column] = bounds[column].checked_next_multiple_of(u64::BITS)?;
            }
            bits = bits.checked_mul(u64::from(bounds[column]))?;
        }
        if bits / 8 > count.saturating_mul(size_of::<Row<W>>() as u64).max(Self::BYTES_FREE) {
            return None;
        }
        let mut seen = SeenBitmap {
            bounds,
            strides,
            known: vec![0; usize::try_from(bits.div_ceil(64)).ok()?],
            fresh: Vec::new(),
        };
        rows.iter().for_each(|row| _ = seen.add(row));
        Some(seen)
    }

    /// Makes a set with the same bounds and known rows that keeps new rows as bits. Bits are also faster where most
    /// rows are known.
    pub(crate) fn fork(&self) -> Self {
        SeenBitmap {
            known: self.known.clone(),
            fresh: vec![0; self.known.len()],
            ..*self
        }
    }

    /// Indexed by column: the largest word that fits.
    pub(crate) fn largest(&self) -> [u32; W] {
        self.bounds.map(|bound| bound - 1)
    }

    /// The bytes of the bits of all rows.
    pub(crate) fn bytes(&self) -> usize {
        self.known.len() * size_of::<u64>()
    }

    /// Whether both sets have the same bounds.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        self.bounds == other.bounds
    }

    /// Adds the new rows of a set with the same bounds; both sets must keep new rows as bits. Returns the number of
    /// rows that are new here.
    pub(crate) fn absorb(&mut self, other: &Self) -> usize {
        let mut new = 0;
        for ((known, fresh), other) in self.known.iter_mut().zip(&mut self.fresh).zip(&other.fresh) {
            let added = other & !*known;
            *known |= added;
            *fresh |= added;
            new += added.count_ones() as usize;
        }
        new
    }

    #[inline]
    fn bit(&self, row: &Row<W>) -> Option<(usize, u64)> {
        let mut at = 0;
        for column in 0..W {
            if row.0[column].0 >= self.bounds[column] {
                return None;
            }
            at += u64::from(row.0[column].0) * self.strides[column];
        }
        Some(((at / 64) as usize, 1 << (at % 64)))
    }

    /// Adds a row.
    #[inline]
    pub(crate) fn add(&mut self, row: &Row<W>) -> Added {
        let Some((word, mask)) = self.bit(row) else {
            return Added::Beyond;
        };
        if self.known[word] & mask != 0 {
            return Added::Known;
        }
        self.known[word] |= mask;
        if let Some(fresh) = self.fresh.get_mut(word) {
            *fresh |= mask;
        }
        Added::New
    }

    /// Adds a row without marking it as new. Returns whether it fits.
    pub(crate) fn mark(&mut self, row: &Row<W>) -> bool {
        let bit = self.bit(row);
        if let Some((word, mask)) = bit {
            self.known[word] |= mask;
        }
        bit.is_some()
    }

    /// Adds copies of `row` in which one word is replaced; the set must keep new rows as bits. Stops at the first word
    /// beyond its bound. Returns the number of rows added and how many of them are new.
    #[inline(always)]
    pub(crate) fn hold_along(
        &mut self,
        mut row: Row<W>,
        column: usize,
        words: impl Iterator<Item = Value>,
    ) -> (usize, usize) {
        row.0[column] = Value(0);
        let Some((base, mask)) = self.bit(&row) else {
            return (0, 0);
        };
        let base = base as u64 * 64 + u64::from(mask.trailing_zeros());
        let (bound, stride) = (self.bounds[column], self.strides[column]);
        let (known, fresh) = (&mut self.known[..], &mut self.fresh[..]);
        let (mut added, mut new) = (0, 0);
        for value in words {
            if value.0 >= bound {
                break;
            }
            let at = base + u64::from(value.0) * stride;
            let (word, mask) = ((at / 64) as usize, 1 << (at % 64));
            if known[word] & mask == 0 {
                known[word] |= mask;
                fresh[word] |= mask;
                new += 1;
            }
            added += 1;
        }
        (added, new)
    }

    /// The number of words of a set of bits for [`SeenBitmap::add_set`]; `None` if rows that differ in this column
    /// do not fill whole words of bits.
    pub(crate) fn set_words(&self, column: usize) -> Option<usize> {
        let (bound, stride) = (self.bounds[column], self.strides[column]);
        (stride == 1 && bound % u64::BITS == 0).then_some((bound / u64::BITS) as usize)
    }

    /// Adds copies of `row` in which the word of `column` is replaced by each element of a set of bits, which has
    /// [`set_words`](SeenBitmap::set_words) words. Returns the number of new rows, or `None` if another word exceeds
    /// its bound. Unless new rows are kept as bits, `new` receives their words in this column.
    pub(crate) fn add_set(
        &mut self,
        mut row: Row<W>,
        column: usize,
        set: &[u64],
        new: &mut Vec<Value>,
    ) -> Option<usize> {
        row.0[column] = Value(0);
        let (base, _) = self.bit(&row)?;
        let known = &mut self.known[base..base + set.len()];
        let mut fresh = self.fresh.get_mut(base..base + set.len());
        let mut count = 0;
        for (at, (known, set)) in known.iter_mut().zip(set).enumerate() {
            let mut added = set & !*known;
            // Frequent where rules derive the same rows many times.
            if added == 0 {
                continue;
            }
            *known |= added;
            count += added.count_ones() as usize;
            match &mut fresh {
                Some(fresh) => fresh[at] |= added,
                None => {
                    while added != 0 {
                        new.push(Value(at as u32 * u64::BITS + added.trailing_zeros()));
                        added &= added - 1;
                    }
                }
            }
        }
        Some(count)
    }

    /// Whether `rows` new rows are better kept as bits than in a list to be sorted.
    pub(crate) fn prefers_bits(&self, rows: usize) -> bool {
        rows / 4 > self.known.len() / 64
    }

    /// Whether new rows are kept as bits.
    pub(crate) fn holds_new(&self) -> bool {
        !self.fresh.is_empty()
    }

    /// Starts to keep new rows as bits. `rows` have been added before and count as new.
    pub(crate) fn hold_new(&mut self, rows: &[Row<W>]) {
        self.fresh = vec![0; self.known.len()];
        for row in rows {
            if let Some((word, mask)) = self.bit(row) {
                self.fresh[word] |= mask;
            }
        }
    }

    /// Takes the `count` new rows, in order, and stops keeping new rows as bits.
    pub(crate) fn drain(&mut self, count: usize) -> Vec<Row<W>> {
        let fresh = std::mem::take(&mut self.fresh);
        self.listed(&fresh, count)
    }

    /// Returns all rows ever added, in order.
    pub(crate) fn all(&self) -> Vec<Row<W>> {
        let count: u32 = self.known.iter().map(|word| word.count_ones()).sum();
        self.listed(&self.known, count as usize)
    }

    /// Returns the `count` rows of a list of bits, in order.
    fn listed(&self, bits: &[u64], count: usize) -> Vec<Row<W>> {
        let mut rows = Vec::with_capacity(count);
        for (position, &word) in (0_u64..).zip(bits) {
            let mut word = word;
            while word != 0 {
                let mut rest = position * 64 + u64::from(word.trailing_zeros());
                word &= word - 1;
                let mut row = Row::ZERO;
                for (column, stride) in self.strides.iter().enumerate() {
                    row.0[column] = Value((rest / stride) as u32);
                    rest %= stride;
                }
                rows.push(row);
            }
        }
        rows
    }
}

/// Raises `largest` to the largest word of the rows in each column.
pub(crate) fn raise<const W: usize>(largest: &mut [u32; W], rows: &[Row<W>]) {
    for row in rows {
        for (largest, word) in largest.iter_mut().zip(&row.0) {
            *largest = word.0.max(*largest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn check<const W: usize>(words: u32) {
        let mut state = 3_u32;
        let mut row = || {
            Row(std::array::from_fn(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                Value((state >> 8) % words)
            }))
        };
        let first: Vec<Row<W>> = (0..20).map(|_| row()).collect();
        let mut seen = SeenBitmap::over(&first, [0; W], 1_000_000).expect("it fits");
        let mut expected: BTreeSet<[u32; W]> = first.iter().map(|row| row.0.map(|word| word.0)).collect();
        for _ in 0..3 {
            let mut fresh = BTreeSet::new();
            seen.hold_new(&[]);
            assert!(seen.holds_new());
            for row in (0..500).map(|_| row()) {
                let plain = row.0.map(|word| word.0);
                match seen.add(&row) {
                    Added::Known => assert!(expected.contains(&plain)),
                    Added::New => assert!(expected.insert(plain) && fresh.insert(plain)),
                    Added::Beyond => assert!(!expected.contains(&plain)),
                }
            }
            for first in 0..words {
                let mut row = Row::ZERO;
                row.0[0] = Value(first);
                let bound = seen.bounds[W - 1];
                let (added, new) = seen.hold_along(row, W - 1, (0..words).map(Value));
                assert!(
                    added
                        == if first < seen.bounds[0] {
                            bound.min(words) as usize
                        } else {
                            0
                        }
                );
                let inserted = (0..added as u32).filter(|&last| {
                    let mut plain = [0; W];
                    (plain[0], plain[W - 1]) = (first, last);
                    expected.insert(plain) && fresh.insert(plain)
                });
                assert_eq!(inserted.count(), new);
            }
            let drained = seen.drain(fresh.len()).into_iter().map(|row| row.0.map(|word| word.0));
            assert!(drained.eq(fresh));
            assert!(!seen.holds_new());
        }
    }

    #[test]
    fn bits_are_a_sorted_set() {
        check::<2>(40);
        check::<3>(15);
        check::<4>(6);
        check::<2>(1);
    }

    #[test]
    fn sparse_rows_have_no_bits() {
        let over = |words: [u32; 2], largest, count| SeenBitmap::over(&[Row(words.map(Value))], largest, count);
        assert!(over([0, u32::MAX], [0, 0], 1000).is_none());
        assert!(over([100_000, 100_000], [0, 0], 1000).is_none());
        assert!(over([100, 100], [100_000, 100_000], 1000).is_none());
        assert!(over([100, 100], [0, 0], 0).is_some_and(|seen| seen.largest() == [125, 125]));
        assert!(over([100, 100], [40, 200], 0).is_some_and(|seen| seen.largest() == [125, 250]));
    }
}
