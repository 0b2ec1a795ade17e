//! The resources of a stratum in evaluation, and the count of its work.

use crate::cancel::Cancel;
use crate::check::ClauseId;
use crate::eval::exec::CommitOptions;
use crate::eval::join;
use crate::eval::join::{JoinState, RowView};
use crate::eval::output::{Abort, Output};
use crate::eval::stats::{EvalEvent, RuleStats, WorkCounts};
use crate::eval::workers::Workers;
use crate::plan::steps::{Plan, StratumPlan};
use crate::row::Row;
use crate::symbol::Symbols;

/// The clause whose evaluation was abandoned, and the reason.
pub(crate) type Failure = (ClauseId, Abort);

/// Runs plans and counts their work.
pub(crate) struct Meter<'a> {
    pub(super) state: JoinState,
    rules: Vec<RuleStats>,
    /// `None` to use the calling thread alone.
    workers: Option<&'a Workers>,
    watch: Option<&'a dyn Fn(EvalEvent)>,
    cancel: &'a Cancel,
}

impl<'a> Meter<'a> {
    /// A meter that allows `budget` rows to be scanned, and symbols to grow to `symbol_bytes`.
    pub(super) fn new(
        budget: u64,
        symbol_bytes: u64,
        options: CommitOptions<'a>,
        workers: Option<&'a Workers>,
    ) -> Self {
        let mut state = JoinState::new(budget);
        state.symbol_bytes = symbol_bytes;
        state.calls = options.calls.cloned();
        Meter {
            state,
            rules: Vec::new(),
            workers,
            watch: options.watch,
            cancel: options.cancel,
        }
    }

    /// Takes the distinct rows of an output, in order; see [`Output::take`].
    pub(crate) fn take<const W: usize>(&self, out: &mut Output<W>) -> Vec<Row<W>> {
        match self.workers {
            Some(workers) => out.take_by(|rows| workers.normalize(rows)),
            None => out.take(),
        }
    }

    /// Evaluates a plan of a clause. `delta_rows` is the number of changed rows that it begins with.
    pub(crate) fn run<const W: usize>(
        &mut self,
        clause: ClauseId,
        plan: &Plan,
        (views, delta_rows): (&[RowView<'_, W>], usize),
        symbols: &Symbols,
        out: &mut Output<W>,
    ) -> Result<(), Failure> {
        let before = (self.state.rows_scanned, out.pushed);
        let notify = |event| self.watch.iter().for_each(|watch| watch(event));
        notify(EvalEvent::Begin(clause));
        let result = match self.workers {
            Some(workers) => workers.run(plan, views, (symbols, self.cancel), &mut self.state, out),
            None => join::run(plan, views, (symbols, self.cancel), &mut self.state, out),
        };
        notify(EvalEvent::End(clause));
        let position = self.rules.binary_search_by_key(&clause, |rule| rule.clause);
        let position = position.unwrap_or_else(|position| {
            let rule = RuleStats {
                clause,
                delta_rows: 0,
                rows_scanned: 0,
                derived: 0,
            };
            self.rules.insert(position, rule);
            position
        });
        let rule = &mut self.rules[position];
        rule.delta_rows += delta_rows as u64;
        rule.rows_scanned += self.state.rows_scanned - before.0;
        rule.derived += out.pushed - before.1;
        result.map_err(|abort| (clause, abort))
    }

    /// Returns an error if `failed`. It names the clause of the stratum that has derived the most rows, repetitions
    /// included.
    pub(crate) fn fail_if(&self, failed: bool, stratum: &StratumPlan, abort: Abort) -> Result<(), Failure> {
        let derived = |clause: &ClauseId| {
            let position = self.rules.binary_search_by_key(clause, |rule| rule.clause);
            position.map_or(0, |position| self.rules[position].derived)
        };
        let clauses = stratum.clauses.iter().copied().filter(|_| failed);
        let largest = clauses.max_by_key(|clause| (derived(clause), std::cmp::Reverse(*clause)));
        largest.map_or(Ok(()), |clause| Err((clause, abort)))
    }

    /// Returns the work done in `rounds` rounds.
    pub(crate) fn finish(self, rounds: usize) -> WorkCounts {
        WorkCounts {
            rounds,
            rules: self.rules,
            given_up: 0,
        }
    }
}

/// The resources that the limits leave for a stratum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quota {
    /// Maximum rows of its members.
    pub(crate) rows: usize,
    /// Maximum rows scanned.
    pub(super) steps: u64,
    /// Maximum bytes of all that its evaluation adds: rows, indexes, buffers and symbols.
    pub(crate) bytes: u64,
    /// Whether so much memory is in use that indexes count.
    pub(super) tight: bool,
}

impl Quota {
    /// Fails if the members of the stratum together have too many rows.
    pub(crate) fn check_rows(&self, total: usize, stratum: &StratumPlan, meter: &Meter<'_>) -> Result<(), Failure> {
        meter.fail_if(total > self.rows, stratum, Abort::Overflow)
    }

    /// Returns the bytes left, or fails if there are none.
    pub(crate) fn left(&self, used: usize, stratum: &StratumPlan, meter: &Meter<'_>) -> Result<u64, Failure> {
        meter.fail_if(used as u64 > self.bytes, stratum, Abort::Memory)?;
        Ok(self.bytes - used as u64)
    }
}
