//! Output files: written under a temporary name, renamed when complete, never over a file of another program.
//!
//! ```text
//! create: lock folder -> remove leftovers -> refuse foreign file -> temporary file, locked for the life of the process
//! finish: lock folder -> rename over the target -> record the result as own -> unlock
//! ```
//!
//! A temporary file is locked, on Windows open, while its process lives. So a second writer of the same file detects the
//! first one, and the leftovers of dead processes are removed. Standard output, other open descriptors and character
//! devices are written directly.

#[cfg(windows)]
use crate::files::ERROR_SHARING_VIOLATION;
#[cfg(windows)]
use crate::files::record::RECORD;
use crate::files::record::{Record, TEMPORARY, existing};
use crate::files::{LINKS_MAX, descriptor, folder_of, record};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The time to wait for another process that holds the lock of a folder, in steps of [`LOCK_STEP`].
const LOCK_TRIES: u32 = 250;
const LOCK_STEP: Duration = Duration::from_millis(20);

/// The existing files that an [`Output`] may replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// Only files that the same command wrote and that have not changed since.
    Own,
    /// Any regular file.
    Any,
}

/// A file that is written under a temporary name. [`Output::finish`] renames it; dropping it earlier removes it.
///
/// A symbolic link is followed. An existing file keeps its permissions and, if the system allows, its owner. A stream
/// ([`Output::stdout`], a character device, an open descriptor such as `/dev/stderr`) has no temporary file and no
/// record.
pub struct Output {
    writer: io::BufWriter<Box<dyn Write + Send>>,
    /// The path to write to: that of the temporary file, or of the stream.
    path: PathBuf,
    is_terminal: bool,
    /// The replacement of the target when the file is complete; `None` for a stream.
    replacement: Option<Replacement>,
}

/// The replacement of the output by a complete temporary file.
struct Replacement {
    target: PathBuf,
    overwrite: Overwrite,
    /// The command to record as the writer of the result, if it is to be recorded.
    by: Option<String>,
    temporary: Temporary,
}

/// One of several outputs that failed: its position among them, and the error.
pub type Failed = (usize, io::Error);

impl Output {
    /// Begins to write the file at `path`, whose folder must exist, or the stream with this path. `by` is the command
    /// that writes, for example `run`.
    ///
    /// # Errors
    /// Errors of the system; `InvalidInput` if `path` exists and is neither a regular file nor a stream, or has a
    /// reserved name; `AlreadyExists` if `overwrite` does not permit replacing the existing file; `ResourceBusy` if
    /// another process writes the same file.
    pub fn create(path: &Path, by: &str, overwrite: Overwrite) -> io::Result<Output> {
        only(Output::create_all(&[path], by, overwrite))
    }

    /// Begins to write several files, as [`Output::create`] does for one. Reads each folder and its record only once.
    ///
    /// # Errors
    /// As [`Output::create`]; then no output has begun.
    pub fn create_all(paths: &[&Path], by: &str, overwrite: Overwrite) -> Result<Vec<Output>, Failed> {
        let mut outputs: Vec<Option<Output>> = Vec::new();
        for (position, path) in paths.iter().enumerate() {
            let stream = stream(path).map_err(|error| (position, error))?;
            outputs.push(stream.map(|stream| Output::streaming(stream, path)));
        }
        let files = (0..paths.len()).filter(|&position| outputs[position].is_none());
        let files: Vec<(usize, &Path)> = files.map(|position| (position, paths[position])).collect();
        for (position, output) in Output::begin(&files, overwrite, Some(by))? {
            outputs[position] = Some(output);
        }
        Ok(outputs.into_iter().flatten().collect())
    }

    /// Returns an output that writes to standard output.
    pub fn stdout() -> Output {
        let stdout = io::stdout();
        let is_terminal = stdout.is_terminal();
        Output::streaming((Box::new(stdout), is_terminal), Path::new("/dev/stdout"))
    }

    fn streaming((writer, is_terminal): Stream, path: &Path) -> Output {
        Output {
            writer: io::BufWriter::new(writer),
            path: path.to_owned(),
            is_terminal,
            replacement: None,
        }
    }

