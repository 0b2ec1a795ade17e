//! Makes data sets. A data set is a function of its request, so an interrupted run can be resumed.
// Decision: docs/decisions/pictures.md#d045

use crate::cancel::Cancel;
use crate::city::Split;
use crate::diag::Diagnostic;
use crate::files::{Folder, Overwrite};
use crate::render::{Icons, Picture, write_mask, write_png};
use crate::rng::Seed;
use crate::sim::{LoadedCity, run_polled, start_threads, threads_of};
use crate::task::shard::Shard;
use crate::task::vap::error::DatasetError;
use crate::task::vap::folder::{Description, ENTITIES, PAIRS, ShardFile, WorldWriter};
use crate::task::vap::table::{Table, count_concepts};
use crate::task::vap::{
    Agents, DatasetSettings, FIRST_TICK, Manifest, Mode, SIDE, TICKS, WorldRecord, Worlds, card, count_actions,
    count_atoms, folder, icon_seed, published_worlds,
};
use rayon::prelude::*;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The largest number of worlds of a data set.
pub const WORLDS_MAX: u32 = 100_000;

/// The worlds to make.
#[derive(Clone, Debug)]
pub struct DatasetRequest {
    /// The mode, which selects the rules.
    pub mode: Mode,
    /// The agents: those of the configuration, or drawn for each world.
    pub agents: Agents,
    /// The split.
    pub split: Split,
    /// The numbers of the worlds.
    pub worlds: Range<u32>,
    /// Which part of these worlds to make.
    pub shard: Option<Shard>,
    /// The seed of all draws.
    pub seed: u64,
    /// Whether to draw pictures. Without pictures the tables are the same.
    pub pictures: bool,
    /// Whether to write masks: which agent each pixel of a picture shows. They need no pictures.
    pub masks: bool,
    /// The number of threads. The files are the same with any number.
    pub threads: NonZeroUsize,
}

impl DatasetRequest {
    /// Requests the worlds of the published set: fixed agents, seed 0, pictures, one thread.
    pub fn new(mode: Mode, split: Split) -> DatasetRequest {
        DatasetRequest {
            mode,
            agents: Agents::Fixed,
            split,
            worlds: 0..published_worlds(split),
            shard: None,
            seed: 0,
            pictures: true,
            masks: false,
            threads: NonZeroUsize::MIN,
        }
    }

    /// Returns the seed of the icons.
    pub fn icon_seed(&self) -> Seed {
        icon_seed(self.seed, self.split)
    }
}

/// The result of [`DatasetWriter::write`].
#[derive(Clone, Debug)]
pub struct DatasetSummary {
    /// The number of worlds that this call made.
    pub made: usize,
    /// The manifest of all worlds in the folder.
    pub manifest: Manifest,
}

/// Makes the worlds of a request.
pub struct DatasetWriter {
    request: DatasetRequest,
    settings: DatasetSettings,
    worlds: Worlds,
}

impl DatasetWriter {
    /// Prepares the common part of all worlds. `city` must have the configuration [`Mode::config`], and `icons` the
    /// seed [`DatasetRequest::icon_seed`]. The icons get the split of the request.
    ///
    /// # Errors
    /// As [`Worlds::new`].
    pub fn new(request: DatasetRequest, city: LoadedCity, icons: Icons) -> Result<DatasetWriter, Vec<Diagnostic>> {
        let icons = icons.with_split(request.split);
        let (difficulty, drawing) = (icons.difficulty().as_percent(), icons.version());
        let pack = icons
            .pack()
            .map(|pack| (pack.hash().to_owned(), pack.mode().name().to_owned()));
        let (pack_hash, pack_mode) = pack.unzip();
        let config_hash = city.scenario.hash.clone();
        let worlds = Worlds::new(
            city.scenario,
            city.program,
            Arc::new(icons),
            request.agents,
            request.split,
            request.seed,
        )?;
        let settings = DatasetSettings {
            data: folder::DATA.to_owned(),
            version: folder::format_version(drawing),
            mode: request.mode.name().to_owned(),
            agents: request.agents.name().to_owned(),
            split: request.split.name().to_owned(),
            seed: request.seed,
            config_hash,
            rules_hash: city.rules_hash,
            pictures: request.pictures,
            masks: request.masks,
            difficulty,
            pack_hash,
            pack_mode,
            drawing_version: drawing.number(),
            drawing_hash: folder::hash(worlds.specimen().pixels()),
        };
        Ok(DatasetWriter {
            request,
            settings,
            worlds,
        })
    }

    /// Writes the requested worlds that the folder lacks, then its `README.md` and `manifest.json`. It keeps existing
    /// worlds. Only with `overwrite` does it replace a `README.md` or `manifest.json` that does not come from a
    /// data set with these settings. The folder must not hold other files, which [`Dataset::check`] refuses.
    ///
    /// `progress` receives the numbers of frames made and to make. It is called, and `cancel` is polled, on the calling
    /// thread only. After cancellation the complete worlds stay in the folder, and another call makes the others.
    ///
    /// # Errors
    /// [`DatasetError::Occupied`] if the folder has worlds with other settings, files that it must not replace, or
    /// files that belong to no data set; those of [`Worlds::frames`]; `cancelled`; files that cannot be read or
    /// written; another process that makes worlds in the folder.
    ///
    /// [`Dataset::check`]: crate::task::vap::Dataset::check
    pub fn write(
        &self,
        folder: &Folder,
        overwrite: Overwrite,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &Cancel,
    ) -> Result<DatasetSummary, DatasetError> {
        let description = Description::begin(folder, &self.settings, overwrite)?;
        let all = &self.request.worlds;
        let part = self.request.shard.map(|shard| ShardFile {
            shard,
            first_world: all.start,
            worlds: all.end - all.start,
        });
        folder::note_shard(folder, part.as_ref())?;
        folder::remove_partials(folder)?;
        let numbers = self.request.shard.map_or(all.clone(), |shard| shard.part(all));
        let missing: Vec<u32> = numbers
            .filter(|&number| !folder.has(&folder::world_name(number)))
            .collect();
        let monitor = Monitor::new(missing.len() as u64 * (TICKS - FIRST_TICK), progress, cancel);
        monitor.run(self.request.threads, &missing, |&number, step| {
            self.write_world(folder, number, step)
        })?;
        let manifest = Manifest::new(self.settings.clone(), folder::records(folder)?);
        let card = card::card(self.request.mode, &manifest, &self.worlds.world().vocabulary);
        description.finish(folder, &card, &manifest)?;
        Ok(DatasetSummary {
            made: missing.len(),
            manifest,
        })
    }

