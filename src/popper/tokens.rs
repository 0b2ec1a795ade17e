//! Tokens of Prolog.

use crate::diag::{SourceId, Span};

/// A token.
#[derive(Clone, Debug, PartialEq)]
pub enum Token {
    /// A name or an operator; whether it is quoted.
    Name(String, bool),
    Variable(String),
    Number(String),
    Text(String),
    Mark(char),
    End,
    Fault(&'static str),
}

/// Splits a text into tokens with their places. Leaves out comments.
pub fn tokens(text: &str, source: SourceId) -> Vec<(Token, Span)> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        let run = |of: &dyn Fn(char) -> bool| rest.find(|c: char| !of(c)).unwrap_or(rest.len());
        let (token, length) = match first {
            '%' => {
                at += rest.find('\n').unwrap_or(rest.len());
                continue;
            }
            '/' if rest.starts_with("/*") => match rest.find("*/") {
                Some(length) => {
                    at += length + 2;
                    continue;
                }
                None => (Token::Fault("this comment is never closed"), rest.len()),
            },
            c if c.is_whitespace() => {
                at += c.len_utf8();
                continue;
            }
            '.' if is_end(&rest[1..]) => (Token::End, 1),
            '\'' | '"' => quoted(rest, first),
            '0'..='9' => number(rest),
            '(' | ')' | '[' | ']' | '{' | '}' | ',' | '|' => (Token::Mark(first), 1),
            ';' | '!' if !rest[1..].starts_with('=') => (Token::Name(first.into(), false), 1),
            c if c.is_alphabetic() || c == '_' => {
                let length = run(&is_word);
                let word = rest[..length].to_owned();
                let is_variable = c == '_' || c.is_uppercase();
                let token = if is_variable {
                    Token::Variable(word)
                } else {
                    Token::Name(word, false)
                };
                (token, length)
            }
            c if is_symbol(c) => {
                let length = run(&is_symbol);
                (Token::Name(rest[..length].to_owned(), false), length)
            }
            c => (Token::Fault("unexpected character"), c.len_utf8()),
        };
        found.push((token, Span::new(source, at..at + length)));
        at += length;
    }
    found
}

/// Returns whether a character continues a name.
pub fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn is_symbol(c: char) -> bool {
    "+-*/\\^<>=~:.?@#&$!".contains(c)
}

/// Returns whether a full stop before this text ends a clause.
fn is_end(rest: &str) -> bool {
    rest.chars().next().is_none_or(|c| c.is_whitespace() || c == '%')
}

/// Reads a quoted atom or string. A doubled quote stands for one, a backslash escapes.
fn quoted(text: &str, quote: char) -> (Token, usize) {
    let mut content = String::new();
    let mut rest = text.char_indices().skip(1).peekable();
    while let Some((at, c)) = rest.next() {
        match c {
            _ if c == quote && rest.peek().is_some_and(|(_, next)| *next == quote) => {
                rest.next();
                content.push(quote);
            }
            _ if c == quote => {
                let token = match quote {
                    '\'' => Token::Name(content, true),
                    _ => Token::Text(content),
                };
                return (token, at + 1);
            }
            '\\' => match rest.next() {
                Some((_, 'n')) => content.push('\n'),
                Some((_, 't')) => content.push('\t'),
                Some((_, '\n')) => {}
                Some((_, c @ ('\\' | '\'' | '"' | '`'))) => content.push(c),
                Some((end, c)) => return (Token::Fault("unknown escape"), end + c.len_utf8()),
                None => break,
            },
            '\n' => return (Token::Fault("this quote is not closed on its line"), at),
            c => content.push(c),
        }
    }
    (Token::Fault("this quote is never closed"), text.len())
}

/// Reads an integer or a float without a sign.
fn number(text: &str) -> (Token, usize) {
    let digits = |text: &str| text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let mut length = digits(text);
    let mut is_float = false;
    if text[length..].starts_with('.') && digits(&text[length + 1..]) > 0 {
        is_float = true;
        length += 1 + digits(&text[length + 1..]);
        if let Some(exponent) = text[length..].strip_prefix(['e', 'E']) {
            let sign = usize::from(exponent.starts_with(['+', '-']));
            if digits(&exponent[sign..]) > 0 {
                length += 1 + sign + digits(&exponent[sign..]);
            }
        }
    }
    if text[length..].starts_with(|c: char| is_word(c) || c == '\'') {
        let more = text[length..]
            .find(|c: char| !is_word(c))
            .unwrap_or(text.len() - length);
        return (Token::Fault("not a decimal number"), length + more.max(1));
    }
    let written = &text[..length];
    let token = match (is_float, written.parse::<f64>()) {
        (true, Ok(value)) if value.is_finite() => Token::Number(format!("{value:?}")),
        (true, _) => Token::Fault("this number is too large"),
        (false, _) => Token::Number(match written.trim_start_matches('0') {
            "" => "0".to_owned(),
            digits => digits.to_owned(),
        }),
    };
    (token, length)
}
