use crate::cancel::Cancel;
use crate::cases::cases;
use crate::induce::constraints::Constraints;
use crate::induce::examples::{Examples, State};
use crate::induce::learner::learn;
use crate::induce::rules::{LearnedRules, Settings};
use crate::induce::support::entailment::Entailment;
use crate::induce::support::support;
use crate::induce::vocabulary::tuples;
use crate::induce::vocabulary::{Atom, Body, Literal, Predicate, Vocabulary};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use proptest::prelude::*;

const DRAWS: Purpose = Purpose::new(u64::MAX - 7);

/// Unary predicates A, B and C, and the binary one D.
fn vocabulary() -> Vocabulary {
    let predicate = |(name, arity): (&str, usize)| Predicate {
        name: name.to_owned(),
        arity,
        is_symmetric: false,
    };
    let predicates = [("A", 1), ("B", 1), ("C", 1), ("D", 2)].map(predicate);
    Vocabulary::new(predicates.to_vec(), 1, Some("Sees".to_owned()))
}

const UNARY: usize = 3;

/// Random constraints. Covering ones have at most `covering` predicates.
fn constraints(covering: usize, random: &mut impl Rng) -> Constraints {
    let mut constraints = Constraints::default();
    let mut pair = || [(); 2].map(|()| random.random_range(0..UNARY));
    let (implied, disjoint, covered) = (pair(), pair(), pair());
    if random.random_bool(0.6) {
        constraints.implies.push((implied[0], implied[1]));
    }
    if disjoint[0] != disjoint[1] && random.random_bool(0.6) {
        constraints.disjoint.push(disjoint.to_vec());
    }
    if covered[0] != covered[1] && random.random_bool(0.6) {
        constraints.covering.push(covered.to_vec());
    }
    if covering > 2 && random.random_bool(0.6) {
        constraints.covering.push((0..UNARY).collect());
    }
    let binary = [
        &mut constraints.symmetric,
        &mut constraints.asymmetric,
        &mut constraints.irreflexive,
        &mut constraints.reflexive,
    ];
    for list in binary {
        if random.random_bool(0.25) {
            list.push(UNARY);
        }
    }
    constraints
}

/// All states of some entities that satisfy constraints.
fn valid(vocabulary: &Vocabulary, constraints: &Constraints, entities: usize) -> Vec<State> {
    let facts: Vec<(usize, Vec<usize>)> = (vocabulary.predicates().iter().enumerate())
        .flat_map(|(at, predicate)| tuples(predicate.arity, entities).map(move |tuple| (at, tuple.to_vec())))
        .collect();
    let states = (0..1_usize << facts.len()).map(|chosen| {
        let mut state = State::new(vocabulary, entities);
        for (at, (predicate, arguments)) in facts.iter().enumerate() {
            if chosen >> at & 1 == 1 {
                state.insert(vocabulary, *predicate, arguments);
            }
        }
        state
    });
    states
        .filter(|state| constraints.violated(vocabulary, state).is_none())
        .collect()
}

/// Whether a literal holds for two variables.
fn is_true(vocabulary: &Vocabulary, state: &State, entities: [usize; 2], literal: &Literal) -> bool {
    let arguments: Vec<usize> = literal
        .atom
        .arguments
        .iter()
        .map(|&variable| entities[variable as usize])
        .collect();
    state.holds(vocabulary, literal.atom.predicate, &arguments) != literal.is_negated
}

/// Whether a literal holds wherever some literals do, in all of some states and for all pairs of an ego and an entity.
fn follows(vocabulary: &Vocabulary, states: &[State], literals: &[Literal], conclusion: &Literal) -> bool {
    states.iter().all(|state| {
        (0..state.entities()).map(|entity| [0, entity]).all(|entities| {
            let holds = |literal: &Literal| is_true(vocabulary, state, entities, literal);
            !literals.iter().all(holds) || holds(conclusion)
        })
    })
}

fn with(literals: &[Literal], more: &Literal) -> Vec<Literal> {
    literals.iter().chain([more]).cloned().collect()
}

fn signed(atoms: Vec<Atom>) -> Vec<Literal> {
    let signs = atoms
        .into_iter()
        .flat_map(|atom| [false, true].map(|is_negated| (is_negated, atom.clone())));
    signs.map(|(is_negated, atom)| Literal { is_negated, atom }).collect()
}

