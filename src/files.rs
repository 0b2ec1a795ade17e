//! Files: the only place that reads input and writes output.
//!
//! Input is read whole, with a bound on its size, and must be UTF-8. Output is written to a temporary name in the same folder
//! and renamed when complete, so a reader never sees half a file and a failed write leaves the old one.

use std::io::{self, Read, Write};
use std::path::Path;

/// Declares the built-in files by their path in the repository. A list and not a search at compile time, so that the program
/// is built from what the text of the source says; a test compares the list with the folders.
macro_rules! builtin_files {
    ($($path:literal)*) => {
        /// The files of `rules/` and `configs/` that are part of the program, so that it works without the repository.
        pub const BUILTIN: &[(&str, &str)] = &[$(($path, include_str!(concat!("../", $path))),)*];
    };
}

builtin_files! {
    "configs/agents/easy.yaml"
    "configs/agents/expert.yaml"
    "configs/agents/hard.yaml"
    "configs/agents/medium.yaml"
    "configs/agents/vap.yaml"
    "configs/common.yaml"
    "configs/easy.yaml"
    "configs/expert.yaml"
    "configs/hard.yaml"
    "configs/maps/random-8x8.yaml"
    "configs/maps/square-5x5.yaml"
    "configs/medium.yaml"
    "configs/predicates/standard.yaml"
    "configs/predicates/vap.yaml"
    "configs/transfer-easy.yaml"
    "configs/transfer-hard.yaml"
    "configs/transfer-medium.yaml"
    "configs/vap-easy.yaml"
    "configs/vap-hard.yaml"
    "rules/easy.dl"
    "rules/expert.dl"
    "rules/hard.dl"
    "rules/medium.dl"
    "rules/transfer-easy.dl"
    "rules/transfer-hard.dl"
    "rules/transfer-medium.dl"
    "rules/vap-easy.dl"
    "rules/vap-hard.dl"
    "rules/vocabulary.dl"
}

/// The folder, as paths name it, that holds the built-in files and nothing else.
pub const BUILTIN_FOLDER: &str = "<builtin>";

/// A built-in file by its path in the repository, for example `rules/vocabulary.dl` or `configs/maps/square-5x5.yaml`.
pub fn builtin(path: &str) -> Option<&'static str> {
    BUILTIN.iter().find(|(known, _)| *known == path).map(|(_, text)| *text)
}

/// The largest text file that is read: 1 GiB.
pub const MAX_BYTES: u64 = 1 << 30;

/// Why a file could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReadError {
    /// There is no such file.
    NotFound,
    /// Its bytes are not UTF-8; the line (from 1) of the first bad byte.
    NotText {
        /// Line of the first byte that is not UTF-8.
        line: usize,
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
            ReadError::NotText { line } => write!(f, "not UTF-8 text (first bad byte in line {line})"),
            ReadError::TooLarge => write!(f, "larger than {} MiB", MAX_BYTES >> 20),
            ReadError::Io(message) => write!(f, "{message}"),
        }
    }
}

impl std::error::Error for ReadError {}

/// Reads a text file.
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    let fail = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => ReadError::NotFound,
        _ => ReadError::Io(error.to_string()),
    };
    let file = std::fs::File::open(path).map_err(fail)?;
    if file.metadata().map_err(fail)?.is_dir() {
        return Err(ReadError::Io("it is a folder, not a file".into()));
    }
    read_from(file)
}

/// Reads all there is as text.
pub fn read_from(input: impl Read) -> Result<String, ReadError> {
    let fail = |error: std::io::Error| ReadError::Io(error.to_string());
    let mut bytes = Vec::new();
    input.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(fail)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(ReadError::TooLarge);
    }
    String::from_utf8(bytes).map_err(|error| ReadError::NotText {
        line: 1 + error.as_bytes()[..error.utf8_error().valid_up_to()]
            .iter()
            .filter(|&&byte| byte == b'\n')
            .count(),
    })
}

/// Reads a text file, or, if there is none, the built-in file of that path. Under [`BUILTIN_FOLDER`] nothing is on disk, and the
/// folder `rules/` may be left out: a rule file anywhere can include `vocabulary.dl`.
///
/// # Errors
/// Why the file cannot be read.
pub fn read_or_builtin(path: &Path) -> Result<String, ReadError> {
    let text = |path: &Path| path.to_str().and_then(builtin).map(str::to_owned);
    match path.strip_prefix(BUILTIN_FOLDER) {
        Ok(inside) => text(inside)
            .or_else(|| text(&Path::new("rules").join(inside)))
            .ok_or(ReadError::NotFound),
        Err(_) => match read_text(path) {
            Err(ReadError::NotFound) => text(path).ok_or(ReadError::NotFound),
            read => read,
        },
    }
}

/// A file being written under a temporary name; [`Output::finish`] gives it its own. Dropped unfinished, it leaves nothing.
pub struct Output {
    file: io::BufWriter<tempfile::NamedTempFile>,
    path: std::path::PathBuf,
}

impl Output {
    /// Begins to write the file at `path`, whose folder must exist.
    pub fn create(path: &Path) -> io::Result<Output> {
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        Ok(Output {
            file: io::BufWriter::new(tempfile::NamedTempFile::new_in(folder)?),
            path: path.to_owned(),
        })
    }

    /// Gives the complete file its name.
    pub fn finish(self) -> io::Result<()> {
        let file = self.file.into_inner().map_err(io::IntoInnerError::into_error)?;
        #[cfg(unix)]
        {
            // Temporary files are private; an output is as readable as any file its user makes.
            use std::os::unix::fs::PermissionsExt;
            file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))?;
        }
        file.persist(&self.path).map_err(|error| error.error)?;
        Ok(())
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
