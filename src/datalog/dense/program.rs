//! What the dense executor runs: a list of operations on numbered sets.

use crate::datalog::check::{ClauseId, RelId};

/// A set of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Reg(u32);

impl Reg {
    /// All entities.
    pub const ALL: Reg = Reg(0);
    /// Those that are decided about.
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

/// A piece of one of the program's lists of steps or tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Range {
    start: u32,
    end: u32,
}

impl Range {
    /// Adds items to a list: they are that piece of it.
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

/// The members of both `left` and `right` that are not in `dst` yet. Those for which a search succeeds are added to `dst`.
#[derive(Clone, Copy, Debug)]
pub(super) struct DemandOp {
    pub dst: Reg,
    pub left: Reg,
    pub right: Reg,
}

/// The search for a member of `among` that all lists, positions in [`Dense::lists`], relate to an entity.
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
    /// Writes the members of both.
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
    /// Adds the members of both.
    Add {
        dst: Reg,
        left: Reg,
        right: Reg,
    },
    Any0(DemandOp, Any<0>),
    Any1(DemandOp, Any<1>),
    Any2(DemandOp, Any<2>),
    Any3(DemandOp, Any<3>),
    /// The search for a value of each step.
    Exists(DemandOp, Range),
    Rare(Rare),
}

/// An operation that few programs have.
#[derive(Clone, Copy, Debug)]
pub(super) enum Rare {
    /// Adds, to the row of each member of `demand`, the values of the first step for which the others have one.
    Rows { dst: usize, demand: Reg, steps: Range },
    /// Adds all rows of `from`.
    OrRows { dst: usize, from: usize },
    /// Writes the entities that are in their own row.
    Diagonal { dst: Reg, rows: usize },
}

/// Finds the values of one variable, those of the steps before and of the head's first variable being bound.
#[derive(Clone, Copy, Debug)]
pub(super) struct SearchStep {
    /// Of whom all is true that is asked of it alone.
    pub among: Reg,
    /// What relates it to bound variables.
    pub tests: Range,
}

/// How a value must stand to a bound variable.
#[derive(Clone, Copy, Debug)]
pub(super) struct Test {
    pub list: Place,
    /// 0 is the head's first variable, `n` that of step `n - 1`.
    pub to: usize,
    pub holds: bool,
}

/// Where the row of the bound variable stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Place {
    /// A position in [`Dense::lists`].
    Given(usize),
    /// A list of derived rows, and the column of the value.
    Derived(usize, Argument),
    /// The variable itself.
    Same,
}

/// A column of a predicate with two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Argument {
    /// The first.
    First,
    /// The second.
    Second,
}

/// A set that the caller provides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Input {
    /// The entities of which a predicate with one column holds.
    Unary(RelId),
    /// The entities that a predicate with two columns relates to themselves.
    Diagonal(RelId),
}

/// Rows that the caller provides: for each value of one column of the predicate, the values of the named other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct List(pub RelId, pub Argument);

/// What is kept of the work of single clauses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackFirings {
    /// Nothing: a clause looks only where its predicate is not derived yet.
    Off,
    /// What each clause derives.
    Each,
}

/// A program for the dense executor.
#[derive(Clone, Debug)]
pub struct Dense {
    pub(super) inputs: Vec<Input>,
    pub(super) lists: Vec<List>,
    pub(super) set_count: usize,
    pub(super) row_lists: usize,
    pub(super) steps: Vec<SearchStep>,
    pub(super) tests: Vec<Test>,
    /// How many of `inputs` change often; the others follow.
    pub(super) restless: usize,
    /// What depends on steady inputs only.
    pub(super) settling: Vec<Op>,
    pub(super) ops: Vec<Op>,
    /// The sets that operations only add to.
    pub(super) cleared: Vec<Reg>,
    /// By [`RelId`]: where it is.
    pub(super) homes: Vec<Home>,
    /// By [`ClauseId`]: where what it derives is, if clauses are counted.
    pub(super) fired: Vec<Option<Fired>>,
    pub(super) local: bool,
    pub(super) guards: Vec<RelId>,
}

/// Where a predicate's facts are.
#[derive(Clone, Copy, Debug)]
pub(super) enum Home {
    /// The caller has them.
    Given,
    Set(Reg),
    Rows(usize),
}

/// Where a clause's own facts are.
#[derive(Clone, Copy, Debug)]
pub(super) enum Fired {
    Set(Reg),
    Rows(usize),
}

impl Dense {
    /// Variables that a search binds at a time, the head's included.
    pub(super) const VARIABLES_MAX: usize = 24;

    /// The sets the caller provides, in the order of [`super::BitState::set_input`].
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// The rows the caller provides, see [`super::BinaryFacts`].
    pub fn lists(&self) -> &[List] {
        &self.lists
    }

    /// Whether derived predicates are asked only about the head's first variable. Then what is derived of one entity does not depend
    /// on what is derived of others, and some entities can be decided about without the rest.
    pub fn is_local(&self) -> bool {
        self.local
    }

    /// Whether every clause looks only at what the predicate relates its head's first variable to. If the program is also
    /// [local](Dense::is_local), entities that it relates to none of those that are decided about can be left out.
    pub fn is_guarded_by(&self, relation: RelId) -> bool {
        self.guards.contains(&relation)
    }

    #[inline]
    pub(super) fn steps(&self, range: Range) -> &[SearchStep] {
        range.cut(&self.steps)
    }

    #[inline]
    pub(super) fn tests(&self, range: Range) -> &[Test] {
        range.cut(&self.tests)
    }

    pub(super) fn set_of(&self, relation: RelId) -> Option<Reg> {
        match self.homes.get(relation.index()) {
            Some(Home::Set(set)) => Some(*set),
            _ => None,
        }
    }

    pub(super) fn rows_of(&self, relation: RelId) -> Option<usize> {
        match self.homes.get(relation.index()) {
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
