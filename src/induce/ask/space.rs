//! The scenes of a fixed number of entities: which facts imply and exclude which.
//!
//! All constraints but the covering ones relate two facts. So a set of facts can be completed to a scene if it is
//! closed, no two of its facts exclude each other, and a choice of covering facts fits.

use crate::induce::bits::{self, Bits};
use crate::induce::constraints::Constraints;
use crate::induce::examples::State;
use crate::induce::vocabulary::{Tuple, Vocabulary, permutations, tuples};

/// A predicate with its arguments.
pub struct Fact {
    pub predicate: usize,
    pub arguments: Tuple,
}

/// What follows from the facts about a number of entities.
pub struct Space {
    pub entities: usize,
    pub egos: usize,
    /// The possible facts, by their numbers.
    pub facts: Vec<Fact>,
    /// For each fact, the facts that follow from it, itself included.
    pub implied: Vec<Bits>,
    /// For each fact, the facts from which it follows, itself included.
    pub implying: Vec<Bits>,
    /// For each fact, the facts that cannot hold together with it. Contains the fact itself if it never holds.
    pub excluded: Vec<Bits>,
    /// The facts that hold in every scene.
    pub always: Bits,
    /// Of each of these sets, at least one fact holds.
    pub covers: Vec<Bits>,
}

impl Space {
    pub fn new(vocabulary: &Vocabulary, constraints: &Constraints, entities: usize) -> Space {
        let count = vocabulary.facts(entities);
        let number = |predicate: usize, arguments: &[usize]| vocabulary.fact(entities, predicate, arguments);
        let mut facts = Vec::with_capacity(count);
        for (predicate, known) in vocabulary.predicates().iter().enumerate() {
            facts.extend(tuples(known.arity, entities).map(|arguments| Fact { predicate, arguments }));
        }
        facts.sort_by_key(|fact| number(fact.predicate, &fact.arguments));
        let mut always = bits::empty(count);
        for &predicate in &constraints.reflexive {
            (0..entities).for_each(|entity| bits::insert(&mut always, number(predicate, &[entity, entity])));
        }
        let symmetric: Vec<usize> = constraints.symmetric(vocabulary).collect();
        let follow = |fact: &Fact| -> Vec<usize> {
            let conclusions = constraints
                .implies
                .iter()
                .filter(|(premise, _)| *premise == fact.predicate);
            let mut next: Vec<usize> = conclusions
                .map(|(_, conclusion)| number(*conclusion, &fact.arguments))
                .collect();
            if symmetric.contains(&fact.predicate) {
                next.push(number(fact.predicate, &[fact.arguments[1], fact.arguments[0]]));
            }
            next
        };
        let closure = |fact: usize| -> Bits {
            let (mut closed, mut open) = (bits::empty(count), vec![fact]);
            while let Some(fact) = open.pop() {
                if !bits::contains(&closed, fact) {
                    bits::insert(&mut closed, fact);
                    open.extend(follow(&facts[fact]));
                }
            }
            closed
        };
        let implied: Vec<Bits> = (0..count).map(closure).collect();
        for fact in bits::elements(&always.clone()) {
            bits::union(&mut always, &implied[fact]);
        }
        let mut implying = vec![bits::empty(count); count];
        for (fact, implied) in implied.iter().enumerate() {
            bits::elements(implied).for_each(|other| bits::insert(&mut implying[other], fact));
        }
        let mut direct = vec![bits::empty(count); count];
        let mut exclude = |one: usize, other: usize| {
            bits::insert(&mut direct[one], other);
            bits::insert(&mut direct[other], one);
        };
        for (one, other) in constraints.disjoint_pairs() {
            for arguments in tuples(vocabulary.predicates()[one].arity, entities) {
                exclude(number(one, &arguments), number(other, &arguments));
            }
        }
        for &predicate in &constraints.asymmetric {
            for pair in tuples(2, entities) {
                exclude(number(predicate, &pair), number(predicate, &[pair[1], pair[0]]));
            }
        }
        for &predicate in &constraints.irreflexive {
            (0..entities).for_each(|entity| {
                let fact = number(predicate, &[entity, entity]);
                exclude(fact, fact);
            });
        }
        let excluded = (0..count).map(|fact| {
            let mut excluded = bits::empty(count);
            for implied in bits::elements(&implied[fact]) {
                for other in bits::elements(&direct[implied]) {
                    bits::union(&mut excluded, &implying[other]);
                }
            }
            excluded
        });
        let mut excluded: Vec<Bits> = excluded.collect();
        for (fact, excluded) in excluded.iter_mut().enumerate() {
            if bits::intersects(excluded, &always) {
                bits::insert(excluded, fact);
            }
        }
        let covers = constraints.covering.iter().flat_map(|predicates| {
            (0..entities).map(|entity| {
                let mut cover = bits::empty(count);
                (predicates.iter()).for_each(|&predicate| bits::insert(&mut cover, number(predicate, &[entity])));
                cover
            })
        });
        Space {
            entities,
            egos: vocabulary.egos(),
            covers: covers.collect(),
            facts,
            implied,
            implying,
            excluded,
            always,
        }
    }

