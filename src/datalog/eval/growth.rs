//! Recursion that derives new values without end.
//!
//! ```text
//! N(x + 1) :- N(x).            A(x - 1) :- B(x).  B(x) :- A(x).            S(cat(x, "a")) :- S(x).
//! ```
//!
//! A graph has a node for each column of a recursive predicate and an edge for each way in which a clause passes a value
//! on. Some edges grow: they compute a new value. A cycle with a growing edge has no end unless a literal bounds a value
//! on it.

use crate::datalog::check::{Clause, ClauseId, Literal, RelId, Rules, Term};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::syntax::functor::Functor;
use crate::diag::Span;
use std::collections::{BTreeMap, BTreeSet};

/// A computation that feeds itself.
pub(crate) struct Growth {
    /// The place of the computation.
    pub span: Span,
    /// The condition that would bound it, as an example.
    pub bound: String,
}

/// The direction in which values grow, and so the comparisons that bound them.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Up,
    Down,
    /// Any comparison bounds the value.
    Somewhere,
}

const WAYS: [Way; 3] = [Way::Up, Way::Down, Way::Somewhere];

/// A column of a predicate.
type Node = (RelId, usize);

/// A way in which a clause passes a value on.
struct Edge {
    from: Node,
    to: Node,
    /// What grows the value.
    growth: Option<(Way, Growth)>,
}

/// Returns a computation without end in the recursion that contains the clause, if there is one.
pub(crate) fn endless(rules: &Rules, clause: ClauseId) -> Option<Growth> {
    let stratum = rules.strata.iter().find(|stratum| stratum.clauses.contains(&clause))?;
    if !stratum.recursive {
        return None;
    }
    let recursive: BTreeSet<RelId> = stratum.relations.iter().copied().collect();
    for way in WAYS {
        let clauses = stratum.clauses.iter().map(|id| &rules.clauses[id.index()]);
        let edges: Vec<Edge> = clauses.flat_map(|clause| edges(clause, &recursive, way)).collect();
        let grows = |edge: &&Edge| matches!(edge.growth, Some((found, _)) if found == way);
        let on_cycle = |edge: &&Edge| reaches(&edges, edge.to, edge.from);
        if let Some(position) = edges.iter().position(|edge| grows(&edge) && on_cycle(&edge)) {
            let (_, growth) = edges.into_iter().nth(position)?.growth?;
            return Some(growth);
        }
    }
    None
}

fn reaches(edges: &[Edge], from: Node, to: Node) -> bool {
    let (mut todo, mut seen) = (vec![from], BTreeSet::from([from]));
    while let Some(node) = todo.pop() {
        if node == to {
            return true;
        }
        let next = edges.iter().filter(|edge| edge.from == node).map(|edge| edge.to);
        todo.extend(next.filter(|node| seen.insert(*node)));
    }
    false
}

/// Returns the ways in which the clause passes on values that nothing bounds in this direction.
fn edges(clause: &Clause, recursive: &BTreeSet<RelId>, way: Way) -> Vec<Edge> {
    let mut found = Vec::new();
    for literal in &clause.body {
        let (Literal::Positive(atom) | Literal::Guard(atom)) = literal else {
            continue;
        };
        if !recursive.contains(&atom.relation) {
            continue;
        }
        for (column, term) in atom.terms.iter().enumerate() {
            let Some(source) = variable(term) else { continue };
            let passed = passed_on(clause, source);
            if is_bounded(clause, recursive, &passed, way) {
                continue;
            }
            for (to, term) in clause.head.terms.iter().enumerate() {
                let Some(growth) = variable(term).and_then(|id| passed.get(&id)) else {
                    continue;
                };
                let growth = growth.map(|(way, span, base)| {
                    let name = clause.variables.get(source).map_or("x", String::as_str);
                    let bound = match (way, base) {
                        (_, BaseType::Symbol) => format!("strlen({name}) < 100"),
                        (Way::Down, BaseType::Unsigned) => format!("{name} > 0"),
                        (Way::Down, _) => format!("{name} > -100"),
                        _ => format!("{name} < 100"),
                    };
                    (way, Growth { span, bound })
                });
                found.push(Edge {
                    from: (atom.relation, column),
                    to: (clause.head.relation, to),
                    growth,
                });
            }
        }
    }
    found
}

