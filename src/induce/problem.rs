//! The examples of one action as columns of bits, and the rows in which a clause holds.
//!
//! A column holds, for one fact about numbered entities, the states in which it is true. An *assignment* gives an
//! entity to each variable of a clause, so it turns the atoms of the clause into facts. The conjunction of their columns
//! are the states in which the clause holds under the assignment.

use crate::induce::bits::{self, Bits};
use crate::induce::examples::State;
use crate::induce::vocabulary::{ARITY_MAX, Atom, Body, VARIABLES_MAX, Vocabulary, cost};
use smallvec::SmallVec;

/// The facts of a list of states, transposed.
pub struct Columns {
    /// Words of a set of states.
    pub words: usize,
    /// For each fact, the states in which it holds.
    facts: Vec<u64>,
    /// For each entity, the states that have it.
    present: Vec<u64>,
}

impl Columns {
    fn new(vocabulary: &Vocabulary, states: &[&State], entities: usize) -> Columns {
        let words = states.len().div_ceil(64);
        let mut columns = Columns {
            words,
            facts: vec![0; vocabulary.facts(entities) * words],
            present: vec![0; entities * words],
        };
        let mut places: Vec<Option<Vec<u32>>> = vec![None; entities + 1];
        for (index, state) in states.iter().enumerate() {
            let own = state.entities();
            let places = places[own].get_or_insert_with(|| places_of(vocabulary, own, entities));
            for fact in state.facts() {
                bits::insert(&mut columns.facts[places[fact] as usize * words..], index);
            }
            for entity in 0..own {
                bits::insert(&mut columns.present[entity * words..], index);
            }
        }
        columns
    }
}

/// Returns, for each fact about `own` entities, its number among the facts about `entities` entities.
fn places_of(vocabulary: &Vocabulary, own: usize, entities: usize) -> Vec<u32> {
    let mut places = Vec::new();
    for (index, predicate) in vocabulary.predicates().iter().enumerate() {
        for number in 0..own.pow(predicate.arity as u32) {
            let mut arguments = [0; ARITY_MAX];
            let mut rest = number;
            for argument in arguments[..predicate.arity].iter_mut().rev() {
                (*argument, rest) = (rest % own, rest / own);
            }
            places.push(vocabulary.fact(entities, index, &arguments[..predicate.arity]) as u32);
        }
    }
    places
}

/// An assignment of entities to variables.
type Assignment = SmallVec<[u8; VARIABLES_MAX]>;

/// The pairs of an assignment and a state in which a clause holds.
#[derive(Clone, Default)]
pub struct Rows {
    /// The assignments that occur, in ascending order.
    assignments: Vec<u32>,
    /// For each of them, a set of states.
    states: Vec<u64>,
}

impl Rows {
    /// Returns the states that occur.
    pub fn states(&self, words: usize) -> Vec<u64> {
        let mut states = vec![0; words];
        for chunk in self.states.chunks_exact(words.max(1)) {
            states.iter_mut().zip(chunk).for_each(|(state, word)| *state |= word);
        }
        states
    }

    /// Returns their number.
    pub fn count(&self) -> u64 {
        bits::count(&self.states).into()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.assignments.is_empty()
    }
}

/// The positive and the negative examples of an action, for clauses over some variables.
pub struct Problem<'a> {
    /// The atoms that clauses consist of.
    pub atoms: Vec<Atom>,
    /// The predicates.
    pub vocabulary: &'a Vocabulary,
    /// The states in which the action is taken.
    pub positive: &'a Columns,
    /// The states in which an action of lower precedence is taken.
    pub negative: &'a Columns,
    entities: usize,
    assignments: Vec<Assignment>,
}

/// The columns of the positive and the negative states of an action.
pub struct Split {
    positive: Columns,
    negative: Columns,
    entities: usize,
}

impl Split {
    /// Transposes states.
    pub fn new(vocabulary: &Vocabulary, positive: &[&State], negative: &[&State]) -> Split {
        let entities = positive.iter().chain(negative).map(|state| state.entities()).max();
        let entities = entities.unwrap_or(vocabulary.egos());
        Split {
            positive: Columns::new(vocabulary, positive, entities),
            negative: Columns::new(vocabulary, negative, entities),
            entities,
        }
    }

