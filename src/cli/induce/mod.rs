//! `logicity induce`: learns rules from examples and questions.

mod ask;
mod collect;
mod popper;

use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::cli::failure::{Failure, assumed};
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, finish, is_stdout, messages, print_others, refuse_mixing, unwritable};
use crate::cli::values::{integer, one_of, threads};
use crate::cli::view;
use crate::cli::{signals, terminal};
use crate::diag::{Sources, counted};
use crate::files;
use crate::induce::{Examples, LearnedRules, NOISE_MAX, Noise, Progress, Settings, VARIABLES_MAX, learn_with, support};
use crate::sim::LoadedCity;
use crate::task::induction::{
    InductionTask, Inquiry, Origin, Questions, Recalls, broken_constraints, only_action, report_json, rule_file,
};
use ask::{ASK_OPTIONS, AskOptions};
use collect::{Collected, collect};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// The configuration without `--config`, `--rules` and traces.
const CONFIG: &str = "configs/expert.yaml";

#[derive(clap::Args)]
pub struct Arguments {
    /// Examples: traces of `logicity run`, scenes with `actions` (one JSON object per line), Parquet tables of
    /// `Demonstrations.to_parquet`, or data sets of `logicity vap make`; `-` means standard input [default: the
    /// recorded episodes of the configuration, driven by its rules]
    data: Vec<PathBuf>,
    /// Configuration that defines the predicates. The learner does not read its clauses of actions [default: with
    /// traces and without --rules, that of the traces, otherwise configs/expert.yaml]
    #[arg(long)]
    config: Option<PathBuf>,
    /// Rule file to use instead of the configuration's, for its declarations
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Recorded episodes to learn from
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "train", conflicts_with = "data")]
    split: Split,
    /// Number of recorded episodes, from the first on; 0 with `--ask` to learn from questions alone [default: all]
    #[arg(long, value_name = "COUNT", value_parser = integer(0..=1_000_000_usize), conflicts_with = "data")]
    episodes: Option<usize>,
    /// Write the rules to FILE; `-` means standard output
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    output: PathBuf,
    /// Write the clauses with their support as JSON to FILE; `-` means standard output
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Examples to measure the rules on, as for DATA: prints recalls by action and the weighted accuracy (wAcc) of the
    /// paper. May be given several times
    #[arg(long, value_name = "DATA")]
    test: Vec<PathBuf>,
    /// Write an HTML page of the trace to FILE that shows which clause decides each moment; needs one trace, and
    /// `--output` with a file
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Actions in the order in which the learned rules try them, separated by commas. The default action of the
    /// configuration comes last [default: Stop,Slow,Fast]
    #[arg(long, value_name = "ACTIONS", value_delimiter = ',', value_parser = one_of(&Action::STANDARD, Action::name))]
    order: Vec<Action>,
    /// Maximum number of variables of a clause [default: 3; with `--popper`, `max_vars` of the bias, which also bounds
    /// it]
    #[arg(long, value_name = "COUNT", value_parser = integer(2..=VARIABLES_MAX))]
    variables: Option<usize>,
    /// Maximum number of steps of the search for one clause; without effect on examples with wrong actions (`--noise`)
    #[arg(long, value_name = "COUNT", value_parser = integer(1..=u32::MAX), default_value_t = Settings::default().nodes)]
    effort: u32,
    /// Share of examples that may have a wrong action, from 0 to 0.4, or `auto` to estimate it; with `--popper`, in
    /// `auto` an exception counts as much as a literal. Without it, two examples with the same facts and different
    /// actions are an error
    #[arg(long, value_name = "RATE", value_parser = noise, conflicts_with_all = ASK_OPTIONS)]
    noise: Option<Noise>,
    /// Seed of the order in which the learner tries examples
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Number of threads, 0 for one per core; the rules do not depend on it [default: 0]
    #[arg(long, value_name = "COUNT", value_parser = threads)]
    threads: Option<NonZeroUsize>,
    #[command(flatten)]
    popper: popper::PopperOptions,
    #[command(flatten)]
    ask: AskOptions,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

impl Arguments {
    /// Returns whether the user names the configuration or the rules.
    fn is_configured(&self) -> bool {
        self.config.is_some() || self.rules.is_some()
    }

    /// Returns the output files and their options.
    fn outputs(&self) -> Vec<(&'static str, &Path)> {
        let mut outputs = vec![("--output", self.output.as_path())];
        outputs.extend(self.report.as_deref().map(|path| ("--report", path)));
        outputs.extend(self.page.as_deref().map(|path| ("--page", path)));
        outputs
    }

    fn settings(&self) -> Settings {
        Settings {
            variables: self.variables.unwrap_or(Settings::default().variables),
            nodes: self.effort,
            seed: self.seed,
            noise: self.noise.unwrap_or(Noise::None),
            threads: self.threads,
            ..Settings::default()
        }
    }
}

