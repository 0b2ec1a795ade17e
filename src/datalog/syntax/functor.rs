//! Operators, functions and aggregates: names, precedence, arity and types.
//!
//! [`super::super::value`] evaluates them.

use crate::chance;

/// The interpretation of a 32-bit word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BaseType {
    /// An interned string.
    Symbol,
    /// A signed integer of 32 bits, or [64](crate::symbol::WordSize).
    Number,
    /// An unsigned integer of the same size.
    Unsigned,
    /// A floating-point number of the same size.
    Float,
    /// An interned record, or `nil`.
    Record,
}

impl BaseType {
    /// The base types that a declaration can name, in the order in which they open
    /// [`Rules::types`](crate::Rules::types). The type of all records follows them there.
    pub const ALL: [BaseType; 4] = [BaseType::Symbol, BaseType::Number, BaseType::Unsigned, BaseType::Float];

    /// Returns the base type that other languages call `name`.
    pub(crate) fn of_other_languages(name: &str) -> Option<BaseType> {
        match name {
            "int" | "integer" | "i32" => Some(BaseType::Number),
            "uint" | "u32" => Some(BaseType::Unsigned),
            "double" | "real" | "f32" => Some(BaseType::Float),
            "string" | "str" | "text" => Some(BaseType::Symbol),
            _ => None,
        }
    }

    /// Returns whether the words of its values are symbols.
    pub(crate) fn is_interned(self) -> bool {
        matches!(self, BaseType::Symbol | BaseType::Record)
    }

    /// Returns the name of the type in rule files.
    pub fn name(self) -> &'static str {
        match self {
            BaseType::Symbol => "symbol",
            BaseType::Number => "number",
            BaseType::Unsigned => "unsigned",
            BaseType::Float => "float",
            BaseType::Record => "record",
        }
    }

    /// Returns the letter of this type in the shape of a record.
    pub(crate) fn kind(self) -> u8 {
        match self {
            BaseType::Symbol => b's',
            BaseType::Number => b'n',
            BaseType::Unsigned => b'u',
            BaseType::Float => b'f',
            BaseType::Record => b'r',
        }
    }

    /// Returns the type of the fields of a kind.
    pub(crate) fn of_kind(kind: u8) -> BaseType {
        let mut all = Self::ALL.into_iter().chain([BaseType::Record]);
        all.find(|base| base.kind() == kind).unwrap_or(BaseType::Symbol)
    }
}

/// An operator or function of expressions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "the names are those of the language; see `Functor::name`")]
pub enum Functor {
    Negate,
    BitNot,
    Not,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
    Power,
    BitAnd,
    BitOr,
    BitXor,
    ShiftLeft,
    ShiftRight,
    ShiftRightUnsigned,
    And,
    Or,
    Xor,
    Min,
    Max,
    Cat,
    Length,
    Substring,
    Ordinal,
    ToNumber,
    ToSymbol,
    ToFloat,
    ToUnsigned,
    /// `as(x, T)`: the same bits with another type.
    Cast,
    /// `range` has many values. The checker replaces it by an atom, so no evaluator applies it; see `check::range`.
    Range,
    /// The alternative that a clause with probabilities draws. The checker makes it.
    Choose,
    /// `[x, y]`: the record with these fields. The first argument is its shape.
    Pack,
    /// A field of a record: the arguments are its shape, the position of the field, and the record. A record of another
    /// shape has no such field. The base type of the literal is that of the field.
    Unpack,
    /// Like [`Functor::Pack`], but has no value unless the record exists. Only the planner uses it.
    Find,
    /// `@f(x, y)`: a user-defined functor. The first argument is its position in [`Rules::functors`](crate::Rules).
    /// The base type of the literal is that of the result.
    Call,
    /// `autoinc()`: a number of its own for each solution of a body. The checker reads it from a hidden predicate, whose
    /// clause applies it to that predicate and the values of the solution.
    Counter,
}

use Functor::*;

