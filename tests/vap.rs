//! Visual Action Prediction: worlds, tables, and data sets that are ended early, made in parts, or tampered with.

use logicity::config::{AgentKind, Split, load_scenario};
use logicity::diag::Sources;
use logicity::engine::Program;
use logicity::render::{Difficulty, Icons};
use logicity::rng::Seed;
use logicity::task::vap::table::{Sample, Table, Values, samples};
use logicity::task::vap::{Agents, FIRST_TICK, Frame, TICKS, Worlds, count_actions};
use logicity::{files, lang};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

fn worlds(agents: Agents, split: Split) -> Worlds {
    // Icons take long to draw; all worlds share them.
    static ICONS: OnceLock<Arc<Icons>> = OnceLock::new();
    let icons = ICONS.get_or_init(|| Arc::new(Icons::new(Seed(0), Difficulty::CLEAN)));
    let mut sources = Sources::new();
    let scenario = load_scenario(&mut sources, Path::new("vap-hard"), &files::read_or_builtin).unwrap();
    let rules = &scenario.rules.value;
    let entry = sources.add(rules.display().to_string(), files::read_or_builtin(rules).unwrap());
    let program = Program::new(lang::load(&mut sources, entry, &files::read_or_builtin).rules.unwrap()).unwrap();
    Worlds::new(scenario, program, Arc::clone(icons), agents, split, 0).unwrap()
}

fn vap(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
    command
        .arg("vap")
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command.output().unwrap()
}

/// What a command that succeeds prints.
fn told(arguments: &[&str]) -> String {
    let output = vap(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn refused(arguments: &[&str], words: &[&str]) {
    let output = vap(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in:\n{said}");
    }
}

/// Tables only.
const MAKE: [&str; 6] = ["make", "--mode", "hard", "--split", "test", "--no-pictures"];

fn make(folder: &Path, more: &[&str]) -> String {
    told(&[&MAKE[..], &["--out", folder.to_str().unwrap()], more].concat())
}

/// All files below a folder by name.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(inside).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => {
                    let name = path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned();
                    found.insert(name, fs::read(&path).unwrap());
                }
            }
        }
    }
    found
}

#[test]
fn tables_say_what_frames_hold() {
    let worlds = worlds(Agents::Fixed, Split::Test);
    let vocabulary = &worlds.world().vocabulary;
    let frames = worlds.frames(3).unwrap();
    assert_eq!(
        frames.iter().map(|frame| frame.tick).collect::<Vec<_>>(),
        (FIRST_TICK..TICKS).collect::<Vec<_>>()
    );
    let tables = [Table::entities(&worlds, 3, &frames), Table::pairs(&worlds, 3, &frames)];
    assert_eq!(tables.each_ref().map(Table::rows), [89 * 14, 89 * 14 * 14]);
    let [entities, pairs] = tables.map(|table| {
        let mut bytes = [Vec::new(), Vec::new()];
        bytes.iter_mut().for_each(|bytes| table.write(bytes).unwrap());
        let [first, second] = bytes;
        assert_eq!(first, second);
        let read = Table::read(first).unwrap();
        assert_eq!(read, table);
        read
    });
    let read = samples(vocabulary, 3, &entities, &pairs).unwrap();
    let of = |frame: &Frame| Sample {
        tick: i32::try_from(frame.tick).unwrap(),
        names: frame.agents.iter().map(|agent| agent.name.to_string()).collect(),
        labels: (frame.agents.iter())
            .map(|agent| (agent.name.kind == AgentKind::Car).then_some(agent.action))
            .collect(),
        facts: frame.facts.clone(),
    };
    assert_eq!(read, frames.iter().map(of).collect::<Vec<_>>());
    assert!(samples(vocabulary, 4, &entities, &pairs).is_err());

    // Any bytes are read or refused.
    let mut bytes = Vec::new();
    entities.write(&mut bytes).unwrap();
    for number in 0..1000_usize {
        let mut damaged = bytes.clone();
        // Mostly in the description of the columns, which is at the end.
        let back = number.wrapping_mul(2_654_435_761) % if number % 3 == 0 { bytes.len() } else { 3000 };
        let at = bytes.len() - 1 - back;
        damaged[at] = damaged[at].wrapping_add(1 + (number / 7 % 255) as u8);
        if let Ok(read) = Table::read(damaged) {
            let _ = samples(vocabulary, 3, &read, &pairs);
        }
    }

    // Boxes surround the middle of the agent's cell, as far as it is in the picture.
    let mut inside = 0;
    let boxes = frames
        .iter()
        .flat_map(|frame| frame.agents.iter().zip(worlds.boxes(frame)));
    for (agent, pixels) in boxes {
        let middle = [agent.at.col * 8 + 4, agent.at.row * 8 + 4];
        match pixels {
            None => assert!(middle.iter().any(|at| *at > 1024 - 48)),
            Some(pixels) => {
                let ends = [
                    pixels.x + pixels.width.cast_signed(),
                    pixels.y + pixels.height.cast_signed(),
                ];
                assert!(pixels.x >= 0 && pixels.y >= 0 && ends.iter().all(|end| *end <= 1024));
                inside +=
                    usize::from((pixels.x..ends[0]).contains(&middle[0]) && (pixels.y..ends[1]).contains(&middle[1]));
            }
        }
    }
    assert!(inside > 89 * 14 * 9 / 10, "{inside}");
    let Values::MaybeInt(headings) = &entities.columns[9].1 else {
        panic!("{:?}", entities.columns[9].0)
    };
    assert!((0..4).all(|heading| headings.contains(&Some(heading))));
}

