//! `logicity infer`: evaluates the rules on scenes.

use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::{LimitOptions, advised};
use crate::cli::load::{inference_of, load_city};
use crate::cli::outputs::{ForceOption, finish, is_stdout, messages, unwritable};
use crate::cli::report::report;
use crate::cli::scenes::{SceneLine, SceneLines};
use crate::cli::terminal;
use crate::cli::values::{integer, one_of};
use crate::datalog::MarginalOptions;
use crate::datalog::cancel::Cancel;
use crate::diag::{Diagnostic, SourceId, Sources, to_json};
use crate::sim::{Executor, Inference};
use serde_json::json;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Scenes, one JSON object per line, or a list of them for successive ticks; `-` means standard input
    #[arg(default_value = "-")]
    file: PathBuf,
    /// Configuration that defines the predicates, and the rules unless --rules is given
    #[arg(long, default_value = "configs/expert.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Seed for probabilistic predicates that the scene leaves open, for clauses with probabilities, and for samples
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Executor that evaluates the rules; the answers do not depend on it
    #[arg(long, value_parser = one_of(&Executor::ALL, Executor::name), default_value = "auto")]
    executor: Executor,
    /// Also explain in each answer why this fact holds (key `explanations`): the name of any predicate, about each ego,
    /// or a fact such as `IsClose(me, you)`; `_` matches any value
    #[arg(long, value_name = "FACT", conflicts_with = "why_not")]
    why: Option<String>,
    /// Like --why, for a fact that does not hold
    #[arg(long, value_name = "FACT")]
    why_not: Option<String>,
    /// Print the probability of each action instead of a decision: of what the rules derive, and of what the ego does
    #[arg(long, conflicts_with_all = ["why", "why_not", "check_constraints", "executor"])]
    marginals: bool,
    /// With --marginals: the number of sampled worlds where exact probabilities take too long
    #[arg(long, value_name = "N", value_parser = integer(1..=u32::MAX), default_value_t = 10_000, requires = "marginals")]
    samples: u32,
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
    let memory = city.limits.bytes;
    let mut inference = inference_of(city, arguments.seed, arguments.executor, sources)?;
    if arguments.check_constraints {
        inference.check_constraints();
    }

    let question = match (&arguments.why, &arguments.why_not) {
        (Some(fact), _) => Some(sources.add("--why", fact.as_str())),
        (None, Some(fact)) => Some(sources.add("--why-not", fact.as_str())),
        (None, None) => None,
    };
    let options = MarginalOptions {
        samples: arguments.samples,
        seed: arguments.seed,
        ..MarginalOptions::default()
    };
    let asked = match question {
        Some(question) => Asked::Explanation(question, &*sources),
        None if arguments.marginals => Asked::Marginals(options),
        None => Asked::Decision,
    };
    let scenes = SceneLines::open(&arguments.file)?.within(memory);
    match arguments.out.as_deref().filter(|path| !is_stdout(path)) {
        None => {
            let mut out = BufWriter::new(terminal::data());
            let found = answer_all(&mut inference, scenes, asked, (&mut out, &Failure::from))?;
            out.flush()?;
            outcome(found)
        }
        Some(path) => {
            let inputs = Inputs::of(sources).with([arguments.file.clone()]);
            let mut out = arguments.force.create("infer", path, &inputs)?;
            let found = answer_all(
                &mut inference,
                scenes,
                asked,
                (&mut out, &|error| unwritable(path, &error)),
            )?;
            finish(out, path)?;
            writeln!(messages(&[path]), "wrote {}", path.display())?;
            outcome(found)
        }
    }
}

/// What to answer about each scene.
#[derive(Clone, Copy)]
enum Asked<'s> {
    Decision,
    /// The decision, and an explanation: the question, and the sources of the rules and the question.
    Explanation(SourceId, &'s Sources),
    Marginals(MarginalOptions),
}

/// What was faulty, from the least to the most important.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Faulty {
    Nothing,
    /// The question, for some scene.
    Question,
    Scene,
}

fn outcome(found: Faulty) -> Result<(), Failure> {
    match found {
        Faulty::Nothing => Ok(()),
        // The diagnostics have been printed beside their scenes.
        Faulty::Question => Err(Failure::option([])),
        Faulty::Scene => Err(Failure::Reported),
    }
}

/// Answers every scene. Writes `{"error": [diagnostics]}` for a faulty one, so that answers stay aligned with scenes.
/// Notes the first scene for which the dense executor gave up. Returns what was faulty.
fn answer_all(
    inference: &mut Inference,
    mut scenes: SceneLines,
    asked: Asked<'_>,
    (out, unwritable): (&mut dyn Write, &dyn Fn(io::Error) -> Failure),
) -> Result<Faulty, Failure> {
    let (mut found, mut noted) = (Faulty::Nothing, false);
    while let Some(SceneLine { number, sources, scene }) = scenes.next()? {
        let answer = match (scene, asked) {
            (Err(fault), _) => Err(vec![fault]),
            (Ok(source), Asked::Marginals(options)) => {
                let marginals = inference.marginals(&sources, source, options, &Cancel::never());
                let written = match marginals {
                    Ok(marginals) => marginals.write_json(out).and_then(|()| writeln!(out)),
                    Err(faults) => {
                        found = Faulty::Scene;
                        report(&faults, &sources);
                        writeln!(out, "{}", json!({ "error": to_json(&faults, &sources) }))
                    }
                };
                written.map_err(unwritable)?;
                continue;
            }
            (Ok(source), Asked::Decision) => (inference.answer(&sources, source)).map(|answer| (answer, Ok(None))),
            (Ok(source), Asked::Explanation(question, rules)) => {
                let answer = inference.answer_explained((&sources, source), (rules, question));
                answer.map(|(answer, explained)| (answer, explained.map(Some).map_err(|faults| (faults, rules))))
            }
        };
        match answer {
            Ok((answer, explained)) => {
                if let Some(reason) = answer.fallback.as_ref().filter(|_| !noted) {
                    let _ = writeln!(
                        terminal::err(),
                        "note: the relational executor decided line {number} of `{}`: {reason}",
                        scenes.name
                    );
                    noted = true;
                }
                let written = match explained {
                    Err((faults, rules)) => {
                        found = found.max(match asked {
                            Asked::Explanation(question, _) if are_in(&faults, question) => Faulty::Question,
                            _ => Faulty::Scene,
                        });
                        report(&faults, rules);
                        writeln!(out, "{}", json!({ "error": to_json(&faults, rules) }))
                    }
                    Ok(explained) => {
                        let explanations = explained.map(serde_json::Value::from);
                        let more = explanations.iter().map(|value| ("explanations", value));
                        answer.write_json(out, more).and_then(|()| writeln!(out))
                    }
                };
                written.map_err(unwritable)?;
            }
            Err(faults) => {
                found = Faulty::Scene;
                let answer = json!({ "error": to_json(&advised(&faults), &sources) });
                writeln!(out, "{answer}").map_err(unwritable)?;
                report(&faults, &sources);
            }
        }
    }
    Ok(found)
}

/// Returns whether all faults are in a source.
fn are_in(faults: &[Diagnostic], source: SourceId) -> bool {
    let place = |fault: &Diagnostic| fault.primary.as_ref().map(|label| label.span.source);
    faults.iter().all(|fault| place(fault) == Some(source))
}
