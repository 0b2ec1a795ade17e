//! Input of any kind is used or refused, whatever bytes it is: what `tests/fuzz` asks of millions of inputs is asked here of the files
//! of the repository, of files like them, and of what was once found. (`tests/lang.rs` and `tests/config.rs` have hostile texts of
//! their own.)

mod any_input;

use proptest::prelude::*;
use proptest::sample::Index;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

/// The files of these folders and of those in them.
fn files(folders: &[&str]) -> Vec<Vec<u8>> {
    let mut folders: Vec<_> = folders
        .iter()
        .map(|folder| Path::new(env!("CARGO_MANIFEST_DIR")).join(folder))
        .collect();
    let mut paths = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a readable folder") {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() { &mut folders } else { &mut paths }.push(path);
        }
    }
    paths.sort();
    assert!(!paths.is_empty());
    paths
        .iter()
        .map(|path| fs::read(path).expect("a readable file"))
        .collect()
}

/// What the fuzzer begins with.
static RULES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| files(&["tests/corpus", "rules", "tests/fixtures/diagnostics"]));
static CONFIGS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["configs", "tests/fixtures/diagnostics"]));
static SCENES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["tests/fuzz/seeds/scene"]));
static ROWS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    vec![
        b"\0a\t1\t2\t1.5\tb\n\"\t-2\t0\tnan\t\n".to_vec(),
        b"\xc1s,n,u,f,t\n\"a\"\"\",1,2,3,\",\"\n".to_vec(),
    ]
});

/// One of the files with some bytes replaced, removed, doubled or put in, and some lines exchanged.
fn near(files: &'static LazyLock<Vec<Vec<u8>>>) -> impl Strategy<Value = Vec<u8>> {
    let edit = (any::<Index>(), any::<Index>(), 0..5u8, any::<u8>());
    (any::<Index>(), prop::collection::vec(edit, 0..8)).prop_map(|(file, edits)| {
        let mut bytes = file.get(files).clone();
        for (at, other, kind, byte) in edits {
            bytes.push(b'\n');
            let (at, other) = (at.index(bytes.len()), other.index(bytes.len()));
            match kind {
                0 => bytes[at] = byte,
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, bytes[other]),
                3 => bytes.insert(at, byte % 128),
                _ => {
                    let mut lines: Vec<&[u8]> = bytes.split(|byte| *byte == b'\n').collect();
                    let count = lines.len();
                    lines.swap(at % count, other % count);
                    bytes = lines.join(&b'\n');
                }
            }
        }
        bytes
    })
}

fn any_bytes() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..300)
}

#[test]
fn every_rule_file_is_used_or_refused() {
    for bytes in RULES.iter() {
        any_input::parse(bytes);
        any_input::check(bytes);
        any_input::query(bytes);
    }
}

proptest! {
    #[test]
    fn any_rules_are_parsed_or_refused(bytes in prop_oneof![4 => near(&RULES), 1 => any_bytes()]) {
        any_input::parse(&bytes);
    }

    #[test]
    fn any_rules_are_checked_or_refused(bytes in near(&RULES)) {
        any_input::check(&bytes);
    }

    #[test]
    fn any_rules_mean_what_they_mean_to_naive(bytes in near(&RULES)) {
        any_input::query(&bytes);
    }

    #[test]
    fn any_program_agrees_with_naive(bytes in prop::collection::vec(any::<u8>(), 0..1_000)) {
        any_input::evaluate(&bytes);
    }

    #[test]
    fn any_configuration_is_used_or_refused(bytes in prop_oneof![4 => near(&CONFIGS), 1 => any_bytes()]) {
        any_input::config(&bytes);
    }

    #[test]
    fn any_scene_is_answered_or_refused(bytes in prop_oneof![4 => near(&SCENES), 1 => any_bytes()]) {
        any_input::scene(&bytes);
    }

    #[test]
    fn any_rows_are_read_or_refused(bytes in prop_oneof![4 => near(&ROWS), 1 => any_bytes()]) {
        any_input::rows(&bytes);
    }
}

/// Found by fuzzing: more faults than are told.
#[test]
fn rows_with_more_faults_than_are_told_are_refused() {
    let bytes: Vec<u8> = std::iter::once(0)
        .chain(b"x\n".repeat(2 * logicity::diag::MAX_FAULTS))
        .collect();
    any_input::rows(&bytes);
}
