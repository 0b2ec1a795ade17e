//! The formatter: one layout for every rule file.
//!
//! The formatter moves tokens and comments but changes none. It rewrites no literal and sorts nothing, and every
//! comment stays between the same tokens. So the meaning of a file cannot change.
//!
//! - Every directive and clause begins a line, except that facts may share one.
//! - At most one blank line separates items.
//! - A clause that fits stands on one line. A longer clause continues below its `:-`, indented. There the formatter
//!   keeps the author's line breaks between literals and adds breaks where a line would be too long.
//! - What a component contains is indented.
//! - A comment behind code stays there, in the same column if there is room. A comment on a separate line keeps that
//!   line.
// Decision: docs/decisions/language.md#d053

use crate::diag::{Diagnostic, Faults, SourceId, Sources};

use crate::syntax::include::small_source;
use crate::syntax::lexer;
use crate::syntax::lexer::{Kind, Lexed, Token};
use crate::syntax::parser;

/// Maximum line width in characters, where a break is possible.
const WIDTH: usize = 120;

const INDENT: usize = 4;

/// Returns a rule file in the standard layout.
///
/// # Errors
/// All faults, if the file does not parse. Directives of the preprocessor are faults, except `#include "file"`.
pub fn format(sources: &Sources, id: SourceId) -> Result<String, Vec<Diagnostic>> {
    let mut faults = Faults::default();
    let Some(text) = small_source(sources, id, &mut faults) else {
        return Err(faults.finish());
    };
    let lexed = lexer::lex(id, text, &mut faults);
    let (_, starts) = parser::parse_tokens(id, text, &lexed, &mut faults);
    if faults.failed() {
        return Err(faults.finish());
    }
    let mut layout = Layout {
        text,
        lexed: &lexed,
        out: String::new(),
        next_comment: 0,
        last: 0,
        in_directive: false,
        margin: 0,
        depth: 0,
    };
    layout.file(&starts);
    let formatted = layout.out;
    let again = lexer::lex(id, &formatted, &mut faults);
    debug_assert!(
        same(text, &lexed, &formatted, &again),
        "a token or a comment was changed:\n{formatted}"
    );
    Ok(if same(text, &lexed, &formatted, &again) {
        formatted
    } else {
        text.to_owned()
    })
}

/// Returns whether two sources have the same tokens and comments.
fn same(a: &str, one: &Lexed, b: &str, other: &Lexed) -> bool {
    fn words<'t>(text: &'t str, lexed: &Lexed) -> Vec<&'t str> {
        lexed
            .tokens
            .iter()
            .map(|token| &text[token.start as usize..token.end as usize])
            .collect()
    }
    fn comments(text: &str, lexed: &Lexed) -> Vec<(u32, String)> {
        let word = |comment: &lexer::Comment| {
            let text = &text[comment.start as usize..comment.end as usize];
            let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
            (comment.before, lines.join("\n"))
        };
        lexed.comments.iter().map(word).collect()
    }
    words(a, one) == words(b, other) && comments(a, one) == comments(b, other)
}

struct Layout<'a> {
    text: &'a str,
    lexed: &'a Lexed,
    out: String,
    next_comment: usize,
    /// The end of the last part written, as a byte offset in the input.
    last: usize,
    /// Whether the current item is a directive.
    in_directive: bool,
    /// The number of spaces before the current line.
    margin: usize,
    /// The number of components around the current item.
    depth: usize,
}

/// A token or a comment within an item.
#[derive(Clone, Copy)]
enum Lexeme {
    Token(Token),
    /// A comment, as a byte range.
    Comment(usize, usize),
}

