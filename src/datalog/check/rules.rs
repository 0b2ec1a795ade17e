//! Checked rules: what the engine is given.
//!
//! A [`Rules`] is made by [`crate::datalog::workspace::load`] from parsed text once every check has passed, and never changes afterwards. In it every name is
//! resolved, expressions, aggregates and disjunctions are taken apart, `.scope` guards are written out as ordinary atoms, every clause is
//! safe (each variable is bound by a positive atom or computed from bound ones; in the clause of a hidden predicate by a positive atom or a
//! guard) and the predicates are stratified.

use crate::datalog::syntax::ast::{BaseType, Comparison, MarkKind};
use crate::datalog::value::Value;
use crate::diag::Span;
use crate::symbol::Symbols;
use std::collections::HashMap;

use crate::datalog::syntax::functor::{AggregateOp, Functor};

/// Names a type of [`Rules::types`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeId(pub u32);

/// A type: a base type, a declared subtype, or a union of types.
#[derive(Clone, Debug)]
pub struct Type {
    /// Its name.
    pub name: String,
    /// What its values are made of.
    pub base: BaseType,
    /// The type it was declared a subtype of; for a union its base; `None` for a base type.
    pub parent: Option<TypeId>,
    /// The types that a union is made of; empty for other types.
    pub members: Vec<TypeId>,
    /// Text of its doc comment.
    pub doc: String,
}

/// Names a predicate of [`Rules::relations`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RelId(pub u32);

impl RelId {
    /// Position in [`Rules::relations`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A column of a declared predicate.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// Its declared type.
    pub ty: TypeId,
    /// The base of that type.
    pub base: BaseType,
}

/// A declared predicate, or a hidden one (its name begins with `+`, which no user can write) made while checking.
#[derive(Clone, Debug)]
pub struct Relation {
    /// Its name.
    pub name: String,
    /// Its columns; may be none.
    pub columns: Vec<Column>,
    /// Text of its doc comment, without the slashes.
    pub doc: String,
    /// Where it is declared.
    pub span: Span,
    /// Marked `.input`.
    pub input: bool,
    /// Where rows that are given go if rules derive further ones: a hidden predicate that the last of these rules reads.
    pub edb: Option<RelId>,
    /// Marked `.output`.
    pub output: bool,
    /// Marked `.printsize`.
    pub printsize: bool,
    /// Whether some clause with a body has it as head (IDB). Facts in the text do not count.
    pub derived: bool,
    /// Made while checking, not declared.
    pub hidden: bool,
    /// What its `.input`, `.output` and `.printsize` say beyond that, one for each.
    pub directives: Vec<Directive>,
}

/// One `.input`, `.output` or `.printsize` of a predicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Directive {
    /// Which of them.
    pub kind: MarkKind,
    /// Where rows come from or go to.
    pub place: RowPlace,
    /// How rows are written.
    pub format: RowFormat,
}

/// Where rows come from or go to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowPlace {
    /// The file that is named after the predicate.
    Usual,
    /// `filename=`
    File(String),
    /// `IO=stdin`, `IO=stdout`
    Terminal,
}

/// How rows are written as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowFormat {
    /// `delimiter=`: what stands between the values of a row.
    pub delimiter: String,
    /// `headers=`: whether the first line names the columns.
    pub headers: bool,
    /// `columns=`: for each column of the predicate the position of its value in the row that is read, from 0 on. Empty: rows have these
    /// values and no others.
    pub columns: Vec<usize>,
    /// `rfc4180=`: whether texts stand in double quotes, with a double quote in them written twice.
    pub quoted: bool,
}

impl Default for RowFormat {
    fn default() -> Self {
        RowFormat {
            delimiter: "\t".to_owned(),
            headers: false,
            columns: Vec::new(),
            quoted: false,
        }
    }
}

impl Relation {
    /// A predicate that clauses made while checking or planning derive.
    pub(crate) fn made(name: String, columns: Vec<Column>, doc: String, span: Span) -> Self {
        Relation {
            name,
            columns,
            doc,
            span,
            input: false,
            edb: None,
            output: false,
            printsize: false,
            derived: true,
            hidden: true,
            directives: Vec::new(),
        }
    }

    /// Number of columns.
    pub fn arity(&self) -> usize {
        self.columns.len()
    }
}

/// A variable of one clause: position in [`Clause::variables`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VarId(pub u32);

impl VarId {
    /// Position in [`Clause::variables`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// An argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Term {
    /// A variable of the clause.
    Variable(VarId),
    /// A constant of the type of its column.
    Constant(Value),
    /// `_`: any value, not needed. Occurs in body atoms only. In a negated atom it is quantified inside: `!P(x, _)` holds if
    /// no row of `P` begins with x.
    Wildcard,
}

/// A predicate with arguments.
#[derive(Clone, Debug)]
pub struct Atom {
    /// The predicate.
    pub relation: RelId,
    /// As many as the predicate has columns.
    pub terms: Vec<Term>,
    /// The place in the text.
    pub span: Span,
}

