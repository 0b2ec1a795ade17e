//! Quantities in observations: numbers after the truth values of the atoms.
//!
//! A heading takes four truth values for each entity, a light three, and a right of way three for each pair. Any other
//! value is divided by a scale, which most values do not exceed. A power of two divides distances, so that they are read
//! as they were written; whole numbers up to 2^22 are rounded. Where there is no value, the number is 0.

use crate::city::CityMap;
use crate::config::Scenario;
use crate::datalog::Value;
use crate::predicate::{Definition, Quantity, Unit};
use crate::sim::tick::vocabulary::BasePredicate;

/// The quantities in an observation: columns of numbers.
#[derive(Debug)]
pub(super) struct Numbers {
    pub columns: Vec<NumberColumn>,
    /// The maximum number of observed entities.
    entities: usize,
}

/// The numbers of a quantity, or whether it is a certain word.
#[derive(Clone, Copy, Debug)]
pub(super) struct NumberColumn {
    /// The position in the vocabulary.
    pub predicate: usize,
    quantity: Quantity,
    /// The position of the word in [`WORDS`].
    pub word: Option<u32>,
    /// The divisor of the values; 1 for a word.
    pub scale: f32,
    /// The position of the first number among all.
    start: usize,
}

impl NumberColumn {
    /// Returns the number of entities that a number is about. That of the city is repeated for each entity.
    pub fn arity(&self) -> usize {
        self.quantity.agents().max(1)
    }

    /// Returns the number of a value.
    #[allow(clippy::cast_precision_loss)] // observations have single precision
    fn number(&self, value: Value) -> f32 {
        match (self.word, self.quantity.unit()) {
            (Some(word), _) => f32::from(u8::from(value.0 == word)),
            (None, Unit::Float) => value.as_float() / self.scale,
            (None, _) => value.as_number() as f32 / self.scale,
        }
    }

    /// Returns the value of a number; `None` if there is none.
    #[allow(clippy::cast_possible_truncation)] // rounded
    fn value(&self, number: f32) -> Option<Value> {
        match (self.word, self.quantity) {
            (Some(word), _) => (number > 0.5).then_some(Value(word)),
            (None, Quantity::Distance) => Some(Value::float(number * self.scale)),
            (None, Quantity::Intersection | Quantity::Limit) if number == 0.0 => None,
            (None, _) => Some(Value::number((number * self.scale).round() as i32)),
        }
    }
}

impl Numbers {
    /// Returns the quantities of a vocabulary in observations of up to `entities` entities.
    pub fn new(scenario: &Scenario, map: &CityMap, predicates: &[BasePredicate], entities: usize) -> Numbers {
        let (mut columns, mut start) = (Vec::new(), 0);
        for (predicate, base) in predicates.iter().enumerate() {
            let Definition::Quantity(quantity) = base.definition else {
                continue;
            };
            let words: Vec<Option<u32>> = match quantity.unit() {
                Unit::Number | Unit::Float => vec![None],
                Unit::Word(words) => words.range().map(Some).collect(),
            };
            for word in words {
                let column = NumberColumn {
                    predicate,
                    quantity,
                    word,
                    scale: scale(quantity, scenario, map),
                    start,
                };
                start += places(entities, column.arity());
                columns.push(column);
            }
        }
        Numbers { columns, entities }
    }

    /// Returns the number of all numbers.
    pub fn width(&self) -> usize {
        let columns = self.columns.iter().map(|column| places(self.entities, column.arity()));
        columns.sum()
    }

    /// Returns the columns whose numbers are about one entity.
    pub fn about_one(&self) -> impl Iterator<Item = &NumberColumn> {
        self.columns.iter().filter(|column| column.arity() == 1)
    }

