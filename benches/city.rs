//! Benchmarks of the city: ticks, the inference of one scene, routes and moves.

#[path = "../tests/city/shipped_world.rs"]
mod shipped_world;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use logicity::builtin::BuiltinFiles;
use logicity::city::{
    Action, ActionTable, AgentKind, AgentSet, Places, Router, Split, Surroundings, advance, place_agents,
};
use logicity::datalog::dense::{BitFacts, BitState, TrackFirings, has};
use logicity::diag::Sources;
use logicity::files::read_text;
use logicity::rng::{Purpose, Seed};
use logicity::sim::{Executor, Inference, LoadedCity, Settings, Simulation, World};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The world of a mode.
fn world(mode: &str) -> Arc<World> {
    shipped_world::world(mode, None, |_| ())
}

/// Ticks of the test city of a mode; throughput is in decisions.
fn tick(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tick");
    for mode in ["easy", "expert"] {
        let world = world(mode);
        for executor in [Executor::Dense, Executor::Relational] {
            let settings = Settings {
                executor,
                ..Settings::default()
            };
            let mut simulation =
                Simulation::new(Arc::clone(&world), Split::Test, Seed(1), settings).expect("agents placed");
            group.throughput(Throughput::Elements(simulation.agents().len() as u64));
            group.bench_function(format!("{mode}/{}", executor.name()), |bencher| {
                bencher.iter(|| black_box(simulation.tick(&[]).expect("within limits")).tick);
            });
        }
    }
    group.finish();
}

/// Ticks of the expert test city under its rules and more clauses, whose bodies are evaluated and never hold. The
/// difference to `expert` is their price. Throughput is in decisions.
fn clauses(criterion: &mut Criterion) {
    const CONFIG: &str = "base: expert\nrules: rules/own.dl\npredicates: {define: {Waited: {quantity: waited}, Speed: {quantity: speed}, \
                          Priority: {quantity: priority}}}\n";
    const DECLARED: &str = ".include \"expert.dl\"\n.decl Waited(x: agent, n: number)\n\
                            .decl Speed(x: agent, n: number)\n.decl Priority(x: agent, n: number)\n\
                            .input Waited, Speed, Priority\n";
    let clause = |chance: &str, condition: &str| format!("{chance}Stop(X) :- IsCar(X), IsPedestrian(X){condition}.\n");
    let window = |at: usize| {
        let operator = [
            "once[0,30]",
            "historically[0,30]",
            "for[30]",
            "once[1,30]",
            "historically[1,30]",
        ][at % 5];
        clause("", &format!(", {operator} {}(X)", ["IsAtInter", "IsInInter"][at / 5]))
    };
    let threshold = |at: usize| {
        let quantity = ["Waited", "Speed", "Priority"][at % 3];
        clause("", &format!(", {quantity}(X, n), n > {}", at + 10))
    };
    let draw = |at: usize| clause(&format!("0.{} :: ", at + 1), "");
    let mut group = criterion.benchmark_group("clauses");
    for (name, rules) in [
        ("expert", clause("", "")),
        ("10 windows of 30 ticks", (0..10).map(window).collect()),
        ("1 threshold", (0..1).map(threshold).collect()),
        ("10 thresholds", (0..10).map(threshold).collect()),
        ("5 draws", (0..5).map(draw).collect()),
    ] {
        let (world, _) = shipped_world::configured(CONFIG, &format!("{DECLARED}{rules}"), |_| ());
        let settings = Settings {
            executor: Executor::Dense,
            ..Settings::default()
        };
        let mut simulation = Simulation::new(world, Split::Test, Seed(1), settings).expect("agents placed");
        group.throughput(Throughput::Elements(simulation.agents().len() as u64));
        group.bench_function(name, |bencher| {
            bencher.iter(|| black_box(simulation.tick(&[]).expect("within limits")).tick);
        });
    }
    group.finish();
}

