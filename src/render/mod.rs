//! Draws the state of a city from above, with every agent as an icon.
//!
//! An [`Overview`] shows a city, or an [`Extent`] of it, to people, with rulers, legend and labels; a [`CloseUp`] shows
//! the surroundings of a few agents. A [`Renderer`] draws any part of a map at any scale ([`Viewport`]) and returns the box of each
//! agent; a [`Placement`] returns the boxes without drawing. [`Icons`] draws single icons, and [`sheet`] shows instances
//! of all classes. A [`GroundPlan`] describes the ground for drawing at any scale, a [`ZonePlan`] a zone. [`write_png`] encodes a [`Picture`]
//! as PNG, and [`Animation`] a sequence of them as GIF.
//!
//! Icons are generated, each as a function of seed, class and instance, or come from a [`Pack`]. A [`Difficulty`] from
//! 0 to 100 percent makes agents harder to recognize; a [`Framing`] then varies the size and the box of an agent. The
//! same input gives the same bytes on any number of threads.
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
//! let mut sources = Sources::new();
//! let loaded = LoadedCity::load(&mut sources, Path::new("vap-easy"), None, &BuiltinFiles).expect("it is built in");
//! let world = loaded.world().expect("the rules fit");
//! let city = Simulation::new(Arc::new(world), Split::Test, Seed(1), Settings::default()).expect("they have room");
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
//! This module does not depend on rules or simulation. It reads no clock and opens no file; a [`Sprite`] describes an
//! agent.

mod beside;
mod building;
mod car;
mod class;
mod close_up;
mod clutter;
mod difficulty;
mod encode;
mod framing;
mod ground;
mod icon;
mod label;
mod lattice;
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
mod weather;
mod zone;

pub use beside::beside;
pub use class::{Class, Facing};
pub use close_up::CloseUp;
pub use difficulty::{Difficulty, DrawingVersion};
pub use encode::{Animation, read_mask_into, read_png, read_png_into, write_mask, write_png};
pub use framing::Framing;
pub use ground::{GroundPlan, Site};
pub use icon::{Atlas, ICON_MAX, Icons};
pub use overview::{Marked, Overview};
pub use pack::{DrawingFault, Mode, PACK_FILE_MAX, PACK_FILES_MAX, Pack, PackFault, check_drawing};
pub use picture::{Picture, PixelBox};
pub use renderer::{Placement, Renderer};
pub use sheet::sheet;
pub use sprite::Sprite;
pub use view::{Extent, Scale, Viewport, ViewportError};
pub use zone::ZonePlan;
