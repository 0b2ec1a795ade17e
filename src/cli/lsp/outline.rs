//! The structure of a document: its symbols, and the parts that an editor can fold.

use crate::cli::lsp::analysis::Analysis;
use crate::cli::lsp::client::Client;
use crate::cli::lsp::place::Text;
use crate::datalog::ast::Item;
use crate::datalog::{TokenKind, ast, tokens};
use lsp_types::SymbolKind;
use serde_json::{Value, json};
use std::ops::Range;

/// A declaration or a clause.
pub struct Symbol {
    pub name: String,
    /// The first line of its doc comment.
    pub detail: String,
    pub kind: SymbolKind,
    whole: Range<usize>,
    pub selection: Range<usize>,
}

/// Returns declarations, types and, if asked, clauses in source order.
pub fn symbols(items: &[Item], text: &str, with_clauses: bool) -> Vec<Symbol> {
    let title = |doc: &str| doc.lines().next().unwrap_or_default().to_owned();
    let named = |name: &ast::Name, doc: &str, kind: SymbolKind| Symbol {
        name: name.text.clone(),
        detail: title(doc),
        kind,
        whole: name.place.0.range(),
        selection: name.place.0.range(),
    };
    let mut symbols = Vec::new();
    for item in items {
        match item {
            Item::Decl(decl) => {
                let names = decl.names.iter();
                symbols.extend(names.map(|name| named(name, &decl.doc, SymbolKind::FUNCTION)));
            }
            Item::Functor(decl) => symbols.push(named(&decl.name, &decl.doc, SymbolKind::FUNCTION)),
            Item::Type(decl) => symbols.push(named(&decl.name, &decl.doc, SymbolKind::CLASS)),
            Item::Clause(clause) if with_clauses => symbols.extend(clause.heads.first().map(|head| Symbol {
                name: text[head.place.0.range()].to_owned(),
                detail: title(&clause.doc),
                kind: SymbolKind::EVENT,
                whole: clause.place.0.range(),
                selection: head.place.0.range(),
            })),
            _ => {}
        }
    }
    symbols
}

/// Lists the symbols of a document for the client.
pub fn listed(analysis: &Analysis, uri: &str, client: &Client) -> Value {
    let text = analysis.text(analysis.entry);
    let symbols = symbols(analysis.items(), text.as_str(), true).into_iter();
    let listed = symbols.map(|symbol| match client.symbol_ranges {
        true => json!({
            "name": symbol.name, "detail": symbol.detail, "kind": symbol.kind,
            "range": text.range(symbol.whole), "selectionRange": text.range(symbol.selection),
        }),
        false => json!({
            "name": symbol.name, "kind": symbol.kind,
            "location": { "uri": uri, "range": text.range(symbol.whole) },
        }),
    });
    listed.collect()
}

/// A part to fold: its bytes and its kind.
type Fold = (Range<usize>, Option<&'static str>);

/// Returns the parts of a document with several lines: clauses, braces and parentheses, comments, includes and scopes.
pub fn folds(analysis: &Analysis, client: &Client) -> Value {
    let text = analysis.text(analysis.entry);
    let mut folds = comments_and_brackets(analysis, text);
    folds.extend(items(analysis, text));
    folds.retain(|(bytes, _)| text.line(bytes.start) < text.line(bytes.end));
    // The outer parts first, in case the client wants only some.
    folds.sort_by_key(|(bytes, _)| (bytes.start, std::cmp::Reverse(bytes.end)));
    folds.dedup_by_key(|(bytes, _)| (text.line(bytes.start), text.line(bytes.end)));
    folds.truncate(client.folding_max.unwrap_or(usize::MAX));
    let shown = folds.into_iter().map(|(bytes, kind)| {
        let range = text.range(bytes);
        let mut fold = json!({ "startLine": range.start.line, "endLine": range.end.line });
        if !client.folds_lines {
            fold["startCharacter"] = range.start.character.into();
            fold["endCharacter"] = range.end.character.into();
        }
        if let Some(kind) = kind {
            fold["kind"] = kind.into();
        }
        fold
    });
    shown.collect()
}

fn comments_and_brackets(analysis: &Analysis, text: &Text) -> Vec<Fold> {
    let mut folds: Vec<Fold> = Vec::new();
    let mut open: Vec<(TokenKind, usize)> = Vec::new();
    // Comments on successive lines are one part.
    let mut run: Option<Range<usize>> = None;
    for (kind, bytes) in tokens(analysis.entry, text.as_str()) {
        match kind {
            TokenKind::Comment if text.as_str()[bytes.clone()].starts_with("//") => {
                let line = text.line(bytes.start);
                let is_first = text.as_str()[text.content(line).start..bytes.start].trim().is_empty();
                match &mut run {
                    Some(run) if is_first && text.line(run.end) + 1 == line => run.end = bytes.end,
                    _ => folds.extend(run.replace(bytes).map(|run| (run, Some("comment")))),
                }
            }
            TokenKind::Comment => folds.push((bytes, Some("comment"))),
            TokenKind::Open | TokenKind::OpenBrace => open.push((kind, bytes.end)),
            TokenKind::Close | TokenKind::CloseBrace => {
                let opening = match kind {
                    TokenKind::Close => TokenKind::Open,
                    _ => TokenKind::OpenBrace,
                };
                if let Some((_, start)) = open.pop_if(|(kind, _)| *kind == opening) {
                    folds.push((start..bytes.start, None));
                }
            }
            TokenKind::Stop | TokenKind::Directive => open.clear(),
            _ => {}
        }
    }
    folds.extend(run.map(|run| (run, Some("comment"))));
    folds
}

fn items(analysis: &Analysis, text: &Text) -> Vec<Fold> {
    let mut folds: Vec<Fold> = Vec::new();
    let mut scope: Option<Range<usize>> = None;
    let mut includes: Option<Range<usize>> = None;
    for item in analysis.items() {
        if let Item::Include(include) = item {
            let place = include.place.0.range();
            match &mut includes {
                Some(run) => run.end = place.end,
                None => includes = Some(place),
            }
            continue;
        }
        folds.extend(includes.take().map(|run| (run, Some("imports"))));
        match item {
            Item::Scope(entered) => {
                let place = entered.place.0.range();
                let last = text.line(place.start).saturating_sub(1);
                folds.extend(
                    scope
                        .take()
                        .map(|start| (start.end..text.content(last).end, Some("region"))),
                );
                scope = entered.predicate.is_some().then_some(place);
            }
            Item::Clause(clause) => folds.push((clause.place.0.range(), None)),
            _ => {}
        }
    }
    folds.extend(includes.map(|run| (run, Some("imports"))));
    folds.extend(scope.map(|start| (start.end..text.as_str().trim_end().len(), Some("region"))));
    folds.retain(|(bytes, _)| bytes.start <= bytes.end);
    folds
}
