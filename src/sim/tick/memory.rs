//! The memory of a city: what temporal operators read of earlier ticks.
//!
//! Each row of a [`Past`] has a register. A short window is a shift register of bits: bit `i` tells about the tick `i + 1`
//! ticks before the present one. For a longer window, and for one without an end, the register lists the spans of ticks
//! in which the operand held. Sessions keep the same memory in another form; tests compare both.

use crate::datalog::{Past, PastOperator, PredicateId};
use std::collections::BTreeMap;

/// The longest window, in ticks, that a shift register covers.
const BITS: u32 = u64::BITS;

/// Rows of agents, by their positions in the list. Columns that a predicate does not have contain 0.
pub(crate) type AgentRows = Vec<[u32; 2]>;

/// The rows that hold in the present tick for each watched predicate.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watched {
    /// The predicates, in ascending order, with their numbers of columns.
    predicates: Vec<(PredicateId, usize)>,
    /// Their rows.
    pub rows: Vec<AgentRows>,
}

impl Watched {
    /// Lists the predicates that the windows of `pasts` are about. `arity` returns the number of columns.
    pub fn of(pasts: &[Past], arity: impl Fn(PredicateId) -> usize) -> Watched {
        let held = |past: &Past| match past.operator {
            PastOperator::Since(held, _) => Some(held),
            PastOperator::Once | PastOperator::Always => None,
        };
        let all = pasts
            .iter()
            .flat_map(|past| held(past).into_iter().chain([past.operand]));
        let mut predicates: Vec<(PredicateId, usize)> = all.map(|predicate| (predicate, arity(predicate))).collect();
        predicates.sort_unstable();
        predicates.dedup();
        Watched {
            rows: vec![AgentRows::new(); predicates.len()],
            predicates,
        }
    }

    /// Returns the predicates with their numbers of columns.
    pub fn predicates(&self) -> &[(PredicateId, usize)] {
        &self.predicates
    }

    pub fn clear(&mut self) {
        self.rows.iter_mut().for_each(Vec::clear);
    }

    /// Sorts the rows over two agents, as [`Memory::advance`] needs them.
    pub fn sort(&mut self) {
        for (rows, (_, arity)) in self.rows.iter_mut().zip(&self.predicates) {
            if *arity == 2 && !rows.is_sorted() {
                rows.sort_unstable();
            }
        }
    }

    fn position(&self, predicate: PredicateId) -> usize {
        let found = self.predicates.binary_search_by_key(&predicate, |(known, _)| *known);
        found.expect("it is watched")
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
    registers: Registers,
    /// For a predicate over at most one agent, the agents for which it holds, one bit each.
    holding: Vec<u64>,
}

#[derive(Clone, Debug)]
enum Registers {
    /// Over at most one agent: a register for each agent.
    Bits(Vec<u64>),
    /// Over at most one agent, with a long window.
    Spans(Vec<Spans>),
    /// Over two agents: for each first one the second ones in ascending order, with their registers.
    PairBits(Vec<Vec<(u32, u64)>>),
    /// Over two agents, with a long window.
    PairSpans(Vec<BTreeMap<u32, Spans>>),
}

/// The spans of ticks in which a row held, in order: the first and the last tick of each.
type Spans = Vec<(u64, u64)>;

impl Memory {
    /// Creates the memory of a city of this number of agents before its first tick.
    pub fn new(pasts: &[Past], watched: &Watched, agents: usize) -> Memory {
        let record = |past: &Past| {
            let operand = watched.position(past.operand);
            let arity = watched.predicates[operand].1;
            let short = past.last.is_some_and(|last| last <= BITS);
            Record {
                past: past.clone(),
                operand,
                held: match past.operator {
                    PastOperator::Since(held, _) => Some(watched.position(held)),
                    PastOperator::Once | PastOperator::Always => None,
                },
                arity,
                registers: match (arity == 2, short) {
                    (false, true) => Registers::Bits(vec![0; agents]),
                    (false, false) => Registers::Spans(vec![Spans::new(); agents]),
                    (true, true) => Registers::PairBits(vec![Vec::new(); agents]),
                    (true, false) => Registers::PairSpans(vec![BTreeMap::new(); agents]),
                },
                holding: vec![0; agents.div_ceil(64)],
            }
        };
        Memory {
            agents,
            ticks: 0,
            records: pasts.iter().map(record).collect(),
        }
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
            record.holding.fill(0);
            match &mut record.registers {
                Registers::Bits(bits) => bits.fill(0),
                Registers::Spans(spans) => spans.iter_mut().for_each(Vec::clear),
                Registers::PairBits(rows) => rows.iter_mut().for_each(Vec::clear),
                Registers::PairSpans(rows) => rows.iter_mut().for_each(BTreeMap::clear),
            }
        }
    }

