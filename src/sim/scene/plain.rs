//! One-pass parser of symbolic scenes, without the places of their parts.

use crate::city::Action;
use crate::predicate::Unit;
use crate::sim::tick::ground::MAX_ENTITIES;
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::fmt;

/// The positions of agents or entities by their names.
#[derive(Default)]
pub(super) struct NameIndex<'n> {
    list: Vec<&'n str>,
    /// The first bytes of each name, and its length.
    keys: Vec<(u64, usize)>,
    /// Only of many names: few are compared one by one. Lookup only, never iterated.
    positions: HashMap<&'n str, usize>,
}

impl<'n> NameIndex<'n> {
    /// From this number of names on, a hash table is faster.
    const MANY: usize = 16;

    /// Adds a name. Returns the position of an equal one.
    pub fn add(&mut self, name: &'n str) -> Option<usize> {
        let known = self.get(name);
        self.list.push(name);
        match self.list.len() {
            ..Self::MANY => self.keys.push(key(name)),
            // The first one of equal names stays.
            Self::MANY => (0..).zip(&self.list).for_each(|(at, name)| {
                self.positions.entry(name).or_insert(at);
            }),
            more => _ = self.positions.entry(name).or_insert(more - 1),
        }
        known
    }

    /// Returns the position of a name.
    pub fn get(&self, name: &str) -> Option<usize> {
        if self.list.len() >= Self::MANY {
            return self.positions.get(name).copied();
        }
        let wanted = key(name);
        let is_equal = |&(at, known): &(usize, &(u64, usize))| {
            *known == wanted && (name.len() <= KEY_BYTES || self.list[at] == name)
        };
        self.keys.iter().enumerate().find(is_equal).map(|(at, _)| at)
    }
}

/// The number of bytes of a name in its key.
const KEY_BYTES: usize = size_of::<u64>();

/// Returns the first bytes of a name, and its length.
fn key(name: &str) -> (u64, usize) {
    let bytes = name.as_bytes();
    let first = &bytes[..bytes.len().min(KEY_BYTES)];
    (
        first.iter().fold(0, |key, byte| key << 8 | u64::from(*byte)),
        bytes.len(),
    )
}

/// A scene of entities without faults.
pub(super) struct PlainScene<'t> {
    pub entities: Vec<&'t str>,
    pub ego: usize,
    /// By the position of the predicate.
    pub facts: Vec<(usize, PlainFacts<'t>)>,
    pub actions: Vec<(usize, Action)>,
    pub names: NameIndex<'t>,
}

/// The facts of a predicate.
pub(super) enum PlainFacts<'t> {
    Rows(PlainRows),
    /// The rows of a quantity, not yet parsed.
    Quantity(&'t RawValue),
}

/// Rows, sorted, each once, and the probabilities of those that have one, sorted.
pub(super) type PlainRows = (Vec<[u32; 2]>, Vec<([u32; 2], f64)>);

/// Base predicates: name, number of agents in a row, and the type of the value of a quantity.
pub(super) type Predicates<'a> = &'a [(&'a str, usize, Option<Unit>)];

/// Parses a symbolic scene in one pass. Returns `None` for a scene with a fault, with an escaped character in a name, or
/// with facts before its entities.
pub(super) fn plain_scene<'t>(text: &'t str, predicates: Predicates<'_>) -> Option<PlainScene<'t>> {
    let mut read = serde_json::Deserializer::from_str(text);
    let scene = SceneSeed { predicates }.deserialize(&mut read).ok()?;
    read.end().ok().map(|()| scene)
}

/// Parses the rows of a predicate without a value in one pass; `None` if they have a fault.
pub(super) fn plain_rows(raw: &RawValue, arity: usize, names: &NameIndex<'_>) -> Option<PlainRows> {
    let mut read = serde_json::Deserializer::from_str(raw.get());
    Rows(RowSeed::new(arity, names)).deserialize(&mut read).ok()
}

struct SceneSeed<'a> {
    predicates: Predicates<'a>,
}

impl<'de> DeserializeSeed<'de> for SceneSeed<'_> {
    type Value = PlainScene<'de>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for SceneSeed<'_> {
    type Value = PlainScene<'de>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a scene of entities")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut entities: Option<Vec<&'de str>> = None;
        let mut names = NameIndex::default();
        let (mut ego, mut facts, mut actions, mut reason) = (None, None, None, None);
        while let Some(key) = map.next_key::<&str>()? {
            match key {
                "entities" if entities.is_none() => {
                    let list: Vec<&'de str> = map.next_value()?;
                    if list.len() > MAX_ENTITIES || !list.iter().all(|name| names.add(name).is_none()) {
                        return Err(de::Error::custom("other entities"));
                    }
                    entities = Some(list);
                }
                "ego" if ego.is_none() => ego = Some(map.next_value::<&str>()?),
                "facts" if facts.is_none() && entities.is_some() => {
                    facts = Some(map.next_value_seed(FactsSeed {
                        predicates: self.predicates,
                        names: &names,
                    })?);
                }
                "actions" if actions.is_none() && entities.is_some() => {
                    actions = Some(map.next_value_seed(ActionsSeed(&names))?);
                }
                "reason" if reason.is_none() => reason = Some(map.next_value::<&str>()?),
                _ => return Err(de::Error::custom("another key")),
            }
        }
        let ego = ego.and_then(|name| names.get(name));
        let (Some(entities), Some(ego)) = (entities, ego) else {
            return Err(de::Error::custom("no ego"));
        };
        Ok(PlainScene {
            entities,
            ego,
            facts: facts.unwrap_or_default(),
            actions: actions.unwrap_or_default(),
            names,
        })
    }
}

