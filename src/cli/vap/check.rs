//! `logicity vap check`

use crate::builtin::BuiltinFiles;
use crate::cli::vap::folder;
use crate::cli::vap::folder::{ENTITIES, Manifest, PAIRS, Record, Settings, add, file_record, wrong};
use crate::cli::vap::{City, Mode, label_shares, on_threads, shares};
use crate::cli::{Failure, progress, threads};
use crate::diag::{Code, Diagnostic, Sources};
use crate::render::read_png;
use crate::rng::Seed;
use crate::sim::{Executor, Inference, SceneFacts};
use crate::task::vap::table::{Sample, Table, boxes, count_concepts, samples};
use crate::task::vap::{SIDE, count_atoms};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::{Component, Path, PathBuf};

#[derive(clap::Args)]
pub(super) struct Check {
    /// The folder of the data set
    folder: PathBuf,
    /// Threads; 0 is one for each core
    #[arg(long, value_parser = threads, default_value = "0", allow_negative_numbers = true)]
    threads: NonZeroUsize,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl Check {
    pub(super) fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let path = self.folder.join(folder::MANIFEST);
        let manifest = folder::read_manifest(&self.folder)?;
        let settings = &manifest.settings;
        let mode = Mode::ALL.into_iter().find(|mode| mode.name() == settings.mode);
        let mode = mode.ok_or_else(|| wrong(&path, format!("`{}` is not a mode", settings.mode)))?;
        let city = City::load(mode, sources)?;
        if [&city.config_hash, &city.rules_hash] != [&settings.config_hash, &settings.rules_hash] {
            let message = format!("made with another configuration `{}`, or other rules", mode.config());
            return Err(wrong(&path, message).into());
        }
        let inference = city.inference(settings.seed)?;
        let mut faults = self.unlisted(&manifest)?;
        let bar = progress("world", manifest.worlds.len() as u64);
        let found = on_threads(self.threads, &manifest.worlds, |record| {
            let found = self.check_world(&inference, settings, record)?;
            bar.inc(1);
            Ok(found)
        })?;
        bar.finish_and_clear();
        faults.extend(found.into_iter().flatten());
        if Manifest::new(settings.clone(), manifest.worlds.clone()) != manifest {
            faults.push(wrong(&path, "does not count what its worlds have"));
        }
        if !faults.is_empty() {
            return Err(faults.into());
        }
        self.print(mode, &manifest)
    }

    /// What is there and not in the manifest.
    fn unlisted(&self, manifest: &Manifest) -> Result<Vec<Diagnostic>, Failure> {
        let mut faults = Vec::new();
        for path in folder::unexpected_files(&self.folder)? {
            faults.push(wrong(&path, "belongs to no data set"));
        }
        for (path, file) in folder::worlds(&self.folder)? {
            if !manifest.worlds.contains(&file.record) || file.settings != manifest.settings {
                let fault = wrong(&path, "is not as the manifest lists it");
                faults.push(fault.help("`logicity vap make` lists what is there"));
            }
        }
        Ok(faults)
    }

    /// What is wrong with a world.
    fn check_world(
        &self,
        inference: &Inference,
        settings: &Settings,
        record: &Record,
    ) -> Result<Vec<Diagnostic>, Failure> {
        let path = self.folder.join(folder::world_name(record.world));
        let mut faults = Vec::new();
        let tables = read_files(&path, record, &mut faults);
        if !faults.is_empty() {
            return Ok(faults);
        }
        for path in folder::unexpected_in_world(&path, record)? {
            faults.push(wrong(&path, "is not of the world"));
        }
        let label_shares = read_tables(inference, record, tables).and_then(|(entities, samples)| {
            let mut actions = [0; 4];
            for sample in &samples {
                actions = add(actions, check_sample(inference, sample)?);
            }
            let concepts = count_concepts(&entities)?;
            Ok((entities, samples, actions, concepts))
        });
        match label_shares {
            Err(fault) => faults.push(fault.note(format!("in `{}`", path.display()))),
            Ok((entities, samples, actions, concepts)) => {
                let counted = Record {
                    world: record.world,
                    seed: record.seed,
                    frames: samples.len(),
                    actions,
                    agents: entities.rows() as u64,
                    concepts,
                    atoms: count_atoms(inference.vocabulary(), samples.iter().map(|sample| &sample.facts)),
                    files: record.files.clone(),
                };
                if counted != *record {
                    faults.push(wrong(&path, "does not count what its tables have"));
                }
                let pictures = samples.iter().filter(|_| settings.pictures);
                let names: BTreeSet<String> = pictures.map(|sample| folder::frame_name(sample.tick)).collect();
                let there = record.files.keys().filter(|name| name.ends_with(".png"));
                if !there.eq(&names) {
                    faults.push(wrong(&path, "has not one picture for each of its frames"));
                }
            }
        }
        Ok(faults)
    }

