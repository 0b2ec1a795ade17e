//! `logicity reference`: prints the commands and their options as JSON.

use crate::cli::failure::Failure;
use crate::cli::terminal;
use clap::{Arg, ArgAction, Command};
use serde_json::{Value, json};
use std::io::Write;

pub fn run(mut command: Command) -> Result<(), Failure> {
    command.build();
    writeln!(terminal::data(), "{}", to_json(&command))?;
    Ok(())
}

fn to_json(command: &Command) -> Value {
    let arguments = command.get_arguments().filter(|argument| {
        let action = argument.get_action();
        !argument.is_hide_set() && !matches!(action, ArgAction::Help | ArgAction::HelpShort | ArgAction::Version)
    });
    let inner = command
        .get_subcommands()
        .filter(|inner| !inner.is_hide_set() && inner.get_name() != "help");
    json!({
        "name": command.get_name(),
        "about": command.get_about().map(ToString::to_string),
        "usage": command.clone().render_usage().to_string(),
        "arguments": arguments.map(argument).collect::<Vec<_>>(),
        "commands": inner.map(to_json).collect::<Vec<_>>(),
    })
}

fn argument(argument: &Arg) -> Value {
    let takes_value = argument.get_action().takes_values();
    let values = argument.get_value_names().unwrap_or_default();
    let defaults = argument
        .get_default_values()
        .iter()
        .map(|value| value.to_string_lossy());
    let possible = argument.get_possible_values();
    json!({
        "long": argument.get_long(),
        "short": argument.get_short(),
        "positional": argument.is_positional(),
        "required": argument.is_required_set(),
        "values": values.iter().filter(|_| takes_value).map(|value| value.as_str()).collect::<Vec<_>>(),
        "help": argument.get_help().map(ToString::to_string),
        "default": defaults.filter(|_| takes_value).collect::<Vec<_>>(),
        "possible": possible.iter().filter(|_| takes_value).map(|value| value.get_name()).collect::<Vec<_>>(),
    })
}
