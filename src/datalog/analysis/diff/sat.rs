//! A small solver for propositional clauses: conflict-driven, with two watched literals a clause.
//!
//! Deterministic, and bounded by a number of conflicts. A variable that nothing forces is tried as false first, so models have few
//! true variables.

/// A variable or its negation: `2 * variable + negated`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Lit(u32);

impl Lit {
    fn new(variable: u32, negated: bool) -> Lit {
        Lit(2 * variable + u32::from(negated))
    }

    fn variable(self) -> usize {
        (self.0 / 2) as usize
    }

    fn index(self) -> usize {
        self.0 as usize
    }

    fn is_negated(self) -> bool {
        self.0 % 2 == 1
    }
}

impl std::ops::Not for Lit {
    type Output = Lit;

    fn not(self) -> Lit {
        Lit(self.0 ^ 1)
    }
}

/// What a search came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// There is a model; see [`Solver::is_true`].
    Satisfiable,
    /// There is none.
    Unsatisfiable,
    /// The conflicts were used up.
    Unknown,
}

const NO_REASON: u32 = u32::MAX;

/// Clauses and a search for a model of all of them.
#[derive(Clone, Default)]
pub(super) struct Solver {
    clauses: Vec<Vec<Lit>>,
    /// By literal: the clauses that watch it, to be looked at when it becomes false.
    watches: Vec<Vec<u32>>,
    /// By variable.
    value: Vec<Option<bool>>,
    saved: Vec<bool>,
    level: Vec<u32>,
    reason: Vec<u32>,
    activity: Vec<f64>,
    seen: Vec<bool>,
    trail: Vec<Lit>,
    /// Length of the trail when each decision was made.
    decisions: Vec<usize>,
    head: usize,
    bump: f64,
    heap: Heap,
    contradiction: bool,
    /// The model of the last search that found one.
    model: Vec<bool>,
}

impl Solver {
    pub(super) fn new() -> Solver {
        Solver {
            bump: 1.0,
            ..Solver::default()
        }
    }

    pub(super) fn fresh(&mut self) -> Lit {
        let variable = self.value.len();
        self.value.push(None);
        self.saved.push(false);
        self.level.push(0);
        self.reason.push(NO_REASON);
        self.activity.push(0.0);
        self.seen.push(false);
        self.watches.push(Vec::new());
        self.watches.push(Vec::new());
        self.heap.insert(variable, &self.activity);
        Lit::new(variable as u32, false)
    }

    fn holds(&self, lit: Lit) -> Option<bool> {
        self.value[lit.variable()].map(|value| value != lit.is_negated())
    }

    /// Whether the literal is true in the model found last.
    pub(super) fn is_true(&self, lit: Lit) -> bool {
        self.model
            .get(lit.variable())
            .is_some_and(|&value| value != lit.is_negated())
    }

    /// Adds a clause: one of the literals holds.
    pub(super) fn add(&mut self, lits: &[Lit]) {
        self.undo(0);
        let mut clause = lits.to_vec();
        clause.sort_unstable();
        clause.dedup();
        if clause.windows(2).any(|pair| pair[0] == !pair[1]) {
            return;
        }
        if clause.iter().any(|&lit| self.holds(lit) == Some(true)) {
            return;
        }
        clause.retain(|&lit| self.holds(lit).is_none());
        match clause.as_slice() {
            [] => self.contradiction = true,
            &[unit] => {
                self.assign(unit, NO_REASON);
                self.contradiction |= self.propagate().is_some();
            }
            _ => _ = self.attach(clause),
        }
    }

    fn attach(&mut self, clause: Vec<Lit>) -> u32 {
        let id = self.clauses.len() as u32;
        self.watches[clause[0].index()].push(id);
        self.watches[clause[1].index()].push(id);
        self.clauses.push(clause);
        id
    }

    fn assign(&mut self, lit: Lit, reason: u32) {
        let variable = lit.variable();
        self.value[variable] = Some(!lit.is_negated());
        self.level[variable] = self.decisions.len() as u32;
        self.reason[variable] = reason;
        self.trail.push(lit);
    }

    fn undo(&mut self, level: usize) {
        let Some(&length) = self.decisions.get(level) else {
            return;
        };
        for lit in self.trail.drain(length..) {
            let variable = lit.variable();
            self.saved[variable] = self.value[variable] == Some(true);
            self.value[variable] = None;
            self.heap.insert(variable, &self.activity);
        }
        self.decisions.truncate(level);
        self.head = self.trail.len();
    }

