//! One head with one list of literals: resolves names, flattens expressions, infers the type of each variable, and
//! checks that the body binds it.
//!
//! ```text
//! A(x + 1) :- B(x, y), y * 2 < 7.     becomes    A(a) :- B(x, y), a = x + 1, b = y * 2, b < 7.
//! ```
//!
//! The context determines the base type of a plain number (`1`) or an operator. So the constants of comparisons and
//! expressions stay open until the types of all variables are known.
// Decision: docs/decisions/language.md#d010

use std::collections::{HashMap, HashSet};

use crate::chance;
use crate::codes;
use crate::diag::{self, Diagnostic, Faults, Span};
use crate::symbol::{Symbols, WordSize};

use crate::check::InputPolicy;
use crate::check::clauses::{Clauses, Edge, EdgeKind, Guard, Known, renumber};
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, PredicateId, RecordShape, Term, TypeId, VarId};
use crate::syntax::ast;
use crate::syntax::ast::TermKind;
use crate::syntax::ast::{BaseType, Comparison, names_in, names_of};
use crate::syntax::functor::{AggregateOp, Functor, Shape};
use crate::value::{Patterns, Value, parse_in};
use aggregate::Allowed;

mod aggregate;
mod call;
mod counter;
mod range;
mod record;
mod safety;
mod types;

/// Maximum number of operators and functions in one clause.
const MAX_EXPRESSIONS: usize = 1024;

/// A checked clause before the scope adds its guards.
pub(crate) struct UnguardedClause {
    pub head: Atom,
    pub body: Vec<Literal>,
    pub variables: Vec<Known>,
    /// Whether the clause is free of errors.
    pub sound: bool,
}

/// The state for finishing the literals of a clause.
pub(crate) struct Finish<'f> {
    /// The predicate of the head.
    pub head: PredicateId,
    /// The scope in force, with the first argument of the head.
    pub scope: Option<(Guard, Option<Term>)>,
    /// The variables of the whole clause; finishing adds more.
    pub variables: &'f mut Vec<Known>,
    /// The clauses of hidden predicates.
    pub hidden: &'f mut Vec<Clause>,
}

/// Checks one head with one alternative. `None` if a predicate is unknown or has a different number of columns.
pub(crate) fn check(
    clause: &ast::Clause,
    head: &ast::Atom,
    body: &[&ast::Literal],
    guard: Option<Guard>,
    names: &mut Names,
    out: &mut Clauses,
    faults: &mut Faults,
) -> Option<UnguardedClause> {
    let mut check = Check {
        names,
        faults,
        symbols: &out.symbols,
        levels: vec![Level::default()],
        pending: vec![Vec::new()],
        variables: Vec::new(),
        bound: Vec::new(),
        shapes: HashMap::new(),
        edges: Vec::new(),
        numbered_edges: Vec::new(),
        sound: true,
        lost: false,
    };
    check.mark_direct(head, body);
    let lowered = check.head(head, clause.body.is_empty());
    if clause.body.is_empty() && (lowered.is_none() || check.variables.is_empty()) {
        // The early return matters because programs may contain many facts.
        let sound = check.sound;
        return lowered.map(|head| UnguardedClause {
            head,
            body: Vec::new(),
            variables: Vec::new(),
            sound,
        });
    }
    for literal in body {
        check.literal(literal);
    }
    let pending = check.pending.pop().unwrap_or_default();
    if check.has_too_many_expressions(head) {
        return None;
    }
    if let Some(lowered) = &lowered {
        check.derivable(lowered.predicate, clause, head);
    }
    check.join_compared(&pending);
    check.infer_records(lowered.as_ref(), &pending);
    let pending = check.equated(lowered.as_ref(), pending);
    check.infer(lowered.as_ref(), &pending);
    let pending = check.directed(pending);
    check.types(head, lowered.as_ref(), &pending);
    check.bindings(head, clause.body.is_empty(), guard, &pending);

    let mut variables: Vec<Known> = (0..check.variables.len()).map(|index| check.known(index)).collect();
    let mut hidden = Vec::new();
    let mut literals = Vec::with_capacity(pending.len());
    if let (Some(head), true, false) = (&lowered, check.sound, check.lost) {
        let ego = head.terms.first().copied();
        let mut finish = Finish {
            head: head.predicate,
            scope: guard.map(|guard| (guard, ego)),
            variables: &mut variables,
            hidden: &mut hidden,
        };
        match check.finish(&pending, &[], &mut finish, Allowed::All) {
            Some(finished) => literals = finished,
            None => {
                let fault = Diagnostic::new(codes::UNBOUND_VARIABLE, "aggregates or ranges need each other's values");
                check.fault(
                    fault
                        .at(clause.place.0, "")
                        .help("add a positive atom that binds one of the values"),
                );
            }
        }
    } else {
        // No executor evaluates a faulty clause; the lints still use its complete literals.
        literals.extend(pending.iter().filter_map(|pending| check.written(pending)));
    }
    if let (Some(lowered), true) = (&lowered, check.sound) {
        let span = clause.place.0;
        literals = check.numbered(lowered.predicate, literals, &mut variables, &mut hidden, span);
    }
    let numbered_edges = check.numbered_edges;
    let (edges, lost, sound) = (check.edges, check.lost, check.sound);
    let mut lowered = lowered?;
    let from = lowered.predicate;
    out.edges
        .extend(edges.into_iter().map(|(to, kind, span)| Edge { from, to, kind, span }));
    let numbered = numbered_edges.into_iter();
    out.edges
        .extend(numbered.map(|(from, to, kind, span)| Edge { from, to, kind, span }));
    out.hidden.append(&mut hidden);
    if lost {
        return None;
    }
    if clause.body.is_empty() {
        fold(&mut lowered, &mut literals, &out.symbols);
    }
    let variables = renumber(variables, std::iter::once(&mut lowered.terms), &mut literals);
    Some(UnguardedClause {
        head: lowered,
        body: literals,
        variables,
        sound,
    })
}

