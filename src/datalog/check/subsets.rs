//! Which of many sets are parts of another one.
//!
//! The sets stand in a trie, each with its rarest element first. Whoever asks walks down along the elements it has, so a set that lacks
//! one of them is not looked at, however many such sets there are.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::hash::Hash;

/// What a search may still look at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    most: usize,
    left: usize,
    complete: bool,
}

/// What a search took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Comparing {
    /// How often something was looked at.
    pub steps: usize,
    /// Whether all was looked at. If not, something may not have been found.
    pub complete: bool,
}

impl Default for Comparing {
    /// Nothing was looked for.
    fn default() -> Self {
        Budget::new(0).spent()
    }
}

impl Budget {
    /// So many steps.
    pub(crate) fn new(steps: usize) -> Self {
        Budget {
            most: steps,
            left: steps,
            complete: true,
        }
    }

    /// Takes steps; if there are not so many, the search is to be given up.
    pub(crate) fn take(&mut self, steps: usize) -> bool {
        match self.left.checked_sub(steps) {
            Some(left) => self.left = left,
            None => self.complete = false,
        }
        self.complete
    }

    /// A search that takes at most so many of the steps. Whether it found what it looked for.
    pub(crate) fn part(&mut self, steps: usize, search: impl FnOnce(&mut Budget) -> bool) -> bool {
        let mut part = Budget::new(steps.min(self.left));
        let found = search(&mut part);
        self.left -= part.most - part.left;
        self.complete &= found || part.complete;
        found
    }

    /// What has been taken.
    pub(crate) fn spent(&self) -> Comparing {
        Comparing {
            steps: self.most - self.left,
            complete: self.complete,
        }
    }
}

/// Sets, by number.
pub(crate) struct Subsets<E> {
    /// The rarest first, those that may be free last. The map is only asked, never walked.
    ranks: HashMap<E, usize>,
    /// The rank of the first element that may be free.
    free: usize,
    /// The first is the root.
    nodes: Vec<Node>,
}

#[derive(Default)]
struct Node {
    /// By the rank of a further element.
    children: BTreeMap<usize, usize>,
    /// The sets of just the elements on the way here.
    sets: Vec<usize>,
}

impl<E: Clone + Ord + Hash> Subsets<E> {
    /// Sets and their numbers. Who asks may count some elements as there anyway: those that `may_be_free`.
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
            nodes: vec![Node::default()],
        };
        for (number, set) in sets {
            let node = set_of_ranks(set, &subsets.ranks).into_iter().fold(0, |node, rank| {
                let new = subsets.nodes.len();
                let child = *subsets.nodes[node].children.entry(rank).or_insert(new);
                if child == new {
                    subsets.nodes.push(Node::default());
                }
                child
            });
            subsets.nodes[node].sets.push(*number);
        }
        subsets
    }

    /// The numbers, in order, of the sets all of whose elements are in this one or, if it `has_free`, may be free. `None` if it would
    /// take more steps than there are.
    pub(crate) fn within(&self, set: &BTreeSet<E>, has_free: bool, budget: &mut Budget) -> Option<Vec<usize>> {
        let mut ranks = set_of_ranks(set, &self.ranks);
        let free = if has_free { self.free } else { usize::MAX };
        ranks.split_off(&free);
        let mut found = Vec::new();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            let Node { children, sets } = &self.nodes[node];
            let before = open.len();
            if children.len() < ranks.len() {
                let has = |rank: usize| rank >= free || ranks.contains(&rank);
                open.extend(children.iter().filter(|(rank, _)| has(**rank)).map(|(_, child)| child));
            } else {
                open.extend(ranks.iter().filter_map(|rank| children.get(rank)));
                open.extend(children.range(free..).map(|(_, child)| child));
            }
            let rows_scanned = children.len().min(ranks.len()) + (open.len() - before) + sets.len();
            if !budget.take(1 + rows_scanned) {
                return None;
            }
            found.extend(sets);
        }
        found.sort_unstable();
        Some(found)
    }
}

/// The elements by rank; unknown ones are in no set.
fn set_of_ranks<E: Eq + Hash>(set: &BTreeSet<E>, ranks: &HashMap<E, usize>) -> BTreeSet<usize> {
    set.iter().filter_map(|element| ranks.get(element).copied()).collect()
}

/// Rules with clauses that often cover each other.
#[cfg(test)]
pub(crate) mod random_clauses {
    use crate::datalog::check::Rules;
    use crate::datalog::workspace::load;
    use crate::diag::Sources;
    use crate::files::ReadError;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use proptest::sample::select;

    const DECLARED: &str = ".decl D(x: symbol)\n.decl E, L, S(x: symbol, y: symbol)\n.input D, E, L, S\n\
                            .irreflexive L\n.symmetric S\n.implies L, E\n.decl P(x: symbol, y: symbol)\n.output P\n";

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
    use proptest::collection::{btree_set, vec};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn finds_what_looking_at_all_sets_finds(
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
    fn sets_that_lack_an_element_are_not_looked_at() {
        // All have 0 in common, each has an element of its own.
        let sets: Vec<(usize, BTreeSet<usize>)> = (1..=1_000).map(|own| (own, BTreeSet::from([0, own]))).collect();
        let found = Subsets::new(&sets, |_| false).within(&BTreeSet::from([0, 7]), false, &mut Budget::new(20));
        assert_eq!(found, Some(vec![7]));
    }
}
