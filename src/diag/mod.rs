//! Diagnostics: the one type in which every fault in a user's file is told.
//!
//! A parser or checker *speaks at the fault* (it pushes a [`Diagnostic`] with spans into a list and goes on) and somebody
//! else *draws elsewhere* ([`render()`] for a terminal, [`to_json`] for machines). A [`Diagnostic`] passes through no stages:
//! it is complete when it is made, and it refers to text through a [`Span`] into [`Sources`].
//!
//! This module refuses to know what a rule, a configuration or a city is.

mod code;
mod faults;
mod render;
mod source;

pub use code::{CODES, Code};
pub use faults::{Faults, MAX_FAULTS};
pub use render::{render, to_json};
pub use source::{Located, Position, SourceId, Sources, Span};

/// How bad a [`Diagnostic`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// The input cannot be used.
    Error,
    /// The input can be used; something in it is probably not meant.
    Warning,
}

/// A place in a source and what to say about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// The place.
    pub span: Span,
    /// What to say there; may be empty for the primary label.
    pub message: String,
}

/// One fault: what is wrong, where, what else is involved and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// The stable name of the message.
    pub code: Code,
    /// One line, lower case, no full stop.
    pub message: String,
    /// Where the fault is. Absent only when it has no place in any text.
    pub primary: Option<Label>,
    /// Other places involved.
    pub secondary: Vec<Label>,
    /// Facts that explain.
    pub notes: Vec<String>,
    /// What to do.
    pub help: Vec<String>,
}

impl Diagnostic {
    /// A diagnostic without a place yet; see [`Diagnostic::at`].
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        Diagnostic {
            code,
            message: message.into(),
            primary: None,
            secondary: Vec::new(),
            notes: Vec::new(),
            help: Vec::new(),
        }
    }

    /// The diagnostic of work that the caller cancelled.
    pub fn cancelled() -> Self {
        Diagnostic::new(Code::CANCELLED, "the work was cancelled")
    }

    /// Sets the primary place and what to say there.
    pub fn at(mut self, span: Span, message: impl Into<String>) -> Self {
        self.primary = Some(Label {
            span,
            message: message.into(),
        });
        self
    }

    /// Adds a secondary place.
    pub fn also(mut self, span: Span, message: impl Into<String>) -> Self {
        self.secondary.push(Label {
            span,
            message: message.into(),
        });
        self
    }

    /// Adds a fact that explains.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }

    /// Adds what to do.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help.push(help.into());
        self
    }

    /// Error or warning; it follows from the code.
    pub fn severity(&self) -> Severity {
        self.code.severity()
    }

    /// Whether this makes the input unusable.
    pub fn is_error(&self) -> bool {
        self.severity() == Severity::Error
    }
}

/// The candidate most like `name`, if any is near enough to be a likely typing error. Ties go to the earlier candidate.
pub fn did_you_mean<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = name.to_lowercase();
    let mut best: Option<(usize, &str)> = None;
    for candidate in candidates {
        // Comparing takes time in the product of the lengths; nobody mistypes a name as long as this.
        if name.len().max(candidate.len()) > 100 {
            continue;
        }
        let distance = strsim::damerau_levenshtein(&lower, &candidate.to_lowercase());
        let allowed = (name.chars().count().max(candidate.chars().count()) / 3).max(1);
        if distance <= allowed && best.is_none_or(|(nearest, _)| distance < nearest) {
            best = Some((distance, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}
