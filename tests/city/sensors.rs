//! Sensors of Safe Path Following: what they hide, their rates, and the probabilities that follow from readings.

use crate::shipped_world::{task, task_of};
use logicity::cancel::Cancel;
use logicity::city::{Action, Agent, AgentKind, Cell, CityMap, Split};
use logicity::config::Sensor;
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::{Decider, Observer, observed_columns};
use logicity::task::spf::{Autoreset, Begin, ControlMode, Env, EpisodeSource, ObservationKind, SpfTask, VectorEnv};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// Expert mode with these sensors, as a mapping in YAML.
fn sensed(sensors: &str) -> Arc<SpfTask> {
    let config = format!("base: expert\ntask: {{sensors: {sensors}}}\n");
    Arc::new(task_of(&config).unwrap_or_else(|faults| panic!("{faults:?}")))
}

/// Expert mode with a sensor for all predicates.
fn with(output: &str, sensor: &Sensor) -> Arc<SpfTask> {
    let occluders = [
        ("buildings", sensor.occluded_by_buildings),
        ("agents", sensor.occluded_by_agents),
    ];
    let occluders = occluders.into_iter().filter(|(_, hides)| *hides).map(|(name, _)| name);
    let range = sensor.range.map_or(String::new(), |range| format!("range: {range}, "));
    sensed(&format!(
        "{{output: {output}, true_positive_rate: {}, false_positive_rate: {}, {range}occluded_by: [{}], delay: {}, \
         dropout: {}, correlation: {}}}",
        sensor.true_positive_rate,
        sensor.false_positive_rate,
        occluders.collect::<Vec<_>>().join(", "),
        sensor.delay,
        sensor.dropout,
        sensor.correlation,
    ))
}

/// A fact: a predicate by its position, and agents by theirs.
type Fact = (usize, Vec<usize>);

/// Returns the observed numbers of all facts about the observed agents.
fn numbers(env: &Env) -> BTreeMap<Fact, f32> {
    let task = env.task();
    let mut observation = vec![f32::NAN; task.observation_width()];
    env.observe(0, &mut observation);
    let agents: Vec<usize> = env.controlled_cars()[0].observer().entities().collect();
    let most = task.config().entities as usize;
    let (mut numbers, mut start) = (BTreeMap::new(), 0);
    for column in observed_columns(task.world(), most) {
        for (place, number) in observation[start..][..column.width].iter().enumerate() {
            let entities = match column.arity {
                1 => vec![place],
                _ => vec![place / most, place % most],
            };
            let same = entities.len() == 2 && entities[0] == entities[1];
            match entities.iter().all(|entity| *entity < agents.len()) && !same {
                true => {
                    _ = numbers.insert(
                        (column.predicate, entities.iter().map(|at| agents[*at]).collect()),
                        *number,
                    )
                }
                false => assert_eq!(*number, 0.0, "{} {entities:?}", column.name),
            }
        }
        start += column.width;
    }
    numbers
}

fn truths(observer: &Observer) -> BTreeSet<Fact> {
    observer.atoms().collect()
}

/// Runs episodes as the rules want. Calls `each` with the environment in each state, and whether it is the first.
fn drive(env: &mut Env, episodes: std::ops::Range<u64>, mut each: impl FnMut(&Env, bool)) {
    for seed in episodes {
        env.reset(seed).unwrap();
        each(env, true);
        while env.controlled_cars()[0].is_running() {
            env.step(&[env.oracle_action(0)]).unwrap();
            each(env, false);
        }
    }
}

fn env(task: &Arc<SpfTask>, split: Split) -> Env {
    Env::new(Arc::clone(task), split, ControlMode::First).unwrap()
}

