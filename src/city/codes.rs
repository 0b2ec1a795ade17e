//! The codes of messages about maps and routes.

crate::diagnostic_codes! {
    /// A map that cannot be generated.
    INVALID_MAP = "invalid-map", Error;
    /// More agents than cells they could start from, or none at all.
    NO_START_CELL = "no-start-cell", Error;
    /// A goal that cannot be reached.
    NO_ROUTE = "no-route", Error;
}
