//! Decides which clauses the dense executor can evaluate.

use crate::check::{Atom, Clause, ClauseId, Literal, PredicateId, Rules, Stratum, Term, VarId};
use crate::dense::body::{DenseBody, PAIR, decompose};
use crate::dense::count::{BoundedCount, bounded_counts, is_stored};
use crate::dense::program::Dense;
use crate::diag::Span;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};
use std::collections::HashMap;

/// The reason why the dense executor cannot evaluate a clause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unsupported {
    /// What the dense executor does not support.
    pub construct: Construct,
    /// The clause; the first one of a recursive stratum.
    pub clause: ClauseId,
    /// The place of the construct.
    pub span: Span,
}

/// A construct that the dense executor does not support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Construct {
    /// The predicate depends on itself.
    Recursion(PredicateId),
    /// A predicate whose rows depend on the rounds of its evaluation.
    Rounds(PredicateId),
    /// The predicate has no columns, or more than two.
    Columns(PredicateId),
    /// The predicate has a column whose values may be no entities.
    NotEntities(PredicateId),
    /// A constant.
    Constant,
    /// A draw about more than two entities, or about the value of an expression on several.
    Draw,
    /// An expression.
    Expression,
    /// A comparison other than `=` and `!=` of two variables for symbols.
    Comparison,
    /// An aggregate, except a count of entities that is only compared with constants.
    Aggregate(AggregateOp),
    /// A negated atom without a variable.
    NoVariable,
    /// A clause with too many variables.
    Variables,
}

impl Unsupported {
    fn at(clause: ClauseId, (construct, span): (Construct, Span)) -> Unsupported {
        Unsupported {
            construct,
            clause,
            span,
        }
    }

    /// Returns the reason as a sentence without a full stop, to follow "because".
    pub fn show(&self, rules: &Rules) -> String {
        let named = |predicate: PredicateId| {
            let predicate = &rules.predicates[predicate.index()];
            match predicate.hidden {
                true => predicate.title().to_owned(),
                false => format!("`{}`", predicate.name),
            }
        };
        let head = named(rules.clauses[self.clause.index()].head.predicate);
        match self.construct {
            Construct::Recursion(predicate) => format!("{} depends on itself", named(predicate)),
            Construct::Columns(predicate) => format!(
                "a clause of {head} uses {}, which has {} columns, not one or two",
                named(predicate),
                rules.predicates[predicate.index()].arity()
            ),
            Construct::NotEntities(predicate) => {
                format!(
                    "a clause of {head} uses {}, which has a column that may hold values other than agents",
                    named(predicate)
                )
            }
            Construct::Rounds(predicate) => {
                format!("{} depends on the rounds in which rows are derived", named(predicate))
            }
            Construct::Constant => format!("a clause of {head} names a constant"),
            Construct::Draw => format!("a clause of {head} draws for each combination of more than two agents"),
            Construct::Expression => format!("a clause of {head} computes a value"),
            Construct::Comparison => format!("a clause of {head} compares values"),
            Construct::Aggregate(op) => format!("a clause of {head} aggregates with `{}`", op.name()),
            Construct::NoVariable => format!("a clause of {head} negates an atom without a variable"),
            Construct::Variables => format!("a clause of {head} has more than {} variables", Dense::VARIABLES_MAX),
        }
    }

    /// Returns what to write instead, if something has the same meaning.
    pub fn help(&self) -> Option<&'static str> {
        match self.construct {
            Construct::Recursion(_) => Some("write out the steps if chains have a bounded length"),
            Construct::Columns(_) => Some("use predicates of one or two columns"),
            Construct::Constant => Some(
                "if the constant names an agent, give the agent a concept in the configuration and test that instead",
            ),
            Construct::Aggregate(AggregateOp::Count) => {
                Some("count the agents that a predicate relates to one agent, and compare the count with constants")
            }
            Construct::Draw => Some(
                "derive the body in a predicate over one agent or two, and draw over that; variables that begin with `_` \
                 take no part in a draw",
            ),
            Construct::Variables => Some("derive a part of the body in a predicate of its own"),
            Construct::NotEntities(_)
            | Construct::Expression
            | Construct::Comparison
            | Construct::Aggregate(_)
            | Construct::Rounds(_)
            | Construct::NoVariable => None,
        }
    }
}

/// Returns why the dense executor cannot evaluate clauses, in the order of strata: one reason for each such clause, and
/// for each recursive stratum.
pub fn obstacles(rules: &Rules) -> Vec<Unsupported> {
    let aggregates = aggregates(rules);
    let mut is_known = vec![false; rules.clauses.len()];
    let found = rules.strata.iter().flat_map(|stratum| obstacles_in(rules, stratum));
    let found = found.map(|reason| visible(rules, &aggregates, reason));
    found
        .filter(|reason| !std::mem::replace(&mut is_known[reason.clause.index()], true))
        .collect()
}