/// Parses the facts of a scene.
struct FactsSeed<'a, 'n> {
    predicates: Predicates<'a>,
    names: &'a NameIndex<'n>,
}

impl<'de> DeserializeSeed<'de> for FactsSeed<'_, '_> {
    type Value = Vec<(usize, PlainFacts<'de>)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for FactsSeed<'_, '_> {
    type Value = Vec<(usize, PlainFacts<'de>)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("facts")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut facts: Vec<(usize, PlainFacts<'de>)> = Vec::new();
        while let Some(key) = map.next_key::<&str>()? {
            let known = self.predicates.iter().position(|(name, ..)| *name == key);
            let known = known.filter(|known| facts.iter().all(|(other, _)| other != known));
            let known = known.ok_or_else(|| de::Error::custom("another predicate"))?;
            let (_, arity, unit) = self.predicates[known];
            let found = match unit {
                Some(_) => PlainFacts::Quantity(map.next_value()?),
                None => PlainFacts::Rows(map.next_value_seed(Rows(RowSeed::new(arity, self.names)))?),
            };
            facts.push((known, found));
        }
        Ok(facts)
    }
}

/// Parses the actions of entities.
struct ActionsSeed<'a, 'n>(&'a NameIndex<'n>);

impl<'de> DeserializeSeed<'de> for ActionsSeed<'_, '_> {
    type Value = Vec<(usize, Action)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for ActionsSeed<'_, '_> {
    type Value = Vec<(usize, Action)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("actions")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut actions: Vec<(usize, Action)> = Vec::new();
        let mut acted = vec![false; self.0.list.len()];
        while let Some((name, action)) = map.next_entry::<&str, &str>()? {
            let named = self
                .0
                .get(name)
                .filter(|named| !std::mem::replace(&mut acted[*named], true));
            match named.zip(Action::standard_ignoring_case(action)) {
                Some(found) => actions.push(found),
                None => return Err(de::Error::custom("another action")),
            }
        }
        Ok(actions)
    }
}

/// Parses a list of rows.
struct Rows<'a, 'n>(RowSeed<'a, 'n>);

impl<'de> DeserializeSeed<'de> for Rows<'_, '_> {
    type Value = PlainRows;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Rows<'_, '_> {
    type Value = PlainRows;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        // Most predicates have few rows.
        let (mut rows, mut uncertain) = (Vec::with_capacity(16), Vec::new());
        while let Some((row, probability)) = list.next_element_seed(self.0)? {
            rows.push(row);
            uncertain.extend(probability.map(|probability| (row, probability)));
        }
        uncertain.sort_by_key(|(row, _)| *row);
        if !rows.is_sorted_by(|one, other| one < other) {
            rows.sort_unstable();
            let is_uncertain = |row: &[u32; 2]| uncertain.binary_search_by_key(row, |(row, _)| *row).is_ok();
            if rows.windows(2).any(|pair| pair[0] == pair[1] && is_uncertain(&pair[0])) {
                return Err(de::Error::custom("a row with a probability is given again"));
            }
            rows.dedup();
        }
        Ok((rows, uncertain))
    }
}

/// Parses a row of names, which may have a probability below 1.
#[derive(Clone, Copy)]
struct RowSeed<'a, 'n> {
    arity: usize,
    names: &'a NameIndex<'n>,
    may_be_uncertain: bool,
}

impl<'a, 'n> RowSeed<'a, 'n> {
    fn new(arity: usize, names: &'a NameIndex<'n>) -> Self {
        RowSeed {
            arity,
            names,
            may_be_uncertain: true,
        }
    }
}

impl<'de> DeserializeSeed<'de> for RowSeed<'_, '_> {
    type Value = ([u32; 2], Option<f64>);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for RowSeed<'_, '_> {
    type Value = ([u32; 2], Option<f64>);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a row")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<Self::Value, E> {
        match self.arity {
            1 => Ok(([NameSeed(self.names).visit_str(name)?, 0], None)),
            _ => Err(E::custom("one name")),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let (mut row, mut length) = ([0; 2], 0);
        while let Some(name) = list.next_element_seed(NameSeed(self.names))? {
            *row.get_mut(length).ok_or_else(|| de::Error::custom("too many names"))? = name;
            length += 1;
        }
        match length == self.arity {
            true => Ok((row, None)),
            false => Err(de::Error::custom("another number of names")),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let certain = RowSeed {
            may_be_uncertain: false,
            ..self
        };
        let (mut found, mut probability) = (None, None);
        while let Some(key) = map.next_key::<&str>()? {
            match key {
                "row" if found.is_none() && self.may_be_uncertain => found = Some(map.next_value_seed(certain)?),
                "probability" if probability.is_none() => probability = Some(map.next_value::<f64>()?),
                _ => return Err(de::Error::custom("another key")),
            }
        }
        match (found, probability) {
            (Some((row, _)), Some(1.0)) => Ok((row, None)),
            (Some((row, _)), Some(probability)) if probability > 0.0 && probability < 1.0 => {
                Ok((row, Some(probability)))
            }
            _ => Err(de::Error::custom("no probability")),
        }
    }
}

/// Parses a name, and returns its position.
struct NameSeed<'a, 'n>(&'a NameIndex<'n>);

impl<'de> DeserializeSeed<'de> for NameSeed<'_, '_> {
    type Value = u32;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<u32, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for NameSeed<'_, '_> {
    type Value = u32;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<u32, E> {
        let position = self.0.get(name).and_then(|position| u32::try_from(position).ok());
        position.ok_or_else(|| E::custom("an unknown name"))
    }
}
