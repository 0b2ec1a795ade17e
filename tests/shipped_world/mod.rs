//! Worlds of the shipped configurations, for tests and benches.

use logicity::config::{Scenario, load_scenario};
use logicity::diag::Sources;
use logicity::engine::Program;
use logicity::sim::World;
use logicity::{files, lang};
use std::path::Path;
use std::sync::Arc;

/// A world of a built-in configuration, changed by `edit`; with its rules, or those of `text`.
#[allow(dead_code)] // some tests want the texts as well
pub fn world(config: &str, text: Option<&str>, edit: impl FnOnce(&mut Scenario)) -> Arc<World> {
    with_sources(config, text, edit).0
}

/// The same, and the texts it was made of.
pub fn with_sources(config: &str, text: Option<&str>, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    let mut sources = Sources::new();
    let mut scenario = load_scenario(&mut sources, Path::new(config), &files::read_or_builtin).expect("built in");
    edit(&mut scenario);
    let entry = match text {
        Some(text) => sources.add("test.dl", text),
        None => {
            let rules = &scenario.rules.value;
            let text = files::read_or_builtin(rules).expect("built in");
            sources.add(rules.display().to_string(), text)
        }
    };
    let loaded = lang::load(&mut sources, entry, &files::read_or_builtin);
    let program = Program::new(loaded.rules.expect("clean rules")).expect("within limits");
    let world = World::new(scenario, program).expect("rules and configuration fit");
    (Arc::new(world), sources)
}