/// A literal of a clause's body.
#[derive(Clone, Debug)]
pub enum Literal {
    /// The atom holds.
    Positive(Atom),
    /// The atom does not hold. Its predicate is in a lower stratum.
    Negative(Atom),
    /// Both sides are variables or constants of the same base type. Symbols compare by their text, character by character.
    /// Besides testing, `=` with one bound side binds the other, so a variable may be bound by a chain of equalities that
    /// starts at a constant or at a variable of a positive atom.
    Compare {
        /// The operator.
        op: Comparison,
        /// Left side.
        left: Term,
        /// Right side.
        right: Term,
        /// What both sides are made of.
        base: BaseType,
        /// The place in the text.
        span: Span,
    },
    /// `to` is the value of the functor; if there is none, the literal does not hold. The arguments are variables or constants.
    /// Besides testing it binds `to` when all arguments are bound.
    Compute {
        /// A variable.
        to: Term,
        /// What is computed.
        functor: Functor,
        /// The base type of the first argument, which decides what the functor means.
        base: BaseType,
        /// Its arguments.
        arguments: Vec<Term>,
        /// The place in the text.
        span: Span,
    },
    /// `to` is the aggregate over the rows of the atom that have its constants and the values of its variables; if it has no
    /// value, the literal does not hold. The atom's predicate is in a lower stratum. Besides testing it binds `to` when all
    /// variables of the atom are bound.
    Aggregate {
        /// A variable.
        to: Term,
        /// What is computed.
        op: AggregateOp,
        /// The base type of the values.
        base: BaseType,
        /// The rows.
        atom: Atom,
        /// The column of the values; `None` for `count`.
        column: Option<usize>,
    },
    /// `.scope` guard: like `Positive`, but not written by the author.
    Guard(Atom),
}

impl Literal {
    /// The atom of a literal that has one.
    pub fn atom(&self) -> Option<&Atom> {
        match self {
            Literal::Positive(atom)
            | Literal::Negative(atom)
            | Literal::Guard(atom)
            | Literal::Aggregate { atom, .. } => Some(atom),
            Literal::Compare { .. } | Literal::Compute { .. } => None,
        }
    }

    /// Its variables, constants and wildcards.
    pub fn terms(&self) -> impl Iterator<Item = &Term> {
        let (list, further): (&[Term], [Option<&Term>; 2]) = match self {
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => (&atom.terms, [None; 2]),
            Literal::Compare { left, right, .. } => (&[], [Some(left), Some(right)]),
            Literal::Compute { to, arguments, .. } => (arguments, [Some(to), None]),
            Literal::Aggregate { to, atom, .. } => (&atom.terms, [Some(to), None]),
        };
        list.iter().chain(further.into_iter().flatten())
    }

    /// The same, to be changed.
    pub(crate) fn terms_mut(&mut self) -> impl Iterator<Item = &mut Term> {
        let (list, further): (&mut [Term], [Option<&mut Term>; 2]) = match self {
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => (&mut atom.terms, [None, None]),
            Literal::Compare { left, right, .. } => (&mut [], [Some(left), Some(right)]),
            Literal::Compute { to, arguments, .. } => (arguments, [Some(to), None]),
            Literal::Aggregate { to, atom, .. } => (&mut atom.terms, [Some(to), None]),
        };
        list.iter_mut().chain(further.into_iter().flatten())
    }
}

/// Names a clause of [`Rules::clauses`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClauseId(pub u32);

impl ClauseId {
    /// Position in [`Rules::clauses`].
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A clause. A clause without a body is a fact; all its terms are constants.
#[derive(Clone, Debug)]
pub struct Clause {
    /// What is derived.
    pub head: Atom,
    /// When; all literals must hold.
    pub body: Vec<Literal>,
    /// The names of the variables, for messages.
    pub variables: Vec<String>,
    /// Text of the doc comment before the clause, without the slashes.
    pub doc: String,
    /// The place in the text, from head to full stop.
    pub span: Span,
}

/// What is true of the facts of base predicates, whatever they are: the author's word, which nothing in the rules can show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Constraint {
    /// No row is in both.
    Disjoint(RelId, RelId),
    /// Every row of the first is one of the second.
    Implies(RelId, RelId),
    /// No row relates something to itself.
    Irreflexive(RelId),
    /// With each row the reversed one is there.
    Symmetric(RelId),
}

/// A constraint and where it is declared.
#[derive(Clone, Copy, Debug)]
pub struct DeclaredConstraint {
    /// What is declared.
    pub constraint: Constraint,
    /// The directive.
    pub span: Span,
}

/// Predicates that are computed together, after all they negate.
#[derive(Clone, Debug)]
pub struct Stratum {
    /// The predicates, each with at least one clause.
    pub relations: Vec<RelId>,
    /// All clauses with those heads, in the order of the text; facts included.
    pub clauses: Vec<ClauseId>,
    /// Whether a predicate of the stratum occurs in a body of the stratum.
    pub recursive: bool,
}

/// Checked rules.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Types; the first ones are the base types, in the order of [`BaseType::ALL`].
    pub types: Vec<Type>,
    /// Predicates in the order of declaration, hidden ones last.
    pub relations: Vec<Relation>,
    /// Clauses in the order of the text, those of hidden predicates last.
    pub clauses: Vec<Clause>,
    /// Strongly connected components of the predicates that have clauses, in an order in which each comes after all it depends
    /// on.
    pub strata: Vec<Stratum>,
    /// What is declared of the facts of predicates without rules, in the order of the text.
    pub constraints: Vec<DeclaredConstraint>,
    /// The texts of all constants.
    pub symbols: Symbols,
}

impl Rules {
    /// The predicate of that name.
    pub fn relation(&self, name: &str) -> Option<RelId> {
        let index = self.relations.iter().position(|relation| relation.name == name)?;
        Some(RelId(u32::try_from(index).expect("fewer than 2^32 predicates")))
    }

    /// All predicates by their names, for whoever looks up many.
    pub(crate) fn relations_by_name(&self) -> HashMap<&str, RelId> {
        let names = self.relations.iter().map(|relation| relation.name.as_str());
        names.zip((0..).map(RelId)).collect()
    }
}
