//! Tables of the rule learner on the recorded episodes: examples with wrong actions, few demonstrations, many examples.
//!
//! `cargo bench --bench induce_noise` prints all tables; `-- noise`, `-- subsets` or `-- million` prints one. Times are
//! CPU seconds of all threads.

#[path = "induce/cpu.rs"]
mod cpu;
#[path = "induce/mode.rs"]
mod mode;

use logicity::cancel::Cancel;
use logicity::induce::{Noise, Settings, State, learn};
use logicity::rng::{Purpose, Rng, RngExt, Seed};
use mode::Mode;
use std::fs;

const DRAWS: Purpose = Purpose::new(u64::MAX);

fn noise() {
    println!("mode    rate   seed  known TSR  clauses     s   auto TSR  estimate  clauses     s");
    for name in ["easy", "medium", "hard", "expert"] {
        let mode = Mode::load(name);
        let steps: Vec<(State, usize)> = mode.demonstrations().concat();
        for rate in [0.0, 0.001, 0.005, 0.01, 0.02, 0.05] {
            for seed in 0..3 {
                let mut random = Seed(seed).stream(DRAWS, (rate * 10_000.0) as u64, 0);
                let flipped: Vec<(State, usize)> = (steps.iter())
                    .map(|(state, action)| (state.clone(), flip(*action, rate, &mut random)))
                    .collect();
                let examples = mode.examples(flipped.iter());
                let row = |noise| {
                    let begin = cpu::seconds();
                    let settings = Settings {
                        noise,
                        ..Settings::default()
                    };
                    let rules = learn(&examples, &settings, &Cancel::never());
                    (
                        mode.success(&rules),
                        rules.bodies().len(),
                        cpu::seconds() - begin,
                        rules.rate,
                    )
                };
                let (known, auto) = (row(Noise::Rate(rate)), row(Noise::Auto));
                println!(
                    "{name:7} {rate:<6} {seed:4}  {:9.2}  {:7}  {:4.1}  {:9.2}  {:8.4}  {:7}  {:4.1}",
                    known.0, known.1, known.2, auto.0, auto.3, auto.1, auto.2
                );
            }
        }
    }
}

fn subsets() {
    println!("mode    demonstrations  mean TSR  worst");
    for name in ["easy", "medium", "hard", "expert"] {
        let mode = Mode::load(name);
        let demonstrations = mode.demonstrations();
        for (count, draws) in [(5, 10), (10, 10), (25, 10), (50, 10), (75, 10), (100, 1)] {
            let mut rates = Vec::new();
            for seed in 0..draws {
                let mut random = Seed(seed).stream(DRAWS, count as u64, 1);
                let mut order: Vec<usize> = (0..demonstrations.len()).collect();
                for last in (1..order.len()).rev() {
                    order.swap(last, random.random_range(0..=last));
                }
                let steps = order[..count.min(order.len())]
                    .iter()
                    .flat_map(|&episode| &demonstrations[episode]);
                let rules = learn(&mode.examples(steps), &Settings::default(), &Cancel::never());
                rates.push(mode.success(&rules));
            }
            let mean = rates.iter().sum::<f64>() / rates.len() as f64;
            let worst = rates.iter().copied().fold(1.0, f64::min);
            println!("{name:7} {count:14}  {mean:8.3}  {worst:5.2}");
        }
    }
}

/// Learns from random scenes of one to eight entities in which rules learned from the demonstrations decide, without
/// wrong actions and with 1 % of them.
fn million() {
    let mode = Mode::load("expert");
    let steps = mode.demonstrations().concat();
    let rules = learn(&mode.examples(steps.iter()), &Settings::default(), &Cancel::never());
    println!(
        "density  wrong actions  noise       examples   states  learned from  clauses  right states       s  peak GiB"
    );
    for density in [0.1, 0.3] {
        for (rate, noise) in [(0.0, Noise::None), (0.01, Noise::Rate(0.01)), (0.01, Noise::Auto)] {
            let mut random = Seed(1).stream(DRAWS, 0, 2);
            let mut flips = Seed(1).stream(DRAWS, 0, 3);
            let mut examples = mode.examples(std::iter::empty());
            while examples.count() < 1_000_000 {
                let states: Vec<State> = (0..10_000).map(|_| scene(&mode, density, &mut random)).collect();
                let actions = rules.decide(&mode.vocabulary, &states.iter().collect::<Vec<_>>());
                for (state, action) in states.into_iter().zip(actions) {
                    examples.push(state, flip(action, rate, &mut flips));
                }
            }
            let settings = Settings {
                noise,
                ..Settings::default()
            };
            let begin = cpu::seconds();
            let learned = learn(&examples, &settings, &Cancel::never());
            let seconds = cpu::seconds() - begin;
            let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
            let [decided, actions] = [&learned, &rules].map(|rules| rules.decide(&mode.vocabulary, &states));
            let right = decided
                .iter()
                .zip(&actions)
                .filter(|(decided, action)| decided == action);
            println!(
                "{density:7}  {rate:13}  {:10} {:9}  {:7}  {:12}  {:7}  {:12}  {seconds:6.1}  {:8.1}",
                format!("{noise:?}"),
                examples.count(),
                states.len(),
                learned.working_states,
                learned.bodies().len(),
                right.count(),
                peak_gib(),
            );
        }
    }
}

/// Returns the largest resident memory of this process so far, in GiB.
fn peak_gib() -> f64 {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / f64::from(1 << 20)
}

/// Draws a scene of one to eight entities.
fn scene(mode: &Mode, density: f64, random: &mut impl Rng) -> State {
    let entities = random.random_range(1..=8);
    let mut state = State::new(&mode.vocabulary, entities);
    for (index, predicate) in mode.vocabulary.predicates().iter().enumerate() {
        for number in 0..entities.pow(predicate.arity as u32) {
            let (one, other) = (number / entities, number % entities);
            let is_drawn = predicate.arity == 1
                || if predicate.is_symmetric {
                    one < other
                } else {
                    one != other
                };
            if is_drawn && random.random_bool(density) {
                state.insert(&mode.vocabulary, index, &[one, other][2 - predicate.arity..]);
                if predicate.is_symmetric {
                    state.insert(&mode.vocabulary, index, &[other, one]);
                }
            }
        }
    }
    state
}

/// Returns an action, or another one at a rate.
fn flip(action: usize, rate: f64, random: &mut impl Rng) -> usize {
    let by = if random.random_bool(rate) {
        random.random_range(1..4)
    } else {
        0
    };
    (action + by) % 4
}

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let tables: [(&str, fn()); 3] = [("noise", noise), ("subsets", subsets), ("million", million)];
    for (_, print) in tables
        .iter()
        .filter(|(name, _)| arguments.is_empty() || arguments.iter().any(|own| own == name))
    {
        print();
    }
}
