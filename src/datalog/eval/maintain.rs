//! Updates a stratum incrementally: delete and rederive (DRed).
//!
//! For each clause and each changed atom of its body:
//!
//! 1. *Lose*: overestimate the lost heads. These are the heads that the clause derived from a removed row (of a negated
//!    atom: an added row), with all else as before. In a recursive stratum, heads derived from lost heads may be lost
//!    too.
//! 2. *Keep*: keep the lost heads that some clause still derives.
//! 3. *Gain*: add the new heads that the clause derives from an added row (of a negated atom: a removed row), with
//!    all else as it is now. In a recursive stratum, also add what follows from the kept and gained heads.
//!
//! The algorithm counts no derivations, so it stores nothing between commits besides the predicates. A clause can stop
//! at the first derivation of a head, and one commit can recompute a stratum that the next maintains.
// Decision: docs/decisions/facts.md#d025

use crate::check::PredicateId;
use crate::eval::exec::{Commit, Failure, Meter, Quota, State, specs};
use crate::eval::join::RowView;
use crate::eval::output::{Abort, Output};
use crate::eval::recursion::{Iteration, Relation, Variable};
use crate::eval::table::{Table, TableDelta};
use crate::plan::steps::{ChangePlan, IndexSpec, Plan, Source, Step, StratumPlan, Version};
use crate::row::{AnyBatch, Batch, ByWidth, Row, difference, merge};
use std::sync::Arc;

/// Rows, by member of a stratum.
type ByMember<const W: usize> = Vec<Vec<Row<W>>>;

impl<const W: usize> State<W> {
    /// Returns the changes of the stratum's members and the number of rounds. The inputs' tables are new, the members'
    /// tables old. Fails if a member may lose more rows than `lost_max`.
    pub(crate) fn maintain(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        lost_max: usize,
        quota: Quota,
        meter: &mut Meter<'_>,
    ) -> Result<(Vec<TableDelta<W>>, usize), Failure> {
        let plans = &commit.plans;
        let members = &stratum.members;
        let (lost, mut rounds) = self.lose(commit, stratum, lost_max, meter)?;

        // In a recursive stratum, a row that may be lost must not support others.
        let without = |(predicate, lost): (&PredicateId, &Vec<Row<W>>)| {
            let delta = TableDelta {
                added: Arc::default(),
                removed: lost.clone(),
            };
            let needed = stratum.recursive && !lost.is_empty();
            needed.then(|| self.tables[predicate.index()].patched(&specs(plans, *predicate), &delta))
        };
        let shrunk: Vec<Option<Table<W>>> = members.iter().zip(&lost).map(without).collect();
        let tables = members.iter().map(|predicate| &self.tables[predicate.index()]);
        let base: Vec<&Table<W>> = shrunk
            .iter()
            .zip(tables)
            .map(|(shrunk, table)| shrunk.as_ref().unwrap_or(table))
            .collect();

        let gone = self.keep(commit, stratum, &base, &lost, meter)?;
        let gained = self.gain(commit, stratum, &base, quota, meter)?;
        let deltas: Vec<TableDelta<W>> = if stratum.recursive {
            let again = lost.iter().zip(&gone).map(|(lost, gone)| difference(lost, gone));
            let seeds = again.zip(gained).map(|(again, gained)| merge(&again, &gained));
            let seeds = seeds.map(|rows| Output::of(rows, quota.rows)).collect();
            let (grown, more) = self.grow(commit, stratum, Some(&base), seeds, quota, meter)?;
            rounds += more;
            let delta = |(lost, grown): (&Vec<Row<W>>, &Vec<Row<W>>)| TableDelta {
                added: difference(grown, lost).into(),
                removed: difference(lost, grown),
            };
            lost.iter().zip(&grown).map(delta).collect()
        } else {
            let deltas = gained.into_iter().zip(gone);
            deltas
                .map(|(added, removed)| TableDelta {
                    added: added.into(),
                    removed,
                })
                .collect()
        };

        let after = |(predicate, delta): (&PredicateId, &TableDelta<W>)| {
            self.tables[predicate.index()].rows.len() + delta.added.len() - delta.removed.len()
        };
        let total: usize = members.iter().zip(&deltas).map(after).sum();
        quota.check_rows(total, stratum, meter)?;
        Ok((deltas, rounds.max(1)))
    }

