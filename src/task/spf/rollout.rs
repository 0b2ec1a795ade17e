//! Whole episodes under simple policies, and episode sets generated with them.

use crate::city::{Action, ActionTable, AgentKind, Split};
use crate::datalog::{ClauseId, Literal};
use crate::diag::codes;
use crate::diag::{Diagnostic, SourceId, Span};
use crate::rng::{Purpose, RngExt, Seed};
use crate::sim::Actions;
use crate::task::shard::{self, Origin, Shard, ShardText};
use crate::task::spf::episode::{DrawnLine, episode_seed};
use crate::task::spf::{ControlMode, Env, Episode, EpisodeSet, MapIdentity, OracleRun, SpfTask};
use crate::yaml::codes::INVALID_VALUE;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

impl Purpose {
    /// Seeds of consecutive episodes; index: the number of episodes before.
    pub const EPISODE: Purpose = Purpose::new(8);

    /// A policy that acts at random; index: the step.
    pub const POLICY: Purpose = Purpose::new(9);
}

/// The oracle must reach the goal within this many steps; otherwise the episode is in a deadlock and `make_episodes`
/// drops it.
const STEPS_MAX: u32 = 1000;

/// The maximum number of draws per requested episode.
const DRAWS: u64 = 1000;

/// The maximum number of draws of [`reset_demanding`].
pub const DRAWS_MAX: u64 = 1000;

/// Policies without learning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// Does what the rules want.
    Oracle,
    /// Draws each action uniformly from those that a car can take.
    Random(Seed),
    /// Always takes the same action.
    Always(Action),
}

/// The result of an episode for an ego.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rollout {
    /// Number of steps.
    pub steps: u32,
    /// The sum of the rewards.
    pub total: f64,
    /// Whether the car reached the goal in time and without a violation.
    pub success: bool,
    /// Whether the episode reached its horizon.
    pub truncated: bool,
    /// Number of steps in which the policy chose each action, in the order of the action table.
    pub actions: [u32; Action::MAX],
    /// Number of steps in which the rules derived each action, in the same order.
    pub constrained: [u32; Action::MAX],
    /// The violated clauses, by their positions in [`Oracle::constraints`](crate::sim::Oracle::constraints).
    pub broken: Vec<usize>,
    /// The clauses that applied, summed over the steps: those observed fully, partly and not at all. An evaluation
    /// counts them if others may tell the ego facts; see [`Env::observed_clauses`].
    pub observed_clauses: [u32; 3],
}

/// Returns the names of the actions that have steps, and their numbers of steps, which are in the order of the table.
pub fn steps_by_action(table: &ActionTable, steps: [u32; Action::MAX]) -> impl Iterator<Item = (&str, u32)> {
    table.names().zip(steps).filter(|(_, steps)| *steps > 0)
}

impl Rollout {
    /// Returns the number of steps in which the rules derived each action, without actions that they never derived.
    pub fn constrained_by_name(&self, table: &ActionTable) -> BTreeMap<String, u32> {
        let steps = steps_by_action(table, self.constrained);
        steps.map(|(action, steps)| (action.to_owned(), steps)).collect()
    }

    /// Adds the last step of a controlled car, in which it took an action. `asked` are the actions that the rules
    /// derived before it.
    pub fn add(&mut self, env: &Env, controlled_car: usize, action: Action, asked: impl Iterator<Item = Action>) {
        let last = env.controlled_cars()[controlled_car].last();
        self.steps += 1;
        self.total += last.reward;
        self.success = last.success;
        self.truncated = last.truncated;
        self.broken.clone_from(&last.broken);
        self.actions[action.index()] += 1;
        let possible = env.task().possible_actions();
        let asked = asked.filter(|action| possible.contains(action));
        asked.for_each(|action| self.constrained[action.index()] += 1);
    }
}

/// Runs a policy on the controlled cars from the start of an episode to its end for the first one.
///
/// # Errors
/// `limit-exceeded` for rules that derive too much; `cancelled` if the environment's work is cancelled.
pub fn rollout(env: &mut Env, policy: Policy) -> Result<Rollout, Diagnostic> {
    let mut done = run_while(env, policy, |env| env.controlled_cars()[0].is_running())?;
    Ok(done.swap_remove(0))
}

