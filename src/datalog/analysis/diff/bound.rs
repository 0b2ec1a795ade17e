//! How large a scene a difference needs.
//!
//! Let a fact about the entities in question (the *roots*) hold on one side only. Keep the roots, and for every derived fact about the
//! roots that is true a way in which it is derived: the entities of that way are its *witnesses*. All that is said of those that are
//! left is still so, since what is not derived says "for all", which fewer entities cannot break; and constraints say "for all" too.
//! So if there is a difference, there is one with the roots and the witnesses alone.
//!
//! That fails where "for all" depends on "there is" (a derived predicate about others than the roots that must not hold), where the
//! way of a fact may be arbitrarily long (recursion), and where values have an order or a size (numbers, `<`).

use crate::datalog::analysis::diff::ground::variables;
use crate::datalog::analysis::diff::{Individual, Output, Side};
use crate::datalog::check::{Atom, Clause, Literal, RelId, Term};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::value::Value;
use indexmap::IndexSet;
use std::collections::{BTreeSet, HashMap};

/// Of all outputs together, so many facts about roots are taken apart; of later outputs no bound is known.
pub(super) const FACTS_MAX: usize = 200_000;

/// An argument of a fact about the roots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Root {
    /// A column of the output.
    Column(usize),
    Constant(Value),
}

type RootFact = (RelId, Vec<Root>);

/// What [`Side::cost`] is known to be.
#[derive(Default)]
struct Costs {
    known: HashMap<(RelId, bool), usize>,
    /// A chain of predicates was too long to follow.
    too_deep: bool,
}

/// About one output so many facts about roots are taken apart.
const FACTS_OF_OUTPUT_MAX: usize = 1_000;

/// Longer chains of predicates are not followed.
const DEPTH_MAX: usize = 64;

/// An argument of a fact about the roots, in words that mean the same on both sides.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Argument {
    Column(usize),
    Constant(Individual),
}

