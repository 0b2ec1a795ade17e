//! The buffer that receives the rows of a plan.

use crate::eval::groups::Groups;
use crate::eval::seen_bitmap::{Added, SeenBitmap, raise};
use crate::plan::steps::Plan;
use crate::row::{Row, difference, normalize};
use crate::symbol::Symbols;
use crate::value::Value;

/// A buffer for derived rows. It may hold repetitions.
///
/// Its memory is bounded. Where words are dense, a [`SeenBitmap`] marks rows and filters repetitions. Elsewhere, the
/// buffer sorts its rows when there are many and drops repetitions.
#[derive(Debug)]
pub(crate) struct Output<const W: usize> {
    rows: Vec<Row<W>>,
    /// The number of rows ever pushed.
    pub(crate) pushed: u64,
    /// If present, contains everything in `rows`.
    seen: Option<SeenBitmap<W>>,
    /// Whether `seen`, if present, holds all rows ever pushed.
    seen_has_all: bool,
    /// Whether rows have been taken.
    has_taken: bool,
    /// Indexed by column: the largest word of the rows taken.
    largest: [u32; W],
    /// Whether `seen` lacks only rows that were taken. [`Output::mark_taken`] can add these.
    lacks_taken: bool,
    /// Whether `seen` is the only record of the rows taken; see [`Output::keep_record`].
    seen_is_record: bool,
    /// If so, and `seen` was dropped: the rows taken before that.
    record: Vec<Row<W>>,
    /// The number of new rows that `seen` holds in place of `rows`.
    in_seen: usize,
    /// The number of rows at which `reorganize` reorganizes the buffer.
    reorganize_at: usize,
    compact_at: usize,
    limit: usize,
    /// The maximum number of distinct rows that memory allows.
    memory_max: usize,
    /// The lesser of `limit` and `memory_max`.
    rows_max: usize,
    /// The result of a plan with a fold, which derives no rows.
    groups: Option<Box<Groups<W>>>,
    /// Scratch memory of [`Output::push_set`].
    values: Vec<Value>,
}

/// The reason why an evaluation was abandoned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Abort {
    /// The clauses derived more distinct rows than allowed.
    Overflow,
    /// The plans scanned more rows than allowed.
    Budget,
    /// Rows, indexes or symbols take more memory than allowed.
    Memory,
    /// The caller cancelled it.
    Cancelled,
    /// A user-defined functor failed.
    Functor,
}

impl<const W: usize> Output<W> {
    /// The number of buffered words (128 MiB) at which the buffer removes repetitions.
    const COMPACT_WORDS: usize = 1 << 25;

    /// The minimum number of rows before the buffer considers a bitmap.
    const SEEN_MIN: usize = 256;

    /// Distinct rows may take 3/4 of the memory. The rest is for a bitmap and for repetitions, so that the buffer is
    /// not sorted for every few rows.
    const MEMORY_PARTS: usize = 4;

    /// Unused memory at the end of a list is freed from this size on. Freeing less costs more than it saves.
    const SLACK_BYTES: usize = 1 << 20;

    /// Limits a bitmap to 1 GiB, the memory of this number of rows.
    const SEEN_ROWS_MAX: u64 = (1 << 30) / size_of::<Row<W>>() as u64;

    /// An empty buffer that accepts at most `limit` distinct rows.
    pub(crate) fn new(limit: usize) -> Self {
        let compact_at = (Self::COMPACT_WORDS / W).min(limit.saturating_add(1));
        Output {
            rows: Vec::new(),
            pushed: 0,
            seen: None,
            seen_has_all: true,
            has_taken: false,
            largest: [0; W],
            lacks_taken: false,
            seen_is_record: false,
            record: Vec::new(),
            in_seen: 0,
            reorganize_at: compact_at.min(Self::SEEN_MIN),
            compact_at,
            limit,
            memory_max: usize::MAX,
            rows_max: limit,
            groups: None,
            values: Vec::new(),
        }
    }

    /// Limits the memory of the buffer.
    pub(crate) fn set_bytes(&mut self, bytes: u64) {
        let rows = usize::try_from(bytes / size_of::<Row<W>>() as u64).unwrap_or(usize::MAX);
        self.set_memory_max(rows / Self::MEMORY_PARTS * (Self::MEMORY_PARTS - 1));
    }

