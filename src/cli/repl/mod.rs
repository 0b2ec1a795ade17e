//! `logicity repl`: runs an interactive prompt.
//!
//! Input passes through three stages. Lines accumulate until they are complete. The input gets a name such as `<input
//! 3>` for diagnostics. It is then a question, a command, or text of the language.

mod command;
mod prompt;
mod table;
mod workbench;

use crate::cli::fact;
use crate::cli::fact::Question;
use crate::cli::failure::Failure;
use crate::cli::limits::LimitOptions;
use crate::cli::report::{exit, report};
use crate::cli::souffle::SouffleOptions;
use crate::cli::{query, terminal};
use crate::datalog;
use crate::datalog::codes;
use crate::datalog::{BaseType, ClauseId, PredicateId, Value, is_complete};
use crate::datalog::{Limits, Session, facts};
use crate::diag::{self, Diagnostic, SourceId, Sources};
use command::Command;
use prompt::{Line, Lines};
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;
use table::Column;
use workbench::{Outcome, Workbench};

/// The maximum number of rows of a predicate that a terminal shows.
const SHOWN_MAX: usize = 200;

/// The default limit of derived rows. More are probably a mistake, which a low limit reveals early.
const ROWS_MAX: usize = 1_000_000;

#[derive(clap::Args)]
#[command(
    after_help = "Type .help at the prompt. If standard input is not a terminal, the command reads it without a prompt \
and exits with code 1 if an input is faulty."
)]
pub struct Arguments {
    /// Rule files to load
    rules: Vec<PathBuf>,
    /// Folder with a file NAME.facts for each input predicate
    #[arg(short = 'F', long, value_name = "DIR")]
    facts: Option<PathBuf>,
    #[command(flatten)]
    souffle: SouffleOptions,
    #[command(flatten)]
    limits: LimitOptions,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut bench = Workbench::new(
        sources,
        arguments.limits.limits(Limits {
            rows: ROWS_MAX,
            ..Limits::default()
        }),
        arguments.souffle.clone(),
    )?;
    let mut lines = Lines::open();
    let mut repl = Repl {
        out: terminal::out(),
        profile: String::new(),
        rows_max: if io::stdout().is_terminal() {
            SHOWN_MAX
        } else {
            usize::MAX
        },
    };
    if lines.is_interactive() {
        let version = env!("CARGO_PKG_VERSION");
        writeln!(repl.out, "logicity {version}; .help for help, .quit to quit")?;
    }
    let mut faulty = false;
    // The user can fix and reload a faulty file. A missing file is a usage error that ends the command.
    match repl.begin(&mut bench, arguments) {
        Err(Failure::Input(faults)) => {
            report(&faults, bench.sources);
            faulty = true;
        }
        other => other?,
    }
    for number in 1.. {
        let text = match lines.next(&bench)? {
            Line::Text(text) => text,
            Line::NotText => {
                let fault = Diagnostic::new(diag::codes::NOT_TEXT, "the input is not UTF-8 text");
                report(&[fault], bench.sources);
                faulty = true;
                continue;
            }
            Line::End => break,
        };
        let id = bench.sources.add(format!("<input {number}>"), text);
        let done = lines.is_interactive().then(StillWorking::begin);
        let outcome = repl.input(&mut bench, id);
        drop(done);
        match outcome {
            Ok(true) => {}
            Ok(false) => break,
            Err(Failure::Closed) => return Err(Failure::Closed),
            Err(failure) => {
                let failure = match lines.has_interrupted() {
                    true => command::interrupted(failure),
                    false => failure,
                };
                exit(command::pointing_at(failure, id, bench.sources), bench.sources);
                faulty = true;
            }
        }
        repl.out.flush()?;
    }
    if faulty && !lines.is_interactive() {
        return Err(Failure::Reported);
    }
    Ok(())
}

/// Shows a message on the terminal during a long evaluation, and removes it when dropped.
struct StillWorking {
    /// Carries no messages: the thread waits until this end closes.
    done: Option<mpsc::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// Delay before the message.
const PATIENCE: Duration = Duration::from_secs(1);

impl StillWorking {
    fn begin() -> StillWorking {
        let (done, wait) = mpsc::channel();
        let show = move || {
            if wait.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                terminal::print_passing("still evaluating; Ctrl-C quits the program", || {
                    let _ = wait.recv();
                });
            }
        };
        StillWorking {
            done: Some(done),
            // Without a thread there is no message, which is harmless.
            thread: std::thread::Builder::new().spawn(show).ok(),
        }
    }
}

