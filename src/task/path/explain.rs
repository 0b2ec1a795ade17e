//! In words: where a rider is, and why the rules want what they want of it.

use super::Env;
use crate::city::Agent;
use crate::config::Speed;
use crate::diag::{Code, Diagnostic, Sources};
use crate::engine::provenance::{ExplainError, Explainer, Teller};
use std::fmt::Write;

/// The state of a rider in a few lines: how far it has come, whom it observes, what is true of them, what the rules want of it.
pub fn describe(env: &Env, rider: usize) -> String {
    let (observer, agents) = (env.riders()[rider].observer(), env.city().agents());
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
        100.0 * env.progress(rider),
        env.riders()[rider].cells(),
        entities.join("\n"),
        atoms.collect::<Vec<_>>().join(" "),
        env.oracle_action(rider).name(),
    )
}

/// Tells why the rules want an action of a rider, now: a proof, on the facts that it observes, of each action that they ask; or if they
/// ask none, why. `sources` are those that the rules were loaded from.
///
/// # Errors
/// `limit-exceeded` for rules that derive too much, or proofs that take too long to find.
pub fn explain(env: &Env, rider: usize, sources: &Sources) -> Result<String, Diagnostic> {
    let (ego, world) = (&env.riders()[rider], env.task().world());
    let (session, value) = ego.observer().session(env.city())?;
    let vocabulary = &world.vocabulary;
    let derived = ego.derived();
    let actions = vocabulary.telling(derived, |action| session.contains(action, &[value]));

    let agent = &env.city().agents()[ego.agent()];
    let wanted = env.oracle_action(rider).name();
    let mut out = format!("{}: the rules want {wanted}", agent.name());
    let names: Vec<&str> = derived.iter().map(Speed::name).collect();
    out += &match names.len() {
        0 => ", the default: they ask nothing".to_owned(),
        1 => String::new(),
        _ => format!(", the first by the configured order of {}", names.join(", ")),
    };
    out.push('\n');

    let fault = |error: ExplainError| Diagnostic::new(Code::LimitExceeded, error.to_string());
    let mut explainer = Explainer::new(&session);
    let teller = Teller::new(world.program.rules(), session.symbols(), sources);
    for action in actions {
        let Some(relation) = vocabulary.action(action) else {
            let _ = write!(out, "\n{}: the rules do not mention it\n", action.name());
            continue;
        };
        let told = match session.contains(relation, &[value]) {
            true => explainer.explain(relation, &[value]),
            false => explainer.explain_absence(relation, &[Some(value)]),
        };
        if let Some(explanation) = told.map_err(fault)? {
            let _ = write!(out, "\n{}", teller.tree(&explanation));
        }
    }
    Ok(out)
}
