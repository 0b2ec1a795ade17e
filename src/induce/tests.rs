use crate::cancel::Cancel;
use crate::cases::cases;
use crate::induce::bits::{self, Bits};

use crate::induce::cover::cheapest_cover;
use crate::induce::learner::learn_here;
use crate::induce::problem::LabeledColumns;
use crate::induce::rules::clauses_hold;
use crate::induce::search::{EXAMPLE, ExampleSearch};
use crate::induce::vocabulary::tuples;
use crate::induce::{
    Body, Constraints, Examples, LearnedRules, Literal, Noise, Predicate, Settings, State, Vocabulary, learn, support,
};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use proptest::prelude::*;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

const SCENES: Purpose = Purpose::new(u64::MAX);

/// Unary predicates A, B, ... and binary ones, of which the first is symmetric.
fn vocabulary(unary: usize, binary: usize, has_guard: bool) -> Vocabulary {
    let predicate = |index: usize| Predicate {
        name: char::from(b'A' + index as u8).to_string(),
        arity: if index < unary { 1 } else { 2 },
        is_symmetric: index == unary,
    };
    Vocabulary::new(
        (0..unary + binary).map(predicate).collect(),
        1,
        has_guard.then(|| "Sees".into()),
    )
}

/// A state with random facts. Binary ones are irreflexive.
fn state(vocabulary: &Vocabulary, entities: usize, density: f64, random: &mut impl Rng) -> State {
    let mut state = State::new(vocabulary, entities);
    for (index, predicate) in vocabulary.predicates().iter().enumerate() {
        for one in 0..entities {
            if predicate.arity == 1 {
                if random.random_bool(density) {
                    state.insert(vocabulary, index, &[one]);
                }
                continue;
            }
            for other in (0..entities).filter(|&other| other != one) {
                if (!predicate.is_symmetric || one < other) && random.random_bool(density) {
                    state.insert(vocabulary, index, &[one, other]);
                    if predicate.is_symmetric {
                        state.insert(vocabulary, index, &[other, one]);
                    }
                }
            }
        }
    }
    state
}

fn states(vocabulary: &Vocabulary, count: usize, seed: u64) -> Vec<State> {
    let mut random = Seed(seed).stream(SCENES, 0, 0);
    let density = random.random_range(0.2..0.6);
    let mut state = || {
        let entities = random.random_range(1..=4);
        state(vocabulary, entities, density, &mut random)
    };
    (0..count).map(|_| state()).collect()
}

/// Random clauses: for each action but the default one, some bodies.
fn rules(vocabulary: &Vocabulary, actions: usize, seed: u64) -> Vec<Vec<Body>> {
    let mut random = Seed(seed).stream(SCENES, 1, 0);
    let atoms = vocabulary.atoms(3);
    let mut body = || {
        let mut literals: Vec<Literal> = Vec::new();
        for _ in 0..random.random_range(1..=4) {
            let atom = atoms[random.random_range(0..atoms.len())].clone();
            if literals.iter().all(|literal| literal.atom != atom) {
                let is_negated = random.random_bool(0.3);
                literals.push(Literal { is_negated, atom });
            }
        }
        Body::normalized(literals, vocabulary)
    };
    (1..actions).map(|_| (0..2).map(|_| body()).collect()).collect()
}

/// Whether a body holds, by trying all assignments.
fn holds(vocabulary: &Vocabulary, body: &Body, state: &State) -> bool {
    let free = (body.variables(vocabulary) - vocabulary.egos()) as u32;
    (0..state.entities().pow(free)).any(|number| {
        let mut entities: Vec<usize> = (0..vocabulary.egos()).collect();
        let mut rest = number;
        for _ in 0..free {
            entities.push(rest % state.entities());
            rest /= state.entities();
        }
        body.0.iter().all(|literal| {
            let arguments: Vec<usize> = literal
                .atom
                .arguments
                .iter()
                .map(|&variable| entities[variable as usize])
                .collect();
            state.holds(vocabulary, literal.atom.predicate, &arguments) != literal.is_negated
        })
    })
}

/// The first action one of whose bodies holds.
fn decide(vocabulary: &Vocabulary, rules: &[Vec<Body>], state: &State) -> usize {
    let holds = |bodies: &Vec<Body>| bodies.iter().any(|body| holds(vocabulary, body, state));
    rules.iter().position(holds).unwrap_or(rules.len())
}

