//! Changes of a relation that the next commit makes.

use crate::datalog::eval::table::{Table, TableDelta};
use crate::datalog::row::{Row, normalise};
use crate::datalog::value::Value;
use std::sync::Arc;

/// Rows that are to come or to go, in the order in which that was noted; of several changes of one row the last counts.
///
/// Facts mostly come by themselves and into a relation that has none. So as long as no row is to go, the rows that come are a
/// plain list, which becomes the relation's own.
#[derive(Debug, Default)]
pub(crate) struct PendingChanges<const W: usize> {
    coming: Vec<Row<W>>,
    /// All changes, if a row is to go; then `coming` is empty.
    changes: Vec<(Row<W>, bool)>,
}

impl<const W: usize> PendingChanges<W> {
    /// These rows are to come.
    pub(crate) fn of(rows: Vec<Row<W>>) -> Self {
        PendingChanges {
            coming: rows,
            changes: Vec::new(),
        }
    }

    /// How many changes were noted.
    pub(crate) fn len(&self) -> usize {
        self.coming.len() + self.changes.len()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(crate) fn clear(&mut self) {
        self.coming.clear();
        self.changes.clear();
    }

    /// Notes that a row is to come or to go.
    #[inline]
    pub(crate) fn push(&mut self, row: Row<W>, present: bool) {
        if present && self.changes.is_empty() {
            self.coming.push(row);
            return;
        }
        self.changes.extend(self.coming.drain(..).map(|row| (row, true)));
        self.changes.push((row, present));
    }

    /// Notes that rows are to come, which are `arity` words each.
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

    /// Makes room for so many rows more that are to come.
    pub(crate) fn reserve(&mut self, rows: usize) {
        if self.changes.is_empty() {
            self.coming.reserve(rows);
        }
    }

    /// Forgets all changes but the first ones.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.coming.truncate(len);
        self.changes.truncate(len);
    }

    /// What the changes add to a table and remove from it, and its rows afterwards, if it is anything. If the table is empty, the
    /// rows are taken out of here and are to be [put back](PendingChanges::put_back) when the commit fails.
    pub(crate) fn apply(&mut self, table: &Table<W>) -> Option<(TableDelta<W>, Arc<Vec<Row<W>>>)> {
        normalise(&mut self.coming);
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

    /// These are the rows that were taken.
    pub(crate) fn put_back(&mut self, rows: Arc<Vec<Row<W>>>) {
        self.coming = Arc::unwrap_or_clone(rows);
    }
}

/// Keeps of several changes of a row the last one, in the order of rows.
fn settle<const W: usize>(changes: &mut Vec<(Row<W>, bool)>) {
    changes.sort_by_key(|(row, _)| *row);
    // `dedup_by` keeps the first of equal elements and is given the later one first.
    changes.dedup_by(|later, kept| {
        let same = later.0 == kept.0;
        if same {
            kept.1 = later.1;
        }
        same
    });
}
