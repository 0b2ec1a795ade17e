//! Predicates as text and as JSON, in Soufflé's conventions.
//!
//! Each line is one row. Tabs separate the values unless a [`RowFormat`] sets another delimiter. A symbol stands as it
//! is, a number in decimal, a float with up to nine significant digits. The only row of a predicate without columns is
//! `()`, which an empty line also stands for. This module converts rows from and to text; the caller reads and writes
//! files.

use crate::check::{Column, Predicate, PredicateId, RowFormat};
use crate::codes;
use crate::convert::read;
use crate::diag::{Diagnostic, Faults, SourceId, Sources, Span, counted};
use crate::session::Session;
use crate::symbol::{Symbol, WordSize};
use crate::syntax::ast::BaseType;
use crate::value::{self, Value, number_text, parse_in, print_record};
use std::borrow::Cow;
use std::cmp::Ordering;
use std::io::{self, Write};
use std::ops::Range;

mod json;

pub use json::{load_json, write_json};

/// Inserts the rows of a `.facts` text into a predicate and returns the number of rows read.
///
/// The rows hold from the next commit on.
///
/// ```text
/// Car_1<tab>7
/// Car_2<tab>-3
/// ```
///
/// # Errors
/// All faults, as `invalid-fact` diagnostics. In that case the function inserts nothing.
pub fn load(
    session: &mut Session,
    id: PredicateId,
    sources: &Sources,
    source: SourceId,
) -> Result<usize, Vec<Diagnostic>> {
    load_as(session, id, sources, source, &RowFormat::default())
}

/// Loads rows as [`load`] does, in the given format.
///
/// # Errors
/// All faults, as `invalid-fact` diagnostics. In that case the function inserts nothing.
pub fn load_as(
    session: &mut Session,
    id: PredicateId,
    sources: &Sources,
    source: SourceId,
    format: &RowFormat,
) -> Result<usize, Vec<Diagnostic>> {
    let program = session.program().clone();
    let Some(predicate) = program.rules().predicates.get(id.index()) else {
        return Err(vec![Diagnostic::new(
            codes::INVALID_FACT,
            "the program has no such predicate",
        )]);
    };
    let text = sources.text(source);
    let types = &program.rules().types;
    let mut faults = Faults::default();
    let mut rows: Vec<Value> = Vec::new();
    let mut count = 0;
    let mut header = format.headers;
    let mut fields = Vec::new();
    let last = format.columns.iter().max();
    let needed = last.map_or(predicate.arity(), |&last| last + 1);
    let mut start = 0;
    // The final line break is optional.
    while start < text.len() {
        let record = read_record(text, start, format, needed, &mut fields);
        let span = |range: Range<usize>| Span::new(source, range);
        let whole = start..record.end;
        start = record.next;
        if std::mem::take(&mut header) {
            continue;
        }
        count += 1;
        if let Some((range, message)) = record.fault {
            let help = "enclose a value in double quotes, and double a quote inside";
            faults.push(
                Diagnostic::new(codes::INVALID_FACT, message)
                    .at(span(range), "")
                    .help(help),
            );
            continue;
        }
        if predicate.columns.is_empty() {
            if !matches!(&text[whole.clone()], "()" | "") {
                let message = format!("`{}` has no columns; its only row is `()`", predicate.name);
                let fault = Diagnostic::new(codes::INVALID_FACT, message);
                faults.push(fault.at(span(whole), "expected `()` or an empty line"));
            }
            continue;
        }
        let found = record.values;
        if !last.map_or(found == predicate.arity(), |&last| last < found) {
            let message = if whole.is_empty() {
                format!("an empty line where a row of `{}` was expected", predicate.name)
            } else if let Some(last) = last {
                let found = counted(found, "value");
                format!("a row of {found} where value {last} is read, counted from 0")
            } else {
                let (name, arity) = (&predicate.name, predicate.arity());
                format!("a row of `{name}` has {}, not {found}", counted(arity, "value"))
            };
            let fault = Diagnostic::new(codes::INVALID_FACT, message).at(span(whole), "");
            faults.push(
                fault
                    .also(predicate.span, "declared here")
                    .help(if format.delimiter == "\t" {
                        "values are separated by single tabs".to_owned()
                    } else {
                        format!("values are separated by `{}`", format.delimiter)
                    }),
            );
            continue;
        }
        for (index, column) in predicate.columns.iter().enumerate() {
            let field = fields[format.columns.get(index).copied().unwrap_or(index)].clone();
            if column.base == BaseType::Record {
                match parse_record(session, column, &text[field.clone()], format) {
                    Ok(value) => rows.push(value),
                    Err((at, message)) => {
                        let at = (field.start + at).min(field.end);
                        let fault = Diagnostic::new(codes::INVALID_FACT, message).at(span(at..field.end), "");
                        let column = format!("the column is `{}: {}`", column.name, types[column.ty.0 as usize].name);
                        faults.push(fault.note(column).also(predicate.span, "declared here"));
                    }
                }
                continue;
            }
            if let Some(value) = parse(session, column, &text[field.clone()], format) {
                rows.push(value);
                continue;
            }
            let long = session.symbols().word_size() == WordSize::Bits64;
            let (what, label) = match column.base {
                BaseType::Unsigned => (
                    "unsigned numbers",
                    if long {
                        "not a 64-bit decimal number without a sign"
                    } else {
                        "not a 32-bit decimal number without a sign"
                    },
                ),
                BaseType::Float => ("floats", "not a decimal number"),
                _ => (
                    "numbers",
                    if long {
                        "not a 64-bit decimal number"
                    } else {
                        "not a 32-bit decimal number"
                    },
                ),
            };
            let message = format!("column `{}` of `{}` holds {what}", column.name, predicate.name);
            faults.push(Diagnostic::new(codes::INVALID_FACT, message).at(span(field), label));
        }
    }
    let mut faults = faults.finish();
    if faults.is_empty() {
        let inserted = match predicate.arity() {
            0 => (0..count.min(1)).try_for_each(|_| session.insert(id, ())),
            arity => session.insert_all(id, rows.chunks_exact(arity)),
        };
        if let Err(error) = inserted {
            faults.push(Diagnostic::new(codes::INVALID_FACT, error.to_string()));
        }
    }
    if faults.is_empty() { Ok(count) } else { Err(faults) }
}

