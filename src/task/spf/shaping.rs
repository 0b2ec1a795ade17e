//! Reward terms that only training has.
//!
//! A potential keeps the optimal policies (Ng, Harada and Russell 1999). Its terms telescope: discounted by the same
//! gamma, they sum to minus the potential of the first state, since the potential of a terminal state is 0. No action
//! changes this sum. `progress` and `goal` have no such guarantee.

use crate::config::{Potential, PotentialOf, Shaping};

/// The part of a step that reward terms depend on.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShapedStep {
    /// The covered shares of the route before and after the step.
    pub covered: [f64; 2],
    pub terminated: bool,
    pub success: bool,
}

/// Returns what a step gets besides the reward of the task.
pub(super) fn shaping(terms: &Shaping, step: ShapedStep) -> f64 {
    let [before, after] = step.covered;
    let Potential { gamma, .. } = terms.potential;
    let potential = |covered| potential(&terms.potential, covered);
    // Truncation does not end the task, so the state after it keeps its potential.
    let next = if step.terminated { 0.0 } else { potential(after) };
    let goal = if step.success { terms.goal } else { 0.0 };
    terms.progress * (after - before) + goal + (gamma * next - potential(before))
}

/// Returns the potential of a state that does not end the episode.
fn potential(of: &Potential, covered: f64) -> f64 {
    match of.of {
        PotentialOf::Remaining => -of.weight * (1.0 - covered),
        PotentialOf::Progress => of.weight * covered,
    }
}