/// All literals over two variables, and a body of up to three of them that some state satisfies.
fn literals(vocabulary: &Vocabulary, states: &[State], random: &mut impl Rng) -> (Vec<Literal>, Vec<Literal>) {
    let all = signed(vocabulary.atoms(2));
    let state = &states[random.random_range(0..states.len())];
    let entities = [0, random.random_range(0..state.entities())];
    let mut body: Vec<Literal> = Vec::new();
    for _ in 0..random.random_range(0..=3) {
        let literal = &all[random.random_range(0..all.len())];
        if is_true(vocabulary, state, entities, literal) && !body.contains(literal) {
            body.push(literal.clone());
        }
    }
    (all, body)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..cases(120) })]

    #[test]
    fn entailment_equals_that_over_all_states(seed: u64, covering in 2_usize..=3) {
        let vocabulary = vocabulary();
        let mut random = Seed(seed).stream(DRAWS, 0, 0);
        let constraints = constraints(covering, &mut random);
        let mut states = valid(&vocabulary, &constraints, 1);
        states.extend(valid(&vocabulary, &constraints, 2));
        // `A implies B`, `A` and `B` disjoint, and `A` covering alone, for example, have no state.
        prop_assume!(!states.is_empty());
        let (all, body) = literals(&vocabulary, &states, &mut random);
        let entailment = Entailment::new(&vocabulary, &constraints, 2);
        let is_exact = constraints.covering.iter().all(|cover| cover.len() < 3);
        for literal in &all {
            let (fast, slow) = (entailment.implies(&body, literal), follows(&vocabulary, &states, &body, literal));
            prop_assert!(fast == slow || slow && !is_exact, "{body:?} {literal:?} {constraints:?}: {fast}");
        }
        let kept = entailment.strongest(&body, all.clone());
        for literal in &kept {
            prop_assert!(!is_exact || !follows(&vocabulary, &states, &body, literal), "{literal:?} follows");
        }
        // Whatever is left out follows from the clause, alone or with a literal that stays. If no state has a literal,
        // it implies everything.
        for literal in all.iter().filter(|literal| !kept.contains(literal)) {
            let by = |more: &Literal| follows(&vocabulary, &states, &with(&body, more), literal);
            prop_assert!(follows(&vocabulary, &states, &body, literal) || kept.iter().any(by), "{literal:?} is missing");
        }
        for (at, one) in kept.iter().enumerate().filter(|_| is_exact) {
            let is_possible = |literal: &Literal| !follows(&vocabulary, &states, &body, &Literal {
                is_negated: !literal.is_negated,
                atom: literal.atom.clone(),
            });
            for other in kept[..at].iter().chain(&kept[at + 1..]).filter(|other| is_possible(other)) {
                prop_assert!(!follows(&vocabulary, &states, &with(&body, other), one), "{other:?} implies {one:?}");
            }
        }
    }

    #[test]
    fn support_equals_that_of_a_count_one_by_one(seed: u64, has_noise: bool) {
        let vocabulary = vocabulary();
        let mut random = Seed(seed).stream(DRAWS, 1, 0);
        let constraints = constraints(2, &mut random);
        let valid: Vec<State> = (1..=2).flat_map(|entities| valid(&vocabulary, &constraints, entities)).collect();
        prop_assume!(!valid.is_empty());
        let names: Vec<String> = ["First", "Second", "Default"].map(str::to_owned).to_vec();
        let mut examples = Examples::new(vocabulary.clone(), names);
        let mut labeled: Vec<(State, usize)> = Vec::new();
        for _ in 0..40 {
            let state = valid[random.random_range(0..valid.len())].clone();
            let known = labeled.iter().find(|(known, _)| *known == state).map(|(_, action)| *action);
            let random_action = random.random_range(0..3);
            let action = known.filter(|_| !has_noise).unwrap_or(random_action);
            examples.push(state.clone(), action);
            labeled.push((state, action));
        }
        let settings = Settings { variables: 2, ..Settings::default() };
        let learned = learn(&examples, &settings, &Cancel::never());
        compare(&vocabulary, &constraints, &valid, &examples, &learned, &labeled)?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..cases(120) })]

    /// Constraints that a state violates are removed, and no others.
    #[test]
    fn constraints_are_tested_one_by_one(seed: u64, count in 0_usize..6) {
        let vocabulary = vocabulary();
        let mut random = Seed(seed).stream(DRAWS, 2, 0);
        let constraints = constraints(3, &mut random);
        let all = valid(&vocabulary, &Constraints::default(), 2);
        let states: Vec<State> = (0..count).map(|_| all[random.random_range(0..all.len())].clone()).collect();
        let (kept, broken) = constraints.tested(&vocabulary, &states);
        prop_assert!(states.iter().all(|state| kept.violated(&vocabulary, state).is_none()));
        let size = |of: &Constraints| {
            let unary = [&of.symmetric, &of.asymmetric, &of.irreflexive, &of.reflexive].map(Vec::len);
            of.implies.len() + of.disjoint.len() + of.covering.len() + unary.iter().sum::<usize>()
        };
        prop_assert_eq!(size(&kept) + broken.len(), size(&constraints));
        for (violation, position) in &broken {
            let (rest, first) = constraints.tested(&vocabulary, &states[..=*position]);
            prop_assert!(first.contains(&(violation.clone(), *position)));
            prop_assert!(rest.violated(&vocabulary, &states[*position]).is_none());
            prop_assert!(constraints.violated(&vocabulary, &states[*position]).is_some());
        }
    }
}

