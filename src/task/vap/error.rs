//! The error of data sets.

use crate::diag::Diagnostic;
use crate::files::FileError;
use std::fmt;
use std::path::PathBuf;

/// The reason why a data set was not made or checked.
#[derive(Debug)]
#[non_exhaustive]
pub enum DatasetError {
    /// Invalid input, or `cancelled`.
    Faulty(Vec<Diagnostic>),
    /// A file that cannot be read or written.
    File(FileError),
    /// A file or folder that keeps a data set from being made in its folder.
    Occupied(Occupied),
}

/// A file or folder that is not part of the data set to make.
#[derive(Debug)]
pub struct Occupied {
    /// The file or folder.
    pub path: PathBuf,
    /// The reason.
    pub reason: String,
    /// Whether [`Overwrite::Any`](crate::files::Overwrite::Any) replaces it.
    pub replaceable: bool,
}

impl fmt::Display for Occupied {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot write `{}`: {}", self.path.display(), self.reason)
    }
}

impl From<Diagnostic> for DatasetError {
    fn from(fault: Diagnostic) -> Self {
        DatasetError::Faulty(vec![fault])
    }
}

impl From<Vec<Diagnostic>> for DatasetError {
    fn from(faults: Vec<Diagnostic>) -> Self {
        DatasetError::Faulty(faults)
    }
}

impl From<Occupied> for DatasetError {
    fn from(occupied: Occupied) -> Self {
        DatasetError::Occupied(occupied)
    }
}

impl From<FileError> for DatasetError {
    fn from(error: FileError) -> Self {
        DatasetError::File(error)
    }
}

impl fmt::Display for DatasetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            DatasetError::Faulty(faults) => {
                let messages: Vec<&str> = faults.iter().map(|fault| fault.message.as_str()).collect();
                f.write_str(&messages.join("\n"))
            }
            DatasetError::File(error) => error.fmt(f),
            DatasetError::Occupied(occupied) => occupied.fmt(f),
        }
    }
}

impl std::error::Error for DatasetError {}
