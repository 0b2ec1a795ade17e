//! Rules learned by questions, compared with the rules that the oracle follows.

#[path = "../../benches/induce/target.rs"]
mod target;

use logicity::cancel::Cancel;
use logicity::induce::ask::{
    Answer, AskSettings, Bound, End, Event, Failure, Oracle, Reason, Refined, Refinement, count_at_most, count_scenes,
};
use logicity::induce::{Constraints, Examples, Predicate, Settings, State, Vocabulary};
use logicity::rng::{Purpose, RngExt, Seed};
use std::cell::Cell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use target::{ACTIONS, Clause, Task, action, city, clauses_of, difference, random_rules, random_state};

const TEST: Purpose = Purpose::new(1002);

/// Two unary predicates and a binary one, with constraints that depend on a number.
fn small_task(number: u64) -> Task {
    let predicate = |name: &str, arity: usize, is_symmetric: bool| Predicate {
        name: name.to_owned(),
        arity,
        is_symmetric,
    };
    let is_symmetric = number % 3 == 1;
    let vocabulary = Vocabulary::new(
        vec![
            predicate("P", 1, false),
            predicate("Q", 1, false),
            predicate("R", 2, is_symmetric),
        ],
        1,
        Some("Sees".to_owned()),
    );
    let when = |is_true: bool, constraint: usize| if is_true { vec![constraint] } else { Vec::new() };
    let constraints = Constraints {
        implies: if number % 4 == 1 { vec![(0, 1)] } else { Vec::new() },
        disjoint: if number % 4 == 2 { vec![vec![0, 1]] } else { Vec::new() },
        covering: if number % 4 >= 2 { vec![vec![0, 1]] } else { Vec::new() },
        symmetric: when(is_symmetric, 2),
        asymmetric: when(number % 3 == 2, 2),
        irreflexive: when(number % 5 != 4, 2),
        reflexive: when(number % 5 == 4 && number % 3 != 2, 2),
    };
    Task {
        vocabulary,
        constraints,
    }
}

/// All states of up to `entities` entities that satisfy the constraints, without any shortcut.
fn all_states(task: &Task, entities: usize) -> Vec<State> {
    let mut all = Vec::new();
    for entities in 1..=entities {
        let facts: Vec<(usize, Vec<usize>)> = (0..entities)
            .flat_map(|one| {
                let pairs = (0..entities).map(move |other| (2, vec![one, other]));
                [(0, vec![one]), (1, vec![one])].into_iter().chain(pairs)
            })
            .collect();
        for number in 0..1_u32 << facts.len() {
            let mut state = State::new(&task.vocabulary, entities);
            for (at, (predicate, arguments)) in facts.iter().enumerate() {
                if number >> at & 1 == 1 {
                    state.insert(&task.vocabulary, *predicate, arguments);
                }
            }
            if task.constraints.violated(&task.vocabulary, &state).is_none() {
                all.push(state);
            }
        }
    }
    all
}

/// Returns a state with its second and third entity exchanged.
fn exchanged(task: &Task, state: &State) -> State {
    let order = [0, 2, 1];
    let mut other = State::new(&task.vocabulary, state.entities());
    for one in 0..3 {
        for predicate in 0..2 {
            if state.holds(&task.vocabulary, predicate, &[one]) {
                other.insert(&task.vocabulary, predicate, &[order[one]]);
            }
        }
        for two in 0..3 {
            if state.holds(&task.vocabulary, 2, &[one, two]) {
                other.insert(&task.vocabulary, 2, &[order[one], order[two]]);
            }
        }
    }
    other
}

fn refinement(task: &Task, asking: AskSettings, log: Vec<Answer>) -> Refinement {
    Refinement {
        examples: Examples::new(task.vocabulary.clone(), ACTIONS.map(str::to_owned).to_vec()),
        constraints: task.constraints.clone(),
        learning: Settings::default(),
        asking,
        log,
    }
}

