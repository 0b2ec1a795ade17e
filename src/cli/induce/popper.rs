//! `logicity induce --popper`: learns the target of a task in the format of Popper.

use crate::cli::failure::Failure;
use crate::cli::induce::ask::ASK_OPTIONS;
use crate::cli::induce::{Arguments, search_bar, show};
use crate::cli::inputs::{Inputs, unreadable};
use crate::cli::outputs::{finish, is_stdout, messages, print_others, unwritable};
use crate::cli::report::report;
use crate::cli::signals;
use crate::diag::{SourceId, Sources, counted};
use crate::files;
use crate::induce::{Noise, Progress, Settings};
use crate::popper::{Files, Options, read};
use crate::sim::TICK_LIMITS;
use crate::task::induction::TargetRules;
use serde_json::json;
use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(clap::Args)]
pub struct PopperOptions {
    /// Learn the task in FOLDER: the files `bk.pl`, `exs.pl` and `bias.pl` of the learner Popper. Writes Prolog
    /// clauses, or a rule file with the facts of the task if the output ends in `.dl`
    #[arg(long, value_name = "FOLDER", conflicts_with_all = CITY_OPTIONS, conflicts_with_all = ASK_OPTIONS)]
    pub popper: Option<PathBuf>,
    /// With `--popper`: all arguments of the target that are not in an example are negative examples
    #[arg(long, requires = "popper", conflicts_with_all = CITY_OPTIONS, conflicts_with_all = ASK_OPTIONS)]
    closed_world: bool,
    /// With `--popper`: clauses may have negated literals
    #[arg(long, requires = "popper", conflicts_with_all = CITY_OPTIONS, conflicts_with_all = ASK_OPTIONS)]
    negation: bool,
}

/// The options about a city, which a task in the format of Popper does not have, beside [`ASK_OPTIONS`].
const CITY_OPTIONS: [&str; 8] = ["data", "config", "rules", "split", "episodes", "test", "page", "order"];

pub fn run(arguments: &Arguments, folder: &Path, sources: &mut Sources) -> Result<(), Failure> {
    let options = &arguments.popper;
    if folder.exists() && !folder.is_dir() {
        let message = format!("--popper: `{}` is not a folder with a task", folder.display());
        return Err(Failure::Usage(message));
    }
    let files = add_files(folder, sources)?;
    let inputs = Inputs::of(sources);
    // A file that cannot be written is reported before the work.
    let path = arguments.output.as_path();
    let mut rules_out = arguments.force.create("induce", path, &inputs)?;
    let report_out = (arguments.report.as_deref())
        .map(|path| arguments.force.create("induce", path, &inputs).map(|out| (out, path)))
        .transpose()?;

    let begun = Instant::now();
    let options_of_task = Options {
        closed_world: options.closed_world,
        variables: arguments.variables,
        limits: arguments.limits.limits(TICK_LIMITS),
    };
    let (task, diagnostics) = read(sources, &files, &options_of_task);
    let Some(task) = task else {
        return Err(diagnostics.into());
    };
    report(&diagnostics, sources);
    check_variables(arguments.variables, task.variables)?;
    let read_seconds = begun.elapsed().as_secs_f64();
    let settings = Settings {
        nodes: arguments.effort,
        seed: arguments.seed,
        threads: arguments.threads,
        negation: options.negation,
        noise: arguments.noise.unwrap_or(Noise::None),
        ..task.settings()
    };
    let cancel = signals::cancel();
    let begun = Instant::now();
    let bar = search_bar("positive examples");
    let progress = |progress: Progress| show(&bar, progress, "");
    let solution = task.solve(|_| true, &settings, &progress, &cancel);
    bar.finish_and_clear();
    let learn_seconds = begun.elapsed().as_secs_f64();

    let rules = TargetRules::new(&task, &solution, &settings);
    let lines = origin(folder, &settings, options);
    let text = match path.extension() == Some(OsStr::new("dl")) {
        true => rules.rule_file(&lines),
        false => rules.prolog(&lines),
    };
    write!(rules_out, "{text}").map_err(|error| unwritable(path, &error))?;
    finish(rules_out, path)?;
    if let Some((mut out, path)) = report_out {
        let mut json = rules.report();
        json["origin"] = json!(lines);
        json["closed_world"] = json!(options.closed_world);
        json["seconds"] = json!({"read": read_seconds, "learn": learn_seconds});
        writeln!(out, "{json:#}").map_err(|error| unwritable(path, &error))?;
        finish(out, path)?;
    }
    if !is_stdout(path) {
        let mut written = vec![path];
        written.extend(arguments.report.as_deref());
        writeln!(
            messages(&written),
            "wrote {} to {} in {:.2} s\n{}",
            counted(rules.clauses(), "clause"),
            path.display(),
            read_seconds + learn_seconds,
            rules.outcome()
        )?;
        print_others(&mut *messages(&written), &[arguments.report.as_deref()])?;
    }
    if solution.is_cut {
        return Err(Failure::Interrupted);
    }
    match rules.shortfall() {
        Some(fault) => Err(fault.into()),
        None => Ok(()),
    }
}

/// Reads the files of a task.
fn add_files(folder: &Path, sources: &mut Sources) -> Result<Files, Failure> {
    let mut add = |name: &str| -> Result<SourceId, Failure> {
        let path = folder.join(name);
        let text = files::read_text(&path).map_err(|error| unreadable(&path, &error))?;
        Ok(sources.add(path.display().to_string(), text))
    };
    Ok(Files {
        background: add("bk.pl")?,
        examples: add("exs.pl")?,
        bias: add("bias.pl")?,
    })
}

/// Fails if the option `--variables` asks for another number of variables than the task can have.
fn check_variables(wanted: Option<usize>, bound: usize) -> Result<(), Failure> {
    let Some(wanted) = wanted.filter(|wanted| *wanted != bound) else {
        return Ok(());
    };
    let message = match wanted > bound {
        true => format!("the bias permits at most {bound}\nhelp: change `max_vars` in `bias.pl`"),
        false => format!("the target has {bound} arguments"),
    };
    Err(Failure::Usage(format!("--variables {wanted}: {message}")))
}

/// Returns the lines that say how the rules were learned.
fn origin(folder: &Path, settings: &Settings, options: &PopperOptions) -> [String; 2] {
    [
        format!(
            "Rules learned by logicity {} from {}.",
            env!("CARGO_PKG_VERSION"),
            files::portable_name(&folder.display().to_string())
        ),
        format!(
            "At most {} variables, {} per search, seed {}{}{}{}.",
            settings.variables,
            counted(settings.nodes as usize, "step"),
            settings.seed,
            if options.negation { ", negated literals" } else { "" },
            if options.closed_world { ", closed world" } else { "" },
            if settings.noise == Noise::None { "" } else { ", noise" },
        ),
    ]
}
