//! The command line, with one file per subcommand.
//!
//! Results go to standard output; progress and diagnostics go to standard error. Exit code 0 means success, 1 faulty
//! input, 2 wrong usage or a file that cannot be read or written.
//!
//! The Python package runs the same command line ([`run_with_python`]) and adds the commands [`PYTHON_COMMANDS`].

mod bench;
mod check;
mod codes;
mod configuration;
mod diff;
mod episodes;
mod explain;
mod fmt;
mod icons;
mod induce;
mod infer;
mod kind;
#[cfg(feature = "lsp")]
mod lsp;
mod memory;
mod new;
mod query;
mod questions;
mod reference;
#[cfg(feature = "repl")]
mod repl;
mod route;
mod run;
mod scenes;
mod schema;
mod signals;
mod terminal;
mod trace;
mod vap;
mod view;
mod why;

use crate::builtin::BuiltinFiles;
use crate::city::{Action, MapConfig};
use crate::config::{self, load_map, missing_file, rule_file};
use crate::datalog::{InputPolicy, Limits, Program, Workspace};
use crate::diag::{self, Diagnostic, Limit, Sources, neutral, render, similar_file};
use crate::files::{self, FileError, FileId, Output, Overwrite, ReadError, ReadFile};
use crate::sim::{LoadError, LoadedCity};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use kind::Kind;
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fmt::Display;
use std::fs::File;
use std::io::{self, Write};
use std::iter;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

/// Simulate a city of cars and pedestrians under Datalog rules
#[derive(Parser)]
#[command(name = "logicity", version, propagate_version = true, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run a city and write a trace, an animation and a picture of the last tick
    Run(run::Arguments),
    /// Create a folder with a rule file, a configuration and scenes to start from
    New(new::Arguments),
    /// Check rule files and configurations, and print diagnostics, strata and conflicts
    Check(check::Arguments),
    /// Format rule files
    Fmt(fmt::Arguments),
    /// Compare two rule sets: prove them equivalent or print a minimal counterexample
    Diff(diff::Arguments),
    /// Run a Datalog program on facts files, compatible with Soufflé
    Query(query::Arguments),
    /// Develop a Datalog program interactively: add and retract facts and rules, query, explain
    #[cfg(feature = "repl")]
    Repl(repl::Arguments),
    /// Evaluate the rules on scenes: one JSON scene per line in, one JSON answer per line out
    Infer(infer::Arguments),
    /// Learn rules from episodes, traces, labeled scenes, data sets, questions to an oracle or tasks of Popper
    Induce(Box<induce::Arguments>),
    /// Explain why an agent acted as it did in a run, or why it did not act otherwise
    Explain(explain::Arguments),
    /// Write an interactive HTML page of a run that explains every decision
    View(view::Arguments),
    /// Generate, check or print recorded episodes of Safe Path Following
    Episodes(episodes::Arguments),
    /// Generate multiple-choice questions about the decisions of cars, with solved examples
    Questions(questions::Arguments),
    /// Generate or check data sets of Visual Action Prediction: pictures, boxes, facts and labels
    Vap(vap::Arguments),
    /// Plan one route and print its cells
    Route(route::Arguments),
    /// Draw sheets of the icons in pictures
    Icons(icons::Arguments),
    /// Measure the speed of rules, ticks, episodes, pictures, and cities of up to a million agents
    Bench(bench::Arguments),
    /// Run a language server over standard input and output
    #[cfg(feature = "lsp")]
    Lsp(lsp::Arguments),
    /// Explain the codes of messages, with examples
    Codes(codes::Arguments),
    /// Print the JSON Schema of configuration files, for editors
    Schema(schema::Arguments),
    /// Print all commands with their options as JSON; the documentation is made from it
    #[command(hide = true)]
    Reference,
    /// Print a shell completion script
    Completions {
        /// Shell to complete for
        shell: clap_complete::Shell,
    },
}

