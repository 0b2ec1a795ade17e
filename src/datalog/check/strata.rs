//! Stratification: the order of evaluation, and the check that no predicate depends on its own negation. Predicates
//! that depend on each other form one stratum, which comes after everything it depends on.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use crate::codes;
use crate::diag::{Diagnostic, Faults, counted};

use crate::check::clauses::{Edge, EdgeKind};
use crate::check::names::Names;
use crate::check::rules::{Clause, ClauseId, Predicate, PredicateId, Stratum};

/// Maximum number of cycles reported in one component.
const MAX_CYCLES: usize = 8;

/// Maximum number of steps that the diagnostic of a cycle shows.
const SHOWN_MAX: usize = 16;

/// Reports cycles through negation or aggregation. For each such atom on a cycle this is the shortest cycle through it,
/// unless a reported cycle already contains it.
pub(crate) fn check(edges: &[Edge], names: &Names, faults: &mut Faults) {
    let count = names.predicates.len();
    let mut out: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (index, edge) in edges.iter().enumerate() {
        out[edge.from.index()].push(index);
    }
    let successors: Vec<Vec<usize>> = out
        .iter()
        .map(|list| list.iter().map(|&edge| edges[edge].to.index()).collect())
        .collect();
    let (component, components) = components(&successors);
    let mut covered = vec![false; edges.len()];
    let mut reported = vec![0_usize; components];
    for (index, edge) in edges.iter().enumerate() {
        if faults.full() {
            return;
        }
        let home = component[edge.from.index()];
        if edge.kind == EdgeKind::Needs
            || component[edge.to.index()] != home
            || covered[index]
            || reported[home] >= MAX_CYCLES
        {
            continue;
        }
        reported[home] += 1;
        let back = shortest(edge.to.index(), edge.from.index(), edges, &out, &component);
        covered[index] = true;
        for &step in &back {
            covered[step] = true;
        }
        let what = match edge.kind {
            EdgeKind::Aggregates => "an aggregate over itself",
            _ => "its own negation",
        };
        let (about, through) = about(edge, &back, edges, names);
        let message = match through.as_str() {
            "" => format!("{about} depends on {what}"),
            _ => format!("{about} depends on {what}, through {through}"),
        };
        let shown = |id: PredicateId| shown(names.predicate(id));
        let step = |edge: &Edge| {
            let (from, to) = (shown(edge.from), shown(edge.to));
            let need = match names.predicate(edge.from).is_numbered() {
                true => "need",
                false => "needs",
            };
            match edge.kind {
                EdgeKind::Needs => format!("{from} {need} {to}"),
                EdgeKind::Negates => format!("{from} {need} that {to} does not hold"),
                EdgeKind::Aggregates => format!("{from} {need} all of {to}"),
            }
        };
        let mut fault = Diagnostic::new(codes::CYCLIC_NEGATION, message).at(edge.span, step(edge));
        for &at in back.iter().take(SHOWN_MAX) {
            fault = fault.also(edges[at].span, step(&edges[at]));
        }
        if back.len() > SHOWN_MAX {
            fault = fault.note(match back.len() - SHOWN_MAX {
                1 => "1 further step of the cycle is not shown".to_owned(),
                more => format!("{more} further steps of the cycle are not shown"),
            });
        }
        let help = match edge.kind {
            _ if [edge.from, edge.to].iter().any(|&id| names.predicate(id).is_numbered()) => {
                "remove one of these steps".to_owned()
            }
            EdgeKind::Aggregates => {
                let from = shown(edge.from);
                format!("aggregate over a predicate that does not depend on {from}")
            }
            _ => {
                let (from, to) = (shown(edge.from), shown(edge.to));
                format!("define {to} without {from}, or remove one of these steps")
            }
        };
        let looks_back = |edge: &Edge| names.predicate(edge.to).hidden && names.predicate(edge.to).name.contains(' ');
        if looks_back(edge) || back.iter().any(|&step| looks_back(&edges[step])) {
            fault = fault.help("a window that begins with 0 contains the present tick; let it begin with 1");
        }
        faults.push(
            fault
                .help(help)
                .note("a negated atom or an aggregate needs the complete predicate first, so no cycle may contain one"),
        );
    }
}

/// Returns what messages call a predicate.
fn shown(predicate: &Predicate) -> String {
    match predicate.is_numbered() {
        true => predicate.title().to_owned(),
        false => format!("`{}`", predicate.name),
    }
}

/// Returns the first declared predicate of a cycle, and the others.
fn about(edge: &Edge, back: &[usize], edges: &[Edge], names: &Names) -> (String, String) {
    let cycle = std::iter::once(edge.from).chain(std::iter::once(edge.to));
    let mut cycle: Vec<PredicateId> = cycle.chain(back.iter().map(|&step| edges[step].to)).collect();
    // It ends where it begins.
    cycle.pop();
    let first = cycle
        .iter()
        .position(|&id| !names.predicate(id).is_numbered())
        .unwrap_or(0);
    cycle.rotate_left(first);
    let about = shown(names.predicate(cycle[0]));
    cycle.retain(|&id| !names.predicate(id).is_numbered());
    let between = cycle.get(1..).unwrap_or_default();
    let mut through: Vec<String> = (between.iter().take(SHOWN_MAX))
        .map(|&id| shown(names.predicate(id)))
        .collect();
    if between.len() > SHOWN_MAX {
        through.push(counted(between.len() - SHOWN_MAX, "other"));
    }
    (about, through.join(" and "))
}

