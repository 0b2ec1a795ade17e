//! `logicity explain`

use super::Failure;
use super::trace::TraceReader;
use super::why;
use crate::config::Speed;
use crate::diag::{Code, Diagnostic, Sources, did_you_mean};
use crate::engine::provenance::{Explainer, Explanation, Teller};
use crate::sim::{Replay, TraceTick};
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// A trace that `run` has written
    trace: PathBuf,
    /// Number of the tick; the last one unless given
    #[arg(long)]
    tick: Option<u64>,
    /// Name of the agent
    #[arg(long)]
    agent: String,
    /// Tell why this action was not derived instead of why the agent did what it did
    #[arg(long, value_name = "ACTION", value_parser = action)]
    why_not: Option<Speed>,
    /// Print JSON instead: `tick`, `agent`, `at`, `heading`, `derived`, `action`, `explanations`
    #[arg(long)]
    json: bool,
    /// Configuration of the run, if it is no longer where the trace says
    #[arg(long)]
    config: Option<PathBuf>,
    /// Rules of the run, if they are no longer where the trace says
    #[arg(long)]
    rules: Option<PathBuf>,
}

fn action(text: &str) -> Result<Speed, String> {
    let known = Speed::ALL.into_iter().find(|speed| speed.name() == text);
    known.ok_or_else(|| "expected Slow, Normal, Fast or Stop".to_owned())
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut trace = TraceReader::open(&arguments.trace)?;
    let names: Vec<&str> = trace.header.agents.iter().map(|agent| agent.id.as_str()).collect();
    let Some(position) = names.iter().position(|name| *name == arguments.agent) else {
        let near = did_you_mean(&arguments.agent, names.iter().copied());
        let help = near.map_or_else(
            || format!("it has: {}", names.join(", ")),
            |name| format!("did you mean `{name}`? It has: {}", names.join(", ")),
        );
        let message = format!("the trace has no agent `{}`\nhelp: {help}", arguments.agent);
        return Err(Failure::Usage(message));
    };
    let mut replay = trace.replay(sources, arguments.config.as_deref(), arguments.rules.as_deref(), true)?;
    let tick = find(&mut trace, arguments.tick)?;
    replay.set(&tick).map_err(|fault| trace.placed(fault))?;

    let derived = replay.derived(position);
    let Some(state) = tick.agents.get(position) else {
        return Err(trace.placed(Diagnostic::new(Code::InvalidTrace, "an agent is missing")));
    };
    if !derived.iter().map(|speed| speed.name()).eq(state.derived.iter()) {
        let found: Vec<&str> = derived.iter().map(|speed| speed.name()).collect();
        let message = format!(
            "the state of tick {} gives {} [{}], the trace has [{}]",
            tick.tick,
            arguments.agent,
            found.join(", "),
            state.derived.join(", ")
        );
        return Err(trace.placed(Diagnostic::new(Code::TraceMismatch, message)));
    }
    tell(arguments, &replay, &tick, position, sources)
}

/// The tick of that number, or the last one.
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

/// Why an action holds or does not.
fn ask(
    explainer: &mut Explainer<'_>,
    replay: &Replay,
    position: usize,
    action: Speed,
) -> Result<Option<Explanation>, Failure> {
    let Some(relation) = replay.world().vocabulary.action(action) else {
        return Ok(None);
    };
    let agent = replay.value(position);
    let (_, explanation) = why::explain(explainer, replay.session(), relation, &[Some(agent)])?;
    Ok(explanation)
}

fn tell(
    arguments: &Arguments,
    replay: &Replay,
    tick: &TraceTick,
    position: usize,
    sources: &Sources,
) -> Result<(), Failure> {
    let session = replay.session();
    let rules = session.program().rules();
    let state = &tick.agents[position];
    let derived = replay.derived(position);
    let vocabulary = &replay.world().vocabulary;

    // Which actions to speak of: the one asked for; else those derived, the one taken first; else, if none was derived, all.
    let taken = Speed::ALL.into_iter().find(|speed| speed.name() == state.action);
    let by_rules = vocabulary.decide(derived);
    let actions = match arguments.why_not {
        Some(action) => vec![action],
        None => vocabulary.telling(derived, |action| session.contains(action, &[replay.value(position)])),
    };

    let mut explainer = Explainer::new(session);
    let teller = Teller::new(rules, session.symbols(), sources);
    let mut explanations = Vec::new();
    for action in actions {
        explanations.push((action, ask(&mut explainer, replay, position, action)?));
    }

    let mut out = anstream::stdout();
    if arguments.json {
        let told: Vec<serde_json::Value> = (explanations.iter())
            .map(|(action, explanation)| {
                let mut entry = json!({ "action": action.name() });
                if let Some(explanation) = explanation {
                    entry["nodes"] = teller.json(explanation)["nodes"].take();
                }
                entry
            })
            .collect();
        let line = json!({
            "tick": tick.tick,
            "agent": arguments.agent,
            "at": state.at,
            "heading": state.heading,
            "derived": state.derived,
            "action": state.action,
            "explanations": told,
        });
        writeln!(out, "{line}")?;
        return Ok(());
    }
    let [row, col] = state.at;
    let heading = state.heading.as_ref().map(|heading| format!(", heading {heading}"));
    writeln!(
        out,
        "tick {}: {} at [{row}, {col}]{}: {}",
        tick.tick,
        arguments.agent,
        heading.unwrap_or_default(),
        state.action
    )?;
    if taken.is_some_and(|taken| taken != by_rules) {
        writeln!(out, "the action came from outside; the rules say {}", by_rules.name())?;
    } else if derived.len() > 1 {
        let names: Vec<&str> = derived.iter().map(|speed| speed.name()).collect();
        writeln!(
            out,
            "derived were {}; the first by the configured order was taken",
            names.join(", ")
        )?;
    } else if derived.is_empty() && explanations.len() > 1 {
        writeln!(out, "no action was derived, so the default was taken")?;
    }
    if let Some(action) = arguments.why_not.filter(|action| derived.contains(*action)) {
        writeln!(out, "{} was derived, and this is why", action.name())?;
    }
    for (action, explanation) in &explanations {
        match explanation {
            Some(explanation) => write!(out, "\n{}", teller.tree(explanation))?,
            None => writeln!(out, "\n{}: the rules do not mention it", action.name())?,
        }
    }
    Ok(())
}