/// Whether a sensor of the ego reaches an agent: by distance, and by the cells nearest to the line between them.
fn visible(sensor: &Sensor, map: &CityMap, agents: &[Agent], ego: usize, other: usize) -> bool {
    let [from, to] = [agents[ego].cell, agents[other].cell];
    let [rows, cols] = [to.row - from.row, to.col - from.col].map(f64::from);
    if sensor.range.is_some_and(|range| rows.hypot(cols) > f64::from(range)) {
        return false;
    }
    let steps = rows.abs().max(cols.abs());
    #[allow(clippy::cast_possible_truncation)] // small
    let along = |step: i32, whole: f64| (f64::from(step) * whole / steps + 0.5).floor() as i32;
    #[allow(clippy::cast_possible_truncation)]
    let between = (1..steps as i32).map(|step| Cell::new(from.row + along(step, rows), from.col + along(step, cols)));
    let blocks = |cell: Cell| {
        let third = |(at, agent): (usize, &Agent)| at != ego && at != other && agent.cell == cell;
        sensor.occluded_by_buildings && map.building_at(cell).is_some()
            || sensor.occluded_by_agents && agents.iter().enumerate().any(third)
    };
    !between.into_iter().any(blocks)
}

/// Exact sensors read what was true and visible some ticks before.
#[test]
fn hidden_and_late_readings_are_those_of_the_definition() {
    let mut random = Seed(8).stream(Purpose::TEST, 0, 0);
    for case in 0..6 {
        let sensor = Sensor {
            range: (case % 2 == 0).then(|| random.random_range(4..20)),
            occluded_by_buildings: case % 3 != 0,
            occluded_by_agents: case % 3 != 1,
            delay: if case < 2 { 0 } else { random.random_range(1..6) },
            ..Sensor::default()
        };
        let task = with("facts", &sensor);
        let (mut past, mut hidden, mut late) = (VecDeque::new(), 0, 0);
        drive(&mut env(&task, Split::Test), 0..8, |env, first| {
            let observer = env.controlled_cars()[0].observer();
            if first {
                past.clear();
            }
            let (map, agents, ego) = (task.world().map(), env.city().agents(), observer.ego());
            let seen = observer
                .entities()
                .filter(|other| *other == ego || visible(&sensor, map, agents, ego, *other));
            let observed: BTreeSet<usize> = observer.entities().collect();
            past.push_back((truths(observer), seen.collect::<BTreeSet<usize>>(), observed));
            let measured = past.len().checked_sub(sensor.delay as usize + 1).map(|at| &past[at]);
            for (fact, number) in numbers(env) {
                let expected = measured.is_some_and(|(held, seen, observed)| {
                    let reached = fact
                        .1
                        .iter()
                        .all(|agent| seen.contains(agent) && observed.contains(agent));
                    hidden += u32::from(held.contains(&fact) && !reached);
                    held.contains(&fact) && reached
                });
                assert_eq!(number == 1.0, expected, "{sensor:?}: {fact:?}");
                late += u32::from(expected != past.back().unwrap().0.contains(&fact));
            }
        });
        assert!(
            hidden > 0 && (sensor.delay == 0 || late > 0),
            "{sensor:?}: {hidden} {late}"
        );
    }
}

/// Readings have the configured rates, whatever the correlation, and noise has the configured correlation.
#[test]
fn readings_have_the_rates_and_correlations_of_their_sensor() {
    for correlation in [0.0, 0.7] {
        let sensor = Sensor {
            true_positive_rate: 0.85,
            false_positive_rate: 0.1,
            dropout: 0.2,
            correlation,
            ..Sensor::default()
        };
        let task = with("facts", &sensor);
        let mut counts = [[0.0f64; 2]; 2];
        drive(&mut env(&task, Split::Test), 0..60, |env, _| {
            let held = truths(env.controlled_cars()[0].observer());
            for (fact, number) in numbers(env) {
                let counts = &mut counts[usize::from(held.contains(&fact))];
                counts[0] += 1.0;
                counts[1] += f64::from(number);
            }
        });
        for ([total, read], rate) in counts.into_iter().zip([0.1, 0.85]) {
            assert!(
                (read / total - rate * 0.8).abs() < 0.01,
                "{correlation}: {read} of {total}"
            );
        }
        // Readings that do not depend on the truth show the noise.
        let sensor = Sensor {
            true_positive_rate: 0.5,
            false_positive_rate: 0.5,
            correlation,
            ..Sensor::default()
        };
        let task = with("facts", &sensor);
        let (mut before, mut pairs, mut product) = (BTreeMap::new(), 0.0, 0.0);
        drive(&mut env(&task, Split::Test), 0..30, |env, first| {
            if first {
                before.clear();
            }
            let now = numbers(env);
            for (fact, number) in &now {
                if let Some(earlier) = before.get(fact) {
                    pairs += 1.0;
                    product += f64::from((number - 0.5) * (earlier - 0.5)) * 4.0;
                }
            }
            before = now;
        });
        assert!(
            (product / pairs - correlation).abs() < 0.02,
            "{correlation}: {}",
            product / pairs
        );
    }
}

