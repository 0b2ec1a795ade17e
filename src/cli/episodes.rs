//! `logicity episodes`: generates, checks and prints recorded episodes.

use crate::builtin::BuiltinFiles;
use crate::city::{ActionTable, Split};
use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::values::{ShardOption, integer, one_of};
use crate::cli::{inputs, terminal};
use crate::diag::{Diagnostic, SourceId, Sources, counted};
use crate::files;
use crate::task::shard::{self, Origin, Shard};
use crate::task::spf::codes;
use crate::task::spf::{
    Baseline, ControlMode, Env, Episode, EpisodeSet, EpisodeShard, Policy, RANDOM_RUNS, Rollout, SpfTask,
    make_episodes, rollout, summarize,
};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The largest number of episodes in a set.
const COUNT_MAX: u32 = 100_000;

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: EpisodesCommand,
}

#[derive(clap::Subcommand)]
enum EpisodesCommand {
    /// Generate episodes that the oracle solves, balanced over the kinds of egos, and write them to a file
    Make(Make),
    /// Verify that the oracle solves the recorded episodes exactly as recorded
    Check(Which),
    /// Print recorded episodes, one per line, and the results of the oracle and of a random policy
    Show(Show),
    /// Generate many sets of episodes and print how the measures vary between sets
    Spread(Spread),
}

#[derive(clap::Args)]
struct Which {
    /// Configuration with a task
    #[arg(default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    #[command(flatten)]
    limits: LimitOptions,
}

#[derive(clap::Args)]
struct Make {
    #[command(flatten)]
    which: Which,
    /// Number of episodes [default: 40 for val, 100 for train and test]
    #[arg(long, value_parser = integer(1..=COUNT_MAX))]
    count: Option<u32>,
    /// Seed of the episodes
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    shard: ShardOption,
    /// Write the episodes to FILE; `-` means standard output [default: the file that the configuration names]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
}

#[derive(clap::Args)]
struct Show {
    #[command(flatten)]
    which: Which,
    /// Print one episode in full, by its number from 0
    #[arg(long, value_parser = integer(0..=usize::MAX))]
    episode: Option<usize>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
struct Spread {
    #[command(flatten)]
    which: Which,
    /// Number of sets, generated with the seeds 1, 2, ...
    #[arg(long, value_parser = integer(2..=100_000_u32), default_value_t = 40)]
    sets: u32,
    /// Episodes per set [default: 40 for val, 100 for train and test]
    #[arg(long, value_parser = integer(1..=100_000_u32))]
    count: Option<u32>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Generates, checks or prints episodes, or measures the spread of their sets.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    match &arguments.what {
        EpisodesCommand::Make(make) => make.run(sources),
        EpisodesCommand::Check(which) => which.check(sources),
        EpisodesCommand::Show(show) => show.run(sources),
        EpisodesCommand::Spread(spread) => spread.run(sources),
    }
}

impl Which {
    fn task(&self, sources: &mut Sources) -> Result<Arc<SpfTask>, Failure> {
        let world = load_city(sources, &self.config, self.rules.as_deref(), &self.limits)?.world()?;
        Ok(Arc::new(SpfTask::new(Arc::new(world), sources)?))
    }

    /// Returns the number of episodes in a set.
    fn count(&self, given: Option<u32>) -> usize {
        let usual = if self.split == Split::Val { 40 } else { 100 };
        given.unwrap_or(usual) as usize
    }

    /// Returns the task's recorded episodes, and an environment for them.
    fn load(&self, sources: &mut Sources) -> Result<(Env, EpisodeSet), Failure> {
        let task = self.task(sources)?;
        let set = EpisodeSet::load(&task, self.split, sources, &BuiltinFiles)?;
        Ok((Env::new(task, self.split, ControlMode::First)?, set))
    }

