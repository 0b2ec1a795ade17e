//! `logicity run`

use crate::city::{Action, AgentKind, Split};
use crate::cli::icons::IconOptions;
use crate::cli::{Failure, load_city, one_of};
use crate::datalog::constraints;
use crate::datalog::explain::ExplanationPrinter;
use crate::datalog::{Clause, ClauseId};
use crate::diag::{Code, Diagnostic, SourceId, Sources};
use crate::files::{Output, make_folder};
use crate::page::DECISIONS_MAX;
use crate::render::{Animation, Overview, Sprite, write_png};
use crate::rng::Seed;
use crate::sim::{
    DeadlockReport, Executor, LOOK_TICKS, MAX_ENTITIES, STUCK_TICKS, Settings, Simulation, TraceWriter, WaitsFor,
    World, hash_sources, standstill, waits,
};
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The animation ends after this many ticks, to stay of a size that viewers open.
const MAX_FRAMES: u64 = 1000;
/// How long the animation shows a tick.
const FRAME_DELAY: Duration = Duration::from_millis(100);

#[derive(clap::Args)]
pub struct Arguments {
    /// Run configuration
    config: PathBuf,
    /// How long, in ticks, 1 to 1000000000; the configuration's `ticks` unless given
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000), allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Seed of everything random in the run
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Which agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// Folder for trace.jsonl, city.gif and last.png; made if it does not exist
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Rule file instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Look at every tick, which then takes as long as with the relational executor, whether the facts satisfy the constraints of the rules
    /// (`.disjoint`, `.implies`, ..); exit code 1 if they are not
    #[arg(long)]
    check_constraints: bool,
    /// What evaluates the rules; runs are the same with each
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// Threads for a city of many agents; 0 is one for each core. Runs are the same with any number
    #[arg(long, value_parser = super::threads, default_value = "1", allow_negative_numbers = true)]
    threads: NonZeroUsize,
    /// Also write a page that a browser opens: the city moves, and every decision says why
    #[arg(long, value_name = "FILE", conflicts_with = "no_trace")]
    html: Option<PathBuf>,
    /// Write the trace only
    #[arg(long, conflicts_with_all = ["pack", "difficulty"])]
    no_pictures: bool,
    #[command(flatten)]
    icons: IconOptions,
    /// Write nothing, print the summary only
    #[arg(long)]
    no_trace: bool,
}

/// What the summary counts.
#[derive(Default)]
struct Tally {
    ticks: u64,
    deciding: Duration,
    actions: [[u64; 4]; 2],
    overlaps: u64,
    firings: Vec<u64>,
    goals: u64,
    last_move: Vec<u64>,
    /// For each agent that stands still, whom it waited for when it was looked at, and by which clause.
    waited: Vec<BTreeSet<(usize, ClauseId)>>,
    /// For each violated constraint, if constraints are checked: the first message, its tick, and the number of ticks.
    broken: Vec<(Diagnostic, u64, u64)>,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let (scenario, program, rule_file) = load_city(sources, &arguments.config, arguments.rules.as_deref())?;
    let rule_files: Vec<_> = sources.ids().skip_while(|&id| id != rule_file).collect();
    let rules_hash = hash_sources(sources, &rule_files);
    let ticks = arguments.ticks.unwrap_or(u64::from(scenario.ticks));
    let mut simulation = Simulation::new(
        Arc::new(World::new(scenario, program)?),
        arguments.split,
        Seed(arguments.seed),
        Settings {
            executor: arguments.executor,
            count_firings: true,
            threads: arguments.threads.get(),
        },
    )?;

    let stop = stop_on_interrupt()?;
    if !arguments.no_trace && simulation.agents().len() > MAX_ENTITIES {
        let agents = simulation.agents().len();
        let message = format!("a trace of {agents} agents would be too large; the limit is {MAX_ENTITIES}");
        let fault = Diagnostic::new(Code::LIMIT_EXCEEDED, message);
        return Err(fault
            .help("`--no-trace` runs the city and prints the summary only")
            .into());
    }
    let decisions = ticks.saturating_mul(simulation.agents().len() as u64);
    if arguments.html.is_some() && decisions > DECISIONS_MAX as u64 {
        let message = format!("a page of {decisions} decisions would be slow to open; the limit is {DECISIONS_MAX}");
        let fault = Diagnostic::new(Code::LIMIT_EXCEEDED, message);
        return Err(fault
            .help("leave out `--html` and make a page of some ticks: `logicity view TRACE --from N --ticks N`")
            .into());
    }
    let mut record = match arguments.no_trace {
        true => None,
        false => Some(Record::new(arguments, &simulation, sources, rule_file, &rules_hash)?),
    };

