//! Interned names.
//!
//! A [`Symbol`] is a small number that stands for a text; [`Symbols`] is the table that knows both ways. Numbers are given in
//! the order of first appearance, so they are the same in every run.

use indexmap::IndexSet;

/// An interned text; meaningful only with the [`Symbols`] that made it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Symbol(pub u32);

/// A table of interned texts.
#[derive(Clone, Debug, Default)]
pub struct Symbols {
    texts: IndexSet<Box<str>>,
}

impl Symbols {
    /// An empty table.
    pub fn new() -> Self {
        Self::default()
    }

    /// The symbol of a text, made if it is new.
    pub fn intern(&mut self, text: &str) -> Symbol {
        let index = match self.texts.get_index_of(text) {
            Some(index) => index,
            None => self.texts.insert_full(text.into()).0,
        };
        Symbol(u32::try_from(index).expect("fewer than 2^32 symbols"))
    }

    /// The symbol of a text, if it has one.
    pub fn get(&self, text: &str) -> Option<Symbol> {
        let index = self.texts.get_index_of(text)?;
        Some(Symbol(u32::try_from(index).expect("fewer than 2^32 symbols")))
    }

    /// The text of a symbol; `None` if another table made it.
    pub fn text(&self, symbol: Symbol) -> Option<&str> {
        self.texts.get_index(symbol.0 as usize).map(AsRef::as_ref)
    }

    /// How many symbols there are.
    pub fn len(&self) -> usize {
        self.texts.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.texts.is_empty()
    }
}
