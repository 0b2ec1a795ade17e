//! Files: the only place that reads input and writes output.
//!
//! Input is read whole, with a bound on its size, and must be UTF-8. Output is written to a temporary name in the same folder
//! and renamed when complete, so a reader never sees half a file and a failed write leaves the old one.

#[cfg(feature = "sim")]
use std::io::Write;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

#[cfg(feature = "parquet")]
mod folder;

#[cfg(feature = "parquet")]
pub use folder::{FileError, Folder, make_folder};

/// The folder, as paths name it, that holds the built-in files and nothing else.
pub const BUILTIN_FOLDER: &str = "<builtin>";

/// The largest text file that is read: 1 GiB.
pub const MAX_BYTES: u64 = 1 << 30;

/// Why a file could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReadError {
    /// There is no such file.
    NotFound,
    /// Its bytes are not UTF-8.
    NotText {
        /// Line of the first byte that is not UTF-8, from 1.
        line: usize,
        /// Its column in characters, from 1.
        column: usize,
    },
    /// It is larger than [`MAX_BYTES`].
    TooLarge,
    /// Anything else; the system's words.
    Io(String),
}

impl std::fmt::Display for ReadError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ReadError::NotFound => write!(f, "no such file"),
            ReadError::NotText { line, column } => {
                write!(f, "not UTF-8 text (first bad byte in line {line}, column {column})")
            }
            ReadError::TooLarge => write!(f, "larger than {} MiB", MAX_BYTES >> 20),
            ReadError::Io(message) => write!(f, "{message}"),
        }
    }
}

impl std::error::Error for ReadError {}

/// How a program or a configuration reads the files that it names: the rooms that parse them do no I/O.
///
/// Every function `Fn(&Path) -> Result<String, ReadError>` is one, for example [`read_text`].
pub trait ReadFile {
    /// The text of a file.
    ///
    /// # Errors
    /// Why the file cannot be read.
    fn read(&self, path: &Path) -> Result<String, ReadError>;

    /// The paths of the files below [`BUILTIN_FOLDER`], for suggestions in messages.
    fn builtin_paths(&self) -> Vec<String> {
        Vec::new()
    }
}

impl<F: Fn(&Path) -> Result<String, ReadError>> ReadFile for F {
    fn read(&self, path: &Path) -> Result<String, ReadError> {
        self(path)
    }
}

/// Reads a text file.
///
/// # Errors
/// Why the file cannot be read.
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    read_from(open(path)?)
}

/// Opens what is not a folder.
///
/// # Errors
/// Why the file cannot be read.
pub fn open(path: &Path) -> Result<std::fs::File, ReadError> {
    let fail = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => ReadError::NotFound,
        _ => ReadError::Io(error.to_string()),
    };
    let file = std::fs::File::open(path).map_err(fail)?;
    if file.metadata().map_err(fail)?.is_dir() {
        return Err(ReadError::Io("it is a folder, not a file".into()));
    }
    Ok(file)
}

/// Reads all there is as text.
pub fn read_from(input: impl Read) -> Result<String, ReadError> {
    to_text(read_bytes(input)?)
}

/// Reads all there is as text, also what is not: each byte that is no part of a text becomes `U+FFFD`. Beside it the place of the first.
pub fn read_any(input: impl Read) -> Result<(String, Option<usize>), ReadError> {
    Ok(match String::from_utf8(read_bytes(input)?) {
        Ok(text) => (text, None),
        Err(error) => {
            let first = error.utf8_error().valid_up_to();
            (String::from_utf8_lossy(error.as_bytes()).into_owned(), Some(first))
        }
    })
}

fn read_bytes(input: impl Read) -> Result<Vec<u8>, ReadError> {
    let fail = |error: std::io::Error| ReadError::Io(error.to_string());
    let mut bytes = Vec::new();
    input.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(fail)?;
    match bytes.len() as u64 > MAX_BYTES {
        true => Err(ReadError::TooLarge),
        false => Ok(bytes),
    }
}

/// A path and the bytes of its file.
pub type NamedBytes = (String, Vec<u8>);

