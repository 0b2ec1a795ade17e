//! What can be typed besides the language.

use crate::cli::Failure;
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, did_you_mean};
use crate::lang::DIRECTIVES;
use std::path::PathBuf;

pub const HELP: &str = "\
Facts, clauses, declarations and directives are typed as in a file and may take several lines:
  .decl Edge(x: number, y: number)
  Edge(1, 2). Edge(2, 3).
Questions are the body of a clause; each variable is a column, unless it begins with `_`:
  ?- Edge(x, y), !Edge(y, _), n = count : { Edge(_, y) }.
Commands stand on one line; a full stop at the end may be missing:
  explain FACT       why it holds: a shortest proof
  why-not FACT       why it does not: what fails in each clause; `_` is any value
  retract FACTS      take facts back; or a clause: retract Path(x, y) :- Edge(x, y).
  .load FILE...      add rule files
  .reload            read all rule files again; what was typed stays
  .facts FOLDER      read NAME.facts for each input relation
  .relations         all relations and their sizes
  .show NAME         declaration, clauses and rows of a relation
  .plan [?- ...]     how the clauses, or a question, are evaluated
  .profile           what every clause did in the last change or question
  .help, .quit
Ctrl-C drops the input, Ctrl-D ends. Tab completes.
";

/// The commands that begin with a full stop, without it.
pub const DOTTED: &[&str] = &[
    "load",
    "reload",
    "facts",
    "relations",
    "show",
    "plan",
    "profile",
    "help",
    "quit",
];

/// The commands that are words, and may begin with a full stop as well.
pub const WORDS: &[&str] = &["explain", "why-not", "retract"];

#[derive(Debug)]
pub enum Command {
    /// The text after the word is a source of its own, which has the name of the whole.
    Explain(SourceId),
    WhyNot(SourceId),
    Retract(SourceId),
    Plan(Option<SourceId>),
    Load(Vec<PathBuf>),
    Facts(PathBuf),
    Reload,
    Profile,
    Relations,
    Show(String, Span),
    Help,
    Quit,
}

/// The command that a text begins with, and what follows it.
pub fn word(text: &str) -> Option<(&'static str, &str)> {
    let text = text.trim_start();
    let (dotted, rest) = match text.strip_prefix('.') {
        Some(rest) => (true, rest),
        None => (false, text),
    };
    let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '_' || c == '?'));
    let (name, rest) = rest.split_at(end.unwrap_or(rest.len()));
    let known = WORDS
        .iter()
        .chain(if dotted { DOTTED } else { &[] })
        .find(|known| **known == name)?;
    // A predicate may have the name of a command.
    let is_atom = !dotted && !rest.starts_with(char::is_whitespace);
    (!is_atom).then_some((*known, rest))
}

/// The command that an input is; `None` if it is text of the language.
///
/// # Errors
/// A command that is unlike any, or not written as it should be.
pub fn read(sources: &mut Sources, id: SourceId) -> Result<Option<Command>, Failure> {
    let text = sources.text(id).to_owned();
    let Some((name, rest)) = word(&text) else {
        return unknown(sources, id, &text).map_or(Ok(None), |fault| Err(fault.into()));
    };
    let start = text.len() - rest.len();
    let argument = rest.trim();
    let at = start + rest.find(argument).unwrap_or(0);
    let place = Span::new(id, at..at + argument.len());
    // The same text with all before the argument blanked out, so that places stay what they are; see `pointing_at`.
    let part = |sources: &mut Sources| {
        let blank: String = text[..start]
            .chars()
            .map(|c| if c == '\n' { '\n' } else { ' ' })
            .collect();
        let name = sources.name(id).to_owned();
        sources.add(name, blank + rest)
    };
    let missing = |what: &str| {
        let fault = Diagnostic::new(Code::Syntax, format!("expected {what}"));
        fault.at(Span::new(id, start..start), "after this")
    };
    let paths = || argument.split_whitespace().map(PathBuf::from);
    Ok(Some(match name {
        "explain" | "why-not" if argument.is_empty() => return Err(missing("a fact").into()),
        "retract" if argument.is_empty() => return Err(missing("a fact or a clause").into()),
        "explain" => Command::Explain(part(sources)),
        "why-not" => Command::WhyNot(part(sources)),
        "retract" => {
            let id = part(sources);
            if argument.ends_with('.') {
                Command::Retract(id)
            } else {
                let (name, text) = (
                    sources.name(id).to_owned(),
                    sources.text(id).trim_end().to_owned() + ".",
                );
                Command::Retract(sources.add(name, text))
            }
        }
        "plan" if argument.is_empty() => Command::Plan(None),
        "plan" => Command::Plan(Some(part(sources))),
        "load" if argument.is_empty() => return Err(missing("the names of rule files").into()),
        "load" => Command::Load(paths().collect()),
        "facts" if argument.is_empty() => return Err(missing("the name of a folder").into()),
        "facts" => Command::Facts(PathBuf::from(argument)),
        "show" if argument.is_empty() => return Err(missing("the name of a relation").into()),
        "show" => Command::Show(argument.trim_end_matches('.').to_owned(), place),
        simple => {
            if !argument.trim_end_matches('.').is_empty() {
                let fault = Diagnostic::new(Code::Syntax, format!("`.{simple}` stands alone"));
                return Err(fault.at(place, "").into());
            }
            match simple {
                "reload" => Command::Reload,
                "profile" => Command::Profile,
                "relations" => Command::Relations,
                "quit" => Command::Quit,
                _ => Command::Help,
            }
        }
    }))
}

/// Lets diagnostics that point into the argument of a command point into the whole input.
pub fn pointing_at(failure: Failure, id: SourceId, sources: &Sources) -> Failure {
    let Failure::Input(mut faults) = failure else {
        return failure;
    };
    for fault in &mut faults {
        for label in fault.primary.iter_mut().chain(&mut fault.secondary) {
            if sources.name(label.span.source) == sources.name(id) {
                label.span.source = id;
            }
        }
    }
    Failure::Input(faults)
}

/// The fault of a word after a full stop that is neither directive nor command, but like a command.
fn unknown(sources: &Sources, id: SourceId, text: &str) -> Option<Diagnostic> {
    let start = text.len() - text.trim_start().len();
    let rest = text[start..].strip_prefix('.')?;
    let name: String = rest
        .chars()
        .take_while(|c| c.is_ascii_alphanumeric() || "-_".contains(*c))
        .collect();
    if name.is_empty() || DIRECTIVES.contains(&name.as_str()) {
        return None;
    }
    let near = did_you_mean(&name, DOTTED.iter().chain(WORDS).chain(DIRECTIVES).copied())?;
    if DIRECTIVES.contains(&near) {
        return None;
    }
    let span = Span::new(id, start..start + 1 + name.len());
    let fault = Diagnostic::new(Code::Syntax, format!("no command `{}`", sources.slice(span)));
    Some(fault.at(span, "").help(format!(
        "did you mean `{}{near}`?",
        if WORDS.contains(&near) { "" } else { "." }
    )))
}