impl Drop for StillWorking {
    fn drop(&mut self) {
        self.done = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Repl<W> {
    out: W,
    /// The profile of the last evaluation.
    profile: String,
    rows_max: usize,
}

impl<W: Write> Repl<W> {
    fn begin(&mut self, bench: &mut Workbench<'_>, arguments: &Arguments) -> Result<(), Failure> {
        if !arguments.rules.is_empty() {
            let outcome = bench.load(&arguments.rules)?;
            report(&outcome.warnings, bench.sources);
        }
        if let Some(folder) = &arguments.facts {
            self.load_facts(bench, folder)?;
        }
        self.profile = query::profile(&bench.session, &bench.times, bench.sources);
        Ok(())
    }

    /// Executes an input. Returns whether to continue.
    fn input(&mut self, bench: &mut Workbench<'_>, id: SourceId) -> Result<bool, Failure> {
        let is_question = bench.sources.text(id).trim_start().starts_with("?-");
        let outcome = match command::read(bench.sources, id)? {
            None if is_question => return self.answer(bench, id).map(|()| true),
            None => bench.add(id)?,
            Some(Command::Quit) => return Ok(false),
            Some(Command::Load(paths)) => bench.load(&paths)?,
            Some(Command::Reload) => bench.reload()?,
            Some(Command::Facts(folder)) => return self.load_facts(bench, &folder).map(|()| true),
            Some(Command::Retract(id)) => bench.retract(id)?,
            Some(Command::Tick(ticks)) => bench.tick(ticks)?,
            Some(command) => return self.show(bench, command).map(|()| true),
        };
        self.print_outcome(bench, &outcome)?;
        Ok(true)
    }

    fn load_facts(&mut self, bench: &mut Workbench<'_>, folder: &Path) -> Result<(), Failure> {
        let outcome = bench.load_facts(folder)?;
        self.print_outcome(bench, &outcome)
    }

    /// Executes a command that changes nothing.
    fn show(&mut self, bench: &Workbench<'_>, command: Command) -> Result<(), Failure> {
        match command {
            Command::Explain(id) => self.why(bench, Question::Holds, id)?,
            Command::WhyNot(id) => self.why(bench, Question::Fails, id)?,
            Command::Plan(None) => {
                let program = bench.session.program();
                write!(self.out, "{}", program.show_plans(bench.sources))?;
            }
            Command::Plan(Some(question)) => {
                let (program, _) = bench.compile_question(question)?;
                write!(self.out, "{}", program.show_plans(bench.sources))?;
            }
            Command::Profile => write!(self.out, "{}", self.profile)?,
            Command::Predicates => self.predicates(bench)?,
            Command::Show(name, span) => match bench.session.program().predicate(&name) {
                Some(id) if !bench.session.program().rules().predicates[id.index()].hidden => {
                    self.predicate(bench, id)?
                }
                _ => {
                    let fault = Diagnostic::new(codes::UNKNOWN_PREDICATE, format!("no predicate `{name}` is declared"));
                    return Err(fault.at(span, "").help("`.predicates` lists them").into());
                }
            },
            Command::Help => write!(self.out, "{}", command::HELP)?,
            Command::Quit
            | Command::Load(_)
            | Command::Reload
            | Command::Facts(_)
            | Command::Retract(_)
            | Command::Tick(_) => {}
        }
        Ok(())
    }

    fn why(&mut self, bench: &Workbench<'_>, question: Question, id: SourceId) -> Result<(), Failure> {
        let (workspace, session) = (&bench.workspace, &bench.session);
        fact::explain(&mut self.out, (question, id), workspace, session, bench.sources, false)
    }

    /// Prints the outcome of a change, for example `Edge +1, Path +3`.
    fn print_outcome(&mut self, bench: &Workbench<'_>, outcome: &Outcome) -> Result<(), Failure> {
        self.profile = query::profile(&bench.session, &bench.times, bench.sources);
        report(&outcome.warnings, bench.sources);
        for note in &outcome.notes {
            writeln!(self.out, "{note}")?;
        }
        let changes = outcome.changes.iter().map(|change| {
            let signed = [('+', change.added), ('-', change.removed)];
            let signed = signed.iter().filter(|(_, count)| *count > 0);
            let signed: Vec<String> = signed.map(|(sign, count)| format!("{sign}{count}")).collect();
            format!("{} {}", change.predicate, signed.join(" "))
        });
        let changes: Vec<String> = changes.collect();
        if !changes.is_empty() {
            writeln!(self.out, "{}", changes.join(", "))?;
        }
        Ok(())
    }

    fn answer(&mut self, bench: &Workbench<'_>, id: SourceId) -> Result<(), Failure> {
        let answer = bench.ask(id)?;
        report(&answer.warnings, bench.sources);
        self.profile = query::profile(&answer.session, &answer.times, bench.sources);
        let predicate = &answer.session.program().rules().predicates[answer.predicate.index()];
        if predicate.columns.is_empty() {
            writeln!(self.out, "{}", !answer.session.is_empty(answer.predicate))?;
            return Ok(());
        }
        self.rows(&answer.session, answer.predicate)
    }

    /// Prints the rows of a predicate as a table, and their number.
    fn rows(&mut self, session: &Session, id: PredicateId) -> Result<(), Failure> {
        let predicate = &session.program().rules().predicates[id.index()];
        let columns: Vec<Column> = (predicate.columns.iter())
            .map(|column| Column {
                title: column.name.clone(),
                numeric: column.base != BaseType::Symbol,
            })
            .collect();
        let sorted = facts::sorted(session, id);
        let cell = |(column, value): (&datalog::Column, &Value)| facts::print_value(session, *value, column.base);
        let rows: Vec<Vec<String>> = (sorted.iter().take(self.rows_max))
            .map(|row| predicate.columns.iter().zip(*row).map(cell).collect())
            .collect();
        if !rows.is_empty() && !columns.is_empty() {
            write!(self.out, "{}", table::draw(&columns, &rows))?;
        }
        let count = if sorted.len() == 1 {
            "1 row".to_owned()
        } else {
            format!("{} rows", sorted.len())
        };
        let shown = match rows.len() < sorted.len() {
            true => format!("; showing the first {}", rows.len()),
            false => String::new(),
        };
        writeln!(self.out, "{count}{shown}")?;
        Ok(())
    }

    fn predicates(&mut self, bench: &Workbench<'_>) -> Result<(), Failure> {
        let title = |title: &str, numeric| Column {
            title: title.to_owned(),
            numeric,
        };
        let columns = [title("rows", true), title("predicate", false), title("", false)];
        let session = &bench.session;
        let shown = query::predicates(session.program()).filter(|(_, predicate)| !predicate.hidden);
        let rows: Vec<Vec<String>> = shown
            .map(|(id, predicate)| {
                let mut words = Vec::new();
                words.extend(predicate.derived.then_some("derived"));
                words.extend(predicate.input.then_some("input"));
                words.extend(predicate.output.then_some("output"));
                vec![session.len(id).to_string(), signature(session, id), words.join(", ")]
            })
            .collect();
        write!(self.out, "{}", table::draw(&columns, &rows))?;
        Ok(())
    }

    /// Prints documentation, declaration, directives, clauses and rows of a predicate.
    fn predicate(&mut self, bench: &Workbench<'_>, id: PredicateId) -> Result<(), Failure> {
        let (session, rules) = (&bench.session, bench.session.program().rules());
        let predicate = &rules.predicates[id.index()];
        for line in predicate.doc.lines() {
            writeln!(self.out, "/// {line}")?;
        }
        let place = bench.sources.locate(predicate.span);
        writeln!(self.out, ".decl {}    {place}", signature(session, id))?;
        for directive in &predicate.directives {
            writeln!(self.out, ".{} {}", directive.kind.name(), predicate.name)?;
        }
        for (clause, number) in rules.clauses.iter().zip(0..) {
            if clause.head.predicate == id && !clause.body.is_empty() {
                let shown = session.program().show_clause(ClauseId(number), bench.sources);
                writeln!(self.out, "{shown}")?;
            }
        }
        self.rows(session, id)
    }
}

/// Formats a signature, for example `Path(x: number, y: number)`.
fn signature(session: &Session, id: PredicateId) -> String {
    let rules = session.program().rules();
    let predicate = &rules.predicates[id.index()];
    let columns = predicate.columns.iter().map(|column| {
        let ty = &rules.types[column.ty.0 as usize].name;
        format!("{}: {ty}", column.name)
    });
    format!("{}({})", predicate.name, columns.collect::<Vec<_>>().join(", "))
}

/// Returns whether an input may end here. A command is one line.
fn is_whole(text: &str) -> bool {
    command::word(text).is_some() || command::foreign(text).is_some() || is_complete(text)
}