fn run(task: &Task, asking: AskSettings, log: Vec<Answer>, oracle: &mut dyn Oracle) -> Refined {
    refinement(task, asking, log).run(oracle, &mut |_| {}, &Cancel::never())
}

/// An oracle that follows clauses and counts its answers.
fn follow<'a>(
    task: &'a Task,
    truth: &'a [Clause],
    asked: &'a Cell<usize>,
) -> impl FnMut(&State) -> Result<usize, Failure> + 'a {
    move |state| {
        asked.set(asked.get() + 1);
        assert_eq!(task.constraints.violated(&task.vocabulary, state), None, "{state:?}");
        Ok(action(&task.vocabulary, truth, state))
    }
}

fn easy() -> (Task, Vec<Clause>) {
    city(Path::new(env!("CARGO_MANIFEST_DIR")), "easy")
}

#[test]
fn certified_rules_agree_with_the_oracle_in_all_scenes() {
    for number in 0..20 {
        let task = small_task(number);
        let truth = random_rules(&task, 1..=4, 1..=4, &mut Seed(5).stream(TEST, number, 0));
        let bound = Bound { facts: 15, entities: 3 };
        let asking = AskSettings {
            seed: number,
            agreements: 5,
            sweep: Some(bound),
            ..AskSettings::default()
        };
        let asked = Cell::new(0);
        let refined = run(&task, asking, Vec::new(), &mut follow(&task, &truth, &asked));
        let states = all_states(&task, 3);
        let distinct: BTreeSet<&State> = states
            .iter()
            .filter(|state| state.entities() < 3 || **state <= exchanged(&task, state))
            .collect();
        let End::Certified(certified, scenes) = refined.end else {
            panic!("{number}: {:?}", refined.end);
        };
        assert_eq!((certified, scenes), (bound, distinct.len() as u64), "{number}");
        let count = count_scenes(&task.vocabulary, &task.constraints, bound, &Cancel::never());
        assert_eq!(count, Some(scenes));
        assert!(count_at_most(&task.vocabulary, &task.constraints, bound) >= scenes.into());
        let learned = clauses_of(&refined.rules.actions);
        for state in &states {
            let actions = [&learned, &truth].map(|clauses| action(&task.vocabulary, clauses, state));
            assert_eq!(actions[0], actions[1], "{number}: {state:?}");
        }
        assert_eq!(difference(&task, &learned, &truth), None, "{number}");
    }
}

#[test]
fn closing_a_state_adds_what_the_constraints_require() {
    for number in 0..60 {
        let task = small_task(number);
        let mut random = Seed(6).stream(TEST, number, 0);
        let mut is_open = false;
        for _ in 0..50 {
            let mut state = State::new(&task.vocabulary, 3);
            for _ in 0..random.random_range(0..6) {
                let (one, two) = (random.random_range(0..3), random.random_range(0..3));
                match random.random_range(0..3) {
                    2 => state.insert(&task.vocabulary, 2, &[one, two]),
                    predicate => state.insert(&task.vocabulary, predicate, &[one]),
                }
            }
            let mut closed = state.clone();
            task.constraints.close(&task.vocabulary, &mut closed);
            is_open |= closed != state;
            // The closure is the intersection of all states that contain the facts and satisfy the constraints that add.
            let adding = Constraints {
                disjoint: Vec::new(),
                covering: Vec::new(),
                asymmetric: Vec::new(),
                irreflexive: Vec::new(),
                ..task.constraints.clone()
            };
            assert_eq!(adding.violated(&task.vocabulary, &closed), None);
            let before: BTreeSet<usize> = state.facts().collect();
            let after: BTreeSet<usize> = closed.facts().collect();
            assert!(before.is_subset(&after));
        }
        let adds = !task.constraints.implies.is_empty()
            || !task.constraints.symmetric.is_empty()
            || !task.constraints.reflexive.is_empty();
        assert_eq!(is_open, adds, "{number}");
    }
}

