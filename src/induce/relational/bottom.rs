//! Clauses of one positive example: what is true of some of its constants.
//!
//! A *choice* of constants beside those of the example gives each variable of a clause a constant. The literals that
//! then hold are the *bottom* of the choice: a clause for the example is a subset of them. The choices are those whose
//! constants facts link to the example.

use crate::induce::bits::{self, Bits};
use crate::induce::relational::database::{Binding, Database, UNBOUND};
use crate::induce::vocabulary::{Atom, VARIABLES_MAX};
use smallvec::SmallVec;
use std::collections::BTreeSet;

/// The constants of the variables that are not in the head, in ascending order.
pub type Choice = SmallVec<[u32; VARIABLES_MAX]>;

/// The maximum number of facts with the same constant at the same place that a choice follows.
const FACTS_MAX: usize = 1024;

/// The maximum number of choices of one number of constants.
const CHOICES_MAX: usize = 4096;

/// The choices of an example by number of constants, made step by step.
pub struct Choices<'a> {
    database: &'a Database,
    head: &'a [u32],
    most: usize,
    /// Whether variables may have the constant of another one.
    repeats: bool,
    /// For each number of constants, the choices, in the order in which they were found.
    by_size: Vec<(Vec<Choice>, BTreeSet<Choice>)>,
    /// Whether no choice was left out.
    pub is_complete: bool,
}

impl<'a> Choices<'a> {
    /// Prepares the choices of at most `most` constants.
    pub fn new(database: &'a Database, head: &'a [u32], most: usize, repeats: bool) -> Choices<'a> {
        let mut by_size = vec![(Vec::new(), BTreeSet::new()); most + 1];
        by_size[0].0.push(Choice::new());
        Choices {
            database,
            head,
            most,
            repeats,
            by_size,
            is_complete: true,
        }
    }

    /// Returns the choices of a number of constants. The smaller numbers must have been asked for.
    pub fn of_size(&mut self, size: usize) -> &[Choice] {
        if size > 0 && size <= self.most {
            self.extend(size - 1);
        }
        &self.by_size[size.min(self.most)].0
    }

    /// Extends all choices of a size by each fact that is linked to them.
    fn extend(&mut self, size: usize) {
        let (database, head) = (self.database, self.head);
        for at in 0..self.by_size[size].0.len() {
            let choice = self.by_size[size].0[at].clone();
            let constants: Choice = head.iter().chain(&choice).copied().collect();
            let room = self.most - size;
            let mut found: BTreeSet<Choice> = BTreeSet::new();
            for predicate in 0..database.vocabulary().predicates().len() {
                self.is_complete &= database.linked(predicate, head, &constants, FACTS_MAX, &mut |row| {
                    self.repeats.then(|| repeated(row, &constants, room, &mut found));
                    let mut more = Choice::new();
                    for constant in row.iter().filter(|constant| !constants.contains(constant)) {
                        if !more.contains(constant) {
                            more.push(*constant);
                        }
                    }
                    if !more.is_empty() && more.len() <= room {
                        found.insert(more);
                    }
                });
            }
            for more in found {
                let mut longer: Choice = choice.iter().chain(&more).copied().collect();
                longer.sort_unstable();
                let (listed, known) = &mut self.by_size[longer.len()];
                if listed.len() >= CHOICES_MAX {
                    self.is_complete = false;
                } else if known.insert(longer.clone()) {
                    listed.push(longer);
                }
            }
        }
    }
}

/// Adds the constants of a fact that new variables could have, if some of them may have the constant of another one.
fn repeated(row: &[u32], constants: &[u32], room: usize, found: &mut BTreeSet<Choice>) {
    for subset in 1_u32..1 << row.len() {
        let is_new = |at: usize| subset >> at & 1 == 1;
        let others_are_known = row
            .iter()
            .enumerate()
            .all(|(at, constant)| is_new(at) || constants.contains(constant));
        let more: Choice = (row.iter().enumerate())
            .filter(|(at, _)| is_new(*at))
            .map(|(_, constant)| *constant)
            .collect();
        if others_are_known && more.len() <= room {
            found.insert(more);
        }
    }
}

