//! Folders of several files, for example data sets.

use crate::files::{Output, ReadError, open_regular, read_text};
use std::fmt;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// An error of a file or folder operation.
#[derive(Debug)]
pub struct FileError {
    /// The failed operation as a verb, for example `read`.
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// The reason.
    pub error: io::Error,
}

impl FileError {
    fn new(action: &'static str, path: PathBuf) -> impl FnOnce(io::Error) -> FileError {
        move |error| FileError { action, path, error }
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot {} `{}`: {}", self.action, self.path.display(), self.error)
    }
}

impl std::error::Error for FileError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.error)
    }
}

/// Creates a folder for results, and its missing parents.
///
/// # Errors
/// If a file has the name of the folder or of a parent; I/O errors.
pub fn make_folder(path: &Path) -> Result<(), FileError> {
    let taken = "a file has this name, or the name of a parent folder";
    let reason = |error: io::Error| match error.kind() {
        kind @ (io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory) => io::Error::new(kind, taken),
        _ => error,
    };
    (fs::create_dir_all(path).map_err(reason)).map_err(FileError::new("make the folder", path.to_owned()))
}

/// A folder that callers pass to a module that does no I/O. The module reads and writes files in it by name.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Creates a folder for results as [`make_folder`] does. An existing folder stays as it is.
    ///
    /// # Errors
    /// As [`make_folder`].
    pub fn make(path: &Path) -> Result<Folder, FileError> {
        make_folder(path)?;
        Ok(Folder::new(path))
    }

    /// Returns the folder with this path, which need not exist.
    pub fn new(path: impl Into<PathBuf>) -> Folder {
        Folder { path: path.into() }
    }

    /// Returns the subfolder with this name.
    pub fn folder(&self, name: &str) -> Folder {
        Folder::new(self.path.join(name))
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether the folder contains a file or folder with this name.
    pub fn has(&self, name: &str) -> bool {
        self.path.join(name).exists()
    }

    /// Creates the folder, whose parent must exist.
    ///
    /// # Errors
    /// I/O errors, also if the folder exists.
    pub fn create(&self) -> Result<(), FileError> {
        fs::create_dir(&self.path).map_err(FileError::new("write", self.path.clone()))
    }

    /// Returns the paths of all files and folders inside, sorted.
    ///
    /// # Errors
    /// I/O errors.
    pub fn entries(&self) -> Result<Vec<PathBuf>, FileError> {
        let list = || -> io::Result<Vec<PathBuf>> {
            let paths = fs::read_dir(&self.path)?.map(|entry| Ok(entry?.path()));
            paths.collect()
        };
        let mut paths = list().map_err(FileError::new("read", self.path.clone()))?;
        paths.sort();
        Ok(paths)
    }

    /// Reads a text file.
    ///
    /// # Errors
    /// As [`read_text`].
    pub fn read_text(&self, name: &str) -> Result<String, FileError> {
        let path = self.path.join(name);
        let kind = |error: &ReadError| match error {
            ReadError::NotFound => io::ErrorKind::NotFound,
            ReadError::NotText { .. } => io::ErrorKind::InvalidData,
            _ => io::ErrorKind::Other,
        };
        (read_text(&path).map_err(|error| io::Error::new(kind(&error), error))).map_err(FileError::new("read", path))
    }

    /// Reads a file if it has this length in bytes. A file of another length is not read.
    ///
    /// # Errors
    /// I/O errors.
    pub fn read_of_length(&self, name: &str, length: u64) -> io::Result<Option<Vec<u8>>> {
        let path = self.path.join(name);
        match fs::metadata(&path)?.len() == length {
            true => {
                let mut bytes = Vec::new();
                let file = open_regular(&path).map_err(io::Error::other)?;
                file.take(length).read_to_end(&mut bytes)?;
                Ok((bytes.len() as u64 == length).then_some(bytes))
            }
            false => Ok(None),
        }
    }

    /// Writes a file.
    ///
    /// # Errors
    /// I/O errors.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<(), FileError> {
        let path = self.path.join(name);
        fs::write(&path, bytes).map_err(FileError::new("write", path))
    }

    /// Begins to write a file, which replaces an existing one. No other process can write it at the same time.
    ///
    /// # Errors
    /// As [`Output::edit`].
    pub fn replace(&self, name: &str) -> Result<Output, FileError> {
        let path = self.path.join(name);
        Output::edit(&path).map_err(FileError::new("write", path))
    }

    /// Completes a file that [`Folder::replace`] began.
    ///
    /// # Errors
    /// I/O errors.
    pub fn finish(&self, name: &str, mut output: Output, text: &str) -> Result<(), FileError> {
        let written = output.write_all(text.as_bytes()).and_then(|()| output.finish());
        written.map_err(FileError::new("write", self.path.join(name)))
    }

    /// Renames a file or folder inside.
    ///
    /// # Errors
    /// I/O errors.
    pub fn rename(&self, from: &str, to: &str) -> Result<(), FileError> {
        let whole = self.path.join(to);
        fs::rename(self.path.join(from), &whole).map_err(FileError::new("write", whole))
    }

    /// Removes a file, or a folder with its contents.
    ///
    /// # Errors
    /// I/O errors.
    pub fn remove(&self, name: &str) -> Result<(), FileError> {
        let path = self.path.join(name);
        let removed = match path.is_dir() {
            true => fs::remove_dir_all(&path),
            false => fs::remove_file(&path),
        };
        removed.map_err(FileError::new("remove", path))
    }
}
