//! Tables of the rule learner on the recorded episodes: examples with wrong actions, few demonstrations, many examples.
//!
//! `cargo bench --bench induce_noise` prints all tables; `-- noise`, `-- subsets` or `-- million` prints one.

use logicity::builtin::BuiltinFiles;
use logicity::cancel::Cancel;
use logicity::city::{Action, Split};
use logicity::diag::Sources;
use logicity::induce::{Examples, Learned, Noise, Predicate, Settings, State, Vocabulary, learn};
use logicity::rng::{Purpose, RngExt, Seed};
use logicity::sim::LoadedCity;
use logicity::task::spf::{ControlMode, ControlledCar, Env, EpisodeSet, SpfTask};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

const ORDER: [Action; 4] = [Action::Stop, Action::Slow, Action::Fast, Action::Normal];
const DRAWS: Purpose = Purpose::new(u64::MAX);

/// A mode with its recorded episodes.
struct Mode {
    task: Arc<SpfTask>,
    train: EpisodeSet,
    test: EpisodeSet,
    vocabulary: Vocabulary,
}

impl Mode {
    fn load(mode: &str) -> Mode {
        let mut sources = Sources::new();
        let path = format!("configs/{mode}.yaml");
        let city = LoadedCity::load(&mut sources, Path::new(&path), None, &BuiltinFiles).expect("a mode");
        let world = Arc::new(city.world().expect("a world"));
        let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).expect("a task"));
        let mut load = |split| EpisodeSet::load(&task, split, &mut sources, &BuiltinFiles).expect("episodes");
        let (train, test) = (load(Split::Train), load(Split::Test));
        let predicates = (task.oracle().columns())
            .map(|(position, _)| {
                let predicate = &world.vocabulary.predicates[position];
                let name = predicate.name.to_string();
                Predicate {
                    arity: predicate.arity,
                    is_symmetric: name == "IsClose" || name == "NextTo",
                    name,
                }
            })
            .collect();
        Mode {
            task,
            train,
            test,
            vocabulary: Vocabulary::new(predicates, 1, Some("Sees".into())),
        }
    }

    /// Returns what a car observes.
    fn state(&self, car: &ControlledCar) -> State {
        let mut values = vec![0.0; self.task.observation_width()];
        car.observer().write(&mut values);
        let entities = self.task.oracle().entities();
        let mut state = State::new(&self.vocabulary, car.observer().entities().len());
        let mut values = values.into_iter();
        for (index, predicate) in self.vocabulary.predicates().iter().enumerate() {
            for number in 0..entities.pow(predicate.arity as u32) {
                let arguments = [number / entities, number % entities];
                if values.next().is_some_and(|value| value > 0.5) {
                    state.insert(&self.vocabulary, index, &arguments[2 - predicate.arity..]);
                }
            }
        }
        state
    }

    /// Returns the states and actions of each demonstration.
    fn demonstrations(&self) -> Vec<Vec<(State, usize)>> {
        let mut env = Env::new(Arc::clone(&self.task), Split::Train, ControlMode::First).expect("an environment");
        let mut all = Vec::new();
        for episode in &self.train.episodes {
            env.reset_to(episode).expect("an episode");
            let mut steps = Vec::new();
            while env.controlled_cars()[0].is_running() {
                let action = env.oracle_action(0);
                let index = ORDER.iter().position(|other| *other == action).expect("an action");
                steps.push((self.state(&env.controlled_cars()[0]), index));
                env.step(&[action]).expect("within limits");
            }
            all.push(steps);
        }
        all
    }

    fn examples<'a>(&self, steps: impl Iterator<Item = &'a (State, usize)>) -> Examples {
        let names = ORDER.iter().map(|action| action.name().to_owned()).collect();
        let mut examples = Examples::new(self.vocabulary.clone(), names);
        for (state, action) in steps {
            examples.push(state.clone(), *action);
        }
        examples
    }

    /// Returns the share of test episodes in which a car that follows the rules reaches the goal without a violation.
    fn success(&self, rules: &Learned) -> f64 {
        let mut env = Env::new(Arc::clone(&self.task), Split::Test, ControlMode::First).expect("an environment");
        let mut successes = 0;
        for episode in &self.test.episodes {
            env.reset_to(episode).expect("an episode");
            env.set_horizon(episode.horizon(self.task.config()));
            while env.controlled_cars()[0].is_running() {
                let state = self.state(&env.controlled_cars()[0]);
                let action = ORDER[rules.decide(&self.vocabulary, &[&state])[0]];
                env.step(&[action]).expect("within limits");
            }
            successes += usize::from(env.controlled_cars()[0].last().success);
        }
        successes as f64 / self.test.episodes.len() as f64
    }
}

fn noise() {
    println!("mode    rate   seed  known TSR  clauses     s   auto TSR  estimate  clauses     s");
    for name in ["easy", "medium", "hard", "expert"] {
        let mode = Mode::load(name);
        let steps: Vec<(State, usize)> = mode.demonstrations().concat();
        for rate in [0.0, 0.001, 0.005, 0.01, 0.02, 0.05] {
            for seed in 0..3 {
                let mut random = Seed(seed).stream(DRAWS, (rate * 10_000.0) as u64, 0);
                let flipped: Vec<(State, usize)> = (steps.iter())
                    .map(|(state, action)| {
                        let by = if random.random_bool(rate) {
                            random.random_range(1..4)
                        } else {
                            0
                        };
                        (state.clone(), (action + by) % 4)
                    })
                    .collect();
                let examples = mode.examples(flipped.iter());
                let row = |noise| {
                    let begin = Instant::now();
                    let settings = Settings {
                        noise,
                        ..Settings::default()
                    };
                    let rules = learn(&examples, &settings, &Cancel::never());
                    (
                        mode.success(&rules),
                        rules.bodies().len(),
                        begin.elapsed().as_secs_f64(),
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

/// Learns from random scenes of one to eight entities in which rules learned from the demonstrations decide.
fn million() {
    let mode = Mode::load("expert");
    let steps = mode.demonstrations().concat();
    let rules = learn(&mode.examples(steps.iter()), &Settings::default(), &Cancel::never());
    for density in [0.1, 0.3] {
        let mut random = Seed(1).stream(DRAWS, 0, 2);
        let mut examples = mode.examples(std::iter::empty());
        while examples.count() < 1_000_000 {
            let states: Vec<State> = (0..10_000)
                .map(|_| {
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
                })
                .collect();
            let actions = rules.decide(&mode.vocabulary, &states.iter().collect::<Vec<_>>());
            for (state, action) in states.into_iter().zip(actions) {
                examples.push(state, action);
            }
        }
        let begin = Instant::now();
        let learned = learn(&examples, &Settings::default(), &Cancel::never());
        let seconds = begin.elapsed().as_secs_f64();
        let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
        let decided = learned.decide(&mode.vocabulary, &states);
        let is_right =
            |((_, tallies), action): &((&State, &[logicity::induce::Tally]), usize)| tallies[*action].count > 0;
        let right = examples.states().zip(decided).filter(is_right).count();
        println!(
            "density {density}: {} examples, {} states, {} learned from, {} clauses, {right} right, {seconds:.1} s",
            examples.count(),
            states.len(),
            learned.working_states,
            learned.bodies().len()
        );
    }
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
