//! The examples of README: writes its rule files to a folder, runs its commands there, and compares their output with
//! the quoted one.

use crate::pages::{self, Block};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn blocks() -> Vec<Block> {
    pages::blocks(&fs::read_to_string(root().join("README.md")).unwrap())
}

/// Returns the standard output and error of a shell command, with this program first on the path.
pub fn shell(command: &str, folder: &Path) -> String {
    let program = Path::new(env!("CARGO_BIN_EXE_logicity")).parent().unwrap();
    let others = std::env::var_os("PATH").unwrap();
    let path = std::env::join_paths(std::iter::once(program.to_owned()).chain(std::env::split_paths(&others))).unwrap();
    let output = Command::new("sh")
        .args(["-c", command])
        .env("PATH", path)
        .current_dir(folder)
        .output()
        .unwrap();
    String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap()
}

#[test]
fn slow_commands_print_the_output_in_readme() {
    let folder = tempfile::tempdir().unwrap();
    let mut last_file = String::new();
    let mut last_output = String::new();
    let mut compared = 0;
    for block in blocks() {
        match block.kind.as_str() {
            kind if kind.starts_with("prolog ") => {
                last_file = kind["prolog ".len()..].to_owned();
                fs::write(folder.path().join(&last_file), &block.text).unwrap();
                last_output.clear();
            }
            "sh" if block.text.contains("cargo run") => {}
            "sh" => {
                last_output = shell(&block.text, folder.path());
                assert!(!last_output.contains("error"), "{}\n{last_output}", block.text);
            }
            "text" if last_output.is_empty() => {
                let output = shell(&format!("logicity check {last_file}"), folder.path());
                assert_eq!(output, block.text);
                compared += 1;
            }
            "text" | "json" => {
                assert_eq!(last_output, block.text);
                compared += 1;
            }
            _ => {}
        }
    }
    assert!(compared >= 1, "README has too few examples");
}

/// The scenes that the site shows satisfy the constraints of the rules: those that it pipes to `infer`, and those that
/// `check` and `diff` print.
#[test]
fn the_scenes_of_the_site_satisfy_the_constraints() {
    let folder = tempfile::tempdir().unwrap();
    let mut count = 0;
    let mut infer = |command: &str| {
        let output = shell(command, folder.path());
        assert!(
            output.starts_with("{\"egos\"") && !output.contains("error"),
            "{command}\n{output}"
        );
        count += 1;
    };
    let pages = pages::pages();
    let blocks = pages.iter().flat_map(|(_, text)| pages::blocks(text));
    // Constraints are about one world, uncertain rows about several.
    for block in blocks.filter(|block| !block.text.contains("probability") && !block.text.contains("--marginals")) {
        if block.kind == "sh" && block.text.contains("| logicity infer") || block.text.contains("|\n  logicity infer") {
            infer(
                &block
                    .text
                    .replace("logicity infer", "logicity infer --check-constraints"),
            );
        }
        for line in block
            .text
            .lines()
            .filter(|line| line.trim().starts_with("{\"entities\""))
        {
            infer(&format!(
                "echo '{line}' | logicity infer --config vap-hard --check-constraints"
            ));
        }
    }
    assert!(count >= 3, "the site shows too few scenes");
}

/// Runs the commands of the site that need cargo, with the default features, for which everything is built already.
#[test]
fn slow_cargo_prints_the_output_in_the_site() {
    let mut count = 0;
    for (page, text) in pages::pages() {
        let mut output = String::new();
        for block in pages::blocks(&text) {
            match block.kind.as_str() {
                "sh cargo" => {
                    let command = block.text.replace("cargo run", "cargo run --quiet --locked");
                    let command = command.replace("cargo ", concat!(env!("CARGO"), " "));
                    output = shell(&format!("cd '{}' && {command}", root().display()), &root());
                }
                "text cargo" => {
                    assert_eq!(output, block.text, "{}:{}", page.display(), block.line);
                    count += 1;
                }
                _ => {}
            }
        }
    }
    assert!(count >= 1);
}

/// Returns the names of all commands in the help.
fn commands() -> Vec<String> {
    let help = shell("logicity --help", &root());
    let commands: Vec<String> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .map_while(|line| line.strip_prefix("  "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .map(str::to_owned)
        .collect();
    assert!(commands.len() >= 6);
    commands
}

/// The site is made from the output of this command.
#[test]
fn the_reference_has_every_command_and_option() {
    let reference: Value = serde_json::from_str(&shell("logicity reference", &root())).unwrap();
    let listed = reference["commands"].as_array().unwrap();
    let names: Vec<&str> = listed.iter().map(|command| command["name"].as_str().unwrap()).collect();
    assert_eq!(names, commands());
    for command in listed {
        let name = command["name"].as_str().unwrap();
        let help = shell(&format!("logicity {name} --help"), &root());
        for argument in command["arguments"].as_array().unwrap() {
            let form = match argument["long"].as_str() {
                Some(long) => format!("--{long}"),
                None => argument["values"][0].as_str().unwrap().to_owned(),
            };
            assert!(help.contains(&form), "`{form}` is not in the help of `{name}`");
            assert!(argument["help"].is_string(), "`{form}` of `{name}` has no help");
        }
        let options = help.lines().filter(|line| line.trim_start().starts_with("--")).count();
        let found = command["arguments"].as_array().unwrap().len();
        assert!(
            found + 2 >= options,
            "`{name}` has {options} options, the reference {found}"
        );
    }
}
