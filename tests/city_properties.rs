//! What holds on every map: the generator, routes compared with the slow and obvious way to find them, and agents under random
//! decisions.

use logicity::city::{
    Agent, Cell, CityMap, Ground, Heading, Lane, NoRoute, Places, Reason, Route, Router, Surroundings, advance,
    place_agents, possible_cells,
};
use logicity::config::{
    AgentConfig, AgentKind, AgentSet, Building, Buildings, Located, MapConfig, Routing, Speed, Widths,
};
use logicity::diag::{Code, Sources, Span};
use logicity::rng::Seed;
use proptest::prelude::*;
use proptest::sample::Index;
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

const ALL_BUILDINGS: [Building; 5] = [
    Building::House,
    Building::Office,
    Building::Garage,
    Building::Store,
    Building::GasStation,
];

fn located<T>(value: T) -> Located<T> {
    let mut sources = Sources::new();
    let span = Span::new(sources.add("test", ""), 0..0);
    Located { value, span }
}

fn config(blocks: [u32; 2], widths: Widths, buildings: Buildings) -> MapConfig {
    MapConfig {
        name: "test".into(),
        blocks: located(blocks),
        widths: located(widths),
        buildings: located(buildings),
    }
}

/// Any map that can be generated, up to 4 x 4 blocks.
fn maps() -> impl Strategy<Value = Arc<CityMap>> {
    let widths =
        (1..=7_u32, 1..=6_u32, 1..=10_u32, 0..=5_u32).prop_map(|(half, sidewalk, building, inner_sidewalk)| Widths {
            street: 2 * half + 1,
            sidewalk,
            building,
            inner_sidewalk,
        });
    ([1..=4_u32, 1..=4_u32], widths, any::<u64>()).prop_map(|(blocks, widths, seed)| {
        let weights = ALL_BUILDINGS.map(|building| (building, 1.0)).to_vec();
        let config = config(blocks, widths, Buildings::Random { seed, weights });
        Arc::new(CityMap::generate(&config).expect("these sizes are valid"))
    })
}

/// Sizes of every kind: small, odd, and absurd.
fn sizes() -> impl Strategy<Value = u32> {
    prop_oneof![8 => 0..8_u32, 1 => any::<u32>(), 1 => Just(1_000_000_000)]
}

fn building_tables() -> impl Strategy<Value = Buildings> {
    let building = proptest::sample::select(&ALL_BUILDINGS[..]);
    let weight = prop_oneof![any::<f64>(), 0.0..1.0];
    prop_oneof![
        proptest::collection::vec(proptest::collection::vec(building.clone(), 0..9), 0..9).prop_map(Buildings::Fixed),
        (any::<u64>(), proptest::collection::vec((building, weight), 0..7))
            .prop_map(|(seed, weights)| Buildings::Random { seed, weights }),
    ]
}

/// A shortest way on foot: its number of cells.
fn walk(map: &CityMap, start: Cell, goal: Cell) -> Option<usize> {
    let mut seen = BTreeSet::from([start]);
    let mut queue = VecDeque::from([(start, 1)]);
    while let Some((cell, length)) = queue.pop_front() {
        if cell == goal {
            return Some(length);
        }
        for next in Heading::ALL.map(|heading| cell.ahead(heading, 1)) {
            if map.is_walkable(next) && seen.insert(next) {
                queue.push_back((next, length + 1));
            }
        }
    }
    None
}

fn distance(from: Cell, to: Cell) -> u32 {
    from.row.abs_diff(to.row) + from.col.abs_diff(to.col)
}

/// The cost of going on from lane to lane.
fn cost(routing: Routing, from: Lane, to: Lane) -> u32 {
    match routing {
        Routing::Hops => 2,
        Routing::Weighted => {
            let turn = if from.heading == to.heading { 0 } else { 30 };
            distance(from.end, to.start) + turn + to.length()
        }
    }
}

/// The least cost from the end of one lane to the end of each lane, by relaxing every connector until nothing changes.
fn least_costs(router: &Router, from: usize) -> Vec<Option<u32>> {
    let lanes = router.lanes();
    let mut costs = vec![None; lanes.len()];
    costs[from] = Some(0);
    loop {
        let mut changed = false;
        for (a, b) in router.connectors() {
            let Some(so_far) = costs[a] else { continue };
            let through = so_far + cost(router.routing(), lanes[a], lanes[b]);
            if costs[b].is_none_or(|known| through < known) {
                costs[b] = Some(through);
                changed = true;
            }
        }
        if !changed {
            return costs;
        }
    }
}

