//! Subset queries: which of many sets are subsets of a given one.
//!
//! A trie stores the sets, each with its rarest element first. A query follows only the elements of its own set. So it
//! never visits a set whose rarest element it lacks, however many there are.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::hash::Hash;

/// The remaining steps of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    most: usize,
    left: usize,
    complete: bool,
}

/// The work of a search for subsumed clauses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Comparing {
    /// The number of steps.
    pub steps: usize,
    /// Whether the search was exhaustive. If not, it may have missed something.
    pub complete: bool,
}

impl Default for Comparing {
    /// An empty search.
    fn default() -> Self {
        Budget::new(0).spent()
    }
}

impl Budget {
    /// Creates a budget of this many steps.
    pub(crate) fn new(steps: usize) -> Self {
        Budget {
            most: steps,
            left: steps,
            complete: true,
        }
    }

    /// Takes steps from the budget. Returns whether the search may continue.
    pub(crate) fn take(&mut self, steps: usize) -> bool {
        match self.left.checked_sub(steps) {
            Some(left) => self.left = left,
            None => self.complete = false,
        }
        self.complete
    }

    /// Runs a search with at most `steps` of the remaining steps. Returns whether it succeeded.
    pub(crate) fn part(&mut self, steps: usize, search: impl FnOnce(&mut Budget) -> bool) -> bool {
        let mut part = Budget::new(steps.min(self.left));
        let found = search(&mut part);
        self.left -= part.most - part.left;
        self.complete &= found || part.complete;
        found
    }

    /// Returns the work so far.
    pub(crate) fn spent(&self) -> Comparing {
        Comparing {
            steps: self.most - self.left,
            complete: self.complete,
        }
    }
}

/// A collection of sets, identified by numbers.
pub(crate) struct Subsets<E> {
    /// The rank of each element: rarest first, and those that may be free last. Lookup only, never iterated.
    ranks: HashMap<E, usize>,
    /// The rank of the first element that may be free.
    free: usize,
    /// The nodes of the trie; the first one is the root.
    nodes: Vec<TrieNode>,
}

#[derive(Default)]
struct TrieNode {
    /// The children by the rank of the next element.
    children: BTreeMap<usize, usize>,
    /// The numbers of the sets that end at this node.
    sets: Vec<usize>,
}

impl<E: Clone + Ord + Hash> Subsets<E> {
    /// Builds the trie of numbered sets. A query may treat the elements with `may_be_free` as present.
    pub(crate) fn new(sets: &[(usize, BTreeSet<E>)], may_be_free: impl Fn(&E) -> bool) -> Self {
        let mut counts: BTreeMap<&E, usize> = BTreeMap::new();
        for element in sets.iter().flat_map(|(_, set)| set) {
            *counts.entry(element).or_default() += 1;
        }
        let mut elements: Vec<(bool, usize, &E)> = (counts.into_iter())
            .map(|(element, count)| (may_be_free(element), count, element))
            .collect();
        elements.sort_unstable();
        let mut subsets = Subsets {
            free: elements.partition_point(|(free, ..)| !free),
            ranks: elements
                .into_iter()
                .map(|(.., element)| element.clone())
                .zip(0..)
                .collect(),
            nodes: vec![TrieNode::default()],
        };
        for (number, set) in sets {
            let node = set_of_ranks(set, &subsets.ranks).into_iter().fold(0, |node, rank| {
                let new = subsets.nodes.len();
                let child = *subsets.nodes[node].children.entry(rank).or_insert(new);
                if child == new {
                    subsets.nodes.push(TrieNode::default());
                }
                child
            });
            subsets.nodes[node].sets.push(*number);
        }
        subsets
    }

    /// Returns, in order, the numbers of the sets that are subsets of `set`. With `has_free`, free elements count as
    /// present. `None` if the budget does not suffice.
    pub(crate) fn within(&self, set: &BTreeSet<E>, has_free: bool, budget: &mut Budget) -> Option<Vec<usize>> {
        let mut ranks = set_of_ranks(set, &self.ranks);
        let free = if has_free { self.free } else { usize::MAX };
        ranks.split_off(&free);
        let mut found = Vec::new();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            let TrieNode { children, sets } = &self.nodes[node];
            let before = open.len();
            if children.len() < ranks.len() {
                let has = |rank: usize| rank >= free || ranks.contains(&rank);
                open.extend(children.iter().filter(|(rank, _)| has(**rank)).map(|(_, child)| child));
            } else {
                open.extend(ranks.iter().filter_map(|rank| children.get(rank)));
                open.extend(children.range(free..).map(|(_, child)| child));
            }
            let visited = children.len().min(ranks.len()) + (open.len() - before) + sets.len();
            if !budget.take(1 + visited) {
                return None;
            }
            found.extend(sets);
        }
        found.sort_unstable();
        Some(found)
    }
}

