//! Worlds of the shipped configurations, for tests and benches.
#![allow(dead_code, reason = "each target uses its own part")]

use logicity::builtin::BuiltinFiles;
use logicity::builtin::read_or_builtin;
use logicity::config::{Scenario, load_scenario};
use logicity::datalog::Program;
use logicity::diag::{Diagnostic, Sources};
use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile};
use logicity::sim::World;
use logicity::task::spf::SpfTask;
use std::path::Path;
use std::sync::Arc;

/// The modes of the paper: configurations, and rule files of the same names.
pub const MODES: &[&str] = &[
    "easy",
    "medium",
    "hard",
    "expert",
    "transfer-easy",
    "transfer-medium",
    "transfer-hard",
    "vap-easy",
    "vap-hard",
];

/// Those of Safe Path Following.
pub const PATH_MODES: &[&str] = MODES.split_at(7).0;

/// A world of a built-in configuration, changed by `edit`; with its rules, or those of `text`.
pub fn world(config: &str, text: Option<&str>, edit: impl FnOnce(&mut Scenario)) -> Arc<World> {
    load(config, &BuiltinFiles, text, edit).expect("it is built in").0
}

/// A world of a built-in configuration with its rules, or those of `text`, and the texts it was made of.
pub fn with_sources(config: &str, text: Option<&str>) -> (Arc<World>, Sources) {
    load(config, &BuiltinFiles, text, |_| ()).expect("it is built in")
}

/// Safe Path Following in a built-in configuration; with its rules, or those of `text`.
pub fn task(config: &str, text: Option<&str>) -> Arc<SpfTask> {
    let (world, sources) = load(config, &BuiltinFiles, text, |_| ()).expect("it is built in");
    Arc::new(SpfTask::new(world, &sources).unwrap_or_else(|faults| panic!("{faults:?}")))
}

/// Safe Path Following as the text of a configuration has it.
pub fn task_of(config: &str) -> Result<SpfTask, Vec<Diagnostic>> {
    let read = |path: &Path| match path.to_str() {
        Some("mine.yaml") => Ok(config.to_owned()),
        _ if path.starts_with(BUILTIN_FOLDER) => BuiltinFiles.read(path),
        _ => Err(ReadError::NotFound),
    };
    let (world, sources) = load("mine.yaml", &read, None, |_| ())?;
    SpfTask::new(world, &sources)
}

fn load(
    config: &str,
    read: &dyn ReadFile,
    text: Option<&str>,
    edit: impl FnOnce(&mut Scenario),
) -> Result<(Arc<World>, Sources), Vec<Diagnostic>> {
    let mut sources = Sources::new();
    let mut scenario = load_scenario(&mut sources, Path::new(config), read)?;
    edit(&mut scenario);
    let name = scenario.rules.value.display().to_string();
    let rules = text.map_or_else(
        || read_or_builtin(&scenario.rules.value).expect("built in"),
        str::to_owned,
    );
    let entry = sources.add(name, rules);
    let (program, faults) = Program::load(&mut sources, entry, &BuiltinFiles);
    let world = World::new(scenario, program.ok_or(faults)?)?;
    Ok((Arc::new(world), sources))
}
