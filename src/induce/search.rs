//! The best clause that explains a given example: a best-first search.
//!
//! A clause for an example is a subset of the literals that are true in it, under one assignment of its entities. It
//! must be false in every row of the negative examples. So for each negative row it needs one of the literals that are
//! false there: the clause is a hitting set. The search extends clauses literal by literal and takes the most promising
//! first. Literals only remove rows and add cost, so the score of a partial clause bounds those of its extensions.
//!
//! The negative rows are many, and few of them matter. So the search begins with a sample. It compares a clause that is
//! false in the whole sample with all negative rows, and adds to the sample some of those in which it holds.
// Decision: docs/decisions/tasks.md#d070

use crate::cancel::Cancel;
use crate::induce::bits::{self, Bits};
use crate::induce::hitting_set::{Exclusions, Node, body, shortened};
use crate::induce::problem::{Open, Problem, Rows};
use crate::induce::vocabulary::{Body, LITERAL_COST};
use std::collections::BinaryHeap;

/// Negative rows that are compared with the example at the beginning, and those kept of them: the nearest ones.
const SAMPLE: (usize, usize) = (256, 64);
/// Negative rows that are compared with the example when a clause holds in some, and those kept of them.
const REFUTATIONS: (usize, usize) = (64, 8);

/// What a newly covered state counts in scores, in the unit of costs.
pub const EXAMPLE: i64 = 2 * LITERAL_COST as i64;

/// A clause that a search found.
#[derive(Clone, Debug)]
pub struct FoundClause {
    /// The body.
    pub body: Body,
    /// The positive states that the clause covers.
    pub covered: Vec<u64>,
    /// [`EXAMPLE`] for each newly covered state, minus the cost of the clause.
    pub score: i64,
    /// Whether no clause for this example and assignment has a higher score. False if the search was cut.
    pub is_best: bool,
}

/// The search for the clauses of one example and one assignment.
pub struct ExampleSearch<'a> {
    problem: &'a Problem<'a>,
    /// The true atoms of the example.
    seed: &'a Bits,
    /// The positive states that count.
    open: &'a Open<'a>,
    /// For each negative row of the sample, the literals of the seed that are false there.
    exclusions: Exclusions,
    cancel: &'a Cancel,
}

