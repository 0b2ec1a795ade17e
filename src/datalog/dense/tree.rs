//! Searches for values of three or more variables.
//!
//! ```text
//! P(x) :- R(x, a), R(a, b), R(b, c), S(c, d), T(a, c).
//!
//! the tree, last eliminated variable first        the table of a branch holds for
//!   a           R(x, a)
//!   +- c        T(a, c)                            a
//!      +- b     R(a, b), R(b, c)                   c, and a
//!      +- d     S(c, d)                            c
//! ```
//!
//! Variable elimination at compile time makes the variables a tree ([`super::body`]). The values of a branch depend on
//! the variables of its separator only: that of its parent and some earlier ones. A table holds for which of these the
//! branch has values, so each combination is searched once, and only if the search reaches it. The values of the parent
//! are the bits of a row, so one operation decides all that are known. Tables that do not depend on the head's first
//! variable stay valid for all its values.
//!
//! A search that takes more than a few steps is interrupted, to make the domains of the variables arc-consistent
//! first: once for all values of the head's first variable, then for the present one. Most searches that fail fail
//! there, without a step. This removes no value that is part of a solution, so tables stay valid: if the values of a
//! separator are in their domains, so are those of the branches that they allow.
// Decision: docs/decisions/executors.md#d040

use crate::dense::program::{Branch, Dense, Range};
use crate::dense::search::{BinaryFacts, ValueSearch};
use crate::dense::sets::{Set, and, has, is_empty, members, only, or, without};
use std::fmt;

/// A run took more steps than [`Dense::steps_max`] allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManySteps {
    /// The maximum number of steps.
    pub limit: u64,
}

impl fmt::Display for TooManySteps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a clause with many variables took more than {} steps", self.limit)
    }
}

impl std::error::Error for TooManySteps {}

/// The maximum size of a table in words. A branch without a table is searched for each combination of values; a table
/// over two variables always fits.
const TABLE_WORDS: usize = 1 << 19;

/// The knowledge of a branch, for the values of the other variables of its separator.
#[derive(Clone, Debug)]
struct BranchRow<const W: usize> {
    /// The generation that wrote the row; it is empty in other generations.
    generation: u64,
    /// The values of the parent for which the branch has values.
    yes: Set<W>,
    /// The values of the parent for which it has none.
    no: Set<W>,
}

/// The tables of searches, and the number of their steps.
#[derive(Clone, Debug)]
pub(super) struct Tables<const W: usize> {
    rows: Vec<BranchRow<W>>,
    /// The values of each branch that satisfy the conditions on the variable alone and on it and the head's first one.
    domains: Vec<Set<W>>,
    /// The values of each branch that may be part of a solution for some value of the head's first variable.
    reduced: Vec<Set<W>>,
    /// The first row of each branch; `None` without a table.
    starts: Vec<Option<usize>>,
    generation: u64,
    steps: u64,
    limit: u64,
}

impl<const W: usize> Tables<W> {
    pub fn new() -> Self {
        Tables {
            rows: Vec::new(),
            domains: Vec::new(),
            reduced: Vec::new(),
            starts: Vec::new(),
            generation: 0,
            steps: 0,
            limit: 0,
        }
    }

    /// Starts counting steps.
    #[inline]
    pub fn begin_run(&mut self, limit: u64) {
        (self.steps, self.limit) = (0, limit);
    }

    /// Returns the number of steps since [`Tables::begin_run`].
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Returns whether the steps were within the limit.
    #[inline]
    pub fn end_run(&self) -> Result<(), TooManySteps> {
        match self.steps > self.limit {
            true => Err(TooManySteps { limit: self.limit }),
            false => Ok(()),
        }
    }

    /// Makes empty tables for the branches of a search.
    fn begin_search(&mut self, branches: &[Branch], program: &Dense, count: usize) {
        let row_words = 2 * W;
        let mut end = 0;
        self.starts.clear();
        for branch in branches {
            let others = program.numbers(branch.others).len();
            let size = (0..others).try_fold(1_usize, |size, _| size.checked_mul(count));
            let size = size.filter(|size| size.saturating_mul(row_words) <= TABLE_WORDS || others <= 1);
            self.starts.push(size.map(|_| end));
            end += size.unwrap_or(0);
        }
        if self.rows.len() < end {
            let row = BranchRow {
                generation: 0,
                yes: [0; W],
                no: [0; W],
            };
            self.rows.resize(end, row);
        }
        self.generation += 1;
    }
}

