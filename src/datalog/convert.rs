//! Conversion between rows of Rust values and the words of a predicate.

use std::fmt;

use crate::check::{Column, Predicate, PredicateId, Rules, Type, TypeId};
use crate::diag::{counted, did_you_mean};
use crate::symbol::{Symbol, Symbols, WordEncoder, WordSize};
use crate::syntax::functor::BaseType;
use crate::value::{Value, WHOLE, print_record};

mod read;

pub(crate) use read::read;
pub use read::{record_of_text, record_word};

/// A predicate as callers name it: by its name, or by its id, which takes no search.
pub trait AsPredicate: Copy {
    #[doc(hidden)]
    fn resolve(self, rules: &Rules) -> Result<(PredicateId, &Predicate), RowError>;
}

impl AsPredicate for PredicateId {
    #[inline]
    fn resolve(self, rules: &Rules) -> Result<(PredicateId, &Predicate), RowError> {
        let predicate = rules.predicates.get(self.index());
        let unknown = || RowError::UnknownPredicate {
            predicate: format!("#{}", self.0),
            near: None,
        };
        Ok((self, predicate.ok_or_else(unknown)?))
    }
}

impl AsPredicate for &str {
    fn resolve(self, rules: &Rules) -> Result<(PredicateId, &Predicate), RowError> {
        let Some(id) = rules.predicate(self) else {
            let declared = rules.predicates.iter().filter(|predicate| !predicate.hidden);
            let near = did_you_mean(self, declared.map(|predicate| predicate.name.as_str()));
            return Err(RowError::UnknownPredicate {
                predicate: self.to_owned(),
                near: near.map(str::to_owned),
            });
        };
        Ok((id, &rules.predicates[id.index()]))
    }
}

impl AsPredicate for &String {
    fn resolve(self, rules: &Rules) -> Result<(PredicateId, &Predicate), RowError> {
        self.as_str().resolve(rules)
    }
}

/// A Rust value for a column.
///
/// Whole numbers fit columns of type `number` and `unsigned`, floats those of type `float`, and strings those of type
/// `symbol`. A [`Value`] fits every column, since it is a word already.
pub trait ToValue {
    /// Returns the word of the value in a column, or `None` if it does not fit. `words` encodes numbers and strings.
    #[doc(hidden)]
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value>;

    /// Returns the text of a record.
    #[doc(hidden)]
    fn text(&self) -> Option<&str> {
        None
    }

    /// Describes the value for a message.
    #[doc(hidden)]
    fn describe(&self) -> String;

    /// Returns a row as it is, if it consists of words.
    #[doc(hidden)]
    #[inline]
    fn words(_row: &[Self]) -> Option<&[Value]>
    where
        Self: Sized,
    {
        None
    }
}

impl ToValue for Value {
    fn to_value(&self, _: BaseType, _: &WordEncoder<'_>) -> Option<Value> {
        Some(*self)
    }

    fn describe(&self) -> String {
        format!("the word {}", self.0)
    }

    #[inline]
    fn words(row: &[Value]) -> Option<&[Value]> {
        Some(row)
    }
}

macro_rules! whole_numbers {
    ($($number:ty),*) => {
        $(impl ToValue for $number {
            fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
                words.whole(base, *self as i128)
            }

            fn describe(&self) -> String {
                self.to_string()
            }
        })*
    };
}

whole_numbers!(i8, i16, i32, i64, isize, u8, u16, u32, u64, usize);

impl ToValue for f32 {
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
        f64::from(*self).to_value(base, words)
    }

    fn describe(&self) -> String {
        format!("the float {self:?}")
    }
}

impl ToValue for f64 {
    /// Rounds to the precision of the program.
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
        (base == BaseType::Float).then(|| words.float(*self))?
    }

    fn describe(&self) -> String {
        format!("the float {self:?}")
    }
}

impl ToValue for str {
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
        match base {
            BaseType::Symbol => words.symbol(self).map(|symbol| Value(symbol.0)),
            BaseType::Number | BaseType::Unsigned | BaseType::Float | BaseType::Record => None,
        }
    }

    fn text(&self) -> Option<&str> {
        Some(self)
    }

    fn describe(&self) -> String {
        format!("the symbol {self:?}")
    }
}

impl ToValue for String {
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
        self.as_str().to_value(base, words)
    }

    fn text(&self) -> Option<&str> {
        Some(self)
    }

    fn describe(&self) -> String {
        self.as_str().describe()
    }
}

impl<T: ToValue + ?Sized> ToValue for &T {
    fn to_value(&self, base: BaseType, words: &WordEncoder<'_>) -> Option<Value> {
        (**self).to_value(base, words)
    }

