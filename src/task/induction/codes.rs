//! Diagnostic codes of examples.

crate::diagnostic_codes! {
    "codes.md":
    /// Two examples with the same facts and different actions.
    CONTRADICTING_EXAMPLES = "contradicting-examples", Error;
}