/// The types of arguments and result.
pub(crate) enum Shape {
    /// Any number of arguments of one base type, which is also that of the result.
    Same(&'static [BaseType]),
    /// An argument of one of these base types, and a result of another one.
    Convert(&'static [BaseType], BaseType),
    /// Arguments and result as listed.
    Fixed(&'static [BaseType], BaseType),
    /// The arguments of [`Functor::Choose`].
    Choice,
    /// Those of [`Functor::Pack`], [`Functor::Unpack`] and [`Functor::Find`], which the shape of the record determines.
    Record,
    /// Those of [`Functor::Call`], which the declaration determines.
    Declared,
}

const NUMERIC: &[BaseType] = &[BaseType::Number, BaseType::Unsigned, BaseType::Float];
const INTEGER: &[BaseType] = &[BaseType::Number, BaseType::Unsigned];
const SIGNED: &[BaseType] = &[BaseType::Number, BaseType::Float];
const ANY: &[BaseType] = &[BaseType::Number, BaseType::Unsigned, BaseType::Float, BaseType::Symbol];

/// What a cast takes: a record may get another record type.
const CASTABLE: &[BaseType] = &[
    BaseType::Number,
    BaseType::Unsigned,
    BaseType::Float,
    BaseType::Symbol,
    BaseType::Record,
];

impl Functor {
    /// Every functor with its spelling.
    const NAMES: &'static [(Functor, &'static str)] = &[
        (Negate, "-"),
        (BitNot, "bnot"),
        (Not, "lnot"),
        (Add, "+"),
        (Subtract, "-"),
        (Multiply, "*"),
        (Divide, "/"),
        (Remainder, "%"),
        (Power, "^"),
        (BitAnd, "band"),
        (BitOr, "bor"),
        (BitXor, "bxor"),
        (ShiftLeft, "bshl"),
        (ShiftRight, "bshr"),
        (ShiftRightUnsigned, "bshru"),
        (And, "land"),
        (Or, "lor"),
        (Xor, "lxor"),
        (Min, "min"),
        (Max, "max"),
        (Cat, "cat"),
        (Length, "strlen"),
        (Substring, "substr"),
        (Ordinal, "ord"),
        (ToNumber, "to_number"),
        (ToSymbol, "to_string"),
        (ToFloat, "to_float"),
        (ToUnsigned, "to_unsigned"),
        (Cast, "as"),
        (Range, "range"),
        (Choose, "choose"),
        (Pack, "[...]"),
        (Unpack, "[...]"),
        (Find, "[...]"),
        (Call, "@"),
        (Counter, "autoinc"),
    ];

    /// Returns the spelling of the functor.
    pub fn name(self) -> &'static str {
        let found = Self::NAMES.iter().find(|(functor, _)| *functor == self);
        found.map_or("", |(_, name)| name)
    }

    /// Returns the function with that name, such as `cat`.
    pub(crate) fn function(name: &str) -> Option<Functor> {
        let named = |functor: &Functor| functor.precedence().is_none() && !matches!(functor, Cast | Choose);
        let mut all = Self::NAMES.iter().filter(|(functor, _)| named(functor));
        all.find(|(_, other)| *other == name).map(|(functor, _)| *functor)
    }

    /// Returns the names of functions, and of the operators that are words.
    pub fn words() -> impl Iterator<Item = &'static str> {
        let written = Self::NAMES.iter().filter(|(functor, _)| *functor != Choose);
        let names = written.map(|(_, name)| *name);
        names.filter(|name| name.starts_with(|c: char| c.is_ascii_alphabetic()))
    }

    /// Returns the binary operator with that spelling.
    pub(crate) fn infix(text: &str) -> Option<Functor> {
        let mut all = Self::NAMES.iter().filter(|(functor, _)| functor.is_infix());
        all.find(|(_, other)| *other == text).map(|(functor, _)| *functor)
    }

    /// Returns whether the functor is an operator between its arguments.
    pub(crate) fn is_infix(self) -> bool {
        !self.is_prefix() && self.precedence().is_some()
    }

    /// Returns whether the functor is a prefix operator.
    pub(crate) fn is_prefix(self) -> bool {
        matches!(self, Negate | BitNot | Not)
    }

    /// Returns whether the functor can create new symbols. What a user-defined functor does is unknown.
    pub fn makes_symbol(self) -> bool {
        matches!(self, Cat | Substring | ToSymbol | Pack | Call)
    }

    /// Returns the precedence of an operator, from 1 (loosest) to 11; `None` for functions.
    pub(crate) fn precedence(self) -> Option<u8> {
        Some(match self {
            Or => 1,
            Xor => 2,
            And => 3,
            BitOr => 4,
            BitXor => 5,
            BitAnd => 6,
            ShiftLeft | ShiftRight | ShiftRightUnsigned => 7,
            Add | Subtract => 8,
            Multiply | Divide | Remainder => 9,
            Negate | BitNot | Not => 10,
            Power => 11,
            _ => return None,
        })
    }

    /// Returns the minimum and maximum number of arguments.
    pub(crate) fn arity(self) -> (usize, usize) {
        match self {
            Min | Max => (2, 64),
            Cat => (1, 64),
            Substring => (3, 3),
            Range => (2, 3),
            Choose => (chance::FIXED, usize::MAX),
            Pack | Find | Call => (1, usize::MAX),
            Counter => (0, 0),
            Unpack => (3, 3),
            Length | Ordinal | ToNumber | ToSymbol | ToFloat | ToUnsigned | Cast => (1, 1),
            _ if self.is_prefix() => (1, 1),
            _ => (2, 2),
        }
    }

    pub(crate) fn shape(self) -> Shape {
        use BaseType::{Float, Number, Record, Symbol, Unsigned};
        match self {
            Negate => Shape::Same(SIGNED),
            Subtract | Multiply | Divide | Power | Range => Shape::Same(NUMERIC),
            Add | Min | Max => Shape::Same(ANY),
            BitNot | Not | Remainder | BitAnd | BitOr | BitXor | ShiftLeft | ShiftRight | ShiftRightUnsigned | And
            | Or | Xor => Shape::Same(INTEGER),
            Cat => Shape::Same(&[Symbol]),
            Length => Shape::Fixed(&[Symbol], Number),
            Substring => Shape::Fixed(&[Symbol, Number, Number], Symbol),
            Ordinal => Shape::Convert(&[Symbol, Record], Number),
            Counter => Shape::Fixed(&[], Number),
            ToNumber => Shape::Convert(ANY, Number),
            ToSymbol => Shape::Convert(ANY, Symbol),
            ToFloat => Shape::Convert(ANY, Float),
            ToUnsigned => Shape::Convert(ANY, Unsigned),
            Choose => Shape::Choice,
            Pack | Unpack | Find => Shape::Record,
            Call => Shape::Declared,
            // The result has the base type of the named type.
            Cast => Shape::Convert(CASTABLE, Number),
        }
    }
}