/// Returns the length of the rows at the start of a text that are complete although the text continues: each ends with
/// a line break outside of quotes.
pub fn complete(text: &str, format: &RowFormat) -> usize {
    let mut end = 0;
    if !format.quoted {
        return text.rfind('\n').map_or(0, |at| at + 1);
    }
    while end < text.len() {
        let record = read_record(text, end, format, 0, &mut Vec::new());
        if record.end == record.next || record.next > text.len() {
            break;
        }
        end = record.next;
    }
    end
}

/// The extent of one row of a text.
struct Record {
    /// The number of its values.
    values: usize,
    /// The end of its content, before the line break.
    end: usize,
    /// The start of the next row.
    next: usize,
    /// The fault of its quotes.
    fault: Option<(Range<usize>, &'static str)>,
}

/// Finds the row that begins at `start`, and replaces `fields` by the byte ranges of its first `needed` values.
///
/// With [`RowFormat::quoted`], a value that begins with a double quote extends to its closing quote, over delimiters
/// and line breaks (RFC 4180).
fn read_record(text: &str, start: usize, format: &RowFormat, needed: usize, fields: &mut Vec<Range<usize>>) -> Record {
    fields.clear();
    let mut values = 0;
    let mut add = |field| {
        values += 1;
        if values <= needed {
            fields.push(field);
        }
        values
    };
    let line_end = |from: usize| text[from..].find('\n').map_or(text.len(), |length| from + length);
    let mut from = start;
    let mut line = line_end(start);
    loop {
        let quoted = format.quoted && text[from..].starts_with('"');
        let close = match quoted {
            true => match closing_quote(text, from + 1) {
                Some(close) => close + 1,
                None => {
                    return Record {
                        values: 0,
                        end: text.len(),
                        next: text.len(),
                        fault: Some((from..from + 1, "this quote is never closed")),
                    };
                }
            },
            false => from,
        };
        if line < close {
            line = line_end(close);
        }
        let end = line - usize::from(text[close..line].ends_with('\r'));
        let record = |values, fault| Record {
            values,
            end,
            next: line + 1,
            fault,
        };
        let open = match (
            format.delimiter.contains(','),
            text[close..end].trim_start().starts_with(['[', '$']),
        ) {
            (true, true) => bracketed(&text[close..end]),
            _ => 0,
        };
        match text[close + open..end]
            .find(format.delimiter.as_str())
            .map(|at| at + open)
        {
            Some(length) if quoted && length > 0 => {
                let fault = (close..close + length, "a value continues after its closing quote");
                return record(0, Some(fault));
            }
            Some(length) => {
                add(from..close + length);
                from = close + length + format.delimiter.len();
            }
            None if quoted && close < end => {
                return record(0, Some((close..end, "a value continues after its closing quote")));
            }
            None => {
                let values = add(from..end);
                return record(values, None);
            }
        }
    }
}

/// Returns the length of a record at the start of a text, up to the bracket that closes it; 0 if none does.
fn bracketed(text: &str) -> usize {
    let (mut depth, mut in_quotes) = (0_usize, false);
    for (at, character) in text.char_indices() {
        match character {
            '"' => in_quotes = !in_quotes,
            _ if in_quotes => {}
            '[' | '(' => depth += 1,
            ']' | ')' if depth <= 1 => return at + 1,
            ']' | ')' => depth -= 1,
            ',' if depth == 0 => return 0,
            _ => {}
        }
    }
    0
}

/// Returns the position of the first double quote that no other one follows.
fn closing_quote(text: &str, mut from: usize) -> Option<usize> {
    loop {
        let quote = from + text[from..].find('"')?;
        if !text[quote + 1..].starts_with('"') {
            return Some(quote);
        }
        from = quote + 2;
    }
}

/// Returns a value without its quotes, if the format has them.
fn unquoted<'t>(text: &'t str, format: &RowFormat) -> Cow<'t, str> {
    let inner = text.strip_prefix('"').and_then(|text| text.strip_suffix('"'));
    match inner.filter(|_| format.quoted) {
        Some(inner) if inner.contains('"') => Cow::Owned(inner.replace("\"\"", "\"")),
        Some(inner) => Cow::Borrowed(inner),
        None => Cow::Borrowed(text),
    }
}

