//! The codes of messages about data sets.

crate::diagnostic_codes! {
    /// A data set that is not as it was made, or of another configuration.
    INVALID_DATA_SET = "invalid-data-set", Error;
}
