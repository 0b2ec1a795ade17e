//! `logicity check`: checks rule files and configurations.

use crate::builtin::BuiltinFiles;
use crate::cli::configuration::{self, Checked, Opened};
use crate::cli::failure::Failure;
use crate::cli::limits::LimitOptions;
use crate::cli::load::{inputs_of, load_workspace_from};
use crate::cli::report::report;
use crate::cli::souffle::SouffleOptions;
use crate::cli::terminal;
use crate::cli::trace::TraceReader;
use crate::config::ActionsConfig;
use crate::datalog::codes;
use crate::datalog::dense::{self, Unsupported};
use crate::datalog::diff::{Cut, Equivalence};
use crate::datalog::explain::ExplanationPrinter;
use crate::datalog::{BaseType, Clause, ClauseId, Column, InputPolicy, PredicateId, Program, Rules, Stratum};
use crate::diag::{Code, Diagnostic, Sources, counted, to_json};
use crate::files::ReadFile;
use crate::sim::{
    CONFLICT_BUDGET, Coverage, Finding, Overlap, conflict_lints, conflicts, earlier_facts, examine as examine_rules,
    help_to_declare, needed_draws, scene_json,
};
use crate::symbol::WordSize;
use serde_json::json;
use std::collections::HashSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The warnings that Soufflé has, too.
const WARNINGS_OF_SOUFFLE: [Code; 2] = [codes::SINGLETON_VARIABLE, codes::OLD_FORM];

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule files, each checked as a separate program; configurations (.yaml, or names of built-in ones such as
    /// `expert`), checked with their rules; maps [default with --coverage: the rules of the run]
    #[arg(required_unless_present = "coverage", value_name = "FILES")]
    rules: Vec<PathBuf>,
    /// Print one JSON object per file, with the keys `file`, `ok`, `strata`, `executors`, `costly`, `conflicts` and
    /// `diagnostics`; `costly` lists the clauses for which the dense executor may give up; `configuration` for a
    /// configuration; `coverage` with --coverage; `unfinished` lists searches that reached a limit
    #[arg(long)]
    json: bool,
    /// Count how often each clause fires on the states of this trace, and list the literals that never matter there
    #[arg(long, value_name = "TRACE")]
    coverage: Option<PathBuf>,
    /// Configuration of the city for which the rules are checked, as if `run` had the option `--rules`; its order of
    /// actions decides conflicts [default: Stop, Slow, Fast, Normal]; with --coverage the configuration to use instead
    /// of the one in the trace
    #[arg(long)]
    config: Option<PathBuf>,
    /// Also report literals and clauses that are always true or redundant
    #[arg(long)]
    lints: bool,
    /// Warn only of what Soufflé warns of: variables that occur once, and forms of older versions
    #[arg(long, conflicts_with = "lints")]
    souffle: bool,
    #[command(flatten)]
    options: SouffleOptions,
    #[command(flatten)]
    limits: LimitOptions,
}

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let mut out = terminal::results(arguments.json);
    let mut reported = HashSet::new();
    let mut diagnostics: Vec<Diagnostic> = Vec::new();
    let mut unreadable = Vec::new();
    let mut paths = arguments.rules.clone();
    let mut files: Box<dyn ReadFile> = Box::new(BuiltinFiles);
    if let (Some(trace), true) = (&arguments.coverage, paths.is_empty()) {
        let archive = TraceReader::open(trace)?.rules()?;
        paths.extend(archive.rule_files.first().map(|file| file.name.clone().into()));
        files = Box::new(archive);
    }
    for path in &paths {
        let mut report = match examine(arguments, path, &*files, sources) {
            Ok(report) => report,
            Err(Failure::Usage(message)) => {
                unreadable.push(message);
                continue;
            }
            Err(other) => return Err(other),
        };
        if arguments.souffle {
            let found = &mut report.found;
            found.retain(|fault| fault.is_error() || WARNINGS_OF_SOUFFLE.contains(&fault.code));
        }
        if arguments.json {
            writeln!(out, "{}", report.json(path, sources))?;
        } else {
            report.print(&mut out, path, arguments, sources)?;
        }
        let found = report.found;
        // Reports a fault in a file that several programs include only once.
        diagnostics.extend(
            found
                .into_iter()
                .filter(|fault| reported.insert(to_json(std::slice::from_ref(fault), sources).to_string())),
        );
    }
    let faulty = diagnostics.iter().any(Diagnostic::is_error);
    if !arguments.json {
        report(&diagnostics, sources);
    }
    if !unreadable.is_empty() {
        return Err(Failure::Usage(unreadable.join("\nerror: ")));
    }
    if faulty { Err(Failure::Reported) } else { Ok(()) }
}

