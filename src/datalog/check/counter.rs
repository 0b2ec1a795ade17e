//! `autoinc()`: the clause reads the numbers of its solutions from a hidden predicate.
//!
//! ```text
//! A(x, autoinc()) :- B(x, y), y > 0.    becomes    +1(x, y) :- B(x, y), y > 0.
//!                                                  +2(n, x, y) :- +1(x, y), n = autoinc(+2, x, y).
//!                                                  A(x, n) :- +2(n, x, y).
//! ```
//!
//! The numbers begin behind those of the clauses that are evaluated before, so that no two solutions have the same one.
// Decision: docs/decisions/language.md#d085

use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, Numbering, Predicate, PredicateId, Term, TypeId, VarId};
use crate::check::strata;
use crate::diag::Span;
use crate::syntax::ast::BaseType;
use crate::syntax::functor::Functor;
use crate::value::Value;

/// The columns of the solutions: names and types.
pub(crate) type Columns = Vec<(String, TypeId)>;

/// Defines the hidden predicates for the solutions of a body, and for their numbers. Returns the latter.
pub(crate) fn define(
    names: &mut Names,
    hidden: &mut Vec<Clause>,
    (columns, each): (Columns, u32),
    solutions: Clause,
    span: Span,
) -> PredicateId {
    let of = solutions.head.predicate;
    hidden.push(solutions);
    let number = ("number".to_owned(), Names::base_type(BaseType::Number));
    let doc = "the numbers of `autoinc()`".to_owned();
    let numbers = names.hide(std::iter::once(number).chain(columns).collect(), doc, span);
    names.predicates[numbers.index()].numbering = Some(Numbering {
        solutions: of,
        each,
        before: Vec::new(),
    });
    numbers
}

/// Adds the clauses of the numbers, in an order that follows the strata.
pub(crate) fn finish(predicates: &mut [Predicate], clauses: &mut Vec<Clause>) {
    if predicates.iter().all(|predicate| predicate.numbering.is_none()) {
        return;
    }
    let numbered = |predicates: &[Predicate], id: PredicateId| predicates[id.index()].numbering.clone();
    let ids: Vec<PredicateId> = (0..)
        .map(PredicateId)
        .take(predicates.len())
        .filter(|id| predicates[id.index()].numbering.is_some())
        .collect();
    for &id in &ids {
        clauses.extend(numbered(predicates, id).map(|numbering| clause(id, &numbering, predicates)));
    }
    // What is evaluated before decides where the numbers begin, so that no clause depends on its own numbers.
    let mut before = Vec::new();
    for stratum in strata::order(predicates, clauses) {
        for id in stratum.predicates {
            if let Some(numbering) = &mut predicates[id.index()].numbering {
                numbering.before.clone_from(&before);
                before.push((numbering.solutions, numbering.each));
            }
        }
    }
}

/// Returns the clause of numbers.
fn clause(id: PredicateId, numbering: &Numbering, predicates: &[Predicate]) -> Clause {
    let predicate = &predicates[id.index()];
    let span = predicate.span;
    let variable = |at: usize| Term::Variable(VarId(u32::try_from(at).expect("few columns")));
    let arity = predicate.arity();
    let values: Vec<Term> = (1..arity).map(variable).collect();
    let mut body = vec![Literal::Positive(Atom {
        predicate: numbering.solutions,
        terms: values.clone(),
        span,
    })];
    let mut arguments = vec![Term::Constant(Value(id.0))];
    arguments.extend(values);
    body.push(Literal::Compute {
        to: variable(0),
        functor: Functor::Counter,
        base: BaseType::Number,
        arguments,
        span,
    });
    let variables: Vec<String> = predicate.columns.iter().map(|column| column.name.clone()).collect();
    Clause {
        head: Atom {
            predicate: id,
            terms: (0..arity).map(variable).collect(),
            span,
        },
        body,
        variable_spans: vec![span; variables.len()],
        variables,
        doc: String::new(),
        span,
    }
}
