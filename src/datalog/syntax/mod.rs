//! From text to syntax tree and back.
//!
//! The stages, each in its own file or folder: `lexer` (text to tokens), `parser` (tokens to [`ast`]), `include` (the files of a program
//! as one list of items). [`print`](fn@print) writes a tree as text; [`format`](fn@format) lays a text out and keeps its comments.
//!
//! This room does not resolve names, and it reads no files: the caller passes a function that does.

pub mod ast;
mod formatter;
pub mod functor;
pub(crate) mod include;
pub(crate) mod lexer;
pub(crate) mod parser;
mod printer;

use crate::diag::{Diagnostic, Faults, SourceId, Sources};

pub use formatter::format;
pub use lexer::is_name;
pub use parser::DIRECTIVES;
pub use printer::{print, quoted};

/// What [`parse`] gives.
#[derive(Clone, Debug)]
pub struct Parsed {
    /// The tree of all that could be understood.
    pub file: ast::File,
    /// The faults of the text.
    pub diagnostics: Vec<Diagnostic>,
}

/// Parses one text of `sources`, looking up no name and following no `.include`.
pub fn parse(sources: &Sources, id: SourceId) -> Parsed {
    let mut faults = Faults::default();
    let file = include::parse_one(sources, id, &mut faults);
    Parsed {
        file,
        diagnostics: faults.finish(),
    }
}
