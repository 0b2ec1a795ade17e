//! What follows from one literal, alone and under the promises.

use crate::datalog::check::{Clause, Constraint, Literal, RelId, Term};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::value::Value;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

/// An argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Arg {
    Variable(usize),
    Constant(Value),
    /// In an atom: some value, whatever it is. In a negated atom: none at all.
    Any,
}

/// Which outcomes of a comparison a literal allows; a set of these bits.
pub(super) const LESS: u8 = 1;
pub(super) const EQUAL: u8 = 2;
pub(super) const GREATER: u8 = 4;

/// A literal in a form in which equal meaning is equal value, as far as names go.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Fact {
    Atom {
        holds: bool,
        relation: RelId,
        args: Vec<Arg>,
    },
    /// The smaller argument stands on the left.
    Compare { allowed: u8, left: Arg, right: Arg },
}

/// The literals of a clause. `once_is_any`: a variable of one positive atom that occurs nowhere else is [`Arg::Any`]; otherwise each
/// `_` of a positive atom is a variable of its own, numbered after those of the clause.
pub(super) fn facts(clause: &Clause, once_is_any: bool) -> Vec<Fact> {
    let mut uses = vec![0_usize; clause.variables.len()];
    let mut count = |term: &Term| {
        if let Term::Variable(id) = term {
            uses[id.index()] += 1;
        }
    };
    clause.head.terms.iter().for_each(&mut count);
    clause.body.iter().flat_map(Literal::terms).for_each(&mut count);
    let mut fresh = clause.variables.len();
    let mut arg = |term: &Term, positive: bool| match *term {
        Term::Variable(id) if positive && once_is_any && uses[id.index()] == 1 => Arg::Any,
        Term::Variable(id) => Arg::Variable(id.index()),
        Term::Constant(value) => Arg::Constant(value),
        Term::Wildcard if positive && !once_is_any => {
            fresh += 1;
            Arg::Variable(fresh - 1)
        }
        Term::Wildcard => Arg::Any,
    };
    let fact = |literal: &Literal| {
        Some(match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => Fact::Atom {
                holds: true,
                relation: atom.relation,
                args: atom.terms.iter().map(|term| arg(term, true)).collect(),
            },
            Literal::Negative(atom) => Fact::Atom {
                holds: false,
                relation: atom.relation,
                args: atom.terms.iter().map(|term| arg(term, false)).collect(),
            },
            Literal::Compare {
                op, left, right, base, ..
            } => comparison(allowed(*op), arg(left, false), arg(right, false), *base),
            Literal::Compute { .. } | Literal::Aggregate { .. } => return None,
        })
    };
    clause.body.iter().filter_map(fact).collect()
}

/// Whether all literals of a clause are atoms, or comparisons of texts or whole numbers. Of expressions and aggregates nothing is
/// known here, and floats have values that are not even equal to themselves; a clause with any of them is left as it is.
pub(crate) fn speaks_of(clause: &Clause) -> bool {
    clause.body.iter().all(|literal| match literal {
        Literal::Positive(_) | Literal::Negative(_) | Literal::Guard(_) => true,
        Literal::Compare { op, base, .. } => {
            let texts = [
                Comparison::Match,
                Comparison::NotMatch,
                Comparison::Contains,
                Comparison::NotContains,
            ];
            matches!(base, BaseType::Symbol | BaseType::Number) && !texts.contains(op)
        }
        Literal::Compute { .. } | Literal::Aggregate { .. } => false,
    })
}

fn allowed(op: Comparison) -> u8 {
    match op {
        Comparison::Equal => EQUAL,
        Comparison::NotEqual => LESS | GREATER,
        Comparison::Less => LESS,
        Comparison::LessEqual => LESS | EQUAL,
        Comparison::Greater => GREATER,
        Comparison::GreaterEqual => GREATER | EQUAL,
        // Nothing is known.
        Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => {
            LESS | EQUAL | GREATER
        }
    }
}

