//! `.disjoint`, `.implies`, `.irreflexive`, `.symmetric`: what the author constraints of the facts of base predicates.

use crate::diag::{Code, Diagnostic, Faults, Span};

use crate::datalog::check::names::Names;
use crate::datalog::check::rules::{Constraint, DeclaredConstraint, RelId};
use crate::datalog::syntax::ast;
use crate::datalog::syntax::ast::{ConstraintKind, Item, Name};

/// More constraints are refused: `.disjoint` makes one of every pair.
const MAX_CONSTRAINTS: usize = 10_000;

/// Looks names up and refuses constraints that cannot be kept. The clauses must have been checked before, so that it is known what
/// is derived.
pub(crate) fn check(items: &[Item], names: &mut Names, faults: &mut Faults) -> Vec<DeclaredConstraint> {
    let mut constraints = Vec::new();
    for item in items {
        let Item::Constraint(constraint) = item else { continue };
        let found: Vec<Option<RelId>> = (constraint.names.iter())
            .map(|name| {
                names
                    .predicate(name)
                    .filter(|&relation| usable(relation, name, names, faults))
            })
            .collect();
        let pairs: usize = found.len() * found.len().saturating_sub(1) / 2;
        if constraints.len() + pairs.max(found.len()) > MAX_CONSTRAINTS {
            let fault = Diagnostic::new(Code::LIMIT_EXCEEDED, "too many constraints")
                .at(constraint.place.0, "")
                .note(format!(
                    "at most {MAX_CONSTRAINTS} are possible; `.disjoint` makes one of every pair"
                ));
            faults.push(fault);
            break;
        }
        let span = constraint.place.0;
        match constraint.kind {
            ConstraintKind::Disjoint => {
                for (later, name) in constraint.names.iter().enumerate() {
                    for earlier in 0..later {
                        if let Some((a, b)) = pair(found[earlier], found[later], constraint, name, names, faults) {
                            constraints.push(DeclaredConstraint {
                                constraint: Constraint::Disjoint(a, b),
                                span,
                            });
                        }
                    }
                }
            }
            ConstraintKind::Implies => {
                if let Some((a, b)) = pair(found[0], found[1], constraint, &constraint.names[1], names, faults) {
                    constraints.push(DeclaredConstraint {
                        constraint: Constraint::Implies(a, b),
                        span,
                    });
                }
            }
            ConstraintKind::Irreflexive | ConstraintKind::Symmetric => {
                for (relation, name) in found.into_iter().zip(&constraint.names) {
                    let Some(relation) =
                        relation.filter(|&relation| relates(relation, name, constraint, names, faults))
                    else {
                        continue;
                    };
                    let constraint = match constraint.kind {
                        ConstraintKind::Symmetric => Constraint::Symmetric(relation),
                        _ => Constraint::Irreflexive(relation),
                    };
                    constraints.push(DeclaredConstraint { constraint, span });
                }
            }
        }
    }
    constraints
}

fn refuse(message: String, at: Span, relation: RelId, names: &Names) -> Diagnostic {
    let fault = Diagnostic::new(Code::INVALID_CONSTRAINT, message)
        .at(at, "")
        .also(names.relation(relation).span, "declared here");
    fault.note(format!("the declaration is `{}`", names.signature_text(relation)))
}

/// Reports constraints on derived predicates: their rules already say what is true of them.
fn usable(relation: RelId, name: &Name, names: &Names, faults: &mut Faults) -> bool {
    let signature = &names.signatures[relation.index()];
    if names.relation(relation).derived && signature.input.is_some() {
        return false; // reported as an input that is derived
    }
    if names.relation(relation).derived {
        let message = format!("`{}` is derived, so what is true of it follows from rules", name.text);
        let fault = refuse(message, name.place.0, relation, names);
        faults.push(fault.help("constraints are about predicates that have facts only"));
        return false;
    }
    signature.columns.is_some()
}

/// The two predicates, if a row of one can be a row of the other.
fn pair(
    first: Option<RelId>,
    second: Option<RelId>,
    constraint: &ast::ConstraintDecl,
    name: &Name,
    names: &Names,
    faults: &mut Faults,
) -> Option<(RelId, RelId)> {
    let (first, second) = (first?, second?);
    let kind = constraint.kind.name();
    if first == second {
        let message = format!("`.{kind}` names `{}` twice", name.text);
        faults.push(refuse(message, name.place.0, second, names));
        return None;
    }
    let [left, right] = [first, second].map(|relation| &names.relation(relation).columns);
    let fits = left.len() == right.len() && left.iter().zip(right).all(|(a, b)| names.meet(a.ty, b.ty).is_some());
    if !fits {
        let other = &names.relation(first).name;
        let message = format!("`{other}` and `{}` have different columns", name.text);
        let fault = refuse(message, name.place.0, second, names).also(names.relation(first).span, "the other one");
        faults.push(fault);
    }
    fits.then_some((first, second))
}

/// Whether the predicate relates things of one kind.
fn relates(relation: RelId, name: &Name, constraint: &ast::ConstraintDecl, names: &Names, faults: &mut Faults) -> bool {
    let columns = &names.relation(relation).columns;
    let fits = match columns.as_slice() {
        [a, b] => names.meet(a.ty, b.ty).is_some(),
        _ => false,
    };
    if !fits {
        let message = format!(
            "`{}` cannot be {}: it has not two columns of one type",
            name.text,
            constraint.kind.name()
        );
        faults.push(refuse(message, name.place.0, relation, names));
    }
    fits
}