fn examples(vocabulary: &Vocabulary, actions: usize, labeled: impl Iterator<Item = (State, usize)>) -> Examples {
    let names = (0..actions).map(|action| format!("Action{action}")).collect();
    let mut examples = Examples::new(vocabulary.clone(), names);
    for (state, action) in labeled {
        examples.push(state, action);
    }
    examples
}

/// The number of distinct states in which rules choose another action than an example.
fn wrong(learned: &LearnedRules, examples: &Examples) -> usize {
    let bodies: Vec<Vec<Body>> = (learned.actions.iter())
        .map(|rules| rules.clauses.iter().map(|clause| clause.body.clone()).collect())
        .collect();
    let vocabulary = examples.vocabulary();
    let is_wrong =
        |(state, tallies): &(&State, &[super::Tally])| tallies[decide(vocabulary, &bodies, state)].count == 0;
    examples.states().filter(is_wrong).count()
}

fn texts(learned: &LearnedRules, vocabulary: &Vocabulary) -> Vec<Vec<String>> {
    learned.bodies().iter().map(|body| body.texts(vocabulary)).collect()
}

/// A vocabulary of predicates of each arity, with one or two egos.
fn any_vocabulary(random: &mut impl Rng) -> Vocabulary {
    let predicates = (0..random.random_range(1..=6)).map(|index| Predicate {
        name: char::from(b'A' + index).to_string(),
        arity: random.random_range(1..=3),
        is_symmetric: false,
    });
    let predicates: Vec<Predicate> = predicates.collect();
    let (egos, guard) = (
        random.random_range(1..=2),
        random.random_bool(0.5).then(|| "Sees".into()),
    );
    Vocabulary::new(predicates, egos, guard)
}

/// A state with facts of each arity.
fn any_state(vocabulary: &Vocabulary, entities: usize, density: f64, random: &mut impl Rng) -> State {
    let mut state = State::new(vocabulary, entities);
    for (index, predicate) in vocabulary.predicates().iter().enumerate() {
        for arguments in tuples(predicate.arity, entities) {
            if random.random_bool(density) {
                state.insert(vocabulary, index, &arguments);
            }
        }
    }
    state
}

/// A body of literals over some variables, one of which may occur twice in an atom.
fn any_body(vocabulary: &Vocabulary, variables: usize, random: &mut impl Rng) -> Body {
    let literals = (0..random.random_range(0..=5)).map(|_| {
        let predicate = random.random_range(0..vocabulary.predicates().len());
        let arity = vocabulary.predicates()[predicate].arity;
        let arguments = (0..arity).map(|_| random.random_range(0..variables) as u8);
        Literal {
            atom: super::Atom {
                predicate,
                arguments: arguments.collect(),
            },
            is_negated: random.random_bool(0.4),
        }
    });
    Body(literals.collect())
}