/// The results for one file.
struct Report {
    /// The contents of the configuration, if the file is one.
    configuration: Option<Checked>,
    /// Whether the rules are for a city.
    in_city: bool,
    program: Option<Program>,
    found: Vec<Diagnostic>,
    /// The searches that reached a limit.
    unfinished: Vec<&'static str>,
    overlaps: Vec<Overlap>,
    /// The actions and their order of precedence.
    actions: ActionsConfig,
    covered: Option<Coverage>,
}

/// Checks one file: a rule file, a configuration with its rules, or a map.
fn examine(arguments: &Arguments, path: &Path, files: &dyn ReadFile, sources: &mut Sources) -> Result<Report, Failure> {
    let mut report = Report::new();
    let mut given = match &arguments.config {
        None => None,
        Some(config) => Some(configuration::open_run(config, sources)?),
    };
    let Some(path) = report.open(path, sources)? else {
        return Ok(report);
    };
    if let (None, None, Some(trace)) = (&given, &report.configuration, &arguments.coverage) {
        let city = TraceReader::open(trace)?.city(sources, None, None)?;
        given = Some(configuration::Checked::from_scenario(city.scenario)?);
    }
    if let Some(city) = given.as_ref().or(report.configuration.as_ref()) {
        if arguments.options.word_size() == WordSize::Bits64 {
            let message = "a city has numbers of 32 bits\nhelp: omit `--word-size 64`";
            return Err(Failure::Usage(message.to_owned()));
        }
        report.actions = city.actions();
    }
    let Some(rules) = report.load(&path, given.as_ref(), arguments, files, sources)? else {
        return Ok(report);
    };
    let in_city = report.lint(&rules, given.as_ref(), arguments.lints, sources);
    let program = match Program::new(rules) {
        Ok(program) => program,
        Err(fault) => {
            report.found.push(fault);
            return Ok(report);
        }
    };
    if arguments.options.word_size() == WordSize::Bits32 {
        report.overlaps = conflicts(&in_city, &report.actions.table)?;
    }
    let lints = conflict_lints(&report.overlaps, program.rules(), &report.actions);
    report.found.extend(lints);
    if let Some(configuration) = &report.configuration {
        report.found.extend(configuration.bind(&program, None, sources));
    } else if let Some(given) = &given {
        report.found.extend(given.bind(&program, Some(&path), sources));
    }
    if let Some(trace) = &arguments.coverage {
        report.covered = Some(measure(arguments, trace, &path, sources)?);
    }
    report.program = Some(program);
    Ok(report)
}

impl Report {
    fn new() -> Report {
        Report {
            configuration: None,
            in_city: false,
            program: None,
            found: Vec::new(),
            unfinished: Vec::new(),
            overlaps: Vec::new(),
            actions: ActionsConfig::default(),
            covered: None,
        }
    }

    /// Opens the file. Returns the path of the rules; `None` if there are none, or if the file is faulty.
    fn open(&mut self, path: &Path, sources: &mut Sources) -> Result<Option<PathBuf>, Failure> {
        Ok(match configuration::open(path, sources)? {
            Opened::Rules => Some(path.to_owned()),
            Opened::Faulty(faults) => {
                self.found = faults;
                None
            }
            Opened::Map(map) => {
                self.configuration = Some(map);
                None
            }
            Opened::Run(run) => {
                let rules = run.rules().to_owned();
                self.configuration = Some(run);
                Some(rules)
            }
        })
    }