/// Returns the ranks of the elements. No set contains the others.
fn set_of_ranks<E: Eq + Hash>(set: &BTreeSet<E>, ranks: &HashMap<E, usize>) -> BTreeSet<usize> {
    set.iter().filter_map(|element| ranks.get(element).copied()).collect()
}

/// Random rules whose clauses often subsume each other.
#[cfg(test)]
pub(crate) mod random_clauses {
    use crate::check::Rules;
    use crate::diag::Sources;
    use crate::files::ReadError;
    use crate::workspace::load;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use proptest::sample::select;

    const DECLARED: &str = ".decl D(x: symbol)\n.decl E, L, S(x: symbol, y: symbol)\n.input D, E, L, S\n\
                            .asymmetric L\n.symmetric S\n.reflexive E\n.implies L, E\n.decl P(x: symbol, y: symbol)\n.output P\n";

    const HEADS: &[&str] = &["P(x, y)", "P(x, x)", "P(x, \"a\")", "P(\"a\", y)"];

    const LITERALS: &[&str] = &[
        "E(x, y)",
        "E(y, x)",
        "E(x, x)",
        "E(x, _)",
        "E(x, \"a\")",
        "E(\"a\", y)",
        "E(y, z)",
        "L(x, y)",
        "L(y, z)",
        "L(\"b\", y)",
        "S(x, y)",
        "S(y, x)",
        "S(z, \"a\")",
        "!E(x, y)",
        "!E(x, _)",
        "!E(x, x)",
        "!L(x, x)",
        "!L(x, y)",
        "!L(z, z)",
        "!S(_, y)",
        "x != y",
        "y != x",
        "x = \"a\"",
        "y = z",
        "x < \"b\"",
        "\"b\" > x",
        "x != \"a\"",
        "x <= y",
        "contains(\"a\", x)",
    ];

    pub(crate) fn rules() -> impl Strategy<Value = Rules> {
        vec((select(HEADS), vec(select(LITERALS), 0..4)), 2..12).prop_map(|clauses| {
            let clause = |(head, body): (&str, Vec<&str>)| {
                let body = body.join(", ");
                let others = ["y", "z"].map(|name| match (head.to_owned() + &body).contains(name) {
                    true => format!(", D({name})"),
                    false => String::new(),
                });
                let comma = if body.is_empty() { "" } else { ", " };
                format!("{head} :- D(x){}{comma}{body}.\n", others.concat())
            };
            let text = DECLARED.to_owned() + &clauses.into_iter().map(clause).collect::<String>();
            let mut sources = Sources::new();
            let id = sources.add("random.dl", text);
            let loaded = load(&mut sources, id, &|_: &std::path::Path| Err(ReadError::NotFound));
            loaded.rules.unwrap_or_else(|| panic!("{:?}", loaded.diagnostics))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::cases;
    use proptest::collection::{btree_set, vec};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]

        #[test]
        fn equals_linear_search(
            sets in vec(btree_set(0_u8..12, 0..5), 0..40),
            set in btree_set(0_u8..14, 0..9),
            limit in proptest::option::of(0_u8..12),
        ) {
            let numbered: Vec<(usize, BTreeSet<u8>)> = sets.into_iter().enumerate().collect();
            let free = |element: &u8| limit.is_some_and(|limit| *element >= limit);
            let slow: Vec<usize> = (numbered.iter())
                .filter(|(_, part)| part.iter().all(|element| set.contains(element) || free(element)))
                .map(|(number, _)| *number)
                .collect();
            let subsets = Subsets::new(&numbered, |element| *element >= limit.unwrap_or(6));
            let fast = |budget: &mut Budget| subsets.within(&set, limit.is_some(), budget);
            let mut enough = Budget::new(10_000);
            prop_assert_eq!(fast(&mut enough), Some(slow));
            let needed = enough.spent();
            prop_assert!(needed.complete);
            let mut short = Budget::new(needed.steps - 1);
            prop_assert_eq!(fast(&mut short), None);
            prop_assert!(!short.spent().complete);
        }
    }

    #[test]
    fn skips_sets_that_lack_an_element() {
        // All sets share 0, and each has one unique element.
        let sets: Vec<(usize, BTreeSet<usize>)> = (1..=1_000).map(|own| (own, BTreeSet::from([0, own]))).collect();
        let found = Subsets::new(&sets, |_| false).within(&BTreeSet::from([0, 7]), false, &mut Budget::new(20));
        assert_eq!(found, Some(vec![7]));
    }
}
