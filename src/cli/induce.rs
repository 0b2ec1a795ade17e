//! `logicity induce`: learns rules from examples.

use crate::builtin::BuiltinFiles;
use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::cli::trace::TraceReader;
use crate::cli::view;
use crate::cli::{
    Failure, ForceOption, Inputs, LimitOptions, cancel_on_interrupt, finish, integer, is_stdout, load_city, messages,
    one_of, open, unwritable,
};
use crate::diag::{Code, Diagnostic, Sources};
use crate::files::{self, Folder, MAX_BYTES};
use crate::induce::{Examples, Learned, Noise, Progress, Settings, VARIABLES_MAX, learn_with, support};
use crate::rng::Seed;
use crate::sim::{Executor, Inference, LoadedCity};
use crate::task::induction::{InductionTask, Origin, report_json, rule_file};
use crate::task::spf::{ControlMode, Env, EpisodeSet, SpfTask};
use crate::task::vap::Dataset;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{BufRead, BufReader, Read, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(clap::Args)]
pub struct Arguments {
    /// Examples: traces of `logicity run`, scenes with `actions` (one JSON object per line), or data sets of `logicity
    /// vap make` [default: the recorded episodes of the configuration, driven by its rules]
    data: Vec<PathBuf>,
    /// Configuration that defines the predicates. The learner does not read its clauses of actions
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's, for its declarations
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Recorded episodes to learn from
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "train", conflicts_with = "data")]
    split: Split,
    /// Number of recorded episodes, from the first on [default: all]
    #[arg(long, value_name = "COUNT", value_parser = integer(1..=1_000_000_usize), conflicts_with = "data")]
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
    #[arg(long, value_name = "ACTIONS", value_delimiter = ',', value_parser = one_of(&Action::ALL, Action::name))]
    order: Vec<Action>,
    /// The most variables of a clause
    #[arg(long, value_name = "COUNT", value_parser = integer(2..=VARIABLES_MAX),
        default_value_t = Settings::default().variables)]
    variables: usize,
    /// The most steps of the search for one clause
    #[arg(long, value_name = "COUNT", value_parser = integer(1..=u32::MAX), default_value_t = Settings::default().nodes)]
    effort: u32,
    /// Share of examples that may have a wrong action, from 0 to 0.5, or `auto` to estimate it. Without it, two examples
    /// with the same facts and different actions are an error
    #[arg(long, value_name = "RATE", value_parser = noise)]
    noise: Option<Noise>,
    /// Seed of the order in which the learner tries examples
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Number of threads; the rules do not depend on it [default: all cores]
    #[arg(long, value_name = "COUNT")]
    threads: Option<NonZeroUsize>,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut outputs = vec![("--output", arguments.output.as_path())];
    outputs.extend(arguments.report.as_deref().map(|path| ("--report", path)));
    outputs.extend(arguments.page.as_deref().map(|path| ("--page", path)));
    crate::cli::refuse_mixing(outputs)?;
    if arguments.page.is_some() && (arguments.data.len() != 1 || is_stdout(&arguments.output)) {
        let message = "--page needs one trace, as `logicity run` writes it, and --output with a file for the rules";
        return Err(Failure::Usage(message.to_owned()));
    }
    let city = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?;
    let inputs = Inputs::of(sources).with(arguments.data.iter().chain(&arguments.test).cloned());
    // A file that cannot be written is reported before the work.
    let mut rules_out = arguments.force.create(&arguments.output, &inputs)?;
    let report_out = (arguments.report.as_deref())
        .map(|path| arguments.force.create(path, &inputs).map(|out| (out, path)))
        .transpose()?;
    let page_out = (arguments.page.as_deref())
        .map(|path| arguments.force.create(path, &inputs).map(|out| (out, path)))
        .transpose()?;
    let rule_files = city.rule_files.clone();
    let mut origin = Origin::default();
    origin.lines.push(format!(
        "Rules learned by logicity {} from {}.",
        env!("CARGO_PKG_VERSION"),
        described(arguments, &city)
    ));
    let settings = Settings {
        variables: arguments.variables,
        nodes: arguments.effort,
        seed: arguments.seed,
        noise: arguments.noise.unwrap_or(Noise::None),
        threads: arguments.threads,
        ..Settings::default()
    };
    let cancel = cancel_on_interrupt()?;
    let Collected { task, examples, tests } = collect(arguments, city, sources, &mut origin, &cancel)?;
    if arguments.noise.is_none() {
        task.check(&examples, &origin)?;
    }
    origin.lines.push(task.describe(&settings));

    let bar = ProgressBar::new(1);
    let template = "{bar:30} {msg} {pos} of {len} states";
    bar.set_style(ProgressStyle::with_template(template).expect("a valid template"));
    let names: Vec<&str> = task.actions().iter().map(|action| action.name()).collect();
    let progress = |progress: Progress| {
        bar.set_length(progress.states as u64);
        bar.set_position(progress.covered as u64);
        bar.set_message(format!(
            "{}: {} clauses found,",
            names[progress.action], progress.clauses
        ));
    };
    let learned = learn_with(&examples, &settings, &progress, &cancel);
    let support = support(&examples, &learned);
    bar.finish_and_clear();

    let text = rule_file(&task, &learned, &support, &origin, (sources, &rule_files));
    let path = &arguments.output;
    write!(rules_out, "{text}").map_err(|error| unwritable(path, &error))?;
    finish(rules_out, path)?;
    let measured = (!arguments.test.is_empty()).then(|| Recalls::new(&tests, &learned));
    if let Some((mut out, path)) = report_out {
        let mut json = report_json(&task, &learned, &support, &origin);
        if let Some(measured) = &measured {
            json["test"] = measured.json(&names);
        }
        writeln!(out, "{json:#}").map_err(|error| unwritable(path, &error))?;
        finish(out, path)?;
    }
    if let Some((mut out, page)) = page_out {
        view::write_with(&arguments.data[0], path, &mut out, page, &arguments.limits)?;
        finish(out, page)?;
    }
    let mut written = vec![path.as_path()];
    written.extend(arguments.report.as_deref());
    written.extend(arguments.page.as_deref());
    if !is_stdout(path) {
        let mut out = messages(&written);
        let clauses = support.clauses.len();
        writeln!(out, "wrote {clauses} clauses to {}", path.display())?;
    }
    if let Some(measured) = measured {
        write!(messages(&written), "{}", measured.text(&names))?;
    }
    if learned.is_complete {
        Ok(())
    } else {
        Err(Failure::Interrupted)
    }
}

