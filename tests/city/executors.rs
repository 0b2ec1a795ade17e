//! Compares the executors: a run is the same with either one, on any number of threads.

use crate::agreement::{go_the_same_way, multiply, simulation};
use crate::shipped_world::{MODES, world};
use logicity::cancel::Cancel;
use logicity::city::{Action, AgentKind, Building, Buildings, Split, Terrain, TripEnds};
use logicity::diag::codes;
use logicity::rng::Seed;
use logicity::sim::{Batch, Executor, Settings, Simulation, WINDOW_MAX, World};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// The number of ticks to compare. README describes `LOGICITY_TICKS`.
fn ticks() -> u64 {
    std::env::var("LOGICITY_TICKS").map_or(300, |ticks| ticks.parse().expect("a number of ticks"))
}

#[test]
fn executors_agree_in_every_mode() {
    let modes = MODES.iter().map(|&mode| (mode, None));
    for (mode, rules) in modes.chain([("expert", Some(include_str!("../fixtures/rules/traffic-code.dl")))]) {
        let world = world(mode, rules, |_| ());
        let dense = simulation(&world, Executor::Dense, 1);
        assert_eq!(dense.executor(), Executor::Dense);
        go_the_same_way(&mut [dense, simulation(&world, Executor::Relational, 1)], ticks());
    }
}

/// A city that continues with the agents of another one equals that one; under other rules, these decide.
#[test]
fn a_resumed_run_continues_the_first_one() {
    let resume = |world: &Arc<World>, executor, of: &Simulation| {
        let settings = Settings {
            executor,
            count_firings: true,
            threads: 1,
        };
        let start = (of.now(), of.agents().to_vec());
        Simulation::resume(
            Arc::clone(world),
            of.split(),
            of.seed(),
            settings,
            start,
            &Cancel::never(),
        )
        .unwrap()
    };
    for mode in MODES {
        let world = world(mode, None, |_| ());
        let mut first = simulation(&world, Executor::Auto, 1);
        for _ in 0..17 {
            first.tick(&[]).unwrap();
        }
        let others = [Executor::Dense, Executor::Relational].map(|executor| resume(&world, executor, &first));
        go_the_same_way(&mut [first].into_iter().chain(others).collect::<Vec<_>>(), ticks() / 4);
    }
    let mut first = simulation(&world("expert", None, |_| ()), Executor::Auto, 1);
    for _ in 0..17 {
        first.tick(&[]).unwrap();
    }
    let halt = Some(".include \"vocabulary.dl\"\nStop(X) :- IsCar(X).");
    let mut halted = resume(&world("expert", halt, |_| ()), Executor::Auto, &first);
    let report = halted.tick(&[]).unwrap();
    assert_eq!(report.tick, 17);
    for (done, agent) in report.agents.iter().zip(first.agents()) {
        assert_eq!(done.moved.from, agent.cell);
        assert_eq!(done.action == Action::Stop, agent.kind == AgentKind::Car);
    }
}

/// Cancelled at any poll of a tick, the simulation is unchanged, and its next ticks are those of another that was never
/// cancelled.
#[test]
fn a_cancelled_tick_leaves_the_simulation_unchanged() {
    let world = world("expert", None, |_| ());
    let settings = Settings {
        executor: Executor::Relational,
        ..Settings::default()
    };
    let left = Arc::new(AtomicI64::new(i64::MAX));
    let polls = Arc::clone(&left);
    let cancel = Cancel::when(move || polls.fetch_sub(1, Ordering::Relaxed) <= 0);
    let city = || Simulation::new_with(Arc::clone(&world), Split::Test, Seed(3), settings, &cancel);
    left.store(3, Ordering::Relaxed);
    assert_eq!(city().err().unwrap().code, codes::CANCELLED);
    left.store(i64::MAX, Ordering::Relaxed);
    let (mut city, mut twin) = (city().unwrap(), simulation(&world, Executor::Dense, 1));
    for tick in 0..20 {
        let mut given_up = 0;
        while let Err(fault) = {
            left.store(given_up, Ordering::Relaxed);
            city.tick(&[])
        } {
            assert_eq!((fault.code, city.now()), (codes::CANCELLED, tick));
            given_up += 1;
        }
        assert!(given_up > 100, "{given_up}");
        assert_eq!(city.report().agents, twin.tick(&[]).unwrap().agents);
    }
}

/// Runs of a batch equal single runs, on any number of threads.
#[test]
fn a_batch_equals_single_cities() {
    for &mode in MODES {
        let world = world(mode, None, |_| ());
        let city = |seed| Simulation::new(Arc::clone(&world), Split::Test, Seed(seed), Settings::default()).unwrap();
        let mut batches: Vec<Batch> = (1..=3)
            .map(|threads| Batch::new((0..5).map(city).collect(), threads).unwrap())
            .collect();
        let mut alone: Vec<Simulation> = (0..5).map(city).collect();
        for tick in 0..ticks() {
            for batch in &mut batches {
                // The first agent of the third city must stop.
                batch
                    .tick(|city| if city == 2 { &[(0, Action::Stop)] } else { &[] })
                    .unwrap();
            }
            for (number, city) in alone.iter_mut().enumerate() {
                let controls: &[_] = if number == 2 { &[(0, Action::Stop)] } else { &[] };
                city.tick(controls).unwrap();
                for batch in &batches {
                    assert_eq!(
                        batch.cities()[number].report().agents,
                        city.report().agents,
                        "tick {tick}"
                    );
                }
            }
        }
    }
}

