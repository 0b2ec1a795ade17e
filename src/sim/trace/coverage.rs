//! Rule coverage over many states: which clauses fired, when, and which literals never mattered.

use crate::datalog::explain::{ExplainError, Explainer};
use crate::datalog::{ClauseId, Literal, Rules, Session, Value};
use std::collections::BTreeMap;

/// The ticks in which one clause derived each of its rows.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Firings {
    /// The clause.
    pub clause: ClauseId,
    /// For each row that it derived, the first and last ticks of the runs of successive ticks, in order.
    pub rows: BTreeMap<Vec<Value>, Vec<(u64, u64)>>,
}

impl Firings {
    /// Creates the firings of a clause in no tick.
    pub fn new(clause: ClauseId) -> Self {
        Firings {
            clause,
            rows: BTreeMap::new(),
        }
    }

    /// Adds those rows that the clause derives in a tick for which `counts` returns true. Ticks must ascend.
    pub fn add(&mut self, session: &Session, tick: u64, counts: impl Fn(&[Value]) -> bool) {
        for row in session.fired(self.clause).into_iter().filter(|row| counts(row)) {
            let runs = self.rows.entry(row).or_default();
            match runs.last_mut() {
                Some((_, last)) if *last + 1 == tick => *last = tick,
                _ => runs.push((tick, tick)),
            }
        }
    }

    /// Returns the number of rows that it derived, summed over all ticks.
    pub fn count(&self) -> u64 {
        self.rows.values().flatten().map(|(first, last)| last - first + 1).sum()
    }

    /// Returns the number of ticks in which it derived a row.
    pub fn ticks(&self) -> u64 {
        let mut runs: Vec<(u64, u64)> = self.rows.values().flatten().copied().collect();
        runs.sort_unstable();
        let (mut total, mut next) = (0, 0);
        for (first, last) in runs {
            let first = first.max(next);
            if first <= last {
                total += last - first + 1;
                next = last + 1;
            }
        }
        total
    }
}

/// The coverage of a program's clauses over a number of states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Coverage {
    /// The number of states.
    pub states: u64,
    /// The visible clauses with a body, in source order.
    pub clauses: Vec<ClauseCoverage>,
}

/// The coverage of one clause.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ClauseCoverage {
    /// The clause.
    pub clause: ClauseId,
    /// The number of rows that it derived, summed over all states.
    pub fired: u64,
    /// The number of states in which it derived a row.
    pub states: u64,
    /// Positions in the body of the literals that never mattered.
    ///
    /// Without such a literal, the clause derives nothing in any state that does not hold anyway. Each literal is
    /// tested alone: of two equivalent literals, neither matters. Guards of a scope, and literals that alone bind a
    /// needed variable, are not tested.
    pub idle: Vec<usize>,
}

impl Coverage {
    /// Creates the coverage of zero states.
    pub fn new(rules: &Rules) -> Self {
        let clauses = rules.clauses.iter().zip(0..);
        let counted = clauses
            .filter(|(clause, _)| !clause.body.is_empty() && !rules.predicates[clause.head.predicate.index()].hidden);
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

    /// Adds the state of a session. The session must belong to the program of [`Coverage::new`].
    ///
    /// # Errors
    /// If enumerating the ways to satisfy a clause exceeds the limit of [`Explainer`].
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
