//! The lexer: from text to tokens in one pass. It reports faults and continues.

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Span};

/// Maximum length of a name in bytes, which keeps messages and comparisons of names cheap.
pub(crate) const MAX_NAME_BYTES: usize = 255;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Ident,
    Underscore,
    Number,
    Float,
    Unsigned,
    /// An IPv4 address.
    Address,
    /// A malformed number or an overlong name, already reported.
    Faulty,
    /// A string with both quotes.
    String,
    /// A string without its closing quote, already reported.
    OpenString,
    LParen,
    RParen,
    LBracket,
    RBracket,
    LBrace,
    RBrace,
    Comma,
    Dot,
    Colon,
    Semicolon,
    /// `:-`
    If,
    Bang,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    /// `<:`
    Subtype,
    /// `::`
    DoubleColon,
    Pipe,
    /// `+ * / % ^`
    Operator,
    Minus,
    Dollar,
    At,
    Hash,
    /// A directive of the C preprocessor with the lines that continue it, except `#include "..."`.
    Preprocessor,
    End,
}

/// Spellings of other languages: the text, the token that replaces it, and the help.
const FOREIGN: &[(&str, Kind, &str)] = &[
    ("\\+", Kind::Bang, NEGATION),
    ("=\\=", Kind::NotEqual, "inequality is written `!=`"),
    ("\\=", Kind::NotEqual, "inequality is written `!=`"),
    ("<>", Kind::NotEqual, "inequality is written `!=`"),
    ("\u{2260}", Kind::NotEqual, "inequality is written `!=`"),
    ("=:=", Kind::Equal, "equality is written `=`"),
    ("==", Kind::Equal, "equality is written `=`"),
    ("=<", Kind::LessEqual, "\"at most\" is written `<=`"),
    ("\u{2264}", Kind::LessEqual, "\"at most\" is written `<=`"),
    ("\u{2265}", Kind::GreaterEqual, "\"at least\" is written `>=`"),
    ("&&", Kind::Comma, CONJUNCTION),
    ("&", Kind::Comma, CONJUNCTION),
    ("\u{2227}", Kind::Comma, CONJUNCTION),
    ("||", Kind::Semicolon, DISJUNCTION),
    ("\u{2228}", Kind::Semicolon, DISJUNCTION),
    ("~", Kind::Bang, NEGATION),
    ("\u{ac}", Kind::Bang, NEGATION),
    ("\u{2190}", Kind::If, IMPLICATION),
    (
        "\u{2200}",
        Kind::Faulty,
        "\"for all\" counts the exceptions: `count : { A(y), Not(B(x, y)) } = 0`",
    ),
    (
        "\u{2203}",
        Kind::Faulty,
        "write the literals alone: variables that occur only in the body are existential",
    ),
    (
        "\u{2204}",
        Kind::Faulty,
        "\"none exists\" is `count : { A(y), B(x, y) } = 0`",
    ),
];

/// Preprocessor directives of C. A `#` before any other word begins a comment in other languages.
const PREPROCESSOR: &[&str] = &[
    "include", "define", "undef", "if", "ifdef", "ifndef", "elif", "elifdef", "elifndef", "else", "endif", "error",
    "warning", "line", "pragma",
];

/// The aggregates of answer set programming, which begin with `#`.
const ASP_AGGREGATES: &[&str] = &["count", "sum", "min", "max"];

/// Returns the spelling of a token of punctuation.
fn spelling(kind: Kind) -> Option<&'static str> {
    Some(match kind {
        Kind::Bang => "!",
        Kind::NotEqual => "!=",
        Kind::Equal => "=",
        Kind::LessEqual => "<=",
        Kind::GreaterEqual => ">=",
        Kind::Comma => ",",
        Kind::Semicolon => ";",
        Kind::If => ":-",
        _ => return None,
    })
}

pub(crate) const COMMENT: &str = "comments begin with `//`, or stand between `/*` and `*/`";
pub(crate) const NEGATION: &str = "negation is written `Not(P(X))`, `not P(X)` or `!P(X)`";
pub(crate) const CONJUNCTION: &str = "literals are separated by commas, which mean \"and\"";
pub(crate) const DISJUNCTION: &str = "alternatives are separated by `;`";
pub(crate) const IMPLICATION: &str = "head and body are separated by `:-`";

