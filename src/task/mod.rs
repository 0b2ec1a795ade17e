//! What is asked of learners in the city.
//!
//! [`path`] is Safe Path Following: drive to a goal without breaking a rule. [`questions`] asks for decisions in words.

pub mod path;
pub mod questions;
