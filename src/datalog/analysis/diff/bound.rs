//! An upper bound on the size of a scene that shows a difference.
//!
//! Suppose that only one side derives a fact about the entities in question (the *roots*). Keep the roots. For every
//! true derived fact about the roots, keep one of its derivations; the entities of that derivation are its *witnesses*.
//! Removing all other entities preserves the difference: false derived facts stay false, because they are universal
//! statements, and fewer entities cannot break those. The same holds for constraints. So if there is a difference,
//! there is one with just the roots and the witnesses.
//!
//! The argument fails in three cases: a universal statement depends on an existential one (a negated derived predicate
//! over other entities than the roots); a derivation may be arbitrarily long (recursion); values have an order or a
//! size (numbers, `<`).

use crate::analysis::diff::Cut;
use crate::analysis::diff::pair::{Individual, Output, Pair, Side};
use crate::check::{Atom, Clause, Literal, PredicateId, Term, VarId};
use crate::syntax::ast::{BaseType, Comparison};
use crate::value::Value;
use indexmap::IndexSet;
use std::collections::{BTreeSet, HashMap};

/// Maximum number of facts about roots for all outputs together. Beyond it, later outputs have no bound.
const FACTS_MAX: usize = 200_000;

/// Returns the size up to which an exhaustive search is a proof, if it is known, and whether a limit ended its
/// computation.
pub(super) fn proof(pair: &Pair<'_>) -> (Option<usize>, BTreeSet<Cut>) {
    let sides = [&pair.sides[0], &pair.sides[1]];
    // In evaluation order, so that the bound of an output can use the equality of earlier ones.
    let mut order: Vec<&Output> = pair.outputs.iter().collect();
    order.sort_by_key(|output| sides[0].stratum[output.ids[0].index()]);
    let mut equal = BTreeSet::new();
    let mut proof = Some(0);
    let mut literals_left = FACTS_MAX;
    for output in order {
        let needed = entities(sides, output, &equal, &mut literals_left);
        if needed.is_some() {
            equal.insert(output.name.clone());
        }
        proof = proof.zip(needed).map(|(most, needed)| most.max(needed));
    }
    let cut = (proof.is_none() && literals_left == 0).then_some(Cut::Proof);
    (proof, cut.into_iter().collect())
}

/// An argument of a fact about the roots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Root {
    /// A column of the output.
    Column(usize),
    Constant(Value),
}

type RootFact = (PredicateId, Vec<Root>);

/// Cache of [`Side::cost`].
#[derive(Default)]
struct Costs {
    known: HashMap<(PredicateId, bool), usize>,
    /// Whether a chain of predicates exceeded `DEPTH_MAX`.
    too_deep: bool,
}

/// Maximum number of facts about roots for one output.
const FACTS_OF_OUTPUT_MAX: usize = 1_000;

/// Maximum length of a chain of predicates.
const DEPTH_MAX: usize = 64;

/// An argument of a fact about the roots, in a form that both sides share.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum SharedRoot {
    Column(usize),
    Constant(Individual),
}