/// The states in which each body holds, by columns of bits.
fn by_columns(vocabulary: &Vocabulary, bodies: &[&Body], states: &[&State]) -> Vec<Vec<bool>> {
    let mut all = vec![Vec::new(); bodies.len()];
    for (range, chunk) in clauses_hold(vocabulary, bodies, states) {
        for (all, set) in all.iter_mut().zip(&chunk) {
            all.extend((0..range.len()).map(|state| bits::contains(set, state)));
        }
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..cases(600) })]

    /// Columns of bits, backtracking, and the trial of all assignments agree.
    #[test]
    fn the_evaluations_of_a_clause_agree(seed: u64) {
        let mut random = Seed(seed).stream(SCENES, 4, 0);
        let vocabulary = any_vocabulary(&mut random);
        let density = random.random_range(0.1..0.9);
        let states: Vec<State> = (0..random.random_range(1..=80)).map(|_| {
            let entities = random.random_range(vocabulary.egos()..=4);
            any_state(&vocabulary, entities, density, &mut random)
        }).collect();
        let bodies: Vec<Body> = (0..6).map(|_| {
            let variables = random.random_range(vocabulary.egos()..=4);
            any_body(&vocabulary, variables, &mut random)
        }).collect();
        let states: Vec<&State> = states.iter().collect();
        let bodies: Vec<&Body> = bodies.iter().collect();
        let columns = by_columns(&vocabulary, &bodies, &states);
        for (body, columns) in bodies.iter().zip(columns) {
            prop_assert_eq!(columns.len(), states.len());
            for (state, by_columns) in states.iter().zip(columns) {
                let naive = holds(&vocabulary, body, state);
                prop_assert_eq!(by_columns, naive);
                prop_assert_eq!(body.holds(&vocabulary, state), naive);
            }
        }
    }

    /// No conjunction of literals of the example that excludes all negative rows has a higher score.
    #[test]
    fn best_clause_equals_that_of_an_exhaustive_search(seed: u64, has_guard: bool, variables in 1_usize..=2) {
        let vocabulary = vocabulary(2, 2, has_guard);
        let states = states(&vocabulary, 24, seed);
        let (positive, negative) = states.split_at(10);
        let (positive, negative): (Vec<&State>, Vec<&State>) = (positive.iter().collect(), negative.iter().collect());
        let columns = LabeledColumns::new(&vocabulary, &positive, &negative);
        let never = Cancel::never();
        let problem = columns.problem(&vocabulary, variables, true, &never).unwrap();
        let mut open: Bits = bits::empty(positive.len());
        (0..positive.len()).filter(|index| index % 3 != 1).for_each(|index| bits::insert(&mut open, index));
        for example in problem.seeds(0) {
            let mut best: Option<i64> = None;
            for number in 0..1_u64 << problem.atoms.len() {
                let chosen: Bits = Bits::from_slice(&[number]);
                let excludes = problem.holds(problem.negative, &chosen, &example).is_empty();
                if excludes && problem.binds_all(&chosen, &example) {
                    let covered = problem.holds(problem.positive, &chosen, &example).states(problem.positive.words);
                    let cost = problem.cost(&chosen, &example);
                    best = best.max(Some(i64::from(bits::intersection_len(&covered, &open)) * EXAMPLE - i64::from(cost)));
                }
            }
            let counted: Vec<&State> = bits::elements(&open).map(|state| positive[state]).collect();
            let counted_columns = columns.columns(&vocabulary, &counted);
            let found = ExampleSearch::new(&problem, &example, &problem.open(&counted_columns), &never).best(u32::MAX);
            prop_assert!(found.as_ref().is_none_or(|found| found.is_best));
            prop_assert_eq!(found.map(|found| found.score), best);
        }
    }

    #[test]
    fn cover_equals_that_of_an_exhaustive_search(
        columns in prop::collection::vec((0_u64..1 << 10, 1_u32..9), 0..9),
    ) {
        let columns: Vec<(Vec<u64>, u32)> = columns.into_iter().map(|(set, cost)| (vec![set], cost)).collect();
        let sum = |chosen: &mut dyn Iterator<Item = usize>| {
            chosen.fold((0, 0), |(set, cost), column| (set | columns[column].0[0], cost + columns[column].1))
        };
        let all = sum(&mut (0..columns.len())).0;
        let cheapest = (0..1_usize << columns.len())
            .map(|number| sum(&mut (0..columns.len()).filter(|column| number >> column & 1 == 1)))
            .filter(|(set, _)| *set == all)
            .map(|(_, cost)| cost)
            .min();
        let cover = cheapest_cover(&columns, &Cancel::never());
        prop_assert!(cover.is_cheapest);
        prop_assert_eq!(sum(&mut cover.columns.iter().copied()), (all, cheapest.unwrap_or(0)));
    }

    /// Every example of random rules is reproduced, with a working set as well.
    #[test]
    fn learned_rules_reproduce_the_examples_of_random_rules(seed: u64, working_states in prop::sample::select(vec![25, 20_000])) {
        let vocabulary = vocabulary(3, 2, true);
        let rules = rules(&vocabulary, 3, seed);
        let states = states(&vocabulary, 100, seed);
        let labeled = states.into_iter().map(|state| (state.clone(), decide(&vocabulary, &rules, &state)));
        let examples = examples(&vocabulary, 3, labeled);
        let settings = Settings { working_states, ..Settings::default() };
        let learned = learn(&examples, &settings, &Cancel::never());
        prop_assert_eq!(wrong(&learned, &examples), 0);
        prop_assert!(learned.is_complete && learned.actions.iter().all(|rules| rules.uncovered == 0));
    }

    /// With arbitrary actions, the only wrong states are those that no clause separates from the negative ones.
    #[test]
    fn learned_rules_reproduce_arbitrary_examples(seed: u64) {
        let vocabulary = vocabulary(2, 1, seed % 2 == 0);
        let mut random = Seed(seed).stream(SCENES, 2, 0);
        let labeled: Vec<_> = states(&vocabulary, 30, seed).into_iter().map(|state| (state, random.random_range(0..3))).collect();
        let mut examples = examples(&vocabulary, 3, std::iter::empty());
        for (state, action) in labeled {
            let mut again = examples.clone();
            again.push(state, action);
            if again.contradictions().next().is_none() {
                examples = again;
            }
        }
        let learned = learn(&examples, &Settings::default(), &Cancel::never());
        let uncovered: usize = learned.actions.iter().map(|rules| rules.uncovered).sum();
        prop_assert_eq!(wrong(&learned, &examples), uncovered);
    }

    /// After cancellation, the clauses found so far hold in no negative state.
    #[test]
    fn cancellation_returns_the_clauses_found_so_far(seed: u64, polls in 0_usize..40, rate in prop::sample::select(vec![0.0, 0.01])) {
        let vocabulary = vocabulary(3, 2, true);
        let rules = rules(&vocabulary, 3, seed);
        let labeled = states(&vocabulary, 60, seed).into_iter().map(|state| (state.clone(), decide(&vocabulary, &rules, &state)));
        let examples = examples(&vocabulary, 3, labeled);
        let count = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&count);
        let cancel = Cancel::when(move || counter.fetch_add(1, Relaxed) >= polls);
        let settings = Settings { noise: Noise::Rate(rate), ..Settings::default() };
        // On the threads of the test, so that every poll counts.
        let learned = learn_here(&examples, &settings, &|_| (), &cancel);
        prop_assert_eq!(learned.is_complete, count.load(Relaxed) <= polls);
        if rate > 0.0 {
            return Ok(());
        }
        for (action, rules) in learned.actions.iter().enumerate() {
            for (state, tallies) in examples.states() {
                let is_negative = tallies[..=action].iter().all(|tally| tally.count == 0);
                let any = rules.clauses.iter().any(|clause| holds(&vocabulary, &clause.body, state));
                prop_assert!(!(is_negative && any));
            }
        }
    }
}

