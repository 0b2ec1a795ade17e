//! Programs from text, for examples and benches.

use logicity::datalog;
use logicity::datalog::Program;
use logicity::diag::{Sources, render};

/// Compiles a text, which may include the files of `rules/`.
pub fn program(text: &str) -> Program {
    let mut sources = Sources::new();
    let entry = sources.add(concat!(env!("CARGO_MANIFEST_DIR"), "/rules/example.dl"), text);
    let loaded = datalog::load(&mut sources, entry, &logicity::files::read_text);
    let rules = loaded
        .rules
        .unwrap_or_else(|| panic!("{}", render(&loaded.diagnostics, &sources, false)));
    Program::new(rules).expect("the rules are safe and small")
}
