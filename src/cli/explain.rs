//! `logicity explain`: explains a decision in a trace, or lists the firings of a clause.

use crate::cancel::Cancel;
use crate::city::{Action, Cell, Effect};
use crate::cli::failure::Failure;
use crate::cli::limits::LimitOptions;
use crate::cli::terminal;
use crate::cli::trace::TraceReader;
use crate::cli::values::integer;
use crate::datalog::ClauseId;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::diag::{Diagnostic, SourceId, Sources, counted, did_you_mean, listed};
use crate::sim::codes;
use crate::sim::{AskedFact, AskedTemporal, Decision, Driven, Firings, Replay, TraceTick, World};
use serde_json::json;
use std::collections::BTreeSet;
use std::fmt;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Trace written by `logicity run`
    trace: PathBuf,
    /// Number of the tick [default: the last tick; with --clause all ticks]
    #[arg(long, value_parser = integer(0..=u64::MAX))]
    tick: Option<u64>,
    /// Name of the agent; unnecessary if FACT has values; with --clause, lists only rows that contain it
    #[arg(long)]
    agent: Option<String>,
    /// Explain why this fact holds, instead of why the agent acted as it did: the name of any predicate, about the
    /// agent, or a fact such as `IsClose(Car_1, Car_2)`; `_` matches any value. A temporal operator asks about earlier
    /// ticks: `once[0,5] IsAtInter(Car_1)`
    #[arg(long, value_name = "FACT", conflicts_with = "why_not")]
    why: Option<String>,
    /// Explain why this fact does not hold, for example the action `Fast`
    #[arg(long, value_name = "FACT")]
    why_not: Option<String>,
    /// List the rows that a clause derived, each with its ticks: the clause by the start of its doc comment up to the
    /// colon (`S1`), or by its file and line (`my.dl:7`)
    #[arg(long, value_name = "CLAUSE", conflicts_with_all = ["why", "why_not"])]
    clause: Option<String>,
    /// Print JSON with the keys `tick`, `agent`, `at`, `heading`, `derived`, `action` and `explanations`, plus `driven`
    /// for a controlled agent, and `parked_since` and `parked` for one that stands parked; for a fact that is not an
    /// action of the agent, with the keys `tick`, `fact`, `holds` and `nodes`, plus `base` for a base fact; for a
    /// temporal literal with `because` and `witness` instead of `nodes`; for a clause with the keys `ticks`, the number
    /// of ticks searched, and `clauses`: each with `clause`, `fired`, `ticks` and `rows`, the facts with the first and
    /// last ticks of the runs of successive ticks
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
    if let Some(asked) = &arguments.clause {
        return print_firings(arguments, (trace, &mut replay), (asked, position), sources);
    }
    let why_not = (arguments.why_not.as_ref())
        .filter(|_| position.is_some())
        .and_then(|name| replay.world().vocabulary.actions().find_ignoring_case(name));
    let fact = match (&arguments.why, &arguments.why_not) {
        (Some(fact), _) => Some(sources.add("--why", fact.as_str())),
        (None, Some(fact)) if why_not.is_none() => Some(sources.add("--why-not", fact.as_str())),
        _ => None,
    };
    let tick = find(&mut trace, arguments.tick)?;
    load(&mut replay, &tick, &trace)?;
    if let Some(question) = fact {
        let known = (&replay.world().scenario, replay.session());
        let ego = arguments.agent.as_deref();
        let temporal = AskedTemporal::read(sources, question, known, &names, ego).map_err(Failure::option)?;
        return match temporal {
            Some(asked) => print_temporal(arguments, &mut replay, (&tick, &asked), sources),
            None => print_fact(arguments, &replay, (&tick, question), &names, sources),
        };
    }
    let Some(position) = position else {
        let help = "or ask about a fact with `--why` or `--why-not`, or about a clause with `--clause`";
        let known = listed(&names);
        return Err(Failure::Usage(format!(
            "name an agent with `--agent`: the trace has {known}\nhelp: {help}"
        )));
    };

    let since = match why_not {
        None => parked_since(arguments, replay.world(), (&tick, position))?,
        Some(_) => None,
    };
    let mut out = terminal::results(arguments.json);
    let mut account = account(arguments, &replay, (&tick, since), (position, why_not), sources)?;
    let Some(since) = since else {
        write!(out, "{account}")?;
        return Ok(());
    };
    // The tick of the decision explains why the agent stands.
    let mut trace = TraceReader::open(&arguments.trace)?;
    let parking = find(&mut trace, Some(since))?;
    load(&mut replay, &parking, &trace)?;
    let before = self::account(arguments, &replay, (&parking, None), (position, None), sources)?;
    match (&mut account, before) {
        (Shown::Json(line), Shown::Json(before)) => line["parked"] = before,
        (Shown::Text(text), Shown::Text(before)) => *text += &format!("\n{before}"),
        _ => unreachable!("both have the form that the user chose"),
    }
    write!(out, "{account}")?;
    Ok(())
}

