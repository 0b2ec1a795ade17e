//! Opens and checks data sets.

use crate::cancel::Cancel;
use crate::city::AgentKind;
use crate::diag::Diagnostic;
use crate::files::{Folder, ReadError};
use crate::render::{PixelBox, read_mask_into, read_png};
use crate::rng::Seed;
use crate::sim::{Executor, Inference, LoadedCity, SceneFacts, Vocabulary};
use crate::task::vap::codes;
use crate::task::vap::dataset::{Monitor, Step};
use crate::task::vap::folder::{ENTITIES, Entry, MANIFEST, PAIRS, WorldFile, add, file_record, wrong};
use crate::task::vap::table::{Sample, Table, boxes, count_concepts, samples, visible};
use crate::task::vap::{DatasetError, Manifest, Mode, SIDE, WorldRecord, count_atoms, folder};
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::path::{Component, Path, PathBuf};

/// The help for files that do not belong to the data set.
const MOVE: &str = "move it elsewhere";

/// A data set on disk.
pub struct Dataset {
    folder: Folder,
    mode: Mode,
    manifest: Manifest,
}

impl Dataset {
    /// Opens a data set and reads its manifest.
    ///
    /// # Errors
    /// `invalid-data-set` if the manifest is invalid or of another version; a file that cannot be read.
    pub fn open(folder: Folder) -> Result<Dataset, DatasetError> {
        let manifest = folder::read_manifest(&folder)?;
        let name = &manifest.settings.mode;
        let mode = Mode::ALL.into_iter().find(|mode| mode.name() == name);
        let path = folder.path().join(MANIFEST);
        Ok(Dataset {
            mode: mode.ok_or_else(|| wrong(&path, format!("`{name}` is not a mode")))?,
            folder,
            manifest,
        })
    }

    /// Returns the mode, which selects the rules.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Returns the manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Reads the samples of a world, without its pictures. The facts are in the order of `vocabulary`.
    ///
    /// # Errors
    /// `invalid-data-set` if a table is missing, has changed or is faulty.
    pub fn samples(&self, vocabulary: &Vocabulary, record: &WorldRecord) -> Result<Vec<Sample>, DatasetError> {
        let folder = self.folder.folder(&folder::world_name(record.world));
        let table = |name: &str| {
            let path = folder.path().join(name);
            let expected = record
                .files
                .get(name)
                .ok_or_else(|| wrong(&path, "is not in the manifest"))?;
            match folder.read_of_length(name, expected.bytes as u64) {
                Err(error) => Err(wrong(&path, error)),
                Ok(Some(bytes)) if file_record(&bytes) == *expected => Table::read(bytes),
                Ok(_) => Err(wrong(&path, "has changed since it was made")),
            }
        };
        let (entities, pairs) = (table(ENTITIES)?, table(PAIRS)?);
        let samples = samples(vocabulary, record.world, &entities, &pairs);
        Ok(samples.map_err(|fault| fault.note(format!("in `{}`", folder.path().display())))?)
    }

    /// Returns the folder.
    pub(super) fn folder(&self) -> &Folder {
        &self.folder
    }

    fn manifest_path(&self) -> PathBuf {
        self.folder.path().join(MANIFEST)
    }

    /// Checks files, hashes, order, pictures, boxes and visible fractions, and derives every label from the facts.
    ///
    /// `city` has the configuration of [`mode`](Dataset::mode). `progress` receives the numbers of worlds checked and
    /// to check. It is called, and `cancel` is polled, on the calling thread only.
    ///
    /// # Errors
    /// `invalid-data-set` for every error in the data set; `cancelled`; a folder that cannot be read.
    pub fn check(
        &self,
        city: LoadedCity,
        threads: NonZeroUsize,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &Cancel,
    ) -> Result<(), DatasetError> {
        let (path, settings) = (self.manifest_path(), &self.manifest.settings);
        if [&city.scenario.hash, &city.rules_hash] != [&settings.config_hash, &settings.rules_hash] {
            let config = self.mode.config();
            let message = format!("made with another version of the configuration `{config}`, or other rules");
            return Err(wrong(&path, message).into());
        }
        // The scene of a sample names no map file.
        let read = |_: &Path| Err(ReadError::NotFound);
        let seed = Seed(settings.seed);
        let inference = Inference::new(city.scenario, city.program, seed, Executor::Auto, read)?;
        let mut faults = self.unlisted()?;
        let records = &self.manifest.worlds;
        let monitor = Monitor::new(records.len() as u64, progress, cancel);
        let found = monitor.run(threads, records, |record, step| {
            let found = self.check_world(&inference, record, step)?;
            step(1)?;
            Ok(found)
        })?;
        faults.extend(found.into_iter().flatten());
        if Manifest::new(settings.clone(), records.clone()) != self.manifest {
            faults.push(wrong(&path, "has counts that differ from its worlds"));
        }
        match faults.is_empty() {
            true => Ok(()),
            false => Err(faults.into()),
        }
    }

