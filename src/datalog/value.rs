//! Values, and the evaluation of functors on them.
//!
//! A functor application may have no value (`1 / 0`, `to_number("x")`); then the literal that contains it does not
//! hold. So an expression never fails, and the derived facts do not depend on the order of evaluation.
//!
//! Numbers have the [size](WordSize) of the table of symbols: `number` and `unsigned` wrap around on overflow, and `float`
//! has single precision in 32 bits, double precision in 64.

use std::borrow::Cow;
use std::cmp::Ordering;
use std::collections::HashMap;

use crate::chance;
use crate::record;
use crate::symbol::{Symbol, Symbols, WordEncoder, WordSize};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{Functor, Functor::*};
use crate::syntax::quoted;

/// One 32-bit word of a row.
///
/// The base type of the column determines the meaning: the id of a [`crate::symbol::Symbol`] for `symbol`, the bits of
/// an `i32` for `number`, a `u32` for `unsigned`, the bits of an `f32` for `float`. In programs with numbers of 64 bits,
/// [`WordSize`] describes the words of `number`, `unsigned` and `float`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Value(pub u32);

impl Value {
    /// Returns the word for a number.
    pub fn number(n: i32) -> Self {
        Value(n.cast_unsigned())
    }

    /// Returns the word as a number; meaningful in a column of base type `number`.
    pub fn as_number(self) -> i32 {
        self.0.cast_signed()
    }

    /// Returns the word for a float.
    ///
    /// Negative zero becomes zero, and every NaN becomes the same one, so floats are equal exactly if their words are.
    pub fn float(x: f32) -> Self {
        Value(if x.is_nan() { f32::NAN } else { x + 0.0 }.to_bits())
    }

    /// Returns the word as a float; meaningful in a column of base type `float`.
    pub fn as_float(self) -> f32 {
        f32::from_bits(self.0)
    }

    /// Returns the word for a number in a program with these symbols; `None` if it does not fit.
    pub fn of_number(number: i64, symbols: &Symbols) -> Option<Self> {
        symbols.encoder().whole(BaseType::Number, number.into())
    }

    /// Returns the word for an unsigned number in a program with these symbols; `None` if it does not fit.
    pub fn of_unsigned(number: u64, symbols: &Symbols) -> Option<Self> {
        symbols.encoder().whole(BaseType::Unsigned, number.into())
    }

    /// Returns the word for a float in a program with these symbols, rounded to its precision.
    pub fn of_float(x: f64, symbols: &Symbols) -> Self {
        symbols.encoder().float(x).expect("an encoder interns every string")
    }

    /// Returns the word as a number of a program with these symbols.
    pub fn to_number(self, symbols: &Symbols) -> i64 {
        match symbols.word_size() {
            WordSize::Bits32 => self.as_number().into(),
            WordSize::Bits64 => symbols.bits(self.0).cast_signed(),
        }
    }

    /// Returns the word as an unsigned number of a program with these symbols.
    pub fn to_unsigned(self, symbols: &Symbols) -> u64 {
        match symbols.word_size() {
            WordSize::Bits32 => self.0.into(),
            WordSize::Bits64 => symbols.bits(self.0),
        }
    }

    /// Returns the word as a float of a program with these symbols.
    pub fn to_float(self, symbols: &Symbols) -> f64 {
        match symbols.word_size() {
            WordSize::Bits32 => self.as_float().into(),
            WordSize::Bits64 => f64::from_bits(symbols.bits(self.0)),
        }
    }
}

