//! Measures one run of a peer: its counts, CPU time and peak memory. Each run is a separate process.

use crate::case::{Case, Changes, Facts};
use crate::peer::Peer;
#[cfg(feature = "others")]
use crate::{ascent, crepe, differential};
use crate::{datafrog, engine};
use cpu_time::ProcessTime;
use std::error::Error;
use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;
use wait4::Wait4;

/// The shares of the rows of a predicate that a run replaces after the first result.
pub const CHANGES: [f64; 2] = [0.0001, 0.01];

/// The measurement of one run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Indexed by position in the derived predicates of the program.
    pub counts: Vec<usize>,
    /// User and system time of all threads.
    pub cpu: Duration,
    /// The largest resident set, in KiB.
    pub peak_kib: u64,
    /// For each of [`CHANGES`], alone, the CPU time of the change and the counts after it; nothing for a peer that does
    /// not update its results.
    pub changes: Vec<Change>,
}

/// A change of the facts: its CPU time, and the counts after it.
pub type Change = (Duration, Vec<usize>);

/// What a run may take. Runs that take more are killed.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub seconds: u64,
    pub memory_kib: u64,
}

/// The limit that a run exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    Time,
    Memory,
}

/// What [`run`] found.
pub type Outcome = Result<Run, Limit>;

/// Returns the largest resident set of this process so far, in KiB.
fn peak() -> Result<u64, Box<dyn Error>> {
    let status = fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let peak = peak.and_then(|rest| rest.split_whitespace().next()).ok_or("no VmHWM")?;
    Ok(peak.parse()?)
}

/// Runs a peer in this process and prints counts, nanoseconds and KiB, then the nanoseconds and counts of each change if
/// there are changes, separated by spaces. The measured time begins with the facts in lists of numbers and
/// ends with the counts of rows.
pub fn once(peer: Peer, case: Case, changing: bool) -> Result<(), Box<dyn Error>> {
    let facts = case.facts();
    let computed = match peer {
        Peer::Engine => engine_run(case, &facts, changing)?,
        #[cfg(feature = "others")]
        Peer::Differential => differential_run(case, facts, changing)?,
        _ => {
            let start = ProcessTime::now();
            let counts = match peer {
                Peer::Datafrog => datafrog::counts(case.kind(), &facts),
                #[cfg(feature = "others")]
                Peer::Ascent => Some(ascent::counts(case.kind(), &facts)),
                #[cfg(feature = "others")]
                Peer::Crepe => crepe::counts(case.kind(), &facts),
                _ => return Err("this peer is a separate program, or not compiled".into()),
            };
            Run {
                counts: counts.ok_or("this peer does not have the program")?,
                cpu: start.elapsed(),
                peak_kib: peak()?,
                changes: Vec::new(),
            }
        }
    };
    let list = |counts: &[usize]| counts.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    print!(
        "{} {} {}",
        list(&computed.counts),
        computed.cpu.as_nanos(),
        computed.peak_kib
    );
    for (time, counts) in &computed.changes {
        print!(" {} {}", time.as_nanos(), list(counts));
    }
    println!();
    Ok(())
}

fn engine_run(case: Case, facts: &Facts, changing: bool) -> Result<Run, Box<dyn Error>> {
    let (kind, start) = (case.kind(), ProcessTime::now());
    let mut session = engine::load(kind.program(), facts);
    session.commit()?;
    let counts = engine::lengths(&session, kind.derived());
    let (cpu, peak_kib) = (start.elapsed(), peak()?);
    let mut measure = |share: &f64| {
        let changes = case.changes(facts, *share);
        let start = ProcessTime::now();
        drop(engine::change(&mut session, &changes));
        let found = (start.elapsed(), engine::lengths(&session, kind.derived()));
        // The next change begins with the same facts.
        drop(engine::change(&mut session, &reversed(&changes)));
        found
    };
    let changes = shares(changing).iter().map(&mut measure).collect();
    Ok(Run {
        counts,
        cpu,
        peak_kib,
        changes,
    })
}

#[cfg(feature = "others")]
fn differential_run(case: Case, facts: Facts, changing: bool) -> Result<Run, Box<dyn Error>> {
    let start = ProcessTime::now();
    let found = timely::execute_directly(move |worker| {
        let mut dataflow = differential::Dataflow::new(worker, case.kind(), &facts);
        let (counts, cpu, peak_kib) = (dataflow.counts(), start.elapsed(), peak());
        let mut measure = |share: &f64| {
            let changes = case.changes(&facts, *share);
            let start = ProcessTime::now();
            dataflow.tick(worker, &changes);
            let found = (start.elapsed(), dataflow.counts());
            dataflow.tick(worker, &reversed(&changes));
            found
        };
        let changes = shares(changing).iter().map(&mut measure).collect();
        (counts, cpu, peak_kib.map_err(|error| error.to_string()), changes)
    });
    let (counts, cpu, peak_kib, changes) = found;
    Ok(Run {
        counts,
        cpu,
        peak_kib: peak_kib?,
        changes,
    })
}

fn shares(changing: bool) -> &'static [f64] {
    if changing { &CHANGES } else { &[] }
}

/// The changes that undo some changes.
fn reversed(changes: &Changes) -> Changes {
    let undo = |pairs: &[_]| {
        pairs
            .iter()
            .map(|&(pair, present): &(_, bool)| (pair, !present))
            .collect()
    };
    changes.iter().map(|(name, pairs)| (*name, undo(pairs))).collect()
}

