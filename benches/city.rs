//! The city: a tick of the simulation, and the inference of one scene.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use logicity::config::{Speed, Split, load_scenario};
use logicity::diag::Sources;
use logicity::engine::Program;
use logicity::engine::dense::{BitFacts, Counting, Dense, Frame, choose, has};
use logicity::files::{read_or_builtin, read_text};
use logicity::lang;
use logicity::rng::Seed;
use logicity::sim::{Executor, Inference, Settings, Simulation, World};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

fn world(mode: &str) -> World {
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new(mode), &read_text).expect("a built-in configuration");
    let text = read_or_builtin(&scenario.rules.value).expect("built-in rules");
    let entry = sources.add(scenario.rules.value.display().to_string(), text);
    let rules = lang::load(&mut sources, entry, &read_or_builtin)
        .rules
        .expect("clean rules");
    World::new(scenario, Program::new(rules).expect("within limits")).expect("a city")
}

/// Ticks of the test city of a mode; throughput is in decisions.
fn tick(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tick");
    for mode in ["easy", "expert"] {
        let world = Arc::new(world(mode));
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

/// One scene, from text to answer; throughput is in scenes.
fn infer(criterion: &mut Criterion) {
    let World { scenario, program, .. } = world("expert");
    let mut inference = Inference::new(scenario, program, Seed(0), read_text).expect("rules fit");
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

/// The rules alone, on facts that are ready: the bit rows of the expert test city at 64 moments of a run. Throughput is in
/// decisions.
fn rules(criterion: &mut Criterion) {
    const WIDTH: usize = 1;
    let world = Arc::new(world("expert"));
    let rules = world.program.rules();
    let steady = |relation| {
        let predicate = world
            .vocabulary
            .predicates
            .iter()
            .find(|predicate| predicate.relation == Some(relation));
        predicate
            .is_some_and(|predicate| matches!(predicate.definition, Definition::Kind(_) | Definition::Concept { .. }))
    };
    let dense = Dense::new(rules, &choose(rules), Counting::Off, steady);
    let mut simulation =
        Simulation::new(Arc::clone(&world), Split::Test, Seed(1), Settings::default()).expect("agents placed");
    let count = simulation.agents().len();
    let mut frame: Frame<WIDTH> = Frame::new(&dense, count);
    let moments: Vec<BitFacts<WIDTH>> = (0..64)
        .map(|_| {
            for _ in 0..7 {
                simulation.tick(&[]).expect("within limits");
            }
            let mut facts = BitFacts::new(&dense, count);
            for (index, predicate) in world.vocabulary.predicates.iter().enumerate() {
                let Some(relation) = predicate.relation else { continue };
                for row in simulation.rows(index) {
                    facts.insert(&dense, relation, &row.map(|entity| entity as usize)[..predicate.arity]);
                }
            }
            facts.load(&dense, &mut frame);
            frame.run(&dense, &facts);
            for speed in Speed::ALL {
                let relation = world.vocabulary.action(speed).expect("all are in use");
                let set = frame.set(&dense, relation).expect("it is derived");
                let moment = simulation.moment().expect("within limits");
                for agent in 0..count {
                    let holds = moment.session().contains(relation, &[moment.value(agent)]);
                    assert_eq!(has(set, agent), holds, "{} of {agent}", speed.name());
                }
            }
            facts
        })
        .collect();
    let mut group = criterion.benchmark_group("rules");
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function("expert", |bencher| {
        let mut moment = 0;
        bencher.iter(|| {
            moment = (moment + 1) % moments.len();
            moments[moment].load(&dense, &mut frame);
            frame.run(&dense, &moments[moment]);
            black_box(&frame);
        });
    });
    group.finish();
}

criterion_group!(city, tick, infer, rules);
criterion_main!(city);