impl WordEncoder<'_> {
    /// Returns the word of a whole number in a column of this base type; `None` if it does not fit.
    pub fn whole(&self, base: BaseType, number: i128) -> Option<Value> {
        match (base, self.size()) {
            (BaseType::Number, WordSize::Bits32) => i32::try_from(number).ok().map(Value::number),
            (BaseType::Unsigned, WordSize::Bits32) => u32::try_from(number).ok().map(Value),
            (BaseType::Number, WordSize::Bits64) => {
                let number = i64::try_from(number).ok()?;
                self.bits(number.cast_unsigned()).map(Value)
            }
            (BaseType::Unsigned, WordSize::Bits64) => {
                u64::try_from(number).ok().and_then(|bits| self.bits(bits)).map(Value)
            }
            _ => None,
        }
    }

    /// Returns the word of a float, rounded to the precision.
    #[allow(clippy::cast_possible_truncation)]
    pub fn float(&self, x: f64) -> Option<Value> {
        match self.size() {
            WordSize::Bits32 => Some(Value::float(x as f32)),
            WordSize::Bits64 => self.bits(canonical(x).to_bits()).map(Value),
        }
    }

    /// Returns the word of the number with this text; `None` if the text does not fit the type.
    pub fn parse(&self, base: BaseType, text: &str) -> Option<Value> {
        match (self.size(), base) {
            (WordSize::Bits32, _) => parse(base, text),
            (_, BaseType::Float) => self.float(text.parse().ok()?),
            (_, BaseType::Symbol | BaseType::Record) => None,
            _ => match in_radix(text) {
                Some(number) => self.whole(base, number),
                None => {
                    let digits = match base {
                        BaseType::Unsigned => text.strip_suffix('u').unwrap_or(text),
                        _ => text,
                    };
                    self.whole(base, digits.parse().ok()?)
                }
            },
        }
    }
}

/// Returns the float with one zero and one NaN.
fn canonical(x: f64) -> f64 {
    if x.is_nan() { f64::NAN } else { x + 0.0 }
}

impl Functor {
    /// Returns the maximum length in bytes of the symbol that [`Functor::apply`] creates; 0 if it creates none.
    pub(crate) fn symbol_length(self, base: BaseType, arguments: &[Value], symbols: &Symbols) -> u64 {
        /// The longest symbol of a number.
        const NUMBER: u64 = 400;
        let length = |value: &Value| symbols.resolve(Symbol(value.0)).map_or(0, str::len) as u64;
        match (self, arguments) {
            (Cat, parts) => parts.iter().map(length).sum(),
            (Add, parts) if base == BaseType::Symbol => parts.iter().map(length).sum(),
            (Substring, [value, ..]) => length(value),
            (ToSymbol, _) => NUMBER,
            (Pack, parts) => record::bytes(parts.len()),
            _ if symbols.word_size() == WordSize::Bits64 => BITS_LENGTH,
            _ => 0,
        }
    }