/// Parses a record, or returns where the text is none, and why.
fn parse_record(session: &Session, column: &Column, text: &str, format: &RowFormat) -> Result<Value, (usize, String)> {
    let types = &session.program().rules().types;
    let unquoted = unquoted(text, format);
    read(&unquoted, column.ty, types, &session.symbols().encoder()).map_err(|fault| {
        let at = fault.at + usize::from(unquoted.len() < text.len());
        (at, format!("expected {}", fault.expected.unwrap_or_default()))
    })
}

fn parse(session: &mut Session, column: &Column, text: &str, format: &RowFormat) -> Option<Value> {
    let text = unquoted(text, format);
    match column.base {
        BaseType::Symbol => Some(session.intern(&text)),
        base => parse_in(base, text.trim_start_matches(' '), session.symbols()),
    }
}

/// Returns the rows of a predicate as text, in the order of [`sorted`].
pub fn print(session: &Session, id: PredicateId) -> String {
    let mut out = Vec::new();
    write_rows(session, id, &RowFormat::default(), &mut out).expect("writing to memory cannot fail");
    String::from_utf8(out).expect("texts are written whole")
}

/// Returns the header line with the column names; empty if the format has no headers.
pub fn header(predicate: &Predicate, format: &RowFormat) -> String {
    let names: Vec<&str> = predicate.columns.iter().map(|column| column.name.as_str()).collect();
    match format.headers {
        true => names.join(&format.delimiter) + "\n",
        false => String::new(),
    }
}

/// Returns the rows of a predicate, ordered column by column: numbers by value, symbols by text, records by their fields.
pub fn sorted(session: &Session, id: PredicateId) -> Vec<&[Value]> {
    let mut rows: Vec<&[Value]> = session.encoded_rows(id).collect();
    if let Some(predicate) = session.program().rules().predicates.get(id.index()) {
        rows.sort_by(|a, b| compare(session, predicate, a, b));
    }
    rows
}

