//! Holds the rows of all predicates, makes commits and evaluates strata. [`super::recursion`] evaluates the recursive
//! ones. `meter` bounds and counts the work of a stratum, and `adapt` replans its clauses.

mod adapt;
mod meter;

use crate::cancel::Cancel;
use crate::check::{Atom, ClauseId, Literal, Numbering, PredicateId, Rules, Term};
use crate::eval::calls::Calls;
use crate::eval::choice::{Choice, by_value};
use crate::eval::correlated::CorrelatedValues;
use crate::eval::delta::{Delta, Rows};
use crate::eval::exec::adapt::Basis;
pub(crate) use crate::eval::exec::meter::{Failure, Meter, Quota};
use crate::eval::groups;
use crate::eval::join;
use crate::eval::join::{JoinState, RowView};
use crate::eval::limits::{EvalError, Limits};
use crate::eval::narrow::NarrowTable;
use crate::eval::output::{Abort, Output};
use crate::eval::pending::PendingChanges;
use crate::eval::stats::{EvalEvent, EvalStats, Strategy, StratumStats};
use crate::eval::table::{Table, TableDelta};
use crate::eval::workers::Workers;
use crate::plan::estimate::Shape;
use crate::plan::steps::{Aim, IndexId, IndexSpec, Plan, Slot, Source, Step, StratumPlan, Version};
use crate::plan::{Compiled, Plans};
use crate::row::{AnyBatch, Batch, ByWidth, Row, normalize, read_row, read_rows};
use crate::snapshot::{Decoder, Encoder, SnapshotError};
use crate::symbol::{Symbols, WordSize};
use crate::syntax::ast::BaseType;
use crate::syntax::functor::AggregateOp;
use crate::value::Value;
use std::io;
use std::sync::Arc;

/// The state that a session keeps between commits, independent of the row width.
pub(crate) trait Store: Send + Sync {
    /// Records that the next commit inserts a row (`present`) or removes it.
    fn change(&mut self, predicate: PredicateId, row: &[Value], present: bool);
    /// Records that the next commit inserts rows of `arity` words each; `arity` is at least 1.
    fn insert_all(&mut self, predicate: PredicateId, words: &[Value], arity: usize);
    /// Reserves memory for `rows` insertions.
    fn reserve(&mut self, predicate: PredicateId, rows: usize);
    /// The number of pending changes of a predicate.
    fn pending(&self, predicate: PredicateId) -> usize;
    /// Drops all but the first `len` pending changes of a predicate.
    fn forget(&mut self, predicate: PredicateId, len: usize);
    /// Drops the changes recorded since the last commit.
    fn rollback(&mut self);
    /// Makes the pending changes and updates what depends on them. A failed commit changes nothing.
    fn commit(
        &mut self,
        compiled: &Compiled,
        symbols: &Symbols,
        options: CommitOptions<'_>,
    ) -> Result<(Delta, EvalStats), EvalError>;
    /// Whether the predicate contains the row, which has the right arity.
    fn contains(&self, predicate: PredicateId, row: &[Value]) -> bool;
    /// The row at a position below `len`, with padding.
    fn row(&self, predicate: PredicateId, position: usize) -> &[Value];
    /// The number of rows of the predicate.
    fn len(&self, predicate: PredicateId) -> usize;
    /// The rows of the predicate, which the result shares.
    fn rows(&self, predicate: PredicateId, arity: usize) -> Rows;
    /// The bytes of the rows, indexes and pending changes.
    fn bytes(&self) -> u64;
    /// Writes the rows and the pending changes.
    fn save(&self, out: &mut Encoder<'_>) -> io::Result<()>;
    /// Reads what `save` wrote into a new store. The rows have the first `known` symbols.
    fn load(&mut self, input: &mut Decoder<'_>, rules: &Rules, known: usize) -> Result<(), SnapshotError>;
    /// The aggregate of the group with this key in a grouped predicate.
    fn group(&self, predicate: PredicateId, key: &[Value], op: AggregateOp) -> Option<Value>;
    /// The value of a correlated aggregate for these parameters, and the number of rows scanned. It stops after about
    /// `budget` rows, or if the evaluation takes more than `bytes`.
    fn correlated(
        &self,
        aggregate: &Literal,
        parameters: &[Value],
        symbols: &Symbols,
        limits: (u64, u64, &Cancel),
        calls: Option<&Arc<Calls>>,
    ) -> (Result<Option<Value>, Abort>, u64);
    /// The plans in use.
    fn plans(&self) -> &Plans;
    /// The distinct rows that a clause derives. The cache of correlated values takes at most about `bytes`.
    fn fired(&self, compiled: &Compiled, symbols: &Symbols, clause: ClauseId, bytes: u64) -> Vec<Vec<Value>>;
}

/// The options of a commit.
#[derive(Clone, Copy)]
pub(crate) struct CommitOptions<'a> {
    pub(crate) strategy: Strategy,
    pub(crate) limits: Limits,
    pub(crate) workers: &'a Workers,
    /// Called when the evaluation of a clause begins and ends.
    pub(crate) watch: Option<&'a dyn Fn(EvalEvent)>,
    /// Polled on the calling thread.
    pub(crate) cancel: &'a Cancel,
    /// The user-defined functors, if there are any.
    pub(crate) calls: Option<&'a Arc<Calls>>,
}

/// Makes an empty store for a program.
pub(crate) fn store(compiled: &Compiled) -> Box<dyn Store> {
    match compiled.plans.width {
        2 => Box::new(State::<2>::new(compiled)),
        3 => Box::new(State::<3>::new(compiled)),
        4 => Box::new(State::<4>::new(compiled)),
        6 => Box::new(State::<6>::new(compiled)),
        8 => Box::new(State::<8>::new(compiled)),
        12 => Box::new(State::<12>::new(compiled)),
        20 => Box::new(State::<20>::new(compiled)),
        _ => Box::new(State::<32>::new(compiled)),
    }
}

pub(crate) struct State<const W: usize> {
    /// By [`PredicateId`]: the rows as of the last commit.
    pub(crate) tables: Vec<Table<W>>,
    /// By [`PredicateId`]: a loaded predicate with narrow rows. It has nothing in `tables`, `source_facts` and `pending`.
    narrow: Vec<Option<NarrowTable>>,
    /// By [`PredicateId`]: the facts in the source, for predicates that no clause with a body derives. They cannot be
    /// retracted.
    source_facts: Vec<Vec<Row<W>>>,
    /// By [`PredicateId`]: the changes that the next commit makes.
    pending: Vec<PendingChanges<W>>,
    /// The plans in use, made for about the current sizes of the predicates.
    pub(crate) plans: Arc<Plans>,
    /// Indexed by position of the stratum: the sizes that its plans were made for.
    pub(crate) bases: Vec<Basis>,
    /// Whether a commit has succeeded.
    committed: bool,
    /// Indexed by position of the stratum: the cost of the last computation from scratch.
    costs: Vec<Cost>,
    /// The number of rows of all tables.
    rows: usize,
    /// The maximum number of copies of each row in memory.
    pub(crate) copies_max: usize,
}

/// The cost of computing a stratum from scratch.
#[derive(Clone, Copy, Debug, Default)]
struct Cost {
    rows_scanned: u64,
    /// The number of rows that its inputs had.
    inputs: u64,
}

/// A commit in progress.
pub(crate) struct Commit<'a, const W: usize> {
    pub(crate) compiled: &'a Compiled,
    /// The session's plans.
    pub(crate) plans: Arc<Plans>,
    pub(crate) symbols: &'a Symbols,
    options: CommitOptions<'a>,
    /// By [`PredicateId`]: the change of the predicate so far, and its table before the commit.
    pub(crate) changed: Vec<Option<(TableDelta<W>, Table<W>)>>,
    /// By [`PredicateId`]: the rows that the first commit loads into a narrow table.
    loaded: Vec<Option<Rows>>,
    /// The bytes of pending changes and, at most, of `changed`.
    kept: u64,
}

