//! Reads the rule files of the repository, which the engine alone does not contain.

use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile, read_text};
use std::path::Path;

/// Reads files from the disk, and under [`BUILTIN_FOLDER`] those of `rules/`.
pub struct RuleFiles;

impl ReadFile for RuleFiles {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        match path.strip_prefix(BUILTIN_FOLDER) {
            Ok(name) => read_text(&Path::new(env!("CARGO_MANIFEST_DIR")).join("rules").join(name)),
            Err(_) => read_text(path),
        }
    }

    fn builtin_paths(&self) -> Vec<String> {
        let files = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("rules")).expect("the folder exists");
        let mut paths: Vec<String> = files
            .map(|file| format!("rules/{}", file.expect("an entry").file_name().to_string_lossy()))
            .collect();
        paths.sort();
        paths
    }
}
