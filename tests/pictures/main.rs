//! What is drawn: pictures, the page of a run, data sets of Visual Action Prediction.

mod page;
mod render;
#[path = "../city/shipped_world.rs"]
mod shipped_world;
mod vap;
