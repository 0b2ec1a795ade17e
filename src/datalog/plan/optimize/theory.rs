//! Consequences of one literal, with and without the integrity constraints.

use crate::check::subsumption::{Arg, EQUAL, Fact, GREATER, LESS, Theory, covers};
use crate::check::{Constraint, DeclaredConstraint, PredicateId};
use crate::symbol::WordSize;
use crate::syntax::ast::BaseType;
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// The integrity constraints, indexed by predicate. A number is the position of a constraint in the list that
/// [`Constraints::new`] took.
#[derive(Clone, Debug, Default)]
pub(super) struct Constraints {
    size: WordSize,
    implied: BTreeMap<PredicateId, Vec<(PredicateId, usize)>>,
    implying: BTreeMap<PredicateId, Vec<(PredicateId, usize)>>,
    disjoint: BTreeMap<PredicateId, Vec<(PredicateId, usize)>>,
    irreflexive: BTreeMap<PredicateId, usize>,
    symmetric: BTreeMap<PredicateId, usize>,
    asymmetric: BTreeMap<PredicateId, usize>,
    /// Indexed by predicate: its columns with the predicates that relate their values to themselves.
    reflexive: BTreeMap<PredicateId, Vec<(usize, PredicateId, usize)>>,
}

/// The maximum number of consequences derived from one literal.
const CLOSURE_MAX: usize = 256;

/// The consequences of a literal, itself first.
pub(super) struct Closure {
    pub(super) facts: Vec<Fact>,
    /// For each fact but the first, the fact that it follows from and the constraint by which it does.
    steps: Vec<Option<(usize, usize)>>,
}

impl Closure {
    /// Returns the constraints by which a consequence follows from the literal.
    pub(super) fn reasons(&self, fact: usize) -> impl Iterator<Item = usize> + '_ {
        let steps = std::iter::successors(self.steps[fact], |(from, _)| self.steps[*from]);
        steps.map(|(_, constraint)| constraint)
    }
}

