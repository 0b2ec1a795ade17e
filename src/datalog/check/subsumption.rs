//! Theta subsumption between clauses.
//!
//! A clause C *subsumes* a clause D if some substitution of C's variables makes the heads equal and every literal of C
//! follows from a literal of D. Then C derives every row that D derives. The condition is sufficient, not necessary. A
//! [`Theory`] determines what follows from a literal; [`NoConstraints`] is the empty one.
//!
//! The search compares few pairs. A clause can subsume only clauses with all its traits, and [`Subsets`] finds these.
// Decision: docs/decisions/language.md#d036

use std::cmp::Ordering;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use crate::check::rules::{Clause, Literal, PredicateId, Term};
use crate::check::subsets::{Budget, Subsets};
use crate::symbol::WordSize;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
use crate::value::Value;

/// Maximum number of steps of the search for one substitution. Beyond it, the clause counts as not subsumed.
const STEPS_OF_PAIR: usize = 2_000;

/// Maximum number of arguments of a head or an atom that become traits.
const PLACES: usize = 8;

/// An argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Arg {
    Variable(usize),
    Constant(Value),
    /// In an atom: some value. In a negated atom: no value.
    Any,
}

/// Bits for the outcomes of a comparison. A literal allows a set of them.
pub(crate) const LESS: u8 = 1;
pub(crate) const EQUAL: u8 = 2;
pub(crate) const GREATER: u8 = 4;

/// A literal in normal form: up to variable names, literals with equal meaning are equal values.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Fact {
    Atom {
        holds: bool,
        predicate: PredicateId,
        args: Vec<Arg>,
    },
    /// A comparison of symbols or whole numbers, with the smaller argument on the left.
    Compare {
        base: BaseType,
        allowed: u8,
        left: Arg,
        right: Arg,
    },
    /// Another comparison, a string test or an expression. Only an equal fact implies it.
    Opaque { operator: Operator, args: Vec<Arg> },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Operator {
    Comparison(Comparison, BaseType),
    Functor(Functor, BaseType),
}

/// The kind of a fact. Without a theory, facts of different kinds never imply each other. The search processes a body
/// in this order, so that atoms bind the variables of comparisons and negated atoms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Kind {
    Positive(PredicateId),
    Opaque(Operator),
    Compare,
    Negative(PredicateId),
}

impl Fact {
    fn kind(&self) -> Kind {
        match self {
            Fact::Atom { holds, predicate, .. } if *holds => Kind::Positive(*predicate),
            Fact::Atom { predicate, .. } => Kind::Negative(*predicate),
            Fact::Compare { .. } => Kind::Compare,
            Fact::Opaque { operator, .. } => Kind::Opaque(*operator),
        }
    }

    fn args(&self) -> Vec<Arg> {
        match self {
            Fact::Atom { args, .. } | Fact::Opaque { args, .. } => args.clone(),
            Fact::Compare { left, right, .. } => vec![*left, *right],
        }
    }
}

impl Kind {
    /// Returns whether the two arguments are interchangeable.
    fn is_symmetric(self) -> bool {
        matches!(
            self,
            Kind::Opaque(Operator::Comparison(Comparison::Equal | Comparison::NotEqual, _))
        )
    }
}

/// Returns the literals of a clause except aggregates. With `once_is_any`, a variable that occurs only once, in a
/// positive atom, becomes [`Arg::Any`]. Otherwise each `_` of a positive atom becomes a fresh variable, numbered after
/// those of the clause. Numbers of 64 bits count as symbols here, since their words are not ordered as they are.
pub(crate) fn facts(clause: &Clause, once_is_any: bool, size: WordSize) -> Vec<Fact> {
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
        Term::Wildcard if positive && !once_is_any => {
            fresh += 1;
            Arg::Variable(fresh - 1)
        }
        other => plain(&other),
    };
    let fact = |literal: &Literal| {
        Some(match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => Fact::Atom {
                holds: true,
                predicate: atom.predicate,
                args: atom.terms.iter().map(|term| arg(term, true)).collect(),
            },
            Literal::Negative(atom) => Fact::Atom {
                holds: false,
                predicate: atom.predicate,
                args: atom.terms.iter().map(plain).collect(),
            },
            Literal::Compare {
                op, left, right, base, ..
            } => {
                let base = match (base, size) {
                    (BaseType::Number, WordSize::Bits64) => BaseType::Symbol,
                    (base, _) => *base,
                };
                compared(*op, plain(left), plain(right), base)
            }
            Literal::Compute {
                to,
                functor,
                base,
                arguments,
                ..
            } => Fact::Opaque {
                operator: Operator::Functor(*functor, *base),
                args: std::iter::once(to).chain(arguments).map(plain).collect(),
            },
            Literal::Aggregate { .. } => return None,
        })
    };
    clause.body.iter().filter_map(fact).collect()
}

