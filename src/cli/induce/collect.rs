//! The examples of recorded episodes, traces, tables of steps, scenes and data sets.

use crate::builtin::BuiltinFiles;
use crate::cancel::Cancel;
use crate::cli::failure::Failure;
use crate::cli::induce::Arguments;
use crate::cli::inputs::unreadable;
use crate::cli::limits::LimitOptions;
use crate::cli::report::report;
use crate::cli::scenes::{SceneLine, SceneLines, open_input};
use crate::cli::trace::{TraceReader, line_max};
use crate::diag::{Diagnostic, Sources, listed};
use crate::files::{self, Folder, ReadError, read_bytes};
use crate::induce::{Examples, State};
use crate::rng::Seed;
use crate::sim::codes;
use crate::sim::{Executor, Inference, LoadedCity};
use crate::task::induction::{InductionTask, Origin, Steps};
use crate::task::spf::{ControlMode, Env, EpisodeSet, SpfTask};
use crate::task::vap::{self, Dataset, MANIFEST};
use std::io::{BufRead, Cursor, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// The first bytes of Parquet and HDF5 files.
const PARQUET: &[u8] = b"PAR1";
const HDF5: &[u8] = b"\x89HDF";

/// The number of steps of an episode between two polls for cancellation.
const CANCEL_STEPS: i32 = 1_024;

/// Examples and their origin.
pub struct Collected {
    pub examples: Examples,
    pub origin: Origin,
}

/// Returns the city of the traces among files of examples, or `None` if there is no trace with its configuration. A
/// pipe is not read, because that is possible only once.
pub fn city_of_traces(
    paths: &[PathBuf],
    sources: &mut Sources,
    limits: &LimitOptions,
) -> Result<Option<LoadedCity>, Failure> {
    let mut first: Option<(&Path, TraceReader)> = None;
    for path in paths.iter().filter(|path| path.is_file()) {
        let mut lines = open_input(path)?;
        let fail = |error| Failure::file("read", path, error);
        // Tables of steps have no lines.
        if !lines.fill_buf().map_err(fail)?.starts_with(b"{") {
            continue;
        }
        let mut line = Vec::new();
        lines.take(line_max()).read_until(b'\n', &mut line).map_err(fail)?;
        if !is_trace(&line) {
            continue;
        }
        let trace = TraceReader::open(path)?;
        let Some((known, other)) = &first else {
            first = trace.header.archive.is_some().then_some((path, trace));
            continue;
        };
        let hashes = |trace: &TraceReader| [trace.header.config_hash.clone(), trace.header.rules_hash.clone()];
        let [config, rules] = [0, 1].map(|index| hashes(&trace)[index] == hashes(other)[index]);
        if !config || !rules {
            let (known, path) = (known.display(), path.display());
            let what = if config { "rules" } else { "configurations" };
            let message = format!("the traces `{known}` and `{path}` have different {what}");
            let help = "name the configuration to learn with: `--config FILE`";
            return Err(Failure::Usage(format!("{message}\nhelp: {help}")));
        }
    }
    let Some((_, trace)) = first else { return Ok(None) };
    let mut city = trace.city(sources, None, None)?;
    city.limits = limits.limits(city.limits);
    report(&city.warnings, sources);
    Ok(Some(city))
}

/// Returns whether the first line of a file is the header of a trace.
fn is_trace(first: &[u8]) -> bool {
    serde_json::from_slice::<serde_json::Value>(first).is_ok_and(|header| header.get("trace").is_some())
}

/// Collects the examples to learn from, and those of `--test`. `origin` begins with lines about the source.
pub fn collect(
    arguments: &Arguments,
    city: LoadedCity,
    sources: &mut Sources,
    origin: Origin,
    cancel: &Cancel,
) -> Result<(InductionTask, Collected, Option<Collected>), Failure> {
    let (scenario, program) = (city.scenario.clone(), city.program.clone());
    let world = Arc::new(city.world()?);
    let task = InductionTask::new(Arc::clone(&world), &arguments.order)?;
    let mut files = FileCollector {
        task: &task,
        limits: &arguments.limits,
        is_configured: arguments.is_configured(),
        is_page_wanted: arguments.page.is_some(),
        scenes: Inference::new(
            scenario,
            program,
            Seed(arguments.seed),
            Executor::Relational,
            BuiltinFiles,
        )?,
        cancel,
    };
    let collected = match arguments.data.is_empty() {
        true if arguments.episodes == Some(0) => Collected {
            examples: task.examples(),
            origin,
        },
        true => episodes(arguments, &task, sources, origin, cancel)?,
        false => files.collect(&arguments.data, origin)?,
    };
    files.is_page_wanted = false;
    // Rules may be measured in another city.
    files.is_configured = true;
    let tests = match arguments.test.is_empty() {
        true => None,
        false => Some(files.collect(&arguments.test, Origin::default())?),
    };
    Ok((task, collected, tests))
}

/// Drives recorded episodes of the configuration.
fn episodes(
    arguments: &Arguments,
    task: &InductionTask,
    sources: &mut Sources,
    mut origin: Origin,
    cancel: &Cancel,
) -> Result<Collected, Failure> {
    let path_task = Arc::new(SpfTask::new(Arc::clone(task.world()), sources)?);
    let set = EpisodeSet::load(&path_task, arguments.split, sources, &BuiltinFiles)?;
    let available = set.episodes.len();
    let wanted = arguments.episodes.unwrap_or(available);
    if wanted > available {
        return Err(Failure::Usage(format!(
            "--episodes {wanted}: the configuration has {available} recorded episodes"
        )));
    }
    let mut env = Env::new_with(path_task, arguments.split, ControlMode::First, cancel)?;
    let mut examples = task.examples();
    for (number, episode) in set.episodes.iter().take(wanted).enumerate() {
        origin.push_episode(examples.count(), format!("episode {number}"));
        task.add_episode(&mut env, episode, &mut examples)?;
    }
    origin.lines.push(format!("Episodes {}.", set.hash()));
    Ok(Collected { examples, origin })
}

/// Reads examples from files.
struct FileCollector<'a> {
    task: &'a InductionTask,
    limits: &'a LimitOptions,
    is_configured: bool,
    is_page_wanted: bool,
    scenes: Inference,
    cancel: &'a Cancel,
}

