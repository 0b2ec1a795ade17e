//! File input and output. Apart from the command line, no other module of the library accesses files.
//!
//! A text is read as a whole, is bounded in size, and must be UTF-8. [`Output`] writes files atomically and protects
//! those that the program did not write.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

#[cfg(feature = "parquet")]
mod folder;
#[cfg(feature = "parquet")]
mod footer;
mod journal;
mod output;
mod record;

#[cfg(feature = "parquet")]
pub use folder::{FileError, Folder, make_folder};
#[cfg(feature = "parquet")]
pub use footer::check_flat;
pub use journal::Journal;
pub use logicity_datalog::files::{BUILTIN_FOLDER, ReadError, ReadFile, builtin_path, normalize, slash_help, to_text};
pub use output::{Output, Overwrite, end, remove_own, without_temporaries};

/// The maximum size of an input file that is read as a whole: 1 GiB. [`limit_reads`] can lower it.
pub const MAX_BYTES: u64 = 1 << 30;

/// The maximum size that applies now.
static LIMIT: AtomicU64 = AtomicU64::new(MAX_BYTES);

/// Sets the maximum size of the files that this process reads as a whole, at most [`MAX_BYTES`]. Nothing notices in time
/// that a file of any size takes too much memory.
pub fn limit_reads(bytes: u64) {
    LIMIT.store(bytes.min(MAX_BYTES), Ordering::Relaxed);
}

/// Returns the maximum size of the files that this process reads as a whole.
pub fn read_limit() -> u64 {
    LIMIT.load(Ordering::Relaxed)
}

/// Reads a text file, which must be a regular file.
///
/// # Errors
/// Why the file cannot be read.
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    to_text(read_whole(open_regular(path)?)?)
}

/// Reads a file of bytes, which must be a regular file.
///
/// # Errors
/// Why the file cannot be read.
pub fn read_file(path: &Path) -> Result<Vec<u8>, ReadError> {
    read_whole(open_regular(path)?)
}

/// Reads an open file. Refuses one of more than [`read_limit`] before it reads a byte.
///
/// # Errors
/// Why the file cannot be read.
pub fn read_whole(file: std::fs::File) -> Result<Vec<u8>, ReadError> {
    let limit = read_limit();
    match file.metadata() {
        Ok(found) if found.is_file() && found.len() > limit => Err(ReadError::TooLarge(limit)),
        _ => read_bytes(file),
    }
}

/// The maximum number of entries of a folder that [`names_in`] reads.
const NAMES_MAX: usize = 10_000;

/// Returns the names of the entries of a folder, sorted, without hidden ones; none if the folder cannot be read. The
/// empty path is the working directory.
pub fn names_in(folder: &Path) -> Vec<String> {
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().take(NAMES_MAX);
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort_unstable();
    names
}

/// The maximum number of files that help names.
const NAMED_MAX: usize = 8;

/// Returns help for a folder, with these names in it, that stands where a file must: the files of this project's kinds.
pub fn name_a_file(folder: &Path, names: &[String]) -> Option<String> {
    const ENDINGS: [&str; 7] = [".dl", ".yaml", ".yml", ".jsonl", ".jsonl.gz", ".json", ".parquet"];
    let fitting = names
        .iter()
        .filter(|name| ENDINGS.iter().any(|ending| name.ends_with(ending)));
    let paths = fitting.map(|name| format!("`{}`", folder.join(name).display()));
    let first: Vec<String> = paths.take(NAMED_MAX).collect();
    (!first.is_empty()).then(|| format!("name a file in it: {}", first.join(", ")))
}

/// Opens a regular file. Fails at once for a pipe, a device or a folder.
///
/// # Errors
/// Why the file cannot be read.
pub fn open_regular(path: &Path) -> Result<std::fs::File, ReadError> {
    let found = std::fs::metadata(path).map_err(|error| unreadable(path, &error))?;
    match found.is_file() || found.is_dir() {
        true => open(path),
        false => Err(ReadError::Io("it is a pipe or a device, not a regular file".into())),
    }
}

/// The error of Windows for a file that another process has opened and does not share.
#[cfg(windows)]
const ERROR_SHARING_VIOLATION: i32 = 32;

