//! Records: the types of their fields, and whether a literal makes a record or takes one apart.
//!
//! ```text
//! A(x) :- B([x, y]), y > 0.     becomes    A(x) :- B(r), x = field 0 of r, y = field 1 of r, y > 0.
//! A([x, y]) :- B(x, y).         becomes    A(r) :- B(x, y), r = [x, y].
//! ```
//!
//! Both forms mean the same: `r` is the record with these fields. So the choice only decides which side binds the other
//! one, and the literals may be evaluated in any order. A record is taken apart if other literals bind it, since that
//! makes no record that is not there.
// Decision: docs/decisions/language.md#d082

use crate::check::body::{Check, Name, Operand, OperandKind, Pending, Use};
use crate::check::clauses::VariableType;
use crate::check::names::Names;
use crate::check::rules::{Atom, RecordShape, TypeId, VarId};
use crate::codes;
use crate::diag::{Diagnostic, Span, counted};
use crate::record;
use crate::syntax::ast;
use crate::syntax::ast::{BaseType, Comparison, TermKind};
use crate::syntax::functor::Functor;
use crate::value::Value;
use std::collections::HashMap;

impl<'c> Check<'_, 'c> {
    /// Returns the operand for a record, whose first argument is its branch. Without arguments it is `nil`.
    pub(super) fn record(
        &mut self,
        term: &'c ast::Term,
        arguments: &'c [ast::Term],
        into: Option<VarId>,
    ) -> OperandKind {
        let Some((branch, fields)) = arguments.split_first() else {
            return OperandKind::Constant(Value(self.symbols.intern(record::NIL).0), BaseType::Record);
        };
        let fields = fields
            .iter()
            .map(|field| match field.kind {
                // Any value: a variable of its own.
                TermKind::Wildcard => Operand::variable(self.value_of(field), field.place.0),
                _ => self.operand(field, None),
            })
            .collect();
        let to = into.unwrap_or_else(|| self.value_of(term));
        let branch = match &branch.kind {
            TermKind::Symbol(name) if !name.is_empty() => Some((name.as_str(), branch.place.0)),
            _ => None,
        };
        if let Some((name, span)) = branch {
            match self.names.branch(name) {
                Ok(Some(ty)) => self.narrow(to.index(), Use { ty, span: term.place.0 }),
                Ok(None) => {
                    self.sound = false;
                    self.excuse(to);
                }
                Err(near) => {
                    let message = format!("no type has a branch `{name}`");
                    let fault = Diagnostic::new(codes::UNKNOWN_TYPE, message).at(span, "");
                    let fault = match near {
                        Some(near) => fault.did_you_mean(&near, &[span]),
                        None => fault.help(format!("declare a type with it: `.type T = {name} {{x: number}}`")),
                    };
                    self.sound = false;
                    if self.names.complete() {
                        self.fault(fault);
                    }
                    self.excuse(to);
                }
            }
        }
        self.push(Pending::Record {
            to,
            branch,
            fields,
            span: term.place.0,
        });
        OperandKind::Variable(to)
    }

    /// Gives the fields of records the types that the types of the records imply, and the other way round.
    pub(super) fn infer_records(&mut self, head: Option<&Atom>, pending: &[Pending<'c>]) {
        let mut records = Vec::new();
        records_in(pending, &mut records);
        if records.is_empty() {
            return;
        }
        let atoms = head
            .into_iter()
            .chain(pending.iter().filter_map(|pending| match pending {
                Pending::Atom {
                    negated: true, atom, ..
                } => Some(atom),
                _ => None,
            }));
        // If nothing else determines the type of a record, its uses in the head and in negated atoms do.
        let uses: Vec<(VarId, Option<TypeId>)> = atoms
            .flat_map(|atom| {
                let columns = atom.terms.iter().enumerate();
                columns.filter_map(|(column, term)| Some((term.variable()?, self.column(atom.predicate, column))))
            })
            .collect();
        // The type of the column has been reported.
        for (id, _) in uses.iter().filter(|(_, ty)| ty.is_none()) {
            let group = self.group(id.index());
            self.variables[group].excused = true;
            self.excuse(*id);
        }
        let hints: Vec<(VarId, TypeId)> = (uses.into_iter())
            .filter_map(|(id, ty)| Some((id, ty?)))
            .chain(pending.iter().flat_map(|pending| self.arguments_of(pending)))
            .filter(|(_, ty)| self.names.base(*ty) == BaseType::Record)
            .collect();
        self.spread_fields(&mut records);
        for (id, ty) in hints {
            let group = self.group(id.index());
            if self.variables[group].narrowest.is_none() && self.variables[group].base.is_none() {
                let span = self.variables[id.index()].first;
                self.narrow(group, Use { ty, span });
            }
        }
        self.spread_fields(&mut records);
    }

    /// Types the fields of records with a known type, and removes these records from the list.
    fn spread_fields(&mut self, records: &mut Vec<(VarId, &[Operand], Option<&str>)>) {
        let mut changed = true;
        while std::mem::take(&mut changed) {
            let mut rest = Vec::new();
            for (to, fields, branch) in std::mem::take(records) {
                let VariableType::Type(ty) = self.type_of_variable(to) else {
                    rest.push((to, fields, branch));
                    continue;
                };
                changed = true;
                let Some(shape) = shape(self.names, ty, branch).cloned() else {
                    continue;
                };
                for (field, (_, ty)) in fields.iter().zip(shape.fields) {
                    if let OperandKind::Variable(id) = field.kind {
                        let (group, span) = (self.group(id.index()), field.span);
                        let known = self.variables[group].narrowest;
                        if known.is_none_or(|known| self.names.meet(known.ty, ty).is_none()) {
                            self.narrow(group, Use { ty, span });
                        }
                    }
                }
            }
            *records = rest;
        }
    }

    /// Replaces records of unknown type that are equal by equations of their fields.
    ///
    /// ```text
    /// r = [x, y], s = r, s = [v, w]    becomes    x = v, y = w
    /// ```
    pub(super) fn equated(&mut self, head: Option<&Atom>, pending: Vec<Pending<'c>>) -> Vec<Pending<'c>> {
        let mut pending = pending;
        while let Some((equal, kept)) = self.untyped(head, &pending) {
            let mut first: Option<Vec<Operand>> = None;
            pending = (pending.into_iter().enumerate())
                .filter_map(|(at, literal)| match literal {
                    Pending::Record { fields, .. } if kept.contains(&at) => {
                        let Some(first) = &mut first else {
                            first = Some(fields);
                            return None;
                        };
                        let mut equations = Vec::new();
                        for (left, right) in first.iter_mut().zip(fields) {
                            match (self.is_any(*left), self.is_any(right)) {
                                (true, _) => *left = right,
                                (false, true) => {}
                                (false, false) => equations.push(Pending::Compare {
                                    op: Comparison::Equal,
                                    left: *left,
                                    right,
                                    span: right.span,
                                }),
                            }
                        }
                        Some(equations)
                    }
                    _ if kept.contains(&at) => None,
                    other => Some(vec![other]),
                })
                .flatten()
                .collect();
            for id in equal {
                self.excuse(id);
            }
            self.join_compared(&pending);
            self.infer_records(head, &pending);
        }
        pending
    }

    /// Returns whether a field is `_`.
    fn is_any(&self, field: Operand) -> bool {
        match field.kind {
            OperandKind::Variable(id) => {
                let name = &self.variables[id.index()].name;
                matches!(name, Name::Expression(term) if term.kind == TermKind::Wildcard)
            }
            _ => false,
        }
    }

    /// Finds variables of unknown type that occur only in equations with each other and with two or more records of as
    /// many fields. Returns them and the positions of these literals.
    fn untyped(&self, head: Option<&Atom>, pending: &[Pending<'c>]) -> Option<(Vec<VarId>, Vec<usize>)> {
        for (start, literal) in pending.iter().enumerate() {
            let Pending::Record {
                to,
                fields: first,
                branch: None,
                ..
            } = literal
            else {
                continue;
            };
            if self.type_of_variable(*to) != VariableType::Unknown {
                continue;
            }
            let mut equal = vec![*to];
            let mut next = 0;
            while let Some(&id) = equal.get(next) {
                next += 1;
                for literal in pending {
                    if let Pending::Compare {
                        op: Comparison::Equal,
                        left,
                        right,
                        ..
                    } = literal
                        && let (OperandKind::Variable(a), OperandKind::Variable(b)) = (left.kind, right.kind)
                        && (a == id || b == id)
                    {
                        let other = if a == id { b } else { a };
                        if !equal.contains(&other) {
                            equal.push(other);
                        }
                    }
                }
            }
            let is_equal = |operand: &Operand| matches!(operand.kind, OperandKind::Variable(id) if equal.contains(&id));
            let mut literals = Vec::new();
            let mut records = 0;
            let mut elsewhere = head.is_some_and(|head| {
                let mut variables = head.terms.iter().filter_map(|term| term.variable());
                variables.any(|id| equal.contains(&id))
            });
            for (at, literal) in pending.iter().enumerate() {
                match literal {
                    Pending::Record {
                        to,
                        fields,
                        branch: None,
                        ..
                    } if equal.contains(to) => {
                        elsewhere |= fields.len() != first.len() || fields.iter().any(is_equal);
                        records += 1;
                        literals.push(at);
                    }
                    Pending::Compare {
                        op: Comparison::Equal,
                        left,
                        right,
                        ..
                    } if is_equal(left) && is_equal(right) => {
                        literals.push(at);
                    }
                    other => self.each_variable(std::slice::from_ref(other), None, &mut |id, _| {
                        elsewhere |= equal.contains(&id);
                    }),
                }
            }
            if records > 1 && !elsewhere {
                debug_assert!(literals.contains(&start));
                return Some((equal, literals));
            }
        }
        None
    }

    /// Replaces records by literals that make them or take them apart, and reports those that do not fit their types.
    pub(super) fn directed(&mut self, pending: Vec<Pending<'c>>) -> Vec<Pending<'c>> {
        let mut records = Vec::new();
        records_in(&pending, &mut records);
        if records.is_empty() {
            return pending;
        }
        let mut pending = self.shared(pending);
        self.bound = vec![false; self.variables.len()];
        // Records that literals bind are taken apart first, then one is made, which may bind others.
        loop {
            self.bind_all(&pending);
            let mut changed = false;
            pending = self.replaced(pending, false, &mut changed);
            if !changed {
                pending = self.replaced(pending, true, &mut changed);
            }
            if !changed && !self.name_shapes(&pending) {
                break;
            }
        }
        let certain = self.sound;
        self.report_records(&pending, certain);
        pending
    }

    /// Equates each record with an earlier one of the same type and fields, so that joins compare records instead of
    /// fields.
    ///
    /// ```text
    /// A([x, y]), B([x, y])    becomes    A(r), r = [x, y], B(s), s = r
    /// ```
    fn shared(&self, pending: Vec<Pending<'c>>) -> Vec<Pending<'c>> {
        let mut records: Vec<(VarId, Option<&str>, Vec<OperandKind>)> = Vec::new();
        let mut replaced: HashMap<VarId, VarId> = HashMap::new();
        let mut all = Vec::with_capacity(pending.len());
        for mut literal in pending {
            match &mut literal {
                Pending::Aggregate { body, .. } => *body = self.shared(std::mem::take(body)),
                Pending::Record {
                    to,
                    branch,
                    fields,
                    span,
                } => {
                    let (to, span, branch) = (*to, *span, branch.map(|(name, _)| name));
                    // The records in fields come before those with the fields.
                    let same = |field: &Operand| match field.kind {
                        OperandKind::Variable(id) => OperandKind::Variable(*replaced.get(&id).unwrap_or(&id)),
                        kind => kind,
                    };
                    let kinds: Vec<OperandKind> = fields.iter().map(same).collect();
                    let ty = self.type_of_variable(to);
                    let equal = records.iter().find(|(other, named, fields)| {
                        (*named, fields) == (branch, &kinds) && self.type_of_variable(*other) == ty
                    });
                    match equal {
                        Some(&(other, ..)) if self.has_fields(ty, branch, fields.len()) => {
                            replaced.insert(to, other);
                            literal = Pending::Compare {
                                op: Comparison::Equal,
                                left: Operand::variable(to, span),
                                right: Operand::variable(other, span),
                                span,
                            };
                        }
                        _ => records.push((to, branch, kinds)),
                    }
                }
                _ => {}
            }
            all.push(literal);
        }
        all
    }

    /// Returns whether the records of a type with this branch have this number of fields.
    fn has_fields(&self, ty: VariableType, branch: Option<&str>, count: usize) -> bool {
        match ty {
            VariableType::Type(ty) => shape(self.names, ty, branch).is_some_and(|shape| shape.fields.len() == count),
            _ => false,
        }
    }

    /// Gives a record of unknown type the shape that its fields imply, since that is all it needs. Returns whether there
    /// is one.
    fn name_shapes(&mut self, pending: &[Pending<'c>]) -> bool {
        let mut records = Vec::new();
        records_in(pending, &mut records);
        let untyped = records.into_iter().find_map(|(to, fields, branch)| {
            let group = &self.variables[self.group(to.index())];
            let is_unknown = group.narrowest.is_none() && !group.excused && branch.is_none();
            if !is_unknown
                || self.shapes.contains_key(&to)
                || !matches!(self.base_of_variable(to), None | Some(BaseType::Record))
            {
                return None;
            }
            let field = |field: &Operand| match field.kind {
                // No context asks for another type.
                OperandKind::Whole(_) => Some(BaseType::Number),
                _ => self.base_of(*field),
            };
            let bases: Option<Vec<BaseType>> = fields.iter().map(field).collect();
            Some((to, bases?))
        });
        let Some((to, bases)) = untyped else { return false };
        let fields = (1..)
            .zip(bases)
            .map(|(at, base)| (format!("x{at}"), Names::base_type(base)));
        let fields = fields.collect();
        self.shapes.insert(to, RecordShape { branch: None, fields });
        true
    }

    /// Replaces the records that are bound or, with `make`, the first one whose fields are bound.
    fn replaced(&mut self, pending: Vec<Pending<'c>>, make: bool, changed: &mut bool) -> Vec<Pending<'c>> {
        let mut all = Vec::with_capacity(pending.len());
        for mut pending in pending {
            match pending {
                Pending::Aggregate { ref mut body, .. } => {
                    *body = self.replaced(std::mem::take(body), make, changed);
                    all.push(pending);
                }
                Pending::Record {
                    to,
                    branch,
                    ref fields,
                    span,
                } => {
                    let is_bound = match make {
                        false => self.is_bound(Operand::variable(to, span)),
                        true => !*changed && fields.iter().all(|field| self.is_bound(*field)),
                    };
                    let known = is_bound.then(|| self.fitting(to, branch, fields)).flatten();
                    match known {
                        Some((shape, words)) => {
                            *changed = true;
                            self.replacement((to, span), &shape, words, make, &mut all);
                        }
                        None => all.push(pending),
                    }
                }
                other => all.push(other),
            }
        }
        all
    }

    /// Adds the literals for a record: one that makes it, or one for each field.
    fn replacement(
        &mut self,
        (to, span): (VarId, Span),
        shape: &RecordShape,
        fields: Vec<Operand>,
        make: bool,
        all: &mut Vec<Pending<'c>>,
    ) {
        let kinds: Vec<u8> = shape.fields.iter().map(|(_, ty)| self.names.base(*ty).kind()).collect();
        let text = record::shape(shape.branch.as_deref(), &kinds);
        let shape_word = Value(self.symbols.intern(&text).0);
        let constant = |value: Value, base: BaseType| Operand {
            kind: OperandKind::Constant(value, base),
            span,
        };
        let shape_operand = constant(shape_word, BaseType::Symbol);
        let compute = |to, functor, arguments| Pending::Compute {
            to,
            functor,
            arguments,
            ty: None,
            span,
        };
        if make {
            let arguments = std::iter::once(shape_operand).chain(fields).collect();
            all.push(compute(to, Functor::Pack, arguments));
        } else if fields.is_empty() {
            let word = self.symbols.intern(&record::encoded(shape_word.0, []));
            all.push(Pending::Compare {
                op: Comparison::Equal,
                left: Operand::variable(to, span),
                right: constant(Value(word.0), BaseType::Record),
                span,
            });
        } else {
            for ((field, (_, ty)), at) in fields.into_iter().zip(&shape.fields).zip(0..) {
                let position = constant(Value(at), BaseType::Unsigned);
                let arguments = vec![shape_operand, position, Operand::variable(to, span)];
                let value = match field.kind {
                    OperandKind::Variable(id) => {
                        let group = self.group(id.index());
                        self.narrow(
                            group,
                            Use {
                                ty: *ty,
                                span: field.span,
                            },
                        );
                        id
                    }
                    _ => {
                        let id = self.unnamed(to, span);
                        self.narrow(
                            id.index(),
                            Use {
                                ty: *ty,
                                span: field.span,
                            },
                        );
                        all.push(Pending::Compare {
                            op: Comparison::Equal,
                            left: Operand::variable(id, field.span),
                            right: field,
                            span: field.span,
                        });
                        id
                    }
                };
                all.push(compute(value, Functor::Unpack, arguments));
            }
        }
        // The literal binds what it computes, as `bind_all` will find.
    }

    /// Returns the shape of a record and its fields with typed constants; `None` after a report, and if the type of the
    /// record is unknown.
    fn fitting(
        &mut self,
        to: VarId,
        branch: Option<(&str, Span)>,
        fields: &[Operand],
    ) -> Option<(RecordShape, Vec<Operand>)> {
        let shape = match self.type_of_variable(to) {
            VariableType::Type(ty) => shape(self.names, ty, branch.map(|(name, _)| name)).cloned()?,
            _ => self.shapes.get(&to).cloned()?,
        };
        if shape.fields.len() != fields.len() {
            return None;
        }
        let mut typed = Vec::with_capacity(fields.len());
        for (field, (name, ty)) in fields.iter().zip(&shape.fields) {
            let wanted = self.names.base(*ty);
            let mut field = *field;
            let found = match field.kind {
                OperandKind::Whole(_) if matches!(wanted, BaseType::Symbol | BaseType::Record) => {
                    Some(BaseType::Number)
                }
                OperandKind::Whole(_) => {
                    field.kind = OperandKind::Constant(self.value(field, wanted), wanted);
                    None
                }
                OperandKind::Constant(..) => self.base_of(field).filter(|base| *base != wanted),
                OperandKind::Variable(_) => self.base_of(field).filter(|base| *base != wanted),
                OperandKind::Nothing => None,
            };
            if let Some(found) = found {
                let wanted_name = self.names.type_name(*ty).to_owned();
                let message = format!("the field `{name}` has type `{wanted_name}`, not `{}`", found.name());
                let fault = Diagnostic::new(codes::TYPE_MISMATCH, message)
                    .at(field.span, format!("must be of type `{wanted_name}`"));
                let rewritten = self.rewritten(field, wanted);
                self.fault(rewritten.into_iter().fold(fault, Diagnostic::help));
                field.kind = OperandKind::Nothing;
            }
            if let OperandKind::Constant(_, BaseType::Record) = field.kind {
                self.check_nil(*ty, field.span);
            }
            typed.push(field);
        }
        Some((shape, typed))
    }

    /// Reports `nil` as a value of an algebraic data type.
    pub(super) fn check_nil(&mut self, ty: TypeId, span: Span) {
        let shapes = self.names.shapes(ty);
        if shapes.iter().all(|shape| shape.branch.is_none()) {
            return;
        }
        let branches: Vec<String> = shapes.iter().map(written).collect();
        let message = format!(
            "`nil` is no value of `{}`, which has branches",
            self.names.type_name(ty)
        );
        let fault = Diagnostic::new(codes::TYPE_MISMATCH, message).at(span, "");
        self.fault(fault.help(format!("write one of its branches: {}", branches.join(", "))));
    }

    /// Reports the records whose type has no such shape or, if it is `certain` that no earlier fault is the cause, is
    /// unknown.
    fn report_records(&mut self, pending: &[Pending<'c>], certain: bool) {
        for pending in pending {
            match pending {
                Pending::Aggregate { body, .. } => self.report_records(body, certain),
                Pending::Record {
                    to,
                    branch,
                    fields,
                    span,
                } => {
                    let is_unknown = !matches!(self.type_of_variable(*to), VariableType::Type(_));
                    if self.variables[self.group(to.index())].excused || (is_unknown && !certain) {
                        self.excuse(*to);
                        self.excuse_fields(fields);
                        continue;
                    }
                    self.report_record(*to, *branch, fields, *span);
                }
                _ => {}
            }
        }
    }

    fn report_record(&mut self, to: VarId, branch: Option<(&str, Span)>, fields: &[Operand], span: Span) {
        let found = self.type_of_variable(to);
        let ty = match found {
            VariableType::Type(ty) => ty,
            VariableType::Base(base) if base != BaseType::Record => {
                // `check_tie` has reported it.
                self.excuse_fields(fields);
                return;
            }
            _ => {
                let fault = Diagnostic::new(codes::TYPE_MISMATCH, "a record of unknown type").at(span, "");
                self.fault(fault.help("use it in a column with a record type, or name its type: `as([x, y], Pair)`"));
                self.excuse(to);
                self.excuse_fields(fields);
                return;
            }
        };
        let name = self.names.type_name(ty).to_owned();
        let shapes = self.names.shapes(ty);
        let branch = branch.map(|(branch, _)| branch);
        let fault = match (shape(self.names, ty, branch), branch) {
            (Some(shape), _) if shape.fields.len() != fields.len() => {
                let (wanted, found) = (counted(shape.fields.len(), "field"), fields.len());
                let what = branch.map_or_else(|| format!("a record of type `{name}`"), |branch| format!("`${branch}`"));
                let message = format!("{what} has {wanted}, not {found}");
                let declared = match branch {
                    Some(_) => format!("the branch is {}", written(shape)),
                    None => format!("the type is `.type {name} = {}`", self.shape_text(shape)),
                };
                Some(
                    Diagnostic::new(codes::ARITY_MISMATCH, message)
                        .at(span, "")
                        .note(declared),
                )
            }
            (None, None) if !shapes.is_empty() => {
                let branches: Vec<String> = shapes.iter().map(written).collect();
                let message = format!("a record without a branch, but `{name}` has branches");
                let fault = Diagnostic::new(codes::TYPE_MISMATCH, message).at(span, "");
                Some(fault.help(format!("write one of them: {}", branches.join(", "))))
            }
            (None, None) => {
                let message = format!("expected a value of type `{name}`, found a record");
                Some(Diagnostic::new(codes::TYPE_MISMATCH, message).at(span, ""))
            }
            // It is neither bound nor made. The check for safety reports variables, but not `_`.
            _ => fields.iter().find(|field| self.is_any(**field)).map(|field| {
                Diagnostic::new(codes::UNBOUND_VARIABLE, "`_` in a record that is made here")
                    .at(field.span, "nothing binds it")
                    .help("write a variable that an atom binds, or a constant")
            }),
        };
        if let Some(fault) = fault {
            let origin = self.origin(to).filter(|origin| *origin != span);
            let fault = match origin {
                Some(origin) => fault.also(origin, "its type comes from here"),
                None => fault,
            };
            self.fault(fault);
            self.excuse(to);
            self.excuse_fields(fields);
        }
    }

    fn excuse_fields(&mut self, fields: &[Operand]) {
        for field in fields {
            if let OperandKind::Variable(id) = field.kind {
                self.excuse(id);
            }
        }
        self.sound = false;
    }

    /// `[x: number, y: symbol]`
    fn shape_text(&self, shape: &RecordShape) -> String {
        let fields: Vec<String> = (shape.fields.iter())
            .map(|(name, ty)| format!("{name}: {}", self.names.type_name(*ty)))
            .collect();
        format!("[{}]", fields.join(", "))
    }
}

/// `$Circle(r)`
fn written(shape: &RecordShape) -> String {
    let fields: Vec<&str> = shape.fields.iter().map(|(name, _)| name.as_str()).collect();
    let branch = shape.branch.as_deref().unwrap_or_default();
    match fields.is_empty() {
        true => format!("`${branch}`"),
        false => format!("`${branch}({})`", fields.join(", ")),
    }
}

/// Returns the shape of the records of a type with this branch.
fn shape<'n>(names: &'n Names, ty: TypeId, branch: Option<&str>) -> Option<&'n RecordShape> {
    names.shapes(ty).iter().find(|shape| shape.branch.as_deref() == branch)
}

/// Collects the records in literals and in the aggregates among them: the variable, the fields, and the branch.
fn records_in<'p, 'c>(pending: &'p [Pending<'c>], found: &mut Vec<(VarId, &'p [Operand], Option<&'c str>)>) {
    for pending in pending {
        match pending {
            Pending::Record { to, fields, branch, .. } => found.push((*to, fields, branch.map(|(name, _)| name))),
            Pending::Aggregate { body, .. } => records_in(body, found),
            _ => {}
        }
    }
}