/// Of the facts with a probability near p, a share near p holds; beliefs predict better than single readings.
#[test]
fn probabilities_are_calibrated() {
    for sensor in [
        Sensor {
            true_positive_rate: 0.9,
            false_positive_rate: 0.15,
            ..Sensor::default()
        },
        Sensor {
            true_positive_rate: 0.8,
            false_positive_rate: 0.1,
            dropout: 0.3,
            delay: 1,
            correlation: 0.5,
            ..Sensor::default()
        },
    ] {
        let mut scores = Vec::new();
        for output in ["facts", "probabilities", "belief"] {
            let task = with(output, &sensor);
            let (mut bins, mut squares, mut all) = ([[0.0f64; 3]; 10], 0.0, 0.0);
            drive(&mut env(&task, Split::Train), 500..600, |env, _| {
                let held = truths(env.controlled_cars()[0].observer());
                for (fact, number) in numbers(env) {
                    assert!((0.0..=1.0).contains(&number), "{number}");
                    let holds = f64::from(u8::from(held.contains(&fact)));
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a bin
                    let bin = &mut bins[((number * 10.0) as usize).min(9)];
                    *bin = [bin[0] + 1.0, bin[1] + f64::from(number), bin[2] + holds];
                    squares += (f64::from(number) - holds).powi(2);
                    all += 1.0;
                }
            });
            if output != "facts" {
                assert!(
                    bins.iter().filter(|bin| bin[0] > 500.0).count() >= 3,
                    "{output}: {bins:?}"
                );
                for [count, predicted, holds] in bins.into_iter().filter(|bin| bin[0] > 500.0) {
                    let error = (predicted - holds).abs() / count;
                    assert!(
                        error < 0.05,
                        "{output} {sensor:?}: {count} facts, {predicted} and {holds}"
                    );
                }
            }
            scores.push(squares / all);
        }
        // The Brier scores.
        assert!(scores[2] < scores[1] && scores[1] < scores[0], "{sensor:?}: {scores:?}");
    }
}

/// Vectors observe through sensors as individual environments do, on any number of threads.
#[test]
fn vectors_and_repetitions_read_the_same() {
    let task = sensed(
        "{output: belief, true_positive_rate: .9, false_positive_rate: .1, correlation: .5, dropout: .1, ego: exact, \
         predicates: {IsClose: {range: 15, delay: 1}, LeftOf: {occluded_by: buildings}}}",
    );
    let width = task.observation_width();
    let run = |threads: usize| {
        let sources = (0..12).map(|seed| EpisodeSource::new(seed, None));
        let view = ObservationKind::Groundings;
        let mut vector = VectorEnv::new(
            &task,
            (Split::Train, ControlMode::First),
            sources,
            Autoreset::SameStep,
            view,
            threads,
        )
        .unwrap();
        let mut shown = vec![0.0; 12 * width];
        vector.reset(&vec![Some(Begin::Next); 12], &mut shown).unwrap();
        let mut all = shown.clone();
        for _ in 0..60 {
            let wanted: Vec<_> = vector
                .sub_envs()
                .iter()
                .map(|sub_env| sub_env.env().oracle_action(0))
                .collect();
            vector.step(&wanted, &mut shown).unwrap();
            all.extend_from_slice(&shown);
        }
        all
    };
    let one = run(1);
    assert_eq!(one, run(3));
    let mut alone = Env::new(Arc::clone(&task), Split::Train, ControlMode::First).unwrap();
    let mut source = EpisodeSource::new(5, None);
    source.begin(&mut alone).unwrap();
    let mut shown = vec![0.0; width];
    for step in 0..=60 {
        alone.observe(0, &mut shown);
        assert_eq!(shown, one[(step * 12 + 5) * width..][..width], "{step}");
        let wanted = alone.oracle_action(0);
        alone.step(&[wanted]).unwrap();
        if !alone.controlled_cars()[0].is_running() {
            source.begin(&mut alone).unwrap();
        }
    }
}

