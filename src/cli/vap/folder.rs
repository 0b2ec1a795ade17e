//! A data set on disk: a folder a world, named by its number, and when all that was asked for is there `README.md` and `manifest.json`.
//!
//! Whatever is written begins under another name and is renamed, so what has its name is whole. Those other names are the same between a dot
//! and `.partial`; what an earlier command left of them is removed by the next.

use crate::cli::Failure;
use crate::diag::{Code, Diagnostic};
use crate::files;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What every manifest begins with.
pub(super) const DATA: &str = "logicity vap";

/// Version of the format; it grows when a reader of the old one would misread the new one.
pub(super) const VERSION: u32 = 2;

pub(super) const MANIFEST: &str = "manifest.json";
pub(super) const CARD: &str = "README.md";
pub(super) const ENTITIES: &str = "entities.parquet";
pub(super) const PAIRS: &str = "pairs.parquet";
/// In the folder of a world, a [`WorldFile`].
const RECORD: &str = "world.json";
const PARTIAL: &str = ".partial";

/// What all worlds of a data set have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Settings {
    /// [`DATA`].
    pub(super) data: String,
    pub(super) version: u32,
    pub(super) mode: String,
    pub(super) agents: String,
    pub(super) split: String,
    pub(super) seed: u64,
    pub(super) config_hash: String,
    pub(super) rules_hash: String,
    /// Whether there are pictures; boxes are those of the pictures that would be there.
    pub(super) pictures: bool,
    /// Of the icons, in percent.
    pub(super) difficulty: u8,
    /// Of the files of the pack of icons, if there is one.
    pub(super) pack_hash: Option<String>,
    pub(super) pack_mode: Option<String>,
    /// Of a small picture: where it is another, pictures are drawn in another way.
    pub(super) drawing_hash: String,
}

/// What a world's folder holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    pub(super) world: u32,
    /// Of the city.
    pub(super) seed: u64,
    pub(super) frames: usize,
    /// Labels of cars, in the order of [`Action::ALL`](crate::city::Action::ALL).
    pub(super) actions: [u64; 4],
    /// Agents of all frames.
    pub(super) agents: u64,
    /// Those that carry each concept; who carries none counts by type.
    pub(super) concepts: BTreeMap<String, u64>,
    /// As [`count_atoms`](crate::task::vap::count_atoms) counts.
    pub(super) atoms: BTreeMap<String, u64>,
    pub(super) files: BTreeMap<String, FileRecord>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct FileRecord {
    pub(super) bytes: usize,
    pub(super) sha256: String,
}

/// What a world is, whatever folder it lies in.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WorldFile {
    pub(super) settings: Settings,
    #[serde(flatten)]
    pub(super) record: Record,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Manifest {
    pub(super) settings: Settings,
    pub(super) frames: usize,
    pub(super) actions: [u64; 4],
    pub(super) agents: u64,
    pub(super) concepts: BTreeMap<String, u64>,
    pub(super) atoms: BTreeMap<String, u64>,
    pub(super) worlds: Vec<Record>,
}

impl Manifest {
    /// What worlds make, in their order.
    pub(super) fn new(settings: Settings, worlds: Vec<Record>) -> Manifest {
        let sum = |counts: fn(&Record) -> &BTreeMap<String, u64>| {
            let mut sums = BTreeMap::new();
            for (name, count) in worlds.iter().flat_map(counts) {
                *sums.entry(name.clone()).or_default() += count;
            }
            sums
        };
        Manifest {
            frames: worlds.iter().map(|record| record.frames).sum(),
            actions: worlds.iter().map(|record| record.actions).fold([0; 4], add),
            agents: worlds.iter().map(|record| record.agents).sum(),
            concepts: sum(|record| &record.concepts),
            atoms: sum(|record| &record.atoms),
            worlds,
            settings,
        }
    }

    /// Size of all files of the worlds that end so, in bytes.
    pub(super) fn bytes(&self, extension: &str) -> usize {
        let files = self.worlds.iter().flat_map(|record| &record.files);
        let named = files.filter(|(name, _)| name.ends_with(extension));
        named.map(|(_, file)| file.bytes).sum()
    }
}

pub(super) fn add(left: [u64; 4], right: [u64; 4]) -> [u64; 4] {
    std::array::from_fn(|action| left[action] + right[action])
}

pub(super) fn wrong(path: &Path, message: impl std::fmt::Display) -> Diagnostic {
    Diagnostic::new(Code::INVALID_DATA_SET, format!("`{}`: {message}", path.display()))
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

/// The name of a world's folder.
pub(super) fn world_name(world: u32) -> String {
    format!("world-{world:05}")
}

/// The name of the picture of a tick.
pub(super) fn frame_name(tick: impl std::fmt::Display) -> String {
    format!("frame-{tick:0>3}.png")
}

fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("it has a form in JSON") + "\n"
}

fn partial(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!(".{name}{PARTIAL}"))
}

fn write_failure(path: &Path) -> impl FnOnce(io::Error) -> Failure {
    let path = path.to_owned();
    move |error| Failure::file("write", &path, error)
}

/// A world being written.
pub(super) struct WorldWriter {
    partial: PathBuf,
    whole: PathBuf,
    files: BTreeMap<String, FileRecord>,
}