impl<const W: usize> Commit<'_, W> {
    /// Returns all changes and drops the old tables.
    fn into_delta(self) -> Delta {
        let mut delta = Delta::default();
        // Skip predicates that the optimizer added.
        let predicates = self.compiled.rules.predicates.iter().zip((0..).map(PredicateId));
        for ((changed, loaded), (predicate, id)) in self.changed.into_iter().zip(self.loaded).zip(predicates) {
            if let Some(rows) = loaded {
                delta.push(id, rows, Rows::default());
            }
            let Some((change, _)) = changed else { continue };
            if self.plans.indexes.is_grouped(id) {
                continue;
            }
            let arity = predicate.arity();
            delta.push(
                id,
                Rows::of(arity, change.added),
                Rows::of(arity, change.removed.into()),
            );
        }
        delta
    }

    /// The change of a predicate, or `None`.
    pub(crate) fn delta(&self, predicate: PredicateId) -> Option<&TableDelta<W>> {
        self.changed[predicate.index()].as_ref().map(|(delta, _)| delta)
    }
}

/// A recursive stratum is computed anew if more than one in so many of its rows may be lost: to look up, check and derive
/// a lost row again costs more than to derive all rows.
const LOST_PARTS: usize = 8;

impl<const W: usize> State<W> {
    fn new(compiled: &Compiled) -> Self {
        let rules = &compiled.rules;
        let indexes = || compiled.plans.indexes.counts();
        let narrow = |(count, id): (usize, PredicateId)| match compiled.plans.member[id.index()] {
            None => NarrowTable::new(compiled.plans.indexes.arity(id), W, count),
            Some(_) => None,
        };
        let mut narrow: Vec<Option<NarrowTable>> = indexes().zip((0..).map(PredicateId)).map(narrow).collect();
        let mut source_facts = vec![Vec::new(); rules.predicates.len()];
        for clause in rules.clauses.iter().filter(|clause| rules.is_row(clause)) {
            let Atom { predicate, terms, .. } = &clause.head;
            let row: Row<W> = constants(terms);
            match &mut narrow[predicate.index()] {
                Some(narrow) => narrow.add_source_fact(&row.0[..terms.len()]),
                None => source_facts[predicate.index()].push(row),
            }
        }
        source_facts.iter_mut().for_each(normalize);
        narrow.iter_mut().flatten().for_each(NarrowTable::insert_source_facts);
        State {
            tables: indexes().map(|count| Table::new(Vec::new(), count)).collect(),
            narrow,
            rows: 0,
            copies_max: indexes().max().unwrap_or(0) + 1,
            costs: vec![Cost::default(); compiled.plans.strata.len()],
            // The first commit inserts the facts of the source like any others.
            pending: source_facts.iter().cloned().map(PendingChanges::of).collect(),
            plans: Arc::clone(&compiled.plans),
            bases: vec![Basis::default(); compiled.plans.strata.len()],
            source_facts,
            committed: false,
        }
    }

