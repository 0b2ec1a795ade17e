//! The syntax tree: a parsed source, before name resolution.

use crate::diag::Span;
use crate::syntax::functor::{AggregateOp, Functor};
use core::net::Ipv4Addr;

pub use crate::syntax::functor::BaseType;

/// The place of a node in its source. All places compare equal, so the comparison of trees ignores them.
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
    /// The place of the name.
    pub place: Place,
}

/// One parsed source.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct File {
    /// Directives and clauses, in source order.
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
    /// An integrity constraint: `.disjoint A, B`, `.reflexive A`, ...
    Constraint(ConstraintDecl),
    /// `.pragma "key" "value"`: parsed and ignored.
    Pragma(Pragma),
    /// `.plan 1:(2,1)`: parsed and ignored.
    Plan(Plan),
    /// `.scope P`, or `.scope` alone
    Scope(Scope),
    /// `.comp name<T> : base<T> { ... }`
    Component(Component),
    /// `.init name = component<T>`
    Init(Init),
    /// `.override P`, in a component
    Override(Override),
    /// `.functor f(x: number, y: symbol): number`
    Functor(FunctorDecl),
    /// `A(x) <= A(y) :- x < y.`
    Subsumption(Subsumption),
    /// A fact or a rule.
    Clause(Clause),
}

/// `A(x) <= A(y) :- x < y.`: a row of A does not hold if another row makes it superfluous.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subsumption {
    /// The row that does not hold.
    pub weaker: Atom,
    /// The row that holds instead.
    pub stronger: Atom,
    /// The body: a conjunction.
    pub body: Vec<Literal>,
    /// The text of the doc comment before it.
    pub doc: String,
    /// The text up to the full stop.
    pub place: Place,
}

/// `.functor f(x: number, y: symbol): number stateful`: a functor that the caller defines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FunctorDecl {
    /// The name, without `@`.
    pub name: Name,
    /// The types of the arguments, each with its name if it has one.
    pub arguments: Vec<(Option<Name>, Name)>,
    /// The type of the value.
    pub result: Name,
    /// Whether it is `stateful`, which has no effect.
    pub stateful: bool,
    /// The text of the doc comment before the declaration.
    pub doc: String,
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
    /// The strings after the directive: a key and an optional value.
    pub words: Vec<String>,
    /// The directive.
    pub place: Place,
}

/// `.plan 0:(1,2), 1:(2,1)`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The join orders: a version number of the preceding clause and the order of its atoms.
    pub orders: Vec<(i128, Vec<i128>)>,
    /// The directive.
    pub place: Place,
}

/// A type declaration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDecl {
    /// The name of the type.
    pub name: Name,
    /// The right-hand side of the declaration.
    pub definition: TypeDefinition,
    /// The text of the doc comment before the declaration.
    pub doc: String,
}

/// The right-hand side of a `.type`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TypeDefinition {
    /// `<: parent`
    Subtype(Name),
    /// `= other`: a second name for the same type.
    Alias(Name),
    /// `= a | b`: the values of all members, of which there are at least two.
    Union(Vec<Name>),
    /// `= [x: number, y: symbol]`: records with these fields, and `nil`.
    Record(Vec<ColumnDecl>),
    /// `= A {x: number} | B {}`: an algebraic data type, whose values are records with the name of a branch.
    Branches(Vec<Branch>),
    /// A definition that the parser reported as faulty. The tree keeps the name to avoid further reports at its uses.
    Faulty,
}

/// A branch of an algebraic data type: `A {x: number}`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Branch {
    /// The name of the branch.
    pub name: Name,
    /// The fields; may be empty.
    pub fields: Vec<ColumnDecl>,
}

