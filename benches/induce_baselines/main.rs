//! Compares the rule learner with baselines on recorded demonstrations.
//!
//! `cargo bench --bench induce_baselines -- demonstrations [MODE...]` learns from the recorded training episodes of the
//! modes of Safe Path Following. It prints the accuracy on the steps of the test episodes and the CPU seconds, for FOIL
//! with beams of 20 and 200 clauses and for the learner. `python/benches/induce_baselines.py` does so for FOLD-RM.

mod foil;
#[path = "../../tests/city/shipped_world.rs"]
mod shipped_world;

use foil::Foil;
use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, Split};
use logicity::diag::Sources;
use logicity::induce::{Body, Examples, Predicate, Settings, State, Vocabulary, learn};
use logicity::task::spf::{ControlMode, Env, EpisodeSet};
use std::fs;
use std::sync::Arc;

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let rest = arguments.get(1..).unwrap_or_default();
    match arguments.first().map(String::as_str) {
        Some("demonstrations") => demonstrations(rest),
        _ => eprintln!("usage: cargo bench --bench induce_baselines -- demonstrations [MODE...]"),
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
    let fires = |bodies: &Vec<Body>| bodies.iter().any(|body| body.holds(vocabulary, state));
    rules.iter().position(fires).unwrap_or(rules.len())
}
