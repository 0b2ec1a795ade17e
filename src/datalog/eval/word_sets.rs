//! Lists of rows as sets of bits.

use crate::eval::groups::KeyHasher;
use crate::row::Row;
use crate::value::Value;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::BuildHasherDefault;

/// The words that follow a word in the rows of a plan's last scan, as sets of bits.
///
/// A recursive clause often finds the same long list of rows for many derived rows. Merging a set into a
/// [`SeenBitmap`] takes one operation for 64 of them.
#[derive(Debug, Default)]
pub(super) struct WordSets {
    /// Indexed by batch and word: the position of the set in `bits`; `None` if the word occurred once, without a set.
    /// Only looked up, so its order does not matter.
    places: HashMap<(u32, Value), Option<usize>, BuildHasherDefault<KeyHasher>>,
    bits: Vec<u64>,
    /// The number of words of a set.
    width: usize,
}

impl WordSets {
    /// Shorter lists take less time than their sets.
    pub(super) const ROWS_MIN: usize = 32;

    /// Returns the set of the words in the second column of `found`: the rows of a batch that begin with `first`. The
    /// words are less than `64 * width`. Returns `None` at the first call for a word, or if all sets together would
    /// have more than `most` words.
    pub(super) fn of<const V: usize>(
        &mut self,
        (batch, first): (u32, Value),
        found: &[Row<V>],
        (width, most): (usize, usize),
    ) -> Option<&[u64]> {
        if width != self.width {
            *self = WordSets::default();
            self.width = width;
        }
        let place = match self.places.entry((batch, first)) {
            Entry::Vacant(entry) => {
                entry.insert(None);
                return None;
            }
            Entry::Occupied(entry) => entry.into_mut(),
        };
        let start = match *place {
            Some(start) => start,
            None if self.bits.len() + width > most => return None,
            None => {
                let start = self.bits.len();
                self.bits.resize(start + width, 0);
                let set = &mut self.bits[start..];
                for row in found {
                    let word = row.0[1].0;
                    set[(word / u64::BITS) as usize] |= 1 << (word % u64::BITS);
                }
                *place = Some(start);
                start
            }
        };
        Some(&self.bits[start..start + width])
    }
}
