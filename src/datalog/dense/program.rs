//! The program of the dense executor: a list of operations on numbered sets.

use crate::check::{ClauseId, PredicateId};

/// The number of a set in a [`BitState`](super::BitState).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Reg(u32);

impl Reg {
    /// All entities.
    pub const ALL: Reg = Reg(0);
    /// The egos: the entities to decide about.
    pub const EGOS: Reg = Reg(1);
    /// The first input; the others follow.
    pub const INPUTS: Reg = Reg(2);

    pub fn new(number: usize) -> Reg {
        Reg(u32::try_from(number).expect("fewer than 2^32 sets"))
    }

    #[inline]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A slice of one of the program's lists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Range {
    start: u32,
    end: u32,
}

impl Range {
    /// Appends items to a list and returns their range.
    pub fn extend<T>(list: &mut Vec<T>, items: Vec<T>) -> Range {
        let end = |list: &[T]| u32::try_from(list.len()).expect("fewer than 2^32 items");
        let start = end(list);
        list.extend(items);
        Range { start, end: end(list) }
    }

    #[inline]
    fn cut<T>(self, list: &[T]) -> &[T] {
        &list[self.start as usize..self.end as usize]
    }
}

/// The demand of a search: the members of both `left` and `right` that are not in `dst` yet. The operation adds those
/// for which the search succeeds to `dst`.
#[derive(Clone, Copy, Debug)]
pub(super) struct DemandOp {
    pub dst: Reg,
    pub left: Reg,
    pub right: Reg,
}

/// The counts from `low` to `high`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Bounds {
    pub low: u32,
    pub high: u32,
}

impl Bounds {
    pub fn contain(self, count: u32) -> bool {
        (self.low..=self.high).contains(&count)
    }
}

/// A search for a member of `among` that all lists relate to an entity. Lists are positions in [`Dense::lists`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Any<const N: usize> {
    pub among: Reg,
    pub lists: [u16; N],
}

impl<const N: usize> Any<N> {
    pub fn new(among: Reg, lists: [u16; N]) -> Self {
        Any { among, lists }
    }
}

/// One operation.
#[derive(Clone, Copy, Debug)]
pub(super) enum Op {
    /// Writes the intersection.
    Both {
        dst: Reg,
        left: Reg,
        right: Reg,
    },
    /// Writes the members of `left` that are not in `right`.
    Without {
        dst: Reg,
        left: Reg,
        right: Reg,
    },
    /// Adds the intersection.
    Add {
        dst: Reg,
        left: Reg,
        right: Reg,
    },
    Any0(DemandOp, Any<0>),
    Any1(DemandOp, Any<1>),
    Any2(DemandOp, Any<2>),
    Any3(DemandOp, Any<3>),
    /// A search for a value of each of one or two steps.
    Exists(DemandOp, Range),
    /// A rarely used operation, by its position in [`Dense::rare`]. The others are small without it.
    Rare(u32),
}

/// A rarely used operation.
#[derive(Clone, Copy, Debug)]
pub(super) enum Rare {
    /// For each member of `demand`: adds the values of the first step for which the second one, if any, has a value to
    /// its row.
    Rows { dst: usize, demand: Reg, steps: Range },
    /// A search for a value of each branch of a tree.
    ExistsTree(DemandOp, Range),
    /// For each member of `demand`: adds the values of the root for which the other branches have values to its row.
    RowsTree { dst: usize, demand: Reg, branches: Range },
    /// Adds all rows of `from`.
    OrRows { dst: usize, from: usize },
    /// Writes the entities that their own row contains.
    Diagonal { dst: Reg, rows: usize },
    /// Writes the members of `demand` with a number of related entities within bounds. `test` has one condition.
    Count {
        dst: Reg,
        demand: Reg,
        test: Range,
        bounds: Bounds,
    },
}

/// A step of a search: finds the values of one variable. The head's first variable and those of earlier steps are
/// bound.
#[derive(Clone, Copy, Debug)]
pub(super) struct SearchStep {
    /// The values that satisfy the conditions on this variable alone.
    pub among: Reg,
    /// The conditions that relate it to bound variables.
    pub tests: Range,
}

/// A step of a search in a tree. Branch `n` of a tree binds variable `n + 1`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Branch {
    /// The values that satisfy the conditions on this variable alone.
    pub among: Reg,
    /// The conditions that relate it to the head's first variable.
    pub to_head: Range,
    /// The conditions that relate it to variables of other branches, sorted by these.
    pub to_others: Range,
    /// The positions of the children in the tree, in [`Dense::numbers`].
    pub children: Range,
    /// The variables of the separator besides the head's first and the parent's, in [`Dense::numbers`].
    pub others: Range,
    /// Whether the branch depends on the head's first variable.
    pub of_head: bool,
}

/// A condition that relates a value to a bound variable.
#[derive(Clone, Copy, Debug)]
pub(super) struct Test {
    pub list: Place,
    /// 0 is the head's first variable, `n` that of step `n - 1`.
    pub to: usize,
    pub holds: bool,
}

/// The row of the bound variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Place {
    /// A position in [`Dense::lists`].
    Input(usize),
    /// A list of derived rows, and the column of the value.
    Derived(usize, Argument),
    /// The variable itself.
    Same,
}