    /// Replaces the writer of an output to which nothing is written yet. `wrap` also receives whether it is a terminal.
    pub fn through(self, wrap: impl FnOnce(Box<dyn Write + Send>, bool) -> Box<dyn Write + Send>) -> Output {
        let mut output = self;
        let writer = std::mem::replace(&mut output.writer, io::BufWriter::new(Box::new(io::sink())));
        let (inner, _) = writer.into_parts();
        output.writer = io::BufWriter::new(wrap(inner, output.is_terminal));
        output
    }

    /// Begins to edit a file of the user in place. Replaces any regular file, and leaves no record.
    ///
    /// # Errors
    /// As [`Output::create`].
    pub fn edit(path: &Path) -> io::Result<Output> {
        let begun = Output::begin(&[(0, path)], Overwrite::Any, None);
        only(begun.map(|begun| begun.into_iter().map(|(_, output)| output).collect()))
    }

    /// Begins to write files, each with its position, folder by folder.
    fn begin(files: &[(usize, &Path)], overwrite: Overwrite, by: Option<&str>) -> Result<Vec<(usize, Output)>, Failed> {
        let targets = (files.iter()).map(|&(position, path)| match follow_links(path) {
            Ok(target) => Ok((target, position)),
            Err(error) => Err((position, error)),
        });
        let mut begun = Vec::new();
        for (folder, targets) in by_folder(targets.collect::<Result<_, _>>()?) {
            let failed = |error| (targets[0].1, error);
            if !folder.is_dir() {
                let message = format!("there is no folder `{}`", folder.display());
                return Err(failed(io::Error::new(io::ErrorKind::NotFound, message)));
            }
            let _lock = lock(&folder).map_err(failed)?;
            let busy = remove_leftovers(&folder).map_err(failed)?;
            // Only a regular file can be replaced by the record.
            let record = by.map(|_| Record::read(&folder)).transpose().map_err(failed)?;
            for (target, position) in targets {
                let replacing = Replacing { overwrite, by };
                let output = Output::begin_one(target, &busy, record.as_ref(), replacing);
                begun.push((position, output.map_err(|error| (position, error))?));
            }
        }
        Ok(begun)
    }

    /// Begins to write a file in a folder that is locked. `busy` describes the files that are being written.
    fn begin_one(
        target: PathBuf,
        busy: &BTreeMap<String, String>,
        record: Option<&Record>,
        replacing: Replacing<'_>,
    ) -> io::Result<Output> {
        let name = name_of(&target)?;
        if record::is_reserved(&name) || temporary_of(&name).is_some() {
            let message = "logicity uses names like this one for its own records";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
        }
        if let Some(who) = busy.get(&short(&name)) {
            return Err(io::Error::new(io::ErrorKind::ResourceBusy, who.clone()));
        }
        let existing = existing(&target)?;
        replacing.check(record, &name, existing.as_ref())?;
        if existing.is_some() {
            // A file that the user protected against writing.
            OpenOptions::new().write(true).open(&target)?;
        }
        let temporary = Temporary::create(folder_of(&target), &name, existing.as_ref())?;
        Ok(Output {
            writer: io::BufWriter::new(Box::new(temporary.file.try_clone()?)),
            path: temporary.path.clone(),
            is_terminal: false,
            replacement: Some(Replacement {
                target,
                overwrite: replacing.overwrite,
                by: replacing.by.map(str::to_owned),
                temporary,
            }),
        })
    }

    /// Returns whether a file has a name of temporary files.
    pub fn is_temporary(path: &Path) -> bool {
        let name = path.file_name().and_then(OsStr::to_str);
        name.and_then(temporary_of).is_some()
    }

    /// Returns the path of the temporary file or of the stream, for a writer that needs a path.
    pub fn temporary(&self) -> &Path {
        &self.path
    }

    /// Renames the complete file to its path. Flushes a stream.
    ///
    /// # Errors
    /// Errors of the system; then an existing file at that path is unchanged, unless only the record could not be
    /// written. `AlreadyExists` if another program made the file in the meantime; then the result is kept under another
    /// name, which the message contains.
    pub fn finish(self) -> io::Result<()> {
        Output::finish_all(vec![self]).map_err(|(_, error)| error)
    }

