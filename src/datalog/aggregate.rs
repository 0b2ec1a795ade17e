//! Evaluation of aggregates, over all values at once or in parts.
//!
//! With numbers of 64 bits, sums and means read all values at once. Everything else is a [`Partial`].
//!
//! A [`Partial`] takes one value at a time and keeps no values, so an aggregate over many rows needs constant memory.
//! Parts of the values can be aggregated apart, for example on several threads, and merged. Neither the order of the
//! values nor the division into parts has an effect, not even for floats: [`ExactSum`] adds without rounding.

use crate::symbol::{Symbols, WordSize};
use crate::syntax::ast::BaseType;
use crate::syntax::functor::AggregateOp;
use crate::value::{self, Value};

/// The aggregate of the values added so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Partial {
    count: u64,
    /// The sum, minimum or maximum; not used for a mean or a sum of floats.
    word: Value,
    /// The sum of floats, or the sum for a mean.
    total: Option<Box<ExactSum>>,
}

impl AggregateOp {
    /// Returns the aggregate of `values`; `None` if it has none, such as the minimum of no values.
    ///
    /// `base` is the base type of the values. [`AggregateOp::Count`] accepts values of any type. The order of the
    /// values has no effect, not even for floats.
    pub fn of(self, base: BaseType, values: impl Iterator<Item = Value>, symbols: &Symbols) -> Option<Value> {
        if symbols.word_size() == WordSize::Bits64 && matches!(self, AggregateOp::Sum | AggregateOp::Mean) {
            return self.sum_or_mean_64(base, values, symbols);
        }
        let mut partial = Partial::default();
        match self {
            AggregateOp::Count => partial.count = values.count() as u64,
            _ => values.for_each(|value| partial.add(self, base, value, symbols)),
        }
        partial.finish(self, base)
    }
}

impl AggregateOp {
    /// Returns the sum or the mean of numbers of 64 bits. Floats are added from the least to the greatest.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        clippy::cast_sign_loss
    )]
    fn sum_or_mean_64(self, base: BaseType, values: impl Iterator<Item = Value>, symbols: &Symbols) -> Option<Value> {
        if base == BaseType::Float {
            let mut all: Vec<f64> = values.map(|value| value.to_float(symbols)).collect();
            all.sort_unstable_by(f64::total_cmp);
            let sum: f64 = all.iter().sum();
            return match self {
                AggregateOp::Mean => (!all.is_empty()).then(|| Value::of_float(sum / all.len() as f64, symbols)),
                _ => Some(Value::of_float(sum, symbols)),
            };
        }
        let (mut count, mut sum) = (0_u64, 0_i128);
        for value in values {
            count += 1;
            sum += match base {
                BaseType::Unsigned => value.to_unsigned(symbols).into(),
                _ => i128::from(value.to_number(symbols)),
            };
        }
        match self {
            AggregateOp::Mean => (count > 0).then(|| Value::of_float(sum as f64 / count as f64, symbols)),
            // The sum wraps around.
            _ => Some(Value(symbols.intern_bits(sum as u64))),
        }
    }
}

impl Partial {
    /// Adds a value. All calls must pass the same `op` and `base`.
    #[inline]
    pub(crate) fn add(&mut self, op: AggregateOp, base: BaseType, value: Value, symbols: &Symbols) {
        self.count += 1;
        match (op, base) {
            (AggregateOp::Count, _) => {}
            (AggregateOp::Sum, BaseType::Float) | (AggregateOp::Mean, _) => {
                self.total.get_or_insert_default().add(base, value);
            }
            // Wrapping addition is the same for signed and unsigned words.
            (AggregateOp::Sum, _) => self.word.0 = self.word.0.wrapping_add(value.0),
            (AggregateOp::Min | AggregateOp::Max, _) => {
                if self.count == 1 || beats(op, base, value, self.word, symbols) {
                    self.word = value;
                }
            }
        }
    }

    /// Counts `times` values that need not be known; for [`AggregateOp::Count`] only.
    #[inline]
    pub(crate) fn count(&mut self, times: u64) {
        self.count += times;
    }

