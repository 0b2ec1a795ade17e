//! Executes a [`Dense`] program.

use crate::check::{ClauseId, PredicateId};
use crate::dense::program::{Any, DemandOp, Dense, Op, Rare, Reg};
use crate::dense::search::{BinaryFacts, search};
use crate::dense::sets::{Set, and, first, has, is_empty, members, or, without};
use crate::dense::tree::{Tables, TooManySteps, TreeSearch};

/// Programs with at most this number of sets run faster.
const FEW: usize = 256;

/// The numbers of sets of one word for which a run has its own code, so that the state of a small program is small.
const FEWER: [usize; 2] = [64, 128];

/// Returns the number of sets to allocate for a program with this many.
fn allocated<const W: usize>(set_count: usize) -> usize {
    let fewer = FEWER.into_iter().find(|&fewer| W == 1 && set_count <= fewer);
    fewer.unwrap_or(set_count.max(FEW))
}

/// The sets of a [`BitState`] during a run.
trait Sets<const W: usize>: AsRef<[Set<W>]> {
    fn get(&self, set: Reg) -> &Set<W>;
    fn get_mut(&mut self, set: Reg) -> &mut Set<W>;
}

impl<const W: usize> Sets<W> for [Set<W>] {
    #[inline(always)]
    fn get(&self, set: Reg) -> &Set<W> {
        &self[set.index()]
    }

    #[inline(always)]
    fn get_mut(&mut self, set: Reg) -> &mut Set<W> {
        &mut self[set.index()]
    }
}

// The length is a power of two and covers all numbers of sets, so that indexing needs no bounds check.
impl<const W: usize, const N: usize> Sets<W> for [Set<W>; N] {
    #[inline(always)]
    fn get(&self, set: Reg) -> &Set<W> {
        &self[set.index() % N]
    }

    #[inline(always)]
    fn get_mut(&mut self, set: Reg) -> &mut Set<W> {
        &mut self[set.index() % N]
    }
}

impl DemandOp {
    /// Returns the demanded entities.
    #[inline(always)]
    fn of<const W: usize>(&self, sets: &(impl Sets<W> + ?Sized)) -> Set<W> {
        without(and(*sets.get(self.left), sets.get(self.right)), sets.get(self.dst))
    }
}

#[inline(always)]
fn add_any<const W: usize, const N: usize>(
    sets: &mut (impl Sets<W> + ?Sized),
    demand: &DemandOp,
    search: &Any<N>,
    pairs: &impl BinaryFacts<W>,
) {
    let (asked, among) = (demand.of(sets), *sets.get(search.among));
    if !is_empty(&asked) && !is_empty(&among) {
        let found = match N {
            0 => asked,
            _ => pairs.any(search.lists.map(usize::from), asked, among),
        };
        let dst = sets.get_mut(demand.dst);
        *dst = or(*dst, &found);
    }
}

/// The sets that a [`Dense`] program reads and writes, for one universe.
#[derive(Clone, Debug)]
pub struct BitState<const W: usize> {
    pub(super) count: usize,
    pub(super) sets: Vec<Set<W>>,
    /// Whether a steady input has changed since the operations that depend on it ran.
    pub(super) unsettled: bool,
    /// The rows of derived two-column predicates, `count` for each.
    rows: Vec<Set<W>>,
    tables: Tables<W>,
}

impl<const W: usize> BitState<W> {
    /// Makes a state for `count` entities with empty inputs.
    ///
    /// # Panics
    /// If `count` exceeds `64 * W`.
    pub fn new(program: &Dense, count: usize) -> Self {
        let mut bit_state = BitState {
            count: 0,
            sets: vec![[0; W]; allocated::<W>(program.set_count)],
            unsettled: true,
            rows: Vec::new(),
            tables: Tables::new(),
        };
        bit_state.reset(program, count);
        bit_state
    }

    /// Resets the state to another universe of the same program, with empty inputs. Allocates only if this universe is
    /// larger than all earlier ones.
    ///
    /// # Panics
    /// If `count` exceeds `64 * W`.
    pub fn reset(&mut self, program: &Dense, count: usize) {
        assert!(count <= 64 * W, "{count} entities in sets of {}", 64 * W);
        self.count = count;
        // A run writes all other sets before it reads them.
        self.sets[Reg::INPUTS.index()..][..program.inputs.len()].fill([0; W]);
        self.rows.clear();
        self.rows.resize(program.row_lists * count, [0; W]);
        self.unsettled = true;
        self.sets[Reg::ALL.index()] = first(count);
        self.sets[Reg::EGOS.index()] = first(count);
    }

