//! Learns the clauses of a target from facts about constants.
//!
//! The learner of demonstrations, [`crate::induce::learn`], has a state of a few entities for each example, and a bit
//! for each possible fact. Here all examples share one [`Database`], so they can refer to any number of constants, and
//! predicates can have more arguments. The search is the same otherwise: clauses for a few uncovered examples until all
//! are covered, then a cover of least cost. A round takes clauses with one more variable as long as the best clause
//! leaves most of the open examples.

mod bottom;
mod database;
mod noisy;
mod search;
#[cfg(test)]
mod tests;

use crate::cancel::Cancel;
use crate::induce::beam::SCALE;
use crate::induce::bits;
use crate::induce::learner::{cheapest_rules, in_pool};
use crate::induce::noise::exception;
use crate::induce::relational::bottom::{Bottom, Choice, Choices};
use crate::induce::relational::noisy::NoisyLearner;
use crate::induce::relational::search::{BottomSearch, Cases, Found, covered_by, weight};
use crate::induce::rules::{ActionRules, Noise, Progress, Settings};
use crate::induce::search::FoundClause;
use crate::induce::vocabulary::{Atom, Body, LITERAL_COST, Literal, VARIABLE_COST};
use crate::rng::{self, Purpose, Seed};
pub use database::Database;
use rayon::prelude::*;
use smallvec::SmallVec;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// The searches between two updates of the best score and of the hard examples. The result does not depend on the
/// number of threads.
const CHUNK: usize = 32;

/// The open examples on which searches count.
const OPEN_MAX: usize = 128;

/// The negative examples with which a search begins, and how many of them are spread over all.
const HARD: (usize, usize) = (32, 8);

/// Learns clauses that hold in the positive examples and in no negative one. With noise, they may be wrong in some. An
/// example is the list of the constants of the head.
pub fn learn_relational(
    database: &Database,
    positive: &[Vec<u32>],
    negative: &[Vec<u32>],
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> ActionRules {
    let exception = match settings.noise {
        Noise::None | Noise::Rate(0.0) => None,
        // As in the description length of MaxSynth, an exception is as long as a literal.
        Noise::Auto => Some(LITERAL_COST.into()),
        Noise::Rate(rate) => Some(exception(rate, 2) / SCALE),
    };
    in_pool(settings.threads, cancel, |cancel| {
        if let Some(exception) = exception {
            let learner = NoisyLearner {
                database,
                positive,
                negative,
                settings,
                exception,
                cancel,
            };
            return learner.learn(progress);
        }
        let learner = Learner {
            database,
            positive,
            negative,
            settings,
            pool: BTreeMap::new(),
            refutations: BTreeMap::new(),
            atoms: BTreeMap::new(),
            cancel,
        };
        learner.learn(progress)
    })
}

/// Returns whether a body holds in each of some examples.
pub fn derived(database: &Database, body: &Body, heads: &[Vec<u32>]) -> Vec<bool> {
    let covered = covered_by(database, body, heads, &Cancel::never());
    (0..heads.len()).map(|case| bits::contains(&covered, case)).collect()
}

/// Returns the literals over the variables of a body that can join it: with each of them, it still holds in all of the
/// examples. There are none without an example. With `negation`, negated literals are part of them.
pub fn undecided(database: &Database, body: &Body, heads: &[Vec<u32>], negation: bool) -> Vec<Literal> {
    let Some(first) = heads.first() else {
        return Vec::new();
    };
    let kinds = database.kinds_in(first, body);
    let atoms = database.atoms(&kinds).into_iter();
    let atoms = atoms.filter(|atom| !body.0.iter().any(|own| own.atom == *atom));
    let signs = atoms.flat_map(|atom| {
        let signs = [false, true].into_iter().take(if negation { 2 } else { 1 });
        signs.map(move |is_negated| Literal {
            is_negated,
            atom: atom.clone(),
        })
    });
    let fits = |literal: &Literal| {
        let longer = Body(body.0.iter().chain([literal]).cloned().collect());
        let never = Cancel::never();
        heads.iter().all(|head| search::holds(database, &longer, head, &never))
    };
    signs.filter(fits).collect()
}

struct Learner<'a> {
    database: &'a Database,
    positive: &'a [Vec<u32>],
    negative: &'a [Vec<u32>],
    settings: &'a Settings,
    /// All clauses found.
    pool: BTreeMap<Body, FoundClause>,
    /// How often negative examples refuted a clause.
    refutations: BTreeMap<u32, u32>,
    /// The atoms over variables of some kinds.
    atoms: BTreeMap<SmallVec<[u32; 7]>, Vec<Atom>>,
    cancel: &'a Cancel,
}

