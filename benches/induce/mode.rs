//! A mode of Safe Path Following with its recorded episodes, as examples of the learner.

use logicity::builtin::BuiltinFiles;
use logicity::city::{Action, Split};
use logicity::diag::Sources;
use logicity::induce::{Examples, LearnedRules, Predicate, State, Vocabulary};
use logicity::sim::{LoadedCity, ObservedColumn};
use logicity::task::spf::{ControlMode, ControlledCar, Env, EpisodeSet, SpfTask};
use std::path::Path;
use std::sync::Arc;

/// The actions, the one with the highest precedence first.
const ORDER: [Action; 4] = [Action::Stop, Action::Slow, Action::Fast, Action::Normal];

/// A mode with its recorded episodes.
pub struct Mode {
    task: Arc<SpfTask>,
    train: EpisodeSet,
    test: EpisodeSet,
    pub vocabulary: Vocabulary,
}

impl Mode {
    /// Reads the configuration and the episodes of a mode.
    pub fn load(mode: &str) -> Mode {
        let mut sources = Sources::new();
        let path = format!("configs/{mode}.yaml");
        let city = LoadedCity::load(&mut sources, Path::new(&path), None, &BuiltinFiles).expect("a mode");
        let world = Arc::new(city.world().expect("a world"));
        let task = Arc::new(SpfTask::new(Arc::clone(&world), &sources).expect("a task"));
        let mut load = |split| EpisodeSet::load(&task, split, &mut sources, &BuiltinFiles).expect("episodes");
        let (train, test) = (load(Split::Train), load(Split::Test));
        let predicate = |column: ObservedColumn| Predicate {
            arity: column.arity,
            is_symmetric: column.name == "IsClose" || column.name == "NextTo",
            name: column.name,
        };
        let predicates = task.oracle().columns().into_iter().map(predicate).collect();
        Mode {
            task,
            train,
            test,
            vocabulary: Vocabulary::new(predicates, 1, Some("Sees".into())),
        }
    }

    /// Returns what a car observes.
    pub fn state(&self, car: &ControlledCar) -> State {
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
    pub fn demonstrations(&self) -> Vec<Vec<(State, usize)>> {
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

    /// Returns steps as examples.
    pub fn examples<'a>(&self, steps: impl Iterator<Item = &'a (State, usize)>) -> Examples {
        let names = ORDER.iter().map(|action| action.name().to_owned()).collect();
        let mut examples = Examples::new(self.vocabulary.clone(), names);
        for (state, action) in steps {
            examples.push(state.clone(), *action);
        }
        examples
    }

    /// Returns the share of test episodes in which a car that follows the rules reaches the goal without a violation.
    pub fn success(&self, rules: &LearnedRules) -> f64 {
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
