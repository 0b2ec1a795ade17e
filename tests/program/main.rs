//! Tests of the binary, and checks of the repository as a whole.

mod ask;
#[path = "../cases.rs"]
mod cases;
mod check;
mod cli;
mod diagnostics;
mod diff;
mod examples;
mod explain;
#[cfg(unix)]
mod files;
mod grammar;
#[cfg(unix)]
mod hostile;
mod induce;
mod layers;
#[cfg(unix)]
mod lsp;
#[cfg(target_os = "linux")]
mod memory;
#[path = "../datalog/pages.rs"]
mod pages;
mod popper;
mod prose;
mod questions;
mod readme;
mod references;
mod repl;
mod repository;
#[path = "../root.rs"]
mod root;
mod shards;
#[path = "../city/shipped_world.rs"]
mod shipped_world;
mod shortcuts;
mod souffle;
#[cfg(unix)]
mod terminal;
#[cfg(unix)]
mod video;
