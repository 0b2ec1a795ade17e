#![cfg_attr(
    feature = "sim",
    doc = "A city of cars and pedestrians governed by Datalog rules, and the Datalog engine that evaluates them."
)]
#![cfg_attr(
    not(feature = "sim"),
    doc = "An incremental Datalog engine for rules in a dialect of Soufflé: LogiCity without the city."
)]
//!
//! # Where to start
//!
//! - **Datalog**: [`datalog`] loads rules, keeps facts and maintains what follows. The crate with
//!   `default-features = false` contains this engine alone.
//! - **Sources and diagnostics**: [`diag`] holds the texts of rules and prints what is wrong with them.
#![cfg_attr(feature = "sim", doc = "- **One scene, one decision**: [`sim::Inference`].")]
#![cfg_attr(
    feature = "sim",
    doc = "- **A running city**: [`sim::World`] and [`sim::Simulation`]."
)]
#![cfg_attr(feature = "sim", doc = "- **Safe Path Following**: [`task::spf`].")]
#![cfg_attr(
    feature = "sim",
    doc = "
```text
rules/*.dl --datalog--> Program
                           |
configs/*.yaml --config--> Scenario --> World --> Simulation --ground--> facts --> Session --> actions --> moves
```"
)]
//!
//! # Example
//!
//! A [`Program`](datalog::Program) holds checked rules. A [`Session`](datalog::Session) of it keeps facts between
//! commits. Every commit returns a [`Delta`](datalog::Delta): the rows it added and removed.
//!
//! ```
//! use logicity::datalog::Program;
//! use logicity::diag::{Sources, render};
//! use logicity::files;
//!
//! let mut sources = Sources::new();
//! let entry = sources.add(
//!     "path.dl",
//!     ".decl edge(x: symbol, y: symbol)
//!      .input edge
//!      .decl path(x: symbol, y: symbol)
//!      path(x, y) :- edge(x, y).
//!      path(x, z) :- path(x, y), edge(y, z).",
//! );
//! let (program, diagnostics) = Program::load(&mut sources, entry, &files::read_text);
//! let program = program.ok_or_else(|| render(&diagnostics, &sources, false))?;
//! let (edge, path) = (program.relation("edge").unwrap(), program.relation("path").unwrap());
//!
//! let mut session = program.session();
//! let [a, b, c] = ["a", "b", "c"].map(|name| session.intern(name));
//! session.insert(edge, &[a, b])?;
//! session.commit()?;
//! session.insert(edge, &[b, c])?;
//! let delta = session.commit()?;
//! let added: Vec<_> = delta.of(path).unwrap().added.iter().collect();
//! assert_eq!(added, [[a, c], [b, c]]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! See also the [life of a program](datalog#the-life-of-a-program), [what is incremental](datalog#what-is-incremental)
//! and the [limits](datalog#limits).

pub mod cancel;
#[cfg(test)]
mod cases;
pub mod datalog;
pub mod diag;
pub mod files;
pub mod induce;
pub mod rng;
pub mod symbol;
pub(crate) mod threads;

#[cfg(feature = "sim")]
pub mod builtin;
#[cfg(feature = "sim")]
pub mod city;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[cfg(feature = "sim")]
pub mod config;
#[cfg(feature = "render")]
pub mod page;
#[cfg(feature = "sim")]
pub mod predicate;
#[cfg(feature = "render")]
pub mod render;
#[cfg(feature = "sim")]
pub mod sim;
#[cfg(feature = "sim")]
pub mod task;
