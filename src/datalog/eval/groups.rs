//! Groups: aggregates by key, computed from matches in any order.

use crate::aggregate::Partial;
use crate::plan::steps::Fold;
use crate::row::Row;
use crate::symbol::Symbols;
use crate::syntax::functor::AggregateOp;
use crate::value::Value;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// The word of a group whose aggregate has no value: a count beyond the range of numbers. No count is negative.
const NO_VALUE: Value = Value(u32::MAX);

/// The aggregates of the matches seen so far, by key.
///
/// Stored as rows, a group is its key and then its aggregate. A group without a value has no row, unless its aggregate
/// is a count.
#[derive(Debug)]
pub(crate) struct Groups<const W: usize> {
    fold: Fold,
    /// The number of words of a key.
    keys: usize,
    done: HashMap<Row<W>, Partial, BuildHasherDefault<KeyHasher>>,
    /// The group of the last match, not yet in `done`: successive matches often have the same key.
    current: Option<(Row<W>, Partial)>,
}

impl<const W: usize> Groups<W> {
    pub(crate) fn new(fold: Fold, keys: usize) -> Self {
        Groups {
            fold,
            keys,
            done: HashMap::default(),
            current: None,
        }
    }

    /// Makes empty groups for a part of the matches.
    pub(crate) fn fork(&self) -> Self {
        Groups::new(self.fold, self.keys)
    }

    /// The number of groups.
    pub(crate) fn len(&self) -> usize {
        self.done.len() + usize::from(self.current.is_some())
    }

    /// The number of rows that take as much memory as the groups: a table is up to half empty, and has two copies while
    /// it grows.
    #[inline]
    pub(crate) fn rows(&self) -> usize {
        match self.len() {
            // One group is no more than one row, however little memory there is.
            count @ 0..=1 => count,
            count => count * (3 * size_of::<(Row<W>, Partial)>() / size_of::<Row<W>>() + Self::EXACT),
        }
    }

    /// The number of rows that take as much memory as an exact sum.
    const EXACT: usize = 96_usize.div_ceil(size_of::<Row<W>>());

    /// Adds a match with this value.
    #[inline]
    pub(crate) fn add(&mut self, key: Row<W>, value: Value, symbols: &Symbols) {
        let Fold { op, base, .. } = self.fold;
        self.group(key).add(op, base, value, symbols);
    }

    /// Counts matches; for [`AggregateOp::Count`] only.
    #[inline]
    pub(crate) fn count(&mut self, key: Row<W>, times: u64) {
        self.group(key).count(times);
    }

    #[inline]
    fn group(&mut self, key: Row<W>) -> &mut Partial {
        if self.current.as_ref().is_none_or(|(current, _)| *current != key) {
            self.change(key);
        }
        &mut self.current.get_or_insert_with(|| (key, Partial::default())).1
    }

    fn change(&mut self, key: Row<W>) {
        let next = self.done.remove(&key).unwrap_or_default();
        if let Some((key, partial)) = self.current.replace((key, next)) {
            self.done.insert(key, partial);
        }
    }

    /// Adds the matches of other groups.
    pub(crate) fn merge(&mut self, other: Self, symbols: &Symbols) {
        let Fold { op, base, .. } = self.fold;
        for (key, partial) in other.done.into_iter().chain(other.current) {
            self.group(key).merge(partial, op, base, symbols);
        }
    }

    /// Takes the groups as sorted rows.
    pub(crate) fn take(&mut self) -> Vec<Row<W>> {
        let Fold { op, base, .. } = self.fold;
        let groups = self.done.drain().chain(self.current.take());
        let rows = groups.filter_map(|(mut key, partial)| {
            let absent = (op == AggregateOp::Count).then_some(NO_VALUE);
            key.0[self.keys] = partial.finish(op, base).or(absent)?;
            Some(key)
        });
        let mut rows: Vec<Row<W>> = rows.collect();
        rows.sort_unstable();
        rows.shrink_to_fit();
        rows
    }
}

/// Returns the aggregate of a group, given the rows that begin with its key, at most one.
#[inline]
pub(crate) fn lookup<const W: usize>(found: &[Row<W>], keys: usize, op: AggregateOp) -> Option<Value> {
    match (found.first(), op) {
        (Some(row), AggregateOp::Count) => Some(row.0[keys]).filter(|value| *value != NO_VALUE),
        (Some(row), _) => Some(row.0[keys]),
        // The sum of no floats is the word 0, too.
        (None, AggregateOp::Count | AggregateOp::Sum) => Some(Value(0)),
        (None, _) => None,
    }
}

/// A fast hash of words. No result depends on it: its users look up keys, and sort what they enumerate.
#[derive(Default)]
pub(crate) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u32(byte.into()));
    }

    #[inline]
    fn write_u32(&mut self, word: u32) {
        self.0 = (self.0.rotate_left(5) ^ u64::from(word)).wrapping_mul(0xF135_7AEA_2E62_A9C5);
    }

    #[inline]
    fn write_usize(&mut self, _: usize) {
        // The length of a key, which all keys share.
    }

    #[inline]
    fn finish(&self) -> u64 {
        // The table uses the low bits, and multiplication mixes the high ones best.
        self.0.rotate_left(26)
    }
}
