//! Witnesses of `min` and `max`.
//!
//! ```text
//! Youngest(p, n) :- n = min x : { Age(p, x) }.
//! becomes
//! Youngest(p, n) :- n = min x : { Age(q, x) }, Age(p, y), n = y.
//! ```
//!
//! A variable in the body of `min` or `max` that also occurs outside, but is bound nowhere there, is a witness: it
//! takes the values for which the aggregate attains its result. The rewriting works on syntax, before name resolution.

use std::collections::{HashMap, HashSet};

use crate::datalog::syntax::ast::Comparison;
use crate::datalog::syntax::ast::{Aggregate, Atom, Literal, Term, TermKind};
use crate::datalog::syntax::ast::{names_in, names_of};
use crate::datalog::syntax::functor::AggregateOp;

/// Rewrites the aggregates with witnesses; `None` if there are none.
pub(crate) fn write_out(head: &Atom, body: &[&Literal]) -> Option<Vec<Literal>> {
    if !body.iter().any(|literal| selection(literal).is_some()) {
        return None;
    }
    let mut outside: HashSet<&str> = HashSet::new();
    let mut note = |name| {
        outside.insert(name);
    };
    head.terms.iter().for_each(|term| names_of(term, false, &mut note));
    body.iter().for_each(|literal| names_in(literal, false, &mut note));
    let bound = bound_names(body);

    let mut out: Vec<Literal> = Vec::with_capacity(body.len());
    let mut any = false;
    for (index, literal) in body.iter().enumerate() {
        let Some((result, aggregate, target)) = selection(literal) else {
            out.push((*literal).clone());
            continue;
        };
        let (mut inside, mut of_target): (HashSet<&str>, HashSet<&str>) = (HashSet::new(), HashSet::new());
        for literal in &aggregate.body {
            names_in(literal, true, &mut |name| {
                inside.insert(name);
            });
        }
        names_of(target, true, &mut |name| {
            of_target.insert(name);
        });
        let free = |name: &str| !bound.contains(name) || of_target.contains(name);
        let is_witness = |name: &str| outside.contains(name) && !bound.contains(name);
        if !inside.iter().any(|name| is_witness(name)) {
            out.push((*literal).clone());
            continue;
        }
        any = true;
        let place = target.place;
        let result = match &result.kind {
            TermKind::Wildcard => variable(format!("+{index}"), result),
            _ => result.clone(),
        };
        // The aggregate gets fresh names for its witnesses.
        let apart = rename(&inside, |name| is_witness(name).then(|| format!("+{name}.{index}")));
        out.push(Literal::Compare {
            op: Comparison::Equal,
            left: result.clone(),
            right: Term {
                kind: TermKind::Aggregate(Box::new(Aggregate {
                    op: aggregate.op,
                    target: Some(renamed_term(target, &apart)),
                    body: aggregate.body.iter().map(|literal| renamed(literal, &apart)).collect(),
                })),
                place,
            },
            place,
        });
        // A second copy of the body holds for the result of the aggregate.
        let again = rename(&inside, |name| {
            (free(name) && !is_witness(name)).then(|| format!("+{name}.{index}.found"))
        });
        out.extend(aggregate.body.iter().map(|literal| renamed(literal, &again)));
        out.push(Literal::Compare {
            op: Comparison::Equal,
            left: result,
            right: renamed_term(target, &again),
            place,
        });
    }
    any.then_some(out)
}

/// Returns the result, the aggregate and its target if the literal has the form `x = min y : { ... }`.
fn selection(literal: &Literal) -> Option<(&Term, &Aggregate, &Term)> {
    let Literal::Compare {
        op: Comparison::Equal,
        left,
        right,
        ..
    } = literal
    else {
        return None;
    };
    let (result, aggregate) = match (&left.kind, &right.kind) {
        (_, TermKind::Aggregate(aggregate)) => (left, aggregate),
        (TermKind::Aggregate(aggregate), _) => (right, aggregate),
        _ => return None,
    };
    let simple = !matches!(
        result.kind,
        TermKind::Functor(..) | TermKind::Cast(..) | TermKind::Aggregate(_)
    );
    let target = aggregate.target.as_ref()?;
    let selects = matches!(aggregate.op, AggregateOp::Min | AggregateOp::Max);
    (simple && selects).then_some((result, aggregate, target))
}

/// Returns the names that the literals bind outside of aggregates. Results of aggregates count as bound.
pub(crate) fn bound_names<'c>(body: &[&'c Literal]) -> HashSet<&'c str> {
    let mut bound: HashSet<&str> = HashSet::new();
    loop {
        let before = bound.len();
        for literal in body {
            match literal {
                Literal::Atom { negated: false, atom } => bound.extend(atom.terms.iter().filter_map(name)),
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } => {
                    for (to, from) in [(left, right), (right, left)] {
                        let mut known = true;
                        names_of(from, false, &mut |name| known &= bound.contains(name));
                        if known {
                            bound.extend(name(to));
                        }
                    }
                }
                _ => {}
            }
        }
        if bound.len() == before {
            return bound;
        }
    }
}

fn name(term: &Term) -> Option<&str> {
    match &term.kind {
        TermKind::Variable(name) => Some(name),
        _ => None,
    }
}

fn variable(name: String, at: &Term) -> Term {
    Term {
        kind: TermKind::Variable(name),
        place: at.place,
    }
}

/// A substitution of variables.
pub(crate) type Names = HashMap<String, TermKind>;

fn rename(names: &HashSet<&str>, new: impl Fn(&str) -> Option<String>) -> Names {
    names
        .iter()
        .filter_map(|name| Some(((*name).to_owned(), TermKind::Variable(new(name)?))))
        .collect()
}

pub(crate) fn renamed(literal: &Literal, names: &Names) -> Literal {
    let mut literal = literal.clone();
    match &mut literal {
        Literal::Atom { atom, .. } => atom.terms.iter_mut().for_each(|term| *term = renamed_term(term, names)),
        Literal::Compare { left, right, .. } => {
            *left = renamed_term(left, names);
            *right = renamed_term(right, names);
        }
        Literal::Any(alternatives) => {
            for literal in alternatives.iter_mut().flatten() {
                *literal = renamed(literal, names);
            }
        }
    }
    literal
}

pub(crate) fn renamed_term(term: &Term, names: &Names) -> Term {
    let mut term = term.clone();
    match &mut term.kind {
        TermKind::Variable(name) => {
            if let Some(new) = names.get(name.as_str()) {
                term.kind = new.clone();
            }
        }
        TermKind::Functor(_, arguments) => {
            for argument in arguments {
                *argument = renamed_term(argument, names);
            }
        }
        TermKind::Cast(inner, _) => **inner = renamed_term(inner, names),
        TermKind::Aggregate(aggregate) => {
            aggregate.target = aggregate.target.as_ref().map(|target| renamed_term(target, names));
            for literal in &mut aggregate.body {
                *literal = renamed(literal, names);
            }
        }
        TermKind::Wildcard | TermKind::Number(_) | TermKind::Unsigned(_) | TermKind::Float(_) | TermKind::Text(_) => {}
    }
    term
}
