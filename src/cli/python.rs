//! The commands of the Python package.

use std::ffi::OsString;

/// The commands that the Python package implements, as words of the command line, and their summaries.
pub const PYTHON_COMMANDS: [(&[&str], &str); 17] = [
    (
        &["evaluate"],
        "Measure a policy on recorded episodes with the metrics of the paper",
    ),
    (&["policies"], "List the trained policies that the package contains"),
    (
        &["train"],
        "Train a learner on Safe Path Following, or resume an interrupted run",
    ),
    (
        &["experiment"],
        "Train and evaluate the learners of an experiment, or resume it, and print a table beside the paper's",
    ),
    (
        &["distill"],
        "Learn the rules that recorded traffic follows, and report how much they explain",
    ),
    (&["map", "export"], "Write a map as a road network for SUMO"),
    (
        &["release"],
        "Write data sets with metadata, and trained policies, as folders to publish, or resume",
    ),
    (
        &["import-episodes"],
        "Read the episodes of the published program from its pickle, without running it",
    ),
    (
        &["shards"],
        "Make the shards of a command in processes, on a Ray cluster or on Slurm, and join them",
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
        &["study"],
        "Write questions as documents for people, with the answers in another document",
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

/// Returns the Python command at the start of the arguments, and the arguments after it.
pub fn python_command(arguments: &[OsString]) -> Option<(&'static [&'static str], Vec<OsString>)> {
    let begins = |words: &[&str]| arguments.len() >= words.len() && words.iter().zip(arguments).all(|(a, b)| b == a);
    let (words, _) = PYTHON_COMMANDS.into_iter().find(|(words, _)| begins(words))?;
    Some((words, arguments[words.len()..].to_vec()))
}

/// Adds a command of the Python package for help and completion scripts; its arguments complete as paths.
pub fn add_subcommand(command: clap::Command, words: &'static [&'static str], summary: &'static str) -> clap::Command {
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
