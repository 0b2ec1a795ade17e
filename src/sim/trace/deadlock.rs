//! Finds waits between agents, and deadlocks.
//!
//! An agent waits for another if a clause of `Stop` holds for it under a binding that names the other. Every derivation
//! of `Stop` counts, not one proof: an agent moves again only when all of them are gone. Agents that do not move and
//! wait for each other in a cycle are deadlocked: none of them moves unless another agent changes the situation.
// Decision: docs/decisions/analysis.md#d032

use crate::city::Action;
use crate::datalog::explain::{ExplainError, Explainer};
use crate::datalog::{BaseType, Clause, ClauseId, Literal, Rules, Term};
use crate::sim::tick::simulation::Snapshot;
use std::collections::{BTreeSet, VecDeque};

/// Ticks without a move after which an agent counts as stuck. A cycle of stuck agents is a deadlock.
pub const STUCK_TICKS: u64 = 50;

/// The number of ticks between searches for waits.
pub const LOOK_TICKS: u64 = 10;

/// A wait: one agent stops because of a clause that names another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct WaitsFor {
    /// The waiting agent: position in the list of agents.
    pub agent: usize,
    /// The agent it waits for.
    pub on: usize,
    /// The clause of `Stop`.
    pub clause: ClauseId,
}

/// The reasons why stuck agents do not move.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeadlockReport {
    /// Deadlocks: the waits of a shortest cycle, in order.
    pub deadlocks: Vec<Vec<WaitsFor>>,
    /// Stuck agents that wait for no stuck agent: they wait for moving agents, or for none.
    pub starving: Vec<usize>,
    /// The other stuck agents, each with its chain of waits to a deadlock or, if there is none, to a starving agent.
    pub behind: Vec<Vec<WaitsFor>>,
}

/// Returns the waits of `agents` in a state, sorted.
///
/// # Errors
/// If enumerating the derivations of `Stop` exceeds the limit of [`Explainer`].
pub fn waits(snapshot: &Snapshot<'_>, agents: &[usize]) -> Result<Vec<WaitsFor>, ExplainError> {
    let Some(stop) = snapshot.world().vocabulary.action(Action::Stop) else {
        return Ok(Vec::new());
    };
    let session = snapshot.session();
    let rules = session.program().rules();
    let mut explainer = Explainer::new(session);
    let mut waits = BTreeSet::new();
    for &agent in agents {
        for (clause, binding) in explainer.derivations(stop, &[snapshot.value(agent)])? {
            let named = symbols(rules, &rules.clauses[clause.index()]);
            let values = binding
                .iter()
                .enumerate()
                .filter(|(variable, _)| named.contains(variable));
            for on in values.filter_map(|(_, value)| snapshot.agent((*value)?)) {
                if on != agent {
                    waits.insert(WaitsFor { agent, on, clause });
                }
            }
        }
    }
    Ok(waits.into_iter().collect())
}

/// Returns the variables of a clause that have the base type symbol.
fn symbols(rules: &Rules, clause: &Clause) -> BTreeSet<usize> {
    let mut found = BTreeSet::new();
    for literal in &clause.body {
        if let Literal::Positive(atom) | Literal::Guard(atom) = literal {
            let columns = &rules.predicates[atom.predicate.index()].columns;
            for (term, column) in atom.terms.iter().zip(columns) {
                if let (Term::Variable(variable), BaseType::Symbol) = (term, column.base) {
                    found.insert(variable.index());
                }
            }
        }
    }
    found
}

