//! Runs the steps of a plan: one pipelined nested-loop join over sorted rows, without intermediate relations.

use crate::engine::plan::{Plan, Slot, Step};
use crate::engine::row::{Batch, Row, normalise};
use crate::lang::{BaseType, Comparison, Functor, Patterns, Value};
use crate::symbol::{Symbol, Symbols};
use std::cmp::Ordering;

/// The rows a step looks at: sorted batches, mostly one.
#[derive(Clone, Debug)]
pub(super) struct View<'a, const W: usize> {
    pub(super) first: Batch<'a, W>,
    pub(super) rest: Vec<Batch<'a, W>>,
}

impl<'a, const W: usize> View<'a, W> {
    /// For a step that looks at no rows.
    pub(super) const NONE: Self = View {
        first: Batch { rows: &[], starts: &[] },
        rest: Vec::new(),
    };

    fn batches(&self) -> impl Iterator<Item = &Batch<'a, W>> {
        std::iter::once(&self.first).chain(&self.rest)
    }

    fn holds(&self, key: &[Value]) -> bool {
        self.batches().any(|batch| !batch.range(key).is_empty())
    }
}

/// Derived rows on their way to a relation, with repetitions. The memory they take is bounded: when there are many, they are
/// put in order and repetitions are dropped.
#[derive(Debug)]
pub(super) struct Output<const W: usize> {
    pub(super) rows: Vec<Row<W>>,
    /// Rows ever pushed.
    pub(super) pushed: u64,
    compact_at: usize,
    limit: usize,
}

/// More distinct rows were derived than the limit allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Overflow;

impl<const W: usize> Output<W> {
    /// Words of derived rows that are kept before repetitions are looked for: 128 MiB.
    const COMPACT_WORDS: usize = 1 << 25;

    /// No rows yet; at most `limit` distinct ones are accepted.
    pub(super) fn new(limit: usize) -> Self {
        Output {
            rows: Vec::new(),
            pushed: 0,
            compact_at: (Self::COMPACT_WORDS / W).min(limit.saturating_add(1)),
            limit,
        }
    }

    #[inline]
    fn push(&mut self, row: Row<W>) -> Result<(), Overflow> {
        self.rows.push(row);
        self.pushed += 1;
        if self.rows.len() >= self.compact_at {
            self.compact()
        } else {
            Ok(())
        }
    }

    #[cold]
    fn compact(&mut self) -> Result<(), Overflow> {
        normalise(&mut self.rows);
        if self.rows.len() > self.limit {
            return Err(Overflow);
        }
        self.compact_at = self.compact_at.max(self.rows.len().saturating_mul(2));
        Ok(())
    }

    /// The distinct rows, in order. The output is empty afterwards.
    pub(super) fn take(&mut self) -> Vec<Row<W>> {
        let mut rows = std::mem::take(&mut self.rows);
        normalise(&mut rows);
        rows
    }
}

/// Evaluates a plan. `views` has an element for each of its steps.
pub(super) fn run<const W: usize>(
    plan: &Plan,
    views: &[View<'_, W>],
    symbols: &Symbols,
    scratch: &mut Vec<Value>,
    out: &mut Output<W>,
) -> Result<(), Overflow> {
    scratch.clear();
    scratch.extend_from_slice(&plan.slots);
    let mut join = Join {
        plan,
        views,
        symbols,
        slots: scratch,
        patterns: None,
        out,
    };
    join.from(0).map(|_| ())
}

struct Join<'a, const W: usize> {
    plan: &'a Plan,
    views: &'a [View<'a, W>],
    symbols: &'a Symbols,
    slots: &'a mut [Value],
    /// Made when first needed.
    patterns: Option<Patterns>,
    out: &'a mut Output<W>,
}

impl<const W: usize> Join<'_, W> {
    /// Does the steps from `depth` on and says whether they succeeded at least once.
    fn from(&mut self, depth: usize) -> Result<bool, Overflow> {
        let plan = self.plan;
        let views = self.views;
        let mut depth = depth;
        loop {
            let Some(step) = plan.steps.get(depth) else {
                return self.emit();
            };
            let passed = match step {
                Step::Scan { key, bind, check, .. } => return self.scan(depth, key, bind, check),
                Step::Exists { key, .. } => views[depth].holds(&self.key(key)[..key.len()]),
                Step::Absent { key, .. } => !views[depth].holds(&self.key(key)[..key.len()]),
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
                    let value = self.compute(*functor, *base, arguments);
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
                    let rows = views[depth]
                        .batches()
                        .flat_map(|batch| batch.range(&words[..key.len()]));
                    // Of rows without columns there are only as many as can be counted.
                    let values = rows.map(|row| row.0[*column as usize]);
                    let value = op.of(*base, values, self.symbols);
                    self.fill(*to, *test, value)
                }
            };
            if !passed {
                return Ok(false);
            }
            depth += 1;
        }
    }

    fn scan(
        &mut self,
        depth: usize,
        key: &[Slot],
        bind: &[(u16, Slot)],
        check: &[(u16, Slot)],
    ) -> Result<bool, Overflow> {
        let views = self.views;
        let words = self.key(key);
        let last = depth + 1 == self.plan.steps.len();
        let once = depth >= self.plan.settled;
        let mut any = false;
        for batch in views[depth].batches() {
            for row in batch.range(&words[..key.len()]) {
                for &(column, slot) in bind {
                    self.slots[slot as usize] = row.0[column as usize];
                }
                if check
                    .iter()
                    .any(|&(column, slot)| self.slots[slot as usize] != row.0[column as usize])
                {
                    continue;
                }
                if if last { self.emit()? } else { self.from(depth + 1)? } {
                    any = true;
                    if once {
                        return Ok(true);
                    }
                }
            }
        }
        Ok(any)
    }

    /// Puts a value into a slot, or compares it with what is there.
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
    fn emit(&mut self) -> Result<bool, Overflow> {
        let row = self.key(&self.plan.output);
        self.out.push(Row(row))?;
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

/// Whether a comparison holds. Numbers compare by value; symbols are equal by word and ordered by text.
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