/// A thousand cars on a map of 44 x 44 blocks, and on a road network with a junction wherever two streets meet.
/// Throughput is in decisions.
fn towns(criterion: &mut Criterion) {
    let blocks = "{base: square-5x5, blocks: [44, 44], buildings: {rows: ~, random: {seed: 1, weights: {House: 3, \
                  Store: 1}}}}";
    const TICKS: u32 = 200;
    let mut group = criterion.benchmark_group("towns");
    for (name, map) in [("blocks", blocks.to_owned()), ("roads", network(45))] {
        let config = format!(
            "base: expert\nrules: rules/own.dl\ntask: ~\nregion: ~\nmap: {map}\nagents: {{train: ~, val: ~, test: {{cars: [{{count: 1000, \
             priority: 1}}], pedestrians: []}}}}\n"
        );
        let (world, _) = shipped_world::configured(&config, ".include \"expert.dl\"\n", |_| ());
        group
            .sample_size(20)
            .throughput(Throughput::Elements(1000 * u64::from(TICKS)));
        group.bench_function(name, |bencher| {
            let city = || {
                Simulation::new(Arc::clone(&world), Split::Test, Seed(1), Settings::default()).expect("agents placed")
            };
            // Each sample starts with a fresh city, before traffic jams.
            bencher.iter_batched(
                city,
                |mut city| {
                    (0..TICKS)
                        .map(|_| city.tick(&[]).expect("within limits").tick)
                        .sum::<u64>()
                },
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

/// A map with a square of junctions, which streets of one lane per direction join.
fn network(side: i32) -> String {
    const STREET: i32 = 48;
    let steps = [(1, 0), (0, 1), (-1, 0), (0, -1)];
    let name = |row: i32, col: i32, heading: usize| format!("{row}-{col}-{heading}");
    let is_inside = |row: i32, col: i32| (0..side).contains(&row) && (0..side).contains(&col);
    let (mut junctions, mut lanes, mut connections) = (Vec::new(), Vec::new(), Vec::new());
    for (row, col) in (0..side).flat_map(|row| (0..side).map(move |col| (row, col))) {
        let (x, y) = (20 + STREET * col, 20 + STREET * row);
        let corners = [(-6, -6), (6, -6), (6, 6), (-6, 6)].map(|(right, down)| format!("{},{}", x + right, y + down));
        junctions.push(format!("\"{row}-{col} {}\"", corners.join(" ")));
        for (heading, (right, down)) in steps.into_iter().enumerate() {
            let (to_row, to_col) = (row + down, col + right);
            if !is_inside(to_row, to_col) {
                continue;
            }
            // To the right of the middle of the street.
            let at = |along: i32| format!("{},{}", x + right * along - 2 * down, y + down * along + 2 * right);
            lanes.push(format!(
                "\"{} drive to={to_row}-{to_col} width=3 {} {}\"",
                name(row, col, heading),
                at(6),
                at(STREET - 6)
            ));
            for (turn, direction) in ["straight", "right", "around", "left"].into_iter().enumerate() {
                let next = (heading + turn) % 4;
                let (right, down) = steps[next];
                if direction != "around" && is_inside(to_row + down, to_col + right) {
                    connections.push(format!(
                        "\"{} {} {direction} priority\"",
                        name(row, col, heading),
                        name(to_row, to_col, next)
                    ));
                }
            }
        }
    }
    let size = 40 + STREET * (side - 1);
    format!(
        "{{blocks: ~, widths: ~, buildings: ~, roads: {{cell: 1, size: [{size}, {size}], junctions: [{}], lanes: [{}], connections: [{}]}}}}",
        junctions.join(", "),
        lanes.join(", "),
        connections.join(", ")
    )
}

/// One scene, from text to answer; throughput is in scenes.
fn infer(criterion: &mut Criterion) {
    let world = world("expert");
    let (scenario, program) = (world.scenario.clone(), world.program.clone());
    let mut inference = Inference::new(scenario, program, Seed(0), Executor::Auto, read_text).expect("rules fit");
    let mut sources = Sources::new();
    let scene = sources.add(
        "scene",
        r#"{"map":"square-5x5","egos":["Car_1"],"agents":[
            {"id":"Car_1","type":"Car","at":[102,20],"heading":"Up","concepts":["tiro"],"priority":1},
            {"id":"Car_2","type":"Car","at":[92,20],"heading":"Down","concepts":["police"],"priority":2},
            {"id":"Pedestrian_1","type":"Pedestrian","at":[98,20]}]}"#,
    );
    let mut group = criterion.benchmark_group("infer");
    group.throughput(Throughput::Elements(1));
    group.bench_function("geometric", |bencher| {
        bencher.iter(|| inference.answer(&sources, scene).expect("a scene"));
    });
    group.finish();
}

/// The rules alone, on prepared facts: the bit rows of the expert test city at 64 ticks of a run. Throughput is in
/// decisions.
fn rules(criterion: &mut Criterion) {
    const WIDTH: usize = 1;
    let world = world("expert");
    let rules = world
        .compile(TrackFirings::Off)
        .expect("the rules of the paper are dense");
    let dense = &rules.dense;
    let mut simulation =
        Simulation::new(Arc::clone(&world), Split::Test, Seed(1), Settings::default()).expect("agents placed");
    let count = simulation.agents().len();
    let mut bit_state: BitState<WIDTH> = BitState::new(dense, count);
    let states: Vec<BitFacts<WIDTH>> = (0..64)
        .map(|_| {
            for _ in 0..7 {
                simulation.tick(&[]).expect("within limits");
            }
            let vocabulary = &world.vocabulary;
            let facts = simulation
                .facts(|predicate| vocabulary.is_read(predicate))
                .expect("within limits");
            let facts: BitFacts<WIDTH> = rules.bits(&facts, vocabulary, count, std::iter::empty::<&str>());
            facts.load(dense, &mut bit_state);
            bit_state.run(dense, &facts).expect("few steps");
            for action in Action::STANDARD {
                let declared = world.vocabulary.action(action).expect("the rules use every action");
                let set = bit_state.set(dense, declared).expect("derived");
                let state = simulation.snapshot().expect("within limits");
                for agent in 0..count {
                    let holds = state.session().contains(declared, [state.value(agent)]);
                    assert_eq!(has(set, agent), holds, "{} of {agent}", action.name());
                }
            }
            facts
        })
        .collect();
    let mut group = criterion.benchmark_group("rules");
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function("expert", |bencher| {
        let mut state = 0;
        bencher.iter(|| {
            state = (state + 1) % states.len();
            states[state].load(dense, &mut bit_state);
            bit_state.run(dense, &states[state]).expect("few steps");
            black_box(&bit_state);
        });
    });
    group.finish();
}

/// The test agents of a configuration, with its router and start cells.
fn planner(config: &str) -> (AgentSet, Router, Places) {
    let city = LoadedCity::load(&mut Sources::new(), Path::new(config), None, &BuiltinFiles).expect("built in");
    let World { router, scenario, .. } = city.world().expect("the rules fit");
    let set = scenario.agent_set(Split::Test).expect("a test set").clone();
    let region = set.region.as_ref().map(|region| &region.value);
    let trip = set.trip.map(|trip| trip.value);
    let places = Places::of(&router, scenario.trip_ends, region, trip);
    (set, router, places)
}

/// Draws a goal and plans the route to it, from one goal to the next, on the paper's map and on a map for a million
/// agents. `far` draws goals anywhere on the large map. Throughput is in routes.
fn route(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("route");
    group.throughput(Throughput::Elements(1));
    for config in ["expert", "metropolis"] {
        let (_, router, places) = planner(config);
        for kind in AgentKind::ALL {
            let mut at = places.nth(kind, places.count(kind) / 2).expect("a place");
            let mut draw = 0;
            group.bench_function(format!("{config}/{}", kind.name()), |bencher| {
                bencher.iter(|| {
                    draw += 1;
                    let mut stream = Seed(1).stream(Purpose::GOAL, 0, draw);
                    let route = places.draw_route(&router, kind, at, &mut stream).expect("a way");
                    at = route.goal();
                    route
                });
            });
        }
    }
    let (_, router, places) = planner("metropolis");
    let count = places.count(AgentKind::Car);
    let place = |number: usize| places.nth(AgentKind::Car, number % count).expect("a place");
    let mut number = 0;
    group.bench_function("metropolis/far", |bencher| {
        bencher.iter(|| {
            number += 7_654_321;
            router
                .plan(AgentKind::Car, place(number), place(3 * number))
                .expect("a way")
        });
    });
    group.finish();
}

/// Moves the agents of the expert test city at their normal speeds, replanning included. Throughput is in moves.
fn moves(criterion: &mut Criterion) {
    let (set, router, places) = planner("expert");
    let mut agents = place_agents(&set, &router, &places, Seed(1)).expect("agents placed");
    let mut group = criterion.benchmark_group("advance");
    group.throughput(Throughput::Elements(agents.len() as u64));
    let actions = ActionTable::default();
    let mut surroundings = Surroundings {
        router: &router,
        places: &places,
        actions: &actions,
        seed: Seed(1),
        tick: 0,
    };
    group.bench_function("expert", |bencher| {
        bencher.iter(|| {
            surroundings.tick += 1;
            for (index, agent) in agents.iter_mut().enumerate() {
                black_box(advance(agent, index, Action::Normal, &surroundings));
            }
        });
    });
    group.finish();
}

criterion_group! {
    name = city;
    // Long enough for figures within some percent of each other; all of `cargo bench` takes minutes.
    config = Criterion::default().warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(3));
    targets = tick, clauses, towns, infer, rules, route, moves
}
criterion_main!(city);
