//! Warnings that need all clauses: those that can never fire, and those that derive nothing new.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap, HashSet};

use crate::diag::{Code, Diagnostic, Faults, Span};

use crate::datalog::check::clause::{Checked, Clauses};
use crate::datalog::check::names::Names;
use crate::datalog::check::rules::{Atom, Clause, Literal, RelId, Relation, Term};
use crate::datalog::check::strata;
use crate::datalog::check::subsets::{Budget, Comparing, Subsets};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::syntax::functor::Functor;
use crate::datalog::value::Value;

// --- clauses that never fire

/// Of the clauses that need one empty predicate, so many are shown.
const MAX_DEAD_SHOWN: usize = 4;

/// Warns of clauses with a positive atom over a predicate that cannot have a row: it is not input, and it has no clause, or
/// only clauses that need it first. A clause that is dead only because such a clause is, is not reported.
pub(crate) fn dead(all: &Clauses, names: &Names, faults: &mut Faults) {
    if all.incomplete || !names.complete() {
        return;
    }
    let filled = filled(all, names);
    let mut has_clause = vec![false; names.relations.len()];
    let mut needs_empty: Vec<Vec<usize>> = vec![Vec::new(); names.relations.len()];
    for Checked { clause, .. } in &all.clauses {
        let head = clause.head.relation.index();
        has_clause[head] = true;
        needs_empty[head].extend(
            needed(clause)
                .map(|atom| atom.relation.index())
                .filter(|&id| !filled[id]),
        );
    }
    let (component, _) = strata::components(&needs_empty);
    // The empty predicates, in the order of the text, and the clauses that need each.
    let mut causes: indexmap::IndexMap<RelId, Vec<&Clause>> = indexmap::IndexMap::new();
    for Checked { clause, .. } in &all.clauses {
        let empty = |atom: &&Atom| !filled[atom.relation.index()];
        let missing = needed(clause)
            .filter(empty)
            .find(|atom| !has_clause[atom.relation.index()]);
        let circular = || {
            needed(clause)
                .filter(empty)
                .find(|atom| component[atom.relation.index()] == component[clause.head.relation.index()])
        };
        if let Some(atom) = missing.or_else(circular) {
            causes.entry(atom.relation).or_default().push(clause);
        }
    }
    for (relation, clauses) in causes {
        let name = &names.relation(relation).name;
        let place = |clause: &Clause| {
            let written = clause.body.iter().find_map(|literal| match literal {
                Literal::Positive(atom) if atom.relation == relation => Some(atom.span),
                _ => None,
            });
            written.unwrap_or(clause.head.span)
        };
        let mut fault = Diagnostic::new(
            Code::DEAD_CLAUSE,
            format!("this clause never fires: `{name}` is always empty"),
        )
        .at(place(clauses[0]), "");
        for clause in clauses.iter().take(MAX_DEAD_SHOWN).skip(1) {
            fault = fault.also(place(clause), "nor does this one");
        }
        if clauses.len() > MAX_DEAD_SHOWN {
            fault = fault.note(format!("nor do {} other clauses", clauses.len() - MAX_DEAD_SHOWN));
        }
        fault = fault.also(names.relation(relation).span, format!("`{name}` is declared here"));
        fault = if has_clause[relation.index()] {
            fault.note(format!("every clause for `{name}` needs a row of `{name}` first"))
        } else {
            fault.help(format!("write a clause or a fact for it, or `.input {name}`"))
        };
        faults.push(fault);
    }
}

/// The atoms that must hold for a clause to fire.
fn needed(clause: &Clause) -> impl Iterator<Item = &Atom> {
    clause.body.iter().filter_map(|literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => Some(atom),
        _ => None,
    })
}

/// Which predicates may have rows.
fn filled(all: &Clauses, names: &Names) -> Vec<bool> {
    let mut waiting: Vec<usize> = all
        .clauses
        .iter()
        .map(|checked| needed(&checked.clause).count())
        .collect();
    let mut users: Vec<Vec<usize>> = vec![Vec::new(); names.relations.len()];
    for (index, Checked { clause, .. }) in all.clauses.iter().enumerate() {
        for atom in needed(clause) {
            users[atom.relation.index()].push(index);
        }
    }
    // A hidden predicate with positive atoms, see `range`, is filled by what the clause asks of it.
    let given = |relation: &Relation| relation.input || relation.hidden;
    let mut filled: Vec<bool> = names.relations.iter().map(given).collect();
    for (index, Checked { clause, .. }) in all.clauses.iter().enumerate() {
        filled[clause.head.relation.index()] |= waiting[index] == 0;
    }
    let mut work: Vec<usize> = (0..filled.len()).filter(|&id| filled[id]).collect();
    while let Some(id) = work.pop() {
        for &user in &users[id] {
            waiting[user] -= 1;
            let head = all.clauses[user].clause.head.relation.index();
            if waiting[user] == 0 && !filled[head] {
                filled[head] = true;
                work.push(head);
            }
        }
    }
    filled
}

