//! Grounding: computes the base facts that are true in a state.
//!
//! It evaluates the definition of every base predicate ([`predicate`](crate::predicate)) for all entities.

use crate::cancel::Cancel;
use crate::city::CityMap;
use crate::datalog::Value;
use crate::datalog::internal::size;
use crate::diag::codes;
use crate::diag::{Diagnostic, Limit};
use crate::predicate::{
    Definition, Entity, Measure, Measured, PairKind, Quantity, Relation, Sight, Subject, Unit, WORDS, Words, with_pair,
};
use crate::sim::tick::chance::Chance;
use crate::sim::tick::external::ExternalFacts;
use crate::sim::tick::vocabulary::Vocabulary;

/// The maximum number of entities in a scene, and of agents in a city with the relational executor. Binary facts take
/// memory quadratic in that number.
pub const MAX_ENTITIES: usize = 2000;

/// Rows of a hidden predicate about earlier ticks, sorted, with the ticks that explain them.
pub type PastRows = Vec<([u32; 2], u64)>;

/// The true rows of each predicate of a [`Vocabulary`], in its order.
///
/// A row holds positions in the list of entities, and 0 in columns that a predicate does not have. Rows are sorted, and
/// each occurs once.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// The rows of each predicate.
    pub rows: Vec<Vec<[u32; 2]>>,
    /// For each predicate with a value, that of each row, in their order; empty for others. For a word, its position
    /// among the words of all quantities: their headings, lights and rights of way, in this order.
    pub values: Vec<Vec<Value>>,
    /// The rows of each hidden predicate about earlier ticks, in the order of [`Rules::pasts`](crate::datalog::Rules),
    /// with the ticks that explain them; empty before the first tick.
    pub past: Vec<PastRows>,
    /// The word of the tick, from which the draws of clauses with probabilities follow.
    pub chance: u64,
}

impl Facts {
    /// Creates facts without rows about this number of predicates.
    pub fn new(predicates: usize) -> Facts {
        Facts::of(vec![Vec::new(); predicates])
    }

    /// Creates facts of predicates without values.
    pub fn of(rows: Vec<Vec<[u32; 2]>>) -> Facts {
        Facts {
            values: vec![Vec::new(); rows.len()],
            rows,
            past: Vec::new(),
            chance: 0,
        }
    }

    /// Adds the rows of the external predicates that `wanted` selects by their positions in the vocabulary.
    pub(crate) fn add_external(
        &mut self,
        vocabulary: &Vocabulary,
        external: &ExternalFacts,
        wanted: impl Fn(usize) -> bool,
    ) {
        let predicates = vocabulary.predicates.iter().enumerate();
        let externals = predicates.filter(|(_, predicate)| predicate.definition.is_external());
        for (number, (index, _)) in externals.enumerate() {
            if wanted(index) {
                self.rows[index] = external.rows(number);
            }
        }
    }

    /// Returns the value of a quantity for these agents; the rest of `agents` is 0.
    pub(crate) fn value(&self, predicate: usize, agents: [u32; 2]) -> Option<Value> {
        let row = self.rows[predicate].binary_search(&agents).ok()?;
        self.values[predicate].get(row).copied()
    }

    /// Returns the bytes of the rows.
    pub(crate) fn bytes(&self) -> u64 {
        let rows = self.rows.iter().map(|rows| size_of_val(&rows[..]));
        let rows = rows.chain(self.past.iter().map(|rows| size_of_val(&rows[..])));
        let values = self.values.iter().map(|values| size_of_val(&values[..]));
        rows.chain(values).sum::<usize>() as u64
    }
}

/// Returns a value of [`Facts::values`] as JSON.
pub(crate) fn json_value(value: Value, unit: Unit) -> serde_json::Value {
    match unit {
        Unit::Number => value.as_number().into(),
        Unit::Float => value.as_float().into(),
        Unit::Word(_) => WORDS[value.0 as usize].into(),
    }
}

