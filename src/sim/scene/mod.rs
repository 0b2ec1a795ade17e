//! Scenes: single states that come from outside, what the rules decide in them, and those in which actions conflict.

mod conflict;
mod format;
mod infer;

pub use conflict::{CONFLICT_BUDGET, Finding, Overlap, conflicts, scene_json};
pub use infer::{Answer, EgoAnswer, Inference, SceneFacts};
