//! Clauses whose rows another clause of the predicate derives.
//!
//! One clause covers another if some substitution makes the heads equal and every literal of the one implied by the other's. Few pairs are
//! tried: a clause can cover only those that have all its traits, and [`Subsets`] finds these.

use crate::datalog::check::{Budget, Clause, ClauseId, Comparing, RelId, Rules, Subsets, Term};
use crate::datalog::plan::optimize::theory;
use crate::datalog::plan::optimize::theory::{Arg, Fact, Theory, covers, facts};
use crate::datalog::plan::optimize::{Finding, LITERALS_MAX};
use crate::datalog::syntax::ast::BaseType;
use crate::datalog::value::Value;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// Looking for clauses that others cover takes at most so many steps.
const STEPS_MAX: usize = 10_000_000;

/// Of one pair of clauses at most so many.
const STEPS_OF_PAIR: usize = 2_000;

/// Of heads and atoms so many arguments are looked at to find the clauses that are worth trying.
const PLACES: usize = 8;

/// Something a clause has. A clause has the traits of each that covers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Trait {
    /// An atom of the predicate that holds, or that does not.
    Atom(bool, RelId),
    /// An atom that holds, with a constant in this place.
    Constant(RelId, usize, Value),
    /// An atom that holds with, in this place, what stands in this column of the head.
    Head(RelId, usize, usize),
    /// A constant in this column of the head.
    HeadConstant(usize, Value),
    /// A comparison of a variable with this constant.
    Side(Value),
}

/// A clause made ready to be compared with those of its predicate.
struct Candidate {
    id: ClauseId,
    head: Vec<Arg>,
    variables: usize,
    /// Its literals, as those of a clause that covers another.
    general: Vec<Fact>,
    /// Its literals and all that follows from them, as those of a clause that is covered.
    special: Vec<Fact>,
}

impl Candidate {
    fn new(id: ClauseId, clause: &Clause, theory: &Theory) -> Self {
        let arg = |term: &Term| match *term {
            Term::Variable(id) => Arg::Variable(id.index()),
            Term::Constant(value) => Arg::Constant(value),
            Term::Wildcard => Arg::Any,
        };
        // Positive atoms first: they say what the variables are.
        let mut general = facts(clause, true);
        general.sort_by_key(|fact| !matches!(fact, Fact::Atom { holds: true, .. }));
        let special = facts(clause, false);
        Candidate {
            id,
            head: clause.head.terms.iter().map(arg).collect(),
            variables: clause.variables.len(),
            general,
            special: special.iter().flat_map(|fact| theory.closure(fact)).collect(),
        }
    }

    /// What a clause has if this one covers it.
    fn asks(&self, theory: &Theory) -> BTreeSet<Trait> {
        let mut traits = traits(&self.head, &self.general);
        // "It is not related to itself" may hold without being said.
        traits.retain(|one| !matches!(one, Trait::Atom(false, relation) if theory.is_irreflexive(*relation)));
        traits
    }

    /// Whether a variable of a clause that covers this one may stand for a constant. Then a comparison of it may hold without being said.
    fn names_constants(&self) -> bool {
        let is_constant = |arg: &Arg| matches!(arg, Arg::Constant(_));
        let names = |fact: &Fact| match fact {
            Fact::Atom { holds, args, .. } => *holds && args.iter().any(is_constant),
            Fact::Compare { .. } => false,
        };
        self.head.iter().any(is_constant) || self.special.iter().any(names)
    }
}

