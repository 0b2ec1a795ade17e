//! Facts about constants, indexed for joins, and the evaluation of conjunctions.

use crate::cancel::Cancel;
use crate::induce::bits::{self, Bits};
use crate::induce::vocabulary::{ARITY_MAX, Atom, Body, Link, Literal, VARIABLES_MAX, Vocabulary};
use smallvec::SmallVec;

/// The constant of each variable, [`UNBOUND`] for those without one.
pub type Binding = [u32; VARIABLES_MAX];

/// No constant.
pub const UNBOUND: u32 = u32::MAX;

/// Steps of a join between two polls for cancellation.
const POLL_STEPS: u32 = 1 << 12;

/// The facts of a predicate: rows of constants.
#[derive(Clone, Debug)]
struct Table {
    arity: usize,
    /// The rows in ascending order, one after the other.
    rows: Vec<u32>,
    /// For each argument position, the numbers of the rows by constant.
    index: Vec<Index>,
}

/// The numbers of rows, grouped by a constant.
#[derive(Clone, Debug)]
struct Index {
    /// For each constant, where its rows begin; then where the last ones end.
    begins: Vec<u32>,
    rows: Vec<u32>,
}

impl Table {
    fn new(arity: usize, rows: &[Vec<u32>], constants: usize) -> Table {
        let mut sorted: Vec<&Vec<u32>> = rows.iter().collect();
        sorted.sort_unstable();
        sorted.dedup();
        let index = (0..arity).map(|at| {
            let mut begins = vec![0; constants + 1];
            sorted.iter().for_each(|row| begins[row[at] as usize + 1] += 1);
            (0..constants).for_each(|constant| begins[constant + 1] += begins[constant]);
            let mut numbers: Vec<u32> = (0..sorted.len() as u32).collect();
            numbers.sort_by_key(|&number| sorted[number as usize][at]);
            Index { begins, rows: numbers }
        });
        Table {
            arity,
            index: index.collect(),
            rows: sorted.into_iter().flatten().copied().collect(),
        }
    }

    fn len(&self) -> usize {
        self.rows.len() / self.arity
    }

    #[inline]
    fn row(&self, number: u32) -> &[u32] {
        &self.rows[number as usize * self.arity..][..self.arity]
    }

    /// Returns the numbers of the rows with a constant at a position.
    #[inline]
    fn with(&self, at: usize, constant: u32) -> &[u32] {
        let Index { begins, rows } = &self.index[at];
        &rows[begins[constant as usize] as usize..begins[constant as usize + 1] as usize]
    }

    fn contains(&self, row: &[u32]) -> bool {
        // Rows with the same first constant are neighbors.
        let with_first = self.with(0, row[0]);
        with_first.binary_search_by(|&number| self.row(number).cmp(row)).is_ok()
    }
}

/// Facts about constants, and what they can be in clauses.
///
/// A constant has a kind. The constants at an argument position have the same kind, so a variable has one, too.
#[derive(Clone, Debug)]
pub struct Database {
    vocabulary: Vocabulary,
    tables: Vec<Table>,
    /// For each constant, its kind.
    kinds: Vec<u32>,
    /// For each predicate, the kinds of its arguments.
    argument_kinds: Vec<Vec<u32>>,
    /// For each argument of a predicate, the only variable of the head that it can be, if there is one.
    pinned: Vec<Vec<Option<u8>>>,
}

impl Database {
    /// Indexes facts.
    ///
    /// `rows` and `pinned` have an entry for each predicate of the vocabulary, which has links. `kinds` are those of the
    /// constants. `pinned` has, for each argument of a predicate, the only variable of the head that it can be, if there
    /// is one.
    ///
    /// # Panics
    /// If the vocabulary has no links, or the lists do not fit its predicates.
    pub fn new(
        vocabulary: Vocabulary,
        rows: &[Vec<Vec<u32>>],
        kinds: Vec<u32>,
        argument_kinds: Vec<Vec<u32>>,
        pinned: Vec<Vec<Option<u8>>>,
    ) -> Database {
        assert!(vocabulary.links().is_some(), "links");
        let arities: Vec<usize> = vocabulary
            .predicates()
            .iter()
            .map(|predicate| predicate.arity)
            .collect();
        let fits = |lists: &mut dyn Iterator<Item = usize>| lists.eq(arities.iter().copied());
        assert!(fits(&mut argument_kinds.iter().map(Vec::len)), "kinds of arguments");
        assert!(fits(&mut pinned.iter().map(Vec::len)), "pinned arguments");
        assert_eq!(rows.len(), arities.len(), "facts");
        let tables = rows
            .iter()
            .zip(&arities)
            .map(|(rows, &arity)| Table::new(arity, rows, kinds.len()));
        Database {
            tables: tables.collect(),
            vocabulary,
            kinds,
            argument_kinds,
            pinned,
        }
    }

