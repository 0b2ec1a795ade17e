//! The components of both crates form layers: a component imports only what the table in ARCHITECTURE.md allows.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

/// Components that do no input or output and read no clock, with all components inside them.
const PURE: &[&str] = &[
    "datalog",
    "config",
    "city",
    "predicate",
    "sim",
    "render",
    "page",
    "task",
    "yaml",
];

/// Crates that only these files may use.
const ONLY_IN: &[(&str, &str)] = &[
    ("annotate_snippets", "src/datalog/diag/render.rs"),
    ("batsat", "src/datalog/analysis/diff/sat.rs"),
    ("datafrog", "src/datalog/eval/recursion.rs"),
    ("egg", "src/datalog/plan/optimize/saturate.rs"),
    ("include_dir", "src/builtin.rs"),
    ("logicity_datalog", "src/files.rs"),
    ("parquet", "src/cli/query/tables.rs"),
    ("parquet", "src/task/induction/steps.rs"),
    ("parquet", "src/task/vap/table.rs"),
    ("rand_chacha", "src/datalog/analysis/diff/trial.rs"),
    ("rand_chacha", "src/rng.rs"),
    ("regex", "src/datalog/value.rs"),
    ("serde_yaml", "src/yaml/mistakes.rs"),
    ("serde_yaml", "src/yaml/tree.rs"),
];

/// Components that may contain paths of shipped files.
const PRODUCT_PATHS_IN: &[&str] = &["builtin", "cli"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// A source file.
struct Source {
    path: PathBuf,
    /// Its module, for example `["datalog", "check", "body"]`.
    module: Vec<String>,
    component: String,
    /// The text of the file, without comments and without the tests at its end.
    code: String,
}

/// The folder of the engine, which is a crate.
const ENGINE: &str = "datalog";

/// Modules of the engine that the simulator re-exports at its root.
const REEXPORTED: &[&str] = &["cancel", "diag", "symbol", "threads"];

/// All source files of both crates but the `lib.rs` and `main.rs` of the simulator and the examples of the engine.
fn sources() -> Vec<Source> {
    let levels = levels();
    let mut found = Vec::new();
    let mut folders = vec![root().join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if !path.ends_with("examples") {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let path = path.strip_prefix(root()).unwrap().to_owned();
                let parts = path.with_extension("");
                let mut module: Vec<String> = (parts.iter().skip(1))
                    .map(|part| part.to_str().unwrap().to_owned())
                    .collect();
                if ["lib", "main"].contains(&module[0].as_str()) {
                    continue;
                }
                module.pop_if(|last| last == "mod" || last == "lib");
                let text = fs::read_to_string(root().join(&path)).unwrap();
                let text = text.split("\n#[cfg(test)]\nmod ").next().unwrap();
                let text = text.split("\n#[cfg(test)]\npub(crate) mod ").next().unwrap();
                let code: Vec<&str> = (text.lines())
                    .filter(|line| !line.trim_start().starts_with("//"))
                    .collect();
                let component =
                    component(&levels, &module).unwrap_or_else(|| panic!("{} is in no component", path.display()));
                found.push(Source {
                    component,
                    code: code.join("\n"),
                    module,
                    path,
                });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    found
}

/// The component of a path from the root of the crate: its longest prefix in the table.
fn component(levels: &BTreeMap<String, u32>, path: &[String]) -> Option<String> {
    let beginnings = (1..=path.len()).rev().map(|length| path[..length].join("::"));
    beginnings.into_iter().find(|beginning| levels.contains_key(beginning))
}

/// The paths after `crate::` or `super::` in the code of a module, as if the engine were a module of the simulator.
/// Expands lists in braces.
fn imports(source: &Source) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for (at, start) in (source.code.match_indices("crate::")).chain(source.code.match_indices("super::")) {
        let before = source.code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':' || c == '$') {
            continue;
        }
        let mut rest = &source.code[at + start.len()..];
        // Macros are at the root of their crate.
        if rest
            .trim_start_matches(|c: char| c.is_alphanumeric() || c == '_')
            .starts_with('!')
        {
            continue;
        }
        let mut prefix = match start {
            "crate::" if source.module[0] == ENGINE => vec![ENGINE.to_owned()],
            "crate::" => Vec::new(),
            _ => source.module[..source.module.len() - 1].to_vec(),
        };
        while let Some(further) = rest.strip_prefix("super::") {
            prefix.pop();
            rest = further;
        }
        tree(rest, prefix, &mut found);
    }
    for path in &mut found {
        if REEXPORTED.contains(&path[0].as_str()) {
            path.insert(0, ENGINE.to_owned());
        }
    }
    found
}

/// Adds the leaves of a tree of paths. Returns the text after it.
fn tree<'a>(mut rest: &'a str, mut path: Vec<String>, found: &mut Vec<Vec<String>>) -> &'a str {
    loop {
        rest = rest.trim_start();
        if let Some(inside) = rest.strip_prefix('{') {
            rest = inside;
            loop {
                rest = rest.trim_start_matches(|c: char| c.is_whitespace() || c == ',');
                if let Some(after) = rest.strip_prefix('}') {
                    return after;
                }
                rest = tree(rest, path.clone(), found);
            }
        }
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '*'));
        let (word, after) = rest.split_at(end.unwrap_or(rest.len()));
        assert!(
            !word.is_empty(),
            "a path continues with a name: {}",
            &rest[..rest.len().min(60)]
        );
        path.push(word.to_owned());
        match after.strip_prefix("::") {
            // The arguments of a type are not part of a path.
            Some(next) if !next.starts_with('<') => rest = next,
            _ => {
                found.push(path);
                return after.trim_start_matches(|c: char| c == ' ' || c.is_alphanumeric() || c == '_');
            }
        }
    }
}

