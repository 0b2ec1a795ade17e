//! Output files: written under a temporary name, renamed when complete, never over a file of another program.
//!
//! ```text
//! create: lock folder -> remove leftovers -> refuse foreign file -> temporary file, locked for the life of the process
//! finish: lock folder -> rename over the target -> record size and time of the result -> unlock
//! ```
//!
//! The record [`RECORD`] in each folder lists the files that the program wrote there, each with its size and its time
//! of change. A file is the program's own if both still match. A temporary file is locked while its process lives. So a
//! second writer of the same file detects the first one, and the leftovers of dead processes are removed.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The name of the record of the files that the program wrote in a folder.
const RECORD: &str = ".logicity.json";

/// The middle of the names of temporary files: `.NAME.logicity-PID-SECONDS`.
const TEMPORARY: &str = ".logicity-";

/// The maximum length of a chain of symbolic links, as in Linux.
const LINKS_MAX: usize = 40;

/// How long to wait for another process that holds the lock of a folder, in steps of [`LOCK_STEP`].
const LOCK_TRIES: u32 = 250;
const LOCK_STEP: Duration = Duration::from_millis(20);

/// Which existing files an [`Output`] may replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// Only files that the program wrote and that have not changed since.
    Own,
    /// Any regular file.
    Any,
}

/// A file that is written under a temporary name. [`Output::finish`] renames it; dropping it earlier removes it.
///
/// A symbolic link is followed. An existing file keeps its permissions and, if the system allows, its owner.
pub struct Output {
    file: io::BufWriter<File>,
    temporary: PathBuf,
    target: PathBuf,
    overwrite: Overwrite,
    /// Whether to record the result as the program's own.
    recorded: bool,
}

/// The record of a folder.
#[derive(Default, Serialize, Deserialize)]
struct Record {
    /// The files that the program wrote, by name.
    written: BTreeMap<String, Stamp>,
}

/// Identifies the content of a file without reading it.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    bytes: u64,
    /// The time of change in nanoseconds since 1970.
    changed: u64,
}

impl Output {
    /// Begins to write the file at `path`, whose folder must exist.
    ///
    /// # Errors
    /// Errors of the system; `InvalidInput` if `path` exists and is not a regular file; `AlreadyExists` if `overwrite`
    /// does not permit replacing the existing file; `ResourceBusy` if another process writes the same file.
    pub fn create(path: &Path, overwrite: Overwrite) -> io::Result<Output> {
        Output::begin(path, overwrite, true)
    }

    /// Begins to edit a file of the user in place. Replaces any regular file, and leaves no record.
    ///
    /// # Errors
    /// As [`Output::create`].
    pub fn edit(path: &Path) -> io::Result<Output> {
        Output::begin(path, Overwrite::Any, false)
    }