/// A search for values of the variables of a tree.
pub(super) struct TreeSearch<'a, const W: usize, P> {
    search: ValueSearch<'a, W, P>,
    branches: &'a [Branch],
    tables: &'a mut Tables<W>,
    /// The generation of tables that do not depend on the head's first variable.
    lasting: u64,
    /// The value of the head's first variable, then those of the branches.
    bound: [usize; Dense::VARIABLES_MAX + 1],
    /// The number of steps at which the search is interrupted.
    interrupt: u64,
    /// Whether a search was interrupted, so that `tables` holds reduced sets of values.
    is_reduced: bool,
    /// Whether the search fails for all values of the head's first variable.
    fails: bool,
    stopped: bool,
}

impl<'a, const W: usize, P: BinaryFacts<W>> TreeSearch<'a, W, P> {
    pub fn new(search: ValueSearch<'a, W, P>, tables: &'a mut Tables<W>, branches: Range) -> Self {
        let branches = search.program.branches(branches);
        tables.begin_search(branches, search.program, search.count);
        TreeSearch {
            branches,
            lasting: tables.generation,
            tables,
            bound: [0; Dense::VARIABLES_MAX + 1],
            interrupt: u64::MAX,
            is_reduced: false,
            fails: false,
            stopped: false,
            search,
        }
    }

    /// Returns the members of `demand` for which all branches have values.
    pub fn exists(&mut self, demand: Set<W>) -> Set<W> {
        let mut found = [0; W];
        let of_head = self.branches[0].of_head;
        for ego in members(&demand) {
            let succeeds = self.begin(ego) && self.succeeds();
            if !of_head {
                return if succeeds { demand } else { found };
            }
            if succeeds {
                found[ego / 64] |= 1 << (ego % 64);
            }
            if self.fails {
                break;
            }
        }
        found
    }

    /// Returns the values of the root for which the other branches have values.
    pub fn values(&mut self, ego: usize) -> Set<W> {
        self.reduce();
        if self.fails || !self.begin(ego) || !self.make_consistent() {
            return [0; W];
        }
        let mut set = self.tables.domains[0];
        for value in members(&set) {
            if !self.fits(0, value) {
                set = without(set, &only(value));
            }
        }
        set
    }

    /// Binds the head's first variable; returns false if some branch has no value for it.
    fn begin(&mut self, ego: usize) -> bool {
        self.bound[0] = ego;
        self.tables.generation += 1;
        let Tables { domains, reduced, .. } = &mut *self.tables;
        domains.clear();
        self.branches.iter().enumerate().all(|(place, branch)| {
            let among = match self.is_reduced {
                true => reduced[place],
                false => self.search.sets[branch.among.index()],
            };
            let to_head = self.search.program.tests(branch.to_head);
            let domain = self.search.pass(to_head, among, &self.bound);
            domains.push(domain);
            !is_empty(&domain)
        })
    }

    /// Whether all branches have values.
    fn succeeds(&mut self) -> bool {
        // Some of the steps that consistency takes.
        let tests: usize = self
            .branches
            .iter()
            .map(|branch| self.search.program.tests(branch.to_others).len())
            .sum();
        self.interrupt = self.tables.steps + (tests * self.search.count / 16) as u64;
        let found = self.has_values(0);
        let is_hard = self.tables.steps > self.interrupt;
        self.interrupt = u64::MAX;
        if !is_hard || self.is_over() {
            return found;
        }
        self.stopped = false;
        self.reduce();
        !self.fails && self.make_consistent() && self.has_values(0)
    }

    /// Reduces the values of all branches to those that are arc-consistent whatever the head's first variable is.
    fn reduce(&mut self) {
        if self.is_reduced {
            return;
        }
        self.is_reduced = true;
        let sets = self.search.sets;
        let mut reduced = std::mem::take(&mut self.tables.reduced);
        reduced.clear();
        reduced.extend(self.branches.iter().map(|branch| sets[branch.among.index()]));
        self.fails = !self.revise(&mut reduced);
        for (domain, reduced) in self.tables.domains.iter_mut().zip(&reduced) {
            *domain = and(*domain, reduced);
        }
        self.tables.reduced = reduced;
    }

    /// Makes the domains arc-consistent, or nearly so. Returns false if some domain becomes empty.
    fn make_consistent(&mut self) -> bool {
        let mut domains = std::mem::take(&mut self.tables.domains);
        let consistent = self.revise(&mut domains);
        self.tables.domains = domains;
        consistent
    }

