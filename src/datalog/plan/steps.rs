//! The steps of a plan: for every clause straight lists of [`Step`]s over numbered slots (the clause's variables, then its constants).
//!
//! A scan binds variables, one atom at a time; every other step tests what is already bound, and stands as early as it can.
//!
//! A clause of a recursive stratum has one plan for each of its atoms over that stratum, beginning with the newest rows of it, and
//! *alternatives*, which reach those rows later. The sizes of relations decide in every round which one runs ([`super::estimate`]).
//!
//! For maintenance every clause has one plan for each of its atoms, negated ones included, beginning with the rows that changed, and one
//! that begins with rows of the head and asks whether they can be derived.

use crate::datalog::check::{ClauseId, RelId};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::syntax::functor::{AggregateOp, Functor};
use crate::datalog::value::Value;

/// A place for a value while a clause is evaluated: a variable, or after them a constant.
pub(crate) type Slot = u16;

/// Names an index of [`Indexes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct IndexId(pub(crate) u32);

impl IndexId {
    pub(crate) fn index(self) -> usize {
        self.0 as usize
    }
}

/// An order of a relation's columns. Each index has all columns, so that it can be patched when rows come and go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IndexSpec {
    pub(crate) relation: RelId,
    pub(crate) columns: Vec<u16>,
    /// Among the relation's indexes; 0 for its own rows.
    pub(crate) position: usize,
}

/// The orders in which rows are wanted, each once. The first ones are the relations' own rows, by [`RelId`].
#[derive(Clone, Debug)]
pub(crate) struct Indexes {
    specs: Vec<IndexSpec>,
    /// By [`RelId`]: the indexes of a relation, its own rows first.
    of: Vec<Vec<IndexId>>,
}

impl std::ops::Index<IndexId> for Indexes {
    type Output = IndexSpec;

    fn index(&self, index: IndexId) -> &IndexSpec {
        &self.specs[index.index()]
    }
}

impl Indexes {
    /// The own rows of relations with so many columns.
    pub(crate) fn new(arities: impl Iterator<Item = usize>) -> Self {
        let own = |(arity, number)| own_rows(RelId(number), arity);
        let specs: Vec<IndexSpec> = arities.zip(0..).map(own).collect();
        Indexes {
            of: (0..specs.len() as u32).map(|index| vec![IndexId(index)]).collect(),
            specs,
        }
    }

    /// How many indexes each relation has, by [`RelId`].
    pub(crate) fn counts(&self) -> impl Iterator<Item = usize> {
        self.of.iter().map(Vec::len)
    }

    /// The indexes of a relation, its own rows first.
    pub(crate) fn of(&self, relation: RelId) -> impl Iterator<Item = &IndexSpec> {
        self.of[relation.index()].iter().map(|&index| &self[index])
    }

    /// Whether the index is a relation's own rows.
    pub(crate) fn is_own(&self, index: IndexId) -> bool {
        index.index() < self.of.len()
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.specs.len()
    }

    /// Takes back all but the first ones.
    pub(crate) fn truncate(&mut self, count: usize) {
        self.specs.truncate(count);
        for known in &mut self.of {
            known.retain(|index| index.index() < count);
        }
    }

    /// An index that begins with the columns of each group in turn, within a group in some order, and its order of columns.
    pub(crate) fn prefix(&mut self, relation: RelId, groups: [&[u16]; 2]) -> (IndexId, Vec<u16>) {
        let begins = |order: &[u16]| {
            let (first, rest) = order.split_at(groups[0].len());
            let within = |group: &[u16], part: &[u16]| group.iter().all(|column| part.contains(column));
            within(groups[0], first) && within(groups[1], &rest[..groups[1].len()])
        };
        let known = &mut self.of[relation.index()];
        if let Some(&index) = known.iter().find(|index| begins(&self.specs[index.index()].columns)) {
            return (index, self.specs[index.index()].columns.clone());
        }
        let mut columns = groups.concat();
        let all = self.specs[relation.index()].columns.iter().copied();
        let rest: Vec<u16> = all.filter(|column| !columns.contains(column)).collect();
        columns.extend(rest);
        let index = IndexId(self.specs.len() as u32);
        self.specs.push(IndexSpec {
            relation,
            columns: columns.clone(),
            position: known.len(),
        });
        known.push(index);
        (index, columns)
    }
}

