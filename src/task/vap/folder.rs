//! The layout of a data set on disk: one folder per world, named by its number, and at the end `README.md` and
//! `manifest.json`; `shard.json` in a shard.
//!
//! Each world is written under a temporary name, `.NAME.partial`, and renamed when complete. The next command removes
//! temporary files that an interrupted command has left. A [`Description`] keeps other commands from the folder.

use crate::diag::{Diagnostic, json_error};
use crate::files::{FileError, Folder, Output, Overwrite};
use crate::render::DrawingVersion;
use crate::task::shard::{self, Shard};
use crate::task::vap::codes;
use crate::task::vap::error::{DatasetError, Occupied};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::ops::{Range, RangeInclusive};
use std::path::{Component, Path, PathBuf};

/// The value of [`DatasetSettings::data`].
pub(super) const DATA: &str = "logicity vap";

/// The versions of the format that this program reads. The version increases when a reader of the old one would misread
/// the new one: from version 4 on, boxes may be loose.
const VERSIONS: RangeInclusive<u32> = 3..=4;

/// Returns the version of the format for pictures of a version. The first drawing version has a format without a field
/// for it, so data sets with this version stay the same.
pub(super) fn format_version(drawing: DrawingVersion) -> u32 {
    match drawing {
        DrawingVersion::V1 => 3,
        DrawingVersion::V2 => 4,
    }
}

fn first_drawing() -> u8 {
    DrawingVersion::V1.number()
}

fn is_first_drawing(number: &u8) -> bool {
    *number == first_drawing()
}

/// The file of a data set with its settings and worlds.
pub const MANIFEST: &str = "manifest.json";
const CARD: &str = "README.md";
/// The file that makes a data set a shard: a [`ShardFile`].
const SHARD: &str = "shard.json";
pub(super) const ENTITIES: &str = "entities.parquet";
pub(super) const PAIRS: &str = "pairs.parquet";
/// How the names of masks begin.
pub(super) const MASK: &str = "mask-";
/// The [`WorldFile`] in the folder of a world.
const RECORD: &str = "world.json";
const PARTIAL: &str = ".partial";

/// The common settings of all worlds of a data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetSettings {
    /// Always `logicity vap`.
    pub data: String,
    /// The version of the format.
    pub version: u32,
    /// The name of the [`Mode`](crate::task::vap::Mode).
    pub mode: String,
    /// The name of the [`Agents`](crate::task::vap::Agents).
    pub agents: String,
    /// The name of the [`Split`](crate::city::Split).
    pub split: String,
    /// The seed of the data set.
    pub seed: u64,
    /// The SHA-256 of the content of the configuration.
    pub config_hash: String,
    /// The SHA-256 of the content of the rules.
    pub rules_hash: String,
    /// Whether there are pictures. Without pictures the boxes are the same.
    pub pictures: bool,
    /// Whether there are masks. Files of sets without masks lack it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub masks: bool,
    /// The difficulty of the pictures in percent.
    pub difficulty: u8,
    /// The hash of the icon pack.
    pub pack_hash: Option<String>,
    /// The mode of the icon pack.
    pub pack_mode: Option<String>,
    /// The number of the [`DrawingVersion`]. Files of format 3 lack it; it is then 1.
    #[serde(default = "first_drawing", skip_serializing_if = "is_first_drawing")]
    pub drawing_version: u8,
    /// The SHA-256 of the pixels of [`Worlds::specimen`](crate::task::vap::Worlds::specimen). It changes with the
    /// drawing code.
    pub drawing_hash: String,
}

impl DatasetSettings {
    /// Whether agents have a [`Framing`](crate::render::Framing): loose boxes, and things that hide parts of them.
    pub(super) fn has_framings(&self) -> bool {
        self.drawing_version > 1 && self.difficulty > 0
    }
}

/// The counts and files of a world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldRecord {
    /// The number of the world.
    pub world: u32,
    /// The seed of the city.
    pub seed: u64,
    /// The number of frames.
    pub frames: usize,
    /// The number of cars with each label, in the order of [`Action::STANDARD`](crate::city::Action::STANDARD).
    pub actions: [u64; 4],
    /// The number of agents in all frames.
    pub agents: u64,
    /// The number of agents with each concept. Agents without concepts count by type.
    pub concepts: BTreeMap<String, u64>,
    /// The result of [`count_atoms`](crate::task::vap::count_atoms).
    pub atoms: BTreeMap<String, u64>,
    /// The files by name.
    pub files: BTreeMap<String, FileRecord>,
}