    fn try_commit(&mut self, commit: &mut Commit<'_, W>) -> Result<(EvalStats, Vec<Cost>), EvalError> {
        let limits = commit.options.limits;
        let Compiled { rules, plans, .. } = commit.compiled;
        for predicate in (0..rules.predicates.len() as u32).map(PredicateId) {
            self.load_narrow(commit, predicate)?;
            let pending = &mut self.pending[predicate.index()];
            if pending.is_empty() {
                continue;
            }
            let table = &self.tables[predicate.index()];
            // A changed table is copied, with its indexes.
            let copied = if table.rows.is_empty() { 0 } else { 2 * table.bytes() };
            if copied + pending.bytes() > limits.bytes / 16 {
                let tables = Self::bytes_of(&self.tables, &self.narrow);
                if tables + commit.kept + copied + pending.bytes() + commit.symbols.bytes() > limits.bytes {
                    return Err(EvalError::TooManyInputs { limit: limits.bytes });
                }
            }
            let applied = pending.apply(table);
            commit.kept += pending.bytes();
            if let Some((delta, rows)) = applied {
                let table = table.replaced(&specs(&commit.plans, predicate), &delta, rows);
                self.put(commit, predicate, delta, table);
            }
        }

        let mut log = EvalStats::default();
        let mut costs = self.costs.clone();
        // Rows derived and scanned by the strata so far. These sums alone decide whether a limit is exceeded.
        let (mut derived, mut steps) = (0, 0);
        for ((stratum, cost), number) in plans.strata.iter().zip(&mut costs).zip(0..) {
            let changes = stratum.inputs.iter().any(|&input| commit.delta(input).is_some());
            let work = if self.committed && !changes {
                StratumStats::Skipped
            } else {
                let quota = self.quota(commit, (derived, steps));
                let work = self.update(commit, (stratum, number), cost, quota);
                work.map_err(|(clause, abort)| match abort {
                    Abort::Budget => EvalError::TooManySteps {
                        limit: limits.steps,
                        clause,
                    },
                    Abort::Overflow => EvalError::TooManyRows {
                        limit: limits.rows,
                        clause,
                    },
                    Abort::Memory => EvalError::TooMuchMemory {
                        limit: limits.bytes,
                        clause,
                    },
                    Abort::Cancelled => EvalError::Cancelled { clause },
                    Abort::Functor => {
                        let (functor, reason) = commit.options.calls.map(|calls| calls.failure()).unwrap_or_default();
                        EvalError::FailedFunctor {
                            functor,
                            reason,
                            clause,
                        }
                    }
                })?
            };
            steps += work.work().map_or(0, |work| work.rows_scanned() + work.given_up);
            log.strata.push(work);
            let members = stratum.members.iter();
            derived += members.map(|&predicate| self.len(predicate)).sum::<usize>();
        }
        Ok((log, costs))
    }

    /// The resources left for a stratum after earlier strata derived and scanned this many rows.
    fn quota(&self, commit: &Commit<'_, W>, (derived, steps): (usize, u64)) -> Quota {
        let limits = commit.options.limits;
        let most = (self.rows * self.copies_max * size_of::<Row<W>>()) as u64 + commit.kept;
        // Use an upper bound where it suffices: adding up the tables takes longer than many commits.
        let tight = most > limits.bytes / 16;
        let held = match tight {
            true => Self::bytes_of(&self.tables, &self.narrow) + commit.kept,
            false => most,
        };
        Quota {
            rows: limits.rows.saturating_sub(derived),
            steps: limits.steps.saturating_sub(steps),
            bytes: limits.bytes.saturating_sub(held + commit.symbols.bytes()),
            tight,
        }
    }

    /// Loads the pending rows of a narrow table in the first commit.
    fn load_narrow(&mut self, commit: &mut Commit<'_, W>, predicate: PredicateId) -> Result<(), EvalError> {
        let limit = commit.options.limits.bytes;
        let pending = (self.narrow[predicate.index()].as_ref()).map_or(0, NarrowTable::pending_bytes);
        if pending > limit / 16 {
            let tables = Self::bytes_of(&self.tables, &self.narrow);
            if tables + commit.kept + pending + commit.symbols.bytes() > limit {
                return Err(EvalError::TooManyInputs { limit });
            }
        }
        let arity = commit.plans.indexes.arity(predicate);
        let Some(narrow) = self.narrow[predicate.index()]
            .as_mut()
            .filter(|narrow| narrow.pending() > 0)
        else {
            return Ok(());
        };
        commit.loaded[predicate.index()] = narrow.load(arity);
        self.rows += narrow.len();
        commit.kept += narrow.pending_bytes();
        Ok(())
    }

