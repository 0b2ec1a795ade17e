//! Evaluates one plan on several threads.
//!
//! The rows of a plan's first scan are split into chunks. Each thread evaluates some chunks into its own output, and
//! the outputs are merged. The assignment of chunks to threads affects neither the rows nor the number of rows scanned,
//! so answers and statistics equal those of one thread. Small work stays on the calling thread.
// Decision: docs/decisions/evaluation.md#d019

use crate::cancel::Cancel;
use crate::eval::join;
use crate::eval::join::{JoinState, RowView};
use crate::eval::output::{Abort, Output};
use crate::plan::estimate::Shape;
use crate::plan::steps::{Plan, Slot, Step};
use crate::row::{AnyBatch, AnyRows, Batch, Row, each_width, gallop, map_width, normalize};
use crate::symbol::Symbols;
use crate::threads::Pool;
use rayon::slice::ParallelSliceMut;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

/// The number of threads and the work from which on they are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threads {
    /// The number of threads. With one, the calling thread does all work.
    pub count: NonZeroUsize,
    /// Plans that are expected to scan fewer rows than this stay on the calling thread; so does sorting of shorter
    /// lists.
    pub split_from: usize,
}

impl Threads {
    /// Uses `count` threads for work that takes clearly longer than waking a thread.
    pub fn new(count: NonZeroUsize) -> Self {
        Threads {
            count,
            split_from: 1 << 15,
        }
    }

    /// Uses one thread for each core available to this process.
    pub fn all() -> Self {
        Threads::new(std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN))
    }
}

impl Default for Threads {
    /// Uses one thread.
    fn default() -> Self {
        Threads::new(NonZeroUsize::MIN)
    }
}

/// The threads of a session.
#[derive(Debug, Default)]
pub(crate) struct Workers {
    /// Present if there is more than one thread.
    pool: Option<Pool>,
    threads: Threads,
}

/// The output and state of one thread.
struct Worker<const W: usize> {
    out: Output<W>,
    state: JoinState,
    result: Result<(), Abort>,
}

impl Workers {
    /// Cancellation polling interval of the calling thread while others evaluate.
    const POLL_INTERVAL: Duration = Duration::from_millis(10);

    /// Chunks per thread. Several chunks balance the load.
    const CHUNKS: usize = 16;

    /// Starts the threads. Fails if the system cannot start them.
    pub(crate) fn new(threads: Threads) -> std::io::Result<Self> {
        let count = threads.count.get();
        let pool = (count > 1).then(|| Pool::new(count)).transpose()?;
        let count = pool.as_ref().map_or(1, Pool::count);
        Ok(Workers {
            pool,
            threads: Threads {
                count: NonZeroUsize::new(count).unwrap_or(NonZeroUsize::MIN),
                ..threads
            },
        })
    }

    /// Whether there is more than one thread.
    pub(crate) fn are_several(&self) -> bool {
        self.pool.is_some()
    }