/// A token: its kind and its byte range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Token {
    pub kind: Kind,
    pub start: u32,
    pub end: u32,
    /// Whether the token is the first one on its line.
    pub first_on_line: bool,
}

/// A line of a doc comment without the slashes, and the index of the token that follows it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DocLine {
    pub before: u32,
    pub start: u32,
    pub end: u32,
}

/// A comment of any kind with its delimiters, and the index of the token that follows it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Comment {
    pub before: u32,
    pub start: u32,
    pub end: u32,
}

#[derive(Debug)]
pub(crate) struct Lexed {
    /// The tokens; the last one is [`Kind::End`].
    pub tokens: Vec<Token>,
    pub docs: Vec<DocLine>,
    /// All comments, including doc comments: the formatter keeps them.
    pub comments: Vec<Comment>,
}

pub(crate) fn is_name_start(byte: u8) -> bool {
    byte.is_ascii_alphabetic() || byte == b'_' || byte == b'?'
}

pub(crate) fn is_name_part(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'?'
}

/// Returns whether the text can be the name of a predicate or a type.
pub fn is_name(text: &str) -> bool {
    let mut bytes = text.bytes();
    text.len() <= MAX_NAME_BYTES
        && bytes.next().is_some_and(is_name_start)
        && bytes.all(is_name_part)
        && !matches!(text, "_" | "Not" | "not")
}

/// Returns the word after the `#` with which `text` begins, if it is a directive of the C preprocessor. A line marker
/// such as `# 1 "file"` gives its number.
pub(crate) fn preprocessor_word(text: &str) -> Option<&str> {
    let rest = text.get(1..)?.trim_start_matches([' ', '\t']);
    let word = &rest[..rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(rest.len())];
    let is_marker = word.starts_with(|c: char| c.is_ascii_digit()) && rest[word.len()..].starts_with(" \"");
    (PREPROCESSOR.contains(&word) || is_marker).then_some(word)
}

/// Returns the length of the line with which `text` begins, and of the lines that continue it after a backslash or
/// within a comment.
pub(crate) fn logical_line(text: &str) -> usize {
    let bytes = text.as_bytes();
    let (mut at, mut in_text) = (0, false);
    while let Some(&byte) = bytes.get(at) {
        match (byte, bytes.get(at + 1)) {
            (b'\n', _) => break,
            (b'\\', _) if bytes[at + 1..].starts_with(b"\r\n") => at += 2,
            (b'\\', _) => at += 1,
            (b'"', _) => in_text = !in_text,
            (b'/', Some(b'/')) if !in_text => return at + text[at..].find('\n').unwrap_or(text.len() - at),
            (b'/', Some(b'*')) if !in_text => {
                let end = text[at + 2..].find("*/");
                at = end.map_or(bytes.len(), |length| at + 2 + length + 1);
            }
            _ => {}
        }
        at += 1;
    }
    at.min(bytes.len())
}

/// The kind of a [`token`](tokens), as far as tools for editing need it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TokenKind {
    /// A comment of any kind, with its delimiters.
    Comment,
    /// A string with its quotes.
    String,
    /// A number or an IPv4 address.
    Number,
    /// The dot and the name of a directive, at the start of a line.
    Directive,
    /// A name or a word of the language.
    Name,
    /// `(`
    Open,
    /// `)`
    Close,
    /// `{`
    OpenBrace,
    /// `}`
    CloseBrace,
    /// `,`
    Comma,
    /// The full stop of a clause.
    Stop,
    /// Any other token.
    Other,
}

