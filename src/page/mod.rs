//! Builds an HTML page of a run, or of two runs side by side: one self-contained file that animates the city and
//! explains every decision.
//!
//! ```text
//! trace --Replay--> state of a tick --Page::push--> columns, explanations --Page::write--> HTML with everything in it
//!                                     two pages --Comparison--> where they differ --Comparison::write--> HTML
//! simulation --Live--> ticks and explanations as JSON, for a viewer of a running city
//! ```
//!
//! The engine computes all data; the script in the page only shows them and evaluates no rules. Explanations share
//! equal nodes over the whole run (`page::proofs`). A page names files without the folders of the author.

mod comparison;
mod file;
mod header;
mod live;
mod proofs;
mod run;
mod scenery;

pub use comparison::Comparison;
pub use live::{LIVE_TICKS, Live};
pub use run::{DECISIONS_MAX, Page};
