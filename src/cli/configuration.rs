//! Checks a configuration for `logicity check`: its files, and whether rules, map and agents fit together.

use crate::builtin::BuiltinFiles;
use crate::city::{CityMap, MapConfig, Terrain};
use crate::cli::failure::Failure;
use crate::cli::load::missing_is_usage;
use crate::cli::report::agents_in_words;
use crate::config::{ActionsConfig, Loaded, Scenario, SpfConfig, load_any, missing_file};
use crate::datalog::Program;
use crate::diag::{Diagnostic, Sources, Span, counted};
use crate::files::ReadFile as _;
use crate::located::Located;
use crate::rng::Seed;
use crate::sim::{CityTheory, Settings, Simulation, Unprovided, World};
use crate::task::spf::SpfTask;
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

/// The content of a file named on the command line.
pub enum Opened {
    Rules,
    Run(Checked),
    Map(Checked),
    /// A configuration with errors.
    Faulty(Vec<Diagnostic>),
}

/// The contents of a valid configuration.
pub struct Checked {
    map: MapConfig,
    /// Rows and columns of cells.
    size: [i32; 2],
    scenario: Option<Box<Scenario>>,
    theory: Option<Box<CityTheory>>,
}

/// Reads a file, unless it is a rule file. A bare name without a file means a built-in configuration.
pub fn open(path: &Path, sources: &mut Sources) -> Result<Opened, Failure> {
    let is_yaml = (path.extension()).is_some_and(|ending| ending == "yaml" || ending == "yml");
    let is_bare = path.extension().is_none() && path.components().count() == 1 && !path.is_file();
    let named = ["configs", "configs/maps"].map(|folder| Path::new(folder).join(path).with_extension("yaml"));
    let named = named
        .iter()
        .find(|named| is_bare && BuiltinFiles.read_or_builtin(named).is_ok());
    if !is_yaml && named.is_none() {
        return Ok(Opened::Rules);
    }
    let path = named.map_or(path, |named| named.as_path());
    let (map, scenario) = match load_any(sources, path, &BuiltinFiles) {
        Ok(Loaded::Map(map)) => (map, None),
        Ok(Loaded::Scenario(scenario)) => (scenario.map.clone(), Some(scenario)),
        Err(faults) if missing_file(&faults).is_some() => return Err(missing_is_usage(faults)),
        Err(faults) => return Ok(Opened::Faulty(faults)),
    };
    Ok(match CityMap::generate(&map) {
        Err(fault) => Opened::Faulty(vec![fault]),
        Ok(city) => {
            let theory = scenario.as_deref().map(|scenario| CityTheory::new(scenario.clone()));
            let checked = Checked {
                map,
                size: [city.rows(), city.cols()],
                theory: theory.transpose()?.map(Box::new),
                scenario,
            };
            match checked.scenario {
                None => Opened::Map(checked),
                Some(_) => Opened::Run(checked),
            }
        }
    })
}

/// Reads the run configuration that an option `--config` names.
pub fn open_run(path: &Path, sources: &mut Sources) -> Result<Checked, Failure> {
    match open(path, sources)? {
        Opened::Run(run) => Ok(run),
        Opened::Faulty(faults) => Err(faults.into()),
        Opened::Map(_) | Opened::Rules => {
            let message = format!("--config expects a run configuration, not `{}`", path.display());
            Err(Failure::Usage(message))
        }
    }
}

/// Describes a task in a line.
fn in_words(task: &SpfConfig) -> String {
    let mut text = "Safe Path Following".to_owned();
    if let Some(egos) = task.egos {
        text += &format!(", {}", counted(egos.value, "ego"));
    }
    if let Some(sensors) = &task.sensors {
        text += &format!(", sensors ({})", sensors.output.name());
        if let Some(share) = sensors.share {
            text += &format!(", up to {} by {}", counted(share.facts, "told fact"), share.by.name());
        }
    }
    if let Some(shield) = &task.shield {
        text += &format!(", shield ({}, {})", shield.value.mode.name(), shield.value.query.name());
    }
    text
}

impl Checked {
    /// Prepares a scenario to judge rules.
    ///
    /// # Errors
    /// The map cannot be generated.
    pub fn from_scenario(scenario: Scenario) -> Result<Checked, Diagnostic> {
        let city = CityMap::generate(&scenario.map)?;
        Ok(Checked {
            map: scenario.map.clone(),
            size: [city.rows(), city.cols()],
            theory: Some(Box::new(CityTheory::new(scenario.clone())?)),
            scenario: Some(Box::new(scenario)),
        })
    }

