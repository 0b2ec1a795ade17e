//! The memory of a session: which rows of hidden predicates follow from earlier ticks.
//!
//! ```text
//! tick              0  1  2  3  4  5  6
//! P(x)              .  x  x  .  .  .  .      one span, from 1 to 2
//! once[1,3] P(x)    .  .  x  x  x  x  .      from 1 + 1 to 2 + 3
//! ```
//!
//! For each row the memory keeps the [`Spans`] of ticks in which it held. A span that no later window can see is
//! forgotten. A row changes in a hidden predicate some fixed number of ticks after a span begins or ends. The agenda
//! keeps these ticks, so the work of a tick depends on what changes in it. The exception is `P since Q` for rows in
//! which Q holds and P does not.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::io;

use crate::chance;
use crate::check::{Past, PastOperator, PredicateId, Rules};
use crate::eval::delta::Delta;
use crate::snapshot::{Decoder, Encoder, SnapshotError};
use crate::spans::Spans;
use crate::value::Value;

type Row = Box<[Value]>;

/// The memory of a session.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    /// The present tick.
    tick: u64,
    memories: Vec<Memory>,
    /// For each watched predicate, the rows that commits of the present tick changed, and whether they hold now.
    changes: BTreeMap<PredicateId, BTreeMap<Row, bool>>,
    /// The changes of hidden rows that no commit has made yet.
    pub staged: Vec<(PredicateId, Row, bool)>,
    /// The ticks of rows that the caller inserted; see [`Session::insert_past`](crate::Session::insert_past).
    pub given: HashMap<(PredicateId, Row), u64>,
    /// What draws read, if the rules draw.
    chance: Option<Chance>,
}

/// The word of the tick.
#[derive(Clone, Debug)]
struct Chance {
    predicate: PredicateId,
    /// The seed of the words; `None` if the caller determines each.
    seed: Option<u64>,
    /// The word that is staged or committed.
    word: Option<u64>,
}

/// The memory of one hidden predicate.
#[derive(Clone, Debug)]
struct Memory {
    past: Past,
    /// The rows that hold in the hidden predicate.
    holding: BTreeSet<Row>,
    rows: HashMap<Row, Spans>,
    /// The number of all their spans.
    spans: usize,
    agenda: Agenda,
    /// For `since`: the rows of the first predicate that hold.
    held: HashSet<Row>,
    /// For `since`: the rows with spans, by the row of the first predicate.
    by_held: HashMap<Row, BTreeSet<Row>>,
    /// For `since`: the rows with spans for which the first predicate does not hold.
    unheld: BTreeSet<Row>,
}

/// The rows to look at in later ticks.
#[derive(Clone, Debug, Default)]
struct Agenda {
    ticks: BTreeMap<u64, BTreeSet<Row>>,
    /// The number of rows in all ticks.
    len: usize,
}

impl Agenda {
    fn add(&mut self, tick: u64, row: &Row) {
        self.len += usize::from(self.ticks.entry(tick).or_default().insert(row.clone()));
    }

    /// Removes the rows of the first tick, if it is not after `now`.
    fn pop(&mut self, now: u64) -> Option<BTreeSet<Row>> {
        let due = self.ticks.first_entry().filter(|due| *due.key() <= now)?.remove();
        self.len -= due.len();
        Some(due)
    }
}

impl History {
    pub fn new(rules: &Rules) -> History {
        let pasts = &rules.pasts;
        let memory = |past: &Past| Memory {
            past: past.clone(),
            holding: BTreeSet::new(),
            rows: HashMap::new(),
            spans: 0,
            agenda: Agenda::default(),
            held: HashSet::new(),
            by_held: HashMap::new(),
            unheld: BTreeSet::new(),
        };
        let watched = pasts.iter().flat_map(|past| {
            let held = match &past.operator {
                PastOperator::Since(held, _) => Some(*held),
                PastOperator::Once | PastOperator::Always => None,
            };
            held.into_iter().chain([past.operand])
        });
        let chance = rules.chance.map(|predicate| Chance {
            predicate,
            seed: Some(0),
            word: None,
        });
        let mut history = History {
            tick: 0,
            memories: pasts.iter().map(memory).collect(),
            changes: watched.map(|predicate| (predicate, BTreeMap::new())).collect(),
            staged: Vec::new(),
            given: HashMap::new(),
            chance,
        };
        history.draw();
        history
    }

