//! Draws diagnostics: for a terminal, and as JSON.

use super::{Diagnostic, Label, Severity, Sources, Span};
use annotate_snippets::{Annotation, AnnotationKind, Group, Level, Renderer, Snippet};
use serde_json::{Value, json};

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
        let text = sources.text(id);
        let mut snippet = Snippet::source(text)
            .line_start(sources.first_line(id))
            .path(sources.name(id));
        for (kind, label) in labels.iter().filter(|(_, label)| label.span.source == id) {
            snippet = snippet.annotation(annotation(*kind, label, text));
        }
        group = group.element(snippet);
    }
    for note in &diagnostic.notes {
        group = group.element(Level::NOTE.message(printable(note)));
    }
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(printable(help)));
    }
    renderer.render(&[group])
}

fn annotation<'a>(kind: AnnotationKind, label: &'a Label, text: &str) -> Annotation<'a> {
    let mut start = label.span.range().start.min(text.len());
    let mut end = label.span.range().end.clamp(start, text.len());
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
