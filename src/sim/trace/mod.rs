//! The output of a run: its trace, replay of single ticks, and explanations of decisions and waits.

mod archive;
mod coverage;
mod deadlock;
mod replay;
mod why;
mod writer;

pub use archive::{Archive, ArchivedFile, hash_sources};
pub use coverage::{ClauseCoverage, Coverage};
pub use deadlock::{DeadlockReport, LOOK_TICKS, STUCK_TICKS, WaitsFor, find_deadlocks, waits};
pub use replay::{Replay, TraceAgent, TraceHeader, TraceState, TraceTick, trace_limits};
pub use why::{Account, Decision};
pub use writer::{Driven, TRACE_VERSION, TraceWriter};
