//! The tick: from the state of the agents to facts, and from facts to one action per agent.
//!
//! `vocabulary` binds the configuration to the rules. The relational executor takes its facts from `ground` and keeps
//! them in a `ground_state`. The dense one computes them in a `window`, those without a fast form in `hidden`, and has
//! a session for clauses that it does not support (`handed`). `memory` keeps what temporal operators read of earlier
//! ticks, `external` the facts that a function of the caller computes. `batch` runs many cities. See
//! [`Executor`](crate::sim::Executor).

pub(super) mod agent_state;
pub(super) mod asked;
pub(super) mod batch;
pub(super) mod chance;
mod dense_executor;
pub(super) mod executor;
pub(super) mod external;
pub(super) mod ground;
pub(super) mod ground_state;
mod handed;
mod hidden;
pub(super) mod memory;
pub(super) mod pool;
pub(super) mod simulation;
pub(super) mod vocabulary;
pub(super) mod width;
pub(super) mod window;
pub(super) mod world;

pub use dense_executor::{WHOLE_MAX, WINDOW_MAX};
