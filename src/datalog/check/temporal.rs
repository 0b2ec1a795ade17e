//! Temporal operators: replaces them by atoms over hidden predicates, before name resolution.
//!
//! ```text
//! .scope Sees
//! Stop(X) :- IsCar(X), once[0,5] IsBus(Y).     becomes   Stop(X) :- IsCar(X), once[0,5] IsBus(X, Y).
//!                                              with      now IsBus(X, Y) :- IsBus(Y).
//! .scope
//! once[0,5] IsBus(X, Y) :- now IsBus(X, Y).
//! once[0,5] IsBus(X, Y) :- once[1,5] IsBus(X, Y).
//! ```
//!
//! The names with spaces are hidden predicates. Nothing derives `once[1,5] IsBus`: its rows are the memory of earlier
//! ticks, which [`Past`] describes. All windows of a `Past` begin at least one tick ago, so no predicate depends on its
//! own present through it. The scope guards the clause of `now IsBus`: the view of each tick counts in that tick.

use std::collections::{HashMap, HashSet};

use indexmap::IndexMap;

use crate::codes;
use crate::diag::{Diagnostic, Faults};

use crate::check::names::Names;
use crate::check::rules::{Past, PastOperator, Predicate};
use crate::syntax::ast::{
    Aggregate, Atom, BaseType, Clause, ColumnDecl, Decl, Item, Literal, Name, Operator, Place, Scope, Temporal, Term,
    TermKind, TypeDefinition,
};
use crate::syntax::printer::write_operator;

/// Items without temporal literals, and the memory that they read.
pub(crate) struct Lowered {
    pub items: Vec<Item>,
    pasts: Vec<NamedPast>,
    /// The names of all hidden predicates.
    hidden: HashSet<String>,
}

/// A [`Past`] by names.
struct NamedPast {
    predicate: String,
    operator: Operator,
    operand: String,
    held: Option<(String, Vec<usize>)>,
    first: u32,
    last: Option<u32>,
}

impl NamedPast {
    /// Returns whether both remember the same.
    fn remembers_as(&self, other: &NamedPast) -> bool {
        let what = |past: &NamedPast| {
            (
                past.operator,
                past.operand.clone(),
                past.held.clone(),
                past.first,
                past.last,
            )
        };
        what(self) == what(other)
    }
}

/// Returns whether a literal has a temporal operator.
pub(crate) fn is_temporal(literal: &Literal) -> bool {
    fn in_term(term: &Term) -> bool {
        match &term.kind {
            TermKind::Functor(_, arguments) => arguments.iter().any(in_term),
            TermKind::Cast(inner, _) => in_term(inner),
            TermKind::Aggregate(aggregate) => aggregate.body.iter().any(is_temporal),
            _ => false,
        }
    }
    match literal {
        Literal::Temporal { .. } => true,
        Literal::Atom { atom, .. } => atom.terms.iter().any(in_term),
        Literal::Compare { left, right, .. } => in_term(left) || in_term(right),
        Literal::Any(alternatives) => alternatives.iter().flatten().any(is_temporal),
    }
}

/// Returns whether an item has a temporal operator.
pub(crate) fn in_item(item: &Item) -> bool {
    matches!(item, Item::Clause(clause) if clause.body.iter().any(is_temporal)
        || clause.heads.iter().any(|head| is_temporal(&Literal::Atom { negated: false, atom: head.clone() })))
}

