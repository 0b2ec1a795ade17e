//! The conditions of a clause on its variables, and searches for existential variables.

use crate::check::{Atom, Clause, Literal, PredicateId, Term};
use crate::dense::count::bounded_counts;
use crate::dense::program::{Argument, Bounds};
use crate::syntax::ast::Comparison;
use std::collections::{BTreeMap, BTreeSet};

/// A variable of a body; 0 is the head's first.
pub(super) type Var = usize;

/// A condition on one variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Property {
    Holds(PredicateId),
    Diagonal(PredicateId),
    /// The predicate relates some entity to it; it is in this column.
    Related(PredicateId, Argument),
    /// The number of rows of the predicate with it in this column lies within bounds.
    Count(PredicateId, Argument, Bounds),
}

/// A literal over variables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Lit {
    Is(Property, Var, bool),
    Pair(PredicateId, Var, Var, bool),
    Same(Var, Var, bool),
}

impl Lit {
    fn negated(self) -> Lit {
        match self {
            Lit::Is(property, of, holds) => Lit::Is(property, of, !holds),
            Lit::Pair(predicate, left, right, holds) => Lit::Pair(predicate, left, right, !holds),
            Lit::Same(left, right, holds) => Lit::Same(left, right, !holds),
        }
    }
}

/// A body over numbered variables.
pub(super) struct DenseBody {
    /// The number of variables, the head's first.
    variables: usize,
    pub literals: Vec<Lit>,
    /// Whether the head has two columns; the second is variable 1.
    pair: bool,
}

impl DenseBody {
    /// Translates a body; `None` if it never holds.
    pub fn new(clause: &Clause) -> Option<DenseBody> {
        let mut numbers: BTreeMap<u32, Var> = BTreeMap::new();
        let mut variables = 0;
        let mut fresh = || {
            variables += 1;
            variables - 1
        };
        let mut number = |term: &Term, fresh: &mut dyn FnMut() -> Var| match term {
            Term::Variable(id) => *numbers.entry(id.0).or_insert_with(fresh),
            Term::Wildcard => fresh(),
            Term::Constant(_) => unreachable!("a stratum with constants is not dense"),
        };
        let mut literals = Vec::new();
        let head: Vec<Var> = (clause.head.terms.iter())
            .map(|term| number(term, &mut fresh))
            .collect();
        let pair = head.len() == 2;
        if pair && head[0] == head[1] {
            let second = fresh();
            literals.push(Lit::Same(head[0], second, true));
        }
        let counts = bounded_counts(clause);
        for count in &counts {
            let entity = number(&Term::Variable(count.entity), &mut fresh);
            let property = |bounds| Property::Count(count.predicate, count.column, bounds);
            literals.extend((count.bounds.iter()).map(|&(bounds, holds)| Lit::Is(property(bounds), entity, holds)));
        }
        let counted = |position: &usize| counts.iter().any(|count| count.literals.contains(position));
        let others = clause
            .body
            .iter()
            .enumerate()
            .filter(|(position, _)| !counted(position));
        for (_, literal) in others {
            match literal {
                Literal::Positive(Atom { predicate, terms, .. }) | Literal::Guard(Atom { predicate, terms, .. }) => {
                    let terms: Vec<Var> = terms.iter().map(|term| number(term, &mut fresh)).collect();
                    literals.push(about(*predicate, &terms, true));
                }
                Literal::Negative(Atom { predicate, terms, .. }) => literals.push(match terms.as_slice() {
                    [term, Term::Wildcard] => Lit::Is(
                        Property::Related(*predicate, Argument::First),
                        number(term, &mut fresh),
                        false,
                    ),
                    [Term::Wildcard, term] => Lit::Is(
                        Property::Related(*predicate, Argument::Second),
                        number(term, &mut fresh),
                        false,
                    ),
                    terms => {
                        let terms: Vec<Var> = terms.iter().map(|term| number(term, &mut fresh)).collect();
                        about(*predicate, &terms, false)
                    }
                }),
                Literal::Compare { op, left, right, .. } => {
                    let (left, right) = (number(left, &mut fresh), number(right, &mut fresh));
                    let holds = *op == Comparison::Equal;
                    match (left == right, holds) {
                        (true, true) => {}
                        (true, false) => return None,
                        (false, _) => literals.push(Lit::Same(left.min(right), left.max(right), holds)),
                    }
                }
                Literal::Compute { .. } | Literal::Aggregate { .. } => {
                    unreachable!("a stratum that computes is not dense")
                }
            }
        }
        literals.sort_unstable();
        literals.dedup();
        let contradicts = |literal: &Lit| literals.binary_search(&literal.negated()).is_ok();
        if literals.iter().any(contradicts) {
            return None;
        }
        Some(DenseBody {
            variables,
            literals,
            pair,
        })
    }

