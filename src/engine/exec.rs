//! The relational executor: keeps the rows of all relations and evaluates strata, semi-naively where they are recursive.
//!
//! The only user of datafrog, whose variables do the bookkeeping of a recursive stratum: derived rows wait in a variable, are
//! *new* for one round, and belong to its *stable* batches afterwards. The joins are our own ([`super::join`]), since
//! datafrog's want their number and the types of their rows at compile time.

use crate::engine::join::{self, Output, Overflow, View};
use crate::engine::plan::{IndexId, Plan, Plans, Source, Step, StratumPlan, Version};
use crate::engine::row::{Batch, Index, Row, difference, gallop, merge, normalise, project};
use crate::engine::{Compiled, Delta, EvalError, Rows, StratumWork, WorkLog};
use crate::lang::{ClauseId, RelId, Term, Value};
use crate::symbol::Symbols;
use datafrog::{Iteration, Relation, Variable};
use std::cell::Ref;
use std::sync::OnceLock;

/// What a session keeps between commits, whatever the width of its rows.
pub(super) trait Store: Send + Sync {
    /// Notes that a row is to be (or not to be) there from the next commit on.
    fn change(&mut self, relation: RelId, row: &[Value], present: bool);
    /// Forgets the changes noted since the last commit.
    fn rollback(&mut self);
    /// Makes the noted changes and evaluates what depends on them. On failure everything is as before.
    fn commit(&mut self, compiled: &Compiled, symbols: &Symbols, limit: usize) -> Result<(Delta, WorkLog), EvalError>;
    /// Whether the row, which has the right arity, is there.
    fn contains(&self, relation: RelId, row: &[Value]) -> bool;
    /// The row at a position below `len`, padded.
    fn row(&self, relation: RelId, position: usize) -> &[Value];
    /// How many rows the relation has.
    fn len(&self, relation: RelId) -> usize;
    /// The distinct rows that a clause derives.
    fn fired(&self, compiled: &Compiled, symbols: &Symbols, clause: ClauseId) -> Vec<Vec<Value>>;
}

/// An empty store for a program.
pub(super) fn store(compiled: &Compiled) -> Box<dyn Store> {
    match compiled.plans.width {
        2 => Box::new(State::<2>::new(compiled)),
        3 => Box::new(State::<3>::new(compiled)),
        4 => Box::new(State::<4>::new(compiled)),
        8 => Box::new(State::<8>::new(compiled)),
        16 => Box::new(State::<16>::new(compiled)),
        _ => Box::new(State::<32>::new(compiled)),
    }
}

struct State<const W: usize> {
    /// By [`RelId`]: the rows as of the last commit.
    relations: Vec<Vec<Row<W>>>,
    /// By [`IndexId`]: made when first needed, dropped when the relation changes.
    indexes: Vec<OnceLock<Index<W>>>,
    /// By [`RelId`]: the facts in the text, for relations that no clause with a body derives. They cannot be retracted.
    given: Vec<Vec<Row<W>>>,
    /// By [`RelId`]: noted changes in the order they came; of several for one row the last counts.
    noted: Vec<Vec<(Row<W>, bool)>>,
    /// Whether a commit has succeeded.
    committed: bool,
}

/// A derived relation and its rows.
type Evaluated<const W: usize> = (RelId, Vec<Row<W>>);

/// What a commit has replaced so far.
struct Undo<const W: usize> {
    /// Relations that changed, with their old rows.
    old: Vec<(RelId, Vec<Row<W>>)>,
    /// By [`RelId`].
    changed: Vec<bool>,
}

impl<const W: usize> State<W> {
    fn new(compiled: &Compiled) -> Self {
        let rules = &compiled.rules;
        let mut given = vec![Vec::new(); rules.relations.len()];
        for clause in &rules.clauses {
            if !rules.relations[clause.head.relation.index()].derived {
                given[clause.head.relation.index()].push(constants(&clause.head.terms));
            }
        }
        given.iter_mut().for_each(normalise);
        State {
            relations: vec![Vec::new(); rules.relations.len()],
            indexes: compiled.plans.indexes.iter().map(|_| OnceLock::new()).collect(),
            // They are inserted like any other fact, once.
            noted: given
                .iter()
                .map(|rows| rows.iter().map(|&row| (row, true)).collect())
                .collect(),
            given,
            committed: false,
        }
    }

    /// Replaces a relation's rows and forgets the indexes over the old ones.
    fn replace(&mut self, plans: &Plans, relation: RelId, rows: Vec<Row<W>>) -> Vec<Row<W>> {
        for index in &plans.indexes_of[relation.index()] {
            self.indexes[index.index()].take();
        }
        std::mem::replace(&mut self.relations[relation.index()], rows)
    }

