//! Completion, and the columns of the atom at a position.

use crate::builtin::BuiltinFiles;
use crate::cli::lsp::analysis::{Analysis, Meaning};
use crate::cli::lsp::client::Client;
use crate::cli::lsp::words::{Place, WORDS, Word};
use crate::cli::lsp::{markup, words};
use crate::datalog;
use crate::datalog::{DIRECTIVES, TokenKind, tokens};
use crate::files::ReadFile;
use lsp_types::{CompletionItem, CompletionItemKind, Documentation};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The most names that a completion lists. A longer list takes long to send.
const NAMES_MAX: usize = 1000;

/// Completes directives at the start of a line, files in an include, types after a colon, else predicates and, in
/// bodies, words of the language.
pub fn complete(analysis: &Analysis, byte: usize, client: &Client) -> Value {
    let text = analysis.text(analysis.entry);
    let start = text.content(text.line(byte)).start;
    let line = &text.as_str()[start..byte];
    let before = line.trim_end_matches(|c: char| c.is_ascii_alphanumeric() || c == '_' || c == '?');
    let begun = line[before.len()..].to_lowercase();
    let before = before.trim();
    let documented = |doc: String| Documentation::MarkupContent(markup(doc, client.plain_completion));
    let item = |meaning: &Meaning, kind: CompletionItemKind| {
        let (detail, doc) = analysis.described(meaning).unzip();
        CompletionItem {
            label: meaning.name().to_owned(),
            kind: Some(kind),
            detail,
            documentation: doc.filter(|doc| !doc.is_empty()).map(documented),
            ..CompletionItem::default()
        }
    };
    let keyword = |word: &Word, label: String| CompletionItem {
        label,
        kind: Some(CompletionItemKind::KEYWORD),
        detail: Some(word.form.to_owned()),
        documentation: Some(documented(word.meaning.to_owned())),
        ..CompletionItem::default()
    };
    let directives = |dot: &'static str| {
        let words = DIRECTIVES.iter().filter_map(|name| words::find(name, true));
        words.map(move |word| keyword(word, format!("{dot}{}", word.name)))
    };
    if before == "." {
        return json!(directives("").collect::<Vec<_>>());
    }
    if before.starts_with(".include") && before.contains('"') {
        let known = BuiltinFiles.builtin_paths();
        let names = known.iter().filter_map(|path| path.strip_prefix("rules/"));
        let file = |name: &str| CompletionItem {
            label: name.to_owned(),
            kind: Some(CompletionItemKind::FILE),
            ..CompletionItem::default()
        };
        return json!(names.map(file).collect::<Vec<_>>());
    }
    let of_types = (before.starts_with(".decl") && before.ends_with(':'))
        || (before.starts_with(".type") && before.ends_with([':', '=', '|']));
    let mut seen = BTreeSet::new();
    let declared = analysis.declared().filter(|meaning| match meaning {
        Meaning::Type(_) => of_types,
        Meaning::Predicate(_) => !of_types,
        _ => false,
    });
    let names: Vec<&Meaning> = declared.filter(|meaning| seen.insert(meaning.name())).collect();
    let complete = names.len() <= NAMES_MAX;
    let fits = |meaning: &&&Meaning| complete || meaning.name().to_lowercase().contains(&begun);
    let kind = match of_types {
        true => CompletionItemKind::CLASS,
        false => CompletionItemKind::FUNCTION,
    };
    let mut items = Vec::new();
    if of_types {
        let bases = datalog::BaseType::ALL.map(|base| Meaning::Type(base.name().to_owned()));
        items.extend(bases.iter().map(|base| item(base, kind)));
    }
    let names = names.iter().filter(fits).take(NAMES_MAX);
    items.extend(names.map(|meaning| item(meaning, kind)));
    if !before.starts_with('.') && analysis.in_body(byte) {
        let words = WORDS.iter();
        let words = words.filter(|word| matches!(word.place, Place::Body | Place::Operator));
        items.extend(words.map(|word| keyword(word, word.name.to_owned())));
    } else if before.is_empty() {
        items.extend(directives("."));
    }
    match complete {
        true => json!(items),
        false => json!({ "isIncomplete": true, "items": items }),
    }
}

