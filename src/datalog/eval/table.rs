//! The storage of a predicate: its rows, its indexes, and incremental updates of both.
// Decision: docs/decisions/facts.md#d026

use crate::plan::steps::IndexSpec;
use crate::row::{Batch, Row, difference, gallop};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, OnceLock};

/// The net change of a table: added and removed rows, both sorted and disjoint.
#[derive(Clone, Debug, Default)]
pub(crate) struct TableDelta<const W: usize> {
    /// Shared with the table if it was empty before.
    pub(crate) added: Arc<Vec<Row<W>>>,
    pub(crate) removed: Vec<Row<W>>,
}

impl<const W: usize> TableDelta<W> {
    pub(crate) fn is_empty(&self) -> bool {
        self.added.is_empty() && self.removed.is_empty()
    }

    pub(crate) fn len(&self) -> usize {
        self.added.len() + self.removed.len()
    }

    /// The change from one set of rows to another.
    pub(crate) fn between(old: &[Row<W>], new: &Arc<Vec<Row<W>>>) -> Self {
        TableDelta {
            added: match old {
                [] => Arc::clone(new),
                _ => difference(new, old).into(),
            },
            removed: difference(old, new),
        }
    }
}

/// A predicate's rows and the indexes over them.
#[derive(Debug, Default)]
pub(crate) struct Table<const W: usize> {
    /// Sorted, without repetitions.
    pub(crate) rows: Arc<Vec<Row<W>>>,
    /// By [`IndexSpec::position`]; built on first use.
    indexes: Vec<OnceLock<Index<W>>>,
}

impl<const W: usize> Table<W> {
    /// A table with `indexes` indexes, none built yet.
    pub(crate) fn new(rows: Vec<Row<W>>, indexes: usize) -> Self {
        Table {
            rows: rows.into(),
            indexes: (0..indexes).map(|_| OnceLock::new()).collect(),
        }
    }

    /// Extends the table to `indexes` indexes.
    pub(crate) fn widen(&mut self, indexes: usize) {
        self.indexes.resize_with(indexes.max(self.indexes.len()), OnceLock::new);
    }

    /// A table of these rows with as many indexes, none built yet.
    pub(crate) fn reloaded(&self, rows: Arc<Vec<Row<W>>>) -> Self {
        Table {
            rows,
            indexes: self.indexes.iter().map(|_| OnceLock::new()).collect(),
        }
    }

