//! Shards of episodes, questions and data sets: joined, they are what one process makes, byte for byte.

use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_logicity"));
    program.args(arguments).current_dir(folder).output().unwrap()
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

fn fails(folder: &Path, arguments: &[&str], code: i32, words: &[&str]) {
    crate::cli::fails(&run(folder, arguments), code, words);
}

/// The content of a file, or of all files in a folder.
fn content(path: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    if path.is_file() {
        return BTreeMap::from([(PathBuf::new(), fs::read(path).unwrap())]);
    }
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(path).unwrap() {
        let path = entry.unwrap().path();
        let name = PathBuf::from(path.file_name().unwrap());
        found.extend(
            content(&path)
                .into_iter()
                .map(|(inner, bytes)| (name.join(inner), bytes)),
        );
    }
    found
}

/// Makes the shards `NAME-1`, `NAME-2`, ... in a folder.
fn make_shards(folder: &Path, command: &[&str], name: &str, of: usize) -> Vec<String> {
    let make = |number: usize| {
        let (output, shard) = (format!("{name}-{number}"), format!("{number}/{of}"));
        succeeds(folder, &[command, &["--shard", &shard, "--out", &output][..]].concat());
        output
    };
    (1..=of).map(make).collect()
}

/// Joins shards in reverse order.
fn merge(folder: &Path, shards: &[String], output: &str) -> String {
    let shards = shards.iter().rev().map(String::as_str);
    let arguments: Vec<&str> = ["merge"]
        .into_iter()
        .chain(shards)
        .chain(["--output", output])
        .collect();
    succeeds(folder, &arguments)
}

#[test]
fn joined_shards_equal_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let episodes = ["episodes", "make", "hard", "--count", "9", "--seed", "3"];
    let questions = ["questions", "--count", "24", "--seed", "2"];
    let concepts = [
        "questions",
        "--count",
        "16",
        "--mix",
        "by-concept",
        "--about",
        "tiro,bus",
    ];
    let pictures = ["questions", "vap-easy", "--count", "3", "--style", "picture"];
    let tables = [
        "vap",
        "make",
        "--mode",
        "easy",
        "--split",
        "test",
        "--worlds",
        "3",
        "--no-pictures",
    ];
    let cases: [(&str, &[&str], &[usize]); 5] = [
        ("episodes", &episodes, &[1, 2, 5]),
        ("questions", &questions, &[2, 7]),
        ("concepts", &concepts, &[3]),
        ("pictures", &pictures, &[2]),
        ("tables", &tables, &[2, 4]),
    ];
    for (name, command, numbers) in cases {
        let option = if name == "tables" { "--out" } else { "--output" };
        // The files of pictures have names that end with that of the set.
        fs::create_dir(folder.join(name)).unwrap();
        let whole = format!("{name}/set.jsonl");
        succeeds(folder, &[command, &[option, &whole][..]].concat());
        for of in numbers {
            let shards = match name {
                "tables" => make_shards(folder, command, &format!("{name}-{of}"), *of),
                _ => {
                    let make = |number: usize| {
                        let (output, shard) = (format!("{name}-{of}-{number}"), format!("{number}/{of}"));
                        succeeds(
                            folder,
                            &[command, &["--shard", &shard, "--output", &output][..]].concat(),
                        );
                        output
                    };
                    (1..=*of).map(make).collect()
                }
            };
            let joined = folder.join(format!("{name}-{of}-joined"));
            fs::create_dir(&joined).unwrap();
            merge(folder, &shards, joined.join("set.jsonl").to_str().unwrap());
            let plain = |path: &Path| {
                let mut found = content(path);
                // The record of which command wrote a file.
                found.retain(|path, _| !path.ends_with(".logicity.json"));
                found
            };
            let (found, expected) = (plain(&joined), plain(&folder.join(name)));
            assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
            assert!(found == expected, "{name}, {of} shards");
        }
    }
}

