//! Scenes: single states from outside, the decisions of the rules in them, and scenes with conflicting actions.

mod answer;
mod conflict;
mod constraints;
mod empty;
mod format;
mod infer;
mod judge;
mod lint;
mod marginals;
mod plain;
mod theory;

pub use answer::{Answer, EgoAnswer, SceneFacts};
pub use conflict::{CONFLICT_BUDGET, Finding, Overlap, conflicts, earlier_facts, needed_draws, scene_json};
pub use constraints::CityConstraints;
pub use infer::{Explained, Inference};
pub use lint::{Examined, agent_lints, conflict_lints, examine, no_decision, unread_predicates};
pub use marginals::{MarginalAnswer, MarginalEgo};
pub use theory::CityTheory;
