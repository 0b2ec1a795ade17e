//! The task of an ego as a planning problem in PDDL, and plans read back.
//!
//! ```text
//! Env at the start of an episode -> the rules drive to the tick of the start -> tables of states -> domain, problem
//!                                                                                                       |
//! Env at the start of an episode <- replay: every action of the plan, as the environment judges it <- plan
//! ```
//!
//! A state is the tick and the places of agents on their routes. The planner chooses the action of the ego; axioms made
//! from the rules decide whether it violates a clause. [`Encoding`] says what drives the others.
//! Everything random is decided by the seed of the episode, so a plan has one outcome.
// Decision: docs/decisions/tasks.md#d075

mod fragment;
mod many;
mod names;
mod one;
mod replay;

pub use replay::{PlanStep, Replay, read_plan, replay};

use crate::city::Action;
use crate::diag::Diagnostic;
use crate::diag::codes as common;
use crate::task::spf::lookahead::{CityState, Lookahead};
use crate::task::spf::pddl::names::Names;
use crate::task::spf::{Env, SpfTask, codes};
use std::fmt::Write;

/// What the problem says of the other agents and of the rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// The others move as they do when the rules drive the ego, and the ego may be only where they do. Axioms judge the
    /// ego's actions.
    OneAgent,
    /// As `OneAgent`, with a fact for each permitted action instead of axioms, and without costs.
    Strips,
    /// Axioms decide for the others, too.
    MultiAgent,
}

impl Encoding {
    /// All encodings.
    pub const ALL: [Encoding; 3] = [Encoding::OneAgent, Encoding::Strips, Encoding::MultiAgent];

    /// Returns its name: `one-agent`, `strips` or `multi-agent`.
    pub const fn name(self) -> &'static str {
        match self {
            Encoding::OneAgent => "one-agent",
            Encoding::Strips => "strips",
            Encoding::MultiAgent => "multi-agent",
        }
    }
}

/// What to encode.
#[derive(Clone, Copy, Debug)]
pub struct PddlOptions {
    /// The encoding.
    pub encoding: Encoding,
    /// The number of steps that the rules drive the ego before the problem begins.
    pub start: u32,
    /// The maximum number of steps of a plan. `None` means the steps that the rules need to the goal, or
    /// [`MULTI_AGENT_TICKS`] in the encoding with several agents if those are fewer.
    pub horizon: Option<u32>,
}

/// The default number of steps of a plan in the multi-agent encoding.
pub const MULTI_AGENT_TICKS: u32 = 5;

/// The maximum number of steps in which the rules must reach the goal.
const STEPS_MAX: u32 = 1000;

/// The maximum number of states of the ego in a problem, and of facts about pairs of places.
const STATES_MAX: usize = 1 << 20;

/// A planning problem.
#[derive(Clone, Debug)]
pub struct PddlTask {
    /// The text of the domain, which depends on the configuration only.
    pub domain: String,
    /// The text of the problem.
    pub problem: String,
    /// The maximum number of steps of a plan.
    pub horizon: u32,
    /// The costs of actions.
    pub costs: Costs,
    /// Whether the rules reach the goal of the trip within the horizon, so that a plan must. Otherwise a plan may also
    /// end at the horizon, at least as far on the route as the rules come.
    pub reaches_goal: bool,
    /// The cost of the cheapest plan by a search in the environment; `None` without a plan, and in the multi-agent
    /// encoding.
    pub cheapest: Option<u64>,
}

/// The costs of actions as whole numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Costs {
    /// Each action that an ego can take, and its cost.
    pub of: Vec<(Action, u64)>,
    /// The cost that stands for a return of -1: four times the cells of the route, and the power of ten that makes the
    /// costs whole.
    pub per_return: u64,
}

