//! `logicity vap`
//!
//! A data set is a folder: a folder a world, named by its number, and when all that was asked for is there `README.md` and
//! `manifest.json`. A world is written under another name and renamed, so what has its name is whole.

use super::{Failure, load_city, make_folder, one_of, progress};
use crate::config::{Speed, Split};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files::{self, Output};
use crate::render::{Difficulty, Icons};
use crate::rng::Seed;
use crate::sim::{Executor, Inference, SceneFacts, hash_sources};
use crate::task::vap::table::{ENTITY_NAMES, ENTITY_NUMBERS, PAIR_NAMES, Sample, Table, samples};
use crate::task::vap::{Agents, FIRST_TICK, Frame, TICKS, Worlds, count_actions, published_worlds};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Version of the format; it grows when a reader of the old one would misread the new one.
const VERSION: u32 = 1;

/// The most worlds of a data set.
const WORLDS_MAX: i64 = 100_000;

const MANIFEST: &str = "manifest.json";
const RECORD: &str = "world.json";
const TABLES: [&str; 2] = ["entities.parquet", "pairs.parquet"];

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Make worlds, or go on where making them was ended; worlds that are there stay
    Make(Make),
    /// Check files, hashes and order of a data set, and derive every label from what it says is true
    Check {
        /// The folder of the data set
        folder: PathBuf,
        /// One JSON object
        #[arg(long)]
        json: bool,
    },
}

/// The rules of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Easy,
    Hard,
}

impl Mode {
    const ALL: [Mode; 2] = [Mode::Easy, Mode::Hard];

    const fn name(self) -> &'static str {
        match self {
            Mode::Easy => "easy",
            Mode::Hard => "hard",
        }
    }

    /// What the paper's fixed test set counts, in the order of [`Speed::ALL`].
    const fn published(self) -> [u64; 4] {
        match self {
            Mode::Easy => [3042, 3978, 0, 7220],
            Mode::Hard => [4155, 2882, 715, 6488],
        }
    }
}

#[derive(clap::Args)]
struct Make {
    /// Which rules: those of configs/vap-easy.yaml or configs/vap-hard.yaml
    #[arg(long, value_parser = one_of(&Mode::ALL, Mode::name))]
    mode: Mode,
    /// The agents: those of the configuration, or drawn for each world
    #[arg(long, value_parser = one_of(&Agents::ALL, Agents::name), default_value = "fixed")]
    agents: Agents,
    /// Which split
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name))]
    split: Split,
    /// How many worlds; 100 for train and 20 otherwise unless given
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=WORLDS_MAX), allow_negative_numbers = true)]
    worlds: Option<u32>,
    /// Number of the first: several processes can make parts of a data set in folders of their own, or one after the other in one
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..WORLDS_MAX), allow_negative_numbers = true,
        default_value_t = 0)]
    first_world: u32,
    /// What everything is drawn from
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// The folder to write
    #[arg(short, long)]
    out: PathBuf,
}

/// What all worlds of a data set have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    /// Always `logicity vap`.
    data: String,
    version: u32,
    mode: String,
    agents: String,
    split: String,
    seed: u64,
    config_hash: String,
    rules_hash: String,
}

/// What a world's folder holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    world: u32,
    /// Of the city.
    seed: u64,
    frames: usize,
    /// Labels of cars, in the order of [`Speed::ALL`].
    actions: [u64; 4],
    files: BTreeMap<String, FileRecord>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct FileRecord {
    bytes: usize,
    sha256: String,
}

/// `world.json`: what a world is, whatever folder it lies in.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct WorldFile {
    settings: Settings,
    #[serde(flatten)]
    record: Record,
}

#[derive(Debug, Serialize, Deserialize)]
struct Manifest {
    settings: Settings,
    frames: usize,
    actions: [u64; 4],
    worlds: Vec<Record>,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    match &arguments.what {
        What::Make(make) => make.run(sources),
        What::Check { folder, json } => check(folder, *json, sources),
    }
}

