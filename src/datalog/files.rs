//! How sources include files: the caller reads them, the engine does no I/O.

use std::io;
use std::path::{Component, Path, PathBuf};

/// The folder, as paths name it, that holds the built-in files and nothing else.
pub const BUILTIN_FOLDER: &str = "<builtin>";

/// The reason why a file could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReadError {
    /// The file does not exist.
    NotFound,
    /// It is a folder.
    Folder,
    /// The file is not UTF-8.
    NotText {
        /// The line of the first byte that is not UTF-8, from 1.
        line: usize,
        /// Its column in characters, from 1.
        column: usize,
    },
    /// The file is larger than this many bytes.
    TooLarge(u64),
    /// Any other error, with the system's message.
    Io(String),
}

impl std::fmt::Display for ReadError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ReadError::NotFound => write!(f, "no such file"),
            ReadError::Folder => write!(f, "it is a folder, not a file"),
            ReadError::NotText { line, column } => {
                write!(f, "not UTF-8 text (first bad byte in line {line}, column {column})")
            }
            ReadError::TooLarge(limit) => write!(f, "larger than {} MiB", limit >> 20),
            ReadError::Io(message) => write!(f, "{message}"),
        }
    }
}

impl std::error::Error for ReadError {}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> ReadError {
        match error.kind() {
            io::ErrorKind::NotFound => ReadError::NotFound,
            _ => ReadError::Io(error.to_string()),
        }
    }
}

/// Reads the files that a source names.
///
/// Every function `Fn(&Path) -> Result<String, ReadError>` implements it:
///
/// ```
/// use logicity_datalog::files::{ReadError, ReadFile, to_text};
/// use std::path::Path;
///
/// let from_disk = |path: &Path| to_text(std::fs::read(path)?);
/// assert_eq!(from_disk.read(Path::new("missing.dl")), Err(ReadError::NotFound));
/// ```
pub trait ReadFile {
    /// Returns the text of a file that another file names. On disk it must be a regular file, because reading a pipe or
    /// a device may never end.
    ///
    /// # Errors
    /// Why the file cannot be read.
    fn read(&self, path: &Path) -> Result<String, ReadError>;

    /// Returns the text of a file that the user named, for example on the command line: also of a pipe, such as
    /// `<(command)` in a shell.
    ///
    /// # Errors
    /// Why the file cannot be read.
    fn read_named(&self, path: &Path) -> Result<String, ReadError> {
        self.read(path)
    }

    /// Returns the paths of the files below [`BUILTIN_FOLDER`], for suggestions in messages.
    fn builtin_paths(&self) -> Vec<String> {
        Vec::new()
    }

    /// Returns the names of the entries of a folder, sorted, for suggestions in messages.
    fn names_in(&self, folder: &Path) -> Vec<String> {
        let _ = folder;
        Vec::new()
    }

    /// Returns the text of a file that the user named or, if it does not exist, of the built-in file with that path.
    ///
    /// # Errors
    /// Why the file cannot be read.
    fn read_or_builtin(&self, path: &Path) -> Result<String, ReadError> {
        match self.read_named(path) {
            Err(ReadError::NotFound) if self.builtin_paths().iter().any(|known| path.to_str() == Some(known)) => {
                self.read(&Path::new(BUILTIN_FOLDER).join(path))
            }
            read => read,
        }
    }
}

impl<F: Fn(&Path) -> Result<String, ReadError>> ReadFile for F {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        self(path)
    }
}

/// Decodes UTF-8 text.
///
/// # Errors
/// [`ReadError::NotText`].
pub fn to_text(bytes: Vec<u8>) -> Result<String, ReadError> {
    String::from_utf8(bytes).map_err(|error| {
        let good = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
        ReadError::NotText {
            line: 1 + good.matches('\n').count(),
            column: 1 + good.rsplit('\n').next().unwrap_or_default().chars().count(),
        }
    })
}

/// Returns the path without `.` and, where possible, without `..`, so that two names of one file compare equal. Does
/// not access the disk.
pub fn normalize(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir if matches!(out.components().next_back(), Some(Component::Normal(_))) => {
                out.pop();
            }
            component => out.push(component),
        }
    }
    out
}