/// Runs a policy on the controlled cars from the start of an episode to its end for all of them. Returns their results.
///
/// # Errors
/// As [`rollout`].
pub fn rollouts(env: &mut Env, policy: Policy) -> Result<Vec<Rollout>, Diagnostic> {
    run_while(env, policy, Env::is_running)
}

fn run_while(env: &mut Env, policy: Policy, runs: impl Fn(&Env) -> bool) -> Result<Vec<Rollout>, Diagnostic> {
    let mut done = vec![Rollout::default(); env.controlled_cars().len()];
    let (mut actions, mut asked): (Vec<Action>, Vec<Option<Actions>>) = (Vec::new(), Vec::new());
    while runs(env) {
        if env.city().cancel().requested() {
            return Err(Diagnostic::cancelled());
        }
        let act = |controlled_car: usize| match policy {
            Policy::Oracle => env.oracle_action(controlled_car),
            Policy::Random(seed) => {
                let mut stream = seed.stream(Purpose::POLICY, env.steps().into(), controlled_car as u64);
                let possible = env.task().possible_actions();
                possible[stream.random_range(0..possible.len())]
            }
            Policy::Always(action) => action,
        };
        actions.clear();
        actions.extend((0..env.controlled_cars().len()).map(act));
        asked.clear();
        asked.extend((env.controlled_cars().iter()).map(|car| car.is_running().then(|| car.derived())));
        env.step(&actions)?;
        for (number, asked) in asked.iter().enumerate() {
            if let Some(asked) = asked {
                done[number].add(env, number, actions[number], asked.iter());
            }
        }
    }
    Ok(done)
}

/// Begins a recorded episode. In the mode [`ControlMode::Egos`], its horizon is `patience` times the steps that the
/// oracle needs until all egos are at their goals, or the configured horizon if it does not get there within
/// [`STEPS_MAX`] steps.
///
/// # Errors
/// As [`Env::reset_to`] and [`rollout`].
pub(super) fn reset_for_evaluation(env: &mut Env, episode: &Episode) -> Result<(), Diagnostic> {
    env.reset_to(episode)?;
    if env.control() == ControlMode::Egos {
        env.set_horizon(STEPS_MAX);
        let oracle = rollouts(env, Policy::Oracle)?;
        let (steps, config) = (env.steps(), env.task().config());
        let horizon = match oracle.iter().all(|rollout| rollout.success) {
            true => steps.saturating_mul(config.patience),
            false => config.horizon,
        };
        env.reset_to(episode)?;
        env.set_horizon(horizon);
    }
    Ok(())
}

/// Begins the first demanding episode of a sequence of drawn ones: in the oracle's run of it, up to the horizon, the
/// rules constrain at least `constrained_steps` steps (of the configuration). The first draw has the seed `seed`.
/// `agents` is that of [`Env::reset_with`]. Returns the number of draws.
///
/// # Errors
/// As [`Env::reset_with`] and [`rollout`]; `limit-exceeded` if none of [`DRAWS_MAX`] draws is demanding.
pub fn reset_demanding(env: &mut Env, seed: u64, agents: Option<usize>) -> Result<u64, Diagnostic> {
    for draw in 0..DRAWS_MAX {
        let drawn = match draw {
            0 => seed,
            _ => episode_seed(&mut Seed(seed).stream(Purpose::EPISODE, draw, u64::MAX)),
        };
        env.reset_with(drawn, agents)?;
        if is_demanding(env)? {
            if env.steps() > 0 {
                env.reset_with(drawn, agents)?;
            }
            return Ok(draw + 1);
        }
    }
    let config = env.task().config();
    let steps = match config.constrained_steps {
        1 => "a step".to_owned(),
        steps => format!("{steps} steps"),
    };
    let message = format!("in none of {DRAWS_MAX} drawn episodes do the rules constrain {steps} of the oracle's run");
    let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message).at(config.span, "of this task");
    Err(fault.help("lower `constrained_steps`, use more agents or a smaller region, or draw all episodes"))
}

