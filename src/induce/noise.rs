//! Learns rules from examples some of which have a wrong action.

use crate::cancel::Cancel;
use crate::induce::beam::{Candidate, SCALE, Scoring, beam};
use crate::induce::bits;
use crate::induce::examples::{Examples, State, Tally};
use crate::induce::problem::{LabeledColumns, Problem};
use crate::induce::rules::{ActionRules, LearnedClause, LearnedRules, Noise, Progress, Settings, clauses_hold};
use crate::induce::vocabulary::{Body, LITERAL_COST, Literal, Vocabulary};
use crate::induce::weights::Weights;
use crate::rng::{self, Purpose, RngExt, Seed};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The maximum number of rounds of adding and revising clauses. They end earlier when the description does not become
/// shorter.
const ROUNDS_MAX: usize = 5;

/// Bits of a description per unit of the cost of a literal. A literal with one variable takes 6 bits, enough to choose
/// one of 64 literals.
const BITS: f64 = 0.375;

/// Returns the description length of a wrong action, in the unit of costs times [`SCALE`].
pub(crate) fn exception(rate: f64, actions: usize) -> i64 {
    let rate = rate.clamp(f64::MIN_POSITIVE, NOISE_MAX);
    let bits = ((1.0 - rate) * (actions.max(2) - 1) as f64 / rate).log2();
    ((bits / BITS * SCALE as f64).round() as i64).max(1)
}

/// The rates that cross-validation compares.
const CANDIDATES: [f64; 3] = [0.001, 0.01, 0.05];
/// The parts of cross-validation.
const FOLDS: usize = 2;

/// The highest share of wrong actions: with more, the majority of similar examples says little.
pub const NOISE_MAX: f64 = 0.4;