    fn write_world(&self, set: &Folder, number: u32, step: Step<'_>) -> Result<(), DatasetError> {
        let worlds = &self.worlds;
        let mut writer = WorldWriter::begin(set, number)?;
        let frames = worlds.frames(number)?;
        let renderer = self.settings.pictures.then(|| worlds.renderer(number));
        let (mut picture, mut bytes) = (Picture::default(), Vec::new());
        for frame in &frames {
            if let Some(renderer) = &renderer {
                renderer.draw_into(&frame.sprites(), &mut picture);
                bytes.clear();
                write_png(&picture, &mut bytes).expect("memory does not fail");
                writer.put(folder::frame_name(frame.tick), &bytes)?;
            }
            if self.settings.masks {
                bytes.clear();
                write_mask(&worlds.mask(frame), (SIDE, SIDE), &mut bytes).expect("memory does not fail");
                writer.put(folder::mask_name(frame.tick), &bytes)?;
            }
            step(1)?;
        }
        // The tables come after the pictures, because the boxes of the drawn icons are then cached.
        let entities = Table::entities(worlds, number, &frames);
        let concepts = count_concepts(&entities)?;
        for (name, table) in [(ENTITIES, entities), (PAIRS, Table::pairs(worlds, number, &frames))] {
            let mut bytes = Vec::new();
            table.write(&mut bytes).expect("memory does not fail");
            writer.put(name.to_owned(), &bytes)?;
        }
        writer.finish(self.settings.clone(), |files| WorldRecord {
            world: number,
            seed: worlds.seed(number),
            frames: frames.len(),
            actions: count_actions(&frames),
            agents: frames.iter().map(|frame| frame.agents.len() as u64).sum(),
            concepts,
            atoms: count_atoms(&worlds.world().vocabulary, frames.iter().map(|frame| &frame.facts)),
            files,
        })?;
        Ok(())
    }
}

/// Adds units of work to the progress. Fails after cancellation.
pub(super) type Step<'s> = &'s dyn Fn(u64) -> Result<(), Diagnostic>;

/// Progress and cancellation of work on several threads.
pub(super) struct Monitor<'c> {
    done: AtomicU64,
    total: u64,
    /// The last number that `progress` received.
    reported: AtomicU64,
    cancelled: AtomicBool,
    progress: &'c (dyn Fn(u64, u64) + Sync),
    cancel: &'c Cancel,
}

impl<'c> Monitor<'c> {
    pub(super) fn new(total: u64, progress: &'c (dyn Fn(u64, u64) + Sync), cancel: &'c Cancel) -> Monitor<'c> {
        Monitor {
            done: AtomicU64::new(0),
            total,
            reported: AtomicU64::new(u64::MAX),
            cancelled: AtomicBool::new(false),
            progress,
            cancel,
        }
    }

    fn report(&self) {
        let done = self.done.load(Ordering::Relaxed);
        if self.reported.swap(done, Ordering::Relaxed) != done {
            (self.progress)(done, self.total);
        }
    }

    /// Reports progress and polls for cancellation. Returns whether the work is cancelled.
    fn poll(&self) -> bool {
        self.report();
        if self.cancel.requested() {
            self.cancelled.store(true, Ordering::Relaxed);
        }
        self.cancelled.load(Ordering::Relaxed)
    }

    fn check(&self) -> Result<(), Diagnostic> {
        match self.cancelled.load(Ordering::Relaxed) {
            true => Err(Diagnostic::cancelled()),
            false => Ok(()),
        }
    }

    /// Runs `work` for every item. The first failure ends the run; with several threads it may vary which failure is
    /// returned.
    pub(super) fn run<T: Sync, R: Send>(
        &self,
        threads: NonZeroUsize,
        items: &[T],
        work: impl Fn(&T, Step<'_>) -> Result<R, DatasetError> + Sync,
    ) -> Result<Vec<R>, DatasetError> {
        self.poll();
        self.check()?;
        let count = |units| self.done.fetch_add(units, Ordering::Relaxed);
        let pool = start_threads(threads.get().min(items.len()))?;
        let results = match &threads_of(pool.as_ref())? {
            None => {
                let step = |units| {
                    count(units);
                    self.poll();
                    self.check()
                };
                items.iter().map(|item| work(item, &step)).collect()
            }
            Some(pool) => {
                let step = |units| {
                    count(units);
                    self.check()
                };
                run_polled(pool, &|| _ = self.poll(), || {
                    let items = items.par_iter().with_max_len(1);
                    items.map(|item| work(item, &step)).collect::<Result<Vec<R>, _>>()
                })
            }
        }?;
        self.report();
        Ok(results)
    }
}
