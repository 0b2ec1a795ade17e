//! Diagnostic codes of examples.

crate::diagnostic_codes! {
    "codes.md":
    /// Two examples with the same facts and different actions.
    CONTRADICTING_EXAMPLES = "contradicting-examples", Error;
    /// The answer of an oracle is not an action of the rules.
    INVALID_ANSWER = "invalid-answer", Error;
    /// No rules within the limits of the search agree with all answers of an oracle.
    INSEPARABLE_ANSWERS = "inseparable-answers", Error;
    /// The clauses learned from a task of Popper do not derive all positive examples.
    UNCOVERED_EXAMPLES = "uncovered-examples", Error;
}
