//! The most probable proofs of rows, in place of their formulas.
//!
//! A proof is a set of variables that hold and of others that fail. Of a conjunction, disjunction or negation, the most
//! probable proofs are kept: Huang et al.: Scallop, 2021. While no row has more than `k` proofs, the row follows from
//! each of them. A negation considers only the kept proofs, so beyond `k` its proofs are approximations.

use crate::diagram::{Formula, TooLarge};
use crate::marginals::formulas::Algebra;
use std::collections::HashMap;

/// A variable, shifted by one, and whether it fails.
type SignedVariable = u32;

/// The literals of a proof, sorted.
pub(super) type Proof = Box<[SignedVariable]>;

/// Sets of at most `k` proofs. Formulas are their numbers.
pub(super) struct TopProofs {
    k: usize,
    /// By number: the proofs, the most probable first. Number 0 has the empty proof, which always holds.
    sets: Vec<Box<[Proof]>>,
    /// The numbers of sets. Lookup only, never iterated.
    known: HashMap<Box<[Proof]>, u32>,
    /// The proofs of the negation of each set.
    negations: Vec<Option<Formula>>,
    /// The probability of each variable.
    variables: Vec<f64>,
    steps_left: u64,
    steps_max: u64,
}

/// Returns the variable of a literal, and whether it holds.
pub(super) fn literal(literal: SignedVariable) -> (usize, bool) {
    ((literal >> 1) as usize, literal & 1 == 0)
}

impl TopProofs {
    /// Keeps `k` proofs for each row, and takes at most `steps_max` steps.
    pub fn new(k: usize, steps_max: u64) -> TopProofs {
        let truth: Box<[Proof]> = [Proof::default()].into();
        TopProofs {
            k,
            known: HashMap::from([(truth.clone(), 0)]),
            sets: vec![truth],
            negations: vec![None],
            variables: Vec::new(),
            steps_left: steps_max,
            steps_max,
        }
    }

    /// Removes all variables and formulas.
    pub fn clear(&mut self) {
        *self = TopProofs::new(self.k, self.steps_max);
    }

    /// Returns the proofs of a formula, the most probable first.
    pub fn proofs(&mut self, formula: Formula) -> Result<&[Proof], TooLarge> {
        let number = self.positive(formula)?;
        Ok(number.map_or(&[], |number| &self.sets[number]))
    }

    /// Returns the number of variables.
    pub fn count(&self) -> usize {
        self.variables.len()
    }

    /// Returns the probability of a variable.
    pub fn of_variable(&self, variable: usize) -> f64 {
        self.variables[variable]
    }

    /// Returns the probability of a proof.
    pub fn probability(&self, proof: &[SignedVariable]) -> f64 {
        let each = proof.iter().map(|&each| {
            let (variable, holds) = literal(each);
            let probability = self.variables[variable];
            if holds { probability } else { 1.0 - probability }
        });
        each.product()
    }

    /// Returns the number of the set of a formula; `None` if it has no proof.
    fn positive(&mut self, formula: Formula) -> Result<Option<usize>, TooLarge> {
        if formula == Formula::FALSE {
            return Ok(None);
        }
        if !formula.is_negated() {
            return Ok(Some(formula.node()));
        }
        let negation = match self.negations[formula.node()] {
            Some(known) => known,
            None => {
                let found = self.negate(formula.node())?;
                self.negations[formula.node()] = Some(found);
                found
            }
        };
        Ok((negation != Formula::FALSE).then(|| negation.node()))
    }

    /// Returns the proofs of the negation: each has the negation of a literal of every proof.
    fn negate(&mut self, number: usize) -> Result<Formula, TooLarge> {
        let mut all: Vec<Proof> = vec![Proof::default()];
        for proof in self.sets[number].clone() {
            let others = proof.iter().map(|literal| Proof::from([literal ^ 1]));
            all = self.joined(&all, &others.collect::<Vec<_>>())?;
        }
        Ok(self.set(all))
    }

    /// Returns the most probable proofs of a conjunction.
    fn joined(&mut self, left: &[Proof], right: &[Proof]) -> Result<Vec<Proof>, TooLarge> {
        let pairs = left.len() as u64 * right.len() as u64;
        self.steps_left = self.steps_left.checked_sub(pairs).ok_or(TooLarge)?;
        let all = left
            .iter()
            .flat_map(|one| right.iter().filter_map(|other| union(one, other)));
        Ok(self.best(all.collect()))
    }