/// Runs the oracle until the rules have constrained enough steps, or the episode ends.
fn is_demanding(env: &mut Env) -> Result<bool, Diagnostic> {
    let mut missing = env.task().config().constrained_steps;
    let mut actions: Vec<Action> = Vec::new();
    while env.controlled_cars()[0].is_running() {
        if env.city().cancel().requested() {
            return Err(Diagnostic::cancelled());
        }
        if !env.controlled_cars()[0].derived().is_empty() {
            missing -= 1;
            if missing == 0 {
                return Ok(true);
            }
        }
        actions.clear();
        actions.extend((0..env.controlled_cars().len()).map(|controlled_car| env.oracle_action(controlled_car)));
        env.step(&actions)?;
    }
    Ok(false)
}

/// The requirements that a set of episodes does not meet yet.
struct Wanted {
    /// Number of episodes by concepts of the ego.
    concepts: Vec<(Arc<[String]>, usize)>,
    /// Number of episodes by action that the rules must derive in them.
    actions: [usize; Action::MAX],
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
        let possible = |action: Action| task.possible_actions().contains(&action);
        let asked: [bool; Action::MAX] = std::array::from_fn(|action| {
            let requires = |action: Action| constraints.iter().any(|constraint| constraint.action == action);
            possible(Action::at(action)) && requires(Action::at(action))
        });
        // 1 / (2k) of the episodes for k actions, because the rules may derive some actions for few egos only.
        let share = count.div_ceil(2 * asked.iter().filter(|asked| **asked).count().max(1));
        Wanted {
            concepts,
            actions: asked.map(|asked| if asked { share } else { 0 }),
        }
    }

    /// Checks that egos can have the concepts for which the rules derive the actions.
    ///
    /// # Errors
    /// `invalid-value` if they cannot, and too few episodes have the other actions.
    fn check(&self, env: &Env, split: Split, count: usize) -> Result<(), Diagnostic> {
        let task = env.task();
        let cars = env
            .controlled_cars()
            .iter()
            .map(|car| &env.city().agents()[car.agent()].concepts);
        let egos: Vec<Arc<[String]>> = match &task.config().ego {
            Some(_) => self.concepts.iter().map(|(concepts, _)| Arc::clone(concepts)).collect(),
            None => cars.cloned().collect(),
        };
        let clauses = |action: usize| {
            let constraints = task.oracle().constraints().iter();
            constraints
                .filter(move |one| one.action == Action::at(action))
                .map(|one| one.clause)
        };
        let lacks = |action: &usize| {
            let is_possible = |clause| egos.iter().any(|ego| unsuitable(task, clause, ego).is_none());
            self.actions[*action] > 0 && !clauses(*action).any(is_possible)
        };
        let (lacking, others): (Vec<usize>, Vec<usize>) = (0..Action::MAX).partition(lacks);
        // The search accepts only episodes with an action that is still missing.
        let most: usize = others.iter().map(|&action| self.actions[action]).sum();
        let Some(&action) = lacking.first().filter(|_| most < count) else {
            return Ok(());
        };
        let mut reasons = clauses(action).filter_map(|clause| Some((clause, unsuitable(task, clause, egos.first()?)?)));
        let Some((clause, Unsuitable { label, concept })) = reasons.next() else {
            return Ok(());
        };
        let name = task.world().vocabulary.actions().name(Action::at(action));
        let message = format!(
            "no ego of the split `{}` can satisfy a clause of `{name}`, which a set of episodes needs",
            split.name()
        );
        let fault = Diagnostic::new(INVALID_VALUE, message)
            .at(task.world().program.rules().clauses[clause.index()].span, label)
            .also(task.config().span, "of this task");
        let carry = concept.map_or("[...]".to_owned(), |concept| format!("[{concept}]"));
        Err(match &task.config().ego {
            Some(_) => fault.help(format!(
                "add a variant of the ego to the task: `{{weight: 1, concepts: {carry}}}`"
            )),
            None => fault.help(format!(
                "the ego is the first car of `agents: {}`: give it `concepts: {carry}`, or let the task draw an `ego`",
                split.name()
            )),
        })
    }

    /// Accepts an episode that the oracle solves with a constrained step if it meets an open requirement.
    fn take(&mut self, task: &SpfTask, ego: usize, episode: &Episode) -> bool {
        let table = task.world().vocabulary.actions();
        let oracle = episode.oracle.as_ref().expect("the oracle solved it");
        let asked = oracle.constrained.keys().filter_map(|name| table.find(name));
        let asked: Vec<usize> = asked.map(Action::index).collect();
        let asks = |action: usize| asked.contains(&action);
        let concepts = &episode.agents[ego].concepts;
        let lacking = self.actions.iter().any(|wanted| *wanted > 0);
        let helps = (0..Action::MAX).any(|action| self.actions[action] > 0 && asks(action));
        if lacking && !helps {
            return false;
        }
        if let Some((_, wanted)) = self.concepts.iter_mut().find(|(kind, _)| kind == concepts) {
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

/// Why an ego never satisfies a clause.
struct Unsuitable {
    label: String,
    /// The concept that the ego would need.
    concept: Option<String>,
}

/// Returns why a car with these concepts never satisfies the body of a clause, judged by its atoms about kinds and
/// concepts.
fn unsuitable(task: &SpfTask, clause: ClauseId, concepts: &[String]) -> Option<Unsuitable> {
    let (rules, scenario) = (task.world().program.rules(), &task.world().scenario);
    let clause = &rules.clauses[clause.index()];
    let reason = |literal: &Literal| {
        let (atom, wanted) = match literal {
            Literal::Positive(atom) => (atom, true),
            Literal::Negative(atom) => (atom, false),
            _ => return None,
        };
        let name = rules.predicates[atom.predicate.index()].name.as_str();
        let known = scenario.predicates.iter().find(|known| known.name.value == name)?;
        if atom.terms != clause.head.terms || known.definition.holds_always(AgentKind::Car, concepts)? == wanted {
            return None;
        }
        let concept = known
            .definition
            .concept()
            .filter(|concept| wanted && concept.of == AgentKind::Car);
        Some(match concept {
            Some(concept) => Unsuitable {
                label: format!("no ego has the concept `{}`", concept.concept),
                concept: Some(concept.concept.clone()),
            },
            None if wanted => Unsuitable {
                label: format!("`{name}` holds for no ego"),
                concept: None,
            },
            None => Unsuitable {
                label: format!("`{name}` holds for every ego"),
                concept: None,
            },
        })
    };
    clause.body.iter().find_map(reason)
}

/// Generates a set of random episodes in which the oracle reaches the goal and at least one step is constrained. The
/// set is balanced over the kinds of egos in the configuration. If the rules can derive k actions, each of them occurs
/// in at least 1 / (2k) of the episodes. Calls `watch` with the number of episodes after each new one.
///
/// # Errors
/// As [`Env::new`] and [`Env::reset`]; `invalid-value` if no ego can have the concepts for which the rules derive an
/// action that the set needs; `limit-exceeded` if the search finds too few episodes.
pub fn make_episodes(
    task: &Arc<SpfTask>,
    split: Split,
    count: usize,
    seed: u64,
    watch: impl FnMut(usize),
) -> Result<EpisodeSet, Diagnostic> {
    let mut draws = Draws::new(task, split, seed)?;
    search(task, (split, count, seed), &mut draws, Draws::episode, watch)
}

/// The episodes of a part of the draws, by the numbers of the draws.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeShard {
    /// Which part.
    pub shard: Shard,
    /// The number of searched draws of this part.
    pub searched: u64,
    /// Those of the draws that a set may contain.
    pub episodes: BTreeMap<u64, Episode>,
}

impl EpisodeShard {
    /// Searches a part of the draws of [`make_episodes`] until it has its share of the episodes. `watch` as there.
    ///
    /// # Errors
    /// As for [`make_episodes`], but the shard may have too few episodes.
    pub fn draw(
        task: &Arc<SpfTask>,
        (split, count, seed): (Split, usize, u64),
        shard: Shard,
        mut watch: impl FnMut(usize),
    ) -> Result<EpisodeShard, Diagnostic> {
        let mut draws = Draws::new(task, split, seed)?;
        Wanted::new(task, count).check(&draws.env, split, count)?;
        let share = shard.share(count);
        let mut wanted = Wanted::new(task, share);
        let (mut taken, mut searched, mut episodes) = (0, 0, BTreeMap::new());
        while taken < share && searched < DRAWS.saturating_mul(share as u64) {
            let draw = shard.item(searched);
            searched += 1;
            if let Some(episode) = draws.episode(draw)? {
                taken += usize::from(wanted.take(task, draws.ego, &episode));
                watch(taken);
                episodes.insert(draw, episode);
            }
        }
        Ok(EpisodeShard {
            shard,
            searched,
            episodes,
        })
    }

    /// Joins all shards, in order, to the set of [`make_episodes`]. Searches the few draws that no shard has. Also
    /// returns their number.
    ///
    /// # Errors
    /// As for [`make_episodes`].
    pub fn join(
        task: &Arc<SpfTask>,
        (split, count, seed): (Split, usize, u64),
        shards: &[EpisodeShard],
        watch: impl FnMut(usize),
    ) -> Result<(EpisodeSet, u64), Diagnostic> {
        let mut state = (Draws::new(task, split, seed)?, 0);
        let of = shards.len().max(1) as u64;
        let episode = |(draws, added): &mut (Draws, u64), draw: u64| match shards.get((draw % of) as usize) {
            Some(shard) if draw / of < shard.searched => Ok(shard.episodes.get(&draw).cloned()),
            _ => {
                *added += 1;
                draws.episode(draw)
            }
        };
        let set = search(task, (split, count, seed), &mut state, episode, watch)?;
        Ok((set, state.1))
    }

    /// Writes the file of the shard.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write<R: Serialize>(&self, origin: &Origin<R>, out: &mut impl Write) -> io::Result<()> {
        let lines = self
            .episodes
            .iter()
            .map(|(draw, episode)| DrawnLine::of(*draw, episode));
        shard::write(out, (EPISODE_SHARDS, self.shard), origin, self.searched, lines)
    }

    /// Reads the lines of a shard, which follow its header.
    ///
    /// # Errors
    /// `invalid-shard`, and `invalid-episode`, with the place of the line.
    pub fn read<R>(
        ShardText { header, lines }: &ShardText<'_, R>,
        source: SourceId,
        task: &SpfTask,
        split: Split,
    ) -> Result<EpisodeShard, Diagnostic> {
        let scenario = &task.world().scenario;
        let mut episodes = BTreeMap::new();
        for (start, text) in lines {
            let here = |fault: Diagnostic| fault.at(Span::new(source, *start..start + text.len()), "in this line");
            let line: DrawnLine = shard::parse(text, source, *start, "an episode of a shard")?;
            let draw = line.draw;
            let episode = line.read(&scenario.kinds, &scenario.actions.table).map_err(here)?;
            episode.place(task, split, ControlMode::First).map_err(here)?;
            if episode.oracle.is_none() || episodes.insert(draw, episode).is_some() {
                return Err(here(shard::invalid(format!(
                    "draw {draw} has no oracle or occurs twice"
                ))));
            }
        }
        Ok(EpisodeShard {
            shard: header.shard,
            searched: header.searched,
            episodes,
        })
    }
}

