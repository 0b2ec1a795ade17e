//! What can be typed besides the language.

use crate::cli::Failure;
use crate::datalog::DIRECTIVES;
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, did_you_mean};
use std::path::PathBuf;

pub const HELP: &str = "\
Facts, clauses, declarations and directives are typed as in a file and may take several lines:
  .decl Edge(x: number, y: number)
  Edge(1, 2). Edge(2, 3).
Questions are the body of a clause; each variable is a column, unless it begins with `_`:
  ?- Edge(x, y), !Edge(y, _), n = count : { Edge(_, y) }.
Their full stop may be missing where the line is complete without it.
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

/// What other prompts call it, and what to type here.
const OTHER_WORDS: &[(&str, &str)] = &[
    ("why", "explain FACT"),
    ("proof", "explain FACT"),
    ("prove", "explain FACT"),
    ("whynot", "why-not FACT"),
    ("why_not", "why-not FACT"),
    ("exit", ".quit"),
    ("bye", ".quit"),
    ("q", ".quit"),
    ("h", ".help"),
    ("tables", ".relations"),
    ("schema", ".show NAME"),
    ("ask", "?- BODY"),
    ("query", "?- BODY"),
    ("delete", "retract FACTS"),
    ("remove", "retract FACTS"),
    ("read", ".load FILE"),
    ("consult", ".load FILE"),
];

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

/// A command as it was typed.
struct Typed<'t> {
    id: SourceId,
    text: &'t str,
    /// Where what follows the word begins.
    start: usize,
}

impl<'t> Typed<'t> {
    fn argument(&self) -> &'t str {
        self.text[self.start..].trim()
    }

    fn place(&self) -> Span {
        let rest = &self.text[self.start..];
        let at = self.start + rest.len() - rest.trim_start().len();
        Span::new(self.id, at..at + self.argument().len())
    }

    /// The argument as a source of its own, in which all before it is blanked out, so that places stay what they are; see
    /// [`pointing_at`]. It ends as given.
    fn part(&self, sources: &mut Sources, end: &str) -> SourceId {
        let line_or_blank = |c: char| if c == '\n' { '\n' } else { ' ' };
        let blank: String = self.text[..self.start].chars().map(line_or_blank).collect();
        let name = sources.name(self.id).to_owned();
        sources.add(name, blank + self.text[self.start..].trim_end() + end)
    }

    /// Unless there is an argument.
    fn wants(&self, what: &str) -> Result<(), Failure> {
        if !self.argument().is_empty() {
            return Ok(());
        }
        let fault = Diagnostic::new(Code::SYNTAX, format!("expected {what}"));
        Err(fault
            .at(Span::new(self.id, self.start..self.start), "after this")
            .into())
    }

    /// Unless there is none.
    fn stands_alone(&self, name: &str) -> Result<(), Failure> {
        if self.argument().trim_end_matches('.').is_empty() {
            return Ok(());
        }
        let fault = Diagnostic::new(Code::SYNTAX, format!("`.{name}` stands alone"));
        Err(fault.at(self.place(), "").into())
    }
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
    let typed = Typed {
        id,
        text: &text,
        start: text.len() - rest.len(),
    };
    let argument = typed.argument();
    match name {
        "explain" | "why-not" => typed.wants("a fact")?,
        "retract" => typed.wants("a fact or a clause")?,
        "load" => typed.wants("the names of rule files")?,
        "facts" => typed.wants("the name of a folder")?,
        "show" => typed.wants("the name of a relation")?,
        "plan" => {}
        alone => typed.stands_alone(alone)?,
    }
    Ok(Some(match name {
        "explain" => Command::Explain(typed.part(sources, "")),
        "why-not" => Command::WhyNot(typed.part(sources, "")),
        "retract" if argument.ends_with('.') => Command::Retract(typed.part(sources, "")),
        "retract" => Command::Retract(typed.part(sources, ".")),
        "plan" if argument.is_empty() => Command::Plan(None),
        "plan" => Command::Plan(Some(typed.part(sources, ""))),
        "load" => Command::Load(argument.split_whitespace().map(PathBuf::from).collect()),
        "facts" => Command::Facts(PathBuf::from(argument)),
        "show" => Command::Show(argument.trim_end_matches('.').to_owned(), typed.place()),
        "reload" => Command::Reload,
        "profile" => Command::Profile,
        "relations" => Command::Relations,
        "quit" => Command::Quit,
        _ => Command::Help,
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

/// The word that a text begins with, with its full stop if there is one, where other prompts have it for a command; and what to type here.
pub fn foreign(text: &str) -> Option<(&str, &'static str)> {
    let text = text.trim_start();
    let written = text.split_whitespace().next()?;
    // With arguments in parentheses it is a predicate.
    let name = written.strip_prefix('.').unwrap_or(written).trim_end_matches('.');
    let (_, meant) = OTHER_WORDS.iter().find(|(other, _)| *other == name)?;
    Some((written, meant))
}

/// The fault of a word that is no command here: one of other prompts, or after a full stop one that is unlike any directive.
fn unknown(sources: &Sources, id: SourceId, text: &str) -> Option<Diagnostic> {
    let start = text.len() - text.trim_start().len();
    let fault = |length: usize| {
        let span = Span::new(id, start..start + length);
        Diagnostic::new(Code::SYNTAX, format!("no command `{}`", sources.slice(span))).at(span, "")
    };
    if let Some((written, meant)) = foreign(text) {
        return Some(fault(written.len()).help(format!("type `{meant}`")));
    }
    let rest = text[start..].strip_prefix('.')?;
    let name: String = rest
        .chars()
        .take_while(|c| c.is_ascii_alphanumeric() || "-_".contains(*c))
        .collect();
    if name.is_empty() || DIRECTIVES.contains(&name.as_str()) {
        return None;
    }
    let help = match did_you_mean(&name, DOTTED.iter().chain(WORDS).chain(DIRECTIVES).copied()) {
        Some(near) if DIRECTIVES.contains(&near) => return None,
        Some(near) if WORDS.contains(&near) => format!("did you mean `{near}`?"),
        Some(near) => format!("did you mean `.{near}`?"),
        None => format!(
            "there are `.{}`; directives are typed as in a file",
            DOTTED.join("`, `.")
        ),
    };
    Some(fault(1 + name.len()).help(help))
}
