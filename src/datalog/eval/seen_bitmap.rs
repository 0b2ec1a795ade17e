//! A bitmap of derived rows: one bit for each possible row.
//!
//! Rules often derive the same row many times. Where words are dense, as interned symbols and small numbers are,
//! testing a bit costs much less than sorting repetitions away. The bits of new rows also form a sorted list. Where only
//! some parts of the possible rows are dense, as those of functions in a program are, only their bits are stored.
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
    known: Bits,
    /// The bits of rows added since the last [`SeenBitmap::drain`]; empty while new rows are kept elsewhere.
    fresh: Bits,
}

/// A list of bits in words.
#[derive(Clone, Debug)]
enum Bits {
    All(Vec<u64>),
    Paged(Pages),
}

/// A list of bits of which only the pages with a bit are stored.
#[derive(Clone, Debug)]
struct Pages {
    /// By page: one more than its position in `words`, in pages; 0 if no bit of it is set.
    places: Vec<u32>,
    words: Vec<u64>,
    /// The maximum number of stored pages.
    most: usize,
}

impl Pages {
    /// The number of words of a page.
    const PAGE: usize = 64;

    fn new(words: usize, most: usize) -> Self {
        Pages {
            places: vec![0; words.div_ceil(Self::PAGE)],
            words: Vec::new(),
            most,
        }
    }

    /// Returns a word, of a new page if need be; `None` if that would be a page too many.
    #[inline]
    fn word(&mut self, at: usize) -> Option<&mut u64> {
        let (page, word) = (at / Self::PAGE, at % Self::PAGE);
        let place = match self.places[page] {
            0 => self.add(page)?,
            place => place,
        };
        Some(&mut self.words[(place as usize - 1) * Self::PAGE + word])
    }

    #[cold]
    fn add(&mut self, page: usize) -> Option<u32> {
        let count = self.words.len() / Self::PAGE;
        if count >= self.most {
            return None;
        }
        self.words.resize(self.words.len() + Self::PAGE, 0);
        self.places[page] = u32::try_from(count + 1).ok()?;
        Some(self.places[page])
    }
}

impl Bits {
    const NONE: Bits = Bits::All(Vec::new());

    /// The same number of bits, none of which is set.
    fn cleared(&self) -> Bits {
        match self {
            Bits::All(words) => Bits::All(vec![0; words.len()]),
            Bits::Paged(pages) => Bits::Paged(Pages {
                places: vec![0; pages.places.len()],
                words: Vec::new(),
                most: pages.most,
            }),
        }
    }

    fn is_empty(&self) -> bool {
        match self {
            Bits::All(words) => words.is_empty(),
            Bits::Paged(pages) => pages.places.is_empty(),
        }
    }

    /// The number of stored words, and the bytes of all.
    fn stored(&self) -> (usize, usize) {
        match self {
            Bits::All(words) => (words.len(), size_of_val(&words[..])),
            Bits::Paged(Pages { places, words, .. }) => {
                (words.len(), size_of_val(&words[..]) + size_of_val(&places[..]))
            }
        }
    }

    /// Sets the bits of a mask in a word. Returns those that were not set; `None` if the word cannot be stored.
    #[inline]
    fn set(&mut self, at: usize, mask: u64) -> Option<u64> {
        let word = match self {
            Bits::All(words) => &mut words[at],
            Bits::Paged(pages) => pages.word(at)?,
        };
        let added = mask & !*word;
        *word |= mask;
        Some(added)
    }

    /// The words with their positions, in order, but for some that are 0.
    fn words(&self) -> impl Iterator<Item = (usize, u64)> {
        let (all, pages) = match self {
            Bits::All(words) => (&words[..], None),
            Bits::Paged(pages) => (&[][..], Some(pages)),
        };
        let stored = pages.into_iter().flat_map(|pages| {
            let places = pages.places.iter().enumerate().filter(|(_, place)| **place > 0);
            places.flat_map(|(page, &place)| {
                let words = pages.words[(place as usize - 1) * Pages::PAGE..]
                    .iter()
                    .take(Pages::PAGE);
                words
                    .enumerate()
                    .map(move |(at, word)| (page * Pages::PAGE + at, *word))
            })
        });
        all.iter().copied().enumerate().chain(stored)
    }
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

    /// Bits are stored by pages if a page has at least this number of rows on average. If all bits fit into memory, they
    /// must also take this size in bytes, and the pages must be a small part of all.
    const PAGE_ROWS: usize = 16;
    const PAGED_MIN: u64 = 1 << 24;
    const PAGE_PARTS: usize = 16;

