//! `logicity questions`: generates language questions.

use crate::city::Split;
use crate::cli::failure::Failure;
use crate::cli::icons::with_looks;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, finish, is_stdout, messages, print_others, refuse_mixing, unwritable};
use crate::cli::terminal;
use crate::cli::values::{integer, one_of};
use crate::diag::Sources;
use crate::files::{Output, make_folder};
use crate::render::{Difficulty, Icons, write_png};
use crate::rng::Seed;
use crate::sim::World;
use crate::task::questions::{
    Extent, Mix, Prompt, QUESTIONS_MAX, QuestionSet, Request, RulesFile, SHOTS_MAX, Style, askable,
};
use crate::yaml::codes;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Size and concepts of the paper's small set.
const MINI: (usize, [&str; 2]) = (117, ["tiro", "reckless"]);

/// The number of pictures whose names are recorded together.
const BATCH: usize = 64;

#[derive(clap::Args)]
pub struct Arguments {
    /// Configuration
    #[arg(default_value = "configs/vap-hard.yaml")]
    config: PathBuf,
    /// Rule file to use instead of the configuration's
    #[arg(long)]
    rules: Option<PathBuf>,
    /// Number of questions
    #[arg(long, value_parser = integer(1..=QUESTIONS_MAX),
        default_value_t = 1000)]
    count: u32,
    /// Number of solved examples before each question: 0, or at least one per action that the rules can derive
    #[arg(long, value_parser = integer(0..=SHOTS_MAX),
        default_value_t = 5)]
    shots: u32,
    /// Seed of the questions
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
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
    /// How often each answer is correct. equal: all answers equally often, as far as they occur. paper: in the
    /// proportions of the paper's small set, Slow 20, Normal 42, Fast 25, Stop 30. by-concept: equally often among the
    /// cars with the same concepts, so that these concepts do not help to guess
    #[arg(long, value_parser = one_of(&Mix::ALL, Mix::name), default_value = "equal")]
    mix: Mix,
    /// Form of the facts. atoms: a list of atoms. words: English sentences. paper: the wording and layout of the
    /// paper's prompt. picture: a picture, in the folder FILE-pictures beside the output FILE, and sentences on what it
    /// does not show
    #[arg(long, value_parser = one_of(&Style::ALL, Style::name), default_value = "atoms")]
    style: Style,
    /// What the instructions state and request. examples: only the solved examples show the rules, as in the paper.
    /// rules: state the rules in English. why: also request the rule that requires the action
    #[arg(long, value_parser = one_of(&Prompt::ALL, Prompt::name), default_value = "examples")]
    prompt: Prompt,
    /// Only ask about cars with one of these concepts, separated by commas
    #[arg(long, value_delimiter = ',', value_name = "CONCEPTS")]
    about: Vec<String>,
    /// Use the size and concepts of the paper's small set: 117 questions about tiro (novice) and reckless cars
    #[arg(long, conflicts_with_all = ["count", "about"])]
    mini: bool,
    /// Write the questions to FILE, one JSON object per line; `-` means standard output [default: -]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Also write the questions to FILE in the CSV format of MMLU, without a header; `-` means standard output, if the
    /// questions go to a file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Also write the solved examples to FILE in the same format
    #[arg(long, value_name = "FILE")]
    demonstrations_csv: Option<PathBuf>,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let pictures = match arguments.style {
        Style::Picture => Some(picture_folder(arguments)?),
        _ => None,
    };
    let named: Vec<(&str, &Path)> = [
        ("--output", Some(arguments.output.as_deref().unwrap_or(Path::new("-")))),
        ("--csv", arguments.csv.as_deref()),
        ("--demonstrations-csv", arguments.demonstrations_csv.as_deref()),
    ]
    .into_iter()
    .filter_map(|(option, path)| Some((option, path?)))
    .collect();
    refuse_mixing(named.iter().copied())?;
    let city = load_city(
        sources,
        &arguments.config,
        arguments.rules.as_deref(),
        &arguments.limits,
    )?;
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
        prompt: arguments.prompt,
        mix: arguments.mix,
        about,
        seed: arguments.seed,
    };
    let inputs = Inputs::of(sources);
    let begin = |path: Option<&Path>| {
        path.map(|path| arguments.force.create("questions", path, &inputs))
            .transpose()
    };
    let table = begin(arguments.csv.as_deref())?;
    let demonstrations = begin(arguments.demonstrations_csv.as_deref())?;
    let output = arguments.output.as_deref().filter(|path| !is_stdout(path));
    let questions = begin(output)?;
    let bar = terminal::progress("question", count as u64);
    let set = QuestionSet::draw(&world, request, |found| bar.set_position(found as u64));
    bar.finish_and_clear();
    // The configuration is valid, so an invalid value is one of the request.
    let set = set.map_err(
        |faults| match faults.iter().all(|fault| fault.code == codes::INVALID_VALUE) {
            true => Failure::option(faults),
            false => Failure::Input(faults),
        },
    )?;
    if let Some(folder) = &pictures {
        draw(&set, &world, folder, arguments, &inputs)?;
    }
    let rules = RulesFile {
        name: sources.name(rule_file),
        hash: &hash,
        sources,
    };
    write(table, arguments.csv.as_deref(), |out| set.write_table(out))?;
    write(demonstrations, arguments.demonstrations_csv.as_deref(), |out| {
        set.write_demonstrations(out)
    })?;
    let paths: Vec<&Path> = named.iter().map(|(_, path)| *path).collect();
    let tables = [arguments.csv.as_deref(), arguments.demonstrations_csv.as_deref()];
    print_others(&mut *messages(&paths), &tables)?;
    let Some(path) = output else {
        let mut out = io::BufWriter::new(terminal::data());
        set.write_json(&world, rules, "", &mut out)?;
        // Dropping the buffer would ignore errors.
        out.flush()?;
        return Ok(());
    };
    let folder = pictures.as_deref().and_then(Path::file_name).unwrap_or_default();
    let folder = folder.to_string_lossy();
    write(questions, output, |out| set.write_json(&world, rules, &folder, out))?;
    let answers = set.answers();
    let counts = askable(&world)
        .into_iter()
        .map(|action| format!("{} {}", action.name(), answers[action.index()]));
    let counts: Vec<String> = counts.collect();
    let mut out = messages(&paths);
    if let Some(folder) = &pictures {
        writeln!(
            out,
            "wrote {} pictures to {}",
            count + set.demonstrations.len(),
            folder.display()
        )?;
    }
    writeln!(
        out,
        "wrote {count} questions to {}: {}",
        path.display(),
        counts.join(", ")
    )?;
    let [same, by_concept] = set.best_guesses();
    writeln!(
        out,
        "best guess: {same} of {count} right with one answer for all cars, {by_concept} with one for each concept"
    )?;
    Ok(())
}

