//! `logicity query`: runs a Datalog program on facts files.

mod outputs;
mod rows;
mod tables;

use crate::builtin::BuiltinFiles;
use crate::cli::fact;
use crate::cli::fact::Question;
use crate::cli::failure::Failure;
use crate::cli::inputs::Inputs;
use crate::cli::limits::LimitOptions;
use crate::cli::load::load_workspace_from;
use crate::cli::outputs::ForceOption;
use crate::cli::report::report;
use crate::cli::souffle::SouffleOptions;
use crate::cli::terminal;
use crate::cli::values::{integer, threads};
use crate::datalog::cancel::Cancel;
use crate::datalog::codes;
use crate::datalog::explain::ExplanationPrinter;
use crate::datalog::{
    ClauseId, Directive, EvalError, InputPolicy, MarkKind, Past, Predicate, PredicateId, RowEncoding, RowPlace, Rules,
    Value, facts, rewrite,
};
use crate::datalog::{
    Delta, EvalEvent, Limits, MarginalOptions, Marginals, Options, Program, RuleStats, Session, Threads, constraints,
};
use crate::diag::{Diagnostic, Sources, listed};
use crate::files;
use crate::files::ReadError;
use rows::{decompressed, load_rows};
use std::cell::{Cell, RefCell};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule file
    rules: PathBuf,
    /// Folder with a file NAME.facts for each input predicate: one row per line, tab-separated, unless options of
    /// `.input` differ. Repeat the option to give the facts of successive ticks; results and --profile are those of the
    /// last tick [default: .]
    #[arg(short = 'F', long, value_name = "DIR")]
    facts: Vec<PathBuf>,
    /// Folder for a file NAME.csv for each output predicate; created if missing; `-` means standard output
    #[arg(short = 'D', long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
    /// Permit outputs outside of that folder: absolute names, `..` and links that lead out. Use it only for rules that
    /// you trust
    #[arg(long)]
    output_anywhere: bool,
    /// Print the evaluation plan of every clause and exit. With `-F`, plan for the sizes of the predicates in the facts;
    /// without, for few rows
    #[arg(long, conflicts_with = "profile")]
    plan: bool,
    /// Print to standard error the wall-clock time and the number of rows of each clause
    #[arg(long)]
    profile: bool,
    /// Explain why FACT holds, with a shortest proof, instead of writing results. Example: 'Path(1, 2)'; `_` matches
    /// any value
    #[arg(long, value_name = "FACT", conflicts_with = "plan")]
    explain: Option<String>,
    /// Explain why FACT does not hold: print what fails in each clause
    #[arg(long, value_name = "FACT", conflicts_with_all = ["plan", "explain"])]
    why_not: Option<String>,
    /// Print the probability of each row of each output predicate, instead of writing results
    #[arg(long, conflicts_with_all = ["plan", "explain", "why_not"])]
    marginals: bool,
    /// With --marginals: the number of sampled worlds where exact probabilities take too long
    #[arg(long, value_name = "N", value_parser = integer(1..=u32::MAX), default_value_t = 10_000, requires = "marginals")]
    samples: u32,
    /// Seed for the draws of clauses with probabilities, and for samples
    #[arg(long, value_parser = integer(0..=u64::MAX), default_value_t = 0)]
    seed: u64,
    /// Print the explanation as one line of JSON with the keys `fact`, `holds` and `nodes`
    #[arg(long)]
    json: bool,
    /// Number of threads; 0 means one per core. The results and their order do not depend on it
    #[arg(long, value_name = "N", value_parser = threads, default_value = "1")]
    threads: NonZeroUsize,
    #[command(flatten)]
    souffle: SouffleOptions,
    #[command(flatten)]
    limits: LimitOptions,
    #[command(flatten)]
    force: ForceOption,
}

