//! Road networks: their import from SUMO, their raster, routes on them, and agents that follow these.
//!
//! The files in `tests/fixtures/networks` were made by netgenerate and netconvert 1.28 (PyPI `eclipse-sumo`): grids of
//! each type of junction, spiders, random networks, and three networks with nodes and edges of our own (t-junction,
//! five-arms, roundabout).

use crate::agreement::{go_the_same_way, simulation};
use crate::cases::cases;
use crate::config::load_memory_map;
use crate::shipped_world::{configured, world};
use logicity::city::{Action, ActionTable};
use logicity::city::{
    Agent, AgentConfig, AgentKind, AgentName, Aspect, Cell, CityMap, Direction, Ground, LaneUse, Light, MapConfig,
    Network, NoRoute, Places, Point, RightOfWay, RoadLane, Router, Routing, Sign, SignalLink, Split, Surroundings,
    Terrain, TripEnds, advance, possible_cells,
};
use logicity::diag::{Diagnostic, Sources};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Executor, Settings, Simulation};
use logicity::sumo;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

const NETWORKS: [&str; 13] = [
    "five-arms",
    "grid-all-way-stop",
    "grid-priority",
    "grid-right",
    "grid-signals",
    "grid-walks",
    "random-3",
    "random-4",
    "random-5",
    "roundabout",
    "spider-3",
    "spider-5",
    "t-junction",
];

fn text_of(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/networks/{name}.net.xml"));
    fs::read_to_string(path).unwrap()
}

fn import(text: &str, cell: f64) -> Result<Network, Diagnostic> {
    let mut sources = Sources::new();
    let source = sources.add("town.net.xml", text);
    sumo::import(&sources, source, cell).map(|imported| imported.network)
}

/// The map of a network, by way of its map file.
fn map_of(name: &str, cell: f64) -> (Arc<CityMap>, Network) {
    let network = import(&text_of(name), cell).unwrap();
    let config = load_memory_map(&sumo::map_file(&network)).unwrap_or_else(|faults| panic!("{name}: {faults:?}"));
    (Arc::new(CityMap::generate(&config).unwrap()), network)
}

fn number_of(network: &Network, lane: &str) -> usize {
    network
        .lanes
        .iter()
        .position(|known| known.name == lane)
        .unwrap_or_else(|| panic!("no lane {lane}"))
}

#[test]
fn a_map_file_holds_the_whole_network() {
    for name in NETWORKS {
        let network = import(&text_of(name), 1.0).unwrap();
        let config: MapConfig = load_memory_map(&sumo::map_file(&network)).unwrap();
        let Terrain::Roads { roads } = &config.terrain else {
            panic!("no roads")
        };
        let json = |network: &Network| serde_json::to_string(network).unwrap();
        assert_eq!(json(&roads.value), json(&network), "{name}");
    }
}

#[test]
fn each_lane_and_each_connection_is_on_the_ground() {
    let mut counts = [0; 4];
    for name in NETWORKS {
        for cell in [0.8, 1.0, 2.5] {
            let (map, network) = map_of(name, cell);
            for lane in &network.lanes {
                for point in &lane.shape {
                    let at = Cell::new(point.y as i32, point.x as i32);
                    let ground = map.ground_at(at).unwrap();
                    match lane.usage {
                        LaneUse::Drive => assert!(map.is_drivable(at), "{name} {} {at:?} {ground:?}", lane.name),
                        LaneUse::Walk => assert!(map.is_walkable(at), "{name} {} {at:?} {ground:?}", lane.name),
                        LaneUse::Crossing | LaneUse::Place => {}
                    }
                    counts[ground as usize] += 1;
                }
            }
        }
    }
    assert!(
        counts[Ground::Traffic as usize] > 1000 && counts[Ground::Walking as usize] > 50,
        "{counts:?}"
    );
}

#[test]
fn routes_of_cars_lead_along_lanes_and_connections() {
    let mut planned = 0;
    // It has no way back.
    for name in NETWORKS.into_iter().filter(|name| *name != "grid-walks") {
        for routing in Routing::ALL {
            let (map, _) = map_of(name, 1.0);
            let router = Router::new(Arc::clone(&map), routing);
            let places = Places::new(&router, TripEnds::Curb, None, None);
            let count = places.count(AgentKind::Car);
            assert!(count > 50, "{name}: {count} places");
            let mut random = Seed(1).stream(Purpose::TEST, 0, 0);
            for _ in 0..60 {
                let [start, goal] =
                    [(); 2].map(|()| places.nth(AgentKind::Car, random.random_range(0..count)).unwrap());
                // Cars start and arrive where they can drive on.
                let route =
                    (router.plan(AgentKind::Car, start, goal)).unwrap_or_else(|_| panic!("{name}: {start:?} {goal:?}"));
                let cells: Vec<Cell> = route.cells().collect();
                assert_eq!((cells[0], *cells.last().unwrap()), (start, goal));
                for pair in cells.windows(2) {
                    assert_eq!(pair[0].row.abs_diff(pair[1].row) + pair[0].col.abs_diff(pair[1].col), 1);
                }
                assert!(cells.iter().all(|&cell| map.is_drivable(cell)), "{name}");
                assert_eq!(router.follow(AgentKind::Car, cells.iter().copied()), Some(route));
                planned += 1;
            }
        }
    }
    assert!(planned > 1000, "{planned}");
}