/// Size and hash of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FileRecord {
    /// The size in bytes.
    pub bytes: usize,
    /// The SHA-256.
    pub sha256: String,
}

/// The file `world.json`.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WorldFile {
    pub(super) settings: DatasetSettings,
    #[serde(flatten)]
    pub(super) record: WorldRecord,
}

/// The file `manifest.json`: settings, worlds, and their sums.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The common settings of all worlds.
    pub settings: DatasetSettings,
    /// The number of frames.
    pub frames: usize,
    /// The sums of [`WorldRecord::actions`].
    pub actions: [u64; 4],
    /// The sum of [`WorldRecord::agents`].
    pub agents: u64,
    /// The sums of [`WorldRecord::concepts`].
    pub concepts: BTreeMap<String, u64>,
    /// The sums of [`WorldRecord::atoms`].
    pub atoms: BTreeMap<String, u64>,
    /// The worlds by number.
    pub worlds: Vec<WorldRecord>,
}

impl Manifest {
    /// Returns the manifest of these worlds.
    pub(super) fn new(settings: DatasetSettings, worlds: Vec<WorldRecord>) -> Manifest {
        let sum = |counts: fn(&WorldRecord) -> &BTreeMap<String, u64>| {
            let mut sums = BTreeMap::new();
            for (name, count) in worlds.iter().flat_map(counts) {
                let sum: &mut u64 = sums.entry(name.clone()).or_default();
                *sum = sum.saturating_add(*count);
            }
            sums
        };
        let frames = worlds.iter().map(|record| record.frames);
        let agents = worlds.iter().map(|record| record.agents);
        Manifest {
            frames: frames.fold(0, usize::saturating_add),
            actions: worlds.iter().map(|record| record.actions).fold([0; 4], add),
            agents: agents.fold(0, u64::saturating_add),
            concepts: sum(|record| &record.concepts),
            atoms: sum(|record| &record.atoms),
            worlds,
            settings,
        }
    }

    /// Returns the number of pictures.
    pub fn pictures(&self) -> usize {
        if self.settings.pictures { self.frames } else { 0 }
    }

    /// Returns the size in bytes of all files of the worlds whose names have this beginning and this end.
    pub(super) fn bytes(&self, begin: &str, end: &str) -> usize {
        let files = self.worlds.iter().flat_map(|record| &record.files);
        let named = files.filter(|(name, _)| name.starts_with(begin) && name.ends_with(end));
        named.map(|(_, file)| file.bytes).fold(0, usize::saturating_add)
    }
}

/// Adds counts. It saturates, because counts may come from a damaged file.
pub(super) fn add(left: [u64; 4], right: [u64; 4]) -> [u64; 4] {
    std::array::from_fn(|action| left[action].saturating_add(right[action]))
}

/// Returns an `invalid-data-set` diagnostic about a file or folder.
pub(super) fn wrong(path: &Path, message: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::new(codes::INVALID_DATA_SET, format!("`{}`: {message}", path.display()))
}

pub(super) fn file_record(bytes: &[u8]) -> FileRecord {
    FileRecord {
        bytes: bytes.len(),
        sha256: hash(bytes),
    }
}

pub(super) fn hash(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// Returns the name of a world's folder.
pub(super) fn world_name(world: u32) -> String {
    format!("world-{world:05}")
}

/// Returns the name of the picture of a tick.
pub(super) fn frame_name(tick: impl std::fmt::Display) -> String {
    format!("frame-{tick:0>3}.png")
}

/// Returns the name of the mask of a tick.
pub(super) fn mask_name(tick: impl std::fmt::Display) -> String {
    format!("{MASK}{tick:0>3}.png")
}

fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("it has a form in JSON") + "\n"
}

fn partial(name: &str) -> String {
    format!(".{name}{PARTIAL}")
}

/// Writes one world.
pub(super) struct WorldWriter<'f> {
    set: &'f Folder,
    name: String,
    /// The folder under its temporary name.
    partial: Folder,
    files: BTreeMap<String, FileRecord>,
}

