//! `logicity infer`: evaluates the rules on scenes.

use crate::builtin::BuiltinFiles;
use crate::cli::{
    Failure, ForceOption, Inputs, LimitOptions, advised, finish, integer, is_stdout, load_city, one_of, open, report,
    unwritable,
};
use crate::diag::{Code, Diagnostic, Sources, to_json};
use crate::files;
use crate::files::ReadError;
use crate::rng::Seed;
use crate::sim::{Executor, Inference};
use serde_json::json;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

/// The longest scene, in bytes (64 MiB).
const MAX_SCENE: u64 = 1 << 26;

#[derive(clap::Args)]
pub struct Arguments {
    /// Scenes, one JSON object per line; `-` means standard input
    #[arg(default_value = "-")]
    file: PathBuf,
    /// Configuration that defines the predicates, and the rules unless --rules is given
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Seed for probabilistic predicates that the scene leaves open
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Executor that evaluates the rules; the answers do not depend on it
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// Reject scenes whose facts violate a constraint of the rules (`.disjoint`, `.implies`, ...); implies the
    /// relational executor
    #[arg(long)]
    check_constraints: bool,
    /// Write the answers to FILE; `-` means standard output [default: -]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    if arguments.check_constraints && arguments.executor == Executor::Dense {
        return Err(Failure::Usage(
            "--check-constraints requires the relational executor; omit --executor dense".to_owned(),
        ));
    }
    let city = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?;
    let mut inference = Inference::new(
        city.scenario,
        city.program,
        Seed(arguments.seed),
        arguments.executor,
        BuiltinFiles,
    )?;
    inference.name_clauses(sources);
    inference.set_limits(city.limits);
    if arguments.check_constraints {
        inference.check_constraints();
    }

    let (input, name): (Box<dyn Read>, _) = if arguments.file == Path::new("-") {
        (Box::new(io::stdin().lock()), "<stdin>".to_owned())
    } else {
        (Box::new(open(&arguments.file)?), arguments.file.display().to_string())
    };
    let scenes = BufReader::new(input);
    match arguments.out.as_deref().filter(|path| !is_stdout(path)) {
        None => {
            let mut out = BufWriter::new(io::stdout().lock());
            let faulty = answer_all(&mut inference, scenes, &name, &arguments.file, |line| {
                writeln!(out, "{line}").map_err(Failure::from)
            })?;
            out.flush()?;
            outcome(faulty)
        }
        Some(path) => {
            let inputs = Inputs::of(sources).with([arguments.file.clone()]);
            let mut out = arguments.force.create(path, &inputs)?;
            let faulty = answer_all(&mut inference, scenes, &name, &arguments.file, |line| {
                writeln!(out, "{line}").map_err(|error| unwritable(path, &error))
            })?;
            finish(out, path)?;
            outcome(faulty)
        }
    }
}

fn outcome(faulty: bool) -> Result<(), Failure> {
    if faulty { Err(Failure::Reported) } else { Ok(()) }
}

/// Answers every scene. Writes `{"error": [diagnostics]}` for a faulty one, so that answers stay aligned with scenes.
/// Notes the first scene for which the dense executor gave up. Returns whether any scene was faulty.
fn answer_all(
    inference: &mut Inference,
    mut scenes: impl BufRead,
    name: &str,
    path: &Path,
    mut write: impl FnMut(serde_json::Value) -> Result<(), Failure>,
) -> Result<bool, Failure> {
    let (mut faulty, mut noted) = (false, false);
    let mut bytes = Vec::new();
    for number in 1.. {
        bytes.clear();
        let unreadable = |error| Failure::file("read", path, error);
        let read = scenes.by_ref().take(MAX_SCENE).read_until(b'\n', &mut bytes);
        if read.map_err(unreadable)? == 0 {
            break;
        }
        let mut sources = Sources::new();
        let fault = |code, what: &str| {
            Err(vec![Diagnostic::new(
                code,
                format!("line {number} of `{name}` is {what}"),
            )])
        };
        let answer = if bytes.len() as u64 == MAX_SCENE && !bytes.ends_with(b"\n") {
            scenes.skip_until(b'\n').map_err(unreadable)?;
            fault(
                Code::LIMIT_EXCEEDED,
                &format!("too long: the limit is {} MiB", MAX_SCENE >> 20),
            )
        } else {
            match files::to_text(std::mem::take(&mut bytes)) {
                Ok(line) if line.trim().is_empty() => continue,
                Ok(line) => {
                    let source = sources.add_from(name, line.trim_end_matches(['\n', '\r']), number);
                    inference.answer(&sources, source)
                }
                Err(ReadError::NotText { column, .. }) => fault(
                    Code::NOT_TEXT,
                    &format!("not UTF-8 text (first bad byte in column {column})"),
                ),
                Err(error) => return Err(Failure::file("read", path, error)),
            }
        };
        match answer {
            Ok(answer) => {
                if let Some(reason) = answer.fallback.as_ref().filter(|_| !noted) {
                    eprintln!("note: the relational executor decided line {number} of `{name}`: {reason}");
                    noted = true;
                }
                write(answer.to_json())?;
            }
            Err(faults) => {
                faulty = true;
                write(json!({ "error": to_json(&advised(&faults), &sources) }))?;
                report(&faults, &sources);
            }
        }
    }
    Ok(faulty)
}
