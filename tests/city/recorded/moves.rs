//! The city against recorded runs of the published simulator.

use flate2::read::GzDecoder;
use logicity::builtin::BuiltinFiles;
use logicity::city::{
    Agent, Cell, CityMap, Ground, Heading, Lane, Places, Reason, Rest, Route, Router, Surroundings, advance,
    field_of_view, possible_cells, speed_cells,
};
use logicity::city::{AgentConfig, AgentKind, AgentName, Building, Routing, Speed};
use logicity::config::load_map;
use logicity::diag::Sources;
use logicity::rng::Seed;
use ndarray::{Array2, Array3, Axis};
use ndarray_npy::NpzReader;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;

/// The map of the paper.
fn square_5x5() -> CityMap {
    let config = load_map(&mut Sources::new(), Path::new("square-5x5"), &BuiltinFiles).expect("a built-in map");
    CityMap::generate(&config).expect("the map of the paper can be generated")
}

/// What a map says of each of its cells.
fn layer<T>(map: &CityMap, of: impl Fn(Cell) -> T) -> Array2<T> {
    let shape = (map.rows() as usize, map.cols() as usize);
    Array2::from_shape_fn(shape, |(row, col)| of(Cell::new(row as i32, col as i32)))
}

#[test]
fn the_map_is_the_recorded_one_in_every_layer() {
    let Some(folder) = crate::recorded::folder() else {
        return;
    };
    let map = square_5x5();
    let mut npz = NpzReader::new(File::open(folder.join("map_square_5x5.npz")).unwrap()).unwrap();
    let street: Array2<f32> = npz.by_name("street").unwrap();
    let building: Array2<i16> = npz.by_name("building").unwrap();
    let block: Array2<i16> = npz.by_name("block").unwrap();
    let mid_line: Array2<bool> = npz.by_name("midline").unwrap();
    let intersection: Array3<i16> = npz.by_name("intersection").unwrap();

    assert_eq!(layer(&map, |cell| map.is_mid_line(cell)), mid_line);
    let ground = street.mapv(|code| match code {
        0.0 => Ground::Other,
        1.0 => Ground::Walking,
        -1.0 => Ground::Crossing,
        _ => Ground::Traffic,
    });
    assert_eq!(layer(&map, |cell| map.ground_at(cell).unwrap()), ground);
    let building = building.mapv(|code| match code {
        3 => Some(Building::House),
        4 => Some(Building::GasStation),
        5 => Some(Building::Office),
        6 => Some(Building::Garage),
        7 => Some(Building::Store),
        _ => None,
    });
    assert_eq!(layer(&map, |cell| map.building_at(cell)), building);
    let block_of_building = |cell| {
        map.building_at(cell)
            .and_then(|_| map.layout.block_at(cell))
            .unwrap_or(0)
    };
    assert_eq!(layer(&map, block_of_building), block.mapv(|number| number as u32));
    let recorded = |mask: usize| intersection.index_axis(Axis(0), mask).mapv(|number| number as u32);
    let at = |kind| layer(&map, |cell| map.at_intersection(kind, cell).unwrap_or(0));
    assert_eq!(at(AgentKind::Car), recorded(0));
    assert_eq!(at(AgentKind::Pedestrian), recorded(1));
    assert_eq!(layer(&map, |cell| map.in_intersection(cell).unwrap_or(0)), recorded(2));
}

/// Half-width of the field of view in the recorded runs.
const HALF_WIDTH: u32 = 25;

/// Rows and columns of the region in the recorded runs.
const REGION: u32 = 120;

/// The lines of a recorded file.
fn lines(folder: &Path, name: &str) -> Vec<Value> {
    let file = File::open(folder.join(name)).unwrap();
    (BufReader::new(GzDecoder::new(file)).lines())
        .map(|line| serde_json::from_str(&line.unwrap()).unwrap())
        .collect()
}

fn cell(value: &Value) -> Cell {
    let coordinate = |index: usize| i32::try_from(value[index].as_i64().unwrap()).unwrap();
    Cell::new(coordinate(0), coordinate(1))
}

fn kind(value: &Value) -> AgentKind {
    if value == "Car" {
        AgentKind::Car
    } else {
        AgentKind::Pedestrian
    }
}

/// A recorded route.
struct Planned {
    mode: &'static str,
    seed: u64,
    tick: i64,
    id: u64,
    kind: AgentKind,
    cells: Vec<Cell>,
}

