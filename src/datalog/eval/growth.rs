//! Recursion that derives new values without end.
//!
//! ```text
//! N(x + 1) :- N(x).       A(x - 1) :- B(x).  B(x) :- A(x).       S(cat(x, "a")) :- S(x).       L([1, x]) :- L(x).
//! ```
//!
//! A graph has a node for each column of a recursive predicate and an edge for each way in which a clause passes a value
//! on. Some edges grow: they compute a new value. A cycle with a growing edge has no end unless a literal bounds a value
//! on it.

use crate::check::strata::components;
use crate::check::{Clause, ClauseId, Literal, PredicateId, Rules, Term, VarId};
use crate::diag::Span;
use crate::symbol::Symbols;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::Functor;
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
type ColumnNode = (PredicateId, usize);

/// A way in which a clause passes a value on.
struct Edge {
    from: ColumnNode,
    to: ColumnNode,
    /// What grows the value.
    growth: Option<(Way, Growth)>,
}

/// Returns a computation without end in the recursion that contains the clause, if there is one.
pub(crate) fn endless(rules: &Rules, clause: ClauseId) -> Option<Growth> {
    let stratum = rules.strata.iter().find(|stratum| stratum.clauses.contains(&clause))?;
    if !stratum.recursive {
        return None;
    }
    let recursive: BTreeSet<PredicateId> = stratum.predicates.iter().copied().collect();
    for way in WAYS {
        let clauses = stratum.clauses.iter().map(|id| &rules.clauses[id.index()]);
        let edges: Vec<Edge> = clauses
            .flat_map(|clause| edges(clause, &recursive, way, &rules.symbols))
            .collect();
        let home = homes(&edges);
        let is_endless = |edge: &Edge| {
            let grows = matches!(edge.growth, Some((found, _)) if found == way);
            grows && home[&edge.from] == home[&edge.to]
        };
        if let Some(edge) = edges.into_iter().find(is_endless) {
            return edge.growth.map(|(_, growth)| growth);
        }
    }
    None
}

/// Returns the strongly connected component of each node. An edge is on a cycle if both its nodes are in one component.
fn homes(edges: &[Edge]) -> BTreeMap<ColumnNode, usize> {
    let nodes: BTreeSet<ColumnNode> = edges.iter().flat_map(|edge| [edge.from, edge.to]).collect();
    let number: BTreeMap<ColumnNode, usize> = nodes.into_iter().zip(0..).collect();
    let mut successors = vec![Vec::new(); number.len()];
    for edge in edges {
        successors[number[&edge.from]].push(number[&edge.to]);
    }
    let (home, _) = components(&successors);
    number.into_iter().map(|(node, at)| (node, home[at])).collect()
}

/// Returns the ways in which the clause passes on values that nothing bounds in this direction.
fn edges(clause: &Clause, recursive: &BTreeSet<PredicateId>, way: Way, symbols: &Symbols) -> Vec<Edge> {
    let mut found = Vec::new();
    for literal in &clause.body {
        let (Literal::Positive(atom) | Literal::Guard(atom)) = literal else {
            continue;
        };
        if !recursive.contains(&atom.predicate) {
            continue;
        }
        for (column, term) in atom.terms.iter().enumerate() {
            let Some(source) = term.variable() else { continue };
            let passed = passed_on(clause, source, symbols);
            if is_bounded(clause, recursive, &passed, way) {
                continue;
            }
            for (to, term) in clause.head.terms.iter().enumerate() {
                let Some(growth) = term.variable().and_then(|id| passed.get(&id)) else {
                    continue;
                };
                let growth = growth.map(|(way, span, base)| {
                    let name = clause.variables.get(source.index()).map_or("x", String::as_str);
                    let bound = match (way, base) {
                        (_, BaseType::Record) => "`n < 100`, where a column `n` counts the steps".to_owned(),
                        (_, BaseType::Symbol) => format!("`strlen({name}) < 100`"),
                        (Way::Down, BaseType::Unsigned) => format!("`{name} > 0`"),
                        (Way::Down, _) => format!("`{name} > -100`"),
                        _ => format!("`{name} < 100`"),
                    };
                    (way, Growth { span, bound })
                });
                found.push(Edge {
                    from: (atom.predicate, column),
                    to: (clause.head.predicate, to),
                    growth,
                });
            }
        }
    }
    found
}

type Passed = BTreeMap<VarId, Option<(Way, Span, BaseType)>>;

/// Returns the variables whose values come from `source`, each with what grew it on the way.
fn passed_on(clause: &Clause, source: VarId, symbols: &Symbols) -> Passed {
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
                        let growth = passed.get(&from.variable()?)?;
                        Some((to.variable()?, *growth)).filter(|(to, _)| !passed.contains_key(to))
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
                    let from = arguments.iter().find_map(|argument| passed.get(&argument.variable()?));
                    let (Some(from), Some(to)) = (from, to.variable()) else {
                        continue;
                    };
                    let own = grows(*functor, *base, arguments, symbols).map(|way| (way, *span, *base));
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
fn grows(functor: Functor, base: BaseType, arguments: &[Term], symbols: &Symbols) -> Option<Way> {
    let sign = |term: &Term| match (term, base) {
        (Term::Constant(value), BaseType::Number) => Some(value.to_number(symbols) < 0),
        (Term::Constant(value), BaseType::Float) => Some(value.to_float(symbols) < 0.0),
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
        (Functor::Cat | Functor::Pack, _) => Some(Way::Up),
        (Functor::Call, _) => Some(Way::Somewhere),
        (Functor::Add, [left, right]) => Some(towards(sign(left).or(sign(right)))),
        (Functor::Subtract, [_, right]) => Some(towards(sign(right).map(|down| !down))),
        (Functor::Multiply | Functor::Power, _) => Some(Way::Somewhere),
        _ => None,
    }
}

/// Returns whether a literal restricts one of the passed values to finitely many, or bounds it in this direction.
fn is_bounded(clause: &Clause, recursive: &BTreeSet<PredicateId>, passed: &Passed, way: Way) -> bool {
    let is_passed = |term: &Term| term.variable().is_some_and(|id| passed.contains_key(&id));
    clause.body.iter().any(|literal| match literal {
        Literal::Positive(atom) | Literal::Guard(atom) => {
            !recursive.contains(&atom.predicate) && atom.terms.iter().any(is_passed)
        }
        Literal::Negative(atom) => atom.terms.iter().any(is_passed),
        Literal::Compare { op, left, right, .. } => match (is_passed(left), is_passed(right)) {
            (true, true) => !matches!(op, Comparison::Equal),
            (true, false) => bounds(*op, way),
            (false, true) => bounds(op.mirrored(), way),
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