    fn text(&self) -> Option<&str> {
        (**self).text()
    }

    fn describe(&self) -> String {
        (**self).describe()
    }
}

/// A row to insert, to retract or to look up: a tuple of up to 12 values, or an array or slice of values of one type.
///
/// A row of [`Value`]s is used as it is, without a copy.
pub trait IntoRow {
    /// Returns the values of the row.
    #[doc(hidden)]
    fn values(&self) -> Vec<&dyn ToValue>;

    /// Returns the row if it consists of words.
    #[doc(hidden)]
    #[inline]
    fn words(&self) -> Option<&[Value]> {
        None
    }
}

macro_rules! rows_of_one_type {
    ($(($($generics:tt)*) $row:ty),*) => {
        $(impl<$($generics)*> IntoRow for $row {
            fn values(&self) -> Vec<&dyn ToValue> {
                self.iter().map(|value| value as &dyn ToValue).collect()
            }

            #[inline]
            fn words(&self) -> Option<&[Value]> {
                T::words(&self[..])
            }
        })*
    };
}

rows_of_one_type!((T: ToValue) [T], (T: ToValue) Vec<T>, (T: ToValue, const N: usize) [T; N]);

impl<R: IntoRow + ?Sized> IntoRow for &R {
    fn values(&self) -> Vec<&dyn ToValue> {
        (**self).values()
    }

    #[inline]
    fn words(&self) -> Option<&[Value]> {
        (**self).words()
    }
}

/// A value of a column as Rust has it.
///
/// `i64` reads columns of type `number` and `unsigned`, `i32` those of type `number`, `u32` those of type `unsigned`,
/// `f32` and `f64` those of type `float`, `&str` and `String` those of type `symbol`, and [`Value`] every column.
/// `String` reads records, too, as the text that `.facts` files have; one of more than 16 MiB ends in `...`.
pub trait FromValue<'s>: Sized {
    /// The types of columns that it reads, for a message.
    #[doc(hidden)]
    const NAME: &'static str;

    #[doc(hidden)]
    fn reads(base: BaseType, size: WordSize) -> bool;

    #[doc(hidden)]
    fn from_value(value: Value, base: BaseType, symbols: &'s Symbols) -> Self;
}

macro_rules! columns {
    ($($ty:ty: $name:literal, $pattern:pat, |$value:ident, $base:ident, $symbols:ident| $read:expr;)*) => {
        $(impl<'s> FromValue<'s> for $ty {
            const NAME: &'static str = $name;

            fn reads(base: BaseType, size: WordSize) -> bool {
                matches!((base, size), $pattern)
            }

            #[inline]
            fn from_value($value: Value, $base: BaseType, $symbols: &'s Symbols) -> Self {
                $read
            }
        })*
    };
}

columns! {
    Value: "any type", _, |value, _base, _symbols| value;
    i32: "type number", (BaseType::Number, WordSize::Bits32), |value, _base, _symbols| value.as_number();
    u32: "type unsigned", (BaseType::Unsigned, WordSize::Bits32), |value, _base, _symbols| value.0;
    i64: "type number or unsigned",
        (BaseType::Number, _) | (BaseType::Unsigned, WordSize::Bits32),
        |value, base, symbols| match base {
            BaseType::Unsigned => value.0.into(),
            _ => value.to_number(symbols),
        };
    u64: "type unsigned", (BaseType::Unsigned, _), |value, _base, symbols| value.to_unsigned(symbols);
    f32: "type float", (BaseType::Float, WordSize::Bits32), |value, _base, _symbols| value.as_float();
    f64: "type float", (BaseType::Float, _), |value, _base, symbols| value.to_float(symbols);
    &'s str: "type symbol", (BaseType::Symbol, _), |value, _base, symbols| symbols.resolve(Symbol(value.0)).unwrap_or_default();
    String: "type symbol or a record", (BaseType::Symbol | BaseType::Record, _), |value, base, symbols| match base {
        BaseType::Record => {
            let mut text = String::new();
            print_record(value, symbols, WHOLE, false, &mut text);
            text
        }
        _ => <&str>::from_value(value, base, symbols).to_owned(),
    };
}

/// A row as Rust has it: a tuple of up to 12 values, or an array or a `Vec` of values of one type.
pub trait FromRow<'s>: Sized {
    /// Checks that rows of the predicate can be read.
    #[doc(hidden)]
    fn check(predicate: &Predicate, size: WordSize) -> Result<(), RowError>;

    #[doc(hidden)]
    fn from_row(row: &'s [Value], columns: &[Column], symbols: &'s Symbols) -> Self;
}