    /// Completes several files, as [`Output::finish`] does one. Writes the record of each folder only once.
    ///
    /// # Errors
    /// As [`Output::finish`]. The outputs before the one that failed in the same folder are complete.
    pub fn finish_all(outputs: Vec<Output>) -> Result<(), Failed> {
        let mut complete = Vec::new();
        for (position, mut output) in outputs.into_iter().enumerate() {
            output.writer.flush().map_err(|error| (position, error))?;
            let replacement = output.replacement.take();
            complete.extend(replacement.map(|file| (file.target.clone(), (position, file))));
        }
        for (folder, files) in by_folder(complete) {
            let failed = |error| (files[0].1.0, error);
            let _lock = lock(&folder).map_err(failed)?;
            let is_recorded = files.iter().any(|(_, (_, file))| file.by.is_some());
            let mut record = is_recorded.then(|| Record::read(&folder)).transpose().map_err(failed)?;
            let replaced = (files.iter()).try_for_each(|(_, (position, file))| {
                file.replace(record.as_mut()).map_err(|error| (*position, error))
            });
            let recorded = record.map_or(Ok(()), |record| record.write(&folder)).map_err(failed);
            replaced.and(recorded)?;
        }
        Ok(())
    }
}

/// Removes those of these files that the command `by` wrote and that have not changed since. Other files stay.
///
/// # Errors
/// Errors of the system; `ResourceBusy` if another process writes one of the files.
pub fn remove_own(paths: &[&Path], by: &str) -> Result<(), Failed> {
    let targets = paths.iter().zip(0..).map(|(path, position)| match follow_links(path) {
        Ok(target) => Ok((target, position)),
        Err(error) => Err((position, error)),
    });
    for (folder, targets) in by_folder(targets.collect::<Result<_, _>>()?) {
        let failed = |error| (targets[0].1, error);
        let _lock = lock(&folder).map_err(failed)?;
        let busy = remove_leftovers(&folder).map_err(failed)?;
        let record = Record::read(&folder).map_err(failed)?;
        let removed = targets.iter().try_for_each(|(target, position)| {
            let remove = || {
                let name = name_of(target)?;
                match existing(target)? {
                    Some(found) if record.writer(&name, &found) == Some(by) => {}
                    _ => return Ok(()),
                }
                match busy.get(&short(&name)) {
                    Some(who) => Err(io::Error::new(io::ErrorKind::ResourceBusy, who.clone())),
                    None => fs::remove_file(target),
                }
            };
            remove().map_err(|error| (*position, error))
        });
        // The record of a folder lists no files that are gone.
        let recorded = record.write(&folder).map_err(failed);
        removed.and(recorded)?;
    }
    Ok(())
}

/// Returns the result for the only one of several outputs.
fn only(outputs: Result<Vec<Output>, Failed>) -> io::Result<Output> {
    let outputs = outputs.map_err(|(_, error)| error)?;
    Ok(outputs.into_iter().next().expect("one for each path"))
}

/// Groups files by folder, in their order within each.
fn by_folder<T>(files: Vec<(PathBuf, T)>) -> BTreeMap<PathBuf, Vec<(PathBuf, T)>> {
    let mut folders: BTreeMap<PathBuf, Vec<(PathBuf, T)>> = BTreeMap::new();
    for (path, of) in files {
        folders.entry(folder_of(&path).to_owned()).or_default().push((path, of));
    }
    folders
}

impl Replacement {
    /// Renames the temporary file in a folder that is locked, and adds the result to the record of the folder.
    fn replace(&self, record: Option<&mut Record>) -> io::Result<()> {
        let name = name_of(&self.target)?;
        let existing = existing(&self.target)?;
        let replacing = Replacing {
            overwrite: self.overwrite,
            by: self.by.as_deref(),
        };
        if let Err(error) = replacing.check(record.as_deref(), &name, existing.as_ref()) {
            let folder = folder_of(&self.target);
            let free = (1..).map(|number| folder.join(format!("{name}.{number}")));
            let free = free.into_iter().find(|path| fs::symlink_metadata(path).is_err());
            let free = free.expect("finitely many names are taken");
            fs::rename(&self.temporary.path, &free)?;
            let message = format!("{error}; the result is in `{}`", free.display());
            return Err(io::Error::new(error.kind(), message));
        }
        fs::rename(&self.temporary.path, &self.target)?;
        if let (Some(record), Some(by)) = (record, replacing.by) {
            record.add(&name, &fs::metadata(&self.target)?, by);
        }
        Ok(())
    }
}