    /// Applies the functor; `None` if it has no value.
    ///
    /// `base` is the base type of the arguments; where they differ, that of the first.
    pub fn apply(self, base: BaseType, arguments: &[Value], symbols: &Symbols) -> Option<Value> {
        let text = |value: &Value| symbols.resolve(Symbol(value.0)).unwrap_or_default();
        let made = |text: &str| Some(Value(symbols.intern(text).0));
        match (self, arguments) {
            (Choose, _) => return choose(arguments, symbols),
            // `Rules::call` does it, and the evaluation of a stratum.
            (Call | Counter, _) => return None,
            (Cast, [value]) => return Some(*value),
            (Pack, [shape, fields @ ..]) => return made(&record::encoded(shape.0, fields.iter().map(|field| field.0))),
            (Find, [shape, fields @ ..]) => {
                let text = record::encoded(shape.0, fields.iter().map(|field| field.0));
                return symbols.get(&text).map(|found| Value(found.0));
            }
            (Unpack, [shape, at, whole]) => return record::field(shape.0, at.0, whole.0, symbols).map(Value),
            (Ordinal, [value]) => return Value::of_unsigned(value.0.into(), symbols),
            (Add, parts) if base == BaseType::Symbol => return made(&parts.iter().map(text).collect::<String>()),
            (Cat, parts) => return made(&parts.iter().map(text).collect::<String>()),
            (Length, [value]) => {
                return Value::of_number(text(value).chars().count() as i64, symbols);
            }
            (Substring, [value, from, length]) => {
                let (from, length) = (from.to_number(symbols), length.to_number(symbols));
                let Ok(from) = usize::try_from(from) else {
                    return made("");
                };
                // As in Soufflé, a negative length means the rest of the symbol.
                let length = usize::try_from(length).unwrap_or(usize::MAX);
                return made(&text(value).chars().skip(from).take(length).collect::<String>());
            }
            (ToSymbol, [value]) => {
                return match base {
                    BaseType::Symbol => Some(*value),
                    BaseType::Number => made(&value.to_number(symbols).to_string()),
                    BaseType::Unsigned => made(&value.to_unsigned(symbols).to_string()),
                    BaseType::Float => made(&format!("{:.6}", value.to_float(symbols))),
                    BaseType::Record => None,
                };
            }
            (ToNumber | ToFloat | ToUnsigned, [value]) => return self.convert(base, *value, symbols),
            _ => {}
        }
        if symbols.word_size() == WordSize::Bits64 && !matches!(base, BaseType::Symbol | BaseType::Record) {
            return self.apply_64(base, arguments, symbols);
        }
        match base {
            BaseType::Symbol => {
                let texts = arguments.iter();
                match self {
                    Min => texts.min_by_key(|value| text(value)).copied(),
                    Max => texts.max_by_key(|value| text(value)).copied(),
                    _ => None,
                }
            }
            BaseType::Number => {
                fold(arguments, |value| value.as_number(), |operands| self.numbers(operands)).map(Value::number)
            }
            BaseType::Unsigned => fold(arguments, |value| value.0, |operands| self.unsigned(operands)).map(Value),
            BaseType::Float => {
                fold(arguments, |value| value.as_float(), |operands| self.floats(operands)).map(Value::float)
            }
            BaseType::Record => None,
        }
    }

    /// Applies an operation to numbers of 64 bits.
    fn apply_64(self, base: BaseType, arguments: &[Value], symbols: &Symbols) -> Option<Value> {
        match base {
            BaseType::Number => {
                let found = fold(arguments, |value| value.to_number(symbols), |all| self.numbers_64(all))?;
                Value::of_number(found, symbols)
            }
            BaseType::Unsigned => {
                let found = fold(
                    arguments,
                    |value| value.to_unsigned(symbols),
                    |all| self.unsigned_64(all),
                )?;
                Value::of_unsigned(found, symbols)
            }
            _ => {
                let found = fold(arguments, |value| value.to_float(symbols), |all| self.floats_64(all))?;
                Some(Value::of_float(found, symbols))
            }
        }
    }

    fn convert(self, base: BaseType, value: Value, symbols: &Symbols) -> Option<Value> {
        let text = || {
            symbols
                .resolve(Symbol(value.0))
                .unwrap_or_default()
                .trim_matches(is_space)
        };
        let long = symbols.word_size() == WordSize::Bits64;
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_precision_loss,
            clippy::cast_sign_loss
        )]
        Some(match (self, base) {
            (ToNumber, BaseType::Number) | (ToUnsigned, BaseType::Unsigned) | (ToFloat, BaseType::Float) => value,
            (ToNumber, BaseType::Unsigned) | (ToUnsigned, BaseType::Number) => value,
            (ToNumber, BaseType::Float) if long => Value::of_number(value.to_float(symbols) as i64, symbols)?,
            (ToUnsigned, BaseType::Float) if long => Value::of_unsigned(value.to_float(symbols) as u64, symbols)?,
            (ToNumber, BaseType::Float) => Value::number(value.as_float() as i32),
            (ToUnsigned, BaseType::Float) => Value(value.as_float() as u32),
            // Rounding twice, to double and then to single precision, gives the same: an `f64` holds each `i32`.
            (ToFloat, BaseType::Number) => Value::of_float(value.to_number(symbols) as f64, symbols),
            (ToFloat, BaseType::Unsigned) => Value::of_float(value.to_unsigned(symbols) as f64, symbols),
            (ToNumber, BaseType::Symbol) => parse_in(BaseType::Number, text(), symbols)?,
            (ToUnsigned, BaseType::Symbol) => parse_in(BaseType::Unsigned, text(), symbols)?,
            (ToFloat, BaseType::Symbol) => parse_in(BaseType::Float, text(), symbols)?,
            _ => return None,
        })
    }
}

