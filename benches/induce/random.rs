//! Random rule sets, learned from random scenes, then with questions, then with a sweep over all small scenes.

use crate::cpu;
use crate::target::{ACTIONS, Clause, Task, action, city, clauses_of, difference, random_rules, random_state};
use logicity::cancel::Cancel;
use logicity::induce::ask::{AskSettings, Bound, End, Event, Failure, Refinement};
use logicity::induce::{Examples, Settings, State};
use logicity::rng::{Purpose, RngExt, Seed};
use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

const RULES: Purpose = Purpose::new(1000);
const SCENES: Purpose = Purpose::new(1001);

/// Number of scenes from which rules are learned, and number of fresh scenes on which they are measured.
const SCENES_COUNT: usize = 10_000;
/// The scenes that the learner asks at the end.
const SWEEP: Bound = Bound { facts: 3, entities: 3 };
/// Random scenes in a row without a surprise after which the sweep begins.
const AGREEMENTS: usize = 200;
/// Time between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(10);

/// What is known about one rule set.
struct Row {
    clauses: usize,
    accuracy: f64,
    /// Whether the rules are equivalent to the true ones: from scenes, with questions, with the sweep.
    exact: [bool; 3],
    questions: usize,
    end: End,
    /// CPU seconds: of the scenes, of the questions and of the sweep.
    seconds: [f64; 3],
}

/// Prints how exactly random rule sets are learned.
pub fn table(root: &Path, range: Range<u64>) {
    let (task, _) = city(root, "hard");
    println!("                        exact from              CPU seconds of");
    println!("set  clauses  accuracy  scenes questions sweep  scenes questions  sweep  questions  end");
    let mut rows = Vec::new();
    for index in range {
        let row = measure(&task, index);
        let mark = |is_exact: bool| if is_exact { "yes" } else { "no" };
        println!(
            "{index:3} {:8} {:9.4}  {:>6} {:>9} {:>5} {:7.1} {:9.1} {:6.1} {:10}  {}",
            row.clauses,
            row.accuracy,
            mark(row.exact[0]),
            mark(row.exact[1]),
            mark(row.exact[2]),
            row.seconds[0],
            row.seconds[1],
            row.seconds[2],
            row.questions,
            match &row.end {
                End::Certified(_, scenes) => format!("certified on {scenes} scenes"),
                end => format!("{end:?}"),
            }
        );
        rows.push(row);
    }
    let exact = [0, 1, 2].map(|stage| rows.iter().filter(|row| row.exact[stage]).count());
    println!(
        "{} rule sets: least accuracy {:.4}; exact from scenes {}, with questions {}, with questions and sweep {}; \
         at most {} questions; {:.0} CPU seconds",
        rows.len(),
        rows.iter().map(|row| row.accuracy).fold(1.0, f64::min),
        exact[0],
        exact[1],
        exact[2],
        rows.iter().map(|row| row.questions).max().unwrap_or(0),
        rows.iter().flat_map(|row| row.seconds).sum::<f64>(),
    );
}

fn measure(task: &Task, index: u64) -> Row {
    let truth = random_rules(task, 3..=15, 2..=5, &mut Seed(0).stream(RULES, index, 0));
    let mut scenes = Seed(0).stream(SCENES, index, 0);
    let mut draw = || {
        let state = random_state(task, scenes.random_range(1..=5), &mut scenes);
        let action = action(&task.vocabulary, &truth, &state);
        (state, action)
    };
    let mut examples = Examples::new(task.vocabulary.clone(), ACTIONS.map(str::to_owned).to_vec());
    for _ in 0..SCENES_COUNT {
        let (state, action) = draw();
        examples.push(state, action);
    }
    let refinement = Refinement {
        examples,
        constraints: task.constraints.clone(),
        learning: Settings::default(),
        asking: AskSettings {
            agreements: AGREEMENTS,
            sweep: Some(SWEEP),
            ..AskSettings::default()
        },
        log: Vec::new(),
    };
    let mut oracle = |state: &State| -> Result<usize, Failure> { Ok(action(&task.vocabulary, &truth, state)) };
    // After each stage: the rules and the CPU time.
    let mut stages: Vec<(Vec<Clause>, f64)> = vec![(Vec::new(), cpu::seconds())];
    let (mut latest, mut asked, mut in_sweep, mut questions) = (Vec::new(), 0, false, 0);
    let mut reported = Instant::now();
    let mut observe = |event: Event<'_>| {
        match event {
            Event::Answered { .. } => {
                asked += 1;
                questions += usize::from(!in_sweep);
            }
            Event::Learned(rules) => {
                latest = clauses_of(&rules.actions);
                if stages.len() == 1 {
                    stages.push((latest.clone(), cpu::seconds()));
                }
            }
            Event::Sweep(..) => {
                in_sweep = true;
                stages.push((latest.clone(), cpu::seconds()));
            }
        }
        if reported.elapsed() > PROGRESS {
            reported = Instant::now();
            eprintln!("set {index}: {} clauses after {asked} answers", latest.len());
        }
    };
    let refined = refinement.run(&mut oracle, &mut observe, &Cancel::never());
    while stages.len() < 4 {
        stages.push((clauses_of(&refined.rules.actions), cpu::seconds()));
    }
    let fresh = (0..SCENES_COUNT).map(|_| draw());
    let right = fresh.filter(|(state, taken)| action(&task.vocabulary, &stages[1].0, state) == *taken);
    Row {
        clauses: truth.len(),
        accuracy: right.count() as f64 / SCENES_COUNT as f64,
        exact: [1, 2, 3].map(|stage| difference(task, &stages[stage].0, &truth).is_none()),
        questions,
        end: refined.end,
        seconds: [1, 2, 3].map(|stage| stages[stage].1 - stages[stage - 1].1),
    }
}
