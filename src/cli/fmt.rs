//! `logicity fmt`: formats rule files.

use crate::builtin::BuiltinFiles;
use crate::cli::failure::Failure;
use crate::cli::inputs::{read, unreadable};
use crate::cli::kind::Kind;
use crate::cli::limits::MemoryOption;
use crate::cli::outputs::{finish, unwritable};
use crate::cli::terminal;
use crate::config::rule_file;
use crate::datalog;
use crate::diag::{Diagnostic, Sources};
use crate::files::{self, Output};
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule files to format in place; `-` formats standard input to standard output
    #[arg(required = true, value_name = "RULES")]
    rules: Vec<PathBuf>,
    /// Write nothing; list the files that are not formatted, and exit with code 1 if there are any
    #[arg(long)]
    check: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut out = terminal::results(!arguments.check);
    let mut faults: Vec<Diagnostic> = Vec::new();
    let mut clean = true;
    for path in &arguments.rules {
        let path = &rule_file(path, &BuiltinFiles);
        let is_stdin = path == Path::new("-");
        let text = if is_stdin {
            files::read_from(std::io::stdin().lock()).map_err(|error| unreadable(path, &error))?
        } else {
            read(path)?
        };
        if let Some(fault) = Kind::Rules.mismatch(path, &text) {
            faults.push(fault);
            continue;
        }
        let source = sources.add(path.display().to_string(), text);
        let formatted = match datalog::format(sources, source) {
            Ok(formatted) => formatted,
            Err(found) => {
                faults.extend(found);
                continue;
            }
        };
        let same = formatted == sources.text(source);
        clean &= same;
        if arguments.check {
            if !same {
                writeln!(out, "{}", path.display())?;
            }
        } else if is_stdin {
            write!(out, "{formatted}")?;
        } else if !same {
            let fail = |error: std::io::Error| unwritable(path, &error);
            let mut file = Output::edit(path).map_err(fail)?;
            file.write_all(formatted.as_bytes()).map_err(fail)?;
            finish(file, path)?;
            let _ = writeln!(terminal::err(), "wrote {}", path.display());
        }
    }
    if !faults.is_empty() {
        return Err(faults.into());
    }
    if arguments.check && !clean {
        Err(Failure::Reported)
    } else {
        Ok(())
    }
}
