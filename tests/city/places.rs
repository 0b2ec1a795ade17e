//! Predicates of places: their meaning on maps, and that both executors, scenes, traces and observations agree on them.

use crate::agreement::{self, Counts, multiply, record, replay, simulation};
use crate::config::load_memory;
use crate::shipped_world::configured;
use logicity::builtin::BuiltinFiles;
use logicity::city::{AgentKind, Building, Cell, CityMap, Router, Routing};
use logicity::config::Scenario;
use logicity::diag::{Sources, render};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{CityTheory, Executor, Observer, Oracle, World, examine};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Returns the map with these zones.
fn map(base: &str, zones: &str) -> CityMap {
    let config = format!("base: expert\nmap:\n  base: {base}\n  zones:\n{zones}");
    let (sources, scenario) = load_memory(&[("main.yaml", &config)]);
    let scenario = scenario.unwrap_or_else(|faults| panic!("{}", render(&faults, &sources, false)));
    CityMap::generate(&scenario.map).unwrap_or_else(|fault| panic!("{}", render(&[fault], &sources, false)))
}

fn cells(map: &CityMap) -> impl Iterator<Item = Cell> {
    let cols = map.cols();
    (0..map.rows()).flat_map(move |row| (0..cols).map(move |col| Cell::new(row, col)))
}

/// Returns whether a cell for which `is_landmark` holds is at most `within` rows and columns away.
fn is_around(map: &CityMap, at: Cell, within: i32, is_landmark: impl Fn(Cell) -> bool) -> bool {
    let around = |at: i32| at - within..=at + within;
    around(at.row)
        .any(|row| around(at.col).any(|col| map.contains(Cell::new(row, col)) && is_landmark(Cell::new(row, col))))
}

#[test]
fn zones_have_the_cells_that_the_documents_name() {
    let map = map(
        "square-5x5",
        "    cells: [{rows: [41, 61], cols: [7, 9]}]
    block: [{block: [2, 5]}]
    around_block: [{block: [2, 5], within: 4}]
    street: [{horizontal_street: 1}, {vertical_street: 6, within: 2}]
    gas: [{near: GasStation, within: 5}]
",
    );
    assert_eq!(
        map.zones().collect::<Vec<_>>(),
        ["cells", "block", "around_block", "street", "gas"]
    );
    let is_gas = |cell| map.building_at(cell) == Some(Building::GasStation);
    let mut counts = [0; 5];
    for at in cells(&map) {
        let expected = [
            (41..=61).contains(&at.row) && (7..=9).contains(&at.col),
            map.layout().unwrap().block_at(at) == Some(10),
            is_around(&map, at, 4, |cell| map.layout().unwrap().block_at(cell) == Some(10)),
            at.row < 11 || at.col >= 241 - 11 - 2,
            is_around(&map, at, 5, is_gas),
        ];
        for (zone, (name, expected)) in map.zones().zip(expected).enumerate() {
            assert_eq!(map.in_zone(name, at), expected, "{name} {at:?}");
            counts[zone] += usize::from(expected);
        }
        assert!(!map.in_zone("unknown", at));
    }
    assert!(counts.iter().all(|count| *count > 50), "{counts:?}");
}

#[test]
fn samples_are_drawn_from_the_seed() {
    let zones = "    two: [{near: Store, within: 0, sample: 2}]
    three: [{near: Store, within: 0, sample: 3}]
    other: [{near: Store, within: 0, sample: 2, seed: 7}]
    blocks: [{sample_blocks: 3}]
    all: [{near: Store, within: 0}]
";
    let drawn = map("random-8x8", zones);
    let of = |map: &CityMap, name: &str| {
        cells(map)
            .filter(|cell| map.in_zone(name, *cell))
            .collect::<Vec<Cell>>()
    };
    let [two, three, other, blocks, all] = ["two", "three", "other", "blocks", "all"].map(|name| of(&drawn, name));
    assert_eq!(
        [two.len(), three.len(), other.len(), blocks.len()],
        [200, 300, 200, 3 * 35 * 35]
    );
    assert!(two.iter().all(|cell| three.contains(cell)));
    assert!(three.iter().chain(&other).all(|cell| all.contains(cell)));
    assert_ne!(two, other);
    assert!(
        three
            .iter()
            .all(|&cell| drawn.building_at(cell) == Some(Building::Store))
    );
    // Maps with other buildings have other samples.
    let reseeded = "    blocks: [{sample_blocks: 3}]\n  buildings: {random: {seed: 2}}\n";
    assert_ne!(of(&map("random-8x8", reseeded), "blocks"), blocks);
    assert_eq!(of(&map("random-8x8", zones), "two"), two);
}