impl<'s, T: FromValue<'s>> FromRow<'s> for Vec<T> {
    fn check(predicate: &Predicate, size: WordSize) -> Result<(), RowError> {
        (0..predicate.arity()).try_for_each(|column| check_column::<T>(predicate, column, size))
    }

    fn from_row(row: &'s [Value], columns: &[Column], symbols: &'s Symbols) -> Self {
        let values = row.iter().zip(columns);
        values
            .map(|(value, column)| T::from_value(*value, column.base, symbols))
            .collect()
    }
}

impl<'s, T: FromValue<'s>, const N: usize> FromRow<'s> for [T; N] {
    fn check(predicate: &Predicate, size: WordSize) -> Result<(), RowError> {
        check_arity(predicate, N)?;
        Vec::<T>::check(predicate, size)
    }

    fn from_row(row: &'s [Value], columns: &[Column], symbols: &'s Symbols) -> Self {
        std::array::from_fn(|at| T::from_value(row[at], columns[at].base, symbols))
    }
}

macro_rules! tuples {
    ($(($($name:ident $at:tt),*))*) => {
        $(
            impl<$($name: ToValue),*> IntoRow for ($($name,)*) {
                fn values(&self) -> Vec<&dyn ToValue> {
                    vec![$(&self.$at),*]
                }
            }

            impl<'s, $($name: FromValue<'s>),*> FromRow<'s> for ($($name,)*) {
                fn check(predicate: &Predicate, size: WordSize) -> Result<(), RowError> {
                    check_arity(predicate, [$(stringify!($name)),*].len())?;
                    $(check_column::<$name>(predicate, $at, size)?;)*
                    Ok(())
                }

                #[inline]
                fn from_row(row: &'s [Value], columns: &[Column], symbols: &'s Symbols) -> Self {
                    ($($name::from_value(row[$at], columns[$at].base, symbols),)*)
                }
            }
        )*
    };
}

tuples! {
    (A 0)
    (A 0, B 1)
    (A 0, B 1, C 2)
    (A 0, B 1, C 2, D 3)
    (A 0, B 1, C 2, D 3, E 4)
    (A 0, B 1, C 2, D 3, E 4, F 5)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7, I 8)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7, I 8, J 9)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7, I 8, J 9, K 10)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7, I 8, J 9, K 10, L 11)
}

/// The row of a predicate without columns.
impl IntoRow for () {
    fn values(&self) -> Vec<&dyn ToValue> {
        Vec::new()
    }

    #[inline]
    fn words(&self) -> Option<&[Value]> {
        Some(&[])
    }
}

impl<'s> FromRow<'s> for () {
    fn check(predicate: &Predicate, _: WordSize) -> Result<(), RowError> {
        check_arity(predicate, 0)
    }

    #[inline]
    fn from_row(_: &'s [Value], _: &[Column], _: &'s Symbols) -> Self {}
}

fn check_column<'s, T: FromValue<'s>>(predicate: &Predicate, column: usize, size: WordSize) -> Result<(), RowError> {
    let Column { name, base, .. } = &predicate.columns[column];
    match T::reads(*base, size) {
        true => Ok(()),
        false => Err(RowError::ColumnType {
            predicate: predicate.name.clone(),
            column: name.clone(),
            base: *base,
            expected: match size == WordSize::Bits64 && !base.is_interned() && T::reads(*base, WordSize::Bits32) {
                true if *base == BaseType::Number => "`i64`, since numbers have 64 bits",
                true if *base == BaseType::Unsigned => "`u64`, since numbers have 64 bits",
                true => "`f64`, since numbers have 64 bits",
                false => T::NAME,
            },
        }),
    }
}

fn check_arity(predicate: &Predicate, found: usize) -> Result<(), RowError> {
    match predicate.arity() == found {
        true => Ok(()),
        false => Err(RowError::Arity {
            predicate: predicate.name.clone(),
            expected: predicate.arity(),
            found,
        }),
    }
}

/// Checks that the words fit the predicate.
#[inline]
pub(crate) fn check_words(predicate: &Predicate, row: &[Value], symbols: &Symbols) -> Result<(), RowError> {
    check_arity(predicate, row.len())?;
    let known = symbols.len();
    let is_known = |(value, column): (&Value, &Column)| match column.base {
        BaseType::Symbol | BaseType::Record => (value.0 as usize) < known,
        BaseType::Number | BaseType::Unsigned | BaseType::Float => symbols.is_number(value.0),
    };
    match row.iter().zip(&predicate.columns).all(is_known) {
        true => Ok(()),
        false => Err(RowError::UnknownSymbol {
            predicate: predicate.name.clone(),
        }),
    }
}

