//! A clause of least description length for a given example: a beam search.
//!
//! With noise, a clause may hold in a few negative examples. So there is no set of rows that it must exclude, and a
//! best-first search has no tight bound. The beam search extends clauses literal by literal, keeps the most informative
//! ones of each length, and remembers the one whose description is shortest: that of the clause, minus that of the
//! exceptions which it makes superfluous, plus that of the exceptions which it causes.

use crate::cancel::Cancel;
use crate::induce::bits::{self, Bits};
use crate::induce::problem::{Columns, Problem, Rows};
use crate::induce::vocabulary::{Body, LITERAL_COST, Literal};
use crate::induce::weights::Weights;
use std::collections::BTreeSet;
use std::rc::Rc;

/// The most clauses of each length that are extended. `cargo bench --bench induce_noise -- noise` measures it, as well
/// as [`DOUBT`] and the constants of the module `noise`.
const WIDTH: usize = 24;
/// The maximum number of literals of a clause. A clause for wrong actions alone would otherwise become as long as its
/// examples allow.
const LITERALS_MAX: usize = 10;

/// The description lengths of examples and literals.
pub struct Scoring<'a> {
    /// The weights of the positive states.
    pub positive: &'a Weights,
    /// The weights of the negative states.
    pub negative: &'a Weights,
    /// The description length of an exception, in the unit of the costs of literals, times [`SCALE`].
    pub exception: i64,
    /// The share of examples that have a wrong action.
    pub rate: f64,
}

impl Scoring<'_> {
    /// Returns how much shorter the description becomes by a clause that holds in some positive and negative states.
    /// `open` are the states that no other clause covers. The negative states beyond those that noise explains count
    /// [`DOUBT`] times.
    pub fn score(&self, states: &[Vec<u64>; 2], open: &[Vec<u64>; 2], cost: u32) -> i64 {
        let gain = self.positive.sum_common(&states[0], &open[0]);
        let loss = self.negative.sum_common(&states[1], &open[1]);
        self.exception * (gain - loss - DOUBT * self.doubtful(states)) - SCALE * i64::from(cost)
    }

    /// Returns the number of negative examples of a clause beyond those that noise explains.
    fn doubtful(&self, states: &[Vec<u64>; 2]) -> i64 {
        let negative = self.negative.sum(&states[1]);
        let expected = (self.positive.sum(&states[0]) + negative) as f64 * self.rate;
        (negative - (expected + 2.0 * expected.sqrt()).ceil() as i64).max(0)
    }
}

/// The weight of a negative example beyond those that noise explains, in exceptions.
const DOUBT: i64 = 10;

/// The factor of the costs of literals in scores.
pub const SCALE: i64 = 2;

/// A clause and what it changes.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The body.
    pub body: Body,
    /// The cost of the clause.
    cost: u32,
    /// The positive and the negative states in which it holds.
    pub states: [Vec<u64>; 2],
}

impl Candidate {
    /// Returns the candidate of a body.
    pub fn new(problem: &Problem<'_>, body: Body) -> Candidate {
        let states = |columns: &Columns| problem.satisfying(columns, &body).states(columns.words);
        Candidate {
            cost: body.cost(problem.vocabulary) + LITERAL_COST,
            states: [states(problem.positive), states(problem.negative)],
            body,
        }
    }

    /// Returns how much shorter the description becomes if the clause joins others that leave these states.
    pub fn score(&self, scoring: &Scoring<'_>, open: &[Vec<u64>; 2]) -> i64 {
        scoring.score(&self.states, open, self.cost)
    }
}

struct BeamNode {
    chosen: Bits,
    positive: Rc<Rows>,
    negative: Rc<Rows>,
    /// Number of negative rows: pairs of an assignment and a state.
    negative_rows: u64,
}

struct Extension {
    /// The information gain of FOIL (Quinlan 1990), with half a positive and half a negative example added.
    value: f64,
    parent: usize,
    literal: usize,
    chosen: Bits,
}

