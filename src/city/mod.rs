//! A world without logic: the map and how it is generated, roads and routes, agents, how they move and how far they see.
//!
//! [`CityMap::generate`] makes a map, [`Router`] plans on it, [`place_agents`] puts [`Agent`]s there and [`advance`] moves one
//! by what somebody else decided. Coordinates are (row, column) from 0, distances are in cells, time is in ticks.
//!
//! This module refuses to know what a rule or a predicate is.

mod agent;
mod codes;
mod generate;
mod grid;
mod map;
mod model;
mod motion;
mod places;
mod roads;
mod route;
mod view;
mod walk;

pub use agent::{Agent, Rest, place_agents, place_agents_into};
pub use codes::CODES;
pub use grid::{Cell, Heading};
pub use map::{CityMap, Ground, Junction, Layout, SEMANTIC_MAX, STATIC_LAYERS};
pub use model::{
    Action, AgentConfig, AgentGroup, AgentKind, AgentName, AgentSet, Building, Buildings, MapConfig, Routing, Split,
    Widths,
};
pub use motion::{MoveReason, Moved, Surroundings, advance, possible_cells, speed_cells};
pub use places::Places;
pub use roads::{Lane, NoRoute, Router};
pub use route::Route;
pub use view::{FieldOfView, field_of_view, view_reach};
