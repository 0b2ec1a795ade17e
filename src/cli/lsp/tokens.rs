//! Semantic tokens: the kind of each word, so that an editor can color it.

use crate::cli::lsp::analysis::{Analysis, Meaning, Role};
use crate::cli::lsp::words;
use crate::cli::lsp::words::Place;
use crate::datalog::ast::Item;
use crate::datalog::{BaseType, TokenKind, tokens};
use crate::files::BUILTIN_FOLDER;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ops::Range;

/// The types of tokens; a token has the position of its type.
pub const TYPES: [&str; 10] = [
    "comment",
    "string",
    "number",
    "keyword",
    "operator",
    "type",
    "function",
    "parameter",
    "variable",
    "enumMember",
];

/// The modifiers of tokens; a token has the sum of their powers of two.
pub const MODIFIERS: [&str; 3] = ["declaration", "definition", "defaultLibrary"];

const DECLARATION: u32 = 1;
const DEFINITION: u32 = 2;
const LIBRARY: u32 = 4;

/// A word: its bytes, its type and its modifiers.
type Token = (Range<usize>, &'static str, u32);

/// Returns the tokens between two bytes of the file itself, in the encoding of the protocol: five numbers each.
pub fn encoded(analysis: &Analysis, asked: &Range<usize>) -> Vec<u32> {
    let text = analysis.text(analysis.entry);
    let mut data = Vec::new();
    let mut before = (0, 0);
    let narrow = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    for (bytes, kind, modifiers) in found(analysis) {
        let (first, last) = (text.line(bytes.start), text.line(bytes.end));
        let kind = narrow(TYPES.iter().position(|known| *known == kind).unwrap_or(0));
        // A token has one line; a comment may have several.
        for line in first..=last {
            let content = text.content(line);
            let part = content.start.max(bytes.start)..content.end.min(bytes.end);
            if part.is_empty() || part.end <= asked.start || asked.end <= part.start {
                continue;
            }
            let at = (line, text.units(content.start, part.start));
            let column = if at.0 == before.0 { at.1 - before.1 } else { at.1 };
            let length = text.units(part.start, part.end);
            data.extend([at.0 - before.0, column, length].map(narrow));
            data.extend([kind, modifiers]);
            before = at;
        }
    }
    data
}

fn found(analysis: &Analysis) -> Vec<Token> {
    let source = analysis.sources.text(analysis.entry);
    let columns: BTreeSet<usize> = (analysis.items().iter())
        .filter_map(|item| match item {
            Item::Decl(decl) => decl.columns.as_ref(),
            _ => None,
        })
        .flatten()
        .map(|column| column.name.place.0.range().start)
        .collect();
    let mut named = (analysis.occurrences.iter())
        .filter(|one| one.span.source == analysis.entry)
        .peekable();
    let mut tokens = tokens(analysis.entry, source).into_iter().peekable();
    let mut found: Vec<Token> = Vec::new();
    while let Some((kind, bytes)) = tokens.next() {
        let word = &source[bytes.clone()];
        while named.next_if(|one| one.span.range().start < bytes.start).is_some() {}
        let occurrence = named.peek().filter(|one| one.span.range() == bytes);
        found.push(match (kind, occurrence) {
            (TokenKind::Comment, _) => (bytes, "comment", 0),
            (TokenKind::String, _) => (bytes, "string", 0),
            (TokenKind::Number, _) => (bytes, "number", 0),
            (TokenKind::Directive, _) => (bytes, "keyword", 0),
            (TokenKind::Name, Some(one)) => {
                let role = match one.role {
                    Role::Declares => DECLARATION,
                    Role::Derives => DEFINITION,
                    Role::Uses => 0,
                };
                match &one.meaning {
                    Meaning::Predicate(_) | Meaning::Functor(_) => {
                        (bytes, "function", role | library(analysis, &one.meaning))
                    }
                    Meaning::Type(name) => {
                        let is_base = BaseType::ALL.iter().any(|base| base.name() == name);
                        let library = if is_base {
                            LIBRARY
                        } else {
                            library(analysis, &one.meaning)
                        };
                        (bytes, "type", role | library)
                    }
                    Meaning::Branch(_) => (bytes, "enumMember", role | library(analysis, &one.meaning)),
                    Meaning::Variable(..) => (bytes, "variable", 0),
                    Meaning::Include(_) => continue,
                }
            }
            (TokenKind::Name, None) if columns.contains(&bytes.start) => (bytes, "parameter", DECLARATION),
            (TokenKind::Name, None) => match words::find(word, false).map(|word| word.place) {
                Some(Place::Body) if matches!(tokens.peek(), Some((TokenKind::Open, _))) => {
                    let negates = matches!(word, "Not" | "not");
                    (
                        bytes,
                        if negates { "keyword" } else { "function" },
                        if negates { 0 } else { LIBRARY },
                    )
                }
                Some(Place::Body) => (bytes, "keyword", 0),
                Some(Place::Operator) => (bytes, "operator", 0),
                Some(Place::Type) => (bytes, "type", LIBRARY),
                _ => continue,
            },
            _ => continue,
        });
    }
    found
}

/// Returns the modifier of a name that a built-in file declares.
fn library(analysis: &Analysis, meaning: &Meaning) -> u32 {
    let declared = analysis.declaration(analysis.entry, meaning);
    let is_builtin = declared.is_some_and(|span| analysis.sources.name(span.source).starts_with(BUILTIN_FOLDER));
    if is_builtin { LIBRARY } else { 0 }
}

/// Returns the edit that turns the data of one result into that of the next.
pub fn edits(old: &[u32], new: &[u32]) -> Value {
    let same = old.iter().zip(new).take_while(|(one, other)| one == other).count();
    let ends = old[same..].iter().rev().zip(new[same..].iter().rev());
    let end = ends.take_while(|(one, other)| one == other).count();
    let (deleted, added) = (old.len() - same - end, &new[same..new.len() - end]);
    match (deleted, added) {
        (0, []) => json!([]),
        _ => json!([{ "start": same, "deleteCount": deleted, "data": added }]),
    }
}
