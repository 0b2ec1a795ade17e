//! Inline predicates that say nothing of themselves.
//!
//! ```text
//! .decl less(x: number, y: number) inline
//! less(x, y) :- x < y.
//! A(x) :- B(x), B(y), less(x, y + 1).         becomes   A(x) :- B(x), B(y), x < y + 1.
//! ```
//!
//! An inline predicate is like any other if its clauses bind their variables. One with a clause that does not is no set of
//! rows: each atom over it is replaced by what it stands for. This is done on the syntax, before names are looked up.

use std::collections::{HashMap, HashSet};

use crate::diag::{Code, Diagnostic};

use super::ast::{Atom, Clause, Item, Literal, Term, TermKind};
use super::clause::names_in;
use super::faults::Faults;
use super::parser::negate;
use super::rules::Comparison;
use super::witness::{Names, bound_names, renamed, renamed_term};

/// Inline predicates may use each other so deeply.
const MAX_DEPTH: usize = 16;

/// One clause may be made this much longer by it.
const MAX_GROWTH: usize = 1024;

/// What an inline predicate stands for: head and body of its clauses.
type Meanings<'c> = HashMap<&'c str, Vec<(&'c Atom, &'c [Literal])>>;

/// The items with such predicates replaced; `None` if there are none.
pub(super) fn replace(items: &[Item], faults: &mut Faults) -> Option<Vec<Item>> {
    let inline: HashSet<&str> = (items.iter())
        .filter_map(|item| match item {
            Item::Decl(decl) if decl.qualifiers.iter().any(|word| word.text == "inline") => Some(&decl.names),
            _ => None,
        })
        .flatten()
        .map(|name| name.text.as_str())
        .collect();
    if inline.is_empty() {
        return None;
    }
    let clauses = || {
        items.iter().filter_map(|item| match item {
            Item::Clause(clause) => Some(clause),
            _ => None,
        })
    };
    let mut meanings: Meanings<'_> = HashMap::new();
    let mut open: HashSet<&str> = HashSet::new();
    for clause in clauses() {
        for head in clause
            .heads
            .iter()
            .filter(|head| inline.contains(head.predicate.text.as_str()))
        {
            let name = head.predicate.text.as_str();
            meanings.entry(name).or_default().push((head, &clause.body));
            let bound = bound_names(&clause.body.iter().collect::<Vec<_>>());
            let is_open =
                |term: &Term| matches!(&term.kind, TermKind::Variable(name) if !bound.contains(name.as_str()));
            let simple = !clause.body.iter().any(|literal| matches!(literal, Literal::Any(_)));
            if simple && !clause.body.is_empty() && head.terms.iter().any(is_open) {
                open.insert(name);
            }
        }
    }
    meanings.retain(|name, _| open.contains(name));
    if meanings.is_empty() {
        return None;
    }
    let mut inliner = Inliner {
        meanings: &meanings,
        fresh: 0,
        growth: 0,
        faults,
    };
    let mut out = Vec::with_capacity(items.len());
    for item in items {
        match item {
            Item::Clause(clause) => {
                let heads: Vec<Atom> = (clause.heads.iter())
                    .filter(|head| !meanings.contains_key(head.predicate.text.as_str()))
                    .cloned()
                    .collect();
                if !heads.is_empty() {
                    inliner.growth = 0;
                    let body = inliner.all(&clause.body, 0);
                    out.push(Item::Clause(Clause {
                        heads,
                        body,
                        ..clause.clone()
                    }));
                }
            }
            Item::Decl(decl) => {
                let mut decl = decl.clone();
                // Here the word has an effect.
                if decl.names.iter().all(|name| meanings.contains_key(name.text.as_str())) {
                    decl.qualifiers.retain(|word| word.text != "inline");
                }
                out.push(Item::Decl(decl));
            }
            other => out.push(other.clone()),
        }
    }
    Some(out)
}

struct Inliner<'a, 'c> {
    meanings: &'a Meanings<'c>,
    fresh: usize,
    growth: usize,
    faults: &'a mut Faults,
}

