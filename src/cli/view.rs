//! `logicity view`: writes an HTML page of a trace, or of two traces side by side.

use crate::cancel::Cancel;
use crate::cli::failure::Failure;
use crate::cli::icons::IconOptions;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::outputs::{ForceOption, finish, messages, unwritable};
use crate::cli::terminal;
use crate::cli::trace::TraceReader;
use crate::cli::values::{integer, scale};
use crate::cli::video::{Part, Traces, VideoOptions};
use crate::datalog::Limits;
use crate::diag::{Diagnostic, SourceId, Sources};
use crate::files::Output;
use crate::page::{Comparison, Page};
use crate::render::Scale;
use crate::rng::Seed;
use crate::sim::codes;
use crate::sim::hash_sources;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Trace written by `logicity run`; two traces are shown side by side, with their differences
    #[arg(required = true, num_args = 1..=2, value_name = "TRACE")]
    traces: Vec<PathBuf>,
    /// Write the page to FILE; `-` means standard output [default: city.html, or no page with --video]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Number of the first tick to show
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    from: u64,
    /// Number of ticks to show [default: all]
    #[arg(long, value_parser = integer(1..=u64::MAX))]
    ticks: Option<u64>,
    /// Configuration to use instead of the one in the trace; must have the same content. For two traces, one for both
    /// or two
    #[arg(long, value_name = "CONFIG")]
    config: Vec<PathBuf>,
    /// Rules to use instead of those in the trace; must have the same content. For two traces, one for both or two
    #[arg(long, value_name = "RULES")]
    rules: Vec<PathBuf>,
    #[command(flatten)]
    video: VideoOptions,
    /// Show only the part of the map that agents visit, in the video
    #[arg(long, requires = "video")]
    crop: bool,
    /// Side of a cell in the video, in pixels, 1 to 64 [default: at most 12, so that the longer side of the map has at
    /// most 1000]
    #[arg(long, value_name = "PIXELS", value_parser = scale, requires = "video")]
    scale: Option<Scale>,
    #[command(flatten)]
    icons: IconOptions,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let Arguments { traces, icons, .. } = arguments;
    let default = arguments.video.video.is_none().then(|| PathBuf::from("city.html"));
    let output = arguments.output.clone().or(default);
    let range = (arguments.from, arguments.ticks.unwrap_or(u64::MAX));
    // The file given for a trace, or for both.
    let file = |files: &'_ [PathBuf], number: usize| files.get(number).or(files.last()).cloned();
    for (option, files) in [("--config", &arguments.config), ("--rules", &arguments.rules)] {
        if files.len() > traces.len() {
            let message = format!("{option} is given {} times for {} trace", files.len(), traces.len());
            return Err(Failure::Usage(message));
        }
    }
    if output.is_some() && arguments.video.video.is_some() && traces.iter().any(|trace| !trace.is_file()) {
        let message = "a page and a video read the trace twice, which a pipe does not allow";
        return Err(Failure::Usage(format!("{message}\nhelp: write the trace to a file")));
    }
    let inputs = Inputs::new(traces.clone()).with(icons.files());
    let inputs = inputs.with(arguments.config.iter().chain(&arguments.rules).cloned());
    let page = output
        .as_deref()
        .map(|output| arguments.force.create("view", output, &inputs));
    let page = page.transpose()?;
    let video = arguments.video.begin(&arguments.force, "view", &inputs)?;
    let results: Vec<&Path> = output
        .as_deref()
        .into_iter()
        .chain(arguments.video.video.as_deref())
        .collect();
    let mut out = messages(&results);
    let files = |number: usize| [file(&arguments.config, number), file(&arguments.rules, number)];
    if let (Some(mut file_out), Some(output)) = (page, &output) {
        let mut pages = Vec::new();
        for (number, trace) in traces.iter().enumerate() {
            let files = files(number);
            let files = [files[0].as_deref(), files[1].as_deref()];
            let limits = |trace: &TraceReader, rules: Option<&Path>| trace.limits(rules, &arguments.limits);
            pages.push(load(trace, range, files, Explain::Recorded, limits, icons, sources)?);
        }
        if !arguments.config.is_empty() || !arguments.rules.is_empty() {
            // The files that these name are known only now.
            Inputs::of(sources).refuse(output)?;
        }
        let fail = |error| unwritable(output, &error);
        if let [left, right] = &pages[..] {
            let comparison = Comparison::new([left, right], names([&traces[0], &traces[1]]))?;
            comparison.write(&mut file_out).map_err(fail)?;
            writeln!(out, "{}", comparison.summary())?;
        } else {
            pages[0].write(&mut file_out).map_err(fail)?;
        }
        finish(file_out, output)?;
        writeln!(out, "wrote {}", output.display())?;
    }
    if let Some(video) = video {
        let own: Vec<[Option<PathBuf>; 2]> = (0..traces.len()).map(files).collect();
        let files = traces
            .iter()
            .zip(&own)
            .map(|(trace, own)| (trace.as_path(), own.each_ref().map(Option::as_deref)));
        let names = match &traces[..] {
            [left, right] => names([left, right]).into(),
            _ => Vec::new(),
        };
        let shown = Traces {
            files: files.collect(),
            names,
            range,
        };
        let part = Part {
            crop: arguments.crop,
            scale: arguments.scale,
        };
        let path = video.write(&shown, part, icons, &Cancel::never())?;
        writeln!(out, "wrote {}", path.display())?;
    }
    Ok(())
}

