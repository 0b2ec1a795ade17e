//! `logicity bench`: measures how fast this machine evaluates rules, simulates cities and draws pictures.

use crate::cancel::Cancel;
use crate::city::{Action, Blocks, Building, Buildings, Region, Split, Terrain};
use crate::city::{Agent, Cell};
use crate::cli::failure::Failure;
use crate::cli::limits::LimitOptions;
use crate::cli::load::{inference_of, load_city};
use crate::cli::report::report;
use crate::cli::scenes::{SceneLine, SceneLines};
use crate::cli::terminal;
use crate::cli::values::{integer, one_of, threads};
use crate::config::Scenario;
use crate::datalog::dense::{BitFacts, BitState, Dense, TrackFirings};
use crate::diag::{self, Diagnostic, Sources};
use crate::located::Located;
use crate::render::{Difficulty, Icons, Picture, Renderer, Scale, Sprite, Viewport, read_png, write_png};
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::codes;
use crate::sim::{
    Executor, Facts, Inference, LoadedCity, MAX_ENTITIES, Phase, SceneFacts, Settings, Simulation, WHOLE_MAX,
    WINDOW_MAX, Width, World, in_words,
};
use crate::task::spf::{ControlMode, Env, SpfTask};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// States of the city on which `infer` evaluates the rules. Fewer if together they exceed `STATES_BYTES` (256 MiB).
const STATES: usize = 64;
const STATES_BYTES: usize = 1 << 28;
/// Ticks between two of these states.
const BETWEEN: usize = 7;
/// The maximum number of entities in a scene: the bits of one word.
const SCENE_MAX: usize = Width::One.entities();
/// Ticks after which `scale` places a new city.
const SCALE_TICKS: u32 = 50;
/// The city sizes that `scale` measures, in agents.
const SCALE: [u32; 4] = [1_000, 10_000, 100_000, 1_000_000];

/// The benchmarks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Benchmark {
    Infer,
    Ground,
    Tick,
    Env,
    Render,
    Scale,
}

impl Benchmark {
    const ALL: [Benchmark; 6] = [
        Benchmark::Infer,
        Benchmark::Ground,
        Benchmark::Tick,
        Benchmark::Env,
        Benchmark::Render,
        Benchmark::Scale,
    ];

    const fn name(self) -> &'static str {
        match self {
            Benchmark::Infer => "infer",
            Benchmark::Ground => "ground",
            Benchmark::Tick => "tick",
            Benchmark::Env => "env",
            Benchmark::Render => "render",
            Benchmark::Scale => "scale",
        }
    }
}

#[derive(clap::Args)]
pub struct Arguments {
    /// The benchmark. infer: the rules alone, on facts in memory, as bits (dense) or as changing rows (relational).
    /// ground: all facts that the rules can read. tick: a city, placed again after the configuration's ticks. env:
    /// episodes of the configuration's task under a random policy, with observations. render: pictures like those of
    /// the visual data set, drawn, encoded as PNG and decoded, at difficulties 0 and 50, and smaller ones. scale:
    /// cities of 1000 agents up to --agents
    #[arg(value_parser = one_of(&Benchmark::ALL, Benchmark::name))]
    what: Benchmark,
    /// Configuration of the city
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test", conflicts_with = "scenes")]
    split: Split,
    /// Scale the city to this many agents, rounded up to whole copies of the configuration's agent list (`repeat` is
    /// ignored). The map grows so that the density stays the same; trips stay as long as the configuration's region is
    /// wide. For scale: the largest city [default: those of the
    /// configuration; 1000000 for scale]. infer takes at most 4096 agents, ground 256
    #[arg(
        long,
        value_parser = integer(1..=1_000_000_u32),
        conflicts_with = "scenes"
    )]
    agents: Option<u32>,
    /// Executor that evaluates the rules
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// For tick and scale: number of threads, used for cities of many agents; 0 means one per core [default: 1]
    #[arg(long, value_parser = threads, conflicts_with = "scenes")]
    threads: Option<NonZeroUsize>,
    /// Duration of each measurement, in seconds
    #[arg(long, value_parser = seconds, default_value = "3")]
    seconds: Duration,
    /// Seed of the city
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// For infer: evaluate the scenes in FILE, one JSON object per line as for `logicity infer`, instead of states of
    /// the city; `-` means standard input
    #[arg(long, value_name = "FILE")]
    scenes: Option<PathBuf>,
    /// For tick: also print the share of time spent in each phase
    #[arg(long)]
    breakdown: bool,
    /// Print one JSON object per line
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    limits: LimitOptions,
}

