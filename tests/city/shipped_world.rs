//! Worlds of the shipped configurations, for tests and benches.
#![allow(dead_code, reason = "each target uses its own part")]

use logicity::builtin::{BuiltinFiles, ReadWith};
use logicity::config::Scenario;
use logicity::diag::{Diagnostic, Sources};
use logicity::files::{BUILTIN_FOLDER, ReadError, ReadFile, read_text};
use logicity::sim::{LoadError, LoadedCity, World};
use logicity::task::spf::SpfTask;
use std::cell::OnceCell;
use std::path::Path;
use std::sync::Arc;

/// The modes of the paper: the names of their configurations and rule files.
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

/// The modes of Safe Path Following.
pub const SPF_MODES: &[&str] = MODES.split_at(7).0;

/// A world of a built-in configuration, changed by `edit`, with its rules or those of `text`.
pub fn world(config: &str, text: Option<&str>, edit: impl FnOnce(&mut Scenario)) -> Arc<World> {
    load(config, &BuiltinFiles, text, edit).expect("built in").0
}

/// A world of a built-in configuration with its rules or those of `text`, and its sources.
pub fn with_sources(config: &str, text: Option<&str>) -> (Arc<World>, Sources) {
    load(config, &BuiltinFiles, text, |_| ()).expect("it is built in")
}

/// A world of the configuration with this text and these rules, changed by `edit`, and its sources.
pub fn configured(config: &str, rules: &str, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    let read = |path: &Path| match path.to_str() {
        Some("mine.yaml") => Ok(config.to_owned()),
        _ => BuiltinFiles.read(path),
    };
    load("mine.yaml", &read, Some(rules), edit).unwrap_or_else(|faults| panic!("{faults:?}"))
}

/// Safe Path Following in a built-in configuration, with its rules or those of `text`.
pub fn task(config: &str, text: Option<&str>) -> Arc<SpfTask> {
    let (world, sources) = load(config, &BuiltinFiles, text, |_| ()).expect("it is built in");
    Arc::new(SpfTask::new(world, &sources).unwrap_or_else(|faults| panic!("{faults:?}")))
}

/// Safe Path Following in the configuration with this text.
pub fn task_of(config: &str) -> Result<SpfTask, Vec<Diagnostic>> {
    let read = |path: &Path| match path.to_str() {
        Some("mine.yaml") => Ok(config.to_owned()),
        _ if path.starts_with(BUILTIN_FOLDER) => BuiltinFiles.read(path),
        _ => Err(ReadError::NotFound),
    };
    let (world, sources) = load("mine.yaml", &read, None, |_| ())?;
    SpfTask::new(world, &sources)
}

/// The world of a configuration in a file, with its rules.
pub fn of_file(path: &str) -> Arc<World> {
    let read = ReadWith(read_text);
    load(path, &read, None, |_| ())
        .unwrap_or_else(|faults| panic!("{faults:?}"))
        .0
}

fn load(
    config: &str,
    files: &dyn ReadFile,
    text: Option<&str>,
    edit: impl FnOnce(&mut Scenario),
) -> Result<(Arc<World>, Sources), Vec<Diagnostic>> {
    let mut sources = Sources::new();
    // The loader reads the rule file of the configuration before the files it includes.
    let named = OnceCell::new();
    let read = ReadWith(|path: &Path| match text {
        Some(text) if path.extension() == Some("dl".as_ref()) && named.get_or_init(|| path.to_owned()) == path => {
            Ok(text.to_owned())
        }
        _ => files.read(path),
    });
    let mut city = LoadedCity::load(&mut sources, Path::new(config), None, &read).map_err(|error| match error {
        LoadError::Config(faults) | LoadError::Rules(faults) => faults,
        LoadError::RuleFile(path, error) => panic!("{}: {error}", path.display()),
    })?;
    edit(&mut city.scenario);
    Ok((Arc::new(city.world()?), sources))
}