/// A declaration of one or more predicates with the same columns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decl {
    /// The names of the predicates; at least one.
    pub names: Vec<Name>,
    /// The columns; `None` if the parser reported them as faulty.
    pub columns: Option<Vec<ColumnDecl>>,
    /// Storage and evaluation qualifiers (`btree`, `inline` ...). Only `inline` has an effect.
    pub qualifiers: Vec<Name>,
    /// `choice-domain x, (y, z)`: keys, each of which has at most one row of the predicate.
    pub choices: Vec<Vec<Name>>,
    /// The text of the doc comment before the declaration.
    pub doc: String,
}

/// A column: `name: type`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnDecl {
    /// The name of the column.
    pub name: Name,
    /// The name of its type.
    pub ty: Name,
}

/// `.input A, B`, `.output A`, `.printsize A` or `.limitsize A(n=10)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mark {
    /// The directive.
    pub kind: MarkKind,
    /// The predicates; at least one.
    pub names: Vec<Name>,
    /// The options `(key=value, ...)`, which apply to all the predicates.
    pub options: Vec<DirectiveOption>,
}

/// An option: `key=value`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DirectiveOption {
    /// The key.
    pub key: Name,
    /// The value; a bare word equals the same word in quotes.
    pub value: String,
    /// The place of the value.
    pub place: Place,
}

/// `.comp name<T> : base<T> { ... }`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Component {
    /// The name of the component.
    pub name: Name,
    /// The parameters, each of which stands for a type or a component.
    pub parameters: Vec<Name>,
    /// The components whose items this one has, too.
    pub bases: Vec<ComponentType>,
    /// The items between the braces.
    pub items: Vec<Item>,
    /// The text of the doc comment before the component.
    pub doc: String,
    /// The directive up to the opening brace.
    pub place: Place,
}

/// A component with its arguments: `graph<number>`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComponentType {
    /// The name of the component, or of a parameter that stands for one.
    pub name: Name,
    /// The types or components for its parameters.
    pub arguments: Vec<Name>,
}

/// `.init name = component<T>`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Init {
    /// The name of the instance.
    pub name: Name,
    /// What it is an instance of.
    pub component: ComponentType,
    /// The directive.
    pub place: Place,
}

/// `.override P, Q`: the component defines these predicates of its bases anew.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Override {
    /// The predicates; at least one.
    pub names: Vec<Name>,
    /// The directive.
    pub place: Place,
}

/// An integrity constraint, such as `.disjoint A, B`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConstraintDecl {
    /// The kind of constraint.
    pub kind: ConstraintKind,
    /// The predicates: exactly two for `.implies`, at least two for `.disjoint` and `.covering`, at least one
    /// otherwise.
    pub names: Vec<Name>,
    /// The whole directive.
    pub place: Place,
}

/// The kind of a [`ConstraintDecl`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConstraintKind {
    /// `.disjoint`: no row is in two of the predicates.
    Disjoint,
    /// `.implies`: every row of the first predicate is in the second one.
    Implies,
    /// `.covering`: every value of the type is in one of the predicates.
    Covering,
    /// `.reflexive`: every value of the type is related to itself.
    Reflexive,
    /// `.irreflexive`: no row relates a value to itself.
    Irreflexive,
    /// `.symmetric`: with every row, the swapped row holds too.
    Symmetric,
    /// `.asymmetric`: a row and its swapped row never both hold.
    Asymmetric,
}

impl ConstraintKind {
    /// All kinds.
    pub const ALL: [ConstraintKind; 7] = [
        ConstraintKind::Disjoint,
        ConstraintKind::Implies,
        ConstraintKind::Covering,
        ConstraintKind::Reflexive,
        ConstraintKind::Irreflexive,
        ConstraintKind::Symmetric,
        ConstraintKind::Asymmetric,
    ];

    /// Returns the name of the directive without its dot.
    pub fn name(self) -> &'static str {
        match self {
            ConstraintKind::Disjoint => "disjoint",
            ConstraintKind::Implies => "implies",
            ConstraintKind::Covering => "covering",
            ConstraintKind::Reflexive => "reflexive",
            ConstraintKind::Irreflexive => "irreflexive",
            ConstraintKind::Symmetric => "symmetric",
            ConstraintKind::Asymmetric => "asymmetric",
        }
    }
}

