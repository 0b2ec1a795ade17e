//! The record of the files that the program wrote in a folder, which shows whether an existing file is its own.
//!
//! The record [`RECORD`] lists each file with its size, its time of change and the command that wrote it. A file is the
//! program's own if size and time still match. The caller holds the lock of the folder.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::time::UNIX_EPOCH;

/// The name of the record.
pub(super) const RECORD: &str = ".logicity.json";

/// The middle of the names of temporary files: `.NAME.logicity-PID-SECONDS`.
pub(super) const TEMPORARY: &str = ".logicity-";

/// The record of a folder.
#[derive(Default, Serialize, Deserialize)]
struct Record {
    /// The files that the program wrote, by name.
    written: BTreeMap<String, Stamp>,
}

/// Identifies the content of a file without reading it.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    bytes: u64,
    /// The time of change in nanoseconds since 1970.
    changed: u64,
    /// The command that wrote the file.
    #[serde(default)]
    by: String,
}

impl Stamp {
    fn of(found: &fs::Metadata, by: &str) -> Stamp {
        let changed = found
            .modified()
            .ok()
            .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        Stamp {
            bytes: found.len(),
            changed: changed.map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)),
            by: by.to_owned(),
        }
    }
}

/// Returns the command that wrote the existing file `name`; `None` if the program did not write it or it has changed
/// since.
pub(super) fn writer(folder: &Path, name: &str, existing: &fs::Metadata) -> io::Result<Option<String>> {
    let known = read(folder)?.written.remove(name);
    Ok(known
        .filter(|known| *known == Stamp::of(existing, &known.by))
        .map(|known| known.by))
}

/// Returns whether a name is that of the record or of its temporary file, in upper or lower case.
pub(super) fn is_reserved(name: &str) -> bool {
    name.get(..RECORD.len())
        .is_some_and(|begin| begin.eq_ignore_ascii_case(RECORD))
}

/// Fails if the record cannot be replaced, because something other than a regular file has its name.
pub(super) fn check(folder: &Path) -> io::Result<()> {
    existing(&folder.join(RECORD)).map(drop)
}

/// Records a file as written by the command `by`.
pub(super) fn add(folder: &Path, name: &str, written: &fs::Metadata, by: &str) -> io::Result<()> {
    let mut record = read(folder)?;
    record.written.insert(name.to_owned(), Stamp::of(written, by));
    record.written.retain(|name, _| folder.join(name).is_file());
    let text = serde_json::to_string(&record).expect("names and numbers") + "\n";
    let temporary = folder.join(format!("{RECORD}{TEMPORARY}{}-0", std::process::id()));
    // Never write through a link of that name.
    let _ = fs::remove_file(&temporary);
    let mut file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
    file.write_all(text.as_bytes())?;
    fs::rename(&temporary, folder.join(RECORD))
}

/// Reads the record of a folder. A file of that name with other content lists no files.
fn read(folder: &Path) -> io::Result<Record> {
    let path = folder.join(RECORD);
    match existing(&path)? {
        None => Ok(Record::default()),
        Some(_) => Ok(serde_json::from_slice(&fs::read(path)?).unwrap_or_default()),
    }
}

/// Returns the metadata of a file, if it exists. Fails for anything but a regular file.
pub(super) fn existing(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match fs::metadata(path) {
        Ok(found) if found.is_file() => Ok(Some(found)),
        Ok(_) => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