    /// Returns the path of the rule file. A map has none.
    pub fn rules(&self) -> &Path {
        let scenario = self.scenario.as_ref();
        scenario.map_or(Path::new(""), |scenario| &scenario.rules.value)
    }

    /// Returns the configuration, prepared to judge rules. A map has none.
    pub fn theory(&self) -> Option<&CityTheory> {
        self.theory.as_deref()
    }

    /// Returns the actions and their order of precedence: those of the standard for a map.
    pub fn actions(&self) -> ActionsConfig {
        let scenario = self.scenario.as_ref();
        scenario.map_or_else(ActionsConfig::default, |scenario| scenario.actions.clone())
    }

    /// Binds the predicates to the rules, creates the task and places the agents of each split. Returns the errors.
    /// `rules` is the rule file, if it is not that of the configuration.
    pub fn bind(&self, program: &Program, rules: Option<&Path>, sources: &Sources) -> Vec<Diagnostic> {
        let Some(scenario) = &self.scenario else {
            return Vec::new();
        };
        let mut scenario = (**scenario).clone();
        let entry = rules.and_then(|rules| {
            let name = rules.display().to_string();
            sources.ids().find(|&id| sources.name(id) == name)
        });
        if let (Some(rules), Some(entry)) = (rules, entry) {
            scenario.rules = Located {
                value: rules.to_owned(),
                span: Span::new(entry, 0..0),
            };
        }
        let mut world = match World::new(scenario, program.clone()) {
            Ok(world) => world,
            Err(faults) => return faults,
        };
        // No tick runs here.
        if let Err(fault) = world.set_external(Arc::new(Unprovided::of(&world.vocabulary))) {
            return vec![fault];
        }
        let world = Arc::new(world);
        let scenario = &world.scenario;
        let mut faults = Vec::new();
        if scenario.task.is_some() {
            faults.extend(SpfTask::new(Arc::clone(&world), sources).err().into_iter().flatten());
        }
        for (split, _) in &scenario.splits {
            let placed = Simulation::new(Arc::clone(&world), *split, Seed(0), Settings::default());
            faults.extend(placed.err());
        }
        faults
    }

    pub fn json(&self) -> Value {
        let mut map = json!({ "name": self.map.name });
        match &self.map.terrain {
            Terrain::Blocks(blocks) => map["blocks"] = json!(blocks.blocks.value),
            Terrain::Roads { roads } => {
                let roads = &roads.value;
                map["lanes"] = json!(roads.lanes.len());
                map["junctions"] = json!(roads.junctions.len());
                map["connections"] = json!(roads.connections.len());
            }
        }
        map["cells"] = json!(self.size);
        let Some(scenario) = &self.scenario else {
            return json!({ "map": map });
        };
        let agents: serde_json::Map<String, Value> = (scenario.splits.iter())
            .map(|(split, set)| {
                let counts = scenario.kinds.all().map(|kind| {
                    let key = scenario.kinds.key(kind).to_owned();
                    (key, json!(set.count_of(kind)))
                });
                (split.name().to_owned(), counts.collect::<serde_json::Value>())
            })
            .collect();
        json!({
            "map": map,
            "rules": scenario.rules.value.display().to_string(),
            "agents": agents,
            "task": scenario.task.is_some(),
        })
    }

    pub fn print(&self, out: &mut impl Write, path: &Path) -> io::Result<()> {
        let streets = match &self.map.terrain {
            Terrain::Blocks(blocks) => {
                let [rows, cols] = blocks.blocks.value;
                format!("{rows} x {cols} blocks")
            }
            Terrain::Roads { roads } => {
                let roads = &roads.value;
                let [lanes, junctions] = [(roads.lanes.len(), "lane"), (roads.junctions.len(), "junction")]
                    .map(|(count, what)| counted(count, what));
                format!("{lanes}, {junctions}")
            }
        };
        let [rows, cols] = self.size;
        let map = format!("{streets}, {rows} x {cols} cells");
        let Some(scenario) = &self.scenario else {
            return writeln!(out, "{}: a map of {map}", path.display());
        };
        let agents = scenario.splits.iter().map(|(split, set)| {
            let agents = agents_in_words(&scenario.kinds, |kind| set.count_of(kind));
            format!("{} {agents}", split.name())
        });
        let task = scenario.task.as_ref().map_or("none".to_owned(), in_words);
        writeln!(out, "{}: a run configuration", path.display())?;
        writeln!(out, "  map: {}, {map}", self.map.name)?;
        writeln!(out, "  agents: {}", agents.collect::<Vec<_>>().join(", "))?;
        writeln!(out, "  task: {task}")
    }
}
