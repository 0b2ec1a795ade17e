//! The predicates of a learning task, and the atoms that clauses are made of.

use smallvec::SmallVec;

/// The maximum number of arguments of a predicate.
pub const ARITY_MAX: usize = 6;

/// The maximum number of variables of a clause.
pub const VARIABLES_MAX: usize = 7;

/// The names of the variables of clauses, those of the head first.
pub const VARIABLE_NAMES: [&str; VARIABLES_MAX] = ["X", "Y", "Z", "V", "W", "U", "T"];

/// A predicate that states and clauses use.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Predicate {
    /// The name.
    pub name: String,
    /// Number of arguments, 1 to [`ARITY_MAX`].
    pub arity: usize,
    /// Whether it is binary and holds in both directions or in none.
    pub is_symmetric: bool,
}

/// How a positive literal of a predicate binds the variables of a clause, in a vocabulary with links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// As soon as one of its variables is bound, it binds the others.
    Any,
    /// It binds its variables as soon as those in these argument positions are bound. The lowest bit stands for the
    /// first argument.
    Inputs(u8),
}

/// The predicates of a learning task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    predicates: Vec<Predicate>,
    /// For each predicate and arity, the number of predicates before it that have this arity.
    before: Vec<[usize; ARITY_MAX]>,
    /// By arity, the number of predicates.
    total: [usize; ARITY_MAX],
    /// The largest arity.
    widest: usize,
    egos: usize,
    guard: Option<String>,
    links: Option<Vec<Link>>,
}

impl Vocabulary {
    /// Creates a vocabulary. Clauses have `egos` variables in their head: the first entities of a state. `guard` is a
    /// predicate that holds between the ego and every entity of a state. It binds variables that no other positive
    /// literal binds; without it, the learner finds only clauses whose positive literals bind every variable.
    ///
    /// # Panics
    /// If an arity is 0 or exceeds [`ARITY_MAX`], or there is no ego, or more than [`VARIABLES_MAX`].
    pub fn new(predicates: Vec<Predicate>, egos: usize, guard: Option<String>) -> Vocabulary {
        assert!((1..=VARIABLES_MAX).contains(&egos), "{egos} variables in the head");
        let mut total = [0; ARITY_MAX];
        let before = (predicates.iter())
            .map(|predicate| {
                let before = total;
                assert!(
                    (1..=ARITY_MAX).contains(&predicate.arity),
                    "arity of {}",
                    predicate.name
                );
                total[predicate.arity - 1] += 1;
                before
            })
            .collect();
        Vocabulary {
            widest: predicates.iter().map(|predicate| predicate.arity).max().unwrap_or(0),
            predicates,
            before,
            total,
            egos,
            guard,
            links: None,
        }
    }

    /// Requires that positive literals link every variable of a clause to its head: the variables of the head are
    /// bound, and literals bind further ones as their predicates' links say.
    ///
    /// # Panics
    /// If there is not one link per predicate, or the vocabulary has a guard.
    pub fn linked(mut self, links: Vec<Link>) -> Vocabulary {
        assert_eq!(links.len(), self.predicates.len(), "links");
        assert!(self.guard.is_none(), "a guard binds every variable");
        self.links = Some(links);
        self
    }

    /// Returns how literals bind variables, for each predicate.
    pub fn links(&self) -> Option<&[Link]> {
        self.links.as_deref()
    }

    /// Returns whether a literal binds its variables if those in the set `bound` are bound.
    pub(crate) fn binds(&self, atom: &Atom, bound: u64) -> bool {
        let is_bound = |variable: &u8| bound >> variable & 1 == 1;
        match self.links.as_ref().map(|links| links[atom.predicate]) {
            None => true,
            Some(Link::Any) => atom.arguments.iter().any(is_bound),
            Some(Link::Inputs(inputs)) => {
                (atom.arguments.iter().enumerate()).all(|(at, variable)| inputs >> at & 1 == 0 || is_bound(variable))
            }
        }
    }

