//! `autoinc()` in a clause: splits the body at the numbers.

use crate::check::body::Check;
use crate::check::clauses::{EdgeKind, Known, VariableType, renumber};
use crate::check::counter;
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, PredicateId, Term, TypeId, VarId};
use crate::codes;
use crate::diag::{Diagnostic, Span};
use crate::syntax::ast::BaseType;
use crate::syntax::functor::Functor;
use crate::value::Value;
use std::collections::BTreeSet;

impl Check<'_, '_> {
    /// Reports `autoinc()` in an aggregate.
    pub(super) fn check_counter(&mut self, span: Span) {
        if self.levels.len() > 1 {
            let fault =
                Diagnostic::new(codes::UNSUPPORTED, "`autoinc()` in an aggregate is not supported").at(span, "");
            self.fault(fault.help("number the rows in a predicate of their own, and aggregate that"));
        }
    }

    /// Replaces the literals without numbers by an atom of a hidden predicate, which numbers their solutions.
    pub(super) fn numbered(
        &mut self,
        head: PredicateId,
        literals: Vec<Literal>,
        variables: &mut Vec<Known>,
        hidden: &mut Vec<Clause>,
        span: Span,
    ) -> Vec<Literal> {
        let counters: Vec<Term> = (literals.iter())
            .filter_map(|literal| match literal {
                Literal::Compute { to, .. } if is_counter(literal) => Some(*to),
                _ => None,
            })
            .collect();
        if counters.is_empty() {
            return literals;
        }
        // No executor evaluates a clause with a value whose type is unknown: a declaration is faulty.
        self.split(head, &counters, literals.clone(), variables, hidden, span)
            .unwrap_or(literals)
    }

    /// Returns the literals that remain; `None` if the type of a value is unknown.
    fn split(
        &mut self,
        head: PredicateId,
        counters: &[Term],
        literals: Vec<Literal>,
        variables: &mut Vec<Known>,
        hidden: &mut Vec<Clause>,
        span: Span,
    ) -> Option<Vec<Literal>> {
        // What depends on the numbers stays.
        let mut late: BTreeSet<VarId> = counters.iter().filter_map(Term::variable).collect();
        let (mut early, mut rest) = (Vec::new(), Vec::new());
        let mut waiting: Vec<Literal> = literals.into_iter().filter(|literal| !is_counter(literal)).collect();
        loop {
            let before = waiting.len();
            let (with, without): (Vec<Literal>, Vec<Literal>) =
                std::mem::take(&mut waiting).into_iter().partition(|literal| {
                    !matches!(literal, Literal::Positive(_) | Literal::Guard(_))
                        && literal.variables().any(|id| late.contains(&id))
                });
            for literal in &with {
                match literal {
                    Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => late.extend(to.variable()),
                    Literal::Compare { left, right, .. } => {
                        late.extend([left, right].into_iter().filter_map(Term::variable));
                    }
                    _ => {}
                }
            }
            rest.extend(with);
            waiting = without;
            if waiting.len() == before {
                break;
            }
        }
        // A positive atom with a number finds its rows without it.
        for literal in waiting {
            match literal {
                Literal::Positive(mut atom) | Literal::Guard(mut atom) => {
                    for (column, term) in atom.terms.iter_mut().enumerate() {
                        if *term == Term::Wildcard {
                            // Each row counts.
                            let value = VarId(u32::try_from(variables.len()).expect("few variables"));
                            variables.push(Known {
                                name: "_".to_owned(),
                                ty: VariableType::Type(self.column(atom.predicate, column)?),
                                first: atom.span,
                                count: 1,
                                hidden: true,
                            });
                            *term = Term::Variable(value);
                        }
                        let Some(id) = term.variable().filter(|id| counters.contains(&Term::Variable(*id))) else {
                            continue;
                        };
                        let value = VarId(u32::try_from(variables.len()).expect("few variables"));
                        variables.push(variables[id.index()].clone());
                        *term = Term::Variable(value);
                        rest.push(equal(Term::Variable(value), Term::Variable(id), span));
                    }
                    early.push(Literal::Positive(atom));
                }
                other => early.push(other),
            }
        }
        let columns: BTreeSet<VarId> = early.iter().flat_map(Literal::variables).collect();
        let typed = |id: &VarId| {
            let Known { name, ty, .. } = &variables[id.index()];
            let ty: TypeId = match ty {
                VariableType::Type(ty) => *ty,
                VariableType::Base(base) => Names::base_type(*base),
                VariableType::Unknown => return None,
            };
            Some((name.clone(), ty))
        };
        let typed: counter::Columns = columns.iter().map(typed).collect::<Option<_>>()?;
        let doc = "the solutions that `autoinc()` numbers".to_owned();
        let solutions = self.names.hide(typed.clone(), doc, span);
        for literal in &early {
            let kind = match literal {
                Literal::Positive(_) | Literal::Guard(_) => EdgeKind::Needs,
                Literal::Negative(_) => EdgeKind::Negates,
                _ => EdgeKind::Aggregates,
            };
            if let Some(atom) = literal.atom() {
                self.numbered_edges.push((solutions, atom.predicate, kind, span));
            }
        }
        let terms: Vec<Term> = columns.iter().copied().map(Term::Variable).collect();
        let mut own = terms.clone();
        let known = renumber(variables.clone(), std::iter::once(&mut own), &mut early);
        let solved = Clause {
            head: Atom {
                predicate: solutions,
                terms: own,
                span,
            },
            body: early,
            variable_spans: known.iter().map(|variable| variable.first).collect(),
            variables: known.into_iter().map(|variable| variable.name).collect(),
            doc: String::new(),
            span,
        };
        let each = u32::try_from(counters.len()).expect("few expressions");
        let numbers = counter::define(self.names, hidden, (typed, each), solved, span);
        self.numbered_edges
            .push((numbers, solutions, EdgeKind::Aggregates, span));
        self.numbered_edges.push((head, numbers, EdgeKind::Needs, span));
        let first = counters[0];
        let mut body = vec![Literal::Positive(Atom {
            predicate: numbers,
            terms: std::iter::once(first).chain(terms).collect(),
            span,
        })];
        for (at, &to) in counters.iter().enumerate().skip(1) {
            let step = i32::try_from(at).expect("few expressions");
            body.push(Literal::Compute {
                to,
                functor: Functor::Add,
                base: BaseType::Number,
                arguments: vec![first, Term::Constant(Value::number(step))],
                span,
            });
        }
        body.append(&mut rest);
        Some(body)
    }
}

fn is_counter(literal: &Literal) -> bool {
    matches!(literal, Literal::Compute { functor, .. } if *functor == Functor::Counter)
}

fn equal(left: Term, right: Term, span: Span) -> Literal {
    Literal::Compare {
        op: crate::syntax::ast::Comparison::Equal,
        left,
        right,
        base: BaseType::Number,
        span,
    }
}
