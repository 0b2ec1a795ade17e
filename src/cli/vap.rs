//! `logicity vap`: makes and checks data sets of Visual Action Prediction.

use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::cli::failure::Failure;
use crate::cli::icons::IconOptions;
use crate::cli::limits::{LimitOptions, MemoryOption};
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, refuse_stdout_as_folder};
use crate::cli::terminal;
use crate::cli::values::{ShardOption, integer, one_of, threads};
use crate::diag::Sources;
use crate::files::Folder;
use crate::render::{Difficulty, Icons};
use crate::task;
use crate::task::vap::{
    Agents, Dataset, DatasetError, DatasetRequest, DatasetWriter, Estimate, Manifest, Mode, Statistics, WORLDS_MAX,
    WorldCounts, Worlds, icon_seed, percent, published_worlds, total,
};
use std::io::Write;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: VapCommand,
}

#[derive(clap::Subcommand)]
enum VapCommand {
    /// Make the worlds of a data set; existing worlds stay, so an interrupted run can be resumed
    Make(Make),
    /// Check files, hashes, order, pictures and boxes of a data set, and derive every label from the facts
    Check(Check),
    /// Estimate the shares of labels and the number of true facts, with standard errors; writes no files
    Stats(Stats),
}

/// The worlds of a data set.
#[derive(clap::Args)]
struct WorldOptions {
    /// Rules: those of configs/vap-easy.yaml or configs/vap-hard.yaml
    #[arg(long, value_parser = one_of(&Mode::ALL, Mode::name))]
    mode: Mode,
    /// Agents: from the configuration, or drawn for each world
    #[arg(long, value_parser = one_of(&Agents::ALL, Agents::name), default_value = "fixed")]
    agents: Agents,
    /// Agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name))]
    split: Split,
    /// Number of worlds [default: 100 for train, 20 for val and test]
    #[arg(long, value_parser = integer(1..=WORLDS_MAX))]
    worlds: Option<u32>,
    /// Number of the first world, so that several processes can make parts of a data set
    #[arg(long, value_parser = integer(0..=WORLDS_MAX - 1), default_value_t = 0)]
    first_world: u32,
    /// Seed of the data set
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Number of threads; 0 means one per core. The result does not depend on it
    #[arg(long, value_parser = threads, default_value = "0")]
    threads: NonZeroUsize,
}

impl WorldOptions {
    fn numbers(&self) -> Range<u32> {
        let count = self.worlds.unwrap_or(published_worlds(self.split));
        self.first_world..self.first_world + count
    }
}

#[derive(clap::Args)]
#[command(mut_arg("difficulty", |difficulty| difficulty.default_value("50")))]
struct Make {
    #[command(flatten)]
    worlds: WorldOptions,
    #[command(flatten)]
    shard: ShardOption,
    /// Write tables only; boxes are the same as with pictures
    #[arg(long)]
    no_pictures: bool,
    /// Also write a mask for each picture: a grayscale PNG with the number of the agent that each pixel shows
    #[arg(long)]
    masks: bool,
    #[command(flatten)]
    icons: IconOptions,
    /// Folder to write
    #[arg(short, long)]
    out: PathBuf,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    _memory: MemoryOption,
}

