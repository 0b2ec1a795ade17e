//! The city without its rules: maps and their generation, roads and routes, agents, movement, and fields of view.
//!
//! [`CityMap::generate`] makes a map, [`Router`] plans routes on it, [`place_agents`] places [`Agent`]s, and
//! [`advance`] moves an agent according to a given action. Coordinates are (row, column) from 0, distances are in
//! cells, and time is in ticks.
//!
//! This module does not depend on rules or predicates.

mod action;
mod action_table;
mod agent;
mod area;
pub mod codes;
mod drive;
mod generate;
mod grid;
mod kind;
mod look;
mod map;
mod model;
mod motion;
mod network;
mod places;
mod road_map;
mod roads;
mod route;
mod signal;
mod square;
mod view;
mod walk;
mod zone;

pub use action::Action;
pub use action_table::{ActionTable, Effect, OwnAction, Side, Turn};
pub(crate) use agent::place_agents_into;
pub use agent::{Agent, Rest, place_agents};
pub(crate) use area::{Area, Rectangle};
pub use grid::{Cell, Heading};
pub use kind::{AgentKind, AgentName, KindId, KindName, KindTable, OwnKind, PICTURES, speed_cells};
pub use look::{Look, OwnLook};
pub use map::{CityMap, Layout, SEMANTIC_MAX, STATIC_LAYERS};
pub use model::{
    AgentConfig, AgentGroup, AgentSet, Blocks, Building, Buildings, Landmarks, MapConfig, OwnGroups, Region, Routing,
    Sample, Split, Terrain, TripEnds, Widths, ZoneConfig, ZonePart,
};
pub use motion::{MoveReason, Moved, Surroundings, advance, possible_cells};
pub(crate) use network::LIMIT_MAX;
pub use network::{Connection, Direction, LaneUse, Network, Point, RightOfWay, RoadJunction, RoadLane, Sign};
pub use places::Places;
#[cfg(feature = "cli")]
pub(crate) use road_map::distance;
pub use roads::{Lane, Router};
pub use route::{NoRoute, Route, corners};
pub use signal::{Aspect, Light, Phase, Signal, SignalLink};
pub use square::{Ground, Junction};
pub(crate) use view::view_reach;
pub use view::{FieldOfView, field_of_view};
