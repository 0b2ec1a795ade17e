//! The rooms of the library form layers: a room imports only what the table in ARCHITECTURE.md allows.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Rooms that do no input or output of their own and read no clock.
const PURE: &[&str] = &["lang", "config", "engine", "city", "sim", "render", "page", "task"];

/// Crates that only one room may use.
const ONLY_IN: &[(&str, &str)] = &[
    ("datafrog", "src/engine/recursion.rs"),
    ("egg", "src/engine/optimize/saturate.rs"),
    ("batsat", "src/engine/diff/sat.rs"),
    ("serde_yaml", "src/config/yaml.rs"),
    ("parquet", "src/task/vap/table.rs"),
    ("rand_chacha", "src/rng.rs"),
    ("regex", "src/lang/functor.rs"),
    ("annotate_snippets", "src/diag/render.rs"),
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Every source file with its room and its code: comments and the tests at its end left out.
fn files() -> Vec<(PathBuf, String, String)> {
    let mut found = Vec::new();
    let mut folders = vec![root().join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let inside = path.strip_prefix(root()).unwrap().to_owned();
                let room = inside.iter().nth(1).unwrap().to_str().unwrap().trim_end_matches(".rs");
                let text = fs::read_to_string(&path).unwrap();
                let text = text.split("#[cfg(test)]").next().unwrap();
                let code: Vec<&str> = text
                    .lines()
                    .filter(|line| !line.trim_start().starts_with("//"))
                    .collect();
                found.push((inside.clone(), room.to_owned(), code.join("\n")));
            }
        }
    }
    found.sort();
    found
}

/// The rooms that code names after `crate::`, alone or in braces.
fn imports(code: &str) -> BTreeSet<String> {
    let word = |text: &str| -> String { text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect() };
    let mut rooms = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if let Some(list) = rest.strip_prefix('{') {
            let list = list.split(';').next().unwrap();
            rooms.extend(list.split(',').map(|item| word(item.trim())));
        } else {
            rooms.insert(word(rest));
        }
    }
    rooms
}

/// The level of each room, from the table in ARCHITECTURE.md.
fn levels() -> BTreeMap<String, u32> {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let row = |line: &str| {
        let mut columns = line.strip_prefix("| ")?.split(" | ");
        let level = columns.next()?.parse().ok()?;
        Some((columns.next()?.trim_matches('`').to_owned(), level))
    };
    text.lines().filter_map(row).collect()
}

#[test]
fn rooms_import_only_lower_rooms() {
    let level = levels();
    let rooms: BTreeSet<String> = files().into_iter().map(|(_, room, _)| room).collect();
    let expected = rooms.iter().filter(|room| !["lib", "main"].contains(&room.as_str()));
    assert!(
        level.keys().eq(expected),
        "the table has a row for each room: {level:?}"
    );
    let mut faults = Vec::new();
    for (path, room, code) in files() {
        if room == "lib" || room == "main" {
            continue;
        }
        for import in imports(&code) {
            let Some(&other) = level.get(&import) else {
                continue;
            };
            let allowed = import == room || other < level[&room];
            if !allowed {
                faults.push(format!("{} imports {import}", path.display()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn pure_rooms_touch_no_files_and_no_clock() {
    let mut faults = Vec::new();
    for (path, room, code) in files() {
        if PURE.contains(&room.as_str()) {
            let words = [
                "std::fs",
                "std::env",
                "std::net",
                "std::time::Instant",
                "SystemTime",
                "println!",
                "thread_rng",
            ];
            faults.extend(
                words
                    .iter()
                    .filter(|word| code.contains(*word))
                    .map(|word| format!("{}: {word}", path.display())),
            );
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn a_crate_with_one_purpose_is_used_in_one_place() {
    for (name, home) in ONLY_IN {
        let users: Vec<PathBuf> = files()
            .into_iter()
            .filter(|(_, _, code)| code.contains(&format!("{name}::")))
            .map(|(path, _, _)| path)
            .collect();
        assert_eq!(users, [Path::new(home)], "{name}");
    }
}