/// Returns the columns of the predicate, or the parameters of the function, whose arguments contain a byte.
pub fn signature(analysis: &Analysis, byte: usize, client: &Client) -> Option<Value> {
    let text = analysis.text(analysis.entry).as_str();
    let tokens = tokens(analysis.entry, text);
    let before = &tokens[..tokens.partition_point(|(_, bytes)| bytes.start < byte)];
    if let Some((kind, bytes)) = before.last()
        && (byte < bytes.end && *kind == TokenKind::Text || *kind == TokenKind::Comment && is_inside(text, bytes, byte))
    {
        return None;
    }
    let (mut depth, mut commas) = (0_usize, 0);
    let mut open = None;
    for (at, (kind, _)) in before.iter().enumerate().rev() {
        match kind {
            TokenKind::Close | TokenKind::CloseBrace => depth += 1,
            TokenKind::Open if depth == 0 => {
                open = Some(at);
                break;
            }
            TokenKind::OpenBrace if depth == 0 => return None,
            TokenKind::Open | TokenKind::OpenBrace => depth -= 1,
            TokenKind::Comma if depth == 0 => commas += 1,
            TokenKind::Stop | TokenKind::Directive => return None,
            _ => {}
        }
    }
    let (kind, name) = before.get(open?.checked_sub(1)?)?;
    let name = &text[name.clone()];
    // The columns of a declaration and the options of a directive are no arguments.
    let mut list = before[..open?].iter().rev();
    let begins = list.find(|(kind, _)| !matches!(kind, TokenKind::Name | TokenKind::Comma));
    let is_directive = begins.is_some_and(|(kind, _)| *kind == TokenKind::Directive);
    if *kind != TokenKind::Name || is_directive {
        return None;
    }
    let (parameters, doc) = match analysis.decl(name) {
        Some(decl) => {
            let columns = decl.columns.iter().flatten();
            let columns = columns.map(|column| format!("{}: {}", column.name.text, column.ty.text));
            (columns.collect(), decl.doc.clone())
        }
        None => function(name)?,
    };
    let mut label = format!("{name}(");
    let mut shown = Vec::new();
    for (at, parameter) in parameters.iter().enumerate() {
        label += if at > 0 { ", " } else { "" };
        // The protocol counts these in UTF-16; the text is ASCII.
        let start = label.len();
        label += parameter;
        shown.push(match client.label_ranges {
            true => json!({ "label": [start, label.len()] }),
            false => json!({ "label": parameter }),
        });
    }
    label.push(')');
    // The last parameter of some functions stands for any number.
    let is_open = parameters.last().is_some_and(|last| last == "...");
    let active = if is_open {
        commas.min(parameters.len() - 1)
    } else {
        commas
    };
    let mut signature = json!({ "label": label, "parameters": shown });
    if !doc.is_empty() {
        signature["documentation"] = json!(markup(doc, client.plain_completion));
    }
    Some(json!({ "signatures": [signature], "activeSignature": 0, "activeParameter": active }))
}

/// Returns whether a byte is inside a comment. The end of a line belongs to a comment that ends there.
fn is_inside(text: &str, comment: &std::ops::Range<usize>, byte: usize) -> bool {
    byte < comment.end || byte == comment.end && text[comment.clone()].starts_with("//")
}

/// Returns the parameters of a function of the language and its meaning.
fn function(name: &str) -> Option<(Vec<String>, String)> {
    let word = words::find(name, false).filter(|word| word.place == Place::Body)?;
    let parameters = word.form.strip_prefix(name)?.strip_prefix('(')?.strip_suffix(')')?;
    let parameters = parameters.split(", ").map(str::to_owned).collect();
    (!matches!(name, "Not" | "not")).then(|| (parameters, word.meaning.to_owned()))
}
