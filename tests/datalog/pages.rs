//! The pages of the documentation and their blocks of code. `docs/how-to/add-a-page.md` describes the kinds of blocks.

use crate::root::root;
use std::fs;
use std::path::PathBuf;

/// A block of code in a Markdown text.
pub struct Block {
    /// The number of its first line, which holds the three backquotes.
    pub line: usize,
    /// The text after the three backquotes, for example `dl my.dl`.
    pub kind: String,
    /// The text, which ends with a line break.
    pub text: String,
}

/// Returns the blocks of a Markdown text.
pub fn blocks(text: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let mut lines = text.lines().zip(1..);
    while let Some((first, line)) = lines.next() {
        if let Some(kind) = first.strip_prefix("```") {
            let inside = lines.by_ref().map(|(line, _)| line).take_while(|line| *line != "```");
            found.push(Block {
                line,
                kind: kind.to_owned(),
                text: inside.map(|line| format!("{line}\n")).collect(),
            });
        }
    }
    found
}

/// Returns the path from the root of the repository and the text of each page of the site.
pub fn pages() -> Vec<(PathBuf, String)> {
    let root = root();
    let mut paths = Vec::new();
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a readable folder") {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                // A program with a README of its own.
                if !path.ends_with("docs/playground") {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|extension| extension == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("a readable page");
        (
            path.strip_prefix(root).expect("a page of the repository").to_owned(),
            text,
        )
    };
    paths.into_iter().map(read).collect()
}