    /// Returns the rows that may be lost and the number of rounds.
    fn lose(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        lost_max: usize,
        meter: &mut Meter<'_>,
    ) -> Result<(ByMember<W>, usize), Failure> {
        let plans = &commit.plans;
        let before = |spec: &IndexSpec| match &commit.changed[spec.predicate.index()] {
            Some((_, table)) => ByWidth::Own(table.batch(spec)),
            None => self.batch(spec),
        };
        let mut outputs: Vec<Output<W>> = stratum.members.iter().map(|_| Output::new(lost_max)).collect();
        derive_from_inputs(commit, stratum, ChangeSide::Lost, None, &before, meter, &mut outputs)?;
        if !stratum.recursive || outputs.iter().all(Output::is_empty) {
            return Ok((outputs.iter_mut().map(Output::take).collect(), 0));
        }

        let mut iteration = Iteration::new();
        let members = stratum.members.iter();
        let variables: Vec<Variable<Row<W>>> = members.map(|_| iteration.variable("lost")).collect();
        let mut rounds = 0;
        loop {
            for (variable, output) in variables.iter().zip(&mut outputs) {
                variable.insert(Relation {
                    elements: output.take(),
                });
            }
            if !iteration.changed() {
                break;
            }
            for variable in &variables {
                let stable: usize = variable.stable.borrow().iter().map(|rows| rows.len()).sum();
                let lost = stable + variable.recent.borrow().len();
                meter.fail_if(lost > lost_max, stratum, Abort::Budget)?;
            }
            rounds += 1;
            for &clause in &stratum.clauses {
                let recursive = |change: &&ChangePlan| stratum.members.contains(&change.over);
                for change in plans.clauses[clause.index()].changes.iter().filter(recursive) {
                    let member = (
                        plans.member[change.over.index()],
                        plans.member[change.plan.head.index()],
                    );
                    let (Some(over), Some(head)) = member else { continue };
                    let rows = variables[over].recent.borrow();
                    if !rows.is_empty() {
                        let views: Vec<_> = views(commit, &change.plan, &rows, None, &before).collect();
                        meter.run(
                            clause,
                            &change.plan,
                            (&views, rows.len()),
                            commit.symbols,
                            &mut outputs[head],
                        )?;
                    }
                }
            }
        }
        let lost = variables.into_iter().map(|variable| variable.complete().elements);
        Ok((lost.collect(), rounds))
    }

    /// Returns the rows of `lost` that no clause derives from `base` and the inputs.
    fn keep(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        base: &[&Table<W>],
        lost: &ByMember<W>,
        meter: &mut Meter<'_>,
    ) -> Result<ByMember<W>, Failure> {
        let plans = &commit.plans;
        let now = |spec: &IndexSpec| self.now(stratum, base, spec);
        let mut gone = lost.clone();
        for &clause in &stratum.clauses {
            let plans = &plans.clauses[clause.index()];
            let Some(member) = commit.plans.member[plans.complete.head.index()] else {
                continue;
            };
            if let (Some(plan), false) = (&plans.check, gone[member].is_empty()) {
                let mut out = Output::new(usize::MAX);
                let doubtful = std::mem::take(&mut gone[member]);
                let views: Vec<_> = views(commit, plan, &doubtful, None, &now).collect();
                meter.run(clause, plan, (&views, doubtful.len()), commit.symbols, &mut out)?;
                gone[member] = difference(&doubtful, &out.take());
            }
        }
        Ok(gone)
    }