/// Estimates the share of wrong actions: the share of examples that rules learned from other examples get wrong.
/// `None` if the learner finds rules that are right in all examples although it may leave exceptions.
fn estimate(
    examples: &Examples,
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> Option<f64> {
    let least = 0.5 / examples.count().max(1) as f64;
    if examples.contradictions().next().is_none() {
        let rules = learn_tolerant(examples, settings, least, progress, cancel);
        if wrong(&rules, examples) == 0 {
            return None;
        }
    }
    let mut random = Seed(settings.seed).stream(Purpose::INDUCE, u64::MAX, 0);
    let folds: Vec<usize> = examples.states().map(|_| random.random_range(0..FOLDS)).collect();
    let part = |keep: &dyn Fn(usize) -> bool| {
        let mut part = Examples::new(examples.vocabulary().clone(), examples.actions().to_vec());
        for ((state, tallies), _) in examples.states().zip(&folds).filter(|(_, fold)| keep(**fold)) {
            part.merge(state, tallies);
        }
        part
    };
    let parts: Vec<_> = (0..FOLDS)
        .map(|fold| (part(&|other| other != fold), part(&|other| other == fold)))
        .collect();
    let errors = |rate: f64| -> u64 {
        let error = |(train, test): &(Examples, Examples)| {
            wrong(&learn_tolerant(train, settings, rate, progress, cancel), test)
        };
        parts.iter().map(error).sum()
    };
    let errors: Vec<u64> = CANDIDATES.iter().map(|&rate| errors(rate)).collect();
    let fewest = errors.into_iter().min().unwrap_or(0);
    Some((fewest as f64 / examples.count() as f64).clamp(least, NOISE_MAX))
}

/// Learns rules that may be wrong in some examples, at the rate of the settings. `None` if the examples show no noise.
///
/// If there are more states than [`Settings::working_states`], the learner takes an evenly spread sample, and a larger
/// one while the rules get a larger share of all examples wrong than of the sample.
pub(crate) fn learn_noisy(
    examples: &Examples,
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> Option<LearnedRules> {
    let mut most = settings.working_states.max(1);
    loop {
        let sample = spread(examples, most);
        let sample = sample.as_ref().unwrap_or(examples);
        let rate = match settings.noise {
            Noise::None => None,
            Noise::Rate(rate) => (rate > 0.0).then_some(rate),
            Noise::Auto => estimate(sample, settings, progress, cancel),
        };
        let learned = learn_tolerant(sample, settings, rate?, progress, cancel);
        if learned.working_states == examples.states().len() || !learned.is_complete {
            return Some(learned);
        }
        let share = |of: &Examples| wrong(&learned, of) as f64 / of.count() as f64;
        let (all, expected) = (share(examples), share(sample).max(learned.rate));
        let chance = DEVIATIONS * (all / sample.count() as f64).sqrt();
        if all <= expected + chance.min(expected) {
            return Some(learned);
        }
        most = most.saturating_mul(2);
    }
}

/// How many standard deviations the share of wrong examples may exceed the expected one. It never exceeds its double.
const DEVIATIONS: f64 = 3.0;

/// Returns the examples of at most about `most` states. `None` if there are no more.
fn spread(examples: &Examples, most: usize) -> Option<Examples> {
    let step = examples.states().len().div_ceil(most);
    (step > 1).then(|| {
        let mut sample = Examples::new(examples.vocabulary().clone(), examples.actions().to_vec());
        for (state, tallies) in examples.states().step_by(step) {
            sample.merge(state, tallies);
        }
        sample
    })
}

/// Returns the number of examples in which rules choose another action.
fn wrong(rules: &LearnedRules, examples: &Examples) -> u64 {
    let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
    let decided = rules.decide(examples.vocabulary(), &states);
    let others = |((_, tallies), action): ((&State, &[Tally]), &usize)| -> u64 {
        let all: u64 = tallies.iter().map(|tally| u64::from(tally.count)).sum();
        all - u64::from(tallies[*action].count)
    };
    examples.states().zip(&decided).map(others).sum()
}

/// Learns rules that may be wrong in a share `rate` of the examples.
fn learn_tolerant(
    examples: &Examples,
    settings: &Settings,
    rate: f64,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> LearnedRules {
    let (vocabulary, actions) = (examples.vocabulary(), examples.actions().len());
    let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
    let mut decided = vec![false; states.len()];
    let mut learned = Vec::new();
    for action in 0..actions - 1 {
        // How many more examples have this action than the most frequent one of lower precedence.
        let excess: Vec<i64> = examples
            .states()
            .zip(&decided)
            .map(|((_, tallies), is_decided)| {
                let lower = tallies[action + 1..].iter().map(|tally| tally.count).max().unwrap_or(0);
                if *is_decided {
                    0
                } else {
                    i64::from(tallies[action].count) - i64::from(lower)
                }
            })
            .collect();
        let of = |sign: i64| -> (Vec<&State>, Vec<u32>) {
            let kept = states.iter().zip(&excess).filter(|(_, excess)| *excess * sign > 0);
            kept.map(|(state, excess)| (*state, excess.unsigned_abs() as u32))
                .unzip()
        };
        let ((positive, gains), (negative, losses)) = (of(1), of(-1));
        let columns = LabeledColumns::new(vocabulary, &positive, &negative);
        // This search keeps what it has on cancellation, so its rows must be complete.
        let never = Cancel::never();
        let search = TolerantSearch {
            vocabulary,
            action,
            settings,
            problems: (vocabulary.egos()..=settings.variables)
                .map_while(|variables| columns.problem(vocabulary, variables, settings.negation, &never))
                .collect(),
            scoring: Scoring {
                positive: &Weights::new(&gains),
                negative: &Weights::new(&losses),
                exception: exception(rate, actions),
                rate,
            },
            states: [positive.len(), negative.len()],
        };
        let clauses = search.learn(progress, cancel);
        let bodies: Vec<&Body> = clauses.iter().map(|clause| &clause.body).collect();
        for (range, holds) in clauses_hold(vocabulary, &bodies, &states) {
            for holds in holds {
                bits::elements(&holds).for_each(|state| decided[range.start + state] = true);
            }
        }
        let open = search.open(&clauses, None);
        learned.push(ActionRules {
            uncovered: bits::count(&open[0]) as usize,
            clauses: clauses
                .into_iter()
                .map(|clause| LearnedClause {
                    body: clause.body,
                    is_best: false,
                })
                .collect(),
            is_cheapest: false,
            variables_limit: Some(search.variables()).filter(|limit| *limit < settings.variables),
        });
    }
    LearnedRules {
        actions: learned,
        is_complete: !cancel.requested(),
        working_states: states.len(),
        rate,
    }
}

/// The search for the clauses of one action.
struct TolerantSearch<'a> {
    vocabulary: &'a Vocabulary,
    action: usize,
    settings: &'a Settings,
    /// The problems by number of variables, from that of the head on.
    problems: Vec<Problem<'a>>,
    scoring: Scoring<'a>,
    /// The numbers of positive and negative states.
    states: [usize; 2],
}

impl TolerantSearch<'_> {
    /// Returns the most variables of a clause for which there is a problem.
    fn variables(&self) -> usize {
        self.vocabulary.egos() + self.problems.len() - 1
    }

    fn problem(&self, variables: usize) -> &Problem<'_> {
        &self.problems[variables - self.vocabulary.egos()]
    }

    /// Returns the positive and the negative states that no clause except one covers.
    fn open(&self, clauses: &[Candidate], except: Option<usize>) -> [Vec<u64>; 2] {
        let mut open = self.states.map(|count| bits::full(count).into_vec());
        for clause in clauses
            .iter()
            .enumerate()
            .filter(|(index, _)| Some(*index) != except)
            .map(|(_, clause)| clause)
        {
            bits::subtract(&mut open[0], &clause.states[0]);
            bits::subtract(&mut open[1], &clause.states[1]);
        }
        open
    }

    fn learn(&self, progress: &(dyn Fn(Progress) + Sync), cancel: &Cancel) -> Vec<Candidate> {
        let (mut clauses, mut pool) = (Vec::new(), BTreeMap::new());
        let mut best = 0;
        for _ in 0..ROUNDS_MAX {
            self.cover(&mut clauses, &mut pool, progress, cancel);
            self.revise(&mut clauses, cancel);
            self.exchange(&mut clauses, &pool, cancel);
            self.revise(&mut clauses, cancel);
            let total = self.total(&clauses);
            if total <= best || cancel.requested() {
                break;
            }
            best = total;
        }
        clauses.sort_by_key(|clause| std::cmp::Reverse(bits::count(&clause.states[0])));
        clauses
    }

    /// Adds clauses of a pool, and drops those that they make superfluous, while that shortens the description.
    fn exchange(&self, clauses: &mut Vec<Candidate>, pool: &BTreeMap<Body, Candidate>, cancel: &Cancel) {
        let mut best = self.total(clauses);
        while !cancel.requested() {
            let other = |added: &Candidate| {
                let mut others = clauses.clone();
                others.push(added.clone());
                self.prune(&mut others);
                (self.total(&others), others)
            };
            let trials: Vec<_> = pool.par_iter().map(|(_, added)| other(added)).collect();
            let found = trials
                .into_iter()
                .reduce(|best, other| if other.0 > best.0 { other } else { best });
            match found {
                Some((total, others)) if total > best => (best, *clauses) = (total, others),
                _ => break,
            }
        }
    }

    /// Drops clauses that do not shorten the description, the least useful one first.
    fn prune(&self, clauses: &mut Vec<Candidate>) {
        loop {
            let scores = (0..clauses.len()).map(|index| {
                (
                    clauses[index].score(&self.scoring, &self.open(clauses, Some(index))),
                    index,
                )
            });
            match scores.min() {
                Some((score, index)) if score <= 0 => clauses.remove(index),
                _ => break,
            };
        }
    }

    /// Returns how much shorter the clauses make the description.
    fn total(&self, clauses: &[Candidate]) -> i64 {
        let mut open = self.open(&[], None);
        let mut total = 0;
        for clause in clauses {
            total += clause.score(&self.scoring, &open);
            bits::subtract(&mut open[0], &clause.states[0]);
            bits::subtract(&mut open[1], &clause.states[1]);
        }
        total
    }

    /// Adds the best clause for some uncovered examples while that shortens the description.
    fn cover(
        &self,
        clauses: &mut Vec<Candidate>,
        pool: &mut BTreeMap<Body, Candidate>,
        progress: &(dyn Fn(Progress) + Sync),
        cancel: &Cancel,
    ) {
        let mut random = Seed(self.settings.seed).stream(Purpose::INDUCE, self.action as u64, 1);
        let mut open = self.open(clauses, None);
        // The positive states that are worth a try.
        let mut hopeful = open[0].clone();
        let fewest = (self.vocabulary.egos() + 1).min(self.variables());
        while !cancel.requested() {
            let left: Vec<usize> = bits::elements(&hopeful).collect();
            if left.is_empty() {
                break;
            }
            progress(Progress {
                action: self.action,
                states: self.states[0],
                covered: self.states[0] - left.len(),
                clauses: clauses.len(),
            });
            let tries = rng::draw(&left, self.settings.seeds_per_round, &mut random);
            let mut best: Option<(i64, Candidate)> = None;
            for variables in fewest..=self.variables() {
                let problem = self.problem(variables);
                let found: Vec<_> = problem
                    .all_seeds(&tries)
                    .par_iter()
                    .filter_map(|seed| beam(problem, seed, &self.scoring, &open, cancel))
                    .collect();
                for found in found {
                    pool.insert(found.1.body.clone(), found.1.clone());
                    if best.as_ref().is_none_or(|best| found.0 > best.0) {
                        best = Some(found);
                    }
                }
                let enough = self.settings.coverage_min.into();
                if (best.as_ref())
                    .is_some_and(|(_, best)| self.scoring.positive.sum_common(&best.states[0], &open[0]) >= enough)
                {
                    break;
                }
            }
            match best {
                Some((_, best)) => {
                    bits::subtract(&mut open[0], &best.states[0]);
                    bits::subtract(&mut hopeful, &best.states[0]);
                    bits::subtract(&mut open[1], &best.states[1]);
                    clauses.push(best);
                }
                None => tries.iter().for_each(|&state| bits::remove(&mut hopeful, state)),
            }
        }
    }

    /// Drops, replaces and adds literals of each clause while that shortens the description, and drops clauses.
    fn revise(&self, clauses: &mut Vec<Candidate>, cancel: &Cancel) {
        let mut index = 0;
        while index < clauses.len() && !cancel.requested() {
            let open = self.open(clauses, Some(index));
            let score = clauses[index].score(&self.scoring, &open);
            match self.best_neighbor(&clauses[index], score.max(0), &open) {
                Some(better) => clauses[index] = better,
                None if score <= 0 => drop(clauses.remove(index)),
                None => index += 1,
            }
        }
    }

    /// Returns the best clause that differs in one literal, if it is better.
    fn best_neighbor(&self, clause: &Candidate, score: i64, open: &[Vec<u64>; 2]) -> Option<Candidate> {
        let variables = clause.body.variables(self.vocabulary);
        let fewest = (self.vocabulary.egos() + 1).min(self.variables());
        let problem = self.problem(variables.max(fewest));
        let literals = &clause.body.0;
        let best = (0..=literals.len())
            .into_par_iter()
            .filter_map(|dropped| {
                let mut kept = literals.clone();
                if dropped < literals.len() {
                    kept.remove(dropped);
                }
                let kept = Body(kept);
                let positive = problem.satisfying(problem.positive, &kept);
                let negative = problem.satisfying(problem.negative, &kept);
                let mut states = [vec![0; problem.positive.words], vec![0; problem.negative.words]];
                let mut best: Option<(i64, Vec<Literal>)> = None;
                let mut consider = |literals: Vec<Literal>, states: &[Vec<u64>; 2]| {
                    let body = Body(literals);
                    let own = self
                        .scoring
                        .score(states, open, body.cost(self.vocabulary) + LITERAL_COST);
                    if own > score && body.is_safe(self.vocabulary) && best.as_ref().is_none_or(|best| own > best.0) {
                        best = Some((own, body.0));
                    }
                };
                if dropped < literals.len() {
                    consider(
                        kept.0.clone(),
                        &[
                            positive.states(problem.positive.words),
                            negative.states(problem.negative.words),
                        ],
                    );
                }
                for atom in &problem.atoms {
                    for is_negated in [false, true].into_iter().filter(|negated| !negated || problem.negation) {
                        problem.states_with(problem.positive, &positive, atom, !is_negated, &mut states[0]);
                        problem.states_with(problem.negative, &negative, atom, !is_negated, &mut states[1]);
                        let mut literals = kept.0.clone();
                        literals.push(Literal {
                            is_negated,
                            atom: atom.clone(),
                        });
                        consider(literals, &states);
                    }
                }
                best
            })
            .collect::<Vec<_>>()
            .into_iter()
            .reduce(|best, other| if other.0 > best.0 { other } else { best });
        let body = Body::normalized(best?.1, self.vocabulary);
        Some(Candidate::new(problem, body))
    }
}
