//! One-pass parser of symbolic scenes, without the places of their parts.
//!
//! It parses only the JSON that scenes without faults usually have. `format.rs` parses the rest, and reports faults.

use crate::city::Action;
use crate::predicate::Unit;
use crate::sim::tick::ground::MAX_ENTITIES;
use serde::Deserialize;
use serde_json::value::RawValue;
use std::collections::HashMap;

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

    /// Returns the names in the order in which they were added.
    pub fn list(&self) -> &[&'n str] {
        &self.list
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

/// Parses a symbolic scene in one pass. Returns `None` for anything else, among it scenes with escaped characters, or with
/// facts or actions before the entities.
pub(super) fn plain_scene<'t>(text: &'t str, predicates: Predicates<'_>) -> Option<PlainScene<'t>> {
    let mut cursor = Cursor { text, at: 0 };
    let mut entities: Option<Vec<&'t str>> = None;
    let mut names = NameIndex::default();
    let (mut ego, mut facts, mut actions, mut reason) = (None, None, None, None);
    cursor.object(|cursor, key| {
        match key {
            "entities" if entities.is_none() => {
                let mut list = Vec::new();
                cursor.list(|cursor| {
                    list.push(cursor.string()?);
                    Some(())
                })?;
                if list.len() > MAX_ENTITIES || !list.iter().all(|name| names.add(name).is_none()) {
                    return None;
                }
                entities = Some(list);
            }
            "ego" if ego.is_none() => ego = Some(cursor.string()?),
            "facts" if facts.is_none() && entities.is_some() => facts = Some(cursor.facts(predicates, &names)?),
            "actions" if actions.is_none() && entities.is_some() => actions = Some(cursor.actions(&names)?),
            "reason" if reason.is_none() => reason = Some(cursor.string()?),
            _ => return None,
        }
        Some(())
    })?;
    cursor.end()?;
    Some(PlainScene {
        entities: entities?,
        ego: names.get(ego?)?,
        facts: facts.unwrap_or_default(),
        actions: actions.unwrap_or_default(),
        names,
    })
}

/// Parses the rows of a predicate without a value in one pass; `None` if they have a fault.
pub(super) fn plain_rows(raw: &RawValue, arity: usize, names: &NameIndex<'_>) -> Option<PlainRows> {
    let mut cursor = Cursor { text: raw.get(), at: 0 };
    let rows = cursor.rows(arity, names)?;
    cursor.end().map(|()| rows)
}

/// A position in JSON text. Methods return `None` for invalid JSON, and for JSON that plain scenes lack.
struct Cursor<'t> {
    text: &'t str,
    at: usize,
}

impl<'t> Cursor<'t> {
    /// Skips whitespace, and returns the next byte.
    #[inline]
    fn peek(&mut self) -> Option<u8> {
        loop {
            match self.text.as_bytes().get(self.at)? {
                b' ' | b'\t' | b'\n' | b'\r' => self.at += 1,
                other => return Some(*other),
            }
        }
    }

    /// Consumes a byte if it is the next one after whitespace. Returns whether it is.
    #[inline]
    fn eat(&mut self, wanted: u8) -> bool {
        let is_next = self.peek() == Some(wanted);
        self.at += usize::from(is_next);
        is_next
    }

    /// Consumes a byte that must be the next one after whitespace.
    #[inline]
    fn expect(&mut self, wanted: u8) -> Option<()> {
        self.eat(wanted).then_some(())
    }

    /// Checks that nothing follows.
    fn end(&mut self) -> Option<()> {
        self.peek().is_none().then_some(())
    }