    /// Returns the number of entities.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Restricts the run to these entities: it omits heads whose first argument is another entity. Use it only for
    /// [local](Dense::is_local) programs; for others the answer would be wrong.
    pub fn set_egos(&mut self, egos: Set<W>) {
        let egos = and(egos, &self.sets[Reg::ALL.index()]);
        let old = &mut self.sets[Reg::EGOS.index()];
        self.unsettled |= *old != egos;
        *old = egos;
    }

    /// Sets an input to the entities for which it holds. `input` is a position in [`Dense::inputs`].
    pub fn set_input(&mut self, program: &Dense, input: usize, set: Set<W>) {
        let old = &mut self.sets[Reg::INPUTS.index() + input];
        self.unsettled |= input >= program.restless && *old != set;
        *old = set;
    }

    /// Evaluates the program.
    ///
    /// # Errors
    /// If searches over many variables take more steps than [`Dense::steps_max`]; the results are then meaningless.
    /// Whether they do depends on the program and the facts only.
    #[inline]
    pub fn run(&mut self, program: &Dense, pairs: &impl BinaryFacts<W>) -> Result<(), TooManySteps> {
        let BitState {
            count,
            sets,
            unsettled,
            rows,
            tables,
        } = self;
        tables.begin_run(Dense::steps_max(*count));
        for set in &program.cleared {
            sets[set.index()] = [0; W];
        }
        if !rows.is_empty() {
            rows.fill([0; W]);
        }
        let mut execute = |ops: &[Op]| {
            // The length identifies the code: see `allocated`.
            if W == 1 && sets.len() == FEWER[0] {
                let few = sets.first_chunk_mut::<{ FEWER[0] }>().expect("its length");
                return execute(program, ops, few, rows, tables, *count, pairs);
            }
            if W == 1 && sets.len() == FEWER[1] {
                let few = sets.first_chunk_mut::<{ FEWER[1] }>().expect("its length");
                return execute(program, ops, few, rows, tables, *count, pairs);
            }
            match sets.first_chunk_mut::<FEW>() {
                Some(few) if program.set_count <= FEW => execute(program, ops, few, rows, tables, *count, pairs),
                _ => execute(program, ops, &mut sets[..], rows, tables, *count, pairs),
            }
        };
        if std::mem::take(unsettled) {
            execute(&program.settling);
        }
        execute(&program.ops);
        tables.end_run()
    }

    /// Returns the number of steps that searches over three or more variables took in the last run; see
    /// [`Dense::steps_max`].
    pub fn steps(&self) -> u64 {
        self.tables.steps()
    }

    /// Returns the entities for which a one-column predicate holds, or `None` if the program does not derive it.
    pub fn set(&self, program: &Dense, predicate: PredicateId) -> Option<&Set<W>> {
        program.set_of(predicate).map(|set| &self.sets[set.index()])
    }

    /// Returns the entities to which a two-column predicate relates entity `at`, or `None` if the program does not
    /// derive it.
    pub fn row(&self, program: &Dense, predicate: PredicateId, at: usize) -> Option<&Set<W>> {
        let list = program.rows_of(predicate)?;
        (at < self.count).then(|| &self.rows[list * self.count + at])
    }

    /// Returns the entities for which a clause derives its one-column head, or `None` if firings are not tracked
    /// ([`TrackFirings::Each`]).
    ///
    /// [`TrackFirings::Each`]: super::TrackFirings::Each
    pub fn fired(&self, program: &Dense, clause: ClauseId) -> Option<&Set<W>> {
        program.fired(clause).map(|set| &self.sets[set.index()])
    }

    /// Returns the number of rows that a clause derives, or `None` if firings are not tracked or the clause is not in
    /// the program.
    pub fn count_fired(&self, program: &Dense, clause: ClauseId) -> Option<usize> {
        let size = |set: &Set<W>| set.iter().map(|word| word.count_ones() as usize).sum::<usize>();
        if let Some(set) = self.fired(program, clause) {
            return Some(size(set));
        }
        let list = program.fired_rows(clause)?;
        let rows = &self.rows[list * self.count..(list + 1) * self.count];
        Some(rows.iter().map(size).sum())
    }
}