/// A column of a two-column predicate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Argument {
    /// The first column.
    First,
    /// The second column.
    Second,
}

impl Argument {
    /// Returns the other column.
    pub(super) fn other(self) -> Argument {
        match self {
            Argument::First => Argument::Second,
            Argument::Second => Argument::First,
        }
    }
}

/// An input set, which the caller provides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Input {
    /// The entities of a one-column predicate.
    Unary(PredicateId),
    /// The entities that a two-column predicate relates to themselves.
    Diagonal(PredicateId),
}

/// An input list, which the caller provides: for each value of one column of the predicate, the values of the named
/// other column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct List(pub PredicateId, pub Argument);

/// Whether a run records what each clause derives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackFirings {
    /// No. A clause then evaluates only heads that are not derived yet.
    Off,
    /// Yes, for each clause.
    Each,
}

/// A compiled program of the dense executor.
#[derive(Clone, Debug)]
pub struct Dense {
    pub(super) inputs: Vec<Input>,
    pub(super) lists: Vec<List>,
    pub(super) set_count: usize,
    pub(super) row_lists: usize,
    pub(super) steps: Vec<SearchStep>,
    pub(super) tests: Vec<Test>,
    pub(super) branches: Vec<Branch>,
    pub(super) numbers: Vec<usize>,
    /// The number of `inputs` that change often; these come first.
    pub(super) restless: usize,
    /// The operations that depend on steady inputs only.
    pub(super) settling: Vec<Op>,
    pub(super) ops: Vec<Op>,
    pub(super) rare: Vec<Rare>,
    /// The sets that operations only add to; each run clears them.
    pub(super) cleared: Vec<Reg>,
    /// By [`PredicateId`]: the location of its facts.
    pub(super) homes: Vec<Home>,
    /// By [`ClauseId`]: the location of what it derives, if firings are tracked.
    pub(super) fired: Vec<Option<Fired>>,
    pub(super) local: bool,
    pub(super) guards: Vec<PredicateId>,
}

/// The location of a predicate's facts.
#[derive(Clone, Copy, Debug)]
pub(super) enum Home {
    /// With the caller.
    Input,
    Set(Reg),
    Rows(usize),
}

/// The location of what one clause derives.
#[derive(Clone, Copy, Debug)]
pub(super) enum Fired {
    Set(Reg),
    Rows(usize),
}

impl Dense {
    /// The maximum number of variables that a search binds, the head's included.
    pub(super) const VARIABLES_MAX: usize = 24;

    /// Returns the maximum number of steps of one run over this many entities. A step finds the values of one variable
    /// of a search over three or more; other work is at most cubic in the number of entities.
    pub fn steps_max(entities: usize) -> u64 {
        const PER_PAIR: u64 = 256;
        let entities = entities.max(64) as u64;
        PER_PAIR * entities * entities
    }

    /// Returns the input sets, in the order of [`super::BitState::set_input`].
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// Returns the input lists; see [`super::BinaryFacts`].
    pub fn lists(&self) -> &[List] {
        &self.lists
    }

    /// Returns whether the program is local: conditions on derived predicates concern only the head's first variable.
    /// Then the results for one entity do not depend on those for others, and a run can evaluate a subset of the
    /// entities.
    pub fn is_local(&self) -> bool {
        self.local
    }

    /// Returns whether every clause reads only entities that the predicate relates to its head's first variable. If the
    /// program is also [local](Dense::is_local), a run can omit entities that the predicate relates to no ego.
    pub fn is_guarded_by(&self, predicate: PredicateId) -> bool {
        self.guards.contains(&predicate)
    }

    pub(super) fn rare(&self, op: u32) -> &Rare {
        &self.rare[op as usize]
    }

    #[inline]
    pub(super) fn steps(&self, range: Range) -> &[SearchStep] {
        range.cut(&self.steps)
    }

    #[inline]
    pub(super) fn tests(&self, range: Range) -> &[Test] {
        range.cut(&self.tests)
    }

    pub(super) fn branches(&self, range: Range) -> &[Branch] {
        range.cut(&self.branches)
    }

    #[inline]
    pub(super) fn numbers(&self, range: Range) -> &[usize] {
        range.cut(&self.numbers)
    }

    pub(super) fn set_of(&self, predicate: PredicateId) -> Option<Reg> {
        match self.homes.get(predicate.index()) {
            Some(Home::Set(set)) => Some(*set),
            _ => None,
        }
    }

    pub(super) fn rows_of(&self, predicate: PredicateId) -> Option<usize> {
        match self.homes.get(predicate.index()) {
            Some(Home::Rows(rows)) => Some(*rows),
            _ => None,
        }
    }

    pub(super) fn fired(&self, clause: ClauseId) -> Option<Reg> {
        match self.fired.get(clause.index()) {
            Some(Some(Fired::Set(set))) => Some(*set),
            _ => None,
        }
    }

    pub(super) fn fired_rows(&self, clause: ClauseId) -> Option<usize> {
        match self.fired.get(clause.index()) {
            Some(Some(Fired::Rows(rows))) => Some(*rows),
            _ => None,
        }
    }
}
