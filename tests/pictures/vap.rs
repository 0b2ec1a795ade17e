//! Visual Action Prediction: worlds, tables, pictures, and data sets that are cancelled, made in parts, or tampered
//! with.

use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{AgentKind, Split};
use logicity::diag::Sources;
use logicity::diag::codes;
use logicity::files::{Folder, Overwrite};
use logicity::render::{Difficulty, DrawingVersion, Icons, Picture, PixelBox, read_mask_into, read_png, write_png};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::LoadedCity;
use logicity::task::vap::table::{Sample, Table, Values, samples};
use logicity::task::vap::{
    Agents, Dataset, DatasetError, DatasetRequest, DatasetWriter, FIRST_TICK, Frame, Mode, SIDE, Statistics, TICKS,
    WorldCounts, Worlds, count_atoms, icon_seed,
};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

fn hard_mode() -> LoadedCity {
    LoadedCity::load(&mut Sources::new(), Path::new(Mode::Hard.config()), None, &BuiltinFiles).unwrap()
}

fn worlds(agents: Agents, split: Split) -> Worlds {
    // Drawing icons takes long, so all worlds share them.
    static ICONS: OnceLock<Arc<Icons>> = OnceLock::new();
    let icons = ICONS.get_or_init(|| Arc::new(Icons::new(Seed(0), Difficulty::CLEAN)));
    let city = hard_mode();
    Worlds::new(city.scenario, city.program, Arc::clone(icons), agents, split, 0).unwrap()
}

fn vap(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
    command
        .arg("vap")
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    command.output().unwrap()
}