    /// Loads and checks the rules. Returns `None` for faulty ones.
    fn load(
        &mut self,
        path: &Path,
        given: Option<&Checked>,
        arguments: &Arguments,
        files: &dyn ReadFile,
        sources: &mut Sources,
    ) -> Result<Option<Rules>, Failure> {
        let mut texts = match load_workspace_from(sources, path, InputPolicy::Fixed, &arguments.options, files) {
            Ok(texts) => texts,
            Err(Failure::Input(faults)) => {
                self.found = faults;
                return Ok(None);
            }
            Err(other) => return Err(other),
        };
        let inputs = inputs_of(&texts, given.is_some() || self.configuration.is_some());
        self.in_city = inputs == InputPolicy::Fixed;
        texts.set_inputs(inputs);
        let loaded = texts.check();
        self.found = loaded.diagnostics;
        if let Some(city) = given.or(self.configuration.as_ref()).and_then(Checked::theory) {
            // The program and the configuration are compared as a whole otherwise.
            if loaded.rules.is_none() {
                help_to_declare(&mut self.found, sources, (&texts.declared(), &city.scenario));
            }
        }
        if !loaded.compared.complete {
            self.unfinished.push("clauses that derive nothing new");
        }
        Ok(loaded.rules)
    }

    /// Adds what static checks find. Returns the rules with the constraints that hold in the city.
    fn lint(&mut self, rules: &Rules, given: Option<&Checked>, with_hints: bool, sources: &Sources) -> Rules {
        let city = given.or(self.configuration.as_ref()).and_then(Checked::theory);
        let examined = examine_rules(rules, city, sources);
        self.found.extend(examined.diagnostics);
        if with_hints {
            // Redundant literals may be there for the reader.
            self.found.extend(examined.hints);
            self.unfinished.extend(examined.unfinished);
        }
        examined.in_city
    }

    fn rules(&self) -> Option<&Rules> {
        self.program.as_ref().map(Program::rules)
    }

    fn json(&self, path: &Path, sources: &Sources) -> serde_json::Value {
        let mut line = json!({
            "file": path.display().to_string(),
            "ok": !self.found.iter().any(Diagnostic::is_error),
            "strata": self.rules().map(strata),
            "executors": self.rules().map(|rules| executors_json(rules, sources)),
        });
        if let Some(configuration) = &self.configuration {
            line["configuration"] = configuration.json();
        }
        if let Some(rules) = self.rules() {
            let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
            let costly = costly(rules).into_iter().map(|clause| printer.clause_json(clause));
            line["costly"] = costly.collect();
            line["conflicts"] = overlaps_json(&self.overlaps, &self.actions, rules, sources);
            if let Some(covered) = &self.covered {
                line["coverage"] = coverage_json(covered, rules, sources);
            }
        }
        if !self.unfinished.is_empty() {
            line["unfinished"] = json!(self.unfinished);
        }
        line["diagnostics"] = to_json(&self.found, sources);
        line
    }

    /// Prints nothing for rules with errors.
    fn print(&self, out: &mut impl Write, path: &Path, arguments: &Arguments, sources: &Sources) -> io::Result<()> {
        if let Some(configuration) = &self.configuration {
            configuration.print(out, path)?;
        }
        let Some(rules) = self.rules() else { return Ok(()) };
        let path = self.configuration.as_ref().map_or(path, Checked::rules);
        let strata: Vec<String> = strata(rules).iter().map(|names| names.join(", ")).collect();
        let is_written = |clause: &&Clause| !rules.predicates[clause.head.predicate.index()].hidden;
        let clauses = rules.clauses.iter().filter(is_written).count();
        writeln!(out, "{}: {}", path.display(), counted(clauses, "clause"))?;
        writeln!(out, "  strata: {}", strata.join(" < "))?;
        if self.in_city {
            print_executors(out, rules, sources)?;
        }
        for what in &self.unfinished {
            writeln!(
                out,
                "  incomplete: the search for {what} reached its limit and may have missed some"
            )?;
        }
        print_overlaps(out, &self.overlaps, &self.actions, rules, sources)?;
        if let (Some(covered), Some(trace)) = (&self.covered, &arguments.coverage) {
            print_coverage(out, covered, trace, rules, sources)?;
        }
        Ok(())
    }
}

/// Returns the rules as the dense executor reads them: with conditions instead of literals on quantities, which are the
/// input predicates that end with a column of another type than those of agents.
fn with_conditions(rules: &Rules) -> Rules {
    let quantity = |predicate: PredicateId| {
        let predicate = &rules.predicates[predicate.index()];
        let (value, agents) = predicate.columns.split_last()?;
        let is_agent = |column: &Column| column.base == BaseType::Symbol && column.ty != value.ty;
        let is_quantity = predicate.input && agents.len() <= 2 && agents.iter().all(is_agent);
        (is_quantity && (value.base != BaseType::Symbol || !agents.is_empty())).then_some(agents.len())
    };
    dense::lift(rules, quantity).rules
}

