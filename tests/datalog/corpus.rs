//! Runs programs with expected answers in every mode. `tests/corpus/README.md` describes the format of the files.

use crate::root::root;
use crate::rule_files::RuleFiles;
use logicity_datalog as datalog;
use logicity_datalog::diag::{Diagnostic, Severity, Sources, render};
use logicity_datalog::symbol::{Symbol, Symbols};
use logicity_datalog::{BaseType, InputPolicy, PredicateId, Rules, Value};
use logicity_datalog::{Options, Program, Session, Strategy, constraints, facts, naive};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A change of the facts, the begin of the next tick, or a query.
#[derive(Debug)]
enum Step {
    Change {
        present: bool,
        predicate: String,
        rows: Vec<String>,
    },
    Tick,
    Expect {
        line: usize,
        predicate: String,
        rows: Vec<String>,
    },
}

/// A parsed file.
#[derive(Default)]
struct Script {
    steps: Vec<Step>,
    /// Line and `error[code]` or `warning[code]`.
    diagnostics: BTreeSet<(usize, String)>,
}

fn read_script(text: &str) -> Script {
    let mut script = Script::default();
    for (line, number) in text.lines().zip(1..) {
        for kind in ["error", "warning"] {
            if let Some((_, rest)) = line.split_once(&format!("// {kind}["))
                && let Some((code, _)) = rest.split_once(']')
            {
                script.diagnostics.insert((number, format!("{kind}[{code}]")));
            }
        }
        if line == "// tick" {
            script.steps.push(Step::Tick);
        }
        let Some((verb, rest)) = line.strip_prefix("// ").and_then(|line| line.split_once(' ')) else {
            continue;
        };
        if !["expect", "insert", "retract"].contains(&verb) {
            continue;
        }
        let (predicate, rows) = rest.split_once(':').expect("a predicate and a colon");
        let rows: Vec<String> = match rows.strip_prefix(' ') {
            Some(rows) => rows.split(" | ").map(str::to_owned).collect(),
            None => Vec::new(),
        };
        let predicate = predicate.to_owned();
        script.steps.push(match verb {
            "expect" => Step::Expect {
                line: number,
                predicate,
                rows,
            },
            verb => Step::Change {
                present: verb == "insert",
                predicate,
                rows,
            },
        });
    }
    script
}

/// The facts that hold, as rows of text.
type Facts = BTreeMap<String, BTreeSet<String>>;

/// The answer to a query: the rows of a predicate as text, sorted.
type Answer = Vec<String>;

/// A mode of evaluation.
#[derive(Clone, Copy, Debug)]
enum Mode {
    /// The specification.
    Naive,
    /// A new session for each query.
    FromScratch(Options),
    /// One session for all queries, with a commit before each.
    OneSession(Options, Strategy),
}

/// All modes: the original and the optimized program, with and without relying on constraints (the facts of the corpus
/// satisfy them), and a single session under every strategy.
fn modes() -> Vec<Mode> {
    let options = |optimize, constraints| Options { optimize, constraints };
    let options = [options(false, false), options(true, false), options(true, true)];
    let mut modes = vec![Mode::Naive];
    modes.extend(options.map(Mode::FromScratch));
    for strategy in [Strategy::Auto, Strategy::Maintain, Strategy::Recompute] {
        modes.extend(options.map(|options| Mode::OneSession(options, strategy)));
    }
    modes
}

impl Mode {
    /// Runs all steps and returns the answers to the queries.
    fn run(self, rules: &Rules, steps: &[Step]) -> Vec<Answer> {
        let program = |options| Program::with(rules.clone(), options).expect("a small program");
        match self {
            Mode::Naive => by_naive(rules, steps),
            Mode::FromScratch(options) => from_scratch(&program(options), steps),
            Mode::OneSession(options, strategy) => in_one_session(&program(options), strategy, steps),
        }
    }
}

fn parse_row(rules: &Rules, symbols: &Symbols, predicate: PredicateId, row: &str) -> Vec<Value> {
    let columns = &rules.predicates[predicate.index()].columns;
    if columns.is_empty() {
        return Vec::new();
    }
    let values: Vec<&str> = row.split(", ").collect();
    assert_eq!(values.len(), columns.len(), "{row}");
    (columns.iter().zip(values))
        .map(|(column, text)| match column.base {
            BaseType::Symbol => Value(symbols.intern(text).0),
            base => datalog::parse_value(base, text).expect("a value of the column"),
        })
        .collect()
}

