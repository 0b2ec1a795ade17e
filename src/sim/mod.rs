//! Connects the city to the Datalog engine.
//!
//! In each tick of a [`Simulation`], the rules decide on the current state and then the agents move. The dense executor
//! computes base facts as bits when a rule needs them. The relational executor grounds all facts ([`ground`]) and
//! commits the *difference* from the previous tick. [`Vocabulary::decide`] picks one of the derived actions.
//! [`Inference`] does the same for single scenes from outside.

pub mod codes;
mod load;
mod observe;
mod scene;
mod tick;
mod trace;

pub use crate::predicate::{Entity, Progress};
pub use load::{LoadError, LoadedCity, help_to_declare};
pub use observe::{
    ActionConstraint, Chain, Decider, FactCounts, OBSERVED_MAX, ObservedColumn, Observer, Oracle, SensorModel, Sensors,
    Shield, ShieldState, Verdict, observed_columns,
};
pub use scene::{
    Answer, CONFLICT_BUDGET, CityConstraints, CityTheory, EgoAnswer, Examined, Explained, Finding, Inference,
    MarginalAnswer, MarginalEgo, Overlap, SceneFacts, agent_lints, conflict_lints, conflicts, earlier_facts, examine,
    needed_draws, no_decision, scene_json, unread_predicates,
};
pub use tick::asked::{AskedFact, AskedTemporal, FactAccount, TemporalVerdict};
pub use tick::batch::Batch;
pub use tick::chance::Chance;
pub use tick::executor::{DenseRules, Executor};
#[cfg(feature = "cli")]
pub(crate) use tick::external::Unprovided;
pub use tick::external::{CityState, ExternalFacts, ExternalPredicates};
#[cfg(feature = "render")]
pub(crate) use tick::ground::json_value;
pub use tick::ground::{Facts, MAX_ENTITIES, PastRows, ground};
pub(crate) use tick::ground_state::GroundState;
pub(crate) use tick::pool::{run_polled, start_threads, threads_of};
pub(crate) use tick::simulation::entity;
pub use tick::simulation::{AgentTick, Phase, Settings, Simulation, Snapshot, TickReport};
pub use tick::vocabulary::{Actions, BasePredicate, Vocabulary};
pub use tick::width::Width;
#[cfg(feature = "cli")]
pub(crate) use tick::width::in_words;
pub use tick::world::{TICK_LIMITS, World};
pub use tick::{WHOLE_MAX, WINDOW_MAX};
pub use trace::{
    Account, Archive, ArchivedFile, ClauseCoverage, Coverage, DeadlockReport, Decision, Driven, Firings, LOOK_TICKS,
    Replay, STUCK_TICKS, TRACE_VERSION, TraceAgent, TraceHeader, TraceState, TraceTick, TraceWriter, WaitsFor,
    find_deadlocks, hash_sources, trace_limits, waits,
};
