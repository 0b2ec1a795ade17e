//! Checked rules: what the engine is given.
//!
//! A [`Rules`] is made by [`super::load`] from parsed text once every check has passed, and never changes afterwards. In it every name is
//! resolved, `.scope` guards are written out as ordinary atoms, every clause is safe (each variable is bound by a positive
//! atom; in the clause of a hidden predicate by a positive atom or a guard) and the predicates are stratified.

use crate::diag::Span;
use crate::symbol::Symbols;

/// One 32-bit word of a row. A column of base type `symbol` holds the number of a [`crate::symbol::Symbol`], one of base type
/// `number` the bits of an `i32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Value(pub u32);

impl Value {
    /// The word for a number.
    pub fn number(n: i32) -> Self {
        Value(n.cast_unsigned())
    }

    /// The number that the word holds, if its column is of base type `number`.
    pub fn as_number(self) -> i32 {
        self.0.cast_signed()
    }
}

/// What a word means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BaseType {
    /// An interned text.
    Symbol,
    /// A 32-bit signed integer.
    Number,
}

/// Names a type of [`Rules::types`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeId(pub u32);

/// A type: `symbol`, `number`, or a declared subtype of one of them.
#[derive(Clone, Debug)]
pub struct Type {
    /// Its name.
    pub name: String,
    /// What its values are made of.
    pub base: BaseType,
    /// The type it was declared a subtype of; `None` for `symbol` and `number`.
    pub parent: Option<TypeId>,
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
    /// Marked `.output`.
    pub output: bool,
    /// Marked `.printsize`.
    pub printsize: bool,
    /// Whether some clause with a body has it as head (IDB). Facts in the text do not count.
    pub derived: bool,
    /// Made while checking, not declared.
    pub hidden: bool,
}

impl Relation {
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

/// A comparison operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Comparison {
    /// `=`
    Equal,
    /// `!=`
    NotEqual,
    /// `<`
    Less,
    /// `<=`
    LessEqual,
    /// `>`
    Greater,
    /// `>=`
    GreaterEqual,
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
    /// `.scope` guard: like `Positive`, but not written by the author.
    Guard(Atom),
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

/// A constraint and where it is promised.
#[derive(Clone, Copy, Debug)]
pub struct Promise {
    /// What is promised.
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
    /// Types; the first two are `symbol` and `number`.
    pub types: Vec<Type>,
    /// Predicates in the order of declaration, hidden ones last.
    pub relations: Vec<Relation>,
    /// Clauses in the order of the text, those of hidden predicates last.
    pub clauses: Vec<Clause>,
    /// Strongly connected components of the predicates that have clauses, in an order in which each comes after all it depends
    /// on.
    pub strata: Vec<Stratum>,
    /// What is promised of the facts of predicates without rules, in the order of the text.
    pub promises: Vec<Promise>,
    /// The texts of all constants.
    pub symbols: Symbols,
}

impl Rules {
    /// The predicate of that name.
    pub fn relation(&self, name: &str) -> Option<RelId> {
        let index = self.relations.iter().position(|relation| relation.name == name)?;
        Some(RelId(u32::try_from(index).expect("fewer than 2^32 predicates")))
    }
}