    /// Ends a tick in which these rows held; they are [sorted](Watched::sort).
    pub fn advance(&mut self, watched: &Watched) {
        let sets: Vec<Vec<u64>> = (watched.rows.iter().zip(&watched.predicates))
            .map(|(rows, (_, arity))| match arity {
                2 => Vec::new(),
                _ => set_of(rows, self.agents),
            })
            .collect();
        let ended = self.ticks;
        self.ticks += 1;
        for record in &mut self.records {
            record.advance(watched, &sets, ended);
        }
    }

    /// Returns whether a hidden predicate over at most one agent holds for this one.
    #[inline]
    pub fn holds_alone(&self, past: usize, agent: u32) -> bool {
        self.records[past].holding[agent as usize / 64] >> (agent % 64) & 1 != 0
    }

    /// Returns whether a hidden predicate over two agents holds for these.
    #[inline]
    pub fn holds(&self, past: usize, x: u32, y: u32) -> bool {
        let record = &self.records[past];
        match &record.registers {
            Registers::PairBits(rows) => {
                let row = &rows[x as usize];
                let found = row.binary_search_by_key(&y, |(other, _)| *other);
                found.is_ok_and(|found| record.past.holds_bits(row[found].1))
            }
            Registers::PairSpans(rows) => {
                let spans = rows[x as usize].get(&y);
                spans.is_some_and(|spans| record.past.holds_spans(spans, self.ticks))
            }
            Registers::Bits(_) | Registers::Spans(_) => false,
        }
    }

    /// Returns the rows of each hidden predicate, sorted, with the ticks that explain them: the nearest tick of the
    /// window in which the operand held, or the first one if it held in all.
    pub fn rows(&self) -> Vec<Vec<([u32; 2], u64)>> {
        self.records.iter().map(|record| record.rows(self.ticks)).collect()
    }

    /// Returns the [rows](Memory::rows) over some of the agents.
    pub fn rows_among(&self, agents: &[u32]) -> Vec<Vec<([u32; 2], u64)>> {
        let mut all = self.rows();
        for (rows, record) in all.iter_mut().zip(&self.records) {
            let arity = record.arity;
            rows.retain(|(row, _)| row[..arity].iter().all(|agent| agents.contains(agent)));
        }
        all
    }
}

impl Record {
    fn rows(&self, now: u64) -> Vec<([u32; 2], u64)> {
        let number = |index: usize| u32::try_from(index).expect("fewer than 2^32 agents");
        let of_bits = |row: [u32; 2], bits: u64| Some((row, self.past.witness_bits(bits, now)?));
        let of_spans = |row: [u32; 2], spans: &Spans| Some((row, self.past.witness_spans(spans, now)?));
        match &self.registers {
            Registers::Bits(all) => {
                let rows = all.iter().enumerate();
                rows.filter_map(|(agent, bits)| of_bits([number(agent), 0], *bits))
                    .collect()
            }
            Registers::Spans(all) => {
                let rows = all.iter().enumerate();
                rows.filter_map(|(agent, spans)| of_spans([number(agent), 0], spans))
                    .collect()
            }
            Registers::PairBits(all) => {
                let rows = all.iter().enumerate();
                let pairs = rows.flat_map(|(x, row)| row.iter().map(move |(y, bits)| ([number(x), *y], *bits)));
                pairs.filter_map(|(row, bits)| of_bits(row, bits)).collect()
            }
            Registers::PairSpans(all) => {
                let rows = all.iter().enumerate();
                let pairs = rows.flat_map(|(x, row)| row.iter().map(move |(y, spans)| ([number(x), *y], spans)));
                pairs.filter_map(|(row, spans)| of_spans(row, spans)).collect()
            }
        }
    }