/// Implements the operations on signed, unsigned and floating-point numbers of one size.
macro_rules! operations {
    ($signed:ident: $int:ty, $unsigned:ident: $uint:ty, $floating:ident: $float:ty) => {
        impl Functor {
            fn $signed(self, operands: &[$int]) -> Option<$int> {
                Some(match (self, operands) {
                    (Negate, &[a]) => a.wrapping_neg(),
                    (BitNot, &[a]) => !a,
                    (Not, &[a]) => <$int>::from(a == 0),
                    (Add, &[a, b]) => a.wrapping_add(b),
                    (Subtract, &[a, b]) => a.wrapping_sub(b),
                    (Multiply, &[a, b]) => a.wrapping_mul(b),
                    (Divide, &[a, b]) => (b != 0).then(|| a.wrapping_div(b))?,
                    (Remainder, &[a, b]) => (b != 0).then(|| a.wrapping_rem(b))?,
                    (Power, &[a, b]) => match (a, <$uint>::try_from(b)) {
                        (a, Ok(exponent)) => Power.$unsigned(&[a.cast_unsigned(), exponent])?.cast_signed(),
                        (1, _) => 1,
                        (-1, _) => 1 - 2 * (b & 1),
                        // A negative power of zero divides by zero.
                        (0, _) => return None,
                        _ => 0,
                    },
                    (BitAnd, &[a, b]) => a & b,
                    (BitOr, &[a, b]) => a | b,
                    (BitXor, &[a, b]) => a ^ b,
                    (ShiftLeft, &[a, b]) => a.wrapping_shl(b as u32),
                    (ShiftRight, &[a, b]) => a.wrapping_shr(b as u32),
                    (ShiftRightUnsigned, &[a, b]) => a.cast_unsigned().wrapping_shr(b as u32).cast_signed(),
                    (And, &[a, b]) => <$int>::from(a != 0 && b != 0),
                    (Or, &[a, b]) => <$int>::from(a != 0 || b != 0),
                    (Xor, &[a, b]) => <$int>::from((a != 0) != (b != 0)),
                    (Min, all) => all.iter().copied().min()?,
                    (Max, all) => all.iter().copied().max()?,
                    _ => return None,
                })
            }

            fn $unsigned(self, operands: &[$uint]) -> Option<$uint> {
                Some(match (self, operands) {
                    (BitNot, &[a]) => !a,
                    (Not, &[a]) => <$uint>::from(a == 0),
                    (Add, &[a, b]) => a.wrapping_add(b),
                    (Subtract, &[a, b]) => a.wrapping_sub(b),
                    (Multiply, &[a, b]) => a.wrapping_mul(b),
                    (Divide, &[a, b]) => a.checked_div(b)?,
                    (Remainder, &[a, b]) => a.checked_rem(b)?,
                    (Power, &[a, b]) => {
                        let (mut power, mut square, mut exponent): ($uint, $uint, $uint) = (1, a, b);
                        while exponent > 0 {
                            if exponent & 1 == 1 {
                                power = power.wrapping_mul(square);
                            }
                            square = square.wrapping_mul(square);
                            exponent >>= 1;
                        }
                        power
                    }
                    (BitAnd, &[a, b]) => a & b,
                    (BitOr, &[a, b]) => a | b,
                    (BitXor, &[a, b]) => a ^ b,
                    (ShiftLeft, &[a, b]) => a.wrapping_shl(b as u32),
                    (ShiftRight | ShiftRightUnsigned, &[a, b]) => a.wrapping_shr(b as u32),
                    (And, &[a, b]) => <$uint>::from(a != 0 && b != 0),
                    (Or, &[a, b]) => <$uint>::from(a != 0 || b != 0),
                    (Xor, &[a, b]) => <$uint>::from((a != 0) != (b != 0)),
                    (Min, all) => all.iter().copied().min()?,
                    (Max, all) => all.iter().copied().max()?,
                    _ => return None,
                })
            }

            fn $floating(self, operands: &[$float]) -> Option<$float> {
                Some(match (self, operands) {
                    (Negate, &[a]) => -a,
                    (Add, &[a, b]) => a + b,
                    (Subtract, &[a, b]) => a - b,
                    (Multiply, &[a, b]) => a * b,
                    (Divide, &[a, b]) => a / b,
                    (Power, &[a, b]) => a.powf(b),
                    (Min, all) => all.iter().copied().reduce(<$float>::min)?,
                    (Max, all) => all.iter().copied().reduce(<$float>::max)?,
                    _ => return None,
                })
            }
        }
    };
}