    /// Drops the pending changes of a predicate.
    fn clear_pending(&mut self, predicate: PredicateId) {
        self.pending[predicate.index()].clear();
        if let Some(narrow) = &mut self.narrow[predicate.index()] {
            narrow.clear_pending();
        }
    }

    /// Gives a narrow table that changes after the first commit the program's width.
    fn widen(&mut self, predicate: PredicateId) {
        if self.committed
            && let Some(narrow) = self.narrow[predicate.index()].take()
        {
            let (rows, pending, source_facts) = narrow.widened();
            self.tables[predicate.index()] = self.tables[predicate.index()].reloaded(rows.into());
            self.pending[predicate.index()] = pending;
            self.source_facts[predicate.index()] = source_facts;
        }
    }

    /// The bytes of all tables.
    fn bytes_of(tables: &[Table<W>], narrow: &[Option<NarrowTable>]) -> u64 {
        let narrow = narrow.iter().flatten().map(NarrowTable::bytes);
        tables.iter().map(Table::bytes).chain(narrow).sum()
    }

    /// The bytes of the members' tables, with their indexes.
    fn bytes_of_members(&self, stratum: &StratumPlan) -> u64 {
        let tables = stratum.members.iter().map(|member| &self.tables[member.index()]);
        tables.map(Table::bytes).sum()
    }

    /// The bytes of the indexes that a computation of the stratum from scratch must build.
    fn missing_indexes(&self, plans: &Plans, stratum: &StratumPlan) -> u64 {
        let clauses = stratum.clauses.iter().map(|clause| &plans.clauses[clause.index()]);
        let all = clauses.flat_map(|clause| {
            let deltas = clause.deltas.iter().map(|(_, plan)| plan);
            deltas
                .chain(clause.alternatives.iter().flatten())
                .chain([&clause.complete])
        });
        let sources = all.flat_map(|plan| &plan.steps).flat_map(Step::sources);
        let finished = sources.filter(|source| source.version == Version::Complete);
        let mut missing: Vec<IndexId> = finished.map(|source| source.index).collect();
        missing.sort_unstable();
        missing.dedup();
        let specs = missing.into_iter().map(|index| &plans.indexes[index]);
        specs
            .map(|spec| match &self.narrow[spec.predicate.index()] {
                Some(narrow) => narrow.missing_bytes(spec),
                None => self.tables[spec.predicate.index()].missing_bytes(spec),
            })
            .sum()
    }