    /// Returns the set of variables that a conjunction of positive literals binds. With links, the variables of the
    /// head are part of it.
    pub(crate) fn bound<'a>(&self, positive: impl Iterator<Item = &'a Atom> + Clone) -> u64 {
        let mut bound = if self.links.is_some() { (1 << self.egos) - 1 } else { 0 };
        loop {
            let mut more = bound;
            for atom in positive.clone().filter(|atom| self.binds(atom, bound)) {
                atom.arguments.iter().for_each(|variable| more |= 1 << variable);
            }
            if more == bound {
                return bound;
            }
            bound = more;
        }
    }

    /// Returns the predicates.
    pub fn predicates(&self) -> &[Predicate] {
        &self.predicates
    }

    /// Returns the number of variables in the head of a clause.
    pub fn egos(&self) -> usize {
        self.egos
    }

    /// Returns the predicate that holds between the ego and every entity.
    pub fn guard(&self) -> Option<&str> {
        self.guard.as_deref()
    }

    /// Returns the number of possible facts about `entities` entities.
    pub fn facts(&self, entities: usize) -> usize {
        self.sum(&self.total, entities)
    }

    /// Returns the number of a fact among all possible facts about `entities` entities: predicate by predicate, the
    /// last argument changes fastest.
    #[inline]
    pub fn fact(&self, entities: usize, predicate: usize, arguments: &[usize]) -> usize {
        let index = arguments.iter().fold(0, |index, argument| index * entities + argument);
        self.sum(&self.before[predicate], entities) + index
    }

    fn sum(&self, counts: &[usize; ARITY_MAX], entities: usize) -> usize {
        counts[..self.widest]
            .iter()
            .rev()
            .fold(0, |sum, count| (sum + count) * entities)
    }

    /// Returns all atoms over variables, each with distinct variables. An atom of a symmetric predicate occurs once.
    pub fn atoms(&self, variables: usize) -> Vec<Atom> {
        let mut atoms = Vec::new();
        for (index, predicate) in self.predicates.iter().enumerate() {
            for tuple in tuples(predicate.arity, variables) {
                let arguments: SmallVec<[u8; ARITY_MAX]> = tuple.iter().map(|&variable| variable as u8).collect();
                let is_distinct = (1..arguments.len()).all(|at| !arguments[..at].contains(&arguments[at]));
                let is_mirrored = predicate.is_symmetric && arguments.len() == 2 && arguments[0] > arguments[1];
                if is_distinct && !is_mirrored {
                    atoms.push(Atom {
                        predicate: index,
                        arguments,
                    });
                }
            }
        }
        atoms
    }
}

/// A predicate applied to variables. The variables of the head come first.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Atom {
    /// Position of the predicate in the vocabulary.
    pub predicate: usize,
    /// The variables.
    pub arguments: SmallVec<[u8; ARITY_MAX]>,
}

/// The arguments of a fact: entities.
pub(crate) type Tuple = SmallVec<[usize; ARITY_MAX]>;

/// An assignment of entities to the variables of a clause.
pub(crate) type Assignment = SmallVec<[u8; VARIABLES_MAX]>;

impl Atom {
    /// Returns the arguments under an assignment of entities to variables.
    #[inline]
    pub(crate) fn under(&self, assignment: &[u8]) -> Tuple {
        let arguments = self.arguments.iter();
        arguments
            .map(|&variable| assignment[usize::from(variable)].into())
            .collect()
    }

    /// Returns the arguments if each variable stands for the entity of its number.
    pub(crate) fn own(&self) -> Tuple {
        self.arguments.iter().map(|&variable| variable.into()).collect()
    }
}

/// An atom or its negation.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Literal {
    /// Whether the atom is negated. Positive literals come first in the order.
    pub is_negated: bool,
    /// The atom.
    pub atom: Atom,
}

/// The cost of a positive literal with one variable. It equals that of a clause.
pub const LITERAL_COST: u32 = 16;
/// What each further variable of a literal costs.
pub const ARGUMENT_COST: u32 = 2;
/// What a negation costs.
pub const NEGATION_COST: u32 = 1;
/// The cost of each variable of a clause that is not in its head, except the first one.
pub const VARIABLE_COST: u32 = 32;

/// Returns the cost of a conjunction: atoms, and whether they are negated. The variables below `egos` are in the head.
pub fn cost<'a>(literals: impl Iterator<Item = (&'a Atom, bool)>, egos: usize) -> u32 {
    let (mut used, mut cost) = (0_u32, 0);
    for (atom, is_negated) in literals {
        cost += LITERAL_COST + (atom.arguments.len() as u32 - 1) * ARGUMENT_COST;
        cost += u32::from(is_negated) * NEGATION_COST;
        atom.arguments.iter().for_each(|variable| used |= 1 << variable);
    }
    cost + (used >> egos).count_ones().saturating_sub(1) * VARIABLE_COST
}

/// A conjunction of literals.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Body(pub Vec<Literal>);

impl Body {
    /// Creates a body from literals in any order. Renames the variables that are not in the head so that clauses that
    /// differ in their names become equal, and leaves out the numbers of those that do not occur.
    pub fn normalized(literals: Vec<Literal>, vocabulary: &Vocabulary) -> Body {
        let egos = vocabulary.egos() as u8;
        let mut used: Vec<u8> = (literals.iter().flat_map(|literal| &literal.atom.arguments).copied())
            .filter(|&variable| variable >= egos)
            .collect();
        used.sort_unstable();
        used.dedup();
        let named = |names: &[u8]| {
            let mut body: Vec<Literal> = literals.clone();
            for argument in body.iter_mut().flat_map(|literal| &mut literal.atom.arguments) {
                if let Some(at) = names.iter().position(|name| name == argument) {
                    *argument = egos + at as u8;
                }
            }
            for literal in &mut body {
                let predicate = &vocabulary.predicates[literal.atom.predicate];
                if predicate.is_symmetric && predicate.arity == 2 {
                    literal.atom.arguments.sort_unstable();
                }
            }
            body.sort_unstable();
            Body(body)
        };
        permutations(&used)
            .iter()
            .map(|names| named(names))
            .min()
            .unwrap_or_default()
    }

