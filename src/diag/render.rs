//! Draws diagnostics: for a terminal, and as JSON.

use super::{Diagnostic, Label, Severity, Sources, Span};
use annotate_snippets::{Annotation, AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use serde_json::{Value, json};
use std::ops::Range;

/// A line with more bytes is named, not shown.
const MAX_LINE: usize = 2000;

/// Draws diagnostics as text with source lines and carets, one blank line between them. `colour` adds terminal styles.
pub fn render(diagnostics: &[Diagnostic], sources: &Sources, colour: bool) -> String {
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    let mut out = String::new();
    for (index, diagnostic) in diagnostics.iter().enumerate() {
        if index > 0 {
            out.push('\n');
        }
        out.push_str(&render_one(diagnostic, sources, &renderer));
        out.push('\n');
    }
    out
}

fn render_one(diagnostic: &Diagnostic, sources: &Sources, renderer: &Renderer) -> String {
    let level = match diagnostic.severity() {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let mut group = Group::with_title(
        level
            .primary_title(printable(&diagnostic.message))
            .id(diagnostic.code.name()),
    );
    // One snippet per source, the primary one first; within a source the renderer orders by line.
    let mut labels: Vec<(AnnotationKind, &Label)> = Vec::new();
    labels.extend(diagnostic.primary.iter().map(|label| (AnnotationKind::Primary, label)));
    labels.extend(
        diagnostic
            .secondary
            .iter()
            .map(|label| (AnnotationKind::Context, label)),
    );
    let mut order = Vec::new();
    for (_, label) in &labels {
        if !order.contains(&label.span.source) {
            order.push(label.span.source);
        }
    }
    for id in order {
        let labels: Vec<(AnnotationKind, &Label)> = (labels.iter().copied())
            .filter(|(_, label)| label.span.source == id)
            .collect();
        group = match excerpt(sources.text(id), &labels) {
            Some((range, lines_before)) => {
                let text = &sources.text(id)[range.clone()];
                let snippet = Snippet::source(text)
                    .line_start(sources.first_line(id) + lines_before)
                    .path(sources.name(id));
                let annotations = labels
                    .iter()
                    .map(|(kind, label)| annotation(*kind, label, text, range.start));
                group.element(snippet.annotations(annotations))
            }
            None => labels.iter().fold(group, |group, (_, label)| {
                let position = sources.position(label.span);
                let place = Origin::path(sources.name(id))
                    .line(position.line)
                    .char_column(position.column);
                let group = group.element(place);
                if label.message.is_empty() {
                    group
                } else {
                    group.element(Level::NOTE.message(printable(&label.message)))
                }
            }),
        };
    }
    for note in &diagnostic.notes {
        group = group.element(Level::NOTE.message(printable(note)));
    }
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(printable(help)));
    }
    renderer.render(&[group])
}

/// The lines from the first label to the last, as a range of bytes and the number of lines before it. Whatever the size of the
/// text, only these are drawn. `None` if one of them is too long to be shown to anybody.
fn excerpt(text: &str, labels: &[(AnnotationKind, &Label)]) -> Option<(Range<usize>, usize)> {
    let bytes = text.as_bytes();
    let first = labels
        .iter()
        .map(|(_, label)| label.span.range().start)
        .min()?
        .min(bytes.len());
    let last = labels
        .iter()
        .map(|(_, label)| label.span.range().end)
        .max()?
        .clamp(first, bytes.len());
    let start = bytes[..first]
        .iter()
        .rposition(|&byte| byte == b'\n')
        .map_or(0, |at| at + 1);
    let end = bytes[last..]
        .iter()
        .position(|&byte| byte == b'\n')
        .map_or(bytes.len(), |at| last + at);
    let shown = &text[start..end];
    let lines_before = bytes[..start].iter().filter(|&&byte| byte == b'\n').count();
    (shown.lines().all(|line| line.len() <= MAX_LINE)).then_some((start..end, lines_before))
}

/// A label, in a part of the text that begins at byte `offset`.
fn annotation<'a>(kind: AnnotationKind, label: &'a Label, text: &str, offset: usize) -> Annotation<'a> {
    let inside = |byte: usize| byte.saturating_sub(offset).min(text.len());
    let (mut start, mut end) = (inside(label.span.range().start), inside(label.span.range().end));
    end = end.max(start);
    while !text.is_char_boundary(start) {
        start -= 1;
    }
    while !text.is_char_boundary(end) {
        end += 1;
    }
    let annotation = kind.span(start..end);
    if label.message.is_empty() {
        annotation
    } else {
        annotation.label(printable(&label.message))
    }
}

/// Text from a user's file may hold control characters; they must not reach a terminal.
fn printable(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() && c != '\n' { '\u{fffd}' } else { c })
        .collect()
}

/// Diagnostics as a JSON array. Each has `code`, `severity`, `message`, `labels` (the primary one first, with `file`, `line`,
/// `column`, `end_line`, `end_column`, `message`, `primary`), `notes` and `help`.
pub fn to_json(diagnostics: &[Diagnostic], sources: &Sources) -> Value {
    let label = |label: &Label, primary: bool| {
        let Span { source, end, .. } = label.span;
        let start = sources.position(label.span);
        let end = sources.position_of(source, end as usize);
        json!({
            "file": sources.name(source),
            "line": start.line,
            "column": start.column,
            "end_line": end.line,
            "end_column": end.column,
            "message": label.message,
            "primary": primary,
        })
    };
    diagnostics
        .iter()
        .map(|diagnostic| {
            let labels: Vec<Value> = (diagnostic.primary.iter().map(|l| label(l, true)))
                .chain(diagnostic.secondary.iter().map(|l| label(l, false)))
                .collect();
            json!({
                "code": diagnostic.code.name(),
                "severity": match diagnostic.severity() { Severity::Error => "error", Severity::Warning => "warning" },
                "message": diagnostic.message,
                "labels": labels,
                "notes": diagnostic.notes,
                "help": diagnostic.help,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diag::Code;

    fn fault(source: crate::diag::SourceId, range: Range<usize>) -> Diagnostic {
        Diagnostic::new(Code::Syntax, "wrong").at(Span::new(source, range), "here")
    }

    #[test]
    fn a_label_far_down_is_drawn_with_its_own_line_number() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "x\n".repeat(1000) + "αβγ δ\nend");
        let text = render(&[fault(id, 2000 + 7..2000 + 9)], &sources, false);
        for part in ["error[syntax]: wrong", "a.dl:1001:5", "1001 | αβγ δ", "^ here"] {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
        assert!(!text.contains("end"));
    }

    #[test]
    fn a_line_too_long_to_show_is_named() {
        let mut sources = Sources::new();
        let id = sources.add_from("a.json", "y".repeat(1 << 20), 7);
        let text = render(&[fault(id, 99_999..100_000)], &sources, false);
        assert!(text.contains("a.json:7:100000") && text.contains("here"), "{text}");
        assert!(text.len() < 200, "{text}");
    }

    #[test]
    fn spans_outside_of_the_text_or_inside_a_character_are_drawn_somewhere() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "αβ\n");
        for (start, end) in [(0, 0), (1, 3), (4, 5), (5, 5), (9, 99), (3, 1)] {
            assert!(render(&[fault(id, start..end)], &sources, false).contains("a.dl:"));
        }
    }
}