#[test]
fn random_states_and_the_exact_comparison_agree() {
    let mut different = 0;
    for number in 0..40 {
        let task = small_task(number);
        let mut random = Seed(7).stream(TEST, number, 0);
        let [one, other] = [0, 1].map(|_| random_rules(&task, 1..=2, 1..=3, &mut random));
        let witness = difference(&task, &one, &other);
        let differs = |state: &State| action(&task.vocabulary, &one, state) != action(&task.vocabulary, &other, state);
        assert_eq!(witness.is_some(), all_states(&task, 3).iter().any(differs), "{number}");
        assert!(
            witness
                .iter()
                .all(|state| task.constraints.violated(&task.vocabulary, state).is_none() && differs(state))
        );
        let state = random_state(&task, 3, &mut random);
        assert_eq!(task.constraints.violated(&task.vocabulary, &state), None);
        different += usize::from(witness.is_some());
    }
    assert!((10..40).contains(&different), "{different}");
}

#[test]
fn the_rules_of_easy_are_learned_from_questions_alone() {
    let (task, truth) = easy();
    assert_eq!(truth.len(), 3);
    for seed in 0..3 {
        let asking = AskSettings {
            seed,
            agreements: 40,
            ..AskSettings::default()
        };
        let (asked, equal_after) = (Cell::new(0), Cell::new(None));
        let mut observe = |event: Event<'_>| {
            if let Event::Learned(rules) = event {
                let is_equal = difference(&task, &clauses_of(&rules.actions), &truth).is_none();
                equal_after.set(if is_equal {
                    equal_after.get().or(Some(asked.get()))
                } else {
                    None
                });
            }
        };
        let mut oracle = follow(&task, &truth, &asked);
        let refined = refinement(&task, asking, Vec::new()).run(&mut oracle, &mut observe, &Cancel::never());
        assert!(matches!(refined.end, End::Agreed), "{:?}", refined.end);
        assert_eq!(refined.log.len(), asked.get());
        let questions = equal_after.get().expect("the rules are equivalent in the end");
        assert!((10..=100).contains(&questions), "seed {seed}: {questions}");
    }
}

#[test]
fn an_interrupted_run_continues_where_it_stopped() {
    let (task, truth) = easy();
    let asking = AskSettings {
        agreements: 20,
        repeat_after: 7,
        ..AskSettings::default()
    };
    let asked = Cell::new(0);
    let whole = run(&task, asking.clone(), Vec::new(), &mut follow(&task, &truth, &asked));
    assert!(
        whole
            .log
            .iter()
            .filter(|answer| answer.reason == Reason::Repeat)
            .count()
            > 3
    );
    assert_eq!(asked.get(), whole.log.len());
    for cut in [0, 1, whole.log.len() / 3, whole.log.len() - 1, whole.log.len()] {
        let limited = AskSettings {
            questions: cut,
            ..asking.clone()
        };
        let first = run(&task, limited, Vec::new(), &mut follow(&task, &truth, &asked));
        assert_eq!(first.log, whole.log[..cut], "{cut}");
        assert_eq!(
            matches!(first.end, End::Limit),
            cut < whole.log.len(),
            "{:?}",
            first.end
        );
        asked.set(0);
        let second = run(&task, asking.clone(), first.log, &mut follow(&task, &truth, &asked));
        assert_eq!(asked.get(), whole.log.len() - cut);
        assert_eq!(second.log, whole.log);
        assert_eq!(clauses_of(&second.rules.actions), clauses_of(&whole.rules.actions));
    }
}

#[test]
fn another_seed_gives_other_questions() {
    let (task, truth) = easy();
    let logs = [0, 1].map(|seed| {
        let asking = AskSettings {
            seed,
            agreements: 10,
            ..AskSettings::default()
        };
        run(&task, asking, Vec::new(), &mut follow(&task, &truth, &Cell::new(0))).log
    });
    assert_ne!(logs[0], logs[1]);
}

