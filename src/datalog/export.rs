//! Checked rules for other engines: plain Soufflé, and SQL for DuckDB.
//!
//! Checked rules have no components, macros, includes, nested expressions or alternatives any more, so a plain program
//! is a listing of them. What another engine cannot express is an error with its place.
// Decision: docs/decisions/analysis.md#d088

mod names;
mod souffle;
mod sql;

pub use souffle::souffle;
pub use sql::sql;

use crate::check::{Clause, Literal, Predicate, PredicateId, Rules};
use crate::codes;
use crate::diag::{Diagnostic, Faults, Span};
use crate::symbol::WordSize;
use crate::syntax::ast::BaseType;
use crate::syntax::functor::{Functor, Shape};

/// Returns the error for what a language lacks.
fn lacking(language: &str, what: &str, span: Span) -> Diagnostic {
    let message = format!("{language} cannot express {what}");
    Diagnostic::new(codes::UNSUPPORTED, message).at(span, "")
}

/// Reports the parts of rules that neither language has as this engine means them.
fn check(rules: &Rules, language: &str, faults: &mut Faults) {
    let place = |id: PredicateId| rules.predicates[id.index()].span;
    for past in &rules.pasts {
        faults.push(lacking(language, "temporal operators", place(past.predicate)));
    }
    if let Some(id) = rules.chance {
        faults.push(lacking(language, "clauses with probabilities", place(id)));
    }
    for predicate in &rules.predicates {
        let Predicate { name, span, .. } = predicate;
        if predicate.columns.iter().any(|column| column.base == BaseType::Record) {
            faults.push(lacking(language, &format!("the records of `{name}`"), *span));
        }
        if !predicate.choices.is_empty() {
            faults.push(lacking(language, &format!("which row `{name}` chooses"), *span));
        }
        if predicate.subsumption.is_some() {
            faults.push(lacking(language, &format!("the subsumption of `{name}`"), *span));
        }
        if predicate.numbering.is_some() {
            faults.push(lacking(language, "`autoinc()`", *span));
        }
        if predicate.size_limit.is_some() {
            faults.push(lacking(language, &format!("the `.limitsize` of `{name}`"), *span));
        }
        if predicate.parameters > 0 {
            faults.push(lacking(
                language,
                "an aggregate whose body depends on variables outside",
                *span,
            ));
        }
    }
    for clause in &rules.clauses {
        for literal in &clause.body {
            if let Literal::Compute { functor, span, .. } = literal
                && !is_portable(*functor)
            {
                faults.push(lacking(language, &format!("`{}`", functor.name()), *span));
            }
        }
    }
}

/// Returns whether other engines have the functor with the same meaning.
fn is_portable(functor: Functor) -> bool {
    !matches!(
        functor,
        Functor::Cast
            | Functor::Range
            | Functor::Choose
            | Functor::Pack
            | Functor::Unpack
            | Functor::Call
            | Functor::Counter
    )
}

/// Returns the base type of an argument of a functor that is applied to arguments of the base type `base`.
fn argument_base(functor: Functor, base: BaseType, at: usize) -> BaseType {
    match functor.shape() {
        Shape::Fixed(arguments, _) => arguments.get(at).copied().unwrap_or(base),
        _ => base,
    }
}

/// Refuses programs with numbers of 64 bits.
fn refuse_64_bits(rules: &Rules) -> Result<(), Vec<Diagnostic>> {
    match rules.symbols.word_size() {
        WordSize::Bits32 => Ok(()),
        WordSize::Bits64 => {
            let message = "programs with numbers of 64 bits are not exported";
            Err(vec![
                Diagnostic::new(codes::UNSUPPORTED, message).help("omit `--word-size 64`"),
            ])
        }
    }
}

/// Returns the predicates that a clause reads, with the places.
fn reads(clause: &Clause) -> impl Iterator<Item = (PredicateId, Span)> {
    clause
        .body
        .iter()
        .filter_map(|literal| literal.atom().map(|atom| (atom.predicate, atom.span)))
}
