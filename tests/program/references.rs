//! What documents and comments refer to exists: files, targets of the Makefile, tests, and listed addresses of other
//! sites.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use regex::Regex;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The texts of the repository with their paths: documents, code and settings, without what is built or recorded.
fn texts() -> Vec<(String, String)> {
    const SKIPPED: &[&str] = &[
        "target",
        "node_modules",
        "recorded",
        "fixtures",
        "proptest-regressions",
        "snapshots",
    ];
    const READ: &[&str] = &["md", "rs", "py", "toml", "yml", "yaml", "dl", "cff", "js", "html"];
    let mut found = Vec::new();
    let mut folders = vec![root()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            // `.git` and virtual environments.
            let hidden = name.starts_with('.') && name != ".github";
            if path.is_dir() {
                if !hidden && !SKIPPED.contains(&name.as_str()) {
                    folders.push(path);
                }
            } else if name == "Makefile" || path.extension().is_some_and(|end| READ.iter().any(|read| end == *read)) {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(root()).unwrap().display().to_string(), text));
            }
        }
    }
    found.sort();
    assert!(found.len() > 500);
    found
}

fn is_document(path: &str) -> bool {
    path.ends_with(".md")
}

#[test]
fn named_files_exist() {
    let folders = "src|tests|docs|python|benches|configs|rules|editors|examples|results|\\.github";
    let path = Regex::new(&format!("`((?:{folders})/[^\\s`*<>{{}}$,;:)(#]*)(?:#[a-z0-9]+)?`")).unwrap();
    // Documents at the root have names in upper case.
    let document = Regex::new(r"\b((?:docs/)?[A-Za-z0-9_/-]+\.md)\b").unwrap();
    let link = Regex::new(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)").unwrap();
    let mut missing = Vec::new();
    let mut seen = 0;
    for (file, text) in texts() {
        let folder = Path::new(&file).parent().unwrap();
        let mut check = |name: &str| {
            seen += 1;
            // Names with a part in upper case stand for others: `results/EXPERIMENT.json`.
            let stands_for_others = name
                .split(['/', '.'])
                .any(|part| part.len() > 3 && part == part.to_uppercase());
            let is_document = name.ends_with(".md");
            if !(root().join(name).exists() || root().join(folder).join(name).exists())
                && (is_document || !stands_for_others)
            {
                missing.push(format!("{file}: {name}"));
            }
        };
        // Tests name files that must not exist.
        let is_test = file.starts_with("tests/") || file.starts_with("python/tests/");
        if !is_test {
            path.captures_iter(&text).for_each(|found| check(&found[1]));
        }
        if is_document(&file) {
            link.captures_iter(&text).for_each(|found| check(&found[1]));
        } else if file.ends_with(".toml") || file.ends_with("Makefile") || file.ends_with(".yml") {
            let comments = text
                .lines()
                .filter_map(|line| line.split_once('#'))
                .map(|(_, comment)| comment);
            comments.for_each(|comment| document.captures_iter(comment).for_each(|found| check(&found[1])));
        }
    }
    assert!(seen > 300, "{seen}");
    assert_eq!(missing, [""; 0]);
}

/// Each tutorial ends with a link to the next one of its track, the last one with links out of it.
#[test]
fn tutorials_end_where_the_next_one_begins() {
    let folder = root().join("docs/tutorials");
    let index = fs::read_to_string(folder.join("index.md")).unwrap();
    let track = Regex::new(r"(?s)```\{toctree\}\n:hidden:\n:caption: ([^\n]+)\n\n(.*?)\n```").unwrap();
    let tracks: Vec<Vec<&str>> = track
        .captures_iter(&index)
        .map(|found| found.get(2).unwrap().as_str().lines().collect())
        .collect();
    assert_eq!(tracks.len(), 4, "{tracks:?}");
    for pages in tracks {
        for (at, page) in pages.iter().enumerate() {
            let text = fs::read_to_string(folder.join(format!("{page}.md"))).unwrap();
            let (_, end) = text
                .rsplit_once("\n## Next\n")
                .unwrap_or_else(|| panic!("{page} has no end"));
            match pages.get(at + 1) {
                Some(next) => assert!(end.contains(&format!("({next}.md)")), "{page} does not lead to {next}"),
                None => assert!(end.contains("](../"), "{page} leads nowhere"),
            }
        }
    }
}

/// A manifest that gives a reason in another file names one that mentions the subject.
#[test]
fn reasons_stand_where_manifests_say() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let reason = Regex::new(r#"(?m)^#.*the reasons are in ([^\s#]+)\S*\n([a-z_]+) = \{ package = "([^"]+)""#).unwrap();
    let found: Vec<_> = reason.captures_iter(&manifest).collect();
    assert!(!found.is_empty());
    for found in found {
        let text = fs::read_to_string(root().join(&found[1])).unwrap();
        assert!(text.contains(&found[3]), "{} does not mention {}", &found[1], &found[3]);
    }
}

