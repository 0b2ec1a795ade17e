//! What is true of all states.

use crate::induce::examples::State;
use crate::induce::vocabulary::{Vocabulary, tuples};

/// What is true of all states of a learning task. Predicates are positions in the [`Vocabulary`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Constraints {
    /// Each fact of the first predicate implies that of the second one with the same arguments.
    pub implies: Vec<(usize, usize)>,
    /// At most one of these predicates of equal arity holds for the same arguments.
    pub disjoint: Vec<Vec<usize>>,
    /// At least one of these unary predicates holds for every entity.
    pub covering: Vec<Vec<usize>>,
    /// These binary predicates hold in both directions or in none.
    pub symmetric: Vec<usize>,
    /// These binary predicates hold in at most one direction, and never between an entity and itself.
    pub asymmetric: Vec<usize>,
    /// These binary predicates never hold between an entity and itself.
    pub irreflexive: Vec<usize>,
    /// These binary predicates hold between every entity and itself.
    pub reflexive: Vec<usize>,
}

/// A constraint that a state violates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Violation {
    /// The first predicate holds for these arguments, the second one does not.
    Implies(usize, usize, Vec<usize>),
    /// Both predicates hold for these arguments.
    Disjoint(usize, usize, Vec<usize>),
    /// None of the predicates of this covering constraint holds for this entity.
    Covering(Vec<usize>, usize),
    /// The predicate holds for these arguments and not in the other direction.
    Symmetric(usize, [usize; 2]),
    /// The predicate holds in both directions.
    Asymmetric(usize, [usize; 2]),
    /// The predicate holds between this entity and itself.
    Irreflexive(usize, usize),
    /// The predicate does not hold between this entity and itself.
    Reflexive(usize, usize),
}

impl Constraints {
    /// Adds the facts that follow from those of a state: by implication, symmetry and reflexivity. A covering
    /// constraint adds nothing, since it leaves a choice.
    pub fn close(&self, vocabulary: &Vocabulary, state: &mut State) {
        let entities = state.entities();
        for &predicate in &self.reflexive {
            (0..entities).for_each(|entity| state.insert(vocabulary, predicate, &[entity, entity]));
        }
        let symmetric: Vec<usize> = self.symmetric(vocabulary).collect();
        let mut facts = 0;
        while facts < state.facts().count() {
            facts = state.facts().count();
            for &(premise, conclusion) in &self.implies {
                for arguments in tuples(vocabulary.predicates()[premise].arity, entities) {
                    if state.holds(vocabulary, premise, &arguments) {
                        state.insert(vocabulary, conclusion, &arguments);
                    }
                }
            }
            for &predicate in &symmetric {
                for arguments in tuples(2, entities) {
                    if state.holds(vocabulary, predicate, &arguments) {
                        state.insert(vocabulary, predicate, &[arguments[1], arguments[0]]);
                    }
                }
            }
        }
    }

