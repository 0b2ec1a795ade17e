//! `logicity questions`: generates language questions.

use crate::city::Split;
use crate::cli::failure::Failure;
use crate::cli::icons::with_looks;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_city;
use crate::cli::outputs::{ForceOption, finish, is_stdout, messages, print_others, refuse_mixing, unwritable};
use crate::cli::values::{ShardOption, integer, one_of};
use crate::cli::{inputs, terminal};
use crate::diag::{Diagnostic, SourceId, Sources, counted};
use crate::files::{Output, make_folder};
use crate::render::{Difficulty, Icons, write_png};
use crate::rng::Seed;
use crate::sim::World;
use crate::task::questions::{
    Extent, Mix, Prompt, QUESTIONS_MAX, QuestionSet, QuestionShard, Request, RequestRecord, RulesFile, SHOTS_MAX,
    Style, askable,
};
use crate::task::shard::{self, Origin, Shard};
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
    shard: ShardOption,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

impl Arguments {
    fn request(&self) -> Request {
        let (count, about) = match self.mini {
            true => (MINI.0, MINI.1.map(str::to_owned).to_vec()),
            false => (self.count as usize, self.about.clone()),
        };
        Request {
            count,
            shots: self.shots as usize,
            split: self.split,
            demonstrations: self.demonstrations,
            entities: self.entities,
            style: self.style,
            prompt: self.prompt,
            mix: self.mix,
            about,
            seed: self.seed,
        }
    }

    /// Writes a shard.
    fn run_shard(&self, shard: Shard, sources: &mut Sources) -> Result<(), Failure> {
        if self.csv.is_some() || self.demonstrations_csv.is_some() {
            return Err(Failure::Usage("a shard cannot have tables: leave out `--csv`".into()));
        }
        let Some(path) = &self.output else {
            return Err(Failure::Usage("name a file for the shard with `--output`".into()));
        };
        inputs::refuse_undecodable(&self.config, self.rules.as_deref())?;
        let city = load_city(sources, &self.config, self.rules.as_deref(), &self.limits)?;
        let request = self.request();
        let origin = Origin {
            config: self.config.clone(),
            rules: self.rules.clone(),
            config_hash: city.scenario.hash.clone(),
            rules_hash: city.rules_hash.clone(),
            request: RequestRecord::of(&request),
        };
        let world = Arc::new(city.world()?);
        let mut out = self.force.create("questions", path, &Inputs::of(sources))?;
        let bar = terminal::progress("question", shard.share(request.count) as u64);
        let made = QuestionShard::draw(&world, &request, shard, |found| bar.set_position(found as u64));
        bar.finish_and_clear();
        let made = made.map_err(faults_of_request)?;
        made.write(&origin, &mut out)
            .map_err(|error| unwritable(path, &error))?;
        finish(out, path)?;
        let (found, path_shown) = (
            counted(usize::try_from(made.searched).unwrap_or(0), "world"),
            path.display(),
        );
        writeln!(
            messages(&[path]),
            "wrote shard {shard} to {path_shown}: {found} searched"
        )?;
        Ok(())
    }
}

/// Returns the failure of a request. The configuration is valid, so an invalid value is one of the request.
fn faults_of_request(faults: Vec<Diagnostic>) -> Failure {
    match faults.iter().all(|fault| fault.code == codes::INVALID_VALUE) {
        true => Failure::option(faults),
        false => Failure::Input(faults),
    }
}

