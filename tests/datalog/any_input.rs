//! Properties that hold for any bytes. `hostile` checks them on many inputs in every test run, `tests/fuzz` for as long
//! as it runs. Each function panics if a property does not hold.

use crate::random_program::agree::agrees;
use crate::random_program::{Batch, Genome};
use crate::rule_files::RuleFiles;
use logicity_datalog as datalog;
use logicity_datalog::codes;
use logicity_datalog::diag::{self, Diagnostic, MAX_FAULTS, Sources, render, to_json};
use logicity_datalog::explain::{Explainer, ExplanationPrinter};
use logicity_datalog::files::{BUILTIN_FOLDER, ReadError, ReadFile, normalize};
use logicity_datalog::{Atom, BaseType, Clause, Column, Literal, PredicateId, RowFormat, Rules, Value};
use logicity_datalog::{Limits, Options, Program, Session, diff, facts};
use std::path::Path;
use std::sync::LazyLock;

/// A text parses or gives diagnostics. If it parses, the printed and the formatted text parse to the same rules, and
/// both operations are idempotent.
pub fn parse(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let mut sources = Sources::new();
    let entry = sources.add("any.dl", text);
    let parsed = datalog::parse(&sources, entry);
    let formatted = datalog::format(&sources, entry);
    let failed = parsed.diagnostics.iter().any(Diagnostic::is_error);
    assert_eq!(formatted.as_ref().err(), failed.then_some(&parsed.diagnostics));
    let Ok(formatted) = formatted else { return };

    let mut read = |text: &str| {
        let id = sources.add("again.dl", text);
        let again = datalog::parse(&sources, id);
        assert!(
            !again.diagnostics.iter().any(Diagnostic::is_error),
            "{}",
            render(&again.diagnostics, &sources, false)
        );
        (again.file, datalog::format(&sources, id).expect("the text parses"))
    };
    let (again, twice) = read(&formatted);
    assert_eq!(again, parsed.file, "formatted:\n{formatted}");
    assert_eq!(twice, formatted);
    let printed = datalog::print(&parsed.file);
    let (again, _) = read(&printed);
    assert_eq!(again, parsed.file, "printed:\n{printed}");
    assert_eq!(datalog::print(&again), printed);
}

/// Rule files pass the checker, and `check` and `query --plan` can print everything about them, or they give
/// diagnostics. A line `// file: NAME` begins another file.
pub fn check(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let files = split_files(&text);
    let read = |path: &Path| {
        let path = normalize(path);
        match files.iter().find(|(name, _)| Path::new(name) == path) {
            Some((_, text)) => Ok(text.clone()),
            None if path.starts_with(BUILTIN_FOLDER) => RuleFiles.read(&path),
            None => Err(ReadError::NotFound),
        }
    };
    let mut sources = Sources::new();
    let entry = sources.add(files[0].0.as_str(), files[0].1.as_str());
    let (program, diagnostics) = Program::load(&mut sources, entry, &read);
    assert_eq!(program.is_none(), diagnostics.iter().any(Diagnostic::is_error));
    draw(&diagnostics, &sources);
    let Some(program) = program else { return };

    let rules = program.rules();
    #[cfg(feature = "optimizer")]
    draw(
        &logicity_datalog::optimize::lints(rules, &sources).diagnostics,
        &sources,
    );
    for constraints in [false, true] {
        let optimize = constraints;
        let program =
            Program::with(rules.clone(), Options { optimize, constraints }).expect("the same rules have a plan");
        program.show_plans(&sources);
    }
    let options = diff::Options {
        entities_max: 1,
        conflicts_max: 100,
        ..diff::Options::default()
    };
    let same = diff::diff(rules, rules, &options);
    assert!(!matches!(same, Ok(diff::Equivalence::Different(_))), "{same:?}");
}

/// Sessions agree with `naive` on the program and the script of changes that the bytes encode.
pub fn evaluate(bytes: &[u8]) {
    let genome = Genome::read(bytes);
    let rules = genome.rules();
    let script = genome.batches(&rules);
    let program = Program::new(rules.clone()).expect("a generated program is safe and small");
    if ends_soon(&program, &script) {
        agrees(&rules, &script).unwrap_or_else(|failure| panic!("{failure}\n{genome:#?}"));
    }
}