    let bar = ProgressBar::new(ticks).with_style(
        ProgressStyle::with_template("{bar:30} tick {pos} of {len}, {per_sec}, {eta} left").expect("a valid template"),
    );
    let mut tally = Tally {
        last_move: vec![0; simulation.agents().len()],
        waited: vec![BTreeSet::new(); simulation.agents().len()],
        firings: vec![0; simulation.clauses().len()],
        ..Tally::default()
    };
    while tally.ticks < ticks && !stop.load(Ordering::Relaxed) {
        let begin = Instant::now();
        let tick = simulation.tick(&[])?.tick;
        tally.deciding += begin.elapsed();
        tally.add(&mut simulation);
        if arguments.check_constraints {
            tally.add_broken(constraints::violations(simulation.snapshot()?.session()), tick);
        }
        if let Some(record) = &mut record {
            record.tick(&simulation)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();

    let mut written = record.map_or_else(|| Ok(Vec::new()), |record| record.finish(&simulation))?;
    let page = match (&arguments.html, written.first()) {
        (Some(page), Some(trace)) => {
            let files = [Some(arguments.config.as_path()), arguments.rules.as_deref()];
            let made = super::view::write(trace, page, (0, u64::MAX), files, &arguments.icons, &mut Sources::new());
            if made.is_ok() {
                written.push(page.clone());
            }
            made
        }
        _ => Ok(()),
    };
    let mut out = anstream::stdout();
    write!(out, "{}", summary(&mut simulation, &tally, sources, &written))?;
    page?;
    if tally.ticks < ticks {
        writeln!(out, "interrupted: {} of {ticks} ticks were run", tally.ticks)?;
        return Err(Failure::Interrupted);
    }
    if tally.broken.is_empty() {
        return Ok(());
    }
    let faults = tally.broken.into_iter().map(|(fault, first, count)| {
        fault.note(format!(
            "in tick {first} for the first time; in {count} of {} ticks",
            tally.ticks
        ))
    });
    Err(Failure::Input(faults.collect()))
}

/// The files of a run, under temporary names until it is over.
struct Record {
    folder: PathBuf,
    trace: TraceWriter<Output>,
    pictures: Option<(Overview, Animation<Output>)>,
    names: Vec<String>,
}

impl Record {
    fn new(
        arguments: &Arguments,
        simulation: &Simulation,
        sources: &Sources,
        rule_file: SourceId,
        rules_hash: &str,
    ) -> Result<Record, Failure> {
        let folder = arguments.out.clone();
        make_folder(&folder)?;
        let create = |name: &str| Output::create(&folder.join(name));
        let config = arguments.config.to_string_lossy();
        let trace = create("trace.jsonl")
            .and_then(|file| TraceWriter::new(file, simulation, sources, &config, rule_file, rules_hash))
            .map_err(|error| Failure::file("write", &folder.join("trace.jsonl"), error))?;
        let names: Vec<String> = (simulation.agents().iter().map(|agent| agent.name().to_string())).collect();
        let pictures = if arguments.no_pictures {
            None
        } else {
            let overview = Overview::new(
                simulation.world().map(),
                Arc::new(arguments.icons.load(simulation.seed())?),
            )
            .map_err(|error| Diagnostic::new(Code::INVALID_MAP, error.to_string()))?;
            let first = overview.draw(0, &sprites(simulation, &names));
            let animation = create("city.gif")
                .and_then(|file| Animation::new(file, &first, FRAME_DELAY))
                .map_err(|error| Failure::file("write", &folder.join("city.gif"), error))?;
            Some((overview, animation))
        };
        Ok(Record {
            names,
            folder,
            trace,
            pictures,
        })
    }

    fn fault(&self, name: &str, error: io::Error) -> Failure {
        Failure::file("write", &self.folder.join(name), error)
    }

    /// Writes the last tick.
    fn tick(&mut self, simulation: &Simulation) -> Result<(), Failure> {
        (self.trace.tick(simulation)).map_err(|error| self.fault("trace.jsonl", error))?;
        let tick = simulation.report().tick;
        if let Some((overview, animation)) = &mut self.pictures
            && tick < MAX_FRAMES
        {
            let frame = overview.draw(tick, &sprites(simulation, &self.names));
            animation.push(&frame).map_err(|error| self.fault("city.gif", error))?;
        }
        Ok(())
    }

    /// The files, which now have their names.
    fn finish(self, simulation: &Simulation) -> Result<Vec<PathBuf>, Failure> {
        let path = |name: &str| self.folder.join(name);
        let fault = |name: &str, error: io::Error| Failure::file("write", &path(name), error);
        (self.trace.into_inner().finish()).map_err(|error| fault("trace.jsonl", error))?;
        let mut written = vec![path("trace.jsonl")];
        if let Some((overview, animation)) = self.pictures {
            (animation.finish())
                .and_then(Output::finish)
                .map_err(|error| fault("city.gif", error))?;
            let frame = overview.draw(simulation.now(), &sprites(simulation, &self.names));
            Output::create(&path("last.png"))
                .and_then(|mut file| {
                    write_png(&frame, &mut file)?;
                    file.finish()
                })
                .map_err(|error| fault("last.png", error))?;
            written.extend([path("city.gif"), path("last.png")]);
        }
        Ok(written)
    }
}

/// Becomes true when the user interrupts the run (Ctrl-C) or the system asks it to end; what was done is then written and kept. A
/// second time ends the program at once.
fn stop_on_interrupt() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .map_err(|error| Failure::Usage(format!("cannot listen for interrupts: {error}")))?;
    Ok(stop)
}

/// The agents as they are, and what they decided in the last tick, if there was one. `names` are theirs.
fn sprites<'a>(simulation: &'a Simulation, names: &'a [String]) -> Vec<Sprite<'a>> {
    let decided = &simulation.report().agents;
    let agents = simulation.agents().iter().zip(names).enumerate();
    agents
        .map(|(index, (agent, name))| {
            let action = (simulation.now() > 0).then(|| decided[index].action);
            Sprite::of(agent, name, action)
        })
        .collect()
}

impl Tally {
    /// Counts the last tick.
    fn add(&mut self, simulation: &mut Simulation) {
        self.ticks += 1;
        for (index, (done, agent)) in (simulation.report().agents.iter().zip(simulation.agents())).enumerate() {
            let kind = match agent.kind {
                AgentKind::Car => 0,
                AgentKind::Pedestrian => 1,
            };
            self.actions[kind][done.action as usize] += 1;
            self.overlaps += u64::from(done.derived.len() > 1);
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
            // Waits that are too many to look at are told in the summary.
            let Ok(moment) = simulation.snapshot() else { return };
            for wait in waits(&moment, &still).unwrap_or_default() {
                self.waited[wait.agent].insert((wait.on, wait.clause));
            }
        }
    }

