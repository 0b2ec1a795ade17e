//! `logicity diff`: compares two rule sets.

mod given;
mod verdict;

use crate::builtin::BuiltinFiles;
use crate::cli::configuration::{Checked, open_run};
use crate::cli::failure::Failure;
use crate::cli::limits::MemoryOption;
use crate::cli::load::{compile, inputs_of, load_workspace};
use crate::cli::report::report;
use crate::cli::terminal;
use crate::cli::values::integer;
use crate::config::rule_file;
use crate::datalog::codes;
use crate::datalog::diff::{Equivalence, Options, diff, unsat_core};
use crate::datalog::{InputPolicy, Rules};
use crate::diag::{Diagnostic, Sources, to_json};
use crate::sim::{CityTheory, examine, scene_json};
use std::collections::HashSet;
use std::io::Write;
use std::path::PathBuf;
use verdict::Verdict;

#[derive(clap::Args)]
pub struct Arguments {
    /// First rule file
    left: PathBuf,
    /// Second rule file
    right: PathBuf,
    /// Predicates to compare, separated by commas [default: all outputs]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    predicates: Vec<String>,
    /// Compare only rows for which a condition holds, for example 'IsCar(X)'. X, Y, Z, ... are the columns of the
    /// compared predicates; other variables must occur with one of them
    #[arg(long, value_name = "BODY")]
    given: Option<String>,
    /// Compare the rules in the city of this configuration: only scenes of its agents, with the constraints that hold
    /// there instead of the declared ones
    #[arg(long, value_name = "CONFIG")]
    config: Option<PathBuf>,
    /// Compare scenes of at most this many entities
    #[arg(
        long,
        value_name = "COUNT",
        value_parser = integer(1..=usize::MAX),
        default_value_t = Options::default().entities_max,
    )]
    entities: usize,
    /// Stop the search after this many conflicts, or a tenth as many scenes where `diff` evaluates scenes one by one
    #[arg(long, value_name = "COUNT", value_parser = integer(0..=u64::MAX),
        default_value_t = Options::default().conflicts_max)]
    effort: u64,
    /// Print only a scene that shows a difference, as input for `logicity infer`
    #[arg(long, conflicts_with = "json")]
    scene: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

/// Returns exit code 0 if it finds no difference, 1 if it finds one.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<u8, Failure> {
    let city = match &arguments.config {
        None => None,
        Some(config) => Some(open_run(config, sources)?),
    };
    let theory = city.as_ref().and_then(Checked::theory);
    let paths = [&arguments.left, &arguments.right].map(|path| rule_file(path, &BuiltinFiles));
    let (sides, warnings) = load(&paths, city.as_ref(), sources)?;
    let mut sides = sides.map(|rules| in_city(rules, theory));
    let mut predicates = arguments.predicates.clone();
    if let Some(condition) = &arguments.given {
        (sides, predicates) = given::restrict(sources, &paths, sides, &predicates, condition, theory)?;
    }
    let agents = theory.map_or(usize::MAX, CityTheory::agents_max);
    let options = Options {
        predicates,
        entities_max: arguments.entities.min(agents),
        conflicts_max: arguments.effort,
        ..Options::default()
    };
    let equivalence = compare(&sides, &options, agents).map_err(|faults| {
        let is_option = |fault: &Diagnostic| fault.code == codes::RULE_MISMATCH && !arguments.predicates.is_empty();
        match faults.iter().all(is_option) {
            true => Failure::option(faults),
            false => Failure::Input(faults),
        }
    })?;
    let given = match &equivalence {
        Equivalence::Equivalent { .. } => needed(&sides, &options, sources)?,
        _ => Vec::new(),
    };
    let verdict = Verdict {
        equivalence: &equivalence,
        given: &given,
        city: theory.map(|theory| theory.scenario.name.as_str()),
    };
    let mut out = terminal::results(arguments.json || arguments.scene);
    if arguments.json {
        writeln!(out, "{}", verdict.json(&sides))?;
    } else if arguments.scene {
        if let Equivalence::Different(difference) = &equivalence {
            writeln!(out, "{}", scene_json(difference, &sides.each_ref()))?;
        }
    } else {
        let names = [&arguments.left, &arguments.right].map(|path| path.display().to_string());
        verdict.print(&mut out, &names, &sides)?;
    }
    out.flush()?;
    report(&warnings, sources);
    Ok(match equivalence {
        Equivalence::Different(_) => 1,
        _ => 0,
    })
}

/// Loads both rule sets, and compares them with the configuration if there is one. Also returns the warnings.
fn load(
    paths: &[PathBuf; 2],
    city: Option<&Checked>,
    sources: &mut Sources,
) -> Result<([Rules; 2], Vec<Diagnostic>), Failure> {
    let mut load = |path| {
        let mut texts = load_workspace(sources, path, InputPolicy::Fixed)?;
        texts.set_inputs(inputs_of(&texts, city.is_some()));
        compile(&texts)
    };
    let (left, mut warnings) = load(&paths[0])?;
    let (right, more) = load(&paths[1])?;
    warnings.extend(more);
    if let Some(city) = city {
        for (program, path) in [(&left, &paths[0]), (&right, &paths[1])] {
            warnings.extend(examine(program.rules(), city.theory(), sources).diagnostics);
            warnings.extend(city.bind(program, Some(path), sources));
        }
    }
    once(&mut warnings, sources);
    if warnings.iter().any(Diagnostic::is_error) {
        return Err(Failure::Input(warnings));
    }
    let sides = [left, right].map(|program| program.rules().with_draws_as_facts());
    Ok((sides, warnings))
}

/// Keeps each of several equal faults once: both sides may include the file with the fault.
fn once(faults: &mut Vec<Diagnostic>, sources: &Sources) {
    let mut known = HashSet::new();
    faults.retain(|fault| known.insert(to_json(std::slice::from_ref(fault), sources).to_string()));
}

/// Returns the rules with the constraints that hold in a city instead of the declared ones.
fn in_city(rules: Rules, theory: Option<&CityTheory>) -> Rules {
    match theory {
        None => rules,
        Some(theory) => Rules {
            constraints: theory.constraints(&rules).of_agents,
            functions: (theory.functions(&rules).into_iter())
                .chain(rules.functions.iter().cloned())
                .collect(),
            ..rules
        },
    }
}

/// Compares the rule sets in scenes of a city with at most this many agents.
fn compare(sides: &[Rules; 2], options: &Options, agents: usize) -> Result<Equivalence, Vec<Diagnostic>> {
    let mut equivalence = diff(&sides[0], &sides[1], options)?;
    if let Equivalence::NoneFound {
        entities: Some(entities),
        cut,
        ..
    } = &equivalence
        && cut.is_empty()
        && *entities >= agents
    {
        // No scene of the city has more agents.
        equivalence = Equivalence::Equivalent {
            entities: Some(*entities),
        };
    }
    if let Equivalence::Different(difference) = &mut equivalence {
        given::restore_names(difference);
    }
    Ok(equivalence)
}

/// The budget of the search for the constraints that a proof needs; see [`Options::conflicts_max`].
const CORE_EFFORT: u64 = 20_000;

/// Returns the constraints that a proof of equality needs, as text.
fn needed(sides: &[Rules; 2], options: &Options, sources: &Sources) -> Result<Vec<String>, Failure> {
    let options = Options {
        conflicts_max: options.conflicts_max.min(CORE_EFFORT),
        ..options.clone()
    };
    let core = unsat_core(&sides[0], &sides[1], &options)?;
    Ok(core.into_iter().map(|(one, rules)| one.show(rules, sources)).collect())
}