    fn check(&self, sources: &mut Sources) -> Result<(), Failure> {
        let (mut env, set) = self.load(sources)?;
        let mut faults = Vec::new();
        for (number, episode) in set.episodes.iter().enumerate() {
            let of = |fault: Diagnostic| {
                fault.note(format!("in episode {number} of `{}`, {}", set.config, set.split.name()))
            };
            if let Err(fault) = env.reset_to(episode) {
                faults.push(of(fault));
                continue;
            }
            let done = rollout(&mut env, Policy::Oracle)?;
            if let Some(difference) = differs(env.task().world().vocabulary.actions(), episode, &done) {
                faults.push(of(Diagnostic::new(codes::INVALID_EPISODE, difference)));
            }
        }
        if !faults.is_empty() {
            return Err(faults.into());
        }
        let (count, hash) = (set.episodes.len(), set.hash());
        writeln!(
            terminal::out(),
            "{count} episodes match their records: {} {} {hash}",
            set.config,
            set.split.name()
        )?;
        Ok(())
    }
}

/// Describes how a run differs from the recorded one.
fn differs(table: &ActionTable, episode: &Episode, done: &Rollout) -> Option<String> {
    let Some(oracle) = &episode.oracle else {
        return Some("the file has no oracle run for this episode".to_owned());
    };
    if !done.success {
        return Some(format!(
            "the oracle does not reach the goal within {} steps",
            done.steps
        ));
    }
    let close = (done.total - oracle.total).abs() <= 1e-9;
    let constrained = done.constrained_by_name(table);
    let same = done.steps == oracle.steps && close && constrained == oracle.constrained;
    (!same).then(|| {
        format!(
            "oracle steps {}, return {}, but the record has {} and {}; constrained steps {:?}, but the record has {:?}",
            done.steps, done.total, oracle.steps, oracle.total, constrained, oracle.constrained
        )
    })
}

/// What the episodes of a shard depend on besides the configuration.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Requested {
    split: String,
    count: usize,
    seed: u64,
}

impl Make {
    /// Writes a shard.
    fn run_shard(&self, shard: Shard, sources: &mut Sources) -> Result<(), Failure> {
        let Some(path) = &self.output else {
            return Err(Failure::Usage("`--shard` needs `--output FILE`".into()));
        };
        let Which {
            config,
            split,
            rules,
            limits,
        } = &self.which;
        inputs::refuse_undecodable(config, rules.as_deref())?;
        let city = load_city(sources, config, rules.as_deref(), limits)?;
        let rules_hash = city.rules_hash.clone();
        let task = Arc::new(SpfTask::new(Arc::new(city.world()?), sources)?);
        let count = self.which.count(self.count);
        let origin = Origin {
            config: config.clone(),
            rules: rules.clone(),
            config_hash: task.world().scenario.hash.clone(),
            rules_hash,
            request: Requested {
                split: split.name().to_owned(),
                count,
                seed: self.seed,
            },
        };
        let mut out = self.force.create("episodes", path, &Inputs::of(sources))?;
        let bar = terminal::progress("episode", shard.share(count) as u64);
        let made = EpisodeShard::draw(&task, (*split, count, self.seed), shard, |found| {
            bar.set_position(found as u64)
        })?;
        bar.finish_and_clear();
        made.write(&origin, &mut out)
            .map_err(|error| unwritable(path, &error))?;
        finish(out, path)?;
        let found = counted(made.episodes.len(), "possible episode");
        let (searched, path_shown) = (made.searched, path.display());
        writeln!(
            messages(&[path]),
            "wrote shard {shard} to {path_shown}: {found} in {searched} draws"
        )?;
        Ok(())
    }

    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        if let Some(shard) = self.shard.shard {
            return self.run_shard(shard, sources);
        }
        let (task, split) = (self.which.task(sources)?, self.which.split);
        let count = self.which.count(self.count);
        let named = task.config().episodes[split as usize]
            .as_ref()
            .map(|file| file.value.clone());
        let path = match self.output.clone().or(named) {
            Some(path) if path.starts_with(files::BUILTIN_FOLDER) => {
                return Err(Failure::Usage(
                    "the configuration is built in: specify the output file with `--output`".into(),
                ));
            }
            Some(path) => path,
            None => {
                return Err(Failure::Usage(
                    "the configuration has no episode file for this split: specify one with `--output`".into(),
                ));
            }
        };
        let mut out = self.force.create("episodes", &path, &Inputs::of(sources))?;
        let bar = terminal::progress("episode", count as u64);
        let set = make_episodes(&task, split, count, self.seed, |found| bar.set_position(found as u64))?;
        bar.finish_and_clear();
        set.write(&mut out).map_err(|error| unwritable(&path, &error))?;
        finish(out, &path)?;
        writeln!(
            messages(&[&path]),
            "wrote {} to {}: {}",
            counted(count, "episode"),
            path.display(),
            set.hash()
        )?;
        Ok(())
    }
}

