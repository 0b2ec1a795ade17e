//! Explains why a fact holds or does not hold, for all commands.

use crate::cli::failure::Failure;
use crate::datalog::Session;
use crate::datalog::Workspace;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{Diagnostic, SourceId, Sources};
use serde_json::json;
use std::io::Write;

/// A question about a fact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// Why does it hold?
    Holds,
    /// Why does it not hold?
    Fails,
}

/// Reads a fact from a text of `sources` and prints why it holds or does not: a tree of lines, or one line of JSON with
/// the keys `fact`, `holds` and `nodes`.
///
/// # Errors
/// The diagnostics of the fact; `limit-exceeded` if the search for an explanation takes too many steps; errors of
/// `out`.
pub fn explain(
    out: &mut impl Write,
    asked: (Question, SourceId),
    workspace: &Workspace,
    session: &Session,
    sources: &Sources,
    as_json: bool,
) -> Result<(), Failure> {
    let (question, source) = asked;
    let fact = workspace.fact(sources, source, session.symbols())?;
    let (holds, explanation) =
        (Explainer::new(session).explain_either(fact.predicate, &fact.values)).map_err(Diagnostic::from)?;
    let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources).quoting();
    let shown = printer.row(fact.predicate, &fact.values);
    if as_json {
        let mut line = json!({ "fact": shown, "holds": holds });
        if let Some(explanation) = &explanation {
            line["nodes"] = printer.json(explanation)["nodes"].take();
        }
        writeln!(out, "{line}")?;
        return Ok(());
    }
    match (question, holds) {
        (Question::Holds, false) => writeln!(out, "{shown} does not hold, because:")?,
        (Question::Fails, true) => writeln!(out, "{shown} holds, because:")?,
        _ => {}
    }
    if let Some(explanation) = &explanation {
        write!(out, "{}", printer.tree(explanation))?;
    }
    Ok(())
}
