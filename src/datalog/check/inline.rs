//! Inline predicates whose clauses do not bind their variables.
//!
//! ```text
//! .decl less(x: number, y: number) inline
//! less(x, y) :- x < y.
//! A(x) :- B(x), B(y), less(x, y + 1).         becomes   A(x) :- B(x), B(y), x < y + 1.
//! ```
//!
//! An inline predicate whose clauses bind all their variables is an ordinary predicate. Otherwise it is no finite set of
//! rows, and the checker replaces each atom over it by its definition. The replacement works on syntax, before name
//! resolution.

use std::collections::{HashMap, HashSet};

use crate::codes;
use crate::diag::{Diagnostic, Faults, Span};

use crate::check::strata::components;
use crate::check::witness::{Names, bound_names, renamed, renamed_term, size};
use crate::syntax::ast::Comparison;
use crate::syntax::ast::{Atom, Clause, Decl, Item, Literal, Name, Term, TermKind};
use crate::syntax::ast::{names_in, names_of};
use crate::syntax::parser::negate;

/// Maximum nesting of inline predicates.
const MAX_DEPTH: usize = 16;

/// Maximum number of literals that inlining may add to one clause.
const MAX_GROWTH: usize = 1024;

/// The definitions of inline predicates: head and body of each clause.
type Meanings<'c> = HashMap<&'c str, Vec<(&'c Atom, &'c [Literal])>>;

/// Replaces such predicates in all items; `None` if there are none.
pub(crate) fn replace(items: &[Item], faults: &mut Faults) -> Option<Vec<Item>> {
    let inline = declared(items);
    if inline.is_empty() {
        return None;
    }
    refuse_marks(items, &inline, faults);
    refuse_keys(items, &inline, faults);
    let cyclic = refuse_cycles(items, &inline, faults);
    let mut meanings: Meanings<'_> = HashMap::new();
    for clause in clauses(items) {
        for head in &clause.heads {
            let name = head.predicate.text.as_str();
            if inline.contains_key(name) {
                meanings.entry(name).or_default().push((head, &clause.body));
            }
        }
    }
    let open = open_predicates(items, &meanings);
    refuse_negated(items, &meanings, &open, faults);
    meanings.retain(|name, _| open.contains(name) && !cyclic.contains(name));
    if meanings.is_empty() && cyclic.is_empty() {
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
                    .filter(|head| {
                        let name = head.predicate.text.as_str();
                        !meanings.contains_key(name) && !cyclic.contains(name)
                    })
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
                // For these predicates `inline` has an effect, so no warning follows.
                let replaced = |name: &str| meanings.contains_key(name) || cyclic.contains(name);
                if decl.names.iter().all(|name| replaced(&name.text)) {
                    decl.qualifiers.retain(|word| word.text != "inline");
                }
                out.push(Item::Decl(decl));
            }
            other => out.push(other.clone()),
        }
    }
    Some(out)
}

/// Returns the inline predicates with a clause that does not bind all columns, itself or by other ones of this kind.
fn open_predicates<'c>(items: &'c [Item], meanings: &Meanings<'c>) -> HashSet<&'c str> {
    let is_inline = |atom: &Atom| meanings.contains_key(atom.predicate.text.as_str());
    // A larger body cannot replace an atom.
    let fits = |clause: &&Clause| !clause.body.is_empty() && clause.body.iter().map(size).sum::<usize>() <= MAX_GROWTH;
    let inline = clauses(items).filter(|clause| clause.heads.iter().any(is_inline));
    let inline: Vec<&Clause> = inline.filter(fits).collect();
    let mut open: Unbound<'c> = HashMap::new();
    // A longer chain of such predicates is refused.
    for _ in 0..=MAX_DEPTH {
        let mut found: Unbound<'c> = HashMap::new();
        for clause in &inline {
            let weakened = weakened(&clause.body, &open);
            let bound = bound_by_all(&weakened.iter().collect::<Vec<_>>(), &HashSet::new());
            for head in clause.heads.iter().filter(|head| is_inline(head)) {
                for (column, term) in head.terms.iter().enumerate() {
                    names_of(term, false, &mut |name| {
                        if !bound.contains(name) {
                            found.entry(&head.predicate.text).or_default().insert(column);
                        }
                    });
                }
            }
        }
        if found == open {
            break;
        }
        open = found;
    }
    open.into_keys().collect()
}