/// `.scope P`: guards the variables of the clauses that follow. `.scope` alone ends the scope.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scope {
    /// The guard; `None` ends the scope.
    pub predicate: Option<Name>,
    /// The directive.
    pub place: Place,
}

/// A fact (no body) or a rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clause {
    /// The head atoms; at least one.
    pub heads: Vec<Atom>,
    /// `0.8 :: A(x)`: the probability of each head, of which at most one is drawn. Empty if all heads hold.
    pub probabilities: Vec<Term>,
    /// The body: a conjunction. Empty for a fact.
    pub body: Vec<Literal>,
    /// The text of the doc comment before the clause.
    pub doc: String,
    /// The text from the head to the full stop.
    pub place: Place,
}

/// A literal. The parser folds parentheses, `true`, and negations of anything but an atom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Literal {
    /// `P(X)`, or `Not(P(X))`, `not P(X)`, `!P(X)`
    Atom {
        /// Whether the atom is negated.
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
    /// `once[0,5] P(X)`, `P(X) since Q(X)`
    Temporal {
        /// Whether the literal is negated.
        negated: bool,
        /// The operator and its atoms.
        temporal: Box<Temporal>,
    },
    /// `(A(x), B(x); C(x))`: a disjunction of conjunctions. Without alternatives it is `false`.
    Any(Vec<Vec<Literal>>),
}

/// A temporal operator, applied to atoms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Temporal {
    /// The operator.
    pub operator: Operator,
    /// The first and the last tick of the window, counted back from the present; `None` for all ticks so far.
    pub window: Option<(u32, u32)>,
    /// The atom before `since`, and only there.
    pub held: Option<Atom>,
    /// The atom after the operator.
    pub atom: Atom,
    /// The whole literal.
    pub place: Place,
}

/// The operator of a [`Temporal`] literal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Operator {
    /// `previous P(X)`: P held in the tick before. The window is from 1 to 1.
    Previous,
    /// `once[a,b] P(X)`: P held in some tick of the window.
    Once,
    /// `historically[a,b] P(X)`: P held in all ticks of the window.
    Historically,
    /// `for[n] P(X)`: P held in the last n ticks. The window is from 0 to n - 1.
    For,
    /// `P(X) since[a,b] Q(X)`: Q held in some tick of the window, and P in all ticks after that one.
    Since,
}

impl Operator {
    /// All operators.
    pub const ALL: [Operator; 5] = [
        Operator::Previous,
        Operator::Once,
        Operator::Historically,
        Operator::For,
        Operator::Since,
    ];

    /// Returns the word that writes the operator.
    pub fn word(self) -> &'static str {
        match self {
            Operator::Previous => "previous",
            Operator::Once => "once",
            Operator::Historically => "historically",
            Operator::For => "for",
            Operator::Since => "since",
        }
    }
}

impl Temporal {
    /// Returns the atoms, that before `since` first.
    pub fn atoms(&self) -> impl Iterator<Item = &Atom> {
        self.held.iter().chain([&self.atom])
    }

    /// Mutable variant of [`atoms`](Temporal::atoms).
    pub(crate) fn atoms_mut(&mut self) -> impl Iterator<Item = &mut Atom> {
        self.held.iter_mut().chain([&mut self.atom])
    }
}

/// A predicate applied to arguments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Atom {
    /// The name of the predicate.
    pub predicate: Name,
    /// The arguments.
    pub terms: Vec<Term>,
    /// The whole atom.
    pub place: Place,
}

/// An argument or operand.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Term {
    /// The kind of term.
    pub kind: TermKind,
    /// The place of the term.
    pub place: Place,
}

