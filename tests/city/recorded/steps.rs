//! Observations, wanted actions, violations, rewards and moves of the controlled car equal those of the published
//! environment.

use super::{cell, cells, heading, index, plain_agent, recordings, square_5x5};
use crate::shipped_world::{SPF_MODES, task};
use logicity::city::{Action, AgentConfig, AgentKind, Routing, Split};
use logicity::city::{ActionTable, Agent, Cell, Heading, Router, possible_cells, speed_cells};
use logicity::rng::Seed;
use logicity::sim::{Chance, Observer, Settings, Simulation, World};
use logicity::task::spf::SpfTask;
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::Arc;

/// In every recorded state, the observation, wanted action, reward and violation equal the recorded ones.
#[test]
fn recorded_steps() {
    for recording in recordings("gym") {
        let Some(mode) = recording.mode().filter(|mode| SPF_MODES.contains(mode)) else {
            recording.report(
                "steps not compared: the tag is no shipped mode of Safe Path Following, so its rules are unknown",
            );
            continue;
        };
        let task = task(mode, None);
        let world = task.world();
        let mut city = Simulation::new(Arc::clone(world), Split::Test, Seed(0), Settings::default()).unwrap();
        let mut out = vec![0.0; task.observation_width()];
        let mut ego = None;
        let (mut steps, mut rewarded) = (0, BTreeSet::new());
        for step in recording.lines() {
            if step["meta"] == true {
                assert_eq!(step["obs_dim"], task.observation_width(), "{mode}");
                continue;
            }
            if step["reset"] == true {
                ego = Some(step["ego"].clone());
                continue;
            }
            let place = format!("{mode} step {steps}");
            let recorded = step["agents"].as_array().unwrap();
            assert_eq!(
                recorded.len(),
                city.agents().len(),
                "{place}: the agents of the test set"
            );
            let list = |id: &Value| recorded.iter().position(|agent| agent["id"] == *id).unwrap();
            let mut agents: Vec<Agent> = recorded
                .iter()
                .zip(city.agents())
                .map(|(agent, like)| placed(agent, like, world))
                .collect();
            city.restart(Seed(0), &mut agents);
            let ego = list(ego.as_ref().expect("a reset before the first step"));
            let mut observer = Observer::new(Arc::clone(task.oracle()), ego);
            observer.begin(&city);
            let ones: BTreeSet<usize> = step["obs_ones"].as_array().unwrap().iter().map(index).collect();
            let entities: Vec<usize> = step["ents"].as_array().unwrap().iter().map(list).collect();
            let draws = Draws {
                task: &task,
                entities: &entities,
                ones: &ones,
            };
            observer.look_with(&city, &draws).unwrap();

            assert_eq!(observer.entities().collect::<Vec<_>>(), entities, "{place}");
            observer.write(&mut out);
            let written: BTreeSet<usize> = (0..out.len()).filter(|&at| out[at] == 1.0).collect();
            assert_eq!(written, ones, "{place}");
            let derived = observer.derived(&city).unwrap();
            let wanted = world.vocabulary.decide(Some(AgentKind::Car.into()), derived);
            assert_eq!(wanted, Action::STANDARD[index(&step["expert"])], "{place}");
            let action = Action::STANDARD[index(&step["action"])];
            let broken = observer.violations(&city, action).unwrap().to_vec();
            assert_eq!(!broken.is_empty(), step["fail"].as_bool().unwrap(), "{place}");
            let mut reward = task.reward(action, &broken, index(&step["path_length4"]) / 4);
            if step["overtime"] == true {
                reward += task.config().reward.overtime;
            }
            let expected = step["reward"].as_f64().unwrap();
            assert!(
                (reward - expected).abs() < 1e-6,
                "{place}: {reward}, recorded {expected}"
            );
            steps += 1;
            rewarded.insert(action);
        }
        assert!(steps > 0, "{} has no steps", recording.path.display());
        recording.report(&format!("{steps} steps compared, with the actions {rewarded:?}"));
    }
}

