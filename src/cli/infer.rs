//! `logicity infer`

use super::{Failure, load_config, load_program, report};
use crate::diag::{Code, Diagnostic, Sources, to_json};
use crate::files::{self, MAX_BYTES, Output};
use crate::rng::Seed;
use crate::sim::{InferError, Inference};
use serde_json::json;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Scenes, one JSON object a line; `-` is standard input
    #[arg(default_value = "-")]
    file: PathBuf,
    /// Configuration: it defines the predicates and, unless --rules is given, the rules
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Rule file instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Seed of the predicates that hold with a probability and are not given by the scene
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Where to write the answers; standard output unless given
    #[arg(long)]
    out: Option<PathBuf>,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let scenario = load_config(sources, &arguments.config)?;
    let (program, warnings) = load_program(sources, &scenario, arguments.rules.as_deref())?;
    report(&warnings, sources);
    let mut inference = Inference::new(scenario, program, Seed(arguments.seed), files::read_text)?;

    let input: Box<dyn Read> = if arguments.file == Path::new("-") {
        Box::new(io::stdin().lock())
    } else {
        let file =
            std::fs::File::open(&arguments.file).map_err(|error| Failure::file("read", &arguments.file, error))?;
        Box::new(file)
    };
    let name = if arguments.file == Path::new("-") {
        "<stdin>".to_owned()
    } else {
        arguments.file.display().to_string()
    };
    let scenes = BufReader::new(input);
    match &arguments.out {
        None => {
            let mut out = BufWriter::new(io::stdout().lock());
            let faulty = answer_all(&mut inference, scenes, &name, &arguments.file, |line| {
                writeln!(out, "{line}").map_err(Failure::from)
            })?;
            out.flush()?;
            finish(faulty)
        }
        Some(path) => {
            let fail = |error| Failure::file("write", path, error);
            let mut out = Output::create(path).map_err(fail)?;
            let faulty = answer_all(&mut inference, scenes, &name, &arguments.file, |line| {
                writeln!(out, "{line}").map_err(fail)
            })?;
            out.finish().map_err(fail)?;
            finish(faulty)
        }
    }
}

fn finish(faulty: bool) -> Result<(), Failure> {
    if faulty { Err(Failure::Told) } else { Ok(()) }
}

/// Answers every scene; a faulty one gets `{"error": [diagnostics]}` in its line, so that answers stay in step with scenes.
/// Returns whether any was faulty.
fn answer_all(
    inference: &mut Inference,
    mut scenes: impl BufRead,
    name: &str,
    path: &Path,
    mut write: impl FnMut(serde_json::Value) -> Result<(), Failure>,
) -> Result<bool, Failure> {
    let mut faulty = false;
    let mut bytes = Vec::new();
    for number in 1.. {
        bytes.clear();
        let read = scenes.by_ref().take(MAX_BYTES).read_until(b'\n', &mut bytes);
        if read.map_err(|error| Failure::file("read", path, error))? == 0 {
            break;
        }
        let mut sources = Sources::new();
        let text = String::from_utf8_lossy(&bytes);
        let line = text.trim_end_matches(['\n', '\r']);
        if line.trim().is_empty() {
            continue;
        }
        let source = sources.add_from(name, line, number);
        let answer = if text.contains('\u{fffd}') && std::str::from_utf8(&bytes).is_err() {
            let fault = Diagnostic::new(Code::NotText, format!("line {number} of `{name}` is not UTF-8 text"));
            Err(InferError::Scene(vec![fault]))
        } else {
            inference.answer(&sources, source, number as u64)
        };
        match answer {
            Ok(answer) => write(answer.to_json())?,
            Err(error) => {
                faulty = true;
                let faults = match error {
                    InferError::Scene(faults) => faults,
                    InferError::Eval(error) => {
                        vec![Diagnostic::new(
                            Code::LimitExceeded,
                            format!("{name}:{number}: {error}"),
                        )]
                    }
                };
                write(json!({ "error": to_json(&faults, &sources) }))?;
                report(&faults, &sources);
            }
        }
    }
    Ok(faulty)
}