/// The ego may know the facts about itself; and every car of a city has noise of its own.
#[test]
fn facts_about_the_ego_may_be_exact() {
    let half = "true_positive_rate: .5, false_positive_rate: .5";
    let task = sensed(&format!("{{ego: exact, {half}}}"));
    let mut wrong = 0;
    drive(&mut env(&task, Split::Test), 0..5, |env, _| {
        let observer = env.controlled_cars()[0].observer();
        let (held, ego) = (truths(observer), observer.ego());
        for (fact, number) in numbers(env) {
            let differs = held.contains(&fact) != (number == 1.0);
            assert!(!differs || fact.1 != [ego], "{fact:?}");
            wrong += u32::from(differs);
        }
    });
    assert!(wrong > 0);
    // Noise that does not depend on the facts is equal for two cars in half of the numbers.
    let task = sensed(&format!("{{{half}}}"));
    let mut env = Env::new(Arc::clone(&task), Split::Train, ControlMode::Egos).unwrap();
    let (mut equal, mut all) = (0.0, 0.0);
    for seed in 0..40 {
        env.reset(seed).unwrap();
        let [one, two] = [0, 1].map(|car| {
            let mut observation = vec![0.0; task.observation_width()];
            env.observe(car, &mut observation);
            let most = task.config().entities as usize;
            // Facts about the car alone come first in the columns of unary predicates.
            observation.into_iter().step_by(most).take(11).collect::<Vec<f32>>()
        });
        equal += one
            .iter()
            .zip(&two)
            .map(|(one, two)| f64::from(u8::from(one == two)))
            .sum::<f64>();
        all += 11.0;
    }
    assert!((equal / all - 0.5).abs() < 0.1, "{equal} of {all}");
}

/// Sensors without delay, dropout, correlation and exact facts have code of their own. `ego: exact` needs the general code,
/// which must read the same.
#[test]
fn simple_sensors_equal_general_ones() {
    for (output, more) in [
        ("facts", ", occluded_by: [buildings, agents]"),
        ("probabilities", ", range: 14"),
        ("belief", ", range: 14, occluded_by: agents"),
    ] {
        let rates = format!("output: {output}, true_positive_rate: .8, false_positive_rate: .3{more}");
        let tasks = [format!("{{{rates}}}"), format!("{{{rates}, ego: exact}}")].map(|text| sensed(&text));
        let run = |task: &Arc<SpfTask>| {
            let mut all = Vec::new();
            drive(&mut env(task, Split::Train), 0..4, |env, _| {
                let ego = env.controlled_cars()[0].observer().ego();
                let others = numbers(env).into_iter().filter(|(fact, _)| fact.1 != [ego]);
                all.push(others.collect::<Vec<_>>());
            });
            all
        };
        let [simple, general] = tasks.each_ref().map(run);
        assert!(simple.len() > 100, "{}", simple.len());
        assert_eq!(simple, general, "{output}");
    }
}

/// Without any reading, a belief is that of agents that have just come into view, whatever the delay.
#[test]
fn late_readings_do_not_age_beliefs() {
    let late = sensed("{output: belief, delay: 100}");
    let never = sensed("{output: belief, dropout: 1}");
    let (mut late, mut never) = (env(&late, Split::Test), env(&never, Split::Test));
    for seed in 0..5 {
        late.reset(seed).unwrap();
        never.reset(seed).unwrap();
        for _ in 0..20 {
            let (one, two) = (numbers(&late), numbers(&never));
            assert!(
                one.iter()
                    .zip(&two)
                    .all(|(one, two)| one.0 == two.0 && (one.1 - two.1).abs() < 1e-5)
            );
            if !late.controlled_cars()[0].is_running() {
                break;
            }
            let action = late.oracle_action(0);
            late.step(&[action]).unwrap();
            never.step(&[action]).unwrap();
        }
    }
}

