//! Clauses as hitting sets: for each negative row that a search knows, a clause needs one of the literals that are false
//! there. The parts that the searches of [`crate::induce::search`] and [`crate::induce::relational`] share.

use crate::induce::bits::{self, Bits};
use crate::induce::vocabulary::{Atom, Body, Literal, Vocabulary};
use std::cmp::{Ordering, Reverse};

/// A partial clause of a best-first search, ordered by its bound. `T` is what it covers.
pub struct Node<T> {
    /// An upper bound of the score of each extension.
    pub bound: i64,
    /// Position in the order of creation, to break ties.
    pub number: u32,
    /// The literals of the clause.
    pub chosen: Bits,
    /// The literals that no extension has.
    pub banned: Bits,
    /// What the clause covers.
    pub covered: T,
    /// The exclusions that no chosen literal meets, of the first `compared` ones.
    pub open: Vec<u32>,
    /// The number of exclusions that `open` takes into account.
    pub compared: usize,
}

impl<T> Node<T> {
    /// Returns the clause without literals, of `literals` possible ones.
    pub fn root(literals: usize, covered: T) -> Node<T> {
        Node {
            bound: i64::MAX,
            number: 0,
            chosen: bits::empty(literals),
            banned: bits::empty(literals),
            covered,
            open: Vec::new(),
            compared: 0,
        }
    }
}

impl<T> PartialEq for Node<T> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<T> Eq for Node<T> {}

impl<T> PartialOrd for Node<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Node<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.cmp(&other.bound).then(other.number.cmp(&self.number))
    }
}

/// For each known negative row, the literals that are false there.
#[derive(Default)]
pub struct Exclusions(Vec<Bits>);

impl Exclusions {
    pub fn len(&self) -> usize {
        self.0.len()
    }

    pub fn push(&mut self, exclusion: Bits) {
        self.0.push(exclusion);
    }

    /// Returns whether one of the exclusions from `begin` on is a subset of another one, which is then met with it.
    pub fn imply(&self, begin: usize, exclusion: &[u64]) -> bool {
        let is_subset = |small: &Bits| small.iter().zip(exclusion).all(|(small, large)| small & !large == 0);
        self.0[begin..].iter().any(is_subset)
    }

    /// Returns whether a clause meets all exclusions.
    pub fn are_met(&self, chosen: &[u64]) -> bool {
        self.0.iter().all(|exclusion| bits::intersects(exclusion, chosen))
    }

    /// Adds to the open exclusions of a clause those since the last comparison that it does not meet.
    pub fn compare<T>(&self, node: &mut Node<T>) {
        for (at, exclusion) in self.0.iter().enumerate().skip(node.compared) {
            if !bits::intersects(exclusion, &node.chosen) {
                node.open.push(at as u32);
            }
        }
        node.compared = self.0.len();
    }

    /// Returns those of some exclusions that a literal does not meet.
    pub fn left(&self, open: &[u32], literal: usize) -> Vec<u32> {
        let is_left = |at: &u32| !bits::contains(&self.0[*at as usize], literal);
        open.iter().copied().filter(is_left).collect()
    }

    /// Returns the literals that meet the open exclusion of a clause with the fewest choices. `None` if none is open.
    pub fn hardest<T>(&self, node: &Node<T>) -> Option<Bits> {
        let choices = |&at: &u32| -> Bits {
            let literals = self.0[at as usize].iter().zip(&node.banned);
            literals.map(|(exclusion, banned)| exclusion & !banned).collect()
        };
        node.open.iter().map(choices).min_by_key(|choices| bits::count(choices))
    }

    /// Returns a number of literals, none of them banned, that any clause needs to meet some exclusions: the number of
    /// those that have no literal in common. `None` if no clause meets them.
    pub fn fewest(&self, open: &[u32], banned: &[u64]) -> Option<u32> {
        let (mut seen, mut count) = (Bits::from_slice(banned), 0);
        for &at in open {
            let exclusion = &self.0[at as usize];
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

    /// Adds literals to a clause until it meets its open exclusions: first those that meet the most. `None` if there are
    /// no literals.
    pub fn meet<T>(&self, node: &mut Node<T>, literals: usize) -> Option<()> {
        while !node.open.is_empty() {
            let mut gains = vec![0_u32; literals];
            for &at in &node.open {
                bits::elements(&self.0[at as usize]).for_each(|literal| gains[literal] += 1);
            }
            let best = (0..literals).max_by_key(|&literal| (gains[literal], Reverse(literal)))?;
            bits::insert(&mut node.chosen, best);
            node.open = self.left(&node.open, best);
        }
        Some(())
    }
}

/// Drops the literals of a clause that it does not need, negative ones first. `seed` are the positive ones, and
/// `suffices` says whether fewer literals are enough.
pub fn shortened(chosen: &Bits, seed: &[u64], mut suffices: impl FnMut(&Bits) -> bool) -> Bits {
    let mut order: Vec<usize> = bits::elements(chosen).collect();
    order.sort_by_key(|&literal| (bits::contains(seed, literal), literal));
    let mut chosen = chosen.clone();
    for literal in order {
        let mut less = chosen.clone();
        bits::remove(&mut less, literal);
        if suffices(&less) {
            chosen = less;
        }
    }
    chosen
}

/// Returns the body of a clause. `seed` are the positive literals.
pub fn body(chosen: &[u64], seed: &[u64], atoms: &[Atom], vocabulary: &Vocabulary) -> Body {
    let literals = bits::elements(chosen).map(|literal| Literal {
        is_negated: !bits::contains(seed, literal),
        atom: atoms[literal].clone(),
    });
    Body::normalized(literals.collect(), vocabulary)
}
