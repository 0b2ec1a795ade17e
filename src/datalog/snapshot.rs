//! The coding of saved sessions: numbers, strings and a checksum.
//!
//! ```text
//! "logicity session"   16 bytes
//! version              4 bytes, little-endian like all numbers
//! program              32 bytes: a digest of the rules
//! content              what the session writes
//! checksum             32 bytes: SHA-256 of all bytes before it
//! ```
//!
//! A reader trusts no number: it allocates what it has read, and stops at its limit of memory.
// Decision: docs/decisions/facts.md#d086

use sha2::{Digest as _, Sha256};
use std::fmt;
use std::io::{self, Read, Write};

/// The start of a file.
const MAGIC: &[u8; 16] = b"logicity session";

/// The version of the format. It changes when older programs could not read a file, or would derive other rows.
const VERSION: u32 = 1;

/// The bytes of a digest.
const DIGEST: usize = 32;

/// The bytes that are coded at once.
const BLOCK: usize = 1 << 16;

/// A digest of rules.
pub(crate) type Fingerprint = [u8; DIGEST];

/// The reason why a session cannot be loaded.
#[derive(Debug)]
#[non_exhaustive]
pub enum SnapshotError {
    /// The input cannot be read.
    Io(io::Error),
    /// The input is no saved session.
    NotASnapshot,
    /// Another version of the engine saved it.
    Version {
        /// The version of its format.
        found: u32,
        /// The version that this engine reads.
        expected: u32,
    },
    /// A session of another program was saved.
    OtherProgram,
    /// The input ends too early.
    Truncated,
    /// The input was changed after it was saved.
    Corrupt,
    /// The session takes more memory than the limit.
    TooMuchMemory {
        /// The limit in bytes.
        limit: u64,
    },
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SnapshotError::Io(error) => write!(f, "{error}"),
            SnapshotError::NotASnapshot => write!(f, "it is no saved session"),
            SnapshotError::Version { found, expected } => {
                write!(
                    f,
                    "the saved session has format {found}; this version reads format {expected}"
                )
            }
            SnapshotError::OtherProgram => write!(f, "the saved session is one of another program"),
            SnapshotError::Truncated => write!(f, "the saved session is incomplete"),
            SnapshotError::Corrupt => write!(f, "the saved session is damaged"),
            SnapshotError::TooMuchMemory { limit } => {
                write!(f, "the saved session takes more than {} MiB of memory", limit >> 20)
            }
        }
    }
}

impl std::error::Error for SnapshotError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            SnapshotError::Io(error) => Some(error),
            _ => None,
        }
    }
}

/// Writes a session.
pub(crate) struct Encoder<'a> {
    out: &'a mut dyn Write,
    block: Vec<u8>,
    hash: Sha256,
}

impl<'a> Encoder<'a> {
    pub(crate) fn new(out: &'a mut dyn Write, program: &Fingerprint) -> io::Result<Self> {
        let mut encoder = Encoder {
            out,
            block: Vec::with_capacity(BLOCK),
            hash: Sha256::new(),
        };
        encoder.bytes(MAGIC)?;
        encoder.word(VERSION)?;
        encoder.bytes(program)?;
        Ok(encoder)
    }

    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.block.extend_from_slice(bytes);
        match self.block.len() >= BLOCK {
            true => self.flush(),
            false => Ok(()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.hash.update(&self.block);
        self.out.write_all(&self.block)?;
        self.block.clear();
        Ok(())
    }

    pub(crate) fn flag(&mut self, flag: bool) -> io::Result<()> {
        self.bytes(&[u8::from(flag)])
    }

    pub(crate) fn word(&mut self, word: u32) -> io::Result<()> {
        self.bytes(&word.to_le_bytes())
    }

    pub(crate) fn long(&mut self, number: u64) -> io::Result<()> {
        self.bytes(&number.to_le_bytes())
    }

    pub(crate) fn count(&mut self, count: usize) -> io::Result<()> {
        self.long(count as u64)
    }

    pub(crate) fn text(&mut self, text: &str) -> io::Result<()> {
        self.count(text.len())?;
        self.bytes(text.as_bytes())
    }

    /// Writes the checksum.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.flush()?;
        self.out.write_all(&self.hash.finalize())?;
        self.out.flush()
    }
}