/// Splits a text into tokens with their bytes, comments included. Faulty text has tokens as far as they are clear.
pub fn tokens(source: SourceId, text: &str) -> Vec<(TokenKind, std::ops::Range<usize>)> {
    let lexed = lex(source, text, &mut Faults::default());
    let bytes = |start: u32, end: u32| start as usize..end as usize;
    let mut comments = lexed.comments.iter().peekable();
    let mut found: Vec<(TokenKind, std::ops::Range<usize>)> = Vec::new();
    for (index, token) in lexed.tokens.iter().enumerate() {
        while let Some(comment) = comments.next_if(|comment| comment.before as usize <= index) {
            found.push((TokenKind::Comment, bytes(comment.start, comment.end)));
        }
        let before = index.checked_sub(1).map(|before| &lexed.tokens[before]);
        let directive = before.filter(|dot| {
            token.kind == Kind::Ident && dot.kind == Kind::Dot && dot.first_on_line && dot.end == token.start
        });
        if let (Some(dot), Some(last)) = (directive, found.last_mut()) {
            *last = (TokenKind::Directive, bytes(dot.start, token.end));
            continue;
        }
        let kind = match token.kind {
            Kind::End => break,
            Kind::Ident => TokenKind::Name,
            Kind::Number | Kind::Float | Kind::Unsigned | Kind::Address => TokenKind::Number,
            Kind::String | Kind::OpenString => TokenKind::String,
            Kind::LParen => TokenKind::Open,
            Kind::RParen => TokenKind::Close,
            Kind::LBrace => TokenKind::OpenBrace,
            Kind::RBrace => TokenKind::CloseBrace,
            Kind::Comma => TokenKind::Comma,
            Kind::Dot => TokenKind::Stop,
            _ => TokenKind::Other,
        };
        found.push((kind, bytes(token.start, token.end)));
    }
    found
}

/// Splits `text`, which must be shorter than 4 GiB, into tokens.
pub(crate) fn lex(source: SourceId, text: &str, faults: &mut Faults) -> Lexed {
    let mut lexer = Lexer {
        source,
        text,
        bytes: text.as_bytes(),
        at: if text.starts_with('\u{feff}') {
            '\u{feff}'.len_utf8()
        } else {
            0
        },
        fresh_line: true,
        foreign_comments: Vec::new(),
        annotations_end: false,
        lexed: Lexed {
            tokens: Vec::new(),
            docs: Vec::new(),
            comments: Vec::new(),
        },
        faults,
    };
    lexer.run();
    lexer.lexed
}

struct Lexer<'a> {
    source: SourceId,
    text: &'a str,
    bytes: &'a [u8],
    at: usize,
    fresh_line: bool,
    /// The start of each comment in the notation of another language.
    foreign_comments: Vec<Span>,
    /// Whether the rest of the text closes no annotation.
    annotations_end: bool,
    lexed: Lexed,
    faults: &'a mut Faults,
}