/// Evaluates the expressions of a fact, if all have a value.
fn fold(head: &mut Atom, literals: &mut Vec<Literal>, symbols: &Symbols) {
    let mut values: HashMap<VarId, Value> = HashMap::new();
    for literal in literals.iter() {
        let Literal::Compute {
            to: Term::Variable(to),
            functor,
            base,
            arguments,
            ..
        } = literal
        else {
            return;
        };
        let arguments: Option<Vec<Value>> = (arguments.iter())
            .map(|argument| match argument {
                Term::Constant(value) => Some(*value),
                Term::Variable(id) => values.get(id).copied(),
                Term::Wildcard => None,
            })
            .collect();
        let Some(value) = arguments.and_then(|arguments| functor.apply(*base, &arguments, symbols)) else {
            return;
        };
        values.insert(*to, value);
    }
    literals.clear();
    for term in &mut head.terms {
        if let Term::Variable(id) = term
            && let Some(value) = values.get(id)
        {
            *term = Term::Constant(*value);
        }
    }
}

/// The occurrence of a variable in a column.
#[derive(Clone, Copy)]
struct Use {
    ty: TypeId,
    span: Span,
}

/// A variable during inference. Compared variables form a group with one type; its representative is the variable at
/// the end of the `typed_as` chain (a union-find forest).
struct Variable<'c> {
    name: Name<'c>,
    first: Span,
    count: usize,
    /// The number of enclosing aggregates; 0 for the clause itself.
    level: usize,
    /// The next variable of the chain; `None` for the representative.
    typed_as: Option<usize>,
    /// Whether it occurs in a reported construct, so that further messages about it would mislead.
    excused: bool,
    /// The narrowest type of the columns it occurs in.
    narrowest: Option<Use>,
    /// The base type implied by constants and expressions that it equals, with the place.
    base: Option<(BaseType, Span)>,
    /// The column of a negated atom it occurs in, to suggest an atom that binds it.
    negated: Option<(TypeId, Span)>,
    /// The type of the other side of a comparison, for the same purpose.
    compared: Option<TypeId>,
    /// An occurrence in a nested aggregate.
    further_in: Option<Span>,
}

