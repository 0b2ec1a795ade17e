//! Heights of derived facts, and the derivation of minimal height of each.

use crate::check::{Atom, Clause, ClauseId, Literal, PredicateId, Rules};
use crate::explain::ExplainError;
use crate::explain::search::{Attempt, Binding, ProofSearch, bind_head, unify, value};
use crate::value::Value;
use std::collections::{BTreeMap, HashMap};

/// The known heights.
pub(super) struct Heights {
    /// The facts of the source, each with the first clause that states it.
    source: HashMap<(PredicateId, Vec<Value>), ClauseId>,
    /// The position of the stratum of each derived predicate, by [`PredicateId`].
    stratum: Vec<Option<usize>>,
    /// The heights of derived facts that some goal rests on, by predicate and row position.
    relevant: HashMap<(PredicateId, u32), u32>,
    /// The derivations found so far.
    best: HashMap<(PredicateId, Vec<Value>), (u32, Best)>,
    /// The heights of whole strata, by stratum position. Used where too much is relevant to a goal.
    progress: HashMap<usize, Progress>,
}

/// Facts, by predicate and position, with their heights.
type Settled = Vec<((PredicateId, u32), u32)>;

/// Limits of the backward search from one goal: clause instances, and steps to find them.
const INSTANCES_MAX: usize = 500_000;
const RELEVANT_STEPS: u64 = 5_000_000;

/// A stratum in which the search settles heights in ascending order.
#[derive(Default)]
struct Progress {
    /// The heights by predicate and row position.
    heights: HashMap<PredicateId, Vec<Height>>,
    /// The facts to settle, by their height so far.
    queue: BTreeMap<u32, Vec<(PredicateId, u32)>>,
}

#[derive(Clone, Copy)]
struct Height {
    height: u32,
    settled: bool,
}

/// The origin of a fact.
#[derive(Clone)]
pub(in crate::explain) enum Best {
    Input,
    /// Its premises were removed.
    Removed,
    Source(ClauseId),
    Derived {
        clause: ClauseId,
        binding: Binding,
        /// Indexed by literal of the body: the row that matches a positive literal.
        rows: Vec<Option<Vec<Value>>>,
    },
}

impl Heights {
    pub(super) fn new(rules: &Rules) -> Self {
        let mut stratum = vec![None; rules.predicates.len()];
        for (position, members) in rules.strata.iter().enumerate() {
            for predicate in &members.predicates {
                if rules.predicates[predicate.index()].derived {
                    stratum[predicate.index()] = Some(position);
                }
            }
        }
        let mut source = HashMap::new();
        for (clause, id) in rules.clauses.iter().zip(0..) {
            if clause.body.is_empty() {
                let row: Option<Vec<Value>> = clause.head.terms.iter().map(|term| value(term, &[])).collect();
                if let Some(row) = row {
                    source.entry((clause.head.predicate, row)).or_insert(ClauseId(id));
                }
            }
        }
        Heights {
            source,
            stratum,
            relevant: HashMap::new(),
            best: HashMap::new(),
            progress: HashMap::new(),
        }
    }

    /// Returns the height of a row, if it is settled.
    fn of(&self, id: PredicateId, position: u32) -> Option<u32> {
        let Some(stratum) = self.stratum[id.index()] else {
            return Some(0);
        };
        if let Some(&height) = self.relevant.get(&(id, position)) {
            return Some(height);
        }
        let height = self.progress.get(&stratum)?.heights.get(&id)?[position as usize];
        height.settled.then_some(height.height)
    }
}

/// Returns the atoms that must hold for the clause to fire.
fn positive(clause: &Clause) -> impl Iterator<Item = (usize, &Atom)> {
    let body = clause.body.iter().enumerate();
    body.filter_map(|(literal, body)| match body {
        Literal::Positive(atom) | Literal::Guard(atom) => Some((literal, atom)),
        _ => None,
    })
}

