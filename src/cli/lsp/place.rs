//! Positions as the protocol counts them (lines from 0, columns in the units of the client), and URIs.

use crate::diag::Span;
use lsp_types::{Position, Range};
use std::ops;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The unit of columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    Utf8,
    #[default]
    Utf16,
    Utf32,
}

impl Encoding {
    /// Returns the encoding with this name in the protocol.
    pub fn named(name: &str) -> Option<Encoding> {
        let all = [Encoding::Utf8, Encoding::Utf16, Encoding::Utf32];
        all.into_iter().find(|encoding| encoding.name() == name)
    }

    pub fn name(self) -> &'static str {
        match self {
            Encoding::Utf8 => "utf-8",
            Encoding::Utf16 => "utf-16",
            Encoding::Utf32 => "utf-32",
        }
    }

    fn units(self, c: char) -> usize {
        match self {
            Encoding::Utf8 => c.len_utf8(),
            Encoding::Utf16 => c.len_utf16(),
            Encoding::Utf32 => 1,
        }
    }

    fn length(self, text: &str) -> usize {
        match self {
            Encoding::Utf8 => text.len(),
            _ => text.chars().map(|c| self.units(c)).sum(),
        }
    }
}

/// The distance in bytes between two marks.
const STEP: usize = 1024;

/// A document with an index of its lines. A line ends with `\n`, `\r\n` or `\r`.
#[derive(Clone, Debug)]
pub struct Text {
    text: String,
    encoding: Encoding,
    /// The first byte of each line.
    starts: Vec<usize>,
    /// The number of units before every `STEP`th byte, so that the position of a byte in a long line needs no scan of
    /// the line.
    marks: OnceLock<Vec<usize>>,
}

impl Text {
    pub fn new(text: String, encoding: Encoding) -> Self {
        let starts = std::iter::once(0).chain(line_starts(&text)).collect();
        Text {
            text,
            encoding,
            starts,
            marks: OnceLock::new(),
        }
    }

    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Returns the position of a byte. A byte inside a character or a line break counts as its first.
    pub fn position(&self, byte: usize) -> Position {
        let byte = floor_char(&self.text, byte);
        let line = self.line(byte);
        let content = self.content(line);
        let column = self.units(content.start, byte.min(content.end));
        Position::new(narrow(line), narrow(column))
    }

    /// Returns the byte at a position. A position past the end of a line or text maps to that end, one inside a
    /// character to its first byte.
    pub fn byte(&self, position: Position) -> usize {
        let line = position.line as usize;
        if line >= self.starts.len() {
            return self.text.len();
        }
        let ops::Range { mut start, end } = self.content(line);
        let mut left = position.character as usize;
        if end - start > STEP {
            let target = self.units(0, start).saturating_add(left);
            let marks = self.marks();
            let after = marks.partition_point(|&units| units <= target);
            let mark = floor_char(&self.text, (after - 1) * STEP);
            if mark >= end {
                return end;
            }
            if mark > start {
                (start, left) = (mark, target - marks[after - 1]);
            }
        }
        for (at, c) in self.text[start..end].char_indices() {
            let units = self.encoding.units(c);
            if left < units {
                return start + at;
            }
            left -= units;
        }
        end
    }

    /// Returns the range of these bytes.
    pub fn range(&self, bytes: ops::Range<usize>) -> Range {
        let end = bytes.end.max(bytes.start);
        Range::new(self.position(bytes.start), self.position(end))
    }

    pub fn range_of(&self, span: Span) -> Range {
        self.range(span.range())
    }

    pub fn whole(&self) -> Range {
        self.range(0..self.text.len())
    }

    /// Returns the bytes of a line without its line break.
    pub fn content(&self, line: usize) -> ops::Range<usize> {
        let start = self.starts[line];
        let Some(&next) = self.starts.get(line + 1) else {
            return start..self.text.len();
        };
        let end = match &self.text.as_bytes()[start..next] {
            [.., b'\r', b'\n'] => next - 2,
            _ => next - 1,
        };
        start..end
    }

    /// Returns the line of a byte.
    pub fn line(&self, byte: usize) -> usize {
        self.starts.partition_point(|&start| start <= byte) - 1
    }

