//! The memory of a city: what temporal operators read of earlier ticks.
//!
//! Each row of agents is one bit, so one operation on a word processes 64 rows. For each row a [`Timer`] counts the
//! ticks for which its hidden predicate still holds. A plane contains one binary digit of the counters of all rows:
//!
//! ```text
//! once[1,5] P(x)            P starts the timer of x at 5
//! once[3,7] P(x)            the same, two ticks later
//! P(x) since[1,5] Q(x)      Q starts it, and a tick without P ends it
//! historically[1,5] P(x)    a tick without P starts it, and the predicate holds while it does not run
//! ```
//!
//! Pairs of many agents, and windows that begin long ago, are kept as [`Spans`] of ticks instead. Sessions of the
//! engine keep the same memory in a third form; tests compare all three.

use crate::datalog::internal::{Spans, size};
use crate::datalog::{Past, PastOperator, PredicateId};
use crate::diag::{self, Diagnostic, Limit};
use crate::sim::tick::ground::PastRows;
use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};

/// The most agents whose pairs are kept as bits.
const PAIRS_MAX: usize = 512;

/// The longest delay of a window that is kept as bits.
const DELAY_MAX: u32 = 64;

/// Rows of at most two agents, by their positions in the list. Columns that a predicate does not have contain 0.
#[derive(Clone, Debug)]
pub(crate) enum Rows {
    /// A bit for each agent or, over two agents, for each second one in `words` words for each first one; a single bit
    /// over none.
    Bits(Vec<u64>),
    /// Rows over two agents.
    List(Vec<[u32; 2]>),
}

impl Rows {
    /// Returns no rows, of a predicate with this number of columns in a city of this number of agents.
    fn new(arity: usize, agents: usize) -> Rows {
        match arity {
            2 if agents > PAIRS_MAX => Rows::List(Vec::new()),
            2 => Rows::Bits(vec![0; agents * words(agents)]),
            1 => Rows::Bits(vec![0; words(agents)]),
            _ => Rows::Bits(vec![0]),
        }
    }
}

/// Returns the number of words with a bit for each agent.
fn words(agents: usize) -> usize {
    agents.div_ceil(64)
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("fewer than 2^32 agents")
}

/// The rows that hold in the present tick for each watched predicate.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watched {
    agents: usize,
    /// The predicates, in ascending order, with their numbers of columns.
    predicates: Vec<(PredicateId, usize)>,
    /// Their rows.
    rows: Vec<Rows>,
}

impl Watched {
    /// Lists the predicates that the windows of `pasts` are about, for a city of this number of agents. `arity` returns
    /// the number of columns.
    pub fn of(pasts: &[Past], agents: usize, arity: impl Fn(PredicateId) -> usize) -> Watched {
        let all = pasts.iter().flat_map(Past::operands);
        let mut predicates: Vec<(PredicateId, usize)> = all.map(|predicate| (predicate, arity(predicate))).collect();
        predicates.sort_unstable();
        predicates.dedup();
        Watched {
            agents,
            rows: predicates.iter().map(|(_, arity)| Rows::new(*arity, agents)).collect(),
            predicates,
        }
    }

    /// Returns the predicates with their numbers of columns.
    pub fn predicates(&self) -> &[(PredicateId, usize)] {
        &self.predicates
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        for rows in &mut self.rows {
            match rows {
                Rows::Bits(bits) => bits.fill(0),
                Rows::List(list) => list.clear(),
            }
        }
    }

    /// Adds a row of the predicate at this position. Rows over two agents of a large city may come in any order.
    #[inline]
    pub fn add(&mut self, position: usize, [x, y]: [u32; 2]) {
        match &mut self.rows[position] {
            Rows::Bits(bits) if self.predicates[position].1 == 2 => {
                bits[x as usize * words(self.agents) + y as usize / 64] |= 1 << (y % 64);
            }
            Rows::Bits(bits) => bits[x as usize / 64] |= 1 << (x % 64),
            Rows::List(list) => list.push([x, y]),
        }
    }