/// Returns the facts that are true of `entities` on `map`.
///
/// `view` is the half-width of the field of view in cells. Predicates for which `skip` holds and external ones stay
/// empty.
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

/// Returns what stops the grounding of another predicate, given its rows so far: a request, or more bytes of facts than
/// the limit.
pub(crate) fn bounded<'c>(
    facts: &Facts,
    (limit, cancel): (u64, &'c Cancel),
) -> impl Fn(&[[u32; 2]]) -> Result<(), Stopped> + use<'c> {
    let left = limit.saturating_sub(facts.bytes()) / size_of::<[u32; 2]>() as u64;
    move |rows| match cancel.requested() {
        true => Err(Stopped::Cancelled),
        false if rows.len() as u64 > left => Err(Stopped::TooManyFacts { limit }),
        false => Ok(()),
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
    bounds: (u64, &Cancel),
) -> Result<Facts, Stopped> {
    let mut facts = Facts::new(vocabulary.predicates.len());
    facts.chance = if vocabulary.draws { chance.word() } else { 0 };
    let sight = Sight { map, half_width: view };
    let subjects: Vec<Subject> = entities.iter().map(Entity::subject).collect();
    for (index, predicate) in vocabulary.predicates.iter().enumerate() {
        if skip(index) {
            continue;
        }
        let stop = bounded(&facts, bounds);
        let rows = &mut facts.rows[index];
        match &predicate.definition {
            Definition::Static(kind) => unary(rows, entities, stop, |x| kind.holds(x.kind, x.concepts)),
            Definition::Local(kind) => unary(rows, entities, stop, |x| kind.holds(map, x.kind, x.at)),
            Definition::Place(kind) => unary(rows, entities, stop, |x| kind.holds(map, x.at)),
            Definition::Pair(pair) => {
                let draw = |x, y, probability| chance.decides(index, x, y, probability);
                with_pair!(pair, kind => binary(rows, kind, sight, &subjects, stop, draw))
            }
            // The caller adds them.
            Definition::External(_) => Ok(()),
            Definition::Quantity(quantity) => {
                let measured: Vec<Measured> = entities.iter().map(Entity::measured).collect();
                measure(
                    rows,
                    &mut facts.values[index],
                    *quantity,
                    (map, chance.tick()),
                    &measured,
                    stop,
                )
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

/// Adds the rows of a quantity and their values. Asks `stop` before each first entity.
fn measure(
    rows: &mut Vec<[u32; 2]>,
    values: &mut Vec<Value>,
    quantity: Quantity,
    (map, tick): (&CityMap, u64),
    entities: &[Measured],
    stop: impl Fn(&[[u32; 2]]) -> Result<(), Stopped>,
) -> Result<(), Stopped> {
    let mut add = |row, agents: &[&Measured]| {
        if let Some(measure) = quantity.measure(map, tick, agents) {
            rows.push(row);
            values.push(word(measure));
        }
        stop(rows)
    };
    match quantity.agents() {
        0 => add([0, 0], &[]),
        1 => entities
            .iter()
            .enumerate()
            .try_for_each(|(x, first)| add([number(x), 0], &[first])),
        _ => (entities.iter().enumerate()).try_for_each(|(x, first)| {
            let mut others = entities.iter().enumerate().filter(|(y, _)| *y != x);
            others.try_for_each(|(y, second)| add([number(x), number(y)], &[first, second]))
        }),
    }
}

/// Returns a value as in [`Facts::values`].
pub(crate) fn word(measure: Measure) -> Value {
    match measure {
        Measure::Number(number) => Value::number(number),
        Measure::Float(float) => Value::float(float),
        Measure::Heading(heading) => Value(Words::Headings.range().start + heading as u32),
        Measure::RightOfWay(right) => Value(Words::RightsOfWay.range().start + right as u32),
        Measure::Light(light) => Value(Words::Lights.range().start + light as u32),
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("fewer than 2^32 entities")
}
