//! Prints diagnostics and failures, and counts in messages.

use crate::city::{KindId, KindTable};
use crate::cli::failure::Failure;
use crate::cli::limits::advised;
use crate::cli::{signals, terminal};
use crate::config;
use crate::diag::{Diagnostic, Sources, counted, render};
use std::io::Write;

/// Prints a failure and returns its exit code.
pub fn exit(failure: Failure, sources: &Sources) -> u8 {
    match failure {
        Failure::Closed => 0,
        Failure::Input(diagnostics) => {
            report(&diagnostics, sources);
            // Splits come from options only.
            let is_option = diagnostics
                .iter()
                .all(|fault| fault.code == config::codes::UNKNOWN_SPLIT);
            if is_option { 2 } else { 1 }
        }
        Failure::Option(diagnostics) => {
            report(&diagnostics, sources);
            2
        }
        Failure::Reported => 1,
        Failure::Interrupted => signals::code(),
        Failure::Usage(message) => {
            let _ = writeln!(terminal::err(), "error: {message}");
            2
        }
    }
}

/// Prints diagnostics to standard error, with the options that raise exceeded limits, and their count if there are
/// several.
pub fn report(diagnostics: &[Diagnostic], sources: &Sources) {
    if diagnostics.is_empty() {
        return;
    }
    let diagnostics = sources.all_traced(diagnostics);
    terminal::print_styled(&render(&advised(&diagnostics), sources, terminal::has_color()));
    let errors = diagnostics.iter().filter(|diagnostic| diagnostic.is_error()).count();
    if diagnostics.len() > 1 {
        let _ = writeln!(terminal::err(), "{}", count(errors, diagnostics.len() - errors));
    }
}

/// Formats the numbers of agents of each kind, for example `7 cars and 4 pedestrians`. Omits kinds of the configuration
/// without agents.
pub fn agents_in_words(kinds: &KindTable, count: impl Fn(KindId) -> usize) -> String {
    let counted = kinds.all().filter_map(|kind| match (count(kind), kind.is_standard()) {
        (0, false) => None,
        (count, true) => Some(counted(count, &kinds.name(kind).to_lowercase())),
        (count, false) => Some(counted(count, kinds.name(kind))),
    });
    let counted: Vec<String> = counted.collect();
    let (last, first) = counted.split_last().expect("the standard kinds");
    format!("{} and {last}", first.join(", "))
}

/// Formats counts, for example `2 errors, 1 warning`.
pub fn count(errors: usize, warnings: usize) -> String {
    match (errors, warnings) {
        (errors, 0) => counted(errors, "error"),
        (0, warnings) => counted(warnings, "warning"),
        (errors, warnings) => format!("{}, {}", counted(errors, "error"), counted(warnings, "warning")),
    }
}