/// The output of a command that must succeed.
fn stdout_of(arguments: &[&str]) -> String {
    let output = vap(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The data set is faulty.
fn refused(arguments: &[&str], words: &[&str]) {
    fails(1, arguments, words);
}

fn fails(code: i32, arguments: &[&str], words: &[&str]) {
    let output = vap(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in:\n{said}");
    }
}

/// A request for tables without pictures.
const MAKE: [&str; 6] = ["make", "--mode", "hard", "--split", "test", "--no-pictures"];

fn make(folder: &Path, more: &[&str]) -> String {
    stdout_of(&[&MAKE[..], &["--out", folder.to_str().unwrap()], more].concat())
}

/// All files below a folder, by name.
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
fn tables_equal_frames() {
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
    let fractions: Vec<Option<f32>> = frames.iter().flat_map(|frame| worlds.visible(frame)).collect();
    assert_eq!(entities.maybe_floats("visible").unwrap(), fractions);
    let covered = fractions.iter().flatten().filter(|fraction| **fraction < 1.0);
    assert!((10..500).contains(&covered.count()));
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
    // Cars have labels; other agents have none.
    let mut unlabeled = entities.clone();
    let labels = unlabeled.columns.iter_mut().find(|(name, _)| name == "label");
    let Some((_, Values::MaybeInt(labels))) = labels else {
        panic!("no labels")
    };
    let car = labels.iter().position(Option::is_some).unwrap();
    labels[car] = None;
    let fault = samples(vocabulary, 3, &unlabeled, &pairs).unwrap_err();
    assert!(fault.message.contains("only cars, have labels"), "{}", fault.message);

    // Any bytes are a table or give an error.
    let mut bytes = Vec::new();
    entities.write(&mut bytes).unwrap();
    for number in 0..1000_usize {
        let mut damaged = bytes.clone();
        // Mostly in the metadata of the columns, which is at the end.
        let back = number.wrapping_mul(2_654_435_761) % if number % 3 == 0 { bytes.len() } else { 3000 };
        let at = bytes.len() - 1 - back;
        damaged[at] = damaged[at].wrapping_add(1 + (number / 7 % 255) as u8);
        if let Ok(read) = Table::read(damaged) {
            let _ = samples(vocabulary, 3, &read, &pairs);
        }
    }

    // A box contains the center of the agent's cell if the picture does.
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
fn random_agents_follow_the_paper() {
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
fn parts_equal_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, part] = ["whole", "part"].map(|name| folder.path().join(name));
    let said = make(&whole, &["--worlds", "3"]);
    assert!(said.starts_with("worlds made: 3, in "), "{said}");
    let expected = contents(&whole);
    assert_eq!(expected.len(), 3 * 3 + 2);
    let manifest: Value = serde_json::from_slice(&expected["manifest.json"]).unwrap();
    assert_eq!(manifest["settings"]["difficulty"], 50);

    make(&part, &["--worlds", "1", "--first-world", "2"]);
    let parts = contents(&part);
    assert_eq!(parts.len(), 3 + 2);
    for name in parts.keys().filter(|name| name.starts_with("world-00002")) {
        assert_eq!(parts[name], expected[name], "{name}");
    }
    // The settings must equal those of the folder.
    let again = [&MAKE[..], &["--out", part.to_str().unwrap()]].concat();
    for more in [["--seed", "1"], ["--difficulty", "0"]] {
        fails(2, &[&again[..], &more].concat(), &["manifest.json", "other settings"]);
        fails(
            2,
            &[&again[..], &more, &["--force"]].concat(),
            &["world-00002", "other settings"],
        );
    }
    let pictures: Vec<&str> = again.iter().copied().filter(|word| *word != "--no-pictures").collect();
    fails(2, &pictures, &["manifest.json", "other settings"]);
    let old = fs::read_to_string(part.join("world-00002/world.json")).unwrap();
    fs::write(
        part.join("world-00002/world.json"),
        old.replace("\"version\": 4", "\"version\": 2"),
    )
    .unwrap();
    fails(2, &again, &["version 2; this program reads versions 3 and 4"]);

    tampered_sets_are_found_out(&whole);
}

/// Returns the writer of the first worlds of a data set that [`MAKE`] requests.
fn writer(worlds: u32, threads: usize) -> DatasetWriter {
    let request = DatasetRequest {
        worlds: 0..worlds,
        pictures: false,
        threads: NonZeroUsize::new(threads).unwrap(),
        ..DatasetRequest::new(Mode::Hard, Split::Test)
    };
    let icons = Icons::new(request.icon_seed(), Difficulty::percent(50).unwrap());
    DatasetWriter::new(request, hard_mode(), icons).unwrap()
}

/// A folder that `make` completes is one that `check` accepts: `make` refuses other content, with and without
/// `--force`, and changes nothing.
#[test]
fn make_refuses_what_check_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let out = Folder::new(folder.path());
    let folder = folder.path();
    let writer = writer(1, 1);
    let write = |overwrite| writer.write(&out, overwrite, &|_, _| (), &Cancel::never());
    let check = || {
        let set = Dataset::open(out.clone()).unwrap();
        match set.check(hard_mode(), NonZeroUsize::MIN, &|_, _| (), &Cancel::never()) {
            Ok(()) => Vec::new(),
            Err(DatasetError::Faulty(faults)) => faults.into_iter().map(|fault| fault.message).collect(),
            Err(error) => panic!("{error}"),
        }
    };
    write(Overwrite::Own).unwrap();
    assert_eq!(check(), [""; 0]);
    let expected = contents(folder);
    let refuses = |path: &str, reason: &str| {
        let before = contents(folder);
        let found = check();
        let named = found.iter().find(|fault| fault.contains(&format!("{path}`: ")));
        assert!(named.is_some_and(|fault| fault.contains(reason)), "{path}: {found:?}");
        for overwrite in [Overwrite::Own, Overwrite::Any] {
            let Err(DatasetError::Occupied(occupied)) = write(overwrite) else {
                panic!("{path}: not refused")
            };
            assert!(occupied.path.ends_with(path) && !occupied.replaceable, "{occupied}");
            assert!(occupied.reason.contains(reason), "{occupied}");
        }
        assert!(contents(folder) == before, "{path}");
    };
    for (name, reason) in [
        ("notes.txt", "it belongs to no data set"),
        (".logicity.json", "it belongs to no data set"),
        (".world-notes.partial", "it belongs to no data set"),
        (".world-00001.partial", "it belongs to no data set"),
        ("world-1", "it belongs to no data set"),
        ("world-00001", "it has the name of a world, but is not a folder"),
        ("world-00000/notes.txt", "it does not belong to the world"),
    ] {
        fs::write(folder.join(name), "foreign").unwrap();
        refuses(name, reason);
        fs::remove_file(folder.join(name)).unwrap();
    }
    let world = folder.join("world-00001");
    fs::create_dir(&world).unwrap();
    refuses("world-00001", "`world.json` in it is wrong: no such file");
    for (text, reason) in [
        (&b"{}"[..], "not a file of a data set"),
        (b"\xff", "not UTF-8"),
        (&expected["world-00000/world.json"], "it holds world 0"),
    ] {
        fs::write(world.join("world.json"), text).unwrap();
        refuses("world-00001", reason);
    }
    fs::remove_dir_all(&world).unwrap();
    fs::remove_file(folder.join("world-00000/pairs.parquet")).unwrap();
    assert!(check().iter().any(|fault| fault.contains("world-00000/pairs.parquet")));
    let said = write(Overwrite::Own).unwrap_err().to_string();
    assert!(
        said.contains("world-00000`: its file `pairs.parquet` is missing"),
        "{said}"
    );
    let table = "world-00000/pairs.parquet";
    fs::write(folder.join(table), &expected[table]).unwrap();

    // The two files that `make` itself replaces, if it may.
    for name in ["README.md", "manifest.json"] {
        for foreign in [&b"foreign"[..], b"\xff"] {
            fs::write(folder.join(name), foreign).unwrap();
            let Err(DatasetError::Occupied(occupied)) = write(Overwrite::Own) else {
                panic!("{name}: not refused")
            };
            assert!(occupied.path.ends_with(name) && occupied.replaceable, "{occupied}");
            assert_eq!(fs::read(folder.join(name)).unwrap(), foreign);
            write(Overwrite::Any).unwrap();
            assert!(contents(folder) == expected);
        }
    }

    // `make` removes what an interrupted `make` has left.
    let left = [".world-00001.partial", ".manifest.json.logicity-1-2"];
    fs::create_dir(folder.join(left[0])).unwrap();
    fs::write(folder.join(left[0]).join("pairs.parquet"), "").unwrap();
    fs::write(folder.join(left[1]), "{").unwrap();
    let found = check();
    for name in left {
        let incomplete = format!("{name}`: it is incomplete");
        assert!(found.iter().any(|fault| fault.contains(&incomplete)), "{found:?}");
    }
    write(Overwrite::Own).unwrap();
    assert!(contents(folder) == expected && !folder.join(".world-00001.partial").exists());
    assert_eq!(check(), [""; 0]);

    // The command line.
    fs::write(folder.join("notes.txt"), "foreign").unwrap();
    let path = folder.to_str().unwrap();
    fails(
        2,
        &[&MAKE[..], &["--out", path, "--worlds", "1"]].concat(),
        &[
            "notes.txt`: it belongs to no data set",
            "help: choose another folder, or move it elsewhere",
        ],
    );
    refused(
        &["check", path],
        &["notes.txt`: it belongs to no data set", "help: move it elsewhere"],
    );
}

/// The library makes the files of the command. It calls both callbacks on the calling thread.
#[test]
fn a_cancelled_data_set_is_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let by_command = folder.path().join("command");
    make(&by_command, &["--worlds", "2", "--threads", "1"]);
    let expected = contents(&by_command);

    let here = thread::current().id();
    let is_cancelled = |error: DatasetError| match error {
        DatasetError::Faulty(faults) => assert_eq!(faults[0].code, codes::CANCELLED),
        error => panic!("{error}"),
    };
    let writers = [1, 2].map(|threads| writer(2, threads));
    for (index, writer) in writers.iter().enumerate() {
        let out = Folder::make(&folder.path().join(format!("library-{index}"))).unwrap();
        // Before the first world.
        is_cancelled(
            writer
                .write(&out, Overwrite::Own, &|_, _| (), &Cancel::when(|| true))
                .unwrap_err(),
        );
        assert!(contents(out.path()).is_empty());
        // Before the tables of the last world.
        let frames = Arc::new(AtomicU64::new(0));
        let progress = |done, total| {
            assert_eq!((thread::current().id(), total), (here, 178));
            assert!(done >= frames.swap(done, Ordering::Relaxed));
        };
        let made = Arc::clone(&frames);
        let cancel = Cancel::when(move || {
            assert_eq!(thread::current().id(), here);
            made.load(Ordering::Relaxed) == 178
        });
        let written = writer.write(&out, Overwrite::Own, &progress, &cancel);
        let kept = contents(out.path());
        let complete: BTreeSet<&str> = kept
            .keys()
            .filter_map(|name| Some(name.split_once("/world.json")?.0))
            .collect();
        if index == 0 {
            is_cancelled(written.unwrap_err());
            assert_eq!((kept.len(), &complete), (3, &BTreeSet::from(["world-00000"])));
        } else if let Err(error) = written {
            // Two threads may finish before the next poll.
            is_cancelled(error);
        }
        assert!(
            kept.iter()
                .all(|(name, bytes)| name.starts_with('.') || *bytes == expected[name])
        );
        // Another call makes the rest, with any number of threads.
        let summary = writers[1 - index]
            .write(&out, Overwrite::Own, &|_, _| (), &Cancel::never())
            .unwrap();
        assert_eq!((summary.made, summary.manifest.frames), (2 - complete.len(), 178));
        assert!(contents(out.path()) == expected);
    }

    let set = Dataset::open(Folder::new(&by_command)).unwrap();
    assert_eq!((set.mode(), set.manifest().worlds.len()), (Mode::Hard, 2));
    let worlds = AtomicU64::new(0);
    let progress = |done, _| worlds.store(done, Ordering::Relaxed);
    set.check(hard_mode(), NonZeroUsize::MIN, &progress, &Cancel::never())
        .unwrap();
    assert_eq!(worlds.load(Ordering::Relaxed), 2);
    is_cancelled(
        set.check(hard_mode(), NonZeroUsize::MIN, &|_, _| (), &Cancel::when(|| true))
            .unwrap_err(),
    );
    let mut other = hard_mode();
    other.rules_hash.push('0');
    let refused = set
        .check(other, NonZeroUsize::MIN, &|_, _| (), &Cancel::never())
        .unwrap_err();
    assert!(refused.to_string().contains("other rules"), "{refused}");
}

