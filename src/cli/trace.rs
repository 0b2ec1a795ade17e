//! Reads traces, and finds the configuration and rules of their runs.

use crate::builtin::BuiltinFiles;
use crate::cli::{Failure, open};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files::MAX_BYTES;
use crate::sim::{LoadError, LoadedCity, Replay, TraceHeader, TraceTick};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An open trace, after its header.
pub struct TraceReader {
    path: PathBuf,
    lines: BufReader<File>,
    number: usize,
    /// Size of the file, and of the lines read so far, in bytes.
    pub length: u64,
    pub read: u64,
    /// The header.
    pub header: TraceHeader,
}

impl TraceReader {
    pub fn open(path: &Path) -> Result<TraceReader, Failure> {
        let file = open(path)?;
        let length = file.metadata().map_or(0, |file| file.len());
        let mut lines = BufReader::new(file);
        let (mut number, mut read) = (0, 0);
        let Some(line) = next_line(&mut lines, path, &mut number, &mut read)? else {
            let message = format!("`{}` is empty", path.display());
            return Err(Diagnostic::new(Code::INVALID_TRACE, message).into());
        };
        Ok(TraceReader {
            header: TraceHeader::read(&line).map_err(|fault| placed(fault, path, number))?,
            path: path.to_owned(),
            lines,
            number,
            length,
            read,
        })
    }

    /// Returns the next tick, or `None` at the end.
    pub fn tick(&mut self) -> Result<Option<TraceTick>, Failure> {
        let line = next_line(&mut self.lines, &self.path, &mut self.number, &mut self.read)?;
        line.map(|line| TraceTick::read(&line).map_err(|fault| self.placed(fault)))
            .transpose()
    }

    /// Returns a fault with the place of the last line read.
    pub fn placed(&self, fault: Diagnostic) -> Failure {
        placed(fault, &self.path, self.number)
    }

    /// Returns the replay under the configuration and rules of the run, or under the given files. Rejects a
    /// configuration with another hash, and other rules if `strict`.
    pub fn replay(
        &self,
        sources: &mut Sources,
        config: Option<&Path>,
        rules: Option<&Path>,
        strict: bool,
    ) -> Result<Replay, Failure> {
        let named = self.header.config_file.as_ref().unwrap_or(&self.header.config);
        let config_path = config.unwrap_or(Path::new(named));
        let rules_path = rules.unwrap_or(Path::new(&self.header.rules));
        let city = LoadedCity::load(sources, config_path, Some(rules_path), &BuiltinFiles).map_err(|error| {
            let (given, help) = match error {
                LoadError::Config(_) => (config, "specify the configuration of the run with --config"),
                LoadError::RuleFile(..) | LoadError::Rules(_) => (rules, "specify the rules of the run with --rules"),
            };
            match Failure::from(error) {
                // A file that only the trace names.
                Failure::Usage(message) if given.is_none() => Failure::Usage(format!("{message}\nhelp: {help}")),
                failure => failure,
            }
        })?;
        let hashes = [&city.scenario.hash, &self.header.config_hash];
        matching("configuration", config_path, hashes, &self.path, "--config")?;
        if strict {
            let hashes = [&city.rules_hash, &self.header.rules_hash];
            matching("rules", rules_path, hashes, &self.path, "--rules")?;
        }
        let world = city.world()?;
        Replay::new(Arc::new(world), &self.header).map_err(|fault| placed(fault, &self.path, 1))
    }
}

fn placed(mut fault: Diagnostic, path: &Path, number: usize) -> Failure {
    fault.message = format!("{}:{number}: {}", path.display(), fault.message);
    fault.into()
}

/// Returns the next line that is not blank.
fn next_line(
    lines: &mut BufReader<File>,
    path: &Path,
    number: &mut usize,
    read: &mut u64,
) -> Result<Option<String>, Failure> {
    loop {
        let mut bytes = Vec::new();
        let found = lines.by_ref().take(MAX_BYTES).read_until(b'\n', &mut bytes);
        let found = found.map_err(|error| Failure::file("read", path, error))?;
        if found == 0 {
            return Ok(None);
        }
        *read += found as u64;
        *number += 1;
        let line = String::from_utf8(bytes).map_err(|_| {
            let fault = Diagnostic::new(Code::NOT_TEXT, "not UTF-8 text");
            placed(fault, path, *number)
        })?;
        if !line.trim().is_empty() {
            return Ok(Some(line));
        }
    }
}

fn matching(what: &str, path: &Path, [found, wanted]: [&String; 2], trace: &Path, option: &str) -> Result<(), Failure> {
    if found == wanted {
        return Ok(());
    }
    let short = |hash: &str| hash.chars().take(12).collect::<String>();
    let is = if what == "rules" {
        "differ from those"
    } else {
        "differs from that"
    };
    let message = format!(
        "the {what} `{}` {is} of the run in `{}`",
        path.display(),
        trace.display()
    );
    let note = format!(
        "its hash is {}..., but the trace has {}...",
        short(found),
        short(wanted)
    );
    Err(Diagnostic::new(Code::TRACE_MISMATCH, message)
        .note(note)
        .help(format!("specify the original file with {option}, or run again"))
        .into())
}
