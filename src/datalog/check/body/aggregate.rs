//! Aggregates as literals over one predicate.
//!
//! ```text
//! A(k, n) :- K(k), n = sum v : { B(k, v) }.             n is the sum of the second column of B where the first is k
//!
//! A(k, n) :- K(k), n = sum v : { B(v), v < k }.         n is the sum of v in +1(k, v)
//!                                                 with  +1(k, v) :- B(v), v < k, K(k).
//! ```
//!
//! A body other than one simple atom becomes a hidden predicate. Its columns are the variables it shares with the rest
//! of the clause, and the values of its own atoms, because each solution of the body counts once. For a shared variable
//! that the body does not bind, the hidden clause copies the literals that bind it outside.
//!
//! Where only the recursion of the clause binds a shared variable, a copy would make the aggregate depend on its own
//! result. There the shared variables are parameters of the hidden predicate, and the aggregate is *correlated*: it is
//! evaluated in place for each binding of them.
//!
//! ```text
//! A(k + 1) :- A(k), c = count : { B(v), v < k }, c > 0.     c is the number of v in +1(k, v), given k
//!                                                     with  +1(k, v) :- B(v), v < k.
//! ```

use std::collections::BTreeSet;

use crate::diag::{Code, Diagnostic, Span};

use crate::datalog::check::body::{Check, Finish, Operand, Pending};
use crate::datalog::check::clauses::{EdgeKind, Known, VariableType, renumber};
use crate::datalog::check::names::Names;
use crate::datalog::check::rules::{Atom, Clause, Literal, RelId, Term, TypeId, VarId};
use crate::datalog::check::scope;
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::syntax::functor::{AggregateOp, Functor};

/// An aggregate without its body.
#[derive(Clone, Copy)]
struct Head {
    to: VarId,
    op: AggregateOp,
    target: Option<Operand>,
    level: usize,
    span: Span,
}

