//! Facts stored as bits.

use crate::check::PredicateId;
use crate::dense::program::{Argument, Dense, Input, List, Reg};
use crate::dense::run::BitState;
use crate::dense::search::BinaryFacts;
use crate::dense::sets::{Set, and, is_empty};

/// The facts of all predicates that a program reads, stored as bits.
#[derive(Clone, Debug)]
pub struct BitFacts<const W: usize> {
    count: usize,
    inputs: Vec<Set<W>>,
    /// For each list, one block per word of a set: the rows of the entities whose bits are in that word.
    lists: Vec<[Set<W>; 64]>,
    /// For each list, the entities whose rows are not empty.
    related: Vec<Set<W>>,
}

impl<const W: usize> BitFacts<W> {
    /// Makes an empty set of facts about `count` entities.
    pub fn new(program: &Dense, count: usize) -> Self {
        BitFacts {
            count,
            inputs: vec![[0; W]; program.inputs().len()],
            lists: vec![[[0; W]; 64]; program.lists().len() * W],
            related: vec![[0; W]; program.lists().len()],
        }
    }

    /// Adds a fact: its predicate and the positions of its entities. Ignores predicates that the program does not read.
    ///
    /// # Panics
    /// If a position is not less than the number of entities.
    pub fn insert(&mut self, program: &Dense, predicate: PredicateId, row: &[usize]) {
        assert!(row.iter().all(|&entity| entity < self.count), "unknown entity");
        for (&input, set) in program.inputs().iter().zip(&mut self.inputs) {
            let holds = match (input, row) {
                (Input::Unary(read), [_]) => read == predicate,
                (Input::Diagonal(read), [x, y]) => read == predicate && x == y,
                _ => false,
            };
            if holds {
                set[row[0] / 64] |= 1 << (row[0] % 64);
            }
        }
        if let &[x, y] = row {
            for (position, list) in program.lists().iter().enumerate() {
                let (at, member) = match *list {
                    List(read, Argument::Second) if read == predicate => (x, y),
                    List(read, Argument::First) if read == predicate => (y, x),
                    List(..) => continue,
                };
                self.lists[position * W + at / 64][at % 64][member / 64] |= 1 << (member % 64);
                self.related[position][at / 64] |= 1 << (at % 64);
            }
        }
    }

    /// Writes the inputs of a state with the same number of entities.
    ///
    /// # Panics
    /// If the state has another number of entities.
    #[inline]
    pub fn load(&self, program: &Dense, bit_state: &mut BitState<W>) {
        assert_eq!(self.count, bit_state.count);
        let (restless, steady) = self.inputs.split_at(program.restless);
        let (into, steady_into) = (bit_state.sets[Reg::INPUTS.index()..]).split_at_mut(program.restless);
        for (into, set) in into.iter_mut().zip(restless) {
            *into = *set;
        }
        let steady_into = &mut steady_into[..steady.len()];
        if steady_into != steady {
            steady_into.copy_from_slice(steady);
            bit_state.unsettled = true;
        }
    }
}

impl<const W: usize> BinaryFacts<W> for BitFacts<W> {
    #[inline(always)]
    fn narrow(&self, list: usize, at: usize, among: Set<W>) -> Set<W> {
        and(among, &self.lists[list * W + at / 64][at % 64])
    }

    // The compiler would call it otherwise, which costs an evaluation of 18 agents a tenth of its time.
    #[inline(always)]
    fn any<const N: usize>(&self, lists: [usize; N], demand: Set<W>, among: Set<W>) -> Set<W> {
        let demand = lists
            .iter()
            .fold(demand, |demand, &list| and(demand, &self.related[list]));
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

/// Returns the members for which `holds` is true.
#[inline(always)]
fn of(members: u64, holds: impl Fn(usize) -> bool) -> u64 {
    let mut found = 0;
    let mut rest = members;
    while rest != 0 {
        let at = rest.trailing_zeros() as usize & 63;
        // Branch-free, since the result is hard to predict.
        found |= u64::from(holds(at)) << at;
        rest &= rest - 1;
    }
    found
}