    /// The rows in the order of an index, which is built if necessary.
    pub(crate) fn batch(&self, spec: &IndexSpec) -> Batch<'_, W> {
        let own = spec.position == 0;
        let index = self.indexes[spec.position].get_or_init(|| Index::build(&self.rows, &spec.columns, own));
        index.used.store(true, Relaxed);
        Batch {
            rows: if own { &self.rows } else { &index.rows },
            starts: &index.starts,
        }
    }

    /// The bytes of the rows and of the indexes built so far.
    pub(crate) fn bytes(&self) -> u64 {
        let indexes = self.indexes.iter().filter_map(OnceLock::get);
        let starts = indexes.clone().map(|index| size_of_val(&index.starts[..]));
        let lists = indexes.map(|index| size_of_val(&index.rows[..]));
        (starts.chain(lists).sum::<usize>() + size_of_val(&self.rows[..])) as u64
    }

    /// The bytes that building the index takes; 0 if it has been built.
    pub(crate) fn missing_bytes(&self, spec: &IndexSpec) -> u64 {
        if self.indexes[spec.position].get().is_some() {
            return 0;
        }
        let first = spec.columns.first().map_or(0, |&column| column as usize);
        let largest = self.rows.iter().map(|row| row.0[first].0).max().unwrap_or(0) as usize;
        let starts = if Index::<W>::dense(self.rows.len(), largest) {
            largest + 3
        } else {
            0
        };
        let rows = if spec.position == 0 {
            0
        } else {
            size_of_val(&self.rows[..])
        };
        (rows + starts * size_of::<u32>()) as u64
    }

    /// The rows in primary order, with a directory if it has been built.
    fn known(&self) -> Batch<'_, W> {
        let starts = self.indexes.first().and_then(OnceLock::get);
        Batch {
            rows: &self.rows,
            starts: starts.map_or(&[], |index| &index.starts),
        }
    }

    /// Returns the net effect of the changes and the new rows, or `None` if nothing changes. The changes are sorted, at
    /// most one per row; `true` inserts.
    pub(crate) fn update(
        &self,
        changes: impl ExactSizeIterator<Item = (Row<W>, bool)>,
    ) -> Option<(TableDelta<W>, Arc<Vec<Row<W>>>)> {
        let count = changes.len();
        let (mut added, mut removed) = (Vec::new(), Vec::new());
        let mut finder = Finder::new(self.known());
        let mut rows = Vec::new();
        let mut copied = 0;
        for (row, present) in changes {
            let was = finder.find(&row);
            if was == present {
                continue;
            }
            if rows.is_empty() {
                rows.reserve(self.rows.len() + count);
            }
            append(&mut rows, &self.rows[copied..finder.at]);
            copied = finder.at;
            if present {
                added.push(row);
                rows.push(row);
            } else {
                removed.push(row);
                copied += 1;
            }
        }
        if added.is_empty() && removed.is_empty() {
            return None;
        }
        append(&mut rows, &self.rows[copied..]);
        let added = added.into();
        Some((TableDelta { added, removed }, rows.into()))
    }

    /// Returns the table after a change. Patches the indexes in use.
    pub(crate) fn patched(&self, specs: &[&IndexSpec], delta: &TableDelta<W>) -> Table<W> {
        let rows = patch(self.known(), delta);
        self.replaced(specs, delta, rows.into())
    }

    /// Like `patched`, if the new rows are known.
    pub(crate) fn replaced(&self, specs: &[&IndexSpec], delta: &TableDelta<W>, rows: Arc<Vec<Row<W>>>) -> Table<W> {
        let indexes = self.indexes.iter().zip(specs).map(|(index, spec)| {
            let index = index.get().filter(|_| delta.len() <= rows.len() / 2);
            index
                .and_then(|index| index.patched(&self.rows, spec, delta, &rows))
                .map_or_else(OnceLock::new, OnceLock::from)
        });
        Table {
            indexes: indexes.collect(),
            rows,
        }
    }
}

/// A predicate's rows in another order of columns, or only a directory of the primary order.
#[derive(Debug)]
struct Index<const W: usize> {
    /// Empty for the primary index.
    rows: Vec<Row<W>>,
    starts: Vec<u32>,
    /// Whether a query used it since it was built or patched.
    used: AtomicBool,
    /// The number of consecutive patches without use.
    idle: u8,
}

impl<const W: usize> Index<W> {
    /// Below this number of rows a binary search costs no more than a directory.
    const DIRECTORY_MIN: usize = 512;

    /// Whether a directory is worth its memory: it is small, or its words are dense.
    fn dense(rows: usize, largest: usize) -> bool {
        let sparse = if largest < 1 << 16 { 32 } else { 4 };
        rows >= Self::DIRECTORY_MIN && largest / sparse <= rows && u32::try_from(rows).is_ok()
    }

    /// An index is dropped after this number of patches without use.
    const IDLE_MAX: u8 = 4;

    /// Builds an index over `rows` by `columns`. `own` builds the primary index.
    fn build(rows: &[Row<W>], columns: &[u16], own: bool) -> Self {
        let (rows, starts) = match own {
            true => (Vec::new(), directory(rows)),
            false => ordered(rows, columns),
        };
        Index {
            rows,
            starts,
            used: AtomicBool::new(false),
            idle: 0,
        }
    }

