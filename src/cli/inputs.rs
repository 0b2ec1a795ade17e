//! The files that a command reads: those on the command line, and which of them no output may replace.

use crate::builtin::BuiltinFiles;
use crate::cli::failure::Failure;
use crate::cli::memory;
use crate::diag::{self, Diagnostic, Limit, Sources, similar_file};
use crate::files::{self, FileId, ReadError, ReadFile};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
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