/// Whether a cell is on the lane's side of its street, between the lane's ends.
fn is_beside(map: &CityMap, lane: Lane, cell: Cell) -> bool {
    let (rows, cols) = lane.heading.delta();
    let (down, right) = (cell.row - lane.start.row, cell.col - lane.start.col);
    let along = rows * down + cols * right;
    // To the right of a heading (rows, cols) is (cols, -rows).
    let right_of_mid_line = cols * down - rows * right + map.layout.lane_offset();
    let half_street = map.layout.street_span(0).end / 2;
    (0..=lane.length().cast_signed()).contains(&along) && (1..=half_street).contains(&right_of_mid_line)
}

/// On which side of a cell, seen along the heading, the mid line of its street is: walk to both sides up to where cars cannot
/// be. `None` where the street has no mid line to either side.
fn mid_line_is_left(map: &CityMap, cell: Cell, heading: Heading) -> Option<bool> {
    let (left, right) = match heading {
        Heading::Left => (Heading::Down, Heading::Up),
        Heading::Right => (Heading::Up, Heading::Down),
        Heading::Up => (Heading::Left, Heading::Right),
        Heading::Down => (Heading::Right, Heading::Left),
    };
    let is_mid_line = |cell: Cell| {
        let place = (usize::try_from(cell.row).ok(), usize::try_from(cell.col).ok());
        matches!(place, (Some(row), Some(col)) if map.mid_line.get((row, col)) == Some(&true))
    };
    // The mid line of this street, not the end of one that comes from the side.
    let is_along = |cell: Cell| is_mid_line(cell) && [1, -1].iter().any(|&step| is_mid_line(cell.ahead(heading, step)));
    let reaches = |side: Heading| {
        (1..)
            .map(|cells| cell.ahead(side, cells))
            .take_while(|&cell| map.is_drivable(cell))
            .any(is_along)
    };
    match (reaches(left), reaches(right)) {
        (false, false) => None,
        (left, _) => Some(left),
    }
}

/// How many cells an agent can move along the cells before it, by definition: straight on, and over no node of the road graph.
fn plainly_possible(map: &CityMap, kind: AgentKind, cells: &[Cell]) -> usize {
    let reach = if kind == AgentKind::Car { 3 } else { 1 };
    let heading = |steps: usize| Heading::between(cells[steps - 1], cells[steps]);
    let is_stop = |cell| kind == AgentKind::Car && map.layout.is_lane_node(cell);
    (1..cells.len().min(reach + 1))
        .take_while(|&steps| heading(steps) == heading(1) && (1..steps).all(|passed| !is_stop(cells[passed])))
        .last()
        .unwrap_or(0)
}

/// Checks a car's route against the road graph and the map.
fn check_drive(router: &Router, route: &Route, start: Cell, goal: Cell) -> Result<(), TestCaseError> {
    let (map, lanes) = (router.map(), router.lanes());
    prop_assert_eq!((route.start(), route.goal()), (start, goal));
    let cells: Vec<Cell> = route.cells().collect();
    prop_assert_eq!(cells.len(), route.steps() + 1);
    for pair in cells.windows(2) {
        prop_assert_eq!(distance(pair[0], pair[1]), 1);
        prop_assert!(map.is_drivable(pair[0]) && map.is_drivable(pair[1]), "{:?}", pair);
        let heading = Heading::between(pair[0], pair[1]).expect("neighbours");
        prop_assert_ne!(
            mid_line_is_left(map, pair[0], heading),
            Some(false),
            "{:?} on the wrong side",
            pair[0]
        );
    }
    // Nodes alternate: the end of a lane, the start of the next, its end, ..., the start of the goal's lane.
    let nodes: Vec<Cell> = route.nodes().collect();
    prop_assert!(nodes.len() >= 2 && nodes.len().is_multiple_of(2), "{:?}", nodes);
    let ending = |cell: Cell| lanes.iter().position(|lane| lane.end == cell);
    let starting = |cell: Cell| lanes.iter().position(|lane| lane.start == cell);
    let first = ending(nodes[0]).expect("a lane ends at the first node");
    let last = starting(nodes[nodes.len() - 1]).expect("a lane starts at the last node");
    let connectors: BTreeSet<(usize, usize)> = router.connectors().collect();
    let (mut at, mut total) = (first, 0);
    for pair in nodes.chunks(2) {
        prop_assert_eq!(ending(pair[0]), Some(at));
        let to = starting(pair[1]).expect("a lane starts at every second node");
        prop_assert!(connectors.contains(&(at, to)));
        total += cost(router.routing(), lanes[at], lanes[to]);
        at = to;
    }
    prop_assert_eq!(at, last);
    let least = (router.connectors().filter(|&(_, to)| to == last))
        .filter_map(|(from, to)| {
            Some(least_costs(router, first)[from]? + cost(router.routing(), lanes[from], lanes[to]))
        })
        .min();
    prop_assert_eq!(Some(total), least);
    Ok(())
}