fn noise(text: &str) -> Result<Noise, String> {
    let rate = text.parse().ok().filter(|rate| (0.0..=0.5).contains(rate));
    match (text, rate) {
        ("auto", _) => Ok(Noise::Auto),
        (_, Some(rate)) => Ok(Noise::Rate(rate)),
        _ => Err("expected `auto` or a number from 0 to 0.5".to_owned()),
    }
}

/// Returns the source of the examples in words.
fn described(arguments: &Arguments, city: &LoadedCity) -> String {
    if arguments.data.is_empty() {
        let count = arguments.episodes.map_or("the".to_owned(), |count| format!("{count}"));
        return format!(
            "{count} recorded episodes of {} ({})",
            city.scenario.name,
            arguments.split.name()
        );
    }
    let names: Vec<String> = arguments
        .data
        .iter()
        .map(|path| files::portable_name(&path.display().to_string()))
        .collect();
    names.join(", ")
}

/// The examples of a task.
struct Collected {
    task: InductionTask,
    examples: Examples,
    /// Those to measure the rules on.
    tests: Examples,
}

/// Collects the examples of all sources.
fn collect(
    arguments: &Arguments,
    city: LoadedCity,
    sources: &mut Sources,
    origin: &mut Origin,
    cancel: &Cancel,
) -> Result<Collected, Failure> {
    let mut scenes = match arguments.data.is_empty() && arguments.test.is_empty() {
        true => None,
        false => Some(Inference::new(
            city.scenario.clone(),
            city.program.clone(),
            Seed(arguments.seed),
            Executor::Relational,
            BuiltinFiles,
        )?),
    };
    let world = Arc::new(city.world()?);
    let task = InductionTask::new(world.clone(), &arguments.order);
    let mut examples = task.examples();
    let mut tests = task.examples();
    for path in &arguments.test {
        let scenes = scenes.as_mut().expect("made for files");
        add_file(
            (&task, &arguments.limits),
            scenes,
            path,
            &mut tests,
            &mut Origin::default(),
            cancel,
        )?;
    }
    for path in &arguments.data {
        let scenes = scenes.as_mut().expect("made for files");
        add_file((&task, &arguments.limits), scenes, path, &mut examples, origin, cancel)?;
    }
    for (paths, found) in [(&arguments.data, &examples), (&arguments.test, &tests)] {
        if !paths.is_empty() && found.count() == 0 {
            let names: Vec<String> = paths.iter().map(|path| format!("`{}`", path.display())).collect();
            let message = format!("no examples in {}", names.join(", "));
            return Err(Diagnostic::new(Code::INVALID_SCENE, message).into());
        }
    }
    if !arguments.data.is_empty() {
        return Ok(Collected { task, examples, tests });
    }
    let path_task = Arc::new(SpfTask::new(world, sources)?);
    let set = EpisodeSet::load(&path_task, arguments.split, sources, &BuiltinFiles)?;
    let available = set.episodes.len();
    let wanted = arguments.episodes.unwrap_or(available);
    if wanted > available {
        return Err(Failure::Usage(format!(
            "--episodes {wanted}: the configuration has {available} recorded episodes"
        )));
    }
    let mut env = Env::new_with(path_task, arguments.split, ControlMode::First, cancel)?;
    for (number, episode) in set.episodes.iter().take(wanted).enumerate() {
        origin.push_episode(examples.count(), format!("episode {number}"));
        task.add_episode(&mut env, episode, &mut examples)?;
    }
    origin.lines.push(format!("Episodes {}.", set.hash()));
    Ok(Collected { task, examples, tests })
}

