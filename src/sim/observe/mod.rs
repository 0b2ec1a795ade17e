//! What one agent of a task observes, and which clauses its actions break.

mod observer;
mod rule_monitor;

pub use observer::{OBSERVED_MAX, Observer, Oracle};
pub use rule_monitor::ActionConstraint;
