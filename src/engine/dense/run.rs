//! Running a [`Dense`] program.

use super::compile::{Axis, Combination, Dense, Input, List, Lists, Op, Place, Range, Step};
use crate::lang::{ClauseId, RelId};

/// A set of entities: entity `i` is bit `i % 64` of word `i / 64`. Holds up to `64 * W` entities.
pub type Set<const W: usize> = [u64; W];

/// The set with one member.
fn only<const W: usize>(entity: usize) -> Set<W> {
    let mut set = [0; W];
    set[entity / 64] = 1 << (entity % 64);
    set
}

/// Whether the entity is in the set.
pub fn has<const W: usize>(set: &Set<W>, entity: usize) -> bool {
    set[entity / 64] >> (entity % 64) & 1 != 0
}

/// The first `count` entities.
pub fn first<const W: usize>(count: usize) -> Set<W> {
    std::array::from_fn(|word| match count.saturating_sub(word * 64) {
        0 => 0,
        1..64 => (1 << (count % 64)) - 1,
        _ => u64::MAX,
    })
}

/// The members of both.
#[inline(always)]
pub fn and<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] &= right[at];
        at += 1;
    }
    left
}

/// The members of `left` that are not in `right`.
#[inline(always)]
pub fn without<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] &= !right[at];
        at += 1;
    }
    left
}

#[inline(always)]
fn or<const W: usize>(mut left: Set<W>, right: &Set<W>) -> Set<W> {
    let mut at = 0;
    while at < W {
        left[at] |= right[at];
        at += 1;
    }
    left
}

/// Whether the set has no members.
#[inline(always)]
pub fn is_empty<const W: usize>(set: &Set<W>) -> bool {
    let mut all = 0;
    let mut at = 0;
    while at < W {
        all |= set[at];
        at += 1;
    }
    all == 0
}

/// The entities of a set in ascending order.
pub fn members<const W: usize>(set: &Set<W>) -> impl Iterator<Item = usize> + use<W> {
    let mut rest = *set;
    let mut word = 0;
    std::iter::from_fn(move || {
        while word < W {
            if rest[word] != 0 {
                let bit = rest[word].trailing_zeros() as usize;
                rest[word] &= rest[word] - 1;
                return Some(word * 64 + bit);
            }
            word += 1;
        }
        None
    })
}

/// Where facts about pairs come from.
pub trait Pairs<const W: usize> {
    /// Those of `among` that stand in the relation of the list to entity `at`. `list` is a position in [`Dense::lists`].
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W>;

    /// Those of `demand` to which one and the same member of `among` stands in the relations of all lists.
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

/// [`Pairs::any`] for a number of lists that is known at run time.
#[inline]
fn any<const W: usize>(pairs: &impl Pairs<W>, lists: Lists, demand: Set<W>, among: Set<W>) -> Set<W> {
    let [first, second, third] = lists.lists.map(usize::from);
    match lists.count {
        0 => demand,
        1 => pairs.any([first], demand, among),
        2 => pairs.any([first, second], demand, among),
        _ => pairs.any([first, second, third], demand, among),
    }
}

/// Makes combinations of sets.
#[inline]
fn combine<const W: usize>(sets: &mut [Set<W>], combinations: &[Combination]) {
    for &Combination {
        dst,
        left,
        right,
        flips,
    } in combinations
    {
        let (left, right) = (sets[left.index()], sets[right.index()]);
        let [flip_left, flip_right, flip] = flips;
        let dst = &mut sets[dst.index()];
        let mut word = 0;
        while word < W {
            dst[word] = (left[word] ^ flip_left) & (right[word] ^ flip_right) ^ flip;
            word += 1;
        }
    }
}

/// The sets a [`Dense`] program reads and writes, for one universe.
#[derive(Clone, Debug)]
pub struct Frame<const W: usize> {
    count: usize,
    sets: Vec<Set<W>>,
    /// Whether a steady input has changed since what follows from it was computed.
    unsettled: bool,
    /// Rows of derived predicates with two columns, `count` for each.
    rows: Vec<Set<W>>,
}

impl<const W: usize> Frame<W> {
    /// For `count` entities; all inputs are empty.
    ///
    /// # Panics
    /// If a set does not hold so many.
    pub fn new(program: &Dense, count: usize) -> Self {
        let mut frame = Frame {
            count: 0,
            sets: Vec::new(),
            unsettled: true,
            rows: Vec::new(),
        };
        frame.reset(program, count);
        frame
    }

