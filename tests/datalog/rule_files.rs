//! Reads the rule files of the repository, which the engine alone does not contain.

use crate::root::root;
use logicity_datalog::files::{BUILTIN_FOLDER, ReadError, ReadFile, to_text};
use std::path::Path;

/// Reads files from the disk, and under [`BUILTIN_FOLDER`] those of `rules/`.
pub struct RuleFiles;

impl ReadFile for RuleFiles {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        match path.strip_prefix(BUILTIN_FOLDER) {
            Ok(name) => to_text(std::fs::read(root().join("rules").join(name))?),
            Err(_) => to_text(std::fs::read(path)?),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        let files = std::fs::read_dir(root().join("rules")).expect("the folder exists");
        let mut paths: Vec<String> = files
            .map(|file| format!("rules/{}", file.expect("an entry").file_name().to_string_lossy()))
            .collect();
        paths.sort();
        paths
    }
}
