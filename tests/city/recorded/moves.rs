//! Fields of view, routes and moves equal the recorded ones.

use super::{Recording, cell, cells, heading, index, kind, plain_agent, recordings, square_5x5};
use logicity::city::{Action, ActionTable, AgentKind, Routing, TripEnds};
use logicity::city::{
    Agent, Cell, CityMap, Heading, MoveReason, Moved, Places, Rest, Route, Router, Surroundings, advance,
    field_of_view, possible_cells, speed_cells,
};
use logicity::rng::Seed;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Half-width of the field of view in the recorded runs.
const HALF_WIDTH: u32 = 25;

/// Rows and columns of the region in the recorded runs.
const REGION: u32 = 120;

fn router(map: CityMap) -> Router {
    Router::new(Arc::new(map), Routing::Hops)
}

#[test]
fn routes_equal_the_recorded_ones() {
    let router = router(square_5x5());
    let weighted = Router::new(router.map().clone(), Routing::Weighted);
    let places = Places::new(&router, TripEnds::Curb, Some(REGION), None);
    for recording in recordings("paths") {
        let (mut cars, mut pedestrians) = (0, 0);
        for line in recording.lines() {
            let (kind, recorded) = (kind(&line["type"]), cells(&line["path"]));
            let (start, goal) = (cell(&line["start"]), cell(&line["goal"]));
            assert_eq!((recorded[0], recorded[recorded.len() - 1]), (start, goal));
            let route = router.plan(kind, start, goal).unwrap();
            assert!([start, goal].iter().all(|cell| places.contains(kind, *cell)));
            // The cells are the same, not only the numbers of nodes and steps.
            assert!(route.cells().eq(recorded.iter().copied()), "{start:?} to {goal:?}");
            assert_eq!(route, router.follow(kind, recorded).unwrap());
            let other = weighted.plan(kind, start, goal).unwrap();
            match kind {
                AgentKind::Car => cars += 1,
                AgentKind::Pedestrian => {
                    pedestrians += 1;
                    let block = |cell| router.map().layout().unwrap().block_at(cell).unwrap();
                    assert_ne!(block(start), block(goal));
                    assert_eq!(route.steps(), other.steps(), "{start:?} to {goal:?}");
                }
            }
        }
        assert!(cars + pedestrians > 0, "{} is empty", recording.path.display());
        recording.report(&format!(
            "{cars} routes of cars and {pedestrians} of pedestrians compared"
        ));
    }
}

#[test]
fn fields_of_view_equal_the_recorded_ones() {
    let map = square_5x5();
    for recording in recordings("trace") {
        let mut egos = 0;
        for line in recording.lines() {
            let agents = line["agents"].as_array().unwrap();
            for ego in agents {
                let view = field_of_view(cell(&ego["pos"]), heading(&ego["dir"]), HALF_WIDTH, &map);
                let others = agents
                    .iter()
                    .filter(|agent| agent["id"] != ego["id"] && view.contains(cell(&agent["pos"])));
                let seen: Vec<&Value> = [ego].into_iter().chain(others).map(|agent| &agent["id"]).collect();
                let recorded = line["ego"][ego["id"].to_string()]["ents"].as_array().unwrap();
                assert!(seen.into_iter().eq(recorded), "{} {}", recording.tag, line["tick"]);
                egos += 1;
            }
        }
        recording.report(&format!("{egos} fields of view compared"));
    }
}

/// A recorded tick of one agent.
struct Step<'a> {
    ego: &'a Value,
    kind: AgentKind,
}

impl Step<'_> {
    /// The moves that the rules allow, as the published program recorded them: by one, two, three or no cells.
    fn decided(&self) -> BTreeSet<Action> {
        let local = self.ego["local"].as_array().unwrap().iter().map(index);
        local
            .map(|action| match (self.kind, action) {
                (AgentKind::Pedestrian, 0..4) | (AgentKind::Car, 4..8) => Action::Normal,
                (AgentKind::Car, 0..4) => Action::Slow,
                (AgentKind::Car, 8..12) => Action::Fast,
                (AgentKind::Pedestrian, 4) | (AgentKind::Car, 12) => Action::Stop,
                (kind, action) => panic!("a {kind:?} has no action {action}"),
            })
            .collect()
    }

    /// The moves that the route allows. `None` if the published program did not use the route.
    fn allowed(&self) -> Option<BTreeSet<(Heading, usize)>> {
        const HEADINGS: [Heading; 4] = [Heading::Left, Heading::Right, Heading::Up, Heading::Down];
        let allowed = self.ego["global"].as_array()?.iter().map(index);
        Some(allowed.map(|action| (HEADINGS[action % 4], action / 4 + 1)).collect())
    }

    fn rest(&self) -> Rest {
        match (self.ego["wait"][0].as_bool().unwrap(), index(&self.ego["wait"][1])) {
            (false, _) => Rest::UnderWay,
            (true, 1) => Rest::Arrived,
            (true, _) => Rest::Rested,
        }
    }
}

