//! `logicity explain`: explains a decision in a trace.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::city::Cell;
use crate::cli::trace::TraceReader;
use crate::cli::{Failure, LimitOptions, integer, one_of, terminal};
use crate::datalog::explain::ExplanationPrinter;
use crate::diag::{Code, Diagnostic, Sources, did_you_mean};
use crate::sim::{Decision, Driven, Replay, TraceTick, World};
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Trace written by `logicity run`
    trace: PathBuf,
    /// Number of the tick [default: the last tick]
    #[arg(long, value_parser = integer(0..=u64::MAX))]
    tick: Option<u64>,
    /// Name of the agent
    #[arg(long)]
    agent: String,
    /// Explain why this action was not derived, instead of why the agent acted as it did
    #[arg(long, value_name = "ACTION", value_parser = one_of(&Action::ALL, Action::name))]
    why_not: Option<Action>,
    /// Print JSON with the keys `tick`, `agent`, `at`, `heading`, `derived`, `action` and `explanations`, plus `driven`
    /// for a controlled agent
    #[arg(long)]
    json: bool,
    /// Configuration to use instead of the one in the trace; must have the same content
    #[arg(long)]
    config: Option<PathBuf>,
    /// Rules to use instead of those in the trace; must have the same content
    #[arg(long)]
    rules: Option<PathBuf>,
    #[command(flatten)]
    limits: LimitOptions,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut trace = TraceReader::open(&arguments.trace)?;
    let names: Vec<&str> = trace.header.agents.iter().map(|agent| agent.id.as_str()).collect();
    let Some(position) = names.iter().position(|name| *name == arguments.agent) else {
        let near = did_you_mean(&arguments.agent, names.iter().copied());
        let help = near.map_or_else(
            || format!("the trace has: {}", names.join(", ")),
            |name| format!("did you mean `{name}`? The trace has: {}", names.join(", ")),
        );
        let message = format!("the trace has no agent `{}`\nhelp: {help}", arguments.agent);
        return Err(Failure::Usage(message));
    };
    let rules = arguments.rules.as_deref();
    let limits = trace.limits(rules, &arguments.limits);
    let mut replay = trace.replay(sources, arguments.config.as_deref(), rules, true, limits)?;
    let tick = find(&mut trace, arguments.tick)?;
    replay.set(&tick).map_err(|fault| trace.placed(fault))?;

    let derived = replay.derived(position);
    let Some(state) = tick.agents.get(position) else {
        return Err(trace.placed(Diagnostic::new(Code::INVALID_TRACE, "an agent is missing")));
    };
    if !derived.iter().map(|action| action.name()).eq(state.derived.iter()) {
        let found: Vec<&str> = derived.iter().map(|action| action.name()).collect();
        let message = format!(
            "the state of tick {} gives {} [{}], but the trace has [{}]",
            tick.tick,
            arguments.agent,
            found.join(", "),
            state.derived.join(", ")
        );
        return Err(trace.placed(Diagnostic::new(Code::TRACE_MISMATCH, message)));
    }
    print(arguments, &replay, &tick, position, sources)
}

/// Returns the tick with this number, or the last tick.
fn find(trace: &mut TraceReader, number: Option<u64>) -> Result<TraceTick, Failure> {
    let mut ends: Option<(u64, u64)> = None;
    let mut last = None;
    while let Some(tick) = trace.tick()? {
        if number == Some(tick.tick) {
            return Ok(tick);
        }
        ends = Some((ends.map_or(tick.tick, |(first, _)| first), tick.tick));
        last = Some(tick);
    }
    match (number, last, ends) {
        (None, Some(last), _) => Ok(last),
        (Some(number), _, Some((first, last))) => Err(Failure::Usage(format!(
            "the trace has no tick {number}\nhelp: it has the ticks {first} to {last}"
        ))),
        _ => Err(Failure::Usage("the trace has no ticks".to_owned())),
    }
}

fn print(
    arguments: &Arguments,
    replay: &Replay,
    tick: &TraceTick,
    position: usize,
    sources: &Sources,
) -> Result<(), Failure> {
    let state = &tick.agents[position];
    let [row, col] = state.at;
    let decision = Decision {
        world: replay.world(),
        session: replay.session(),
        tick: tick.tick,
        agent: arguments.agent.clone(),
        value: replay.value(position),
        at: Cell { row, col },
        heading: state.heading()?,
        derived: replay.derived(position),
        action: state.action()?,
    };
    let account = (decision.account(arguments.why_not, &Cancel::never())).map_err(Diagnostic::from)?;
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let mut line = account.json(sources);
        if let Some(driven) = &state.driven {
            line["driven"] = json!(driven);
        }
        writeln!(out, "{line}")?;
    } else {
        if let Some(driven) = &state.driven {
            writeln!(out, "{}", steering(driven, replay.world(), sources)?)?;
        }
        write!(out, "{}", account.text(sources))?;
    }
    Ok(())
}

/// Describes what a controlled agent observed, and which clauses its action violated.
fn steering(driven: &Driven, world: &World, sources: &Sources) -> Result<String, Diagnostic> {
    let rules = world.program.rules();
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let label = |&broken: &usize| {
        let message = || format!("clause {broken} does not exist");
        let clause = world.clauses().nth(broken);
        (clause.map(|clause| printer.label(clause))).ok_or_else(|| Diagnostic::new(Code::INVALID_TRACE, message()))
    };
    let broken: Vec<String> = driven.broken.iter().map(label).collect::<Result<_, _>>()?;
    let judgement = match broken.is_empty() {
        true => "its action violated no clause".to_owned(),
        false => format!("its action violated {}", broken.join(", ")),
    };
    Ok(format!(
        "controlled externally: given its observation of ({}), the rules wanted {}; {judgement}",
        driven.observes.join(", "),
        driven.wanted()?.name()
    ))
}