/// Checks the combination of arguments.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.episodes == Some(0) && !arguments.ask.is_asked() {
        let message = "--episodes 0 leaves nothing to learn from; `--ask` names an oracle for questions";
        return Err(Failure::Usage(message.to_owned()));
    }
    // The page reads the trace again, which a pipe does not allow.
    let is_one_file = matches!(&arguments.data[..], [path] if path.is_file());
    if arguments.page.is_some() && (!is_one_file || is_stdout(&arguments.output)) {
        let message = "--page needs one trace in a file, as `logicity run` writes it, and --output with a file";
        return Err(Failure::Usage(message.to_owned()));
    }
    let repeated = (1..arguments.order.len()).find(|&at| arguments.order[..at].contains(&arguments.order[at]));
    if let Some(at) = repeated {
        let message = format!("--order: `{}` occurs twice", arguments.order[at].name());
        return Err(Failure::Usage(message));
    }
    let inputs = arguments.data.iter().chain(&arguments.test);
    if inputs.filter(|path| path.as_path() == Path::new("-")).count() > 1 {
        let message = "standard input can be read once only; name a file for the other examples";
        return Err(Failure::Usage(message.to_owned()));
    }
    Ok(())
}

/// Loads the city that defines the predicates. Returns the number of sources that are files within a trace and not on
/// disk.
fn load(arguments: &Arguments, sources: &mut Sources) -> Result<(LoadedCity, usize), Failure> {
    if !arguments.is_configured()
        && let Some(city) = collect::city_of_traces(&arguments.data, sources, &arguments.limits)?
    {
        return Ok((city, sources.ids().count()));
    }
    let config = arguments.config.as_deref().unwrap_or(Path::new(CONFIG));
    let city = load_city(sources, config, arguments.rules.as_deref(), &arguments.limits)?;
    Ok((city, 0))
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    // Without rules of its own, the configuration fits them, or is that of the traces.
    induce(arguments, sources).map_err(|failure| match (&arguments.config, &arguments.rules) {
        (None, Some(_)) => failure.advise(Some(&assumed(CONFIG))),
        _ => failure,
    })
}

fn induce(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let paths: Vec<&Path> = arguments.outputs().into_iter().map(|(_, path)| path).collect();
    refuse_mixing(arguments.outputs())?;
    if let Some(folder) = &arguments.popper.popper {
        return popper::run(arguments, folder, sources);
    }
    check(arguments)?;
    let (city, archived) = load(arguments, sources)?;
    let oracle = arguments.ask.load(sources, &city.scenario, &arguments.limits)?;
    let files = sources.ids().skip(archived).map(|id| sources.name(id).into());
    let inputs = Inputs::new(files).with(arguments.data.iter().chain(&arguments.test).cloned());
    // A file that cannot be written is reported before the work.
    let mut rules_out = arguments.force.create("induce", &arguments.output, &inputs)?;
    let report_out = (arguments.report.as_deref())
        .map(|path| arguments.force.create("induce", path, &inputs).map(|out| (out, path)))
        .transpose()?;
    let page_out = (arguments.page.as_deref())
        .map(|path| arguments.force.create("induce", path, &inputs).map(|out| (out, path)))
        .transpose()?;
    let session = match oracle {
        Some(oracle) => Some(arguments.ask.open(oracle, &inputs, &paths)?),
        None => None,
    };
    let rule_files = city.rule_files.clone();
    let mut origin = Origin::default();
    origin.lines.push(format!(
        "Rules learned by logicity {} from {}.",
        env!("CARGO_PKG_VERSION"),
        described(arguments, &city)
    ));
    if let Some(rules) = &arguments.rules {
        let name = files::portable_name(&rules.display().to_string());
        origin.lines.push(format!("The configuration has the rules in {name}."));
    }
    let settings = arguments.settings();
    let cancel = signals::cancel();
    let (task, collected, tests) = collect(arguments, city, sources, origin, &cancel)?;
    let Collected { examples, mut origin } = collected;
    if arguments.noise.is_none() {
        task.check(&examples, &origin)?;
    }
    origin.lines.push(task.describe(&settings));
    let names: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
    let (learned, examples, questions) = match session {
        None => (learn(&task, &examples, &settings, &cancel), examples, None),
        Some(session) => {
            let inquiry = Inquiry::new(examples, settings, arguments.seed);
            let asked = session.ask(&task, inquiry, sources, &cancel)?;
            asked.questions.name_answers(&asked.examples, &mut origin);
            origin.lines.extend(asked.questions.lines());
            (asked.learned, asked.examples, Some(asked.questions))
        }
    };
    // An interrupt keeps the rules so far, but a file without rules is no progress.
    if !learned.is_complete && questions.is_none() && learned.bodies().is_empty() {
        writeln!(
            terminal::err(),
            "interrupted before a clause was found; nothing is written"
        )?;
        return Err(Failure::Interrupted);
    }
    let support = support(&examples, &learned, &task.constraints());

    let text = rule_file(&task, &learned, &support, &origin, (sources, &rule_files));
    let path = &arguments.output;
    write!(rules_out, "{text}").map_err(|error| unwritable(path, &error))?;
    finish(rules_out, path)?;
    let measured = tests.map(|tests| Recalls::new(&tests.examples, &learned));
    if let Some((mut out, path)) = report_out {
        let mut json = report_json(&task, &learned, &support, &origin);
        if let Some(questions) = &questions {
            json["questions"] = questions.json();
        }
        if let Some(measured) = &measured {
            json["test"] = measured.json(&names);
        }
        writeln!(out, "{json:#}").map_err(|error| unwritable(path, &error))?;
        finish(out, path)?;
    }
    if let Some((mut out, page)) = page_out {
        let report = report_json(&task, &learned, &support, &origin);
        view::write_with(&arguments.data[0], (path, report), &mut out, page, &arguments.limits)?;
        finish(out, page)?;
    }
    let mut remarks = String::new();
    let lines = broken_constraints(&task, &support, &origin);
    (only_action(&task, &support).into_iter().chain(lines)).for_each(|line| remarks += &(line + "\n"));
    remarks.extend(measured.map(|it| it.text(&names)));
    print_summary(arguments, &learned, support.clauses.len(), &remarks, questions.as_ref())?;
    if let Some(questions) = questions {
        let ended = questions.check(&task, &examples, &origin);
        ended.map_err(|error| ask::failure(error, questions.asked()))?;
    }
    if learned.is_complete {
        Ok(())
    } else {
        Err(Failure::Interrupted)
    }
}

