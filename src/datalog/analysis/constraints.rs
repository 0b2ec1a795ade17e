//! Integrity constraints on the facts of a session.

use crate::check::{Constraint, DeclaredConstraint, PredicateId};
use crate::codes;
use crate::diag::Diagnostic;
use crate::session::Session;
use crate::symbol::Symbol;
use crate::syntax::ast::BaseType;
use crate::value::{Value, record_text, shown_number};
use std::collections::HashSet;

/// Maximum number of violations reported, one for each constraint.
pub const BROKEN_MAX: usize = 20;

/// Returns the constraints that the facts of the last commit violate, each with one offending row.
pub fn violations(session: &Session) -> Vec<Diagnostic> {
    violations_among(session, |_| true)
}

/// Variant of [`violations`] that skips constraints on predicates for which `known` is false.
pub fn violations_among(session: &Session, known: impl Fn(PredicateId) -> bool) -> Vec<Diagnostic> {
    let mut faults = Vec::new();
    for DeclaredConstraint {
        constraint,
        domain,
        span,
        ..
    } in &session.program().rules().constraints
    {
        let shown = |predicate: PredicateId, row: &[Value]| shown(session, predicate, row);
        let reversed = |row: &[Value]| -> Vec<Value> { row.iter().rev().copied().collect() };
        let found = match *constraint {
            _ if !constraint.predicates().all(&known) => continue,
            Constraint::Disjoint(a, b) => session
                .encoded_rows(a)
                .find(|row| session.contains(b, row))
                .map(|row| format!("both {} and {} hold", shown(a, row), shown(b, row))),
            Constraint::Implies(a, b) => session
                .encoded_rows(a)
                .find(|row| !session.contains(b, row))
                .map(|row| format!("{} holds, {} does not", shown(a, row), shown(b, row))),
            Constraint::Covering(ref predicates) => {
                let covered = |value| predicates.iter().any(|&predicate| session.contains(predicate, [value]));
                outside(session, domain, covered).map(|(predicate, row, value)| {
                    let options: Vec<String> = predicates.iter().map(|&one| shown(one, &[value])).collect();
                    format!("{} holds, none of {} does", shown(predicate, row), options.join(", "))
                })
            }
            Constraint::Reflexive(a) => {
                outside(session, domain, |value| session.contains(a, [value, value])).map(|(predicate, row, value)| {
                    let own = shown(a, &[value, value]);
                    format!("{} holds, {own} does not", shown(predicate, row))
                })
            }
            Constraint::Irreflexive(a) => session
                .encoded_rows(a)
                .find(|row| row[0] == row[1])
                .map(|row| format!("{} holds", shown(a, row))),
            Constraint::Symmetric(a) => session
                .encoded_rows(a)
                .find(|row| !session.contains(a, reversed(row)))
                .map(|row| format!("{} holds, {} does not", shown(a, row), shown(a, &reversed(row)))),
            Constraint::Asymmetric(a) => session
                .encoded_rows(a)
                .find(|row| session.contains(a, reversed(row)))
                .map(|row| match row[0] == row[1] {
                    true => format!("{} holds", shown(a, row)),
                    false => format!("both {} and {} hold", shown(a, row), shown(a, &reversed(row))),
                }),
        };
        if let Some(message) = found
            && faults.len() < BROKEN_MAX
        {
            let fault = Diagnostic::new(codes::CONSTRAINT_VIOLATION, message).at(*span, "declared here");
            faults.push(fault.help("correct the facts, or remove the constraint"));
        }
    }
    faults
}

/// Returns the first value of a domain for which the test fails, with a row that contains it.
fn outside<'s>(
    session: &'s Session,
    domain: &[(PredicateId, usize)],
    holds: impl Fn(Value) -> bool,
) -> Option<(PredicateId, &'s [Value], Value)> {
    let mut passed: HashSet<Value> = HashSet::new();
    for &(predicate, column) in domain {
        for row in session.encoded_rows(predicate) {
            let value = row[column];
            if passed.insert(value) && !holds(value) {
                return Some((predicate, row, value));
            }
        }
    }
    None
}

/// Returns a fact in the notation of rules.
fn shown(session: &Session, predicate: PredicateId, row: &[Value]) -> String {
    let predicate = &session.program().rules().predicates[predicate.index()];
    let values = predicate
        .columns
        .iter()
        .zip(row)
        .map(|(column, value)| match column.base {
            base @ (BaseType::Number | BaseType::Unsigned | BaseType::Float) => {
                shown_number(base, *value, session.symbols())
            }
            BaseType::Record => record_text(*value, session.symbols()),
            BaseType::Symbol => format!("{:?}", session.symbols().resolve(Symbol(value.0)).unwrap_or_default()),
        });
    format!("`{}({})`", predicate.name, values.collect::<Vec<_>>().join(", "))
}