/// The temporary files of this process, for [`without_temporaries`].
static TEMPORARIES: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn temporaries() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    TEMPORARIES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ends the process at once, without its temporary files.
pub fn end(code: i32) -> ! {
    without_temporaries(|| std::process::exit(code))
}

/// Removes the temporary files of this process, then calls `then`. No other thread can create one meanwhile.
pub fn without_temporaries<T>(then: impl FnOnce() -> T) -> T {
    let temporaries = temporaries();
    // A process keeps the files of the one from which it was forked.
    let process = |path: &Path| Some(temporary_of(path.file_name()?.to_str()?)?.1);
    for path in temporaries
        .iter()
        .filter(|path| process(path) == Some(std::process::id()))
    {
        let _ = fs::remove_file(path);
    }
    then()
}

/// A temporary file, locked until it is dropped. It is removed then, unless it has been renamed.
struct Temporary {
    path: PathBuf,
    file: File,
}

impl Temporary {
    /// Creates the temporary file of the file `name` in `folder`.
    fn create(folder: &Path, name: &str, existing: Option<&fs::Metadata>) -> io::Result<Temporary> {
        let seconds = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |time| time.as_secs());
        let path = folder.join(format!(".{}{TEMPORARY}{}-{seconds}", short(name), std::process::id()));
        let mut temporaries = temporaries();
        let file = create_temporary(&path, existing)?;
        temporaries.insert(path.clone());
        drop(temporaries);
        let temporary = Temporary { path, file };
        match hold(&temporary.file) {
            Ok(()) | Err(TryLockError::Error(_)) => Ok(temporary),
            Err(TryLockError::WouldBlock) => Err(io::ErrorKind::ResourceBusy.into()),
        }
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
        temporaries().remove(&self.path);
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

/// A writer, and whether it is a terminal.
type Stream = (Box<dyn Write + Send>, bool);

/// Returns the writer of a stream: of an open descriptor or a character device. `None` for any other path.
fn stream(path: &Path) -> io::Result<Option<Stream>> {
    fn opened(stream: impl Write + IsTerminal + Send + 'static) -> Option<Stream> {
        let is_terminal = stream.is_terminal();
        Some((Box::new(stream), is_terminal))
    }
    let number = descriptor(path);
    Ok(match number.as_deref() {
        Some("1") => opened(io::stdout()),
        Some("2") => opened(io::stderr()),
        None if !is_character_device(path) => None,
        _ => opened(OpenOptions::new().write(true).open(path)?),
    })
}

#[cfg(unix)]
fn is_character_device(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    fs::metadata(path).is_ok_and(|found| found.file_type().is_char_device())
}

#[cfg(not(unix))]
fn is_character_device(_: &Path) -> bool {
    false
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

fn name_of(path: &Path) -> io::Result<String> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    name.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "it is not the name of a file"))
}

/// Locks a folder until the result is dropped. Returns `None` where the file system has no locks, as on some network
/// file systems: then two processes that begin at the same instant do not detect each other.
fn lock(folder: &Path) -> io::Result<Option<File>> {
    for _ in 0..LOCK_TRIES {
        match try_lock(folder) {
            Err(TryLockError::WouldBlock) => thread::sleep(LOCK_STEP),
            lock => return Ok(lock.ok()),
        }
    }
    Err(io::Error::new(
        io::ErrorKind::ResourceBusy,
        format!("another process has locked the folder `{}`", folder.display()),
    ))
}

#[cfg(not(windows))]
fn try_lock(folder: &Path) -> Result<File, TryLockError> {
    let handle = File::open(folder).map_err(TryLockError::Error)?;
    handle.try_lock().map(|()| handle)
}