    fn try_commit(
        &mut self,
        compiled: &Compiled,
        symbols: &Symbols,
        limit: usize,
        undo: &mut Undo<W>,
    ) -> Result<(Delta, WorkLog), EvalError> {
        let Compiled { rules, plans } = compiled;
        let mut delta = Delta::default();
        for relation in (0..rules.relations.len() as u32).map(RelId) {
            let noted = &mut self.noted[relation.index()];
            if noted.is_empty() {
                continue;
            }
            settle(noted);
            let old = &self.relations[relation.index()];
            let [added, removed] = net(old, noted);
            if !added.is_empty() || !removed.is_empty() {
                let rows = update(old, noted);
                self.record(compiled, relation, rows, (&added, &removed), undo, &mut delta);
            }
        }

        let mut log = WorkLog::default();
        // Rows derived by the strata so far. A limit that is passed by a sum of these is passed whatever was there before.
        let mut derived = 0;
        for stratum in &plans.strata {
            if self.committed && !stratum.inputs.iter().any(|input| undo.changed[input.index()]) {
                log.strata.push(StratumWork::Skipped);
                derived += stratum
                    .members
                    .iter()
                    .map(|&relation| self.len(relation))
                    .sum::<usize>();
                continue;
            }
            let room = limit.saturating_sub(derived);
            let (results, work) = self
                .evaluate(compiled, symbols, stratum, room)
                .map_err(|clause| EvalError::TooManyRows { limit, clause })?;
            derived += results.iter().map(|(_, rows)| rows.len()).sum::<usize>();
            log.strata.push(work);
            for (relation, rows) in results {
                let old = &self.relations[relation.index()];
                if *old != rows {
                    let (added, removed) = (difference(&rows, old), difference(old, &rows));
                    self.record(compiled, relation, rows, (&added, &removed), undo, &mut delta);
                }
            }
        }
        delta.changes.sort_by_key(|change| change.relation);
        Ok((delta, log))
    }

    /// Puts a relation's new rows in place and says how they differ from the old ones.
    fn record(
        &mut self,
        compiled: &Compiled,
        relation: RelId,
        rows: Vec<Row<W>>,
        (added, removed): (&[Row<W>], &[Row<W>]),
        undo: &mut Undo<W>,
        delta: &mut Delta,
    ) {
        let arity = compiled.rules.relations[relation.index()].arity();
        let list = |rows: &[Row<W>]| {
            let mut list = Rows::with_capacity(arity, rows.len());
            rows.iter().for_each(|row| list.push(&row.0[..arity]));
            list
        };
        delta.push(relation, list(added), list(removed));
        let old = self.replace(&compiled.plans, relation, rows);
        undo.old.push((relation, old));
        undo.changed[relation.index()] = true;
    }

    /// The rows of the stratum's derived relations, from scratch. If there are more than `room`, a clause that derives them.
    fn evaluate(
        &self,
        compiled: &Compiled,
        symbols: &Symbols,
        stratum: &StratumPlan,
        room: usize,
    ) -> Result<(Vec<Evaluated<W>>, StratumWork), ClauseId> {
        let plans = &compiled.plans;
        let members = &stratum.members;

        let mut outputs: Vec<Output<W>> = members.iter().map(|_| Output::new(room)).collect();
        let mut scratch = Vec::new();
        for &clause in &stratum.clauses {
            let plan = &plans.clauses[clause.index()];
            let Some(member) = plans.member[plan.complete.head.index()] else {
                continue;
            };
            // A clause over the stratum itself derives nothing before there is something.
            if plan.deltas.is_empty() {
                let views = self.complete_views(plans, &plan.complete);
                join::run(&plan.complete, &views, symbols, &mut scratch, &mut outputs[member])
                    .map_err(|Overflow| clause)?;
            }
        }

        if stratum
            .clauses
            .iter()
            .all(|clause| plans.clauses[clause.index()].deltas.is_empty())
        {
            let rows: Vec<_> = members
                .iter()
                .copied()
                .zip(outputs.iter_mut().map(Output::take))
                .collect();
            let total: usize = rows.iter().map(|(_, rows)| rows.len()).sum();
            if let (true, Some(&clause)) = (total > room, stratum.clauses.last()) {
                return Err(clause);
            }
            let considered = outputs.iter().map(|output| output.pushed).sum();
            return Ok((rows, StratumWork::Evaluated { rounds: 1, considered }));
        }

        let mut recursion = Recursion::new(compiled, stratum);
        let mut rounds = 0;
        loop {
            for (variable, output) in recursion.variables.iter().zip(&mut outputs) {
                variable.insert(Relation {
                    elements: output.take(),
                });
            }
            if !recursion.advance(plans) {
                break;
            }
            rounds += 1;
            let held = recursion.hold();
            let total: usize = held.iter().map(Held::len).sum();
            for &clause in &stratum.clauses {
                if total > room {
                    return Err(clause);
                }
                for (over, plan) in &plans.clauses[clause.index()].deltas {
                    let (Some(over), Some(head)) = (plans.member[over.index()], plans.member[plan.head.index()]) else {
                        continue;
                    };
                    if held[over].new.is_empty() {
                        continue;
                    }
                    let view = |step: &Step| match step.source() {
                        None => View::NONE,
                        Some(source) if source.version == Version::Complete => self.complete_view(plans, source),
                        Some(source) => recursion.view(&held, plans, source),
                    };
                    let views: Vec<View<'_, W>> = plan.steps.iter().map(view).collect();
                    join::run(plan, &views, symbols, &mut scratch, &mut outputs[head]).map_err(|Overflow| clause)?;
                }
            }
        }
        let considered = outputs.iter().map(|output| output.pushed).sum();
        let rows = recursion.complete();
        Ok((rows, StratumWork::Evaluated { rounds, considered }))
    }

