//! A city of cars and pedestrians that is governed by Datalog rules.
//!
//! What to reach for:
//!
//! - **One scene, one decision**: [`sim::Inference`].
//! - **A city that runs**: [`config::load_scenario`], [`sim::World`], [`sim::Simulation`].
//! - **Datalog without a city**: [`lang::load`], [`engine::Program`], [`engine::Session`].
//!
//! ```text
//! rules/*.dl --lang--> Rules --engine--> Program
//!                                           |
//! configs/*.yaml --config--> Scenario --> World --> Simulation --ground--> facts --> Session --> actions --> moves
//! ```
//!
//! A session keeps facts between commits and says what each commit changed:
//!
//! ```
//! use logicity::{diag::Sources, engine::Program, files, lang};
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
//! let loaded = lang::load(&mut sources, entry, &files::read_or_builtin);
//! let rules = loaded.rules.expect("no errors");
//! let program = Program::new(rules).expect("within limits");
//! let (edge, path) = (program.relation("edge").unwrap(), program.relation("path").unwrap());
//!
//! let mut session = program.session();
//! let [a, b, c] = ["a", "b", "c"].map(|name| session.intern(name));
//! session.insert(edge, &[a, b])?;
//! session.commit()?;
//! session.insert(edge, &[b, c])?;
//! let delta = session.commit()?;
//! let appeared: Vec<_> = delta.of(path).unwrap().added.iter().collect();
//! assert_eq!(appeared, [[a, c], [b, c]]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod city;
pub mod cli;
pub mod config;
pub mod diag;
pub mod engine;
pub mod files;
pub mod lang;
pub mod page;
pub mod render;
pub mod rng;
pub mod sim;
pub mod symbol;
pub mod task;
