//! The examples of one action as columns of bits, and the rows in which a clause holds.
//!
//! A column holds, for one fact about numbered entities, the states in which it is true. An *assignment* gives an
//! entity to each variable of a clause, so it turns the atoms of the clause into facts. The conjunction of their
//! columns are the states in which the clause holds under the assignment.

use crate::cancel::Cancel;
use crate::induce::bits::{self, Bits};
use crate::induce::examples::State;
use crate::induce::vocabulary::{Assignment, Atom, Body, Vocabulary, assignments, cost, tuples};

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
        let facts = tuples(predicate.arity, own);
        places.extend(facts.map(|arguments| vocabulary.fact(entities, index, &arguments) as u32));
    }
    places
}

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
    /// Whether clauses may contain negative literals.
    pub negation: bool,
    /// After cancellation, rows are incomplete.
    pub cancel: &'a Cancel,
    entities: usize,
    assignments: Vec<Assignment>,
}

/// The most assignments of entities to the variables of a problem. They have 64 entities and three variables beside that
/// of the head.
const ASSIGNMENTS_MAX: usize = 1 << 18;
/// The most 64-bit words of all rows of a problem: 256 MiB.
const WORDS_MAX: usize = 1 << 25;

/// The columns of the positive and the negative states of an action.
pub struct LabeledColumns {
    positive: Columns,
    negative: Columns,
    entities: usize,
}

impl LabeledColumns {
    /// Transposes states.
    pub fn new(vocabulary: &Vocabulary, positive: &[&State], negative: &[&State]) -> LabeledColumns {
        let entities = positive.iter().chain(negative).map(|state| state.entities()).max();
        let entities = entities.unwrap_or(vocabulary.egos());
        LabeledColumns {
            positive: Columns::new(vocabulary, positive, entities),
            negative: Columns::new(vocabulary, negative, entities),
            entities,
        }
    }

    /// Transposes some of the positive states.
    pub fn columns(&self, vocabulary: &Vocabulary, states: &[&State]) -> Columns {
        Columns::new(vocabulary, states, self.entities)
    }

    /// Returns the problem of finding clauses over a number of variables. `None` if there are too many assignments of
    /// entities to variables for the memory.
    pub fn problem<'a>(
        &'a self,
        vocabulary: &'a Vocabulary,
        variables: usize,
        negation: bool,
        cancel: &'a Cancel,
    ) -> Option<Problem<'a>> {
        let free = (variables - vocabulary.egos()) as u32;
        let count = self.entities.checked_pow(free)?;
        if count > ASSIGNMENTS_MAX || count * (self.positive.words + self.negative.words) > WORDS_MAX {
            return None;
        }
        Some(Problem {
            atoms: vocabulary.atoms(variables),
            vocabulary,
            positive: &self.positive,
            negative: &self.negative,
            negation,
            cancel,
            entities: self.entities,
            assignments: assignments(vocabulary.egos(), variables, self.entities).collect(),
        })
    }
}

/// The positive states that a search counts.
pub struct Open<'a> {
    /// Their facts.
    pub columns: &'a Columns,
    /// Their rows in which clauses of the problem can hold.
    pub rows: Rows,
}

