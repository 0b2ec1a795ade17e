//! Propositional clauses, and the search for a model of them: a wrapper of batsat.
//!
//! Deterministic, and bounded by a number of conflicts. A variable that nothing forces is tried as false first, so models have few
//! true variables.

use batsat::{Callbacks, ClauseKind, SolverInterface, lbool};

/// A variable or its negation.
pub(super) use batsat::Lit;

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// There is a model; see [`Solver::is_true`].
    Satisfiable,
    /// There is none.
    Unsatisfiable,
    /// The conflicts were used up.
    Unknown,
}

/// Stops a search after a number of conflicts: each adds one clause.
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

/// Clauses and a search for a model of all of them.
pub(super) struct Solver {
    inner: batsat::Solver<Bound>,
    /// The model of the last search that found one, by variable.
    model: Vec<lbool>,
}

impl Solver {
    pub(super) fn new() -> Solver {
        Solver {
            inner: batsat::Solver::new(batsat::SolverOpts::default(), Bound { used: 0, most: 0 }),
            model: Vec::new(),
        }
    }

    /// A new variable.
    pub(super) fn fresh(&mut self) -> Lit {
        Lit::new(self.inner.new_var(lbool::FALSE, true), true)
    }

    /// Whether the literal is true in the model found last.
    pub(super) fn is_true(&self, lit: Lit) -> bool {
        let value = self.model.get(lit.var().idx() as usize);
        value.is_some_and(|&value| value == lbool::new(lit.sign()))
    }

    /// Adds a clause: one of the literals holds.
    pub(super) fn add(&mut self, lits: &[Lit]) {
        self.inner.add_clause_reuse(&mut lits.to_vec());
    }

    /// Searches for a model in which the assumptions hold. Every conflict takes one of `conflicts`.
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The solver against trying everything.
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
                let bits = (0..8).map(|variable| u32::from(solver.is_true(variables[variable])) << variable).sum::<u32>();
                prop_assert!(model(&bits));
            }
            // Asked again without assumptions.
            let exists = (0..256_u32).any(|bits| clauses.iter().all(|clause| clause.iter().any(|part| holds(bits, part))));
            let outcome = solver.solve(&[], &mut 10_000);
            prop_assert_eq!(outcome, if exists { Outcome::Satisfiable } else { Outcome::Unsatisfiable });
        }
    }
}