/// Sets the visible fraction of the last pedestrian of the first frame, which is drawn last.
fn set_visible(table: &mut Table, fraction: f32) {
    let (_, Values::MaybeFloat(visible)) = table.columns.iter_mut().find(|(name, _)| name == "visible").unwrap() else {
        panic!("a fraction that is not a number")
    };
    visible[6] = Some(fraction);
}

/// Without covers, `check` knows which agents are wholly visible. With covers, any agent may be partly hidden.
#[test]
fn wrong_visible_fractions_are_found_out() {
    for (difficulty, is_refused) in [("0", true), ("50", false)] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        make(folder, &["--worlds", "2", "--difficulty", difficulty]);
        let entities = "world-00001/entities.parquet";
        let mut table = Table::read(fs::read(folder.join(entities)).unwrap()).unwrap();
        set_visible(&mut table, 0.25);
        let mut bytes = Vec::new();
        table.write(&mut bytes).unwrap();
        put(folder, entities, &bytes);
        let check = ["check", folder.to_str().unwrap()];
        match is_refused {
            true => refused(
                &check,
                &["row 6 of the entities is 0.25 visible, but nothing covers it"],
            ),
            false => assert!(stdout_of(&check).starts_with("worlds: 2, ")),
        }
    }
}

/// Changes a file of world 1, with or without the matching counts and hashes.
fn tampered_sets_are_found_out(folder: &Path) {
    let path = folder.to_str().unwrap();
    let check = || stdout_of(&["check", path]);
    assert!(check().starts_with("worlds: 3, frames: 267, pictures: 0, every label follows from the facts\n"));
    let counts: Value = serde_json::from_str(&stdout_of(&["check", path, "--json"])).unwrap();
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
        &["invalid-data-set", "has changed since it was made", entities],
    );

    // With matching hashes, the rules detect the change.
    let label = |table: &mut Table| {
        let (_, Values::MaybeInt(labels)) = table.columns.iter_mut().find(|(name, _)| name == "label").unwrap() else {
            panic!("a label that is not a number")
        };
        let label = labels.iter_mut().flatten().next().unwrap();
        *label = (*label + 1) % 4;
    };
    let fact = |table: &mut Table| {
        let (_, Values::Bool(holds)) = table.columns.iter_mut().find(|(name, _)| name == "IsInInter").unwrap() else {
            panic!("a fact that is not a Boolean")
        };
        holds.iter_mut().for_each(|holds| *holds = !*holds);
    };
    let order = |table: &mut Table| {
        let Values::Int(agents) = &mut table.columns[2].1 else {
            panic!("a position that is not a number")
        };
        agents.swap(0, 1);
    };
    let column = |table: &mut Table| drop(table.columns.pop());
    let corner = |table: &mut Table| {
        let (_, Values::MaybeInt(xs)) = table.columns.iter_mut().find(|(name, _)| name == "x").unwrap() else {
            panic!("a corner that is not a number")
        };
        *xs.iter_mut().flatten().next().unwrap() = 1020;
    };
    let concept = |table: &mut Table| {
        let (_, Values::Text(concepts)) = table.columns.iter_mut().find(|(name, _)| name == "concepts").unwrap() else {
            panic!("a concept that is not text")
        };
        concepts[0] = "taxi".to_owned();
    };
    type Change<'a> = &'a dyn Fn(&mut Table);
    let too_visible = |table: &mut Table| set_visible(table, 1.5);
    let faults: [(Change<'_>, &str); 7] = [
        (&label, "is labeled"),
        (&fact, "is labeled"),
        (&order, "in order"),
        (&column, "there is no column `IsInInter`"),
        (&corner, "does not lie in the picture"),
        (&too_visible, "row 6 of the entities has a wrong visible fraction"),
        (&concept, "has counts that differ from its tables"),
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
        manifest.replace("\"version\": 4", "\"version\": 2"),
    )
    .unwrap();
    refused(&["check", path], &["version 2; this program reads versions 3 and 4"]);
    fs::write(
        folder.join("manifest.json"),
        manifest.replace("\"rules_hash\": \"", "\"rules_hash\": \"0"),
    )
    .unwrap();
    refused(&["check", path], &["other rules"]);
    restore();
    check();
}

