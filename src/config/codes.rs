//! Diagnostic codes of configurations.

crate::diagnostic_codes! {
    "codes.md":
    /// The text is not YAML.
    YAML_SYNTAX = "yaml-syntax", Error;
    /// The mapping does not have this key.
    UNKNOWN_KEY = "unknown-key", Error;
    /// The mapping has the key twice.
    DUPLICATE_KEY = "duplicate-key", Error;
    /// A required key is missing.
    MISSING_KEY = "missing-key", Error;
    /// A value has the wrong type or is outside of its range.
    INVALID_VALUE = "invalid-value", Error;
    /// A file that a configuration names cannot be read.
    MISSING_FILE = "missing-file", Error;
    /// The configuration does not have the split.
    UNKNOWN_SPLIT = "unknown-split", Error;
}