    /// Returns the set with the facts of every scene.
    pub fn start(&self) -> Bits {
        self.always.clone()
    }

    /// Returns whether a fact can be added to a consistent set.
    pub fn fits(&self, scene: &[u64], fact: usize) -> bool {
        !bits::contains(&self.excluded[fact], fact) && !bits::intersects(&self.excluded[fact], scene)
    }

    /// Adds a fact and what follows from it.
    pub fn add(&self, scene: &mut [u64], fact: usize) {
        bits::union(scene, &self.implied[fact]);
    }

    /// Returns the covering facts that could be added for the first entity that lacks one. `None` if none does.
    pub fn uncovered(&self, scene: &[u64]) -> Option<Vec<usize>> {
        let cover = self.covers.iter().find(|cover| !bits::intersects(cover, scene))?;
        Some(bits::elements(cover).filter(|&fact| self.fits(scene, fact)).collect())
    }

    /// Returns whether a closed set without facts that exclude each other has the facts that every scene has.
    pub fn is_complete(&self, scene: &[u64]) -> bool {
        self.always
            .iter()
            .zip(scene)
            .all(|(always, scene)| always & !scene == 0)
            && self.covers.iter().all(|cover| bits::intersects(cover, scene))
    }

    /// Returns a set as a state.
    pub fn state(&self, scene: &[u64]) -> State {
        State::from_facts(self.entities, Bits::from_slice(scene))
    }

    /// Returns the facts of a scene about the entities in `kept`, renumbered in their order, in the space of these.
    pub fn restrict(&self, scene: &[u64], kept: &[usize], vocabulary: &Vocabulary) -> State {
        let mut state = State::new(vocabulary, kept.len());
        for fact in bits::elements(scene) {
            let Fact { predicate, arguments } = &self.facts[fact];
            let places: Option<Tuple> = (arguments.iter())
                .map(|entity| kept.iter().position(|kept| kept == entity))
                .collect();
            if let Some(places) = places {
                state.insert(vocabulary, *predicate, &places);
            }
        }
        state
    }
}

/// The maximum number of entities besides the egos whose orders are compared.
const ORDERED_MAX: usize = 4;

/// Returns the state with its entities in the order that gives the least set of facts, so that states that differ in
/// the order of entities become equal. Large states are only sorted by their facts.
pub fn canonical(vocabulary: &Vocabulary, state: &State) -> State {
    let (entities, egos) = (state.entities(), vocabulary.egos());
    if entities - egos > ORDERED_MAX {
        return state.clone().sorted(vocabulary);
    }
    let others: Vec<usize> = (egos..entities).collect();
    let orders = permutations(&others)
        .into_iter()
        .map(|others| -> Vec<usize> { (0..egos).chain(others).collect() });
    let facts: Vec<(usize, Tuple)> = {
        let mut all = Vec::new();
        for (predicate, known) in vocabulary.predicates().iter().enumerate() {
            let held = tuples(known.arity, entities).filter(|tuple| state.holds(vocabulary, predicate, tuple));
            all.extend(held.map(|tuple| (predicate, tuple)));
        }
        all
    };
    let renamed = orders.map(|order| {
        let mut renamed = bits::empty(vocabulary.facts(entities));
        for (predicate, arguments) in &facts {
            let arguments: Tuple = arguments.iter().map(|&entity| order[entity]).collect();
            bits::insert(&mut renamed, vocabulary.fact(entities, *predicate, &arguments));
        }
        renamed
    });
    State::from_facts(entities, renamed.min().unwrap_or_else(|| state.fact_set().clone()))
}
