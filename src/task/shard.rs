//! Shards: the parts of a data set that separate processes make, and that `logicity merge` joins.
//!
//! A data set is the result of a search over independent items: worlds, or draws of episodes. A shard has the results
//! of every N-th item, or those of a range. The search itself is cheap and runs when shards are joined, so that the
//! result does not depend on the number of shards.

use crate::diag::{Diagnostic, SourceId, Span, json_error};
use crate::task::codes;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io::{self, Write};
use std::ops::Range;
use std::path::PathBuf;

/// The largest number of shards.
pub const SHARDS_MAX: u32 = 10_000;

/// One of several shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// The number of the shard, from 1.
    pub number: u32,
    /// The number of shards.
    pub of: u32,
}

impl Shard {
    /// Parses `I/N`.
    ///
    /// # Errors
    /// A message for other texts, and for numbers that are out of range.
    pub fn parse(text: &str) -> Result<Shard, String> {
        let number = |text: &str| {
            text.parse()
                .ok()
                .filter(|_| text.bytes().all(|byte| byte.is_ascii_digit()))
        };
        let parts = text
            .split_once('/')
            .and_then(|(number_text, of)| Some((number(number_text)?, number(of)?)));
        let shard = parts
            .map(|(number, of)| Shard { number, of })
            .filter(|shard| shard.is_valid());
        shard.ok_or_else(|| format!("expected I/N, such as 1/4, with I from 1 to N and N up to {SHARDS_MAX}"))
    }

    fn is_valid(self) -> bool {
        (1..=self.of).contains(&self.number) && self.of <= SHARDS_MAX
    }

    /// Returns the position of the shard, from 0.
    pub fn position(self) -> usize {
        self.number as usize - 1
    }

    /// Returns the part of a range that the shard has. Parts differ in length by at most 1, and are in order.
    pub fn part(self, all: &Range<u32>) -> Range<u32> {
        let at = |number: u32| {
            let length = u64::from(all.end.saturating_sub(all.start));
            let offset = length * u64::from(number) / u64::from(self.of);
            all.start + u32::try_from(offset).expect("not beyond the range")
        };
        at(self.number - 1)..at(self.number)
    }

    /// Returns the `index`-th of the items that the shard searches: every N-th.
    pub fn item(self, index: u64) -> u64 {
        index * u64::from(self.of) + self.position() as u64
    }

    /// Returns the share of a number of wanted results that the shard looks for.
    pub fn share(self, count: usize) -> usize {
        count.div_ceil(self.of as usize)
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{}/{}", self.number, self.of)
    }
}

/// What the items of a shard depend on. It is the same in all shards of a data set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin<R> {
    /// The configuration, as the command line names it.
    pub config: PathBuf,
    /// The rules that replace those of the configuration.
    pub rules: Option<PathBuf>,
    /// The SHA-256 of the content of the configuration.
    pub config_hash: String,
    /// The SHA-256 of the content of the rules.
    pub rules_hash: String,
    /// What else the command line asks for.
    pub request: R,
}

impl<R> Origin<R> {
    /// Checks that the configuration and the rules are those of the shards, by their hashes.
    ///
    /// # Errors
    /// `invalid-shard` if they have changed.
    pub fn check(&self, config_hash: &str, rules_hash: &str) -> Result<(), Diagnostic> {
        if (self.config_hash.as_str(), self.rules_hash.as_str()) == (config_hash, rules_hash) {
            return Ok(());
        }
        let changed = if self.config_hash == config_hash {
            "its rules have"
        } else {
            "it has"
        };
        let message = format!(
            "the shards are of `{}`, but {changed} changed since",
            self.config.display()
        );
        Err(invalid(message).help("make the shards again"))
    }
}

/// The first line of the file of a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardHeader<O> {
    /// The kind of its items: `logicity episodes` or `logicity questions`.
    pub shard_of: String,
    /// The version of the format.
    pub version: u32,
    /// Which of the shards it is.
    pub shard: Shard,
    /// What the items depend on.
    pub origin: O,
    /// The number of items that the shard has searched.
    pub searched: u64,
    /// The number of results in the lines below.
    pub results: u64,
    /// The SHA-256 of this line, with an empty text in place of the hash, and of the lines below.
    pub sha256: String,
}

