//! What the examples say about learned clauses: how many they explain, and which literals the examples cannot decide.

mod entailment;
#[cfg(test)]
mod tests;

use crate::cancel::Cancel;
use crate::induce::bits;
use crate::induce::constraints::{Constraints, Violation};
use crate::induce::examples::{Examples, State, majority};
use crate::induce::problem::{LabeledColumns, Problem};
use crate::induce::rules::{LearnedRules, clauses_hold};
use crate::induce::vocabulary::{ARITY_MAX, Atom, Body, Literal, Vocabulary};
use entailment::Entailment;
use std::collections::BTreeMap;

/// The maximum number of states of lower precedence that [`support`] compares alternatives with.
const NEGATIVE_MAX: usize = 100_000;

/// What the examples say about learned rules.
#[derive(Clone, Debug)]
pub struct Support {
    /// The clauses in the order of [`LearnedRules::bodies`].
    pub clauses: Vec<ClauseSupport>,
    /// Number of distinct states.
    pub states: usize,
    /// Number of examples.
    pub examples: u64,
    /// Number of examples whose action is not the one that the rules choose.
    pub wrong: u64,
    /// The numbers of the first of these examples, at most 10.
    pub wrong_first: Vec<u64>,
    /// By action, the number of examples.
    pub by_action: Vec<u64>,
    /// The pairs of actions whose clauses hold in the same examples.
    pub conflicts: Vec<Conflict>,
    /// Number of distinct states with examples of several actions.
    pub contradictions: usize,
    /// Atoms over the variables of the head that hold in no example, and atoms of predicates that never hold at all.
    /// Atoms that imply another one of them by the constraints are left out.
    pub unseen: Vec<Atom>,
    /// The constraints that a state violates, with the number of the first example of such a state. No literal is left
    /// out because of them.
    pub broken: Vec<(Violation, u64)>,
}

impl Support {
    /// Returns the position of the only action that has examples. `None` if there are several, or no examples.
    pub fn only_action(&self) -> Option<usize> {
        let mut taken = (0..self.by_action.len()).filter(|&action| self.by_action[action] > 0);
        taken.next().filter(|_| taken.next().is_none())
    }
}

/// Examples in which clauses of two actions hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The positions of the action that the rules choose, and of the other one.
    pub actions: [usize; 2],
    /// Number of examples.
    pub examples: u64,
    /// The number of the first one.
    pub first: u64,
}

/// What the examples say about a clause.
#[derive(Clone, Debug, Default)]
pub struct ClauseSupport {
    /// The position of its action.
    pub action: usize,
    /// Number of examples of its action in which it holds.
    pub examples: u64,
    /// Number of distinct states of these examples.
    pub states: u64,
    /// Number of examples of its action in which no other clause of this action holds.
    pub alone: u64,
    /// Number of distinct states of these examples.
    pub alone_states: u64,
    /// Number of examples of an action with higher precedence in which it holds.
    pub outranked: u64,
    /// Number of examples of an action with lower precedence in which it holds.
    pub against: u64,
    /// The number of the first example that it alone explains.
    pub first: Option<u64>,
    /// Literals that also hold in every state that it alone explains: with such a literal the clause fits as well.
    /// Literals that follow from the clause or from another one of them by the constraints are left out.
    pub undecided: Vec<Literal>,
    /// Pairs of a literal of the clause and another one that fits as well in its place. Alternatives that have the same
    /// meaning by the constraints are left out.
    pub alternatives: Vec<(Literal, Literal)>,
}