    /// Adds the rows that begin with `x` of the predicate at this position, which has two columns; `set` has a bit for
    /// each second agent.
    pub fn add_row(&mut self, position: usize, x: usize, set: &[u64]) {
        let words = words(self.agents);
        match &mut self.rows[position] {
            Rows::Bits(bits) => bits[x * words..][..words].copy_from_slice(&set[..words]),
            Rows::List(list) => {
                let others = (0..self.agents).filter(|y| set[y / 64] >> (y % 64) & 1 != 0);
                list.extend(others.map(|y| [number(x), number(y)]));
            }
        }
    }

    /// Sets the rows of the predicate at this position, which has at most one column; `set` has a bit for each agent.
    pub fn set(&mut self, position: usize, set: &[u64]) {
        if let Rows::Bits(bits) = &mut self.rows[position] {
            let words = bits.len();
            bits.copy_from_slice(&set[..words]);
        }
    }

    /// Sorts the rows, as [`Memory::advance`] needs them.
    pub fn sort(&mut self) {
        for rows in &mut self.rows {
            if let Rows::List(list) = rows {
                list.sort_unstable();
            }
        }
    }

    fn position(&self, predicate: PredicateId) -> usize {
        let found = self.predicates.binary_search_by_key(&predicate, |(known, _)| *known);
        found.expect("it is watched")
    }

    /// Returns whether the predicate at this position has the row.
    #[inline]
    fn holds(&self, position: usize, [x, y]: [u32; 2]) -> bool {
        match &self.rows[position] {
            Rows::Bits(bits) if self.predicates[position].1 == 2 => {
                bits[x as usize * words(self.agents) + y as usize / 64] >> (y % 64) & 1 != 0
            }
            Rows::Bits(bits) => bits[x as usize / 64] >> (x % 64) & 1 != 0,
            Rows::List(list) => list.binary_search(&[x, y]).is_ok(),
        }
    }
}

/// What the present tick can read of earlier ones.
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    agents: usize,
    /// The number of ticks so far.
    ticks: u64,
    records: Vec<Record>,
}

/// The memory of one hidden predicate.
#[derive(Clone, Debug)]
struct Record {
    past: Past,
    /// The positions in [`Watched`] of the operand and of the predicate before `since`.
    operand: usize,
    held: Option<usize>,
    arity: usize,
    kept: Kept,
}

#[derive(Clone, Debug)]
enum Kept {
    Timer(Timer),
    Spans {
        rows: BTreeMap<[u32; 2], Spans>,
        /// The number of all spans.
        count: usize,
    },
}

/// A counter for each row of a predicate, as [`Rows::Bits`].
#[derive(Clone, Debug)]
struct Timer {
    /// The tick nearest to the present in the window: the number of ticks before the present, at least 1.
    first: u32,
    /// The number of ticks for which an event counts; `None` for all later ones.
    length: Option<u32>,
    /// The digits of the counters, the lowest first; none if events never end.
    planes: Vec<Vec<u64>>,
    /// The rows whose counter is not 0, or that had an event that never ends.
    running: Vec<u64>,
    /// Events that wait for the first tick of the window, the oldest first.
    delayed: VecDeque<Vec<u64>>,
    /// If events never end: the tick of the event that started the timer of each row.
    begun: Vec<u64>,
    /// The bits that stand for rows.
    rows: Vec<u64>,
    /// Whether the hidden predicate holds while the timer does not run.
    inverse: bool,
    /// The rows for which it holds.
    holding: Vec<u64>,
    /// Buffers.
    event: Vec<u64>,
    borrow: Vec<u64>,
}

impl Timer {
    fn bytes(&self) -> usize {
        // Running, rows, holding and two buffers.
        let planes = self.planes.len() + self.delayed.len() + 5;
        (planes * self.rows.len() + self.begun.len()) * size_of::<u64>()
    }

