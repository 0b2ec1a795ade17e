//! The record of the files that the program wrote in a folder, which shows whether an existing file is its own.
//!
//! The record [`RECORD`] lists each file with its size, its time of change and the command that wrote it. A file is the
//! program's own if size and time still match. The caller holds the lock of the folder.
// Decision: docs/decisions/safety.md#d065

use crate::files::{ReadError, open_regular};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::path::Path;
use std::time::UNIX_EPOCH;

/// The name of the record.
pub(super) const RECORD: &str = ".logicity.json";

/// The middle of the names of temporary files: `.NAME.logicity-PID-SECONDS`.
pub(super) const TEMPORARY: &str = ".logicity-";

/// The maximum number of bytes of a record that are read: others may have written it.
const BYTES_MAX: u64 = 16 << 20;

/// The record of a folder.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Record {
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

/// Returns whether a name is that of the record or of its temporary file, in upper or lower case.
pub(super) fn is_reserved(name: &str) -> bool {
    name.get(..RECORD.len())
        .is_some_and(|begin| begin.eq_ignore_ascii_case(RECORD))
}

impl Record {
    /// Reads the record of a folder. A file of that name with other content lists no files.
    ///
    /// # Errors
    /// Errors of the system; `InvalidInput` for anything but a regular file, which a record could not replace.
    pub(super) fn read(folder: &Path) -> io::Result<Record> {
        let mut text = Vec::new();
        match open_regular(&folder.join(RECORD)) {
            Ok(file) => file.take(BYTES_MAX).read_to_end(&mut text)?,
            Err(ReadError::NotFound) => return Ok(Record::default()),
            Err(error) => {
                let message = format!("its folder has a file `{RECORD}` that cannot be read: {error}");
                return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
            }
        };
        Ok(serde_json::from_slice(&text).unwrap_or_default())
    }

    /// Returns the command that wrote the existing file `name`; `None` if the program did not write it or it has
    /// changed since.
    pub(super) fn writer(&self, name: &str, existing: &fs::Metadata) -> Option<&str> {
        let known = self.written.get(name)?;
        (*known == Stamp::of(existing, &known.by)).then_some(&known.by)
    }

    /// Records a file as written by the command `by`.
    pub(super) fn add(&mut self, name: &str, written: &fs::Metadata, by: &str) {
        self.written.insert(name.to_owned(), Stamp::of(written, by));
    }

    /// Writes the record of a folder, without the files that are gone.
    pub(super) fn write(mut self, folder: &Path) -> io::Result<()> {
        // Others may have written names of other folders.
        let is_inside = |name: &str| Path::new(name).file_name().is_some_and(|inside| inside == name);
        self.written
            .retain(|name, _| is_inside(name) && folder.join(name).is_file());
        let text = serde_json::to_string(&self).expect("names and numbers") + "\n";
        let temporary = folder.join(format!("{RECORD}{TEMPORARY}{}-0", std::process::id()));
        // Never write through a link of that name.
        let _ = fs::remove_file(&temporary);
        let mut file = OpenOptions::new().write(true).create_new(true).open(&temporary)?;
        file.write_all(text.as_bytes())?;
        fs::rename(&temporary, folder.join(RECORD))
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