/// The version of the format of shards.
pub const VERSION: u32 = 1;

/// The keys that the first lines of all shards share.
#[derive(Deserialize)]
struct Format {
    shard_of: String,
    version: u32,
}

/// Returns the kind of items in the file of a shard, by its first line.
///
/// # Errors
/// `invalid-shard` if the text is not that of a shard, or of another version.
pub fn kind_of(text: &str, source: SourceId) -> Result<String, Diagnostic> {
    let line = text.lines().next().unwrap_or_default();
    let found: Format = parse(line, source, 0, "the first line of a shard")?;
    match found.version == VERSION {
        true => Ok(found.shard_of),
        false => Err(invalid(format!(
            "version {}; this program reads version {VERSION}",
            found.version
        ))
        .at(Span::new(source, 0..line.len()), "in this line")),
    }
}

/// Parses a line of a shard that begins at `start`.
///
/// # Errors
/// `invalid-shard` with its place.
pub fn parse<'t, T: Deserialize<'t>>(
    line: &'t str,
    source: SourceId,
    start: usize,
    what: &str,
) -> Result<T, Diagnostic> {
    serde_json::from_str(line).map_err(|error| {
        let at = error.column().saturating_sub(1).min(line.len());
        let at = (0..=at).rev().find(|&at| line.is_char_boundary(at)).unwrap_or(0);
        let help = "make the shard again; `logicity merge` joins what `--shard` wrote";
        invalid(format!("not {what}: {}", json_error(&error)))
            .at(Span::new(source, start + at..start + line.len()), "here")
            .help(help)
    })
}

/// Returns an `invalid-shard` diagnostic.
pub fn invalid(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::INVALID_SHARD, message)
}

/// Checks that the shards, which have these names, are all of one data set, and returns their order.
///
/// # Errors
/// `invalid-shard` if one is missing, occurs twice, or differs from the first in what its results depend on.
pub fn in_order<O: PartialEq>(shards: &[(String, Shard, O)]) -> Result<Vec<usize>, Diagnostic> {
    let Some((first_name, first, origin)) = shards.first() else {
        return Err(invalid("no shards"));
    };
    if let Some((name, shard, _)) = shards.iter().find(|(_, shard, _)| !shard.is_valid()) {
        return Err(invalid(format!("`{name}` claims to be shard {shard}")));
    }
    let mut order: Vec<Option<usize>> = vec![None; first.of as usize];
    for (index, (name, shard, other)) in shards.iter().enumerate() {
        if other != origin || shard.of != first.of {
            let message = format!("`{name}` and `{first_name}` are of different data sets");
            let help = "join only shards of commands that differ in nothing but `--shard` and the output";
            return Err(invalid(message).help(help));
        }
        if let Some(other) = order[shard.position()].replace(index) {
            let message = format!("`{}` and `{name}` are both shard {shard}", shards[other].0);
            return Err(invalid(message));
        }
    }
    let missing: Vec<String> = (order.iter().enumerate())
        .filter(|(_, found)| found.is_none())
        .map(|(position, _)| format!("{}/{}", position + 1, first.of))
        .collect();
    let message = match missing.as_slice() {
        [] => return Ok(order.into_iter().flatten().collect()),
        [one] => format!("shard {one} is missing"),
        [some @ .., last] if some.len() < 10 => format!("the shards {} and {last} are missing", some.join(", ")),
        [one, ..] => format!(
            "{} of {} shards are missing, the first one is {one}",
            missing.len(),
            first.of
        ),
    };
    Err(invalid(message).help("make them with the same command, and `--shard` for each"))
}

/// Writes the file of a shard: the header, and a line for each result.
///
/// # Errors
/// Errors of `out`.
pub fn write<R: Serialize>(
    out: &mut impl Write,
    (shard_of, shard): (&str, Shard),
    origin: &Origin<R>,
    searched: u64,
    results: impl Iterator<Item = impl Serialize>,
) -> io::Result<()> {
    let (mut body, mut count) = (Vec::new(), 0);
    for result in results {
        serde_json::to_writer(&mut body, &result)?;
        body.push(b'\n');
        count += 1;
    }
    let mut header = ShardHeader {
        shard_of: shard_of.to_owned(),
        version: VERSION,
        shard,
        origin,
        searched,
        results: count,
        sha256: String::new(),
    };
    header.sha256 = hash(&header, &body);
    writeln!(out, "{}", serde_json::to_string(&header)?)?;
    out.write_all(&body)
}