    /// Returns the index after a change, or `None` if it is unused. `old` and `new` are the predicate's rows in primary
    /// order.
    fn patched(&self, old: &[Row<W>], spec: &IndexSpec, delta: &TableDelta<W>, new: &[Row<W>]) -> Option<Self> {
        let idle = if self.used.load(Relaxed) { 0 } else { self.idle + 1 };
        if idle > Self::IDLE_MAX {
            return None;
        }
        let (rows, starts) = if spec.position == 0 {
            (Vec::new(), patch_directory(&self.starts, delta, new))
        } else {
            let delta = TableDelta {
                added: project(&delta.added, &spec.columns).into(),
                removed: project(&delta.removed, &spec.columns),
            };
            debug_assert_eq!(self.rows.len(), old.len());
            let batch = Batch {
                rows: &self.rows,
                starts: &self.starts,
            };
            let rows = patch(batch, &delta);
            let starts = patch_directory(&self.starts, &delta, &rows);
            (rows, starts)
        };
        Some(Index {
            rows,
            starts,
            used: AtomicBool::new(false),
            idle,
        })
    }
}

/// Reorders the columns of sorted rows and sorts the result.
pub(crate) fn project<const W: usize>(rows: &[Row<W>], columns: &[u16]) -> Vec<Row<W>> {
    ordered(rows, columns).0
}

/// Like `project`, with a directory if it is worth its memory. Then a counting sort by the first word orders the rows.
/// It is stable, so rows with the same first word are usually in order already.
fn ordered<const W: usize>(rows: &[Row<W>], columns: &[u16]) -> (Vec<Row<W>>, Vec<u32>) {
    let first = columns.first().map_or(0, |&column| column as usize);
    let largest = rows.iter().map(|row| row.0[first].0).max().unwrap_or(0) as usize;
    if !Index::<W>::dense(rows.len(), largest) {
        let mut projected: Vec<Row<W>> = rows.iter().map(|row| row.project(columns)).collect();
        projected.sort_unstable();
        return (projected, Vec::new());
    }
    // The count of a word is stored two places after it. When all rows are placed, the entries of the word and of its
    // successor are the bounds of its rows.
    let mut starts = vec![0_u32; largest + 3];
    for row in rows {
        starts[row.0[first].0 as usize + 2] += 1;
    }
    for word in 2..starts.len() {
        starts[word] += starts[word - 1];
    }
    let mut projected = vec![Row::ZERO; rows.len()];
    for row in rows {
        let at = &mut starts[row.0[first].0 as usize + 1];
        projected[*at as usize] = row.project(columns);
        *at += 1;
    }
    starts.pop();
    if !columns.iter().skip(1).is_sorted() {
        for bounds in starts.windows(2) {
            projected[bounds[0] as usize..bounds[1] as usize].sort_unstable();
        }
    }
    (projected, starts)
}

/// Finds rows in ascending order.
struct Finder<'a, const W: usize> {
    batch: Batch<'a, W>,
    /// All rows before it are less than the rows found so far.
    at: usize,
}

impl<'a, const W: usize> Finder<'a, W> {
    fn new(batch: Batch<'a, W>) -> Self {
        Finder { batch, at: 0 }
    }

    /// Moves `at` to the first row that is not less than `row`, and returns whether the two are equal.
    fn find(&mut self, row: &Row<W>) -> bool {
        // The directory has no entry for words larger than all earlier ones; such rows belong at the end.
        if let Some(&start) = self.batch.starts.get(row.0[0].0 as usize) {
            self.at = self.at.max(start as usize);
        }
        let rest = &self.batch.rows[self.at..];
        self.at += gallop(rest, |other| other < row);
        self.batch.rows.get(self.at) == Some(row)
    }
}

/// Appends rows; optimized for few.
#[inline]
fn append<const W: usize>(to: &mut Vec<Row<W>>, rows: &[Row<W>]) {
    if rows.len() < 16 {
        rows.iter().for_each(|row| to.push(*row));
    } else {
        to.extend_from_slice(rows);
    }
}