impl Constraints {
    pub(super) fn new<'c>(size: WordSize, constraints: impl IntoIterator<Item = &'c DeclaredConstraint>) -> Self {
        let mut theory = Constraints {
            size,
            ..Constraints::default()
        };
        for (number, DeclaredConstraint { constraint, domain, .. }) in constraints.into_iter().enumerate() {
            match *constraint {
                Constraint::Disjoint(a, b) => {
                    theory.disjoint.entry(a).or_default().push((b, number));
                    theory.disjoint.entry(b).or_default().push((a, number));
                }
                Constraint::Implies(a, b) => {
                    theory.implied.entry(a).or_default().push((b, number));
                    theory.implying.entry(b).or_default().push((a, number));
                }
                Constraint::Irreflexive(a) => _ = theory.irreflexive.entry(a).or_insert(number),
                Constraint::Symmetric(a) => _ = theory.symmetric.entry(a).or_insert(number),
                Constraint::Asymmetric(a) => {
                    theory.irreflexive.entry(a).or_insert(number);
                    theory.asymmetric.entry(a).or_insert(number);
                }
                Constraint::Reflexive(a) => {
                    for &(predicate, column) in domain {
                        theory.reflexive.entry(predicate).or_default().push((column, a, number));
                    }
                }
                // A disjunction follows from no single literal in this form.
                Constraint::Covering(_) => {}
            }
        }
        theory
    }

    /// Returns the constraint by which the atom never holds, if it relates a term to itself through an irreflexive
    /// predicate.
    fn forbids_loop(&self, predicate: PredicateId, args: &[Arg]) -> Option<usize> {
        let irreflexive = self.irreflexive.get(&predicate).copied();
        irreflexive.filter(|_| args[0] == args[1] && args[0] != Arg::Any)
    }

    /// Returns the constraints by which the consequences of two literals contradict each other, or `one` has a
    /// consequence that never holds.
    pub(super) fn contradiction(&self, one: &Closure, other: &Closure) -> Option<Vec<usize>> {
        let never = |(at, fact): (usize, &Fact)| Some(one.reasons(at).chain(self.never(fact)?).collect());
        let both = |(a, first): (usize, &Fact)| {
            let excluded = |second: &Fact| excludes(first, second) || excludes(second, first);
            let b = other.facts.iter().position(excluded)?;
            Some(one.reasons(a).chain(other.reasons(b)).collect())
        };
        let consequences = || one.facts.iter().enumerate();
        consequences().find_map(never).or_else(|| consequences().find_map(both))
    }

    /// Returns the constraints by which the fact never holds; `None` if it can hold.
    fn never(&self, fact: &Fact) -> Option<Option<usize>> {
        match fact {
            Fact::Atom { holds, predicate, args } if *holds => self.forbids_loop(*predicate, args).map(Some),
            Fact::Compare { allowed, .. } if *allowed == 0 => Some(None),
            _ => None,
        }
    }

    /// Returns the constraints by which the fact always holds; `None` if it can fail.
    pub(super) fn tautology(&self, fact: &Fact) -> Option<Option<usize>> {
        match fact {
            Fact::Atom { holds, predicate, args } if !*holds => self.forbids_loop(*predicate, args).map(Some),
            Fact::Compare { allowed, .. } if *allowed == LESS | EQUAL | GREATER => Some(None),
            _ => None,
        }
    }

    /// Returns the fact and everything that follows from it, with the reasons.
    pub(super) fn consequences(&self, fact: &Fact) -> Closure {
        let mut found = Closure {
            facts: vec![fact.clone()],
            steps: vec![None],
        };
        let mut at = 0;
        while let Some(fact) = found.facts.get(at).cloned() {
            let from = at;
            at += 1;
            let Fact::Atom { holds, predicate, args } = fact else {
                continue;
            };
            let mut add = |fact: Fact, constraint: usize| {
                if found.facts.len() < CLOSURE_MAX && !found.facts.contains(&fact) {
                    found.facts.push(fact);
                    found.steps.push(Some((from, constraint)));
                }
            };
            let reversed = || args.iter().rev().copied().collect();
            let others = if holds { &self.implied } else { &self.implying };
            for &(predicate, number) in others.get(&predicate).into_iter().flatten() {
                let args = args.clone();
                add(Fact::Atom { holds, predicate, args }, number);
            }
            if let Some(&number) = self.symmetric.get(&predicate) {
                let args = reversed();
                add(Fact::Atom { holds, predicate, args }, number);
            }
            let reflexive = self.reflexive.get(&predicate).filter(|_| holds);
            for &(column, predicate, number) in reflexive.into_iter().flatten() {
                if args[column] != Arg::Any {
                    let args = vec![args[column]; 2];
                    add(Fact::Atom { holds, predicate, args }, number);
                }
            }
            if holds && !args.contains(&Arg::Any) {
                if let Some(&number) = self.asymmetric.get(&predicate) {
                    let fact = Fact::Atom {
                        holds: false,
                        predicate,
                        args: reversed(),
                    };
                    add(fact, number);
                }
                for &(predicate, number) in self.disjoint.get(&predicate).into_iter().flatten() {
                    let fact = Fact::Atom {
                        holds: false,
                        predicate,
                        args: args.clone(),
                    };
                    add(fact, number);
                }
                if let Some(&number) = self.irreflexive.get(&predicate).filter(|_| args[0] != args[1]) {
                    let (left, right) = (args[0].min(args[1]), args[0].max(args[1]));
                    let fact = Fact::Compare {
                        base: BaseType::Symbol,
                        allowed: LESS | GREATER,
                        left,
                        right,
                    };
                    add(fact, number);
                }
            }
        }
        found
    }
}

impl Theory for Constraints {
    fn word_size(&self) -> WordSize {
        self.size
    }