/// Joins the shards in some files, for `logicity merge`.
pub fn merge(
    shards: &[SourceId],
    output: &Path,
    (force, limits): (&ForceOption, &LimitOptions),
    sources: &mut Sources,
) -> Result<(), Failure> {
    let header = |&source: &SourceId| {
        let header = shard::read::<Requested>(sources.text(source), source)?.header;
        Ok::<_, Diagnostic>((sources.name(source).to_owned(), header.shard, header.origin))
    };
    let known: Vec<_> = shards.iter().map(header).collect::<Result<_, _>>()?;
    let order = shard::in_order(&known)?;
    let origin = &known[0].2;
    let city = load_city(sources, &origin.config, origin.rules.as_deref(), limits)?;
    origin.check(&city.scenario.hash, &city.rules_hash)?;
    let Requested { split, count, seed } = &origin.request;
    let split = Split::ALL.into_iter().find(|known| known.name() == split);
    let split = split.ok_or_else(|| shard::invalid("the request of the shards names an unknown split"))?;
    if !(1..=COUNT_MAX as usize).contains(count) {
        return Err(shard::invalid(format!(
            "the request of the shards has {count} episodes, not 1 to {COUNT_MAX}"
        ))
        .into());
    }
    let task = Arc::new(SpfTask::new(Arc::new(city.world()?), sources)?);
    let mut made = Vec::new();
    for index in order {
        let source = shards[index];
        let read = shard::read::<Requested>(sources.text(source), source)?;
        made.push(EpisodeShard::read(&read, source, &task, split)?);
    }
    let mut out = force.create("merge", output, &Inputs::of(sources))?;
    let bar = terminal::progress("episode", *count as u64);
    let request = (split, *count, *seed);
    let (set, added) = EpisodeShard::join(&task, request, &made, |found| bar.set_position(found as u64))?;
    bar.finish_and_clear();
    set.write(&mut out).map_err(|error| unwritable(output, &error))?;
    finish(out, output)?;
    let mut said = messages(&[output]);
    let (joined, path) = (counted(made.len(), "shard"), output.display());
    writeln!(
        said,
        "joined {joined}, and searched {}",
        counted(usize::try_from(added).unwrap_or(0), "further draw")
    )?;
    writeln!(said, "wrote {} to {path}: {}", counted(*count, "episode"), set.hash())?;
    Ok(())
}