    /// Removes values that fit no value of some other variable, in a few rounds. Returns false if some domain becomes
    /// empty.
    fn revise(&mut self, domains: &mut [Set<W>]) -> bool {
        const ROUNDS: usize = 2;
        for _ in 0..ROUNDS {
            let mut changed = false;
            for (place, branch) in self.branches.iter().enumerate() {
                let tests = self.search.program.tests(branch.to_others);
                // All conditions on the same two variables at once: `R(a, b), R(b, a)` fails if `R` is an order.
                for tests in tests.chunk_by(|one, other| one.to == other.to) {
                    let to = tests[0].to;
                    let (domain, others) = (domains[place], domains[to - 1]);
                    let (mut fitting, mut fitted) = ([0; W], [0; W]);
                    for value in members(&others) {
                        self.bound[to] = value;
                        let values = self.search.pass(tests, domain, &self.bound);
                        if !is_empty(&values) {
                            fitting = or(fitting, &values);
                            fitted[value / 64] |= 1 << (value % 64);
                        }
                    }
                    if is_empty(&fitting) {
                        return false;
                    }
                    changed |= fitting != domain || fitted != others;
                    (domains[place], domains[to - 1]) = (fitting, fitted);
                }
            }
            if !changed || self.search.pairs.cancelled() {
                break;
            }
        }
        true
    }

    /// Counts a step; returns false to give up.
    #[inline]
    fn may_step(&mut self) -> bool {
        if !self.stopped {
            self.tables.steps += 1;
            self.stopped = self.tables.steps > self.interrupt || self.is_over();
        }
        !self.stopped
    }

    #[inline]
    fn is_over(&self) -> bool {
        self.tables.steps > self.tables.limit || self.search.pairs.cancelled()
    }

    /// Whether a branch and its descendants have values, given the values of its separator.
    fn has_values(&mut self, branch: usize) -> bool {
        if !self.may_step() {
            return false;
        }
        let Branch {
            to_others, children, ..
        } = self.branches[branch];
        let tests = self.search.program.tests(to_others);
        let set = self.search.pass(tests, self.tables.domains[branch], &self.bound);
        let (mut open, mut sure) = (set, set);
        for &child in self.search.program.numbers(children) {
            match self.row(child) {
                Some(row) => {
                    let row = &self.tables.rows[row];
                    let known = row.generation == self.generation_of(child);
                    sure = if known { and(sure, &row.yes) } else { [0; W] };
                    open = if known { without(open, &row.no) } else { open };
                }
                None => sure = [0; W],
            }
        }
        !is_empty(&sure) || members(&open).any(|value| self.fits(branch, value))
    }

    /// Whether all children of a branch have values if this is the value of its variable.
    fn fits(&mut self, branch: usize, value: usize) -> bool {
        self.bound[branch + 1] = value;
        let children = self.search.program.numbers(self.branches[branch].children);
        children.iter().all(|&child| self.child_has_values(child, value))
    }

    /// Looks up in its table whether a branch has values, or searches them. `value` is that of the parent.
    fn child_has_values(&mut self, branch: usize, value: usize) -> bool {
        let Some(at) = self.row(branch) else {
            return self.has_values(branch);
        };
        let generation = self.generation_of(branch);
        let row = &mut self.tables.rows[at];
        if row.generation != generation {
            *row = BranchRow {
                generation,
                yes: [0; W],
                no: [0; W],
            };
        } else if has(&row.yes, value) {
            return true;
        } else if has(&row.no, value) {
            return false;
        }
        let holds = self.has_values(branch);
        if self.stopped {
            return false;
        }
        let row = &mut self.tables.rows[at];
        let set = if holds { &mut row.yes } else { &mut row.no };
        set[value / 64] |= 1 << (value % 64);
        holds
    }

    /// Returns the row of a branch's table for the bound values; `None` without a table.
    #[inline]
    fn row(&self, branch: usize) -> Option<usize> {
        let others = self.search.program.numbers(self.branches[branch].others);
        let row = |row, &other: &usize| row * self.search.count + self.bound[other];
        Some(self.tables.starts[branch]? + others.iter().fold(0, row))
    }

    #[inline]
    fn generation_of(&self, branch: usize) -> u64 {
        match self.branches[branch].of_head {
            true => self.tables.generation,
            false => self.lasting,
        }
    }
}
