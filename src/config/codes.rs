//! The codes of messages about configurations.

crate::diagnostic_codes! {
    /// The text is not YAML.
    YAML_SYNTAX = "yaml-syntax", Error;
    /// A key that has no meaning here.
    UNKNOWN_KEY = "unknown-key", Error;
    /// A key given twice.
    DUPLICATE_KEY = "duplicate-key", Error;
    /// A required key that is absent.
    MISSING_KEY = "missing-key", Error;
    /// A value of the wrong type or outside its range.
    INVALID_VALUE = "invalid-value", Error;
    /// A file that a configuration refers to and that cannot be read.
    MISSING_FILE = "missing-file", Error;
    /// A split that the configuration does not have.
    UNKNOWN_SPLIT = "unknown-split", Error;
}
