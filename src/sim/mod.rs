//! Where the city meets the engine.
//!
//! Each tick, [`Simulation`] lets the rules decide on the state of the agents and the agents move. The dense executor computes base facts
//! as bits where a rule asks for them; the relational one is given the *difference* of all facts ([`ground`](ground::ground)) from
//! those of the tick before. One action is taken of those derived ([`Vocabulary::decide`]). [`Inference`] does the same for single scenes
//! that come from outside.

mod codes;
mod conflict;
mod coverage;
mod deadlock;
mod executor;
mod ground;
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
pub use codes::CODES;
pub use conflict::{CONFLICT_EFFORT, Finding, Overlap, conflicts, scene_json};
pub use coverage::{ClauseCoverage, Coverage};
pub use deadlock::{DeadlockReport, LOOK_TICKS, STUCK_TICKS, WaitsFor, standstill, waits};
pub use executor::{CROWD_MAX, Executor, WHOLE_MAX};
pub use ground::{Chance, Facts, ground};
pub use infer::{Answer, EgoAnswer, Inference, SceneFacts};
pub use observe::{OBSERVED_MAX, Observer, Oracle};
pub use replay::{Replay, TraceAgent, TraceHeader, TraceState, TraceTick};
pub use rule_monitor::ActionConstraint;
pub use scene::MAX_ENTITIES;
pub(crate) use simulation::start_threads;
pub use simulation::{AgentTick, Batch, Phase, Settings, Simulation, Snapshot, Stop, TickReport};
pub use trace::{Driven, TRACE_VERSION, TraceWriter, hash_sources};
pub use vocabulary::{Actions, Predicate, Vocabulary};
pub use why::{Account, Decision};
pub use width::Width;
#[cfg(feature = "cli")]
pub(crate) use width::in_words;
pub use world::World;