fn agent(kind: AgentKind, number: usize) -> AgentConfig {
    AgentConfig {
        name: format!("{}_{number}", kind.name()),
        kind,
        concepts: Vec::new(),
        priority: 1,
    }
}

fn agent_set(cars: usize, pedestrians: usize, region: Option<u32>) -> AgentSet {
    let numbered = |kind, count| (1..=count).map(move |number| agent(kind, number));
    AgentSet {
        agents: numbered(AgentKind::Car, cars)
            .chain(numbered(AgentKind::Pedestrian, pedestrians))
            .collect(),
        region: region.map(located),
        span: located(()).span,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_generator_answers_every_configuration(
        blocks in [sizes(), sizes()],
        (street, sidewalk, building, inner_sidewalk) in (sizes(), sizes(), sizes(), sizes()),
        buildings in building_tables(),
    ) {
        let widths = Widths { street, sidewalk, building, inner_sidewalk };
        match CityMap::generate(&config(blocks, widths, buildings)) {
            Ok(map) => prop_assert!(map.ground.len() <= 1 << 24),
            Err(diagnostic) => {
                prop_assert!(matches!(diagnostic.code, Code::InvalidMap | Code::LimitExceeded));
                prop_assert!(diagnostic.primary.is_some() && !diagnostic.help.is_empty());
            }
        }
    }

    #[test]
    fn layers_agree_with_each_other(map in maps()) {
        let [block_rows, block_cols] = map.layout.blocks();
        let mut numbers = BTreeSet::new();
        for (place, &ground) in map.ground.indexed_iter() {
            let cell = Cell::new(i32::try_from(place.0).unwrap(), i32::try_from(place.1).unwrap());
            let (entrance, outline, inside) = (map.entrance[place], map.outline[place], map.inside[place]);
            prop_assert!(entrance == 0 || entrance == outline);
            prop_assert!(outline == 0 || inside == 0);
            prop_assert!(ground != Ground::Crossing || outline + inside > 0);
            prop_assert!(!map.mid_line[place] || ground == Ground::Traffic);
            prop_assert_eq!(map.building[place].is_some(), map.block[place] > 0);
            if map.building[place].is_some() {
                prop_assert_eq!(ground, Ground::Other);
                prop_assert_eq!(map.layout.block_at(cell), Some(map.block[place]));
            }
            prop_assert_eq!(map.layout.block_at(cell).is_none(), map.is_drivable(cell));
            numbers.insert(inside);
        }
        // 0 is the rest of the world; the four corners are no intersections.
        let intersections = (block_rows + 1) * (block_cols + 1) - 4;
        prop_assert_eq!(numbers.len(), intersections.unsigned_abs() as usize + 1);
        prop_assert_eq!(numbers.last().copied(), Some(intersections.unsigned_abs()));

        let agents = [Cell::new(0, 1), Cell::new(-1, 0)];
        let layers = map.semantic(&agents);
        prop_assert_eq!(layers.dim(), (map.ground.nrows(), map.ground.ncols(), 10));
        for (place, &ground) in map.ground.indexed_iter() {
            let statics: f32 = (0..8).map(|layer| layers[(place.0, place.1, layer)]).sum();
            let gap = ground == Ground::Other && map.building[place].is_none();
            prop_assert_eq!(statics, if gap { 0.0 } else { 1.0 });
            prop_assert_eq!(layers[(place.0, place.1, 8)] == 1.0, place == (0, 1));
            prop_assert_eq!(layers[(place.0, place.1, 9)], 0.0);
        }
    }

    /// Start cells against their definition, cell by cell.
    #[test]
    fn start_cells_are_beside_the_right_buildings(map in maps(), region in 0..120_u32) {
        let building = |cell: Cell| map.building.get((usize::try_from(cell.row).ok()?, usize::try_from(cell.col).ok()?)).copied().flatten();
        let reach = map.layout.sidewalk() + 1;
        for kind in [AgentKind::Car, AgentKind::Pedestrian] {
            let mut expected = Vec::new();
            for row in 0..map.rows().min(region.cast_signed()) {
                for col in 0..map.cols().min(region.cast_signed()) {
                    let cell = Cell::new(row, col);
                    let is_start = match kind {
                        AgentKind::Pedestrian => map.ground_at(cell) == Some(Ground::Walking) && (-1..=1).any(|dr| (-1..=1).any(|dc| {
                            matches!(building(Cell::new(row + dr, col + dc)), Some(Building::House | Building::Office))
                        })),
                        AgentKind::Car => map.ground_at(cell) == Some(Ground::Traffic) && Heading::ALL.iter().any(|&heading| {
                            let near = (1..=reach).find_map(|cells| building(cell.ahead(heading, cells)));
                            matches!(near, Some(Building::GasStation | Building::Garage | Building::Store))
                        }),
                    };
                    if is_start {
                        expected.push(cell);
                    }
                }
            }
            prop_assert_eq!(map.start_cells(kind, Some(region)), expected);
        }
    }

    #[test]
    fn cars_get_everywhere_by_the_best_way_and_keep_right(map in maps(), picks in proptest::collection::vec(any::<[Index; 2]>(), 6)) {
        let places = map.start_cells(AgentKind::Car, None);
        prop_assume!(!places.is_empty());
        for routing in [Routing::Weighted, Routing::Hops] {
            let router = Router::new(map.clone(), routing);
            for pick in &picks {
                let [start, goal] = pick.map(|index| *index.get(&places));
                let route = router.plan(AgentKind::Car, start, goal);
                prop_assert!(route.is_ok());
                let Ok(route) = route else { continue };
                if start == goal {
                    prop_assert!(route.cells().eq([start]));
                } else {
                    check_drive(&router, &route, start, goal)?;
                }
                prop_assert_eq!(router.plan(AgentKind::Car, start, goal), Ok(route));
            }
        }
    }

    #[test]
    fn cars_start_only_beside_lanes(map in maps(), pick in any::<Index>()) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let start = router.lanes()[0].start;
        for index in 0..20 {
            let place = (pick.index(map.ground.len()) + 31 * index) % map.ground.len();
            let cell = Cell::new(i32::try_from(place).unwrap() / map.cols(), i32::try_from(place).unwrap() % map.cols());
            let beside = router.lanes().iter().any(|lane| is_beside(&map, *lane, cell));
            match router.plan(AgentKind::Car, cell, start) {
                Ok(route) => {
                    prop_assert!(beside, "{:?}", cell);
                    prop_assert!(route.cells().all(|cell| map.is_drivable(cell)));
                    prop_assert!(router.follow(AgentKind::Car, route.cells()) == Some(route.clone()));
                }
                Err(reason) => prop_assert_eq!((reason, beside), (NoRoute::Start, false), "{:?}", cell),
            }
        }
    }

    #[test]
    fn pedestrians_take_a_shortest_way(map in maps(), picks in proptest::collection::vec(any::<[Index; 2]>(), 3)) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let places = map.start_cells(AgentKind::Pedestrian, None);
        prop_assume!(!places.is_empty());
        for pick in picks {
            let [start, goal] = pick.map(|index| *index.get(&places));
            let route = router.plan(AgentKind::Pedestrian, start, goal);
            prop_assert_eq!(route.as_ref().ok().map(|route| route.cells().count()), walk(&map, start, goal));
            let Ok(route) = route else { continue };
            prop_assert_eq!((route.start(), route.goal()), (start, goal));
            prop_assert!(route.cells().all(|cell| map.is_walkable(cell)));
            prop_assert!(route.cells().zip(route.cells().skip(1)).all(|(from, to)| distance(from, to) == 1));
        }
    }

    #[test]
    fn agents_stay_on_their_way_under_any_decisions(
        map in maps(),
        seed in any::<u64>(),
        decisions in proptest::collection::vec(proptest::sample::select(&Speed::ALL[..]), 60..90),
    ) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let places = Places::new(&router, None);
        let set = agent_set(places.of(AgentKind::Car).len().min(3), places.of(AgentKind::Pedestrian).len().min(3), None);
        let agents = match place_agents(&set, &router, &places, Seed(seed)) {
            Ok(agents) => agents,
            // One block: pedestrians have no other one to go to.
            Err(diagnostic) => {
                prop_assert_eq!(diagnostic.code, Code::NoRoute);
                return Ok(());
            }
        };
        let starts: BTreeSet<Cell> = agents.iter().map(|agent| agent.cell).collect();
        prop_assert_eq!(starts.len(), agents.len());
        let run = |mut agents: Vec<Agent>| -> Result<Vec<Cell>, TestCaseError> {
            let mut cells = Vec::new();
            for (tick, &decided) in (0..).zip(&decisions) {
                let surroundings = Surroundings { router: &router, places: &places, seed: Seed(seed), tick };
                for (index, agent) in agents.iter_mut().enumerate() {
                    let (before, heading, position) = (agent.cell, agent.heading, agent.position());
                    let most = possible_cells(agent);
                    let way: Vec<Cell> = agent.route().cells().collect();
                    prop_assert_eq!(most, plainly_possible(&map, agent.kind, &way[position..]));
                    let moved = advance(agent, index, decided, &surroundings);
                    prop_assert_eq!((moved.from, moved.to), (before, agent.cell));
                    prop_assert_eq!(agent.route().cells().nth(agent.position()), Some(agent.cell));
                    prop_assert_eq!(agent.at_goal(), agent.position() == agent.route().steps());
                    if !moved.replanned {
                        let cells = agent.position() - position;
                        prop_assert!(cells <= most);
                        prop_assert_eq!(cells == 0, decided == Speed::Stop || moved.reason == Reason::Resting);
                        prop_assert_eq!(agent.heading, Heading::between(moved.from, moved.to).or(heading));
                    }
                    let allowed = match agent.kind {
                        AgentKind::Car => map.is_drivable(agent.cell),
                        AgentKind::Pedestrian => map.is_walkable(agent.cell),
                    };
                    prop_assert!(allowed);
                    cells.push(agent.cell);
                }
            }
            Ok(cells)
        };
        prop_assert_eq!(run(agents.clone())?, run(agents)?);
    }
}

