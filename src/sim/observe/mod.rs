//! The observation of one agent of a task, and the clauses that its actions violate.

mod decider;
mod observer;
mod rule_monitor;

pub use decider::Decider;
pub use observer::{OBSERVED_MAX, Observer, Oracle};
pub use rule_monitor::ActionConstraint;
