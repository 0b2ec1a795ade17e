//! Learns tasks in the format of the learner Popper.
//!
//! `cargo bench --bench popper -- [FOLDER [SECONDS]]` learns random tasks of `tests/city/popper_tasks.rs`, or those in
//! the subfolders of a folder, each with `bk.pl`, `exs.pl` and `bias.pl`: for example `examples` of Popper's repository,
//! or the folder that `Demonstrations.to_popper` writes. A task without negative examples is read under the closed-world
//! assumption. A task whose name begins with `noisy` is learned with `Noise::Auto`.
//!
//! It prints a line for each task: the positive and the negative examples for which the clauses derive the target, the
//! seconds to read and to learn, and whether the task is solved, without an error. A task has 60 seconds unless a limit
//! is given, and one thread, as Popper has.

#[path = "../tests/city/popper_tasks.rs"]
mod popper_tasks;

use logicity::cancel::Cancel;
use logicity::diag::{Sources, render};
use logicity::induce::{Noise, Settings};
use logicity::popper::{Files, Options, read};
use popper_tasks::{TARGETS, Texts, family, pieces, trains};
use std::fs;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let limit = arguments
        .get(1)
        .map_or(60, |seconds| seconds.parse().expect("a number of seconds"));
    let limit = Duration::from_secs(limit);
    println!("| task | positive | negative | read, s | learn, s | clauses | literals | outcome |");
    println!("|---|---|---|---|---|---|---|---|");
    let Some(folder) = arguments.first() else {
        for target in 0..TARGETS {
            for (name, texts) in [
                ("trains", trains(1, target, 1000)),
                ("pieces", pieces(1, target, 200)),
                ("family", family(1, target, 100)),
            ] {
                measure(&format!("{name}{}", target + 1), &texts, limit);
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
            measure(&name, &[background, examples, bias], limit);
        }
    }
}

/// Learns a task and prints a line.
fn measure(name: &str, [background, examples, bias]: &Texts, limit: Duration) {
    let begin = Instant::now();
    let mut sources = Sources::new();
    let files = Files {
        background: sources.add("bk.pl", background.as_str()),
        examples: sources.add("exs.pl", examples.as_str()),
        bias: sources.add("bias.pl", bias.as_str()),
    };
    let options = Options {
        closed_world: !examples.contains("neg("),
        ..Options::default()
    };
    let (task, diagnostics) = read(&sources, &files, &options);
    let Some(task) = task else {
        let fault = diagnostics.iter().find(|fault| fault.is_error());
        let shown = render(fault.map(std::slice::from_ref).unwrap_or_default(), &sources, false);
        let first = shown.lines().next().unwrap_or_default().replace('|', "\\|");
        println!("| {name} | | | | | | | refused: {first} |");
        return;
    };
    let read_seconds = begin.elapsed().as_secs_f64();
    let cancel = Cancel::when(move || begin.elapsed() > limit);
    let settings = Settings {
        threads: NonZeroUsize::new(1),
        noise: if name.starts_with("noisy") {
            Noise::Auto
        } else {
            Noise::None
        },
        ..task.settings()
    };
    let solution = task.solve(|_| true, &settings, &|_| (), &cancel);
    let seconds = begin.elapsed().as_secs_f64() - read_seconds;
    let clauses = &solution.rules.clauses;
    let holds: Vec<Vec<bool>> = clauses.iter().map(|clause| task.holds(&clause.body)).collect();
    let counts = [true, false].map(|label| {
        let cases = (0..task.cases.len()).filter(|&case| task.cases[case].is_positive == label);
        let derived = cases.clone().filter(|&case| holds.iter().any(|holds| holds[case]));
        [derived.count(), cases.count()]
    });
    let [[true_positives, positive], [false_positives, negative]] = counts;
    let outcome = match (true_positives == positive && false_positives == 0, solution.is_cut) {
        (true, false) => "solved",
        (true, true) => "exact, not finished",
        (false, false) if settings.noise != Noise::None => "finished",
        (false, false) => "not separated",
        (false, true) => "not finished",
    };
    println!(
        "| {name} | {true_positives} of {positive} | {false_positives} of {negative} | {read_seconds:.2} | \
         {seconds:.2} | {} | {} | {outcome} |",
        clauses.len(),
        clauses.iter().map(|clause| clause.body.0.len()).sum::<usize>(),
    );
}
