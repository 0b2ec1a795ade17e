//! The evaluation of conjunctions, choices and bottoms against loops over all constants.

use super::bottom::{Bottom, Choice, Choices};
use super::database::{Database, UNBOUND};
use super::{derived, learn_relational, undecided};
use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::rules::Settings;
use crate::induce::vocabulary::{Atom, Body, Link, Literal, Predicate, VARIABLES_MAX, Vocabulary};
use crate::rng::{Purpose, Rng, RngExt, Seed};
use std::collections::BTreeSet;

const DATABASES: Purpose = Purpose::new((1 << 20) + 40);

/// The number of constants of a random database. Even ones are of one kind, odd ones of another.
const CONSTANTS: u32 = 8;

/// The facts of each predicate.
type Facts = Vec<BTreeSet<Vec<u32>>>;

fn constant_of(kind: u32, random: &mut impl Rng) -> u32 {
    2 * random.random_range(0..CONSTANTS / 2) + kind
}

/// A database of predicates with one to four arguments, and its facts.
fn any_database(egos: usize, random: &mut impl Rng) -> (Database, Facts, Vec<Vec<u32>>) {
    let (mut kinds, mut facts, mut links, mut predicates) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for index in 0..random.random_range(2..6) {
        let arity = random.random_range(1..=4);
        let own: Vec<u32> = (0..arity).map(|_| random.random_range(0..2)).collect();
        let mut rows = BTreeSet::new();
        for _ in 0..random.random_range(1..20) {
            rows.insert(own.iter().map(|&kind| constant_of(kind, random)).collect::<Vec<u32>>());
        }
        links.push(match random.random_bool(0.5) {
            true => Link::Any,
            false => Link::Inputs(random.random_range(1..1 << arity)),
        });
        predicates.push(Predicate {
            name: format!("p{index}"),
            arity,
            is_symmetric: false,
        });
        facts.push(rows);
        kinds.push(own);
    }
    let pinned = kinds.iter().map(|own| vec![None; own.len()]).collect();
    let rows: Vec<Vec<Vec<u32>>> = facts.iter().map(|rows| rows.iter().cloned().collect()).collect();
    let vocabulary = Vocabulary::new(predicates, egos, None).linked(links);
    let of_constants = (0..CONSTANTS).map(|constant| constant % 2).collect();
    let database = Database::new(vocabulary, &rows, of_constants, kinds.clone(), pinned);
    (database, facts, kinds)
}

fn any_head(egos: usize, random: &mut impl Rng) -> Vec<u32> {
    (0..egos).map(|_| random.random_range(0..CONSTANTS)).collect()
}

/// Returns whether literals hold for some constants of the variables from `egos` on, by trying all.
fn naive(facts: &Facts, literals: &[Literal], head: &[u32], variables: usize) -> bool {
    let free = (variables - head.len()) as u32;
    (0..CONSTANTS.pow(free)).any(|number| {
        let more = (0..free).map(|at| number / CONSTANTS.pow(at) % CONSTANTS);
        let binding: Vec<u32> = head.iter().copied().chain(more).collect();
        literals.iter().all(|literal| {
            let row: Vec<u32> = (literal.atom.arguments.iter())
                .map(|&at| binding[usize::from(at)])
                .collect();
            facts[literal.atom.predicate].contains(&row) != literal.is_negated
        })
    })
}

/// A safe body over atoms of a bottom-like list.
fn any_body(database: &Database, kinds: &[u32], random: &mut impl Rng) -> Option<Body> {
    let atoms = database.atoms(kinds);
    let count = random.random_range(1..=5);
    let literals = (0..count).filter_map(|_| {
        let atom = atoms.get(random.random_range(0..atoms.len().max(1)))?;
        Some(Literal {
            is_negated: random.random_bool(0.2),
            atom: atom.clone(),
        })
    });
    let mut literals: Vec<Literal> = literals.collect();
    literals.sort_by(|one, other| one.atom.cmp(&other.atom));
    literals.dedup_by(|one, other| one.atom == other.atom);
    let body = Body::normalized(literals, database.vocabulary());
    Some(body).filter(|body| body.is_safe(database.vocabulary()))
}

