//! Clauses that tell a concept from what it is confused with.

use crate::analysis::diff::shortcuts::{ConceptMap, Image, ShortcutOptions, witness};
use crate::check::{Atom, Clause, ClauseId, Literal, PredicateId, Rules, Term, VarId};
use crate::diag::Diagnostic;

/// Returns a clause that tells a concept from its image in a map: with it, the map changes a decision. `None` if no
/// clause of two literals is found.
///
/// # Errors
/// As [`shortcuts`](super::shortcuts).
pub fn remedy(
    rules: &Rules,
    order: &[PredicateId],
    options: &ShortcutOptions,
    (map, concepts): (&ConceptMap, &[PredicateId]),
    concept: usize,
) -> Result<Option<Clause>, Vec<Diagnostic>> {
    let arity = rules.predicates[concepts[concept].index()].arity();
    let span = rules.predicates[concepts[concept].index()].span;
    let atom = |predicate: PredicateId| Atom {
        predicate,
        terms: (0..arity as u32).map(|column| Term::Variable(VarId(column))).collect(),
        span,
    };
    let literal = |predicate: PredicateId, holds: bool| match holds {
        true => Literal::Positive(atom(predicate)),
        false => Literal::Negative(atom(predicate)),
    };
    let own = concepts[concept];
    // A variable needs a positive literal: every entity sees itself and all others.
    let scope = rules
        .clauses
        .iter()
        .flat_map(|clause| &clause.body)
        .find_map(|literal| match literal {
            Literal::Guard(atom) => Some(atom.predicate),
            _ => None,
        });
    let seen = scope.map(|predicate| {
        let second = VarId(arity as u32 - 1);
        let terms = vec![Term::Variable(VarId(0)), Term::Variable(second)];
        Literal::Positive(Atom { predicate, terms, span })
    });
    let unless = |literals: Vec<Literal>| seen.iter().cloned().chain(literals).collect::<Vec<_>>();
    let mut bodies: Vec<Vec<Literal>> = match map.images[concept] {
        Image::Constant(false) => vec![vec![literal(own, true)]],
        Image::Constant(true) => vec![unless(vec![literal(own, false)])],
        Image::Concept { position, negated } if position == concept => {
            debug_assert!(negated, "the concept is confused");
            vec![vec![literal(own, true)]]
        }
        Image::Concept {
            position,
            negated: false,
        } => vec![
            vec![literal(own, true), literal(concepts[position], false)],
            vec![literal(concepts[position], true), literal(own, false)],
        ],
        Image::Concept {
            position,
            negated: true,
        } => vec![
            vec![literal(own, true), literal(concepts[position], true)],
            unless(vec![literal(own, false), literal(concepts[position], false)]),
        ],
    };
    let is_safe = |body: &Vec<Literal>| body.iter().any(|literal| matches!(literal, Literal::Positive(_)));
    bodies.retain(is_safe);
    for action in order {
        for body in &bodies {
            let clause = Clause {
                head: Atom {
                    predicate: *action,
                    terms: vec![Term::Variable(VarId(0))],
                    span,
                },
                body: body.clone(),
                variables: ["X", "Y"][..arity].iter().map(|name| (*name).to_owned()).collect(),
                variable_spans: vec![span; arity],
                doc: String::new(),
                span,
            };
            let mut more = rules.clone();
            let Some(stratum) = more
                .strata
                .iter_mut()
                .find(|stratum| stratum.predicates.contains(action))
            else {
                continue;
            };
            stratum.clauses.push(ClauseId(more.clauses.len() as u32));
            more.clauses.push(clause.clone());
            if matches!(witness(&more, order, options, &map.images)?, Ok(Some(_))) {
                return Ok(Some(clause));
            }
        }
    }
    Ok(None)
}