/// Replaces temporal operators in all items; `None` if there are none.
pub(crate) fn lower(items: &[Item], faults: &mut Faults) -> Option<Lowered> {
    if !items.iter().any(in_item) {
        return None;
    }
    let mut lowering = Lowering {
        columns: HashMap::new(),
        derived: HashSet::new(),
        parents: HashMap::new(),
        scope: None,
        ego: None,
        operands: IndexMap::new(),
        literals: IndexMap::new(),
        names: HashSet::new(),
        decls: Vec::new(),
        scoped: Vec::new(),
        clauses: Vec::new(),
        pasts: Vec::new(),
        faults,
    };
    for item in items {
        match item {
            Item::Decl(Decl { names, columns, .. }) => {
                for name in names {
                    lowering.columns.insert(&name.text, columns.as_deref());
                }
            }
            Item::Type(decl) => {
                let parents = match &decl.definition {
                    TypeDefinition::Subtype(parent) | TypeDefinition::Alias(parent) => std::slice::from_ref(parent),
                    TypeDefinition::Union(members) => members,
                    TypeDefinition::Record(_) | TypeDefinition::Branches(_) | TypeDefinition::Faulty => &[],
                };
                lowering.parents.insert(&decl.name.text, parents);
            }
            Item::Clause(clause) if !clause.body.is_empty() => {
                let heads = clause.heads.iter().map(|head| head.predicate.text.as_str());
                lowering.derived.extend(heads);
            }
            _ => {}
        }
    }
    let mut out = Vec::with_capacity(items.len());
    for item in items {
        match item {
            Item::Clause(clause) if in_item(item) => {
                // In a scope each head has its own ego.
                let split = if lowering.scope.is_some() {
                    1
                } else {
                    clause.heads.len().max(1)
                };
                for heads in clause.heads.chunks(split) {
                    out.push(Item::Clause(lowering.clause(clause, heads)));
                }
            }
            _ => {
                if let Item::Scope(Scope { predicate, .. }) = item {
                    lowering.scope = predicate.as_ref();
                }
                out.push(item.clone());
            }
        }
    }
    let Lowering {
        names,
        decls,
        scoped,
        clauses,
        pasts,
        ..
    } = lowering;
    out.extend(decls.into_iter().map(Item::Decl));
    for (scope, clause) in scoped {
        let place = clause.place;
        out.push(Item::Scope(Scope {
            predicate: scope,
            place,
        }));
        out.push(Item::Clause(clause));
        out.push(Item::Scope(Scope { predicate: None, place }));
    }
    out.extend(clauses.into_iter().map(Item::Clause));
    Some(Lowered {
        items: out,
        pasts,
        hidden: names,
    })
}

impl Lowered {
    /// Marks the predicates that this module made as hidden.
    pub fn hide(&self, names: &mut Names) {
        for predicate in &mut names.predicates {
            predicate.hidden |= self.hidden.contains(&predicate.name);
        }
    }

    /// Returns the memory that the clauses read.
    pub fn pasts(&self, names: &Names) -> Vec<Past> {
        let id = |name: &str| names.find(name);
        let past = |past: &NamedPast| {
            Some(Past {
                predicate: id(&past.predicate)?,
                operand: id(&past.operand)?,
                operator: match (past.operator, &past.held) {
                    (_, Some((held, columns))) => PastOperator::Since(id(held)?, columns.clone()),
                    (Operator::Historically, None) => PastOperator::Always,
                    _ => PastOperator::Once,
                },
                first: past.first,
                last: past.last,
            })
        };
        self.pasts.iter().filter_map(past).collect()
    }
}

/// An operand without the names of variables: operands with equal patterns share a hidden predicate.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Pattern {
    scope: Option<String>,
    /// Whether the first column is the ego.
    ego: bool,
    predicate: String,
    /// The arguments of the atom, with numbered variables.
    terms: Vec<String>,
    /// The number of different variables, with the ego.
    columns: usize,
}

/// An operand: the predicate to watch, and the variables of its columns.
struct Operand<'c> {
    predicate: String,
    variables: Vec<&'c Term>,
    pattern: Pattern,
}

/// The definition of a temporal literal, without the names of variables.
type Definition = (Operator, Option<(u32, u32)>, Option<(Pattern, Vec<usize>)>, Pattern);

