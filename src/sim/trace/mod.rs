//! The output of a run: its trace, replay of single ticks, and explanations of decisions and waits.

mod archive;
mod coverage;
mod deadlock;
mod decision;
mod replay;
mod writer;

pub use archive::{Archive, ArchivedFile, hash_sources};
pub use coverage::{ClauseCoverage, Coverage, Firings};
pub use deadlock::{DeadlockReport, LOOK_TICKS, STUCK_TICKS, WaitsFor, find_deadlocks, waits};
pub use decision::{Account, Decision};
pub use replay::{Replay, TraceAgent, TraceHeader, TraceState, TraceTick, trace_limits};
pub use writer::{Driven, TRACE_VERSION, TraceWriter};
