//! City state to picture: the map from above, with every agent on it as an icon.
//!
//! Which to take: an [`Overview`] shows a whole city to people, with rulers, legend and labels; a [`Renderer`] draws any part of a map at
//! any scale ([`View`]), many thousand pictures of it, and tells where in the picture each agent is; [`Icons`] has the icons alone, and
//! [`sheet`] shows what there are. A [`Picture`] becomes a PNG with [`write_png`], a sequence of them a GIF with [`Animation`].
//!
//! Icons are drawn by parameters, each a function of seed, class and instance, or come from a [`Pack`]. The same input gives the same bytes
//! on any number of threads. This module knows neither rules nor simulation: it reads no clock, opens no file, and an agent is what its
//! [`Sprite`] says.

mod building;
mod car;
mod class;
mod encode;
mod ground;
mod icon;
mod label;
mod legend;
mod overview;
mod pack;
mod pedestrian;
mod picture;
mod renderer;
mod sheet;
mod sketch;
mod sprite;
mod view;

pub use class::{Class, Facing};
pub use encode::{Animation, write_png};
pub use icon::{Difficulty, ICON_MAX, Icons, PixelBox, Stamp};
pub use overview::Overview;
pub use pack::{Mode, PACK_FILE_MAX, PACK_FILES_MAX, Pack, PackFault};
pub use picture::Picture;
pub use renderer::Renderer;
pub use sheet::sheet;
pub use sprite::Sprite;
pub use view::{Scale, View, ViewError};