    /// Adds the values of another part.
    pub(crate) fn merge(&mut self, other: Partial, op: AggregateOp, base: BaseType, symbols: &Symbols) {
        if other.count == 0 {
            return;
        }
        match op {
            AggregateOp::Min | AggregateOp::Max => {
                if self.count == 0 || beats(op, base, other.word, self.word, symbols) {
                    self.word = other.word;
                }
            }
            _ => self.word.0 = self.word.0.wrapping_add(other.word.0),
        }
        self.count += other.count;
        match (&mut self.total, other.total) {
            (Some(total), Some(other)) => total.merge(&other),
            (total @ None, other) => *total = other,
            (Some(_), None) => {}
        }
    }

    /// Returns the aggregate, or `None` if it has no value.
    pub(crate) fn finish(&self, op: AggregateOp, base: BaseType) -> Option<Value> {
        let total = || self.total.as_ref().map_or(0.0, |total| total.value());
        match (op, base) {
            (AggregateOp::Count, _) => i32::try_from(self.count).ok().map(Value::number),
            (AggregateOp::Sum, BaseType::Float) => Some(Value::float(narrow(total()))),
            (AggregateOp::Sum, _) => Some(self.word),
            (AggregateOp::Mean, _) => {
                let count = u32::try_from(self.count).ok().filter(|&count| count > 0)?;
                Some(Value::float(narrow(total() / f64::from(count))))
            }
            (AggregateOp::Min | AggregateOp::Max, _) => (self.count > 0).then_some(self.word),
        }
    }
}

/// Whether a minimum or maximum prefers the first value to the second.
fn beats(op: AggregateOp, base: BaseType, a: Value, b: Value, symbols: &Symbols) -> bool {
    let order = value::compare(base, a, b, symbols);
    match op {
        AggregateOp::Max => order.is_gt(),
        _ => order.is_lt(),
    }
}

#[allow(clippy::cast_possible_truncation)]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// A sum of 32-bit values without rounding: a fixed-point number in units of 2^-149, the least positive `f32`.
#[derive(Clone, Debug, Default)]
struct ExactSum {
    /// Two's complement, least significant word first. A value has 277 bits, so 2^64 of them cannot overflow.
    words: [u64; 6],
    /// The sum of the infinities and NaNs among the values; 0 if there are none.
    special: f64,
}

impl ExactSum {
    /// The binary exponent of the least positive `f32`.
    const UNIT: u32 = 149;

    fn add(&mut self, base: BaseType, value: Value) {
        let (magnitude, shift, negative) = match base {
            BaseType::Float if !value.as_float().is_finite() => {
                self.special += f64::from(value.as_float());
                return;
            }
            BaseType::Float => {
                let (exponent, fraction) = (value.0 >> 23 & 0xff, value.0 & 0x7f_ffff);
                let magnitude = if exponent == 0 { fraction } else { fraction | 1 << 23 };
                (
                    magnitude,
                    exponent.saturating_sub(1),
                    value.as_float().is_sign_negative(),
                )
            }
            BaseType::Unsigned => (value.0, Self::UNIT, false),
            _ => (value.as_number().unsigned_abs(), Self::UNIT, value.as_number() < 0),
        };
        let wide = u128::from(magnitude) << (shift % 64);
        let mut addend = [0; 6];
        let low = (shift / 64) as usize;
        (addend[low], addend[low + 1]) = (wide as u64, (wide >> 64) as u64);
        self.words = if negative {
            added(&self.words, &negated(&addend))
        } else {
            added(&self.words, &addend)
        };
    }

    fn merge(&mut self, other: &ExactSum) {
        self.words = added(&self.words, &other.words);
        self.special += other.special;
    }

    /// The sum, rounded once.
    fn value(&self) -> f64 {
        if self.special != 0.0 {
            return self.special;
        }
        let negative = self.words[5] >> 63 == 1;
        let words = if negative { negated(&self.words) } else { self.words };
        let Some(top) = words.iter().rposition(|&word| word != 0) else {
            return 0.0;
        };
        // The 64 most significant bits. The last one also stands for all lower ones, which only matter for rounding.
        let zeros = words[top].leading_zeros();
        let below = if top > 0 { words[top - 1] } else { 0 };
        let pair = (u128::from(words[top]) << 64 | u128::from(below)) << zeros;
        let rest = pair as u64 != 0 || words[..top.saturating_sub(1)].iter().any(|&word| word != 0);
        let leading = (pair >> 64) as u64 | u64::from(rest);
        let exponent = top as i32 * 64 - zeros as i32 - Self::UNIT as i32;
        #[allow(clippy::cast_precision_loss, reason = "this is the rounding")]
        let value = leading as f64 * 2_f64.powi(exponent);
        if negative { -value } else { value }
    }
}