impl ProofSearch<'_> {
    /// Returns the height of a fact that holds, and the derivation that gives it.
    pub(in crate::explain) fn origin(&mut self, id: PredicateId, row: &[Value]) -> Result<(u32, Best), ExplainError> {
        let fact = (id, row.to_vec());
        if let Some(&clause) = self.heights.source.get(&fact) {
            return Ok((0, Best::Source(clause)));
        }
        let Some(stratum) = self.heights.stratum[id.index()] else {
            return Ok((0, Best::Input));
        };
        if let Some(found) = self.heights.best.get(&fact) {
            return Ok(found.clone());
        }
        let found = self.derivation(stratum, id, row)?;
        self.heights.best.insert(fact, found.clone());
        Ok(found)
    }

    /// Returns the height and derivation of a derived fact that is not in the source.
    fn derivation(
        &mut self,
        stratum: usize,
        predicate: PredicateId,
        row: &[Value],
    ) -> Result<(u32, Best), ExplainError> {
        let rules = self.rules();
        let clauses = self.clauses_of(predicate);
        let goal = self.position(predicate, row)?.map(|position| (predicate, position));
        let known = goal.is_some_and(|(predicate, position)| self.heights.of(predicate, position).is_some());
        if known || goal.is_some_and(|goal| self.settle_relevant(goal)) {
            // In this case the heights of all premises are known too.
        } else if rules.strata[stratum].recursive {
            self.settle_below(&rules.strata[stratum].clauses)?;
            self.settle(stratum, goal)?;
        } else {
            self.settle_below(&clauses)?;
        }

        let mut best: Option<(u32, ClauseId, Binding, Vec<Option<u32>>)> = None;
        for id in clauses {
            let clause = &rules.clauses[id.index()];
            let mut binding: Binding = vec![None; clause.variables.len()];
            let pattern: Vec<_> = row.iter().copied().map(Some).collect();
            if clause.body.is_empty() || bind_head(clause, &pattern, &mut binding).is_err() {
                continue;
            }
            let mut attempt = Attempt::new(clause, &vec![true; clause.body.len()], binding, 0);
            // Clauses come in source order, so the first clause of minimal height wins.
            let bar = best.as_ref().map_or(u32::MAX, |(height, ..)| *height);
            let heights = &self.heights;
            let usable = |predicate, position| heights.of(predicate, position).is_some_and(|height| height + 1 < bar);
            self.advance(&mut attempt, &usable, &mut |solution| {
                let height = 1 + highest(clause, solution.rows, |predicate, position| {
                    heights.of(predicate, position)
                });
                let better = best.as_ref().is_none_or(|(least, by, binding, rows)| {
                    (height, id, solution.binding, solution.rows) < (*least, *by, binding, rows)
                });
                if better && height < bar {
                    best = Some((height, id, solution.binding.to_vec(), solution.rows.to_vec()));
                }
                true
            })?;
        }
        let Some((height, clause, binding, rows)) = best else {
            // A session holds only derived facts in derived predicates, so a subsumption has removed premises.
            return Ok((0, Best::Removed));
        };
        let body = &rules.clauses[clause.index()].body;
        let rows = body.iter().zip(rows).map(|(literal, row)| match (literal, row) {
            (Literal::Positive(atom) | Literal::Guard(atom), Some(position)) => {
                Some(self.row(atom.predicate, position).to_vec())
            }
            _ => None,
        });
        let rows = rows.collect();
        Ok((height, Best::Derived { clause, binding, rows }))
    }

    /// Computes the heights of all facts that a derivation of the goal could rest on. First collects all clause
    /// instances backwards from the goal, then computes heights forwards. Returns `false` without a change if that
    /// exceeds its limits.
    fn settle_relevant(&mut self, goal: (PredicateId, u32)) -> bool {
        let outer = self.left();
        let inner = RELEVANT_STEPS.min(outer / 2);
        self.set_left(inner);
        let found = self.relevant(goal);
        self.set_left(outer - (inner - self.left()));
        match found {
            Ok(Some(heights)) => {
                self.heights.relevant.extend(heights);
                true
            }
            Ok(None) | Err(_) => false,
        }
    }

    fn relevant(&self, goal: (PredicateId, u32)) -> Result<Option<Settled>, ExplainError> {
        let rules = self.rules();
        let mut facts = vec![goal];
        let mut ids = HashMap::from([(goal, 0)]);
        // By instance: the fact it derives, and the number of unsettled facts it needs.
        let mut instances: Vec<(usize, usize)> = Vec::new();
        // By fact: the instances that need it.
        let mut users: Vec<Vec<usize>> = vec![Vec::new()];
        let mut queue: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        let mut next = 0;
        while let Some(&(predicate, position)) = facts.get(next) {
            let head = next;
            next += 1;
            let row = self.row(predicate, position);
            if let Some(height) = self.heights.of(predicate, position) {
                queue.entry(height).or_default().push(head);
                continue;
            }
            if self.heights.source.contains_key(&(predicate, row.to_vec())) {
                queue.entry(0).or_default().push(head);
                continue;
            }
            let pattern: Vec<_> = row.iter().copied().map(Some).collect();
            for id in self.clauses_of(predicate) {
                let clause = &rules.clauses[id.index()];
                let mut binding: Binding = vec![None; clause.variables.len()];
                if clause.body.is_empty() || bind_head(clause, &pattern, &mut binding).is_err() {
                    continue;
                }
                let mut attempt = Attempt::new(clause, &vec![true; clause.body.len()], binding, 0);
                self.advance(&mut attempt, &|_, _| true, &mut |solution| {
                    let mut needed: Vec<usize> = Vec::new();
                    for (literal, atom) in positive(clause) {
                        let derived = self.heights.stratum[atom.predicate.index()].is_some();
                        if let (true, Some(position)) = (derived, solution.rows[literal]) {
                            let fact = (atom.predicate, position);
                            let id = *ids.entry(fact).or_insert_with(|| {
                                facts.push(fact);
                                users.push(Vec::new());
                                facts.len() - 1
                            });
                            if !needed.contains(&id) {
                                needed.push(id);
                            }
                        }
                    }
                    needed.iter().for_each(|&id| users[id].push(instances.len()));
                    if needed.is_empty() {
                        queue.entry(1).or_default().push(head);
                    }
                    instances.push((head, needed.len()));
                    instances.len() < INSTANCES_MAX
                })?;
                if instances.len() >= INSTANCES_MAX {
                    return Ok(None);
                }
            }
        }
        let mut heights: Vec<Option<u32>> = vec![None; facts.len()];
        while let Some((height, ready)) = queue.pop_first() {
            for fact in ready {
                if heights[fact].is_some() {
                    continue;
                }
                heights[fact] = Some(height);
                for &instance in &users[fact] {
                    let (head, missing) = &mut instances[instance];
                    *missing -= 1;
                    if *missing == 0 {
                        queue.entry(height + 1).or_default().push(*head);
                    }
                }
            }
        }
        let settled = facts.into_iter().zip(heights);
        Ok(Some(
            settled.filter_map(|(fact, height)| Some((fact, height?))).collect(),
        ))
    }

    /// Settles all facts of the lower strata that the clauses need, directly or through others.
    fn settle_below(&mut self, clauses: &[ClauseId]) -> Result<(), ExplainError> {
        let rules = self.rules();
        let own = clauses
            .first()
            .and_then(|clause| self.heights.stratum[rules.clauses[clause.index()].head.predicate.index()]);
        let mut needed = Vec::new();
        let mut todo: Vec<&[ClauseId]> = vec![clauses];
        while let Some(clauses) = todo.pop() {
            for clause in clauses {
                for (_, atom) in positive(&rules.clauses[clause.index()]) {
                    if let Some(stratum) = self.heights.stratum[atom.predicate.index()]
                        && Some(stratum) != own
                        && !needed.contains(&stratum)
                    {
                        needed.push(stratum);
                        todo.push(&rules.strata[stratum].clauses);
                    }
                }
            }
        }
        needed.sort_unstable();
        needed.into_iter().try_for_each(|stratum| self.settle(stratum, None))
    }

    /// Settles the facts of a stratum in ascending order, up to `goal` or all of them.
    fn settle(&mut self, stratum: usize, goal: Option<(PredicateId, u32)>) -> Result<(), ExplainError> {
        if let Some((id, position)) = goal
            && self.heights.of(id, position).is_some()
        {
            return Ok(());
        }
        // Removed during the update, so that an error leaves no half-finished state.
        let mut progress = match self.heights.progress.remove(&stratum) {
            Some(progress) => progress,
            None => self.begin(stratum)?,
        };
        let rules = self.rules();
        while let Some((&height, _)) = progress.queue.first_key_value() {
            let facts = progress.queue.remove(&height).unwrap_or_default();
            let mut last = false;
            for (id, position) in facts {
                let known = &mut progress.heights.entry(id).or_default()[position as usize];
                if known.settled {
                    continue;
                }
                known.settled = true;
                last |= goal == Some((id, position));
                if rules.strata[stratum].recursive {
                    self.follow(stratum, id, position, &mut progress)?;
                }
            }
            if last {
                break;
            }
        }
        self.heights.progress.insert(stratum, progress);
        Ok(())
    }

    /// Derives the facts that follow without any fact of the stratum itself.
    fn begin(&mut self, stratum: usize) -> Result<Progress, ExplainError> {
        let rules = self.rules();
        let mut progress = Progress::default();
        let unknown = Height {
            height: u32::MAX,
            settled: false,
        };
        for &predicate in &rules.strata[stratum].predicates {
            progress.heights.insert(predicate, vec![unknown; self.len(predicate)]);
        }
        for &id in &rules.strata[stratum].clauses {
            let clause = &rules.clauses[id.index()];
            let own = |(_, atom): (usize, &Atom)| progress.heights.contains_key(&atom.predicate);
            if !positive(clause).any(own) {
                let attempt = Attempt::new(
                    clause,
                    &vec![true; clause.body.len()],
                    vec![None; clause.variables.len()],
                    0,
                );
                self.derive(attempt, &mut progress)?;
            }
        }
        Ok(progress)
    }

    /// Derives what follows from a newly settled fact and other settled facts.
    fn follow(
        &mut self,
        stratum: usize,
        predicate: PredicateId,
        position: u32,
        progress: &mut Progress,
    ) -> Result<(), ExplainError> {
        let rules = self.rules();
        for &id in &rules.strata[stratum].clauses {
            let clause = &rules.clauses[id.index()];
            for (literal, atom) in positive(clause).filter(|(_, atom)| atom.predicate == predicate) {
                let mut binding: Binding = vec![None; clause.variables.len()];
                if unify(
                    &atom.terms,
                    self.row(predicate, position),
                    &mut binding,
                    &mut Vec::new(),
                ) {
                    let mut attempt = Attempt::new(clause, &vec![true; clause.body.len()], binding, 0);
                    attempt.pending[literal] = false;
                    attempt.rows[literal] = Some(position);
                    self.derive(attempt, progress)?;
                }
            }
        }
        Ok(())
    }

    /// Lowers the heights of the facts that an attempt derives.
    fn derive(&mut self, mut attempt: Attempt<'_>, progress: &mut Progress) -> Result<(), ExplainError> {
        let clause = attempt.clause;
        let mut lower = Vec::new();
        let mut failed = None;
        {
            let of = |id: PredicateId, position: u32| match progress.heights.get(&id) {
                Some(heights) => {
                    let height = heights[position as usize];
                    height.settled.then_some(height.height)
                }
                None => self.heights.of(id, position),
            };
            self.advance(
                &mut attempt,
                &|id, position| of(id, position).is_some(),
                &mut |solution| {
                    let head: Option<Vec<Value>> = (clause.head.terms.iter())
                        .map(|term| value(term, solution.binding))
                        .collect();
                    // A fact of the source has height 0.
                    let height = if clause.body.is_empty() {
                        0
                    } else {
                        1 + highest(clause, solution.rows, of)
                    };
                    let id = clause.head.predicate;
                    let position = head.map_or(Ok(None), |row| self.position(id, &row));
                    let position = position.unwrap_or_else(|error| {
                        failed = Some(error);
                        None
                    });
                    if let Some(position) = position {
                        let known = progress.heights[&id][position as usize];
                        if !known.settled && height < known.height {
                            lower.push((height, position));
                        }
                    }
                    failed.is_none()
                },
            )?;
        }
        if let Some(error) = failed {
            return Err(error);
        }
        let id = clause.head.predicate;
        for (height, position) in lower {
            let known = &mut progress.heights.entry(id).or_default()[position as usize];
            if height < known.height {
                known.height = height;
                progress.queue.entry(height).or_default().push((id, position));
            }
        }
        Ok(())
    }
}

