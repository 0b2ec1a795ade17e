//! The integrity constraints that a proof of equality needs: an unsatisfiable core.

use crate::analysis::diff::bound;
use crate::analysis::diff::ground::Circuit;
use crate::analysis::diff::pair::{Pair, ScopeRows};
use crate::analysis::diff::sat::Outcome;
use crate::analysis::diff::{Options, Remaining, Scenes, last_size};
use crate::check::{DeclaredConstraint, Rules};
use crate::diag::Diagnostic;
use std::collections::{BTreeSet, HashMap};

/// Returns constraints of both sides from which it follows that the sides are equivalent, each with its rules. The
/// caller has found that [`super::diff`] proves them equivalent.
///
/// For the scenes of each size, a search with all constraints finds an unsatisfiable core, and further searches in the
/// same circuit remove what the others imply. Where a limit ends a search, more constraints than needed remain.
/// Constraints with equal text on the two sides count as one.
///
/// # Errors
/// As [`super::diff`].
pub fn unsat_core<'r>(
    left: &'r Rules,
    right: &'r Rules,
    options: &Options,
) -> Result<Vec<(&'r DeclaredConstraint, &'r Rules)>, Vec<Diagnostic>> {
    let pair = Pair::new(left, right, options)?;
    let mut listed = Vec::new();
    let mut numbers: HashMap<String, usize> = HashMap::new();
    let switches = [left, right].map(|rules| {
        let number = |one: &'r DeclaredConstraint| {
            *numbers.entry(one.constraint.show(rules)).or_insert_with(|| {
                listed.push((one, rules));
                listed.len() - 1
            })
        };
        rules.constraints.iter().map(number).collect::<Vec<usize>>()
    });
    let (proof, _) = bound::proof(&pair);
    let mut budget = Remaining::new(options);
    let mut core = BTreeSet::new();
    for (&view, views) in pair.views.iter().zip((1..=pair.views.len()).rev()) {
        let mut share = budget.take(views);
        // A core of the largest scenes mostly suffices for smaller ones.
        for entities in (0..=last_size(proof, options)).rev() {
            extend(&mut core, &pair, entities, view, (&switches, listed.len()), &mut share);
        }
        budget.give_back(&share);
    }
    Ok(core.into_iter().map(|number| listed[number]).collect())
}

/// Adds the constraints that a proof for scenes of one size needs besides those of `core`. `switches` has the number of
/// each constraint by side and position, and how many there are.
fn extend(
    core: &mut BTreeSet<usize>,
    pair: &Pair<'_>,
    entities: usize,
    view: ScopeRows,
    (switches, count): (&[Vec<usize>; 2], usize),
    budget: &mut Remaining,
) {
    let scenes = Scenes::new(pair, entities);
    let Ok((mut circuit, questions)) = scenes.circuit(&pair.outputs, view, Some(switches), budget) else {
        core.extend(0..count);
        return;
    };
    let any = circuit.any(questions.iter().map(|question| question.differs).collect());
    if circuit.is_no(any) {
        return;
    }
    circuit.solver.add(&[any]);
    let mut search = CoreSearch {
        circuit,
        core,
        conflicts: &mut budget.conflicts,
    };
    if search.failed(&BTreeSet::new()).is_some() {
        return;
    }
    let all: BTreeSet<usize> = (0..count).filter(|one| !search.core.contains(one)).collect();
    let mut least = search.minimal(&all).unwrap_or_else(|| all.clone());
    // A constraint with the same effect as two others makes a smaller core without one of these.
    for one in least.clone() {
        let mut others = all.clone();
        others.remove(&one);
        if let Some(other) = search.minimal(&others).filter(|other| other.len() < least.len()) {
            least = other;
        }
    }
    core.extend(least);
}

/// Searches for unsatisfiable cores in one circuit.
struct CoreSearch<'a> {
    circuit: Circuit<'a>,
    /// The constraints that hold in every search.
    core: &'a BTreeSet<usize>,
    conflicts: &'a mut u64,
}

impl CoreSearch<'_> {
    /// Returns those of the constraints on which a proof depends; `None` if there is no proof with them.
    fn failed(&mut self, constraints: &BTreeSet<usize>) -> Option<BTreeSet<usize>> {
        let all: BTreeSet<usize> = constraints.union(self.core).copied().collect();
        let outcome = self.circuit.solve_with(&all, self.conflicts);
        let failed = |one: &&usize| self.circuit.has_failed(**one);
        (outcome == Outcome::Unsatisfiable).then(|| constraints.iter().filter(failed).copied().collect())
    }

    /// Returns a set of these constraints of which a proof needs each; `None` if there is no proof with all of them.
    fn minimal(&mut self, constraints: &BTreeSet<usize>) -> Option<BTreeSet<usize>> {
        let mut needed = self.failed(constraints)?;
        for one in needed.clone() {
            let mut fewer = needed.clone();
            if fewer.remove(&one)
                && let Some(found) = self.failed(&fewer)
            {
                needed = found;
            }
        }
        Some(needed)
    }
}