/// Cars start and arrive on lanes that lead to each other, and on all of these.
#[test]
fn places_of_cars_lead_to_each_other() {
    let mut left_out = 0;
    for name in NETWORKS {
        let (map, network) = map_of(name, 1.0);
        let places = Places::new(
            &Router::new(Arc::clone(&map), Routing::ALL[0]),
            TripEnds::Curb,
            None,
            None,
        );
        // By closure: which lane leads to which.
        let count = network.lanes.len();
        let mut leads = vec![vec![false; count]; count];
        for way in &network.connections {
            leads[way.from as usize][way.to as usize] = true;
        }
        for (lane, number) in network.lanes.iter().zip(0..) {
            if let Some(left) = lane.left {
                (leads[number][left as usize], leads[left as usize][number]) = (true, true);
            }
        }
        for by in 0..count {
            for from in 0..count {
                for to in 0..count {
                    leads[from][to] |= leads[from][by] && leads[by][to];
                }
            }
        }
        if !(0..count).any(|lane| leads[lane][lane]) {
            assert_eq!(name, "grid-walks");
            continue;
        }
        let has_places: Vec<bool> = (network.lanes.iter())
            .map(|lane| {
                let [from, to] = [lane.shape[0], lane.shape[1]];
                let middle = Cell::new(((from.y + to.y) / 2.0) as i32, ((from.x + to.x) / 2.0) as i32);
                lane.usage == LaneUse::Drive && places.contains(AgentKind::Car, middle)
            })
            .collect();
        let of_cars = (0..count).filter(|&lane| has_places[lane]);
        for (one, other) in of_cars
            .clone()
            .flat_map(|one| of_cars.clone().map(move |other| (one, other)))
        {
            assert!(
                leads[one][other],
                "{name}: {} {}",
                network.lanes[one].name, network.lanes[other].name
            );
        }
        for lane in 0..count {
            let drives = network.lanes[lane].usage == LaneUse::Drive;
            let circulates = of_cars.clone().any(|other| leads[lane][other] && leads[other][lane]);
            left_out += usize::from(drives && !circulates);
            // Lanes of a few cells have no places.
            let [from, to] = [network.lanes[lane].shape[0], network.lanes[lane].shape[1]];
            if drives && network.lanes[lane].shape.len() == 2 && (from.x - to.x).hypot(from.y - to.y) > 12.0 {
                assert_eq!(has_places[lane], circulates, "{name}: {}", network.lanes[lane].name);
            }
        }
    }
    assert!(left_out > 0, "{left_out}");
}

/// The cost of a turn in cells, as `docs/decisions/city.md` gives it.
const TURN_COST: usize = 30;

/// The places of each cell on lanes for cars.
fn places_on_lanes(map: &CityMap, network: &Network) -> BTreeMap<Cell, Vec<(usize, usize)>> {
    let mut places: BTreeMap<Cell, Vec<(usize, usize)>> = BTreeMap::new();
    for lane in 0..network.lanes.len() {
        for (at, &cell) in map.lane_cells(lane).iter().enumerate() {
            places.entry(cell).or_default().push((lane, at));
        }
    }
    places
}