    fn complete_views(&self, plans: &Plans, plan: &Plan) -> Vec<View<'_, W>> {
        let view = |step: &Step| {
            step.source()
                .map_or(View::NONE, |source| self.complete_view(plans, source))
        };
        plan.steps.iter().map(view).collect()
    }

    fn complete_view(&self, plans: &Plans, source: Source) -> View<'_, W> {
        let spec = &plans.indexes[source.index.index()];
        let own = &self.relations[spec.relation.index()];
        let index = self.indexes[source.index.index()]
            .get_or_init(|| Index::build(own, &spec.columns, plans.is_own(source.index)));
        View {
            first: index.batch(own),
            rest: Vec::new(),
        }
    }
}

impl<const W: usize> Store for State<W> {
    fn change(&mut self, relation: RelId, row: &[Value], present: bool) {
        let row = Row::new(row);
        if present || self.given[relation.index()].binary_search(&row).is_err() {
            self.noted[relation.index()].push((row, present));
        }
    }

    fn rollback(&mut self) {
        for (noted, given) in self.noted.iter_mut().zip(&self.given) {
            noted.clear();
            if !self.committed {
                noted.extend(given.iter().map(|&row| (row, true)));
            }
        }
    }

    fn commit(&mut self, compiled: &Compiled, symbols: &Symbols, limit: usize) -> Result<(Delta, WorkLog), EvalError> {
        let mut undo = Undo {
            old: Vec::new(),
            changed: vec![false; self.relations.len()],
        };
        let result = self.try_commit(compiled, symbols, limit, &mut undo);
        if result.is_ok() {
            self.noted.iter_mut().for_each(Vec::clear);
            self.committed = true;
        } else {
            for (relation, old) in undo.old {
                self.replace(&compiled.plans, relation, old);
            }
        }
        result
    }

    fn contains(&self, relation: RelId, row: &[Value]) -> bool {
        self.relations[relation.index()].binary_search(&Row::new(row)).is_ok()
    }

    fn row(&self, relation: RelId, position: usize) -> &[Value] {
        &self.relations[relation.index()][position].0
    }

    fn len(&self, relation: RelId) -> usize {
        self.relations[relation.index()].len()
    }

    fn fired(&self, compiled: &Compiled, symbols: &Symbols, clause: ClauseId) -> Vec<Vec<Value>> {
        let plan = &compiled.plans.clauses[clause.index()].complete;
        let mut out = Output::new(usize::MAX);
        if self.committed {
            let views = self.complete_views(&compiled.plans, plan);
            // What a clause derives is in its head's relation, which is within the limit: it cannot overflow.
            let _ = join::run(plan, &views, symbols, &mut Vec::new(), &mut out);
        }
        let arity = compiled.rules.relations[plan.head.index()].arity();
        out.take().iter().map(|row| row.0[..arity].to_vec()).collect()
    }
}

/// The row of a fact.
fn constants<const W: usize>(terms: &[Term]) -> Row<W> {
    let mut row = Row::ZERO;
    for (word, term) in row.0.iter_mut().zip(terms) {
        if let Term::Constant(value) = term {
            *word = *value;
        }
    }
    row
}

/// Keeps of several changes of a row the last one, in the order of rows.
fn settle<const W: usize>(noted: &mut Vec<(Row<W>, bool)>) {
    noted.sort_by_key(|(row, _)| *row);
    // `dedup_by` keeps the first of equal elements and is given the later one first.
    noted.dedup_by(|later, kept| {
        let same = later.0 == kept.0;
        if same {
            kept.1 = later.1;
        }
        same
    });
}