/// Finds a clause that holds in the example and shortens the description most. `open` are the positive and the negative
/// states that no other clause covers. `None` if no clause of the beam shortens it.
pub fn beam(
    problem: &Problem<'_>,
    seed: &Bits,
    scoring: &Scoring<'_>,
    open: &[Vec<u64>; 2],
    cancel: &Cancel,
) -> Option<(i64, Candidate)> {
    let root = BeamNode {
        chosen: bits::empty(problem.atoms.len()),
        positive: Rc::new(problem.all(problem.positive)),
        negative: Rc::new(problem.all(problem.negative)),
        negative_rows: u64::MAX,
    };
    let prior = {
        let all = [scoring.positive.sum(&open[0]), scoring.negative.sum(&open[1])].map(|sum| sum as f64);
        all[0] / (all[0] + all[1])
    };
    let (mut best, mut best_score) = (None, 0);
    let mut nodes = vec![root];
    let mut states = [vec![0; problem.positive.words], vec![0; problem.negative.words]];
    for _ in 0..LITERALS_MAX {
        let mut extensions: Vec<Extension> = Vec::new();
        let mut seen: BTreeSet<Bits> = BTreeSet::new();
        for (parent, node) in nodes.iter().enumerate() {
            for literal in (0..problem.atoms.len()).filter(|&literal| !bits::contains(&node.chosen, literal)) {
                let is_true = bits::contains(seed, literal);
                if !is_true && !problem.negation {
                    continue;
                }
                let atom = &problem.atoms[literal];
                let mut chosen = node.chosen.clone();
                bits::insert(&mut chosen, literal);
                if !seen.insert(chosen.clone()) {
                    continue;
                }
                let cost = problem.cost(&chosen, seed) + LITERAL_COST;
                problem.states_with(problem.positive, &node.positive, atom, is_true, &mut states[0]);
                let gain = scoring.positive.sum_common(&states[0], &open[0]);
                if scoring.exception * gain - SCALE * i64::from(cost) <= best_score {
                    continue;
                }
                let rows = problem.states_with(problem.negative, &node.negative, atom, is_true, &mut states[1]);
                if rows == node.negative_rows {
                    continue;
                }
                let loss = scoring.negative.sum_common(&states[1], &open[1]);
                let score = scoring.score(&states, open, cost);
                if score > best_score && problem.binds_all(&chosen, seed) {
                    (best, best_score) = (Some(chosen.clone()), score);
                }
                let (gain, loss) = (gain as f64, loss as f64);
                extensions.push(Extension {
                    value: gain * ((gain + 0.5) / (gain + loss + 1.0) / prior).log2(),
                    parent,
                    literal,
                    chosen,
                });
            }
        }
        extensions.sort_by(|one, other| {
            other
                .value
                .total_cmp(&one.value)
                .then_with(|| one.chosen.cmp(&other.chosen))
        });
        extensions.truncate(WIDTH);
        nodes = (extensions.into_iter())
            .map(|extension| {
                let (parent, atom) = (&nodes[extension.parent], &problem.atoms[extension.literal]);
                let is_true = bits::contains(seed, extension.literal);
                let negative = problem.restrict(problem.negative, &parent.negative, atom, is_true);
                BeamNode {
                    positive: Rc::new(problem.restrict(problem.positive, &parent.positive, atom, is_true)),
                    negative_rows: negative.count(),
                    negative: Rc::new(negative),
                    chosen: extension.chosen,
                }
            })
            .collect();
        if nodes.is_empty() || cancel.requested() {
            break;
        }
    }
    let literals = bits::elements(&best?)
        .map(|literal| Literal {
            is_negated: !bits::contains(seed, literal),
            atom: problem.atoms[literal].clone(),
        })
        .collect();
    let body = Body::normalized(literals, problem.vocabulary);
    Some((best_score, Candidate::new(problem, body)))
}