/// Sessions agree with `naive` on a program with changes, written as in `tests/corpus`, and explain its rows.
pub fn query(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let mut sources = Sources::new();
    let entry = sources.add("any.dl", text.as_ref());
    let builtin = |path: &Path| match path.starts_with(BUILTIN_FOLDER) {
        true => RuleFiles.read(path),
        false => Err(ReadError::NotFound),
    };
    let (Some(program), _) = Program::load(&mut sources, entry, &builtin) else {
        return;
    };
    let rules = program.rules();
    let script = batches(rules, &text);
    if ends_soon(&program, &script) {
        agrees(rules, &script).unwrap_or_else(|failure| panic!("{failure}"));
        explain(&program, &script, &sources);
    }
}

/// The number of rows to explain in a predicate, and the steps for each.
const EXPLAINED_MAX: usize = 3;
const EXPLAIN_STEPS: u64 = 20_000;

/// Explains rows that hold after the script and rows that do not.
fn explain(program: &Program, script: &[Batch], sources: &Sources) {
    let rules = program.rules();
    let mut session = program.session();
    for batch in script {
        note(&mut session, batch);
        session.commit().expect("few rows");
    }
    let printer = ExplanationPrinter::new(rules, session.symbols(), sources);
    let mut explainer = Explainer::new(&session);
    explainer.set_limit(EXPLAIN_STEPS);
    for (predicate, id) in rules.predicates.iter().zip((0..).map(PredicateId)) {
        let nothing = explainer.explain_absence(id, &vec![None; predicate.arity()]);
        let rows = session.encoded_rows(id).take(EXPLAINED_MAX);
        let proofs = rows.map(|row| explainer.explain(id, row)).chain([nothing]);
        for explanation in proofs.filter_map(Result::ok).flatten() {
            assert!(!printer.tree(&explanation).is_empty());
            assert!(printer.json(&explanation).is_object());
        }
    }
}

fn note(session: &mut Session, batch: &Batch) {
    for (present, id, row) in batch {
        let noted = match present {
            true => session.insert(*id, row),
            false => session.retract(*id, row),
        };
        noted.expect("a row that fits");
    }
}

/// A text loads as rows, whose printed form loads as the same rows, or gives diagnostics. The first byte chooses the
/// format.
pub fn rows(bytes: &[u8]) {
    let Some((&kind, bytes)) = bytes.split_first() else {
        return;
    };
    let format = RowFormat {
        delimiter: ["\t", ",", "::"][usize::from(kind % 3)].to_owned(),
        headers: kind & 64 != 0,
        quoted: kind & 128 != 0,
        columns: Vec::new(),
    };
    let program = &*ROWS;
    let p = program.predicate("p").expect("declared");
    let mut sources = Sources::new();
    let source = sources.add("p.facts", String::from_utf8_lossy(bytes));
    let mut session = program.session();
    match facts::load_as(&mut session, p, &sources, source, &format) {
        Ok(lines) => {
            session.commit().expect("nothing is derived");
            assert!(session.len(p) <= lines);
            let printed = written(&session, p, &format);
            let mut again = program.session();
            let source = sources.add("again", printed.as_str());
            facts::load_as(&mut again, p, &sources, source, &format).expect("printed rows load");
            again.commit().expect("nothing is derived");
            assert_eq!(written(&again, p, &format), printed);
        }
        Err(faults) => {
            assert!(!faults.is_empty());
            // If there are more faults than the limit, the last one says so.
            let (last, others) = faults.split_last().expect("there are some");
            assert!(others.iter().all(|fault| fault.code == codes::INVALID_FACT));
            assert!([codes::INVALID_FACT, diag::codes::LIMIT_EXCEEDED].contains(&last.code));
            let differs = |(at, fault): &(usize, &Diagnostic)| !faults[..*at].iter().any(|known| known.repeats(fault));
            assert!(others.iter().enumerate().filter(differs).count() <= MAX_FAULTS);
            draw(&faults, &sources);
        }
    }
}

/// One predicate with a column of each type. Shared, since loading it takes longer than reading a few rows.
static ROWS: LazyLock<Program> = LazyLock::new(|| {
    let mut sources = Sources::new();
    let declarations = ".decl p(x: symbol, n: number, u: unsigned, f: float, y: symbol)\n.input p\n";
    let entry = sources.add("rows.dl", declarations);
    let (program, _) = Program::load(&mut sources, entry, &RuleFiles);
    program.expect("valid rules")
});