/// Adds the examples of a file: a trace or labeled scenes.
fn add_file(
    (task, limits): (&InductionTask, &LimitOptions),
    scenes: &mut Inference,
    path: &Path,
    examples: &mut Examples,
    origin: &mut Origin,
    cancel: &Cancel,
) -> Result<(), Failure> {
    let name = files::portable_name(&path.display().to_string());
    if path.is_dir() {
        return add_data_set(task, path, &name, examples, origin, cancel);
    }
    let mut lines = BufReader::new(open(path)?);
    let mut first = Vec::new();
    let unreadable = |error| Failure::file("read", path, error);
    lines
        .by_ref()
        .take(MAX_BYTES)
        .read_until(b'\n', &mut first)
        .map_err(unreadable)?;
    let is_trace =
        serde_json::from_slice::<serde_json::Value>(&first).is_ok_and(|header| header.get("trace").is_some());
    drop(lines);
    if is_trace {
        add_trace(task, limits, path, &name, examples, origin, cancel)
    } else {
        add_scenes(task, scenes, path, &name, examples, origin, cancel)
    }
}

/// Adds the labeled cars of a data set of Visual Action Prediction.
fn add_data_set(
    task: &InductionTask,
    path: &Path,
    name: &str,
    examples: &mut Examples,
    origin: &mut Origin,
    cancel: &Cancel,
) -> Result<(), Failure> {
    let data = Dataset::open(Folder::new(path))?;
    let vocabulary = &task.world().vocabulary;
    let translator = task.translator(vocabulary)?;
    for world in &data.manifest().worlds {
        for sample in data.samples(vocabulary, world)? {
            if cancel.requested() {
                return Err(Failure::Interrupted);
            }
            for (car, label) in sample.labels.iter().enumerate() {
                let Some(action) = label else { continue };
                let place = format!(
                    "{name}, world {}, tick {}, {}",
                    world.world, sample.tick, sample.names[car]
                );
                origin.push(examples.count(), place);
                examples.push(translator.state(&sample.facts, car)?, task.action(*action)?);
            }
        }
    }
    Ok(())
}

/// Adds every decision of every agent in a trace.
fn add_trace(
    task: &InductionTask,
    limits: &LimitOptions,
    path: &Path,
    name: &str,
    examples: &mut Examples,
    origin: &mut Origin,
    cancel: &Cancel,
) -> Result<(), Failure> {
    let mut trace = TraceReader::open(path)?;
    let limits = trace.limits(None, limits);
    let mut replay = trace.replay(&mut Sources::new(), None, None, false, limits)?;
    let vocabulary = replay.world().vocabulary.clone();
    let translator = task.translator(&vocabulary).map_err(|fault| trace.placed(fault))?;
    while let Some(tick) = trace.tick()? {
        if cancel.requested() {
            return Err(Failure::Interrupted);
        }
        replay.set(&tick).map_err(|fault| trace.placed(fault))?;
        for (agent, state) in tick.agents.iter().enumerate() {
            let action = state.action().and_then(|action| task.action(action));
            let action = action.map_err(|fault| trace.placed(fault))?;
            let state = translator
                .state(replay.facts(), agent)
                .map_err(|fault| trace.placed(fault))?;
            origin.push(
                examples.count(),
                format!("{name}, {} in tick {}", replay.agents()[agent].id, tick.tick),
            );
            examples.push(state, action);
        }
    }
    Ok(())
}

