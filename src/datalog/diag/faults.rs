//! Collects diagnostics.

use crate::diag::{Diagnostic, Severity, codes};

/// The maximum number of different errors, and of different warnings, kept for one input. A file of noise must not fill
/// the memory or the screen.
pub const MAX_FAULTS: usize = 100;

/// The maximum number of errors, and of warnings, kept for one input that repeat an earlier one at another place.
const MAX_REPEATS: usize = 1000;

/// The diagnostics of one input so far.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    errors: List,
    warnings: List,
    hidden_warnings: usize,
}

/// The diagnostics of one severity.
#[derive(Clone, Debug, Default)]
struct List {
    all: Vec<Diagnostic>,
    /// The positions in `all` of those that repeat no earlier one.
    different: Vec<usize>,
}

impl List {
    /// Returns whether there is no room for a diagnostic that differs from all others, or for one that repeats another.
    fn is_full(&self) -> bool {
        self.different.len() >= MAX_FAULTS || self.all.len() - self.different.len() >= MAX_REPEATS
    }

    /// Adds a diagnostic if there is room. Returns whether there was.
    fn push(&mut self, fault: Diagnostic) -> bool {
        let repeats = self.different.iter().any(|&known| self.all[known].repeats(&fault));
        let has_room = match repeats {
            true => self.all.len() - self.different.len() < MAX_REPEATS,
            false => self.different.len() < MAX_FAULTS,
        };
        if has_room {
            if !repeats {
                self.different.push(self.all.len());
            }
            self.all.push(fault);
        }
        has_room
    }
}

impl Faults {
    /// Adds a diagnostic. Drops it if there are [`MAX_FAULTS`] different ones of its severity, or too many like it.
    pub fn push(&mut self, fault: Diagnostic) {
        match fault.severity() {
            Severity::Error => {
                if !self.full() {
                    self.errors.push(fault);
                }
            }
            Severity::Warning => {
                if !self.warnings.push(fault) {
                    self.hidden_warnings += 1;
                }
            }
        }
    }

    /// Returns whether there is an error.
    pub fn failed(&self) -> bool {
        !self.errors.all.is_empty()
    }

    /// Returns whether further errors would be dropped, so that the caller can stop.
    pub fn full(&self) -> bool {
        self.errors.is_full()
    }

    /// Returns the diagnostics in source order, without duplicates.
    pub fn finish(self) -> Vec<Diagnostic> {
        let full = self.full();
        let mut list = self.errors.all;
        list.extend(self.warnings.all);
        let place = |fault: &Diagnostic| {
            fault
                .primary
                .as_ref()
                .map(|label| (label.span.source, label.span.start, label.span.end))
        };
        list.sort_by(|a, b| (place(a), a.code, &a.message).cmp(&(place(b), b.code, &b.message)));
        // The checker visits a clause with alternatives or several heads several times.
        list.dedup();
        if full {
            let errors = list.iter().filter(|fault| fault.is_error()).count();
            // The caller may have stopped here, so the number of further errors is unknown.
            list.push(Diagnostic::new(
                codes::LIMIT_EXCEEDED,
                format!("more than {errors} errors; the others are not shown"),
            ));
        }
        if self.hidden_warnings > 0
            && let Some(last) = list.last_mut()
        {
            last.notes.push(match self.hidden_warnings {
                1 => "1 more warning is not shown".to_owned(),
                more => format!("{more} more warnings are not shown"),
            });
        }
        list
    }
}

impl FromIterator<Diagnostic> for Faults {
    fn from_iter<I: IntoIterator<Item = Diagnostic>>(list: I) -> Self {
        let mut faults = Faults::default();
        list.into_iter().for_each(|fault| faults.push(fault));
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diag::{SourceId, Sources, Span};

    /// Adds diagnostics with these messages, each at another place.
    fn push(faults: &mut Faults, messages: impl IntoIterator<Item = String>) {
        let id: SourceId = Sources::new().add("a.dl", "");
        for (at, message) in messages.into_iter().enumerate() {
            faults.push(Diagnostic::new(crate::codes::UNSUPPORTED, message).at(Span::new(id, at..at + 1), ""));
        }
    }

    fn again(count: usize) -> Vec<String> {
        vec!["again".to_owned(); count]
    }

    #[test]
    fn faults_that_differ_only_in_their_place_count_once() {
        let mut faults = Faults::default();
        push(&mut faults, again(500));
        push(&mut faults, (0..MAX_FAULTS - 2).map(|number| format!("other {number}")));
        assert!(!faults.full());
        push(&mut faults, ["the last".to_owned(), "beyond".to_owned()]);
        assert!(faults.full());
        let found = faults.clone().finish();
        assert_eq!(found.len(), 500 + MAX_FAULTS - 1 + 1);
        let mut messages = found.iter().map(|fault| fault.message.as_str());
        assert!(messages.any(|message| message.starts_with("more than 599 errors")));
    }

    #[test]
    fn the_places_of_one_fault_are_bounded() {
        let mut faults = Faults::default();
        push(&mut faults, again(10_000));
        assert!(faults.full());
        assert_eq!(faults.finish().len(), 1 + MAX_REPEATS + 1);
    }
}