fn name_of(world: u32) -> String {
    format!("world-{world:05}")
}

fn add(left: [u64; 4], right: [u64; 4]) -> [u64; 4] {
    std::array::from_fn(|action| left[action] + right[action])
}

fn wrong(path: &Path, message: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::new(Code::InvalidDataSet, format!("`{}`: {message}", path.display()))
}

fn file_record(bytes: &[u8]) -> FileRecord {
    FileRecord {
        bytes: bytes.len(),
        sha256: format!("{:x}", Sha256::digest(bytes)),
    }
}

impl Make {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let config = format!("vap-{}", self.mode.name());
        let (scenario, program, rule_file) = load_city(sources, Path::new(&config), None)?;
        let rule_files: Vec<_> = sources.ids().skip_while(|&id| id != rule_file).collect();
        let settings = Settings {
            data: "logicity vap".to_owned(),
            version: VERSION,
            mode: self.mode.name().to_owned(),
            agents: self.agents.name().to_owned(),
            split: self.split.name().to_owned(),
            seed: self.seed,
            config_hash: scenario.hash.clone(),
            rules_hash: hash_sources(sources, &rule_files),
        };
        let icons = Arc::new(Icons::new(Seed(self.seed), Difficulty::CLEAN));
        let worlds = Worlds::new(scenario, program, icons, self.agents, self.split, self.seed)?;
        let count = self.worlds.unwrap_or(published_worlds(self.split));
        make_folder(&self.out)?;
        for record in found(&self.out)? {
            settings.must_be(&record.1.settings, &record.0)?;
        }
        let bar = progress("world", count.into());
        let mut made = 0;
        for number in self.first_world..self.first_world + count {
            let folder = self.out.join(name_of(number));
            if !folder.exists() {
                self.write_world(&folder, &settings, &worlds, number)?;
                made += 1;
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        let manifest = self.finish(settings, &worlds)?;
        writeln!(
            io::stdout(),
            "worlds made: {made}, in {}: {}; labels of cars: {}",
            self.out.display(),
            manifest.worlds.len(),
            told(manifest.actions)
        )?;
        Ok(())
    }

    /// Writes a world under another name, and renames it when it is whole.
    fn write_world(&self, folder: &Path, settings: &Settings, worlds: &Worlds, number: u32) -> Result<(), Failure> {
        let frames = worlds.frames(number)?;
        let partial = self.out.join(format!(".{}.partial", name_of(number)));
        let fail = |path: &Path| {
            let path = path.to_owned();
            move |error: io::Error| Failure::file("write", &path, error)
        };
        if partial.exists() {
            fs::remove_dir_all(&partial).map_err(fail(&partial))?;
        }
        fs::create_dir(&partial).map_err(fail(&partial))?;
        let mut files = BTreeMap::new();
        for (name, bytes) in contents(worlds, number, &frames) {
            let path = partial.join(&name);
            fs::write(&path, &bytes).map_err(fail(&path))?;
            files.insert(name, file_record(&bytes));
        }
        let record = Record {
            world: number,
            seed: worlds.seed(number),
            frames: frames.len(),
            actions: count_actions(&frames),
            files,
        };
        let settings = settings.clone();
        let path = partial.join(RECORD);
        fs::write(&path, pretty(&WorldFile { settings, record })).map_err(fail(&path))?;
        fs::rename(&partial, folder).map_err(fail(folder))
    }

    /// Describes all worlds that are there.
    fn finish(&self, settings: Settings, worlds: &Worlds) -> Result<Manifest, Failure> {
        let records: Vec<Record> = found(&self.out)?.into_iter().map(|(_, file)| file.record).collect();
        let manifest = Manifest {
            frames: records.iter().map(|record| record.frames).sum(),
            actions: records.iter().map(|record| record.actions).fold([0; 4], add),
            worlds: records,
            settings,
        };
        for (name, text) in [
            ("README.md", self.card(&manifest, worlds)),
            (MANIFEST, pretty(&manifest)),
        ] {
            let path = self.out.join(name);
            let fail = |error| Failure::file("write", &path, error);
            let mut out = Output::create(&path).map_err(fail)?;
            out.write_all(text.as_bytes()).map_err(fail)?;
            out.finish().map_err(fail)?;
        }
        Ok(manifest)
    }

    /// What README says of a data set.
    fn card(&self, manifest: &Manifest, worlds: &Worlds) -> String {
        let Settings {
            mode,
            agents,
            split,
            seed,
            config_hash,
            rules_hash,
            ..
        } = &manifest.settings;
        let total: u64 = manifest.actions.iter().sum();
        let mut text = format!(
            "# Visual Action Prediction, {mode} mode, {agents} agents, {split}\n\n\
             {} worlds of {TICKS} ticks, of which the ticks from {FIRST_TICK} on are here: {} frames, {total} labels of cars. Made by\n\
             `logicity vap make --mode {mode} --agents {agents} --split {split} --seed {seed}`, checked by `logicity vap check`. Under the MIT\n\
             licence, as the program that made it.\n\n\
             configuration {config_hash}  \nrules {rules_hash}\n\n\
             A label is what the rules want of a car in the state that the frame shows, not the move that followed.\n\n\
             | label | here | share | published fixed test set | share |\n|---|---|---|---|---|\n",
            manifest.worlds.len(),
            manifest.frames,
        );
        let published = self.mode.published();
        let share = |count: u64, total: u64| format!("{}.{} %", count * 1000 / total / 10, count * 1000 / total % 10);
        for (index, action) in Speed::ALL.into_iter().enumerate() {
            let (here, there) = (manifest.actions[index], published[index]);
            let of = [share(here, total.max(1)), share(there, published.iter().sum())];
            writeln!(
                text,
                "| {index} {} | {here} | {} | {there} | {} |",
                action.name(),
                of[0],
                of[1]
            )
            .expect("memory");
        }
        let predicates = |arity: usize| {
            let all = worlds
                .world()
                .vocabulary
                .predicates
                .iter()
                .filter(move |predicate| predicate.arity == arity);
            all.map(|predicate| format!("`{}`", predicate.name))
                .collect::<Vec<_>>()
                .join(", ")
        };
        text += "\n`world-NNNNN/entities.parquet`: a row for each agent of each frame, in order of tick and agent.\n\n| column | what it is |\n|---|---|\n";
        let numbers = ENTITY_NUMBERS.iter().map(|(name, what, _)| (*name, *what));
        for (name, what) in ENTITY_NAMES.into_iter().chain(numbers) {
            writeln!(text, "| `{name}` | {what} |").expect("memory");
        }
        writeln!(
            text,
            "| {} | whether it holds |\n\n`world-NNNNN/pairs.parquet`: a row for each ordered pair of agents of each frame, so that the column of a predicate \
             is a\nmatrix for each frame, row by row.\n\n| column | what it is |\n|---|---|",
            predicates(1)
        )
        .expect("memory");
        for (name, what) in PAIR_NAMES {
            writeln!(text, "| `{name}` | {what} |").expect("memory");
        }
        writeln!(
            text,
            "| {} | whether it holds of first and second |\n\n\
             Boxes are those of a picture of the first 128 rows and columns, 8 pixels a cell. `world-NNNNN/world.json` and `manifest.json` have\n\
             counts, the seed of each world, and size and SHA-256 of each file.",
            predicates(2)
        )
        .expect("memory");
        text
    }
}

/// The files of a world. Whatever is to lie beside the tables belongs here.
fn contents(worlds: &Worlds, number: u32, frames: &[Frame]) -> Vec<(String, Vec<u8>)> {
    let tables = [
        Table::entities(worlds, number, frames),
        Table::pairs(worlds, number, frames),
    ];
    let written = TABLES.into_iter().zip(tables).map(|(name, table)| {
        let mut bytes = Vec::new();
        table.write(&mut bytes).expect("memory does not fail");
        (name.to_owned(), bytes)
    });
    written.collect()
}

fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("it has a form in JSON") + "\n"
}