impl Layout<'_> {
    fn file(&mut self, starts: &[usize]) {
        let end = self.lexed.tokens.len() - 1;
        for (index, &start) in starts.iter().enumerate() {
            let next = starts.get(index + 1).copied().unwrap_or(end);
            self.margin = self.depth * INDENT;
            self.comments(start);
            if self.lexed.tokens[start].kind == Kind::RBrace {
                self.depth = self.depth.saturating_sub(1);
                self.margin = self.depth * INDENT;
            }
            self.item(start, next, index > 0 && self.is_fact(starts[index - 1], start));
        }
        self.comments(end);
        let length = self.out.trim_end().len();
        self.out.truncate(length);
        if length > 0 {
            self.out.push('\n');
        }
    }

    /// Returns whether the item is a fact: no directive, and without a `:-`.
    fn is_fact(&self, start: usize, end: usize) -> bool {
        self.lexed.tokens[start].kind == Kind::Ident
            && !self.lexed.tokens[start..end].iter().any(|token| token.kind == Kind::If)
    }

    /// Returns the number of line breaks between two byte offsets.
    fn breaks(&self, from: usize, to: usize) -> usize {
        self.text[from..to].bytes().filter(|&byte| byte == b'\n').count()
    }

    /// Begins a line, and keeps one blank line if the input has one here.
    fn line(&mut self, from: usize) {
        if self.out.is_empty() {
            return;
        }
        if !self.out.ends_with('\n') {
            self.out.push('\n');
        }
        if self.breaks(self.last, from) > 1 && !self.out.ends_with("\n\n") {
            self.out.push('\n');
        }
        self.out.push_str(&" ".repeat(self.margin));
    }

    /// Writes the comments before the token that begins an item, or before the end.
    fn comments(&mut self, before: usize) {
        while let Some(comment) = self.lexed.comments.get(self.next_comment).copied()
            && comment.before as usize <= before
        {
            self.next_comment += 1;
            let (start, end) = (comment.start as usize, comment.end as usize);
            if !self.out.is_empty() && self.breaks(self.last, start) == 0 && !self.out.ends_with('\n') {
                let column = self.column(start);
                let comment = self.comment(start, end);
                trail(&mut self.out, column, &comment);
            } else {
                self.line(start);
                self.out += &self.comment(start, end);
            }
            self.last = end;
        }
    }

    /// Returns a comment without trailing whitespace.
    fn comment(&self, start: usize, end: usize) -> String {
        let lines: Vec<&str> = self.text[start..end].lines().map(str::trim_end).collect();
        lines.join("\n")
    }

    /// Returns the number of characters before a byte offset on its line.
    fn column(&self, at: usize) -> usize {
        let line = self.text[..at].rfind('\n').map_or(0, |newline| newline + 1);
        self.text[line..at].chars().count()
    }

    fn item(&mut self, start: usize, next: usize, after_fact: bool) {
        let tokens = &self.lexed.tokens[start..next];
        let opens = tokens[0].kind == Kind::Dot && tokens[tokens.len() - 1].kind == Kind::LBrace;
        self.in_directive = tokens[0].kind == Kind::Dot;
        let (from, to) = (tokens[0].start as usize, tokens[tokens.len() - 1].end as usize);
        let mut parts: Vec<Lexeme> = Vec::new();
        for (offset, &token) in tokens.iter().enumerate() {
            while let Some(comment) = self.lexed.comments.get(self.next_comment)
                && comment.before as usize <= start + offset
            {
                self.next_comment += 1;
                parts.push(Lexeme::Comment(comment.start as usize, comment.end as usize));
            }
            parts.push(Lexeme::Token(token));
        }
        let flat = self.flat(&parts);
        let line_start = self.out.rfind('\n').map_or(0, |newline| newline + 1);
        let width = self.out[line_start..].chars().count();
        match flat {
            Some(flat) if self.margin + flat.chars().count() <= WIDTH => {
                let joins = after_fact
                    && self.is_fact(start, next)
                    && self.breaks(self.last, from) == 0
                    && !self.out.is_empty()
                    && !self.out.ends_with('\n')
                    && !self.ends_in_comment(from)
                    && width + 1 + flat.chars().count() <= WIDTH;
                if joins {
                    self.out.push(' ');
                } else {
                    self.line(from);
                }
                self.out += &flat;
            }
            _ => {
                self.line(from);
                self.broken(&parts);
            }
        }
        self.depth += usize::from(opens);
        self.last = to;
    }

    /// Returns whether a comment directly precedes a byte offset.
    fn ends_in_comment(&self, from: usize) -> bool {
        let before = self
            .next_comment
            .checked_sub(1)
            .and_then(|index| self.lexed.comments.get(index));
        before.is_some_and(|comment| comment.end as usize == self.last && self.last <= from)
    }

    /// Returns the item on one line; `None` if a comment in it requires a line break.
    fn flat(&self, parts: &[Lexeme]) -> Option<String> {
        let mut line = String::new();
        let mut before: Option<Token> = None;
        let mut binary = false;
        let mut last = None;
        for part in parts {
            match *part {
                Lexeme::Comment(start, end) => {
                    let comment = &self.text[start..end];
                    if comment.starts_with("//")
                        || comment.contains('\n')
                        || last.is_some_and(|at| self.breaks(at, start) > 0)
                    {
                        return None;
                    }
                    line.push(' ');
                    line += comment;
                    before = None;
                    last = Some(end);
                }
                Lexeme::Token(token) => {
                    if before.is_none() && !line.is_empty()
                        || before.is_some_and(|other| self.space(other, token, binary))
                    {
                        line.push(' ');
                    }
                    binary = self.is_binary(before, token);
                    line += self.word(token);
                    before = Some(token);
                    last = Some(token.end as usize);
                }
            }
        }
        Some(line)
    }

    fn word(&self, token: Token) -> &str {
        &self.text[token.start as usize..token.end as usize]
    }

    /// Returns whether a sign stands between two values. A `$` without a name is a value.
    fn is_binary(&self, before: Option<Token>, token: Token) -> bool {
        matches!(token.kind, Kind::Minus | Kind::Operator)
            && before.is_some_and(|before| {
                matches!(
                    before.kind,
                    Kind::Ident
                        | Kind::Number
                        | Kind::Address
                        | Kind::Float
                        | Kind::Unsigned
                        | Kind::String
                        | Kind::RParen
                        | Kind::RBracket
                        | Kind::Dollar
                ) && !self.is_choice(before)
            })
    }

    /// Returns whether this is the first part of `choice-domain`, which is one word.
    fn is_choice(&self, token: Token) -> bool {
        self.in_directive && self.word(token) == "choice"
    }

    /// Returns whether a comma separates the ends of a window.
    fn in_window(&self, comma: Token) -> bool {
        let at = self.lexed.tokens.partition_point(|token| token.start < comma.start);
        at.checked_sub(2)
            .is_some_and(|open| self.lexed.tokens[open].kind == Kind::LBracket)
    }

    /// Returns whether a space separates two tokens. `binary`: the first is a sign between two values.
    fn space(&self, left: Token, right: Token, binary: bool) -> bool {
        use Kind::*;
        match (left.kind, right.kind) {
            (_, Comma | Semicolon | RParen | RBracket) => false,
            // `x: number` in a declaration, `count : { ... }` in a clause.
            (Greater, Colon) => true,
            (_, Colon) => !self.in_directive,
            // The arguments of a component: `A<T>`.
            (Ident, Less) | (Less, Ident) | (_, Greater) if self.in_directive => false,
            // The dot of a directive touches the following name; a full stop touches the preceding token.
            (Dot, Ident) => left.end != right.start,
            (_, Dot) => false,
            (LParen | LBracket | Bang | At | Hash, _) | (Dollar, Ident) => false,
            (Ident, Minus) if self.is_choice(left) => false,
            (Ident, LParen) => self.word(left) == "not",
            // The window of a temporal operator: `once[0,5]`.
            (Ident, LBracket) => false,
            (Comma, Number) => !self.in_window(left),
            (RParen, LParen) => false,
            (_, Minus | Operator) if self.is_binary(Some(left), right) => true,
            (Minus | Operator, _) => binary,
            _ => true,
        }
    }

    /// Writes the item over several lines.
    fn broken(&mut self, parts: &[Lexeme]) {
        let allowed = usize::from(self.in_directive);
        let mut line = String::new();
        // The tokens since the last possible break, not yet part of `line`.
        let mut chunk = String::new();
        let mut before: Option<Token> = None;
        let mut binary = false;
        let mut depth = 0_usize;
        let mut last: Option<usize> = None;
        for part in parts {
            match *part {
                Lexeme::Comment(start, end) => {
                    let comment = self.comment(start, end);
                    let own_line = last.is_some_and(|at| self.breaks(at, start) > 0);
                    join(&mut self.out, &mut line, &mut chunk, self.margin);
                    if own_line {
                        end_line(&mut self.out, &mut line, self.margin);
                        line = " ".repeat(self.margin + INDENT) + &comment;
                        end_line(&mut self.out, &mut line, self.margin);
                    } else if comment.starts_with("//") {
                        trail(&mut line, self.column(start), &comment);
                        end_line(&mut self.out, &mut line, self.margin);
                    } else {
                        if !line.trim().is_empty() {
                            line.push(' ');
                        }
                        line += &comment;
                        line.push(' ');
                        if comment.contains('\n') {
                            end_line(&mut self.out, &mut line, self.margin);
                        }
                    }
                    before = None;
                    last = Some(end);
                }
                Lexeme::Token(token) => {
                    let may_break = before.is_some_and(|before| {
                        before.kind == Kind::If
                            || matches!(before.kind, Kind::Comma | Kind::Semicolon) && depth <= allowed
                    });
                    if may_break {
                        let author = last.is_some_and(|at| self.breaks(at, token.start as usize) > 0);
                        let after_if = before.is_some_and(|before| before.kind == Kind::If);
                        join(&mut self.out, &mut line, &mut chunk, self.margin);
                        if author || after_if {
                            end_line(&mut self.out, &mut line, self.margin);
                        }
                    } else if before.is_some_and(|other| self.space(other, token, binary)) {
                        chunk.push(' ');
                    }
                    binary = self.is_binary(before, token);
                    match token.kind {
                        Kind::LParen | Kind::LBracket | Kind::LBrace => depth += 1,
                        Kind::RParen | Kind::RBracket | Kind::RBrace => depth = depth.saturating_sub(1),
                        _ => {}
                    }
                    chunk += self.word(token);
                    before = Some(token);
                    last = Some(token.end as usize);
                }
            }
        }
        join(&mut self.out, &mut line, &mut chunk, self.margin);
        self.out += line.trim_end();
    }
}