#[test]
fn only_complete_and_unchanged_shards_are_joined() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let make = |name: &str, shard: &str, more: &[&str]| {
        let command = [
            "episodes", "make", "easy", "--count", "2", "--shard", shard, "--output", name,
        ];
        succeeds(folder, &[&command[..], more].concat());
    };
    make("one", "1/2", &[]);
    make("two", "2/2", &[]);
    make("other", "2/2", &["--seed", "1"]);
    let refused = |shards: &[&str], words: &[&str]| {
        fails(
            folder,
            &[&["merge"][..], shards, &["--output", "whole"]].concat(),
            1,
            words,
        );
        assert!(!folder.join("whole").exists());
    };
    refused(&["one"], &["error[invalid-shard]: shard 2/2 is missing"]);
    refused(&["one", "one", "two"], &["`one` and `one` are both shard 1/2"]);
    refused(&["one", "other"], &["`other` and `one` are of different data sets"]);
    let [first, text] = ["one", "two"].map(|name| fs::read_to_string(folder.join(name)).unwrap());
    fs::write(folder.join("cut"), &text[..text.len() - 9]).unwrap();
    refused(&["one", "cut"], &["truncated or modified", "cut:1:1"]);
    fs::write(folder.join("none"), "").unwrap();
    refused(&["one", "none"], &["not the first line of a shard", "none:1:1"]);
    fs::write(folder.join("later"), text.replacen("\"version\":1", "\"version\":2", 1)).unwrap();
    refused(&["one", "later"], &["version 2; this program reads version 1"]);
    fs::write(
        folder.join("fewer"),
        text.replacen("\"searched\":", "\"searched\":1", 1),
    )
    .unwrap();
    refused(&["one", "fewer"], &["truncated or modified", "fewer:1:1"]);
    fs::write(folder.join("many"), forged(&text, "\"of\":2", "\"of\":4000000000")).unwrap();
    refused(&["many"], &["`many` claims to be shard 2/4000000000"]);
    let episodes = ["episodes", "make", "easy", "--count", "2", "--output", "set"];
    succeeds(folder, &episodes);
    refused(&["set"], &["missing field `shard_of`"]);
    fails(
        folder,
        &["merge", "missing", "--output", "whole"],
        2,
        &["cannot read `missing`"],
    );
    fails(
        folder,
        &["merge", "one", "two", "--output", "one"],
        2,
        &["this command reads it"],
    );
    // A line with a right hash that does not fit the city.
    fs::write(
        folder.join("huge"),
        forged(&text, "\"count\":2", "\"count\":18446744073709551615"),
    )
    .unwrap();
    fs::write(
        folder.join("huge-too"),
        forged(&first, "\"count\":2", "\"count\":18446744073709551615"),
    )
    .unwrap();
    refused(
        &["huge", "huge-too"],
        &["has 18446744073709551615 episodes, not 1 to 100000"],
    );
    fs::write(folder.join("forged"), forged(&text, "\"Car_1\"", "\"Car_7\"")).unwrap();
    refused(&["one", "forged"], &["error[invalid-episode]", "forged:2:1"]);
}

/// Returns the text of a shard after a change, with the right hash.
fn forged(text: &str, from: &str, to: &str) -> String {
    let text = text.replace(from, to);
    let (head, body) = text.split_once('\n').unwrap();
    let hash = head.split("\"sha256\":\"").nth(1).unwrap().trim_end_matches("\"}");
    let without = head.replace(hash, "");
    head.replace(hash, &format!("{:x}", Sha256::digest(format!("{without}\n{body}")))) + "\n" + body
}

#[test]
fn worlds_are_checked_as_they_are_joined() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let command = [
        "vap",
        "make",
        "--mode",
        "easy",
        "--split",
        "test",
        "--worlds",
        "2",
        "--no-pictures",
    ];
    let shards = make_shards(folder, &command, "shard", 2);
    let merge = |out: &'static str| ["merge", "shard-1", "shard-2", "--output", out];
    fails(
        folder,
        &["merge", "shard-2", "--output", "whole"],
        1,
        &["shard 1/2 is missing"],
    );
    assert!(!folder.join("whole").exists());
    // A shard stays one, and a data set that is none does not become one.
    let continued = |more: &[&str], words: &[&str]| {
        let arguments = [&command[..], &["--out", "shard-1"], more].concat();
        fails(folder, &arguments, 2, words);
    };
    continued(&[], &["the folder has shard 1/2 of 2 worlds"]);
    continued(&["--shard", "2/2"], &["the folder has shard 1/2 of 2 worlds"]);
    succeeds(
        folder,
        &[&command[..], &["--shard", "1/2", "--out", "shard-1"]].concat(),
    );
    let table = folder.join("shard-2/world-00001/pairs.parquet");
    let bytes = fs::read(&table).unwrap();
    fs::write(&table, &bytes[..bytes.len() - 1]).unwrap();
    fails(
        folder,
        &merge("whole"),
        1,
        &["invalid-data-set", "pairs.parquet", "has changed since it was made"],
    );
    // The interrupted command is resumed.
    fs::write(&table, bytes).unwrap();
    let said = succeeds(folder, &merge("whole"));
    assert!(said.contains("worlds copied: 1, in whole: 2"), "{said}");
    fails(
        folder,
        &[&command[..], &["--out", "whole", "--shard", "1/2"]].concat(),
        2,
        &["the folder has a data set that is not this shard"],
    );
    succeeds(folder, &["vap", "check", "whole"]);
    fs::remove_file(folder.join("shard-1/shard.json")).unwrap();
    fails(folder, &merge("again"), 1, &["is not a shard of a data set"]);
    assert_eq!(shards, ["shard-1", "shard-2"]);
}

#[test]
fn shards_fail_as_their_fixture_expects() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let fixture = "tests/fixtures/diagnostics/invalid-shard.jsonl";
    let words = [
        "error[invalid-shard]: not the first line of a shard",
        "invalid-shard.jsonl:1:",
    ];
    fails(root, &["merge", fixture, "--output", "/tmp/never-written"], 1, &words);
    for value in ["0/2", "3/2", "1", "1/x"] {
        fails(
            root,
            &["questions", "--shard", value, "--output", "x"],
            2,
            &["expected I/N, such as 1/4"],
        );
    }
    fails(
        root,
        &["questions", "--shard", "1/2"],
        2,
        &["name a file for the shard with `--output`"],
    );
    fails(
        root,
        &["episodes", "make", "easy", "--shard", "1/2"],
        2,
        &["`--shard` needs `--output FILE`"],
    );
}