fn change(facts: &mut Facts, step: &Step) {
    if let Step::Change {
        present,
        predicate,
        rows,
    } = step
    {
        let known = facts.entry(predicate.clone()).or_default();
        for row in rows {
            if *present {
                known.insert(row.clone())
            } else {
                known.remove(row)
            };
        }
    }
}

fn find(rules: &Rules, name: &str) -> PredicateId {
    rules.predicate(name).unwrap_or_else(|| panic!("no predicate {name}"))
}

fn by_naive(rules: &Rules, steps: &[Step]) -> Vec<Answer> {
    let symbols = rules.symbols.clone();
    let rows_of = |facts: &Facts| -> Vec<(PredicateId, Vec<Value>)> {
        let rows = facts.iter().flat_map(|(name, rows)| {
            let predicate = find(rules, name);
            rows.iter().map(move |row| (predicate, row))
        });
        rows.map(|(predicate, row)| (predicate, parse_row(rules, &symbols, predicate, row)))
            .collect()
    };
    let mut facts = Facts::new();
    let mut ended = Vec::new();
    let mut answers = Vec::new();
    for step in steps {
        let predicate = match step {
            Step::Change { .. } => {
                change(&mut facts, step);
                continue;
            }
            Step::Tick => {
                ended.push(rows_of(&facts));
                continue;
            }
            Step::Expect { predicate, .. } => predicate,
        };
        let ticks = ended.iter().cloned().chain([rows_of(&facts)]);
        let database = naive::evaluate_ticks(rules, &symbols, ticks).pop().expect("a tick");
        let id = find(rules, predicate);
        let columns = &rules.predicates[id.index()].columns;
        let mut answer: Answer = (database[id.index()].iter())
            .map(|row| {
                let shown = columns.iter().zip(row).map(|(column, value)| match column.base {
                    BaseType::Symbol => symbols.resolve(Symbol(value.0)).expect("a symbol").to_owned(),
                    BaseType::Number => value.as_number().to_string(),
                    BaseType::Unsigned => value.0.to_string(),
                    BaseType::Float => logicity_datalog::print_float(value.as_float()),
                    BaseType::Record => unreachable!("no program of the corpus has records"),
                });
                shown.collect::<Vec<_>>().join(", ")
            })
            .collect();
        answer.sort();
        answers.push(answer);
    }
    answers
}

fn ask(session: &Session, predicate: &str) -> Answer {
    let text = facts::print(session, find(session.program().rules(), predicate));
    let rows = text.lines().map(|row| {
        if row == "()" {
            String::new()
        } else {
            row.replace('\t', ", ")
        }
    });
    let mut answer: Answer = rows.collect();
    answer.sort();
    answer
}

/// Inserts or retracts rows.
fn note<'r>(session: &mut Session, present: bool, predicate: &str, rows: impl IntoIterator<Item = &'r String>) {
    let program = session.program().clone();
    let predicate = find(program.rules(), predicate);
    for row in rows {
        let row = parse_row(program.rules(), session.symbols(), predicate, row);
        let noted = match present {
            true => session.insert(predicate, &row),
            false => session.retract(predicate, &row),
        };
        noted.expect("a row that fits");
    }
}

fn from_scratch(program: &Program, steps: &[Step]) -> Vec<Answer> {
    let mut facts = Facts::new();
    let mut ended = Vec::new();
    let mut answers = Vec::new();
    for step in steps {
        let predicate = match step {
            Step::Change { .. } => {
                change(&mut facts, step);
                continue;
            }
            Step::Tick => {
                ended.push(facts.clone());
                continue;
            }
            Step::Expect { predicate, .. } => predicate,
        };
        let mut session = program.session();
        let mut before = &Facts::new();
        for (tick, facts) in ended.iter().chain([&facts]).enumerate() {
            for (present, rows) in [(false, before), (true, facts)] {
                for (name, rows) in rows {
                    note(&mut session, present, name, rows);
                }
            }
            match tick {
                0 => session.commit().expect("few rows"),
                _ => session.advance().expect("few rows"),
            };
            before = facts;
        }
        answers.push(ask(&session, predicate));
    }
    answers
}