/// Returns the rows after a change.
fn patch<const W: usize>(batch: Batch<'_, W>, delta: &TableDelta<W>) -> Vec<Row<W>> {
    let mut rows = Vec::with_capacity((batch.rows.len() + delta.added.len()).saturating_sub(delta.removed.len()));
    let mut finder = Finder::new(batch);
    let (mut added, mut removed) = (&delta.added[..], &delta.removed[..]);
    let mut copied = 0;
    loop {
        let comes = match (added.first(), removed.first()) {
            (None, None) => break,
            (Some(_), None) => true,
            (None, Some(_)) => false,
            (Some(added), Some(removed)) => added < removed,
        };
        let list = if comes { &mut added } else { &mut removed };
        let Some((row, rest)) = list.split_first() else { break };
        *list = rest;
        let found = finder.find(row);
        append(&mut rows, &batch.rows[copied..finder.at]);
        copied = finder.at;
        if comes {
            rows.push(*row);
        } else if found {
            copied += 1;
        }
    }
    append(&mut rows, &batch.rows[copied..]);
    rows
}

/// Builds a directory for direct addressing by the first word, if the words are dense. Symbols are: they are numbered
/// from zero.
fn directory<const W: usize>(rows: &[Row<W>]) -> Vec<u32> {
    let Some(last) = rows.last() else { return Vec::new() };
    let largest = last.0[0].0 as usize;
    if !Index::<W>::dense(rows.len(), largest) {
        return Vec::new();
    }
    let mut starts = Vec::with_capacity(largest + 2);
    for (row, position) in rows.iter().zip(0_u32..) {
        let word = row.0[0].0 as usize;
        if starts.len() <= word {
            starts.resize(word + 1, position);
        }
    }
    starts.push(rows.len() as u32);
    starts
}

