//! Keys of predicates, and limits of their sizes: which of the rows of a round hold.
//!
//! ```text
//! .decl P(x: number, y: number) choice-domain x    of the rows with one x, the first one holds
//! ```
//!
//! Rows of an earlier round come before those of a later one. Within a round, their values decide.
// Decision: docs/decisions/language.md#d083

use crate::check::{PredicateId, Rules};
use crate::row::Row;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use crate::value::{Value, compare};
use std::cmp::Ordering;
use std::collections::HashSet;

/// The keys of a predicate, and their values in the rows that hold.
pub(crate) struct Choice {
    keys: Vec<(Vec<usize>, HashSet<Vec<Value>>)>,
    bases: Vec<BaseType>,
}

impl Choice {
    /// Returns the keys of a predicate if it has some.
    pub(crate) fn of(rules: &Rules, predicate: PredicateId) -> Option<Choice> {
        let predicate = &rules.predicates[predicate.index()];
        let keys = predicate
            .choices
            .iter()
            .map(|columns| (columns.clone(), HashSet::new()));
        (!predicate.choices.is_empty()).then(|| Choice {
            keys: keys.collect(),
            bases: predicate.columns.iter().map(|column| column.base).collect(),
        })
    }

    /// Returns about the memory of the keys, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        let of = |(columns, held): &(Vec<usize>, HashSet<Vec<Value>>)| {
            held.capacity() * (size_of::<Vec<Value>>() + columns.len() * size_of::<Value>())
        };
        self.keys.iter().map(of).sum()
    }

    /// Keeps the rows of a round that hold. They must be different.
    pub(crate) fn keep<const W: usize>(&mut self, mut rows: Vec<Row<W>>, symbols: &Symbols) -> Vec<Row<W>> {
        rows.sort_by(|one, other| by_value(&self.bases, &one.0, &other.0, symbols));
        rows.retain(|row| {
            let of = |columns: &[usize]| columns.iter().map(|&column| row.0[column]).collect::<Vec<Value>>();
            if self.keys.iter().any(|(columns, held)| held.contains(&of(columns))) {
                return false;
            }
            for (columns, held) in &mut self.keys {
                held.insert(of(columns));
            }
            true
        });
        rows.sort_unstable();
        rows
    }
}

/// Orders rows by their values.
pub(crate) fn by_value(bases: &[BaseType], one: &[Value], other: &[Value], symbols: &Symbols) -> Ordering {
    let columns = bases.iter().zip(one.iter().zip(other));
    let orders = columns.map(|(&base, (&one, &other))| compare(base, one, other, symbols));
    orders.fold(Ordering::Equal, Ordering::then)
}
