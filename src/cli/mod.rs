//! The command line: one file a subcommand.
//!
//! Results go to standard output, everything else (progress, diagnostics) to standard error. Exit code 0: done; 1: faulty
//! input; 2: wrong usage, or a file that cannot be read or written.
//!
//! The Python package runs the same command line ([`run_with_python`]) and adds commands of its own ([`PYTHON_COMMANDS`]).

mod bench;
mod check;
mod diff;
mod episodes;
mod explain;
mod fmt;
mod icons;
mod infer;
#[cfg(feature = "lsp")]
mod lsp;
mod query;
mod questions;
#[cfg(feature = "repl")]
mod repl;
mod route;
mod run;
mod trace;
mod vap;
mod view;
mod why;

use crate::builtin::{BuiltinFiles, read_or_builtin};
use crate::city::MapConfig;
use crate::config::{Scenario, load_map, load_scenario};
use crate::datalog::{Edb, Rules, Workspace};
use crate::datalog::{EvalError, Limits, Program};
use crate::diag::Located;
use crate::diag::{Code, Diagnostic, SourceId, Sources, Span, render};
use crate::files::{FileError, ReadError};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::iter;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::ExitCode;

/// A city of cars and pedestrians governed by Datalog rules.
#[derive(Parser)]
#[command(name = "logicity", version, propagate_version = true, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run a city and write a trace, an animation and a last picture
    Run(run::Arguments),
    /// Check rule files: report every fault, print the strata
    Check(check::Arguments),
    /// Lay rule files out in one style; comments stay
    Fmt(fmt::Arguments),
    /// Compare two rule sets: are they equal, and if not, in which smallest scene do they differ?
    Diff(diff::Arguments),
    /// Run any Datalog program on facts files, as Soufflé does
    Query(query::Arguments),
    /// Work on a Datalog program at a prompt: add and retract facts and rules, ask questions, see why
    #[cfg(feature = "repl")]
    Repl(repl::Arguments),
    /// Decide scenes: one JSON scene a line in, one JSON answer a line out
    Infer(infer::Arguments),
    /// Tell why an agent did what it did in a run, or why it did not do something else
    Explain(explain::Arguments),
    /// Make a page of a run that a browser opens: the city moves, and every decision says why
    View(view::Arguments),
    /// Make, check or show recorded episodes of Safe Path Following
    Episodes(episodes::Arguments),
    /// Make multiple-choice questions in words about what cars do, with solved examples
    Questions(questions::Arguments),
    /// Make or check data sets of Visual Action Prediction: pictures, boxes, facts and labels
    Vap(vap::Arguments),
    /// Plan one route and print its cells
    Route(route::Arguments),
    /// Show the icons that pictures are made of
    Icons(icons::Arguments),
    /// Time the rules, a tick, an episode, or cities of up to a million agents
    Bench(bench::Arguments),
    /// Serve an editor over standard input and output: diagnostics, hover, definitions, renaming and more
    #[cfg(feature = "lsp")]
    Lsp(lsp::Arguments),
    /// Print a completion script for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Why a command did not do what was asked.
enum Failure {
    /// The input is at fault; the diagnostics tell how. Exit code 1.
    Input(Vec<Diagnostic>),
    /// The input is at fault and that has been told. Exit code 1.
    Told,
    /// Wrong usage, or a file that cannot be read or written. Exit code 2.
    Usage(String),
    /// The user ended the command early; what was done has been written. Exit code 130, as shells have it.
    Interrupted,
    /// Whoever reads standard output has gone; there is nobody to tell.
    Closed,
}

impl From<Diagnostic> for Failure {
    fn from(fault: Diagnostic) -> Self {
        Failure::Input(vec![fault])
    }
}

impl From<Vec<Diagnostic>> for Failure {
    fn from(faults: Vec<Diagnostic>) -> Self {
        Failure::Input(faults)
    }
}