    /// Returns the cost of the literals and variables.
    pub fn cost(&self, vocabulary: &Vocabulary) -> u32 {
        cost(
            self.0.iter().map(|literal| (&literal.atom, literal.is_negated)),
            vocabulary.egos,
        )
    }

    /// Returns the number of variables: one more than the largest that occurs, at least the number in the head.
    pub fn variables(&self, vocabulary: &Vocabulary) -> usize {
        let used = self.0.iter().flat_map(|literal| &literal.atom.arguments).copied().max();
        used.map_or(0, |variable| variable as usize + 1).max(vocabulary.egos)
    }

    /// Returns the literals as text, with the guards of variables that no positive literal binds.
    pub fn texts(&self, vocabulary: &Vocabulary) -> Vec<String> {
        let mut texts: Vec<String> = self.0.iter().map(|literal| literal.text(vocabulary)).collect();
        if let Some(guard) = &vocabulary.guard {
            let free = (0..self.variables(vocabulary)).filter(|&variable| !self.binds(variable));
            let used = free.filter(|&variable| variable < vocabulary.egos || self.uses(variable));
            let positive = self.0.iter().filter(|literal| !literal.is_negated).count();
            let guards = used.map(|variable| format!("{guard}({}, {})", VARIABLE_NAMES[0], VARIABLE_NAMES[variable]));
            texts.splice(positive..positive, guards.collect::<Vec<_>>());
        }
        texts
    }

    /// Returns whether a guard, or positive literals, bind all variables of the body and of the head. With links, the
    /// literals must be linked to the head.
    pub fn is_safe(&self, vocabulary: &Vocabulary) -> bool {
        let variables = |literals: &mut dyn Iterator<Item = &Literal>| {
            let arguments = literals.flat_map(|literal| &literal.atom.arguments);
            arguments.fold(0_u64, |set, variable| set | 1 << variable)
        };
        let positive = self.0.iter().filter(|literal| !literal.is_negated);
        let heads = (1 << vocabulary.egos) - 1;
        let missing = heads & !variables(&mut positive.clone());
        let unbound = variables(&mut self.0.iter()) & !vocabulary.bound(positive.map(|literal| &literal.atom));
        vocabulary.guard.is_some() || missing | unbound == 0
    }

    /// Returns whether a positive literal contains a variable.
    pub fn binds(&self, variable: usize) -> bool {
        (self.0.iter()).any(|literal| !literal.is_negated && literal.atom.arguments.contains(&(variable as u8)))
    }

    fn uses(&self, variable: usize) -> bool {
        (self.0.iter()).any(|literal| literal.atom.arguments.contains(&(variable as u8)))
    }
}

impl Literal {
    /// Returns the literal as text.
    pub fn text(&self, vocabulary: &Vocabulary) -> String {
        let predicate = &vocabulary.predicates[self.atom.predicate];
        let arguments: Vec<&str> = self
            .atom
            .arguments
            .iter()
            .map(|&variable| VARIABLE_NAMES[variable as usize])
            .collect();
        let atom = format!("{}({})", predicate.name, arguments.join(", "));
        if self.is_negated { format!("Not({atom})") } else { atom }
    }
}

/// Returns all orders of some elements.
pub(crate) fn permutations<T: Copy>(elements: &[T]) -> Vec<Vec<T>> {
    let mut all = vec![Vec::new()];
    for &element in elements {
        all = (all.iter())
            .flat_map(|order: &Vec<T>| {
                (0..=order.len()).map(move |at| {
                    let mut longer = order.clone();
                    longer.insert(at, element);
                    longer
                })
            })
            .collect();
    }
    all
}

/// Returns all lists of `arity` entities; the last one changes fastest.
pub fn tuples(arity: usize, entities: usize) -> impl Iterator<Item = Tuple> {
    (0..entities.pow(arity as u32)).map(move |number| {
        let mut tuple: Tuple = SmallVec::from_elem(0, arity);
        let mut rest = number;
        for entity in tuple.iter_mut().rev() {
            (*entity, rest) = (rest % entities, rest / entities);
        }
        tuple
    })
}

/// Returns all assignments of entities to variables. The variables of the head have fixed entities; of the others, the
/// first changes fastest.
pub(crate) fn assignments(egos: usize, variables: usize, entities: usize) -> impl Iterator<Item = Assignment> {
    let free = (variables - egos) as u32;
    (0..entities.pow(free)).map(move |number| {
        let mut rest = number;
        let mut assignment: Assignment = (0..egos as u8).collect();
        for _ in 0..free {
            assignment.push((rest % entities) as u8);
            rest /= entities;
        }
        assignment
    })
}