/// The number of entities that suffice to show a difference in the output of that name; `None` if no number is known
/// to. Outputs in `equal` are the same on both sides wherever those are, so their witnesses count once. `literals_left`
/// is 0 if it would have taken too long.
pub(super) fn entities(
    sides: [&Side<'_>; 2],
    output: &Output,
    equal: &BTreeSet<String>,
    literals_left: &mut usize,
) -> Option<usize> {
    let arity = output.columns.len();
    let mut total = arity;
    let mut kept: BTreeSet<(&str, Vec<Argument>)> = BTreeSet::new();
    for (side, relation) in sides.into_iter().zip(output.ids) {
        let mut costs = Costs::default();
        let mut facts: IndexSet<RootFact> = [(relation, (0..arity).map(Root::Column).collect())].into();
        let mut at = 0;
        while let Some((relation, row)) = facts.get_index(at).cloned() {
            at += 1;
            *literals_left = literals_left.checked_sub(1)?;
            let witnesses = side.witnesses(relation, &row, &mut facts, &mut costs);
            if facts.len() > FACTS_OF_OUTPUT_MAX || costs.too_deep {
                *literals_left = 0;
            }
            let witnesses = witnesses?;
            let name = side.rules.relations[relation.index()].name.as_str();
            let known = equal.contains(name) && kept.contains(&(name, side.arguments(relation, &row)));
            if !known {
                total = total.checked_add(witnesses)?;
                kept.insert((name, side.arguments(relation, &row)));
            }
        }
    }
    Some(total)
}

impl Side<'_> {
    fn arguments(&self, relation: RelId, row: &[Root]) -> Vec<Argument> {
        let columns = &self.rules.relations[relation.index()].columns;
        let one = |(root, column): (&Root, &crate::datalog::check::Column)| match *root {
            Root::Column(column) => Argument::Column(column),
            Root::Constant(value) => Argument::Constant(self.individual(value, column.base)),
        };
        row.iter().zip(columns).map(one).collect()
    }

    /// Witnesses of a fact about the roots, those of other such facts not counted; these are added to `facts`.
    fn witnesses(
        &self,
        relation: RelId,
        row: &[Root],
        facts: &mut IndexSet<RootFact>,
        costs: &mut Costs,
    ) -> Option<usize> {
        let (mut most, mut failing) = (0, 0_usize);
        for clause in self.derivations(relation)? {
            let (locals, local) = self.split(clause, row, facts)?;
            let (some, none) = self.wildcards(clause)?;
            let mut needed = locals.checked_add(some)?;
            failing = failing.checked_add(none)?;
            for (positive, atom) in local {
                needed = needed.checked_add(self.cost(atom.relation, positive, 0, costs)?)?;
                // Where the fact does not hold, this literal may be what fails, for any values.
                if self.cost(atom.relation, !positive, 0, costs)? > 0 {
                    return None;
                }
            }
            most = most.max(needed);
        }
        Some(most.max(failing))
    }

    /// Witnesses that any fact of the predicate needs to hold, or to fail.
    fn cost(&self, relation: RelId, holds: bool, depth: usize, costs: &mut Costs) -> Option<usize> {
        if let Some(&known) = costs.known.get(&(relation, holds)) {
            return Some(known);
        }
        if depth > DEPTH_MAX {
            costs.too_deep = true;
            return None;
        }
        let mut total = 0_usize;
        for clause in self.derivations(relation)? {
            self.plain(clause)?;
            let head: Vec<usize> = clause.head.terms.iter().filter_map(variable).collect();
            let locals: BTreeSet<usize> = clause
                .body
                .iter()
                .flat_map(variables)
                .filter(|id| !head.contains(id))
                .collect();
            let (some, none) = self.wildcards(clause)?;
            let mut sum = locals.len() + some;
            let mut worst = 0;
            for (positive, atom) in self.derived_atoms(clause) {
                sum = sum.checked_add(self.cost(atom.relation, positive, depth + 1, costs)?)?;
                worst = worst.max(self.cost(atom.relation, !positive, depth + 1, costs)?);
            }
            total = match (holds, locals.is_empty()) {
                (true, _) => total.max(sum),
                (false, true) => total.checked_add(worst)?.checked_add(none)?,
                (false, false) if worst == 0 => total.checked_add(none)?,
                (false, false) => return None,
            };
        }
        costs.known.insert((relation, holds), total);
        Some(total)
    }

    /// The clauses of a derived predicate, none for others; `None` if it is recursive.
    fn derivations(&self, relation: RelId) -> Option<Vec<&Clause>> {
        let declared = &self.rules.relations[relation.index()];
        if declared.columns.iter().any(|column| column.base != BaseType::Symbol) {
            return None;
        }
        if !declared.derived {
            return Some(Vec::new());
        }
        let stratum = self.stratum[relation.index()]?;
        (!self.rules.strata[stratum].recursive).then(|| self.clauses[relation.index()].clone())
    }

    /// That a clause asks for no order of values.
    fn plain(&self, clause: &Clause) -> Option<()> {
        let numbers = |atom: &Atom| {
            let columns = &self.rules.relations[atom.relation.index()].columns;
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

    /// Witnesses for the `_` of a clause: that its atoms hold, and that its negated atoms fail. The latter must be about the head
    /// only, or there would be others for each value of a variable.
    fn wildcards(&self, clause: &Clause) -> Option<(usize, usize)> {
        let head: Vec<usize> = clause.head.terms.iter().filter_map(variable).collect();
        let (mut some, mut none) = (0, 0);
        for literal in &clause.body {
            let (atom, positive) = match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => (atom, true),
                Literal::Negative(atom) => (atom, false),
                Literal::Compare { .. } | Literal::Compute { .. } | Literal::Aggregate { .. } => continue,
            };
            let wild = atom.terms.iter().filter(|term| **term == Term::Wildcard).count();
            let local = variables(literal).any(|id| !head.contains(&id));
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
        self.rules.relations[atom.relation.index()].derived
    }

    /// How many other variables a clause has when its head is about the roots, and the derived atoms about others. Those about the
    /// roots are added to `facts`.
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
            if let Some(id) = variable(term) {
                bound[id].get_or_insert(root);
            }
        }
        let locals: BTreeSet<usize> = (clause.body.iter().flat_map(variables))
            .filter(|&id| bound[id].is_none())
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
                    facts.insert((atom.relation, roots));
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

fn variable(term: &Term) -> Option<usize> {
    match term {
        Term::Variable(variable) => Some(variable.index()),
        _ => None,
    }
}