    /// Makes it one for another universe; all inputs are empty. Allocates only if it is larger than every one before.
    ///
    /// # Panics
    /// If a set does not hold so many.
    pub fn reset(&mut self, program: &Dense, count: usize) {
        assert!(count <= 64 * W, "{count} entities in sets of {}", 64 * W);
        self.count = count;
        self.sets.clear();
        self.sets.resize(program.set_count(), [0; W]);
        self.rows.clear();
        self.rows.resize(program.row_lists() * count, [0; W]);
        self.unsettled = true;
        self.sets[Dense::ALL] = first(count);
        self.sets[Dense::EGOS] = first(count);
    }

    /// How many entities there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Decides only about these entities: heads whose first argument is another are left out. Only for programs that are
    /// [local](Dense::is_local); for others the answer would be wrong.
    pub fn set_egos(&mut self, egos: Set<W>) {
        let egos = and(egos, &self.sets[Dense::ALL]);
        self.unsettled |= self.sets[Dense::EGOS] != egos;
        self.sets[Dense::EGOS] = egos;
    }

    /// Sets an input: the entities of which it holds. `input` is a position in [`Dense::inputs`].
    pub fn set_input(&mut self, program: &Dense, input: usize, set: Set<W>) {
        let old = &mut self.sets[Dense::FIRST_INPUT + input];
        self.unsettled |= input >= program.restless && *old != set;
        *old = set;
    }

    /// Evaluates the program.
    pub fn run(&mut self, program: &Dense, pairs: &impl Pairs<W>) {
        for &head in &program.heads {
            self.sets[head.index()] = [0; W];
        }
        if !self.rows.is_empty() {
            self.rows.fill([0; W]);
        }
        if self.unsettled {
            combine(&mut self.sets, &program.settling);
            self.unsettled = false;
        }
        self.execute(program, pairs);
    }

    #[inline]
    fn execute(&mut self, program: &Dense, pairs: &impl Pairs<W>) {
        // As a local the list stays in registers.
        let mut sets = std::mem::take(&mut self.sets);
        for op in &program.ops {
            match *op {
                Op::Combine(range) => combine(&mut sets, program.combinations(range)),
                Op::Any {
                    dst,
                    demand,
                    among,
                    lists,
                } => {
                    let (demand, among) = (sets[demand.index()], sets[among.index()]);
                    sets[dst.index()] = match is_empty(&demand) || is_empty(&among) {
                        true => [0; W],
                        false => any(pairs, lists, demand, among),
                    };
                }
                Op::AddAny {
                    dst,
                    left,
                    right,
                    among,
                    lists,
                } => {
                    let known = sets[dst.index()];
                    let demand = without(and(sets[left.index()], &sets[right.index()]), &known);
                    let among = sets[among.index()];
                    if !is_empty(&demand) && !is_empty(&among) {
                        sets[dst.index()] = or(known, &any(pairs, lists, demand, among));
                    }
                }
                Op::Exists { dst, demand, steps } => {
                    sets[dst.index()] = self.search(program, &sets, pairs).exists(sets[demand.index()], steps);
                }
                Op::Rows { dst, demand, steps } => {
                    let (steps, demand) = (program.steps(steps), sets[demand.index()]);
                    if is_empty(&sets[steps[0].among.index()]) {
                        continue;
                    }
                    for ego in members(&demand) {
                        let set = self.search(program, &sets, pairs).values(ego, steps);
                        let row = dst * self.count + ego;
                        self.rows[row] = or(self.rows[row], &set);
                    }
                }
                Op::OrRows { dst, from } => {
                    for at in 0..self.count {
                        let dst = dst * self.count + at;
                        self.rows[dst] = or(self.rows[dst], &self.rows[from * self.count + at]);
                    }
                }
                Op::Diagonal { dst, rows } => {
                    let mut set = [0; W];
                    for at in 0..self.count {
                        if has(&self.rows[rows * self.count + at], at) {
                            set[at / 64] |= 1 << (at % 64);
                        }
                    }
                    sets[dst.index()] = set;
                }
            }
        }
        self.sets = sets;
    }

