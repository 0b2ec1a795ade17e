//! The CPU time of the benches.

use std::fs;

/// Returns the CPU time of this process in user mode, of all threads. The clock has ticks of 10 ms.
pub fn seconds() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    let ticks = after
        .split_whitespace()
        .nth(11)
        .and_then(|field| field.parse::<f64>().ok());
    ticks.unwrap_or(f64::NAN) / 100.0
}
