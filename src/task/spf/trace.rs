//! Traces of episodes.
// Decision: docs/decisions/tasks.md#d044

use crate::cancel::Cancel;
use crate::city::{Action, Split};
use crate::diag::{self, Diagnostic, SourceId, Sources};
use crate::sim::{Driven, MAX_ENTITIES, Settings, TraceWriter};
use crate::task::spf::{ControlMode, Env, Episode, SpfTask};
use crate::yaml::codes;
use std::io::{self, Write};
use std::sync::Arc;

/// The origin of the city, for the header of a trace.
#[derive(Clone, Copy)]
pub struct Origin<'a> {
    /// The sources that the rules were loaded from.
    pub sources: &'a Sources,
    /// The file of the rules and its includes.
    pub rule_files: &'a [SourceId],
}

/// The reason why `record` failed.
#[derive(Debug)]
pub enum RecordError {
    /// The episode cannot be replayed with these actions.
    Fault(Diagnostic),
    /// The output failed.
    Write(io::Error),
}

impl From<Diagnostic> for RecordError {
    fn from(fault: Diagnostic) -> Self {
        RecordError::Fault(fault)
    }
}

impl From<io::Error> for RecordError {
    fn from(error: io::Error) -> Self {
        RecordError::Write(error)
    }
}

/// Replays an episode of a split with the actions of the first car, and writes the trace in the format of `logicity
/// run`. The first car appears as [`Driven`]. Start and actions determine an episode, so environments need not keep
/// traces.
///
/// # Errors
/// As [`Env::new`] and [`Env::reset_to`]; `invalid-value` for more actions than the episode has steps,
/// `limit-exceeded` for more than [`MAX_ENTITIES`] agents; `cancelled` on cancellation. Ticks written before that stay
/// in `out`.
pub fn record<W: Write>(
    task: &Arc<SpfTask>,
    split: Split,
    (episode, actions): (&Episode, &[Action]),
    origin: Origin<'_>,
    out: W,
    cancel: &Cancel,
) -> Result<W, RecordError> {
    let settings = Settings {
        count_firings: true,
        ..Settings::default()
    };
    let mut env = Env::configured(Arc::clone(task), split, ControlMode::First, settings, cancel)?;
    env.reset_to(episode)?;
    let agents = env.city().agents().len();
    if agents > MAX_ENTITIES {
        let message = format!("a trace of {agents} agents would be too large; the limit is {MAX_ENTITIES}");
        return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).into());
    }
    let Origin { sources, rule_files } = origin;
    let mut trace = TraceWriter::new(out, env.city(), sources, rule_files)?;
    for &action in actions {
        if env.city().cancel().requested() {
            return Err(Diagnostic::cancelled().into());
        }
        if !env.controlled_cars()[0].is_running() {
            let message = format!(
                "{} actions for an episode that ends after {} steps",
                actions.len(),
                env.steps()
            );
            return Err(Diagnostic::new(codes::INVALID_VALUE, message).into());
        }
        let mut driven = observed(&env);
        env.step(&[action])?;
        driven.broken = broken(&env);
        trace.tick_driven(env.city(), &[(env.controlled_cars()[0].agent(), driven)])?;
    }
    Ok(trace.into_inner())
}

/// Returns the observation of the first controlled car, and the action that the rules want of it.
fn observed(env: &Env) -> Driven {
    let agents = env.city().agents();
    let entities = env.controlled_cars()[0].observer().entities();
    Driven {
        observes: entities.map(|agent| agents[agent].name().to_string()).collect(),
        wanted: env.oracle_action(0).name().to_owned(),
        broken: Vec::new(),
    }
}

/// Returns the clauses that its last action violated.
fn broken(env: &Env) -> Vec<usize> {
    let (controlled_car, constraints) = (&env.controlled_cars()[0], env.task().oracle().constraints());
    let clauses = env.city().clauses();
    let position = |&constraint: &usize| {
        let found = clauses
            .iter()
            .position(|clause| *clause == constraints[constraint].clause);
        found.expect("a clause that derives an action has a body")
    };
    controlled_car.last().broken.iter().map(position).collect()
}
