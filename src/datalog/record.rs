//! Records as interned strings.
//!
//! The word of a record is the id of a symbol: a mark, the id of the record's shape, and the words of its fields. So
//! equal records have equal words, and the table of symbols numbers, counts, copies and removes them. The shape names
//! the branch and the kind of each field, so that a record can be printed without its type.
//!
//! ```text
//! shape of [x: number, y: symbol]      ns
//! shape of Circle {r: float}           Circle:f
//! ```
//!
//! Every record is newer than its fields. All walks rely on that, so they end even for a symbol that only looks like a
//! record, which `as` may make.
// Decision: docs/decisions/language.md#d082

use crate::symbol::{Symbol, Symbols};
use std::cmp::Ordering;
use std::collections::HashMap;

/// The first character of the symbol of a record. Alone it is `nil`.
const MARK: char = '\u{10FFFF}';

/// The symbol of `nil`.
pub(crate) const NIL: &str = "\u{10FFFF}";

/// The kind of a field that holds a symbol.
pub(crate) const SYMBOL: u8 = b's';

/// The kind of a field that holds a record.
pub(crate) const RECORD: u8 = b'r';

/// The number of characters of a word. Each has six bits.
const DIGITS: usize = 6;

/// Returns the approximate memory of a new record in bytes.
pub(crate) fn bytes(fields: usize) -> u64 {
    (MARK.len_utf8() + DIGITS * (fields + 1)) as u64
}

/// Returns the text of the shape with these kinds of fields.
pub(crate) fn shape(branch: Option<&str>, kinds: &[u8]) -> String {
    let mut text = branch.map_or_else(String::new, |branch| format!("{branch}:"));
    text.extend(kinds.iter().map(|&kind| char::from(kind)));
    text
}

/// Returns the branch of a shape and the kinds of its fields.
pub(crate) fn parts(shape: &str) -> (Option<&str>, &[u8]) {
    match shape.rsplit_once(':') {
        Some((branch, kinds)) => (Some(branch), kinds.as_bytes()),
        None => (None, shape.as_bytes()),
    }
}

/// Returns the text of the symbol of a record.
pub(crate) fn encoded(shape: u32, words: impl IntoIterator<Item = u32>) -> String {
    let mut text = String::from(MARK);
    for word in std::iter::once(shape).chain(words) {
        let digits = (0..DIGITS).rev();
        text.extend(digits.map(|digit| char::from(b'0' + (word >> (6 * digit) & 63) as u8)));
    }
    text
}

/// Returns whether a symbol is a record or `nil`.
pub(crate) fn is(text: &str) -> bool {
    text.starts_with(MARK)
}

/// Returns the field at a position of a record with this shape; `None` for another record, for `nil`, and for a symbol
/// that no record has, which `as` may make.
pub(crate) fn field(shape: u32, at: u32, record: u32, symbols: &Symbols) -> Option<u32> {
    let digits = digits(record, symbols)?;
    let fields = parts(symbols.resolve(Symbol(shape))?).1.len();
    let is_whole = digits.len() == (fields + 1) * DIGITS;
    (is_whole && word(digits, 0)? == shape).then(|| word(digits, at as usize + 1))?
}

fn digits(record: u32, symbols: &Symbols) -> Option<&[u8]> {
    symbols.resolve(Symbol(record))?.strip_prefix(MARK).map(str::as_bytes)
}

/// Returns a word; `None` unless its digits are those of [`encoded`].
fn word(digits: &[u8], at: usize) -> Option<u32> {
    let digits = digits.get(at * DIGITS..(at + 1) * DIGITS)?;
    let mut word = 0_u64;
    for digit in digits {
        let digit = digit.checked_sub(b'0').filter(|digit| *digit < 64)?;
        word = word << 6 | u64::from(digit);
    }
    u32::try_from(word).ok()
}

/// A record that is no `nil`, taken apart.
struct Parts<'s> {
    shape: u32,
    branch: Option<&'s str>,
    kinds: &'s [u8],
    digits: &'s [u8],
    record: u32,
}

impl<'s> Parts<'s> {
    fn of(record: u32, symbols: &'s Symbols) -> Option<Parts<'s>> {
        let digits = digits(record, symbols)?;
        let shape = word(digits, 0)?;
        let (branch, kinds) = parts(symbols.resolve(Symbol(shape))?);
        Some(Parts {
            shape,
            branch,
            kinds,
            digits,
            record,
        })
    }

    /// Returns the kind and the word of a field; `None` after the last one.
    fn field(&self, at: usize) -> Option<(u8, u32)> {
        let (kind, word) = (*self.kinds.get(at)?, word(self.digits, at + 1)?);
        let is_record = kind != RECORD || word < self.record;
        Some((if is_record { kind } else { SYMBOL }, word))
    }
}

/// The branch of a record and its fields, each with its kind or type.
pub type Fields<'s, Kind, Word> = (Option<&'s str>, Vec<(Kind, Word)>);

/// Returns the branch of a record and its fields with their kinds; `None` for `nil`.
pub(crate) fn fields(record: u32, symbols: &Symbols) -> Option<Fields<'_, u8, u32>> {
    let parts = Parts::of(record, symbols)?;
    Some((parts.branch, (0..).map_while(|at| parts.field(at)).collect()))
}

