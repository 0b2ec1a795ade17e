//! The changes of a commit: the rows added and removed, by predicate.

use std::fmt;
use std::sync::Arc;

use crate::check::PredicateId;
use crate::row::{Row, RowList};
use crate::value::Value;

/// Rows of one predicate, sorted by their words. Cheap to clone: clones share the rows, also with the session.
#[derive(Clone)]
pub struct Rows {
    arity: usize,
    len: usize,
    list: Arc<dyn RowList>,
}

impl Rows {
    /// Wraps rows whose first `arity` words are the columns; the rest is padding.
    pub(super) fn of<const W: usize>(arity: usize, rows: Arc<Vec<Row<W>>>) -> Self {
        Rows {
            arity,
            len: rows.len(),
            list: rows,
        }
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[Value]> {
        self.range(0..self.len)
    }

    /// Returns the rows at these positions. Positions beyond the end are skipped.
    pub fn range(&self, positions: std::ops::Range<usize>) -> impl Iterator<Item = &[Value]> {
        let end = positions.end.min(self.len);
        (positions.start..end).map(|position| &self.list.row(position)[..self.arity])
    }
}

impl Default for Rows {
    fn default() -> Self {
        Rows::of::<2>(0, Arc::default())
    }
}

impl PartialEq for Rows {
    fn eq(&self, other: &Self) -> bool {
        self.len == other.len && self.iter().eq(other.iter())
    }
}

impl Eq for Rows {}

impl fmt::Debug for Rows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// The changes of one predicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PredicateChange {
    /// The predicate.
    pub predicate: PredicateId,
    /// The rows that the commit added.
    pub added: Rows,
    /// The rows that the commit removed.
    pub removed: Rows,
}

/// The changes of a commit in base and derived predicates.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Delta {
    changes: Vec<PredicateChange>,
}

impl Delta {
    pub(super) fn push(&mut self, predicate: PredicateId, added: Rows, removed: Rows) {
        self.changes.push(PredicateChange {
            predicate,
            added,
            removed,
        });
    }

    /// Returns the predicates that changed, by id.
    pub fn changes(&self) -> &[PredicateChange] {
        &self.changes
    }

    /// Returns the changes of a predicate, or `None` if it did not change.
    pub fn of(&self, id: PredicateId) -> Option<&PredicateChange> {
        let position = self.changes.binary_search_by_key(&id, |change| change.predicate).ok()?;
        Some(&self.changes[position])
    }

    /// Returns whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }
}