/// The step that `render` measures for each picture.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Done {
    Drawn,
    /// Drawn and encoded as PNG.
    Written,
    /// Decoded from PNG.
    Read,
}

impl Done {
    const fn name(self) -> &'static str {
        match self {
            Done::Drawn => "drawn",
            Done::Written => "written",
            Done::Read => "read",
        }
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    match (0.01..=86_400.0).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err("expected a number from 0.01 to 86400".to_owned()),
    }
}

/// The cost of a repeated piece of work.
#[derive(Clone, Copy, Debug)]
struct Timed {
    /// Number of repetitions.
    times: u64,
    wall: Duration,
    /// CPU time of all threads; `None` if the system does not report it.
    cpu: Option<Duration>,
}

impl Default for Timed {
    fn default() -> Self {
        Timed {
            times: 0,
            wall: Duration::ZERO,
            cpu: Some(Duration::ZERO),
        }
    }
}

impl Timed {
    /// Repeats the work for about this duration. `work` gets the number of repetitions to do.
    fn run(seconds: Duration, mut work: impl FnMut(u64) -> Result<(), Failure>) -> Result<Timed, Failure> {
        // Doubles the repetitions per clock reading until the reading's cost is negligible.
        let mut times = 1;
        let warm_up = Instant::now();
        loop {
            let start = Instant::now();
            work(times)?;
            if start.elapsed() > seconds / 50 || warm_up.elapsed() > seconds / 5 {
                break;
            }
            times *= 2;
        }
        let (start, cpu, mut done) = (Instant::now(), cpu_time(), 0);
        while start.elapsed() < seconds {
            work(times)?;
            done += times;
        }
        let mut timed = Timed::default();
        timed.add(done, start, cpu);
        Ok(timed)
    }

    /// Adds work that began at `start`, when the process had used `cpu` CPU time.
    fn add(&mut self, times: u64, start: Instant, cpu: Option<Duration>) {
        self.times += times;
        self.wall += start.elapsed();
        let spent = cpu_time().zip(cpu).map(|(after, before)| after.saturating_sub(before));
        self.cpu = self.cpu.zip(spent).map(|(sum, spent)| sum + spent);
    }

    #[allow(clippy::cast_precision_loss)]
    fn per_second(&self) -> f64 {
        self.times as f64 / self.wall.as_secs_f64().max(1e-9)
    }

    #[allow(clippy::cast_precision_loss)]
    fn per_cpu_second(&self) -> Option<f64> {
        let cpu = self.cpu?.as_secs_f64();
        (cpu > 0.0).then(|| self.times as f64 / cpu)
    }

    /// Returns the nanoseconds of CPU time, or of wall-clock time where the CPU time is unknown, per piece of `pieces`.
    fn nanoseconds(&self, pieces: usize) -> f64 {
        let per_second = self.per_cpu_second().unwrap_or_else(|| self.per_second());
        #[allow(clippy::cast_precision_loss)]
        let pieces = pieces as f64;
        1e9 / (per_second * pieces).max(1e-9)
    }
}

/// CPU time of the process so far.
#[cfg(unix)]
fn cpu_time() -> Option<Duration> {
    use nix::sys::time::TimeValLike;
    let usage = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF).ok()?;
    let micros = usage.user_time().num_microseconds() + usage.system_time().num_microseconds();
    u64::try_from(micros).ok().map(Duration::from_micros)
}

