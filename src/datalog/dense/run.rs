//! Executes a [`Dense`] program.

use crate::datalog::check::{ClauseId, RelId};
use crate::datalog::dense::program::{Any, Argument, DemandOp, Dense, Op, Place, Range, Rare, Reg, SearchStep};
use crate::datalog::dense::sets::{Set, and, first, has, is_empty, members, only, or, without};

/// A source of binary facts, which it may compute lazily.
pub trait BinaryFacts<const W: usize> {
    /// Returns the members of `among` that a list relates to entity `at`. `list` is a position in [`Dense::lists`].
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W>;

    /// Polls for cancellation. Once it returns true, the results are meaningless.
    #[inline]
    fn cancelled(&self) -> bool {
        false
    }

    /// Returns the members of `demand` that all lists relate to one and the same member of `among`.
    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let mut found = [0; W];
        for at in members(&demand) {
            let mut set = among;
            for list in lists {
                set = self.narrow(list, at, set);
                if is_empty(&set) {
                    break;
                }
            }
            if !is_empty(&set) {
                found[at / 64] |= 1 << (at % 64);
            }
        }
        found
    }
}

/// Programs with at most this number of sets run faster.
const FEW: usize = 256;

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

// The length covers all values of one byte, so that indexing needs no bounds check.
impl<const W: usize> Sets<W> for [Set<W>; FEW] {
    #[inline(always)]
    fn get(&self, set: Reg) -> &Set<W> {
        &self[set.index() % FEW]
    }

    #[inline(always)]
    fn get_mut(&mut self, set: Reg) -> &mut Set<W> {
        &mut self[set.index() % FEW]
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
}

impl<const W: usize> BitState<W> {
    /// Makes a state for `count` entities with empty inputs.
    ///
    /// # Panics
    /// If `count` exceeds `64 * W`.
    pub fn new(program: &Dense, count: usize) -> Self {
        let mut bit_state = BitState {
            count: 0,
            sets: vec![[0; W]; program.set_count.max(FEW)],
            unsettled: true,
            rows: Vec::new(),
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
    pub fn run(&mut self, program: &Dense, pairs: &impl BinaryFacts<W>) {
        let BitState {
            count,
            sets,
            unsettled,
            rows,
        } = self;
        for set in &program.cleared {
            sets[set.index()] = [0; W];
        }
        if !rows.is_empty() {
            rows.fill([0; W]);
        }
        let mut execute = |ops: &[Op]| match sets.first_chunk_mut::<FEW>() {
            Some(few) if program.set_count <= FEW => execute(program, ops, few, rows, *count, pairs),
            _ => execute(program, ops, &mut sets[..], rows, *count, pairs),
        };
        if std::mem::take(unsettled) {
            execute(&program.settling);
        }
        execute(&program.ops);
    }

    /// Returns the entities for which a one-column predicate holds, or `None` if the program does not derive it.
    pub fn set(&self, program: &Dense, relation: RelId) -> Option<&Set<W>> {
        program.set_of(relation).map(|set| &self.sets[set.index()])
    }

    /// Returns the entities to which a two-column predicate relates entity `at`, or `None` if the program does not
    /// derive it.
    pub fn row(&self, program: &Dense, relation: RelId, at: usize) -> Option<&Set<W>> {
        let list = program.rows_of(relation)?;
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
fn execute<const W: usize>(
    program: &Dense,
    ops: &[Op],
    sets: &mut (impl Sets<W> + ?Sized),
    rows: &mut [Set<W>],
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
                    let found = search(program, sets, rows, count, pairs).exists(asked, *steps);
                    let dst = sets.get_mut(demand.dst);
                    *dst = or(*dst, &found);
                }
            }
            Op::Rare(op) => execute_rare(program, op, sets, rows, count, pairs),
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
                let set = search(program, sets, rows, count, pairs).values(ego, steps);
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
    }
}

fn search<'a, const W: usize, P>(
    program: &'a Dense,
    sets: &'a (impl Sets<W> + ?Sized),
    rows: &'a [Set<W>],
    count: usize,
    pairs: &'a P,
) -> Search<'a, W, P> {
    Search {
        program,
        sets: sets.as_ref(),
        rows,
        count,
        pairs,
    }
}

/// A search for values of variables.
struct Search<'a, const W: usize, P> {
    program: &'a Dense,
    sets: &'a [Set<W>],
    rows: &'a [Set<W>],
    count: usize,
    pairs: &'a P,
}

/// The values of the head's first variable and of the variables of earlier steps.
type Bound = [usize; Dense::VARIABLES_MAX + 1];

impl<const W: usize, P: BinaryFacts<W>> Search<'_, W, P> {
    /// Returns the members of `demand` for which all steps have values.
    #[inline(never)]
    fn exists(&self, demand: Set<W>, steps: Range) -> Set<W> {
        let mut found = [0; W];
        let steps = self.program.steps(steps);
        if is_empty(&self.sets[steps[0].among.index()]) {
            return found;
        }
        for ego in members(&demand) {
            let mut bound = [0; Dense::VARIABLES_MAX + 1];
            bound[0] = ego;
            let set = self.narrow(&steps[0], &bound);
            if self.go_on(steps, 0, set, &mut bound) {
                found[ego / 64] |= 1 << (ego % 64);
            }
        }
        found
    }

    /// Returns the values of the first step for which the other steps have values.
    fn values(&self, ego: usize, steps: &[SearchStep]) -> Set<W> {
        let mut bound = [0; Dense::VARIABLES_MAX + 1];
        bound[0] = ego;
        let mut set = self.narrow(&steps[0], &bound);
        if steps.len() > 1 {
            for value in members(&set) {
                if !self.go_on(steps, 0, only(value), &mut bound) {
                    set = without(set, &only(value));
                }
            }
        }
        set
    }

    /// Whether some member of `set`, as the value of step `depth`, leaves values for all later steps.
    fn go_on(&self, steps: &[SearchStep], depth: usize, set: Set<W>, bound: &mut Bound) -> bool {
        let Some(next) = steps.get(depth + 1) else {
            return !is_empty(&set);
        };
        if is_empty(&set) || is_empty(&self.sets[next.among.index()]) || self.pairs.cancelled() {
            return false;
        }
        members(&set).any(|value| {
            bound[depth + 1] = value;
            let set = self.narrow(next, bound);
            self.go_on(steps, depth + 1, set, bound)
        })
    }

    /// Returns the values that a step allows, given the bound values.
    #[inline]
    fn narrow(&self, step: &SearchStep, bound: &Bound) -> Set<W> {
        let mut set = self.sets[step.among.index()];
        for test in self.program.tests(step.tests) {
            let at = bound[test.to];
            let fitting = match test.list {
                Place::Input(list) => self.pairs.narrow(list, at, set),
                Place::Derived(list, Argument::Second) => and(set, &self.rows[list * self.count + at]),
                Place::Derived(list, Argument::First) => {
                    let mut fitting = [0; W];
                    for member in members(&set) {
                        if has(&self.rows[list * self.count + member], at) {
                            fitting[member / 64] |= 1 << (member % 64);
                        }
                    }
                    fitting
                }
                Place::Same => and(set, &only(at)),
            };
            set = match test.holds {
                true => fitting,
                false => without(set, &fitting),
            };
        }
        set
    }
}