    /// Updates the predicates of a stratum by the strategy with the lower estimated cost.
    fn update(
        &mut self,
        commit: &mut Commit<'_, W>,
        (stratum, number): (&StratumPlan, usize),
        cost: &mut Cost,
        quota: Quota,
    ) -> Result<StratumStats, Failure> {
        let CommitOptions { strategy, workers, .. } = commit.options;
        // One thread must make all new symbols, since they are numbered in the order of creation. With correlated
        // aggregates, the number of rows scanned depends on which of them the thread has evaluated before.
        let correlated = !stratum.correlated.is_empty();
        let several =
            workers.are_several() && !correlated && !makes_symbols(&commit.plans, stratum, commit.symbols.word_size());
        let workers = several.then_some(workers);
        let inputs: usize = stratum.inputs.iter().map(|&input| self.len(input)).sum();
        let inputs = inputs as u64;
        let mut given_up = 0;
        // A stratum that makes symbols shares its memory between rows and symbols.
        let symbol_bytes = commit.symbols.bytes() + quota.bytes / 2;
        if self.committed && stratum.maintainable && strategy != Strategy::Recompute {
            // The cost of the last computation from scratch, scaled to the current number of input rows.
            let recomputing = u128::from(cost.rows_scanned) * u128::from(inputs + 1) / u128::from(cost.inputs + 1);
            let recomputing = u64::try_from(recomputing).unwrap_or(u64::MAX);
            let maintaining = || Self::maintenance_cost(commit, stratum);
            // Maintenance copies the members' tables, and their rows that may be lost.
            let fits = !quota.tight || 3 * self.bytes_of_members(stratum) <= quota.bytes;
            let budget = match strategy {
                _ if !fits => None,
                Strategy::Maintain => Some(u64::MAX),
                _ => (maintaining() <= recomputing).then_some(recomputing),
            };
            if let Some(budget) = budget.map(|budget| budget.min(quota.steps)) {
                self.adapt(commit, (stratum, number), Aim::Maintain);
                let mut meter = Meter::new(budget, symbol_bytes, commit.options, workers);
                let lost_max = match strategy {
                    Strategy::Maintain => usize::MAX,
                    _ if !stratum.recursive => usize::MAX,
                    _ => {
                        (stratum.members.iter().map(|&member| self.len(member)).sum::<usize>() / LOST_PARTS).max(1_000)
                    }
                };
                match self.maintain(commit, stratum, lost_max, quota, &mut meter) {
                    Ok((deltas, rounds)) => {
                        for (&predicate, delta) in stratum.members.iter().zip(deltas) {
                            if !delta.is_empty() {
                                let table =
                                    self.tables[predicate.index()].patched(&specs(&commit.plans, predicate), &delta);
                                self.put(commit, predicate, delta, table);
                            }
                        }
                        return Ok(StratumStats::Maintained(meter.finish(rounds)));
                    }
                    Err(failure @ (_, Abort::Cancelled | Abort::Functor)) => return Err(failure),
                    // The number of threads may decide where the evaluation stops, but not whether it exceeds the
                    // budget.
                    Err(_) => given_up = budget,
                }
            }
        }

        let mut quota = Quota {
            steps: quota.steps - given_up,
            ..quota
        };
        self.adapt(commit, (stratum, number), Aim::Recompute);
        if quota.tight {
            // The new tables replace the members' tables after the evaluation, and the change is copied.
            let copied = self.bytes_of_members(stratum);
            let missing = self.missing_indexes(&commit.plans, stratum) + copied;
            if let (true, Some(&clause)) = (missing > quota.bytes, stratum.clauses.first()) {
                return Err((clause, Abort::Memory));
            }
            quota.bytes = (quota.bytes - missing) / if copied > 0 { 2 } else { 1 };
        }
        if makes_symbols(&commit.plans, stratum, commit.symbols.word_size()) {
            quota.bytes /= 2;
        }
        let values_bytes = if correlated { quota.bytes / 4 } else { 0 };
        quota.bytes -= values_bytes;
        let attempt = |workers| {
            let mut meter = Meter::new(quota.steps, symbol_bytes, commit.options, workers);
            meter.state.correlated = CorrelatedValues::within(values_bytes, stratum.correlated.len());
            let result = self.evaluate(commit, stratum, quota, &mut meter);
            result.map(|(results, rounds)| (results, rounds, meter))
        };
        let (results, rounds, meter) = match attempt(workers) {
            // The number of threads may decide which limit the evaluation exceeds first, and where.
            Err((_, abort)) if several && !matches!(abort, Abort::Cancelled | Abort::Functor) => attempt(None)?,
            result => result?,
        };
        *cost = Cost {
            rows_scanned: meter.state.rows_scanned,
            inputs,
        };
        for (&predicate, rows) in stratum.members.iter().zip(results) {
            let table = &self.tables[predicate.index()];
            let rows = Arc::new(rows);
            let delta = TableDelta::between(&table.rows, &rows);
            if !delta.is_empty() {
                let table = table.replaced(&specs(&commit.plans, predicate), &delta, rows);
                self.put(commit, predicate, delta, table);
            }
        }
        let mut work = meter.finish(rounds);
        work.given_up = given_up;
        Ok(StratumStats::Recomputed(work))
    }

    /// Estimates the number of rows that maintaining the stratum scans.
    fn maintenance_cost(commit: &Commit<'_, W>, stratum: &StratumPlan) -> u64 {
        /// The cost of a changed row: lookups in other predicates, and checks of heads that may have lost a derivation.
        const ROW: u64 = 4;
        /// The fixed cost of evaluating a clause.
        const CLAUSE: u64 = 8;
        let clauses = stratum.clauses.iter();
        let changes = clauses.flat_map(|clause| &commit.plans.clauses[clause.index()].changes);
        let deltas = changes.filter_map(|change| commit.delta(change.over));
        deltas.map(|delta| CLAUSE + ROW * delta.len() as u64).sum()
    }

    /// Replaces a predicate's table.
    fn put(&mut self, commit: &mut Commit<'_, W>, predicate: PredicateId, delta: TableDelta<W>, table: Table<W>) {
        let old = std::mem::replace(&mut self.tables[predicate.index()], table);
        if !old.rows.is_empty() {
            commit.kept += ((old.rows.len() * self.copies_max + delta.len()) * size_of::<Row<W>>()) as u64;
        }
        self.rows = self.rows + self.len(predicate) - old.rows.len();
        commit.changed[predicate.index()] = Some((delta, old));
    }