impl Costs {
    /// Returns the costs of a task on a route of `cells` cells.
    ///
    /// # Errors
    /// `pddl-unsupported` for positive rewards, since costs are not negative, and for more than six decimal places.
    pub fn new(task: &SpfTask, cells: usize) -> Result<Costs, Diagnostic> {
        let rewards = &task.config().reward.actions;
        let possible = task.possible_actions().iter();
        let rewards: Vec<(Action, f64)> = possible.map(|&action| (action, rewards[action.index()])).collect();
        let fault = |message: String, help: &str| {
            let fault = Diagnostic::new(codes::PDDL_UNSUPPORTED, message).at(task.config().span, "of this task");
            Err(fault.help(help))
        };
        let table = task.world().vocabulary.actions();
        if let Some((action, reward)) = rewards.iter().find(|(_, reward)| *reward > 0.0) {
            let message = format!(
                "PDDL cannot state the reward {reward} of {}: costs are not negative",
                table.name(*action)
            );
            return fault(message, "give every action a reward of at most 0");
        }
        let is_whole = |scale: f64| {
            rewards
                .iter()
                .all(|(_, reward)| ((reward * scale).round() - reward * scale).abs() < 1e-9)
        };
        let Some(scale) = [1_u32, 10, 100, 1000, 10_000, 100_000, 1_000_000]
            .into_iter()
            .find(|scale| is_whole((*scale).into()))
        else {
            let message = "PDDL cannot state rewards of actions with more than six decimal places".to_owned();
            return fault(message, "round the rewards of actions");
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // It is whole and not negative.
        let cost = |reward: f64| (-reward * f64::from(scale)).round() as u64;
        Ok(Costs {
            of: rewards.iter().map(|&(action, reward)| (action, cost(reward))).collect(),
            per_return: 4 * cells as u64 * u64::from(scale),
        })
    }

    /// Returns the cost of an action that an ego can take.
    pub fn of(&self, action: Action) -> Option<u64> {
        let known = self.of.iter().find(|(known, _)| *known == action);
        known.map(|(_, cost)| *cost)
    }
}

/// Writes the task of the first car from the state after `options.start` steps of an episode. The environment controls
/// one car, and the episode has just begun.
///
/// # Errors
/// `pddl-unsupported` for what PDDL cannot state; `limit-exceeded` if the rules do not reach the goal, the episode ends
/// before the start or the horizon, or there are too many states.
pub fn encode(env: &mut Env, options: &PddlOptions) -> Result<PddlTask, Diagnostic> {
    fragment::check_state(env.task().world())?;
    let course = Course::new(env, options)?;
    let costs = Costs::new(env.task(), env.controlled_cars()[0].cells())?;
    match options.encoding {
        Encoding::MultiAgent => many::encode(course, costs),
        Encoding::OneAgent => one::encode(course, costs, true),
        Encoding::Strips => one::encode(course, costs, false),
    }
}

/// What happens if the rules drive the ego.
struct Course {
    lookahead: Lookahead,
    /// The states from the start to the horizon. After its arrival, the ego stays at its goal.
    states: Vec<CityState>,
    /// The place to which the rules drive the ego until the horizon.
    reached: usize,
    /// The last place of its route.
    goal: usize,
    /// Whether both are the same.
    reaches_goal: bool,
    /// The name of the problem.
    name: String,
    options: PddlOptions,
}

impl Course {
    fn new(env: &mut Env, options: &PddlOptions) -> Result<Course, Diagnostic> {
        let limited = |message: String, help: &str| Diagnostic::new(common::LIMIT_EXCEEDED, message).help(help);
        let mut lookahead = Lookahead::new(env)?;
        let ego = lookahead.ego();
        let mut state = CityState {
            steps: 0,
            agents: lookahead.env().city().agents().to_vec(),
        };
        let mut states = Vec::new();
        let mut arrived = state.agents[ego].at_goal().then_some(0);
        let most = options
            .horizon
            .map_or(STEPS_MAX, |horizon| options.start.saturating_add(horizon));
        let by_default = match options.encoding {
            Encoding::MultiAgent => Some(MULTI_AGENT_TICKS),
            _ => None,
        };
        loop {
            if state.steps >= options.start {
                states.push(state.clone());
            }
            let done = u32::try_from(states.len().saturating_sub(1)).expect("at most the horizon");
            let is_last = match (options.horizon, by_default) {
                (Some(horizon), _) => !states.is_empty() && done >= horizon,
                (None, Some(ticks)) => !states.is_empty() && (done >= ticks || arrived.is_some()),
                (None, None) => arrived.is_some(),
            };
            if is_last || state.steps >= most {
                break;
            }
            if env.city().cancel().requested() {
                return Err(Diagnostic::cancelled());
            }
            lookahead.place(&state)?;
            let moved = match arrived {
                None => lookahead.moved(ego, lookahead.wanted()),
                Some(_) => state.agents[ego].clone(),
            };
            let mut agents = lookahead.others_moved()?;
            agents[ego] = moved;
            state = CityState {
                steps: state.steps + 1,
                agents,
            };
            if arrived.is_none() && state.agents[ego].at_goal() {
                arrived = Some(state.steps);
            }
        }
        if arrived.is_some_and(|steps| steps <= options.start) || states.is_empty() {
            let steps = arrived.unwrap_or(state.steps);
            let message = format!(
                "the rules bring the ego to its goal in {steps} steps, so none is left after {}",
                options.start
            );
            return Err(limited(message, "choose an earlier start"));
        }
        if arrived.is_none() && options.horizon.is_none() && by_default.is_none() {
            let message = format!("the rules do not bring the ego to its goal within {STEPS_MAX} steps");
            return Err(limited(
                message,
                "set a horizon, at whose end a plan must have come as far as the rules do",
            ));
        }
        let last = states.last().expect("the start is one");
        let reaches_goal = arrived.is_some();
        // The episode ends at its horizon: with the arrival, or with the overtime penalty.
        let latest = env.horizon() - u32::from(!reaches_goal);
        if last.steps > latest {
            let message = format!(
                "the episode ends after {} steps, before the horizon of the plan",
                env.horizon()
            );
            let help = format!(
                "set a horizon of at most {} steps",
                latest.saturating_sub(options.start)
            );
            return Err(limited(message, &help));
        }
        let seed = env.episode().seed;
        let scenario = &env.task().world().scenario.name;
        Ok(Course {
            reached: last.agents[ego].position(),
            goal: last.agents[ego].route().steps(),
            name: format!("{scenario}-{seed}-{}", options.start),
            lookahead,
            states,
            reaches_goal,
            options: *options,
        })
    }