fn plain(term: &Term) -> Arg {
    match *term {
        Term::Variable(id) => Arg::Variable(id.index()),
        Term::Constant(value) => Arg::Constant(value),
        Term::Wildcard => Arg::Any,
    }
}

fn compared(op: Comparison, left: Arg, right: Arg, base: BaseType) -> Fact {
    let allowed = match op {
        Comparison::Equal => EQUAL,
        Comparison::NotEqual => LESS | GREATER,
        Comparison::Less => LESS,
        Comparison::LessEqual => LESS | EQUAL,
        Comparison::Greater => GREATER,
        Comparison::GreaterEqual => GREATER | EQUAL,
        Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => 0,
    };
    // No rule applies to a comparison of floats: NaN is not even equal to itself.
    if allowed != 0 && matches!(base, BaseType::Symbol | BaseType::Number) {
        return comparison(allowed, left, right, base);
    }
    let (op, mut args) = match op {
        Comparison::Greater => (Comparison::Less, vec![right, left]),
        Comparison::GreaterEqual => (Comparison::LessEqual, vec![right, left]),
        other => (other, vec![left, right]),
    };
    if matches!(op, Comparison::Equal | Comparison::NotEqual) {
        args.sort_unstable();
    }
    let operator = Operator::Comparison(op, base);
    Fact::Opaque { operator, args }
}

/// Returns a comparison in normal form. If the outcome is known (equal arguments, or two numbers), it allows every
/// outcome or none.
pub(crate) fn comparison(allowed: u8, left: Arg, right: Arg, base: BaseType) -> Fact {
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
        return Fact::Compare {
            base,
            allowed,
            left,
            right,
        };
    }
    let (allowed, left, right) = match left <= right {
        true => (allowed, left, right),
        false => (turned(allowed), right, left),
    };
    Fact::Compare {
        base,
        allowed,
        left,
        right,
    }
}

/// Returns the same outcomes with the sides exchanged.
fn turned(allowed: u8) -> u8 {
    allowed & EQUAL | (allowed & LESS) << 2 | (allowed & GREATER) >> 2
}

/// Returns whether a known fact implies the wanted one.
pub(crate) fn covers(known: &Fact, wanted: &Fact) -> bool {
    match (known, wanted) {
        (
            Fact::Atom { holds, predicate, args },
            Fact::Atom {
                holds: h,
                predicate: r,
                args: wanted,
            },
        ) => {
            let one =
                |(&known, &wanted): (&Arg, &Arg)| known == wanted || if *holds { wanted } else { known } == Arg::Any;
            holds == h && predicate == r && args.iter().zip(wanted).all(one)
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
        ) => (left, right) == (l, r) && allowed & !a == 0,
        _ => known == wanted,
    }
}

/// The properties that the facts of a program are known to satisfy.
pub(crate) trait Theory {
    /// The size of numbers.
    fn word_size(&self) -> WordSize;

    /// Returns the fact and everything that follows from it.
    fn closure(&self, fact: &Fact) -> Vec<Fact> {
        vec![fact.clone()]
    }

    /// Returns whether the fact is always true.
    fn always(&self, fact: &Fact) -> bool {
        matches!(fact, Fact::Compare { allowed, .. } if *allowed == LESS | EQUAL | GREATER)
    }

    /// Returns whether the predicate never relates a value to itself.
    fn is_irreflexive(&self, _: PredicateId) -> bool {
        false
    }
}

