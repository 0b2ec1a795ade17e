//! Which literals of a clause follow from others by the constraints.

use crate::induce::bits::{self, Bits};
use crate::induce::constraints::Constraints;
use crate::induce::vocabulary::tuples;
use crate::induce::vocabulary::{Literal, Vocabulary};
use smallvec::SmallVec;

/// The consequences of literals over some variables.
///
/// Variables count as different entities. This loses nothing: if a clause holds for a state in which two variables
/// stand for one entity, it holds for the state in which a copy of this entity replaces one of them.
pub struct Entailment<'a> {
    vocabulary: &'a Vocabulary,
    variables: usize,
    /// For each literal, those that follow from it alone. A literal is twice the number of its fact, plus one if it is
    /// negated.
    direct: Vec<SmallVec<[u32; 4]>>,
    /// Of each of these sets of facts, at least one holds.
    covers: Vec<Vec<u32>>,
}

impl<'a> Entailment<'a> {
    pub fn new(vocabulary: &'a Vocabulary, constraints: &Constraints, variables: usize) -> Entailment<'a> {
        let arity = |predicate: usize| vocabulary.predicates()[predicate].arity;
        let number = |predicate: usize, arguments: &[usize]| vocabulary.fact(variables, predicate, arguments) as u32;
        let mut direct = vec![SmallVec::new(); 2 * vocabulary.facts(variables)];
        // The first literal implies the second one, and the negation of the second one that of the first.
        let mut imply = |one: u32, other: u32| {
            direct[one as usize].push(other);
            direct[other as usize ^ 1].push(one ^ 1);
        };
        for &(premise, conclusion) in &constraints.implies {
            for arguments in tuples(arity(premise), variables) {
                imply(2 * number(premise, &arguments), 2 * number(conclusion, &arguments));
            }
        }
        for (one, other) in constraints.disjoint_pairs() {
            for arguments in tuples(arity(one), variables) {
                imply(2 * number(one, &arguments), 2 * number(other, &arguments) + 1);
            }
        }
        for pair in tuples(2, variables) {
            let mirrored = [pair[1], pair[0]];
            for predicate in constraints.symmetric(vocabulary) {
                imply(2 * number(predicate, &pair), 2 * number(predicate, &mirrored));
            }
            for &predicate in &constraints.asymmetric {
                imply(2 * number(predicate, &pair), 2 * number(predicate, &mirrored) + 1);
            }
        }
        let covers = (constraints.covering.iter())
            .flat_map(|predicates| (0..variables).map(move |variable| (predicates, variable)))
            .map(|(predicates, variable)| predicates.iter().map(|&one| number(one, &[variable])).collect());
        Entailment {
            covers: covers.collect(),
            vocabulary,
            variables,
            direct,
        }
    }

    /// Returns the literals that follow from some literals by unit propagation. `None` if they contradict each other.
    pub fn consequences<'l>(&self, literals: impl Iterator<Item = &'l Literal>) -> Option<Consequences> {
        let mut holds = bits::empty(self.direct.len());
        let mut open: Vec<u32> = literals.map(|literal| self.number(literal) as u32).collect();
        loop {
            while let Some(literal) = open.pop() {
                if !bits::contains(&holds, literal as usize) {
                    if bits::contains(&holds, literal as usize ^ 1) {
                        return None;
                    }
                    bits::insert(&mut holds, literal as usize);
                    open.extend(&self.direct[literal as usize]);
                }
            }
            for cover in &self.covers {
                let mut possible = (cover.iter()).filter(|&&fact| !bits::contains(&holds, 2 * fact as usize + 1));
                match (possible.next(), possible.next()) {
                    (None, _) => return None,
                    (Some(&only), None) if !bits::contains(&holds, 2 * only as usize) => open.push(2 * only),
                    _ => {}
                }
            }
            if open.is_empty() {
                return Some(Consequences(holds));
            }
        }
    }

    /// Returns whether some literals imply another one: whether propagation refutes its negation. The answer is exact
    /// unless a covering constraint has three or more predicates; then it may be false for a literal that follows.
    pub fn implies(&self, literals: &[Literal], conclusion: &Literal) -> bool {
        let negation = Literal {
            is_negated: !conclusion.is_negated,
            atom: conclusion.atom.clone(),
        };
        self.consequences(literals.iter().chain([&negation])).is_none()
    }

    /// Returns the literals that neither follow from a clause nor from the clause with another one of them. Of literals
    /// that follow from each other, a positive one stays if there is one.
    pub fn strongest(&self, body: &[Literal], mut literals: Vec<Literal>) -> Vec<Literal> {
        literals.retain(|literal| !self.implies(body, literal));
        let with: Vec<Option<Consequences>> = literals
            .iter()
            .map(|literal| self.consequences(body.iter().chain([literal])))
            .collect();
        let follows = |from: usize, literal: usize| {
            (with[from].as_ref()).is_some_and(|with| with.contains(self, &literals[literal]))
        };
        let is_strongest = |&at: &usize| {
            let is_before = |other: usize| (literals[other].is_negated, other) < (literals[at].is_negated, at);
            (0..literals.len())
                .all(|other| other == at || !follows(other, at) || follows(at, other) && !is_before(other))
        };
        let kept: Vec<usize> = (0..literals.len()).filter(is_strongest).collect();
        kept.into_iter().map(|at| literals[at].clone()).collect()
    }

    fn number(&self, literal: &Literal) -> usize {
        let arguments: SmallVec<[usize; 4]> = literal.atom.arguments.iter().map(|&variable| variable.into()).collect();
        2 * self.vocabulary.fact(self.variables, literal.atom.predicate, &arguments) + usize::from(literal.is_negated)
    }
}

/// A set of literals.
pub struct Consequences(Bits);

impl Consequences {
    /// Returns whether a literal is in the set.
    pub fn contains(&self, of: &Entailment<'_>, literal: &Literal) -> bool {
        bits::contains(&self.0, of.number(literal))
    }
}
