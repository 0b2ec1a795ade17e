//! Compares the rule learner with baselines, and on tasks in the format of Popper.
//!
//! `cargo bench --bench induce_baselines -- demonstrations [MODE...]` learns from the recorded training episodes of the
//! modes of Safe Path Following. It prints the accuracy on the steps of the test episodes and the CPU seconds, for FOIL
//! with beams of 20 and 200 clauses and for the learner. `python/benches/induce_baselines.py` does so for FOLD-RM.
//!
//! `cargo bench --bench induce_baselines -- popper [FOLDER]` learns random tasks of `tests/datalog/popper_tasks.rs`,
//! and those in the subfolders of a folder, each with `bk.pl`, `exs.pl` and `bias.pl`: `examples` of Popper, or the
//! folder that `Demonstrations.to_popper` writes. It prints the accuracy on the examples, the accuracy on the last
//! fifth of the examples of each label learned from the others, the seconds and the clauses. A task has at most 60
//! seconds. `popper FOLDER VARIABLES` learns clauses with at most that many variables; without it, `max_vars` decides.

mod foil;
#[path = "../../tests/datalog/popper_tasks.rs"]
mod popper_tasks;
#[path = "../../tests/city/shipped_world.rs"]
mod shipped_world;

use foil::Foil;
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, Split};
use logicity::diag::{Sources, render};
use logicity::induce::popper::{self, Files, Options, Task, read, solve};
use logicity::induce::{Body, Examples, Predicate, Settings, State, VARIABLES_MAX, Vocabulary, learn};
use logicity::task::spf::{ControlMode, Env, EpisodeSet};
use popper_tasks::{TARGETS, Texts, family, pieces, trains};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The time limit of a task.
const LIMIT: Duration = Duration::from_secs(60);

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let rest = arguments.get(1..).unwrap_or_default();
    match arguments.first().map(String::as_str) {
        Some("demonstrations") => demonstrations(rest),
        Some("popper") => tasks(rest),
        _ => eprintln!(
            "usage: cargo bench --bench induce_baselines -- demonstrations [MODE...] | popper [FOLDER [VARIABLES]]"
        ),
    }
}

/// The actions in the order of precedence.
const ACTIONS: [Action; 4] = [Action::Stop, Action::Slow, Action::Fast, Action::Normal];

/// Labeled states: the steps of the recorded episodes of a split.
fn steps(mode: &str, split: Split) -> (Vocabulary, Vec<(State, usize)>) {
    let task = shipped_world::task(mode, None);
    let world = task.world();
    let predicates: Vec<Predicate> = (world.vocabulary.predicates.iter().enumerate())
        .filter(|(index, _)| *index != world.vocabulary.sees)
        .map(|(_, predicate)| Predicate {
            name: predicate.name.clone(),
            arity: predicate.arity,
            is_symmetric: false,
        })
        .collect();
    let vocabulary = Vocabulary::new(predicates, 1, Some("Sees".to_owned()));
    let set = EpisodeSet::load(&task, split, &mut Sources::new(), &BuiltinFiles).expect("it is built in");
    let mut env = Env::new(Arc::clone(&task), split, ControlMode::First).expect("the city is valid");
    let mut row = vec![0.0; task.oracle().width()];
    let most = task.oracle().entities();
    let mut steps = Vec::new();
    for episode in &set.episodes {
        env.reset_to(episode).expect("the episode fits the city");
        while env.controlled_cars()[0].is_running() {
            let observer = env.controlled_cars()[0].observer();
            observer.write(&mut row);
            let mut state = State::new(&vocabulary, observer.entities().len());
            let mut rest = row.as_slice();
            for (index, predicate) in vocabulary.predicates().iter().enumerate() {
                let (own, after) = rest.split_at(most.pow(predicate.arity as u32));
                rest = after;
                for (at, _) in own.iter().enumerate().filter(|(_, value)| **value > 0.5) {
                    match predicate.arity {
                        1 => state.insert(&vocabulary, index, &[at]),
                        _ => state.insert(&vocabulary, index, &[at / most, at % most]),
                    }
                }
            }
            let action = env.oracle_action(0);
            let label = ACTIONS.iter().position(|known| *known == action).expect("one of four");
            steps.push((state, label));
            env.step(&[action]).expect("the rules decide");
        }
    }
    (vocabulary, steps)
}