/// The text of a shard, whose hash is right.
#[derive(Clone, Debug)]
pub struct ShardText<'t, R> {
    /// The header.
    pub header: ShardHeader<Origin<R>>,
    /// The lines below, with their places in the text.
    pub lines: Vec<(usize, &'t str)>,
}

/// Reads the file of a shard.
///
/// # Errors
/// `invalid-shard` with its place if the header is faulty, or the file is not as it was written.
pub fn read<R: Serialize + DeserializeOwned>(text: &str, source: SourceId) -> Result<ShardText<'_, R>, Diagnostic> {
    let (first, body) = text.split_once('\n').unwrap_or((text, ""));
    let mut header: ShardHeader<Origin<R>> = parse(first, source, 0, "the first line of a shard")?;
    let found = std::mem::take(&mut header.sha256);
    if found != hash(&header, body.as_bytes()) {
        let fault = invalid("the shard is truncated or modified");
        let fault = fault.at(Span::new(source, 0..first.len()), "in the shard with this first line");
        return Err(fault.help("make the shard again"));
    }
    let mut at = first.len() + 1;
    let lines = body.split_inclusive('\n').map(|line| {
        let start = at;
        at += line.len();
        (start, line.trim_end_matches('\n'))
    });
    Ok(ShardText {
        lines: lines.collect(),
        header,
    })
}

/// Returns the SHA-256 of a header without a hash and of the lines below.
fn hash(header: &impl Serialize, body: &[u8]) -> String {
    let mut hash = Sha256::new();
    hash.update(serde_json::to_vec(header).expect("a header has a form in JSON"));
    hash.update(b"\n");
    hash.update(body);
    format!("{:x}", hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_a_range_once() {
        for of in 1..8 {
            for length in 0..20 {
                let all = 3..3 + length;
                let parts = (1..=of).map(|number| Shard { number, of }.part(&all));
                let joined: Vec<u32> = parts.clone().flatten().collect();
                assert_eq!(joined, all.clone().collect::<Vec<_>>());
                let sizes: Vec<usize> = parts.map(|part| part.len()).collect();
                assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1);
            }
        }
        let of_five: Vec<u64> = (0..3).map(|index| Shard { number: 2, of: 5 }.item(index)).collect();
        assert_eq!(of_five, [1, 6, 11]);
    }

    #[test]
    fn only_numbers_in_range_are_shards() {
        assert_eq!(Shard::parse("2/4"), Ok(Shard { number: 2, of: 4 }));
        assert_eq!(Shard::parse("2/4").unwrap().to_string(), "2/4");
        for text in [
            "",
            "1",
            "0/4",
            "5/4",
            "1/0",
            "1/10001",
            "+1/4",
            "1/4/4",
            "a/b",
            "-1/4",
            "99999999999/4",
        ] {
            assert!(Shard::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn shards_must_be_complete_and_of_one_data_set() {
        let shard = |number, of, origin| (format!("{number}"), Shard { number, of }, origin);
        assert_eq!(in_order(&[shard(2, 2, 0), shard(1, 2, 0)]).unwrap(), [1, 0]);
        for (shards, message) in [
            (vec![], "no shards"),
            (vec![shard(1, 2, 0)], "shard 2/2 is missing"),
            (
                vec![shard(2, 4, 0), shard(4, 4, 0)],
                "the shards 1/4 and 3/4 are missing",
            ),
            (vec![shard(1, 2, 0), shard(1, 2, 0)], "`1` and `1` are both shard 1/2"),
            (
                vec![shard(1, 2, 0), shard(2, 2, 1)],
                "`2` and `1` are of different data sets",
            ),
            (
                vec![shard(1, 2, 0), shard(2, 3, 0)],
                "`2` and `1` are of different data sets",
            ),
            (
                vec![shard(1, 100, 0)],
                "99 of 100 shards are missing, the first one is 2/100",
            ),
        ] {
            assert_eq!(in_order(&shards).unwrap_err().message, message);
        }
    }
}
