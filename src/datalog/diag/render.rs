//! Renders diagnostics for a terminal and as JSON.

use crate::diag::{Diagnostic, Label, Severity, SourceId, Sources, Span, neutral};
use annotate_snippets::{Annotation, AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use serde_json::error::Category;
use serde_json::{Value, json};
use std::ops::RangeInclusive;

/// The maximum length in bytes of a source line to show. For a longer line the output has only its place.
const MAX_LINE: usize = 2000;

/// Places with more lines between them are shown in separate excerpts.
const MAX_GAP: usize = 200;

/// The number of further places of a diagnostic to name.
const PLACES_SHOWN: usize = 3;

/// Renders diagnostics as text with source lines and carets, separated by blank lines. Those that differ only in their
/// place are one, with a note about the other places. `color` adds terminal styles. Text of users, names of files
/// included, is [`neutral`].
pub fn render(diagnostics: &[Diagnostic], sources: &Sources, color: bool) -> String {
    let renderer = if color { Renderer::styled() } else { Renderer::plain() };
    let traced = sources.all_traced(diagnostics);
    let mut different: Vec<(&Diagnostic, Vec<Span>)> = Vec::new();
    for diagnostic in &traced {
        let known = different.iter_mut().find(|(known, _)| known.repeats(diagnostic));
        match (known, &diagnostic.primary) {
            (Some((_, places)), Some(label)) => places.push(label.span),
            _ => different.push((diagnostic, Vec::new())),
        }
    }
    let mut out = String::new();
    for (index, (diagnostic, places)) in different.into_iter().enumerate() {
        if index > 0 {
            out.push('\n');
        }
        let rendered = match places.is_empty() {
            true => render_one(diagnostic, sources, &renderer),
            false => render_one(&diagnostic.clone().note(also_at(&places, sources)), sources, &renderer),
        };
        out.push_str(&rendered);
        out.push('\n');
    }
    out
}

/// Names the further places of a diagnostic.
fn also_at(places: &[Span], sources: &Sources) -> String {
    let shown = places.iter().take(PLACES_SHOWN);
    let shown: Vec<String> = shown.map(|&span| sources.locate(span)).collect();
    let also = match &shown[..] {
        [most @ .., last] if !most.is_empty() && places.len() <= PLACES_SHOWN => {
            format!("{} and {last}", most.join(", "))
        }
        _ => shown.join(", "),
    };
    match places.len() - shown.len() {
        0 => format!("also at {also}"),
        1 => format!("also at {also} and 1 more place"),
        more => format!("also at {also} and {more} more places"),
    }
}

fn render_one(diagnostic: &Diagnostic, sources: &Sources, renderer: &Renderer) -> String {
    let level = match diagnostic.severity() {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let mut group = Group::with_title(
        level
            .primary_title(neutral(&diagnostic.message))
            .id(diagnostic.code.name()),
    );
    let labels = (diagnostic.primary.iter().map(|label| (AnnotationKind::Primary, label))).chain(
        diagnostic
            .secondary
            .iter()
            .map(|label| (AnnotationKind::Context, label)),
    );
    for excerpt in excerpts(labels, sources) {
        let Excerpt { source, lines, labels } = &excerpt;
        let name = neutral(sources.name(*source));
        let is_long = |line: usize| sources.line_range(*source, line).len() > MAX_LINE;
        if lines.clone().any(is_long) {
            for (_, label) in labels {
                let position = sources.position(label.span);
                let place = Origin::path(name.clone())
                    .line(position.line)
                    .char_column(position.column);
                group = group.element(place);
                if !label.message.is_empty() {
                    group = group.element(Level::NOTE.message(neutral(&label.message)));
                }
            }
            continue;
        }
        let start = sources.line_range(*source, *lines.start()).start;
        let end = sources.line_range(*source, *lines.end()).end;
        let text = &sources.text(*source)[start..end];
        // A carriage return before a line feed is part of the line break.
        let text = text.replace("\r\n", " \n");
        let snippet = Snippet::source(neutral(&text).into_owned())
            .line_start(sources.first_line(*source) + lines.start())
            .path(name);
        let annotations = labels
            .iter()
            .map(|(kind, label)| annotation(*kind, label, &text, start));
        group = group.element(snippet.annotations(annotations));
    }
    for note in &diagnostic.notes {
        group = group.element(Level::NOTE.message(neutral(note)));
    }
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(neutral(help)));
    }
    renderer.render(&[group])
}

/// Nearby labels of one source, and the range of their lines, counted from 0.
struct Excerpt<'a> {
    source: SourceId,
    lines: RangeInclusive<usize>,
    labels: Vec<(AnnotationKind, &'a Label)>,
}

/// Groups labels into excerpts that contain only nearby lines, so that rendering time does not depend on the size of
/// the text. The excerpt with the first (primary) label comes first; the others follow in order of source and text.
fn excerpts<'a>(labels: impl Iterator<Item = (AnnotationKind, &'a Label)>, sources: &Sources) -> Vec<Excerpt<'a>> {
    let mut labels: Vec<_> = labels.collect();
    let Some(&(_, first)) = labels.first() else {
        return Vec::new();
    };
    labels.sort_by_key(|(_, label)| (label.span.source != first.span.source, label.span));
    let mut found: Vec<Excerpt<'_>> = Vec::new();
    for (kind, label) in labels {
        let (source, bytes) = (label.span.source, label.span.range());
        let start = sources.line_index(source, bytes.start.min(sources.text(source).len()));
        let end = sources.line_index(source, bytes.end.min(sources.text(source).len()));
        // For a label that spans more lines, show only its beginning.
        let end = if end.saturating_sub(start) > MAX_GAP {
            start
        } else {
            end.max(start)
        };
        match found.last_mut() {
            Some(last) if last.source == source && start <= last.lines.end() + MAX_GAP => {
                last.lines = *last.lines.start()..=end.max(*last.lines.end());
                last.labels.push((kind, label));
            }
            _ => found.push(Excerpt {
                source,
                lines: start..=end,
                labels: vec![(kind, label)],
            }),
        }
    }
    let leads = |excerpt: &Excerpt<'_>| excerpt.labels.iter().any(|(_, label)| std::ptr::eq(*label, first));
    found.sort_by_key(|excerpt| !leads(excerpt));
    found
}

