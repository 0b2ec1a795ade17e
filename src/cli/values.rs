//! Parsers of the values of options.

use crate::render::Scale;
use crate::task::shard::Shard;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::ffi::OsStr;
use std::fmt::Display;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Returns a parser for a fixed list of values, by name in upper or lower case.
pub fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    OneOf { all, name }
}

#[derive(Clone, Copy)]
struct OneOf<T: 'static> {
    all: &'static [T],
    name: fn(T) -> &'static str,
}

impl<T: Copy + Send + Sync + 'static> OneOf<T> {
    fn names(self) -> impl Iterator<Item = &'static str> {
        self.all.iter().map(move |&value| (self.name)(value))
    }
}

impl<T: Copy + Send + Sync + 'static> TypedValueParser for OneOf<T> {
    type Value = T;

    fn parse_ref(&self, command: &clap::Command, argument: Option<&clap::Arg>, text: &OsStr) -> Result<T, clap::Error> {
        let is_named = |value: &&T| {
            text.to_str()
                .is_some_and(|text| (self.name)(**value).eq_ignore_ascii_case(text))
        };
        match self.all.iter().find(is_named) {
            Some(&value) => Ok(value),
            None => {
                let refused = PossibleValuesParser::new(self.names()).parse_ref(command, argument, text);
                Err(refused.expect_err("it is none of the names"))
            }
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.names().map(PossibleValue::new)))
    }
}

/// Parses a count with an optional decimal suffix, such as `20K`.
pub fn count_of<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    let wrong = || "expected a nonnegative integer, optionally with a suffix: 20K, 50M, 1G, 1T".to_owned();
    let (number, unit) = with_unit(text).ok_or_else(wrong)?;
    let scale: u64 = match unit.as_str() {
        "" => 1,
        "k" => 1_000,
        "m" => 1_000_000,
        "g" => 1_000_000_000,
        "t" => 1_000_000_000_000,
        _ => return Err(wrong()),
    };
    N::try_from(number.saturating_mul(scale)).map_err(|_| wrong())
}

/// Splits a text into an integer and the lowercased suffix.
fn with_unit(text: &str) -> Option<(u64, String)> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    Some((number.parse().ok()?, unit.trim_start().to_ascii_lowercase()))
}

/// Parses a size in MiB, or with a binary suffix, and returns bytes.
pub fn memory_size(text: &str) -> Result<u64, String> {
    let (number, unit) = with_unit(text).ok_or(MEMORY_SIZE)?;
    let scale = match unit.as_str() {
        "k" | "kib" => 10,
        "" | "m" | "mib" => 20,
        "g" | "gib" => 30,
        "t" | "tib" => 40,
        _ => return Err(MEMORY_SIZE.to_owned()),
    };
    Ok(number.saturating_mul(1 << scale))
}

const MEMORY_SIZE: &str = "expected an integer number of MiB, or one with a suffix: 512K, 50M, 2G, 1T, 50MiB";

/// Returns a parser of integers in a range, whose message names the range.
pub fn integer<N>(range: RangeInclusive<N>) -> impl Fn(&str) -> Result<N, String> + Clone + Send + Sync + 'static
where
    N: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text: &str| {
        let number: Option<N> = text.parse().ok();
        let number = number.filter(|number| range.contains(number));
        number.ok_or_else(|| format!("expected an integer from {} to {}", range.start(), range.end()))
    }
}

/// Parses a decimal number within a range.
pub fn decimal(range: RangeInclusive<f64>) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text: &str| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| format!("expected a number from {} to {}", range.start(), range.end()))
    }
}

/// The option to make one of several shards.
#[derive(clap::Args)]
pub struct ShardOption {
    /// Make only part I of N, from 1/N to N/N; `logicity merge` joins all of them to what one process makes without
    /// this option
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
}

/// The maximum number of threads: each needs memory, and systems refuse to start several thousand.
const THREADS_MAX: usize = 1024;

/// Parses a number of threads; 0 means one per core.
pub fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|&count: &usize| count <= THREADS_MAX);
    let count = count.ok_or_else(|| format!("expected an integer from 0 to {THREADS_MAX}; 0 means one per core"))?;
    let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    Ok(NonZeroUsize::new(count).unwrap_or_else(cores))
}

/// Parses the side of a cell in pictures, in pixels.
pub fn scale(text: &str) -> Result<Scale, String> {
    let scale = text.parse().ok().and_then(Scale::pixels);
    scale.ok_or_else(|| "expected an integer from 1 to 64".to_owned())
}