    /// Makes a set of these rows. Its bounds leave room above the words of `rows` and `largest`. Returns `None` if it
    /// would take more memory than `count` rows and either the rows are scattered or their pages could take more than
    /// `most` rows.
    pub(crate) fn over(rows: &[Row<W>], mut largest: [u32; W], count: u64, most: u64) -> Option<Self> {
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
            known: Bits::NONE,
            fresh: Bits::NONE,
        };
        let fits = bits / 8 <= bytes(count).max(Self::BYTES_FREE);
        if !fits || bits / 8 >= Self::PAGED_MIN {
            // Known and new rows have a list of places each, and their pages.
            let page = (Pages::PAGE * size_of::<u64>()) as u64;
            let pages = words.div_ceil(Pages::PAGE);
            let places = 2 * (pages * size_of::<u32>()) as u64;
            let left = bytes(most).saturating_sub(places);
            let first = rows.len() / Self::PAGE_ROWS;
            let few = if fits {
                first.min(pages / Self::PAGE_PARTS)
            } else {
                first
            };
            let most = usize::try_from(left / (2 * page)).ok()?;
            if places <= bytes(count) {
                seen.known = Bits::Paged(Pages::new(words, most.min(few)));
                if rows.iter().all(|row| seen.add(row) != Added::Beyond) {
                    if let Bits::Paged(pages) = &mut seen.known {
                        pages.most = most;
                    }
                    return Some(seen);
                }
            }
        }
        if !fits {
            return None;
        }
        seen.known = Bits::All(vec![0; words]);
        rows.iter().for_each(|row| _ = seen.add(row));
        Some(seen)
    }

    /// Makes a set with the same bounds and known rows that keeps new rows as bits. Bits are also faster where most
    /// rows are known.
    pub(crate) fn fork(&self) -> Self {
        SeenBitmap {
            known: self.known.clone(),
            fresh: self.known.cleared(),
            ..*self
        }
    }

    /// Indexed by column: the largest word that fits.
    pub(crate) fn largest(&self) -> [u32; W] {
        self.bounds.map(|bound| bound - 1)
    }

    /// The bytes of the bits of all rows.
    pub(crate) fn bytes(&self) -> usize {
        self.known.stored().1
    }

    /// Whether both sets have the same bounds and can be joined.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let all = |seen: &Self| matches!(seen.known, Bits::All(_));
        self.bounds == other.bounds && all(self) && all(other)
    }

    /// Adds the new rows of a set with the same bounds; both sets must keep new rows as bits. Returns the number of
    /// rows that are new here.
    pub(crate) fn absorb(&mut self, other: &Self) -> usize {
        let mut new = 0;
        if let (Bits::All(known), Bits::All(fresh), Bits::All(other)) = (&mut self.known, &mut self.fresh, &other.fresh)
        {
            for ((known, fresh), other) in known.iter_mut().zip(fresh).zip(other) {
                let added = other & !*known;
                *known |= added;
                *fresh |= added;
                new += added.count_ones() as usize;
            }
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
        let held = !self.fresh.is_empty();
        match &mut self.known {
            Bits::All(known) => {
                if known[word] & mask != 0 {
                    return Added::Known;
                }
                known[word] |= mask;
            }
            Bits::Paged(pages) => match pages.word(word) {
                None => return Added::Beyond,
                Some(known) if *known & mask != 0 => return Added::Known,
                Some(known) => *known |= mask,
            },
        }
        // Both lists may have as many pages, and new rows are known.
        if held {
            self.fresh.set(word, mask);
        }
        Added::New
    }

    /// Adds a row without marking it as new. Returns whether it fits.
    pub(crate) fn mark(&mut self, row: &Row<W>) -> bool {
        let bit = self.bit(row);
        bit.is_some_and(|(word, mask)| self.known.set(word, mask).is_some())
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
        let (mut added, mut new) = (0, 0);
        let places = words.take_while(|value| value.0 < bound).map(|value| {
            let at = base + u64::from(value.0) * stride;
            ((at / 64) as usize, 1 << (at % 64))
        });
        match (&mut self.known, &mut self.fresh) {
            (Bits::All(known), Bits::All(fresh)) => {
                let (known, fresh) = (&mut known[..], &mut fresh[..]);
                for (word, mask) in places {
                    if known[word] & mask == 0 {
                        known[word] |= mask;
                        fresh[word] |= mask;
                        new += 1;
                    }
                    added += 1;
                }
            }
            (Bits::Paged(known), fresh) => {
                for (word, mask) in places {
                    let Some(known) = known.word(word) else { break };
                    if *known & mask == 0 {
                        *known |= mask;
                        fresh.set(word, mask);
                        new += 1;
                    }
                    added += 1;
                }
            }
            // New rows are stored in the same way.
            (Bits::All(_), Bits::Paged(_)) => {}
        }
        (added, new)
    }

    /// The number of words of a set of bits for [`SeenBitmap::add_set`]; `None` if rows that differ in this column
    /// do not fill whole words of bits.
    pub(crate) fn set_words(&self, column: usize) -> Option<usize> {
        let (bound, stride) = (self.bounds[column], self.strides[column]);
        let all = matches!(self.known, Bits::All(_));
        (all && stride == 1 && bound % u64::BITS == 0).then_some((bound / u64::BITS) as usize)
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
        let (Bits::All(known), Bits::All(fresh)) = (&mut self.known, &mut self.fresh) else {
            return None;
        };
        let known = &mut known[base..base + set.len()];
        let mut fresh = fresh.get_mut(base..base + set.len());
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
        rows / 4 > self.known.stored().0 / 64
    }

    /// Whether new rows are kept as bits.
    pub(crate) fn holds_new(&self) -> bool {
        !self.fresh.is_empty()
    }

    /// Starts to keep new rows as bits. `rows` have been added before and count as new.
    pub(crate) fn hold_new(&mut self, rows: &[Row<W>]) {
        self.fresh = self.known.cleared();
        for row in rows {
            if let Some((word, mask)) = self.bit(row) {
                self.fresh.set(word, mask);
            }
        }
    }

    /// Takes the `count` new rows, in order, and stops keeping new rows as bits.
    pub(crate) fn drain(&mut self, count: usize) -> Vec<Row<W>> {
        let fresh = std::mem::replace(&mut self.fresh, Bits::NONE);
        self.listed(&fresh, count)
    }

    /// Returns all rows ever added, in order.
    pub(crate) fn all(&self) -> Vec<Row<W>> {
        let count: u32 = self.known.words().map(|(_, word)| word.count_ones()).sum();
        self.listed(&self.known, count as usize)
    }

    /// Returns the `count` rows of a list of bits, in order.
    fn listed(&self, bits: &Bits, count: usize) -> Vec<Row<W>> {
        let mut rows = Vec::with_capacity(count);
        for (position, word) in bits.words() {
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
        assert!(matches!(all.known, Bits::All(_)));
        // With pages, too.
        let Bits::All(bits) = &all.known else { panic!("bits") };
        let mut paged = SeenBitmap {
            bounds: all.bounds,
            strides: all.strides,
            known: Bits::Paged(Pages::new(bits.len(), usize::MAX)),
            fresh: Bits::NONE,
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

    /// Rows of clusters are stored by pages, up to a number of them.
    #[test]
    fn clusters_have_pages() {
        let cluster = |number: u32| {
            (0..2_500).map(move |at| Row([Value(number * 1_000 + at / 50), Value(number * 1_000 + at % 50)]))
        };
        let rows: Vec<Row<2>> = (0..60).step_by(2).flat_map(cluster).collect();
        let over = |most| SeenBitmap::over(&rows, [0; 2], 2_000_000, most);
        let mut seen = over(2_000_000).expect("few pages");
        assert!(seen.bytes() < 8_000_000);
        seen.hold_new(&[]);
        assert!(rows.iter().all(|row| seen.add(row) == Added::Known));
        let mut new: Vec<Row<2>> = cluster(1).collect();
        assert!(new.iter().all(|row| seen.add(row) == Added::New));
        new.sort_unstable();
        assert_eq!(seen.drain(new.len()), new);
        let (known, forked) = (seen.all().len(), seen.fork());
        assert_eq!((known, forked.all().len()), (31 * 2_500, 31 * 2_500));
        // Pages for the rows, and not for those of other clusters.
        let Bits::Paged(Pages { places, words, .. }) = &seen.known else {
            panic!("pages")
        };
        let most = 2 * (size_of_val(&words[..]) + size_of_val(&places[..])) / size_of::<Row<2>>();
        let mut seen = over(most as u64).expect("enough pages");
        let places: Vec<Added> = (1..60).step_by(2).flat_map(cluster).map(|row| seen.add(&row)).collect();
        assert!(places.contains(&Added::Beyond) && !places.contains(&Added::Known));
        let row = Row([Value(1_000), Value(0)]);
        seen.hold_new(&[]);
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
