//! FOIL: a greedy learner of clauses with a beam, as a baseline.
//!
//! It learns an action at a time, and a clause at a time. A clause starts empty. Each step extends every clause of the
//! beam by every literal and keeps the clauses with the largest information gain (Quinlan 1990, over examples rather
//! than bindings). The clause without negative examples that covers the most positive ones is the result.

use logicity::induce::{Atom, Body, Examples, Literal, State, Tally};
use std::collections::BTreeSet;

/// The maximum number of literals of a clause.
const LITERALS_MAX: usize = 8;

/// Settings of FOIL.
#[derive(Clone, Copy)]
pub struct Foil {
    /// The clauses that each step keeps.
    pub width: usize,
    /// The variables of a clause, those of its head included.
    pub variables: usize,
}

/// The rows in which literals hold: bits over the pairs of a binding and a state, binding by binding.
struct Table {
    literals: Vec<Literal>,
    rows: Vec<Vec<u64>>,
    /// The rows whose entities exist.
    present: Vec<u64>,
    words: usize,
}

/// A clause of the beam.
#[derive(Clone)]
struct Candidate {
    literals: BTreeSet<usize>,
    rows: Vec<u64>,
    positive: u32,
    negative: u32,
    gain: f64,
}

impl Foil {
    /// Learns the clauses of each action but the last, those of the highest precedence first.
    pub fn learn(self, examples: &Examples) -> Vec<Vec<Body>> {
        let labeled: Vec<(&State, usize)> = examples
            .states()
            .map(|(state, tallies)| (state, majority(tallies)))
            .collect();
        (0..examples.actions().len() - 1)
            .map(|action| {
                let states: Vec<&State> = labeled
                    .iter()
                    .filter(|(_, label)| *label >= action)
                    .map(|(state, _)| *state)
                    .collect();
                let labels = labeled.iter().filter(|(_, label)| *label >= action);
                let mut open = vec![0_u64; states.len().div_ceil(64)];
                for (index, (_, label)) in labels.enumerate() {
                    open[index / 64] |= u64::from(*label == action) << (index % 64);
                }
                self.cover(examples, &states, open)
            })
            .collect()
    }

    /// Learns clauses until they cover all positive examples, or no clause covers only positive ones.
    fn cover(self, examples: &Examples, states: &[&State], mut open: Vec<u64>) -> Vec<Body> {
        let table = Table::new(examples, states, self.variables);
        let mut negative: Vec<u64> = open.iter().map(|word| !word).collect();
        if let Some(last) = negative.last_mut()
            && !states.len().is_multiple_of(64)
        {
            *last &= (1 << (states.len() % 64)) - 1;
        }
        let mut clauses = Vec::new();
        while open.iter().any(|word| *word != 0) {
            let Some(best) = self.clause(&table, &open, &negative) else {
                break;
            };
            for (open, covered) in open.iter_mut().zip(table.states(&best.rows)) {
                *open &= !covered;
            }
            let literals = best.literals.iter().map(|&literal| table.literals[literal].clone());
            clauses.push(Body::normalized(literals.collect(), examples.vocabulary()));
        }
        clauses
    }

    /// Returns the clause without negative examples that covers the most positive ones, of those that the search meets.
    fn clause(self, table: &Table, open: &[u64], negative: &[u64]) -> Option<Candidate> {
        let mut beam = vec![table.candidate(BTreeSet::new(), table.present.clone(), None, open, negative)];
        let mut best: Option<Candidate> = None;
        for _ in 0..LITERALS_MAX {
            let mut next: Vec<Candidate> = Vec::new();
            let mut seen: BTreeSet<BTreeSet<usize>> = BTreeSet::new();
            for parent in &beam {
                for literal in 0..table.literals.len() {
                    let mut literals = parent.literals.clone();
                    if !literals.insert(literal) || !seen.insert(literals.clone()) {
                        continue;
                    }
                    let rows = (parent.rows.iter())
                        .zip(&table.rows[literal])
                        .map(|(row, own)| row & own)
                        .collect();
                    let candidate = table.candidate(literals, rows, Some(parent), open, negative);
                    let most = best.as_ref().map_or(0, |best| best.positive);
                    if candidate.positive <= most || candidate.negative == parent.negative {
                        continue;
                    }
                    match candidate.negative {
                        0 => best = Some(candidate),
                        _ => next.push(candidate),
                    }
                }
                keep(&mut next, self.width);
            }
            beam = next;
        }
        best
    }
}

