//! Compares logicity with its peers on small programs or on the suite: checks that they count the same, and measures
//! CPU time and memory.
// Decision: docs/decisions/safety.md#d024

#[cfg(feature = "others")]
mod ascent;
mod case;
#[cfg(feature = "others")]
mod crepe;
mod datafrog;
#[cfg(feature = "others")]
mod differential;
mod engine;
mod measure;
mod peer;
mod report;

use case::Case;
use clap::Parser;
use peer::Peer;
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare the engine of logicity with its peers.
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Only these cases
    #[arg(long, value_delimiter = ',')]
    cases: Vec<Case>,
    /// Only these peers, and the engine
    #[arg(long, value_delimiter = ',')]
    peers: Vec<Peer>,
    /// The cases of the suite, with absolute figures, and with changes for the engine and differential-dataflow; needs
    /// 16 GiB of memory
    #[arg(long)]
    suite: bool,
    /// Runs of each peer on each case, interleaved, of which the table has the median
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// CPU time of a run in seconds, after which it is killed
    #[arg(long, value_name = "SECONDS", default_value_t = 600)]
    time: u64,
    /// Resident memory of a run in GiB, at which it is killed
    #[arg(long, value_name = "GIB", default_value_t = 16)]
    memory: u64,
    /// File for all figures; it keeps those of other cases
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Write the program and the facts of every case, to run an engine manually
    Data {
        /// Folder to write to; each case gets a folder
        folder: PathBuf,
    },
    /// One run in this process, which other commands start
    #[command(hide = true)]
    Once {
        peer: Peer,
        case: Case,
        /// Measure changes too
        #[arg(long)]
        changing: bool,
    },
}

fn main() -> ExitCode {
    // Run the `logicity` command in this binary, to measure `query` without building another one.
    if std::env::var_os(peer::AS_LOGICITY).is_some() {
        return logicity::cli::main();
    }
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    match &arguments.command {
        Some(Command::Data { folder }) => {
            for case in arguments.cases() {
                peer::write_case(case, &folder.join(case.to_string()))?;
            }
            Ok(())
        }
        Some(Command::Once { peer, case, changing }) => measure::once(*peer, *case, *changing),
        None => compare(arguments),
    }
}

impl Arguments {
    fn cases(&self) -> Vec<Case> {
        match (&self.cases[..], self.suite) {
            ([], true) => Case::SUITE.to_vec(),
            ([], false) => Case::SMALL.to_vec(),
            (cases, _) => cases.to_vec(),
        }
    }
}

fn compare(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let cases = arguments.cases();
    if cases.contains(&Case::CrdtTrace) && std::env::var_os(case::CRDT).is_none() {
        return Err(format!("set {} to the folder of the trace", case::CRDT).into());
    }
    let limits = measure::Limits {
        seconds: arguments.time,
        memory_kib: arguments.memory << 20,
    };
    let wanted = |peer: &Peer| arguments.peers.is_empty() || *peer == Peer::Engine || arguments.peers.contains(peer);
    let mut peers: Vec<Peer> = Peer::ALL.into_iter().filter(wanted).collect();
    peers.retain(|peer| peer.is_compiled() && cases.iter().any(|case| peer.has(case.kind())));
    let mut versions: Vec<(&str, String)> = Vec::new();
    for program in Peer::PROGRAMS {
        if !peers.iter().any(|peer| peer.program() == Some(program)) {
            continue;
        }
        match peer::version(program) {
            Some(version) => versions.push((program, version)),
            None => {
                eprintln!("{program} is not on the path; omitting it");
                peers.retain(|peer| peer.program() != Some(program));
            }
        }
    }

    let work = tempfile::tempdir()?;
    let mut results = report::Results::new(limits);
    let earlier = match arguments.json.as_deref().filter(|path| path.exists()) {
        Some(path) => serde_json::from_str(&std::fs::read_to_string(path)?)?,
        None => serde_json::Value::Null,
    };
    for (position, &case) in cases.iter().enumerate() {
        let folder = work.path().join(case.to_string());
        // In another process, since the peak of a process begins with that of its parent.
        let mut write = std::process::Command::new(std::env::current_exe()?);
        write.args(["--cases", &case.to_string(), "data"]).arg(work.path());
        if !write.status()?.success() {
            return Err(format!("{case}: the facts were not written").into());
        }
        let with: Vec<Peer> = peers.iter().copied().filter(|peer| peer.has(case.kind())).collect();
        for peer in &with {
            peer.compile(case, &folder)?;
        }
        let mut expected = None;
        for round in 0..arguments.repeats.max(1) {
            for &peer in &with {
                // Changes of large functions join them, so that the result is many times larger.
                let changing = arguments.suite && case != Case::CspaLarge;
                let outcome = measure::run(peer, case, &folder, limits, changing)?;
                if let Ok(run) = &outcome {
                    // All peers must count the same, also after each change.
                    let (counts, changed) = expected.get_or_insert_with(|| (run.counts.clone(), Vec::new()));
                    let found: Vec<_> = run.changes.iter().map(|(_, counts)| counts.clone()).collect();
                    if changed.is_empty() {
                        changed.clone_from(&found);
                    }
                    if *counts != run.counts || !found.is_empty() && *changed != found {
                        let found = (&run.counts, &found);
                        return Err(format!("{case}: {peer} counts {found:?}, not {expected:?}").into());
                    }
                }
                if arguments.suite {
                    let said = match &outcome {
                        Ok(run) => format!("{:.2} s, {} MiB", run.cpu.as_secs_f64(), run.peak_kib >> 10),
                        Err(limit) => format!("exceeds the limit of {limit:?}").to_lowercase(),
                    };
                    eprintln!("{case}, run {}: {}: {said}", round + 1, peer.to_string().trim_end());
                }
                results.add(peer, case, outcome);
            }
        }
        let counts = expected.map(|(counts, _)| counts).unwrap_or_default();
        eprintln!("{case}: {} peers count {counts:?}", with.len());
        if let Some(path) = &arguments.json {
            let done = &cases[..=position];
            std::fs::write(path, results.json(&peers, done, &versions, &earlier))?;
        }
    }
    match arguments.suite {
        true => print!("{}", results.suite(&peers, &cases)),
        false => print!("{}", results.table(&peers, &cases)),
    }
    Ok(())
}
