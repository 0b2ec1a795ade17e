//! Files of lines that grow while a process works: a killed process loses no line that it has added.

use crate::files::{folder_of, refuse_generated};
#[cfg(not(windows))]
use std::fs::TryLockError;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The longest line, in bytes (64 MiB).
const LINE_MAX: u64 = 1 << 26;
/// The maximum number of bytes of an incomplete line that are read.
const TORN_MAX: u64 = 1 << 16;

/// A regular file to which one process appends lines, each at once.
///
/// ```text
/// open: create or open, lock -> lines: read what is there -> append: remove a torn last line, then add lines
/// ```
///
/// A file that [`Journal::open`] has created is removed again if it is still empty in the end.
#[derive(Debug)]
pub struct Journal {
    file: File,
    path: PathBuf,
    is_new: bool,
    /// Where the complete lines end.
    end: u64,
}

impl Journal {
    /// Opens a file, or creates it.
    ///
    /// # Errors
    /// Errors of the system; `InvalidInput` for anything but a regular file; `InvalidData` if an incomplete last line is
    /// too long; `ResourceBusy` if another process has the file open as a journal.
    pub fn open(path: &Path) -> io::Result<Journal> {
        let existing = fs::metadata(path).ok();
        if existing.as_ref().is_some_and(|found| !found.is_file()) {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file"));
        }
        refuse_generated(path)?;
        let folder = folder_of(path);
        if !folder.is_dir() {
            let message = format!("there is no folder `{}`", folder.display());
            return Err(io::Error::new(io::ErrorKind::NotFound, message));
        }
        let mut file = open_alone(path)?;
        let end = end_of_lines(&mut file)?;
        Ok(Journal {
            file,
            path: path.to_owned(),
            is_new: existing.is_none(),
            end,
        })
    }

    /// Returns the complete lines.
    ///
    /// # Errors
    /// Errors of the system; `InvalidData` for a line that is not UTF-8 or too long.
    pub fn lines(&self) -> io::Result<impl Iterator<Item = io::Result<String>> + use<>> {
        let mut file = self.file.try_clone()?;
        file.seek(SeekFrom::Start(0))?;
        let mut reader = BufReader::new(file.take(self.end));
        let mut number = 0;
        Ok(std::iter::from_fn(move || {
            number += 1;
            let invalid = |what: &str| io::Error::new(io::ErrorKind::InvalidData, format!("line {number} is {what}"));
            let mut bytes = Vec::new();
            match reader.by_ref().take(LINE_MAX).read_until(b'\n', &mut bytes) {
                Ok(0) => None,
                Ok(_) if bytes.pop() != Some(b'\n') => Some(Err(invalid("too long"))),
                Ok(_) => Some(String::from_utf8(bytes).map_err(|_| invalid("not UTF-8 text"))),
                Err(error) => Some(Err(error)),
            }
        }))
    }

    /// Returns the beginning of the last line, at most 64 KiB, if it is incomplete, otherwise an empty text.
    ///
    /// # Errors
    /// Errors of the system.
    pub fn torn(&mut self) -> io::Result<Vec<u8>> {
        let mut text = Vec::new();
        self.file.seek(SeekFrom::Start(self.end))?;
        (&self.file).take(TORN_MAX).read_to_end(&mut text)?;
        Ok(text)
    }

    /// Adds a line. The first call removes an incomplete last line.
    ///
    /// # Errors
    /// Errors of the system.
    pub fn append(&mut self, line: &str) -> io::Result<()> {
        if self.file.metadata()?.len() > self.end {
            self.file.set_len(self.end)?;
        }
        let line = format!("{line}\n");
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(line.as_bytes())?;
        self.end += line.len() as u64;
        Ok(())
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        if self.is_new && self.file.metadata().is_ok_and(|found| found.len() == 0) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Opens or creates a file that no other process has open as a journal.
fn open_alone(path: &Path) -> io::Result<File> {
    let busy = || io::Error::new(io::ErrorKind::ResourceBusy, "another process writes it");
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    #[cfg(windows)]
    {
        // A lock would also keep readers from the file.
        use crate::files::ERROR_SHARING_VIOLATION;
        use std::os::windows::fs::OpenOptionsExt;
        const FILE_SHARE_READ_DELETE: u32 = 1 | 4;
        let file = options.share_mode(FILE_SHARE_READ_DELETE).open(path);
        file.map_err(|error| match error.raw_os_error() {
            Some(ERROR_SHARING_VIOLATION) => busy(),
            _ => error,
        })
    }
    #[cfg(not(windows))]
    {
        let file = options.open(path)?;
        match file.try_lock() {
            Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
            Err(TryLockError::WouldBlock) => Err(busy()),
        }
    }
}

/// Returns the position after the last line break. Fails if the incomplete last line is longer than [`LINE_MAX`].
fn end_of_lines(file: &mut File) -> io::Result<u64> {
    const CHUNK: u64 = 1 << 16;
    let mut end = file.metadata()?.len();
    let least = end.saturating_sub(LINE_MAX);
    let mut bytes = Vec::new();
    while end > 0 {
        if end < least {
            let message = format!("its last line is longer than {} MiB", LINE_MAX >> 20);
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        let begin = end.saturating_sub(CHUNK);
        bytes.clear();
        file.seek(SeekFrom::Start(begin))?;
        (&*file).take(end - begin).read_to_end(&mut bytes)?;
        if let Some(at) = bytes.iter().rposition(|byte| *byte == b'\n') {
            return Ok(begin + at as u64 + 1);
        }
        end = begin;
    }
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(journal: &Journal) -> Vec<String> {
        journal.lines().expect("open").map(|line| line.expect("text")).collect()
    }

    #[test]
    fn lines_are_kept_and_a_torn_one_is_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("log");
        drop(Journal::open(&path).expect("new"));
        assert!(!path.exists(), "an empty new file is removed");
        let mut journal = Journal::open(&path).expect("new");
        let busy = Journal::open(&path).expect_err("it is open");
        assert_eq!(busy.kind(), io::ErrorKind::ResourceBusy);
        for line in ["one", "", "three"] {
            journal.append(line).expect("room");
        }
        assert_eq!(lines(&journal), ["one", "", "three"]);
        drop(journal);
        // Longer than a chunk of the search for the last line break.
        let torn = "x".repeat(200_000);
        fs::write(&path, format!("one\ntwo\n{torn}")).expect("writable");
        let mut journal = Journal::open(&path).expect("a file");
        assert_eq!(lines(&journal), ["one", "two"]);
        assert_eq!(journal.torn().expect("a file"), torn.as_bytes()[..1 << 16]);
        assert_eq!(
            fs::metadata(&path).expect("there").len(),
            200_008,
            "reading changes nothing"
        );
        journal.append("new").expect("room");
        assert_eq!(lines(&journal), ["one", "two", "new"]);
        drop(journal);
        assert_eq!(fs::read_to_string(&path).expect("text"), "one\ntwo\nnew\n");
        let nowhere = Journal::open(&folder.path().join("none/log")).expect_err("no folder");
        assert_eq!(nowhere.kind(), io::ErrorKind::NotFound);
        assert!(nowhere.to_string().starts_with("there is no folder `"), "{nowhere}");
        let folder = Journal::open(folder.path()).expect_err("a folder");
        assert_eq!(folder.kind(), io::ErrorKind::InvalidInput);
        fs::write(&path, b"\xff\n").expect("writable");
        let journal = Journal::open(&path).expect("a file");
        let line = journal.lines().expect("open").next().expect("one line");
        assert_eq!(line.expect_err("not text").to_string(), "line 1 is not UTF-8 text");
    }
}