#[derive(clap::Args)]
struct Check {
    /// Folder of the data set
    folder: PathBuf,
    /// Number of threads; 0 means one per core
    #[arg(long, value_parser = threads, default_value = "0")]
    threads: NonZeroUsize,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

#[derive(clap::Args)]
struct Stats {
    #[command(flatten)]
    worlds: WorldOptions,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    match &arguments.what {
        VapCommand::Make(make) => make.run(sources),
        VapCommand::Check(check) => check.run(sources),
        VapCommand::Stats(stats) => stats.run(sources),
    }
}

impl From<DatasetError> for Failure {
    fn from(error: DatasetError) -> Self {
        match error {
            DatasetError::Faulty(faults) => faults.into(),
            DatasetError::File(error) => error.into(),
            DatasetError::Occupied(occupied) => {
                let help = match occupied.replaceable {
                    true => "choose another folder, or replace the file with `--force`",
                    false => "choose another folder, or move it elsewhere",
                };
                Failure::Usage(format!("{occupied}\nhelp: {help}"))
            }
        }
    }
}

/// Joins the shards in some folders, for `logicity merge`.
pub fn merge(shards: &[PathBuf], out: &Path, force: &ForceOption, sources: &mut Sources) -> Result<(), Failure> {
    refuse_stdout_as_folder(out)?;
    let open = |path: &PathBuf| Dataset::open(Folder::new(path));
    let sets = shards.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let mode = sets[0].mode();
    let city = load_city(sources, Path::new(mode.config()), None, &LimitOptions::default())?;
    let hashes = (city.scenario.hash.clone(), city.rules_hash.clone());
    let world = city.world()?;
    let made_with = [hashes.0.as_str(), hashes.1.as_str()];
    let summary = with_bar("world", |progress| {
        let city = (&world.vocabulary, made_with);
        task::vap::merge(out, &sets, city, force.overwrite(), progress, &Cancel::never())
    })?;
    writeln!(
        terminal::out(),
        "shards: {}, worlds copied: {}, in {}: {}; labels of cars: {}",
        sets.len(),
        summary.made,
        out.display(),
        summary.manifest.worlds.len(),
        action_shares(summary.manifest.actions)
    )?;
    Ok(())
}

/// Runs `work` with a progress bar. `work` reports the numbers of units done and in total.
fn with_bar<R>(unit: &str, work: impl FnOnce(&(dyn Fn(u64, u64) + Sync)) -> R) -> R {
    let bar = terminal::progress(unit, 0);
    let result = work(&|done, total| {
        bar.set_length(total);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    result
}

impl Make {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        refuse_stdout_as_folder(&self.out)?;
        let worlds = &self.worlds;
        let city = load_city(sources, Path::new(worlds.mode.config()), None, &LimitOptions::default())?;
        let request = DatasetRequest {
            mode: worlds.mode,
            agents: worlds.agents,
            split: worlds.split,
            worlds: worlds.numbers(),
            shard: self.shard.shard,
            seed: worlds.seed,
            pictures: !self.no_pictures,
            masks: self.masks,
            threads: worlds.threads,
        };
        let icons = self.icons.load(request.icon_seed(), &city.scenario.looks)?;
        let folder = Folder::make(&self.out)?;
        let writer = DatasetWriter::new(request, city, icons)?;
        let summary = with_bar("frame", |progress| {
            writer.write(&folder, self.force.overwrite(), progress, &Cancel::never())
        })?;
        writeln!(
            terminal::out(),
            "worlds made: {}, in {}: {}; labels of cars: {}",
            summary.made,
            self.out.display(),
            summary.manifest.worlds.len(),
            action_shares(summary.manifest.actions)
        )?;
        Ok(())
    }
}

impl Check {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let dataset = Dataset::open(Folder::new(&self.folder))?;
        let city = load_city(
            sources,
            Path::new(dataset.mode().config()),
            None,
            &LimitOptions::default(),
        )?;
        with_bar("world", |progress| {
            dataset.check(city, self.threads, progress, &Cancel::never())
        })?;
        let published = dataset.mode().published_actions();
        let manifest = dataset.manifest();
        let pictures = manifest.pictures();
        let Manifest {
            frames,
            actions,
            agents,
            concepts,
            atoms,
            worlds,
            ..
        } = manifest;
        let worlds = worlds.len();
        let mut out = terminal::results(self.json);
        if self.json {
            let counts = serde_json::json!({
                "worlds": worlds, "frames": frames, "pictures": pictures, "actions": actions,
                "published": published, "agents": agents, "concepts": concepts, "atoms": atoms,
            });
            writeln!(out, "{counts}")?;
            return Ok(());
        }
        writeln!(
            out,
            "worlds: {worlds}, frames: {frames}, pictures: {pictures}, every label follows from the facts"
        )?;
        writeln!(out, "labels of cars: {}", action_shares(*actions))?;
        writeln!(out, "published test: {}", action_shares(published))?;
        let concepts = concepts.iter().map(|(name, count)| (name.as_str(), *count));
        writeln!(out, "agents: {}", shares(concepts, *agents))?;
        let atoms: Vec<String> = atoms.iter().map(|(name, count)| format!("{name} {count}")).collect();
        writeln!(out, "true atoms, pairs if an agent sees both: {}", atoms.join(", "))?;
        Ok(())
    }
}

impl Stats {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let options = &self.worlds;
        let city = load_city(
            sources,
            Path::new(options.mode.config()),
            None,
            &LimitOptions::default(),
        )?;
        let icons = Arc::new(Icons::new(icon_seed(options.seed, options.split), Difficulty::CLEAN));
        let worlds = Worlds::new(
            city.scenario,
            city.program,
            icons,
            options.agents,
            options.split,
            options.seed,
        )?;
        let counts = with_bar("world", |progress| {
            WorldCounts::of_worlds(&worlds, options.numbers(), options.threads, progress, &Cancel::never())
        })?;
        let found = Statistics::of(&counts);
        let published = options.mode.published_actions();
        let per = published_worlds(options.split);
        let mut out = terminal::results(self.json);
        if self.json {
            let estimate = |Estimate { value, error }: Estimate| serde_json::json!({"value": value, "error": error});
            let actions = Action::STANDARD.iter().map(|action| action.name().to_owned());
            let actions = actions
                .zip(found.actions.map(estimate))
                .collect::<serde_json::Map<_, _>>();
            let atoms = found.atoms.iter().map(|(name, &atoms)| (name.clone(), estimate(atoms)));
            let all = serde_json::json!({
                "worlds": found.worlds, "labels": found.labels, "published": published,
                "shares": actions, "atoms_per_world": atoms.collect::<serde_json::Map<_, _>>(),
            });
            writeln!(out, "{all}")?;
            return Ok(());
        }
        writeln!(
            out,
            "worlds: {}, labels of cars: {}; estimates with standard errors",
            found.worlds, found.labels
        )?;
        for (action, share) in Action::STANDARD.into_iter().zip(found.actions) {
            let paper = percent(published[action.index()], total(published));
            let share = with_error(share.times(100.0), 1);
            writeln!(out, "{:<16} {share:>16} %, published test {paper}", action.name())?;
        }
        writeln!(out, "true atoms per {per} worlds, pairs if an agent sees both:")?;
        for (name, &atoms) in &found.atoms {
            writeln!(out, "{name:<16} {:>16}", with_error(atoms.times(per.into()), 0))?;
        }
        Ok(())
    }
}

/// Formats an estimate, for example `45.9 ± 0.7`.
fn with_error(Estimate { value, error }: Estimate, decimals: usize) -> String {
    match error {
        Some(error) => format!("{value:.decimals$} ± {error:.decimals$}"),
        None => format!("{value:.decimals$}"),
    }
}

/// Formats counts and shares, for example `Slow 12 (80.0 %), Normal 3 (20.0 %)`.
fn shares<'a>(counts: impl Iterator<Item = (&'a str, u64)>, total: u64) -> String {
    let words = counts.map(|(name, count)| format!("{name} {count} ({})", percent(count, total)));
    words.collect::<Vec<_>>().join(", ")
}

fn action_shares(actions: [u64; 4]) -> String {
    let names = Action::STANDARD.iter().map(|action| action.name());
    shares(names.zip(actions), total(actions))
}
