//! `logicity vap`
//!
//! [`folder`] knows how a data set lies on disk, [`card`] what its README says, [`check`] reads it again.

mod card;
mod check;
mod folder;

use crate::city::{Action, Split};
use crate::cli::icons::IconOptions;
use crate::cli::{Failure, load_city, make_folder, one_of, progress};
use crate::config::Scenario;
use crate::datalog::Program;
use crate::diag::Sources;
use crate::render::{Picture, write_png};
use crate::sim::start_threads;
use crate::task::vap::table::{Table, count_concepts};
use crate::task::vap::{Agents, FIRST_TICK, TICKS, Worlds, count_actions, count_atoms, icon_seed, published_worlds};
use folder::{ENTITIES, Manifest, PAIRS, Record, Settings, WorldWriter, wrong};
use indicatif::ProgressBar;
use rayon::prelude::*;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The most worlds of a data set.
const WORLDS_MAX: i64 = 100_000;

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Make worlds, or go on where making them was ended; worlds that are there stay
    Make(Make),
    /// Check files, hashes, order, pictures and boxes of a data set, and derive every label from what it says is true
    Check(check::Check),
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

    fn config(self) -> String {
        format!("vap-{}", self.name())
    }

    /// What the paper's fixed test set counts, in the order of [`Action::ALL`].
    const fn published(self) -> [u64; 4] {
        match self {
            Mode::Easy => [3042, 3978, 0, 7220],
            Mode::Hard => [4155, 2882, 715, 6488],
        }
    }
}

/// What a data set is made with.
struct City {
    scenario: Scenario,
    program: Program,
    config_hash: String,
    rules_hash: String,
}

impl City {
    fn load(mode: Mode, sources: &mut Sources) -> Result<City, Failure> {
        let city = load_city(sources, Path::new(&mode.config()), None)?;
        Ok(City {
            config_hash: city.scenario.hash.clone(),
            rules_hash: city.rules_hash(sources),
            scenario: city.scenario,
            program: city.program,
        })
    }
}

#[derive(clap::Args)]
#[command(mut_arg("difficulty", |difficulty| difficulty.default_value("50")))]
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
    /// Tables only; boxes are those of the pictures that would be there
    #[arg(long)]
    no_pictures: bool,
    #[command(flatten)]
    icons: IconOptions,
    /// Threads; 0 is one for each core. The bytes are the same with any number
    #[arg(long, value_parser = super::threads, default_value = "0", allow_negative_numbers = true)]
    threads: NonZeroUsize,
    /// The folder to write
    #[arg(short, long)]
    out: PathBuf,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    match &arguments.what {
        What::Make(make) => make.run(sources),
        What::Check(check) => check.run(sources),
    }
}

