//! Views, atoms and decisions equal the recorded ones: each ego of each tick becomes a scene.

use super::{Recording, recordings, solved};
use crate::shipped_world::world;
use logicity::city::Action;
use logicity::config::Scenario;
use logicity::diag::{Sources, render};
use logicity::files::read_text;
use logicity::predicate::{Definition, Pair};
use logicity::rng::Seed;
use logicity::sim::{EgoAnswer, Executor, Inference};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// True atoms by predicate, without predicates that have none.
type Atoms = BTreeMap<String, BTreeSet<Vec<String>>>;

/// The record of one ego in one tick.
struct Recorded {
    place: String,
    /// A scene for this ego alone, since each ego drew `CollidingClose` separately.
    scene: Value,
    sees: Vec<String>,
    atoms: Atoms,
    /// `None` if the solver found no model.
    actions: Option<BTreeSet<Action>>,
}

/// A configuration with the predicates of a recording: all predicates of the paper if its rules are not known.
fn config(recording: &Recording) -> &'static str {
    recording.mode().unwrap_or("expert")
}

#[test]
fn slow_egos_see_and_decide_as_recorded() {
    for recording in recordings("trace") {
        let mut expected: Vec<Recorded> = recording.lines().flat_map(|tick| egos_of_tick(&tick)).collect();
        let predicates: BTreeSet<String> = recording.lines().flat_map(|tick| predicates_of_tick(&tick)).collect();
        if recording.mode().is_none() {
            drop_unknown_predicates(&recording, &predicates, &mut expected);
        }
        assert!(!expected.is_empty(), "{} is empty", recording.path.display());
        let scenes: Vec<&Value> = expected.iter().map(|recorded| &recorded.scene).collect();
        let answers = answers(config(&recording), |_| (), &scenes);

        let (mut differences, mut decisions, mut unsolved) = (Vec::new(), 0, 0);
        for (answer, recorded) in answers.iter().zip(&expected) {
            let [ego] = answer.as_slice() else {
                panic!("{}: expected one ego", recorded.place)
            };
            let mut atoms = atoms_of(ego);
            // The record has exactly the predicates of the configuration.
            if recording.mode().is_none() {
                atoms.retain(|name, _| predicates.contains(name));
            }
            let mut agrees = ego.sees == recorded.sees && atoms == recorded.atoms;
            match &recorded.actions {
                _ if recording.mode().is_none() => {}
                Some(actions) => {
                    decisions += 1;
                    agrees &= decides(ego, actions);
                }
                None => unsolved += 1,
            }
            if !agrees {
                differences.push(format!(
                    "{}: {ego:?}\nrecorded {:?} {:?} {:?}",
                    recorded.place, recorded.sees, recorded.atoms, recorded.actions
                ));
            }
        }
        recording.report(&format!(
            "{} views with their atoms and {decisions} decisions compared, {} differences",
            expected.len(),
            differences.len()
        ));
        if unsolved > 0 {
            recording.report(&format!("{unsolved} decisions not compared: the solver found no model"));
        }
        if recording.mode().is_none() {
            recording.report(&format!(
                "{} decisions not compared: `{}` is no shipped mode, so its rules are unknown",
                expected.len(),
                recording.tag
            ));
        }
        assert!(
            differences.is_empty(),
            "{}: {} of {} egos differ; the first:\n{}",
            recording.path.display(),
            differences.len(),
            expected.len(),
            differences[0]
        );
    }
}

/// Whether the rules derive the actions that the solver found. Normal is the default if no other action is derived; the
/// solver's model may contain it or not.
fn decides(ego: &EgoAnswer, solved: &BTreeSet<Action>) -> bool {
    let but_normal = |action: &Action| *action != Action::Normal;
    let derived: BTreeSet<Action> = ego.derived.iter().filter(but_normal).collect();
    let wanted: BTreeSet<Action> = solved.iter().copied().filter(but_normal).collect();
    derived == wanted && solved.contains(&ego.action)
}

/// With every chance set to one, `CollidingClose` holds wherever it was recorded. Where it holds but was not recorded,
/// a chance decides: for a pedestrian, or for two agents in one cell.
#[test]
fn slow_collisions_follow_from_positions() {
    let mut certain = 0;
    for recording in recordings("trace") {
        let expected: Vec<Recorded> = recording.lines().flat_map(|tick| egos_of_tick(&tick)).collect();
        // All egos of a tick share the scene.
        let mut scenes: Vec<Value> = Vec::new();
        let mut of_ego = Vec::new();
        for recorded in &expected {
            let scene = json!({"map": recorded.scene["map"], "agents": recorded.scene["agents"]});
            if scenes.last() != Some(&scene) {
                scenes.push(scene);
            }
            of_ego.push(scenes.len() - 1);
        }
        let answers = answers(config(&recording), always, &scenes.iter().collect::<Vec<_>>());
        let mut here = 0;
        for (recorded, tick) in expected.iter().zip(of_ego) {
            let agents = scenes[tick]["agents"].as_array().unwrap();
            let agent = |name: &str| agents.iter().find(|agent| agent["id"] == name).unwrap();
            let name = &recorded.sees[0];
            let ego = answers[tick].iter().find(|ego| ego.id == *name).unwrap();
            let [computed, drawn] =
                [&atoms_of(ego), &recorded.atoms].map(|atoms| atoms.get("CollidingClose").cloned().unwrap_or_default());
            assert!(drawn.is_subset(&computed), "{}", recorded.place);
            for missed in computed.difference(&drawn) {
                let (x, y) = (agent(&missed[0]), agent(&missed[1]));
                assert!(
                    x["type"] == "Pedestrian" || x["at"] == y["at"],
                    "{} {missed:?}",
                    recorded.place
                );
            }
            here += drawn.len();
        }
        recording.report(&format!("{here} atoms of CollidingClose follow from the positions"));
        certain += here;
    }
    assert!(certain > 1000, "{certain} in all files");
}

