//! The commands of the prompt.

use crate::cli::failure::Failure;
use crate::datalog::codes;
use crate::datalog::{DIRECTIVES, FULL_STOP};
use crate::diag::{Diagnostic, SourceId, Sources, Span, did_you_mean};
use std::path::PathBuf;

pub const HELP: &str = "\
Type facts, clauses, declarations and directives as in a file; they may span several lines:
  .decl Edge(x: number, y: number)
  Edge(1, 2). Edge(2, 3).
Ask questions as the body of a clause; each variable is a column unless it begins with `_`:
  ?- Edge(x, y), !Edge(y, _), n = count : { Edge(_, y) }.
The full stop is optional where the line is complete without it.
The prompt `| ` continues an incomplete input: end it with a full stop, or discard it with Ctrl-C. A line that begins
with `?-` or with a command's full stop ends it, too.
Commands take one line; a full stop at the end is optional:
  explain FACT       explain why it holds, with a shortest proof
  why-not FACT       explain why it does not hold; `_` matches any value
  retract FACTS      retract facts, or a clause: retract Path(x, y) :- Edge(x, y).
  .load FILE...      add rule files
  .reload            reload all rule files; keep what you typed
  .facts FOLDER      read NAME.facts for each input predicate
  .tick [N]          begin the next tick, or N ticks, and sum their changes; facts stay until you retract them, and
                     changed rules begin again at tick 0
  .predicates         list all predicates and their sizes
  .show NAME         print declaration, clauses and rows of a predicate
  .plan [?- ...]     print the evaluation plan of the clauses or of a question
  .profile           print the work of each clause in the last change or question
  .help              print this help
  .quit              quit
Ctrl-C discards the input, Ctrl-D quits, Tab completes.
";

/// The commands that begin with a full stop, without it.
pub const DOTTED: &[&str] = &[
    "load",
    "reload",
    "facts",
    "tick",
    "predicates",
    "show",
    "plan",
    "profile",
    "help",
    "quit",
];

/// The commands that are words; a full stop before them is optional.
pub const WORDS: &[&str] = &["explain", "why-not", "retract"];

/// Words of other prompts, and their equivalents here.
const OTHER_WORDS: &[(&str, &str)] = &[
    ("why", "explain FACT"),
    ("proof", "explain FACT"),
    ("prove", "explain FACT"),
    ("whynot", "why-not FACT"),
    ("why_not", "why-not FACT"),
    ("exit", ".quit"),
    ("quit", ".quit"),
    ("bye", ".quit"),
    ("q", ".quit"),
    ("h", ".help"),
    ("help", ".help"),
    ("tables", ".predicates"),
    ("relations", ".predicates"),
    ("schema", ".show NAME"),
    ("ask", "?- BODY"),
    ("query", "?- BODY"),
    ("delete", "retract FACTS"),
    ("remove", "retract FACTS"),
    ("read", ".load FILE"),
    ("advance", ".tick"),
    ("next", ".tick"),
    ("consult", ".load FILE"),
];

/// The words of [`OTHER_WORDS`] that end an incomplete input if they are alone on a line.
const LONE_WORDS: &[&str] = &["quit", "exit", "help"];

/// The maximum number of ticks of a command.
const TICKS_MAX: u32 = 1_000_000;

#[derive(Debug)]
pub enum Command {
    /// The argument is a separate text with the name of the input; see `Typed::part`.
    Explain(SourceId),
    WhyNot(SourceId),
    Retract(SourceId),
    Plan(Option<SourceId>),
    Load(Vec<PathBuf>),
    Facts(PathBuf),
    /// The number of ticks.
    Tick(u32),
    Reload,
    Profile,
    Predicates,
    Show(String, Span),
    Help,
    Quit,
}

/// Returns the command at the start of a text, and the text after it.
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

/// Returns whether a line after an incomplete text is an input of its own and not a part of the text: a question, a
/// command with a full stop, or a lone word such as `quit`, outside of a comment.
pub fn interrupts(text: &str, line: &str) -> bool {
    let begin = line.trim_start();
    let is_command = begin.starts_with('.') && (word(line).is_some() || foreign(line).is_some());
    // Between two operands, a lone word cannot continue a clause.
    let follows_operand = || {
        let last = text.trim_end().chars().next_back();
        last.is_some_and(|last| last.is_alphanumeric() || "_)]}\"".contains(last))
    };
    let is_lone_word = || LONE_WORDS.contains(&begin.trim_end().trim_end_matches('.')) && follows_operand();
    // Only such a line pays for a search through the text, which may be large.
    (is_command || begin.starts_with("?-") || is_lone_word()) && text.rfind("/*") <= text.rfind("*/")
}