impl Problem<'_> {
    /// Returns the states that a search counts. [`LabeledColumns::columns`] makes the columns.
    pub fn open<'b>(&self, columns: &'b Columns) -> Open<'b> {
        Open {
            columns,
            rows: self.all(columns),
        }
    }

    /// Returns all rows of a list of states in which clauses can hold: the assignments whose entities exist.
    pub fn all(&self, columns: &Columns) -> Rows {
        let mut rows = Rows::default();
        for (index, assignment) in self.assignments.iter().enumerate() {
            let begin = rows.states.len();
            rows.states.resize(begin + columns.words, u64::MAX);
            let mut seen = 0_u64;
            for &entity in assignment {
                if seen >> entity & 1 == 1 {
                    continue;
                }
                seen |= 1 << entity;
                let present = &columns.present[usize::from(entity) * columns.words..];
                (rows.states[begin..].iter_mut().zip(present)).for_each(|(word, present)| *word &= present);
            }
            if rows.states[begin..].iter().any(|word| *word != 0) {
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
        let literals = bits::elements(chosen).map(|literal| (&self.atoms[literal], !bits::contains(seed, literal)));
        cost(literals, self.vocabulary.egos())
    }

    /// Returns whether the positive literals of a conjunction, or a guard, bind all its variables. `seed` has those of
    /// its atoms that are not negated.
    pub fn binds_all(&self, chosen: &[u64], seed: &[u64]) -> bool {
        self.binders(chosen, &bits::empty(self.atoms.len()), seed).is_none()
    }

    /// Returns `None` if positive literals bind all variables that must be bound. Otherwise returns the literals that
    /// bind a further one, of which every extension of the clause without a banned literal has one.
    pub fn binders(&self, chosen: &[u64], banned: &[u64], seed: &[u64]) -> Option<Bits> {
        if self.vocabulary.guard().is_some() {
            return None;
        }
        let (atoms, vocabulary) = (&self.atoms, self.vocabulary);
        let positive = bits::elements(chosen).filter(|&literal| bits::contains(seed, literal));
        let positive: Vec<&Atom> = positive.map(|literal| &atoms[literal]).collect();
        let set = |atom: &Atom| atom.arguments.iter().fold(0_u64, |set, variable| set | 1 << variable);
        let heads = (1_u64 << vocabulary.egos()) - 1;
        let occurring = positive.iter().fold(0, |occurring, atom| occurring | set(atom));
        let used = bits::elements(chosen).fold(heads, |used, literal| used | set(&atoms[literal]));
        let bound = vocabulary.bound(positive.iter().copied());
        // A variable of the head is bound, but the clause is safe only if it occurs in the body.
        let missing = heads & !occurring;
        let unbound = used & !bound;
        let wanted = if missing != 0 { missing } else { unbound };
        if wanted == 0 {
            return None;
        }
        let first = wanted & wanted.wrapping_neg();
        let mut binders = bits::empty(atoms.len());
        for literal in bits::elements(seed) {
            if !bits::contains(banned, literal) && set(&atoms[literal]) & first != 0 {
                bits::insert(&mut binders, literal);
            }
        }
        Some(binders)
    }

    /// Returns the rows in which a conjunction holds. `seed` has those of its atoms that are not negated.
    pub fn holds(&self, columns: &Columns, chosen: &[u64], seed: &[u64]) -> Rows {
        let literals = bits::elements(chosen).map(|literal| (&self.atoms[literal], bits::contains(seed, literal)));
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
        for (atom, is_true) in literals.take_while(|_| !self.cancel.requested()) {
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
            if bits::contains(&columns.facts[self.fact(atom, assignment) * columns.words..], state) {
                bits::insert(&mut row, index);
            }
        }
        row
    }

    /// Returns the distinct [`Problem::seeds`] of some positive states.
    pub fn all_seeds(&self, states: &[usize]) -> Vec<Bits> {
        let mut seeds: Vec<Bits> = states.iter().flat_map(|&state| self.seeds(state)).collect();
        seeds.sort_unstable();
        seeds.dedup();
        seeds
    }

    /// Returns the distinct sets of true atoms of a positive state, one for each way to name its entities. The entities
    /// of the variables that are not in the head are in ascending order: other orders give the same clauses.
    pub fn seeds(&self, state: usize) -> Vec<Bits> {
        let egos = self.vocabulary.egos();
        let exists = |entity: &u8| {
            bits::contains(
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
        let arguments = atom.under(&self.assignments[assignment as usize]);
        self.vocabulary.fact(self.entities, atom.predicate, &arguments)
    }
}
