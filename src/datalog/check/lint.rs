//! Warnings that need all clauses: clauses that never fire, and clauses that derive nothing new.

use std::hash::{BuildHasher, RandomState};

use crate::codes;
use crate::diag::{Code, Diagnostic, Faults, Span};
use crate::symbol::WordSize;

use crate::check::clauses::{Checked, Clauses};
use crate::check::names::Names;
use crate::check::rules::{Atom, Clause, Literal, Predicate, PredicateId, Term};
use crate::check::strata;
use crate::check::subsets::{Budget, Comparing};
use crate::check::subsumption;
use crate::check::subsumption::{NoConstraints, Pattern};

// --- clauses that never fire

/// Maximum number of clauses shown for one empty predicate.
const MAX_DEAD_SHOWN: usize = 4;

/// Warns of clauses with a positive atom over an empty predicate: one that is not input and has no clause, or only
/// clauses that need it first. Does not report clauses that are dead only because these are.
pub(crate) fn dead(all: &Clauses, names: &Names, faults: &mut Faults) {
    if all.incomplete || !names.complete() {
        return;
    }
    let filled = filled(all, names);
    let mut has_clause = vec![false; names.predicates.len()];
    let mut needs_empty: Vec<Vec<usize>> = vec![Vec::new(); names.predicates.len()];
    for Checked { clause, .. } in &all.clauses {
        let head = clause.head.predicate.index();
        has_clause[head] = true;
        needs_empty[head].extend(
            needed(clause)
                .map(|atom| atom.predicate.index())
                .filter(|&id| !filled[id]),
        );
    }
    let (component, _) = strata::components(&needs_empty);
    // The empty predicates, in source order, each with the clauses that need it.
    let mut causes: indexmap::IndexMap<PredicateId, Vec<&Clause>> = indexmap::IndexMap::new();
    for Checked { clause, .. } in &all.clauses {
        let empty = |atom: &&Atom| !filled[atom.predicate.index()];
        let missing = needed(clause)
            .filter(empty)
            .find(|atom| !has_clause[atom.predicate.index()]);
        let circular = || {
            needed(clause)
                .filter(empty)
                .find(|atom| component[atom.predicate.index()] == component[clause.head.predicate.index()])
        };
        if let Some(atom) = missing.or_else(circular) {
            causes.entry(atom.predicate).or_default().push(clause);
        }
    }
    for (predicate, clauses) in causes {
        let name = &names.predicate(predicate).name;
        let place = |clause: &Clause| {
            let written = clause.body.iter().find_map(|literal| match literal {
                Literal::Positive(atom) if atom.predicate == predicate => Some(atom.span),
                _ => None,
            });
            written.unwrap_or(clause.head.span)
        };
        // A clause with several heads or alternatives counts several times.
        let mut places: Vec<Span> = clauses.into_iter().map(place).collect();
        places.dedup();
        let mut fault = Diagnostic::new(
            codes::DEAD_CLAUSE,
            format!("this clause never fires: `{name}` is always empty"),
        )
        .at(places[0], "");
        for place in places.iter().take(MAX_DEAD_SHOWN).skip(1) {
            fault = fault.also(*place, "nor does this one");
        }
        if places.len() > MAX_DEAD_SHOWN {
            fault = fault.note(match places.len() - MAX_DEAD_SHOWN {
                1 => "nor does 1 other clause".to_owned(),
                more => format!("nor do {more} other clauses"),
            });
        }
        fault = fault.also(names.predicate(predicate).span, format!("`{name}` is declared here"));
        fault = if has_clause[predicate.index()] {
            fault.note(format!("every clause for `{name}` needs a row of `{name}` first"))
        } else {
            fault.help(format!("write a clause or a fact for it, or `.input {name}`"))
        };
        faults.push(fault);
    }
}

/// Returns the atoms that must hold for a clause to fire.
fn needed(clause: &Clause) -> impl Iterator<Item = &Atom> {
    clause.body.iter().filter_map(|literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    })
}

/// Returns, by predicate, whether it may have rows.
fn filled(all: &Clauses, names: &Names) -> Vec<bool> {
    let mut waiting: Vec<usize> = all
        .clauses
        .iter()
        .map(|checked| needed(&checked.clause).count())
        .collect();
    let mut users: Vec<Vec<usize>> = vec![Vec::new(); names.predicates.len()];
    for (index, Checked { clause, .. }) in all.clauses.iter().enumerate() {
        for atom in needed(clause) {
            users[atom.predicate.index()].push(index);
        }
    }
    // The clause that uses a hidden predicate with positive atoms fills it; see `range`.
    let given = |predicate: &Predicate| predicate.input || predicate.hidden;
    let mut filled: Vec<bool> = names.predicates.iter().map(given).collect();
    for (index, Checked { clause, .. }) in all.clauses.iter().enumerate() {
        filled[clause.head.predicate.index()] |= waiting[index] == 0;
    }
    let mut work: Vec<usize> = (0..filled.len()).filter(|&id| filled[id]).collect();
    while let Some(id) = work.pop() {
        for &user in &users[id] {
            waiting[user] -= 1;
            let head = all.clauses[user].clause.head.predicate.index();
            if waiting[user] == 0 && !filled[head] {
                filled[head] = true;
                work.push(head);
            }
        }
    }
    filled
}