impl<'f> WorldWriter<'f> {
    /// Begins a world that does not exist yet.
    pub(super) fn begin(set: &'f Folder, world: u32) -> Result<WorldWriter<'f>, FileError> {
        let name = world_name(world);
        let partial = set.folder(&partial(&name));
        partial.create()?;
        Ok(WorldWriter {
            set,
            name,
            partial,
            files: BTreeMap::new(),
        })
    }

    pub(super) fn put(&mut self, name: String, bytes: &[u8]) -> Result<(), FileError> {
        self.partial.write(&name, bytes)?;
        self.files.insert(name, file_record(bytes));
        Ok(())
    }

    /// Writes the record that `record` returns for the files, and gives the folder its final name.
    pub(super) fn finish(
        self,
        settings: DatasetSettings,
        record: impl FnOnce(BTreeMap<String, FileRecord>) -> WorldRecord,
    ) -> Result<(), FileError> {
        let record = record(self.files);
        self.partial.write(RECORD, pretty(&WorldFile { settings, record }))?;
        self.set.rename(&partial(&self.name), &self.name)
    }
}

/// `README.md` and `manifest.json` of a data set while a command makes its worlds.
pub(super) struct Description {
    card: Output,
    manifest: Output,
}

impl Description {
    /// Reserves both files, so that a second command on the same folder fails, and checks that the folder holds nothing
    /// but a data set with these settings. `overwrite` applies to the two files only.
    pub(super) fn begin(
        set: &Folder,
        settings: &DatasetSettings,
        overwrite: Overwrite,
    ) -> Result<Description, DatasetError> {
        let description = Description {
            card: set.replace(CARD)?,
            manifest: set.replace(MANIFEST)?,
        };
        if overwrite == Overwrite::Own {
            let wrong = |name: &str, reason| Occupied {
                path: set.path().join(name),
                reason,
                replaceable: true,
            };
            if set.has(MANIFEST) {
                let read = understood(read_json::<Manifest>(set, MANIFEST))?;
                match read.map_err(|reason| wrong(MANIFEST, reason))?.settings == *settings {
                    true => {}
                    false => return Err(wrong(MANIFEST, OTHER_SETTINGS.to_owned()).into()),
                }
            }
            if set.has(CARD) {
                let foreign = "the file exists, and logicity did not write it or it has changed since";
                match understood(set.read_text(CARD).map(Ok))? {
                    Ok(text) if is_sealed(&text) => {}
                    _ => return Err(wrong(CARD, foreign.to_owned()).into()),
                }
            }
        }
        for path in set.entries()? {
            check_entry(set, &path, settings)?;
        }
        Ok(description)
    }

    /// Writes the files.
    pub(super) fn finish(self, set: &Folder, card: &str, manifest: &Manifest) -> Result<(), FileError> {
        set.finish(CARD, self.card, &sealed(card))?;
        set.finish(MANIFEST, self.manifest, &pretty(manifest))
    }
}

/// Checks that a file or folder belongs to a data set with these settings. Compares the names of the files of a world,
/// but not their content.
fn check_entry(set: &Folder, path: &Path, settings: &DatasetSettings) -> Result<(), DatasetError> {
    let occupied = |path: &Path, reason: String| Occupied {
        path: path.to_owned(),
        reason,
        replaceable: false,
    };
    match Entry::of(path) {
        Entry::Description | Entry::Partial | Entry::Temporary => Ok(()),
        Entry::Other => Err(occupied(path, OTHER.to_owned()).into()),
        Entry::World(number) => {
            let file = read_world(set, number)?.map_err(|reason| occupied(path, reason))?;
            if file.settings != *settings {
                return Err(occupied(path, OTHER_SETTINGS.to_owned()).into());
            }
            let folder = Folder::new(path);
            if let Some(other) = unknown_world_entries(&folder, &file.record)?.first() {
                return Err(occupied(other, OTHER_IN_WORLD.to_owned()).into());
            }
            match file.record.files.keys().find(|name| !folder.has(name)) {
                Some(name) => Err(occupied(path, format!("its file `{name}` is missing")).into()),
                None => Ok(()),
            }
        }
    }
}

/// The reasons why a file or folder is not part of a data set.
pub(super) const OTHER: &str = "it belongs to no data set";
pub(super) const OTHER_IN_WORLD: &str = "it does not belong to the world";
const OTHER_SETTINGS: &str = "it belongs to a data set with other settings, configuration, rules or pictures";

const SEAL: [&str; 2] = ["\n<!-- logicity vap: SHA-256 of the text above: ", " -->\n"];

/// Appends a hash, by which [`is_sealed`] recognizes a text that has not changed.
fn sealed(text: &str) -> String {
    let [before, after] = SEAL;
    format!("{text}{before}{}{after}", hash(text.as_bytes()))
}

fn is_sealed(text: &str) -> bool {
    let parts = text.strip_suffix(SEAL[1]).and_then(|text| text.rsplit_once(SEAL[0]));
    parts.is_some_and(|(text, found)| found == hash(text.as_bytes()))
}

/// The kind of a file or folder in the folder of a data set, which its name determines.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Entry {
    /// `README.md`, `manifest.json` or `shard.json`.
    Description,
    /// The world with this number.
    World(u32),
    /// A world under its temporary name.
    Partial,
    /// Another file under its temporary name.
    Temporary,
    /// Not part of a data set.
    Other,
}

