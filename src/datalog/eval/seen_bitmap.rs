//! A bitmap of derived rows: one bit for each possible row.
//!
//! Rules often derive the same row many times. Where words are dense, as interned symbols and small numbers are,
//! testing a bit costs much less than sorting repetitions away. The bits of new rows also form a sorted list. If rows
//! form dense clusters, such as one for each function of a program, only the pages of bits with a row are stored.
// Decision: docs/decisions/evaluation.md#d018

use crate::eval::pages::{Paged, Pages};
use crate::row::Row;
use crate::value::Value;

/// A set of rows whose words are below fixed bounds.
#[derive(Debug)]
pub(crate) struct SeenBitmap<const W: usize> {
    /// Indexed by column: the exclusive upper bound of the words.
    bounds: [u32; W],
    /// Indexed by column: the distance between the bits of consecutive words.
    strides: [u64; W],
    /// The bits of all rows ever added; empty if they are stored by pages.
    known: Vec<u64>,
    /// The bits of rows added since the last [`SeenBitmap::drain`]; empty while new rows are kept elsewhere.
    fresh: Vec<u64>,
    pages: Option<Box<Paged>>,
    /// Whether new rows are kept as bits.
    holds_new: bool,
}

/// The result of adding a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Added {
    /// The set already had the row.
    Known,
    /// The row is new.
    New,
    /// A word exceeds its bound, or no page is left for the row.
    Beyond,
}

impl<const W: usize> SeenBitmap<W> {
    /// The size in bytes that a set may have regardless of the number of rows.
    const BYTES_FREE: u64 = 1 << 13;

    /// From this bound on, the words of the last column fill whole words of bits, so that [`SeenBitmap::add_set`] can
    /// add many rows at once.
    const ALIGNED_MIN: u32 = 512;

    /// The size in bytes of all bits from which on they may be stored by pages.
    const PAGED_MIN: u64 = 1 << 26;

    /// The minimum number of rows of a page, on average, when the set is made.
    const PAGE_ROWS: usize = 16;

    /// If all bits may fit later, at most one page in this number is stored when the set is made. Dense pages are no
    /// reason to do without [`SeenBitmap::add_set`].
    const PAGE_PARTS: usize = 16;

    /// Makes a set of these rows. Its bounds leave room above the words of `rows` and `largest`. Returns `None` if
    /// neither all bits nor pages fit. All bits may take the memory of `count` rows, pages that of `rows_max` rows.
    pub(crate) fn over(rows: &[Row<W>], mut largest: [u32; W], count: u64, rows_max: u64) -> Option<Self> {
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
        let bytes = |rows: u64| rows.saturating_mul(size_of::<Row<W>>() as u64);
        let words = usize::try_from(bits.div_ceil(64)).ok()?;
        let mut seen = SeenBitmap {
            bounds,
            strides,
            known: Vec::new(),
            fresh: Vec::new(),
            pages: None,
            holds_new: false,
        };
        let fits = bits / 8 <= bytes(count).max(Self::BYTES_FREE);
        if bits / 8 >= Self::PAGED_MIN {
            // Both lists, of known and of new rows, have places and pages.
            let page = (Pages::PAGE * size_of::<u64>()) as u64;
            let pages = words.div_ceil(Pages::PAGE);
            let places = 2 * (pages * size_of::<u32>()) as u64;
            // A list that grows is copied.
            let pages_max = usize::try_from(bytes(rows_max).saturating_sub(places) / (3 * page)).ok()?;
            let dense_pages = (rows.len() / Self::PAGE_ROWS).min(pages_max);
            let first_pages = match bits / 8 <= bytes(rows_max) {
                true => dense_pages.min(pages / Self::PAGE_PARTS),
                false => dense_pages,
            };
            if places <= bytes(count) {
                let known = Pages::new(words, first_pages);
                let fresh = Pages::new(words, pages_max);
                let mut paged = Box::new(Paged { known, fresh });
                let added = rows.iter().map(|row| paged.add(seen.bit(row)?, false).map(usize::from));
                // The rows may repeat.
                let distinct = added.sum::<Option<usize>>();
                if distinct.is_some_and(|distinct| distinct >= paged.known.stored() * Self::PAGE_ROWS) {
                    paged.known.pages_max = pages_max;
                    seen.pages = Some(paged);
                    return Some(seen);
                }
            }
        }
        if !fits {
            return None;
        }
        seen.known = vec![0; words];
        rows.iter().for_each(|row| _ = seen.add(row));
        Some(seen)
    }

    /// Makes a set with the same bounds and known rows that keeps new rows as bits. Bits are also faster where most
    /// rows are known. `count` forks may store as many more pages as this set.
    pub(crate) fn fork(&self, count: usize) -> Self {
        SeenBitmap {
            known: self.known.clone(),
            fresh: vec![0; self.known.len()],
            pages: self.pages.clone().map(|mut paged| {
                let stored = paged.known.stored();
                paged.known.pages_max = stored + (paged.known.pages_max - stored) / count;
                paged.fresh = paged.known.cleared();
                paged
            }),
            holds_new: true,
            ..*self
        }
    }

