//! The tick: from the state of the agents to facts, from facts to one action for each agent.
//!
//! `vocabulary` binds configuration and rules. The relational executor takes its facts from `ground` and keeps them in a `ground_state`; the
//! dense one ([`Executor`](crate::sim::Executor)) computes them in a `window`.

pub(super) mod chance;
mod dense_executor;
pub(super) mod executor;
pub(super) mod ground;
pub(super) mod ground_state;
pub(super) mod simulation;
pub(super) mod vocabulary;
pub(super) mod width;
pub(super) mod window;
pub(super) mod world;

pub use dense_executor::{WHOLE_MAX, WINDOW_MAX};
