//! Why a fact holds and why another does not, for every command that is asked.

use super::Failure;
use crate::diag::{Code, Diagnostic, SourceId, Sources};
use crate::engine::Session;
use crate::engine::provenance::{ExplainError, Explainer, Explanation, Teller};
use crate::lang::{RelId, Texts, Value};
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

/// An explanation of whatever is the case: why some fact of that form holds, and which, or why none does.
///
/// # Errors
/// `limit-exceeded` if the search for an explanation takes too many steps.
pub fn explain(
    explainer: &mut Explainer<'_>,
    session: &Session,
    relation: RelId,
    pattern: &[Option<Value>],
) -> Result<(Question, Option<Explanation>), Failure> {
    let fault = |error: ExplainError| Diagnostic::new(Code::LimitExceeded, error.to_string());
    let fits =
        |row: &&[_]| (pattern.iter().zip(*row)).all(|(wanted, value)| wanted.is_none_or(|wanted| wanted == *value));
    Ok(match session.rows(relation).find(fits) {
        Some(row) => (Question::Holds, explainer.explain(relation, row).map_err(fault)?),
        None => {
            let absence = explainer.explain_absence(relation, pattern).map_err(fault)?;
            (Question::Fails, absence)
        }
    })
}

/// Reads the fact that a text of `sources` names, and tells why it holds or does not: a tree of lines, or one line of JSON with
/// `fact`, `holds` and `nodes`.
///
/// # Errors
/// All that is wrong with the fact, those of [`explain`], and `out` that cannot be written to.
pub fn tell(
    out: &mut impl Write,
    asked: (Question, SourceId),
    texts: &Texts,
    session: &Session,
    sources: &Sources,
    as_json: bool,
) -> Result<(), Failure> {
    let (question, source) = asked;
    let fact = texts.fact(sources, source, session.symbols())?;
    let mut explainer = Explainer::new(session);
    let (answer, explanation) = explain(&mut explainer, session, fact.relation, &fact.values)?;
    let teller = Teller::new(session.program().rules(), session.symbols(), sources).quoting();
    let shown = teller.row(fact.relation, &fact.values);
    if as_json {
        let mut line = json!({ "fact": shown, "holds": answer == Question::Holds });
        if let Some(explanation) = &explanation {
            line["nodes"] = teller.json(explanation)["nodes"].take();
        }
        writeln!(out, "{line}")?;
        return Ok(());
    }
    match (question, answer) {
        (Question::Holds, Question::Fails) => writeln!(out, "{shown} does not hold, and this is why")?,
        (Question::Fails, Question::Holds) => writeln!(out, "{shown} holds, and this is why")?,
        _ => {}
    }
    if let Some(explanation) = &explanation {
        write!(out, "{}", teller.tree(explanation))?;
    }
    Ok(())
}