/// The columns of inline predicates that some clause of theirs does not bind.
type Unbound<'c> = HashMap<&'c str, HashSet<usize>>;

/// Returns a body in which atoms do not contain the variables that they do not bind.
fn weakened(body: &[Literal], open: &Unbound<'_>) -> Vec<Literal> {
    let mut body = body.to_vec();
    for literal in &mut body {
        match literal {
            Literal::Atom { negated: false, atom } => {
                let unbound = open.get(atom.predicate.text.as_str());
                for &column in unbound.into_iter().flatten() {
                    if let Some(term) = atom.terms.get_mut(column) {
                        term.kind = TermKind::Wildcard;
                    }
                }
            }
            Literal::Any(alternatives) => {
                for all in alternatives {
                    *all = weakened(all, open);
                }
            }
            _ => {}
        }
    }
    body
}

/// Returns names that a body binds outside of aggregates, whichever of its alternatives hold: all of them unless
/// alternatives need what others bind.
fn bound_by_all<'c>(body: &[&'c Literal], known: &HashSet<&'c str>) -> HashSet<&'c str> {
    let mut bound = bound_names(body, known.clone());
    for literal in body {
        let Literal::Any(alternatives) = literal else { continue };
        let by_each = (alternatives.iter()).map(|all| bound_by_all(&all.iter().collect::<Vec<_>>(), &bound));
        let by_all = by_each.reduce(|one, other| one.intersection(&other).copied().collect());
        bound.extend(by_all.into_iter().flatten());
    }
    bound_names(body, bound)
}

fn clauses(items: &[Item]) -> impl Iterator<Item = &Clause> {
    items.iter().filter_map(|item| match item {
        Item::Clause(clause) => Some(clause),
        _ => None,
    })
}

/// Returns the inline predicates with the places of their declarations. `no_inline` overrides `inline`.
fn declared(items: &[Item]) -> HashMap<&str, Span> {
    let has = |decl: &Decl, wanted: &str| decl.qualifiers.iter().any(|word| word.text == wanted);
    (items.iter())
        .filter_map(|item| match item {
            Item::Decl(decl) if has(decl, "inline") && !has(decl, "no_inline") => Some(&decl.names),
            _ => None,
        })
        .flatten()
        .map(|name| (name.text.as_str(), name.place.0))
        .collect()
}

fn refused(name: &Name, why: &str) -> Diagnostic {
    Diagnostic::new(
        codes::UNSUPPORTED,
        format!("`{}` {why}: this is not supported", name.text),
    )
    .at(name.place.0, "")
    .help("remove `inline` from its declaration")
}

/// Reports directives that name inline predicates, which have no rows to read or write.
fn refuse_marks(items: &[Item], inline: &HashMap<&str, Span>, faults: &mut Faults) {
    for item in items {
        let Item::Mark(mark) = item else { continue };
        for name in &mark.names {
            if let Some(&declaration) = inline.get(name.text.as_str()) {
                let why = format!("is inline and named by `.{}`", mark.kind.name());
                faults.push(refused(name, &why).also(declaration, "declared here"));
            }
        }
    }
}

/// Reports inline predicates with keys, which choose among rows.
fn refuse_keys(items: &[Item], inline: &HashMap<&str, Span>, faults: &mut Faults) {
    for item in items {
        let Item::Decl(decl) = item else { continue };
        let has_keys = !decl.choices.is_empty();
        for name in decl
            .names
            .iter()
            .filter(|name| has_keys && inline.contains_key(name.text.as_str()))
        {
            faults.push(refused(name, "is inline and has keys"));
        }
    }
}