    /// Like [`join::run`], on all threads; on the calling thread if a forked process cannot start them. If it fails, the
    /// caller must not use `out`.
    pub(crate) fn run<const W: usize>(
        &self,
        plan: &Plan,
        views: &[RowView<'_, W>],
        (symbols, cancel): (&Symbols, &Cancel),
        state: &mut JoinState,
        out: &mut Output<W>,
    ) -> Result<(), Abort> {
        if let Some(pool) = &self.pool {
            let chunks = self.split(plan, views, out.seen_bytes());
            if !chunks.is_empty()
                && out.can_fork(self.threads.count.get())
                && let Ok(pool) = pool.threads()
            {
                let workers = self.evaluate(&pool, (plan, views, &chunks), (symbols, cancel), state, out);
                if let Some(result) = merge(workers, symbols, state, out) {
                    return result;
                }
            }
        }
        join::run(plan, views, (symbols, cancel), state, out)
    }

    /// Sorts rows and removes repetitions.
    pub(crate) fn normalize<const W: usize>(&self, rows: &mut Vec<Row<W>>) {
        let large = rows.len() >= self.threads.split_from;
        match self.pool.as_ref().filter(|_| large).map(Pool::threads) {
            Some(Ok(pool)) => {
                pool.install(|| rows.par_sort_unstable());
                rows.dedup();
            }
            _ => normalize(rows),
        }
    }

    /// Splits the rows of the first scan into chunks; returns none if one thread is better. `copied` is the number of
    /// bytes copied to give each thread an output.
    fn split<'a, const W: usize>(&self, plan: &Plan, views: &[RowView<'a, W>], copied: usize) -> Vec<AnyRows<'a, W>> {
        let Some(Step::Scan {
            key,
            bind,
            check,
            distinct,
            ..
        }) = plan.steps.first()
        else {
            return Vec::new();
        };
        // A scan that only counts its rows visits none of them.
        if plan.steps.len() == 1 && check.is_empty() && *distinct == 0 && join::counts(plan, bind) {
            return Vec::new();
        }
        // If one success is enough, the scan stops early.
        let one_is_enough = plan.enough.first().is_some_and(|&end| end != 0);
        if one_is_enough || expected(plan, views) < (self.threads.split_from.max(copied / 8)) as f64 {
            return Vec::new();
        }
        let words: Vec<_> = key.iter().map(|&slot| plan.slots[slot as usize]).collect();
        let ranges = || views[0].batches().map(|batch| batch.range(&words));
        let count: usize = ranges().map(|rows| rows.len()).sum();
        let size = count.div_ceil(self.threads.count.get() * Self::CHUNKS).max(1);
        let mut chunks = Vec::new();
        for mut rest in ranges() {
            while rest.len() > 0 {
                let mut end = size.min(rest.len());
                // The scan visits one of the rows that agree in the first columns, so they stay together.
                if let Some(columns @ 1..) = Some(*distinct as usize) {
                    end += each_width!(rest, rows => {
                        let last = &rows[end - 1];
                        gallop(&rows[end..], |row| row.0[..columns] == last.0[..columns])
                    });
                }
                let (chunk, others) = rest.split_at(end);
                chunks.push(chunk);
                rest = others;
            }
        }
        if chunks.len() < 2 { Vec::new() } else { chunks }
    }

    fn evaluate<const W: usize>(
        &self,
        pool: &rayon::ThreadPool,
        (plan, views, chunks): (&Plan, &[RowView<'_, W>], &[AnyRows<'_, W>]),
        (symbols, cancel): (&Symbols, &Cancel),
        state: &JoinState,
        out: &Output<W>,
    ) -> Vec<Worker<W>> {
        let count = self.threads.count.get();
        // A plan with user-defined functors makes symbols, so one thread runs it.
        let worker = || Worker {
            out: out.fork(count),
            state: JoinState::new(state.budget.saturating_sub(state.rows_scanned)),
            result: Ok(()),
        };
        let mut workers: Vec<Worker<W>> = (0..count).map(|_| worker()).collect();
        let (next, stopped) = (&AtomicUsize::new(0), &AtomicBool::new(false));
        // The callback of `cancel` runs on the calling thread only; the others poll a flag.
        let cancelled = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&cancelled);
        let flagged = &Cancel::when(move || flag.load(Relaxed));
        let (working, done) = mpsc::channel::<()>();
        pool.in_place_scope(|scope| {
            for worker in &mut workers {
                let working = working.clone();
                scope.spawn(move |_| {
                    let mut views = views.to_vec();
                    while let (Some(chunk), false) = (chunks.get(next.fetch_add(1, Relaxed)), stopped.load(Relaxed)) {
                        views[0] = RowView::of(map_width!(*chunk, rows => Batch::plain(rows)));
                        let (symbols, out) = ((symbols, flagged), &mut worker.out);
                        worker.result = join::run(plan, &views, symbols, &mut worker.state, out);
                        if worker.result.is_err() {
                            stopped.store(true, Relaxed);
                        }
                    }
                    worker.out.settle();
                    drop(working);
                });
            }
            drop(working);
            // The channel carries no message; it closes when all threads are done.
            while !cancel.is_never() && done.recv_timeout(Self::POLL_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                if cancel.requested() {
                    cancelled.store(true, Relaxed);
                    break;
                }
            }
        });
        if cancelled.load(Relaxed) {
            // Even if all threads were done before they polled the flag.
            workers[0].result = Err(Abort::Cancelled);
        }
        workers
    }
}

/// Merges the results of the threads. `None` if a thread exceeded its share of the rows or of the memory: several
/// threads may have derived the same rows.
fn merge<const W: usize>(
    workers: Vec<Worker<W>>,
    symbols: &Symbols,
    state: &mut JoinState,
    out: &mut Output<W>,
) -> Option<Result<(), Abort>> {
    let stopped = |with: Abort| workers.iter().any(|worker| worker.result == Err(with));
    if stopped(Abort::Cancelled) {
        return Some(Err(Abort::Cancelled));
    }
    if stopped(Abort::Overflow) || stopped(Abort::Memory) {
        return None;
    }
    state.rows_scanned += workers.iter().map(|worker| worker.state.rows_scanned).sum::<u64>();
    if stopped(Abort::Budget) || state.rows_scanned > state.budget {
        return Some(Err(Abort::Budget));
    }
    Some(
        workers
            .into_iter()
            .try_for_each(|worker| out.absorb(worker.out, symbols)),
    )
}

