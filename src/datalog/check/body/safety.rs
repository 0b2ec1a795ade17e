//! Safety: which variables the body binds, and what could bind the others.

use crate::check::rules::{Term, VarId};
use crate::check::witness::{is_shadow, written};
use crate::codes;
use crate::diag::Diagnostic;
use crate::syntax::ast;
use crate::syntax::ast::{BaseType, Comparison, TermKind};

use crate::check::body::{Check, Name, Operand, OperandKind, Pending, Variable};
use crate::check::clauses::{Guard, reads_as_constant};

impl<'c> Check<'_, 'c> {
    pub(super) fn is_bound(&self, operand: Operand) -> bool {
        match operand.kind {
            OperandKind::Variable(id) => self.bound[id.index()],
            _ => true,
        }
    }

    /// Marks the variables of a level that a literal binds, given those bound so far. The body of an aggregate binds no
    /// outer variable.
    fn bind(&mut self, pending: &Pending<'c>, level: usize) -> bool {
        let mut binds: Vec<VarId> = Vec::new();
        let mut changed = false;
        match pending {
            Pending::Atom {
                negated: false, atom, ..
            } => {
                binds.extend(atom.terms.iter().filter_map(Term::variable));
            }
            Pending::Compare {
                op: Comparison::Equal,
                left,
                right,
                ..
            } => {
                for (from, to) in [(*left, *right), (*right, *left)] {
                    if let (true, OperandKind::Variable(id)) = (self.is_bound(from), to.kind) {
                        binds.push(id);
                    }
                }
            }
            Pending::Compute { to, arguments, .. } if arguments.iter().all(|&argument| self.is_bound(argument)) => {
                binds.push(*to);
            }
            Pending::Aggregate {
                to,
                target,
                body,
                level: inner,
                ..
            } => {
                for pending in body {
                    changed |= self.bind(pending, *inner);
                }
                let mut ready = true;
                self.each_variable(body, *target, &mut |id, check| {
                    ready &= check.variables[id.index()].level >= *inner || check.bound[id.index()];
                });
                if ready {
                    binds.push(*to);
                }
            }
            _ => {}
        }
        for id in binds {
            if self.variables[id.index()].level == level && !self.bound[id.index()] {
                self.bound[id.index()] = true;
                changed = true;
            }
        }
        changed
    }

    /// Calls `each` with every variable of the literals and of an aggregate's target.
    pub(super) fn each_variable(
        &self,
        pending: &[Pending<'c>],
        target: Option<Operand>,
        each: &mut dyn FnMut(VarId, &Self),
    ) {
        let operand = |operand: Operand, each: &mut dyn FnMut(VarId, &Self)| {
            if let OperandKind::Variable(id) = operand.kind {
                each(id, self);
            }
        };
        for pending in pending {
            match pending {
                Pending::Atom { atom, .. } => {
                    for term in &atom.terms {
                        if let Term::Variable(id) = term {
                            each(*id, self);
                        }
                    }
                }
                Pending::Compare { left, right, .. } => {
                    operand(*left, each);
                    operand(*right, each);
                }
                Pending::Compute { to, arguments, .. } => {
                    arguments.iter().for_each(|&argument| operand(argument, each));
                    each(*to, self);
                }
                Pending::Record { to, fields, .. } => {
                    fields.iter().for_each(|&field| operand(field, each));
                    each(*to, self);
                }
                Pending::Aggregate { to, target, body, .. } => {
                    each(*to, self);
                    self.each_variable(body, *target, each);
                }
            }
        }
        if let Some(target) = target {
            operand(target, each);
        }
    }

    pub(super) fn bindings(&mut self, head: &ast::Atom, is_fact: bool, guard: Option<Guard>, pending: &[Pending<'c>]) {
        self.bound = vec![false; self.variables.len()];
        self.bind_all(pending);
        // A reported construct may bind its variables.
        for index in 0..self.variables.len() {
            self.bound[index] |= self.variables[index].excused || self.variables[self.group(index)].excused;
        }
        self.bind_all(pending);
        // Report the causes first, not the values computed from them.
        let mut computed = vec![false; self.variables.len()];
        mark_computed(pending, &mut computed);
        // In `Car_2 = Y` without quotes, `Y` would be bound if `Car_2` were the constant that it looks like.
        let ids = (0..).take(self.variables.len()).map(VarId);
        let constants: Vec<bool> = ids.map(|id| reads_as_constant(&self.name(id))).collect();
        self.report_unbound(head, is_fact, guard, |index| constants[index] && !computed[index]);
        self.bind_all(pending);
        self.report_unbound(head, is_fact, guard, |index| !computed[index]);
        self.bind_all(pending);
        self.report_unbound(head, is_fact, guard, |_| true);
    }

    pub(super) fn bind_all(&mut self, pending: &[Pending<'c>]) {
        let mut changed = true;
        while std::mem::take(&mut changed) {
            for pending in pending {
                changed |= self.bind(pending, 0);
            }
        }
    }

    fn report_unbound(
        &mut self,
        head: &ast::Atom,
        is_fact: bool,
        guard: Option<Guard>,
        chosen: impl Fn(usize) -> bool,
    ) {
        let mut unbound: Vec<usize> = (0..self.variables.len())
            .filter(|&index| !self.bound[index] && chosen(index))
            .collect();
        unbound.sort_by_key(|&index| self.is_hidden(index));
        for index in unbound {
            if self.faults.full() {
                self.sound = false;
                return;
            }
            self.bound[index] = true;
            let is_renamed = matches!(self.variables[index].name, Name::Written(_)) && self.is_hidden(index);
            if self.is_hidden(index) && !(is_renamed && self.sound) {
                // Its operands include a reported variable, or it stands for one.
                self.sound = false;
                continue;
            }
            let name = self.name(VarId(u32::try_from(index).expect("fewer than 2^32 variables")));
            let name = written(&name).to_owned();
            let mut fault = Diagnostic::new(codes::UNBOUND_VARIABLE, format!("no positive atom binds `{name}`"))
                .at(self.variables[index].first, "");
            if is_renamed && self.is_of_aggregate(index) {
                fault = fault.note("in the body of an aggregate, its result is another variable");
            }
            if is_fact {
                fault = fault
                    .note("a fact has no variables; a name without quotes is a variable")
                    .help(format!("write the constant in quotes: `\"{name}\"`"))
                    .fix(
                        "write a constant in quotes",
                        [(self.variables[index].first, format!("\"{name}\""))],
                    );
            } else {
                if let Some((_, span)) = self.variables[index].negated
                    && span != self.variables[index].first
                {
                    fault = fault.also(span, "a negated atom binds nothing");
                }
                if let Some(span) = self.variables[index].further_in {
                    fault = fault.also(span, "an aggregate binds nothing outside of it");
                }
                let is_constant = reads_as_constant(&name);
                if is_constant {
                    fault = fault
                        .note("a name without quotes is a variable")
                        .help(format!(
                            "if you mean the symbol `{name}`, write it in quotes: `\"{name}\"`"
                        ))
                        .fix(
                            "write a constant in quotes",
                            [(self.variables[index].first, format!("\"{name}\""))],
                        );
                }
                let twin = self.twin(index, &name);
                if let Some(twin) = &twin {
                    fault = fault.help(format!("did you mean `{twin}`?")).fix(
                        "use the variable in the other case",
                        [(self.variables[index].first, twin.clone())],
                    );
                }
                let or = if is_constant || twin.is_some() { "or " } else { "" };
                fault = match self.binder(index, head, guard, &name) {
                    Some(binder) => fault.help(format!(
                        "{or}add a positive atom that binds `{name}`, such as `{binder}`"
                    )),
                    None => fault.help(format!("{or}add a positive atom with `{name}` to the body")),
                };
                let compared = self.variables[index].compared.map(|ty| self.names.base(ty));
                if !is_constant && compared == Some(BaseType::Symbol) && self.variables[index].negated.is_none() {
                    fault = fault.help(format!("or, if you mean the symbol, write it in quotes: `\"{name}\"`"));
                }
            }
            self.fault(fault);
        }
    }

    /// Returns whether the variable stands for one in the body of an aggregate, not for one of an inline predicate.
    fn is_of_aggregate(&self, index: usize) -> bool {
        let id = VarId(u32::try_from(index).expect("fewer than 2^32 variables"));
        self.variables[index].level > 0 || is_shadow(&self.name(id))
    }

    /// Returns the name of a bound variable that differs from `name` in case only.
    fn twin(&self, index: usize, name: &str) -> Option<String> {
        let level = self.variables[index].level;
        let is_twin = |other: &usize| {
            let Variable {
                name: written,
                level: home,
                ..
            } = &self.variables[*other];
            let is_similar = |written: &&str| *written != name && written.to_lowercase() == name.to_lowercase();
            self.bound[*other] && *home <= level && matches!(written, Name::Written(written) if is_similar(written))
        };
        let twin = (0..self.variables.len()).find(is_twin)?;
        Some(self.name(VarId(u32::try_from(twin).expect("fewer than 2^32 variables"))))
    }

    /// Suggests an atom that could bind the variable: that of the scope, which restricts nothing further, or one over a
    /// predicate with few columns, one of which has its type.
    fn binder(&self, index: usize, head: &ast::Atom, guard: Option<Guard>, name: &str) -> Option<String> {
        let Variable { negated, compared, .. } = self.variables[index];
        let wanted = negated.map(|(ty, _)| ty).or(compared).or_else(|| {
            let predicate = self.names.find(&head.predicate.text)?;
            let is_it = |term: &ast::Term| term.kind == TermKind::Variable(name.to_owned());
            self.column(predicate, head.terms.iter().position(is_it)?)
        })?;
        if let (Some(guard), Some(TermKind::Variable(ego))) = (guard, head.terms.first().map(|term| &term.kind)) {
            let scope = &self.names.predicate(guard.predicate).name;
            if *scope != head.predicate.text && self.names.is_subtype(guard.seen, wanted) {
                return Some(format!("{scope}({ego}, {name})"));
            }
        }
        let mut best: Option<(usize, String)> = None;
        for (predicate, signature) in self.names.predicates.iter().zip(&self.names.signatures).take(1000) {
            let columns = signature.columns.as_deref().unwrap_or_default();
            let place = columns
                .iter()
                .position(|ty| ty.is_some_and(|ty| self.names.is_subtype(ty, wanted)));
            let Some(place) = place else { continue };
            // Among predicates of equal arity, prefer an input one, which surely has rows.
            let rank = 2 * columns.len() + usize::from(!predicate.input);
            if predicate.name != head.predicate.text
                && !predicate.hidden
                && best.as_ref().is_none_or(|(least, _)| rank < *least)
            {
                let terms: Vec<&str> = (0..columns.len())
                    .map(|at| if at == place { name } else { "_" })
                    .collect();
                best = Some((rank, format!("{}({})", predicate.name, terms.join(", "))));
            }
        }
        best.map(|(_, text)| text)
    }
}

/// Marks the variables that literals compute.
fn mark_computed(pending: &[Pending<'_>], computed: &mut [bool]) {
    for pending in pending {
        match pending {
            Pending::Compute { to, .. } | Pending::Record { to, .. } => computed[to.index()] = true,
            Pending::Aggregate { to, body, .. } => {
                computed[to.index()] = true;
                mark_computed(body, computed);
            }
            Pending::Atom { .. } | Pending::Compare { .. } => {}
        }
    }
}