impl FileCollector<'_> {
    fn collect(&mut self, paths: &[PathBuf], origin: Origin) -> Result<Collected, Failure> {
        let mut collected = Collected {
            examples: self.task.examples(),
            origin,
        };
        for (path, name) in paths.iter().zip(short_names(paths)) {
            self.add(path, &name, &mut collected)?;
        }
        if collected.examples.count() == 0 {
            let names: Vec<String> = paths.iter().map(|path| format!("`{}`", path.display())).collect();
            let message = format!("no examples in {}", listed(&names));
            return Err(Diagnostic::new(codes::INVALID_SCENE, message).into());
        }
        Ok(collected)
    }

    /// Adds the examples of a trace, of a table of steps, of labeled scenes or of a data set. `name` is its name in
    /// places.
    fn add(&mut self, path: &Path, name: &str, to: &mut Collected) -> Result<(), Failure> {
        if path.is_dir() {
            // Minari keeps a dataset in a folder `data` in a folder with the name of the dataset.
            if ["data/metadata.json", "metadata.json"]
                .iter()
                .any(|name| path.join(name).is_file())
            {
                return Err(is_minari(path).into());
            }
            if !path.join(MANIFEST).is_file() {
                let message = format!("`{}` is not a data set: it has no file `{MANIFEST}`", path.display());
                let help = "`logicity vap make` writes data sets; for a trace, name its file";
                return Err(Failure::Usage(format!("{message}\nhelp: {help}")));
            }
            return self.add_data_set(path, name, to);
        }
        // A pipe can be read once, so the reader of the rest gets the first line, too.
        let mut lines = open_input(path)?;
        let fail = |error| Failure::file("read", path, error);
        let begin = lines.fill_buf().map_err(fail)?;
        let is_table = path.extension().is_some_and(|extension| extension == "parquet") || begin.starts_with(PARQUET);
        if is_table {
            let limit = files::read_limit();
            if std::fs::metadata(path).is_ok_and(|found| found.is_file() && found.len() > limit) {
                return Err(unreadable(path, &ReadError::TooLarge(limit)));
            }
            let bytes = read_bytes(lines).map_err(|error| unreadable(path, &error))?;
            return self.add_steps(bytes, path, name, to);
        }
        if begin.starts_with(HDF5) {
            return Err(is_minari(path).into());
        }
        let mut first = Vec::new();
        lines
            .by_ref()
            .take(line_max())
            .read_until(b'\n', &mut first)
            .map_err(fail)?;
        let is_trace = is_trace(&first);
        let lines = Box::new(Cursor::new(first).chain(lines));
        if self.is_page_wanted && !is_trace {
            let message = format!(
                "`{}` is not a trace; --page shows a trace as `logicity run` writes it",
                path.display()
            );
            return Err(Failure::Usage(message));
        }
        if is_trace {
            self.add_trace(TraceReader::new(lines, path, 0)?, path, name, to)
        } else {
            self.add_scenes(SceneLines::new(lines, path), name, to)
        }
    }

    fn check_cancelled(&self) -> Result<(), Failure> {
        match self.cancel.requested() {
            true => Err(Failure::Interrupted),
            false => Ok(()),
        }
    }

    /// Adds the labeled cars of a data set of Visual Action Prediction.
    fn add_data_set(&self, path: &Path, name: &str, to: &mut Collected) -> Result<(), Failure> {
        let data = Dataset::open(Folder::new(path))?;
        let vocabulary = &self.task.world().vocabulary;
        let translator = self.task.translator(vocabulary)?;
        for world in &data.manifest().worlds {
            self.check_cancelled()?;
            for sample in data.samples(vocabulary, world)? {
                for (car, label) in sample.labels.iter().enumerate() {
                    let Some(action) = label else { continue };
                    let (world, tick) = (world.world, sample.tick);
                    let place = format!("{name}, world {world}, tick {tick}, {}", sample.names[car]);
                    let noted = |fault: Diagnostic| fault.note(format!("in {place}"));
                    let action = self.task.action(*action).map_err(noted)?;
                    let state = translator.state(&sample.facts, car).map_err(noted)?;
                    to.add(state, action, place);
                }
            }
        }
        Ok(())
    }

    /// Adds the steps of a Parquet table.
    fn add_steps(&self, bytes: Vec<u8>, path: &Path, name: &str, to: &mut Collected) -> Result<(), Failure> {
        let placed = |fault: Diagnostic| fault.note(format!("in `{}`", path.display()));
        let steps = Steps::open(bytes).map_err(placed)?;
        let entities = self.task.observed_entities(&steps.atoms);
        let entities =
            entities.map_err(|fault| placed(fault.note(format!("the table is of the mode {}", steps.mode))))?;
        let mut episode = None;
        steps.for_each(|step| {
            if step.step % CANCEL_STEPS == 0 {
                self.check_cancelled()?;
            }
            if episode != Some(step.episode) {
                episode = Some(step.episode);
                to.origin
                    .push_episode(to.examples.count(), format!("{name}, episode {}", step.episode));
            }
            let state = self.task.observed_state(step.observation, entities, None);
            to.examples.push(state, self.task.action(step.action).map_err(placed)?);
            Ok(())
        })
    }

    /// Adds every decision of every agent in a trace.
    fn add_trace(&self, mut trace: TraceReader, path: &Path, name: &str, to: &mut Collected) -> Result<(), Failure> {
        let hash = &self.task.world().scenario.hash;
        if !self.is_configured && trace.header.archive.is_some() && trace.header.config_hash != *hash {
            let message = format!(
                "the trace `{}` has the configuration `{}`, which is not the one to learn with\nhelp: name that \
                 configuration with `--config`, or write the trace to a file and learn from the file",
                path.display(),
                trace.header.config
            );
            return Err(Failure::Usage(message));
        }
        let limits = trace.limits(None, self.limits);
        let mut replay = trace.replay(&mut Sources::new(), None, None, false, limits)?;
        let vocabulary = replay.world().vocabulary.clone();
        let translator = self.task.translator(&vocabulary).map_err(|fault| trace.placed(fault))?;
        while let Some(tick) = trace.tick()? {
            self.check_cancelled()?;
            replay.set(&tick).map_err(|fault| trace.placed(fault))?;
            for (agent, state) in tick.agents.iter().enumerate() {
                let place = format!("{name}, {} in tick {}", replay.agents()[agent].id, tick.tick);
                let action = state
                    .action(self.task.world().vocabulary.actions())
                    .and_then(|action| self.task.action(action));
                let action = action.map_err(|fault| trace.placed(fault))?;
                let state = translator
                    .state(replay.facts(), agent)
                    .map_err(|fault| trace.placed(fault))?;
                to.add(state, action, place);
            }
        }
        Ok(())
    }

    /// Adds the labeled egos of scenes.
    fn add_scenes(&mut self, mut lines: SceneLines, name: &str, to: &mut Collected) -> Result<(), Failure> {
        let vocabulary = self.scenes.vocabulary().clone();
        let translator = self.task.translator(&vocabulary)?;
        while let Some(SceneLine { number, sources, scene }) = lines.next()? {
            self.check_cancelled()?;
            let place = format!("in line {number} of `{}`", lines.name);
            let scene = scene.map_err(|fault| vec![fault]);
            let scene = scene
                .and_then(|source| self.scenes.ground(&sources, source))
                .map_err(|faults| {
                    report(&faults, &sources);
                    Failure::Reported
                })?;
            if scene.actions.is_empty() {
                let fault = Diagnostic::new(codes::INVALID_SCENE, format!("the scene {place} has no actions"));
                let example = "{\"Car_1\": \"Stop\"}";
                let help = format!("add the action that each ego took, for example \"actions\": {example}");
                return Err(fault.help(help).into());
            }
            for (ego, action) in scene.actions {
                let noted = |fault: Diagnostic| fault.note(place.clone());
                let action = self.task.action(action).map_err(noted)?;
                let state = translator.state(&scene.facts, ego).map_err(noted)?;
                to.add(state, action, format!("{name}, line {number}, {}", scene.names[ego]));
            }
        }
        Ok(())
    }
}