/// Writes a page of a whole trace to `out`, whose path is `output`. `limits` applies to each tick.
pub fn write(
    trace: &Path,
    out: &mut Output,
    output: &Path,
    limits: Limits,
    icons: &IconOptions,
) -> Result<(), Failure> {
    let page = load(
        trace,
        (0, u64::MAX),
        [None; 2],
        Explain::Recorded,
        |_, _| limits,
        icons,
        &mut Sources::new(),
    )?;
    page.write(out).map_err(|error| unwritable(output, &error))
}

/// Writes a page of a whole trace that explains its states with learned rules. `report` is about these.
pub fn write_with(
    trace: &Path,
    (rules, report): (&Path, Value),
    out: &mut Output,
    output: &Path,
    limits: &LimitOptions,
) -> Result<(), Failure> {
    let (icons, files) = (IconOptions::default(), [None, Some(rules)]);
    let limits = |trace: &TraceReader, rules: Option<&Path>| trace.limits(rules, limits);
    let mut page = load(
        trace,
        (0, u64::MAX),
        files,
        Explain::Other,
        limits,
        &icons,
        &mut Sources::new(),
    )?;
    page.set_report(report);
    page.write(out).map_err(|error| unwritable(output, &error))
}

/// The rules that a page explains.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Explain {
    /// Those of the run.
    Recorded,
    /// Others, whose firings are derived again.
    Other,
}

/// Returns the last parts of two paths that differ: `x` and `y` for `x/trace.jsonl` and `y/trace.jsonl`. Without a
/// difference, returns `A` and `B`.
fn names([left, right]: [&Path; 2]) -> [String; 2] {
    let different = left
        .iter()
        .rev()
        .zip(right.iter().rev())
        .find(|(one, other)| one != other);
    match different {
        Some((one, other)) => [one, other].map(|part| part.to_string_lossy().into_owned()),
        None => ["A", "B"].map(str::to_owned),
    }
}

/// Returns a page of at most `most` ticks of a trace, from number `from` on. `config` and `rules` replace those in the
/// trace. `limits` returns the limits of each tick, given the trace and `rules`.
fn load(
    trace: &Path,
    (from, most): (u64, u64),
    [config, rules]: [Option<&Path>; 2],
    explain: Explain,
    limits: impl FnOnce(&TraceReader, Option<&Path>) -> Limits,
    icons: &IconOptions,
    sources: &mut Sources,
) -> Result<Page, Failure> {
    let mut reader = TraceReader::open(trace)?;
    let limits = limits(&reader, rules);
    let mut replay = reader.replay(sources, config, rules, explain == Explain::Recorded, limits)?;
    if let (Explain::Other, Some(rules)) = (explain, rules) {
        let is_rules = |id: &SourceId| sources.name(*id).ends_with(".dl");
        let files: Vec<SourceId> = sources.ids().filter(is_rules).collect();
        reader.header.rules = rules.display().to_string();
        reader.header.rules_hash = hash_sources(sources, &files);
    }
    let icons = icons.load(Seed(reader.header.seed), &replay.world().scenario.looks)?;
    let mut page = Page::new(&replay, &reader.header, &icons, sources)?;
    // The number of ticks is unknown before the end of the file, but its size is known.
    let bar = ProgressBar::new(reader.length).with_style(
        ProgressStyle::with_template("{bar:30} explaining tick {msg}, {percent} %, {eta} left")
            .expect("a valid template"),
    );
    let bar = terminal::with_lines(bar, "explaining, byte");
    let (mut shown, mut last) = (0, None);
    while shown < most
        && let Some(mut tick) = reader.tick()?
    {
        if tick.tick >= from {
            let set = replay.set(&tick).and_then(|()| match explain {
                Explain::Other => {
                    for (agent, fired) in tick.agents.iter_mut().zip(replay.fired()) {
                        agent.clauses = fired;
                    }
                    Ok(())
                }
                Explain::Recorded => replay.verify(&tick),
            });
            set.and_then(|()| page.push(&replay, &tick, sources))
                .map_err(|fault| reader.placed(fault))?;
            shown += 1;
        }
        last = Some(tick.tick);
        bar.set_message(tick.tick.to_string());
        bar.set_position(reader.read);
    }
    bar.finish_and_clear();
    match last {
        None => {
            let message = format!("`{}` has no ticks", trace.display());
            Err(Diagnostic::new(codes::INVALID_TRACE, message).into())
        }
        Some(last) if shown == 0 => Err(Failure::Usage(format!(
            "the trace ends with tick {last}, before tick {from}"
        ))),
        Some(_) => Ok(page),
    }
}