    /// Returns the number of units between two bytes.
    pub fn units(&self, from: usize, to: usize) -> usize {
        if self.encoding == Encoding::Utf8 {
            return to - from;
        }
        match to - from > STEP {
            true => self.units_before(to) - self.units_before(from),
            false => self.encoding.length(&self.text[from..to]),
        }
    }

    fn units_before(&self, byte: usize) -> usize {
        let mark = byte / STEP;
        let from = floor_char(&self.text, mark * STEP);
        self.marks()[mark] + self.encoding.length(&self.text[from..byte])
    }

    fn marks(&self) -> &[usize] {
        self.marks.get_or_init(|| {
            let mut marks = vec![0];
            let (mut units, mut from) = (0, 0);
            for at in (STEP..=self.text.len()).step_by(STEP) {
                let to = floor_char(&self.text, at);
                units += self.encoding.length(&self.text[from..to]);
                marks.push(units);
                from = to;
            }
            marks
        })
    }

    /// Replaces bytes. The range may be reversed; its ends must lie between characters.
    pub fn replace(&mut self, bytes: ops::Range<usize>, new: &str) {
        let bytes = bytes.start.min(bytes.end)..bytes.start.max(bytes.end);
        // The line before the change may end in `\r`, which makes one line break with a `\n` after it.
        let first = self.line(bytes.start).saturating_sub(1);
        let last = self.line(bytes.end);
        let from = self.starts[first];
        let move_by = |start: usize| start - bytes.len() + new.len();
        let to = move_by(self.starts.get(last + 1).copied().unwrap_or(self.text.len()));
        self.text.replace_range(bytes.clone(), new);
        self.marks = OnceLock::new();
        let fresh: Vec<usize> = line_starts(&self.text[from..to]).map(|start| from + start).collect();
        let end = (last + 2).min(self.starts.len());
        for start in &mut self.starts[end..] {
            *start = move_by(*start);
        }
        self.starts.splice(first + 1..end, fresh);
    }
}

/// Returns the first byte of each line but the first.
fn line_starts(text: &str) -> impl Iterator<Item = usize> {
    let bytes = text.as_bytes();
    let ends = bytes.iter().enumerate().filter(|&(at, byte)| match byte {
        b'\n' => true,
        b'\r' => bytes.get(at + 1) != Some(&b'\n'),
        _ => false,
    });
    ends.map(|(at, _)| at + 1)
}

/// Returns the largest character boundary at or before `byte`.
fn floor_char(text: &str, byte: usize) -> usize {
    let mut byte = byte.min(text.len());
    while !text.is_char_boundary(byte) {
        byte -= 1;
    }
    byte
}

fn narrow(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// Returns the path of a `file:` URI. For other schemes, returns the URI itself as the name of the unsaved document.
pub fn path_of(uri: &str) -> PathBuf {
    let Some(rest) = uri.strip_prefix("file://") else {
        return PathBuf::from(uri);
    };
    let rest = &rest[rest.find('/').unwrap_or(rest.len())..];
    let mut bytes = Vec::with_capacity(rest.len());
    let mut at = 0;
    while let Some(&byte) = rest.as_bytes().get(at) {
        let digits = (byte == b'%').then(|| rest.get(at + 1..at + 3)).flatten();
        match digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(decoded) => {
                bytes.push(decoded);
                at += 3;
            }
            None => {
                bytes.push(byte);
                at += 1;
            }
        }
    }
    let path = String::from_utf8_lossy(&bytes).into_owned();
    // `/C:/rules/a.dl`
    match path.as_bytes() {
        [b'/', drive, b':', ..] if drive.is_ascii_alphabetic() => PathBuf::from(&path[1..]),
        _ => PathBuf::from(path),
    }
}

