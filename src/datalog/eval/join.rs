//! Runs a plan: a pipelined nested-loop join over sorted rows, without intermediate predicates.
// Decision: docs/decisions/evaluation.md#d017

use crate::cancel::Cancel;
use crate::eval::calls::Calls;
use crate::eval::correlated::CorrelatedValues;
use crate::eval::groups;
use crate::eval::output::{Abort, Output};
use crate::eval::word_sets::WordSets;
use crate::plan::steps::{List, Plan, Slot, Source, Step};
use crate::row::{AnyBatch, AnyRows, Batch, ByWidth, Row, each_width, gallop};
use crate::symbol::{Symbol, Symbols, WordSize};
use crate::syntax::ast::{BaseType, Comparison};
use crate::syntax::functor::{AggregateOp, Functor};
use crate::value::{Patterns, Value};
use std::sync::Arc;

/// The rows that a step reads, as sorted batches. A leapfrog join has one batch for each list, and a correlated
/// aggregate one for each source of its plans.
#[derive(Clone, Debug)]
pub(crate) struct RowView<'a, const W: usize> {
    pub(crate) first: AnyBatch<'a, W>,
    pub(crate) rest: Vec<AnyBatch<'a, W>>,
}

impl<'a, const W: usize> RowView<'a, W> {
    /// The view of a step that reads no rows.
    pub(crate) const NONE: Self = RowView {
        first: ByWidth::Own(Batch { rows: &[], starts: &[] }),
        rest: Vec::new(),
    };

    /// A view of one batch.
    pub(crate) fn of(first: AnyBatch<'a, W>) -> Self {
        RowView {
            first,
            rest: Vec::new(),
        }
    }

    /// The view of a step; `batch` returns the rows of a source.
    #[inline]
    pub(crate) fn for_step(step: &Step, mut batch: impl FnMut(Source) -> AnyBatch<'a, W>) -> Self {
        match (step.source(), step) {
            (Some(source), _) => RowView::of(batch(source)),
            (None, Step::LeapfrogJoin { .. } | Step::Correlated { .. }) => {
                let mut batches = step.sources().map(batch);
                batches.next().map_or(RowView::NONE, |first| RowView {
                    first,
                    rest: batches.collect(),
                })
            }
            _ => RowView::NONE,
        }
    }

    pub(crate) fn batches(&self) -> impl Iterator<Item = &AnyBatch<'a, W>> {
        std::iter::once(&self.first).chain(&self.rest)
    }

    #[inline]
    fn holds(&self, key: &[Value]) -> bool {
        self.first.holds(key) || self.rest.iter().any(|batch| batch.holds(key))
    }
}

/// The scratch memory, counters and limits of evaluations.
#[derive(Debug)]
pub(crate) struct JoinState {
    slots: Vec<Value>,
    /// Rows that scans and tests have visited.
    pub(crate) rows_scanned: u64,
    /// The maximum of `rows_scanned`.
    pub(crate) budget: u64,
    /// With more rows than this, budget and cancellation are checked.
    next_poll: u64,
    /// The maximum size of all symbols, in bytes.
    pub(crate) symbol_bytes: u64,
    /// The correlated aggregates evaluated so far.
    pub(crate) correlated: CorrelatedValues,
    /// The user-defined functors; `None` if no clause applies one.
    pub(crate) calls: Option<Arc<Calls>>,
}

impl JoinState {
    /// Cancellation polling interval, in scanned rows: a fraction of a millisecond.
    const POLL_INTERVAL: u64 = 1 << 14;

    /// A state that has scanned nothing.
    pub(crate) fn new(budget: u64) -> Self {
        JoinState {
            slots: Vec::new(),
            rows_scanned: 0,
            budget,
            next_poll: budget.min(Self::POLL_INTERVAL),
            symbol_bytes: u64::MAX,
            correlated: CorrelatedValues::default(),
            calls: None,
        }
    }
}

