//! `logicity check`

use super::{Failure, load_program, report};
use crate::diag::{Code, Diagnostic, Sources, to_json};
use crate::engine::{Program, optimize};
use crate::lang::{RelId, Rules};
use serde_json::json;
use std::collections::HashSet;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule files; each is a program of its own
    #[arg(required = true, value_name = "RULES")]
    rules: Vec<PathBuf>,
    /// Print one JSON object a file instead: `file`, `ok`, `strata`, `diagnostics`
    #[arg(long)]
    json: bool,
    /// Also tell literals and clauses that are true and needless
    #[arg(long)]
    lints: bool,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut out = anstream::stdout();
    let mut told = HashSet::new();
    let mut diagnostics: Vec<Diagnostic> = Vec::new();
    let mut unreadable = Vec::new();
    for path in &arguments.rules {
        let (program, mut found) = match load_program(sources, path) {
            Ok((program, warnings)) => (Some(program), warnings),
            Err(Failure::Input(faults)) => (None, faults),
            Err(Failure::Usage(message)) => {
                unreadable.push(message);
                continue;
            }
            Err(other) => return Err(other),
        };
        let rules = program.as_ref().map(Program::rules);
        if let Some(rules) = rules {
            let lints = optimize::lints(rules).into_iter();
            // What is needless may be there for the reader.
            found.extend(lints.filter(|lint| arguments.lints || lint.code == Code::ContradictoryBody));
        }
        if arguments.json {
            let line = json!({
                "file": path.display().to_string(),
                "ok": rules.is_some(),
                "strata": rules.map(strata),
                "diagnostics": to_json(&found, sources),
            });
            writeln!(out, "{line}")?;
        } else if let Some(rules) = rules {
            let strata: Vec<String> = strata(rules).iter().map(|names| names.join(", ")).collect();
            writeln!(out, "{}: {} clauses", path.display(), rules.clauses.len())?;
            writeln!(out, "  strata: {}", strata.join(" < "))?;
        }
        // A fault in a file that several programs include is told once.
        diagnostics.extend(
            found
                .into_iter()
                .filter(|fault| told.insert(to_json(std::slice::from_ref(fault), sources).to_string())),
        );
    }
    let faulty = diagnostics.iter().any(Diagnostic::is_error);
    if !arguments.json {
        report(&diagnostics, sources);
    }
    if !unreadable.is_empty() {
        return Err(Failure::Usage(unreadable.join("\nerror: ")));
    }
    if faulty { Err(Failure::Told) } else { Ok(()) }
}

/// The names of the predicates of each stratum, in the order in which they are computed.
fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    let name = |relation: &RelId| rules.relations[relation.index()].name.as_str();
    rules
        .strata
        .iter()
        .map(|stratum| stratum.relations.iter().map(name).collect())
        .collect()
}
