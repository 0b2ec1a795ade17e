//! Positions as the protocol counts them (lines from 0, columns in UTF-16 code units), and URIs.

use crate::diag::{SourceId, Sources, Span};
use lsp_types::{Position, Range};
use std::path::{Path, PathBuf};

/// The line starts of a text.
pub struct Lines<'t> {
    text: &'t str,
    starts: Vec<usize>,
}

impl<'t> Lines<'t> {
    pub fn new(text: &'t str) -> Self {
        let breaks = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
        let starts = std::iter::once(0).chain(breaks.map(|(at, _)| at + 1)).collect();
        Lines { text, starts }
    }

    /// Returns the lines of one text of `sources`.
    pub fn of(sources: &'t Sources, id: SourceId) -> Self {
        Lines::new(sources.text(id))
    }

    /// Returns the position of a byte. A byte inside a character counts as the character's first.
    pub fn position(&self, byte: usize) -> Position {
        let mut byte = byte.min(self.text.len());
        while !self.text.is_char_boundary(byte) {
            byte -= 1;
        }
        let line = self.starts.partition_point(|&start| start <= byte) - 1;
        let before = &self.text[self.starts[line]..byte];
        let column = before.chars().map(char::len_utf16).sum();
        Position::new(narrow(line), narrow(column))
    }

    /// Returns the byte at a position. A position past the end of a line or text maps to that end, one inside a
    /// character to its first byte.
    pub fn byte(&self, position: Position) -> usize {
        let line = position.line as usize;
        let Some(&start) = self.starts.get(line) else {
            return self.text.len();
        };
        let end = self.starts.get(line + 1).map_or(self.text.len(), |next| next - 1);
        let mut left = position.character as usize;
        for (at, c) in self.text[start..end].char_indices() {
            if left < c.len_utf16() {
                return start + at;
            }
            left -= c.len_utf16();
        }
        end
    }

    pub fn range(&self, span: Span) -> Range {
        let bytes = span.range();
        Range::new(self.position(bytes.start), self.position(bytes.end.max(bytes.start)))
    }

    pub fn whole(&self) -> Range {
        Range::new(Position::new(0, 0), self.position(self.text.len()))
    }
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

    #[test]
    fn every_byte_has_a_position_that_leads_back() {
        let text = "a\u{e9}\u{1f697}b\r\n\n\u{1f697}\u{1f697}x";
        let lines = Lines::new(text);
        for (byte, _) in text.char_indices().chain([(text.len(), ' ')]) {
            // Reference implementation of the position of a byte.
            let before = &text[..byte];
            let last = before.rsplit('\n').next().unwrap();
            let expected = (before.matches('\n').count(), last.encode_utf16().count());
            let position = lines.position(byte);
            assert_eq!((position.line as usize, position.character as usize), expected);
            assert_eq!(lines.byte(position), byte);
        }
        assert_eq!(lines.byte(Position::new(0, 3)), 3, "in the middle of a pair");
        assert_eq!(lines.byte(Position::new(0, 99)), 9);
        assert_eq!(lines.byte(Position::new(99, 0)), text.len());
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
