//! The peers, and the commands of those that are separate programs.

use crate::case::{Case, Kind, name};
use std::error::Error;
use std::ffi::OsStr;
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
    /// datatoad, including startup and reading rules and facts
    Datatoad,
    /// A program compiled by FlowLog, including startup and reading facts
    Flowlog,
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
            Peer::Datatoad => "datatoad *",
            Peer::Flowlog => "FlowLog compiled *",
        })
    }
}

/// The environment variable that makes a process the `logicity` command.
pub const AS_LOGICITY: &str = "LOGICITY_PEERS_AS_LOGICITY";

impl Peer {
    /// All peers, logicity first.
    pub const ALL: [Peer; 10] = [
        Peer::Engine,
        Peer::Query,
        Peer::Ascent,
        Peer::Datafrog,
        Peer::Crepe,
        Peer::Differential,
        Peer::Souffle,
        Peer::SouffleCompiled,
        Peer::Datatoad,
        Peer::Flowlog,
    ];

    /// The programs on the path that peers need.
    pub const PROGRAMS: [&str; 3] = ["souffle", "datatoad", "flowlog-compiler"];

    /// Whether this program contains it or calls it.
    pub fn is_compiled(self) -> bool {
        cfg!(feature = "others") || !matches!(self, Peer::Ascent | Peer::Crepe | Peer::Differential)
    }

    /// The program on the path that it needs.
    pub fn program(self) -> Option<&'static str> {
        match self {
            Peer::Souffle | Peer::SouffleCompiled => Some("souffle"),
            Peer::Datatoad => Some("datatoad"),
            Peer::Flowlog => Some("flowlog-compiler"),
            _ => None,
        }
    }

    /// Whether the measurement covers the whole process.
    pub fn is_whole(self) -> bool {
        self == Peer::Query || self.program().is_some()
    }

    /// Whether it has the program. Peers that are libraries have some programs written for them.
    pub fn has(self, kind: Kind) -> bool {
        match self {
            Peer::Crepe | Peer::Datafrog => {
                matches!(kind, Kind::Closure | Kind::Generation | Kind::Pointsto | Kind::City)
            }
            #[cfg(feature = "others")]
            Peer::Differential => crate::differential::has(kind),
            // `for_datatoad` translates no negation.
            Peer::Datatoad => !matches!(kind, Kind::City | Kind::Borrows | Kind::Crdt),
            _ => true,
        }
    }

    /// Compiles or translates the program in the folder of [`write_case`].
    pub fn compile(self, case: Case, folder: &Path) -> Result<(), Box<dyn Error>> {
        let mut command = match self {
            Peer::SouffleCompiled => {
                let mut command = Command::new("souffle");
                command.arg("-o").arg(folder.join("compiled"));
                command.arg(folder.join("program.dl"));
                command
            }
            Peer::Datatoad => {
                std::fs::write(folder.join("program.dt"), for_datatoad(case, folder))?;
                return Ok(());
            }
            Peer::Flowlog => {
                let program = folder.join("program.flowlog.dl");
                std::fs::write(&program, for_flowlog(case.kind().program()))?;
                let mut command = Command::new("flowlog-compiler");
                command.arg(program).arg("-F").arg(folder);
                command.args(["-D", "-", "-o"]).arg(folder.join("flowlog"));
                command
            }
            _ => return Ok(()),
        };
        eprintln!("{case}: {self} compiles the program");
        let output = command.stdin(Stdio::null()).output()?;
        if output.status.success() {
            Ok(())
        } else {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(format!("{case}: {self} could not compile the program: {said}").into())
        }
    }

    /// The program and the arguments for one run; the folder is that of [`write_case`].
    pub fn command(self, case: Case, folder: &Path) -> std::io::Result<Command> {
        let ours = std::env::current_exe()?;
        let program = folder.join("program.dl");
        let of = |program: &Path, arguments: &[&OsStr]| {
            let mut command = Command::new(program);
            command.args(arguments);
            command
        };
        let facts: [&OsStr; 2] = ["-F".as_ref(), folder.as_ref()];
        let mut command = match self {
            Peer::Query => {
                let mut command = of(&ours, &["query".as_ref(), program.as_ref()]);
                command.env(AS_LOGICITY, "1").args(facts);
                command
            }
            Peer::Souffle => of("souffle".as_ref(), &[program.as_ref(), facts[0], facts[1]]),
            Peer::SouffleCompiled => of(&folder.join("compiled"), &facts),
            Peer::Datatoad => of("datatoad".as_ref(), &[folder.join("program.dt").as_ref()]),
            // It counts on standard error.
            Peer::Flowlog => of(
                "sh".as_ref(),
                &[
                    "-c".as_ref(),
                    "exec \"$0\" -w 1 2>&1".as_ref(),
                    folder.join("flowlog").as_ref(),
                ],
            ),
            _ => of(&ours, &["once".as_ref(), name(self).as_ref(), name(case).as_ref()]),
        };
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        Ok(command)
    }

    /// The number of rows of a predicate in what the whole process printed.
    pub fn printed_count(self, text: &str, predicate: &str) -> Option<usize> {
        let count = |line: &str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            match (self, &words[..]) {
                // `.list` of datatoad.
                (Peer::Datatoad, [count, found, "[forms:", ..]) if *found == predicate => count.parse().ok(),
                (Peer::Flowlog, [found, .., count]) if *found == format!("[size][{predicate}]") => {
                    count.strip_prefix("size=")?.parse().ok()
                }
                (_, [found, count]) if *found == predicate => count.parse().ok(),
                _ => None,
            }
        };
        text.lines().find_map(count)
    }
}