struct Lowering<'c, 'f> {
    /// The columns of the declared predicates; `None` for those that did not parse.
    columns: HashMap<&'c str, Option<&'c [ColumnDecl]>>,
    /// The predicates that clauses with a body derive.
    derived: HashSet<&'c str>,
    /// The types that the declaration of each type names.
    parents: HashMap<&'c str, &'c [Name]>,
    /// The scope in force.
    scope: Option<&'c Name>,
    /// The first argument of the head, if a scope is in force and it is a variable.
    ego: Option<&'c Term>,
    /// The hidden predicates of operands.
    operands: IndexMap<Pattern, String>,
    /// The predicates that replace literals.
    literals: IndexMap<Definition, String>,
    names: HashSet<String>,
    decls: Vec<Decl>,
    /// Clauses with the scope that guards them.
    scoped: Vec<(Option<Name>, Clause)>,
    clauses: Vec<Clause>,
    pasts: Vec<NamedPast>,
    faults: &'f mut Faults,
}

impl<'c> Lowering<'c, '_> {
    fn clause(&mut self, clause: &'c Clause, heads: &'c [Atom]) -> Clause {
        let first = heads.first().and_then(|head| head.terms.first());
        // The clauses of the scope itself have no guards.
        let scope = self
            .scope
            .filter(|scope| heads.iter().all(|head| head.predicate.text != scope.text));
        self.ego = first.filter(|term| scope.is_some() && matches!(term.kind, TermKind::Variable(_)));
        Clause {
            heads: heads.iter().map(|head| self.atom(head)).collect(),
            probabilities: Vec::new(),
            body: self.all(&clause.body),
            doc: clause.doc.clone(),
            place: clause.place,
        }
    }

    fn all(&mut self, literals: &'c [Literal]) -> Vec<Literal> {
        literals.iter().map(|literal| self.literal(literal)).collect()
    }

    fn atom(&mut self, atom: &'c Atom) -> Atom {
        Atom {
            terms: atom.terms.iter().map(|term| self.term(term)).collect(),
            ..atom.clone()
        }
    }

    fn term(&mut self, term: &'c Term) -> Term {
        let kind = match &term.kind {
            TermKind::Functor(functor, arguments) => {
                TermKind::Functor(*functor, arguments.iter().map(|argument| self.term(argument)).collect())
            }
            TermKind::Cast(inner, ty) => TermKind::Cast(Box::new(self.term(inner)), ty.clone()),
            TermKind::Aggregate(aggregate) => TermKind::Aggregate(Box::new(Aggregate {
                op: aggregate.op,
                target: aggregate.target.as_ref().map(|target| self.term(target)),
                body: self.all(&aggregate.body),
            })),
            kind => kind.clone(),
        };
        Term {
            kind,
            place: term.place,
        }
    }

    fn literal(&mut self, literal: &'c Literal) -> Literal {
        match literal {
            Literal::Temporal { negated, temporal } => Literal::Atom {
                negated: *negated,
                atom: self.temporal(temporal),
            },
            Literal::Atom { negated, atom } => Literal::Atom {
                negated: *negated,
                atom: self.atom(atom),
            },
            Literal::Compare { op, left, right, place } => Literal::Compare {
                op: *op,
                left: self.term(left),
                right: self.term(right),
                place: *place,
            },
            Literal::Any(alternatives) => Literal::Any(alternatives.iter().map(|all| self.all(all)).collect()),
        }
    }

    /// Returns the atom that replaces a literal.
    fn temporal(&mut self, temporal: &'c Temporal) -> Atom {
        self.check_terms(temporal);
        // One literal has one view: if it concerns others, the ego is a column of both of its atoms.
        let ego = self.ego.filter(|ego| {
            let mut atoms = temporal.atoms();
            atoms.any(|atom| self.in_view(atom, ego).is_some())
        });
        let held = temporal.held.as_ref().map(|held| self.operand(held, ego));
        let operand = self.operand(&temporal.atom, ego);
        let held = held.map(|held| {
            let column = |variable: &&Term| {
                let found = operand.variables.iter().position(|other| other.kind == variable.kind);
                if found.is_none() {
                    let message = format!("the atom after `since` lacks the variable `{}`", name_of(variable));
                    let fault = Diagnostic::new(codes::INVALID_TEMPORAL, message).at(variable.place.0, "");
                    let help = "every variable before `since` must occur after it; define a predicate without it";
                    self.faults.push(fault.help(help));
                }
                found.unwrap_or(0)
            };
            let columns = held.variables.iter().map(column).collect::<Vec<usize>>();
            (held, columns)
        });
        let place = temporal.place;
        let definition: Definition = (
            temporal.operator,
            temporal.window,
            held.as_ref()
                .map(|(held, columns)| (held.pattern.clone(), columns.clone())),
            operand.pattern.clone(),
        );
        let predicate = match self.literals.get(&definition) {
            Some(predicate) => predicate.clone(),
            None => {
                let predicate = self.define(temporal, &operand, held.as_ref());
                self.literals.insert(definition, predicate.clone());
                predicate
            }
        };
        Atom {
            predicate: Name { text: predicate, place },
            terms: operand.variables.into_iter().cloned().collect(),
            place,
        }
    }

    /// Reports arguments that no row of an earlier tick determines.
    fn check_terms(&mut self, temporal: &Temporal) {
        for term in temporal.atoms().flat_map(|atom| &atom.terms) {
            let what = match &term.kind {
                TermKind::Aggregate(_) => "an aggregate",
                _ if is_computed(term) => "an expression",
                _ => continue,
            };
            let message = format!("{what} in the atom of a temporal operator");
            let fault = Diagnostic::new(codes::INVALID_TEMPORAL, message).at(term.place.0, "");
            self.faults
                .push(fault.help("write a variable, and compare it with the expression in a literal of its own"));
        }
    }

    /// Returns an atom as an operand, and defines its predicate unless that of the atom serves.
    fn operand(&mut self, atom: &'c Atom, ego: Option<&'c Term>) -> Operand<'c> {
        let mut variables: Vec<&Term> = ego.into_iter().collect();
        let terms = atom.terms.iter().map(|term| match &term.kind {
            TermKind::Variable(_) => {
                let number = variables.iter().position(|other| other.kind == term.kind);
                let number = number.unwrap_or_else(|| {
                    variables.push(term);
                    variables.len() - 1
                });
                format!("x{number}")
            }
            _ => term.to_string(),
        });
        let terms: Vec<String> = terms.collect();
        let name = &atom.predicate.text;
        let plain = terms
            .iter()
            .enumerate()
            .all(|(column, term)| *term == format!("x{column}"));
        let pattern = Pattern {
            scope: self.scope.filter(|_| ego.is_some()).map(|scope| scope.text.clone()),
            ego: ego.is_some(),
            predicate: name.clone(),
            terms,
            columns: variables.len(),
        };
        let declared = self.columns.get(name.as_str()).copied().flatten();
        let fits = declared.is_some_and(|columns| columns.len() == pattern.terms.len());
        if plain && fits && (ego.is_none() || variables.len() == 1) && self.derived.contains(name.as_str()) {
            return Operand {
                predicate: name.clone(),
                variables,
                pattern,
            };
        }
        let predicate = match self.operands.get(&pattern) {
            Some(predicate) => predicate.clone(),
            None => {
                let predicate = self.fresh(format!("now {name}"));
                let types = variables.iter().map(|variable| self.type_of(variable, atom, ego));
                let types: Option<Vec<Name>> = types.collect();
                let shown = template(atom, &variables) + &in_view_of(ego, &[atom]);
                self.declare(&predicate, types, shown, atom.place);
                self.define_operand(atom, over(&predicate, &variables, atom.place), ego);
                self.operands.insert(pattern.clone(), predicate.clone());
                predicate
            }
        };
        Operand {
            predicate,
            variables,
            pattern,
        }
    }

    /// Adds the clause of the hidden predicate of an operand.
    fn define_operand(&mut self, atom: &'c Atom, head: Atom, ego: Option<&'c Term>) {
        let place = atom.place;
        let mut atom = atom.clone();
        // These are reported.
        let computed = atom.terms.iter_mut().filter(|term| is_computed(term));
        computed.for_each(|term| term.kind = TermKind::Wildcard);
        let mut sees = None;
        if let (Some(ego), Some(scope)) = (ego, self.scope)
            && atom.terms.iter().all(|term| term.kind != ego.kind)
        {
            // The guard alone would not bind the ego.
            let seen = self.in_view(&atom, ego);
            sees = seen.map(|column| {
                let seen = &mut atom.terms[column];
                if seen.kind == TermKind::Wildcard {
                    seen.kind = TermKind::Variable("_seen".to_owned());
                }
                over(&scope.text, &[ego, seen], place)
            });
        }
        let body = sees
            .into_iter()
            .chain([atom])
            .map(|atom| Literal::Atom { negated: false, atom });
        let clause = Clause {
            heads: vec![head],
            probabilities: Vec::new(),
            body: body.collect(),
            doc: String::new(),
            place,
        };
        match ego {
            Some(_) => self.scoped.push((self.scope.cloned(), clause)),
            None => self.clauses.push(clause),
        }
    }

    /// Returns the first column of an atom with a variable other than the ego, or with `_`, that the scope guards.
    fn in_view(&self, atom: &Atom, ego: &Term) -> Option<usize> {
        let columns = |name: &str| *self.columns.get(name)?;
        let seen = columns(&self.scope?.text)?.get(1)?;
        let columns = columns(&atom.predicate.text)?;
        let guarded = |term: &Term, column: &ColumnDecl| {
            let other = match &term.kind {
                TermKind::Variable(_) => term.kind != ego.kind,
                kind => *kind == TermKind::Wildcard,
            };
            let [seen, ty] = [&seen.ty.text, &column.ty.text];
            let is_value = BaseType::ALL.iter().any(|base| base.name() == ty) && ty != seen;
            other && !is_value && (self.is_within(seen, ty) || self.is_within(ty, seen))
        };
        let mut terms = atom.terms.iter().zip(columns);
        terms.position(|(term, column)| guarded(term, column))
    }

    /// Returns whether the definition of a type leads to another one.
    fn is_within(&self, from: &str, to: &str) -> bool {
        let (mut open, mut seen) = (vec![from], HashSet::new());
        while let Some(ty) = open.pop() {
            if ty == to {
                return true;
            }
            if seen.insert(ty) {
                let parents = self.parents.get(ty).copied().unwrap_or_default();
                open.extend(parents.iter().map(|parent| parent.text.as_str()));
            }
        }
        false
    }

    /// Defines the predicate of a literal.
    fn define(
        &mut self,
        temporal: &'c Temporal,
        operand: &Operand<'c>,
        held: Option<&(Operand<'c>, Vec<usize>)>,
    ) -> String {
        let (operator, place) = (temporal.operator, temporal.place);
        let (first, last) = match temporal.window {
            Some((first, last)) => (first, Some(last)),
            None => (0, None),
        };
        let variables = &operand.variables;
        let types = variables
            .iter()
            .map(|variable| self.type_of(variable, &temporal.atom, self.ego));
        let types: Option<Vec<Name>> = types.collect();
        let name = |operator: Operator, first: u32| {
            let before = temporal.held.iter().map(|held| format!("{} ", held.predicate.text));
            let mut name: String = before.collect();
            write_window(&mut name, operator, first, last);
            format!("{name} {}", temporal.atom.predicate.text)
        };
        let ego = self
            .ego
            .filter(|ego| variables.first().is_some_and(|first| first.kind == ego.kind));
        let shown = |operator: Operator, first: u32| {
            let mut text: String = temporal
                .held
                .iter()
                .map(|held| template(held, variables) + " ")
                .collect();
            write_window(&mut text, operator, first, last);
            let atoms: Vec<&Atom> = temporal.atoms().collect();
            format!(
                "{text} {}{}",
                template(&temporal.atom, variables),
                in_view_of(ego, &atoms)
            )
        };
        let includes_present = first == 0;
        let remembers = last.is_none_or(|last| last > 0);
        let past = remembers.then(|| {
            let past = NamedPast {
                predicate: String::new(),
                // `for[10]` is `historically[0,9]`, and `previous` is `once[1,1]`.
                operator: match operator {
                    Operator::For => Operator::Historically,
                    Operator::Previous => Operator::Once,
                    other => other,
                },
                operand: operand.predicate.clone(),
                held: held.map(|(held, columns)| (held.predicate.clone(), columns.clone())),
                first: first.max(1),
                last,
            };
            if let Some(known) = self.pasts.iter().find(|known| known.remembers_as(&past)) {
                return known.predicate.clone();
            }
            let name = match past.operator {
                Operator::Since if !includes_present => format!("so far {}", name(operator, first)),
                Operator::Once if operator == Operator::Previous => name(operator, first),
                other => name(other, first.max(1)),
            };
            let predicate = self.fresh(name);
            let so_far = if operator == Operator::Since && !includes_present {
                "so far "
            } else {
                ""
            };
            let shown = match operator {
                Operator::Previous => shown(operator, first),
                _ => so_far.to_owned() + &shown(past.operator, first.max(1)),
            };
            self.declare(&predicate, types.clone(), shown, place);
            self.pasts.push(NamedPast {
                predicate: predicate.clone(),
                ..past
            });
            predicate
        });
        let atom = |predicate: &str, variables: &[&Term]| Literal::Atom {
            negated: false,
            atom: over(predicate, variables, place),
        };
        let now = atom(&operand.predicate, variables);
        let past = past.map(|past| (atom(&past, variables), past));
        let bodies: Vec<Vec<Literal>> = match (operator, held, past) {
            (_, None, Some((_, past))) if !includes_present => return past,
            (Operator::Historically | Operator::For, _, Some((past, _))) => vec![vec![now, past]],
            (_, Some((held, _)), Some((past, _))) => {
                let held = atom(&held.predicate, &held.variables);
                let now = includes_present.then_some(vec![now]);
                now.into_iter().chain([vec![held, past]]).collect()
            }
            (_, None, Some((past, _))) => vec![vec![now], vec![past]],
            (_, _, None) => vec![vec![now]],
        };
        let predicate = self.fresh(name(operator, first));
        self.declare(&predicate, types, shown(operator, first), place);
        for body in bodies {
            self.clauses.push(Clause {
                heads: vec![over(&predicate, variables, place)],
                probabilities: Vec::new(),
                body,
                doc: String::new(),
                place,
            });
        }
        predicate
    }

    /// Returns a name that no other hidden predicate has.
    fn fresh(&mut self, name: String) -> String {
        let mut numbered = name.clone();
        for number in 2.. {
            if self.names.insert(numbered.clone()) {
                break;
            }
            numbered = format!("{name} ({number})");
        }
        numbered
    }

    /// Declares a hidden predicate that is shown as this [`template`]. Without types, the checker reports its atoms
    /// elsewhere.
    fn declare(&mut self, predicate: &str, types: Option<Vec<Name>>, shown: String, place: Place) {
        let columns = types.map(|types| columns_of(types, place));
        self.decls.push(Decl {
            names: vec![Name {
                text: predicate.to_owned(),
                place,
            }],
            columns,
            qualifiers: Vec::new(),
            choices: Vec::new(),
            doc: shown,
        });
    }

    /// Returns the type of a variable of an operand: that of the column in which it occurs first, or of the ego. `None`
    /// if the predicate is not declared so.
    fn type_of(&self, variable: &Term, atom: &Atom, ego: Option<&Term>) -> Option<Name> {
        let of_column = || {
            let columns = (*self.columns.get(atom.predicate.text.as_str())?)?;
            let column = atom.terms.iter().position(|term| term.kind == variable.kind)?;
            columns.get(column).map(|column| column.ty.text.clone())
        };
        let of_ego = || {
            let ego = ego.is_some_and(|ego| ego.kind == variable.kind);
            let scope = self.scope.filter(|_| ego)?;
            let columns = (*self.columns.get(scope.text.as_str())?)?;
            columns.first().map(|column| column.ty.text.clone())
        };
        let text = of_column().or_else(of_ego)?;
        let place = variable.place;
        Some(Name { text, place })
    }
}

