//! Signature help: the columns of the atom, or the parameters of the function, at a position.

use crate::cli::lsp::analysis::Analysis;
use crate::cli::lsp::client::Client;
use crate::cli::lsp::words::Place;
use crate::cli::lsp::{markup, words};
use crate::datalog::{TokenKind, tokens};
use serde_json::{Value, json};

/// Returns the columns of the predicate, or the parameters of the function, whose arguments contain a byte.
pub fn signature(analysis: &Analysis, byte: usize, client: &Client) -> Option<Value> {
    let text = analysis.text(analysis.entry).as_str();
    let tokens = tokens(analysis.entry, text);
    let before = &tokens[..tokens.partition_point(|(_, bytes)| bytes.start < byte)];
    if let Some((kind, bytes)) = before.last()
        && (byte < bytes.end && *kind == TokenKind::String
            || *kind == TokenKind::Comment && is_inside(text, bytes, byte))
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