impl Entry {
    pub(super) fn of(path: &Path) -> Entry {
        let world = |name: &str| {
            let number = name.strip_prefix("world-")?.parse().ok()?;
            (name == world_name(number)).then_some(number)
        };
        let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
        let whole = name.strip_prefix('.').and_then(|name| name.strip_suffix(PARTIAL));
        match world(name) {
            Some(number) => Entry::World(number),
            None if [CARD, MANIFEST, SHARD].contains(&name) => Entry::Description,
            None if whole.and_then(world).is_some() && path.is_dir() => Entry::Partial,
            None if Output::is_temporary(path) => Entry::Temporary,
            None => Entry::Other,
        }
    }
}

/// The file `shard.json` of a data set that is a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardFile {
    /// Which shard.
    pub shard: Shard,
    /// The number of the first world of all shards.
    pub first_world: u32,
    /// The number of the worlds of all shards.
    pub worlds: u32,
}

impl ShardFile {
    /// Returns the numbers of the worlds of all shards.
    pub(super) fn all(&self) -> Range<u32> {
        self.first_world..self.first_world.saturating_add(self.worlds)
    }
}

/// Writes which shard a data set is, unless the folder says so already.
///
/// # Errors
/// [`DatasetError::Occupied`] if the folder has another shard, or a data set that is not this shard.
pub(super) fn note_shard(set: &Folder, shard: Option<&ShardFile>) -> Result<(), DatasetError> {
    let found = if set.has(SHARD) { Some(read_shard(set)?) } else { None };
    let is_new = !set.has(MANIFEST)
        && !set
            .entries()?
            .iter()
            .any(|path| matches!(Entry::of(path), Entry::World(_)));
    match (shard, found) {
        (None, None) => Ok(()),
        (Some(shard), Some(found)) if *shard == found => Ok(()),
        (Some(shard), None) if is_new => {
            let output = set.replace(SHARD)?;
            Ok(set.finish(SHARD, output, &pretty(shard))?)
        }
        (_, found) => Err(Occupied {
            path: set.path().join(if found.is_some() { SHARD } else { MANIFEST }),
            reason: match found {
                Some(found) => format!("the folder has shard {} of {} worlds", found.shard, found.worlds),
                None => "the folder has a data set that is not this shard".to_owned(),
            },
            replaceable: false,
        }
        .into()),
    }
}

/// Reads which shard a data set is.
///
/// # Errors
/// `invalid-shard` if the file is missing or faulty.
pub(super) fn read_shard(set: &Folder) -> Result<ShardFile, DatasetError> {
    let path = set.path().join(SHARD);
    if !set.has(SHARD) {
        let fault = shard::invalid(format!(
            "`{}` is not a shard of a data set: it has no `{SHARD}`",
            set.path().display()
        ));
        return Err(fault.help("make it with `logicity vap make --shard I/N`").into());
    }
    let text = set.read_text(SHARD)?;
    let parsed = serde_json::from_str(&text);
    Ok(parsed.map_err(|error| shard::invalid(format!("`{}`: {}", path.display(), json_error(&error))))?)
}

/// Copies a world of a data set, and compares its files with its record.
pub(super) fn copy_world(
    from: &Folder,
    to: &Folder,
    settings: &DatasetSettings,
    record: &WorldRecord,
) -> Result<(), DatasetError> {
    let folder = from.folder(&world_name(record.world));
    let mut writer = WorldWriter::begin(to, record.world)?;
    for (name, expected) in &record.files {
        let path = folder.path().join(name);
        if !Path::new(name).components().eq([Component::Normal(name.as_ref())]) {
            return Err(wrong(&path, "is not in the folder of the world").into());
        }
        match folder.read_of_length(name, expected.bytes as u64) {
            Err(error) => return Err(wrong(&path, error).into()),
            Ok(Some(bytes)) if file_record(&bytes) == *expected => writer.put(name.clone(), &bytes)?,
            Ok(_) => return Err(wrong(&path, "has changed since it was made").into()),
        }
    }
    Ok(writer.finish(settings.clone(), |_| record.clone())?)
}

