//! Finds the columns for symbols that may be no entities: values of quantities, constants, and what follows from them.
//!
//! ```text
//! .decl Vertical(h: symbol)
//! Vertical("Up"). Vertical("Down").
//! Slow(X) :- Heading(X, h), Vertical(h).
//! ```
//!
//! Sets of bits are sets of entities. A predicate over anything else has none, so the dense executor cannot store it.

use crate::check::{Clause, Literal, PredicateId, Rules, Term};
use crate::syntax::ast::Comparison;

/// Returns for each column of each predicate whether it may hold symbols that are no entities. `entities` returns for a
/// predicate whose last column is a value the number of columns before it.
///
/// A constant in a column of a declared type, such as `agent`, counts as an entity.
pub(super) fn value_columns(rules: &Rules, entities: impl Fn(PredicateId) -> Option<usize>) -> Vec<Vec<bool>> {
    let predicates = (0..).map(PredicateId).zip(&rules.predicates);
    let mut values: Vec<Vec<bool>> = predicates
        .map(|(id, predicate)| {
            let value = entities(id);
            (0..predicate.arity()).map(|column| value == Some(column)).collect()
        })
        .collect();
    let mut changed = true;
    while changed {
        changed = false;
        for clause in &rules.clauses {
            changed |= add_head(rules, clause, &mut values);
        }
        for past in &rules.pasts {
            let of_operand = values[past.operand.index()].clone();
            let of_past = &mut values[past.predicate.index()];
            changed |= *of_past != of_operand;
            *of_past = of_operand;
        }
    }
    values
}

/// Adds the columns of a head that may hold values. Returns whether there are new ones.
fn add_head(rules: &Rules, clause: &Clause, values: &mut [Vec<bool>]) -> bool {
    let mut origins = vec![Origin::Entity; clause.variables.len()];
    for literal in &clause.body {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => {
                for (term, is_value) in atom.terms.iter().zip(&values[atom.predicate.index()]) {
                    if let (Some(variable), true) = (term.variable(), is_value) {
                        origins[variable.index()] = Origin::Value;
                    }
                }
            }
            Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => {
                to.variable()
                    .into_iter()
                    .for_each(|to| origins[to.index()] = Origin::Value);
            }
            Literal::Negative(_) | Literal::Compare { .. } => {}
        }
    }
    // `x = y` gives one the value of the other; a chain of them ends after as many rounds as there are literals.
    for _ in &clause.body {
        for literal in &clause.body {
            if let Literal::Compare {
                op: Comparison::Equal,
                left,
                right,
                ..
            } = literal
            {
                let both = Origin::of(left, &origins).max(Origin::of(right, &origins));
                for variable in [left, right].into_iter().filter_map(Term::variable) {
                    origins[variable.index()] = both;
                }
            }
        }
    }
    let head = clause.head.predicate.index();
    let mut changed = false;
    for (column, term) in clause.head.terms.iter().enumerate() {
        let ty = &rules.types[rules.predicates[head].columns[column].ty.0 as usize];
        let is_value = match Origin::of(term, &origins) {
            Origin::Entity => false,
            Origin::Constant => ty.parent.is_none() && ty.members.is_empty(),
            Origin::Value => true,
        };
        changed |= is_value && !values[head][column];
        values[head][column] |= is_value;
    }
    changed
}

/// Where the values of a term may come from; a later one includes those before it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Origin {
    Entity,
    Constant,
    Value,
}

impl Origin {
    fn of(term: &Term, origins: &[Origin]) -> Origin {
        match term {
            Term::Variable(variable) => origins[variable.index()],
            Term::Constant(_) => Origin::Constant,
            Term::Wildcard => Origin::Entity,
        }
    }
}
