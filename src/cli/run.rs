//! `logicity run`: runs a city.

use crate::cancel::Cancel;
use crate::city::codes;
use crate::city::{Action, KindId, Split};
use crate::cli::failure::Failure;
use crate::cli::frames::{Drawn, Frame};
use crate::cli::icons::IconOptions;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, finish, is_stdout, refuse_stdout_as_folder, unremovable, unwritable};
use crate::cli::report::{agents_in_words, report};
use crate::cli::values::{integer, one_of, scale, threads};
use crate::cli::video::{CROP_MARGIN, Part, Traces, VideoOptions};
use crate::cli::{signals, terminal, video};
use crate::datalog::constraints;
use crate::datalog::explain::ExplanationPrinter;
use crate::datalog::{Clause, ClauseId};
use crate::diag::{self, Diagnostic, SourceId, Sources, counted};
use crate::files::{Output, make_folder, remove_own};
use crate::page::DECISIONS_MAX;
use crate::render::{Animation, Extent, Icons, Overview, Scale, write_png};
use crate::rng::Seed;
use crate::sim::{
    DeadlockReport, Executor, LOOK_TICKS, MAX_ENTITIES, STUCK_TICKS, Settings, Simulation, TraceWriter, WaitsFor,
    agent_lints, find_deadlocks, no_decision, unread_predicates, waits,
};
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::mem;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The maximum number of ticks in the animation, which keeps it small enough for viewers.
const MAX_FRAMES: u64 = 1000;
/// The time for which the animation shows a tick.
const FRAME_DELAY: Duration = Duration::from_millis(100);

#[derive(clap::Args)]
pub struct Arguments {
    /// Run configuration
    config: PathBuf,
    /// Number of ticks, 1 to 1000000000 [default: `ticks` of the configuration]
    #[arg(long, value_parser = integer(1..=1_000_000_000_u64))]
    ticks: Option<u64>,
    /// Seed of the run
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// Folder for trace.jsonl, city.gif and last.png; created if missing
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Check on every tick that the facts satisfy the constraints of the rules (`.disjoint`, `.implies`, ...), and exit
    /// with code 1 otherwise. Slows the run to the speed of the relational executor
    #[arg(long)]
    check_constraints: bool,
    /// Executor that evaluates the rules; results do not depend on it
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// Number of threads, used for cities of many agents; 0 means one per core. Results do not depend on it
    #[arg(long, value_parser = threads, default_value = "1")]
    threads: NonZeroUsize,
    /// Also write an interactive HTML page of the run to FILE
    #[arg(long, value_name = "FILE", conflicts_with = "no_trace")]
    html: Option<PathBuf>,
    /// Write the trace but no pictures; removes the pictures of an earlier run in the folder, which would not fit it
    #[arg(long, conflicts_with_all = ["pack", "difficulty", "drawing_version"])]
    no_pictures: bool,
    /// Show only the part of the map that agents visit in this run. Pictures are drawn when the run has ended
    #[arg(long)]
    crop: bool,
    /// Side of a cell in pictures, in pixels, 1 to 64 [default: at most 12, so that the longer side of the map has at
    /// most 1000]
    #[arg(long, value_name = "PIXELS", value_parser = scale)]
    scale: Option<Scale>,
    #[command(flatten)]
    icons: IconOptions,
    #[command(flatten)]
    video: VideoOptions,
    /// Print the summary but write no files
    #[arg(long, conflicts_with = "video")]
    no_trace: bool,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

/// The counts of the summary.
#[derive(Default)]
struct Tally {
    ticks: u64,
    deciding: Duration,
    actions: BTreeMap<KindId, Vec<u64>>,
    /// The decisions with several derived actions: these actions, the chosen one, and the number of decisions.
    overlaps: BTreeMap<(Vec<Action>, Action), u64>,
    firings: Vec<u64>,
    goals: u64,
    last_move: Vec<u64>,
    /// For each agent that stands still: the agents it waited for at each check, and the clauses.
    waited: Vec<BTreeSet<(usize, ClauseId)>>,
    /// For each violated constraint, if `run` checks them: the first message, its tick, and the number of ticks.
    broken: Vec<(Diagnostic, u64, u64)>,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    refuse_stdout_as_folder(&arguments.out)?;
    if arguments.html.as_deref().is_some_and(is_stdout) {
        let message = "the summary goes to standard output, so the page of `--html` cannot";
        return Err(Failure::Usage(format!("{message}\nhelp: name a file")));
    }
    if arguments.no_pictures && arguments.video.video.is_none() && (arguments.crop || arguments.scale.is_some()) {
        let message = "`--crop` and `--scale` have no effect with `--no-pictures`";
        return Err(Failure::Usage(format!(
            "{message}\nhelp: omit them, or write a video: `--video city.mp4`"
        )));
    }
    let city = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?;
    let rule_files = city.rule_files.clone();
    let ticks = arguments.ticks.unwrap_or(u64::from(city.scenario.ticks));
    let mut simulation = Simulation::new(
        Arc::new(city.world()?),
        arguments.split,
        Seed(arguments.seed),
        Settings {
            executor: arguments.executor,
            count_firings: true,
            threads: arguments.threads.get(),
        },
    )?;