impl<'a> ExampleSearch<'a> {
    /// Prepares a search. `open` are the positive states that count.
    pub fn new(problem: &'a Problem<'a>, seed: &'a Bits, open: &'a Open<'a>, cancel: &'a Cancel) -> ExampleSearch<'a> {
        ExampleSearch {
            problem,
            seed,
            open,
            exclusions: Exclusions::default(),
            cancel,
        }
    }

    /// Finds the clause with the highest score among those that hold in the example and in no negative row. `None` if
    /// there is none, or on cancellation. Stops after `nodes` nodes and completes a clause greedily.
    pub fn best(self, nodes: u32) -> Option<FoundClause> {
        let cancel = self.cancel;
        // Rows are incomplete after cancellation, so the clause may hold in negative ones.
        self.found(nodes).filter(|_| !cancel.requested())
    }

    fn found(mut self, nodes: u32) -> Option<FoundClause> {
        let everything = self.problem.all(self.problem.negative);
        self.exclude(&everything, SAMPLE)?;
        let mut heap = BinaryHeap::new();
        heap.push(Node::root(self.problem.atoms.len(), self.open.rows.clone()));
        let mut number = 0;
        while let Some(mut node) = heap.pop() {
            if self.cancel.requested() {
                return None;
            }
            self.exclusions.compare(&mut node);
            if node.open.is_empty() {
                let refuting = self.problem.holds(self.problem.negative, &node.chosen, self.seed);
                if refuting.is_empty() {
                    match self.problem.binders(&node.chosen, &node.banned, self.seed) {
                        None => return Some(self.finish(&node, true)),
                        Some(choices) => {
                            self.branch(&mut heap, node, &choices, &mut number);
                            continue;
                        }
                    }
                }
                self.exclude(&refuting, REFUTATIONS)?;
                self.exclusions.compare(&mut node);
            }
            if number > nodes {
                return self.complete(node);
            }
            if let Some(choices) = self.exclusions.hardest(&node) {
                self.branch(&mut heap, node, &choices, &mut number);
            }
        }
        None
    }

    /// Adds to the exclusions those of the rows that differ least from the example. `None` if one does not differ.
    fn exclude(&mut self, rows: &Rows, (sample, kept): (usize, usize)) -> Option<()> {
        let negations = if self.problem.negation { u64::MAX } else { 0 };
        let mut differ: Vec<(u32, Bits)> = (self.problem.sample(self.problem.negative, rows, sample).into_iter())
            .map(|row| {
                let exclude = |(row, seed): (&u64, &u64)| (row ^ seed) & (seed | negations);
                let differ: Bits = row.iter().zip(self.seed).map(exclude).collect();
                (bits::count(&differ), differ)
            })
            .collect();
        differ.sort_unstable();
        differ.dedup();
        let begin = self.exclusions.len();
        for (count, differ) in differ {
            if count == 0 {
                return None;
            }
            if self.exclusions.len() < begin + kept && !self.exclusions.imply(begin, &differ) {
                self.exclusions.push(differ);
            }
        }
        Some(())
    }

    /// Adds a node for each of the literals. Each bans those before it.
    fn branch(&self, heap: &mut BinaryHeap<Node<Rows>>, node: Node<Rows>, choices: &Bits, number: &mut u32) {
        let mut banned = node.banned;
        for literal in bits::elements(choices) {
            // With many rows, one literal takes a tenth of a second.
            if self.cancel.requested() {
                return;
            }
            let open = self.exclusions.left(&node.open, literal);
            let Some(further) = self.exclusions.fewest(&open, &banned) else {
                // Without the banned literals, a row cannot be excluded.
                bits::insert(&mut banned, literal);
                continue;
            };
            *number += 1;
            let is_true = bits::contains(self.seed, literal);
            let mut chosen = node.chosen.clone();
            bits::insert(&mut chosen, literal);
            let cost = self.problem.cost(&chosen, self.seed);
            let atom = &self.problem.atoms[literal];
            let rows = (self.problem).restrict(self.open.columns, &node.covered, atom, is_true);
            heap.push(Node {
                bound: self.score(&rows, cost + further * LITERAL_COST),
                number: *number,
                chosen,
                banned: banned.clone(),
                covered: rows,
                open,
                compared: node.compared,
            });
            bits::insert(&mut banned, literal);
        }
    }

    /// Returns the score of a clause that holds in some rows of the states that count.
    fn score(&self, rows: &Rows, cost: u32) -> i64 {
        let covered = rows.states(self.open.columns.words);
        i64::from(bits::count(&covered)) * EXAMPLE - i64::from(cost)
    }

    /// Completes a clause greedily: the literal that excludes the most rows comes first.
    fn complete(mut self, mut node: Node<Rows>) -> Option<FoundClause> {
        while !self.cancel.requested() {
            self.exclusions.meet(&mut node, self.problem.atoms.len())?;
            let refuting = self.problem.holds(self.problem.negative, &node.chosen, self.seed);
            if !refuting.is_empty() {
                self.exclude(&refuting, REFUTATIONS)?;
                self.exclusions.compare(&mut node);
            } else if let Some(binders) =
                self.problem
                    .binders(&node.chosen, &bits::empty(self.problem.atoms.len()), self.seed)
            {
                bits::insert(&mut node.chosen, bits::elements(&binders).next()?);
            } else {
                return Some(self.finish(&node, false));
            }
        }
        None
    }

    /// Drops the literals that the clause does not need, negative ones first.
    fn finish(&self, node: &Node<Rows>, is_best: bool) -> FoundClause {
        let chosen = shortened(&node.chosen, self.seed, |less| {
            self.exclusions.are_met(less)
                && self.problem.binds_all(less, self.seed)
                && self.problem.holds(self.problem.negative, less, self.seed).is_empty()
        });
        let rows = self.problem.holds(self.problem.positive, &chosen, self.seed);
        let counted = self.problem.holds(self.open.columns, &chosen, self.seed);
        let body = body(&chosen, self.seed, &self.problem.atoms, self.problem.vocabulary);
        FoundClause {
            score: self.score(&counted, body.cost(self.problem.vocabulary)),
            covered: rows.states(self.problem.positive.words),
            body,
            is_best,
        }
    }
}