operations!(numbers: i32, unsigned: u32, floats: f32);
operations!(numbers_64: i64, unsigned_64: u64, floats_64: f64);

/// Returns the alternative that a draw chooses; [`chance`] describes the arguments.
fn choose(arguments: &[Value], symbols: &Symbols) -> Option<Value> {
    let &[high, low, stream_high, stream_low, alternatives, kinds, ref rest @ ..] = arguments else {
        return None;
    };
    let (probabilities, values) = rest.split_at_checked(alternatives.0 as usize)?;
    let begun = chance::Draw::new(
        chance::joined(high.0, low.0),
        chance::joined(stream_high.0, stream_low.0),
    );
    let draw = values
        .iter()
        .enumerate()
        .fold(begun, |draw, (at, value)| match kinds.0 >> at & 1 {
            1 => draw.symbol(symbol_hash(*value, symbols)),
            _ => draw.value(value.0),
        });
    let chosen = chance::alternative(draw.number(), probabilities.iter().map(|value| value.as_float()))?;
    u32::try_from(chosen).ok().map(Value)
}

/// Returns the hash of the symbol or record with this word, which draws use in place of its id.
pub(crate) fn symbol_hash(value: Value, symbols: &Symbols) -> u64 {
    let text = symbols.resolve(Symbol(value.0)).unwrap_or_default();
    if !record::is(text) {
        return chance::hash(text);
    }
    let mut text = String::new();
    print_record(value, symbols, WHOLE, true, &mut text);
    chance::hash(&text)
}

/// Orders values: numbers by value, symbols by text, records by their fields.
pub(crate) fn compare(base: BaseType, a: Value, b: Value, symbols: &Symbols) -> Ordering {
    let text = |value: Value| symbols.resolve(Symbol(value.0)).unwrap_or_default();
    match base {
        BaseType::Symbol if a == b => Ordering::Equal,
        BaseType::Symbol => text(a).cmp(text(b)),
        BaseType::Number => a.to_number(symbols).cmp(&b.to_number(symbols)),
        BaseType::Unsigned => a.to_unsigned(symbols).cmp(&b.to_unsigned(symbols)),
        BaseType::Float => a.to_float(symbols).total_cmp(&b.to_float(symbols)),
        BaseType::Record => record::compare(a.0, b.0, symbols, |kind, a, b| {
            compare(BaseType::of_kind(kind), Value(a), Value(b), symbols)
        }),
    }
}

/// The maximum length in bytes of the string of an interned number.
const BITS_LENGTH: u64 = 24;

/// The maximum length of a record or another text of a file in a message, in bytes.
pub(crate) const MESSAGE: usize = 1000;

/// Returns a text as messages show it: at most 1000 bytes, and `...` for the rest.
pub fn shortened(text: &str) -> Cow<'_, str> {
    match text.len() > MESSAGE {
        true => format!("{}...", &text[..text.floor_char_boundary(MESSAGE)]).into(),
        false => text.into(),
    }
}

