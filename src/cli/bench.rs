//! `logicity bench`: how fast rules are evaluated and cities go, on this machine.

use crate::builtin::BuiltinFiles;
use crate::city::{Action, AgentSet, Building, Buildings, MapConfig, Split};
use crate::city::{Agent, Cell};
use crate::cli::{Failure, load_city, one_of, threads};
use crate::config::Scenario;
use crate::datalog::Program;
use crate::datalog::dense::{BitFacts, BitState, Dense, TrackFirings};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files;
use crate::render::{Difficulty, Icons, Picture, Renderer, Scale, Sprite, Viewport, read_png, write_png};
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::{
    Executor, Facts, Inference, Phase, Settings, Simulation, WHOLE_MAX, WINDOW_MAX, Width, World, in_words,
};
use crate::task::spf::{ControlMode, Env, SpfTask};
use serde_json::{Value, json};
use std::hint::black_box;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// States on which the rules alone are timed, if they do not take more memory together than that: 256 MiB.
const STATES: usize = 64;
const STATES_BYTES: usize = 1 << 28;
/// Ticks from one of them to the next.
const BETWEEN: usize = 7;
/// The most entities in a scene: as many as one word has bits.
const SCENE_MAX: usize = Width::One.entities();
/// So many ticks of a city of `scale` are timed before it is placed afresh.
const SCALE_TICKS: u32 = 50;
/// The sizes of cities that `scale` goes through.
const SCALE: [u32; 4] = [1_000, 10_000, 100_000, 1_000_000];

/// What is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Infer,
    Ground,
    Tick,
    Env,
    Render,
    Scale,
}

impl What {
    const ALL: [What; 6] = [
        What::Infer,
        What::Ground,
        What::Tick,
        What::Env,
        What::Render,
        What::Scale,
    ];

    const fn name(self) -> &'static str {
        match self {
            What::Infer => "infer",
            What::Ground => "ground",
            What::Tick => "tick",
            What::Env => "env",
            What::Render => "render",
            What::Scale => "scale",
        }
    }
}

#[derive(clap::Args)]
pub struct Arguments {
    /// infer: the rules alone, facts ready as bits (dense) or as rows that change (relational). ground: all facts that the rules can
    /// ask for. tick: a city, placed afresh after the ticks of the configuration. env: episodes of the configuration's task
    /// under a random policy, observations written. render: pictures as those of the visual data set, drawn, written as PNG and read, clean
    /// and at difficulty 50, and small ones. scale: cities of 1000 agents up to --agents
    #[arg(value_parser = one_of(&What::ALL, What::name))]
    what: What,
    /// Configuration of the city
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Which agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test", conflicts_with = "scenes")]
    split: Split,
    /// So many agents, rounded up to whole copies of the configuration's list of agents (its `repeat` is left aside), on a map of a
    /// size that leaves them as dense; goals lie as far away as the region of the configuration is wide. For scale the largest city,
    /// 1000000 unless given
    #[arg(
        long,
        value_parser = clap::value_parser!(u32).range(1..=1_000_000),
        allow_negative_numbers = true,
        conflicts_with = "scenes"
    )]
    agents: Option<u32>,
    /// What evaluates the rules
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// For tick and scale: threads for a city of many agents, 1 unless given; 0 is one for each core
    #[arg(long, value_parser = threads, allow_negative_numbers = true, conflicts_with = "scenes")]
    threads: Option<NonZeroUsize>,
    /// How long each measurement takes, in seconds
    #[arg(long, value_parser = seconds, default_value = "3", allow_negative_numbers = true)]
    seconds: Duration,
    /// Seed of the city
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// For infer: evaluate these scenes, one JSON object a line as `logicity infer` takes them, instead of states of the city; `-` is
    /// standard input. Always by the dense executor
    #[arg(long, value_name = "FILE")]
    scenes: Option<PathBuf>,
    /// For tick: also tell where the time goes
    #[arg(long)]
    breakdown: bool,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
}

/// What is done with a picture.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Done {
    Drawn,
    /// Drawn and written as PNG.
    Written,
    /// Read of a PNG.
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
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    match (0.01..=86_400.0).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err("not from 0.01 to 86400".to_owned()),
    }
}