/// The empty theory: the facts are arbitrary.
pub(crate) struct NoConstraints(pub(crate) WordSize);

impl Theory for NoConstraints {
    fn word_size(&self) -> WordSize {
        self.0
    }
}

/// A property of a clause. A clause has all traits of every clause that subsumes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Trait {
    /// A fact of this kind.
    Kind(Kind),
    /// A fact of this kind with the constant in this place.
    Constant(Kind, usize, Value),
    /// A fact of this kind whose argument in this place equals the head's argument in this column.
    Head(Kind, usize, usize),
    /// The constant in this column of the head.
    HeadConstant(usize, Value),
    /// A comparison of a variable with this constant.
    Side(Value),
}

/// A clause without aggregates, prepared for the search.
pub(crate) struct Pattern {
    head: Vec<Arg>,
    variables: usize,
    /// Its distinct literals as the general clause, sorted by kind, then in source order.
    general: Vec<Fact>,
    /// Its literals and everything that follows from them, as the special clause; sorted by kind.
    special: Vec<Fact>,
}

impl Pattern {
    pub(crate) fn new(clause: &Clause, theory: &dyn Theory) -> Self {
        let by_kind = |mut facts: Vec<Fact>| {
            let mut seen = BTreeSet::new();
            facts.retain(|fact| seen.insert(fact.clone()));
            facts.sort_by_key(Fact::kind);
            facts
        };
        let size = theory.word_size();
        let special = facts(clause, false, size);
        Pattern {
            head: clause.head.terms.iter().map(plain).collect(),
            variables: clause.variables.len(),
            general: by_kind(facts(clause, true, size)),
            special: by_kind(special.iter().flat_map(|fact| theory.closure(fact)).collect()),
        }
    }

    /// Returns whether this clause subsumes the other one.
    pub(crate) fn subsumes(&self, other: &Pattern, theory: &dyn Theory, budget: &mut Budget) -> bool {
        self.search(other, theory, false, budget)
    }

    fn search(&self, other: &Pattern, theory: &dyn Theory, renaming: bool, budget: &mut Budget) -> bool {
        budget.part(STEPS_OF_PAIR, |budget| {
            let mut search = SubstitutionSearch {
                theory,
                general: &self.general,
                special: &other.special,
                bound: vec![None; self.variables],
                trail: Vec::new(),
                renaming,
                budget,
            };
            search.unify(&self.head, &other.head) && search.fact(0)
        })
    }

    /// Returns the traits of every clause that this one subsumes.
    fn required(&self, theory: &dyn Theory) -> BTreeSet<Trait> {
        let mut traits = traits(&self.head, &self.general);
        // That a predicate relates no value to itself may hold without a literal.
        traits
            .retain(|one| !matches!(one, Trait::Kind(Kind::Negative(predicate)) if theory.is_irreflexive(*predicate)));
        traits
    }

    /// Returns whether a variable of a subsuming clause may map to a constant. Then a comparison of that variable may
    /// hold without a literal.
    fn names_constants(&self) -> bool {
        let is_constant = |arg: &Arg| matches!(arg, Arg::Constant(_));
        self.head.iter().any(is_constant)
            || self.special.iter().any(|fact| match fact.kind() {
                Kind::Positive(_) | Kind::Opaque(_) => fact.args().iter().any(is_constant),
                Kind::Compare => fact.args().iter().all(is_constant),
                Kind::Negative(_) => false,
            })
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
        let kind = fact.kind();
        match fact {
            Fact::Compare { left, right, .. } => match (left, right) {
                (Arg::Variable(_), Arg::Constant(value)) | (Arg::Constant(value), Arg::Variable(_)) => {
                    traits.insert(Trait::Side(*value));
                }
                _ => {}
            },
            Fact::Atom { holds: false, .. } => _ = traits.insert(Trait::Kind(kind)),
            Fact::Atom { args, .. } | Fact::Opaque { args, .. } => {
                traits.insert(Trait::Kind(kind));
                for (at, arg) in args.iter().take(PLACES).enumerate() {
                    let at = if kind.is_symmetric() { 0 } else { at };
                    if let Arg::Constant(value) = arg {
                        traits.insert(Trait::Constant(kind, at, *value));
                    }
                    let same = head().filter(|(_, other)| *other == arg && *arg != Arg::Any);
                    traits.extend(same.map(|(column, _)| Trait::Head(kind, at, column)));
                }
            }
        }
    }
    traits
}

