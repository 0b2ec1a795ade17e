//! Sources and positions in them.
//!
//! Besides the sources that users wrote there are derived ones: the text that the preprocessor made of some files, and
//! one copy of a file for each instance of a component. Spans in these are ordinary, so that the checker needs to know
//! nothing of macros and components; [`Sources::written`] maps them to what the user wrote.

use std::ops::Range;
use std::sync::Arc;

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
    text: Arc<String>,
    first_line: usize,
    line_starts: Vec<u32>,
    origin: Origin,
}

/// Where the text of a source comes from.
#[derive(Clone, Debug)]
pub(super) enum Origin {
    Written,
    /// The preprocessor wrote it.
    Expanded(Arc<Expansion>),
    /// The same text as that of `of`, for an instance of a component.
    Instance {
        of: SourceId,
        made: Span,
        label: String,
    },
}

/// How the preprocessor made a text from others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Expansion {
    /// The parts of the text, in order and without gaps.
    pub parts: Vec<Part>,
    pub uses: Vec<MacroUse>,
}

/// A part of a text that the preprocessor wrote, up to the start of the next part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    pub start: u32,
    /// The place that the part stands for. If `copied`, its first byte is that of the part; otherwise the part as a
    /// whole stands for the place.
    pub place: Span,
    pub copied: bool,
    /// The innermost use of a macro that wrote the part, as a position in [`Expansion::uses`].
    pub used: Option<u32>,
}

/// A use of a macro.
#[derive(Clone, Debug)]
pub(crate) struct MacroUse {
    pub name: Arc<str>,
    /// The place of the name in the definition.
    pub definition: Span,
    /// The place of the use, with its arguments.
    pub call: Span,
    /// The use whose macro has this use in its definition.
    pub within: Option<u32>,
    /// The text that replaces the outermost use.
    pub text: Range<usize>,
}

impl Expansion {
    /// Returns the part that contains a byte, and the byte after it.
    pub(super) fn part(&self, byte: usize) -> Option<(&Part, u32)> {
        let after = self.parts.partition_point(|part| part.start as usize <= byte);
        let part = self.parts.get(after.checked_sub(1)?)?;
        Some((part, self.parts.get(after).map_or(u32::MAX, |next| next.start)))
    }

    /// Returns the place of a range.
    fn written(&self, range: Range<usize>) -> Option<Span> {
        let (first, _) = self.part(range.start)?;
        let at = |part: &Part, byte: usize| part.place.start + (byte - part.start as usize) as u32;
        let start = match first.copied {
            true => Span {
                start: at(first, range.start),
                end: at(first, range.start),
                ..first.place
            },
            false => first.place,
        };
        let (last, _) = self.part(range.end.max(range.start + 1) - 1)?;
        let end = match last.copied {
            true => Span {
                start: at(last, range.end),
                end: at(last, range.end),
                ..last.place
            },
            false => last.place,
        };
        Some(start.to(end))
    }
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
        self.push(name.into(), text.into(), first_line, Origin::Written)
    }

    fn push(&mut self, name: String, text: String, first_line: usize, origin: Origin) -> SourceId {
        let mut line_starts = vec![0];
        let breaks = text.match_indices('\n');
        line_starts.extend(breaks.map(|(index, _)| u32::try_from(index + 1).unwrap_or(u32::MAX)));
        self.list.push(Source {
            name,
            text: Arc::new(text),
            first_line,
            line_starts,
            origin,
        });
        SourceId(u32::try_from(self.list.len() - 1).expect("fewer than 2^32 sources"))
    }

    /// Adds the text that the preprocessor made of a file.
    pub(crate) fn add_expanded(&mut self, name: &str, text: String, expansion: Expansion) -> SourceId {
        self.push(name.to_owned(), text, 1, Origin::Expanded(Arc::new(expansion)))
    }

    /// Adds a copy of a source for an instance of a component. Diagnostics in it also have the label `label` at `made`.
    pub(crate) fn add_instance(&mut self, of: SourceId, made: Span, label: String) -> SourceId {
        let (name, text) = (self.name(of).to_owned(), String::new());
        self.push(name, text, 1, Origin::Instance { of, made, label })
    }

    /// Returns the ids of the sources that users wrote, in order of addition.
    pub fn ids(&self) -> impl Iterator<Item = SourceId> + use<> {
        let is_written = |source: &Source| matches!(source.origin, Origin::Written);
        let written: Vec<bool> = self.list.iter().map(is_written).collect();
        (0..u32::try_from(written.len()).expect("fewer than 2^32 sources"))
            .map(SourceId)
            .filter(move |id| written[id.0 as usize])
    }

    /// Returns the source whose text this one has.
    pub(super) fn base(&self, id: SourceId) -> SourceId {
        let mut id = id;
        while let Origin::Instance { of, .. } = self.list[id.0 as usize].origin {
            id = of;
        }
        id
    }

    /// Returns the place that the user wrote: before the expansion of macros, and in the component that an instance
    /// copies.
    pub fn written(&self, span: Span) -> Span {
        let source = self.base(span.source);
        match &self.list[source.0 as usize].origin {
            Origin::Expanded(expansion) => expansion.written(span.range()).unwrap_or(Span { source, ..span }),
            _ => Span { source, ..span },
        }
    }

    pub(super) fn origin(&self, id: SourceId) -> &Origin {
        &self.list[id.0 as usize].origin
    }

    /// Returns the name of the source in which the user wrote a span.
    pub fn file(&self, span: Span) -> &str {
        self.name(self.written(span).source)
    }

    /// Returns the name of a source.
    pub fn name(&self, id: SourceId) -> &str {
        &self.list[id.0 as usize].name
    }

    /// Returns a source.
    pub fn text(&self, id: SourceId) -> &str {
        &self.list[self.base(id).0 as usize].text
    }

    /// Returns the text of a source, which may outlive the borrow.
    pub(crate) fn shared_text(&self, id: SourceId) -> Arc<String> {
        self.list[self.base(id).0 as usize].text.clone()
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

    /// Returns the position where a span begins, as the user wrote it.
    pub fn position(&self, span: Span) -> Position {
        let span = self.written(span);
        self.position_of(span.source, span.start as usize)
    }

    /// Returns the position of a byte.
    pub fn position_of(&self, id: SourceId, byte: usize) -> Position {
        let id = self.base(id);
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
        let span = self.written(span);
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
