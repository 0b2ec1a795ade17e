//! `logicity questions`

use crate::city::Split;
use crate::cli::{Failure, load_city, one_of, progress};
use crate::diag::Sources;
use crate::files::Output;
use crate::sim::{World, hash_sources};
use crate::task::questions::{Extent, QUESTIONS_MAX, QuestionSet, Request, RulesFile, SHOTS_MAX, askable};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The small set of the paper.
const MINI: (usize, [&str; 2]) = (117, ["tiro", "reckless"]);

#[derive(clap::Args)]
pub struct Arguments {
    /// Configuration
    #[arg(default_value = "configs/vap-hard.yaml")]
    config: PathBuf,
    /// Rule file instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// How many questions; every answer that occurs is right equally often, as far as there are such questions
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=QUESTIONS_MAX as i64), allow_negative_numbers = true,
        default_value_t = 1000)]
    count: u32,
    /// How many solved questions come first: none, or at least one for each action that the rules can ask
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=SHOTS_MAX as i64), allow_negative_numbers = true,
        default_value_t = 5)]
    shots: u32,
    /// What everything is drawn from
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// The agents that are asked about
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "test")]
    split: Split,
    /// The agents of the solved questions
    #[arg(long, value_parser = one_of(&Split::ALL, Split::name), default_value = "train", value_name = "SPLIT")]
    demonstrations: Split,
    /// The entities of a question: those that the car sees, or all of the city, as the paper has it
    #[arg(long, value_parser = one_of(&Extent::ALL, Extent::name), default_value = "view")]
    entities: Extent,
    /// Ask only about cars that carry one of these concepts
    #[arg(long, value_delimiter = ',', value_name = "CONCEPTS")]
    about: Vec<String>,
    /// The size and the concepts of the paper's small set: 117 questions about tiro and reckless cars
    #[arg(long, conflicts_with_all = ["count", "about"])]
    mini: bool,
    /// The file to write, one JSON object a line; standard output unless given
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Write the questions to this file, too: comma-separated, without a header, as MMLU has them
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the solved questions to this file in the same way
    #[arg(long, value_name = "FILE")]
    demonstrations_csv: Option<PathBuf>,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let (scenario, program, rule_file) = load_city(sources, &arguments.config, arguments.rules.as_deref())?;
    let rule_files: Vec<_> = sources.ids().skip_while(|&id| id != rule_file).collect();
    let hash = hash_sources(sources, &rule_files);
    let world = Arc::new(World::new(scenario, program)?);
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
        about,
        seed: arguments.seed,
    };
    let bar = progress("question", count as u64);
    let set = QuestionSet::draw(&world, request, |found| bar.set_position(found as u64));
    bar.finish_and_clear();
    let set = set?;
    let rules = RulesFile {
        name: sources.name(rule_file),
        hash: &hash,
    };
    write(arguments.csv.as_deref(), |out| set.write_table(out))?;
    write(arguments.demonstrations_csv.as_deref(), |out| {
        set.write_demonstrations(out)
    })?;
    let Some(path) = &arguments.output else {
        set.write_json(&world, rules, &mut io::BufWriter::new(io::stdout().lock()))?;
        return Ok(());
    };
    write(Some(path), |out| set.write_json(&world, rules, out))?;
    let answers = set.answers();
    let listed = askable(&world)
        .into_iter()
        .map(|action| format!("{} {}", action.name(), answers[action as usize]));
    let listed: Vec<String> = listed.collect();
    writeln!(
        io::stdout(),
        "{count} questions written to {}: {}",
        path.display(),
        listed.join(", ")
    )?;
    Ok(())
}

/// Writes a file, if one is named.
fn write(path: Option<&Path>, what: impl FnOnce(&mut Output) -> io::Result<()>) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    let fail = |error| Failure::file("write", path, error);
    let mut out = Output::create(path).map_err(fail)?;
    what(&mut out).map_err(fail)?;
    out.finish().map_err(fail)
}