fn in_one_session(program: &Program, strategy: Strategy, steps: &[Step]) -> Vec<Answer> {
    let mut session = program.session();
    session.set_strategy(strategy);
    // Whether the next commit begins a tick.
    let mut begins = false;
    let mut answers = Vec::new();
    for step in steps {
        if !matches!(step, Step::Change { .. }) {
            match std::mem::take(&mut begins) {
                true => session.advance().expect("few rows"),
                false => session.commit().expect("few rows"),
            };
            // Some modes rely on the constraints.
            assert!(
                constraints::violations(&session).is_empty(),
                "facts violate a constraint"
            );
        }
        match step {
            Step::Change {
                present,
                predicate,
                rows,
            } => note(&mut session, *present, predicate, rows),
            Step::Tick => begins = true,
            Step::Expect { predicate, .. } => answers.push(ask(&session, predicate)),
        }
    }
    answers
}

/// Loads the file, compares its diagnostics, and runs it in every mode.
fn check(path: &Path) -> Result<(), String> {
    let text = fs::read_to_string(path).expect("a corpus file is text");
    let script = read_script(&text);
    let mut sources = Sources::new();
    let entry = sources.add(path.display().to_string(), text);
    let loaded = datalog::load_with(&mut sources, entry, &RuleFiles, InputPolicy::Extensible);
    let found: BTreeSet<(usize, String)> = loaded.diagnostics.iter().map(|fault| place(fault, &sources)).collect();
    if found != script.diagnostics {
        let drawn = render(&loaded.diagnostics, &sources, false);
        return Err(format!(
            "diagnostics: expected {:?}, found {found:?}\n{drawn}",
            script.diagnostics
        ));
    }
    let Some(rules) = loaded.rules else { return Ok(()) };
    if !script.steps.iter().any(|step| matches!(step, Step::Expect { .. })) {
        return Err("nothing is expected".to_owned());
    }
    for mode in modes() {
        let mut answers = mode.run(&rules, &script.steps).into_iter();
        for step in &script.steps {
            let Step::Expect { line, predicate, rows } = step else {
                continue;
            };
            let mut expected: Answer = rows.iter().map(|row| row.replace("()", "")).collect();
            expected.sort();
            let answer = answers.next().expect("an answer for each query");
            if answer != expected {
                return Err(format!(
                    "{mode:?}, line {line}: `{predicate}` is {answer:?}, not {expected:?}"
                ));
            }
        }
    }
    Ok(())
}

fn place(fault: &Diagnostic, sources: &Sources) -> (usize, String) {
    let line = fault
        .primary
        .as_ref()
        .map_or(0, |label| sources.position(label.span).line);
    let kind = if fault.severity() == Severity::Error {
        "error"
    } else {
        "warning"
    };
    (line, format!("{kind}[{}]", fault.code.name()))
}

fn corpus() -> Vec<PathBuf> {
    let root = root().join("tests/corpus");
    let mut files = Vec::new();
    let mut folders = vec![root];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a readable folder") {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "dl") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

#[test]
fn every_program_of_the_corpus_gives_its_answers_in_every_mode() {
    let files = corpus();
    assert!(files.len() > 20);
    let failures: Vec<String> = (files.iter())
        .filter_map(|path| {
            check(path)
                .err()
                .map(|failure| format!("{}: {failure}", path.display()))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
}

/// The printed program parses to the same program.
#[test]
fn the_corpus_survives_printing() {
    for path in corpus() {
        let mut sources = Sources::new();
        let id = sources.add("corpus.dl", fs::read_to_string(&path).expect("a corpus file is text"));
        let parsed = datalog::parse(&sources, id);
        if parsed.diagnostics.is_empty() {
            let printed = datalog::print(&parsed.file);
            let again = sources.add("printed.dl", printed.clone());
            let again = datalog::parse(&sources, again);
            assert!(
                again.diagnostics.is_empty(),
                "{}",
                render(&again.diagnostics, &sources, false)
            );
            assert_eq!(again.file, parsed.file, "{}\n{printed}", path.display());
        }
    }
}