/// `Slow 12, Normal 3`
fn told(actions: [u64; 4]) -> String {
    let words: Vec<String> = Speed::ALL
        .iter()
        .zip(actions)
        .map(|(action, count)| format!("{} {count}", action.name()))
        .collect();
    words.join(", ")
}

impl Settings {
    /// Whether a world that is there belongs to what is made.
    fn must_be(&self, there: &Settings, path: &Path) -> Result<(), Failure> {
        match self == there {
            true => Ok(()),
            false => Err(
                wrong(path, "is of a data set with other settings, configuration or rules")
                    .help("name another folder with `--out`")
                    .into(),
            ),
        }
    }
}

/// The worlds in a folder by number, each with the path of its folder.
fn found(folder: &Path) -> Result<Vec<(PathBuf, WorldFile)>, Failure> {
    let fail = |error| Failure::file("read", folder, error);
    let mut worlds = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let named = path
            .file_name()
            .and_then(|name| name.to_str())
            .is_some_and(|name| name.starts_with("world-"));
        if named {
            let file: WorldFile = read_json(&path.join(RECORD))?;
            if path.file_name().is_none_or(|name| *name != *name_of(file.record.world)) {
                return Err(wrong(&path, format!("holds world {}", file.record.world)).into());
            }
            worlds.push((path, file));
        }
    }
    worlds.sort_by_key(|(_, file)| file.record.world);
    Ok(worlds)
}