impl Functor {
    /// Returns the base type of the argument at a position, given that of the first one; `None` if it may have any.
    pub(crate) fn argument_base(self, base: BaseType, at: usize) -> Option<BaseType> {
        match self.shape() {
            Shape::Fixed(arguments, _) => arguments.get(at).copied(),
            Shape::Same(_) | Shape::Convert(..) => Some(base),
            Shape::Choice | Shape::Declared => None,
            Shape::Record => match (self, at) {
                (_, 0) => Some(BaseType::Symbol),
                (Unpack, 1) => Some(BaseType::Unsigned),
                (Unpack, _) => Some(BaseType::Record),
                _ => None,
            },
        }
    }

    /// Returns the base type of the value; `None` for a cast, which names its type itself.
    pub(crate) fn result_base(self, base: BaseType) -> Option<BaseType> {
        match self.shape() {
            _ if self == Cast => None,
            Shape::Same(_) | Shape::Declared => Some(base),
            Shape::Fixed(_, result) | Shape::Convert(_, result) => Some(result),
            Shape::Choice => Some(BaseType::Number),
            Shape::Record if self == Unpack => Some(base),
            Shape::Record => Some(BaseType::Record),
        }
    }
}

/// An aggregate function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "the names are those of the language")]
pub enum AggregateOp {
    Count,
    Sum,
    Min,
    Max,
    Mean,
}

impl AggregateOp {
    /// All operators.
    pub const ALL: [AggregateOp; 5] = [
        AggregateOp::Count,
        AggregateOp::Sum,
        AggregateOp::Min,
        AggregateOp::Max,
        AggregateOp::Mean,
    ];

    /// Returns the spelling of the aggregate.
    pub fn name(self) -> &'static str {
        match self {
            AggregateOp::Count => "count",
            AggregateOp::Sum => "sum",
            AggregateOp::Min => "min",
            AggregateOp::Max => "max",
            AggregateOp::Mean => "mean",
        }
    }

    /// Returns the aggregate with this spelling.
    pub(crate) fn named(name: &str) -> Option<AggregateOp> {
        AggregateOp::ALL.into_iter().find(|op| op.name() == name)
    }

    /// Returns the base type of the result over values of this base type.
    pub(crate) fn result_base(self, base: BaseType) -> BaseType {
        match self {
            AggregateOp::Count => BaseType::Number,
            AggregateOp::Mean => BaseType::Float,
            AggregateOp::Sum | AggregateOp::Min | AggregateOp::Max => base,
        }
    }

    /// Returns the base types that the aggregate accepts.
    pub(crate) fn takes(self) -> &'static [BaseType] {
        match self {
            AggregateOp::Min | AggregateOp::Max => ANY,
            _ => NUMERIC,
        }
    }
}
