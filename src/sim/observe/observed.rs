//! What a monitor reads: the observed entities, the facts about them, imposed actions, and earlier ticks.

use crate::cancel::Cancel;
use crate::city::{Action, Agent};
use crate::datalog::Value;
use crate::datalog::dense::{first, members};
use crate::sim::tick::agent_state::AgentState;
use crate::sim::tick::chance::Drawing;
use crate::sim::tick::ground::Facts;
use crate::sim::tick::memory::Memory;

/// The maximum number of observed entities.
pub const OBSERVED_MAX: usize = 64;

/// Returns the set of the first `count` entities.
pub(super) fn all_of(count: usize) -> u64 {
    let [all] = first(count);
    all
}

/// The facts about up to 64 entities.
#[derive(Clone, Debug, Default)]
pub(super) struct Atoms {
    /// The sets of entities, see [`AtomLayout`].
    pub words: Vec<u64>,
    /// For each quantity of the vocabulary, its values for the entities, or for each pair of them,
    /// [`AtomLayout::entities`] to a row, or for the city; empty for other predicates; no entries at all if
    /// the vocabulary has no quantities.
    pub values: Vec<Vec<Option<Value>>>,
    pub layout: AtomLayout,
}

/// The places of sets of entities: first one for each predicate of the vocabulary, the entities for which it holds;
/// then `entities` sets for each predicate from `first_pair` on, those to which it relates each entity.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AtomLayout {
    pub predicates: usize,
    /// The first predicate over two agents.
    pub first_pair: usize,
    pub entities: usize,
}

impl AtomLayout {
    /// Returns the number of sets.
    pub fn len(self) -> usize {
        self.predicates + (self.predicates - self.first_pair) * self.entities
    }

    /// Returns the place of the first set of a predicate over two agents.
    pub fn rows(self, predicate: usize) -> usize {
        self.predicates + (predicate - self.first_pair) * self.entities
    }

    /// Returns the predicate of a set, and the entity whose related ones are in it, if the predicate is over two
    /// agents.
    pub fn predicate(self, set: usize) -> (usize, Option<usize>) {
        match set.checked_sub(self.predicates) {
            None => (set, None),
            Some(row) => (self.first_pair + row / self.entities, Some(row % self.entities)),
        }
    }

    /// Returns the entity whose related ones are in a set; `None` if the set is about a predicate over one agent.
    pub fn related(self, set: usize) -> Option<usize> {
        Some(set.checked_sub(self.predicates)? % self.entities)
    }
}

impl Atoms {
    /// Copies the facts of others with the same layout.
    pub fn copy_from(&mut self, other: &Atoms) {
        self.words.copy_from_slice(&other.words);
        self.copy_values(other);
    }

    /// Copies the values of others with the same layout.
    pub fn copy_values(&mut self, other: &Atoms) {
        let pairs = self.values.iter_mut().zip(&other.values);
        for (to, from) in pairs.filter(|(_, from)| !from.is_empty()) {
            to.clone_from(from);
        }
    }

    /// Returns the entities for which a predicate holds.
    pub fn unary(&self, predicate: usize) -> u64 {
        self.words[predicate]
    }

    /// Returns the entities that a predicate relates to `entity`.
    pub fn row(&self, predicate: usize, entity: usize) -> u64 {
        match predicate < self.layout.first_pair {
            true => 0,
            false => self.words[self.layout.rows(predicate) + entity],
        }
    }

    /// Returns the value of a quantity for the entities.
    pub fn value(&self, predicate: usize, entities: &[usize]) -> Option<Value> {
        let place = entities
            .iter()
            .fold(0, |place, entity| place * self.layout.entities + entity);
        self.values.get(predicate)?.get(place).copied().flatten()
    }

    /// Returns the rows of a predicate over two agents.
    pub fn rows_mut(&mut self, predicate: usize) -> &mut [u64] {
        &mut self.words[self.layout.rows(predicate)..][..self.layout.entities]
    }
}

/// The observed entities, the ego first.
#[derive(Clone, Copy)]
pub(super) enum Entities<'a> {
    /// Agents of a city. A body has its position in the list of agents.
    Agents {
        bodies: &'a [AgentState],
        agents: &'a [Agent],
    },
    /// The first `present` of at most `most` entities without a city.
    Numbered { present: usize, most: usize },
}