/// The reason why a command failed.
enum Failure {
    /// The input is faulty, as the diagnostics describe. Exit code 1.
    Input(Vec<Diagnostic>),
    /// The input is faulty, and the command has printed the diagnostics. Exit code 1.
    Reported,
    /// The value of an option does not fit the input, as the diagnostics describe. Exit code 2.
    Option(Vec<Diagnostic>),
    /// Wrong usage, or a file that cannot be read or written. Exit code 2.
    Usage(String),
    /// The user or the system asked the command to end; its results so far are on disk. See [`signals`] for the exit
    /// codes.
    Interrupted,
    /// The reader closed standard output. Exit code 0, without a message.
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

impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        match error {
            LoadError::Config(faults) => missing_is_usage(faults),
            LoadError::RuleFile(path, error) => unreadable(&path, &error),
            LoadError::Rules(faults) => faults.into(),
        }
    }
}

/// Converts errors of standard output; [`Failure::file`] converts those of files.
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
    /// Returns the failure to read or write a file; `doing` is the verb.
    fn file(doing: &str, path: &Path, error: impl std::fmt::Display) -> Failure {
        Failure::Usage(format!("cannot {doing} `{}`: {error}", path.display()))
    }

    /// Returns the failure of an option whose value does not fit the input.
    fn option(faults: impl Into<Vec<Diagnostic>>) -> Failure {
        Failure::Option(faults.into())
    }
}

/// The option to replace files of other programs.
#[derive(clap::Args)]
struct ForceOption {
    /// Replace output files that this command did not write, or that have changed since. Files that the command reads
    /// are never replaced
    #[arg(long)]
    force: bool,
}

impl ForceOption {
    fn overwrite(&self) -> Overwrite {
        if self.force { Overwrite::Any } else { Overwrite::Own }
    }

    /// Begins to write an output file of the command `by`; `-` means standard output. Fails if the command reads that
    /// file.
    fn create(&self, by: &str, path: &Path, inputs: &Inputs) -> Result<Output, Failure> {
        if path == Path::new("-") {
            return Ok(terminal::screened(Output::stdout()));
        }
        let outputs = self.create_all(by, &[path], inputs)?;
        Ok(outputs.into_iter().next().expect("one for each path"))
    }

    /// Begins to write several output files, none of which is standard output.
    fn create_all(&self, by: &str, paths: &[&Path], inputs: &Inputs) -> Result<Vec<Output>, Failure> {
        paths.iter().try_for_each(|path| inputs.refuse(path))?;
        let outputs = Output::create_all(paths, by, self.overwrite());
        let outputs = outputs.map_err(|(position, error)| unwritable(paths[position], &error))?;
        Ok(outputs.into_iter().map(terminal::screened).collect())
    }
}

/// The files that a command reads. No output replaces one of them, not even with `--force`.
#[derive(Default)]
struct Inputs(BTreeSet<FileId>);

impl Inputs {
    /// Returns the files with these paths; `-` means standard input.
    fn new(paths: impl IntoIterator<Item = PathBuf>) -> Inputs {
        Inputs::default().with(paths)
    }

    /// Returns the files of texts: rules with their includes, configurations with their parts.
    fn of(sources: &Sources) -> Inputs {
        Inputs::new(sources.ids().map(|id| PathBuf::from(sources.name(id))))
    }

    /// Adds files; `-` means standard input.
    fn with(mut self, paths: impl IntoIterator<Item = PathBuf>) -> Inputs {
        let named = |path: PathBuf| match path == Path::new("-") {
            true => "/dev/stdin".into(),
            false => path,
        };
        let existing = paths.into_iter().filter_map(|path| FileId::of(&named(path)));
        self.0.extend(existing);
        self
    }

    /// Fails if an output is one of the files.
    fn refuse(&self, output: &Path) -> Result<(), Failure> {
        match FileId::of(output).is_some_and(|output| self.0.contains(&output)) {
            true => Err(Failure::Usage(format!(
                "cannot write `{}`: this command reads it\n\
                 help: choose another path; `--force` does not replace inputs",
                output.display()
            ))),
            false => Ok(()),
        }
    }
}

/// Returns whether an output is standard output: `-`, `/dev/stdout` or a link to it.
fn is_stdout(path: &Path) -> bool {
    path == Path::new("-") || files::is_stdout(path)
}

/// Fails if several outputs, given with their options, are standard output.
fn refuse_mixing<'a>(outputs: impl IntoIterator<Item = (&'a str, &'a Path)>) -> Result<(), Failure> {
    let mixed = outputs.into_iter().filter(|(_, path)| is_stdout(path));
    match mixed.map(|(option, _)| option).collect::<Vec<_>>()[..] {
        [one, other, ..] => Err(Failure::Usage(format!(
            "{one} and {other} would both write to standard output; name a file for one of them"
        ))),
        _ => Ok(()),
    }
}