    /// Reads a string without escaped characters.
    #[inline]
    fn string(&mut self) -> Option<&'t str> {
        self.expect(b'"')?;
        let start = self.at;
        let rest = &self.text.as_bytes()[start..];
        let length = rest.iter().position(|byte| matches!(byte, b'"' | b'\\' | ..0x20))?;
        let end = start + length;
        self.at = end + 1;
        (rest[length] == b'"').then(|| &self.text[start..end])
    }

    /// Parses the next value with `serde_json`.
    fn value<T: Deserialize<'t>>(&mut self) -> Option<T> {
        let mut values = serde_json::Deserializer::from_str(&self.text[self.at..]).into_iter();
        let value = values.next()?.ok()?;
        self.at += values.byte_offset();
        Some(value)
    }

    /// Reads a list. `item` reads an item.
    #[inline]
    fn list(&mut self, item: impl FnMut(&mut Self) -> Option<()>) -> Option<()> {
        self.expect(b'[')?;
        self.items(b']', item)
    }

    /// Reads an object. `entry` reads the value of a key.
    #[inline]
    fn object(&mut self, mut entry: impl FnMut(&mut Self, &'t str) -> Option<()>) -> Option<()> {
        self.expect(b'{')?;
        self.items(b'}', |cursor| {
            let key = cursor.string()?;
            cursor.expect(b':')?;
            entry(cursor, key)
        })
    }

    /// Reads items that commas separate, up to the closing bracket.
    #[inline]
    fn items(&mut self, close: u8, mut item: impl FnMut(&mut Self) -> Option<()>) -> Option<()> {
        if self.eat(close) {
            return Some(());
        }
        loop {
            item(self)?;
            if !self.eat(b',') {
                return self.expect(close);
            }
        }
    }

    /// Reads the facts of a scene.
    fn facts(&mut self, predicates: Predicates<'_>, names: &NameIndex<'_>) -> Option<Vec<(usize, PlainFacts<'t>)>> {
        let mut facts: Vec<(usize, PlainFacts<'t>)> = Vec::with_capacity(predicates.len());
        self.object(|cursor, key| {
            let known = predicates.iter().position(|(name, ..)| *name == key)?;
            if facts.iter().any(|(other, _)| *other == known) {
                return None;
            }
            let (_, arity, unit) = predicates[known];
            cursor.peek()?;
            let found = match unit {
                Some(_) => PlainFacts::Quantity(cursor.value()?),
                None => PlainFacts::Rows(cursor.rows(arity, names)?),
            };
            facts.push((known, found));
            Some(())
        })?;
        Some(facts)
    }

    /// Reads the actions of entities.
    fn actions(&mut self, names: &NameIndex<'_>) -> Option<Vec<(usize, Action)>> {
        let mut actions: Vec<(usize, Action)> = Vec::new();
        let mut acted = vec![false; names.list.len()];
        self.object(|cursor, name| {
            let named = names.get(name)?;
            if std::mem::replace(&mut acted[named], true) {
                return None;
            }
            actions.push((named, Action::standard_ignoring_case(cursor.string()?)?));
            Some(())
        })?;
        Some(actions)
    }

    /// Reads a list of rows.
    fn rows(&mut self, arity: usize, names: &NameIndex<'_>) -> Option<PlainRows> {
        // Most predicates have few rows.
        let (mut rows, mut uncertain) = (Vec::with_capacity(16), Vec::new());
        self.list(|cursor| {
            let (row, probability) = cursor.row(arity, names)?;
            rows.push(row);
            uncertain.extend(probability.map(|probability| (row, probability)));
            Some(())
        })?;
        uncertain.sort_by_key(|(row, _)| *row);
        if !rows.is_sorted_by(|one, other| one < other) {
            rows.sort_unstable();
            let is_uncertain = |row: &[u32; 2]| uncertain.binary_search_by_key(row, |(row, _)| *row).is_ok();
            if rows.windows(2).any(|pair| pair[0] == pair[1] && is_uncertain(&pair[0])) {
                return None;
            }
            rows.dedup();
        }
        Some((rows, uncertain))
    }

    /// Reads a row, which may have a probability.
    #[inline]
    fn row(&mut self, arity: usize, names: &NameIndex<'_>) -> Option<([u32; 2], Option<f64>)> {
        if self.peek() != Some(b'{') {
            return self.certain_row(arity, names).map(|row| (row, None));
        }
        let (mut row, mut probability) = (None, None);
        self.object(|cursor, key| {
            match key {
                "row" if row.is_none() => row = Some(cursor.certain_row(arity, names)?),
                "probability" if probability.is_none() => probability = Some(cursor.value::<f64>()?),
                _ => return None,
            }
            Some(())
        })?;
        let probability = probability.filter(|probability| *probability > 0.0 && *probability <= 1.0)?;
        Some((row?, (probability < 1.0).then_some(probability)))
    }

    /// Reads a row of names. A row of one may be written as the name alone.
    #[inline]
    fn certain_row(&mut self, arity: usize, names: &NameIndex<'_>) -> Option<[u32; 2]> {
        let mut row = [0; 2];
        if arity == 1 && self.peek() == Some(b'"') {
            row[0] = self.name(names)?;
            return Some(row);
        }
        let mut length = 0;
        self.list(|cursor| {
            *row.get_mut(length)? = cursor.name(names)?;
            length += 1;
            Some(())
        })?;
        (length == arity).then_some(row)
    }

    /// Reads a name, and returns its position.
    #[inline]
    fn name(&mut self, names: &NameIndex<'_>) -> Option<u32> {
        let name = self.string()?;
        u32::try_from(names.get(name)?).ok()
    }
}
