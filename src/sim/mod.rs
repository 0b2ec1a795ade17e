//! Where the city meets the engine.
//!
//! Each tick, [`Simulation`] turns the state of the agents into base facts ([`ground`](ground::ground)), gives the engine the
//! *difference* from the facts of the tick before, reads one action for every agent from the derived facts
//! ([`Vocabulary::decide`]) and lets the agents move. [`Inference`] does the same for single scenes that come from outside.

mod ground;
mod infer;
mod scene;
mod simulation;
mod trace;
mod vocabulary;
mod world;

pub use ground::{Chance, Entity, Facts, ground};
pub use infer::{Answer, EgoAnswer, Inference};
pub use scene::MAX_ENTITIES;
pub use simulation::{AgentTick, Simulation, TickReport};
pub use trace::{TRACE_VERSION, TraceWriter, hash_sources};
pub use vocabulary::{Predicate, Vocabulary};
pub use world::World;
