//! Reduced ordered binary decision diagrams, and the probability that such a formula holds.
//!
//! Bryant: Graph-based algorithms for Boolean function manipulation, 1986. A formula is a node of a [`Diagrams`], and
//! equal formulas are the same node. Negation is a bit of the reference to a node, so it costs nothing.

mod circuit;

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

pub(crate) use circuit::DiagramCircuit;

/// A formula: the number of a node, shifted by one, and whether it is negated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Formula(u32);

impl Formula {
    /// Always holds.
    pub const TRUE: Formula = Formula(0);
    /// Never holds.
    pub const FALSE: Formula = Formula(1);

    /// Returns the formula of a node, negated if `negate`.
    pub fn new(node: u32, negate: bool) -> Formula {
        Formula(node << 1 | u32::from(negate))
    }

    /// Returns the negation.
    pub fn not(self) -> Formula {
        Formula(self.0 ^ 1)
    }

    /// Returns the number of its node.
    pub fn node(self) -> usize {
        (self.0 >> 1) as usize
    }

    /// Returns whether it is the negation of its node.
    pub fn is_negated(self) -> bool {
        self.0 & 1 == 1
    }

    /// Returns the formula, negated if `negate`.
    fn flipped(self, negate: bool) -> Formula {
        Formula(self.0 ^ u32::from(negate))
    }
}

/// A decision on a variable. The branch in which the variable holds is never negated, so each formula has one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Node {
    variable: u32,
    holds: Formula,
    fails: Formula,
}

/// The diagrams would have more nodes, or need more steps, than the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TooLarge;

/// Formulas over variables with probabilities, ordered by their numbers.
#[derive(Debug)]
pub(crate) struct Diagrams {
    nodes: Vec<Node>,
    /// Lookup only, never iterated.
    unique: HashMap<Node, u32, BuildHasherDefault<Mixer>>,
    /// The conjunctions of pairs. Lookup only, never iterated.
    conjunctions: HashMap<(Formula, Formula), Formula, BuildHasherDefault<Mixer>>,
    /// The probability of each variable.
    variables: Vec<f64>,
    /// The probabilities that each node holds, and that it fails. Their sum is 1, but the difference of the one from 1
    /// would lose the digits of the other.
    probabilities: Vec<[f64; 2]>,
    nodes_max: usize,
    steps_left: u64,
}

/// The variable of the constants, after all others.
const NONE: u32 = u32::MAX;

/// Steps for each node that the limit allows.
const STEPS: u64 = 64;

/// Known conjunctions for each node that the limit allows.
const CONJUNCTIONS: usize = 4;

/// The bytes that each node of the limit may take: the node, its probability, and entries of both tables.
pub(crate) const NODE_BYTES: u64 = 160;

/// The maximum number of variables on a path, which bounds the depth of recursion.
const DEPTH_MAX: u32 = 4096;

impl Diagrams {
    /// Creates diagrams without variables, of at most `nodes_max` nodes.
    pub fn new(nodes_max: usize) -> Diagrams {
        let truth = Node {
            variable: NONE,
            holds: Formula::TRUE,
            fails: Formula::TRUE,
        };
        Diagrams {
            nodes: vec![truth],
            unique: HashMap::default(),
            conjunctions: HashMap::default(),
            variables: Vec::new(),
            probabilities: vec![[1.0, 0.0]],
            nodes_max: nodes_max.min(1 << 30),
            steps_left: nodes_max as u64 * STEPS,
        }
    }

    /// Removes all variables and formulas, and keeps the memory.
    pub fn clear(&mut self) {
        /// Clearing larger tables takes longer than creating them anew.
        const KEPT: usize = 1 << 12;
        if self.conjunctions.capacity() > KEPT {
            *self = Diagrams::new(self.nodes_max);
            return;
        }
        self.nodes.truncate(1);
        self.unique.clear();
        self.conjunctions.clear();
        self.variables.clear();
        self.probabilities.truncate(1);
        self.steps_left = self.nodes_max as u64 * STEPS;
    }

