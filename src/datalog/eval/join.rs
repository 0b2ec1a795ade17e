//! Runs a plan: a pipelined nested-loop join over sorted rows, without intermediate relations.

use crate::cancel::Cancel;
use crate::datalog::check::RelId;
use crate::datalog::eval::groups::{self, Groups, KeyHasher};
use crate::datalog::eval::seen_bitmap::{Added, SeenBitmap, raise};
use crate::datalog::plan::steps::{List, Plan, Slot, Source, Step};
use crate::datalog::row::{AnyBatch, AnyRows, Batch, ByWidth, Row, difference, each_width, gallop, normalize};
use crate::datalog::syntax::ast::{BaseType, Comparison};
use crate::datalog::syntax::functor::{AggregateOp, Functor};
use crate::datalog::value::{Patterns, Value};
use crate::symbol::{Symbol, Symbols};
use std::cmp::Ordering;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::BuildHasherDefault;

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

/// A buffer for derived rows. It may hold repetitions.
///
/// Its memory is bounded. Where words are dense, a [`SeenBitmap`] marks rows and filters repetitions. Elsewhere, the
/// buffer sorts its rows when there are many and drops repetitions.
#[derive(Debug)]
pub(crate) struct Output<const W: usize> {
    rows: Vec<Row<W>>,
    /// The number of rows ever pushed.
    pub(crate) pushed: u64,
    /// If present, contains everything in `rows`.
    seen: Option<SeenBitmap<W>>,
    /// Whether `seen`, if present, holds all rows ever pushed.
    whole: bool,
    /// Whether rows have been taken.
    took: bool,
    /// By column: the largest word of the rows taken.
    largest: [u32; W],
    /// Whether `seen` lacks only rows that were taken. [`Output::learn`] can add these.
    may_learn: bool,
    /// Whether `seen` is the only record of the rows taken; see [`Output::remember`].
    remembers: bool,
    /// If so, and `seen` was dropped: the rows taken before.
    taken: Vec<Row<W>>,
    /// The number of new rows that `seen` holds in place of `rows`.
    kept: usize,
    /// The number of rows at which `act` reorganizes the buffer.
    act_at: usize,
    compact_at: usize,
    limit: usize,
    /// The maximum number of distinct rows that memory allows.
    fit: usize,
    /// The lesser of `limit` and `fit`.
    most: usize,
    /// What a plan with a fold derives, in place of rows.
    groups: Option<Box<Groups<W>>>,
    /// Scratch memory of [`Output::push_set`].
    values: Vec<Value>,
}

/// The reason why an evaluation was abandoned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Abort {
    /// The clauses derived more distinct rows than allowed.
    Overflow,
    /// The plans scanned more rows than allowed.
    Budget,
    /// Rows, indexes or texts take more memory than allowed.
    Memory,
    /// The caller cancelled it.
    Cancelled,
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
    /// The maximum size of all texts, in bytes.
    pub(crate) text_bytes: u64,
    /// The correlated aggregates evaluated so far.
    pub(crate) correlated: Values,
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
            text_bytes: u64::MAX,
            correlated: Values::default(),
        }
    }
}

/// The values of correlated aggregates, by relation and parameters. What an aggregate reads is complete, so its values
/// stay valid while a stratum is evaluated.
#[derive(Debug)]
pub(crate) struct Values {
    known: HashMap<RelId, HashMap<Box<[Value]>, Option<Value>>>,
    /// The approximate memory of `known`.
    bytes: u64,
    /// The maximum of `bytes`. The rows of one evaluation may take as much again.
    pub(crate) bytes_max: u64,
}

impl Default for Values {
    /// An empty cache of any size.
    fn default() -> Self {
        Values {
            known: HashMap::new(),
            bytes: 0,
            bytes_max: u64::MAX,
        }
    }
}

impl Values {
    /// The memory of an entry: a table is up to half empty, and has two copies while it grows.
    const ENTRY_BYTES: u64 = 3 * size_of::<(Box<[Value]>, Option<Value>)>() as u64 + 16;

