//! Properties of every map: the generator, routes compared with slow and obvious searches, and agents under random
//! decisions.

use crate::cases::cases;
use logicity::builtin::BuiltinFiles;
use logicity::city::codes;
use logicity::city::{
    Action, ActionTable, AgentGroup, AgentKind, AgentSet, Blocks, Building, Buildings, MapConfig, Region, Routing,
    Split, Terrain,
};
use logicity::city::{
    Agent, Cell, CityMap, Ground, Heading, Junction, Lane, Layout, MoveReason, NoRoute, Places, Route, Router,
    Surroundings, advance, place_agents, possible_cells,
};
use logicity::city::{TripEnds, Widths};
use logicity::config::{load_map, load_scenario};
use logicity::diag::{self, Sources, Span};
use logicity::located::Located;
use logicity::rng::Seed;
use ndarray::Array2;
use proptest::prelude::*;
use proptest::sample::Index;
use std::collections::{BTreeSet, VecDeque};
use std::ops::{Range, RangeInclusive};
use std::path::Path;
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
        terrain: Terrain::Blocks(Blocks {
            blocks: located(blocks),
            widths: located(widths),
            buildings: located(buildings),
        }),
        zones: Vec::new(),
    }
}

/// Valid maps of up to 4 x 4 blocks.
fn maps() -> impl Strategy<Value = Arc<CityMap>> {
    maps_of(1..=4)
}

/// Valid maps with these numbers of rows and columns of blocks.
fn maps_of(blocks: RangeInclusive<u32>) -> impl Strategy<Value = Arc<CityMap>> {
    let widths =
        (1..=7_u32, 1..=6_u32, 1..=10_u32, 0..=5_u32).prop_map(|(half, sidewalk, building, inner_sidewalk)| Widths {
            street: 2 * half + 1,
            sidewalk,
            building,
            inner_sidewalk,
        });
    ([blocks.clone(), blocks], widths, any::<u64>()).prop_map(|(blocks, widths, seed)| {
        let weights = ALL_BUILDINGS.map(|building| (building, 1.0)).to_vec();
        let config = config(blocks, widths, Buildings::Random { seed, weights });
        Arc::new(CityMap::generate(&config).expect("these sizes are valid"))
    })
}

/// Small, odd and absurd sizes.
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

fn trip_ends() -> impl Strategy<Value = TripEnds> {
    proptest::sample::select(&TripEnds::ALL[..])
}

/// All cells, row by row.
fn cells(map: &CityMap) -> impl Iterator<Item = Cell> + use<> {
    let (rows, cols) = (map.rows(), map.cols());
    (0..rows).flat_map(move |row| (0..cols).map(move |col| Cell::new(row, col)))
}

/// The start and goal cells of a kind.
fn list(places: &Places, kind: AgentKind) -> Vec<Cell> {
    (0..places.count(kind))
        .map(|number| places.nth(kind, number).unwrap())
        .collect()
}

/// A map painted layer by layer, later strokes over earlier ones: the definition of a map. Numbers count from 1.
struct Painted {
    ground: Array2<Ground>,
    mid_line: Array2<bool>,
    /// The number of the block on cells with a building.
    block: Array2<u32>,
    /// The number of the intersection on its entrance lines, its outline and its inside.
    entrance: Array2<u32>,
    outline: Array2<u32>,
    inside: Array2<u32>,
}

/// Sets a rectangle of a layer; what lies beyond the world is left out.
fn fill<T: Clone>(layer: &mut Array2<T>, rows: Range<i32>, cols: Range<i32>, value: T) {
    for row in rows {
        for col in cols.clone() {
            if let (Ok(row), Ok(col)) = (usize::try_from(row), usize::try_from(col))
                && let Some(cell) = layer.get_mut((row, col))
            {
                *cell = value.clone();
            }
        }
    }
}

