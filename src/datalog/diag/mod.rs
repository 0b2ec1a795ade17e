//! Diagnostics: one type for every fault in a user's input.
//!
//! A parser or checker pushes a [`Diagnostic`] with spans into a list and continues. The caller draws the list later:
//! [`render()`] for a terminal, [`to_json`] for machines. A [`Diagnostic`] is complete when it is made, and it refers
//! to text through a [`Span`] into [`Sources`].
//!
//! This module does not depend on rules, configurations or cities.
// Decision: docs/decisions/language.md#d068

mod code;
pub mod codes;
mod explanation;
mod faults;
mod neutral;
mod render;
mod source;
mod trace;

pub use code::Code;
pub use explanation::{Catalog, Example, Explanation, explanations};
pub use faults::{Faults, MAX_FAULTS};
pub use neutral::neutral;
pub use render::{json_error, render, to_json};
pub(crate) use source::{Expansion, MacroUse, Part};
pub use source::{Position, SourceId, Sources, Span};
use std::borrow::Borrow;
use std::path::Path;

/// The severity of a [`Diagnostic`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// The input cannot be used.
    Error,
    /// The input can be used, but something in it is probably a mistake.
    Warning,
}

/// A place in a source with a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// The place.
    pub span: Span,
    /// The message; may be empty for the primary label.
    pub message: String,
}

/// One fault: what is wrong, where, what else is involved, and how to fix it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The stable name of the message.
    pub code: Code,
    /// One line, lower case, no full stop.
    pub message: String,
    /// The place of the fault; absent only if the fault has no place in any source.
    pub primary: Option<Label>,
    /// Other places that are involved.
    pub secondary: Vec<Label>,
    /// Explanations.
    pub notes: Vec<String>,
    /// Suggested fixes, in words.
    pub help: Vec<String>,
    /// Suggested fixes as edits, which an editor can apply.
    pub fixes: Vec<Fix>,
    /// The exceeded limit if the caller can raise it. The caller adds how: it knows its options.
    pub limit: Option<Limit>,
}

/// A limit on resources that a caller can raise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// The number of derived rows.
    Rows,
    /// The number of scanned rows.
    Steps,
    /// The memory, in bytes.
    Memory(u64),
}

/// A suggested change of the sources, for editors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fix {
    /// The effect of the change, in one line.
    pub title: String,
    /// The ranges to replace, which do not overlap, and their replacements.
    pub edits: Vec<(Span, String)>,
}

impl Diagnostic {
    /// Creates a diagnostic without a place; see [`Diagnostic::at`].
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        Diagnostic {
            code,
            message: message.into(),
            primary: None,
            secondary: Vec::new(),
            notes: Vec::new(),
            help: Vec::new(),
            fixes: Vec::new(),
            limit: None,
        }
    }

    /// The diagnostic of work that the caller cancelled.
    pub fn cancelled() -> Self {
        Diagnostic::new(codes::CANCELLED, "the work was cancelled")
    }

    /// Sets the primary place and its message.
    pub fn at(mut self, span: Span, message: impl Into<String>) -> Self {
        self.primary = Some(Label {
            span,
            message: message.into(),
        });
        self
    }

    /// Adds a secondary place with a message.
    pub fn also(mut self, span: Span, message: impl Into<String>) -> Self {
        self.secondary.push(Label {
            span,
            message: message.into(),
        });
        self
    }

    /// Adds an explanation.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }

    /// Adds a suggested fix.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help.push(help.into());
        self
    }

    /// Adds a suggested change of the sources.
    pub fn fix(mut self, title: impl Into<String>, edits: impl IntoIterator<Item = (Span, String)>) -> Self {
        self.fixes.push(Fix {
            title: title.into(),
            edits: edits.into_iter().collect(),
        });
        self
    }

    /// Sets the exceeded limit.
    pub fn exceeds(mut self, limit: Limit) -> Self {
        self.limit = Some(limit);
        self
    }

    /// Suggests the nearest name in words, and to write it at these places.
    pub fn did_you_mean(self, near: &str, places: &[Span]) -> Self {
        let edits = places.iter().map(|&place| (place, near.to_owned()));
        self.help(format!("did you mean `{near}`?"))
            .fix(format!("replace it with `{near}`"), edits)
    }

    /// Suggests to remove a place.
    pub fn remove(self, place: Span) -> Self {
        self.help("remove it").fix("remove it", [(place, String::new())])
    }

    /// Returns the severity, which depends on the code alone.
    pub fn severity(&self) -> Severity {
        self.code.severity()
    }

    /// Returns whether another diagnostic says the same about another place.
    pub fn repeats(&self, other: &Diagnostic) -> bool {
        let (Some(label), Some(other_label)) = (&self.primary, &other.primary) else {
            return false;
        };
        (self.code, &self.message, self.limit) == (other.code, &other.message, other.limit)
            && label.message == other_label.message
            && (&self.secondary, &self.notes, &self.help) == (&other.secondary, &other.notes, &other.help)
    }

    /// Returns whether this is an error, which makes the input unusable.
    pub fn is_error(&self) -> bool {
        self.severity() == Severity::Error
    }
}

