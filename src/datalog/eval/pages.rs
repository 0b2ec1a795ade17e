//! Bits by pages: of a long list of bits, only the pages with a bit are stored.
// Decision: docs/decisions/evaluation.md#d018

/// The bits of all rows and of new ones, by pages.
#[derive(Clone, Debug)]
pub(crate) struct Paged {
    pub(crate) known: Pages,
    pub(crate) fresh: Pages,
}

/// A list of bits of which only the pages with a bit are stored.
#[derive(Clone, Debug)]
pub(crate) struct Pages {
    /// Indexed by page: its number in `words` plus 1, or 0 if it is not stored.
    places: Vec<u32>,
    words: Vec<u64>,
    /// The maximum number of stored pages.
    pub(crate) pages_max: usize,
}

impl Pages {
    /// The number of words of a page.
    pub(crate) const PAGE: usize = 64;

    pub(crate) fn new(words: usize, pages_max: usize) -> Self {
        Pages {
            places: vec![0; words.div_ceil(Self::PAGE)],
            words: Vec::new(),
            pages_max,
        }
    }

    /// Returns a word, and adds its page if necessary; `None` if no page is left.
    #[inline]
    pub(crate) fn word(&mut self, at: usize) -> Option<&mut u64> {
        let (page, word) = (at / Self::PAGE, at % Self::PAGE);
        let place = match self.places[page] {
            0 => self.add(page)?,
            place => place,
        };
        Some(&mut self.words[(place as usize - 1) * Self::PAGE + word])
    }

    #[cold]
    fn add(&mut self, page: usize) -> Option<u32> {
        let count = self.stored();
        if count >= self.pages_max {
            return None;
        }
        let len = self.words.len() + Self::PAGE;
        if len > self.words.capacity() {
            // Doubling would take more memory than `SeenBitmap::over` expects.
            self.words.try_reserve_exact(Self::PAGE.max(len / 8)).ok()?;
        }
        self.words.resize(len, 0);
        self.places[page] = u32::try_from(count + 1).ok()?;
        Some(self.places[page])
    }

    /// The number of stored pages.
    pub(crate) fn stored(&self) -> usize {
        self.words.len() / Self::PAGE
    }

    /// As many bits, none of which is set.
    pub(crate) fn cleared(&self) -> Self {
        Pages::new(self.places.len() * Self::PAGE, self.pages_max)
    }

    /// The bytes of the pages and of the list of them.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.words[..]) + size_of_val(&self.places[..])
    }

    /// Returns the stored words with their positions, in order. All others are 0.
    pub(crate) fn words(&self) -> impl Iterator<Item = (usize, u64)> {
        let places = self.places.iter().enumerate().filter(|(_, place)| **place > 0);
        places.flat_map(|(page, &place)| {
            let words = self.words[(place as usize - 1) * Self::PAGE..].iter().take(Self::PAGE);
            words.enumerate().map(move |(at, word)| (page * Self::PAGE + at, *word))
        })
    }
}

impl Paged {
    /// Adds the bit of a mask in a word; to the new ones, too, if they are `held`. Returns whether
    /// it was not set; `None` if it cannot be stored.
    #[inline]
    pub(crate) fn add(&mut self, (word, mask): (usize, u64), held: bool) -> Option<bool> {
        let known = self.known.word(word)?;
        if *known & mask != 0 {
            return Some(false);
        }
        *known |= mask;
        // Cannot fail: each page of new rows is also one of known rows, and both lists have the same limit.
        if held && let Some(fresh) = self.fresh.word(word) {
            *fresh |= mask;
        }
        Some(true)
    }
}