fn traits(head: &[Arg], facts: &[Fact]) -> BTreeSet<Trait> {
    let head = || head.iter().take(PLACES).enumerate();
    let mut traits = BTreeSet::new();
    traits.extend(head().filter_map(|(column, arg)| match arg {
        Arg::Constant(value) => Some(Trait::HeadConstant(column, *value)),
        _ => None,
    }));
    for fact in facts {
        match fact {
            Fact::Atom { holds, relation, args } => {
                traits.insert(Trait::Atom(*holds, *relation));
                for (at, arg) in args.iter().take(PLACES).enumerate().filter(|_| *holds) {
                    if let Arg::Constant(value) = arg {
                        traits.insert(Trait::Constant(*relation, at, *value));
                    }
                    let same = head().filter(|(_, other)| *other == arg && *arg != Arg::Any);
                    traits.extend(same.map(|(column, _)| Trait::Head(*relation, at, column)));
                }
            }
            Fact::Compare { left, right, .. } => match (left, right) {
                (Arg::Variable(_), Arg::Constant(value)) | (Arg::Constant(value), Arg::Variable(_)) => {
                    traits.insert(Trait::Side(*value));
                }
                _ => {}
            },
        }
    }
    traits
}

/// Finds them. A clause that never fires is neither covered nor covers.
pub(super) fn subsumed(rules: &Rules, theory: &Theory, findings: &mut Vec<Finding>) -> Comparing {
    let contradictory = |finding: &Finding| match finding {
        Finding::Contradictory { clause, .. } => Some(clause.index()),
        _ => None,
    };
    let never: BTreeSet<usize> = findings.iter().filter_map(contradictory).collect();
    let mut by_head: BTreeMap<RelId, Vec<Candidate>> = BTreeMap::new();
    for (index, clause) in rules.clauses.iter().enumerate() {
        let is_known = !clause.body.is_empty() && clause.body.len() <= LITERALS_MAX && theory::speaks_of(clause);
        if is_known && !never.contains(&index) {
            let group = by_head.entry(clause.head.relation).or_default();
            group.push(Candidate::new(ClauseId(index as u32), clause, theory));
        }
    }
    let mut budget = Budget::new(STEPS_MAX);
    for group in by_head.into_values().filter(|group| group.len() > 1) {
        subsumed_of(&without_copies(group, findings), theory, &mut budget, findings);
    }
    budget.spent()
}

/// Those of one predicate, the last first.
fn subsumed_of(group: &[Candidate], theory: &Theory, budget: &mut Budget, findings: &mut Vec<Finding>) {
    let asks: Vec<(usize, BTreeSet<Trait>)> = group.iter().map(|one| one.asks(theory)).enumerate().collect();
    let subsets = Subsets::new(&asks, |one| matches!(one, Trait::Side(_)));
    let mut gone = vec![false; group.len()];
    for (at, special) in group.iter().enumerate().rev() {
        let own = traits(&special.head, &special.special);
        let Some(others) = subsets.within(&own, special.names_constants(), budget) else {
            return;
        };
        let covers =
            |&other: &usize| other != at && !gone[other] && Cover::exists(theory, &group[other], special, budget);
        if let Some(other) = others.into_iter().find(covers) {
            gone[at] = true;
            findings.push(Finding::Subsumed {
                clause: special.id,
                by: group[other].id,
            });
        }
    }
}

/// Finds copies, and leaves them out, so that many of one clause are not compared with each other.
fn without_copies(group: Vec<Candidate>, findings: &mut Vec<Finding>) -> Vec<Candidate> {
    let mut first: BTreeMap<(Vec<Arg>, Vec<Fact>), ClauseId> = BTreeMap::new();
    let mut kept = Vec::new();
    for one in group {
        match first.entry((one.head.clone(), one.general.clone())) {
            Entry::Occupied(other) => findings.push(Finding::Subsumed {
                clause: one.id,
                by: *other.get(),
            }),
            Entry::Vacant(place) => {
                place.insert(one.id);
                kept.push(one);
            }
        }
    }
    kept
}

/// Whether the first clause covers the second.
pub(super) fn is_covered(theory: &Theory, general: &Clause, special: &Clause) -> bool {
    let [general, special] = [general, special].map(|clause| Candidate::new(ClauseId(0), clause, theory));
    Cover::exists(theory, &general, &special, &mut Budget::new(STEPS_OF_PAIR))
}

/// The search for a substitution.
struct Cover<'a, 'b> {
    theory: &'a Theory,
    general: &'a [Fact],
    special: &'a [Fact],
    bound: Vec<Option<Arg>>,
    budget: &'b mut Budget,
}

