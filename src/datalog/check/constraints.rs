//! Integrity constraints, such as `.disjoint` and `.reflexive`, on the facts of base predicates.
// Decision: docs/decisions/language.md#d034

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, Span};

use crate::check::names::Names;
use crate::check::rules::{Constraint, DeclaredConstraint, PredicateId, TypeId};
use crate::syntax::ast;
use crate::syntax::ast::{ConstraintKind, Item, Name};

/// Maximum number of constraints. `.disjoint` makes one of every pair of predicates.
const MAX_CONSTRAINTS: usize = 10_000;

/// Resolves the names of constraints and reports constraints that make no sense. Requires checked clauses, which
/// determine the derived predicates.
pub(crate) fn check(items: &[Item], names: &mut Names, faults: &mut Faults) -> Vec<DeclaredConstraint> {
    let mut constraints = Vec::new();
    for item in items {
        let Item::Constraint(constraint) = item else { continue };
        let found: Vec<Option<PredicateId>> = (constraint.names.iter())
            .map(|name| {
                names
                    .resolve(name)
                    .filter(|&predicate| usable(predicate, name, names, faults))
            })
            .collect();
        let pairs: usize = found.len() * found.len().saturating_sub(1) / 2;
        if constraints.len() + pairs.max(found.len()) > MAX_CONSTRAINTS {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "too many constraints")
                .at(constraint.place.0, "")
                .note(format!(
                    "a program has at most {MAX_CONSTRAINTS}; `.disjoint` makes one of every pair"
                ));
            faults.push(fault);
            break;
        }
        let span = constraint.place.0;
        let mut declare = |constraint, domain| {
            constraints.push(DeclaredConstraint {
                constraint,
                domain,
                span,
                inferred: false,
            });
        };
        match constraint.kind {
            ConstraintKind::Disjoint => {
                for (later, name) in constraint.names.iter().enumerate() {
                    for earlier in 0..later {
                        if let Some((a, b)) = pair(found[earlier], found[later], constraint, name, names, faults) {
                            declare(Constraint::Disjoint(a, b), Vec::new());
                        }
                    }
                }
            }
            ConstraintKind::Implies => {
                if let Some((a, b)) = pair(found[0], found[1], constraint, &constraint.names[1], names, faults) {
                    declare(Constraint::Implies(a, b), Vec::new());
                }
            }
            ConstraintKind::Covering => {
                if let Some((predicates, ty)) = cover(&found, constraint, names, faults) {
                    declare(Constraint::Covering(predicates), domain(ty, names));
                }
            }
            ConstraintKind::Reflexive
            | ConstraintKind::Irreflexive
            | ConstraintKind::Symmetric
            | ConstraintKind::Asymmetric => {
                for (predicate, name) in found.into_iter().zip(&constraint.names) {
                    let Some(predicate) = predicate else { continue };
                    let Some(ty) = relates(predicate, name, constraint, names, faults) else {
                        continue;
                    };
                    match constraint.kind {
                        ConstraintKind::Reflexive => declare(Constraint::Reflexive(predicate), domain(ty, names)),
                        ConstraintKind::Symmetric => declare(Constraint::Symmetric(predicate), Vec::new()),
                        ConstraintKind::Asymmetric => declare(Constraint::Asymmetric(predicate), Vec::new()),
                        _ => declare(Constraint::Irreflexive(predicate), Vec::new()),
                    }
                }
            }
        }
    }
    constraints
}

/// Returns the columns that hold values of a type; see [`DeclaredConstraint::domain`].
fn domain(ty: TypeId, names: &Names) -> Vec<(PredicateId, usize)> {
    let mut domain = Vec::new();
    for (predicate, id) in names.predicates.iter().zip((0..).map(PredicateId)) {
        if predicate.derived || predicate.hidden {
            continue;
        }
        let columns = predicate.columns.iter().enumerate();
        let within = columns.filter(|(_, column)| names.is_subtype(column.ty, ty));
        domain.extend(within.map(|(column, _)| (id, column)));
    }
    domain
}