    fn set_memory_max(&mut self, rows: usize) {
        self.memory_max = rows;
        self.rows_max = rows.min(self.limit);
        self.compact_at = self.compact_at.min(self.buffer_max());
        self.reorganize_at = self.reorganize_at.min(self.compact_at);
    }

    /// The maximum number of rows in the list, repetitions included.
    fn buffer_max(&self) -> usize {
        let repeated = self.rows_max / (Self::MEMORY_PARTS - 1);
        self.rows_max.saturating_add(repeated).saturating_add(1)
    }

    /// Fails if there are too many distinct rows.
    #[inline]
    pub(crate) fn check(&self, rows: usize) -> Result<(), Abort> {
        if rows <= self.rows_max {
            return Ok(());
        }
        Err(if rows > self.limit {
            Abort::Overflow
        } else {
            Abort::Memory
        })
    }

    /// An empty buffer for the output of a plan; it accepts at most `limit` distinct rows.
    pub(crate) fn for_plan(plan: &Plan, limit: usize) -> Self {
        let groups = |fold| Box::new(Groups::new(fold, plan.output.len()));
        Output {
            groups: plan.fold.map(groups),
            ..Self::new(limit)
        }
    }

    /// A buffer that holds these distinct rows.
    pub(crate) fn of(rows: Vec<Row<W>>, limit: usize) -> Self {
        Output {
            rows,
            ..Self::new(limit)
        }
    }

    /// Makes an empty buffer for one of `count` parts of the rows. It filters rows that this one knows. Together, the
    /// parts need no more memory than this buffer has left for them and for its own copy of their rows.
    pub(crate) fn fork(&self, count: usize) -> Self {
        let mut fork = Output {
            seen: self.seen.as_ref().map(|seen| seen.fork(count)),
            groups: self.groups.as_ref().map(|groups| Box::new(groups.fork())),
            ..Self::new(self.limit / count)
        };
        if self.memory_max < usize::MAX {
            fork.set_memory_max(self.memory_max.saturating_sub(self.rows.len()) / (2 * count));
        }
        fork
    }

    /// Whether the bitmaps of `count` forks fit into memory.
    pub(crate) fn can_fork(&self, count: usize) -> bool {
        self.seen_bytes() / size_of::<Row<W>>() * 2 * count <= self.memory_max / 4
    }

    /// The bytes of the bitmap of known rows.
    pub(crate) fn seen_bytes(&self) -> usize {
        self.seen.as_ref().map_or(0, SeenBitmap::bytes)
    }

    /// Adds the rows of a fork.
    pub(crate) fn absorb(&mut self, mut fork: Self, symbols: &Symbols) -> Result<(), Abort> {
        let pushed = self.pushed + fork.pushed;
        self.pushed = pushed;
        if let (Some(groups), Some(other)) = (&mut self.groups, fork.groups.take()) {
            groups.merge(*other, symbols);
            let rows = groups.rows();
            return self.check(rows);
        }
        if let (Some(seen), Some(other)) = (&mut self.seen, &fork.seen)
            && other.holds_new()
            && seen.is_like(other)
        {
            if !seen.holds_new() {
                seen.hold_new(&self.rows);
                self.in_seen = std::mem::take(&mut self.rows).len();
            }
            self.in_seen += seen.absorb(other);
            return self.check(self.in_seen);
        }
        let rows = fork.take();
        if self.seen.is_none() {
            self.rows.try_reserve_exact(rows.len()).map_err(|_| Abort::Memory)?;
            self.rows.extend_from_slice(&rows);
            drop(rows);
            // A stable sort merges sorted runs, such as those of several forks, in linear time.
            self.rows.sort();
            self.rows.dedup();
            return if self.rows.len() >= self.reorganize_at {
                self.reorganize()
            } else {
                Ok(())
            };
        }
        for row in rows {
            self.push(row)?;
        }
        self.pushed = pushed;
        Ok(())
    }

    /// Sorts the rows if they are in a list.
    pub(crate) fn settle(&mut self) {
        normalize(&mut self.rows);
    }