/// Peak resident memory of the process, in bytes.
#[cfg(unix)]
fn peak_memory() -> Option<u64> {
    let usage = nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_SELF).ok()?;
    let unit = if cfg!(target_vendor = "apple") { 1 } else { 1024 };
    u64::try_from(usage.max_rss()).ok().map(|size| size * unit)
}

#[cfg(not(unix))]
fn cpu_time() -> Option<Duration> {
    None
}

#[cfg(not(unix))]
fn peak_memory() -> Option<u64> {
    None
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let misplaced = |option: &str, of: &str| Err(Failure::Usage(format!("{option} is for `bench {of}` only")));
    if arguments.threads.is_some() && !matches!(arguments.what, Benchmark::Tick | Benchmark::Scale) {
        return misplaced("--threads", "tick|scale");
    }
    if arguments.executor != Executor::Auto && arguments.what == Benchmark::Env {
        return misplaced("--executor", "infer|ground|tick|render|scale");
    }
    if arguments.breakdown && arguments.what != Benchmark::Tick {
        return misplaced("--breakdown", "tick");
    }
    if arguments.scenes.is_some() && arguments.what != Benchmark::Infer {
        return misplaced("--scenes", "infer");
    }
    let city = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?;
    if arguments.what == Benchmark::Scale {
        let most = arguments.agents.unwrap_or(SCALE[SCALE.len() - 1]);
        let sizes = SCALE.into_iter().take_while(|&size| size < most);
        for size in sizes.chain([most]) {
            Bench::new(arguments, city.clone(), Some(size))?.tick(SCALE_TICKS, false)?;
        }
        return Ok(());
    }
    if let Some(scenes) = &arguments.scenes {
        return infer_scenes(arguments, city, scenes, sources);
    }
    let mut bench = Bench::new(arguments, city, arguments.agents)?;
    match arguments.what {
        Benchmark::Infer => bench.infer(),
        Benchmark::Ground => bench.ground(),
        Benchmark::Tick | Benchmark::Scale => bench.tick(bench.world.scenario.ticks, arguments.breakdown),
        Benchmark::Env => bench.env(sources),
        Benchmark::Render => bench.render(),
    }
}

/// A city under measurement.
struct Bench<'a> {
    arguments: &'a Arguments,
    world: Arc<World>,
    simulation: Simulation,
}

impl<'a> Bench<'a> {
    fn new(arguments: &'a Arguments, mut city: LoadedCity, agents: Option<u32>) -> Result<Self, Failure> {
        if let Some(agents) = agents {
            grow(&mut city.scenario, arguments.split, agents);
        }
        let world = Arc::new(city.world()?);
        let simulation = Self::place(arguments, &world, arguments.seed, arguments.executor)?;
        Ok(Bench {
            arguments,
            world,
            simulation,
        })
    }

    fn place(arguments: &Arguments, world: &Arc<World>, seed: u64, executor: Executor) -> Result<Simulation, Failure> {
        let settings = Settings {
            executor,
            count_firings: false,
            threads: arguments.threads.map_or(1, NonZeroUsize::get),
        };
        Ok(Simulation::new(
            Arc::clone(world),
            arguments.split,
            Seed(seed),
            settings,
        )?)
    }

    fn agents(&self) -> usize {
        self.simulation.agents().len()
    }