fn added(a: &[u64; 6], b: &[u64; 6]) -> [u64; 6] {
    let mut carry = false;
    std::array::from_fn(|at| {
        let (sum, first) = a[at].overflowing_add(b[at]);
        let (sum, second) = sum.overflowing_add(u64::from(carry));
        carry = first || second;
        sum
    })
}

fn negated(words: &[u64; 6]) -> [u64; 6] {
    added(&words.map(|word| !word), &[1, 0, 0, 0, 0, 0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> u32 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 32) as u32
    }

    #[test]
    fn parts_have_the_aggregate_of_the_whole() {
        let symbols = Symbols::new();
        ["b", "a", "c", ""].iter().for_each(|text| _ = symbols.intern(text));
        let mut state = 1;
        for round in 0..200 {
            for op in AggregateOp::ALL {
                for base in BaseType::ALL.into_iter().filter(|base| op.takes().contains(base)) {
                    let value = |state: &mut u64| match base {
                        BaseType::Symbol => Value(random(state) % 4),
                        // Any bits, some of them infinite or no number.
                        BaseType::Float => Value::float(f32::from_bits(random(state))),
                        _ => Value(random(state)),
                    };
                    let mut values: Vec<Value> = (0..round % 40).map(|_| value(&mut state)).collect();
                    let whole = op.of(base, values.iter().copied(), &symbols);
                    let middle = values.len() / 3;
                    values.rotate_left(middle);
                    let mut parts = [Partial::default(), Partial::default()];
                    for (at, value) in values.iter().enumerate() {
                        parts[usize::from(at > middle)].add(op, base, *value, &symbols);
                    }
                    let [mut first, second] = parts;
                    first.merge(second, op, base, &symbols);
                    assert_eq!(first.finish(op, base), whole, "{op:?} of {base:?}");
                }
            }
        }
    }

    #[test]
    fn sums_are_exact() {
        let sum = |values: &[f32]| {
            let mut sum = ExactSum::default();
            values
                .iter()
                .for_each(|&value| sum.add(BaseType::Float, Value::float(value)));
            sum.value()
        };
        assert_eq!(sum(&[1e30, 1.0, -1e30]), 1.0);
        assert_eq!(sum(&[f32::MAX, 1e-45, -f32::MAX]), f64::from(f32::from_bits(1)));
        assert_eq!(sum(&[f32::MAX; 5]), 5.0 * f64::from(f32::MAX));
        assert_eq!(sum(&[-0.1, -0.2]), f64::from(-0.1_f32) + f64::from(-0.2_f32));
        assert_eq!(sum(&[]), 0.0);
        assert_eq!(sum(&[f32::INFINITY, 1.0]), f64::INFINITY);
        assert!(sum(&[f32::INFINITY, f32::NEG_INFINITY, 3.0]).is_nan());
        let mut state = 5;
        for _ in 0..1_000 {
            // Two floats of similar size: the sum in double precision is exact.
            let floats = [(); 2].map(|()| f32::from_bits(random(&mut state) % (1 << 26) + (100 << 23)));
            assert_eq!(sum(&floats), f64::from(floats[0]) + f64::from(floats[1]));
            let numbers = [(); 3].map(|()| random(&mut state));
            for (base, wide) in [
                (BaseType::Number, numbers.map(|word| i64::from(word.cast_signed()))),
                (BaseType::Unsigned, numbers.map(i64::from)),
            ] {
                let mut sum = ExactSum::default();
                numbers.iter().for_each(|&word| sum.add(base, Value(word)));
                assert_eq!(sum.value(), wide.iter().sum::<i64>() as f64);
            }
        }
    }
}
