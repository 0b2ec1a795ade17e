//! The command line: the commands and their dispatch. Each subcommand has a file, and so has what several share.
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
mod fact;
mod failure;
mod fcd;
mod fmt;
mod frames;
mod icons;
mod induce;
mod infer;
mod inputs;
mod kind;
mod limits;
mod load;
#[cfg(feature = "lsp")]
mod lsp;
mod map;
mod memory;
mod merge;
mod new;
mod outputs;
mod pddl;
mod python;
mod query;
mod questions;
mod reference;
#[cfg(feature = "repl")]
mod repl;
mod report;
mod route;
mod run;
mod scenes;
mod schema;
mod shortcuts;
mod signals;
mod souffle;
mod terminal;
mod trace;
mod values;
mod vap;
mod video;
mod view;

use crate::cli::failure::Failure;
use crate::cli::limits::memory_limit;
use crate::cli::python::{add_subcommand, python_command};
use crate::cli::report::{exit, report};
use crate::diag::{self, Diagnostic, Limit, Sources, neutral};
use crate::files;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
pub use python::PYTHON_COMMANDS;
use std::ffi::OsString;
use std::io::{self, Write};
use std::iter;
use std::process::ExitCode;

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
    /// Count reasoning shortcuts: confusions of concepts that change no decision
    Shortcuts(shortcuts::Arguments),
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
    /// Write the task of an ego as a planning problem in PDDL, or drive a plan in the city
    Pddl(pddl::Arguments),
    /// Generate multiple-choice questions about the decisions of cars, with solved examples
    Questions(questions::Arguments),
    /// Generate or check data sets of Visual Action Prediction: pictures, boxes, facts and labels
    Vap(vap::Arguments),
    /// Join the shards that `--shard` makes of episodes, questions or data sets of pictures
    Merge(merge::Arguments),
    /// Import road networks of SUMO as maps, or export maps to SUMO
    Map(map::Arguments),
    /// Write a run as floating car data of SUMO: the positions of all agents over time
    Fcd(fcd::Arguments),
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
            ["train" | "experiment"] => "logicity[learn]",
            _ => "logicity",
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
        .and_then(|mut matches| {
            let assumed = assumed_config(&command, &matches);
            Ok((
                memory_limit(&matches),
                assumed,
                Arguments::from_arg_matches_mut(&mut matches)?,
            ))
        });
    let (limit, assumed, arguments) = match parsed {
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
        Command::Shortcuts(arguments) => shortcuts::run(&arguments, &mut sources),
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
        Command::Pddl(arguments) => pddl::run(&arguments, &mut sources),
        Command::Questions(arguments) => questions::run(&arguments, &mut sources),
        Command::Merge(arguments) => merge::run(&arguments, &mut sources),
        Command::Vap(arguments) => vap::run(&arguments, &mut sources),
        #[cfg(feature = "lsp")]
        Command::Lsp(arguments) => lsp::run(&arguments),
        Command::Icons(arguments) => icons::run(&arguments),
        Command::Map(arguments) => map::run(&arguments, &mut sources),
        Command::Fcd(arguments) => fcd::run(&arguments, &mut sources),
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
        Err(failure) => exit(failure.advise(assumed.as_deref()), &sources),
    }
}

/// Returns the help about the configuration that a command takes by default, if the user chose none.
fn assumed_config(command: &clap::Command, matches: &clap::ArgMatches) -> Option<String> {
    if let Some((name, inner)) = matches.subcommand() {
        return assumed_config(command.find_subcommand(name)?, inner);
    }
    let argument = command.get_arguments().find(|argument| argument.get_id() == "config")?;
    let chosen = matches.value_source("config") != Some(clap::parser::ValueSource::DefaultValue);
    let assumed = argument.get_default_values().first().filter(|_| !chosen)?;
    let assumed = assumed.to_string_lossy();
    Some(match argument.get_long() {
        Some(_) => failure::assumed(&assumed),
        None => format!("this is about `{assumed}`, the default; name another configuration as the argument `CONFIG`"),
    })
}
