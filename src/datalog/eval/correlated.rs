//! The values of correlated aggregates that an evaluation keeps.
// Decision: docs/decisions/evaluation.md#d012

use crate::check::PredicateId;
use crate::value::Value;
use std::collections::HashMap;

/// The values of correlated aggregates, by predicate and parameters. What an aggregate reads is complete, so its values
/// stay valid while a stratum is evaluated.
#[derive(Debug)]
pub(crate) struct CorrelatedValues {
    known: HashMap<PredicateId, HashMap<Box<[Value]>, Option<Value>>>,
    /// The approximate memory of `known`.
    bytes: u64,
    /// The maximum of `bytes`.
    bytes_max: u64,
    /// The maximum memory of the rows of each evaluation in progress.
    pub(super) rows_bytes_max: u64,
}

impl Default for CorrelatedValues {
    /// An empty cache of any size, for plans without correlated aggregates.
    fn default() -> Self {
        CorrelatedValues::caching(u64::MAX)
    }
}

impl CorrelatedValues {
    /// Creates an empty cache of at most about `bytes`, for evaluations that have their own limit.
    pub(crate) fn caching(bytes: u64) -> Self {
        CorrelatedValues {
            known: HashMap::new(),
            bytes: 0,
            bytes_max: bytes,
            rows_bytes_max: u64::MAX,
        }
    }

    /// Creates an empty cache. It and the evaluations in progress together take at most about `bytes`. `depth` is the
    /// maximum number of evaluations in progress: an aggregate may need the values of others.
    pub(crate) fn within(bytes: u64, depth: usize) -> Self {
        CorrelatedValues {
            rows_bytes_max: bytes / 2 / depth.max(1) as u64,
            ..CorrelatedValues::caching(bytes / 2)
        }
    }

    /// The memory of an entry: a table is up to half empty, and has two copies while it grows.
    const ENTRY_BYTES: u64 = 3 * size_of::<(Box<[Value]>, Option<Value>)>() as u64 + 16;

    /// The value for these parameters if it is known. The inner `None` means that the aggregate has no value.
    #[allow(clippy::option_option)]
    pub(crate) fn get(&self, predicate: PredicateId, parameters: &[Value]) -> Option<Option<Value>> {
        self.known.get(&predicate)?.get(parameters).copied()
    }

    /// Adds a value. If the memory is full, forgets all others first.
    pub(crate) fn insert(&mut self, predicate: PredicateId, parameters: &[Value], value: Option<Value>) {
        let bytes = Self::ENTRY_BYTES + size_of_val(parameters) as u64;
        if self.bytes.saturating_add(bytes) > self.bytes_max {
            self.known = HashMap::new();
            self.bytes = 0;
        }
        if bytes <= self.bytes_max {
            self.bytes += bytes;
            self.known
                .entry(predicate)
                .or_default()
                .insert(parameters.into(), value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values_are_limited() {
        let mut values = CorrelatedValues::within(20_000, 5);
        assert_eq!(values.rows_bytes_max, 2_000);
        let predicate = PredicateId(3);
        for n in 0..1_000 {
            values.insert(predicate, &[Value(n), Value(1)], Some(Value(n)));
            assert!(values.bytes <= 10_000);
            assert_eq!(values.get(predicate, &[Value(n), Value(1)]), Some(Some(Value(n))));
        }
        assert_eq!(values.get(predicate, &[Value(0), Value(1)]), None);
        let mut values = CorrelatedValues::within(0, 5);
        values.insert(predicate, &[Value(0)], None);
        assert_eq!((values.get(predicate, &[Value(0)]), values.bytes), (None, 0));
    }
}