/// Returns the folder of the pictures: that of the output without its extension, and `-pictures`.
fn picture_folder(arguments: &Arguments) -> Result<PathBuf, Failure> {
    let usage = |message: &str| Err(Failure::Usage(message.to_owned()));
    if arguments.csv.is_some() || arguments.demonstrations_csv.is_some() {
        return usage("a table cannot have pictures: use another `--style`, or leave out `--csv`");
    }
    let Some(output) = arguments.output.as_deref().filter(|path| !is_stdout(path)) else {
        return usage("`--style picture` writes pictures beside the questions: name a file with `--output`");
    };
    let Some(name) = output.file_stem().and_then(|name| name.to_str()) else {
        return usage("`--style picture` needs an output file with a name in UTF-8");
    };
    Ok(output.with_file_name(format!("{name}-pictures")))
}

/// Draws the pictures of a set into a folder.
fn draw(
    set: &QuestionSet,
    world: &Arc<World>,
    folder: &Path,
    arguments: &Arguments,
    inputs: &Inputs,
) -> Result<(), Failure> {
    make_folder(folder)?;
    let icons = Arc::new(with_looks(
        Icons::new(Seed(arguments.seed), Difficulty::CLEAN),
        &world.scenario.looks,
    )?);
    let bar = terminal::progress("picture", (set.questions.len() + set.demonstrations.len()) as u64);
    let mut batch: Vec<(PathBuf, Vec<u8>)> = Vec::new();
    set.draw_pictures(world, &icons, |name, picture| {
        let mut bytes = Vec::new();
        write_png(picture, &mut bytes).expect("memory takes all bytes");
        batch.push((folder.join(name), bytes));
        bar.inc(1);
        match batch.len() {
            BATCH => finish_pictures(&std::mem::take(&mut batch), arguments, inputs),
            _ => Ok(()),
        }
    })?;
    bar.finish_and_clear();
    finish_pictures(&batch, arguments, inputs)
}

/// Writes the files of pictures.
fn finish_pictures(pictures: &[(PathBuf, Vec<u8>)], arguments: &Arguments, inputs: &Inputs) -> Result<(), Failure> {
    let paths: Vec<&Path> = pictures.iter().map(|(path, _)| path.as_path()).collect();
    let mut outputs = arguments.force.create_all("questions", &paths, inputs)?;
    for (output, (path, bytes)) in outputs.iter_mut().zip(pictures) {
        output.write_all(bytes).map_err(|error| unwritable(path, &error))?;
    }
    Output::finish_all(outputs).map_err(|(position, error)| unwritable(paths[position], &error))
}

/// Writes a file, if the user named one.
fn write(
    output: Option<Output>,
    path: Option<&Path>,
    what: impl FnOnce(&mut Output) -> io::Result<()>,
) -> Result<(), Failure> {
    let (Some(mut output), Some(path)) = (output, path) else {
        return Ok(());
    };
    what(&mut output).map_err(|error| unwritable(path, &error))?;
    finish(output, path)
}