impl Show {
    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let (mut env, set) = self.which.load(sources)?;
        if let Some(number) = self.episode {
            let count = set.episodes.len();
            let episode = set
                .episodes
                .get(number)
                .ok_or_else(|| Failure::Usage(format!("no episode {number}: the numbers are 0 to {}", count - 1)))?;
            return one(&mut env, episode);
        }
        let (oracle, random) = drive(&mut env, &set)?;
        let task = env.task();
        let (wanted, drawn) = (summarize(task, &oracle, Some(random.returns())), random.summary(task));
        let mut out = terminal::results(self.json);
        if self.json {
            let all = json!({
                "config": set.config, "split": set.split.name(), "seed": set.seed, "hash": set.hash(),
                "episodes": set.episodes.len(), "oracle": wanted, "random": drawn,
            });
            writeln!(out, "{all}")?;
            return Ok(());
        }
        writeln!(
            out,
            "{:>7} {:20} {:>8} {:>5} {:>5} {:>7}  constrained",
            "episode", "ego", "priority", "cells", "steps", "return"
        )?;
        let task = Arc::clone(env.task());
        let table = task.world().vocabulary.actions();
        for (number, (episode, done)) in set.episodes.iter().zip(&oracle).enumerate() {
            env.reset_to(episode)?;
            let ego = &episode.agents[env.controlled_cars()[0].agent()];
            let (carried, cells) = (ego.concepts.join("+"), env.controlled_cars()[0].cells());
            let (steps, total) = (done.steps, done.total);
            writeln!(
                out,
                "{number:>7} {carried:20} {:>8} {cells:>5} {steps:>5} {total:>7.3}  {}",
                ego.priority,
                asked(table, &done.constrained_by_name(table))
            )?;
        }
        writeln!(out)?;
        writeln!(
            out,
            "{:8} {:>18} {:>18} {:>18} {:>22} {:>7} {:>6}",
            "policy", "compliance", "TSR", "DSR", "Score", "return", "steps"
        )?;
        for (name, summary) in [("oracle", &wanted), ("random", &drawn)] {
            let rate = |rate: crate::task::spf::Rate| {
                if rate.runs > 0 {
                    format!("{:.2} [{:.2}, {:.2}]", rate.value, rate.low, rate.high)
                } else {
                    "-".to_owned()
                }
            };
            let score = summary.score.map_or_else(String::new, |score| {
                format!("{:.2} [{:.2}, {:.2}]", score.value, score.low, score.high)
            });
            let (total, steps) = (summary.mean_return.value, summary.mean_steps);
            let (compliance, tsr, dsr) = (rate(summary.compliance), rate(summary.tsr), rate(summary.dsr));
            writeln!(
                out,
                "{name:8} {compliance:>18} {tsr:>18} {dsr:>18} {score:>22} {total:>7.2} {steps:>6.1}"
            )?;
        }
        writeln!(out, "{} {} {}", set.config, set.split.name(), set.hash())?;
        Ok(())
    }
}

/// Runs the oracle and the random policy on all episodes of a set.
fn drive(env: &mut Env, set: &EpisodeSet) -> Result<(Vec<Rollout>, Baseline), Diagnostic> {
    let (mut oracle, mut random) = (Vec::new(), Baseline::default());
    for episode in &set.episodes {
        env.reset_to(episode)?;
        oracle.push(rollout(env, Policy::Oracle)?);
        random.add(env, episode)?;
    }
    Ok((oracle, random))
}

impl Spread {
    /// The measures of a set. The last uses one random run per episode, as the paper does.
    const MEASURES: [&str; 7] = [
        "score",
        "oracle return",
        "oracle steps",
        "random return",
        "random steps",
        "random TSR",
        "score, one random run",
    ];