/// Lanes are those of the road graph, and other cells are on none.
#[test]
fn lanes_reach_from_node_to_node_of_the_road_graph() {
    for (name, blocks) in [("square-5x5", ""), ("random-8x8", "  blocks: [2, 3]\n")] {
        let map = Arc::new(map(name, &format!("    all: [{{horizontal_street: 1}}]\n{blocks}")));
        let router = Router::new(Arc::clone(&map), Routing::Weighted);
        let mut headings = BTreeMap::new();
        // The side of a street, from the mid line, and the place of the lane's nodes on it.
        let (side, offset) = (
            map.layout().unwrap().mid_line(0) - map.layout().unwrap().street_start(0),
            map.layout().unwrap().lane_offset(),
        );
        for lane in router.lanes() {
            for across in 1 - offset..=side - offset {
                let (rows, cols) = lane.heading.delta();
                // Cars keep right.
                let shift = |cell: Cell| Cell::new(cell.row + cols * across, cell.col - rows * across);
                let mut at = lane.start;
                headings.insert(shift(at), lane.heading);
                while at != lane.end {
                    at = at.ahead(lane.heading, 1);
                    headings.insert(shift(at), lane.heading);
                }
            }
        }
        assert!(headings.len() > 1000);
        for cell in cells(&map) {
            assert_eq!(map.lane_at(cell), headings.get(&cell).copied(), "{cell:?}");
        }
        assert_eq!(map.lane_at(Cell::new(-1, 20)), None);
    }
}

/// Intersections have the numbers that the reference documents.
#[test]
fn intersections_are_numbered_row_by_row() {
    let map = map("square-5x5", "    all: [{block: [1, 1]}]\n");
    let mut number = 0;
    for (row, col) in (0..6).flat_map(|row| (0..6).map(move |col| (row, col))) {
        let cell = Cell::new(map.layout().unwrap().mid_line(row), map.layout().unwrap().mid_line(col));
        let is_corner = [0, 5].contains(&row) && [0, 5].contains(&col);
        number += u32::from(!is_corner);
        for kind in AgentKind::ALL {
            assert_eq!(
                map.intersection(kind, cell),
                (!is_corner).then_some(number),
                "{row} {col}"
            );
        }
    }
    assert_eq!(number, 32);
}

/// Returns the faults of a configuration whose map or predicates have these lines.
fn faults(zones: &str, predicate: &str) -> String {
    let config = format!(
        "base: expert\nmap:\n  base: square-5x5\n  zones:\n    school: {zones}\npredicates:\n  define:\n    InSchool: {predicate}\n"
    );
    let (sources, scenario) = load_memory(&[("main.yaml", &config)]);
    match scenario {
        Err(faults) => render(&faults, &sources, false),
        Ok(scenario) => match CityMap::generate(&scenario.map) {
            Err(fault) => render(&[fault], &sources, false),
            Ok(_) => String::new(),
        },
    }
}

