//! The files that a command reads: those on the command line, and which of them no output may replace.

use crate::builtin::{self, BuiltinFiles};
use crate::cli::failure::Failure;
use crate::cli::memory;
use crate::diag::{self, Diagnostic, Limit, Sources};
use crate::files::{self, FileId, ReadError, ReadFile};
use std::collections::BTreeSet;
use std::fs::File;
use std::iter;
use std::path::{Path, PathBuf};

/// The files that a command reads. No output replaces one of them, not even with `--force`.
#[derive(Default)]
pub struct Inputs(BTreeSet<FileId>);

impl Inputs {
    /// Returns the files with these paths; `-` means standard input.
    pub fn new(paths: impl IntoIterator<Item = PathBuf>) -> Inputs {
        Inputs::default().with(paths)
    }

    /// Returns the files of texts: rules with their includes, configurations with their parts.
    pub fn of(sources: &Sources) -> Inputs {
        Inputs::new(sources.ids().map(|id| PathBuf::from(sources.name(id))))
    }

    /// Adds files; `-` means standard input.
    pub fn with(mut self, paths: impl IntoIterator<Item = PathBuf>) -> Inputs {
        let named = |path: PathBuf| match path == Path::new("-") {
            true => "/dev/stdin".into(),
            false => path,
        };
        let existing = paths.into_iter().filter_map(|path| FileId::of(&named(path)));
        self.0.extend(existing);
        self
    }

    /// Fails if an output is one of the files.
    pub fn refuse(&self, output: &Path) -> Result<(), Failure> {
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

/// Reads a file named on the command line, or a built-in one.
pub fn read(path: &Path) -> Result<String, Failure> {
    read_with(&BuiltinFiles, path)
}

pub fn read_with(files: &dyn ReadFile, path: &Path) -> Result<String, Failure> {
    files.read_or_builtin(path).map_err(|error| unreadable(path, &error))
}

/// Opens a file named on the command line, which may be a pipe.
pub fn open(path: &Path) -> Result<File, Failure> {
    files::open(path).map_err(|error| unreadable(path, &error))
}

/// Reports a file named on the command line that cannot be read.
pub fn unreadable(path: &Path, error: &ReadError) -> Failure {
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
            let help = match error {
                ReadError::NotFound => builtin::similar(path).map(|near| format!("did you mean `{near}`?")),
                ReadError::Folder => files::name_a_file(path, &files::names_in(path)),
                _ => None,
            };
            let help = help.map_or_else(String::new, |help| format!("\nhelp: {help}"));
            Failure::Usage(format!("cannot read `{}`: {error}{help}", path.display()))
        }
    }
}

/// Fails if a shard could not name the configuration or the rules, since its first line is JSON.
pub fn refuse_undecodable(config: &Path, rules: Option<&Path>) -> Result<(), Failure> {
    match iter::once(config).chain(rules).find(|path| path.to_str().is_none()) {
        Some(path) => Err(Failure::Usage(format!(
            "a shard cannot name `{}`, which is not UTF-8\nhelp: rename it",
            path.display()
        ))),
        None => Ok(()),
    }
}
