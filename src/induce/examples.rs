//! Labeled states: what an ego sees, and the action it takes.

use crate::induce::bits::{self, Bits};
use crate::induce::vocabulary::{ARITY_MAX, Assignment, Body, Literal, Vocabulary, tuples};
use indexmap::IndexMap;
use indexmap::map::Entry;

/// The maximum number of entities of a state.
pub const ENTITIES_MAX: usize = 64;

/// A state: facts about entities, the egos first.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct State {
    entities: u8,
    /// A bit for each possible fact.
    facts: Bits,
}

impl State {
    /// Returns a state without facts.
    ///
    /// # Panics
    /// If there are fewer entities than egos or more than [`ENTITIES_MAX`].
    pub fn new(vocabulary: &Vocabulary, entities: usize) -> State {
        assert!(
            (vocabulary.egos()..=ENTITIES_MAX).contains(&entities),
            "{entities} entities"
        );
        State {
            entities: entities as u8,
            facts: bits::empty(vocabulary.facts(entities)),
        }
    }

    /// Returns the state with these facts.
    pub(crate) fn from_facts(entities: usize, facts: Bits) -> State {
        State {
            entities: entities as u8,
            facts,
        }
    }

    /// Returns the facts as a set of their numbers.
    pub(crate) fn fact_set(&self) -> &Bits {
        &self.facts
    }

    /// Returns the number of entities.
    pub fn entities(&self) -> usize {
        self.entities.into()
    }

    /// Adds a fact.
    ///
    /// # Panics
    /// If the arguments do not fit the predicate or the entities.
    pub fn insert(&mut self, vocabulary: &Vocabulary, predicate: usize, arguments: &[usize]) {
        assert_eq!(
            arguments.len(),
            vocabulary.predicates()[predicate].arity,
            "number of arguments"
        );
        assert!(arguments.iter().all(|&entity| entity < self.entities()), "entities");
        let fact = vocabulary.fact(self.entities(), predicate, arguments);
        bits::insert(&mut self.facts, fact);
    }

    /// Returns whether a fact holds. A fact about an entity that the state lacks does not.
    pub fn holds(&self, vocabulary: &Vocabulary, predicate: usize, arguments: &[usize]) -> bool {
        arguments.iter().all(|&entity| entity < self.entities())
            && bits::contains(&self.facts, vocabulary.fact(self.entities(), predicate, arguments))
    }

    /// Returns the numbers of the facts that hold, as [`Vocabulary::fact`] counts them, in ascending order.
    pub fn facts(&self) -> impl Iterator<Item = usize> + '_ {
        bits::elements(&self.facts)
    }

    /// Returns the state with its entities other than the egos in an order that depends on their facts only. Many
    /// states that differ in the order of entities become equal.
    pub fn sorted(self, vocabulary: &Vocabulary) -> State {
        let (entities, egos) = (self.entities(), vocabulary.egos());
        if entities <= egos + 1 {
            return self;
        }
        let signature = |entity: usize| -> Vec<bool> {
            let mut signature = Vec::new();
            for (index, predicate) in vocabulary.predicates().iter().enumerate() {
                match predicate.arity {
                    1 => signature.push(self.holds(vocabulary, index, &[entity])),
                    2 => {
                        for ego in 0..egos {
                            signature.push(self.holds(vocabulary, index, &[ego, entity]));
                            signature.push(self.holds(vocabulary, index, &[entity, ego]));
                        }
                    }
                    _ => {}
                }
            }
            signature
        };
        let mut order: Vec<usize> = (0..entities).collect();
        order[egos..].sort_by_cached_key(|&entity| std::cmp::Reverse(signature(entity)));
        if order.is_sorted() {
            return self;
        }
        let mut sorted = State::new(vocabulary, entities);
        for (index, predicate) in vocabulary.predicates().iter().enumerate() {
            for arguments in tuples(predicate.arity, entities) {
                let before = arguments
                    .iter()
                    .fold(0, |index, &argument| index * entities + order[argument]);
                let first = vocabulary.fact(entities, index, &[0; ARITY_MAX][..predicate.arity]);
                if bits::contains(&self.facts, first + before) {
                    sorted.insert(vocabulary, index, &arguments);
                }
            }
        }
        sorted
    }
}

impl Body {
    /// Returns whether the body holds in a state for some entities.
    pub fn holds(&self, vocabulary: &Vocabulary, state: &State) -> bool {
        !witnesses(vocabulary, &self.0, self.variables(vocabulary), state, 1).is_empty()
    }
}

/// Returns up to `most` assignments of entities to `variables` variables under which a conjunction holds in a state: a
/// search that evaluates each literal as soon as its variables are assigned.
pub(crate) fn witnesses(
    vocabulary: &Vocabulary,
    literals: &[Literal],
    variables: usize,
    state: &State,
    most: usize,
) -> Vec<Assignment> {
    let mut search = Witnesses {
        vocabulary,
        literals,
        variables,
        state,
        most,
        found: Vec::new(),
    };
    search.extend(&mut (0..vocabulary.egos() as u8).collect());
    search.found
}

