//! Decisions are those of the published program: every ego of every tick of the recorded traces goes through `logicity infer`.

use flate2::read::GzDecoder;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};

/// What was recorded of one ego in one tick.
struct Recorded {
    place: String,
    ego: String,
    sees: Vec<String>,
    atoms: BTreeMap<String, BTreeSet<Vec<String>>>,
    action: &'static str,
}

#[test]
fn easy() {
    check("easy");
}

#[test]
fn hard() {
    check("hard");
}

/// `CollidingClose` as we compute it, with every chance set to one, holds wherever it was recorded; where it was not, a chance was
/// at play: a pedestrian, or two agents in one cell.
#[test]
fn collisions() {
    for mode in ["easy", "hard"] {
        let Some((mut scenes, expected)) = read(mode) else {
            return;
        };
        for scene in &mut scenes {
            // The same scene for all egos of a tick.
            scene
                .as_object_mut()
                .unwrap()
                .retain(|key, _| key == "map" || key == "agents");
        }
        scenes.dedup();
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("certain.yaml");
        let chances = "{pedestrian_chance: 1, same_cell_chance: 1}";
        let text = format!(
            "base: configs/{mode}.yaml\npredicates: {{define: {{CollidingClose: {{colliding: {chances}}}}}}}\n"
        );
        std::fs::write(&config, text).unwrap();
        let answers = infer(config.to_str().unwrap(), &scenes);
        let mut certain = 0;
        let mut ticks = scenes.iter().zip(&answers).peekable();
        let mut place = expected[0].place.clone();
        for recorded in &expected {
            if recorded.place != place {
                ticks.next();
                place.clone_from(&recorded.place);
            }
            let (scene, answer) = ticks.peek().unwrap();
            let agent = |name: &str| {
                let agents = scene["agents"].as_array().unwrap();
                agents.iter().find(|agent| agent["id"] == name).unwrap()
            };
            let rows = answer["egos"][&recorded.ego]["true"].get("CollidingClose");
            let computed: BTreeSet<Vec<String>> = rows
                .map(|rows| rows.as_array().unwrap().iter().map(row).collect())
                .unwrap_or_default();
            let empty = BTreeSet::new();
            let recorded_rows = recorded.atoms.get("CollidingClose").unwrap_or(&empty);
            let context = || format!("{mode} {} {}", recorded.place, recorded.ego);
            assert!(recorded_rows.is_subset(&computed), "{}", context());
            for missed in computed.difference(recorded_rows) {
                let (x, y) = (agent(&missed[0]), agent(&missed[1]));
                assert!(
                    x["type"] == "Pedestrian" || x["at"] == y["at"],
                    "{} {missed:?}",
                    context()
                );
            }
            certain += recorded_rows.len();
        }
        assert!(certain > 1000);
    }
}

/// The scenes of a recorded trace, one for each ego, and what was recorded. `None` if there are no recorded cases.
fn read(mode: &str) -> Option<(Vec<Value>, Vec<Recorded>)> {
    let trace = GzDecoder::new(File::open(crate::recorded::folder()?.join(format!("trace_{mode}.jsonl.gz"))).unwrap());
    let mut scenes = Vec::new();
    let mut expected = Vec::new();
    for line in BufReader::new(trace).lines() {
        let tick: Value = serde_json::from_str(&line.unwrap()).unwrap();
        scenes_of_tick(&tick, &mut scenes, &mut expected);
    }
    Some((scenes, expected))
}

fn check(mode: &str) {
    let Some((scenes, expected)) = read(mode) else { return };
    let answers = infer(&format!("configs/{mode}.yaml"), &scenes);
    assert_eq!(answers.len(), expected.len());

    let mut differences = Vec::new();
    for (answer, recorded) in answers.iter().zip(&expected) {
        let ego = &answer["egos"][&recorded.ego];
        let sees: Vec<String> = serde_json::from_value(ego["sees"].clone()).unwrap();
        let atoms: BTreeMap<String, BTreeSet<Vec<String>>> = ego["true"]
            .as_object()
            .unwrap()
            .iter()
            .map(|(name, rows)| (name.clone(), rows.as_array().unwrap().iter().map(row).collect()))
            .collect();
        if sees != recorded.sees || atoms != recorded.atoms || ego["action"] != recorded.action {
            differences.push(format!(
                "{} {}: {ego}\nrecorded {:?} {:?} {}",
                recorded.place, recorded.ego, recorded.sees, recorded.atoms, recorded.action
            ));
        }
    }
    println!("{mode}: {} egos, {} differences", expected.len(), differences.len());
    assert!(
        differences.is_empty(),
        "{} of {} egos differ; the first:\n{}",
        differences.len(),
        expected.len(),
        differences[0]
    );
}

/// A scene for each ego, since each ego drew its own `CollidingClose`.
fn scenes_of_tick(tick: &Value, scenes: &mut Vec<Value>, expected: &mut Vec<Recorded>) {
    let list = tick["agents"].as_array().unwrap();
    let names: HashMap<i64, String> = list
        .iter()
        .map(|agent| {
            (
                agent["id"].as_i64().unwrap(),
                agent["name"].as_str().unwrap().to_owned(),
            )
        })
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
    let name = |id: &Value| names[&id.as_i64().unwrap()].clone();
    for (id, ego) in tick["ego"].as_object().unwrap() {
        let id: i64 = id.parse().unwrap();
        let atoms: BTreeMap<String, BTreeSet<Vec<String>>> = ego["true"]
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
        scenes.push(json!({
            "map": "square-5x5",
            "agents": agents,
            "egos": [names[&id]],
            "given": { "CollidingClose": colliding },
        }));
        let stop = ego["z3"].as_array().unwrap().iter().any(|action| action == "Stop");
        expected.push(Recorded {
            place: format!("seed {} tick {}", tick["seed"], tick["tick"]),
            ego: names[&id].clone(),
            sees: ego["ents"].as_array().unwrap().iter().map(name).collect(),
            atoms,
            action: if stop { "Stop" } else { "Normal" },
        });
    }
}

fn row(row: &Value) -> Vec<String> {
    match row {
        Value::String(name) => vec![name.clone()],
        names => serde_json::from_value(names.clone()).unwrap(),
    }
}

/// The answers, which both executors give.
fn infer(config: &str, scenes: &[Value]) -> Vec<Map<String, Value>> {
    let [dense, relational] = ["dense", "relational"].map(|executor| infer_by(executor, config, scenes));
    assert_eq!(dense, relational);
    dense
}

fn infer_by(executor: &str, config: &str, scenes: &[Value]) -> Vec<Map<String, Value>> {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(["infer", "--config", config, "--executor", executor])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = process.stdin.take().unwrap();
    let lines: String = scenes.iter().map(|scene| format!("{scene}\n")).collect();
    let writer = std::thread::spawn(move || input.write_all(lines.as_bytes()).unwrap());
    let answers = BufReader::new(process.stdout.take().unwrap())
        .lines()
        .map(|line| serde_json::from_str(&line.unwrap()).unwrap())
        .collect();
    writer.join().unwrap();
    assert!(process.wait().unwrap().success());
    answers
}
