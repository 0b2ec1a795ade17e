//! Scenes: single states from outside, the decisions of the rules in them, and scenes with conflicting actions.

mod conflict;
mod constraints;
mod empty;
mod format;
mod infer;
mod judge;
mod lint;
mod theory;

pub use conflict::{CONFLICT_BUDGET, Finding, Overlap, conflicts, scene_json};
pub use constraints::CityConstraints;
pub use infer::{Answer, EgoAnswer, Explained, Inference, SceneFacts};
pub use lint::{Examined, agent_lints, conflict_lints, examine};
pub use theory::CityTheory;
