//! Equality saturation: a body and its simpler forms in one e-graph.
//!
//! A body is a node over the sorted set of its literals' e-classes, so that order and repetition do not matter. These
//! rules run until they add no form:
//!
//! ```text
//! two literals that imply each other           are one class
//! all(.., a, b, ..)   with a and b exclusive   =  never
//! all(.., a, b, ..)   with a => b              =  all(.., a, ..)
//! all(.., a, ..)      with a always true       =  all(..)
//! ```
//!
//! Extraction prefers the fewest literals, then those written first. This is the only user of egg. It does not use
//! egg's runner, which reads the clock.

use egg::{CostFunction, EGraph, Extractor, Id, Language, define_language};

define_language! {
    /// Literals, by number, and conjunctions of them.
    enum Conjunction {
        Literal(u32),
        "all" = All(Box<[Id]>),
        "never" = Never,
    }
}

/// Predicates between literals, which are given by number.
pub(super) trait Knowledge {
    /// Whether `b` holds whenever `a` does.
    fn implies(&self, a: usize, b: usize) -> bool;
    /// Whether `a` and `b` never hold together. With `a` = `b`: whether it never holds.
    fn exclude(&self, a: usize, b: usize) -> bool;
    /// Whether `a` always holds.
    fn always(&self, a: usize) -> bool;
}

/// The search stops when the e-graph has more nodes than this.
const NODES_MAX: usize = 4096;

/// Returns the cheapest form of the conjunction of literals 0 to `count`, or `None` if it never holds.
pub(super) fn simplest(count: usize, knowledge: &dyn Knowledge) -> Option<Vec<usize>> {
    let mut egraph: EGraph<Conjunction, ()> = EGraph::new(());
    let leaves: Vec<Id> = (0..count as u32)
        .map(|number| egraph.add(Conjunction::Literal(number)))
        .collect();
    for a in 0..count {
        for b in 0..a {
            if knowledge.implies(a, b) && knowledge.implies(b, a) {
                egraph.union(leaves[a], leaves[b]);
            }
        }
    }
    let root = egraph.add(Conjunction::All(leaves.into()));
    egraph.rebuild();
    let mut rows_scanned = 0;
    loop {
        let forms: Vec<Conjunction> = egraph[egraph.find(root)].nodes.clone();
        if forms.len() <= rows_scanned || egraph.total_number_of_nodes() > NODES_MAX {
            break;
        }
        rows_scanned = forms.len();
        for form in forms {
            let Conjunction::All(parts) = form else { continue };
            for better in simpler(&egraph, &parts, knowledge) {
                let better = egraph.add(better);
                egraph.union(root, better);
            }
        }
        egraph.rebuild();
    }
    let (_, best) = Extractor::new(&egraph, Fewest).find_best(root);
    let literals: Vec<usize> = (best.as_ref().iter())
        .filter_map(|node| match node {
            Conjunction::Literal(number) => Some(*number as usize),
            _ => None,
        })
        .collect();
    match best.as_ref().last() {
        Some(Conjunction::Never) => None,
        _ => Some(literals),
    }
}

/// Rewrites a conjunction by one step.
fn simpler(egraph: &EGraph<Conjunction, ()>, parts: &[Id], knowledge: &dyn Knowledge) -> Vec<Conjunction> {
    let mut set: Vec<Id> = parts.iter().map(|&part| egraph.find(part)).collect();
    set.sort_unstable();
    set.dedup();
    let literal = |class: Id| {
        egraph[class].nodes.iter().find_map(|node| match node {
            Conjunction::Literal(number) => Some(*number as usize),
            _ => None,
        })
    };
    let literals: Vec<usize> = set.iter().filter_map(|&class| literal(class)).collect();
    let mut found = Vec::new();
    if set.len() < parts.len() {
        found.push(Conjunction::All(set.clone().into()));
    }
    if literals
        .iter()
        .any(|&a| literals.iter().any(|&b| knowledge.exclude(a, b)))
    {
        found.push(Conjunction::Never);
    }
    // Remove one at a time, the last first. Implication is an order on classes, so every sequence ends in the same
    // form.
    let redundant = (0..literals.len()).rev().find(|&at| {
        let implied = |&(other, &literal): &(usize, &usize)| other != at && knowledge.implies(literal, literals[at]);
        knowledge.always(literals[at]) || literals.iter().enumerate().any(|pair| implied(&pair))
    });
    if let Some(at) = redundant {
        set.remove(at);
        found.push(Conjunction::All(set.into()));
    }
    found
}

/// The cost of a form: the number of literals, then their positions.
struct Fewest;

impl CostFunction<Conjunction> for Fewest {
    type Cost = u64;

    fn cost<C: FnMut(Id) -> u64>(&mut self, node: &Conjunction, mut costs: C) -> u64 {
        match node {
            Conjunction::Never => 0,
            Conjunction::Literal(number) => (1 << 32) + u64::from(*number),
            Conjunction::All(_) => node.fold(1, |sum, part| sum.saturating_add(costs(part))),
        }
    }
}
