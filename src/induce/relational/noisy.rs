//! Clauses when some examples may be wrong: a beam search for the least description length.
//!
//! A clause may hold in some negative examples and leave some positive ones. The description of the examples is the
//! clauses and the exceptions. Each clause grows literal by literal, so that it holds in a given positive example. The
//! search keeps the most informative clauses of each length, and remembers the one that shortens the description most.

use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::relational::database::Database;
use crate::induce::relational::search::{covered_by, holds};
use crate::induce::rules::{ActionRules, LearnedClause, Progress, Settings};
use crate::induce::vocabulary::{Body, LITERAL_COST, Literal, VARIABLES_MAX};
use crate::rng::{self, Purpose, Seed};
use rayon::prelude::*;
use smallvec::SmallVec;
use std::collections::BTreeSet;

/// The most clauses of each length that are extended.
const WIDTH: usize = 16;

/// The maximum number of literals of a clause.
const LITERALS_MAX: usize = 6;

/// The positive and the negative examples on which the search counts.
const SAMPLE: usize = 256;

/// The learner of a target with wrong examples.
pub struct NoisyLearner<'a> {
    pub database: &'a Database,
    pub positive: &'a [Vec<u32>],
    pub negative: &'a [Vec<u32>],
    pub settings: &'a Settings,
    /// The description length of an exception, in the unit of costs.
    pub exception: i64,
    pub cancel: &'a Cancel,
}

/// A clause with the examples that it covers.
#[derive(Clone)]
struct Clause {
    body: Body,
    cost: i64,
    positive: Vec<u64>,
    negative: Vec<u64>,
}

/// A clause of the beam, with the examples of the sample that it covers.
struct Node {
    body: Vec<Literal>,
    kinds: SmallVec<[u32; VARIABLES_MAX]>,
    positive: Vec<u32>,
    negative: Vec<u32>,
}

/// The examples on which a search counts, with what one of each label stands for.
struct Sample {
    positive: Vec<u32>,
    negative: Vec<u32>,
    weights: [f64; 2],
}