    fn begin(path: &Path, overwrite: Overwrite, recorded: bool) -> io::Result<Output> {
        let target = follow_links(path)?;
        let folder = folder_of(&target);
        if !folder.is_dir() {
            let message = format!("there is no folder `{}`", folder.display());
            return Err(io::Error::new(io::ErrorKind::NotFound, message));
        }
        let name = name_of(&target)?;
        let _lock = lock(folder)?;
        remove_leftovers(folder, &name)?;
        if recorded {
            // Only a regular file can be replaced by the record.
            self::existing(&folder.join(RECORD))?;
        }
        let existing = existing(&target)?;
        check_own(folder, &name, existing.as_ref(), overwrite)?;
        if existing.is_some() {
            // A file that the user protected against writing.
            OpenOptions::new().write(true).open(&target)?;
        }
        let seconds = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |time| time.as_secs());
        let temporary = folder.join(format!(".{}{TEMPORARY}{}-{seconds}", short(&name), std::process::id()));
        let file = create_temporary(&temporary, existing.as_ref())?;
        match file.try_lock() {
            Ok(()) | Err(TryLockError::Error(_)) => {}
            Err(TryLockError::WouldBlock) => return Err(io::ErrorKind::ResourceBusy.into()),
        }
        Ok(Output {
            file: io::BufWriter::new(file),
            temporary,
            target,
            overwrite,
            recorded,
        })
    }

    /// Checks that [`Output::create`] would succeed. Commands that write much later call it before their work.
    ///
    /// # Errors
    /// As [`Output::create`].
    pub fn check(path: &Path, overwrite: Overwrite) -> io::Result<()> {
        Output::create(path, overwrite).map(drop)
    }

    /// Returns whether a file has a name of temporary files.
    pub fn is_temporary(path: &Path) -> bool {
        let name = path.file_name().and_then(OsStr::to_str);
        name.and_then(temporary_of).is_some()
    }

    /// Returns the path of the temporary file, for a writer that needs a path.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// Renames the complete file to its path.
    ///
    /// # Errors
    /// Errors of the system; then an existing file at that path is unchanged, unless only the record could not be
    /// written. `AlreadyExists` if another program made the file in the meantime; then the result is kept under another
    /// name, which the message contains.
    pub fn finish(mut self) -> io::Result<()> {
        self.file.flush()?;
        let folder = folder_of(&self.target);
        let name = name_of(&self.target)?;
        let _lock = lock(folder)?;
        let existing = existing(&self.target)?;
        if let Err(error) = check_own(folder, &name, existing.as_ref(), self.overwrite) {
            let free = (1..).map(|number| folder.join(format!("{name}.{number}")));
            let free = free.into_iter().find(|path| fs::symlink_metadata(path).is_err());
            let free = free.expect("finitely many names are taken");
            fs::rename(&self.temporary, &free)?;
            let message = format!("{error}; the result is in `{}`", free.display());
            return Err(io::Error::new(error.kind(), message));
        }
        fs::rename(&self.temporary, &self.target)?;
        if self.recorded {
            record(folder, &name, &fs::metadata(&self.target)?)?;
        }
        Ok(())
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        // After `finish` the file no longer has this name.
        let _ = fs::remove_file(&self.temporary);
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

/// Returns the file that a path of symbolic links leads to. That file need not exist.
fn follow_links(path: &Path) -> io::Result<PathBuf> {
    let mut target = path.to_owned();
    for _ in 0..LINKS_MAX {
        match fs::read_link(&target) {
            Ok(next) => target = folder_of(&target).join(next),
            Err(_) => return Ok(target),
        }
    }
    Err(io::Error::new(
        io::ErrorKind::InvalidInput,
        "too many levels of symbolic links",
    ))
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn name_of(path: &Path) -> io::Result<String> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    name.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "it is not the name of a file"))
}