impl Make {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let city = City::load(self.mode, sources)?;
        let (icons, pack_hash) = self.icons.load_hashed(icon_seed(self.seed, self.split))?;
        let difficulty = icons.difficulty().as_percent();
        let worlds = Worlds::new(
            city.scenario,
            city.program,
            Arc::new(icons),
            self.agents,
            self.split,
            self.seed,
        )?;
        let settings = Settings {
            data: folder::DATA.to_owned(),
            version: folder::VERSION,
            mode: self.mode.name().to_owned(),
            agents: self.agents.name().to_owned(),
            split: self.split.name().to_owned(),
            seed: self.seed,
            config_hash: city.config_hash,
            rules_hash: city.rules_hash,
            pictures: !self.no_pictures,
            difficulty,
            pack_mode: pack_hash.is_some().then(|| self.icons.pack_mode.name().to_owned()),
            pack_hash,
            drawing_hash: folder::hash(worlds.specimen().pixels()),
        };
        make_folder(&self.out)?;
        for (path, file) in folder::worlds(&self.out)? {
            if file.settings != settings {
                let fault = wrong(
                    &path,
                    "is of a data set with other settings, configuration, rules or pictures",
                );
                return Err(fault.help("name another folder with `--out`").into());
            }
        }
        folder::remove_partials(&self.out)?;
        let made = self.write_worlds(&settings, &worlds)?;
        let records = folder::worlds(&self.out)?.into_iter().map(|(_, file)| file.record);
        let manifest = Manifest::new(settings, records.collect());
        folder::write_description(&self.out, &card::card(self.mode, &manifest, &worlds), &manifest)?;
        writeln!(
            io::stdout(),
            "worlds made: {made}, in {}: {}; labels of cars: {}",
            self.out.display(),
            manifest.worlds.len(),
            label_shares(manifest.actions)
        )?;
        Ok(())
    }

    /// Writes the worlds that are not there; how many.
    fn write_worlds(&self, settings: &Settings, worlds: &Worlds) -> Result<usize, Failure> {
        let count = self.worlds.unwrap_or(published_worlds(self.split));
        let missing: Vec<u32> = (self.first_world..self.first_world + count)
            .filter(|&number| !self.out.join(folder::world_name(number)).exists())
            .collect();
        let bar = progress("frame", missing.len() as u64 * (TICKS - FIRST_TICK));
        on_threads(self.threads, &missing, |&number| {
            self.write_world(settings, worlds, number, &bar)
        })?;
        bar.finish_and_clear();
        Ok(missing.len())
    }

    fn write_world(&self, settings: &Settings, worlds: &Worlds, number: u32, bar: &ProgressBar) -> Result<(), Failure> {
        let mut writer = WorldWriter::begin(&self.out, number)?;
        let frames = worlds.frames(number)?;
        if settings.pictures {
            let renderer = worlds.renderer(number);
            let (mut picture, mut bytes) = (Picture::default(), Vec::new());
            for frame in &frames {
                renderer.draw_into(&frame.sprites(), &mut picture);
                bytes.clear();
                write_png(&picture, &mut bytes).expect("memory does not fail");
                writer.put(folder::frame_name(frame.tick), &bytes)?;
                bar.inc(1);
            }
        } else {
            bar.inc(frames.len() as u64);
        }
        // The pictures first: whose icon has been drawn, of those the boxes are known.
        let entities = Table::entities(worlds, number, &frames);
        let concepts = count_concepts(&entities)?;
        for (name, table) in [(ENTITIES, entities), (PAIRS, Table::pairs(worlds, number, &frames))] {
            let mut bytes = Vec::new();
            table.write(&mut bytes).expect("memory does not fail");
            writer.put(name.to_owned(), &bytes)?;
        }
        writer.finish(settings.clone(), |files| Record {
            world: number,
            seed: worlds.seed(number),
            frames: frames.len(),
            actions: count_actions(&frames),
            agents: frames.iter().map(|frame| frame.agents.len() as u64).sum(),
            concepts,
            atoms: count_atoms(&worlds.world().vocabulary, frames.iter().map(|frame| &frame.facts)),
            files,
        })
    }
}

/// Does the work for each, on so many threads. The first that fails ends it; which that is may depend on threads.
fn on_threads<T: Sync, R: Send>(
    threads: NonZeroUsize,
    all: &[T],
    work: impl Fn(&T) -> Result<R, Failure> + Send + Sync,
) -> Result<Vec<R>, Failure> {
    match start_threads(threads.get().min(all.len()))? {
        None => all.iter().map(work).collect(),
        Some(pool) => pool.install(|| all.par_iter().with_max_len(1).map(work).collect()),
    }
}

/// `41.0 %`
fn percent(count: u64, total: u64) -> String {
    let tenths = (count * 1000 + total / 2) / total.max(1);
    format!("{}.{} %", tenths / 10, tenths % 10)
}

/// `Slow 12 (80.0 %), Normal 3 (20.0 %)`
fn shares<'a>(counts: impl Iterator<Item = (&'a str, u64)>, total: u64) -> String {
    let words = counts.map(|(name, count)| format!("{name} {count} ({})", percent(count, total)));
    words.collect::<Vec<_>>().join(", ")
}

/// How many labels are which.
fn label_shares(actions: [u64; 4]) -> String {
    let names = Action::ALL.iter().map(|action| action.name());
    shares(names.zip(actions), actions.iter().sum())
}