impl Arguments {
    /// Returns the fact to explain, the name of its option, and the question about it.
    fn question(&self) -> Option<(&str, &'static str, Question)> {
        let holds = self.explain.as_deref().map(|fact| (fact, "--explain", Question::Holds));
        holds.or_else(|| Some((self.why_not.as_deref()?, "--why-not", Question::Fails)))
    }
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let question = arguments.question();
    if arguments.json && question.is_none() {
        return Err(Failure::Usage("--json requires --explain or --why-not".to_owned()));
    }
    let workspace = load_workspace_from(
        sources,
        &arguments.rules,
        InputPolicy::Extensible,
        &arguments.souffle,
        &BuiltinFiles,
    )?;
    // Only a question needs the syntax trees, which may be large.
    let (loaded, workspace) = match question {
        Some(_) => (workspace.check(), Some(workspace)),
        None => (workspace.into_checked(), None),
    };
    let Some(rules) = loaded.rules else {
        return Err(loaded.diagnostics.into());
    };
    let program = Program::new(rules)?;
    report(&loaded.diagnostics, sources);
    // An explanation speaks of the clauses as they are written.
    let program = match question {
        None => rewritten(program, sources)?,
        Some(_) => program,
    };
    // The session checks constraints after the commit, before it prints any answer.
    let options = Options {
        constraints: true,
        ..Options::default()
    };
    let program = match program.rules().constraints.is_empty() {
        true => program,
        false => Program::with(program.rules().clone(), options)?,
    };
    if arguments.plan && arguments.facts.is_empty() {
        write!(terminal::out(), "{}", program.show_plans(sources))?;
        return Ok(());
    }
    let mut session = program.session();
    session.set_seed(arguments.seed);
    session.set_limits(arguments.limits.limits(Limits::default()));
    (session.set_threads(Threads::new(arguments.threads)))
        .map_err(|error| Failure::Usage(format!("cannot start {} threads: {error}", arguments.threads)))?;
    let here = [PathBuf::from(".")];
    let folders = match arguments.facts.as_slice() {
        [] => &here,
        folders => folders,
    };
    let paths = folders.iter().flat_map(|folder| input_paths(session.program(), folder));
    let inputs = Inputs::of(sources).with(paths.collect::<Vec<_>>());
    if let [_, second, ..] = folders {
        let is_stdin = |path: &PathBuf| path == Path::new("-") || path == Path::new("/dev/stdin");
        if input_paths(session.program(), &here[0]).iter().any(is_stdin) {
            let message = "an input predicate reads standard input, which has the facts of one tick";
            return Err(Failure::Usage(format!("{message}; omit `-F {}`", second.display())));
        }
        if let Some(drawn) = program.rules().drawn_operand().filter(|_| arguments.marginals) {
            return Err(Failure::Usage(format!(
                "temporal operators read `{}` of the earlier ticks, which is uncertain, since the rules draw it; give \
                 one folder with --marginals",
                program.rules().predicates[drawn.index()].title()
            )));
        }
    }
    // A question may be about any predicate.
    let needed = match question {
        None if !arguments.plan && !arguments.profile => needed(session.program().rules()),
        _ => every_predicate(session.program()),
    };
    // The first one is checked when it is read, before any tick.
    for folder in &folders[1..] {
        check_inputs(session.program(), folder, &needed)?;
    }
    let mut times = None;
    for (tick, folder) in folders.iter().enumerate() {
        if tick > 0 {
            retract_inputs(&mut session);
        }
        load_inputs(folder, &mut session, &needed, sources)?;
        if tick == 0 && question.is_none() && !arguments.plan && !arguments.marginals {
            outputs::check(session.program(), arguments, &inputs)?;
        }
        let committed = match (arguments.profile, tick) {
            (true, 0) => timed_commit(&mut session).map(|(_, times)| Some(times)),
            (true, _) => timed_advance(&mut session).map(|(_, times)| Some(times)),
            (false, _) => {
                let done = if tick == 0 { session.commit() } else { session.advance() };
                done.map(|_| None).map_err(|error| exceeded(&error, program.rules()))
            }
        };
        times = committed?;
        if !arguments.plan {
            let broken = constraints::violations(&session);
            if !broken.is_empty() {
                let of = match folders.len() {
                    1 => None,
                    _ => Some(format!("in tick {tick}, with the facts of `{}`", folder.display())),
                };
                let broken = broken.into_iter().map(|fault| match &of {
                    None => fault,
                    Some(tick) => fault.note(tick.clone()),
                });
                return Err(broken.collect::<Vec<_>>().into());
            }
        }
    }
    if arguments.plan {
        write!(terminal::out(), "{}", session.show_plans(sources))?;
        return Ok(());
    }