    /// Measures ticks. Places a new city after `length` ticks, because over time more agents block each other.
    /// Placement is not timed.
    fn tick(&mut self, length: u32, breakdown: bool) -> Result<(), Failure> {
        let mut parts = [Duration::ZERO; Phase::ALL.len()];
        let mut timed = Timed::default();
        let mut seed = self.arguments.seed;
        while timed.wall < self.arguments.seconds {
            if timed.times > 0 {
                seed = seed.wrapping_add(1);
                self.simulation = Self::place(self.arguments, &self.world, seed, self.arguments.executor)?;
            }
            let simulation = &mut self.simulation;
            let (start, cpu, mut done) = (Instant::now(), cpu_time(), 0);
            for tick in 0..length {
                // Reading the clock costs a tenth of a tick of a small city.
                if tick % 16 == 0 && tick >= SCALE_TICKS && timed.wall + start.elapsed() > self.arguments.seconds {
                    break;
                }
                done += 1;
                if breakdown {
                    let mut last = Instant::now();
                    simulation.tick_watched(&[], |phase| {
                        let now = Instant::now();
                        parts[phase as usize] += now - last;
                        last = now;
                    })?;
                } else {
                    simulation.tick(&[])?;
                }
            }
            timed.add(done, start, cpu);
        }
        let mut more = Vec::new();
        if breakdown {
            let sum: Duration = parts.iter().sum();
            for (phase, part) in Phase::ALL.into_iter().zip(parts) {
                let name = match phase {
                    Phase::Decide => "share_decide",
                    Phase::Move => "share_move",
                    Phase::Note => "share_note",
                };
                more.push((name, json!(part.as_secs_f64() / sum.as_secs_f64().max(1e-12))));
            }
        }
        self.print_result("ticks", timed, &more)
    }

    /// Measures consecutive episodes of the task in which a random policy drives the first car.
    fn env(&mut self, sources: &Sources) -> Result<(), Failure> {
        let task = Arc::new(SpfTask::new(Arc::clone(&self.world), sources)?);
        let mut observation = vec![0.0; task.observation_width()];
        let mut env = Env::new(task, self.arguments.split, ControlMode::First)?;
        let mut stream = Seed(self.arguments.seed).stream(Purpose::POLICY, 0, 0);
        let timed = Timed::run(self.arguments.seconds, |times| {
            for _ in 0..times {
                if !env.controlled_cars()[0].is_running() {
                    env.reset(stream.random())?;
                }
                env.observe(0, &mut observation);
                env.step(&[Action::STANDARD[stream.random_range(0..Action::STANDARD.len())]])?;
            }
            Ok(())
        })?;
        self.print_result("steps", timed, &[])
    }

    /// Measures pictures of the first 128 x 128 cells, over states of the city that are [`BETWEEN`] ticks apart.
    fn render(&mut self) -> Result<(), Failure> {
        let names: Vec<String> = (self.simulation.agents().iter())
            .map(|agent| agent.name().to_string())
            .collect();
        let mut states = Vec::with_capacity(STATES);
        for _ in 0..STATES {
            for _ in 0..BETWEEN {
                self.simulation.tick(&[])?;
            }
            states.push(self.simulation.agents().to_vec());
        }
        let wrong = |error: crate::render::ViewportError| Failure::Usage(error.to_string());
        let corner = Cell::new(0, 0);
        let published = Viewport::published(corner).map_err(wrong)?;
        let scale = Scale::pixels(2).expect("within bounds");
        let small = (Viewport::new(corner, 128, 128, scale))
            .and_then(|view| view.with_agents(12, 8))
            .map_err(wrong)?;
        for (view, percent, what) in [
            (published, 0, Done::Drawn),
            (published, 0, Done::Written),
            (published, 0, Done::Read),
            (published, 50, Done::Drawn),
            (published, 50, Done::Written),
            (published, 50, Done::Read),
            (small, 0, Done::Drawn),
        ] {
            self.pictures(&states, &names, view, percent, what)?;
        }
        Ok(())
    }