/// A relation's rows in their own order.
fn own_rows(relation: RelId, arity: usize) -> IndexSpec {
    IndexSpec {
        relation,
        columns: (0..arity as u16).collect(),
        position: 0,
    }
}

/// Which rows of a relation are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Version {
    /// Those of the finished relation.
    Complete,
    /// Those known before this round and those new in it.
    All,
    /// Those known before this round.
    Old,
    /// Those new in this round.
    New,
}

/// Where a step finds rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Source {
    pub(crate) index: IndexId,
    pub(crate) version: Version,
}

/// The words that follow the key in the rows that begin with it, sorted.
#[derive(Clone, Debug)]
pub(crate) struct List {
    pub(crate) source: Source,
    pub(crate) key: Vec<Slot>,
}

/// One step of a plan.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    /// For each row that begins with the key and passes the checks, bind and go on.
    Scan {
        source: Source,
        key: Vec<Slot>,
        /// (column of the index, slot to fill).
        bind: Vec<(u16, Slot)>,
        /// (column of the index, slot it must equal); done after binding.
        check: Vec<(u16, Slot)>,
        /// If not 0, only so many columns of the index matter, the first ones: of rows that agree in them one is enough.
        distinct: u16,
    },
    /// For each word that all lists have, fill the slot with it and go on: a leapfrog join of one variable. However skewed the
    /// rows are, it looks at no more of each list than the shortest is long.
    LeapfrogJoin { lists: Vec<List>, to: Slot },
    /// Go on if some row begins with the key.
    Exists { source: Source, key: Vec<Slot> },
    /// Go on if no row begins with the key.
    AntiJoin { source: Source, key: Vec<Slot> },
    /// Fill a slot from another.
    Copy { to: Slot, from: Slot },
    /// Go on if the comparison holds.
    Compare {
        op: Comparison,
        left: Slot,
        right: Slot,
        base: BaseType,
    },
    /// Go on if the functor has a value: the one in the slot if that is a `test`, else fill the slot with it.
    Compute {
        functor: Functor,
        base: BaseType,
        arguments: Vec<Slot>,
        to: Slot,
        test: bool,
    },
    /// The same for the aggregate over the rows that begin with the key.
    Aggregate {
        source: Source,
        key: Vec<Slot>,
        op: AggregateOp,
        base: BaseType,
        /// The column of the index that holds the values; 0 where rows are counted.
        column: u16,
        to: Slot,
        test: bool,
    },
}

impl Step {
    /// Where the step finds rows, if it looks at those of a single relation.
    #[inline]
    pub(crate) fn source(&self) -> Option<Source> {
        match self {
            Step::Scan { source, .. }
            | Step::Exists { source, .. }
            | Step::AntiJoin { source, .. }
            | Step::Aggregate { source, .. } => Some(*source),
            Step::LeapfrogJoin { .. } | Step::Copy { .. } | Step::Compare { .. } | Step::Compute { .. } => None,
        }
    }

    /// Wherever the step finds rows.
    pub(crate) fn sources(&self) -> impl Iterator<Item = Source> {
        let lists: &[List] = match self {
            Step::LeapfrogJoin { lists, .. } => lists,
            _ => &[],
        };
        self.source().into_iter().chain(lists.iter().map(|list| list.source))
    }

    /// The slots it fills.
    pub(crate) fn fills(&self) -> Vec<Slot> {
        match self {
            Step::Scan { bind, .. } => bind.iter().map(|&(_, slot)| slot).collect(),
            Step::LeapfrogJoin { to, .. } | Step::Copy { to, .. } => vec![*to],
            Step::Compute { to, test: false, .. } | Step::Aggregate { to, test: false, .. } => vec![*to],
            _ => Vec::new(),
        }
    }

