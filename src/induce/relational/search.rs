//! The best clause of a choice: a best-first search like that of [`crate::induce::search`], whose negative rows are
//! found when a clause needs them instead of listed.
//!
//! The search knows some negative rows, and of each the literals that are false there. A clause that has one of these
//! for each known row is compared with all negative examples. Rows in which it holds become known.
// Decision: docs/decisions/tasks.md#d072

use crate::cancel::Cancel;
use crate::induce::bits::{self, Bits};
use crate::induce::hitting_set::{Exclusions, Node, body, shortened};
use crate::induce::relational::bottom::Bottom;
use crate::induce::relational::database::{Binding, Database};
use crate::induce::search::{EXAMPLE, FoundClause};
use crate::induce::vocabulary::{Atom, Body, LITERAL_COST, cost};
use smallvec::SmallVec;
use std::collections::BinaryHeap;

/// The negative rows that become known when a clause holds in some.
const REFUTATIONS: usize = 4;

/// The examples of a search: the constants of their heads.
pub struct Cases<'a> {
    /// All positive examples.
    pub positive: &'a [Vec<u32>],
    /// All negative examples.
    pub negative: &'a [Vec<u32>],
    /// The positive examples that count, or a sample of them.
    pub open: &'a [u32],
    /// What one of them counts in scores, in the unit of costs.
    pub weight: i64,
    /// The negative examples with which a search begins: those that refuted the most clauses before.
    pub hard: &'a [u32],
}

/// What a search found.
pub struct Found {
    /// The clause. Its score counts the examples of [`Cases::open`].
    pub clause: FoundClause,
    /// The negative examples that refuted other clauses.
    pub refuting: Vec<u32>,
}

/// The search for the best clause of a choice.
pub struct BottomSearch<'a> {
    database: &'a Database,
    bottom: &'a Bottom,
    cases: &'a Cases<'a>,
    /// The search ignores clauses whose score is not above this one.
    least: i64,
    /// For each known negative row, the literals that are false there.
    exclusions: Exclusions,
    refuting: Vec<u32>,
    cancel: &'a Cancel,
}