/// Masks show each agent in its box where the tables say that it is visible, leave the other files as they are, and are
/// found out if they do not.
#[test]
fn masks_show_the_agents() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, masked] = ["plain", "masked"].map(|name| folder.path().join(name));
    make(&plain, &["--worlds", "2"]);
    make(&masked, &["--worlds", "2", "--masks"]);
    let (without, with) = (contents(&plain), contents(&masked));
    let is_mask = |name: &str| name.contains("/mask-");
    assert_eq!(with.keys().filter(|name| is_mask(name)).count(), 2 * 89);
    for name in without.keys().filter(|name| name.ends_with(".parquet")) {
        assert_eq!(with[name], without[name], "{name}");
    }
    assert_eq!(with.len(), without.len() + 2 * 89);
    let card = String::from_utf8(with["README.md"].clone()).unwrap();
    assert!(
        card.contains("mask-TTT.png") && card.contains("--no-pictures --masks"),
        "{card}"
    );
    let path = masked.to_str().unwrap();
    let check = || stdout_of(&["check", path]);
    assert!(check().starts_with("worlds: 2, frames: 178, pictures: 0, every label follows from the facts\n"));

    // The masks are those of the frames, whose agents have the order of the table.
    let worlds = worlds_at(50, DrawingVersion::V2, Agents::Fixed, Split::Test);
    let table = Table::read(with["world-00001/entities.parquet"].clone()).unwrap();
    let (visible, ticks) = (
        logicity::task::vap::table::visible(&table).unwrap(),
        table.ints("tick").unwrap(),
    );
    let mut row = 0;
    for frame in worlds.frames(1).unwrap() {
        let mut mask = vec![0; SIDE as usize * SIDE as usize];
        let name = format!("world-00001/mask-{:03}.png", frame.tick);
        read_mask_into(&with[&name], (SIDE, SIDE), &mut mask).unwrap();
        assert!(mask == worlds.mask(&frame), "{name}");
        for number in 1..=frame.agents.len() {
            assert_eq!(u64::try_from(ticks[row]).unwrap(), frame.tick);
            let shows = mask.iter().any(|&value| usize::from(value) == number);
            assert_eq!(
                shows,
                visible[row].is_some_and(|fraction| fraction > 0.0),
                "{name}, agent {number}"
            );
            row += 1;
        }
    }
    assert_eq!(row, table.rows());

    let (first, last) = ("world-00001/mask-011.png", "world-00001/mask-099.png");
    let mut other = vec![0; SIDE as usize * SIDE as usize];
    read_mask_into(&with[first], (SIDE, SIDE), &mut other).unwrap();
    *other.iter_mut().find(|value| **value == 0).unwrap() = 200;
    let unknown = encoded(&other, SIDE, png::ColorType::Grayscale);
    let black = encoded(&vec![0; SIDE as usize * SIDE as usize], SIDE, png::ColorType::Grayscale);
    let faults: [(&[u8], &str); 5] = [
        (&with[last], "row "),
        (&unknown, "a pixel has the value 200, but the tick has fewer agents"),
        (&black, "has pixels, unlike its visible fraction, or lacks them"),
        (b"no picture", "not a valid PNG"),
        (
            &encoded(&[0; 16], 4, png::ColorType::Grayscale),
            "4 x 4 pixels instead of 1024 x 1024",
        ),
    ];
    for (bytes, words) in faults {
        put(&masked, first, bytes);
        refused(&["check", path], &["invalid-data-set", words, "mask-011.png"]);
        put(&masked, first, &with[first]);
    }
    put(&masked, first, &encoded(&vec![0; 3 << 20], SIDE, png::ColorType::Rgb));
    refused(&["check", path], &["the pixels are not 8-bit grayscale"]);
    put(&masked, first, &with[first]);
    check();
    // The option belongs to the settings.
    let again = [&MAKE[..], &["--out", path]].concat();
    fails(2, &again, &["manifest.json", "other settings"]);
}

/// Replaces a file of world 1 and its record in the manifest.
fn put(folder: &Path, name: &str, bytes: &[u8]) {
    fs::write(folder.join(name), bytes).unwrap();
    let (world, file) = name.split_once('/').unwrap();
    for (stdout_of, at) in [
        (format!("{world}/world.json"), "/files"),
        ("manifest.json".into(), "/worlds/1/files"),
    ] {
        let path = folder.join(stdout_of);
        let mut value: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        let record = &mut value.pointer_mut(at).unwrap()[file];
        record["bytes"] = bytes.len().into();
        record["sha256"] = format!("{:x}", Sha256::digest(bytes)).into();
        fs::write(&path, value.to_string()).unwrap();
    }
}

/// A pack with one instance per class, so that a debug build draws all icons quickly.
fn write_pack(folder: &Path) {
    let classes = [
        "car",
        "bus",
        "ambulance",
        "police",
        "reckless",
        "tiro",
        "old",
        "young",
        "pedestrian",
        "house",
        "office",
        "garage",
        "store",
        "gas-station",
    ];
    for (number, class) in classes.iter().enumerate() {
        fs::create_dir_all(folder.join(class)).unwrap();
        let ellipse = format!(
            "<ellipse cx='15' cy='25' rx='14' ry='{}' fill='#9{number:x}3'/>",
            10 + number
        );
        let drawing = format!("<svg xmlns='http://www.w3.org/2000/svg' width='30' height='50'>{ellipse}</svg>");
        fs::write(folder.join(class).join("1.svg"), drawing).unwrap();
    }
}

