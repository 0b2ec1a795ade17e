//! Interned strings, and the words of numbers of 64 bits, which are interned among them.
//!
//! A [`Symbol`] is a small number that represents a string, and [`Symbols`] is the table that maps both ways. Symbols are
//! numbered in order of first appearance, so they are the same in every run.
//!
//! A table grows through a shared reference, since rules create symbols during evaluation. A string never moves, so
//! [`Symbols::resolve`] takes no lock.
// Decision: docs/decisions/facts.md#d013

use indexmap::IndexSet;
use std::fmt;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

/// An interned string, valid only with the [`Symbols`] that made it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Symbol(pub u32);

/// A table of interned strings.
#[derive(Default)]
pub struct Symbols {
    /// Maps strings to numbers.
    numbers: RwLock<IndexSet<Arc<str>>>,
    /// Maps numbers to strings: block b holds `FIRST_BLOCK << b` strings.
    strings: [OnceLock<Block>; BLOCKS],
    /// The number of strings; read for every inserted row.
    len: AtomicUsize,
    /// The approximate memory of all strings, in bytes.
    bytes: AtomicU64,
    /// The size of the numbers that words stand for.
    word_size: WordSize,
}

/// The size of `number`, `unsigned` and `float`.
///
/// A row has 32 bits for each column in both sizes. With 64 bits, a whole number from 0 to 2^31 - 1 is its own word. Any
/// other number, and each float but 0, is interned like a string, which takes more memory and time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WordSize {
    /// `number` is an `i32`, `unsigned` a `u32`, `float` an `f32`.
    #[default]
    Bits32,
    /// `number` is an `i64`, `unsigned` a `u64`, `float` an `f64`.
    Bits64,
}

/// The first character of the string of an interned number.
const NUMBER_PREFIX: char = '\u{e001}';

/// The bit that marks the word of an interned number.
const INTERNED: u32 = 1 << 31;

type Block = Box<[OnceLock<Arc<str>>]>;

/// The number of strings in the first block; a power of two.
const FIRST_BLOCK: usize = 64;

/// The overhead of a string in bytes, rounded up: its entries in both directions, with room to grow, and its allocation.
const STRING_BYTES: u64 = 128;

/// The number of blocks that hold 2^32 strings.
const BLOCKS: usize = 27;

/// Encodes values as words.
#[derive(Clone, Copy)]
pub struct WordEncoder<'a> {
    strings: Strings<'a>,
    size: WordSize,
}