/// Fails if a folder for results is `-`, which means standard output where a command writes one file.
fn refuse_stdout_as_folder(folder: &Path) -> Result<(), Failure> {
    match folder == Path::new("-") {
        true => Err(Failure::Usage(
            "this command writes several files, so `-` cannot mean standard output\nhelp: name a folder; `./-` is the \
             folder with that name"
                .to_owned(),
        )),
        false => Ok(()),
    }
}

/// Returns where to print messages about the results: standard error if a result goes to standard output.
fn messages(results: &[&Path]) -> Box<dyn Write> {
    match results.iter().any(|path| is_stdout(path)) {
        true => Box::new(terminal::err()),
        false => Box::new(terminal::out()),
    }
}

/// Prints the paths of further results than the first, which the summary of a command names.
fn print_others(out: &mut dyn Write, others: &[Option<&Path>]) -> io::Result<()> {
    let mut others = others.iter().flatten().filter(|path| !is_stdout(path));
    others.try_for_each(|path| writeln!(out, "wrote {}", path.display()))
}

/// Gives a complete output file its name.
fn finish(output: Output, path: &Path) -> Result<(), Failure> {
    output.finish().map_err(|error| unwritable(path, &error))
}

/// Reports an output file that cannot be written.
fn unwritable(path: &Path, error: &io::Error) -> Failure {
    if is_stdout(path) {
        return io::Error::new(error.kind(), error.to_string()).into();
    }
    let help = match error.kind() {
        io::ErrorKind::AlreadyExists => "\nhelp: choose another path, or replace it with `--force`",
        _ => "",
    };
    Failure::Usage(format!("cannot write `{}`: {error}{help}", path.display()))
}

/// The commands that the Python package implements, as words of the command line, and their summaries.
pub const PYTHON_COMMANDS: [(&[&str], &str); 10] = [
    (
        &["evaluate"],
        "Measure a policy on recorded episodes with the metrics of the paper",
    ),
    (
        &["train"],
        "Train a learner on Safe Path Following, or resume an interrupted run",
    ),
    (
        &["experiment"],
        "Train and evaluate the learners of an experiment, or resume it, and print a table beside the paper's",
    ),
    (
        &["ask"],
        "Send the questions of `logicity questions` to a chat endpoint, or resume a run",
    ),
    (
        &["grade"],
        "Grade answers to questions by the actions that the rules derive",
    ),
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
        "Measure the baselines: the majority action, a small network, and the rules",
    ),
    (
        &["vap", "features"],
        "Compute and store the features of the boxes of a data set, or resume",
    ),
];

/// The result of [`run_with_python`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The command ran and returned this exit code.
    Exit(u8),
    /// The caller must run this entry of [`PYTHON_COMMANDS`] with the remaining arguments.
    Python(&'static [&'static str], Vec<OsString>),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
    if let Some((words, _)) = python_command(&arguments) {
        let mut err = terminal::err();
        let package = match words {
            ["train" | "experiment"] => "./python[learn]",
            _ => "./python",
        };
        let _ = writeln!(err, "error: `logicity {}` requires the Python package", words.join(" "));
        let _ = writeln!(
            err,
            "help: `pip install '{package}'` installs it, with a `logicity` that has all commands"
        );
        return ExitCode::from(2);
    }
    ExitCode::from(run(Arguments::command(), &arguments))
}

/// Makes the next signal end a forked process of Python, which has no thread that handles requests.
pub fn end_forked() {
    signals::end_forked();
}

/// Runs the command line of the Python package. `arguments` excludes the program name.
pub fn run_with_python(arguments: &[OsString]) -> Outcome {
    if let Some((words, rest)) = python_command(arguments) {
        return Outcome::Python(words, rest);
    }
    // Treats `logicity help train` as `logicity train --help`, and `logicity vap help coco` accordingly.
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
    // Python's exit does not flush Rust's buffers.
    let _ = io::stdout().flush();
    Outcome::Exit(code)
}

