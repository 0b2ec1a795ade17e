//! The observation of one agent of a task, and the clauses that its actions violate.

mod decider;
mod numbers;
mod observer;
mod rule_monitor;

pub use decider::Decider;
pub use observer::{OBSERVED_MAX, ObservedColumn, Observer, Oracle, observed_columns};
pub use rule_monitor::ActionConstraint;
