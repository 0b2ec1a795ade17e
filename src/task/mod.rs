//! What is asked of learners in the city.
//!
//! [`spf`] is Safe Path Following: drive to a goal without breaking a rule. [`questions`] asks for decisions in
//! words. [`vap`] is Visual Action Prediction: frames of many worlds, with what is true in them and what the rules want.

pub mod questions;
pub mod spf;
#[cfg(feature = "parquet")]
pub mod vap;