/// Returns the Python command at the start of the arguments, and the arguments after it.
fn python_command(arguments: &[OsString]) -> Option<(&'static [&'static str], Vec<OsString>)> {
    let begins = |words: &[&str]| arguments.len() >= words.len() && words.iter().zip(arguments).all(|(a, b)| b == a);
    let (words, _) = PYTHON_COMMANDS.into_iter().find(|(words, _)| begins(words))?;
    Some((words, arguments[words.len()..].to_vec()))
}

/// Adds a command of the Python package for help and completion scripts; its arguments complete as paths.
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

/// Lets every option take a negative number, so that the parser of its value says what it expects.
fn accept_negative_numbers(command: clap::Command) -> clap::Command {
    let option = |argument: clap::Arg| {
        let takes_value = argument.get_long().is_some() && argument.get_action().takes_values();
        match takes_value {
            true => argument.allow_negative_numbers(true),
            false => argument,
        }
    };
    command.mut_args(option).mut_subcommands(accept_negative_numbers)
}

/// Parses the arguments, runs the command and returns the exit code.
fn run(mut command: clap::Command, arguments: &[OsString]) -> u8 {
    command = accept_negative_numbers(command);
    let shown = |argument: &OsString| argument.to_str().is_some_and(|text| neutral(text) == text);
    let is_plain = !arguments.iter().all(shown);
    if is_plain {
        command = command.styles(clap::builder::Styles::plain());
    }
    let name = OsString::from("logicity");
    let parsed = command
        .try_get_matches_from_mut(iter::once(&name).chain(arguments))
        .and_then(|mut matches| Ok((memory_limit(&matches), Arguments::from_arg_matches_mut(&mut matches)?)));
    let (limit, arguments) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => {
            let error = error.format(&mut command);
            // A closed standard error does not change the exit code.
            return match terminal::print_usage(&error, is_plain) {
                Err(failed) if !error.use_stderr() => exit(failed.into(), &Sources::new()),
                _ => u8::try_from(error.exit_code()).unwrap_or(2),
            };
        }
    };
    memory::exit_when_exhausted();
    signals::end_at_once();
    files::limit_reads(limit.saturating_add(memory::BUFFERS));
    memory::watch(limit, move |size| {
        let fault = Diagnostic::new(
            diag::codes::LIMIT_EXCEEDED,
            format!("the command takes more than {} MiB", limit >> 20),
        )
        .note(format!(
            "the process uses {} MiB, with the program itself and its input",
            size >> 20
        ))
        .exceeds(Limit::Memory(limit));
        report(&[fault], &Sources::new());
        files::end(1);
    });
    let (mut sources, mut code) = (Sources::new(), 0);
    let result = match arguments.command {
        Command::Run(arguments) => run::run(&arguments, &mut sources),
        Command::New(arguments) => new::run(&arguments),
        Command::Check(arguments) => check::run(&arguments, &mut sources),
        Command::Fmt(arguments) => fmt::run(&arguments, &mut sources),
        Command::Diff(arguments) => diff::run(&arguments, &mut sources).map(|differs| code = differs),
        Command::Query(arguments) => query::run(&arguments, &mut sources),
        #[cfg(feature = "repl")]
        Command::Repl(arguments) => repl::run(&arguments, &mut sources),
        Command::Induce(arguments) => induce::run(&arguments, &mut sources),
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
        Command::Codes(arguments) => codes::run(&arguments),
        Command::Schema(arguments) => schema::run(&arguments),
        Command::Reference => reference::run(command),
        Command::Completions { shell } => {
            // `generate` panics if it cannot write, for example to a closed pipe.
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut command, "logicity", &mut script);
            terminal::data().write_all(&script).map_err(Failure::from)
        }
    };
    // The process of a caller in Python continues, and must not ignore the next request.
    signals::end_at_once();
    files::limit_reads(files::MAX_BYTES);
    // The end of the process would ignore that the last line cannot be written.
    match result.and_then(|()| io::stdout().flush().map_err(Failure::from)) {
        Ok(()) => code,
        Err(failure) => exit(failure, &sources),
    }
}