#[test]
fn drawn_agents_are_as_the_paper_says() {
    for split in Split::ALL {
        let worlds = worlds(Agents::Random, split);
        let mut seen = BTreeSet::new();
        for number in 0..20 {
            let frames = worlds.frames(number).unwrap();
            let agents = &frames[0].agents;
            let carry = |concept: &str| {
                agents
                    .iter()
                    .filter(|agent| agent.concepts.iter().any(|one| one == concept))
                    .count()
            };
            let walking = agents
                .iter()
                .filter(|agent| agent.name.kind == AgentKind::Pedestrian)
                .count();
            let (fits, walks) = match split {
                Split::Train => (agents.len() == 12, 3..=5),
                Split::Val => ((13..=15).contains(&agents.len()), 3..=5),
                Split::Test => ((13..=15).contains(&agents.len()), 5..=7),
            };
            assert!(fits && walks.contains(&walking) && carry("old") >= 1 && carry("young") >= 2);
            let cars = agents.iter().filter(|agent| agent.name.kind == AgentKind::Car);
            let mut priorities: Vec<i32> = cars.map(|agent| agent.priority).collect();
            seen.insert(priorities.clone());
            priorities.sort_unstable();
            assert!(
                priorities
                    .into_iter()
                    .eq(1..=i32::try_from(agents.len() - walking).unwrap())
            );
        }
        assert!(seen.len() > 15, "priorities are drawn");
    }
}

