//! The programs in the folders `examples` print what their comments show.

use crate::root::root;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// The longest example, in lines.
const LINES_MAX: usize = 60;

fn examples() -> Vec<PathBuf> {
    let folders = ["examples", "src/datalog/examples"].map(|folder| root().join(folder));
    let mut found: Vec<PathBuf> = (folders.iter())
        .flat_map(|folder| fs::read_dir(folder).unwrap())
        .map(|entry| entry.unwrap().path())
        .collect();
    found.sort();
    found
}

/// Returns the output that the comment at the start of an example shows, between "```text" and "```".
fn shown(text: &str) -> Option<String> {
    let comment = text.lines().map_while(|line| line.strip_prefix("//!"));
    let mut lines = comment.map(|line| line.strip_prefix(' ').unwrap_or(line));
    lines.find(|line| *line == "```text")?;
    Some(
        lines
            .take_while(|line| *line != "```")
            .map(|line| format!("{line}\n"))
            .collect(),
    )
}

/// Cargo builds the examples first if this test runs alone.
#[test]
fn slow_examples_print_what_their_comments_show() {
    let names: Vec<String> = (examples().iter())
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    assert!(names.len() >= 5, "{names:?}");
    // This program is TARGET/PROFILE/deps/program-HASH.
    let program = std::env::current_exe().unwrap();
    let profile = program.ancestors().nth(2).unwrap();
    let mut build = Command::new(env!("CARGO"));
    build.args(["build", "--quiet", "--locked", "--examples", "--target-dir"]);
    build.arg(profile.parent().unwrap()).current_dir(root());
    if profile.ends_with("release") {
        build.arg("--release");
    }
    assert!(build.status().unwrap().success());
    for (name, path) in names.iter().zip(examples()) {
        let text = fs::read_to_string(path).unwrap();
        let output = Command::new(profile.join("examples").join(name)).output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        assert!(
            output.status.success(),
            "{name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let shown = shown(&text).unwrap_or_else(|| panic!("{name} shows no output; it prints\n{printed}"));
        // A trailing space in a comment would not survive.
        let printed: String = printed.lines().map(|line| format!("{}\n", line.trim_end())).collect();
        assert_eq!(printed.trim_end(), shown.trim_end(), "{name}");
        assert!(text.lines().count() < LINES_MAX, "{name} has {LINES_MAX} lines or more");
    }
}
