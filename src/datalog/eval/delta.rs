//! What a commit changed: rows that came and rows that went, by relation.

use std::fmt;
use std::sync::Arc;

use crate::datalog::check::RelId;
use crate::datalog::row::{Row, RowList};
use crate::datalog::value::Value;

/// Rows of one relation, sorted by their words. Cheap to clone: they may be shared with the session they come from.
#[derive(Clone)]
pub struct Rows {
    arity: usize,
    len: usize,
    list: Arc<dyn RowList>,
}

impl Rows {
    /// Of rows that have at least so many words.
    pub(super) fn of<const W: usize>(arity: usize, rows: Arc<Vec<Row<W>>>) -> Self {
        Rows {
            arity,
            len: rows.len(),
            list: rows,
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[Value]> {
        self.range(0..self.len)
    }

    /// The rows at these positions; those that are not there are left out.
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

/// How one relation changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RelationChange {
    /// The relation.
    pub relation: RelId,
    /// Rows that hold now and did not before.
    pub added: Rows,
    /// Rows that held before and do not now.
    pub removed: Rows,
}

/// What a commit changed, in base and derived relations.
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

    /// The relations that changed, in the order of their ids.
    pub fn changes(&self) -> &[RelationChange] {
        &self.changes
    }

    /// How a relation changed, if it did.
    pub fn of(&self, rel: RelId) -> Option<&RelationChange> {
        let position = self.changes.binary_search_by_key(&rel, |change| change.relation).ok()?;
        Some(&self.changes[position])
    }

    /// Whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }
}