/// Runs operations in order.
// A call keeps fewer values in registers, which costs an evaluation of 18 agents a tenth of its time.
#[inline(always)]
fn execute<const W: usize>(
    program: &Dense,
    ops: &[Op],
    sets: &mut (impl Sets<W> + ?Sized),
    rows: &mut [Set<W>],
    tables: &mut Tables<W>,
    count: usize,
    pairs: &impl BinaryFacts<W>,
) {
    for op in ops {
        match op {
            Op::Both { dst, left, right } => *sets.get_mut(*dst) = and(*sets.get(*left), sets.get(*right)),
            Op::Without { dst, left, right } => *sets.get_mut(*dst) = without(*sets.get(*left), sets.get(*right)),
            Op::Add { dst, left, right } => {
                let set = and(*sets.get(*left), sets.get(*right));
                let dst = sets.get_mut(*dst);
                *dst = or(*dst, &set);
            }
            Op::Any0(demand, search) => add_any(sets, demand, search, pairs),
            Op::Any1(demand, search) => add_any(sets, demand, search, pairs),
            Op::Any2(demand, search) => add_any(sets, demand, search, pairs),
            Op::Any3(demand, search) => add_any(sets, demand, search, pairs),
            Op::Exists(demand, steps) => {
                let asked = demand.of(sets);
                if !is_empty(&asked) {
                    let found = search(program, sets.as_ref(), rows, count, pairs).exists(asked, *steps);
                    let dst = sets.get_mut(demand.dst);
                    *dst = or(*dst, &found);
                }
            }
            Op::Rare(op) => execute_rare(program, program.rare(*op), sets, rows, tables, count, pairs),
        }
    }
}

// Not inlined, so that the common operations keep their values in registers.
#[inline(never)]
fn execute_rare<const W: usize>(
    program: &Dense,
    op: &Rare,
    sets: &mut (impl Sets<W> + ?Sized),
    rows: &mut [Set<W>],
    tables: &mut Tables<W>,
    count: usize,
    pairs: &impl BinaryFacts<W>,
) {
    match op {
        Rare::Rows { dst, demand, steps } => {
            let (steps, demand) = (program.steps(*steps), *sets.get(*demand));
            if is_empty(sets.get(steps[0].among)) {
                return;
            }
            for ego in members(&demand) {
                let set = search(program, sets.as_ref(), rows, count, pairs).values(ego, steps);
                let row = dst * count + ego;
                rows[row] = or(rows[row], &set);
            }
        }
        Rare::ExistsTree(demand, branches) => {
            let asked = demand.of(sets);
            if !is_empty(&asked) {
                let search = search(program, sets.as_ref(), rows, count, pairs);
                let found = TreeSearch::new(search, tables, *branches).exists(asked);
                let dst = sets.get_mut(demand.dst);
                *dst = or(*dst, &found);
            }
        }
        Rare::RowsTree { dst, demand, branches } => {
            let search = search(program, sets.as_ref(), rows, count, pairs);
            let mut search = TreeSearch::new(search, tables, *branches);
            let egos = members(sets.get(*demand));
            let found: Vec<(usize, Set<W>)> = egos.map(|ego| (ego, search.values(ego))).collect();
            for (ego, set) in found {
                let row = dst * count + ego;
                rows[row] = or(rows[row], &set);
            }
        }
        Rare::OrRows { dst, from } => {
            for at in 0..count {
                let dst = dst * count + at;
                rows[dst] = or(rows[dst], &rows[from * count + at]);
            }
        }
        Rare::Diagonal { dst, rows: list } => {
            let mut set = [0; W];
            for at in 0..count {
                if has(&rows[list * count + at], at) {
                    set[at / 64] |= 1 << (at % 64);
                }
            }
            *sets.get_mut(*dst) = set;
        }
        Rare::Count {
            dst,
            demand,
            test,
            bounds,
        } => {
            let demand = *sets.get(*demand);
            let search = search(program, sets.as_ref(), rows, count, pairs);
            let (test, all) = (program.tests(*test), *sets.get(Reg::ALL));
            let mut set = [0; W];
            for at in members(&demand) {
                let related = search.pass(test, all, &[at]);
                let ones = related.iter().map(|word| word.count_ones()).sum();
                set[at / 64] |= u64::from(bounds.contain(ones)) << (at % 64);
            }
            *sets.get_mut(*dst) = set;
        }
    }
}
