//! Tests of the city: configurations, maps, moves, decisions and Safe Path Following.

mod actions;
mod agreement;
mod any_input;
mod ask;
#[path = "../cases.rs"]
mod cases;
mod chance;
mod cities;
mod config;
mod conflicts;
mod egos;
mod executors;
mod explain;
mod external;
mod handed;
mod hostile;
mod kinds;
mod looks;
#[path = "../datalog/near_files.rs"]
mod near_files;
#[path = "../datalog/pages.rs"]
mod pages;
mod pddl;
mod places;
mod popper;
mod popper_tasks;
#[path = "../datalog/proofs.rs"]
mod proofs;
mod properties;
mod quantities;
mod recorded;
mod roads;
#[path = "../root.rs"]
mod root;
mod schema;
mod sensors;
mod shield;
mod shipped_world;
mod spf;
mod temporal;
mod training;
mod vector;
#[path = "../datalog/written_program.rs"]
mod written_program;
