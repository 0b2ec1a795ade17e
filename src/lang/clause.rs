//! One clause at a time: looks its names up, finds the type of each variable, and makes sure that the body binds it.

use std::collections::HashMap;

use crate::diag::{Code, Diagnostic, Span};
use crate::symbol::Symbols;

use super::ast::{self, Item, TermKind};
use super::faults::Faults;
use super::names::Names;
use super::rules::{Atom, BaseType, Clause, Comparison, Literal, RelId, Term, TypeId, Value, VarId};
use super::scope::{self, Scope};

/// A longer body is refused.
const MAX_LITERALS: usize = 1024;

/// That a head depends on a predicate of its body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub from: RelId,
    pub to: RelId,
    pub negative: bool,
    /// The atom in the body; for a guard, the `.scope`.
    pub span: Span,
}

/// A clause and what the checks between clauses need besides.
#[derive(Debug)]
pub(super) struct Checked {
    pub clause: Clause,
    /// Whether no error was found in it.
    pub sound: bool,
}

/// All clauses.
#[derive(Default)]
pub(super) struct Clauses {
    pub clauses: Vec<Checked>,
    /// Clauses of the hidden predicates.
    pub hidden: Vec<Clause>,
    /// Dependencies, of faulty clauses too. Hidden predicates do not occur in them.
    pub edges: Vec<Edge>,
    /// The texts of all constants.
    pub symbols: Symbols,
    /// Whether a clause was left out because of a name that is not known.
    pub incomplete: bool,
}

pub(super) fn check(items: &[Item], names: &mut Names, faults: &mut Faults) -> Clauses {
    let mut clauses = Clauses::default();
    let mut scopes = scope::Scopes::default();
    for item in items {
        match item {
            Item::Scope(scope) => scopes.enter(scope, names, faults),
            Item::Clause(clause) => one(clause, &mut scopes, names, &mut clauses, faults),
            _ => {}
        }
    }
    clauses
}

fn one(clause: &ast::Clause, scopes: &mut scope::Scopes, names: &mut Names, out: &mut Clauses, faults: &mut Faults) {
    if clause.body.len() > MAX_LITERALS {
        let fault = Diagnostic::new(
            Code::LimitExceeded,
            format!("clause with {} literals", clause.body.len()),
        )
        .at(clause.head.place.0, "")
        .note(format!("a body has at most {MAX_LITERALS}"));
        faults.push(fault);
        out.incomplete = true;
        return;
    }
    let mut check = Check {
        names,
        faults,
        symbols: &mut out.symbols,
        numbers: HashMap::new(),
        variables: Vec::new(),
        constant_bases: Vec::new(),
        negated: Vec::new(),
        sound: true,
    };
    let head = check.head(&clause.head, clause.body.is_empty());
    let mut body = Vec::with_capacity(clause.body.len());
    for literal in &clause.body {
        body.extend(check.literal(literal));
    }
    if let Some(head) = &head {
        check.derivable(head.relation, clause);
        for literal in &body {
            if let Literal::Positive(atom) | Literal::Negative(atom) = literal {
                out.edges.push(Edge {
                    from: head.relation,
                    to: atom.relation,
                    negative: matches!(literal, Literal::Negative(_)),
                    span: atom.span,
                });
            }
        }
    }
    check.join_equals(&body);
    check.types(clause, head.as_ref(), &mut body);
    check.bindings(clause);
    let Check { variables, sound, .. } = check;
    let Some(head) = head.filter(|_| body.len() == clause.body.len()) else {
        out.incomplete = true;
        return;
    };
    let mut scoped = Scope {
        head: &head,
        body: &mut body,
        names: variables.iter().map(|variable| variable.name.to_owned()).collect(),
        types: (variables.iter()).map(|variable| variable.kind(&variables)).collect(),
        guarded: vec![false; variables.len()],
    };
    let sound = scopes.guard(&mut scoped, sound, names, out, faults) && sound;
    let Scope {
        names: variable_names,
        guarded,
        ..
    } = scoped;
    if sound && !clause.body.is_empty() {
        lone_variables(&variables, &guarded, faults);
    }
    let derived = &mut names.relations[head.relation.index()].derived;
    *derived |= !clause.body.is_empty();
    out.clauses.push(Checked {
        clause: Clause {
            head,
            body,
            variables: variable_names,
            doc: clause.doc.clone(),
            span: clause.place.0,
        },
        sound,
    });
}