/// A control replaces the decided action in one tick, on any number of threads. The last control of an agent counts.
#[test]
fn controls_replace_decisions() {
    let world = world("expert", None, |scenario| multiply(scenario, 20));
    for threads in [1, 3] {
        let (mut free, mut led) = (
            simulation(&world, Executor::Dense, threads),
            simulation(&world, Executor::Dense, threads),
        );
        assert_eq!(led.threads(), threads);
        let count = led.agents().len();
        for tick in 0..10 {
            // Both simulations have the same state before every tick, so only the control can make a difference.
            let decided = free.tick(&[]).unwrap().clone();
            let given = [
                (count - 1, Action::Fast),
                (tick, Action::Slow),
                (count - 1, decided.agents[count - 1].action),
                (tick, decided.agents[tick].action),
            ];
            assert_eq!(led.tick(&given).unwrap().agents, decided.agents, "tick {tick}");
        }
        let decided = free.tick(&[]).unwrap().agents.clone();
        let stops: Vec<_> = (0..count).step_by(2).map(|agent| (agent, Action::Stop)).collect();
        for (agent, done) in led.tick(&stops).unwrap().agents.iter().enumerate() {
            match agent % 2 {
                0 => assert_eq!((done.action, done.moved.from), (Action::Stop, done.moved.to)),
                _ => assert_eq!(*done, decided[agent]),
            }
        }
        // A control does not last until the next tick.
        let rested = led.tick(&[]).unwrap();
        assert!(rested.agents.iter().any(|done| done.action != Action::Stop));
    }
}

/// A control of a missing agent fails before the tick; the other cities of a batch take theirs.
#[test]
fn controls_of_missing_agents_are_errors() {
    let world = world("easy", None, |_| ());
    let mut city = simulation(&world, Executor::Dense, 1);
    let count = city.agents().len();
    let before: Vec<_> = city.agents().iter().map(|agent| agent.cell).collect();
    let fault = city.tick(&[(0, Action::Fast), (count, Action::Stop)]).unwrap_err();
    assert!(
        fault.message.contains(&format!("no agent {count} to control")),
        "{}",
        fault.message
    );
    assert!(city.now() == 0 && city.agents().iter().map(|agent| agent.cell).eq(before));
    let mut alone = simulation(&world, Executor::Dense, 1);
    assert_eq!(
        city.tick(&[]).unwrap().agents,
        alone.tick(&[]).unwrap().agents,
        "a list with an error has no effect"
    );

    for threads in [1, 3] {
        let cities = (0..4).map(|_| simulation(&world, Executor::Dense, 1)).collect();
        let mut batch = Batch::new(cities, threads).unwrap();
        let absent = [[(count + 1, Action::Stop)], [(count + 2, Action::Stop)]];
        let fault = batch.tick(|city| match city {
            1 => &absent[0],
            3 => &absent[1],
            _ => &[],
        });
        assert!(fault.unwrap_err().message.contains(&format!("agent {}", count + 1)));
        let times: Vec<u64> = batch.cities().iter().map(Simulation::now).collect();
        assert_eq!(times, [1, 0, 1, 0]);
    }
}

/// More agents than fit one window: tiles on one thread and on three equal the relational executor.
#[test]
fn slow_tiles_equal_the_relational_executor() {
    for (mode, times, ticks) in [("expert", 20, 30), ("vap-hard", 30, 12)] {
        let world = world(mode, None, |scenario| multiply(scenario, times));
        let mut simulations = [
            simulation(&world, Executor::Relational, 1),
            simulation(&world, Executor::Auto, 1),
            simulation(&world, Executor::Dense, 3),
        ];
        assert!(simulations[0].agents().len() > 256);
        assert_eq!(simulations[1].executor(), Executor::Dense);
        go_the_same_way(&mut simulations, ticks);
    }
}

/// Threads of a batch evaluate a city of tiles.
#[test]
fn a_batch_of_large_cities_equals_single_cities() {
    let world = world("expert", None, |scenario| multiply(scenario, 20));
    let mut batch = Batch::new((0..3).map(|_| simulation(&world, Executor::Dense, 1)).collect(), 3).unwrap();
    let mut alone = simulation(&world, Executor::Dense, 1);
    for _ in 0..10 {
        batch.tick(|_| &[]).unwrap();
        alone.tick(&[]).unwrap();
        for city in batch.cities() {
            assert_eq!(city.report().agents, alone.report().agents);
        }
    }
}