/// A redundant clause, by its position.
pub(crate) struct Redundant {
    pub(crate) clause: usize,
    /// The clause that derives the same rows.
    pub(crate) by: usize,
    /// Whether the two clauses are equal up to variable names and order.
    pub(crate) copy: bool,
}

/// Finds the clauses of one predicate that others subsume. If two clauses subsume each other, the shorter one stays, or
/// else the first. The search considers only pairs that `counts` accepts.
pub(crate) fn redundant(
    group: &[Pattern],
    theory: &dyn Theory,
    budget: &mut Budget,
    counts: &dyn Fn(usize, usize) -> bool,
) -> Vec<Redundant> {
    let mut found = Vec::new();
    // Removing copies first avoids comparing many copies with each other.
    let mut first: BTreeMap<(&[Arg], &[Fact]), usize> = BTreeMap::new();
    let mut required = Vec::new();
    for (clause, pattern) in group.iter().enumerate() {
        match first.entry((&pattern.head, &pattern.general)) {
            Entry::Occupied(by) if counts(clause, *by.get()) => found.push(Redundant {
                clause,
                by: *by.get(),
                copy: true,
            }),
            Entry::Occupied(_) => {}
            Entry::Vacant(place) => {
                place.insert(clause);
                required.push((clause, pattern.required(theory)));
            }
        }
    }
    let subsets = Subsets::new(&required, |one| matches!(one, Trait::Side(_)));
    let mut gone = vec![false; group.len()];
    for &(clause, _) in &required {
        let pattern = &group[clause];
        let own = traits(&pattern.head, &pattern.special);
        let Some(others) = subsets.within(&own, pattern.names_constants(), budget) else {
            break;
        };
        for by in others {
            if by == clause || gone[by] || !counts(clause, by) {
                continue;
            }
            if let Some(copy) = makes_redundant(group, by, clause, theory, budget) {
                gone[clause] = true;
                found.push(Redundant { clause, by, copy });
                break;
            }
        }
    }
    found
}

/// Returns `None` unless the general clause makes the special one redundant; otherwise whether the two are equal up to
/// names.
fn makes_redundant(
    group: &[Pattern],
    general: usize,
    special: usize,
    theory: &dyn Theory,
    budget: &mut Budget,
) -> Option<bool> {
    let (one, two) = (&group[general], &group[special]);
    if !one.subsumes(two, theory, budget) {
        return None;
    }
    if !two.subsumes(one, theory, budget) {
        return Some(false);
    }
    let [short, long] = [two, one].map(|pattern| pattern.general.len());
    if (short, special) < (long, general) {
        return None;
    }
    Some(short == long && one.search(two, theory, true, budget))
}

/// The state of the search for a substitution.
struct SubstitutionSearch<'a> {
    theory: &'a dyn Theory,
    general: &'a [Fact],
    special: &'a [Fact],
    /// The argument that each variable of the general clause maps to.
    bound: Vec<Option<Arg>>,
    /// The bound variables, in order of binding.
    trail: Vec<usize>,
    /// Whether the substitution must map variables to distinct variables.
    renaming: bool,
    budget: &'a mut Budget,
}

