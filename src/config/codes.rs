//! Diagnostic codes of configurations.

crate::diagnostic_codes! {
    "codes.md":
    /// A file that a configuration names cannot be read.
    MISSING_FILE = "missing-file", Error;
    /// The configuration does not have the split.
    UNKNOWN_SPLIT = "unknown-split", Error;
}