/// The least cost from one place on a lane to another, by relaxing all connections until nothing changes. For networks
/// without lanes side by side.
fn least_cost(map: &CityMap, network: &Network, from: (usize, usize), to: (usize, usize)) -> Option<usize> {
    let mut at_start = vec![None; network.lanes.len()];
    loop {
        let mut changed = false;
        for (number, connection) in network.connections.iter().enumerate() {
            let [lane, next] = [connection.from, connection.to].map(|lane| lane as usize);
            let last = map.lane_cells(lane).len() - 1;
            let here = (lane == from.0).then(|| last - from.1);
            let behind = at_start[lane].map(|cost: usize| cost + last);
            let Some(at_end) = here.into_iter().chain(behind).min() else {
                continue;
            };
            let turn = if connection.direction == Direction::Straight {
                0
            } else {
                TURN_COST
            };
            let cost = at_end + map.connection_cells(number).len() + 1 + turn;
            if at_start[next].is_none_or(|known| cost < known) {
                at_start[next] = Some(cost);
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    let direct = (from.0 == to.0 && from.1 <= to.1).then(|| to.1 - from.1);
    direct.into_iter().chain(at_start[to.0].map(|cost| cost + to.1)).min()
}

/// The cost of a route: its steps and its turns, which its connections show.
fn cost_of(map: &CityMap, network: &Network, cells: &[Cell], from: (usize, usize)) -> usize {
    let (mut lane, mut at, mut place) = (from.0, 0, from.1);
    let mut turns = 0;
    loop {
        let path = &map.lane_cells(lane)[place..];
        if cells.len() - at <= path.len() && path.starts_with(&cells[at..]) {
            return cells.len() - 1 + TURN_COST * turns;
        }
        assert!(cells[at..].starts_with(path), "the route leaves a lane before its end");
        at += path.len();
        let taken = (network.connections.iter().enumerate()).filter(|(_, connection)| connection.from as usize == lane);
        let next = taken.filter(|(number, connection)| {
            let start = &map.lane_cells(connection.to as usize)[..1];
            let link: Vec<Cell> = map.connection_cells(*number).iter().chain(start).copied().collect();
            cells[at..].starts_with(&link)
        });
        // Of several with the same cells, the cheapest.
        let (number, connection) = next
            .min_by_key(|(_, connection)| connection.direction != Direction::Straight)
            .unwrap();
        turns += usize::from(connection.direction != Direction::Straight);
        at += map.connection_cells(number).len();
        (lane, place) = (connection.to as usize, 0);
    }
}

#[test]
fn routes_have_the_least_cost() {
    let (mut drawn, mut compared) = (0, 0);
    for name in NETWORKS {
        let (map, network) = map_of(name, 1.0);
        if network.lanes.iter().any(|lane| lane.left.is_some()) {
            continue;
        }
        let router = Router::new(Arc::clone(&map), Routing::Weighted);
        let places = Places::new(&router, TripEnds::Curb, None, None);
        let on_lanes = places_on_lanes(&map, &network);
        let mut random = Seed(2).stream(Purpose::TEST, 0, 0);
        let count = places.count(AgentKind::Car);
        for _ in 0..cases(40).cases {
            drawn += 1;
            let ends = [(); 2].map(|()| places.nth(AgentKind::Car, random.random_range(0..count)).unwrap());
            let [start, goal] = ends;
            // A cell may be on the paths of two lanes, and belongs to one.
            let ([from], [to]) = (&on_lanes[&start][..], &on_lanes[&goal][..]) else {
                continue;
            };
            let (from, to) = (*from, *to);
            if start == goal {
                continue;
            }
            let found = router.plan(AgentKind::Car, start, goal);
            match least_cost(&map, &network, from, to) {
                None => assert_eq!(found, Err(NoRoute::Unconnected), "{name}"),
                Some(least) => {
                    let cells: Vec<Cell> = found.unwrap().cells().collect();
                    assert_eq!(
                        cost_of(&map, &network, &cells, from),
                        least,
                        "{name} {start:?} {goal:?}"
                    );
                    compared += 1;
                }
            }
        }
    }
    assert!(2 * compared > drawn, "{compared} of {drawn}");
}

#[test]
fn pedestrians_reach_all_sides_of_a_junction_over_crossings() {
    for name in ["five-arms", "grid-walks", "roundabout", "t-junction"] {
        let (map, network) = map_of(name, 1.0);
        let router = Router::new(Arc::clone(&map), Routing::Weighted);
        let places = Places::new(&router, TripEnds::Curb, None, None);
        let count = places.count(AgentKind::Pedestrian);
        assert!(count > 100, "{name}: {count}");
        let mut random = Seed(3).stream(Purpose::TEST, 0, 0);
        let (mut reached, mut crossed) = (0, 0);
        for _ in 0..40 {
            let [start, goal] = [(); 2].map(|()| {
                places
                    .nth(AgentKind::Pedestrian, random.random_range(0..count))
                    .unwrap()
            });
            let Ok(route) = router.plan(AgentKind::Pedestrian, start, goal) else {
                continue;
            };
            reached += 1;
            assert!(route.cells().all(|cell| map.is_walkable(cell)));
            crossed += usize::from(route.cells().any(|cell| map.ground_at(cell) == Some(Ground::Crossing)));
        }
        assert!(network.lanes.iter().any(|lane| lane.usage == LaneUse::Crossing));
        assert!(
            reached >= 30 && crossed >= 8,
            "{name}: {reached} reached, {crossed} over a crossing"
        );
    }
}

#[test]
fn intersections_are_where_ways_meet() {
    let counts: Vec<(&str, u32)> = NETWORKS
        .iter()
        .map(|name| (*name, map_of(name, 1.0).0.intersections()))
        .collect();
    let of = |wanted: &str| counts.iter().find(|(name, _)| *name == wanted).unwrap().1;
    assert_eq!(of("t-junction"), 1);
    assert_eq!(of("five-arms"), 1);
    assert_eq!(of("roundabout"), 4);
    assert_eq!(of("grid-right"), 4);
    for name in NETWORKS {
        let (map, network) = map_of(name, 1.0);
        let mut at = 0;
        for (number, lane) in network.lanes.iter().enumerate() {
            let Some(&end) = map.lane_cells(number).last() else {
                continue;
            };
            let intersection = map.at_intersection(AgentKind::Car, end);
            assert_eq!(map.in_intersection(end), None, "{name} {}", lane.name);
            at += usize::from(intersection.is_some());
        }
        assert!(at > 1, "{name}: {at} lanes end at an intersection");
    }
}

#[test]
fn lanes_yield_as_their_signs_say() {
    let (map, network) = map_of("t-junction", 1.0);
    let end = |lane: &str| *map.lane_cells(number_of(&network, lane)).last().unwrap();
    let drive = |edge: &str| {
        let lane = network
            .lanes
            .iter()
            .find(|lane| lane.usage == LaneUse::Drive && lane.name.starts_with(edge));
        end(&lane.unwrap().name)
    };
    let [west, east, south] = ["in_west", "in_east", "in_south"].map(drive);
    assert!(map.must_yield(south, west) && map.must_yield(south, east));
    assert!(!map.must_yield(west, south) && !map.must_yield(east, south));
    assert!(map.signs_ahead(south).all(|sign| sign == Sign::Yield));
    assert!(map.signs_ahead(west).any(|sign| sign == Sign::Priority));
}

/// An agent on a route.
fn agent(router: &Router, places: &Places, kind: AgentKind, seed: u64) -> Option<Agent> {
    let mut random = Seed(seed).stream(Purpose::TEST, 1, 0);
    let start = places.nth(kind, random.random_range(0..places.count(kind)))?;
    let route = places.draw_route(router, kind, start, &mut random).ok()?;
    let config = AgentConfig {
        name: AgentName::standard(kind, 1),
        concepts: Arc::default(),
        priority: 1,
    };
    Some(Agent::new(&config, route))
}

#[test]
fn moves_follow_lanes_and_end_on_nodes() {
    let (mut moves, mut fast, mut bent) = (0, 0, 0);
    for name in NETWORKS {
        let (map, _) = map_of(name, 1.0);
        let router = Router::new(Arc::clone(&map), Routing::Weighted);
        let places = Places::new(&router, TripEnds::Curb, None, None);
        let actions = ActionTable::default();
        for seed in 0..6 {
            let Some(mut agent) = agent(&router, &places, AgentKind::Car, seed) else {
                continue;
            };
            for tick in 0..200 {
                let before = (agent.position(), agent.route().clone());
                let most = possible_cells(&agent, &actions);
                let surroundings = Surroundings {
                    router: &router,
                    places: &places,
                    actions: &actions,
                    seed: Seed(seed),
                    tick,
                };
                let action = [Action::Fast, Action::Normal, Action::Slow][tick as usize % 3];
                let moved = advance(&mut agent, 0, action, &surroundings);
                if moved.replanned || moved.cells() == 0 {
                    continue;
                }
                let (position, route) = before;
                let way: Vec<Cell> = route.cells().skip(position).take(moved.cells() as usize + 1).collect();
                assert_eq!((way[0], *way.last().unwrap()), (moved.from, moved.to), "{name}");
                assert!(moved.cells() as usize <= most.max(1));
                let inner = &way[1..way.len() - 1];
                assert!(
                    inner.iter().all(|&cell| !map.is_lane_node(cell)),
                    "{name}: a move jumps over a node"
                );
                moves += 1;
                fast += usize::from(moved.cells() == 3);
                bent += usize::from(moved.from.row != moved.to.row && moved.from.col != moved.to.col);
            }
        }
    }
    assert!(moves > 5_000 && fast > 1_000 && bent > 100, "{moves} {fast} {bent}");
}

#[test]
fn executors_agree_on_a_road_network() {
    let map = load_memory_map(&sumo::map_file(&import(&text_of("roundabout"), 1.0).unwrap())).unwrap();
    for mode in ["easy", "expert"] {
        let world = world(mode, None, |scenario| {
            scenario.map = map.clone();
            scenario.splits.iter_mut().for_each(|(_, set)| set.region = None);
        });
        let executors = [Executor::Dense, Executor::Relational];
        go_the_same_way(&mut executors.map(|executor| simulation(&world, executor, 1)), 150);
    }
}

#[test]
fn broken_networks_are_refused_with_their_place() {
    let town = text_of("t-junction");
    let line_of = |text: &str, fault: &Diagnostic| {
        let mut sources = Sources::new();
        let source = sources.add("town.net.xml", text);
        let _ = source;
        let label = fault.primary.as_ref().expect("a place");
        sources.position(label.span).line
    };
    let refused = |change: &dyn Fn(&str) -> String, expected: &str, at: &str| {
        let text = change(&town);
        let fault = import(&text, 1.0).expect_err(expected);
        assert!(fault.message.contains(expected), "{}", fault.message);
        let line = text.lines().position(|line| line.contains(at)).map(|line| line + 1);
        assert_eq!(Some(line_of(&text, &fault)), line, "{expected}");
        assert!(!fault.help.is_empty());
    };
    let replaced = |from: &'static str, to: &'static str| move |text: &str| text.replacen(from, to, 1);
    refused(&replaced("</net>", ""), "not well-formed XML", "<?xml");
    refused(&replaced("<net ", "<road "), "not well-formed XML", "</net>");
    refused(
        &|text| text.replace("<net ", "<osm ").replace("</net>", "</osm>"),
        "no network of SUMO",
        "<osm ",
    );
    refused(
        &replaced("to=\"middle\"", "to=\"nowhere\""),
        "a junction that the network does not have",
        "nowhere",
    );
    refused(&replaced("shape=\"", "shape=\"oops "), "no point at `oops`", "oops");
    refused(&replaced("via=\":middle_0_0\"", "via=\":gone\""), "`:gone`", ":gone");
    refused(
        &replaced("<lane id=\"in_west_0\"", "<lane name=\"in_west_0\""),
        "no attribute `id`",
        "<lane name=",
    );
    // No cut makes it panic.
    for end in (0..town.len()).step_by(211) {
        let _ = import(&town[..end], 1.0).is_err();
    }
}

/// `map export` writes what `map import` reads: the network comes back the same.
#[test]
fn networks_come_back_from_their_export() {
    for name in NETWORKS {
        for cell in [1.0, 2.5] {
            let network = import(&text_of(name), cell).unwrap();
            let back = import(&sumo::network_file(&network), cell).unwrap();
            assert_eq!((back.size, back.origin), (network.size, network.origin), "{name}");
            let near = |one: &[Point], other: &[Point]| {
                let pairs = || one.iter().zip(other);
                one.len() == other.len() && pairs().all(|(a, b)| (a.x - b.x).hypot(a.y - b.y) < 0.02)
            };
            let junctions = |network: &Network| {
                network
                    .junctions
                    .iter()
                    .map(|known| known.name.clone())
                    .collect::<Vec<_>>()
            };
            assert_eq!(junctions(&back), junctions(&network), "{name}");
            let lanes = |network: &Network| -> BTreeMap<String, RoadLane> {
                network
                    .lanes
                    .iter()
                    .map(|lane| (lane.name.clone(), lane.clone()))
                    .collect()
            };
            let (lanes, others) = (lanes(&network), lanes(&back));
            assert!(lanes.keys().eq(others.keys()), "{name}");
            let place =
                |network: &Network, lane: Option<u32>| lane.map(|lane| network.lanes[lane as usize].name.clone());
            let end =
                |network: &Network, lane: &RoadLane| lane.to.map(|to| network.junctions[to as usize].name.clone());
            for (lane, other) in lanes.values().zip(others.values()) {
                assert_eq!(
                    (lane.usage, lane.limit),
                    (other.usage, other.limit),
                    "{name} {}",
                    lane.name
                );
                assert_eq!(
                    place(&network, lane.left),
                    place(&back, other.left),
                    "{name} {}",
                    lane.name
                );
                if lane.usage == LaneUse::Drive {
                    assert_eq!(end(&network, lane), end(&back, other), "{name} {}", lane.name);
                }
                assert!(near(&lane.shape, &other.shape), "{name} {}", lane.name);
                assert!((lane.width - other.width).abs() < 0.02, "{name} {}", lane.name);
            }
            let ways = |network: &Network| -> Vec<(String, Direction, Sign, Vec<String>)> {
                let ends = |at: u32| {
                    let way = &network.connections[at as usize];
                    let [from, to] = [way.from, way.to].map(|lane| &network.lanes[lane as usize].name);
                    format!("{from}>{to}")
                };
                (network.connections.iter().zip(0..))
                    .map(|(way, at)| {
                        let foes = way.yields_to.iter().map(|&foe| ends(foe)).collect();
                        (ends(at), way.direction, way.sign, foes)
                    })
                    .collect()
            };
            assert_eq!(ways(&back), ways(&network), "{name}");
            assert_eq!(back.signals, network.signals, "{name}");
            let lights = |network: &Network| network.connections.iter().map(|way| way.light).collect::<Vec<_>>();
            assert_eq!(lights(&back), lights(&network), "{name}");
            for (way, other) in network.connections.iter().zip(&back.connections) {
                // Longer cells round more, so a point may be near enough to the line to be left out now.
                let is_shorter = cell > 1.0 && other.shape.len() < way.shape.len();
                assert!(near(&way.shape, &other.shape) || is_shorter, "{name}");
            }
        }
    }
}

/// Floating car data of a run have the positions of all agents: cells come back from them, and angles follow lanes.
#[test]
fn runs_are_written_as_positions() {
    let world = world("configs/right-of-way-roads.yaml", None, |_| ());
    let map = world.map();
    let network = map.network().unwrap();
    let plane = sumo::Plane {
        cell: network.cell,
        origin: network.origin,
        tick: 0.5,
    };
    let mut city = simulation(&world, Executor::Auto, 1);
    let mut writer = sumo::FcdWriter::new(Vec::new(), map, plane).unwrap();
    let mut cells: Vec<Cell> = Vec::new();
    for tick in 0..40 {
        let before: Vec<(String, Cell)> = (city.agents().iter())
            .map(|agent| (agent.name().to_string(), agent.cell))
            .collect();
        city.tick(&[]).unwrap();
        let moving = before
            .iter()
            .zip(city.agents())
            .map(|((name, at), agent)| sumo::Moving {
                name,
                trip: 0,
                kind_name: "Car",
                kind: AgentKind::Car,
                at: *at,
                next: agent.cell,
                heading: agent.heading,
            });
        writer.tick(tick, moving).unwrap();
        cells.extend(city.agents().iter().map(|agent| agent.cell));
    }
    let text = String::from_utf8(writer.finish().unwrap()).unwrap();
    let value = |line: &str, key: &str| -> f64 {
        let (_, rest) = line.split_once(&format!(" {key}=\"")).unwrap();
        rest.split_once('"').unwrap().0.parse().unwrap()
    };
    assert_eq!(text.matches("<timestep time=").count(), 40);
    assert!(text.contains("<timestep time=\"19.50\">"));
    let vehicles: Vec<&str> = text.lines().filter(|line| line.contains("<vehicle ")).collect();
    assert_eq!(vehicles.len(), cells.len());
    let mut on_lanes = 0;
    for (line, cell) in vehicles.into_iter().zip(cells) {
        let [left, top] = network.origin;
        let (col, row) = (
            (value(line, "x") - left) / network.cell,
            (top - value(line, "y")) / network.cell,
        );
        // Cars on lanes are written on the middle of these.
        let away = (row - f64::from(cell.row) - 0.5).hypot(col - f64::from(cell.col) - 0.5);
        let is_on_lane = line.contains(" lane=");
        assert!(away <= if is_on_lane { 1.0 } else { 0.01 }, "{line}");
        if let Some(facing) = map.lane_at(cell).filter(|_| is_on_lane) {
            let angle = match facing {
                logicity::city::Heading::Up => 0.0,
                logicity::city::Heading::Right => 90.0,
                logicity::city::Heading::Down => 180.0,
                logicity::city::Heading::Left => 270.0_f64,
            };
            let apart = (value(line, "angle") - angle).rem_euclid(360.0);
            assert!(apart.min(360.0 - apart) <= 60.0, "{line} {facing:?}");
            on_lanes += 1;
        }
    }
    assert!(on_lanes > 200, "{on_lanes}");
}

/// The light of each connection is the letter that the file of SUMO has for its link at that second, counted second by
/// second.
#[test]
fn signals_have_the_phases_of_sumo() {
    let text = text_of("grid-signals");
    // Another cycle for one signal, and an offset.
    let text = text.replacen("offset=\"0\"", "offset=\"-7\"", 1);
    let document = roxmltree::Document::parse(&text).unwrap();
    let mut programs: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for node in document.descendants().filter(|node| node.has_tag_name("tlLogic")) {
        let mut seconds: Vec<&str> = Vec::new();
        for phase in node.children().filter(|node| node.has_tag_name("phase")) {
            let duration: usize = phase.attribute("duration").unwrap().parse().unwrap();
            seconds.extend(vec![phase.attribute("state").unwrap(); duration]);
        }
        let offset: i64 = node.attribute("offset").unwrap().parse().unwrap();
        let length = seconds.len() as i64;
        seconds.rotate_right(offset.rem_euclid(length) as usize);
        programs.insert(node.attribute("id").unwrap(), seconds);
    }
    let network = import(&text, 1.0).unwrap();
    let config = load_memory_map(&sumo::map_file(&network)).unwrap();
    let map = CityMap::generate(&config).unwrap();
    let mut seen = BTreeMap::new();
    for node in document.descendants().filter(|node| node.has_tag_name("connection")) {
        let Some(signal) = node.attribute("tl") else { continue };
        let link: usize = node.attribute("linkIndex").unwrap().parse().unwrap();
        let lane = |edge, lane| format!("{}_{}", node.attribute(edge).unwrap(), node.attribute(lane).unwrap());
        let [from, to] = [lane("from", "fromLane"), lane("to", "toLane")].map(|name| number_of(&network, &name));
        let way = network
            .connections
            .iter()
            .find(|way| [way.from, way.to] == [from as u32, to as u32]);
        let way = way.unwrap();
        // Where it is the only connection in its direction, a car on its lane sees its light.
        let [at, next] = [network.lanes[from].shape.last(), network.lanes[to].shape.first()]
            .map(|point| Cell::new(point.unwrap().y as i32, point.unwrap().x as i32));
        let exit = map.lane_at(next);
        let rivals = network.connections.iter().filter(|other| {
            let first = network.lanes[other.to as usize].shape[0];
            other.from == way.from && map.lane_at(Cell::new(first.y as i32, first.x as i32)) == exit
        });
        let is_alone = rivals.count() == 1;
        for second in 0..300_usize {
            let program = &programs[signal];
            let letter = program[second % program.len()].chars().nth(link).unwrap();
            let shown = way.light.unwrap();
            let aspect = network.signals[shown.signal as usize].aspect(shown.link, second as u64);
            assert_eq!(aspect.map(Aspect::letter), Some(letter), "{signal} {link} {second}");
            if is_alone && map.lane_at(at).is_some() && exit.is_some() {
                let light = map.light(AgentKind::Car, at, exit, second as u64);
                let expected = match letter {
                    'r' => Light::Red,
                    'y' => Light::Yellow,
                    _ => Light::Green,
                };
                assert_eq!(light, Some(expected), "{signal} {link} {second}");
                *seen.entry(letter).or_insert(0) += 1;
            }
        }
    }
    assert!(seen.len() >= 3 && seen.values().all(|count| *count > 100), "{seen:?}");
}

/// Both executors read the lights, and cars wait at red ones.
#[test]
fn cars_wait_at_red_lights() {
    let network = import(&text_of("grid-signals"), 1.0).unwrap();
    let rules = "Stop(X) :- IsAtInter(X), SeesRed(X).\nStop(X) :- IsAtInter(X), SeesYellow(X).";
    let rules = format!(".include \"right-of-way-roads.dl\"\n{rules}");
    let config = load_memory_map(&sumo::map_file(&network)).unwrap();
    let (world, _) = configured("base: right-of-way-roads\nrules: mine.dl", &rules, |scenario| {
        scenario.map = config.clone();
    });
    let mut cities = [Executor::Relational, Executor::Dense].map(|executor| simulation(&world, executor, 1));
    go_the_same_way(&mut cities, 60);
    let [_, mut city] = cities;
    let (mut waits, mut crossings) = (0, 0);
    for tick in 60..400 {
        let before = city.agents().to_vec();
        city.tick(&[]).unwrap();
        for (agent, after) in before.iter().zip(city.agents()) {
            if world.map().at_intersection(agent.kind, agent.cell).is_none() {
                continue;
            }
            let light = world.map().light(agent.kind, agent.cell, agent.exit(world.map()), tick);
            match light {
                Some(Light::Red | Light::Yellow) => {
                    assert_eq!(agent.cell, after.cell, "tick {tick}");
                    waits += 1;
                }
                Some(Light::Green) => crossings += usize::from(agent.cell != after.cell),
                None => {}
            }
        }
    }
    assert!(waits > 50 && crossings > 20, "{waits} {crossings}");
}

#[test]
fn faults_of_signals_name_what_is_wrong() {
    let town = text_of("grid-signals");
    let faults = |text: &str| match import(text, 1.0) {
        Ok(network) => match load_memory_map(&sumo::map_file(&network)) {
            Ok(_) => panic!("accepted"),
            Err(faults) => faults[0].message.clone(),
        },
        Err(fault) => fault.message,
    };
    let cut = |from: &str, to: &str| {
        assert!(town.contains(from), "{from}");
        town.replacen(from, to, 1)
    };
    let cases = [
        (cut("<phase duration=\"", "<phase duration=\"0 "), "is no number"),
        (cut("<phase duration=\"42", "<phase duration=\"0"), "is not from 1 to"),
        (
            cut("<phase duration=\"42\" state=\"", "<phase duration=\"42\" state=\"?"),
            "no letters of lights",
        ),
        (
            cut("<phase duration=\"3\"  state=\"", "<phase duration=\"3\" state=\"r"),
            "different numbers of links",
        ),
        (cut("offset=\"0\"", "offset=\"soon\""), "is no number"),
        (cut("linkIndex=\"0\"", "linkIndex=\"77\""), "has no link `77`"),
    ];
    for (text, expected) in cases {
        let message = faults(&text);
        assert!(message.contains(expected), "{message}");
    }
    let map = sumo::map_file(&import(&town, 1.0).unwrap());
    let line = map.lines().find(|line| line.contains(" 42:")).unwrap().trim();
    let name = line.trim_start_matches("- \"").split(' ').next().unwrap();
    let light = map.split(" light=").nth(1).unwrap().split(' ').next().unwrap();
    let cases = [
        (map.replacen(" 42:", " 0:", 1), "is no phase"),
        (map.replacen(" 42:", " 42:x", 1), "is no phase"),
        (map.replacen(" 3:", " 3:r", 1), "the first one has"),
        (
            map.replacen(line, &format!("- \"{name}\""), 1),
            "the signal has no phase",
        ),
        (
            map.replacen(line, &format!("- \"{name} offset=x 4:r\""), 1),
            "is no offset",
        ),
        (
            map.replacen(&format!("light={light}"), "light=nowhere:0", 1),
            "has no signal `nowhere`",
        ),
        (
            map.replacen(&format!("light={light}"), "light=nowhere", 1),
            "names no link",
        ),
        (
            map.replacen(&format!("light={light}"), &format!("light={name}:99"), 1),
            "has no link `99`",
        ),
    ];
    for (text, expected) in cases {
        let faults = load_memory_map(&text).unwrap_err();
        assert!(
            faults[0].message.contains(expected),
            "{expected}: {}",
            faults[0].message
        );
    }
}

/// Networks side by side keep their lanes, ways and signals, and nothing leads from one to another.
#[test]
fn networks_stand_side_by_side() {
    let names = ["grid-signals", "roundabout", "spider-3"];
    let parts = names.map(|name| import(&text_of(name), 1.0).unwrap());
    let mut all = Network {
        size: [0, 0],
        junctions: Vec::new(),
        lanes: Vec::new(),
        connections: Vec::new(),
        signals: Vec::new(),
        ..parts[0].clone()
    };
    let mut spans = Vec::new();
    for (part, prefix) in parts.iter().zip(["a.", "b.", "c."]) {
        spans.push(all.place_beside(part.clone(), 20, prefix));
    }
    let config = load_memory_map(&sumo::map_file(&all)).unwrap();
    assert_eq!(
        serde_json::to_string(&all).unwrap(),
        match &config.terrain {
            Terrain::Roads { roads } => serde_json::to_string(&roads.value).unwrap(),
            Terrain::Blocks(_) => panic!("no roads"),
        }
    );
    let (mut lanes, mut ways) = (all.lanes.iter(), all.connections.iter());
    for ((part, prefix), [rows, cols]) in parts.iter().zip(["a.", "b.", "c."]).zip(&spans) {
        assert_eq!([rows.len(), cols.len()], part.size.map(|side| side as usize));
        for lane in &part.lanes {
            let moved = lanes.next().unwrap();
            assert_eq!(moved.name, format!("{prefix}{}", lane.name));
            for (point, origin) in moved.shape.iter().zip(&lane.shape) {
                assert_eq!((point.x, point.y), (origin.x + f64::from(cols.start), origin.y));
            }
            let end = lane
                .to
                .map(|to| format!("{prefix}{}", part.junctions[to as usize].name));
            assert_eq!(moved.to.map(|to| all.junctions[to as usize].name.clone()), end);
        }
        let name = |network: &Network, way: u32| {
            let way = &network.connections[way as usize];
            [way.from, way.to].map(|lane| network.lanes[lane as usize].name.clone())
        };
        for way in &part.connections {
            let moved = ways.next().unwrap();
            let own = |lane: u32| format!("{prefix}{}", part.lanes[lane as usize].name);
            assert_eq!(all.lanes[moved.from as usize].name, own(way.from));
            assert_eq!(all.lanes[moved.to as usize].name, own(way.to));
            let foes = way
                .yields_to
                .iter()
                .map(|&foe| name(part, foe).map(|name| format!("{prefix}{name}")));
            let moved_foes = moved.yields_to.iter().map(|&foe| name(&all, foe));
            assert!(foes.eq(moved_foes));
            let shown = |network: &Network, light: Option<SignalLink>| {
                light.map(|light| {
                    network.signals[light.signal as usize]
                        .aspect(light.link, 7)
                        .map(Aspect::letter)
                })
            };
            assert_eq!(shown(&all, moved.light), shown(part, way.light));
        }
    }
    assert!(lanes.next().is_none() && ways.next().is_none());
}

/// In the towns of `town`, the agents of a split stay in its zone, and both executors agree.
#[test]
fn each_split_has_its_own_town() {
    let world = world("town", None, |_| ());
    let map = world.map();
    for split in Split::ALL {
        let mut cities = [Executor::Relational, Executor::Dense].map(|executor| {
            let settings = Settings {
                executor,
                count_firings: true,
                threads: 1,
            };
            Simulation::new(Arc::clone(&world), split, Seed(5), settings).unwrap()
        });
        go_the_same_way(&mut cities, 40);
        let mut trips = 0;
        for _ in 0..300 {
            let goals: Vec<Cell> = cities[1].agents().iter().map(|agent| agent.goal()).collect();
            cities[1].tick(&[]).unwrap();
            for (agent, goal) in cities[1].agents().iter().zip(goals) {
                assert!(map.in_zone(split.name(), agent.cell) && map.in_zone(split.name(), agent.goal()));
                trips += usize::from(agent.goal() != goal);
            }
        }
        assert!(trips > 10, "{trips}");
    }
}

/// Rules change lanes: the car reaches the lane on that side and goes on to its goal, and both executors agree.
#[test]
fn rules_change_lanes() {
    const AVENUE: &str = "\
roads:
  cell: 1
  size: [40, 160]
  junctions: [east, west]
  lanes:
    - there_0 drive to=east left=there_1 width=3 10,30 150,30
    - there_1 drive to=east width=3 10,26 150,26
    - back_0 drive to=west left=back_1 width=3 150,10 10,10
    - back_1 drive to=west width=3 150,14 10,14
  connections:
    - there_0 back_0 left priority 156,30 156,10
    - there_1 back_1 left priority 153,26 153,14
    - back_0 there_0 left priority 4,10 4,30
    - back_1 there_1 left priority 7,14 7,26
";
    const CONFIG: &str = "\
base: right-of-way-roads
rules: mine.dl
actions:
  define:
    ToLeft: {cells: {Car: 1}, change_lane: left}
    ToRight: {cells: {Car: 1}, change_lane: right}
  priority: [Stop, ToLeft, ToRight, Slow, Fast, Normal]
predicates:
  use: [IsPedestrian, IsCar, IsAtInter, IsInInter, Ahead, Tick, HasLeft, HasRight, OnLeft, OnRight]
  define:
    Ahead: {ahead: 6}
    Tick: {quantity: tick}
    HasLeft: {lane_beside: left}
    HasRight: {lane_beside: right}
    OnLeft: {beside: left}
    OnRight: {beside: right}
agents: {test: {cars: [{priority: 1, count: 6}]}}
";
    const RULES: &str = "\
.include \"vocabulary.dl\"
.decl Ahead, OnLeft, OnRight(x: agent, y: agent)
.decl HasLeft, HasRight, ToLeft, ToRight(x: agent)
.decl Tick(t: number)
.input Ahead, OnLeft, OnRight, HasLeft, HasRight, Tick
.output ToLeft, ToRight
Slow(X) :- Ahead(X, Y), Not(Stop(X)).
ToLeft(X) :- HasLeft(X), Tick(t), t % 40 < 10, Not(OnLeft(X, _)).
ToRight(X) :- HasRight(X), Tick(t), t % 40 >= 20, t % 40 < 30.
";
    let map = load_memory_map(AVENUE).unwrap();
    let (world, _) = configured(CONFIG, RULES, |scenario| scenario.map = map.clone());
    let mut cities = [Executor::Relational, Executor::Dense].map(|executor| simulation(&world, executor, 1));
    go_the_same_way(&mut cities, 200);
    let [_, mut city] = cities;
    let lane = |cell: Cell| {
        let rows = [(30, "there_0"), (26, "there_1"), (10, "back_0"), (14, "back_1")];
        let found = rows.into_iter().find(|(row, _)| *row == cell.row);
        found.map(|(_, name)| name.to_owned())
    };
    let (mut changed, mut arrived) = (BTreeMap::new(), 0);
    let mut wanted: BTreeMap<usize, (String, u64)> = BTreeMap::new();
    for tick in 200..1400 {
        let before = city.agents().to_vec();
        let done: Vec<Action> = city
            .tick(&[])
            .unwrap()
            .agents
            .iter()
            .map(|agent| agent.action)
            .collect();
        for (at, (agent, action)) in before.iter().zip(done).enumerate() {
            let name = world.scenario.actions.table.name(action);
            let beside = lane(agent.cell).and_then(|lane| {
                let (street, number) = lane.split_once('_')?;
                match (name, number) {
                    ("ToLeft", "0") => Some(format!("{street}_1")),
                    ("ToRight", "1") => Some(format!("{street}_0")),
                    _ => None,
                }
            });
            let after = &city.agents()[at];
            arrived += usize::from(after.goal() != agent.goal());
            if let Some(beside) = beside
                && world.map().at_intersection(agent.kind, agent.cell).is_none()
            {
                wanted.entry(at).or_insert((beside, tick));
            }
            if let Some((there, since)) = wanted.get(&at).cloned() {
                if lane(after.cell).as_deref() == Some(&there) {
                    *changed.entry(there).or_insert(0) += 1;
                    wanted.remove(&at);
                } else if tick - since > 12 {
                    // It was too near to an end, or at its goal.
                    wanted.remove(&at);
                }
            }
        }
    }
    assert!(arrived > 20 && changed.len() == 4, "{arrived} {changed:?}");
    assert!(changed.values().all(|count| *count > 10), "{changed:?}");
}

/// The right of way between two routes is what the connections that they take say.
#[test]
fn routes_that_meet_have_a_right_of_way() {
    let network = import(&text_of("grid-priority"), 1.0).unwrap();
    let rules = ".include \"right-of-way-roads.dl\"\nStop(X) :- IsAtInter(X), MustYield(X, Y), IsAtInter(Y).\n\
                 Slow(X) :- Not(Stop(X)), RightOfWay(X, _, \"first\").";
    let config = load_memory_map(&sumo::map_file(&network)).unwrap();
    let (world, _) = configured("base: right-of-way-roads\nrules: mine.dl", rules, |scenario| {
        scenario.map = config.clone();
    });
    let mut cities = [Executor::Relational, Executor::Dense].map(|executor| simulation(&world, executor, 1));
    go_the_same_way(&mut cities, 60);
    let [_, mut city] = cities;
    let map = world.map();
    // The connections of each lane, by the names of their lanes and the cells of the first ones.
    let lane_of = |cell: Cell| -> Option<usize> {
        let middle = |lane: &RoadLane| {
            let near = |point: &Point| (point.y - f64::from(cell.row) - 0.5).hypot(point.x - f64::from(cell.col) - 0.5);
            let segments = lane.shape.windows(2).map(|pair| {
                let (dx, dy) = (pair[1].x - pair[0].x, pair[1].y - pair[0].y);
                let (x, y) = (
                    f64::from(cell.col) + 0.5 - pair[0].x,
                    f64::from(cell.row) + 0.5 - pair[0].y,
                );
                let along = ((x * dx + y * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
                (x - along * dx).hypot(y - along * dy)
            });
            segments.fold(lane.shape.iter().map(near).fold(f64::INFINITY, f64::min), f64::min)
        };
        let drives = (network.lanes.iter().enumerate()).filter(|(_, lane)| lane.usage == LaneUse::Drive);
        let nearest = drives.min_by(|(_, one), (_, other)| middle(one).total_cmp(&middle(other)));
        nearest.filter(|(_, lane)| middle(lane) < 0.9).map(|(number, _)| number)
    };
    let mut counts = [0; 4];
    for _ in 0..150 {
        city.tick(&[]).unwrap();
        let agents = city.agents().to_vec();
        let exits: Vec<_> = agents.iter().map(|agent| agent.exit(map)).collect();
        let ways: Vec<Vec<u32>> = (agents.iter().zip(&exits))
            .map(|(agent, exit)| {
                let lane = map.lane_at(agent.cell).and_then(|_| lane_of(agent.cell));
                let ways = (network.connections.iter().zip(0..)).filter(|(way, _)| {
                    let first = network.lanes[way.to as usize].shape[0];
                    let entered = map.lane_at(Cell::new(first.y as i32, first.x as i32));
                    Some(way.from as usize) == lane && exit.is_some() && entered == *exit
                });
                ways.map(|(_, number)| number).collect()
            })
            .collect();
        for (one, other) in (0..agents.len()).flat_map(|one| (0..agents.len()).map(move |other| (one, other))) {
            if one == other || ways[one].is_empty() || ways[other].is_empty() {
                continue;
            }
            let must = |one: usize, other: usize| {
                let pairs = ways[one]
                    .iter()
                    .flat_map(|way| ways[other].iter().map(move |foe| (way, foe)));
                let mut pairs = pairs.map(|(way, foe)| network.connections[*way as usize].yields_to.contains(foe));
                pairs.any(|yields| yields)
            };
            let expected = match (must(one, other), must(other, one)) {
                (true, true) => Some(RightOfWay::Mutual),
                (true, false) => Some(RightOfWay::Yields),
                (false, true) => Some(RightOfWay::First),
                (false, false) => None,
            };
            let found = map.right_of_way((agents[one].cell, exits[one]), (agents[other].cell, exits[other]));
            assert_eq!(found, expected, "{:?} {:?}", agents[one].cell, agents[other].cell);
            counts[expected.map_or(3, |right| right as usize)] += 1;
        }
    }
    assert!(
        counts[0] > 20 && counts[1] == counts[0] && counts[3] > 100,
        "{counts:?}"
    );
}

/// The clearance of cars whose ways through a junction meet is what counting the cells of both, one by one, gives.
#[test]
fn cars_leave_the_ways_of_others_after_their_clearance() {
    let mut met = 0;
    for name in ["five-arms", "grid-priority", "roundabout", "spider-3"] {
        let (map, network) = map_of(name, 1.0);
        let drives = |lane: u32| network.lanes[lane as usize].usage == LaneUse::Drive;
        // The cells of each connection with its lane before and one cell after, and the number of those before.
        let ways: Vec<(u32, Vec<Cell>, usize)> = (network.connections.iter().enumerate())
            .filter(|(_, connection)| drives(connection.from) && drives(connection.to))
            .map(|(number, connection)| {
                let lane = map.lane_cells(connection.from as usize);
                let after = &map.lane_cells(connection.to as usize)[..1];
                let cells = [lane, map.connection_cells(number), after].concat();
                (connection.from, cells, lane.len())
            })
            .collect();
        let exit_of = |cells: &[Cell]| map.lane_at(*cells.last().unwrap());
        // Elsewhere, a car counts to the nearest of several lanes, or to none on a crossing.
        let is_clear = |cell: Cell| {
            let lanes = (0..network.lanes.len()).filter(|lane| map.lane_cells(*lane).contains(&cell));
            map.in_intersection(cell).is_some() || (lanes.count() == 1 && map.lane_at(cell).is_some())
        };
        // All ways of a car in a cell, with its position on them.
        let possible = |cell: Cell, exit| -> Vec<(usize, usize)> {
            let is_inside = map.in_intersection(cell).is_some();
            let all = ways
                .iter()
                .enumerate()
                .filter(|(_, (_, cells, _))| exit_of(cells) == exit);
            let at = all.filter_map(|(number, (_, cells, lane))| {
                let mut positions = if is_inside { *lane..cells.len() - 1 } else { 0..*lane };
                Some((number, positions.find(|position| cells[*position] == cell)?))
            });
            at.collect()
        };
        let mut random = Seed(5).stream(Purpose::TEST, 0, 0);
        for _ in 0..cases(64).cases * 40 {
            let [one, other] = [(); 2].map(|()| {
                let (_, cells, lane) = &ways[random.random_range(0..ways.len())];
                let at = random.random_range(lane.saturating_sub(9)..cells.len() - 1);
                (cells[at], exit_of(cells))
            });
            if !is_clear(one.0) || !is_clear(other.0) {
                continue;
            }
            let theirs = possible(one.0, one.1);
            let mut expected = None;
            for (number, at) in possible(other.0, other.1) {
                let (from, cells, lane) = &ways[number];
                for (position, cell) in cells.iter().enumerate().skip(at.max(*lane)) {
                    let crosses = theirs.iter().any(|&(their, begin)| {
                        let (their_from, their_cells, their_lane) = &ways[their];
                        their_from != from && their_cells[begin.max(*their_lane)..].contains(cell)
                    });
                    if crosses {
                        expected = expected.max(Some((position + 1 - at) as u32));
                    }
                }
            }
            assert_eq!(map.clearance(one, other), expected, "{name} {one:?} {other:?}");
            met += u32::from(expected.is_some());
        }
    }
    assert!(met > 100, "{met}");
}
