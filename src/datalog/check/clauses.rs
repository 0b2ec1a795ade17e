//! Checked clauses: the data that the stages of the checker exchange.

use crate::check::rules::{Clause, Literal, PredicateId, Term, TypeId, VarId};
use crate::diag::Span;
use crate::symbol::Symbols;
use crate::syntax::ast::BaseType;

/// A dependency of a head on a predicate of its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Edge {
    pub from: PredicateId,
    pub to: PredicateId,
    pub kind: EdgeKind,
    /// The atom in the body; for a guard, the `.scope`.
    pub span: Span,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum EdgeKind {
    Needs,
    Negates,
    Aggregates,
}

/// A clause with the facts that checks between clauses need.
#[derive(Debug)]
pub(crate) struct Checked {
    pub clause: Clause,
    /// The base types of its variables, as far as known.
    pub bases: Vec<Option<BaseType>>,
    /// Whether the clause is free of errors.
    pub sound: bool,
}

/// All clauses of a program.
#[derive(Default)]
pub(crate) struct Clauses {
    pub clauses: Vec<Checked>,
    /// The clauses of the hidden predicates.
    pub hidden: Vec<Clause>,
    /// The dependencies, also those of faulty clauses. Hidden predicates do not occur in them.
    pub edges: Vec<Edge>,
    /// The symbols of all constants.
    pub symbols: Symbols,
    /// Whether the checker dropped a clause because of an unknown name or a limit.
    pub incomplete: bool,
}

/// A variable of a checked clause.
#[derive(Clone)]
pub(crate) struct Known {
    pub name: String,
    pub ty: VariableType,
    pub first: Span,
    /// The number of occurrences.
    pub count: usize,
    /// Whether the variable represents the value of an expression.
    pub hidden: bool,
}

/// Returns whether a name looks like a constant without its quotes, for example `Car_2`: a word with a capital letter
/// and, after an underscore, a number.
pub(crate) fn reads_as_constant(name: &str) -> bool {
    name.rsplit_once('_').is_some_and(|(word, number)| {
        word.starts_with(|c: char| c.is_ascii_uppercase())
            && word.len() > 1
            && !number.is_empty()
            && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

/// The type of a variable as far as known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VariableType {
    Unknown,
    /// It only equals constants and expressions of this base type, so it fits every subtype of it.
    Base(BaseType),
    Type(TypeId),
}

/// The scope in force.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guard {
    pub predicate: PredicateId,
    pub ego: TypeId,
    pub seen: TypeId,
    /// The place of the `.scope`.
    pub span: Span,
}

/// Renumbers the variables that occur, keeping their order, and returns them.
pub(crate) fn renumber<'t>(
    variables: Vec<Known>,
    heads: impl Iterator<Item = &'t mut Vec<Term>>,
    literals: &'t mut [Literal],
) -> Vec<Known> {
    let mut terms: Vec<&mut Term> = heads
        .flatten()
        .chain(literals.iter_mut().flat_map(Literal::terms_mut))
        .collect();
    let mut used = vec![false; variables.len()];
    for term in &terms {
        if let Term::Variable(id) = **term {
            used[id.index()] = true;
        }
    }
    let mut next = 0;
    let numbers: Vec<u32> = (used.iter())
        .map(|&used| {
            let number = next;
            next += u32::from(used);
            number
        })
        .collect();
    for term in &mut terms {
        if let Term::Variable(id) = &mut **term {
            *id = VarId(numbers[id.index()]);
        }
    }
    variables
        .into_iter()
        .zip(used)
        .filter(|(_, used)| *used)
        .map(|(known, _)| known)
        .collect()
}
