//! Where the city meets the engine.
//!
//! Each tick, [`Simulation`] lets the rules decide on the state of the agents and the agents move. The dense executor computes base facts
//! as bits where a rule asks for them; the relational one is given the *difference* of all facts ([`ground`](ground::ground)) from
//! those of the tick before. One action is taken of those derived ([`Vocabulary::decide`]). [`Inference`] does the same for single scenes
//! that come from outside.

mod chance;
mod codes;
mod conflict;
mod coverage;
mod deadlock;
mod dense_executor;
mod executor;
mod ground;
mod ground_state;
mod infer;
mod observe;
mod replay;
mod rule_monitor;
mod scene;
mod simulation;
mod trace;
mod vocabulary;
mod why;
mod width;
mod window;
mod world;

pub use crate::predicate::Entity;
pub use chance::Chance;
pub use codes::CODES;
pub use conflict::{CONFLICT_EFFORT, Finding, Overlap, conflicts, scene_json};
pub use coverage::{ClauseCoverage, Coverage};
pub use deadlock::{DeadlockReport, LOOK_TICKS, STUCK_TICKS, WaitsFor, standstill, waits};
pub use dense_executor::{CROWD_MAX, WHOLE_MAX};
pub use executor::Executor;
pub use ground::{Facts, MAX_ENTITIES, ground};
pub use infer::{Answer, EgoAnswer, Inference, SceneFacts};
pub use observe::{OBSERVED_MAX, Observer, Oracle};
pub use replay::{Replay, TraceAgent, TraceHeader, TraceState, TraceTick};
pub use rule_monitor::ActionConstraint;
pub(crate) use simulation::start_threads;
pub use simulation::{AgentTick, Batch, Phase, Settings, Simulation, Snapshot, Stop, TickReport};
pub use trace::{Driven, TRACE_VERSION, TraceWriter, hash_sources};
pub use vocabulary::{Actions, Predicate, Vocabulary};
pub use why::{Account, Decision};
pub use width::Width;
#[cfg(feature = "cli")]
pub(crate) use width::in_words;
pub use world::World;
