//! States of an episode and what follows from them: the exact model of the environment for searches.
//!
//! A state is the number of steps and the agents. With the seed of the episode it determines everything that happens
//! later, random draws included, as long as the rules do not look back.

use crate::city::{Action, Agent, Cell, Heading, Rest, Surroundings, advance};
use crate::diag::Diagnostic;
use crate::sim::{Actions, Observer};
use crate::task::spf::{ControlMode, Env};
use std::sync::Arc;

/// A state of an episode.
#[derive(Clone, Debug)]
pub(super) struct CityState {
    /// The number of steps so far.
    pub steps: u32,
    /// The agents in list order.
    pub agents: Vec<Agent>,
}

/// What determines the later moves of an agent, given its decisions and the seed: start and goal of its route, its
/// position on it, its rest, its heading, and how long it stands parked.
///
/// A run has one route for each start and goal unless an action changes routes.
pub(super) type LocalState = ([i32; 4], usize, Rest, Option<Heading>, u32);

/// Returns the local state of an agent.
pub(super) fn local_state(agent: &Agent) -> LocalState {
    let (Cell { row, col, .. }, goal) = (agent.start(), agent.goal());
    (
        [row, col, goal.row, goal.col],
        agent.position(),
        agent.rest,
        agent.heading,
        agent.parked,
    )
}

/// Computes what follows from states of an episode.
pub(super) struct Lookahead {
    env: Env,
    /// The position of the ego in the list of agents.
    ego: usize,
    /// Working memory.
    agents: Vec<Agent>,
}

impl Lookahead {
    /// Copies the episode of an environment with one controlled car, without its sensors and its shield.
    ///
    /// # Errors
    /// `rule-mismatch` if the rules have temporal operators; as [`Env::new_with`] and [`Env::reset_to`].
    pub fn new(env: &Env) -> Result<Lookahead, Diagnostic> {
        let (task, city) = (env.task(), env.city());
        task.world().without_time("searches")?;
        let mut copy = Env::without_sensors_and_shield(
            Arc::clone(task),
            city.split(),
            ControlMode::First,
            crate::sim::Settings::default(),
            city.cancel(),
        )?;
        copy.judge_actions();
        copy.reset_to(env.episode())?;
        Ok(Lookahead {
            ego: copy.controlled_cars()[0].agent(),
            agents: Vec::new(),
            env: copy,
        })
    }

    /// Follows the environment to another episode.
    ///
    /// # Errors
    /// As [`Env::reset_to`].
    pub fn follow(&mut self, env: &Env) -> Result<(), Diagnostic> {
        match self.env.episode() == env.episode() {
            true => Ok(()),
            false => self.env.reset_to(env.episode()),
        }
    }

    /// Returns the position of the ego in the list of agents.
    pub fn ego(&self) -> usize {
        self.ego
    }

    /// Returns the environment in the state that it was placed in last.
    pub fn env(&self) -> &Env {
        &self.env
    }

    /// Returns what the ego observes in the state that it was placed in last.
    pub fn observer(&self) -> &Observer {
        self.env.controlled_cars()[0].observer()
    }

    /// Places the environment in a state.
    ///
    /// # Errors
    /// `limit-exceeded` if the rules derive too many rows.
    pub fn place(&mut self, state: &CityState) -> Result<(), Diagnostic> {
        self.agents.clone_from(&state.agents);
        self.env.place(state.steps, &mut self.agents)
    }

    /// Returns the actions that violate no clause in the present state.
    pub fn allowed(&self) -> Actions {
        let allowed = self.env.controlled_cars()[0].allowed();
        allowed.expect("the environment judges actions")
    }

    /// Returns the action that the rules want of the ego in the present state.
    pub fn wanted(&self) -> Action {
        self.env.oracle_action(0)
    }

    /// Returns an agent of the present state, by its position in the list, after a tick in which it takes an action.
    pub fn moved(&self, index: usize, action: Action) -> Agent {
        let city = self.env.city();
        self.moved_from(&city.agents()[index], (index, city.now()), action)
    }

    /// Returns an agent after the tick of this number in which it takes an action; `index` is its position in the list.
    pub fn moved_from(&self, agent: &Agent, (index, tick): (usize, u64), action: Action) -> Agent {
        let city = self.env.city();
        let world = city.world();
        let surroundings = Surroundings {
            router: &world.router,
            places: city.places(),
            actions: &world.scenario.actions.table,
            seed: city.seed(),
            tick,
        };
        let mut moved = agent.clone();
        advance(&mut moved, index, action, &surroundings);
        moved
    }

    /// Returns the agents after the next tick from the present state, in which the rules decide for all but the ego.
    /// The ego is as before.
    ///
    /// # Errors
    /// As [`Simulation::tick`](crate::sim::Simulation::tick).
    pub fn others_moved(&mut self) -> Result<Vec<Agent>, Diagnostic> {
        let before = self.env.city().agents()[self.ego].clone();
        self.env.city_mut().tick(&[])?;
        let mut agents = self.env.city().agents().to_vec();
        agents[self.ego] = before;
        Ok(agents)
    }
}
