//! A world without logic.

mod grid;
mod map;

pub use grid::{Cell, Heading};
pub use map::{CityMap, Ground};
