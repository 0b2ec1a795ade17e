//! The rule language and the engine alone: no city, no configuration, no program on the path.

mod any_input;
mod corpus;
mod dense;
mod diff;
mod engine;
mod explain;
mod format;
mod hostile;
mod lang;
mod near_files;
#[cfg(feature = "optimizer")]
mod optimize;
mod proofs;
mod random_program;
mod rule_files;
mod written_program;