/// Estimates the number of rows that the plan scans.
fn expected<const W: usize>(plan: &Plan, views: &[RowView<'_, W>]) -> f64 {
    let (mut flow, mut rows_scanned) = (1.0, 0.0);
    let in_batch = |batch: &AnyBatch<'_, W>, key: &[Slot]| {
        let columns: Vec<u16> = (0..key.len() as u16).collect();
        each_width!(batch, batch => Shape::<W>::of(batch.rows).found(&columns))
    };
    for (step, view) in plan.steps.iter().zip(views) {
        match step {
            Step::Scan { key, .. } | Step::Aggregate { key, .. } => {
                let found: f64 = view.batches().map(|batch| in_batch(batch, key)).sum();
                rows_scanned += flow * found;
                if let Step::Scan { .. } = step {
                    flow *= found;
                }
            }
            Step::LeapfrogJoin { lists, .. } => {
                let found = lists.iter().zip(view.batches());
                let least = found
                    .map(|(list, batch)| in_batch(batch, &list.key))
                    .fold(f64::INFINITY, f64::min);
                rows_scanned += flow * least * lists.len() as f64;
                flow *= least;
            }
            _ => {}
        }
    }
    rows_scanned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::PredicateId;
    use crate::diag::Sources;
    use crate::eval::table::Table;
    use crate::files::ReadError;
    use crate::plan::steps::Source;
    use crate::program::Program;
    use crate::row::ByWidth;
    use crate::value::Value;

    /// Rows, number of rows derived, number of rows scanned.
    type Done = (Vec<Row<2>>, u64, u64);

    #[test]
    fn chunks_do_what_the_whole_does() {
        let text = ".decl A(x: number, y: number)
            .decl B(x: number, y: number)
            B(x, z) :- A(x, y), A(y, z), x != z.
            B(x, x) :- A(x, _), A(_, x).
            B(x, y) :- A(x, y).
            B(1, 2) :- A(_, _).";
        let mut sources = Sources::new();
        let entry = sources.add("test.dl", text);
        let none = |_: &std::path::Path| Err(ReadError::TooLarge(0));
        let program = Program::load(&mut sources, entry, &none).0.expect("it is right");
        let plans = &program.0.plans;
        let symbols = Symbols::new();
        // Dense words, and words too sparse for a bitmap.
        for step in [1, 5_000_011] {
            let mut rows: Vec<Row<2>> = (0..3_000_u32)
                .map(|n| Row([n * n % 397, n * 7 % 401].map(|word| Value(word * step))))
                .collect();
            normalize(&mut rows);
            let tables = [
                Table::new(rows, plans.indexes.of(PredicateId(0)).count()),
                Table::new(Vec::new(), plans.indexes.of(PredicateId(1)).count()),
            ];
            for (clause, splits) in [(0, true), (1, true), (2, true), (3, false)] {
                let plan = &plans.clauses[clause].complete;
                let batch = |source: Source| {
                    let spec = &plans.indexes[source.index];
                    assert_eq!(spec.predicate, PredicateId(0));
                    ByWidth::Own(tables[0].batch(spec))
                };
                let view = |step: &Step| RowView::for_step(step, batch);
                let views: Vec<RowView<'_, 2>> = plan.steps.iter().map(view).collect();
                let run = |workers: &Workers, budget: u64, limit: usize| -> Result<Done, Abort> {
                    let (mut state, mut out) = (JoinState::new(budget), Output::new(limit));
                    // In the second run most rows are known.
                    workers.run(plan, &views, (&symbols, &Cancel::never()), &mut state, &mut out)?;
                    workers.run(plan, &views, (&symbols, &Cancel::never()), &mut state, &mut out)?;
                    let pushed = out.pushed;
                    Ok((out.take_by(|rows| workers.normalize(rows)), pushed, state.rows_scanned))
                };
                let alone = Workers::default();
                let expected = run(&alone, u64::MAX, usize::MAX).unwrap();
                for count in [2, 3, 7] {
                    let workers = Workers::new(Threads {
                        count: NonZeroUsize::new(count).unwrap(),
                        split_from: 0,
                    })
                    .unwrap();
                    assert_eq!(workers.split(plan, &views, 0).len() > count, splits);
                    assert_eq!(run(&workers, u64::MAX, usize::MAX).as_ref(), Ok(&expected));
                    let (rows, _, rows_scanned) = &expected;
                    assert_eq!(run(&workers, *rows_scanned, rows.len()).as_ref(), Ok(&expected));
                    assert_eq!(run(&workers, rows_scanned - 1, usize::MAX), Err(Abort::Budget));
                    assert_eq!(run(&alone, rows_scanned - 1, usize::MAX), Err(Abort::Budget));
                }
            }
        }
    }
}