/// Writes an operator with its window.
fn write_window(text: &mut String, operator: Operator, first: u32, last: Option<u32>) {
    write_operator(text, operator, last.map(|last| (first, last))).expect("a string takes all text");
    if last.is_none() && first > 0 {
        // All ticks so far, without the present.
        text.push_str("[1,]");
    }
}

/// Stands before and after the number of a column in a template. No text of a source contains it.
const COLUMN: char = '\0';

/// Returns an atom with the numbers of columns in place of its variables.
fn template(atom: &Atom, columns: &[&Term]) -> String {
    let term = |term: &Term| match columns.iter().position(|column| column.kind == term.kind) {
        Some(column) => format!("{COLUMN}{column}{COLUMN}"),
        None => term.to_string(),
    };
    let terms: Vec<String> = atom.terms.iter().map(term).collect();
    format!("{}({})", atom.predicate.text, terms.join(", "))
}

/// Returns whose view a template is about, if its atoms do not say it.
fn in_view_of(ego: Option<&Term>, atoms: &[&Atom]) -> String {
    let names = |ego: &Term| {
        atoms
            .iter()
            .any(|atom| atom.terms.iter().any(|term| term.kind == ego.kind))
    };
    match ego {
        Some(ego) if !names(ego) => format!(" in the view of {COLUMN}0{COLUMN}"),
        _ => String::new(),
    }
}