    /// Measures pictures of `view` over the states, at a difficulty in percent.
    fn pictures(
        &self,
        states: &[Vec<Agent>],
        names: &[String],
        view: Viewport,
        percent: u8,
        what: Done,
    ) -> Result<(), Failure> {
        let difficulty = Difficulty::percent(percent).expect("a percentage");
        let icons = Arc::new(Icons::new(Seed(0), difficulty));
        let renderer = Renderer::new(self.world.map(), icons, view);
        let (mut picture, mut next) = (Picture::default(), 0);
        let (mut written, mut pictures) = (0, 0);
        let mut files = vec![Vec::new(); states.len()];
        let draw = |state: usize, picture: &mut Picture| {
            let agents = states[state].iter().zip(names);
            let sprites: Vec<_> = agents.map(|(agent, name)| Sprite::of(agent, name, None)).collect();
            renderer.draw_into(&sprites, picture);
        };
        let write = |picture: &Picture, file: &mut Vec<u8>| {
            file.clear();
            write_png(picture, file).expect("writing to a vector cannot fail");
        };
        // Icons are drawn on first use; this loop keeps that out of the measurement.
        for (state, file) in files.iter_mut().enumerate() {
            draw(state, &mut picture);
            if what == Done::Read {
                write(&picture, file);
            }
        }
        let timed = Timed::run(self.arguments.seconds, |times| {
            for _ in 0..times {
                if what == Done::Read {
                    picture = read_png(&files[next]).expect("it was written");
                } else {
                    draw(next, &mut picture);
                }
                if what == Done::Written {
                    write(&picture, &mut files[next]);
                }
                black_box((&picture, &files[next]));
                written += files[next].len();
                (next, pictures) = ((next + 1) % states.len(), pictures + 1);
            }
            Ok(())
        })?;
        let result = json!({
            "what": self.arguments.what.name(),
            "config": self.world.scenario.name,
            "map": self.world.map().name,
            "agents": self.agents(),
            "pixels": view.size().0,
            "difficulty": percent,
            "done": what.name(),
            "seconds": timed.wall.as_secs_f64(),
            "pictures": timed.times,
            "pictures_per_s": timed.per_second(),
            "pictures_per_cpu_s": timed.per_cpu_second(),
            "bytes_per_picture": if what == Done::Drawn { picture.pixels().len() } else { written / pictures.max(1) },
        });
        print(result, self.arguments)
    }

    fn infer(&mut self) -> Result<(), Failure> {
        if self.simulation.hands_over() {
            // Facts in memory are those of one executor.
            let seed = self.arguments.seed;
            self.simulation = Self::place(self.arguments, &self.world, seed, Executor::Relational)?;
        }
        if self.simulation.executor() == Executor::Relational {
            return self.infer_relational();
        }
        let many = self.agents();
        let width = Width::of(many).ok_or_else(|| {
            Failure::Usage(format!(
                "the dense executor holds facts of at most {WINDOW_MAX} agents, not {many}; choose fewer with --agents"
            ))
        })?;
        in_words!(width, W => self.infer_dense::<W>())
    }

    fn infer_dense<const W: usize>(&mut self) -> Result<(), Failure> {
        let (world, count) = (Arc::clone(&self.world), self.agents());
        let rules = world.compile(TrackFirings::Off)?;
        let agents = self.simulation.agents().iter();
        let names: Vec<String> = agents.map(|agent| agent.name().to_string()).collect();
        let dense = &rules.dense;
        let sets = dense.inputs().len() + dense.lists().len() * 64 * W;
        let states: Vec<BitFacts<W>> = self.states(BETWEEN, |facts| {
            (
                rules.bits(&facts, &world.vocabulary, count, names.iter()),
                sets * size_of::<[u64; W]>(),
            )
        })?;
        let timed = evaluate(self.arguments.seconds, dense, &states, count)?;
        self.print_result("evaluations", timed, &[("states", json!(states.len()))])
    }