/// The number of files in the subfolders of a folder.
fn files_inside(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    // The program may rename a folder in the meantime.
    let inside = entries.filter_map(|entry| Some(fs::read_dir(entry.path()).ok()?.count()));
    inside.sum()
}

#[test]
fn pictures_are_the_same_after_a_kill_and_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed, pack] = ["whole", "killed", "pack"].map(|name| folder.path().join(name));
    write_pack(&pack);
    let make = |out: &Path, threads: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
        command.args([
            "vap", "make", "--mode", "easy", "--agents", "random", "--split", "val", "--worlds", "2",
        ]);
        command.args([
            "--pack",
            pack.to_str().unwrap(),
            "--pack-mode",
            "replace",
            "--threads",
            threads,
        ]);
        command
            .arg("--out")
            .arg(out)
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command
    };
    assert!(make(&whole, "1").status().unwrap().success());
    let expected = contents(&whole);
    assert_eq!(expected.len(), 2 * (89 + 3) + 2);

    let mut stream = Seed(5).stream(Purpose::TEST, 0, 0);
    for round in 0..5 {
        let mut process = make(&killed, if round % 2 == 0 { "2" } else { "1" }).spawn().unwrap();
        // Kill it after some files, without those of earlier rounds.
        let begin = files_inside(&killed);
        let end = begin + stream.random_range(1..30);
        while files_inside(&killed) < end && process.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        process.kill().unwrap();
        process.wait().unwrap();
        for (name, bytes) in contents(&killed) {
            assert!(
                name.starts_with('.') || bytes == expected[&name],
                "round {round}: {name}"
            );
        }
    }
    // Leave the files of a kill at the worst moment.
    fs::create_dir_all(killed.join(".world-00001.partial")).unwrap();
    fs::write(killed.join(".world-00001.partial/entities.parquet"), "PAR1").unwrap();
    fs::write(killed.join(".manifest.json.logicity-1-2"), "{").unwrap();
    for _ in 0..2 {
        assert!(make(&killed, "3").status().unwrap().success());
        assert!(contents(&killed) == expected);
    }
    // The next run makes only missing worlds.
    fs::remove_dir_all(killed.join("world-00001")).unwrap();
    let written = || {
        fs::metadata(killed.join("world-00000/frame-011.png"))
            .unwrap()
            .modified()
            .unwrap()
    };
    let before = written();
    for made in [1, 0] {
        let said = make(&killed, "2").stdout(Stdio::piped()).output().unwrap().stdout;
        let said = String::from_utf8(said).unwrap();
        assert!(said.starts_with(&format!("worlds made: {made}, in ")), "{said}");
        assert!(written() == before && contents(&killed) == expected);
    }
    // The tables are the same without pictures.
    let tables = folder.path().join("tables");
    assert!(make(&tables, "2").arg("--no-pictures").status().unwrap().success());
    for (name, bytes) in contents(&tables).iter().filter(|(name, _)| name.ends_with(".parquet")) {
        assert!(*bytes == expected[name], "{name}");
    }
    tampered_pictures_are_found_out(&whole, &expected);
}

fn tampered_pictures_are_found_out(folder: &Path, original: &BTreeMap<String, Vec<u8>>) {
    let path = folder.to_str().unwrap();
    let said = stdout_of(&["check", path]);
    assert!(said.starts_with("worlds: 2, frames: 178, pictures: 178, "), "{said}");
    let frame = |tick: u32| format!("world-00001/frame-{tick:03}.png");
    let picture = read_png(&original[&frame(42)]).unwrap();
    assert_eq!((picture.width(), picture.height()), (SIDE, SIDE));

    // `check` reports all faults together: a changed pixel, a missing picture, and invalid pictures with matching
    // hashes.
    let mut pixels = picture.pixels().to_vec();
    pixels[3_000] ^= 1;
    fs::write(folder.join(frame(42)), encoded(&pixels, SIDE, png::ColorType::Rgb)).unwrap();
    fs::remove_file(folder.join(frame(43))).unwrap();
    put(folder, &frame(44), &encoded(&pixels[..30], 10, png::ColorType::Rgb));
    put(
        folder,
        &frame(45),
        &encoded(&pixels[..1 << 20], SIDE, png::ColorType::Grayscale),
    );
    put(
        folder,
        &frame(46),
        &original[&frame(46)][..original[&frame(46)].len() / 2],
    );
    let faults = [
        (42, "has changed since it was made"),
        (43, "No such file"),
        (44, "10 x 1 pixels instead of 1024 x 1024"),
        (45, "the pixels are not 8-bit RGB"),
        (46, "not a valid PNG"),
    ];
    let output = vap(&["check", path]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for (tick, word) in faults {
        let line = said
            .lines()
            .find(|line| line.contains(&frame(tick)))
            .unwrap_or_default();
        assert!(
            line.contains("error[invalid-data-set]") && line.contains(word),
            "{word}:\n{said}"
        );
    }
    assert!(said.contains("5 errors"), "{said}");
    original
        .iter()
        .for_each(|(name, bytes)| fs::write(folder.join(name), bytes).unwrap());

    // Files that do not belong to the data set.
    fs::write(folder.join("notes.txt"), "").unwrap();
    fs::write(folder.join(frame(100)), &original[&frame(42)]).unwrap();
    let unexpected_files = [
        "belongs to no data set",
        "notes.txt",
        "does not belong to the world",
        &frame(100),
        "2 errors",
    ];
    refused(&["check", path], &unexpected_files);
    fs::remove_file(folder.join("notes.txt")).unwrap();
    put(folder, &frame(100), &original[&frame(42)]);
    refused(
        &["check", path],
        &["does not have exactly one picture per frame", "world-00001"],
    );
}

/// A PNG with this number of columns.
fn encoded(pixels: &[u8], width: u32, color_type: png::ColorType) -> Vec<u8> {
    let mut bytes = Vec::new();
    let height = u32::try_from(pixels.len() / color_type.samples()).unwrap() / width;
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color_type);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(pixels).unwrap();
    writer.finish().unwrap();
    bytes
}