    fn new(past: &Past, arity: usize, agents: usize) -> Timer {
        let row: Vec<u64> = (0..words(agents)).map(|word| low_bits(agents - word * 64)).collect();
        let rows = match arity {
            2 => row.repeat(agents),
            1 => row,
            _ => vec![1],
        };
        let length = past.last.map(|last| last - past.first + 1);
        let digits = length.map_or(0, |length| u32::BITS - length.leading_zeros());
        let empty = vec![0; rows.len()];
        let mut timer = Timer {
            first: past.first,
            length,
            planes: vec![empty.clone(); digits as usize],
            running: empty.clone(),
            delayed: vec![empty.clone(); past.first as usize - 1].into(),
            begun: match length {
                Some(_) => Vec::new(),
                None => vec![0; rows.len() * 64],
            },
            inverse: past.operator == PastOperator::Always,
            holding: empty.clone(),
            event: empty.clone(),
            borrow: empty,
            rows,
        };
        timer.clear();
        timer
    }

    /// Forgets all ticks.
    fn clear(&mut self) {
        // Before the first tick nothing held. So for `historically`, each row had an event in each tick.
        let before = |rows: u64| if self.inverse { rows } else { 0 };
        for (running, rows) in self.running.iter_mut().zip(&self.rows) {
            *running = before(*rows);
        }
        let (running, length) = (&self.running, self.length.unwrap_or(0));
        for (digit, plane) in self.planes.iter_mut().enumerate() {
            match length >> digit & 1 {
                0 => plane.fill(0),
                _ => plane.copy_from_slice(running),
            }
        }
        self.delayed
            .iter_mut()
            .for_each(|events| events.copy_from_slice(running));
        self.holding.fill(0);
    }

    /// Ends a tick with these rows of the operand. `keep` are the rows for which earlier events count.
    fn advance(&mut self, operand: &[u64], keep: Option<&[u64]>, ended: u64) {
        if let Some(keep) = keep {
            for kept in self
                .delayed
                .iter_mut()
                .chain(&mut self.planes)
                .chain([&mut self.running])
            {
                kept.iter_mut().zip(keep).for_each(|(kept, keep)| *kept &= keep);
            }
        }
        let mut event = std::mem::take(&mut self.event);
        for ((event, operand), rows) in event.iter_mut().zip(operand).zip(&self.rows) {
            *event = if self.inverse { rows & !operand } else { *operand };
        }
        if let Some(oldest) = self.delayed.pop_front() {
            self.delayed.push_back(std::mem::replace(&mut event, oldest));
        }
        match self.length {
            Some(length) => self.count(&event, length),
            // Before that tick there are no events.
            None => self.begin(&event, (ended + 1).saturating_sub(u64::from(self.first))),
        }
        self.event = event;
        for ((holding, running), rows) in self.holding.iter_mut().zip(&self.running).zip(&self.rows) {
            *holding = if self.inverse { rows & !running } else { *running };
        }
    }

    /// Counts down, and starts the timers of rows with an event.
    fn count(&mut self, event: &[u64], length: u32) {
        self.borrow.copy_from_slice(&self.running);
        self.running.fill(0);
        for (digit, plane) in self.planes.iter_mut().enumerate() {
            let start = if length >> digit & 1 != 0 { u64::MAX } else { 0 };
            let words = plane.iter_mut().zip(event).zip(&mut self.borrow).zip(&mut self.running);
            for (((digit, event), borrow), running) in words {
                let before = *digit;
                *digit = (before ^ *borrow) & !event | event & start;
                *borrow &= !before;
                *running |= *digit;
            }
        }
    }

    /// Starts the timers, which never end, of rows with an event in this tick.
    fn begin(&mut self, event: &[u64], tick: u64) {
        for (word, (event, running)) in event.iter().zip(&mut self.running).enumerate() {
            let mut new = event & !*running;
            *running |= event;
            while new != 0 {
                self.begun[word * 64 + new.trailing_zeros() as usize] = tick;
                new &= new - 1;
            }
        }
    }