fn planned_routes(folder: &Path) -> Vec<Planned> {
    let mut routes = Vec::new();
    for mode in ["easy", "hard"] {
        for line in lines(folder, &format!("paths_{mode}.jsonl.gz")) {
            let mut cells: Vec<Cell> = line["path"].as_array().unwrap().iter().map(cell).collect();
            cells.dedup();
            assert_eq!(
                (cells[0], cells[cells.len() - 1]),
                (cell(&line["start"]), cell(&line["goal"]))
            );
            routes.push(Planned {
                mode,
                seed: line["seed"].as_u64().unwrap(),
                tick: line["tick"].as_i64().unwrap(),
                id: line["id"].as_u64().unwrap(),
                kind: kind(&line["type"]),
                cells,
            });
        }
    }
    routes
}

#[test]
fn start_cells_are_as_many_as_in_the_published_program() {
    let router = Router::new(Arc::new(square_5x5()), Routing::Weighted);
    let count = |kind| {
        [Some(60), Some(100), Some(120), Some(140), None].map(|region| Places::new(&router, region, None).count(kind))
    };
    assert_eq!(count(AgentKind::Car), [90, 160, 220, 360, 980]);
    assert_eq!(count(AgentKind::Pedestrian), [44, 352, 616, 792, 2244]);
}

#[test]
fn the_road_graph_is_that_of_the_paper() {
    let router = Router::new(Arc::new(square_5x5()), Routing::Weighted);
    let lanes: Vec<Lane> = router.lanes().collect();
    assert_eq!(lanes.len(), 120);
    assert!(lanes.iter().all(|lane| lane.length() == 26));
    let nodes: BTreeSet<Cell> = lanes.iter().flat_map(|lane| [lane.start, lane.end]).collect();
    assert_eq!(nodes.len(), 240);

    // The connectors are exactly the pairs within reach, and nothing else is near.
    let connectors: BTreeSet<(Cell, Cell)> = router
        .connectors()
        .map(|(from, to)| (lanes[from].end, lanes[to].start))
        .collect();
    assert_eq!(connectors.len(), 416);
    let near = |from: &Lane, to: &Lane| from.end.distance(to.start) <= 25.6;
    let within_reach: BTreeSet<(Cell, Cell)> = (lanes.iter())
        .flat_map(|from| {
            lanes
                .iter()
                .filter(move |to| near(from, to))
                .map(|to| (from.end, to.start))
        })
        .collect();
    assert_eq!(connectors, within_reach);
}

#[test]
fn routes_are_the_recorded_ones() {
    let Some(folder) = crate::recorded::folder() else {
        return;
    };
    let router = Router::new(Arc::new(square_5x5()), Routing::Hops);
    let weighted = Router::new(router.map().clone(), Routing::Weighted);
    let places = Places::new(&router, Some(REGION), None);
    let (mut cars, mut pedestrians) = (0, 0);
    for planned in planned_routes(&folder) {
        let (start, goal) = (planned.cells[0], planned.cells[planned.cells.len() - 1]);
        let route = router.plan(planned.kind, start, goal).unwrap();
        assert!([start, goal].iter().all(|cell| places.contains(planned.kind, *cell)));
        // Not only as many nodes or steps: the same cells.
        assert!(route.cells().eq(planned.cells.iter().copied()), "{start:?} to {goal:?}");
        let recorded = router.follow(planned.kind, planned.cells).unwrap();
        assert_eq!(route, recorded);
        let other = weighted.plan(planned.kind, start, goal).unwrap();
        match planned.kind {
            AgentKind::Car => cars += 1,
            AgentKind::Pedestrian => {
                pedestrians += 1;
                let block = |cell| router.map().layout.block_at(cell).unwrap();
                assert_ne!(block(start), block(goal));
                assert_eq!(route.steps(), other.steps(), "{start:?} to {goal:?}");
            }
        }
    }
    assert!(cars > 0 && pedestrians > 0);
    println!("{cars} routes of cars, {pedestrians} of pedestrians");
}

/// A recorded tick of one agent.
struct Step<'a> {
    agent: &'a Value,
    ego: &'a Value,
    kind: AgentKind,
}

