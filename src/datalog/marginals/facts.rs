//! The given facts with their probabilities, and rows of a session.

use crate::check::PredicateId;
use crate::session::Session;
use crate::value::Value;
use smallvec::SmallVec;
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// The rows of [`Marginals::set_rows`](super::Marginals::set_rows).
pub(super) type AskedRows = BTreeSet<Box<[Value]>>;

/// The words of a fact.
pub(super) type FactRow = SmallVec<[Value; 4]>;

/// The facts of the input predicates, with their probabilities.
pub(super) struct FactTables {
    /// By predicate: the rows, and whether they are sorted, each once. The last of equal rows counts.
    tables: Vec<(Vec<(FactRow, f64)>, bool)>,
}

impl FactTables {
    pub(super) fn new(predicates: usize) -> FactTables {
        FactTables {
            tables: vec![(Vec::new(), true); predicates],
        }
    }

    pub(super) fn insert(&mut self, to: PredicateId, row: FactRow, probability: f64) {
        let (rows, sorted) = &mut self.tables[to.index()];
        *sorted &= rows.last().is_none_or(|(last, _)| *last < row);
        rows.push((row, probability));
    }

    pub(super) fn remove(&mut self, to: PredicateId, row: &[Value]) {
        self.sort();
        let (rows, _) = &mut self.tables[to.index()];
        if let Ok(at) = rows.binary_search_by(|(known, _)| (**known).cmp(row)) {
            rows.remove(at);
        }
    }

    pub(super) fn clear(&mut self) {
        for (rows, sorted) in &mut self.tables {
            rows.clear();
            *sorted = true;
        }
    }

    pub(super) fn sort(&mut self) {
        for (rows, sorted) in self.tables.iter_mut().filter(|(_, sorted)| !sorted) {
            // The order of equal rows stays.
            rows.sort_by(|(one, _), (other, _)| one.cmp(other));
            rows.reverse();
            rows.dedup_by(|(one, _), (other, _)| one == other);
            rows.reverse();
            *sorted = true;
        }
    }

    pub(super) fn len(&self) -> usize {
        self.tables.iter().map(|(rows, _)| rows.len()).sum()
    }

    pub(super) fn of(&self, predicate: PredicateId) -> &[(FactRow, f64)] {
        &self.tables[predicate.index()].0
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (PredicateId, &[Value], f64)> {
        let tables = (0..).map(PredicateId).zip(&self.tables);
        tables.flat_map(|(id, (rows, _))| rows.iter().map(move |(row, probability)| (id, &**row, *probability)))
    }
}

/// Returns the rows of a predicate that are asked for, with their positions.
pub(super) fn asked_rows<'s>(
    session: &'s Session,
    predicate: PredicateId,
    asked: Option<&AskedRows>,
) -> Vec<(usize, &'s [Value])> {
    match asked {
        None => session.encoded_rows(predicate).enumerate().collect(),
        Some(asked) => {
            let found = asked
                .iter()
                .filter_map(|row| find_row(session, predicate, row))
                .map(|at| at as usize);
            found.map(|at| (at, session.row(predicate, at))).collect()
        }
    }
}

/// Returns the position of a row.
pub(super) fn find_row(session: &Session, predicate: PredicateId, wanted: &[Value]) -> Option<u32> {
    let (mut low, mut high) = (0, session.len(predicate));
    while low < high {
        let middle = low.midpoint(high);
        match session.row(predicate, middle).cmp(wanted) {
            Ordering::Less => low = middle + 1,
            Ordering::Equal => return u32::try_from(middle).ok(),
            Ordering::Greater => high = middle,
        }
    }
    None
}