/// Returns the metadata of a file, if it exists. Fails for anything but a regular file.
fn existing(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match fs::metadata(path) {
        Ok(found) if found.is_file() => Ok(Some(found)),
        Ok(_) => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// Locks a folder until the result is dropped. Returns `None` where the file system has no locks, as on some network
/// file systems: then two processes that begin at the same instant do not detect each other.
fn lock(folder: &Path) -> io::Result<Option<File>> {
    // Only Unix opens folders.
    let Ok(handle) = File::open(folder) else {
        return Ok(None);
    };
    for _ in 0..LOCK_TRIES {
        match handle.try_lock() {
            Ok(()) => return Ok(Some(handle)),
            Err(TryLockError::WouldBlock) => thread::sleep(LOCK_STEP),
            Err(TryLockError::Error(_)) => return Ok(None),
        }
    }
    Err(io::Error::new(
        io::ErrorKind::ResourceBusy,
        format!("another process has locked the folder `{}`", folder.display()),
    ))
}

/// Removes the temporary files of dead processes. Fails if another process writes the file `name`.
fn remove_leftovers(folder: &Path, name: &str) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let Some((of, process, seconds)) = path.file_name().and_then(|name| temporary_of(name.to_str()?)) else {
            continue;
        };
        if !fs::symlink_metadata(&path).is_ok_and(|found| found.is_file()) {
            continue;
        }
        match File::open(&path).map(|file| file.try_lock()) {
            Ok(Ok(())) => drop(fs::remove_file(&path)),
            Ok(Err(TryLockError::WouldBlock)) if of == short(name) => {
                let who = match process == std::process::id() {
                    true => "this process already writes it".to_owned(),
                    false => format!("process {process} has been writing it since {} UTC", date(seconds)),
                };
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, who));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns a name that is short enough to be a part of another one.
fn short(name: &str) -> String {
    const MOST: usize = 80;
    if name.len() <= MOST {
        return name.to_owned();
    }
    let hash = format!("{:x}", Sha256::digest(name));
    let end = (0..=MOST).rev().find(|&at| name.is_char_boundary(at)).unwrap_or(0);
    format!("{}{}", &name[..end], &hash[..16])
}

/// Splits the name of a temporary file into the name of its target, the process, and the seconds since 1970.
fn temporary_of(name: &str) -> Option<(&str, u32, u64)> {
    let (of, writer) = name.strip_prefix('.')?.rsplit_once(TEMPORARY)?;
    let (process, seconds) = writer.split_once('-')?;
    Some((of, process.parse().ok()?, seconds.parse().ok()?))
}

fn create_temporary(path: &Path, existing: Option<&fs::Metadata>) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if let Some(existing) = existing {
        use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
        // Private until the owner is right.
        let file = options.mode(0o600).open(path)?;
        let own = file.metadata()?;
        if (own.uid(), own.gid()) != (existing.uid(), existing.gid()) {
            // Only root may give files away; then the file belongs to the user who runs the program.
            let _ = std::os::unix::fs::fchown(&file, Some(existing.uid()), Some(existing.gid()));
        }
        file.set_permissions(existing.permissions())?;
        return Ok(file);
    }
    let _ = existing;
    options.open(path)
}

/// Fails if an existing file is not the program's own and must not be replaced.
fn check_own(folder: &Path, name: &str, existing: Option<&fs::Metadata>, overwrite: Overwrite) -> io::Result<()> {
    let Some(existing) = existing else { return Ok(()) };
    if overwrite == Overwrite::Any || read_record(folder)?.written.get(name) == Some(&stamp(existing)) {
        return Ok(());
    }
    Err(io::Error::new(
        io::ErrorKind::AlreadyExists,
        "the file exists, and logicity did not write it or it has changed since",
    ))
}

fn stamp(found: &fs::Metadata) -> Stamp {
    let changed = found
        .modified()
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    Stamp {
        bytes: found.len(),
        changed: changed.map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)),
    }
}

/// Reads the record of a folder. A file of that name with other content lists no files.
fn read_record(folder: &Path) -> io::Result<Record> {
    let path = folder.join(RECORD);
    match existing(&path)? {
        None => Ok(Record::default()),
        Some(_) => Ok(serde_json::from_slice(&fs::read(path)?).unwrap_or_default()),
    }
}

/// Records a file as the program's own. The caller holds the lock of the folder.
fn record(folder: &Path, name: &str, written: &fs::Metadata) -> io::Result<()> {
    let mut record = read_record(folder)?;
    record.written.insert(name.to_owned(), stamp(written));
    record.written.retain(|name, _| folder.join(name).is_file());
    let text = serde_json::to_string(&record).expect("names and numbers") + "\n";
    let temporary = folder.join(format!("{RECORD}{TEMPORARY}{}-0", std::process::id()));
    // Never write through a link of that name.
    let _ = fs::remove_file(&temporary);
    let mut file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
    file.write_all(text.as_bytes())?;
    fs::rename(&temporary, folder.join(RECORD))
}

