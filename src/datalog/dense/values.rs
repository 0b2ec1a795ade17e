//! Finds the columns for symbols that may be no entities: values of quantities, constants, and what follows from them.
//!
//! ```text
//! .decl Vertical(h: symbol)
//! Vertical("Up"). Vertical("Down").
//! Slow(X) :- Heading(X, h), Vertical(h).
//! ```
//!
//! Sets of bits are sets of entities. A predicate over anything else has none, so the dense executor cannot store it.

use crate::check::{Atom, Clause, Literal, PredicateId, Rules, Term};
use crate::syntax::ast::BaseType;

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
    let mut holds = vec![false; clause.variables.len()];
    for literal in &clause.body {
        match literal {
            Literal::Positive(atom) | Literal::Guard(atom) => mark(atom, values, &mut holds),
            Literal::Compute { to, .. } | Literal::Aggregate { to, .. } => {
                to.variable().into_iter().for_each(|to| holds[to.index()] = true);
            }
            Literal::Negative(_) | Literal::Compare { .. } => {}
        }
    }
    // `x = y` gives one the value of the other; a chain of them ends after as many rounds as there are literals.
    for _ in &clause.body {
        for literal in &clause.body {
            let Literal::Compare { left, right, .. } = literal else {
                continue;
            };
            let is_value = [left, right].map(|term| term.variable().is_none_or(|of| holds[of.index()]));
            if is_value.contains(&true) {
                for of in [left, right].into_iter().filter_map(Term::variable) {
                    holds[of.index()] = true;
                }
            }
        }
    }
    let head = &rules.predicates[clause.head.predicate.index()];
    let mut changed = false;
    for (column, term) in clause.head.terms.iter().enumerate() {
        let ty = &rules.types[head.columns[column].ty.0 as usize];
        let is_value = match term {
            Term::Variable(variable) => holds[variable.index()],
            Term::Constant(_) => ty.parent.is_none() && ty.members.is_empty(),
            Term::Wildcard => false,
        };
        let known = &mut values[clause.head.predicate.index()][column];
        changed |= is_value && !*known && ty.base == BaseType::Symbol;
        *known |= is_value;
    }
    changed
}

/// Marks the variables of an atom in columns that may hold values.
fn mark(atom: &Atom, values: &[Vec<bool>], holds: &mut [bool]) {
    for (term, is_value) in atom.terms.iter().zip(&values[atom.predicate.index()]) {
        if let (Some(variable), true) = (term.variable(), is_value) {
            holds[variable.index()] = true;
        }
    }
}