impl Step<'_> {
    fn heading(&self) -> Option<Heading> {
        self.agent["dir"].as_str().map(|name| Heading::from_name(name).unwrap())
    }

    /// What the rules decided: the common speed of the low-level actions they allow.
    fn decided(&self) -> Speed {
        match (self.kind, self.ego["local"][0].as_u64().unwrap()) {
            (AgentKind::Pedestrian, 4) | (AgentKind::Car, 12) => Speed::Stop,
            (AgentKind::Pedestrian, _) | (AgentKind::Car, 4..8) => Speed::Normal,
            (AgentKind::Car, 0..4) => Speed::Slow,
            (AgentKind::Car, _) => Speed::Fast,
        }
    }

    fn rest(&self) -> Rest {
        match (
            self.ego["wait"][0].as_bool().unwrap(),
            self.ego["wait"][1].as_u64().unwrap(),
        ) {
            (false, _) => Rest::UnderWay,
            (true, 1) => Rest::Arrived,
            (true, _) => Rest::Rested,
        }
    }
}

#[test]
fn what_agents_see_is_recorded() {
    let Some(folder) = crate::recorded::folder() else {
        return;
    };
    let map = square_5x5();
    let mut egos = 0;
    for mode in ["easy", "hard"] {
        for line in lines(&folder, &format!("trace_{mode}.jsonl.gz")) {
            let agents = line["agents"].as_array().unwrap();
            for ego in agents {
                let heading = ego["dir"].as_str().map(|name| Heading::from_name(name).unwrap());
                let view = field_of_view(cell(&ego["pos"]), heading, HALF_WIDTH, &map);
                let others = agents
                    .iter()
                    .filter(|agent| agent["id"] != ego["id"] && view.contains(cell(&agent["pos"])));
                let seen: Vec<&Value> = [ego].into_iter().chain(others).map(|agent| &agent["id"]).collect();
                let recorded = &line["ego"][ego["id"].to_string()]["ents"];
                assert_eq!(
                    seen,
                    recorded.as_array().unwrap().iter().collect::<Vec<_>>(),
                    "{mode} {}",
                    line["tick"]
                );
                egos += 1;
            }
        }
    }
    println!("{egos} fields of view");
}

#[test]
fn agents_move_as_recorded() {
    let Some(folder) = crate::recorded::folder() else {
        return;
    };
    let router = Router::new(Arc::new(square_5x5()), Routing::Hops);
    let places = Places::new(&router, Some(REGION), None);
    let mut planned: BTreeMap<(&str, u64, u64, i64), Route> = BTreeMap::new();
    for route in planned_routes(&folder) {
        let key = (route.mode, route.seed, route.id, route.tick);
        planned.insert(key, router.follow(route.kind, route.cells).unwrap());
    }
    let (mut moves, mut replans, mut lost) = (0, 0, Vec::new());
    for mode in ["easy", "hard"] {
        let mut agents: BTreeMap<(u64, u64), Agent> = BTreeMap::new();
        for line in lines(&folder, &format!("trace_{mode}.jsonl.gz")) {
            let (seed, tick) = (line["seed"].as_u64().unwrap(), line["tick"].as_i64().unwrap());
            for (index, state) in line["agents"].as_array().unwrap().iter().enumerate() {
                let id = state["id"].as_u64().unwrap();
                let step = Step {
                    agent: state,
                    ego: &line["ego"][id.to_string()],
                    kind: kind(&state["type"]),
                };
                let place = format!("{mode}, seed {seed}, tick {tick}, {}", state["name"]);
                let agent = agents.entry((seed, id)).or_insert_with(|| {
                    let config = AgentConfig {
                        name: AgentName {
                            kind: step.kind,
                            number: 1,
                        },
                        concepts: Arc::default(),
                        priority: 0,
                    };
                    Agent::new(&config, planned[&(mode, seed, id, -1)].clone())
                });
                assert_eq!(
                    (agent.cell, agent.heading, agent.goal(), agent.rest),
                    (cell(&state["pos"]), step.heading(), cell(&state["goal"]), step.rest()),
                    "{place}"
                );

                let allowed: Option<BTreeSet<u64>> = (step.ego["global"].as_array())
                    .map(|allowed| allowed.iter().map(|action| action.as_u64().unwrap() / 4 + 1).collect());
                let possible = |agent: &Agent| -> BTreeSet<u64> { (1..=possible_cells(agent) as u64).collect() };
                // Where a route comes through a cell twice, the published program takes the second time for the first and
                // drives around again, for ever. Ours keeps its place on the route; here it is put back to go on comparing.
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
                let mut moved_agent = agent.clone();
                let surroundings = Surroundings {
                    router: &router,
                    places: &places,
                    seed: Seed(seed),
                    tick: tick.unsigned_abs(),
                };
                let moved = advance(&mut moved_agent, index, step.decided(), &surroundings);
                assert_eq!(moved.from, agent.cell);
                if moved.replanned {
                    // Where it goes is drawn; the recorded route takes the place of ours, and the decision is followed on it.
                    replans += 1;
                    assert_eq!(
                        router.plan(agent.kind, agent.cell, moved_agent.goal()).as_ref(),
                        Ok(moved_agent.route())
                    );
                    agent.set_out(planned[&(mode, seed, id, tick)].clone());
                    moved_agent = agent.clone();
                    let moved = advance(&mut moved_agent, index, step.decided(), &surroundings);
                    assert!(!moved.replanned, "{place}");
                } else {
                    assert!(
                        !planned.contains_key(&(mode, seed, id, tick)),
                        "{place}: should have replanned"
                    );
                }
                if let Some(allowed) = allowed {
                    assert_eq!(possible(agent), allowed, "{place}");
                }
                assert_ne!(moved.reason, Reason::Drawn, "{place}: nothing is drawn in these modes");
                let recorded_heading = step.ego["next_dir"]
                    .as_str()
                    .map(|name| Heading::from_name(name).unwrap());
                assert_eq!(
                    (moved_agent.cell, moved_agent.heading),
                    (cell(&step.ego["next"]), recorded_heading),
                    "{place}"
                );
                *agent = moved_agent;
                moves += 1;
            }
        }
    }
    assert!(moves > 0 && replans > 0);
    println!("{moves} moves, {replans} new goals; published program lost its place on a route: {lost:?}");
}

