//! Text descriptions of a controlled car and explanations of its rules.

use crate::city::Agent;
use crate::datalog::explain::Explainer;
use crate::diag::{Diagnostic, Sources};
use crate::sim::{AskedFact, Decision};
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
        env.oracle_action(controlled_car).name(),
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
    let decision = Decision {
        world: env.task().world(),
        session: &session,
        tick: env.steps().into(),
        agent: agent.name().to_string(),
        kind: agent.kind_id,
        value,
        at: agent.cell,
        heading: agent.heading,
        derived: ego.derived(),
        action: env.oracle_action(controlled_car),
    };
    let account = decision.account(None, env.city().cancel());
    let account = account.map_err(|error| (vec![error.into()], sources.clone()))?;
    Ok(account.text(sources))
}