type Passed = BTreeMap<usize, Option<(Way, Span, BaseType)>>;

/// Returns the variables whose values come from `source`, each with what grew it on the way.
fn passed_on(clause: &Clause, source: usize) -> Passed {
    let mut passed = Passed::from([(source, None)]);
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for literal in &clause.body {
            let (to, growth) = match literal {
                Literal::Compare {
                    op: Comparison::Equal,
                    left,
                    right,
                    ..
                } => {
                    let pair = [(left, right), (right, left)].into_iter().find_map(|(from, to)| {
                        let growth = passed.get(&variable(from)?)?;
                        Some((variable(to)?, *growth)).filter(|(to, _)| !passed.contains_key(to))
                    });
                    let Some(pair) = pair else { continue };
                    pair
                }
                Literal::Compute {
                    to,
                    functor,
                    base,
                    arguments,
                    span,
                } => {
                    let from = arguments.iter().find_map(|argument| passed.get(&variable(argument)?));
                    let (Some(from), Some(to)) = (from, variable(to)) else {
                        continue;
                    };
                    let own = grows(*functor, *base, arguments).map(|way| (way, *span, *base));
                    (to, from.or(own))
                }
                _ => continue,
            };
            if let std::collections::btree_map::Entry::Vacant(entry) = passed.entry(to) {
                entry.insert(growth);
                changed = true;
            }
        }
    }
    passed
}

/// Returns the direction in which repeated application of the functor makes new values; `None` if they repeat soon.
fn grows(functor: Functor, base: BaseType, arguments: &[Term]) -> Option<Way> {
    let sign = |term: &Term| match (term, base) {
        (Term::Constant(value), BaseType::Number) => Some(value.as_number() < 0),
        (Term::Constant(value), BaseType::Float) => Some(value.as_float() < 0.0),
        (Term::Constant(_), _) => Some(false),
        _ => None,
    };
    let towards = |down: Option<bool>| match down {
        Some(true) => Way::Down,
        Some(false) => Way::Up,
        None => Way::Somewhere,
    };
    match (functor, arguments) {
        (Functor::Add, _) if base == BaseType::Symbol => Some(Way::Up),
        (Functor::Cat, _) => Some(Way::Up),
        (Functor::Add, [left, right]) => Some(towards(sign(left).or(sign(right)))),
        (Functor::Subtract, [_, right]) => Some(towards(sign(right).map(|down| !down))),
        (Functor::Multiply | Functor::Power, _) => Some(Way::Somewhere),
        _ => None,
    }
}

/// Returns whether a literal restricts one of the passed values to finitely many, or bounds it in this direction.
fn is_bounded(clause: &Clause, recursive: &BTreeSet<RelId>, passed: &Passed, way: Way) -> bool {
    let is_passed = |term: &Term| variable(term).is_some_and(|id| passed.contains_key(&id));
    clause.body.iter().any(|literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => {
            !recursive.contains(&atom.relation) && atom.terms.iter().any(is_passed)
        }
        Literal::Negative(atom) => atom.terms.iter().any(is_passed),
        Literal::Compare { op, left, right, .. } => match (is_passed(left), is_passed(right)) {
            (true, true) => !matches!(op, Comparison::Equal),
            (true, false) => bounds(*op, way),
            (false, true) => bounds(mirrored(*op), way),
            (false, false) => false,
        },
        Literal::Compute { .. } | Literal::Aggregate { .. } => false,
    })
}

/// Returns whether `x op constant` bounds x in this direction.
fn bounds(op: Comparison, way: Way) -> bool {
    match op {
        Comparison::Less | Comparison::LessEqual => way != Way::Down,
        Comparison::Greater | Comparison::GreaterEqual => way != Way::Up,
        _ => true,
    }
}

/// Returns the operator with its sides exchanged.
fn mirrored(op: Comparison) -> Comparison {
    match op {
        Comparison::Less => Comparison::Greater,
        Comparison::LessEqual => Comparison::GreaterEqual,
        Comparison::Greater => Comparison::Less,
        Comparison::GreaterEqual => Comparison::LessEqual,
        other => other,
    }
}

fn variable(term: &Term) -> Option<usize> {
    match term {
        Term::Variable(id) => Some(id.index()),
        _ => None,
    }
}