/// Returns an atom of a hidden predicate of this module as the author wrote the literal; `None` for other predicates.
pub(crate) fn shown(predicate: &Predicate, arguments: &[String]) -> Option<String> {
    if !predicate.hidden || predicate.is_numbered() {
        return None;
    }
    let parts = predicate.doc.split(COLUMN).enumerate();
    let part = |(position, part): (usize, &str)| match position % 2 {
        0 => part.to_owned(),
        _ => {
            let column = part.parse::<usize>().ok();
            column
                .and_then(|column| arguments.get(column).cloned())
                .unwrap_or_default()
        }
    };
    Some(parts.map(part).collect())
}

/// Returns whether a term is an expression or an aggregate.
fn is_computed(term: &Term) -> bool {
    matches!(
        term.kind,
        TermKind::Functor(..) | TermKind::Cast(..) | TermKind::Aggregate(_)
    )
}

fn name_of(term: &Term) -> &str {
    match &term.kind {
        TermKind::Variable(name) => name,
        _ => "_",
    }
}

/// Returns columns of these types.
fn columns_of(types: Vec<Name>, place: Place) -> Vec<ColumnDecl> {
    let columns = types.into_iter().enumerate().map(|(column, ty)| ColumnDecl {
        name: Name {
            text: format!("x{}", column + 1),
            place,
        },
        ty,
    });
    columns.collect()
}

fn over(predicate: &str, variables: &[&Term], place: Place) -> Atom {
    Atom {
        predicate: Name {
            text: predicate.to_owned(),
            place,
        },
        terms: variables.iter().map(|&variable| variable.clone()).collect(),
        place,
    }
}