    /// Indexed by column: the largest word that fits.
    pub(crate) fn largest(&self) -> [u32; W] {
        self.bounds.map(|bound| bound - 1)
    }

    /// The bytes of the bits of all rows.
    pub(crate) fn bytes(&self) -> usize {
        let paged = |paged: &Paged| paged.known.bytes() + paged.fresh.bytes();
        self.pages.as_deref().map_or(size_of_val(&self.known[..]), paged)
    }

    /// Whether both sets have the same bounds and can be joined.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        self.bounds == other.bounds && self.pages.is_none() && other.pages.is_none()
    }

    /// Adds the new rows of a set that is [like](SeenBitmap::is_like) this one; both must keep new rows as bits.
    /// Returns the number of rows that are new here.
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
        let Some(known) = self.known.get_mut(word) else {
            return self.add_to_page((word, mask));
        };
        if *known & mask != 0 {
            return Added::Known;
        }
        *known |= mask;
        if let Some(fresh) = self.fresh.get_mut(word) {
            *fresh |= mask;
        }
        Added::New
    }

    #[cold]
    #[inline(never)]
    fn add_to_page(&mut self, bit: (usize, u64)) -> Added {
        let held = self.holds_new;
        match self.pages.as_mut().and_then(|paged| paged.add(bit, held)) {
            Some(true) => Added::New,
            Some(false) => Added::Known,
            None => Added::Beyond,
        }
    }

    /// Adds a row without marking it as new. Returns whether it fits.
    pub(crate) fn mark(&mut self, row: &Row<W>) -> bool {
        let Some((word, mask)) = self.bit(row) else {
            return false;
        };
        match self.known.get_mut(word) {
            Some(known) => *known |= mask,
            None => return (self.pages.as_mut()).is_some_and(|paged| paged.add((word, mask), false).is_some()),
        }
        true
    }

    /// Adds copies of `row` in which one word is replaced; the set must keep new rows as bits. Stops at the first row
    /// that does not fit. Returns the number of rows added and how many of them are new.
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
        let (mut added, mut new) = (0, 0);
        if let Some(paged) = &mut self.pages {
            for value in words {
                let at = base + u64::from(value.0) * stride;
                let fits = value.0 < bound;
                let bit = fits.then(|| paged.add(((at / 64) as usize, 1 << (at % 64)), true));
                let Some(is_new) = bit.flatten() else { break };
                new += usize::from(is_new);
                added += 1;
            }
            return (added, new);
        }
        let (known, fresh) = (&mut self.known[..], &mut self.fresh[..]);
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
        (self.pages.is_none() && stride == 1 && bound % u64::BITS == 0).then_some((bound / u64::BITS) as usize)
    }

    /// Adds copies of `row` in which the word of `column` is replaced by each element of a set of bits, which has
    /// [`set_words`](SeenBitmap::set_words) words. Returns the number of new rows, or `None` if another word exceeds
    /// its bound or bits are stored by pages. Unless new rows are kept as bits, `new` receives their words in this
    /// column.
    pub(crate) fn add_set(
        &mut self,
        mut row: Row<W>,
        column: usize,
        set: &[u64],
        new: &mut Vec<Value>,
    ) -> Option<usize> {
        row.0[column] = Value(0);
        let (base, _) = self.bit(&row)?;
        // There is no such word if bits are stored by pages.
        let known = self.known.get_mut(base..base + set.len())?;
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
        let paged = |paged: &Paged| paged.known.stored() * Pages::PAGE;
        rows / 4 > self.pages.as_deref().map_or(self.known.len(), paged) / 64
    }

    /// Whether new rows are kept as bits.
    pub(crate) fn holds_new(&self) -> bool {
        self.holds_new
    }

    /// Starts to keep new rows as bits. `rows` have been added before and count as new.
    pub(crate) fn hold_new(&mut self, rows: &[Row<W>]) {
        self.fresh = vec![0; self.known.len()];
        self.holds_new = true;
        for row in rows {
            let Some((word, mask)) = self.bit(row) else { continue };
            let fresh = match &mut self.pages {
                Some(paged) => paged.fresh.word(word),
                None => self.fresh.get_mut(word),
            };
            if let Some(fresh) = fresh {
                *fresh |= mask;
            }
        }
    }

    /// Takes the `count` new rows, in order, and stops keeping new rows as bits.
    pub(crate) fn drain(&mut self, count: usize) -> Vec<Row<W>> {
        self.holds_new = false;
        let fresh = std::mem::take(&mut self.fresh);
        match &mut self.pages {
            Some(paged) => {
                let cleared = paged.fresh.cleared();
                let fresh = std::mem::replace(&mut paged.fresh, cleared);
                self.listed(fresh.words(), count)
            }
            None => self.listed(fresh.into_iter().enumerate(), count),
        }
    }

    /// Returns all rows ever added, in order.
    pub(crate) fn all(&self) -> Vec<Row<W>> {
        match &self.pages {
            Some(paged) => self.listed(paged.known.words(), ones(paged.known.words())),
            None => {
                let words = || self.known.iter().copied().enumerate();
                self.listed(words(), ones(words()))
            }
        }
    }

    /// Returns the `count` rows of the words of a list of bits, in order.
    fn listed(&self, words: impl Iterator<Item = (usize, u64)>, count: usize) -> Vec<Row<W>> {
        let mut rows = Vec::with_capacity(count);
        for (position, word) in words {
            let mut word = word;
            while word != 0 {
                let mut rest = position as u64 * 64 + u64::from(word.trailing_zeros());
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

/// The number of bits of words with their positions.
fn ones(words: impl Iterator<Item = (usize, u64)>) -> usize {
    words.map(|(_, word)| word.count_ones() as usize).sum()
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
        let all = SeenBitmap::over(&first, [0; W], 1_000_000, 0).expect("it fits");
        assert!(all.pages.is_none());
        // The same rows in pages.
        let pages = || Pages::new(all.known.len(), usize::MAX);
        let mut paged = SeenBitmap {
            known: Vec::new(),
            fresh: Vec::new(),
            pages: Some(Box::new(Paged {
                known: pages(),
                fresh: pages(),
            })),
            ..all
        };
        assert!(first.iter().all(|row| paged.mark(row)));
        check_set(all, &first, words, &mut row);
        check_set(paged, &first, words, &mut row);
    }

    fn check_set<const W: usize>(
        mut seen: SeenBitmap<W>,
        first: &[Row<W>],
        words: u32,
        mut row: impl FnMut() -> Row<W>,
    ) {
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
        let all = seen.all().into_iter().map(|row| row.0.map(|word| word.0));
        assert!(all.eq(expected));
    }

    /// Clustered rows are stored by pages, up to a limit.
    #[test]
    fn clusters_have_pages() {
        let cluster = |number: u32| {
            (0..2_500).map(move |at| Row([Value(number * 1_000 + at / 50), Value(number * 1_000 + at % 50)]))
        };
        let rows: Vec<Row<2>> = (0..60).step_by(2).flat_map(cluster).collect();
        let over = |most| SeenBitmap::over(&rows, [0; 2], 2_000_000, most);
        let mut seen = over(2_000_000).expect("few pages");
        assert!(seen.bytes() < 16_000_000);
        seen.hold_new(&[]);
        assert!(rows.iter().all(|row| seen.add(row) == Added::Known));
        let mut new: Vec<Row<2>> = cluster(1).collect();
        assert!(new.iter().all(|row| seen.add(row) == Added::New));
        new.sort_unstable();
        assert_eq!(seen.drain(new.len()), new);
        let (known, forked) = (seen.all().len(), seen.fork(1));
        assert_eq!((known, forked.all().len()), (31 * 2_500, 31 * 2_500));
        // The limit admits these clusters and no others.
        let known = &seen.pages.as_deref().expect("pages").known;
        let stored = known.stored() * Pages::PAGE * size_of::<u64>();
        let rows_max = (3 * stored + 2 * (known.bytes() - stored)) / size_of::<Row<2>>();
        let mut seen = over(rows_max as u64).expect("enough pages");
        let places: Vec<Added> = (1..60).step_by(2).flat_map(cluster).map(|row| seen.add(&row)).collect();
        assert!(places.contains(&Added::Beyond) && !places.contains(&Added::Known));
        let row = Row([Value(1_000), Value(0)]);
        seen.hold_new(&[]);
        assert_eq!(
            (seen.set_words(1), seen.add_set(row, 1, &[1], &mut Vec::new())),
            (None, None)
        );
        let (added, new) = seen.hold_along(row, 1, (0..75_000).map(Value));
        assert!(added < 75_000 && new <= added);
        assert!(over(1_000).is_none());
        let scattered: Vec<Row<2>> = (0..60_000)
            .map(|at: u32| Row([Value(at), Value(at.wrapping_mul(7_919) % 60_000)]))
            .collect();
        assert!(SeenBitmap::over(&scattered, [0; 2], 60_000, 1 << 30).is_none());
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
        let over =
            |words: [u32; 2], largest, count| SeenBitmap::over(&[Row(words.map(Value))], largest, count, 1_000_000);
        assert!(over([0, u32::MAX], [0, 0], 1000).is_none());
        assert!(over([100_000, 100_000], [0, 0], 1000).is_none());
        assert!(over([100, 100], [100_000, 100_000], 1000).is_none());
        assert!(over([100, 100], [0, 0], 0).is_some_and(|seen| seen.largest() == [125, 125]));
        assert!(over([100, 100], [40, 200], 0).is_some_and(|seen| seen.largest() == [125, 250]));
    }
}