/// The folders of the files that the kernel generates. They claim to be regular, but reading one may never end
/// (`/proc/kmsg`) or change the system.
const KERNEL_FOLDERS: [&str; 2] = ["/proc", "/sys"];

/// Fails for a file that the kernel generates, also through links.
fn refuse_generated(path: &Path) -> io::Result<()> {
    // An open descriptor of a pipe, such as `/dev/stdin`, leads to no path.
    let is_generated = |real: PathBuf| KERNEL_FOLDERS.iter().any(|folder| real.starts_with(folder));
    match path.canonicalize().is_ok_and(is_generated) {
        true => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "the system generates its content, which may never end; copy it to a regular file",
        )),
        false => Ok(()),
    }
}

fn unreadable(path: &Path, error: &io::Error) -> ReadError {
    match (error.kind(), std::fs::read_link(path)) {
        (io::ErrorKind::NotFound, Ok(target)) => ReadError::Io(format!(
            "it is a symbolic link to `{}`, which does not exist",
            target.display()
        )),
        (io::ErrorKind::NotFound, Err(_)) => ReadError::NotFound,
        _ => ReadError::Io(error.to_string()),
    }
}

/// Opens a file that the user named, as [`check_readable`] permits. Waits for the writer of a pipe.
///
/// # Errors
/// Why the file cannot be read.
pub fn open(path: &Path) -> Result<std::fs::File, ReadError> {
    check_readable(path)?;
    std::fs::File::open(path).map_err(|error| unreadable(path, &error))
}

/// Checks without opening it that a file can be read: a regular file, a pipe, `/dev/null`, or an open descriptor such as
/// `/dev/stdin`, but no folder, no other device and no file below `/proc` or `/sys`.
///
/// # Errors
/// Why the file cannot be read.
pub fn check_readable(path: &Path) -> Result<(), ReadError> {
    let found = std::fs::metadata(path).map_err(|error| unreadable(path, &error))?;
    if found.is_dir() {
        return Err(ReadError::Folder);
    }
    let is_empty = path == Path::new("/dev/null");
    if !found.is_file() && !is_pipe(&found) && !is_empty && descriptor(path).is_none() {
        return Err(ReadError::Io("it is a device, not a file".into()));
    }
    match found.is_file() {
        true => refuse_generated(path).map_err(|error| ReadError::Io(error.to_string())),
        false => Ok(()),
    }
}

#[cfg(unix)]
fn is_pipe(found: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt;
    found.file_type().is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: &std::fs::Metadata) -> bool {
    false
}

/// Returns the path without links of a file that need not exist.
///
/// # Errors
/// Errors of the system; `InvalidInput` for `..` below something that does not exist, and for a loop of links.
pub fn real_path(path: &Path) -> io::Result<PathBuf> {
    let mut existing = path.to_owned();
    let mut missing = Vec::new();
    // Each step follows a link or removes a component.
    for _ in 0..LINKS_MAX + path.components().count() {
        let begin = if existing.as_os_str().is_empty() {
            Path::new(".")
        } else {
            &existing
        };
        match begin.canonicalize() {
            Ok(real) => return Ok(missing.iter().rev().fold(real, |path, name| path.join(name))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        match std::fs::read_link(&existing) {
            Ok(target) => existing = folder_of(&existing).join(target),
            Err(_) => {
                let Some(name) = existing.file_name().map(ToOwned::to_owned) else {
                    break;
                };
                missing.push(name);
                existing.pop();
            }
        }
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, "it leads nowhere"))
}

/// The maximum length of a chain of symbolic links, as in Linux.
const LINKS_MAX: usize = 40;

/// Returns the number of the open descriptor that a path names, also through links: 1 for `/dev/stdout`.
fn descriptor(path: &Path) -> Option<String> {
    let mut target = path.to_owned();
    for _ in 0..LINKS_MAX {
        let folder = folder_of(&target);
        if ["/dev/fd", "/proc/self/fd"]
            .iter()
            .any(|known| folder == Path::new(known))
        {
            return target.file_name()?.to_str().map(str::to_owned);
        }
        target = folder.join(std::fs::read_link(&target).ok()?);
    }
    None
}

/// Returns whether a path leads to standard output, for example `/dev/stdout`.
pub fn is_stdout(path: &Path) -> bool {
    descriptor(path).is_some_and(|number| number == "1")
}

/// Returns the folder that contains a path; `.` for a name alone.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Identifies a regular file, whatever path leads to it: device and inode, or the path without links.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileId(#[cfg(unix)] (u64, u64), #[cfg(not(unix))] PathBuf);

impl FileId {
    /// Returns the identity of an existing regular file.
    pub fn of(path: &Path) -> Option<FileId> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            let found = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
            Some(FileId((found.dev(), found.ino())))
        }
        #[cfg(not(unix))]
        path.canonicalize().ok().filter(|path| path.is_file()).map(FileId)
    }
}