/// The moves that an agent's route allows.
fn possible(agent: &Agent) -> BTreeSet<(Heading, usize)> {
    (1..=possible_cells(agent, &ActionTable::default()))
        .map(|cells| (agent.ahead(), cells))
        .collect()
}

/// The numbers of cells that an agent may move: those of the decided actions that the route allows, or else those that
/// the route allows.
fn choices(agent: &Agent, decided: &BTreeSet<Action>) -> BTreeSet<usize> {
    let most = possible_cells(agent, &ActionTable::default());
    let wanted = decided.iter().filter_map(|&action| speed_cells(agent.kind, action));
    let mut choices: BTreeSet<usize> = wanted.filter(|&cells| cells <= most).collect();
    if choices.is_empty() {
        choices = (most.min(1)..=most).collect();
    }
    choices
}

/// The action that moves an agent by as many cells as its route allows.
fn action_of(kind: AgentKind, cells: usize) -> Action {
    let moves = |action: &Action| speed_cells(kind, *action) == Some(cells);
    Action::STANDARD.into_iter().find(moves).expect("the reach of an agent")
}

/// The routes of a run: the recorded ones, or else planned ones for recorded starts and goals.
struct Planned {
    recorded: BTreeMap<(u64, u64, i64), Route>,
    /// Goals by seed, agent and tick.
    goals: BTreeMap<(u64, u64, i64), Cell>,
}

impl Planned {
    fn new(router: &Router, trace: &Recording) -> Planned {
        let mut recorded = BTreeMap::new();
        for line in trace.beside("paths").iter().flat_map(Recording::lines) {
            let [seed, id] = ["seed", "id"].map(|key| line[key].as_u64().unwrap());
            let route = router.follow(kind(&line["type"]), cells(&line["path"])).unwrap();
            recorded.insert((seed, id, line["tick"].as_i64().unwrap()), route);
        }
        let mut goals = BTreeMap::new();
        for line in trace.lines() {
            let (seed, tick) = (line["seed"].as_u64().unwrap(), line["tick"].as_i64().unwrap());
            for agent in line["agents"].as_array().unwrap() {
                goals.insert((seed, agent["id"].as_u64().unwrap(), tick), cell(&agent["goal"]));
            }
        }
        Planned { recorded, goals }
    }

    /// Whether the run has recorded routes.
    fn is_recorded(&self) -> bool {
        !self.recorded.is_empty()
    }

    /// The route that was planned in a tick, `-1` for the first. `None` if no route was recorded and the trace ends
    /// before it shows the goal.
    fn route(&self, router: &Router, key: (u64, u64, i64), kind: AgentKind, start: Cell) -> Option<Route> {
        if self.is_recorded() {
            return Some(self.recorded.get(&key).expect("a recorded route").clone());
        }
        let (seed, id, tick) = key;
        let goal = self.goals.get(&(seed, id, tick + 1))?;
        Some(router.plan(kind, start, *goal).unwrap())
    }
}