// --- clauses that derive nothing new

/// All comparisons of clauses together take at most so many steps; then the search is given up.
const MAX_STEPS: usize = 10_000_000;

/// One comparison takes at most so many steps; if that does not settle it, nothing is said.
const MAX_STEPS_OF_PAIR: usize = 2_000;

/// Warns of clauses that are equal to another or less general than it.
///
/// C makes D redundant if some substitution of C's variables makes their heads equal and each literal of C one of D's (theta
/// subsumption): whenever D fires, C derives the same. That is sufficient, not necessary, so what is reported is true, but
/// not all that is true is reported.
pub(crate) fn redundant(clauses: &[Checked], faults: &mut Faults) -> Comparing {
    // Facts are found by their rows: there may be very many. The map is only asked, never walked.
    let mut facts: HashMap<(RelId, &[Term]), Span> = HashMap::new();
    for Checked { clause, sound, .. } in clauses {
        if *sound && clause.body.is_empty() {
            let row = (clause.head.relation, clause.head.terms.as_slice());
            if let Some(&first) = facts.get(&row) {
                report(Code::DUPLICATE_CLAUSE, clause.span, first, faults);
            } else {
                facts.insert(row, clause.span);
            }
        }
    }
    let mut by_head: indexmap::IndexMap<RelId, Vec<Pattern>> = indexmap::IndexMap::new();
    for Checked { clause, sound, .. } in clauses {
        // Of aggregates nothing is known.
        let known = !(clause.body.iter()).any(|literal| matches!(literal, Literal::Aggregate { .. }));
        if *sound && known && !clause.body.is_empty() {
            if let Some(&fact) = facts.get(&(clause.head.relation, clause.head.terms.as_slice())) {
                report(Code::SUBSUMED_CLAUSE, clause.span, fact, faults);
            } else {
                let group = by_head.entry(clause.head.relation).or_default();
                group.push(Pattern::new(clause));
            }
        }
    }
    let mut budget = Budget::new(MAX_STEPS);
    for group in by_head.into_values() {
        redundant_of(group, &mut budget, faults);
    }
    budget.spent()
}

/// The same for clauses with one head predicate.
fn redundant_of(group: Vec<Pattern>, budget: &mut Budget, faults: &mut Faults) {
    let group = without_copies(group, faults);
    let traits: Vec<(usize, BTreeSet<Trait>)> = group.iter().map(Pattern::traits).enumerate().collect();
    let subsets = Subsets::new(&traits, |_| false);
    let mut gone = vec![false; group.len()];
    for (special, own) in &traits {
        let special = *special;
        let Some(candidates) = subsets.within(own, false, budget) else {
            return;
        };
        // Alternatives and heads of one clause are not the author's fault.
        let others = (candidates.into_iter()).filter(|&other| group[other].span != group[special].span);
        for general in others {
            if gone[general] {
                continue;
            }
            if let Some(code) = makes_redundant(&group, general, special, budget) {
                gone[special] = true;
                report(code, group[special].span, group[general].span, faults);
                break;
            }
        }
    }
}

/// Tells copies, and leaves them out, so that many of one clause are not compared with each other.
fn without_copies(group: Vec<Pattern>, faults: &mut Faults) -> Vec<Pattern> {
    // Only asked, never walked.
    let mut first: HashMap<(Vec<Part>, Vec<Normal>), Span> = HashMap::new();
    let mut kept = Vec::new();
    for pattern in group {
        match first.entry((pattern.head.clone(), pattern.literals.clone())) {
            Entry::Occupied(other) if *other.get() == pattern.span => {}
            Entry::Occupied(other) => report(Code::DUPLICATE_CLAUSE, pattern.span, *other.get(), faults),
            Entry::Vacant(place) => {
                place.insert(pattern.span);
                kept.push(pattern);
            }
        }
    }
    kept
}

fn report(code: Code, span: Span, other: Span, faults: &mut Faults) {
    let (message, label) = match code {
        Code::DUPLICATE_CLAUSE => (
            "this clause stands here already",
            "the same, up to the names of variables and order",
        ),
        _ => (
            "this clause derives nothing that another does not",
            "whenever it fires, this one derives the same",
        ),
    };
    faults.push(
        Diagnostic::new(code, message)
            .at(span, "")
            .also(other, label)
            .help("remove it"),
    );
}

