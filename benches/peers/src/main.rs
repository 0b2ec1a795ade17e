//! Compares logicity with its peers on five programs: checks that they count the same, and measures CPU time and
//! memory.
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
    /// Measured runs of each peer on each case, interleaved, of which the table has the median. A first run compares
    /// counts
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// File for all figures
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
    Once { peer: Peer, case: Case },
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
            for case in Case::ALL {
                peer::write_case(case, &folder.join(case.to_string()))?;
            }
            Ok(())
        }
        Some(Command::Once { peer, case }) => measure::once(*peer, *case),
        None => compare(arguments),
    }
}

fn compare(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let chosen = |case: &Case| arguments.cases.is_empty() || arguments.cases.contains(case);
    let cases: Vec<Case> = Case::ALL.into_iter().filter(chosen).collect();
    let wanted = |peer: &Peer| arguments.peers.is_empty() || *peer == Peer::Engine || arguments.peers.contains(peer);
    let mut peers: Vec<Peer> = Peer::ALL.into_iter().filter(wanted).collect();
    peers.retain(|peer| peer.is_compiled());
    let souffle = peer::souffle_version();
    if souffle.is_none() && peers.iter().any(|peer| peer.is_souffle()) {
        eprintln!("souffle is not on the path; omitting it");
        peers.retain(|peer| !peer.is_souffle());
    }

    let work = tempfile::tempdir()?;
    let mut results = report::Results::default();
    for &case in &cases {
        let folder = work.path().join(case.to_string());
        peer::write_case(case, &folder)?;
        if peers.contains(&Peer::SouffleCompiled) {
            eprintln!("{case}: souffle compiles the program");
            peer::compile(&folder)?;
        }
        // An unmeasured pass first: all peers must count the same.
        let mut expected = None;
        for &peer in &peers {
            let run = measure::run(peer, case, &folder)?;
            let first = expected.get_or_insert_with(|| run.counts.clone());
            if *first != run.counts {
                return Err(format!("{case}: {peer} counts {:?}, not {first:?}", run.counts).into());
            }
        }
        eprintln!("{case}: {} peers count {:?}", peers.len(), expected.unwrap_or_default());
        for _ in 0..arguments.repeats.max(1) {
            for &peer in &peers {
                results.add(peer, case, measure::run(peer, case, &folder)?);
            }
        }
    }
    print!("{}", results.table(&peers, &cases));
    if let Some(path) = &arguments.json {
        std::fs::write(path, results.json(&peers, &cases, souffle.as_deref()))?;
    }
    Ok(())
}
