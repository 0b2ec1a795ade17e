//! From syntax trees to checked [`Rules`].
//!
//! The stages, each in its own file or folder: `inline` (predicates that stand for their bodies), `names` (types and predicates),
//! `clause` (alternatives and several heads), `witness` (the rows of an extreme value), `body` (one clause: names, expressions, types,
//! safety), `aggregate` and `range` (hidden predicates for these), `scope` (guards), `constraints` (integrity constraints), `strata` (the
//! order of evaluation), `lint` (warnings that need all clauses), `subsumption` (which clause derives all that another one does). None stops at the first fault.
//!
//! This room does not know how rules are evaluated.

mod aggregate;
mod body;
pub(crate) mod clause;
mod constraints;
pub(crate) mod inline;
mod lint;
pub(crate) mod names;
mod range;
mod rules;
mod scope;
mod strata;
mod subsets;
pub(crate) mod subsumption;
pub(crate) mod witness;

use crate::datalog::syntax::ast;
use crate::diag::Faults;
use crate::symbol::Symbols;

pub use rules::{
    Atom, Clause, ClauseId, Column, Constraint, DeclaredConstraint, Directive, Literal, RelId, Relation, RowFormat,
    RowPlace, Rules, Stratum, Term, Type, TypeId, VarId,
};
#[cfg(feature = "optimizer")]
pub(crate) use subsets::Budget;
pub use subsets::Comparing;
#[cfg(test)]
pub(crate) use subsets::random_clauses;

/// What holds of a predicate that is `.input`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Edb {
    /// The rows that are given, and the facts of the text: a rule for it is an error.
    #[default]
    Fixed,
    /// Besides, what rules derive, as in Soufflé: a rule for it is told by a warning.
    Extensible,
}

/// Checks all items. The constants' texts are added to `symbols`. There are no rules if there is an error.
pub(crate) fn check(
    items: &[ast::Item],
    complete: bool,
    inputs: Edb,
    symbols: Symbols,
    faults: &mut Faults,
) -> (Option<Rules>, Comparing) {
    let replaced = inline::replace(items, faults);
    let syntax_is_good = !faults.failed();
    let items = replaced.as_deref().unwrap_or(items);
    let mut names = names::declare(items, complete, inputs, faults);
    let checked = clause::check(items, &mut names, symbols, faults);
    let constraints = constraints::check(items, &mut names, faults);
    names.report_unknown(faults);
    strata::check(&checked.edges, &names, faults);
    let mut compared = Comparing::default();
    // What could not be read might make a clause live, or tell two clauses apart.
    if syntax_is_good {
        lint::dead(&checked, &names, faults);
        compared = lint::redundant(&checked.clauses, faults);
    }
    if faults.failed() {
        return (None, compared);
    }
    let names::Names { types, relations, .. } = names;
    let clauses: Vec<Clause> = (checked.clauses.into_iter().map(|clause| clause.clause))
        .chain(checked.hidden)
        .collect();
    let rules = Rules {
        strata: strata::order(&relations, &clauses),
        types,
        relations,
        clauses,
        symbols: checked.symbols,
        constraints,
    };
    (Some(rules), compared)
}