/// Returns the names of the visible predicates of each stratum, in evaluation order.
fn strata(rules: &Rules) -> Vec<Vec<&str>> {
    let visible = |stratum: &Stratum| visible_of(rules, stratum);
    rules
        .strata
        .iter()
        .map(visible)
        .filter(|names| !names.is_empty())
        .collect()
}

fn visible_of<'r>(rules: &'r Rules, stratum: &Stratum) -> Vec<&'r str> {
    let predicates = stratum
        .predicates
        .iter()
        .map(|predicate| &rules.predicates[predicate.index()]);
    let visible = predicates.filter(|predicate| !predicate.hidden);
    visible.map(|predicate| predicate.name.as_str()).collect()
}

/// Describes a reason with the place of the clause.
fn because(reason: &Unsupported, rules: &Rules, sources: &Sources) -> String {
    format!("{} at {}", reason.show(rules), sources.locate(reason.span))
}

/// The number of agents for which `check` estimates the steps of the dense executor.
const CROWD: usize = 64;

/// Returns the clauses for which the dense executor may give up; none if it does not evaluate all clauses.
fn costly(rules: &Rules) -> Vec<ClauseId> {
    let rules = &with_conditions(rules);
    match dense::obstacles(rules).is_empty() {
        true => dense::costly(rules, CROWD, CROWD),
        false => Vec::new(),
    }
}

/// Prints the clauses for which the dense executor may give up.
fn print_costly(out: &mut impl Write, rules: &Rules, sources: &Sources) -> io::Result<()> {
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    for clause in costly(rules) {
        let title = printer.title(clause);
        writeln!(
            out,
            "    relational if {CROWD} agents or more leave it no other choice: many variables depend on each other in \
             {title}"
        )?;
    }
    Ok(())
}

fn print_executors(out: &mut impl Write, rules: &Rules, sources: &Sources) -> io::Result<()> {
    let with_conditions = with_conditions(rules);
    let reasons = dense::obstacles(&with_conditions);
    if reasons.is_empty() {
        writeln!(out, "  executor: dense")?;
        return print_costly(out, rules, sources);
    }
    writeln!(
        out,
        "  executor: dense; relational for these clauses and what they read"
    )?;
    let mut helped = HashSet::new();
    for reason in reasons {
        let head = rules.clauses[reason.clause.index()].head.predicate;
        let name = rules.predicates[head.index()].title();
        writeln!(out, "    {name}: {}", because(&reason, &with_conditions, sources))?;
        if let Some(help) = reason.help().filter(|_| helped.insert(reason.span)) {
            writeln!(out, "      help: {help}")?;
        }
    }
    Ok(())
}

/// Returns the executor of each stratum in a city: `dense`, `relational`, or `both`. `relational` lists the clauses
/// that the dense one does not support, and why.
fn executors_json(rules: &Rules, sources: &Sources) -> serde_json::Value {
    let with_conditions = with_conditions(rules);
    let reasons = dense::obstacles(&with_conditions);
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let strata = rules.strata.iter().filter_map(|stratum| {
        let names = visible_of(rules, stratum);
        let own = reasons.iter().filter(|reason| stratum.clauses.contains(&reason.clause));
        let relational: Vec<serde_json::Value> = own
            .map(|reason| {
                json!({
                    "because": because(reason, &with_conditions, sources),
                    "clause": printer.clause_json(reason.clause),
                    "help": reason.help(),
                })
            })
            .collect();
        let executor = match relational.len() {
            0 => "dense",
            some if stratum.recursive || some == stratum.clauses.len() => "relational",
            _ => "both",
        };
        let found = json!({ "predicates": names, "executor": executor, "relational": relational });
        (!names.is_empty()).then_some(found)
    });
    strata.collect()
}