/// Prints what was written, the remarks, and the number of questions.
fn print_summary(
    arguments: &Arguments,
    learned: &LearnedRules,
    clauses: usize,
    remarks: &str,
    questions: Option<&Questions>,
) -> Result<(), Failure> {
    let paths: Vec<&Path> = arguments.outputs().into_iter().map(|(_, path)| path).collect();
    let mut out = messages(&paths);
    if !is_stdout(&arguments.output) {
        let whole = match learned.is_complete || questions.is_some() {
            true => "wrote",
            false => "interrupted: wrote the first",
        };
        writeln!(
            out,
            "{whole} {} to {}",
            counted(clauses, "clause"),
            arguments.output.display()
        )?;
    }
    print_others(&mut *out, &[arguments.report.as_deref(), arguments.page.as_deref()])?;
    write!(out, "{remarks}")?;
    for line in questions.iter().flat_map(|questions| questions.lines()) {
        writeln!(out, "{line}")?;
    }
    Ok(())
}

/// Returns the progress bar of a search over examples, here called `examples`.
fn search_bar(examples: &str) -> ProgressBar {
    let bar = ProgressBar::new(1);
    let template = format!("{{bar:30}} {{msg}} {{pos}} of {{len}} {examples}");
    bar.set_style(ProgressStyle::with_template(&template).expect("a valid template"));
    terminal::with_lines(bar, examples)
}

/// Shows the progress of a search.
fn show(bar: &ProgressBar, progress: Progress, action: &str) {
    bar.set_length(progress.states as u64);
    bar.set_position(progress.covered as u64);
    bar.set_message(format!("{action}{} clauses found,", progress.clauses));
}

/// Learns from examples alone.
fn learn(task: &InductionTask, examples: &Examples, settings: &Settings, cancel: &Cancel) -> LearnedRules {
    let bar = search_bar("states");
    let progress = |progress: Progress| show(&bar, progress, &format!("{}: ", task.actions()[progress.action].name()));
    let learned = learn_with(examples, settings, &progress, cancel);
    bar.finish_and_clear();
    learned
}

/// Reads the value of `--noise`.
fn noise(text: &str) -> Result<Noise, String> {
    if text == "auto" {
        return Ok(Noise::Auto);
    }
    let rate = text.parse().ok().filter(|rate| (0.0..=NOISE_MAX).contains(rate));
    rate.map(Noise::Rate)
        .ok_or_else(|| format!("expected `auto` or a number from 0 to {NOISE_MAX}"))
}

/// Returns the source of the examples in words.
fn described(arguments: &Arguments, city: &LoadedCity) -> String {
    if arguments.episodes == Some(0) {
        return format!("questions about scenes of {}", city.scenario.name);
    }
    if arguments.data.is_empty() {
        let episodes = match arguments.episodes {
            None => "the recorded episodes".to_owned(),
            Some(count) => counted(count, "recorded episode"),
        };
        return format!("{episodes} of {} ({})", city.scenario.name, arguments.split.name());
    }
    collect::short_names(&arguments.data).join(", ")
}