/// Counts the examples that each clause explains, and finds the literals that neither the examples nor the constraints
/// decide. It does not search for these literals in the rules of an interrupted learner.
pub fn support(examples: &Examples, learned: &LearnedRules, constraints: &Constraints) -> Support {
    let vocabulary = examples.vocabulary();
    let states: Vec<&State> = examples.states().map(|(state, _)| state).collect();
    let (constraints, broken) = constraints.tested(vocabulary, states.iter().copied());
    let bodies = learned.bodies();
    let action_of: Vec<usize> = (learned.actions.iter().enumerate())
        .flat_map(|(action, rules)| rules.clauses.iter().map(move |_| action))
        .collect();
    let mut clauses: Vec<ClauseSupport> = (action_of.iter())
        .map(|&action| ClauseSupport {
            action,
            ..ClauseSupport::default()
        })
        .collect();
    let labels: Vec<usize> = examples.states().map(|(_, tallies)| majority(tallies)).collect();
    let mut alone: Vec<Vec<usize>> = vec![Vec::new(); bodies.len()];
    // For each clause, the states of an action with lower precedence in which it holds, in ascending order.
    let mut against: Vec<Vec<usize>> = vec![Vec::new(); bodies.len()];
    let mut conflicts: BTreeMap<[usize; 2], Conflict> = BTreeMap::new();
    let (mut wrong, mut wrong_first) = (0, Vec::new());
    for (range, holds) in clauses_hold(vocabulary, &bodies, &states) {
        for state in range.clone() {
            let (_, tallies) = examples.state(state).expect("a position below their number");
            let held: Vec<usize> = (0..bodies.len())
                .filter(|&clause| bits::contains(&holds[clause], state - range.start))
                .collect();
            let chosen = held.first().map_or(learned.actions.len(), |&clause| action_of[clause]);
            let count = tallies.iter().map(|tally| u64::from(tally.count)).sum::<u64>();
            let first = first_example(examples, state);
            let mut outranked: Vec<usize> = held.iter().map(|&clause| action_of[clause]).collect();
            outranked.dedup();
            for actions in outranked.iter().skip(1).map(|&other| [chosen, other]) {
                let known = conflicts.entry(actions).or_insert(Conflict {
                    actions,
                    examples: 0,
                    first,
                });
                known.examples += count;
                known.first = known.first.min(first);
            }
            let lower = held.iter().filter(|&&clause| majority(tallies) > action_of[clause]);
            lower.for_each(|&clause| against[clause].push(state));
            for (action, tally) in tallies.iter().enumerate().filter(|(_, tally)| tally.count > 0) {
                let count = u64::from(tally.count);
                if action != chosen {
                    wrong += count;
                    wrong_first.push(tally.first);
                }
                let of_action: Vec<usize> = held
                    .iter()
                    .copied()
                    .filter(|&clause| action_of[clause] == action)
                    .collect();
                for &clause in &held {
                    let clause_support = &mut clauses[clause];
                    match action_of[clause].cmp(&action) {
                        std::cmp::Ordering::Equal => {
                            clause_support.examples += count;
                            clause_support.states += 1;
                        }
                        std::cmp::Ordering::Greater => clause_support.outranked += count,
                        std::cmp::Ordering::Less => clause_support.against += count,
                    }
                }
                if let [only] = of_action[..] {
                    let clause = &mut clauses[only];
                    clause.alone += count;
                    clause.alone_states += 1;
                    clause.first = Some(clause.first.map_or(tally.first, |first| first.min(tally.first)));
                    alone[only].push(state);
                }
            }
        }
    }
    wrong_first.sort_unstable();
    wrong_first.truncate(10);
    for (index, (clause, body)) in clauses.iter_mut().zip(&bodies).enumerate() {
        let is_negative =
            |state: &usize| labels[*state] > clause.action && against[index].binary_search(state).is_err();
        let lower: Vec<usize> = (0..states.len()).filter(is_negative).collect();
        let step = lower.len().div_ceil(NEGATIVE_MAX).max(1);
        let lower: Vec<&State> = lower.into_iter().step_by(step).map(|state| states[state]).collect();
        let alone: Vec<&State> = alone[index].iter().map(|&state| states[state]).collect();
        if !alone.is_empty() && learned.is_complete {
            let entailment = Entailment::new(vocabulary, &constraints, body.variables(vocabulary));
            (clause.undecided, clause.alternatives) = undecided(vocabulary, &entailment, body, &alone, &lower);
        }
    }
    let by_action = (0..examples.actions().len())
        .map(|action| {
            examples
                .states()
                .map(|(_, tallies)| u64::from(tallies[action].count))
                .sum()
        })
        .collect();
    Support {
        clauses,
        states: states.len(),
        examples: examples.count(),
        wrong,
        wrong_first,
        by_action,
        conflicts: conflicts.into_values().collect(),
        contradictions: examples.contradictions().count(),
        unseen: unseen(vocabulary, &constraints, &states),
        broken: (broken.into_iter())
            .map(|(violation, state)| (violation, first_example(examples, state)))
            .collect(),
    }
}

