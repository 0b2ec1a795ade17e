//! The plan representation. Each plan is a straight list of [`Step`]s over numbered slots: the clause's variables, then
//! its constants.
//!
//! A scan binds the variables of one atom, and a leapfrog join binds one variable. Every other step tests or computes
//! from bound slots, and the planner places it as early as possible.
//!
//! A clause of a recursive stratum has one delta plan for each body atom over that stratum. The delta plan begins with
//! the newest rows of that atom. *Alternatives* compute the same result but reach those rows later. In every round
//! [`super::estimate`] chooses between them by the sizes of predicates.
//!
//! For maintenance, each clause has one plan for each body atom, negated ones included, that begins with the changed
//! rows. One more plan begins with head rows and checks whether the clause derives them.

use crate::check::{ClauseId, Predicate, PredicateId, Rules};
use crate::record;
use crate::symbol::Symbol;
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::value::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The position of a value during evaluation: variables come first, then constants.
pub(crate) type Slot = u16;

/// The id of an index in [`Indexes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct IndexId(pub(crate) u32);

impl IndexId {
    pub(crate) fn index(self) -> usize {
        self.0 as usize
    }
}

/// An order of a predicate's columns. Each index covers all columns, so that it can be patched when rows are added or
/// removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IndexSpec {
    pub(crate) predicate: PredicateId,
    pub(crate) columns: Vec<u16>,
    /// Position among the predicate's indexes; 0 is the primary index, the predicate's rows in their stored order.
    pub(crate) position: usize,
}

/// The indexes that the plans use, without duplicates. The primary indexes come first, by [`PredicateId`].
#[derive(Clone, Debug)]
pub(crate) struct Indexes {
    specs: Vec<IndexSpec>,
    /// By [`PredicateId`]: the indexes of a predicate, the primary index first.
    of: Vec<Vec<IndexId>>,
    /// By [`PredicateId`]: whether the rows of the predicate are groups, each a key and its aggregate.
    grouped: Vec<bool>,
    /// The plans of correlated predicates, which other plans contain.
    correlated: BTreeMap<PredicateId, Arc<[Plan]>>,
    /// Maps the symbol of a record shape to its number of fields.
    shapes: BTreeMap<Symbol, usize>,
}

impl std::ops::Index<IndexId> for Indexes {
    type Output = IndexSpec;

    fn index(&self, index: IndexId) -> &IndexSpec {
        &self.specs[index.index()]
    }
}

impl Indexes {
    /// Creates the primary indexes of the predicates of a program with these groupings.
    pub(crate) fn new(rules: &Rules, groupings: &[Option<Grouping>]) -> Self {
        let arities = rules.predicates.iter().map(Predicate::arity);
        let own = |((arity, grouping), number): ((usize, &Option<Grouping>), _)| {
            own_rows(
                PredicateId(number),
                grouping.map_or(arity, |grouping| grouping.keys + 1),
            )
        };
        let specs: Vec<IndexSpec> = arities.zip(groupings).zip(0..).map(own).collect();
        Indexes {
            of: (0..specs.len() as u32).map(|index| vec![IndexId(index)]).collect(),
            specs,
            grouped: groupings.iter().map(Option::is_some).collect(),
            correlated: BTreeMap::new(),
            shapes: shapes(rules),
        }
    }

    /// Returns the number of fields of a shape; `None` if no clause takes such records apart.
    pub(crate) fn fields(&self, shape: Symbol) -> Option<usize> {
        self.shapes.get(&shape).copied()
    }

    /// The plans of a correlated predicate; `None` for any other predicate.
    pub(crate) fn correlated(&self, predicate: PredicateId) -> Option<&Arc<[Plan]>> {
        self.correlated.get(&predicate)
    }

    /// The number of correlated predicates, and so the maximum number of nested evaluations of them.
    pub(crate) fn correlated_len(&self) -> usize {
        self.correlated.len()
    }

    /// Sets the plans of a correlated predicate.
    pub(crate) fn set_correlated(&mut self, predicate: PredicateId, plans: Vec<Plan>) {
        self.correlated.insert(predicate, plans.into());
    }

    /// Whether the rows of the predicate are groups.
    pub(crate) fn is_grouped(&self, predicate: PredicateId) -> bool {
        self.grouped[predicate.index()]
    }

    /// The number of words in a row of the predicate.
    pub(crate) fn arity(&self, predicate: PredicateId) -> usize {
        self.specs[predicate.index()].columns.len()
    }

