//! Relations as text, by Souffle's conventions.
//!
//! One row is one line, its values are separated by tabs: a symbol as it is, a number in decimal. The only row of a relation
//! without columns is `()`. This module turns text into rows and rows into text; reading and writing files is for others.

use crate::diag::{Code, Diagnostic, SourceId, Sources, Span};
use crate::engine::Session;
use crate::lang::{BaseType, Column, RelId, Value};
use crate::symbol::Symbol;
use std::cmp::Ordering;
use std::fmt::Write;

/// At most this many faults of one text are reported.
pub const FAULTS_MAX: usize = 20;

/// Inserts the rows of a `.facts` text into a relation, to hold from the next commit on, and says how many lines there were. If
/// there are faults, nothing is inserted.
///
/// ```text
/// Car_1<tab>7
/// Car_2<tab>-3
/// ```
pub fn load(session: &mut Session, rel: RelId, sources: &Sources, source: SourceId) -> Result<usize, Vec<Diagnostic>> {
    let program = session.program().clone();
    let Some(relation) = program.rules().relations.get(rel.index()) else {
        return Err(vec![Diagnostic::new(
            Code::InvalidFact,
            "the program has no such relation",
        )]);
    };
    let text = sources.text(source);
    let mut faults = Faults::default();
    let mut rows: Vec<Value> = Vec::new();
    let mut count = 0;
    let mut start = 0;
    // The last line may or may not end with a line break.
    for line in text
        .strip_suffix('\n')
        .unwrap_or(text)
        .split('\n')
        .take(if text.is_empty() { 0 } else { usize::MAX })
    {
        let content = line.strip_suffix('\r').unwrap_or(line);
        let span = |from: usize, to: usize| Span::new(source, start + from..start + to);
        if relation.columns.is_empty() {
            if content != "()" {
                let message = format!("`{}` has no columns; its only row is `()`", relation.name);
                faults.push(Diagnostic::new(Code::InvalidFact, message).at(span(0, content.len()), "expected `()`"));
            }
        } else {
            let found = content.split('\t').count();
            if found != relation.arity() {
                let message = if content.is_empty() {
                    format!("an empty line where a row of `{}` was expected", relation.name)
                } else {
                    let (name, arity) = (&relation.name, relation.arity());
                    format!("a row of `{name}` has {arity} values, not {found}")
                };
                let fault = Diagnostic::new(Code::InvalidFact, message).at(span(0, content.len()), "");
                faults.push(
                    fault
                        .also(relation.span, "declared here")
                        .help("values are separated by single tabs"),
                );
            } else {
                let mut from = 0;
                for (column, value) in relation.columns.iter().zip(content.split('\t')) {
                    match parse(session, column, value) {
                        Some(value) => rows.push(value),
                        None => {
                            let message = format!("column `{}` of `{}` holds numbers", column.name, relation.name);
                            let fault = Diagnostic::new(Code::InvalidFact, message);
                            let label = "not a 32-bit decimal number";
                            faults.push(fault.at(span(from, from + value.len()), label));
                        }
                    }
                    from += value.len() + 1;
                }
            }
        }
        count += 1;
        start += line.len() + 1;
    }
    let mut faults = faults.finish();
    if faults.is_empty() {
        for position in 0..count {
            let row = &rows[position * relation.arity()..(position + 1) * relation.arity()];
            if let Err(error) = session.insert(rel, row) {
                faults.push(Diagnostic::new(Code::InvalidFact, error.to_string()));
                break;
            }
        }
    }
    if faults.is_empty() { Ok(count) } else { Err(faults) }
}

fn parse(session: &mut Session, column: &Column, text: &str) -> Option<Value> {
    match column.base {
        BaseType::Symbol => Some(session.intern(text)),
        BaseType::Number => text.parse().ok().map(Value::number),
    }
}

/// Faults, the first ones kept and all counted.
#[derive(Default)]
struct Faults {
    kept: Vec<Diagnostic>,
    count: usize,
}

impl Faults {
    fn push(&mut self, fault: Diagnostic) {
        self.count += 1;
        if self.count <= FAULTS_MAX {
            self.kept.push(fault);
        }
    }

    fn finish(mut self) -> Vec<Diagnostic> {
        if let (true, Some(last)) = (self.count > FAULTS_MAX, self.kept.last_mut()) {
            last.notes.push(format!(
                "{} more faults in this file are not shown",
                self.count - FAULTS_MAX
            ));
        }
        self.kept
    }
}

/// The rows of a relation as text, ordered by what is shown: numbers by value, symbols by text.
pub fn print(session: &Session, rel: RelId) -> String {
    let Some(relation) = session.program().rules().relations.get(rel.index()) else {
        return String::new();
    };
    let text = |value: Value| session.symbols().text(Symbol(value.0)).unwrap_or_default();
    let mut rows: Vec<&[Value]> = session.rows(rel).collect();
    rows.sort_by(|a, b| {
        let mut columns = relation.columns.iter().zip(a.iter().zip(*b));
        let order = columns.find_map(|(column, (a, b))| {
            let order = match column.base {
                BaseType::Symbol => text(*a).cmp(text(*b)),
                BaseType::Number => a.as_number().cmp(&b.as_number()),
            };
            order.is_ne().then_some(order)
        });
        order.unwrap_or(Ordering::Equal)
    });
    let mut out = String::new();
    for row in rows {
        for (position, (column, value)) in relation.columns.iter().zip(row).enumerate() {
            if position > 0 {
                out.push('\t');
            }
            match column.base {
                BaseType::Symbol => out.push_str(text(*value)),
                BaseType::Number => write!(out, "{}", value.as_number()).expect("writing to a string cannot fail"),
            }
        }
        if relation.columns.is_empty() {
            out.push_str("()");
        }
        out.push('\n');
    }
    out
}
