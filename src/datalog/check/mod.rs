//! The checker: from syntax trees to checked [`Rules`].
//!
//! Each stage has a file or folder. No stage stops at the first fault.
//!
//! - `chance`: replaces probabilities of heads by literals that draw.
//! - `temporal`: replaces temporal operators by atoms over hidden predicates.
//! - `inline`: replaces inline predicates by their bodies.
//! - `names`: declares types and predicates.
//! - `clause`: splits disjunctions and multiple heads into clauses.
//! - `witness`: rewrites `min` and `max` with witness variables.
//! - `body`: checks one clause: names, expressions, types and safety. Defines hidden predicates for aggregates and
//!   ranges.
//! - `scope`: adds the guards of `.scope`.
//! - `constraints`: checks integrity constraints.
//! - `strata`: finds the order of evaluation.
//! - `lint`: warns of dead and redundant clauses.
//! - `subsumption`: decides whether one clause derives everything that another one derives.
//!
//! This module does not know how rules are evaluated.

mod body;
mod chance;
pub(crate) mod clause;
mod clauses;
mod constraints;
mod counter;
mod dominance;
mod functors;
pub(crate) mod inline;
mod lint;
pub(crate) mod names;
mod rules;
mod scope;
pub(crate) mod strata;
mod subsets;
pub(crate) mod subsumption;
pub(crate) mod temporal;
pub(crate) mod witness;

use crate::codes;
use crate::diag::{Diagnostic, Faults};
use crate::symbol::{Symbols, WordSize};
use crate::syntax::ast;
use crate::syntax::include::Offered;
use crate::syntax::packed::FactRuns;
use std::borrow::Cow;

pub use chance::{Draw, drawn_probabilities};
pub use functors::{FunctorBatch, FunctorError};
pub use rules::{
    Atom, Clause, ClauseId, Column, Constraint, DeclaredConstraint, Directive, Function, Literal, Numbering, Past,
    PastOperator, Predicate, PredicateId, RecordShape, RowEncoding, RowFormat, RowPlace, Rules, Stratum, Term, Type,
    TypeId, UserFunctor, VarId, shapes,
};
pub(crate) use rules::{Field, bind_all};
#[cfg(feature = "optimizer")]
pub(crate) use subsets::Budget;
pub use subsets::Comparing;
#[cfg(test)]
pub(crate) use subsets::random_clauses;

/// Returns rules with the strata of their clauses, which another component has changed.
pub(crate) fn restratified(mut rules: Rules) -> Rules {
    rules.strata = strata::order(&rules.predicates, &rules.clauses);
    rules
}

/// Whether rules may derive `.input` predicates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InputPolicy {
    /// Only inserted rows and the facts of the source hold. A rule for an `.input` predicate is an error.
    #[default]
    Fixed,
    /// As in Soufflé, rules may derive further rows of an `.input` predicate. The checker warns of such rules.
    Extensible,
}

/// What the checker permits.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Policy {
    /// Whether rules may derive `.input` predicates.
    pub inputs: InputPolicy,
    /// The size of numbers.
    pub word_size: WordSize,
    /// Whether a head takes values of any type with the base type of its column, as Soufflé does with `--legacy`.
    pub legacy: bool,
}

/// What is known of declarations outside of the checked items.
#[derive(Clone, Copy)]
pub(crate) struct Elsewhere<'a> {
    /// Whether there are none. If not, the checker reports no unknown names.
    pub complete: bool,
    /// The names that built-in files declare, for suggestions.
    pub offered: &'a Offered,
}

/// Refuses draws and temporal operators in a program with numbers of 64 bits, at the first clause with each.
fn refuse_64_bits(items: &[ast::Item], faults: &mut Faults) {
    let is_drawn = |item: &ast::Item| matches!(item, ast::Item::Clause(clause) if !clause.probabilities.is_empty());
    let first = [
        (items.iter().find(|item| is_drawn(item)), "draws"),
        (items.iter().find(|item| temporal::in_item(item)), "temporal operators"),
    ];
    for (item, what) in first {
        let Some(ast::Item::Clause(clause)) = item else {
            continue;
        };
        let message = format!("programs with numbers of 64 bits have no {what}");
        let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(clause.place.0, "");
        faults.push(fault.help("omit `--word-size 64`"));
    }
}

/// Checks all items and interns their constants in `symbols`. The rules are `None` if there is an error. Owned items
/// and facts are dropped as soon as they are checked. If a predicate is inline, there must be no packed facts.
pub(crate) fn check(
    (written, facts): (Cow<'_, [ast::Item]>, Cow<'_, FactRuns>),
    elsewhere: Elsewhere<'_>,
    policy: Policy,
    symbols: Symbols,
    faults: &mut Faults,
) -> (Option<Rules>, Comparing) {
    let written = dominance::lower(written, faults);
    let drawn = chance::lower(&written, faults);
    let without_chance = drawn.as_deref().unwrap_or(&written);
    let lowered = temporal::lower(without_chance, faults);
    if policy.word_size == WordSize::Bits64 {
        refuse_64_bits(&written, faults);
    }
    let without_time = lowered.as_ref().map_or(without_chance, |lowered| &lowered.items);
    let replaced = inline::replace(without_time, faults);
    let syntax_is_good = !faults.failed();
    let items = replaced.as_deref().unwrap_or(without_time);
    let mut names = names::declare(items, elsewhere.complete, policy, faults);
    if let Some(lowered) = &lowered {
        lowered.hide(&mut names);
    }
    let chance = chance::hide(&mut names);
    dominance::hide(&mut names);
    let mut checked = clause::check((items, &facts), &mut names, symbols, faults);
    dominance::edges(&names, &mut checked);
    let constraints = constraints::check(items, &mut names, faults);
    let pasts = lowered.as_ref().map_or_else(Vec::new, |lowered| lowered.pasts(&names));
    drop((replaced, lowered, drawn, written, facts));
    names.report_unknown(elsewhere.offered, faults);
    strata::check(&checked.edges, &names, faults);
    let mut compared = Comparing::default();
    // A clause that did not parse could make a dead clause live.
    if syntax_is_good {
        lint::dead(&checked, &names, faults);
        compared = lint::redundant(&checked.clauses, policy.word_size, faults);
    }
    if faults.failed() {
        return (None, compared);
    }
    let names::Names {
        types,
        predicates,
        functors,
        ..
    } = names;
    let mut predicates = predicates;
    let mut clauses: Vec<Clause> = checked.clauses.into_iter().map(|clause| clause.clause).collect();
    clauses.extend(checked.hidden);
    counter::finish(&mut predicates, &mut clauses);
    let rules = Rules {
        strata: strata::order(&predicates, &clauses),
        types,
        predicates,
        clauses,
        symbols: checked.symbols,
        constraints,
        functions: Vec::new(),
        functors: functors.into(),
        pasts,
        chance,
    };
    (Some(rules), compared)
}