    /// Computes the stratum's derived predicates from scratch. Returns their rows and the number of rounds.
    fn evaluate(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        quota: Quota,
        meter: &mut Meter<'_>,
    ) -> Result<(Vec<Vec<Row<W>>>, usize), Failure> {
        let plans = &commit.plans;
        if let [member] = stratum.members[..]
            && let Some(numbering) = &commit.compiled.rules.predicates[member.index()].numbering
        {
            let rows = self.numbered(commit, member, numbering);
            quota.check_rows(rows.len(), stratum, meter)?;
            return Ok((vec![rows], 1));
        }
        let mut outputs: Vec<Output<W>> = stratum.members.iter().map(|_| Output::new(quota.rows)).collect();
        if let ([output], [clause]) = (&mut outputs[..], &stratum.clauses[..]) {
            *output = Output::for_plan(&plans.clauses[clause.index()].complete, quota.rows);
        }
        let share = quota.bytes / outputs.len().max(1) as u64;
        outputs.iter_mut().for_each(|output| output.set_bytes(share));
        let mut views = Vec::new();
        for &clause in &stratum.clauses {
            let plan = &plans.clauses[clause.index()];
            let Some(member) = plans.member[plan.complete.head.index()] else {
                continue;
            };
            // A recursive clause derives nothing until the others have derived rows.
            if plan.deltas.is_empty() {
                views.clear();
                views.extend(self.complete_views(plans, &plan.complete));
                meter.run(
                    clause,
                    &plan.complete,
                    (&views, 0),
                    commit.symbols,
                    &mut outputs[member],
                )?;
            }
        }
        if stratum.recursive {
            return self.grow(commit, stratum, None, outputs, quota, meter);
        }
        let mut rows: Vec<_> = outputs.iter_mut().map(|output| meter.take(output)).collect();
        for (rows, output) in rows.iter().zip(&outputs) {
            output
                .check(rows.len())
                .or_else(|abort| meter.fail_if(true, stratum, abort))?;
        }
        let total: usize = rows.iter().map(Vec::len).sum();
        quota.check_rows(total, stratum, meter)?;
        if stratum.by_rounds {
            for (rows, &member) in rows.iter_mut().zip(&stratum.members) {
                if let Some(mut choice) = Choice::of(&commit.compiled.rules, member) {
                    *rows = choice.keep(std::mem::take(rows), commit.symbols);
                }
            }
        }
        Ok((rows, 1))
    }

    /// Numbers solutions in the order of their values.
    fn numbered(&self, commit: &Commit<'_, W>, predicate: PredicateId, numbering: &Numbering) -> Vec<Row<W>> {
        let columns = &commit.compiled.rules.predicates[predicate.index()].columns;
        let bases: Vec<BaseType> = columns.iter().skip(1).map(|column| column.base).collect();
        let before = numbering.before.iter();
        let first: u64 = before.map(|(of, each)| self.len(*of) as u64 * u64::from(*each)).sum();
        let mut solutions: Vec<Row<W>> = self.tables[numbering.solutions.index()].rows.to_vec();
        solutions.sort_by(|one, other| by_value(&bases, &one.0, &other.0, commit.symbols));
        let mut rows: Vec<Row<W>> = (solutions.iter().zip(0_u64..))
            .map(|(solution, at)| {
                let mut row = Row::ZERO;
                let number = first + at * u64::from(numbering.each);
                row.0[0] = match commit.symbols.word_size() {
                    // Numbers wrap around.
                    WordSize::Bits32 => Value(number as u32),
                    WordSize::Bits64 => Value(commit.symbols.intern_bits(number)),
                };
                row.0[1..=bases.len()].copy_from_slice(&solution.0[..bases.len()]);
                row
            })
            .collect();
        rows.sort_unstable();
        rows
    }

    fn complete_views<'a>(&'a self, plans: &'a Plans, plan: &'a Plan) -> impl Iterator<Item = RowView<'a, W>> {
        plan.steps.iter().map(|step| self.complete_view(plans, step))
    }

    pub(crate) fn complete_view(&self, plans: &Plans, step: &Step) -> RowView<'_, W> {
        RowView::for_step(step, |source: Source| self.batch(&plans.indexes[source.index]))
    }

    /// The rows of a predicate in the order of an index.
    pub(crate) fn batch(&self, spec: &IndexSpec) -> AnyBatch<'_, W> {
        match &self.narrow[spec.predicate.index()] {
            Some(narrow) => narrow.batch(spec),
            None => ByWidth::Own(self.tables[spec.predicate.index()].batch(spec)),
        }
    }

    /// The shape of the rows of a predicate.
    pub(crate) fn shape(&self, predicate: PredicateId) -> Shape<W> {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.shape(),
            None => Shape::of(&self.tables[predicate.index()].rows),
        }
    }
}

/// Whether a clause of the stratum creates new symbols.
fn makes_symbols(plans: &Plans, stratum: &StratumPlan, size: WordSize) -> bool {
    let long = size == WordSize::Bits64;
    let makes = |plan: &Plan| {
        plan.steps.iter().any(|step| match step {
            Step::Compute { functor, .. } => long || functor.makes_symbol(),
            Step::Aggregate { op, .. } | Step::Correlated { op, .. } => {
                long && matches!(op, AggregateOp::Sum | AggregateOp::Mean)
            }
            _ => false,
        })
    };
    let mut inner = stratum
        .correlated
        .iter()
        .filter_map(|predicate| plans.indexes.correlated(*predicate));
    let mut clauses = stratum.clauses.iter();
    clauses.any(|clause| makes(&plans.clauses[clause.index()].complete)) || inner.any(|plans| plans.iter().any(makes))
}

/// The index specifications of a predicate.
pub(crate) fn specs(plans: &Plans, predicate: PredicateId) -> Vec<&IndexSpec> {
    plans.indexes.of(predicate).collect()
}

impl<const W: usize> Store for State<W> {
    fn change(&mut self, predicate: PredicateId, row: &[Value], present: bool) {
        self.widen(predicate);
        if let Some(narrow) = &mut self.narrow[predicate.index()] {
            return narrow.change(row, present);
        }
        let row = Row::new(row);
        if present || self.source_facts[predicate.index()].binary_search(&row).is_err() {
            self.pending[predicate.index()].push(row, present);
        }
    }

