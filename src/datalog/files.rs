//! How sources include files: the caller reads them, the engine does no I/O.

use std::io;
use std::path::{Component, MAIN_SEPARATOR, Path, PathBuf};

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
            Err(ReadError::NotFound) if self.builtin_paths().iter().any(|known| path == Path::new(known)) => {
                self.read(&builtin_path(path))
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

/// Returns the path of a built-in file from its path inside of [`BUILTIN_FOLDER`]. An absolute path stays as it is.
///
/// ```
/// use logicity_datalog::files::builtin_path;
/// use std::path::Path;
///
/// assert_eq!(builtin_path("rules/hard.dl").to_str(), Some("<builtin>/rules/hard.dl"));
/// ```
pub fn builtin_path(inside: impl AsRef<Path>) -> PathBuf {
    portable(Path::new(BUILTIN_FOLDER).join(inside))
}

/// Returns a path of a built-in file with `/` between its parts, so that traces and messages name it equally on every
/// system. Other paths stay as they are.
pub fn portable(path: PathBuf) -> PathBuf {
    match path
        .to_str()
        .filter(|_| MAIN_SEPARATOR != '/' && path.starts_with(BUILTIN_FOLDER))
    {
        Some(text) => text.replace(MAIN_SEPARATOR, "/").into(),
        None => path,
    }
}

/// Returns the help for a missing file whose path has `\` between its parts, which only Windows understands.
pub fn slash_help(path: &str) -> Option<String> {
    let help = || {
        let portable = path.replace('\\', "/");
        format!("write `/` between the parts of a path, on every system: `{portable}`")
    };
    (MAIN_SEPARATOR == '/' && path.contains('\\')).then(help)
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
    portable(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paths of built-in files have `/` on every system. What is a separator depends on it.
    #[test]
    fn paths_of_builtin_files_are_portable() {
        let inside: PathBuf = ["configs", "maps", "square.yaml"].iter().collect();
        assert_eq!(
            builtin_path(&inside).to_str(),
            Some("<builtin>/configs/maps/square.yaml")
        );
        let climbing: PathBuf = ["configs", "..", "rules", ".", "hard.dl"].iter().collect();
        assert_eq!(
            normalize(&builtin_path(climbing)).to_str(),
            Some("<builtin>/rules/hard.dl")
        );
        let own: PathBuf = ["my", "..", "city.yaml"].iter().collect();
        assert_eq!(normalize(&own), Path::new("city.yaml"));
        // Two spellings of one file compare equal.
        assert_eq!(builtin_path(&inside), Path::new(BUILTIN_FOLDER).join(inside));
    }

    #[cfg(windows)]
    #[test]
    fn windows_has_drives_and_two_separators() {
        assert_eq!(builtin_path(r"rules\hard.dl").to_str(), Some("<builtin>/rules/hard.dl"));
        for absolute in [r"C:\rules\hard.dl", r"\\server\rules\hard.dl"] {
            assert_eq!(builtin_path(absolute), Path::new(absolute));
        }
        assert_eq!(normalize(Path::new(r"C:\a\.\b/../c.dl")), Path::new(r"C:\a\c.dl"));
        assert_eq!(slash_help(r"rules\hard.dl"), None);
    }

    #[cfg(unix)]
    #[test]
    fn unix_has_one_separator() {
        assert_eq!(
            builtin_path(r"rules\hard.dl").to_str(),
            Some(r"<builtin>/rules\hard.dl")
        );
        assert_eq!(builtin_path("/rules/hard.dl"), Path::new("/rules/hard.dl"));
        let help = slash_help(r"rules\hard.dl").expect("Unix does not understand it");
        assert!(help.ends_with("`rules/hard.dl`"), "{help}");
        assert_eq!(slash_help("rules/hard.dl"), None);
    }
}