impl Lexer<'_> {
    fn run(&mut self) {
        while let Some(&byte) = self.bytes.get(self.at) {
            match byte {
                b'\n' => {
                    self.fresh_line = true;
                    self.at += 1;
                }
                b' ' | b'\t' | b'\r' | 0x0b | 0x0c => self.at += 1,
                b'/' if self.peek(1) == Some(b'/') => self.line_comment(),
                b'/' if self.peek(1) == Some(b'*') => self.block_comment(),
                b'"' => self.string(),
                b'0'..=b'9' => self.number(),
                _ if is_name_start(byte) => self.name(),
                _ => self.punctuation(byte),
            }
        }
        self.push(Kind::End, 0);
        self.report_foreign_comments();
    }

    fn peek(&self, ahead: usize) -> Option<u8> {
        self.bytes.get(self.at + ahead).copied()
    }

    fn span(&self, start: usize, end: usize) -> Span {
        Span::new(self.source, start..end)
    }

    fn push(&mut self, kind: Kind, length: usize) {
        let end = self.at + length;
        let narrow = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
        self.lexed.tokens.push(Token {
            kind,
            start: narrow(self.at),
            end: narrow(end),
            first_on_line: self.fresh_line,
        });
        self.fresh_line = false;
        self.at = end;
    }

    fn count_while(&self, from: usize, keep: impl Fn(u8) -> bool) -> usize {
        self.bytes[from..].iter().take_while(|&&byte| keep(byte)).count()
    }

    fn comment(&mut self, end: usize) {
        let narrow = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
        self.lexed.comments.push(Comment {
            before: narrow(self.lexed.tokens.len()),
            start: narrow(self.at),
            end: narrow(end),
        });
    }

    fn line_comment(&mut self) {
        let length = self.count_while(self.at, |byte| byte != b'\n');
        let end = self.at + length;
        // As in Rust, `///` begins a doc comment and `////` does not.
        if self.peek(2) == Some(b'/') && self.peek(3) != Some(b'/') {
            let narrow = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
            self.lexed.docs.push(DocLine {
                before: narrow(self.lexed.tokens.len()),
                start: narrow(self.at + 3),
                end: narrow(end),
            });
        }
        self.comment(end);
        self.at = end;
    }

    fn block_comment(&mut self) {
        match self.text[self.at + 2..].find("*/") {
            Some(length) => {
                let end = self.at + 2 + length + 2;
                self.fresh_line |= self.bytes[self.at..end].contains(&b'\n');
                self.comment(end);
                self.at = end;
            }
            None => {
                self.faults.push(
                    Diagnostic::new(codes::SYNTAX, "unclosed comment")
                        .at(self.span(self.at, self.at + 2), "this `/*` has no `*/`"),
                );
                self.at = self.bytes.len();
            }
        }
    }

    fn string(&mut self) {
        let mut length = 1;
        loop {
            match self.peek(length) {
                Some(b'"') => return self.push(Kind::String, length + 1),
                Some(b'\\') if !matches!(self.peek(length + 1), None | Some(b'\n')) => length += 2,
                None | Some(b'\n') => break,
                Some(_) => length += 1,
            }
        }
        self.faults.push(
            Diagnostic::new(codes::SYNTAX, "string without a closing quote")
                .at(self.span(self.at, self.at + 1), "it begins here")
                .note("a string ends on the line where it begins; write a line break as `\\n`"),
        );
        self.push(Kind::OpenString, length);
    }

    fn number(&mut self) {
        let length = self.count_while(self.at, |byte| byte.is_ascii_alphanumeric() || byte == b'_');
        let word = &self.bytes[self.at..self.at + length];
        let (digits, suffix) = match word.split_last() {
            Some((b'u', digits)) => (digits, Kind::Unsigned),
            _ => (word, Kind::Number),
        };
        let good = match digits {
            [b'0', b'x', hexadecimal @ ..] => !hexadecimal.is_empty() && hexadecimal.iter().all(u8::is_ascii_hexdigit),
            [b'0', b'b', bits @ ..] => !bits.is_empty() && bits.iter().all(|bit| matches!(bit, b'0' | b'1')),
            decimal => decimal.iter().all(u8::is_ascii_digit),
        };
        if let Some(address) = self.address() {
            return self.push(Kind::Address, address);
        }
        if let Some(float) = self.float() {
            return self.push(Kind::Float, float);
        }
        if good {
            return self.push(suffix, length);
        }
        self.faults.push(
            Diagnostic::new(codes::SYNTAX, "not a number")
                .at(self.span(self.at, self.at + length), "")
                .help("write a number in decimal, or with the prefix `0x` or `0b`; a name cannot begin with a digit"),
        );
        self.push(Kind::Faulty, length);
    }

    /// Returns the length of an IPv4 address: four runs of digits between dots.
    fn address(&self) -> Option<usize> {
        let mut length = 0;
        for part in 0..4 {
            if part > 0 {
                length += usize::from(self.peek(length) == Some(b'.'));
            }
            let digits = self.count_while(self.at + length, |byte| byte.is_ascii_digit());
            if digits == 0 || (part > 0 && self.bytes[self.at + length - 1] != b'.') {
                return None;
            }
            length += digits;
        }
        (!self.peek(length).is_some_and(is_name_part)).then_some(length)
    }

    /// Returns the length of a floating-point number: digits with a fraction, an exponent or both.
    fn float(&self) -> Option<usize> {
        let digits = |from: usize| self.count_while(self.at + from, |byte| byte.is_ascii_digit());
        let whole = digits(0);
        let mut length = whole;
        if self.peek(length) == Some(b'.') && digits(length + 1) > 0 {
            length += 1 + digits(length + 1);
        }
        if matches!(self.peek(length), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(self.peek(length + 1), Some(b'+' | b'-')));
            let exponent = digits(length + 1 + sign);
            if exponent > 0 {
                length += 1 + sign + exponent;
            }
        }
        let ends = !self.peek(length).is_some_and(is_name_part);
        (length > whole && ends).then_some(length)
    }

    fn name(&mut self) {
        let length = self.count_while(self.at, is_name_part);
        if length > MAX_NAME_BYTES {
            self.faults.push(
                Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("name of {length} characters"))
                    .at(self.span(self.at, self.at + 1), "it begins here")
                    .note(format!("a name has at most {MAX_NAME_BYTES}")),
            );
            return self.push(Kind::Faulty, length);
        }
        let kind = match &self.bytes[self.at..self.at + length] {
            b"_" => Kind::Underscore,
            _ => Kind::Ident,
        };
        self.push(kind, length);
    }

    /// Reports a spelling of another language and emits the token that replaces it. `None` if there is no such spelling
    /// here.
    fn foreign(&mut self) -> Option<()> {
        let rest = &self.bytes[self.at..];
        let (written, kind, help) = FOREIGN
            .iter()
            .find(|(written, ..)| rest.starts_with(written.as_bytes()))?;
        // `T<>` is a lattice in Soufflé, which the parser reports.
        let after = rest.iter().skip(2).find(|byte| !byte.is_ascii_whitespace());
        if *written == "<>" && matches!(after, Some(b')' | b',' | b'{')) {
            return None;
        }
        let fault = Diagnostic::new(codes::SYNTAX, format!("`{written}` has no meaning here"))
            .at(self.span(self.at, self.at + written.len()), "")
            .help(*help);
        let fault = match spelling(*kind) {
            Some(spelling) => {
                let span = self.span(self.at, self.at + written.len());
                fault.fix(format!("replace it with `{spelling}`"), [(span, spelling.to_owned())])
            }
            None => fault,
        };
        self.faults.push(fault);
        self.push(*kind, written.len());
        Some(())
    }

    /// Skips a comment in the notation of another language, where nothing else can begin. Returns whether it found one.
    fn foreign_comment(&mut self) -> bool {
        let rest = &self.text[self.at..];
        let after_item = (self.lexed.tokens.last()).is_none_or(|token| token.kind == Kind::Dot);
        let is_aggregate = |rest: &str| {
            let word = rest
                .split(|c: char| !c.is_ascii_alphabetic())
                .next()
                .unwrap_or_default();
            ASP_AGGREGATES.contains(&word) && rest[word.len()..].trim_start_matches(['+', ' ', '\t']).starts_with('{')
        };
        let length = match rest.strip_prefix('#') {
            // The parser reports it.
            Some(rest) if is_aggregate(rest) => return false,
            Some(_) if preprocessor_word(rest).is_none() => 1,
            None if after_item && rest.starts_with('%') => 1,
            None if after_item && rest.starts_with("--") => 2,
            _ => return false,
        };
        self.foreign_comments.push(self.span(self.at, self.at + length));
        self.at += self.count_while(self.at, |byte| byte != b'\n');
        true
    }

    /// Reports all comments in foreign notation as one fault, because a file that has one has many.
    fn report_foreign_comments(&mut self) {
        let Some((&first, others)) = self.foreign_comments.split_first() else {
            return;
        };
        let written = &self.text[first.start as usize..first.end as usize];
        let mut fault = Diagnostic::new(codes::SYNTAX, format!("`{written}` does not begin a comment"))
            .at(first, "")
            .help(COMMENT);
        if !others.is_empty() {
            fault = fault.note(match others.len() {
                1 => "there is 1 more such line".to_owned(),
                count => format!("there are {count} more such lines"),
            });
        }
        self.faults.push(fault);
    }

    /// Emits a token for the directive of the C preprocessor that begins on this line. Returns whether there is one.
    fn preprocessor(&mut self) -> bool {
        let rest = &self.text[self.at..];
        let Some(word) = preprocessor_word(rest).filter(|_| self.fresh_line) else {
            return false;
        };
        let after = &rest[rest.find(word).unwrap_or(0) + word.len()..];
        if word == "include" && after.trim_start_matches([' ', '\t']).starts_with('"') {
            return false;
        }
        self.push(Kind::Preprocessor, logical_line(rest));
        true
    }

    /// Skips and reports an annotation of Soufflé: `@[...]`, `@![...]`. Returns whether it found one.
    fn annotation(&mut self) -> bool {
        let rest = self.bytes[self.at + 1..].iter().copied().enumerate();
        let mut rest = rest.skip_while(|(at, byte)| byte.is_ascii_whitespace() || (*at == 0 && *byte == b'!'));
        if rest.next().is_none_or(|(_, byte)| byte != b'[') {
            return false;
        }
        let (mut depth, mut in_text) = (1_usize, false);
        while let Some((at, byte)) = rest.next() {
            match byte {
                b'\\' if in_text => _ = rest.next(),
                b'"' => in_text = !in_text,
                b'[' if !in_text => depth += 1,
                b']' if !in_text => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                let span = self.span(self.at, self.at + 1);
                let fault = Diagnostic::new(codes::UNSUPPORTED, "annotations (`@[...]`) are not supported");
                self.faults.push(fault.at(span, "").help("remove it"));
                self.at += 1 + at + 1;
                return true;
            }
        }
        // Unclosed, like all that follow.
        self.annotations_end = true;
        false
    }

    fn punctuation(&mut self, byte: u8) {
        if (byte == b'#' && self.preprocessor())
            || (byte == b'@' && !self.annotations_end && self.annotation())
            || self.foreign_comment()
            || self.foreign().is_some()
        {
            return;
        }
        let (kind, length) = match (byte, self.peek(1)) {
            (b':', Some(b'-')) => (Kind::If, 2),
            (b':', Some(b':')) => (Kind::DoubleColon, 2),
            (b'!', Some(b'=')) => (Kind::NotEqual, 2),
            (b'<', Some(b'=')) => (Kind::LessEqual, 2),
            (b'<', Some(b':')) => (Kind::Subtype, 2),
            (b'>', Some(b'=')) => (Kind::GreaterEqual, 2),
            (b'(', _) => (Kind::LParen, 1),
            (b')', _) => (Kind::RParen, 1),
            (b'[', _) => (Kind::LBracket, 1),
            (b']', _) => (Kind::RBracket, 1),
            (b'{', _) => (Kind::LBrace, 1),
            (b'}', _) => (Kind::RBrace, 1),
            (b',', _) => (Kind::Comma, 1),
            (b'.', _) => (Kind::Dot, 1),
            (b':', _) => (Kind::Colon, 1),
            (b';', _) => (Kind::Semicolon, 1),
            (b'!', _) => (Kind::Bang, 1),
            (b'=', _) => (Kind::Equal, 1),
            (b'<', _) => (Kind::Less, 1),
            (b'>', _) => (Kind::Greater, 1),
            (b'|', _) => (Kind::Pipe, 1),
            (b'-', _) => (Kind::Minus, 1),
            (b'+' | b'*' | b'/' | b'%' | b'^', _) => (Kind::Operator, 1),
            (b'$', _) => (Kind::Dollar, 1),
            (b'@', _) => (Kind::At, 1),
            (b'#', _) => (Kind::Hash, 1),
            _ => return self.strange_characters(),
        };
        self.push(kind, length);
    }

    /// Reports a run of characters that begin no token, as one fault.
    fn strange_characters(&mut self) {
        let start = self.at;
        let strange = |byte: u8| {
            !byte.is_ascii_whitespace()
                && !is_name_part(byte)
                && !b"\"()[]{},.:;!=<>|-+*/%^&$@#".contains(&byte)
                && byte != 0x0b
        };
        let length = self.count_while(start, strange);
        let first = self.text[start..].chars().next().unwrap_or('\u{fffd}');
        let line_ends = || {
            let rest = self.text[start + length..].lines().next();
            rest.is_none_or(|rest| rest.trim().is_empty())
        };
        if first == '\\' && length == 1 && line_ends() {
            let fault = Diagnostic::new(codes::UNSUPPORTED, "a backslash at the end of a line is not supported");
            let fault = fault.at(self.span(start, start + length), "");
            self.faults.push(fault.remove(self.span(start, start + length)));
            self.at += length;
            return;
        }
        let message = if first.is_control() {
            format!("unexpected character U+{:04X}", u32::from(first))
        } else {
            format!("unexpected character `{first}`")
        };
        let mut fault = Diagnostic::new(codes::SYNTAX, message).at(self.span(start, start + length), "");
        fault = match first {
            '\'' | '\u{2018}' | '\u{2019}' | '\u{201c}' | '\u{201d}' => {
                fault.help("write strings in double quotes: `\"...\"`")
            }
            _ if first.is_alphabetic() => fault.help(
                "names consist of the letters a-z and A-Z, digits, `_` and `?`; only strings may contain other letters",
            ),
            _ => fault,
        };
        self.faults.push(fault);
        self.at += length;
    }
}
