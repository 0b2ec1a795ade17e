//! The reasons why a command fails.

use crate::datalog::codes;
use crate::diag::Diagnostic;
use crate::files::FileError;
use std::io;
use std::path::Path;

/// The reason why a command failed.
pub enum Failure {
    /// The input is faulty, as the diagnostics describe. Exit code 1.
    Input(Vec<Diagnostic>),
    /// The input is faulty, and the command has printed the diagnostics. Exit code 1.
    Reported,
    /// The value of an option does not fit the input, as the diagnostics describe. Exit code 2.
    Option(Vec<Diagnostic>),
    /// Wrong usage, or a file that cannot be read or written. Exit code 2.
    Usage(String),
    /// The user or the system asked the command to end; its results so far are on disk. See [`signals`] for the exit
    /// codes.
    Interrupted,
    /// The reader closed standard output. Exit code 0, without a message.
    Closed,
}

impl From<Diagnostic> for Failure {
    fn from(fault: Diagnostic) -> Self {
        Failure::Input(vec![fault])
    }
}

impl From<Vec<Diagnostic>> for Failure {
    fn from(faults: Vec<Diagnostic>) -> Self {
        Failure::Input(faults)
    }
}

/// Converts errors of standard output; [`Failure::file`] converts those of files.
impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Failure::Closed,
            _ => Failure::Usage(format!("cannot write to standard output: {error}")),
        }
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Failure::Usage(error.to_string())
    }
}

impl Failure {
    /// Returns the failure to read or write a file; `doing` is the verb.
    pub fn file(doing: &str, path: &Path, error: impl std::fmt::Display) -> Failure {
        Failure::Usage(format!("cannot {doing} `{}`: {error}", path.display()))
    }

    /// Adds help to the faults of rules that do not fit a configuration.
    pub fn advise(self, help: Option<&str>) -> Failure {
        let advise = |fault: Diagnostic| match help.filter(|_| fault.code == codes::RULE_MISMATCH) {
            Some(help) => fault.help(help),
            None => fault,
        };
        match self {
            Failure::Input(faults) => Failure::Input(faults.into_iter().map(advise).collect()),
            other => other,
        }
    }

    /// Returns the failure of an option whose value does not fit the input.
    pub fn option(faults: impl Into<Vec<Diagnostic>>) -> Failure {
        Failure::Option(faults.into())
    }
}

/// Returns the help about the configuration that a command takes without its option `--config`.
pub fn assumed(config: &str) -> String {
    format!("without `--config`, this is about `{config}`; choose another configuration with `--config FILE`")
}