/// The maximum length of a record in a file, in bytes.
pub(crate) const WHOLE: usize = 1 << 24;

/// Returns the whole text of a record as files of rows show it, or `None` if it is longer than 16 MiB.
pub fn whole_record(value: Value, symbols: &Symbols) -> Option<String> {
    let mut text = String::new();
    print_record(value, symbols, WHOLE, false, &mut text).then_some(text)
}

/// Adds the text of a record to `out`, and returns whether it is complete: a text longer than `limit` bytes ends in
/// `...`. Symbols stand as in rules with `source`, otherwise as in a rows file.
pub(crate) fn print_record(value: Value, symbols: &Symbols, limit: usize, source: bool, out: &mut String) -> bool {
    record::print(value.0, symbols, limit, out, |kind, word, out| {
        let value = Value(word);
        match BaseType::of_kind(kind) {
            base @ (BaseType::Number | BaseType::Unsigned | BaseType::Float) => {
                out.push_str(&number_text(base, value, symbols));
            }
            BaseType::Symbol | BaseType::Record => {
                let text = symbols.resolve(Symbol(word)).unwrap_or_default();
                let special = |c: char| matches!(c, ',' | '[' | ']' | '(' | ')' | '"') || c.is_control();
                if source {
                    out.push_str(&quoted(text));
                } else if text.trim() != text || text.contains(special) {
                    out.push('"');
                    out.push_str(&text.replace('"', "\"\""));
                    out.push('"');
                } else {
                    out.push_str(text);
                }
            }
        }
    })
}

/// Returns a record as rules write it.
pub fn record_source(value: Value, symbols: &Symbols) -> String {
    let mut text = String::new();
    print_record(value, symbols, WHOLE, true, &mut text);
    text
}

/// Returns the branch of a record and its fields with their types; `None` for `nil`.
pub fn record_fields(value: Value, symbols: &Symbols) -> Option<record::Fields<'_, BaseType, Value>> {
    let (branch, fields) = record::fields(value.0, symbols)?;
    let typed = fields.into_iter();
    Some((
        branch,
        typed
            .map(|(kind, word)| (BaseType::of_kind(kind), Value(word)))
            .collect(),
    ))
}

/// The symbol of `nil`.
pub const NIL: &str = record::NIL;

/// Returns a record as messages show it.
pub(crate) fn record_text(value: Value, symbols: &Symbols) -> String {
    let mut text = String::new();
    print_record(value, symbols, MESSAGE, true, &mut text);
    text
}

/// Returns whether a character is white space to Soufflé.
fn is_space(c: char) -> bool {
    c.is_ascii_whitespace() || c == '\u{b}'
}

/// Reads the arguments and applies the operation. The cases of one and two operands allocate nothing.
fn fold<T: Copy + Default>(
    arguments: &[Value],
    read: impl Fn(&Value) -> T,
    apply: impl Fn(&[T]) -> Option<T>,
) -> Option<T> {
    match arguments {
        [a] => apply(&[read(a)]),
        [a, b] => apply(&[read(a), read(b)]),
        many => apply(&many.iter().map(read).collect::<Vec<T>>()),
    }
}

/// Returns a number, unsigned number or float as files of rows show it.
pub(crate) fn number_text(base: BaseType, value: Value, symbols: &Symbols) -> String {
    match (base, symbols.word_size()) {
        (BaseType::Number, _) => value.to_number(symbols).to_string(),
        (BaseType::Float, WordSize::Bits32) => print_float(value.as_float()),
        (BaseType::Float, WordSize::Bits64) => print_double(value.to_float(symbols), 17),
        _ => value.to_unsigned(symbols).to_string(),
    }
}

