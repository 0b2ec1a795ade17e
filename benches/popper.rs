//! Learns tasks in the format of the learner Popper, and compares with FOIL.
//!
//! `cargo bench --bench popper -- [FOLDER [TABLES]]` learns random tasks of
//! `tests/city/popper_tasks.rs`, or those in the subfolders of a folder, each with `bk.pl`, `exs.pl` and `bias.pl`:
//! for example `examples` of Popper's repository, or the folder that `Demonstrations.to_popper` writes. A task without
//! negative examples is read under the closed-world assumption.
//!
//! It prints the share of the examples that the clauses get right, the same for the last fifth of the examples of each
//! label with clauses learned from the others, and the seconds to read the task and to learn. A task has at most 60
//! seconds. FOIL has a beam of 20 clauses, may use negated literals, and has as many variables as fit into its tables.
//!
//! With TABLES, it also writes a table per task to that folder, for learners of propositional rules. A row is an
//! example. The columns are the conjunctions of at most two atoms, with at most one variable beside those of the head,
//! that hold in some examples and not in others. `python/benches/induce_baselines.py --tables` reads them.

#[path = "induce_baselines/foil.rs"]
mod foil;
#[path = "../tests/city/popper_tasks.rs"]
mod popper_tasks;

use foil::Foil;
use logicity::cancel::Cancel;
use logicity::diag::{Sources, render};
use logicity::induce::{Atom, Body, Literal, Settings};
use logicity::popper::{Files, Options, Solution, Task, read, solve};
use popper_tasks::{TARGETS, Texts, family, pieces, trains};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The time limit of a task.
const LIMIT: Duration = Duration::from_secs(60);
/// The size of the tables of FOIL in words of 64 bits.
const FOIL_WORDS: usize = 4_000_000;

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let tables = arguments.get(1).map(PathBuf::from);
    println!(
        "| task | examples | right | held out | read, s | learn, s | clauses | literals | FOIL, variables | FOIL, right | FOIL, s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let Some(folder) = arguments.first() else {
        for target in 0..TARGETS {
            for (name, texts) in [
                ("trains", trains(1, target, 1000)),
                ("pieces", pieces(1, target, 200)),
                ("family", family(1, target, 100)),
            ] {
                measure(&format!("{name}{}", target + 1), &texts, None);
            }
        }
        return;
    };
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(folder) = folders.pop() {
        let mut inside: Vec<_> = fs::read_dir(&folder)
            .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
            .map(|entry| entry.expect("a readable entry").path())
            .filter(|path| path.is_dir())
            .collect();
        inside.sort_by(|a, b| b.cmp(a));
        folders.extend(inside);
        let texts = ["bk.pl", "exs.pl", "bias.pl"].map(|file| fs::read_to_string(folder.join(file)));
        if let [Ok(background), Ok(examples), Ok(bias)] = texts {
            let name = folder.file_name().unwrap_or_default().to_string_lossy();
            measure(&name, &[background, examples, bias], tables.as_deref());
        }
    }
}

/// Learns a task and prints a line.
fn measure(name: &str, [background, examples, bias]: &Texts, tables: Option<&Path>) {
    let mut sources = Sources::new();
    let files = Files {
        background: sources.add("bk.pl", background.as_str()),
        examples: sources.add("exs.pl", examples.as_str()),
        bias: sources.add("bias.pl", bias.as_str()),
    };
    let begin = Instant::now();
    let options = Options {
        closed_world: !examples.contains("neg("),
        ..Options::default()
    };
    let (task, diagnostics) = read(&sources, &files, &options);
    let Some(task) = task else {
        let fault = diagnostics.iter().find(|fault| fault.is_error());
        let shown = render(fault.map(std::slice::from_ref).unwrap_or_default(), &sources, false);
        println!("| {name} | {} |", shown.lines().next().unwrap_or_default());
        return;
    };
    let read_seconds = begin.elapsed().as_secs_f64();
    if let Some(folder) = tables {
        fs::create_dir_all(folder).expect("a folder for the tables");
        fs::write(folder.join(format!("{name}.tsv")), table(&task)).expect("a writable table");
    }
    let begin = Instant::now();
    let solution = learned(&task, |_| true);
    let seconds = begin.elapsed().as_secs_f64();
    let bodies: Vec<&Body> = solution.rules.clauses.iter().map(|clause| &clause.body).collect();
    let is_held_out = held_out(&task);
    let rest = match is_held_out.iter().filter(|is_held_out| **is_held_out).count() {
        // Too few examples to hold some out.
        0..4 => "-".to_owned(),
        _ => {
            let other = learned(&task, |case| !is_held_out[case]);
            let bodies: Vec<&Body> = other.rules.clauses.iter().map(|clause| &clause.body).collect();
            format!("{:.3}", accuracy(&task, &bodies, |case| is_held_out[case]))
        }
    };
    println!(
        "| {name} | {} | {:.3} | {rest} | {read_seconds:.2} | {seconds:.2}{} | {} | {} | {} |",
        task.cases.len(),
        accuracy(&task, &bodies, |_| true),
        if solution.is_cut { " (cut)" } else { "" },
        bodies.len(),
        bodies.iter().map(|body| body.0.len()).sum::<usize>(),
        foil(&task),
    );
}