/// Formats a time in seconds since 1970 as `YYYY-MM-DD HH:MM:SS`.
fn date(seconds: u64) -> String {
    let (mut days, rest) = (seconds / 86_400, seconds % 86_400);
    let is_leap = |year: u64| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let mut year = 1970;
    // The bound keeps a forged name from taking long.
    while year < 9999 && days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let mut month = 1;
    for length in [
        31,
        28 + u64::from(is_leap(year)),
        31,
        30,
        31,
        30,
        31,
        31,
        30,
        31,
        30,
        31,
    ] {
        if days < length || month == 12 {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year}-{month:02}-{:02} {hour:02}:{minute:02}:{second:02}", days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::read_text;

    fn write(path: &Path, text: &str, overwrite: Overwrite) -> io::Result<()> {
        let mut output = Output::create(path, overwrite)?;
        output.write_all(text.as_bytes())?;
        output.finish()
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("it is there");
        let mut names: Vec<String> = (entries.map(|entry| entry.expect("readable").file_name()))
            .map(|name| name.into_string().expect("UTF-8"))
            .collect();
        names.sort();
        names
    }

    #[test]
    fn only_own_files_are_replaced() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        for text in ["first", "second"] {
            write(&path, text, Overwrite::Own).expect("it is new, or its own");
            assert_eq!(read_text(&path).as_deref(), Ok(text));
        }
        drop(Output::create(&path, Overwrite::Own).expect("its own"));
        assert_eq!(names(folder.path()), [RECORD, "out"], "no temporary file remains");

        fs::write(&path, "edited").expect("writable");
        let refused = write(&path, "third", Overwrite::Own).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::AlreadyExists));
        assert_eq!(read_text(&path).as_deref(), Ok("edited"));
        write(&path, "third", Overwrite::Any).expect("any file may be replaced");
        write(&path, "fourth", Overwrite::Own).expect("its own again");

        let refused = Output::check(folder.path(), Overwrite::Any).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::InvalidInput), "a folder");
    }

    #[test]
    fn a_file_made_in_the_meantime_is_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        let mut output = Output::create(&path, Overwrite::Own).expect("new");
        output.write_all(b"result").expect("room");
        fs::write(&path, "foreign").expect("writable");
        let message = output.finish().expect_err("it is foreign").to_string();
        assert!(message.contains("out.1"), "{message}");
        assert_eq!(read_text(&path).as_deref(), Ok("foreign"));
        assert_eq!(read_text(&folder.path().join("out.1")).as_deref(), Ok("result"));
    }

    #[test]
    fn a_second_writer_learns_of_the_first() {
        let folder = tempfile::tempdir().expect("a folder");
        let long = "n".repeat(255);
        for name in ["out", &long] {
            let path = folder.path().join(name);
            let first = Output::create(&path, Overwrite::Own).expect("new");
            let error = Output::create(&path, Overwrite::Own).err().expect("busy");
            assert_eq!(error.kind(), io::ErrorKind::ResourceBusy);
            assert!(error.to_string().contains("this process already writes it"), "{error}");
            // Another file is free.
            write(&folder.path().join("other"), "", Overwrite::Own).expect("new, or its own");
            drop(first);
            write(&path, "", Overwrite::Own).expect("free again");
        }
    }

    #[test]
    fn leftovers_of_dead_processes_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let kept = [".out.logicity-1-x", ".out.logicity", "out.logicity-1-2", ".out.tmp"];
        for name in [".out.logicity-1-2", ".else.logicity-4294967295-18446744073709551615"]
            .iter()
            .chain(&kept)
        {
            fs::write(folder.path().join(name), "left").expect("writable");
        }
        write(&folder.path().join("out"), "", Overwrite::Own).expect("new");
        let mut expected = [&kept[..], &[RECORD, "out"]].concat();
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_permissions_kept() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().expect("a folder");
        let inner = folder.path().join("inner");
        fs::create_dir(&inner).expect("new");
        let (link, file) = (folder.path().join("link"), inner.join("file"));
        symlink("inner/file", &link).expect("new");
        // A link to a file that does not exist yet.
        write(&link, "first", Overwrite::Own).expect("new");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).expect("own");
        let mut output = Output::edit(&link).expect("any");
        output.write_all(b"second").expect("room");
        output.finish().expect("renamed");
        assert!(fs::symlink_metadata(&link).expect("there").is_symlink());
        assert_eq!(read_text(&file).as_deref(), Ok("second"));
        assert_eq!(fs::metadata(&file).expect("there").permissions().mode() & 0o777, 0o640);

        symlink("round", folder.path().join("round")).expect("new");
        let refused = Output::check(&folder.path().join("round"), Overwrite::Any);
        assert!(refused.expect_err("a loop").to_string().contains("symbolic links"));
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        let known = [
            (0, "1970-01-01 00:00:00"),
            (951_782_400, "2000-02-29 00:00:00"),
            (1_709_251_199, "2024-02-29 23:59:59"),
            (1_735_689_599, "2024-12-31 23:59:59"),
            (4_107_542_400, "2100-03-01 00:00:00"),
        ];
        for (seconds, text) in known {
            assert_eq!(date(seconds), text);
        }
        assert!(date(u64::MAX).starts_with("9999-12-"));
    }
}
