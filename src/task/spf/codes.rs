//! Diagnostic codes of recorded episodes.

crate::diagnostic_codes! {
    "codes.md":
    /// An episode violates the format, or does not fit its city.
    INVALID_EPISODE = "invalid-episode", Error;
}
