//! Decisions are those of the published program: every ego of every tick of the recorded traces goes through `logicity infer`.

mod recorded_cases;

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

fn check(mode: &str) {
    let Some(folder) = recorded_cases::folder() else { return };
    let trace = GzDecoder::new(File::open(folder.join(format!("trace_{mode}.jsonl.gz"))).unwrap());
    let mut scenes = Vec::new();
    let mut expected = Vec::new();
    for line in BufReader::new(trace).lines() {
        let tick: Value = serde_json::from_str(&line.unwrap()).unwrap();
        scenes_of_tick(&tick, &mut scenes, &mut expected);
    }
    let answers = infer(mode, scenes);
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
fn scenes_of_tick(tick: &Value, scenes: &mut Vec<String>, expected: &mut Vec<Recorded>) {
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
        scenes.push(
            json!({
                "map": "square-5x5",
                "agents": agents,
                "egos": [names[&id]],
                "given": { "CollidingClose": colliding },
            })
            .to_string(),
        );
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

fn infer(mode: &str, scenes: Vec<String>) -> Vec<Map<String, Value>> {
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"))
        .args(["infer", "--config"])
        .arg(format!("configs/{mode}.yaml"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = process.stdin.take().unwrap();
    let writer = std::thread::spawn(move || {
        for scene in scenes {
            writeln!(input, "{scene}").unwrap();
        }
    });
    let answers = BufReader::new(process.stdout.take().unwrap())
        .lines()
        .map(|line| serde_json::from_str(&line.unwrap()).unwrap())
        .collect();
    writer.join().unwrap();
    assert!(process.wait().unwrap().success());
    answers
}
