//! Running a [`Dense`] program.

use super::compile::{Axis, Dense, Input, List, Op, Place, Range, Step};
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
fn first<const W: usize>(count: usize) -> Set<W> {
    std::array::from_fn(|word| match count.saturating_sub(word * 64) {
        0 => 0,
        1..64 => (1 << (count % 64)) - 1,
        _ => u64::MAX,
    })
}

fn and<const W: usize>(left: Set<W>, right: &Set<W>) -> Set<W> {
    std::array::from_fn(|word| left[word] & right[word])
}

fn without<const W: usize>(left: Set<W>, right: &Set<W>) -> Set<W> {
    std::array::from_fn(|word| left[word] & !right[word])
}

fn is_empty<const W: usize>(set: &Set<W>) -> bool {
    set.iter().all(|&word| word == 0)
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
}

/// The sets a [`Dense`] program reads and writes, for one universe.
#[derive(Clone, Debug)]
pub struct Frame<const W: usize> {
    count: usize,
    sets: Vec<Set<W>>,
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
        self.sets[Dense::EGOS] = and(egos, &self.sets[Dense::ALL]);
    }

    /// Sets an input: the entities of which it holds. `input` is a position in [`Dense::inputs`].
    pub fn set_input(&mut self, input: usize, set: Set<W>) {
        self.sets[Dense::FIRST_INPUT + input] = set;
    }

    /// Evaluates the program.
    pub fn run(&mut self, program: &Dense, pairs: &impl Pairs<W>) {
        for &head in &program.heads {
            self.sets[head.index()] = [0; W];
        }
        if !self.rows.is_empty() {
            self.rows.fill([0; W]);
        }
        for op in &program.ops {
            match *op {
                Op::And { dst, ones, zeros } => self.sets[dst.index()] = self.both(program, ones, zeros),
                Op::Or { dst, from } => {
                    let from = self.sets[from.index()];
                    let dst = &mut self.sets[dst.index()];
                    (0..W).for_each(|word| dst[word] |= from[word]);
                }
                Op::Exists { dst, demand, steps } => {
                    self.sets[dst.index()] = self.exists(program, self.sets[demand.index()], steps, pairs);
                }
                Op::Rows { dst, demand, steps } => {
                    self.fill_rows(program, dst, self.sets[demand.index()], steps, pairs)
                }
                Op::OrRows { dst, from } => {
                    for at in 0..self.count {
                        let from = self.rows[from * self.count + at];
                        let dst = &mut self.rows[dst * self.count + at];
                        (0..W).for_each(|word| dst[word] |= from[word]);
                    }
                }
                Op::Diagonal { dst, rows } => {
                    let mut set = [0; W];
                    for at in 0..self.count {
                        if has(&self.rows[rows * self.count + at], at) {
                            set[at / 64] |= 1 << (at % 64);
                        }
                    }
                    self.sets[dst.index()] = set;
                }
            }
        }
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

    /// The intersection of some sets and of the complements of others.
    #[inline]
    fn both(&self, program: &Dense, ones: Range, zeros: Range) -> Set<W> {
        let mut set = self.sets[Dense::ALL];
        for one in program.operands(ones) {
            set = and(set, &self.sets[one.index()]);
        }
        for zero in program.operands(zeros) {
            set = without(set, &self.sets[zero.index()]);
        }
        set
    }

    /// Those of `demand` for which values of all steps exist.
    #[inline]
    fn exists(&self, program: &Dense, demand: Set<W>, steps: Range, pairs: &impl Pairs<W>) -> Set<W> {
        let mut found = [0; W];
        if is_empty(&demand) {
            return found;
        }
        let steps = program.steps(steps);
        let candidates = self.both(program, steps[0].ones, steps[0].zeros);
        if is_empty(&candidates) {
            return found;
        }
        if let [step] = steps {
            for ego in members(&demand) {
                let set = self.narrow(program, step, candidates, &[ego], pairs);
                if !is_empty(&set) {
                    found[ego / 64] |= 1 << (ego % 64);
                }
            }
            return found;
        }
        for ego in members(&demand) {
            let mut bound = [0; Dense::VARIABLES_MAX + 1];
            bound[0] = ego;
            let set = self.narrow(program, &steps[0], candidates, &bound, pairs);
            if self.search(program, steps, 0, set, &mut bound, pairs) {
                found[ego / 64] |= 1 << (ego % 64);
            }
        }
        found
    }

    /// Whether some member of `set`, taken for step `depth`, leaves values for all further steps.
    fn search(
        &self,
        program: &Dense,
        steps: &[Step],
        depth: usize,
        set: Set<W>,
        bound: &mut [usize; Dense::VARIABLES_MAX + 1],
        pairs: &impl Pairs<W>,
    ) -> bool {
        let Some(next) = steps.get(depth + 1) else {
            return !is_empty(&set);
        };
        if is_empty(&set) {
            return false;
        }
        let candidates = self.both(program, next.ones, next.zeros);
        if is_empty(&candidates) {
            return false;
        }
        members(&set).any(|value| {
            bound[depth + 1] = value;
            let set = self.narrow(program, next, candidates, bound, pairs);
            self.search(program, steps, depth + 1, set, bound, pairs)
        })
    }

    /// Adds to each row of `demand` the values of the first step for which values of the others exist.
    fn fill_rows(&mut self, program: &Dense, dst: usize, demand: Set<W>, steps: Range, pairs: &impl Pairs<W>) {
        let steps = program.steps(steps);
        let candidates = self.both(program, steps[0].ones, steps[0].zeros);
        if is_empty(&candidates) {
            return;
        }
        for ego in members(&demand) {
            let mut bound = [0; Dense::VARIABLES_MAX + 1];
            bound[0] = ego;
            let mut set = self.narrow(program, &steps[0], candidates, &bound, pairs);
            if steps.len() > 1 {
                for value in members(&set) {
                    if !self.search(program, steps, 0, only(value), &mut bound, pairs) {
                        set = without(set, &only(value));
                    }
                }
            }
            let row = &mut self.rows[dst * self.count + ego];
            (0..W).for_each(|word| row[word] |= set[word]);
        }
    }

    /// Those of `set` that stand as the step asks to what is bound.
    #[inline]
    fn narrow(&self, program: &Dense, step: &Step, set: Set<W>, bound: &[usize], pairs: &impl Pairs<W>) -> Set<W> {
        let mut set = set;
        for test in program.tests(step.tests) {
            let at = bound[test.to];
            let fitting = match test.list {
                Place::Given(list) => pairs.narrow(list, at, set),
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
    /// `count` for each list.
    lists: Vec<Set<W>>,
}

impl<const W: usize> BitFacts<W> {
    /// No facts about `count` entities.
    pub fn new(program: &Dense, count: usize) -> Self {
        BitFacts {
            count,
            inputs: vec![[0; W]; program.inputs().len()],
            lists: vec![[0; W]; program.lists().len() * count],
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
                self.lists[position * self.count + at][member / 64] |= 1 << (member % 64);
            }
        }
    }

    /// Gives a frame for as many entities its inputs.
    ///
    /// # Panics
    /// If the frame is for another number of entities.
    pub fn load(&self, frame: &mut Frame<W>) {
        assert_eq!(self.count, frame.count);
        let from = Dense::FIRST_INPUT;
        frame.sets[from..from + self.inputs.len()].copy_from_slice(&self.inputs);
    }
}

impl<const W: usize> Pairs<W> for BitFacts<W> {
    #[inline]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        and(among, &self.lists[list * self.count + at])
    }
}
