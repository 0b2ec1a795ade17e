//! CPU time and memory of the benches.

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

/// Returns the largest resident memory of this process so far, in GiB.
#[allow(dead_code, reason = "not every bench prints memory")]
pub fn peak_gib() -> f64 {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / f64::from(1 << 20)
}