/// Returns the URI of an absolute path.
pub fn uri_of(path: &Path) -> Option<String> {
    if !path.is_absolute() {
        return None;
    }
    let path = path.to_str()?.replace('\\', "/");
    let mut uri = String::from(if path.starts_with('/') { "file://" } else { "file:///" });
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => uri.push(char::from(byte)),
            _ => uri += &format!("%{byte:02X}"),
        }
    }
    Some(uri)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::cases;
    use proptest::prelude::*;

    /// The position of a byte by the words of the protocol.
    fn position(text: &str, byte: usize, encoding: Encoding) -> Position {
        let before = text[..byte].replace("\r\n", "\n").replace('\r', "\n");
        // A `\r` before the byte may belong to a `\r\n` that continues after it.
        let inside = text[..byte].ends_with('\r') && text[byte..].starts_with('\n');
        let before = if inside { &before[..before.len() - 1] } else { &before };
        let last = before.rsplit('\n').next().unwrap();
        let column = match encoding {
            Encoding::Utf8 => last.len(),
            Encoding::Utf16 => last.encode_utf16().count(),
            Encoding::Utf32 => last.chars().count(),
        };
        Position::new(narrow(before.matches('\n').count()), narrow(column))
    }

    fn texts() -> impl Strategy<Value = String> {
        proptest::collection::vec(
            prop_oneof!["[a\u{e9}\u{1f697}\r\n]", "\r\n", "[b\u{1f697}]{400,1200}"],
            0..12,
        )
        .prop_map(|parts| parts.concat())
    }

    fn encodings() -> impl Strategy<Value = Encoding> {
        proptest::sample::select(vec![Encoding::Utf8, Encoding::Utf16, Encoding::Utf32])
    }

    proptest! {
        #![proptest_config(cases(128))]

        #[test]
        fn every_byte_has_a_position_that_leads_back(text in texts(), encoding in encodings()) {
            let indexed = Text::new(text.clone(), encoding);
            for (byte, _) in text.char_indices().chain([(text.len(), ' ')]).step_by(1 + text.len() / 300) {
                let found = indexed.position(byte);
                prop_assert_eq!(found, position(&text, byte, encoding));
                let inside = text[..byte].ends_with('\r') && text[byte..].starts_with('\n');
                prop_assert_eq!(indexed.byte(found), byte - usize::from(inside));
            }
        }

        #[test]
        fn the_index_of_lines_follows_edits(
            text in texts(),
            edits in proptest::collection::vec((0_usize..9000, 0_usize..9000, texts()), 1..6),
        ) {
            let (mut indexed, mut plain) = (Text::new(text.clone(), Encoding::Utf16), text);
            for (one, other, new) in edits {
                let [one, other] = [one, other].map(|byte| floor_char(&plain, byte));
                indexed.replace(one..other, &new);
                plain.replace_range(one.min(other)..one.max(other), &new);
                let fresh = Text::new(plain.clone(), Encoding::Utf16);
                prop_assert_eq!(&indexed.text, &plain);
                prop_assert_eq!(&indexed.starts, &fresh.starts);
                prop_assert_eq!(indexed.whole(), fresh.whole());
            }
        }
    }

    #[test]
    fn positions_beyond_an_end_map_to_that_end() {
        let text = Text::new("a\u{e9}\u{1f697}b\r\n\n\u{1f697}\u{1f697}x".to_owned(), Encoding::Utf16);
        assert_eq!(text.byte(Position::new(0, 3)), 3, "in the middle of a pair");
        assert_eq!(text.byte(Position::new(0, 99)), 8, "before the line break");
        assert_eq!(text.byte(Position::new(0, u32::MAX)), 8);
        assert_eq!(text.byte(Position::new(1, 1)), 10);
        assert_eq!(text.byte(Position::new(99, 0)), text.as_str().len());
        let long = Text::new("\u{1f697}".repeat(5000) + "\nb", Encoding::Utf16);
        assert_eq!(long.byte(Position::new(0, u32::MAX)), 20_000);
        assert_eq!(long.byte(Position::new(0, 9_999)), 19_996);
        assert_eq!(long.position(19_996), Position::new(0, 9_998));
    }

    #[test]
    fn uris_and_paths_go_both_ways() {
        let path = Path::new("/rules of the road/\u{e9}%.dl");
        let uri = uri_of(path).unwrap();
        assert_eq!(uri, "file:///rules%20of%20the%20road/%C3%A9%25.dl");
        assert_eq!(path_of(&uri), path);
        assert_eq!(path_of("file:///C%3A/a.dl"), Path::new("C:/a.dl"));
        assert_eq!(path_of("untitled:Untitled-1"), Path::new("untitled:Untitled-1"));
        assert_eq!(uri_of(Path::new("untitled:Untitled-1")), None);
    }
}
