//! Whole episodes under simple policies, and episode sets made from them.

use crate::city::{Action, Split};
use crate::diag::{Code, Diagnostic};
use crate::rng::{Purpose, RngExt, Seed};
use crate::task::spf::{ControlMode, Env, Episode, EpisodeSet, OracleRun, SpfTask};
use std::sync::Arc;

impl Purpose {
    /// Seeds of one episode after another; index: how many there were before.
    pub const EPISODE: Purpose = Purpose::new(8);

    /// A policy that acts at random; index: the step.
    pub const POLICY: Purpose = Purpose::new(9);
}

/// An episode in which the oracle is not at the goal after so many steps is not kept; it stands in a deadlock.
const STEPS_MAX: u32 = 1000;

/// So many episodes are drawn for every one that is wanted before making a set is given up.
const DRAWS: u64 = 1000;

/// Policies that need no learning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// Does what the rules want.
    Oracle,
    /// Draws each action from all four alike.
    Random(Seed),
    /// Does always the same.
    Always(Action),
}

/// How an episode went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rollout {
    /// How many steps it had.
    pub steps: u32,
    /// The sum of its rewards.
    pub total: f64,
    /// Whether the goal was reached in time and without a rule broken.
    pub success: bool,
    /// Whether it was cut short at the horizon.
    pub truncated: bool,
    /// In how many steps the rules asked an action, by action in the order of [`Action::ALL`].
    pub constrained: [u32; 4],
    /// The clauses that were broken, by their positions in [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub broken: Vec<usize>,
}

/// In how many steps the rules asked an action, by its name, where they asked it at all. `constrained` is as in [`Rollout`].
pub fn constrained_by_name(constrained: [u32; 4]) -> impl Iterator<Item = (&'static str, u32)> {
    let named = Action::ALL.map(Action::name).into_iter().zip(constrained);
    named.filter(|(_, steps)| *steps > 0)
}

impl Rollout {
    /// Adds what the first controlled_car has just done. `asked` are the actions that the rules asked before.
    pub fn add(&mut self, env: &Env, asked: impl Iterator<Item = Action>) {
        let last = env.controlled_cars()[0].last();
        self.steps += 1;
        self.total += last.reward;
        self.success = last.success;
        self.truncated = last.truncated;
        self.broken.clone_from(&last.broken);
        asked.for_each(|action| self.constrained[action as usize] += 1);
    }
}

/// Lets a policy drive the first car of an environment from the beginning of an episode to its end.
///
/// # Errors
/// `limit-exceeded` for rules that derive too much; `cancelled` if the environment's work is cancelled.
pub fn rollout(env: &mut Env, policy: Policy) -> Result<Rollout, Diagnostic> {
    let mut done = Rollout::default();
    let mut actions: Vec<Action> = Vec::new();
    while env.controlled_cars()[0].is_running() {
        if env.city().cancel().requested() {
            return Err(Diagnostic::cancelled());
        }
        let act = |controlled_car: usize| match policy {
            Policy::Oracle => env.oracle_action(controlled_car),
            Policy::Random(seed) => {
                let mut stream = seed.stream(Purpose::POLICY, env.steps().into(), controlled_car as u64);
                Action::ALL[stream.random_range(0..Action::ALL.len())]
            }
            Policy::Always(action) => action,
        };
        actions.clear();
        actions.extend((0..env.controlled_cars().len()).map(act));
        let asked = env.controlled_cars()[0].derived();
        env.step(&actions)?;
        done.add(env, asked.iter());
    }
    Ok(done)
}

/// What a set of episodes still lacks.
struct Wanted {
    /// By concepts of the ego: how many episodes.
    concepts: Vec<(Arc<[String]>, usize)>,
    /// By action: how many episodes in which the rules ask it.
    actions: [usize; 4],
}

impl Wanted {
    fn new(task: &SpfTask, count: usize) -> Wanted {
        let drawn = task.config().ego.iter().flat_map(|ego| &ego.concepts);
        let mut concepts: Vec<(Arc<[String]>, usize)> = Vec::new();
        for (_, carried) in drawn.filter(|(weight, _)| *weight > 0.0) {
            if concepts.iter().all(|(known, _)| known != carried) {
                concepts.push((Arc::clone(carried), 0));
            }
        }
        let kinds = concepts.len();
        for (kind, (_, wanted)) in concepts.iter_mut().enumerate() {
            *wanted = count / kinds + usize::from(kind < count % kinds);
        }
        let constraints = task.oracle().constraints();
        let asked = Action::ALL.map(|action| constraints.iter().any(|constraint| constraint.action == action));
        // Half of an equal share: the rules may ask some actions of few egos only.
        let share = count.div_ceil(2 * asked.iter().filter(|asked| **asked).count().max(1));
        Wanted {
            concepts,
            actions: asked.map(|asked| if asked { share } else { 0 }),
        }
    }