/// Evaluates a plan. `views` has one element per step.
pub(crate) fn run<const W: usize>(
    plan: &Plan,
    views: &[RowView<'_, W>],
    (symbols, cancel): (&Symbols, &Cancel),
    state: &mut JoinState,
    out: &mut Output<W>,
) -> Result<(), Abort> {
    state.slots.clear();
    state.slots.extend_from_slice(&plan.slots);
    let mut join = Join {
        plan,
        views,
        symbols,
        slots: &mut state.slots,
        rows_scanned: state.rows_scanned,
        budget: state.budget,
        next_poll: state.next_poll,
        cancel,
        symbol_bytes: state.symbol_bytes,
        patterns: None,
        cursors: Vec::new(),
        sets: WordSets::default(),
        known: &mut state.correlated,
        calls: state.calls.as_deref(),
        deferred: Vec::new(),
        out,
    };
    let result = join.from(0, plan.steps.len()).and_then(|_| join.finish());
    (state.rows_scanned, state.next_poll) = (join.rows_scanned, join.next_poll);
    result?;
    // The last scan may have exceeded the budget.
    if state.rows_scanned > state.budget {
        return Err(Abort::Budget);
    }
    Ok(())
}

/// Columns of an index with their slots.
type Columns<'a> = &'a [(u16, Slot)];

struct Join<'a, const W: usize> {
    plan: &'a Plan,
    views: &'a [RowView<'a, W>],
    symbols: &'a Symbols,
    slots: &'a mut [Value],
    rows_scanned: u64,
    budget: u64,
    next_poll: u64,
    cancel: &'a Cancel,
    symbol_bytes: u64,
    /// Created on first use.
    patterns: Option<Patterns>,
    /// The rest of each list of the active leapfrog joins, and the column of its words.
    cursors: Vec<(AnyRows<'a, W>, usize)>,
    /// The rows of the last scan.
    sets: WordSets,
    /// The correlated aggregates evaluated so far.
    known: &'a mut CorrelatedValues,
    calls: Option<&'a Calls>,
    /// The calls of functors that wait for others, by step.
    deferred: Vec<Deferred>,
    out: &'a mut Output<W>,
}

/// Calls of a functor that wait until there are enough of them.
struct Deferred {
    /// The position of the step.
    depth: usize,
    /// The slots of each call.
    slots: Vec<Value>,
    calls: usize,
}

/// The number of calls of a functor that are evaluated together.
const CALLS: usize = 4096;

