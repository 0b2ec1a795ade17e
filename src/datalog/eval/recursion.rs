//! Semi-naive evaluation of a recursive stratum to its fixpoint.
//!
//! datafrog's variables do the bookkeeping, here and in [`super::maintain`]. Derived rows wait in a variable, are *new*
//! for one round, and join its *stable* batches afterwards. The joins are in [`super::join`]: datafrog's need the
//! number of joins and the row types at compile time.
// Decision: docs/decisions/evaluation.md#d014

use crate::check::{ClauseId, PredicateId};
use crate::eval::choice::Choice;
use crate::eval::dominance::Dominance;
use crate::eval::exec::{Commit, Failure, Meter, Quota, State};
use crate::eval::join::RowView;
use crate::eval::output::Output;
use crate::eval::table::{Table, project};
use crate::plan::Compiled;
use crate::plan::Plans;
use crate::plan::estimate;
use crate::plan::estimate::Shape;
use crate::plan::steps::{ClausePlans, IndexId, Plan, Source, Step, StratumPlan, Version};
use crate::row::{Batch, ByWidth, Row, difference, merge};
pub(crate) use datafrog::{Iteration, Relation, Variable};
use std::cell::Ref;
use std::collections::{BTreeSet, HashSet};

impl<const W: usize> State<W> {
    /// Returns the rows that follow from those in `outputs`, these included, and the number of rounds. `base` holds the
    /// members' existing rows; the result does not repeat them.
    pub(crate) fn grow(
        &self,
        commit: &Commit<'_, W>,
        stratum: &StratumPlan,
        base: Option<&[&Table<W>]>,
        mut outputs: Vec<Output<W>>,
        quota: Quota,
        meter: &mut Meter<'_>,
    ) -> Result<(Vec<Vec<Row<W>>>, usize), Failure> {
        let plans = &commit.plans;
        let mut recursion = Recursion::new(commit.compiled, plans, stratum, base);
        let rules = &commit.compiled.rules;
        let members = || stratum.members.iter().filter(|_| stratum.by_rounds);
        let mut choices: Vec<Option<Choice>> = members().map(|&member| Choice::of(rules, member)).collect();
        let position = |predicate: PredicateId| plans.member[predicate.index()];
        let mut dominance: Vec<Option<Dominance<W>>> = members()
            .map(|&member| Dominance::of(rules, member, position))
            .collect();
        let pairs: BTreeSet<usize> = dominance.iter().flatten().map(|dominance| dominance.pairs).collect();
        let limits: Vec<Option<usize>> = members()
            .map(|member| rules.predicates[member.index()].size_limit)
            .collect();
        let mut rounds = 0;
        loop {
            for (member, output) in outputs.iter_mut().enumerate() {
                let mut elements = meter.take(output);
                output
                    .check(elements.len())
                    .or_else(|stop| meter.fail_if(true, stratum, stop))?;
                if let Some(base) = base {
                    elements = difference(&elements, &base[member].rows);
                }
                if pairs.contains(&member) {
                    continue;
                }
                if let Some(Some(dominance)) = dominance.get(member) {
                    dominance.keep(&mut elements);
                }
                if let Some(Some(choice)) = choices.get_mut(member) {
                    elements = choice.keep(elements, commit.symbols);
                }
                recursion.insert(member, elements, output);
            }
            if !recursion.iteration.changed() {
                break;
            }
            if !pairs.is_empty() {
                let chosen = self.choose(plans, stratum, &recursion);
                let deciding = |head: PredicateId| position(head).is_some_and(|member| pairs.contains(&member));
                // Fewer rows may lead to other plans below, so every index stays.
                recursion.keep(plans, |_| true);
                let left = quota.left(0, stratum, meter)?;
                for &member in &pairs {
                    outputs[member] = Output::new(quota.rows);
                    outputs[member].set_bytes(left / 2);
                }
                let held = recursion.hold();
                for &(clause, over, plan) in chosen.iter().filter(|(_, _, plan)| deciding(plan.head)) {
                    let Some(head) = position(plan.head) else { continue };
                    let views: Vec<RowView<'_, W>> = self.delta_views(plan, &recursion, &held, plans).collect();
                    let given = held[over].new.len();
                    meter.run(clause, plan, (&views, given), commit.symbols, &mut outputs[head])?;
                }
                drop(held);
                for (member, dominance) in dominance.iter_mut().enumerate() {
                    let Some(dominance) = dominance else { continue };
                    let found = meter.take(&mut outputs[dominance.pairs]);
                    (outputs[dominance.pairs].check(found.len())).or_else(|stop| meter.fail_if(true, stratum, stop))?;
                    let gone = dominance.decide(found, commit.symbols);
                    recursion.remove(member, &gone, plans);
                }
            }
            if recursion.has_reached(&limits) {
                // The rows of this round hold; nothing follows from them.
                while recursion.iteration.changed() {}
                break;
            }
            rounds += 1;
            let mut chosen = self.choose(plans, stratum, &recursion);
            chosen.retain(|(_, _, plan)| position(plan.head).is_none_or(|member| !pairs.contains(&member)));
            let sources = || {
                chosen
                    .iter()
                    .flat_map(|(_, _, plan)| &plan.steps)
                    .flat_map(Step::sources)
            };
            if pairs.is_empty() {
                recursion.keep(plans, |index| sources().any(|source| source.index == index));
            }
            let held = recursion.hold();
            let known: usize = base.unwrap_or_default().iter().map(|table| table.rows.len()).sum();
            let total = known + recursion.left_out.iter().sum::<usize>() + held.iter().map(Held::len).sum::<usize>();
            // Rows that ceased to hold were derived, too: a recursion may replace its rows without end.
            let gone: usize = dominance.iter().flatten().map(Dominance::gone).sum();
            quota.check_rows(total + gone, stratum, meter)?;
            let keys: usize = choices.iter().flatten().map(Choice::bytes).sum();
            let copies: usize = recursion.grown.iter().map(Grown::len).sum();
            // Merging copies rows and indexes. A quarter of the memory is for the bitmaps of known rows.
            let used = 2 * (total + copies + gone) * size_of::<Row<W>>() + keys;
            let left = quota.left(used.saturating_add((quota.bytes / 4) as usize), stratum, meter)?;
            let heads: BTreeSet<PredicateId> = chosen.iter().map(|(_, _, plan)| plan.head).collect();
            outputs
                .iter_mut()
                .for_each(|output| output.set_bytes(left / heads.len().max(1) as u64));
            let mut views: Vec<RowView<'_, W>> = Vec::new();
            for &(clause, over, plan) in &chosen {
                let Some(head) = plans.member[plan.head.index()] else {
                    continue;
                };
                views.clear();
                views.extend(self.delta_views(plan, &recursion, &held, plans));
                let given = held[over].new.len();
                meter.run(clause, plan, (&views, given), commit.symbols, &mut outputs[head])?;
            }
        }
        Ok((recursion.complete(&outputs), rounds))
    }