    /// Adds a variable after all others, and returns the formula that it holds.
    pub fn variable(&mut self, probability: f64) -> Result<Formula, TooLarge> {
        let variable = self.variables.len() as u32;
        self.variables.push(probability);
        self.decide(variable, Formula::TRUE, Formula::FALSE)
    }

    /// Returns the conjunction.
    pub fn and(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        self.conjunction(left, right, DEPTH_MAX)
    }

    fn conjunction(&mut self, left: Formula, right: Formula, depth: u32) -> Result<Formula, TooLarge> {
        let (left, right) = (left.min(right), left.max(right));
        // x & 1, x & 0, x & x, x & !x
        match (left, right) {
            (Formula::TRUE, other) => return Ok(other),
            (Formula::FALSE, _) => return Ok(Formula::FALSE),
            _ if left == right => return Ok(left),
            _ if left == right.not() => return Ok(Formula::FALSE),
            _ => {}
        }
        if let Some(known) = self.conjunctions.get(&(left, right)) {
            return Ok(*known);
        }
        self.steps_left = self.steps_left.checked_sub(1).ok_or(TooLarge)?;
        let depth = depth.checked_sub(1).ok_or(TooLarge)?;
        let [one, other] = [left, right].map(|formula| self.nodes[formula.node()]);
        let variable = one.variable.min(other.variable);
        let branches = |formula: Formula, node: Node| match node.variable == variable {
            true => [node.holds, node.fails].map(|branch| branch.flipped(formula.is_negated())),
            false => [formula; 2],
        };
        let ([one_holds, one_fails], [other_holds, other_fails]) = (branches(left, one), branches(right, other));
        let holds = self.conjunction(one_holds, other_holds, depth)?;
        let fails = self.conjunction(one_fails, other_fails, depth)?;
        let found = self.decide(variable, holds, fails)?;
        if self.conjunctions.len() >= CONJUNCTIONS * self.nodes_max {
            self.conjunctions.clear();
        }
        self.conjunctions.insert((left, right), found);
        Ok(found)
    }

    /// Returns the disjunction.
    pub fn or(&mut self, left: Formula, right: Formula) -> Result<Formula, TooLarge> {
        Ok(self.and(left.not(), right.not())?.not())
    }

    /// Returns for each formula that it is the first one that holds, and after these that none holds.
    pub fn firsts(&mut self, formulas: &[Formula]) -> Result<Vec<Formula>, TooLarge> {
        let mut none = Formula::TRUE;
        let mut firsts = Vec::with_capacity(formulas.len() + 1);
        for formula in formulas {
            firsts.push(self.and(none, *formula)?);
            none = self.and(none, formula.not())?;
        }
        firsts.push(none);
        Ok(firsts)
    }

    fn decide(&mut self, variable: u32, holds: Formula, fails: Formula) -> Result<Formula, TooLarge> {
        if holds == fails {
            return Ok(holds);
        }
        let negate = holds.is_negated();
        let node = Node {
            variable,
            holds: holds.flipped(negate),
            fails: fails.flipped(negate),
        };
        let next = self.nodes.len();
        let number = match self.unique.entry(node) {
            std::collections::hash_map::Entry::Occupied(known) => *known.get(),
            std::collections::hash_map::Entry::Vacant(_) if next >= self.nodes_max => return Err(TooLarge),
            std::collections::hash_map::Entry::Vacant(free) => {
                let of = |formula: Formula, fails: bool| {
                    self.probabilities[formula.node()][usize::from(formula.is_negated() != fails)]
                };
                let probability = self.variables[variable as usize];
                let counted = [false, true]
                    .map(|fails| probability * of(node.holds, fails) + (1.0 - probability) * of(node.fails, fails));
                self.nodes.push(node);
                self.probabilities.push(counted);
                *free.insert(next as u32)
            }
        };
        Ok(Formula::new(number, negate))
    }

    /// Returns the probability that a formula holds.
    pub fn probability(&self, formula: Formula) -> f64 {
        self.probabilities[formula.node()][usize::from(formula.is_negated())]
    }
}