/// Returns the directory after a change; `rows` are the new rows.
fn patch_directory<const W: usize>(old: &[u32], delta: &TableDelta<W>, rows: &[Row<W>]) -> Vec<u32> {
    let beyond = delta
        .added
        .last()
        .is_some_and(|row| row.0[0].0 as usize + 1 >= old.len());
    if old.is_empty() || beyond || !Index::<W>::dense(rows.len(), old.len()) {
        return directory(rows);
    }
    // An added row shifts all later positions up by one, a removed row shifts them down.
    let mut starts = Vec::with_capacity(old.len());
    let (mut added, mut removed) = (&delta.added[..], &delta.removed[..]);
    let mut shift = 0_u32;
    while starts.len() < old.len() {
        let first = |list: &[Row<W>]| list.first().map_or(usize::MAX, |row| row.0[0].0 as usize);
        let word = first(added).min(first(removed));
        let moved = &old[starts.len()..old.len().min(word.saturating_add(1))];
        starts.extend(moved.iter().map(|start| start.wrapping_add(shift)));
        for (list, by) in [(&mut added, 1), (&mut removed, u32::MAX)] {
            while first(list) == word && !list.is_empty() {
                shift = shift.wrapping_add(by);
                *list = &list[1..];
            }
        }
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::PredicateId;
    use crate::row::{merge, normalize};
    use crate::value::Value;

    fn spec(columns: &[u16], position: usize) -> IndexSpec {
        IndexSpec {
            predicate: PredicateId(0),
            columns: columns.to_vec(),
            position,
        }
    }

    #[test]
    fn searches_agree_with_and_without_a_directory() {
        let mut list: Vec<Row<3>> = Vec::new();
        for a in (0..300).filter(|a| a % 7 != 3) {
            for b in 0..a % 5 {
                list.push(Row([Value(a), Value(b), Value(a ^ b)]));
            }
        }
        normalize(&mut list);
        let table = Table::new(list.clone(), 1);
        let own = spec(&[0, 1, 2], 0);
        assert!(!table.batch(&own).starts.is_empty());
        for a in 0..400 {
            for b in 0..6 {
                let expected: Vec<_> = list.iter().filter(|row| row.0[..2] == [Value(a), Value(b)]).collect();
                for batch in [Batch::plain(&list), table.batch(&own)] {
                    assert!(batch.range(&[Value(a), Value(b)]).iter().eq(expected.iter().copied()));
                }
            }
            let expected: Vec<_> = list.iter().filter(|row| row.0[0] == Value(a)).collect();
            for batch in [Batch::plain(&list), table.batch(&own)] {
                assert!(batch.range(&[Value(a)]).iter().eq(expected.iter().copied()));
            }
        }
        assert!(table.batch(&own).range(&[Value(u32::MAX)]).is_empty());
    }

    #[test]
    fn orders_are_as_sorted_ones() {
        let mut state = 11_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        let mut counted = 0;
        for (count, words) in [
            (0, 1),
            (3, 5),
            (700, 20),
            (700, 3_000),
            (2_000, 40),
            (2_000, 16_000_000),
        ] {
            let mut rows: Vec<Row<4>> = (0..count)
                .map(|_| Row([words, 7, words, 1].map(|below| Value(random(below)))))
                .collect();
            normalize(&mut rows);
            for columns in [&[1, 0, 2][..], &[0, 2, 1], &[2, 1, 0], &[1, 2, 0], &[2, 0, 1]] {
                let mut expected: Vec<Row<4>> = rows.iter().map(|row| row.project(columns)).collect();
                expected.sort_unstable();
                let (projected, starts) = ordered(&rows, columns);
                assert_eq!(projected, expected);
                assert_eq!(starts, directory(&expected));
                counted += usize::from(!starts.is_empty());
            }
        }
        assert_eq!(counted, 17);
    }

    #[test]
    fn patched_tables_are_as_built_ones() {
        let mut state = 7_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        let specs = [spec(&[0, 1], 0), spec(&[1, 0], 1)];
        let specs: Vec<&IndexSpec> = specs.iter().collect();
        // Words that fit into a directory, and words that sometimes do not.
        for words in [300, 1_000, 1_000_000] {
            let mut table: Table<2> = Table::new(Vec::new(), 2);
            for step in 0..60 {
                specs.iter().for_each(|spec| _ = table.batch(spec));
                let count = if step % 10 == 0 { 900 } else { 20 };
                let mut changes: Vec<(Row<2>, bool)> = (0..count)
                    .map(|_| match table.rows.len() as u32 {
                        rows if rows > 0 && random(2) == 0 => (table.rows[random(rows) as usize], false),
                        _ => (Row([Value(random(words)), Value(random(words))]), true),
                    })
                    .collect();
                changes.sort_unstable();
                changes.dedup_by_key(|(row, _)| *row);
                let Some((delta, rows)) = table.update(changes.into_iter()) else {
                    continue;
                };
                let expected = merge(&difference(&table.rows, &delta.removed), &delta.added);
                assert_eq!(*delta.added, difference(&expected, &table.rows));
                assert_eq!(*rows, expected);
                table = table.patched(&specs, &delta);
                assert_eq!(*table.rows, expected);
                let built = Table::new(expected, 2);
                for spec in &specs {
                    let (patched, built) = (table.batch(spec), built.batch(spec));
                    assert_eq!(patched.rows, built.rows);
                    // A patched directory may have entries after the last word and may outlive the density that it
                    // needs.
                    for word in 0..=words.min(2_000) {
                        assert_eq!(patched.range(&[Value(word)]), built.range(&[Value(word)]));
                    }
                }
            }
        }
    }

    #[test]
    fn an_unused_index_is_dropped() {
        let specs = [spec(&[0, 1], 0), spec(&[1, 0], 1)];
        let specs: Vec<&IndexSpec> = specs.iter().collect();
        let rows = (0..100).map(|word| Row([Value(word), Value(word / 2)])).collect();
        let mut table: Table<2> = Table::new(rows, 2);
        table.batch(specs[1]);
        for word in 0..u32::from(Index::<2>::IDLE_MAX) + 2 {
            assert!(table.indexes[0].get().is_none());
            assert_eq!(
                table.indexes[1].get().is_some(),
                word < u32::from(Index::<2>::IDLE_MAX) + 2,
                "{word}"
            );
            let delta = TableDelta {
                added: vec![Row([Value(200 + word), Value(0)])].into(),
                removed: Vec::new(),
            };
            table = table.patched(&specs, &delta);
        }
        assert!(table.indexes[1].get().is_none());
    }
}
