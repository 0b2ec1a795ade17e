//! Loaded predicates with rows narrower than the program's.
//!
//! Facts dominate the memory of many programs, and padding them to the width of the widest predicate may multiply it. So
//! a predicate that no clause derives loads its facts into narrow rows, and joins read these. Narrow rows do not change:
//! the first change after a commit moves the predicate to a table of the program's width.
// Decision: docs/decisions/facts.md#d008

use crate::eval::delta::Rows;
use crate::eval::pending::PendingChanges;
use crate::eval::table::Table;
use crate::plan::estimate::{Shape, Size};
use crate::plan::steps::IndexSpec;
use crate::row::{AnyBatch, ByWidth, NARROW, Row, normalize, read_rows};
use crate::snapshot::{Decoder, SnapshotError};
use crate::value::Value;
use std::sync::Arc;

/// The rows of a loaded predicate.
#[derive(Debug)]
pub(crate) enum NarrowTable {
    Two(Loaded<2>),
    Four(Loaded<4>),
    Eight(Loaded<8>),
}

/// A predicate with rows of `V` words.
#[derive(Debug)]
pub(crate) struct Loaded<const V: usize> {
    table: Table<V>,
    pending: PendingChanges<V>,
    /// The facts in the source.
    source_facts: Vec<Row<V>>,
}

/// The parts of a widened predicate: rows, pending changes, and facts in the source.
pub(crate) type Widened<const W: usize> = (Vec<Row<W>>, PendingChanges<W>, Vec<Row<W>>);

macro_rules! each {
    ($value:expr, $name:ident => $result:expr) => {
        match $value {
            NarrowTable::Two($name) => $result,
            NarrowTable::Four($name) => $result,
            NarrowTable::Eight($name) => $result,
        }
    };
}

impl NarrowTable {
    /// Makes an empty table for a predicate without rules; `None` if its rows are not narrower than those of `width`.
    pub(crate) fn new(arity: usize, width: usize, indexes: usize) -> Option<Self> {
        let narrow = NARROW.into_iter().find(|&narrow| narrow >= arity)?;
        match narrow {
            _ if arity == 0 || narrow >= width => None,
            2 => Some(NarrowTable::Two(Loaded::new(indexes))),
            4 => Some(NarrowTable::Four(Loaded::new(indexes))),
            _ => Some(NarrowTable::Eight(Loaded::new(indexes))),
        }
    }

    /// Adds a fact of the source.
    pub(crate) fn add_source_fact(&mut self, words: &[Value]) {
        each!(self, loaded => loaded.source_facts.push(Row::new(words)));
    }

    /// Makes the facts of the source pending. The first commit inserts them like any others.
    pub(crate) fn insert_source_facts(&mut self) {
        each!(self, loaded => {
            normalize(&mut loaded.source_facts);
            loaded.pending = PendingChanges::of(loaded.source_facts.clone());
        });
    }

    /// Records a change for the first commit.
    pub(crate) fn change(&mut self, row: &[Value], present: bool) {
        each!(self, loaded => {
            let row = Row::new(row);
            if present || loaded.source_facts.binary_search(&row).is_err() {
                loaded.pending.push(row, present);
            }
        });
    }

    /// Records insertions for the first commit.
    pub(crate) fn insert_all(&mut self, words: &[Value], arity: usize) {
        each!(self, loaded => loaded.pending.extend(words, arity));
    }

    /// Reserves memory for `rows` more insertions.
    pub(crate) fn reserve(&mut self, rows: usize) {
        each!(self, loaded => loaded.pending.reserve(rows));
    }

    /// The number of pending changes.
    pub(crate) fn pending(&self) -> usize {
        each!(self, loaded => loaded.pending.len())
    }

    /// The bytes of the pending changes.
    pub(crate) fn pending_bytes(&self) -> u64 {
        each!(self, loaded => loaded.pending.bytes())
    }

    /// Drops all but the first `len` pending changes.
    pub(crate) fn forget(&mut self, len: usize) {
        each!(self, loaded => loaded.pending.truncate(len));
    }

    /// Makes the pending changes in an empty table. Returns the rows, if there are any.
    pub(crate) fn load(&mut self, arity: usize) -> Option<Rows> {
        each!(self, loaded => {
            let (_, rows) = loaded.pending.apply(&loaded.table)?;
            loaded.table = loaded.table.reloaded(Arc::clone(&rows));
            Some(Rows::of(arity, rows))
        })
    }