    /// Reports files and worlds that the manifest does not list.
    fn unlisted(&self) -> Result<Vec<Diagnostic>, DatasetError> {
        let mut faults = Vec::new();
        for path in self.folder.entries()? {
            match Entry::of(&path) {
                Entry::Description => {}
                Entry::Other => faults.push(wrong(&path, folder::OTHER).help(MOVE)),
                Entry::Partial | Entry::Temporary => {
                    let fault = wrong(&path, "it is incomplete");
                    faults.push(fault.help("`logicity vap make` completes the data set"));
                }
                Entry::World(number) => match folder::read_world(&self.folder, number)? {
                    Err(reason) => faults.push(wrong(&path, reason).help(MOVE)),
                    Ok(file) if self.lists(&file) => {}
                    Ok(_) => {
                        let fault = wrong(&path, "it differs from its entry in the manifest");
                        faults.push(fault.help("`logicity vap make` updates the manifest"));
                    }
                },
            }
        }
        Ok(faults)
    }

    fn lists(&self, file: &WorldFile) -> bool {
        self.manifest.worlds.contains(&file.record) && file.settings == self.manifest.settings
    }

    /// Returns the errors of a world.
    fn check_world(
        &self,
        inference: &Inference,
        record: &WorldRecord,
        step: Step<'_>,
    ) -> Result<Vec<Diagnostic>, DatasetError> {
        let folder = self.folder.folder(&folder::world_name(record.world));
        let path = folder.path();
        let mut faults = Vec::new();
        let WorldFiles { others: tables, masks } = read_files(&folder, record, step, &mut faults)?;
        if !faults.is_empty() {
            return Ok(faults);
        }
        for path in folder::unknown_world_entries(&folder, record)? {
            faults.push(wrong(&path, folder::OTHER_IN_WORLD).help(MOVE));
        }
        let has_covers = self.manifest.settings.has_framings();
        let read = read_tables(inference, record, tables, has_covers).and_then(|(entities, samples)| {
            let mut actions = [0; 4];
            for sample in &samples {
                actions = add(actions, check_sample(inference, sample)?);
            }
            let concepts = count_concepts(&entities)?;
            if self.manifest.settings.masks {
                check_masks(&entities, &masks)?;
            }
            Ok((entities, samples, actions, concepts))
        });
        match read {
            Err(fault) => faults.push(fault.note(format!("in `{}`", path.display()))),
            Ok((entities, samples, actions, concepts)) => {
                let counted = WorldRecord {
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
                    faults.push(wrong(path, "has counts that differ from its tables"));
                }
                let settings = &self.manifest.settings;
                let pictures = samples.iter().filter(|_| settings.pictures);
                let masks = samples.iter().filter(|_| settings.masks);
                let names: BTreeSet<String> = (pictures.map(|sample| folder::frame_name(sample.tick)))
                    .chain(masks.map(|sample| folder::mask_name(sample.tick)))
                    .collect();
                let listed = record.files.keys().filter(|name| name.ends_with(".png"));
                if !listed.eq(&names) {
                    let what = if settings.masks { "picture and mask" } else { "picture" };
                    faults.push(wrong(path, format!("does not have exactly one {what} per frame")));
                }
            }
        }
        Ok(faults)
    }
}

/// The boxes of the values of a mask, from value 1 on; `None` for values that no pixel has.
type MaskBoxes = Vec<Option<PixelBox>>;

/// Files of a world by name.
struct WorldFiles<'a> {
    /// All except pictures and masks.
    others: BTreeMap<&'a str, Vec<u8>>,
    masks: BTreeMap<&'a str, MaskBoxes>,
}

