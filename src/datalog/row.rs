//! Rows of a width fixed at compile time, and sorted lists of them.
//!
//! A program learns the arities of its predicates at run time, but fast sorting, merging and searching need them at
//! compile time. So all code on rows is generic over one width `W`: the program's largest arity, rounded up to one of
//! [`WIDTHS`]. Zeros pad narrower rows; only loaded predicates have rows of their own width ([`ByWidth`]). A set of rows
//! is a sorted slice without duplicates.
// Decision: docs/decisions/facts.md#d007

use crate::snapshot::{Decoder, SnapshotError};
use crate::value::Value;
use std::cmp::Ordering;

/// The supported widths, in words. The planner rejects a program with a larger arity.
pub(crate) const WIDTHS: [usize; 8] = [2, 3, 4, 6, 8, 12, 20, 32];

/// A row of `W` words, ordered lexicographically.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Row<const W: usize>(pub(crate) [Value; W]);

impl<const W: usize> Row<W> {
    /// A row of zeros.
    pub(crate) const ZERO: Self = Row([Value(0); W]);

    /// Pads the values to a row. `values` must have at most `W` elements.
    #[inline]
    pub(crate) fn new(values: &[Value]) -> Self {
        let mut row = Self::ZERO;
        // Shorter than a call of `memcpy` for a few words.
        for (to, &from) in row.0.iter_mut().zip(values) {
            *to = from;
        }
        row
    }

    /// Returns the values of the given columns, padded.
    pub(crate) fn project(&self, columns: &[u16]) -> Self {
        let mut row = Self::ZERO;
        for (to, &from) in row.0.iter_mut().zip(columns) {
            *to = self.0[from as usize];
        }
        row
    }
}

/// Reads a saved row. `interned` says which of its words are symbols; these are below `known`.
pub(crate) fn read_row<const W: usize>(
    input: &mut Decoder<'_>,
    interned: &[bool],
    known: usize,
) -> Result<Row<W>, SnapshotError> {
    let mut row = Row::ZERO;
    for (value, interned) in row.0.iter_mut().zip(interned) {
        value.0 = input.word()?;
        if *interned && value.0 as usize >= known {
            return Err(SnapshotError::Corrupt);
        }
    }
    Ok(row)
}

/// Reads saved rows, which are sorted and different.
pub(crate) fn read_rows<const W: usize>(
    input: &mut Decoder<'_>,
    count: u64,
    interned: &[bool],
    known: usize,
) -> Result<Vec<Row<W>>, SnapshotError> {
    /// The rows for which memory is reserved before any is read.
    const FIRST: u64 = 1 << 12;
    let mut rows: Vec<Row<W>> = Vec::with_capacity(count.min(FIRST) as usize);
    for _ in 0..count {
        input.room(1, size_of::<Row<W>>())?;
        let row = read_row(input, interned, known)?;
        if rows.last().is_some_and(|last| *last >= row) {
            return Err(SnapshotError::Corrupt);
        }
        rows.push(row);
    }
    rows.shrink_to_fit();
    Ok(rows)
}

/// Rows of some width, behind a common interface.
pub(crate) trait RowList: Send + Sync {
    /// Returns the padded row at a position, which must be less than the number of rows.
    fn row(&self, position: usize) -> &[Value];
}

impl<const W: usize> RowList for Vec<Row<W>> {
    fn row(&self, position: usize) -> &[Value] {
        &self[position].0
    }
}

impl<const W: usize> Ord for Row<W> {
    /// Compares lexicographically, two words at a time, because sorting spends its time here.
    #[inline]
    fn cmp(&self, other: &Self) -> Ordering {
        let pair = |row: &Self, i: usize| u64::from(row.0[i].0) << 32 | u64::from(row.0[i + 1].0);
        let mut i = 0;
        while i + 1 < W {
            let (a, b) = (pair(self, i), pair(other, i));
            if i + 2 >= W || a != b {
                return a.cmp(&b);
            }
            i += 2;
        }
        self.0[W - 1].cmp(&other.0[W - 1])
    }
}