/// Compares two records: `nil` is less than any other, then the branch decides, then the fields from the first to the
/// last. `leaf` compares words of a kind other than a record.
pub(crate) fn compare(a: u32, b: u32, symbols: &Symbols, leaf: impl Fn(u8, u32, u32) -> Ordering) -> Ordering {
    let (mut a, mut b) = (a, b);
    loop {
        if a == b {
            return Ordering::Equal;
        }
        let (one, other) = match (Parts::of(a, symbols), Parts::of(b, symbols)) {
            (Some(one), Some(other)) => (one, other),
            (one, other) => return one.is_some().cmp(&other.is_some()).then(a.cmp(&b)),
        };
        let order = (one.branch, one.kinds).cmp(&(other.branch, other.kinds));
        if order.is_ne() {
            return order;
        }
        let fields = (0..).map_while(|at| Some((one.field(at)?, other.field(at)?)));
        // Different records differ in a field, so the first difference decides.
        match fields.into_iter().find(|((_, left), (_, right))| left != right) {
            Some(((RECORD, left), (RECORD, right))) => (a, b) = (left, right),
            Some(((kind, left), (_, right))) => return leaf(kind, left, right).then(left.cmp(&right)),
            None => return a.cmp(&b),
        }
    }
}

/// Adds the text of a record to `out`, and returns whether it is complete: a text longer than `limit` bytes ends in
/// `...`. `leaf` prints words of a kind other than a record.
pub(crate) fn print(
    record: u32,
    symbols: &Symbols,
    limit: usize,
    out: &mut String,
    leaf: impl Fn(u8, u32, &mut String),
) -> bool {
    let limit = out.len().saturating_add(limit);
    let mut open: Vec<(Parts<'_>, usize)> = Vec::new();
    let mut next = Some(record);
    loop {
        if let Some(record) = next.take() {
            match Parts::of(record, symbols) {
                None => out.push_str("nil"),
                Some(parts) => {
                    match parts.branch {
                        None => out.push('['),
                        Some(branch) => {
                            out.push('$');
                            out.push_str(branch);
                            if !parts.kinds.is_empty() {
                                out.push('(');
                            }
                        }
                    }
                    open.push((parts, 0));
                }
            }
        }
        let Some((parts, at)) = open.last_mut() else {
            return true;
        };
        if out.len() > limit {
            out.push_str("...");
            return false;
        }
        match parts.field(*at) {
            Some((kind, word)) => {
                if *at > 0 {
                    out.push_str(", ");
                }
                *at += 1;
                match kind {
                    RECORD => next = Some(word),
                    _ => leaf(kind, word, out),
                }
            }
            None => {
                match parts.branch {
                    None => out.push(']'),
                    Some(_) if !parts.kinds.is_empty() => out.push(')'),
                    Some(_) => {}
                }
                open.pop();
            }
        }
    }
}

/// Returns the word in `to` of a record in `from`.
pub(crate) fn copied(record: u32, from: &Symbols, to: &Symbols) -> u32 {
    let string = |word: u32| to.intern(from.resolve(Symbol(word)).unwrap_or_default()).0;
    let mut done: HashMap<u32, u32> = HashMap::new();
    let mut open = vec![record];
    while let Some(&record) = open.last() {
        let Some(parts) = Parts::of(record, from) else {
            done.insert(record, string(record));
            open.pop();
            continue;
        };
        let fields = || (0..).map_while(|at| parts.field(at));
        let before = open.len();
        open.extend(fields().filter_map(|(kind, word)| (kind == RECORD && !done.contains_key(&word)).then_some(word)));
        if open.len() > before {
            continue;
        }
        let words = fields().map(|(kind, word)| match kind {
            RECORD => done[&word],
            SYMBOL => string(word),
            _ => to.number_of(word, from),
        });
        let text = encoded(string(parts.shape), words);
        done.insert(record, to.intern(&text).0);
        open.pop();
    }
    done[&record]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(symbols: &Symbols, length: u32) -> u32 {
        let shape = symbols.intern(&shape(None, b"nr")).0;
        let nil = symbols.intern(NIL).0;
        (0..length).fold(nil, |tail, head| symbols.intern(&encoded(shape, [head, tail])).0)
    }

    fn text(record: u32, symbols: &Symbols, limit: usize) -> (String, bool) {
        let mut text = String::new();
        let leaf = |_, word: u32, out: &mut String| out.push_str(&word.to_string());
        let complete = print(record, symbols, limit, &mut text, leaf);
        (text, complete)
    }

    #[test]
    fn records_are_taken_apart() {
        let symbols = Symbols::new();
        let record = list(&symbols, 2);
        let shape = symbols.intern("nr").0;
        assert_eq!(field(shape, 0, record, &symbols), Some(1));
        let tail = field(shape, 1, record, &symbols).unwrap();
        assert_eq!(field(shape, 0, tail, &symbols), Some(0));
        assert_eq!(field(shape, 2, record, &symbols), None);
        assert_eq!(field(shape + 1, 0, record, &symbols), None);
        assert_eq!(field(shape, 0, symbols.intern(NIL).0, &symbols), None);
        assert_eq!(text(record, &symbols, 100), ("[1, [0, nil]]".to_owned(), true));
        assert_eq!(text(record, &symbols, 3), ("[1, [...".to_owned(), false));
    }

    #[test]
    fn deep_records_need_no_deep_stack() {
        let (symbols, other) = (Symbols::new(), Symbols::new());
        let long = list(&symbols, 300_000);
        let leaf = |_, a: u32, b: u32| a.cmp(&b);
        assert_eq!(
            compare(long, list(&symbols, 299_999), &symbols, leaf),
            Ordering::Greater
        );
        other.intern("before");
        let copy = copied(long, &symbols, &other);
        assert_eq!(text(copy, &other, usize::MAX), text(long, &symbols, usize::MAX));
    }
}