impl Learner<'_> {
    fn learn(mut self, progress: &(dyn Fn(Progress) + Sync)) -> ActionRules {
        let mut random = Seed(self.settings.seed).stream(Purpose::INDUCE, 0, 2);
        let mut open = bits::full(self.positive.len());
        while !self.cancel.requested() {
            let left: Vec<u32> = bits::elements(&open).map(|case| case as u32).collect();
            if left.is_empty() {
                break;
            }
            progress(Progress {
                action: 0,
                states: self.positive.len(),
                covered: self.positive.len() - left.len(),
                clauses: self.pool.len(),
            });
            let tries = rng::draw(&left, self.settings.seeds_per_round, &mut random);
            let found = self
                .best(&tries, &left, false)
                .or_else(|| self.best(&tries, &left, true));
            match found {
                Some(best) => bits::subtract(&mut open, &best.covered),
                // No clause separates these examples from the negative ones.
                None => tries.iter().for_each(|&case| bits::remove(&mut open, case as usize)),
            }
        }
        let pool: Vec<FoundClause> = self.pool.into_values().collect();
        cheapest_rules(self.database.vocabulary(), &pool, self.positive.len(), self.cancel)
    }

    /// Finds the best clause for one of some examples, and adds each clause found to the pool. `left` are the uncovered
    /// ones.
    fn best(&mut self, tries: &[u32], left: &[u32], repeats: bool) -> Option<FoundClause> {
        let (database, positive) = (self.database, self.positive);
        let egos = database.vocabulary().egos();
        let most = self.settings.variables - egos;
        let step = left.len().div_ceil(OPEN_MAX);
        let open: Vec<u32> = left.iter().copied().step_by(step).collect();
        let weight = weight(left.len(), open.len());
        let mut choices: Vec<Choices<'_>> = (tries.iter())
            .map(|&case| Choices::new(database, &positive[case as usize], most, repeats))
            .collect();
        let mut best: Option<FoundClause> = None;
        for size in 0..=most {
            let least_cost = LITERAL_COST + (size as u32).saturating_sub(1) * VARIABLE_COST;
            let least = |best: &Option<FoundClause>| best.as_ref().map_or(i64::MIN, |best| best.score);
            if weight * open.len() as i64 - i64::from(least_cost) <= least(&best) || self.cancel.requested() {
                break;
            }
            let mut seen: BTreeSet<(Vec<Atom>, bits::Bits)> = BTreeSet::new();
            let mut is_complete = true;
            let mut jobs: Vec<(u32, Choice)> = Vec::new();
            for (&case, choices) in tries.iter().zip(&mut choices) {
                jobs.extend(choices.of_size(size).iter().map(|choice| (case, choice.clone())));
                is_complete &= choices.is_complete;
            }
            for chunk in jobs.chunks(CHUNK) {
                if self.cancel.requested() {
                    break;
                }
                let bottoms: Vec<Bottom> = (chunk.iter())
                    .map(|(case, choice)| self.bottom(*case, choice))
                    .filter(|bottom| seen.insert((bottom.atoms.clone(), bottom.seed.clone())))
                    .collect();
                let hard = self.hard();
                let cases = Cases {
                    positive,
                    negative: self.negative,
                    open: &open,
                    weight,
                    hard: &hard,
                };
                let (bound, cancel, nodes) = (least(&best), self.cancel, self.settings.nodes);
                let search = |bottom: &Bottom| BottomSearch::new(database, bottom, &cases, bound, cancel).best(nodes);
                let found: Vec<Option<Found>> = bottoms.par_iter().map(search).collect();
                for Found { mut clause, refuting } in found.into_iter().flatten() {
                    refuting
                        .into_iter()
                        .for_each(|case| *self.refutations.entry(case).or_default() += 1);
                    clause.is_best &= is_complete;
                    if best.as_ref().is_none_or(|best| clause.score > best.score) {
                        best = Some(clause.clone());
                    }
                    self.pool.insert(clause.body.clone(), clause);
                }
            }
            let covered = best.as_ref().map_or(0, |best| {
                left.iter()
                    .filter(|&&case| bits::contains(&best.covered, case as usize))
                    .count()
            });
            if 2 * covered >= left.len() {
                break;
            }
        }
        best
    }

    /// Returns the literals that hold for a choice of a positive example.
    fn bottom(&mut self, case: u32, choice: &Choice) -> Bottom {
        let head = &self.positive[case as usize];
        let constants: Choice = head.iter().chain(choice).copied().collect();
        let kinds = self.database.kinds_of(&constants);
        let database = self.database;
        let atoms = (self.atoms.entry(kinds)).or_insert_with_key(|kinds| database.atoms(kinds));
        Bottom::new(database, atoms, head, choice, self.settings.negation)
    }

    /// Returns the negative examples with which a search begins.
    fn hard(&self) -> Vec<u32> {
        let mut counted: Vec<(Reverse<u32>, u32)> = self
            .refutations
            .iter()
            .map(|(&case, &count)| (Reverse(count), case))
            .collect();
        counted.sort_unstable();
        let (most, spread) = HARD;
        let mut hard: Vec<u32> = counted.into_iter().map(|(_, case)| case).take(most - spread).collect();
        let step = self.negative.len().div_ceil(most - hard.len()).max(1);
        for case in (0..self.negative.len() as u32).step_by(step) {
            if !hard.contains(&case) {
                hard.push(case);
            }
        }
        hard
    }
}