    /// Keeps the most probable proofs, of which none contains another.
    fn best(&self, proofs: Vec<Proof>) -> Vec<Proof> {
        let mut ranked: Vec<(f64, Proof)> = (proofs.into_iter())
            .map(|proof| (self.probability(&proof), proof))
            .collect();
        // Of equally probable ones, the shorter comes first, so it is kept in place of those that contain it.
        ranked
            .sort_by(|(p, one), (q, other)| (q.total_cmp(p)).then_with(|| (one.len(), one).cmp(&(other.len(), other))));
        let mut kept: Vec<Proof> = Vec::new();
        for (_, proof) in ranked {
            if kept.len() == self.k {
                break;
            }
            if !kept.iter().any(|known| contains(&proof, known)) {
                kept.push(proof);
            }
        }
        kept
    }

    /// Returns the formula of these proofs.
    fn set(&mut self, proofs: Vec<Proof>) -> Formula {
        if proofs.is_empty() {
            return Formula::FALSE;
        }
        let proofs: Box<[Proof]> = proofs.into();
        if let Some(&known) = self.known.get(&proofs) {
            return Formula::new(known, false);
        }
        let number = self.sets.len() as u32;
        self.sets.push(proofs.clone());
        self.negations.push(None);
        self.known.insert(proofs, number);
        Formula::new(number, false)
    }
}

impl Algebra for TopProofs {
    fn variable(&mut self, probability: f64) -> Result<Formula, TooLarge> {
        let variable = self.variables.len() as u32;
        self.variables.push(probability);
        Ok(self.set(vec![Proof::from([variable << 1])]))
    }

    fn and(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        match (left, right) {
            (Formula::TRUE, other) | (other, Formula::TRUE) => return Ok(other),
            (Formula::FALSE, _) | (_, Formula::FALSE) => return Ok(Formula::FALSE),
            _ if left == right => return Ok(left),
            _ if left == right.not() => return Ok(Formula::FALSE),
            _ => {}
        }
        let (Some(left), Some(right)) = (self.positive(left)?, self.positive(right)?) else {
            return Ok(Formula::FALSE);
        };
        let (left, right) = (self.sets[left].clone(), self.sets[right].clone());
        let joined = self.joined(&left, &right)?;
        Ok(self.set(joined))
    }

    fn or(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        match (left, right) {
            (Formula::FALSE, other) | (other, Formula::FALSE) => return Ok(other),
            (Formula::TRUE, _) | (_, Formula::TRUE) => return Ok(Formula::TRUE),
            _ if left == right => return Ok(left),
            _ => {}
        }
        let mut all = Vec::new();
        for formula in [left, right] {
            all.extend(self.proofs(formula)?.iter().cloned());
        }
        self.steps_left = self.steps_left.checked_sub(all.len() as u64).ok_or(TooLarge)?;
        let best = self.best(all);
        Ok(self.set(best))
    }
}

/// Returns the literals of both proofs; `None` if a variable would hold and fail.
fn union(one: &[SignedVariable], other: &[SignedVariable]) -> Option<Proof> {
    let mut all: Vec<SignedVariable> = Vec::with_capacity(one.len() + other.len());
    let (mut left, mut right) = (one.iter().peekable(), other.iter().peekable());
    loop {
        let next = match (left.peek(), right.peek()) {
            (Some(&&one), Some(&&other)) if one == other => {
                right.next();
                left.next()
            }
            (Some(one), Some(other)) if one < other => left.next(),
            (Some(_), None) => left.next(),
            (_, Some(_)) => right.next(),
            (None, None) => return Some(all.into()),
        };
        let next = *next?;
        if all.last().is_some_and(|last| *last == next ^ 1) {
            return None;
        }
        all.push(next);
    }
}

/// Returns whether a proof has all literals of another.
fn contains(proof: &[SignedVariable], other: &[SignedVariable]) -> bool {
    let mut rest = proof.iter();
    other.iter().all(|literal| rest.any(|own| own == literal))
}