#[test]
fn what_was_ended_early_goes_on_and_parts_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed, part] = ["whole", "killed", "part"].map(|name| folder.path().join(name));
    let said = make(&whole, &["--worlds", "3"]);
    assert!(said.starts_with("worlds made: 3, in "), "{said}");
    let expected = contents(&whole);
    assert_eq!(expected.len(), 3 * 3 + 2);

    // Killed as soon as a world is there.
    let arguments = [&MAKE[..], &["--worlds", "3", "--out", killed.to_str().unwrap()]].concat();
    let mut process = Command::new(env!("CARGO_BIN_EXE_logicity"));
    let process = process
        .arg("vap")
        .args(&arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    let mut process = process.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !killed.join("world-00000").exists() {
        assert!(process.try_wait().unwrap().is_none(), "it ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(!killed.join("manifest.json").exists() || killed.join("world-00002").exists());
    // And at the worst moment: something of a world was written.
    fs::create_dir_all(killed.join(".world-00002.partial")).unwrap();
    fs::write(killed.join(".world-00002.partial/entities.parquet"), "PAR1").unwrap();
    let said = make(&killed, &["--worlds", "3"]);
    assert!(!said.starts_with("worlds made: 3"), "what was there stays: {said}");
    assert_eq!(contents(&killed), expected);
    assert!(make(&killed, &["--worlds", "3"]).starts_with("worlds made: 0, in "));
    assert_eq!(contents(&killed), expected);

    make(&part, &["--worlds", "1", "--first-world", "2"]);
    let parts = contents(&part);
    assert_eq!(parts.len(), 3 + 2);
    for name in parts.keys().filter(|name| name.starts_with("world-00002")) {
        assert_eq!(parts[name], expected[name], "{name}");
    }
    let seed = "--seed";
    refused(
        &[&MAKE[..], &["--out", part.to_str().unwrap(), seed, "1"]].concat(),
        &["invalid-data-set", "other settings"],
    );

    tampered_sets_are_found_out(&whole);
}

/// Changes a file of world 1, with the counts and hashes that stand for it or without them.
fn tampered_sets_are_found_out(folder: &Path) {
    let path = folder.to_str().unwrap();
    let check = || told(&["check", path]);
    assert!(check().starts_with("worlds: 3, frames: 267, pictures: 0, every label follows from the facts\n"));
    let counts: Value = serde_json::from_str(&told(&["check", path, "--json"])).unwrap();
    assert_eq!(counts["published"], serde_json::json!([4155, 2882, 715, 6488]));
    let total: u64 = counts["actions"]
        .as_array()
        .unwrap()
        .iter()
        .map(|count| count.as_u64().unwrap())
        .sum();
    assert_eq!(total, 267 * 8);

    let original = contents(folder);
    let restore = || {
        original
            .iter()
            .for_each(|(name, bytes)| fs::write(folder.join(name), bytes).unwrap())
    };
    let entities = "world-00001/entities.parquet";
    let mut bytes = original[entities].clone();
    bytes[200] ^= 1;
    fs::write(folder.join(entities), &bytes).unwrap();
    refused(
        &["check", path],
        &["invalid-data-set", "is not the file that was made", entities],
    );

    // With hashes to match, the rules tell.
    let label = |table: &mut Table| {
        let (_, Values::MaybeInt(labels)) = table.columns.iter_mut().find(|(name, _)| name == "label").unwrap() else {
            panic!("labels are numbers")
        };
        let label = labels.iter_mut().flatten().next().unwrap();
        *label = (*label + 1) % 4;
    };
    let fact = |table: &mut Table| {
        let (_, Values::Bool(holds)) = table.columns.iter_mut().find(|(name, _)| name == "IsInInter").unwrap() else {
            panic!("facts are true or not")
        };
        holds.iter_mut().for_each(|holds| *holds = !*holds);
    };
    let order = |table: &mut Table| {
        let Values::Int(agents) = &mut table.columns[2].1 else {
            panic!("positions are numbers")
        };
        agents.swap(0, 1);
    };
    let column = |table: &mut Table| drop(table.columns.pop());
    type Change<'a> = &'a dyn Fn(&mut Table);
    let faults: [(Change<'_>, &str); 4] = [
        (&label, "is labelled"),
        (&fact, "is labelled"),
        (&order, "in order"),
        (&column, "there is no column `IsInInter`"),
    ];
    for (change, word) in faults {
        let mut table = Table::read(original[entities].clone()).unwrap();
        change(&mut table);
        let mut bytes = Vec::new();
        table.write(&mut bytes).unwrap();
        put(folder, entities, &bytes);
        refused(&["check", path], &["invalid-data-set", word, "world-00001"]);
        restore();
    }
    put(folder, entities, b"no table");
    refused(&["check", path], &["not a table of frames"]);
    restore();

    fs::rename(folder.join("world-00001"), folder.join("elsewhere")).unwrap();
    refused(&["check", path], &["world-00001", "No such file"]);
    fs::rename(folder.join("elsewhere"), folder.join("world-00003")).unwrap();
    refused(&["check", path], &["holds world 1"]);
    fs::rename(folder.join("world-00003"), folder.join("world-00001")).unwrap();
    let manifest = String::from_utf8(original["manifest.json"].clone()).unwrap();
    fs::write(
        folder.join("manifest.json"),
        manifest.replace("entities.parquet", "../x"),
    )
    .unwrap();
    refused(&["check", path], &["is not in the folder of the world"]);
    fs::write(
        folder.join("manifest.json"),
        manifest.replace("\"version\": 2", "\"version\": 1"),
    )
    .unwrap();
    refused(&["check", path], &["version 1; this program reads version 2"]);
    fs::write(
        folder.join("manifest.json"),
        manifest.replace("\"rules_hash\": \"", "\"rules_hash\": \"0"),
    )
    .unwrap();
    refused(&["check", path], &["other rules"]);
    restore();
    check();
}

/// Replaces a file and what is told of it.
fn put(folder: &Path, name: &str, bytes: &[u8]) {
    fs::write(folder.join(name), bytes).unwrap();
    let (world, file) = name.split_once('/').unwrap();
    for (told, at) in [
        (format!("{world}/world.json"), "/files"),
        ("manifest.json".into(), "/worlds/1/files"),
    ] {
        let path = folder.join(told);
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        let record = &mut value.pointer_mut(at).unwrap()[file];
        record["bytes"] = bytes.len().into();
        record["sha256"] = format!("{:x}", Sha256::digest(bytes)).into();
        fs::write(&path, value.to_string()).unwrap();
    }
}

#[test]
fn what_is_no_data_set_is_told() {
    refused(
        &["check", "tests/fixtures/diagnostics/invalid-data-set"],
        &["error[invalid-data-set]", "manifest.json"],
    );
    assert_eq!(vap(&["check", "no/such/folder"]).status.code(), Some(2));
    assert_eq!(
        vap(&["make", "--mode", "medium", "--split", "test", "--out", "x"])
            .status
            .code(),
        Some(2)
    );
    assert_eq!(
        vap(&[
            "make", "--mode", "easy", "--split", "test", "--worlds", "0", "--out", "x"
        ])
        .status
        .code(),
        Some(2)
    );
}

/// The published fixed test set has 29, 20, 5 and 46 % of the labels. Ours has fewer of slow and normal and 8 % more of stop: more cars wait
/// for each other.
#[test]
fn labels_are_about_as_frequent_as_published() {
    let worlds = worlds(Agents::Fixed, Split::Test);
    let counts = (0..20).map(|number| count_actions(&worlds.frames(number).unwrap()));
    let counts = counts.fold([0; 4], |sum: [u64; 4], more| {
        std::array::from_fn(|action| sum[action] + more[action])
    });
    let total: u64 = counts.iter().sum();
    assert_eq!(total, 20 * 89 * 8);
    for (count, published) in counts.into_iter().zip([4155, 2882, 715, 6488]) {
        let here = count * 1000 / total;
        assert!(here.abs_diff(published * 1000 / 14240) < 100, "{counts:?}");
    }
}