impl SubstitutionSearch<'_> {
    /// Returns whether the facts of the general clause from `at` on follow from the special clause.
    fn fact(&mut self, at: usize) -> bool {
        let Some(wanted) = self.general.get(at) else {
            return !self.renaming || self.renames();
        };
        let (kind, special) = (wanted.kind(), self.special);
        let from = special.partition_point(|known| known.kind() < kind);
        let candidates = special[from..].iter().take_while(|known| known.kind() == kind);
        if matches!(kind, Kind::Compare | Kind::Negative(_))
            && let Some(wanted) = self.instance(wanted)
        {
            let budget = &mut *self.budget;
            let follows =
                self.theory.always(&wanted) || { candidates }.any(|known| budget.take(1) && covers(known, &wanted));
            return follows && self.fact(at + 1);
        }
        // An equation binds its variable, as atoms and expressions do.
        let args = wanted.args();
        for known in candidates {
            let known_args = known.args();
            let reversed = || known_args.iter().rev().copied().collect();
            let orders = match (wanted, known) {
                (Fact::Compare { allowed, .. }, Fact::Compare { allowed: known, .. }) => {
                    let orders = [(*known, known_args.clone()), (turned(*known), reversed())];
                    let fits = |(known, args): (u8, Vec<Arg>)| (known & !allowed == 0).then_some(args);
                    orders.into_iter().filter_map(fits).collect()
                }
                _ if kind.is_symmetric() => vec![known_args.clone(), reversed()],
                _ => vec![known_args],
            };
            for order in orders {
                if !self.budget.take(1) {
                    return false;
                }
                let mark = self.trail.len();
                if self.unify(&args, &order) && self.fact(at + 1) {
                    return true;
                }
                for variable in self.trail.drain(mark..) {
                    self.bound[variable] = None;
                }
            }
        }
        false
    }

    /// Binds variables to make the arguments equal. On failure the trail contains the bindings made so far.
    fn unify(&mut self, general: &[Arg], special: &[Arg]) -> bool {
        general.iter().zip(special).all(|(&general, &special)| match general {
            Arg::Any => true,
            Arg::Constant(_) => general == special,
            Arg::Variable(_) if special == Arg::Any => false,
            Arg::Variable(id) => match self.bound[id] {
                Some(known) => known == special,
                None => {
                    self.bound[id] = Some(special);
                    self.trail.push(id);
                    true
                }
            },
        })
    }

    /// Returns the fact with its variables replaced; `None` if one of them is unbound.
    fn instance(&self, fact: &Fact) -> Option<Fact> {
        let value = |arg: Arg| match arg {
            Arg::Variable(id) => self.bound[id],
            other => Some(other),
        };
        let mut instance = fact.clone();
        match &mut instance {
            Fact::Compare {
                base,
                allowed,
                left,
                right,
            } => return Some(comparison(*allowed, value(*left)?, value(*right)?, *base)),
            Fact::Atom { args, .. } | Fact::Opaque { args, .. } => {
                for arg in args {
                    *arg = value(*arg)?;
                }
            }
        }
        Some(instance)
    }

    fn renames(&self) -> bool {
        let mut images = BTreeSet::new();
        let mut bound = self.bound.iter().flatten();
        bound.all(|image| matches!(image, Arg::Variable(_)) && images.insert(*image))
    }
}

/// Returns whether every literal of the clause is an atom, or a comparison of symbols or whole numbers.
pub(crate) fn within_theory(clause: &Clause) -> bool {
    let facts = facts(clause, false, WordSize::Bits32);
    facts.len() == clause.body.len() && !facts.iter().any(|fact| matches!(fact, Fact::Opaque { .. }))
}

/// Returns whether each subsumed clause has the required traits, so that the search by traits misses none.
#[cfg(test)]
pub(crate) fn traits_suffice<'a>(clauses: impl Iterator<Item = &'a Clause>, theory: &dyn Theory) -> bool {
    let all: Vec<Pattern> = clauses.map(|clause| Pattern::new(clause, theory)).collect();
    let mut pairs = all.iter().flat_map(|one| all.iter().map(move |other| (one, other)));
    pairs.all(|(general, special)| {
        let mut required = general.required(theory);
        required.retain(|one| !(special.names_constants() && matches!(one, Trait::Side(_))));
        required.is_subset(&traits(&special.head, &special.special))
            || !general.subsumes(special, theory, &mut Budget::new(STEPS_OF_PAIR))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::cases;
    use crate::check::random_clauses;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(cases(256))]

        #[test]
        fn traits_suffice_without_constraints(rules in random_clauses::rules()) {
            prop_assert!(traits_suffice(rules.clauses.iter(), &NoConstraints(WordSize::Bits32)));
        }
    }
}
