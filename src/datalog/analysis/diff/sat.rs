//! Propositional clauses and the search for a model: a wrapper of batsat.
//!
//! The search is deterministic and bounded by a number of conflicts. It tries unforced variables as false first, so
//! models have few true variables.
// Decision: docs/decisions/analysis.md#d055

use batsat::{Callbacks, ClauseKind, SolverInterface, lbool};

/// A variable or its negation.
pub(super) use batsat::Lit;

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// A model exists; see [`Solver::is_true`].
    Satisfiable,
    /// No model exists.
    Unsatisfiable,
    /// The search reached its limit of conflicts.
    Unknown,
}

/// Stops a search after a number of conflicts, each of which learns one clause.
struct Bound {
    used: u64,
    most: u64,
}

impl Callbacks for Bound {
    fn on_new_clause(&mut self, _: &[Lit], kind: ClauseKind) {
        self.used += u64::from(kind == ClauseKind::Learnt);
    }

    fn stop(&self) -> bool {
        self.used > self.most
    }
}

/// A set of clauses with a search for a model.
pub(super) struct Solver {
    inner: batsat::Solver<Bound>,
    /// The model that the last successful search found, by variable.
    model: Vec<lbool>,
}

impl Solver {
    pub(super) fn new() -> Solver {
        Solver {
            inner: batsat::Solver::new(batsat::SolverOpts::default(), Bound { used: 0, most: 0 }),
            model: Vec::new(),
        }
    }

    /// Creates a variable.
    pub(super) fn fresh(&mut self) -> Lit {
        Lit::new(self.inner.new_var(lbool::FALSE, true), true)
    }

    /// Returns whether the literal is true in the last model.
    pub(super) fn is_true(&self, lit: Lit) -> bool {
        let value = self.model.get(lit.var().idx() as usize);
        value.is_some_and(|&value| value == lbool::new(lit.sign()))
    }

    /// Adds a clause: a disjunction of literals.
    pub(super) fn add(&mut self, lits: &[Lit]) {
        self.inner.add_clause_reuse(&mut lits.to_vec());
    }

    /// Searches for a model that satisfies the assumptions. Every conflict decrements `conflicts`.
    pub(super) fn solve(&mut self, assumptions: &[Lit], conflicts: &mut u64) -> Outcome {
        *self.inner.cb_mut() = Bound {
            used: 0,
            most: *conflicts,
        };
        let result = self.inner.solve_limited(assumptions);
        *conflicts = conflicts.saturating_sub(self.inner.cb().used);
        if result == lbool::TRUE {
            self.model = self.inner.get_model().to_vec();
            Outcome::Satisfiable
        } else if result == lbool::FALSE {
            Outcome::Unsatisfiable
        } else {
            Outcome::Unknown
        }
    }

    /// Returns whether the last search, which found no model, used this assumption.
    pub(super) fn has_failed(&self, assumption: Lit) -> bool {
        self.inner.unsat_core_contains_var(assumption.var())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::cases;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]

        /// Compares the solver with an exhaustive search.
        #[test]
        fn finds_a_model_exactly_if_there_is_one(
            clauses in proptest::collection::vec(proptest::collection::vec((0..8_u32, any::<bool>()), 1..4), 0..40),
            assumed in proptest::collection::vec((0..8_u32, any::<bool>()), 0..3),
        ) {
            let mut solver = Solver::new();
            let variables: Vec<Lit> = (0..8).map(|_| solver.fresh()).collect();
            let lit = |&(variable, negated): &(u32, bool)| {
                let lit = variables[variable as usize];
                if negated { !lit } else { lit }
            };
            for clause in &clauses {
                solver.add(&clause.iter().map(lit).collect::<Vec<_>>());
            }
            let holds = |bits: u32, &(variable, negated): &(u32, bool)| (bits >> variable & 1 == 1) != negated;
            let model = |bits: &u32| {
                clauses.iter().all(|clause| clause.iter().any(|part| holds(*bits, part)))
                    && assumed.iter().all(|part| holds(*bits, part))
            };
            let assumptions: Vec<Lit> = assumed.iter().map(lit).collect();
            let outcome = solver.solve(&assumptions, &mut 10_000);
            let exists = (0..256).any(|bits| model(&bits));
            prop_assert_eq!(outcome, if exists { Outcome::Satisfiable } else { Outcome::Unsatisfiable });
            if exists {
                let bit = |variable: usize| u32::from(solver.is_true(variables[variable])) << variable;
                let bits = (0..8).map(bit).sum::<u32>();
                prop_assert!(model(&bits));
            }
            // A second search, without assumptions.
            let is_model = |bits| clauses.iter().all(|clause| clause.iter().any(|part| holds(bits, part)));
            let exists = (0..256_u32).any(is_model);
            let outcome = solver.solve(&[], &mut 10_000);
            prop_assert_eq!(outcome, if exists { Outcome::Satisfiable } else { Outcome::Unsatisfiable });
        }
    }
}
