//! What one agent of a task observes, exactly or through sensors; the clauses that its actions violate, and the actions
//! that a shield permits.

mod belief;
mod decider;
mod joint;
mod noise;
mod numbers;
mod observed;
mod observer;
mod rule_monitor;
mod sensors;
mod share;
mod shield;
mod visibility;

pub use belief::{Chain, SensorModel};
pub use decider::Decider;
pub use observed::OBSERVED_MAX;
pub use observer::{ObservedColumn, Observer, Oracle, observed_columns};
pub use rule_monitor::ActionConstraint;
pub use sensors::{FactCounts, Sensors};
pub use shield::{Shield, ShieldState, Verdict};