    /// Whether it needs what is in a slot.
    pub(crate) fn reads(&self, slot: Slot) -> bool {
        match self {
            Step::Scan { key, check, .. } => key.contains(&slot) || check.iter().any(|&(_, other)| other == slot),
            Step::LeapfrogJoin { lists, .. } => lists.iter().any(|list| list.key.contains(&slot)),
            Step::Exists { key, .. } | Step::AntiJoin { key, .. } => key.contains(&slot),
            Step::Copy { from, .. } => *from == slot,
            Step::Compare { left, right, .. } => *left == slot || *right == slot,
            Step::Compute {
                arguments, to, test, ..
            } => arguments.contains(&slot) || (*test && *to == slot),
            Step::Aggregate { key, to, test, .. } => key.contains(&slot) || (*test && *to == slot),
        }
    }

    /// Whether it may go on several times.
    pub(crate) fn branches(&self) -> bool {
        matches!(self, Step::Scan { .. } | Step::LeapfrogJoin { .. })
    }
}

/// How to evaluate a clause.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) head: RelId,
    /// Where the head's columns come from.
    pub(crate) output: Vec<Slot>,
    pub(crate) steps: Vec<Step>,
    /// By step: where a part of the plan ends of which one success is enough, since nothing it binds is needed behind it. 0 if
    /// none begins with the step.
    pub(crate) enough: Vec<u16>,
    /// What the slots hold at the beginning: zeros for variables, then the constants.
    pub(crate) slots: Vec<Value>,
    /// The step that asks whether the head row is known already; only in plans for changes.
    pub(crate) fresh: Option<usize>,
}

impl Plan {
    /// Whether it goes through all new rows again and again.
    pub(crate) fn searches_new(&self) -> bool {
        self.steps.iter().any(
            |step| matches!(step, Step::Scan { source, key, .. } if source.version == Version::New && key.is_empty()),
        )
    }
}

/// The plans of a clause.
#[derive(Clone, Debug)]
pub(crate) struct ClausePlans {
    /// Over finished relations.
    pub(crate) complete: Plan,
    /// One for each atom over the clause's own recursive stratum, with the relation whose new rows it begins with.
    pub(crate) deltas: Vec<(RelId, Plan)>,
    /// By position in `deltas`: plans of the same answer that begin with a finished relation and come to the newest rows later.
    /// Better when there are many new rows; which one is used is decided from the sizes in every round.
    pub(crate) alternatives: Vec<Vec<Plan>>,
    /// One for each atom of the body: what follows from rows of it that came or went. None if the clause is too large.
    pub(crate) changes: Vec<ChangePlan>,
    /// Begins with rows of the head: which of them the clause derives. `None` if the clause is too large.
    pub(crate) check: Option<Plan>,
}

/// How to evaluate a clause for rows of one of its atoms.
#[derive(Clone, Debug)]
pub(crate) struct ChangePlan {
    /// The relation of the atom.
    pub(crate) over: RelId,
    /// Whether the atom is negated, so that rows that go are what may make the clause derive more.
    pub(crate) negated: bool,
    pub(crate) plan: Plan,
}

/// What a stratum computes and from what.
#[derive(Clone, Debug)]
pub(crate) struct StratumPlan {
    /// The derived relations; those with nothing but facts are not evaluated.
    pub(crate) members: Vec<RelId>,
    /// The other relations that occur in bodies, in order.
    pub(crate) inputs: Vec<RelId>,
    /// The clauses of the members.
    pub(crate) clauses: Vec<ClauseId>,
    /// Whether a member occurs in a body.
    pub(crate) recursive: bool,
    /// Whether all clauses have plans for maintenance. If not, the stratum is recomputed whatever changes.
    pub(crate) maintainable: bool,
}

/// What plans are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Aim {
    /// A computation from scratch.
    Recompute,
    /// Maintenance.
    Maintain,
}