/// Only standard output is written without naming a file; see [`Failure::file`] for files.
impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::Closed,
            _ => Failure::Usage(format!("cannot write to standard output: {error}")),
        }
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Failure::Usage(error.to_string())
    }
}

impl Failure {
    /// A file that cannot be written or read.
    fn file(doing: &str, path: &Path, error: impl std::fmt::Display) -> Failure {
        Failure::Usage(format!("cannot {doing} `{}`: {error}", path.display()))
    }
}

/// The commands that the Python package implements, as words of the command line, with their summaries.
pub const PYTHON_COMMANDS: [(&[&str], &str); 8] = [
    (
        &["evaluate"],
        "Measure a policy on recorded episodes, as the paper does",
    ),
    (
        &["train"],
        "Train a DQN, PPO or A2C model, or resume an interrupted run",
    ),
    (
        &["ask"],
        "Send the questions of `logicity questions` to a chat endpoint, or resume",
    ),
    (&["grade"], "Compare answers to questions with what the rules derive"),
    (
        &["describe"],
        "Print tables of environments, rewards and observations as Markdown",
    ),
    (
        &["vap", "webdataset"],
        "Convert a data set to tar files for the package webdataset",
    ),
    (&["vap", "coco"], "Write the boxes of a data set as COCO JSON"),
    (
        &["vap", "baselines"],
        "Measure the majority action, a small network on the facts, and the rules",
    ),
];

/// The result of [`run_with_python`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The command has run, with this exit code.
    Exit(u8),
    /// The caller runs this entry of [`PYTHON_COMMANDS`] with the remaining arguments.
    Python(&'static [&'static str], Vec<OsString>),
}

/// Runs the command of this process.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if let Some((words, _)) = python_command(&arguments) {
        let mut err = anstream::stderr();
        let _ = writeln!(
            err,
            "error: `logicity {}` comes with the Python package",
            words.join(" ")
        );
        let _ = writeln!(
            err,
            "help: `pip install ./python` installs the package, and `logicity` with all commands"
        );
        return ExitCode::from(2);
    }
    ExitCode::from(run(Arguments::command(), &arguments))
}

/// Runs the command line of the Python package. `arguments` exclude the name of the program.
pub fn run_with_python(arguments: &[OsString]) -> Outcome {
    if let Some((words, rest)) = python_command(arguments) {
        return Outcome::Python(words, rest);
    }
    // `logicity help train` is `logicity train --help`, and `logicity vap help coco` likewise.
    if let Some(at) = arguments.iter().position(|argument| argument == "help") {
        let without: Vec<OsString> = [&arguments[..at], &arguments[at + 1..]].concat();
        if let Some((words, _)) = python_command(&without).filter(|(words, _)| at < words.len()) {
            return Outcome::Python(words, vec!["--help".into()]);
        }
    }
    let mut command = Arguments::command();
    for (words, summary) in PYTHON_COMMANDS {
        command = add_subcommand(command, words, summary);
    }
    let code = run(command, arguments);
    // At exit, a process that is not a Rust program flushes no Rust buffer.
    let _ = io::stdout().flush();
    Outcome::Exit(code)
}

/// The Python command that the arguments begin with, and its own arguments.
fn python_command(arguments: &[OsString]) -> Option<(&'static [&'static str], Vec<OsString>)> {
    let begins = |words: &[&str]| arguments.len() >= words.len() && words.iter().zip(arguments).all(|(a, b)| b == a);
    let (words, _) = PYTHON_COMMANDS.into_iter().find(|(words, _)| begins(words))?;
    Some((words, arguments[words.len()..].to_vec()))
}

