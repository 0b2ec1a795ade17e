//! Pieces of text as the preprocessor sees them: names, numbers, strings and single characters.

use crate::diag::{SourceId, Span};
use crate::syntax::lexer::{is_name_part, is_name_start};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PieceKind {
    Name,
    Number,
    /// A string with its quotes.
    String,
    /// Any other character, and `##`.
    Other,
    /// No text: the end of the expansion of the macro with this number.
    End(u32),
}

/// The white space before a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Space {
    None,
    Blank,
    /// With a line break.
    Line,
}

/// The text of a piece, as a range of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PieceText {
    Source(SourceId),
    /// Text that the preprocessor made.
    Made,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub kind: PieceKind,
    pub space: Space,
    /// Whether this name was met during the expansion of its own macro, so that it never expands.
    pub painted: bool,
    pub text: PieceText,
    pub start: u32,
    pub end: u32,
    /// The place in the file that the user wrote; `None` in the definition of a macro.
    pub place: Option<Span>,
    /// The innermost use of a macro that wrote the piece.
    pub used: Option<u32>,
}

impl Piece {
    /// Returns the place of a piece that no macro made.
    pub(super) fn span(&self) -> Option<Span> {
        match self.text {
            PieceText::Source(source) => Some(Span::new(source, self.start as usize..self.end as usize)),
            PieceText::Made => None,
        }
    }
}

/// Reads the pieces of a range of a source.
#[derive(Clone, Debug)]
pub(super) struct Pieces<'t> {
    pub source: SourceId,
    pub text: &'t str,
    pub at: usize,
    pub end: usize,
}

/// Returns the number of bytes of a comment, of a line break after a backslash, or of one other white space with which
/// `text` begins, and the white space it stands for.
pub(super) fn space_of(text: &str) -> Option<(usize, Space)> {
    let bytes = text.as_bytes();
    Some(match bytes {
        [b'\n', ..] => (1, Space::Line),
        [b' ' | b'\t' | b'\r' | 0x0b | 0x0c, ..] => (1, Space::Blank),
        [b'\\', b'\n', ..] => (2, Space::Line),
        [b'\\', b'\r', b'\n', ..] => (3, Space::Line),
        [b'/', b'/', ..] => (text.find('\n').unwrap_or(text.len()), Space::Blank),
        [b'/', b'*', ..] => (
            text[2..].find("*/").map_or(text.len(), |length| length + 4),
            Space::Blank,
        ),
        _ => return None,
    })
}

/// Returns the length of the string with which `text` begins. One without a closing quote ends with its line.
pub(super) fn string_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let mut at = 1;
    loop {
        match bytes.get(at) {
            None | Some(b'\n') => return at,
            Some(b'"') => return at + 1,
            Some(b'\\') if !matches!(bytes.get(at + 1), None | Some(b'\n')) => at += 2,
            Some(_) => at += 1,
        }
    }
}

/// Returns the number of bytes of the name or number with which `text` begins.
pub(super) fn word_length(text: &str) -> usize {
    text.bytes().take_while(|&byte| is_name_part(byte)).count()
}

/// Returns the kind and the length of the piece with which `text` begins, which is neither empty nor white space.
pub(super) fn piece_of(text: &str) -> (PieceKind, usize) {
    let byte = text.as_bytes()[0];
    match byte {
        b'"' => (PieceKind::String, string_length(text)),
        b'0'..=b'9' => (PieceKind::Number, word_length(text)),
        b'#' if text.starts_with("##") => (PieceKind::Other, 2),
        _ if is_name_start(byte) => (PieceKind::Name, word_length(text)),
        _ => (PieceKind::Other, text.chars().next().map_or(1, char::len_utf8)),
    }
}

impl Iterator for Pieces<'_> {
    type Item = Piece;

    fn next(&mut self) -> Option<Piece> {
        let mut space = Space::None;
        while let Some((length, found)) = space_of(&self.text[self.at..self.end]) {
            space = space.max(found);
            self.at += length;
        }
        if self.at >= self.end {
            return None;
        }
        let (kind, length) = piece_of(&self.text[self.at..self.end]);
        let narrow = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
        let piece = Piece {
            kind,
            space,
            painted: false,
            text: PieceText::Source(self.source),
            start: narrow(self.at),
            end: narrow(self.at + length),
            place: Some(Span::new(self.source, self.at..self.at + length)),
            used: None,
        };
        self.at += length;
        Some(piece)
    }
}