    /// Returns the connected components of the variables other than the head's first; connections through that one do
    /// not count. If the head has two columns, the first component begins with its second variable.
    pub fn groups(&self) -> Vec<Vec<Var>> {
        let mut group: Vec<Var> = (0..self.variables).collect();
        for literal in &self.literals {
            if let Lit::Pair(_, left, right, _) | Lit::Same(left, right, _) = *literal
                && left != 0
                && right != 0
            {
                let (keep, drop) = (group[left].min(group[right]), group[left].max(group[right]));
                group
                    .iter_mut()
                    .filter(|group| **group == drop)
                    .for_each(|group| *group = keep);
            }
        }
        let heads = (1..self.variables).filter(|&var| group[var] == var);
        heads
            .map(|head| (1..self.variables).filter(|&var| group[var] == head).collect())
            .collect()
    }

    /// Whether the predicate relates the head's first variable to all others, and no condition quantifies over all
    /// entities.
    pub fn is_guarded_by(&self, guard: PredicateId) -> bool {
        let asks_all = |literal: &Lit| matches!(literal, Lit::Is(Property::Related(..), ..));
        let guarded = |var| self.literals.contains(&Lit::Pair(guard, 0, var, true));
        (1..self.variables).all(guarded) && !self.literals.iter().any(asks_all)
    }

    /// Returns the head's second variable, if it has two columns.
    pub fn second_of_head(&self) -> Option<Var> {
        self.pair.then_some(1)
    }

    /// Returns the groups of existential variables.
    pub fn conditions(&self) -> Vec<Vec<Var>> {
        self.groups().split_off(usize::from(self.pair))
    }
}

fn about(predicate: PredicateId, terms: &[Var], holds: bool) -> Lit {
    match *terms {
        [of] => Lit::Is(Property::Holds(predicate), of, holds),
        [left, right] if left == right => Lit::Is(Property::Diagonal(predicate), left, holds),
        [left, right] => Lit::Pair(predicate, left, right, holds),
        _ => unreachable!("a dense predicate has one or two columns"),
    }
}

/// How to search for values of the variables of one group: one step per variable.
pub(super) type SearchPlan = Vec<Seek>;

/// A step of a search.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Seek {
    pub properties: Vec<(Property, bool)>,
    /// (predicate, position of the bound variable, whether it holds).
    pub predicates: Vec<(Relates, usize, bool)>,
}

/// A predicate between a value and a bound variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Relates {
    /// The predicate relates them; the value is in this column.
    By(PredicateId, Argument),
    Same,
}

impl DenseBody {
    /// Returns the conditions on one variable alone.
    pub fn properties(&self, var: Var) -> Vec<(Property, bool)> {
        let of = |literal: &Lit| match *literal {
            Lit::Is(property, of, holds) if of == var => Some((property, holds)),
            _ => None,
        };
        self.literals.iter().filter_map(of).collect()
    }

    /// Returns the conditions that relate `var` to a bound variable; `bound` lists these in binding order.
    fn predicates(&self, var: Var, bound: &[Var]) -> Vec<(Relates, usize, bool)> {
        let place = |of: Var| bound.iter().position(|&bound| bound == of);
        let of = |literal: &Lit| match *literal {
            Lit::Pair(predicate, left, right, holds) if right == var => {
                Some((Relates::By(predicate, Argument::Second), place(left)?, holds))
            }
            Lit::Pair(predicate, left, right, holds) if left == var => {
                Some((Relates::By(predicate, Argument::First), place(right)?, holds))
            }
            Lit::Same(left, right, holds) if right == var => Some((Relates::Same, place(left)?, holds)),
            Lit::Same(left, right, holds) if left == var => Some((Relates::Same, place(right)?, holds)),
            _ => None,
        };
        self.literals.iter().filter_map(of).collect()
    }