/// Returns the clauses whose searches may take more than [`Dense::steps_max`] steps over this many entities, `egos` of
/// them to decide about. A run of the other clauses always ends. The dense executor evaluates all `rules`.
pub fn costly(rules: &Rules, entities: usize, egos: usize) -> Vec<ClauseId> {
    let clauses = rules.strata.iter().flat_map(|stratum| &stratum.clauses).copied();
    let steps: Vec<(ClauseId, u64)> = clauses
        .map(|clause| (clause, steps(rules, clause, entities as u64, egos as u64)))
        .collect();
    let all = steps.iter().fold(0_u64, |sum, (_, steps)| sum.saturating_add(*steps));
    let max = Dense::steps_max(entities);
    // If the sum alone exceeds it, the most expensive clause counts.
    let largest = steps.iter().map(|(_, steps)| *steps).max().unwrap_or(0);
    let costly = |steps: u64| steps > max || all > max && steps == largest;
    steps
        .into_iter()
        .filter(|(_, steps)| costly(*steps))
        .map(|(clause, _)| clause)
        .collect()
}

/// Returns the maximum number of steps that the searches of a clause take.
fn steps(rules: &Rules, clause: ClauseId, entities: u64, egos: u64) -> u64 {
    let Some(body) = DenseBody::new(&rules.clauses[clause.index()]) else {
        return 0;
    };
    let (groups, first) = (body.groups(), body.second_of_head());
    let mut sum = 0_u64;
    for group in groups.iter().filter(|group| group.len() > PAIR) {
        let first = first.filter(|first| group.contains(first));
        for branch in decompose(&body.search(group, first, &[])) {
            let of_head = if branch.of_head { egos } else { 1 };
            let combinations = branch
                .separator
                .iter()
                .fold(of_head, |product, _| product.saturating_mul(entities));
            // An interrupted search repeats some steps.
            sum = sum.saturating_add(combinations.saturating_mul(2));
        }
    }
    sum
}

/// Returns the reasons in a stratum why its clauses cannot be dense: one for each such clause, or one for a recursive
/// stratum.
pub(super) fn obstacles_in(rules: &Rules, stratum: &Stratum) -> Vec<Unsupported> {
    if !stratum.recursive {
        return (stratum.clauses.iter().filter_map(|&id| obstacle(rules, id))).collect();
    }
    let within = |atom: &&Atom| stratum.predicates.contains(&atom.predicate);
    let step = |&clause: &ClauseId| {
        let mut atoms = rules.clauses[clause.index()].body.iter().filter_map(Literal::atom);
        let atom = atoms.find(within)?;
        Some(Unsupported::at(
            clause,
            (Construct::Recursion(atom.predicate), atom.span),
        ))
    };
    stratum.clauses.iter().find_map(step).into_iter().collect()
}

/// Returns the reason in the clause itself why it cannot be dense, if any.
pub(super) fn obstacle(rules: &Rules, id: ClauseId) -> Option<Unsupported> {
    let clause = &rules.clauses[id.index()];
    let wildcards = clause.body.iter().flat_map(Literal::terms);
    let wildcards = wildcards.filter(|term| **term == Term::Wildcard).count();
    let many = clause.variables.len() + wildcards > Dense::VARIABLES_MAX;
    let found = many.then_some((Construct::Variables, clause.span));
    // Expressions and aggregates are the reason for columns of numbers.
    let counts: Vec<BoundedCount> = bounded_counts(clause);
    let counts = || counts.iter().filter(|count| is_stored(rules, count));
    let counted = |position: usize| counts().any(|count| count.literals.contains(&position));
    let literals = || clause.body.iter().enumerate();
    let others = || {
        literals()
            .filter(|(position, _)| !counted(*position))
            .map(|(_, literal)| literal)
    };
    let body = || {
        let aggregated = counts().filter_map(|count| unfit(rules, clause.body[count.literals[0]].atom()?));
        aggregated.chain(others().filter_map(|literal| obstacle_in(rules, literal)))
    };
    let computed = |(construct, _): &(Construct, Span)| {
        matches!(
            construct,
            Construct::Draw | Construct::Expression | Construct::Aggregate(_) | Construct::Comparison
        )
    };
    let found = found.or_else(|| body().find(computed));
    let found = found.or_else(|| unfit(rules, &clause.head)).or_else(|| body().next());
    found.map(|found| Unsupported::at(id, found))
}