impl<'a> BottomSearch<'a> {
    /// Prepares a search for a clause with a score above `least`.
    pub fn new(
        database: &'a Database,
        bottom: &'a Bottom,
        cases: &'a Cases<'a>,
        least: i64,
        cancel: &'a Cancel,
    ) -> BottomSearch<'a> {
        BottomSearch {
            database,
            bottom,
            cases,
            least,
            exclusions: Exclusions::default(),
            refuting: Vec::new(),
            cancel,
        }
    }

    /// Finds the clause with the highest score that holds in no negative example. `None` if there is none with a score
    /// above the least one, or on cancellation. Stops after `nodes` nodes and completes a clause greedily.
    pub fn best(mut self, nodes: u32) -> Option<Found> {
        let clause = self.clause(nodes).filter(|_| !self.cancel.requested())?;
        Some(Found {
            clause,
            refuting: self.refuting,
        })
    }

    fn clause(&mut self, nodes: u32) -> Option<FoundClause> {
        for &case in self.cases.hard {
            let binding = Database::bound(&self.cases.negative[case as usize]);
            self.exclude(&binding)?;
        }
        let literals = self.bottom.atoms.len();
        let mut heap = BinaryHeap::new();
        heap.push(Node::root(literals, self.cases.open.to_vec()));
        let mut number = 0;
        while let Some(mut node) = heap.pop() {
            if self.cancel.requested() || node.bound <= self.least {
                return None;
            }
            self.exclusions.compare(&mut node);
            if node.open.is_empty() {
                if self.is_safe(&node.chosen) && !self.refute(&node.chosen)? {
                    return Some(self.finish(&node.chosen, true));
                }
                self.exclusions.compare(&mut node);
                if node.open.is_empty() {
                    let binders = self.binders(&node.chosen, &node.banned);
                    self.branch(&mut heap, &node, &binders, &mut number);
                    continue;
                }
            }
            if number > nodes {
                return self.complete(node);
            }
            if let Some(choices) = self.exclusions.hardest(&node) {
                self.branch(&mut heap, &node, &choices, &mut number);
            }
        }
        None
    }

    /// Adds the false literals of a negative row. `None` if there is none, so that no clause excludes the row.
    fn exclude(&mut self, binding: &Binding) -> Option<()> {
        let exclusion = self.bottom.false_in(self.database, binding);
        if bits::count(&exclusion) == 0 {
            return None;
        }
        if !self.exclusions.imply(0, &exclusion) {
            self.exclusions.push(exclusion);
        }
        Some(())
    }

    /// Looks for negative examples in which a clause holds, and adds their rows. Returns whether there are any; `None`
    /// if no clause excludes one of them.
    fn refute(&mut self, chosen: &[u64]) -> Option<bool> {
        let literals = self.bottom.literals(chosen);
        let negative = self.cases.negative;
        let mut count = 0;
        let others = (0..negative.len() as u32).filter(|case| !self.cases.hard.contains(case));
        for case in self.cases.hard.iter().copied().chain(others) {
            let binding = Database::bound(&negative[case as usize]);
            let Some(row) = self.database.witness(&literals, &binding, self.cancel) else {
                continue;
            };
            self.refuting.push(case);
            self.exclude(&row)?;
            count += 1;
            if count == REFUTATIONS {
                break;
            }
        }
        Some(count > 0)
    }

    /// Adds a node for each of the literals. Each bans those before it.
    fn branch(&self, heap: &mut BinaryHeap<Node<Vec<u32>>>, node: &Node<Vec<u32>>, choices: &Bits, number: &mut u32) {
        let mut banned = node.banned.clone();
        for literal in bits::elements(choices) {
            if self.cancel.requested() {
                return;
            }
            let open = self.exclusions.left(&node.open, literal);
            if let Some(further) = self.exclusions.fewest(&open, &banned) {
                *number += 1;
                let mut chosen = node.chosen.clone();
                bits::insert(&mut chosen, literal);
                let cost = self.cost(&chosen) + further * LITERAL_COST;
                let most = self.score(node.covered.len(), cost);
                if most > self.least {
                    let covered = self.covered(&chosen, &node.covered);
                    let bound = self.score(covered.len(), cost);
                    if bound > self.least {
                        heap.push(Node {
                            bound,
                            number: *number,
                            chosen,
                            banned: banned.clone(),
                            covered,
                            open,
                            compared: node.compared,
                        });
                    }
                }
            }
            bits::insert(&mut banned, literal);
        }
    }

    /// Returns the examples of a list that a conjunction covers. Literals whose variables are not linked yet are left
    /// out: others will link them.
    fn covered(&self, chosen: &[u64], among: &[u32]) -> Vec<u32> {
        let literals = self.bottom.literals(chosen);
        let linked = self.database.vocabulary().bound(
            literals
                .iter()
                .filter(|(_, is_positive)| *is_positive)
                .map(|(atom, _)| *atom),
        );
        let literals: Vec<_> = (literals.iter().copied())
            .filter(|(atom, _)| atom.arguments.iter().all(|variable| linked >> variable & 1 == 1))
            .collect();
        let covers = |case: &u32| {
            let binding = Database::bound(&self.cases.positive[*case as usize]);
            self.database.witness(&literals, &binding, self.cancel).is_some()
        };
        among.iter().copied().filter(covers).collect()
    }

    fn cost(&self, chosen: &[u64]) -> u32 {
        let literals =
            bits::elements(chosen).map(|at| (&self.bottom.atoms[at], !bits::contains(&self.bottom.seed, at)));
        cost(literals, self.database.vocabulary().egos())
    }

    fn score(&self, covered: usize, cost: u32) -> i64 {
        covered as i64 * self.cases.weight - i64::from(cost)
    }

    /// Returns whether positive literals link all variables of a clause to its head, and contain those of the head.
    fn is_safe(&self, chosen: &[u64]) -> bool {
        self.unlinked(chosen) == 0
    }

    /// Returns the variables of a clause, or of its head, that positive literals must still link: first those of the
    /// head that do not occur.
    fn unlinked(&self, chosen: &[u64]) -> u64 {
        let vocabulary = self.database.vocabulary();
        let set = |atom: &Atom| atom.arguments.iter().fold(0_u64, |set, variable| set | 1 << variable);
        let positive = bits::elements(chosen).filter(|&at| bits::contains(&self.bottom.seed, at));
        let positive: Vec<&Atom> = positive.map(|at| &self.bottom.atoms[at]).collect();
        let occurring = positive.iter().fold(0, |all, atom| all | set(atom));
        let heads = (1_u64 << vocabulary.egos()) - 1;
        match heads & !occurring {
            0 => {
                let used = bits::elements(chosen).fold(heads, |used, at| used | set(&self.bottom.atoms[at]));
                used & !vocabulary.bound(positive.iter().copied())
            }
            missing => missing,
        }
    }

    /// Returns the literals of which every safe extension of a clause without a banned literal has one.
    fn binders(&self, chosen: &[u64], banned: &[u64]) -> Bits {
        let vocabulary = self.database.vocabulary();
        let heads = (1_u64 << vocabulary.egos()) - 1;
        let wanted = self.unlinked(chosen);
        let positive = bits::elements(chosen).filter(|&at| bits::contains(&self.bottom.seed, at));
        let positive: Vec<&Atom> = positive.map(|at| &self.bottom.atoms[at]).collect();
        let bound = vocabulary.bound(positive.iter().copied());
        let first = wanted & wanted.wrapping_neg();
        let set = |atom: &Atom| atom.arguments.iter().fold(0_u64, |set, variable| set | 1 << variable);
        let serves = |atom: &Atom| match wanted & heads {
            0 => set(atom) & !bound != 0 && vocabulary.binds(atom, bound),
            _ => set(atom) & first != 0,
        };
        let mut binders = bits::empty(self.bottom.atoms.len());
        for at in bits::elements(&self.bottom.seed) {
            if !bits::contains(banned, at) && !bits::contains(chosen, at) && serves(&self.bottom.atoms[at]) {
                bits::insert(&mut binders, at);
            }
        }
        binders
    }

    /// Completes a clause greedily: the literal that is false in the most rows comes first.
    fn complete(&mut self, mut node: Node<Vec<u32>>) -> Option<FoundClause> {
        while !self.cancel.requested() {
            self.exclusions.meet(&mut node, self.bottom.atoms.len())?;
            if !self.is_safe(&node.chosen) {
                let binders = self.binders(&node.chosen, &bits::empty(self.bottom.atoms.len()));
                bits::insert(&mut node.chosen, bits::elements(&binders).next()?);
            } else if self.refute(&node.chosen)? {
                self.exclusions.compare(&mut node);
            } else {
                return Some(self.finish(&node.chosen, false)).filter(|found| found.score > self.least);
            }
        }
        None
    }

    /// Drops the literals that the clause does not need, negative ones first.
    fn finish(&mut self, chosen: &Bits, is_best: bool) -> FoundClause {
        let bottom = self.bottom;
        let chosen = shortened(chosen, &bottom.seed, |less| {
            self.exclusions.are_met(less) && self.is_safe(less) && self.refute(less) == Some(false)
        });
        let body = body(&chosen, &bottom.seed, &bottom.atoms, self.database.vocabulary());
        let counted = self.covered(&chosen, self.cases.open);
        let cost = body.cost(self.database.vocabulary());
        FoundClause {
            score: self.score(counted.len(), cost),
            covered: covered_by(self.database, &body, self.cases.positive, self.cancel),
            body,
            is_best,
        }
    }
}

/// Returns the examples, given by the constants of their heads, in which a body holds.
pub fn covered_by(database: &Database, body: &Body, heads: &[Vec<u32>], cancel: &Cancel) -> Vec<u64> {
    let mut covered = bits::empty(heads.len()).into_vec();
    for (case, _) in heads
        .iter()
        .enumerate()
        .filter(|(_, head)| holds(database, body, head, cancel))
    {
        bits::insert(&mut covered, case);
    }
    covered
}

/// Returns whether a body holds for the constants of a head.
pub fn holds(database: &Database, body: &Body, head: &[u32], cancel: &Cancel) -> bool {
    let literals: SmallVec<[(&Atom, bool); 16]> = body
        .0
        .iter()
        .map(|literal| (&literal.atom, !literal.is_negated))
        .collect();
    database.witness(&literals, &Database::bound(head), cancel).is_some()
}

/// What an example counts in scores if a sample of `sample` stands for `all`.
pub fn weight(all: usize, sample: usize) -> i64 {
    EXAMPLE * all as i64 / (sample.max(1) as i64)
}