/// Returns whether two paths lead to one file, which need not exist.
pub fn is_same_file(one: &Path, other: &Path) -> bool {
    match (FileId::of(one), FileId::of(other)) {
        (None, None) => matches!((real_path(one), real_path(other)), (Ok(one), Ok(other)) if one == other),
        (one, other) => one == other,
    }
}

/// Reads all input as text.
///
/// # Errors
/// Why the input cannot be read.
pub fn read_from(input: impl Read) -> Result<String, ReadError> {
    to_text(read_bytes(input)?)
}

/// Reads all input.
///
/// # Errors
/// Why the input cannot be read.
pub fn read_bytes(input: impl Read) -> Result<Vec<u8>, ReadError> {
    let fail = |error: std::io::Error| ReadError::Io(error.to_string());
    let (mut bytes, limit) = (Vec::new(), read_limit());
    input.take(limit + 1).read_to_end(&mut bytes).map_err(fail)?;
    match bytes.len() as u64 > limit {
        true => Err(ReadError::TooLarge(limit)),
        false => Ok(bytes),
    }
}

/// A path and the bytes of its file.
pub type NamedBytes = (String, Vec<u8>);

/// Reads the files in the subfolders of a folder, sorted by path, each with its path `FOLDER/NAME`. Skips files outside
/// of subfolders and names that begin with a dot.
///
/// # Errors
/// The path that cannot be read and the reason: too many files, or an error of the system.
pub fn read_folders(path: &Path, files_max: usize, bytes_max: u64) -> Result<Vec<NamedBytes>, (PathBuf, ReadError)> {
    let mut found = Vec::new();
    for folder in listed(path)?.into_iter().filter(|path| path.is_dir()) {
        for file in listed(&folder)? {
            let fail = |error: ReadError| (file.clone(), error);
            if found.len() == files_max {
                return Err(fail(ReadError::Io(format!("more than {files_max} files"))));
            }
            let handle = open_regular(&file).map_err(fail)?;
            // Read one byte more, so that the caller can detect that the file is too large.
            let bytes = read_bytes(handle.take(bytes_max + 1)).map_err(fail)?;
            let inside = file.strip_prefix(path).ok().and_then(Path::to_str);
            let name = inside.ok_or_else(|| fail(ReadError::Io("its name is not UTF-8".into())))?;
            found.push((name.replace(std::path::MAIN_SEPARATOR, "/"), bytes));
        }
    }
    Ok(found)
}

/// Returns the sorted contents of a folder, without names that begin with a dot.
fn listed(path: &Path) -> Result<Vec<PathBuf>, (PathBuf, ReadError)> {
    let fail = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => (path.to_owned(), ReadError::Io("no such folder".into())),
        io::ErrorKind::NotADirectory => (path.to_owned(), ReadError::Io("it is not a folder".into())),
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

/// Returns the name of a file without folders, for outputs that must not contain paths of this machine. A built-in file
/// keeps its path. Control characters, quotes and backslashes become `_`.
pub fn portable_name(path: &str) -> String {
    let name = match Path::new(path).starts_with(BUILTIN_FOLDER) {
        true => path,
        false => path.rsplit(std::path::is_separator).next().unwrap_or_default(),
    };
    name.replace(|c: char| c.is_control() || "\"\\".contains(c), "_")
}