/// Returns the clauses of each action but the last.
type Learner<'a> = dyn Fn(&Examples) -> Vec<Vec<Body>> + 'a;

fn demonstrations(modes: &[String]) {
    let modes: Vec<&str> = match modes {
        [] => shipped_world::SPF_MODES.to_vec(),
        named => named.iter().map(String::as_str).collect(),
    };
    println!("| mode | learner | accuracy on test steps | CPU seconds | clauses | literals |");
    println!("|---|---|---|---|---|---|");
    for mode in modes {
        let (vocabulary, training) = steps(mode, Split::Train);
        let (_, test) = steps(mode, Split::Test);
        let actions = ACTIONS.iter().map(|action| format!("{action:?}")).collect();
        let mut examples = Examples::new(vocabulary, actions);
        for (state, label) in training {
            examples.push(state, label);
        }
        let foil = |width| move |examples: &Examples| Foil { width, variables: 3 }.learn(examples);
        let own = |examples: &Examples| -> Vec<Vec<Body>> {
            let rules = learn(examples, &Settings::default(), &Cancel::never());
            let bodies = rules
                .actions
                .into_iter()
                .map(|rules| rules.clauses.into_iter().map(|clause| clause.body).collect());
            bodies.collect()
        };
        let learners: [(&str, &Learner<'_>); 3] = [
            ("FOIL, width 20", &foil(20)),
            ("FOIL, width 200", &foil(200)),
            ("logicity", &own),
        ];
        for (name, learner) in learners {
            let (begin, mut runs) = (cpu_seconds(), 1.0);
            let rules = learner(&examples);
            // The clock has ticks of 10 ms.
            while cpu_seconds() - begin < 0.5 {
                learner(&examples);
                runs += 1.0;
            }
            let seconds = (cpu_seconds() - begin) / runs;
            let right = test
                .iter()
                .filter(|(state, label)| decide(examples.vocabulary(), &rules, state) == *label);
            let accuracy = right.count() as f64 / test.len() as f64;
            let clauses: usize = rules.iter().map(Vec::len).sum();
            let literals: usize = rules.iter().flatten().map(|body| body.0.len()).sum();
            println!("| {mode} | {name} | {accuracy:.4} | {seconds:.2} | {clauses} | {literals} |");
        }
    }
}

/// The user time of this process, of all threads.
fn cpu_seconds() -> f64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    let ticks: f64 = after
        .split_whitespace()
        .nth(11)
        .and_then(|field| field.parse().ok())
        .unwrap_or(f64::NAN);
    ticks / 100.0
}

/// The action of the first rule that fires, by naive evaluation.
fn decide(vocabulary: &Vocabulary, rules: &[Vec<Body>], state: &State) -> usize {
    let fires = |bodies: &Vec<Body>| bodies.iter().any(|body| holds(vocabulary, body, state));
    rules.iter().position(fires).unwrap_or(rules.len())
}

/// Whether a clause holds in a state: some binding of its variables makes all literals true.
fn holds(vocabulary: &Vocabulary, body: &Body, state: &State) -> bool {
    let variables = body.variables(vocabulary);
    let mut binding: Vec<usize> = (0..vocabulary.egos()).collect();
    extend(vocabulary, body, state, variables, &mut binding)
}

fn extend(vocabulary: &Vocabulary, body: &Body, state: &State, variables: usize, binding: &mut Vec<usize>) -> bool {
    let bound = binding.len();
    // The literals whose last variable is the newest one.
    let decided = body.0.iter().filter(|literal| {
        let last = literal
            .atom
            .arguments
            .iter()
            .max()
            .map_or(0, |&variable| usize::from(variable));
        last + 1 == bound || bound == vocabulary.egos() && last < bound
    });
    let is_true = |literal: &logicity::induce::Literal| {
        let arguments: Vec<usize> = literal
            .atom
            .arguments
            .iter()
            .map(|&variable| binding[usize::from(variable)])
            .collect();
        state.holds(vocabulary, literal.atom.predicate, &arguments) != literal.is_negated
    };
    if !decided.into_iter().all(is_true) {
        return false;
    }
    bound == variables
        || (0..state.entities()).any(|entity| {
            binding.push(entity);
            let found = extend(vocabulary, body, state, variables, binding);
            binding.pop();
            found
        })
}