/// What the files of shards of episodes are of.
pub const EPISODE_SHARDS: &str = "logicity episodes";

/// Random episodes by number. Each is a function of its number, the seed and the split.
struct Draws {
    env: Env,
    split: Split,
    seed: Seed,
    /// The position of the ego among the agents.
    ego: usize,
}

impl Draws {
    fn new(task: &Arc<SpfTask>, split: Split, seed: u64) -> Result<Draws, Diagnostic> {
        let env = Env::new(Arc::clone(task), split, ControlMode::First)?;
        Ok(Draws {
            ego: env.controlled_cars()[0].agent(),
            env,
            split,
            seed: Seed(seed),
        })
    }

    /// Returns the episode of a draw with the run of the oracle, if the oracle solves it with a constrained step.
    fn episode(&mut self, draw: u64) -> Result<Option<Episode>, Diagnostic> {
        // These seeds differ from those of environments, whose last number is 0, and from those of other splits.
        let seed: u64 = self.seed.stream(Purpose::EPISODE, draw, 1 + self.split as u64).random();
        self.env.reset(seed)?;
        self.env.set_horizon(STEPS_MAX);
        let done = rollout(&mut self.env, Policy::Oracle)?;
        if !done.success || done.constrained == [0; Action::MAX] {
            return Ok(None);
        }
        let mut episode = self.env.episode().clone();
        episode.oracle = Some(OracleRun {
            steps: done.steps,
            total: done.total,
            constrained: done.constrained_by_name(self.env.task().world().vocabulary.actions()),
        });
        Ok(Some(episode))
    }
}