/// Returns the positions of the literals of a clause that cannot be dense, and of those that share a value with them.
pub(super) fn unsupported_literals(rules: &Rules, clause: &Clause) -> Vec<usize> {
    let bases = rules.bases(clause);
    let values = |position: usize| {
        let variables = clause.body[position].variables();
        variables.filter(|variable| bases[variable.index()] != BaseType::Symbol)
    };
    let counts: Vec<BoundedCount> = bounded_counts(clause);
    let stored = |position: &usize| {
        let mut of_count = counts.iter().filter(|count| count.literals.contains(position));
        of_count.any(|count| {
            let counted = clause.body[count.literals[0]].atom();
            is_stored(rules, count) && counted.is_some_and(|atom| unfit(rules, atom).is_none())
        })
    };
    let is_unsupported = |position: &usize| {
        let literal = &clause.body[*position];
        !stored(position) && obstacle_in(rules, literal).is_some()
    };
    let mut found: Vec<usize> = (0..clause.body.len()).filter(is_unsupported).collect();
    let mut next = 0;
    while let Some(&position) = found.get(next) {
        let shared: Vec<VarId> = values(position).collect();
        let joins = |other: &usize| !found.contains(other) && values(*other).any(|value| shared.contains(&value));
        let joined: Vec<usize> = (0..clause.body.len()).filter(joins).collect();
        found.extend(joined);
        next += 1;
    }
    found.sort_unstable();
    found
}

/// Returns the reason in the clause that the author wrote: for one in a hidden predicate, the aggregate that the
/// predicate belongs to.
fn visible(rules: &Rules, aggregates: &Aggregates, found: Unsupported) -> Unsupported {
    let head = rules.clauses[found.clause.index()].head.predicate;
    let aggregate = aggregates.get(&head).filter(|_| rules.predicates[head.index()].hidden);
    match aggregate {
        Some(&(clause, op, span)) => Unsupported::at(clause, (Construct::Aggregate(op), span)),
        None => found,
    }
}

/// The first aggregate over each predicate.
type Aggregates = HashMap<PredicateId, (ClauseId, AggregateOp, Span)>;

fn aggregates(rules: &Rules) -> Aggregates {
    let mut found = Aggregates::new();
    for (clause, id) in rules.clauses.iter().zip((0..).map(ClauseId)) {
        for literal in &clause.body {
            if let Literal::Aggregate { op, atom, .. } = literal {
                found.entry(atom.predicate).or_insert((id, *op, atom.span));
            }
        }
    }
    found
}

fn obstacle_in(rules: &Rules, literal: &Literal) -> Option<(Construct, Span)> {
    match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => unfit(rules, atom),
        Literal::Negative(atom) => unfit(rules, atom).or_else(|| {
            let bound = atom.terms.iter().any(|term| matches!(term, Term::Variable(_)));
            (!bound).then_some((Construct::NoVariable, atom.span))
        }),
        Literal::Compare {
            op: Comparison::Equal | Comparison::NotEqual,
            left: Term::Variable(_),
            right: Term::Variable(_),
            base: BaseType::Symbol,
            ..
        } => None,
        Literal::Compare {
            left,
            right,
            base: BaseType::Symbol,
            span,
            ..
        } if [left, right].iter().any(|term| matches!(term, Term::Constant(_))) => Some((Construct::Constant, *span)),
        Literal::Compare { span, .. } => Some((Construct::Comparison, *span)),
        Literal::Compute {
            functor: Functor::Choose,
            span,
            ..
        } => Some((Construct::Draw, *span)),
        Literal::Compute { span, .. } => Some((Construct::Expression, *span)),
        Literal::Aggregate { op, atom, .. } => Some((Construct::Aggregate(*op), atom.span)),
    }
}

fn unfit(rules: &Rules, atom: &Atom) -> Option<(Construct, Span)> {
    let shape = unfit_shape(rules, atom.predicate).map(|construct| (construct, atom.span));
    let constant = atom.terms.iter().any(|term| matches!(term, Term::Constant(_)));
    shape.or_else(|| constant.then_some((Construct::Constant, atom.span)))
}

/// Returns the reason why the dense executor cannot store a predicate, if any.
pub(super) fn unfit_shape(rules: &Rules, id: PredicateId) -> Option<Construct> {
    let predicate = &rules.predicates[id.index()];
    if predicate.depends_on_rounds() {
        return Some(Construct::Rounds(id));
    }
    if !(1..=2).contains(&predicate.arity()) {
        return Some(Construct::Columns(id));
    }
    let symbols = predicate.columns.iter().all(|column| column.base == BaseType::Symbol);
    (!symbols).then_some(Construct::NotEntities(id))
}
