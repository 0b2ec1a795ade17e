//! Completion.

use crate::builtin::BuiltinFiles;
use crate::cli::lsp::analysis::{Analysis, Meaning};
use crate::cli::lsp::client::Client;
use crate::cli::lsp::words::{Place, WORDS, Word};
use crate::cli::lsp::{markup, words};
use crate::datalog;
use crate::datalog::DIRECTIVES;
use crate::files::ReadFile;
use lsp_types::{CompletionItem, CompletionItemKind, Documentation};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The maximum number of names that a completion lists. A longer list takes long to send.
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
    let of_branches = before.ends_with('$');
    let mut seen = BTreeSet::new();
    let declared = analysis.declared().filter(|meaning| match meaning {
        Meaning::Type(_) => of_types,
        Meaning::Branch(_) => of_branches,
        Meaning::Predicate(_) => !of_types && !of_branches,
        _ => false,
    });
    let names: Vec<&Meaning> = declared.filter(|meaning| seen.insert(meaning.name())).collect();
    let complete = names.len() <= NAMES_MAX;
    let fits = |meaning: &&&Meaning| complete || meaning.name().to_lowercase().contains(&begun);
    let kind = match (of_types, of_branches) {
        (true, _) => CompletionItemKind::CLASS,
        (_, true) => CompletionItemKind::ENUM_MEMBER,
        _ => CompletionItemKind::FUNCTION,
    };
    let mut items = Vec::new();
    if of_types {
        let bases = datalog::BaseType::ALL.map(|base| Meaning::Type(base.name().to_owned()));
        items.extend(bases.iter().map(|base| item(base, kind)));
    }
    let names = names.iter().filter(fits).take(NAMES_MAX);
    items.extend(names.map(|meaning| item(meaning, kind)));
    if !before.starts_with('.') && !of_branches && analysis.in_body(byte) {
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