impl Inliner<'_, '_> {
    fn all(&mut self, literals: &[Literal], depth: usize) -> Vec<Literal> {
        literals.iter().flat_map(|literal| self.one(literal, depth)).collect()
    }

    fn one(&mut self, literal: &Literal, depth: usize) -> Vec<Literal> {
        match literal {
            Literal::Any(alternatives) => {
                vec![Literal::Any(
                    alternatives
                        .iter()
                        .map(|alternative| self.all(alternative, depth))
                        .collect(),
                )]
            }
            Literal::Compare { op, left, right, place } => {
                let [left, right] = [left, right].map(|side| self.term(side, depth));
                vec![Literal::Compare {
                    op: *op,
                    left,
                    right,
                    place: *place,
                }]
            }
            Literal::Atom { negated, atom } => {
                let Some(meanings) = self.meanings.get(atom.predicate.text.as_str()) else {
                    return vec![literal.clone()];
                };
                self.growth += meanings.iter().map(|(_, body)| 1 + body.len()).sum::<usize>();
                if depth >= MAX_DEPTH || self.growth > MAX_GROWTH {
                    return self.refuse(atom, "is inline and used too deeply or by itself");
                }
                let mut alternatives = Vec::new();
                for &(head, body) in meanings {
                    if head.terms.len() != atom.terms.len() {
                        return vec![literal.clone()];
                    }
                    let Some(alternative) = self.meaning(atom, head, body, *negated) else {
                        return self.refuse(atom, "is inline, has variables of its own, and cannot be negated");
                    };
                    alternatives.push(self.all(&alternative, depth + 1));
                }
                if *negated {
                    return alternatives.into_iter().flat_map(negate).collect();
                }
                match alternatives.len() {
                    1 => alternatives.remove(0),
                    _ => vec![Literal::Any(alternatives)],
                }
            }
        }
    }

    /// Aggregates have bodies, too.
    fn term(&mut self, term: &Term, depth: usize) -> Term {
        let mut term = term.clone();
        match &mut term.kind {
            TermKind::Aggregate(aggregate) => aggregate.body = self.all(&aggregate.body, depth),
            TermKind::Functor(_, arguments) => {
                for argument in arguments {
                    *argument = self.term(argument, depth);
                }
            }
            TermKind::Cast(inner, _) => **inner = self.term(inner, depth),
            _ => {}
        }
        term
    }

    fn refuse(&mut self, atom: &Atom, why: &str) -> Vec<Literal> {
        let message = format!("`{}` {why}: this is not supported", atom.predicate.text);
        self.faults
            .push(Diagnostic::new(Code::Unsupported, message).at(atom.place.0, ""));
        Vec::new()
    }

    /// What one clause says of the atom. `None` if that cannot be negated.
    fn meaning(&mut self, atom: &Atom, head: &Atom, body: &[Literal], negated: bool) -> Option<Vec<Literal>> {
        self.fresh += 1;
        let mut names: Names = HashMap::new();
        let mut equal: Vec<(&Term, &Term)> = Vec::new();
        for (formal, actual) in head.terms.iter().zip(&atom.terms) {
            match &formal.kind {
                TermKind::Variable(name) if !names.contains_key(name) && actual.kind != TermKind::Wildcard => {
                    names.insert(name.clone(), actual.kind.clone());
                }
                _ if actual.kind == TermKind::Wildcard && negated => return None,
                _ if actual.kind == TermKind::Wildcard => {}
                _ => equal.push((formal, actual)),
            }
        }
        let mut own: HashSet<&str> = HashSet::new();
        for literal in body {
            names_in(literal, true, &mut |name| {
                own.insert(name);
            });
        }
        own.retain(|name| !names.contains_key(*name));
        if negated && !own.is_empty() {
            return None;
        }
        for name in own {
            names.insert(name.to_owned(), TermKind::Variable(format!("+{name}.{}", self.fresh)));
        }
        let equal = equal.into_iter().map(|(formal, actual)| Literal::Compare {
            op: Comparison::Equal,
            left: renamed_term(formal, &names),
            right: actual.clone(),
            place: atom.place,
        });
        Some(
            equal
                .chain(body.iter().map(|literal| renamed(literal, &names)))
                .collect(),
        )
    }
}