    /// Of which entities a predicate with one column holds; `None` if the program does not derive it.
    pub fn set(&self, program: &Dense, relation: RelId) -> Option<&Set<W>> {
        program.set_of(relation).map(|set| &self.sets[set.index()])
    }

    /// To which entities a predicate with two columns relates entity `at`; `None` if the program does not derive it.
    pub fn row(&self, program: &Dense, relation: RelId, at: usize) -> Option<&Set<W>> {
        let list = program.rows_of(relation)?;
        (at < self.count).then(|| &self.rows[list * self.count + at])
    }

    /// The entities that a clause derives its head of, if the head has one column and clauses are counted ([`Counting::Each`]).
    ///
    /// [`Counting::Each`]: super::Counting::Each
    pub fn fired(&self, program: &Dense, clause: ClauseId) -> Option<&Set<W>> {
        program.fired(clause).map(|set| &self.sets[set.index()])
    }

    /// How many rows a clause derives; `None` if clauses are not counted, or it is not the program's.
    pub fn count_fired(&self, program: &Dense, clause: ClauseId) -> Option<usize> {
        let size = |set: &Set<W>| set.iter().map(|word| word.count_ones() as usize).sum::<usize>();
        if let Some(set) = self.fired(program, clause) {
            return Some(size(set));
        }
        let list = program.fired_rows(clause)?;
        let rows = &self.rows[list * self.count..(list + 1) * self.count];
        Some(rows.iter().map(size).sum())
    }

    fn search<'a, P>(&'a self, program: &'a Dense, sets: &'a [Set<W>], pairs: &'a P) -> Search<'a, W, P> {
        Search {
            program,
            sets,
            rows: &self.rows,
            count: self.count,
            pairs,
        }
    }
}

/// Looks for values of variables.
struct Search<'a, const W: usize, P> {
    program: &'a Dense,
    sets: &'a [Set<W>],
    rows: &'a [Set<W>],
    count: usize,
    pairs: &'a P,
}

/// The values of the head's first variable and of those of the steps so far.
type Bound = [usize; Dense::VARIABLES_MAX + 1];