    /// Returns the predicates.
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// Returns the facts of a predicate in ascending order.
    pub fn rows(&self, predicate: usize) -> impl Iterator<Item = &[u32]> {
        let table = &self.tables[predicate];
        (0..table.len() as u32).map(|number| table.row(number))
    }

    /// Returns whether a fact holds.
    pub fn holds(&self, predicate: usize, row: &[u32]) -> bool {
        self.tables[predicate].contains(row)
    }

    /// Returns the kinds of constants.
    pub(super) fn kinds_of(&self, constants: &[u32]) -> SmallVec<[u32; VARIABLES_MAX]> {
        constants
            .iter()
            .map(|&constant| self.kinds[constant as usize])
            .collect()
    }

    /// Returns the kinds of the variables of a clause; 0 for those that do not occur.
    pub(super) fn kinds_in(&self, head: &[u32], body: &Body) -> SmallVec<[u32; VARIABLES_MAX]> {
        let mut kinds = self.kinds_of(head);
        kinds.resize(body.variables(&self.vocabulary), 0);
        for atom in body.0.iter().map(|literal| &literal.atom) {
            for (&variable, &kind) in atom.arguments.iter().zip(&self.argument_kinds[atom.predicate]) {
                kinds[usize::from(variable)] = kind;
            }
        }
        kinds
    }

    /// Returns the atoms over variables of some kinds, those of the head first. Their variables are distinct.
    pub(super) fn atoms(&self, kinds: &[u32]) -> Vec<Atom> {
        let mut atoms = Vec::new();
        for (predicate, (wanted, pinned)) in self.argument_kinds.iter().zip(&self.pinned).enumerate() {
            let mut partial: Vec<SmallVec<[u8; ARITY_MAX]>> = vec![SmallVec::new()];
            for (kind, pin) in wanted.iter().zip(pinned) {
                let fits =
                    |variable: &u8| kinds[usize::from(*variable)] == *kind && pin.is_none_or(|pin| pin == *variable);
                let longer = partial.iter().flat_map(|chosen| {
                    let next = (0..kinds.len() as u8)
                        .filter(fits)
                        .filter(|variable| !chosen.contains(variable));
                    next.map(|variable| chosen.iter().copied().chain([variable]).collect())
                });
                partial = longer.collect();
            }
            atoms.extend(partial.into_iter().map(|arguments| Atom {
                predicate,
                arguments: arguments.into_iter().collect(),
            }));
        }
        atoms
    }