/// Adds a command of the Python package, for the help and the completion scripts. Its arguments are paths there.
fn add_subcommand(command: clap::Command, words: &'static [&'static str], summary: &'static str) -> clap::Command {
    match words {
        [] => command,
        [name] => command.subcommand(
            clap::Command::new(*name).about(summary).arg(
                clap::Arg::new("arguments")
                    .num_args(0..)
                    .trailing_var_arg(true)
                    .allow_hyphen_values(true)
                    .value_hint(clap::ValueHint::AnyPath),
            ),
        ),
        [name, rest @ ..] => command.mut_subcommand(*name, |inner| add_subcommand(inner, rest, summary)),
    }
}

/// Parses the arguments, runs the command and returns the exit code.
fn run(mut command: clap::Command, arguments: &[OsString]) -> u8 {
    let name = OsString::from("logicity");
    let parsed = command
        .try_get_matches_from_mut(iter::once(&name).chain(arguments))
        .and_then(|mut matches| Arguments::from_arg_matches_mut(&mut matches));
    let arguments = match parsed {
        Ok(arguments) => arguments,
        Err(error) => {
            let error = error.format(&mut command);
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    let mut sources = Sources::new();
    let result = match arguments.command {
        Command::Run(arguments) => run::run(&arguments, &mut sources),
        Command::Check(arguments) => check::run(&arguments, &mut sources),
        Command::Fmt(arguments) => fmt::run(&arguments, &mut sources),
        Command::Diff(arguments) => {
            return match diff::run(&arguments, &mut sources) {
                Ok(code) => code,
                Err(failure) => exit(failure, &sources),
            };
        }
        Command::Query(arguments) => query::run(&arguments, &mut sources),
        #[cfg(feature = "repl")]
        Command::Repl(arguments) => repl::run(&arguments, &mut sources),
        Command::Infer(arguments) => infer::run(&arguments, &mut sources),
        Command::Explain(arguments) => explain::run(&arguments, &mut sources),
        Command::View(arguments) => view::run(&arguments, &mut sources),
        Command::Episodes(arguments) => episodes::run(&arguments, &mut sources),
        Command::Questions(arguments) => questions::run(&arguments, &mut sources),
        Command::Vap(arguments) => vap::run(&arguments, &mut sources),
        #[cfg(feature = "lsp")]
        Command::Lsp(arguments) => lsp::run(&arguments),
        Command::Icons(arguments) => icons::run(&arguments),
        Command::Route(arguments) => route::run(&arguments, &mut sources),
        Command::Bench(arguments) => bench::run(&arguments, &mut sources),
        Command::Completions { shell } => {
            // `generate` panics if it cannot write, for example to a closed pipe.
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut command, "logicity", &mut script);
            io::stdout().write_all(&script).map_err(Failure::from)
        }
    };
    match result {
        Ok(()) => 0,
        Err(failure) => exit(failure, &sources),
    }
}

/// Prints a failure and returns its exit code.
fn exit(failure: Failure, sources: &Sources) -> u8 {
    match failure {
        Failure::Closed => 0,
        Failure::Input(diagnostics) => {
            report(&diagnostics, sources);
            1
        }
        Failure::Told => 1,
        Failure::Interrupted => 130,
        Failure::Usage(message) => {
            let _ = writeln!(io::stderr(), "error: {message}");
            2
        }
    }
}

/// Draws diagnostics on standard error, and how many there are if more than one.
fn report(diagnostics: &[Diagnostic], sources: &Sources) {
    if diagnostics.is_empty() {
        return;
    }
    let mut err = anstream::stderr();
    let colour = io::stderr().is_terminal();
    let _ = writeln!(err, "{}", render(diagnostics, sources, colour));
    let errors = diagnostics.iter().filter(|diagnostic| diagnostic.is_error()).count();
    if diagnostics.len() > 1 {
        let _ = writeln!(err, "{}", count(errors, diagnostics.len() - errors));
    }
}

/// `2 errors, 1 warning`.
fn count(errors: usize, warnings: usize) -> String {
    let plural = |n: usize, word: &str| format!("{n} {word}{}", if n == 1 { "" } else { "s" });
    match (errors, warnings) {
        (errors, 0) => plural(errors, "error"),
        (0, warnings) => plural(warnings, "warning"),
        (errors, warnings) => format!("{}, {}", plural(errors, "error"), plural(warnings, "warning")),
    }
}

/// Parses one of a few values by its name.
fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(all.iter().map(|&value| name(value))).map(move |text| {
        let found = all.iter().find(|value| name(**value) == text);
        *found.expect("no other text is possible")
    })
}

