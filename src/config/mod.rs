//! Loads typed configurations from YAML.
//!
//! ```text
//! path --compose--> one tree of all files --load--> Scenario, MapConfig
//! ```
//!
//! Use [`load_scenario`] to run a city, [`load_map`] for a map alone, [`load_any`] for either, and [`load_tree`] if the
//! caller interprets the keys. None of them accesses the disk: the caller passes a function that reads files, and the
//! built-in files serve where it finds none. This module does not know what rules say or whether a map has room for its
//! agents.

mod actions;
pub mod codes;
mod compose;
mod kinds;
mod load;
mod looks;
mod model;
mod predicates;
mod roads;
mod sensors;
mod shield;
mod task;
mod tree;
mod zones;

pub use compose::{Read, rule_file};
pub use load::{Loaded, load_any, load_map, load_scenario, missing_file};
pub use model::*;
pub use predicates::SEES;
pub use tree::{Tree, load_tree};