/// Places a label in a part of the text that begins at byte `offset`.
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
    let shown = |end: usize| neutral(&text[..end]).len();
    let annotation = kind.span(shown(start)..shown(end));
    if label.message.is_empty() {
        annotation
    } else {
        annotation.label(neutral(&label.message))
    }
}

/// Returns what is wrong with a JSON text, without the position, in the words of JSON instead of Rust.
pub fn json_error(error: &serde_json::Error) -> String {
    match error.classify() {
        Category::Eof => "the JSON text ends too early".to_owned(),
        Category::Syntax | Category::Io => {
            let text = error.to_string();
            let reason = text.split(" at line ").next().unwrap_or(&text);
            format!("not JSON: {}", reason.replace("ident", "`true`, `false` or `null`"))
        }
        Category::Data => {
            let text = error.to_string();
            let mut reason = text.split(" at line ").next().unwrap_or(&text).to_owned();
            for (rust, json) in RUST_AND_JSON {
                reason = reason.replace(rust, json);
            }
            reason
        }
    }
}

/// Words of the JSON parser for Rust types, and those of JSON.
const RUST_AND_JSON: [(&str, &str); 11] = [
    ("floating point", "number"),
    ("expected i8", "expected an integer"),
    ("expected i32", "expected an integer"),
    ("expected i64", "expected an integer"),
    ("expected u8", "expected an integer"),
    ("expected u32", "expected an integer"),
    ("expected u64", "expected an integer"),
    ("expected usize", "expected an integer"),
    ("a sequence", "a list"),
    ("a map", "an object"),
    ("map, expected", "object, expected"),
];

/// Returns diagnostics as a JSON array. Each has `code`, `severity`, `message`, `labels`, `notes` and `help`. Each
/// label has `file`, `line`, `column`, `end_line`, `end_column`, `message` and `primary`; the primary one comes first.
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
    (sources.all_traced(diagnostics).iter())
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
    use crate::codes;
    use std::ops::Range;

    fn fault(source: SourceId, range: Range<usize>) -> Diagnostic {
        Diagnostic::new(codes::SYNTAX, "wrong").at(Span::new(source, range), "here")
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
    fn a_repeated_diagnostic_is_drawn_once_with_its_further_places() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "x\n".repeat(100));
        let other = sources.add("b.dl", "x\n");
        let at = |source, line: usize| fault(source, 2 * line..2 * line + 1);
        let note = |faults: &[Diagnostic]| {
            let text = render(faults, &sources, false);
            let notes = text.lines().filter_map(|line| line.split_once("note: "));
            (
                text.matches("error[").count(),
                notes.map(|(_, note)| note.to_owned()).collect::<Vec<_>>(),
            )
        };
        assert_eq!(note(&[at(id, 0)]), (1, vec![]));
        assert_eq!(
            note(&[at(id, 0), at(other, 0)]),
            (1, vec!["also at b.dl:1:1".to_owned()])
        );
        let some = [0, 4, 9].map(|line| at(id, line));
        assert_eq!(note(&some), (1, vec!["also at a.dl:5:1 and a.dl:10:1".to_owned()]));
        let many: Vec<Diagnostic> = (0..100).map(|line| at(id, line)).collect();
        let places = "also at a.dl:2:1, a.dl:3:1, a.dl:4:1 and 96 more places";
        assert_eq!(note(&many), (1, vec![places.to_owned()]));
        let helped = at(id, 1).help("do that");
        assert_eq!(
            note(&[at(id, 0), helped]),
            (2, vec![]),
            "another help makes it another fault"
        );
    }

    #[test]
    fn places_far_apart_are_shown_apart() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "first\n".to_owned() + &"between\n".repeat(5000) + "last");
        let end = sources.text(id).len();
        let fault = fault(id, end - 4..end).also(Span::new(id, 0..5), "there");
        let excerpts = excerpts(
            [&fault.primary.clone().expect("given"), &fault.secondary[0]]
                .into_iter()
                .map(|label| (AnnotationKind::Context, label)),
            &sources,
        )
        .into_iter()
        .map(|excerpt| excerpt.lines)
        .collect::<Vec<_>>();
        assert_eq!(excerpts, [5001..=5001, 0..=0]);
        let text = render(&[fault], &sources, false);
        let (last, first) = (text.find("5002 | last"), text.find("1 | first"));
        assert!(last.is_some() && first.is_some() && last < first, "{text}");
        assert!(!text.contains("between"), "{text}");
    }

    #[test]
    fn a_label_over_very_many_lines_is_shown_where_it_begins() {
        let mut sources = Sources::new();
        let id = sources.add("a.dl", "line\n".repeat(5000));
        let text = render(&[fault(id, 5..20_000)], &sources, false);
        assert!(text.contains("a.dl:2:1") && text.lines().count() < 10, "{text}");
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