/// Prints nothing for programs with fewer than two actions.
fn print_overlaps(
    out: &mut impl Write,
    overlaps: &[Overlap],
    config: &ActionsConfig,
    rules: &Rules,
    sources: &Sources,
) -> io::Result<()> {
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let mut printed = false;
    let mut not_found: Vec<(_, Vec<String>)> = Vec::new();
    for overlap in overlaps {
        let Overlap { actions, finding } = overlap;
        let [first, second] = actions.map(|action| config.table.name(action));
        match finding {
            Finding::Excluded { .. } => {}
            Finding::Together { clauses, scene } => {
                let [a, b] = clauses.map(|clause| printer.title(clause));
                writeln!(
                    out,
                    "  conflicts: {first} and {second} can be derived together, and {} wins, as in this scene:",
                    config.table.name(overlap.winner(&config.priority))
                )?;
                writeln!(out, "    {}", scene_json(scene, &[rules]))?;
                let earlier = earlier_facts(scene, rules);
                if !earlier.is_empty() {
                    let earlier = earlier.join(", ");
                    writeln!(
                        out,
                        "    if earlier ticks make these hold, which `check` does not decide: {earlier}"
                    )?;
                }
                let needed = needed_draws(scene);
                if !needed.is_empty() {
                    writeln!(out, "    if these draws succeed: {}", needed.join("; "))?;
                }
                writeln!(out, "    {first} by {a}\n    {second} by {b}")?;
                printed = true;
            }
            Finding::NotFound(equivalence) => {
                let key = (searched(equivalence), unproved(equivalence));
                let pair = format!("{first} and {second}");
                match not_found.iter_mut().find(|(known, _)| *known == key) {
                    Some((_, pairs)) => pairs.push(pair),
                    None => not_found.push((key, vec![pair])),
                }
            }
        }
    }
    for ((searched, reasons), pairs) in &not_found {
        writeln!(out, "  conflicts: none found in {searched} for {}", pairs.join(", "))?;
        for reason in reasons {
            writeln!(out, "    not a proof: {reason}")?;
        }
        printed = true;
    }
    if !printed && !overlaps.is_empty() {
        writeln!(out, "  conflicts: none")?;
        let given = overlaps.iter().flat_map(|overlap| match &overlap.finding {
            Finding::Excluded { given } => given.as_slice(),
            _ => &[],
        });
        let given: Vec<String> = given.map(|one| one.show(rules, sources)).collect();
        let mut shown = HashSet::new();
        for one in given.iter().filter(|one| shown.insert(one.as_str())) {
            writeln!(out, "    given {one}")?;
        }
    }
    Ok(())
}

fn agents(count: usize) -> String {
    format!("{count} {}", if count == 1 { "agent" } else { "agents" })
}

/// Describes the scenes in which a search found nothing.
fn searched(equivalence: &Equivalence) -> String {
    match equivalence {
        Equivalence::NoneFound { entities: None, .. } => "0 scenes (even the smallest exceeds a limit)".to_owned(),
        Equivalence::NoneFound {
            entities: Some(most), ..
        } => format!("all scenes of up to {}", agents(*most)),
        Equivalence::NoneTried { scenes, .. } => format!("{scenes} scenes"),
        Equivalence::Equivalent { .. } | Equivalence::Different(_) => String::new(),
    }
}

/// Explains why a search that found nothing is not a proof.
fn unproved(equivalence: &Equivalence) -> Vec<String> {
    match equivalence {
        Equivalence::NoneFound { proof, cut, .. } => {
            let needed = match proof {
                Some(needed) => format!("larger scenes, up to {}, may show a conflict", agents(*needed)),
                None => "the number of agents that a proof needs is unknown".to_owned(),
            };
            let cuts = cut.iter().map(|cut| match cut {
                Cut::Conflicts => format!("the search reached its limit of {CONFLICT_BUDGET} solver conflicts"),
                Cut::Size => "larger scenes have too many possible facts or derivations".to_owned(),
                Cut::Proof => "there are too many rules to compute the number of agents that a proof needs".to_owned(),
            });
            [needed].into_iter().chain(cuts).collect()
        }
        Equivalence::NoneTried { .. } => {
            let sampled = "rules with expressions, aggregates, floats or unsigned numbers";
            vec![format!("`check` only samples scenes for {sampled}")]
        }
        Equivalence::Equivalent { .. } | Equivalence::Different(_) => Vec::new(),
    }
}

