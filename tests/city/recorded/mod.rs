//! Recorded runs of the published simulator: the files of `tests/recorded` and of the folder `LOGICITY_CASES`.

mod decisions;
mod map;
mod moves;
mod steps;

use crate::shipped_world::MODES;
use flate2::read::GzDecoder;
use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, AgentConfig, AgentKind, AgentName};
use logicity::city::{Cell, CityMap, Heading};
use logicity::config::load_map;
use logicity::diag::Sources;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The folder in the repository.
fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recorded")
}

/// A recorded file, named `KIND_TAG.jsonl.gz`.
struct Recording {
    path: PathBuf,
    kind: &'static str,
    tag: String,
}

/// The recorded files of a kind: `trace`, `paths` or `gym`.
fn recordings(kind: &'static str) -> Vec<Recording> {
    let mut found = recordings_in(&folder(), kind);
    assert!(!found.is_empty(), "tests/recorded has no {kind}_*.jsonl.gz");
    if let Some(more) = std::env::var_os("LOGICITY_CASES").map(PathBuf::from) {
        let kinds = ["trace", "paths", "gym"];
        let any = kinds.iter().any(|kind| !recordings_in(&more, kind).is_empty());
        assert!(any, "LOGICITY_CASES: no recorded file in {}", more.display());
        found.extend(recordings_in(&more, kind));
    }
    found
}

fn recordings_in(folder: &Path, kind: &'static str) -> Vec<Recording> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let recording = |path: PathBuf| {
        let name = path.file_name()?.to_str()?;
        let tag = name.strip_prefix(kind)?.strip_prefix('_')?.strip_suffix(".jsonl.gz")?;
        let tag = tag.to_owned();
        Some(Recording { path, kind, tag })
    };
    paths.into_iter().filter_map(recording).collect()
}

impl Recording {
    /// The lines of the file.
    fn lines(&self) -> impl Iterator<Item = Value> {
        let file = File::open(&self.path).unwrap();
        let lines = BufReader::new(GzDecoder::new(file)).lines();
        lines.map(|line| serde_json::from_str(&line.unwrap()).unwrap())
    }

    /// The shipped configuration with the rules of the recorded run. `None` if the tag is no shipped mode.
    fn mode(&self) -> Option<&'static str> {
        let name = self.tag.replace('_', "-");
        MODES.iter().copied().find(|mode| *mode == name)
    }

    /// The recording of another kind with the same tag, in the same folder.
    fn beside(&self, kind: &'static str) -> Option<Recording> {
        let same = |other: &Recording| other.tag == self.tag;
        let folder = self.path.parent().expect("a file is in a folder");
        recordings_in(folder, kind).into_iter().find(same)
    }

    /// Prints what was compared, even if the test passes.
    fn report(&self, text: &str) {
        // The test harness captures `println!` and `eprintln!`.
        let _ = writeln!(std::io::stderr(), "recorded {}_{}: {text}", self.kind, self.tag);
    }
}

/// The map of the recorded runs.
fn square_5x5() -> CityMap {
    let config = load_map(&mut Sources::new(), Path::new("square-5x5"), &BuiltinFiles).expect("a built-in map");
    CityMap::generate(&config).expect("the map of the paper can be generated")
}

fn index(value: &Value) -> usize {
    usize::try_from(value.as_u64().unwrap()).unwrap()
}

fn cell(value: &Value) -> Cell {
    let coordinate = |index: usize| i32::try_from(value[index].as_i64().unwrap()).unwrap();
    Cell::new(coordinate(0), coordinate(1))
}

/// A route. Its cells may repeat in a row.
fn cells(value: &Value) -> Vec<Cell> {
    let mut cells: Vec<Cell> = value.as_array().unwrap().iter().map(cell).collect();
    cells.dedup();
    cells
}

fn kind(value: &Value) -> AgentKind {
    match value.as_str().unwrap() {
        "Car" => AgentKind::Car,
        "Pedestrian" => AgentKind::Pedestrian,
        other => panic!("unknown kind of agent: {other}"),
    }
}

fn heading(value: &Value) -> Option<Heading> {
    value.as_str().map(|name| Heading::from_name(name).unwrap())
}

/// The actions that the solver found; Normal if there is none.
fn solved(ego: &Value) -> BTreeSet<Action> {
    let named = |name: &Value| Action::STANDARD.into_iter().find(|action| name == action.name());
    let solved = ego["z3"].as_array().unwrap().iter();
    let mut actions: BTreeSet<Action> = solved.map(|name| named(name).unwrap()).collect();
    if actions.is_empty() {
        actions.insert(Action::Normal);
    }
    actions
}

/// An agent of this kind; its other properties do not matter.
fn plain_agent(kind: AgentKind) -> AgentConfig {
    AgentConfig {
        name: AgentName::standard(kind, 1),
        concepts: Arc::default(),
        priority: 0,
    }
}