/// The rows that settled changes add to and remove from a relation.
fn net<const W: usize>(old: &[Row<W>], noted: &[(Row<W>, bool)]) -> [Vec<Row<W>>; 2] {
    let mut net = [Vec::new(), Vec::new()];
    let mut rest = old;
    for (row, present) in noted {
        rest = &rest[gallop(rest, |other| other < row)..];
        let was = rest.first() == Some(row);
        if was != *present {
            net[usize::from(was)].push(*row);
        }
    }
    net
}

/// The relation after settled changes.
fn update<const W: usize>(old: &[Row<W>], noted: &[(Row<W>, bool)]) -> Vec<Row<W>> {
    let mut new = Vec::with_capacity(old.len() + noted.len());
    let mut rest = old;
    for (row, present) in noted {
        let (before, after) = rest.split_at(gallop(rest, |other| other < row));
        new.extend_from_slice(before);
        rest = if after.first() == Some(row) { &after[1..] } else { after };
        if *present {
            new.push(*row);
        }
    }
    new.extend_from_slice(rest);
    new
}

/// A recursive stratum being evaluated.
struct Recursion<const W: usize> {
    iteration: Iteration,
    members: Vec<RelId>,
    /// By position in `members`.
    variables: Vec<Variable<Row<W>>>,
    /// The members' rows in other orders of columns.
    grown: Vec<Grown<W>>,
}

/// An index over a relation that grows.
struct Grown<const W: usize> {
    id: IndexId,
    /// Position in [`Recursion::members`].
    member: usize,
    /// Each at least twice as long as the next, so that a row is merged only a logarithmic number of times.
    stable: Vec<Vec<Row<W>>>,
    new: Vec<Row<W>>,
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

impl<const W: usize> Recursion<W> {
    fn new(compiled: &Compiled, stratum: &StratumPlan) -> Self {
        let Compiled { rules, plans } = compiled;
        let members = &stratum.members;
        let mut iteration = Iteration::new();
        let name = |member: &RelId| &rules.relations[member.index()].name;
        let variables = members.iter().map(|member| iteration.variable(name(member))).collect();
        let mut grown: Vec<Grown<W>> = Vec::new();
        let deltas = stratum
            .clauses
            .iter()
            .flat_map(|clause| &plans.clauses[clause.index()].deltas);
        for source in deltas.flat_map(|(_, plan)| &plan.steps).filter_map(Step::source) {
            let relation = plans.indexes[source.index.index()].relation;
            let known = source.version == Version::Complete || plans.is_own(source.index);
            let known = known || grown.iter().any(|grown| grown.id == source.index);
            if let (false, Some(member)) = (known, plans.member[relation.index()]) {
                grown.push(Grown {
                    id: source.index,
                    member,
                    stable: Vec::new(),
                    new: Vec::new(),
                });
            }
        }
        Recursion {
            iteration,
            members: members.clone(),
            variables,
            grown,
        }
    }

    /// Begins the next round; false if nothing is new.
    fn advance(&mut self, plans: &Plans) -> bool {
        let changed = self.iteration.changed();
        for grown in &mut self.grown {
            let mut batch = std::mem::take(&mut grown.new);
            if !batch.is_empty() {
                while let Some(last) = grown.stable.pop_if(|last| last.len() <= 2 * batch.len()) {
                    batch = merge(&last, &batch);
                }
                grown.stable.push(batch);
            }
            grown.new = project(
                &self.variables[grown.member].recent.borrow(),
                &plans.indexes[grown.id.index()].columns,
            );
        }
        changed
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

    /// The rows of a member that a step looks at.
    fn view<'a>(&'a self, held: &'a [Held<'a, W>], plans: &Plans, source: Source) -> View<'a, W> {
        let mut batches: Vec<Batch<'a, W>> = Vec::new();
        let (with_old, with_new) = (source.version != Version::New, source.version != Version::Old);
        if let Some(grown) = self.grown.iter().find(|grown| grown.id == source.index) {
            batches.extend(grown.stable.iter().filter(|_| with_old).map(|rows| Batch::plain(rows)));
            batches.extend(with_new.then(|| Batch::plain(&grown.new)));
        } else {
            let relation = plans.indexes[source.index.index()].relation;
            if let Some(member) = plans.member[relation.index()] {
                let Held { stable, new } = &held[member];
                batches.extend(stable.iter().filter(|_| with_old).map(|rows| Batch::plain(rows)));
                batches.extend(with_new.then(|| Batch::plain(new)));
            }
        }
        match batches.pop() {
            Some(first) => View { first, rest: batches },
            None => View::NONE,
        }
    }

    /// The finished relations. Only after [`Recursion::advance`] has said that nothing is new.
    fn complete(self) -> Vec<Evaluated<W>> {
        let rows = self.variables.into_iter().map(|variable| variable.complete().elements);
        self.members.into_iter().zip(rows).collect()
    }
}