    let world = simulation.world();
    let agents = world.scenario.agent_set(arguments.split);
    let rules = world.program.rules();
    let mut warnings = agent_lints(rules, agents.into_iter());
    warnings.extend(unread_predicates(rules, &world.scenario.actions.table));
    warnings.extend(no_decision(rules, &world.scenario));
    report(&warnings, sources);

    let cancel = signals::cancel();
    refuse_large_outputs(arguments, ticks, simulation.agents().len())?;
    let inputs = Inputs::of(sources).with(arguments.icons.files());
    let mut record = match arguments.no_trace {
        true => None,
        false => Some(Record::new(arguments, &inputs, &simulation, sources, &rule_files)?),
    };

    let page = arguments
        .html
        .as_deref()
        .map(|page| arguments.force.create("run", page, &inputs))
        .transpose()?;
    let video = arguments.video.begin(&arguments.force, "run", &inputs)?;

    let tally = simulate(arguments, ticks, &mut simulation, record.as_mut(), &cancel)?;
    let mut written = record.map_or_else(|| Ok(Vec::new()), |record| record.finish(&simulation))?;
    let page = match (&arguments.html, page, written.first()) {
        (Some(page), Some(mut out), Some(trace)) => {
            let limits = simulation.world().limits;
            let made =
                super::view::write(trace, &mut out, page, limits, &arguments.icons).and_then(|()| finish(out, page));
            if made.is_ok() {
                written.push(page.clone());
            }
            made
        }
        _ => Ok(()),
    };
    let video = match (video, written.first().cloned()) {
        (Some(video), Some(trace)) if tally.ticks > 0 => {
            let part = Part {
                crop: arguments.crop,
                scale: arguments.scale,
            };
            let traces = Traces {
                files: vec![(&trace, [None; 2])],
                names: Vec::new(),
                range: (0, u64::MAX),
            };
            video
                .write(&traces, part, &arguments.icons, &cancel)
                .map(|path| written.push(path))
        }
        _ => Ok(()),
    };
    let mut out = terminal::out();
    write!(out, "{}", summary(&mut simulation, &tally, sources, &written))?;
    page?;
    video?;
    if tally.ticks < ticks {
        writeln!(out, "interrupted after {} of {ticks} ticks", tally.ticks)?;
        return Err(Failure::Interrupted);
    }
    if tally.broken.is_empty() {
        return Ok(());
    }
    let faults = tally.broken.into_iter().map(|(fault, first, count)| {
        fault.note(format!(
            "first violated in tick {first}; violated in {count} of {} ticks",
            tally.ticks
        ))
    });
    Err(Failure::Input(faults.collect()))
}

/// Fails if the trace or the page of a run would be too large.
fn refuse_large_outputs(arguments: &Arguments, ticks: u64, agents: usize) -> Result<(), Failure> {
    if !arguments.no_trace && agents > MAX_ENTITIES {
        let message = format!("a trace of {agents} agents would be too large; the limit is {MAX_ENTITIES}");
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message);
        return Err(fault.help("use `--no-trace` to print only the summary").into());
    }
    let decisions = ticks.saturating_mul(agents as u64);
    if arguments.html.is_some() && decisions > DECISIONS_MAX as u64 {
        let message = format!("a page of {decisions} decisions would be slow to open; the limit is {DECISIONS_MAX}");
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message);
        return Err(fault
            .help("omit `--html` and write a page of some ticks: `logicity view TRACE --from N --ticks N`")
            .into());
    }
    if arguments.video.video.is_some() {
        let help = "omit `--video` and make one of some ticks: `logicity view TRACE --video FILE --from N --ticks N`";
        video::refuse_large(decisions, help)?;
    }
    Ok(())
}