/// What a measurement took.
#[derive(Clone, Copy, Debug)]
struct Timed {
    /// How often the work was done.
    times: u64,
    wall: Duration,
    /// Of all threads; `None` where the system does not tell.
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
    /// Does the work again and again for about so long. It is told how often to do it.
    fn run(seconds: Duration, mut work: impl FnMut(u64) -> Result<(), Failure>) -> Result<Timed, Failure> {
        // A look at the clock costs as much as a small piece of work.
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

    /// Adds work that began then, with so much CPU time used.
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

    /// Nanoseconds of CPU time, or of time where that is not known, for each of so many pieces of a piece of work.
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

/// The most memory the process has held, in bytes.
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
    if arguments.threads.is_some() && !matches!(arguments.what, What::Tick | What::Scale) {
        return misplaced("--threads", "tick|scale");
    }
    if arguments.executor != Executor::Auto && arguments.what == What::Env {
        return misplaced("--executor", "infer|ground|tick|render|scale");
    }
    if arguments.breakdown && arguments.what != What::Tick {
        return misplaced("--breakdown", "tick");
    }
    if arguments.scenes.is_some() && arguments.what != What::Infer {
        return misplaced("--scenes", "infer");
    }
    if arguments.scenes.is_some() && arguments.executor == Executor::Relational {
        return Err(Failure::Usage(
            "--scenes times the dense executor only; leave out --executor relational".to_owned(),
        ));
    }
    let (scenario, program, _) = load_city(sources, &arguments.config, None)?;
    if arguments.what == What::Scale {
        let most = arguments.agents.unwrap_or(SCALE[SCALE.len() - 1]);
        let sizes = SCALE.into_iter().take_while(|&size| size < most);
        for size in sizes.chain([most]) {
            Bench::new(arguments, &scenario, &program, Some(size))?.tick(SCALE_TICKS, false)?;
        }
        return Ok(());
    }
    if let Some(scenes) = &arguments.scenes {
        return infer_scenes(arguments, scenario, program, scenes);
    }
    let mut bench = Bench::new(arguments, &scenario, &program, arguments.agents)?;
    match arguments.what {
        What::Infer => bench.infer(),
        What::Ground => bench.ground(),
        What::Tick | What::Scale => bench.tick(bench.world.scenario.ticks, arguments.breakdown),
        What::Env => bench.env(sources),
        What::Render => bench.render(),
    }
}

/// A city to be timed.
struct Bench<'a> {
    arguments: &'a Arguments,
    world: Arc<World>,
    simulation: Simulation,
}

impl<'a> Bench<'a> {
    fn new(
        arguments: &'a Arguments,
        scenario: &Scenario,
        program: &Program,
        agents: Option<u32>,
    ) -> Result<Self, Failure> {
        let mut scenario = scenario.clone();
        if let Some(agents) = agents {
            grow(&mut scenario, arguments.split, agents);
        }
        let world = Arc::new(World::new(scenario, program.clone())?);
        let simulation = Self::place(arguments, &world, arguments.seed)?;
        Ok(Bench {
            arguments,
            world,
            simulation,
        })
    }

    fn place(arguments: &Arguments, world: &Arc<World>, seed: u64) -> Result<Simulation, Failure> {
        let settings = Settings {
            executor: arguments.executor,
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

    /// Ticks of cities that are placed afresh after `length` ticks, since in time many of its agents wait for each other. Placing is not
    /// timed.
    fn tick(&mut self, length: u32, breakdown: bool) -> Result<(), Failure> {
        let mut parts = [Duration::ZERO; Phase::ALL.len()];
        let mut timed = Timed::default();
        let mut seed = self.arguments.seed;
        while timed.wall < self.arguments.seconds {
            if timed.times > 0 {
                seed = seed.wrapping_add(1);
                self.simulation = Self::place(self.arguments, &self.world, seed)?;
            }
            let simulation = &mut self.simulation;
            let (start, cpu, mut done) = (Instant::now(), cpu_time(), 0);
            for tick in 0..length {
                // To look at the clock takes a tenth of a tick of a small city.
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
        self.print("ticks", timed, &more)
    }

    /// Episodes of the task, one after another, the first car driven at random.
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
                env.step(&[Action::ALL[stream.random_range(0..Action::ALL.len())]])?;
            }
            Ok(())
        })?;
        self.print("steps", timed, &[])
    }

    /// Pictures of the first 128 x 128 cells in states of the city that are some ticks apart.
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