#[test]
fn faults_of_zones_name_their_place_and_what_to_do() {
    let good = ("[{near: Office, within: 8}]", "{zone: school}");
    assert_eq!(faults(good.0, good.1), "");
    for (zones, place, message) in [
        ("[]", "5:13", "the zone `school` has no parts"),
        (
            "[{near: School, within: 8}]",
            "5:21",
            "one of `House`, `Office`, `Garage`, `Store`, `GasStation`, found `School`",
        ),
        ("[{near: Offce, within: 8}]", "5:21", "did you mean `Office`?"),
        ("[{near: Office}]", "5:14", "`near` needs the key `within`, too"),
        ("[{rows: [1, 2]}]", "5:14", "`rows` needs the key `cols`, too"),
        ("[{cols: [1, 2]}]", "5:14", "`cols` needs the key `rows`, too"),
        (
            "[{rows: [9, 2], cols: [1, 2]}]",
            "5:21",
            "the first and the last row in ascending order",
        ),
        (
            "[{rows: [200, 241], cols: [1, 2]}]",
            "5:14",
            "the map has the rows 0 to 240 and the columns 0 to 240",
        ),
        ("[{block: [6, 1]}]", "5:14", "its blocks are [1, 1] to [5, 5]"),
        ("[{block: 6}]", "5:22", "two numbers: the row and the column of a block"),
        (
            "[{vertical_street: 7}]",
            "5:14",
            "its vertical streets have the numbers 1 to 6, from the left edge",
        ),
        (
            "[{near: GasStation, within: 2, sample: 99}]",
            "5:14",
            "cannot draw 99 of the kind GasStation: the map has 5",
        ),
        ("[{sample_blocks: 26}]", "5:14", "cannot draw 26 blocks: the map has 25"),
        ("[{sample: 2}]", "5:14", "`sample` needs the key `near`, too"),
        ("[{block: [1, 1], sample: 2}]", "5:38", "expected no `sample` here"),
        ("[{block: [1, 1], seed: 2}]", "5:36", "expected no `seed` here"),
        (
            "[{block: [1, 1], near: Store, within: 2}]",
            "5:14",
            "found `block`, `near`",
        ),
        ("[{within: 2}]", "5:14", "expected exactly one of `rows` with `cols`"),
        ("[{bloc: [1, 1]}]", "5:15", "did you mean `block`?"),
        (
            "{near: Office, within: 8}",
            "5:13",
            "expected a list of parts of a zone",
        ),
    ] {
        let found = faults(zones, good.1);
        assert!(
            found.contains(message) && found.contains(&format!("main.yaml:{place}")),
            "{zones}\n{found}"
        );
    }
    for (predicate, place, message) in [
        ("{zone: scool}", "8:22", "did you mean `school`?"),
        ("{zone: park}", "8:22", "the zones of the map: school"),
        ("{zone: [school]}", "8:22", "expected the name of a zone"),
        ("{near: Store}", "8:15", "`{near: Store, within: 8}`"),
        ("{within: 8}", "8:15", "`{near: Store, within: 8}`"),
        ("{near: Shop, within: 8}", "8:22", "one of `House`"),
        ("{lane: lft}", "8:22", "did you mean `left`?"),
        (
            "{lane: bus}",
            "8:22",
            "one of `left`, `right`, `up`, `down`, `sidewalk`, `crossing`",
        ),
        ("{same: street}", "8:22", "one of `intersection`"),
        ("{near: Store, within: 1001}", "8:37", "a whole number from 0 to 1000"),
    ] {
        let found = faults(good.0, predicate);
        assert!(
            found.contains(message) && found.contains(&format!("main.yaml:{place}")),
            "{predicate}\n{found}"
        );
    }
    // A predicate that is not in use may name a zone of another map.
    let (_, unused) = load_memory(&[(
        "main.yaml",
        "base: easy\npredicates:\n  define:\n    InPark: {zone: park}\n",
    )]);
    assert!(unused.is_ok());
    let (sources, none) = load_memory(&[(
        "main.yaml",
        "base: expert\npredicates:\n  define:\n    InPark: {zone: park}\n",
    )]);
    let found = render(&none.unwrap_err(), &sources, false);
    assert!(
        found.contains("add it to the map: `zones: {park: [{near: Office, within: 8}]}`"),
        "{found}"
    );
}

/// The hash of a configuration depends on its zones only if it has some.
#[test]
fn zones_are_part_of_the_hash() {
    let hash = |map: &str| {
        load_memory(&[("main.yaml", &format!("base: expert\n{map}"))])
            .1
            .unwrap()
            .hash
    };
    let without = hash("");
    assert_eq!(hash("map: {base: square-5x5, zones: {}}"), without);
    assert_ne!(hash("map: {base: square-5x5, zones: {a: [{block: [1, 1]}]}}"), without);
}

/// Expert mode with places, these rules, and the changes of `edit`.
fn with_places(rules: &str, edit: impl FnOnce(&mut Scenario)) -> (Arc<World>, Sources) {
    configured(CONFIG, &format!("{DECLARED}{rules}"), edit)
}

