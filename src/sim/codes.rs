//! Diagnostic codes for scenes, traces, and rules that do not fit a configuration.

crate::diagnostic_codes! {
    "codes.md":
    /// The dense executor was requested, but it cannot evaluate these rules or this number of agents.
    DENSE_UNSUPPORTED = "dense-unsupported", Error;
    /// Two actions that the rules can derive for one agent.
    ACTION_CONFLICT = "action-conflict", Warning;
    /// Rules for actions that do not react to imminent collisions.
    NO_COLLISION_CLAUSE = "no-collision-clause", Warning;
    /// A variable with the name of an agent.
    UNQUOTED_AGENT = "unquoted-agent", Warning;
    /// A constant that names no agent of the configuration.
    UNKNOWN_AGENT = "unknown-agent", Warning;
    /// A declared constraint that does not hold in the city of the configuration.
    CONSTRAINT_MISMATCH = "constraint-mismatch", Error;
    /// A predicate that never holds in the city, although rules read it.
    EMPTY_PREDICATE = "empty-predicate", Warning;
    /// An output of rules for a city that is no action.
    UNUSED_OUTPUT = "unused-output", Warning;
    /// A predicate of rules for a city that is not an action and that no clause reads.
    UNREAD_PREDICATE = "unread-predicate", Warning;
    /// An action of the configuration that no clause derives, or a clause that derives it for other kinds of agents.
    UNUSED_ACTION = "unused-action", Warning;
    /// A definition of a predicate that the rules do not declare.
    UNUSED_DEFINITION = "unused-definition", Warning;
    /// A kind of the configuration that no agent has.
    UNUSED_KIND = "unused-kind", Warning;
    /// A zone of the configuration that no predicate tests.
    UNUSED_ZONE = "unused-zone", Warning;
    /// A function that computes an external predicate is missing or fails.
    EXTERNAL_PREDICATE = "external-predicate", Error;
    /// A scene that is not JSON or does not follow the scene format.
    INVALID_SCENE = "invalid-scene", Error;
    /// A trace that is not JSON or does not follow the trace format.
    INVALID_TRACE = "invalid-trace", Error;
    /// A trace of another configuration or with other rules.
    TRACE_MISMATCH = "trace-mismatch", Error;
}
