//! Learning tasks in the city.
//!
//! [`spf`] is Safe Path Following: drive to a goal without violating a rule. [`questions`] poses decisions as text.
//! [`vap`] is Visual Action Prediction: frames of many worlds, with their facts and the actions that the rules want.
//! [`induction`] learns the rules themselves. [`shard`] divides data sets among processes.

pub mod codes;
pub mod induction;
pub mod questions;
pub mod shard;
pub mod spf;
#[cfg(feature = "parquet")]
pub mod vap;
