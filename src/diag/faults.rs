//! Collects diagnostics.

use crate::diag::{Code, Diagnostic, Severity};

/// The maximum number of errors, and of warnings, kept for one input. A file of noise must not fill the memory or the
/// screen.
pub const MAX_FAULTS: usize = 100;

/// The diagnostics of one input so far.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    errors: Vec<Diagnostic>,
    warnings: Vec<Diagnostic>,
    hidden_warnings: usize,
}

/// A state of [`Faults`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mark {
    errors: usize,
    warnings: usize,
    hidden_warnings: usize,
}

impl Faults {
    /// Adds a diagnostic; drops it if there are [`MAX_FAULTS`] of its severity.
    pub fn push(&mut self, fault: Diagnostic) {
        let list = match fault.severity() {
            Severity::Error => &mut self.errors,
            Severity::Warning => &mut self.warnings,
        };
        if list.len() < MAX_FAULTS {
            list.push(fault);
        } else if fault.severity() == Severity::Warning {
            self.hidden_warnings += 1;
        }
    }

    /// Returns the current state, for [`Faults::rewind`].
    pub(crate) fn mark(&self) -> Mark {
        Mark {
            errors: self.errors.len(),
            warnings: self.warnings.len(),
            hidden_warnings: self.hidden_warnings,
        }
    }

    /// Drops the diagnostics added since `mark`.
    pub(crate) fn rewind(&mut self, mark: Mark) {
        self.errors.truncate(mark.errors);
        self.warnings.truncate(mark.warnings);
        self.hidden_warnings = mark.hidden_warnings;
    }

    /// Returns whether there is an error.
    pub fn failed(&self) -> bool {
        !self.errors.is_empty()
    }

    /// Returns whether further errors would be dropped, so that the caller can stop.
    pub fn full(&self) -> bool {
        self.errors.len() >= MAX_FAULTS
    }

    /// Returns the diagnostics in source order, without duplicates.
    pub fn finish(self) -> Vec<Diagnostic> {
        let full = self.full();
        let mut list = self.errors;
        list.extend(self.warnings);
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
            // The caller may have stopped here, so the number of further errors is unknown.
            list.push(Diagnostic::new(
                Code::LIMIT_EXCEEDED,
                format!("more than {MAX_FAULTS} errors; the others are not shown"),
            ));
        }
        if self.hidden_warnings > 0
            && let Some(last) = list.last_mut()
        {
            last.notes
                .push(format!("{} more warnings are not shown", self.hidden_warnings));
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