/// Searches a set among the episodes of draws, in their order.
fn search<S>(
    task: &Arc<SpfTask>,
    (split, count, seed): (Split, usize, u64),
    state: &mut S,
    episode: impl Fn(&mut S, u64) -> Result<Option<Episode>, Diagnostic>,
    mut watch: impl FnMut(usize),
) -> Result<EpisodeSet, Diagnostic> {
    let env = Env::new(Arc::clone(task), split, ControlMode::First)?;
    let ego = env.controlled_cars()[0].agent();
    let mut wanted = Wanted::new(task, count);
    wanted.check(&env, split, count)?;
    let mut episodes: Vec<Episode> = Vec::new();
    let draws = DRAWS.saturating_mul(count as u64);
    for draw in 0..draws {
        if episodes.len() == count {
            break;
        }
        if let Some(episode) = episode(state, draw)?.filter(|episode| wanted.take(task, ego, episode)) {
            episodes.push(episode);
            watch(episodes.len());
        }
    }
    if episodes.len() < count {
        let message = format!("found only {} of {count} episodes in {draws} draws", episodes.len());
        let fault = Diagnostic::new(codes::LIMIT_EXCEEDED, message).at(task.config().span, "of this task");
        return Err(fault.help(wanted.missing(task.world().vocabulary.actions())));
    }
    // An order independent of the requirements.
    episodes.sort_by_key(|episode| episode.seed);
    Ok(EpisodeSet {
        config: task.world().scenario.name.clone(),
        split,
        map: MapIdentity::of(task.world().map()),
        seed,
        episodes,
    })
}