#[test]
fn joins_equal_loops_over_all_constants() {
    let (mut held, mut tried) = (0, 0);
    for seed in 0..400 {
        let mut random = Seed(seed).stream(DATABASES, 0, 0);
        let egos = random.random_range(1..=2);
        let (database, facts, _) = any_database(egos, &mut random);
        let head = any_head(egos, &mut random);
        let mut kinds = database.kinds_of(&head);
        kinds.extend((0..random.random_range(0..=3)).map(|_| random.random_range(0..2)));
        for _ in 0..20 {
            let Some(body) = any_body(&database, &kinds, &mut random) else {
                continue;
            };
            let expected = naive(&facts, &body.0, &head, kinds.len());
            assert_eq!(
                derived(&database, &body, std::slice::from_ref(&head)),
                [expected],
                "{body:?} {facts:?}"
            );
            tried += 1;
            held += u32::from(expected);
            // The found literals are those that hold with the body.
            if expected {
                let found: BTreeSet<Literal> = undecided(&database, &body, std::slice::from_ref(&head), true)
                    .into_iter()
                    .collect();
                let own: BTreeSet<&Atom> = body.0.iter().map(|literal| &literal.atom).collect();
                let all = database.atoms(&database.kinds_in(&head, &body));
                for atom in all.into_iter().filter(|atom| !own.contains(atom)) {
                    for is_negated in [false, true] {
                        let literal = Literal {
                            is_negated,
                            atom: atom.clone(),
                        };
                        let longer: Vec<Literal> = body.0.iter().cloned().chain([literal.clone()]).collect();
                        let variables = body.variables(database.vocabulary());
                        assert_eq!(found.contains(&literal), naive(&facts, &longer, &head, variables));
                    }
                }
            }
        }
    }
    assert!(held > 200 && tried - held > 200, "{held} of {tried}");
}

/// Returns the sets of constants of the variables of a size for which some literals link all of them, by trying all.
fn linked_sets(
    database: &Database,
    facts: &Facts,
    kinds: &[Vec<u32>],
    head: &[u32],
    size: usize,
) -> BTreeSet<Vec<u32>> {
    let links = database.vocabulary().links().unwrap();
    let mut sets = BTreeSet::new();
    for number in 0..1_u32 << CONSTANTS {
        let set: Vec<u32> = (0..CONSTANTS).filter(|constant| number >> constant & 1 == 1).collect();
        if set.len() != size || set.iter().any(|constant| head.contains(constant)) {
            continue;
        }
        let mut bound: BTreeSet<u32> = head.iter().copied().collect();
        loop {
            let before = bound.len();
            for (predicate, rows) in facts.iter().enumerate() {
                for row in rows {
                    let is_inside = row
                        .iter()
                        .all(|constant| set.contains(constant) || head.contains(constant));
                    let is_bound = match links[predicate] {
                        Link::Any => row.iter().any(|constant| bound.contains(constant)),
                        Link::Inputs(inputs) => {
                            (0..kinds[predicate].len()).all(|at| inputs >> at & 1 == 0 || bound.contains(&row[at]))
                        }
                    };
                    if is_inside && is_bound {
                        bound.extend(row);
                    }
                }
            }
            if bound.len() == before {
                break;
            }
        }
        if set.iter().all(|constant| bound.contains(constant)) {
            sets.insert(set);
        }
    }
    sets
}

/// Each negative example lacks one of the facts of the positive one, so a clause needs them all.
#[test]
fn clauses_can_have_more_literals_than_a_word_has_bits() {
    const LITERALS: u32 = 100;
    let predicate = |index| Predicate {
        name: format!("p{index}"),
        arity: 1,
        is_symmetric: false,
    };
    let vocabulary = Vocabulary::new((0..LITERALS).map(predicate).collect(), 1, None);
    let vocabulary = vocabulary.linked(vec![Link::Any; LITERALS as usize]);
    let others = |index| (0..=LITERALS).filter(move |constant| *constant != index + 1);
    let rows: Vec<Vec<Vec<u32>>> = (0..LITERALS)
        .map(|index| others(index).map(|constant| vec![constant]).collect())
        .collect();
    let one = vec![vec![0]; LITERALS as usize];
    let pinned = vec![vec![None]; LITERALS as usize];
    let database = Database::new(vocabulary, &rows, vec![0; LITERALS as usize + 1], one, pinned);
    let negative: Vec<Vec<u32>> = (1..=LITERALS).map(|constant| vec![constant]).collect();
    let settings = Settings {
        variables: 1,
        ..Settings::default()
    };
    let rules = learn_relational(&database, &[vec![0]], &negative, &settings, &|_| (), &Cancel::never());
    assert_eq!((rules.clauses.len(), rules.uncovered), (1, 0));
    assert_eq!(rules.clauses[0].body.0.len(), LITERALS as usize);
}

#[test]
fn choices_are_the_linked_sets_of_constants() {
    let mut found = 0;
    for seed in 0..200 {
        let mut random = Seed(seed).stream(DATABASES, 1, 0);
        let egos = random.random_range(1..=2);
        let (database, facts, kinds) = any_database(egos, &mut random);
        let head = any_head(egos, &mut random);
        let mut choices = Choices::new(&database, &head, 4, false);
        // With repetitions, there are these and others.
        let mut repeated = Choices::new(&database, &head, 2, true);
        for size in 0..=4 {
            let own: BTreeSet<Vec<u32>> = choices.of_size(size).iter().map(|choice| choice.to_vec()).collect();
            assert_eq!(
                own,
                linked_sets(&database, &facts, &kinds, &head, size),
                "{head:?} {facts:?}"
            );
            assert!(choices.is_complete);
            found += own.len();
            if size <= 2 {
                let more: BTreeSet<Vec<u32>> = repeated.of_size(size).iter().map(|choice| choice.to_vec()).collect();
                assert!(more.is_superset(&own));
            }
        }
    }
    assert!(found > 2000, "{found}");
}