/// Hashes the words of nodes and pairs: each is multiplied and rotated, as in Firefox and rustc.
#[derive(Default)]
struct Mixer(u64);

impl Hasher for Mixer {
    fn finish(&self) -> u64 {
        self.0.rotate_left(26)
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u32(u32::from(byte)));
    }

    fn write_u32(&mut self, word: u32) {
        self.0 = (self.0.wrapping_add(u64::from(word))).wrapping_mul(0xf135_7aea_2e62_a9c5);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A formula as a tree over four variables.
    #[derive(Clone, Debug)]
    enum Tree {
        Variable(usize),
        Not(Box<Tree>),
        And(Box<Tree>, Box<Tree>),
        Or(Box<Tree>, Box<Tree>),
    }

    fn trees() -> impl Strategy<Value = Tree> {
        let leaf = (0..4_usize).prop_map(Tree::Variable);
        leaf.prop_recursive(6, 40, 2, |inner| {
            let pair = (inner.clone(), inner.clone());
            prop_oneof![
                inner.prop_map(|tree| Tree::Not(Box::new(tree))),
                pair.clone()
                    .prop_map(|(one, other)| Tree::And(Box::new(one), Box::new(other))),
                pair.prop_map(|(one, other)| Tree::Or(Box::new(one), Box::new(other))),
            ]
        })
    }

    fn holds(tree: &Tree, world: usize) -> bool {
        match tree {
            Tree::Variable(variable) => world >> variable & 1 == 1,
            Tree::Not(inner) => !holds(inner, world),
            Tree::And(one, other) => holds(one, world) && holds(other, world),
            Tree::Or(one, other) => holds(one, world) || holds(other, world),
        }
    }

    fn formula(tree: &Tree, variables: &[Formula], diagrams: &mut Diagrams) -> Formula {
        match tree {
            Tree::Variable(variable) => variables[*variable],
            Tree::Not(inner) => formula(inner, variables, diagrams).not(),
            Tree::And(one, other) | Tree::Or(one, other) => {
                let [one, other] = [one, other].map(|tree| formula(tree, variables, diagrams));
                match tree {
                    Tree::And(..) => diagrams.and(one, other).unwrap(),
                    _ => diagrams.or(one, other).unwrap(),
                }
            }
        }
    }

    const PROBABILITIES: [f64; 4] = [0.3, 0.9, 0.0, 0.55];

    proptest! {
        #[test]
        fn formulas_have_the_probability_of_their_worlds(one in trees(), other in trees()) {
            let mut diagrams = Diagrams::new(1 << 12);
            let variables = PROBABILITIES.map(|probability| diagrams.variable(probability).unwrap());
            let [first, second] = [&one, &other].map(|tree| formula(tree, &variables, &mut diagrams));
            let weight = |world: usize| -> f64 {
                let of = |(at, p): (usize, &f64)| if world >> at & 1 == 1 { *p } else { 1.0 - p };
                PROBABILITIES.iter().enumerate().map(of).product()
            };
            let expected: f64 = (0..16).filter(|world| holds(&one, *world)).map(weight).sum();
            prop_assert!((diagrams.probability(first) - expected).abs() < 1e-12);
            // Equal formulas are the same node.
            let equal = (0..16).all(|world| holds(&one, world) == holds(&other, world));
            prop_assert_eq!(first == second, equal);
        }
    }

    #[test]
    fn large_formulas_are_refused() {
        let mut diagrams = Diagrams::new(100);
        let mut variables: Vec<Formula> = Vec::new();
        for _ in 0..20 {
            variables.push(diagrams.variable(0.5).unwrap());
        }
        // In this order the formula needs a node for each subset of the first half.
        let all = (0..10).try_fold(Formula::TRUE, |all, at| {
            let pair = diagrams.or(variables[at], variables[at + 10])?;
            diagrams.and(all, pair)
        });
        assert_eq!(all, Err(TooLarge));
    }
}
