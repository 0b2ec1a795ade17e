//! What is asked of learners in the city.
//!
//! [`path`] is Safe Path Following: drive to a goal without breaking a rule.

pub mod path;