    /// Returns what the steps of a plan over new rows read.
    fn delta_views<'a>(
        &'a self,
        plan: &'a Plan,
        recursion: &'a Recursion<'_, W>,
        held: &'a [Held<'a, W>],
        plans: &'a Plans,
    ) -> impl Iterator<Item = RowView<'a, W>> {
        plan.steps.iter().map(move |step| match step.source() {
            Some(source) if source.version != Version::Complete => recursion.view(held, plans, source),
            _ => self.complete_view(plans, step),
        })
    }

    /// Chooses the plans for a round, each with its clause and the member whose new rows it begins with.
    fn choose<'p>(
        &self,
        plans: &'p Plans,
        stratum: &StratumPlan,
        recursion: &Recursion<'_, W>,
    ) -> Vec<(ClauseId, usize, &'p Plan)> {
        let held = recursion.hold();
        let shape = |source: Source| {
            let predicate = plans.indexes[source.index].predicate;
            match plans.member[predicate.index()] {
                Some(member) if source.version != Version::Complete => recursion.shape(&held, member, source.version),
                _ => self.shape(predicate),
            }
        };
        let mut chosen = Vec::new();
        for &clause in &stratum.clauses {
            let ClausePlans {
                deltas, alternatives, ..
            } = &*plans.clauses[clause.index()];
            for ((over, plan), alternatives) in deltas.iter().zip(alternatives) {
                if let Some(over) = plans.member[over.index()].filter(|&over| !held[over].new.is_empty()) {
                    chosen.push((
                        clause,
                        over,
                        estimate::choose(plan, alternatives, &plans.indexes, &shape),
                    ));
                }
            }
        }
        chosen
    }
}

/// The state of a recursive stratum during evaluation.
struct Recursion<'a, const W: usize> {
    iteration: Iteration,
    /// Indexed by member: the existing rows.
    base: Option<&'a [&'a Table<W>]>,
    /// Indexed by member: the derived rows.
    variables: Vec<Variable<Row<W>>>,
    /// Indexed by member: whether no plan reads rows derived before this round.
    forward: Vec<bool>,
    /// Indexed by member: the number of derived rows that its variable omits, since no plan reads them and its output
    /// holds them.
    left_out: Vec<usize>,
    /// The secondary indexes of the members.
    grown: Vec<Grown<W>>,
    /// Whether outputs may have rows that do not hold.
    by_rounds: bool,
}