    /// Returns facts about states of the city that are `between` ticks apart. `make` converts them and returns their
    /// size in bytes.
    fn states<T>(&mut self, between: usize, make: impl Fn(Facts) -> (T, usize)) -> Result<Vec<T>, Failure> {
        let (mut states, mut bytes) = (Vec::new(), 0);
        while states.len() < STATES {
            for _ in 0..between {
                self.simulation.tick(&[])?;
            }
            let vocabulary = &self.world.vocabulary;
            let (state, size) = make(self.simulation.facts(|predicate| vocabulary.is_read(predicate))?);
            bytes += size;
            // A single state would make every evaluation repeat the one before.
            if bytes > STATES_BYTES && states.len() >= 2 {
                break;
            }
            states.push(state);
        }
        Ok(states)
    }

    /// Measures incremental evaluation: the differences from each state to the next, and from the last to the first.
    fn infer_relational(&mut self) -> Result<(), Failure> {
        let states = self.states(1, |facts| {
            let rows: usize = facts.rows.iter().map(Vec::len).sum();
            (facts, rows * size_of::<[u32; 2]>())
        })?;
        let simulation = &mut self.simulation;
        let mut next = 0;
        let timed = Timed::run(self.arguments.seconds, |times| {
            for _ in 0..times {
                simulation.evaluate(&states[next])?;
                next = (next + 1) % states.len();
            }
            Ok(())
        })?;
        self.print_result("evaluations", timed, &[("states", json!(states.len()))])
    }

    fn ground(&mut self) -> Result<(), Failure> {
        let simulation = &mut self.simulation;
        let Some(facts) = simulation.count_facts() else {
            let what = "ground measures facts that the dense executor computes for the whole city at once";
            let agents = simulation.agents().len();
            return Err(Failure::Usage(match (simulation.executor(), simulation.fallback()) {
                (Executor::Dense, _) => {
                    format!("{what}: this works for up to {WHOLE_MAX} agents, not {agents}; choose fewer with --agents")
                }
                (_, Some(reason)) => format!("{what}, but {}", reason.message),
                (_, None) => format!("{what}; omit --executor relational"),
            }));
        };
        let timed = Timed::run(self.arguments.seconds, |times| {
            (0..times).for_each(|_| {
                black_box(simulation.count_facts());
            });
            Ok(())
        })?;
        self.print_result("groundings", timed, &[("facts", json!(facts))])
    }

    /// Prints a result. `unit` names the repeated work.
    #[allow(clippy::cast_precision_loss)]
    fn print_result(&self, unit: &str, timed: Timed, more: &[(&str, Value)]) -> Result<(), Failure> {
        let agents = self.agents();
        let mut result = json!({
            "what": self.arguments.what.name(),
            "config": self.world.scenario.name,
            "map": self.world.map().name,
            "agents": agents,
            "threads": self.simulation.threads(),
            "executor": self.simulation.executor().name(),
            "seconds": timed.wall.as_secs_f64(),
        });
        let mut set = |key: String, value: Value| {
            result[key] = value;
        };
        set(unit.to_owned(), json!(timed.times));
        set(format!("{unit}_per_s"), json!(timed.per_second()));
        set("decisions_per_s".to_owned(), json!(timed.per_second() * agents as f64));
        set(format!("{unit}_per_cpu_s"), json!(timed.per_cpu_second()));
        set("ns_per_decision".to_owned(), json!(timed.nanoseconds(agents)));
        let peak = peak_memory().map(|bytes| bytes as f64 / f64::from(1 << 20));
        set("peak_rss_mb".to_owned(), json!(peak));
        if self.arguments.what == Benchmark::Scale {
            let per_agent = peak_memory().map(|bytes| bytes as f64 / agents as f64);
            set("peak_bytes_per_agent".to_owned(), json!(per_agent));
        }
        for (key, value) in more {
            set((*key).to_owned(), value.clone());
        }
        print(result, self.arguments)
    }
}