/// Each decision is one section, whose anchor has its number, with a date and a status. Comments and links name
/// decisions that exist, on the page where they are.
#[test]
fn cited_decisions_exist() {
    let section = Regex::new(
        r"(?m)^\(d(\d{3})\)=\n## (\d{3})\. \S.*\n\n\d{4}-\d\d-\d\d, (?:accepted|rejected|(?:in part )?superseded by \[)",
    )
    .unwrap();
    let heading = Regex::new(r"(?m)^## \d").unwrap();
    let texts = texts();
    let pages = (texts.iter()).filter_map(|(file, text)| Some((file.strip_prefix("docs/decisions/")?, text)));
    let mut decisions = BTreeSet::new();
    let mut numbers = BTreeSet::new();
    for (page, text) in pages.clone() {
        let sections: Vec<_> = section.captures_iter(text).collect();
        assert_eq!(
            heading.find_iter(text).count(),
            sections.len(),
            "{page}: a section lacks a part"
        );
        for found in sections {
            assert_eq!(found[1], found[2], "{page}");
            assert!(numbers.insert(found[1].to_owned()), "two decisions {}", &found[1]);
            decisions.insert(format!("{page}#d{}", &found[1]));
        }
    }
    assert!(numbers.len() >= 71, "{numbers:?}");

    let cited = Regex::new(r"decisions/([a-z]+\.md#d\d+)").unwrap();
    for (file, text) in &texts {
        for found in cited.captures_iter(text) {
            assert!(decisions.contains(&found[1]), "{file}: no decision {}", &found[1]);
        }
    }
    let link = Regex::new(r"\]\(([a-z]+\.md)?(#d\d+)\)").unwrap();
    for (page, text) in pages {
        for found in link.captures_iter(text) {
            let target = format!("{}{}", found.get(1).map_or(page, |page| page.as_str()), &found[2]);
            assert!(decisions.contains(&target), "{page}: no decision {target}");
        }
    }
}

#[test]
fn named_targets_of_the_makefile_exist() {
    let makefile = fs::read_to_string(root().join("Makefile")).unwrap();
    let rule = Regex::new(r"(?m)^([a-z][a-z -]*):(?:[^=]|$)").unwrap();
    let targets: BTreeSet<&str> = rule
        .captures_iter(&makefile)
        .flat_map(|rule| rule.get(1).unwrap().as_str().split(' '))
        .collect();
    assert!(targets.contains("test") && targets.contains("links"));
    let named = Regex::new(r"(?m)(?:`|^)make ((?:[a-z][a-z-]*)(?: [a-z][a-z-]*)*)(?:`| [A-Z]| *#|$)").unwrap();
    let mut seen = 0;
    for (file, text) in texts().iter().filter(|(file, _)| is_document(file)) {
        for found in named.captures_iter(text) {
            for name in found[1].split(' ') {
                seen += 1;
                assert!(targets.contains(name), "{file}: the Makefile has no target `{name}`");
            }
        }
    }
    assert!(seen > 15, "{seen}");
}

#[test]
fn named_tests_exist() {
    let command = Regex::new(r"cargo test[^\n`]*--test ([a-z_]+)(?: ([a-z_]+))?").unwrap();
    let mut seen = 0;
    let texts = texts();
    for (file, text) in texts.iter().filter(|(file, _)| is_document(file)) {
        for found in command.captures_iter(text) {
            let folder = format!("tests/{}/", &found[1]);
            assert!(root().join(&folder).join("main.rs").is_file(), "{file}: {}", &found[0]);
            let Some(name) = found.get(2).map(|name| name.as_str()) else {
                continue;
            };
            seen += 1;
            let function = Regex::new(&format!("(?:fn|mod) [a-z_]*{name}")).unwrap();
            let mut parts = texts.iter().filter(|(part, _)| part.starts_with(&folder));
            assert!(parts.any(|(_, text)| function.is_match(text)), "{file}: {}", &found[0]);
        }
    }
    assert!(seen >= 4, "{seen}");
}

/// All texts name the variable of `tests/cases.rs` where they speak of the number of random cases.
#[test]
fn one_variable_scales_random_cases() {
    for (file, text) in texts() {
        let other = concat!("PROPTEST", "_CASES");
        assert!(
            !text.contains(other) || file == "tests/cases.rs",
            "{file} names {other}"
        );
    }
}

/// `make links` checks the list against the network; no other target reads it.
#[test]
fn addresses_of_other_sites_are_listed() {
    let list = fs::read_to_string(root().join("docs/external-links.txt")).unwrap();
    let listed: Vec<&str> = list.lines().filter(|line| !line.starts_with('#')).collect();
    assert!(listed.is_sorted(), "the list is sorted");
    let address = Regex::new(r#"https?://[^\s)>`"'\]\\]+"#).unwrap();
    // Servers on this machine, the repository before its release, and names of XML and JSON formats.
    let is_site = |address: &&str| !address.contains("//localhost") && !address.contains("/OWNER/");
    let texts = texts();
    let found: BTreeSet<&str> = texts
        .iter()
        .filter(|(file, _)| is_document(file) || file == "CITATION.cff" || file == "Cargo.toml")
        .flat_map(|(_, text)| address.find_iter(text))
        .map(|found| found.as_str().trim_end_matches(['.', ',', ';']))
        .filter(is_site)
        .collect();
    assert_eq!(found.into_iter().collect::<Vec<_>>(), listed);
}
