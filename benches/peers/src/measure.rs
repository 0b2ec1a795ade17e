//! Measures one run of a peer: its counts, CPU time and peak memory. Each run is a separate process.

use crate::case::Case;
use crate::peer::Peer;
#[cfg(feature = "others")]
use crate::{ascent, crepe, differential};
use crate::{datafrog, engine};
use cpu_time::ProcessTime;
use std::io::Read;
use std::path::Path;
use std::time::Duration;
use wait4::Wait4;

/// The measurement of one run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Indexed by position in [`Case::derived`].
    pub counts: Vec<usize>,
    /// User and system time of all threads.
    pub cpu: Duration,
    /// The largest resident set, in KiB.
    pub peak_kib: u64,
}

/// Runs a peer in this process and prints counts, nanoseconds and KiB, separated by spaces. The measured time begins
/// with the facts in lists of numbers and ends with the counts of rows.
pub fn once(peer: Peer, case: Case) -> Result<(), Box<dyn std::error::Error>> {
    let facts = case.facts();
    let start = ProcessTime::now();
    let counts = match peer {
        Peer::Engine => engine::counts(case.program(), &facts, case.derived()),
        Peer::Datafrog => datafrog::counts(case, &facts),
        #[cfg(feature = "others")]
        Peer::Ascent => ascent::counts(case, &facts),
        #[cfg(feature = "others")]
        Peer::Crepe => crepe::counts(case, &facts),
        #[cfg(feature = "others")]
        Peer::Differential => differential::counts(case, facts),
        #[cfg(not(feature = "others"))]
        Peer::Ascent | Peer::Crepe | Peer::Differential => return Err("this peer is not compiled".into()),
        Peer::Query | Peer::Souffle | Peer::SouffleCompiled => return Err("this peer is a separate program".into()),
    };
    let nanoseconds = start.elapsed().as_nanos();
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let peak = peak.and_then(|rest| rest.split_whitespace().next()).ok_or("no VmHWM")?;
    let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
    println!("{} {nanoseconds} {peak}", counts.join(","));
    Ok(())
}

/// Runs a peer in a new process.
pub fn run(peer: Peer, case: Case, folder: &Path) -> Result<Run, Box<dyn std::error::Error>> {
    let mut child = peer.command(case, folder)?.spawn()?;
    let mut text = String::new();
    child.stdout.take().ok_or("no output")?.read_to_string(&mut text)?;
    let used = child.wait4()?;
    if !used.status.success() {
        return Err(format!("{case}: {peer} failed: {}", used.status).into());
    }
    if peer.is_whole() {
        let count = |name: &&str| {
            let found = text
                .lines()
                .find_map(|line| line.strip_prefix(name)?.strip_prefix('\t'));
            found
                .ok_or_else(|| format!("{case}: {peer} did not count `{name}`"))?
                .trim()
                .parse()
                .map_err(|error| format!("{error}"))
        };
        Ok(Run {
            counts: case.derived().iter().map(count).collect::<Result<_, String>>()?,
            cpu: used.rusage.utime + used.rusage.stime,
            peak_kib: used.rusage.maxrss / 1024,
        })
    } else {
        let faulty = || format!("{case}: {peer} printed `{}`", text.trim());
        let [counts, nanoseconds, peak] = text.split_whitespace().collect::<Vec<_>>()[..] else {
            return Err(faulty().into());
        };
        Ok(Run {
            counts: counts.split(',').map(str::parse).collect::<Result<_, _>>()?,
            cpu: Duration::from_nanos(nanoseconds.parse()?),
            peak_kib: peak.parse()?,
        })
    }
}