    /// The number of indexes of each predicate, by [`PredicateId`].
    pub(crate) fn counts(&self) -> impl Iterator<Item = usize> {
        self.of.iter().map(Vec::len)
    }

    /// The indexes of a predicate, the primary index first.
    pub(crate) fn of(&self, predicate: PredicateId) -> impl Iterator<Item = &IndexSpec> {
        self.of[predicate.index()].iter().map(|&index| &self[index])
    }

    /// Whether this is a predicate's primary index.
    pub(crate) fn is_own(&self, index: IndexId) -> bool {
        index.index() < self.of.len()
    }

    /// The number of indexes of all predicates together.
    pub(crate) fn len(&self) -> usize {
        self.specs.len()
    }

    /// Removes all but the first `count` indexes.
    pub(crate) fn truncate(&mut self, count: usize) {
        self.specs.truncate(count);
        for known in &mut self.of {
            known.retain(|index| index.index() < count);
        }
    }

    /// Returns an index that begins with the columns of the first group, then those of the second, each in any order.
    /// Creates the index if none exists. The second value is its column order.
    pub(crate) fn prefix(&mut self, predicate: PredicateId, groups: [&[u16]; 2]) -> (IndexId, Vec<u16>) {
        let begins = |order: &[u16]| {
            let (first, rest) = order.split_at(groups[0].len());
            let within = |group: &[u16], part: &[u16]| group.iter().all(|column| part.contains(column));
            within(groups[0], first) && within(groups[1], &rest[..groups[1].len()])
        };
        let known = &mut self.of[predicate.index()];
        if let Some(&index) = known.iter().find(|index| begins(&self.specs[index.index()].columns)) {
            return (index, self.specs[index.index()].columns.clone());
        }
        let mut columns = groups.concat();
        let all = self.specs[predicate.index()].columns.iter().copied();
        let rest: Vec<u16> = all.filter(|column| !columns.contains(column)).collect();
        columns.extend(rest);
        let index = IndexId(self.specs.len() as u32);
        self.specs.push(IndexSpec {
            predicate,
            columns: columns.clone(),
            position: known.len(),
        });
        known.push(index);
        (index, columns)
    }
}

/// The specification of a predicate's primary index.
fn own_rows(predicate: PredicateId, arity: usize) -> IndexSpec {
    IndexSpec {
        predicate,
        columns: (0..arity as u16).collect(),
        position: 0,
    }
}

/// The subset of a predicate's rows that a step reads during semi-naive evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Version {
    /// The rows of a finished predicate.
    Complete,
    /// Old and new rows.
    All,
    /// The rows derived before this round.
    Old,
    /// The rows that are new in this round.
    New,
}

/// The index and the subset of rows that a step reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Source {
    pub(crate) index: IndexId,
    pub(crate) version: Version,
}

/// One input of a leapfrog join: the sorted words that follow the key in the rows that begin with it.
#[derive(Clone, Debug)]
pub(crate) struct List {
    pub(crate) source: Source,
    pub(crate) key: Vec<Slot>,
}

/// One step of a plan.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    /// For each row that begins with the key and passes the checks: bind the slots and continue.
    Scan {
        source: Source,
        key: Vec<Slot>,
        /// (column of the index, slot to fill).
        bind: Vec<(u16, Slot)>,
        /// (column of the index, slot it must equal), checked after binding.
        check: Vec<(u16, Slot)>,
        /// If not 0, only this number of leading columns matters: the scan visits one row for each combination of them.
        distinct: u16,
    },
    /// For each word that occurs in all lists: fill the slot with it and continue. This is the leapfrog join of one
    /// variable. It visits at most as many rows of each list as the shortest list has, however skewed the rows are.
    LeapfrogJoin { lists: Vec<List>, to: Slot },
    /// Continue if some row begins with the key.
    Exists { source: Source, key: Vec<Slot> },
    /// Continue if no row begins with the key.
    AntiJoin { source: Source, key: Vec<Slot> },
    /// Copy a slot to another.
    Copy { to: Slot, from: Slot },
    /// Continue if the comparison holds.
    Compare {
        op: Comparison,
        left: Slot,
        right: Slot,
        base: BaseType,
    },
    /// Compute a functor and continue if it has a value. A `test` requires the slot to hold that value; otherwise the
    /// step fills the slot with it.
    Compute {
        functor: Functor,
        base: BaseType,
        arguments: Vec<Slot>,
        to: Slot,
        test: bool,
    },
    /// Aggregate the rows that begin with the key, with `test` as in [`Step::Compute`].
    Aggregate {
        source: Source,
        key: Vec<Slot>,
        op: AggregateOp,
        base: BaseType,
        /// The column of the index that holds the aggregated values; 0 for a count.
        column: u16,
        to: Slot,
        test: bool,
    },
    /// Evaluate a correlated aggregate for the parameters in the key, with `test` as in [`Step::Compute`].
    Correlated {
        predicate: PredicateId,
        /// One plan for each clause of the predicate. Its first step scans the parameters.
        plans: Arc<[Plan]>,
        key: Vec<Slot>,
        op: AggregateOp,
        base: BaseType,
        /// The column of the predicate that holds the aggregated values; `None` for `count`.
        column: Option<usize>,
        to: Slot,
        test: bool,
    },
    /// Look up the aggregate of the group with this key, with `test` as in [`Step::Compute`].
    Group {
        source: Source,
        key: Vec<Slot>,
        op: AggregateOp,
        base: BaseType,
        to: Slot,
        test: bool,
    },
}

