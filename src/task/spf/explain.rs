//! Text descriptions of a controlled car and explanations of its rules.

use crate::city::{Action, Agent};
use crate::config::ShieldMode;
use crate::datalog::explain::{Explainer, ExplanationPrinter};
use crate::datalog::{Session, Value};
use crate::diag::{Diagnostic, Sources};
use crate::sim::{Actions, AskedFact, Decision, ShieldState, World};
use crate::task::spf::Env;

/// Describes the current state of a controlled car in a few lines: progress, observed agents, true atoms, and the
/// action that the rules want. Also works after its episode has ended.
pub fn describe(env: &Env, controlled_car: usize) -> String {
    let (observer, agents) = (env.controlled_cars()[controlled_car].observer(), env.city().agents());
    let vocabulary = &env.task().world().vocabulary;
    let place = |agent: usize| {
        let Agent { cell, heading, .. } = &agents[agent];
        let heading = heading.map(|heading| format!(" heading {}", heading.name()));
        format!(
            "{} at [{}, {}]{}",
            agents[agent].name(),
            cell.row,
            cell.col,
            heading.unwrap_or_default()
        )
    };
    let atoms = observer.atoms().map(|(predicate, of)| {
        let names: Vec<String> = of.iter().map(|&agent| agents[agent].name().to_string()).collect();
        format!("{}({})", vocabulary.predicates[predicate].name, names.join(", "))
    });
    let entities: Vec<String> = observer.entities().map(place).collect();
    format!(
        "step {} of {}, {:.0} % of {} cells\n{}\n{}\nthe rules want {}\n",
        env.steps(),
        env.horizon(),
        100.0 * env.progress(controlled_car),
        env.controlled_cars()[controlled_car].cells(),
        entities.join("\n"),
        atoms.collect::<Vec<_>>().join(" "),
        vocabulary.actions().name(env.oracle_action(controlled_car)),
    )
}

/// Explains why the rules want an action of a controlled car now: a proof of each derived action from the observed
/// facts, or why there is none. With `fact`, explains instead why this fact holds or does not hold there; see
/// [`AskedFact::read`]. `sources` are those that the rules were loaded from.
///
/// # Errors
/// With the sources of their places: those of the fact; `limit-exceeded` if the rules derive too many rows, or a proof
/// takes too many steps.
pub fn explain(
    env: &Env,
    controlled_car: usize,
    fact: Option<&str>,
    sources: &Sources,
) -> Result<String, (Vec<Diagnostic>, Sources)> {
    let ego = &env.controlled_cars()[controlled_car];
    let agent = &env.city().agents()[ego.agent()];
    let (session, value) = (ego.observer().session(env.city())).map_err(|fault| (vec![fault], sources.clone()))?;
    if let Some(fact) = fact {
        let mut sources = sources.clone();
        let question = sources.add("<fact>", fact);
        let names: Vec<String> = env
            .city()
            .agents()
            .iter()
            .map(|agent| agent.name().to_string())
            .collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let (world, name) = (env.task().world(), agent.name().to_string());
        let asked = AskedFact::read(&sources, question, (&world.scenario, &session), &names, Some(&name));
        let asked = asked.map_err(|faults| (faults, sources.clone()))?;
        let mut explainer = Explainer::new_with(&session, env.city().cancel());
        let account = asked
            .explain(&mut explainer)
            .map_err(|error| (vec![error.into()], sources.clone()))?;
        return Ok(account.text(&session, &sources));
    }
    let world = env.task().world();
    let decided = (ego.derived(), env.oracle_action(controlled_car));
    decision_text(env, agent, (world, &session, value), decided, sources)
}

/// Explains the shield of a controlled car: the actions that it permits now, those that it does not with the clauses that
/// they violate, and a proof of the action that its rules choose on the observed facts (with probabilities, those above
/// 0.5). `sources` are those of its rules. Returns an empty text without a shield.
///
/// # Errors
/// As [`explain`].
pub fn explain_shield(
    env: &mut Env,
    controlled_car: usize,
    sources: &Sources,
) -> Result<String, (Vec<Diagnostic>, Sources)> {
    let failed = |fault: Diagnostic| (vec![fault], sources.clone());
    env.ask_shield().map_err(failed)?;
    let ego = &env.controlled_cars()[controlled_car];
    let Some((shield, verdict)) = env.shield().zip(ego.verdict()) else {
        return Ok(String::new());
    };
    let (config, world) = (shield.config(), shield.oracle().world());
    let printer = ExplanationPrinter::new(world.program.rules(), &world.program.rules().symbols, sources);
    let mut lines = [Vec::new(), Vec::new()];
    let mut state = ShieldState::new(shield);
    for &action in env.task().possible_actions() {
        let mut line = world.vocabulary.actions().name(action).to_owned();
        let mut notes = Vec::new();
        if config.mode == ShieldMode::Probabilistic {
            notes.push(format!("{:.3}", verdict.probability(action)));
        }
        let permitted = verdict.permitted.contains(action);
        if !permitted {
            let broken = state
                .violations(shield, ego.observer(), env.city(), action)
                .map_err(failed)?;
            let constraints = shield.oracle().constraints();
            let labels = broken.iter().map(|clause| printer.label(constraints[*clause].clause));
            let labels = labels.collect::<Vec<String>>().join(", ");
            if !labels.is_empty() {
                notes.push(format!("violates {labels}"));
            }
        }
        if !notes.is_empty() {
            line += &format!(" ({})", notes.join("; "));
        }
        lines[usize::from(permitted)].push(line);
    }
    let [refused, permitted] = lines.map(|line| line.join(", "));
    let query = config.query.name();
    let mut text = format!("{query} by the shield: {permitted}\n");
    if !verdict.permitted.iter().any(|action| verdict.probability(action) > 0.0) {
        text = format!("no action is {query}; the rules choose {permitted}\n");
    }
    if !refused.is_empty() {
        text += &format!("not {query}: {refused}\n");
    }
    let (observer, agent) = (ego.observer(), &env.city().agents()[ego.agent()]);
    let decided = shield.decide(observer, env.city()).map_err(failed)?;
    let (session, value) = observer.observed_session(shield.oracle(), env.city()).map_err(failed)?;
    text += &decision_text(env, agent, (world, &session, value), decided, sources)?;
    Ok(text)
}

/// Returns the explanation of what rules decide for an agent. `derived` are the actions before the default, with the
/// chosen one.
fn decision_text(
    env: &Env,
    agent: &Agent,
    (world, session, value): (&World, &Session, Value),
    (derived, action): (Actions, Action),
    sources: &Sources,
) -> Result<String, (Vec<Diagnostic>, Sources)> {
    let decision = Decision {
        world,
        session,
        tick: env.steps().into(),
        agent: agent.name().to_string(),
        kind: agent.kind_id,
        value,
        at: agent.cell,
        heading: agent.heading,
        derived,
        action,
        parked_since: None,
    };
    let account = decision.account(None, env.city().cancel());
    let account = account.map_err(|error| (vec![error.into()], sources.clone()))?;
    Ok(account.text(sources))
}