/// Returns the edges of a shortest path between two predicates of one component.
fn shortest(from: usize, to: usize, edges: &[Edge], out: &[Vec<usize>], component: &[usize]) -> Vec<usize> {
    let mut came_by: Vec<Option<usize>> = vec![None; out.len()];
    let mut queue = VecDeque::from([from]);
    while let Some(at) = queue.pop_front() {
        if at == to {
            break;
        }
        for &edge in &out[at] {
            let next = edges[edge].to.index();
            if component[next] == component[from] && next != from && came_by[next].is_none() {
                came_by[next] = Some(edge);
                queue.push_back(next);
            }
        }
    }
    let mut way = Vec::new();
    let mut at = to;
    while at != from {
        let Some(edge) = came_by[at] else { break };
        way.push(edge);
        at = edges[edge].from.index();
    }
    way.reverse();
    way
}

/// Returns the strongly connected components of a graph: the component of each node, and their number. A component has
/// a higher number than every component it reaches.
pub(crate) fn components(successors: &[Vec<usize>]) -> (Vec<usize>, usize) {
    const UNSEEN: usize = usize::MAX;
    let count = successors.len();
    let mut index = vec![UNSEEN; count];
    let mut low = vec![0_usize; count];
    let mut component = vec![UNSEEN; count];
    let mut components = 0;
    let mut next_index = 0;
    let mut stack = Vec::new();
    // Tarjan's algorithm with an explicit stack, so that long chains of predicates do not overflow the call stack.
    let mut calls: Vec<(usize, usize)> = Vec::new();
    for root in 0..count {
        if index[root] != UNSEEN {
            continue;
        }
        calls.push((root, 0));
        while let Some((node, child)) = calls.pop() {
            if child == 0 {
                index[node] = next_index;
                low[node] = next_index;
                next_index += 1;
                stack.push(node);
            }
            match successors[node].get(child) {
                Some(&next) => {
                    calls.push((node, child + 1));
                    if index[next] == UNSEEN {
                        calls.push((next, 0));
                    } else if component[next] == UNSEEN {
                        low[node] = low[node].min(index[next]);
                    }
                }
                None => {
                    if low[node] == index[node] {
                        while let Some(member) = stack.pop() {
                            component[member] = components;
                            if member == node {
                                break;
                            }
                        }
                        components += 1;
                    }
                    if let Some(&(parent, _)) = calls.last() {
                        low[parent] = low[parent].min(low[node]);
                    }
                }
            }
        }
    }
    (component, components)
}

/// Returns the strata of the predicates with clauses, in topological order. Ties go to the predicate that is declared
/// first. A predicate with parameters has no stratum: the strata of its readers evaluate it.
pub(crate) fn order(predicates: &[Predicate], clauses: &[Clause]) -> Vec<Stratum> {
    let mut successors: Vec<Vec<usize>> = vec![Vec::new(); predicates.len()];
    let mut defining: Vec<Vec<ClauseId>> = vec![Vec::new(); predicates.len()];
    for (index, clause) in clauses.iter().enumerate() {
        let head = clause.head.predicate.index();
        if predicates[head].parameters == 0 {
            defining[head].push(ClauseId(u32::try_from(index).expect("fewer than 2^32 clauses")));
        }
        for literal in &clause.body {
            if let Some(atom) = literal.atom() {
                successors[head].push(atom.predicate.index());
            }
        }
    }
    for (predicate, successors) in predicates.iter().zip(&mut successors) {
        successors.extend(predicate.subsumption.map(PredicateId::index));
        let before = predicate.numbering.iter().flat_map(|numbering| &numbering.before);
        successors.extend(before.map(|(of, _)| of.index()));
    }
    let (component, count) = components(&successors);
    let mut members: Vec<Vec<PredicateId>> = vec![Vec::new(); count];
    for predicate in 0..predicates.len() {
        members[component[predicate]].push(PredicateId(
            u32::try_from(predicate).expect("fewer than 2^32 predicates"),
        ));
    }
    let mut waiting = vec![0_usize; count];
    let mut dependants: Vec<Vec<usize>> = vec![Vec::new(); count];
    let mut recursive = vec![false; count];
    for (predicate, list) in successors.iter().enumerate() {
        for &needed in list {
            let (home, other) = (component[predicate], component[needed]);
            if home == other {
                recursive[home] = true;
            } else {
                waiting[home] += 1;
                dependants[other].push(home);
            }
        }
    }
    let rank = |stratum: usize| Reverse((members[stratum][0], stratum));
    let mut ready: BinaryHeap<_> = (0..count).filter(|&stratum| waiting[stratum] == 0).map(rank).collect();
    let mut strata = Vec::new();
    while let Some(Reverse((_, stratum))) = ready.pop() {
        for &dependant in &dependants[stratum] {
            waiting[dependant] -= 1;
            if waiting[dependant] == 0 {
                ready.push(rank(dependant));
            }
        }
        let mut own: Vec<ClauseId> = members[stratum]
            .iter()
            .flat_map(|id| defining[id.index()].iter().copied())
            .collect();
        if own.is_empty() {
            continue;
        }
        own.sort_unstable();
        strata.push(Stratum {
            predicates: members[stratum].clone(),
            clauses: own,
            recursive: recursive[stratum],
        });
    }
    strata
}