/// A comparison in normal form. Of one thing with itself, or of two numbers, the outcome is known: all or nothing is allowed.
pub(super) fn comparison(allowed: u8, left: Arg, right: Arg, base: BaseType) -> Fact {
    let known = match (left, right) {
        _ if left == right => Some(Ordering::Equal),
        (Arg::Constant(a), Arg::Constant(b)) if base == BaseType::Number => Some(a.as_number().cmp(&b.as_number())),
        _ => None,
    };
    let bit = |order| match order {
        Ordering::Less => LESS,
        Ordering::Equal => EQUAL,
        Ordering::Greater => GREATER,
    };
    if let Some(order) = known {
        let allowed = if allowed & bit(order) == 0 {
            0
        } else {
            LESS | EQUAL | GREATER
        };
        return Fact::Compare { allowed, left, right };
    }
    if left <= right {
        return Fact::Compare { allowed, left, right };
    }
    let turned = allowed & EQUAL | (allowed & LESS) << 2 | (allowed & GREATER) >> 2;
    Fact::Compare {
        allowed: turned,
        left: right,
        right: left,
    }
}

/// The promises, by predicate.
#[derive(Clone, Debug, Default)]
pub(super) struct Theory {
    implied: BTreeMap<RelId, Vec<RelId>>,
    implying: BTreeMap<RelId, Vec<RelId>>,
    disjoint: BTreeMap<RelId, Vec<RelId>>,
    irreflexive: BTreeSet<RelId>,
    symmetric: BTreeSet<RelId>,
}

/// Of one literal at most so many consequences are drawn.
const CLOSURE_MAX: usize = 256;

impl Theory {
    pub(super) fn new(constraints: impl IntoIterator<Item = Constraint>) -> Theory {
        let mut theory = Theory::default();
        for constraint in constraints {
            match constraint {
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
            }
        }
        theory
    }

    /// Whether the fact holds always.
    pub(super) fn always(&self, fact: &Fact) -> bool {
        match fact {
            Fact::Atom { holds, relation, args } => !holds && self.is_loop(*relation, args),
            Fact::Compare { allowed, .. } => *allowed == LESS | EQUAL | GREATER,
        }
    }

    /// An atom that relates one thing to itself, and never may.
    fn is_loop(&self, relation: RelId, args: &[Arg]) -> bool {
        self.irreflexive.contains(&relation) && args[0] == args[1] && args[0] != Arg::Any
    }

    /// Whether the predicate never relates a thing to itself.
    pub(super) fn is_irreflexive(&self, relation: RelId) -> bool {
        self.irreflexive.contains(&relation)
    }

    /// The fact and what follows from it.
    pub(super) fn closure(&self, fact: &Fact) -> Vec<Fact> {
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
            if holds && !args.contains(&Arg::Any) {
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

    /// Whether no two of these facts, each with all that follows from it, can hold together; one with itself included.
    pub(super) fn contradict(&self, one: &[Fact], other: &[Fact]) -> bool {
        one.iter()
            .any(|a| self.never(a) || other.iter().any(|b| excludes(a, b) || excludes(b, a)))
    }

    fn never(&self, fact: &Fact) -> bool {
        match fact {
            Fact::Atom { holds, relation, args } => *holds && self.is_loop(*relation, args),
            Fact::Compare { allowed, .. } => *allowed == 0,
        }
    }
}

/// Whether a known fact says at least what is wanted.
pub(super) fn covers(known: &Fact, wanted: &Fact) -> bool {
    match (known, wanted) {
        (
            Fact::Atom { holds, relation, args },
            Fact::Atom {
                holds: h,
                relation: r,
                args: wanted,
            },
        ) => {
            let one =
                |(&known, &wanted): (&Arg, &Arg)| known == wanted || if *holds { wanted } else { known } == Arg::Any;
            holds == h && relation == r && args.iter().zip(wanted).all(one)
        }
        (
            Fact::Compare { allowed, left, right },
            Fact::Compare {
                allowed: a,
                left: l,
                right: r,
            },
        ) => (left, right) == (l, r) && allowed & !a == 0,
        _ => false,
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
