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

/// Replays an episode of a split with the actions of the egos, and writes the trace in the format of `logicity run`.
/// The egos appear as [`Driven`] until their episodes end; [`SpfTask::control`] says which cars they are. Start and
/// actions determine an episode, so environments need not keep traces.
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
    let mut env = Env::configured(Arc::clone(task), split, task.control(), settings, cancel)?;
    env.reset_to(episode)?;
    if env.control() == ControlMode::Egos {
        // Environments and evaluations have different horizons.
        env.set_horizon(u32::MAX);
    }
    let agents = env.city().agents().len();
    if agents > MAX_ENTITIES {
        let message = format!("a trace of {agents} agents would be too large; the limit is {MAX_ENTITIES}");
        return Err(Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).into());
    }
    let Origin { sources, rule_files } = origin;
    let mut trace = TraceWriter::new(out, env.city(), sources, rule_files)?;
    let (egos, count) = (env.controlled_cars().len(), actions.len());
    if !count.is_multiple_of(egos) {
        let message = format!("{count} actions of {egos} egos");
        return Err(Diagnostic::new(codes::INVALID_VALUE, message).into());
    }
    let mut driven: Vec<(usize, Driven)> = Vec::new();
    for actions in actions.chunks_exact(egos) {
        if env.city().cancel().requested() {
            return Err(Diagnostic::cancelled().into());
        }
        if !env.is_running() {
            let message = format!("{count} actions for an episode that ends after {} steps", env.steps());
            return Err(Diagnostic::new(codes::INVALID_VALUE, message).into());
        }
        driven.clear();
        let running = (0..egos).filter(|ego| env.controlled_cars()[*ego].is_running());
        driven.extend(running.map(|ego| (ego, observed(&env, ego))));
        env.step(actions)?;
        for (ego, driven) in &mut driven {
            driven.broken = broken(&env, *ego);
            *ego = env.controlled_cars()[*ego].agent();
        }
        trace.tick_driven(env.city(), &driven)?;
    }
    Ok(trace.into_inner())
}

/// Returns the observation of a controlled car, and the action that the rules want of it.
fn observed(env: &Env, ego: usize) -> Driven {
    let agents = env.city().agents();
    let entities = env.controlled_cars()[ego].observer().entities();
    Driven {
        observes: entities.map(|agent| agents[agent].name().to_string()).collect(),
        wanted: env
            .task()
            .world()
            .vocabulary
            .actions()
            .name(env.oracle_action(ego))
            .to_owned(),
        broken: Vec::new(),
    }
}

/// Returns the clauses that its last action violated.
fn broken(env: &Env, ego: usize) -> Vec<usize> {
    let (controlled_car, constraints) = (&env.controlled_cars()[ego], env.task().oracle().constraints());
    let clauses = env.city().clauses();
    let position = |&constraint: &usize| {
        let found = clauses
            .iter()
            .position(|clause| *clause == constraints[constraint].clause);
        found.expect("a clause that derives an action has a body")
    };
    controlled_car.last().broken.iter().map(position).collect()
}