    /// Returns the literals that extend a clause whose variables have some kinds: their positive ones are linked to it,
    /// and have as few new variables as their arguments need, of `variables` in all. With `negation`, there are negated
    /// ones over the variables of the clause.
    pub(super) fn extensions(&self, kinds: &[u32], variables: usize, negation: bool) -> Vec<Literal> {
        let mut literals = Vec::new();
        let links = self.vocabulary.links().expect("a database has links");
        let bound = (1_u64 << kinds.len()) - 1;
        for (predicate, wanted) in self.argument_kinds.iter().enumerate() {
            // Each argument is a variable of the clause, or the next new one.
            let mut partial: Vec<SmallVec<[u8; ARITY_MAX]>> = vec![SmallVec::new()];
            for (at, kind) in wanted.iter().enumerate() {
                let pin = self.pinned[predicate][at];
                let longer = partial.iter().flat_map(|chosen| {
                    let newest = chosen
                        .iter()
                        .map(|&variable| usize::from(variable) + 1)
                        .max()
                        .unwrap_or(0);
                    let next = newest.max(kinds.len()) as u8;
                    let known = (0..kinds.len() as u8).filter(|variable| kinds[usize::from(*variable)] == *kind);
                    let new = Some(next).filter(|&next| usize::from(next) < variables);
                    let fits =
                        move |variable: &u8| !chosen.contains(variable) && pin.is_none_or(|pin| pin == *variable);
                    let all = known.chain(new).filter(fits);
                    all.map(|variable| chosen.iter().copied().chain([variable]).collect())
                });
                partial = longer.collect();
            }
            for arguments in partial {
                let atom = Atom { predicate, arguments };
                let is_known = atom
                    .arguments
                    .iter()
                    .all(|&variable| usize::from(variable) < kinds.len());
                let is_linked = match links[predicate] {
                    Link::Inputs(0) => true,
                    _ => self.vocabulary.binds(&atom, bound),
                };
                if is_linked {
                    literals.push(Literal {
                        is_negated: false,
                        atom: atom.clone(),
                    });
                }
                if negation && is_known {
                    literals.push(Literal { is_negated: true, atom });
                }
            }
        }
        literals
    }

    /// Returns whether an atom holds for a binding of all its variables.
    #[inline]
    pub(super) fn is_true(&self, atom: &Atom, binding: &Binding) -> bool {
        let row: SmallVec<[u32; ARITY_MAX]> = atom
            .arguments
            .iter()
            .map(|&variable| binding[usize::from(variable)])
            .collect();
        self.tables[atom.predicate].contains(&row)
    }

    /// Calls `each` with the rows of a predicate that a fact about the constants of a set can bind, by the links of the
    /// predicate, as long as it returns true. `head` are the constants of the head. Rows beyond `most` with the same
    /// constant at the same place are left out; returns whether there were none.
    pub(super) fn linked(
        &self,
        predicate: usize,
        head: &[u32],
        constants: &[u32],
        most: usize,
        each: &mut dyn FnMut(&[u32]),
    ) -> bool {
        let (table, kinds) = (&self.tables[predicate], &self.argument_kinds[predicate]);
        let pins = &self.pinned[predicate];
        let link = self.vocabulary.links().expect("a database has links")[predicate];
        let mut is_complete = true;
        let mut visit = |numbers: &[u32]| {
            is_complete &= numbers.len() <= most;
            for &number in numbers.iter().take(most) {
                let row = table.row(number);
                let is_pinned = pins
                    .iter()
                    .zip(row)
                    .all(|(pin, constant)| pin.is_none_or(|pin| head[usize::from(pin)] == *constant));
                let is_bound = match link {
                    Link::Any => row.iter().any(|constant| constants.contains(constant)),
                    Link::Inputs(inputs) => (row.iter().enumerate())
                        .all(|(at, constant)| inputs >> at & 1 == 0 || constants.contains(constant)),
                };
                if is_pinned && is_bound {
                    each(row);
                }
            }
        };
        // A pinned argument selects the fewest rows.
        if let Some((at, pin)) = pins.iter().enumerate().find_map(|(at, pin)| Some((at, (*pin)?))) {
            visit(table.with(at, head[usize::from(pin)]));
            return is_complete;
        }
        let at_position = |at: usize| {
            constants
                .iter()
                .filter(move |constant| self.kinds[**constant as usize] == kinds[at])
        };
        match link {
            Link::Inputs(0) => {
                let all: Vec<u32> = (0..table.len() as u32).collect();
                visit(&all);
            }
            Link::Inputs(inputs) => {
                let at = inputs.trailing_zeros() as usize;
                at_position(at).for_each(|&constant| visit(table.with(at, constant)));
            }
            Link::Any => {
                for at in 0..table.arity {
                    at_position(at).for_each(|&constant| visit(table.with(at, constant)));
                }
            }
        }
        is_complete
    }