/// Adds the labeled egos of scenes, one scene per line.
fn add_scenes(
    task: &InductionTask,
    inference: &mut Inference,
    path: &Path,
    name: &str,
    examples: &mut Examples,
    origin: &mut Origin,
    cancel: &Cancel,
) -> Result<(), Failure> {
    let vocabulary = inference.vocabulary().clone();
    let translator = task.translator(&vocabulary)?;
    let mut lines = BufReader::new(open(path)?);
    for number in 1.. {
        if cancel.requested() {
            return Err(Failure::Interrupted);
        }
        let mut bytes = Vec::new();
        let read = lines.by_ref().take(MAX_BYTES).read_until(b'\n', &mut bytes);
        if read.map_err(|error| Failure::file("read", path, error))? == 0 {
            break;
        }
        let text = String::from_utf8(bytes).map_err(|_| {
            Diagnostic::new(
                Code::NOT_TEXT,
                format!("line {number} of `{}` is not UTF-8 text", path.display()),
            )
        })?;
        if text.trim().is_empty() {
            continue;
        }
        let mut sources = Sources::new();
        let source = sources.add_from(path.display().to_string(), text.trim_end(), number);
        let scene = inference
            .ground(&sources, source)
            .map_err(|faults| reported(&faults, &sources))?;
        if scene.actions.is_empty() {
            let message = format!("the scene in line {number} of `{}` has no actions", path.display());
            return Err(Diagnostic::new(Code::INVALID_SCENE, message)
                .help("add the action that each ego took, for example \"actions\": {\"Car_1\": \"Stop\"}")
                .into());
        }
        for (ego, action) in scene.actions {
            let state = translator.state(&scene.facts, ego)?;
            origin.push(examples.count(), format!("{name}, line {number}, {}", scene.names[ego]));
            examples.push(state, task.action(action)?);
        }
    }
    Ok(())
}

/// Prints diagnostics of a source that only this function knows.
fn reported(faults: &[Diagnostic], sources: &Sources) -> Failure {
    crate::cli::report(faults, sources);
    Failure::Reported
}

/// The examples in which rules choose the right action.
struct Recalls {
    /// By action, the number of examples and of right choices.
    actions: Vec<[u64; 2]>,
}

impl Recalls {
    fn new(examples: &Examples, learned: &Learned) -> Recalls {
        let states: Vec<_> = examples.states().map(|(state, _)| state).collect();
        let chosen = learned.decide(examples.vocabulary(), &states);
        let mut actions = vec![[0; 2]; examples.actions().len()];
        for ((_, tallies), chosen) in examples.states().zip(chosen) {
            for (action, (tally, counts)) in tallies.iter().zip(&mut actions).enumerate() {
                counts[0] += u64::from(tally.count);
                counts[1] += if action == chosen { u64::from(tally.count) } else { 0 };
            }
        }
        Recalls { actions }
    }

    /// Returns the recalls of the actions that occur, with their positions.
    fn recalls(&self) -> impl Iterator<Item = (usize, f64)> {
        let occur = self.actions.iter().enumerate().filter(|(_, [count, _])| *count > 0);
        #[allow(clippy::cast_precision_loss)] // rates
        occur.map(|(action, [count, right])| (action, *right as f64 / *count as f64))
    }

    /// Returns the accuracy and the weighted accuracy, in which an action with n examples has the weight 1/n.
    #[allow(clippy::cast_precision_loss)] // rates
    fn accuracies(&self) -> [f64; 2] {
        let sum = |at: usize| self.actions.iter().map(|counts| counts[at]).sum::<u64>() as f64;
        let weight = |action: usize| 1.0 / self.actions[action][0] as f64;
        let weights: f64 = self.recalls().map(|(action, _)| weight(action)).sum();
        let weighted: f64 = self.recalls().map(|(action, recall)| recall * weight(action)).sum();
        [sum(1) / sum(0), weighted / weights]
    }

    fn text(&self, names: &[&str]) -> String {
        let [accuracy, weighted] = self.accuracies();
        let count: u64 = self.actions.iter().map(|[count, _]| count).sum();
        let mut text = format!("test: {count} examples, accuracy {accuracy:.4}, wAcc {weighted:.4}; recall");
        for (index, (action, recall)) in self.recalls().enumerate() {
            let comma = if index > 0 { "," } else { "" };
            text += &format!("{comma} {} {recall:.4}", names[action]);
        }
        text + "\n"
    }

    fn json(&self, names: &[&str]) -> serde_json::Value {
        let [accuracy, weighted] = self.accuracies();
        let recalls: serde_json::Map<String, serde_json::Value> = self
            .recalls()
            .map(|(action, recall)| (names[action].to_owned(), recall.into()))
            .collect();
        serde_json::json!({ "accuracy": accuracy, "weighted_accuracy": weighted, "recall": recalls })
    }
}
