//! The changes of a commit: the rows added and removed, by relation.

use std::fmt;
use std::sync::Arc;

use crate::check::RelId;
use crate::row::{Row, RowList};
use crate::value::Value;

/// Rows of one relation, sorted by their words. Cheap to clone: clones share the rows, also with the session.
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

/// The changes of one relation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RelationChange {
    /// The relation.
    pub relation: RelId,
    /// The rows that the commit added.
    pub added: Rows,
    /// The rows that the commit removed.
    pub removed: Rows,
}

/// The changes of a commit in base and derived relations.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Delta {
    changes: Vec<RelationChange>,
}

impl Delta {
    pub(super) fn push(&mut self, relation: RelId, added: Rows, removed: Rows) {
        self.changes.push(RelationChange {
            relation,
            added,
            removed,
        });
    }

    /// Returns the relations that changed, by id.
    pub fn changes(&self) -> &[RelationChange] {
        &self.changes
    }

    /// Returns the changes of a relation, or `None` if it did not change.
    pub fn of(&self, rel: RelId) -> Option<&RelationChange> {
        let position = self.changes.binary_search_by_key(&rel, |change| change.relation).ok()?;
        Some(&self.changes[position])
    }

    /// Returns whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }
}