/// Reads a file that the user named on the command line.
fn read(path: &Path) -> Result<String, Failure> {
    read_or_builtin(path).map_err(|error| match error {
        ReadError::NotText { .. } => Diagnostic::new(Code::NOT_TEXT, format!("`{}` is {error}", path.display()))
            .help("save the file as UTF-8")
            .into(),
        error => Failure::file("read", path, error),
    })
}

/// What an evaluation may take.
#[derive(clap::Args)]
struct LimitOptions {
    /// Stop with an error if the rules derive more rows, as 20000, 20K, 50M or 1G (thousands, millions, thousand millions): a hundred
    /// millions unless given, at the prompt of `repl` a million
    #[arg(long, value_name = "COUNT", value_parser = count_of::<usize>, allow_negative_numbers = true)]
    max_rows: Option<usize>,
    /// Stop with an error if more rows have to be looked at, given like --max-rows: a hundred thousand millions unless given
    #[arg(long, value_name = "COUNT", value_parser = count_of::<u64>, allow_negative_numbers = true)]
    max_steps: Option<u64>,
    /// Stop with an error if rows, indexes and texts take more memory: in MiB, or with a unit: K, M, G, T or KiB, MiB, GiB, TiB (all
    /// powers of 1024); 4096 unless given; the process may need about three times as much
    #[arg(long, value_name = "SIZE", value_parser = memory, allow_negative_numbers = true)]
    max_memory: Option<u64>,
}

impl LimitOptions {
    /// With these limits for what is not given.
    fn limits(&self, usual: Limits) -> Limits {
        Limits {
            rows: self.max_rows.unwrap_or(usual.rows),
            steps: self.max_steps.unwrap_or(usual.steps),
            bytes: self.max_memory.unwrap_or(usual.bytes),
        }
    }
}

/// A number, or one of thousands, millions and so on.
fn count_of<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    let wrong = || "expected a whole number from 0 on, or one with a unit: 20K, 50M, 1G, 1T".to_owned();
    let (number, unit) = with_unit(text).ok_or_else(wrong)?;
    let scale: u64 = match unit.as_str() {
        "" => 1,
        "k" => 1_000,
        "m" => 1_000_000,
        "g" => 1_000_000_000,
        "t" => 1_000_000_000_000,
        _ => return Err(wrong()),
    };
    N::try_from(number.saturating_mul(scale)).map_err(|_| wrong())
}

/// A whole number and what follows it, in small letters.
fn with_unit(text: &str) -> Option<(u64, String)> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    Some((number.parse().ok()?, unit.trim_start().to_ascii_lowercase()))
}

/// Bytes: a number of mebibytes, or one with a unit.
fn memory(text: &str) -> Result<u64, String> {
    let (number, unit) = with_unit(text).ok_or(MEMORY)?;
    let scale = match unit.as_str() {
        "k" | "kib" => 10,
        "" | "m" | "mib" => 20,
        "g" | "gib" => 30,
        "t" | "tib" => 40,
        _ => return Err(MEMORY.to_owned()),
    };
    Ok(number.saturating_mul(1 << scale))
}

const MEMORY: &str = "expected a whole number of MiB, or one with a unit: 512K, 50M, 2G, 1T, 50MiB";

/// The fault of a commit, with what can be done about it.
pub(super) fn too_much(error: &EvalError, rules: &Rules) -> Diagnostic {
    let fault = error.diagnostic(rules);
    let option = match error {
        EvalError::TooManyRows { .. } => "--max-rows",
        EvalError::TooManySteps { .. } => "--max-steps",
        EvalError::TooMuchMemory { .. } => "--max-memory",
        EvalError::Interrupted { .. } => return fault,
    };
    fault.note(format!("`{option}` allows more"))
}

