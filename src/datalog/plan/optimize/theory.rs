//! Consequences of one literal, with and without the integrity constraints.

use crate::datalog::check::subsumption::{Arg, EQUAL, Fact, GREATER, LESS, Theory};
use crate::datalog::check::{Constraint, DeclaredConstraint, RelId};
use std::collections::{BTreeMap, BTreeSet};

/// The integrity constraints, indexed by predicate.
#[derive(Clone, Debug, Default)]
pub(super) struct Constraints {
    implied: BTreeMap<RelId, Vec<RelId>>,
    implying: BTreeMap<RelId, Vec<RelId>>,
    disjoint: BTreeMap<RelId, Vec<RelId>>,
    irreflexive: BTreeSet<RelId>,
    symmetric: BTreeSet<RelId>,
    asymmetric: BTreeSet<RelId>,
    /// Indexed by predicate: its columns with the predicates that relate their values to themselves.
    reflexive: BTreeMap<RelId, Vec<(usize, RelId)>>,
}

/// The maximum number of consequences derived from one literal.
const CLOSURE_MAX: usize = 256;

impl Constraints {
    pub(super) fn new<'c>(constraints: impl IntoIterator<Item = &'c DeclaredConstraint>) -> Self {
        let mut theory = Constraints::default();
        for DeclaredConstraint { constraint, domain, .. } in constraints {
            match *constraint {
                Constraint::Disjoint(a, b) => {
                    theory.disjoint.entry(a).or_default().push(b);
                    theory.disjoint.entry(b).or_default().push(a);
                }
                Constraint::Implies(a, b) => {
                    theory.implied.entry(a).or_default().push(b);
                    theory.implying.entry(b).or_default().push(a);
                }
                Constraint::Irreflexive(a) => _ = theory.irreflexive.insert(a),
                Constraint::Symmetric(a) => _ = theory.symmetric.insert(a),
                Constraint::Asymmetric(a) => {
                    theory.irreflexive.insert(a);
                    theory.asymmetric.insert(a);
                }
                Constraint::Reflexive(a) => {
                    for &(relation, column) in domain {
                        theory.reflexive.entry(relation).or_default().push((column, a));
                    }
                }
                // A disjunction follows from no single literal in this form.
                Constraint::Covering(_) => {}
            }
        }
        theory
    }

    /// Whether the atom relates a term to itself through an irreflexive predicate.
    fn is_loop(&self, relation: RelId, args: &[Arg]) -> bool {
        self.irreflexive.contains(&relation) && args[0] == args[1] && args[0] != Arg::Any
    }

    /// Whether the two sets of facts contradict each other, or `one` contains a fact that never holds.
    pub(super) fn contradict(&self, one: &[Fact], other: &[Fact]) -> bool {
        one.iter()
            .any(|a| self.never(a) || other.iter().any(|b| excludes(a, b) || excludes(b, a)))
    }

    fn never(&self, fact: &Fact) -> bool {
        match fact {
            Fact::Atom { holds, relation, args } => *holds && self.is_loop(*relation, args),
            Fact::Compare { allowed, .. } => *allowed == 0,
            Fact::Opaque { .. } => false,
        }
    }
}

impl Theory for Constraints {
    fn closure(&self, fact: &Fact) -> Vec<Fact> {
        let mut found = vec![fact.clone()];
        let mut at = 0;
        while let Some(fact) = found.get(at).cloned() {
            at += 1;
            let Fact::Atom { holds, relation, args } = fact else {
                continue;
            };
            let mut add = |fact: Fact| {
                if found.len() < CLOSURE_MAX && !found.contains(&fact) {
                    found.push(fact);
                }
            };
            let others = if holds { &self.implied } else { &self.implying };
            for &relation in others.get(&relation).into_iter().flatten() {
                add(Fact::Atom {
                    holds,
                    relation,
                    args: args.clone(),
                });
            }
            if self.symmetric.contains(&relation) {
                add(Fact::Atom {
                    holds,
                    relation,
                    args: args.iter().rev().copied().collect(),
                });
            }
            let reflexive = self.reflexive.get(&relation).filter(|_| holds);
            for &(column, relation) in reflexive.into_iter().flatten() {
                if args[column] != Arg::Any {
                    add(Fact::Atom {
                        holds,
                        relation,
                        args: vec![args[column]; 2],
                    });
                }
            }
            if holds && !args.contains(&Arg::Any) {
                if self.asymmetric.contains(&relation) {
                    add(Fact::Atom {
                        holds: false,
                        relation,
                        args: args.iter().rev().copied().collect(),
                    });
                }
                for &relation in self.disjoint.get(&relation).into_iter().flatten() {
                    add(Fact::Atom {
                        holds: false,
                        relation,
                        args: args.clone(),
                    });
                }
                if self.irreflexive.contains(&relation) && args[0] != args[1] {
                    let (left, right) = (args[0].min(args[1]), args[0].max(args[1]));
                    add(Fact::Compare {
                        allowed: LESS | GREATER,
                        left,
                        right,
                    });
                }
            }
        }
        found
    }

    fn always(&self, fact: &Fact) -> bool {
        match fact {
            Fact::Atom { holds, relation, args } => !holds && self.is_loop(*relation, args),
            Fact::Compare { allowed, .. } => *allowed == LESS | EQUAL | GREATER,
            Fact::Opaque { .. } => false,
        }
    }

    fn is_irreflexive(&self, relation: RelId) -> bool {
        self.irreflexive.contains(&relation)
    }
}

fn excludes(a: &Fact, b: &Fact) -> bool {
    match (a, b) {
        (
            Fact::Atom {
                holds: true,
                relation,
                args,
            },
            Fact::Atom {
                holds: false,
                relation: r,
                args: none,
            },
        ) => {
            relation == r
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