    /// Returns the problem of finding clauses over a number of variables.
    pub fn problem<'a>(&'a self, vocabulary: &'a Vocabulary, variables: usize) -> Problem<'a> {
        let free = (variables - vocabulary.egos()) as u32;
        let assignments = (0..self.entities.pow(free)).map(|number| {
            let mut rest = number;
            let mut assignment: Assignment = (0..vocabulary.egos() as u8).collect();
            for _ in 0..free {
                assignment.push((rest % self.entities) as u8);
                rest /= self.entities;
            }
            assignment
        });
        Problem {
            atoms: vocabulary.atoms(variables),
            vocabulary,
            positive: &self.positive,
            negative: &self.negative,
            entities: self.entities,
            assignments: assignments.collect(),
        }
    }
}

impl Problem<'_> {
    /// Returns all rows of a list of states: the assignments whose entities exist.
    pub fn all(&self, columns: &Columns) -> Rows {
        let mut rows = Rows::default();
        for (index, assignment) in self.assignments.iter().enumerate() {
            let begin = rows.states.len();
            rows.states.resize(begin + columns.words, u64::MAX);
            let mut any = false;
            let mut seen = 0_u64;
            for &entity in assignment {
                if seen >> entity & 1 == 1 {
                    continue;
                }
                seen |= 1 << entity;
                let present = &columns.present[usize::from(entity) * columns.words..];
                (rows.states[begin..].iter_mut().zip(present)).for_each(|(word, present)| *word &= present);
            }
            any |= rows.states[begin..].iter().any(|word| *word != 0);
            if any {
                rows.assignments.push(index as u32);
            } else {
                rows.states.truncate(begin);
            }
        }
        rows
    }

    /// Returns the rows in which an atom is true, or false.
    pub fn restrict(&self, columns: &Columns, rows: &Rows, atom: &Atom, is_true: bool) -> Rows {
        let words = columns.words;
        let mut left = Rows {
            assignments: Vec::with_capacity(rows.assignments.len()),
            states: Vec::with_capacity(rows.states.len()),
        };
        let flip = if is_true { 0 } else { u64::MAX };
        for (&assignment, states) in rows.assignments.iter().zip(rows.states.chunks_exact(words.max(1))) {
            let column = &columns.facts[self.fact(atom, assignment) * words..][..words];
            let begin = left.states.len();
            let mut any = 0;
            left.states.extend(states.iter().zip(column).map(|(state, column)| {
                let word = state & (column ^ flip);
                any |= word;
                word
            }));
            if any == 0 {
                left.states.truncate(begin);
            } else {
                left.assignments.push(assignment);
            }
        }
        left
    }

    /// Writes the states of the rows in which an atom is true, or false. Returns the number of rows.
    pub fn states_with(&self, columns: &Columns, rows: &Rows, atom: &Atom, is_true: bool, out: &mut [u64]) -> u64 {
        out.fill(0);
        let flip = if is_true { 0 } else { u64::MAX };
        let mut count = 0;
        for (&assignment, states) in rows
            .assignments
            .iter()
            .zip(rows.states.chunks_exact(columns.words.max(1)))
        {
            let column = &columns.facts[self.fact(atom, assignment) * columns.words..];
            for ((out, state), column) in out.iter_mut().zip(states).zip(column) {
                let word = state & (column ^ flip);
                count += u64::from(word.count_ones());
                *out |= word;
            }
        }
        count
    }

    /// Returns the cost of a conjunction. `seed` has those of its atoms that are not negated.
    pub fn cost(&self, chosen: &[u64], seed: &[u64]) -> u32 {
        let literals = bits::elements(chosen).map(|literal| (&self.atoms[literal], !bits::has(seed, literal)));
        cost(literals, self.vocabulary.egos())
    }

    /// Returns whether the positive literals of a conjunction, or a guard, bind all its variables. `seed` has those of
    /// its atoms that are not negated.
    pub fn binds_all(&self, chosen: &[u64], seed: &[u64]) -> bool {
        self.unbound(chosen, seed).is_none()
    }

    /// Returns a variable that no positive literal of a conjunction binds although it must be bound.
    pub fn unbound(&self, chosen: &[u64], seed: &[u64]) -> Option<u8> {
        if self.vocabulary.guard().is_some() {
            return None;
        }
        let (mut used, mut bound) = ((1_u64 << self.vocabulary.egos()) - 1, 0_u64);
        for literal in bits::elements(chosen) {
            for variable in &self.atoms[literal].arguments {
                used |= 1 << variable;
                if bits::has(seed, literal) {
                    bound |= 1 << variable;
                }
            }
        }
        let unbound = used & !bound;
        (unbound != 0).then(|| unbound.trailing_zeros() as u8)
    }

    /// Returns the rows in which a conjunction holds. `seed` has those of its atoms that are not negated.
    pub fn holds(&self, columns: &Columns, chosen: &[u64], seed: &[u64]) -> Rows {
        let literals = bits::elements(chosen).map(|literal| (&self.atoms[literal], bits::has(seed, literal)));
        self.conjunction(columns, literals)
    }

    /// Returns the rows in which a body holds.
    pub fn satisfying(&self, columns: &Columns, body: &Body) -> Rows {
        self.conjunction(
            columns,
            body.0.iter().map(|literal| (&literal.atom, !literal.is_negated)),
        )
    }

    fn conjunction<'b>(&self, columns: &Columns, literals: impl Iterator<Item = (&'b Atom, bool)>) -> Rows {
        let mut rows = self.all(columns);
        for (atom, is_true) in literals {
            rows = self.restrict(columns, &rows, atom, is_true);
        }
        rows
    }

    /// Returns the true atoms of up to `most` of the rows, spread over all.
    pub fn sample(&self, columns: &Columns, rows: &Rows, most: usize) -> Vec<Bits> {
        let total: usize = rows.states.iter().map(|word| word.count_ones() as usize).sum();
        let step = total.div_ceil(most.max(1)).max(1);
        let mut sample = Vec::new();
        let mut skip = 0;
        for (&assignment, states) in rows
            .assignments
            .iter()
            .zip(rows.states.chunks_exact(columns.words.max(1)))
        {
            for (at, &word) in states.iter().enumerate() {
                let count = word.count_ones() as usize;
                if skip >= count {
                    skip -= count;
                    continue;
                }
                for state in bits::elements(&[word]) {
                    if skip == 0 {
                        sample.push(self.row(columns, at * 64 + state, assignment));
                        skip = step;
                    }
                    skip -= 1;
                }
            }
        }
        sample
    }

    /// Returns the true atoms of a state under an assignment.
    fn row(&self, columns: &Columns, state: usize, assignment: u32) -> Bits {
        let mut row = bits::empty(self.atoms.len());
        for (index, atom) in self.atoms.iter().enumerate() {
            if bits::has(&columns.facts[self.fact(atom, assignment) * columns.words..], state) {
                bits::insert(&mut row, index);
            }
        }
        row
    }

    /// Returns the distinct sets of true atoms of a positive state, one for each way to name its entities. The entities
    /// of the variables that are not in the head are in ascending order: other orders give the same clauses.
    pub fn seeds(&self, state: usize) -> Vec<Bits> {
        let egos = self.vocabulary.egos();
        let exists = |entity: &u8| {
            bits::has(
                &self.positive.present[usize::from(*entity) * self.positive.words..],
                state,
            )
        };
        let mut seeds: Vec<Bits> = Vec::new();
        for (index, assignment) in self.assignments.iter().enumerate() {
            if assignment.iter().all(exists) && assignment[egos..].is_sorted_by(|a, b| a < b) {
                let row = self.row(self.positive, state, index as u32);
                if !seeds.contains(&row) {
                    seeds.push(row);
                }
            }
        }
        seeds
    }

    /// Returns the number of the fact that an atom is under an assignment.
    #[inline]
    fn fact(&self, atom: &Atom, assignment: u32) -> usize {
        let assignment = &self.assignments[assignment as usize];
        let arguments: SmallVec<[usize; ARITY_MAX]> = atom
            .arguments
            .iter()
            .map(|&variable| assignment[variable as usize].into())
            .collect();
        self.vocabulary.fact(self.entities, atom.predicate, &arguments)
    }
}