/// Classifies `stuck` agents, given their waits in ascending order. Deterministic, with sorted results.
pub fn find_deadlocks(stuck: &[usize], waits: &[WaitsFor]) -> DeadlockReport {
    let among: Vec<WaitsFor> = (waits.iter().copied())
        .filter(|wait| stuck.contains(&wait.agent) && stuck.contains(&wait.on))
        .collect();
    let mut result = DeadlockReport::default();
    let mut in_cycle = BTreeSet::new();
    for &agent in stuck {
        if in_cycle.contains(&agent) {
            continue;
        }
        // The shortest path back to the agent is the shortest cycle through it.
        let Some(cycle) = way(&among, agent, |other| other == agent) else {
            continue;
        };
        // Of the cycles that share an agent, the shortest is reported.
        let shortest = (cycle.iter())
            .filter_map(|wait| way(&among, wait.agent, |other| other == wait.agent))
            .min_by_key(Vec::len)
            .unwrap_or(cycle);
        let mut members: Vec<usize> = shortest.iter().map(|wait| wait.agent).collect();
        if members.iter().any(|member| in_cycle.contains(member)) {
            continue;
        }
        let first = members
            .iter()
            .min()
            .and_then(|least| members.iter().position(|member| member == least));
        let mut cycle = shortest;
        cycle.rotate_left(first.unwrap_or(0));
        in_cycle.extend(members.drain(..));
        result.deadlocks.push(cycle);
    }
    let rest: Vec<usize> = stuck
        .iter()
        .copied()
        .filter(|agent| !in_cycle.contains(agent))
        .collect();
    let (waiting, starving): (Vec<usize>, Vec<usize>) =
        (rest.into_iter()).partition(|agent| among.iter().any(|wait| wait.agent == *agent));
    for agent in waiting {
        let to_cycle = way(&among, agent, |other| in_cycle.contains(&other));
        result
            .behind
            .extend(to_cycle.or_else(|| way(&among, agent, |other| starving.contains(&other))));
    }
    result.starving = starving;
    result
}

/// Returns a shortest path of at least one wait from an agent to one for which `found` holds.
fn way(waits: &[WaitsFor], from: usize, found: impl Fn(usize) -> bool) -> Option<Vec<WaitsFor>> {
    // The wait by which the search reached each agent.
    let mut reached: Vec<WaitsFor> = Vec::new();
    let mut queue = VecDeque::from([from]);
    while let Some(agent) = queue.pop_front() {
        let first = waits.partition_point(|wait| wait.agent < agent);
        for &wait in waits[first..].iter().take_while(|wait| wait.agent == agent) {
            if found(wait.on) {
                let mut way = vec![wait];
                let mut at = agent;
                while at != from {
                    let before = reached.iter().find(|wait| wait.on == at)?;
                    way.push(*before);
                    at = before.agent;
                }
                way.reverse();
                return Some(way);
            }
            if wait.on != from && reached.iter().all(|other| other.on != wait.on) {
                reached.push(wait);
                queue.push_back(wait.on);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waits(pairs: &[(usize, usize)]) -> Vec<WaitsFor> {
        let clause = ClauseId(0);
        let mut waits: Vec<WaitsFor> = pairs
            .iter()
            .map(|&(agent, on)| WaitsFor { agent, on, clause })
            .collect();
        waits.sort_unstable();
        waits
    }

    fn agents(waits: &[WaitsFor]) -> Vec<usize> {
        waits.iter().map(|wait| wait.agent).collect()
    }

    #[test]
    fn deadlocks_blocked_and_starving_agents_are_distinguished() {
        // 1 <-> 2; 1 -> 4 -> 1 is no shorter; 3 waits for 4; 5 for 6, which moves; 7 for none; 8 -> 9 -> 10 -> 8; 11
        // for 5.
        let pairs = [
            (1, 2),
            (2, 1),
            (1, 4),
            (4, 1),
            (3, 4),
            (5, 6),
            (8, 9),
            (9, 10),
            (10, 8),
            (11, 5),
        ];
        let found = find_deadlocks(&[1, 2, 3, 4, 5, 7, 8, 9, 10, 11], &waits(&pairs));
        let lists = |list: &[Vec<WaitsFor>]| list.iter().map(|way| agents(way)).collect::<Vec<_>>();
        assert_eq!(lists(&found.deadlocks), [vec![1, 2], vec![8, 9, 10]]);
        assert_eq!(lists(&found.behind), [vec![3, 4], vec![4], vec![11]]);
        assert_eq!(found.starving, [5, 7]);
    }

    #[test]
    fn a_cycle_of_moving_agents_is_no_deadlock() {
        let found = find_deadlocks(&[1], &waits(&[(1, 2), (2, 1)]));
        assert!(found.deadlocks.is_empty() && found.starving == [1]);
    }
}
