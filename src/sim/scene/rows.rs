//! Rows of a scene in one pass, without places.

use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::HashMap;
use std::fmt;

/// Rows, sorted, each once, and the probabilities of those that have one, sorted.
pub(super) type PlainRows = (Vec<[u32; 2]>, Vec<([u32; 2], f64)>);

/// Parses the rows of a predicate without a value in one pass; `None` if they have a fault.
pub(super) fn plain_rows(raw: &RawValue, arity: usize, names: &HashMap<String, usize>) -> Option<PlainRows> {
    let mut read = serde_json::Deserializer::from_str(raw.get());
    let rows: Vec<([u32; 2], Option<f64>)> = Rows(RowSeed {
        arity,
        names,
        may_be_uncertain: true,
    })
    .deserialize(&mut read)
    .ok()?;
    let uncertain = rows
        .iter()
        .filter_map(|(row, probability)| Some((*row, (*probability)?)));
    let mut uncertain: Vec<([u32; 2], f64)> = uncertain.collect();
    let mut rows: Vec<[u32; 2]> = rows.into_iter().map(|(row, _)| row).collect();
    rows.sort_unstable();
    rows.dedup();
    uncertain.sort_by_key(|(row, _)| *row);
    let twice = uncertain.windows(2).any(|pair| pair[0].0 == pair[1].0);
    (!twice).then_some((rows, uncertain))
}

/// Parses a list of rows.
struct Rows<'n>(RowSeed<'n>);

impl<'de> DeserializeSeed<'de> for Rows<'_> {
    type Value = Vec<([u32; 2], Option<f64>)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Rows<'_> {
    type Value = Vec<([u32; 2], Option<f64>)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut rows = Vec::new();
        while let Some(row) = list.next_element_seed(self.0)? {
            rows.push(row);
        }
        Ok(rows)
    }
}

/// Parses a row of names, which may have a probability below 1.
#[derive(Clone, Copy)]
struct RowSeed<'n> {
    arity: usize,
    names: &'n HashMap<String, usize>,
    may_be_uncertain: bool,
}

impl<'de> DeserializeSeed<'de> for RowSeed<'_> {
    type Value = ([u32; 2], Option<f64>);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for RowSeed<'_> {
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
struct NameSeed<'n>(&'n HashMap<String, usize>);

impl<'de> DeserializeSeed<'de> for NameSeed<'_> {
    type Value = u32;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<u32, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for NameSeed<'_> {
    type Value = u32;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<u32, E> {
        let position = self.0.get(name).and_then(|position| u32::try_from(*position).ok());
        position.ok_or_else(|| E::custom("an unknown name"))
    }
}