/// Returns the inline predicates that depend on themselves through inline predicates only. Reports each cycle once.
fn refuse_cycles<'c>(items: &'c [Item], inline: &HashMap<&'c str, Span>, faults: &mut Faults) -> HashSet<&'c str> {
    let mut names: Vec<&str> = inline.keys().copied().collect();
    names.sort_unstable_by_key(|name| inline[name]);
    let number: HashMap<&str, usize> = names.iter().enumerate().map(|(number, name)| (*name, number)).collect();
    let mut uses: Vec<(usize, usize, &Name)> = Vec::new();
    for clause in clauses(items) {
        for head in &clause.heads {
            if let Some(&from) = number.get(head.predicate.text.as_str()) {
                each_atom(&clause.body, &mut |_, atom| {
                    if let Some(&to) = number.get(atom.predicate.text.as_str()) {
                        uses.push((from, to, &atom.predicate));
                    }
                });
            }
        }
    }
    let mut successors = vec![Vec::new(); names.len()];
    for &(from, to, _) in &uses {
        successors[from].push(to);
    }
    let (component, _) = components(&successors);
    let mut reported: HashSet<usize> = HashSet::new();
    let mut cyclic = HashSet::new();
    for (from, to, place) in uses {
        if component[from] == component[to] {
            cyclic.extend([names[from], names[to]]);
            if reported.insert(component[from]) {
                let why = "is inline and depends on itself through inline predicates only";
                faults.push(refused(place, why).also(inline[names[to]], "declared here"));
            }
        }
    }
    cyclic
}

/// Reports negated atoms over inline predicates with extra variables in a body, which nothing outside can bind.
fn refuse_negated(items: &[Item], meanings: &Meanings<'_>, open: &HashSet<&str>, faults: &mut Faults) {
    let has_own = |(head, body): &(&Atom, &[Literal])| {
        let mut of_head: HashSet<&str> = HashSet::new();
        head.terms.iter().for_each(|term| {
            names_of(term, true, &mut |name| {
                of_head.insert(name);
            })
        });
        let mut own = false;
        body.iter()
            .for_each(|literal| names_in(literal, true, &mut |name| own |= !of_head.contains(name)));
        own
    };
    for clause in clauses(items) {
        each_atom(&clause.body, &mut |negated, atom| {
            let name = atom.predicate.text.as_str();
            let meaning = meanings.get(name).filter(|_| negated && !open.contains(name));
            if meaning.is_some_and(|clauses| clauses.iter().any(has_own)) {
                let why = "is inline, has extra variables, and is negated";
                faults.push(refused(&atom.predicate, why));
            }
        });
    }
}

/// Calls `each` with every atom, also those in aggregates, and whether it is negated.
pub(crate) fn each_atom<'c>(literals: &'c [Literal], each: &mut dyn FnMut(bool, &'c Atom)) {
    for literal in literals {
        match literal {
            Literal::Atom { negated, atom } => {
                each(*negated, atom);
                atom.terms.iter().for_each(|term| each_atom_of(term, each));
            }
            Literal::Compare { left, right, .. } => {
                each_atom_of(left, each);
                each_atom_of(right, each);
            }
            Literal::Temporal { negated, temporal } => temporal.atoms().for_each(|atom| each(*negated, atom)),
            Literal::Any(alternatives) => alternatives.iter().for_each(|all| each_atom(all, each)),
        }
    }
}

/// Calls `each` as [`each_atom`] does with the atoms in the aggregates of a term.
pub(crate) fn each_atom_of<'c>(term: &'c Term, each: &mut dyn FnMut(bool, &'c Atom)) {
    match &term.kind {
        TermKind::Functor(_, arguments) => arguments.iter().for_each(|argument| each_atom_of(argument, each)),
        TermKind::Cast(inner, _) => each_atom_of(inner, each),
        TermKind::Aggregate(aggregate) => each_atom(&aggregate.body, each),
        _ => {}
    }
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
            // Temporal literals are lowered to atoms before.
            Literal::Temporal { .. } => vec![literal.clone()],
            Literal::Atom { negated, atom } => {
                let Some(meanings) = self.meanings.get(atom.predicate.text.as_str()) else {
                    return vec![literal.clone()];
                };
                self.growth += meanings.iter().map(|(_, body)| 1 + body.len()).sum::<usize>();
                if depth >= MAX_DEPTH || self.growth > MAX_GROWTH {
                    return self.refuse(atom, "is inline and nested too deeply");
                }
                let mut alternatives = Vec::new();
                for &(head, body) in meanings {
                    if head.terms.len() != atom.terms.len() {
                        return vec![literal.clone()];
                    }
                    let Some(alternative) = self.meaning(atom, head, body, *negated) else {
                        return self.refuse(atom, "is inline, has extra variables, and is negated");
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

    /// Replaces inline predicates in the bodies of aggregates.
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
        self.faults.push(refused(&atom.predicate, why));
        Vec::new()
    }

    /// Returns the body of one clause for the arguments of the atom; `None` if its negation is not expressible.
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
