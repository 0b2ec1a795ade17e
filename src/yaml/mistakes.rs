//! Explains syntax errors: where the mistake is, and what to write instead.

use crate::diag::{Diagnostic, SourceId, Span};
use crate::yaml::codes;
use serde_yaml::granit_parser::ErrorKind;

/// The maximum number of characters of a text in a message.
const SHOWN: usize = 40;

/// The place where the parser stopped.
pub(super) struct Stop<'a> {
    pub source: SourceId,
    pub text: &'a str,
    /// The byte of the place.
    pub at: usize,
    /// The innermost bracket that is open there.
    pub bracket: Option<usize>,
    /// The end of what was parsed before.
    pub parsed: usize,
}

impl Stop<'_> {
    /// Returns the diagnostic of an error of the parser.
    pub fn explain(mut self, kind: &ErrorKind) -> Diagnostic {
        let place = self.character(self.at);
        self.at = place.range().start;
        let known = self
            .tab(kind)
            .or_else(|| self.second_colon())
            .or_else(|| self.brackets(kind))
            .or_else(|| self.glued_dash())
            .or_else(|| self.glued_key())
            .or_else(|| self.quote(kind))
            .or_else(|| self.indentation(kind))
            .or_else(|| self.word(kind));
        known.unwrap_or_else(|| fault(kind.to_string()).at(place, ""))
    }

    /// The span of the character at a byte, so that a caret has a target; empty at the end of the text.
    pub fn character(&self, byte: usize) -> Span {
        let mut start = byte.min(self.text.len());
        while !self.text.is_char_boundary(start) {
            start -= 1;
        }
        let length = self.text[start..].chars().next().map_or(0, char::len_utf8);
        Span::new(self.source, start..start + length)
    }

    /// Returns the start of the line of a byte.
    fn start_of(&self, byte: usize) -> usize {
        self.text[..byte].rfind('\n').map_or(0, |newline| newline + 1)
    }

    /// Returns the rest of the line from a byte on.
    fn line(&self, start: usize) -> &str {
        self.text[start..].lines().next().unwrap_or_default()
    }

    fn indent(&self, start: usize) -> usize {
        let line = self.line(start);
        line.len() - line.trim_start_matches([' ', '\t']).len()
    }

    /// Returns the starts of the line of the error and of the line before it.
    fn lines_near(&self) -> impl Iterator<Item = usize> {
        let start = self.start_of(self.at);
        let before = start.checked_sub(1).map(|end| self.start_of(end));
        [Some(start), before].into_iter().flatten()
    }

    /// Reports a tab that indents the line or, if the parser complains about a tab, a later line of the same scalar.
    fn tab(&self, kind: &ErrorKind) -> Option<Diagnostic> {
        // The parser reports a tab below a plain scalar at the scalar.
        let lines = match kind.to_string().contains("found a tab") {
            true => usize::MAX,
            false => 1,
        };
        let start = self.start_of(self.at);
        let starts = self.text[start..].split_inclusive('\n').scan(start, |next, line| {
            let start = *next;
            *next += line.len();
            Some(start)
        });
        let tab = starts.take(lines).find_map(|start| {
            let tab = self.line(start)[..self.indent(start)].find('\t')?;
            Some(start + tab)
        })?;
        let span = Span::new(self.source, tab..tab + 1);
        let fault = fault("a tab indents this line").at(span, "");
        Some(fault.help("indent with spaces: YAML does not allow tabs here"))
    }

    /// Reports `key: word: value` on one line.
    fn second_colon(&self) -> Option<Diagnostic> {
        let (start, at) = (self.start_of(self.at), self.at);
        let rest = self.text[at..].strip_prefix(": ")?.lines().next().unwrap_or_default();
        let (before, word) = self.text[start..at].rsplit_once(": ")?;
        let key = before.trim_start_matches([' ', '-']);
        let key = key.rsplit_once(['{', '[', ',']).map_or(key, |(_, key)| key).trim();
        let word = word.trim();
        let is_plain = |text: &str| !text.is_empty() && !text.contains(['{', '}', '[', ']', ',', '"', '\'', '#']);
        let value = rest.split([',', '}', ']', '#']).next().unwrap_or_default().trim();
        if ![key, word, value].into_iter().all(is_plain) {
            return None;
        }
        let from = at - word.len();
        let span = Span::new(self.source, from..at + 2 + rest.find(value)? + value.len());
        let fault = fault("a value in the line of its key cannot have a key itself");
        Some(fault.at(span, format!("in the value of `{key}`")).help(format!(
            "write a mapping in braces, `{key}: {{{word}: {value}}}`, or a text in quotes, `{key}: \"{word}: {value}\"`"
        )))
    }

    /// Reports brackets that are not closed, or by the wrong bracket, and what cannot be in brackets.
    fn brackets(&self, kind: &ErrorKind) -> Option<Diagnostic> {
        let here = self.character(self.at);
        match kind {
            ErrorKind::MismatchedFlowCollectionEnd { open, close } => {
                let needed = closing(*open);
                let found = fault(format!("a `{needed}` is missing before a `{close}`")).at(here, "opened here");
                let found = match self.wrong_end(self.at, *close) {
                    Some(end) => found.also(self.character(end), format!("write `{needed}` before this")),
                    None => found,
                };
                Some(found.help(format!("close the `{open}` with `{needed}`")))
            }
            ErrorKind::UnclosedFlowCollection { open } => {
                let needed = closing(*open);
                let found = fault(format!("the `{open}` is not closed")).at(here, "opened here");
                Some(found.help(format!("write `{needed}` after its last entry")))
            }
            ErrorKind::MisplacedFlowCollectionEnd => {
                let close = self.text[self.at..].chars().next()?;
                let found = fault(format!("nothing opens this `{close}`")).at(here, "");
                Some(found.help("remove it, or write the bracket that opens it"))
            }
            ErrorKind::PlainScalarStartsWithDashFlowIndicator | ErrorKind::BlockEntryInFlowCollection
                if self.bracket.is_some() =>
            {
                let found = fault("the entries of a list in brackets have no dashes").at(here, "");
                Some(found.help("remove the dash"))
            }
            ErrorKind::ExpectedFlowMappingSeparator
            | ErrorKind::ExpectedFlowSequenceSeparator
            | ErrorKind::InvalidColonPlacement => {
                let bracket = self.bracket?;
                let open = self.text[bracket..].chars().next()?;
                let needed = closing(open);
                let start = self.start_of(self.at);
                let first = start + self.indent(start);
                // A colon on a later line belongs to a key, which begins the line.
                let is_key = matches!(kind, ErrorKind::InvalidColonPlacement) && bracket < start;
                let (place, line) = match is_key || self.at == first {
                    true => (self.character(first), " before this line"),
                    false => (here, ""),
                };
                let found = fault(format!("expected `,` or `{needed}`{line}")).at(place, "");
                let found = found.also(self.character(bracket), "opened here");
                Some(found.help(format!(
                    "close the `{open}` with `{needed}`, or put a comma between its entries"
                )))
            }
            ErrorKind::BlockSequenceEntryNotAllowed => {
                let entry = self.line(self.at).strip_prefix("- ")?.trim();
                let is_alone = self.text[self.start_of(self.at)..self.at].trim().is_empty();
                if is_alone || entry.is_empty() {
                    return None;
                }
                let found = fault("a list in the line of its key has brackets, not dashes").at(here, "");
                Some(found.help(format!("write `[{}]`", shown(entry))))
            }
            _ => None,
        }
    }

    /// Returns the first bracket from `open` on that does not close the last one opened, if it is a `close`.
    fn wrong_end(&self, open: usize, close: char) -> Option<usize> {
        let mut opened: Vec<char> = Vec::new();
        let mut quote = None;
        let mut before = '[';
        for (at, letter) in self.text[open..].char_indices() {
            match (quote, letter) {
                (Some(end), _) if letter == end => quote = None,
                (Some(_), _) => {}
                (None, '"' | '\'') if "[{,:".contains(before) => quote = Some(letter),
                (None, '[' | '{') => opened.push(letter),
                (None, ']' | '}') => match opened.pop() {
                    Some(last) if closing(last) == letter => {}
                    _ => return (letter == close).then_some(open + at),
                },
                _ => {}
            }
            if !letter.is_whitespace() {
                before = letter;
            }
        }
        None
    }

    /// Reports a dash without a space after it, at the start of the line or of the line before.
    fn glued_dash(&self) -> Option<Diagnostic> {
        self.lines_near().find_map(|start| {
            let from = start + self.indent(start);
            dash_fault(self.source, from, self.line(from))
        })
    }

    /// Reports a missing space after a key in the line or in the line before.
    fn glued_key(&self) -> Option<Diagnostic> {
        self.lines_near().find_map(|start| {
            let mut from = start + self.indent(start);
            while let Some(rest) = self.text[from..].strip_prefix("- ") {
                from = self.text.len() - rest.trim_start_matches(' ').len();
            }
            let written = self.line(from);
            let (key, _) = glued(written)?;
            let span = Span::new(self.source, from..from + written.trim_end().len());
            let fault = fault(format!("expected a space after `{key}:`"));
            Some(fault.at(span, "").help(space_help(written)?))
        })
    }

    /// Reports a quote that is not closed.
    fn quote(&self, kind: &ErrorKind) -> Option<Diagnostic> {
        let is_open = matches!(
            kind,
            ErrorKind::InvalidQuotedScalarIndent
                | ErrorKind::UnclosedQuotedScalar
                | ErrorKind::DocumentIndicatorInQuotedScalar
        );
        let rest = self.text.get(self.parsed..).filter(|_| is_open)?;
        let open = self.parsed + rest.find(['"', '\''])?;
        let quote = self.text[open..].chars().next()?;
        let found = fault("the quote is not closed").at(self.character(open), "opened here");
        Some(found.help(format!("write the closing `{quote}` in the same line")))
    }

    /// Reports a line that begins in a column in which no line above begins.
    fn indentation(&self, kind: &ErrorKind) -> Option<Diagnostic> {
        let concerns_columns = matches!(
            kind,
            ErrorKind::ExpectedBlockMappingKey
                | ErrorKind::ExpectedBlockSequenceEntry
                | ErrorKind::MappingValueNotAllowed
                | ErrorKind::BlockSequenceEntryNotAllowed
                | ErrorKind::InvalidIndentation
        );
        if !concerns_columns || self.bracket.is_some() {
            return None;
        }
        let start = self.start_of(self.at);
        let indent = self.indent(start);
        let content = self.line(start + indent).trim_end();
        let span = Span::new(self.source, start + indent..start + indent + content.len());
        let is_entry = content == "-" || content.starts_with("- ");
        let mut begins = self.begins_above(start, is_entry);
        let is_known = begins.iter().any(|(column, ..)| *column == indent);
        if is_known || self.opens_above(start, indent) {
            return None;
        }
        // The nearest columns first.
        begins.sort_by_key(|(column, ..)| column.abs_diff(indent));
        let like = |(column, name, line): &(usize, &str, usize)| {
            let spaces = if *column == 1 { "space" } else { "spaces" };
            format!("`{name}` in line {line} ({column} {spaces})")
        };
        let likes: Vec<String> = begins.iter().take(2).map(like).collect();
        if likes.is_empty() {
            let found = fault("expected a key, found a list entry")
                .at(span, "")
                .help("remove the dash, or write the key of the list in a line before its entries");
            return is_entry.then_some(found);
        }
        let found = fault("no line above has the indentation of this line").at(span, "");
        Some(found.help(format!("indent it like {}", likes.join(", or like "))))
    }

    /// Returns whether the line above is a key whose value can begin in this column of the next line.
    fn opens_above(&self, start: usize, column: usize) -> bool {
        let mut above = self.text[..start].lines().rev();
        let content = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
        above.find(content).is_some_and(|line| {
            let indent = line.len() - line.trim_start_matches([' ', '-']).len();
            line.trim_end().ends_with(':') && indent < column
        })
    }

    /// Returns where the keys, or the entries of lists, begin to which a line could belong: the column, the key, and
    /// the number of the line.
    fn begins_above(&self, start: usize, entries: bool) -> Vec<(usize, &str, usize)> {
        let mut found = Vec::new();
        let mut least = usize::MAX;
        let above: Vec<&str> = self.text[..start].lines().collect();
        for (number, line) in above.iter().enumerate().rev() {
            let mut content = line.trim_start_matches(' ');
            if content.is_empty() || content.starts_with('#') {
                continue;
            }
            let indent = line.len() - content.len();
            let mut column = indent;
            while let Some(rest) = content.strip_prefix("- ") {
                if entries && column < least {
                    found.push((column, "-", number + 1));
                }
                let inside = rest.trim_start_matches(' ');
                column += content.len() - inside.len();
                content = inside;
            }
            if let Some(key) = key_of(content).filter(|_| !entries && column < least) {
                found.push((column, key, number + 1));
            }
            least = least.min(indent);
            if least == 0 {
                break;
            }
        }
        found
    }

    /// Reports a key without a colon, and characters with which no plain text begins.
    fn word(&self, kind: &ErrorKind) -> Option<Diagnostic> {
        let written = self.line(self.at).trim_end();
        let span = Span::new(self.source, self.at..self.at + written.len());
        match kind {
            ErrorKind::SimpleKeyExpected => {
                let (key, value) = assignment(written.trim_start_matches("- "))?;
                let found = fault(format!("expected `:` after `{key}`")).at(span, "");
                Some(found.help(format!("write `{key}: {}`", shown(value))))
            }
            ErrorKind::UnknownAnchor => {
                let name = written.strip_prefix('*')?.split([',', '}', ']', '#', ' ']).next()?;
                let span = Span::new(self.source, self.at..self.at + 1 + name.len());
                let found = fault(format!("no anchor `&{}` comes before this alias", shown(name))).at(span, "");
                Some(found.help(format!(
                    "define it earlier, or write the text in quotes: `\"*{}\"`",
                    shown(name)
                )))
            }
            ErrorKind::UnexpectedCharacter { .. } => {
                let first = written.chars().next()?;
                let value = written.split([',', '}', ']', '#']).next()?.trim_end();
                if value.is_empty() {
                    return None;
                }
                let span = Span::new(self.source, self.at..self.at + value.len());
                let found = fault(format!("a text without quotes cannot begin with `{first}`")).at(span, "");
                Some(found.help(format!("write it in quotes: `\"{}\"`", shown(value))))
            }
            _ => None,
        }
    }
}

