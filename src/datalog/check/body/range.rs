//! `range` as hidden predicates.
//!
//! ```text
//! A(x) :- B(n), x = range(0, n).      becomes   A(x) :- B(n), +2(0, n, 1, x).
//!                                     with      +1(0, n, 1) :- 0 <= n, B(n).              the requests
//!                                               +2(f, t, s, f) :- +1(f, t, s), f < t.     the first value
//!                                               +2(f, t, s, y) :- +2(f, t, s, x), ...     the values after it
//! ```
//!
//! So the rules compute only ranges that the rest of the clause requests, and every executor supports ranges. Whole
//! numbers double the distance from the start in each round, so a range of n values takes log n rounds. Ranges of
//! floats add one step at a time, because the rounded sum depends on the order of additions.

use std::collections::BTreeSet;

use crate::diag::Span;
use crate::symbol::Symbols;

use crate::check::body::aggregate::{Allowed, bound_by};
use crate::check::body::{Check, Finish, Pending};
use crate::check::clauses::EdgeKind;
use crate::check::clauses::{Known, VariableType, renumber};
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, PredicateId, Term, VarId};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::value::Value;

const FROM: Term = Term::Variable(VarId(0));
const TO: Term = Term::Variable(VarId(1));
const STEP: Term = Term::Variable(VarId(2));
const VALUE: Term = Term::Variable(VarId(3));
const DISTANCE: Term = Term::Variable(VarId(4));
const DOUBLE: Term = Term::Variable(VarId(5));
const NEXT: Term = Term::Variable(VarId(6));

/// The names of these variables.
const NAMES: [&str; 7] = ["from", "to", "step", "value", "distance", "double", "next"];

/// The numbers of columns: of a request, and of a value.
const ASKED: usize = 3;
const COLUMNS: usize = 4;

impl<'c> Check<'_, 'c> {
    /// Returns an atom for `to = range(from, to, step)`; `None` while a literal that binds an argument is missing.
    ///
    /// `near` are the finished literals of the same body. `context` are those of the enclosing clause or aggregates, of
    /// which `allowed` says which may bind an argument.
    pub fn range_literal(
        &mut self,
        pending: &Pending<'c>,
        near: &[Literal],
        context: &[Literal],
        finish: &mut Finish<'_>,
        allowed: Allowed,
    ) -> Option<Literal> {
        let Some(Literal::Compute {
            to,
            functor: Functor::Range,
            base,
            arguments,
            span,
        }) = self.written(pending)
        else {
            return None;
        };
        let needed: BTreeSet<VarId> = arguments.iter().filter_map(Term::variable).collect();
        // In an aggregate, a range of values that the recursion provides would make the aggregate depend on itself.
        let mut context = context.to_vec();
        if allowed == Allowed::Outside {
            context.retain(|literal| self.is_outside(literal, finish));
        }
        let (near, context) = relevant(&needed, near, &context)?;
        for atom in context.iter().filter_map(Literal::atom) {
            if !self.names.predicate(atom.predicate).hidden {
                self.edge(atom.predicate, EdgeKind::Aggregates, atom.span);
            } else if self.is_recursive(atom.predicate, finish) {
                self.edge(finish.head, EdgeKind::Aggregates, atom.span);
            }
        }
        let mut making = Making {
            names: &mut *self.names,
            hidden: &mut *finish.hidden,
            symbols: self.symbols,
            base,
            span,
        };
        let asked = making.predicate("requests to `range`", ASKED);
        let values = making.predicate("values of `range`", COLUMNS);
        let around: Vec<Literal> = near.into_iter().chain(context).collect();
        let mut ways = Vec::new();
        for (terms, condition, way) in requests(&arguments, base, span, self.symbols) {
            let body = condition.into_iter().chain(around.iter().cloned()).collect();
            making.clause(asked, terms, body, finish.variables.clone());
            ways.push(way);
        }
        making.values(asked, values, &ways);
        let [from, until, rest @ ..] = arguments.as_slice() else {
            return None;
        };
        // Without a step the request has two directions, one of which has no values.
        let step = rest.first().copied().unwrap_or(Term::Wildcard);
        Some(Literal::Positive(Atom {
            predicate: values,
            terms: vec![*from, *until, step, to],
            span,
        }))
    }
}