/// Returns the number of entities that suffice to show a difference in the output; `None` if no bound is known. The
/// predicates in `equal` have equal rows on both sides unless an earlier output differs, so the witnesses of their
/// facts count once. A computation that exceeds its limit sets `literals_left` to 0.
fn entities(
    sides: [&Side<'_>; 2],
    output: &Output,
    equal: &BTreeSet<String>,
    literals_left: &mut usize,
) -> Option<usize> {
    let arity = output.columns.len();
    let mut total = arity;
    let mut kept: BTreeSet<(&str, Vec<SharedRoot>)> = BTreeSet::new();
    for (side, predicate) in sides.into_iter().zip(output.ids) {
        let mut costs = Costs::default();
        let mut facts: IndexSet<RootFact> = [(predicate, (0..arity).map(Root::Column).collect())].into();
        let mut at = 0;
        while let Some((predicate, row)) = facts.get_index(at).cloned() {
            at += 1;
            *literals_left = literals_left.checked_sub(1)?;
            let witnesses = side.witnesses(predicate, &row, &mut facts, &mut costs);
            if facts.len() > FACTS_OF_OUTPUT_MAX || costs.too_deep {
                *literals_left = 0;
            }
            let witnesses = witnesses?;
            let name = side.rules.predicates[predicate.index()].name.as_str();
            let known = equal.contains(name) && kept.contains(&(name, side.shared(predicate, &row)));
            if !known {
                total = total.checked_add(witnesses)?;
                kept.insert((name, side.shared(predicate, &row)));
            }
        }
    }
    Some(total)
}

impl Side<'_> {
    fn shared(&self, predicate: PredicateId, row: &[Root]) -> Vec<SharedRoot> {
        let columns = &self.rules.predicates[predicate.index()].columns;
        let one = |(root, column): (&Root, &crate::check::Column)| match *root {
            Root::Column(column) => SharedRoot::Column(column),
            Root::Constant(value) => SharedRoot::Constant(self.individual(value, column.base)),
        };
        row.iter().zip(columns).map(one).collect()
    }

    /// Returns the number of witnesses of a fact about the roots. Adds the facts about the roots that it rests on to
    /// `facts`, without counting their witnesses.
    fn witnesses(
        &self,
        predicate: PredicateId,
        row: &[Root],
        facts: &mut IndexSet<RootFact>,
        costs: &mut Costs,
    ) -> Option<usize> {
        let (mut most, mut failing) = (0, 0_usize);
        for clause in self.derivations(predicate)? {
            let (locals, local) = self.split(clause, row, facts)?;
            let (some, none) = self.wildcards(clause)?;
            let mut needed = locals.checked_add(some)?;
            failing = failing.checked_add(none)?;
            for (positive, atom) in local {
                needed = needed.checked_add(self.cost(atom.predicate, positive, 0, costs)?)?;
                // If the fact does not hold, this literal may be the failing one, for any values.
                if self.cost(atom.predicate, !positive, 0, costs)? > 0 {
                    return None;
                }
            }
            most = most.max(needed);
        }
        Some(most.max(failing))
    }

    /// Returns the number of witnesses that any fact of the predicate needs to hold, or to fail.
    fn cost(&self, predicate: PredicateId, holds: bool, depth: usize, costs: &mut Costs) -> Option<usize> {
        if let Some(&known) = costs.known.get(&(predicate, holds)) {
            return Some(known);
        }
        if depth > DEPTH_MAX {
            costs.too_deep = true;
            return None;
        }
        let mut total = 0_usize;
        for clause in self.derivations(predicate)? {
            self.plain(clause)?;
            let head: Vec<VarId> = clause.head.terms.iter().filter_map(Term::variable).collect();
            let locals: BTreeSet<VarId> = clause
                .body
                .iter()
                .flat_map(Literal::variables)
                .filter(|id| !head.contains(id))
                .collect();
            let (some, none) = self.wildcards(clause)?;
            let mut sum = locals.len() + some;
            let mut worst = 0;
            for (positive, atom) in self.derived_atoms(clause) {
                sum = sum.checked_add(self.cost(atom.predicate, positive, depth + 1, costs)?)?;
                worst = worst.max(self.cost(atom.predicate, !positive, depth + 1, costs)?);
            }
            total = match (holds, locals.is_empty()) {
                (true, _) => total.max(sum),
                (false, true) => total.checked_add(worst)?.checked_add(none)?,
                (false, false) if worst == 0 => total.checked_add(none)?,
                (false, false) => return None,
            };
        }
        costs.known.insert((predicate, holds), total);
        Some(total)
    }

    /// Returns the clauses of a derived predicate, none for others; `None` if it is recursive or has columns other than
    /// symbols.
    fn derivations(&self, predicate: PredicateId) -> Option<Vec<&Clause>> {
        let declared = &self.rules.predicates[predicate.index()];
        if declared.columns.iter().any(|column| column.base != BaseType::Symbol) {
            return None;
        }
        if !declared.derived {
            return Some(Vec::new());
        }
        let stratum = self.stratum[predicate.index()]?;
        (!self.rules.strata[stratum].recursive).then(|| self.clauses[predicate.index()].clone())
    }

    /// Returns `Some` if the clause does not depend on an order of values.
    fn plain(&self, clause: &Clause) -> Option<()> {
        let numbers = |atom: &Atom| {
            let columns = &self.rules.predicates[atom.predicate.index()].columns;
            columns.iter().any(|column| column.base != BaseType::Symbol)
        };
        let plain = clause.body.iter().all(|literal| match literal {
            Literal::Positive(atom) | Literal::Negative(atom) | Literal::Guard(atom) => !numbers(atom),
            Literal::Compare { op, base, .. } => {
                *base == BaseType::Symbol && matches!(op, Comparison::Equal | Comparison::NotEqual)
            }
            Literal::Compute { .. } | Literal::Aggregate { .. } => false,
        });
        plain.then_some(())
    }

    /// Returns the numbers of witnesses for the `_` of a clause: for its atoms to hold, and for its negated atoms to
    /// fail. A negated atom with `_` may only have variables of the head; otherwise each value of another variable
    /// could need a witness.
    fn wildcards(&self, clause: &Clause) -> Option<(usize, usize)> {
        let head: Vec<VarId> = clause.head.terms.iter().filter_map(Term::variable).collect();
        let (mut some, mut none) = (0, 0);
        for literal in &clause.body {
            let (atom, positive) = match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => (atom, true),
                Literal::Negative(atom) => (atom, false),
                Literal::Compare { .. } | Literal::Compute { .. } | Literal::Aggregate { .. } => continue,
            };
            let wild = atom.terms.iter().filter(|term| **term == Term::Wildcard).count();
            let local = literal.variables().any(|id| !head.contains(&id));
            match (wild, positive) {
                (0, _) => {}
                _ if self.is_derived(atom) => return None,
                (_, true) => some += wild,
                (_, false) if local => return None,
                (_, false) => none += wild,
            }
        }
        Some((some, none))
    }

    fn derived_atoms<'c>(&self, clause: &'c Clause) -> impl Iterator<Item = (bool, &'c Atom)> {
        clause.body.iter().filter_map(|literal| match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => self.is_derived(atom).then_some((true, atom)),
            Literal::Negative(atom) => self.is_derived(atom).then_some((false, atom)),
            Literal::Compare { .. } | Literal::Compute { .. } | Literal::Aggregate { .. } => None,
        })
    }

    fn is_derived(&self, atom: &Atom) -> bool {
        self.rules.predicates[atom.predicate.index()].derived
    }

    /// Returns the number of variables outside the head, and the derived atoms that contain some of them. Adds the
    /// derived atoms over roots alone to `facts`.
    #[allow(clippy::type_complexity)]
    fn split<'c>(
        &self,
        clause: &'c Clause,
        row: &[Root],
        facts: &mut IndexSet<RootFact>,
    ) -> Option<(usize, Vec<(bool, &'c Atom)>)> {
        self.plain(clause)?;
        let mut bound: Vec<Option<Root>> = vec![None; clause.variables.len()];
        for (term, &root) in clause.head.terms.iter().zip(row) {
            if let Some(id) = term.variable() {
                bound[id.index()].get_or_insert(root);
            }
        }
        let locals: BTreeSet<VarId> = (clause.body.iter().flat_map(Literal::variables))
            .filter(|id| bound[id.index()].is_none())
            .collect();
        let mut local = Vec::new();
        for (positive, atom) in self.derived_atoms(clause) {
            let roots: Option<Vec<Root>> = (atom.terms.iter())
                .map(|term| match *term {
                    Term::Variable(id) => bound[id.index()],
                    Term::Constant(value) => Some(Root::Constant(value)),
                    Term::Wildcard => None,
                })
                .collect();
            match roots {
                Some(roots) => {
                    facts.insert((atom.predicate, roots));
                    if facts.len() > FACTS_OF_OUTPUT_MAX {
                        return None;
                    }
                }
                None => local.push((positive, atom)),
            }
        }
        Some((locals.len(), local))
    }
}
