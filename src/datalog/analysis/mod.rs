//! Analyses of programs and facts: equality of rule sets ([`diff`]) and integrity constraints ([`constraints`]).

pub mod constraints;
pub mod diff;