#[test]
fn faulty_sensors_are_reported_at_their_place() {
    let fault = |sensors: &str| {
        let config = format!(
            "base: expert\npredicates: {{define: {{Waited: {{quantity: waited}}}}}}\nrules: expert\n\
             task: {{sensors: {sensors}}}\n"
        );
        let faults = task_of(&config).err().unwrap_or_default();
        assert_eq!(faults.len(), 1, "{sensors}: {faults:?}");
        faults[0].message.clone() + &faults[0].help.concat()
    };
    for (sensors, message) in [
        ("{true_positive_rate: 1.5}", "a probability from 0 to 1"),
        ("{correlation: 1}", "a correlation from 0 to 0.999"),
        ("{delay: 101}", "a whole number from 0 to 100"),
        ("{occluded_by: [trees]}", "`buildings`, `agents`"),
        ("{output: fact}", "did you mean `facts`?"),
        (
            "{predicates: {IsClos: {dropout: .1}}}",
            "the configuration has no predicate `IsClos`",
        ),
        ("{predicates: {Sees: {dropout: .1}}}", "no sensor reads `Sees`"),
        ("{predicates: {Waited: {dropout: .1}}}", "`Waited` has values"),
        ("{dropout_rate: .1}", "unknown key `dropout_rate`"),
    ] {
        let said = fault(sensors);
        assert!(said.contains(message), "{sensors}: {said}");
    }
}

/// The observation of the ego, and the entities that each of its numbers is about.
fn observation(env: &Env) -> (Vec<f32>, Vec<Vec<usize>>) {
    let task = env.task();
    let mut numbers = vec![f32::NAN; task.observation_width()];
    env.observe(0, &mut numbers);
    let most = task.config().entities as usize;
    let about = observed_columns(task.world(), most).into_iter().flat_map(|column| {
        (0..column.width).map(move |place| match column.arity {
            1 => vec![place],
            _ => vec![place / most, place % most],
        })
    });
    let about = about.collect();
    (numbers, about)
}