    /// Returns the tick that explains a row that holds, given by the position of its bit.
    fn witness(&self, bit: usize, now: u64) -> u64 {
        let Some(length) = self.length else {
            return self.begun[bit];
        };
        let window = u64::from(self.first) + u64::from(length);
        if self.inverse {
            return now + 1 - window;
        }
        let digits = self.planes.iter().enumerate();
        let left = digits.map(|(digit, plane)| (plane[bit / 64] >> (bit % 64) & 1) << digit);
        // It started with the whole length, and since then one was taken off in each tick.
        now + left.sum::<u64>() - window
    }
}

impl Memory {
    /// Returns the memory of a city before its first tick; `watched` are the rows of the same city.
    ///
    /// # Errors
    /// `limit-exceeded` if it takes more than `limit` bytes.
    pub fn new(pasts: &[Past], watched: &Watched, limit: u64) -> Result<Memory, Diagnostic> {
        let agents = watched.agents;
        let record = |past: &Past| {
            let operand = watched.position(past.operand);
            let arity = watched.predicates[operand].1;
            let are_bits = matches!(watched.rows[operand], Rows::Bits(_)) && past.first <= DELAY_MAX;
            Record {
                past: past.clone(),
                operand,
                held: match past.operator {
                    PastOperator::Since(held, _) => Some(watched.position(held)),
                    PastOperator::Once | PastOperator::Always => None,
                },
                arity,
                kept: match are_bits {
                    true => Kept::Timer(Timer::new(past, arity, agents)),
                    false => Kept::Spans {
                        rows: BTreeMap::new(),
                        count: 0,
                    },
                },
            }
        };
        let mut memory = Memory {
            agents,
            ticks: 0,
            records: Vec::new(),
        };
        for past in pasts {
            memory.records.push(record(past));
            memory.check(limit)?;
        }
        Ok(memory)
    }

    /// Returns whether there is nothing to remember.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Returns the number of ticks that the memory contains.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Forgets all ticks.
    pub fn clear(&mut self) {
        self.ticks = 0;
        for record in &mut self.records {
            match &mut record.kept {
                Kept::Timer(timer) => timer.clear(),
                Kept::Spans { rows, count } => {
                    rows.clear();
                    *count = 0;
                }
            }
        }
    }

    /// Checks that the memory takes at most `limit` bytes.
    ///
    /// # Errors
    /// `limit-exceeded`.
    pub fn check(&self, limit: u64) -> Result<(), Diagnostic> {
        if self.records.iter().map(Record::bytes).sum::<usize>() as u64 <= limit {
            return Ok(());
        }
        let message = format!("what the rules read of earlier ticks takes more than {}", size(limit));
        let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).exceeds(Limit::Memory(limit));
        Err(fault.help("write shorter windows, or use fewer agents"))
    }

    /// Ends a tick in which these rows held; they are [sorted](Watched::sort).
    pub fn advance(&mut self, watched: &Watched) {
        for record in &mut self.records {
            record.advance(watched, self.ticks);
        }
        self.ticks += 1;
    }

    /// Returns the agents for which a hidden predicate over at most one agent holds, one bit each; `None` if they are not
    /// kept so.
    #[inline]
    pub fn holding(&self, past: usize) -> Option<&[u64]> {
        match &self.records[past].kept {
            Kept::Timer(timer) => Some(&timer.holding),
            Kept::Spans { .. } => None,
        }
    }

    /// Returns the agents to which a hidden predicate relates agent `x`, one bit each; `None` if they are not kept so.
    #[inline]
    pub fn holding_row(&self, past: usize, x: usize) -> Option<&[u64]> {
        let words = words(self.agents);
        Some(&self.holding(past)?[x * words..][..words])
    }

    /// Returns whether a hidden predicate over at most one agent holds for this one.
    #[inline]
    pub fn holds_alone(&self, past: usize, agent: u32) -> bool {
        match self.holding(past) {
            Some(holding) => holding[agent as usize / 64] >> (agent % 64) & 1 != 0,
            None => self.holds_spans(past, [agent, 0]),
        }
    }

    /// Returns whether a hidden predicate over two agents holds for these.
    #[inline]
    pub fn holds(&self, past: usize, x: u32, y: u32) -> bool {
        match self.holding_row(past, x as usize) {
            Some(row) => row[y as usize / 64] >> (y % 64) & 1 != 0,
            None => self.holds_spans(past, [x, y]),
        }
    }

    fn holds_spans(&self, past: usize, row: [u32; 2]) -> bool {
        let record = &self.records[past];
        match &record.kept {
            Kept::Spans { rows, .. } => rows
                .get(&row)
                .is_some_and(|spans| spans.holds(&record.past, self.ticks)),
            Kept::Timer(_) => false,
        }
    }

    /// Returns the rows of each hidden predicate, sorted, with the ticks that explain them: a tick of the window in which
    /// the operand held, or the first one if it held in all.
    pub fn rows(&self) -> Vec<PastRows> {
        self.rows_of(|_| true)
    }

    /// Variant of [`rows`](Memory::rows) that leaves predicates without rows unless `wanted` selects their positions.
    pub fn rows_of(&self, wanted: impl Fn(usize) -> bool) -> Vec<PastRows> {
        let records = self.records.iter().enumerate();
        let rows = |(position, record): (usize, &Record)| match wanted(position) {
            true => record.rows(self.agents, self.ticks),
            false => PastRows::new(),
        };
        records.map(rows).collect()
    }

    /// Returns the [rows](Memory::rows) over some of the agents.
    pub fn rows_among(&self, agents: &[u32]) -> Vec<PastRows> {
        let mut all = self.rows();
        for (rows, record) in all.iter_mut().zip(&self.records) {
            rows.retain(|(row, _)| row[..record.arity].iter().all(|agent| agents.contains(agent)));
        }
        all
    }
}

