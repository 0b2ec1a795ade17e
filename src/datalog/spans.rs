//! The spans of ticks in which a row held, and what temporal operators read of them.

use crate::check::{Past, PastOperator};

/// The end of a span that has not ended.
const OPEN: u64 = u64::MAX;

/// The spans of ticks in which a row held, in order: the first and the last tick of each.
#[derive(Clone, Debug, Default)]
pub struct Spans(Vec<(u64, u64)>);

impl Spans {
    /// Returns the number of spans.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether the row never held, or no later window contains a tick in which it did.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Begins a span that contains this tick and all later ones.
    pub fn begin(&mut self, tick: u64) {
        self.0.push((tick, OPEN));
    }

    /// Ends the last span with this tick. A damaged file may have lost it.
    pub fn end(&mut self, tick: u64) {
        if let Some(last) = self.0.last_mut() {
            last.1 = tick;
        }
    }

    /// Returns the spans: the first and the last tick of each.
    pub fn ticks(&self) -> &[(u64, u64)] {
        &self.0
    }

    /// Returns these spans, or `None` if they are not in order, or one that is not the last has not ended.
    pub fn of(ticks: Vec<(u64, u64)>) -> Option<Spans> {
        let in_order = ticks.iter().all(|span| span.0 <= span.1) && ticks.windows(2).all(|two| two[0].1 < two[1].0);
        in_order.then_some(Spans(ticks))
    }

    /// Returns whether the last span has not ended.
    pub fn is_open(&self) -> bool {
        self.0.last().is_some_and(|span| span.1 == OPEN)
    }

    /// Adds a tick after all others.
    pub fn add(&mut self, tick: u64) {
        match self.0.last_mut() {
            Some(last) if last.1 + 1 == tick => last.1 = tick,
            _ => self.0.push((tick, tick)),
        }
    }

    /// Removes all spans.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Forgets what the windows of tick `now` and of later ticks do not need.
    pub fn forget(&mut self, past: &Past, now: u64) {
        let from = past.last.map_or(0, |last| now.saturating_sub(u64::from(last)));
        self.0.retain(|span| span.1 >= from);
        if past.operator != PastOperator::Always {
            // If an earlier span is in the window, so is the last one that began before its end.
            let to = now.checked_sub(u64::from(past.first));
            let begun = to.and_then(|to| self.0.iter().rposition(|span| span.0 <= to));
            self.0.drain(..begun.unwrap_or(0));
        }
    }

    /// Returns whether the row of the hidden predicate holds in tick `now`.
    pub fn holds(&self, past: &Past, now: u64) -> bool {
        let Some(to) = now.checked_sub(u64::from(past.first)) else {
            return false;
        };
        // `None` if the window begins before the first tick.
        let from = past.last.and_then(|last| now.checked_sub(u64::from(last)));
        match past.operator {
            PastOperator::Always => from.is_some_and(|from| self.0.iter().any(|span| span.0 <= from && to <= span.1)),
            PastOperator::Once | PastOperator::Since(..) => {
                let from = from.unwrap_or(0);
                self.0.iter().any(|span| span.0 <= to && from <= span.1)
            }
        }
    }

    /// Returns the tick that explains a row that [holds](Spans::holds) in tick `now`: the nearest one of the window in
    /// which the operand held, or the first one if it held in all.
    pub fn witness(&self, past: &Past, now: u64) -> Option<u64> {
        let nearest = now.checked_sub(u64::from(past.first))?;
        match (&past.operator, past.last) {
            (PastOperator::Always, Some(last)) => now.checked_sub(u64::from(last)),
            _ => {
                let span = self.0.iter().rfind(|span| span.0 <= nearest);
                span.map(|span| span.1.min(nearest))
            }
        }
    }
}
