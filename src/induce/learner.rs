//! Learns rules from examples: for each action in the order of precedence, clauses that cover its examples and no
//! example of an action of lower precedence.

use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::cover::cheapest_cover;
use crate::induce::examples::{Examples, State, majority};
use crate::induce::noise;
use crate::induce::problem::{LabeledColumns, Problem};
use crate::induce::rules::{ActionRules, LearnedClause, LearnedRules, Noise, Progress, Settings};
use crate::induce::search::{ExampleSearch, FoundClause};
use crate::induce::vocabulary::{Body, LITERAL_COST, VARIABLES_MAX, Vocabulary};
use crate::rng::{self, Purpose, Seed};
use crate::threads;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

impl Purpose {
    /// The order in which the learner tries uncovered examples; the index is the position of the action.
    pub const INDUCE: Purpose = Purpose::new(40);
}

/// Learns clauses for all actions except the default one. Each state counts once, with its most frequent action.
///
/// If there are more states than [`Settings::working_states`], the learner begins with a sample. It adds states that
/// the learned rules get wrong and learns again, until the rules are right in all states that any clauses can separate.
///
/// # Panics
/// If a setting is out of its range.
pub fn learn(examples: &Examples, settings: &Settings, cancel: &Cancel) -> LearnedRules {
    learn_with(examples, settings, &|_| (), cancel)
}

/// Variant of [`learn`] that reports its progress.
///
/// # Panics
/// If a setting is out of its range.
pub fn learn_with(
    examples: &Examples,
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> LearnedRules {
    let range = examples.vocabulary().egos()..=VARIABLES_MAX;
    assert!(range.contains(&settings.variables), "variables not in {range:?}");
    assert!(
        settings.seeds_per_round > 0 && settings.working_states > 0,
        "no tries or states"
    );
    in_pool(settings.threads, cancel, |cancel| {
        learn_here(examples, settings, progress, cancel)
    })
}

/// Works on a pool of threads, `None` for one per core.
pub(crate) fn in_pool<T: Send>(
    threads: Option<NonZeroUsize>,
    cancel: &Cancel,
    work: impl FnOnce(&Cancel) -> T + Send,
) -> T {
    let Ok(pool) = threads::start(threads.map_or(0, NonZeroUsize::get)) else {
        // If no threads can be created, the learner uses those of the caller.
        return work(cancel);
    };
    // `cancel` may have an effect on this thread only, so this one polls it, and the threads of the pool poll a flag.
    let requested = Arc::new(AtomicBool::new(cancel.requested()));
    let flag = Arc::clone(&requested);
    let forwarded = Cancel::when(move || flag.load(Ordering::Relaxed));
    let (done, finished) = mpsc::channel();
    thread::scope(|scope| {
        let work = || pool.install(|| work(&forwarded));
        scope.spawn(move || done.send(catch_unwind(AssertUnwindSafe(work))));
        let learned = loop {
            match finished.recv_timeout(POLL_INTERVAL) {
                Err(RecvTimeoutError::Timeout) => requested.store(cancel.requested(), Ordering::Relaxed),
                received => break received.expect("the thread sends a result"),
            }
        };
        learned.unwrap_or_else(|panic| resume_unwind(panic))
    })
}

/// The interval in which [`in_pool`] polls for cancellation.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Learns on the threads of the caller.
pub(crate) fn learn_here(
    examples: &Examples,
    settings: &Settings,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &Cancel,
) -> LearnedRules {
    if settings.noise != Noise::None
        && let Some(learned) = noise::learn_noisy(examples, settings, progress, cancel)
    {
        return learned;
    }
    let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
    let labels: Vec<usize> = examples.states().map(|(_, tallies)| majority(tallies)).collect();
    let mut works: Vec<bool> = sample(&labels, examples.actions().len(), settings.working_states);
    loop {
        let working: Vec<usize> = (0..states.len()).filter(|&state| works[state]).collect();
        let actions: Vec<ActionRules> = (0..examples.actions().len() - 1)
            .map(|action| {
                let of = |keep: &dyn Fn(usize) -> bool| -> Vec<&State> {
                    let kept = working.iter().filter(|&&state| keep(labels[state]));
                    kept.map(|&state| states[state]).collect()
                };
                let (positive, negative) = (of(&|label| label == action), of(&|label| label > action));
                learn_action(
                    examples.vocabulary(),
                    action,
                    &positive,
                    &negative,
                    settings,
                    (progress, cancel),
                )
            })
            .collect();
        let learned = LearnedRules {
            actions,
            is_complete: !cancel.requested(),
            working_states: working.len(),
            rate: 0.0,
        };
        if working.len() == states.len() || !learned.is_complete {
            return learned;
        }
        let decided = learned.decide(examples.vocabulary(), &states);
        let wrong: Vec<usize> = (0..states.len())
            .filter(|&state| !works[state] && decided[state] != labels[state])
            .collect();
        if wrong.is_empty() {
            return learned;
        }
        let of_wrong: Vec<usize> = wrong.iter().map(|&state| labels[state]).collect();
        let added = sample(&of_wrong, examples.actions().len(), settings.working_states.div_ceil(4));
        for (state, _) in wrong.iter().zip(added).filter(|(_, is_added)| *is_added) {
            works[*state] = true;
        }
    }
}

/// Samples about `most` states, balanced over actions and evenly spaced. Keeps every state of a rare action.
fn sample(labels: &[usize], actions: usize, most: usize) -> Vec<bool> {
    let mut counts = vec![0; actions];
    labels.iter().for_each(|&label| counts[label] += 1);
    let mut ascending = counts.clone();
    ascending.sort_unstable();
    let (mut left, mut share) = (most, most);
    for (index, count) in ascending.iter().enumerate() {
        share = left / (actions - index);
        left -= (*count).min(share);
    }
    let mut before = vec![0; actions];
    labels
        .iter()
        .map(|&label| {
            let (rank, count) = (before[label], counts[label]);
            before[label] += 1;
            // The states whose share of the sample grows by one.
            count <= share || (rank + 1) * share / count > rank * share / count
        })
        .collect()
}

/// Learns the clauses of one action: finds clauses until they cover the positive states, then chooses the cheapest
/// cover.
fn learn_action(
    vocabulary: &Vocabulary,
    action: usize,
    positive: &[&State],
    negative: &[&State],
    settings: &Settings,
    (progress, cancel): (&(dyn Fn(Progress) + Sync), &Cancel),
) -> ActionRules {
    let columns = LabeledColumns::new(vocabulary, positive, negative);
    let mut search = ClauseSearch {
        vocabulary,
        settings,
        columns: &columns,
        problems: Vec::new(),
        variables_max: settings.variables,
        pool: BTreeMap::new(),
        cancel,
    };
    let mut random = Seed(settings.seed).stream(Purpose::INDUCE, action as u64, 0);
    let mut open = bits::full(positive.len());
    while !cancel.requested() {
        let left: Vec<usize> = bits::elements(&open).collect();
        if left.is_empty() {
            break;
        }
        progress(Progress {
            action,
            states: positive.len(),
            covered: positive.len() - left.len(),
            clauses: search.pool.len(),
        });
        let tries = rng::draw(&left, settings.seeds_per_round, &mut random);
        let uncovered: Vec<&State> = left.iter().map(|&state| positive[state]).collect();
        match search.best(&tries, &uncovered, &open) {
            Some(best) => bits::subtract(&mut open, &best.covered),
            // No clause separates these examples from the negative ones.
            None => tries.iter().for_each(|&state| bits::remove(&mut open, state)),
        }
    }
    let variables_limit = Some(search.variables_max).filter(|limit| *limit < settings.variables);
    let pool: Vec<FoundClause> = search.pool.into_values().collect();
    ActionRules {
        variables_limit,
        ..cheapest_rules(vocabulary, &pool, positive.len(), cancel)
    }
}

/// The search for the clauses of one action.
struct ClauseSearch<'a> {
    vocabulary: &'a Vocabulary,
    settings: &'a Settings,
    columns: &'a LabeledColumns,
    /// The problems by number of variables, made when a search needs them.
    problems: Vec<Problem<'a>>,
    /// The maximum number of variables of a clause. The memory may allow fewer than the settings.
    variables_max: usize,
    /// All clauses found.
    pool: BTreeMap<Body, FoundClause>,
    cancel: &'a Cancel,
}