/// Prints a failure and returns its exit code.
fn exit(failure: Failure, sources: &Sources) -> u8 {
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
fn report(diagnostics: &[Diagnostic], sources: &Sources) {
    if diagnostics.is_empty() {
        return;
    }
    terminal::print_styled(&render(&advised(diagnostics), sources, terminal::has_color()));
    let errors = diagnostics.iter().filter(|diagnostic| diagnostic.is_error()).count();
    if diagnostics.len() > 1 {
        let _ = writeln!(terminal::err(), "{}", count(errors, diagnostics.len() - errors));
    }
}

/// Formats a count, for example `1 clause` or `2 clauses`.
fn plural(count: impl TryInto<u64>, word: &str) -> String {
    let count: u64 = count.try_into().unwrap_or(u64::MAX);
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

/// Formats counts, for example `2 errors, 1 warning`.
fn count(errors: usize, warnings: usize) -> String {
    match (errors, warnings) {
        (errors, 0) => plural(errors, "error"),
        (0, warnings) => plural(warnings, "warning"),
        (errors, warnings) => format!("{}, {}", plural(errors, "error"), plural(warnings, "warning")),
    }
}

/// Returns a parser for a fixed list of values, by name in upper or lower case.
fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    OneOf { all, name }
}

#[derive(Clone, Copy)]
struct OneOf<T: 'static> {
    all: &'static [T],
    name: fn(T) -> &'static str,
}

impl<T: Copy + Send + Sync + 'static> OneOf<T> {
    fn names(self) -> impl Iterator<Item = &'static str> {
        self.all.iter().map(move |&value| (self.name)(value))
    }
}

impl<T: Copy + Send + Sync + 'static> TypedValueParser for OneOf<T> {
    type Value = T;

    fn parse_ref(&self, command: &clap::Command, argument: Option<&clap::Arg>, text: &OsStr) -> Result<T, clap::Error> {
        let is_named = |value: &&T| {
            text.to_str()
                .is_some_and(|text| (self.name)(**value).eq_ignore_ascii_case(text))
        };
        match self.all.iter().find(is_named) {
            Some(&value) => Ok(value),
            None => {
                let refused = PossibleValuesParser::new(self.names()).parse_ref(command, argument, text);
                Err(refused.expect_err("it is none of the names"))
            }
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.names().map(PossibleValue::new)))
    }
}

/// Reads a file named on the command line, or a built-in one.
fn read(path: &Path) -> Result<String, Failure> {
    read_with(&BuiltinFiles, path)
}

fn read_with(files: &dyn ReadFile, path: &Path) -> Result<String, Failure> {
    files.read_or_builtin(path).map_err(|error| unreadable(path, &error))
}

/// Opens a file named on the command line, which may be a pipe.
fn open(path: &Path) -> Result<File, Failure> {
    files::open(path).map_err(|error| unreadable(path, &error))
}

/// Reports a file named on the command line that cannot be read.
fn unreadable(path: &Path, error: &ReadError) -> Failure {
    match error {
        ReadError::NotText { .. } => Diagnostic::new(diag::codes::NOT_TEXT, format!("`{}` is {error}", path.display()))
            .help("save the file as UTF-8")
            .into(),
        ReadError::TooLarge(limit) if *limit < files::MAX_BYTES => {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("`{}` is {error}", path.display()));
            fault
                .exceeds(Limit::Memory(limit.saturating_sub(memory::BUFFERS)))
                .into()
        }
        error => {
            let near = (*error == ReadError::NotFound).then(|| near_file(path)).flatten();
            let help = near.map_or_else(String::new, |near| format!("\nhelp: did you mean `{near}`?"));
            Failure::Usage(format!("cannot read `{}`: {error}{help}", path.display()))
        }
    }
}

/// The maximum number of files of a folder among which [`near_file`] searches.
const SIMILAR_MAX: usize = 10_000;

/// Returns a file with a name like that of a missing one: in the same folder, or built in.
fn near_file(path: &Path) -> Option<String> {
    let written = path.to_str()?;
    let name = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new(".")))
        .into_iter()
        .flatten();
    let mut beside: Vec<String> = entries
        .take(SIMILAR_MAX)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| !name.starts_with('.'))
        .collect();
    beside.sort_unstable();
    if let Some(near) = similar_file(name, beside.iter().map(String::as_str)) {
        return Some(folder.map_or(near.to_owned(), |folder| folder.join(near).display().to_string()));
    }
    let known = BuiltinFiles.builtin_paths();
    let rules = || known.iter().map(String::as_str).filter(|known| known.ends_with(".dl"));
    let named = |known: &&str| Path::new(known).file_stem() == path.file_stem();
    match path.extension().and_then(OsStr::to_str) {
        None | Some("dl") => rules()
            .find(|known| folder.is_none() && named(known))
            .or_else(|| similar_file(written, rules()))
            .map(str::to_owned),
        Some("yaml") => similar_file(written, known.iter().map(String::as_str)).map(str::to_owned),
        Some(_) => None,
    }
}