impl<'c> Check<'_, 'c> {
    /// Returns the finished literals. `context` are those of the enclosing clause or aggregates.
    pub fn finish(&mut self, pending: &[Pending<'c>], context: &[Literal], finish: &mut Finish<'_>) -> Vec<Literal> {
        let mut done: Vec<Option<Literal>> = Vec::with_capacity(pending.len());
        for pending in pending {
            let is_range = matches!(
                pending,
                Pending::Compute {
                    functor: Functor::Range,
                    ..
                }
            );
            done.push(if is_range { None } else { self.written(pending) });
        }
        // An aggregate or a range may need the value of another one.
        let mut progress = true;
        while std::mem::take(&mut progress) {
            for (index, pending) in pending.iter().enumerate() {
                if done[index].is_none()
                    && let Pending::Compute { .. } = pending
                {
                    let around: Vec<Literal> = done.iter().flatten().cloned().collect();
                    done[index] = self.range_literal(pending, &around, context, finish);
                    progress |= done[index].is_some();
                }
                let Pending::Aggregate {
                    to,
                    op,
                    target,
                    body,
                    level,
                    span,
                } = pending
                else {
                    continue;
                };
                if done[index].is_some() {
                    continue;
                }
                let head = Head {
                    to: *to,
                    op: *op,
                    target: *target,
                    level: *level,
                    span: *span,
                };
                let around: Vec<Literal> = context.iter().chain(done.iter().flatten()).cloned().collect();
                let literal = self.aggregate_literal(head, body, &around, finish);
                progress |= literal.is_some();
                done[index] = literal;
            }
        }
        if done.iter().any(Option::is_none) {
            self.unsound();
        }
        done.into_iter().flatten().collect()
    }

    /// Returns the literal of an aggregate; `None` while an outer literal that it needs is missing.
    fn aggregate_literal(
        &mut self,
        head: Head,
        body: &[Pending<'c>],
        context: &[Literal],
        finish: &mut Finish<'_>,
    ) -> Option<Literal> {
        let mut inner = self.finish(body, context, finish);
        let base = head.target.map_or(BaseType::Number, |target| self.settled_base(target));
        let target = head.target.map(|target| self.finished(target, base));
        let is_own = |check: &Self, id: VarId| check.level(id).is_none_or(|level| level >= head.level);

        let guards = self.guards(head, &mut inner, finish);
        if let ([Literal::Positive(atom)], true) = (inner.as_slice(), guards.is_empty())
            && let Some(literal) = self.direct(head, atom, target, base)
        {
            return Some(literal);
        }
        inner.extend(guards);

        // The columns: shared variables first.
        let mut shared = BTreeSet::new();
        let mut own = BTreeSet::new();
        for term in inner.iter().flat_map(Literal::terms).chain(&target) {
            if let Term::Variable(id) = term
                && !is_own(self, *id)
            {
                shared.insert(*id);
            }
        }
        if !matches!(head.op, AggregateOp::Min | AggregateOp::Max) {
            for literal in &mut inner {
                let Literal::Positive(atom) = literal else { continue };
                let types = self.names.signatures[atom.relation.index()]
                    .columns
                    .clone()
                    .unwrap_or_default();
                for (term, ty) in atom.terms.iter_mut().zip(types) {
                    if *term == Term::Wildcard {
                        let ty = ty.map_or(VariableType::Unknown, VariableType::Type);
                        *term = Term::Variable(fresh(finish.variables, ty, head.span));
                    }
                    if let Term::Variable(id) = *term
                        && is_own(self, id)
                    {
                        own.insert(id);
                    }
                }
            }
        }
        let target = target.map(|target| match target {
            Term::Variable(id) => id,
            constant => {
                let id = fresh(finish.variables, VariableType::Base(base), head.span);
                inner.push(Literal::Compare {
                    op: Comparison::Equal,
                    left: Term::Variable(id),
                    right: constant,
                    base,
                    span: head.span,
                });
                id
            }
        });
        if let Some(id) = target
            && !shared.contains(&id)
        {
            own.insert(id);
        }
        let outside = |literal: &Literal| {
            literal
                .atom()
                .is_none_or(|atom| !self.is_recursive(atom.relation, finish))
        };
        let parameters = match grounding(&shared, &inner, context, &outside) {
            Some(added) => {
                for literal in added.into_iter().map(|position| &context[position]) {
                    if let Some(atom) = literal.atom()
                        && !self.names.relation(atom.relation).hidden
                    {
                        self.edge(atom.relation, EdgeKind::Aggregates, atom.span);
                    }
                    inner.push(literal.clone());
                }
                0
            }
            None => {
                grounding(&shared, &inner, context, &|_| true)?;
                shared.len()
            }
        };

        let columns: Vec<VarId> = shared.iter().chain(&own).copied().collect();
        let relation = self.define(&columns, parameters, inner, head, finish);
        let term = |id: &VarId| {
            if shared.contains(id) {
                Term::Variable(*id)
            } else {
                Term::Wildcard
            }
        };
        Some(Literal::Aggregate {
            to: Term::Variable(head.to),
            op: head.op,
            base,
            atom: Atom {
                relation,
                terms: columns.iter().map(term).collect(),
                span: head.span,
            },
            column: target.and_then(|target| columns.iter().position(|column| *column == target)),
        })
    }

    /// Returns the aggregate over the atom itself, unless one of its own variables occurs twice.
    fn direct(&self, head: Head, atom: &Atom, target: Option<Term>, base: BaseType) -> Option<Literal> {
        let is_own = |id: VarId| self.level(id).is_none_or(|level| level >= head.level);
        let mut seen = BTreeSet::new();
        let mut terms = atom.terms.clone();
        for term in &mut terms {
            if let Term::Variable(id) = *term
                && is_own(id)
            {
                if !seen.insert(id) {
                    return None;
                }
                *term = Term::Wildcard;
            }
        }
        let column = match target {
            None => None,
            Some(target @ Term::Variable(_)) => Some(atom.terms.iter().position(|term| *term == target)?),
            Some(_) => return None,
        };
        Some(Literal::Aggregate {
            to: Term::Variable(head.to),
            op: head.op,
            base,
            atom: Atom { terms, ..atom.clone() },
            column,
        })
    }

    /// Returns the guards that restrict the aggregate's own variables and `_`s to what is in view under a scope.
    fn guards(&mut self, head: Head, inner: &mut [Literal], finish: &mut Finish<'_>) -> Vec<Literal> {
        let Some((guard, ego)) = finish.scope else {
            return Vec::new();
        };
        let mut targets = BTreeSet::new();
        for literal in inner.iter_mut() {
            let negated = matches!(literal, Literal::Negative(_));
            let (Literal::Positive(atom) | Literal::Negative(atom)) = literal else {
                continue;
            };
            let types = self.names.signatures[atom.relation.index()]
                .columns
                .clone()
                .unwrap_or_default();
            for (term, ty) in atom.terms.iter_mut().zip(types) {
                let in_view = ty.is_some_and(|ty| self.names.meet(ty, guard.seen).is_some());
                match *term {
                    Term::Wildcard if in_view && negated => {
                        let fault = Diagnostic::new(
                            Code::UNSUPPORTED,
                            "`_` in a negated atom of an aggregate under a scope is not supported",
                        )
                        .at(atom.span, "")
                        .help("define a separate predicate, and negate that");
                        self.report(fault);
                    }
                    Term::Wildcard if in_view => {
                        let ty = ty.map_or(VariableType::Unknown, VariableType::Type);
                        let id = fresh(finish.variables, ty, head.span);
                        *term = Term::Variable(id);
                        targets.insert(id);
                    }
                    Term::Variable(id) => {
                        let known = &finish.variables[id.index()];
                        let is_own = self.level(id) == Some(head.level);
                        if is_own && !known.hidden && scope::fits(known.ty, guard.seen, self.names) {
                            targets.insert(id);
                        }
                    }
                    _ => {}
                }
            }
        }
        if targets.is_empty() {
            return Vec::new();
        }
        let ego = match ego {
            Some(Term::Variable(id)) if scope::fits(finish.variables[id.index()].ty, guard.ego, self.names) => id,
            _ => {
                let fault = Diagnostic::new(Code::INVALID_SCOPE, "cannot guard this aggregate")
                    .at(head.span, "")
                    .also(guard.span, "the scope")
                    .note("under a scope, an aggregate ranges over what the head's first argument sees")
                    .help("end the scope before the clause: `.scope`");
                self.report(fault);
                return Vec::new();
            }
        };
        self.edge(guard.relation, EdgeKind::Aggregates, guard.span);
        let atom = |target: VarId| Atom {
            relation: guard.relation,
            terms: vec![Term::Variable(ego), Term::Variable(target)],
            span: guard.span,
        };
        targets
            .into_iter()
            .filter(|target| *target != ego)
            .map(|target| Literal::Guard(atom(target)))
            .collect()
    }

    /// Returns whether a predicate is mutually recursive with the head of the clause, or reads values that only such
    /// predicates bind.
    pub fn is_recursive(&self, relation: RelId, finish: &Finish<'_>) -> bool {
        let (mut todo, mut hidden) = (vec![relation], Vec::new());
        while let Some(relation) = todo.pop() {
            if !self.names.relation(relation).hidden {
                if self.names.components[relation.index()] == self.names.components[finish.head.index()] {
                    return true;
                }
            } else if self.names.relation(relation).parameters > 0 {
                // Only the recursion gives values to the parameters.
                return true;
            } else if !hidden.contains(&relation) {
                hidden.push(relation);
                let clauses = finish.hidden.iter().filter(|clause| clause.head.relation == relation);
                let atoms = clauses.flat_map(|clause| &clause.body).filter_map(Literal::atom);
                todo.extend(atoms.map(|atom| atom.relation));
            }
        }
        false
    }

    /// Defines a hidden predicate with these columns, of which the first are parameters.
    fn define(
        &mut self,
        columns: &[VarId],
        parameters: usize,
        mut body: Vec<Literal>,
        head: Head,
        finish: &mut Finish<'_>,
    ) -> RelId {
        let column = |id: &VarId| {
            let Known { name, ty, .. } = &finish.variables[id.index()];
            let ty = match ty {
                VariableType::Type(ty) => *ty,
                VariableType::Base(base) => Names::base_type(*base),
                VariableType::Unknown => TypeId(0),
            };
            (name.clone(), ty)
        };
        let doc = format!("the rows of `{}`", head.op.name());
        let relation = self.names.hide(columns.iter().map(column).collect(), doc, head.span);
        self.names.relations[relation.index()].parameters = parameters;
        let mut terms: Vec<Term> = columns.iter().map(|id| Term::Variable(*id)).collect();
        let variables = renumber(finish.variables.clone(), std::iter::once(&mut terms), &mut body);
        finish.hidden.push(Clause {
            head: Atom {
                relation,
                terms,
                span: head.span,
            },
            body,
            variable_spans: variables.iter().map(|variable| variable.first).collect(),
            variables: variables.into_iter().map(|variable| variable.name).collect(),
            doc: String::new(),
            span: head.span,
        });
        relation
    }
}

/// Returns the positions of the context literals that together with `inner` bind the shared variables. `None` if the
/// `usable` ones cannot.
fn grounding(
    shared: &BTreeSet<VarId>,
    inner: &[Literal],
    context: &[Literal],
    usable: &dyn Fn(&Literal) -> bool,
) -> Option<Vec<usize>> {
    let mut body = inner.to_vec();
    let mut taken = Vec::new();
    // The variables for which a literal was taken; it may need further variables.
    let mut given = BTreeSet::new();
    loop {
        let bound = bound_by(&body);
        let needed = body.iter().flat_map(variables_of);
        let unbound: BTreeSet<VarId> = (shared.iter().copied().chain(needed))
            .filter(|id| !bound.contains(id))
            .collect();
        if unbound.is_empty() {
            return Some(taken);
        }
        let gives = |literal: &Literal, id: VarId| match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => atom.terms.contains(&Term::Variable(id)),
            Literal::Compare {
                op: Comparison::Equal,
                left,
                right,
                ..
            } => [left, right].contains(&&Term::Variable(id)),
            Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => *to == Term::Variable(id),
            _ => false,
        };
        let atoms_first = |position: &usize| (!matches!(context[*position], Literal::Positive(_)), *position);
        let best = |id: VarId| {
            (0..context.len())
                .filter(|position| !taken.contains(position))
                .filter(|&position| gives(&context[position], id) && usable(&context[position]))
                .min_by_key(atoms_first)
                .map(|position| (id, position))
        };
        // A variable that has a literal already may need another one, for example `x = c` besides `x = y`.
        let mut order = unbound.difference(&given).chain(unbound.intersection(&given));
        let (id, position) = order.find_map(|id| best(*id))?;
        given.insert(id);
        taken.push(position);
        body.push(context[position].clone());
    }
}

