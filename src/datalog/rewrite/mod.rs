//! Rewrites checked rules so that evaluation computes fewer rows: [`unfold`] and [`demand`].
//!
//! The rewritten rules derive the same rows of `.output` and `.printsize` predicates. They have other clauses, so use
//! them where only these rows matter: `query` does, unless it explains a fact. A rewritten clause keeps the place of
//! the clause that it comes from.
// Decision: docs/decisions/language.md#d037

mod demand;
mod unfold;

pub use demand::{demand, would_restrict};
pub use unfold::unfold;

use crate::check::{PredicateId, Rules};

/// Returns whether the rows of a predicate are visible outside of the rules: to `.input`, `.output`, `.printsize` or a
/// constraint.
fn is_visible(rules: &Rules, predicate: PredicateId) -> bool {
    let declared = &rules.predicates[predicate.index()];
    let named = rules.constraints.iter().any(|declared| {
        let in_domain = declared.domain.iter().any(|(other, _)| *other == predicate);
        in_domain || declared.constraint.predicates().any(|named| named == predicate)
    });
    declared.input || declared.output || declared.printsize || declared.edb.is_some() || named
}