    /// The value for these parameters if it is known. The inner `None` means that the aggregate has no value.
    #[allow(clippy::option_option)]
    fn get(&self, relation: RelId, parameters: &[Value]) -> Option<Option<Value>> {
        self.known.get(&relation)?.get(parameters).copied()
    }

    /// Adds a value. If the memory is full, forgets all others first.
    fn insert(&mut self, relation: RelId, parameters: &[Value], value: Option<Value>) {
        let bytes = Self::ENTRY_BYTES + size_of_val(parameters) as u64;
        if self.bytes.saturating_add(bytes) > self.bytes_max {
            self.known = HashMap::new();
            self.bytes = 0;
        }
        if bytes <= self.bytes_max {
            self.bytes += bytes;
            self.known.entry(relation).or_default().insert(parameters.into(), value);
        }
    }
}

impl<const W: usize> Output<W> {
    /// The number of buffered words (128 MiB) at which the buffer removes repetitions.
    const COMPACT_WORDS: usize = 1 << 25;

    /// The minimum number of rows before the buffer considers a bitmap.
    const SEEN_MIN: usize = 256;

    /// Distinct rows may take 3/4 of the memory. The rest is for a bitmap and for repetitions, so that the buffer is
    /// not sorted for every few rows.
    const FIT_PARTS: usize = 4;

    /// Unused memory at the end of a list is freed from this size on. Freeing less costs more than it saves.
    const SLACK_BYTES: usize = 1 << 20;

    /// Limits a bitmap to 1 GiB, the memory of this number of rows.
    const SEEN_ROWS_MAX: u64 = (1 << 30) / size_of::<Row<W>>() as u64;

    /// An empty buffer that accepts at most `limit` distinct rows.
    pub(crate) fn new(limit: usize) -> Self {
        let compact_at = (Self::COMPACT_WORDS / W).min(limit.saturating_add(1));
        Output {
            rows: Vec::new(),
            pushed: 0,
            seen: None,
            whole: true,
            took: false,
            largest: [0; W],
            may_learn: false,
            remembers: false,
            taken: Vec::new(),
            kept: 0,
            act_at: compact_at.min(Self::SEEN_MIN),
            compact_at,
            limit,
            fit: usize::MAX,
            most: limit,
            groups: None,
            values: Vec::new(),
        }
    }

    /// Limits the memory of the buffer.
    pub(crate) fn set_bytes(&mut self, bytes: u64) {
        let rows = usize::try_from(bytes / size_of::<Row<W>>() as u64).unwrap_or(usize::MAX);
        self.set_fit(rows / Self::FIT_PARTS * (Self::FIT_PARTS - 1));
    }

    fn set_fit(&mut self, fit: usize) {
        self.fit = fit;
        self.most = fit.min(self.limit);
        self.compact_at = self.compact_at.min(self.buffer_max());
        self.act_at = self.act_at.min(self.compact_at);
    }

    /// The maximum number of rows in the list, repetitions included.
    fn buffer_max(&self) -> usize {
        let repeated = self.most / (Self::FIT_PARTS - 1);
        self.most.saturating_add(repeated).saturating_add(1)
    }

    /// Fails if there are too many distinct rows.
    #[inline]
    pub(crate) fn check(&self, rows: usize) -> Result<(), Abort> {
        if rows <= self.most {
            return Ok(());
        }
        Err(if rows > self.limit {
            Abort::Overflow
        } else {
            Abort::Memory
        })
    }

    /// An empty buffer for the output of a plan; it accepts at most `limit` distinct rows.
    pub(crate) fn for_plan(plan: &Plan, limit: usize) -> Self {
        let groups = |fold| Box::new(Groups::new(fold, plan.output.len()));
        Output {
            groups: plan.fold.map(groups),
            ..Self::new(limit)
        }
    }

    /// A buffer that holds these distinct rows.
    pub(crate) fn of(rows: Vec<Row<W>>, limit: usize) -> Self {
        Output {
            rows,
            ..Self::new(limit)
        }
    }