/// Resource limits of an evaluation, for every command that evaluates rules of the user.
#[derive(clap::Args, Default)]
struct LimitOptions {
    /// Fail if the rules derive more than COUNT rows; suffixes K, M, G and T are powers of 1000 [default: 100M for
    /// `query`; 1M for `repl`; 10M for each scene, tick or task; for each tick of a trace 100K plus 100 for each pair of
    /// agents, or 100M for rules that `--rules` names]
    #[arg(long, value_name = "COUNT", value_parser = count_of::<usize>)]
    max_rows: Option<usize>,
    /// Fail if the evaluation scans more than COUNT rows, with the same suffixes [default: 100G for `query` and `repl`;
    /// 1G for each scene, tick or task; for each tick of a trace 100M plus 1K for each row of the default of `--max-rows`]
    #[arg(long, value_name = "COUNT", value_parser = count_of::<u64>)]
    max_steps: Option<u64>,
    #[command(flatten)]
    memory: MemoryOption,
}

/// The limit of memory, for every command that reads files.
#[derive(clap::Args, Clone, Copy, Default)]
struct MemoryOption {
    /// Fail if input, rows, indexes, symbols and buffers need more than SIZE, in MiB or with a suffix: K, M, G, T or KiB,
    /// MiB, GiB, TiB (powers of 1024). Limits of the system (`ulimit -v`, control groups) lower it [default: 4096]
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    max_memory: Option<u64>,
}

impl MemoryOption {
    /// Returns the bytes that the command may use, with `usual` for an unset option.
    fn bytes(self, usual: u64) -> u64 {
        let system = memory::system_limit().map_or(u64::MAX, |limit| limit.bytes);
        self.max_memory.unwrap_or(usual).min(system)
    }
}

impl LimitOptions {
    /// Returns these limits, with `usual` for unset ones.
    fn limits(&self, usual: Limits) -> Limits {
        Limits {
            rows: self.max_rows.unwrap_or(usual.rows),
            steps: self.max_steps.unwrap_or(usual.steps),
            bytes: self.memory.bytes(usual.bytes),
        }
    }
}

/// Returns the memory that a command may use, in bytes.
fn memory_limit(matches: &ArgMatches) -> u64 {
    if let Some((_, inner)) = matches.subcommand() {
        return memory_limit(inner);
    }
    // A command without the option has the usual limit.
    let max_memory = matches.try_get_one::<u64>("max_memory").ok().flatten().copied();
    MemoryOption { max_memory }.bytes(Limits::default().bytes)
}

/// Parses a count with an optional decimal suffix, such as `20K`.
fn count_of<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    let wrong = || "expected a nonnegative integer, optionally with a suffix: 20K, 50M, 1G, 1T".to_owned();
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

/// Splits a text into an integer and the lowercased suffix.
fn with_unit(text: &str) -> Option<(u64, String)> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    Some((number.parse().ok()?, unit.trim_start().to_ascii_lowercase()))
}

/// Parses a size in MiB, or with a binary suffix, and returns bytes.
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

const MEMORY: &str = "expected an integer number of MiB, or one with a suffix: 512K, 50M, 2G, 1T, 50MiB";

/// Adds to diagnostics of exceeded limits how to raise them: by an option, or in the system if its limit is the lower
/// one.
fn advised(diagnostics: &[Diagnostic]) -> Vec<Diagnostic> {
    let raise = |limit: Limit| {
        let option = match limit {
            Limit::Rows => "--max-rows",
            Limit::Steps => "--max-steps",
            Limit::Memory(bytes) => match memory::system_limit().filter(|system| system.bytes == bytes) {
                Some(system) => return format!("{} leaves no more; raise that limit", system.origin),
                None => "--max-memory",
            },
        };
        format!("raise the limit with `{option}`")
    };
    let advised = diagnostics.iter().map(|fault| match fault.limit {
        Some(limit) => fault.clone().help(raise(limit)),
        None => fault.clone(),
    });
    advised.collect()
}