/// Reads the files in the folders of a folder, each with its path `FOLDER/NAME`, in the order of paths. What lies beside the folders, and
/// what has a name that begins with a dot, is left out.
///
/// # Errors
/// The path that cannot be read, or that has too many or too large files below it, and why.
pub fn read_folders(path: &Path, files_max: usize, bytes_max: u64) -> Result<Vec<NamedBytes>, (PathBuf, ReadError)> {
    let mut found = Vec::new();
    for folder in listed(path)?.into_iter().filter(|path| path.is_dir()) {
        for file in listed(&folder)? {
            let fail = |error: ReadError| (file.clone(), error);
            if found.len() == files_max {
                return Err(fail(ReadError::Io(format!("more than {files_max} files"))));
            }
            let handle = open(&file).map_err(fail)?;
            // One byte more, so that whoever takes the bytes can tell that there are too many.
            let bytes = read_bytes(handle.take(bytes_max + 1)).map_err(fail)?;
            let inside = file.strip_prefix(path).ok().and_then(Path::to_str);
            let name = inside.ok_or_else(|| fail(ReadError::Io("its name is not UTF-8".into())))?;
            found.push((name.replace(std::path::MAIN_SEPARATOR, "/"), bytes));
        }
    }
    Ok(found)
}

/// What is in a folder, sorted, without names that begin with a dot.
fn listed(path: &Path) -> Result<Vec<PathBuf>, (PathBuf, ReadError)> {
    let fail = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => (path.to_owned(), ReadError::Io("no such folder".into())),
        io::ErrorKind::NotADirectory => (path.to_owned(), ReadError::Io("it is no folder".into())),
        _ => (path.to_owned(), ReadError::Io(error.to_string())),
    };
    let entries = std::fs::read_dir(path).map_err(fail)?;
    let mut paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<io::Result<Vec<_>>>()
        .map_err(fail)?;
    paths.retain(|path| {
        path.file_name()
            .is_some_and(|name| !name.to_string_lossy().starts_with('.'))
    });
    paths.sort();
    Ok(paths)
}

/// The text that bytes are.
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

/// A path without `.` and, where the text allows it, without `..`: by it two names of one file are known to be the same. The disk
/// is not asked.
pub fn normalise(path: &Path) -> PathBuf {
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

/// A file being written under a temporary name; [`Output::finish`] gives it its own. Dropped unfinished, it leaves nothing.
#[cfg(feature = "sim")]
pub struct Output {
    file: io::BufWriter<tempfile::NamedTempFile>,
    path: PathBuf,
}

#[cfg(feature = "sim")]
impl Output {
    /// Begins to write the file at `path`, whose folder must exist.
    ///
    /// # Errors
    /// Those of the system, and `InvalidInput` if `path` is a folder, a device or the like: it would be replaced.
    pub fn create(path: &Path) -> io::Result<Output> {
        if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file"));
        }
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        if !folder.is_dir() {
            let message = format!("there is no folder `{}`", folder.display());
            return Err(io::Error::new(io::ErrorKind::NotFound, message));
        }
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        {
            // Temporary files are private; an output is as readable as any file its user makes.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        Ok(Output {
            file: io::BufWriter::new(builder.tempfile_in(folder)?),
            path: path.to_owned(),
        })
    }

    /// Gives the complete file its name.
    ///
    /// # Errors
    /// Those of the system; then the file of that name, if there is one, is as before.
    pub fn finish(self) -> io::Result<()> {
        let file = self.file.into_inner().map_err(io::IntoInnerError::into_error)?;
        file.persist(&self.path).map_err(|error| error.error)?;
        Ok(())
    }
}

#[cfg(feature = "sim")]
impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(all(test, feature = "sim"))]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_are_replaced() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        for text in ["first", "second"] {
            let mut output = Output::create(&path).expect("the folder exists");
            output.write_all(text.as_bytes()).expect("there is room");
            output.finish().expect("it can be renamed");
            assert_eq!(read_text(&path).as_deref(), Ok(text));
        }
        drop(Output::create(&path).expect("the folder exists"));
        assert_eq!(read_text(&path).as_deref(), Ok("second"));
        let refused = Output::create(folder.path()).err().map(|error| error.kind());
        assert_eq!(refused, Some(io::ErrorKind::InvalidInput));
        assert_eq!(std::fs::read_dir(folder.path()).expect("it is there").count(), 1);
    }
}
