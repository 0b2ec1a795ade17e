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
use crate::induce::problem::{Open, Problem, Rows};
use crate::induce::vocabulary::{Body, LITERAL_COST, Literal};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;
use std::rc::Rc;

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

struct SearchNode {
    /// An upper bound of the score of each extension.
    bound: i64,
    /// Position in the order of creation, to break ties.
    number: u32,
    chosen: Bits,
    banned: Bits,
    rows: Rc<Rows>,
    /// The exclusions that no chosen literal meets, of the first `compared` ones.
    open: Vec<u32>,
    compared: usize,
}

impl PartialEq for SearchNode {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for SearchNode {}

impl PartialOrd for SearchNode {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for SearchNode {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.cmp(&other.bound).then(other.number.cmp(&self.number))
    }
}

/// The search for the clauses of one example and one assignment.
pub struct ExampleSearch<'a> {
    problem: &'a Problem<'a>,
    /// The true atoms of the example.
    seed: &'a Bits,
    /// The positive states that count.
    open: &'a Open<'a>,
    /// For each negative row of the sample, the literals of the seed that are false there.
    exclusions: Vec<Bits>,
    cancel: &'a Cancel,
}

impl<'a> ExampleSearch<'a> {
    /// Prepares a search. `open` are the positive states that count.
    pub fn new(problem: &'a Problem<'a>, seed: &'a Bits, open: &'a Open<'a>, cancel: &'a Cancel) -> ExampleSearch<'a> {
        ExampleSearch {
            problem,
            seed,
            open,
            exclusions: Vec::new(),
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
        heap.push(SearchNode {
            bound: i64::MAX,
            number: 0,
            chosen: bits::empty(self.problem.atoms.len()),
            banned: bits::empty(self.problem.atoms.len()),
            rows: Rc::new(self.open.rows.clone()),
            open: Vec::new(),
            compared: 0,
        });
        let mut number = 0;
        while let Some(mut node) = heap.pop() {
            if self.cancel.requested() {
                return None;
            }
            self.compare(&mut node);
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
                self.compare(&mut node);
            }
            if number > nodes {
                return self.complete(node);
            }
            let choices = |at: u32| -> Bits {
                let exclusion = &self.exclusions[at as usize];
                exclusion
                    .iter()
                    .zip(&node.banned)
                    .map(|(exclusion, banned)| exclusion & !banned)
                    .collect()
            };
            let hardest = node
                .open
                .iter()
                .map(|&at| choices(at))
                .min_by_key(|choices| bits::count(choices));
            if let Some(choices) = hardest {
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
            let includes = |small: &Bits| small.iter().zip(&differ).all(|(small, differ)| small & !differ == 0);
            if self.exclusions.len() < begin + kept && !self.exclusions[begin..].iter().any(includes) {
                self.exclusions.push(differ);
            }
        }
        Some(())
    }

    /// Finds the exclusions since the last comparison that no chosen literal meets.
    fn compare(&self, node: &mut SearchNode) {
        for (at, exclusion) in self.exclusions.iter().enumerate().skip(node.compared) {
            if !bits::intersects(exclusion, &node.chosen) {
                node.open.push(at as u32);
            }
        }
        node.compared = self.exclusions.len();
    }

    /// Adds a node for each of the literals. Each bans those before it.
    fn branch(&self, heap: &mut BinaryHeap<SearchNode>, node: SearchNode, choices: &Bits, number: &mut u32) {
        let mut banned = node.banned;
        for literal in bits::elements(choices) {
            // With many rows, one literal takes a tenth of a second.
            if self.cancel.requested() {
                return;
            }
            let open: Vec<u32> = (node.open.iter().copied())
                .filter(|&at| !bits::contains(&self.exclusions[at as usize], literal))
                .collect();
            let Some(further) = self.fewest(&open, &banned) else {
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
            let rows = (self.problem).restrict(self.open.columns, &node.rows, atom, is_true);
            heap.push(SearchNode {
                bound: self.score(&rows, cost + further * LITERAL_COST),
                number: *number,
                chosen,
                banned: banned.clone(),
                rows: Rc::new(rows),
                open,
                compared: node.compared,
            });
            bits::insert(&mut banned, literal);
        }
    }

    /// Returns a number of literals, none of them banned, that any clause needs to meet some exclusions: the number of
    /// those that have no literal in common. `None` if no clause meets them.
    fn fewest(&self, open: &[u32], banned: &[u64]) -> Option<u32> {
        let (mut seen, mut count) = (Bits::from_slice(banned), 0);
        for &at in open {
            let exclusion = &self.exclusions[at as usize];
            if exclusion
                .iter()
                .zip(banned)
                .all(|(exclusion, banned)| exclusion & !banned == 0)
            {
                return None;
            }
            let is_apart = (exclusion.iter().zip(&seen).zip(banned))
                .all(|((exclusion, seen), banned)| exclusion & seen & !banned == 0);
            if is_apart {
                count += 1;
                seen.iter_mut().zip(exclusion).for_each(|(seen, more)| *seen |= more);
            }
        }
        Some(count)
    }

    /// Returns the score of a clause that holds in some rows of the states that count.
    fn score(&self, rows: &Rows, cost: u32) -> i64 {
        let covered = rows.states(self.open.columns.words);
        i64::from(bits::count(&covered)) * EXAMPLE - i64::from(cost)
    }

    /// Completes a clause greedily: the literal that excludes the most rows comes first.
    fn complete(mut self, mut node: SearchNode) -> Option<FoundClause> {
        while !self.cancel.requested() {
            while !node.open.is_empty() {
                let mut gains = vec![0_u32; self.problem.atoms.len()];
                for &at in &node.open {
                    bits::elements(&self.exclusions[at as usize]).for_each(|literal| gains[literal] += 1);
                }
                let best = (0..gains.len()).max_by_key(|&literal| (gains[literal], Reverse(literal)))?;
                bits::insert(&mut node.chosen, best);
                node.open
                    .retain(|&at| !bits::contains(&self.exclusions[at as usize], best));
            }
            let refuting = self.problem.holds(self.problem.negative, &node.chosen, self.seed);
            if !refuting.is_empty() {
                self.exclude(&refuting, REFUTATIONS)?;
                self.compare(&mut node);
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
    fn finish(&self, node: &SearchNode, is_best: bool) -> FoundClause {
        let mut chosen = node.chosen.clone();
        let mut order: Vec<usize> = bits::elements(&chosen).collect();
        order.sort_by_key(|&literal| (bits::contains(self.seed, literal), literal));
        for literal in order {
            let mut less = chosen.clone();
            bits::remove(&mut less, literal);
            let is_false = self
                .exclusions
                .iter()
                .all(|exclusion| bits::intersects(exclusion, &less));
            if is_false
                && self.problem.binds_all(&less, self.seed)
                && self.problem.holds(self.problem.negative, &less, self.seed).is_empty()
            {
                chosen = less;
            }
        }
        let rows = self.problem.holds(self.problem.positive, &chosen, self.seed);
        let counted = self.problem.holds(self.open.columns, &chosen, self.seed);
        let literals = bits::elements(&chosen).map(|literal| Literal {
            is_negated: !bits::contains(self.seed, literal),
            atom: self.problem.atoms[literal].clone(),
        });
        let body = Body::normalized(literals.collect(), self.problem.vocabulary);
        FoundClause {
            score: self.score(&counted, body.cost(self.problem.vocabulary)),
            covered: rows.states(self.problem.positive.words),
            body,
            is_best,
        }
    }
}