impl Step {
    /// The source of a step that reads a single predicate.
    #[inline]
    pub(crate) fn source(&self) -> Option<Source> {
        match self {
            Step::Scan { source, .. }
            | Step::Exists { source, .. }
            | Step::AntiJoin { source, .. }
            | Step::Aggregate { source, .. }
            | Step::Group { source, .. } => Some(*source),
            Step::LeapfrogJoin { .. }
            | Step::Copy { .. }
            | Step::Compare { .. }
            | Step::Compute { .. }
            | Step::Correlated { .. } => None,
        }
    }

    /// All sources that the step reads.
    pub(crate) fn sources(&self) -> impl Iterator<Item = Source> {
        let lists: &[List] = match self {
            Step::LeapfrogJoin { lists, .. } => lists,
            _ => &[],
        };
        let inner: Vec<Source> = match self {
            Step::Correlated { plans, .. } => plans.iter().flat_map(Plan::sources_in_place).collect(),
            _ => Vec::new(),
        };
        let own = self.source().into_iter().chain(lists.iter().map(|list| list.source));
        own.chain(inner)
    }

    /// The slots that the step fills.
    pub(crate) fn fills(&self) -> Vec<Slot> {
        match self {
            Step::Scan { bind, .. } => bind.iter().map(|&(_, slot)| slot).collect(),
            Step::LeapfrogJoin { to, .. } | Step::Copy { to, .. } => vec![*to],
            Step::Compute { to, test: false, .. }
            | Step::Aggregate { to, test: false, .. }
            | Step::Correlated { to, test: false, .. }
            | Step::Group { to, test: false, .. } => vec![*to],
            _ => Vec::new(),
        }
    }

    /// Whether the step reads a slot.
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
            Step::Aggregate { key, to, test, .. }
            | Step::Correlated { key, to, test, .. }
            | Step::Group { key, to, test, .. } => key.contains(&slot) || (*test && *to == slot),
        }
    }

    /// Whether the step may continue more than once.
    pub(crate) fn branches(&self) -> bool {
        matches!(self, Step::Scan { .. } | Step::LeapfrogJoin { .. })
    }
}

/// The aggregation of a hidden predicate. Its first columns are the key of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Grouping {
    /// The number of key columns.
    pub(crate) keys: usize,
    pub(crate) op: AggregateOp,
    pub(crate) base: BaseType,
    /// The column of the values; `None` for `count`.
    pub(crate) column: Option<usize>,
}

/// The aggregate of a plan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fold {
    pub(crate) op: AggregateOp,
    pub(crate) base: BaseType,
    /// The slot of the values; `None` for `count`.
    pub(crate) value: Option<Slot>,
}

/// A plan that evaluates a clause.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) head: PredicateId,
    /// Indexed by column of the head: the slot that holds its value. With `fold`, only the columns of the key.
    pub(crate) output: Vec<Slot>,
    /// Aggregates what the plan derives, by the key in `output`; see [`super::grouping`].
    pub(crate) fold: Option<Fold>,
    pub(crate) steps: Vec<Step>,
    /// Indexed by step: the end of the existential group that begins with it, or 0 if none begins there. One success of
    /// the group is enough, since no later step reads what the group binds.
    pub(crate) enough: Vec<u16>,
    /// The initial slots: zeros for variables, then the constants.
    pub(crate) slots: Vec<Value>,
    /// The step that tests whether the head row is known already; only in maintenance plans.
    pub(crate) fresh: Option<usize>,
}