/// Keeps the candidates with the largest gain.
fn keep(candidates: &mut Vec<Candidate>, width: usize) {
    candidates.sort_by(|a, b| b.gain.total_cmp(&a.gain).then(a.literals.cmp(&b.literals)));
    // Clauses that hold in the same rows are one.
    candidates.dedup_by(|a, b| a.gain == b.gain && a.rows == b.rows);
    candidates.truncate(width);
}

impl Table {
    fn new(examples: &Examples, states: &[&State], variables: usize) -> Table {
        let vocabulary = examples.vocabulary();
        let entities = states.iter().map(|state| state.entities()).max().unwrap_or(1);
        let free = variables - vocabulary.egos();
        let words = states.len().div_ceil(64);
        let bindings: Vec<Vec<usize>> = (0..entities.pow(free as u32))
            .map(|mut number| {
                let mut binding: Vec<usize> = (0..vocabulary.egos()).collect();
                for _ in 0..free {
                    binding.push(number % entities);
                    number /= entities;
                }
                binding
            })
            .collect();
        let fill = |holds: &dyn Fn(&State, &[usize]) -> bool| -> Vec<u64> {
            let mut rows = vec![0_u64; bindings.len() * words];
            for (binding, row) in bindings.iter().zip(rows.chunks_exact_mut(words.max(1))) {
                for (index, state) in states.iter().enumerate() {
                    row[index / 64] |= u64::from(holds(state, binding)) << (index % 64);
                }
            }
            rows
        };
        let present = fill(&|state, binding| binding.iter().all(|&entity| entity < state.entities()));
        let (mut literals, mut rows) = (Vec::new(), Vec::new());
        for atom in vocabulary.atoms(variables) {
            let arguments = |atom: &Atom, binding: &[usize]| -> Vec<usize> {
                atom.arguments
                    .iter()
                    .map(|&variable| binding[usize::from(variable)])
                    .collect()
            };
            let own = fill(&|state, binding| state.holds(vocabulary, atom.predicate, &arguments(&atom, binding)));
            for is_negated in [false, true] {
                let literal = Literal {
                    is_negated,
                    atom: atom.clone(),
                };
                literals.push(literal);
                rows.push(match is_negated {
                    true => own.iter().map(|word| !word).collect(),
                    false => own.clone(),
                });
            }
        }
        Table {
            literals,
            rows,
            present,
            words,
        }
    }

    /// The states that occur in rows.
    fn states(&self, rows: &[u64]) -> Vec<u64> {
        let mut states = vec![0; self.words];
        for row in rows.chunks_exact(self.words.max(1)) {
            states.iter_mut().zip(row).for_each(|(state, word)| *state |= word);
        }
        states
    }

    fn candidate(
        &self,
        literals: BTreeSet<usize>,
        rows: Vec<u64>,
        parent: Option<&Candidate>,
        open: &[u64],
        negative: &[u64],
    ) -> Candidate {
        let states = self.states(&rows);
        let count = |set: &[u64]| -> u32 {
            states
                .iter()
                .zip(set)
                .map(|(state, word)| (state & word).count_ones())
                .sum()
        };
        let (positive, negative) = (count(open), count(negative));
        let information = |positive: u32, negative: u32| (f64::from(positive) / f64::from(positive + negative)).log2();
        let gain = match parent {
            Some(parent) if positive > 0 => {
                f64::from(positive) * (information(positive, negative) - information(parent.positive, parent.negative))
                    + parent.gain * f64::from(positive) / f64::from(parent.positive)
            }
            _ => 0.0,
        };
        Candidate {
            literals,
            rows,
            positive,
            negative,
            gain,
        }
    }
}

/// The most frequent action, of several the one with the highest precedence.
fn majority(tallies: &[Tally]) -> usize {
    let most = tallies.iter().map(|tally| tally.count).max().unwrap_or(0);
    tallies.iter().position(|tally| tally.count == most).unwrap_or(0)
}