    fn insert_all(&mut self, predicate: PredicateId, words: &[Value], arity: usize) {
        self.widen(predicate);
        match &mut self.narrow[predicate.index()] {
            Some(narrow) => narrow.insert_all(words, arity),
            None => self.pending[predicate.index()].extend(words, arity),
        }
    }

    fn reserve(&mut self, predicate: PredicateId, rows: usize) {
        self.widen(predicate);
        match &mut self.narrow[predicate.index()] {
            Some(narrow) => narrow.reserve(rows),
            None => self.pending[predicate.index()].reserve(rows),
        }
    }

    fn pending(&self, predicate: PredicateId) -> usize {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.pending(),
            None => self.pending[predicate.index()].len(),
        }
    }

    fn forget(&mut self, predicate: PredicateId, len: usize) {
        match &mut self.narrow[predicate.index()] {
            Some(narrow) => narrow.forget(len),
            None => self.pending[predicate.index()].truncate(len),
        }
    }

    fn rollback(&mut self) {
        for (pending, facts) in self.pending.iter_mut().zip(&self.source_facts) {
            pending.clear();
            if !self.committed {
                *pending = PendingChanges::of(facts.clone());
            }
        }
        if !self.committed {
            self.narrow
                .iter_mut()
                .flatten()
                .for_each(NarrowTable::insert_source_facts);
        }
    }

    fn commit(
        &mut self,
        compiled: &Compiled,
        symbols: &Symbols,
        options: CommitOptions<'_>,
    ) -> Result<(Delta, EvalStats), EvalError> {
        let mut commit = Commit {
            compiled,
            // The commit is the only owner while it runs, so that it can change the plans in place.
            plans: std::mem::replace(&mut self.plans, Arc::clone(&compiled.plans)),
            symbols,
            options,
            changed: self.tables.iter().map(|_| None).collect(),
            loaded: self.tables.iter().map(|_| None).collect(),
            kept: 0,
        };
        let result = self.try_commit(&mut commit);
        self.plans = Arc::clone(&commit.plans);
        match result {
            Ok((log, costs)) => {
                self.pending.iter_mut().for_each(PendingChanges::clear);
                self.narrow.iter_mut().flatten().for_each(NarrowTable::clear_pending);
                self.costs = costs;
                self.committed = true;
                Ok((commit.into_delta(), log))
            }
            Err(error) => {
                for (loaded, narrow) in commit.loaded.into_iter().zip(&mut self.narrow) {
                    if let (Some(loaded), Some(narrow)) = (loaded, narrow) {
                        drop(loaded);
                        self.rows -= narrow.len();
                        narrow.unload();
                    }
                }
                for (position, changed) in commit.changed.into_iter().enumerate() {
                    let Some((delta, old)) = changed else { continue };
                    drop(delta);
                    self.rows = self.rows + old.rows.len() - self.tables[position].rows.len();
                    let base = commit.plans.member[position].is_none();
                    let pending = &mut self.pending[position];
                    let new = std::mem::replace(&mut self.tables[position], old);
                    // The table took these insertions.
                    if base && pending.is_empty() {
                        pending.put_back(new.rows);
                    }
                }
                Err(error)
            }
        }
    }

    fn contains(&self, predicate: PredicateId, row: &[Value]) -> bool {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.contains(row),
            None => self.tables[predicate.index()]
                .rows
                .binary_search(&Row::new(row))
                .is_ok(),
        }
    }

    fn row(&self, predicate: PredicateId, position: usize) -> &[Value] {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.row(position),
            None => &self.tables[predicate.index()].rows[position].0,
        }
    }

    fn len(&self, predicate: PredicateId) -> usize {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.len(),
            None => self.tables[predicate.index()].rows.len(),
        }
    }

    fn rows(&self, predicate: PredicateId, arity: usize) -> Rows {
        match &self.narrow[predicate.index()] {
            Some(narrow) => narrow.rows(arity),
            None => Rows::of(arity, Arc::clone(&self.tables[predicate.index()].rows)),
        }
    }

    fn bytes(&self) -> u64 {
        let narrow = self.narrow.iter().flatten().map(NarrowTable::pending_bytes);
        let pending = self.pending.iter().map(PendingChanges::bytes).chain(narrow);
        Self::bytes_of(&self.tables, &self.narrow) + pending.sum::<u64>()
    }

    fn save(&self, out: &mut Encoder<'_>) -> io::Result<()> {
        out.flag(self.committed)?;
        for cost in &self.costs {
            out.long(cost.rows_scanned)?;
            out.long(cost.inputs)?;
        }
        for predicate in (0..self.tables.len() as u32).map(PredicateId) {
            let arity = self.plans.indexes.arity(predicate);
            let rows = self.rows(predicate, arity);
            out.count(rows.len())?;
            for word in rows.iter().flatten() {
                out.word(word.0)?;
            }
            let mut changes = Vec::new();
            match &self.narrow[predicate.index()] {
                Some(narrow) => narrow.changes(arity, &mut changes),
                None => self.pending[predicate.index()].list(arity, &mut changes),
            }
            out.count(changes.len() / (arity + 1))?;
            for word in changes {
                out.word(word.0)?;
            }
        }
        Ok(())
    }

    fn load(&mut self, input: &mut Decoder<'_>, rules: &Rules, known: usize) -> Result<(), SnapshotError> {
        self.committed = input.flag()?;
        for cost in &mut self.costs {
            cost.rows_scanned = input.long()?;
            cost.inputs = input.long()?;
        }
        for predicate in (0..self.tables.len() as u32).map(PredicateId) {
            let arity = self.plans.indexes.arity(predicate);
            let columns = &rules.predicates[predicate.index()].columns;
            // The columns of groups are others.
            let interned: Vec<bool> = match self.plans.indexes.is_grouped(predicate) {
                true => vec![false; arity],
                false => columns.iter().map(|column| column.base.is_interned()).collect(),
            };
            let count = input.long()?;
            if count > 0 && !self.committed {
                return Err(SnapshotError::Corrupt);
            }
            match &mut self.narrow[predicate.index()] {
                Some(narrow) => narrow.restore(input, count, &interned, known)?,
                None => {
                    let rows = read_rows(input, count, &interned, known)?;
                    let table = &mut self.tables[predicate.index()];
                    *table = table.reloaded(rows.into());
                }
            }
            self.rows += self.len(predicate);
            self.clear_pending(predicate);
            for _ in 0..input.long()? {
                input.room(1, size_of::<(Row<W>, bool)>())?;
                let row: Row<W> = read_row(input, &interned, known)?;
                let present = input.word()? == 1;
                self.change(predicate, &row.0[..arity], present);
            }
        }
        Ok(())
    }

    fn group(&self, predicate: PredicateId, key: &[Value], op: AggregateOp) -> Option<Value> {
        let rows = Batch::plain(&self.tables[predicate.index()].rows);
        groups::lookup(rows.range(key), key.len(), op)
    }

    fn correlated(
        &self,
        aggregate: &Literal,
        parameters: &[Value],
        symbols: &Symbols,
        (budget, bytes, cancel): (u64, u64, &Cancel),
        calls: Option<&Arc<Calls>>,
    ) -> (Result<Option<Value>, Abort>, u64) {
        let Literal::Aggregate {
            op, base, atom, column, ..
        } = aggregate
        else {
            return (Ok(None), 0);
        };
        let Some(plans) = self.plans.indexes.correlated(atom.predicate) else {
            return (Ok(None), 0);
        };
        // A plan of one step, which derives the value.
        let to = parameters.len() as Slot;
        let plan = Plan {
            head: atom.predicate,
            output: vec![to],
            fold: None,
            steps: vec![Step::Correlated {
                predicate: atom.predicate,
                plans: Arc::clone(plans),
                key: (0..to).collect(),
                op: *op,
                base: *base,
                column: *column,
                to,
                test: false,
            }],
            enough: vec![0],
            slots: parameters.iter().copied().chain([Value(0)]).collect(),
            fresh: None,
        };
        let views: Vec<RowView<'_, W>> = self.complete_views(&self.plans, &plan).collect();
        let (mut state, mut out) = (JoinState::new(budget), Output::<W>::new(usize::MAX));
        state.calls = calls.cloned();
        state.correlated = CorrelatedValues::within(bytes, self.plans.indexes.correlated_len());
        let result = join::run(&plan, &views, (symbols, cancel), &mut state, &mut out);
        let value = result.map(|()| out.take().first().map(|row| row.0[0]));
        (value, state.rows_scanned)
    }

    fn plans(&self) -> &Plans {
        &self.plans
    }

    fn fired(&self, compiled: &Compiled, symbols: &Symbols, clause: ClauseId, bytes: u64) -> Vec<Vec<Value>> {
        let plan = &self.plans.clauses[clause.index()].complete;
        let mut out = Output::new(usize::MAX);
        let source = &compiled.rules.clauses[clause.index()];
        if self.committed && compiled.rules.is_row(source) {
            let words = &constants::<W>(&source.head.terms).0[..source.head.terms.len()];
            return vec![words.to_vec()];
        }
        if self.committed && plan.fold.is_none() {
            let views: Vec<RowView<'_, W>> = self.complete_views(&self.plans, plan).collect();
            let mut state = JoinState::new(u64::MAX);
            state.calls = Some(Calls::new(&compiled.rules.functors));
            state.correlated = CorrelatedValues::caching(bytes);
            // This cannot overflow: what a clause derives is in its head's predicate, which is within the limit.
            let _ = join::run(plan, &views, (symbols, &Cancel::never()), &mut state, &mut out);
        }
        let arity = compiled.rules.predicates[plan.head.index()].arity();
        out.take().iter().map(|row| row.0[..arity].to_vec()).collect()
    }
}

/// Returns the row of a fact.
fn constants<const W: usize>(terms: &[Term]) -> Row<W> {
    let mut row = Row::ZERO;
    for (word, term) in row.0.iter_mut().zip(terms) {
        if let Term::Constant(value) = term {
            *word = *value;
        }
    }
    row
}
