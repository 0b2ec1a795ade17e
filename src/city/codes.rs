//! Diagnostic codes of maps and routes.

crate::diagnostic_codes! {
    "codes.md":
    /// The map cannot be generated.
    INVALID_MAP = "invalid-map", Error;
    /// The agents need more start cells than the region has.
    NO_START_CELL = "no-start-cell", Error;
    /// An agent cannot reach any goal.
    NO_ROUTE = "no-route", Error;
}