/// The lines of a program that are neither declarations nor comments.
fn rules(program: &str) -> impl Iterator<Item = &str> {
    program
        .lines()
        .filter(|line| !line.starts_with('.') && !line.starts_with("//"))
}

/// The rules with a command that reads each file of facts, and one that lists the relations.
fn for_datatoad(case: Case, folder: &Path) -> String {
    let facts = case.facts();
    let arities = (facts.unary.iter().map(|(name, _)| (*name, 1)))
        .chain(facts.binary.iter().map(|(name, _)| (*name, 2)))
        .chain(facts.ternary.iter().map(|(name, _)| (*name, 3)))
        .chain(facts.quaternary.iter().map(|(name, _)| (*name, 4)));
    let mut text = String::new();
    for (name, arity) in arities {
        let columns: Vec<String> = (0..arity).map(|at| format!(r"(?P<u32_{at}>\d+)")).collect();
        let (pattern, file) = (columns.join(r"\t"), folder.join(format!("{name}.facts")));
        writeln!(text, ".load {name} ^{pattern}$ {}", file.display()).expect("writing to a string cannot fail");
    }
    rules(case.kind().program()).for_each(|line| text.extend([line, "\n"]));
    text + ".list\n.quit\n"
}

/// The program with the types of FlowLog, and options at each `.input`.
fn for_flowlog(program: &str) -> String {
    let mut text = String::new();
    for line in program.lines() {
        match line.strip_prefix(".input ") {
            Some(names) => {
                for name in names.split(", ") {
                    text += &format!(".input {name}(IO=\"file\", filename=\"{name}.facts\", delimiter=\"\\t\")\n");
                }
            }
            None if line.starts_with(".decl") => text += &(line.replace(": number", ": int32") + "\n"),
            None => text.extend([line, "\n"]),
        }
    }
    text
}

/// Writes the program and its facts, one file per predicate.
pub fn write_case(case: Case, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("program.dl"), case.kind().program())?;
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
    for (name, rows) in &facts.ternary {
        let mut text = String::new();
        rows.iter().for_each(|[x, y, z]| _ = writeln!(text, "{x}\t{y}\t{z}"));
        write(name, text)?;
    }
    for (name, rows) in &facts.quaternary {
        let mut text = String::new();
        rows.iter()
            .for_each(|[x, y, z, w]| _ = writeln!(text, "{x}\t{y}\t{z}\t{w}"));
        write(name, text)?;
    }
    Ok(())
}

/// The version that a program on the path states, or `None` if there is no such program.
pub fn version(program: &str) -> Option<String> {
    // datatoad has no such option, and reads commands until the end of its input.
    let output = Command::new(program)
        .arg("--version")
        .stdin(Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text
        .lines()
        .find(|line| line.to_lowercase().contains("version") || line.starts_with(program));
    Some(line.unwrap_or("unknown version").trim().to_owned())
}
