//! The pending changes of a predicate, which the next commit makes.

use crate::eval::table::{Table, TableDelta};
use crate::row::{Row, normalize};
use crate::value::Value;
use std::sync::Arc;

/// Pending insertions and removals, in the order of the calls. The last change of a row counts.
///
/// Most commits only insert, and often into an empty predicate. While there is no removal, the insertions are a plain
/// list that becomes the predicate's rows.
#[derive(Debug, Default)]
pub(crate) struct PendingChanges<const W: usize> {
    coming: Vec<Row<W>>,
    /// All changes if there is a removal; then `coming` is empty.
    changes: Vec<(Row<W>, bool)>,
}

impl<const W: usize> PendingChanges<W> {
    /// The insertion of these rows.
    pub(crate) fn of(rows: Vec<Row<W>>) -> Self {
        PendingChanges {
            coming: rows,
            changes: Vec::new(),
        }
    }

    /// The number of pending changes.
    pub(crate) fn len(&self) -> usize {
        self.coming.len() + self.changes.len()
    }

    /// The bytes of the pending changes.
    pub(crate) fn bytes(&self) -> u64 {
        (size_of_val(&self.coming[..]) + size_of_val(&self.changes[..])) as u64
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(crate) fn clear(&mut self) {
        self.coming.clear();
        self.changes.clear();
    }

    /// Adds an insertion (`present`) or a removal.
    #[inline]
    pub(crate) fn push(&mut self, row: Row<W>, present: bool) {
        if present && self.changes.is_empty() {
            self.coming.push(row);
            return;
        }
        self.changes.extend(self.coming.drain(..).map(|row| (row, true)));
        self.changes.push((row, present));
    }

    /// Adds insertions of rows with `arity` words each.
    pub(crate) fn extend(&mut self, words: &[Value], arity: usize) {
        if !self.changes.is_empty() {
            let rows = words.chunks_exact(arity).map(Row::new);
            self.changes.extend(rows.map(|row| (row, true)));
        } else if arity == W {
            self.coming.extend(words.as_chunks().0.iter().copied().map(Row));
        } else {
            self.coming.extend(words.chunks_exact(arity).map(Row::new));
        }
    }

    /// Adds the changes to `words`, in order: the words of each row, then 1 for an insertion and 0 for a removal.
    pub(crate) fn list(&self, arity: usize, words: &mut Vec<Value>) {
        let coming = self.coming.iter().map(|row| (row, true));
        let changes = self.changes.iter().map(|(row, present)| (row, *present));
        for (row, present) in coming.chain(changes) {
            words.extend_from_slice(&row.0[..arity]);
            words.push(Value(u32::from(present)));
        }
    }

    /// Reserves memory for `rows` more insertions.
    pub(crate) fn reserve(&mut self, rows: usize) {
        if self.changes.is_empty() {
            self.coming.reserve(rows);
        }
    }

    /// Drops all but the first `len` changes.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.coming.truncate(len);
        self.changes.truncate(len);
    }

    /// Returns the net change of a table and its new rows, or `None` if nothing changes. If the table is empty, the new
    /// rows are taken from here. The caller must [put them back](PendingChanges::put_back) if the commit fails.
    pub(crate) fn apply(&mut self, table: &Table<W>) -> Option<(TableDelta<W>, Arc<Vec<Row<W>>>)> {
        normalize(&mut self.coming);
        settle(&mut self.changes);
        if !self.changes.is_empty() {
            return table.update(self.changes.iter().copied());
        }
        if !table.rows.is_empty() {
            return table.update(self.coming.iter().map(|&row| (row, true)));
        }
        let mut rows = std::mem::take(&mut self.coming);
        rows.shrink_to_fit();
        let rows = Arc::new(rows);
        (!rows.is_empty()).then(|| (TableDelta::between(&[], &rows), rows))
    }

    /// Returns the same changes with wider rows.
    pub(crate) fn widened<const V: usize>(self) -> PendingChanges<V> {
        let wide = |row: &Row<W>| Row::new(&row.0);
        PendingChanges {
            coming: self.coming.iter().map(wide).collect(),
            changes: self
                .changes
                .iter()
                .map(|(row, present)| (wide(row), *present))
                .collect(),
        }
    }

    /// Restores the rows that [`PendingChanges::apply`] took.
    pub(crate) fn put_back(&mut self, rows: Arc<Vec<Row<W>>>) {
        self.coming = Arc::unwrap_or_clone(rows);
    }
}

/// Sorts changes by row and keeps the last one of each row.
fn settle<const W: usize>(changes: &mut Vec<(Row<W>, bool)>) {
    changes.sort_by_key(|(row, _)| *row);
    // `dedup_by` keeps the first of equal elements and passes the later one first.
    changes.dedup_by(|later, kept| {
        let same = later.0 == kept.0;
        if same {
            kept.1 = later.1;
        }
        same
    });
}
