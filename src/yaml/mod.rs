//! Reads YAML: the tree of a file with places, and typed values from it.
//!
//! ```text
//! text --parse--> YamlNode (values with places) --read--> typed values, all faults
//! ```
//!
//! This module does not know which keys there are or what they mean.

pub mod codes;
mod mistakes;
pub(crate) mod read;
mod tree;

pub(crate) use tree::{Key, MAX_BYTES, MAX_NODES, Value, YamlNode, parse};