    fn run(&self, sources: &mut Sources) -> Result<(), Failure> {
        let (task, split) = (self.which.task(sources)?, self.which.split);
        let count = self.which.count(self.count);
        let mut env = Env::new(Arc::clone(&task), split, ControlMode::First)?;
        let bar = terminal::progress("set", self.sets.into());
        let mut measured: [Vec<f64>; Self::MEASURES.len()] = Default::default();
        for seed in 1..=u64::from(self.sets) {
            let set = make_episodes(&task, split, count, seed, |_| ())?;
            let (oracle, random) = drive(&mut env, &set)?;
            for (values, value) in measured.iter_mut().zip(Self::measure(&task, &oracle, &random)) {
                values.push(value);
            }
            bar.set_position(seed);
        }
        bar.finish_and_clear();
        let rows = Self::MEASURES
            .iter()
            .zip(measured.iter().map(|values| Spread::of(values)));
        let mut out = terminal::results(self.json);
        if self.json {
            let measures: serde_json::Map<String, serde_json::Value> = rows
                .map(|(name, [mean, deviation, least, most])| {
                    let measure = json!({"mean": mean, "standard_deviation": deviation, "min": least, "max": most});
                    ((*name).to_owned(), measure)
                })
                .collect();
            let (config, split) = (&task.world().scenario.name, split.name());
            let all =
                json!({"config": config, "split": split, "sets": self.sets, "episodes": count, "measures": measures});
            writeln!(out, "{all}")?;
            return Ok(());
        }
        writeln!(
            out,
            "{:22} {:>8} {:>8} {:>8} {:>8}",
            "measure", "mean", "sd", "min", "max"
        )?;
        for (name, [mean, deviation, least, most]) in rows {
            writeln!(out, "{name:22} {mean:>8.2} {deviation:>8.2} {least:>8.2} {most:>8.2}")?;
        }
        writeln!(out, "{} sets of {count} episodes", self.sets)?;
        Ok(())
    }

    fn measure(task: &SpfTask, oracle: &[Rollout], random: &Baseline) -> [f64; Self::MEASURES.len()] {
        let (wanted, drawn) = (summarize(task, oracle, None), random.summary(task));
        let first = random.rollouts().iter().step_by(RANDOM_RUNS.into());
        let once: Vec<f64> = first.map(|rollout| rollout.total).collect();
        let score = |random: &[f64]| {
            summarize(task, oracle, Some(random))
                .score
                .map_or(f64::NAN, |score| score.value)
        };
        [
            score(random.returns()),
            wanted.mean_return.value,
            wanted.mean_steps,
            drawn.mean_return.value,
            drawn.mean_steps,
            drawn.tsr.value,
            score(&once),
        ]
    }

    /// Returns mean, standard deviation, minimum and maximum.
    #[allow(clippy::cast_precision_loss)] // fewer than 2^53 sets
    fn of(values: &[f64]) -> [f64; 4] {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        [mean, (squares / (n - 1.0)).sqrt(), least, most]
    }
}

/// Formats constrained steps, for example `Stop 3, Fast 1`.
fn asked(table: &ActionTable, constrained: &BTreeMap<String, u32>) -> String {
    let words: Vec<String> = (table.names())
        .filter_map(|action| Some(format!("{action} {}", constrained.get(action)?)))
        .collect();
    words.join(", ")
}

/// Prints one episode in full.
fn one(env: &mut Env, episode: &Episode) -> Result<(), Failure> {
    env.reset_to(episode)?;
    let mut out = terminal::out();
    writeln!(out, "seed {}, at most {} steps", episode.seed, env.horizon())?;
    if let Some(oracle) = &episode.oracle {
        let (steps, total) = (oracle.steps, oracle.total);
        writeln!(
            out,
            "oracle: {steps} steps, return {total:.4}, constrained: {}",
            asked(env.task().world().vocabulary.actions(), &oracle.constrained)
        )?;
    }
    let place = |cell: crate::city::Cell| format!("[{}, {}]", cell.row, cell.col);
    writeln!(
        out,
        "{:14} {:20} {:>8} {:>10} {:>10} {:>5}",
        "agent", "concepts", "priority", "start", "goal", "cells"
    )?;
    for (agent, driven) in episode.agents.iter().zip(env.city().agents()) {
        let (name, carried) = (agent.name.to_string(), agent.concepts.join("+"));
        let (start, goal, cells) = (place(agent.start), place(agent.goal), driven.route().steps() + 1);
        writeln!(
            out,
            "{name:14} {carried:20} {:>8} {start:>10} {goal:>10} {cells:>5}",
            agent.priority
        )?;
    }
    Ok(())
}
