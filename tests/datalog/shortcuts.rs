//! Reasoning shortcuts: counts against the enumeration of all maps and scenes, and against published ones.

use crate::cases::cases;
use crate::written_program::program;
use logicity_datalog::diff::shortcuts::{
    ConceptMaps, Image, ShortcutOptions, Shortcuts, Stopped, identity, shortcuts, witness,
};
use logicity_datalog::{PredicateId, Program, Value, naive};
use proptest::prelude::*;
use std::collections::BTreeSet;

const DECLARED: &str = ".decl A(x: symbol) .input A
    .decl B(x: symbol) .input B
    .decl C(x: symbol) .input C
    .decl R(x: symbol, y: symbol) .input R
    .decl Stop(x: symbol) .output Stop
    .decl Slow(x: symbol) .output Slow\n";

/// The concepts with their arities.
const CONCEPTS: [(&str, usize); 4] = [("A", 1), ("B", 1), ("C", 1), ("R", 2)];

/// The number of entities in a scene.
const ENTITIES: usize = 2;

fn order(program: &Program) -> Vec<PredicateId> {
    ["Stop", "Slow"].map(|name| program.predicate(name).unwrap()).into()
}

fn counted(program: &Program, maps: ConceptMaps, entities_max: usize) -> Shortcuts {
    let options = ShortcutOptions {
        maps,
        entities_max,
        ..ShortcutOptions::default()
    };
    let found = shortcuts(program.rules(), &order(program), &options).unwrap();
    assert_eq!(found.stopped, None);
    found
}

/// The rows of all concepts over the entities, in the order of bits.
fn atoms() -> Vec<(usize, Vec<usize>)> {
    let rows = |arity: usize| -> Vec<Vec<usize>> {
        match arity {
            1 => (0..ENTITIES).map(|x| vec![x]).collect(),
            _ => (0..ENTITIES * ENTITIES)
                .map(|row| vec![row / ENTITIES, row % ENTITIES])
                .collect(),
        }
    };
    let concepts = CONCEPTS.iter().enumerate();
    concepts
        .flat_map(|(concept, (_, arity))| rows(*arity).into_iter().map(move |row| (concept, row)))
        .collect()
}

/// The decision of the first entity by the facts with these bits: the position of the action.
fn decision(program: &Program, facts: usize, constraints: &[(&str, &str)]) -> Option<Option<usize>> {
    let symbols = &program.rules().symbols;
    let word = |entity: usize| Value(symbols.intern(&format!("e{entity}")).0);
    let held: Vec<(usize, Vec<usize>)> = (atoms().into_iter().enumerate())
        .filter(|(bit, _)| facts >> bit & 1 == 1)
        .map(|(_, atom)| atom)
        .collect();
    let has = |name: &str, row: &[usize]| held.iter().any(|(of, known)| CONCEPTS[*of].0 == name && known == row);
    let excluded = constraints
        .iter()
        .any(|(one, other)| (0..ENTITIES).any(|x| has(one, &[x]) && has(other, &[x])));
    let rows = held.iter().map(|(of, row)| {
        let predicate = program.predicate(CONCEPTS[*of].0).unwrap();
        (predicate, row.iter().map(|entity| word(*entity)).collect())
    });
    let database = naive::evaluate(program.rules(), symbols, rows);
    let first = order(program)
        .iter()
        .position(|action| database[action.index()].contains(&vec![word(0)]));
    (!excluded).then_some(first)
}

/// The facts that perception reports in place of others.
fn reported(facts: usize, images: &[Image], concepts: &[usize]) -> usize {
    let atoms = atoms();
    let mut found = 0;
    for (bit, (concept, row)) in atoms.iter().enumerate() {
        let value = match concepts.iter().position(|known| known == concept).map(|at| images[at]) {
            None => facts >> bit & 1 == 1,
            Some(Image::Constant(value)) => value,
            Some(Image::Concept { position, negated }) => {
                let wanted = (concepts[position], row.clone());
                let other = atoms.iter().position(|atom| *atom == wanted).unwrap();
                (facts >> other & 1 == 1) != negated
            }
        };
        found |= usize::from(value) << bit;
    }
    found
}

