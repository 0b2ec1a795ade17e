//! From text to checked rules.
//!
//! [`load`] is the door: it reads a rule file and all it includes and gives the checked [`Rules`], or every fault of every
//! file; [`Texts`] is for those who change a program and ask it questions. [`parse`] and [`print`](fn@print) go between text and syntax
//! tree without checking names; [`format`](fn@format) lays a text out and keeps its comments.
//!
//! The stages, each in its own file or folder: `lexer` (text to tokens), `parser` (tokens to [`ast`]), `include` (the texts of a program as
//! one list of items), `inline` (predicates that stand for their bodies), `names` (types and predicates), `clause` (alternatives and
//! several heads), `witness` (who has the least), `body` (one clause: names, expressions, types, safety), `aggregate` and `range` (hidden
//! predicates for these), `scope` (guards), `promise` (what is promised of facts), `strata` (order of evaluation), `lint` (warnings that
//! need all clauses). None stops at the first fault.
//!
//! This room refuses to know what a city is, how rules are evaluated, and where texts come from: the caller reads the files.

use std::path::Path;

use crate::diag::{Diagnostic, Faults, SourceId, Sources};
use crate::files::ReadError;
use crate::symbol::Symbols;

mod aggregate;
pub mod ast;
mod body;
mod clause;
mod format;
mod functor;
mod include;
mod inline;
mod lexer;
mod lint;
mod names;
mod parser;
mod print;
mod promise;
mod range;
mod rules;
mod scope;
mod strata;
mod subsets;
mod texts;
mod witness;

pub use format::format;
pub use functor::{AggregateOp, Functor, Patterns, parse as parse_value};
pub use parser::DIRECTIVES;
pub use print::{print, quoted};
pub use rules::{
    Atom, BaseType, Clause, ClauseId, Column, Comparison, Constraint, Directive, Literal, MarkKind, Promise, RelId,
    Relation, RowFormat, RowPlace, Rules, Stratum, Term, Type, TypeId, Value, VarId,
};

pub use lexer::is_name;
pub use subsets::Comparing;
#[cfg(test)]
pub(crate) use subsets::random_clauses;
pub(crate) use subsets::{Budget, Subsets};
pub use texts::{FactPattern, FactRow, Texts, is_complete};

/// What [`load`] gives.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The rules; `None` if a diagnostic is an error.
    pub rules: Option<Rules>,
    /// Errors and warnings of all files, in the order of the text.
    pub diagnostics: Vec<Diagnostic>,
    /// What looking for clauses that derive nothing new took.
    pub compared: Comparing,
}

impl Loaded {
    /// No rules, because of these faults.
    fn failed(diagnostics: Vec<Diagnostic>) -> Self {
        Loaded {
            rules: None,
            diagnostics,
            compared: Comparing::default(),
        }
    }
}

/// Reads and checks the rules of `entry`, a text of `sources`, and of all it includes.
///
/// `.include "x"` asks `read` for `x` in the folder of the including text (whose path is its name in `sources`); if that is
/// not found, for the path [`BUILTIN_FOLDER`](crate::files::BUILTIN_FOLDER)`/x`, at which the caller may serve rule files of its own.
/// Included texts are added to `sources`.
pub fn load(sources: &mut Sources, entry: SourceId, read: &dyn Fn(&Path) -> Result<String, ReadError>) -> Loaded {
    load_with(sources, entry, read, Inputs::Given)
}

/// What holds of a predicate that is `.input`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Inputs {
    /// The rows that are given, and the facts of the text: a rule for it is an error.
    #[default]
    Given,
    /// Besides, what rules derive, as in Soufflé: a rule for it is told by a warning.
    Extended,
}

/// As [`load`], with a choice of what an `.input` is.
pub fn load_with(
    sources: &mut Sources,
    entry: SourceId,
    read: &dyn Fn(&Path) -> Result<String, ReadError>,
    inputs: Inputs,
) -> Loaded {
    let mut texts = Texts::new(inputs);
    texts.add(sources, entry, read);
    texts.check()
}

/// Checks all items. The constants' texts are added to `symbols`. There are no rules if there is an error.
fn check(
    items: &[ast::Item],
    complete: bool,
    inputs: Inputs,
    symbols: Symbols,
    faults: &mut Faults,
) -> (Option<Rules>, Comparing) {
    let replaced = inline::replace(items, faults);
    let syntax_is_good = !faults.failed();
    let items = replaced.as_deref().unwrap_or(items);
    let mut names = names::declare(items, complete, inputs, faults);
    let checked = clause::check(items, &mut names, symbols, faults);
    let promises = promise::check(items, &mut names, faults);
    names.report_unknown(faults);
    strata::check(&checked.edges, &names, faults);
    let mut compared = Comparing::default();
    // What could not be read might make a clause live, or tell two clauses apart.
    if syntax_is_good {
        lint::dead(&checked, &names, faults);
        compared = lint::redundant(&checked.clauses, faults);
    }
    if faults.failed() {
        return (None, compared);
    }
    let names::Names { types, relations, .. } = names;
    let clauses: Vec<Clause> = (checked.clauses.into_iter().map(|clause| clause.clause))
        .chain(checked.hidden)
        .collect();
    let rules = Rules {
        strata: strata::order(&relations, &clauses),
        types,
        relations,
        clauses,
        symbols: checked.symbols,
        promises,
    };
    (Some(rules), compared)
}

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
