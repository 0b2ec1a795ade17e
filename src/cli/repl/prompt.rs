//! Reads inputs: from a terminal with a line editor, else line by line from standard input.

use crate::cli::failure::Failure;
use crate::cli::repl::command;
use crate::cli::repl::workbench::Workbench;
use crate::cli::{query, terminal};
use crate::datalog::DIRECTIVES;
use rustyline::completion::{Completer, FilenameCompleter, Pair};
use rustyline::config::{BellStyle, Config};
use rustyline::error::ReadlineError;
use rustyline::highlight::Highlighter;
use rustyline::hint::Hinter;
use rustyline::history::FileHistory;
use rustyline::validate::Validator;
use rustyline::{CompletionType, Context, Editor, Helper};
use std::borrow::Cow;
use std::io::{self, BufRead, IsTerminal, Write};
use std::path::PathBuf;

/// The prompt of a new input, and of a line that continues an incomplete one.
const PROMPT: &str = "> ";
const CONTINUATION: &str = "| ";

/// The maximum number of inputs in the history.
const HISTORY_MAX: usize = 1000;

/// The next input.
pub enum Line {
    Text(String),
    /// Bytes that are not UTF-8.
    NotText,
    End,
}

/// A source of inputs.
pub struct Lines {
    source: Source,
    /// The line that interrupted the last input: a command or the begin of a question.
    command: Option<String>,
}

enum Source {
    Editor(Box<Terminal>),
    Plain,
}

pub struct Terminal {
    editor: Editor<Words, FileHistory>,
    /// The file of the history; `None` if there is no place for it.
    history: Option<PathBuf>,
}

impl Lines {
    /// Opens standard input: with an editor if it is a terminal.
    pub fn open() -> Lines {
        Lines {
            source: Source::open(),
            command: None,
        }
    }

    /// Returns whether the input is interactive.
    pub fn is_interactive(&self) -> bool {
        matches!(self.source, Source::Editor(_))
    }

    /// Returns whether the next line interrupted the last input.
    pub fn has_interrupted(&self) -> bool {
        self.command.is_some()
    }

    /// Returns the next input that is not blank. A command after an incomplete text is a separate input.
    pub fn next(&mut self, bench: &Workbench<'_>) -> Result<Line, Failure> {
        if let Some(command) = self.command.take() {
            return Ok(Line::Text(command));
        }
        loop {
            let line = match &mut self.source {
                Source::Editor(terminal) => terminal.next(bench, &mut self.command)?,
                Source::Plain => plain(&mut self.command)?,
            };
            match line {
                Line::Text(text) if text.trim().is_empty() => {}
                line => return Ok(line),
            }
        }
    }
}

impl Source {
    fn open() -> Source {
        if !io::stdin().is_terminal() {
            return Source::Plain;
        }
        let config = Config::builder()
            .completion_type(CompletionType::List)
            .bell_style(BellStyle::None)
            .max_history_size(HISTORY_MAX)
            .map(|builder| builder.build());
        let editor = config.and_then(Editor::with_config);
        match editor {
            Ok(mut editor) => {
                editor.set_helper(Some(Words::default()));
                let history = history_file();
                if let Some(path) = &history {
                    // The file does not exist before the first use.
                    let _ = editor.load_history(path);
                }
                Source::Editor(Box::new(Terminal { editor, history }))
            }
            Err(error) => {
                let _ = writeln!(terminal::err(), "cannot use the line editor: {error}");
                Source::Plain
            }
        }
    }
}

/// Returns the next input of standard input. `command` gets a command that interrupts it.
fn plain(command: &mut Option<String>) -> Result<Line, Failure> {
    /// The size up to which every line may end an input. Checking a text takes time in proportion to its size.
    const SHORT: usize = 4096;
    let mut input = io::stdin().lock();
    let mut bytes = Vec::new();
    let mut checked = 0;
    loop {
        let before = bytes.len();
        let read = input.read_until(b'\n', &mut bytes);
        let read = read.map_err(|error| Failure::Usage(format!("cannot read standard input: {error}")))?;
        let Ok(text) = std::str::from_utf8(&bytes) else {
            return Ok(Line::NotText);
        };
        if read == 0 && text.trim().is_empty() {
            return Ok(Line::End);
        }
        let (whole, line) = text.split_at(before);
        if !whole.trim().is_empty() && command::interrupts(whole, line) {
            *command = Some(line.to_owned());
            return Ok(Line::Text(whole.to_owned()));
        }
        // At the end of the input, an incomplete text is final.
        let may_end = text.len() < SHORT || text.trim_end().ends_with('.') && text.len() > checked + checked / 8;
        if may_end {
            checked = text.len();
        }
        if read == 0 || may_end && super::is_whole(text) {
            return Ok(Line::Text(text.to_owned()));
        }
    }
}