struct Witnesses<'a> {
    vocabulary: &'a Vocabulary,
    literals: &'a [Literal],
    variables: usize,
    state: &'a State,
    most: usize,
    found: Vec<Assignment>,
}

impl Witnesses<'_> {
    /// Assigns the remaining variables.
    fn extend(&mut self, assignment: &mut Assignment) {
        let assigned = assignment.len();
        let last = if assigned == self.vocabulary.egos() {
            0
        } else {
            assigned - 1
        };
        let agrees = self.literals.iter().all(|literal| {
            let newest = literal.atom.arguments.iter().copied().max().unwrap_or(0) as usize;
            // Literals of fewer variables were evaluated before.
            newest >= assigned
                || newest < last
                || (self.state).holds(self.vocabulary, literal.atom.predicate, &literal.atom.under(assignment))
                    != literal.is_negated
        });
        if !agrees {
            return;
        }
        if assigned == self.variables {
            self.found.push(assignment.clone());
            return;
        }
        for entity in 0..self.state.entities() as u8 {
            assignment.push(entity);
            self.extend(assignment);
            assignment.pop();
            if self.found.len() >= self.most {
                return;
            }
        }
    }
}

/// Examples of a behavior: states with the action taken in each.
#[derive(Clone, Debug)]
pub struct Examples {
    vocabulary: Vocabulary,
    actions: Vec<String>,
    /// The distinct states with their examples for each action.
    states: IndexMap<State, Box<[Tally]>>,
    count: u64,
}

/// The examples of one state and one action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of examples.
    pub count: u32,
    /// The number of the first one, counted from 0 over all examples.
    pub first: u64,
}

/// Two examples of one state with different actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contradiction {
    /// The numbers of the examples.
    pub examples: [u64; 2],
    /// The positions of their actions.
    pub actions: [usize; 2],
}

impl Examples {
    /// Returns a set without examples. `actions` are the actions, the one with the highest precedence first. The last
    /// one is the default: clauses are learned for all others.
    ///
    /// # Panics
    /// If there is no action.
    pub fn new(vocabulary: Vocabulary, actions: Vec<String>) -> Examples {
        assert!(!actions.is_empty(), "no action");
        Examples {
            vocabulary,
            actions,
            states: IndexMap::new(),
            count: 0,
        }
    }

    /// Returns the predicates.
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// Returns the actions, the one with the highest precedence first and the default last.
    pub fn actions(&self) -> &[String] {
        &self.actions
    }

    /// Adds an example. Returns the position of its state.
    ///
    /// # Panics
    /// If there is no such action.
    pub fn push(&mut self, state: State, action: usize) -> usize {
        assert!(action < self.actions.len(), "action");
        let entry = self.states.entry(state.sorted(&self.vocabulary));
        let index = entry.index();
        let tallies = match entry {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(vec![Tally::default(); self.actions.len()].into()),
        };
        let tally = &mut tallies[action];
        if tally.count == 0 {
            tally.first = self.count;
        }
        tally.count += 1;
        self.count += 1;
        index
    }

    /// Adds the examples of a state, whose order of entities is that of [`State::sorted`]. They keep their numbers.
    pub(crate) fn merge(&mut self, state: &State, tallies: &[Tally]) {
        self.states.insert(state.clone(), tallies.into());
        self.count += tallies.iter().map(|tally| u64::from(tally.count)).sum::<u64>();
    }

    /// Returns the distinct states with the examples for each action.
    pub fn states(&self) -> impl ExactSizeIterator<Item = (&State, &[Tally])> + Clone {
        self.states.iter().map(|(state, tallies)| (state, &**tallies))
    }

    /// Returns a state by its position.
    pub fn state(&self, index: usize) -> Option<(&State, &[Tally])> {
        self.states.get_index(index).map(|(state, tallies)| (state, &**tallies))
    }

    /// Returns the number of examples, repetitions included.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the states that occur with several actions, with two examples of each.
    pub fn contradictions(&self) -> impl Iterator<Item = Contradiction> + '_ {
        self.states.values().filter_map(|tallies| {
            let mut taken = (0..tallies.len()).filter(|&action| tallies[action].count > 0);
            let actions = [taken.next()?, taken.next()?];
            let mut examples = actions.map(|action| (tallies[action].first, action));
            examples.sort_unstable();
            Some(Contradiction {
                examples: examples.map(|(first, _)| first),
                actions: examples.map(|(_, action)| action),
            })
        })
    }
}

/// Returns the most frequent action, of several the one with the highest precedence.
pub(crate) fn majority(tallies: &[Tally]) -> usize {
    let most = tallies.iter().map(|tally| tally.count).max().unwrap_or(0);
    tallies.iter().position(|tally| tally.count == most).unwrap_or(0)
}
