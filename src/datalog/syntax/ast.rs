//! The syntax tree: what a text says, before any name is looked up.

use crate::diag::Span;

use crate::datalog::syntax::functor::{AggregateOp, Functor};

/// Where a part of the tree stands in its text. Two places are always equal, so trees are compared by what they say.
#[derive(Clone, Copy, Debug)]
pub struct Place(pub Span);

impl PartialEq for Place {
    fn eq(&self, _: &Place) -> bool {
        true
    }
}

impl Eq for Place {}

/// A name as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    /// The name.
    pub text: String,
    /// Where it stands.
    pub place: Place,
}

/// One text.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct File {
    /// Its parts, in order.
    pub items: Vec<Item>,
}

/// A directive or a clause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Item {
    /// `.include "path"`
    Include(Include),
    /// `.type name <: parent` or `.type name = other`
    Type(TypeDecl),
    /// `.decl A, B(x: number)`
    Decl(Decl),
    /// `.input A, B`, `.output A`, `.printsize A`
    Mark(Mark),
    /// `.disjoint A, B`, `.implies A, B`, `.irreflexive A`, `.symmetric A`
    Constraint(ConstraintDecl),
    /// `.pragma "key" "value"`: read and ignored.
    Pragma(Pragma),
    /// `.plan 1:(2,1)`: read and ignored.
    Plan(Plan),
    /// `.scope P`, or `.scope` alone
    Scope(Scope),
    /// A fact or a rule.
    Clause(Clause),
}

/// `.include "path"`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Include {
    /// The path between the quotes.
    pub path: String,
    /// The quoted path.
    pub place: Place,
}

/// `.pragma "key" "value"`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pragma {
    /// The texts after it: a key and perhaps a value.
    pub words: Vec<String>,
    /// The directive.
    pub place: Place,
}

/// `.plan 0:(1,2), 1:(2,1)`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Versions of the clause before it, each with an order of its atoms.
    pub orders: Vec<(i64, Vec<i64>)>,
    /// The directive.
    pub place: Place,
}

/// A declared type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDecl {
    /// Its name.
    pub name: Name,
    /// What it is.
    pub definition: TypeDefinition,
    /// Text of the doc comment before it.
    pub doc: String,
}

/// The right-hand side of a `.type`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TypeDefinition {
    /// `<: parent`
    Subtype(Name),
    /// `= other`: one type under two names.
    Alias(Name),
    /// `= a | b`: all values of several types; at least two.
    Union(Vec<Name>),
    /// Something that is not understood and was reported; the name is kept so that its uses are not reported too.
    Faulty,
}

/// One or more declared predicates with the same columns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decl {
    /// Their names; at least one.
    pub names: Vec<Name>,
    /// Their columns; `None` if they could not be read, which was reported.
    pub columns: Option<Vec<ColumnDecl>>,
    /// How they are to be stored or evaluated (`btree`, `inline` ...): read and ignored.
    pub qualifiers: Vec<Name>,
    /// Text of the doc comment before it.
    pub doc: String,
}

/// `name: type`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnDecl {
    /// The column's name.
    pub name: Name,
    /// The name of its type.
    pub ty: Name,
}

/// `.input A, B` and the like.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// Which directive.
    pub kind: MarkKind,
    /// The predicates it names; at least one.
    pub names: Vec<Name>,
    /// `(key=value, ...)`; for all of them.
    pub options: Vec<DirectiveOption>,
}

/// `key=value`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DirectiveOption {
    /// The key.
    pub key: Name,
    /// The value; a word is the same as a text.
    pub value: String,
    /// The value's place.
    pub place: Place,
}

/// `.disjoint A, B` and the like.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConstraintDecl {
    /// Which directive.
    pub kind: ConstraintKind,
    /// The predicates it names: two for `.implies`, at least two for `.disjoint`, else at least one.
    pub names: Vec<Name>,
    /// All of it.
    pub place: Place,
}

/// What a [`ConstraintDecl`] says of its predicates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConstraintKind {
    /// `.disjoint`
    Disjoint,
    /// `.implies`
    Implies,
    /// `.irreflexive`
    Irreflexive,
    /// `.symmetric`
    Symmetric,
}

impl ConstraintKind {
    /// The directive without its dot.
    pub fn name(self) -> &'static str {
        match self {
            ConstraintKind::Disjoint => "disjoint",
            ConstraintKind::Implies => "implies",
            ConstraintKind::Irreflexive => "irreflexive",
            ConstraintKind::Symmetric => "symmetric",
        }
    }
}

/// `.scope P`: guards the variables of the clauses after it; without a name it ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scope {
    /// The guard.
    pub predicate: Option<Name>,
    /// The directive.
    pub place: Place,
}