/// All maps of these concepts.
fn every(concepts: &[usize], maps: ConceptMaps) -> Vec<Vec<Image>> {
    let arity = |at: usize| CONCEPTS[concepts[at]].1;
    let mut all: Vec<Vec<Image>> = vec![Vec::new()];
    for at in 0..concepts.len() {
        let same = (0..concepts.len()).filter(|other| arity(*other) == arity(at));
        let mut images: Vec<Image> = same.clone().map(identity).collect();
        if maps != ConceptMaps::Permutations {
            images.extend(same.map(|position| Image::Concept {
                position,
                negated: true,
            }));
        }
        if maps == ConceptMaps::All {
            images.extend([true, false].map(Image::Constant));
        }
        all = all
            .iter()
            .flat_map(|known| images.iter().map(|image| [&known[..], &[*image]].concat()))
            .collect();
    }
    let is_permutation = |images: &Vec<Image>| {
        let used = images.iter().filter_map(|image| match image {
            Image::Concept { position, .. } => Some(*position),
            Image::Constant(_) => None,
        });
        used.collect::<BTreeSet<_>>().len() == images.len()
    };
    all.into_iter()
        .filter(|images| maps == ConceptMaps::All || is_permutation(images))
        .collect()
}

proptest! {
    #![proptest_config(cases(60))]

    #[test]
    fn counts_are_those_of_all_maps_and_scenes(
        clauses in proptest::collection::vec((
            prop::sample::select(vec!["Stop(x)", "Slow(x)"]),
            prop::sample::select(vec!["A(x)", "R(x, y)", "R(y, x)"]),
            proptest::collection::vec(
                prop::sample::select(vec!["B(x)", "not B(x)", "C(y)", "not A(y)", "R(y, x)", "not R(x, y)", "A(y)", "x != y"]),
                0..3,
            ),
        ), 1..4),
        maps in prop::sample::select(vec![ConceptMaps::Permutations, ConceptMaps::Signed, ConceptMaps::All]),
        is_disjoint in any::<bool>(),
    ) {
        let mut text = DECLARED.to_owned();
        for (head, first, body) in &clauses {
            let body: Vec<&str> = [*first].into_iter().chain(body.iter().copied()).collect();
            // Every variable has a positive atom.
            let domain = if *first == "A(x)" && body.iter().any(|literal| literal.contains('y')) { ", R(x, y)" } else { "" };
            let body = body.join(", ");
            text += &format!("{head} :- {body}{domain}.\n");
        }
        let constraints: &[(&str, &str)] = if is_disjoint { &[("A", "B")] } else { &[] };
        if is_disjoint {
            text += ".disjoint A, B\n";
        }
        let program = program(&text);
        let found = counted(&program, maps, ENTITIES);
        let name = |id: &PredicateId| program.rules().predicates[id.index()].name.clone();
        let concepts: Vec<usize> = (found.concepts.iter())
            .map(|id| CONCEPTS.iter().position(|(known, _)| *known == name(id)).unwrap())
            .collect();
        let scenes = 0..1_usize << atoms().len();
        let decisions: Vec<Option<Option<usize>>> = scenes.clone().map(|facts| decision(&program, facts, constraints)).collect();
        let of_reported: Vec<Option<usize>> =
            scenes.clone().map(|facts| decision(&program, facts, &[]).unwrap()).collect();
        let (mut expected, mut excluded) = (Vec::new(), 0);
        for images in every(&concepts, maps) {
            let (mut valid, mut same) = (true, true);
            for facts in scenes.clone() {
                let Some(known) = decisions[facts] else { continue };
                let seen = reported(facts, &images, &concepts);
                valid &= of_reported[seen] == known;
                same &= seen == facts;
            }
            if valid {
                expected.push((images, same));
            } else {
                excluded += 1;
                if excluded % 7 != 1 {
                    continue;
                }
                // A witness shows it.
                let options = ShortcutOptions { maps, entities_max: ENTITIES, ..ShortcutOptions::default() };
                let shown = witness(program.rules(), &order(&program), &options, &images).unwrap().unwrap().unwrap();
                let bit = |name: &str, row: &[String]| {
                    let row = row.iter().map(|entity| entity[1..].parse().unwrap()).collect();
                    let atom = (CONCEPTS.iter().position(|(known, _)| *known == name).unwrap(), row);
                    atoms().iter().position(|known| *known == atom).unwrap()
                };
                let facts = shown.scene.facts.iter().flat_map(|(name, rows)| rows.iter().map(move |row| (name, row)));
                let facts = facts.fold(0, |facts, (name, row)| facts | 1_usize << bit(name, row));
                let actions = order(&program);
                let place = |decision: Option<PredicateId>| decision.map(|of| actions.iter().position(|known| *known == of).unwrap());
                prop_assert_eq!(decisions[facts], Some(place(shown.decisions[0])));
                let present = |bit: usize| atoms()[bit].1.iter().all(|entity| *entity < shown.scene.entities.len());
                let absent: usize = (0..atoms().len()).filter(|bit| !present(*bit)).map(|bit| 1 << bit).sum();
                let seen = reported(facts, &images, &concepts) & !absent;
                prop_assert_eq!(of_reported[seen], place(shown.decisions[1]));
                prop_assert!(shown.decisions[0] != shown.decisions[1]);
            }
        }
        expected.sort();
        let mut maps: Vec<(Vec<Image>, bool)> = found.maps.iter().map(|map| (map.images.clone(), map.is_same())).collect();
        maps.sort();
        prop_assert_eq!(maps, expected);
    }
}

