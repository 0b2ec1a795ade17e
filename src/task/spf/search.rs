//! The planner: a search for the best actions of an ego in the city itself, up to a horizon.
//!
//! In each decision it explores all ways without a violation for some steps, with what the others really do, and takes
//! the first action of the best way. States that are equal except for how they were reached are one, so the number of
//! states grows with the places of the ego rather than with the number of ways. A way that does not reach the goal
//! costs at least the cheapest actions for the rest of the route: the bound is that no action moves the ego by more
//! cells than it demands.

use crate::city::Action;
use crate::diag::Diagnostic;
use crate::predicate::Definition;
use crate::sim::World;
use crate::task::spf::Env;
use crate::task::spf::lookahead::{CityState, LocalState, Lookahead, local_state};
use std::collections::BTreeMap;

/// The bounds of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchBounds {
    /// The number of steps that the planner looks ahead, at least 1.
    pub horizon: u32,
    /// The maximum number of states that it expands for a decision, at least 1. The search ends with the last step that
    /// it explores completely.
    pub expansions: usize,
}

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// The first action of the best way; without a way, the action that the rules want.
    pub action: Action,
    /// The number of states that the search expanded.
    pub expanded: usize,
    /// The number of steps that it explored completely.
    pub depth: u32,
}

/// Plans for the first car of environments with one controlled car. It knows the true state and the seed of the
/// episode.
pub struct Planner {
    bounds: SearchBounds,
    lookahead: Option<Lookahead>,
}

/// A state on the best known way to it.
struct Node {
    state: CityState,
    /// The sum of the rewards so far.
    total: f64,
    /// The first action of the way; `None` for the present state.
    first: Option<Action>,
}

/// The rank of a way: the bound of its return, then the cells that it covers.
type Rank = (f64, usize);

fn is_better(one: Rank, other: Rank) -> bool {
    // Sums in another order differ in the last digits.
    if (one.0 - other.0).abs() > 1e-12 {
        one.0 > other.0
    } else {
        one.1 > other.1
    }
}

/// What identifies a state at a step: the local states of all agents and, if rules read quantities, speeds and waits.
type Key = Vec<(LocalState, [u32; 2])>;

fn key_of(state: &CityState, reads_progress: bool) -> Key {
    let agents = state.agents.iter();
    let key = agents.map(|agent| match reads_progress {
        true => (local_state(agent), [agent.speed.into(), agent.waited]),
        false => (local_state(agent), [0, 0]),
    });
    key.collect()
}

/// Returns whether rules may read how fast an agent was and how long it waited.
fn reads_progress(world: &World) -> bool {
    let read = world
        .vocabulary
        .predicates
        .iter()
        .filter(|predicate| predicate.id.is_some());
    read.into_iter()
        .any(|predicate| matches!(predicate.definition, Definition::Quantity(_) | Definition::External(_)))
}

impl Planner {
    /// Returns a planner.
    ///
    /// # Panics
    /// If a bound is 0.
    pub fn new(bounds: SearchBounds) -> Planner {
        assert!(
            bounds.horizon > 0 && bounds.expansions > 0,
            "a search has at least one step"
        );
        Planner {
            bounds,
            lookahead: None,
        }
    }

    /// Returns the bounds.
    pub fn bounds(&self) -> SearchBounds {
        self.bounds
    }

    /// Plans from the present state of an environment, whose episode is running.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules have temporal operators; `limit-exceeded` if they derive too many rows.
    ///
    /// # Panics
    /// If the environment does not control exactly one car.
    pub fn plan(&mut self, env: &Env) -> Result<Planned, Diagnostic> {
        assert!(env.controlled_cars().len() == 1, "the planner drives one car");
        let lookahead = match self.lookahead.take() {
            Some(mut known) => {
                known.follow(env)?;
                self.lookahead.insert(known)
            }
            None => self.lookahead.insert(Lookahead::new(env)?),
        };
        search(lookahead, env, self.bounds)
    }
}

