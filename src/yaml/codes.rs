//! Diagnostic codes of YAML and of the values in it.

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
}