    /// Sets the seed of the words of this tick and later ones.
    pub fn set_seed(&mut self, seed: u64) {
        if let Some(chance) = &mut self.chance {
            chance.seed = Some(seed);
            self.draw();
        }
    }

    /// Sets the word of this tick, and of later ones until the next call.
    pub fn set_word(&mut self, word: u64) {
        if let Some(chance) = &mut self.chance {
            chance.seed = None;
            self.stage_word(word);
        }
    }

    /// Stages the word of the tick that follows from the seed.
    fn draw(&mut self) {
        if let Some(seed) = self.chance.as_ref().and_then(|chance| chance.seed) {
            self.stage_word(chance::word(seed, self.tick));
        }
    }

    fn stage_word(&mut self, word: u64) {
        let Some(chance) = &mut self.chance else { return };
        let before = chance.word.replace(word).filter(|before| *before != word);
        let row = |word: u64| chance::halves(word).map(Value).into();
        let removed = before.map(|before| (chance.predicate, row(before), false));
        self.staged.extend(removed);
        self.staged.push((chance.predicate, row(word), true));
    }

    /// Returns the number of the present tick, from 0.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Notes what a commit changed.
    pub fn note(&mut self, delta: &Delta) {
        self.staged.clear();
        for (predicate, changes) in &mut self.changes {
            let Some(change) = delta.of(*predicate) else { continue };
            for (rows, holds) in [(&change.removed, false), (&change.added, true)] {
                for row in rows.iter() {
                    // A second change undoes the first.
                    if changes.remove(row).is_none() {
                        changes.insert(row.into(), holds);
                    }
                }
            }
        }
    }

    /// Begins the next tick. Stages the changes of the hidden rows.
    pub fn advance(&mut self) {
        let ended = self.tick;
        self.tick += 1;
        let changed = |predicate: PredicateId| self.changes.get(&predicate).into_iter().flatten();
        for memory in &mut self.memories {
            for (row, &holds) in changed(memory.past.operand) {
                memory.note(row, holds, ended);
            }
            if let PastOperator::Since(held, _) = memory.past.operator {
                memory.note_held(changed(held), ended);
            }
            memory.advance(self.tick, &mut self.staged);
        }
        self.changes.values_mut().for_each(BTreeMap::clear);
        self.draw();
    }

    /// Writes the memory.
    pub fn save(&self, out: &mut Encoder<'_>) -> io::Result<()> {
        out.long(self.tick)?;
        if let Some(chance) = &self.chance {
            for number in [chance.seed, chance.word] {
                out.flag(number.is_some())?;
                out.long(number.unwrap_or_default())?;
            }
        }
        for memory in &self.memories {
            memory.save(out)?;
        }
        for changes in self.changes.values() {
            out.count(changes.len())?;
            for (row, holds) in changes {
                write_row(out, row)?;
                out.flag(*holds)?;
            }
        }
        out.count(self.staged.len())?;
        for (predicate, row, holds) in &self.staged {
            out.word(predicate.0)?;
            write_row(out, row)?;
            out.flag(*holds)?;
        }
        // In an order that does not depend on hashes.
        let given: BTreeMap<_, _> = self.given.iter().collect();
        out.count(given.len())?;
        for ((predicate, row), tick) in given {
            out.word(predicate.0)?;
            write_row(out, row)?;
            out.long(*tick)?;
        }
        Ok(())
    }

    /// Reads what [`save`](History::save) wrote, into a new memory of the same rules. The rows have the first `known`
    /// symbols.
    pub fn load(&mut self, input: &mut Decoder<'_>, rules: &Rules, known: usize) -> Result<(), SnapshotError> {
        self.tick = input.long()?;
        // Later ticks are counted from it.
        if self.tick > u64::from(u32::MAX) << 24 {
            return Err(SnapshotError::Corrupt);
        }
        if let Some(chance) = &mut self.chance {
            for number in [&mut chance.seed, &mut chance.word] {
                let is_set = input.flag()?;
                *number = Some(input.long()?).filter(|_| is_set);
            }
        }
        let read = |input: &mut Decoder<'_>, predicate: PredicateId| read_row(input, rules, predicate, known);
        for memory in &mut self.memories {
            memory.load(input, self.tick, &read)?;
        }
        for (predicate, changes) in &mut self.changes {
            for _ in 0..input.long()? {
                let (row, holds) = (read(input, *predicate)?, input.flag()?);
                // Before the first tick no row held.
                if !holds && self.tick == 0 {
                    return Err(SnapshotError::Corrupt);
                }
                changes.insert(row, holds);
            }
        }
        self.staged.clear();
        for _ in 0..input.long()? {
            let predicate = PredicateId(input.word()?);
            self.staged.push((predicate, read(input, predicate)?, input.flag()?));
        }
        for _ in 0..input.long()? {
            let predicate = PredicateId(input.word()?);
            self.given.insert((predicate, read(input, predicate)?), input.long()?);
        }
        Ok(())
    }