impl Painted {
    fn new(map: &CityMap) -> Painted {
        let shape = (map.rows() as usize, map.cols() as usize);
        let mut painted = Painted {
            ground: Array2::from_elem(shape, Ground::Traffic),
            mid_line: Array2::from_elem(shape, false),
            block: Array2::zeros(shape),
            entrance: Array2::zeros(shape),
            outline: Array2::zeros(shape),
            inside: Array2::zeros(shape),
        };
        painted.lay_blocks(map.layout().unwrap());
        painted.lay_intersections(map.layout().unwrap());
        painted
    }

    /// Walking streets, buildings and the mid lines along them. Other cells are traffic street.
    fn lay_blocks(&mut self, layout: &Layout) {
        let [block_rows, block_cols] = layout.blocks();
        for block_row in 0..block_rows {
            for block_col in 0..block_cols {
                let (top, left) = (layout.block_start(block_row), layout.block_start(block_col));
                let side = layout.block_side();
                fill(&mut self.ground, top..top + side, left..left + side, Ground::Walking);
                let number = (block_row * block_cols + block_col + 1).unsigned_abs();
                for (row, col) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let rows = layout.building_span(block_row, row);
                    let cols = layout.building_span(block_col, col);
                    fill(&mut self.ground, rows.clone(), cols.clone(), Ground::Other);
                    fill(&mut self.block, rows, cols, number);
                }
            }
        }
        for street in 0..=block_rows {
            let middle = layout.mid_line(street);
            for block in 0..block_cols {
                fill(&mut self.mid_line, middle..middle + 1, layout.built_span(block), true);
            }
        }
        for street in 0..=block_cols {
            let middle = layout.mid_line(street);
            for block in 0..block_rows {
                fill(&mut self.mid_line, layout.built_span(block), middle..middle + 1, true);
            }
        }
    }

    /// Crossings and the three masks of intersections, numbered row by row without the corners of the world.
    fn lay_intersections(&mut self, layout: &Layout) {
        let [block_rows, block_cols] = layout.blocks();
        let mut number = 0;
        for street_row in 0..=block_rows {
            for street_col in 0..=block_cols {
                let at_edge = [
                    street_row == 0 || street_row == block_rows,
                    street_col == 0 || street_col == block_cols,
                ];
                if at_edge == [true, true] {
                    continue;
                }
                number += 1;
                let (rows, cols) = (
                    layout.intersection_span(street_row),
                    layout.intersection_span(street_col),
                );
                fill(&mut self.inside, rows, cols, number);
                for entering in Heading::ALL {
                    self.lay_side(layout, entering, [street_row, street_col], number);
                }
            }
        }
    }

    /// The side by which cars with this heading enter an intersection, if a street leads to that side.
    fn lay_side(&mut self, layout: &Layout, entering: Heading, [street_row, street_col]: [i32; 2], number: u32) {
        let [block_rows, block_cols] = layout.blocks();
        let down = matches!(entering, Heading::Down | Heading::Up);
        let (street, end, streets, ends) = if down {
            (street_col, street_row, block_cols, block_rows)
        } else {
            (street_row, street_col, block_rows, block_cols)
        };
        let (across, along) = (layout.intersection_span(street), layout.intersection_span(end));
        let forward = matches!(entering, Heading::Down | Heading::Right);
        // No street comes from beyond the world, and cars on a street along an edge have no line to wait at.
        let beyond = if forward { end == 0 } else { end == ends };
        if beyond || street == 0 || street == streets {
            return;
        }
        let line = if forward { along.start } else { along.end - 1 };
        let middle = layout.mid_line(street);
        let half = match entering {
            Heading::Down | Heading::Left => across.start..middle,
            Heading::Up | Heading::Right => middle + 1..across.end,
        };
        let sidewalk = layout.sidewalk();
        let crossing = if forward {
            line..line + sidewalk
        } else {
            line + 1 - sidewalk..line + 1
        };
        let place = |across: Range<i32>, along: Range<i32>| if down { (along, across) } else { (across, along) };
        let (rows, cols) = place(layout.street_span(street), crossing);
        fill(&mut self.ground, rows, cols, Ground::Crossing);
        let (rows, cols) = place(across, line..line + 1);
        fill(&mut self.inside, rows.clone(), cols.clone(), 0);
        fill(&mut self.outline, rows, cols, number);
        let (rows, cols) = place(half, line..line + 1);
        fill(&mut self.entrance, rows, cols, number);
    }
}