impl NoisyLearner<'_> {
    /// Learns clauses that shorten the description.
    pub fn learn(&self, progress: &(dyn Fn(Progress) + Sync)) -> ActionRules {
        let mut random = Seed(self.settings.seed).stream(Purpose::INDUCE, 0, 3);
        let mut clauses: Vec<Clause> = Vec::new();
        let mut hopeful = bits::full(self.positive.len());
        while !self.cancel.requested() {
            let left: Vec<usize> = bits::elements(&hopeful).collect();
            if left.is_empty() {
                break;
            }
            progress(Progress {
                action: 0,
                states: self.positive.len(),
                covered: self.positive.len() - left.len(),
                clauses: clauses.len(),
            });
            let tries = rng::draw(&left, self.settings.seeds_per_round, &mut random);
            let sample = self.sample(&clauses);
            let found = tries.iter().filter_map(|&case| self.clause(case, &sample));
            let gain = |clause: &Clause| self.gain(clause, &clauses);
            let best = found
                .map(|clause| (gain(&clause), clause))
                .filter(|(gain, _)| *gain > 0);
            match best.reduce(|best, other| if other.0 > best.0 { other } else { best }) {
                Some((_, clause)) => {
                    bits::subtract(&mut hopeful, &clause.positive);
                    clauses.push(clause);
                    self.prune(&mut clauses);
                }
                None => tries.iter().for_each(|&case| bits::remove(&mut hopeful, case)),
            }
        }
        clauses.sort_by_key(|clause| std::cmp::Reverse(bits::count(&clause.positive)));
        let mut uncovered = bits::full(self.positive.len());
        clauses
            .iter()
            .for_each(|clause| bits::subtract(&mut uncovered, &clause.positive));
        let clauses = clauses.into_iter().map(|clause| LearnedClause {
            body: clause.body,
            is_best: false,
        });
        ActionRules {
            clauses: clauses.collect(),
            is_cheapest: false,
            variables_limit: None,
            uncovered: bits::count(&uncovered) as usize,
        }
    }

    /// Returns evenly spread examples that no clause covers.
    fn sample(&self, clauses: &[Clause]) -> Sample {
        let open = |all: usize, covered: &dyn Fn(&Clause) -> Vec<u64>| -> (Vec<u32>, f64) {
            let mut open = bits::full(all);
            clauses
                .iter()
                .for_each(|clause| bits::subtract(&mut open, &covered(clause)));
            let open: Vec<u32> = bits::elements(&open).map(|case| case as u32).collect();
            let sample: Vec<u32> = open
                .iter()
                .copied()
                .step_by(open.len().div_ceil(SAMPLE).max(1))
                .collect();
            let weight = open.len() as f64 / sample.len().max(1) as f64;
            (sample, weight)
        };
        let (positive, one) = open(self.positive.len(), &|clause| clause.positive.clone());
        let (negative, other) = open(self.negative.len(), &|clause| clause.negative.clone());
        Sample {
            positive,
            negative,
            weights: [one, other],
        }
    }

    /// Returns how much shorter the description becomes if a clause joins others.
    fn gain<'b>(&self, clause: &Clause, others: impl IntoIterator<Item = &'b Clause>) -> i64 {
        let (mut positive, mut negative) = (clause.positive.clone(), clause.negative.clone());
        for other in others {
            bits::subtract(&mut positive, &other.positive);
            bits::subtract(&mut negative, &other.negative);
        }
        self.exception * (i64::from(bits::count(&positive)) - i64::from(bits::count(&negative))) - clause.cost
    }

    /// Drops clauses that do not shorten the description, the least useful one first.
    fn prune(&self, clauses: &mut Vec<Clause>) {
        loop {
            let others = |index: usize| {
                clauses
                    .iter()
                    .enumerate()
                    .filter(move |(at, _)| *at != index)
                    .map(|(_, other)| other)
            };
            let gains = (0..clauses.len()).map(|index| (self.gain(&clauses[index], others(index)), index));
            match gains.min() {
                Some((gain, index)) if gain <= 0 => drop(clauses.remove(index)),
                _ => return,
            }
        }
    }

    /// Finds the clause that holds in a positive example and shortens the description of a sample most.
    fn clause(&self, seed: usize, sample: &Sample) -> Option<Clause> {
        let (database, head) = (self.database, &self.positive[seed]);
        let vocabulary = database.vocabulary();
        let score = |[positive, negative]: [usize; 2], cost: i64| {
            let counted = [positive as f64 * sample.weights[0], negative as f64 * sample.weights[1]];
            (self.exception as f64 * (counted[0] - counted[1])) as i64 - cost
        };
        let share = |[positive, negative]: [usize; 2]| (positive as f64 + 0.5) / ((positive + negative) as f64 + 1.0);
        let prior = share([sample.positive.len(), sample.negative.len()]);
        let mut nodes = vec![Node {
            body: Vec::new(),
            kinds: database.kinds_of(head),
            positive: sample.positive.clone(),
            negative: sample.negative.clone(),
        }];
        let (mut best, mut best_score) = (None, 0);
        for _ in 0..LITERALS_MAX {
            let mut seen: BTreeSet<Body> = BTreeSet::new();
            let mut extensions: Vec<(usize, Body)> = Vec::new();
            for (parent, node) in nodes.iter().enumerate() {
                for literal in database.extensions(&node.kinds, self.settings.variables, self.settings.negation) {
                    if !node.body.iter().any(|own| own.atom == literal.atom) {
                        let body = Body::normalized(node.body.iter().chain([&literal]).cloned().collect(), vocabulary);
                        if seen.insert(body.clone()) {
                            extensions.push((parent, body));
                        }
                    }
                }
            }
            if self.cancel.requested() {
                break;
            }
            let extend = |(parent, body): (usize, Body)| {
                let node = &nodes[parent];
                if !holds(database, &body, head, self.cancel) {
                    return None;
                }
                let among = |cases: &[u32], heads: &[Vec<u32>]| -> Vec<u32> {
                    let covers = |case: &u32| holds(database, &body, &heads[*case as usize], self.cancel);
                    cases.iter().copied().filter(covers).collect()
                };
                let cost = i64::from(body.cost(vocabulary) + LITERAL_COST);
                let positive = among(&node.positive, self.positive);
                if score([positive.len(), 0], cost) <= best_score {
                    return None;
                }
                let negative = among(&node.negative, self.negative);
                let counts = [positive.len(), negative.len()];
                let is_longer = database.kinds_in(head, &body).len() > node.kinds.len();
                if !is_longer && counts == [node.positive.len(), node.negative.len()] {
                    return None;
                }
                let value = counts[0] as f64 * (share(counts) / prior).log2();
                let kinds = database.kinds_in(head, &body);
                let extended = Node {
                    body: body.0,
                    kinds,
                    positive,
                    negative,
                };
                Some((value, score(counts, cost), extended))
            };
            let mut found: Vec<(f64, i64, Node)> = extensions.into_par_iter().filter_map(extend).collect();
            for (_, score, node) in &found {
                let body = Body(node.body.clone());
                if *score > best_score && body.is_safe(vocabulary) {
                    (best, best_score) = (Some(body), *score);
                }
            }
            found.sort_by(|one, other| other.0.total_cmp(&one.0).then_with(|| one.2.body.cmp(&other.2.body)));
            found.truncate(WIDTH);
            nodes = found.into_iter().map(|(.., node)| node).collect();
            if nodes.is_empty() {
                break;
            }
        }
        let body: Body = best?;
        Some(Clause {
            cost: i64::from(body.cost(vocabulary) + LITERAL_COST),
            positive: covered_by(database, &body, self.positive, self.cancel),
            negative: covered_by(database, &body, self.negative, self.cancel),
            body,
        })
    }
}
