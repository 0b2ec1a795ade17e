//! Reads traces with the configuration and the rules of their runs.

use crate::builtin::BuiltinFiles;
use crate::cli::failure::Failure;
use crate::cli::inputs::open;
use crate::cli::kind::Kind;
use crate::cli::limits::LimitOptions;
use crate::datalog::Limits;
use crate::diag::{self, Diagnostic, Sources};
use crate::files;
use crate::sim::codes;
use crate::sim::{Archive, LoadError, LoadedCity, Replay, TraceHeader, TraceTick, trace_limits};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Returns the longest line, in bytes: 256 MiB, or less memory.
pub fn line_max() -> u64 {
    files::read_limit().min(1 << 28)
}

/// An open trace, after its header.
pub struct TraceReader {
    path: PathBuf,
    lines: Box<dyn BufRead>,
    number: usize,
    /// Size of the file, and of the lines read so far, in bytes.
    pub length: u64,
    pub read: u64,
    /// The number of the next tick, once one has been read.
    next: Option<u64>,
    /// The header.
    pub header: TraceHeader,
}

impl TraceReader {
    pub fn open(path: &Path) -> Result<TraceReader, Failure> {
        let file = open(path)?;
        let length = file.metadata().map_or(0, |file| file.len());
        TraceReader::new(Box::new(BufReader::new(file)), path, length)
    }

    /// Reads the header of an open trace of `length` bytes, 0 if that is unknown.
    pub fn new(mut lines: Box<dyn BufRead>, path: &Path, length: u64) -> Result<TraceReader, Failure> {
        let (mut number, mut read) = (0, 0);
        let Some(line) = next_line(&mut *lines, path, &mut number, &mut read)? else {
            let message = format!("`{}` is empty", path.display());
            return Err(Diagnostic::new(codes::INVALID_TRACE, message).into());
        };
        Ok(TraceReader {
            header: TraceHeader::read(&line).map_err(|fault| match Kind::Trace.mismatch(path, &line) {
                Some(mismatch) => mismatch.into(),
                None => placed(fault, path, number),
            })?,
            path: path.to_owned(),
            lines,
            number,
            length,
            read,
            next: None,
        })
    }

    /// Returns the next tick, or `None` at the end. The numbers of the ticks are consecutive.
    pub fn tick(&mut self) -> Result<Option<TraceTick>, Failure> {
        let line = next_line(&mut *self.lines, &self.path, &mut self.number, &mut self.read)?;
        let Some(line) = line else { return Ok(None) };
        let tick = TraceTick::read(&line).map_err(|fault| self.placed(fault))?;
        if let Some(expected) = self.next.filter(|&expected| expected != tick.tick) {
            let message = format!("found tick {} instead of tick {expected}", tick.tick);
            return Err(self.placed(Diagnostic::new(codes::INVALID_TRACE, message)));
        }
        self.next = Some(tick.tick.saturating_add(1));
        Ok(Some(tick))
    }

    /// Returns a fault with the place of the last line read.
    pub fn placed(&self, fault: Diagnostic) -> Failure {
        placed(fault, &self.path, self.number)
    }

    /// Returns the rules in the trace.
    pub fn rules(&self) -> Result<Archive, Failure> {
        let missing = || {
            let message = "a trace of version 1, which does not contain its rules";
            let fault = Diagnostic::new(codes::INVALID_TRACE, message);
            placed(
                fault.help("specify rule files, and the configuration of the run with `--config`"),
                &self.path,
                1,
            )
        };
        self.header.archive.clone().ok_or_else(missing)
    }

    /// Returns the limits of each tick under these options. Rules that come with the trace have lower defaults than the
    /// file `rules`, which the user named.
    pub fn limits(&self, rules: Option<&Path>, options: &LimitOptions) -> Limits {
        options.limits(match rules {
            Some(_) => Limits::default(),
            None => trace_limits(self.header.agents.len()),
        })
    }

    /// Returns the replay under the configuration and rules in the trace, or under the given files. Rejects a given
    /// configuration with another hash, and other rules if `strict`. Opens no file that the trace names. `limits`
    /// applies to each tick.
    pub fn replay(
        &self,
        sources: &mut Sources,
        config: Option<&Path>,
        rules: Option<&Path>,
        strict: bool,
        limits: Limits,
    ) -> Result<Replay, Failure> {
        let mut city = self.city(sources, config, rules)?;
        if let Some(config) = config {
            let hashes = [&city.scenario.hash, &self.header.config_hash];
            matching("configuration", config, hashes, &self.path, "--config")?;
        }
        // The rules of a trace of version 1 come from its configuration.
        if strict && (rules.is_some() || self.header.archive.is_none()) {
            let hashes = [&city.rules_hash, &self.header.rules_hash];
            let path = sources.name(city.rule_files[0]).to_owned();
            matching("rules", Path::new(&path), hashes, &self.path, "--rules")?;
        }
        city.limits = limits;
        let world = city.world()?;
        Replay::new(Arc::new(world), &self.header).map_err(|fault| placed(fault, &self.path, 1))
    }

    /// Loads the configuration and rules in the trace, or the given files.
    pub fn city(
        &self,
        sources: &mut Sources,
        config: Option<&Path>,
        rules: Option<&Path>,
    ) -> Result<LoadedCity, Failure> {
        LoadedCity::of_trace(sources, &self.header, config, rules, &BuiltinFiles).map_err(|error| {
            let noted = |faults: Vec<Diagnostic>, what: &str| -> Vec<Diagnostic> {
                let note = format!("in the {what} of the trace `{}`", self.path.display());
                faults.into_iter().map(|fault| fault.note(note.clone())).collect()
            };
            match (error, config, rules) {
                // Without a place: it is no file that the user named, so it has no other one.
                (LoadError::Config(faults), None, _) if faults.iter().all(|fault| fault.primary.is_none()) => {
                    placed(faults.into_iter().next().expect("at least one"), &self.path, 1)
                }
                (LoadError::Config(faults), None, _) => noted(faults, "configuration").into(),
                (LoadError::Rules(faults), _, None) => noted(faults, "rules").into(),
                (error, ..) => error.into(),
            }
        })
    }
}

fn placed(mut fault: Diagnostic, path: &Path, number: usize) -> Failure {
    fault.message = format!("{}:{number}: {}", path.display(), fault.message);
    fault.into()
}

/// Returns the next line that is not blank.
fn next_line(
    lines: &mut dyn BufRead,
    path: &Path,
    number: &mut usize,
    read: &mut u64,
) -> Result<Option<String>, Failure> {
    loop {
        let mut bytes = Vec::new();
        let longest = line_max();
        let found = (&mut *lines).take(longest).read_until(b'\n', &mut bytes);
        let found = found.map_err(|error| Failure::file("read", path, error))?;
        if found == 0 {
            return Ok(None);
        }
        *read += found as u64;
        *number += 1;
        if found as u64 == longest && !bytes.ends_with(b"\n") {
            let message = format!("a line of more than {} MiB", longest >> 20);
            return Err(placed(Diagnostic::new(codes::INVALID_TRACE, message), path, *number));
        }
        let line = String::from_utf8(bytes).map_err(|_| {
            let fault = Diagnostic::new(diag::codes::NOT_TEXT, "not UTF-8 text");
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
    Err(Diagnostic::new(codes::TRACE_MISMATCH, message)
        .note(note)
        .help(format!(
            "specify the original file with {option}, omit {option} to use that in the trace, or run again"
        ))
        .into())
}