/// Warns of variables that occur once. One guarded by a scope says "somebody in view" and needs no second occurrence.
fn lone_variables(variables: &[Variable<'_>], guarded: &[bool], faults: &mut Faults) {
    for (variable, guarded) in variables.iter().zip(guarded) {
        if variable.count == 1 && !guarded && !variable.name.starts_with('_') {
            let fault = Diagnostic::new(
                Code::SingletonVariable,
                format!("the variable `{}` occurs only once", variable.name),
            )
            .at(variable.first, "")
            .help(format!(
                "write `_` or `_{}` if its value does not matter",
                variable.name
            ));
            faults.push(fault);
        }
    }
}

/// A column that a variable stands in.
#[derive(Clone, Copy)]
struct Use {
    ty: TypeId,
    span: Span,
}

/// What is known of a variable. Variables that `=` makes equal form a group and share all but name and places; the group is
/// named by the variable at the end of the chain of `equal_to`.
struct Variable<'c> {
    name: &'c str,
    first: Span,
    count: usize,
    /// `None`: it stands for the group itself.
    equal_to: Option<usize>,
    /// A positive atom or a constant binds it.
    bound: bool,
    /// It occurs in something that was reported, so nothing follows from what is not known of it.
    excused: bool,
    /// The narrowest column it stands in.
    narrowest: Option<Use>,
    /// The base of a constant it equals.
    constant: Option<(BaseType, Span)>,
    /// A negated atom it stands in and the column there, to suggest what could bind it.
    negated: Option<(TypeId, Span)>,
    /// The type of what it is compared with, to the same end.
    compared: Option<TypeId>,
}

/// The type of a variable as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VariableType {
    Unknown,
    /// It only equals constants of this base and so fits every subtype of it.
    Base(BaseType),
    Type(TypeId),
}

impl Variable<'_> {
    fn kind(&self, all: &[Variable<'_>]) -> VariableType {
        let mut group = self;
        while let Some(next) = group.equal_to {
            group = &all[next];
        }
        match (group.narrowest, group.constant) {
            (Some(narrowest), _) => VariableType::Type(narrowest.ty),
            (None, Some((base, _))) => VariableType::Base(base),
            (None, None) => VariableType::Unknown,
        }
    }
}

struct Check<'a, 'c> {
    names: &'a mut Names,
    faults: &'a mut Faults,
    symbols: &'a mut Symbols,
    /// Only asked, never walked.
    numbers: HashMap<&'c str, VarId>,
    variables: Vec<Variable<'c>>,
    /// The bases of the constants of each comparison, left and right.
    constant_bases: Vec<[Option<BaseType>; 2]>,
    /// The syntax of each negated atom.
    negated: Vec<&'c ast::Atom>,
    sound: bool,
}