impl Plan {
    /// Makes the plan aggregate the rows that it derives.
    pub(crate) fn grouped(mut self, grouping: &Grouping) -> Self {
        self.fold = Some(Fold {
            op: grouping.op,
            base: grouping.base,
            value: grouping.column.map(|column| self.output[column]),
        });
        self.output.truncate(grouping.keys);
        self
    }

    /// The sources of a plan that a [`Step::Correlated`] evaluates: all but the parameters.
    pub(crate) fn sources_in_place(&self) -> Vec<Source> {
        self.steps[1..].iter().flat_map(Step::sources).collect()
    }

    /// Whether a step scans all new rows without a key.
    pub(crate) fn searches_new(&self) -> bool {
        self.steps.iter().any(
            |step| matches!(step, Step::Scan { source, key, .. } if source.version == Version::New && key.is_empty()),
        )
    }
}

/// The plans of a clause.
#[derive(Clone, Debug)]
pub(crate) struct ClausePlans {
    /// The plan over finished predicates.
    pub(crate) complete: Plan,
    /// One plan for each atom over the clause's recursive stratum, with the predicate whose new rows the plan begins
    /// with.
    pub(crate) deltas: Vec<(PredicateId, Plan)>,
    /// Indexed by position in `deltas`: equivalent plans that read a finished predicate first, or directly after the
    /// newest rows. Each round chooses a plan by the sizes of predicates.
    pub(crate) alternatives: Vec<Vec<Plan>>,
    /// One plan for each atom of the body: what the clause derives from added or removed rows of that atom. Empty if
    /// the clause cannot be maintained.
    pub(crate) changes: Vec<ChangePlan>,
    /// Begins with head rows and finds those that the clause derives. `None` if the clause cannot be maintained.
    pub(crate) check: Option<Plan>,
}

impl ClausePlans {
    /// The plans of a clause that only ever runs as a whole.
    pub(crate) fn of(complete: Plan) -> Self {
        ClausePlans {
            complete,
            deltas: Vec::new(),
            alternatives: Vec::new(),
            changes: Vec::new(),
            check: None,
        }
    }
}

/// A plan that evaluates a clause for changed rows of one atom.
#[derive(Clone, Debug)]
pub(crate) struct ChangePlan {
    /// The predicate of the atom.
    pub(crate) over: PredicateId,
    /// Whether the atom is negated. Then removed rows can make the clause derive more.
    pub(crate) negated: bool,
    pub(crate) plan: Plan,
}

/// The inputs, members and clauses of a stratum.
#[derive(Clone, Debug)]
pub(crate) struct StratumPlan {
    /// The derived predicates. Predicates that have only facts are not evaluated.
    pub(crate) members: Vec<PredicateId>,
    /// The other predicates that occur in bodies, by id, also those in bodies of correlated predicates.
    pub(crate) inputs: Vec<PredicateId>,
    /// The clauses of the members.
    pub(crate) clauses: Vec<ClauseId>,
    /// Whether a member occurs in a body.
    pub(crate) recursive: bool,
    /// Whether all clauses have maintenance plans. If not, any change recomputes the stratum.
    pub(crate) maintainable: bool,
    /// Whether the rounds in which rows are derived determine which rows hold.
    pub(crate) by_rounds: bool,
    /// The correlated predicates that the clauses evaluate in place, each after those that it needs.
    pub(crate) correlated: Vec<PredicateId>,
}

/// The purpose of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Aim {
    /// Computation from scratch.
    Recompute,
    /// Incremental maintenance.
    Maintain,
}

/// The shapes of the records that clauses take apart, with their numbers of fields.
fn shapes(rules: &Rules) -> BTreeMap<Symbol, usize> {
    let literals = rules.clauses.iter().flat_map(|clause| &clause.body);
    let shapes = literals.filter_map(|literal| Some(literal.field()?.shape));
    let fields = |shape: Symbol| {
        let text = rules.symbols.resolve(shape).unwrap_or_default();
        (shape, record::parts(text).1.len())
    };
    shapes.map(fields).collect()
}
