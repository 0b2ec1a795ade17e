//! Loads rules, maps and cities that the command line names.

use crate::builtin::BuiltinFiles;
use crate::city::{Action, MapConfig};
use crate::cli::failure::Failure;
use crate::cli::inputs::{read_with, unreadable};
use crate::cli::kind::Kind;
use crate::cli::limits::LimitOptions;
use crate::cli::report::report;
use crate::cli::souffle::SouffleOptions;
use crate::config::{load_map, missing_file, rule_file};
use crate::datalog::{InputPolicy, Program, Workspace};
use crate::diag::{Diagnostic, Sources};
use crate::files::ReadFile;
use crate::rng::Seed;
use crate::sim::{Executor, Inference, LoadError, LoadedCity};
use std::path::Path;

impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        match error {
            LoadError::Config(faults) => missing_is_usage(faults),
            LoadError::RuleFile(path, error) => unreadable(&path, &error),
            LoadError::Rules(faults) => faults.into(),
        }
    }
}

/// Returns whether rules may derive `.input` predicates. A city computes its input, so no rule may derive that: the rules
/// are for a city if they are checked for one or declare an action.
pub fn inputs_of(texts: &Workspace, in_city: bool) -> InputPolicy {
    match in_city || Action::STANDARD.iter().any(|action| texts.declares(action.name())) {
        true => InputPolicy::Fixed,
        false => InputPolicy::Extensible,
    }
}

/// Checks and plans rules. Also returns the warnings.
pub fn compile(workspace: &Workspace) -> Result<(Program, Vec<Diagnostic>), Failure> {
    let loaded = workspace.check();
    match loaded.rules {
        Some(rules) => Ok((Program::new(rules)?, loaded.diagnostics)),
        None => Err(loaded.diagnostics.into()),
    }
}

/// Reads a rule file, given as a path or a bare name such as `hard`, and its includes.
pub fn load_workspace(sources: &mut Sources, path: &Path, inputs: InputPolicy) -> Result<Workspace, Failure> {
    load_workspace_from(sources, path, inputs, &SouffleOptions::default(), &BuiltinFiles)
}

/// Reads a rule file and its includes from `files`, as `options` say.
pub fn load_workspace_from(
    sources: &mut Sources,
    path: &Path,
    inputs: InputPolicy,
    options: &SouffleOptions,
    files: &dyn ReadFile,
) -> Result<Workspace, Failure> {
    let path = rule_file(path, files);
    let text = read_with(files, &path)?;
    if let Some(fault) = Kind::Rules.mismatch(&path, &text) {
        return Err(fault.into());
    }
    let entry = sources.add(path.display().to_string(), text);
    let mut workspace = options.workspace(inputs);
    workspace.add(sources, entry, files);
    Ok(workspace)
}

/// Loads a configuration with its rules, or those in the file `rules`, and prints the warnings. `limits` applies to
/// each tick or scene.
pub fn load_city(
    sources: &mut Sources,
    config: &Path,
    rules: Option<&Path>,
    limits: &LimitOptions,
) -> Result<LoadedCity, Failure> {
    refuse_other_kind(config, Kind::Configuration)?;
    if let Some(rules) = rules {
        refuse_other_kind(&rule_file(rules, &BuiltinFiles), Kind::Rules)?;
    }
    let mut city = LoadedCity::load(sources, config, rules, &BuiltinFiles)?;
    city.limits = limits.limits(city.limits);
    report(&city.warnings, sources);
    Ok(city)
}

/// Fails if the user names a file of another kind. A pipe, which is read once, is left to its reader.
fn refuse_other_kind(path: &Path, kind: Kind) -> Result<(), Failure> {
    let is_pipe = path.metadata().is_ok_and(|found| !found.is_file());
    let text = (!is_pipe).then(|| BuiltinFiles.read_or_builtin(path).ok()).flatten();
    match text.and_then(|text| kind.mismatch(path, &text)) {
        Some(fault) => Err(fault.into()),
        None => Ok(()),
    }
}

/// Returns what decides single scenes of a city.
pub fn inference_of(city: LoadedCity, seed: u64, executor: Executor, sources: &Sources) -> Result<Inference, Failure> {
    let mut inference = Inference::new(city.scenario, city.program, Seed(seed), executor, BuiltinFiles)?;
    inference.name_clauses(sources);
    inference.set_limits(city.limits);
    Ok(inference)
}

/// Reads a map, given as a path to a YAML file or as the name of a built-in map.
pub fn find_map(sources: &mut Sources, name: &str) -> Result<MapConfig, Failure> {
    load_map(sources, Path::new(name), &BuiltinFiles).map_err(missing_is_usage)
}

/// Reports a missing file as wrong usage if the command line names it, so that no text refers to it.
pub fn missing_is_usage(faults: Vec<Diagnostic>) -> Failure {
    match missing_file(&faults) {
        Some(fault) => {
            let help = fault.help.iter().map(|help| format!("\nhelp: {help}"));
            Failure::Usage(fault.message.clone() + &help.collect::<String>())
        }
        None => faults.into(),
    }
}