// --- clauses that derive nothing new

/// Maximum number of steps for all comparisons of clauses together.
const MAX_STEPS: usize = 10_000_000;

/// Warns of clauses that duplicate another one, or that another one subsumes.
pub(crate) fn redundant(clauses: &[Checked], size: WordSize, faults: &mut Faults) -> Comparing {
    let theory = NoConstraints(size);
    let facts = Facts::new(clauses);
    for (fact, first) in facts.repeated() {
        report(
            codes::DUPLICATE_CLAUSE,
            clauses[fact].clause.span,
            clauses[first].clause.span,
            faults,
        );
    }
    let mut by_head: indexmap::IndexMap<PredicateId, Vec<&Clause>> = indexmap::IndexMap::new();
    for Checked { clause, sound, .. } in clauses {
        let aggregates = (clause.body.iter()).any(|literal| matches!(literal, Literal::Aggregate { .. }));
        if *sound && !aggregates && !clause.body.is_empty() {
            if let Some(fact) = facts.find(&clause.head) {
                report(codes::SUBSUMED_CLAUSE, clause.span, clauses[fact].clause.span, faults);
            } else {
                by_head.entry(clause.head.predicate).or_default().push(clause);
            }
        }
    }
    let mut budget = Budget::new(MAX_STEPS);
    for group in by_head.into_values() {
        let patterns: Vec<Pattern> = (group.iter()).map(|clause| Pattern::new(clause, &theory)).collect();
        // Ignore the alternatives and heads of one source clause, which the checker split.
        let counts = |one: usize, other: usize| group[one].span != group[other].span;
        for found in subsumption::redundant(&patterns, &theory, &mut budget, &counts) {
            let code = match found.copy {
                true => codes::DUPLICATE_CLAUSE,
                false => codes::SUBSUMED_CLAUSE,
            };
            report(code, group[found.clause].span, group[found.by].span, faults);
        }
    }
    budget.spent()
}

/// The sound facts of a program, sorted by a hash of their rows. There may be millions, so each takes few bytes.
struct Facts<'c> {
    clauses: &'c [Checked],
    hasher: RandomState,
    /// The hash and the position of each fact.
    sorted: Vec<(u64, usize)>,
}

impl<'c> Facts<'c> {
    fn new(clauses: &'c [Checked]) -> Self {
        let hasher = RandomState::new();
        let is_fact = |checked: &&(usize, &Checked)| checked.1.sound && checked.1.clause.body.is_empty();
        let facts = clauses.iter().enumerate();
        let mut sorted: Vec<(u64, usize)> = facts
            .filter(|one| is_fact(&one))
            .map(|(at, checked)| (hasher.hash_one(row(&checked.clause.head)), at))
            .collect();
        sorted.sort_unstable();
        Facts {
            clauses,
            hasher,
            sorted,
        }
    }

    /// Returns the facts that repeat an earlier one, in source order, each with the first such fact.
    fn repeated(&self) -> Vec<(usize, usize)> {
        let mut repeated = Vec::new();
        for group in self.sorted.chunk_by(|one, other| one.0 == other.0) {
            let mut firsts: Vec<usize> = Vec::new();
            for &(_, fact) in group.iter().filter(|_| group.len() > 1) {
                let is_same = |first: &&usize| self.row(**first) == self.row(fact);
                match firsts.iter().find(is_same) {
                    Some(&first) => repeated.push((fact, first)),
                    None => firsts.push(fact),
                }
            }
        }
        repeated.sort_unstable();
        repeated
    }

    /// Returns the first fact with the row of this head.
    fn find(&self, head: &Atom) -> Option<usize> {
        let hash = self.hasher.hash_one(row(head));
        let start = self.sorted.partition_point(|&(other, _)| other < hash);
        let group = self.sorted[start..].iter().take_while(|&&(other, _)| other == hash);
        group.map(|&(_, fact)| fact).find(|&fact| self.row(fact) == row(head))
    }

    fn row(&self, fact: usize) -> (PredicateId, &[Term]) {
        row(&self.clauses[fact].clause.head)
    }
}

fn row(head: &Atom) -> (PredicateId, &[Term]) {
    (head.predicate, &head.terms)
}

fn report(code: Code, span: Span, other: Span, faults: &mut Faults) {
    let (message, label) = match code {
        codes::DUPLICATE_CLAUSE => (
            "this clause is a duplicate",
            "the same clause, up to variable names and order",
        ),
        _ => (
            "another clause derives everything that this one does",
            "this clause derives the same rows",
        ),
    };
    faults.push(
        Diagnostic::new(code, message)
            .at(span, "")
            .also(other, label)
            .remove(span),
    );
}