#[derive(Clone)]
enum Name<'c> {
    Written(&'c str),
    /// The expression whose value it holds.
    Expression(&'c ast::Term),
}

/// A value with its place.
#[derive(Clone, Copy)]
pub(crate) struct Operand {
    pub kind: OperandKind,
    pub span: Span,
}

impl Operand {
    fn variable(id: VarId, span: Span) -> Self {
        let kind = OperandKind::Variable(id);
        Operand { kind, span }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum OperandKind {
    Variable(VarId),
    /// A plain number such as `1`, of any numeric base type.
    Whole(i128),
    Constant(Value, BaseType),
    /// A value that the checker has reported.
    Nothing,
}

/// A literal whose constants have no type yet.
pub(crate) enum Pending<'c> {
    Atom {
        negated: bool,
        atom: Atom,
        syntax: &'c ast::Atom,
    },
    Compare {
        op: Comparison,
        left: Operand,
        right: Operand,
        span: Span,
    },
    Compute {
        to: VarId,
        functor: Functor,
        arguments: Vec<Operand>,
        /// The type of a cast.
        ty: Option<TypeId>,
        span: Span,
    },
    /// `to` is the record with these fields. [`Check::directed`] replaces it.
    Record {
        to: VarId,
        branch: Option<(&'c str, Span)>,
        fields: Vec<Operand>,
        span: Span,
    },
    Aggregate {
        to: VarId,
        op: AggregateOp,
        target: Option<Operand>,
        body: Vec<Pending<'c>>,
        /// The level of the body.
        level: usize,
        span: Span,
    },
}

/// The variables of a clause or of the body of an aggregate.
#[derive(Default)]
struct Level<'c> {
    /// Lookup only, never iterated.
    numbers: HashMap<&'c str, VarId>,
    /// The names that belong to this level, whether seen yet or not.
    direct: HashSet<&'c str>,
}

pub(crate) struct Check<'a, 'c> {
    pub names: &'a mut Names,
    faults: &'a mut Faults,
    pub symbols: &'a Symbols,
    levels: Vec<Level<'c>>,
    /// The literals read so far, by level.
    pending: Vec<Vec<Pending<'c>>>,
    variables: Vec<Variable<'c>>,
    /// Whether each variable is bound; empty until [`Check::bindings`] ends.
    bound: Vec<bool>,
    /// The shapes of records whose type nothing names. Lookup only, never iterated.
    shapes: HashMap<VarId, RecordShape>,
    edges: Vec<(PredicateId, EdgeKind, Span)>,
    /// The edges of the predicates that number solutions.
    numbered_edges: Vec<(PredicateId, PredicateId, EdgeKind, Span)>,
    sound: bool,
    /// Whether an atom was unusable.
    lost: bool,
}

impl<'c> Check<'_, 'c> {
    fn fault(&mut self, fault: Diagnostic) {
        self.sound = false;
        self.faults.push(fault);
    }

    // --- names

    fn new_variable(&mut self, name: Name<'c>, level: usize, span: Span) -> VarId {
        let id = VarId(u32::try_from(self.variables.len()).expect("fewer than 2^32 variables"));
        self.variables.push(Variable {
            name,
            first: span,
            count: 0,
            level,
            typed_as: None,
            excused: false,
            narrowest: None,
            base: None,
            negated: None,
            compared: None,
            further_in: None,
        });
        id
    }

    fn variable(&mut self, name: &'c str, span: Span) -> VarId {
        let here = self.levels.len() - 1;
        let home = (0..=here)
            .rev()
            .find(|&level| self.levels[level].direct.contains(name))
            .unwrap_or(here);
        let id = match self.levels[home].numbers.get(name) {
            Some(&id) => id,
            None => {
                let id = self.new_variable(Name::Written(name), home, span);
                self.levels[home].numbers.insert(name, id);
                id
            }
        };
        let variable = &mut self.variables[id.index()];
        variable.count += 1;
        if home < here {
            variable.further_in.get_or_insert(span);
        }
        id
    }

    /// Creates a variable for the value of an expression.
    fn value_of(&mut self, term: &'c ast::Term) -> VarId {
        let level = self.levels.len() - 1;
        let id = self.new_variable(Name::Expression(term), level, term.place.0);
        self.variables[id.index()].count = 2;
        id
    }

    /// Creates a variable for a part of the value of another variable.
    fn unnamed(&mut self, of: VarId, span: Span) -> VarId {
        let (name, level) = (
            self.variables[of.index()].name.clone(),
            self.variables[of.index()].level,
        );
        let id = self.new_variable(name, level, span);
        self.variables[id.index()].count = 2;
        self.bound.push(false);
        id
    }

    fn name(&self, id: VarId) -> String {
        match &self.variables[id.index()].name {
            Name::Written(name) => (*name).to_owned(),
            Name::Expression(term) => term.to_string(),
        }
    }

    fn is_hidden(&self, index: usize) -> bool {
        match self.variables[index].name {
            Name::Expression(_) => true,
            // The rewriting of `witness` makes such names.
            Name::Written(name) => name.starts_with('+'),
        }
    }

    fn known(&self, index: usize) -> Known {
        let id = VarId(u32::try_from(index).expect("fewer than 2^32 variables"));
        let hidden = self.is_hidden(index);
        let variable = &self.variables[index];
        Known {
            name: self.name(id),
            ty: self.type_of_variable(id),
            first: variable.first,
            count: variable.count,
            hidden,
        }
    }

    /// Returns the operand for a term. An expression becomes a literal that computes it, into `into` if given.
    fn operand(&mut self, term: &'c ast::Term, into: Option<VarId>) -> Operand {
        let span = term.place.0;
        let kind = match &term.kind {
            TermKind::Variable(name) => OperandKind::Variable(self.variable(name, span)),
            TermKind::Wildcard => {
                let fault = Diagnostic::new(codes::UNBOUND_VARIABLE, "`_` where a value is needed")
                    .at(span, "nothing binds it")
                    .help("write a variable that an atom binds, or a constant");
                self.fault(fault);
                OperandKind::Nothing
            }
            TermKind::Number(number) => OperandKind::Whole(*number),
            TermKind::Address(address) => {
                // In 32 bits, the highest addresses are negative numbers.
                let number = u32::from(*address);
                let value = match self.symbols.word_size() {
                    WordSize::Bits32 => Value(number),
                    WordSize::Bits64 => Value(self.symbols.intern_bits(number.into())),
                };
                OperandKind::Constant(value, BaseType::Number)
            }
            TermKind::Unsigned(number) => {
                let whole = Operand {
                    kind: OperandKind::Whole((*number).into()),
                    span,
                };
                OperandKind::Constant(self.value(whole, BaseType::Unsigned), BaseType::Unsigned)
            }
            TermKind::Float(text) => {
                let value = parse_in(BaseType::Float, text, self.symbols).unwrap_or_default();
                OperandKind::Constant(value, BaseType::Float)
            }
            TermKind::Symbol(text) => OperandKind::Constant(Value(self.symbols.intern(text).0), BaseType::Symbol),
            TermKind::Functor(Functor::Pack, arguments) => self.record(term, arguments, into),
            TermKind::Functor(Functor::Call, arguments) => self.call(term, arguments, into),
            TermKind::Functor(functor, arguments) => {
                if *functor == Functor::Counter {
                    self.check_counter(span);
                }
                let arguments = arguments.iter().map(|argument| self.operand(argument, None)).collect();
                let to = into.unwrap_or_else(|| self.value_of(term));
                self.push(Pending::Compute {
                    to,
                    functor: *functor,
                    arguments,
                    ty: None,
                    span,
                });
                OperandKind::Variable(to)
            }
            TermKind::Cast(inner, ty) => {
                let mut argument = self.operand(inner, None);
                let ty = self.names.type_named(ty);
                if let (TermKind::Functor(Functor::Pack, _), OperandKind::Variable(id), Some(ty)) =
                    (&inner.kind, argument.kind, ty)
                    && self.names.base(ty) == BaseType::Record
                {
                    self.narrow(id.index(), Use { ty, span });
                }
                if let (OperandKind::Whole(_), Some(base)) = (argument.kind, ty.map(|ty| self.names.base(ty)))
                    && !matches!(base, BaseType::Symbol | BaseType::Record)
                {
                    // `as(2, float)` is 2.0.
                    argument.kind = OperandKind::Constant(self.value(argument, base), base);
                }
                let to = into.unwrap_or_else(|| self.value_of(term));
                match ty {
                    Some(ty) => self.narrow(to.index(), Use { ty, span }),
                    None => self.excuse(to),
                }
                self.push(Pending::Compute {
                    to,
                    functor: Functor::Cast,
                    arguments: vec![argument],
                    ty,
                    span,
                });
                OperandKind::Variable(to)
            }
            TermKind::Aggregate(aggregate) => {
                let to = into.unwrap_or_else(|| self.value_of(term));
                self.aggregate(aggregate, to, span);
                OperandKind::Variable(to)
            }
        };
        Operand { kind, span }
    }

    fn push(&mut self, pending: Pending<'c>) {
        if let Some(list) = self.pending.last_mut() {
            list.push(pending);
        }
    }

    fn aggregate(&mut self, aggregate: &'c ast::Aggregate, to: VarId, span: Span) {
        let (mut body, mut target): (HashSet<&str>, HashSet<&str>) = (HashSet::new(), HashSet::new());
        aggregate.body.iter().for_each(|literal| {
            names_in(literal, false, &mut |name| {
                body.insert(name);
            })
        });
        aggregate.target.iter().for_each(|term| {
            names_of(term, false, &mut |name| {
                target.insert(name);
            })
        });
        // A name that occurs in target and body belongs to the aggregate. Any other known name refers to the outer
        // variable.
        let known = |name: &&&str| self.levels.iter().any(|level| level.direct.contains(**name));
        let own = |name: &&&str| (body.contains(**name) && target.contains(**name)) || !known(name);
        let direct = body.union(&target).filter(own).copied().collect();
        self.levels.push(Level {
            numbers: HashMap::new(),
            direct,
        });
        self.pending.push(Vec::new());
        if aggregate.body.is_empty() {
            self.always(true, span);
        }
        for literal in &aggregate.body {
            if let ast::Literal::Any(alternatives) = literal {
                if alternatives.is_empty() {
                    self.always(false, span);
                    continue;
                }
                let fault = Diagnostic::new(codes::UNSUPPORTED, "alternatives in an aggregate are not supported")
                    .at(span, "")
                    .help("define a predicate with these alternatives, and aggregate over that");
                self.fault(fault);
                self.lost = true;
                let mut names = Vec::new();
                names_in(literal, false, &mut |name| names.push(name));
                for name in names {
                    let id = self.variable(name, span);
                    self.excuse(id);
                }
            }
            self.literal(literal);
        }
        let target = aggregate.target.as_ref().map(|target| self.operand(target, None));
        let body = self.pending.pop().unwrap_or_default();
        let level = self.levels.len() - 1;
        self.levels.pop();
        self.push(Pending::Aggregate {
            to,
            op: aggregate.op,
            target,
            body,
            level,
            span,
        });
    }

    /// Adds `true` or `false` to the body of an aggregate.
    fn always(&mut self, holds: bool, span: Span) {
        let [left, right] = [0, i128::from(!holds)].map(|number| Operand {
            kind: OperandKind::Whole(number),
            span,
        });
        self.push(Pending::Compare {
            op: Comparison::Equal,
            left,
            right,
            span,
        });
    }

    /// Resolves an atom. If its predicate is unknown or has a different number of columns, excuses its variables.
    fn atom(&mut self, atom: &'c ast::Atom) -> Option<Atom> {
        let predicate = self.names.resolve(&atom.predicate);
        let fits = predicate.is_some_and(|predicate| self.arity(predicate, atom));
        let predicate = predicate.filter(|_| fits);
        let terms: Vec<Term> = (atom.terms.iter().enumerate())
            .map(|(column, term)| self.argument(predicate.map(|predicate| (predicate, column)), term))
            .collect();
        let Some(predicate) = predicate else {
            self.sound = false;
            self.lost = true;
            for term in &terms {
                if let Term::Variable(id) = term {
                    self.excuse(*id);
                }
            }
            return None;
        };
        // Constants of an unknown type have no value, so no lint may compare the clause.
        let columns = self.names.signatures[predicate.index()].columns.iter().flatten();
        self.sound &= columns.into_iter().all(Option::is_some);
        Some(Atom {
            predicate,
            terms,
            span: atom.place.0,
        })
    }

    /// Returns the argument of an atom. A constant takes the base type of its column.
    fn argument(&mut self, place: Option<(PredicateId, usize)>, term: &'c ast::Term) -> Term {
        if term.kind == TermKind::Wildcard {
            return Term::Wildcard;
        }
        let operand = self.operand(term, None);
        let (constant, found) = match operand.kind {
            OperandKind::Variable(id) => return Term::Variable(id),
            OperandKind::Nothing => return Term::Wildcard,
            OperandKind::Whole(_) => (None, "a number"),
            OperandKind::Constant(value, BaseType::Symbol) => (Some((value, BaseType::Symbol)), "a symbol"),
            OperandKind::Constant(value, BaseType::Record) => (Some((value, BaseType::Record)), "`nil`"),
            OperandKind::Constant(value, BaseType::Float) => (Some((value, BaseType::Float)), "a float"),
            OperandKind::Constant(value, BaseType::Number) => (Some((value, BaseType::Number)), "a number"),
            OperandKind::Constant(value, BaseType::Unsigned) => {
                (Some((value, BaseType::Unsigned)), "an unsigned number")
            }
        };
        let Some((predicate, ty)) =
            place.and_then(|(predicate, column)| Some((predicate, self.column(predicate, column)?)))
        else {
            return Term::Constant(Value(0));
        };
        let wanted = self.names.base(ty);
        match (operand.kind, constant) {
            (OperandKind::Whole(_), _) if !matches!(wanted, BaseType::Symbol | BaseType::Record) => {
                return Term::Constant(self.value(operand, wanted));
            }
            (_, Some((value, base))) if base == wanted => {
                if base == BaseType::Record {
                    self.check_nil(ty, term.place.0);
                }
                return Term::Constant(value);
            }
            _ => {}
        }
        let message = format!("expected a value of type `{}`, found {found}", self.names.type_name(ty));
        let fault = Diagnostic::new(codes::TYPE_MISMATCH, message)
            .at(term.place.0, found)
            .also(self.names.predicate(predicate).span, "declared here")
            .note(format!("the declaration is `{}`", self.names.signature_text(predicate)));
        let rewritten = self.rewritten(operand, wanted);
        self.fault(rewritten.into_iter().fold(fault, Diagnostic::help));
        Term::Constant(Value(0))
    }

    /// Returns the word of a constant of the given base type, and reports one out of range.
    fn value(&mut self, operand: Operand, base: BaseType) -> Value {
        let number = match operand.kind {
            OperandKind::Constant(value, _) => return value,
            OperandKind::Whole(number) => number,
            _ => return Value(0),
        };
        #[allow(clippy::cast_precision_loss)]
        let value = match base {
            BaseType::Unsigned => {
                (u64::try_from(number).ok()).and_then(|number| Value::of_unsigned(number, self.symbols))
            }
            BaseType::Float if self.symbols.word_size() == WordSize::Bits32 => Some(Value::float(number as f32)),
            BaseType::Float => Some(Value::of_float(number as f64, self.symbols)),
            BaseType::Number | BaseType::Symbol | BaseType::Record => {
                (i64::try_from(number).ok()).and_then(|number| Value::of_number(number, self.symbols))
            }
        };
        value.unwrap_or_else(|| {
            let long = self.symbols.word_size() == WordSize::Bits64;
            let range = match (base, long) {
                (BaseType::Unsigned, false) => format!("unsigned numbers range from 0 to {}", u32::MAX),
                (BaseType::Unsigned, true) => format!("unsigned numbers range from 0 to {}", u64::MAX),
                (_, false) => format!("numbers range from {} to {}", i32::MIN, i32::MAX),
                (_, true) => format!("numbers range from {} to {}", i64::MIN, i64::MAX),
            };
            let mut fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "number out of range")
                .at(operand.span, "")
                .note(range);
            let fits = match base {
                BaseType::Unsigned => u64::try_from(number).is_ok(),
                _ => i64::try_from(number).is_ok(),
            };
            if fits && !long {
                fault = fault.help("`check`, `query` and `repl` take numbers of 64 bits with `--word-size 64`");
            }
            self.fault(fault);
            Value(0)
        })
    }

    fn excuse(&mut self, id: VarId) {
        self.variables[id.index()].excused = true;
    }

    fn arity(&mut self, predicate: PredicateId, atom: &ast::Atom) -> bool {
        let Some(columns) = &self.names.signatures[predicate.index()].columns else {
            return false;
        };
        let (wanted, found) = (columns.len(), atom.terms.len());
        // The atoms of a subsumption are checked themselves.
        let is_pair = self.names.predicate(predicate).is_numbered();
        if wanted != found && is_pair {
            self.sound = false;
        } else if wanted != found {
            let plural = |count: usize| if count == 1 { "argument" } else { "arguments" };
            let name = &atom.predicate.text;
            let message = format!("`{name}` takes {wanted} {}, not {found}", plural(wanted));
            let fault = Diagnostic::new(codes::ARITY_MISMATCH, message)
                .at(atom.place.0, format!("{found} {} here", plural(found)))
                .also(self.names.predicate(predicate).span, "declared here")
                .note(format!("the declaration is `{}`", self.names.signature_text(predicate)));
            self.fault(fault);
        }
        wanted == found
    }

    fn column(&self, predicate: PredicateId, column: usize) -> Option<TypeId> {
        let columns = self.names.signatures[predicate.index()].columns.as_ref()?;
        columns.get(column).copied().flatten()
    }

    fn head(&mut self, atom: &'c ast::Atom, fact: bool) -> Option<Atom> {
        for term in &atom.terms {
            if term.kind == TermKind::Wildcard {
                let fault = Diagnostic::new(codes::UNBOUND_VARIABLE, "`_` in a head")
                    .at(term.place.0, "nothing binds it")
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

    fn literal(&mut self, literal: &'c ast::Literal) {
        match literal {
            ast::Literal::Atom { negated, atom: syntax } => {
                let kind = match (self.levels.len(), negated) {
                    (1, false) => EdgeKind::Needs,
                    (1, true) => EdgeKind::Negates,
                    _ => EdgeKind::Aggregates,
                };
                let Some(atom) = self.atom(syntax) else { return };
                self.edges.push((atom.predicate, kind, atom.span));
                for (column, (term, place)) in atom.terms.iter().zip(&syntax.terms).enumerate() {
                    let Term::Variable(id) = *term else { continue };
                    let Some(ty) = self.column(atom.predicate, column) else {
                        self.excuse(id);
                        continue;
                    };
                    let span = place.place.0;
                    if *negated {
                        self.variables[id.index()].negated.get_or_insert((ty, span));
                    } else {
                        self.narrow(id.index(), Use { ty, span });
                    }
                }
                self.push(Pending::Atom {
                    negated: *negated,
                    atom,
                    syntax,
                });
            }
            ast::Literal::Compare { op, left, right, place } => {
                let is_value = |term: &ast::Term| match &term.kind {
                    // `nil` is a constant.
                    TermKind::Functor(functor, arguments) => *functor != Functor::Pack || !arguments.is_empty(),
                    TermKind::Cast(..) | TermKind::Aggregate(_) => true,
                    _ => false,
                };
                let is_variable = |term: &ast::Term| matches!(term.kind, TermKind::Variable(_));
                if *op == Comparison::Equal {
                    // `_ = max x : { ... }` only requires that the maximum exists.
                    for (any, value) in [(left, right), (right, left)] {
                        if any.kind == TermKind::Wildcard && is_value(value) {
                            self.operand(value, None);
                            return;
                        }
                    }
                    for (variable, value) in [(left, right), (right, left)] {
                        if is_variable(variable) && is_value(value) {
                            if let OperandKind::Variable(into) = self.operand(variable, None).kind {
                                self.operand(value, Some(into));
                            }
                            return;
                        }
                    }
                }
                if let (Comparison::Match | Comparison::NotMatch, TermKind::Symbol(pattern)) = (op, &left.kind)
                    && let Err(reason) = Patterns::compile(pattern)
                {
                    let fault = Diagnostic::new(codes::INVALID_PATTERN, format!("not a regular expression: {reason}"));
                    let help = "a regular expression of Rust's `regex` matches the whole symbol; a backslash before a \
                                special character makes it literal, written `\\\\` in a string";
                    self.fault(fault.at(left.place.0, "").help(help));
                }
                let left = self.operand(left, None);
                let right = self.operand(right, None);
                self.push(Pending::Compare {
                    op: *op,
                    left,
                    right,
                    span: place.0,
                });
            }
            // Temporal literals are lowered to atoms before, and alternatives to several bodies.
            ast::Literal::Temporal { .. } | ast::Literal::Any(_) => {}
        }
    }

    /// Reports a rule for an `.input` predicate.
    fn derivable(&mut self, predicate: PredicateId, clause: &ast::Clause, head: &ast::Atom) {
        if clause.body.is_empty() {
            return;
        }
        if let Some(input) = self.names.signatures[predicate.index()].input {
            let name = &head.predicate.text;
            let (code, help) = match self.names.policy.inputs {
                InputPolicy::Fixed => (
                    codes::DERIVED_INPUT,
                    "derive another predicate, with one clause that copies the input",
                ),
                InputPolicy::Extensible => (
                    codes::EXTENDED_INPUT,
                    "to distinguish them, derive another predicate, with one clause that copies the input",
                ),
            };
            let fault = Diagnostic::new(code, format!("`{name}` is input and also derived"))
                .at(head.place.0, "derived here")
                .also(input, "input here")
                .help(help);
            self.faults.push(fault);
        }
    }

    /// Records the variables that occur outside of all aggregates, before the first aggregate is read.
    fn mark_direct(&mut self, head: &'c ast::Atom, body: &[&'c ast::Literal]) {
        let mut mark = |name| {
            self.levels[0].direct.insert(name);
        };
        head.terms.iter().for_each(|term| names_of(term, false, &mut mark));
        body.iter().for_each(|literal| names_in(literal, false, &mut mark));
    }

    fn has_too_many_expressions(&mut self, head: &ast::Atom) -> bool {
        let count = (0..self.variables.len()).filter(|&index| self.is_hidden(index)).count();
        if count > MAX_EXPRESSIONS {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("clause with {count} expressions"))
                .at(head.place.0, "")
                .note(format!(
                    "a clause has at most {MAX_EXPRESSIONS} operators and functions"
                ));
            self.fault(fault);
        }
        count > MAX_EXPRESSIONS
    }

    // --- the checked literals

    /// Returns the finished literal; `None` for an aggregate, see `Check::finish`.
    pub fn written(&mut self, pending: &Pending<'c>) -> Option<Literal> {
        Some(match pending {
            Pending::Atom { negated, atom, .. } if *negated => Literal::Negative(atom.clone()),
            Pending::Atom { atom, .. } => Literal::Positive(atom.clone()),
            Pending::Compare { op, left, right, span } => {
                let base = self.base_of(*left).or_else(|| self.base_of(*right));
                let number = |side: &Operand| matches!(side.kind, OperandKind::Whole(_));
                let usual = if number(left) {
                    BaseType::Number
                } else {
                    BaseType::Symbol
                };
                let base = base.unwrap_or(usual);
                Literal::Compare {
                    op: *op,
                    left: self.finished(*left, base),
                    right: self.finished(*right, base),
                    base,
                    span: *span,
                }
            }
            Pending::Compute {
                to,
                functor,
                arguments,
                span,
                ..
            } => {
                let known = arguments.iter().find_map(|&argument| self.base_of(argument));
                let base = match functor.shape() {
                    Shape::Same(_) => known.or_else(|| self.base_of_variable(*to)),
                    _ => known,
                };
                let base = base.unwrap_or(BaseType::Number);
                let bases: Vec<BaseType> = match functor.shape() {
                    Shape::Fixed(bases, _) => bases.to_vec(),
                    Shape::Choice => return Some(self.choice(*to, arguments, *span)),
                    Shape::Declared => return self.called(*to, arguments, *span),
                    Shape::Record => {
                        let base = match functor {
                            Functor::Unpack => self.base_of_variable(*to).unwrap_or(BaseType::Record),
                            _ => BaseType::Record,
                        };
                        return Some(Literal::Compute {
                            to: Term::Variable(*to),
                            functor: *functor,
                            base,
                            arguments: (arguments.iter())
                                .map(|&argument| self.finished(argument, base))
                                .collect(),
                            span: *span,
                        });
                    }
                    _ => vec![base; arguments.len()],
                };
                Literal::Compute {
                    to: Term::Variable(*to),
                    functor: *functor,
                    base,
                    arguments: (arguments.iter().zip(bases))
                        .map(|(&argument, base)| self.finished(argument, base))
                        .collect(),
                    span: *span,
                }
            }
            Pending::Aggregate { .. } | Pending::Record { .. } => return None,
        })
    }

    /// Returns the choice of an alternative, with the types of the values that it is about.
    fn choice(&mut self, to: VarId, arguments: &[Operand], span: Span) -> Literal {
        let values = chance::FIXED + types::probabilities(arguments).len();
        let is_symbol = |operand: &Operand| {
            let base = self.base_of(*operand);
            matches!(base, Some(BaseType::Symbol | BaseType::Record))
        };
        let symbols = (arguments[values..].iter().zip(0..chance::VALUES_MAX))
            .map(|(operand, at)| u32::from(is_symbol(operand)) << at)
            .fold(0, |all, bit| all | bit);
        let mut arguments: Vec<Term> = (arguments.iter().enumerate())
            .map(|(at, &argument)| {
                let is_probability = (chance::FIXED..values).contains(&at);
                let base = if is_probability {
                    BaseType::Float
                } else {
                    BaseType::Unsigned
                };
                self.finished(argument, base)
            })
            .collect();
        arguments[chance::SYMBOLS] = Term::Constant(Value(symbols));
        Literal::Compute {
            to: Term::Variable(to),
            functor: Functor::Choose,
            base: BaseType::Unsigned,
            arguments,
            span,
        }
    }

    pub fn finished(&mut self, operand: Operand, base: BaseType) -> Term {
        match operand.kind {
            OperandKind::Variable(id) => Term::Variable(id),
            OperandKind::Nothing => Term::Wildcard,
            OperandKind::Whole(_) | OperandKind::Constant(..) => Term::Constant(self.value(operand, base)),
        }
    }

    /// Returns the level of a variable; `None` for one that the checker added later.
    pub fn level(&self, id: VarId) -> Option<usize> {
        self.variables.get(id.index()).map(|variable| variable.level)
    }

    pub fn report(&mut self, fault: Diagnostic) {
        self.fault(fault);
    }

    pub fn edge(&mut self, to: PredicateId, kind: EdgeKind, span: Span) {
        self.edges.push((to, kind, span));
    }
}
