//! The stable names of messages.

use super::Severity;

/// The stable name of a message, and whether it is an error or a warning.
///
/// The name is part of the public interface and never changes its meaning. Each room declares its own codes with
/// [`diagnostic_codes!`](crate::diagnostic_codes). Each code has a fixture in `tests/fixtures/diagnostics/` and a section in
/// `rules/README.md` or `configs/README.md`; a test checks that both exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Code {
    name: &'static str,
    severity: Severity,
}

impl Code {
    /// A code with this name and severity.
    pub const fn new(name: &'static str, severity: Severity) -> Code {
        Code { name, severity }
    }

    /// The name shown to users, for example `unknown-predicate`.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// Whether the message is an error or a warning.
    pub fn severity(self) -> Severity {
        self.severity
    }
}

/// Declares the codes of a room as constants of [`Code`](crate::diag::Code), and the list of them as `CODES`.
#[macro_export]
#[doc(hidden)]
macro_rules! diagnostic_codes {
    ($($(#[$doc:meta])* $constant:ident = $name:literal, $severity:ident;)*) => {
        impl $crate::diag::Code {
            $($(#[$doc])* pub const $constant: $crate::diag::Code =
                $crate::diag::Code::new($name, $crate::diag::Severity::$severity);)*
        }

        /// The codes of the messages of this room.
        pub const CODES: &[$crate::diag::Code] = &[$($crate::diag::Code::$constant,)*];
    };
}

crate::diagnostic_codes! {
    /// The bytes of a file are not UTF-8 text.
    NOT_TEXT = "not-text", Error;
    /// A size or count in the input is beyond what the program accepts.
    LIMIT_EXCEEDED = "limit-exceeded", Error;
    /// The caller cancelled the work before it was done.
    CANCELLED = "cancelled", Error;
}
