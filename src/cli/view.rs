//! `logicity view`: writes an HTML page of a trace.

use crate::cli::icons::IconOptions;
use crate::cli::trace::TraceReader;
use crate::cli::{Failure, ForceOption, finish, unwritable};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files::Output;
use crate::page::Page;
use crate::rng::Seed;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Trace written by `logicity run`
    trace: PathBuf,
    /// Write the page to FILE
    #[arg(short, long, value_name = "FILE", default_value = "city.html")]
    output: PathBuf,
    /// Number of the first tick to show
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    from: u64,
    /// Number of ticks to show [default: all]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..), allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Configuration to use instead of the one in the trace; must have the same content
    #[arg(long)]
    config: Option<PathBuf>,
    /// Rules to use instead of those in the trace; must have the same content
    #[arg(long)]
    rules: Option<PathBuf>,
    #[command(flatten)]
    icons: IconOptions,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let range = (arguments.from, arguments.ticks.unwrap_or(u64::MAX));
    let files = [arguments.config.as_deref(), arguments.rules.as_deref()];
    let (trace, output) = (&arguments.trace, &arguments.output);
    if let (Ok(from), Ok(to)) = (trace.canonicalize(), output.canonicalize())
        && from == to
    {
        let message = format!(
            "the page would overwrite its trace `{}`; specify another file",
            trace.display()
        );
        return Err(Failure::Usage(message));
    }
    let mut out = arguments.force.create(output)?;
    write(trace, &mut out, output, range, files, &arguments.icons, sources)?;
    finish(out, output)?;
    writeln!(io::stdout(), "wrote {}", output.display())?;
    Ok(())
}

/// Writes a page of at most `most` ticks of a trace, from number `from` on, to `out`, whose path is `output`. `config`
/// and `rules` replace those in the trace.
pub fn write(
    trace: &Path,
    out: &mut Output,
    output: &Path,
    (from, most): (u64, u64),
    [config, rules]: [Option<&Path>; 2],
    icons: &IconOptions,
    sources: &mut Sources,
) -> Result<(), Failure> {
    let mut reader = TraceReader::open(trace)?;
    let mut replay = reader.replay(sources, config, rules, true)?;
    let icons = icons.load(Seed(reader.header.seed))?;
    let mut page = Page::new(&replay, &reader.header, &icons, sources);
    // The number of ticks is unknown before the end of the file, but its size is known.
    let bar = ProgressBar::new(reader.length).with_style(
        ProgressStyle::with_template("{bar:30} explaining tick {msg}, {percent} %, {eta} left")
            .expect("a valid template"),
    );
    let (mut shown, mut last) = (0, None);
    while shown < most
        && let Some(tick) = reader.tick()?
    {
        if tick.tick >= from {
            (replay.set(&tick))
                .and_then(|()| page.push(&replay, &tick, sources))
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
            return Err(Diagnostic::new(Code::INVALID_TRACE, message).into());
        }
        Some(last) if shown == 0 => {
            return Err(Failure::Usage(format!(
                "the trace ends with tick {last}, before tick {from}"
            )));
        }
        Some(_) => {}
    }
    page.write(out).map_err(|error| unwritable(output, &error))
}
