//! `logicity pddl`: writes the task of an ego as a planning problem, and drives plans.

use crate::builtin::BuiltinFiles;
use crate::city::Split;
use crate::cli::failure::Failure;
use crate::cli::inputs::{Inputs, read};
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, refuse_stdout_as_folder, unwritable};
use crate::cli::terminal;
use crate::cli::values::{integer, one_of};
use crate::diag::{Diagnostic, Sources, counted};
use crate::files::{Output, make_folder};
use crate::task::spf::codes;
use crate::task::spf::pddl::{Encoding, PddlOptions, encode, read_plan, replay};
use crate::task::spf::{ControlMode, Env, EpisodeSet, SpfTask};
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The names of the two files.
const FILES: [&str; 2] = ["domain.pddl", "problem.pddl"];

#[derive(clap::Args)]
pub struct Arguments {
    /// Configuration with a task
    #[arg(default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Agent set of the configuration
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// Recorded episode, by its number from 0
    #[arg(long, value_parser = integer(0..=usize::MAX), default_value_t = 0)]
    episode: usize,
    /// Number of steps that the rules drive the ego before the plan
    #[arg(long, value_name = "STEPS", value_parser = integer(0..=100_000_u32), default_value_t = 0)]
    start: u32,
    /// Maximum number of steps of a plan [default: those that the rules take to the goal; at most 5 for `multi-agent`]
    #[arg(long, value_name = "STEPS", value_parser = integer(1..=100_000_u32))]
    horizon: Option<u32>,
    /// What drives the other agents: their course under the rules, with axioms (`one-agent`) or facts (`strips`) for
    /// what the ego may do, or axioms for their decisions (`multi-agent`)
    #[arg(long, value_parser = one_of(&Encoding::ALL, |encoding: Encoding| encoding.name()), default_value = "one-agent")]
    encoding: Encoding,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Folder for domain.pddl and problem.pddl; created if missing
    #[arg(short, long, value_name = "DIR", required_unless_present = "replay")]
    out: Option<PathBuf>,
    /// Drive the plan in FILE in the city instead, and print what happens
    #[arg(long, value_name = "FILE", conflicts_with_all = ["out", "horizon", "encoding"])]
    replay: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

/// Writes a problem, or drives a plan.
pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let world = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?
    .world()?;
    let task = Arc::new(SpfTask::new(Arc::new(world), sources)?);
    let set = EpisodeSet::load(&task, arguments.split, sources, &BuiltinFiles)?;
    let count = set.episodes.len();
    let episode = set.episodes.get(arguments.episode).ok_or_else(|| {
        Failure::Usage(format!(
            "no episode {}: the split `{}` has {}, from 0",
            arguments.episode,
            arguments.split.name(),
            counted(count, "episode")
        ))
    })?;
    let mut env = Env::new(task, arguments.split, ControlMode::First)?;
    env.reset_to(episode)?;
    match (&arguments.replay, &arguments.out) {
        (Some(plan), _) => drive(arguments, plan, &mut env, sources),
        (None, Some(folder)) => write(arguments, folder, &mut env, sources),
        (None, None) => unreachable!("one of the options is required"),
    }
}

fn write(arguments: &Arguments, folder: &Path, env: &mut Env, sources: &Sources) -> Result<(), Failure> {
    refuse_stdout_as_folder(folder)?;
    let options = PddlOptions {
        encoding: arguments.encoding,
        start: arguments.start,
        horizon: arguments.horizon,
    };
    let task = encode(env, &options)?;
    make_folder(folder)?;
    let paths = FILES.map(|name| folder.join(name));
    let named: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    let mut outputs = arguments.force.create_all("pddl", &named, &Inputs::of(sources))?;
    for ((output, path), text) in outputs.iter_mut().zip(&named).zip([&task.domain, &task.problem]) {
        output
            .write_all(text.as_bytes())
            .map_err(|error| unwritable(path, &error))?;
    }
    Output::finish_all(outputs).map_err(|(position, error)| unwritable(named[position], &error))?;
    let has_plan = task.cheapest.is_some() || arguments.encoding == Encoding::MultiAgent;
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let files = paths.map(|path| path.display().to_string());
        let all = json!({
            "files": files, "encoding": arguments.encoding.name(), "start": arguments.start, "horizon": task.horizon,
            "reaches_goal": task.reaches_goal, "cost_per_return": task.costs.per_return, "cheapest": task.cheapest,
        });
        writeln!(out, "{all}")?;
        return Ok(());
    }
    let target = if task.reaches_goal {
        "the goal"
    } else {
        "where the rules come"
    };
    writeln!(
        out,
        "wrote {} and {}: at most {} to {target}",
        paths[0].display(),
        paths[1].display(),
        counted(task.horizon as usize, "step")
    )?;
    if !has_plan {
        writeln!(
            out,
            "there is no plan: every way breaks a rule or changes what the others do"
        )?;
    }
    Ok(())
}

fn drive(arguments: &Arguments, path: &Path, env: &mut Env, sources: &mut Sources) -> Result<(), Failure> {
    let text = read(path)?;
    let source = sources.add(path.display().to_string(), text);
    let plan = read_plan(env, source, sources)?;
    let done = replay(env, arguments.start, &plan)?;
    let task = Arc::clone(env.task());
    let table = task.world().vocabulary.actions();
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let steps: Vec<_> = (done.steps.iter())
            .map(|(action, wanted, broken)| {
                json!({"action": table.name(*action), "rules": table.name(*wanted), "violations": broken})
            })
            .collect();
        let all = json!({"steps": steps, "return": done.total, "cost": done.cost, "success": done.success});
        writeln!(out, "{all}")?;
    } else {
        for (step, (action, wanted, broken)) in (arguments.start..).zip(&done.steps) {
            let violated = match broken.is_empty() {
                true => String::new(),
                false => format!("  violates {}", broken.join(", ")),
            };
            writeln!(
                out,
                "{step:>5}  {:8} the rules want {}{violated}",
                table.name(*action),
                table.name(*wanted)
            )?;
        }
        let reached = if done.success { "at the goal" } else { "not at the goal" };
        writeln!(
            out,
            "{}, cost {}, return {}, {reached}",
            counted(done.steps.len(), "step"),
            done.cost,
            done.total
        )?;
    }
    let broken: Vec<(usize, &String)> = (done.steps.iter().enumerate())
        .flat_map(|(step, (_, _, broken))| broken.iter().map(move |label| (step, label)))
        .collect();
    match broken.first() {
        None => Ok(()),
        Some((step, label)) => {
            let fault = Diagnostic::new(codes::INVALID_PLAN, format!("the plan violates {label}"));
            Err(fault.at(plan[*step].span, "by this action").into())
        }
    }
}