fn search(lookahead: &mut Lookahead, env: &Env, bounds: SearchBounds) -> Result<Planned, Diagnostic> {
    let (task, ego, cells) = (env.task(), lookahead.ego(), env.controlled_cars()[0].cells());
    let reads_progress = reads_progress(task.world());
    let possible = task.possible_actions();
    let cheapest = cheapest_per_cell(env, cells);
    let violation = task.config().reward.violation;
    let start = CityState {
        steps: env.steps(),
        agents: env.city().agents().to_vec(),
    };
    lookahead.place(&start)?;
    let wanted = lookahead.wanted();
    let mut planned = Planned {
        action: wanted,
        expanded: 0,
        depth: 0,
    };
    let mut layer = vec![Node {
        state: start,
        total: 0.0,
        first: None,
    }];
    // The best way that ends before the horizon: at the goal, at the end of the episode, or without a permitted action.
    let mut ended: Option<(Rank, Action)> = None;
    while planned.depth < bounds.horizon && !layer.is_empty() {
        let mut next: BTreeMap<Key, Node> = BTreeMap::new();
        let mut ended_here = ended;
        for node in &layer {
            if planned.expanded == bounds.expansions {
                return Ok(planned);
            }
            if env.city().cancel().requested() {
                return Err(Diagnostic::cancelled());
            }
            planned.expanded += 1;
            lookahead.place(&node.state)?;
            let allowed = lookahead.allowed();
            let is_parked = node.state.agents[ego].is_parked();
            // The action of the rules comes first, so that it wins among equals.
            let mut actions: Vec<Action> = possible
                .iter()
                .copied()
                .filter(|action| allowed.contains(*action))
                .collect();
            let wanted = lookahead.wanted();
            actions.sort_by_key(|action| *action != wanted);
            if is_parked {
                actions = vec![node.state.agents[ego].parked_by];
            }
            let moved: Vec<_> = actions
                .iter()
                .map(|&action| (action, lookahead.moved(ego, action)))
                .collect();
            if moved.is_empty() {
                if let Some(first) = node.first {
                    let rank = (node.total + violation, node.state.agents[ego].position());
                    note(&mut ended_here, rank, first);
                }
                continue;
            }
            let others = lookahead.others_moved()?;
            for (action, agent) in moved {
                let first = node.first.unwrap_or(action);
                let mut total = node.total + task.reward(action, &[], cells);
                let steps = node.state.steps + 1;
                let (arrived, covered) = (agent.at_goal(), agent.position());
                if arrived || steps >= env.horizon() {
                    if !arrived {
                        total += task.config().reward.overtime;
                    }
                    note(&mut ended_here, (total, covered), first);
                    continue;
                }
                let mut agents = others.clone();
                agents[ego] = agent;
                let state = CityState { steps, agents };
                let key = key_of(&state, reads_progress);
                let is_new = next.get(&key).is_none_or(|known| total > known.total + 1e-12);
                if is_new {
                    next.insert(
                        key,
                        Node {
                            state,
                            total,
                            first: Some(first),
                        },
                    );
                }
            }
        }
        // The layer is explored completely: its ways can be compared.
        ended = ended_here;
        planned.depth += 1;
        let mut best = ended;
        for node in next.values() {
            let agent = &node.state.agents[ego];
            #[allow(clippy::cast_precision_loss)] // fewer cells than 2^52
            let bound = node.total - cheapest * f64::from(agent.remaining());
            note(&mut best, (bound, agent.position()), node.first.expect("it has a way"));
        }
        if let Some((_, action)) = best {
            planned.action = action;
        }
        layer = next.into_values().collect();
    }
    Ok(planned)
}

/// Replaces the best way by a better one.
fn note(best: &mut Option<(Rank, Action)>, rank: Rank, first: Action) {
    if best.is_none_or(|(known, _)| is_better(rank, known)) {
        *best = Some((rank, first));
    }
}

/// Returns a lower bound of what a cell of the route costs.
fn cheapest_per_cell(env: &Env, cells: usize) -> f64 {
    let task = env.task();
    let kind = env.city().agents()[env.controlled_cars()[0].agent()].kind_id;
    let table = task.world().vocabulary.actions();
    let costs = task.possible_actions().iter().filter_map(|&action| {
        let moved = table.speed_cells(kind, action).filter(|cells| *cells > 0)?;
        #[allow(clippy::cast_precision_loss)] // a few cells
        let cost = -task.reward(action, &[], cells) / moved as f64;
        Some(cost)
    });
    costs.reduce(f64::min).unwrap_or(0.0)
}
