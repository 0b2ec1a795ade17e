//! Tests of the rule language and the engine alone, without a city, a configuration or the binary.

mod any_input;
#[path = "../cases.rs"]
mod cases;
mod chance;
mod choice;
mod circuits;
mod component;
mod corpus;
mod counter;
mod dense;
mod diff;
mod dominance;
mod engine;
mod explain;
mod export;
mod format;
mod functors;
mod hostile;
mod json;
mod lang;
mod mixed;
mod near_files;
#[cfg(feature = "optimizer")]
mod optimize;
mod order;
mod pages;
mod preprocessor;
mod proofs;
mod queries;
mod random_program;
mod records;
mod rewrite;
#[path = "../root.rs"]
mod root;
mod rule_files;
mod saved;
mod shortcuts;
mod souffle;
mod temporal;
mod word_size;
mod written_program;
