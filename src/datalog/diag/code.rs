//! Stable codes of messages.

use super::Severity;

/// The stable name and the severity of a message.
///
/// The name is part of the public interface and never changes its meaning. Each module with messages declares its codes
/// with [`diagnostic_codes!`](crate::diagnostic_codes). Each code has a fixture in `tests/fixtures/diagnostics/` and a
/// section in the Markdown file beside its declaration; a test checks that both exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code {
    name: &'static str,
    severity: Severity,
}

impl Code {
    /// Creates a code.
    pub const fn new(name: &'static str, severity: Severity) -> Code {
        Code { name, severity }
    }

    /// Returns the name shown to users, for example `unknown-predicate`.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// Returns the severity.
    pub fn severity(self) -> Severity {
        self.severity
    }
}

/// Declares the codes of a module as constants, their list as `CODES`, and their explanations in the named Markdown file
/// as `CATALOG`.
#[macro_export]
#[doc(hidden)]
macro_rules! diagnostic_codes {
    ($file:literal: $($(#[doc = $doc:literal])* $constant:ident = $name:literal, $severity:ident;)*) => {
        $($(#[doc = $doc])* pub const $constant: $crate::diag::Code =
            $crate::diag::Code::new($name, $crate::diag::Severity::$severity);)*

        /// The codes of this module's messages.
        pub const CODES: &[$crate::diag::Code] = &[$($constant,)*];

        /// The explanations of these codes.
        pub const CATALOG: $crate::diag::Catalog = $crate::diag::Catalog {
            summaries: &[$(($constant, concat!($($doc),*)),)*],
            text: include_str!($file),
        };
    };
}
