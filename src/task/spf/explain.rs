//! In words: where a controlled_car is, and why the rules want what they want of it.

use crate::city::Agent;
use crate::diag::{Diagnostic, Sources};
use crate::sim::Decision;
use crate::task::spf::Env;

/// The present state of a controlled_car in a few lines, also of one whose episode has ended: how far it has come, whom it observes, what is true of
/// them, what the rules want of it.
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

/// Tells why the rules want an action of a controlled_car, now: on the facts that it observes, a proof of each action that they ask, or if they ask
/// none, why. `sources` are those that the rules were loaded from.
///
/// # Errors
/// `limit-exceeded` for rules that derive too much, or proofs that take too long to find.
pub fn explain(env: &Env, controlled_car: usize, sources: &Sources) -> Result<String, Diagnostic> {
    let ego = &env.controlled_cars()[controlled_car];
    let agent = &env.city().agents()[ego.agent()];
    let (session, value) = ego.observer().session(env.city())?;
    let decision = Decision {
        world: env.task().world(),
        session: &session,
        tick: env.steps().into(),
        agent: agent.name().to_string(),
        value,
        at: agent.cell,
        heading: agent.heading,
        derived: ego.derived(),
        action: env.oracle_action(controlled_car),
    };
    let account = decision.account(None, env.city().cancel()).map_err(Diagnostic::from)?;
    Ok(account.text(sources))
}
