//! Measures how many questions the learner needs.
//!
//! `cargo bench --bench induce -- questions` prints, for each rule set of the city, the questions until the rules learned
//! from nothing are equivalent to the true ones, over ten seeds; and how exactly 50 random rule sets are learned from
//! 10,000 random scenes each, with and without questions. The comparisons are exact.

#[path = "induce/target.rs"]
mod target;

use logicity::cancel::Cancel;
use logicity::induce::ask::{AskSettings, Bound, End, Event, Failure, Refined, Refinement};
use logicity::induce::{ActionRules, Examples, Settings, State};
use logicity::rng::{Purpose, RngExt, Seed};
use std::path::Path;
use std::time::Instant;
use target::{ACTIONS, Clause, Task, action, city, clauses_of, difference, random_rules, random_state};

const COMMON: [&str; 8] = [
    "IsPedestrian",
    "IsCar",
    "IsAmbulance",
    "IsOld",
    "IsTiro",
    "IsAtInter",
    "IsInInter",
    "HigherPri",
];
const MEDIUM: [&str; 4] = ["CollidingClose", "IsBus", "NextTo", "RightOf"];
const HARD: [&str; 5] = ["IsPolice", "IsReckless", "IsYoung", "IsClose", "LeftOf"];

const RULES: Purpose = Purpose::new(1000);
const SCENES: Purpose = Purpose::new(1001);

/// Returns the predicates of a mode of the city.
fn names(mode: &str) -> Vec<&'static str> {
    match mode {
        "easy" => [&COMMON[..], &MEDIUM[..1]].concat(),
        "medium" => [&COMMON[..], &MEDIUM].concat(),
        _ => [&COMMON[..], &MEDIUM, &HARD].concat(),
    }
}

fn no_examples(task: &Task) -> Examples {
    Examples::new(task.vocabulary.clone(), ACTIONS.map(str::to_owned).to_vec())
}

/// Refines rules with questions to the true clauses. Returns the result and the number of questions after which the
/// learned rules stayed equivalent to the true ones; `None` if they are not.
fn refine(task: &Task, truth: &[Clause], examples: Examples, asking: AskSettings) -> (Refined, Option<usize>) {
    let refinement = Refinement {
        examples,
        constraints: task.constraints.clone(),
        learning: Settings::default(),
        asking,
        log: Vec::new(),
    };
    let mut oracle = |state: &State| -> Result<usize, Failure> { Ok(action(&task.vocabulary, truth, state)) };
    let (mut asked, mut equal_since): (usize, Option<usize>) = (0, None);
    let is_equal = |rules: &[ActionRules]| difference(task, &clauses_of(rules), truth).is_none();
    let mut observe = |event: Event<'_>| match event {
        Event::Answered { .. } => asked += 1,
        Event::Learned(rules) => {
            equal_since = if is_equal(&rules.actions) {
                equal_since.or(Some(asked))
            } else {
                None
            }
        }
        Event::Sweep(..) => {}
    };
    let refined = refinement.run(&mut oracle, &mut observe, &Cancel::never());
    (refined, equal_since)
}

/// Prints the questions from nothing.
fn from_nothing(root: &Path) {
    println!("mode    questions until equivalent, from nothing (seeds 0 to 9)          worst  seconds");
    for mode in ["easy", "medium", "hard", "expert"] {
        let (task, truth) = city(&root.join(format!("rules/{mode}.dl")), &names(mode));
        let begin = Instant::now();
        let counts: Vec<Option<usize>> = (0..10)
            .map(|seed| {
                let asking = AskSettings {
                    seed,
                    ..AskSettings::default()
                };
                refine(&task, &truth, no_examples(&task), asking).1
            })
            .collect();
        print_counts(mode, &counts, begin);
    }
}