    /// Returns how to search for a group. The search begins with `first`, if given. It tests `guards` first, since they
    /// leave few values.
    pub fn search(&self, group: &[Var], first: Option<Var>, guards: &[PredicateId]) -> SearchPlan {
        let order = match group.len() {
            0..=PAIR => self.most_known_first(group, first),
            _ => self.last_eliminated_first(group, first),
        };
        let mut bound: Vec<Var> = vec![0];
        let mut search = Vec::new();
        for next in order {
            let mut predicates = self.predicates(next, &bound);
            predicates.sort_by_key(|&(relates, to, holds)| {
                let guards = matches!(relates, Relates::By(predicate, _) if guards.contains(&predicate));
                (!holds, !guards, relates, to)
            });
            search.push(Seek {
                properties: self.properties(next),
                predicates,
            });
            bound.push(next);
        }
        search
    }

    /// Orders a group so that the variable with the most known conditions comes next.
    fn most_known_first(&self, group: &[Var], first: Option<Var>) -> Vec<Var> {
        let mut bound: Vec<Var> = vec![0];
        let mut rest = group.to_vec();
        while !rest.is_empty() {
            let known = |&var: &Var| {
                let predicates = self.predicates(var, &bound);
                let holding = predicates.iter().filter(|(_, _, holds)| *holds).count();
                (
                    Some(var) == first,
                    holding,
                    self.properties(var).len(),
                    std::cmp::Reverse(var),
                )
            };
            let next = *rest.iter().max_by_key(|var| known(var)).expect("there is one");
            bound.push(next);
            rest.retain(|&var| var != next);
        }
        bound.split_off(1)
    }

    /// Orders a group by variable elimination, last eliminated first: the variable that relates to the fewest others
    /// goes next, and these are related from then on. A variable that does not relate to the head's first variable
    /// goes before one that does.
    fn last_eliminated_first(&self, group: &[Var], first: Option<Var>) -> Vec<Var> {
        let mut related = vec![BTreeSet::new(); self.variables];
        for literal in &self.literals {
            if let Lit::Pair(_, left, right, _) | Lit::Same(left, right, _) = *literal {
                related[left].insert(right);
                related[right].insert(left);
            }
        }
        let of_head: Vec<bool> = related.iter().map(|related| related.contains(&0)).collect();
        for others in &mut related {
            others.remove(&0);
        }
        let mut rest = group.to_vec();
        let mut eliminated = Vec::with_capacity(rest.len());
        while !rest.is_empty() {
            let unrelated = |var: Var| {
                let others = &related[var];
                let missing = |&one: &Var| {
                    others
                        .range(one + 1..)
                        .filter(|other| !related[one].contains(other))
                        .count()
                };
                others.iter().map(missing).sum::<usize>()
            };
            let cost = |&var: &Var| {
                (
                    Some(var) == first,
                    related[var].len(),
                    unrelated(var),
                    of_head[var],
                    var,
                )
            };
            let next = *rest.iter().min_by_key(|var| cost(var)).expect("there is one");
            let others = std::mem::take(&mut related[next]);
            for &one in &others {
                related[one].extend(others.iter().filter(|&&other| other != one));
                related[one].remove(&next);
            }
            rest.retain(|&var| var != next);
            eliminated.push(next);
        }
        eliminated.reverse();
        eliminated
    }
}

/// Groups of at most this many variables are searched without tables.
pub(super) const PAIR: usize = 2;

/// The decomposition of a search into a tree of its steps: the values of a step depend on the variables of its
/// separator only.
pub(super) struct Branch {
    /// The bound variables, besides the head's first, that the step and its descendants relate to; ascending. The last
    /// one is that of the parent. Empty for the root.
    pub separator: Vec<usize>,
    /// The steps whose parent this is.
    pub children: Vec<usize>,
    /// Whether the step or a descendant relates to the head's first variable.
    pub of_head: bool,
}

/// Decomposes a search of a group of several variables. The first step is the root.
pub(super) fn decompose(search: &SearchPlan) -> Vec<Branch> {
    let mut branches: Vec<Branch> = (search.iter())
        .map(|seek| {
            let bound: BTreeSet<usize> = seek.predicates.iter().map(|&(_, to, _)| to).collect();
            Branch {
                of_head: bound.contains(&0),
                separator: bound.into_iter().filter(|&to| to != 0).collect(),
                children: Vec::new(),
            }
        })
        .collect();
    for step in (1..branches.len()).rev() {
        let (parents, rest) = branches.split_at_mut(step);
        let branch = &mut rest[0];
        branch.children.sort_unstable();
        let (&parent, others) = branch.separator.split_last().expect("a group is connected");
        let into = &mut parents[parent - 1];
        into.separator.extend(others);
        into.separator.sort_unstable();
        into.separator.dedup();
        into.children.push(step);
        into.of_head |= branch.of_head;
    }
    branches[0].children.sort_unstable();
    branches
}