/// Measures the evaluation of the rules on each of the states in turn.
fn evaluate<const W: usize>(
    seconds: Duration,
    dense: &Dense,
    states: &[BitFacts<W>],
    count: usize,
) -> Result<Timed, Failure> {
    let mut bit_state = BitState::new(dense, count);
    let mut next = 0;
    Timed::run(seconds, |times| {
        for _ in 0..times {
            states[next].load(dense, &mut bit_state);
            let run = bit_state.run(dense, &states[next]);
            run.map_err(|error| Failure::Usage(format!("{error}; choose --executor relational")))?;
            black_box(&bit_state);
            next += 1;
            if next == states.len() {
                next = 0;
            }
        }
        Ok(())
    })
}

/// Measures the rules alone on the scenes of a file.
fn infer_scenes(arguments: &Arguments, city: LoadedCity, path: &Path, sources: &Sources) -> Result<(), Failure> {
    let name = city.scenario.name.clone();
    let mut inference = inference_of(city, arguments.seed, arguments.executor, sources)?;
    let rules = match arguments.executor {
        Executor::Relational => None,
        Executor::Dense => Some(inference.compile()?),
        Executor::Auto => inference.compile().ok(),
    };
    let scenes = read_scenes(
        &mut inference,
        path,
        if rules.is_some() { SCENE_MAX } else { MAX_ENTITIES },
    )?;
    let most = scenes.iter().map(|scene| scene.names.len()).max().unwrap_or(0);
    let (executor, timed) = match rules {
        Some(rules) => {
            let states: Vec<BitFacts<1>> = (scenes.iter())
                .map(|scene| rules.bits(&scene.facts, inference.vocabulary(), most, scene.names.iter()))
                .collect();
            (
                Executor::Dense,
                evaluate(arguments.seconds, &rules.dense, &states, most)?,
            )
        }
        None => (
            Executor::Relational,
            evaluate_changes(arguments.seconds, &inference, &scenes)?,
        ),
    };
    let result = json!({
        "what": "infer",
        "config": name,
        "scenes": scenes.len(),
        "entities": most,
        "executor": executor.name(),
        "seconds": timed.wall.as_secs_f64(),
        "evaluations": timed.times,
        "evaluations_per_s": timed.per_second(),
        "evaluations_per_cpu_s": timed.per_cpu_second(),
        "ns_per_evaluation": timed.nanoseconds(1),
    });
    print(result, arguments)
}

/// Reads the scenes of a file, of at most `most` entities each, and computes their facts.
fn read_scenes(inference: &mut Inference, path: &Path, most: usize) -> Result<Vec<SceneFacts>, Failure> {
    let mut lines = SceneLines::open(path)?;
    let mut scenes = Vec::new();
    while let Some(SceneLine { number, sources, scene }) = lines.next()? {
        let scene = scene.map_err(|fault| vec![fault]);
        let scene = scene
            .and_then(|source| inference.ground(&sources, source))
            .and_then(|scene| {
                let count = scene.names.len();
                if count <= most {
                    return Ok(scene);
                }
                let message = format!(
                    "line {number} of `{}` has {count} entities; the limit is {most}",
                    lines.name
                );
                Err(vec![Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message)])
            });
        scenes.push(scene.map_err(|faults| {
            report(&faults, &sources);
            Failure::Reported
        })?);
    }
    let from = lines.name;
    match scenes.is_empty() {
        true => Err(Diagnostic::new(codes::INVALID_SCENE, format!("`{from}` contains no scene")).into()),
        false => Ok(scenes),
    }
}