    /// Makes an empty buffer for one of `count` parts of the rows. It filters rows that this one knows. Together, the
    /// parts need no more memory than this buffer has left for them and for its own copy of their rows.
    pub(crate) fn fork(&self, count: usize) -> Self {
        let mut fork = Output {
            seen: self.seen.as_ref().map(SeenBitmap::fork),
            groups: self.groups.as_ref().map(|groups| Box::new(groups.fork())),
            ..Self::new(self.limit / count)
        };
        if self.fit < usize::MAX {
            fork.set_fit(self.fit.saturating_sub(self.rows.len()) / (2 * count));
        }
        fork
    }

    /// Whether the bitmaps of `count` forks fit into memory.
    pub(crate) fn can_fork(&self, count: usize) -> bool {
        self.seen_bytes() / size_of::<Row<W>>() * 2 * count <= self.fit / 4
    }

    /// The bytes of the bitmap of known rows.
    pub(crate) fn seen_bytes(&self) -> usize {
        self.seen.as_ref().map_or(0, SeenBitmap::bytes)
    }

    /// Adds the rows of a fork.
    pub(crate) fn absorb(&mut self, mut fork: Self, symbols: &Symbols) -> Result<(), Abort> {
        let pushed = self.pushed + fork.pushed;
        self.pushed = pushed;
        if let (Some(groups), Some(other)) = (&mut self.groups, fork.groups.take()) {
            groups.merge(*other, symbols);
            let rows = groups.rows();
            return self.check(rows);
        }
        if let (Some(seen), Some(other)) = (&mut self.seen, &fork.seen)
            && other.keeps()
            && seen.is_like(other)
        {
            if !seen.keeps() {
                seen.keep(&self.rows);
                self.kept = std::mem::take(&mut self.rows).len();
            }
            self.kept += seen.absorb(other);
            return self.check(self.kept);
        }
        let rows = fork.take();
        if self.seen.is_none() {
            self.rows.try_reserve_exact(rows.len()).map_err(|_| Abort::Memory)?;
            self.rows.extend_from_slice(&rows);
            drop(rows);
            // A stable sort merges sorted runs, such as those of several forks, in linear time.
            self.rows.sort();
            self.rows.dedup();
            return if self.rows.len() >= self.act_at {
                self.act()
            } else {
                Ok(())
            };
        }
        for row in rows {
            self.push(row)?;
        }
        self.pushed = pushed;
        Ok(())
    }

    /// Sorts the rows if they are in a list.
    pub(crate) fn settle(&mut self) {
        normalize(&mut self.rows);
    }