    /// Whether the buffer is empty.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty() && self.in_seen == 0 && self.groups.as_ref().is_none_or(|groups| groups.len() == 0)
    }

    /// Adds `times` matches with this key and value; `times` is 1 unless the aggregate is a count.
    #[inline]
    pub(super) fn fold(
        &mut self,
        key: Row<W>,
        value: Option<Value>,
        times: u64,
        symbols: &Symbols,
    ) -> Result<(), Abort> {
        self.pushed += times;
        let Some(groups) = &mut self.groups else { return Ok(()) };
        match value {
            Some(value) => groups.add(key, value, symbols),
            None => groups.count(key, times),
        }
        let rows = groups.rows();
        self.check(rows)
    }

    #[inline]
    pub(super) fn push(&mut self, row: Row<W>) -> Result<(), Abort> {
        self.pushed += 1;
        if let Some(seen) = &mut self.seen {
            match seen.add(&row) {
                Added::Known => return Ok(()),
                Added::New if seen.holds_new() => {
                    self.in_seen += 1;
                    return self.check(self.in_seen);
                }
                Added::New => {}
                Added::Beyond => self.unmark(),
            }
        }
        self.rows.push(row);
        if self.rows.len() >= self.reorganize_at {
            self.reorganize()
        } else {
            Ok(())
        }
    }

    /// Pushes copies of `row` in which one word is replaced by a column of the rows found.
    #[inline(always)]
    pub(super) fn push_along<const V: usize>(
        &mut self,
        mut row: Row<W>,
        word: usize,
        found: &[Row<V>],
        column: usize,
    ) -> Result<(), Abort> {
        let mut rest = found;
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.holds_new()) {
            let (added, new) = seen.hold_along(row, word, found.iter().map(|other| other.0[column]));
            self.pushed += added as u64;
            self.in_seen += new;
            self.check(self.in_seen)?;
            rest = &found[added..];
        }
        for other in rest {
            row.0[word] = other.0[column];
            self.push(row)?;
        }
        Ok(())
    }

    /// The number of words of a set of bits for [`Output::push_set`], and the most words that all sets may take; `None`
    /// if the buffer takes no sets in this column.
    pub(super) fn set_words(&self, column: usize) -> Option<(usize, usize)> {
        let seen = self.seen.as_ref()?;
        let fit = (self.memory_max / 12).saturating_mul(size_of::<Row<W>>());
        let most = seen.bytes().min(fit) / size_of::<u64>();
        Some((seen.set_words(column)?, most))
    }

    /// Pushes copies of `row` in which one word is replaced by each of the `count` elements of a set. Returns whether
    /// they fit.
    pub(super) fn push_set(&mut self, mut row: Row<W>, word: usize, set: &[u64], count: usize) -> Result<bool, Abort> {
        let Some(seen) = &mut self.seen else { return Ok(false) };
        let Some(new) = seen.add_set(row, word, set, &mut self.values) else {
            return Ok(false);
        };
        self.pushed += count as u64;
        if self.values.is_empty() {
            self.in_seen += new;
            self.check(self.in_seen)?;
            return Ok(true);
        }
        self.rows.try_reserve(new).map_err(|_| Abort::Memory)?;
        self.rows.extend(self.values.drain(..).map(|value| {
            row.0[word] = value;
            row
        }));
        if self.rows.len() >= self.reorganize_at {
            self.reorganize()?;
        }
        Ok(true)
    }

    /// Replaces the bitmap by a plain list.
    #[cold]
    fn unmark(&mut self) {
        if let Some(mut seen) = self.seen.take() {
            self.largest = seen.largest();
            let all = if self.seen_is_record { seen.all() } else { Vec::new() };
            if seen.holds_new() {
                self.rows = seen.drain(std::mem::take(&mut self.in_seen));
            } else if self.seen_is_record {
                normalize(&mut self.rows);
            }
            self.record = difference(&all, &self.rows);
        }
        self.seen_is_record = false;
        // Reconsider a bitmap only after more rows.
        self.reorganize_at = (self.rows.len() + Self::SEEN_MIN).min(self.compact_at);
    }

    /// Chooses the better representation of the rows.
    #[cold]
    fn reorganize(&mut self) -> Result<(), Abort> {
        if self.seen.is_none() {
            let rows_max = Self::SEEN_ROWS_MAX.min(self.memory_max as u64 / 6);
            self.seen = SeenBitmap::over(&self.rows, self.largest, self.pushed.min(rows_max), rows_max);
            if self.seen.is_some() {
                self.seen_has_all = !self.has_taken;
                self.lacks_taken = self.has_taken;
                normalize(&mut self.rows);
            }
        }
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.prefers_bits(self.rows.len())) {
            seen.hold_new(&self.rows);
            self.in_seen = self.rows.len();
            self.rows = Vec::new();
        }
        // Without a bitmap, the list may hold repetitions until it is compacted.
        let mut distinct = self.seen.is_some();
        if self.rows.len() >= self.compact_at {
            normalize(&mut self.rows);
            distinct = true;
            self.compact_at = self.compact_at.max(self.rows.len().saturating_mul(2));
            self.compact_at = self.compact_at.min(self.buffer_max());
        }
        self.check(if distinct { self.rows.len() } else { 0 }.max(self.in_seen))?;
        self.reorganize_at = self
            .rows
            .len()
            .saturating_mul(2)
            .max(Self::SEEN_MIN)
            .min(self.compact_at);
        let more = self.reorganize_at.saturating_sub(self.rows.len());
        self.rows.try_reserve_exact(more).map_err(|_| Abort::Memory)
    }

    /// Takes the distinct rows, in order. Afterwards the buffer is empty, but it may filter these rows when they are
    /// derived again.
    pub(crate) fn take(&mut self) -> Vec<Row<W>> {
        self.take_by(normalize)
    }

    /// Like `take`, with another function to sort rows and remove repetitions.
    pub(crate) fn take_by(&mut self, normalize: impl FnOnce(&mut Vec<Row<W>>)) -> Vec<Row<W>> {
        self.has_taken |= !self.is_empty();
        if let Some(groups) = &mut self.groups {
            return groups.take();
        }
        self.reorganize_at = self.compact_at.min(Self::SEEN_MIN);
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.holds_new()) {
            return seen.drain(std::mem::take(&mut self.in_seen));
        }
        let mut rows = std::mem::take(&mut self.rows);
        normalize(&mut rows);
        if (rows.capacity() - rows.len()) * size_of::<Row<W>>() > Self::SLACK_BYTES {
            rows.shrink_to_fit();
        }
        if self.seen.is_none() {
            raise(&mut self.largest, &rows);
        }
        rows
    }

    /// Adds the rows taken before there was a bitmap, so that it has [all rows](Output::has_all). If a row does not
    /// fit, that becomes true only with another bitmap.
    pub(crate) fn mark_taken<'a>(&mut self, taken: impl Iterator<Item = &'a [Row<W>]>) {
        if let Some(seen) = self.seen.as_mut().filter(|_| self.lacks_taken) {
            self.lacks_taken = false;
            let mut rows = taken.flatten();
            self.seen_has_all = rows.all(|row| seen.mark(row));
        }
    }

    /// Makes the bitmap the only record of the rows taken. It must have [all rows](Output::has_all). If it drops
    /// the bitmap later, [`Output::take_record`] returns these rows.
    pub(crate) fn keep_record(&mut self) {
        self.seen_is_record = true;
    }

    /// Takes the rows that were taken before the buffer dropped the bitmap that recorded them, in order.
    pub(crate) fn take_record(&mut self) -> Vec<Row<W>> {
        std::mem::take(&mut self.record)
    }

    /// Whether the bitmap holds all rows ever pushed.
    pub(crate) fn has_all(&self) -> bool {
        self.seen_has_all && self.seen.is_some()
    }

    /// The rows in the bitmap, in order: all rows ever pushed if it has [all](Output::has_all).
    pub(crate) fn all(&self) -> Vec<Row<W>> {
        self.seen.as_ref().map(SeenBitmap::all).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn an_output_holds_what_was_pushed() {
        let mut state = 5_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 4) % below
        };
        let mut known = 0;
        // Dense words, then larger ones, then some that do not fit a bitmap.
        for phases in [
            &[40, 40, 300, 300, 2_000][..],
            &[3_000, 20, 100_000_000, 20, 20],
            &[1, 1],
        ] {
            let mut out = Output::<2>::new(usize::MAX);
            assert!(!out.has_all());
            let mut before: BTreeSet<Row<2>> = BTreeSet::new();
            for &words in phases {
                let mut pushed: BTreeSet<Row<2>> = BTreeSet::new();
                for _ in 0..20_000 {
                    if random(10) == 0 {
                        let first = Value(random(words));
                        let found: Vec<Row<2>> =
                            (0..random(50)).map(|_| Row([Value(0), Value(random(words))])).collect();
                        pushed.extend(found.iter().map(|row| Row([first, row.0[1]])));
                        out.push_along(Row([first, Value(9)]), 1, &found, 1).unwrap();
                    } else {
                        let row = Row([Value(random(words)), Value(random(words))]);
                        pushed.insert(row);
                        out.push(row).unwrap();
                    }
                }
                let taken = out.take();
                assert!(out.is_empty());
                assert!(taken.is_sorted_by(|a, b| a < b));
                assert!(taken.iter().all(|row| pushed.contains(row)));
                let taken: BTreeSet<Row<2>> = taken.into_iter().collect();
                assert!(pushed.iter().all(|row| taken.contains(row) || before.contains(row)));
                before.extend(pushed);
                if out.has_all() {
                    assert!(out.all().iter().eq(&before));
                    known += 1;
                }
            }
        }
        // Phases with words that stay dense.
        assert_eq!(known, 4);
    }

    #[test]
    fn sets_of_words_equal_their_rows() {
        let mut state = 9_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        // The last column is padding.
        let (mut sets, mut plain) = (Output::<3>::new(usize::MAX), Output::<3>::new(usize::MAX));
        let mut pushed = [0; 2];
        let mut all: [BTreeSet<Row<3>>; 2] = Default::default();
        // Many new rows, then few, then words beyond the bounds.
        for (times, words) in [
            (300, 2_000),
            (300, 2_000),
            (3_000, 2_000),
            (50, 2_000),
            (3, 100_000),
            (50, 2_000),
        ] {
            for _ in 0..times {
                let row = Row([Value(random(40)), Value(9), Value(0)]);
                let found: BTreeSet<u32> = (0..random(600)).map(|_| random(words)).collect();
                let found: Vec<Row<3>> = (found.iter())
                    .map(|&word| Row([Value(5), Value(word), Value(0)]))
                    .collect();
                plain.push_along(row, 1, &found, 1).unwrap();
                let width = sets.set_words(1).map_or(0, |(width, _)| width);
                let fits = found.last().is_some_and(|last| (last.0[1].0 as usize) < width * 64);
                let mut done = false;
                if fits && random(4) > 0 {
                    let mut bits = vec![0_u64; width];
                    for row in &found {
                        bits[row.0[1].0 as usize / 64] |= 1 << (row.0[1].0 % 64);
                    }
                    let holds_new = sets.seen.as_ref().is_some_and(SeenBitmap::holds_new);
                    // The first word may exceed its bound.
                    done = sets.push_set(row, 1, &bits, found.len()).unwrap();
                    pushed[usize::from(holds_new)] += usize::from(done);
                }
                if !done {
                    sets.push_along(row, 1, &found, 1).unwrap();
                }
            }
            assert_eq!(sets.pushed, plain.pushed);
            // An output may repeat rows that were taken before.
            all[0].extend(sets.take());
            all[1].extend(plain.take());
            assert!(all[0] == all[1]);
        }
        assert!(pushed.iter().all(|&count| count > 20), "{pushed:?}");
    }

    #[test]
    fn an_output_is_limited() {
        for words in [1_000, 1_000_000_000] {
            let mut out = Output::<2>::new(10_000);
            let mut pushed = 0;
            while pushed < 100_000
                && out
                    .push(Row([Value(pushed / 100 * (words / 1_000)), Value(pushed % 100)]))
                    .is_ok()
            {
                pushed += 1;
            }
            assert!((10_000..20_000).contains(&pushed), "{pushed}");
            let mut out = Output::<2>::new(10_000);
            let again = (0..100_000_u32).map(|n| Row([Value(n % 10_000 * (words / 10_000).max(1)), Value(7)]));
            assert!(again.map(|row| out.push(row)).all(|result| result.is_ok()));
            assert!(out.take().len() <= 10_000);
        }
    }
}