/// A clause that holds in no negative example has one of the literals that are false in a row.
#[test]
fn literals_that_hold_in_a_row_do_not_exclude_it() {
    let mut checked = 0;
    for seed in 0..300 {
        let mut random = Seed(seed).stream(DATABASES, 2, 0);
        let (database, facts, _) = any_database(1, &mut random);
        let (head, other) = (any_head(1, &mut random), any_head(1, &mut random));
        if database.kinds_of(&head) != database.kinds_of(&other) {
            continue;
        }
        let mut choices = Choices::new(&database, &head, 3, true);
        for size in 0..=3 {
            let all: Vec<Choice> = choices.of_size(size).to_vec();
            for choice in all.into_iter().take(20) {
                let constants: Choice = head.iter().chain(&choice).copied().collect();
                let atoms = database.atoms(&database.kinds_of(&constants));
                for negation in [false, true] {
                    let bottom = Bottom::new(&database, &atoms, &head, &choice, negation);
                    let binding = Database::bound(&other);
                    let differ = bottom.false_in(&database, &binding);
                    let kept: Vec<Literal> = (0..bottom.atoms.len())
                        .filter(|&at| !bits::contains(&differ, at))
                        .map(|at| Literal {
                            is_negated: !bits::contains(&bottom.seed, at),
                            atom: bottom.atoms[at].clone(),
                        })
                        .collect();
                    assert!(naive(&facts, &kept, &other, 1 + size), "{kept:?} {facts:?}");
                    // The bottom itself holds.
                    let all = bits::full(bottom.atoms.len());
                    let literals = bottom.literals(&all);
                    if literals.len() <= 64 {
                        let mut whole = [UNBOUND; VARIABLES_MAX];
                        whole[0] = head[0];
                        whole[1..=size].copy_from_slice(&choice);
                        assert!(database.witness(&literals, &whole, &Cancel::never()).is_some());
                    }
                    checked += 1;
                }
            }
        }
    }
    assert!(checked > 1000, "{checked}");
}

/// With few constants, each clause of up to two literals over three variables can be tried.
#[test]
fn learned_clauses_are_right_and_not_dearer_than_a_single_one() {
    let (mut solved, mut single) = (0, 0);
    for seed in 0..200 {
        let mut random = Seed(seed).stream(DATABASES, 3, 0);
        let (database, facts, _) = any_database(1, &mut random);
        let heads: Vec<Vec<u32>> = (0..CONSTANTS / 2).map(|number| vec![2 * number]).collect();
        let labels: Vec<bool> = heads.iter().map(|_| random.random_bool(0.5)).collect();
        let of = |label: bool| -> Vec<Vec<u32>> {
            heads
                .iter()
                .zip(&labels)
                .filter(|(_, own)| **own == label)
                .map(|(head, _)| head.clone())
                .collect()
        };
        let (positive, negative) = (of(true), of(false));
        let settings = Settings {
            variables: 3,
            negation: false,
            ..Settings::default()
        };
        let rules = learn_relational(&database, &positive, &negative, &settings, &|_| (), &Cancel::never());
        let vocabulary = database.vocabulary();
        let holds = |head: &Vec<u32>| {
            rules
                .clauses
                .iter()
                .any(|clause| naive(&facts, &clause.body.0, head, 3))
        };
        assert!(!negative.iter().any(holds));
        assert_eq!(positive.iter().filter(|head| !holds(head)).count(), rules.uncovered);
        solved += u32::from(rules.uncovered == 0 && !positive.is_empty());
        let cost: u32 = rules.clauses.iter().map(|clause| clause.body.cost(vocabulary)).sum();
        let kinds = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|more| [0, more[0], more[1]]);
        let atoms: BTreeSet<Atom> = kinds.iter().flat_map(|kinds| database.atoms(kinds)).collect();
        let literal = |atom: &Atom| Literal {
            is_negated: false,
            atom: atom.clone(),
        };
        let bodies = atoms.iter().map(|atom| vec![literal(atom)]);
        let pairs = atoms
            .iter()
            .flat_map(|one| atoms.iter().map(|other| vec![literal(one), literal(other)]));
        let explains = |body: &Body| {
            let naive = |head: &Vec<u32>| naive(&facts, &body.0, head, 3);
            positive.iter().all(naive) && !negative.iter().any(naive)
        };
        let safe = bodies
            .chain(pairs)
            .map(Body)
            .filter(|body| body.is_safe(vocabulary) && explains(body));
        if let Some(least) = safe.map(|body| body.cost(vocabulary)).min()
            && !positive.is_empty()
        {
            single += 1;
            assert!(cost <= least, "{cost} > {least}");
        }
    }
    assert!(solved > 10 && single > 5, "{solved} {single}");
}