#[test]
fn the_controlled_car_moves_as_recorded() {
    let Some(folder) = crate::recorded::folder() else {
        return;
    };
    let router = Router::new(Arc::new(square_5x5()), Routing::Hops);
    let (mut routes, mut moves, mut drawn) = (0, 0, 0);
    for mode in ["easy", "hard"] {
        let mut ego: Option<(Agent, Speed)> = None;
        for line in lines(&folder, &format!("gym_{mode}.jsonl.gz")) {
            if line["reset"] == true {
                let mut cells: Vec<Cell> = line["path"].as_array().unwrap().iter().map(cell).collect();
                let route = router
                    .plan(AgentKind::Car, cell(&line["start"]), cell(&line["goal"]))
                    .unwrap();
                assert_eq!(4 * cells.len() as u64, line["path_length4"].as_u64().unwrap());
                cells.dedup();
                assert!(route.cells().eq(cells));
                let config = AgentConfig {
                    name: AgentName {
                        kind: AgentKind::Car,
                        number: 1,
                    },
                    concepts: Arc::default(),
                    priority: 0,
                };
                ego = Some((Agent::new(&config, route), Speed::Stop));
                routes += 1;
                continue;
            }
            let (Some(state), Some((agent, decided))) = (line["agents"].get(0), ego.as_mut()) else {
                continue;
            };
            let to = cell(&state["pos"]);
            let most = possible_cells(agent);
            let ahead: Vec<Cell> = agent.route().cells().skip(agent.position()).take(most + 1).collect();
            let cells = ahead.iter().position(|&cell| cell == to).expect("a possible move");
            match (*decided, speed_cells(agent.kind, *decided)) {
                (Speed::Stop, _) => assert_eq!(cells, 0),
                (_, Some(wanted)) if wanted <= most => assert_eq!(cells, wanted),
                _ if most == 1 => assert_eq!(cells, 1),
                _ => {
                    assert_ne!(cells, 0);
                    drawn += 1;
                }
            }
            let heading = state["dir"].as_str().map(|name| Heading::from_name(name).unwrap());
            let before = agent.heading;
            let rest = router
                .follow(agent.kind, agent.route().cells().skip(agent.position() + cells))
                .unwrap();
            agent.set_out(rest);
            agent.heading = Heading::between(ahead[0], to).or(before);
            assert_eq!(agent.heading, heading);
            *decided = Speed::ALL[usize::try_from(line["action"].as_u64().unwrap()).unwrap()];
            moves += 1;
        }
    }
    assert!(routes > 0 && moves > 0);
    println!("{routes} routes, {moves} moves of the controlled car, {drawn} of them drawn");
}
