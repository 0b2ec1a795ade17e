//! Measures how many questions the learner needs, and how exactly it learns random rules.
//!
//! `cargo bench --bench induce -- questions` prints, for each rule set of the city, the questions until the learned
//! rules are equivalent to the true ones: from nothing, and from the 100 training demonstrations. `-- nothing` and
//! `-- demonstrations` print one of the two tables; names of modes choose rows.
//!
//! `cargo bench --bench induce -- random` learns 50 random rule sets from 10,000 random scenes each, then with
//! questions, then with a sweep. `-- random 10..20` learns ten of them.
//!
//! The comparisons with the true rules are exact.

#[path = "induce/cpu.rs"]
mod cpu;
#[path = "induce/mode.rs"]
mod mode;
#[path = "induce/random.rs"]
mod random;
#[path = "induce/target.rs"]
mod target;

use logicity::cancel::Cancel;
use logicity::induce::ask::{AskSettings, Event, Failure, Refinement};
use logicity::induce::{Examples, LearnedRules, Settings, State};
use mode::Mode;
use std::path::Path;
use target::{ACTIONS, Clause, Task, action, city, city_over, clauses_of, difference};

const MODES: [&str; 4] = ["easy", "medium", "hard", "expert"];

/// Seeds of the choice of questions.
const SEEDS: u64 = 10;

/// Refines rules with questions to the true clauses, with several seeds. Prints the numbers of questions after which
/// the learned rules stayed equivalent to the true ones. Returns the rules of the last seed.
fn row(mode: &str, task: &Task, truth: &[Clause], examples: &Examples) -> LearnedRules {
    let begin = cpu::seconds();
    let (mut counts, mut last) = (Vec::new(), LearnedRules::default());
    for seed in 0..SEEDS {
        let refinement = Refinement {
            examples: examples.clone(),
            constraints: task.constraints.clone(),
            learning: Settings::default(),
            asking: AskSettings {
                seed,
                ..AskSettings::default()
            },
            log: Vec::new(),
        };
        let mut oracle = |state: &State| -> Result<usize, Failure> { Ok(action(&task.vocabulary, truth, state)) };
        let (mut asked, mut equal_since): (usize, Option<usize>) = (0, None);
        let mut observe = |event: Event<'_>| match event {
            Event::Answered { .. } => asked += 1,
            Event::Learned(rules) => {
                let is_equal = difference(task, &clauses_of(&rules.actions), truth).is_none();
                equal_since = is_equal.then(|| equal_since.unwrap_or(asked));
            }
            Event::Sweep(..) => {}
        };
        last = refinement.run(&mut oracle, &mut observe, &Cancel::never()).rules;
        counts.push(equal_since);
    }
    let text = |count: Option<usize>| count.map_or("never".to_owned(), |count| count.to_string());
    let worst = counts.iter().copied().collect::<Option<Vec<usize>>>();
    let texts: Vec<String> = counts.into_iter().map(text).collect();
    print!(
        "{mode:7} {:52} {:>6} {:11.2}",
        texts.join(" "),
        text(worst.and_then(|counts| counts.into_iter().max())),
        (cpu::seconds() - begin) / SEEDS as f64
    );
    last
}

fn from_nothing(root: &Path, modes: &[&str]) {
    println!("from nothing: questions until equivalent, by seed             worst  CPU s a run");
    for mode in modes {
        let (task, truth) = city(root, mode);
        let examples = Examples::new(task.vocabulary.clone(), ACTIONS.map(str::to_owned).to_vec());
        row(mode, &task, &truth, &examples);
        println!();
    }
}

fn from_demonstrations(root: &Path, modes: &[&str]) {
    println!("from 100 demonstrations: questions until equivalent, by seed  worst  CPU s a run   TSR of the last");
    for name in modes {
        let mode = Mode::load(name);
        let names: Vec<&str> = mode
            .vocabulary
            .predicates()
            .iter()
            .map(|predicate| &*predicate.name)
            .collect();
        let (task, truth) = city_over(root, name, &names);
        let steps = mode.demonstrations().concat();
        let rules = row(name, &task, &truth, &mode.examples(steps.iter()));
        println!("  {:15.2}", mode.success(&rules));
    }
}

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .collect();
    let names = |name: &str| arguments.iter().any(|argument| argument == name);
    let wants = |name: &str| arguments.is_empty() || names(name);
    let mut modes: Vec<&str> = MODES.into_iter().filter(|mode| names(mode)).collect();
    if modes.is_empty() {
        modes = MODES.to_vec();
    }
    if wants("questions") || names("nothing") {
        from_nothing(root, &modes);
    }
    if wants("questions") || names("demonstrations") {
        from_demonstrations(root, &modes);
    }
    if wants("random") {
        let range = arguments.iter().find_map(|argument| {
            let (begin, end) = argument.split_once("..")?;
            Some(begin.parse().ok()?..end.parse().ok()?)
        });
        random::table(root, range.unwrap_or(0..50));
    }
}