    /// Counts the constraints that the facts of a tick break.
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
    let cars = agents.iter().filter(|agent| agent.kind == AgentKind::Car).count();
    let _ = writeln!(
        text,
        "{} ({}): {cars} cars and {} pedestrians on {}, seed {}",
        scenario.name,
        simulation.split().name(),
        agents.len() - cars,
        world.map().name,
        simulation.seed().0,
    );
    let threads = match simulation.threads() {
        1 => "1 thread".to_owned(),
        several => format!("{several} threads"),
    };
    let because = simulation.fallback().map(|reason| format!(": {reason}"));
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
        "{} ticks, {decisions} decisions, {rate:.0} decisions per second, {} goals reached",
        tally.ticks, tally.goals
    );
    let _ = writeln!(
        text,
        "\n{:<12}{:>10}{:>10}{:>10}{:>10}",
        "decisions", "Slow", "Normal", "Fast", "Stop"
    );
    for (kind, counts) in ["cars", "pedestrians"].into_iter().zip(tally.actions) {
        let counts: String = Action::ALL
            .iter()
            .map(|&speed| format!("{:>10}", counts[speed as usize]))
            .collect();
        let _ = writeln!(text, "{kind:<12}{counts}");
    }
    if tally.overlaps > 0 {
        let _ = writeln!(
            text,
            "{} decisions had more than one action derived; the first by priority was taken",
            tally.overlaps
        );
    }
    let _ = writeln!(text, "\n{:>10}  clause", "fired");
    let rules = world.program.rules();
    let place = |clause: &Clause| {
        let file = Path::new(sources.name(clause.span.source)).file_name();
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
            let head = rules.relations[clause.head.relation.index()].name.clone();
            [fired.to_string(), head, place(clause), title(clause)]
        })
        .collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let (heads, places) = (width(1), width(2));
    for [fired, head, place, title] in &rows {
        let _ = writeln!(text, "{fired:>10}  {head:<heads$}  {place:<places$}  {title}");
    }
    if tally.ticks >= STUCK_TICKS {
        stuck(simulation, tally, sources, &mut text);
    }
    if tally.ticks > MAX_FRAMES && written.iter().any(|path| path.ends_with("city.gif")) {
        let _ = writeln!(text, "the animation shows the first {MAX_FRAMES} ticks");
    }
    let written: Vec<String> = written.iter().map(|path| path.display().to_string()).collect();
    if !written.is_empty() {
        let _ = writeln!(text, "wrote {}", written.join(", "));
    }
    text
}