    if arguments.marginals {
        return marginals(arguments, &session);
    }
    if let Some(times) = times {
        // Ignores errors here: the results matter more than the profile.
        let _ = write!(terminal::err(), "{}", profile(&session, &times, sources));
    }
    let mut out = io::BufWriter::new(terminal::results(question.is_none() || arguments.json));
    if let (Some((fact, name, question)), Some(workspace)) = (question, workspace) {
        let asked = (question, sources.add(format!("<{name}>"), fact));
        (workspace.fact(sources, asked.1, session.symbols())).map_err(Failure::option)?;
        return fact::explain(&mut out, asked, &workspace, &session, sources, arguments.json);
    }
    outputs::write(&mut out, &session, arguments, &inputs)?;
    out.flush()?;
    Ok(())
}

/// Prints the probability of each row of the outputs: the fact, a tab and the probability; for an estimate, two more
/// tabs and the ends of its interval. Says on standard error why probabilities are estimates.
fn marginals(arguments: &Arguments, session: &Session) -> Result<(), Failure> {
    let program = session.program();
    let outputs = predicates(program).filter(|(_, predicate)| predicate.output);
    let outputs: Vec<PredicateId> = outputs.map(|(id, _)| id).collect();
    let options = MarginalOptions {
        samples: arguments.samples,
        seed: arguments.seed,
        ..MarginalOptions::default()
    };
    let mut marginals =
        Marginals::of_session(session, outputs.iter().copied(), options).expect("outputs are predicates");
    marginals
        .compute(&Cancel::never())
        .map_err(|error| exceeded(&error, program.rules()))?;
    if let Some(reason) = marginals.inexact() {
        let reason = reason.show(program.rules());
        let _ = writeln!(terminal::err(), "note: the probabilities are estimates: {reason}");
    }
    let sources = Sources::new();
    let printer = ExplanationPrinter::new(program.rules(), marginals.symbols(), &sources).quoting();
    let mut out = io::BufWriter::new(terminal::results(true));
    for id in outputs {
        let shown = marginals.rows(id).map(|(row, probability)| {
            let row: Vec<_> = row.iter().copied().map(Some).collect();
            (printer.row(id, &row), probability)
        });
        let mut shown: Vec<_> = shown.collect();
        shown.sort_by(|one, other| one.0.cmp(&other.0));
        for (fact, probability) in shown {
            write!(out, "{fact}\t{}", probability.value)?;
            if let Some((low, high)) = probability.interval {
                write!(out, "\t{low:.4}\t{high:.4}")?;
            }
            writeln!(out)?;
        }
    }
    out.flush()?;
    Ok(())
}

/// Unfolds `inline` predicates and restricts `magic` ones. Warns of inline predicates whose rows are needed.
fn rewritten(program: Program, sources: &Sources) -> Result<Program, Failure> {
    let rules = program.rules();
    let unfolded = rewrite::unfold(rules);
    if let Some((_, kept)) = &unfolded {
        let warning = |predicate: &PredicateId| {
            let predicate = &rules.predicates[predicate.index()];
            let message = format!("`{}` is inline, but some atoms need its rows", predicate.name);
            (Diagnostic::new(codes::IGNORED, message).at(predicate.span, ""))
                .note("an atom in an aggregate needs them, and one that is negated or has too many alternatives may")
                .help("remove `inline`")
        };
        report(&kept.iter().map(warning).collect::<Vec<_>>(), sources);
    }
    let unfolded = unfolded.map(|(rules, _)| rules);
    match rewrite::demand(unfolded.as_ref().unwrap_or(rules)).or(unfolded) {
        Some(rules) => Ok(Program::new(rules)?),
        None => Ok(program),
    }
}