/// What maps strings to symbols.
#[derive(Clone, Copy)]
enum Strings<'a> {
    Interned(&'a Symbols),
    Known(&'a Symbols),
    By(&'a dyn Fn(&str) -> Option<Symbol>),
}

impl<'a> WordEncoder<'a> {
    /// Creates an encoder from a function that maps strings, and the size of numbers.
    pub fn new(symbol: &'a dyn Fn(&str) -> Option<Symbol>, size: WordSize) -> Self {
        let strings = Strings::By(symbol);
        WordEncoder { strings, size }
    }

    /// Returns the size of numbers.
    pub fn size(&self) -> WordSize {
        self.size
    }

    /// Returns the symbol of a string.
    pub fn symbol(&self, text: &str) -> Option<Symbol> {
        match self.strings {
            Strings::Interned(symbols) => Some(symbols.intern(text)),
            Strings::Known(symbols) => symbols.get(text),
            Strings::By(symbol) => symbol(text),
        }
    }

    /// Returns the word of a number of 64 bits.
    pub(crate) fn bits(&self, bits: u64) -> Option<u32> {
        match u32::try_from(bits) {
            Ok(small) if small < INTERNED => Some(small),
            _ => {
                let Symbol(id) = self.symbol(&format!("{NUMBER_PREFIX}{bits:016x}"))?;
                assert!(id < INTERNED, "fewer than 2^31 strings");
                Some(id | INTERNED)
            }
        }
    }
}

/// Returns the block of a number and its index there.
fn place(number: u32) -> (usize, usize) {
    let shifted = number as usize + FIRST_BLOCK;
    let block = (shifted.ilog2() - FIRST_BLOCK.ilog2()) as usize;
    (block, shifted - (FIRST_BLOCK << block))
}

impl Symbols {
    /// Creates an empty table.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates an empty table for numbers of this size.
    pub fn of_words(word_size: WordSize) -> Self {
        Symbols {
            word_size,
            ..Self::default()
        }
    }

    /// Returns the size of the numbers that words stand for.
    pub fn word_size(&self) -> WordSize {
        self.word_size
    }

    /// Returns whether a word stands for a number: in 64 bits, it is small or interned.
    pub(crate) fn is_number(&self, word: u32) -> bool {
        let is_interned = || {
            let text = self.resolve(Symbol(word & !INTERNED));
            text.is_some_and(|text| text.starts_with(NUMBER_PREFIX))
        };
        self.word_size == WordSize::Bits32 || word < INTERNED || is_interned()
    }

    /// Returns the word in this table of a number in another one.
    pub(crate) fn number_of(&self, word: u32, from: &Symbols) -> u32 {
        match self.word_size {
            WordSize::Bits32 => word,
            WordSize::Bits64 => self.intern_bits(from.bits(word)),
        }
    }

    /// Returns what encodes values and interns new strings.
    pub fn encoder(&self) -> WordEncoder<'_> {
        WordEncoder {
            strings: Strings::Interned(self),
            size: self.word_size,
        }
    }

    /// Returns what encodes values whose strings are known.
    pub fn finder(&self) -> WordEncoder<'_> {
        WordEncoder {
            strings: Strings::Known(self),
            size: self.word_size,
        }
    }

    /// Returns the word of a number of 64 bits.
    pub(crate) fn intern_bits(&self, bits: u64) -> u32 {
        self.encoder().bits(bits).expect("an encoder interns every string")
    }

    /// Returns the number of 64 bits with this word; 0 if there is none.
    pub(crate) fn bits(&self, word: u32) -> u64 {
        if word < INTERNED {
            return word.into();
        }
        let text = self.resolve(Symbol(word & !INTERNED)).unwrap_or_default();
        let digits = text.strip_prefix(NUMBER_PREFIX).unwrap_or_default();
        digits.bytes().fold(0, |bits, digit| {
            bits << 4 | u64::from(char::from(digit).to_digit(16).unwrap_or_default())
        })
    }

    /// Returns the symbol of a string; creates it if it is new.
    pub fn intern(&self, string: &str) -> Symbol {
        if let Some(known) = self.get(string) {
            return known;
        }
        let mut numbers = self.numbers.write().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have added it meanwhile.
        if let Some(index) = numbers.get_index_of(string) {
            return symbol(index);
        }
        let string: Arc<str> = string.into();
        let made = symbol(numbers.insert_full(Arc::clone(&string)).0);
        let (block, at) = place(made.0);
        let block = self.strings[block].get_or_init(|| (0..FIRST_BLOCK << block).map(|_| OnceLock::new()).collect());
        self.bytes
            .fetch_add(STRING_BYTES + string.len() as u64, Ordering::Relaxed);
        block[at].get_or_init(|| string);
        self.len.store(numbers.len(), Ordering::Release);
        made
    }

    /// Removes all but the first `len` symbols.
    pub fn truncate(&mut self, len: usize) {
        let numbers = self.numbers.get_mut().unwrap_or_else(PoisonError::into_inner);
        for string in numbers.drain(len.min(numbers.len())..).rev() {
            let last = *self.len.get_mut() - 1;
            let (block, at) = place(symbol(last).0);
            if let Some(block) = self.strings[block].get_mut() {
                block[at].take();
            }
            *self.bytes.get_mut() -= STRING_BYTES + string.len() as u64;
            *self.len.get_mut() = last;
        }
    }

    /// Returns the symbol of a string, or `None` if it has none.
    pub fn get(&self, string: &str) -> Option<Symbol> {
        let numbers = self.numbers.read().unwrap_or_else(PoisonError::into_inner);
        numbers.get_index_of(string).map(symbol)
    }

    /// Returns the string of a symbol, or `None` if the table does not have it.
    pub fn resolve(&self, symbol: Symbol) -> Option<&str> {
        let (block, at) = place(symbol.0);
        self.strings.get(block)?.get()?.get(at)?.get().map(AsRef::as_ref)
    }

    /// Returns the number of symbols.
    pub fn len(&self) -> usize {
        self.len.load(Ordering::Acquire)
    }

    /// Returns the approximate memory of the table in bytes, a function of the strings alone.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Returns whether there are no symbols.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

fn symbol(index: usize) -> Symbol {
    Symbol(u32::try_from(index).expect("fewer than 2^32 symbols"))
}

impl Clone for Symbols {
    fn clone(&self) -> Self {
        let copy = Symbols::of_words(self.word_size);
        for text in self.numbers.read().unwrap_or_else(PoisonError::into_inner).iter() {
            copy.intern(text);
        }
        copy
    }
}

impl fmt::Debug for Symbols {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let numbers = self.numbers.read().unwrap_or_else(PoisonError::into_inner);
        f.debug_list().entries(numbers.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_forgotten_leaves_nothing() {
        let mut symbols = Symbols::new();
        symbols.intern("a");
        let bytes = symbols.bytes();
        (0..500).for_each(|number| _ = symbols.intern(&number.to_string()));
        assert!(symbols.bytes() > bytes + 500);
        symbols.truncate(700);
        assert_eq!(symbols.len(), 501);
        symbols.truncate(1);
        assert_eq!((symbols.len(), symbols.bytes()), (1, bytes));
        assert_eq!((symbols.resolve(Symbol(1)), symbols.get("0")), (None, None));
        assert_eq!(symbols.intern("b"), Symbol(1));
        assert_eq!(
            (symbols.resolve(Symbol(0)), symbols.resolve(Symbol(1))),
            (Some("a"), Some("b"))
        );
    }

    #[test]
    fn strings_and_numbers_go_both_ways() {
        let symbols = Symbols::new();
        for number in 0..1_000 {
            assert_eq!(symbols.intern(&number.to_string()), Symbol(number));
        }
        for number in 0..1_000 {
            assert_eq!(symbols.resolve(Symbol(number)), Some(number.to_string().as_str()));
            assert_eq!(symbols.intern(&number.to_string()), Symbol(number));
        }
        assert_eq!((symbols.len(), symbols.clone().len()), (1_000, 1_000));
        assert_eq!(symbols.resolve(Symbol(1_000)), None);
        assert_eq!(symbols.resolve(Symbol(u32::MAX)), None);
    }
}
