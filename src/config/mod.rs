//! YAML to typed configuration.

mod model;

pub use model::*;
