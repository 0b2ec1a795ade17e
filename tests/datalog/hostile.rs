//! Any bytes are valid input or give diagnostics: rules, programs and rows. This is what `tests/fuzz` checks on
//! millions of inputs. Here the inputs are the files of the repository, variants of them, and past failures. `lang`
//! tests further hostile texts.

use crate::any_input;
use crate::cases::cases;
use crate::near_files::{any_bytes, files, near};
use proptest::prelude::*;
use std::sync::LazyLock;

/// The seeds of the fuzzer.
static RULES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| files(&["tests/corpus", "rules", "tests/fixtures/diagnostics"]));
static ROWS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    vec![
        b"\0a\t1\t2\t1.5\tb\n\"\t-2\t0\tnan\t\n".to_vec(),
        b"\xc1s,n,u,f,t\n\"a\"\"\",1,2,3,\",\"\n".to_vec(),
    ]
});

#[test]
fn every_rule_file_evaluates_or_gives_diagnostics() {
    for bytes in RULES.iter() {
        any_input::parse(bytes);
        any_input::check(bytes);
        any_input::query(bytes);
    }
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn any_rules_parse_or_give_diagnostics(bytes in prop_oneof![4 => near(&RULES), 1 => any_bytes()]) {
        any_input::parse(&bytes);
    }

    #[test]
    fn any_rules_pass_the_checker_or_give_diagnostics(bytes in near(&RULES)) {
        any_input::check(&bytes);
    }

    #[test]
    fn any_rules_agree_with_naive(bytes in near(&RULES)) {
        any_input::query(&bytes);
    }

    #[test]
    fn any_program_agrees_with_naive(bytes in prop::collection::vec(any::<u8>(), 0..1_000)) {
        any_input::evaluate(&bytes);
    }

    #[test]
    fn any_rows_load_or_give_diagnostics(bytes in prop_oneof![4 => near(&ROWS), 1 => any_bytes()]) {
        any_input::rows(&bytes);
    }
}

/// Found by fuzzing: more faults than are reported.
#[test]
fn rows_with_more_faults_than_the_limit_give_diagnostics() {
    let bytes: Vec<u8> = std::iter::once(0)
        .chain(b"x\n".repeat(2 * logicity_datalog::diag::MAX_FAULTS))
        .collect();
    any_input::rows(&bytes);
}