/// Opens a file in the folder that no other process can open meanwhile. The system removes it when it is closed, however
/// the process ends. A folder itself cannot be locked.
#[cfg(windows)]
fn try_lock(folder: &Path) -> Result<File, TryLockError> {
    use std::os::windows::fs::OpenOptionsExt;
    const FILE_FLAG_DELETE_ON_CLOSE: u32 = 0x0400_0000;
    /// Another process is closing the file.
    const ERROR_ACCESS_DENIED: i32 = 5;
    let mut options = OpenOptions::new();
    options.write(true).create(true);
    options.share_mode(0).custom_flags(FILE_FLAG_DELETE_ON_CLOSE);
    (options.open(folder.join(format!("{RECORD}.lock")))).map_err(|error| match error.raw_os_error() {
        Some(ERROR_SHARING_VIOLATION | ERROR_ACCESS_DENIED) => TryLockError::WouldBlock,
        _ => TryLockError::Error(error),
    })
}

/// Marks a temporary file as being written until it is closed. `WouldBlock` if another process writes it.
#[cfg(not(windows))]
fn hold(temporary: &File) -> Result<(), TryLockError> {
    temporary.try_lock()
}

/// An open file is marked already. A lock would keep writers from it that open its path.
#[cfg(windows)]
fn hold(_: &File) -> Result<(), TryLockError> {
    Ok(())
}

/// Returns whether a process writes a temporary file.
#[cfg(not(windows))]
fn is_held(temporary: &Path) -> io::Result<bool> {
    match File::open(temporary)?.try_lock() {
        Ok(()) => Ok(false),
        Err(TryLockError::WouldBlock) => Ok(true),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Returns whether a process has a temporary file open: then no other one can open it for itself alone.
#[cfg(windows)]
fn is_held(temporary: &Path) -> io::Result<bool> {
    use std::os::windows::fs::OpenOptionsExt;
    match OpenOptions::new().read(true).share_mode(0).open(temporary) {
        Ok(_) => Ok(false),
        Err(error) if error.raw_os_error() == Some(ERROR_SHARING_VIOLATION) => Ok(true),
        Err(error) => Err(error),
    }
}

/// Removes the temporary files of dead processes. Returns who writes the other ones, by the [`short`] name of the file.
fn remove_leftovers(folder: &Path) -> io::Result<BTreeMap<String, String>> {
    let mut busy = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let Some((of, process, seconds)) = path.file_name().and_then(|name| temporary_of(name.to_str()?)) else {
            continue;
        };
        if !fs::symlink_metadata(&path).is_ok_and(|found| found.is_file()) {
            continue;
        }
        match is_held(&path) {
            Ok(false) => drop(fs::remove_file(&path)),
            Ok(true) => {
                let who = match process == std::process::id() {
                    true => "this process already writes it".to_owned(),
                    false => format!("process {process} has been writing it since {} UTC", date(seconds)),
                };
                busy.insert(of.to_owned(), who);
            }
            Err(_) => {}
        }
    }
    Ok(busy)
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

/// What an output of the command `by` may replace.
#[derive(Clone, Copy)]
struct Replacing<'a> {
    overwrite: Overwrite,
    by: Option<&'a str>,
}

impl Replacing<'_> {
    /// Fails if an existing file must not be replaced, because the command did not write it.
    fn check(self, record: Option<&Record>, name: &str, existing: Option<&fs::Metadata>) -> io::Result<()> {
        let Some(existing) = existing else { return Ok(()) };
        if self.overwrite == Overwrite::Any {
            return Ok(());
        }
        let message = match record.and_then(|record| record.writer(name, existing)) {
            Some(writer) if Some(writer) == self.by => return Ok(()),
            // The record is a file that others can edit.
            Some(writer) if is_command(writer) => format!("the file exists, and `{writer}` wrote it, another command"),
            _ => "the file exists, and logicity did not write it or it has changed since".to_owned(),
        };
        Err(io::Error::new(io::ErrorKind::AlreadyExists, message))
    }
}