impl Record {
    fn bytes(&self) -> usize {
        /// The bytes of a row in a map, besides its spans.
        const ROW: usize = 48;
        match &self.kept {
            Kept::Timer(timer) => timer.bytes(),
            Kept::Spans { rows, count } => rows.len() * ROW + count * size_of::<(u64, u64)>(),
        }
    }

    fn advance(&mut self, watched: &Watched, ended: u64) {
        let keep = match (&self.past.operator, self.held) {
            (PastOperator::Since(_, columns), Some(held)) => Some((held, columns.as_slice())),
            _ => None,
        };
        match (&mut self.kept, &watched.rows[self.operand]) {
            (Kept::Timer(timer), Rows::Bits(operand)) => {
                let keep = keep.map(|(held, columns)| kept_rows(watched, held, columns, self.arity));
                timer.advance(operand, keep.as_deref(), ended);
            }
            (Kept::Spans { rows, count }, operand) => {
                let holds = |row: [u32; 2]| watched.holds(self.operand, row);
                let keeps = |row: [u32; 2]| keep.is_none_or(|(held, columns)| watched.holds(held, key(row, columns)));
                match operand {
                    Rows::List(list) => list.iter().for_each(|row| _ = rows.entry(*row).or_default()),
                    Rows::Bits(bits) => {
                        set_rows(bits, watched.agents, self.arity).for_each(|row| _ = rows.entry(row).or_default());
                    }
                }
                *count = 0;
                rows.retain(|row, spans| {
                    if !keeps(*row) {
                        spans.clear();
                    }
                    if holds(*row) {
                        spans.add(ended);
                    }
                    spans.forget(&self.past, ended + 1);
                    *count += spans.len();
                    !spans.is_empty()
                });
            }
            (Kept::Timer(_), Rows::List(_)) => unreachable!("a timer is made for rows as bits"),
        }
    }

