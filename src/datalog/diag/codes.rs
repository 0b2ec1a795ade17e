//! Codes of messages about any input.

crate::diagnostic_codes! {
    "codes.md":
    /// The bytes of a file are not UTF-8 text.
    NOT_TEXT = "not-text", Error;
    /// A size or count in the input exceeds a limit of the program.
    LIMIT_EXCEEDED = "limit-exceeded", Error;
    /// The caller cancelled the work before it was done.
    CANCELLED = "cancelled", Error;
}

/// The examples in Rust, which are tested like those of the documentation.
#[cfg(doctest)]
#[doc = include_str!("codes.md")]
pub struct Examples;