impl<const W: usize, P: Pairs<W>> Search<'_, W, P> {
    /// Those of `demand` for which values of all steps exist.
    fn exists(&self, demand: Set<W>, steps: Range) -> Set<W> {
        let mut found = [0; W];
        let steps = self.program.steps(steps);
        if is_empty(&demand) || is_empty(&self.sets[steps[0].among.index()]) {
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

    /// The values of the first step for an entity for which values of the others exist.
    fn values(&self, ego: usize, steps: &[Step]) -> Set<W> {
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

    /// Whether some member of `set`, taken for step `depth`, leaves values for all further steps.
    fn go_on(&self, steps: &[Step], depth: usize, set: Set<W>, bound: &mut Bound) -> bool {
        let Some(next) = steps.get(depth + 1) else {
            return !is_empty(&set);
        };
        if is_empty(&set) || is_empty(&self.sets[next.among.index()]) {
            return false;
        }
        members(&set).any(|value| {
            bound[depth + 1] = value;
            let set = self.narrow(next, bound);
            self.go_on(steps, depth + 1, set, bound)
        })
    }

    /// The values that a step leaves, given those that are bound.
    #[inline]
    fn narrow(&self, step: &Step, bound: &Bound) -> Set<W> {
        let mut set = self.sets[step.among.index()];
        for test in self.program.tests(step.tests) {
            let at = bound[test.to];
            let fitting = match test.list {
                Place::Given(list) => self.pairs.narrow(list, at, set),
                Place::Derived(list, Axis::Second) => and(set, &self.rows[list * self.count + at]),
                Place::Derived(list, Axis::First) => {
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

/// Facts of all predicates that a program reads, held as bits.
#[derive(Clone, Debug)]
pub struct BitFacts<const W: usize> {
    count: usize,
    inputs: Vec<Set<W>>,
    /// For each list one block for each word of a set: the rows of the entities that have their bits in that word.
    lists: Vec<[Set<W>; 64]>,
}

impl<const W: usize> BitFacts<W> {
    /// No facts about `count` entities.
    pub fn new(program: &Dense, count: usize) -> Self {
        BitFacts {
            count,
            inputs: vec![[0; W]; program.inputs().len()],
            lists: vec![[[0; W]; 64]; program.lists().len() * W],
        }
    }

    /// Adds a fact: its predicate and the positions of its entities. Facts that the program does not read are passed over.
    ///
    /// # Panics
    /// If there are fewer entities.
    pub fn insert(&mut self, program: &Dense, relation: RelId, row: &[usize]) {
        assert!(row.iter().all(|&entity| entity < self.count), "unknown entity");
        for (&input, set) in program.inputs().iter().zip(&mut self.inputs) {
            let holds = match (input, row) {
                (Input::Unary(read), [_]) => read == relation,
                (Input::Diagonal(read), [x, y]) => read == relation && x == y,
                _ => false,
            };
            if holds {
                set[row[0] / 64] |= 1 << (row[0] % 64);
            }
        }
        if let &[x, y] = row {
            for (position, list) in program.lists().iter().enumerate() {
                let (at, member) = match *list {
                    List(read, Axis::Second) if read == relation => (x, y),
                    List(read, Axis::First) if read == relation => (y, x),
                    List(..) => continue,
                };
                self.lists[position * W + at / 64][at % 64][member / 64] |= 1 << (member % 64);
            }
        }
    }

    /// Gives a frame for as many entities its inputs.
    ///
    /// # Panics
    /// If the frame is for another number of entities.
    pub fn load(&self, program: &Dense, frame: &mut Frame<W>) {
        assert_eq!(self.count, frame.count);
        let (restless, steady) = self.inputs.split_at(program.restless);
        let (into, steady_into) = (frame.sets[Dense::FIRST_INPUT..]).split_at_mut(program.restless);
        into.copy_from_slice(restless);
        let steady_into = &mut steady_into[..steady.len()];
        if steady_into != steady {
            steady_into.copy_from_slice(steady);
            frame.unsettled = true;
        }
    }
}

impl<const W: usize> Pairs<W> for BitFacts<W> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        and(among, &self.lists[list * W + at / 64][at % 64])
    }

    #[inline]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let mut found = [0; W];
        let mut word = 0;
        while word < W {
            if demand[word] != 0 {
                let rows = lists.map(|list| &self.lists[list * W + word]);
                found[word] = of(demand[word], |at| {
                    let mut set = among;
                    let mut list = 0;
                    while list < N {
                        set = and(set, &rows[list][at]);
                        list += 1;
                    }
                    !is_empty(&set)
                });
            }
            word += 1;
        }
        found
    }
}

/// Those of `members` for which it holds.
#[inline(always)]
fn of(members: u64, holds: impl Fn(usize) -> bool) -> u64 {
    let mut found = 0;
    let mut rest = members;
    while rest != 0 {
        let lowest = rest & rest.wrapping_neg();
        let at = rest.trailing_zeros() as usize & 63;
        // Without a branch: whether it holds is hard to guess.
        found |= lowest & u64::from(holds(at)).wrapping_neg();
        rest ^= lowest;
    }
    found
}