/// Returns the word of a value; `None` if it does not fit the type.
pub(crate) fn word_of(
    value: &dyn ToValue,
    (ty, base): (TypeId, BaseType),
    types: &[Type],
    words: &WordEncoder<'_>,
) -> Option<Value> {
    match (base, value.text()) {
        (BaseType::Record, Some(text)) => read(text, ty, types, words).ok(),
        _ => value.to_value(base, words),
    }
}

/// Returns the words of a row; those of a row that does not consist of words are in `encoded`.
pub(crate) fn words_of<'r>(
    predicate: &Predicate,
    row: &'r impl IntoRow,
    types: &[Type],
    encoder: &WordEncoder<'_>,
    encoded: &'r mut Vec<Value>,
) -> Result<&'r [Value], RowError> {
    match row.words() {
        Some(words) => Ok(words),
        None => encode(predicate, row, types, encoder, encoded).map(|()| encoded.as_slice()),
    }
}

/// Adds the words of a row to `words`.
pub(crate) fn encode(
    predicate: &Predicate,
    row: &impl IntoRow,
    types: &[Type],
    encoder: &WordEncoder<'_>,
    words: &mut Vec<Value>,
) -> Result<(), RowError> {
    let values = row.values();
    check_arity(predicate, values.len())?;
    for (value, column) in values.into_iter().zip(&predicate.columns) {
        let word = word_of(value, (column.ty, column.base), types, encoder);
        let word = word.ok_or_else(|| RowError::ValueType {
            predicate: predicate.name.clone(),
            column: column.name.clone(),
            base: column.base,
            found: value.describe(),
        })?;
        words.push(word);
    }
    Ok(())
}

/// The reason why a session refuses a row, or a predicate as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RowError {
    /// The program has no such predicate.
    UnknownPredicate {
        /// Its name, or `#` and its id.
        predicate: String,
        /// A predicate with a similar name.
        near: Option<String>,
    },
    /// The predicate is derived: clauses with bodies define its rows, and it is no input.
    Derived {
        /// The predicate's name.
        predicate: String,
    },
    /// The row has the wrong number of values.
    Arity {
        /// The predicate's name.
        predicate: String,
        /// Its number of columns.
        expected: usize,
        /// The number of values in the row.
        found: usize,
    },
    /// A value in a symbol column is no symbol of the session; see [`Session::intern`](crate::Session::intern).
    UnknownSymbol {
        /// The predicate's name.
        predicate: String,
    },
    /// A probability is below 0, above 1 or not a number.
    Probability {
        /// The predicate's name.
        predicate: String,
        /// The number, as text.
        found: String,
    },
    /// A value does not fit its column.
    ValueType {
        /// The predicate's name.
        predicate: String,
        /// The name of the column.
        column: String,
        /// The base type of the column.
        base: BaseType,
        /// The value, in words.
        found: String,
    },
    /// A column cannot be read as the requested type of Rust.
    ColumnType {
        /// The predicate's name.
        predicate: String,
        /// The name of the column.
        column: String,
        /// The base type of the column.
        base: BaseType,
        /// The types of columns that can be read as the requested type.
        expected: &'static str,
    },
}

impl fmt::Display for RowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RowError::UnknownPredicate { predicate, near } => {
                write!(f, "the program declares no predicate `{predicate}`")?;
                match near {
                    Some(near) => write!(f, "; did you mean `{near}`?"),
                    None => Ok(()),
                }
            }
            RowError::Derived { predicate } => write!(f, "`{predicate}` is derived by rules; its rows cannot be set"),
            RowError::Arity {
                predicate,
                expected,
                found,
            } => write!(
                f,
                "a row of `{predicate}` has {}, not {found}",
                counted(*expected, "value")
            ),
            RowError::UnknownSymbol { predicate } => {
                write!(
                    f,
                    "a row of `{predicate}` has a symbol that the session has not interned"
                )
            }
            RowError::Probability { predicate, found } => write!(
                f,
                "the probability of a row of `{predicate}` is {found}; expected 0 to 1"
            ),
            RowError::ValueType {
                predicate,
                column,
                base,
                found,
            } => {
                let expected = match base {
                    BaseType::Symbol => "a symbol",
                    BaseType::Number => "a number in the range of the program",
                    BaseType::Unsigned => "an unsigned number in the range of the program",
                    BaseType::Float => "a float",
                    BaseType::Record => "the text of a record of its type",
                };
                write!(
                    f,
                    "the column `{column}` of `{predicate}` expects {expected}, not {found}"
                )
            }
            RowError::ColumnType {
                predicate,
                column,
                base,
                expected,
            } => write!(
                f,
                "the column `{column}` of `{predicate}` has type {}; expected {expected}",
                base.name()
            ),
        }
    }
}

impl std::error::Error for RowError {}
