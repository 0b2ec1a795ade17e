//! What the targets ask of every input, from the modules that the tests use.

#[path = "../city/any_input.rs"]
pub mod city;
#[path = "../datalog/any_input.rs"]
pub mod datalog;
#[path = "../datalog/random_program/mod.rs"]
mod random_program;
#[path = "../datalog/rule_files.rs"]
mod rule_files;
