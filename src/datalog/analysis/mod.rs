//! Analyses of programs and facts: equivalence of rule sets ([`diff`]) and integrity constraints ([`constraints`]).

pub mod constraints;
pub mod diff;
