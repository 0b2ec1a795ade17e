//! `logicity explain`: explains a decision in a trace.

use crate::cancel::Cancel;
use crate::city::Action;
use crate::city::Cell;
use crate::cli::failure::Failure;
use crate::cli::limits::LimitOptions;
use crate::cli::terminal;
use crate::cli::trace::TraceReader;
use crate::cli::values::integer;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{Diagnostic, SourceId, Sources, did_you_mean, listed};
use crate::sim::codes;
use crate::sim::{AskedFact, Decision, Driven, Replay, TraceTick, World};
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
    /// Name of the agent; unnecessary if FACT has values
    #[arg(long, required_unless_present_any = ["why", "why_not"])]
    agent: Option<String>,
    /// Explain why this fact holds, instead of why the agent acted as it did: the name of any predicate, about the
    /// agent, or a fact such as `IsClose(Car_1, Car_2)`; `_` matches any value
    #[arg(long, value_name = "FACT", conflicts_with = "why_not")]
    why: Option<String>,
    /// Explain why this fact does not hold, for example the action `Fast`
    #[arg(long, value_name = "FACT")]
    why_not: Option<String>,
    /// Print JSON with the keys `tick`, `agent`, `at`, `heading`, `derived`, `action` and `explanations`, plus `driven`
    /// for a controlled agent; for a fact that is not an action of the agent, with the keys `tick`, `fact`, `holds` and
    /// `nodes`
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
    let names: Vec<String> = trace.header.agents.iter().map(|agent| agent.id.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let position = match &arguments.agent {
        None => None,
        Some(agent) => Some(names.iter().position(|name| name == agent).ok_or_else(|| {
            let near = did_you_mean(agent, names.iter().copied());
            let help = near.map_or_else(
                || format!("the trace has {}", listed(&names)),
                |name| format!("did you mean `{name}`? The trace has {}", listed(&names)),
            );
            Failure::Usage(format!("the trace has no agent `{agent}`\nhelp: {help}"))
        })?),
    };
    let rules = arguments.rules.as_deref();
    let limits = trace.limits(rules, &arguments.limits);
    let mut replay = trace.replay(sources, arguments.config.as_deref(), rules, true, limits)?;
    let why_not = (arguments.why_not.as_ref())
        .filter(|_| position.is_some())
        .and_then(|name| replay.world().vocabulary.actions().find_ignoring_case(name));
    let fact = match (&arguments.why, &arguments.why_not) {
        (Some(fact), _) => Some(sources.add("--why", fact.as_str())),
        (None, Some(fact)) if why_not.is_none() => Some(sources.add("--why-not", fact.as_str())),
        _ => None,
    };
    let tick = find(&mut trace, arguments.tick)?;
    let set = replay.set(&tick).and_then(|()| replay.verify(&tick));
    set.map_err(|fault| trace.placed(fault))?;
    if let Some(question) = fact {
        return print_fact(arguments, &replay, (&tick, question), &names, sources);
    }
    let Some(position) = position else {
        return Err(Failure::Usage("name an agent with --agent".to_owned()));
    };

    print(arguments, &replay, &tick, (position, why_not), sources)
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

/// Prints why a fact holds or does not hold in a tick.
fn print_fact(
    arguments: &Arguments,
    replay: &Replay,
    (tick, question): (&TraceTick, SourceId),
    names: &[&str],
    sources: &Sources,
) -> Result<(), Failure> {
    let session = replay.session();
    let known = (&replay.world().scenario, session);
    let asked =
        AskedFact::read(sources, question, known, names, arguments.agent.as_deref()).map_err(Failure::option)?;
    let account = asked.explain(&mut Explainer::new(session)).map_err(Diagnostic::from)?;
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let mut line = account.json(session, sources);
        line["tick"] = json!(tick.tick);
        writeln!(out, "{line}")?;
    } else {
        write!(out, "tick {}: {}", tick.tick, account.text(session, sources))?;
    }
    Ok(())
}

fn print(
    arguments: &Arguments,
    replay: &Replay,
    tick: &TraceTick,
    (position, why_not): (usize, Option<Action>),
    sources: &Sources,
) -> Result<(), Failure> {
    let state = &tick.agents[position];
    let [row, col] = state.at;
    let decision = Decision {
        world: replay.world(),
        session: replay.session(),
        tick: tick.tick,
        agent: replay.agents()[position].id.clone(),
        kind: replay.kind_id(position),
        value: replay.value(position),
        at: Cell { row, col },
        heading: state.heading()?,
        derived: replay.derived(position),
        action: state.action(replay.world().vocabulary.actions())?,
    };
    let account = (decision.account(why_not, &Cancel::never())).map_err(Diagnostic::from)?;
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
        (clause.map(|clause| printer.label(clause))).ok_or_else(|| Diagnostic::new(codes::INVALID_TRACE, message()))
    };
    let broken: Vec<String> = driven.broken.iter().map(label).collect::<Result<_, _>>()?;
    let judgement = match broken.is_empty() {
        true => "its action violated no clause".to_owned(),
        false => format!("its action violated {}", broken.join(", ")),
    };
    Ok(format!(
        "controlled externally: given its observation of ({}), the rules wanted {}; {judgement}",
        driven.observes.join(", "),
        driven.wanted
    ))
}
