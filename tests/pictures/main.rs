//! Tests of pictures, of the page of a run, and of data sets of Visual Action Prediction.

#[path = "../cases.rs"]
mod cases;
mod page;
mod render;
#[path = "../city/shipped_world.rs"]
mod shipped_world;
mod vap;