    /// Returns whether a plan may end at a place of the ego after some steps: at the goal, or at the horizon as far on
    /// the route as the rules come.
    fn is_end(&self, steps: usize, place: usize) -> bool {
        place == self.goal || !self.reaches_goal && steps + 1 == self.states.len() && place >= self.reached
    }

    /// Returns the number of steps of a plan.
    fn horizon(&self) -> u32 {
        u32::try_from(self.states.len() - 1).expect("at most the horizon")
    }

    /// Returns the comment at the head of a problem.
    fn heading(&self, costs: &Costs) -> String {
        let env = self.lookahead.env();
        let ego = &self.states[0].agents[self.lookahead.ego()];
        let reached = match self.reaches_goal {
            true => "its goal",
            false => "its goal, or for so many steps as far as the rules do",
        };
        let mut text = format!(
            "; {} after {} steps of the episode with the seed {}, for at most {} steps\n\
             ; The ego {} drives from [{}, {}] to {reached}; place pN is N cells from the start of its route.\n",
            env.task().world().scenario.name,
            self.options.start,
            env.episode().seed,
            self.horizon(),
            ego.name(),
            ego.cell.row,
            ego.cell.col,
        );
        if self.options.encoding != Encoding::Strips {
            writeln!(text, "; A cost of {} is a return of -1.", costs.per_return).expect("strings take all text");
        }
        text
    }

    /// Returns the facts that order the ticks, and the first one.
    fn ticks(&self) -> String {
        let first = self.states[0].steps;
        let next = (first..first + self.horizon()).map(|tick| format!("    (next t{tick} t{})\n", tick + 1));
        format!("    (now t{first})\n{}", next.collect::<String>())
    }

    /// Returns the names of the ticks.
    fn tick_names(&self) -> String {
        let first = self.states[0].steps;
        (first..=first + self.horizon())
            .map(|tick| format!(" t{tick}"))
            .collect()
    }

    /// Returns the names of all agents.
    fn agent_names(&self) -> Vec<String> {
        let mut names = Names::default();
        let agents = self.states[0].agents.iter();
        agents.map(|agent| names.unique(&agent.name().to_string())).collect()
    }
}

/// Returns the text of an action with a cost, if there is one.
fn increase(cost: Option<u64>) -> String {
    cost.map_or_else(String::new, |cost| format!(" (increase (total-cost) {cost})"))
}

/// Returns the comment at the head of a domain.
fn domain_heading(task: &SpfTask, encoding: Encoding) -> String {
    let name = &task.world().scenario.name;
    format!(
        "; Safe Path Following in {name}: the task of an ego, in the encoding {}\n",
        encoding.name()
    )
}