/// The maximum number of columns of a table.
const COLUMNS_MAX: usize = 1000;

/// Returns the table of a task for learners of propositional rules, with values separated by tabs. The last column is
/// the label.
fn table(task: &Task) -> String {
    let egos = task.vocabulary.egos();
    let atoms = task.vocabulary.atoms((egos + 1).min(task.variables));
    let is_in_head = |atom: &Atom| atom.arguments.iter().any(|&variable| usize::from(variable) < egos);
    let single = atoms.iter().map(|atom| vec![atom]);
    let pairs = (atoms.iter().enumerate()).flat_map(|(at, one)| atoms[..at].iter().map(move |other| vec![other, one]));
    let linked = single
        .chain(pairs)
        .filter(|atoms| atoms.iter().any(|atom| is_in_head(atom)));
    let (mut names, mut columns, mut seen) = (Vec::new(), Vec::new(), BTreeSet::new());
    for atoms in linked {
        let literals = atoms.into_iter().map(|atom| Literal {
            is_negated: false,
            atom: atom.clone(),
        });
        let body = Body(literals.collect());
        let holds = task.cases.iter().map(|case| body.holds(&task.vocabulary, &case.state));
        let column: Vec<bool> = holds.collect();
        if column.contains(&true) && column.contains(&false) && seen.insert(column.clone()) {
            names.push(body.texts(&task.vocabulary).join(", "));
            columns.push(column);
        }
        if columns.len() == COLUMNS_MAX {
            break;
        }
    }
    let mut text = names.join("\t") + "\tlabel\n";
    for (index, case) in task.cases.iter().enumerate() {
        for column in &columns {
            let _ = write!(text, "{}\t", u8::from(column[index]));
        }
        text += if case.is_positive { "pos\n" } else { "neg\n" };
    }
    text
}

/// Learns a task with FOIL, and returns the rest of its line.
fn foil(task: &Task) -> String {
    let (examples, _) = task.examples(|_| true);
    let (egos, words) = (task.vocabulary.egos(), examples.states().len().div_ceil(64));
    let entities = examples.states().map(|(state, _)| state.entities()).max().unwrap_or(1);
    let size = |variables: usize| {
        let bindings = entities.saturating_pow((variables - egos) as u32);
        bindings.saturating_mul(2 * words * task.vocabulary.atoms(variables).len())
    };
    let fits = |variables: &usize| size(*variables) <= FOIL_WORDS;
    let Some(variables) = (egos..=task.variables).rev().find(fits) else {
        return "- | - | -".to_owned();
    };
    let begin = Instant::now();
    let learned = Foil { width: 20, variables }.learn(&examples);
    let seconds = begin.elapsed().as_secs_f64();
    let bodies: Vec<&Body> = learned[0].iter().collect();
    format!("{variables} | {:.3} | {seconds:.2}", accuracy(task, &bodies, |_| true))
}

fn learned(task: &Task, keep: impl Fn(usize) -> bool) -> Solution {
    let deadline = Instant::now() + LIMIT;
    let cancel = Cancel::when(move || Instant::now() > deadline);
    let settings: Settings = task.settings();
    solve(&task.vocabulary, &task.examples(keep).0, &settings, &cancel)
}

/// The last fifth of the examples of each label.
fn held_out(task: &Task) -> Vec<bool> {
    let mut held_out = vec![false; task.cases.len()];
    for label in [true, false] {
        let cases = 0..task.cases.len();
        let own: Vec<usize> = cases.filter(|&case| task.cases[case].is_positive == label).collect();
        own.iter()
            .skip(own.len() * 4 / 5)
            .for_each(|&case| held_out[case] = true);
    }
    held_out
}

/// The share of the selected examples that the clauses decide as labeled, by naive evaluation.
fn accuracy(task: &Task, bodies: &[&Body], of: impl Fn(usize) -> bool) -> f64 {
    let cases = task.cases.iter().enumerate().filter(|(case, _)| of(*case));
    let (mut right, mut all) = (0.0, 0.0);
    for (_, case) in cases {
        let fires = bodies.iter().any(|body| body.holds(&task.vocabulary, &case.state));
        right += f64::from(u8::from(fires == case.is_positive));
        all += 1.0;
    }
    right / all
}