#[test]
fn agents_move_as_recorded() {
    let router = router(square_5x5());
    let places = Places::new(&router, TripEnds::Curb, Some(REGION), None);
    for recording in recordings("trace") {
        let planned = Planned::new(&router, &recording);
        let (mut moves, mut drawn, mut replans, mut unseen, mut lost) = (0, 0, 0, 0, Vec::new());
        // Without agents whose route is unknown.
        let mut agents: BTreeMap<(u64, u64), Option<Agent>> = BTreeMap::new();
        for line in recording.lines() {
            let (seed, tick) = (line["seed"].as_u64().unwrap(), line["tick"].as_i64().unwrap());
            let actions = ActionTable::default();
            let surroundings = Surroundings {
                router: &router,
                places: &places,
                actions: &actions,
                seed: Seed(seed),
                tick: tick.unsigned_abs(),
            };
            for (position, state) in line["agents"].as_array().unwrap().iter().enumerate() {
                let id = state["id"].as_u64().unwrap();
                let step = Step {
                    ego: &line["ego"][id.to_string()],
                    kind: kind(&state["type"]),
                };
                let place = format!("{}, seed {seed}, tick {tick}, {}", recording.tag, state["name"]);
                let known = agents.entry((seed, id)).or_insert_with(|| {
                    let start = cell(&state["pos"]);
                    let route = planned.route(&router, (seed, id, -1), step.kind, start).unwrap();
                    Some(Agent::new(&plain_agent(step.kind), route))
                });
                let Some(agent) = known else { continue };
                assert_eq!(
                    (agent.cell, agent.heading, agent.goal(), agent.rest),
                    (
                        cell(&state["pos"]),
                        heading(&state["dir"]),
                        cell(&state["goal"]),
                        step.rest()
                    ),
                    "{place}"
                );

                let allowed = step.allowed();
                // If a route passes a cell twice, the published program confuses the second pass with the first and
                // drives around endlessly. Our agent keeps its place; the test moves it back to continue the
                // comparison.
                let passed = (agent.route().cells().take(agent.position())).position(|cell| cell == agent.cell);
                if let (Some(first), Some(allowed)) = (passed, &allowed)
                    && agent.rest == Rest::UnderWay
                    && possible(agent) != *allowed
                {
                    let heading = agent.heading;
                    agent.set_out(router.follow(agent.kind, agent.route().cells().skip(first)).unwrap());
                    agent.heading = heading;
                    lost.push(place.clone());
                }

                let decided = step.decided();
                let by = |agent: &Agent, action| -> (Agent, Moved) {
                    let mut agent = agent.clone();
                    let moved = advance(&mut agent, position, action, &surroundings);
                    (agent, moved)
                };
                // If there are several decisions, only moves that do not depend on them.
                let action = decided.first().copied().unwrap_or(Action::Normal);
                let (mut moved_agent, mut moved) = by(agent, action);
                if moved.replanned {
                    // The goal is drawn, so the recorded route replaces ours, and the agent follows the decision on it.
                    replans += 1;
                    assert_eq!(
                        router.plan(agent.kind, agent.cell, moved_agent.goal()).as_ref(),
                        Ok(moved_agent.route())
                    );
                    let Some(route) = planned.route(&router, (seed, id, tick), agent.kind, agent.cell) else {
                        unseen += 1;
                        *known = None;
                        continue;
                    };
                    agent.set_out(route);
                    (moved_agent, moved) = by(agent, action);
                    assert!(!moved.replanned, "{place}");
                } else {
                    assert!(
                        !planned.recorded.contains_key(&(seed, id, tick)),
                        "{place}: must replan"
                    );
                }
                if let Some(allowed) = allowed {
                    assert_eq!(possible(agent), allowed, "{place}");
                }
                if moved.reason != MoveReason::Resting {
                    let to = cell(&step.ego["next"]);
                    let mut ahead = agent.route().cells().skip(agent.position());
                    let cells = ahead.position(|cell| cell == to);
                    let cells = cells.unwrap_or_else(|| panic!("{place}: {to:?} is not on its route"));
                    let choices = choices(agent, &decided);
                    assert!(choices.contains(&cells), "{place}: {cells} of {choices:?}");
                    // Each decision alone leads to one of these choices, or to a move that is possible without it.
                    for &action in &decided {
                        let (alone, moved) = by(agent, action);
                        let cells = alone.position() - agent.position();
                        let right =
                            choices.contains(&cells) || (decided.len() > 1 && moved.reason != MoveReason::Decided);
                        assert!(right, "{place}: {action:?} moves by {cells} of {choices:?}");
                        if decided.len() == 1 {
                            assert_eq!(moved.reason == MoveReason::Drawn, choices.len() > 1, "{place}");
                        }
                    }
                    drawn += usize::from(choices.len() > 1);
                    (moved_agent, _) = by(agent, action_of(agent.kind, cells));
                }
                assert_eq!(
                    (moved_agent.cell, moved_agent.heading),
                    (cell(&step.ego["next"]), heading(&step.ego["next_dir"])),
                    "{place}"
                );
                *agent = moved_agent;
                moves += 1;
            }
        }
        assert!(moves > 0, "{} is empty", recording.path.display());
        recording.report(&format!(
            "{moves} moves compared, {drawn} of them drawn; {replans} new goals"
        ));
        if unseen > 0 {
            recording.report(&format!(
                "{unseen} moves not compared: no routes recorded, and the trace ends before it shows the goal"
            ));
        }
        if !lost.is_empty() {
            recording.report(&format!("the published program lost its place on a route: {lost:?}"));
        }
    }
}
