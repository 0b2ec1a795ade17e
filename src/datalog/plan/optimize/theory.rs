//! Consequences of one literal, with and without the integrity constraints.

use crate::check::subsumption::{Arg, EQUAL, Fact, GREATER, LESS, Theory};
use crate::check::{Constraint, DeclaredConstraint, PredicateId};
use std::collections::BTreeMap;

/// The integrity constraints, indexed by predicate. A number is the position of a constraint in the list that
/// [`Constraints::new`] took.
#[derive(Clone, Debug, Default)]
pub(super) struct Constraints {
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
    pub(super) fn new<'c>(constraints: impl IntoIterator<Item = &'c DeclaredConstraint>) -> Self {
        let mut theory = Constraints::default();
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
                    let allowed = LESS | GREATER;
                    add(Fact::Compare { allowed, left, right }, number);
                }
            }
        }
        found
    }
}

impl Theory for Constraints {
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
            Fact::Compare { allowed, left, right },
            Fact::Compare {
                allowed: a,
                left: l,
                right: r,
            },
        ) => (left, right) == (l, r) && allowed & a == 0,
        _ => false,
    }
}
