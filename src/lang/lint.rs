//! Warnings that need all clauses: those that can never fire, and those that derive nothing new.

use std::collections::{HashMap, HashSet};

use crate::diag::{Code, Diagnostic, Faults, Span};

use super::clause::{Checked, Clauses};
use super::functor::Functor;
use super::names::Names;
use super::rules::{Atom, BaseType, Clause, Comparison, Literal, RelId, Relation, Term, Value};
use super::strata;

// --- clauses that never fire

/// Of the clauses that need one empty predicate, so many are shown.
const MAX_DEAD_SHOWN: usize = 4;

/// Warns of clauses with a positive atom over a predicate that cannot have a row: it is not input, and it has no clause, or
/// only clauses that need it first. A clause that is dead only because such a clause is, is not reported.
pub(super) fn dead(all: &Clauses, names: &Names, faults: &mut Faults) {
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
            Code::DeadClause,
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

/// All comparisons of clauses together take at most so many steps; later pairs are not compared.
const MAX_STEPS: usize = 10_000_000;

/// One comparison takes at most so many steps; if that does not settle it, nothing is said.
const MAX_STEPS_OF_PAIR: usize = 2_000;

/// Warns of clauses that are equal to another or less general than it.
///
/// C makes D redundant if some substitution of C's variables makes their heads equal and each literal of C one of D's (theta
/// subsumption): whenever D fires, C derives the same. That is sufficient, not necessary, so what is reported is true, but
/// not all that is true is reported.
pub(super) fn redundant(clauses: &[Checked], faults: &mut Faults) {
    // Facts are found by their rows: there may be very many. The map is only asked, never walked.
    let mut facts: HashMap<(RelId, &[Term]), Span> = HashMap::new();
    for Checked { clause, sound, .. } in clauses {
        if *sound && clause.body.is_empty() {
            let row = (clause.head.relation, clause.head.terms.as_slice());
            if let Some(&first) = facts.get(&row) {
                report(Code::DuplicateClause, clause.span, first, faults);
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
                report(Code::SubsumedClause, clause.span, fact, faults);
            } else {
                by_head
                    .entry(clause.head.relation)
                    .or_default()
                    .push(Pattern::new(clause));
            }
        }
    }
    let mut steps = MAX_STEPS;
    for group in by_head.values() {
        let mut gone = vec![false; group.len()];
        for later in 0..group.len() {
            for earlier in 0..later {
                let Some(rest) = steps.checked_sub(1) else { return };
                steps = rest;
                if gone[later] {
                    break;
                }
                // Alternatives and heads of one clause are not the author's fault.
                if gone[earlier] || group[earlier].span == group[later].span {
                    continue;
                }
                if let Some((code, redundant)) = compare(&group[earlier], &group[later], &mut steps) {
                    let (redundant, other) = if redundant { (later, earlier) } else { (earlier, later) };
                    gone[redundant] = true;
                    report(code, group[redundant].span, group[other].span, faults);
                }
            }
        }
    }
}

fn report(code: Code, span: Span, other: Span, faults: &mut Faults) {
    let (message, label) = match code {
        Code::DuplicateClause => (
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

/// What is redundant of two clauses with one head predicate, if anything: the later (`true`) or the earlier.
fn compare(earlier: &Pattern, later: &Pattern, steps: &mut usize) -> Option<(Code, bool)> {
    let same_size = earlier.literals.len() == later.literals.len();
    if same_size && Match::exists(earlier, later, true, steps) {
        return Some((Code::DuplicateClause, true));
    }
    let earlier_covers = Match::exists(earlier, later, false, steps);
    let later_covers = Match::exists(later, earlier, false, steps);
    match (earlier_covers, later_covers) {
        (true, true) => Some((Code::SubsumedClause, later.literals.len() >= earlier.literals.len())),
        (true, false) => Some((Code::SubsumedClause, true)),
        (false, true) => Some((Code::SubsumedClause, false)),
        (false, false) => None,
    }
}

/// A clause made ready for comparison: literals are unique and in a normal form.
struct Pattern {
    head: Vec<Part>,
    literals: Vec<Normal>,
    variables: usize,
    /// A bit for each kind of literal, for a quick refusal.
    kinds: u64,
    span: Span,
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
        let kinds = literals
            .iter()
            .map(|literal| literal.kind.bit())
            .fold(0, |all, bit| all | bit);
        Pattern {
            head: clause
                .head
                .terms
                .iter()
                .map(|term| part(*term).unwrap_or(Part::Any))
                .collect(),
            literals,
            variables,
            kinds,
            span: clause.span,
        }
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
    fn bit(self) -> u64 {
        let number = match self {
            LiteralKind::Positive(id) => id.0 % 30,
            LiteralKind::Negative(id) => 30 + id.0 % 30,
            LiteralKind::Equal(_) => 60,
            LiteralKind::NotEqual(_) => 61,
            LiteralKind::Less(_) => 62,
            LiteralKind::LessEqual(_) | LiteralKind::Text(_) | LiteralKind::Compute(..) => 63,
        };
        1 << number
    }

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
    steps: usize,
}

impl Match<'_> {
    fn exists(general: &Pattern, special: &Pattern, renaming: bool, steps: &mut usize) -> bool {
        if general.kinds & !special.kinds != 0 {
            return false;
        }
        let allowed = MAX_STEPS_OF_PAIR.min(*steps);
        let mut search = Match {
            general,
            special,
            bound: vec![None; general.variables],
            trail: Vec::new(),
            renaming,
            steps: allowed,
        };
        let found = search.all(&general.head, &special.head) && search.literal(0);
        *steps -= allowed - search.steps;
        found
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
                let Some(rest) = self.steps.checked_sub(1) else {
                    return false;
                };
                self.steps = rest;
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
