//! A city of cars and pedestrians governed by Datalog rules, and the Datalog engine that evaluates them.
//!
//! # Where to start
//!
//! - **Datalog**: [`datalog`] loads rules, keeps facts and maintains what follows. It is the crate `logicity-datalog`,
//!   which programs without a city can use alone.
//! - **Sources and diagnostics**: [`diag`] holds the texts of rules and prints what is wrong with them.
//! - **One scene, one decision**: [`sim::Inference`].
//! - **A running city**: [`sim::World`] and [`sim::Simulation`].
//! - **Safe Path Following**: [`task::spf`].
//!
//! ```text
//! rules/*.dl --datalog--> Program
//!                            |
//! configs/*.yaml --config--> Scenario --> World --> Simulation --ground--> facts --> Session --> actions --> moves
//! ```
//!
//! # Example
//!
//! A [`Program`](datalog::Program) holds checked rules. A [`Session`](datalog::Session) of it keeps facts between
//! commits. Every commit returns a [`Delta`](datalog::Delta): the rows it added and removed.
//!
//! ```
//! use logicity::datalog::Program;
//!
//! let program = Program::parse(
//!     ".decl edge(x: symbol, y: symbol)
//!      .input edge
//!      .decl path(x: symbol, y: symbol)
//!      path(x, y) :- edge(x, y).
//!      path(x, z) :- path(x, y), edge(y, z).",
//! )?;
//! let path = program.predicate("path").unwrap();
//!
//! let mut session = program.session();
//! session.insert("edge", ("a", "b"))?;
//! session.commit()?;
//! session.insert("edge", ("b", "c"))?;
//! let delta = session.commit()?;
//! let added = session.decode(path, &delta.of(path).unwrap().added)?;
//! assert_eq!(added.collect::<Vec<(&str, &str)>>(), [("a", "c"), ("b", "c")]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! See also the [life of a program](datalog#the-life-of-a-program), [what is incremental](datalog#what-is-incremental)
//! and the [limits](datalog#limits).

pub mod builtin;
#[cfg(test)]
#[path = "../tests/cases.rs"]
mod cases;
pub mod city;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
pub mod config;
pub mod files;
pub mod induce;
pub mod located;
#[cfg(feature = "render")]
pub mod page;
pub mod popper;
pub mod predicate;
#[cfg(feature = "render")]
pub mod render;
pub mod rng;
pub mod sim;
#[cfg(feature = "cli")]
pub mod sumo;
pub mod task;
pub mod yaml;

pub use logicity_datalog as datalog;
pub use logicity_datalog::{cancel, diag, symbol};
pub(crate) use logicity_datalog::{diagnostic_codes, internal::threads};