/// Measures the incremental evaluation of the rules by the relational executor: the differences from each scene to the
/// next, and from the last to the first.
fn evaluate_changes(seconds: Duration, inference: &Inference, scenes: &[SceneFacts]) -> Result<Timed, Failure> {
    // One session for the entities of all scenes: equal names are one entity.
    let mut entities: BTreeMap<&str, u32> = BTreeMap::new();
    let mut names: Vec<&str> = Vec::new();
    let mut states = Vec::new();
    for scene in scenes {
        let places: Vec<u32> = (scene.names.iter())
            .map(|name| {
                *entities.entry(name).or_insert_with(|| {
                    names.push(name);
                    u32::try_from(names.len() - 1).expect("fewer than 2^32 entities")
                })
            })
            .collect();
        let mut facts = scene.facts.clone();
        for (rows, predicate) in facts.rows.iter_mut().zip(&inference.vocabulary().predicates) {
            for place in rows.iter_mut().flat_map(|row| &mut row[..predicate.arity]) {
                *place = places[*place as usize];
            }
            rows.sort_unstable();
        }
        states.push(facts);
    }
    let mut state = inference.ground_state(names.into_iter());
    let mut next = 0;
    Timed::run(seconds, |times| {
        for _ in 0..times {
            inference.evaluate(&mut state, &states[next], &Cancel::never())?;
            next = (next + 1) % states.len();
        }
        Ok(())
    })
}

/// Prints an object, with the rule file that replaces the configuration's, as one line of JSON or as one line per key.
fn print(mut result: Value, arguments: &Arguments) -> Result<(), Failure> {
    let mut out = terminal::results(arguments.json);
    if let Some(rules) = &arguments.rules {
        result["rules"] = rules.display().to_string().into();
    }
    if arguments.json {
        writeln!(out, "{result}")?;
        return Ok(());
    }
    let object = result.as_object().expect("a result is an object");
    let width = object.keys().map(String::len).max().unwrap_or(0);
    for (key, value) in object {
        let value = match value {
            Value::String(text) => text.clone(),
            Value::Number(number) => match number.as_f64() {
                Some(value) if number.is_f64() && value < 100.0 => format!("{value:.2}"),
                Some(value) if number.is_f64() => format!("{value:.0}"),
                _ => number.to_string(),
            },
            Value::Null => "unknown on this system".to_owned(),
            other => other.to_string(),
        };
        writeln!(out, "{key:<width$}  {value}")?;
    }
    writeln!(out)?;
    Ok(())
}

/// Repeats the agent list of a split until it has `agents` agents. Resizes a map of blocks so that the density stays the
/// same: in the region of starts and goals if the split has one, else on the whole map.
fn grow(scenario: &mut Scenario, split: Split, agents: u32) {
    let Some((_, set)) = scenario.splits.iter_mut().find(|(known, _)| *known == split) else {
        // Placing the agents reports the error.
        return;
    };
    let before = set.repeat.max(1);
    let once = (set.len() / before as usize).max(1);
    set.repeat = u32::try_from((agents as usize).div_ceil(once)).expect("at most a million agents");
    let Terrain::Blocks(Blocks {
        blocks: size,
        widths,
        buildings,
    }) = &mut scenario.map.terrain
    else {
        return;
    };
    let widths = widths.value;
    let period = widths.street + 2 * widths.sidewalk + 2 * widths.building + widths.inner_sidewalk;
    let side = set.region.as_ref().map_or_else(
        || f64::from(size.value[0].min(size.value[1]) * period),
        |region| match region.value {
            Region::Side(side) => f64::from(side),
            // The new map has no zones.
            Region::Zone(_) => f64::from(size.value[0].min(size.value[1]) * period),
        },
    );
    let blocks = side * (f64::from(set.repeat) / f64::from(before)).sqrt() / f64::from(period);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most a million agents
    let blocks = (blocks.ceil() as u32).clamp(2, 1000);
    if let (None, Some(region)) = (set.trip, &set.region)
        && let Region::Side(value) = region.value
    {
        set.trip = Some(Located {
            value,
            span: region.span,
        });
    }
    set.region = None;
    let weights = [
        (Building::House, 0.2),
        (Building::Office, 0.2),
        (Building::GasStation, 0.05),
        (Building::Garage, 0.15),
        (Building::Store, 0.4),
    ];
    scenario.map.name = format!("{blocks}x{blocks}");
    size.value = [blocks; 2];
    buildings.value = Buildings::Random {
        seed: 1,
        weights: weights.to_vec(),
    };
}