/// Reads, checks and plans a rule file. Warnings are returned beside the program.
fn load_program(sources: &mut Sources, path: &Path) -> Result<(Program, Vec<Diagnostic>), Failure> {
    compile(&load_texts(sources, path, Edb::Fixed)?)
}

/// Checks and plans rules. Warnings are returned beside the program.
fn compile(texts: &Workspace) -> Result<(Program, Vec<Diagnostic>), Failure> {
    let loaded = texts.check();
    match loaded.rules {
        Some(rules) => Ok((Program::new(rules)?, loaded.diagnostics)),
        None => Err(loaded.diagnostics.into()),
    }
}

/// Reads a rule file and all it includes.
fn load_texts(sources: &mut Sources, path: &Path, inputs: Edb) -> Result<Workspace, Failure> {
    let text = read(path)?;
    let entry = sources.add(path.display().to_string(), text);
    let mut texts = Workspace::new(inputs);
    texts.add(sources, entry, &BuiltinFiles);
    Ok(texts)
}

/// A configuration and its rules, or those of the file that is given instead. Warnings have been told; the texts of the rules are
/// the last of `sources`, from the one returned on.
fn load_city(
    sources: &mut Sources,
    config: &Path,
    rules: Option<&Path>,
) -> Result<(Scenario, Program, SourceId), Failure> {
    let mut scenario = load_config(sources, config)?;
    let path = rules.unwrap_or(&scenario.rules.value).to_owned();
    let texts = sources.ids().count();
    let (program, warnings) = load_program(sources, &path)?;
    report(&warnings, sources);
    let entry = sources.ids().nth(texts).expect("the rules have been read");
    if rules.is_some() {
        // What does not fit is to be shown in the file that was given, not in the configuration.
        let span = Span::new(entry, 0..0);
        scenario.rules = Located { value: path, span };
    }
    Ok((scenario, program, entry))
}

/// More threads are not started, on however many cores: each takes memory, and some thousands more than a system gives.
const THREADS_MAX: usize = 1024;

/// Parses a number of threads; 0 is one for each core.
fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|&count: &usize| count <= THREADS_MAX);
    let count =
        count.ok_or_else(|| format!("expected a whole number from 0 to {THREADS_MAX}; 0 is one for each core"))?;
    let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    Ok(NonZeroUsize::new(count).unwrap_or_else(cores))
}

/// Reads a run configuration and all its parts.
fn load_config(sources: &mut Sources, path: &Path) -> Result<Scenario, Failure> {
    load_scenario(sources, path, &BuiltinFiles).map_err(missing_is_usage)
}

/// Reads a map: a path to a YAML file, or the name of a built-in map.
fn find_map(sources: &mut Sources, name: &str) -> Result<MapConfig, Failure> {
    load_map(sources, Path::new(name), &BuiltinFiles).map_err(missing_is_usage)
}

/// A file that the user named on the command line and that cannot be read has no place in any text: that is wrong usage.
fn missing_is_usage(faults: Vec<Diagnostic>) -> Failure {
    match faults.as_slice() {
        [fault] if fault.code == Code::MISSING_FILE && fault.primary.is_none() => {
            let help = fault.help.iter().map(|help| format!("\nhelp: {help}"));
            Failure::Usage(fault.message.clone() + &help.collect::<String>())
        }
        _ => faults.into(),
    }
}

/// A bar on a terminal.
fn progress(what: &str, count: u64) -> ProgressBar {
    let template = format!("{{bar:30}} {what} {{pos}} of {{len}}, {{eta}} left");
    ProgressBar::new(count).with_style(ProgressStyle::with_template(&template).expect("a valid template"))
}