/// Returns the diagnostic of a failed commit, with what might help.
fn exceeded(error: &EvalError, rules: &Rules) -> Diagnostic {
    let fault = error.diagnostic(rules);
    match matches!(error, EvalError::Cancelled { .. }) || !rewrite::would_restrict(rules) {
        true => fault,
        false => fault.help("`.pragma \"magic-transform\" \"*\"` derives only the rows that the outputs need"),
    }
}

/// Wall-clock times of a commit.
#[derive(Default)]
pub(super) struct Times {
    total: Duration,
    /// For each clause, the total time and the number of its evaluations.
    clauses: BTreeMap<ClauseId, (Duration, u64)>,
}

/// Commits and measures the time.
pub(super) fn timed_commit(session: &mut Session) -> Result<(Delta, Times), Diagnostic> {
    timed(session, Session::commit_watched)
}

/// Begins the next tick and measures the time.
pub(super) fn timed_advance(session: &mut Session) -> Result<(Delta, Times), Diagnostic> {
    timed(session, Session::advance_watched)
}

/// A commit that reports its events.
type WatchedCommit = fn(&mut Session, &dyn Fn(EvalEvent)) -> Result<Delta, EvalError>;

fn timed(session: &mut Session, commit: WatchedCommit) -> Result<(Delta, Times), Diagnostic> {
    let start = Instant::now();
    let (begun, times) = (Cell::new(start), RefCell::new(Times::default()));
    let watch = |event| match event {
        EvalEvent::Begin(_) => begun.set(Instant::now()),
        EvalEvent::End(clause) => {
            let mut times = times.borrow_mut();
            let (time, count) = times.clauses.entry(clause).or_default();
            *time += begun.get().elapsed();
            *count += 1;
        }
    };
    let delta = commit(session, &watch);
    let delta = delta.map_err(|error| exceeded(&error, session.program().rules()))?;
    let mut times = times.into_inner();
    times.total = start.elapsed();
    Ok((delta, times))
}

/// Formats the work and time of each clause, slowest first.
pub(super) fn profile(session: &Session, times: &Times, sources: &Sources) -> String {
    let mut text = format!(
        "{:>10} {:>6} {:>13} {:>13} {:>13} {:>6}  clause\n",
        "time", "", "new rows in", "rows scanned", "derived", "runs"
    );
    let mut line = |time: Duration, numbers: [String; 4], what: &str| {
        let share = 100.0 * time.as_secs_f64() / times.total.as_secs_f64().max(f64::MIN_POSITIVE);
        let [delta_rows, rows_scanned, derived, runs] = numbers;
        let time = format!("{:.3} ms", time.as_secs_f64() * 1e3);
        text +=
            &format!("{time:>10} {share:>5.1}% {delta_rows:>13} {rows_scanned:>13} {derived:>13} {runs:>6}  {what}\n");
    };
    let mut rules: Vec<(Duration, u64, &RuleStats)> = (session.work().rules())
        .map(|rule| {
            let (time, runs) = times.clauses.get(&rule.clause).copied().unwrap_or_default();
            (time, runs, rule)
        })
        .collect();
    rules.sort_by_key(|&(time, _, rule)| (Reverse(time), rule.clause));
    for &(time, runs, rule) in &rules {
        let numbers = [rule.delta_rows, rule.rows_scanned, rule.derived, runs].map(|number| number.to_string());
        line(time, numbers, &session.program().show_clause(rule.clause, sources));
    }
    let clauses: Duration = times.clauses.values().map(|(time, _)| *time).sum();
    let rest = times.total.saturating_sub(clauses);
    line(rest, Default::default(), "(sorting, merging, indexes)");
    let sum = |number: fn(&RuleStats) -> u64| rules.iter().map(|&(_, _, rule)| number(rule)).sum::<u64>();
    let runs = rules.iter().map(|&(_, runs, _)| runs).sum::<u64>();
    let totals = [
        sum(|rule| rule.delta_rows),
        sum(|rule| rule.rows_scanned),
        sum(|rule| rule.derived),
        runs,
    ];
    line(times.total, totals.map(|number| number.to_string()), "(all)");
    text
}