impl Terminal {
    /// Returns the next input. `command` gets a command that interrupts it.
    fn next(&mut self, bench: &Workbench<'_>, command: &mut Option<String>) -> Result<Line, Failure> {
        if let Some(words) = self.editor.helper_mut() {
            let shown = query::predicates(bench.session.program()).filter(|(_, predicate)| !predicate.hidden);
            words.predicates = shown.map(|(_, predicate)| predicate.name.clone()).collect();
        }
        let mut text = String::new();
        loop {
            let prompt = if text.is_empty() { PROMPT } else { CONTINUATION };
            match self.editor.readline(prompt) {
                Ok(line) if !text.trim().is_empty() && command::interrupts(&text, &line) => {
                    self.save(&text);
                    self.save(&line);
                    *command = Some(line);
                    return Ok(Line::Text(text));
                }
                Ok(line) => {
                    text.push_str(&line);
                    if super::is_whole(&text) {
                        self.save(&text);
                        return Ok(Line::Text(text));
                    }
                    text.push('\n');
                }
                Err(ReadlineError::Interrupted) => text.clear(),
                Err(ReadlineError::Eof) if text.is_empty() => return Ok(Line::End),
                // As through a pipe, the end of the input ends an incomplete text.
                Err(ReadlineError::Eof) => return Ok(Line::Text(text)),
                Err(error) => return Err(Failure::Usage(format!("cannot read from the terminal: {error}"))),
            }
        }
    }

    /// Saves the input to the history at once, so that interrupting its evaluation loses nothing. Reports a failure
    /// once.
    fn save(&mut self, text: &str) {
        // The entry is only missing from the history of this session.
        let _ = self.editor.add_history_entry(text.trim_end());
        let Some(path) = &self.history else { return };
        let folder = path.parent().map_or(Ok(()), std::fs::create_dir_all);
        let saved = folder
            .map_err(ReadlineError::Io)
            .and_then(|()| self.editor.append_history(path));
        if let Err(error) = saved {
            let _ = writeln!(
                terminal::err(),
                "cannot save the history to `{}`: {error}",
                path.display()
            );
            self.history = None;
        }
    }
}

/// Returns `$XDG_STATE_HOME/logicity/history`, by default in `~/.local/state`.
fn history_file() -> Option<PathBuf> {
    let state = std::env::var_os("XDG_STATE_HOME")
        .map(PathBuf::from)
        .filter(|path| path.is_absolute());
    let state = state.or_else(|| Some(std::env::home_dir()?.join(".local/state")))?;
    Some(state.join("logicity/history"))
}

/// The words for completion.
#[derive(Default)]
struct Words {
    predicates: Vec<String>,
    files: FilenameCompleter,
}

impl Words {
    /// Returns the candidates for the last word, and where it begins.
    fn candidates(&self, before: &str) -> (usize, Vec<String>) {
        let is_part = |c: char| c.is_ascii_alphanumeric() || "_?-".contains(c);
        let start = before.rfind(|c| !is_part(c)).map_or(0, |at| at + 1);
        let (lead, word) = before.split_at(start);
        let mut candidates: Vec<&str> = Vec::new();
        if lead.trim_start() == "." {
            candidates.extend(command::DOTTED.iter().chain(DIRECTIVES));
        } else {
            candidates.extend(self.predicates.iter().map(String::as_str));
            if lead.trim().is_empty() {
                candidates.extend(command::WORDS);
            }
        }
        let mut found: Vec<String> = (candidates.into_iter().filter(|candidate| candidate.starts_with(word)))
            .map(str::to_owned)
            .collect();
        found.sort();
        (start, found)
    }
}

impl Completer for Words {
    type Candidate = Pair;

    fn complete(&self, line: &str, position: usize, context: &Context<'_>) -> rustyline::Result<(usize, Vec<Pair>)> {
        let before = &line[..position];
        let names_files = matches!(command::word(before), Some(("load" | "facts", rest)) if !rest.is_empty());
        if names_files || before.trim_start().starts_with(".include") {
            return self.files.complete(line, position, context);
        }
        let (start, found) = self.candidates(before);
        let pair = |word: String| Pair {
            display: word.clone(),
            replacement: word,
        };
        Ok((start, found.into_iter().map(pair).collect()))
    }
}

impl Validator for Words {}

impl Highlighter for Words {
    fn highlight_prompt<'b, 's: 'b, 'p: 'b>(&'s self, prompt: &'p str, _: bool) -> Cow<'b, str> {
        Cow::Owned(format!("\u{1b}[1;34m{prompt}\u{1b}[0m"))
    }
}

impl Hinter for Words {
    type Hint = String;
}

impl Helper for Words {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn completion_knows_commands_directives_and_predicates() {
        let words = Words {
            predicates: vec!["Path".to_owned(), "Edge".to_owned(), "explained".to_owned()],
            ..Words::default()
        };
        let found = |text: &str| words.candidates(text);
        let expected = ["reflexive", "reload"].map(str::to_owned);
        assert_eq!(found(".re"), (1, expected.to_vec()));
        assert_eq!(found(".de"), (1, vec!["decl".to_owned()]));
        assert_eq!(found("expl"), (0, vec!["explain".to_owned(), "explained".to_owned()]));
        assert_eq!(found("?- Edge(x, y), !Pa"), (16, vec!["Path".to_owned()]));
        assert_eq!(found("explain P"), (8, vec!["Path".to_owned()]));
    }
}