/// Whether the general clause makes the special one redundant. Of two that derive the same the shorter one stays, else the first.
fn makes_redundant(group: &[Pattern], general: usize, special: usize, budget: &mut Budget) -> Option<Code> {
    let (one, two) = (&group[general], &group[special]);
    if !Match::exists(one, two, false, budget) {
        return None;
    }
    if Match::exists(two, one, false, budget) {
        if (two.literals.len(), special) < (one.literals.len(), general) {
            return None;
        }
        if one.literals.len() == two.literals.len() && Match::exists(one, two, true, budget) {
            return Some(Code::DUPLICATE_CLAUSE);
        }
    }
    Some(Code::SUBSUMED_CLAUSE)
}

/// A clause made ready for comparison: literals are unique and in a normal form.
struct Pattern {
    head: Vec<Part>,
    literals: Vec<Normal>,
    variables: usize,
    span: Span,
}

/// Of heads and literals so many arguments are looked at to find the clauses that are worth comparing.
const PLACES: usize = 8;

/// Something a clause has. If one makes another redundant, the other has all that it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Trait {
    /// Such a literal.
    Kind(LiteralKind),
    /// Such a literal with a constant in this place.
    Constant(LiteralKind, usize, Value),
    /// Such a literal with, in this place, what stands in this column of the head.
    Head(LiteralKind, usize, usize),
    /// A constant in this column of the head.
    HeadConstant(usize, Value),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Part {
    Variable(usize),
    Constant(Value),
    /// `_` in a negated atom: any value at all.
    Any,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum LiteralKind {
    Positive(RelId),
    Negative(RelId),
    Equal(BaseType),
    NotEqual(BaseType),
    Less(BaseType),
    LessEqual(BaseType),
    Text(Comparison),
    Compute(Functor, BaseType),
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Normal {
    kind: LiteralKind,
    parts: Vec<Part>,
}

impl Pattern {
    fn new(clause: &Clause) -> Pattern {
        let mut variables = clause.variables.len();
        let mut literals: Vec<Normal> = Vec::new();
        for literal in &clause.body {
            let normal = match literal {
                Literal::Positive(atom) | Literal::Guard(atom) => Normal {
                    kind: LiteralKind::Positive(atom.relation),
                    // A `_` in a positive atom is a variable that occurs once.
                    parts: (atom.terms.iter())
                        .map(|term| {
                            part(*term).unwrap_or_else(|| {
                                variables += 1;
                                Part::Variable(variables - 1)
                            })
                        })
                        .collect(),
                },
                Literal::Negative(atom) => Normal {
                    kind: LiteralKind::Negative(atom.relation),
                    parts: atom.terms.iter().map(|term| part(*term).unwrap_or(Part::Any)).collect(),
                },
                Literal::Compare {
                    op, left, right, base, ..
                } => {
                    let (kind, swapped) = match op {
                        Comparison::Equal => (LiteralKind::Equal(*base), false),
                        Comparison::NotEqual => (LiteralKind::NotEqual(*base), false),
                        Comparison::Less => (LiteralKind::Less(*base), false),
                        Comparison::LessEqual => (LiteralKind::LessEqual(*base), false),
                        Comparison::Greater => (LiteralKind::Less(*base), true),
                        Comparison::GreaterEqual => (LiteralKind::LessEqual(*base), true),
                        Comparison::Match | Comparison::NotMatch | Comparison::Contains | Comparison::NotContains => {
                            (LiteralKind::Text(*op), false)
                        }
                    };
                    let sides = if swapped { [*right, *left] } else { [*left, *right] };
                    Normal {
                        kind,
                        parts: sides.map(|side| part(side).unwrap_or(Part::Any)).to_vec(),
                    }
                }
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    ..
                } => Normal {
                    kind: LiteralKind::Compute(*functor, *base),
                    parts: std::iter::once(to)
                        .chain(arguments)
                        .map(|term| part(*term).unwrap_or(Part::Any))
                        .collect(),
                },
                Literal::Aggregate { .. } => continue,
            };
            literals.push(normal);
        }
        for literal in literals.iter_mut().filter(|literal| literal.kind.is_symmetric()) {
            literal.parts.sort_unstable();
        }
        let mut seen = HashSet::new();
        literals.retain(|literal| seen.insert(literal.clone()));
        // Literals of one kind stand together; within a kind the author's order stays.
        literals.sort_by_key(|literal| literal.kind);
        let head = clause.head.terms.iter();
        Pattern {
            head: head.map(|term| part(*term).unwrap_or(Part::Any)).collect(),
            literals,
            variables,
            span: clause.span,
        }
    }

    /// What a clause must have if this one is more general, and what this one has if another is.
    fn traits(&self) -> BTreeSet<Trait> {
        let head = || self.head.iter().take(PLACES).enumerate();
        let mut traits = BTreeSet::new();
        for (column, part) in head() {
            if let Part::Constant(value) = part {
                traits.insert(Trait::HeadConstant(column, *value));
            }
        }
        for Normal { kind, parts } in &self.literals {
            traits.insert(Trait::Kind(*kind));
            // In a negated atom `_` stands for anything.
            if matches!(kind, LiteralKind::Negative(_)) {
                continue;
            }
            for (at, part) in parts.iter().take(PLACES).enumerate() {
                let at = if kind.is_symmetric() { 0 } else { at };
                if let Part::Constant(value) = part {
                    traits.insert(Trait::Constant(*kind, at, *value));
                }
                let same = head().filter(|(_, other)| *other == part);
                traits.extend(same.map(|(column, _)| Trait::Head(*kind, at, column)));
            }
        }
        traits
    }
}

fn part(term: Term) -> Option<Part> {
    match term {
        Term::Variable(id) => Some(Part::Variable(id.index())),
        Term::Constant(value) => Some(Part::Constant(value)),
        Term::Wildcard => None,
    }
}

impl LiteralKind {
    /// Whether its two sides may change places.
    fn is_symmetric(self) -> bool {
        matches!(self, LiteralKind::Equal(_) | LiteralKind::NotEqual(_))
    }
}

/// The search for a substitution that makes `general` a part of `special`.
struct Match<'a> {
    general: &'a Pattern,
    special: &'a Pattern,
    /// What each variable of `general` stands for.
    bound: Vec<Option<Part>>,
    /// The variables bound so far, in order.
    trail: Vec<usize>,
    /// Only names of variables may change: each variable stands for another variable.
    renaming: bool,
    budget: &'a mut Budget,
}