    /// Pictures of such a view of states of the city, at a difficulty in percent.
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
            write_png(picture, file).expect("a vector takes all that is written");
        };
        // Each icon is drawn when it is first shown, which is not measured.
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
        print(&result, self.arguments.json)
    }

    fn infer(&mut self) -> Result<(), Failure> {
        if self.simulation.executor() == Executor::Relational {
            return self.infer_relational();
        }
        let many = self.agents();
        let width = Width::of(many).ok_or_else(|| {
            Failure::Usage(format!(
                "the facts about {many} agents are not kept as bits all at once: the limit is {WINDOW_MAX}; take fewer by --agents"
            ))
        })?;
        in_words!(width, W => self.infer_dense::<W>())
    }

    fn infer_dense<const W: usize>(&mut self) -> Result<(), Failure> {
        let (world, count) = (Arc::clone(&self.world), self.agents());
        let dense = world.compile(TrackFirings::Off)?;
        let sets = dense.inputs().len() + dense.lists().len() * 64 * W;
        let states: Vec<BitFacts<W>> = self.states(BETWEEN, |facts| {
            (
                facts.to_bits(&world.vocabulary, &dense, count),
                sets * size_of::<[u64; W]>(),
            )
        })?;
        let timed = evaluate(self.arguments.seconds, &dense, &states, count)?;
        self.print("evaluations", timed, &[("states", json!(states.len()))])
    }

    /// Facts about states of the city that are so many ticks apart, as `make` has them. It tells how many bytes they take.
    fn states<T>(&mut self, between: usize, make: impl Fn(Facts) -> (T, usize)) -> Result<Vec<T>, Failure> {
        let (mut states, mut bytes) = (Vec::new(), 0);
        while states.len() < STATES {
            for _ in 0..between {
                self.simulation.tick(&[])?;
            }
            let vocabulary = &self.world.vocabulary;
            let (state, size) = make(self.simulation.facts(|predicate| vocabulary.is_read(predicate)));
            bytes += size;
            // Of one state alone no evaluation would be another than the one before.
            if bytes > STATES_BYTES && states.len() >= 2 {
                break;
            }
            states.push(state);
        }
        Ok(states)
    }

    /// From one state to the next by differences, and to the first from the last.
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
        self.print("evaluations", timed, &[("states", json!(states.len()))])
    }

    fn ground(&mut self) -> Result<(), Failure> {
        let simulation = &mut self.simulation;
        let Some(facts) = simulation.count_facts() else {
            let what = "facts are computed as bits where the dense executor looks at a whole city at once";
            let agents = simulation.agents().len();
            return Err(Failure::Usage(match (simulation.executor(), simulation.fallback()) {
                (Executor::Dense, _) => {
                    format!("{what}: up to {WHOLE_MAX} agents, and here are {agents}; take fewer by --agents")
                }
                (_, Some(reason)) => format!("{what}, but {reason}"),
                (_, None) => format!("{what}; leave out --executor relational"),
            }));
        };
        let timed = Timed::run(self.arguments.seconds, |times| {
            (0..times).for_each(|_| {
                black_box(simulation.count_facts());
            });
            Ok(())
        })?;
        self.print("groundings", timed, &[("facts", json!(facts))])
    }

    /// Prints a result. `unit` is what was done again and again.
    #[allow(clippy::cast_precision_loss)]
    fn print(&self, unit: &str, timed: Timed, more: &[(&str, Value)]) -> Result<(), Failure> {
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
        if self.arguments.what == What::Scale {
            let per_agent = peak_memory().map(|bytes| bytes as f64 / agents as f64);
            set("peak_bytes_per_agent".to_owned(), json!(per_agent));
        }
        for (key, value) in more {
            set((*key).to_owned(), value.clone());
        }
        print(&result, self.arguments.json)
    }
}

/// Evaluates the rules on facts that are ready, one state after the other.
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
            bit_state.run(dense, &states[next]);
            black_box(&bit_state);
            next += 1;
            if next == states.len() {
                next = 0;
            }
        }
        Ok(())
    })
}