/// With 13 entities, five variables beside the ego have too many assignments for columns of bits.
#[test]
fn a_clause_with_too_many_assignments_for_columns_is_evaluated() {
    let mut random = Seed(8).stream(SCENES, 5, 0);
    let vocabulary = vocabulary(2, 2, true);
    let states: Vec<State> = (0..3).map(|_| state(&vocabulary, 13, 0.15, &mut random)).collect();
    let states: Vec<&State> = states.iter().collect();
    assert!(
        LabeledColumns::new(&vocabulary, &states, &[])
            .problem(&vocabulary, 6, true, &Cancel::never())
            .is_none()
    );
    let chain = |unary: usize, count: u8| {
        let ends = (1..count).map(|variable| (3, vec![variable - 1, variable], false));
        let literals = ends.chain([(unary, vec![count - 1], false), (2, vec![0, 5], true)]);
        let literals = literals.map(|(predicate, arguments, is_negated)| Literal {
            is_negated,
            atom: super::Atom {
                predicate,
                arguments: arguments.into_iter().collect(),
            },
        });
        Body(literals.collect())
    };
    let mut never = chain(0, 6);
    let last = never.0[4].clone();
    never.0.push(Literal {
        is_negated: true,
        ..last
    });
    let bodies = [chain(0, 5), chain(1, 6), never];
    let bodies: Vec<&Body> = bodies.iter().collect();
    let naive: Vec<Vec<bool>> = (bodies.iter())
        .map(|body| states.iter().map(|state| holds(&vocabulary, body, state)).collect())
        .collect();
    assert!(naive.concat().contains(&true) && naive.concat().contains(&false));
    assert_eq!(by_columns(&vocabulary, &bodies, &states), naive);
}

#[test]
fn rules_are_the_same_on_any_number_of_threads() {
    let vocabulary = vocabulary(3, 2, true);
    for seed in 0..8 {
        let rules = rules(&vocabulary, 3, seed);
        let labeled = states(&vocabulary, 200, seed)
            .into_iter()
            .map(|state| (state.clone(), decide(&vocabulary, &rules, &state)));
        let examples = examples(&vocabulary, 3, labeled);
        for noise in [Noise::None, Noise::Rate(0.01)] {
            let [one, four] = [1, 4].map(|threads| {
                let settings = Settings {
                    noise,
                    threads: NonZeroUsize::new(threads),
                    ..Settings::default()
                };
                texts(&learn(&examples, &settings, &Cancel::never()), &vocabulary)
            });
            assert_eq!(one, four);
        }
    }
}