    /// Whether the buffer is empty.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty() && self.kept == 0 && self.groups.as_ref().is_none_or(|groups| groups.len() == 0)
    }

    /// Adds `times` matches with this key and value; `times` is 1 unless the aggregate is a count.
    #[inline]
    fn fold(&mut self, key: Row<W>, value: Option<Value>, times: u64, symbols: &Symbols) -> Result<(), Abort> {
        self.pushed += times;
        let Some(groups) = &mut self.groups else { return Ok(()) };
        match value {
            Some(value) => groups.add(key, value, symbols),
            None => groups.count(key, times),
        }
        let rows = groups.rows();
        self.check(rows)
    }

    #[inline]
    fn push(&mut self, row: Row<W>) -> Result<(), Abort> {
        self.pushed += 1;
        if let Some(seen) = &mut self.seen {
            match seen.add(&row) {
                Added::Known => return Ok(()),
                Added::New if seen.keeps() => {
                    self.kept += 1;
                    return self.check(self.kept);
                }
                Added::New => {}
                Added::Beyond => self.unmark(),
            }
        }
        self.rows.push(row);
        if self.rows.len() >= self.act_at {
            self.act()
        } else {
            Ok(())
        }
    }

    /// Pushes copies of `row` in which one word is replaced by a column of the rows found.
    #[inline]
    fn push_along<const V: usize>(
        &mut self,
        mut row: Row<W>,
        word: usize,
        found: &[Row<V>],
        column: usize,
    ) -> Result<(), Abort> {
        let mut rest = found;
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.keeps()) {
            let (added, new) = seen.keep_along(row, word, found.iter().map(|other| other.0[column]));
            self.pushed += added as u64;
            self.kept += new;
            self.check(self.kept)?;
            rest = &found[added..];
        }
        for other in rest {
            row.0[word] = other.0[column];
            self.push(row)?;
        }
        Ok(())
    }

    /// The number of words of a set of bits for [`Output::push_set`], and the most words that all sets may take; `None`
    /// if the buffer takes no sets in this column.
    fn set_words(&self, column: usize) -> Option<(usize, usize)> {
        let seen = self.seen.as_ref()?;
        let fit = (self.fit / 12).saturating_mul(size_of::<Row<W>>());
        let most = seen.bytes().min(fit) / size_of::<u64>();
        Some((seen.set_words(column)?, most))
    }

    /// Pushes copies of `row` in which one word is replaced by each of the `count` elements of a set. Returns whether
    /// they fit.
    fn push_set(&mut self, mut row: Row<W>, word: usize, set: &[u64], count: usize) -> Result<bool, Abort> {
        let Some(seen) = &mut self.seen else { return Ok(false) };
        let Some(new) = seen.add_set(row, word, set, &mut self.values) else {
            return Ok(false);
        };
        self.pushed += count as u64;
        if self.values.is_empty() {
            self.kept += new;
            self.check(self.kept)?;
            return Ok(true);
        }
        self.rows.try_reserve(new).map_err(|_| Abort::Memory)?;
        self.rows.extend(self.values.drain(..).map(|value| {
            row.0[word] = value;
            row
        }));
        if self.rows.len() >= self.act_at {
            self.act()?;
        }
        Ok(true)
    }

    /// Replaces the bitmap by a plain list.
    #[cold]
    fn unmark(&mut self) {
        if let Some(mut seen) = self.seen.take() {
            self.largest = seen.largest();
            let all = if self.remembers { seen.all() } else { Vec::new() };
            if seen.keeps() {
                self.rows = seen.drain(std::mem::take(&mut self.kept));
            } else if self.remembers {
                normalize(&mut self.rows);
            }
            self.taken = difference(&all, &self.rows);
        }
        self.remembers = false;
        // Reconsider a bitmap only after more rows.
        self.act_at = (self.rows.len() + Self::SEEN_MIN).min(self.compact_at);
    }

    /// Chooses the better representation of the rows.
    #[cold]
    fn act(&mut self) -> Result<(), Abort> {
        if self.seen.is_none() {
            let rows = self.pushed.min(Self::SEEN_ROWS_MAX).min(self.fit as u64 / 6);
            self.seen = SeenBitmap::over(&self.rows, self.largest, rows);
            if self.seen.is_some() {
                self.whole = !self.took;
                self.may_learn = self.took;
                normalize(&mut self.rows);
            }
        }
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.prefers_bits(self.rows.len())) {
            seen.keep(&self.rows);
            self.kept = self.rows.len();
            self.rows = Vec::new();
        }
        // Without a bitmap, the list may hold repetitions until it is compacted.
        let mut distinct = self.seen.is_some();
        if self.rows.len() >= self.compact_at {
            normalize(&mut self.rows);
            distinct = true;
            self.compact_at = self.compact_at.max(self.rows.len().saturating_mul(2));
            self.compact_at = self.compact_at.min(self.buffer_max());
        }
        self.check(if distinct { self.rows.len() } else { 0 }.max(self.kept))?;
        self.act_at = self
            .rows
            .len()
            .saturating_mul(2)
            .max(Self::SEEN_MIN)
            .min(self.compact_at);
        let more = self.act_at.saturating_sub(self.rows.len());
        self.rows.try_reserve_exact(more).map_err(|_| Abort::Memory)
    }

    /// Takes the distinct rows, in order. Afterwards the buffer is empty, but it may filter these rows when they are
    /// derived again.
    pub(crate) fn take(&mut self) -> Vec<Row<W>> {
        self.take_by(normalize)
    }

    /// Like `take`, with another function to sort rows and remove repetitions.
    pub(crate) fn take_by(&mut self, normalize: impl FnOnce(&mut Vec<Row<W>>)) -> Vec<Row<W>> {
        self.took |= !self.is_empty();
        if let Some(groups) = &mut self.groups {
            return groups.take();
        }
        self.act_at = self.compact_at.min(Self::SEEN_MIN);
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.keeps()) {
            return seen.drain(std::mem::take(&mut self.kept));
        }
        let mut rows = std::mem::take(&mut self.rows);
        normalize(&mut rows);
        if (rows.capacity() - rows.len()) * size_of::<Row<W>>() > Self::SLACK_BYTES {
            rows.shrink_to_fit();
        }
        if self.seen.is_none() {
            raise(&mut self.largest, &rows);
        }
        rows
    }

    /// Adds the rows taken before there was a bitmap, so that the buffer [is whole](Output::is_whole). If a row does
    /// not fit, the buffer is not whole until it has another bitmap.
    pub(crate) fn learn<'a>(&mut self, taken: impl Iterator<Item = &'a [Row<W>]>) {
        if let Some(seen) = self.seen.as_mut().filter(|_| self.may_learn) {
            self.may_learn = false;
            let mut rows = taken.flatten();
            self.whole = rows.all(|row| seen.note(row));
        }
    }

    /// Makes the bitmap the only record of the rows taken. The buffer must [be whole](Output::is_whole). If it drops
    /// the bitmap later, [`Output::forgotten`] returns these rows.
    pub(crate) fn remember(&mut self) {
        self.remembers = true;
    }

    /// Takes the rows that the buffer remembered before it dropped the bitmap, in order.
    pub(crate) fn forgotten(&mut self) -> Vec<Row<W>> {
        std::mem::take(&mut self.taken)
    }

    /// Whether the bitmap holds all rows ever pushed.
    pub(crate) fn is_whole(&self) -> bool {
        self.whole && self.seen.is_some()
    }

    /// The rows in the bitmap, in order: all rows ever pushed if the buffer [is whole](Output::is_whole).
    pub(crate) fn all(&self) -> Vec<Row<W>> {
        self.seen.as_ref().map(SeenBitmap::all).unwrap_or_default()
    }
}

