//! Where the stages of this room put what they find.

use crate::diag::{Code, Diagnostic, Severity};

/// More faults than this are counted, not kept: a file of noise must not fill the memory or the screen.
pub(super) const MAX_FAULTS: usize = 1000;

/// The faults found so far.
#[derive(Debug, Default)]
pub(super) struct Faults {
    list: Vec<Diagnostic>,
    unlisted: usize,
    failed: bool,
}

impl Faults {
    pub(super) fn push(&mut self, fault: Diagnostic) {
        self.failed |= fault.severity() == Severity::Error;
        if self.list.len() < MAX_FAULTS {
            self.list.push(fault);
        } else {
            self.unlisted += 1;
        }
    }

    /// Whether there is an error among them.
    pub(super) fn failed(&self) -> bool {
        self.failed
    }

    /// Whether no further fault will be kept.
    pub(super) fn full(&self) -> bool {
        self.list.len() >= MAX_FAULTS
    }

    /// All of them in the order of the text.
    pub(super) fn finish(mut self) -> Vec<Diagnostic> {
        self.list.sort_by_key(|fault| {
            let span = fault.primary.as_ref().map(|label| label.span);
            (span.map(|span| (span.source, span.start, span.end)), fault.code)
        });
        if self.unlisted > 0 {
            // An error only if one of the uncounted may be one; `failed` is then set and the rules are refused anyway.
            self.list.push(
                Diagnostic::new(Code::LimitExceeded, format!("more than {MAX_FAULTS} faults"))
                    .note(format!("{} more are not shown", self.unlisted)),
            );
        }
        self.list
    }
}