/// Returns a number, unsigned number or float as messages and proofs show it: a float as the shortest text that reads
/// back.
pub fn shown_number(base: BaseType, value: Value, symbols: &Symbols) -> String {
    match (base, symbols.word_size()) {
        (BaseType::Float, WordSize::Bits32) => shortest_float(value.as_float()),
        (BaseType::Float, WordSize::Bits64) => {
            let double = value.to_float(symbols);
            print_double(double, digits(&format!("{double:e}")))
        }
        _ => number_text(base, value, symbols),
    }
}

/// Parses a number, unsigned number or float of a program with these symbols; `None` if the text does not fit the type.
pub fn parse_in(base: BaseType, text: &str, symbols: &Symbols) -> Option<Value> {
    symbols.encoder().parse(base, text)
}

/// Parses a hexadecimal (`0x`) or binary (`0b`) number of up to 64 bits.
fn in_radix(text: &str) -> Option<i128> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text),
    };
    let (digits, radix) = match digits.get(..2) {
        Some("0x") => (&digits[2..], 16),
        Some("0b") => (&digits[2..], 2),
        _ => return None,
    };
    if digits.starts_with(['+', '-']) {
        return None;
    }
    u64::from_str_radix(digits, radix)
        .ok()
        .map(|value| sign * i128::from(value))
}

/// Parses a number, unsigned number or float of 32 bits; `None` if the text does not fit the type.
///
/// Whole numbers may be decimal, hexadecimal (`0x`) or binary (`0b`). Symbols and records always give `None`.
pub fn parse(base: BaseType, text: &str) -> Option<Value> {
    match base {
        BaseType::Symbol | BaseType::Record => None,
        BaseType::Number => match in_radix(text) {
            Some(value) => i32::try_from(value).ok().map(Value::number),
            None => text.parse().ok().map(Value::number),
        },
        BaseType::Unsigned => match in_radix(text) {
            Some(value) => u32::try_from(value).ok().map(Value),
            None => text.strip_suffix('u').unwrap_or(text).parse().ok().map(Value),
        },
        BaseType::Float => text.parse().ok().map(Value::float),
    }
}

impl Comparison {
    /// Returns whether the comparison holds of values in this order. Those of text hold in none.
    pub fn accepts(self, order: Ordering) -> bool {
        match self {
            Comparison::Equal => order.is_eq(),
            Comparison::NotEqual => order.is_ne(),
            Comparison::Less => order.is_lt(),
            Comparison::LessEqual => order.is_le(),
            Comparison::Greater => order.is_gt(),
            Comparison::GreaterEqual => order.is_ge(),
            Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => false,
        }
    }

    /// Returns whether the comparison holds. Numbers compare by value; symbols are equal by id and ordered by text.
    /// `matches` returns whether the pattern `left` matches `right`.
    pub(crate) fn holds(
        self,
        base: BaseType,
        left: Value,
        right: Value,
        symbols: &Symbols,
        matches: impl FnOnce() -> bool,
    ) -> bool {
        let text = |value: Value| symbols.resolve(Symbol(value.0)).unwrap_or_default();
        // A NaN is neither less nor greater than any float.
        let order = || match base {
            BaseType::Number => Some(left.to_number(symbols).cmp(&right.to_number(symbols))),
            BaseType::Symbol if left == right => Some(Ordering::Equal),
            BaseType::Symbol => Some(text(left).cmp(text(right))),
            // Only the equality of records is in the language.
            BaseType::Record => Some(left.cmp(&right)),
            BaseType::Unsigned => Some(left.to_unsigned(symbols).cmp(&right.to_unsigned(symbols))),
            BaseType::Float => left.to_float(symbols).partial_cmp(&right.to_float(symbols)),
        };
        match self {
            Comparison::Equal => left == right,
            Comparison::NotEqual => left != right,
            Comparison::Less | Comparison::LessEqual | Comparison::Greater | Comparison::GreaterEqual => {
                order().is_some_and(|order| self.accepts(order))
            }
            Comparison::Contains => text(right).contains(text(left)),
            Comparison::NotContains => !text(right).contains(text(left)),
            Comparison::Match => matches(),
            Comparison::NotMatch => !matches(),
        }
    }
}