const CONFIG: &str = "base: expert
map:
  base: square-5x5
  zones:
    school: [{near: Office, within: 8, sample: 9}, {rows: [0, 30], cols: [0, 120]}]
    center: [{block: [2, 2], within: 11}, {vertical_street: 2}]
predicates:
  define:
    InSchool: {zone: school}
    InCenter: {zone: center}
    NearStore: {near: Store, within: 8}
    NearGas: {near: GasStation, within: 40}
    GoesLeft: {lane: left}
    GoesDown: {lane: down}
    OnSidewalk: {lane: sidewalk}
    OnCrossing: {lane: crossing}
    SameInter: {same: intersection}
";

const DECLARED: &str = ".include \"vocabulary.dl\"
.decl InSchool, InCenter, NearStore, NearGas, GoesLeft, GoesDown, OnSidewalk, OnCrossing(x: agent)
.decl SameInter(x: agent, y: agent)
.input InSchool, InCenter, NearStore, NearGas, GoesLeft, GoesDown, OnSidewalk, OnCrossing, SameInter
";

/// Random rules: clauses of actions with conditions on the places of agents.
fn random_rules(random: &mut impl RngExt) -> String {
    const FACTS: [&str; 16] = [
        "InSchool(X)",
        "Not(InCenter(X))",
        "NearStore(X)",
        "Not(NearGas(X))",
        "IsClose(X, Y), InSchool(Y)",
        "Sees(X, Y), NearStore(Y), Not(InCenter(Y))",
        "IsAtInter(Y), NearGas(Y)",
        "InCenter(Y), HigherPri(X, Y)",
        "IsPedestrian(Y), NearStore(Y)",
        "IsInInter(X)",
        "GoesLeft(X)",
        "Not(GoesDown(X)), Not(OnCrossing(X))",
        "IsClose(Y, X), OnSidewalk(Y)",
        "OnCrossing(Y), Sees(X, Y)",
        "SameInter(X, Y)",
        "SameInter(Y, X), IsPedestrian(Y), Not(Sees(X, Y))",
    ];
    let mut clauses = String::new();
    for head in ["Stop", "Slow", "Fast"] {
        for _ in 0..random.random_range(1..4) {
            let mut body = vec![["IsCar(X)", "NearStore(X)"][random.random_range(0..2)].to_owned()];
            for fact in 0..random.random_range(1..3) {
                let chosen = FACTS[random.random_range(0..FACTS.len())];
                body.push(chosen.replace('Y', &format!("Y{fact}")));
            }
            clauses += &format!("{head}(X) :- {}.\n", body.join(", "));
        }
    }
    clauses
}

/// The dense executor evaluates places, in cities of every shape, as the relational one does.
#[test]
fn executors_agree_on_random_rules_with_places() {
    let mut counts = Counts::default();
    for (case, &(times, ticks, threads)) in [(1, 80, 1), (1, 80, 1), (1, 80, 1), (5, 30, 1), (20, 6, 1), (20, 6, 2)]
        .iter()
        .enumerate()
    {
        let rules = random_rules(&mut Seed(case as u64).stream(Purpose::TEST, 0, 0));
        let (world, _) = with_places(&rules, |scenario| {
            if times > 1 {
                multiply(scenario, times);
            }
        });
        let mut cities = [(Executor::Relational, 1), (Executor::Dense, threads)]
            .map(|(executor, threads)| simulation(&world, executor, threads));
        counts.go_the_same_way(&mut cities, ticks);
    }
    counts.check();
}