/// Returns whether rules may derive `.input` predicates. A city computes its input, so no rule may derive that: the rules
/// are for a city if they are checked for one or declare an action.
fn inputs_of(texts: &Workspace, in_city: bool) -> InputPolicy {
    match in_city || Action::ALL.iter().any(|action| texts.declares(action.name())) {
        true => InputPolicy::Fixed,
        false => InputPolicy::Extensible,
    }
}

/// Checks and plans rules. Also returns the warnings.
fn compile(workspace: &Workspace) -> Result<(Program, Vec<Diagnostic>), Failure> {
    let loaded = workspace.check();
    match loaded.rules {
        Some(rules) => Ok((Program::new(rules)?, loaded.diagnostics)),
        None => Err(loaded.diagnostics.into()),
    }
}

/// Reads a rule file, given as a path or a bare name such as `hard`, and its includes.
fn load_workspace(sources: &mut Sources, path: &Path, inputs: InputPolicy) -> Result<Workspace, Failure> {
    load_workspace_from(sources, path, inputs, &BuiltinFiles)
}

/// Reads a rule file and its includes from `files`.
fn load_workspace_from(
    sources: &mut Sources,
    path: &Path,
    inputs: InputPolicy,
    files: &dyn ReadFile,
) -> Result<Workspace, Failure> {
    let path = rule_file(path, files);
    let text = read_with(files, &path)?;
    if let Some(fault) = Kind::Rules.mismatch(&path, &text) {
        return Err(fault.into());
    }
    let entry = sources.add(path.display().to_string(), text);
    let mut workspace = Workspace::new(inputs);
    workspace.add(sources, entry, files);
    Ok(workspace)
}

/// Loads a configuration with its rules, or those in the file `rules`, and prints the warnings. `limits` applies to
/// each tick or scene.
fn load_city(
    sources: &mut Sources,
    config: &Path,
    rules: Option<&Path>,
    limits: &LimitOptions,
) -> Result<LoadedCity, Failure> {
    let mut city = LoadedCity::load(sources, config, rules, &BuiltinFiles)?;
    city.limits = limits.limits(city.limits);
    report(&city.warnings, sources);
    Ok(city)
}

/// Returns a parser of integers in a range, whose message names the range.
fn integer<N>(range: RangeInclusive<N>) -> impl Fn(&str) -> Result<N, String> + Clone + Send + Sync + 'static
where
    N: FromStr + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text: &str| {
        let number: Option<N> = text.parse().ok();
        let number = number.filter(|number| range.contains(number));
        number.ok_or_else(|| format!("expected an integer from {} to {}", range.start(), range.end()))
    }
}

/// The maximum number of threads: each needs memory, and systems refuse to start several thousand.
const THREADS_MAX: usize = 1024;

/// Parses a number of threads; 0 means one per core.
fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|&count: &usize| count <= THREADS_MAX);
    let count = count.ok_or_else(|| format!("expected an integer from 0 to {THREADS_MAX}; 0 means one per core"))?;
    let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    Ok(NonZeroUsize::new(count).unwrap_or_else(cores))
}

/// Reads a map, given as a path to a YAML file or as the name of a built-in map.
fn find_map(sources: &mut Sources, name: &str) -> Result<MapConfig, Failure> {
    load_map(sources, Path::new(name), &BuiltinFiles).map_err(missing_is_usage)
}

/// Reports a missing file as wrong usage if the command line names it, so that no text refers to it.
fn missing_is_usage(faults: Vec<Diagnostic>) -> Failure {
    match missing_file(&faults) {
        Some(fault) => {
            let help = fault.help.iter().map(|help| format!("\nhelp: {help}"));
            Failure::Usage(fault.message.clone() + &help.collect::<String>())
        }
        None => faults.into(),
    }
}

/// Returns a progress bar.
fn progress(what: &str, count: u64) -> ProgressBar {
    let template = format!("{{bar:30}} {what} {{pos}} of {{len}}, {{eta}} left");
    ProgressBar::new(count).with_style(ProgressStyle::with_template(&template).expect("a valid template"))
}
