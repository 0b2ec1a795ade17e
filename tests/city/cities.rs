//! The cities of the tutorials and of `benches/town.yaml`: their rules are short, and nobody is stuck in them.

use crate::shipped_world::{of_file, world};
use logicity::city::Split;
use logicity::rng::Seed;
use logicity::sim::{Executor, Settings, Simulation};
use std::sync::Arc;

const CITIES: [&str; 7] = [
    "courteous",
    "traffic-lights",
    "four-way-stop",
    "school-zone",
    "tram-line",
    "emergency-corridor",
    "hesitant-drivers",
];

/// Returns the time without a move, in ticks, after which an agent of a city counts as stuck.
fn stuck(city: &str) -> u32 {
    match city {
        // A red light lasts 37 ticks.
        "traffic-lights" | "town" => 50 + 37,
        _ => 50,
    }
}

/// The tutorials have at most 25 clauses.
#[test]
fn agents_keep_moving() {
    let shipped = CITIES.map(|city| (city, world(city, None, |_| ())));
    for (city, world) in shipped.into_iter().chain([("town", of_file("benches/town.yaml"))]) {
        assert!(world.program.rules().clauses.len() <= 25 || city == "town", "{city}");
        let settings = Settings {
            executor: Executor::Dense,
            ..Settings::default()
        };
        for seed in 0..2 {
            let mut run = Simulation::new(Arc::clone(&world), Split::Test, Seed(seed), settings).unwrap();
            let mut decided = [0; 4];
            for tick in 0..500 {
                for (agent, done) in run.tick(&[]).unwrap().agents.iter().enumerate() {
                    assert!(
                        done.waited < stuck(city),
                        "agent {agent} of {city} waits in tick {tick} of seed {seed}"
                    );
                    decided[done.action.index()] += 1;
                }
            }
            assert!(decided[1] > decided[3], "{city}: {decided:?}");
        }
    }
}