/// The rules alone on the scenes of a file.
fn infer_scenes(arguments: &Arguments, scenario: Scenario, program: Program, path: &Path) -> Result<(), Failure> {
    let name = scenario.name.clone();
    let mut inference = Inference::new(scenario, program, Seed(arguments.seed), Executor::Auto, BuiltinFiles)?;
    let dense = inference.compile().map_err(|fault| {
        fault.help("--scenes times the dense executor only; `logicity infer` decides scenes by either")
    })?;
    let from = if path == Path::new("-") {
        "<stdin>".to_owned()
    } else {
        path.display().to_string()
    };
    let text = match path == Path::new("-") {
        true => files::read_from(io::stdin().lock()),
        false => files::read_text(path),
    };
    let text = text.map_err(|error| Failure::file("read", path, error))?;
    let mut scenes = Vec::new();
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
        let mut sources = Sources::new();
        let source = sources.add_from(from.as_str(), line, number);
        let scene = inference.ground(&sources, source).and_then(|scene| {
            let count = scene.names.len();
            if count <= SCENE_MAX {
                return Ok(scene);
            }
            let message = format!("line {number} of `{from}` has {count} entities, the limit is {SCENE_MAX}");
            Err(vec![Diagnostic::new(Code::LIMIT_EXCEEDED, message)])
        });
        scenes.push(scene.map_err(|faults| {
            super::report(&faults, &sources);
            Failure::Reported
        })?);
    }
    let Some(most) = scenes.iter().map(|scene| scene.names.len()).max() else {
        return Err(Diagnostic::new(Code::INVALID_SCENE, format!("there is no scene in `{from}`")).into());
    };
    let states: Vec<BitFacts<1>> = (scenes.iter())
        .map(|scene| scene.facts.to_bits(inference.vocabulary(), &dense, most))
        .collect();
    let timed = evaluate(arguments.seconds, &dense, &states, most)?;
    let result = json!({
        "what": "infer",
        "config": name,
        "scenes": states.len(),
        "entities": most,
        "seconds": timed.wall.as_secs_f64(),
        "evaluations": timed.times,
        "evaluations_per_s": timed.per_second(),
        "evaluations_per_cpu_s": timed.per_cpu_second(),
        "ns_per_evaluation": timed.nanoseconds(1),
    });
    print(&result, arguments.json)
}

/// Prints an object: in one line, or a line for each key.
fn print(result: &Value, as_json: bool) -> Result<(), Failure> {
    let mut out = anstream::stdout();
    if as_json {
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
            Value::Null => "not known on this system".to_owned(),
            other => other.to_string(),
        };
        writeln!(out, "{key:<width$}  {value}")?;
    }
    writeln!(out)?;
    Ok(())
}

/// Repeats the list of agents of a split so often that there are that many agents, and makes the map so large that they are as dense
/// as before: in the region where they start and have their goals, if there is one, else on the whole map.
fn grow(scenario: &mut Scenario, split: Split, agents: u32) {
    let period = {
        let widths = scenario.map.widths.value;
        widths.street + 2 * widths.sidewalk + 2 * widths.building + widths.inner_sidewalk
    };
    let Some((_, set)) = scenario.splits.iter_mut().find(|(known, _)| *known == split) else {
        // Placing the agents tells what is wrong.
        return;
    };
    let side = set.region.map_or_else(
        || f64::from(scenario.map.blocks.value[0].min(scenario.map.blocks.value[1]) * period),
        |region| f64::from(region.value),
    );
    let once = (set.len() / set.repeat.max(1) as usize).max(1);
    let repeat = u32::try_from((agents as usize).div_ceil(once)).expect("at most a million agents");
    let blocks = side * (f64::from(repeat) / f64::from(set.repeat.max(1))).sqrt() / f64::from(period);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most a million agents
    let blocks = (blocks.ceil() as u32).clamp(2, 1000);
    let AgentSet {
        repeat: times,
        region,
        trip,
        ..
    } = set;
    *times = repeat;
    if trip.is_none() {
        *trip = *region;
    }
    *region = None;
    let weights = [
        (Building::House, 0.2),
        (Building::Office, 0.2),
        (Building::GasStation, 0.05),
        (Building::Garage, 0.15),
        (Building::Store, 0.4),
    ];
    let MapConfig {
        name,
        blocks: size,
        buildings,
        ..
    } = &mut scenario.map;
    *name = format!("{blocks}x{blocks}");
    size.value = [blocks; 2];
    buildings.value = Buildings::Random {
        seed: 1,
        weights: weights.to_vec(),
    };
}