impl<const W: usize> PartialOrd for Row<W> {
    #[inline]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Returns the length of the prefix that satisfies `before`, by galloping (exponential) search. `before` must hold for
/// a prefix only. Fast for short prefixes.
pub(crate) fn gallop<T>(slice: &[T], mut before: impl FnMut(&T) -> bool) -> usize {
    let mut step = 1;
    let mut low = 0;
    // Invariant: every element in front of `low` satisfies `before`.
    while low + step <= slice.len() && before(&slice[low + step - 1]) {
        low += step;
        step *= 2;
    }
    let high = (low + step).min(slice.len());
    low + slice[low..high].partition_point(before)
}

/// Returns the union of two sets.
pub(crate) fn merge<const W: usize>(a: &[Row<W>], b: &[Row<W>]) -> Vec<Row<W>> {
    let mut out = Vec::with_capacity(a.len() + b.len());
    let (mut a, mut b) = (a, b);
    while let (Some(x), Some(y)) = (a.first(), b.first()) {
        match x.cmp(y) {
            Ordering::Less => {
                out.push(*x);
                a = &a[1..];
            }
            Ordering::Greater => {
                out.push(*y);
                b = &b[1..];
            }
            Ordering::Equal => a = &a[1..],
        }
    }
    out.extend_from_slice(a);
    out.extend_from_slice(b);
    out
}

/// Returns the elements of `a` that are not in `b`.
pub(crate) fn difference<const W: usize>(a: &[Row<W>], b: &[Row<W>]) -> Vec<Row<W>> {
    let mut out = Vec::new();
    let mut b = b;
    for row in a {
        b = &b[gallop(b, |other| other < row)..];
        if b.first() != Some(row) {
            out.push(*row);
        }
    }
    out
}

/// Sorts the rows and removes duplicates.
pub(crate) fn normalize<const W: usize>(rows: &mut Vec<Row<W>>) {
    if !rows.is_sorted_by(|a, b| a < b) {
        rows.sort_unstable();
        rows.dedup();
    }
}

/// A sorted list of rows with search by prefix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Batch<'a, const W: usize> {
    pub(crate) rows: &'a [Row<W>],
    /// The directory: `starts[v]` is the position of the first row whose first word is at least `v`. Empty if the batch
    /// has no directory.
    pub(crate) starts: &'a [u32],
}

impl<'a, const W: usize> Batch<'a, W> {
    /// Creates a batch without a directory.
    pub(crate) fn plain(rows: &'a [Row<W>]) -> Self {
        Batch { rows, starts: &[] }
    }

    /// Returns the rows that begin with `key`.
    #[inline]
    pub(crate) fn range(&self, key: &[Value]) -> &'a [Row<W>] {
        match key {
            [] => self.rows,
            [first] => self.group(*first),
            [first, second] => pick(self.group(*first), *second),
            [first, rest @ ..] => narrow(self.group(*first), rest),
        }
    }

    /// Returns whether a row begins with `key`.
    #[inline]
    pub(crate) fn holds(&self, key: &[Value]) -> bool {
        match key {
            [first] if !self.starts.is_empty() => {
                let at = first.0 as usize;
                matches!(self.starts.get(at..at.saturating_add(2)), Some(&[start, end]) if start < end)
            }
            [first, second] => {
                let rows = self.group(*first);
                match rows.len() {
                    0..=GROUP_SMALL => rows.iter().any(|row| row.0[1] == *second),
                    _ => !pick(rows, *second).is_empty(),
                }
            }
            _ => !self.range(key).is_empty(),
        }
    }

    /// Returns the rows whose first word is `first`.
    #[inline]
    fn group(&self, first: Value) -> &'a [Row<W>] {
        if self.starts.is_empty() {
            let start = self.rows.partition_point(|row| row.0[0] < first);
            let rows = &self.rows[start..];
            return &rows[..gallop(rows, |row| row.0[0] == first)];
        }
        let at = first.0 as usize;
        match self.starts.get(at..at.saturating_add(2)) {
            Some(&[start, end]) => &self.rows[start as usize..end as usize],
            _ => &[],
        }
    }
}

/// A value for rows of the program's width, or of a narrower one.
///
/// Predicates that no clause derives may have few columns in a program with wide predicates. Their rows are as narrow as
/// these columns allow; see [`NARROW`].
#[derive(Clone, Copy, Debug)]
pub(crate) enum ByWidth<Own, Two, Four, Eight> {
    /// The program's width.
    Own(Own),
    /// Two words.
    Two(Two),
    /// Four words.
    Four(Four),
    /// Eight words.
    Eight(Eight),
}

/// The widths of narrow rows.
pub(crate) const NARROW: [usize; 3] = [2, 4, 8];

/// Evaluates an expression for the value of a [`ByWidth`], whatever its width.
macro_rules! each_width {
    ($value:expr, $name:ident => $result:expr) => {
        match $value {
            $crate::row::ByWidth::Own($name) => $result,
            $crate::row::ByWidth::Two($name) => $result,
            $crate::row::ByWidth::Four($name) => $result,
            $crate::row::ByWidth::Eight($name) => $result,
        }
    };
}

/// Like `each_width`, with a [`ByWidth`] of the results.
macro_rules! map_width {
    ($value:expr, $name:ident => $result:expr) => {
        match $value {
            $crate::row::ByWidth::Own($name) => $crate::row::ByWidth::Own($result),
            $crate::row::ByWidth::Two($name) => $crate::row::ByWidth::Two($result),
            $crate::row::ByWidth::Four($name) => $crate::row::ByWidth::Four($result),
            $crate::row::ByWidth::Eight($name) => $crate::row::ByWidth::Eight($result),
        }
    };
}
pub(crate) use {each_width, map_width};

/// Sorted rows of some width.
pub(crate) type AnyRows<'a, const W: usize> = ByWidth<&'a [Row<W>], &'a [Row<2>], &'a [Row<4>], &'a [Row<8>]>;

