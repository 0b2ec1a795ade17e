//! YAML to typed configuration.
//!
//! ```text
//! path --compose--> one tree of all files --load--> Scenario, MapConfig
//! ```
//!
//! Reach for [`load_scenario`] to run a city, for [`load_map`] if only the map is wanted, and for [`load_tree`] if the caller interprets the
//! keys. None touches a disk: files come
//! through a function of the caller and, where it finds none, from those built into the program. This module knows neither
//! what a rule says nor whether a map has room for its agents.

mod codes;
mod compose;
mod load;
mod model;
pub(crate) mod read;
mod task;
mod tree;
pub(crate) mod yaml;

pub use codes::CODES;
pub use compose::Read;
pub use load::{load_map, load_scenario};
pub use model::*;
pub use tree::{Tree, load_tree};
