//! Learns rules by questions: an oracle decides states that the learner makes up.
//!
//! A question costs an oracle more than the learner, so the learner chooses it well:
//!
//! - It **verifies** each learned clause. The examples that only this clause explains have literals in common. A scene
//!   of the clause falsifies as many of them as possible; if the answer stays the same, the clause needs none of them.
//! - It **explores**: in random scenes in which the learned rules stay silent, an unknown clause may hold.
//! - It **shrinks** a scene with an unexpected answer, until every fact matters.
//! - It **sweeps** all small scenes at the end, if the caller wants a certificate.

mod explore;
mod hypothesis;
mod probe;
mod refine;
mod session;
mod shrink;
mod space;
mod support;
mod sweep;
mod verify;

pub use refine::{Refined, Refinement};
pub use session::{Answer, AskSettings, Bound, End, Event, Failure, Observer, Oracle, Reason};
pub use space::canonical;
pub use sweep::{count_at_most, count_scenes};