impl Cover<'_, '_> {
    fn exists(theory: &Theory, general: &Candidate, special: &Candidate, budget: &mut Budget) -> bool {
        budget.part(STEPS_OF_PAIR, |budget| {
            let mut cover = Cover {
                theory,
                general: &general.general,
                special: &special.special,
                bound: vec![None; general.variables],
                budget,
            };
            cover.unify(&general.head, &special.head).is_some() && cover.literal(0)
        })
    }

    /// Binds variables so that the arguments are the others; the variables that were bound.
    fn unify(&mut self, general: &[Arg], special: &[Arg]) -> Option<Vec<usize>> {
        let mut new = Vec::new();
        for (&general, &special) in general.iter().zip(special) {
            let fits = match general {
                Arg::Any => true,
                Arg::Constant(_) => general == special,
                Arg::Variable(_) if special == Arg::Any => false,
                Arg::Variable(id) => match self.bound[id] {
                    Some(known) => known == special,
                    None => {
                        self.bound[id] = Some(special);
                        new.push(id);
                        true
                    }
                },
            };
            if !fits {
                self.release(&new);
                return None;
            }
        }
        Some(new)
    }

    fn release(&mut self, variables: &[usize]) {
        for &variable in variables {
            self.bound[variable] = None;
        }
    }

    fn literal(&mut self, at: usize) -> bool {
        let Some(wanted) = self.general.get(at) else {
            return true;
        };
        match wanted {
            Fact::Atom {
                holds: true,
                relation,
                args,
            } => {
                for special in self.special {
                    let Fact::Atom {
                        holds: true,
                        relation: r,
                        args: found,
                    } = special
                    else {
                        continue;
                    };
                    if relation != r {
                        continue;
                    }
                    if !self.budget.take(1) {
                        return false;
                    }
                    let Some(new) = self.unify(args, found) else { continue };
                    if self.literal(at + 1) {
                        return true;
                    }
                    self.release(&new);
                }
                false
            }
            _ => {
                let Some(wanted) = self.instance(wanted) else {
                    return false;
                };
                let said = self.theory.always(&wanted) || self.special.iter().any(|known| covers(known, &wanted));
                said && self.literal(at + 1)
            }
        }
    }

    /// The fact with its variables replaced; `None` if one is not bound.
    fn instance(&self, fact: &Fact) -> Option<Fact> {
        let arg = |arg: &Arg| match *arg {
            Arg::Variable(id) => self.bound[id],
            other => Some(other),
        };
        Some(match fact {
            Fact::Atom { holds, relation, args } => Fact::Atom {
                holds: *holds,
                relation: *relation,
                args: args.iter().map(arg).collect::<Option<Vec<Arg>>>()?,
            },
            Fact::Compare { allowed, left, right } => {
                theory::comparison(*allowed, arg(left)?, arg(right)?, BaseType::Symbol)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datalog::check::random_clauses;
    use proptest::prelude::*;

    proptest! {
        /// So looking only at clauses that have all traits misses none.
        #[test]
        fn a_covered_clause_has_all_traits_of_the_one_that_covers_it(rules in random_clauses::rules()) {
            for theory in [Theory::new([]), Theory::new(rules.promises.iter().map(|promise| promise.constraint))] {
                let known = rules.clauses.iter().filter(|clause| theory::speaks_of(clause));
                let all: Vec<Candidate> = known.map(|clause| Candidate::new(ClauseId(0), clause, &theory)).collect();
                for (general, special) in all.iter().flat_map(|one| all.iter().map(move |other| (one, other))) {
                    if Cover::exists(&theory, general, special, &mut Budget::new(STEPS_OF_PAIR)) {
                        let mut asked = general.asks(&theory);
                        asked.retain(|one| !(special.names_constants() && matches!(one, Trait::Side(_))));
                        prop_assert!(asked.is_subset(&traits(&special.head, &special.special)));
                    }
                }
            }
        }
    }
}