    /// Returns the bytes of the memory, about.
    pub fn bytes(&self) -> u64 {
        /// The bytes of a row in a map or set, besides its values.
        const ENTRY: usize = 48;
        /// The number of maps and sets that contain a row, besides the agenda.
        const COPIES: usize = 6;
        let entries = |count: usize, arity: usize| count * (ENTRY + arity * size_of::<Value>());
        let of_memory = |memory: &Memory| {
            let arity = memory.rows.keys().next().map_or(0, |row| row.len());
            let rows = COPIES * (memory.rows.len() + memory.held.len()) + memory.agenda.len;
            entries(rows, arity) + memory.spans * size_of::<(u64, u64)>()
        };
        let arity = self.given.keys().next().map_or(0, |(_, row)| row.len());
        (self.memories.iter().map(of_memory).sum::<usize>() + entries(self.given.len(), arity)) as u64
    }

    /// Returns the nearest tick of the window in which the operand of a row held, or the first one if it held in all.
    pub fn witness(&self, predicate: PredicateId, row: &[Value]) -> Option<u64> {
        let memory = self.memories.iter().find(|memory| memory.past.predicate == predicate)?;
        if let Some(tick) = self.given.get(&(predicate, row.into())) {
            return Some(*tick);
        }
        memory.rows.get(row)?.witness(&memory.past, self.tick)
    }
}

fn write_row(out: &mut Encoder<'_>, row: &[Value]) -> io::Result<()> {
    row.iter().try_for_each(|word| out.word(word.0))
}

/// Reads a row of a predicate.
fn read_row(
    input: &mut Decoder<'_>,
    rules: &Rules,
    predicate: PredicateId,
    known: usize,
) -> Result<Row, SnapshotError> {
    /// The memory of a row in the maps and sets that contain it, besides its values.
    const ENTRIES: usize = 6 * 48;
    let predicate = rules.predicates.get(predicate.index()).ok_or(SnapshotError::Corrupt)?;
    input.room(1, ENTRIES + 6 * size_of::<Value>() * predicate.arity())?;
    let words = predicate.columns.iter().map(|column| {
        let word = input.word()?;
        match column.base.is_interned() && word as usize >= known {
            true => Err(SnapshotError::Corrupt),
            false => Ok(Value(word)),
        }
    });
    words.collect()
}

