//! The codes of messages about recorded episodes.

crate::diagnostic_codes! {
    /// An episode that is not of its format, or that cannot begin in its city.
    INVALID_EPISODE = "invalid-episode", Error;
}
