//! Subsumption: which rows of a round cease to hold.
// Decision: docs/decisions/language.md#d084

use crate::check::{PredicateId, Rules};
use crate::eval::choice::by_value;
use crate::row::Row;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;
use std::collections::HashSet;

/// The rows of a predicate that have ceased to hold.
pub(crate) struct Dominance<const W: usize> {
    /// The position of the predicate of pairs among the members.
    pub(crate) pairs: usize,
    bases: Vec<BaseType>,
    gone: HashSet<Row<W>>,
}

impl<const W: usize> Dominance<W> {
    /// Returns the state of a predicate with a subsumption; `member` returns the position of a predicate.
    pub(crate) fn of(
        rules: &Rules,
        predicate: PredicateId,
        member: impl Fn(PredicateId) -> Option<usize>,
    ) -> Option<Dominance<W>> {
        let predicate = &rules.predicates[predicate.index()];
        Some(Dominance {
            pairs: member(predicate.subsumption?)?,
            bases: predicate.columns.iter().map(|column| column.base).collect(),
            gone: HashSet::new(),
        })
    }

    /// Returns the number of rows that have ceased to hold.
    pub(crate) fn gone(&self) -> usize {
        self.gone.len()
    }

    /// Removes rows that have ceased to hold before.
    pub(crate) fn keep(&self, rows: &mut Vec<Row<W>>) {
        if !self.gone.is_empty() {
            rows.retain(|row| !self.gone.contains(row));
        }
    }

    /// Returns the rows that cease to hold, given pairs of a weaker and a stronger row.
    pub(crate) fn decide(&mut self, pairs: Vec<Row<W>>, symbols: &Symbols) -> HashSet<Row<W>> {
        let width = self.bases.len();
        let split = |pair: &Row<W>| {
            let (mut weaker, mut stronger) = (Row::ZERO, Row::ZERO);
            weaker.0[..width].copy_from_slice(&pair.0[..width]);
            stronger.0[..width].copy_from_slice(&pair.0[width..2 * width]);
            (weaker, stronger)
        };
        let mut pairs: Vec<(Row<W>, Row<W>)> = pairs.iter().map(split).collect();
        pairs.retain(|(weaker, stronger)| weaker != stronger);
        pairs.sort_by(|(one, _), (other, _)| by_value(&self.bases, &one.0, &other.0, symbols));
        let mut gone = HashSet::new();
        for (weaker, stronger) in pairs {
            if !gone.contains(&weaker) && !gone.contains(&stronger) {
                gone.insert(weaker);
            }
        }
        self.gone.extend(&gone);
        gone
    }
}