    /// Draws all consequences of what is assigned; a clause that is false, if there is one.
    fn propagate(&mut self) -> Option<u32> {
        while let Some(&lit) = self.trail.get(self.head) {
            self.head += 1;
            let gone = !lit;
            let mut watching = std::mem::take(&mut self.watches[gone.index()]);
            let mut kept = 0;
            let mut conflict = None;
            let mut at = 0;
            while at < watching.len() {
                let id = watching[at];
                at += 1;
                let clause = &mut self.clauses[id as usize];
                if clause[0] == gone {
                    clause.swap(0, 1);
                }
                let value = |lit: Lit| self.value[lit.variable()].map(|value| value != lit.is_negated());
                let first = clause[0];
                if value(first) == Some(true) {
                    watching[kept] = id;
                    kept += 1;
                    continue;
                }
                if let Some(other) = (2..clause.len()).find(|&other| value(clause[other]) != Some(false)) {
                    clause.swap(1, other);
                    let watched = clause[1];
                    self.watches[watched.index()].push(id);
                    continue;
                }
                watching[kept] = id;
                kept += 1;
                if value(first) == Some(false) {
                    conflict = Some(id);
                    break;
                }
                self.assign(first, id);
            }
            while at < watching.len() {
                watching[kept] = watching[at];
                kept += 1;
                at += 1;
            }
            watching.truncate(kept);
            self.watches[gone.index()] = watching;
            if conflict.is_some() {
                return conflict;
            }
        }
        None
    }

    /// The clause learnt from a conflict, its asserting literal first, and the level to go back to.
    fn analyse(&mut self, conflict: u32) -> (Vec<Lit>, usize) {
        let present = self.decisions.len() as u32;
        let mut learnt = vec![Lit(0)];
        let mut open = 0;
        let mut reason = conflict;
        let mut at = self.trail.len();
        let mut skip: Option<Lit> = None;
        loop {
            for index in 0..self.clauses[reason as usize].len() {
                let lit = self.clauses[reason as usize][index];
                let variable = lit.variable();
                if Some(lit) == skip || self.seen[variable] || self.level[variable] == 0 {
                    continue;
                }
                self.seen[variable] = true;
                self.activity[variable] += self.bump;
                self.heap.raise(variable, &self.activity);
                if self.level[variable] == present {
                    open += 1;
                } else {
                    learnt.push(lit);
                }
            }
            let lit = loop {
                at -= 1;
                let lit = self.trail[at];
                if self.seen[lit.variable()] {
                    break lit;
                }
            };
            self.seen[lit.variable()] = false;
            open -= 1;
            if open == 0 {
                learnt[0] = !lit;
                break;
            }
            skip = Some(lit);
            reason = self.reason[lit.variable()];
        }
        for lit in &learnt[1..] {
            self.seen[lit.variable()] = false;
        }
        self.bump /= 0.95;
        if self.bump > 1e100 {
            self.activity.iter_mut().for_each(|activity| *activity *= 1e-100);
            self.bump *= 1e-100;
        }
        let highest = (1..learnt.len()).max_by_key(|&index| self.level[learnt[index].variable()]);
        let back = highest.map_or(0, |index| {
            learnt.swap(1, index);
            self.level[learnt[1].variable()] as usize
        });
        (learnt, back)
    }

    /// Looks for a model in which the assumptions hold. Every conflict takes one of `conflicts`.
    pub(super) fn solve(&mut self, assumptions: &[Lit], conflicts: &mut u64) -> Outcome {
        self.undo(0);
        if self.contradiction || self.propagate().is_some() {
            self.contradiction = true;
            return Outcome::Unsatisfiable;
        }
        let mut since_restart = 0;
        let mut restart_after = 100;
        loop {
            if let Some(conflict) = self.propagate() {
                if self.decisions.is_empty() {
                    self.contradiction = true;
                    return Outcome::Unsatisfiable;
                }
                let Some(left) = conflicts.checked_sub(1) else {
                    return Outcome::Unknown;
                };
                *conflicts = left;
                since_restart += 1;
                let (learnt, back) = self.analyse(conflict);
                self.undo(back);
                let first = learnt[0];
                let reason = if learnt.len() == 1 {
                    NO_REASON
                } else {
                    self.attach(learnt)
                };
                self.assign(first, reason);
                continue;
            }
            if since_restart >= restart_after {
                since_restart = 0;
                restart_after += restart_after / 2;
                self.undo(0);
                continue;
            }
            if let Some(&wanted) = assumptions.get(self.decisions.len()) {
                match self.holds(wanted) {
                    Some(false) => return Outcome::Unsatisfiable,
                    Some(true) => self.decisions.push(self.trail.len()),
                    None => {
                        self.decisions.push(self.trail.len());
                        self.assign(wanted, NO_REASON);
                    }
                }
                continue;
            }
            let next = loop {
                match self.heap.pop(&self.activity) {
                    Some(variable) if self.value[variable].is_some() => {}
                    other => break other,
                }
            };
            let Some(variable) = next else {
                self.model = self.value.iter().map(|value| *value == Some(true)).collect();
                return Outcome::Satisfiable;
            };
            self.decisions.push(self.trail.len());
            self.assign(Lit::new(variable as u32, !self.saved[variable]), NO_REASON);
        }
    }
}