/// What others tell is what the definition says: true facts without a reading that a sender knows, the first ones in
/// the order that the configuration wants, about as many agents as it allows.
#[test]
fn told_facts_are_those_of_the_definition() {
    let plain = sensed("{range: 9}");
    let mut decider = Decider::new(Arc::clone(plain.oracle())).unwrap();
    let mut decide = |numbers: &[f32]| decider.action(numbers, &Cancel::never()).unwrap();
    let (mut told_facts, mut relevant_sets, mut bounded, mut unknown, mut farther) = (0, 0, 0, 0, 0);
    for (by, from, radius, entities) in [
        ("distance", "assistant", None, None),
        ("distance", "assistant", None, Some(1)),
        ("relevance", "assistant", None, None),
        ("relevance", "assistant", None, Some(2)),
        ("relevance", "cars", None, None),
        ("distance", "cars", Some(12), None),
        ("random", "assistant", None, None),
    ] {
        for facts in [0, 1, 3, 8] {
            let more = radius.map_or(String::new(), |radius| format!(", radius: {radius}"))
                + &entities.map_or(String::new(), |most| format!(", entities: {most}"));
            let shared = sensed(&format!(
                "{{range: 9, share: {{facts: {facts}, by: {by}, from: {from}{more}}}}}"
            ));
            let [mut sharing, mut alone, mut exact] = [
                env(&shared, Split::Test),
                env(&plain, Split::Test),
                env(&task("expert", None), Split::Test),
            ];
            for seed in 0..4 {
                for env in [&mut sharing, &mut alone, &mut exact] {
                    env.reset(seed).unwrap();
                }
                while exact.controlled_cars()[0].is_running() {
                    let (agents, entity) = (exact.city().agents(), |entity: usize| {
                        exact.controlled_cars()[0].observer().entities().nth(entity).unwrap()
                    });
                    let cells = |from: usize, to: usize| {
                        let [from, to] = [from, to].map(|agent| agents[agent].cell);
                        f64::from(to.row - from.row).hypot(f64::from(to.col - from.col))
                    };
                    let ego = entity(0);
                    let [(with, about), (without, _), (truth, _)] = [&sharing, &alone, &exact].map(observation);
                    let sends = |car: usize| {
                        car != ego
                            && agents[car].kind_id == AgentKind::Car.into()
                            && radius.is_none_or(|radius| cells(ego, car) <= f64::from(radius))
                    };
                    let knows = |at: usize| {
                        from == "assistant"
                            || (0..agents.len())
                                .filter(|car| sends(*car))
                                .any(|car| about[at].iter().all(|&each| cells(car, entity(each)) <= 9.0))
                    };
                    let missed: Vec<usize> = (0..truth.len())
                        .filter(|&at| truth[at] == 1.0 && without[at] == 0.0)
                        .collect();
                    let mut order: Vec<usize> = missed.iter().copied().filter(|at| knows(*at)).collect();
                    unknown += missed.len() - order.len();
                    let far = |at: &usize| {
                        about[*at]
                            .iter()
                            .map(|&each| cells(ego, entity(each)))
                            .fold(0.0, f64::max)
                    };
                    order.sort_by(|a, b| far(a).total_cmp(&far(b)).then(a.cmp(b)));
                    let told: Vec<usize> = (0..truth.len()).filter(|&at| with[at] != without[at]).collect();
                    assert!(
                        told.iter().all(|at| order.contains(at) && with[*at] == 1.0),
                        "{by} {from}"
                    );
                    let given = |facts: &[usize]| {
                        let mut numbers = without.clone();
                        facts.iter().for_each(|at| numbers[*at] = 1.0);
                        numbers
                    };
                    if by == "relevance" {
                        // Leaves out whatever the decision does not need, the farthest facts first.
                        let all = decide(&given(&order));
                        let mut needed = order.clone();
                        if decide(&without) == all {
                            needed.clear();
                        }
                        for at in order.iter().rev() {
                            let fewer: Vec<usize> = needed.iter().copied().filter(|each| each != at).collect();
                            if fewer.len() < needed.len() && decide(&given(&fewer)) == all {
                                needed = fewer;
                            }
                        }
                        relevant_sets += usize::from(!needed.is_empty());
                        let rest: Vec<usize> = order.iter().copied().filter(|at| !needed.contains(at)).collect();
                        order = needed;
                        order.extend(rest);
                    }
                    let (mut expected, mut of): (Vec<usize>, BTreeSet<usize>) = (Vec::new(), BTreeSet::new());
                    for at in order.iter().take_while(|_| by != "random") {
                        let mut more = of.clone();
                        more.extend(about[*at].iter().filter(|each| **each > 0));
                        if expected.len() < facts && entities.is_none_or(|most| more.len() <= most) {
                            expected.push(*at);
                            of = more;
                        } else {
                            bounded += 1;
                        }
                    }
                    expected.sort_unstable();
                    match by {
                        "random" => {
                            assert_eq!(told.len(), facts.min(order.len()));
                            let mut nearest = order[..told.len()].to_vec();
                            nearest.sort_unstable();
                            farther += usize::from(told != nearest);
                        }
                        _ => assert_eq!(told, expected, "{by} {from} {facts} {seed}"),
                    }
                    told_facts += told.len();
                    let action = exact.oracle_action(0);
                    for env in [&mut sharing, &mut alone, &mut exact] {
                        env.step(&[action]).unwrap();
                    }
                }
            }
        }
    }
    assert!(
        told_facts > 1000 && relevant_sets > 20 && bounded > 100 && unknown > 100 && farther > 50,
        "{told_facts} {relevant_sets} {bounded} {unknown} {farther}"
    );
}

/// Told facts are certain, and beliefs remember them.
#[test]
fn told_facts_are_certain() {
    for output in ["probabilities", "belief"] {
        let sensor = format!("output: {output}, range: 9, false_positive_rate: .1, correlation: .4");
        let [alone, shared] = ["", ", share: {facts: 50}"].map(|share| sensed(&format!("{{{sensor}{share}}}")));
        let [mut alone, mut shared] = [alone, shared].map(|task| env(&task, Split::Test));
        let (mut certain, mut remembered) = (0, 0);
        for seed in 0..3 {
            alone.reset(seed).unwrap();
            shared.reset(seed).unwrap();
            while shared.controlled_cars()[0].is_running() {
                let [without, with] = [&alone, &shared].map(numbers);
                let truth = truths(shared.controlled_cars()[0].observer());
                for (fact, number) in &with {
                    if *number == 1.0 && without[fact] < 1.0 {
                        assert!(truth.contains(fact));
                        certain += 1;
                    }
                    remembered += usize::from(*number < 1.0 && *number != without[fact]);
                }
                let action = shared.oracle_action(0);
                alone.step(&[action]).unwrap();
                shared.step(&[action]).unwrap();
            }
        }
        assert!(certain > 300, "{certain}");
        assert_eq!(remembered > 0, output == "belief", "{remembered}");
    }
}

