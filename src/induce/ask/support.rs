//! What the examples say about a clause: the literals that are true in all examples that only the clause explains.
//!
//! A clause of the rules to be learned that explains these examples is a subset of these literals. The learned clause
//! is exact if all of them follow from it.

use crate::induce::ask::hypothesis::Hypothesis;
use crate::induce::ask::space::Space;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::{Examples, State, majority};
use crate::induce::vocabulary::{Assignment, Tuple, Vocabulary, tuples};

/// The examples that only one clause explains.
#[derive(Clone, Debug, Default)]
pub struct Support {
    /// The facts about the variables that hold in all of them, and those that hold in none. Numbered like facts about
    /// one entity for each variable.
    literals: Option<(Bits, Bits)>,
    /// Whether one of them has no entities but those of the variables.
    pub is_alone: bool,
    /// The example with the fewest facts, and the entities of the variables there.
    pub smallest: Option<(State, Assignment)>,
}

impl Support {
    /// Returns the facts of the support that do not follow from a clause: those that hold in all examples, and those
    /// that hold in none. `positive` and `negative` are the facts of the clause.
    pub fn gap(&self, space: &Space, positive: &Bits, negative: &Bits) -> (Bits, Bits) {
        let Some((all, none)) = &self.literals else {
            let empty = bits::empty(space.facts.len());
            return (empty.clone(), empty);
        };
        let (mut all, mut none) = (all.clone(), none.clone());
        let (mut true_, mut false_) = (positive.clone(), negative.clone());
        consequences(space, &mut true_, &mut false_);
        bits::subtract(&mut all, &true_);
        bits::subtract(&mut none, &false_);
        (all, none)
    }

    /// Returns the facts that hold in all examples, and those that hold in none.
    pub fn literals(&self) -> Option<&(Bits, Bits)> {
        self.literals.as_ref()
    }
}

/// Adds to sets of true and of false facts what follows from them.
pub fn consequences(space: &Space, true_: &mut Bits, false_: &mut Bits) {
    loop {
        let before = bits::count(true_) + bits::count(false_);
        for fact in 0..space.facts.len() {
            if bits::contains(true_, fact) {
                let (implied, excluded) = (&space.implied[fact], &space.excluded[fact]);
                true_.iter_mut().zip(implied).for_each(|(word, more)| *word |= more);
                false_.iter_mut().zip(excluded).for_each(|(word, more)| *word |= more);
            } else if bits::contains(false_, fact) {
                let implying = &space.implying[fact];
                false_.iter_mut().zip(implying).for_each(|(word, more)| *word |= more);
            } else if bits::contains(&space.excluded[fact], fact) {
                bits::insert(false_, fact);
            }
        }
        for cover in &space.covers {
            let mut left = bits::elements(cover).filter(|&fact| !bits::contains(false_, fact));
            if let (Some(only), None) = (left.next(), left.next()) {
                bits::insert(true_, only);
            }
        }
        if bits::count(true_) + bits::count(false_) == before {
            return;
        }
    }
}

/// Returns the supports of all clauses.
pub fn of_all(hypothesis: &Hypothesis, examples: &Examples) -> Vec<Support> {
    let mut supports = vec![Support::default(); hypothesis.clauses.len()];
    for (state, tallies) in examples.states() {
        add(
            &mut supports,
            hypothesis,
            examples.vocabulary(),
            state,
            majority(tallies),
        );
    }
    supports
}

/// Adds an example to the support of the clause that explains it, if only one does.
pub fn add(supports: &mut [Support], hypothesis: &Hypothesis, vocabulary: &Vocabulary, state: &State, action: usize) {
    let mut only: Option<(usize, Vec<Assignment>)> = None;
    for (index, clause) in hypothesis.clauses.iter().enumerate() {
        if clause.action != action {
            continue;
        }
        let witnesses = hypothesis.witnesses(clause, state, WITNESSES_MAX);
        if !witnesses.is_empty() {
            if only.is_some() {
                return;
            }
            only = Some((index, witnesses));
        }
    }
    let Some((index, witnesses)) = only else { return };
    let entities = |witness: &Assignment| {
        let mut entities = witness.clone();
        entities.sort_unstable();
        entities
    };
    // Several witnesses leave open which of them matters, unless they are one up to the names of the variables.
    let first = entities(&witnesses[0]);
    if witnesses.len() == WITNESSES_MAX || witnesses.iter().any(|witness| entities(witness) != first) {
        return;
    }
    let variables = hypothesis.clauses[index].variables;
    let rows = witnesses
        .into_iter()
        .map(|witness| (row(vocabulary, variables, state, &witness), witness));
    let support = &mut supports[index];
    let merged = rows.map(|((all, none), witness)| match &support.literals {
        None => (all, none, witness),
        Some((old_all, old_none)) => (
            all.iter().zip(old_all).map(|(one, other)| one & other).collect(),
            none.iter().zip(old_none).map(|(one, other)| one & other).collect(),
            witness,
        ),
    });
    let Some((all, none, witness)) = merged.max_by_key(|(all, none, _)| bits::count(all) + bits::count(none)) else {
        return;
    };
    support.literals = Some((all, none));
    support.is_alone |= first
        .iter()
        .enumerate()
        .all(|(at, entity)| !first[..at].contains(entity))
        && state.entities() == variables;
    let is_smaller = |(old, _): &(State, Assignment)| {
        (state.entities(), state.facts().count()) < (old.entities(), old.facts().count())
    };
    if support.smallest.as_ref().is_none_or(is_smaller) {
        support.smallest = Some((state.clone(), witness));
    }
}

/// Witnesses of a clause in one state after which it counts as ambiguous.
const WITNESSES_MAX: usize = 7;

/// Returns the facts about the variables that hold in a state, and those that do not.
fn row(vocabulary: &Vocabulary, variables: usize, state: &State, witness: &[u8]) -> (Bits, Bits) {
    let empty = bits::empty(vocabulary.facts(variables));
    let (mut all, mut none) = (empty.clone(), empty);
    for (predicate, known) in vocabulary.predicates().iter().enumerate() {
        for tuple in tuples(known.arity, variables) {
            if (1..tuple.len()).any(|at| tuple[..at].contains(&tuple[at])) {
                continue;
            }
            let arguments: Tuple = tuple.iter().map(|&variable| witness[variable].into()).collect();
            let fact = vocabulary.fact(variables, predicate, &tuple);
            let holds = state.holds(vocabulary, predicate, &arguments);
            bits::insert(if holds { &mut all } else { &mut none }, fact);
        }
    }
    (all, none)
}