/// A batch of rows of some width.
pub(crate) type AnyBatch<'a, const W: usize> = ByWidth<Batch<'a, W>, Batch<'a, 2>, Batch<'a, 4>, Batch<'a, 8>>;

impl<'a, const W: usize> AnyRows<'a, W> {
    /// Returns the number of rows.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        each_width!(self, rows => rows.len())
    }

    /// Returns the words of a row.
    #[inline]
    pub(crate) fn words(&self, position: usize) -> &'a [Value] {
        each_width!(self, rows => &rows[position].0)
    }

    /// Splits the rows at a position.
    pub(crate) fn split_at(&self, position: usize) -> (Self, Self) {
        match self {
            ByWidth::Own(rows) => {
                let (front, back) = rows.split_at(position);
                (ByWidth::Own(front), ByWidth::Own(back))
            }
            ByWidth::Two(rows) => {
                let (front, back) = rows.split_at(position);
                (ByWidth::Two(front), ByWidth::Two(back))
            }
            ByWidth::Four(rows) => {
                let (front, back) = rows.split_at(position);
                (ByWidth::Four(front), ByWidth::Four(back))
            }
            ByWidth::Eight(rows) => {
                let (front, back) = rows.split_at(position);
                (ByWidth::Eight(front), ByWidth::Eight(back))
            }
        }
    }
}

impl<'a, const W: usize> AnyBatch<'a, W> {
    /// Returns the rows that begin with `key`.
    #[inline]
    pub(crate) fn range(&self, key: &[Value]) -> AnyRows<'a, W> {
        map_width!(self, batch => batch.range(key))
    }

    /// Returns whether a row begins with `key`.
    #[inline]
    pub(crate) fn holds(&self, key: &[Value]) -> bool {
        match self {
            ByWidth::Own(batch) => batch.holds(key),
            narrow => narrow.holds_narrow(key),
        }
    }

    /// Like `holds`, apart from it to keep that small.
    #[inline(never)]
    fn holds_narrow(&self, key: &[Value]) -> bool {
        each_width!(self, batch => batch.holds(key))
    }
}

/// Up to this many rows, linear search beats binary search.
const GROUP_SMALL: usize = 32;

/// Returns the rows with `second` in the second column. All rows must agree in the first column.
#[inline]
fn pick<const W: usize>(rows: &[Row<W>], second: Value) -> &[Row<W>] {
    let start = match rows.len() {
        0..=GROUP_SMALL => rows.iter().filter(|row| row.0[1] < second).count(),
        _ => rows.partition_point(|row| row.0[1] < second),
    };
    let rows = &rows[start..];
    match rows {
        [row, next, ..] if row.0[1] == second && next.0[1] == second => &rows[..gallop(rows, |row| row.0[1] == second)],
        [row, ..] if row.0[1] == second => &rows[..1],
        _ => &[],
    }
}

/// Returns the rows whose columns from the second on begin with `rest`. All rows must agree in the first column.
fn narrow<'a, const W: usize>(rows: &'a [Row<W>], rest: &[Value]) -> &'a [Row<W>] {
    let key = |row: &Row<W>| row.0[1..=rest.len()].cmp(rest);
    let start = rows.partition_point(|row| key(row).is_lt());
    let rows = &rows[start..];
    &rows[..gallop(rows, |row| key(row).is_eq())]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows<const W: usize>(words: &[[u32; W]]) -> Vec<Row<W>> {
        words.iter().map(|row| Row(row.map(Value))).collect()
    }

    #[test]
    fn rows_are_ordered_as_their_words() {
        fn check<const W: usize>() {
            let samples: Vec<[u32; W]> = (0..200u32)
                .map(|i| std::array::from_fn(|column| i.wrapping_mul(2_654_435_761 + column as u32) >> 30))
                .collect();
            for a in &samples {
                for b in &samples {
                    assert_eq!(Row(a.map(Value)).cmp(&Row(b.map(Value))), a.cmp(b));
                }
            }
        }
        check::<2>();
        check::<3>();
        check::<4>();
        check::<8>();
    }

    #[test]
    fn gallop_counts_a_prefix() {
        for len in 0..40 {
            let list: Vec<usize> = (0..len).collect();
            for prefix in 0..=len {
                assert_eq!(gallop(&list, |&x| x < prefix), prefix);
            }
        }
    }

    #[test]
    fn sets_merge_and_subtract() {
        let a = rows(&[[1, 1], [2, 2], [5, 0]]);
        let b = rows(&[[0, 9], [2, 2], [7, 7]]);
        assert_eq!(merge(&a, &b), rows(&[[0, 9], [1, 1], [2, 2], [5, 0], [7, 7]]));
        assert_eq!(difference(&a, &b), rows(&[[1, 1], [5, 0]]));
        assert_eq!(difference(&b, &a), rows(&[[0, 9], [7, 7]]));
    }
}