/// A replay computes places from the cells of the trace, and an observation contains them.
#[test]
fn replays_and_observations_have_the_places_of_the_run() {
    let (world, sources) = with_places("Slow(X) :- InSchool(X).", |_| ());
    let oracle = Arc::new(Oracle::new(Arc::clone(&world), 6).unwrap());
    let mut observer = Observer::new(oracle, 0);
    let mut observed = Vec::new();
    let (trace, facts) = record(&world, &sources, 60, |city| {
        if observed.is_empty() {
            observer.begin(city);
        }
        observer.look(city).unwrap();
        observed.push((
            observer.entities().collect::<Vec<_>>(),
            observer.atoms().collect::<Vec<_>>(),
        ));
    });
    let mut held = 0;
    for ((entities, atoms), facts) in observed.iter().zip(&facts) {
        let predicates = world.vocabulary.predicates.iter().zip(&facts.rows).enumerate();
        for (predicate, (_, rows)) in predicates.filter(|(_, (predicate, _))| predicate.arity == 1) {
            for &agent in entities {
                let holds = rows.contains(&[agent as u32, 0]);
                assert_eq!(atoms.contains(&(predicate, vec![agent])), holds);
                held += usize::from(holds);
            }
        }
    }
    assert!(held > 100);
    replay(&world, &trace, &facts, |_, _| ());
}

/// Checks know on which cells agents can be.
#[test]
fn checks_know_where_places_can_hold() {
    let messages = |config: &str, rules: &str| {
        let (world, sources) = configured(config, rules, |_| ());
        let theory = CityTheory::new(world.scenario.clone()).unwrap();
        let found = examine(world.program.rules(), Some(&theory), &sources).diagnostics;
        render(&found, &sources, false)
    };
    let rules = format!("{DECLARED}Stop(X) :- CollidingClose(X, Y).\nSlow(X) :- NearGas(X), OnCrossing(X).\n");
    assert_eq!(messages(CONFIG, &rules), "");
    let found = messages(CONFIG, &format!("{rules}Slow(X) :- IsCar(X), OnSidewalk(X).\n"));
    assert!(found.contains("contradictory-body"), "{found}");
    let without_gas = CONFIG.replace(
        "  zones:",
        "  buildings: {rows: ~, random: {seed: 1, weights: {House: 1, Office: 1, Store: 1}}}\n  zones:",
    );
    let found = messages(&without_gas, &rules);
    assert!(found.contains("`NearGas` never holds"), "{found}");
}

/// Returns the answer to a scene, which may name the map `town.yaml`, or its faults as text.
fn answer(config: &str, rules: &str, executor: Executor, scene: &str) -> Result<serde_json::Value, String> {
    let (world, _) = configured(config, rules, |_| ());
    let read = |path: &std::path::Path| match path == std::path::Path::new("town.yaml") {
        true => Ok(
            "base: square-5x5\nzones: {school: [{rows: [100, 110], cols: [0, 240]}], center: [{block: [1, 1]}]}\n"
                .to_owned(),
        ),
        false => logicity::files::ReadFile::read(&BuiltinFiles, path),
    };
    agreement::answer(&world, executor, read, scene)
}

#[test]
fn scenes_have_the_places_of_their_map() {
    let rules = format!("{DECLARED}Stop(X) :- InSchool(X).\nSlow(X) :- NearGas(X).\n");
    let agents = r#""agents": [{"id": "Car_1", "type": "Car", "at": [102, 20]}, {"id": "Car_2", "type": "Car", "at": [95, 20]}]}"#;
    for executor in [Executor::Dense, Executor::Relational] {
        let found = answer(CONFIG, &rules, executor, &format!(r#"{{"map": "town.yaml", {agents}"#)).unwrap();
        assert_eq!(found["egos"]["Car_1"]["action"], "Stop");
        let derived = found["egos"]["Car_2"]["derived"].to_string();
        assert!(!derived.contains("Stop"), "{derived}");
        let stated = format!(r#"{{"map": "square-5x5", "given": {{"InSchool": ["Car_2"], "InCenter": []}}, {agents}"#);
        let found = answer(CONFIG, &rules, executor, &stated).unwrap();
        assert_eq!(found["egos"]["Car_2"]["action"], "Stop");
        let symbols = r#"{"entities": ["e0"], "ego": "e0", "facts": {"InSchool": ["e0"]}}"#;
        assert_eq!(
            answer(CONFIG, &rules, executor, symbols).unwrap()["egos"]["e0"]["action"],
            "Stop"
        );
        let fault = answer(CONFIG, &rules, executor, &format!(r#"{{"map": "square-5x5", {agents}"#)).unwrap_err();
        assert!(
            fault.contains("the map `square-5x5` has no zone `school`, which `InSchool` tests"),
            "{fault}"
        );
    }
}