/// Sets every chance to one.
fn always(scenario: &mut Scenario) {
    let mut found = false;
    for predicate in &mut scenario.predicates {
        if let Definition::Pair(Pair::Colliding(colliding)) = &mut predicate.definition {
            (colliding.pedestrian_chance, colliding.same_cell_chance) = (1.0, 1.0);
            found = true;
        }
    }
    assert!(found);
}

/// One record for each agent of a tick.
fn egos_of_tick(tick: &Value) -> Vec<Recorded> {
    let list = tick["agents"].as_array().unwrap();
    let names: HashMap<i64, &str> = list
        .iter()
        .map(|agent| (agent["id"].as_i64().unwrap(), agent["name"].as_str().unwrap()))
        .collect();
    let agents: Vec<Value> = list
        .iter()
        .map(|agent| {
            let concepts: Vec<&String> = agent["concepts"].as_object().unwrap().keys().collect();
            json!({
                "id": agent["name"],
                "type": agent["type"],
                "at": agent["pos"],
                "heading": agent["dir"],
                "concepts": concepts,
                "priority": agent["pri"],
            })
        })
        .collect();
    let name = |id: &Value| names[&id.as_i64().unwrap()].to_owned();
    let recorded = |(id, ego): (&String, &Value)| {
        let id = names[&id.parse().unwrap()];
        let atoms: Atoms = ego["true"]
            .as_object()
            .unwrap()
            .iter()
            .filter(|(_, rows)| !rows.as_array().unwrap().is_empty())
            .map(|(predicate, rows)| {
                let rows = rows.as_array().unwrap().iter();
                let rows = rows.map(|row| match row.as_array() {
                    Some(pair) => pair.iter().map(name).collect(),
                    None => vec![name(row)],
                });
                (predicate.clone(), rows.collect())
            })
            .collect();
        let colliding: Vec<&Vec<String>> = atoms.get("CollidingClose").into_iter().flatten().collect();
        Recorded {
            place: format!("{} seed {} tick {} {id}", tick["mode"], tick["seed"], tick["tick"]),
            scene: json!({
                "map": "square-5x5",
                "agents": agents,
                "egos": [id],
                "given": { "CollidingClose": colliding },
            }),
            sees: ego["ents"].as_array().unwrap().iter().map(name).collect(),
            atoms,
            actions: (ego["sat"] == "sat").then(|| solved(ego)),
        }
    };
    tick["ego"].as_object().unwrap().iter().map(recorded).collect()
}

/// Removes recorded predicates that no shipped configuration has, and prints them.
fn drop_unknown_predicates(recording: &Recording, predicates: &BTreeSet<String>, expected: &mut [Recorded]) {
    let world = world(config(recording), None, |_| ());
    let known = |name: &String| (world.vocabulary.predicates.iter()).any(|predicate| predicate.name == *name);
    let unknown: Vec<&String> = predicates.iter().filter(|name| !known(name)).collect();
    if !unknown.is_empty() {
        recording.report(&format!("atoms of {unknown:?} not compared: unknown predicates"));
    }
    for recorded in expected {
        recorded.atoms.retain(|name, _| known(name));
    }
}

/// The recorded predicates of a tick.
fn predicates_of_tick(tick: &Value) -> BTreeSet<String> {
    let egos = tick["ego"].as_object().unwrap().values();
    egos.flat_map(|ego| ego["true"].as_object().unwrap().keys().cloned())
        .collect()
}

fn atoms_of(ego: &EgoAnswer) -> Atoms {
    let rows = ego.atoms.iter().filter(|(_, rows)| !rows.is_empty());
    rows.map(|(name, rows)| (name.clone(), rows.iter().cloned().collect()))
        .collect()
}

/// Answers scenes with both executors, which must agree. The facts of the scenes satisfy the constraints of the rules.
fn answers(config: &str, edit: fn(&mut Scenario), scenes: &[&Value]) -> Vec<Vec<EgoAnswer>> {
    std::thread::scope(|scope| {
        let by = |executor| scope.spawn(move || answers_by(executor, config, edit, scenes));
        let [dense, relational] = [Executor::Dense, Executor::Relational]
            .map(by)
            .map(|thread| thread.join().unwrap());
        for (dense, relational) in dense.iter().zip(&relational) {
            assert_eq!(format!("{dense:?}"), format!("{relational:?}"));
        }
        dense
    })
}

fn answers_by(executor: Executor, config: &str, edit: fn(&mut Scenario), scenes: &[&Value]) -> Vec<Vec<EgoAnswer>> {
    let world = world(config, None, edit);
    let (scenario, program) = (world.scenario.clone(), world.program.clone());
    let mut inference = Inference::new(scenario, program, Seed(0), executor, read_text).expect("rules fit");
    if executor == Executor::Relational {
        inference.check_constraints();
    }
    let answer = |scene: &&Value| {
        let mut sources = Sources::new();
        let source = sources.add("scene", scene.to_string());
        match inference.answer(&sources, source) {
            Ok(answer) => answer.egos().collect(),
            Err(faults) => panic!("{}", render(&faults, &sources, false)),
        }
    };
    scenes.iter().map(answer).collect()
}
