//! `logicity questions`: generates language questions.

use crate::city::Split;
use crate::cli::{Failure, ForceOption, finish, load_city, one_of, progress, unwritable};
use crate::diag::{Code, Sources};
use crate::files::Output;
use crate::task::questions::{Extent, QUESTIONS_MAX, QuestionSet, Request, RulesFile, SHOTS_MAX, Style, askable};
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;

/// Size and concepts of the paper's small set.
const MINI: (usize, [&str; 2]) = (117, ["tiro", "reckless"]);

#[derive(clap::Args)]
pub struct Arguments {
    /// Configuration
    #[arg(default_value = "configs/vap-hard.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Number of questions, balanced over the answers as far as possible
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=QUESTIONS_MAX as i64), allow_negative_numbers = true,
        default_value_t = 1000)]
    count: u32,
    /// Number of solved examples before each question: 0, or at least one per action that the rules can derive
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=SHOTS_MAX as i64), allow_negative_numbers = true,
        default_value_t = 5)]
    shots: u32,
    /// Seed of the questions
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Agent set of the questions
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// Agent set of the solved examples
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "train", value_name = "SPLIT")]
    demonstrations: Split,
    /// Entities of a question: those that the car sees, or all in the city as in the paper
    #[arg(long, value_parser = one_of(&Extent::ALL, Extent::name), default_value = "view")]
    entities: Extent,
    /// Form of the facts: a list of atoms as in the paper, or English sentences
    #[arg(long, value_parser = one_of(&Style::ALL, Style::name), default_value = "atoms")]
    style: Style,
    /// Only ask about cars with one of these concepts, separated by commas
    #[arg(long, value_delimiter = ',', value_name = "CONCEPTS")]
    about: Vec<String>,
    /// Use the size and concepts of the paper's small set: 117 questions about tiro (novice) and reckless cars
    #[arg(long, conflicts_with_all = ["count", "about"])]
    mini: bool,
    /// Write the questions to FILE, one JSON object per line [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Also write the questions to FILE in the CSV format of MMLU, without a header
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Also write the solved examples to FILE in the same format
    #[arg(long, value_name = "FILE")]
    demonstrations_csv: Option<PathBuf>,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let city = load_city(sources, &arguments.config, arguments.rules.as_deref())?;
    let (rule_file, hash) = (city.rule_files[0], city.rules_hash.clone());
    let world = Arc::new(city.world()?);
    let (count, about) = match arguments.mini {
        true => (MINI.0, MINI.1.map(str::to_owned).to_vec()),
        false => (arguments.count as usize, arguments.about.clone()),
    };
    let request = Request {
        count,
        shots: arguments.shots as usize,
        split: arguments.split,
        demonstrations: arguments.demonstrations,
        entities: arguments.entities,
        style: arguments.style,
        about,
        seed: arguments.seed,
    };
    let begin = |path: &Option<PathBuf>| path.as_deref().map(|path| arguments.force.create(path)).transpose();
    let table = begin(&arguments.csv)?;
    let demonstrations = begin(&arguments.demonstrations_csv)?;
    let questions = begin(&arguments.output)?;
    let bar = progress("question", count as u64);
    let set = QuestionSet::draw(&world, request, |found| bar.set_position(found as u64));
    bar.finish_and_clear();
    // The configuration is valid, so an invalid value is one of the request.
    let set = set.map_err(
        |faults| match faults.iter().all(|fault| fault.code == Code::INVALID_VALUE) {
            true => Failure::option(faults),
            false => Failure::Input(faults),
        },
    )?;
    let rules = RulesFile {
        name: sources.name(rule_file),
        hash: &hash,
    };
    write(table, &arguments.csv, |out| set.write_table(out))?;
    write(demonstrations, &arguments.demonstrations_csv, |out| {
        set.write_demonstrations(out)
    })?;
    let Some(path) = &arguments.output else {
        set.write_json(&world, rules, &mut io::BufWriter::new(io::stdout().lock()))?;
        return Ok(());
    };
    write(questions, &arguments.output, |out| set.write_json(&world, rules, out))?;
    let answers = set.answers();
    let counts = askable(&world)
        .into_iter()
        .map(|action| format!("{} {}", action.name(), answers[action as usize]));
    let counts: Vec<String> = counts.collect();
    writeln!(
        io::stdout(),
        "wrote {count} questions to {}: {}",
        path.display(),
        counts.join(", ")
    )?;
    Ok(())
}

/// Writes a file, if the user named one.
fn write(
    output: Option<Output>,
    path: &Option<PathBuf>,
    what: impl FnOnce(&mut Output) -> io::Result<()>,
) -> Result<(), Failure> {
    let (Some(mut output), Some(path)) = (output, path) else {
        return Ok(());
    };
    what(&mut output).map_err(|error| unwritable(path, &error))?;
    finish(output, path)
}
