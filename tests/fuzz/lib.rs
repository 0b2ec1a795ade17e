//! The properties that the targets check, from the modules of the tests.

#[path = "../city/any_input.rs"]
pub mod city;
#[path = "../datalog/any_input.rs"]
pub mod datalog;
#[path = "../datalog/random_program/mod.rs"]
mod random_program;
#[path = "../root.rs"]
mod root;
#[path = "../datalog/rule_files.rs"]
mod rule_files;