/// The number of cells of a shortest path on foot.
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

/// The cost of a connector between lanes.
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
    let lanes: Vec<Lane> = router.lanes().collect();
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
    let right_of_mid_line = cols * down - rows * right + map.layout().unwrap().lane_offset();
    let half_street = map.layout().unwrap().street_span(0).end / 2;
    (0..=lane.length().cast_signed()).contains(&along) && (1..=half_street).contains(&right_of_mid_line)
}

/// The side of a cell, seen along the heading, with the mid line of its street: search both sides up to where cars
/// cannot be. `None` where the street has no mid line to either side.
fn mid_line_is_left(map: &CityMap, cell: Cell, heading: Heading) -> Option<bool> {
    let (left, right) = match heading {
        Heading::Left => (Heading::Down, Heading::Up),
        Heading::Right => (Heading::Up, Heading::Down),
        Heading::Up => (Heading::Left, Heading::Right),
        Heading::Down => (Heading::Right, Heading::Left),
    };
    // Only the mid line of this street counts, not the end of a side street's.
    let is_along =
        |cell: Cell| map.is_mid_line(cell) && [1, -1].iter().any(|&step| map.is_mid_line(cell.ahead(heading, step)));
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

/// The number of cells that an agent can move, by definition: straight ahead, and over no node of the road graph.
fn plainly_possible(map: &CityMap, kind: AgentKind, cells: &[Cell]) -> usize {
    let reach = if kind == AgentKind::Car { 3 } else { 1 };
    let heading = |steps: usize| Heading::between(cells[steps - 1], cells[steps]);
    let is_stop = |cell| kind == AgentKind::Car && map.is_lane_node(cell);
    (1..cells.len().min(reach + 1))
        .take_while(|&steps| heading(steps) == heading(1) && (1..steps).all(|passed| !is_stop(cells[passed])))
        .last()
        .unwrap_or(0)
}

/// Checks a car's route against the road graph and the map.
fn check_drive(router: &Router, route: &Route, start: Cell, goal: Cell) -> Result<(), TestCaseError> {
    let (map, lanes) = (router.map(), router.lanes().collect::<Vec<Lane>>());
    prop_assert_eq!((route.start(), route.goal()), (start, goal));
    let cells: Vec<Cell> = route.cells().collect();
    prop_assert_eq!(cells.len(), route.steps() + 1);
    for pair in cells.windows(2) {
        prop_assert_eq!(distance(pair[0], pair[1]), 1);
        prop_assert!(map.is_drivable(pair[0]) && map.is_drivable(pair[1]), "{:?}", pair);
        let heading = Heading::between(pair[0], pair[1]).expect("neighbors");
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

/// Returns whether a cell lies between the two nodes of a lane, or is one of them.
fn is_on(lane: &Lane, cell: Cell) -> bool {
    let between = |at: i32, one: i32, other: i32| (one.min(other)..=one.max(other)).contains(&at);
    between(cell.row, lane.start.row, lane.end.row) && between(cell.col, lane.start.col, lane.end.col)
}

fn agent_set(cars: usize, pedestrians: usize, region: Option<u32>) -> AgentSet {
    let group = |count: usize| AgentGroup {
        count: u32::try_from(count).unwrap(),
        concepts: Arc::default(),
        priority: 1,
    };
    AgentSet {
        cars: vec![group(cars)],
        pedestrians: vec![group(pedestrians)],
        own: Vec::new(),
        repeat: 1,
        region: region.map(|side| located(Region::Side(side))),
        trip: None,
        span: located(()).span,
    }
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn the_generator_accepts_or_rejects_every_configuration(
        blocks in [sizes(), sizes()],
        (street, sidewalk, building, inner_sidewalk) in (sizes(), sizes(), sizes(), sizes()),
        buildings in building_tables(),
    ) {
        let widths = Widths { street, sidewalk, building, inner_sidewalk };
        match CityMap::generate(&config(blocks, widths, buildings)) {
            Ok(map) => prop_assert!(map.rows().max(map.cols()) <= 1 << 20),
            Err(diagnostic) => {
                prop_assert!(matches!(diagnostic.code, codes::INVALID_MAP | diag::codes::LIMIT_EXCEEDED));
                prop_assert!(diagnostic.primary.is_some() && !diagnostic.help.is_empty());
            }
        }
    }

    /// Each cell of the map equals that of a map painted layer by layer.
    #[test]
    fn the_map_equals_the_painted_one(map in maps()) {
        let painted = Painted::new(&map);
        let router = Router::new(map.clone(), Routing::Weighted);
        let nodes: BTreeSet<Cell> = router.lanes().flat_map(|lane| [lane.start, lane.end]).collect();
        let semantic = map.semantic(&[Cell::new(0, 1), Cell::new(-1, 0)]).unwrap();
        prop_assert_eq!(semantic.dim(), (map.rows() as usize, map.cols() as usize, 10));
        for cell in cells(&map) {
            let place = (cell.row as usize, cell.col as usize);
            let number = |layer: &Array2<u32>| Some(layer[place]).filter(|&number| number > 0);
            prop_assert_eq!(map.ground_at(cell), Some(painted.ground[place]));
            prop_assert_eq!(map.is_mid_line(cell), painted.mid_line[place]);
            prop_assert_eq!(map.building_at(cell).is_some(), painted.block[place] > 0);
            prop_assert!(map.building_at(cell).is_none() || map.layout().unwrap().block_at(cell) == number(&painted.block));
            prop_assert_eq!(map.layout().unwrap().block_at(cell).is_none(), map.is_drivable(cell));
            prop_assert_eq!(map.at_intersection(AgentKind::Car, cell), number(&painted.entrance));
            prop_assert_eq!(map.at_intersection(AgentKind::Pedestrian, cell), number(&painted.outline));
            prop_assert_eq!(map.in_intersection(cell), number(&painted.inside));
            let junction = map.junction(cell);
            prop_assert_eq!(junction.car_is_at(), number(&painted.entrance).is_some());
            prop_assert_eq!(junction.pedestrian_is_at(), number(&painted.outline).is_some());
            prop_assert_eq!(junction.is_inside(), number(&painted.inside).is_some());
            prop_assert_eq!(map.is_lane_node(cell), nodes.contains(&cell));
            let statics: f32 = (0..8).map(|layer| semantic[(place.0, place.1, layer)]).sum();
            prop_assert_eq!(statics, 1.0);
            prop_assert_eq!(semantic[(place.0, place.1, 8)] == 1.0, place == (0, 1));
            prop_assert_eq!(semantic[(place.0, place.1, 9)], 0.0);
        }
        for outside in [Cell::new(-1, 5), Cell::new(5, -1), Cell::new(map.rows(), 0), Cell::new(0, map.cols())] {
            prop_assert_eq!(map.ground_at(outside), None);
            prop_assert_eq!(map.junction(outside), Junction::default());
        }
    }

    /// Start cells equal their definition, cell by cell.
    #[test]
    fn start_cells_are_beside_the_right_buildings(
        map in maps(),
        ends in trip_ends(),
        region in 0..120_u32,
        trip in 0..100_u32,
        pick in any::<Index>(),
    ) {
        let building = |cell: Cell| map.building_at(cell);
        let router = Router::new(map.clone(), Routing::Weighted);
        let reach = map.layout().unwrap().sidewalk() + 1 + match ends {
            TripEnds::Curb => 0,
            TripEnds::Lane => map.layout().unwrap().mid_line(0) - map.layout().unwrap().lane_offset(),
        };
        let on_line = |cell: Cell| match ends {
            TripEnds::Curb => map.ground_at(cell) == Some(Ground::Traffic),
            TripEnds::Lane => router.lanes().any(|lane| {
                matches!(lane.heading, Heading::Right | Heading::Down) && is_on(&lane, cell)
            }),
        };
        let places = Places::new(&router, ends, Some(region), None);
        let trips = Places::new(&router, ends, Some(region), Some(trip));
        for kind in AgentKind::ALL {
            let is_entrance = |cell: Cell, dr: i32, dc: i32| {
                let beside = building(Cell::new(cell.row + dr, cell.col + dc));
                matches!(beside, Some(Building::House | Building::Office))
            };
            let is_place = |&cell: &Cell| match kind {
                AgentKind::Pedestrian => {
                    map.ground_at(cell) == Some(Ground::Walking)
                        && (-1..=1).any(|dr| (-1..=1).any(|dc| is_entrance(cell, dr, dc)))
                }
                AgentKind::Car => on_line(cell) && Heading::ALL.iter().any(|&heading| {
                    let near = (1..=reach).find_map(|cells| building(cell.ahead(heading, cells)));
                    matches!(near, Some(Building::GasStation | Building::Garage | Building::Store))
                }),
            };
            let in_region = |cell: &Cell| cell.row.max(cell.col) < region.cast_signed();
            let expected: Vec<Cell> = cells(&map).filter(in_region).filter(is_place).collect();
            prop_assert_eq!(list(&places, kind), expected.clone());
            prop_assert_eq!(places.nth(kind, expected.len()), None);
            for cell in cells(&map).step_by(7) {
                prop_assert_eq!(places.contains(kind, cell), expected.contains(&cell));
            }
            // The goals of an agent, with and without a start cell.
            if expected.is_empty() {
                continue;
            }
            let start = *pick.get(&expected);
            for start in [start, start.ahead(Heading::Down, 1), Cell::new(0, 0)] {
                let is_goal = |goal: &Cell| match kind {
                    AgentKind::Car => *goal != start,
                    AgentKind::Pedestrian => {
                        let [from, to] = [start, *goal].map(|cell| map.layout().unwrap().block_at(cell));
                        *goal != start && (from.is_none() || from != to)
                    }
                };
                let goals: Vec<Cell> = expected.iter().copied().filter(is_goal).collect();
                prop_assert_eq!(places.goals(kind, start), goals.clone());
                let is_near = |goal: &Cell| start.row.abs_diff(goal.row).max(start.col.abs_diff(goal.col)) <= trip;
                let near: Vec<Cell> = goals.into_iter().filter(is_near).collect();
                prop_assert_eq!(trips.goals(kind, start), near);
            }
        }
    }

    #[test]
    fn cars_reach_every_goal_by_a_best_route_and_keep_right(
        map in maps(),
        ends in trip_ends(),
        picks in proptest::collection::vec(any::<[Index; 2]>(), 6),
    ) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let places = list(&Places::new(&router, ends, None, None), AgentKind::Car);
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

    /// On maps that are too large for a search of the whole.
    #[test]
    fn slow_routes_on_large_maps_are_best(map in maps_of(7..=13), pick in any::<[Index; 2]>(), near in any::<Index>()) {
        for routing in [Routing::Weighted, Routing::Hops] {
            let router = Router::new(map.clone(), routing);
            let places = Places::new(&router, TripEnds::Curb, None, None);
            let trips = Places::new(&router, TripEnds::Curb, None, Some(3 * map.layout().unwrap().period().unsigned_abs()));
            prop_assume!(places.count(AgentKind::Car) > 0);
            let count = places.count(AgentKind::Car);
            let [start, far] = pick.map(|pick| places.nth(AgentKind::Car, pick.index(count)).unwrap());
            let close = trips.goals(AgentKind::Car, start);
            let close = close.get(near.index(close.len().max(1))).copied();
            for goal in [far].into_iter().chain(close).filter(|&goal| goal != start) {
                let route = router.plan(AgentKind::Car, start, goal);
                prop_assert!(route.is_ok());
                check_drive(&router, &route.clone().unwrap(), start, goal)?;
                prop_assert_eq!(router.plan(AgentKind::Car, start, goal), route);
            }
        }
    }

    #[test]
    fn cars_that_start_on_lanes_follow_them(map in maps(), seed in any::<u64>()) {
        for routing in Routing::ALL {
            let router = Router::new(map.clone(), routing);
            let places = Places::new(&router, TripEnds::Lane, None, None);
            let set = agent_set(places.count(AgentKind::Car).min(4), 0, None);
            for car in place_agents(&set, &router, &places, Seed(seed)).unwrap_or_default() {
                let lanes = router.lanes().filter(|lane| is_on(lane, car.cell));
                prop_assert_eq!(lanes.map(|lane| lane.heading).collect::<Vec<_>>(), [car.ahead()]);
            }
        }
    }

    #[test]
    fn cars_start_only_beside_lanes(map in maps(), pick in any::<Index>()) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let start = router.lanes().next().unwrap().start;
        let (rows, cols) = (map.rows() as usize, map.cols() as usize);
        for index in 0..20 {
            let place = (pick.index(rows * cols) + 31 * index) % (rows * cols);
            let cell = Cell::new((place / cols) as i32, (place % cols) as i32);
            let beside = router.lanes().any(|lane| is_beside(&map, lane, cell));
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
    fn slow_pedestrians_take_a_shortest_path(
        map in maps(),
        picks in proptest::collection::vec(any::<[Index; 2]>(), 12)
    ) {
        let routers = [Routing::Weighted, Routing::Hops].map(|routing| Router::new(map.clone(), routing));
        let places: Vec<Cell> = cells(&map).filter(|&cell| map.is_walkable(cell)).collect();
        for (pick, router) in picks.into_iter().flat_map(|pick| routers.iter().map(move |router| (pick, router))) {
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
    fn agents_stay_on_their_routes_under_any_decisions(
        map in maps(),
        ends in trip_ends(),
        seed in any::<u64>(),
        trip in proptest::option::of(20..200_u32),
        decisions in proptest::collection::vec(proptest::sample::select(&Action::STANDARD[..]), 60..90),
    ) {
        let router = Router::new(map.clone(), Routing::Weighted);
        let places = Places::new(&router, ends, None, trip);
        let set = agent_set(places.count(AgentKind::Car).min(3), places.count(AgentKind::Pedestrian).min(3), None);
        let agents = match place_agents(&set, &router, &places, Seed(seed)) {
            Ok(agents) => agents,
            // Pedestrians walk to another block, which may not exist or lie beyond the trip.
            Err(diagnostic) => {
                prop_assert_eq!(diagnostic.code, codes::NO_ROUTE);
                return Ok(());
            }
        };
        let starts: BTreeSet<Cell> = agents.iter().map(|agent| agent.cell).collect();
        prop_assert_eq!(starts.len(), agents.len());
        let run = |mut agents: Vec<Agent>| -> Result<Vec<Cell>, TestCaseError> {
            let mut cells = Vec::new();
            for (tick, &decided) in (0..).zip(&decisions) {
                let actions = &ActionTable::default();
                let surroundings = Surroundings { router: &router, places: &places, actions, seed: Seed(seed), tick };
                for (index, agent) in agents.iter_mut().enumerate() {
                    let (before, heading, position) = (agent.cell, agent.heading, agent.position());
                    let most = possible_cells(agent, &ActionTable::default());
                    let way: Vec<Cell> = agent.route().cells().collect();
                    prop_assert_eq!(most, plainly_possible(&map, agent.kind, &way[position..]));
                    let moved = advance(agent, index, decided, &surroundings);
                    prop_assert_eq!((moved.from, moved.to), (before, agent.cell));
                    prop_assert_eq!(agent.route().cells().nth(agent.position()), Some(agent.cell));
                    prop_assert_eq!(agent.at_goal(), agent.position() == agent.route().steps());
                    if !moved.replanned {
                        let cells = agent.position() - position;
                        prop_assert!(cells <= most);
                        prop_assert_eq!(cells == 0, decided == Action::Stop || moved.reason == MoveReason::Resting);
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
fn too_many_agents_for_a_region_are_reported() {
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
        let places = Places::of(
            &router,
            TripEnds::Curb,
            set.region.as_ref().map(|region| &region.value),
            None,
        );
        place_agents(set, &router, &places, Seed(1)).map_err(|diagnostic| diagnostic.code)
    };
    // Two stores with two curbs of ten cells each.
    assert_eq!(place(&agent_set(40, 0, None)).map(|agents| agents.len()), Ok(40));
    assert_eq!(
        place(&agent_set(41, 0, None)).map(|agents| agents.len()),
        Err(codes::NO_START_CELL)
    );
    assert_eq!(
        place(&agent_set(1, 0, Some(5))).map(|agents| agents.len()),
        Err(codes::NO_START_CELL)
    );
    assert_eq!(
        place(&agent_set(0, 1, None)).map(|agents| agents.len()),
        Err(codes::NO_ROUTE)
    );
    assert_eq!(place(&agent_set(0, 0, Some(5))).map(|agents| agents.len()), Ok(0));
}

/// The search for the published path has a limit; the formula for other paths has none.
#[test]
fn slow_published_paths_on_foot_can_be_too_long() {
    let config = load_map(&mut Sources::new(), Path::new("metropolis"), &BuiltinFiles).expect("built in");
    let map = Arc::new(CityMap::generate(&config).expect("a valid map"));
    let [published, ours] = [Routing::Hops, Routing::Weighted].map(|routing| Router::new(map.clone(), routing));
    let mut walkable = (0..map.rows())
        .map(|at| Cell::new(at, at))
        .filter(|&cell| map.is_walkable(cell));
    let (start, goal) = (walkable.next().unwrap(), walkable.next_back().unwrap());
    assert_eq!(published.plan(AgentKind::Pedestrian, start, goal), Err(NoRoute::TooFar));
    let steps = start.row.abs_diff(goal.row) + start.col.abs_diff(goal.col);
    assert!(ours.plan(AgentKind::Pedestrian, start, goal).unwrap().steps() >= steps as usize);
}

#[test]
fn slow_agents_of_a_metropolis_are_small_and_keep_to_their_trips() {
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new("metropolis"), &BuiltinFiles).expect("built in");
    let mut set = scenario.agent_set(Split::Test).expect("a test set").clone();
    set.repeat = 500;
    let map = CityMap::generate(&scenario.map).expect("a valid map");
    assert_eq!((map.rows(), map.cols()), (28_301, 28_301));
    // As layers it would take 24 GiB.
    assert_eq!(map.semantic(&[]).unwrap_err().code, diag::codes::LIMIT_EXCEEDED);
    let router = Router::new(Arc::new(map), scenario.routing);
    let trip = set.trip.map(|trip| trip.value);
    let places = Places::new(&router, TripEnds::Curb, None, trip);
    let mut agents = place_agents(&set, &router, &places, Seed(1)).expect("free start cells");
    let starts: BTreeSet<Cell> = agents.iter().map(|agent| agent.cell).collect();
    assert_eq!((agents.len(), starts.len()), (9_000, 9_000));
    let routes: usize = agents.iter().map(|agent| agent.route().heap_bytes()).sum();
    let (own, route) = (size_of::<Agent>(), routes / agents.len());
    println!("an agent takes {own} bytes, and {route} for its route on average");
    assert!(own <= 128 && route <= 64);
    let keeps_to_trip = |agent: &Agent| {
        let (from, to) = (agent.start(), agent.goal());
        assert!(from.row.abs_diff(to.row).max(from.col.abs_diff(to.col)) <= trip.expect("it has one"));
        assert!(places.contains(agent.kind, from) && places.contains(agent.kind, to));
    };
    agents.iter().for_each(keeps_to_trip);
    let mut replanned = 0;
    for tick in 0..200 {
        let surroundings = Surroundings {
            router: &router,
            places: &places,
            actions: &ActionTable::default(),
            seed: Seed(1),
            tick,
        };
        for (index, agent) in agents.iter_mut().enumerate() {
            if advance(agent, index, Action::Normal, &surroundings).replanned {
                keeps_to_trip(agent);
                replanned += 1;
            }
        }
    }
    assert!(replanned > 9_000);
}

/// The share of path cells that are at an intersection, and of those in one, in thousandths.
fn at_and_in(router: &Router, trips: &[[Cell; 2]]) -> [usize; 2] {
    let map = router.map();
    let route = |&[start, goal]: &[Cell; 2]| router.plan(AgentKind::Pedestrian, start, goal).unwrap();
    let cells: Vec<Cell> = trips
        .iter()
        .flat_map(|trip| route(trip).cells().collect::<Vec<_>>())
        .collect();
    let share = |holds: &dyn Fn(Cell) -> bool| 1000 * cells.iter().filter(|&&cell| holds(cell)).count() / cells.len();
    [
        share(&|cell| map.at_intersection(AgentKind::Pedestrian, cell).is_some()),
        share(&|cell| map.in_intersection(cell).is_some()),
    ]
}

#[test]
fn pedestrians_meet_intersections_as_often_as_in_the_published_program() {
    let config = load_map(&mut Sources::new(), Path::new("square-5x5"), &BuiltinFiles).expect("built in");
    let map = Arc::new(CityMap::generate(&config).expect("a valid map"));
    let [published, ours] = [Routing::Hops, Routing::Weighted].map(|routing| Router::new(map.clone(), routing));
    let places = Places::new(&ours, TripEnds::Curb, Some(120), None);
    let count = places.count(AgentKind::Pedestrian);
    let cell = |number: usize| places.nth(AgentKind::Pedestrian, number % count).unwrap();
    let trips: Vec<[Cell; 2]> = (0..1000)
        .map(|at| [cell(at * 7919), cell(at * 104_729 + 13)])
        .filter(|[start, goal]| start != goal)
        .collect();
    let [published, ours] = [at_and_in(&published, &trips), at_and_in(&ours, &trips)];
    println!("at and in an intersection: published {published:?}, ours {ours:?}");
    for (published, ours) in published.into_iter().zip(ours) {
        assert!(published.abs_diff(ours) < 30, "{published} and {ours} of a thousand");
    }
}

/// Returns the number of pairs of cars that face each other when they start, at most 12 cells apart.
fn facing_starts(router: &Router, places: &Places, seed: u64) -> usize {
    let agents = place_agents(&agent_set(60, 0, None), router, places, Seed(seed)).expect("free start cells");
    let faces = |x: &Agent, y: &Agent| {
        let (from, to) = (x.cell, y.cell);
        distance(from, to) <= 12 && Heading::between(from, to) == Some(x.ahead())
    };
    let pairs = agents.iter().enumerate();
    pairs
        .map(|(at, x)| agents[..at].iter().filter(|y| faces(x, y) && faces(y, x)).count())
        .sum()
}

/// Cars that start at the curb first drive to their lane, and may meet head-on. Cars that start on a lane follow it.
#[test]
fn cars_that_start_on_lanes_never_face_each_other() {
    let config = load_map(&mut Sources::new(), Path::new("square-5x5"), &BuiltinFiles).expect("built in");
    let map = Arc::new(CityMap::generate(&config).expect("a valid map"));
    let mut at_curbs = 0;
    for routing in Routing::ALL {
        let router = Router::new(map.clone(), routing);
        let [curbs, lanes] = [TripEnds::Curb, TripEnds::Lane].map(|ends| Places::new(&router, ends, Some(120), None));
        for seed in 0..30 {
            assert_eq!(facing_starts(&router, &lanes, seed), 0);
            at_curbs += facing_starts(&router, &curbs, seed);
        }
    }
    assert!(at_curbs > 10, "{at_curbs}");
}