impl Entities<'_> {
    /// Returns the number of observed entities.
    pub fn count(self) -> usize {
        match self {
            Entities::Agents { bodies, .. } => bodies.len(),
            Entities::Numbered { present, .. } => present,
        }
    }

    /// Returns the position of an entity in the list of agents.
    pub fn position(self, entity: usize) -> u32 {
        match self {
            Entities::Agents { bodies, .. } => bodies[entity].agent,
            Entities::Numbered { .. } => entity as u32,
        }
    }

    /// Returns the names of all agents in list order.
    pub fn names(self) -> Vec<String> {
        match self {
            Entities::Agents { agents, .. } => agents.iter().map(|agent| agent.name().to_string()).collect(),
            Entities::Numbered { most, .. } => (0..most).map(|entity| format!("e{entity}")).collect(),
        }
    }
}

/// Imposed actions: for each action, the entities that take it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GivenActions([u64; Action::MAX]);

impl GivenActions {
    /// Imposes an action on an entity.
    pub fn give(&mut self, entity: usize, action: Action) {
        self.0[action.index()] |= 1 << entity;
    }
}

/// The input of an evaluation.
#[derive(Clone, Copy)]
pub(super) struct Observed<'a> {
    pub atoms: &'a Atoms,
    /// The observed entities, the ego first.
    pub entities: Entities<'a>,
    /// The imposed actions, if the rules take them as input.
    pub given: Option<&'a GivenActions>,
    /// What the rules read of earlier ticks; `None` without a city.
    pub memory: Option<&'a Memory>,
    /// What draws read.
    pub drawing: Drawing<'a>,
    /// Polled by the relational executor.
    pub cancel: &'a Cancel,
}

impl<'a> Observed<'a> {
    /// Returns facts without an imposed action, earlier ticks and draws.
    pub fn new(atoms: &'a Atoms, entities: Entities<'a>, cancel: &'a Cancel) -> Observed<'a> {
        Observed {
            atoms,
            entities,
            given: None,
            memory: None,
            drawing: Drawing::default(),
            cancel,
        }
    }

    /// Returns the entities for which a predicate of the vocabulary or, after those, an imposed action holds.
    pub fn unary(&self, predicate: usize) -> u64 {
        match predicate.checked_sub(self.atoms.layout.predicates) {
            None => self.atoms.unary(predicate),
            Some(action) => self.given.map_or(0, |given| given.0[action]),
        }
    }

    /// Returns the facts by the positions of agents in the list.
    pub fn facts(&self, predicates: usize) -> Facts {
        let agent = |entity: usize| self.entities.position(entity);
        let rows = (0..predicates).map(|predicate| {
            let alone = members(&[self.unary(predicate)]).map(|entity| [agent(entity), 0]);
            let pairs = (0..self.entities.count())
                .filter(|_| predicate < self.atoms.layout.predicates)
                .flat_map(|x| members(&[self.atoms.row(predicate, x)]).map(move |y| (x, y)));
            let mut rows: Vec<[u32; 2]> = alone.chain(pairs.map(|(x, y)| [agent(x), agent(y)])).collect();
            rows.sort_unstable();
            rows
        });
        let mut facts = Facts::of(rows.collect());
        facts.chance = self.drawing.word;
        let quantities = self.atoms.values.iter().enumerate();
        for (predicate, values) in quantities.filter(|(_, values)| !values.is_empty()) {
            self.add_values(predicate, values, &mut facts);
        }
        if let Some(memory) = self.memory {
            let observed: Vec<u32> = (0..self.entities.count()).map(agent).collect();
            facts.past = memory.rows_among(&observed);
        }
        facts
    }

    /// Adds the values of a quantity.
    fn add_values(&self, predicate: usize, values: &[Option<Value>], facts: &mut Facts) {
        let most = self.atoms.layout.entities;
        let agent = |entity: usize| self.entities.position(entity);
        let row = |place: usize| match values.len() {
            // That of the city, which is about no agent, or that of the only observed one.
            1 => Some([agent(0), 0]),
            alone if alone == most => (place < self.entities.count()).then(|| [agent(place), 0]),
            _ => {
                let pair = [place / most, place % most];
                (pair.iter().all(|entity| *entity < self.entities.count())).then(|| pair.map(agent))
            }
        };
        let known = values
            .iter()
            .enumerate()
            .filter_map(|(place, value)| Some((row(place)?, (*value)?)));
        let mut known: Vec<([u32; 2], Value)> = known.collect();
        known.sort_unstable();
        (facts.rows[predicate], facts.values[predicate]) = known.into_iter().unzip();
    }
}