impl Collected {
    /// Adds an example from a place.
    fn add(&mut self, state: State, action: usize, place: String) {
        self.origin.push(self.examples.count(), place);
        self.examples.push(state, action);
    }
}

/// Returns the error for a Minari dataset.
fn is_minari(path: &Path) -> Diagnostic {
    let message = format!(
        "`{}` is a Minari dataset, which the command does not read",
        path.display()
    );
    Diagnostic::new(vap::codes::INVALID_DATA_SET, message)
        .help("call `logicity.induce` in Python with the dataset, its name or its folder")
}

/// Returns names of files for outputs, which must not contain paths of this machine: without folders, or with as many
/// as distinguish files of the same name.
pub fn short_names(paths: &[PathBuf]) -> Vec<String> {
    let parts = |path: &PathBuf| -> Vec<String> {
        let names = path.components().rev().filter_map(|part| match part {
            Component::Normal(name) => Some(files::portable_name(&name.to_string_lossy())),
            _ => None,
        });
        names.collect()
    };
    let all: Vec<Vec<String>> = paths.iter().map(parts).collect();
    let name = |(path, own): (&PathBuf, &Vec<String>)| {
        if path == Path::new("-") {
            return "standard input".to_owned();
        }
        let is_unique = |count: &usize| {
            let is_same = |other: &Vec<String>| other != own && other.starts_with(&own[..*count]);
            !all.iter().any(is_same)
        };
        let count = (1..own.len()).find(is_unique).unwrap_or(own.len());
        match own[..count]
            .iter()
            .rev()
            .map(String::as_str)
            .collect::<Vec<_>>()
            .join("/")
        {
            name if name.is_empty() => path.display().to_string(),
            name => name,
        }
    };
    paths.iter().zip(&all).map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_have_the_folders_that_distinguish_them() {
        let names = |paths: &[&str]| short_names(&paths.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(names(&["/home/me/a.jsonl", "worlds/"]), ["a.jsonl", "worlds"]);
        assert_eq!(
            names(&["/runs/one/trace.jsonl", "/runs/two/trace.jsonl", "other.jsonl"]),
            ["one/trace.jsonl", "two/trace.jsonl", "other.jsonl"]
        );
        assert_eq!(
            names(&["trace.jsonl", "one/trace.jsonl"]),
            ["trace.jsonl", "one/trace.jsonl"]
        );
        assert_eq!(names(&["trace.jsonl", "trace.jsonl"]), ["trace.jsonl", "trace.jsonl"]);
        assert_eq!(names(&["-", ".."]), ["standard input", ".."]);
    }
}