#[test]
fn an_oracle_that_contradicts_itself_is_reported() {
    let (task, truth) = easy();
    let mut count = 0;
    // From the thirtieth question on, it follows no rules at all.
    let mut oracle = |state: &State| -> Result<usize, Failure> {
        count += 1;
        let right = action(&task.vocabulary, &truth, state);
        Ok(if count < 30 { right } else { count % ACTIONS.len() })
    };
    let asking = AskSettings {
        repeat_after: 5,
        ..AskSettings::default()
    };
    let refined = run(&task, asking, Vec::new(), &mut oracle);
    let End::Contradiction { state, actions } = refined.end else {
        panic!("{:?}", refined.end)
    };
    assert_ne!(actions[0], actions[1]);
    let of_state: Vec<usize> = refined
        .log
        .iter()
        .filter(|answer| answer.state == state)
        .map(|answer| answer.action)
        .collect();
    assert_eq!(of_state, actions);
}

#[test]
fn an_oracle_that_no_rules_describe_is_reported() {
    let (task, _) = easy();
    // A clause that holds among two entities holds among three.
    let mut oracle = |state: &State| -> Result<usize, Failure> { Ok(if state.entities() == 2 { 0 } else { 3 }) };
    let refined = run(&task, AskSettings::default(), Vec::new(), &mut oracle);
    let End::Inseparable { state, action } = refined.end else {
        panic!("{:?}", refined.end)
    };
    assert_eq!(action, if state.entities() == 2 { 0 } else { 3 });
}

#[test]
fn examples_that_the_oracle_denies_are_reported_by_the_sweep() {
    let (task, truth) = easy();
    let mut refinement = refinement(
        &task,
        AskSettings {
            agreements: 0,
            sweep: Some(Bound { facts: 1, entities: 2 }),
            ..AskSettings::default()
        },
        Vec::new(),
    );
    let mut state = State::new(&task.vocabulary, 1);
    state.insert(&task.vocabulary, 1, &[0]);
    assert_eq!(action(&task.vocabulary, &truth, &state), 3);
    refinement.examples.push(state.clone(), 0);
    let refined = refinement.run(&mut follow(&task, &truth, &Cell::new(0)), &mut |_| {}, &Cancel::never());
    let End::DeniedExample { state: denied, actions } = refined.end else {
        panic!("{:?}", refined.end)
    };
    assert_eq!((denied, actions), (state, [0, 3]));
}

#[test]
fn cancellation_keeps_what_was_learned() {
    let (task, truth) = easy();
    let answers = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&answers);
    let cancel = Cancel::when(move || count.load(Relaxed) >= 40);
    let mut oracle = |state: &State| -> Result<usize, Failure> {
        answers.fetch_add(1, Relaxed);
        Ok(action(&task.vocabulary, &truth, state))
    };
    let mut last = Vec::new();
    let mut observe = |event: Event<'_>| {
        if let Event::Learned(rules) = event {
            last = clauses_of(&rules.actions);
        }
    };
    let refined = refinement(&task, AskSettings::default(), Vec::new()).run(&mut oracle, &mut observe, &cancel);
    assert!(matches!(refined.end, End::Cancelled), "{:?}", refined.end);
    assert_eq!(refined.log.len(), 40);
    assert!(!last.is_empty());
    assert_eq!(clauses_of(&refined.rules.actions), last);
}

#[test]
fn an_oracle_without_an_answer_ends_the_questions() {
    let (task, truth) = easy();
    let asked = Cell::new(0);
    let mut right = follow(&task, &truth, &asked);
    let mut fails = |state: &State| {
        if asked.get() == 25 {
            Err("the oracle is gone".into())
        } else {
            right(state)
        }
    };
    let refined = run(&task, AskSettings::default(), Vec::new(), &mut fails);
    let End::Failed(failure) = refined.end else {
        panic!("{:?}", refined.end)
    };
    assert_eq!(failure.to_string(), "the oracle is gone");
    assert_eq!(refined.log.len(), 25);
    let mut unknown = |_: &State| -> Result<usize, Failure> { Ok(4) };
    let refined = run(&task, AskSettings::default(), Vec::new(), &mut unknown);
    assert!(matches!(refined.end, End::UnknownAction(4)), "{:?}", refined.end);
}