/// Runs the ticks until cancellation and records them.
fn simulate(
    arguments: &Arguments,
    ticks: u64,
    simulation: &mut Simulation,
    mut record: Option<&mut Record>,
    cancel: &Cancel,
) -> Result<Tally, Failure> {
    let bar = ProgressBar::new(ticks).with_style(
        ProgressStyle::with_template("{bar:30} tick {pos} of {len}, {per_sec}, {eta} left").expect("a valid template"),
    );
    let bar = terminal::with_lines(bar, "tick");
    let mut tally = Tally {
        last_move: vec![0; simulation.agents().len()],
        waited: vec![BTreeSet::new(); simulation.agents().len()],
        firings: vec![0; simulation.clauses().len()],
        ..Tally::default()
    };
    while tally.ticks < ticks && !cancel.requested() {
        let state = (record.as_ref()).and_then(|record| record.state(simulation));
        let begin = Instant::now();
        let tick = simulation.tick(&[])?.tick;
        tally.deciding += begin.elapsed();
        tally.add(simulation);
        if arguments.check_constraints {
            let snapshot = simulation.snapshot()?;
            let world = snapshot.world();
            let known = |predicate| world.vocabulary.defines(&world.program, predicate);
            tally.add_broken(constraints::violations_among(snapshot.session(), known), tick);
        }
        if let Some(record) = &mut record {
            record.tick(simulation, state)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(tally)
}

/// The files of a run, which have temporary names until it ends.
struct Record {
    folder: PathBuf,
    trace: TraceWriter<Output>,
    pictures: Option<Pictures>,
    drawn: Vec<Drawn>,
}

/// The animation, and the picture of the last tick.
struct Pictures {
    icons: Arc<Icons>,
    scale: Option<Scale>,
    /// The empty file of the animation, until the part of the map to show is known.
    begun: Option<Output>,
    drawing: Option<Drawing>,
    /// The ticks of the animation that are not drawn yet.
    kept: Vec<Frame>,
    /// The last tick; before the first one, the state that it will decide.
    shown: Frame,
    last: Output,
}

struct Drawing {
    overview: Overview,
    animation: Animation<Output>,
}

impl Pictures {
    /// Chooses the part of the map to show, and begins the animation. `first` is the state before the first tick.
    fn begin(
        &mut self,
        simulation: &Simulation,
        drawn: &[Drawn],
        part: Extent,
        first: &Frame,
        path: &Path,
    ) -> Result<(), Failure> {
        let world = simulation.world();
        let city = (world.map(), world.vocabulary.actions());
        let overview = Overview::of_city(city, Arc::clone(&self.icons), part, self.scale);
        let overview = overview.map_err(|error| match self.scale {
            Some(_) => Failure::Usage(format!("{error}\nhelp: use a smaller `--scale`, or `--crop`")),
            None => Diagnostic::new(codes::INVALID_MAP, error.to_string()).into(),
        })?;
        let sample = overview.draw(first.tick, &first.sprites(drawn));
        let out = self.begun.take().expect("the animation has not begun");
        let animation = Animation::new(out, &sample, FRAME_DELAY).map_err(|error| unwritable(path, &error))?;
        self.drawing = Some(Drawing { overview, animation });
        Ok(())
    }

    /// Adds a frame to the animation.
    fn add(&mut self, drawn: &[Drawn], frame: &Frame) -> io::Result<()> {
        match &mut self.drawing {
            Some(Drawing { overview, animation }) => animation.push(&overview.draw(frame.tick, &frame.sprites(drawn))),
            None => {
                self.kept.push(frame.clone());
                Ok(())
            }
        }
    }
}

impl Record {
    fn new(
        arguments: &Arguments,
        inputs: &Inputs,
        simulation: &Simulation,
        sources: &Sources,
        rule_files: &[SourceId],
    ) -> Result<Record, Failure> {
        let folder = arguments.out.clone();
        make_folder(&folder)?;
        let create = |name: &str| arguments.force.create("run", &folder.join(name), inputs);
        let trace = TraceWriter::new(create("trace.jsonl")?, simulation, sources, rule_files)
            .map_err(|error| unwritable(&folder.join("trace.jsonl"), &error))?;
        let drawn = Drawn::of_city(simulation);
        let pictures = if arguments.no_pictures {
            None
        } else {
            let first = Frame::before(simulation);
            let mut pictures = Pictures {
                icons: Arc::new(
                    arguments
                        .icons
                        .load(simulation.seed(), &simulation.world().scenario.looks)?,
                ),
                scale: arguments.scale,
                begun: Some(create("city.gif")?),
                drawing: None,
                kept: Vec::new(),
                shown: first.clone(),
                last: create("last.png")?,
            };
            if !arguments.crop {
                let whole = Extent::whole(simulation.world().map());
                pictures.begin(simulation, &drawn, whole, &first, &folder.join("city.gif"))?;
            }
            Some(pictures)
        };
        Ok(Record {
            drawn,
            folder,
            trace,
            pictures,
        })
    }

    fn fault(&self, name: &str, error: io::Error) -> Failure {
        unwritable(&self.folder.join(name), &error)
    }

    /// Returns the state that the next tick decides, if it will be drawn.
    fn state(&self, simulation: &Simulation) -> Option<Frame> {
        self.pictures.as_ref().map(|_| Frame::before(simulation))
    }

    /// Writes the last tick. `state` is the state that it decided.
    fn tick(&mut self, simulation: &Simulation, state: Option<Frame>) -> Result<(), Failure> {
        (self.trace.tick(simulation)).map_err(|error| self.fault("trace.jsonl", error))?;
        if let (Some(pictures), Some(mut frame)) = (&mut self.pictures, state) {
            frame.decide(simulation);
            if frame.tick < MAX_FRAMES {
                let added = pictures.add(&self.drawn, &frame);
                added.map_err(|error| unwritable(&self.folder.join("city.gif"), &error))?;
            }
            pictures.shown = frame;
        }
        Ok(())
    }

    /// Gives the files their final names and returns these.
    fn finish(self, simulation: &Simulation) -> Result<Vec<PathBuf>, Failure> {
        let path = |name: &str| self.folder.join(name);
        let fault = |name: &str, error: io::Error| unwritable(&path(name), &error);
        finish(self.trace.into_inner(), &path("trace.jsonl"))?;
        let mut written = vec![path("trace.jsonl")];
        if let Some(mut pictures) = self.pictures {
            let kept = mem::take(&mut pictures.kept);
            if pictures.drawing.is_none() {
                let last = pictures.shown.clone();
                let first = kept.first().unwrap_or(&last);
                let frames = kept.iter().chain([&last]);
                let cells = frames.flat_map(|frame| frame.agents.iter().map(|(at, ..)| *at));
                let visited = Extent::around(simulation.world().map(), cells, CROP_MARGIN);
                pictures.begin(simulation, &self.drawn, visited, first, &path("city.gif"))?;
            }
            for frame in &kept {
                let added = pictures.add(&self.drawn, frame);
                added.map_err(|error| fault("city.gif", error))?;
            }
            let Pictures {
                drawing,
                shown: last,
                last: mut out,
                ..
            } = pictures;
            let Drawing { overview, animation } = drawing.expect("the animation has begun");
            let animation = animation.finish().map_err(|error| fault("city.gif", error))?;
            finish(animation, &path("city.gif"))?;
            let picture = overview.draw(last.tick, &last.sprites(&self.drawn));
            write_png(&picture, &mut out).map_err(|error| fault("last.png", error))?;
            finish(out, &path("last.png"))?;
            written.extend([path("city.gif"), path("last.png")]);
        } else {
            // Pictures of an earlier run would not fit the trace.
            let pictures = [path("city.gif"), path("last.png")];
            let removed = remove_own(&pictures.each_ref().map(PathBuf::as_path), "run");
            removed.map_err(|(position, error)| unremovable(&pictures[position], &error))?;
        }
        Ok(written)
    }
}

impl Tally {
    /// Counts the last tick.
    fn add(&mut self, simulation: &mut Simulation) {
        self.ticks += 1;
        let world = Arc::clone(simulation.world());
        let table = world.vocabulary.actions();
        for (index, (done, agent)) in (simulation.report().agents.iter().zip(simulation.agents())).enumerate() {
            let counts = self.actions.entry(agent.kind_id).or_default();
            counts.resize(counts.len().max(done.action.index() + 1), 0);
            counts[done.action.index()] += 1;
            // What its kind cannot take is not in conflict.
            let possible = || (done.derived.iter()).filter(|action| table.can_take(agent.kind_id, *action));
            if possible().nth(1).is_some() {
                let overlap = (possible().collect(), done.action);
                *self.overlaps.entry(overlap).or_default() += 1;
            }
            if done.moved.from != done.moved.to {
                self.last_move[index] = self.ticks;
                self.goals += u64::from(agent.at_goal());
                self.waited[index].clear();
            }
        }
        for (sum, fired) in self.firings.iter_mut().zip(simulation.firings()) {
            *sum += *fired as u64;
        }
        if self.ticks.is_multiple_of(LOOK_TICKS) {
            let still = |agent: &usize| self.ticks - self.last_move[*agent] >= LOOK_TICKS;
            let still: Vec<usize> = (0..self.last_move.len()).filter(still).collect();
            if still.is_empty() {
                return;
            }
            // If there are too many waits to examine, the summary says so.
            let Ok(snapshot) = simulation.snapshot() else { return };
            for wait in waits(&snapshot, &still).unwrap_or_default() {
                self.waited[wait.agent].insert((wait.on, wait.clause));
            }
        }
    }

    /// Counts the constraints that the facts of a tick violate.
    fn add_broken(&mut self, mut faults: Vec<Diagnostic>, tick: u64) {
        // One directive may declare several constraints.
        faults.dedup_by(|a, b| a.primary == b.primary);
        for fault in faults {
            let same = |(known, ..): &&mut (Diagnostic, u64, u64)| known.primary == fault.primary;
            match self.broken.iter_mut().find(same) {
                Some((_, _, count)) => *count += 1,
                None => self.broken.push((fault, tick, 1)),
            }
        }
    }
}

fn summary(simulation: &mut Simulation, tally: &Tally, sources: &Sources, written: &[PathBuf]) -> String {
    let world = simulation.world();
    let scenario = &world.scenario;
    let agents = simulation.agents();
    let mut text = String::new();
    let count = |kind| agents.iter().filter(|agent| agent.kind_id == kind).count();
    let _ = writeln!(
        text,
        "{} ({}): {} on {}, seed {}",
        scenario.name,
        simulation.split().name(),
        agents_in_words(&scenario.kinds, count),
        world.map().name,
        simulation.seed().0,
    );
    let threads = match simulation.threads() {
        1 => "1 thread".to_owned(),
        several => format!("{several} threads"),
    };
    let because = simulation.fallback().map(|reason| {
        let place = reason
            .primary
            .as_ref()
            .map(|label| format!(" at {}", sources.locate(label.span)));
        format!(": {}{}", reason.message, place.unwrap_or_default())
    });
    let _ = writeln!(
        text,
        "{} executor, {threads}{}",
        simulation.executor().name(),
        because.unwrap_or_default()
    );
    let decisions = tally.ticks * agents.len() as u64;
    #[allow(clippy::cast_precision_loss)]
    let rate = decisions as f64 / tally.deciding.as_secs_f64().max(1e-9);
    let _ = writeln!(
        text,
        "{}, {}, {rate:.0} decisions per second, {} reached",
        counted(tally.ticks, "tick"),
        counted(decisions, "decision"),
        counted(tally.goals, "goal")
    );
    let table = simulation.world().vocabulary.actions();
    let column = |name: &str| format!("{name:>width$}", width = name.len().max(8) + 2);
    let names: String = table.names().map(column).collect();
    let _ = writeln!(text, "\n{:<12}{names}", "decisions");
    for kind in scenario.kinds.all() {
        let counts = tally.actions.get(&kind);
        if counts.is_none() && !kind.is_standard() {
            continue;
        }
        let kind = match kind.is_standard() {
            true => scenario.kinds.key(kind).to_owned(),
            false => format!("{}s", scenario.kinds.name(kind)),
        };
        let count = |action: Action| {
            counts
                .and_then(|counts| counts.get(action.index()))
                .copied()
                .unwrap_or(0)
        };
        let counts: String = (table.all())
            .map(|action| format!("{:>width$}", count(action), width = column(table.name(action)).len()))
            .collect();
        let _ = writeln!(text, "{kind:<12}{counts}");
    }
    for ((derived, chosen), count) in &tally.overlaps {
        let others = derived.iter().filter(|action| *action != chosen);
        let others: Vec<&str> = others.map(|action| table.name(*action)).collect();
        let _ = writeln!(
            text,
            "conflicts: {} won over {} in {}",
            table.name(*chosen),
            others.join(" and "),
            counted(*count, "decision")
        );
    }
    firings(simulation, tally, sources, &mut text);
    if tally.ticks >= STUCK_TICKS {
        stuck(simulation, tally, sources, &mut text);
    }
    if tally.ticks > MAX_FRAMES && written.iter().any(|path| path.ends_with("city.gif")) {
        let _ = writeln!(text, "the animation ends after {MAX_FRAMES} ticks");
    }
    let written: Vec<String> = written.iter().map(|path| path.display().to_string()).collect();
    if !written.is_empty() {
        let _ = writeln!(text, "wrote {}", written.join(", "));
    }
    text
}

/// Lists the clauses with the number of decisions in which each fired.
fn firings(simulation: &Simulation, tally: &Tally, sources: &Sources, text: &mut String) {
    let _ = writeln!(text, "\n{:>10}  clause", "fired");
    let rules = simulation.world().program.rules();
    let place = |clause: &Clause| {
        let file = Path::new(sources.file(clause.span)).file_name();
        let line = sources.position(clause.span).line;
        format!("{}:{line}", file.unwrap_or_default().to_string_lossy())
    };
    let title = |clause: &Clause| match clause.doc.lines().next() {
        Some(title) => title.to_owned(),
        None => sources
            .slice(clause.span)
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" "),
    };
    let rows: Vec<[String; 4]> = (simulation.clauses().iter().zip(&tally.firings))
        .map(|(clause, fired)| {
            let clause = &rules.clauses[clause.index()];
            let head = rules.predicates[clause.head.predicate.index()].name.clone();
            [fired.to_string(), head, place(clause), title(clause)]
        })
        .collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let (heads, places) = (width(1), width(2));
    for [fired, head, place, title] in &rows {
        let _ = writeln!(text, "{fired:>10}  {head:<heads$}  {place:<places$}  {title}");
    }
}

/// Describes the stuck agents and the waits between them in the state of the last tick.
fn stuck(simulation: &mut Simulation, tally: &Tally, sources: &Sources, text: &mut String) {
    let still = |agent: &usize| tally.ticks - tally.last_move[*agent] >= STUCK_TICKS;
    let stuck: Vec<usize> = (0..tally.last_move.len()).filter(still).collect();
    let names: Vec<String> = (simulation.agents().iter())
        .map(|agent| agent.name().to_string())
        .collect();
    let name = |agent: usize| &*names[agent];
    let listed: Vec<&str> = stuck.iter().map(|&agent| name(agent)).collect();
    let listed = if listed.is_empty() {
        "none".to_owned()
    } else {
        listed.join(", ")
    };
    let _ = writeln!(text, "\nstuck (no move in the last {STUCK_TICKS} ticks): {listed}");
    if stuck.is_empty() {
        return;
    }

    let found = (simulation.snapshot().map_err(|fault| fault.message)).and_then(|snapshot| {
        Ok((
            waits(&snapshot, &stuck).map_err(|error| error.to_string())?,
            snapshot.session(),
        ))
    });
    let (waits, session) = match found {
        Ok(found) => found,
        Err(error) => {
            let _ = writeln!(text, "  unknown cause: {error}");
            return;
        }
    };
    let printer = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources);
    // Formats `Car_3 (S2) -> Car_7 (S1) -> ..`: the waiting agent, the clause, and the agent it waits for.
    let chain = |way: &[WaitsFor]| {
        let links: String = (way.iter())
            .map(|wait| format!("{} ({}) -> ", name(wait.agent), printer.label(wait.clause)))
            .collect();
        links + way.last().map_or("", |wait| name(wait.on))
    };
    let DeadlockReport {
        deadlocks,
        behind,
        starving,
    } = find_deadlocks(&stuck, &waits);
    for cycle in &deadlocks {
        let since = cycle.iter().map(|wait| tally.last_move[wait.agent]).max().unwrap_or(0);
        let _ = writeln!(text, "  deadlock since tick {since}: {}", chain(cycle));
    }
    for agent in starving {
        let (mut names, mut labels): (Vec<&str>, Vec<String>) = Default::default();
        for &(on, clause) in &tally.waited[agent] {
            let (one, label) = (name(on), printer.label(clause));
            if !names.contains(&one) {
                names.push(one);
            }
            if !labels.contains(&label) {
                labels.push(label);
            }
        }
        let _ = if names.is_empty() {
            writeln!(text, "  not blocked: {} waits for no agent", name(agent))
        } else {
            let (names, labels) = (names.join(", "), labels.join(", "));
            writeln!(text, "  starving: {} ({labels}) yields in turn to {names}", name(agent))
        };
    }
    for way in &behind {
        let _ = writeln!(text, "  behind: {}", chain(way));
    }
}