/// Renames the faults of a text that the next input interrupted: a clause without its full stop is the likely cause.
pub fn interrupted(failure: Failure) -> Failure {
    let Failure::Input(mut faults) = failure else {
        return failure;
    };
    for fault in &mut faults {
        if fault.help.iter().any(|help| help == FULL_STOP) {
            fault.message = "the clause before lacks a full stop".to_owned();
        }
    }
    Failure::Input(faults)
}

/// A command as the user typed it.
struct Typed<'t> {
    id: SourceId,
    text: &'t str,
    /// The start of the text after the command word.
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

    /// Adds the argument as a source in which blanks replace the text before it, so that positions stay valid; see
    /// [`pointing_at`]. Appends `end`.
    fn part(&self, sources: &mut Sources, end: &str) -> SourceId {
        let line_or_blank = |c: char| if c == '\n' { '\n' } else { ' ' };
        let blank: String = self.text[..self.start].chars().map(line_or_blank).collect();
        let name = sources.name(self.id).to_owned();
        sources.add(name, blank + self.text[self.start..].trim_end() + end)
    }

    /// Fails if the argument is missing.
    fn wants(&self, what: &str) -> Result<(), Failure> {
        if !self.argument().is_empty() {
            return Ok(());
        }
        let fault = Diagnostic::new(codes::SYNTAX, format!("expected {what}"));
        Err(fault
            .at(Span::new(self.id, self.start..self.start), "expected here")
            .into())
    }

    /// Returns the number of ticks; 1 without an argument.
    fn ticks(&self) -> Result<u32, Failure> {
        match self.argument().trim_end_matches('.') {
            "" => Ok(1),
            number => number
                .parse()
                .ok()
                .filter(|ticks| (1..=TICKS_MAX).contains(ticks))
                .ok_or_else(|| {
                    let fault = Diagnostic::new(codes::SYNTAX, format!("`{number}` is not a number of ticks"));
                    fault.at(self.place(), format!("expected 1 to {TICKS_MAX}")).into()
                }),
        }
    }

    /// Fails if there is an argument.
    fn stands_alone(&self, name: &str) -> Result<(), Failure> {
        if self.argument().trim_end_matches('.').is_empty() {
            return Ok(());
        }
        let fault = Diagnostic::new(codes::SYNTAX, format!("`.{name}` takes no argument"));
        Err(fault.at(self.place(), "").into())
    }
}

/// Parses a command; returns `None` for text of the language.
///
/// # Errors
/// `syntax` for an unknown command, or one with a missing or extra argument.
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
        "show" => typed.wants("the name of a predicate")?,
        "plan" | "tick" => {}
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
        "tick" => Command::Tick(typed.ticks()?),
        "show" => Command::Show(argument.trim_end_matches('.').to_owned(), typed.place()),
        "reload" => Command::Reload,
        "profile" => Command::Profile,
        "predicates" => Command::Predicates,
        "quit" => Command::Quit,
        _ => Command::Help,
    }))
}

/// Redirects diagnostics from the argument of a command to the whole input.
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

/// Returns the first word of a text if it is a command of other prompts, and its equivalent here.
pub fn foreign(text: &str) -> Option<(&str, &'static str)> {
    let text = text.trim_start();
    let written = text.split_whitespace().next()?;
    // A word with arguments in parentheses is a predicate.
    let name = written.strip_prefix('.').unwrap_or(written).trim_end_matches('.');
    let (_, meant) = OTHER_WORDS.iter().find(|(other, _)| *other == name)?;
    Some((written, meant))
}

/// Returns the fault of an unknown command: one of other prompts, or one with a full stop that resembles no directive.
fn unknown(sources: &Sources, id: SourceId, text: &str) -> Option<Diagnostic> {
    let start = text.len() - text.trim_start().len();
    let fault = |length: usize| {
        let span = Span::new(id, start..start + length);
        Diagnostic::new(codes::SYNTAX, format!("no command `{}`", sources.slice(span))).at(span, "")
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
            "the commands are `.{}`; type directives as in a file",
            DOTTED.join("`, `.")
        ),
    };
    Some(fault(1 + name.len()).help(help))
}
