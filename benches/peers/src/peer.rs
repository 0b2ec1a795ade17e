//! The peers, and the commands of those that are separate programs.

use crate::case::Case;
use std::fmt::{self, Write};
use std::path::Path;
use std::process::{Command, Stdio};

/// An engine, or one of its interfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Peer {
    /// logicity as a library
    Engine,
    /// `logicity query`, including startup and reading rules and facts
    Query,
    /// ascent
    Ascent,
    /// hand-written datafrog
    Datafrog,
    /// crepe
    Crepe,
    /// hand-written differential-dataflow
    Differential,
    /// Soufflé's interpreter, including startup and reading rules and facts
    Souffle,
    /// A program compiled by Soufflé, including startup and reading facts
    SouffleCompiled,
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Peer::Engine => "logicity, library",
            Peer::Query => "logicity query *",
            Peer::Ascent => "ascent",
            Peer::Datafrog => "hand-written datafrog",
            Peer::Crepe => "crepe",
            Peer::Differential => "differential-dataflow",
            Peer::Souffle => "Soufflé interpreted *",
            Peer::SouffleCompiled => "Soufflé compiled *",
        })
    }
}

/// The environment variable that makes a process the `logicity` command.
pub const AS_LOGICITY: &str = "LOGICITY_PEERS_AS_LOGICITY";

impl Peer {
    /// All peers, logicity first.
    pub const ALL: [Peer; 8] = [
        Peer::Engine,
        Peer::Query,
        Peer::Ascent,
        Peer::Datafrog,
        Peer::Crepe,
        Peer::Differential,
        Peer::Souffle,
        Peer::SouffleCompiled,
    ];

    /// Whether this program contains it or calls it.
    pub fn is_compiled(self) -> bool {
        cfg!(feature = "others") || !matches!(self, Peer::Ascent | Peer::Crepe | Peer::Differential)
    }

    /// Whether it needs Soufflé.
    pub fn is_souffle(self) -> bool {
        matches!(self, Peer::Souffle | Peer::SouffleCompiled)
    }

    /// Whether the measurement covers the whole process.
    pub fn is_whole(self) -> bool {
        self == Peer::Query || self.is_souffle()
    }

    /// The command for one run; the folder is that of [`write_case`].
    pub fn command(self, case: Case, folder: &Path) -> std::io::Result<Command> {
        let ours = std::env::current_exe()?;
        let program = folder.join("program.dl");
        let mut command = match self {
            Peer::Query => {
                let mut command = Command::new(ours);
                command
                    .env(AS_LOGICITY, "1")
                    .arg("query")
                    .arg(program)
                    .arg("-F")
                    .arg(folder);
                command
            }
            Peer::Souffle => {
                let mut command = Command::new("souffle");
                command.arg(program).arg("-F").arg(folder);
                command
            }
            Peer::SouffleCompiled => {
                let mut command = Command::new(folder.join("compiled"));
                command.arg("-F").arg(folder);
                command
            }
            _ => {
                let mut command = Command::new(ours);
                command.arg("once").arg(name(self)).arg(name(case));
                command
            }
        };
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        Ok(command)
    }
}

/// Writes the program and its facts, one file per predicate.
pub fn write_case(case: Case, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("program.dl"), case.program())?;
    let facts = case.facts();
    let write = |name: &str, text: String| std::fs::write(folder.join(format!("{name}.facts")), text);
    for (name, rows) in &facts.unary {
        let mut text = String::new();
        rows.iter().for_each(|x| _ = writeln!(text, "{x}"));
        write(name, text)?;
    }
    for (name, rows) in &facts.binary {
        let mut text = String::new();
        rows.iter().for_each(|(x, y)| _ = writeln!(text, "{x}\t{y}"));
        write(name, text)?;
    }
    Ok(())
}

/// The version of Soufflé, if it is installed.
pub fn souffle_version() -> Option<String> {
    let output = Command::new("souffle").arg("--version").output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text.lines().find(|line| line.contains("ersion"));
    Some(line.unwrap_or("unknown version").trim().to_owned())
}

/// Compiles the program in the folder with Soufflé.
pub fn compile(folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let mut command = Command::new("souffle");
    command
        .arg("-o")
        .arg(folder.join("compiled"))
        .arg(folder.join("program.dl"));
    let status = command.stdout(Stdio::null()).status()?;
    if status.success() {
        Ok(())
    } else {
        Err("souffle could not compile the program".into())
    }
}

/// The name of a value on the command line.
pub fn name(value: impl clap::ValueEnum) -> String {
    let value = value.to_possible_value().expect("no value is left out");
    value.get_name().to_owned()
}
