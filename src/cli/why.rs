//! Why a fact holds and why another does not, for every command that is asked.

use crate::cli::Failure;
use crate::datalog::Session;
use crate::datalog::Workspace;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{Diagnostic, SourceId, Sources};
use serde_json::json;
use std::io::Write;

/// What is asked about a fact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// Why it holds.
    Holds,
    /// Why it does not.
    Fails,
}

/// Reads the fact that a text of `sources` names, and tells why it holds or does not: a tree of lines, or one line of JSON with
/// `fact`, `holds` and `nodes`.
///
/// # Errors
/// All that is wrong with the fact, `limit-exceeded` if the search for an explanation takes too many steps, and `out` that cannot be
/// written to.
pub fn print(
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
        (Explainer::new(session).explain_either(fact.relation, &fact.values)).map_err(Diagnostic::from)?;
    let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources).quoting();
    let shown = printer.row(fact.relation, &fact.values);
    if as_json {
        let mut line = json!({ "fact": shown, "holds": holds });
        if let Some(explanation) = &explanation {
            line["nodes"] = printer.json(explanation)["nodes"].take();
        }
        writeln!(out, "{line}")?;
        return Ok(());
    }
    match (question, holds) {
        (Question::Holds, false) => writeln!(out, "{shown} does not hold, and this is why")?,
        (Question::Fails, true) => writeln!(out, "{shown} holds, and this is why")?,
        _ => {}
    }
    if let Some(explanation) = &explanation {
        write!(out, "{}", printer.tree(explanation))?;
    }
    Ok(())
}
