//! Any bytes are valid input or give diagnostics: configurations, scenes, examples and rules. `config` tests further hostile
//! texts.

use crate::any_input;
use crate::cases::cases;
use crate::near_files::{any_bytes, files, near};
use proptest::prelude::*;
use std::sync::LazyLock;

/// The seeds of the fuzzer.
static RULES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| files(&["tests/corpus", "rules", "tests/fixtures/diagnostics"]));
static CONFIGS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["configs", "tests/fixtures/diagnostics"]));
static LABELED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["tests/fuzz/seeds/labeled_scenes"]));
static SCENES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["tests/fuzz/seeds/scene"]));

/// The tasks of the fixtures, as `any_input::popper` reads them.
static TASKS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let files = files(&["tests/fixtures/popper"]);
    let task = |files: &[Vec<u8>]| {
        // In order of their names, the bias comes first.
        let [bias, background, examples] = files else {
            panic!("a task has three files");
        };
        [background.as_slice(), examples, bias].join(&1)
    };
    files.chunks(3).map(task).collect()
});

#[test]
fn conflicts_of_every_rule_file_are_found() {
    for bytes in RULES.iter() {
        any_input::conflicts(bytes);
    }
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn conflicts_of_any_rules_are_found(bytes in near(&RULES)) {
        any_input::conflicts(&bytes);
    }

    #[test]
    fn any_configuration_loads_or_gives_diagnostics(bytes in prop_oneof![4 => near(&CONFIGS), 1 => any_bytes()]) {
        any_input::config(&bytes);
    }

    #[test]
    fn any_labeled_scenes_teach_rules(bytes in prop_oneof![4 => near(&LABELED), 1 => any_bytes()]) {
        any_input::labeled_scenes(&bytes);
    }

    #[test]
    fn any_task_of_popper_is_learned_or_gives_diagnostics(bytes in prop_oneof![4 => near(&TASKS), 1 => any_bytes()]) {
        any_input::popper(&bytes);
    }

    #[test]
    fn any_scene_gets_an_answer_or_diagnostics(bytes in prop_oneof![4 => near(&SCENES), 1 => any_bytes()]) {
        any_input::scene(&bytes);
    }
}
