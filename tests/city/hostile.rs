//! Configurations, scenes and rules of any kind are used or refused, whatever bytes they are. (`config` has hostile texts of its own.)

use crate::any_input;
use crate::near_files::{any_bytes, files, near};
use proptest::prelude::*;
use std::sync::LazyLock;

/// What the fuzzer begins with.
static RULES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| files(&["tests/corpus", "rules", "tests/fixtures/diagnostics"]));
static CONFIGS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["configs", "tests/fixtures/diagnostics"]));
static SCENES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| files(&["tests/fuzz/seeds/scene"]));

#[test]
fn conflicts_of_every_rule_file_are_found() {
    for bytes in RULES.iter() {
        any_input::conflicts(bytes);
    }
}

proptest! {
    #[test]
    fn conflicts_of_any_rules_are_found(bytes in near(&RULES)) {
        any_input::conflicts(&bytes);
    }

    #[test]
    fn any_configuration_is_used_or_refused(bytes in prop_oneof![4 => near(&CONFIGS), 1 => any_bytes()]) {
        any_input::config(&bytes);
    }

    #[test]
    fn any_scene_is_answered_or_refused(bytes in prop_oneof![4 => near(&SCENES), 1 => any_bytes()]) {
        any_input::scene(&bytes);
    }
}