impl<'c> Check<'_, 'c> {
    fn fault(&mut self, fault: Diagnostic) {
        self.sound = false;
        self.faults.push(fault);
    }

    // --- names

    fn variable(&mut self, name: &'c str, span: Span) -> VarId {
        let next = VarId(u32::try_from(self.variables.len()).expect("fewer than 2^32 variables"));
        let id = *self.numbers.entry(name).or_insert(next);
        if id == next {
            self.variables.push(Variable {
                name,
                first: span,
                count: 0,
                equal_to: None,
                bound: false,
                excused: false,
                narrowest: None,
                constant: None,
                negated: None,
                compared: None,
            });
        }
        self.variables[id.index()].count += 1;
        id
    }

    fn term(&mut self, term: &'c ast::Term) -> Term {
        match &term.kind {
            TermKind::Variable(name) => Term::Variable(self.variable(name, term.place.0)),
            TermKind::Wildcard => Term::Wildcard,
            TermKind::Number(number) => Term::Constant(Value::number(*number)),
            TermKind::Text(text) => Term::Constant(Value(self.symbols.intern(text).0)),
        }
    }

    /// The atom, if its predicate is known and has as many columns; if not, its variables are excused.
    fn atom(&mut self, atom: &'c ast::Atom) -> Option<Atom> {
        let relation = self.names.predicate(&atom.predicate);
        let fits = relation.is_some_and(|relation| self.arity(relation, atom));
        let terms: Vec<Term> = atom.terms.iter().map(|term| self.term(term)).collect();
        match relation {
            Some(relation) if fits => {
                self.constants(relation, atom);
                Some(Atom {
                    relation,
                    terms,
                    span: atom.place.0,
                })
            }
            _ => {
                self.sound = false;
                self.excuse(&terms);
                None
            }
        }
    }

    fn excuse(&mut self, terms: &[Term]) {
        for term in terms {
            if let Term::Variable(id) = term {
                self.variables[id.index()].excused = true;
            }
        }
    }

    fn arity(&mut self, relation: RelId, atom: &ast::Atom) -> bool {
        let Some(columns) = &self.names.signatures[relation.index()].columns else {
            return false;
        };
        let (wanted, found) = (columns.len(), atom.terms.len());
        if wanted != found {
            let plural = |count: usize| if count == 1 { "argument" } else { "arguments" };
            let name = &atom.predicate.text;
            let message = format!("`{name}` takes {wanted} {}, not {found}", plural(wanted));
            let fault = Diagnostic::new(Code::ArityMismatch, message)
                .at(atom.place.0, format!("{found} {} here", plural(found)))
                .also(self.names.relation(relation).span, "declared here")
                .note(format!("the declaration is `{}`", self.names.signature_text(relation)));
            self.fault(fault);
        }
        wanted == found
    }

    /// Constants must be of the base type of their column.
    fn constants(&mut self, relation: RelId, atom: &ast::Atom) {
        for (column, term) in atom.terms.iter().enumerate() {
            let (found, base) = match &term.kind {
                TermKind::Number(_) => ("a number", BaseType::Number),
                TermKind::Text(_) => ("a text", BaseType::Symbol),
                _ => continue,
            };
            let Some(ty) = self.column(relation, column) else {
                continue;
            };
            if self.names.base(ty) != base {
                let wanted = self.names.type_name(ty).to_owned();
                let fault = Diagnostic::new(
                    Code::TypeMismatch,
                    format!("expected a value of type `{wanted}`, found {found}"),
                )
                .at(term.place.0, found)
                .also(self.names.relation(relation).span, "declared here")
                .note(format!("the declaration is `{}`", self.names.signature_text(relation)));
                self.fault(fault);
            }
        }
    }

    fn column(&self, relation: RelId, column: usize) -> Option<TypeId> {
        let columns = self.names.signatures[relation.index()].columns.as_ref()?;
        columns.get(column).copied().flatten()
    }

    fn head(&mut self, atom: &'c ast::Atom, fact: bool) -> Option<Atom> {
        for term in &atom.terms {
            if term.kind == TermKind::Wildcard {
                let fault = Diagnostic::new(Code::UnboundVariable, "`_` in a head")
                    .at(term.place.0, "nothing says what this is")
                    .help(if fact {
                        "write a constant"
                    } else {
                        "write a variable that the body binds"
                    });
                self.fault(fault);
            }
        }
        self.atom(atom)
    }

    fn literal(&mut self, literal: &'c ast::Literal) -> Option<Literal> {
        match literal {
            ast::Literal::Atom { negated, atom: syntax } => {
                let atom = self.atom(syntax)?;
                for (column, (term, place)) in atom.terms.iter().zip(&syntax.terms).enumerate() {
                    let Term::Variable(id) = *term else { continue };
                    let Some(ty) = self.column(atom.relation, column) else {
                        self.variables[id.index()].excused = true;
                        continue;
                    };
                    if *negated {
                        self.variables[id.index()].negated.get_or_insert((ty, place.place.0));
                    } else {
                        self.variables[id.index()].bound = true;
                        self.narrow(
                            id.index(),
                            Use {
                                ty,
                                span: place.place.0,
                            },
                        );
                    }
                }
                Some(if *negated {
                    self.negated.push(syntax);
                    Literal::Negative(atom)
                } else {
                    Literal::Positive(atom)
                })
            }
            ast::Literal::Compare { op, left, right, place } => {
                let mut bases = [None, None];
                for (side, base) in [left, right].into_iter().zip(&mut bases) {
                    match side.kind {
                        TermKind::Wildcard => {
                            let fault = Diagnostic::new(Code::UnboundVariable, "`_` in a comparison")
                                .at(side.place.0, "nothing says what this is")
                                .help("write a variable that an atom binds, or a constant");
                            self.fault(fault);
                        }
                        TermKind::Number(_) => *base = Some(BaseType::Number),
                        TermKind::Text(_) => *base = Some(BaseType::Symbol),
                        TermKind::Variable(_) => {}
                    }
                }
                self.constant_bases.push(bases);
                Some(Literal::Compare {
                    op: *op,
                    left: self.term(left),
                    right: self.term(right),
                    // Settled by `types`, when the variables' types are known.
                    base: BaseType::Symbol,
                    span: place.0,
                })
            }
        }
    }

    /// A rule for a predicate whose facts come from outside.
    fn derivable(&mut self, relation: RelId, clause: &ast::Clause) {
        if clause.body.is_empty() {
            return;
        }
        if let Some(input) = self.names.signatures[relation.index()].input {
            let name = &clause.head.predicate.text;
            let fault = Diagnostic::new(Code::DerivedInput, format!("`{name}` is input and cannot be derived"))
                .at(clause.head.place.0, "derived here")
                .also(input, "input here")
                .help("derive a predicate of another name, or remove it from `.input`");
            self.fault(fault);
        }
    }

    // --- types

    fn group(&self, mut at: usize) -> usize {
        while let Some(next) = self.variables[at].equal_to {
            at = next;
        }
        at
    }

    /// A further column that a variable, or a group, stands in.
    fn narrow(&mut self, variable: usize, further: Use) {
        let Some(known) = self.variables[variable].narrowest else {
            self.variables[variable].narrowest = Some(further);
            return;
        };
        match self.names.meet(known.ty, further.ty) {
            Some(meet) => {
                if meet != known.ty {
                    self.variables[variable].narrowest = Some(further);
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
        let name = self.variables[variable].name;
        let (first, second) = (
            self.names.type_name(known.ty).to_owned(),
            self.names.type_name(further.ty).to_owned(),
        );
        let fault = Diagnostic::new(
            Code::TypeMismatch,
            format!("`{name}` cannot be both `{first}` and `{second}`"),
        )
        .at(further.span, format!("`{second}` here"))
        .also(known.span, format!("`{first}` here"));
        self.fault(fault);
    }

    /// Makes a group of the variables that `=` makes equal.
    fn join_equals(&mut self, body: &[Literal]) {
        let comparisons = body.iter().filter_map(|literal| match *literal {
            Literal::Compare {
                op, left, right, span, ..
            } => Some((op, left, right, span)),
            _ => None,
        });
        for (index, (op, left, right, span)) in comparisons.enumerate() {
            if op != Comparison::Equal {
                continue;
            }
            match (left, right) {
                (Term::Variable(a), Term::Variable(b)) => self.join(a.index(), b.index()),
                (Term::Variable(a), Term::Constant(_)) | (Term::Constant(_), Term::Variable(a)) => {
                    let group = self.group(a.index());
                    self.variables[group].bound = true;
                    let [left, right] = self.constant_bases[index];
                    let base = left.or(right).expect("one side is a constant");
                    self.variables[group].constant.get_or_insert((base, span));
                }
                _ => {}
            }
        }
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.group(a), self.group(b));
        if a == b {
            return;
        }
        // The later joins the earlier, so chains stay as short as the text makes them.
        let (into, from) = (a.min(b), a.max(b));
        self.variables[from].equal_to = Some(into);
        let (bound, excused) = (self.variables[from].bound, self.variables[from].excused);
        let (narrowest, constant) = (self.variables[from].narrowest, self.variables[from].constant);
        let into_variable = &mut self.variables[into];
        into_variable.bound |= bound;
        into_variable.excused |= excused;
        into_variable.constant = into_variable.constant.or(constant);
        if let Some(narrowest) = narrowest {
            self.narrow(into, narrowest);
        }
    }

    fn type_of(&self, term: Term) -> VariableType {
        match term {
            Term::Variable(id) if !self.variables[self.group(id.index())].excused => {
                self.variables[id.index()].kind(&self.variables)
            }
            _ => VariableType::Unknown,
        }
    }

    fn base_of(&self, term: Term) -> Option<BaseType> {
        match self.type_of(term) {
            VariableType::Unknown => None,
            VariableType::Base(base) => Some(base),
            VariableType::Type(ty) => Some(self.names.base(ty)),
        }
    }

    /// Where the type of a variable comes from.
    fn origin(&self, term: Term) -> Option<Span> {
        let Term::Variable(id) = term else { return None };
        let group = &self.variables[self.group(id.index())];
        group
            .narrowest
            .map(|narrowest| narrowest.span)
            .or(group.constant.map(|(_, span)| span))
    }

    /// Variables in heads, negated atoms and comparisons must fit what stands there.
    fn types(&mut self, clause: &ast::Clause, head: Option<&Atom>, body: &mut [Literal]) {
        if let Some(head) = head {
            for column in 0..head.terms.len() {
                self.fits(head, column, clause.head.terms[column].place.0, true);
            }
        }
        let mut constant_bases = std::mem::take(&mut self.constant_bases).into_iter();
        let mut negated = std::mem::take(&mut self.negated).into_iter();
        for literal in body {
            match literal {
                Literal::Negative(atom) => {
                    let Some(syntax) = negated.next() else { continue };
                    for (column, term) in syntax.terms.iter().enumerate() {
                        self.fits(atom, column, term.place.0, false);
                    }
                }
                Literal::Compare {
                    left,
                    right,
                    base,
                    span,
                    ..
                } => {
                    let [left_constant, right_constant] = constant_bases.next().unwrap_or_default();
                    let left_base = left_constant.or_else(|| self.base_of(*left));
                    let right_base = right_constant.or_else(|| self.base_of(*right));
                    *base = left_base.or(right_base).unwrap_or(BaseType::Symbol);
                    for (term, other) in [(*left, right_base), (*right, left_base)] {
                        if let (Term::Variable(id), Some(base)) = (term, other) {
                            self.variables[id.index()].compared = Some(Names::base_type(base));
                        }
                    }
                    if let (Some(a), Some(b)) = (left_base, right_base)
                        && a != b
                    {
                        self.incomparable([(*left, a), (*right, b)], *span);
                    }
                }
                Literal::Positive(_) | Literal::Guard(_) => {}
            }
        }
    }

    /// In a head the variable must be of a subtype of the column; in a negated atom of the same line.
    fn fits(&mut self, atom: &Atom, column: usize, span: Span, is_head: bool) {
        let term = atom.terms[column];
        let Some(wanted) = self.column(atom.relation, column) else {
            return;
        };
        let fits = match self.type_of(term) {
            VariableType::Unknown => true,
            VariableType::Base(base) => base == self.names.base(wanted),
            VariableType::Type(found) if is_head => self.names.is_subtype(found, wanted),
            VariableType::Type(found) => self.names.meet(found, wanted).is_some(),
        };
        if fits {
            return;
        }
        let Term::Variable(id) = term else { return };
        let name = self.variables[id.index()].name;
        let found = match self.type_of(term) {
            VariableType::Type(found) => self.names.type_name(found).to_owned(),
            VariableType::Base(BaseType::Number) => "number".to_owned(),
            _ => "symbol".to_owned(),
        };
        let wanted = self.names.type_name(wanted).to_owned();
        let message = format!("expected a value of type `{wanted}`, found `{name}` of type `{found}`");
        let mut fault = Diagnostic::new(Code::TypeMismatch, message).at(span, format!("must be of type `{wanted}`"));
        if let Some(origin) = self.origin(term) {
            fault = fault.also(origin, format!("`{name}` is of type `{found}` here"));
        }
        let group = self.group(id.index());
        self.variables[group].excused = true;
        self.fault(fault.note(format!(
            "the declaration is `{}`",
            self.names.signature_text(atom.relation)
        )));
    }

    fn incomparable(&mut self, sides: [(Term, BaseType); 2], span: Span) {
        let name = |base| if base == BaseType::Number { "number" } else { "symbol" };
        let message = format!(
            "a `{}` cannot be compared with a `{}`",
            name(sides[0].1),
            name(sides[1].1)
        );
        let mut fault = Diagnostic::new(Code::TypeMismatch, message).at(span, "");
        for (term, base) in sides {
            if let (Term::Variable(id), Some(origin)) = (term, self.origin(term)) {
                let text = format!("`{}` is a `{}` here", self.variables[id.index()].name, name(base));
                fault = fault.also(origin, text);
            }
        }
        self.fault(fault);
    }

    // --- safety

    fn bindings(&mut self, clause: &ast::Clause) {
        for index in 0..self.variables.len() {
            if self.faults.full() {
                self.sound = false;
                return;
            }
            let group = self.group(index);
            if self.variables[group].bound || self.variables[group].excused || self.variables[index].excused {
                continue;
            }
            let name = self.variables[index].name;
            let mut fault = Diagnostic::new(Code::UnboundVariable, format!("no positive atom binds `{name}`"))
                .at(self.variables[index].first, "");
            if clause.body.is_empty() {
                fault = fault
                    .note("a fact has no variables; a name without quotes is one")
                    .help(format!("write the constant in quotes: `\"{name}\"`"));
            } else {
                if let Some((_, span)) = self.variables[index].negated
                    && span != self.variables[index].first
                {
                    fault = fault.also(span, "a negated atom binds nothing");
                }
                fault = match self.binder(index, clause) {
                    Some(binder) => fault.help(format!(
                        "add a positive atom that says what `{name}` is, such as `{binder}`"
                    )),
                    None => fault.help(format!("add a positive atom with `{name}` to the body")),
                };
            }
            self.fault(fault);
        }
    }

    /// An atom that could bind the variable: over a declared predicate, with few columns, one of which has its type.
    fn binder(&self, index: usize, clause: &ast::Clause) -> Option<String> {
        let head = &clause.head.predicate.text;
        let name = self.variables[index].name;
        let Variable { negated, compared, .. } = self.variables[index];
        let wanted = negated.map(|(ty, _)| ty).or(compared).or_else(|| {
            let relation = self.names.find(head)?;
            let column = clause
                .head
                .terms
                .iter()
                .position(|term| term.kind == TermKind::Variable(name.to_owned()))?;
            self.column(relation, column)
        })?;
        let mut best: Option<(usize, String)> = None;
        for (relation, signature) in self.names.relations.iter().zip(&self.names.signatures).take(1000) {
            let columns = signature.columns.as_deref().unwrap_or_default();
            let place = columns
                .iter()
                .position(|ty| ty.is_some_and(|ty| self.names.is_subtype(ty, wanted)));
            let Some(place) = place else { continue };
            // Of predicates with as many columns an input one is better: it surely has rows.
            let rank = 2 * columns.len() + usize::from(!relation.input);
            if relation.name != *head && best.as_ref().is_none_or(|(least, _)| rank < *least) {
                let terms: Vec<&str> = (0..columns.len())
                    .map(|at| if at == place { name } else { "_" })
                    .collect();
                best = Some((rank, format!("{}({})", relation.name, terms.join(", "))));
            }
        }
        best.map(|(_, text)| text)
    }
}