/// A fact (no body) or a rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clause {
    /// What is derived; at least one.
    pub heads: Vec<Atom>,
    /// When: all of these hold.
    pub body: Vec<Literal>,
    /// Text of the doc comment before it.
    pub doc: String,
    /// From head to full stop.
    pub place: Place,
}

/// A literal. Negations of anything but an atom are folded when they are read, and so are parentheses and `true`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Literal {
    /// `P(X)`, or `Not(P(X))`, `not P(X)`, `!P(X)`
    Atom {
        /// Whether it is negated.
        negated: bool,
        /// The atom.
        atom: Atom,
    },
    /// `X < Y`, `match(X, Y)`, `contains(X, Y)`
    Compare {
        /// The operator.
        op: Comparison,
        /// Left side.
        left: Term,
        /// Right side.
        right: Term,
        /// Both sides.
        place: Place,
    },
    /// `(A(x), B(x); C(x))`: all literals of one of the alternatives hold. None for `false`.
    Any(Vec<Vec<Literal>>),
}

/// A predicate with arguments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Atom {
    /// The predicate's name.
    pub predicate: Name,
    /// Its arguments.
    pub terms: Vec<Term>,
    /// All of it.
    pub place: Place,
}

/// An argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Term {
    /// What it is.
    pub kind: TermKind,
    /// Where it stands.
    pub place: Place,
}

/// What a [`Term`] is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TermKind {
    /// A variable's name.
    Variable(String),
    /// `_`
    Wildcard,
    /// A whole number; what base type it is of depends on where it stands.
    Number(i64),
    /// `1u`
    Unsigned(u32),
    /// `2.5`, as it is written.
    Float(String),
    /// A text in quotes, after its escapes were replaced.
    Text(String),
    /// `x + 1`, `cat(x, y)`
    Functor(Functor, Vec<Term>),
    /// `as(x, type)`
    Cast(Box<Term>, Name),
    /// `sum x : { A(x) }`
    Aggregate(Box<Aggregate>),
}

/// `op target : { body }`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Aggregate {
    /// What is computed.
    pub op: AggregateOp,
    /// Of what; `None` for `count` only.
    pub target: Option<Term>,
    /// For which values of the variables.
    pub body: Vec<Literal>,
}

/// What a word means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BaseType {
    /// An interned text.
    Symbol,
    /// A 32-bit signed integer.
    Number,
    /// A 32-bit unsigned integer.
    Unsigned,
    /// A floating-point number of single precision.
    Float,
}

impl BaseType {
    /// All of them; the type of that name is at the same position of [`Rules::types`](crate::datalog::Rules::types).
    pub const ALL: [BaseType; 4] = [BaseType::Symbol, BaseType::Number, BaseType::Unsigned, BaseType::Float];

    /// The type that has this name in other languages.
    pub(crate) fn of_other_languages(name: &str) -> Option<BaseType> {
        match name {
            "int" | "integer" | "i32" => Some(BaseType::Number),
            "uint" | "u32" => Some(BaseType::Unsigned),
            "double" | "real" | "f32" => Some(BaseType::Float),
            "string" | "str" | "text" => Some(BaseType::Symbol),
            _ => None,
        }
    }

    /// Its name in the language.
    pub fn name(self) -> &'static str {
        match self {
            BaseType::Symbol => "symbol",
            BaseType::Number => "number",
            BaseType::Unsigned => "unsigned",
            BaseType::Float => "float",
        }
    }
}

/// The kind of a [`Directive`](crate::datalog::Directive).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkKind {
    /// `.input`
    Input,
    /// `.output`
    Output,
    /// `.printsize`
    PrintSize,
}

impl MarkKind {
    /// Its name in the language, without the full stop.
    pub fn name(self) -> &'static str {
        match self {
            MarkKind::Input => "input",
            MarkKind::Output => "output",
            MarkKind::PrintSize => "printsize",
        }
    }
}

/// A comparison operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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
    /// `match(pattern, text)`
    Match,
    /// `!match(pattern, text)`
    NotMatch,
    /// `contains(part, text)`
    Contains,
    /// `!contains(part, text)`
    NotContains,
}

impl Comparison {
    /// The comparison that holds when this one does not.
    pub fn opposite(self) -> Comparison {
        match self {
            Comparison::Equal => Comparison::NotEqual,
            Comparison::NotEqual => Comparison::Equal,
            Comparison::Less => Comparison::GreaterEqual,
            Comparison::LessEqual => Comparison::Greater,
            Comparison::Greater => Comparison::LessEqual,
            Comparison::GreaterEqual => Comparison::Less,
            Comparison::Match => Comparison::NotMatch,
            Comparison::NotMatch => Comparison::Match,
            Comparison::Contains => Comparison::NotContains,
            Comparison::NotContains => Comparison::Contains,
        }
    }
}