fn overlaps_json(overlaps: &[Overlap], config: &ActionsConfig, rules: &Rules, sources: &Sources) -> serde_json::Value {
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let conflicts = overlaps.iter().map(|overlap| {
        let Overlap { actions, finding } = overlap;
        let winner = config.table.name(overlap.winner(&config.priority));
        let actions = actions.map(|action| config.table.name(action));
        match finding {
            Finding::Excluded { given } => json!({
                "actions": actions,
                "finding": "excluded",
                "given": given.iter().map(|one| one.show(rules, sources)).collect::<Vec<_>>(),
            }),
            Finding::Together { clauses, scene } => json!({
                "actions": actions,
                "finding": "together",
                "winner": winner,
                "clauses": clauses.map(|clause| printer.clause_json(clause)),
                "scene": scene_json(scene, &[rules]),
                "earlier": earlier_facts(scene, rules),
            }),
            Finding::NotFound(equivalence) => json!({
                "actions": actions,
                "finding": "not-found",
                "searched": searched(equivalence),
                "because": unproved(equivalence),
            }),
        }
    });
    conflicts.collect()
}

/// Measures the clauses of a rule file over the states of a trace.
fn measure(arguments: &Arguments, trace: &Path, rules: &Path, sources: &mut Sources) -> Result<Coverage, Failure> {
    let mut trace = TraceReader::open(trace)?;
    // The user may measure other rules than those of the run.
    let given = (!arguments.rules.is_empty()).then_some(rules);
    let limits = trace.limits(given, &arguments.limits);
    let mut replay = trace.replay(sources, arguments.config.as_deref(), given, given.is_none(), limits)?;
    let mut coverage = Coverage::new(replay.session().program().rules());
    while let Some(tick) = trace.tick()? {
        let set = replay.set(&tick).and_then(|()| match given {
            Some(_) => Ok(()),
            None => replay.verify(&tick),
        });
        set.map_err(|fault| trace.placed(fault))?;
        let added = coverage.add(replay.session());
        added.map_err(|error| trace.placed(error.into()))?;
    }
    Ok(coverage)
}

/// Formats literals as the clause spells them.
fn idle(printer: &ExplanationPrinter<'_>, rules: &Rules, clause: ClauseId, idle: &[usize]) -> Vec<String> {
    let clause = &rules.clauses[clause.index()];
    let open = vec![None; clause.variables.len()];
    let literals = idle.iter().map(|&literal| &clause.body[literal]);
    literals
        .map(|literal| printer.literal(clause, literal, &open))
        .collect()
}

fn print_coverage(
    out: &mut impl Write,
    coverage: &Coverage,
    trace: &Path,
    rules: &Rules,
    sources: &Sources,
) -> io::Result<()> {
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    writeln!(
        out,
        "  coverage: {} of {}",
        counted(coverage.states, "tick"),
        trace.display()
    )?;
    writeln!(out, "{:>10}{:>8}  clause", "fired", "ticks")?;
    let head_of = |clause: ClauseId| &rules.predicates[rules.clauses[clause.index()].head.predicate.index()].name;
    let lengths = coverage
        .clauses
        .iter()
        .map(|clause| head_of(clause.clause).chars().count());
    let heads = lengths.max().unwrap_or(0);
    for clause in &coverage.clauses {
        let (head, title) = (head_of(clause.clause), printer.title(clause.clause));
        writeln!(out, "{:>10}{:>8}  {head:<heads$}  {title}", clause.fired, clause.states)?;
        if clause.fired > 0 && !clause.idle.is_empty() {
            let literals = idle(&printer, rules, clause.clause, &clause.idle).join(", ");
            writeln!(out, "{:>20}{:heads$}  never mattered: {literals}", "", "")?;
        }
    }
    Ok(())
}

fn coverage_json(coverage: &Coverage, rules: &Rules, sources: &Sources) -> serde_json::Value {
    let printer = ExplanationPrinter::new(rules, &rules.symbols, sources);
    let clauses: Vec<serde_json::Value> = (coverage.clauses.iter())
        .map(|clause| {
            json!({
                "clause": printer.clause_json(clause.clause),
                "fired": clause.fired,
                "ticks": clause.states,
                "never_mattered": idle(&printer, rules, clause.clause, &clause.idle),
            })
        })
        .collect();
    json!({ "ticks": coverage.states, "clauses": clauses })
}