    fn print(&self, mode: Mode, manifest: &Manifest) -> Result<(), Failure> {
        let Manifest {
            settings,
            frames,
            actions,
            agents,
            concepts,
            atoms,
            worlds,
        } = manifest;
        let pictures = if settings.pictures { *frames } else { 0 };
        let mut out = io::stdout().lock();
        if self.json {
            let counts = serde_json::json!({
                "worlds": worlds.len(), "frames": frames, "pictures": pictures, "actions": actions,
                "published": mode.published(), "agents": agents, "concepts": concepts, "atoms": atoms,
            });
            writeln!(out, "{counts}")?;
            return Ok(());
        }
        let worlds = worlds.len();
        writeln!(
            out,
            "worlds: {worlds}, frames: {frames}, pictures: {pictures}, every label follows from the facts"
        )?;
        writeln!(out, "labels of cars: {}", label_shares(*actions))?;
        writeln!(out, "published test: {}", label_shares(mode.published()))?;
        let concepts = concepts.iter().map(|(name, count)| (name.as_str(), *count));
        writeln!(out, "agents: {}", shares(concepts, *agents))?;
        let atoms = atoms.iter().map(|(name, count)| format!("{name} {count}"));
        let atoms: Vec<String> = atoms.collect();
        writeln!(out, "true, of pairs if the first sees the second: {}", atoms.join(", "))?;
        Ok(())
    }
}

impl City {
    fn inference(&self, seed: u64) -> Result<Inference, Failure> {
        let (scenario, program) = (self.scenario.clone(), self.program.clone());
        Ok(Inference::new(
            scenario,
            program,
            Seed(seed),
            Executor::Auto,
            BuiltinFiles,
        )?)
    }
}

/// Reads the files of a world, and compares them with what is told of them. The bytes of those that are not pictures.
fn read_files<'a>(folder: &Path, record: &'a Record, faults: &mut Vec<Diagnostic>) -> BTreeMap<&'a str, Vec<u8>> {
    let mut others = BTreeMap::new();
    for (name, expected) in &record.files {
        let path = folder.join(name);
        if !Path::new(name).components().eq([Component::Normal(name.as_ref())]) {
            faults.push(wrong(&path, "is not in the folder of the world"));
            continue;
        }
        let again = "remove the folder of the world and run `logicity vap make` again";
        let other = || wrong(&path, "is not the file that was made").help(again);
        // What has another size is not read.
        let read = || match fs::metadata(&path)?.len() == expected.bytes as u64 {
            true => fs::read(&path).map(Some),
            false => Ok(None),
        };
        match read() {
            Err(error) => faults.push(wrong(&path, error).help(again)),
            Ok(None) => faults.push(other()),
            Ok(Some(bytes)) if file_record(&bytes) != *expected => faults.push(other()),
            Ok(Some(bytes)) if name.ends_with(".png") => {
                if let Err(fault) = check_picture(&bytes) {
                    faults.push(wrong(&path, fault));
                }
            }
            Ok(Some(bytes)) => {
                others.insert(name.as_str(), bytes);
            }
        }
    }
    others
}

fn check_picture(bytes: &[u8]) -> Result<(), String> {
    let picture = read_png(bytes)?;
    match (picture.width(), picture.height()) {
        (SIDE, SIDE) => Ok(()),
        (width, height) => Err(format!("{width} x {height} pixels instead of {SIDE} x {SIDE}")),
    }
}

/// The entities and the samples of a world, if all files besides pictures are its tables and boxes lie in the picture.
fn read_tables(
    inference: &Inference,
    record: &Record,
    mut files: BTreeMap<&str, Vec<u8>>,
) -> Result<(Table, Vec<Sample>), Diagnostic> {
    let mut table = |name: &str| {
        let missing = || Diagnostic::new(Code::INVALID_DATA_SET, format!("there is no `{name}`"));
        Table::read(files.remove(name).ok_or_else(missing)?)
    };
    let (entities, pairs) = (table(ENTITIES)?, table(PAIRS)?);
    if let Some((name, _)) = files.first_key_value() {
        return Err(Diagnostic::new(
            Code::INVALID_DATA_SET,
            format!("`{name}` is neither a table nor a picture"),
        ));
    }
    boxes(&entities)?;
    let samples = samples(inference.vocabulary(), record.world, &entities, &pairs)?;
    Ok((entities, samples))
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
            return Err(Diagnostic::new(Code::INVALID_DATA_SET, message));
        }
        actions[label as usize] += 1;
    }
    Ok(actions)
}
