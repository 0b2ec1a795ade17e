//! A set of clauses of least cost that covers all examples.

use crate::cancel::Cancel;
use crate::induce::bits;
use std::collections::BTreeSet;

/// The nodes after which the search for a cheaper cover stops.
const NODES_MAX: u32 = 200_000;

/// Nodes between two polls for cancellation.
const POLL_NODES: u32 = 16;

/// A cover of all elements.
pub struct Cover {
    /// Indices of the chosen columns, in ascending order.
    pub columns: Vec<usize>,
    /// Whether no cheaper cover exists. False if the search was cut.
    pub is_cheapest: bool,
}

/// Chooses columns of least total cost that cover every element that some column covers. A column is a set of elements
/// with its cost. After cancellation, the cover may not be the cheapest.
pub fn cheapest_cover(columns: &[(Vec<u64>, u32)], cancel: &Cancel) -> Cover {
    let words = columns.first().map_or(0, |(set, _)| set.len());
    // Only the sets of columns that cover an element matter, and only the minimal ones.
    let mut distinct: BTreeSet<(usize, Vec<usize>)> = BTreeSet::new();
    for element in 0..words * 64 {
        let covers = |column: &usize| bits::contains(&columns[*column].0, element);
        let covering: Vec<usize> = (0..columns.len()).filter(covers).collect();
        distinct.insert((covering.len(), covering));
    }
    let mut elements: Vec<Vec<usize>> = Vec::new();
    for (_, covering) in distinct.into_iter().filter(|(count, _)| *count > 0) {
        let is_superset = |small: &Vec<usize>| small.iter().all(|column| covering.binary_search(column).is_ok());
        if !elements.iter().any(is_superset) {
            elements.push(covering);
        }
    }
    let costs: Vec<u32> = columns.iter().map(|(_, cost)| *cost).collect();
    let best = greedy(&elements, &costs);
    let mut search = CoverSearch {
        best_cost: best.iter().map(|&column| costs[column]).sum(),
        elements,
        costs,
        best,
        nodes: 0,
        cancel,
    };
    search.extend(&mut vec![false; columns.len()], &mut Vec::new(), 0);
    search.best.sort_unstable();
    Cover {
        is_cheapest: search.nodes <= NODES_MAX,
        columns: search.best,
    }
}

fn greedy(elements: &[Vec<usize>], costs: &[u32]) -> Vec<usize> {
    let (mut open, mut chosen) = (elements.iter().collect::<Vec<_>>(), Vec::new());
    while !open.is_empty() {
        let mut gains = vec![0_u64; costs.len()];
        open.iter()
            .for_each(|covering| covering.iter().for_each(|&column| gains[column] += 1));
        let better = |a: usize, b: usize| gains[a] * u64::from(costs[b]) > gains[b] * u64::from(costs[a]);
        let best = (0..costs.len()).reduce(|best, column| if better(column, best) { column } else { best });
        let Some(best) = best else { break };
        open.retain(|covering| !covering.contains(&best));
        chosen.push(best);
    }
    chosen
}

struct CoverSearch<'a> {
    /// For each element, the columns that cover it.
    elements: Vec<Vec<usize>>,
    costs: Vec<u32>,
    best: Vec<usize>,
    best_cost: u32,
    nodes: u32,
    cancel: &'a Cancel,
}

impl CoverSearch<'_> {
    /// Tries the columns of the uncovered element that has the fewest.
    fn extend(&mut self, is_chosen: &mut Vec<bool>, chosen: &mut Vec<usize>, cost: u32) {
        self.nodes += 1;
        if self.nodes.is_multiple_of(POLL_NODES) && self.cancel.requested() {
            self.nodes = NODES_MAX;
        }
        if self.nodes > NODES_MAX {
            return;
        }
        let uncovered = |covering: &&Vec<usize>| !covering.iter().any(|&column| is_chosen[column]);
        let Some(hardest) = self
            .elements
            .iter()
            .filter(uncovered)
            .min_by_key(|covering| covering.len())
        else {
            (self.best, self.best_cost) = (chosen.clone(), cost);
            return;
        };
        let mut covering = hardest.clone();
        covering.sort_by_key(|&column| (self.costs[column], column));
        for column in covering {
            let cost = cost + self.costs[column];
            if cost >= self.best_cost {
                break;
            }
            is_chosen[column] = true;
            chosen.push(column);
            self.extend(is_chosen, chosen, cost);
            chosen.pop();
            is_chosen[column] = false;
        }
    }
}
