//! Settings of a learner, learned rules, and their evaluation.

use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::examples::State;
use crate::induce::problem::{LabeledColumns, Problem};
use crate::induce::vocabulary::{Body, Vocabulary};
use std::num::NonZeroUsize;
use std::ops::Range;

/// Settings of a search.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The maximum number of variables of a clause, those in its head included: at most
    /// [`VARIABLES_MAX`](crate::induce::VARIABLES_MAX).
    pub variables: usize,
    /// The seed of the order in which examples are tried.
    pub seed: u64,
    /// Number of threads, `None` for one per core. The rules do not depend on it.
    pub threads: Option<NonZeroUsize>,
    /// Uncovered examples that are tried before a clause is chosen, at least 1.
    pub seeds_per_round: usize,
    /// A further variable is tried if the best clause newly covers fewer examples than this.
    pub coverage_min: u32,
    /// The maximum number of nodes of one search.
    pub nodes: u32,
    /// The number of distinct states from which clauses are learned at first, at least 1. All other states confirm or
    /// refute them.
    pub working_states: usize,
    /// Whether clauses may contain negative literals.
    pub negation: bool,
    /// Whether some examples may have a wrong action.
    pub noise: Noise,
}

/// The share of examples that have a wrong action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// None: the rules must be right in every example that any clauses can separate.
    None,
    /// A known share, from 0 to [`NOISE_MAX`](crate::induce::NOISE_MAX). A higher one counts as that.
    Rate(f64),
    /// A share that cross-validation estimates.
    Auto,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            variables: 3,
            seed: 0,
            threads: None,
            seeds_per_round: 3,
            coverage_min: 16,
            nodes: 20_000,
            working_states: 20_000,
            negation: true,
            noise: Noise::None,
        }
    }
}

/// Learned rules.
#[derive(Clone, Debug, Default)]
pub struct LearnedRules {
    /// The rules of each action but the default one, the one with the highest precedence first.
    pub actions: Vec<ActionRules>,
    /// Whether the learner finished. After cancellation, examples may be left without a clause.
    pub is_complete: bool,
    /// Number of distinct states from which the clauses were learned. The others confirm them.
    pub working_states: usize,
    /// The share of wrong actions that the learner assumed: 0 if it took all examples as right.
    pub rate: f64,
}

/// The clauses of one action.
#[derive(Clone, Debug)]
pub struct ActionRules {
    /// The bodies of the clauses, the one that covers the most states first.
    pub clauses: Vec<LearnedClause>,
    /// Whether no cheaper set of the clauses found covers the examples.
    pub is_cheapest: bool,
    /// The variables of a clause that the memory allows, if these are fewer than in the settings: clauses with
    /// more have too many assignments of entities.
    pub variables_limit: Option<usize>,
    /// Positive states that no clause covers: none separates them from the negative ones, or noise explains them.
    pub uncovered: usize,
}

/// A clause of learned rules.
#[derive(Clone, Debug)]
pub struct LearnedClause {
    /// The body.
    pub body: Body,
    /// Whether the search for the clause was complete: no clause for its example has a higher score.
    pub is_best: bool,
}

/// The state of the learner, for progress reports.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// The position of the action.
    pub action: usize,
    /// Number of its states.
    pub states: usize,
    /// Number of them that a clause covers.
    pub covered: usize,
    /// Number of distinct clauses found.
    pub clauses: usize,
}

impl LearnedRules {
    /// Returns the position of the action that the rules choose in each of some states.
    pub fn decide(&self, vocabulary: &Vocabulary, states: &[&State]) -> Vec<usize> {
        let mut chosen = vec![self.actions.len(); states.len()];
        for (range, holds) in clauses_hold(vocabulary, &self.bodies(), states) {
            for (action, clauses) in self.actions.iter().enumerate().rev() {
                let first: usize = self.actions[..action].iter().map(|rules| rules.clauses.len()).sum();
                for holds in &holds[first..first + clauses.clauses.len()] {
                    bits::elements(holds).for_each(|state| chosen[range.start + state] = action);
                }
            }
        }
        chosen
    }

    /// Returns the bodies of all clauses, action by action.
    pub fn bodies(&self) -> Vec<&Body> {
        let clauses = self.actions.iter().flat_map(|rules| &rules.clauses);
        clauses.map(|clause| &clause.body).collect()
    }
}

/// Returns, for chunks of states, their positions and the states in which each body holds.
pub(crate) fn clauses_hold<'a>(
    vocabulary: &'a Vocabulary,
    bodies: &'a [&'a Body],
    states: &'a [&'a State],
) -> impl Iterator<Item = (Range<usize>, Vec<Vec<u64>>)> + 'a {
    (0..states.len()).step_by(CHUNK).map(move |begin| {
        let range = begin..states.len().min(begin + CHUNK);
        let chunk = &states[range.clone()];
        let (columns, never) = (LabeledColumns::new(vocabulary, chunk, &[]), Cancel::never());
        // The problem of the last number of variables. Two at once would need too much memory.
        let mut last: Option<(usize, Option<Problem<'_>>)> = None;
        let holds = bodies.iter().map(|body| {
            let variables = body.variables(vocabulary);
            if last.as_ref().is_none_or(|(count, _)| *count != variables) {
                last = None;
                last = Some((variables, columns.problem(vocabulary, variables, true, &never)));
            }
            match last.as_ref().and_then(|(_, problem)| problem.as_ref()) {
                Some(problem) => problem
                    .satisfying(problem.positive, body)
                    .states(problem.positive.words),
                // Too many assignments for sets of bits.
                None => {
                    let mut holds = vec![0; chunk.len().div_ceil(64)];
                    let held = (0..chunk.len()).filter(|&state| body.holds(vocabulary, chunk[state]));
                    held.for_each(|state| bits::insert(&mut holds, state));
                    holds
                }
            }
        });
        (range, holds.collect())
    })
}

/// Number of states that are evaluated together.
const CHUNK: usize = 1 << 14;