/// The literals that hold for a choice.
pub struct Bottom {
    /// The atoms. With negation, those that do not hold are part of them.
    pub atoms: Vec<Atom>,
    /// The atoms that hold.
    pub seed: Bits,
}

impl Bottom {
    /// Returns the literals that hold for a choice. `atoms` are those over variables of its kinds.
    pub fn new(database: &Database, atoms: &[Atom], head: &[u32], choice: &Choice, negation: bool) -> Bottom {
        let mut binding = Database::bound(head);
        binding[head.len()..head.len() + choice.len()].copy_from_slice(choice);
        let holds: Vec<bool> = atoms.iter().map(|atom| database.is_true(atom, &binding)).collect();
        let kept: Vec<(&Atom, bool)> = atoms
            .iter()
            .zip(holds)
            .filter(|(_, holds)| *holds || negation)
            .collect();
        let mut seed = bits::empty(kept.len());
        for (at, _) in kept.iter().enumerate().filter(|(_, (_, holds))| *holds) {
            bits::insert(&mut seed, at);
        }
        Bottom {
            atoms: kept.into_iter().map(|(atom, _)| atom.clone()).collect(),
            seed,
        }
    }

    /// Returns the literals of a set, as [`Database::witness`] takes them.
    pub fn literals(&self, chosen: &[u64]) -> SmallVec<[(&Atom, bool); 16]> {
        bits::elements(chosen)
            .map(|at| (&self.atoms[at], bits::contains(&self.seed, at)))
            .collect()
    }

    /// Returns the literals that are false for a row: a binding of some variables, extended so that many atoms hold. A
    /// clause that holds in no such row has one of them.
    pub fn false_in(&self, database: &Database, binding: &Binding) -> Bits {
        let mut binding = *binding;
        self.extend(database, &mut binding);
        let mut differ = bits::empty(self.atoms.len());
        for (at, atom) in self.atoms.iter().enumerate() {
            let is_bound = atom
                .arguments
                .iter()
                .all(|&variable| binding[usize::from(variable)] != UNBOUND);
            // A literal with an unbound variable needs another one that binds it, which is false.
            if !is_bound || database.is_true(atom, &binding) != bits::contains(&self.seed, at) {
                bits::insert(&mut differ, at);
            }
        }
        differ
    }

    /// Binds further variables as long as a positive literal permits it. Of the rows of a literal, it takes the one with
    /// which the most literals hold.
    fn extend(&self, database: &Database, binding: &mut Binding) {
        let is_bound = |binding: &Binding, variable: u8| binding[usize::from(variable)] != UNBOUND;
        loop {
            let mut best: Option<(usize, Binding)> = None;
            for atom in bits::elements(&self.seed).map(|at| &self.atoms[at]) {
                let free = atom
                    .arguments
                    .iter()
                    .filter(|&&variable| !is_bound(binding, variable))
                    .count();
                if free == 0 || free == atom.arguments.len() {
                    continue;
                }
                for row in database.matching(atom, binding, ROWS_MAX) {
                    let mut extended = *binding;
                    for (&variable, &constant) in atom.arguments.iter().zip(row) {
                        extended[usize::from(variable)] = constant;
                    }
                    let holding = (self.atoms.iter().enumerate())
                        .filter(|(_, atom)| atom.arguments.iter().all(|&variable| is_bound(&extended, variable)))
                        .filter(|(at, atom)| database.is_true(atom, &extended) == bits::contains(&self.seed, *at))
                        .count();
                    if best.as_ref().is_none_or(|(most, _)| holding > *most) {
                        best = Some((holding, extended));
                    }
                }
            }
            match best {
                Some((_, extended)) => *binding = extended,
                None => return,
            }
        }
    }
}

/// The rows of a literal that an extension of a row compares.
const ROWS_MAX: usize = 4;
