//! The reward of the task, and reward terms that only training has.
//!
//! A potential keeps the optimal policies (Ng, Harada and Russell 1999). Its terms telescope: discounted by the same
//! gamma, they sum to minus the potential of the first state, since the potential of a terminal state is 0. No action
//! changes this sum. `progress` and `goal` have no such guarantee.

use crate::city::Action;
use crate::config::{Potential, PotentialOf, Shaping, ViolationsPer};
use crate::task::spf::SpfTask;

impl SpfTask {
    /// Returns the reward of a step: the penalties of the violated clauses, by their positions in
    /// [`Oracle::constraints`](crate::sim::Oracle::constraints), or without a violation the reward of the action on a
    /// route of `cells` cells.
    pub fn reward(&self, action: Action, broken: &[usize], cells: usize) -> f64 {
        if broken.is_empty() {
            #[allow(clippy::cast_precision_loss)] // a route has fewer than 2^32 cells
            return self.config.reward.actions[action.index()] / (4.0 * cells as f64);
        }
        let of = |constraint: &usize| self.constraints[*constraint].1;
        match self.config.reward.violations_per {
            ViolationsPer::Clause => broken.iter().map(of).sum(),
            ViolationsPer::Action => {
                let constraints = self.oracle.constraints();
                let of_action = |action| {
                    broken
                        .iter()
                        .filter(move |&&constraint| constraints[constraint].action == action)
                };
                let worst = |action| of_action(action).map(of).reduce(f64::min);
                self.world().vocabulary.actions().all().filter_map(worst).sum()
            }
        }
    }
}

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