    fn advance(&mut self, watched: &Watched, sets: &[Vec<u64>], ended: u64) {
        let Record {
            past,
            operand,
            held,
            registers,
            holding,
            ..
        } = self;
        // Whether the row before `since` held, for a row of the operand.
        let keeps = |row: [u32; 2]| {
            let (Some(held), PastOperator::Since(_, columns)) = (*held, &past.operator) else {
                return true;
            };
            let mut key = [0; 2];
            for (value, column) in key.iter_mut().zip(columns) {
                *value = row[*column];
            }
            match watched.predicates[held].1 {
                2 => watched.rows[held].binary_search(&key).is_ok(),
                _ => sets[held][key[0] as usize / 64] >> (key[0] % 64) & 1 != 0,
            }
        };
        let set = &sets[*operand];
        let number = |agent: usize| u32::try_from(agent).expect("fewer than 2^32 agents");
        match registers {
            Registers::Bits(bits) => {
                holding.fill(0);
                for (agent, bits) in bits.iter_mut().enumerate() {
                    let kept = if keeps([number(agent), 0]) { *bits << 1 } else { 0 };
                    *bits = kept | (set[agent / 64] >> (agent % 64) & 1);
                    holding[agent / 64] |= u64::from(past.holds_bits(*bits)) << (agent % 64);
                }
            }
            Registers::Spans(all) => {
                holding.fill(0);
                for (agent, spans) in all.iter_mut().enumerate() {
                    let holds = set[agent / 64] >> (agent % 64) & 1 != 0;
                    past.extend(spans, holds, keeps([number(agent), 0]), ended);
                    holding[agent / 64] |= u64::from(past.holds_spans(spans, ended + 1)) << (agent % 64);
                }
            }
            Registers::PairBits(all) => {
                let mut rows = watched.rows[*operand].as_slice();
                for (x, known) in all.iter_mut().enumerate() {
                    let x = number(x);
                    let (own, rest) = rows.split_at(rows.partition_point(|row| row[0] <= x));
                    rows = rest;
                    for (y, bits) in known.iter_mut() {
                        *bits = if keeps([x, *y]) { *bits << 1 } else { 0 };
                    }
                    for [_, y] in own {
                        match known.binary_search_by_key(y, |(other, _)| *other) {
                            Ok(place) => known[place].1 |= 1,
                            Err(place) => known.insert(place, (*y, 1)),
                        }
                    }
                    let reach = past.reach();
                    known.retain(|(_, bits)| bits & reach != 0);
                }
            }
            Registers::PairSpans(all) => {
                let mut rows = watched.rows[*operand].as_slice();
                for (x, known) in all.iter_mut().enumerate() {
                    let x = number(x);
                    let (own, rest) = rows.split_at(rows.partition_point(|row| row[0] <= x));
                    rows = rest;
                    own.iter().for_each(|[_, y]| _ = known.entry(*y).or_default());
                    known.retain(|y, spans| {
                        let holds = own.binary_search(&[x, *y]).is_ok();
                        past.extend(spans, holds, keeps([x, *y]), ended);
                        !spans.is_empty()
                    });
                }
            }
        }
    }
}

