//! Binary facts, and searches for values of one or two variables.

use crate::dense::program::{Argument, Dense, Place, Range, SearchStep, Test};
use crate::dense::sets::{Set, and, has, is_empty, members, only, without};

/// A source of binary facts, which it may compute lazily.
pub trait BinaryFacts<const W: usize> {
    /// Returns the members of `among` that a list relates to entity `at`. `list` is a position in [`Dense::lists`].
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W>;

    /// Polls for cancellation. Once it returns true, the results are meaningless.
    #[inline]
    fn cancelled(&self) -> bool {
        false
    }

    /// Returns the members of `demand` that all lists relate to the same member of `among`.
    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let mut found = [0; W];
        for at in members(&demand) {
            let mut set = among;
            for list in lists {
                set = self.narrow(list, at, set);
                if is_empty(&set) {
                    break;
                }
            }
            if !is_empty(&set) {
                found[at / 64] |= 1 << (at % 64);
            }
        }
        found
    }
}

/// Prepares a search.
pub(super) fn search<'a, const W: usize, P>(
    program: &'a Dense,
    sets: &'a [Set<W>],
    rows: &'a [Set<W>],
    count: usize,
    pairs: &'a P,
) -> ValueSearch<'a, W, P> {
    ValueSearch {
        program,
        sets,
        rows,
        count,
        pairs,
    }
}

/// A search for values of variables.
pub(super) struct ValueSearch<'a, const W: usize, P> {
    pub program: &'a Dense,
    pub sets: &'a [Set<W>],
    rows: &'a [Set<W>],
    pub count: usize,
    pub pairs: &'a P,
}

impl<const W: usize, P: BinaryFacts<W>> ValueSearch<'_, W, P> {
    /// Returns the members of `demand` for which all steps have values.
    #[inline(never)]
    pub fn exists(&self, demand: Set<W>, steps: Range) -> Set<W> {
        let mut found = [0; W];
        let steps = self.program.steps(steps);
        if steps.iter().any(|step| is_empty(&self.sets[step.among.index()])) {
            return found;
        }
        for ego in members(&demand) {
            let set = self.narrow(&steps[0], &[ego]);
            let holds = match steps.get(1) {
                Some(second) => members(&set).any(|value| self.has_value(second, ego, value)),
                None => !is_empty(&set),
            };
            if holds {
                found[ego / 64] |= 1 << (ego % 64);
            }
        }
        found
    }

    /// Returns the values of the first step for which the second one, if any, has a value.
    pub fn values(&self, ego: usize, steps: &[SearchStep]) -> Set<W> {
        let mut set = self.sets[steps[0].among.index()];
        for test in self.program.tests(steps[0].tests) {
            // A test of no values would still look for what is in reach.
            if is_empty(&set) {
                return set;
            }
            set = self.pass(std::slice::from_ref(test), set, &[ego]);
        }
        if let Some(second) = steps.get(1) {
            for value in members(&set) {
                if !self.has_value(second, ego, value) {
                    set = without(set, &only(value));
                }
            }
        }
        set
    }

    /// Whether the second step has a value.
    fn has_value(&self, second: &SearchStep, ego: usize, value: usize) -> bool {
        !self.pairs.cancelled() && !is_empty(&self.narrow(second, &[ego, value]))
    }

    /// Returns the values that a step allows, given the bound values.
    #[inline]
    pub fn narrow(&self, step: &SearchStep, bound: &[usize]) -> Set<W> {
        self.pass(self.program.tests(step.tests), self.sets[step.among.index()], bound)
    }

    /// Returns the members of a set that pass tests, given the bound values.
    // The compiler would call it otherwise, since it has several callers.
    #[inline(always)]
    pub fn pass(&self, tests: &[Test], mut set: Set<W>, bound: &[usize]) -> Set<W> {
        for test in tests {
            let at = bound[test.to];
            let fitting = match test.list {
                Place::Input(list) => self.pairs.narrow(list, at, set),
                Place::Derived(list, Argument::Second) => {
                    let fitting = and(set, &self.rows[list * self.count + at]);
                    // Most rows have few members, and the tests that follow compute facts.
                    if test.holds && is_empty(&fitting) {
                        return fitting;
                    }
                    fitting
                }
                Place::Derived(list, Argument::First) => {
                    let mut fitting = [0; W];
                    for member in members(&set) {
                        if has(&self.rows[list * self.count + member], at) {
                            fitting[member / 64] |= 1 << (member % 64);
                        }
                    }
                    fitting
                }
                Place::Same => and(set, &only(at)),
            };
            set = match test.holds {
                true => fitting,
                false => without(set, &fitting),
            };
        }
        set
    }
}