    /// Returns the rows of an atom that agree with a binding, at most `most`. The binding has a constant for one of its
    /// variables at least.
    pub(super) fn matching(&self, atom: &Atom, binding: &Binding, most: usize) -> Vec<&[u32]> {
        let table = &self.tables[atom.predicate];
        let Some(numbers) = shortest(table, atom, binding) else {
            return Vec::new();
        };
        let rows = numbers.iter().map(|&number| table.row(number));
        rows.filter(|row| agrees(atom, row, binding)).take(most).collect()
    }

    /// Returns a binding under which literals hold that extends another one, if there is one. A literal is an atom and
    /// whether it is not negated. Positive literals bind all variables.
    pub(super) fn witness(&self, literals: &[(&Atom, bool)], binding: &Binding, cancel: &Cancel) -> Option<Binding> {
        let mut join = Join {
            database: self,
            literals,
            binding: *binding,
            steps: 0,
            cancel,
        };
        join.holds(bits::full(literals.len())).then_some(join.binding)
    }

    /// Returns the binding of the variables of a head.
    pub(super) fn bound(head: &[u32]) -> Binding {
        let mut binding = [UNBOUND; VARIABLES_MAX];
        binding[..head.len()].copy_from_slice(head);
        binding
    }
}

/// Returns the rows of the constant that selects the fewest; `None` if no argument is bound.
#[inline]
fn shortest<'a>(table: &'a Table, atom: &Atom, binding: &Binding) -> Option<&'a [u32]> {
    let bound = atom.arguments.iter().enumerate().filter_map(|(at, &variable)| {
        let constant = binding[usize::from(variable)];
        (constant != UNBOUND).then(|| table.with(at, constant))
    });
    bound.min_by_key(|rows| rows.len())
}

#[inline]
fn agrees(atom: &Atom, row: &[u32], binding: &Binding) -> bool {
    (atom.arguments.iter().zip(row)).all(|(&variable, &constant)| {
        let own = binding[usize::from(variable)];
        own == UNBOUND || own == constant
    })
}

/// A search for a binding: it always takes the literal with the fewest rows.
struct Join<'a> {
    database: &'a Database,
    literals: &'a [(&'a Atom, bool)],
    binding: Binding,
    steps: u32,
    cancel: &'a Cancel,
}

impl Join<'_> {
    /// Returns whether the literals of a set hold for an extension of the binding, which then is in `binding`.
    fn holds(&mut self, mut left: Bits) -> bool {
        self.steps = self.steps.wrapping_add(1);
        if self.steps.is_multiple_of(POLL_STEPS) && self.cancel.requested() {
            return false;
        }
        let (database, literals) = (self.database, self.literals);
        let mut best: Option<(usize, &[u32])> = None;
        for (at, &(atom, is_positive)) in literals.iter().enumerate() {
            if !bits::contains(&left, at) {
                continue;
            }
            if atom
                .arguments
                .iter()
                .all(|&variable| self.binding[usize::from(variable)] != UNBOUND)
            {
                if database.is_true(atom, &self.binding) != is_positive {
                    return false;
                }
                bits::remove(&mut left, at);
            } else if is_positive
                && let Some(rows) = shortest(&database.tables[atom.predicate], atom, &self.binding)
                && best.is_none_or(|(_, least)| rows.len() < least.len())
            {
                best = Some((at, rows));
            }
        }
        if bits::count(&left) == 0 {
            return true;
        }
        let all: Vec<u32>;
        let (at, rows) = match best {
            Some(best) => best,
            // No variable of the positive literals left is bound, as with a predicate that binds from nothing.
            None => {
                let Some(at) = bits::elements(&left).find(|&at| literals[at].1) else {
                    return false;
                };
                all = (0..database.tables[literals[at].0.predicate].len() as u32).collect();
                (at, all.as_slice())
            }
        };
        let atom = literals[at].0;
        bits::remove(&mut left, at);
        let before = self.binding;
        for &number in rows {
            let row = database.tables[atom.predicate].row(number);
            if agrees(atom, row, &before) {
                for (&variable, &constant) in atom.arguments.iter().zip(row) {
                    self.binding[usize::from(variable)] = constant;
                }
                if self.holds(left.clone()) {
                    return true;
                }
                self.binding = before;
            }
        }
        false
    }
}