/// Adds a variable without a name.
fn fresh(variables: &mut Vec<Known>, ty: VariableType, span: Span) -> VarId {
    let id = VarId(u32::try_from(variables.len()).expect("fewer than 2^32 variables"));
    variables.push(Known {
        name: "_".to_owned(),
        ty,
        first: span,
        count: 2,
        hidden: true,
    });
    id
}

/// Returns the variables that the literals bind among themselves.
pub(crate) fn bound_by(literals: &[Literal]) -> BTreeSet<VarId> {
    let mut bound = BTreeSet::new();
    loop {
        let before = bound.len();
        for literal in literals {
            let known = |term: &Term| match term {
                Term::Variable(id) => bound.contains(id),
                _ => true,
            };
            let gives: Vec<&Term> = match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => atom.terms.iter().collect(),
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } if known(left) || known(right) => vec![left, right],
                Literal::Compute { to, arguments, .. } if arguments.iter().all(known) => vec![to],
                Literal::Aggregate { to, atom, .. } if atom.terms.iter().all(known) => vec![to],
                _ => Vec::new(),
            };
            let ids = gives.into_iter().filter_map(|term| match term {
                Term::Variable(id) => Some(*id),
                _ => None,
            });
            let ids: Vec<VarId> = ids.collect();
            bound.extend(ids);
        }
        if bound.len() == before {
            return bound;
        }
    }
}

/// Returns the variables of the literal.
fn variables_of(literal: &Literal) -> impl Iterator<Item = VarId> + '_ {
    literal.terms().filter_map(|term| match term {
        Term::Variable(id) => Some(*id),
        _ => None,
    })
}
