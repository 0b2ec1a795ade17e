//! The rule language: rule files, fixtures, reference, round trip, hostile texts.

use std::path::Path;

use logicity::diag::{Sources, render};
use logicity::files::{ReadError, read_text};
use logicity::lang::{BUILTIN, Loaded, Rules, load};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Reads files; under [`BUILTIN`] those of `rules/`.
fn read(path: &Path) -> Result<String, ReadError> {
    match path.strip_prefix(BUILTIN) {
        Ok(name) => read_text(&root().join("rules").join(name)),
        Err(_) => read_text(path),
    }
}

fn load_text(name: &str, text: &str) -> (Sources, Loaded) {
    let mut sources = Sources::new();
    let entry = sources.add(name, text);
    let loaded = load(&mut sources, entry, &read);
    (sources, loaded)
}

/// The rules of a text that must have no fault at all.
fn load_clean(name: &str, text: &str) -> Rules {
    let (sources, loaded) = load_text(name, text);
    assert!(
        loaded.diagnostics.is_empty(),
        "{}",
        render(&loaded.diagnostics, &sources, false)
    );
    loaded.rules.expect("no diagnostic, so there are rules")
}

fn load_rule_file(name: &str) -> Rules {
    let path = root().join("rules").join(name);
    load_clean(
        &path.display().to_string(),
        &read_text(&path).expect("the file is there"),
    )
}

fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    (rules.strata.iter())
        .map(|stratum| {
            stratum
                .relations
                .iter()
                .map(|id| rules.relations[id.index()].name.as_str())
                .collect()
        })
        .collect()
}

#[test]
fn all_rule_files_load_without_a_diagnostic() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("rules")).expect("rules/ is there") {
        let name = entry
            .expect("a readable folder")
            .file_name()
            .into_string()
            .expect("UTF-8");
        if name.ends_with(".dl") {
            load_rule_file(&name);
            count += 1;
        }
    }
    assert_eq!(count, 10);
}

#[test]
fn stopping_comes_before_slowing_before_speeding() {
    assert_eq!(
        strata(&load_rule_file("expert.dl")),
        [["Stop"], ["Slow"], ["Fast"], ["Normal"]]
    );
    assert_eq!(strata(&load_rule_file("easy.dl")), [["Stop"], ["Normal"]]);
}