/// The words that follow a word in the rows of a plan's last scan, as sets of bits.
///
/// A recursive clause often finds the same long list of rows for many derived rows. Merging a set into a
/// [`SeenBitmap`] takes one operation for 64 of them.
#[derive(Debug, Default)]
struct WordSets {
    /// By word: the position of its set in `bits`; `None` if the word occurred once, without a set.
    places: HashMap<Value, Option<usize>, BuildHasherDefault<KeyHasher>>,
    bits: Vec<u64>,
    /// The number of words of a set.
    width: usize,
}

impl WordSets {
    /// Shorter lists take less time than their sets.
    const ROWS_MIN: usize = 32;

    /// Returns the set of the words in the second column of `found`, which are less than `64 * width`, sorted batch by
    /// batch, and follow the word `first`. Returns `None` at the first call for a word, or if all sets together would
    /// have more than `most` words.
    fn of<'a, const W: usize>(
        &mut self,
        first: Value,
        found: impl Iterator<Item = AnyRows<'a, W>>,
        (width, most): (usize, usize),
    ) -> Option<&[u64]> {
        if width != self.width {
            *self = WordSets::default();
            self.width = width;
        }
        let place = match self.places.entry(first) {
            Entry::Vacant(entry) => {
                entry.insert(None);
                return None;
            }
            Entry::Occupied(entry) => entry.into_mut(),
        };
        let start = match *place {
            Some(start) => start,
            None if self.bits.len() + width > most => return None,
            None => {
                let start = self.bits.len();
                self.bits.resize(start + width, 0);
                let set = &mut self.bits[start..];
                for rows in found {
                    each_width!(rows, rows => rows.iter().for_each(|row| {
                        let word = row.0[1].0;
                        set[(word / u64::BITS) as usize] |= 1 << (word % u64::BITS);
                    }));
                }
                *place = Some(start);
                start
            }
        };
        Some(&self.bits[start..start + width])
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
        text_bytes: state.text_bytes,
        patterns: None,
        cursors: Vec::new(),
        sets: WordSets::default(),
        known: &mut state.correlated,
        out,
    };
    let result = join.from(0, plan.steps.len());
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
    text_bytes: u64,
    /// Created on first use.
    patterns: Option<Patterns>,
    /// The rest of each list of the active leapfrog joins, and the column of its words.
    cursors: Vec<(AnyRows<'a, W>, usize)>,
    /// The rows of the last scan.
    sets: WordSets,
    /// The correlated aggregates evaluated so far.
    known: &'a mut Values,
    out: &'a mut Output<W>,
}

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
                        _ => compare(self.symbols, *op, left, right, *base),
                    }
                }
                Step::Compute {
                    functor,
                    base,
                    arguments,
                    to,
                    test,
                } => {
                    let value = match functor.makes_text() {
                        true => self.make(*functor, *base, arguments)?,
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
                    // For a relation without columns only the number of rows matters.
                    let values =
                        ranges().flat_map(|range| (0..range.len()).map(move |at| range.words(at)[*column as usize]));
                    let value = op.of(*base, values, self.symbols);
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
        (depth, end, once): (usize, usize, bool),
        key: &[Slot],
        (bind, check): (Columns<'_>, Columns<'_>),
        distinct: usize,
    ) -> Result<bool, Abort> {
        let views = self.views;
        let words = self.key(key);
        let mut any = false;
        for batch in views[depth].batches() {
            any |= each_width!(batch.range(&words[..key.len()]), rows => {
                self.scan_rows((depth, end, once), rows, (bind, check), distinct)?
            });
            if any && once {
                return Ok(true);
            }
        }
        Ok(any)
    }

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
        let mut row = Row(self.key(&self.plan.output));
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
        if let ([(word, 1)], [first]) = (&moves[..count], key)
            && let Some(any) = self.spread_set(depth, *first, row, *word)?
        {
            return Ok(any);
        }
        let mut any = false;
        for batch in views[depth].batches() {
            let found = batch.range(key);
            any |= found.len() > 0;
            self.rows_scanned += found.len() as u64;
            each_width!(found, found => match moves[..count] {
                [(word, column)] => self.out.push_along(row, word, found, column)?,
                _ => {
                    for other in found {
                        for &(word, column) in &moves[..count] {
                            row.0[word] = other.0[column];
                        }
                        self.out.push(row)?;
                    }
                }
            });
        }
        Ok(any)
    }

    /// Like `spread` for rows that follow the word `first` and replace one word of `row`, with all of them as one set.
    /// Does nothing and returns `None` where that is slower or impossible.
    #[inline]
    fn spread_set(&mut self, depth: usize, first: Value, row: Row<W>, word: usize) -> Result<Option<bool>, Abort> {
        let views = self.views;
        let found = || views[depth].batches().map(|batch| batch.range(&[first]));
        let count: usize = found().map(|rows| rows.len()).sum();
        if count < WordSets::ROWS_MIN {
            return Ok(None);
        }
        let Some((width, most)) = self.out.set_words(word).filter(|(width, _)| count >= width / 2) else {
            return Ok(None);
        };
        let largest = found()
            .filter_map(|rows| each_width!(rows, rows => rows.last().map(|row| row.0[1].0)))
            .max();
        if largest.is_none_or(|largest| largest as usize >= width * u64::BITS as usize) {
            return Ok(None);
        }
        let Some(set) = self.sets.of(first, found(), (width, most)) else {
            return Ok(None);
        };
        if !self.out.push_set(row, word, set, count)? {
            return Ok(None);
        }
        self.rows_scanned += count as u64;
        Ok(Some(true))
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
            relation,
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
        if let Some(value) = self.known.get(*relation, parameters) {
            return Ok(value);
        }
        let mut out = Output::new(usize::MAX);
        if let [plan] = &plans[..] {
            out = Output::for_plan(plan, usize::MAX);
        }
        out.set_bytes(self.known.bytes_max);
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
                text_bytes: self.text_bytes,
                patterns: self.patterns.take(),
                cursors: Vec::new(),
                sets: WordSets::default(),
                known: &mut *self.known,
                out: &mut out,
            };
            let result = join.from(1, plan.steps.len());
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
        self.known.insert(*relation, parameters, value);
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

    /// Like [`Join::compute`], for a functor that creates texts. Fails if the texts take too much memory.
    #[cold]
    fn make(&self, functor: Functor, base: BaseType, arguments: &[Slot]) -> Result<Option<Value>, Abort> {
        if functor == Functor::Cat {
            let length = |&slot: &Slot| {
                self.symbols
                    .text(Symbol(self.slots[slot as usize].0))
                    .map_or(0, str::len)
            };
            if arguments.iter().map(length).sum::<usize>() as u64 > self.text_bytes {
                return Err(Abort::Memory);
            }
        }
        let value = self.compute(functor, base, arguments);
        if self.symbols.bytes() > self.text_bytes {
            return Err(Abort::Memory);
        }
        Ok(value)
    }

    fn compute(&self, functor: Functor, base: BaseType, arguments: &[Slot]) -> Option<Value> {
        let slot = |slot: Slot| self.slots[slot as usize];
        match *arguments {
            [a] => functor.apply(base, &[slot(a)], self.symbols),
            [a, b] => functor.apply(base, &[slot(a), slot(b)], self.symbols),
            ref many => {
                let values: Vec<Value> = many.iter().map(|&at| slot(at)).collect();
                functor.apply(base, &values, self.symbols)
            }
        }
    }

    #[cold]
    fn matches(&mut self, pattern: Value, text: Value) -> bool {
        let text = self.symbols.text(Symbol(text.0)).unwrap_or_default();
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

/// Whether a comparison holds. Numbers compare by value; symbols are equal by id and ordered by text.
fn compare(symbols: &Symbols, op: Comparison, left: Value, right: Value, base: BaseType) -> bool {
    let text = |value: Value| symbols.text(Symbol(value.0)).unwrap_or_default();
    let order = || match base {
        BaseType::Number => Some(left.as_number().cmp(&right.as_number())),
        BaseType::Symbol if left == right => Some(Ordering::Equal),
        BaseType::Symbol => Some(text(left).cmp(text(right))),
        BaseType::Unsigned => Some(left.cmp(&right)),
        BaseType::Float => left.as_float().partial_cmp(&right.as_float()),
    };
    match op {
        Comparison::Equal => left == right,
        Comparison::NotEqual => left != right,
        Comparison::Less => order().is_some_and(Ordering::is_lt),
        Comparison::LessEqual => order().is_some_and(Ordering::is_le),
        Comparison::Greater => order().is_some_and(Ordering::is_gt),
        Comparison::GreaterEqual => order().is_some_and(Ordering::is_ge),
        Comparison::Contains => text(right).contains(text(left)),
        Comparison::NotContains => !text(right).contains(text(left)),
        Comparison::Match => Patterns::default().matches(left, text(right), symbols),
        Comparison::NotMatch => !Patterns::default().matches(left, text(right), symbols),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn an_output_holds_what_was_pushed() {
        let mut state = 5_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 4) % below
        };
        let mut known = 0;
        // Dense words, then larger ones, then some that do not fit a bitmap.
        for phases in [
            &[40, 40, 300, 300, 2_000][..],
            &[3_000, 20, 100_000_000, 20, 20],
            &[1, 1],
        ] {
            let mut out = Output::<2>::new(usize::MAX);
            assert!(!out.is_whole());
            let mut before: BTreeSet<Row<2>> = BTreeSet::new();
            for &words in phases {
                let mut pushed: BTreeSet<Row<2>> = BTreeSet::new();
                for _ in 0..20_000 {
                    if random(10) == 0 {
                        let first = Value(random(words));
                        let found: Vec<Row<2>> =
                            (0..random(50)).map(|_| Row([Value(0), Value(random(words))])).collect();
                        pushed.extend(found.iter().map(|row| Row([first, row.0[1]])));
                        out.push_along(Row([first, Value(9)]), 1, &found, 1).unwrap();
                    } else {
                        let row = Row([Value(random(words)), Value(random(words))]);
                        pushed.insert(row);
                        out.push(row).unwrap();
                    }
                }
                let taken = out.take();
                assert!(out.is_empty());
                assert!(taken.is_sorted_by(|a, b| a < b));
                assert!(taken.iter().all(|row| pushed.contains(row)));
                let taken: BTreeSet<Row<2>> = taken.into_iter().collect();
                assert!(pushed.iter().all(|row| taken.contains(row) || before.contains(row)));
                before.extend(pushed);
                if out.is_whole() {
                    assert!(out.all().iter().eq(&before));
                    known += 1;
                }
            }
        }
        // Phases with words that stay dense.
        assert_eq!(known, 4);
    }

    #[test]
    fn sets_of_words_equal_their_rows() {
        let mut state = 9_u32;
        let mut random = move |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        // The last column is padding.
        let (mut sets, mut plain) = (Output::<3>::new(usize::MAX), Output::<3>::new(usize::MAX));
        let mut pushed = [0; 2];
        let mut all: [BTreeSet<Row<3>>; 2] = Default::default();
        // Many new rows, then few, then words beyond the bounds.
        for (times, words) in [
            (300, 2_000),
            (300, 2_000),
            (3_000, 2_000),
            (50, 2_000),
            (3, 100_000),
            (50, 2_000),
        ] {
            for _ in 0..times {
                let row = Row([Value(random(40)), Value(9), Value(0)]);
                let found: BTreeSet<u32> = (0..random(600)).map(|_| random(words)).collect();
                let found: Vec<Row<3>> = (found.iter())
                    .map(|&word| Row([Value(5), Value(word), Value(0)]))
                    .collect();
                plain.push_along(row, 1, &found, 1).unwrap();
                let width = sets.set_words(1).map_or(0, |(width, _)| width);
                let fits = found.last().is_some_and(|last| (last.0[1].0 as usize) < width * 64);
                let mut done = false;
                if fits && random(4) > 0 {
                    let mut bits = vec![0_u64; width];
                    for row in &found {
                        bits[row.0[1].0 as usize / 64] |= 1 << (row.0[1].0 % 64);
                    }
                    let keeps = sets.seen.as_ref().is_some_and(SeenBitmap::keeps);
                    // The first word may exceed its bound.
                    done = sets.push_set(row, 1, &bits, found.len()).unwrap();
                    pushed[usize::from(keeps)] += usize::from(done);
                }
                if !done {
                    sets.push_along(row, 1, &found, 1).unwrap();
                }
            }
            assert_eq!(sets.pushed, plain.pushed);
            // An output may repeat rows that were taken before.
            all[0].extend(sets.take());
            all[1].extend(plain.take());
            assert!(all[0] == all[1]);
        }
        assert!(pushed.iter().all(|&count| count > 20), "{pushed:?}");
    }

    #[test]
    fn known_values_are_limited() {
        let mut values = Values {
            bytes_max: 10_000,
            ..Values::default()
        };
        let relation = RelId(3);
        for n in 0..1_000 {
            values.insert(relation, &[Value(n), Value(1)], Some(Value(n)));
            assert!(values.bytes <= 10_000);
            assert_eq!(values.get(relation, &[Value(n), Value(1)]), Some(Some(Value(n))));
        }
        assert_eq!(values.get(relation, &[Value(0), Value(1)]), None);
        values.bytes_max = 0;
        values.insert(relation, &[Value(0)], None);
        assert_eq!((values.get(relation, &[Value(0)]), values.bytes), (None, 0));
    }

    #[test]
    fn an_output_is_limited() {
        for words in [1_000, 1_000_000_000] {
            let mut out = Output::<2>::new(10_000);
            let mut pushed = 0;
            while pushed < 100_000
                && out
                    .push(Row([Value(pushed / 100 * (words / 1_000)), Value(pushed % 100)]))
                    .is_ok()
            {
                pushed += 1;
            }
            assert!((10_000..20_000).contains(&pushed), "{pushed}");
            let mut out = Output::<2>::new(10_000);
            let again = (0..100_000_u32).map(|n| Row([Value(n % 10_000 * (words / 10_000).max(1)), Value(7)]));
            assert!(again.map(|row| out.push(row)).all(|result| result.is_ok()));
            assert!(out.take().len() <= 10_000);
        }
    }
}