/// Returns the maximal height among the rows that match positive literals.
fn highest(clause: &Clause, rows: &[Option<u32>], of: impl Fn(PredicateId, u32) -> Option<u32>) -> u32 {
    positive(clause)
        .filter_map(|(literal, atom)| of(atom.predicate, rows[literal]?))
        .max()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cancel::Cancel;
    use crate::diag::Sources;
    use crate::program::Program;
    use crate::workspace;

    #[test]
    fn both_ways_to_find_heights_agree() {
        let text = ".decl edge(x: number, y: number)
            .input edge
            .decl hop, path(x: number, y: number)
            .decl round(x: number)
            hop(x, y) :- edge(x, y).
            hop(x, x) :- edge(x, _), !edge(_, x).
            path(3, 9).
            path(x, y) :- hop(x, y).
            path(x, z) :- path(x, y), path(y, z).
            round(x) :- path(x, x).";
        let mut sources = Sources::new();
        let entry = sources.add("heights.dl", text);
        let rules = workspace::load(&mut sources, entry, &|_: &std::path::Path| {
            Err(crate::files::ReadError::NotFound)
        })
        .rules
        .expect("no errors");
        let program = Program::new(rules).expect("within limits");
        let mut session = program.session();
        let edge = program.predicate("edge").expect("declared");
        for [x, y] in [
            [0, 1],
            [1, 2],
            [2, 3],
            [3, 4],
            [4, 5],
            [5, 6],
            [6, 1],
            [9, 2],
            [7, 0],
            [8, 7],
        ] {
            session
                .insert(edge, [Value::number(x), Value::number(y)])
                .expect("a row that fits");
        }
        session.commit().expect("few rows");
        let mut forwards = ProofSearch::new(&session, &Cancel::never());
        forwards.refill(1_000_000);
        for stratum in 0..program.rules().strata.len() {
            forwards.settle(stratum, None).expect("few rows");
        }
        let mut count = 0;
        for name in ["hop", "path", "round"] {
            let id = program.predicate(name).expect("declared");
            for position in 0..u32::try_from(session.len(id)).expect("few rows") {
                let mut backwards = ProofSearch::new(&session, &Cancel::never());
                backwards.refill(1_000_000);
                assert!(backwards.settle_relevant((id, position)));
                let height = forwards.heights.of(id, position);
                assert!(height.is_some());
                assert_eq!(height, backwards.heights.of(id, position));
                let (least, _) = forwards.origin(id, forwards.row(id, position)).expect("few rows");
                assert_eq!(height, Some(least));
                count += 1;
            }
        }
        assert!(count > 50);
    }
}