impl<const W: usize> Join<'_, W> {
    /// Runs the steps from `depth` to `end` and returns whether they succeeded at least once. A success of all steps
    /// derives a row.
    fn from(&mut self, depth: usize, end: usize) -> Result<bool, Abort> {
        let plan = self.plan;
        let mut depth = depth;
        loop {
            if depth == end {
                return if end == plan.steps.len() { self.emit() } else { Ok(true) };
            }
            let passed = match &plan.steps[depth] {
                step @ (Step::Scan { .. } | Step::LeapfrogJoin { .. }) => match plan.enough[depth] as usize {
                    0 => return self.branch(step, depth, (end, false)),
                    // An existential group contains only existential groups, so this one ends at or before `end`.
                    part => {
                        let passed = self.branch(step, depth, (part, true))?;
                        if part == plan.steps.len() {
                            return Ok(passed);
                        }
                        depth = part - 1;
                        passed
                    }
                },
                Step::Exists { key, .. } => self.holds(depth, key),
                Step::AntiJoin { key, .. } => !self.holds(depth, key),
                Step::Copy { to, from } => {
                    self.slots[*to as usize] = self.slots[*from as usize];
                    true
                }
                Step::Compare { op, left, right, base } => {
                    let (left, right) = (self.slots[*left as usize], self.slots[*right as usize]);
                    match op {
                        Comparison::Match => self.matches(left, right),
                        Comparison::NotMatch => !self.matches(left, right),
                        _ => op.holds(*base, left, right, self.symbols, || unreachable!("matched above")),
                    }
                }
                Step::Compute {
                    functor,
                    base,
                    arguments,
                    to,
                    test,
                } => {
                    let value = match functor.makes_symbol() {
                        true if *functor == Functor::Call => match self.call(depth, end, arguments)? {
                            Some(value) => value,
                            None => return Ok(false),
                        },
                        true => self.make(*functor, *base, arguments)?,
                        false if self.symbols.word_size() == WordSize::Bits64 => {
                            self.make(*functor, *base, arguments)?
                        }
                        false => self.compute(*functor, *base, arguments),
                    };
                    self.fill(*to, *test, value)
                }
                Step::Aggregate {
                    key,
                    op,
                    base,
                    column,
                    to,
                    test,
                    ..
                } => {
                    let words = self.key(key);
                    let views = self.views;
                    let ranges = || views[depth].batches().map(|batch| batch.range(&words[..key.len()]));
                    self.rows_scanned += ranges().map(|range| range.len() as u64).sum::<u64>();
                    if self.rows_scanned > self.next_poll {
                        self.poll()?;
                    }
                    // For a predicate without columns only the number of rows matters.
                    let values =
                        ranges().flat_map(|range| (0..range.len()).map(move |at| range.words(at)[*column as usize]));
                    let value = op.of(*base, values, self.symbols);
                    // The sum and the mean of numbers of 64 bits may be new.
                    if self.symbols.bytes() > self.symbol_bytes && self.symbols.word_size() == WordSize::Bits64 {
                        return Err(Abort::Memory);
                    }
                    self.fill(*to, *test, value)
                }
                step @ Step::Correlated { to, test, .. } => {
                    let value = self.correlated(step, depth)?;
                    self.fill(*to, *test, value)
                }
                Step::Group { key, op, to, test, .. } => {
                    self.rows_scanned += 1;
                    let words = self.key(key);
                    let found = self.views[depth].first.range(&words[..key.len()]);
                    let value = each_width!(found, found => groups::lookup(found, key.len(), *op));
                    self.fill(*to, *test, value)
                }
            };
            if !passed {
                return Ok(false);
            }
            depth += 1;
        }
    }

    /// Checks the budget and polls for cancellation.
    #[cold]
    fn poll(&mut self) -> Result<(), Abort> {
        if self.rows_scanned > self.budget {
            return Err(Abort::Budget);
        }
        if self.cancel.requested() {
            return Err(Abort::Cancelled);
        }
        self.next_poll = self.budget.min(self.rows_scanned + JoinState::POLL_INTERVAL);
        Ok(())
    }

    #[inline]
    fn holds(&mut self, depth: usize, key: &[Slot]) -> bool {
        self.rows_scanned += 1;
        let view = &self.views[depth];
        match *key {
            [slot] => view.holds(&[self.slots[slot as usize]]),
            [first, second] => view.holds(&[self.slots[first as usize], self.slots[second as usize]]),
            _ => view.holds(&self.key(key)[..key.len()]),
        }
    }

    /// Runs a step that may continue more than once, and the steps behind it up to `end`. With `once`, stops at the
    /// first success.
    fn branch(&mut self, step: &Step, depth: usize, (end, once): (usize, bool)) -> Result<bool, Abort> {
        if self.rows_scanned > self.next_poll {
            self.poll()?;
        }
        match step {
            Step::Scan {
                key,
                bind,
                check,
                distinct,
                ..
            } => {
                let last = depth + 1 == self.plan.steps.len();
                if last && !once && check.is_empty() && *distinct == 0 {
                    let words = self.key(key);
                    match self.plan.fold {
                        None => return self.spread(depth, &words[..key.len()], bind),
                        Some(_) if counts(self.plan, bind) => return self.count(depth, &words[..key.len()]),
                        Some(_) => {}
                    }
                }
                self.scan((depth, end, once), key, (bind, check), *distinct as usize)
            }
            Step::LeapfrogJoin { lists, to } => {
                let base = self.cursors.len();
                let result = self.leapfrog_join((depth, end, once), lists, *to);
                self.cursors.truncate(base);
                result
            }
            _ => Ok(false),
        }
    }

    fn scan(
        &mut self,
        place: (usize, usize, bool),
        key: &[Slot],
        columns: (Columns<'_>, Columns<'_>),
        distinct: usize,
    ) -> Result<bool, Abort> {
        let views = self.views;
        let (depth, _, once) = place;
        let words = self.key(key);
        let words = &words[..key.len()];
        let mut any = false;
        for batch in views[depth].batches() {
            any |= match batch {
                ByWidth::Own(batch) => self.scan_rows(place, batch.range(words), columns, distinct)?,
                narrow => self.scan_narrow(place, narrow.range(words), columns, distinct)?,
            };
            if any && once {
                return Ok(true);
            }
        }
        Ok(any)
    }

    /// Like `scan_rows`, apart from it to keep that small.
    #[inline(never)]
    fn scan_narrow(
        &mut self,
        place: (usize, usize, bool),
        rows: AnyRows<'_, W>,
        columns: (Columns<'_>, Columns<'_>),
        distinct: usize,
    ) -> Result<bool, Abort> {
        each_width!(rows, rows => self.scan_rows(place, rows, columns, distinct))
    }

    #[inline(always)]
    fn scan_rows<const V: usize>(
        &mut self,
        (depth, end, once): (usize, usize, bool),
        rows: &[Row<V>],
        (bind, check): (Columns<'_>, Columns<'_>),
        distinct: usize,
    ) -> Result<bool, Abort> {
        let last = depth + 1 == self.plan.steps.len();
        let mut any = false;
        let mut rest = rows;
        while let Some((row, others)) = rest.split_first() {
            rest = others;
            if distinct > 0 {
                rest = &rest[gallop(rest, |other| other.0[..distinct] == row.0[..distinct])..];
            }
            self.rows_scanned += 1;
            for &(column, slot) in bind {
                self.slots[slot as usize] = row.0[column as usize];
            }
            if check
                .iter()
                .any(|&(column, slot)| self.slots[slot as usize] != row.0[column as usize])
            {
                continue;
            }
            if if last { self.emit()? } else { self.from(depth + 1, end)? } {
                any = true;
                if once {
                    return Ok(true);
                }
            }
        }
        Ok(any)
    }

    /// The leapfrog join. Each list in turn seeks the first word not less than the largest one found so far. When all
    /// lists have found the same word, it is in the intersection. The caller drops the cursors.
    fn leapfrog_join(
        &mut self,
        (depth, end, once): (usize, usize, bool),
        lists: &[List],
        to: Slot,
    ) -> Result<bool, Abort> {
        let views = self.views;
        let base = self.cursors.len();
        for (list, batch) in lists.iter().zip(views[depth].batches()) {
            let words = self.key(&list.key);
            let rows = batch.range(&words[..list.key.len()]);
            self.cursors.push((rows, list.key.len()));
        }
        let (mut any, mut word, mut agreeing, mut at) = (false, Value(0), 0, 0);
        loop {
            self.rows_scanned += 1;
            let (rows, column) = &mut self.cursors[base + at];
            let found = each_width!(rows, rows => {
                *rows = &rows[gallop(rows, |row| row.0[*column] < word)..];
                rows.first().map(|row| row.0[*column])
            });
            let Some(found) = found else { return Ok(any) };
            agreeing = if found == word { agreeing + 1 } else { 1 };
            word = found;
            at = (at + 1) % lists.len();
            if agreeing < lists.len() {
                continue;
            }
            self.slots[to as usize] = word;
            if self.from(depth + 1, end)? {
                any = true;
                if once {
                    return Ok(true);
                }
            }
            let Some(next) = word.0.checked_add(1) else {
                return Ok(any);
            };
            (word, agreeing) = (Value(next), 0);
        }
    }

    /// Runs the last scan of a plan: every row found derives a row.
    fn spread(&mut self, depth: usize, key: &[Value], bind: &[(u16, Slot)]) -> Result<bool, Abort> {
        let row = Row(self.key(&self.plan.output));
        // (word of the derived row, column of the index)
        let mut moves = [(0, 0); W];
        let mut count = 0;
        for (word, slot) in self.plan.output.iter().enumerate() {
            if let Some(&(column, _)) = bind.iter().find(|(_, bound)| bound == slot) {
                moves[count] = (word, column as usize);
                count += 1;
            }
        }
        let views = self.views;
        let derived = (row, &moves[..count]);
        let mut any = false;
        for (position, batch) in (0..).zip(views[depth].batches()) {
            any |= match batch {
                ByWidth::Own(batch) => self.spread_rows(position, key, batch.range(key), derived)?,
                narrow => self.spread_narrow(position, key, narrow.range(key), derived)?,
            };
        }
        Ok(any)
    }

    /// Like `spread_rows`, apart from it to keep that small.
    #[inline(never)]
    fn spread_narrow(
        &mut self,
        batch: u32,
        key: &[Value],
        found: AnyRows<'_, W>,
        derived: (Row<W>, &[(usize, usize)]),
    ) -> Result<bool, Abort> {
        each_width!(found, found => self.spread_rows(batch, key, found, derived))
    }

    /// Derives a row from each row of a batch that begins with `key`: copies of a row in which some words are replaced
    /// by columns.
    #[inline(always)]
    fn spread_rows<const V: usize>(
        &mut self,
        batch: u32,
        key: &[Value],
        found: &[Row<V>],
        (mut row, moves): (Row<W>, &[(usize, usize)]),
    ) -> Result<bool, Abort> {
        self.rows_scanned += found.len() as u64;
        if let [(word, column)] = *moves {
            let is_long = column == 1 && key.len() == 1 && found.len() >= WordSets::ROWS_MIN;
            if !is_long || !self.spread_set((batch, key[0]), found, row, word)? {
                self.out.push_along(row, word, found, column)?;
            }
        } else {
            for other in found {
                for &(word, column) in moves {
                    row.0[word] = other.0[column];
                }
                self.out.push(row)?;
            }
        }
        Ok(!found.is_empty())
    }

    /// Derives rows in which one word is replaced by the second column of `found`, with all of them as one set. Does
    /// nothing and returns false where that is slower or impossible. `place` is the batch and the first word of
    /// `found`.
    fn spread_set<const V: usize>(
        &mut self,
        place: (u32, Value),
        found: &[Row<V>],
        row: Row<W>,
        word: usize,
    ) -> Result<bool, Abort> {
        let sizes = self.out.set_words(word).filter(|(width, _)| found.len() >= width / 2);
        let (Some(sizes), Some(largest)) = (sizes, found.last().map(|row| row.0[1].0)) else {
            return Ok(false);
        };
        if largest as usize >= sizes.0 * u64::BITS as usize {
            return Ok(false);
        }
        match self.sets.of(place, found, sizes) {
            Some(set) => self.out.push_set(row, word, set, found.len()),
            None => Ok(false),
        }
    }

    /// Runs the last scan of a plan that counts: all rows found are in the same group.
    fn count(&mut self, depth: usize, key: &[Value]) -> Result<bool, Abort> {
        self.rows_scanned += 1;
        let found: usize = self.views[depth].batches().map(|batch| batch.range(key).len()).sum();
        if found > 0 {
            let row = Row(self.key(&self.plan.output));
            self.out.fold(row, None, found as u64, self.symbols)?;
        }
        Ok(found > 0)
    }

    /// Returns the value of a correlated aggregate for its parameters.
    #[cold]
    fn correlated(&mut self, step: &Step, depth: usize) -> Result<Option<Value>, Abort> {
        let Step::Correlated {
            predicate,
            plans,
            key,
            op,
            base,
            column,
            ..
        } = step
        else {
            return Ok(None);
        };
        self.rows_scanned += 1;
        if self.rows_scanned > self.next_poll {
            self.poll()?;
        }
        let words = self.key(key);
        let parameters = &words[..key.len()];
        if let Some(value) = self.known.get(*predicate, parameters) {
            return Ok(value);
        }
        let mut out = Output::new(usize::MAX);
        if let [plan] = &plans[..] {
            out = Output::for_plan(plan, usize::MAX);
        }
        out.set_bytes(self.known.rows_bytes_max);
        let views = self.views;
        let mut batches = views[depth].batches().copied();
        for plan in plans.iter() {
            let view = |(position, step): (usize, &Step)| match position {
                0 => RowView::NONE,
                _ => RowView::for_step(step, |_| batches.next().unwrap_or(RowView::NONE.first)),
            };
            let views: Vec<RowView<'_, W>> = plan.steps.iter().enumerate().map(view).collect();
            let mut slots = plan.slots.clone();
            if !is_bound(plan, &mut slots, parameters) {
                continue;
            }
            let mut join = Join {
                plan,
                views: &views,
                symbols: self.symbols,
                slots: &mut slots,
                rows_scanned: self.rows_scanned,
                budget: self.budget,
                next_poll: self.next_poll,
                cancel: self.cancel,
                symbol_bytes: self.symbol_bytes,
                patterns: self.patterns.take(),
                cursors: Vec::new(),
                sets: WordSets::default(),
                known: &mut *self.known,
                calls: self.calls,
                deferred: Vec::new(),
                out: &mut out,
            };
            let result = join.from(1, plan.steps.len()).and_then(|_| join.finish());
            self.patterns = join.patterns.take();
            (self.rows_scanned, self.next_poll) = (join.rows_scanned, join.next_poll);
            result?;
        }
        let grouped = plans.iter().any(|plan| plan.fold.is_some());
        let found = out.take();
        out.check(found.len())?;
        let value = match grouped {
            true => groups::lookup(&found, parameters.len(), *op),
            false => {
                let values = found.iter().map(|row| column.map_or(Value(0), |column| row.0[column]));
                op.of(*base, values, self.symbols)
            }
        };
        self.known.insert(*predicate, parameters, value);
        Ok(value)
    }

    /// Stores a value in a slot, or compares it with the slot.
    fn fill(&mut self, to: Slot, test: bool, value: Option<Value>) -> bool {
        let slot = &mut self.slots[to as usize];
        match value {
            Some(value) if test => *slot == value,
            Some(value) => {
                *slot = value;
                true
            }
            None => false,
        }
    }

    /// Like [`Join::compute`], for a functor that creates symbols. Fails if the symbols take too much memory.
    #[cold]
    fn make(&self, functor: Functor, base: BaseType, arguments: &[Slot]) -> Result<Option<Value>, Abort> {
        if functor == Functor::Cat {
            let length = |&slot: &Slot| {
                self.symbols
                    .resolve(Symbol(self.slots[slot as usize].0))
                    .map_or(0, str::len)
            };
            if arguments.iter().map(length).sum::<usize>() as u64 > self.symbol_bytes {
                return Err(Abort::Memory);
            }
        }
        let value = self.compute(functor, base, arguments);
        if self.symbols.bytes() > self.symbol_bytes {
            return Err(Abort::Memory);
        }
        Ok(value)
    }

    /// Calls a user-defined functor. Returns `None` if the call waits for others; `finish` continues behind it.
    #[cold]
    fn call(&mut self, depth: usize, end: usize, arguments: &[Slot]) -> Result<Option<Option<Value>>, Abort> {
        // In an existential group, the steps before this one ask whether it succeeds.
        let is_asked = self.plan.enough[..depth].iter().any(|&part| part as usize > depth);
        if is_asked || end != self.plan.steps.len() {
            let rows: Vec<Value> = arguments[1..].iter().map(|&slot| self.slots[slot as usize]).collect();
            let values = self.apply(arguments, (&rows, 1))?;
            return Ok(Some(values.into_iter().next().flatten()));
        }
        let at = match self.deferred.iter().position(|deferred| deferred.depth == depth) {
            Some(at) => at,
            None => {
                self.deferred.push(Deferred {
                    depth,
                    slots: Vec::new(),
                    calls: 0,
                });
                self.deferred.len() - 1
            }
        };
        let deferred = &mut self.deferred[at];
        deferred.slots.extend_from_slice(self.slots);
        deferred.calls += 1;
        if deferred.calls == CALLS {
            self.resume(at)?;
        }
        Ok(None)
    }

    /// Evaluates all calls that wait, and what follows from them.
    fn finish(&mut self) -> Result<(), Abort> {
        while let Some(at) = (0..self.deferred.len())
            .filter(|&at| self.deferred[at].calls > 0)
            .min_by_key(|&at| self.deferred[at].depth)
        {
            self.resume(at)?;
        }
        Ok(())
    }

    /// Evaluates the calls of a step, and continues behind each of them.
    fn resume(&mut self, at: usize) -> Result<(), Abort> {
        let deferred = &mut self.deferred[at];
        let (depth, slots) = (deferred.depth, std::mem::take(&mut deferred.slots));
        let calls = std::mem::take(&mut deferred.calls);
        let plan = self.plan;
        let Step::Compute {
            arguments, to, test, ..
        } = &plan.steps[depth]
        else {
            return Ok(());
        };
        let width = self.slots.len();
        let call = |at: usize| &slots[at * width..(at + 1) * width];
        let rows: Vec<Value> = (0..calls)
            .flat_map(|at| arguments[1..].iter().map(move |&slot| call(at)[slot as usize]))
            .collect();
        let values = self.apply(arguments, (&rows, calls))?;
        let before = self.slots.to_vec();
        for (at, value) in values.into_iter().enumerate() {
            self.slots.copy_from_slice(call(at));
            if self.fill(*to, *test, value) {
                self.from(depth + 1, plan.steps.len())?;
            }
        }
        self.slots.copy_from_slice(&before);
        Ok(())
    }

    fn apply(&mut self, arguments: &[Slot], rows: (&[Value], usize)) -> Result<Vec<Option<Value>>, Abort> {
        self.rows_scanned += rows.1 as u64;
        if self.rows_scanned > self.next_poll {
            self.poll()?;
        }
        let at = self.slots[arguments[0] as usize].0 as usize;
        let calls = self.calls.ok_or(Abort::Functor)?;
        let values = calls.apply(at, rows, self.symbols).map_err(|_| Abort::Functor)?;
        match self.symbols.bytes() > self.symbol_bytes {
            true => Err(Abort::Memory),
            false => Ok(values),
        }
    }

    fn compute(&self, functor: Functor, base: BaseType, arguments: &[Slot]) -> Option<Value> {
        let slot = |slot: Slot| self.slots[slot as usize];
        match *arguments {
            [a] => functor.apply(base, &[slot(a)], self.symbols),
            [a, b] => functor.apply(base, &[slot(a), slot(b)], self.symbols),
            [a, b, c] => functor.apply(base, &[slot(a), slot(b), slot(c)], self.symbols),
            ref many => {
                let values: Vec<Value> = many.iter().map(|&at| slot(at)).collect();
                functor.apply(base, &values, self.symbols)
            }
        }
    }

    #[cold]
    fn matches(&mut self, pattern: Value, text: Value) -> bool {
        let text = self.symbols.resolve(Symbol(text.0)).unwrap_or_default();
        let patterns = self.patterns.get_or_insert_default();
        patterns.matches(pattern, text, self.symbols)
    }

    #[inline]
    fn emit(&mut self) -> Result<bool, Abort> {
        let row = Row(self.key(&self.plan.output));
        match self.plan.fold {
            None => self.out.push(row)?,
            Some(fold) => {
                let value = fold.value.map(|slot| self.slots[slot as usize]);
                self.out.fold(row, value, 1, self.symbols)?;
            }
        }
        Ok(true)
    }

    #[inline]
    fn key(&self, slots: &[Slot]) -> [Value; W] {
        let mut words = [Value(0); W];
        for (word, &slot) in words.iter_mut().zip(slots) {
            *word = self.slots[slot as usize];
        }
        words
    }
}

/// Whether only the number of rows of the last scan, which binds these columns, matters.
pub(crate) fn counts(plan: &Plan, bind: Columns<'_>) -> bool {
    plan.fold.is_some_and(|fold| fold.op == AggregateOp::Count)
        && !bind.iter().any(|(_, slot)| plan.output.contains(slot))
}

/// Puts the parameters of a correlated aggregate into the slots that the first step of its plan binds. Returns whether
/// they agree with the head of the clause.
fn is_bound(plan: &Plan, slots: &mut [Value], parameters: &[Value]) -> bool {
    let Some(Step::Scan { bind, check, .. }) = plan.steps.first() else {
        return true;
    };
    for &(column, slot) in bind {
        slots[slot as usize] = parameters[column as usize];
    }
    let mut checks = check.iter();
    checks.all(|&(column, slot)| slots[slot as usize] == parameters[column as usize])
}