/// Returns a number with its noun, whose plural ends in `s`: `1 row`, `2 rows`.
pub fn counted(count: impl std::fmt::Display, noun: &str) -> String {
    let count = count.to_string();
    let plural = if count == "1" { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Lists names for a message: the first 20, and the number of the others.
pub fn listed<S: Borrow<str>>(names: &[S]) -> String {
    const SHOWN: usize = 20;
    let (shown, rest) = names.split_at(names.len().min(SHOWN));
    match rest.len() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Returns the candidate closest to `name` if it is close enough for a typing error. Ties go to the earlier candidate.
///
/// Without a close candidate, returns the only one that begins or ends with `name`, if there is one.
pub fn did_you_mean<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let candidates: Vec<&str> = candidates.into_iter().collect();
    let lower = name.to_lowercase();
    let mut best: Option<(usize, &str)> = None;
    for &candidate in &candidates {
        // The comparison takes time proportional to the product of the lengths, so skip long names.
        if name.len().max(candidate.len()) > 100 {
            continue;
        }
        let distance = strsim::damerau_levenshtein(&lower, &candidate.to_lowercase());
        let allowed = (name.chars().count().max(candidate.chars().count()) / 3).max(1);
        // A suggestion shares at least one character with the name.
        let is_close = distance <= allowed && distance < name.chars().count();
        if is_close && best.is_none_or(|(nearest, _)| distance < nearest) {
            best = Some((distance, candidate));
        }
    }
    if let Some((_, candidate)) = best {
        return Some(candidate);
    }
    // A part of the name, such as `Car` for `IsCar`.
    let mut longer = candidates.into_iter().filter(|candidate| {
        let candidate = candidate.to_lowercase();
        lower.len() >= PART_MIN && (candidate.ends_with(&lower) || candidate.starts_with(&lower))
    });
    let first = longer.next()?;
    longer.all(|other| other == first).then_some(first)
}

/// Returns the candidate that the name of a missing file most likely means: the name with a missing ending, else the
/// closest one, preferably with the same ending.
pub fn similar_file<'a>(written: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let candidates: Vec<&'a str> = candidates.into_iter().collect();
    let candidates = || candidates.iter().copied();
    if let Some(ending) = Path::new(written).extension() {
        let same = candidates().filter(|candidate| Path::new(candidate).extension() == Some(ending));
        return did_you_mean(written, same).or_else(|| did_you_mean(written, candidates()));
    }
    let stem = |name: &'a str| match Path::new(name).extension() {
        Some(ending) => &name[..name.len() - ending.len() - 1],
        None => name,
    };
    let near = candidates().map(stem).find(|stem| *stem == written);
    let near = near.or_else(|| did_you_mean(written, candidates().map(stem)))?;
    candidates().find(|candidate| stem(candidate) == near)
}

/// Returns the path of an existing file that a missing one most likely means: one in the same folder with a similar
/// name and, if it is given, this ending. `written` is relative to `folder`, and so is the result; `names_in` returns
/// the names of the files in a folder.
pub fn similar_file_in(
    names_in: impl Fn(&Path) -> Vec<String>,
    folder: &Path,
    written: &Path,
    ending: Option<&str>,
) -> Option<String> {
    let parent = written.parent().unwrap_or(Path::new(""));
    let names = names_in(&folder.join(parent));
    let fits = |name: &&str| ending.is_none_or(|ending| Path::new(name).extension().is_some_and(|own| own == ending));
    let fitting = names.iter().map(String::as_str).filter(fits);
    let near = similar_file(written.file_name()?.to_str()?, fitting)?;
    Some(parent.join(near).display().to_string())
}

/// The shortest part of a name that suggests the whole, in bytes.
const PART_MIN: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lists_of_names_are_cut() {
        let names: Vec<String> = (0..30).map(|number| number.to_string()).collect();
        assert_eq!(listed(&names[..2]), "0, 1");
        assert!(listed(&names[..20]).ends_with(", 18, 19"));
        assert!(listed(&names).ends_with(", 18, 19 and 10 more"));
    }

    #[test]
    fn similar_files_have_the_missing_ending_or_a_close_name() {
        let files = ["city.yaml", "rules.dl", "rules.jsonl", "trace.jsonl"];
        let near = |written: &str| similar_file(written, files);
        assert_eq!(near("city"), Some("city.yaml"));
        assert_eq!(near("rules"), Some("rules.dl"), "the first of several");
        assert_eq!(near("ruls"), Some("rules.dl"));
        assert_eq!(near("ruls.jsonl"), Some("rules.jsonl"), "the same ending first");
        assert_eq!(near("trace.json"), Some("trace.jsonl"));
        assert_eq!(near("city.yml"), Some("city.yaml"));
        assert_eq!(near("something-else.dl"), None);
    }
}
