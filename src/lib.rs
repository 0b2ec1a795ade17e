//! A city of cars and pedestrians that is governed by Datalog rules, and the Datalog engine that evaluates them.
//!
//! What to reach for:
//!
//! - **Datalog without a city**: [`datalog`]. With `default-features = false` it is all that is compiled.
//! - **One scene, one decision**: [`sim::Inference`].
//! - **A city that runs**: [`sim::World`], [`sim::Simulation`].
//! - **Safe Path Following**: [`task::spf`].
//!
//! ```text
//! rules/*.dl --datalog--> Program
//!                            |
//! configs/*.yaml --config--> Scenario --> World --> Simulation --ground--> facts --> Session --> actions --> moves
//! ```
//!
//! A session keeps facts between commits and returns what each commit changed:
//!
//! ```
//! use logicity::datalog::Program;
//! use logicity::diag::Sources;
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
//! let (program, faults) = Program::load(&mut sources, entry, &logicity::files::read_text);
//! let program = program.unwrap_or_else(|| panic!("{faults:?}"));
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

pub mod datalog;
pub mod diag;
pub mod files;
pub mod rng;
pub mod symbol;

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
