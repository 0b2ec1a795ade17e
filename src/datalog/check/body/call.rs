//! User-defined functors: `@f(x, y)`.

use crate::check::body::types::{Tie, TieKind, only};
use crate::check::body::{Check, Operand, OperandKind, Pending, Use};
use crate::check::rules::{Literal, Term, TypeId, UserFunctor, VarId};
use crate::codes;
use crate::diag::{Diagnostic, Span};
use crate::syntax::ast;
use crate::syntax::ast::{BaseType, TermKind};
use crate::syntax::functor::Functor;
use crate::value::Value;

impl<'c> Check<'_, 'c> {
    /// Returns the operand for an application, whose first argument is the name of the functor.
    pub(super) fn call(&mut self, term: &'c ast::Term, arguments: &'c [ast::Term], into: Option<VarId>) -> OperandKind {
        let Some((
            ast::Term {
                kind: TermKind::Symbol(name),
                place,
            },
            arguments,
        )) = arguments.split_first()
        else {
            return OperandKind::Nothing;
        };
        let span = term.place.0;
        let mut operands: Vec<Operand> = arguments.iter().map(|argument| self.operand(argument, None)).collect();
        let to = into.unwrap_or_else(|| self.value_of(term));
        let at = match self.names.functor(name) {
            Ok(Some(at)) => at,
            Ok(None) => {
                self.sound = false;
                self.excuse(to);
                return OperandKind::Variable(to);
            }
            Err(near) => {
                self.sound = false;
                if self.names.complete() {
                    let message = format!("no functor `{name}` is declared");
                    let fault = Diagnostic::new(codes::UNKNOWN_FUNCTOR, message).at(place.0, "");
                    self.fault(match near {
                        Some(near) => fault.did_you_mean(&near, &[place.0]),
                        None => fault.help(format!(
                            "declare it with its types, such as `.functor {name}(x: number): number`"
                        )),
                    });
                }
                self.excuse(to);
                return OperandKind::Variable(to);
            }
        };
        let functor = &self.names.functors[at as usize];
        let (wanted, result, declared) = (functor.arguments.len(), functor.result, functor.span);
        let types: Vec<_> = functor.arguments.iter().map(|argument| argument.ty).collect();
        if wanted != operands.len() {
            let plural = |count: usize| if count == 1 { "argument" } else { "arguments" };
            let found = operands.len();
            let message = format!("`@{name}` takes {wanted} {}, not {found}", plural(wanted));
            let fault = Diagnostic::new(codes::ARITY_MISMATCH, message)
                .at(span, format!("{found} {} here", plural(found)))
                .also(declared, "declared here");
            self.fault(fault);
            self.excuse(to);
            return OperandKind::Variable(to);
        }
        self.narrow(to.index(), Use { ty: result, span });
        for ((operand, argument), ty) in operands.iter_mut().zip(arguments).zip(types) {
            let base = self.names.base(ty);
            match operand.kind {
                OperandKind::Whole(_) if !matches!(base, BaseType::Symbol | BaseType::Record) => {
                    operand.kind = OperandKind::Constant(self.value(*operand, base), base);
                }
                OperandKind::Whole(number) => {
                    let wanted = self.names.type_name(ty).to_owned();
                    let message = format!("expected a value of type `{wanted}`, found `{number}`");
                    let fault = Diagnostic::new(codes::TYPE_MISMATCH, message)
                        .at(operand.span, format!("must be of type `{wanted}`"))
                        .also(declared, "declared here");
                    self.fault(fault);
                    operand.kind = OperandKind::Nothing;
                }
                // The declaration determines the type of a record.
                OperandKind::Variable(id) if base == BaseType::Record => {
                    let is_made = matches!(&argument.kind, TermKind::Functor(Functor::Pack, _));
                    if is_made {
                        let span = argument.place.0;
                        self.narrow(id.index(), Use { ty, span });
                    }
                }
                OperandKind::Constant(_, BaseType::Record) if base == BaseType::Record => {
                    self.check_nil(ty, operand.span);
                }
                _ => {}
            }
        }
        let position = Operand {
            kind: OperandKind::Constant(Value(at), BaseType::Unsigned),
            span: place.0,
        };
        self.push(Pending::Compute {
            to,
            functor: Functor::Call,
            arguments: std::iter::once(position).chain(operands).collect(),
            ty: Some(result),
            span,
        });
        OperandKind::Variable(to)
    }

    /// Returns the functor that the first argument of a call names, with its position.
    fn declaration(&self, arguments: &[Operand]) -> Option<(u32, &UserFunctor)> {
        match arguments.first()?.kind {
            OperandKind::Constant(at, _) => Some((at.0, self.names.functors.get(at.0 as usize)?)),
            _ => None,
        }
    }

    /// Returns the variables among the arguments of a call, with the declared types.
    pub(super) fn arguments_of(&self, pending: &Pending<'c>) -> Vec<(VarId, TypeId)> {
        let Pending::Compute {
            functor: Functor::Call,
            arguments,
            ..
        } = pending
        else {
            return Vec::new();
        };
        let declared = self
            .declaration(arguments)
            .into_iter()
            .flat_map(|(_, functor)| &functor.arguments);
        (arguments[1..].iter().zip(declared))
            .filter_map(|(operand, argument)| match operand.kind {
                OperandKind::Variable(id) => Some((id, argument.ty)),
                _ => None,
            })
            .collect()
    }

    /// Collects the base types of arguments and result.
    pub(super) fn ties_of_call(&self, result: Operand, arguments: &[Operand], span: Span, out: &mut Vec<Tie>) {
        let Some((at, functor)) = self.declaration(arguments) else {
            return;
        };
        let kind = TieKind::Call(at);
        for (operand, argument) in arguments[1..].iter().zip(&functor.arguments) {
            out.push(Tie::new(kind, &[*operand], only(argument.base), span));
        }
        out.push(Tie::new(kind, &[result], only(functor.base), span));
    }

    /// Returns the finished literal; `None` if the functor is not declared.
    pub(super) fn called(&mut self, to: VarId, arguments: &[Operand], span: Span) -> Option<Literal> {
        let (_, functor) = self.declaration(arguments)?;
        let base = functor.base;
        let bases = functor.arguments.iter().map(|argument| argument.base);
        let bases: Vec<BaseType> = std::iter::once(BaseType::Unsigned).chain(bases).collect();
        Some(Literal::Compute {
            to: Term::Variable(to),
            functor: Functor::Call,
            base,
            arguments: (arguments.iter().zip(bases))
                .map(|(&argument, base)| self.finished(argument, base))
                .collect(),
            span,
        })
    }
}
