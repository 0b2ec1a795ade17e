//! A world without logic.

mod generate;
mod grid;
mod map;
mod view;

pub use grid::{Cell, Heading};
pub use map::{CityMap, Ground, Layout, STATIC_LAYERS};
pub use view::{View, field_of_view};
