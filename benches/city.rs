//! The city: a tick of the simulation, and the inference of one scene.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use logicity::config::{Split, load_scenario};
use logicity::diag::Sources;
use logicity::engine::Program;
use logicity::files::{read_or_builtin, read_text};
use logicity::lang;
use logicity::rng::Seed;
use logicity::sim::{Inference, Simulation, World};
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
        let mut simulation = Simulation::new(Arc::new(world(mode)), Split::Test, Seed(1)).expect("agents placed");
        group.throughput(Throughput::Elements(simulation.agents().len() as u64));
        group.bench_function(mode, |bencher| {
            bencher.iter(|| simulation.tick(&[]).expect("within limits"));
        });
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

criterion_group!(city, tick, infer);
criterion_main!(city);