/// Whether two pictures differ in each pixel of a rectangle.
fn differs(left: &Picture, right: &Picture, area: PixelBox) -> Vec<bool> {
    let pixel = |picture: &Picture, x: i32, y: i32| {
        let at = 3 * (y.cast_unsigned() * picture.width() + x.cast_unsigned()) as usize;
        picture.pixels()[at..at + 3].to_vec()
    };
    let rows = area.y..area.y + area.height.cast_signed();
    let places = rows.flat_map(|y| (area.x..area.x + area.width.cast_signed()).map(move |x| (x, y)));
    places.map(|(x, y)| pixel(left, x, y) != pixel(right, x, y)).collect()
}

#[test]
fn boxes_are_where_agents_are_in_the_picture() {
    let worlds = worlds(Agents::Fixed, Split::Test);
    let renderer = worlds.renderer(0);
    let frames = worlds.frames(0).unwrap();
    let mut checked = 0;
    for frame in frames.iter().step_by(22) {
        let sprites = frame.sprites();
        let boxes = worlds.boxes(frame);
        assert_eq!(boxes, renderer.boxes(&sprites));
        for (at, pixels) in boxes.iter().enumerate() {
            assert_eq!(renderer.visible(&sprites[at..=at]), [pixels.map(|_| 1.0)]);
        }
        for (sprite, area) in sprites.iter().zip(boxes) {
            let alone = renderer.draw(&[*sprite]);
            let Some(area) = area else { continue };
            let changed = differs(&alone, renderer.ground(), area);
            let count = changed.iter().filter(|changed| **changed).count();
            // A bus on the diagonal covers two fifths of its box.
            assert!(
                3 * count > changed.len(),
                "{count} of {} pixels: {sprite:?}",
                changed.len()
            );
            // Each side of the box touches the agent.
            let PixelBox { x, y, width, height } = area;
            let (right, bottom) = (x + width.cast_signed() - 1, y + height.cast_signed() - 1);
            for side in [
                PixelBox { width: 1, ..area },
                PixelBox {
                    x: right,
                    width: 1,
                    ..area
                },
                PixelBox { height: 1, ..area },
                PixelBox {
                    y: bottom,
                    height: 1,
                    ..area
                },
            ] {
                assert!(
                    differs(&alone, renderer.ground(), side).contains(&true),
                    "{side:?} of {sprite:?}"
                );
            }
            checked += 1;
        }
        // The written picture equals the drawn one.
        let mut bytes = Vec::new();
        write_png(&renderer.draw(&sprites), &mut bytes).unwrap();
        assert!(read_png(&bytes).unwrap() == renderer.draw(&sprites));
    }
    assert!(checked > 30, "{checked}");
}

/// Worlds of a data set with seed 0, in hard mode.
fn worlds_at(percent: u8, version: DrawingVersion, agents: Agents, split: Split) -> Worlds {
    let icons = Icons::new(icon_seed(0, split), Difficulty::percent(percent).unwrap());
    let icons = icons.with_version(version).with_split(split);
    let city = hard_mode();
    Worlds::new(city.scenario, city.program, Arc::new(icons), agents, split, 0).unwrap()
}

fn sha256(bytes: &[u8]) -> String {
    format!("{:x}", Sha256::digest(bytes))
}

/// Data sets of both drawing versions can be made again. The hashes are those of the specimen, and of the first picture
/// and the entities of world 0; those of version 1 come from the last program without drawing versions.
#[test]
fn drawing_versions_keep_their_bytes() {
    const TABLE: &str = "ef19e0bbade47f19059c59fe7c3d43e8edd8543a4a76d1d07f7a5b00534d5664";
    const CLEAN: [&str; 3] = [
        "438f353cbc0fece4718330ebf3e8d246e8cc8c1ffed6c4ad73734dfee8de70cc",
        "7998d56367553dc45d3b621984c6aa84496b6e1ebdb57f4518daf1401215becd",
        TABLE,
    ];
    for (percent, hashes) in [
        (0, [CLEAN, CLEAN]),
        (
            50,
            [
                [
                    "45e9d46372da8a4f9447a5f4bb6384cbd3d176522c4d7bc58408ff4fa74fa1e3",
                    "01792dfc49d793b21d10d52df852f1303afa3d3dea5e2bc30564d0097a7d4cd0",
                    TABLE,
                ],
                [
                    "b615741b655895eeba926c03bdd842532ea10e352c185fda5ccb226283c72fb3",
                    "b1b3c9ec3280d04500cf796d7cd694a35ab88893e5abecbfd3e4ff78f2002025",
                    "96130455297dd73b5ca25d7c962d715b16ed0bf47702a51f6f51a4fe54ce5bdc",
                ],
            ],
        ),
        (
            100,
            [
                [
                    "9487bd8638853c563ed3bd3f2664fd087e97108d7c3dcdc66cdb461f611cf106",
                    "0fde1e3660676c85da7a0cebe0bc145b094654268f079931c95f03310a1505ec",
                    TABLE,
                ],
                [
                    "843c31bc05d7bcbd028fac24a3e3d52dfe322418f7f85e4abbe0f015d3763a8e",
                    "9e794bfce88b88599658b6e6286900f5e3ce33ca766350001ee710a9f0110ee6",
                    "dbaff43480cad7f387e41ccb11320d1c54366f3f133f78f1dda4118365127179",
                ],
            ],
        ),
    ] {
        for (version, expected) in DrawingVersion::ALL.into_iter().zip(hashes) {
            let worlds = worlds_at(percent, version, Agents::Fixed, Split::Test);
            let frames = worlds.frames(0).unwrap();
            let mut bytes = Vec::new();
            write_png(&worlds.renderer(0).draw(&frames[0].sprites()), &mut bytes).unwrap();
            let mut table = Vec::new();
            Table::entities(&worlds, 0, &frames).write(&mut table).unwrap();
            let found = [sha256(worlds.specimen().pixels()), sha256(&bytes), sha256(&table)];
            assert_eq!(found, expected, "{percent}, {version:?}");
        }
    }
    // So are the descriptions.
    let folder = tempfile::tempdir().unwrap();
    let version = ["--worlds", "1", "--drawing-version", "1"];
    make(folder.path(), &version);
    let manifest = fs::read(folder.path().join("manifest.json")).unwrap();
    assert_eq!(
        sha256(&manifest),
        "056bada718fb7a9a7a4b3c7ffa91105993a3b62bb7bf69dcc5156d9e9499dede"
    );
    let path = folder.path().to_str().unwrap();
    assert!(stdout_of(&["check", path]).starts_with("worlds: 1, "));
    // A data set has one version.
    let again = [&MAKE[..], &["--worlds", "1", "--out", path]].concat();
    fails(2, &again, &["manifest.json", "other settings"]);
    let text = String::from_utf8(manifest).unwrap();
    for (from, to, word) in [
        ("\"version\": 3", "\"version\": 4", "version 4 with drawing version 1"),
        (
            "\"pack_mode\": null,",
            "\"pack_mode\": null, \"drawing_version\": 3,",
            "drawing version 3",
        ),
    ] {
        fs::write(folder.path().join("manifest.json"), text.replacen(from, to, 1)).unwrap();
        refused(&["check", path], &["error[invalid-data-set]", word]);
    }
}

