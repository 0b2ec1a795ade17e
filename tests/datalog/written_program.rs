//! Programs from text, for examples and benches.

use crate::root::root;
use logicity_datalog as datalog;
use logicity_datalog::Program;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::files::to_text;
use std::path::Path;

/// Compiles a text, which may include the files of `rules/`.
pub fn program(text: &str) -> Program {
    let mut sources = Sources::new();
    let entry = sources.add(root().join("rules/example.dl").display().to_string(), text);
    let loaded = datalog::load(&mut sources, entry, &|path: &Path| to_text(std::fs::read(path)?));
    let rules = loaded
        .rules
        .unwrap_or_else(|| panic!("{}", render(&loaded.diagnostics, &sources, false)));
    Program::new(rules).expect("the rules are safe and small")
}