impl Wanted {
    fn missing(&self, table: &ActionTable) -> String {
        let concepts = (self.concepts.iter().filter(|(_, wanted)| *wanted > 0)).map(|(kind, wanted)| {
            let kind = if kind.is_empty() {
                "no concept".to_owned()
            } else {
                kind.join(" and ")
            };
            format!("{wanted} with {kind}")
        });
        let actions = (table.names().zip(self.actions))
            .filter(|(_, wanted)| *wanted > 0)
            .map(|(action, wanted)| format!("{wanted} in which the rules derive {action} for the ego"));
        let mut lacking: Vec<String> = concepts.chain(actions).collect();
        if lacking.is_empty() {
            lacking.push("episodes that the oracle solves with a constrained step".to_owned());
        }
        format!(
            "missing: {}; request fewer episodes, or use another region or agent set",
            lacking.join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lacking_is_never_nothing() {
        let message = |concepts, actions| Wanted { concepts, actions }.missing(&ActionTable::default());
        assert!(message(vec![], [0; Action::MAX]).starts_with("missing: episodes that the oracle solves"));
        let bus: Arc<[String]> = Arc::new(["bus".to_owned()]);
        let mut actions = [0; Action::MAX];
        actions[Action::Stop.index()] = 3;
        let message = message(vec![(bus, 2), (Arc::new([]), 1)], actions);
        assert!(
            message
                .starts_with("missing: 2 with bus, 1 with no concept, 3 in which the rules derive Stop for the ego;"),
            "{message}"
        );
    }
}