fn tasks(arguments: &[String]) {
    let most = (arguments.get(1)).map_or(VARIABLES_MAX, |most| most.parse().expect("a number of variables"));
    println!("| task | examples | variables | accuracy | held out | seconds | clauses | literals |");
    println!("|---|---|---|---|---|---|---|---|");
    for target in 0..TARGETS {
        for (name, texts) in [
            ("trains", trains(1, target, 1000)),
            ("pieces", pieces(1, target, 200)),
            ("family", family(1, target, 100)),
        ] {
            measure(&format!("{name}{}", target + 1), &texts, most);
        }
    }
    let Some(folder) = arguments.first() else { return };
    let mut folders = vec![Path::new(folder).to_owned()];
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
            measure(&folder.display().to_string(), &[background, examples, bias], most);
        }
    }
}

/// Learns a task and prints a line.
fn measure(name: &str, [background, examples, bias]: &Texts, most: usize) {
    let mut sources = Sources::new();
    let files = Files {
        background: sources.add("bk.pl", background.as_str()),
        examples: sources.add("exs.pl", examples.as_str()),
        bias: sources.add("bias.pl", bias.as_str()),
    };
    let begin = Instant::now();
    let closed_world = !examples.lines().any(|line| line.trim_start().starts_with("neg("));
    let (task, diagnostics) = read(
        &sources,
        &files,
        &Options {
            closed_world,
            ..Options::default()
        },
    );
    let Some(task) = task else {
        let fault = diagnostics.iter().find(|fault| fault.is_error());
        let shown = render(fault.map(std::slice::from_ref).unwrap_or_default(), &sources, false);
        println!("| {name} | {} |", shown.lines().next().unwrap_or_default());
        return;
    };
    let solution = learned(&task, most, |_| true);
    let seconds = begin.elapsed().as_secs_f64();
    // The last fifth of the examples of each label.
    let mut held_out = vec![false; task.cases.len()];
    for label in [true, false] {
        let own: Vec<usize> = (0..task.cases.len())
            .filter(|&case| task.cases[case].is_positive == label)
            .collect();
        own.iter()
            .skip(own.len() * 4 / 5)
            .for_each(|&case| held_out[case] = true);
    }
    let rest = match held_out.iter().filter(|held_out| **held_out).count() {
        // Too few examples to hold some out.
        0..4 => "-".to_owned(),
        _ => format!(
            "{:.3}",
            accuracy(&task, &learned(&task, most, |case| !held_out[case]), |case| held_out
                [case])
        ),
    };
    let clauses = &solution.rules.clauses;
    let cut = if solution.is_cut { " (cut)" } else { "" };
    println!(
        "| {name} | {} | {} | {:.3} | {rest} | {seconds:.2}{cut} | {} | {} |",
        task.cases.len(),
        solution.variables,
        accuracy(&task, &solution, |_| true),
        clauses.len(),
        clauses.iter().map(|clause| clause.body.0.len()).sum::<usize>()
    );
    if clauses.len() <= 4 {
        task.clauses(&solution.rules)
            .iter()
            .for_each(|clause| println!("| | `{clause}` |"));
    }
}

fn learned(task: &Task, most: usize, keep: impl Fn(usize) -> bool) -> popper::Solution {
    let deadline = Instant::now() + LIMIT;
    let cancel = Cancel::when(move || Instant::now() > deadline);
    let settings = Settings {
        variables: task.variables.min(most),
        ..task.settings()
    };
    solve(&task.vocabulary, &task.examples(keep), &settings, &cancel)
}

/// The share of the selected examples that the clauses decide as labeled, by naive evaluation.
fn accuracy(task: &Task, solution: &popper::Solution, of: impl Fn(usize) -> bool) -> f64 {
    let cases: Vec<_> = task
        .cases
        .iter()
        .enumerate()
        .filter(|(case, _)| of(*case))
        .map(|(_, case)| case)
        .collect();
    let fires = |case: &&&popper::Case| {
        let mut clauses = solution.rules.clauses.iter();
        clauses.any(|clause| holds(&task.vocabulary, &clause.body, &case.state)) == case.is_positive
    };
    cases.iter().filter(fires).count() as f64 / cases.len() as f64
}