/// The kind, the concepts, the facing and the box of every agent in the frames of some worlds.
fn boxes_of(worlds: &Worlds, numbers: std::ops::Range<u32>) -> Vec<(String, usize, PixelBox)> {
    let mut found = Vec::new();
    for number in numbers {
        for frame in worlds.frames(number).unwrap() {
            for (agent, area) in frame.agents.iter().zip(worlds.boxes(&frame)) {
                let class = agent.sprite("").class().to_string();
                found.extend(area.map(|area| (class, agent.facing as usize, area)));
            }
        }
    }
    found
}

/// Pearson's statistic of a table of counts, and its degrees of freedom.
fn chi_square(counts: &BTreeMap<(usize, usize), f64>) -> (f64, f64) {
    let sum = |keep: &dyn Fn(&(usize, usize)) -> bool| -> f64 {
        let kept = counts.iter().filter(|(cell, _)| keep(cell));
        kept.map(|(_, count)| count).sum()
    };
    let [rows, cols] = [
        counts.keys().map(|cell| cell.0).collect::<BTreeSet<_>>(),
        counts.keys().map(|cell| cell.1).collect::<BTreeSet<_>>(),
    ];
    let all = sum(&|_| true);
    let mut statistic = 0.0;
    for &row in &rows {
        for &col in &cols {
            let expected = sum(&|cell| cell.0 == row) * sum(&|cell| cell.1 == col) / all;
            let found = counts.get(&(row, col)).copied().unwrap_or(0.0);
            statistic += (found - expected).powi(2) / expected;
        }
    }
    (statistic, ((rows.len() - 1) * (cols.len() - 1)) as f64)
}

/// From difficulty 50 on, the sides of a box are independent of class and facing, by Pearson's test; below, they are
/// not. Under independence the statistic has its degrees of freedom as mean and twice that as variance.
#[test]
fn sides_of_boxes_are_independent_of_the_class_from_50_on() {
    for (percent, is_independent) in [(0, false), (25, false), (50, true), (75, true), (100, true)] {
        let worlds = worlds_at(percent, DrawingVersion::V2, Agents::Random, Split::Train);
        let boxes = boxes_of(&worlds, 0..6);
        let classes: Vec<&String> = boxes
            .iter()
            .map(|(class, ..)| class)
            .collect::<BTreeSet<_>>()
            .into_iter()
            .collect();
        assert_eq!(classes.len(), 9, "{classes:?}");
        let sides: [fn(&PixelBox) -> u32; 2] = [|area| area.width, |area| area.height];
        for side in sides {
            let by_class = |(class, _, area): &(String, usize, PixelBox)| {
                let class = classes.binary_search(&class).unwrap();
                (class, (side(area).clamp(72, 119) - 72) as usize / 8)
            };
            let by_facing = |(_, facing, area): &(String, usize, PixelBox)| {
                (*facing, (side(area).clamp(72, 119) - 72) as usize / 8)
            };
            let mut counts = [BTreeMap::new(), BTreeMap::new()];
            for one in &boxes {
                *counts[0].entry(by_class(one)).or_insert(0.0) += 1.0;
                *counts[1].entry(by_facing(one)).or_insert(0.0) += 1.0;
            }
            for counts in counts {
                let (statistic, freedom) = chi_square(&counts);
                // Four standard deviations.
                let most = freedom + 4.0 * (2.0 * freedom).sqrt();
                assert_eq!(
                    statistic < most,
                    is_independent,
                    "{percent}: {statistic} with {freedom}"
                );
            }
            if is_independent {
                assert!(boxes.iter().all(|(.., area)| (72..=120).contains(&side(area))));
            }
        }
    }
}

