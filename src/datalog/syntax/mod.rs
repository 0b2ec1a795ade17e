//! Syntax: from text to syntax tree and back.
//!
//! Each stage has a file or folder: `preprocess` (files with directives of the C preprocessor to one text), `lexer` (text
//! to tokens), `parser` (tokens to [`ast`]) and `include` (the files of a program to one list of items; `locate` finds
//! them, `packed` keeps plain facts compactly). [`print`](fn@print) writes a tree as text. [`format`](fn@format) changes
//! the layout of a text and keeps its comments.
//!
//! This module resolves no names and reads no files: the caller passes a function that reads.

pub mod ast;
mod formatter;
pub mod functor;
pub(crate) mod include;
pub(crate) mod lexer;
mod locate;
pub(crate) mod packed;
pub(crate) mod parser;
mod preprocess;
pub(crate) mod printer;

use crate::diag::{Diagnostic, Faults, SourceId, Sources};

pub use formatter::format;
pub use lexer::{TokenKind, is_name, tokens};
pub use parser::{DIRECTIVES, FULL_STOP};
pub use preprocess::Preprocessing;
pub use printer::{print, quoted};

/// The result of [`parse`].
#[derive(Clone, Debug)]
pub struct Parsed {
    /// The tree of everything that the parser understood.
    pub file: ast::File,
    /// The faults of the source.
    pub diagnostics: Vec<Diagnostic>,
}

/// Parses one source. Resolves no names and follows no `.include`.
pub fn parse(sources: &Sources, id: SourceId) -> Parsed {
    let mut faults = Faults::default();
    let file = include::parse_one(sources, id, &mut faults);
    Parsed {
        file,
        diagnostics: faults.finish(),
    }
}