    /// Drops the pending changes.
    pub(crate) fn clear_pending(&mut self) {
        each!(self, loaded => loaded.pending.clear());
    }

    /// Undoes [`NarrowTable::load`]: its rows are pending again, unless the changes still are.
    pub(crate) fn unload(&mut self) {
        each!(self, loaded => {
            let rows = std::mem::take(&mut loaded.table.rows);
            loaded.table = loaded.table.reloaded(Arc::default());
            if loaded.pending.is_empty() {
                loaded.pending.put_back(rows);
            }
        });
    }

    /// The number of rows.
    pub(crate) fn len(&self) -> usize {
        each!(self, loaded => loaded.table.rows.len())
    }

    /// The rows, which the result shares.
    pub(crate) fn rows(&self, arity: usize) -> Rows {
        each!(self, loaded => Rows::of(arity, Arc::clone(&loaded.table.rows)))
    }

    /// Adds the pending changes to `words`, as [`PendingChanges::list`] does.
    pub(crate) fn changes(&self, arity: usize, words: &mut Vec<Value>) {
        each!(self, loaded => loaded.pending.list(arity, words));
    }

    /// Reads saved rows.
    pub(crate) fn restore(
        &mut self,
        input: &mut Decoder<'_>,
        count: u64,
        interned: &[bool],
        known: usize,
    ) -> Result<(), SnapshotError> {
        each!(self, loaded => {
            let rows = read_rows(input, count, interned, known)?;
            loaded.table = loaded.table.reloaded(rows.into());
        });
        Ok(())
    }

    /// The words of a row, with padding.
    pub(crate) fn row(&self, position: usize) -> &[Value] {
        each!(self, loaded => &loaded.table.rows[position].0)
    }

    /// Whether the predicate contains the row.
    pub(crate) fn contains(&self, row: &[Value]) -> bool {
        each!(self, loaded => loaded.table.rows.binary_search(&Row::new(row)).is_ok())
    }

    /// The bytes of the rows and indexes.
    pub(crate) fn bytes(&self) -> u64 {
        each!(self, loaded => loaded.table.bytes())
    }

    /// The bytes that building the index takes.
    pub(crate) fn missing_bytes(&self, spec: &IndexSpec) -> u64 {
        each!(self, loaded => loaded.table.missing_bytes(spec))
    }

    /// Extends the table to `indexes` indexes.
    pub(crate) fn widen(&mut self, indexes: usize) {
        each!(self, loaded => loaded.table.widen(indexes));
    }

    /// The rows in the order of an index.
    pub(crate) fn batch<const W: usize>(&self, spec: &IndexSpec) -> AnyBatch<'_, W> {
        match self {
            NarrowTable::Two(loaded) => ByWidth::Two(loaded.table.batch(spec)),
            NarrowTable::Four(loaded) => ByWidth::Four(loaded.table.batch(spec)),
            NarrowTable::Eight(loaded) => ByWidth::Eight(loaded.table.batch(spec)),
        }
    }

    /// The shape of the rows.
    pub(crate) fn shape<const W: usize>(&self) -> Shape<W> {
        each!(self, loaded => Shape::of(&loaded.table.rows))
    }

    /// The measured size of the rows.
    pub(crate) fn size(&self, arity: usize) -> Size {
        each!(self, loaded => Size::of(&loaded.table.rows, arity))
    }

    /// Returns all that the predicate consists of in rows of the program's width.
    pub(crate) fn widened<const W: usize>(self) -> Widened<W> {
        each!(self, loaded => {
            (wide(&loaded.table.rows), loaded.pending.widened(), wide(&loaded.source_facts))
        })
    }
}

fn wide<const V: usize, const W: usize>(rows: &[Row<V>]) -> Vec<Row<W>> {
    rows.iter().map(|row| Row::new(&row.0)).collect()
}

impl<const V: usize> Loaded<V> {
    fn new(indexes: usize) -> Self {
        Loaded {
            table: Table::new(Vec::new(), indexes),
            pending: PendingChanges::default(),
            source_facts: Vec::new(),
        }
    }
}