/// Prints the rows that the clauses of a label or place derived, with their ticks.
fn print_firings(
    arguments: &Arguments,
    (mut trace, replay): (TraceReader, &mut Replay),
    (asked, position): (&str, Option<usize>),
    sources: &Sources,
) -> Result<(), Failure> {
    let program = replay.session().program().clone();
    let rules = program.rules();
    let labels = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let clauses: Vec<ClauseId> = replay.world().clauses().collect();
    let is_asked = |clause: &ClauseId| labels.label(*clause) == asked || labels.place(*clause) == asked;
    let mut found: Vec<Firings> = clauses.iter().copied().filter(is_asked).map(Firings::new).collect();
    if found.is_empty() {
        let known: Vec<String> = clauses.iter().map(|&clause| labels.label(clause)).collect();
        let known: Vec<&str> = known.iter().map(String::as_str).collect();
        let help = match (did_you_mean(asked, known.iter().copied()), known.is_empty()) {
            (Some(near), _) => format!("did you mean `{near}`? The rules have {}", listed(&known)),
            (None, false) => format!("the rules have {}", listed(&known)),
            (None, true) => "the rules have no clauses".to_owned(),
        };
        return Err(Failure::Usage(format!("no clause is called `{asked}`\nhelp: {help}")));
    }
    let agent = position.map(|position| replay.value(position));
    let mut searched = BTreeSet::new();
    let mut add = |tick: &TraceTick, trace: &TraceReader| -> Result<(), Failure> {
        load(replay, tick, trace)?;
        searched.insert(tick.tick);
        for firings in &mut found {
            firings.add(replay.session(), tick.tick, |row| {
                agent.is_none_or(|agent| row.contains(&agent))
            });
        }
        Ok(())
    };
    if let Some(number) = arguments.tick {
        let tick = find(&mut trace, Some(number))?;
        add(&tick, &trace)?;
    } else {
        while let Some(tick) = trace.tick()? {
            add(&tick, &trace)?;
        }
    }
    let printer = ExplanationPrinter::new(rules, replay.session().symbols(), sources).quoting();
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let clauses: Vec<serde_json::Value> = found.iter().map(|firings| firings_json(firings, &printer)).collect();
        writeln!(out, "{}", json!({ "ticks": searched.len(), "clauses": clauses }))?;
        return Ok(());
    }
    for (at, firings) in found.iter().enumerate() {
        let ticks = match arguments.tick {
            Some(number) => format!("in tick {number}"),
            None => format!("in {} of {}", firings.ticks(), counted(searched.len(), "tick")),
        };
        if at > 0 {
            writeln!(out)?;
        }
        writeln!(out, "{}", printer.title(firings.clause))?;
        writeln!(out, "fired {} {ticks}", counted(firings.count(), "time"))?;
        let rows = firings.rows.iter();
        let lines: Vec<(String, String)> = rows
            .map(|(row, runs)| (printer.head(firings.clause, row), listed_runs(runs)))
            .collect();
        let width = lines.iter().map(|(fact, _)| fact.chars().count()).max().unwrap_or(0);
        for (fact, runs) in lines {
            match arguments.tick {
                Some(_) => writeln!(out, "  {fact}")?,
                None => writeln!(out, "  {fact:<width$}  ticks {runs}")?,
            }
        }
    }
    Ok(())
}

/// Writes runs of ticks as `3 to 5, 9`.
fn listed_runs(runs: &[(u64, u64)]) -> String {
    let runs: Vec<String> = (runs.iter())
        .map(|(first, last)| match first == last {
            true => first.to_string(),
            false => format!("{first} to {last}"),
        })
        .collect();
    runs.join(", ")
}

fn firings_json(firings: &Firings, printer: &ExplanationPrinter<'_>) -> serde_json::Value {
    let rows = firings.rows.iter();
    let rows: Vec<serde_json::Value> = rows
        .map(|(row, runs)| json!({ "fact": printer.head(firings.clause, row), "ticks": runs }))
        .collect();
    json!({
        "clause": printer.clause_json(firings.clause),
        "fired": firings.count(),
        "ticks": firings.ticks(),
        "rows": rows,
    })
}

/// Sets the replay to a tick of the trace.
fn load(replay: &mut Replay, tick: &TraceTick, trace: &TraceReader) -> Result<(), Failure> {
    let set = replay.set(tick).and_then(|()| replay.verify(tick));
    set.map_err(|fault| trace.placed(fault))
}

