//! Bounds on counts: `n = count : { P(x, _) }` with comparisons of `n` and constants.

use crate::check::{Atom, Clause, Literal, PredicateId, Rules, Term, VarId};
use crate::dense::program::{Argument, Bounds};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::AggregateOp;

impl Bounds {
    const ALL: Bounds = Bounds { low: 0, high: u32::MAX };

    /// Returns the counts for which a comparison with a constant, on its right, holds. `None` for a comparison that is
    /// not of numbers.
    fn of(op: Comparison, constant: i32) -> Option<Bounds> {
        // A count is at least 0, so a negative bound says all or nothing.
        let at = |constant: i64| u32::try_from(constant.max(0)).unwrap_or(u32::MAX);
        let constant = i64::from(constant);
        let to = |last: i64| match last < 0 {
            true => Bounds { low: 1, high: 0 },
            false => Bounds { low: 0, high: at(last) },
        };
        let from = |first: i64| Bounds {
            low: at(first),
            high: u32::MAX,
        };
        Some(match op {
            Comparison::Less => to(constant - 1),
            Comparison::LessEqual => to(constant),
            Comparison::Greater => from(constant + 1),
            Comparison::GreaterEqual => from(constant),
            Comparison::Equal | Comparison::NotEqual if constant < 0 => Bounds { low: 1, high: 0 },
            Comparison::Equal | Comparison::NotEqual => Bounds {
                low: at(constant),
                high: at(constant),
            },
            Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => return None,
        })
    }
}

/// A count of a body with the bounds of its result.
pub(super) struct BoundedCount {
    /// The positions of the aggregate and of the comparisons.
    pub literals: Vec<usize>,
    /// The predicate whose rows it counts.
    pub predicate: PredicateId,
    /// The entity in these rows.
    pub entity: VarId,
    /// The column of the entity.
    pub column: Argument,
    /// The bounds, and whether the count lies in them.
    pub bounds: Vec<(Bounds, bool)>,
}

/// Returns the counts of a body that are only compared with constants, each of the rows of one entity.
pub(super) fn bounded_counts(clause: &Clause) -> Vec<BoundedCount> {
    let aggregates = clause.body.iter().enumerate();
    aggregates
        .filter_map(|(position, literal)| bounded(clause, position, literal))
        .collect()
}

fn bounded(clause: &Clause, position: usize, literal: &Literal) -> Option<BoundedCount> {
    let Literal::Aggregate {
        to: Term::Variable(count),
        op: AggregateOp::Count,
        atom: Atom { predicate, terms, .. },
        ..
    } = literal
    else {
        return None;
    };
    let (entity, column) = match *terms.as_slice() {
        [Term::Variable(entity), Term::Wildcard] => (entity, Argument::First),
        [Term::Wildcard, Term::Variable(entity)] => (entity, Argument::Second),
        _ => return None,
    };
    let is_count = |term: &Term| term.variable() == Some(*count);
    if entity == *count || clause.head.terms.iter().any(is_count) {
        return None;
    }
    let mut found = BoundedCount {
        literals: vec![position],
        predicate: *predicate,
        entity,
        column,
        bounds: vec![(Bounds::ALL, true)],
    };
    for (other, literal) in clause.body.iter().enumerate() {
        if other == position || !literal.terms().any(is_count) {
            continue;
        }
        let Literal::Compare {
            op,
            left,
            right,
            base: BaseType::Number,
            ..
        } = literal
        else {
            return None;
        };
        let (op, constant) = match (left, right) {
            (Term::Variable(_), Term::Constant(constant)) => (*op, constant),
            (Term::Constant(constant), Term::Variable(_)) => (op.mirrored(), constant),
            _ => return None,
        };
        let bounds = Bounds::of(op, constant.as_number())?;
        match op {
            Comparison::NotEqual => found.bounds.push((bounds, false)),
            _ => {
                let (all, _) = &mut found.bounds[0];
                *all = Bounds {
                    low: all.low.max(bounds.low),
                    high: all.high.min(bounds.high),
                };
            }
        }
        found.literals.push(other);
    }
    Some(found)
}

/// Returns whether the executor has the rows that a count reads: a predicate without parameters.
pub(super) fn is_stored(rules: &Rules, count: &BoundedCount) -> bool {
    !rules.is_correlated(count.predicate)
}