/// Prints a predicate with its header between separator lines.
fn print_predicate(
    out: &mut dyn Write,
    name: &str,
    header: &str,
    rows: impl Fn(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    write!(out, "---------------\n{name}\n{header}===============\n")?;
    rows(out)?;
    out.write_all(b"===============\n")
}

/// Returns the declared predicates in source order.
pub(super) fn predicates(program: &Program) -> impl Iterator<Item = (PredicateId, &Predicate)> {
    let predicates = program.rules().predicates.iter().enumerate();
    predicates.map(|(index, predicate)| {
        let id = PredicateId(u32::try_from(index).expect("fewer than 2^32 predicates"));
        (id, predicate)
    })
}

/// Returns the file of an input predicate, or `None` for standard input.
fn input_path(folder: &Path, predicate: &str, directive: &Directive) -> Option<PathBuf> {
    match &directive.place {
        RowPlace::Usual => {
            let end = directive.encoding.extension().unwrap_or("facts");
            let plain = folder.join(format!("{predicate}.{end}"));
            let compressed = folder.join(format!("{predicate}.{end}.gz"));
            Some(if !plain.exists() && compressed.exists() {
                compressed
            } else {
                plain
            })
        }
        RowPlace::File(name) => Some(folder.join(name)),
        RowPlace::Terminal => None,
    }
}

/// Returns the files of all input predicates; `-` for standard input.
fn input_paths(program: &Program, folder: &Path) -> Vec<PathBuf> {
    let predicates = predicates(program);
    predicates
        .flat_map(|(_, predicate)| predicate_paths(predicate, folder))
        .collect()
}

/// Returns the files of an input predicate; `-` for standard input.
fn predicate_paths(predicate: &Predicate, folder: &Path) -> Vec<PathBuf> {
    let inputs = predicate
        .directives
        .iter()
        .filter(|directive| directive.kind == MarkKind::Input);
    inputs
        .map(|directive| input_path(folder, &predicate.name, directive).unwrap_or_else(|| "-".into()))
        .collect()
}

/// Marks the facts of all input predicates to hold no longer, from the next commit on.
fn retract_inputs(session: &mut Session) {
    let program = session.program().clone();
    for (id, predicate) in predicates(&program).filter(|(_, predicate)| predicate.input) {
        let given = predicate.edb.unwrap_or(id);
        let rows: Vec<Vec<Value>> = session.encoded_rows(given).map(<[Value]>::to_vec).collect();
        for row in rows {
            session.retract(id, &row).expect("it is a row of the predicate");
        }
    }
}

/// Help for missing facts.
const FACTS_HELP: &str =
    "\nhelp: `-F FOLDER` names the folder of the facts; a predicate without facts needs a file without rows";

/// Returns, by predicate, whether results or constraints depend on its rows. What operators read of earlier ticks counts
/// as needed. In a program without results, every predicate is needed.
fn needed(rules: &Rules) -> Vec<bool> {
    let results = (0..).map(PredicateId).zip(&rules.predicates);
    let results: Vec<_> = results
        .filter(|(_, predicate)| predicate.output || predicate.printsize)
        .collect();
    if results.is_empty() {
        return vec![true; rules.predicates.len()];
    }
    let constraints = rules.constraints.iter().flat_map(|declared| {
        let domain = declared.domain.iter().map(|(predicate, _)| *predicate);
        declared.constraint.predicates().chain(domain)
    });
    let earlier = rules.pasts.iter().flat_map(Past::operands);
    rules.dependencies(results.into_iter().map(|(id, _)| id).chain(constraints).chain(earlier))
}

/// Returns what marks every predicate as needed.
pub(super) fn every_predicate(program: &Program) -> Vec<bool> {
    vec![true; program.rules().predicates.len()]
}

/// Reads the facts of every input predicate, by their files; that of a predicate that is not `needed` may be missing, as
/// in Soufflé. Reports the faults of all files at once.
pub(super) fn load_inputs(
    folder: &Path,
    session: &mut Session,
    needed: &[bool],
    sources: &mut Sources,
) -> Result<(), Failure> {
    let program = session.program().clone();
    check_inputs(&program, folder, needed)?;
    let mut faults = Vec::new();
    for (id, predicate) in predicates(&program) {
        for directive in predicate
            .directives
            .iter()
            .filter(|directive| directive.kind == MarkKind::Input)
        {
            let path = input_path(folder, &predicate.name, directive);
            if !needed[id.index()] && path.as_ref().is_some_and(|path| !path.exists()) {
                continue;
            }
            let path = path.unwrap_or_else(|| PathBuf::from("standard input"));
            let unreadable = |error: ReadError| {
                let (name, path) = (&predicate.name, path.display());
                let help = match error {
                    ReadError::NotFound => FACTS_HELP,
                    _ => "",
                };
                Failure::Usage(format!(
                    "cannot read the facts of `{name}` from `{path}`: {error}{help}"
                ))
            };
            if directive.encoding == RowEncoding::Parquet {
                let file = files::open_regular(&path).map_err(unreadable)?;
                faults.extend(tables::load(session, id, file, &path).err());
                continue;
            }
            let input: Result<Box<dyn Read>, ReadError> = match &directive.place {
                RowPlace::Terminal => Ok(Box::new(io::stdin())),
                RowPlace::File(name) if name == "/dev/stdin" => Ok(Box::new(io::stdin())),
                _ => files::open_regular(&path).and_then(decompressed),
            };
            let input = input.map_err(unreadable)?;
            if let RowEncoding::Json { .. } = directive.encoding {
                let loaded = facts::load_json(session, id, input);
                let loaded = loaded.map_err(|error| unreadable(ReadError::Io(error.to_string())))?;
                faults.extend(
                    loaded
                        .err()
                        .map(|fault| fault.note(format!("while reading `{}`", path.display()))),
                );
                continue;
            }
            let to = (&mut *session, id, &directive.format);
            faults.extend(load_rows(input, &path, to, sources, unreadable)?);
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(faults.into()) }
}

/// Refuses to read facts if the folder or several of the needed files are missing, and names them all.
fn check_inputs(program: &Program, folder: &Path, needed: &[bool]) -> Result<(), Failure> {
    if !folder.is_dir() {
        let fault = match folder.exists() {
            true => "it is not a folder\nhelp: `-F FOLDER` names the folder of the facts",
            false => "no such folder\nhelp: `-F FOLDER` names the folder of the facts",
        };
        return Err(Failure::file("read facts from", folder, fault));
    }
    let paths = predicates(program).filter(|(id, _)| needed[id.index()]);
    let missing: Vec<String> = paths
        .flat_map(|(_, predicate)| predicate_paths(predicate, folder))
        .filter(|path| path.as_os_str() != "-" && !path.exists())
        .map(|path| format!("`{}`", path.display()))
        .collect();
    if missing.len() < 2 {
        return Ok(());
    }
    let (count, missing) = (missing.len(), listed(&missing));
    Err(Failure::Usage(format!(
        "{count} files of facts are missing: {missing}{FACTS_HELP}"
    )))
}