    /// Writes the numbers. `values` has the values of each predicate, as in [`Atoms`](super::observed::Atoms), and
    /// the first `present` entities exist.
    pub fn write(&self, values: &[Vec<Option<Value>>], present: usize, out: &mut [f32]) {
        for column in &self.columns {
            let values = &values[column.predicate];
            let of_city = column.quantity.agents() == 0;
            for place in 0..places(self.entities, column.arity()) {
                let value = match of_city {
                    true => values[0].filter(|_| place < present),
                    false => values[place],
                };
                out[column.start + place] = value.map_or(0.0, |value| column.number(value));
            }
        }
    }

    /// Writes the number of each column about one entity.
    pub fn write_entity(&self, value: impl Fn(Quantity) -> Option<Value>, out: &mut [f32]) {
        for (column, out) in self.about_one().zip(out) {
            *out = value(column.quantity).map_or(0.0, |value| column.number(value));
        }
    }

    /// Returns the entities about which a number is not 0.
    pub fn mentioned(&self, numbers: &[f32]) -> u64 {
        let mut mentioned = 0;
        for column in &self.columns {
            for (place, number) in numbers[column.start..][..places(self.entities, column.arity())]
                .iter()
                .enumerate()
            {
                if *number != 0.0 {
                    mentioned |= 1 << (place % self.entities);
                    // The number of a pair is at the place `entities * first + second`.
                    mentioned |= if column.arity() == 2 {
                        1 << (place / self.entities)
                    } else {
                        0
                    };
                }
            }
        }
        mentioned
    }

    /// Reads what [`Numbers::write`] wrote, if the first `present` entities exist.
    pub fn read(&self, numbers: &[f32], present: usize, values: &mut [Vec<Option<Value>>]) {
        for column in &self.columns {
            values[column.predicate].fill(None);
        }
        for column in &self.columns {
            for (place, value) in values[column.predicate].iter_mut().enumerate() {
                let [first, second] = [place / self.entities, place % self.entities];
                let exists = match column.arity() {
                    1 => place < present,
                    _ => first != second && first.max(second) < present,
                };
                if exists {
                    *value = value.or_else(|| column.value(numbers[column.start + place]));
                }
            }
        }
    }
}

/// Returns the number of lists of `arity` entities, at most 2.
pub(super) fn places(entities: usize, arity: usize) -> usize {
    entities.pow(u32::try_from(arity).expect("at most 2"))
}

/// Returns the greatest absolute priority of agents, at least 1.
#[allow(clippy::cast_precision_loss)] // a scale
pub(super) fn greatest_priority(scenario: &Scenario) -> f32 {
    let of_sets =
        (scenario.splits.iter()).flat_map(|(_, set)| set.entries().map(|group| group.priority.unsigned_abs()));
    let egos = scenario.task.iter().flat_map(|task| &task.ego);
    let greatest = of_sets.chain(egos.flat_map(|ego| ego.priority)).max();
    greatest.unwrap_or(1).max(1) as f32
}

/// Returns the divisor of the values of a quantity.
#[allow(clippy::cast_precision_loss)] // a scale
fn scale(quantity: Quantity, scenario: &Scenario, map: &CityMap) -> f32 {
    match quantity {
        Quantity::Heading | Quantity::Exit | Quantity::Light | Quantity::RightOfWay => 1.0,
        Quantity::Priority => greatest_priority(scenario),
        Quantity::Speed => {
            let most = scenario.kinds.all().map(|kind| scenario.actions.table.reach(kind));
            most.max().unwrap_or(1).max(1) as f32
        }
        Quantity::Waited | Quantity::Tick => {
            let horizon = scenario.task.as_ref().map(|task| task.horizon);
            horizon.unwrap_or(scenario.ticks).max(1) as f32
        }
        Quantity::Remaining => (map.rows() + map.cols()) as f32,
        Quantity::Limit => 100.0,
        Quantity::Intersection => map.intersections().max(1) as f32,
        Quantity::Distance | Quantity::Clearance => scenario.view.max(1).next_power_of_two() as f32,
    }
}