/// Returns the bound literals of `near` and `context` that share variables, directly or through others, with the needed
/// ones. `None` if these literals do not bind the needed variables.
fn relevant(needed: &BTreeSet<VarId>, near: &[Literal], context: &[Literal]) -> Option<(Vec<Literal>, Vec<Literal>)> {
    let all: Vec<Literal> = near.iter().chain(context).cloned().collect();
    let bound = bound_by(&all);
    if !needed.is_subset(&bound) {
        return None;
    }
    let mut connected = needed.clone();
    let mut chosen = vec![false; all.len()];
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for (literal, chosen) in all.iter().zip(&mut chosen) {
            let ids: Vec<VarId> = literal.variables().collect();
            if !*chosen && ids.iter().all(|id| bound.contains(id)) && ids.iter().any(|id| connected.contains(id)) {
                connected.extend(ids);
                *chosen = true;
                changed = true;
            }
        }
    }
    let pick = |from: usize, literals: &[Literal]| {
        let chosen = chosen[from..].iter().zip(literals);
        chosen
            .filter(|(chosen, _)| **chosen)
            .map(|(_, literal)| literal.clone())
            .collect()
    };
    Some((pick(0, near), pick(near.len(), context)))
}

/// The direction of a range: up for a positive step, down for a negative one. A range with step 0 contains only its
/// start, provided that start and end differ.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Up,
    Down,
    Nowhere,
}

/// Returns the possible requests for these arguments: start, end and step, the condition, and the direction.
fn requests(
    arguments: &[Term],
    base: BaseType,
    span: Span,
    symbols: &Symbols,
) -> Vec<(Vec<Term>, Option<Literal>, Way)> {
    let [from, to, rest @ ..] = arguments else {
        return Vec::new();
    };
    let signed = base != BaseType::Unsigned;
    let compare = |op, left, right| Literal::Compare {
        op,
        left,
        right,
        base,
        span,
    };
    match rest.first() {
        Some(step) => {
            let sign = [
                (Way::Up, Comparison::Greater),
                (Way::Down, Comparison::Less),
                (Way::Nowhere, Comparison::Equal),
            ];
            let possible = sign.into_iter().filter(|(way, _)| signed || *way != Way::Down);
            possible
                .map(|(way, op)| {
                    let condition = compare(op, *step, constant(0, base, symbols));
                    (vec![*from, *to, *step], Some(condition), way)
                })
                .collect()
        }
        // Unsigned numbers have no step downwards.
        None => {
            let mut all = vec![(
                vec![*from, *to, constant(1, base, symbols)],
                Some(compare(Comparison::Less, *from, *to)),
                Way::Up,
            )];
            if signed {
                let condition = compare(Comparison::Greater, *from, *to);
                all.push((
                    vec![*from, *to, constant(-1, base, symbols)],
                    Some(condition),
                    Way::Down,
                ));
            }
            all
        }
    }
}

fn constant(n: i8, base: BaseType, symbols: &Symbols) -> Term {
    Term::Constant(match base {
        BaseType::Float => Value::of_float(f64::from(n), symbols),
        _ => Value::of_number(n.into(), symbols).unwrap_or_default(),
    })
}

/// The context in which a range defines its hidden predicates.
struct Making<'m> {
    names: &'m mut Names,
    hidden: &'m mut Vec<Clause>,
    symbols: &'m Symbols,
    base: BaseType,
    span: Span,
}