impl WorldWriter {
    /// Begins a world that is not there.
    pub(super) fn begin(set: &Path, world: u32) -> Result<WorldWriter, Failure> {
        let name = world_name(world);
        let partial = partial(set, &name);
        fs::create_dir(&partial).map_err(write_failure(&partial))?;
        Ok(WorldWriter {
            partial,
            whole: set.join(name),
            files: BTreeMap::new(),
        })
    }

    pub(super) fn put(&mut self, name: String, bytes: &[u8]) -> Result<(), Failure> {
        let path = self.partial.join(&name);
        fs::write(&path, bytes).map_err(write_failure(&path))?;
        self.files.insert(name, file_record(bytes));
        Ok(())
    }

    /// Describes the world by what `record` makes of its files, and gives it its name.
    pub(super) fn finish(
        self,
        settings: Settings,
        record: impl FnOnce(BTreeMap<String, FileRecord>) -> Record,
    ) -> Result<(), Failure> {
        let record = record(self.files);
        let path = self.partial.join(RECORD);
        fs::write(&path, pretty(&WorldFile { settings, record })).map_err(write_failure(&path))?;
        fs::rename(&self.partial, &self.whole).map_err(write_failure(&self.whole))
    }
}

/// Writes what describes a whole set.
pub(super) fn write_description(set: &Path, card: &str, manifest: &Manifest) -> Result<(), Failure> {
    for (name, text) in [(CARD, card), (MANIFEST, &pretty(manifest))] {
        let (partial, whole) = (partial(set, name), set.join(name));
        fs::write(&partial, text).map_err(write_failure(&partial))?;
        fs::rename(&partial, &whole).map_err(write_failure(&whole))?;
    }
    Ok(())
}

/// Removes what was not finished.
pub(super) fn remove_partials(set: &Path) -> Result<(), Failure> {
    for path in entries(set)? {
        let name = path.file_name().and_then(OsStr::to_str);
        let whole = name.and_then(|name| name.strip_prefix('.')?.strip_suffix(PARTIAL));
        if !whole.is_some_and(|whole| is_world(Path::new(whole)) || [CARD, MANIFEST].contains(&whole)) {
            continue;
        }
        let removed = match path.is_dir() {
            true => fs::remove_dir_all(&path),
            false => fs::remove_file(&path),
        };
        removed.map_err(|error| Failure::file("remove", &path, error))?;
    }
    Ok(())
}

/// What is in a folder, in the order of names.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let fail = |error| Failure::file("read", folder, error);
    let paths = fs::read_dir(folder).map_err(fail)?.map(|entry| Ok(entry?.path()));
    let mut paths = paths.collect::<io::Result<Vec<PathBuf>>>().map_err(fail)?;
    paths.sort();
    Ok(paths)
}

/// The worlds in a folder by number, each with the path of its folder.
pub(super) fn worlds(set: &Path) -> Result<Vec<(PathBuf, WorldFile)>, Failure> {
    let mut worlds = Vec::new();
    for path in entries(set)?.into_iter().filter(|path| is_world(path)) {
        let file: WorldFile = read_json(&path.join(RECORD))?;
        if path
            .file_name()
            .is_none_or(|name| *name != *world_name(file.record.world))
        {
            return Err(wrong(&path, format!("holds world {}", file.record.world)).into());
        }
        worlds.push((path, file));
    }
    worlds.sort_by_key(|(_, file)| file.record.world);
    Ok(worlds)
}

fn is_world(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str);
    name.is_some_and(|name| name.starts_with("world-"))
}

/// What is in the folder of a set and belongs to none.
pub(super) fn unexpected_files(set: &Path) -> Result<Vec<PathBuf>, Failure> {
    let known = |path: &PathBuf| is_world(path) || [CARD, MANIFEST].iter().any(|name| path.ends_with(name));
    Ok(entries(set)?.into_iter().filter(|path| !known(path)).collect())
}

/// What is in the folder of a world and not in its record.
pub(super) fn unexpected_in_world(folder: &Path, record: &Record) -> Result<Vec<PathBuf>, Failure> {
    let known = |path: &PathBuf| {
        let name = path.file_name().and_then(OsStr::to_str);
        name.is_some_and(|name| name == RECORD || record.files.contains_key(name))
    };
    Ok(entries(folder)?.into_iter().filter(|path| !known(path)).collect())
}

/// The manifest of a set that this program can read.
pub(super) fn read_manifest(set: &Path) -> Result<Manifest, Failure> {
    read_json(&set.join(MANIFEST))
}

/// A manifest, or the file of a world.
fn read_json<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, Failure> {
    /// What both have in every version.
    #[derive(Deserialize)]
    struct Versioned {
        settings: Version,
    }
    #[derive(Deserialize)]
    struct Version {
        data: String,
        version: u32,
    }
    let text = files::read_text(path).map_err(|error| Failure::file("read", path, error))?;
    let fail = |error| wrong(path, format!("not of a data set: {error}"));
    let Version { data, version } = serde_json::from_str::<Versioned>(&text).map_err(fail)?.settings;
    if data != DATA || version != VERSION {
        let message = format!("a data set `{data}`, version {version}; this program reads version {VERSION}");
        return Err(wrong(path, message).into());
    }
    Ok(serde_json::from_str(&text).map_err(fail)?)
}