fn fault(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::YAML_SYNTAX, message)
}

fn closing(open: char) -> char {
    if open == '{' { '}' } else { ']' }
}

/// Shortens a text for a message.
fn shown(text: &str) -> String {
    let start: String = text.chars().take(SHOWN).collect();
    let more = if start.len() < text.len() { "..." } else { "" };
    start + more
}

/// Returns the key with which a line begins.
fn key_of(line: &str) -> Option<&str> {
    let (key, rest) = line.split_once(':')?;
    let is_key = (rest.is_empty() || rest.starts_with(' ')) && !key.contains(['{', '[', '"', '\'', '#']);
    (is_key && !key.is_empty()).then_some(key)
}

/// Splits `view 40` and `view = 40` into key and value.
pub(super) fn assignment(text: &str) -> Option<(&str, &str)> {
    let (key, value) = text.split_once('=').or_else(|| text.split_once(' '))?;
    let (key, value) = (key.trim(), value.trim());
    (is_word(key) && !value.is_empty()).then_some((key, value))
}

/// Reports a dash at the start of a line, or of a key, that a space must follow; it is at byte `from`.
pub(super) fn dash_fault(source: SourceId, from: usize, line: &str) -> Option<Diagnostic> {
    let line = line.trim_end();
    let entry = line.strip_prefix('-')?;
    let is_entry = entry.starts_with(|c: char| c.is_ascii_alphabetic() || "{[\"'".contains(c));
    let found = fault("expected a space after the dash").at(Span::new(source, from..from + line.len()), "");
    is_entry.then(|| found.help(format!("put a space after the dash: `- {}`", shown(entry))))
}

/// Returns the help for a plain text that would be a key and a value with a space after its first colon.
pub(super) fn space_help(text: &str) -> Option<String> {
    let (key, value) = glued(text)?;
    Some(format!("put a space after the colon: `{key}: {}`", shown(value)))
}

/// Splits `view:40` into key and value. `None` if the text does not begin with a word and a colon, or if it is a URL.
pub(super) fn glued(text: &str) -> Option<(&str, &str)> {
    let (key, value) = text.split_once(':')?;
    let is_value = value.starts_with(|c: char| !c.is_whitespace()) && !value.starts_with("//");
    (is_word(key) && is_value).then_some((key, value.trim_end()))
}

fn is_word(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c))
}