impl Making<'_> {
    fn predicate(&mut self, doc: &str, columns: usize) -> PredicateId {
        let ty = Names::base_type(self.base);
        let columns = NAMES[..columns].iter().map(|name| ((*name).to_owned(), ty)).collect();
        self.names.hide(columns, doc.to_owned(), self.span)
    }

    fn clause(&mut self, predicate: PredicateId, mut terms: Vec<Term>, mut body: Vec<Literal>, variables: Vec<Known>) {
        let variables = renumber(variables, std::iter::once(&mut terms), &mut body);
        let head = self.atom(predicate, terms);
        self.hidden.push(Clause {
            head,
            body,
            variable_spans: variables.iter().map(|variable| variable.first).collect(),
            variables: variables.into_iter().map(|variable| variable.name).collect(),
            doc: String::new(),
            span: self.span,
        });
    }

    fn atom(&self, predicate: PredicateId, terms: Vec<Term>) -> Atom {
        Atom {
            predicate,
            terms,
            span: self.span,
        }
    }

    /// Defines the clauses for the values.
    fn values(&mut self, asked: PredicateId, values: PredicateId, ways: &[Way]) {
        let variables: Vec<Known> = (NAMES.iter())
            .map(|name| Known {
                name: (*name).to_owned(),
                ty: VariableType::Base(self.base),
                first: self.span,
                count: 2,
                hidden: true,
            })
            .collect();
        for &way in ways {
            for (value, body) in self.bodies(asked, values, way) {
                self.clause(values, vec![FROM, TO, STEP, value], body, variables.clone());
            }
        }
    }

    /// Returns the possible values and the bodies that derive them. Because numbers wrap around, a value counts only if
    /// it lies beyond the one it was computed from.
    fn bodies(&self, asked: PredicateId, values: PredicateId, way: Way) -> Vec<(Term, Vec<Literal>)> {
        let (before, after, sign) = match way {
            Way::Up => (Comparison::Less, Comparison::Greater, Comparison::Greater),
            Way::Down => (Comparison::Greater, Comparison::Less, Comparison::Less),
            Way::Nowhere => (Comparison::NotEqual, Comparison::NotEqual, Comparison::Equal),
        };
        let compare = |left, op, right| Literal::Compare {
            op,
            left,
            right,
            base: self.base,
            span: self.span,
        };
        let compute = |to, left, functor, right| Literal::Compute {
            to,
            functor,
            base: self.base,
            arguments: vec![left, right],
            span: self.span,
        };
        let asked = Literal::Positive(self.atom(asked, vec![FROM, TO, STEP]));
        let known = Literal::Positive(self.atom(values, vec![FROM, TO, STEP, VALUE]));
        let this_way = compare(STEP, sign, constant(0, self.base, self.symbols));
        let begin = vec![asked.clone(), this_way.clone(), compare(FROM, before, TO)];
        let reached = |term, from| [compare(term, after, from), compare(term, before, TO)];
        let mut bodies = vec![(FROM, begin)];
        match (way, self.base) {
            (Way::Nowhere, _) => {}
            (_, BaseType::Float) => {
                let mut next = vec![known, this_way, compute(NEXT, VALUE, Functor::Add, STEP)];
                next.extend(reached(NEXT, VALUE));
                bodies.push((NEXT, next));
            }
            _ => {
                let mut second = vec![asked, this_way.clone(), compute(NEXT, FROM, Functor::Add, STEP)];
                second.extend(reached(NEXT, FROM));
                bodies.push((NEXT, second));
                let mut double = vec![
                    known,
                    this_way,
                    compare(VALUE, after, FROM),
                    compute(DISTANCE, VALUE, Functor::Subtract, FROM),
                    compute(DOUBLE, VALUE, Functor::Add, DISTANCE),
                ];
                double.extend(reached(DOUBLE, VALUE));
                let mut beside = double.clone();
                beside.push(compute(NEXT, DOUBLE, Functor::Add, STEP));
                beside.extend(reached(NEXT, DOUBLE));
                bodies.push((DOUBLE, double));
                bodies.push((NEXT, beside));
            }
        }
        bodies
    }
}