/// The content of a file with the rows.
fn written(session: &Session, predicate: PredicateId, format: &RowFormat) -> String {
    let declared = &session.program().rules().predicates[predicate.index()];
    let mut out = facts::header(declared, format).into_bytes();
    facts::write_rows(session, predicate, format, &mut out).expect("writing to memory cannot fail");
    String::from_utf8(out).expect("texts are written whole")
}

/// Prints every diagnostic as text and as JSON.
fn draw(diagnostics: &[Diagnostic], sources: &Sources) {
    if !diagnostics.is_empty() {
        assert!(!render(diagnostics, sources, false).is_empty());
    }
    let json = to_json(diagnostics, sources);
    assert_eq!(json.as_array().map(Vec::len), Some(diagnostics.len()));
}

/// Splits a text at the lines `// file: NAME`.
fn split_files(text: &str) -> Vec<(String, String)> {
    let mut files = vec![("any.dl".to_owned(), String::new())];
    for line in text.split_inclusive('\n') {
        match (line.strip_prefix("// file: "), files.last_mut()) {
            (Some(name), _) => files.push((name.trim_end().to_owned(), String::new())),
            (None, Some((_, text))) => text.push_str(line),
            (None, None) => {}
        }
    }
    files
}

/// Returns the changes in the lines `// insert P: a, 1 | b, 2` and `// retract P: ..` of a text. `// expect` ends a
/// batch. Ignores lines that do not fit the rules.
fn batches(rules: &Rules, text: &str) -> Vec<Batch> {
    let mut batches = vec![Batch::new()];
    for line in text.lines() {
        let Some((verb, rest)) = line.strip_prefix("// ").and_then(|line| line.split_once(' ')) else {
            continue;
        };
        let last = batches.last_mut().expect("not empty");
        match (verb, rest.split_once(": ")) {
            ("insert" | "retract", Some((name, rows))) => {
                let rows = rows.split(" | ").filter_map(|row| row_of(rules, name, row));
                last.extend(rows.map(|(id, row)| (verb == "insert", id, row)));
            }
            ("expect", _) if !last.is_empty() => batches.push(Batch::new()),
            _ => {}
        }
    }
    batches
}

fn row_of(rules: &Rules, name: &str, row: &str) -> Option<(PredicateId, Vec<Value>)> {
    let id = rules.predicate(name)?;
    let predicate = &rules.predicates[id.index()];
    let id = predicate.edb.or((!predicate.derived).then_some(id))?;
    let texts: Vec<&str> = row.split(", ").filter(|_| row != "()").collect();
    let value = |(column, text): (&Column, &str)| match column.base {
        BaseType::Symbol => Some(Value(rules.symbols.intern(text).0)),
        base => datalog::parse_value(base, text),
    };
    let row: Option<Vec<Value>> = predicate.columns.iter().zip(texts.iter().copied()).map(value).collect();
    row.filter(|row| row.len() == texts.len() && row.len() == predicate.arity())
        .map(|row| (id, row))
}

/// The limits of a program that is compared with `naive`.
const LIMITS: Limits = Limits {
    rows: 100,
    steps: 100_000,
    bytes: 1 << 24,
};

/// The combinations of rows that `naive` may try for one clause.
const COMBINATIONS_MAX: usize = 20_000;

/// Whether `naive` ends soon after every batch, and after the last batch is undone.
fn ends_soon(program: &Program, script: &[Batch]) -> bool {
    let rules = program.rules();
    let undo = |(present, id, row): &(bool, PredicateId, Vec<Value>)| (!present, *id, row.clone());
    let undone: Option<Batch> = script.last().map(|batch| batch.iter().map(undo).collect());
    let mut session = program.session();
    session.set_limits(LIMITS);
    script.iter().chain(&undone).all(|batch| {
        note(&mut session, batch);
        session.commit().is_ok()
            && (rules.clauses.iter()).all(|clause| combinations(clause, &session) <= COMBINATIONS_MAX)
    })
}

/// The number of combinations of rows for the atoms of a clause.
fn combinations(clause: &Clause, session: &Session) -> usize {
    let atoms = clause.body.iter().filter_map(positive);
    let sizes = atoms.map(|atom| session.len(atom.predicate).max(1));
    sizes.fold(1, usize::saturating_mul)
}

fn positive(literal: &Literal) -> Option<&Atom> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    }
}