    /// Takes an episode if it has what is lacking.
    fn take(&mut self, concepts: &[String], done: &Rollout) -> bool {
        let asks = |action: usize| done.constrained[action] > 0;
        if !done.success || !(0..4).any(asks) {
            return false;
        }
        let lacking = |actions: &[usize; 4]| (0..4).any(|action| actions[action] > 0);
        let helps = (0..4).any(|action| self.actions[action] > 0 && asks(action));
        if lacking(&self.actions) && !helps {
            return false;
        }
        if let Some((_, wanted)) = self.concepts.iter_mut().find(|(kind, _)| **kind == *concepts) {
            if *wanted == 0 {
                return false;
            }
            *wanted -= 1;
        }
        for (action, wanted) in self.actions.iter_mut().enumerate() {
            *wanted -= usize::from(*wanted > 0 && asks(action));
        }
        true
    }
}

/// Makes a set of episodes: drawn ones in which the oracle reaches the goal and the rules ask an action at least once. Every kind of ego
/// that the configuration draws is there equally often, and every action that a rule can ask is asked in at least half an equal share
/// of them. `watch` is told how many there are after each that is found.
///
/// # Errors
/// As [`Env::new`] and [`Env::reset`]; `limit-exceeded` if such episodes are not found.
pub fn make_episodes(
    task: &Arc<SpfTask>,
    split: Split,
    count: usize,
    seed: u64,
    mut watch: impl FnMut(usize),
) -> Result<EpisodeSet, Diagnostic> {
    let mut env = Env::new(Arc::clone(task), split, ControlMode::First)?;
    let mut wanted = Wanted::new(task, count);
    let mut episodes: Vec<Episode> = Vec::new();
    let draws = DRAWS.saturating_mul(count as u64);
    for draw in 0..draws {
        if episodes.len() == count {
            break;
        }
        // Not the seeds of environments, whose last number is 0, nor those of another split.
        let seed: u64 = Seed(seed).stream(Purpose::EPISODE, draw, 1 + split as u64).random();
        env.reset(seed)?;
        env.set_horizon(STEPS_MAX);
        let done = rollout(&mut env, Policy::Oracle)?;
        let ego = &env.city().agents()[env.controlled_cars()[0].agent()];
        if wanted.take(&ego.concepts, &done) {
            let mut episode = env.episode().clone();
            episode.oracle = Some(OracleRun {
                steps: done.steps,
                total: done.total,
                constrained: done.constrained,
            });
            episodes.push(episode);
            watch(episodes.len());
        }
    }
    if episodes.len() < count {
        let message = format!("{} of {count} episodes found in {draws} draws", episodes.len());
        let fault = Diagnostic::new(Code::LIMIT_EXCEEDED, message).at(task.config().span, "of this task");
        return Err(fault.help(wanted.describe()));
    }
    // In an order that has nothing to do with what was lacking.
    episodes.sort_by_key(|episode| episode.seed);
    Ok(EpisodeSet {
        config: task.world().scenario.name.clone(),
        split,
        seed,
        episodes,
    })
}

impl Wanted {
    fn describe(&self) -> String {
        let concepts = (self.concepts.iter().filter(|(_, wanted)| *wanted > 0)).map(|(kind, wanted)| {
            let kind = if kind.is_empty() {
                "no concept".to_owned()
            } else {
                kind.join(" and ")
            };
            format!("{wanted} with {kind}")
        });
        let actions = (Action::ALL.iter().zip(self.actions).filter(|(_, wanted)| *wanted > 0))
            .map(|(action, wanted)| format!("{wanted} in which the rules ask {}", action.name()));
        let mut lacking: Vec<String> = concepts.chain(actions).collect();
        if lacking.is_empty() {
            lacking.push("episodes that the oracle solves and in which a rule asks something".to_owned());
        }
        format!(
            "lacking: {}; take fewer episodes, or another region or agent set",
            lacking.join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lacking_is_never_nothing() {
        let description = |concepts, actions| Wanted { concepts, actions }.describe();
        assert!(description(vec![], [0; 4]).starts_with("lacking: episodes that the oracle solves"));
        let bus: Arc<[String]> = Arc::new(["bus".to_owned()]);
        let description = description(vec![(bus, 2), (Arc::new([]), 1)], [0, 0, 0, 3]);
        assert!(
            description.starts_with("lacking: 2 with bus, 1 with no concept, 3 in which the rules ask Stop;"),
            "{description}"
        );
    }
}