/// Returns the number of the first example of a state.
fn first_example(examples: &Examples, state: usize) -> u64 {
    let (_, tallies) = examples.state(state).expect("a position below their number");
    let there = tallies.iter().filter(|tally| tally.count > 0);
    there.map(|tally| tally.first).min().unwrap_or(0)
}

/// Returns the atoms over the variables of the head that hold in no state, and one atom of each predicate that holds
/// for no entities at all; without those that imply another one of them.
fn unseen(vocabulary: &Vocabulary, constraints: &Constraints, states: &[&State]) -> Vec<Atom> {
    let egos = vocabulary.egos();
    let mut head: Vec<Atom> = vocabulary.atoms(egos);
    let mut anywhere: Vec<bool> = vec![false; vocabulary.predicates().len()];
    for state in states {
        head.retain(|atom| {
            let arguments: Vec<usize> = atom.arguments.iter().map(|&variable| variable.into()).collect();
            !state.holds(vocabulary, atom.predicate, &arguments)
        });
        for (predicate, any) in anywhere.iter_mut().enumerate().filter(|(_, any)| !**any) {
            let arity = vocabulary.predicates()[predicate].arity;
            let first = vocabulary.fact(state.entities(), predicate, &[0; ARITY_MAX][..arity]);
            let end = first + state.entities().pow(arity as u32);
            *any = state.facts().any(|fact| (first..end).contains(&fact));
        }
    }
    let never = |atom: &Atom| !anywhere[atom.predicate] && !head.iter().any(|known| known.predicate == atom.predicate);
    let mut others: Vec<Atom> = vocabulary.atoms(egos + 1).into_iter().filter(never).collect();
    others.dedup_by_key(|atom| atom.predicate);
    let never = head
        .into_iter()
        .chain(others)
        .map(|atom| Literal { is_negated: true, atom });
    let entailment = Entailment::new(vocabulary, constraints, egos + 1);
    let strongest = entailment.strongest(&[], never.collect());
    strongest.into_iter().map(|literal| literal.atom).collect()
}

/// Returns the literals that can be added to a clause, and those that can replace one of it, so that it still holds in
/// all `alone` states and in no `lower` one.
fn undecided(
    vocabulary: &Vocabulary,
    entailment: &Entailment<'_>,
    body: &Body,
    alone: &[&State],
    lower: &[&State],
) -> (Vec<Literal>, Vec<(Literal, Literal)>) {
    let columns = LabeledColumns::new(vocabulary, alone, lower);
    let never = Cancel::never();
    let Some(problem) = columns.problem(vocabulary, body.variables(vocabulary), true, &never) else {
        return (Vec::new(), Vec::new());
    };
    let others = || {
        let signs = problem
            .atoms
            .iter()
            .flat_map(|atom| [false, true].map(|is_negated| (atom, is_negated)));
        let literals = signs.map(|(atom, is_negated)| Literal {
            is_negated,
            atom: atom.clone(),
        });
        literals.filter(|literal| !body.0.iter().any(|own| own.atom == literal.atom))
    };
    let covers = |problem: &Problem<'_>, body: &Body| {
        let rows = problem.satisfying(problem.positive, body);
        bits::count(&rows.states(problem.positive.words)) as usize == alone.len()
    };
    let with = |without: Option<usize>, literal: &Literal| {
        let kept = body
            .0
            .iter()
            .enumerate()
            .filter(|(at, _)| Some(*at) != without)
            .map(|(_, own)| own.clone());
        Body(kept.chain([literal.clone()]).collect())
    };
    let added = others().filter(|literal| covers(&problem, &with(None, literal)));
    let added = entailment.strongest(&body.0, added.collect());
    let mut alternatives = Vec::new();
    for (at, own) in body.0.iter().enumerate() {
        for literal in others() {
            let other = with(Some(at), &literal);
            if covers(&problem, &other)
                && problem.satisfying(problem.negative, &other).is_empty()
                && other.is_safe(vocabulary)
                && !(entailment.implies(&body.0, &literal) && entailment.implies(&other.0, own))
            {
                alternatives.push((own.clone(), literal));
            }
        }
    }
    (added, alternatives)
}
