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

use crate::codes;
use crate::diag::{Diagnostic, Span};

use crate::check::body::{Check, Finish, Operand, OperandKind, Pending};
use crate::check::clauses::{EdgeKind, Known, VariableType, renumber};
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, PredicateId, Term, TypeId, VarId};
use crate::check::scope;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};

/// The literals that may bind what an aggregate needs from outside.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Allowed {
    /// Those that do not depend on the recursion of the clause.
    Outside,
    /// All.
    All,
}

/// The variables that the finished literals bind.
#[derive(Default)]
struct Bound {
    /// By literals that do not depend on the recursion of the clause.
    outside: Binding,
    all: Binding,
}

impl Bound {
    fn by(&self, allowed: Allowed) -> &Binding {
        match allowed {
            Allowed::Outside => &self.outside,
            Allowed::All => &self.all,
        }
    }
}

/// The variables that literals bind among themselves.
#[derive(Default)]
struct Binding {
    bound: BTreeSet<VarId>,
    /// The literals that bind nothing yet.
    waiting: Vec<Literal>,
}

impl Binding {
    fn add(&mut self, literal: &Literal) {
        self.waiting.push(literal.clone());
        let mut changed = true;
        while std::mem::take(&mut changed) {
            self.waiting.retain(|literal| match binds(literal, &self.bound) {
                Some(ids) => {
                    changed |= !ids.is_empty();
                    self.bound.extend(ids);
                    false
                }
                None => true,
            });
        }
    }
}

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
    /// Returns the finished literals; `None` if a literal that one of them needs is missing. `context` are those of the
    /// enclosing clause or aggregates, and `most` says which literals may bind what an aggregate needs.
    ///
    /// The result must not depend on the order of the literals. So an aggregate takes values that only the recursion
    /// provides once no other literal can be finished without them.
    pub fn finish(
        &mut self,
        pending: &[Pending<'c>],
        context: &[Literal],
        finish: &mut Finish<'_>,
        most: Allowed,
    ) -> Option<Vec<Literal>> {
        let mut done: Vec<Option<Literal>> = Vec::with_capacity(pending.len());
        for pending in pending {
            done.push(match is_range(pending) {
                true => None,
                false => self.written(pending),
            });
        }
        if done.iter().all(Option::is_some) {
            return Some(done.into_iter().flatten().collect());
        }
        let mut bound = Bound::default();
        for literal in context.iter().chain(done.iter().flatten()) {
            self.provide(&mut bound, literal, finish);
        }
        let mut allowed = Allowed::Outside;
        while let Some(unfinished) = done.iter().position(Option::is_none) {
            let mut progress = false;
            for index in unfinished..pending.len() {
                if done[index].is_some() || !self.is_ready(&pending[index], bound.by(allowed)) {
                    continue;
                }
                let Some(literal) = self.finished_one(&pending[index], context, &done, finish, allowed) else {
                    continue;
                };
                self.provide(&mut bound, &literal, finish);
                done[index] = Some(literal);
                progress = true;
                if allowed == Allowed::All {
                    break;
                }
            }
            allowed = match (progress, allowed) {
                (true, _) => Allowed::Outside,
                (false, Allowed::Outside) if most == Allowed::All => Allowed::All,
                (false, _) => return None,
            };
        }
        Some(done.into_iter().flatten().collect())
    }

    /// Returns the literal of an aggregate or range; `None` if one that it needs is missing.
    fn finished_one(
        &mut self,
        pending: &Pending<'c>,
        context: &[Literal],
        done: &[Option<Literal>],
        finish: &mut Finish<'_>,
        allowed: Allowed,
    ) -> Option<Literal> {
        let near: Vec<Literal> = done.iter().flatten().cloned().collect();
        let Pending::Aggregate {
            to,
            op,
            target,
            body,
            level,
            span,
        } = pending
        else {
            return self.range_literal(pending, &near, context, finish, allowed);
        };
        let head = Head {
            to: *to,
            op: *op,
            target: *target,
            level: *level,
            span: *span,
        };
        let around: Vec<Literal> = context.iter().cloned().chain(near).collect();
        self.aggregate_literal(head, body, &around, finish, allowed)
    }

    /// Adds the variables that the literal binds.
    fn provide(&self, bound: &mut Bound, literal: &Literal, finish: &Finish<'_>) {
        bound.all.add(literal);
        if self.is_outside(literal, finish) {
            bound.outside.add(literal);
        }
    }

    /// Returns whether the literal needs no value that only the recursion of the clause provides.
    pub fn is_outside(&self, literal: &Literal, finish: &Finish<'_>) -> bool {
        literal
            .atom()
            .is_none_or(|atom| !self.is_recursive(atom.predicate, finish))
    }

    /// Returns whether the literals around an aggregate or range bind what it needs, given the variables that they bind.
    fn is_ready(&self, pending: &Pending<'c>, bound: &Binding) -> bool {
        let bound = &bound.bound;
        match pending {
            Pending::Aggregate {
                target, body, level, ..
            } => {
                let own = self.bound_in(body, bound);
                let mut ready = true;
                self.each_variable(body, *target, &mut |id, check| {
                    ready &= check.level(id).is_none_or(|found| found >= *level) || own.contains(&id);
                });
                ready
            }
            Pending::Compute { arguments, .. } => arguments.iter().all(|argument| match argument.kind {
                OperandKind::Variable(id) => bound.contains(&id),
                _ => true,
            }),
            Pending::Atom { .. } | Pending::Compare { .. } | Pending::Record { .. } => true,
        }
    }

    /// Returns the variables that the body of an aggregate binds, in addition to those bound around it.
    fn bound_in(&self, body: &[Pending<'c>], around: &BTreeSet<VarId>) -> BTreeSet<VarId> {
        let mut bound = around.clone();
        let mut changed = true;
        while std::mem::take(&mut changed) {
            for pending in body {
                let known = |operand: &Operand| match operand.kind {
                    OperandKind::Variable(id) => bound.contains(&id),
                    _ => true,
                };
                let mut binds = Vec::new();
                match pending {
                    Pending::Atom {
                        negated: false, atom, ..
                    } => binds.extend(atom.terms.iter().filter_map(Term::variable)),
                    Pending::Compare {
                        op: Comparison::Equal,
                        left,
                        right,
                        ..
                    } if known(left) || known(right) => {
                        binds.extend([left, right].into_iter().filter_map(|operand| match operand.kind {
                            OperandKind::Variable(id) => Some(id),
                            _ => None,
                        }));
                    }
                    Pending::Compute { to, arguments, .. } if arguments.iter().all(known) => binds.push(*to),
                    Pending::Aggregate { to, level, .. } => {
                        let mut ready = true;
                        self.each_variable(std::slice::from_ref(pending), None, &mut |id, check| {
                            ready &= id == *to || check.variables[id.index()].level >= *level || bound.contains(&id);
                        });
                        if ready {
                            binds.push(*to);
                        }
                    }
                    Pending::Atom { .. }
                    | Pending::Compare { .. }
                    | Pending::Compute { .. }
                    | Pending::Record { .. } => {}
                }
                for id in binds {
                    changed |= bound.insert(id);
                }
            }
        }
        bound
    }

    /// Returns the literal of an aggregate; `None` while an outer literal that it needs is missing.
    fn aggregate_literal(
        &mut self,
        head: Head,
        body: &[Pending<'c>],
        context: &[Literal],
        finish: &mut Finish<'_>,
        allowed: Allowed,
    ) -> Option<Literal> {
        let mut inner = self.finish(body, context, finish, allowed)?;
        let base = head.target.map_or(BaseType::Number, |target| self.settled_base(target));
        let target = head.target.map(|target| self.finished(target, base));

        let guards = self.guards(head, &mut inner, finish);
        if let ([Literal::Positive(atom)], true) = (inner.as_slice(), guards.is_empty())
            && let Some(literal) = self.direct(head, atom, target, base)
        {
            return Some(literal);
        }
        inner.extend(guards);

        let shared: BTreeSet<VarId> = (inner.iter().flat_map(Literal::terms).chain(&target))
            .filter_map(|term| match term {
                Term::Variable(id) if !self.is_own(head, *id) => Some(*id),
                _ => None,
            })
            .collect();
        let mut own = match head.op {
            AggregateOp::Min | AggregateOp::Max => BTreeSet::new(),
            _ => self.own_columns(head, &mut inner, finish),
        };
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
        let parameters = self.parameters(&shared, &mut inner, context, finish, allowed)?;

        // Shared variables first.
        let columns: Vec<VarId> = shared.iter().chain(&own).copied().collect();
        let predicate = self.define(&columns, parameters, inner, head, finish);
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
                predicate,
                terms: columns.iter().map(term).collect(),
                span: head.span,
            },
            column: target.and_then(|target| columns.iter().position(|column| *column == target)),
        })
    }

    /// Whether a variable belongs to an aggregate, not to what surrounds it.
    fn is_own(&self, head: Head, id: VarId) -> bool {
        self.level(id).is_none_or(|level| level >= head.level)
    }

    /// Returns the own variables in the atoms of an aggregate, after giving each of their wildcards one.
    fn own_columns(&mut self, head: Head, inner: &mut [Literal], finish: &mut Finish<'_>) -> BTreeSet<VarId> {
        let mut own = BTreeSet::new();
        for literal in inner {
            let Literal::Positive(atom) = literal else { continue };
            let types = self.names.signatures[atom.predicate.index()]
                .columns
                .clone()
                .unwrap_or_default();
            for (term, ty) in atom.terms.iter_mut().zip(types) {
                if *term == Term::Wildcard {
                    let ty = ty.map_or(VariableType::Unknown, VariableType::Type);
                    *term = Term::Variable(fresh(finish.variables, ty, head.span));
                }
                if let Term::Variable(id) = *term
                    && self.is_own(head, id)
                {
                    own.insert(id);
                }
            }
        }
        own
    }

    /// Grounds the shared variables of an aggregate with literals of the context, or makes them parameters. Returns the
    /// number of parameters; `None` while an outer literal is missing.
    fn parameters(
        &mut self,
        shared: &BTreeSet<VarId>,
        inner: &mut Vec<Literal>,
        context: &[Literal],
        finish: &Finish<'_>,
        allowed: Allowed,
    ) -> Option<usize> {
        let outside = |literal: &Literal| self.is_outside(literal, finish);
        let Some(added) = grounding(shared, inner, context, &outside) else {
            if allowed == Allowed::Outside {
                return None;
            }
            grounding(shared, inner, context, &|_| true)?;
            return Some(shared.len());
        };
        for literal in added.into_iter().map(|position| &context[position]) {
            if let Some(atom) = literal.atom()
                && !self.names.predicate(atom.predicate).hidden
            {
                self.edge(atom.predicate, EdgeKind::Aggregates, atom.span);
            }
            inner.push(literal.clone());
        }
        Some(0)
    }

    /// Returns the aggregate over the atom itself, unless one of its own variables occurs twice.
    fn direct(&self, head: Head, atom: &Atom, target: Option<Term>, base: BaseType) -> Option<Literal> {
        let mut seen = BTreeSet::new();
        let mut terms = atom.terms.clone();
        for term in &mut terms {
            if let Term::Variable(id) = *term
                && self.is_own(head, id)
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
            let types = self.names.signatures[atom.predicate.index()]
                .columns
                .clone()
                .unwrap_or_default();
            for (term, ty) in atom.terms.iter_mut().zip(types) {
                let in_view = ty.is_some_and(|ty| scope::is_seen(VariableType::Type(ty), guard.seen, self.names));
                match *term {
                    Term::Wildcard if in_view && negated => {
                        let fault = Diagnostic::new(
                            codes::UNSUPPORTED,
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
                        if is_own && !known.hidden && scope::is_seen(known.ty, guard.seen, self.names) {
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
            Some(Term::Variable(id)) if scope::is_seen(finish.variables[id.index()].ty, guard.ego, self.names) => id,
            _ => {
                let fault = Diagnostic::new(codes::INVALID_SCOPE, "cannot guard this aggregate")
                    .at(head.span, "")
                    .also(guard.span, "the scope")
                    .note("under a scope, an aggregate ranges over what the head's first argument sees")
                    .help("end the scope before the clause: `.scope`");
                self.report(fault);
                return Vec::new();
            }
        };
        self.edge(guard.predicate, EdgeKind::Aggregates, guard.span);
        let atom = |target: VarId| Atom {
            predicate: guard.predicate,
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
    pub fn is_recursive(&self, predicate: PredicateId, finish: &Finish<'_>) -> bool {
        let (mut todo, mut hidden) = (vec![predicate], Vec::new());
        while let Some(predicate) = todo.pop() {
            if !self.names.predicate(predicate).hidden {
                if self.names.components[predicate.index()] == self.names.components[finish.head.index()] {
                    return true;
                }
            } else if self.names.predicate(predicate).parameters > 0 {
                // Only the recursion gives values to the parameters.
                return true;
            } else if !hidden.contains(&predicate) {
                hidden.push(predicate);
                let clauses = finish.hidden.iter().filter(|clause| clause.head.predicate == predicate);
                let atoms = clauses.flat_map(|clause| &clause.body).filter_map(Literal::atom);
                todo.extend(atoms.map(|atom| atom.predicate));
            }
        }
        false
    }

    /// Defines a hidden predicate with these columns. The first of them are parameters.
    fn define(
        &mut self,
        columns: &[VarId],
        parameters: usize,
        mut body: Vec<Literal>,
        head: Head,
        finish: &mut Finish<'_>,
    ) -> PredicateId {
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
        let predicate = self.names.hide(columns.iter().map(column).collect(), doc, head.span);
        self.names.predicates[predicate.index()].parameters = parameters;
        let mut terms: Vec<Term> = columns.iter().map(|id| Term::Variable(*id)).collect();
        let variables = renumber(finish.variables.clone(), std::iter::once(&mut terms), &mut body);
        finish.hidden.push(Clause {
            head: Atom {
                predicate,
                terms,
                span: head.span,
            },
            body,
            variable_spans: variables.iter().map(|variable| variable.first).collect(),
            variables: variables.into_iter().map(|variable| variable.name).collect(),
            doc: String::new(),
            span: head.span,
        });
        predicate
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
    // A literal that needs a value from nowhere else, such as that of this aggregate itself, binds nothing.
    let mut around = inner.to_vec();
    around.extend(context.iter().filter(|literal| usable(literal)).cloned());
    let bindable = bound_by(&around);
    let usable = |literal: &Literal| usable(literal) && literal.variables().all(|id| bindable.contains(&id));
    // The variables for which a literal was taken; it may need further variables.
    let mut given = BTreeSet::new();
    loop {
        let bound = bound_by(&body);
        let needed = body.iter().flat_map(Literal::variables);
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
    let mut binding = Binding::default();
    literals.iter().for_each(|literal| binding.add(literal));
    binding.bound
}

/// Returns the variables that a literal binds; `None` while it lacks bound variables to bind others.
fn binds(literal: &Literal, bound: &BTreeSet<VarId>) -> Option<Vec<VarId>> {
    let known = |term: &Term| term.variable().is_none_or(|id| bound.contains(&id));
    let gives: Vec<&Term> = match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => atom.terms.iter().collect(),
        Literal::Compare {
            op: Comparison::Equal,
            left,
            right,
            ..
        } => match known(left) || known(right) {
            true => vec![left, right],
            false => return None,
        },
        Literal::Compute { to, arguments, .. } => match arguments.iter().all(known) {
            true => vec![to],
            false => return None,
        },
        Literal::Aggregate { to, atom, .. } => match atom.terms.iter().all(known) {
            true => vec![to],
            false => return None,
        },
        Literal::Compare { .. } | Literal::Negative(_) => Vec::new(),
    };
    Some(gives.into_iter().filter_map(Term::variable).collect())
}

fn is_range(pending: &Pending<'_>) -> bool {
    matches!(
        pending,
        Pending::Compute {
            functor: Functor::Range,
            ..
        }
    )
}