/// Returns whether a text may be the name of a command, such as `vap coco`.
fn is_command(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || " _.-".contains(c);
    !text.is_empty() && text.len() <= 80 && text.chars().all(is_part)
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
    #[cfg(unix)]
    use crate::files::is_stdout;
    use crate::files::read_text;

    fn write(path: &Path, text: &str, overwrite: Overwrite) -> io::Result<()> {
        let mut output = Output::create(path, "test", overwrite)?;
        output.write_all(text.as_bytes())?;
        output.finish()
    }

    fn check(path: &Path, by: &str, overwrite: Overwrite) -> io::Result<()> {
        Output::create(path, by, overwrite).map(drop)
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
        drop(Output::create(&path, "test", Overwrite::Own).expect("its own"));
        assert_eq!(
            names(folder.path()),
            [record::RECORD, "out"],
            "no temporary file remains"
        );

        fs::write(&path, "edited").expect("writable");
        let refused = write(&path, "third", Overwrite::Own).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::AlreadyExists));
        assert_eq!(read_text(&path).as_deref(), Ok("edited"));
        write(&path, "third", Overwrite::Any).expect("any file may be replaced");
        write(&path, "fourth", Overwrite::Own).expect("its own again");

        let refused = check(folder.path(), "test", Overwrite::Any).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::InvalidInput), "a folder");
    }

    /// A lock that keeps others from the temporary file would also stop a writer that needs a path, as in Python.
    #[test]
    fn a_writer_may_open_the_temporary_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        let output = Output::create(&path, "test", Overwrite::Own).expect("it is new");
        fs::write(output.temporary(), "written by path").expect("nothing keeps it from writing");
        let busy = check(&path, "test", Overwrite::Own).map_err(|error| error.kind());
        assert_eq!(busy, Err(io::ErrorKind::ResourceBusy));
        output.finish().expect("complete");
        assert_eq!(read_text(&path).as_deref(), Ok("written by path"));
    }

    #[test]
    fn a_command_replaces_only_what_it_wrote() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        let write_by = |by: &str, overwrite| {
            let mut output = Output::create(&path, by, overwrite)?;
            output.write_all(by.as_bytes())?;
            output.finish()
        };
        write_by("run", Overwrite::Own).expect("new");
        let refused = write_by("query", Overwrite::Own)
            .expect_err("`run` wrote it")
            .to_string();
        assert!(refused.contains("`run` wrote it"), "{refused}");
        assert_eq!(read_text(&path).as_deref(), Ok("run"));
        write_by("query", Overwrite::Any).expect("any file may be replaced");
        write_by("query", Overwrite::Own).expect("its own");
        // A record of another version names no command.
        let record = folder.path().join(record::RECORD);
        let text = read_text(&record).expect("there").replace(r#","by":"query""#, "");
        fs::write(&record, text).expect("writable");
        let refused = write_by("query", Overwrite::Own).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::AlreadyExists));
    }

    #[test]
    fn no_output_has_the_name_of_a_record() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in [
            ".logicity.json",
            ".Logicity.JSON",
            ".logicity.json.logicity-1-0",
            ".x.logicity-1-2",
        ] {
            let refused = write(&folder.path().join(name), "", Overwrite::Any).map_err(|error| error.kind());
            assert_eq!(refused, Err(io::ErrorKind::InvalidInput), "{name}");
        }
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_file_made_in_the_meantime_is_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out");
        let mut output = Output::create(&path, "test", Overwrite::Own).expect("new");
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
            let first = Output::create(&path, "test", Overwrite::Own).expect("new");
            let error = Output::create(&path, "test", Overwrite::Own).err().expect("busy");
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
        let mut expected = [&kept[..], &[record::RECORD, "out"]].concat();
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
    }

    #[cfg(unix)]
    #[test]
    fn streams_have_no_temporary_file_and_no_record() {
        let folder = tempfile::tempdir().expect("a folder");
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/null", &link).expect("new");
        write(&link, "nothing", Overwrite::Own).expect("a character device");
        assert_eq!(names(folder.path()), ["link"]);
        let full = write(Path::new("/dev/full"), "more", Overwrite::Own).expect_err("it is full");
        assert_eq!(full.kind(), io::ErrorKind::StorageFull);
        for (path, number) in [("/dev/stdout", "1"), ("/dev/fd/2", "2"), ("/proc/self/fd/7", "7")] {
            assert_eq!(descriptor(Path::new(path)).as_deref(), Some(number));
        }
        assert!(is_stdout(Path::new("/dev/stdout")) && !is_stdout(&link) && descriptor(folder.path()).is_none());
        // Opening a pipe would wait for its reader.
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.expect("it runs").success());
        let refused = check(&pipe, "test", Overwrite::Any).map_err(|error| error.kind());
        assert_eq!(refused, Err(io::ErrorKind::InvalidInput));
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
        let refused = check(&folder.path().join("round"), "test", Overwrite::Any);
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
