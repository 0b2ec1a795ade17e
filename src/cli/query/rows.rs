//! Reads files of facts block by block, so that their text is never in memory as a whole.

use crate::cli::failure::Failure;
use crate::datalog::{EvalError, PredicateId, RowFormat, Session, facts};
use crate::diag::codes;
use crate::diag::{Diagnostic, MAX_FAULTS, Sources, Span};
use crate::files::ReadError;
use flate2::read::MultiGzDecoder;
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

/// The bytes that are read at once.
const BLOCK: usize = 1 << 20;

/// The memory of a long row: in the block, as the text of a source, and as a symbol.
const COPIES: u64 = 3;

/// The maximum length of the texts with faults.
const FAULTY_MAX: usize = 8 * BLOCK;

/// Returns the contents of a file that may be compressed with gzip, which its first two bytes show.
pub fn decompressed(file: File) -> Result<Box<dyn Read>, ReadError> {
    let mut file = BufReader::new(file);
    let start = file.fill_buf().map_err(|error| ReadError::Io(error.to_string()))?;
    Ok(match start.starts_with(&[0x1f, 0x8b]) {
        true => Box::new(MultiGzDecoder::new(file)),
        false => Box::new(file),
    })
}

/// Loads the rows of a predicate. Returns the faults, and adds the texts that contain them to the sources. Stops at more
/// faults than anyone reads.
pub fn load_rows(
    input: impl Read,
    path: &Path,
    (session, id, format): (&mut Session, PredicateId, &RowFormat),
    sources: &mut Sources,
    unreadable: impl Fn(ReadError) -> Failure,
) -> Result<Vec<Diagnostic>, Failure> {
    let mut blocks = Blocks::new(input, format.clone());
    let mut faulty = Faulty::default();
    loop {
        let is_last = blocks
            .read()
            .map_err(|error| unreadable(ReadError::Io(error.to_string())))?;
        let (text, invalid) = blocks.rows(is_last);
        let mut part = Sources::new();
        let source = part.add("", &*text);
        if invalid.is_some() || facts::load_as(session, id, &part, source, &blocks.format).is_err() {
            drop(part);
            faulty.add(&text, invalid, path, (session, id, &blocks), sources);
            if invalid.is_some() || faulty.is_full() {
                return Ok(faulty.faults);
            }
        }
        let (length, lines) = (text.len(), text.bytes().filter(|&byte| byte == b'\n').count());
        drop(text);
        if is_last && session.bytes() <= session.limits().bytes {
            return Ok(faulty.faults);
        }
        let long_row = blocks.advance(length, lines);
        if session.bytes().saturating_add(long_row) > session.limits().bytes {
            let limit = session.limits().bytes;
            let fault = EvalError::TooManyInputs { limit }.diagnostic(session.program().rules());
            return Err(fault.note(format!("while reading `{}`", path.display())).into());
        }
    }
}

/// The text of a file, as whole rows.
struct Blocks<R> {
    input: R,
    format: RowFormat,
    /// What was read and not yet passed over.
    block: Vec<u8>,
    /// The bytes at the start of the block that contain no end of a row.
    known: usize,
    /// The number of bytes to read next.
    more: usize,
    /// The number of the first line of the block.
    first_line: usize,
}

impl<R: Read> Blocks<R> {
    fn new(input: R, format: RowFormat) -> Blocks<R> {
        Blocks {
            input,
            format,
            block: Vec::new(),
            known: 0,
            more: BLOCK,
            first_line: 1,
        }
    }

    /// Reads on. Returns whether the file has ended.
    fn read(&mut self) -> io::Result<bool> {
        // A block ends with a line. What remains of the block before has no line break, or one in quotes.
        self.known = if self.format.quoted { 0 } else { self.block.len() };
        let read = (&mut self.input).take(self.more as u64).read_to_end(&mut self.block)?;
        Ok(read == 0)
    }

    /// Returns the complete rows of the block, and where they stop being UTF-8.
    fn rows(&self, is_last: bool) -> (Cow<'_, str>, Option<usize>) {
        let end = match self.block[self.known..].iter().rposition(|&byte| byte == b'\n') {
            _ if is_last => self.block.len(),
            Some(at) => self.known + at + 1,
            None => 0,
        };
        match std::str::from_utf8(&self.block[..end]) {
            Err(error) => (String::from_utf8_lossy(&self.block[..end]), Some(error.valid_up_to())),
            Ok(text) if is_last => (text.into(), None),
            Ok(text) => (text[..facts::complete(text, &self.format)].into(), None),
        }
    }

    /// Passes over rows of this length and number of lines. Returns the memory that an incomplete long row needs.
    fn advance(&mut self, length: usize, lines: usize) -> u64 {
        self.first_line += lines;
        if length > 0 {
            self.format.headers = false;
            self.more = BLOCK;
            self.block.drain(..length);
            return 0;
        }
        // Doubles the block, so that a long row takes linear time.
        self.more = self.block.len().max(BLOCK);
        match self.block.len() > 2 * BLOCK {
            true => COPIES * self.block.len() as u64,
            false => 0,
        }
    }
}

/// The faults found so far.
#[derive(Default)]
struct Faulty {
    faults: Vec<Diagnostic>,
    /// The length of the texts that contain them.
    length: usize,
}

impl Faulty {
    /// Adds the faults of a text, and the text to the sources.
    fn add<R>(
        &mut self,
        text: &str,
        invalid: Option<usize>,
        path: &Path,
        (session, id, blocks): (&mut Session, PredicateId, &Blocks<R>),
        sources: &mut Sources,
    ) {
        let source = sources.add_from(path.display().to_string(), text, blocks.first_line);
        self.length += text.len();
        if let Some(first) = invalid {
            let place = Span::new(source, first..first + char::REPLACEMENT_CHARACTER.len_utf8());
            let fault = Diagnostic::new(codes::NOT_TEXT, format!("`{}` is not UTF-8 text", path.display()));
            let fault = fault.at(place, "invalid UTF-8 starts here");
            self.faults.push(fault.help("save the file as UTF-8"));
        }
        // Reports the other faults of the text as well.
        let others = facts::load_as(session, id, sources, source, &blocks.format).err();
        self.faults.extend(others.into_iter().flatten());
    }

    fn is_full(&self) -> bool {
        self.faults.len() >= MAX_FAULTS || self.length > FAULTY_MAX
    }
}