fn read_json<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, Failure> {
    let text = files::read_text(path).map_err(|error| Failure::file("read", path, error))?;
    serde_json::from_str(&text).map_err(|error| wrong(path, format!("not of a data set: {error}")).into())
}

fn check(folder: &Path, json: bool, sources: &mut Sources) -> Result<(), Failure> {
    let path = folder.join(MANIFEST);
    let manifest: Manifest = read_json(&path)?;
    let settings = &manifest.settings;
    if settings.data != "logicity vap" || settings.version != VERSION {
        let message = format!(
            "a data set `{}`, version {}; this program reads version {VERSION}",
            settings.data, settings.version
        );
        return Err(wrong(&path, message).into());
    }
    let mode = Mode::ALL.into_iter().find(|mode| mode.name() == settings.mode);
    let mode = mode.ok_or_else(|| wrong(&path, format!("`{}` is not a mode", settings.mode)))?;
    let config = format!("vap-{}", mode.name());
    let (scenario, program, rule_file) = load_city(sources, Path::new(&config), None)?;
    let rule_files: Vec<_> = sources.ids().skip_while(|&id| id != rule_file).collect();
    if [&scenario.hash, &hash_sources(sources, &rule_files)] != [&settings.config_hash, &settings.rules_hash] {
        return Err(wrong(
            &path,
            format!("made with another configuration `{config}`, or other rules"),
        )
        .into());
    }
    let inference = Inference::new(scenario, program, Seed(settings.seed), Executor::Auto, files::read_text)?;
    let there = found(folder)?;
    let listed = |file: &(PathBuf, WorldFile)| manifest.worlds.contains(&file.1.record) && file.1.settings == *settings;
    let mut faults: Vec<Diagnostic> = Vec::new();
    for file in there.iter().filter(|file| !listed(file)) {
        faults.push(wrong(&file.0, "is not as the manifest lists it").help("`logicity vap make` lists what is there"));
    }
    let bar = progress("world", manifest.worlds.len() as u64);
    for record in &manifest.worlds {
        let world = folder.join(name_of(record.world));
        faults.extend(check_world(&inference, &world, record)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let actions = manifest.worlds.iter().map(|record| record.actions).fold([0; 4], add);
    let frames: usize = manifest.worlds.iter().map(|record| record.frames).sum();
    if (actions, frames) != (manifest.actions, manifest.frames) {
        faults.push(wrong(&path, "does not count what its worlds have"));
    }
    if !faults.is_empty() {
        return Err(faults.into());
    }
    let mut out = io::stdout().lock();
    if json {
        let counts = serde_json::json!({
            "worlds": manifest.worlds.len(), "frames": frames, "actions": actions, "published": mode.published(),
        });
        writeln!(out, "{counts}")?;
        return Ok(());
    }
    writeln!(
        out,
        "worlds: {}, frames: {frames}, every label follows from the facts",
        manifest.worlds.len()
    )?;
    writeln!(out, "labels of cars: {}", told(actions))?;
    writeln!(out, "published test: {}", told(mode.published()))?;
    Ok(())
}

/// What is wrong with a world.
fn check_world(inference: &Inference, folder: &Path, record: &Record) -> Result<Vec<Diagnostic>, Failure> {
    let mut faults = Vec::new();
    let mut contents = BTreeMap::new();
    for (name, expected) in &record.files {
        let path = folder.join(name);
        let plain = Path::new(name)
            .components()
            .eq([std::path::Component::Normal(name.as_ref())]);
        match fs::read(&path) {
            _ if !plain => faults.push(wrong(&path, "is not in the folder of the world")),
            Err(error) => faults.push(wrong(&path, error)),
            Ok(bytes) if file_record(&bytes) != *expected => faults.push(wrong(&path, "is not the file that was made")),
            Ok(bytes) => {
                contents.insert(name.as_str(), bytes);
            }
        }
    }
    if !faults.is_empty() {
        return Ok(faults);
    }
    let mut table = |name: &str| {
        let bytes = contents
            .remove(name)
            .ok_or_else(|| wrong(folder, format!("has no `{name}`")))?;
        Table::read(bytes)
    };
    let read = table(TABLES[0])
        .and_then(|entities| samples(inference.vocabulary(), record.world, &entities, &table(TABLES[1])?));
    let placed = |fault: Diagnostic| fault.note(format!("in `{}`", folder.display()));
    match read {
        Err(fault) => faults.push(placed(fault)),
        Ok(samples) => {
            let mut actions = [0; 4];
            if samples.len() != record.frames {
                faults.push(wrong(
                    folder,
                    format!("{} frames instead of {}", samples.len(), record.frames),
                ));
            }
            for sample in samples {
                actions = add(actions, check_sample(inference, &sample).map_err(placed)?);
            }
            if actions != record.actions {
                faults.push(wrong(
                    folder,
                    format!("{} instead of {}", told(actions), told(record.actions)),
                ));
            }
        }
    }
    Ok(faults)
}

/// Counts the labels of a sample, which must be what the rules derive from its facts.
fn check_sample(inference: &Inference, sample: &Sample) -> Result<[u64; 4], Diagnostic> {
    let cars: Vec<usize> = (0..sample.names.len())
        .filter(|&agent| sample.labels[agent].is_some())
        .collect();
    let scene = SceneFacts {
        names: sample.names.clone(),
        egos: cars.clone(),
        facts: sample.facts.clone(),
    };
    let mut actions = [0; 4];
    for (car, answer) in cars.into_iter().zip(inference.answer_facts(&scene)?.egos) {
        let label = sample.labels[car].expect("a car has one");
        if label != answer.action {
            let message = format!(
                "tick {}: {} is labelled {}, the rules want {}",
                sample.tick,
                answer.id,
                label.name(),
                answer.action.name()
            );
            return Err(Diagnostic::new(Code::InvalidDataSet, message));
        }
        actions[label as usize] += 1;
    }
    Ok(actions)
}