/// `gen-rss-count.py cnf -f and3.cnf -E` and `xor -n 3 -E` of rsbench (Bortolotti et al. 2024) print 6 and 24 solutions.
#[test]
fn published_counts() {
    let and = program(&(DECLARED.to_owned() + "Stop(x) :- A(x), B(x), C(x).\n"));
    let xor = program(
        &(DECLARED.to_owned()
            + "Stop(x) :- A(x), not B(x), not C(x).
               Stop(x) :- B(x), not A(x), not C(x).
               Stop(x) :- C(x), not A(x), not B(x).
               Stop(x) :- A(x), B(x), C(x).\n"),
    );
    assert_eq!(counted(&and, ConceptMaps::Signed, 1).maps.len(), 6);
    assert_eq!(counted(&and, ConceptMaps::Permutations, 1).maps.len(), 6);
    assert_eq!(counted(&xor, ConceptMaps::Signed, 1).maps.len(), 24);
    assert!(counted(&and, ConceptMaps::Signed, 1).maps[0].is_same());
    assert_eq!(counted(&and, ConceptMaps::Signed, 1).unread.len(), 1);
}

#[test]
fn limits_and_unsupported_rules() {
    let rules = program(&(DECLARED.to_owned() + "Stop(x) :- A(x), B(x), C(x).\n"));
    let few = ShortcutOptions {
        maps_max: 3,
        ..ShortcutOptions::default()
    };
    let found = shortcuts(rules.rules(), &order(&rules), &few).unwrap();
    assert_eq!((found.stopped, found.maps.len()), (Some(Stopped::Maps), 3));
    let named = |name: &str| ShortcutOptions {
        concepts: vec![name.to_owned()],
        ..ShortcutOptions::default()
    };
    let faults = shortcuts(rules.rules(), &order(&rules), &named("R")).unwrap_err();
    assert!(
        faults[0].notes[0].contains("the concepts are `A`, `B`, `C`"),
        "{faults:?}"
    );
    assert_eq!(
        shortcuts(rules.rules(), &order(&rules), &named("A"))
            .unwrap()
            .maps
            .len(),
        1
    );
    let counts = program(&(DECLARED.to_owned() + "Stop(x) :- A(x), count : { R(x, _) } > 2.\n"));
    let faults = shortcuts(counts.rules(), &order(&counts), &ShortcutOptions::default()).unwrap_err();
    assert_eq!(faults[0].code, logicity_datalog::codes::UNSUPPORTED);
}
