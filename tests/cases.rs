//! The number of random cases of a property, for unit tests and for the tests in `tests`.

use proptest::prelude::ProptestConfig;
use std::env;

/// The value of `LOGICITY_RANDOM_CASES` with which every property has its full number of cases.
const USUAL: u64 = 256;

/// Returns the configuration of a property with a number of cases that the environment variable
/// `LOGICITY_RANDOM_CASES` scales: with twice the usual value, every property has twice as many. Proptest's own
/// `PROPTEST_CASES` gives every property the same number, which takes hours where a case is slow.
pub fn cases(full: u32) -> ProptestConfig {
    ProptestConfig::with_cases(scaled(full, env::var("LOGICITY_RANDOM_CASES").ok().as_deref()))
}

fn scaled(full: u32, variable: Option<&str>) -> u32 {
    let Some(variable) = variable else { return full };
    let given: u64 = variable.parse().expect("LOGICITY_RANDOM_CASES is a number");
    u32::try_from(u64::from(full) * given / USUAL)
        .unwrap_or(u32::MAX)
        .max(1)
}

#[test]
fn the_environment_scales_the_number_of_cases() {
    assert_eq!(scaled(96, None), 96);
    assert_eq!(scaled(96, Some("256")), 96);
    assert_eq!(scaled(96, Some("32")), 12);
    assert_eq!(scaled(96, Some("2560")), 960);
    assert_eq!(scaled(96, Some("1")), 1);
    assert_eq!(scaled(u32::MAX, Some("1000")), u32::MAX);
}
