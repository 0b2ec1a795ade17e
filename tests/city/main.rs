//! Tests of the city: configurations, maps, moves, decisions and Safe Path Following.

mod any_input;
#[path = "../../src/cases.rs"]
mod cases;
mod config;
mod conflicts;
mod executors;
mod explain;
mod hostile;
#[path = "../datalog/near_files.rs"]
mod near_files;
#[path = "../datalog/pages.rs"]
mod pages;
#[path = "../datalog/proofs.rs"]
mod proofs;
mod properties;
mod recorded;
mod schema;
mod shipped_world;
mod spf;
mod training;
mod vector;
#[path = "../datalog/written_program.rs"]
mod written_program;
