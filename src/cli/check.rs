//! `logicity check`

use super::trace::TraceReader;
use super::{Failure, load_program, report};
use crate::diag::{Code, Diagnostic, Sources, to_json};
use crate::engine::provenance::Teller;
use crate::engine::{Program, optimize};
use crate::lang::{ClauseId, RelId, Rules};
use crate::sim::{Coverage, ENTITIES_MAX, Finding, Overlap, conflicts};
use serde_json::json;
use std::collections::HashSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule files; each is a program of its own. With --coverage, the rules of the run unless given
    #[arg(required_unless_present = "coverage", value_name = "RULES")]
    rules: Vec<PathBuf>,
    /// Print one JSON object a file instead: `file`, `ok`, `strata`, `conflicts`, `diagnostics`, with --coverage `coverage`
    #[arg(long)]
    json: bool,
    /// Tell how often each clause fires on the states of this trace, and which literals never matter there
    #[arg(long, value_name = "TRACE")]
    coverage: Option<PathBuf>,
    /// Configuration of the run that wrote the trace, if it is no longer where the trace says
    #[arg(long, requires = "coverage")]
    config: Option<PathBuf>,
    /// Also tell literals and clauses that are true and needless
    #[arg(long)]
    lints: bool,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut out = anstream::stdout();
    let mut told = HashSet::new();
    let mut diagnostics: Vec<Diagnostic> = Vec::new();
    let mut unreadable = Vec::new();
    let mut paths = arguments.rules.clone();
    if let (Some(trace), true) = (&arguments.coverage, paths.is_empty()) {
        paths.push(TraceReader::open(trace)?.header.rules.into());
    }
    for path in &paths {
        let (program, mut found) = match load_program(sources, path) {
            Ok((program, warnings)) => (Some(program), warnings),
            Err(Failure::Input(faults)) => (None, faults),
            Err(Failure::Usage(message)) => {
                unreadable.push(message);
                continue;
            }
            Err(other) => return Err(other),
        };
        if let Some(rules) = program.as_ref().map(Program::rules) {
            let lints = optimize::lints(rules).into_iter();
            // What is needless may be there for the reader.
            found.extend(lints.filter(|lint| arguments.lints || lint.code == Code::ContradictoryBody));
        }
        let overlaps = program.as_ref().map(conflicts);
        let covered = match (&arguments.coverage, &program) {
            (Some(trace), Some(_)) => Some(measure(arguments, trace, path, sources)?),
            _ => None,
        };
        if arguments.json {
            let rules = program.as_ref().map(Program::rules);
            let mut line = json!({
                "file": path.display().to_string(),
                "ok": rules.is_some(),
                "strata": rules.map(strata),
            });
            if let (Some(rules), Some(overlaps)) = (rules, &overlaps) {
                line["conflicts"] = overlaps_json(overlaps, rules, sources);
            }
            if let (Some(rules), Some(covered)) = (rules, &covered) {
                line["coverage"] = coverage_json(covered, rules, sources);
            }
            line["diagnostics"] = to_json(&found, sources);
            writeln!(out, "{line}")?;
        } else if let Some(rules) = program.as_ref().map(Program::rules) {
            let strata: Vec<String> = strata(rules).iter().map(|names| names.join(", ")).collect();
            writeln!(out, "{}: {} clauses", path.display(), rules.clauses.len())?;
            writeln!(out, "  strata: {}", strata.join(" < "))?;
            tell_overlaps(&mut out, overlaps.as_deref().unwrap_or_default(), rules, sources)?;
            if let (Some(covered), Some(trace)) = (&covered, &arguments.coverage) {
                tell_coverage(&mut out, covered, trace, rules, sources)?;
            }
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

/// The names of the predicates of each stratum, hidden ones left out, in the order in which they are computed.
fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    let shown = |relation: &&RelId| !rules.relations[relation.index()].hidden;
    let name = |relation: &RelId| rules.relations[relation.index()].name.as_str();
    let strata = rules.strata.iter();
    let strata = strata.map(|stratum| stratum.relations.iter().filter(shown).map(name).collect::<Vec<_>>());
    strata.filter(|names| !names.is_empty()).collect()
}

/// Nothing for programs that have fewer than two actions.
fn tell_overlaps(out: &mut impl Write, overlaps: &[Overlap], rules: &Rules, sources: &Sources) -> io::Result<()> {
    let teller = Teller::new(rules, &rules.symbols, sources);
    let mut told = false;
    for Overlap { actions, finding } in overlaps {
        let [first, second] = actions.map(|action| action.name());
        match finding {
            Finding::Excluded => {}
            Finding::Together { clauses, scene } => {
                let [a, b] = clauses.map(|clause| teller.title(clause));
                writeln!(
                    out,
                    "  conflicts: {first} and {second} can be derived together, as in this scene:"
                )?;
                writeln!(out, "    {}", scene.to_json())?;
                writeln!(out, "    {first} by {a}\n    {second} by {b}")?;
                told = true;
            }
            Finding::NotFound { scenes, all } => {
                let bound = if *all { "" } else { "; the search was cut short" };
                let bound = format!("{scenes} scenes of up to {ENTITIES_MAX} agents{bound}");
                writeln!(out, "  conflicts: none found for {first} and {second} in {bound}")?;
                told = true;
            }
        }
    }
    if !told && !overlaps.is_empty() {
        writeln!(out, "  conflicts: none")?;
    }
    Ok(())
}

fn overlaps_json(overlaps: &[Overlap], rules: &Rules, sources: &Sources) -> serde_json::Value {
    let teller = Teller::new(rules, &rules.symbols, sources);
    let told = overlaps.iter().map(|Overlap { actions, finding }| {
        let actions = actions.map(|action| action.name());
        match finding {
            Finding::Excluded => json!({ "actions": actions, "finding": "excluded" }),
            Finding::Together { clauses, scene } => json!({
                "actions": actions,
                "finding": "together",
                "clauses": clauses.map(|clause| teller.clause_json(clause)),
                "scene": scene.to_json(),
            }),
            Finding::NotFound { scenes, all } => {
                json!({ "actions": actions, "finding": "not-found", "scenes": scenes, "all": all })
            }
        }
    });
    told.collect()
}

/// The clauses of a rule file over the states of a trace.
fn measure(arguments: &Arguments, trace: &Path, rules: &Path, sources: &mut Sources) -> Result<Coverage, Failure> {
    let mut trace = TraceReader::open(trace)?;
    // Other rules than those of the run may be asked about on purpose.
    let strict = arguments.rules.is_empty();
    let mut replay = trace.replay(sources, arguments.config.as_deref(), Some(rules), strict)?;
    let mut coverage = Coverage::new(replay.session().program().rules());
    while let Some(tick) = trace.tick()? {
        replay.set(&tick).map_err(|fault| trace.placed(fault))?;
        let added = coverage.add(replay.session());
        added.map_err(|error| trace.placed(Diagnostic::new(Code::LimitExceeded, error.to_string())))?;
    }
    Ok(coverage)
}

/// The literals as they stand in the clause.
fn idle(teller: &Teller<'_>, rules: &Rules, clause: ClauseId, idle: &[usize]) -> Vec<String> {
    let clause = &rules.clauses[clause.index()];
    let open = vec![None; clause.variables.len()];
    let literals = idle.iter().map(|&literal| &clause.body[literal]);
    literals.map(|literal| teller.literal(clause, literal, &open)).collect()
}

fn tell_coverage(
    out: &mut impl Write,
    coverage: &Coverage,
    trace: &Path,
    rules: &Rules,
    sources: &Sources,
) -> io::Result<()> {
    let teller = Teller::new(rules, &rules.symbols, sources);
    writeln!(out, "  coverage: {} ticks of {}", coverage.states, trace.display())?;
    writeln!(out, "{:>10}{:>8}  clause", "fired", "ticks")?;
    for clause in &coverage.clauses {
        let head = &rules.relations[rules.clauses[clause.clause.index()].head.relation.index()].name;
        let title = teller.title(clause.clause);
        writeln!(out, "{:>10}{:>8}  {head:<8}{title}", clause.fired, clause.states)?;
        if clause.fired > 0 && !clause.idle.is_empty() {
            let literals = idle(&teller, rules, clause.clause, &clause.idle).join(", ");
            writeln!(out, "{:>28}never mattered: {literals}", "")?;
        }
    }
    Ok(())
}

fn coverage_json(coverage: &Coverage, rules: &Rules, sources: &Sources) -> serde_json::Value {
    let teller = Teller::new(rules, &rules.symbols, sources);
    let clauses: Vec<serde_json::Value> = (coverage.clauses.iter())
        .map(|clause| {
            json!({
                "clause": teller.clause_json(clause.clause),
                "fired": clause.fired,
                "ticks": clause.states,
                "never_mattered": idle(&teller, rules, clause.clause, &clause.idle),
            })
        })
        .collect();
    json!({ "ticks": coverage.states, "clauses": clauses })
}