impl Match<'_> {
    fn exists(general: &Pattern, special: &Pattern, renaming: bool, budget: &mut Budget) -> bool {
        budget.part(MAX_STEPS_OF_PAIR, |budget| {
            let mut search = Match {
                general,
                special,
                bound: vec![None; general.variables],
                trail: Vec::new(),
                renaming,
                budget,
            };
            search.all(&general.head, &special.head) && search.literal(0)
        })
    }

    /// Whether the literals of `general` from `index` on can be found in `special`.
    fn literal(&mut self, index: usize) -> bool {
        let Some(wanted) = self.general.literals.get(index) else {
            return true;
        };
        let special = self.special;
        let from = special.literals.partition_point(|literal| literal.kind < wanted.kind);
        for candidate in special.literals[from..]
            .iter()
            .take_while(|literal| literal.kind == wanted.kind)
        {
            let mut orders = vec![candidate.parts.clone()];
            if wanted.kind.is_symmetric() {
                orders.push(candidate.parts.iter().rev().copied().collect());
            }
            for parts in orders {
                if !self.budget.take(1) {
                    return false;
                }
                let mark = self.trail.len();
                if self.all(&wanted.parts, &parts) && self.literal(index + 1) {
                    return true;
                }
                for variable in self.trail.drain(mark..) {
                    self.bound[variable] = None;
                }
            }
        }
        false
    }

    fn all(&mut self, general: &[Part], special: &[Part]) -> bool {
        general.len() == special.len()
            && general
                .iter()
                .zip(special)
                .all(|(&general, &special)| self.one(general, special))
    }

    fn one(&mut self, general: Part, special: Part) -> bool {
        match (general, special) {
            // "No row at all" implies "not this row", whatever this row is; some other literal says what the variable is.
            (_, Part::Any) => !self.renaming || general == Part::Any,
            (Part::Variable(variable), _) => match self.bound[variable] {
                Some(known) => known == special,
                None => {
                    if self.renaming {
                        let taken = self.trail.iter().any(|&other| self.bound[other] == Some(special));
                        if taken || !matches!(special, Part::Variable(_)) {
                            return false;
                        }
                    }
                    self.bound[variable] = Some(special);
                    self.trail.push(variable);
                    true
                }
            },
            (Part::Constant(_), _) => general == special,
            (Part::Any, _) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datalog::check::random_clauses;
    use proptest::prelude::*;

    proptest! {
        /// So looking only at clauses that have all traits misses none.
        #[test]
        fn a_redundant_clause_has_all_traits_of_the_one_that_makes_it_so(rules in random_clauses::rules()) {
            let patterns: Vec<Pattern> = rules.clauses.iter().map(Pattern::new).collect();
            for (general, special) in patterns.iter().flat_map(|one| patterns.iter().map(move |other| (one, other))) {
                if Match::exists(general, special, false, &mut Budget::new(MAX_STEPS_OF_PAIR)) {
                    prop_assert!(general.traits().is_subset(&special.traits()));
                }
            }
        }
    }
}