/// What reads a row of a predicate.
type ReadRow<'a> = &'a dyn Fn(&mut Decoder<'_>, PredicateId) -> Result<Row, SnapshotError>;

impl Memory {
    fn save(&self, out: &mut Encoder<'_>) -> io::Result<()> {
        out.count(self.holding.len())?;
        for row in &self.holding {
            write_row(out, row)?;
        }
        // In an order that does not depend on hashes.
        let rows: BTreeMap<&Row, &Spans> = self.rows.iter().collect();
        out.count(rows.len())?;
        for (row, spans) in rows {
            write_row(out, row)?;
            out.count(spans.len())?;
            for (first, last) in spans.ticks() {
                out.long(*first)?;
                out.long(*last)?;
            }
        }
        out.count(self.agenda.ticks.len())?;
        for (tick, rows) in &self.agenda.ticks {
            out.long(*tick)?;
            out.count(rows.len())?;
            for row in rows {
                write_row(out, row)?;
            }
        }
        let held: BTreeSet<&Row> = self.held.iter().collect();
        out.count(held.len())?;
        for row in held {
            write_row(out, row)?;
        }
        Ok(())
    }

    fn load(&mut self, input: &mut Decoder<'_>, now: u64, read: ReadRow<'_>) -> Result<(), SnapshotError> {
        let of = self.past.predicate;
        for _ in 0..input.long()? {
            self.holding.insert(read(input, of)?);
        }
        for _ in 0..input.long()? {
            let row = read(input, of)?;
            let mut ticks = Vec::new();
            for _ in 0..input.long()? {
                input.room(1, size_of::<(u64, u64)>())?;
                ticks.push((input.long()?, input.long()?));
            }
            let spans = Spans::of(ticks).filter(|spans| spans.ticks().iter().all(|span| span.0 <= now));
            let spans = spans.ok_or(SnapshotError::Corrupt)?;
            self.spans += spans.len();
            self.rows.insert(row, spans);
        }
        for _ in 0..input.long()? {
            let tick = input.long()?;
            for _ in 0..input.long()? {
                self.agenda.add(tick, &read(input, of)?);
            }
        }
        let held = input.long()?;
        let PastOperator::Since(first, columns) = &self.past.operator else {
            return match held {
                0 => Ok(()),
                _ => Err(SnapshotError::Corrupt),
            };
        };
        for _ in 0..held {
            self.held.insert(read(input, *first)?);
        }
        for row in self.rows.keys() {
            let key: Row = columns.iter().map(|&column| row[column]).collect();
            if !self.held.contains(&key) {
                self.unheld.insert(row.clone());
            }
            self.by_held.entry(key).or_default().insert(row.clone());
        }
        Ok(())
    }

    /// Notes a change of the operand in tick `now`.
    fn note(&mut self, row: &Row, holds: bool, now: u64) {
        let spans = self.rows.entry(row.clone()).or_default();
        match holds {
            true => {
                spans.begin(now);
                self.spans += 1;
            }
            // It did not hold in this tick, so the tick before was the last one.
            false => spans.end(now - 1),
        }
        let (first, last) = (u64::from(self.past.first), self.past.last.map(u64::from));
        // `Always` waits for the whole window, and ends with its first tick.
        let delay = match (&self.past.operator, holds) {
            (PastOperator::Always, true) | (PastOperator::Once | PastOperator::Since(..), false) => last,
            _ => Some(first),
        };
        // A span that ended is forgotten after the whole window.
        let forgotten = last.filter(|_| !holds);
        for delay in delay.into_iter().chain(forgotten) {
            self.agenda.add(now + delay, row);
        }
        if let PastOperator::Since(_, columns) = &self.past.operator {
            let key: Row = columns.iter().map(|&column| row[column]).collect();
            if !self.held.contains(&key) {
                self.unheld.insert(row.clone());
            }
            self.by_held.entry(key).or_default().insert(row.clone());
        }
    }

    /// Notes changes of the first predicate of `since` in tick `now`, and cuts the spans of rows for which it does not
    /// hold.
    fn note_held<'r>(&mut self, changes: impl Iterator<Item = (&'r Row, &'r bool)>, now: u64) {
        for (key, &holds) in changes {
            let rows = self.by_held.get(key).into_iter().flatten().cloned();
            if holds {
                self.held.insert(key.clone());
                rows.for_each(|row| {
                    self.unheld.remove(&row);
                });
            } else {
                self.held.remove(key);
                self.unheld.extend(rows);
            }
        }
        for row in &self.unheld {
            let Some(spans) = self.rows.get_mut(row) else { continue };
            let is_open = spans.is_open();
            self.spans -= spans.len();
            spans.clear();
            if is_open {
                spans.begin(now);
                self.spans += 1;
                self.agenda.add(now + u64::from(self.past.first), row);
            }
            self.agenda.add(now + 1, row);
        }
    }

    /// Stages the hidden rows that change in tick `now`.
    fn advance(&mut self, now: u64, staged: &mut Vec<(PredicateId, Row, bool)>) {
        while let Some(due) = self.agenda.pop(now) {
            for row in due {
                let Some(spans) = self.rows.get_mut(&row) else { continue };
                self.spans -= spans.len();
                spans.forget(&self.past, now);
                self.spans += spans.len();
                let holds = spans.holds(&self.past, now);
                if spans.is_empty() {
                    self.forget(&row);
                }
                let changed = match holds {
                    true => self.holding.insert(row.clone()),
                    false => self.holding.remove(&row),
                };
                if changed {
                    staged.push((self.past.predicate, row, holds));
                }
            }
        }
    }

    /// Drops what is known about a row without spans.
    fn forget(&mut self, row: &Row) {
        self.rows.remove(row);
        self.unheld.remove(row);
        if let PastOperator::Since(_, columns) = &self.past.operator {
            let key: Row = columns.iter().map(|&column| row[column]).collect();
            if let Some(rows) = self.by_held.get_mut(&key) {
                rows.remove(row);
                if rows.is_empty() {
                    self.by_held.remove(&key);
                }
            }
        }
    }
}
