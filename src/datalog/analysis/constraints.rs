//! Integrity constraints on the facts of a session.

use crate::datalog::check::{Constraint, RelId};
use crate::datalog::session::Session;
use crate::datalog::syntax::ast::BaseType;
use crate::datalog::value::{Value, print_float};
use crate::diag::{Code, Diagnostic};
use crate::symbol::Symbol;

/// Maximum number of violations reported, one for each constraint.
pub const BROKEN_MAX: usize = 20;

/// Returns the constraints that the facts of the last commit violate, each with one offending row.
pub fn violations(session: &Session) -> Vec<Diagnostic> {
    let mut faults = Vec::new();
    for constraint in &session.program().rules().constraints {
        let reversed = |row: &[Value]| -> Vec<Value> { row.iter().rev().copied().collect() };
        let found = match constraint.constraint {
            Constraint::Disjoint(a, b) => session
                .rows(a)
                .find(|row| session.contains(b, row))
                .map(|row| format!("both {} and {} hold", shown(session, a, row), shown(session, b, row))),
            Constraint::Implies(a, b) => session
                .rows(a)
                .find(|row| !session.contains(b, row))
                .map(|row| format!("{} holds, {} does not", shown(session, a, row), shown(session, b, row))),
            Constraint::Irreflexive(a) => session
                .rows(a)
                .find(|row| row[0] == row[1])
                .map(|row| format!("{} holds", shown(session, a, row))),
            Constraint::Symmetric(a) => session
                .rows(a)
                .find(|row| !session.contains(a, &reversed(row)))
                .map(|row| {
                    let other = shown(session, a, &reversed(row));
                    format!("{} holds, {other} does not", shown(session, a, row))
                }),
        };
        if let Some(message) = found
            && faults.len() < BROKEN_MAX
        {
            let fault = Diagnostic::new(Code::CONSTRAINT_VIOLATION, message).at(constraint.span, "declared here");
            faults.push(fault.help("correct the facts, or remove the constraint"));
        }
    }
    faults
}

/// Returns a fact in the notation of rules.
fn shown(session: &Session, relation: RelId, row: &[Value]) -> String {
    let relation = &session.program().rules().relations[relation.index()];
    let values = relation
        .columns
        .iter()
        .zip(row)
        .map(|(column, value)| match column.base {
            BaseType::Number => value.as_number().to_string(),
            BaseType::Unsigned => value.0.to_string(),
            BaseType::Float => print_float(value.as_float()),
            BaseType::Symbol => format!("{:?}", session.symbols().text(Symbol(value.0)).unwrap_or_default()),
        });
    format!("`{}({})`", relation.name, values.collect::<Vec<_>>().join(", "))
}