fn print_counts(mode: &str, counts: &[Option<usize>], begin: Instant) {
    let texts: Vec<String> = (counts.iter())
        .map(|count| count.map_or("never".to_owned(), |count| count.to_string()))
        .collect();
    let worst = counts
        .iter()
        .copied()
        .collect::<Option<Vec<_>>>()
        .and_then(|counts| counts.into_iter().max());
    let worst = worst.map_or("never".to_owned(), |worst| worst.to_string());
    println!(
        "{mode:7} {:64} {worst:>6} {:>8.2}",
        texts.join(" "),
        begin.elapsed().as_secs_f64()
    );
}

/// Prints how exactly random rule sets are learned, from scenes and then with questions and a sweep.
fn random(root: &Path, count: u64) {
    let (task, _) = city(&root.join("rules/hard.dl"), &names("hard"));
    println!("set  clauses  accuracy  exact from scenes  with questions  and sweep  questions  end          seconds");
    let (mut sums, mut worst) = ([0; 3], 1.0_f64);
    for index in 0..count {
        let truth = random_rules(&task, 3..=15, 2..=5, &mut Seed(0).stream(RULES, index, 0));
        let mut scenes = Seed(0).stream(SCENES, index, 0);
        let mut draw = || {
            let state = random_state(&task, scenes.random_range(1..=5), &mut scenes);
            let action = action(&task.vocabulary, &truth, &state);
            (state, action)
        };
        let mut examples = no_examples(&task);
        for _ in 0..10_000 {
            let (state, action) = draw();
            examples.push(state, action);
        }
        let begin = Instant::now();
        let refinement = Refinement {
            examples,
            constraints: task.constraints.clone(),
            learning: Settings::default(),
            asking: AskSettings {
                sweep: Some(Bound { facts: 3, entities: 3 }),
                ..AskSettings::default()
            },
            log: Vec::new(),
        };
        let mut oracle = |state: &State| -> Result<usize, Failure> { Ok(action(&task.vocabulary, &truth, state)) };
        let is_exact = |rules: &[Clause]| difference(&task, rules, &truth).is_none();
        let (mut first, mut latest, mut asked, mut before_sweep) = (None, Vec::new(), 0, None);
        let mut observe = |event: Event<'_>| match event {
            Event::Answered { .. } => asked += usize::from(before_sweep.is_none()),
            Event::Learned(rules) => {
                latest = clauses_of(&rules.actions);
                first.get_or_insert_with(|| latest.clone());
            }
            Event::Sweep(..) => before_sweep = Some(latest.clone()),
        };
        let refined = refinement.run(&mut oracle, &mut observe, &Cancel::never());
        let (first, before_sweep) = (first.unwrap_or_default(), before_sweep.unwrap_or_default());
        let right = (0..10_000)
            .filter(|_| {
                let (state, taken) = draw();
                action(&task.vocabulary, &first, &state) == taken
            })
            .count();
        let accuracy = right as f64 / 10_000.0;
        let exact = [first, before_sweep, clauses_of(&refined.rules.actions)].map(|rules| is_exact(&rules));
        let end = match refined.end {
            End::Certified(_, scenes) => format!("{scenes} scenes"),
            end => format!("{end:?}"),
        };
        println!(
            "{index:3} {:8} {accuracy:9.4} {:18} {:15} {:10} {asked:10}  {end} {:8.1}",
            truth.len(),
            exact[0],
            exact[1],
            exact[2],
            begin.elapsed().as_secs_f64()
        );
        worst = worst.min(accuracy);
        sums.iter_mut()
            .zip(exact)
            .for_each(|(sum, exact)| *sum += u64::from(exact));
    }
    println!(
        "least accuracy {worst:.4}; exact from scenes {} of {count}, with questions {}, with questions and sweep {}",
        sums[0], sums[1], sums[2]
    );
}

fn main() {
    let root = Path::new(option_env!("LOGICITY_ROOT").unwrap_or(env!("CARGO_MANIFEST_DIR")));
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .collect();
    let wants = |name: &str| arguments.is_empty() || arguments.iter().any(|argument| argument == name);
    if wants("questions") || wants("nothing") {
        from_nothing(root);
    }
    if wants("questions") || wants("random") {
        random(
            root,
            arguments.get(1).and_then(|count| count.parse().ok()).unwrap_or(50),
        );
    }
}
