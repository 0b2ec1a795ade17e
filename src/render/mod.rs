//! City state to picture: the map from above, with every agent on it as an icon.
//!
//! Which to take: an [`Overview`] shows a whole city to people, with rulers, legend and labels; a [`Renderer`] draws any part of a map at
//! any scale ([`Viewport`]), many thousand pictures of it, and tells where in the picture each agent is, as a [`Placement`] does without
//! drawing; [`Icons`] has the icons alone, and
//! [`sheet`] shows what there are. A [`Picture`] becomes a PNG with [`write_png`], a sequence of them a GIF with [`Animation`].
//!
//! Icons are drawn by parameters, each a function of seed, class and instance, or come from a [`Pack`]. The same input gives the same bytes
//! on any number of threads.
//!
//! ```
//! use logicity::builtin::BuiltinFiles;
//! use logicity::city::{Cell, Split};
//! use logicity::diag::Sources;
//! use logicity::render::{Difficulty, Facing, Icons, Renderer, Sprite, Viewport, write_png};
//! use logicity::rng::Seed;
//! use logicity::sim::{LoadedCity, Settings, Simulation};
//! use std::{path::Path, sync::Arc};
//!
//! let loaded = LoadedCity::load(&mut Sources::new(), Path::new("vap-easy"), None, &BuiltinFiles).expect("it is built in");
//! let world = loaded.world().expect("the rules fit");
//! let city = Simulation::new(Arc::new(world), Split::Test, Seed(1), Settings::default()).expect("there is room for all");
//!
//! // 1024 x 1024 pixels: 128 cells of 8; cars are 48 pixels wide, pedestrians 32. The ground is drawn once.
//! let view = Viewport::published(Cell::new(0, 0))?;
//! let icons = Arc::new(Icons::new(Seed(1), Difficulty::CLEAN));
//! let renderer = Renderer::new(city.world().map(), icons, view);
//! let sprites: Vec<Sprite> = city.agents().iter().map(|agent| Sprite::of(agent, "", None)).collect();
//! let mut png = Vec::new();
//! write_png(&renderer.draw(&sprites), &mut png)?;
//!
//! let boxes = renderer.boxes(&sprites); // of each agent, in pixels, clipped to the picture
//! assert!(boxes.iter().flatten().all(|area| area.width <= 1024));
//! let alone = renderer.icons().png(&sprites[0].class(), 0, Facing::Up, 64); // an icon on transparent ground
//! assert!(alone.starts_with(b"\x89PNG"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! This module knows neither rules nor simulation: it reads no clock, opens no file, and an agent is what its [`Sprite`] says.

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
pub use encode::{Animation, read_png, read_png_into, write_png};
pub use icon::{Difficulty, ICON_MAX, Icons, PixelBox, Stamp};
pub use overview::{Marked, Overview};
pub use pack::{Mode, PACK_FILE_MAX, PACK_FILES_MAX, Pack, PackFault};
pub use picture::Picture;
pub use renderer::{Placement, Renderer};
pub use sheet::sheet;
pub use sprite::Sprite;
pub use view::{Scale, Viewport, ViewportError};
