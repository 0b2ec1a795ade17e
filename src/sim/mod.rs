//! Where the city meets the engine.
//!
//! Each tick, [`Simulation`] lets the rules decide on the state of the agents and the agents move. The dense executor computes base facts
//! as bits where a rule asks for them; the relational one is given the *difference* of all facts ([`ground`]) from
//! those of the tick before. One action is taken of those derived ([`Vocabulary::decide`]). [`Inference`] does the same for single scenes
//! that come from outside.

mod codes;
mod load;
mod observe;
mod scene;
mod tick;
mod trace;

pub use crate::predicate::Entity;
pub use codes::CODES;
pub use load::{LoadError, LoadedCity};
pub use observe::{ActionConstraint, OBSERVED_MAX, Observer, Oracle};
pub use scene::{Answer, CONFLICT_BUDGET, EgoAnswer, Finding, Inference, Overlap, SceneFacts, conflicts, scene_json};
pub use tick::chance::Chance;
pub use tick::executor::Executor;
pub use tick::ground::{Facts, MAX_ENTITIES, ground};
pub use tick::simulation::{AgentTick, Batch, Phase, Settings, Simulation, Snapshot, TickReport};
pub(crate) use tick::simulation::{run_polled, start_threads};
pub use tick::vocabulary::{Actions, Predicate, Vocabulary};
pub use tick::width::Width;
#[cfg(feature = "cli")]
pub(crate) use tick::width::in_words;
pub use tick::world::World;
pub use tick::{WHOLE_MAX, WINDOW_MAX};
pub use trace::{
    Account, ClauseCoverage, Coverage, DeadlockReport, Decision, Driven, LOOK_TICKS, Replay, STUCK_TICKS,
    TRACE_VERSION, TraceAgent, TraceHeader, TraceState, TraceTick, TraceWriter, WaitsFor, find_deadlocks, hash_sources,
    waits,
};
