//! City state to picture: a plain raster of the map from above, with every agent on it.
//!
//! A [`Painter`] draws the static part of a map once; [`Painter::frame`] copies it and adds the agents. A [`Frame`]
//! becomes a PNG with [`write_png`], a sequence of them a GIF with [`Animation`].
//!
//! Pictures have a fixed palette of at most 64 colours, so both formats store exactly what was drawn, and the same
//! input gives the same bytes. This module knows neither rules nor simulation: it reads no clock, opens no file, and an
//! agent is what its [`Sprite`] says.

mod agent;
mod canvas;
mod encode;
mod ground;
mod ink;
mod label;
mod legend;
mod painter;

pub use agent::Sprite;
pub use canvas::Frame;
pub use encode::{Animation, write_png};
pub use ink::PALETTE;
pub use painter::{EmptyMap, Painter};