/// More states than are evaluated together, and no clause.
#[test]
fn support_counts_each_example_once() {
    let vocabulary = vocabulary(15, 0, true);
    let count: usize = 17_500;
    let state = |number: usize| {
        let mut state = State::new(&vocabulary, 1);
        (0..15)
            .filter(|bit| number >> bit & 1 == 1)
            .for_each(|bit| state.insert(&vocabulary, bit, &[0]));
        state
    };
    let labeled = (0..count).map(|number| (state(number), usize::from(number != 17_000)));
    let examples = examples(&vocabulary, 2, labeled);
    let settings = Settings {
        noise: Noise::Rate(0.3),
        ..Settings::default()
    };
    let learned = learn(&examples, &settings, &Cancel::never());
    assert!(learned.bodies().is_empty());
    let support = support(&examples, &learned, &Constraints::default());
    assert_eq!((support.wrong, support.wrong_first), (1, vec![17_000]));
}

/// Scenes in which a known rule set decides, and the number of the action that each example has.
fn noisy(rate: f64) -> (Examples, Vec<(State, usize)>) {
    let vocabulary = vocabulary(4, 2, true);
    let literal = |predicate: usize, arguments: &[u8], is_negated: bool| Literal {
        is_negated,
        atom: super::Atom {
            predicate,
            arguments: arguments.iter().copied().collect(),
        },
    };
    let rules = [
        vec![
            Body(vec![literal(0, &[0], false), literal(5, &[0, 1], false)]),
            Body(vec![
                literal(1, &[0], false),
                literal(2, &[1], false),
                literal(4, &[0, 1], true),
            ]),
        ],
        vec![Body(vec![literal(3, &[0], false), literal(1, &[0], true)])],
    ];
    let mut random = Seed(1).stream(SCENES, 3, 0);
    let labeled: Vec<(State, usize)> = (0..1200)
        .map(|_| {
            let entities = random.random_range(1..=4);
            let state = state(&vocabulary, entities, 0.3, &mut random);
            let action = decide(&vocabulary, &rules, &state);
            (state, action)
        })
        .collect();
    let mut flip = |action: usize| {
        if random.random_bool(rate) {
            (action + random.random_range(1..3)) % 3
        } else {
            action
        }
    };
    let flipped: Vec<_> = labeled
        .iter()
        .map(|(state, action)| (state.clone(), flip(*action)))
        .collect();
    (examples(&vocabulary, 3, flipped.into_iter()), labeled)
}

#[test]
fn noise_does_not_change_the_rules() {
    for (rate, noise) in [
        (0.02, Noise::Rate(0.02)),
        (0.02, Noise::Auto),
        (0.05, Noise::Rate(0.05)),
        (0.05, Noise::Auto),
    ] {
        let (examples, labeled) = noisy(rate);
        assert!(
            examples.contradictions().next().is_some(),
            "some states have several actions"
        );
        let settings = Settings {
            noise,
            ..Settings::default()
        };
        let learned = learn(&examples, &settings, &Cancel::never());
        assert!(
            (rate / 2.0..rate * 2.0).contains(&learned.rate),
            "{rate} {}",
            learned.rate
        );
        let states: Vec<&State> = labeled.iter().map(|(state, _)| state).collect();
        let decided = learned.decide(examples.vocabulary(), &states);
        let right: Vec<usize> = labeled.iter().map(|(_, action)| *action).collect();
        assert_eq!(decided, right, "{rate} {noise:?}");
    }
}

/// A sample of the states is enough, and it grows if it is not.
#[test]
fn noisy_examples_are_learned_from_a_sample() {
    let (examples, labeled) = noisy(0.02);
    for (noise, working_states) in [(Noise::Rate(0.02), 400), (Noise::Auto, 400), (Noise::Rate(0.02), 10)] {
        let settings = Settings {
            noise,
            working_states,
            ..Settings::default()
        };
        let learned = learn(&examples, &settings, &Cancel::never());
        assert!(
            (11..examples.states().len()).contains(&learned.working_states),
            "{noise:?} {working_states}"
        );
        let states: Vec<&State> = labeled.iter().map(|(state, _)| state).collect();
        let decided = learned.decide(examples.vocabulary(), &states);
        let wrong = decided
            .iter()
            .zip(&labeled)
            .filter(|(decided, (_, action))| *decided != action)
            .count();
        assert!(
            wrong * 25 <= labeled.len(),
            "{noise:?} {working_states}: {wrong} of {}",
            labeled.len()
        );
    }
}

#[test]
fn estimated_noise_of_consistent_examples_is_none() {
    let (examples, _) = noisy(0.0);
    let rules = |noise| {
        let learned = learn(
            &examples,
            &Settings {
                noise,
                ..Settings::default()
            },
            &Cancel::never(),
        );
        (learned.rate, texts(&learned, examples.vocabulary()))
    };
    assert_eq!(rules(Noise::Auto), rules(Noise::None));
}