/// Removes worlds with temporary names. The caller holds the [`Description`] of the folder.
pub(super) fn remove_partials(set: &Folder) -> Result<(), FileError> {
    for path in set.entries()? {
        if let (Entry::Partial, Some(name)) = (Entry::of(&path), path.file_name().and_then(OsStr::to_str)) {
            set.remove(name)?;
        }
    }
    Ok(())
}

/// Returns the records of the worlds in a folder by number. The caller holds the [`Description`] of the folder.
pub(super) fn records(set: &Folder) -> Result<Vec<WorldRecord>, DatasetError> {
    let mut records = Vec::new();
    for path in set.entries()? {
        if let Entry::World(number) = Entry::of(&path) {
            let file = read_world(set, number)?;
            records.push(file.map_err(|reason| wrong(&path, reason))?.record);
        }
    }
    records.sort_by_key(|record| record.world);
    Ok(records)
}

/// Reads the record of a world. The inner error is the reason why the folder does not hold this world.
pub(super) fn read_world(set: &Folder, number: u32) -> Result<Result<WorldFile, String>, FileError> {
    let folder = set.folder(&world_name(number));
    if !folder.path().is_dir() {
        return Ok(Err("it has the name of a world, but is not a folder".to_owned()));
    }
    let read = understood(read_json::<WorldFile>(&folder, RECORD))?;
    Ok(match read {
        Ok(file) if file.record.world != number => Err(format!("it holds world {}", file.record.world)),
        Ok(file) => Ok(file),
        Err(reason) => Err(format!(
            "it has the name of a world, but `{RECORD}` in it is wrong: {reason}"
        )),
    })
}

/// Returns the files and folders in the folder of a world that its record does not list.
pub(super) fn unknown_world_entries(folder: &Folder, record: &WorldRecord) -> Result<Vec<PathBuf>, FileError> {
    let known = |path: &PathBuf| {
        let name = path.file_name().and_then(OsStr::to_str);
        name.is_some_and(|name| name == RECORD || record.files.contains_key(name))
    };
    Ok(folder.entries()?.into_iter().filter(|path| !known(path)).collect())
}

/// Reads the manifest of a data set. Rejects other versions.
pub(super) fn read_manifest(set: &Folder) -> Result<Manifest, DatasetError> {
    let read = read_json(set, MANIFEST)?;
    Ok(read.map_err(|reason| wrong(&set.path().join(MANIFEST), reason))?)
}

/// Turns the absence of a file, and text that is not UTF-8, into reasons why the file is not part of a data set.
fn understood<T>(read: Result<Result<T, String>, FileError>) -> Result<Result<T, String>, FileError> {
    match read {
        Err(failed) if matches!(failed.error.kind(), ErrorKind::NotFound | ErrorKind::InvalidData) => {
            Ok(Err(failed.error.to_string()))
        }
        read => read,
    }
}

/// Reads a manifest or the file of a world. The inner error is the reason why it is neither.
fn read_json<T: for<'de> Deserialize<'de>>(folder: &Folder, name: &str) -> Result<Result<T, String>, FileError> {
    /// The fields that all versions of both files have.
    #[derive(Deserialize)]
    struct Versioned {
        settings: Version,
    }
    #[derive(Deserialize)]
    struct Version {
        data: String,
        version: u32,
        #[serde(default = "first_drawing")]
        drawing_version: u8,
    }
    let fail = |error: serde_json::Error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        format!("not a file of a data set: {}, in {place}", json_error(&error))
    };
    let text = folder.read_text(name)?;
    let parse = || {
        let Version {
            data,
            version,
            drawing_version,
        } = serde_json::from_str::<Versioned>(&text).map_err(fail)?.settings;
        let (first, last) = VERSIONS.into_inner();
        if data != DATA || !VERSIONS.contains(&version) {
            return Err(format!(
                "a data set `{data}`, version {version}; this program reads versions {first} and {last}"
            ));
        }
        match DrawingVersion::from_number(drawing_version).map(format_version) == Some(version) {
            true => serde_json::from_str(&text).map_err(fail),
            false => Err(format!(
                "a data set of version {version} with drawing version {drawing_version}, which this program does not know"
            )),
        }
    };
    Ok(parse())
}