/// Which agents are stuck, and why: who waits for whom in the state of the last tick.
fn stuck(simulation: &mut Simulation, tally: &Tally, sources: &Sources, text: &mut String) {
    let still = |agent: &usize| tally.ticks - tally.last_move[*agent] >= STUCK_TICKS;
    let stuck: Vec<usize> = (0..tally.last_move.len()).filter(still).collect();
    let names: Vec<String> = (simulation.agents().iter())
        .map(|agent| agent.name().to_string())
        .collect();
    let name = |agent: usize| &*names[agent];
    let told: Vec<&str> = stuck.iter().map(|&agent| name(agent)).collect();
    let told = if told.is_empty() {
        "none".to_owned()
    } else {
        told.join(", ")
    };
    let _ = writeln!(text, "\nstuck (no move in the last {STUCK_TICKS} ticks): {told}");
    if stuck.is_empty() {
        return;
    }

    let found = (simulation.snapshot().map_err(|fault| fault.message)).and_then(|moment| {
        Ok((
            waits(&moment, &stuck).map_err(|error| error.to_string())?,
            moment.session(),
        ))
    });
    let (waits, session) = match found {
        Ok(found) => found,
        Err(error) => {
            let _ = writeln!(text, "  why is not known: {error}");
            return;
        }
    };
    let teller = ExplanationPrinter::new(session.program().rules(), session.symbols(), sources);
    // `Car_3 (S2) -> Car_7 (S1) -> ..`: who waits, by which clause, and for whom.
    let chain = |way: &[WaitsFor]| {
        let links: String = (way.iter())
            .map(|wait| format!("{} ({}) -> ", name(wait.agent), teller.label(wait.clause)))
            .collect();
        links + way.last().map_or("", |wait| name(wait.on))
    };
    let DeadlockReport {
        deadlocks,
        behind,
        starving,
    } = standstill(&stuck, &waits);
    for circle in &deadlocks {
        let since = circle.iter().map(|wait| tally.last_move[wait.agent]).max().unwrap_or(0);
        let _ = writeln!(text, "  deadlock since tick {since}: {}", chain(circle));
    }
    for agent in starving {
        let (mut names, mut labels): (Vec<&str>, Vec<String>) = Default::default();
        for &(on, clause) in &tally.waited[agent] {
            let (one, label) = (name(on), teller.label(clause));
            if !names.contains(&one) {
                names.push(one);
            }
            if !labels.contains(&label) {
                labels.push(label);
            }
        }
        let _ = if names.is_empty() {
            writeln!(text, "  not held: {} waits for nobody", name(agent))
        } else {
            let (names, labels) = (names.join(", "), labels.join(", "));
            writeln!(
                text,
                "  starving: {} ({labels}) gives way in turn to {names}",
                name(agent)
            )
        };
    }
    for way in &behind {
        let _ = writeln!(text, "  behind: {}", chain(way));
    }
}
