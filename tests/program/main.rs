//! Tests of the binary, and checks of the repository as a whole.

mod cli;
mod diagnostics;
mod diff;
mod grammar;
mod layers;
mod lsp;
#[cfg(target_os = "linux")]
mod memory;
mod questions;
mod readme;
mod repl;
#[path = "../city/shipped_world.rs"]
mod shipped_world;