/// The kind of a [`Term`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TermKind {
    /// A variable, by name.
    Variable(String),
    /// `_`
    Wildcard,
    /// A whole number. The context determines its base type.
    Number(i128),
    /// `10.0.0.1`: the number with these four bytes, the first one highest.
    Address(Ipv4Addr),
    /// `1u`
    Unsigned(u64),
    /// `2.5`, as written.
    Float(String),
    /// A string, with its escapes replaced.
    Symbol(String),
    /// `x + 1`, `cat(x, y)`
    ///
    /// A record, too: the first argument of [`Functor::Pack`] is the name of the branch as a symbol, empty for
    /// `[x, y]`; without arguments it is `nil`. The first argument of [`Functor::Call`] is the name of the functor.
    Functor(Functor, Vec<Term>),
    /// `as(x, type)`
    Cast(Box<Term>, Name),
    /// `sum x : { A(x) }`
    Aggregate(Box<Aggregate>),
}

/// `op target : { body }`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Aggregate {
    /// The aggregate function.
    pub op: AggregateOp,
    /// The aggregated expression; `None` for `count`, and only there.
    pub target: Option<Term>,
    /// The body: the aggregate ranges over the bindings that satisfy it.
    pub body: Vec<Literal>,
}

/// The kind of a [`Directive`](crate::Directive).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkKind {
    /// `.input`
    Input,
    /// `.output`
    Output,
    /// `.printsize`
    PrintSize,
    /// `.limitsize`
    LimitSize,
}

impl MarkKind {
    /// Returns the name of the directive without its dot.
    pub fn name(self) -> &'static str {
        match self {
            MarkKind::Input => "input",
            MarkKind::Output => "output",
            MarkKind::PrintSize => "printsize",
            MarkKind::LimitSize => "limitsize",
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
    /// `match(pattern, s)`: the regular expression matches all of the symbol.
    Match,
    /// `!match(pattern, s)`
    NotMatch,
    /// `contains(part, s)`: the symbol contains the part.
    Contains,
    /// `!contains(part, s)`
    NotContains,
}

impl Comparison {
    /// Returns the comparison with its sides exchanged.
    pub(crate) fn mirrored(self) -> Comparison {
        match self {
            Comparison::Less => Comparison::Greater,
            Comparison::LessEqual => Comparison::GreaterEqual,
            Comparison::Greater => Comparison::Less,
            Comparison::GreaterEqual => Comparison::LessEqual,
            other => other,
        }
    }

    /// Returns the negated comparison.
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

/// Calls `each` with every occurrence of a variable in a term; those in aggregates only if `inside`.
pub(crate) fn names_of<'c>(term: &'c Term, inside: bool, each: &mut impl FnMut(&'c str)) {
    match &term.kind {
        TermKind::Variable(name) => each(name),
        TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| names_of(argument, inside, each)),
        TermKind::Cast(inner, _) => names_of(inner, inside, each),
        TermKind::Aggregate(aggregate) if inside => {
            aggregate
                .target
                .iter()
                .for_each(|target| names_of(target, inside, each));
            aggregate
                .body
                .iter()
                .for_each(|literal| names_in(literal, inside, each));
        }
        TermKind::Aggregate(_)
        | TermKind::Wildcard
        | TermKind::Number(_)
        | TermKind::Address(_)
        | TermKind::Unsigned(_)
        | TermKind::Float(_)
        | TermKind::Symbol(_) => {}
    }
}

/// Calls `each` with every occurrence of a variable in a literal; those in aggregates only if `inside`.
pub(crate) fn names_in<'c>(literal: &'c Literal, inside: bool, each: &mut impl FnMut(&'c str)) {
    match literal {
        Literal::Atom { atom, .. } => atom.terms.iter().for_each(|term| names_of(term, inside, each)),
        Literal::Compare { left, right, .. } => [left, right].into_iter().for_each(|side| names_of(side, inside, each)),
        Literal::Temporal { temporal, .. } => {
            let terms = temporal.atoms().flat_map(|atom| &atom.terms);
            terms.for_each(|term| names_of(term, inside, each));
        }
        Literal::Any(alternatives) => {
            alternatives
                .iter()
                .flatten()
                .for_each(|literal| names_in(literal, inside, each));
        }
    }
}
