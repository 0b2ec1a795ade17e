//! Grounding: computes the base facts that are true in a state.
//!
//! It evaluates the definition of every base predicate ([`predicate`](crate::predicate)) for all entities.

use crate::cancel::Cancel;
use crate::city::CityMap;
use crate::datalog::dense::{BitFacts, Dense};
use crate::datalog::internal::size;
use crate::diag::codes;
use crate::diag::{Diagnostic, Limit};
use crate::predicate::{Definition, Entity, PairKind, Relation, Sight, Subject, with_pair};
use crate::sim::tick::chance::Chance;
use crate::sim::tick::vocabulary::Vocabulary;

/// The maximum number of entities in a scene, and of agents in a city with the relational executor. Binary facts take
/// memory quadratic in that number.
pub const MAX_ENTITIES: usize = 2000;

/// The true rows of each predicate of a [`Vocabulary`], in its order.
///
/// A row holds positions in the list of entities. The second position is 0 for a unary predicate. Rows are sorted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// The rows of each predicate.
    pub rows: Vec<Vec<[u32; 2]>>,
}

impl Facts {
    /// Returns the bytes of the rows.
    pub(crate) fn bytes(&self) -> u64 {
        self.rows.iter().map(|rows| size_of_val(&rows[..]) as u64).sum()
    }

    /// Returns, as bits, the facts about `count` entities that a dense program reads.
    pub fn to_bits<const W: usize>(&self, vocabulary: &Vocabulary, dense: &Dense, count: usize) -> BitFacts<W> {
        let mut bits = BitFacts::new(dense, count);
        for (predicate, rows) in vocabulary.predicates.iter().zip(&self.rows) {
            if let Some(declared) = predicate.id {
                for row in rows {
                    bits.insert(dense, declared, &row.map(|entity| entity as usize)[..predicate.arity]);
                }
            }
        }
        bits
    }
}

/// Returns the facts that are true of `entities` on `map`.
///
/// `view` is the half-width of the field of view in cells. Predicates for which `skip` holds stay empty.
pub fn ground(
    vocabulary: &Vocabulary,
    map: &CityMap,
    view: u32,
    entities: &[Entity<'_>],
    chance: &impl Chance,
    skip: impl Fn(usize) -> bool,
) -> Facts {
    let bounds = (u64::MAX, &Cancel::never());
    let facts = ground_with(vocabulary, map, view, entities, chance, skip, bounds);
    facts.unwrap_or_else(|_| unreachable!("without bounds, grounding does not stop"))
}

/// The reason why grounding stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stopped {
    /// The caller cancelled it.
    Cancelled,
    /// The facts take more bytes than allowed.
    TooManyFacts {
        /// The limit.
        limit: u64,
    },
}

impl From<Stopped> for Diagnostic {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Cancelled => Diagnostic::cancelled(),
            Stopped::TooManyFacts { limit } => {
                let message = format!("the facts about the agents take more than {}", size(limit));
                Diagnostic::new(codes::LIMIT_EXCEEDED, message).exceeds(Limit::Memory(limit))
            }
        }
    }
}

/// Bounded variant of [`ground`]. For every entity it polls `cancel` and counts the bytes of the facts.
pub(crate) fn ground_with(
    vocabulary: &Vocabulary,
    map: &CityMap,
    view: u32,
    entities: &[Entity<'_>],
    chance: &impl Chance,
    skip: impl Fn(usize) -> bool,
    (limit, cancel): (u64, &Cancel),
) -> Result<Facts, Stopped> {
    let mut facts = Facts {
        rows: vec![Vec::new(); vocabulary.predicates.len()],
    };
    let sight = Sight { map, half_width: view };
    let subjects: Vec<Subject> = entities.iter().map(Entity::subject).collect();
    for (index, predicate) in vocabulary.predicates.iter().enumerate() {
        if skip(index) {
            continue;
        }
        let left = limit.saturating_sub(facts.bytes()) / size_of::<[u32; 2]>() as u64;
        let stop = |rows: &[[u32; 2]]| match cancel.requested() {
            true => Err(Stopped::Cancelled),
            false if rows.len() as u64 > left => Err(Stopped::TooManyFacts { limit }),
            false => Ok(()),
        };
        let rows = &mut facts.rows[index];
        match &predicate.definition {
            Definition::Static(kind) => unary(rows, entities, stop, |x| kind.holds(x.kind, x.concepts)),
            Definition::Local(kind) => unary(rows, entities, stop, |x| kind.holds(map, x.kind, x.at)),
            Definition::Pair(pair) => {
                let draw = |x, y, probability| chance.decides(index, x, y, probability);
                with_pair!(pair, kind => binary(rows, kind, sight, &subjects, stop, draw))
            }
        }?;
    }
    Ok(facts)
}

/// Adds the rows of a predicate over one entity. Asks `stop` before each entity.
fn unary(
    rows: &mut Vec<[u32; 2]>,
    entities: &[Entity<'_>],
    stop: impl Fn(&[[u32; 2]]) -> Result<(), Stopped>,
    holds: impl Fn(&Entity<'_>) -> bool,
) -> Result<(), Stopped> {
    for (x, entity) in entities.iter().enumerate() {
        stop(rows)?;
        if holds(entity) {
            rows.push([number(x), 0]);
        }
    }
    Ok(())
}

/// Adds the rows of a predicate over two entities. Asks `stop` before each first entity.
fn binary<K: PairKind>(
    rows: &mut Vec<[u32; 2]>,
    kind: &K,
    sight: Sight<'_>,
    subjects: &[Subject],
    stop: impl Fn(&[[u32; 2]]) -> Result<(), Stopped>,
    draw: impl Fn(usize, usize, f64) -> bool,
) -> Result<(), Stopped> {
    for (x, first) in subjects.iter().enumerate() {
        stop(rows)?;
        for (y, second) in subjects.iter().enumerate() {
            let holds = match x == y {
                true => K::Relation::REFLEXIVE,
                false => kind.holds(sight, first, second, |probability| draw(x, y, probability)),
            };
            if holds {
                rows.push([number(x), number(y)]);
            }
        }
    }
    Ok(())
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("fewer than 2^32 entities")
}
