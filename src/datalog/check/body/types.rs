//! Type inference: from the columns of each variable, its comparisons and the expressions around it.

use crate::chance;
use crate::check::names::Names;
use crate::check::rules::{Atom, Term, VarId};
use crate::codes;
use crate::diag::{Diagnostic, Span};
use crate::record;
use crate::symbol::{Symbol, WordSize};
use crate::syntax::ast;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor, Shape};

use crate::check::body::{Check, Operand, OperandKind, Pending, Use};
use crate::check::clauses::VariableType;

impl<'c> Check<'_, 'c> {
    pub(super) fn group(&self, mut at: usize) -> usize {
        while let Some(next) = self.variables[at].typed_as {
            at = next;
        }
        at
    }

    /// Adds a column that a variable or group occurs in.
    pub(super) fn narrow(&mut self, variable: usize, further: Use) {
        let Some(known) = self.variables[variable].narrowest else {
            self.variables[variable].narrowest = Some(further);
            return;
        };
        match self.names.meet(known.ty, further.ty) {
            Some(meet) => {
                if meet != known.ty {
                    self.variables[variable].narrowest = Some(Use { ty: meet, ..further });
                }
            }
            None => self.clash(variable, known, further),
        }
    }

    fn clash(&mut self, variable: usize, known: Use, further: Use) {
        if self.variables[variable].excused {
            return;
        }
        self.variables[variable].excused = true;
        let name = self.name(VarId(u32::try_from(variable).expect("fewer than 2^32 variables")));
        let (first, second) = (
            self.names.type_name(known.ty).to_owned(),
            self.names.type_name(further.ty).to_owned(),
        );
        let fault = Diagnostic::new(
            codes::TYPE_MISMATCH,
            format!("`{name}` cannot be both `{first}` and `{second}`"),
        )
        .at(further.span, format!("`{second}` here"))
        .also(known.span, format!("`{first}` here"));
        self.fault(fault);
    }

    /// Unites compared variables, and the result of `min`, `max` or `sum` with its target.
    pub(super) fn join_compared(&mut self, pending: &[Pending<'c>]) {
        for pending in pending {
            match pending {
                Pending::Compare { left, right, span, .. } => self.join(*left, *right, *span),
                Pending::Aggregate {
                    to,
                    op,
                    target,
                    body,
                    span,
                    ..
                } => {
                    self.join_compared(body);
                    let result = Operand::variable(*to, *span);
                    if let (AggregateOp::Min | AggregateOp::Max | AggregateOp::Sum, Some(target)) = (op, target) {
                        self.join(result, *target, *span);
                    }
                }
                Pending::Atom { .. } | Pending::Compute { .. } | Pending::Record { .. } => {}
            }
        }
    }

    fn join(&mut self, left: Operand, right: Operand, span: Span) {
        let (OperandKind::Variable(a), OperandKind::Variable(b)) = (left.kind, right.kind) else {
            return;
        };
        let groups = [self.group(a.index()), self.group(b.index())];
        if groups[0] == groups[1] {
            return;
        }
        let [first, second] = groups.map(|group| self.variables[group].narrowest);
        let excused = groups.iter().any(|&group| self.variables[group].excused);
        let narrowest = match (first, second) {
            (Some(first), Some(second)) => match self.names.meet(first.ty, second.ty) {
                Some(meet) if meet == first.ty => Some(first),
                Some(meet) => Some(Use { ty: meet, ..second }),
                None => {
                    // `check_tie` reports different base types.
                    if !excused && self.names.base(first.ty) == self.names.base(second.ty) {
                        let types = [first.ty, second.ty].map(|ty| self.names.type_name(ty).to_owned());
                        self.incomparable([(left, &types[0]), (right, &types[1])], span);
                    }
                    return;
                }
            },
            (one, other) => one.or(other),
        };
        // The later group joins the earlier one, which keeps the chains short.
        let [into, from] = [groups[0].min(groups[1]), groups[0].max(groups[1])];
        self.variables[from].typed_as = Some(into);
        self.variables[into].excused = excused;
        self.variables[into].narrowest = narrowest;
    }

    pub(super) fn type_of_variable(&self, id: VarId) -> VariableType {
        let group = &self.variables[self.group(id.index())];
        match (group.narrowest, group.base) {
            (Some(narrowest), _) => VariableType::Type(narrowest.ty),
            (None, Some((base, _))) => VariableType::Base(base),
            (None, None) => VariableType::Unknown,
        }
    }

    /// Returns the type of a variable; `Unknown` once the checker has reported a fault about it.
    fn type_of(&self, id: VarId) -> VariableType {
        if self.variables[self.group(id.index())].excused {
            VariableType::Unknown
        } else {
            self.type_of_variable(id)
        }
    }

    pub(super) fn base_of_variable(&self, id: VarId) -> Option<BaseType> {
        match self.type_of(id) {
            VariableType::Unknown => None,
            VariableType::Base(base) => Some(base),
            VariableType::Type(ty) => Some(self.names.base(ty)),
        }
    }

    pub(super) fn base_of(&self, operand: Operand) -> Option<BaseType> {
        match operand.kind {
            OperandKind::Variable(id) => self.base_of_variable(id),
            OperandKind::Constant(_, base) => Some(base),
            OperandKind::Whole(_) | OperandKind::Nothing => None,
        }
    }

    /// Returns the place that determines the type of a variable.
    pub(super) fn origin(&self, id: VarId) -> Option<Span> {
        let group = &self.variables[self.group(id.index())];
        let narrowest = group.narrowest.map(|narrowest| narrowest.span);
        narrowest.or(group.base.map(|(_, span)| span))
    }

    /// Infers the base types of variables and constants in comparisons and expressions, and reports mismatches.
    pub(super) fn infer(&mut self, head: Option<&Atom>, pending: &[Pending<'c>]) {
        let mut ties = Vec::new();
        self.ties(pending, &mut ties);
        self.spread(&ties);
        // If nothing else determines the type of a variable, its uses in the head and in negated atoms do.
        if let Some(head) = head {
            self.hint(head);
        }
        let negated = pending.iter().filter_map(|pending| match pending {
            Pending::Atom {
                negated: true, atom, ..
            } => Some(atom),
            _ => None,
        });
        negated.for_each(|atom| self.hint(atom));
        self.spread(&ties);
        for index in 0..ties.len() {
            let tie = &ties[index];
            let numeric = tie.allowed.len() < BaseType::ALL.len()
                || tie
                    .operands
                    .iter()
                    .any(|operand| matches!(operand.kind, OperandKind::Whole(_)));
            if numeric && tie.base(self).is_none() && tie.allowed.contains(&BaseType::Number) {
                self.settle(&ties[index], BaseType::Number);
                self.spread(&ties);
            }
        }
        for tie in &ties {
            self.check_tie(tie);
        }
    }

    /// Gives variables without a base type that of their column in the atom.
    fn hint(&mut self, atom: &Atom) {
        for (column, term) in atom.terms.iter().enumerate() {
            if let (Term::Variable(id), Some(ty)) = (term, self.column(atom.predicate, column)) {
                let (base, span) = (self.names.base(ty), self.variables[id.index()].first);
                let group = self.group(id.index());
                if self.base_of_variable(*id).is_none() {
                    self.variables[group].base = Some((base, span));
                }
            }
        }
    }

    /// Collects the equations between base types.
    fn ties(&self, pending: &[Pending<'c>], out: &mut Vec<Tie>) {
        for pending in pending {
            match pending {
                Pending::Atom { .. } => {}
                Pending::Compare { op, left, right, span } => {
                    let allowed: &[BaseType] = match op {
                        Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => {
                            &[BaseType::Symbol]
                        }
                        Comparison::Equal | Comparison::NotEqual => EQUAL,
                        _ => &BaseType::ALL,
                    };
                    out.push(Tie::new(TieKind::Compare, &[*left, *right], allowed, *span));
                }
                Pending::Compute {
                    to,
                    functor,
                    arguments,
                    ty,
                    span,
                } => {
                    let result = Operand::variable(*to, *span);
                    let kind = TieKind::Functor(functor.name());
                    match functor.shape() {
                        Shape::Same(allowed) => {
                            let all: Vec<Operand> = std::iter::once(result).chain(arguments.iter().copied()).collect();
                            out.push(Tie::new(kind, &all, allowed, *span));
                        }
                        Shape::Convert(allowed, base) => {
                            out.push(Tie::new(kind, arguments, allowed, *span));
                            let base = ty.map_or(base, |ty| self.names.base(ty));
                            if *functor != Functor::Cast || ty.is_some() {
                                out.push(Tie::new(kind, &[result], only(base), *span));
                            }
                        }
                        // `directed` makes these literals later.
                        Shape::Record => {}
                        Shape::Declared => self.ties_of_call(result, arguments, *span, out),
                        Shape::Choice => {
                            for &argument in probabilities(arguments) {
                                out.push(Tie::new(
                                    TieKind::Probability,
                                    &[argument],
                                    only(BaseType::Float),
                                    *span,
                                ));
                            }
                            out.push(Tie::new(kind, &[result], only(BaseType::Number), *span));
                        }
                        Shape::Fixed(bases, base) => {
                            for (argument, base) in arguments.iter().zip(bases) {
                                out.push(Tie::new(kind, &[*argument], only(*base), *span));
                            }
                            out.push(Tie::new(kind, &[result], only(base), *span));
                        }
                    }
                }
                Pending::Record { to, span, .. } => {
                    let result = Operand::variable(*to, *span);
                    let kind = TieKind::Functor(Functor::Pack.name());
                    out.push(Tie::new(kind, &[result], only(BaseType::Record), *span));
                }
                Pending::Aggregate {
                    to,
                    op,
                    target,
                    body,
                    span,
                    ..
                } => {
                    self.ties(body, out);
                    let result = Operand::variable(*to, *span);
                    let kind = TieKind::Functor(op.name());
                    match (op, target) {
                        (AggregateOp::Mean, Some(target)) => {
                            out.push(Tie::new(kind, &[*target], op.takes(), *span));
                            out.push(Tie::new(kind, &[result], only(BaseType::Float), *span));
                        }
                        (_, Some(target)) => out.push(Tie::new(kind, &[result, *target], op.takes(), *span)),
                        (_, None) => out.push(Tie::new(kind, &[result], only(BaseType::Number), *span)),
                    }
                }
            }
        }
    }

    /// Propagates base types along the ties up to a fixpoint.
    fn spread(&mut self, ties: &[Tie]) {
        let mut changed = true;
        while std::mem::take(&mut changed) {
            for tie in ties {
                if let Some(base) = tie.base(self) {
                    changed |= self.settle(tie, base);
                }
            }
        }
    }

    /// Gives the base type to all variables of a tie that have none.
    fn settle(&mut self, tie: &Tie, base: BaseType) -> bool {
        let mut changed = false;
        for operand in &tie.operands {
            if let OperandKind::Variable(id) = operand.kind {
                let group = self.group(id.index());
                if !self.variables[group].excused && self.base_of_variable(id).is_none() {
                    self.variables[group].base = Some((base, operand.span));
                    changed = true;
                }
            }
        }
        changed
    }

    fn check_tie(&mut self, tie: &Tie) {
        let known: Vec<(Operand, BaseType)> = (tie.operands.iter())
            .filter_map(|&operand| match operand.kind {
                // A plain number fits every base type except `symbol`.
                OperandKind::Whole(_) if tie.base(self) == Some(BaseType::Symbol) => Some((operand, BaseType::Number)),
                _ => Some((operand, self.base_of(operand)?)),
            })
            .collect();
        let Some(&(first, base)) = known.first() else { return };
        let other = known.iter().find(|(_, other)| *other != base).copied();
        if let (TieKind::Compare, Some(other)) = (tie.kind, other)
            && tie.allowed.len() > 1
        {
            self.incomparable([(first, base.name()), (other.0, other.1.name())], tie.span);
            return;
        }
        let wrong = || known.iter().filter(|(_, found)| !tie.allowed.contains(found));
        // An operand whose type comes from elsewhere explains more than a result.
        let from_elsewhere = wrong().find(|(operand, _)| match operand.kind {
            OperandKind::Variable(id) => self.origin(id).is_some_and(|origin| origin != operand.span),
            _ => false,
        });
        if let Some((operand, found)) = from_elsewhere.or_else(|| wrong().next()) {
            let wanted: Vec<String> = tie.allowed.iter().map(|base| format!("`{}`", base.name())).collect();
            let what = match tie.kind {
                TieKind::Compare => "this takes values".to_owned(),
                TieKind::Functor(name) => format!("`{name}` takes or returns values"),
                TieKind::Call(at) => {
                    let name = &self.names.functors[at as usize].name;
                    format!("`@{name}` takes or returns values")
                }
                TieKind::Probability => "a probability is a value".to_owned(),
            };
            let message = format!("{what} of type {}, not `{}`", wanted.join(" or "), found.name());
            let mut fault =
                Diagnostic::new(codes::TYPE_MISMATCH, message).at(operand.span, format!("`{}`", found.name()));
            let operand = *operand;
            if let TieKind::Probability = tie.kind {
                fault = fault.help("convert it: `to_float(n) / 100.0`");
            } else if (*found == BaseType::Symbol) != (tie.allowed[0] == BaseType::Symbol)
                && ![*found, tie.allowed[0]].contains(&BaseType::Record)
            {
                let mend = self.rewritten(operand, tie.allowed[0]).or_else(|| {
                    let id = self.variable_of(operand)?;
                    Some(format!("convert it: `{}`", self.converted(id, tie.allowed[0])))
                });
                fault = mend.into_iter().fold(fault, Diagnostic::help);
            }
            self.report_with_origin(fault, operand);
        } else if let Some((operand, found)) = other {
            let name = match tie.kind {
                TieKind::Compare => "=",
                TieKind::Functor(name) => name,
                TieKind::Call(at) => &self.names.functors[at as usize].name,
                TieKind::Probability => "::",
            };
            let message = format!("`{name}` cannot mix a `{}` and a `{}`", base.name(), found.name());
            let fault = Diagnostic::new(codes::TYPE_MISMATCH, message)
                .at(operand.span, format!("`{}`", found.name()))
                .also(first.span, format!("`{}`", base.name()))
                .help("convert one of them: `to_number(x)`, `to_unsigned(x)`, `to_float(x)` or `to_string(x)`");
            self.report_with_origin(fault, operand);
        }
    }

    fn report_with_origin(&mut self, mut fault: Diagnostic, operand: Operand) {
        if let OperandKind::Variable(id) = operand.kind {
            if let Some(origin) = self.origin(id)
                && origin != operand.span
            {
                fault = fault.also(origin, "its type comes from here");
            }
            let group = self.group(id.index());
            self.variables[group].excused = true;
        }
        self.fault(fault);
    }

    /// Reports two operands of incomparable types, each with the name of its type.
    fn incomparable(&mut self, sides: [(Operand, &str); 2], span: Span) {
        let message = format!("a `{}` cannot be compared with a `{}`", sides[0].1, sides[1].1);
        let mut fault = Diagnostic::new(codes::TYPE_MISMATCH, message).at(span, "");
        for (operand, ty) in sides {
            if let OperandKind::Variable(id) = operand.kind
                && let Some(origin) = self.origin(id)
            {
                fault = fault.also(origin, format!("`{}` is a `{ty}` here", self.name(id)));
            }
        }
        let sides = sides.map(|(operand, _)| operand);
        if let Some(help) = self.comparable(sides) {
            fault = fault.help(help);
        }
        self.fault(fault);
    }

    /// Returns how to make two operands comparable.
    fn comparable(&self, sides: [Operand; 2]) -> Option<String> {
        let base = |operand: Operand| match operand.kind {
            OperandKind::Whole(_) => Some(BaseType::Number),
            _ => self.base_of(operand),
        };
        let bases = [base(sides[0])?, base(sides[1])?];
        if bases[0] == bases[1] {
            // Two types of one base type.
            let OperandKind::Variable(id) = sides[0].kind else {
                return None;
            };
            let VariableType::Type(ty) = self.type_of(self.variable_of(sides[1])?) else {
                return None;
            };
            let (name, ty) = (self.name(id), self.names.type_name(ty));
            return Some(format!(
                "declare both columns with one type, or convert a value: `as({name}, {ty})`"
            ));
        }
        let mut mends: Vec<String> = Vec::new();
        for (one, other) in [(0, 1), (1, 0)] {
            mends.extend(self.rewritten(sides[one], bases[other]));
        }
        let rewrites = !mends.is_empty();
        for (one, other) in [(0, 1), (1, 0)] {
            // A conversion loses the fraction of a `float`, and the order of numbers.
            let loses = match bases[other] {
                BaseType::Symbol => rewrites,
                _ => bases[one] == BaseType::Float,
            };
            if let Some(id) = self.variable_of(sides[one]).filter(|_| !loses) {
                mends.push(format!(
                    "convert `{}`: `{}`",
                    self.name(id),
                    self.converted(id, bases[other])
                ));
            }
        }
        match mends.is_empty() {
            true => None,
            false => Some(mends.join(", or ")),
        }
    }

    fn variable_of(&self, operand: Operand) -> Option<VarId> {
        match operand.kind {
            OperandKind::Variable(id) => Some(id),
            _ => None,
        }
    }

    /// Returns a variable with a conversion to a base type, as a rule writes it.
    fn converted(&self, id: VarId, base: BaseType) -> String {
        let ty = match base {
            BaseType::Symbol => "string",
            _ => base.name(),
        };
        format!("to_{ty}({})", self.name(id))
    }

    /// Returns how to write a constant with another base type; `None` if that is not its value.
    pub(super) fn rewritten(&self, operand: Operand, base: BaseType) -> Option<String> {
        let is_long = self.symbols.word_size() == WordSize::Bits64;
        match (operand.kind, base) {
            (OperandKind::Whole(number), BaseType::Symbol) => {
                Some(format!("write `{number}` in quotes: `\"{number}\"`"))
            }
            (OperandKind::Constant(value, BaseType::Symbol), _) => {
                let text = self.symbols.resolve(Symbol(value.0))?;
                let fits = match base {
                    BaseType::Symbol | BaseType::Record => false,
                    BaseType::Number if is_long => text.parse::<i64>().is_ok(),
                    BaseType::Unsigned if is_long => text.parse::<u64>().is_ok(),
                    BaseType::Number => text.parse::<i32>().is_ok(),
                    BaseType::Unsigned => text.parse::<u32>().is_ok(),
                    BaseType::Float => text.parse::<f32>().is_ok_and(f32::is_finite),
                };
                fits.then(|| format!("write the number without quotes: `{text}`"))
            }
            (OperandKind::Constant(value, BaseType::Float), BaseType::Number | BaseType::Unsigned) => {
                let number = value.to_float(self.symbols);
                let in_range = match base {
                    BaseType::Number => number.abs() < 1e9,
                    _ => (0.0..1e9).contains(&number),
                };
                in_range.then(|| format!("write a whole number, such as `{}`", number.trunc() as i64))
            }
            _ => None,
        }
    }

    /// Checks that variables in the head and in negated atoms fit their columns.
    pub(super) fn types(&mut self, head: &ast::Atom, lowered: Option<&Atom>, pending: &[Pending<'c>]) {
        if let Some(lowered) = lowered {
            for column in 0..lowered.terms.len() {
                self.fits(lowered, column, head.terms[column].place.0, true);
            }
        }
        self.types_of(pending);
    }

    fn types_of(&mut self, pending: &[Pending<'c>]) {
        for pending in pending {
            match pending {
                Pending::Atom {
                    negated: true,
                    atom,
                    syntax,
                } => {
                    for (column, term) in syntax.terms.iter().enumerate() {
                        self.fits(atom, column, term.place.0, false);
                    }
                }
                Pending::Compare { left, right, .. } => {
                    for (side, other) in [(left, right), (right, left)] {
                        if let (OperandKind::Variable(id), Some(base)) = (side.kind, self.base_of(*other)) {
                            self.variables[id.index()].compared = Some(Names::base_type(base));
                        }
                        if let (OperandKind::Constant(value, BaseType::Record), Some(id)) =
                            (side.kind, self.variable_of(*other))
                            && self.symbols.resolve(Symbol(value.0)) == Some(record::NIL)
                            && let VariableType::Type(ty) = self.type_of(id)
                        {
                            self.check_nil(ty, side.span);
                        }
                    }
                }
                Pending::Aggregate { body, .. } => self.types_of(body),
                Pending::Atom { .. } | Pending::Compute { .. } | Pending::Record { .. } => {}
            }
        }
    }

    /// Reports a variable that does not fit its column. A head requires a subtype of the column; a negated atom, and a
    /// head in the types of older programs, the same base type.
    fn fits(&mut self, atom: &Atom, column: usize, span: Span, is_head: bool) {
        let (Term::Variable(id), Some(wanted)) = (atom.terms[column], self.column(atom.predicate, column)) else {
            return;
        };
        let fits = match self.type_of(id) {
            VariableType::Unknown => true,
            VariableType::Base(base) => base == self.names.base(wanted),
            VariableType::Type(found) if is_head && !self.names.policy.legacy => self.names.is_subtype(found, wanted),
            VariableType::Type(found) => self.names.base(found) == self.names.base(wanted),
        };
        if fits {
            return;
        }
        let name = self.name(id);
        let found = match self.type_of(id) {
            VariableType::Type(found) => self.names.type_name(found).to_owned(),
            VariableType::Base(base) => base.name().to_owned(),
            VariableType::Unknown => String::new(),
        };
        let wanted_type = wanted;
        let wanted = self.names.type_name(wanted).to_owned();
        let message = format!("expected a value of type `{wanted}`, found `{name}` of type `{found}`");
        let mut fault = Diagnostic::new(codes::TYPE_MISMATCH, message).at(span, format!("must be of type `{wanted}`"));
        if let Some(origin) = self.origin(id) {
            fault = fault.also(origin, format!("`{name}` is of type `{found}` here"));
        }
        if let VariableType::Type(ty) = self.type_of(id)
            && self.names.base(ty) == self.names.base(wanted_type)
        {
            fault = fault.help(format!(
                "declare both columns with one type, or convert the value: `as({name}, {wanted})`"
            ));
            if self.names.has_old_types {
                fault = fault.help("if the program is for Soufflé's option `--legacy`, use that option here");
            }
        } else if self.names.base(wanted_type) != BaseType::Record
            && self.base_of_variable(id) != Some(BaseType::Record)
        {
            let converted = self.converted(id, self.names.base(wanted_type));
            fault = fault.help(format!(
                "convert the value: `{converted}`, or declare the columns with one type"
            ));
        }
        let group = self.group(id.index());
        self.variables[group].excused = true;
        self.fault(fault.note(format!(
            "the declaration is `{}`",
            self.names.signature_text(atom.predicate)
        )));
    }

    /// Returns the base type of an operand after inference.
    pub fn settled_base(&self, operand: Operand) -> BaseType {
        self.base_of(operand).unwrap_or(BaseType::Number)
    }
}

/// Operands that must have the same base type.
pub(super) struct Tie {
    kind: TieKind,
    operands: Vec<Operand>,
    allowed: &'static [BaseType],
    span: Span,
}

#[derive(Clone, Copy)]
pub(super) enum TieKind {
    Compare,
    Functor(&'static str),
    /// A user-defined functor, by its position.
    Call(u32),
    Probability,
}

impl Tie {
    pub(super) fn new(kind: TieKind, operands: &[Operand], allowed: &'static [BaseType], span: Span) -> Tie {
        Tie {
            kind,
            operands: operands.to_vec(),
            allowed,
            span,
        }
    }

    fn base(&self, check: &Check<'_, '_>) -> Option<BaseType> {
        match self.allowed {
            [only] => Some(*only),
            _ => self.operands.iter().find_map(|&operand| check.base_of(operand)),
        }
    }
}

/// Returns the arguments of a choice that are probabilities.
pub(super) fn probabilities(arguments: &[Operand]) -> &[Operand] {
    let count = match arguments[chance::ALTERNATIVES].kind {
        OperandKind::Constant(count, _) => count.0 as usize,
        _ => 0,
    };
    &arguments[chance::FIXED..chance::FIXED + count]
}

/// The base types whose values `=` compares.
const EQUAL: &[BaseType] = &[
    BaseType::Symbol,
    BaseType::Number,
    BaseType::Unsigned,
    BaseType::Float,
    BaseType::Record,
];

/// Returns the list of just one base type.
pub(super) fn only(base: BaseType) -> &'static [BaseType] {
    match base {
        BaseType::Symbol => &[BaseType::Symbol],
        BaseType::Number => &[BaseType::Number],
        BaseType::Unsigned => &[BaseType::Unsigned],
        BaseType::Float => &[BaseType::Float],
        BaseType::Record => &[BaseType::Record],
    }
}