/// Reads a session.
pub(crate) struct Decoder<'a> {
    input: &'a mut dyn Read,
    hash: Sha256,
    /// What was read, from `at` on not yet decoded.
    block: Vec<u8>,
    at: usize,
    limit: u64,
    /// The bytes of memory that the limit leaves.
    left: u64,
}

impl<'a> Decoder<'a> {
    /// Begins to read a session of the program, which may take `limit` bytes of memory.
    pub(crate) fn new(input: &'a mut dyn Read, program: &Fingerprint, limit: u64) -> Result<Self, SnapshotError> {
        let mut decoder = Decoder {
            input,
            hash: Sha256::new(),
            block: Vec::new(),
            at: 0,
            limit,
            left: limit,
        };
        match decoder.array() {
            Ok(magic) if magic == *MAGIC => {}
            Ok(_) | Err(SnapshotError::Truncated) => return Err(SnapshotError::NotASnapshot),
            Err(error) => return Err(error),
        }
        let found = decoder.word()?;
        if found != VERSION {
            return Err(SnapshotError::Version {
                found,
                expected: VERSION,
            });
        }
        match decoder.array::<DIGEST>()? == *program {
            true => Ok(decoder),
            false => Err(SnapshotError::OtherProgram),
        }
    }

    /// Reads on until `count` bytes are there; at most [`BLOCK`].
    fn fill(&mut self, count: usize) -> Result<(), SnapshotError> {
        if self.block.len() - self.at >= count {
            return Ok(());
        }
        self.hash.update(&self.block[..self.at]);
        self.block.drain(..self.at);
        self.at = 0;
        let more = (BLOCK - self.block.len()) as u64;
        self.input
            .take(more)
            .read_to_end(&mut self.block)
            .map_err(SnapshotError::Io)?;
        match self.block.len() >= count {
            true => Ok(()),
            false => Err(SnapshotError::Truncated),
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SnapshotError> {
        self.fill(N)?;
        let mut array = [0; N];
        array.copy_from_slice(&self.block[self.at..self.at + N]);
        self.at += N;
        Ok(array)
    }

    pub(crate) fn flag(&mut self) -> Result<bool, SnapshotError> {
        match self.array()? {
            [0] => Ok(false),
            [1] => Ok(true),
            _ => Err(SnapshotError::Corrupt),
        }
    }

    pub(crate) fn word(&mut self) -> Result<u32, SnapshotError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn long(&mut self) -> Result<u64, SnapshotError> {
        self.array().map(u64::from_le_bytes)
    }

    /// Takes memory for `count` things of `bytes` bytes each.
    pub(crate) fn room(&mut self, count: u64, bytes: usize) -> Result<(), SnapshotError> {
        let left = self.left.checked_sub(count.saturating_mul(bytes as u64));
        self.left = left.ok_or(SnapshotError::TooMuchMemory { limit: self.limit })?;
        Ok(())
    }

    /// Reads a string into `text`.
    pub(crate) fn text(&mut self, text: &mut String) -> Result<(), SnapshotError> {
        let length = self.long()?;
        let mut bytes = std::mem::take(text).into_bytes();
        bytes.clear();
        while (bytes.len() as u64) < length {
            self.fill(1)?;
            let rest = usize::try_from(length).unwrap_or(usize::MAX) - bytes.len();
            let end = self.block.len().min(self.at.saturating_add(rest));
            self.room((end - self.at) as u64, 1)?;
            bytes.extend_from_slice(&self.block[self.at..end]);
            self.at = end;
        }
        *text = String::from_utf8(bytes).map_err(|_| SnapshotError::Corrupt)?;
        Ok(())
    }

    /// Checks the checksum, and that nothing follows it.
    pub(crate) fn finish(mut self) -> Result<(), SnapshotError> {
        // All up to here, before further reading drops it.
        self.hash.update(&self.block[..self.at]);
        self.block.drain(..self.at);
        self.at = 0;
        let hash = std::mem::take(&mut self.hash).finalize();
        let found: Fingerprint = self.array()?;
        match found[..] == hash[..] && matches!(self.fill(1), Err(SnapshotError::Truncated)) {
            true => Ok(()),
            false => Err(SnapshotError::Corrupt),
        }
    }
}