/// Compares the files of a world with its record, and reads its masks and its other files except pictures.
fn read_files<'a>(
    folder: &Folder,
    record: &'a WorldRecord,
    step: Step<'_>,
    faults: &mut Vec<Diagnostic>,
) -> Result<WorldFiles<'a>, Diagnostic> {
    let (mut others, mut masks) = (BTreeMap::new(), BTreeMap::new());
    for (name, expected) in &record.files {
        step(0)?;
        let path = folder.path().join(name);
        if !Path::new(name).components().eq([Component::Normal(name.as_ref())]) {
            faults.push(wrong(&path, "is not in the folder of the world"));
            continue;
        }
        let again = "remove the folder of the world and run `logicity vap make` again";
        let other = || wrong(&path, "has changed since it was made").help(again);
        match folder.read_of_length(name, expected.bytes as u64) {
            Err(error) => faults.push(wrong(&path, error).help(again)),
            Ok(None) => faults.push(other()),
            Ok(Some(bytes)) if file_record(&bytes) != *expected => faults.push(other()),
            Ok(Some(bytes)) if name.starts_with(folder::MASK) => match mask_boxes(&bytes) {
                Ok(boxes) => _ = masks.insert(name.as_str(), boxes),
                Err(fault) => faults.push(wrong(&path, fault)),
            },
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
    Ok(WorldFiles { others, masks })
}

/// Reads a mask.
fn mask_boxes(bytes: &[u8]) -> Result<MaskBoxes, String> {
    let mut mask = vec![0; SIDE as usize * SIDE as usize];
    read_mask_into(bytes, (SIDE, SIDE), &mut mask)?;
    // The first and the last column and row of each value.
    let mut ends: Vec<Option<[u32; 4]>> = Vec::new();
    for (row, pixels) in (0..).zip(mask.chunks_exact(SIDE as usize)) {
        for (col, &value) in (0..).zip(pixels) {
            let Some(at) = usize::from(value).checked_sub(1) else {
                continue;
            };
            if ends.len() <= at {
                ends.resize(at + 1, None);
            }
            let [left, top, right, bottom] = ends[at].unwrap_or([col, row, col, row]);
            ends[at] = Some([left.min(col), top.min(row), right.max(col), bottom.max(row)]);
        }
    }
    let boxed = |[left, top, right, bottom]: [u32; 4]| PixelBox {
        x: left.cast_signed(),
        y: top.cast_signed(),
        width: right - left + 1,
        height: bottom - top + 1,
    };
    Ok(ends.into_iter().map(|ends| ends.map(boxed)).collect())
}

/// Checks masks: the pixels of an agent lie in its box, and there are some if a part of the agent is visible.
fn check_masks(entities: &Table, masks: &BTreeMap<&str, MaskBoxes>) -> Result<(), Diagnostic> {
    let (boxes, fractions, ticks) = (boxes(entities)?, visible(entities)?, entities.ints("tick")?);
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for (row, (area, fraction)) in boxes.iter().zip(fractions).enumerate() {
        let name = folder::mask_name(ticks[row]);
        let at = counts.entry(name.clone()).or_default();
        let place = *at;
        *at += 1;
        let Some(found) = masks.get(name.as_str()) else {
            continue;
        };
        let found = found.get(place).copied().flatten();
        let fault = match (area, found) {
            (None, Some(_)) => "has no box, but pixels",
            (Some(area), Some(found)) if !area.contains(found) => "has pixels outside of its box",
            (_, found) if found.is_some() != fraction.is_some_and(|fraction| fraction > 0.0) => {
                "has pixels, unlike its visible fraction, or lacks them"
            }
            _ => continue,
        };
        let message = format!("in `{name}`, row {row} of the entities {fault}");
        return Err(Diagnostic::new(codes::INVALID_DATA_SET, message));
    }
    let unknown = masks
        .iter()
        .find(|(name, found)| found.len() > counts.get(**name).copied().unwrap_or(0));
    match unknown {
        None => Ok(()),
        Some((name, found)) => {
            let message = format!(
                "in `{name}`, a pixel has the value {}, but the tick has fewer agents",
                found.len()
            );
            Err(Diagnostic::new(codes::INVALID_DATA_SET, message))
        }
    }
}

fn check_picture(bytes: &[u8]) -> Result<(), String> {
    let picture = read_png(bytes)?;
    match (picture.width(), picture.height()) {
        (SIDE, SIDE) => Ok(()),
        (width, height) => Err(format!("{width} x {height} pixels instead of {SIDE} x {SIDE}")),
    }
}

/// Reads the entities and the samples of a world. All boxes must lie in the picture, visible fractions must fit them,
/// and all files must be tables.
fn read_tables(
    inference: &Inference,
    record: &WorldRecord,
    mut files: BTreeMap<&str, Vec<u8>>,
    has_covers: bool,
) -> Result<(Table, Vec<Sample>), Diagnostic> {
    let mut table = |name: &str| {
        let missing = || Diagnostic::new(codes::INVALID_DATA_SET, format!("there is no `{name}`"));
        Table::read(files.remove(name).ok_or_else(missing)?)
    };
    let (entities, pairs) = (table(ENTITIES)?, table(PAIRS)?);
    if let Some((name, _)) = files.first_key_value() {
        return Err(Diagnostic::new(
            codes::INVALID_DATA_SET,
            format!("`{name}` is neither a table nor a picture"),
        ));
    }
    check_visible(&entities, has_covers)?;
    let samples = samples(inference.vocabulary(), record.world, &entities, &pairs)?;
    Ok((entities, samples))
}

/// Checks visible fractions. An agent is whole unless the box of an agent that is drawn later overlaps its own, its box
/// is cut off by the edge of the picture, or the pictures have other things that cover agents.
fn check_visible(entities: &Table, has_covers: bool) -> Result<(), Diagnostic> {
    let (boxes, fractions) = (boxes(entities)?, visible(entities)?);
    let (ticks, kinds) = (entities.ints("tick")?, entities.texts("type")?);
    let drawn = |row: usize| (kinds[row] == AgentKind::Pedestrian.name(), row);
    for (row, (pixels, fraction)) in boxes.iter().zip(fractions).enumerate() {
        let (Some(pixels), Some(fraction)) = (pixels, fraction) else {
            continue;
        };
        let is_frame = |other: &usize| ticks[*other] == ticks[row];
        let before = (0..row).rev().take_while(is_frame);
        let later = (before.chain((row..boxes.len()).take_while(is_frame))).filter(|&other| drawn(other) > drawn(row));
        let is_covered = || {
            later
                .filter_map(|other| boxes[other])
                .any(|other| other.overlaps(*pixels))
        };
        let right = pixels.x + pixels.width.cast_signed();
        let bottom = pixels.y + pixels.height.cast_signed();
        let at_edge = pixels.x.min(pixels.y) == 0 || right.max(bottom) == SIDE.cast_signed();
        let is_outside = fraction == 0.0 && at_edge;
        if fraction < 1.0 && !has_covers && !is_outside && !is_covered() {
            let message = format!("row {row} of the entities is {fraction} visible, but nothing covers it");
            return Err(Diagnostic::new(codes::INVALID_DATA_SET, message));
        }
    }
    Ok(())
}

/// Counts the labels of a sample. Every label must be the action that the rules choose.
fn check_sample(inference: &Inference, sample: &Sample) -> Result<[u64; 4], Diagnostic> {
    let cars: Vec<usize> = (0..sample.names.len())
        .filter(|&agent| sample.labels[agent].is_some())
        .collect();
    let scene = SceneFacts {
        kinds: Vec::new(),
        names: sample.names.clone(),
        egos: cars.clone(),
        facts: sample.facts.clone(),
        actions: Vec::new(),
        uncertain: Vec::new(),
    };
    let mut actions = [0; 4];
    for (car, (name, action)) in cars.into_iter().zip(inference.answer_facts(&scene)?.actions()) {
        let label = sample.labels[car].expect("a car has one");
        if label != action {
            let message = format!(
                "tick {}: {} is labeled {}, but the rules choose {}",
                sample.tick,
                name,
                label.name(),
                action.name()
            );
            return Err(Diagnostic::new(codes::INVALID_DATA_SET, message));
        }
        actions[label.index()] += 1;
    }
    Ok(actions)
}
