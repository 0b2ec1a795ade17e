//! Diagnostic codes of recorded episodes, and of planning problems.

crate::diagnostic_codes! {
    "codes.md":
    /// An episode violates the format, or does not fit its city.
    INVALID_EPISODE = "invalid-episode", Error;
    /// A plan is not one for this episode, or breaks a rule.
    INVALID_PLAN = "invalid-plan", Error;
    /// PDDL cannot state a part of the rules or of the configuration.
    PDDL_UNSUPPORTED = "pddl-unsupported", Error;
}
