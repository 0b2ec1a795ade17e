//! Adaptive replanning by the sizes of predicates.
//!
//! Before there are rows, the planner uses the clause alone. When a stratum is evaluated and the predicates that it
//! reads have grown or shrunk by [`FACTOR`], its clauses are replanned with measured sizes.
// Decision: docs/decisions/evaluation.md#d015

use crate::check::PredicateId;
use crate::eval::exec::{Commit, State};
use crate::plan::estimate::Size;
use crate::plan::steps::{Aim, StratumPlan};
use std::sync::Arc;

/// The row counts that a stratum's plans were made for: first of its inputs, then of its members. Empty for plans made
/// before there were rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Basis {
    recompute: Vec<usize>,
    maintain: Vec<usize>,
}

impl Basis {
    fn of(&mut self, aim: Aim) -> &mut Vec<usize> {
        match aim {
            Aim::Recompute => &mut self.recompute,
            Aim::Maintain => &mut self.maintain,
        }
    }
}

/// Smaller predicates count as having this many rows: with fewer rows, every order is cheap.
const ROWS_MIN: usize = 64;

/// Plans stay in use until a predicate grows or shrinks by this factor.
const FACTOR: usize = 4;

/// Whether a plan for `planned` rows still suits `now` rows.
fn is_good(planned: usize, now: usize) -> bool {
    let (planned, now) = (planned.max(ROWS_MIN), now.max(ROWS_MIN));
    now / FACTOR < planned && planned / FACTOR < now
}

impl<const W: usize> State<W> {
    /// Replans the clauses of a stratum if the sizes of its predicates have changed too much.
    pub(crate) fn adapt(&mut self, commit: &mut Commit<'_, W>, (stratum, number): (&StratumPlan, usize), aim: Aim) {
        // The sizes of the members are unknown before a computation from scratch.
        let members: &[PredicateId] = if aim == Aim::Maintain { &stratum.members } else { &[] };
        let predicates = || stratum.inputs.iter().chain(members);
        let rows = |predicate: &PredicateId| match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.len(),
            None => self.tables[predicate.index()].rows.len(),
        };
        let basis = self.bases[number].of(aim);
        let mut planned = basis.iter().copied().chain(std::iter::repeat(0));
        if predicates().all(|predicate| is_good(planned.next().unwrap_or(0), rows(predicate))) {
            return;
        }
        *basis = predicates().map(rows).collect();

        let mut sizes: Vec<Option<Size>> = vec![None; self.tables.len()];
        for predicate in predicates() {
            let arity = commit.plans.indexes.arity(*predicate);
            sizes[predicate.index()] = Some(match &self.narrow[predicate.index()] {
                Some(narrow) => narrow.size(arity),
                None => Size::of(&self.tables[predicate.index()].rows, arity),
            });
        }
        Arc::make_mut(&mut commit.plans).adapt(stratum, aim, &sizes);
        let before = commit
            .changed
            .iter_mut()
            .map(|changed| changed.as_mut().map(|(_, table)| table));
        let tables = self.tables.iter_mut().zip(before).zip(commit.plans.indexes.counts());
        for ((table, before), indexes) in tables {
            table.widen(indexes);
            if let Some(before) = before {
                before.widen(indexes);
            }
            self.copies_max = self.copies_max.max(indexes + 1);
        }
        for (narrow, indexes) in self.narrow.iter_mut().zip(commit.plans.indexes.counts()) {
            narrow.iter_mut().for_each(|narrow| narrow.widen(indexes));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_good_within_a_factor() {
        assert!(is_good(0, 255) && is_good(255, 0) && is_good(100_000, 399_000) && is_good(399_000, 100_000));
        assert!(!is_good(0, 256) && !is_good(256, 0) && !is_good(100_000, 400_000) && !is_good(400_000, 100_000));
    }
}
