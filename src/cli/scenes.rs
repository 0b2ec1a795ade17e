//! Reads files of scenes, one JSON object per line.

use crate::cli::failure::Failure;
use crate::cli::inputs::open;
use crate::cli::kind::Kind;
use crate::datalog::internal::size;
use crate::diag::codes;
use crate::diag::{Diagnostic, SourceId, Sources};
use crate::files::{self, ReadError};
use crate::task::induction::LOG_START;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// The longest scene, in bytes (64 MiB).
const MAX_SCENE: u64 = 1 << 26;

/// The part of the memory of a command that the text of a scene may take: parsed, short values take far more.
const PARTS: u64 = 16;

/// The scenes of a file or of standard input.
pub struct SceneLines {
    lines: Box<dyn BufRead>,
    path: PathBuf,
    /// The name of the file in messages.
    pub name: String,
    number: usize,
    /// The longest line, in bytes.
    longest: u64,
}

/// A line that is not blank.
pub struct SceneLine {
    /// Its number, from 1 on.
    pub number: usize,
    /// Its text alone.
    pub sources: Sources,
    /// The text among the sources, or why the line is none.
    pub scene: Result<SourceId, Diagnostic>,
}

/// Opens a file; `-` means standard input.
pub fn open_input(path: &Path) -> Result<Box<dyn BufRead>, Failure> {
    Ok(match path == Path::new("-") {
        true => Box::new(io::stdin().lock()),
        false => Box::new(BufReader::new(open(path)?)),
    })
}

impl SceneLines {
    /// Opens a file; `-` means standard input. Fails for a file of another kind.
    pub fn open(path: &Path) -> Result<SceneLines, Failure> {
        let mut lines = open_input(path)?;
        let unreadable = |error| Failure::file("read", path, error);
        let begin = lines.fill_buf().map_err(unreadable)?;
        // The buffer may end within a character. Reading the lines reports what is not text.
        let begin = match std::str::from_utf8(begin) {
            Ok(text) => text,
            Err(error) if error.error_len().is_some() => "",
            Err(error) => std::str::from_utf8(&begin[..error.valid_up_to()]).unwrap_or_default(),
        };
        match Kind::Scenes.mismatch(path, begin) {
            Some(fault) => Err(fault.into()),
            None => Ok(SceneLines::new(lines, path)),
        }
    }

    /// Reads the lines of an open file.
    pub fn new(lines: Box<dyn BufRead>, path: &Path) -> SceneLines {
        let name = match path == Path::new("-") {
            true => "<stdin>".to_owned(),
            false => path.display().to_string(),
        };
        SceneLines {
            lines,
            path: path.to_owned(),
            name,
            number: 0,
            longest: MAX_SCENE,
        }
    }

    /// Shortens the longest scene so that it can be read within `memory` bytes.
    pub fn within(mut self, memory: u64) -> SceneLines {
        self.longest = MAX_SCENE.min(memory / PARTS);
        self
    }

    /// Returns the next line that is neither blank nor the header of a log of questions, or `None` at the end.
    pub fn next(&mut self) -> Result<Option<SceneLine>, Failure> {
        loop {
            let unreadable = |error| Failure::file("read", &self.path, error);
            let mut bytes = Vec::new();
            let read = self.lines.by_ref().take(self.longest + 1).read_until(b'\n', &mut bytes);
            if read.map_err(unreadable)? == 0 {
                return Ok(None);
            }
            self.number += 1;
            let (number, name) = (self.number, &self.name);
            let fault = |code, what: &str| Diagnostic::new(code, format!("line {number} of `{name}` is {what}"));
            let mut sources = Sources::new();
            let scene = if bytes.len() as u64 > self.longest && !bytes.ends_with(b"\n") {
                let limit = format!("too long: the limit is {}", size(self.longest));
                let fault = fault(codes::LIMIT_EXCEEDED, &limit);
                let mut rest = self.lines.by_ref().take(MAX_SCENE);
                rest.skip_until(b'\n').map_err(unreadable)?;
                // A line without an end would take as long as the file.
                if rest.limit() == 0 {
                    return Err(fault.into());
                }
                Err(fault)
            } else {
                match files::to_text(bytes) {
                    Ok(line) if line.trim().is_empty() => continue,
                    Ok(line) if number == 1 && line.starts_with(LOG_START) => continue,
                    Ok(mut line) => {
                        line.truncate(line.trim_end_matches(['\n', '\r']).len());
                        Ok(sources.add_from(name.as_str(), line, number))
                    }
                    Err(ReadError::NotText { column, .. }) => {
                        let what = format!("not UTF-8 text (first bad byte in column {column})");
                        Err(fault(codes::NOT_TEXT, &what))
                    }
                    Err(error) => return Err(Failure::file("read", &self.path, error)),
                }
            };
            return Ok(Some(SceneLine { number, sources, scene }));
        }
    }
}