/// Appends a chunk to the line, or to a new line if it does not fit. All lines but the first of an item are indented.
fn join(out: &mut String, line: &mut String, chunk: &mut String, margin: usize) {
    if chunk.is_empty() {
        return;
    }
    let gap = usize::from(!line.is_empty() && !line.ends_with(' '));
    if !line.trim().is_empty() && line.chars().count() + gap + chunk.chars().count() > WIDTH {
        end_line(out, line, margin);
    }
    if !line.is_empty() && !line.ends_with(' ') {
        line.push(' ');
    }
    line.push_str(chunk);
    chunk.clear();
}

/// Ends a line and indents the next one.
fn end_line(out: &mut String, line: &mut String, margin: usize) {
    let text = line.trim_end();
    if !text.is_empty() {
        out.push_str(text);
        out.push('\n');
    }
    *line = " ".repeat(margin + INDENT);
}

/// Appends a comment to a line of code, in its column if there is room.
fn trail(line: &mut String, column: usize, comment: &str) {
    let start = line.rfind('\n').map_or(0, |newline| newline + 1);
    let length = line.trim_end().len();
    line.truncate(length);
    let width = line[start.min(length)..].chars().count();
    line.push_str(&" ".repeat(column.saturating_sub(width).max(1)));
    line.push_str(comment);
}