    /// Returns the rows that clauses derive from added rows of the inputs and that are not in `base`.
    fn gain(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        base: &[&Table<W>],
        quota: Quota,
        meter: &mut Meter<'_>,
    ) -> Result<ByMember<W>, Failure> {
        let now = |spec: &IndexSpec| self.now(stratum, base, spec);
        let mut outputs: Vec<Output<W>> = stratum.members.iter().map(|_| Output::new(quota.rows)).collect();
        let share = quota.bytes / 2 / outputs.len().max(1) as u64;
        outputs.iter_mut().for_each(|output| output.set_bytes(share));
        derive_from_inputs(
            commit,
            stratum,
            ChangeSide::Gained,
            Some(base),
            &now,
            meter,
            &mut outputs,
        )?;
        Ok(outputs.iter_mut().map(Output::take).collect())
    }

    /// The current rows of a predicate in the order of an index; for a member, those in `base`.
    fn now<'a>(&'a self, stratum: &StratumPlan, base: &[&'a Table<W>], spec: &IndexSpec) -> AnyBatch<'a, W> {
        let member = stratum.members.iter().position(|&member| member == spec.predicate);
        member.map_or_else(|| self.batch(spec), |member| ByWidth::Own(base[member].batch(spec)))
    }
}

/// The side of a change on which heads depend.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ChangeSide {
    /// Removed rows; of a negated atom, added ones.
    Lost,
    /// Added rows; of a negated atom, removed ones.
    Gained,
}

/// Adds to `outputs` the heads that the clauses derive from the changed rows of the inputs on one side, without those in
/// `base`. The other atoms read what `complete` returns.
fn derive_from_inputs<'b, const W: usize>(
    commit: &Commit<'_, W>,
    stratum: &StratumPlan,
    side: ChangeSide,
    base: Option<&[&Table<W>]>,
    complete: &impl Fn(&IndexSpec) -> AnyBatch<'b, W>,
    meter: &mut Meter<'_>,
    outputs: &mut [Output<W>],
) -> Result<(), Failure> {
    let plans = &commit.plans;
    let mut steps: Vec<RowView<'_, W>> = Vec::new();
    for &clause in &stratum.clauses {
        for change in &plans.clauses[clause.index()].changes {
            let Some(delta) = commit.delta(change.over) else {
                continue;
            };
            let rows = match (side == ChangeSide::Lost) != change.negated {
                true => &delta.removed,
                false => &delta.added,
            };
            if let (false, Some(head)) = (rows.is_empty(), plans.member[change.plan.head.index()]) {
                steps.clear();
                let known = base.map(|base| base[head]);
                steps.extend(views(commit, &change.plan, rows, known, complete));
                let views = (steps.as_slice(), rows.len());
                meter.run(clause, &change.plan, views, commit.symbols, &mut outputs[head])?;
            }
        }
    }
    Ok(())
}

/// Returns the view of each step of a plan. The first step reads `rows`, the test for known heads reads `known`, and
/// the others read what `complete` returns.
fn views<'a, 'b: 'a, const W: usize>(
    commit: &'a Commit<'_, W>,
    plan: &'a Plan,
    rows: &'a [Row<W>],
    known: Option<&'a Table<W>>,
    complete: &'a impl Fn(&IndexSpec) -> AnyBatch<'b, W>,
) -> impl Iterator<Item = RowView<'a, W>> {
    let indexes = &commit.plans.indexes;
    let view = move |(position, step): (usize, &Step)| {
        let batch = |source: Source| {
            let spec = &indexes[source.index];
            match known {
                _ if source.version == Version::New => ByWidth::Own(Batch::plain(rows)),
                None if plan.fresh == Some(position) => ByWidth::Own(Batch::plain(&[])),
                Some(known) if plan.fresh == Some(position) => ByWidth::Own(known.batch(spec)),
                _ => complete(spec),
            }
        };
        RowView::for_step(step, batch)
    };
    plan.steps.iter().enumerate().map(view)
}