/// Cache of compiled regular expressions, by pattern symbol. An invalid pattern that is not a constant of the rules
/// matches nothing; the checker reports constants.
#[derive(Debug, Default)]
pub struct Patterns(HashMap<Value, Option<regex::Regex>>);

impl Patterns {
    /// Variant of [`matches`](Patterns::matches) without a cache.
    pub(crate) fn match_once(pattern: Value, text: Value, symbols: &Symbols) -> bool {
        let text = symbols.resolve(Symbol(text.0)).unwrap_or_default();
        Patterns::default().matches(pattern, text, symbols)
    }

    /// Returns whether the whole of `text` matches `pattern`.
    pub fn matches(&mut self, pattern: Value, text: &str, symbols: &Symbols) -> bool {
        let compiled = self.0.entry(pattern).or_insert_with(|| {
            let pattern = symbols.resolve(Symbol(pattern.0)).unwrap_or_default();
            Patterns::compile(pattern).ok()
        });
        compiled.as_ref().is_some_and(|compiled| compiled.is_match(text))
    }

    /// Compiles a pattern that matches whole texts.
    ///
    /// # Errors
    /// Why the pattern is invalid, in one line.
    pub fn compile(pattern: &str) -> Result<regex::Regex, String> {
        let build = |pattern: &str| regex::RegexBuilder::new(pattern).size_limit(1 << 20).build();
        // Errors name the pattern as the user wrote it. `^(?:a)(b)$` is valid for the invalid pattern `a)(b`.
        build(pattern)
            .and_then(|_| build(&format!("^(?:{pattern})$")))
            .map_err(|error| match error {
                regex::Error::CompiledTooBig(limit) => format!("compiled, it needs more than {} KiB", limit >> 10),
                // The message draws the pattern; its last line names the fault.
                error => {
                    let text = error.to_string();
                    let last = text.lines().next_back().unwrap_or_default();
                    last.strip_prefix("error: ").unwrap_or(last).to_owned()
                }
            })
    }
}

/// Returns a float as text: nine significant digits without trailing zeros, which suffice to read back the same float.
///
/// Very small and very large numbers have an exponent.
pub fn print_float(x: f32) -> String {
    print_double(x.into(), 9)
}

/// Returns a float as the shortest text that reads back as the same float, for readers: `0.45`, where [`print_float`]
/// returns `0.449999988`.
pub fn shortest_float(x: f32) -> String {
    print_double(x.into(), digits(&format!("{x:e}")))
}

/// Returns the number of significant digits of a float in scientific notation.
fn digits(scientific: &str) -> usize {
    let mantissa = scientific.split('e').next().unwrap_or_default();
    mantissa.bytes().filter(u8::is_ascii_digit).count().max(1)
}

/// Returns a float as text with so many significant digits, at least 1, without trailing zeros.
fn print_double(x: f64, digits: usize) -> String {
    if !x.is_finite() {
        return if x.is_nan() {
            "nan"
        } else if x > 0.0 {
            "inf"
        } else {
            "-inf"
        }
        .to_owned();
    }
    let scientific = format!("{:.*e}", digits - 1, x);
    let Some((mantissa, exponent)) = scientific.split_once('e') else {
        return scientific;
    };
    let exponent: i32 = exponent.parse().unwrap_or_default();
    let trim = |digits: &str| match digits.contains('.') {
        true => digits.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => digits.to_owned(),
    };
    // C++ writes an exponent below 1e-4, and above what the digits hold.
    if (-4..digits.max(9) as i32).contains(&exponent) {
        let decimals = usize::try_from(digits as i32 - 1 - exponent).unwrap_or_default();
        trim(&format!("{x:.decimals$}"))
    } else {
        let sign = if exponent < 0 { '-' } else { '+' };
        format!("{}e{sign}{:02}", trim(mantissa), exponent.abs())
    }
}
