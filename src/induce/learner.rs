//! Learns rules from examples: for each action in the order of precedence, clauses that cover its examples and no example
//! of an action of lower precedence.

use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::cover::cheapest_cover;
use crate::induce::examples::{Examples, State, majority};
use crate::induce::problem::{Problem, Split};
use crate::induce::search::{Found, Search};
use crate::induce::vocabulary::{Body, POSITIVE_COST};
use crate::rng::{Purpose, RngExt, Seed};
use rayon::prelude::*;
use std::collections::BTreeMap;

impl Purpose {
    /// The order in which the learner tries uncovered examples; the index is the position of the action.
    pub const INDUCE: Purpose = Purpose::new(40);
}

/// Settings of a search.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The most variables of a clause, those in its head included.
    pub variables: usize,
    /// The seed of the order in which examples are tried.
    pub seed: u64,
    /// Uncovered examples that are tried before a clause is chosen.
    pub tries: usize,
    /// A further variable is tried if the best clause newly covers fewer examples than this.
    pub enough: u32,
    /// Nodes of one search.
    pub nodes: u32,
    /// Whether clauses may contain negative literals.
    pub negation: bool,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            variables: 3,
            seed: 0,
            tries: 3,
            enough: 10,
            nodes: 20_000,
            negation: true,
        }
    }
}

/// The clauses of one action.
#[derive(Clone, Debug)]
pub struct ActionRules {
    /// The position of the action.
    pub action: usize,
    /// The clauses, the one that covers the most states first.
    pub clauses: Vec<LearnedClause>,
    /// Whether no cheaper set of the clauses found covers the examples.
    pub is_cheapest: bool,
    /// Positive states that no clause covers, since none separates them from the negative ones.
    pub uncovered: usize,
}

/// A clause with its support.
#[derive(Clone, Debug)]
pub struct LearnedClause {
    /// The body.
    pub body: Body,
    /// Number of positive states that it covers.
    pub covers: u32,
    /// Number of positive states that no other clause of the action covers.
    pub alone: u32,
    /// Whether the search for the clause was complete.
    pub is_best: bool,
}

/// Learns clauses for all actions except the default one.
pub fn learn(examples: &Examples, settings: &Settings, cancel: &Cancel) -> Vec<ActionRules> {
    let states: Vec<(&State, usize)> = examples
        .states()
        .map(|(state, tallies)| (state, majority(tallies)))
        .collect();
    (0..examples.actions().len() - 1)
        .map(|action| {
            let of = |keep: &dyn Fn(usize) -> bool| -> Vec<&State> {
                states
                    .iter()
                    .filter(|(_, label)| keep(*label))
                    .map(|(state, _)| *state)
                    .collect()
            };
            let (positive, negative) = (of(&|label| label == action), of(&|label| label > action));
            learn_action(examples, action, &positive, &negative, settings, cancel)
        })
        .collect()
}

fn learn_action(
    examples: &Examples,
    action: usize,
    positive: &[&State],
    negative: &[&State],
    settings: &Settings,
    cancel: &Cancel,
) -> ActionRules {
    let vocabulary = examples.vocabulary();
    let split = Split::new(vocabulary, positive, negative);
    let fewest = (vocabulary.egos() + 1).min(settings.variables);
    let mut problems: Vec<Problem<'_>> = Vec::new();
    let mut random = Seed(settings.seed).stream(Purpose::INDUCE, action as u64, 0);
    let mut pool: BTreeMap<Body, Found> = BTreeMap::new();
    let mut open = bits::empty(positive.len());
    (0..positive.len()).for_each(|state| bits::insert(&mut open, state));
    let mut uncovered = 0;
    while !cancel.requested() {
        let left: Vec<usize> = bits::elements(&open).collect();
        if left.is_empty() {
            break;
        }
        let tries: Vec<usize> = (0..settings.tries)
            .map(|_| left[random.random_range(0..left.len())])
            .collect();
        let mut best: Option<Found> = None;
        for variables in fewest..=settings.variables {
            if problems.len() <= variables - fewest {
                // There are too many assignments for more variables.
                let Some(problem) = split.problem(vocabulary, variables, settings.negation) else {
                    break;
                };
                problems.push(problem);
            }
            let problem = &problems[variables - fewest];
            let mut seeds: Vec<_> = tries.iter().flat_map(|&state| problem.seeds(state)).collect();
            seeds.sort_unstable();
            seeds.dedup();
            let search = |seed| Search::new(problem, seed, &open).best(settings.nodes, cancel);
            let found: Vec<Found> = seeds.par_iter().filter_map(search).collect();
            for found in found {
                if best.as_ref().is_none_or(|best| found.score > best.score) {
                    best = Some(found.clone());
                }
                pool.insert(found.body.clone(), found);
            }
            if best
                .as_ref()
                .is_some_and(|best| bits::common(&best.covered, &open) >= settings.enough)
            {
                break;
            }
        }
        match best {
            Some(best) => open
                .iter_mut()
                .zip(&best.covered)
                .for_each(|(open, covered)| *open &= !covered),
            // No clause separates these examples from the negative ones.
            None => {
                for state in tries {
                    uncovered += usize::from(bits::has(&open, state));
                    bits::remove(&mut open, state);
                }
            }
        }
    }
    let pool: Vec<Found> = pool.into_values().collect();
    let columns: Vec<(Vec<u64>, u32)> = pool
        .iter()
        .map(|found| (found.covered.clone(), found.body.cost() + POSITIVE_COST))
        .collect();
    let cover = cheapest_cover(&columns);
    let chosen: Vec<&Found> = cover.columns.iter().map(|&column| &pool[column]).collect();
    let mut times = vec![0_u32; positive.len()];
    for found in &chosen {
        bits::elements(&found.covered).for_each(|state| times[state] += 1);
    }
    let clauses = chosen.iter().map(|found| LearnedClause {
        body: found.body.clone(),
        covers: bits::count(&found.covered),
        alone: bits::elements(&found.covered)
            .filter(|&state| times[state] == 1)
            .count() as u32,
        is_best: found.is_best,
    });
    let mut clauses: Vec<LearnedClause> = clauses.collect();
    clauses.sort_by(|a, b| b.covers.cmp(&a.covers).then(a.body.cmp(&b.body)));
    ActionRules {
        action,
        clauses,
        is_cheapest: cover.is_cheapest,
        uncovered,
    }
}
