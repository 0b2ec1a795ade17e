//! Aggregates that are computed while their rows are derived, so that no row is stored.
//!
//! ```text
//! A(k, n) :- K(k), n = count : { B(k, x), C(x, y) }.      the checker writes the body as a hidden predicate:
//!
//! +1(k, x, y) :- B(k, x), C(x, y).                        evaluation stores one row (k, count) for each k
//! A(k, n) :- K(k), n = count : { +1(k, _, _) }.           and looks it up
//! ```
//!
//! An aggregate ranges over a set, so this needs a plan that finds each row of the hidden predicate once. A row
//! determines the rows of the body's atoms if the head has all their variables. A minimum or maximum may find a row
//! any number of times.
// Decision: docs/decisions/evaluation.md#d011

use crate::check::{Clause, Literal, Rules, Term};
use crate::plan::steps::Grouping;
use crate::symbol::WordSize;
use crate::syntax::functor::AggregateOp;

/// By [`PredicateId`](crate::check::PredicateId): how the predicate is aggregated; `None` if its rows are stored.
pub(crate) fn groupings(rules: &Rules) -> Vec<Option<Grouping>> {
    // The outer `None` means that no literal reads the predicate, the inner one that its rows are needed.
    let mut read: Vec<Option<Option<Grouping>>> = vec![None; rules.predicates.len()];
    for literal in rules.clauses.iter().flat_map(|clause| &clause.body) {
        let Some(atom) = literal.atom() else { continue };
        // The sum and the mean of numbers of 64 bits may be interned, which groups do not do.
        let long = rules.symbols.word_size() == WordSize::Bits64;
        let grouping = aggregated(literal)
            .filter(|grouping| !long || !matches!(grouping.op, AggregateOp::Sum | AggregateOp::Mean));
        let known = &mut read[atom.predicate.index()];
        *known = match *known {
            Some(known) if known != grouping => Some(None),
            _ => Some(grouping),
        };
    }
    let mut definitions: Vec<Vec<&Clause>> = vec![Vec::new(); rules.predicates.len()];
    for clause in &rules.clauses {
        let predicate = clause.head.predicate.index();
        if rules.predicates[predicate].hidden && read[predicate].is_some() {
            definitions[predicate].push(clause);
        }
    }
    let found = read
        .into_iter()
        .zip(definitions)
        .map(|(read, clauses)| match clauses[..] {
            [clause] => read.flatten().filter(|grouping| is_enumerated(clause, grouping)),
            _ => None,
        });
    found.collect()
}

/// The aggregation of a literal, if its key is a proper prefix of the columns.
fn aggregated(literal: &Literal) -> Option<Grouping> {
    let Literal::Aggregate {
        op, base, atom, column, ..
    } = literal
    else {
        return None;
    };
    let is_key = |term: &Term| *term != Term::Wildcard;
    let keys = atom.terms.iter().take_while(|term| is_key(term)).count();
    let proper = keys < atom.terms.len() && !atom.terms[keys..].iter().any(is_key);
    proper.then_some(Grouping {
        keys,
        op: *op,
        base: *base,
        column: *column,
    })
}

/// Whether a plan of the clause finds each row once, or may find it repeatedly.
fn is_enumerated(clause: &Clause, grouping: &Grouping) -> bool {
    let head = &clause.head.terms;
    let distinct = |at: usize| matches!(head[at], Term::Variable(_)) && !head[..at].contains(&head[at]);
    let in_head = |literal: &Literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => atom.terms.iter().all(|term| match term {
            Term::Variable(_) => head.contains(term),
            Term::Constant(_) => true,
            Term::Wildcard => false,
        }),
        _ => true,
    };
    let repeats = matches!(grouping.op, AggregateOp::Min | AggregateOp::Max);
    !clause.body.is_empty() && (0..head.len()).all(distinct) && (repeats || clause.body.iter().all(in_head))
}
