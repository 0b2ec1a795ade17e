//! `logicity query`

use super::{Failure, load_rules, report};
use crate::diag::{Code, Diagnostic, Sources};
use crate::engine::{Program, Session, facts};
use crate::files::{self, Output, ReadError};
use crate::lang::{MarkKind, RelId, RowPlace};
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule file
    rules: PathBuf,
    /// Folder with one NAME.facts for each input relation: one row a line, values separated by tabs. The options of `.input`
    /// may say otherwise
    #[arg(short = 'F', long, value_name = "DIR", default_value = ".")]
    facts: PathBuf,
    /// Folder for one NAME.csv for each output relation; `-` is standard output
    #[arg(short = 'D', long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let (rules, warnings) = load_rules(sources, &arguments.rules)?;
    report(&warnings, sources);
    let program = Program::new(rules)?;
    let mut session = program.session();
    load_inputs(&arguments.facts, &mut session, sources)?;
    session
        .commit()
        .map_err(|error| Diagnostic::new(Code::LimitExceeded, error.to_string()))?;

    let mut out = anstream::stdout();
    for (id, relation) in relations(&program) {
        for directive in &relation.directives {
            match directive.kind {
                MarkKind::Input => {}
                MarkKind::Output => {
                    let text = facts::print_as(&session, id, &directive.format);
                    let path = match &directive.place {
                        _ if arguments.output == Path::new("-") => None,
                        RowPlace::Terminal => None,
                        RowPlace::Usual => Some(arguments.output.join(format!("{}.csv", relation.name))),
                        RowPlace::File(name) => Some(arguments.output.join(name)),
                    };
                    match path {
                        Some(path) => write_relation(&path, &text)?,
                        None => print_relation(&mut out, &relation.name, &text, directive.format.headers)?,
                    }
                }
                MarkKind::PrintSize => writeln!(out, "{}\t{}", relation.name, session.len(id))?,
            }
        }
    }
    Ok(())
}

/// Prints a relation between rules, its header above them.
fn print_relation(out: &mut impl Write, name: &str, text: &str, headers: bool) -> std::io::Result<()> {
    let (header, rows) = match text.split_once('\n') {
        Some((header, rows)) if headers => (format!("{header}\n"), rows),
        _ => (String::new(), text),
    };
    let rule = "-".repeat(15);
    write!(out, "{rule}\n{name}\n{header}===============\n{rows}===============\n")
}

/// The declared relations in the order of the text.
fn relations(program: &Program) -> impl Iterator<Item = (RelId, &crate::lang::Relation)> {
    let relations = program.rules().relations.iter().enumerate();
    relations.map(|(index, relation)| {
        let id = RelId(u32::try_from(index).expect("fewer than 2^32 relations"));
        (id, relation)
    })
}

/// Reads the facts of every input relation. All faulty files are told in one run.
fn load_inputs(folder: &Path, session: &mut Session, sources: &mut Sources) -> Result<(), Failure> {
    let program = session.program().clone();
    let mut faults = Vec::new();
    for (id, relation) in relations(&program) {
        for directive in relation
            .directives
            .iter()
            .filter(|directive| directive.kind == MarkKind::Input)
        {
            let path = match &directive.place {
                RowPlace::Usual => folder.join(format!("{}.facts", relation.name)),
                RowPlace::File(name) => folder.join(name),
                RowPlace::Terminal => PathBuf::from("standard input"),
            };
            let text = match directive.place {
                RowPlace::Terminal => files::read_from(std::io::stdin()),
                _ => files::read_text(&path),
            };
            match text {
                Ok(text) => {
                    let source = sources.add(path.display().to_string(), text);
                    if let Err(found) = facts::load_as(session, id, sources, source, &directive.format) {
                        faults.extend(found);
                    }
                }
                Err(ReadError::NotText { line }) => faults.push(Diagnostic::new(
                    Code::NotText,
                    format!("line {line} of `{}` is not UTF-8 text", path.display()),
                )),
                Err(error) => {
                    return Err(Failure::Usage(format!(
                        "cannot read the facts of `{}` from `{}`: {error}",
                        relation.name,
                        path.display()
                    )));
                }
            }
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults.into()) }
}

fn write_relation(path: &Path, text: &str) -> Result<(), Failure> {
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|error| Failure::file("make the folder", folder, error))?;
    let fail = |error: std::io::Error| Failure::file("write", path, error);
    let mut file = Output::create(path).map_err(fail)?;
    file.write_all(text.as_bytes()).map_err(fail)?;
    file.finish().map_err(fail)
}