    fn rows(&self, agents: usize, now: u64) -> PastRows {
        match &self.kept {
            Kept::Timer(timer) => {
                let stride = if self.arity == 2 { words(agents) * 64 } else { 0 };
                let bit = |[x, y]: [u32; 2]| match stride {
                    0 => x as usize,
                    stride => x as usize * stride + y as usize,
                };
                let rows = set_rows(&timer.holding, agents, self.arity);
                rows.map(|row| (row, timer.witness(bit(row), now))).collect()
            }
            Kept::Spans { rows, .. } => {
                let holding = rows.iter().filter(|(_, spans)| spans.holds(&self.past, now));
                let witness = |spans: &Spans| spans.witness(&self.past, now).expect("it holds");
                holding.map(|(row, spans)| (*row, witness(spans))).collect()
            }
        }
    }
}

/// Returns the rows whose bits are set, in order.
fn set_rows(bits: &[u64], agents: usize, arity: usize) -> impl Iterator<Item = [u32; 2]> {
    let words = words(agents).max(1);
    let set = bits.iter().enumerate().flat_map(|(word, bits)| {
        let bits = *bits;
        (0..64)
            .filter(move |bit| bits >> bit & 1 != 0)
            .map(move |bit| (word, bit))
    });
    set.map(move |(word, bit)| match arity {
        2 => [number(word / words), number(word % words * 64 + bit)],
        _ => [number(word * 64 + bit), 0],
    })
}

/// Returns the row of the predicate before `since`, whose columns are these columns of a row.
fn key(row: [u32; 2], columns: &[usize]) -> [u32; 2] {
    let mut key = [0; 2];
    for (value, column) in key.iter_mut().zip(columns) {
        *value = row[*column];
    }
    key
}

/// Returns, as bits, the rows over `arity` agents for which the predicate before `since` holds.
fn kept_rows<'a>(watched: &'a Watched, held: usize, columns: &[usize], arity: usize) -> Cow<'a, [u64]> {
    let (agents, words) = (watched.agents, words(watched.agents));
    let Rows::Bits(bits) = &watched.rows[held] else {
        unreachable!("the predicate has no more columns than the operand");
    };
    match (arity, columns) {
        (2, [0, 1]) | (1, [0]) | (0, []) => bits.into(),
        (2, [1]) => bits.repeat(agents).into(),
        (2, [0]) => {
            let row = |x: usize| if bits[x / 64] >> (x % 64) & 1 != 0 { u64::MAX } else { 0 };
            (0..agents).flat_map(|x| std::iter::repeat_n(row(x), words)).collect()
        }
        _ => {
            let mut kept = Rows::new(arity, agents);
            let firsts = if arity == 0 { 1 } else { agents };
            let seconds = if arity == 2 { agents } else { 1 };
            if let Rows::Bits(kept) = &mut kept {
                for (x, y) in (0..firsts).flat_map(|x| (0..seconds).map(move |y| (x, y))) {
                    let holds = watched.holds(held, key([number(x), number(y)], columns));
                    let (word, bit) = if arity == 2 {
                        (x * words + y / 64, y % 64)
                    } else {
                        (x / 64, x % 64)
                    };
                    kept[word] |= u64::from(holds) << bit;
                }
                return std::mem::take(kept).into();
            }
            unreachable!("a timer is made for rows as bits")
        }
    }
}