/// A clause that applies is observed fully, partly or not at all; without sensors, and with exact ones, fully.
#[test]
fn observed_clauses_are_counted() {
    let exact = task("expert", None);
    let cases = [
        (exact, [true, false, false]),
        (sensed("{range: 1000}"), [true, false, false]),
        (sensed("{range: 9}"), [true, true, false]),
        // Not even what the ego knows of itself is read.
        (sensed("{true_positive_rate: 0}"), [false, false, true]),
        (sensed("{true_positive_rate: 0, ego: exact}"), [true, true, true]),
        // If the other agents tell every true fact, the ego observes all that its rules need.
        (sensed("{range: 2, share: {facts: 1000}}"), [true, false, false]),
    ];
    for (task, some) in cases {
        let mut decider = Decider::new(Arc::clone(task.oracle())).unwrap();
        let mut applies = |numbers: &[f32], clause: usize| {
            let mut violates = |action| {
                decider
                    .violations(numbers, action, &Cancel::never())
                    .unwrap()
                    .contains(&clause)
            };
            Action::STANDARD.into_iter().any(&mut violates)
        };
        let mut env = env(&task, Split::Test);
        let mut sums = [0; 3];
        for seed in 0..6 {
            env.reset(seed).unwrap();
            while env.controlled_cars()[0].is_running() {
                let counts = env.observed_clauses(0).unwrap();
                let mut fresh = Observer::new(Arc::clone(task.oracle()), env.controlled_cars()[0].agent());
                fresh.begin(env.city());
                fresh.look(env.city()).unwrap();
                let mut applying = BTreeSet::new();
                for action in Action::STANDARD {
                    applying.extend(fresh.violations(env.city(), action).unwrap().iter().copied());
                }
                assert_eq!(counts.iter().sum::<u32>() as usize, applying.len());
                // The obvious computation, on observations.
                let (seen, _) = observation(&env);
                let mut truth = vec![0.0; seen.len()];
                fresh.write(&mut truth);
                let mut expected = [0; 3];
                for clause in applying {
                    if applies(&seen, clause) {
                        expected[0] += 1;
                        continue;
                    }
                    let (observed, unobserved): (Vec<usize>, Vec<usize>) = (0..truth.len())
                        .filter(|&at| truth[at] == 1.0)
                        .partition(|&at| seen[at] == 1.0);
                    let mut needed = truth.clone();
                    for &at in unobserved.iter().chain(&observed) {
                        needed[at] = 0.0;
                        if !applies(&needed, clause) {
                            needed[at] = 1.0;
                        }
                    }
                    expected[if observed.iter().any(|&at| needed[at] == 1.0) {
                        1
                    } else {
                        2
                    }] += 1;
                }
                assert_eq!(counts, expected);
                sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
                env.step(&[env.oracle_action(0)]).unwrap();
            }
        }
        assert_eq!(sums.map(|sum| sum > 0), some, "{sums:?}");
    }
}

#[test]
fn faulty_shares_are_reported_at_their_place() {
    for (share, message) in [
        ("{}", "`facts`"),
        ("{facts: -1}", "expected a whole number from 0 to 10000, found `-1`"),
        ("{facts: 2, by: distanse}", "`distanse`"),
        ("{facts: 2, from: egos}", "`egos`"),
        ("{facts: 2, radius: 5}", "the assistant has no radius"),
        (
            "{facts: 2, from: cars, radius: 0}",
            "expected a whole number from 1 to 1000000, found `0`",
        ),
        ("{facts: 2, entites: 3}", "`entites`"),
    ] {
        let config = format!("base: expert\ntask: {{sensors: {{share: {share}}}}}\n");
        let faults = task_of(&config).err().unwrap();
        assert!(
            faults[0].message.contains(message) && faults[0].primary.is_some(),
            "{share}: {:?}",
            faults[0]
        );
    }
}