impl ClauseSearch<'_> {
    /// Finds the best clause for one of some positive states, and adds each clause found to the pool. `uncovered` are
    /// the states in `open`. Another variable is tried only while the best clause covers few of them.
    fn best(&mut self, tries: &[usize], uncovered: &[&State], open: &[u64]) -> Option<FoundClause> {
        let cancel = self.cancel;
        let uncovered = self.columns.columns(self.vocabulary, uncovered);
        let fewest = (self.vocabulary.egos() + 1).min(self.settings.variables);
        let mut best: Option<FoundClause> = None;
        for variables in fewest..=self.variables_max {
            if self.problems.len() <= variables - fewest {
                // There are too many assignments for more variables.
                let Some(problem) = self
                    .columns
                    .problem(self.vocabulary, variables, self.settings.negation, cancel)
                else {
                    self.variables_max = variables - 1;
                    break;
                };
                self.problems.push(problem);
            }
            let problem = &self.problems[variables - fewest];
            let counted = problem.open(&uncovered);
            let search = |seed| ExampleSearch::new(problem, seed, &counted, cancel).best(self.settings.nodes);
            let found: Vec<FoundClause> = problem.all_seeds(tries).par_iter().filter_map(search).collect();
            for found in found {
                if best.as_ref().is_none_or(|best| found.score > best.score) {
                    best = Some(found.clone());
                }
                self.pool.insert(found.body.clone(), found);
            }
            if best
                .as_ref()
                .is_some_and(|best| bits::intersection_len(&best.covered, open) >= self.settings.coverage_min)
            {
                break;
            }
        }
        best
    }
}

/// Returns the cheapest clauses of a pool that cover the positive states, the one that covers the most first.
pub(crate) fn cheapest_rules(
    vocabulary: &Vocabulary,
    pool: &[FoundClause],
    positive: usize,
    cancel: &Cancel,
) -> ActionRules {
    let columns: Vec<(Vec<u64>, u32)> = pool
        .iter()
        .map(|found| (found.covered.clone(), found.body.cost(vocabulary) + LITERAL_COST))
        .collect();
    let cover = cheapest_cover(&columns, cancel);
    let mut chosen: Vec<&FoundClause> = cover.columns.iter().map(|&column| &pool[column]).collect();
    chosen.sort_by_key(|found| std::cmp::Reverse(bits::count(&found.covered)));
    let mut uncovered = bits::full(positive);
    chosen
        .iter()
        .for_each(|found| bits::subtract(&mut uncovered, &found.covered));
    let clauses = chosen.iter().map(|found| LearnedClause {
        body: found.body.clone(),
        is_best: found.is_best,
    });
    ActionRules {
        clauses: clauses.collect(),
        is_cheapest: cover.is_cheapest,
        variables_limit: None,
        uncovered: bits::count(&uncovered) as usize,
    }
}