/// A box contains most of what changes a picture when its agent is drawn alone. That it contains the whole body is a
/// unit test of framings.
#[test]
fn boxes_contain_what_is_drawn() {
    for percent in [20, 50, 100] {
        let worlds = worlds_at(percent, DrawingVersion::V2, Agents::Fixed, Split::Test);
        let renderer = worlds.renderer(1);
        let frames = worlds.frames(1).unwrap();
        let (mut loose, mut checked, mut hidden) = (0, 0, 0);
        for frame in frames.iter().step_by(30) {
            let sprites = frame.sprites();
            let boxes = worlds.boxes(frame);
            assert_eq!(boxes, renderer.boxes(&sprites));
            hidden += worlds
                .visible(frame)
                .iter()
                .flatten()
                .filter(|fraction| **fraction < 1.0)
                .count();
            for (agent, area) in frame.agents.iter().zip(boxes) {
                let Some(area) = area else { continue };
                assert_eq!(area.clipped(SIDE, SIDE), Some(area));
                let alone = renderer.draw(&[agent.sprite("")]);
                let ground = renderer.ground();
                let inside = differs(&alone, ground, area)
                    .into_iter()
                    .filter(|changed| *changed)
                    .count();
                let around = PixelBox {
                    x: area.x - 60,
                    y: area.y - 60,
                    width: area.width + 120,
                    height: area.height + 120,
                };
                let around = around.clipped(SIDE, SIDE).unwrap();
                let all = differs(&alone, ground, around)
                    .into_iter()
                    .filter(|changed| *changed)
                    .count();
                // Shadows, skid marks and covers may extend beyond the box.
                assert!(
                    inside > 100 && 10 * inside > 6 * all,
                    "{percent}: {inside} of {all}: {agent:?}"
                );
                loose += usize::from(inside < (area.width * area.height) as usize / 2);
                checked += 1;
            }
        }
        assert!(checked > 30 && hidden > 0, "{checked} {hidden}");
        assert!(percent < 50 || 2 * loose > checked, "{loose} of {checked}");
    }
}

#[test]
fn every_world_has_its_own_ground_and_every_split_its_own_icons() {
    let worlds = worlds(Agents::Fixed, Split::Test);
    let grounds = [0, 1].map(|number| worlds.renderer(number).ground().clone());
    let whole = PixelBox {
        x: 0,
        y: 0,
        width: SIDE,
        height: SIDE,
    };
    let other = differs(&grounds[0], &grounds[1], whole);
    assert!(other.iter().filter(|other| **other).count() > 600_000);
    assert!(grounds[0] == *worlds.renderer(0).ground());
    let seeds = [0, 1].map(|seed| Split::ALL.map(|split| icon_seed(seed, split).0));
    assert_eq!(BTreeSet::from_iter(seeds.concat()).len(), 6);
    // Over the frames of a world, each agent shows many instances.
    let frames = worlds.frames(0).unwrap();
    for agent in 0..frames[0].agents.len() {
        let shown: BTreeSet<u32> = frames.iter().map(|frame| frame.agents[agent].instance).collect();
        assert!(
            shown.len() > 40 && shown.iter().all(|instance| *instance < 100),
            "{shown:?}"
        );
    }
}

#[test]
fn folders_without_a_data_set_are_reported() {
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

/// The figures of the published program, run again, in percent.
#[test]
fn slow_labels_are_as_frequent_as_in_the_published_program() {
    for (mode, published) in [
        (Mode::Hard, [29.2, 20.4, 4.6, 45.9]),
        (Mode::Easy, [21.7, 27.1, 0.0, 51.2]),
    ] {
        let city = LoadedCity::load(&mut Sources::new(), Path::new(mode.config()), None, &BuiltinFiles).unwrap();
        let icons = Arc::new(Icons::new(Seed(0), Difficulty::CLEAN));
        let worlds = Worlds::new(city.scenario, city.program, icons, Agents::Fixed, Split::Test, 0).unwrap();
        let threads = NonZeroUsize::new(2).unwrap();
        let counts = WorldCounts::of_worlds(&worlds, 0..100, threads, &|_, _| (), &Cancel::never()).unwrap();
        let found = Statistics::of(&counts);
        assert_eq!(found.labels, 100 * 89 * 8);
        for (share, published) in found.actions.into_iter().zip(published) {
            assert!((100.0 * share.value - published).abs() < 5.0, "{mode:?}: {found:?}");
        }
    }
}

#[test]
fn atoms_count_if_both_agents_stand_in_one_view() {
    let worlds = worlds(Agents::Fixed, Split::Test);
    let vocabulary = &worlds.world().vocabulary;
    for frame in worlds.frames(1).unwrap().iter().step_by(11) {
        let found = count_atoms(vocabulary, [&frame.facts]);
        let sees = &frame.facts.rows[vocabulary.sees];
        for (predicate, rows) in vocabulary.predicates.iter().zip(&frame.facts.rows) {
            let agents = 0..u32::try_from(frame.agents.len()).unwrap();
            let in_view = |[x, y]: [u32; 2]| agents.clone().any(|z| sees.contains(&[z, x]) && sees.contains(&[z, y]));
            let counted = rows.iter().filter(|&&row| predicate.arity == 1 || in_view(row));
            assert_eq!(found[&predicate.name], counted.count() as u64, "{}", predicate.name);
        }
    }
}

#[test]
fn statistics_equal_the_counts_of_a_data_set() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), &["--worlds", "3", "--seed", "5"]);
    let set: Value = serde_json::from_str(&stdout_of(&["check", folder.path().to_str().unwrap(), "--json"])).unwrap();
    let options = [
        "stats", "--mode", "hard", "--split", "test", "--worlds", "3", "--seed", "5",
    ];
    let found: Value = serde_json::from_str(&stdout_of(&[&options[..], &["--json"]].concat())).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    assert_eq!(found["labels"], 3 * 89 * 8);
    for (place, name) in ["Slow", "Normal", "Fast", "Stop"].into_iter().enumerate() {
        let share = number(&set["actions"][place]) / (3.0 * 89.0 * 8.0);
        assert!((number(&found["shares"][name]["value"]) - share).abs() < 1e-12);
        assert!(number(&found["shares"][name]["error"]) < 1.0);
    }
    for (name, count) in set["atoms"].as_object().unwrap() {
        assert!((number(&found["atoms_per_world"][name]["value"]) - number(count) / 3.0).abs() < 1e-9);
    }
    let printed = stdout_of(&options);
    assert!(
        printed.starts_with("worlds: 3, labels of cars: 2136; estimates with standard errors\n"),
        "{printed}"
    );
    assert!(
        printed.contains(" ± ") && printed.contains("published test 45.6 %"),
        "{printed}"
    );
}