/// Returns the earlier tick whose decision parked an agent until this tick, if one did. A decision to park holds for a
/// number of ticks, then the agent decides anew.
fn parked_since(
    arguments: &Arguments,
    world: &World,
    (tick, position): (&TraceTick, usize),
) -> Result<Option<u64>, Failure> {
    let table = world.vocabulary.actions();
    let state = &tick.agents[position];
    let Some(Effect::Park(ticks)) = table.effect(state.action(table)?) else {
        return Ok(None);
    };
    if !arguments.trace.is_file() {
        return Ok(None);
    }
    let mut trace = TraceReader::open(&arguments.trace)?;
    let mut first = tick.tick;
    let mut before: Option<String> = None;
    while let Some(earlier) = trace.tick()?.filter(|earlier| earlier.tick < tick.tick) {
        let action = &earlier.agents[position].action;
        if *action == state.action && before.as_ref() != Some(action) {
            first = earlier.tick;
        }
        before = Some(action.clone());
    }
    if before.as_ref() != Some(&state.action) {
        first = tick.tick;
    }
    let passed = (tick.tick - first) % u64::from(ticks.max(1));
    Ok((passed > 0).then(|| tick.tick - passed))
}

/// Prints whether a temporal literal holds in a tick, and the proof, or absence, that decides.
fn print_temporal(
    arguments: &Arguments,
    replay: &mut Replay,
    (tick, asked): (&TraceTick, &AskedTemporal),
    sources: &Sources,
) -> Result<(), Failure> {
    if !arguments.trace.is_file() {
        let message = "a question about earlier ticks reads the trace twice, which a pipe does not allow";
        return Err(Failure::Usage(format!("{message}\nhelp: write the trace to a file")));
    }
    let literal = asked.literal(replay.session(), sources);
    let shown = asked.shown(replay.session(), sources);
    let mut trace = TraceReader::open(&arguments.trace)?;
    let (mut facts, mut first) = (Vec::new(), tick.tick);
    while let Some(earlier) = trace.tick()? {
        if earlier.tick >= asked.first_tick(tick.tick) {
            load(replay, &earlier, &trace)?;
            if facts.is_empty() {
                first = earlier.tick;
            }
            facts.push(asked.facts(replay.session()));
        }
        if earlier.tick == tick.tick {
            break;
        }
    }
    let verdict = asked.judge((first, tick.tick), &facts, shown.each_ref().map(String::as_str));
    let proof = match verdict.witness {
        None => None,
        Some((number, fact)) => {
            let mut trace = TraceReader::open(&arguments.trace)?;
            let witness = find(&mut trace, Some(number))?;
            load(replay, &witness, &trace)?;
            let account = fact
                .explain(&mut Explainer::new(replay.session()))
                .map_err(Diagnostic::from)?;
            Some((number, account))
        }
    };
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        let mut line = json!({
            "tick": tick.tick, "fact": literal, "holds": verdict.holds, "because": verdict.because,
        });
        if let Some((number, account)) = proof {
            line["witness"] = account.json(replay.session(), sources);
            line["witness"]["tick"] = json!(number);
        }
        writeln!(out, "{line}")?;
        return Ok(());
    }
    let holds = if verdict.holds { "holds" } else { "does not hold" };
    writeln!(
        out,
        "tick {}: {literal} {holds}, because {}",
        tick.tick, verdict.because
    )?;
    if let Some((number, account)) = proof {
        write!(out, "tick {number}: {}", account.text(replay.session(), sources))?;
    }
    Ok(())
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
        if let Some(computed) = account.computed() {
            line["base"] = json!(computed);
        }
        writeln!(out, "{line}")?;
    } else {
        write!(out, "tick {}: {}", tick.tick, account.text(session, sources))?;
    }
    Ok(())
}

/// An explanation as the user wants it.
enum Shown {
    Json(serde_json::Value),
    Text(String),
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Shown::Json(line) => writeln!(f, "{line}"),
            Shown::Text(text) => f.write_str(text),
        }
    }
}

/// Explains the decision of an agent in a tick to which the replay is set.
fn account(
    arguments: &Arguments,
    replay: &Replay,
    (tick, parked_since): (&TraceTick, Option<u64>),
    (position, why_not): (usize, Option<Action>),
    sources: &Sources,
) -> Result<Shown, Failure> {
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
        parked_since,
    };
    let account = (decision.account(why_not, &Cancel::never())).map_err(Diagnostic::from)?;
    Ok(match arguments.json {
        true => {
            let mut line = account.json(sources);
            if let Some(driven) = &state.driven {
                line["driven"] = json!(driven);
            }
            Shown::Json(line)
        }
        false => {
            let driven = state
                .driven
                .as_ref()
                .map(|driven| steering(driven, replay.world(), sources));
            let driven = driven.transpose()?.map(|line| line + "\n");
            Shown::Text(driven.unwrap_or_default() + &account.text(sources))
        }
    })
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
