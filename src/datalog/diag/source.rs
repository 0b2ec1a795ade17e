//! Sources and positions in them.

use std::ops::Range;

/// The id of a source in [`Sources`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SourceId(u32);

/// A range of bytes in one source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    /// The text.
    pub source: SourceId,
    /// First byte.
    pub start: u32,
    /// One past the last byte.
    pub end: u32,
}

impl Span {
    /// Creates a span over `range` of `source`.
    pub fn new(source: SourceId, range: Range<usize>) -> Self {
        let clamp = |byte: usize| u32::try_from(byte).unwrap_or(u32::MAX);
        Span {
            source,
            start: clamp(range.start),
            end: clamp(range.end),
        }
    }

    /// Returns the smallest span that covers both, or `self` if they lie in different sources.
    pub fn to(self, other: Span) -> Span {
        if self.source != other.source {
            return self;
        }
        Span {
            source: self.source,
            start: self.start.min(other.start),
            end: self.end.max(other.end),
        }
    }

    /// Returns the byte range.
    pub fn range(self) -> Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// A line and a column, both counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Position {
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

#[derive(Clone, Debug)]
struct Source {
    name: String,
    text: String,
    first_line: usize,
    line_starts: Vec<u32>,
}

/// The sources, each under the name that the user knows.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    list: Vec<Source>,
}

impl Sources {
    /// Creates an empty collection.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a source. Messages show the name; for a file, pass the path as the user gave it.
    pub fn add(&mut self, name: impl Into<String>, text: impl Into<String>) -> SourceId {
        self.add_from(name, text, 1)
    }

    /// Adds a part of a source that begins at line `first_line` of the whole, counted from 1.
    pub fn add_from(&mut self, name: impl Into<String>, text: impl Into<String>, first_line: usize) -> SourceId {
        let text = text.into();
        let mut line_starts = vec![0];
        let breaks = text.match_indices('\n');
        line_starts.extend(breaks.map(|(index, _)| u32::try_from(index + 1).unwrap_or(u32::MAX)));
        self.list.push(Source {
            name: name.into(),
            text,
            first_line,
            line_starts,
        });
        SourceId(u32::try_from(self.list.len() - 1).expect("fewer than 2^32 sources"))
    }

    /// Returns the ids of all sources in order of addition.
    pub fn ids(&self) -> impl Iterator<Item = SourceId> + use<> {
        (0..u32::try_from(self.list.len()).expect("fewer than 2^32 sources")).map(SourceId)
    }

    /// Returns the name of a source.
    pub fn name(&self, id: SourceId) -> &str {
        &self.list[id.0 as usize].name
    }

    /// Returns a source.
    pub fn text(&self, id: SourceId) -> &str {
        &self.list[id.0 as usize].text
    }

    /// Returns the part that a span covers. Clips spans to the source and to character boundaries.
    pub fn slice(&self, span: Span) -> &str {
        let text = self.text(span.source);
        let start = floor_char(text, span.start as usize);
        let end = floor_char(text, span.end as usize).max(start);
        &text[start..end]
    }

    /// Returns the number of a source's first line: 1 unless the source is a part of a longer one.
    pub fn first_line(&self, id: SourceId) -> usize {
        self.list[id.0 as usize].first_line
    }

    /// Returns the position where a span begins.
    pub fn position(&self, span: Span) -> Position {
        self.position_of(span.source, span.start as usize)
    }

    /// Returns the position of a byte.
    pub fn position_of(&self, id: SourceId, byte: usize) -> Position {
        let source = &self.list[id.0 as usize];
        let byte = floor_char(&source.text, byte);
        let line = self.line_index(id, byte);
        let column = source.text[source.line_starts[line] as usize..byte].chars().count();
        Position {
            line: line + source.first_line,
            column: column + 1,
        }
    }

    /// The index of the line that contains a byte, from 0.
    pub(super) fn line_index(&self, id: SourceId, byte: usize) -> usize {
        let starts = &self.list[id.0 as usize].line_starts;
        starts.partition_point(|&start| start as usize <= byte) - 1
    }

    /// The bytes of the line with this index, from 0, without its line break.
    pub(super) fn line_range(&self, id: SourceId, index: usize) -> Range<usize> {
        let Source { text, line_starts, .. } = &self.list[id.0 as usize];
        let start = line_starts[index] as usize;
        start..line_starts.get(index + 1).map_or(text.len(), |&next| next as usize - 1)
    }

    /// Returns `name:line:column` of the place where a span begins.
    pub fn locate(&self, span: Span) -> String {
        let Position { line, column } = self.position(span);
        format!("{}:{line}:{column}", self.name(span.source))
    }
}

/// The largest character boundary of `text` at or before `byte`.
fn floor_char(text: &str, byte: usize) -> usize {
    let mut byte = byte.min(text.len());
    while !text.is_char_boundary(byte) {
        byte -= 1;
    }
    byte
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_count_characters_from_one() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "αβ\nγδ\n");
        assert_eq!(sources.position_of(id, 0), Position { line: 1, column: 1 });
        assert_eq!(sources.position_of(id, 2), Position { line: 1, column: 2 });
        assert_eq!(sources.position_of(id, 5), Position { line: 2, column: 1 });
        assert_eq!(sources.position_of(id, 99), Position { line: 3, column: 1 });
        assert_eq!((sources.line_range(id, 1), sources.line_range(id, 2)), (5..9, 10..10));
        assert_eq!(sources.locate(Span::new(id, 7..9)), "a.dl:2:2");
        assert_eq!(sources.slice(Span::new(id, 7..9)), "δ");
    }
}