/// Returns a word whose lowest `count` bits are set; all bits from 64 on.
fn low_bits(count: usize) -> u64 {
    match count {
        64.. => u64::MAX,
        count => (1 << count) - 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, RngExt, Seed};

    /// Whether a row holds in the tick after these, by the words of the language reference.
    fn specified(past: &Past, operand: &[bool], held: &[bool]) -> bool {
        let now = operand.len();
        let window = past.first as usize..=past.last.map_or(now, |last| last as usize).min(now);
        let ticks = || window.clone().map(|ago| now - ago);
        match past.operator {
            PastOperator::Once => ticks().any(|tick| operand[tick]),
            PastOperator::Always => past.last.unwrap() as usize <= now && ticks().all(|tick| operand[tick]),
            PastOperator::Since(..) => ticks().any(|tick| operand[tick] && held[tick + 1..].iter().all(|held| *held)),
        }
    }

    #[test]
    fn timers_and_spans_agree_with_the_whole_history() {
        let mut counts = [0; 2];
        for case in 0..240 {
            let mut random = Seed(case).stream(Purpose::TEST, 0, 0);
            // Pairs of so many agents are no bits.
            let agents = if case % 60 == 0 {
                PAIRS_MAX + 3
            } else {
                [3, 64, 70][case as usize % 3]
            };
            let arity = random.random_range(0..3);
            let first = [1, 2, 5, DELAY_MAX + 1][random.random_range(0..4)];
            let last = first + random.random_range(0..9);
            let columns: Vec<usize> = match arity {
                2 => [vec![], vec![0], vec![1], vec![0, 1], vec![1, 0]][random.random_range(0..5)].clone(),
                1 => [vec![], vec![0]][random.random_range(0..2)].clone(),
                _ => vec![],
            };
            let [operand, held] = [PredicateId(1), PredicateId(2)];
            let since = PastOperator::Since(held, columns.clone());
            let (operator, last) = match random.random_range(0..5) {
                0 => (PastOperator::Once, None),
                1 => (PastOperator::Once, Some(last)),
                2 => (PastOperator::Always, Some(last)),
                3 => (since, None),
                _ => (since, Some(last)),
            };
            let past = Past {
                predicate: PredicateId(0),
                operand,
                operator,
                first,
                last,
            };
            let arity_of = |predicate| if predicate == operand { arity } else { columns.len() };
            let mut watched = Watched::of(std::slice::from_ref(&past), agents, arity_of);
            let mut memory = Memory::new(std::slice::from_ref(&past), &watched, u64::MAX).unwrap();
            let row = |random: &mut dyn FnMut() -> u32, arity: usize| -> [u32; 2] {
                let mut row = [0; 2];
                row[..arity]
                    .iter_mut()
                    .for_each(|agent| *agent = random() % agents.min(3) as u32);
                row
            };
            let mut histories: BTreeMap<[u32; 2], (Vec<bool>, Vec<bool>)> = BTreeMap::new();
            for _ in 0..8 {
                let mut draw = || random.random_range(0..3);
                histories.entry(row(&mut draw, arity)).or_default();
            }
            for tick in 0..u64::from(first) + 24 {
                let mut keys: BTreeMap<[u32; 2], bool> = BTreeMap::new();
                watched.clear();
                for (row, (held_in, kept_in)) in &mut histories {
                    let holds = random.random_bool(0.5);
                    held_in.push(holds);
                    let kept = *keys
                        .entry(key(*row, &columns))
                        .or_insert_with(|| random.random_bool(0.8));
                    kept_in.push(kept);
                    if holds {
                        watched.add(watched.position(operand), *row);
                    }
                }
                if let PastOperator::Since(..) = past.operator {
                    let kept = keys.iter().filter(|(_, kept)| **kept);
                    kept.for_each(|(key, _)| watched.add(watched.position(held), *key));
                }
                watched.sort();
                memory.advance(&watched);
                let found = memory.rows().remove(0);
                let expected: Vec<[u32; 2]> = (histories.iter())
                    .filter(|(_, (operand, held))| specified(&past, operand, held))
                    .map(|(row, _)| *row)
                    .collect();
                let rows: Vec<[u32; 2]> = found.iter().map(|(row, _)| *row).collect();
                assert_eq!(rows, expected, "tick {tick} of case {case}: {past:?}");
                for (row, witness) in found {
                    let ago = memory.ticks() - witness;
                    let window = u64::from(past.first)..=past.last.map_or(u64::MAX, u64::from);
                    assert!(
                        window.contains(&ago) && histories[&row].0[witness as usize],
                        "{past:?} {witness}"
                    );
                    let holds = match arity {
                        2 => memory.holds(0, row[0], row[1]),
                        _ => memory.holds_alone(0, row[0]),
                    };
                    assert!(holds);
                }
                counts[0] += histories.len() - expected.len();
                counts[1] += expected.len();
            }
            memory.clear();
            assert!(memory.rows()[0].is_empty());
        }
        assert!(counts.iter().all(|count| *count > 5000), "{counts:?}");
    }
}