/// Compares the support of learned rules with counts over the examples, one by one.
fn compare(
    vocabulary: &Vocabulary,
    constraints: &Constraints,
    valid: &[State],
    examples: &Examples,
    learned: &LearnedRules,
    labeled: &[(State, usize)],
) -> Result<(), TestCaseError> {
    let found = support(examples, learned, constraints);
    let bodies: Vec<(usize, &Body)> = (learned.actions.iter().enumerate())
        .flat_map(|(action, rules)| rules.clauses.iter().map(move |clause| (action, &clause.body)))
        .collect();
    let held = |state: &State| -> Vec<usize> {
        (0..bodies.len())
            .filter(|&clause| bodies[clause].1.holds(vocabulary, state))
            .collect()
    };
    let held: Vec<Vec<usize>> = labeled.iter().map(|(state, _)| held(state)).collect();
    let count = |has: &dyn Fn(&[usize], usize) -> bool| {
        let examples = held
            .iter()
            .zip(labeled)
            .filter(|(held, (_, action))| has(held, *action));
        examples.count() as u64
    };
    let is_of = |clause: &usize, action: usize| bodies[*clause].0 == action;
    for (clause, clause_support) in found.clauses.iter().enumerate() {
        let action = bodies[clause].0;
        prop_assert_eq!(clause_support.action, action);
        let in_action = |held: &[usize], taken: usize| held.contains(&clause) && taken == action;
        prop_assert_eq!(clause_support.examples, count(&in_action));
        let is_alone = |held: &[usize], taken: usize| {
            in_action(held, taken) && held.iter().filter(|other| is_of(other, action)).count() == 1
        };
        prop_assert_eq!(clause_support.alone, count(&is_alone));
        prop_assert_eq!(
            clause_support.outranked,
            count(&|held, taken| held.contains(&clause) && taken < action)
        );
        prop_assert_eq!(
            clause_support.against,
            count(&|held, taken| held.contains(&clause) && taken > action)
        );
        let first = (0..labeled.len()).find(|&example| is_alone(&held[example], labeled[example].1));
        prop_assert_eq!(clause_support.first, first.map(|first| first as u64));
        let alone: Vec<&State> = (0..labeled.len())
            .filter(|&example| is_alone(&held[example], labeled[example].1))
            .map(|example| &labeled[example].0)
            .collect();
        if alone.is_empty() {
            prop_assert!(clause_support.undecided.is_empty() && clause_support.alternatives.is_empty());
            continue;
        }
        let body = &bodies[clause].1.0;
        let fits = |literals: Vec<Literal>| {
            alone
                .iter()
                .all(|state| Body(literals.clone()).holds(vocabulary, state))
        };
        let all = signed(vocabulary.atoms(bodies[clause].1.variables(vocabulary)));
        for literal in all
            .iter()
            .filter(|literal| body.iter().all(|own| own.atom != literal.atom))
        {
            let is_listed = clause_support.undecided.contains(literal);
            let is_decided = follows(vocabulary, valid, body, literal);
            let is_weaker = (clause_support.undecided.iter())
                .any(|listed| listed != literal && follows(vocabulary, valid, &with(body, listed), literal));
            let expected = fits(with(body, literal)) && !is_decided && (is_listed || !is_weaker);
            prop_assert_eq!(is_listed, expected, "{:?} {:?}", body, literal);
        }
        for (own, other) in &clause_support.alternatives {
            let rest: Vec<Literal> = body.iter().filter(|literal| *literal != own).cloned().collect();
            let replaced = with(&rest, other);
            prop_assert!(fits(replaced.clone()));
            let is_equal = follows(vocabulary, valid, body, other) && follows(vocabulary, valid, &replaced, own);
            prop_assert!(!is_equal, "{body:?}: {own:?} and {other:?} mean the same");
        }
    }
    for chosen in 0..learned.actions.len() {
        for other in chosen + 1..learned.actions.len() {
            let both = |held: &[usize]| {
                held.first().is_some_and(|clause| is_of(clause, chosen))
                    && held.iter().any(|clause| is_of(clause, other))
            };
            let first = held.iter().position(|held| both(held)).map(|first| first as u64);
            let conflict = found
                .conflicts
                .iter()
                .find(|conflict| conflict.actions == [chosen, other]);
            prop_assert_eq!(conflict.map(|conflict| conflict.first), first);
            prop_assert_eq!(
                conflict.map_or(0, |conflict| conflict.examples),
                count(&|held, _| both(held))
            );
        }
    }
    Ok(())
}
