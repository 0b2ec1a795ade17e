//! Diagnostic codes for data sets.

crate::diagnostic_codes! {
    "codes.md":
    /// A data set that was changed or damaged, or that has another configuration.
    INVALID_DATA_SET = "invalid-data-set", Error;
}