/// Returns the rows of a predicate in the order of [`sorted`]. The order takes eight bytes for each row, or nothing if
/// the session holds the rows in that order.
fn ordered<'s>(session: &'s Session, predicate: &Predicate, id: PredicateId) -> impl Iterator<Item = &'s [Value]> {
    let in_order = (session.encoded_rows(id)).is_sorted_by(|a, b| compare(session, predicate, a, b).is_le());
    let mut order: Vec<usize> = Vec::new();
    if !in_order {
        order.extend(0..session.len(id));
        let row = |at: usize| session.row(id, at);
        order.sort_unstable_by(|&a, &b| compare(session, predicate, row(a), row(b)));
    }
    (0..session.len(id)).map(move |at| session.row(id, order.get(at).copied().unwrap_or(at)))
}

/// Returns the whole text of a record.
fn record_text(session: &Session, predicate: &Predicate, record: Value) -> io::Result<String> {
    value::whole_record(record, session.symbols()).ok_or_else(|| {
        let (name, most) = (&predicate.name, value::WHOLE >> 20);
        io::Error::other(format!("a record in `{name}` has more than {most} MiB of text"))
    })
}

/// Compares rows column by column: numbers by value, symbols by text, records by their fields.
fn compare(session: &Session, predicate: &Predicate, a: &[Value], b: &[Value]) -> Ordering {
    let mut columns = predicate.columns.iter().zip(a.iter().zip(b));
    let order = columns.find_map(|(column, (a, b))| {
        let order = value::compare(column.base, *a, *b, session.symbols());
        order.is_ne().then_some(order)
    });
    order.unwrap_or(Ordering::Equal)
}

/// Returns a value as a rows file shows it. A record of more than 16 MiB ends in `...`.
pub fn print_value(session: &Session, word: Value, base: BaseType) -> String {
    match base {
        BaseType::Symbol => session.symbols().resolve(Symbol(word.0)).unwrap_or_default().to_owned(),
        BaseType::Number | BaseType::Unsigned | BaseType::Float => number_text(base, word, session.symbols()),
        BaseType::Record => {
            let mut text = String::new();
            print_record(word, session.symbols(), value::WHOLE, false, &mut text);
            text
        }
    }
}

/// Writes the rows of a predicate in the given format, without the header, in the order of [`sorted`].
///
/// Streaming keeps the memory small: a long symbol that occurs in many rows makes the text far larger than the session.
/// The order takes eight bytes for each row, or nothing if the session holds the rows in that order.
///
/// # Errors
/// If writing to `out` fails.
pub fn write_rows(session: &Session, id: PredicateId, format: &RowFormat, out: &mut dyn Write) -> io::Result<()> {
    let Some(predicate) = session.program().rules().predicates.get(id.index()) else {
        return Ok(());
    };
    let text = |value: Value| session.symbols().resolve(Symbol(value.0)).unwrap_or_default();
    for row in ordered(session, predicate, id) {
        for (position, (column, value)) in predicate.columns.iter().zip(row).enumerate() {
            if position > 0 {
                out.write_all(format.delimiter.as_bytes())?;
            }
            match column.base {
                BaseType::Symbol if format.quoted => write!(out, "\"{}\"", text(*value).replace('"', "\"\""))?,
                BaseType::Symbol => out.write_all(text(*value).as_bytes())?,
                BaseType::Number => write!(out, "{}", value.to_number(session.symbols()))?,
                BaseType::Unsigned => write!(out, "{}", value.to_unsigned(session.symbols()))?,
                BaseType::Float => {
                    out.write_all(number_text(column.base, *value, session.symbols()).as_bytes())?;
                }
                BaseType::Record => {
                    let text = record_text(session, predicate, *value)?;
                    match format.quoted {
                        true => write!(out, "\"{}\"", text.replace('"', "\"\""))?,
                        false => out.write_all(text.as_bytes())?,
                    }
                }
            }
        }
        if predicate.columns.is_empty() {
            out.write_all(b"()")?;
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}