/// Joins the shards in some files, for `logicity merge`.
pub fn merge(
    shards: &[SourceId],
    output: &Path,
    (force, limits): (&ForceOption, &LimitOptions),
    sources: &mut Sources,
) -> Result<(), Failure> {
    let header = |&source: &SourceId| {
        let header = shard::read::<RequestRecord>(sources.text(source), source)?.header;
        Ok::<_, Diagnostic>((sources.name(source).to_owned(), header.shard, header.origin))
    };
    let known: Vec<_> = shards.iter().map(header).collect::<Result<_, _>>()?;
    let order = shard::in_order(&known)?;
    let origin = &known[0].2;
    let request = origin.request.request()?;
    let pictures = match request.style {
        Style::Picture => Some(picture_folder(Some(output))?),
        _ => None,
    };
    let city = load_city(sources, &origin.config, origin.rules.as_deref(), limits)?;
    origin.check(&city.scenario.hash, &city.rules_hash)?;
    let (rule_file, hash) = (city.rule_files[0], city.rules_hash.clone());
    let world = Arc::new(city.world()?);
    let mut made = Vec::new();
    for index in order {
        let source = shards[index];
        let read = shard::read::<RequestRecord>(sources.text(source), source)?;
        made.push(QuestionShard::read(&read, source, &world)?);
    }
    let inputs = Inputs::of(sources);
    let questions = match is_stdout(output) {
        true => None,
        false => Some(force.create("merge", output, &inputs)?),
    };
    let bar = terminal::progress("question", request.count as u64);
    let joined = QuestionSet::join(&world, request, &made, |found| bar.set_position(found as u64));
    bar.finish_and_clear();
    let (set, added) = joined.map_err(faults_of_request)?;
    if let Some(folder) = &pictures {
        draw(&set, &world, folder, force, &inputs)?;
    }
    let (joined, added) = (counted(made.len(), "shard"), usize::try_from(added).unwrap_or(0));
    writeln!(
        messages(&[output]),
        "joined {joined}, and searched {}",
        counted(added, "further world")
    )?;
    let rules = RulesFile {
        name: sources.name(rule_file),
        hash: &hash,
        sources,
    };
    let out = messages(&[output]);
    publish(&set, &world, rules, (output, questions), pictures.as_deref(), out)
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    if let Some(shard) = arguments.shard.shard {
        return arguments.run_shard(shard, sources);
    }
    let pictures = match arguments.style {
        Style::Picture if arguments.csv.is_some() || arguments.demonstrations_csv.is_some() => {
            let message = "a table cannot have pictures: use another `--style`, or leave out `--csv`";
            return Err(Failure::Usage(message.to_owned()));
        }
        Style::Picture => Some(picture_folder(arguments.output.as_deref())?),
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
    let request = arguments.request();
    let count = request.count;
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
    let set = set.map_err(faults_of_request)?;
    if let Some(folder) = &pictures {
        draw(&set, &world, folder, &arguments.force, &inputs)?;
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
    let output = output.unwrap_or(Path::new("-"));
    let out = messages(&paths);
    publish(&set, &world, rules, (output, questions), pictures.as_deref(), out)
}

/// Writes the questions to a file, or to standard output without one, and prints what they are to `out`.
fn publish(
    set: &QuestionSet,
    world: &World,
    rules: RulesFile<'_>,
    (path, file): (&Path, Option<Output>),
    pictures: Option<&Path>,
    mut out: impl Write,
) -> Result<(), Failure> {
    if file.is_none() {
        let mut out = io::BufWriter::new(terminal::data());
        set.write_json(world, rules, "", &mut out)?;
        // Dropping the buffer would ignore errors.
        out.flush()?;
        return Ok(());
    }
    let folder = pictures.and_then(Path::file_name).unwrap_or_default();
    let folder = folder.to_string_lossy();
    write(file, Some(path), |out| set.write_json(world, rules, &folder, out))?;
    let answers = set.answers();
    let counts = askable(world)
        .into_iter()
        .map(|action| format!("{} {}", action.name(), answers[action.index()]));
    let counts: Vec<String> = counts.collect();
    let count = set.questions.len();
    if let Some(folder) = pictures {
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
fn picture_folder(output: Option<&Path>) -> Result<PathBuf, Failure> {
    let usage = |message: &str| Err(Failure::Usage(message.to_owned()));
    let Some(output) = output.filter(|path| !is_stdout(path)) else {
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
    force: &ForceOption,
    inputs: &Inputs,
) -> Result<(), Failure> {
    make_folder(folder)?;
    let icons = Arc::new(with_looks(
        Icons::new(Seed(set.request.seed), Difficulty::CLEAN),
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
            BATCH => finish_pictures(&std::mem::take(&mut batch), force, inputs),
            _ => Ok(()),
        }
    })?;
    bar.finish_and_clear();
    finish_pictures(&batch, force, inputs)
}

/// Writes the files of pictures.
fn finish_pictures(pictures: &[(PathBuf, Vec<u8>)], force: &ForceOption, inputs: &Inputs) -> Result<(), Failure> {
    let paths: Vec<&Path> = pictures.iter().map(|(path, _)| path.as_path()).collect();
    let mut outputs = force.create_all("questions", &paths, inputs)?;
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
