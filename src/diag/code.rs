//! Stable codes of messages.

use super::Severity;

/// The stable name and the severity of a message.
///
/// The name is part of the public interface and never changes its meaning. Each module with messages declares its codes
/// with [`diagnostic_codes!`](crate::diagnostic_codes). Each code has a fixture in `tests/fixtures/diagnostics/` and a
/// section in `docs/reference/language.md` or `docs/reference/configuration.md`; a test checks that both exist.
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

/// Declares the codes of a module as constants of [`Code`](crate::diag::Code), and their list as `CODES`.
#[macro_export]
#[doc(hidden)]
macro_rules! diagnostic_codes {
    ($($(#[$doc:meta])* $constant:ident = $name:literal, $severity:ident;)*) => {
        impl $crate::diag::Code {
            $($(#[$doc])* pub const $constant: $crate::diag::Code =
                $crate::diag::Code::new($name, $crate::diag::Severity::$severity);)*
        }

        /// The codes of this module's messages.
        pub const CODES: &[$crate::diag::Code] = &[$($crate::diag::Code::$constant,)*];
    };
}

crate::diagnostic_codes! {
    /// The bytes of a file are not UTF-8 text.
    NOT_TEXT = "not-text", Error;
    /// A size or count in the input exceeds a limit of the program.
    LIMIT_EXCEEDED = "limit-exceeded", Error;
    /// The caller cancelled the work before it was done.
    CANCELLED = "cancelled", Error;
}