/// Windows of 64 words, and more agents around one place than a window holds.
#[test]
fn slow_crowds_have_a_limit() {
    let fits = world("vap-hard", None, |scenario| {
        multiply(scenario, 100);
        // Lanes have fewer cells where cars start than curbs.
        scenario.trip_ends = TripEnds::Curb;
    });
    let mut fits = simulation(&fits, Executor::Dense, 1);
    let everything = world("vap-hard", None, |scenario| {
        multiply(scenario, 100);
        scenario.trip_ends = TripEnds::Curb;
        scenario.view = 1000;
    });
    let mut everything = simulation(&everything, Executor::Dense, 1);
    assert!((1025..WINDOW_MAX).contains(&everything.agents().len()));
    fits.tick(&[]).unwrap();
    everything.tick(&[]).unwrap();

    let dense_city = world("expert", None, |scenario| {
        let mut splits = scenario.splits.iter_mut();
        let (_, set) = splits.find(|(split, _)| *split == Split::Test).unwrap();
        (set.region, set.repeat, set.cars) = (None, 300, Vec::new());
        set.pedestrians.truncate(1);
        set.pedestrians[0].count = 15;
        let Terrain::Blocks(map) = &mut scenario.map.terrain else {
            panic!("a map of blocks")
        };
        map.blocks.value = [6, 6];
        map.buildings.value = Buildings::Random {
            seed: 1,
            weights: vec![(Building::House, 1.0)],
        };
        scenario.view = 1000;
    });
    // Several tiles are too crowded; the error names the same one on any number of threads.
    let error = |threads| {
        simulation(&dense_city, Executor::Dense, threads)
            .tick(&[])
            .unwrap_err()
            .message
    };
    let first = error(1);
    for threads in [2, 3, 4] {
        assert_eq!(error(threads), first);
    }
    let mut dense_city = simulation(&dense_city, Executor::Dense, 2);
    let before: Vec<_> = dense_city.agents().iter().map(|agent| agent.cell).collect();
    let fault = dense_city.tick(&[]).unwrap_err();
    assert!(
        fault.message.contains("4500 agents around the cell"),
        "{}",
        fault.message
    );
    assert!(dense_city.agents().iter().map(|agent| agent.cell).eq(before));
    assert_eq!((dense_city.now(), dense_city.firings().iter().sum::<usize>()), (0, 0));
}

/// All agents see each other: windows of several words, with up to 300 entities in view.
#[test]
fn slow_executors_agree_about_many_entities_in_view() {
    for times in [4, 9, 17] {
        let world = world("expert", None, |scenario| {
            multiply(scenario, times);
            scenario.view = 1000;
        });
        go_the_same_way(
            &mut [
                simulation(&world, Executor::Relational, 1),
                simulation(&world, Executor::Dense, 2),
            ],
            6,
        );
    }
}

/// Rules that use every predicate in both directions, and beyond the field of view.
#[test]
fn executors_agree_about_rules_with_all_predicates() {
    let text = r#"
        .include "vocabulary.dl"
        .decl Behind(x: agent, y: agent)
        Behind(X, Y) :- LeftOf(Y, X), !Sees(Y, X), HigherPri(X, Y).
        Behind(X, Y) :- CollidingClose(Y, X), !CollidingClose(X, Y).
        Stop(X) :- IsClose(Y, X), RightOf(X, Y), !NextTo(X, _).
        Stop(X) :- Behind(Y, X), Sees(X, Y), !CollidingClose(_, X).
        Slow(X) :- !Stop(X), Sees(X, X), Behind(X, Y), HigherPri(Z, Y), NextTo(Z, X), IsInInter(Z).
        Fast(X) :- !Stop(X), !Slow(X), HigherPri(X, Y), !LeftOf(Y, X), IsAtInter(Y), IsBus(X).
    "#;
    for times in [1, 5] {
        let world = world("expert", Some(text), |scenario| multiply(scenario, times));
        go_the_same_way(
            &mut [
                simulation(&world, Executor::Relational, 1),
                simulation(&world, Executor::Dense, 1),
            ],
            60,
        );
    }
}

#[test]
fn rules_that_are_not_dense_are_reported() {
    let text = ".include \"vocabulary.dl\"\n.decl Linked(x: agent, y: agent)\nLinked(X, Y) :- NextTo(X, Y).\n\
                Linked(X, Z) :- Linked(X, Y), NextTo(Y, Z).\nStop(X) :- Linked(X, Y), IsBus(Y).";
    let world = world("expert", Some(text), |_| ());
    let settings = Settings {
        executor: Executor::Dense,
        ..Settings::default()
    };
    let Err(fault) = Simulation::new(Arc::clone(&world), Split::Test, Seed(3), settings) else {
        panic!("the dense executor took recursive rules")
    };
    let reason = "the dense executor cannot evaluate these rules, because `Linked` depends on itself";
    assert_eq!(fault.message, reason);
    assert_eq!(
        simulation(&world, Executor::Auto, 1).fallback().unwrap().message,
        "the relational executor evaluates some clauses, the first because `Linked` depends on itself"
    );
    assert_eq!(
        simulation(&world, Executor::Relational, 1)
            .fallback()
            .map(|reason| &reason.message),
        None
    );
}
