//! Which clauses fired over many states, and which literals never mattered.

use crate::datalog::Session;
use crate::datalog::explain::{ExplainError, Explainer};
use crate::datalog::{ClauseId, Literal, Rules};

/// What is known of the clauses of a program after a number of states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Coverage {
    /// How many states were looked at.
    pub states: u64,
    /// The clauses with a body, hidden ones left out, in the order of the text.
    pub clauses: Vec<ClauseCoverage>,
}

/// What is known of one clause.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ClauseCoverage {
    /// The clause.
    pub clause: ClauseId,
    /// How many rows it derived, all states together.
    pub fired: u64,
    /// In how many states it derived some.
    pub states: u64,
    /// Positions in the body of the literals that never mattered: without one of them, the clause would have derived nothing that
    /// did not hold anyway, in any state. Each is left out alone; of two that say the same, neither matters. Guards of a scope, and
    /// literals that alone bind a variable that is needed, are not asked.
    pub idle: Vec<usize>,
}

impl Coverage {
    /// No states yet.
    pub fn new(rules: &Rules) -> Self {
        let clauses = rules.clauses.iter().zip(0..);
        let counted = clauses
            .filter(|(clause, _)| !clause.body.is_empty() && !rules.relations[clause.head.relation.index()].hidden);
        Coverage {
            states: 0,
            clauses: counted
                .map(|(clause, id)| {
                    let body = clause.body.iter().enumerate();
                    let written = body.filter(|(_, literal)| !matches!(literal, Literal::Guard(_)));
                    ClauseCoverage {
                        clause: ClauseId(id),
                        fired: 0,
                        states: 0,
                        idle: written.map(|(position, _)| position).collect(),
                    }
                })
                .collect(),
        }
    }

    /// Takes into account what a session holds, which must be one of the program of [`Coverage::new`].
    ///
    /// # Errors
    /// If the ways to satisfy a clause are too many to look at.
    pub fn add(&mut self, session: &Session) -> Result<(), ExplainError> {
        self.states += 1;
        let mut explainer = Explainer::new(session);
        for clause in &mut self.clauses {
            let fired = session.fired(clause.clause).len() as u64;
            clause.fired += fired;
            clause.states += u64::from(fired > 0);
            let mut idle = Vec::new();
            for &literal in &clause.idle {
                if explainer.matters(clause.clause, literal)? == Some(false) {
                    idle.push(literal);
                }
            }
            clause.idle = idle;
        }
        Ok(())
    }
}