/// Runs a peer in a new process within the limits. A run with changes may take the time for each of them again.
pub fn run(peer: Peer, case: Case, folder: &Path, limits: Limits, changing: bool) -> Result<Outcome, Box<dyn Error>> {
    let mut command = peer.command(case, folder)?;
    let mut limits = limits;
    if changing && !peer.is_whole() {
        command.arg("--changing");
        limits.seconds *= 1 + CHANGES.len() as u64;
    }
    let mut child = command
        .spawn()
        .map_err(|error| format!("{case}: cannot start {peer}: {error}"))?;
    let mut output = child.stdout.take().ok_or("no output")?;
    let (id, exceeded) = (child.id(), Mutex::new(None));
    let mut text = String::new();
    let used = std::thread::scope(|scope| {
        let (ended, end) = mpsc::channel::<()>();
        let exceeded = &exceeded;
        scope.spawn(move || {
            while end.recv_timeout(Duration::from_millis(20)) == Err(RecvTimeoutError::Timeout) {
                let Some(limit) = exceeds(id, limits) else { continue };
                *exceeded.lock().expect("no thread panics") = Some(limit);
                _ = Command::new("kill").args(["-KILL", &id.to_string()]).status();
                break;
            }
        });
        output.read_to_string(&mut text)?;
        let used = child.wait4();
        drop(ended);
        used
    })?;
    if let Some(limit) = exceeded.into_inner().expect("no thread panics") {
        return Ok(Err(limit));
    }
    if !used.status.success() {
        return Err(format!("{case}: {peer} failed: {}", used.status).into());
    }
    if peer.is_whole() {
        let count = |name: &&str| {
            let found = peer.printed_count(&text, name);
            found.ok_or_else(|| format!("{case}: {peer} did not count `{name}`"))
        };
        let derived = case.kind().derived();
        return Ok(Ok(Run {
            counts: derived.iter().map(count).collect::<Result<_, _>>()?,
            cpu: used.rusage.utime + used.rusage.stime,
            peak_kib: used.rusage.maxrss / 1024,
            changes: Vec::new(),
        }));
    }
    let list = |text: &str| text.split(',').map(str::parse).collect::<Result<Vec<usize>, _>>();
    let time = |text: &str| text.parse().map(Duration::from_nanos);
    let words: Vec<&str> = text.split_whitespace().collect();
    let [counts, cpu, peak, changes @ ..] = &words[..] else {
        return Err(format!("{case}: {peer} printed `{}`", text.trim()).into());
    };
    let mut found = Vec::new();
    for pair in changes.chunks(2) {
        let [cpu, counts] = pair else {
            return Err(format!("{case}: {peer} printed `{}`", text.trim()).into());
        };
        found.push((time(cpu)?, list(counts)?));
    }
    Ok(Ok(Run {
        counts: list(counts)?,
        cpu: time(cpu)?,
        peak_kib: peak.parse()?,
        changes: found,
    }))
}

/// Which limit a process exceeds, by the CPU time of all its threads and its resident set.
fn exceeds(id: u32, limits: Limits) -> Option<Limit> {
    /// Clock ticks in a second, in files of Linux.
    const TICKS: u64 = 100;
    let read = |name: &str| fs::read_to_string(format!("/proc/{id}/{name}")).ok();
    let stat = read("stat")?;
    // The name of the program, which may contain spaces, ends with the last parenthesis; the times are columns 14 and 15.
    let after = stat.rsplit_once(')')?.1;
    let ticks: u64 = after
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|text| text.parse::<u64>().ok())
        .sum();
    if ticks > limits.seconds * TICKS {
        return Some(Limit::Time);
    }
    let status = read("status")?;
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let resident: u64 = resident.split_whitespace().next()?.parse().ok()?;
    (resident > limits.memory_kib).then_some(Limit::Memory)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_give_the_rows_of_the_changed_facts() {
        for case in Case::SMALL {
            let (kind, facts) = (case.kind(), case.facts());
            let run = engine_run(case, &facts, true).expect("within the limit");
            assert_eq!(run.changes.len(), CHANGES.len());
            for (share, (_, counts)) in CHANGES.into_iter().zip(&run.changes) {
                let mut changed = case.facts();
                for (pair, present) in &case.changes(&facts, share)[0].1 {
                    let rows = &mut changed.binary[0].1;
                    match present {
                        true => rows.push(*pair),
                        false => rows.retain(|row| row != pair),
                    }
                }
                let expected = engine::counts(kind.program(), &changed, kind.derived());
                assert_eq!(*counts, expected, "{case}, {share}");
                assert_ne!(expected, run.counts, "{case}, {share}: the change changes nothing");
            }
            #[cfg(feature = "others")]
            if differential::has(kind) {
                let other = differential_run(case, case.facts(), true).expect("it runs");
                let counts = |run: &Run| run.changes.iter().map(|(_, counts)| counts.clone()).collect::<Vec<_>>();
                assert_eq!((&other.counts, counts(&other)), (&run.counts, counts(&run)), "{case}");
            }
        }
    }

    #[test]
    fn limits_are_noticed() {
        let limit_of_loop = |limits: Limits| {
            let mut child = Command::new("sh")
                .args(["-c", "while :; do :; done"])
                .spawn()
                .expect("it starts");
            let found = loop {
                if let Some(limit) = exceeds(child.id(), limits) {
                    break limit;
                }
            };
            child.kill().expect("it runs");
            child.wait().expect("it ended");
            found
        };
        let (seconds, memory_kib) = (0, 1 << 30);
        assert_eq!(limit_of_loop(Limits { seconds, memory_kib }), Limit::Time);
        let (seconds, memory_kib) = (1_000, 1);
        assert_eq!(limit_of_loop(Limits { seconds, memory_kib }), Limit::Memory);
    }
}