/// Whether the register of a row says that the hidden predicate holds.
trait Window {
    /// Returns the bits of a shift register that the window may contain now or later.
    fn reach(&self) -> u64;
    /// Returns the bits that are in the window.
    fn bits(&self) -> u64;
    fn holds_bits(&self, bits: u64) -> bool;
    fn holds_spans(&self, spans: &Spans, now: u64) -> bool;
    /// Returns the tick that explains a row, if it holds; see [`Memory::rows`].
    fn witness_bits(&self, bits: u64, now: u64) -> Option<u64>;
    fn witness_spans(&self, spans: &Spans, now: u64) -> Option<u64>;
    /// Adds the tick that ended, in which the row held or not, and forgets what no later window contains. `keeps`:
    /// whether earlier ticks count.
    fn extend(&self, spans: &mut Spans, holds: bool, keeps: bool, ended: u64);
}

impl Window for Past {
    #[inline]
    fn reach(&self) -> u64 {
        u64::MAX >> (BITS - self.last.unwrap_or(BITS).min(BITS))
    }

    #[inline]
    fn bits(&self) -> u64 {
        self.reach() & (u64::MAX << (self.first - 1))
    }

    #[inline]
    fn holds_bits(&self, bits: u64) -> bool {
        match self.operator {
            PastOperator::Always => !bits & self.bits() == 0,
            PastOperator::Once | PastOperator::Since(..) => bits & self.bits() != 0,
        }
    }

    fn holds_spans(&self, spans: &Spans, now: u64) -> bool {
        let Some(to) = now.checked_sub(u64::from(self.first)) else {
            return false;
        };
        let from = self.last.map(|last| now.checked_sub(u64::from(last)));
        match self.operator {
            PastOperator::Always => {
                let covers = |from: u64| spans.iter().any(|span| span.0 <= from && to <= span.1);
                from.flatten().is_some_and(covers)
            }
            PastOperator::Once | PastOperator::Since(..) => {
                let from = from.flatten().unwrap_or(0);
                spans.iter().any(|span| span.0 <= to && from <= span.1)
            }
        }
    }

    fn witness_bits(&self, bits: u64, now: u64) -> Option<u64> {
        let nearest = match self.operator {
            PastOperator::Always => self.last?,
            PastOperator::Once | PastOperator::Since(..) => (bits & self.bits()).trailing_zeros() + 1,
        };
        self.holds_bits(bits).then(|| now - u64::from(nearest))
    }

    fn witness_spans(&self, spans: &Spans, now: u64) -> Option<u64> {
        if !self.holds_spans(spans, now) {
            return None;
        }
        let nearest = now - u64::from(self.first);
        match self.operator {
            PastOperator::Always => Some(now - u64::from(self.last?)),
            PastOperator::Once | PastOperator::Since(..) => {
                let span = spans.iter().rfind(|span| span.0 <= nearest);
                span.map(|span| span.1.min(nearest))
            }
        }
    }

    fn extend(&self, spans: &mut Spans, holds: bool, keeps: bool, ended: u64) {
        if !keeps {
            spans.clear();
        }
        match spans.last_mut() {
            Some(last) if holds && last.1 + 1 == ended => last.1 = ended,
            _ if holds => spans.push((ended, ended)),
            _ => {}
        }
        let now = ended + 1;
        let from = self.last.map_or(0, |last| now.saturating_sub(u64::from(last)));
        spans.retain(|span| span.1 >= from);
        if self.operator != PastOperator::Always {
            // If an earlier span is in the window, so is the last one that began before its end.
            let to = now.checked_sub(u64::from(self.first));
            let begun = to.and_then(|to| spans.iter().rposition(|span| span.0 <= to));
            spans.drain(..begun.unwrap_or(0));
        }
    }
}

/// Returns the agents of rows over one agent, one bit each.
fn set_of(rows: &[[u32; 2]], agents: usize) -> Vec<u64> {
    let mut set = vec![0; agents.div_ceil(64)];
    for [agent, _] in rows {
        set[*agent as usize / 64] |= 1 << (agent % 64);
    }
    set
}