/// An agent in a recorded state.
fn placed(recorded: &Value, like: &Agent, world: &World) -> Agent {
    let concepts = recorded["concepts"].as_array().unwrap().iter();
    let config = AgentConfig {
        name: like.name(),
        concepts: concepts.map(|name| name.as_str().unwrap().to_owned()).collect(),
        priority: i32::try_from(recorded["pri"].as_i64().unwrap()).unwrap(),
    };
    let [start, goal] = ["start", "goal"].map(|key| cell(&recorded[key]));
    let mut agent = Agent::new(&config, world.router.plan(like.kind, start, goal).unwrap());
    agent.cell = cell(&recorded["pos"]);
    agent.heading = heading(&recorded["dir"]);
    agent
}

/// The draws of the published program, read from the recorded observation.
struct Draws<'a> {
    task: &'a SpfTask,
    entities: &'a [usize],
    ones: &'a BTreeSet<usize>,
}

impl Chance for Draws<'_> {
    fn tick(&self) -> u64 {
        0
    }

    fn word(&self) -> u64 {
        0
    }

    fn happens(&self, predicate: usize, first: usize, second: usize, _: f64) -> bool {
        let n = self.task.oracle().entities();
        let columns = self.task.oracle().columns();
        let before = columns.iter().take_while(|column| column.predicate != predicate);
        let base: usize = before.map(|column| column.width).sum();
        let place = |agent| self.entities.iter().position(|&entity| entity == agent).unwrap();
        self.ones.contains(&(base + n * place(first) + place(second)))
    }
}

/// The controlled car on its route.
struct Ego {
    id: Value,
    route: Vec<Cell>,
    /// Its position on the route.
    at: usize,
    heading: Option<Heading>,
    /// The action before the present state; Stop at first.
    action: Action,
}

#[test]
fn the_controlled_car_moves_as_recorded() {
    let router = Router::new(Arc::new(square_5x5()), Routing::Hops);
    for recording in recordings("gym") {
        let (mut routes, mut moves, mut drawn, mut lost) = (0, 0, 0, 0);
        let mut ego: Option<Ego> = None;
        for line in recording.lines() {
            if line["reset"] == true {
                let planned = router
                    .plan(AgentKind::Car, cell(&line["start"]), cell(&line["goal"]))
                    .unwrap();
                let recorded = line["path"].as_array().unwrap();
                assert_eq!(4 * recorded.len(), index(&line["path_length4"]));
                let route = cells(&line["path"]);
                assert!(planned.cells().eq(route.iter().copied()));
                ego = Some(Ego {
                    id: line["ego"].clone(),
                    route,
                    at: 0,
                    heading: None,
                    action: Action::Stop,
                });
                routes += 1;
                continue;
            }
            let (Some(agents), Some(ego)) = (line["agents"].as_array(), ego.as_mut()) else {
                continue;
            };
            let state = agents.iter().find(|agent| agent["id"] == ego.id).unwrap();
            let (from, to) = (ego.route[ego.at], cell(&state["pos"]));
            // If the route passes a cell twice, the published program confuses the second pass with the first.
            let first = ego.route.iter().position(|cell| *cell == from).unwrap();
            let moved = [ego.at, first].into_iter().find_map(|at| {
                let rest = router.follow(AgentKind::Car, ego.route[at..].iter().copied()).unwrap();
                let most = possible_cells(&Agent::new(&plain_agent(AgentKind::Car), rest), &ActionTable::default());
                let cells = ego.route[at..=at + most].iter().position(|cell| *cell == to)?;
                Some((at, cells, most))
            });
            let (at, cells, most) = moved.expect("a possible move");
            lost += usize::from(at != ego.at);
            match (ego.action, speed_cells(AgentKind::Car, ego.action)) {
                (Action::Stop, _) => assert_eq!(cells, 0),
                (_, Some(wanted)) if wanted <= most => assert_eq!(cells, wanted),
                _ if most == 1 => assert_eq!(cells, 1),
                _ => {
                    assert_ne!(cells, 0);
                    drawn += 1;
                }
            }
            ego.at = at + cells;
            ego.heading = Heading::between(from, to).or(ego.heading);
            assert_eq!(ego.heading, heading(&state["dir"]));
            ego.action = Action::STANDARD[index(&line["action"])];
            moves += 1;
        }
        assert!(routes > 0 && moves > 0, "{} is empty", recording.path.display());
        recording.report(&format!(
            "{routes} routes and {moves} moves of the controlled car compared, {drawn} of them drawn"
        ));
        if lost > 0 {
            recording.report(&format!("the published program lost its place on a route {lost} times"));
        }
    }
}