/// A secondary index over a growing relation.
struct Grown<const W: usize> {
    id: IndexId,
    /// The position among the members.
    member: usize,
    /// Whether this round uses it. An unused index is dropped and rebuilt on demand.
    kept: bool,
    /// Sorted batches, each at least twice as long as the next, so that a row is merged only a logarithmic number of
    /// times.
    stable: Vec<Vec<Row<W>>>,
    new: Vec<Row<W>>,
}

impl<const W: usize> Grown<W> {
    fn len(&self) -> usize {
        self.stable.iter().map(Vec::len).sum::<usize>() + self.new.len()
    }
}

/// A variable's rows, borrowed for one round.
struct Held<'a, const W: usize> {
    stable: Ref<'a, Vec<Relation<Row<W>>>>,
    new: Ref<'a, Relation<Row<W>>>,
}

impl<const W: usize> Held<'_, W> {
    fn len(&self) -> usize {
        self.stable.iter().map(|batch| batch.len()).sum::<usize>() + self.new.len()
    }
}

impl<'b, const W: usize> Recursion<'b, W> {
    fn new(compiled: &Compiled, plans: &Plans, stratum: &StratumPlan, base: Option<&'b [&'b Table<W>]>) -> Self {
        let rules = &compiled.rules;
        let members = &stratum.members;
        let mut iteration = Iteration::new();
        let name = |member: &PredicateId| &rules.predicates[member.index()].name;
        let variables = members.iter().map(|member| iteration.variable(name(member))).collect();
        let clauses = || stratum.clauses.iter().map(|clause| &plans.clauses[clause.index()]);
        let mut forward = vec![base.is_none() && !stratum.by_rounds; members.len()];
        let alternatives = clauses().flat_map(|clause| &clause.alternatives).flatten();
        let all = clauses()
            .flat_map(|clause| &clause.deltas)
            .map(|(_, plan)| plan)
            .chain(alternatives);
        for source in all.flat_map(|plan| &plan.steps).flat_map(Step::sources) {
            let predicate = plans.indexes[source.index].predicate;
            if let (Version::Old | Version::All, Some(member)) = (source.version, plans.member[predicate.index()]) {
                forward[member] = false;
            }
        }
        let mut grown: Vec<Grown<W>> = Vec::new();
        let deltas = clauses().flat_map(|clause| &clause.deltas);
        for source in deltas.flat_map(|(_, plan)| &plan.steps).flat_map(Step::sources) {
            let predicate = plans.indexes[source.index].predicate;
            let known = source.version == Version::Complete || plans.indexes.is_own(source.index);
            let known = known || grown.iter().any(|grown| grown.id == source.index);
            if let (false, Some(member)) = (known, plans.member[predicate.index()]) {
                grown.push(Grown {
                    id: source.index,
                    member,
                    kept: false,
                    stable: Vec::new(),
                    new: Vec::new(),
                });
            }
        }
        Recursion {
            iteration,
            base,
            variables,
            left_out: vec![0; members.len()],
            forward,
            grown,
            by_rounds: stratum.by_rounds,
        }
    }

    /// Removes rows of a member.
    fn remove(&mut self, member: usize, gone: &HashSet<Row<W>>, plans: &Plans) {
        if gone.is_empty() {
            return;
        }
        let variable = &self.variables[member];
        variable.recent.borrow_mut().elements.retain(|row| !gone.contains(row));
        let mut stable = variable.stable.borrow_mut();
        stable
            .iter_mut()
            .for_each(|rows| rows.elements.retain(|row| !gone.contains(row)));
        stable.retain(|rows| !rows.is_empty());
        for grown in self
            .grown
            .iter_mut()
            .filter(|grown| grown.member == member && grown.kept)
        {
            let columns = &plans.indexes[grown.id].columns;
            grown.stable = stable.iter().map(|rows| project(rows, columns)).collect();
            grown.new = project(&variable.recent.borrow(), columns);
        }
    }

    /// Returns whether a member has as many rows as its limit.
    fn has_reached(&self, limits: &[Option<usize>]) -> bool {
        let mut members = self.variables.iter().zip(limits);
        members.any(|(variable, limit)| {
            limit.is_some_and(|limit| {
                let stable: usize = variable.stable.borrow().iter().map(|rows| rows.len()).sum();
                stable + variable.recent.borrow().len() >= limit
            })
        })
    }

    /// Adds rows of a member, taken from its output, as new rows of the next round.
    fn insert(&mut self, member: usize, elements: Vec<Row<W>>, output: &mut Output<W>) {
        let variable = &self.variables[member];
        let mut stable = variable.stable.borrow_mut();
        if self.forward[member] && output.has_all() {
            // No plan reads the old rows, so omit them instead of merging and copying them in every round.
            output.keep_record();
            let mut recent = variable.recent.borrow_mut();
            self.left_out[member] += stable.iter().map(|rows| rows.len()).sum::<usize>() + recent.len();
            stable.clear();
            recent.elements = Vec::new();
        } else if self.left_out[member] > 0 {
            self.left_out[member] = 0;
            stable.push(Relation {
                elements: output.take_record(),
            });
            variable.recent.borrow_mut().elements = Vec::new();
        } else if self.forward[member] {
            // This insertion may repeat earlier rows; from the next round on the bitmap filters them.
            let recent = variable.recent.borrow();
            output.mark_taken(stable.iter().map(|rows| &rows[..]).chain([&recent[..]]));
        }
        drop(stable);
        variable.insert(Relation { elements });
    }

    /// Updates the indexes that this round uses. Call once per round.
    fn keep(&mut self, plans: &Plans, used: impl Fn(IndexId) -> bool) {
        for grown in &mut self.grown {
            let (was, is) = (grown.kept, used(grown.id));
            let mut batch = std::mem::take(&mut grown.new);
            grown.kept = is;
            if !is {
                grown.stable = Vec::new();
                continue;
            }
            let columns = &plans.indexes[grown.id].columns;
            let variable = &self.variables[grown.member];
            if self.forward[grown.member] {
                // Plans read only the new rows.
            } else if !was {
                let stable = variable.stable.borrow();
                grown.stable = stable.iter().map(|rows| project(rows, columns)).collect();
            } else if !batch.is_empty() {
                while let Some(last) = grown.stable.pop_if(|last| last.len() <= 2 * batch.len()) {
                    batch = merge(&last, &batch);
                }
                grown.stable.push(batch);
            }
            grown.new = project(&variable.recent.borrow(), columns);
        }
    }

    fn hold(&self) -> Vec<Held<'_, W>> {
        self.variables
            .iter()
            .map(|variable| Held {
                stable: variable.stable.borrow(),
                new: variable.recent.borrow(),
            })
            .collect()
    }

    /// The rows of a member that a step reads.
    fn view<'a>(&'a self, held: &'a [Held<'a, W>], plans: &Plans, source: Source) -> RowView<'a, W> {
        let spec = &plans.indexes[source.index];
        let (with_old, with_new) = (source.version != Version::New, source.version != Version::Old);
        let mut batches: Vec<Batch<'a, W>> = Vec::new();
        let Some(member) = plans.member[spec.predicate.index()] else {
            return RowView::NONE;
        };
        if let (true, Some(base)) = (with_old, self.base) {
            batches.push(base[member].batch(spec));
        }
        if let Some(grown) = self.grown.iter().find(|grown| grown.id == source.index) {
            batches.extend(grown.stable.iter().filter(|_| with_old).map(|rows| Batch::plain(rows)));
            batches.extend(with_new.then(|| Batch::plain(&grown.new)));
        } else {
            let Held { stable, new } = &held[member];
            batches.extend(stable.iter().filter(|_| with_old).map(|rows| Batch::plain(rows)));
            batches.extend(with_new.then(|| Batch::plain(new)));
        }
        match batches.pop() {
            Some(first) => RowView {
                first: ByWidth::Own(first),
                rest: batches.into_iter().map(ByWidth::Own).collect(),
            },
            None => RowView::NONE,
        }
    }

    /// The shape of the rows of a member that a step reads.
    fn shape(&self, held: &[Held<'_, W>], member: usize, version: Version) -> Shape<W> {
        let (with_old, with_new) = (version != Version::New, version != Version::Old);
        let base = self.base.filter(|_| with_old).map(|base| &base[member].rows[..]);
        let Held { stable, new } = &held[member];
        let stable = stable.iter().filter(|_| with_old).map(|rows| &rows[..]);
        let lists = base.into_iter().chain(stable).chain(with_new.then_some(&new[..]));
        lists.map(Shape::of).fold(Shape::default(), Shape::with)
    }

    /// Returns the derived rows. Call it when no rows are new. It reads them from outputs that hold them all, so that
    /// they are not in memory twice.
    fn complete(self, outputs: &[Output<W>]) -> Vec<Vec<Row<W>>> {
        drop(self.grown);
        let rows = |(variable, output): (Variable<Row<W>>, &Output<W>)| {
            if self.base.is_some() || self.by_rounds || !output.has_all() {
                return variable.complete().elements;
            }
            variable.stable.borrow_mut().clear();
            output.all()
        };
        self.variables.into_iter().zip(outputs).map(rows).collect()
    }
}