#[test]
fn too_many_agents_for_a_region_are_told() {
    let widths = Widths {
        street: 11,
        sidewalk: 5,
        building: 10,
        inner_sidewalk: 5,
    };
    let buildings = Buildings::Fixed(vec![vec![Building::Store, Building::House]; 2]);
    let map = Arc::new(CityMap::generate(&config([1, 1], widths, buildings)).unwrap());
    let router = Router::new(map, Routing::Weighted);
    let place = |set: &AgentSet| {
        let places = Places::new(&router, set.region.map(|region| region.value));
        place_agents(set, &router, &places, Seed(1)).map_err(|diagnostic| diagnostic.code)
    };
    // Two stores with two kerbs of ten cells each.
    assert_eq!(place(&agent_set(40, 0, None)).map(|agents| agents.len()), Ok(40));
    assert_eq!(
        place(&agent_set(41, 0, None)).map(|agents| agents.len()),
        Err(Code::NoStartCell)
    );
    assert_eq!(
        place(&agent_set(1, 0, Some(5))).map(|agents| agents.len()),
        Err(Code::NoStartCell)
    );
    assert_eq!(
        place(&agent_set(0, 1, None)).map(|agents| agents.len()),
        Err(Code::NoRoute)
    );
    assert_eq!(place(&agent_set(0, 0, Some(5))).map(|agents| agents.len()), Ok(0));
}