fn refuse(message: String, at: Span, predicate: PredicateId, names: &Names) -> Diagnostic {
    let fault = Diagnostic::new(codes::INVALID_CONSTRAINT, message)
        .at(at, "")
        .also(names.predicate(predicate).span, "declared here");
    fault.note(format!("the declaration is `{}`", names.signature_text(predicate)))
}

/// Returns whether a constraint may name the predicate. Reports derived predicates: their rules determine their rows.
fn usable(predicate: PredicateId, name: &Name, names: &Names, faults: &mut Faults) -> bool {
    let signature = &names.signatures[predicate.index()];
    if names.predicate(predicate).derived && signature.input.is_some() {
        return false; // Already reported as a derived input.
    }
    if names.predicate(predicate).derived {
        let message = format!("`{}` is derived, so its rules determine its rows", name.text);
        let fault = refuse(message, name.place.0, predicate, names);
        faults.push(fault.help("constraints apply only to predicates without rules"));
        return false;
    }
    signature.columns.is_some()
}

/// Returns the two predicates if they can have a row in common, and reports them otherwise.
fn pair(
    first: Option<PredicateId>,
    second: Option<PredicateId>,
    constraint: &ast::ConstraintDecl,
    name: &Name,
    names: &Names,
    faults: &mut Faults,
) -> Option<(PredicateId, PredicateId)> {
    let (first, second) = (first?, second?);
    let kind = constraint.kind.name();
    if first == second {
        let message = format!("`.{kind}` names `{}` twice", name.text);
        faults.push(refuse(message, name.place.0, second, names));
        return None;
    }
    let [left, right] = [first, second].map(|predicate| &names.predicate(predicate).columns);
    let fits = left.len() == right.len() && left.iter().zip(right).all(|(a, b)| names.meet(a.ty, b.ty).is_some());
    if !fits {
        let other = &names.predicate(first).name;
        let message = format!("`{other}` and `{}` have different columns", name.text);
        let fault = refuse(message, name.place.0, second, names).also(names.predicate(first).span, "the other one");
        faults.push(fault);
    }
    fits.then_some((first, second))
}

/// Returns the predicates of a covering constraint and the type that they cover. They have one column each, of one
/// type.
fn cover(
    found: &[Option<PredicateId>],
    constraint: &ast::ConstraintDecl,
    names: &Names,
    faults: &mut Faults,
) -> Option<(Vec<PredicateId>, TypeId)> {
    let mut predicates: Vec<PredicateId> = Vec::new();
    let mut covered = None;
    for (predicate, name) in found.iter().zip(&constraint.names) {
        let predicate = (*predicate)?;
        let message = match names.predicate(predicate).columns.as_slice() {
            [column] if covered.is_some_and(|ty| ty != column.ty) => {
                format!(
                    "`{}` covers another type than `{}`",
                    name.text, constraint.names[0].text
                )
            }
            [_] if predicates.contains(&predicate) => format!("`.covering` names `{}` twice", name.text),
            [column] => {
                covered = Some(column.ty);
                predicates.push(predicate);
                continue;
            }
            _ => format!(
                "`{}` cannot be covering: it does not have exactly one column",
                name.text
            ),
        };
        faults.push(refuse(message, name.place.0, predicate, names));
        return None;
    }
    Some((predicates, covered?))
}

/// Returns the type that the two columns of the predicate share. Reports a predicate that does not have two such
/// columns.
fn relates(
    predicate: PredicateId,
    name: &Name,
    constraint: &ast::ConstraintDecl,
    names: &Names,
    faults: &mut Faults,
) -> Option<TypeId> {
    let columns = &names.predicate(predicate).columns;
    let shared = match columns.as_slice() {
        [a, b] => names.meet(a.ty, b.ty),
        _ => None,
    };
    if shared.is_none() {
        let message = format!(
            "`{}` cannot be {}: it does not have exactly two columns of one type",
            name.text,
            constraint.kind.name()
        );
        faults.push(refuse(message, name.place.0, predicate, names));
    }
    shared
}