/// The level of each component, from the table in ARCHITECTURE.md.
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
    let levels = levels();
    let sources = sources();
    let components: BTreeSet<&String> = sources.iter().map(|source| &source.component).collect();
    assert!(
        levels.keys().eq(components),
        "the table has no row for a component without files"
    );
    let mut faults = Vec::new();
    for source in &sources {
        for import in imports(source) {
            let Some(other) = component(&levels, &import) else {
                continue;
            };
            if other != source.component && levels[&other] >= levels[&source.component] {
                faults.push(format!("{} imports {}", source.path.display(), import.join("::")));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn rooms_use_purposes_of_draws_of_their_own_and_of_lower_rooms() {
    let levels = levels();
    let sources = sources();
    let mut home: BTreeMap<&str, &str> = BTreeMap::new();
    for source in &sources {
        let lines = (source.code.lines()).filter_map(|line| line.trim().strip_prefix("pub const "));
        for (name, _) in lines.filter_map(|line| line.split_once(": Purpose = ")) {
            let former = home.insert(name, &source.component);
            assert_eq!(former, None, "Purpose::{name} is declared twice");
        }
    }
    assert!(home.len() > 10, "{home:?}");
    let mut faults = Vec::new();
    for source in &sources {
        for (at, found) in source.code.match_indices("Purpose::") {
            let rest = &source.code[at + found.len()..];
            let end = rest
                .find(|c: char| !(c.is_alphanumeric() || c == '_'))
                .unwrap_or(rest.len());
            let Some(component) = home.get(&rest[..end]) else {
                continue;
            };
            if *component != source.component && levels[*component] >= levels[&source.component] {
                faults.push(format!(
                    "{} uses Purpose::{} of {component}",
                    source.path.display(),
                    &rest[..end]
                ));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let mut numbers = BTreeSet::new();
    for source in &sources {
        for (at, found) in source.code.match_indices("Purpose = Purpose::new(") {
            let rest = &source.code[at + found.len()..];
            let number = &rest[..rest.find(')').unwrap()];
            assert!(
                numbers.insert(number.to_owned()),
                "two purposes have the number {number}"
            );
        }
    }
}

#[test]
fn only_top_rooms_contain_paths_of_shipped_files() {
    let mut faults = Vec::new();
    for source in sources() {
        let top = source.module[0].as_str();
        if !PRODUCT_PATHS_IN.contains(&top) {
            for (at, _) in (source.code.match_indices("\"rules/")).chain(source.code.match_indices("\"configs/")) {
                let literal = source.code[at + 1..].split('"').next().unwrap();
                if [".dl", ".yaml", ".jsonl"]
                    .iter()
                    .any(|ending| literal.ends_with(ending))
                {
                    faults.push(format!("{}: {literal}", source.path.display()));
                }
            }
            assert!(!source.code.contains("include_dir!"), "{}", source.path.display());
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn pure_rooms_use_no_files_and_no_clock() {
    let mut faults = Vec::new();
    for source in sources() {
        if PURE.contains(&source.module[0].as_str()) {
            let words = [
                "std::fs",
                "std::env",
                "std::net",
                "std::time::Instant",
                "SystemTime",
                "println!",
                "thread_rng",
            ];
            let used = words.iter().filter(|word| source.code.contains(**word));
            faults.extend(used.map(|word| format!("{}: {word}", source.path.display())));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn a_crate_with_one_purpose_is_used_only_there() {
    for (name, _) in ONLY_IN {
        let homes: BTreeSet<PathBuf> = (ONLY_IN.iter())
            .filter(|(known, _)| known == name)
            .map(|(_, home)| PathBuf::from(home))
            .collect();
        let users: BTreeSet<PathBuf> = (sources().into_iter())
            .filter(|source| source.code.contains(&format!("{name}::")))
            .map(|source| source.path)
            .collect();
        assert_eq!(users, homes, "{name}");
    }
}

/// A pool that does not notice a fork hangs in the forked process.
#[test]
fn only_one_file_starts_pools_of_threads() {
    let of_pools = ["ThreadPoolBuilder", "build_global", "rayon::spawn", "rayon::join"];
    let starts = |source: &Source| of_pools.iter().any(|name| source.code.contains(name));
    let files: Vec<PathBuf> = (sources().into_iter())
        .filter(starts)
        .map(|source| source.path)
        .collect();
    assert_eq!(files, [PathBuf::from("src/datalog/threads.rs")]);
}

/// Files in a cycle of imports cannot be understood one after the other. A file and the files in its folder count as
/// one.
#[test]
fn files_import_each_other_without_a_cycle() {
    let sources = sources();
    let modules: BTreeSet<&[String]> = sources.iter().map(|source| source.module.as_slice()).collect();
    let mut left: BTreeMap<&[String], BTreeSet<&[String]>> = BTreeMap::new();
    for source in &sources {
        let module = source.module.as_slice();
        let paths = imports(source);
        let named = paths.iter().filter_map(|path| {
            let mut beginnings = (1..=path.len()).rev().map(|length| &path[..length]);
            let found = beginnings.find(|beginning| modules.contains(beginning))?;
            modules.get(found).copied()
        });
        let others = named.filter(|other| !other.starts_with(module) && !module.starts_with(other));
        left.insert(module, others.collect());
    }
    assert!(left.values().map(BTreeSet::len).sum::<usize>() > 300, "{left:?}");
    // Remove files that import no other or that no other imports, until only cycles and the files between them remain.
    while let Some(free) = (left.keys().copied())
        .find(|&module| left[module].is_empty() || !left.values().any(|others| others.contains(module)))
    {
        left.remove(free);
        left.values_mut()
            .for_each(|others| others.retain(|&other| other != free));
    }
    let names = left.iter().map(|(module, others)| {
        let others: Vec<String> = others.iter().map(|other| other.join("::")).collect();
        format!("{} imports {}", module.join("::"), others.join(", "))
    });
    assert!(left.is_empty(), "{}", names.collect::<Vec<_>>().join("\n"));
}