    /// Returns the constraints that all states satisfy, and those that a state violates with the position of the first
    /// such state.
    pub fn tested<'a>(
        &self,
        vocabulary: &Vocabulary,
        states: impl IntoIterator<Item = &'a State>,
    ) -> (Constraints, Vec<(Violation, usize)>) {
        let (mut kept, mut broken) = (self.clone(), Vec::new());
        for (position, state) in states.into_iter().enumerate() {
            while let Some(violation) = kept.violated(vocabulary, state) {
                if !kept.remove(&violation) {
                    break;
                }
                broken.push((violation, position));
            }
        }
        (kept, broken)
    }

    /// Removes a violated constraint. Returns whether it was there.
    fn remove(&mut self, violation: &Violation) -> bool {
        let without = |list: &mut Vec<usize>, predicate: usize| {
            let position = list.iter().position(|known| *known == predicate);
            position.map(|position| list.remove(position)).is_some()
        };
        match *violation {
            Violation::Implies(premise, conclusion, _) => {
                let position = self.implies.iter().position(|pair| *pair == (premise, conclusion));
                position.map(|position| self.implies.remove(position)).is_some()
            }
            Violation::Disjoint(one, other, _) => {
                let has_both = |of: &Vec<usize>| of.contains(&one) && of.contains(&other);
                let position = self.disjoint.iter().position(has_both);
                position.map(|position| self.disjoint.remove(position)).is_some()
            }
            Violation::Covering(ref of, _) => {
                let position = self.covering.iter().position(|known| known == of);
                position.map(|position| self.covering.remove(position)).is_some()
            }
            Violation::Symmetric(of, _) => without(&mut self.symmetric, of),
            Violation::Asymmetric(of, _) => without(&mut self.asymmetric, of),
            Violation::Irreflexive(of, _) => without(&mut self.irreflexive, of),
            Violation::Reflexive(of, _) => without(&mut self.reflexive, of),
        }
    }

    /// Returns a constraint that a state violates, if there is one.
    pub fn violated(&self, vocabulary: &Vocabulary, state: &State) -> Option<Violation> {
        let entities = state.entities();
        let arity = |predicate: usize| vocabulary.predicates()[predicate].arity;
        let holds = |predicate: usize, arguments: &[usize]| state.holds(vocabulary, predicate, arguments);
        for &(premise, conclusion) in &self.implies {
            for arguments in tuples(arity(premise), entities) {
                if holds(premise, &arguments) && !holds(conclusion, &arguments) {
                    return Some(Violation::Implies(premise, conclusion, arguments.to_vec()));
                }
            }
        }
        for (one, other) in self.disjoint_pairs() {
            for arguments in tuples(arity(one), entities) {
                if holds(one, &arguments) && holds(other, &arguments) {
                    return Some(Violation::Disjoint(one, other, arguments.to_vec()));
                }
            }
        }
        for predicates in &self.covering {
            let is_bare = |entity: &usize| predicates.iter().all(|&predicate| !holds(predicate, &[*entity]));
            if let Some(entity) = (0..entities).find(is_bare) {
                return Some(Violation::Covering(predicates.clone(), entity));
            }
        }
        for arguments in tuples(2, entities) {
            let (pair, mirrored) = ([arguments[0], arguments[1]], [arguments[1], arguments[0]]);
            for predicate in self.symmetric(vocabulary) {
                if holds(predicate, &pair) && !holds(predicate, &mirrored) {
                    return Some(Violation::Symmetric(predicate, pair));
                }
            }
            for &predicate in &self.asymmetric {
                if holds(predicate, &pair) && holds(predicate, &mirrored) {
                    return Some(Violation::Asymmetric(predicate, pair));
                }
            }
        }
        for entity in 0..entities {
            let itself = |predicate: &&usize| holds(**predicate, &[entity, entity]);
            if let Some(&predicate) = self.irreflexive.iter().find(itself) {
                return Some(Violation::Irreflexive(predicate, entity));
            }
            if let Some(&predicate) = self.reflexive.iter().find(|predicate| !itself(predicate)) {
                return Some(Violation::Reflexive(predicate, entity));
            }
        }
        None
    }

    /// Returns the predicates that hold in both directions, those that the vocabulary knows included.
    pub(crate) fn symmetric<'a>(&'a self, vocabulary: &'a Vocabulary) -> impl Iterator<Item = usize> + 'a {
        (0..vocabulary.predicates().len()).filter(move |predicate| {
            let known = &vocabulary.predicates()[*predicate];
            self.symmetric.contains(predicate) || (known.is_symmetric && known.arity == 2)
        })
    }

    /// Returns the pairs of disjoint predicates.
    pub(crate) fn disjoint_pairs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.disjoint.iter().flat_map(|predicates| {
            let pairs = (0..predicates.len()).flat_map(|at| (0..at).map(move |before| (before, at)));
            pairs.map(|(one, other)| (predicates[one], predicates[other]))
        })
    }
}

impl Violation {
    /// Returns the constraint as a rule file declares it.
    pub fn constraint(&self, vocabulary: &Vocabulary) -> String {
        let (word, of) = match self {
            Violation::Implies(premise, conclusion, _) => ("implies", vec![*premise, *conclusion]),
            Violation::Disjoint(one, other, _) => ("disjoint", vec![*one, *other]),
            Violation::Covering(of, _) => ("covering", of.clone()),
            Violation::Symmetric(of, _) => ("symmetric", vec![*of]),
            Violation::Asymmetric(of, _) => ("asymmetric", vec![*of]),
            Violation::Irreflexive(of, _) => ("irreflexive", vec![*of]),
            Violation::Reflexive(of, _) => ("reflexive", vec![*of]),
        };
        let names = of
            .iter()
            .map(|&predicate| vocabulary.predicates()[predicate].name.as_str());
        format!(".{word} {}", names.collect::<Vec<_>>().join(", "))
    }
}