/// Variables by activity, the most active on top; of equal ones the earlier.
#[derive(Clone, Default)]
struct Heap {
    list: Vec<usize>,
    /// By variable: its position in the list.
    position: Vec<Option<usize>>,
}

impl Heap {
    fn above(a: usize, b: usize, activity: &[f64]) -> bool {
        activity[a].total_cmp(&activity[b]).reverse().then(a.cmp(&b)).is_lt()
    }

    fn insert(&mut self, variable: usize, activity: &[f64]) {
        if self.position.len() <= variable {
            self.position.resize(variable + 1, None);
        }
        if self.position[variable].is_none() {
            self.position[variable] = Some(self.list.len());
            self.list.push(variable);
            self.up(self.list.len() - 1, activity);
        }
    }

    fn raise(&mut self, variable: usize, activity: &[f64]) {
        if let Some(at) = self.position[variable] {
            self.up(at, activity);
        }
    }

    fn swap(&mut self, a: usize, b: usize) {
        self.list.swap(a, b);
        self.position[self.list[a]] = Some(a);
        self.position[self.list[b]] = Some(b);
    }

    fn up(&mut self, mut at: usize, activity: &[f64]) {
        while at > 0 && Heap::above(self.list[at], self.list[(at - 1) / 2], activity) {
            self.swap(at, (at - 1) / 2);
            at = (at - 1) / 2;
        }
    }

    fn pop(&mut self, activity: &[f64]) -> Option<usize> {
        let top = *self.list.first()?;
        let last = self.list.len() - 1;
        self.swap(0, last);
        self.list.pop();
        self.position[top] = None;
        let mut at = 0;
        loop {
            let mut best = at;
            for child in [2 * at + 1, 2 * at + 2] {
                if child < self.list.len() && Heap::above(self.list[child], self.list[best], activity) {
                    best = child;
                }
            }
            if best == at {
                return Some(top);
            }
            self.swap(at, best);
            at = best;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The solver against trying everything.
        #[test]
        fn finds_a_model_exactly_if_there_is_one(
            clauses in proptest::collection::vec(proptest::collection::vec((0..8_u32, any::<bool>()), 1..4), 0..40),
            assumed in proptest::collection::vec((0..8_u32, any::<bool>()), 0..3),
        ) {
            let mut solver = Solver::new();
            let variables: Vec<Lit> = (0..8).map(|_| solver.fresh()).collect();
            let lit = |&(variable, negated): &(u32, bool)| {
                let lit = variables[variable as usize];
                if negated { !lit } else { lit }
            };
            for clause in &clauses {
                solver.add(&clause.iter().map(lit).collect::<Vec<_>>());
            }
            let holds = |bits: u32, &(variable, negated): &(u32, bool)| (bits >> variable & 1 == 1) != negated;
            let model = |bits: &u32| {
                clauses.iter().all(|clause| clause.iter().any(|part| holds(*bits, part)))
                    && assumed.iter().all(|part| holds(*bits, part))
            };
            let assumptions: Vec<Lit> = assumed.iter().map(lit).collect();
            let outcome = solver.solve(&assumptions, &mut 10_000);
            let exists = (0..256).any(|bits| model(&bits));
            prop_assert_eq!(outcome, if exists { Outcome::Satisfiable } else { Outcome::Unsatisfiable });
            if exists {
                let bits = (0..8).map(|variable| u32::from(solver.is_true(variables[variable])) << variable).sum::<u32>();
                prop_assert!(model(&bits));
            }
            // Asked again without assumptions.
            let exists = (0..256_u32).any(|bits| clauses.iter().all(|clause| clause.iter().any(|part| holds(bits, part))));
            let outcome = solver.solve(&[], &mut 10_000);
            prop_assert_eq!(outcome, if exists { Outcome::Satisfiable } else { Outcome::Unsatisfiable });
        }
    }
}