    fn closure(&self, fact: &Fact) -> Vec<Fact> {
        self.consequences(fact).facts
    }

    fn always(&self, fact: &Fact) -> bool {
        self.tautology(fact).is_some()
    }

    fn is_irreflexive(&self, predicate: PredicateId) -> bool {
        self.irreflexive.contains_key(&predicate)
    }
}

fn excludes(a: &Fact, b: &Fact) -> bool {
    match (a, b) {
        (
            Fact::Atom {
                holds: true,
                predicate,
                args,
            },
            Fact::Atom {
                holds: false,
                predicate: r,
                args: none,
            },
        ) => {
            predicate == r
                && args
                    .iter()
                    .zip(none)
                    .all(|(some, none)| some == none || *none == Arg::Any)
        }
        (
            Fact::Compare {
                allowed, left, right, ..
            },
            Fact::Compare {
                allowed: a,
                left: l,
                right: r,
                ..
            },
        ) if (left, right) == (l, r) => allowed & a == 0,
        _ => for_all_numbers(a, b, |a, b| !(a && b)) == Some(true),
    }
}

/// Returns whether a known fact implies the wanted one, alone or as comparisons of a term with two numbers.
pub(super) fn implies(known: &Fact, wanted: &Fact) -> bool {
    covers(known, wanted) || for_all_numbers(known, wanted, |known, wanted| !known || wanted) == Some(true)
}

/// Returns whether all values of a term agree with `holds`, which takes the truth of two comparisons of the term with
/// numbers; `None` for other facts.
fn for_all_numbers(one: &Fact, other: &Fact, holds: impl Fn(bool, bool) -> bool) -> Option<bool> {
    let bounds = |fact: &Fact| match *fact {
        Fact::Compare {
            base: BaseType::Number,
            allowed,
            left: left @ Arg::Variable(_),
            right: Arg::Constant(number),
        } => Some((left, allowed, number.as_number())),
        _ => None,
    };
    let ((term, allowed, number), (other, others, limit)) = (bounds(one)?, bounds(other)?);
    if term != other {
        return None;
    }
    let is_true = |value: i32, allowed: u8, number: i32| {
        let outcome = match value.cmp(&number) {
            Ordering::Less => LESS,
            Ordering::Equal => EQUAL,
            Ordering::Greater => GREATER,
        };
        allowed & outcome != 0
    };
    // Between these values, nothing changes.
    let around = |number: i32| [number.saturating_sub(1), number, number.saturating_add(1)];
    let mut values = around(number).into_iter().chain(around(limit));
    Some(values.all(|value| holds(is_true(value, allowed, number), is_true(value, others, limit))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::subsumption::comparison;
    use crate::value::Value;

    #[test]
    fn comparisons_with_numbers_agree_with_all_values() {
        let sets = || (0..8).flat_map(|allowed| (-3..4).map(move |number| (allowed, number)));
        let fact = |(allowed, number): (u8, i32)| {
            comparison(
                allowed,
                Arg::Variable(0),
                Arg::Constant(Value::number(number)),
                BaseType::Number,
            )
        };
        let holds = |(allowed, number): (u8, i32), value: i32| {
            let outcome = [LESS, EQUAL, GREATER][(value.cmp(&number) as i8 + 1) as usize];
            allowed & outcome != 0
        };
        for (one, other) in sets().flat_map(|one| sets().map(move |other| (one, other))) {
            let both = (-6..7).any(|value| holds(one, value) && holds(other, value));
            let only = (-6..7).any(|value| holds(one, value) && !holds(other, value));
            assert_eq!(excludes(&fact(one), &fact(other)), !both, "{one:?} {other:?}");
            assert_eq!(implies(&fact(one), &fact(other)), !only, "{one:?} {other:?}");
        }
        let most = (GREATER, i32::MAX - 1);
        assert!(implies(&fact(most), &fact((EQUAL, i32::MAX))) && excludes(&fact(most), &fact((EQUAL, 0))));
    }
}
